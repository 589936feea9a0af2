//! Long texts, formatted in blocks on all threads. A block whose turn has come is written by the thread
//! that has it; others leave theirs to whoever is writing and go on, so that threads hardly ever wait for
//! each other. What waits is bounded, so a file of any length takes little memory; the bytes do not depend
//! on the threads.

use std::collections::BTreeMap;
use std::io::{self, Write};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread;

use super::Sink;
use super::number::Pen;

/// Rows that are formatted as one: half a MB, much beside what handing it on takes.
const BLOCK: usize = 1 << 14;
/// Bytes of plain text that wait before they count as a block.
const WAITING: usize = 1 << 16;
/// Blocks a thread that may wait to be written.
const READY: usize = 2;

/// Formats the chunk of a number.
type Format<'a> = dyn Fn(&mut Pen, usize) + Send + Sync + 'a;

enum Piece<'a> {
    Text(Vec<u8>),
    Rows { chunks: usize, format: Arc<Format<'a>> },
}

pub(super) struct Blocks<'a> {
    text: Vec<u8>,
    pieces: SyncSender<Piece<'a>>,
}

/// Blocks that are still to be formatted.
struct Waiting<'a> {
    pieces: Receiver<Piece<'a>>,
    /// The first chunk that nobody has, how many there are, and what formats them.
    rows: Option<(usize, usize, Arc<Format<'a>>)>,
    /// Blocks so far.
    count: u64,
}

enum Block<'a> {
    Text(Vec<u8>),
    Rows(usize, Arc<Format<'a>>),
}

impl<'a> Waiting<'a> {
    /// The next block and its number; `None` when there are no more.
    fn next(&mut self) -> Option<(u64, Block<'a>)> {
        let block = loop {
            if let Some((chunk, chunks, format)) = &mut self.rows
                && chunk < chunks
            {
                *chunk += 1;
                break Block::Rows(*chunk - 1, format.clone());
            }
            self.rows = None;
            match self.pieces.recv().ok()? {
                Piece::Text(text) => break Block::Text(text),
                Piece::Rows { chunks, format } => self.rows = Some((0, chunks, format)),
            }
        };
        self.count += 1;
        Some((self.count - 1, block))
    }
}

/// What is formatted and not written yet, by number; [`None`] where formatting failed.
struct Ready {
    blocks: BTreeMap<u64, Option<Pen>>,
    /// Number of the block to be written next.
    next: u64,
    /// Nobody else may write.
    is_writing: bool,
    /// To be filled again.
    spare: Vec<Pen>,
    /// Nothing is written after a failure.
    failure: Option<io::Error>,
}

/// What all threads share.
struct Line<'a, 's> {
    waiting: Mutex<Waiting<'a>>,
    ready: Mutex<Ready>,
    sink: Mutex<&'s mut dyn Sink>,
    written: Condvar,
    most_ready: usize,
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
    let (pieces, waiting) = sync_channel(threads);
    let line = Line {
        waiting: Mutex::new(Waiting { pieces: waiting, rows: None, count: 0 }),
        ready: Mutex::new(Ready {
            blocks: BTreeMap::new(),
            next: 0,
            is_writing: false,
            spare: Vec::new(),
            failure: None,
        }),
        sink: Mutex::new(sink),
        written: Condvar::new(),
        most_ready: READY * threads,
    };
    let filled = thread::scope(|scope| {
        for _ in 0..threads {
            thread::Builder::new().spawn_scoped(scope, || line.work())?;
        }
        fill(Blocks { text: Vec::new(), pieces })
    });
    let ready = line.ready.into_inner().unwrap_or_else(PoisonError::into_inner);
    ready.failure.map_or(filled, Err)
}

impl Line<'_, '_> {
    /// Formats and writes blocks until there are no more.
    fn work(&self) {
        let mut pen = Pen::new();
        loop {
            // The lock is not held while a block is formatted.
            let block = lock(&self.waiting).next();
            let Some((number, block)) = block else { return };
            pen.clear();
            // The others would wait for ever for a block that does not come.
            let formatted = catch_unwind(AssertUnwindSafe(|| match block {
                Block::Text(text) => pen.text(&text),
                Block::Rows(chunk, format) => format(&mut pen, chunk),
            }));
            pen = self.hand_on(number, formatted.is_ok().then_some(pen));
        }
    }

    /// Writes what can be written, or leaves it to who is writing; gives a pen to go on with.
    fn hand_on(&self, number: u64, block: Option<Pen>) -> Pen {
        let mut ready = lock(&self.ready);
        ready.blocks.insert(number, block);
        // Whoever has the next one to be written does not wait, and wakes the others.
        let is_too_much = |r: &mut Ready| {
            let can_write = !r.is_writing && r.blocks.contains_key(&r.next);
            r.blocks.len() > self.most_ready && !can_write
        };
        ready = self.written.wait_while(ready, is_too_much).unwrap_or_else(PoisonError::into_inner);
        while !ready.is_writing {
            let next = ready.next;
            let Some(block) = ready.blocks.remove(&next) else { break };
            ready.next += 1;
            if ready.failure.is_none() {
                ready.is_writing = true;
                drop(ready);
                let told = match &block {
                    Some(pen) => lock(&self.sink).write_all(pen.as_bytes()),
                    None => Err(io::Error::other("the formatting of a block failed")),
                };
                ready = lock(&self.ready);
                ready.is_writing = false;
                ready.failure = told.err();
            }
            ready.spare.extend(block);
            self.written.notify_all();
        }
        ready.spare.pop().unwrap_or_else(Pen::new)
    }
}

fn lock<T: ?Sized>(of: &Mutex<T>) -> MutexGuard<'_, T> {
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
        if items.is_empty() {
            return Ok(());
        }
        self.pass_on_text()?;
        let format = move |out: &mut Pen, chunk: usize| {
            let rest = items.get(chunk * BLOCK..).unwrap_or_default();
            rest.iter().take(BLOCK).for_each(|item| write(out, item));
        };
        self.pass_on(Piece::Rows { chunks: items.len().div_ceil(BLOCK), format: Arc::new(format) })
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
        self.pass_on(Piece::Text(text))
    }

    fn pass_on(&mut self, piece: Piece<'a>) -> io::Result<()> {
        self.pieces.send(piece).map_err(|_| io::Error::other("the formatting threads stopped"))
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
