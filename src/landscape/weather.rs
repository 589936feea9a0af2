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
const SNOW: Vec3 = Vec3::new(0.52, 0.555, 0.61);

/// A place as weather changes it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Skin {
    /// Linear.
    pub albedo: Vec3,
    pub normal: Vec3,
    /// How far the surface itself faces up, whatever its normal is rounded to: −1…1.
    pub up: f32,
    /// Depth of snow that stays on it, at most, metres.
    pub holds_m: f32,
    /// Share of the light of the sky that it mirrors.
    pub gloss: f32,
}

/// Where drops are in a picture: layers of lattices, near and far.
#[derive(Debug, Clone)]
pub(super) struct Drops {
    columns: Stage,
    drops: Stage,
    /// Share of the lattices' cells that hold a drop.
    share: f32,
    layers: [Layer; 3],
}

/// A lattice of drops, its first columns known beforehand.
#[derive(Debug, Clone)]
struct Layer {
    /// Height of a cell, as a share of the picture's.
    size: f32,
    /// Cells of a column that are seen, at most.
    rows: usize,
    /// How much higher each column begins, in cells.
    shifts: Vec<f32>,
    /// Of each cell that is seen, column after column, where across it the drop is; NaN without one.
    middles: Vec<f32>,
}

/// Breadth of a cell as a share of its height, and how far aslant drops fall.
const SLIM: f32 = 0.16;
const SLANT: f32 = 0.12;
/// Breadth over height of a picture up to which drops are known beforehand.
const MOST_ASPECT: f32 = 8.0;

impl Drops {
    /// In a picture of so many pixels.
    pub fn new(seed: Seed, weather: &Weather, size: [u32; 2]) -> Drops {
        let layer = |size| Layer { size, rows: 0, shifts: Vec::new(), middles: Vec::new() };
        let mut drops = Drops {
            columns: seed.stage("rain"),
            drops: seed.stage("drop"),
            share: 0.75 * (weather.rain_mm / 30.0).clamp(0.05, 1.0),
            layers: [0.10, 0.055, 0.03].map(layer),
        };
        if weather.rain_mm <= 0.0 {
            return drops;
        }
        let across = (size[0] as f32 / size[1] as f32).min(MOST_ASPECT) + SLANT;
        for number in 0..drops.layers.len() {
            let size = drops.layers[number].size;
            let columns = (across / (size * SLIM)) as u32 + 1;
            let rows = (1.0 / size) as u32 + 2;
            let shifts: Vec<f32> = (0..columns).map(|c| drops.shift(number, c)).collect();
            let cells = (0..columns).zip(&shifts).flat_map(|(column, shift)| {
                let first = *shift as u32;
                (first..first + rows).map(move |row| (column, row))
            });
            let middles = cells.map(|(column, row)| drops.middle(number, column, row)).collect();
            drops.layers[number] = Layer { size, rows: rows as usize, shifts, middles };
        }
        drops
    }

    fn shift(&self, layer: usize, column: u32) -> f32 {
        self.columns.seed(u64::from(column) << 2 | layer as u64).draws().between(0.0, 64.0)
    }

    fn middle(&self, layer: usize, column: u32, row: u32) -> f32 {
        let key = u64::from(column) << 34 ^ u64::from(row) << 2 ^ layer as u64;
        let mut drop = self.drops.seed(key).draws();
        if drop.unit() < self.share { drop.between(0.25, 0.75) } else { f32::NAN }
    }

    /// Brightness of the drops in front of a place in the picture, which is `height` pixels high.
    pub fn streaks(&self, at: Vec2, height: f32) -> f32 {
        let at = at / height;
        let mut light = 0.0;
        for (number, layer) in self.layers.iter().enumerate() {
            // Each layer has a lattice of its own.
            let x = (at.x + SLANT * at.y) / (layer.size * SLIM);
            // No part is below 0, so that this is the floor.
            let column = x as u32;
            let shift = layer.shifts.get(column as usize).copied();
            let y = at.y / layer.size + shift.unwrap_or_else(|| self.shift(number, column));
            let row = y as u32;
            let known = shift.and_then(|shift| {
                let row = row.wrapping_sub(shift as u32) as usize;
                layer.middles.get(column as usize * layer.rows + row)
            });
            let middle = known.copied().unwrap_or_else(|| self.middle(number, column, row));
            let across = (x - column as f32 - middle).abs() / 0.10;
            if across < 1.0 {
                let along = y - row as f32;
                let fade = (along * (1.0 - along) * 4.0).powi(2);
                light += (1.0 - across) * fade * 0.16 * (1.0 - 0.2 * number as f32);
            }
        }
        light
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
        let Skin { mut albedo, mut normal, mut gloss, up, holds_m } = skin;
        if self.rain_mm > 0.0 {
            let wet = (self.rain_mm / 4.0).min(1.0) * (0.35 + 0.65 * open);
            // Water between grains passes light on instead of scattering it back.
            albedo *= 1.0 - 0.45 * wet;
            gloss = (0.22 * wet * normal.z.max(0.0)).max(gloss);
        }
        if self.snow_m > 0.0 {
            let steep = ((up - 0.15) / 0.5).clamp(0.0, 1.0);
            let lies = steep * steep * (3.0 - 2.0 * steep) * open.clamp(0.0, 1.0);
            let deep = self.snow_m.min(holds_m);
            let cover = 1.0 - (-deep * lies * 2.0 / HIDING_M).exp();
            albedo = albedo.lerp(SNOW, cover);
            // A deep layer rounds what is under it.
            let round = cover * (deep / 0.5).min(0.6);
            normal = normal.lerp(Vec3::Z, round).normalize_or(Vec3::Z);
            gloss *= 1.0 - cover;
        }
        Skin { albedo, normal, gloss, ..skin }
    }
}
