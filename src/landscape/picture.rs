//! Pictures of a landscape: what rays meet, lit by sun and sky (Phong), under weather.
//!
//! A picture is refined in passes: first one ray for a square of pixels, then more and more rays a
//! pixel. The same bytes come out on any number of threads, as every pixel sums its own rays in order.

use glam::{DVec2, Vec3};
use rayon::prelude::*;

use super::Landscape;
use super::lens::{Lens, Outline};
use super::light::Light;
use super::pack::LANES;
use super::splat;
use super::trace::{Ray, Tracer};
use super::weather::Weather;
use crate::diagnostic::{Error, Result};
use crate::raster::{Picture, srgb_from_linear};
use crate::render::Camera;
use crate::render::sky::film;
use crate::seed::Seed;

/// How voxels are shown (TD17).
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Mode {
    /// The surface that rays meet.
    #[default]
    Surface,
    /// The greatest density on the way of each ray (maximum intensity projection).
    Densest,
    /// Every voxel as a square of its size.
    Splat,
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Shot {
    pub camera: Camera,
    /// Pixels along x and y, 1…16384.
    pub size: [u32; 2],
    /// Rays a pixel, 1…4096.
    pub effort: u32,
    pub mode: Mode,
    pub weather: Weather,
    /// Towards the sun.
    pub sun: Vec3,
    pub shadows: bool,
    pub exposure: f32,
    pub seed: Seed,
}

/// Pixels along the side of a picture, at most.
pub const MOST_PIXELS: u32 = 16_384;
/// Pixels of a picture, at most: with all that is kept of them they take some gigabytes.
const MOST_AREA: u64 = 36_000_000;

impl Shot {
    pub fn new(camera: Camera, size: [u32; 2]) -> Shot {
        Shot {
            camera,
            size,
            effort: 8,
            mode: Mode::Surface,
            weather: Weather::default(),
            sun: Vec3::new(-0.62, -0.36, 0.70),
            shadows: true,
            exposure: 0.52,
            seed: Seed::new(1),
        }
    }

    pub(super) fn check(&self) -> Result<()> {
        if self.size.iter().any(|side| !(1..=MOST_PIXELS).contains(side)) {
            let [width, height] = self.size;
            return Err(Error::new(format!("a picture of {width} × {height} pixels"))
                .remedy(format!("give sides of 1 to {MOST_PIXELS} pixels")));
        }
        if self.size.map(u64::from).iter().product::<u64>() > MOST_AREA {
            let [width, height] = self.size;
            return Err(Error::new(format!("a picture of {width} × {height} pixels"))
                .remedy(format!("give a --size of at most {MOST_AREA} pixels in all")));
        }
        let Camera { eye, target, fov_y_rad } = self.camera;
        if !(eye.is_finite() && target.is_finite() && (target - eye).length() > 1e-6) {
            return Err(Error::new("the camera looks at its own place")
                .remedy("give --camera two different points"));
        }
        if !(fov_y_rad > 0.0 && fov_y_rad < 3.1) {
            return Err(Error::new(format!("an angle of view of {fov_y_rad} rad")));
        }
        Ok(())
    }
}

/// Pixels along the side of the squares that threads take.
const TILE: usize = 16;
/// Pixels a side for one ray of the first pass, at least, and rays of it at most, so that it is there
/// at once.
const ROUGH: usize = 4;
const ROUGH_RAYS: usize = 60_000;

/// Counts of a finished picture.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Rays {
    /// From the camera.
    pub primary: u64,
}

/// Draws `shot`; `progress` is shown each pass with the rays a pixel that it holds (0 for the first
/// rough one), and ends the work when it says so.
///
/// # Errors
/// Sizes out of range, a camera that looks nowhere, and those of `progress`.
pub fn draw(
    scene: &Landscape,
    shot: &Shot,
    mut progress: impl FnMut(&Picture, u32) -> Result<bool>,
) -> Result<(Picture, Rays)> {
    shot.check()?;
    let [width, height] = shot.size.map(|side| side as usize);
    let lens = scene.lens(&shot.camera, shot.size);
    let outline = Outline::new(&lens, scene.reach());
    let light = Light::new(scene, shot, &lens);
    let mut rays = Rays::default();
    let sky_rays = if shot.effort > 1 { 1 } else { 2 };
    let mut sums = vec![Vec3::ZERO; width * height];
    if shot.mode == Mode::Splat {
        let hits = splat::splat(scene, &lens, shot.size);
        let lit = |(row, line): (usize, &mut [Vec3])| {
            let mut tracer = Tracer::of_leaves(scene);
            for (col, sum) in line.iter_mut().enumerate() {
                let at = DVec2::new(col as f64 + 0.5, row as f64 + 0.5);
                let ray = lens.ray(at, 1.0);
                *sum = light.seen(&mut tracer, &ray, hits[row * width + col], at, 0, sky_rays);
            }
        };
        sums.par_chunks_mut(width).enumerate().for_each(lit);
        rays.primary = (width * height) as u64;
        return Ok((developed(&sums, shot, 1.0), rays));
    }
    if shot.effort > 1 {
        let side = ((width * height).div_ceil(ROUGH_RAYS) as f64).sqrt().ceil() as usize;
        let side = side.max(ROUGH);
        let (across, down) = (width.div_ceil(side), height.div_ceil(side));
        let rough: Vec<Vec3> = (0..down)
            .into_par_iter()
            .flat_map_iter(|row| {
                let mut tracer = Tracer::of_leaves(scene);
                let (light, lens) = (&light, &lens);
                (0..across).map(move |col| {
                    let at = (DVec2::new(col as f64, row as f64) + 0.5) * side as f64;
                    light.along(&mut tracer, &lens.ray(at, side as f64), at, 0, 1)
                })
            })
            .collect();
        rays.primary += rough.len() as u64;
        for (i, sum) in sums.iter_mut().enumerate() {
            *sum = rough[i / width / side * across + i % width / side];
        }
        if !progress(&developed(&sums, shot, 1.0), 0)? {
            return Ok((developed(&sums, shot, 1.0), rays));
        }
        sums.fill(Vec3::ZERO);
    }
    let mut done = 0;
    while done < shot.effort {
        // Each pass doubles what there is.
        let pass = done..(done.max(1) + done).min(shot.effort);
        let bands: Vec<(usize, &mut [Vec3])> = sums.chunks_mut(width * TILE).enumerate().collect();
        bands.into_par_iter().with_max_len(1).for_each_init(
            || Tracer::of_leaves(scene),
            |tracer, (band, sums)| {
                let rows = sums.len() / width;
                for left in (0..width).step_by(TILE) {
                    let may_meet = is_seen(&outline, &lens, [left, band * TILE]);
                    let right = width.min(left + TILE);
                    for row in 0..rows {
                        for first in (left..right).step_by(LANES) {
                            let lanes = LANES.min(right - first);
                            let line = &mut sums[row * width + first..][..lanes];
                            let corner = [first, band * TILE + row];
                            light.line(tracer, &lens, line, corner, (pass.clone(), may_meet));
                        }
                    }
                }
            },
        );
        rays.primary += (width * height) as u64 * u64::from(pass.end - pass.start);
        done = pass.end;
        if done < shot.effort && !progress(&developed(&sums, shot, done as f32), done)? {
            break;
        }
    }
    Ok((developed(&sums, shot, done as f32), rays))
}

fn developed(sums: &[Vec3], shot: &Shot, rays: f32) -> Picture {
    let dither = shot.seed.stage("dither");
    let pixel = |(i, sum): (usize, &Vec3)| {
        // Less than a step of eight bits, so that skies show none.
        let dither = dither.seed(i as u64).draws().unit();
        let byte = |c: f32| (srgb_from_linear(c) + dither) as u8;
        let [r, g, b] = film(*sum / rays, shot.exposure).to_array().map(byte);
        [r, g, b, 255]
    };
    let data = sums.par_iter().enumerate().map(pixel).collect();
    Picture { width: shot.size[0], height: shot.size[1], data }
}

/// Whether a ray of a tile of pixels may meet anything; `first` is the tile's first column and row.
fn is_seen(outline: &Outline, lens: &Lens, first: [usize; 2]) -> bool {
    let low = DVec2::new(first[0] as f64, first[1] as f64);
    outline.is_seen(lens, low, low + TILE as f64)
}

/// Casts the rays of pixels and gives what they met, to measure how fast that is.
pub fn count_hits(scene: &Landscape, shot: &Shot) -> u64 {
    let lens = scene.lens(&shot.camera, shot.size);
    let outline = Outline::new(&lens, scene.reach());
    let [width, height] = shot.size.map(|side| side as usize);
    let bands = height.div_ceil(TILE);
    let band = |tracer: &mut Tracer<'_>, band: usize| {
        let mut hits = 0;
        for left in (0..width).step_by(TILE) {
            if !is_seen(&outline, &lens, [left, band * TILE]) {
                continue;
            }
            for row in band * TILE..height.min((band + 1) * TILE) {
                for first in (left..width.min(left + TILE)).step_by(LANES) {
                    let rays: [Ray; LANES] = std::array::from_fn(|lane| {
                        let at = DVec2::new((first + lane) as f64 + 0.5, row as f64 + 0.5);
                        lens.ray(at, 1.0)
                    });
                    let met = tracer.trace_all(&rays);
                    hits += met.iter().take(width - first).flatten().count() as u64;
                }
            }
        }
        hits
    };
    // Band by band, as those that meet much take long.
    let bands = (0..bands).into_par_iter().with_max_len(1);
    bands.map_init(|| Tracer::new(scene), |tracer, i| band(tracer, i)).sum()
}
