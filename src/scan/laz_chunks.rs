//! The chunks of a LAZ file (Isenburg 2013): each unpacks on its own, so many unpack at a time.
//!
//! The unpacker of the `laz` crate trusts what it reads: a wrong chunk table or layer size makes
//! it allocate gigabytes or panic. So every size is checked here against the bytes there are, and
//! a panic that still happens becomes an error.
//!
//! A sound chunk takes exactly the bytes that the chunk table gives it: the packer pads its end to
//! where the unpacker stops. This tells damage that unpacks to nonsense without an error, and it
//! tells where the next chunk begins when the table is absent or wrong. Chunks in layers (point
//! formats 6–10) state the sizes of their layers, and with them their own.
//!
//! A chunk size in the record of the packing that is not that of the chunks is found out by the chunks
//! themselves, where their table is sound, and so is a table of the other kind, with or without sizes,
//! than the record says.
//!
//! Limits: without a table, chunks of varying size that are not in layers can't be told apart.

use std::cell::Cell;
use std::io::{Cursor, ErrorKind, Read, Seek, SeekFrom};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Once;

use laz::laszip::{ChunkTable, CompressorType};
use laz::record::{
    LayeredPointRecordDecompressor, RecordDecompressor, SequentialPointRecordDecompressor,
};
use laz::{DecompressionSelection, LazItemType, LazVlr};

use super::las_file::{Layout, damaged, io_error};
use crate::diagnostic::Result;

/// Bytes of records unpacked before they are handed on.
const SLAB_BYTES: u64 = 512 << 10;
/// No scan packs more points into a byte; files that do are made to fill the memory.
const MOST_POINTS_PER_BYTE: u64 = 1024;

/// Where one chunk lies and how many points it holds.
#[derive(Debug, Clone, Copy)]
pub(super) struct Chunk {
    pub offset: u64,
    bytes: u64,
    pub points: Points,
}

/// How many points a chunk holds.
#[derive(Debug, Clone, Copy)]
pub(super) enum Points {
    Exactly(u64),
    /// The last chunk's: so many by the header, which may be wrong; as its bytes give, at most
    /// so many.
    Between(u64, u64),
}

impl Points {
    pub fn most(self) -> u64 {
        match self {
            Points::Exactly(n) | Points::Between(_, n) => n,
        }
    }

    fn least(self) -> u64 {
        match self {
            Points::Exactly(n) | Points::Between(n, _) => n,
        }
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Packing {
    /// All points in one chunk, without a table.
    Whole,
    Chunked,
    Layered,
}

pub(super) struct LazChunks {
    vlr: LazVlr,
    packing: Packing,
    /// Points of every chunk but the last; `None` where they vary.
    size: Option<u64>,
    /// As the record has it.
    stated_size: Option<u64>,
    /// Those that the table gives, one behind the other; empty where there is no sound table.
    chunks: Vec<Chunk>,
    /// The chunks of the table end where the table begins.
    pub is_table_whole: bool,
    /// What is wrong with the table.
    pub trouble: Option<String>,
    data_start: u64,
    /// No packed point lies past this.
    data_end: u64,
}

/// What came out of a chunk.
#[derive(Debug, Clone, Copy)]
pub(super) struct Unpacked {
    pub points: u64,
    /// Bytes that they took.
    pub bytes: u64,
    /// The bytes ended before the points did; those given are sound.
    pub is_cut: bool,
}

impl LazChunks {
    /// Reads the chunk table. `record` is the data of the LASzip record.
    ///
    /// # Errors
    /// A packing that is not known or does not fit the point format.
    pub fn read(source: &mut (impl Read + Seek), record: &[u8], layout: &Layout) -> Result<Self> {
        let vlr = LazVlr::from_buffer(record)
            .map_err(|error| damaged(format!("its LAZ packing can't be read: {error}")))?;
        let is_layered = check_items(&vlr, layout)?;
        // The record keeps its compressor to itself, as its first two bytes.
        let compressor = u16::from(record.first().copied().unwrap_or(0));
        let packing = if is_layered {
            Packing::Layered
        } else if compressor == CompressorType::PointWise as u16 {
            Packing::Whole
        } else {
            Packing::Chunked
        };
        let table_place = if packing == Packing::Whole { 0 } else { 8 };
        let size = (!vlr.uses_variable_size_chunks()).then(|| u64::from(vlr.chunk_size()));
        let mut chunks = LazChunks {
            vlr,
            packing,
            size,
            stated_size: size,
            chunks: Vec::new(),
            is_table_whole: false,
            trouble: None,
            data_start: layout.data_offset + table_place,
            data_end: layout.file_bytes,
        };
        if packing == Packing::Whole {
            return Ok(chunks);
        }
        let read = chunks.read_table(source, layout);
        if read.is_err() || !chunks.is_table_whole {
            // A table of the other kind that ends where the chunks do.
            let before = (chunks.size, std::mem::take(&mut chunks.chunks));
            chunks.size = if size.is_some() { None } else { Some(u64::from(u32::MAX)) };
            if chunks.read_table(source, layout).is_err() || !chunks.is_table_whole {
                (chunks.size, chunks.chunks) = before;
                chunks.is_table_whole = false;
                chunks.data_end = layout.file_bytes;
                if let Err(trouble) = read {
                    chunks.chunks.clear();
                    chunks.trouble = Some(trouble);
                }
            }
        }
        let count = layout.point_count;
        let is_odd = |size: u64| {
            let full = chunks.chunks.len().saturating_sub(1) as u64;
            count > 0
                && (full.saturating_mul(size) >= count || (full + 1).saturating_mul(size) < count)
        };
        if chunks.size.is_some_and(is_odd) {
            chunks.measure_size(source, layout)?;
        }
        Ok(chunks)
    }

    /// Finds how many points the chunks hold from themselves, where their table is sound and the size
    /// that is known does not fit them.
    pub fn measure_size(&mut self, source: &mut (impl Read + Seek), layout: &Layout) -> Result<()> {
        /// So many chunks are looked at.
        const LOOKED_AT: usize = 8;
        let (Some(size), true) = (self.size, self.is_table_whole) else { return Ok(()) };
        let full = match &self.chunks[..] {
            [] => return Ok(()),
            [only] => std::slice::from_ref(only),
            [before @ .., _] => before,
        };
        // No chunk has fewer points than this, or more.
        let (mut least, mut most) = (1, u64::from(u32::MAX));
        for chunk in full.iter().step_by(full.len().div_ceil(LOOKED_AT)) {
            let bytes = self.load(source, std::slice::from_ref(chunk))?;
            let of = |points| self.unpack(&bytes, points, |_| {});
            let is_exact = |out: &Unpacked| out.bytes == bytes.len() as u64 && !out.is_cut;
            // One chunk alone may hold fewer points than its size.
            let is_alone = self.chunks.len() == 1;
            let as_known = if is_alone { Points::Between(1, size) } else { Points::Exactly(size) };
            let count = match self.packing {
                Packing::Layered => layered_size(&self.vlr, &bytes).map(|(count, _)| count),
                _ => None,
            };
            if count.is_none_or(|count| count <= size)
                && of(as_known).is_some_and(|out| is_exact(&out))
            {
                return Ok(());
            }
            if let Some(count) = count {
                (least, most) = (least.max(count), most.min(count));
                continue;
            }
            let limit = (bytes.len() as u64 + 1).saturating_mul(MOST_POINTS_PER_BYTE);
            let ends = [1, limit].map(|n| of(Points::Between(n, limit)));
            if let [Some(first), Some(last)] = ends {
                (least, most) = (least.max(first.points), most.min(last.points));
            }
        }
        let is_known = least <= size && (size <= most || self.chunks.len() == 1);
        if is_known || most == u64::from(u32::MAX) || least > most {
            return Ok(());
        }
        // As round as sizes mostly are.
        let round = [50_000, 10_000, 1_000, 100, 10, 1].map(|step| most / step * step);
        let found = round.into_iter().find(|n| *n >= least).unwrap_or(least);
        self.size = Some(found);
        self.set_size(found, layout.point_count);
        Ok(())
    }

    /// What is wrong with the size that the record states.
    pub fn size_trouble(&self) -> Option<String> {
        let words = |size: Option<u64>| match size {
            Some(n) => format!("of {n} points"),
            None => "of varying size".to_owned(),
        };
        // What one chunk has of its own does not tell how others would vary.
        let is_alone = self.chunks.len() == 1 && self.stated_size.is_none();
        (self.size != self.stated_size && !is_alone).then(|| {
            format!(
                "its LAZ chunks are stated to be {} but are {}; they were read as they are",
                words(self.stated_size),
                words(self.size)
            )
        })
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
                    points = points.saturating_add(chunk.points.most());
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

    /// Where the chunks of the table end, and how many points they hold at most.
    pub fn end_of_table_chunks(&self) -> (u64, u64) {
        let end = self.chunks.last().map_or(self.data_start, |last| last.offset + last.bytes);
        (end, self.chunks.iter().map(|chunk| chunk.points.most()).sum())
    }

    /// Whether chunks can be found without a table.
    pub fn can_walk(&self) -> bool {
        self.packing != Packing::Chunked || self.size.is_some()
    }

    /// The packed bytes of the chunk that begins at byte `at`, of a file of which `left` points
    /// are still to come; for chunks that are not in layers, with bytes of those that follow.
    /// `None` where no chunk begins there.
    pub fn load_at(
        &self,
        source: &mut (impl Read + Seek),
        at: u64,
        left: u64,
    ) -> Result<Option<(Vec<u8>, u64)>> {
        let room = self.data_end.saturating_sub(at);
        let size = self.vlr.items_size();
        if left == 0 || room < size {
            return Ok(None);
        }
        source.seek(SeekFrom::Start(at)).map_err(io_error)?;
        let mut bytes = Vec::new();
        if self.packing != Packing::Layered {
            let points = match self.packing {
                Packing::Whole => left,
                _ => left.min(self.size.unwrap_or(left)),
            };
            // Packing at its worst does not double a point.
            let most = points.saturating_mul(2 * size).saturating_add(1024).min(room);
            source.take(most).read_to_end(&mut bytes).map_err(io_error)?;
            let most = (bytes.len() as u64 + 1).saturating_mul(MOST_POINTS_PER_BYTE);
            return Ok(Some((bytes, points.min(most))));
        }
        let head_bytes = size + 4 * (1 + layers(&self.vlr) as u64);
        source.by_ref().take(head_bytes.min(room)).read_to_end(&mut bytes).map_err(io_error)?;
        let Some((count, chunk_bytes)) = layered_size(&self.vlr, &bytes) else { return Ok(None) };
        let full = left.min(self.size.unwrap_or(left));
        // The count may or may not include the first point, which is stored unpacked.
        let points = if count + 1 == full { full } else { count };
        if points == 0 || points > full || chunk_bytes > room {
            return Ok(None);
        }
        let rest = chunk_bytes - bytes.len() as u64;
        source.take(rest).read_to_end(&mut bytes).map_err(io_error)?;
        Ok(Some((bytes, points)))
    }

    /// Whether a damaged chunk still tells where the next one begins.
    pub fn can_skip(&self) -> bool {
        self.packing == Packing::Layered
    }

    /// Unpacks a chunk of the table and hands slabs of whole records to `sink`; the number of
    /// points, or `None` where the chunk is damaged or is not what the table says.
    pub fn unpack_chunk(&self, packed: Packed<'_>, sink: impl FnMut(&[u8])) -> Option<u64> {
        let out = self.unpack(packed.bytes, packed.points, sink)?;
        let is_exact = out.bytes == packed.bytes.len() as u64 && !out.is_cut;
        is_exact.then_some(out.points)
    }

    /// Unpacks the chunk at the start of `bytes`; `None` where it makes no sense.
    pub fn unpack(
        &self,
        bytes: &[u8],
        points: Points,
        mut sink: impl FnMut(&[u8]),
    ) -> Option<Unpacked> {
        let mut points = points;
        if self.packing == Packing::Layered {
            let (count, chunk_bytes) = layered_size(&self.vlr, bytes)?;
            if chunk_bytes > bytes.len() as u64 {
                return None;
            }
            points = match points {
                Points::Exactly(n) if count + 1 < n || count > n => return None,
                Points::Between(_, n) => Points::Exactly(count.clamp(1, n.max(1))),
                exact => exact,
            };
        }
        let most = (bytes.len() as u64 + 1).saturating_mul(MOST_POINTS_PER_BYTE);
        if matches!(points, Points::Exactly(n) if n > most) {
            return None;
        }
        let selection = DecompressionSelection::base()
            .decompress_z()
            .decompress_classification()
            .decompress_flags()
            .decompress_intensity()
            .decompress_rgb();
        let attempt = AssertUnwindSafe(|| {
            let cursor = Cursor::new(bytes);
            if self.packing == Packing::Layered {
                let mut unpacker = LayeredPointRecordDecompressor::new(cursor);
                unpacker.set_fields_from(self.vlr.items()).ok()?;
                unpacker.set_selection(selection);
                run(&mut unpacker, bytes.len() as u64, points, &mut sink)
            } else {
                let mut unpacker = SequentialPointRecordDecompressor::new(cursor);
                unpacker.set_fields_from(self.vlr.items()).ok()?;
                run(&mut unpacker, bytes.len() as u64, points, &mut sink)
            }
        });
        quietly(|| catch_unwind(attempt)).ok().flatten()
    }

    /// Fills `chunks`; what is wrong with the table otherwise.
    fn read_table(
        &mut self,
        source: &mut (impl Read + Seek),
        layout: &Layout,
    ) -> std::result::Result<(), String> {
        let absent = || "absent".to_owned();
        let read_i64 = |source: &mut dyn ReadSeek, at: u64| {
            let mut bytes = [0; 8];
            source.seek(SeekFrom::Start(at)).map_err(|_| absent())?;
            source.read_exact(&mut bytes).map_err(|_| absent())?;
            Ok::<_, String>(u64::try_from(i64::from_le_bytes(bytes)).unwrap_or(0))
        };
        let mut table_at = read_i64(source, layout.data_offset)?;
        if table_at < self.data_start {
            // A writer that could not go back leaves the place at the end of the file.
            table_at = read_i64(source, layout.file_bytes.saturating_sub(8))?;
        }
        if table_at < self.data_start || table_at.saturating_add(8) > layout.file_bytes {
            return Err(absent());
        }
        let data_bytes = table_at - self.data_start;
        // A table takes less than the chunks it tells of; EVLRs may follow it.
        let most = (layout.file_bytes - table_at).min(data_bytes.saturating_add(1 << 16));
        let mut table = Vec::new();
        source.seek(SeekFrom::Start(table_at)).map_err(|_| absent())?;
        source.take(most).read_to_end(&mut table).map_err(|_| absent())?;

        // Each chunk begins with one unpacked point, which bounds their number.
        let chunk_count = match table.get(4..8) {
            Some(&[a, b, c, d]) => u64::from(u32::from_le_bytes([a, b, c, d])),
            _ => return Err(absent()),
        };
        if chunk_count.saturating_mul(self.vlr.items_size()) > data_bytes {
            return Err("wrong: more chunks than the file can hold".into());
        }
        let is_variable = self.size.is_none();
        let entries = quietly(|| {
            catch_unwind(AssertUnwindSafe(|| {
                ChunkTable::read(&mut Cursor::new(table.as_slice()), is_variable)
            }))
        });
        let Ok(Ok(entries)) = entries else { return Err("wrong: it can't be unpacked".into()) };

        let mut offset = self.data_start;
        for entry in &entries {
            let points = self.size.unwrap_or(entry.point_count);
            let end = offset.checked_add(entry.byte_count).filter(|end| *end <= table_at);
            let Some(end) = end else { return Err("wrong: a chunk ends past the data".into()) };
            if points > u64::from(u32::MAX) {
                return Err("wrong: a chunk has more points than can be".into());
            }
            if entry.byte_count > 0 && points > 0 {
                let points = Points::Exactly(points);
                self.chunks.push(Chunk { offset, bytes: entry.byte_count, points });
            }
            offset = end;
        }
        self.is_table_whole = offset == table_at;
        if self.is_table_whole {
            self.data_end = table_at;
        }
        if let Some(size) = self.size {
            self.set_size(size, layout.point_count);
        }
        Ok(())
    }

    /// Makes all chunks but the last hold so many points, and the last what is left of the count.
    fn set_size(&mut self, size: u64, count: u64) {
        let Some((last, before)) = self.chunks.split_last_mut() else { return };
        before.iter_mut().for_each(|chunk| chunk.points = Points::Exactly(size));
        let in_last = count.checked_sub(size.saturating_mul(before.len() as u64));
        let least = in_last.filter(|n| (1..=size).contains(n)).unwrap_or(1);
        last.points = Points::Between(least, size);
    }
}

/// Unpacks points until there are enough, or until the bytes end.
fn run<'a>(
    unpacker: &mut impl RecordDecompressor<Cursor<&'a [u8]>>,
    bytes: u64,
    points: Points,
    sink: &mut impl FnMut(&[u8]),
) -> Option<Unpacked> {
    let size = unpacker.record_size();
    let slab_points = (SLAB_BYTES / size.max(1) as u64).max(1);
    let mut slab = vec![0; (points.most().min(slab_points) as usize) * size];
    let (mut given, mut is_cut, mut is_at_end) = (0, false, false);
    while given < points.most() && !is_cut && !is_at_end {
        let want = (points.most() - given).min(slab_points) as usize;
        let mut got = 0;
        for record in slab.chunks_exact_mut(size).take(want) {
            let begin = unpacker.get().position();
            if let Err(error) = unpacker.decompress_next(record) {
                let is_end = error.kind() == ErrorKind::UnexpectedEof;
                if !is_end || unpacker.get().position() < bytes {
                    return None;
                }
                // A point that begins at the end is one that never was.
                is_at_end = begin == bytes && matches!(points, Points::Between(..));
                is_cut = !is_at_end;
                break;
            }
            got += 1;
            let is_varying = matches!(points, Points::Between(..));
            if is_varying
                && given + got as u64 >= points.least()
                && unpacker.get().position() >= bytes
            {
                is_at_end = true;
                break;
            }
        }
        sink(slab.get(..got * size)?);
        given += got as u64;
    }
    Some(Unpacked { points: given, bytes: unpacker.get().position(), is_cut })
}

thread_local! {
    static IS_QUIET: Cell<bool> = const { Cell::new(false) };
}

/// Runs `work` without a panic in it being told on the terminal.
fn quietly<T>(work: impl FnOnce() -> T) -> T {
    static HOOK: Once = Once::new();
    HOOK.call_once(|| {
        let told = std::panic::take_hook();
        std::panic::set_hook(Box::new(move |panic| {
            if !IS_QUIET.get() {
                told(panic);
            }
        }));
    });
    let was_quiet = IS_QUIET.replace(true);
    let out = work();
    IS_QUIET.set(was_quiet);
    out
}

/// One chunk's packed bytes.
#[derive(Clone, Copy)]
pub(super) struct Packed<'a> {
    bytes: &'a [u8],
    pub points: Points,
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

trait ReadSeek: Read + Seek {}
impl<T: Read + Seek> ReadSeek for T {}

/// Layers of a chunk.
fn layers(vlr: &LazVlr) -> usize {
    vlr.items()
        .iter()
        .map(|item| match item.item_type() {
            LazItemType::Point14 => 9,
            LazItemType::RGBNIR14 => 2,
            LazItemType::Byte14(n) => usize::from(n),
            _ => 1,
        })
        .sum()
}

/// The count and the bytes that a chunk in layers states at its start; `None` where it is cut.
fn layered_size(vlr: &LazVlr, bytes: &[u8]) -> Option<(u64, u64)> {
    let head = vlr.items_size() as usize;
    let end = head + 4 * (1 + layers(vlr));
    let mut numbers = bytes
        .get(head..end)?
        .chunks_exact(4)
        .map(|b| u64::from(u32::from_le_bytes([b[0], b[1], b[2], b[3]])));
    let count = numbers.next()?;
    Some((count, end as u64 + numbers.sum::<u64>()))
}
