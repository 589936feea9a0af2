//! Long texts, formatted in blocks on all threads. A thread writes what it formatted, when its turn has
//! come, while the block is still at hand in its cache. What waits is bounded, so a file of any length
//! takes little memory; the bytes do not depend on the threads.

use std::io::{self, Write};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::thread;

use super::Sink;
use super::number::Pen;

/// Rows that are formatted as one.
const BLOCK: usize = 1 << 13;
/// Bytes of plain text that wait before they count as a block.
const WAITING: usize = 1 << 16;

type Format<'a> = dyn Fn(&mut Pen) + Send + Sync + 'a;

enum Block<'a> {
    Text(Vec<u8>),
    Rows(Box<Format<'a>>),
}

pub(super) struct Blocks<'a> {
    text: Vec<u8>,
    /// Blocks so far.
    count: u64,
    blocks: SyncSender<(u64, Block<'a>)>,
}

/// Whose turn it is to write, and where to.
struct Turn<'s> {
    next: u64,
    sink: &'s mut dyn Sink,
    /// Nothing is written after a failure.
    failure: Option<io::Error>,
}

/// Writes to `sink` what `fill` gives the blocks; it must finish them.
///
/// # Errors
/// The sink's, else those of `fill`.
pub(super) fn through<'a>(
    sink: &mut dyn Sink,
    fill: impl FnOnce(Blocks<'a>) -> io::Result<()>,
) -> io::Result<()> {
    let threads = rayon::current_num_threads().max(1);
    let (blocks, waiting) = sync_channel(threads);
    let waiting = Mutex::new(waiting);
    let turn = Mutex::new(Turn { next: 0, sink, failure: None });
    let written = Condvar::new();
    let filled = thread::scope(|scope| {
        for _ in 0..threads {
            thread::Builder::new().spawn_scoped(scope, || format(&waiting, &turn, &written))?;
        }
        fill(Blocks { text: Vec::new(), count: 0, blocks })
    });
    let turn = turn.into_inner().unwrap_or_else(PoisonError::into_inner);
    turn.failure.map_or(filled, Err)
}

/// Formats and writes blocks until there are no more.
fn format<'a>(
    waiting: &Mutex<Receiver<(u64, Block<'a>)>>,
    turn: &Mutex<Turn<'_>>,
    written: &Condvar,
) {
    let mut pen = Pen::new();
    loop {
        let block = lock(waiting).recv();
        let Ok((number, block)) = block else { return };
        pen.clear();
        // The others would wait for ever for a turn that was not taken.
        let formatted = catch_unwind(AssertUnwindSafe(|| match block {
            Block::Text(text) => pen.text(&text),
            Block::Rows(format) => format(&mut pen),
        }));
        let mut turn = written
            .wait_while(lock(turn), |turn| turn.next != number)
            .unwrap_or_else(PoisonError::into_inner);
        turn.next += 1;
        if turn.failure.is_none() {
            let failed = |_| io::Error::other("the formatting of a block failed");
            let told = formatted.map_err(failed).and_then(|()| turn.sink.write_all(pen.as_bytes()));
            turn.failure = told.err();
        }
        drop(turn);
        written.notify_all();
    }
}

fn lock<T>(of: &Mutex<T>) -> MutexGuard<'_, T> {
    of.lock().unwrap_or_else(PoisonError::into_inner)
}

impl<'a> Blocks<'a> {
    pub fn text(&mut self, text: &str) -> io::Result<()> {
        self.write_all(text.as_bytes())
    }

    /// Each item as `write` puts it.
    pub fn rows<T: Sync>(
        &mut self,
        items: &'a [T],
        write: impl Fn(&mut Pen, &T) + Copy + Send + Sync + 'a,
    ) -> io::Result<()> {
        for chunk in items.chunks(BLOCK) {
            self.pass_on_text()?;
            let format = move |out: &mut Pen| chunk.iter().for_each(|item| write(out, item));
            self.pass_on(Block::Rows(Box::new(format)))?;
        }
        Ok(())
    }

    /// Passes on what waits.
    pub fn finish(mut self) -> io::Result<()> {
        self.pass_on_text()
    }

    fn pass_on_text(&mut self) -> io::Result<()> {
        if self.text.is_empty() {
            return Ok(());
        }
        let text = std::mem::take(&mut self.text);
        self.pass_on(Block::Text(text))
    }

    fn pass_on(&mut self, block: Block<'a>) -> io::Result<()> {
        let numbered = (self.count, block);
        self.count += 1;
        self.blocks.send(numbered).map_err(|_| io::Error::other("the formatting threads stopped"))
    }
}

/// As text between rows.
impl Write for Blocks<'_> {
    fn write(&mut self, text: &[u8]) -> io::Result<usize> {
        self.text.extend_from_slice(text);
        if self.text.len() >= WAITING {
            self.pass_on_text()?;
        }
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
        let items: Vec<u64> = (0..(40 * BLOCK) as u64 + 5).collect();
        let mut sink = io::Cursor::new(Vec::new());
        through(&mut sink, |mut blocks| {
            blocks.text("begin")?;
            blocks.rows(&items, |out, n| out.text(format!(" {n}").as_bytes()))?;
            blocks.text(" e")?;
            blocks.text("nd")?;
            blocks.finish()
        })
        .unwrap();
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
        let items: Vec<u64> = (0..(40 * BLOCK) as u64).collect();
        for room in [0, 100, WAITING / 8] {
            let mut sink = Full(room);
            let told = through(&mut sink, |mut blocks| {
                blocks.rows(&items, |out, n| out.text(&n.to_le_bytes()))?;
                blocks.finish()
            });
            assert_eq!(told.unwrap_err().kind(), io::ErrorKind::StorageFull, "{room}");
        }
    }
}
