//! The chunks of a LAZ file (Isenburg 2013): each unpacks on its own, so many unpack at a time.
//!
//! The unpacker of the `laz` crate trusts what it reads: a wrong chunk table or layer size makes
//! it allocate gigabytes or panic. So every size is checked here against the bytes there are, and
//! a panic that still happens becomes an error.

use std::io::{Cursor, Read, Seek, SeekFrom};
use std::panic::{AssertUnwindSafe, catch_unwind};

use laz::laszip::{ChunkTable, CompressorType};
use laz::record::{
    LayeredPointRecordDecompressor, RecordDecompressor, SequentialPointRecordDecompressor,
};
use laz::{DecompressionSelection, LazItemType, LazVlr};

use super::las_file::{Layout, damaged, io_error};
use crate::diagnostic::{Error, Result};

/// Bytes of records unpacked before they are handed on.
const SLAB_BYTES: u64 = 512 << 10;

/// Where one chunk lies and how many points it holds.
#[derive(Debug, Clone, Copy)]
pub(super) struct Chunk {
    offset: u64,
    bytes: u64,
    points: u64,
}

pub(super) struct LazChunks {
    vlr: LazVlr,
    is_layered: bool,
    chunks: Vec<Chunk>,
}

impl LazChunks {
    /// Reads the chunk table. `record` is the data of the LASzip record.
    pub fn read(source: &mut (impl Read + Seek), record: &[u8], layout: &Layout) -> Result<Self> {
        let vlr = LazVlr::from_buffer(record)
            .map_err(|error| damaged(format!("its LAZ packing can't be read: {error}")))?;
        let is_layered = check_items(&vlr, layout)?;
        // The record keeps its compressor to itself, as its first two bytes.
        let compressor = record.first().copied().unwrap_or(0);
        let chunks = if u16::from(compressor) == CompressorType::PointWise as u16 {
            let offset = layout.data_offset;
            let bytes = layout.file_bytes - offset;
            vec![Chunk { offset, bytes, points: layout.point_count }]
        } else {
            read_table(source, &vlr, layout)?
        };
        Ok(LazChunks { vlr, is_layered, chunks })
    }

    /// Runs of chunks of at least one chunk and otherwise at most `unpacked_bytes`.
    pub fn batches(&self, unpacked_bytes: u64) -> impl Iterator<Item = &[Chunk]> {
        let size = self.vlr.items_size().max(1);
        let mut rest = self.chunks.as_slice();
        std::iter::from_fn(move || {
            let mut points = 0u64;
            let n = rest
                .iter()
                .take_while(|chunk| {
                    points = points.saturating_add(chunk.points);
                    points.saturating_mul(size) <= unpacked_bytes
                })
                .count()
                .max(1)
                .min(rest.len());
            let (batch, others) = rest.split_at(n);
            rest = others;
            (!batch.is_empty()).then_some(batch)
        })
    }

    /// The packed bytes of each chunk of a batch; chunks of a batch follow each other.
    pub fn load(&self, source: &mut (impl Read + Seek), batch: &[Chunk]) -> Result<Vec<u8>> {
        let (Some(first), Some(last)) = (batch.first(), batch.last()) else {
            return Ok(Vec::new());
        };
        let mut bytes = vec![0; (last.offset + last.bytes - first.offset) as usize];
        source.seek(SeekFrom::Start(first.offset)).map_err(io_error)?;
        source.read_exact(&mut bytes).map_err(io_error)?;
        Ok(bytes)
    }

    /// Unpacks a chunk and hands slabs of whole records to `sink`.
    pub fn decode(&self, packed: Packed<'_>, mut sink: impl FnMut(&[u8])) -> Result<()> {
        let Packed { bytes, points } = packed;
        if self.is_layered && !layers_fit(&self.vlr, bytes, points) {
            return Err(damaged("a LAZ chunk's layers do not fit the chunk"));
        }
        let unpack = || -> std::result::Result<(), laz::LasZipError> {
            let mut unpacker: Box<dyn RecordDecompressor<Cursor<&[u8]>>> = if self.is_layered {
                Box::new(LayeredPointRecordDecompressor::new(Cursor::new(bytes)))
            } else {
                Box::new(SequentialPointRecordDecompressor::new(Cursor::new(bytes)))
            };
            unpacker.set_fields_from(self.vlr.items())?;
            unpacker.set_selection(
                DecompressionSelection::base()
                    .decompress_z()
                    .decompress_classification()
                    .decompress_flags()
                    .decompress_intensity()
                    .decompress_rgb(),
            );
            let size = self.vlr.items_size();
            let slab_points = (SLAB_BYTES / size).max(1);
            let mut slab = vec![0; (points.min(slab_points) * size) as usize];
            let mut left = points;
            while left > 0 {
                let n = left.min(slab_points);
                slab.truncate((n * size) as usize);
                unpacker.decompress_many(&mut slab)?;
                sink(&slab);
                left -= n;
            }
            Ok(())
        };
        match catch_unwind(AssertUnwindSafe(unpack)) {
            Ok(Ok(())) => Ok(()),
            Ok(Err(error)) => Err(damaged(format!("a LAZ chunk can't be unpacked: {error}"))),
            Err(_) => Err(damaged("a LAZ chunk can't be unpacked: its bytes make no sense")),
        }
    }
}

/// One chunk's packed bytes.
#[derive(Clone, Copy)]
pub(super) struct Packed<'a> {
    bytes: &'a [u8],
    points: u64,
}

/// Pairs the chunks of a batch with their bytes.
pub(super) fn packed<'a>(batch: &[Chunk], bytes: &'a [u8]) -> Vec<Packed<'a>> {
    let start = batch.first().map_or(0, |chunk| chunk.offset);
    batch
        .iter()
        .map(|chunk| {
            let from = (chunk.offset - start) as usize;
            let bytes = bytes.get(from..from + chunk.bytes as usize).unwrap_or_default();
            Packed { bytes, points: chunk.points }
        })
        .collect()
}

/// Refuses items that don't make up the record; true where the items are packed in layers.
fn check_items(vlr: &LazVlr, layout: &Layout) -> Result<bool> {
    let unsound = || damaged("its LAZ packing does not fit its point format");
    let mut layered = 0;
    for item in vlr.items() {
        let (size, is_layered) = match item.item_type() {
            LazItemType::Point10 => (20, false),
            LazItemType::GpsTime => (8, false),
            LazItemType::RGB12 => (6, false),
            LazItemType::WavePacket13 => (29, false),
            LazItemType::Byte(n) => (n, false),
            LazItemType::Point14 => (30, true),
            LazItemType::RGB14 => (6, true),
            LazItemType::RGBNIR14 => (8, true),
            LazItemType::WavePacket14 => (29, true),
            LazItemType::Byte14(n) => (n, true),
        };
        let versions = if is_layered { 3..=4 } else { 1..=2 };
        if item.size() != size || size == 0 || !versions.contains(&item.version()) {
            return Err(unsound());
        }
        layered += usize::from(is_layered);
    }
    let bytes: usize = vlr.items().iter().map(|item| usize::from(item.size())).sum();
    let first = vlr.items().first().map(|item| item.item_type());
    let expected = if layout.is_extended { LazItemType::Point14 } else { LazItemType::Point10 };
    if first != Some(expected)
        || bytes != layout.record_bytes
        || (layered != 0 && layered != vlr.items().len())
    {
        return Err(unsound());
    }
    Ok(layered > 0)
}

fn read_table(
    source: &mut (impl Read + Seek),
    vlr: &LazVlr,
    layout: &Layout,
) -> Result<Vec<Chunk>> {
    let missing =
        || damaged("has no chunk table: the file was cut short, or its writing was interrupted");
    let data = layout.data_offset + 8;
    let read_i64 = |source: &mut dyn ReadSeek, at: u64| -> Result<u64> {
        let mut bytes = [0; 8];
        source.seek(SeekFrom::Start(at)).map_err(io_error)?;
        source.read_exact(&mut bytes).map_err(|_| missing())?;
        Ok(u64::try_from(i64::from_le_bytes(bytes)).unwrap_or(0))
    };
    let mut table_at = read_i64(source, layout.data_offset)?;
    if table_at < data {
        // A writer that could not go back leaves the place at the end of the file.
        table_at = read_i64(source, layout.file_bytes.saturating_sub(8))?;
    }
    if table_at < data || table_at.saturating_add(8) > layout.file_bytes {
        return Err(missing());
    }
    let mut table = Vec::new();
    source.seek(SeekFrom::Start(table_at)).map_err(io_error)?;
    source.take(layout.file_bytes - table_at).read_to_end(&mut table).map_err(io_error)?;

    // Each chunk begins with one unpacked point, which bounds their number.
    let wrong = |what: &str| damaged(format!("its LAZ chunk table is wrong: {what}"));
    let data_bytes = table_at - data;
    let chunk_count = match table.get(4..8) {
        Some(&[a, b, c, d]) => u64::from(u32::from_le_bytes([a, b, c, d])),
        _ => return Err(missing()),
    };
    if chunk_count.saturating_mul(vlr.items_size()) > data_bytes {
        return Err(wrong("more chunks than the file can hold"));
    }
    let is_variable = vlr.uses_variable_size_chunks();
    let entries = catch_unwind(AssertUnwindSafe(|| {
        ChunkTable::read(&mut Cursor::new(table.as_slice()), is_variable)
    }))
    .map_err(|_| wrong("its bytes make no sense"))?
    .map_err(|error| wrong(&error.to_string()))?;

    let mut chunks = Vec::with_capacity(entries.len());
    let (mut offset, mut left) = (data, layout.point_count);
    for entry in &entries {
        if left == 0 {
            break;
        }
        let points = if is_variable { entry.point_count } else { u64::from(vlr.chunk_size()) };
        let points = points.min(left);
        let end = offset.checked_add(entry.byte_count).filter(|end| *end <= table_at);
        let Some(end) = end else { return Err(wrong("a chunk ends past the data")) };
        if points > 0 {
            chunks.push(Chunk { offset, bytes: entry.byte_count, points });
        }
        offset = end;
        left -= points;
    }
    if left > 0 {
        return Err(Error::new(format!(
            "the header promises {} points but the file holds at most {}",
            layout.point_count,
            layout.point_count - left
        ))
        .remedy("copy or download the file again; it is damaged or was cut short"));
    }
    Ok(chunks)
}

trait ReadSeek: Read + Seek {}
impl<T: Read + Seek> ReadSeek for T {}

/// Whether a layered chunk holds at least `points` points and its layers lie inside it.
fn layers_fit(vlr: &LazVlr, bytes: &[u8], points: u64) -> bool {
    let layers: usize = vlr
        .items()
        .iter()
        .map(|item| match item.item_type() {
            LazItemType::Point14 => 9,
            LazItemType::RGBNIR14 => 2,
            LazItemType::Byte14(n) => usize::from(n),
            _ => 1,
        })
        .sum();
    let head = vlr.items_size() as usize;
    let Some(numbers) = bytes.get(head..head + 4 * (1 + layers)) else { return false };
    let mut numbers =
        numbers.chunks_exact(4).map(|b| u64::from(u32::from_le_bytes([b[0], b[1], b[2], b[3]])));
    let count = numbers.next().unwrap_or(0);
    let layer_bytes: u64 = numbers.sum();
    // The count may or may not include the first point, which is stored unpacked.
    count + 1 >= points && (head + 4 * (1 + layers)) as u64 + layer_bytes <= bytes.len() as u64
}
