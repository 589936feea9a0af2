//! Files to one cloud: which reader reads each, one coordinate system, one origin.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::las_file::io_error;
use super::part::{ColourScale, Columns, Coordinates, Part};
use super::shared::Sample;
use super::{
    ALIGNMENT_M, Bounds, Census, Files, PointCloud, ReadOptions, Removed, Scan, crs, isolated,
    las_file, text,
};
use crate::diagnostic::{Error, Result, Warned};
use crate::frame::{Crs, Frame};

/// Local f32 metres keep 1.6 cm up to here.
pub const MAX_EXTENT_M: f64 = 200_000.0;
/// The origin is a multiple of this.
const ORIGIN_STEP: f64 = 10.0;

pub(super) fn read(files: &Files, options: &ReadOptions) -> Result<Warned<Scan>> {
    let mut warnings = Vec::new();
    match read_inner(files, options, &mut warnings) {
        Ok(scan) => Ok(Warned::with(scan, warnings)),
        Err(error) => Err(error.noticed(warnings)),
    }
}

fn read_inner(files: &Files, options: &ReadOptions, warnings: &mut Vec<String>) -> Result<Scan> {
    let paths = &files.paths[..];
    let mut parts: Vec<Part> = Vec::with_capacity(paths.len());
    let mut sample = Sample::default();
    for (path, format) in paths.iter().zip(formats(paths)?) {
        let part = match format {
            Format::Las => las_file::read(path, options, &files.crs, None)?,
            Format::Text => text::read(path, &files.crs)?,
        };
        refuse(&parts, &part)?;
        sample.add(parts.len(), &part.coordinates, &part.columns);
        parts.push(part);
    }
    sample.tell(paths, warnings);
    refuse_no_points(&parts)?;
    let mut census = census(&parts, warnings);
    let unit_m = unit_m(&parts);
    let mut strays = Strays::default();
    if options.drop_isolated
        && span_too_much(&parts)
        && let Some(is_in_body) = isolated::in_body(&parts, unit_m)
    {
        census.removed.isolated += drop_points(&mut parts, &is_in_body, &mut strays);
    }
    let mut density_per_m2 = isolated::density_per_m2(&parts, unit_m);
    if options.drop_isolated {
        // A point very far away makes the voxels coarse: look again once it is gone.
        for _ in 0..3 {
            let Some(keep) = isolated::keep(&parts, unit_m, density_per_m2) else { break };
            census.removed.isolated += drop_points(&mut parts, &keep.flags, &mut strays);
            density_per_m2 = isolated::density_per_m2(&parts, unit_m);
            if !keep.is_coarse {
                break;
            }
        }
    }
    tell_isolated(paths, &census, warnings)?;
    let (frame, (min_m, max_m)) = frame(paths, &parts, &census, options)?;
    strays.tell(paths, (min_m, max_m), unit_m, warnings);
    let cloud = assemble(parts, frame, warnings);
    census.kept = cloud.len() as u64;
    let bounds = Bounds {
        min: cloud.frame.local_from_world(min_m / unit_m),
        max: cloud.frame.local_from_world(max_m / unit_m),
    };
    Ok(Scan { cloud, census, density_per_m2: density_per_m2 as f32, bounds })
}

/// Which reader reads each file; told before any is read.
pub(super) fn formats(paths: &[PathBuf]) -> Result<Vec<Format>> {
    if paths.is_empty() {
        return Err(Error::new("no scan is given").remedy("name at least one LAS, LAZ or XYZ file"));
    }
    let formats = paths.iter().map(|path| Format::of(path)).collect::<Result<Vec<_>>>()?;
    refuse_twins(paths)?;
    Ok(formats)
}

/// Refuses a part that can't stand beside those read before.
pub(super) fn refuse(before: &[Part], part: &Part) -> Result<()> {
    refuse_degrees(part)?;
    match leading(before) {
        Some(first) if part.in_file > 0 && first.in_file > 0 => refuse_other_system(first, part),
        _ => Ok(()),
    }
}

/// The part whose coordinate system is that of all: the first with points.
fn leading(parts: &[Part]) -> Option<&Part> {
    parts.iter().find(|part| part.in_file > 0).or(parts.first())
}

/// A file without points may stand beside others, but not alone.
pub(super) fn refuse_no_points(parts: &[Part]) -> Result<()> {
    match leading(parts) {
        Some(first) if first.in_file == 0 => {
            Err(Error::new(NO_POINTS).in_file(&first.path).remedy("give a scan with points"))
        }
        _ => Ok(()),
    }
}

const NO_POINTS: &str = "holds no points";

/// Whether the parts lie too far from each other for one frame.
pub(super) fn span_too_much(parts: &[Part]) -> bool {
    let unit_m = unit_m(parts);
    let bounds = parts.iter().filter_map(|part| part.bounds);
    let bounds = bounds.reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)));
    bounds.is_some_and(|(low, high)| ((high - low) * unit_m).max_element() > MAX_EXTENT_M)
}

/// What was read and left out, with the warnings of the parts.
pub(super) fn census(parts: &[Part], warnings: &mut Vec<String>) -> Census {
    let mut census = Census { files: parts.len() as u32, ..Census::default() };
    for part in parts {
        census.in_files += part.in_file;
        census.removed.add(&part.removed);
        let name = part.path.display();
        warnings.extend(part.warnings.iter().map(|text| format!("{name}: {text}")));
        if part.in_file == 0 {
            warnings.push(format!("{name}: {NO_POINTS}"));
        }
        if part.removed.not_finite > 0 {
            let n = part.removed.not_finite;
            warnings.push(format!("{name}: {n} points that are not finite were dropped"));
        }
    }
    if leading(parts).is_none_or(|part| part.crs.is_none()) {
        warnings.push("no coordinate system is stated: world units are taken as metres".into());
    }
    census
}

/// So many isolated points are told, and so many more are no noise, in parts of all.
const MANY_ISOLATED: f64 = 0.05;
const MOST_ISOLATED: f64 = 0.5;
/// Among fewer points shares say little.
const LEAST_POINTS: u64 = 100;

/// Tells of points that were dropped for standing alone, where they are many.
///
/// # Errors
/// Most points stand alone: these are no coordinates of a scan.
pub(super) fn tell_isolated(
    paths: &[PathBuf],
    census: &Census,
    warnings: &mut Vec<String>,
) -> Result<()> {
    let (isolated, all) = (census.removed.isolated, census.in_files);
    let share = isolated as f64 / all.max(1) as f64;
    if all < LEAST_POINTS || share <= MANY_ISOLATED {
        return Ok(());
    }
    if share <= MOST_ISOLATED {
        let percent = 100.0 * share;
        warnings.push(format!(
            "{isolated} of {all} points ({percent:.0} %) stand alone and are left out as noise: check \
             the scale in the header or the order of the columns"
        ));
        return Ok(());
    }
    let error = Error::new(format!("{isolated} of {all} points stand alone, as in no scan")).remedy(
        "check the scale and offset in the header, or the order of the columns: x, y and z come \
         first",
    );
    Err(match paths.first() {
        Some(first) => error.in_file(first),
        None => error,
    })
}

/// Points dropped for standing alone farther from all others than this are told, metres.
const FAR_M: f64 = 100.0;

/// World places of points that were dropped for standing alone; without those of a time when they were
/// so many that [`tell_isolated`] tells them.
#[derive(Debug, Default)]
pub(super) struct Strays(Vec<DVec3>);

impl Strays {
    /// Points that were dropped together, of so many.
    pub fn add(&mut self, places: impl ExactSizeIterator<Item = DVec3>, of: u64) {
        if places.len() as f64 <= MANY_ISOLATED * of.max(LEAST_POINTS) as f64 {
            self.0.extend(places);
        }
    }

    /// Tells of those that lie far out of the bounds of the points kept, in world metres.
    pub fn tell(
        &self,
        paths: &[PathBuf],
        (low, high): (DVec3, DVec3),
        unit_m: DVec3,
        warnings: &mut Vec<String>,
    ) {
        let away_m = |p: &DVec3| {
            let p = *p * unit_m;
            (p - p.clamp(low, high)).length()
        };
        let far = self.0.iter().filter(|p| away_m(p) >= FAR_M);
        let Some(farthest) = far.clone().max_by(|a, b| away_m(a).total_cmp(&away_m(b))) else {
            return;
        };
        let of = match paths {
            [path] => path.display().to_string(),
            _ => format!("the {} files", paths.len()),
        };
        let (points, stand) = match far.count() {
            1 => ("a point".to_owned(), "stands"),
            n => (format!("{n} points"), "stand"),
        };
        let DVec3 { x, y, z } = farthest;
        let away = match away_m(farthest) {
            m if m < 10_000.0 => format!("{m:.0} m"),
            m => format!("{} km", kilometres(m)),
        };
        warnings.push(format!(
            "{of}: {points} that {stand} far from all others, up to {away} away (x {x:.2}, y {y:.2}, \
             z {z:.2}), left out as noise: remove what is stray from the file; what is right, give with \
             the points around it in a run of its own"
        ));
    }
}

fn unit_m(parts: &[Part]) -> DVec3 {
    let crs = leading(parts).and_then(|part| part.crs.clone());
    Frame { origin: DVec3::ZERO, crs }.unit_m()
}

/// The frame of all parts, and their bounds in world metres.
pub(super) fn frame(
    paths: &[PathBuf],
    parts: &[Part],
    census: &Census,
    options: &ReadOptions,
) -> Result<(Frame, (DVec3, DVec3))> {
    let unit_m = unit_m(parts);
    let named = |error: Error| match paths.first() {
        Some(first) => error.in_file(first),
        None => error,
    };
    let of_part = |part: &Part| part.bounds.map(|(a, b)| (a * unit_m, b * unit_m));
    let bounds = parts.iter().filter_map(of_part).reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)));
    let Some((min_m, max_m)) = bounds else {
        return Err(named(
            Error::new(format!(
                "no point is left of {}: {}",
                census.in_files,
                reasons(&census.removed)
            ))
            .remedy("give a scan with finite coordinates whose points are not all marked as noise"),
        ));
    };
    let extent_m = (max_m - min_m).max_element();
    if extent_m > MAX_EXTENT_M {
        return Err(named(
            Error::new(format!("the points span {} km", kilometres(extent_m))).remedy(format!(
                "give scans within {:.0} km of each other; a single far point or a wrong scale in \
                 a header does this too",
                MAX_EXTENT_M / 1000.0
            )),
        ));
    }
    let floor = |v: DVec3, step: f64| (v / step).floor() * step + DVec3::ZERO;
    let origin = match options.is_aligned {
        true => floor(min_m, ALIGNMENT_M) / unit_m,
        false => floor(min_m / unit_m, ORIGIN_STEP),
    };
    let crs = leading(parts).and_then(|part| part.crs.clone());
    Ok((Frame { origin, crs }, (min_m, max_m)))
}

fn kilometres(length_m: f64) -> String {
    let km = length_m / 1000.0;
    if km < 1e9 { format!("{km:.0}") } else { format!("{km:.0e}") }
}

/// Whether every file has colours; with a warning where only some have.
pub(super) fn keeps_colour(parts: &[Part], warnings: &mut Vec<String>) -> bool {
    let has = |part: &Part| part.colour != ColourScale::None;
    let coloured = parts.iter().filter(|part| has(part)).count();
    if coloured > 0 && coloured < parts.len() {
        warnings.push("colours are left out: not every file has them".into());
    }
    coloured == parts.len()
}

#[derive(Debug, Clone, Copy)]
pub(super) enum Format {
    Las,
    Text,
}

impl Format {
    /// By content where it is LAS, else by extension.
    fn of(path: &Path) -> Result<Format> {
        Self::of_inner(path).map_err(|error| error.in_file(path))
    }

    fn of_inner(path: &Path) -> Result<Format> {
        let metadata = std::fs::metadata(path).map_err(|error| {
            if error.kind() == std::io::ErrorKind::NotFound {
                Error::new("there is no such file").remedy("check the path of the scan")
            } else {
                io_error(error)
            }
        })?;
        if metadata.is_dir() {
            return Err(Error::new("is a folder, not a scan").remedy("name the files inside it"));
        }
        if metadata.len() == 0 {
            return Err(las_file::damaged("is empty"));
        }
        let mut start = Vec::new();
        File::open(path).and_then(|f| f.take(4).read_to_end(&mut start)).map_err(io_error)?;
        let extension =
            path.extension().and_then(|e| e.to_str()).unwrap_or_default().to_ascii_lowercase();
        match extension.as_str() {
            _ if start == b"LASF" => Ok(Format::Las),
            "las" | "laz" => Ok(Format::Las),
            "xyz" | "txt" | "asc" | "pts" | "csv" => Ok(Format::Text),
            other => Err(Error::new(format!("files of type \"{other}\" are not read")).remedy(
                "give a scan in LAS, LAZ or plain x y z text (.xyz, .txt, .asc, .pts, .csv)",
            )),
        }
    }
}

/// The same file twice would double its points.
fn refuse_twins(paths: &[PathBuf]) -> Result<()> {
    let mut known: Vec<PathBuf> =
        paths.iter().filter_map(|path| std::fs::canonicalize(path).ok()).collect();
    known.sort();
    if let Some(pair) = known.windows(2).find(|pair| pair[0] == pair[1]) {
        return Err(Error::new("is given twice").in_file(&pair[0]).remedy("name it once"));
    }
    let mut seen: BTreeMap<(u64, Vec<u8>), &Path> = BTreeMap::new();
    for path in &known {
        // A file that can't be read is told by its reader.
        let Ok(print) = fingerprint(path) else { continue };
        // Files without points may be alike.
        if print.0 > LEAST_BYTES
            && let Some(other) = seen.insert(print, path)
        {
            let what = format!("holds the same bytes as {}", other.display());
            return Err(Error::new(what).in_file(path).remedy("give one of them"));
        }
    }
    Ok(())
}

/// Shorter files hold little but their header.
const LEAST_BYTES: u64 = 4096;

/// Length of a file, and its beginning and end.
fn fingerprint(path: &Path) -> std::io::Result<(u64, Vec<u8>)> {
    const END_BYTES: u64 = 1 << 16;
    let mut file = File::open(path)?;
    let length = file.metadata()?.len();
    let mut ends = Vec::new();
    (&mut file).take(END_BYTES).read_to_end(&mut ends)?;
    file.seek(SeekFrom::Start(length.saturating_sub(END_BYTES)))?;
    file.take(END_BYTES).read_to_end(&mut ends)?;
    Ok((length, ends))
}

fn refuse_degrees(part: &Part) -> Result<()> {
    let Some((min, max)) = part.bounds else { return Ok(()) };
    let extent = max - min;
    let breadth = extent.truncate().max_element();
    // Whatever system is stated: a place on the globe, far higher than it is wide.
    let seems_degrees = min.x >= -180.0
        && max.x <= 180.0
        && min.y >= -90.0
        && max.y <= 90.0
        && breadth > 0.0
        && breadth < 0.1
        && extent.z > 100.0 * breadth;
    if part.in_degrees || seems_degrees {
        return Err(crs::degrees_error((min + max) / 2.0).in_file(&part.path));
    }
    Ok(())
}

fn refuse_other_system(first: &Part, other: &Part) -> Result<()> {
    let is_same = match (&first.crs, &other.crs) {
        (None, None) => true,
        (Some(a), Some(b)) => {
            let same_system = match (a.epsg, b.epsg) {
                (Some(a), Some(b)) => a == b,
                _ => a.wkt == b.wkt,
            };
            same_system
                && (a.horizontal_unit_m - b.horizontal_unit_m).abs() < 1e-9
                && (a.vertical_unit_m - b.vertical_unit_m).abs() < 1e-9
        }
        _ => false,
    };
    if is_same {
        return Ok(());
    }
    Err(Error::new(format!(
        "is in {}, but {} is in {}",
        name(&other.crs),
        first.path.display(),
        name(&first.crs)
    ))
    .in_file(&other.path)
    .remedy("reproject one of them, e.g. with PDAL's filters.reprojection, or read them apart"))
}

fn name(crs: &Option<Crs>) -> String {
    let Some(crs) = crs else { return "no stated coordinate system".into() };
    let system = match (crs.epsg, &crs.wkt) {
        (Some(code), _) => format!("EPSG:{code}"),
        (None, Some(wkt)) => wkt.split('"').nth(1).unwrap_or("a system without a code").to_owned(),
        (None, None) => "a system without a code".to_owned(),
    };
    if crs.horizontal_unit_m == 1.0 && crs.vertical_unit_m == 1.0 {
        system
    } else {
        format!("{system} (units of {} and {} m)", crs.horizontal_unit_m, crs.vertical_unit_m)
    }
}

fn reasons(removed: &Removed) -> String {
    let all = [
        (removed.not_finite, "not finite"),
        (removed.withheld, "withheld"),
        (removed.low_noise, "low noise"),
        (removed.high_noise, "high noise"),
        (removed.isolated, "isolated"),
    ];
    let some: Vec<String> =
        all.iter().filter(|(n, _)| *n > 0).map(|(n, why)| format!("{n} {why}")).collect();
    some.join(", ")
}

/// Drops points, and finds the bounds of the others.
fn drop_points(parts: &mut [Part], keep: &[Vec<bool>], strays: &mut Strays) -> u64 {
    let all: u64 = parts.iter().map(|part| part.coordinates.len() as u64).sum();
    let out: Vec<Vec<usize>> = (keep.iter())
        .map(|keep| {
            (keep.par_iter().enumerate()).filter_map(|(i, keep)| (!keep).then_some(i)).collect()
        })
        .collect();
    let numbers: Vec<(usize, usize)> = (out.iter().enumerate())
        .flat_map(|(part, out)| out.iter().map(move |i| (part, *i)))
        .collect();
    let place = |(part, i): &(usize, usize)| parts[*part].coordinates.get(*i).unwrap_or_default();
    strays.add(numbers.iter().map(place), all);
    for (part, out) in parts.iter_mut().zip(&out).filter(|(_, out)| !out.is_empty()) {
        rayon::join(|| part.coordinates.leave_out(out), || part.columns.leave_out(out));
    }
    parts.iter_mut().for_each(|part| part.bounds = part.coordinates.bounds());
    numbers.len() as u64
}

fn assemble(parts: Vec<Part>, frame: Frame, warnings: &mut Vec<String>) -> PointCloud {
    let keeps_colour = keeps_colour(&parts, warnings);
    let total = parts.iter().map(|part| part.coordinates.len()).sum::<usize>();
    let mut position: Vec<Vec3> = Vec::new();
    let mut columns = Columns::default();
    for mut part in parts {
        let local = local_positions(part.coordinates, &frame);
        if !keeps_colour {
            part.columns.rgb = None;
        }
        if position.is_empty() {
            // The first file's columns become the cloud's: nothing is copied for a single file.
            position = local;
            columns = part.columns;
            position.reserve_exact(total - position.len());
        } else {
            position.extend(local);
            columns.append(&mut part.columns);
        }
    }
    position.shrink_to_fit();
    columns.shrink_to_fit();
    PointCloud {
        frame,
        position,
        intensity: columns.intensity,
        return_number: columns.return_number,
        return_count: columns.return_count,
        class: columns.class,
        rgb: columns.rgb,
    }
}

/// Three i32 and three f32 have one size, so LAS steps turn into positions in place.
fn local_positions(coordinates: Coordinates, frame: &Frame) -> Vec<Vec3> {
    match coordinates {
        Coordinates::Scaled { mut steps, scale, offset } => {
            steps.par_iter_mut().for_each(|s| {
                let local =
                    frame.local_from_world(super::part::world_from_steps(*s, scale, offset));
                *s = local.to_array().map(|v| v.to_bits().cast_signed());
            });
            bytemuck::allocation::cast_vec(steps)
        }
        Coordinates::Real(world) => world.iter().map(|p| frame.local_from_world(*p)).collect(),
    }
}
