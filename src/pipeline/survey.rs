//! From scan to trees: reading, ground, terrain, crowns, species. Each function goes one stage
//! further than the one before, so that a command runs what it needs and no more.

use std::path::{Path, PathBuf};

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::Effort;
use super::tiled::Tiled;
use crate::crown::{self, Crown, CrownOptions, Found};
use crate::diagnostic::{Error, Result};
use crate::frame::Frame;
use crate::ground::{self, Classified, Kind};
use crate::inventory::{self, Tree};
use crate::raster::{self, geotiff::Raster};
use crate::report::{ErrorMeasure, Outcome, Recorder};
use crate::scan::{self, Bounds, Census, ReadOptions, Scan};
use crate::seed::Seed;
use crate::species::Species;
use crate::species::allometry;
use crate::species::assign::{How, SpeciesBy, assign};
use crate::species::look::{self, Looks};
use crate::species::photo::Photo;
use crate::terrain::{self, HeldOut, Terrain};
use crate::voxel;

/// What to read and how.
#[derive(Debug, Clone)]
pub struct SurveyJob {
    pub scans: scan::Files,
    pub ground: ground::Method,
    /// Terrain cell; from the density where `None`.
    pub cell_m: Option<f32>,
    pub photo: Option<PathBuf>,
    /// Side of the tiles in which the scan is worked through, metres, rounded up to multiples of
    /// [`scan::tiles::TILE_M`]; in one piece where `None` and the scan is not large.
    pub tile_m: Option<f32>,
    /// To choose among, never empty.
    pub species: Vec<Species>,
    pub species_by: SpeciesBy,
    /// From the density where `None`.
    pub voxel_m: Option<f32>,
    pub min_height_m: f32,
    pub effort: Effort,
    pub seed: Seed,
}

/// Everything known of the place once its trees have been found.
#[derive(Clone)]
pub struct Survey {
    pub frame: Frame,
    pub terrain: Terrain,
    pub photo: Option<Photo>,
    /// As long as `species`.
    pub trees: Vec<Tree>,
    /// Index into the job's species, one a tree.
    pub species: Vec<usize>,
}

/// Work goes on in a frame in which no grid depends on the extent of the scan; what comes out
/// stands near its origin.
pub const READ: ReadOptions =
    ReadOptions { drop_noise_classes: true, drop_isolated: true, is_aligned: true };

/// A frame with its origin near the least corner of a scan, and the way there.
fn near_frame(frame: &Frame, bounds: &Bounds) -> (Frame, Vec3) {
    const STEP: f64 = 10.0;
    let origin = (frame.world_from_local(bounds.min) / STEP).floor() * STEP;
    let by = -frame.local_from_world(origin);
    (Frame { origin, crs: frame.crs.clone() }, by)
}

/// A scan in one piece.
pub(super) struct Whole {
    pub classified: Classified,
    pub density_per_m2: f32,
    pub bounds: Bounds,
}

/// Scan to ground and terrain, all points in memory at the end; by tiles where one piece is not right.
pub(super) fn classified(job: &SurveyJob, run: &mut Recorder) -> Result<(Whole, Terrain)> {
    let scan = match way(job, run)? {
        Way::Whole(scan) => scan,
        Way::Tiles(tiles) => {
            let tiled = Tiled::read(job, run)?.classify(job, tiles, run)?;
            let terrain = tiled.terrain(job, tiles, run)?;
            return Ok((tiled.into_whole()?, terrain));
        }
    };
    let whole = classify(job, *scan, run)?;
    let terrain = build_terrain(job, &whole.classified, run)?;
    Ok((whole, terrain))
}

pub(super) fn read(job: &SurveyJob, run: &mut Recorder) -> Result<Scan> {
    run.stage("scan", |warnings| {
        let scan = scan::read(&job.scans, &READ)?.into_value(warnings);
        check_extent(job, &scan.bounds, scan.cloud.len())?;
        let outcome = scan_outcome(&scan.census, scan.density_per_m2);
        Ok((scan, outcome))
    })
}

/// Whether a terrain can be made of the scans together.
pub(super) fn check_extent(job: &SurveyJob, bounds: &Bounds, points: usize) -> Result<()> {
    let checked = terrain::check_extent(bounds.min, bounds.max, points, job.cell_m);
    checked.map_err(|e| match &job.scans[..] {
        [scan] => e.in_file(scan),
        // None of them alone is to blame.
        scans => {
            let message = format!("the {} files together: {}", scans.len(), e.message());
            Error::new(message).remedy(
                "give what lies far apart in runs of its own, or look for a wrong scale in a header",
            )
        }
    })
}

pub(super) fn classify(job: &SurveyJob, scan: Scan, run: &mut Recorder) -> Result<Whole> {
    run.stage("ground", |warnings| {
        let Scan { cloud, density_per_m2, bounds, .. } = scan;
        let points = cloud.len();
        let classified = ground::classify(cloud, job.ground)
            .map_err(|e| e.in_file(&job.scans[0]))?
            .into_value(warnings);
        let ground = classified.kind.iter().filter(|&&k| k == Kind::Ground).count();
        let mut outcome = ground_outcome(points, ground, ground::spread_m(&classified));
        if classified.is_normalised {
            outcome = outcome.note("heights were already above ground");
        }
        Ok((Whole { classified, density_per_m2, bounds }, outcome))
    })
}

pub(super) fn ground_outcome(points: usize, ground: usize, spread_m: Option<f64>) -> Outcome {
    let outcome = Outcome::items(points, "points", ground, "ground points");
    match spread_m {
        Some(m) => outcome.error(ErrorMeasure::new("spread in 0.5 m cells", m, "m")),
        None => outcome,
    }
}

pub(super) fn scan_outcome(census: &Census, density_per_m2: f32) -> Outcome {
    let removed = &census.removed;
    let share = 100.0 * removed.total() as f64 / census.in_files.max(1) as f64;
    Outcome::items(census.files as usize, "files", census.kept as usize, "points")
        .error(ErrorMeasure::new("removed as noise", share, "%"))
        .note(format!(
            "{} points in the files; removed: {} isolated, {} low and {} high noise, {} withheld, \
             {} not finite",
            census.in_files,
            removed.isolated,
            removed.low_noise,
            removed.high_noise,
            removed.withheld,
            removed.not_finite
        ))
        .note(format!("{density_per_m2:.1} points/m²"))
}

/// # Errors
/// A file that can't be read, or has no place on the ground.
pub(super) fn photo_raster(path: &Path) -> Result<Raster> {
    let raster = raster::read(path)?;
    if raster.geometry.is_none() {
        return Err(Error::new("the photo has no georeference").in_file(path).remedy(
            "give a GeoTIFF, or put a world file beside the photo (.tfw, .pgw, .jgw, .wld)",
        ));
    }
    Ok(raster)
}

pub(super) fn place_photo(
    job: &SurveyJob,
    run: &mut Recorder,
    raster: Option<Raster>,
    frame: &Frame,
    bounds: Bounds,
) -> Result<Option<Photo>> {
    let (Some(path), Some(raster)) = (&job.photo, raster) else { return Ok(None) };
    let scan = frame.crs.as_ref().and_then(|crs| crs.epsg);
    if let (Some(scan), Some(photo)) = (scan, raster.epsg)
        && scan != photo
    {
        run.warnings.push(format!(
            "{}: the photo is in EPSG:{photo}, the scan in EPSG:{scan}; its coordinates are taken as \
             the scan's",
            path.display()
        ));
    }
    let (low, high) = (bounds.min.truncate(), bounds.max.truncate());
    let photo = Photo::new(&path.display().to_string(), raster, frame, low, high)?;
    Ok(Some(photo.into_value(&mut run.warnings)))
}

/// Larger scans go by tiles of about so many points, though none is asked for.
const WHOLE_POINTS: u64 = 30_000_000;
const TILE_POINTS: f64 = 4_000_000.0;
/// Points per square metre that a scan is taken to have before it is read.
const USUAL_DENSITY: f64 = 10.0;

/// Tiles along the side of what is worked on at a time; `None` for the scan in one piece.
fn tiles_a_side(job: &SurveyJob) -> Option<i32> {
    match job.tile_m {
        Some(side_m) => Some(tiles_along(f64::from(side_m))),
        None if scan::stated_points(&job.scans) > WHOLE_POINTS => Some(usual_tiles()),
        None => None,
    }
}

fn usual_tiles() -> i32 {
    tiles_along((TILE_POINTS / USUAL_DENSITY).sqrt())
}

fn tiles_along(side_m: f64) -> i32 {
    // With less, the tiles about a block show too little of what stands beside it.
    (side_m / scan::tiles::TILE_M).ceil().clamp(2.0, 1000.0) as i32
}

/// Whether most of a scan's box is empty, as between plots and along corridors: grids over all of it
/// would be coarser than its points allow, those of tiles are not.
fn has_gaps(scan: &Scan) -> bool {
    const MOST: f32 = 8.0;
    const LEAST_SQ_M: f32 = 1e5;
    let size = scan.bounds.max - scan.bounds.min;
    let flown_sq_m = scan.cloud.len() as f32 / scan.density_per_m2.max(1e-9);
    size.x * size.y > (MOST * flown_sq_m).max(LEAST_SQ_M)
}

/// How a scan is worked through.
enum Way {
    Whole(Box<Scan>),
    /// Tiles along the side of a block; nothing is read or recorded yet.
    Tiles(i32),
}

/// By tiles where that is asked for, the scan is large or has gaps.
fn way(job: &SurveyJob, run: &mut Recorder) -> Result<Way> {
    if let Some(tiles) = tiles_a_side(job) {
        return Ok(Way::Tiles(tiles));
    }
    let before = (run.stages.len(), run.warnings.len());
    let scan = read(job, run)?;
    if has_gaps(&scan) {
        run.stages.truncate(before.0);
        run.warnings.truncate(before.1);
        return Ok(Way::Tiles(usual_tiles()));
    }
    Ok(Way::Whole(Box::new(scan)))
}

/// Scan to terrain.
///
/// # Errors
/// Unreadable scans; no ground; a grid too large.
pub fn terrain(job: &SurveyJob, run: &mut Recorder) -> Result<(Frame, Terrain)> {
    match way(job, run)? {
        Way::Tiles(tiles) => {
            let tiled = Tiled::read(job, run)?.classify(job, tiles, run)?;
            let terrain = tiled.terrain(job, tiles, run)?;
            let (frame, by) = near_frame(tiled.frame(), &tiled.bounds());
            Ok((frame, terrain.moved(by)))
        }
        Way::Whole(scan) => {
            let Whole { classified, bounds, .. } = classify(job, *scan, run)?;
            let terrain = build_terrain(job, &classified, run)?;
            let (frame, by) = near_frame(&classified.cloud.frame, &bounds);
            Ok((frame, terrain.moved(by)))
        }
    }
}

/// One point in so many is looked at by [`check_ground`]: enough for a share.
pub(super) fn looked_at(points: usize) -> u64 {
    const ENOUGH: usize = 1 << 16;
    (points / ENOUGH).next_power_of_two() as u64
}

/// Whether the pulses of a scan reached the ground. A ground is a layer: of the points from 0.3 m
/// below to 1 m above it most lie within 0.3 m of it, 59 % and more in real scans, while an even
/// spread gives 46 % and the underside of a canopy less. A single tree cut out of its scan has no
/// ground either, but is worth a scene: where next to no cell holds ground the terrain's own
/// warning has to do.
pub(super) fn check_ground(
    job: &SurveyJob,
    (near, all): (usize, usize),
    is_normalised: bool,
    terrain: &Terrain,
) -> Result<()> {
    const LEAST_SHARE: f64 = 0.5;
    const LEAST_POINTS: usize = 100;
    const LEAST_OBSERVED: f64 = 0.1;
    let observed = terrain.is_observed.iter().filter(|&&o| o).count() as f64;
    let is_layer = near as f64 >= LEAST_SHARE * all as f64 || all < LEAST_POINTS;
    let is_cut_out = observed < LEAST_OBSERVED * terrain.is_observed.len() as f64;
    if is_layer || is_cut_out || is_normalised || job.ground == ground::Method::FileClasses {
        return Ok(());
    }
    let what = "no ground is found: the lowest points are no layer of their own";
    Err(Error::new(what)
        .in_file(&job.scans[0])
        .remedy("give a scan whose pulses reach the ground, or one with classes and --ground file"))
}

pub(super) fn build_terrain(
    job: &SurveyJob,
    classified: &Classified,
    run: &mut Recorder,
) -> Result<Terrain> {
    run.stage("terrain", |warnings| {
        let options = job.effort.terrain(job.cell_m);
        let (terrain, held_out) = terrain::build_measured(classified, &options)?;
        let terrain = terrain.into_value(warnings);
        let ground = classified.kind.iter().filter(|&&k| k == Kind::Ground).count();
        let cells = terrain.heights.data.len();
        let mut outcome = Outcome::items(ground, "ground points", cells, "cells")
            .note(format!("cell {} m", terrain.heights.geometry.cell_x));
        let near = terrain.near(classified, looked_at(classified.cloud.len()));
        check_ground(job, near, classified.is_normalised, &terrain)?;
        if let Some(held_out) = held_out {
            outcome = with_held_out(outcome, held_out);
        }
        Ok((terrain, outcome))
    })
}

pub(super) fn with_held_out(outcome: Outcome, held_out: HeldOut) -> Outcome {
    let HeldOut { rmse_m, max_m, points } = held_out;
    outcome
        .error(ErrorMeasure::new("held-out RMSE", rmse_m, "m"))
        .note(format!("worst held-out error {max_m:.2} m, of {points} points"))
}

/// Crowns that voxels are meant for, metres across.
const TYPICAL_CROWN_M: f32 = 4.0;

pub(super) fn voxel_m(job: &SurveyJob, density_per_m2: f32) -> f32 {
    job.voxel_m.unwrap_or_else(|| voxel::choose_size_m(density_per_m2, TYPICAL_CROWN_M))
}

/// What the crown stage tells of itself.
pub(super) fn crown_outcome(found: &Found, options: &CrownOptions, voxel_m: f32) -> Outcome {
    let inside: usize = found.crowns.iter().map(|c| c.point_count as usize).sum();
    let vegetation = found.tally.vegetation;
    let left = 100.0 * (1.0 - inside as f64 / vegetation.max(1) as f64);
    let [places, points] = found.notes(options.min_height_m);
    Outcome::items(vegetation, "points", found.crowns.len(), "trees")
        .error(ErrorMeasure::new("vegetation points in no tree", left, "%"))
        .note(format!("voxel {voxel_m:.2} m"))
        .note(places)
        .note(points)
}

/// Scan to trees with species.
///
/// # Errors
/// Those of [`terrain()`]; an unreadable photo, or one that lies elsewhere.
pub fn inventory(job: &SurveyJob, run: &mut Recorder) -> Result<Survey> {
    // Read first: a photo that can't be used is told before the scan is read.
    let raster = job.photo.as_deref().map(photo_raster).transpose()?;
    let scan = match way(job, run)? {
        Way::Whole(scan) => *scan,
        Way::Tiles(tiles) => {
            let tiled = Tiled::read(job, run)?;
            let (frame, by) = near_frame(tiled.frame(), &tiled.bounds());
            let photo = place_photo(job, run, raster, &frame, tiled.bounds().moved(by))?;
            let tiled = tiled.classify(job, tiles, run)?;
            let terrain = tiled.terrain(job, tiles, run)?;
            let (crowns, looks) = tiled.crowns(job, tiles, &terrain, run)?;
            let crowns = crowns.into_iter().map(|c| c.moved(by)).collect();
            return name_trees(job, crowns, &looks, frame, terrain.moved(by), photo, run);
        }
    };
    let (frame, by) = near_frame(&scan.cloud.frame, &scan.bounds);
    let photo = place_photo(job, run, raster, &frame, scan.bounds.moved(by))?;
    let Whole { classified, density_per_m2, .. } = classify(job, scan, run)?;
    let terrain = build_terrain(job, &classified, run)?;
    let crowns = run.stage("crown", |warnings| {
        let (options, voxel_m) = (job.effort.crown(job.min_height_m), voxel_m(job, density_per_m2));
        let found = crown::detect_within(&classified, &terrain, voxel_m, &options, None, |_| true)?;
        warnings.extend(found.warnings(options.min_height_m));
        let outcome = crown_outcome(&found, &options, voxel_m);
        Ok((found.crowns, outcome))
    })?;
    let looks = look::measure(&crowns, &classified, &terrain);
    drop(classified);
    let crowns = crowns.into_par_iter().map(|c| c.moved(by)).collect();
    name_trees(job, crowns, &looks, frame, terrain.moved(by), photo, run)
}

/// Hardly a forest on Earth grows higher, metres; where coordinates are those of a US state plane in
/// feet, and not of a UTM zone, less is enough to tell.
const HIGHEST_M: f32 = 60.0;
const HIGHEST_IN_PLANE_M: f32 = 45.0;
/// This part of the trees may be higher: towers, birds.
const HIGHER: f32 = 0.02;

/// Tells where trees are as high as only feet taken for metres make them.
fn feet_for_metres(heights_m: impl Iterator<Item = f32>, frame: &Frame) -> Option<String> {
    let mut heights: Vec<f32> = heights_m.collect();
    heights.sort_by(f32::total_cmp);
    let higher = (heights.len() as f32 * HIGHER) as usize;
    let highest = *heights.get(heights.len().checked_sub(1 + higher)?)?;
    let DVec3 { x, y, .. } = frame.origin;
    let is_plane = (1e6..1e7).contains(&x) && (0.0..5e6).contains(&y);
    let most = if is_plane { HIGHEST_IN_PLANE_M } else { HIGHEST_M };
    (frame.crs.is_none() && highest > most).then(|| {
        format!(
            "trees come out {highest:.0} m high, more than forests grow{}: no coordinate system is \
             stated, and feet may have been taken for metres; if so, give --crs with the EPSG code of \
             the scan's system, as EPSG:2229 for California zone 5 in feet",
            if is_plane { ", at coordinates as of a US state plane in feet" } else { "" }
        )
    })
}

/// The last stage: species, and what follows from them.
fn name_trees(
    job: &SurveyJob,
    crowns: Vec<Crown>,
    looks: &Looks,
    frame: Frame,
    terrain: Terrain,
    photo: Option<Photo>,
    run: &mut Recorder,
) -> Result<Survey> {
    run.stage("species", |warnings| {
        warnings.extend(feet_for_metres(crowns.iter().map(|c| c.height_m), &frame));
        let (by, seen) = (job.species_by, photo.as_ref());
        let assigned =
            assign(&crowns, looks, seen, &job.species, by, job.seed)?.into_value(warnings);
        let species: Vec<usize> = assigned.iter().map(|a| a.species).collect();
        let trees: Vec<Tree> = crowns
            .into_iter()
            .zip(&assigned)
            .map(|(crown, a)| {
                let s = &job.species[a.species];
                Tree {
                    id: inventory::id(&crown),
                    species: s.name.clone(),
                    species_from: a.how.text().into(),
                    kind_chance: a.kind_chance,
                    luminance: a.luminance,
                    luminance_distance: a.luminance_distance,
                    stem_diameter_m: allometry::stem_diameter_m(
                        s,
                        crown.height_m,
                        crown.diameter_m,
                    ),
                    biomass_kg: allometry::biomass_kg(s, crown.height_m, crown.diameter_m),
                    crown,
                }
            })
            .collect();
        let kinds = (0..job.species.len()).filter(|i| species.contains(i)).count();
        let mut outcome = Outcome::items(trees.len(), "trees", kinds, "species");
        for source in How::ALL {
            let count = assigned.iter().filter(|a| a.how == source).count();
            if count > 0 {
                outcome = outcome.note(format!("species of {count} trees by: {}", source.text()));
            }
        }
        let off: Vec<f32> = assigned.iter().filter_map(|a| a.luminance_distance).collect();
        if !off.is_empty() {
            let mean = off.iter().map(|&d| f64::from(d)).sum::<f64>() / off.len() as f64;
            outcome =
                outcome.error(ErrorMeasure::new("luminance outside range, mean", mean, "of 255"));
        }
        Ok((Survey { frame, terrain, photo, trees, species }, outcome))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scan::system;

    #[test]
    fn feet_taken_for_metres_are_told() {
        let told = |origin, crs, highest: f32| {
            let frame = Frame { origin, crs };
            feet_for_metres((0..200).map(|i| highest * i as f32 / 199.0), &frame)
        };
        let (utm, plane) = (DVec3::new(5e5, 4e6, 0.0), DVec3::new(6.4e6, 1.9e6, 0.0));
        assert_eq!(told(utm, None, 50.0), None);
        assert_eq!(told(plane, None, 40.0), None);
        assert_eq!(told(plane, Some(system("EPSG:2229").unwrap()), 94.0), None);
        assert_eq!(feet_for_metres([].into_iter(), &Frame::local(plane)), None);
        // One of a hundred that is higher may be no tree.
        assert_eq!(
            feet_for_metres(
                (0..100).map(|i| if i == 7 { 300.0 } else { 30.0 }),
                &Frame::local(utm)
            ),
            None
        );
        insta::assert_snapshot!(told(utm, None, 94.0).unwrap(), @"trees come out 92 m high, more than forests grow: no coordinate system is stated, and feet may have been taken for metres; if so, give --crs with the EPSG code of the scan's system, as EPSG:2229 for California zone 5 in feet");
        insta::assert_snapshot!(told(plane, None, 60.0).unwrap(), @"trees come out 59 m high, more than forests grow, at coordinates as of a US state plane in feet: no coordinate system is stated, and feet may have been taken for metres; if so, give --crs with the EPSG code of the scan's system, as EPSG:2229 for California zone 5 in feet");
    }
}
