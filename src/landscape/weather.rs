//! Snow, fog and rain as a recolouring of what rays met (TD17): nothing of the scene is rebuilt.
//!
//! Snow settles by slope and by how much of the sky a place sees. Fog fades colours exponentially
//! with the distance. Rain greys the light, darkens what is wet, lets it shine, and draws streaks.

use glam::{Vec2, Vec3};

use crate::seed::{Seed, Stage};

/// What the weather does; zeros do nothing.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Weather {
    /// Depth of fresh snow in the open, metres.
    pub snow_m: f32,
    /// Distance at which a black thing is lost in fog (contrast 5 %), metres; 0 for none.
    pub fog_m: f32,
    /// Millimetres of rain an hour.
    pub rain_mm: f32,
}

/// Contrast below which nothing is seen.
const LEAST_CONTRAST: f32 = 0.05;
/// Depth that hides most of what is under it.
const HIDING_M: f32 = 0.06;
const SNOW: Vec3 = Vec3::new(0.86, 0.89, 0.93);

/// A place as weather changes it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Skin {
    /// Linear.
    pub albedo: Vec3,
    pub normal: Vec3,
    /// Share of the light of the sky that it mirrors.
    pub gloss: f32,
}

/// Where drops are in a picture.
#[derive(Debug, Clone, Copy)]
pub(super) struct Drops {
    columns: Stage,
    drops: Stage,
}

impl Drops {
    pub fn new(seed: Seed) -> Drops {
        Drops { columns: seed.stage("rain"), drops: seed.stage("drop") }
    }
}

impl Weather {
    /// Light lost a metre.
    pub fn extinction_per_m(&self) -> f32 {
        let lost = -LEAST_CONTRAST.ln();
        let fog = if self.fog_m > 0.0 { lost / self.fog_m } else { 0.0 };
        // Visibility in rain falls with about the 0.63rd power of its rate.
        let rain =
            if self.rain_mm > 0.0 { lost / (22_000.0 * self.rain_mm.powf(-0.63)) } else { 0.0 };
        fog + rain
    }

    /// Share of direct sunlight that is left.
    pub fn sun(&self) -> f32 {
        let clouds = (self.rain_mm / 2.0).min(1.0);
        let fog = if self.fog_m > 0.0 { (self.fog_m / 4000.0).min(1.0) } else { 1.0 };
        (1.0 - 0.92 * clouds) * (0.15 + 0.85 * fog)
    }

    /// What snow and rain make of a place that sees `open` of the sky.
    pub(super) fn settle(&self, skin: Skin, open: f32) -> Skin {
        let Skin { mut albedo, mut normal, mut gloss } = skin;
        if self.rain_mm > 0.0 {
            let wet = (self.rain_mm / 4.0).min(1.0) * (0.35 + 0.65 * open);
            // Water between grains passes light on instead of scattering it back.
            albedo *= 1.0 - 0.45 * wet;
            gloss = (0.22 * wet * normal.z.max(0.0)).max(gloss);
        }
        if self.snow_m > 0.0 {
            let steep = ((normal.z - 0.15) / 0.5).clamp(0.0, 1.0);
            let lies = steep * steep * (3.0 - 2.0 * steep) * open.clamp(0.0, 1.0);
            let cover = 1.0 - (-self.snow_m * lies * 2.0 / HIDING_M).exp();
            albedo = albedo.lerp(SNOW, cover);
            // A deep layer rounds what is under it.
            let round = cover * (self.snow_m / 0.5).min(0.6);
            normal = normal.lerp(Vec3::Z, round).normalize_or(Vec3::Z);
            gloss *= 1.0 - cover;
        }
        Skin { albedo, normal, gloss }
    }

    /// Brightness of the drops in front of a place in the picture, which is `height` pixels high.
    pub(super) fn streaks(&self, at: Vec2, height: f32, drops: &Drops) -> f32 {
        if self.rain_mm <= 0.0 {
            return 0.0;
        }
        let at = at / height;
        let amount = (self.rain_mm / 30.0).clamp(0.05, 1.0);
        let mut light = 0.0;
        for (layer, size) in [0.10f32, 0.055, 0.03].into_iter().enumerate() {
            // Drops fall aslant; each layer has a lattice of its own.
            let x = (at.x + 0.12 * at.y) / (size * 0.16);
            // No part is below 0, so that this is the floor.
            let column = x as u32;
            let mut draws = drops.columns.seed(u64::from(column) << 2 | layer as u64).draws();
            let y = at.y / size + draws.between(0.0, 64.0);
            let row = y as u32;
            let key = u64::from(column) << 34 ^ u64::from(row) << 2 ^ layer as u64;
            let mut drop = drops.drops.seed(key).draws();
            if drop.unit() < 0.75 * amount {
                let middle = drop.between(0.25, 0.75);
                let across = ((x - column as f32 - middle).abs() / 0.10).min(1.0);
                let along = y - row as f32;
                let fade = (along * (1.0 - along) * 4.0).powi(2);
                light += (1.0 - across) * fade * 0.16 * (1.0 - 0.2 * layer as f32);
            }
        }
        light
    }
}
