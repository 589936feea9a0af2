//! Pictures of a landscape: what rays meet, lit by sun and sky (Phong), under weather.
//!
//! A picture is refined in passes: first one ray for a square of pixels, then more and more rays a
//! pixel at places spread evenly (the R2 sequence of Roberts 2018, begun elsewhere in every pixel).
//! Each is lit by a ray to a place on the sun and a few widening ones to the sky. The same bytes
//! come out on any number of threads, as every pixel sums its own rays in order. Known limits: light
//! is not passed on from surface to surface; mirrors show the sky alone.

use std::ops::Range;

use glam::{DVec2, DVec3, Vec3};
use rayon::prelude::*;

use super::Landscape;
use super::grain::{clumps, earth, litter, mottle};
use super::lens::{Lens, Outline};
use super::pack::LANES;
use super::splat;
use super::trace::{FINEST, Hit, Ray, Tracer, What};
use super::weather::{Drops, Skin, Weather};
use crate::diagnostic::{Error, Result};
use crate::raster::Picture;
use crate::render::sky::{BOUNCE_COLOUR, SKY_COLOUR, SUN_COLOUR, film, haze, sky};
use crate::render::{Camera, srgb_from_linear};
use crate::seed::{Seed, Stage};

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
/// Share of light the air takes a metre.
const HAZE_PER_M: f32 = 0.000_12;

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

    fn check(&self) -> Result<()> {
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

/// What is at each pixel's centre, row by row from the top.
#[derive(Debug, Clone, PartialEq)]
pub struct Layers {
    pub size: [u32; 2],
    /// Distance from the camera along its axis in metres; infinite where nothing is.
    pub depth_m: Vec<f32>,
    /// Away from the surface; zero where nothing is.
    pub normal: Vec<Vec3>,
    /// ASPRS class: 2 ground, 5 vegetation, 0 nothing.
    pub class: Vec<u8>,
}

/// Pixels along the side of the squares that threads take.
const TILE: usize = 16;
/// Pixels a side for one ray of the first pass.
const ROUGH: usize = 4;

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
        let (across, down) = (width.div_ceil(ROUGH), height.div_ceil(ROUGH));
        let rough: Vec<Vec3> = (0..down)
            .into_par_iter()
            .flat_map_iter(|row| {
                let mut tracer = Tracer::of_leaves(scene);
                let (light, lens) = (&light, &lens);
                (0..across).map(move |col| {
                    let at = (DVec2::new(col as f64, row as f64) + 0.5) * ROUGH as f64;
                    light.along(&mut tracer, &lens.ray(at, ROUGH as f64), at, 0, 1)
                })
            })
            .collect();
        rays.primary += rough.len() as u64;
        for (i, sum) in sums.iter_mut().enumerate() {
            *sum = rough[i / width / ROUGH * across + i % width / ROUGH];
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
        bands.into_par_iter().for_each_init(
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

/// The start of a sequence that begins at the middle.
const MIDDLE: u64 = 1 << 63 | 1 << 31;

/// The number-th of points spread evenly over the unit square, begun at two halves of `start`.
fn spread(number: u32, start: u64) -> DVec2 {
    // The plastic number's powers.
    const STEP: DVec2 = DVec2::new(0.754_877_666_246_693, 0.569_840_290_998_053);
    let first = DVec2::new((start >> 32) as f64, (start & 0xffff_ffff) as f64) / 4_294_967_296.0;
    (first + STEP * f64::from(number)).fract()
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

/// What is at the centre of each pixel.
///
/// # Errors
/// As [`draw`].
pub fn layers(scene: &Landscape, shot: &Shot) -> Result<Layers> {
    shot.check()?;
    let lens = scene.lens(&shot.camera, shot.size);
    let [width, height] = shot.size.map(|side| side as usize);
    let row = |row: usize| {
        let mut tracer = Tracer::of_leaves(scene);
        let pixel = move |col: usize| {
            let ray = lens.ray(DVec2::new(col as f64 + 0.5, row as f64 + 0.5), 1.0);
            let Some(hit) = tracer.trace(&ray, 0.0, f64::INFINITY) else {
                return (f32::INFINITY, Vec3::ZERO, 0);
            };
            let p = ray.origin + ray.direction * hit.t;
            let normal = tracer.normal(&hit, p, ray.breadth[1] * hit.t as f32);
            let class = if hit.what == What::Vegetation { 5 } else { 2 };
            ((hit.t * f64::from(scene.voxel_m)) as f32, normal, class)
        };
        (0..width).map(pixel).collect::<Vec<_>>()
    };
    let rows: Vec<Vec<(f32, Vec3, u8)>> = (0..height).into_par_iter().map(row).collect();
    let all = || rows.iter().flatten();
    Ok(Layers {
        size: shot.size,
        depth_m: all().map(|p| p.0).collect(),
        normal: all().map(|p| p.1).collect(),
        class: all().map(|p| p.2).collect(),
    })
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
    (0..bands).into_par_iter().map_init(|| Tracer::new(scene), |tracer, i| band(tracer, i)).sum()
}

/// What lights the scene.
struct Light<'a> {
    scene: &'a Landscape,
    shot: &'a Shot,
    sun: Vec3,
    sun_colour: Vec3,
    /// Light of the sky from above.
    sky_colour: Vec3,
    /// Share of the light lost a voxel of distance.
    extinction: f32,
    /// Of the sky itself: grey in rain and fog.
    overcast: f32,
    pixel: f32,
    /// Voxels about the scene as far as its shadow falls on what it stands on.
    shadow: f32,
    drops: Drops,
    /// Of the rays from what was met.
    draws: Stage,
}

/// Half the angle that the sun's disc takes, widened by the air about it.
const SUN_RADIUS: f32 = 0.012;
/// Metres up to which leaves and ground dim the sky.
const DIMMING_M: f32 = 18.0;
/// The scene stands on a sheet of the backdrop's own colour, on which only its shadow shows: softer
/// than the sun's, and dimmed so far about it, over the scene's lesser side.
const TABLE_SUN_RADIUS: f32 = 0.03;
const TABLE_DIMMED: f32 = 0.2;

impl<'a> Light<'a> {
    fn new(scene: &'a Landscape, shot: &'a Shot, lens: &Lens) -> Light<'a> {
        let weather = &shot.weather;
        let sun_share = weather.sun();
        let rain = (weather.rain_mm / 2.0).min(1.0);
        let fog = 1.0 - if weather.fog_m > 0.0 { (weather.fog_m / 4000.0).min(1.0) } else { 1.0 };
        let overcast = rain.max(fog);
        let sun = shot.sun.try_normalize().unwrap_or(Vec3::Z);
        let [wide, deep, high] = scene.reach().map(|side| side as f32);
        let fall = high * sun.truncate().length() / sun.z.max(0.05);
        Light {
            scene,
            shot,
            sun,
            shadow: fall.max(TABLE_DIMMED * wide.min(deep)),
            sun_colour: SUN_COLOUR * sun_share,
            sky_colour: SKY_COLOUR.lerp(Vec3::splat(0.92 - 0.25 * rain), overcast),
            extinction: (HAZE_PER_M + weather.extinction_per_m()) * scene.voxel_m,
            overcast,
            pixel: lens.pixel as f32,
            drops: Drops::new(shot.seed, weather, shot.size),
            draws: shot.seed.stage("light"),
        }
    }

    fn air(&self, direction: Vec3) -> Vec3 {
        haze(direction, self.sun).lerp(Vec3::splat(0.80 - 0.2 * self.overcast), self.overcast)
    }

    fn above(&self, direction: Vec3) -> Vec3 {
        let clear = sky(direction, self.sun);
        let up = direction.normalize_or_zero().z.max(0.0);
        clear.lerp(Vec3::splat(0.66 + 0.18 * up), self.overcast)
    }

    /// Share of its light that is left of what the scene stands on, where a ray meets that.
    fn table(&self, tracer: &mut Tracer<'_>, ray: &Ray, at: DVec2, number: u32) -> f32 {
        let (o, d) = (ray.origin, ray.direction);
        if !(o.z > 0.0 && d.z < 0.0) || self.scene.is_empty() {
            return 1.0;
        }
        let t = -o.z / d.z;
        let place = (o + d * t).with_z(0.0);
        let [wide, deep, _] = self.scene.sides.map(f64::from);
        let off = (place - place.clamp(DVec3::ZERO, DVec3::new(wide, deep, 0.0))).length() as f32;
        if off > self.shadow {
            return 1.0;
        }
        let breadth = (ray.breadth[1] * t as f32).max(1.0);
        let [start, other] = self.starts(at);
        let lit = self.sunlit(tracer, place, breadth, TABLE_SUN_RADIUS, spread(number, start));
        let reach = TABLE_DIMMED * wide.min(deep) as f32;
        let open = self.open(tracer, place, Vec3::Z, breadth, reach, spread(number, other));
        let clear = 1.0 - self.overcast;
        (1.0 - 0.42 * clear * (1.0 - lit)) * (1.0 - 0.4 * (1.0 - open))
    }

    /// Adds the light of rays of these numbers to pixels beside each other, of which `first` is the
    /// first one's column and row; whether they may meet anything.
    fn line(
        &self,
        tracer: &mut Tracer<'_>,
        lens: &Lens,
        sums: &mut [Vec3],
        first: [usize; 2],
        (numbers, is_seen): (Range<u32>, bool),
    ) {
        let Shot { effort, seed, mode, size, .. } = *self.shot;
        let (share, sky_rays) = if effort > 1 { (0.7, 1) } else { (1.0, 2) };
        let starts: [u64; LANES] = std::array::from_fn(|lane| {
            let key = (first[1] * size[0] as usize + first[0] + lane) as u64;
            if effort > 1 { seed.derive("pixel", key).draws().bits() } else { MIDDLE }
        });
        for number in numbers {
            let places: [DVec2; LANES] = std::array::from_fn(|lane| {
                let corner = DVec2::new((first[0] + lane) as f64, first[1] as f64);
                corner + spread(number, starts[lane])
            });
            let rays = places.map(|at| lens.ray(at, share));
            let hits = match mode {
                Mode::Surface if is_seen => tracer.trace_all(&rays),
                _ => [None; LANES],
            };
            for (lane, sum) in sums.iter_mut().enumerate() {
                *sum += match mode {
                    Mode::Densest => self.densest(tracer, &rays[lane]),
                    _ => self.seen(tracer, &rays[lane], hits[lane], places[lane], number, sky_rays),
                };
            }
        }
    }

    /// Light that comes along a ray from the camera.
    fn along(
        &self,
        tracer: &mut Tracer<'_>,
        ray: &Ray,
        at: DVec2,
        number: u32,
        sky_rays: u32,
    ) -> Vec3 {
        if self.shot.mode == Mode::Densest {
            return self.densest(tracer, ray);
        }
        let hit = tracer.trace(ray, 0.0, f64::INFINITY);
        self.seen(tracer, ray, hit, at, number, sky_rays)
    }

    fn densest(&self, tracer: &mut Tracer<'_>, ray: &Ray) -> Vec3 {
        let (density, ground) = tracer.densest(ray);
        let back = match ground {
            Some(Hit { what: What::Cut(_), .. }) => Vec3::splat(0.06),
            Some(hit) => {
                let p = ray.origin + ray.direction * hit.t;
                let normal = self.scene.slope(p.x, p.y, f64::from(self.pixel) * hit.t);
                Vec3::splat(0.05 + 0.10 * normal.dot(self.sun).max(0.0))
            }
            None => Vec3::splat(0.02),
        };
        let hot = density.sqrt();
        // Nothing behind shines through what is dense, so that no seam shows where the ground ends.
        let clear = (1.0 - hot / 0.4).max(0.0);
        back * clear + Vec3::new(1.6 * hot * hot, 1.9 * hot, 0.9 * hot * hot * hot) * hot
    }

    /// Light along a ray that met `hit`.
    fn seen(
        &self,
        tracer: &mut Tracer<'_>,
        ray: &Ray,
        hit: Option<Hit>,
        at: DVec2,
        number: u32,
        sky_rays: u32,
    ) -> Vec3 {
        let direction = ray.direction.as_vec3();
        let weather = &self.shot.weather;
        let mut light = match hit {
            None => self.above(direction) * self.table(tracer, ray, at, number),
            Some(hit) => {
                let lit = self.lit(tracer, ray, &hit, at, number, sky_rays);
                // Air is where the scene is: what is shown whole from afar is not lost on the way.
                let inside = hit.t - tracer.entry(ray);
                let distance = (inside * ray.direction.length()).max(0.0) as f32;
                let clear = (-self.extinction * distance).exp();
                lit * clear + self.air(direction) * (1.0 - clear)
            }
        };
        if weather.rain_mm > 0.0 {
            let streaks = self.drops.streaks(at.as_vec2(), self.shot.size[1] as f32);
            light += Vec3::new(0.75, 0.8, 0.88) * streaks;
        }
        if weather.fog_m > 0.0 && hit.is_none() {
            // The sky behind fog, thicker towards the horizon.
            let up = direction.normalize_or_zero().z.max(0.02);
            let through = (-weather.extinction_per_m() * 250.0 / up).exp();
            light = light * through + self.air(direction) * (1.0 - through);
        }
        light
    }

    fn lit(
        &self,
        tracer: &mut Tracer<'_>,
        ray: &Ray,
        hit: &Hit,
        at: DVec2,
        number: u32,
        sky_rays: u32,
    ) -> Vec3 {
        let place = ray.origin + ray.direction * hit.t;
        let breadth = (ray.breadth[1] * hit.t as f32).max(0.5);
        let mut normal = tracer.normal(hit, place, breadth);
        let toward_eye = -ray.direction.as_vec3().normalize_or(Vec3::NEG_Z);
        let [ground, above] = self.scene.colours(place.x, place.y, breadth);
        let is_leafy = hit.what == What::Vegetation;
        if is_leafy {
            // Clumps of leaves are rounded, and mostly seen from their lit side.
            normal = (normal + 0.35 * Vec3::Z + 0.25 * toward_eye).normalize_or(Vec3::Z);
        }
        let narrow = ray.breadth[1] * hit.t as f32;
        let (mut shade, bump) = match hit.what {
            What::Vegetation => clumps(place, narrow),
            What::Ground => litter(place, self.scene.voxel_m, narrow),
            What::Cut(_) => (1.0, Vec3::ZERO),
        };
        if is_leafy && narrow < FINEST {
            // Between leaves it is darker.
            let deep = (2.0 * tracer.density(place.as_vec3()) - 1.0).clamp(0.0, 1.0);
            shade *= 1.0 + (1.0 - narrow / FINEST) * (0.15 - 0.6 * deep);
        }
        normal = (normal + bump).normalize_or(Vec3::Z);
        let albedo = match hit.what {
            What::Ground => ground * shade,
            What::Vegetation => above * mottle(place) * shade,
            What::Cut(_) => earth(place, self.scene.height(place.x, place.y), self.scene.voxel_m),
        };
        // Off the surface that was met, by what it may be wrong.
        let lift = f64::from(hit.size as f32 * 0.6 + breadth * 0.5);
        let from = place + normal.as_dvec3() * lift;
        let reach = DIMMING_M / self.scene.voxel_m;
        let [start, other] = self.starts(at);
        let mut open = 0.0;
        for ray in 0..sky_rays {
            let sample = spread(number * sky_rays + ray, other);
            open += self.open(tracer, from, normal, breadth, reach, sample);
        }
        open /= sky_rays.max(1) as f32;
        let skin = Skin { albedo, normal, gloss: if is_leafy { 0.02 } else { 0.0 } };
        // Of what falls on leaves a part falls through.
        let caught = if is_leafy { 0.7 * open } else { open };
        let Skin { albedo, normal, gloss } = self.shot.weather.settle(skin, caught);

        let facing = normal.dot(self.sun);
        let direct = if is_leafy {
            // Leaves pass light on.
            (0.8 * facing.max(0.0) + 0.28 * (facing + 0.6).max(0.0)) * 0.86
        } else {
            facing.max(0.0)
        };
        let sunlit = if direct > 0.0 && self.sun_colour.max_element() > 0.02 {
            self.sunlit(tracer, from, breadth, SUN_RADIUS, spread(number, start))
        } else {
            0.0
        };
        let up = 0.5 + 0.5 * normal.z;
        let ambient =
            BOUNCE_COLOUR * ((1.0 - up) * (0.4 + 0.6 * open)) + self.sky_colour * (up * open);
        let diffuse = albedo * (self.sun_colour * (direct * sunlit) + ambient);
        // Phong's highlight, and the sky in what is wet.
        let mirrored = normal * (2.0 * normal.dot(toward_eye)) - toward_eye;
        let spark = mirrored.dot(self.sun).max(0.0).powi(24) * sunlit;
        diffuse + (self.sun_colour * spark + self.above(mirrored) * open) * gloss
    }

    /// Share of the sun's disc that a place sees, by one ray.
    fn sunlit(
        &self,
        tracer: &mut Tracer<'_>,
        from: DVec3,
        breadth: f32,
        radius: f32,
        sample: DVec2,
    ) -> f32 {
        if !self.shot.shadows {
            return 1.0;
        }
        let side = self.sun.any_orthonormal_vector();
        let sample = sample.as_vec2();
        let (sin, cos) = (std::f32::consts::TAU * sample.x).sin_cos();
        let off = sample.y.sqrt() * radius;
        let towards = self.sun + (side * cos + self.sun.cross(side) * sin) * off;
        let ray =
            Ray { origin: from, direction: towards.as_dvec3(), breadth: [0.7 * breadth, 0.002] };
        if tracer.trace(&ray, 0.0, f64::INFINITY).is_some() { 0.0 } else { 1.0 }
    }

    /// Share of the sky that a place sees, by a ray that widens, so that a few steps do.
    fn open(
        &self,
        tracer: &mut Tracer<'_>,
        from: DVec3,
        normal: Vec3,
        breadth: f32,
        reach: f32,
        sample: DVec2,
    ) -> f32 {
        // Around the upper half space, more towards the normal.
        let sample = sample.as_vec2();
        let z = 0.15 + 0.85 * sample.x.sqrt();
        let (sin, cos) = (std::f32::consts::TAU * sample.y).sin_cos();
        let flat = (1.0 - z * z).max(0.0).sqrt();
        let ball = Vec3::new(cos * flat, sin * flat, z);
        let towards = (ball + 0.6 * normal).normalize_or(Vec3::Z);
        let ray =
            Ray { origin: from, direction: towards.as_dvec3(), breadth: [breadth.max(1.0), 0.12] };
        match tracer.trace(&ray, 0.0, f64::from(reach)) {
            Some(hit) => 0.12 + 0.5 * (hit.t as f32 / reach).min(1.0),
            None => 1.0,
        }
    }

    /// Where the sequences of a pixel's rays to the sun and to the sky begin.
    fn starts(&self, at: DVec2) -> [u64; 2] {
        let mut draws = self.draws.seed((at.x as u64) << 32 ^ at.y as u64).draws();
        [draws.bits(), draws.bits()]
    }
}
