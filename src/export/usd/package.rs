//! The container of .usdz: a zip archive whose files are stored as they are, each from a multiple
//! of 64 bytes on, so that readers can use them in place.

use std::io::{self, Seek, SeekFrom, Write};

use crc32fast::Hasher;

const ALIGNMENT: u64 = 64;
/// Local header without name and padding.
const HEADER: u64 = 30;
/// The record that ends the archive.
const END: u64 = 22;
/// Names the extra field that pads.
const PADDING: u16 = 0x1986;
/// The first moment that a zip can tell: 1980-01-01.
const DATE: u16 = 0x21;

/// What a package's 32-bit lengths can tell; one more means something else.
pub(super) const MOST_BYTES: u64 = u32::MAX as u64 - 1;

/// An archive on the way; offsets count from where `out` stood at first.
pub(super) struct Package<W> {
    out: W,
    most_bytes: u64,
    at: u64,
    entries: Vec<Entry>,
}

struct Entry {
    name: String,
    crc: u32,
    length: u32,
    place: u32,
}

impl<W: Write + Seek> Package<W> {
    /// Of so many bytes at most, which are no more than [`MOST_BYTES`].
    pub fn new(out: W, most_bytes: u64) -> Self {
        Package { out, most_bytes, at: 0, entries: Vec::new() }
    }

    pub fn add(&mut self, name: &str, bytes: &[u8]) -> io::Result<()> {
        self.add_written(name, 0, |body| body.write_all(bytes).map(|()| Vec::new()))
    }

    /// A file that begins with `head` bytes which are known when the rest is written: `write` writes
    /// the rest and gives them.
    ///
    /// # Errors
    /// `FileTooLarge` where the archive passes its limit, besides those of `out`.
    pub fn add_written(
        &mut self,
        name: &str,
        head: usize,
        write: impl FnOnce(&mut Body<&mut W>) -> io::Result<Vec<u8>>,
    ) -> io::Result<()> {
        let place = self.at;
        let named = place + HEADER + name.len() as u64;
        // The field that pads has four bytes of its own.
        let start = (named + 4).next_multiple_of(ALIGNMENT);
        let padding = (start - named) as u16;
        self.out.write_all(&vec![0; (start - place) as usize + head])?;
        let mut body = Body { out: &mut self.out, crc: Hasher::new(), length: 0 };
        let head_bytes = write(&mut body)?;
        let Body { crc: rest, length, .. } = body;
        let mut crc = Hasher::new();
        crc.update(&head_bytes);
        crc.combine(&rest);
        let entry = Entry {
            name: name.to_owned(),
            crc: crc.finalize(),
            length: self.small(head as u64 + length)?,
            place: self.small(place)?,
        };
        self.at = start + head as u64 + length;
        let end = self.small(self.at)?;

        let mut header = b"PK\x03\x04".to_vec();
        header.extend(entry.described(padding));
        header.extend(entry.name.as_bytes());
        header.extend(PADDING.to_le_bytes());
        header.extend((padding - 4).to_le_bytes());
        header.resize((start - place) as usize, 0);
        header.extend(head_bytes);
        let back = i64::from(end) - place as i64;
        self.out.seek(SeekFrom::Current(-back))?;
        self.out.write_all(&header)?;
        self.out.seek(SeekFrom::Current(back - header.len() as i64))?;
        self.entries.push(entry);
        Ok(())
    }

    /// Writes the list of files, which ends the archive.
    pub fn finish(mut self) -> io::Result<()> {
        let mut list = Vec::new();
        for entry in &self.entries {
            list.extend(b"PK\x01\x02");
            // Made by version 2.0 of the format.
            list.extend(20u16.to_le_bytes());
            list.extend(entry.described(0));
            // No comment, first disk, no attributes.
            list.extend([0; 10]);
            list.extend(entry.place.to_le_bytes());
            list.extend(entry.name.as_bytes());
        }
        let count = u16::try_from(self.entries.len()).map_err(|_| too_large())?;
        self.small(self.at + list.len() as u64 + END)?;
        let length = list.len() as u32;
        list.extend(b"PK\x05\x06");
        list.extend([0; 4]);
        list.extend(count.to_le_bytes());
        list.extend(count.to_le_bytes());
        list.extend(length.to_le_bytes());
        list.extend((self.at as u32).to_le_bytes());
        list.extend([0; 2]);
        self.out.write_all(&list)?;
        self.out.flush()
    }

    fn small(&self, number: u64) -> io::Result<u32> {
        u32::try_from(number).ok().filter(|_| number <= self.most_bytes).ok_or_else(too_large)
    }
}

impl Entry {
    /// What both headers say of a file, from the version that reads it to the length of the extra
    /// field.
    fn described(&self, extra: u16) -> Vec<u8> {
        let mut out = Vec::new();
        // Version 1.0 reads it; names are UTF-8; stored; midnight.
        for number in [10, 1 << 11, 0, 0, DATE] {
            out.extend(u16::to_le_bytes(number));
        }
        for number in [self.crc, self.length, self.length] {
            out.extend(number.to_le_bytes());
        }
        out.extend((self.name.len() as u16).to_le_bytes());
        out.extend(extra.to_le_bytes());
        out
    }
}

fn too_large() -> io::Error {
    io::Error::new(io::ErrorKind::FileTooLarge, "a .usdz holds less than 4 GiB")
}

/// Takes what is written for its length alone.
#[derive(Default)]
pub(super) struct Nowhere {
    at: u64,
    end: u64,
}

impl Write for Nowhere {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.at += bytes.len() as u64;
        self.end = self.end.max(self.at);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl Seek for Nowhere {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        let at = match to {
            SeekFrom::Start(at) => Some(at),
            SeekFrom::Current(by) => self.at.checked_add_signed(by),
            SeekFrom::End(by) => self.end.checked_add_signed(by),
        };
        self.at = at.ok_or(io::ErrorKind::InvalidInput)?;
        Ok(self.at)
    }
}

/// Counts and sums what goes through it.
pub(super) struct Body<W> {
    out: W,
    crc: Hasher,
    length: u64,
}

impl<W: Write> Write for Body<W> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let written = self.out.write(bytes)?;
        self.crc.update(&bytes[..written]);
        self.length += written as u64;
        Ok(written)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.out.flush()
    }
}
