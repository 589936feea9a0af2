//! LAS 1.0–1.4 and LAZ (ASPRS LAS 1.4 R15; Isenburg 2013 for LASzip).
//!
//! Header fields are checked against the length of the file before anything is allocated or
//! skipped by them, and the header's own bounds are never used: they are often wrong. What is
//! damaged is left out and told as long as sound points remain: a file cut short gives the points
//! before the cut, a LAZ file its sound chunks, also where its chunk table is absent or wrong.
//! Waveform packets are not read, their points are.

use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::Path;

use glam::DVec3;
use rayon::prelude::*;

use super::crs::{self, Records};
use super::laz_chunks::{self, LazChunks, Packed, Points};
use super::part::{ColourScale, Columns, Coordinates, Part, world_from_steps};
use super::{ReadOptions, Removed};
use crate::diagnostic::{Error, Result};
use crate::frame::Crs;

/// Bytes of point records in memory at a time.
const BATCH_BYTES: u64 = 32 << 20;
/// Bytes of the header of LAS 1.0.
const OLDEST_HEADER: u64 = 227;
/// A system's description is never longer.
const LONGEST_RECORD: u64 = 1 << 20;
const DAMAGED: &str = "copy or download the file again; it is damaged or was cut short";

/// What is needed of the header, checked.
pub(super) struct Layout {
    pub file_bytes: u64,
    pub data_offset: u64,
    /// As the header has it; 0 where its writer was interrupted.
    pub point_count: u64,
    /// No point lies past this.
    data_end: u64,
    pub record_bytes: usize,
    /// Point format 6 or higher.
    pub is_extended: bool,
    /// Offset of the colour in a record.
    rgb_at: Option<usize>,
    scale: DVec3,
    offset: DVec3,
}

/// Points on their way from a file to where they are kept.
pub(super) struct Batch {
    pub coordinates: Coordinates,
    pub columns: Columns,
}

/// Takes the points of a file in place of [`Part`], in the file's order.
pub(super) type Sink<'a> = &'a mut (dyn FnMut(Option<&Crs>, Batch) -> Result<()> + Send);

/// Reads one file, which is in this system where it states none; with a sink the part that is returned
/// holds no points.
pub(super) fn read(
    path: &Path,
    options: &ReadOptions,
    crs: &Option<Crs>,
    sink: Option<Sink<'_>>,
) -> Result<Part> {
    read_inner(path, options, crs, sink).map_err(|error| error.in_file(path))
}

/// Points that the headers of LAS files promise; files that are none, or say nothing sound, count
/// for nothing here.
pub fn stated_points(paths: &[std::path::PathBuf]) -> u64 {
    let of = |path: &Path| -> Option<u64> {
        let file = File::open(path).ok()?;
        let file_bytes = file.metadata().ok()?.len();
        let header = las::raw::Header::read_from(BufReader::new(file)).ok()?;
        // Packed to less than a byte a point is no scan.
        Some(layout(&header, file_bytes).ok()?.point_count.min(file_bytes))
    };
    paths.iter().filter_map(|path| of(path)).fold(0, u64::saturating_add)
}

pub(super) fn io_error(error: std::io::Error) -> Error {
    if error.kind() == std::io::ErrorKind::UnexpectedEof {
        Error::new("the file ends early").remedy(DAMAGED)
    } else {
        Error::new(format!("can't be read: {error}")).remedy("check the file and its permissions")
    }
}

pub(super) fn damaged(what: impl Into<String>) -> Error {
    Error::new(what).remedy(DAMAGED)
}

fn read_inner(
    path: &Path,
    options: &ReadOptions,
    crs: &Option<Crs>,
    sink: Option<Sink<'_>>,
) -> Result<Part> {
    let file = File::open(path).map_err(io_error)?;
    let file_bytes = file.metadata().map_err(io_error)?.len();
    let mut source = BufReader::with_capacity(1 << 16, file);
    let header = las::raw::Header::read_from(&mut source).map_err(header_error)?;
    let is_laz = header.point_data_record_format & 0x80 != 0;
    let layout = layout(&header, file_bytes)?;

    let mut warnings = Vec::new();
    let (records, laz_record) = records(&header, &layout, &mut source, &mut warnings)?;
    let mut stated = crs::parse(&records, header.global_encoding & 16 != 0)?;
    warnings.extend(stated.warnings);
    match (&stated.crs, crs) {
        (None, _) => stated.crs.clone_from(crs),
        (Some(own), Some(asked)) if own.epsg != asked.epsg => {
            let own = own.epsg.map_or("another system".into(), |code| format!("EPSG:{code}"));
            let asked = asked.epsg.map_or(String::new(), |code| format!("EPSG:{code} "));
            warnings.push(format!("it states {own}, which goes before the {asked}of --crs"));
        }
        _ => {}
    }

    let mut decoded = Gathered::new(&layout, stated.crs.clone(), sink);
    let told = match laz_record {
        Some(record) if is_laz => decode_laz(&mut source, &record, &layout, options, &mut decoded)?,
        None if is_laz => {
            return Err(damaged("the header says LAZ but no record tells how it is packed"));
        }
        _ => decode_plain(&mut source, &header, &layout, options, &mut decoded)?,
    };
    let found = decoded.kept + decoded.all.removed.total();
    warnings.extend(told);
    count_warning(found, layout.point_count, &mut warnings)?;
    if decoded.all.repaired > 0 {
        let repaired = decoded.all.repaired;
        warnings.push(format!("{repaired} return numbers outside 1..=count were repaired"));
    }
    let version = header.version;
    if version.major != 1 || version.minor > 4 {
        let version = format!("{}.{}", version.major, version.minor);
        warnings.push(format!("it says that it is LAS {version}: it was read as LAS 1.4"));
    }
    if layout.scale.min_element() < 0.0 {
        let scale = layout.scale.to_array();
        warnings.push(format!("its scale {scale:?} is negative: coordinates are mirrored"));
    }
    let bounds = decoded.bounds();
    warnings.extend(wrong_header(&header, &layout, &decoded));
    let colour = ColourScale::of(decoded.all.brightest);
    let Decoded { steps, mut columns, removed, .. } = decoded.all;
    colour.apply(&mut columns.rgb);
    Ok(Part {
        path: path.to_path_buf(),
        crs: stated.crs,
        in_degrees: stated.in_degrees,
        coordinates: Coordinates::Scaled { steps, scale: layout.scale, offset: layout.offset },
        columns,
        bounds,
        colour,
        in_file: found,
        removed,
        warnings,
    })
}

/// Compares the points found with those promised.
fn count_warning(found: u64, promised: u64, warnings: &mut Vec<String>) -> Result<()> {
    if found == 0 && promised > 0 {
        let why = warnings.last().map_or(String::new(), |why| format!(": {why}"));
        return Err(damaged(format!("none of its {promised} points can be read{why}")));
    }
    if found < promised {
        warnings.push(format!(
            "the header promises {promised} points; {} of them are lost, {found} were read",
            promised - found
        ));
    } else if found > promised {
        warnings.push(format!(
            "the header promises {promised} points but {found} are there; all were read"
        ));
    }
    Ok(())
}

/// Whether a point lies outside what the header states. Points left out count as inside.
fn bounds_are_wrong(header: &las::raw::Header, layout: &Layout, bounds: (DVec3, DVec3)) -> bool {
    let ends = [bounds.0, bounds.1];
    let stated_min = DVec3::new(header.min_x, header.min_y, header.min_z);
    let stated_max = DVec3::new(header.max_x, header.max_y, header.max_z);
    // Writers round them.
    let slack = 2.0 * layout.scale.abs() + DVec3::splat(0.01);
    let is_inside =
        |p: DVec3| p.cmpge(stated_min - slack).all() && p.cmple(stated_max + slack).all();
    !ends.into_iter().all(is_inside)
}

/// What the bounds in the header and those of the points say against each other.
fn wrong_header(
    header: &las::raw::Header,
    layout: &Layout,
    decoded: &Gathered<'_>,
) -> Option<String> {
    let (kept, all) = (decoded.bounds()?, decoded.bounds_of_all()?);
    let stated = (
        DVec3::new(header.min_x, header.min_y, header.min_z),
        DVec3::new(header.max_x, header.max_y, header.max_z),
    );
    let is_complete = decoded.kept + decoded.all.removed.total() >= layout.point_count;
    let wrong = || wrong_scale(layout, stated, all).or_else(|| wrong_scale(layout, stated, kept));
    if let Some((times, axes)) = is_complete.then(wrong).flatten() {
        let named = |k: &usize| ["x", "y", "z"][*k];
        let names: Vec<&str> = axes.iter().map(named).collect();
        let scale = layout.scale.to_array();
        let right: Vec<f64> = axes.iter().map(|&k| rounded(scale[k] / times)).collect();
        let is: Vec<f64> = axes.iter().map(|&k| scale[k]).collect();
        return Some(format!(
            "its points are spread {} times as far in {} as the bounds in its header: if these are \
             right, its scale is wrong, and so are all sizes; export it anew with a scale of {right:?} \
             there in place of {is:?}",
            rounded(times),
            names.join(", ")
        ));
    }
    if bounds_are_wrong(header, layout, kept) {
        return Some("the bounds in its header are wrong; those of its points are used".into());
    }
    /// Of what is cut out of a larger file, with its header.
    const MOST_TIMES: f64 = 10.0;
    const MOST_BEYOND: f64 = 1000.0;
    let room = MOST_TIMES * (all.1 - all.0) + DVec3::splat(MOST_BEYOND);
    (stated.1 - stated.0).cmpgt(room).any().then(|| {
        let size = |v: DVec3| v.to_array().map(|v| if v < 1e6 { v.round() } else { rounded(v) });
        format!(
            "the bounds in its header span {:?}, its points {:?}: those of its points are used",
            size(stated.1 - stated.0),
            size(all.1 - all.0)
        )
    })
}

/// To four digits.
fn rounded(value: f64) -> f64 {
    format!("{value:.3e}").parse().unwrap_or(value)
}

/// How many times as far from the offset as the header says the points lie along some axes, and which:
/// the same factor along each, and the rest as the header says. Where the header's offset does not fit,
/// powers of ten by the spread alone.
fn wrong_scale(
    layout: &Layout,
    (stated_low, stated_high): (DVec3, DVec3),
    (low, high): (DVec3, DVec3),
) -> Option<(f64, Vec<usize>)> {
    /// Of a factor that is none, and between axes.
    const LIKE: f64 = 0.01;
    /// Factors that come of units and digits: believed though the header's bounds begin at its offset,
    /// where any other, of a single axis, may come of points that are not there.
    const USUAL: [f64; 4] = [2.0, 3.280_84, 12.0, 39.370_1];
    let power = |times: f64| 10f64.powf(times.log10().round());
    let is_like = |a: f64, b: f64| (a / b - 1.0).abs() < LIKE;
    let is_usual = |times: f64| {
        let usual = USUAL.into_iter().flat_map(|u| [u, 1.0 / u]);
        (1e-6..=1e6).contains(&times) && usual.chain([power(times)]).any(|u| is_like(times, u))
    };
    let mut scaled: Vec<(usize, f64)> = Vec::new();
    let (mut by_spread, mut fits, mut is_told) = (Vec::new(), true, false);
    for k in 0..3 {
        // Writers round the bounds.
        let slack = 2.0 * layout.scale[k].abs() + 0.01;
        let (stated, found) = (stated_high[k] - stated_low[k], high[k] - low[k]);
        let is_near = |a: f64, b: f64| (a - b).abs() <= slack;
        if is_near(low[k], stated_low[k]) && is_near(high[k], stated_high[k]) {
            continue;
        }
        let times = found / stated;
        let lever = (stated_low[k] - layout.offset[k]).abs();
        let room = slack * (1.0 + times) + 2.0 * slack * times * lever / stated;
        let expected = layout.offset[k] + times * (stated_low[k] - layout.offset[k]);
        let is_specific = lever * (times - 1.0).abs() > 10.0 * room;
        if stated > 4.0 * slack && (expected - low[k]).abs() <= room && !is_like(times, 1.0) {
            is_told |= is_specific || is_usual(times) || !scaled.is_empty();
            scaled.push((k, times));
        } else {
            fits = false;
        }
        if is_like(times, power(times)) && !is_like(times, 1.0) && is_usual(times) {
            by_spread.push((k, power(times)));
        }
    }
    let is_one = |all: &[(usize, f64)]| all.iter().all(|(_, times)| is_like(*times, all[0].1));
    let found = if fits && is_told && is_one(&scaled) { scaled } else { by_spread };
    // The longest axis tells the factor most exactly.
    let longest = found.iter().max_by(|a, b| {
        let length = |k: usize| stated_high[k] - stated_low[k];
        length(a.0).total_cmp(&length(b.0))
    })?;
    let times = if is_like(longest.1, power(longest.1)) { power(longest.1) } else { longest.1 };
    let of_times = found.iter().filter(|(_, t)| is_like(*t, times));
    Some((times, of_times.map(|(k, _)| *k).collect()))
}

/// Unpacks a batch of chunks at a time, each chunk on its own; gives what the user should know.
fn decode_laz(
    source: &mut (impl Read + Seek),
    laz_record: &[u8],
    layout: &Layout,
    options: &ReadOptions,
    decoded: &mut Gathered<'_>,
) -> Result<Vec<String>> {
    let mut chunks = LazChunks::read(source, laz_record, layout)?;
    if let Some(told) = decode_chunks(source, &chunks, layout, options, decoded, true)? {
        return Ok(told);
    }
    // It may be that all others fail for the same reason.
    chunks.measure_size(source, layout)?;
    Ok(decode_chunks(source, &chunks, layout, options, decoded, false)?.unwrap_or_default())
}

/// As [`decode_laz`]; `None`, and nothing decoded, where the first chunk of a sound table fails and
/// `is_first_needed`.
fn decode_chunks(
    source: &mut (impl Read + Seek),
    chunks: &LazChunks,
    layout: &Layout,
    options: &ReadOptions,
    decoded: &mut Gathered<'_>,
    is_first_needed: bool,
) -> Result<Option<Vec<String>>> {
    let mut damaged_chunks = 0u64;
    let (mut walk_from, held) = chunks.end_of_table_chunks();
    let mut left = layout.point_count.saturating_sub(held);
    if layout.point_count == 0 {
        left = u64::MAX;
    }
    let mut table_is_wrong = chunks.trouble.is_some();
    let mut passed = 0;
    let unpack = |packed: Vec<Packed<'_>>| -> Vec<Option<Decoded>> {
        let unpack_one = |chunk: Packed<'_>| {
            let mut part = Decoded::with_room(chunk.points.most(), layout);
            chunks.unpack_chunk(chunk, |slab| part.push(slab, layout, options))?;
            Some(part)
        };
        packed.into_par_iter().with_max_len(1).map(unpack_one).collect()
    };
    // One batch unpacks while the points of the one before it are taken.
    let mut waiting: Vec<Decoded> = Vec::new();
    'table: for batch in chunks.batches(BATCH_BYTES) {
        let bytes = chunks.load(source, batch)?;
        let before = std::mem::take(&mut waiting);
        let (taken, parts) = rayon::join(
            || before.into_iter().try_for_each(|part| decoded.append(part)),
            || unpack(laz_chunks::packed(batch, &bytes)),
        );
        taken?;
        let is_sound: Vec<bool> = parts.iter().map(Option::is_some).collect();
        for (i, (chunk, part)) in batch.iter().zip(parts).enumerate() {
            match part {
                Some(part) => waiting.push(part),
                None if is_first_needed && passed == 0 && chunks.is_table_whole => return Ok(None),
                // A table that is right about the next chunk, or about where all of them end, is
                // right about this one.
                None if chunks.is_table_whole || is_sound.get(i + 1) == Some(&true) => {
                    damaged_chunks += 1;
                }
                None => {
                    table_is_wrong = true;
                    walk_from = chunk.offset;
                    left = match layout.point_count {
                        0 => u64::MAX,
                        count => count.saturating_sub(passed),
                    };
                    break 'table;
                }
            }
            passed += chunk.points.most();
        }
    }
    waiting.into_iter().try_for_each(|part| decoded.append(part))?;
    let mut told: Vec<String> = chunks.size_trouble().into_iter().collect();
    // A table that holds too few points and does not reach the end of the data.
    table_is_wrong |= !chunks.is_table_whole && held > 0 && left > 0;
    if table_is_wrong {
        let trouble = chunks.trouble.as_deref().unwrap_or("wrong");
        if !chunks.can_walk() && decoded.kept == 0 {
            return Err(damaged(format!(
                "its LAZ chunk table is {trouble}, without which chunks of varying size can't be read"
            )));
        }
        told.push(format!(
            "its LAZ chunk table is {trouble}; its chunks were looked for one by one"
        ));
    }
    if !chunks.is_table_whole && chunks.can_walk() {
        damaged_chunks += walk(source, chunks, walk_from, left, layout, options, decoded)?;
    }
    if damaged_chunks > 0 {
        told.push(format!("{damaged_chunks} of its LAZ chunks are damaged and were left out"));
    }
    Ok(Some(told))
}

/// Unpacks chunk after chunk from byte `at` on, each beginning where the one before ended, until
/// `left` points are read or no sound chunk follows; gives the number of those skipped. Of a chunk
/// cut by the end of the file the points before the cut are taken.
fn walk(
    source: &mut (impl Read + Seek),
    chunks: &LazChunks,
    mut at: u64,
    mut left: u64,
    layout: &Layout,
    options: &ReadOptions,
    decoded: &mut Gathered<'_>,
) -> Result<u64> {
    let mut skipped = 0;
    while let Some((bytes, points)) = chunks.load_at(source, at, left)? {
        let mut part = Decoded::default();
        let unpacked =
            chunks.unpack(&bytes, Points::Exactly(points), |slab| part.push(slab, layout, options));
        let taken = match unpacked {
            Some(unpacked) => {
                decoded.append(part)?;
                if unpacked.is_cut {
                    break;
                }
                unpacked.bytes
            }
            None if chunks.can_skip() => {
                skipped += 1;
                bytes.len() as u64
            }
            None => break,
        };
        at += taken;
        if left < u64::MAX {
            left -= points;
        }
    }
    Ok(skipped)
}

fn decode_plain(
    source: &mut (impl Read + Seek),
    header: &las::raw::Header,
    layout: &Layout,
    options: &ReadOptions,
    decoded: &mut Gathered<'_>,
) -> Result<Vec<String>> {
    let record_bytes = layout.record_bytes as u64;
    let room = layout.data_end.saturating_sub(layout.data_offset) / record_bytes;
    let goes_on = layout.point_count == 0 || goes_on(source, header, layout, room)?;
    source.seek(SeekFrom::Start(layout.data_offset)).map_err(io_error)?;
    let batch = (BATCH_BYTES / record_bytes).max(1);
    let mut slab = Vec::new();
    let mut left = if goes_on { room } else { layout.point_count.min(room) };
    while left > 0 {
        let n = left.min(batch);
        slab.resize((n * record_bytes) as usize, 0);
        source.read_exact(&mut slab).map_err(io_error)?;
        let parts: Vec<Decoded> = slab
            .par_chunks(layout.record_bytes * 65_536)
            .map(|slab| {
                let mut part = Decoded::default();
                part.push(slab, layout, options);
                part
            })
            .collect();
        parts.into_iter().try_for_each(|part| decoded.append(part))?;
        left -= n;
    }
    let spare = room.saturating_sub(layout.point_count);
    Ok(if !goes_on && spare > 0 {
        vec![format!(
            "bytes for {spare} more points follow those the header promises; they are not read"
        )]
    } else {
        Vec::new()
    })
}

/// Whether what follows the points that the header promises are points too: whole records, the first
/// and the last of them within the bounds that it states.
fn goes_on(
    source: &mut (impl Read + Seek),
    header: &las::raw::Header,
    layout: &Layout,
    room: u64,
) -> Result<bool> {
    let record_bytes = layout.record_bytes as u64;
    let bytes = layout.data_end.saturating_sub(layout.data_offset);
    if room <= layout.point_count || !bytes.is_multiple_of(record_bytes) {
        return Ok(false);
    }
    for number in [layout.point_count, room - 1] {
        let mut head = [0u8; 12];
        source
            .seek(SeekFrom::Start(layout.data_offset + number * record_bytes))
            .and_then(|_| source.read_exact(&mut head))
            .map_err(io_error)?;
        let step = |k: usize| i32::from_le_bytes([head[k], head[k + 1], head[k + 2], head[k + 3]]);
        let place = world_from_steps([step(0), step(4), step(8)], layout.scale, layout.offset);
        if bounds_are_wrong(header, layout, (place, place)) {
            return Ok(false);
        }
    }
    Ok(true)
}

fn header_error(error: las::Error) -> Error {
    match error {
        las::Error::InvalidFileSignature(_) => {
            Error::new("is no LAS or LAZ file: it does not begin with LASF")
                .remedy("give a scan in LAS, LAZ or plain x y z text (.xyz, .txt, .asc, .pts)")
        }
        las::Error::Io(error) => io_error(error),
        other => damaged(format!("the header can't be read: {other}")),
    }
}

fn layout(header: &las::raw::Header, file_bytes: u64) -> Result<Layout> {
    let format = header.point_data_record_format & 0x3f;
    let shortest = match format {
        0 => 20,
        1 => 28,
        2 => 26,
        3 => 34,
        4 => 57,
        5 => 63,
        6 => 30,
        7 => 36,
        8 => 38,
        9 => 59,
        10 => 67,
        _ => {
            return Err(Error::new(format!("point format {format} does not exist"))
                .remedy("point formats 0 to 10 are read; check that this is a LAS 1.0–1.4 file"));
        }
    };
    let record_bytes = usize::from(header.point_data_record_length);
    if record_bytes < shortest {
        return Err(damaged(format!(
            "its points have {record_bytes} bytes where point format {format} needs {shortest}"
        )));
    }
    // The old 32-bit count is the fallback: many writers of 1.4 fill in both, some only that.
    let point_count = match header.large_file.map(|large| large.number_of_point_records) {
        Some(count) if count > 0 => count,
        _ => u64::from(header.number_of_point_records),
    };
    let data_offset = u64::from(header.offset_to_point_data);
    if data_offset < u64::from(header.header_size) || data_offset > file_bytes {
        return Err(damaged(format!(
            "its points should begin at byte {data_offset} of {file_bytes}"
        )));
    }
    // What a file holds behind its points.
    let behind = [
        header.evlr.map(|evlr| evlr.start_of_first_evlr),
        header.start_of_waveform_data_packet_record,
    ];
    let data_end =
        behind.into_iter().flatten().filter(|at| *at > data_offset).fold(file_bytes, u64::min);
    let scale = DVec3::new(header.x_scale_factor, header.y_scale_factor, header.z_scale_factor);
    let offset = DVec3::new(header.x_offset, header.y_offset, header.z_offset);
    let reach = scale.abs() * f64::from(i32::MAX) + offset.abs();
    // An offset so large that neighbouring f64 values lie farther apart than points.
    let is_coarse = (offset.abs() * f64::EPSILON).cmpgt(scale.abs()).any();
    if !reach.is_finite() || is_coarse || scale.to_array().contains(&0.0) {
        let (scale, offset) = (scale.to_array(), offset.to_array());
        return Err(damaged(format!(
            "its scale {scale:?} or offset {offset:?} gives no coordinates"
        )));
    }
    Ok(Layout {
        file_bytes,
        data_offset,
        point_count,
        data_end,
        record_bytes,
        is_extended: format >= 6,
        rgb_at: match format {
            2 => Some(20),
            3 | 5 => Some(28),
            7 | 8 | 10 => Some(30),
            _ => None,
        },
        scale,
        offset,
    })
}

/// The records about the coordinate system, and the one about LAZ packing.
fn records(
    header: &las::raw::Header,
    layout: &Layout,
    source: &mut (impl Read + Seek),
    warnings: &mut Vec<String>,
) -> Result<(Records, Option<Vec<u8>>)> {
    let mut records = Records::default();
    let mut laz_record = None;
    let mut take = |user: &[u8], id: u16, data: Vec<u8>| match (user, id) {
        (b"LASF_Projection", 2112) => records.wkt = Some(data),
        (b"LASF_Projection", 34735) => records.geo_keys = Some(data),
        (b"LASF_Projection", 34736) => records.geo_doubles = Some(data),
        (b"LASF_Projection", 34737) => records.geo_ascii = Some(data),
        (b"laszip encoded", 22204) => laz_record = Some(data),
        _ => {}
    };
    // The number of records read before one makes no sense.
    let mut walk = |start: u64, end: u64, count: u32, is_extended: bool| -> Result<u32> {
        let mut at = start;
        for number in 0..count {
            let mut head = [0u8; 60];
            let head_bytes: u64 = if is_extended { 60 } else { 54 };
            if at.checked_add(head_bytes).is_none_or(|body| body > end) {
                return Ok(number);
            }
            source.seek(SeekFrom::Start(at)).map_err(io_error)?;
            source.read_exact(&mut head[..head_bytes as usize]).map_err(io_error)?;
            let length = if is_extended {
                let mut bytes = [0; 8];
                bytes.copy_from_slice(&head[20..28]);
                u64::from_le_bytes(bytes)
            } else {
                u64::from(u16::from_le_bytes([head[20], head[21]]))
            };
            let body = at + head_bytes;
            let Some(next) = body.checked_add(length).filter(|next| *next <= end) else {
                return Ok(number);
            };
            let user = head[2..18].split(|b| *b == 0).next().unwrap_or_default();
            let wanted = user == b"LASF_Projection" || user == b"laszip encoded";
            if wanted && length <= LONGEST_RECORD {
                let mut data = vec![0; length as usize];
                source.read_exact(&mut data).map_err(io_error)?;
                take(user, u16::from_le_bytes([head[18], head[19]]), data);
            }
            at = next;
        }
        Ok(count)
    };
    let vlrs = header.number_of_variable_length_records;
    let vlrs_start = u64::from(header.header_size).max(OLDEST_HEADER);
    let mut places = vec![(vlrs_start, layout.data_offset, vlrs, false)];
    if let Some(evlr) = header.evlr {
        let count = evlr.number_of_evlrs;
        places.push((evlr.start_of_first_evlr, layout.file_bytes, count, true));
    }
    for (start, end, count, is_extended) in places {
        let sound = walk(start, end, count, is_extended)?;
        let lost = count - sound;
        let room = end.saturating_sub(start) / if is_extended { 60 } else { 54 };
        if u64::from(count) > room {
            warnings.push(format!(
                "its header promises more records than it has room for; {sound} were read"
            ));
        } else if lost > 0 {
            warnings.push(format!("{lost} records of its header are damaged and were left out"));
        }
    }
    if laz_record.is_none() && header.point_data_record_format & 0x80 != 0 {
        laz_record = search_laz_record(source, vlrs_start, layout)?;
    }
    Ok((records, laz_record))
}

/// The LASzip record where the records before it are damaged, by its name.
fn search_laz_record(
    source: &mut (impl Read + Seek),
    start: u64,
    layout: &Layout,
) -> Result<Option<Vec<u8>>> {
    const NAME: &[u8; 16] = b"laszip encoded\0\0";
    let length = layout.data_offset.saturating_sub(start).min(LONGEST_RECORD);
    let mut bytes = Vec::new();
    source.seek(SeekFrom::Start(start)).map_err(io_error)?;
    source.take(length).read_to_end(&mut bytes).map_err(io_error)?;
    let found = bytes.windows(NAME.len()).position(|window| window == NAME);
    // Behind the name: the id (2 bytes), the length (2), a description (32).
    Ok(found.and_then(|at| {
        let length = u16::from_le_bytes([*bytes.get(at + 18)?, *bytes.get(at + 19)?]);
        Some(bytes.get(at + 52..at + 52 + usize::from(length))?.to_vec())
    }))
}

/// Points decoded together.
#[derive(Default)]
struct Decoded {
    steps: Vec<[i32; 3]>,
    columns: Columns,
    removed: Removed,
    repaired: u64,
    /// Least and greatest steps; the wrong way round without points. Of those kept, and of those not.
    ends: Ends,
    removed_ends: Ends,
    /// Greatest value of a colour.
    brightest: u16,
}

#[derive(Clone, Copy)]
struct Ends([[i32; 3]; 2]);

impl Default for Ends {
    fn default() -> Self {
        Ends([[i32::MAX; 3], [i32::MIN; 3]])
    }
}

impl Ends {
    fn add(&mut self, low: &[i32; 3], high: &[i32; 3]) {
        for k in 0..3 {
            self.0[0][k] = self.0[0][k].min(low[k]);
            self.0[1][k] = self.0[1][k].max(high[k]);
        }
    }
}

/// All points of a file decoded so far, or what is known of them where a sink takes them.
struct Gathered<'a> {
    all: Decoded,
    kept: u64,
    scale: DVec3,
    offset: DVec3,
    crs: Option<Crs>,
    sink: Option<Sink<'a>>,
}

impl<'a> Gathered<'a> {
    /// Room for all points, but for no more than one a byte of the file: the count may be wrong.
    fn new(layout: &Layout, crs: Option<Crs>, sink: Option<Sink<'a>>) -> Self {
        let mut all = Decoded::default();
        if sink.is_none() {
            let room = layout.point_count.min(layout.file_bytes) as usize;
            all.steps.reserve_exact(room);
            all.columns.intensity.reserve_exact(room);
            all.columns.return_number.reserve_exact(room);
            all.columns.return_count.reserve_exact(room);
            all.columns.class.reserve_exact(room);
            if layout.rgb_at.is_some() {
                all.columns.rgb.get_or_insert_default().reserve_exact(room);
            }
        }
        let (scale, offset) = (layout.scale, layout.offset);
        Gathered { all, kept: 0, scale, offset, crs, sink }
    }

    fn append(&mut self, mut part: Decoded) -> Result<()> {
        self.kept += part.steps.len() as u64;
        let [low, high] = &part.ends.0;
        self.all.ends.add(low, high);
        let [low, high] = &part.removed_ends.0;
        self.all.removed_ends.add(low, high);
        self.all.brightest = self.all.brightest.max(part.brightest);
        self.all.removed.add(&part.removed);
        self.all.repaired += part.repaired;
        let Some(sink) = &mut self.sink else {
            let Decoded { steps, columns, .. } = &mut self.all;
            rayon::join(|| steps.append(&mut part.steps), || columns.append(&mut part.columns));
            return Ok(());
        };
        let (scale, offset) = (self.scale, self.offset);
        let coordinates = Coordinates::Scaled { steps: part.steps, scale, offset };
        sink(self.crs.as_ref(), Batch { coordinates, columns: part.columns })
    }

    /// Of the points kept, world coordinates.
    fn bounds(&self) -> Option<(DVec3, DVec3)> {
        self.world((self.kept > 0).then_some(self.all.ends)?)
    }

    /// Also of those left out.
    fn bounds_of_all(&self) -> Option<(DVec3, DVec3)> {
        let mut ends = (self.kept > 0).then_some(self.all.ends)?;
        let [low, high] = &self.all.removed_ends.0;
        ends.add(low, high);
        self.world(ends)
    }

    fn world(&self, Ends(ends): Ends) -> Option<(DVec3, DVec3)> {
        let [low, high] = ends.map(|steps| world_from_steps(steps, self.scale, self.offset));
        // A scale may be negative.
        Some((low.min(high), low.max(high)))
    }
}

impl Decoded {
    /// Room for so many points, within reason.
    fn with_room(points: u64, layout: &Layout) -> Self {
        let room = points.min(1 << 16) as usize;
        let columns = Columns {
            intensity: Vec::with_capacity(room),
            return_number: Vec::with_capacity(room),
            return_count: Vec::with_capacity(room),
            class: Vec::with_capacity(room),
            rgb: layout.rgb_at.map(|_| Vec::with_capacity(room)),
        };
        Decoded { steps: Vec::with_capacity(room), columns, ..Decoded::default() }
    }

    /// Takes the records of `slab` that are kept.
    fn push(&mut self, slab: &[u8], layout: &Layout, options: &ReadOptions) {
        let columns = &mut self.columns;
        if layout.rgb_at.is_some() && columns.rgb.is_none() {
            columns.rgb = Some(Vec::new());
        }
        // Every format has at least 20 bytes; those with 16-byte flags at least 30.
        for record in slab.chunks_exact(layout.record_bytes) {
            let (number, count, class, withheld) = if layout.is_extended {
                (record[14] & 15, record[14] >> 4, record[16], record[15] & 4 != 0)
            } else {
                let flags = record[15];
                (record[14] & 7, (record[14] >> 3) & 7, flags & 31, flags & 128 != 0)
            };
            let step = |at: usize| {
                i32::from_le_bytes([record[at], record[at + 1], record[at + 2], record[at + 3]])
            };
            let short = |at: usize| u16::from_le_bytes([record[at], record[at + 1]]);
            let steps = [step(0), step(4), step(8)];
            let removed = match class {
                _ if withheld => Some(&mut self.removed.withheld),
                7 if options.drop_noise_classes => Some(&mut self.removed.low_noise),
                // Reserved before format 6, but writers use it there too.
                18 if options.drop_noise_classes => Some(&mut self.removed.high_noise),
                _ => None,
            };
            if let Some(removed) = removed {
                *removed += 1;
                self.removed_ends.add(&steps, &steps);
                continue;
            }
            self.ends.add(&steps, &steps);
            self.steps.push(steps);
            columns.intensity.push(short(12));
            let sound = number >= 1 && number <= count;
            self.repaired += u64::from(!sound);
            columns.return_number.push(number.max(1));
            columns.return_count.push(count.max(number).max(1));
            columns.class.push(class);
            if let (Some(at), Some(rgb)) = (layout.rgb_at, &mut columns.rgb) {
                let colour = [short(at), short(at + 2), short(at + 4)];
                self.brightest = colour.into_iter().fold(self.brightest, u16::max);
                rgb.push(colour);
            }
        }
    }
}
