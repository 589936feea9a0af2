//! Long texts, formatted in blocks on all threads and written in order. What waits is bounded, so
//! a file of any length takes little memory; the bytes do not depend on the threads.

use std::io;

use rayon::prelude::*;

use super::Sink;

/// Rows that are formatted as one.
const BLOCK: usize = 1 << 12;
/// Bytes that wait before they are formatted.
const WAITING: usize = 1 << 22;
/// Of a row, about.
const ROW_BYTES: usize = 32;

type Format<'a> = dyn Fn(&mut Vec<u8>) + Send + Sync + 'a;

enum Block<'a> {
    Text(Vec<u8>),
    Rows(Box<Format<'a>>),
}

pub(super) struct Blocks<'a, 's> {
    sink: &'s mut dyn Sink,
    waiting: Vec<Block<'a>>,
    bytes: usize,
}

impl<'a, 's> Blocks<'a, 's> {
    pub fn new(sink: &'s mut dyn Sink) -> Self {
        Blocks { sink, waiting: Vec::new(), bytes: 0 }
    }

    pub fn text(&mut self, text: &str) -> io::Result<()> {
        match self.waiting.last_mut() {
            Some(Block::Text(last)) => last.extend(text.as_bytes()),
            _ => self.waiting.push(Block::Text(text.as_bytes().to_vec())),
        }
        self.add(text.len())
    }

    /// Each item as `write` puts it.
    pub fn rows<T: Sync>(
        &mut self,
        items: &'a [T],
        write: impl Fn(&mut Vec<u8>, &T) + Copy + Send + Sync + 'a,
    ) -> io::Result<()> {
        for chunk in items.chunks(BLOCK) {
            let format = move |out: &mut Vec<u8>| chunk.iter().for_each(|item| write(out, item));
            self.waiting.push(Block::Rows(Box::new(format)));
            self.add(chunk.len() * ROW_BYTES)?;
        }
        Ok(())
    }

    /// Writes what waits.
    pub fn finish(mut self) -> io::Result<()> {
        self.flush()
    }

    fn add(&mut self, bytes: usize) -> io::Result<()> {
        self.bytes += bytes;
        if self.bytes < WAITING { Ok(()) } else { self.flush() }
    }

    fn flush(&mut self) -> io::Result<()> {
        self.bytes = 0;
        let texts: Vec<Vec<u8>> = std::mem::take(&mut self.waiting)
            .into_par_iter()
            .map(|block| match block {
                Block::Text(text) => text,
                Block::Rows(format) => {
                    let mut out = Vec::new();
                    format(&mut out);
                    out
                }
            })
            .collect();
        texts.iter().try_for_each(|text| self.sink.write_all(text))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blocks_are_joined_in_order_without_a_seam() {
        let items: Vec<u64> = (0..(WAITING / 8) as u64 + 5).collect();
        let mut sink = io::Cursor::new(Vec::new());
        let mut blocks = Blocks::new(&mut sink);
        blocks.text("begin").unwrap();
        let write = |out: &mut Vec<u8>, n: &u64| out.extend(format!(" {n}").as_bytes());
        blocks.rows(&items, write).unwrap();
        blocks.text(" e").unwrap();
        blocks.text("nd").unwrap();
        blocks.finish().unwrap();
        let plain: Vec<String> = items.iter().map(u64::to_string).collect();
        let expected = format!("begin {} end", plain.join(" "));
        assert!(sink.into_inner() == expected.into_bytes());
    }
}
