//! The light that comes along rays: what they met, lit by sun and sky (Phong), under weather.
//!
//! Rays of a pixel go through places spread evenly (the R2 sequence of Roberts 2018, begun elsewhere
//! in every pixel). What they meet is lit by a ray to a place on the sun and a few widening ones to the
//! sky. Known limits: light is not passed on from surface to surface; of mirrors water alone shows more
//! than the sky.

use std::ops::Range;

use glam::{DVec2, DVec3, Vec3};

use super::Landscape;
use super::grain::{clumps, drift, earth, litter, mottle};
use super::lens::Lens;
use super::pack::LANES;
use super::picture::{Mode, Shot};
use super::trace::{FINEST, Hit, Ray, Tracer, What};
use super::weather::{Drops, Skin};
use crate::render::sky::{BOUNCE_COLOUR, SKY_COLOUR, SUN_COLOUR, haze, sky};
use crate::seed::Stage;

/// Share of light the air takes a metre.
const HAZE_PER_M: f32 = 0.000_12;

/// The start of a sequence that begins at the middle.
const MIDDLE: u64 = 1 << 63 | 1 << 31;

/// The number-th of points spread evenly over the unit square, begun at two halves of `start`.
fn spread(number: u32, start: u64) -> DVec2 {
    // The plastic number's powers.
    const STEP: DVec2 = DVec2::new(0.754_877_666_246_693, 0.569_840_290_998_053);
    let first = DVec2::new((start >> 32) as f64, (start & 0xffff_ffff) as f64) / 4_294_967_296.0;
    (first + STEP * f64::from(number)).fract()
}

/// How far off the nearest fiftieth of what a picture shows is, in voxels, so that no single mast
/// decides; 0 from within the scene.
pub(super) fn nearest(scene: &Landscape, lens: &Lens, size: [u32; 2]) -> f64 {
    /// Rays across and down that tell it.
    const RAYS: u32 = 48;
    let far = Vec3::from(scene.reach().map(|side| side as f32)).as_dvec3();
    let outside = (lens.eye - lens.eye.clamp(DVec3::ZERO, far)).length();
    if outside <= 0.0 {
        return 0.0;
    }
    let mut tracer = Tracer::new(scene);
    let mut off = Vec::new();
    for (row, col) in (0..RAYS).flat_map(|row| (0..RAYS).map(move |col| (row, col))) {
        let at = DVec2::new(f64::from(col) + 0.5, f64::from(row) + 0.5) / f64::from(RAYS);
        let ray = lens.ray(at * DVec2::new(f64::from(size[0]), f64::from(size[1])), 1.0);
        if let Some(hit) = tracer.trace(&ray, 0.0, f64::INFINITY) {
            off.push(hit.t * ray.direction.length());
        }
    }
    off.sort_unstable_by(f64::total_cmp);
    off.get(off.len() / 50).copied().unwrap_or(outside)
}

/// What lights the scene.
pub(super) struct Light<'a> {
    scene: &'a Landscape,
    shot: &'a Shot,
    sun: Vec3,
    sun_colour: Vec3,
    /// Light of the sky from above.
    sky_colour: Vec3,
    /// Share of the light lost a voxel of distance, from so many voxels off the eye on: at the nearest
    /// that is seen.
    extinction: f32,
    near: f64,
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
/// How far waves turn what water mirrors, and how much further in heavy rain.
const RIPPLES: f32 = 0.05;
const RIPPLES_IN_RAIN: f32 = 0.35;
/// Brightness of water over that of its colour.
const STILL: f32 = 0.8;
/// Depth of snow that leaves hold, and that wind leaves on ice at most, metres.
const LEAVES_HOLD_M: f32 = 0.035;
const ICE_HOLDS_M: f32 = 0.08;
/// Share of the sun that crowns let through.
const THROUGH: f32 = 0.1;
/// Light from leaves and ground all around, over that of the open sky.
const CLOSED: f32 = 0.17;
/// The scene stands on a sheet of the backdrop's own colour, on which only its shadow shows: softer
/// than the sun's, and dimmed so far about it, over the scene's lesser side.
const TABLE_SUN_RADIUS: f32 = 0.03;
const TABLE_DIMMED: f32 = 0.2;

impl<'a> Light<'a> {
    pub fn new(scene: &'a Landscape, shot: &'a Shot, lens: &Lens) -> Light<'a> {
        let weather = &shot.weather;
        let sun_share = weather.sun();
        let rain = (weather.rain_mm / 2.0).min(1.0);
        let fog = 1.0 - if weather.fog_m > 0.0 { (weather.fog_m / 4000.0).min(1.0) } else { 1.0 };
        let overcast = rain.max(fog);
        let sun = shot.sun.try_normalize().unwrap_or(Vec3::Z);
        let [wide, deep, high] = scene.reach().map(|side| side as f32);
        let near = nearest(scene, lens, shot.size);
        let fall = high * sun.truncate().length() / sun.z.max(0.05);
        Light {
            scene,
            shot,
            sun,
            shadow: fall.max(TABLE_DIMMED * wide.min(deep)),
            sun_colour: SUN_COLOUR * sun_share,
            sky_colour: SKY_COLOUR.lerp(Vec3::splat(0.92 - 0.25 * rain), overcast),
            extinction: (HAZE_PER_M + weather.extinction_per_m()) * scene.voxel_m,
            near,
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
    pub fn line(
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
    pub fn along(
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
    pub fn seen(
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
                let distance = hit.t * ray.direction.length() - self.near;
                let clear = (-self.extinction * distance.max(0.0) as f32).exp();
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
        let up = normal.z;
        if is_leafy {
            // Clumps of leaves are rounded, and mostly seen from their lit side.
            normal = (normal + 0.35 * Vec3::Z + 0.25 * toward_eye).normalize_or(Vec3::Z);
        }
        let narrow = ray.breadth[1] * hit.t as f32;
        // Ground bluer than any soil is water.
        let water = match hit.what {
            What::Ground => {
                (4.0 * (ground.z - ground.x) / (ground.z + ground.x + 1e-3)).clamp(0.0, 1.0)
            }
            _ => 0.0,
        };
        let (mut shade, mut bump) = match hit.what {
            What::Vegetation => clumps(place, narrow, self.scene.boughs_in_voxel()),
            What::Ground => litter(place, self.scene.voxel_m, narrow),
            What::Cut(_) => (1.0, Vec3::ZERO),
        };
        shade += water * (STILL - shade);
        bump *= 1.0 - water;
        if is_leafy && narrow < FINEST {
            // Between leaves it is darker.
            let deep = (2.0 * tracer.density(place.as_vec3()) - 1.0).clamp(0.0, 1.0);
            shade *= 1.0 + (1.0 - narrow / FINEST) * (0.15 - 0.4 * deep);
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
        // Schlick's approximation, of water.
        let slant = 1.0 - normal.dot(toward_eye).clamp(0.0, 1.0);
        let gloss = if is_leafy { 0.02 } else { water * (0.02 + 0.98 * slant.powi(5)) };
        // Wind bares the ice.
        let ice_m = || ICE_HOLDS_M * drift(place, self.scene.voxel_m) / water.max(1e-3);
        let holds_m = match is_leafy {
            true => LEAVES_HOLD_M,
            false if water > 0.0 => ice_m(),
            false => f32::INFINITY,
        };
        let skin = Skin { albedo, normal, up: up + bump.z, holds_m, gloss };
        // Of what falls on leaves a part falls through.
        let caught = if is_leafy { 0.7 * open } else { open };
        let Skin { albedo, normal, gloss, .. } = self.shot.weather.settle(skin, caught);

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
        let sky = 0.5 + 0.5 * normal.z;
        let ambient =
            BOUNCE_COLOUR * ((1.0 - sky) * (0.4 + 0.6 * open)) + self.sky_colour * (sky * open);
        let diffuse = albedo * (self.sun_colour * (direct * sunlit) + ambient);
        // Phong's highlight, and the sky in what is wet.
        let weather = &self.shot.weather;
        let mirrored = normal * (2.0 * normal.dot(toward_eye)) - toward_eye;
        let spark = mirrored.dot(self.sun).max(0.0).powi(24) * sunlit;
        let shown = match water > 0.0 && gloss > 0.0 {
            true => {
                // Breath of wind, and drops.
                let ripples = RIPPLES + RIPPLES_IN_RAIN * (weather.rain_mm / 10.0).min(1.0);
                let off = (spread(number, start ^ other) - 0.5).as_vec2() * ripples;
                let towards = mirrored + Vec3::new(0.3 * off.y, 0.3 * off.y, off.x);
                self.mirrored(tracer, from, towards, breadth)
            }
            false => self.above(mirrored) * open,
        };
        diffuse * (1.0 - gloss * water) + (self.sun_colour * spark + shown) * gloss
    }

    /// What still water shows: the shore in its own colours, as bright as from all sides, or the sky.
    fn mirrored(&self, tracer: &mut Tracer<'_>, from: DVec3, towards: Vec3, breadth: f32) -> Vec3 {
        let direction = towards.with_z(towards.z.abs()).as_dvec3();
        let ray = Ray { origin: from, direction, breadth: [breadth, 0.01] };
        let Some(hit) = tracer.trace(&ray, 0.0, f64::INFINITY) else {
            return self.above(direction.as_vec3());
        };
        let place = from + direction * hit.t;
        let [ground, above] = self.scene.colours(place.x, place.y, breadth);
        let colour = if hit.what == What::Vegetation { above } else { ground };
        colour * (0.3 * self.sun_colour + 0.5 * self.sky_colour)
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
        match tracer.trace(&ray, 0.0, f64::INFINITY).map(|hit| hit.what) {
            None => 1.0,
            Some(What::Vegetation) => THROUGH,
            Some(_) => 0.0,
        }
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
            Some(hit) => CLOSED + (0.62 - CLOSED) * (hit.t as f32 / reach).min(1.0),
            None => 1.0,
        }
    }

    /// Where the sequences of a pixel's rays to the sun and to the sky begin.
    fn starts(&self, at: DVec2) -> [u64; 2] {
        let mut draws = self.draws.seed((at.x as u64) << 32 ^ at.y as u64).draws();
        [draws.bits(), draws.bits()]
    }
}
