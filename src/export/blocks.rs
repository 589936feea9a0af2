//! Long texts, formatted in blocks on all threads and written in order, one lot while the next is
//! formatted. What waits is bounded, so a file of any length takes little memory; the bytes do not
//! depend on the threads.

use std::io::{self, Write};

use rayon::prelude::*;

use super::Sink;

/// Rows that are formatted as one.
const BLOCK: usize = 1 << 13;
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
    /// Of what waits, about.
    bytes: usize,
    formatted: Vec<Vec<u8>>,
    /// Written, and kept for their room.
    spare: Vec<Vec<u8>>,
}

impl<'a, 's> Blocks<'a, 's> {
    pub fn new(sink: &'s mut dyn Sink) -> Self {
        Blocks { sink, waiting: Vec::new(), bytes: 0, formatted: Vec::new(), spare: Vec::new() }
    }

    pub fn text(&mut self, text: &str) -> io::Result<()> {
        self.write_all(text.as_bytes())
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
        self.pass_on()?;
        self.pass_on()
    }

    fn add(&mut self, bytes: usize) -> io::Result<()> {
        self.bytes += bytes;
        if self.bytes < WAITING { Ok(()) } else { self.pass_on() }
    }

    /// Writes what is formatted, and formats what waits.
    fn pass_on(&mut self) -> io::Result<()> {
        self.bytes = 0;
        let waiting = std::mem::take(&mut self.waiting);
        let mut texts = std::mem::take(&mut self.spare);
        texts.iter_mut().for_each(Vec::clear);
        texts.resize_with(texts.len().max(waiting.len()), Vec::new);
        let (sink, formatted) = (&mut self.sink, &self.formatted);
        let (written, ()) = rayon::join(
            || formatted.iter().try_for_each(|text| sink.write_all(text)),
            || {
                let pairs = waiting.into_par_iter().zip(&mut texts);
                pairs.for_each(|(block, out)| match block {
                    Block::Text(text) => *out = text,
                    Block::Rows(format) => format(out),
                });
            },
        );
        self.spare = std::mem::replace(&mut self.formatted, texts);
        written
    }
}

/// As text between rows.
impl Write for Blocks<'_, '_> {
    fn write(&mut self, text: &[u8]) -> io::Result<usize> {
        match self.waiting.last_mut() {
            Some(Block::Text(last)) => last.extend_from_slice(text),
            _ => self.waiting.push(Block::Text(text.to_vec())),
        }
        self.add(text.len())?;
        Ok(text.len())
    }

    /// Only [`Blocks::finish`] writes everything.
    fn flush(&mut self) -> io::Result<()> {
        Ok(())
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

    #[test]
    fn a_failing_sink_is_told_of() {
        struct Full(usize);
        impl Write for Full {
            fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
                self.0 = self.0.checked_sub(bytes.len()).ok_or(io::ErrorKind::StorageFull)?;
                Ok(bytes.len())
            }
            fn flush(&mut self) -> io::Result<()> {
                Ok(())
            }
        }
        impl io::Seek for Full {
            fn seek(&mut self, _: io::SeekFrom) -> io::Result<u64> {
                Ok(0)
            }
        }
        let items: Vec<u64> = (0..100_000).collect();
        for room in [0, 100, WAITING / 8] {
            let mut sink = Full(room);
            let mut blocks = Blocks::new(&mut sink);
            let write = |out: &mut Vec<u8>, n: &u64| out.extend(n.to_le_bytes());
            let told = blocks.rows(&items, write).and_then(|()| blocks.finish());
            assert_eq!(told.unwrap_err().kind(), io::ErrorKind::StorageFull, "{room}");
        }
    }
}
