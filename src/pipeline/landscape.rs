//! A scan to its voxel landscape, and that to pictures.

use std::path::Path;

use super::survey::{self, SurveyJob, Whole};
use super::view::{self, Eye};
use crate::diagnostic::{Error, Result};
use crate::frame::Frame;
use crate::landscape::{self, Columns, Detail, Landscape, Layers, Rays, Shot};
use crate::raster::Picture;
use crate::render::Camera;
use crate::report::{ErrorMeasure, Outcome, Recorder};

/// What is kept of a scan where nothing else is asked for.
pub const DETAIL: Detail = Detail { density_bits: 2, height_stride: 4, colour_stride: 2 };

/// Voxels of an edge that is asked for, along a scan's greater side, at least.
const FEWEST_ACROSS: f32 = 4.0;

/// A scan in columns of voxels, and where it is.
pub struct Voxelized {
    pub columns: Columns,
    pub frame: Frame,
    pub voxel_m: f32,
    /// As it was asked for, but heights and colours no closer than what they come from.
    pub detail: Detail,
}

/// Scan to columns of voxels. Species and trees are not looked for.
///
/// # Errors
/// Those of [`survey::terrain`]; an unreadable photo; voxels too small or too large.
pub fn voxelize(job: &SurveyJob, detail: &Detail, run: &mut Recorder) -> Result<Voxelized> {
    let raster = job.photo.as_deref().map(survey::photo_raster).transpose()?;
    let (Whole { classified, density_per_m2, bounds }, terrain) = survey::classified(job, run)?;
    let frame = classified.cloud.frame.clone();
    let photo = survey::place_photo(job, run, raster, &frame, bounds)?;
    let extent_m = (bounds.max - bounds.min).truncate();
    let most_m = (extent_m.max_element() / FEWEST_ACROSS).max(1.0);
    if let Some(voxel_m) = job.voxel_m.filter(|voxel_m| *voxel_m > most_m) {
        return Err(Error::new(format!(
            "voxels of {voxel_m} m over {:.0} × {:.0} m",
            extent_m.x, extent_m.y
        ))
        .in_file(&job.scans[0])
        .remedy(format!("give a --voxel of at most {most_m:.1}")));
    }
    let closest_m = survey::voxel_m(job, density_per_m2);
    let mut voxel_m = job
        .voxel_m
        .unwrap_or_else(|| landscape::connected_voxel_m(&classified, &terrain, closest_m));
    let least_m = Columns::least_voxel_m(extent_m);
    let edge_from = if job.voxel_m.is_some() {
        "as asked for".to_owned()
    } else if voxel_m < least_m {
        run.warnings.push(format!(
            "voxels of {voxel_m:.2} m would be too many over so wide an area: they are {least_m:.2} m; \
             for finer ones give its parts in runs of their own"
        ));
        voxel_m = least_m;
        "the least that are not too many".to_owned()
    } else if voxel_m > closest_m {
        format!("the density of the scan suggests {closest_m:.2}, in which crowns fall apart")
    } else {
        "from the density of the scan".to_owned()
    };
    let colour_m = photo.as_ref().map_or(density_per_m2.max(1e-3).sqrt().recip(), |p| p.pixel_m());
    let within = |source_m: f32| {
        let voxels = (source_m / voxel_m).clamp(1.0, 64.0) as u32;
        1 << voxels.ilog2()
    };
    let detail = &Detail {
        height_stride: within(terrain.heights.geometry.cell_x as f32).max(detail.height_stride),
        colour_stride: within(colour_m).max(detail.colour_stride),
        ..*detail
    };
    run.stage("voxels", |_| {
        let sample = photo.as_ref().map(|photo| move |p| photo.sample(p));
        let seen = sample.as_ref().map(|sample| sample as landscape::Seen<'_>);
        let (columns, from) = Columns::of_scan(&classified, &terrain, seen, voxel_m, detail)
            .map_err(|e| e.in_file(&job.scans[0]))?;
        let outcome = Outcome::items(classified.cloud.len(), "points", columns.len(), "voxels")
            .note(format!("edge {voxel_m:.2} m: {edge_from}"))
            .note(format!("colours from {}", from.text()));
        Ok((Voxelized { columns, frame, voxel_m, detail: *detail }, outcome))
    })
}

/// Scan to landscape.
///
/// # Errors
/// Those of [`voxelize`].
pub fn build(job: &SurveyJob, detail: &Detail, run: &mut Recorder) -> Result<Landscape> {
    let Voxelized { columns, frame, voxel_m, detail } = voxelize(job, detail, run)?;
    run.stage("landscape", |_| {
        let (scene, tally) = Landscape::build(&columns, &detail, frame, columns.first_m, voxel_m)?;
        let memory = scene.memory();
        let off = landscape::surface_error(&scene, &columns);
        let outcome = Outcome::items(tally.bricks as usize, "bricks", memory.total(), "bytes")
            .error(ErrorMeasure::new("ground off its terrain, RMS", off.ground_rms_m, "m"))
            .note(format!("ground at worst {:.2} m off its terrain", off.ground_worst_m))
            .note(format!("{} of {voxel_m:.2} m", sides(scene.voxels())))
            .note(format!(
                "{:.2} MB: voxels {:.2}, heights {:.2}, colours {:.2}",
                megabytes(memory.total()),
                megabytes(memory.voxels),
                megabytes(memory.heights),
                megabytes(memory.colours)
            ));
        Ok((scene, outcome))
    })
}

/// Reads a landscape that was saved.
///
/// # Errors
/// A file that is none, or is broken.
pub fn load(path: &Path, run: &mut Recorder) -> Result<Landscape> {
    run.stage("landscape", |_| {
        let scene = Landscape::read(path)?;
        let outcome = Outcome::items(1, "files", scene.memory().total(), "bytes")
            .note(format!("{} of {:.2} m", sides(scene.voxels()), scene.voxel_m()))
            .note(format!("{:.2} MB", megabytes(scene.memory().total())));
        Ok((scene, outcome))
    })
}

/// A camera in the scan's own coordinates, in those of the landscape, for pictures of `size` pixels.
///
/// # Errors
/// A camera below the ground or within a crown, or that sees nothing of the landscape.
pub fn camera(scene: &Landscape, eye: &Eye, size: [u32; 2]) -> Result<Camera> {
    /// Pixels a side by which it is told whether anything is seen.
    const ENOUGH: u32 = 2000;
    let camera = view::camera(&scene.frame, eye);
    let (x, y, z) = (eye.at.x, eye.at.y, eye.at.z);
    if let Some(ground) = scene.ground_m(camera.eye).filter(|ground| camera.eye.z < *ground) {
        let height = scene.frame.world_from_local(camera.eye.with_z(ground)).z;
        return Err(Error::new(format!(
            "the camera at {x},{y},{z} is below the ground, which is {height:.2} high there"
        ))
        .remedy(format!("give --camera a third number above {height:.2}")));
    }
    if let Some(up_m) = scene.within_m(camera.eye) {
        let free = scene.frame.world_from_local(camera.eye + glam::Vec3::Z * up_m).z;
        return Err(Error::new(format!("the camera at {x},{y},{z} is within a crown"))
            .remedy(format!("give --camera another place, or a third number above {free:.2}")));
    }
    let shot = Shot::new(camera, size.map(|side| side.min(ENOUGH)));
    if !scene.is_empty() && landscape::count_hits(scene, &shot) == 0 {
        let [low, high] = scene.bounds_m().map(|p| scene.frame.world_from_local(p));
        let corner = |p: glam::DVec3| format!("{:.0},{:.0},{:.0}", p.x, p.y, p.z);
        return Err(Error::new(format!(
            "the camera at {x},{y},{z} sees nothing of the landscape, which reaches from {} to {}",
            corner(low),
            corner(high)
        ))
        .remedy("give --camera a place to look at that lies between these corners"));
    }
    Ok(camera)
}

/// Draws, showing each pass to `progress`.
///
/// # Errors
/// Those of [`landscape::draw`].
pub fn draw(
    scene: &Landscape,
    shot: &Shot,
    run: &mut Recorder,
    progress: impl FnMut(&Picture, u32) -> Result<bool>,
) -> Result<Picture> {
    run.stage("picture", |_| {
        let started = std::time::Instant::now();
        let (picture, Rays { primary }) = landscape::draw(scene, shot, progress)?;
        let rate = primary as f64 / started.elapsed().as_secs_f64().max(1e-9) / 1e6;
        let [width, height] = shot.size.map(|side| side as usize);
        let outcome = Outcome::items(width * height, "pixels", primary as usize, "rays")
            .note(format!("{rate:.2} million rays/s from the camera, with light"));
        Ok((picture, outcome))
    })
}

/// Depth, normals and classes of a picture's pixels.
///
/// # Errors
/// Those of [`landscape::layers`].
pub fn layers(scene: &Landscape, shot: &Shot, run: &mut Recorder) -> Result<Layers> {
    run.stage("layers", |_| {
        let layers = landscape::layers(scene, shot)?;
        let seen = layers.class.iter().filter(|class| **class != 0).count();
        let pixels = layers.class.len();
        Ok((layers, Outcome::items(pixels, "pixels", seen, "pixels of something")))
    })
}

/// Whether the scans named are a saved landscape.
///
/// # Errors
/// A saved landscape among scans.
pub fn is_saved(scans: &[std::path::PathBuf]) -> Result<bool> {
    match scans.iter().find(|path| Landscape::is_stored(path)) {
        Some(_) if scans.len() == 1 => Ok(true),
        Some(path) => Err(Error::new("a saved landscape beside other files")
            .in_file(path)
            .remedy("give one saved landscape, or scans only")),
        None => Ok(false),
    }
}

fn sides([x, y, z]: [u32; 3]) -> String {
    format!("{x} × {y} × {z} voxels")
}

fn megabytes(bytes: usize) -> f64 {
    bytes as f64 / 1e6
}
