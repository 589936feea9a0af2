//! The shape of a simulated tree: a lobed surface of revolution around a tapering stem.

use std::f32::consts::TAU;

use glam::{Vec2, Vec3};

use super::stand::TrueTree;
use crate::seed::Seed;
use crate::species::Species;
use crate::species::model::{Kind, LeafShape};

/// A tree that rays can meet; local metres.
#[derive(Debug, Clone)]
pub(super) struct Shape {
    pub axis: Vec2,
    pub foot_z: f32,
    pub base_z: f32,
    pub top_z: f32,
    /// Greatest radius before lobes.
    radius_m: f32,
    stem_radius_m: f32,
    /// Relative radius at equal steps of relative height 0…1, greatest 1.
    profile: [f32; 33],
    /// (angular frequency, twist, phase, depth) of each lobe series.
    lobes: [[f32; 4]; 3],
    /// Share of light that leaves stop a metre, as an exponential rate.
    extinction_per_m: f32,
}

impl Shape {
    pub fn new(tree: &TrueTree, species: &Species, seed: Seed) -> Shape {
        let mut draws = seed.draws();
        let mut profile: [f32; 33] =
            std::array::from_fn(|i| outline(&species.size.profile, i as f32 / 32.0));
        let widest = profile.iter().copied().fold(1e-3, f32::max);
        profile = profile.map(|r| r / widest);
        let depth = if species.kind == Kind::Conifer { 0.09 } else { 0.12 };
        let mut lobe = |k: f32, depth: f32| {
            [
                k,
                k * draws.between(1.5, 4.0),
                draws.between(0.0, TAU),
                depth * draws.between(0.6, 1.2),
            ]
        };
        let lobes = [lobe(2.0, depth), lobe(5.0, depth * 0.5), lobe(11.0, depth * 0.45)];
        let extinction_per_m = match (species.kind, species.foliage.shape) {
            (Kind::Shrub, _) => 1.6,
            (_, LeafShape::Tuft) => 0.65,
            (Kind::Conifer, _) => 0.95,
            (Kind::Broadleaf, _) => 0.75,
        };
        let p = tree.position;
        Shape {
            axis: p.truncate(),
            foot_z: p.z,
            base_z: p.z + tree.crown_base_height_m,
            top_z: p.z + tree.height_m,
            radius_m: tree.crown_diameter_m * 0.5,
            stem_radius_m: tree.stem_diameter_m * 0.5,
            profile,
            lobes,
            extinction_per_m,
        }
    }

    /// No part of the crown is farther from the axis.
    pub fn reach_m(&self) -> f32 {
        self.radius_m * (1.0 + self.lobes.iter().map(|l| l[3].abs()).sum::<f32>())
    }

    /// Radius of the crown at a height, before lobes; `None` above and below it.
    pub fn radius_at(&self, z: f32) -> Option<f32> {
        let t = (z - self.base_z) / (self.top_z - self.base_z);
        if !(0.0..=1.0).contains(&t) {
            return None;
        }
        let u = t * 32.0;
        let i = (u as usize).min(31);
        let f = u - i as f32;
        Some(self.radius_m * (self.profile[i] * (1.0 - f) + self.profile[i + 1] * f))
    }

    fn lobing(&self, d: Vec2, z: f32) -> f32 {
        let t = (z - self.base_z) / (self.top_z - self.base_z);
        let phi = d.y.atan2(d.x);
        1.0 + self.lobes.iter().map(|l| l[3] * (l[0] * phi + l[1] * t + l[2]).sin()).sum::<f32>()
    }

    /// Extinction of light at a place: leaves sit towards the crown's surface.
    pub fn extinction_at(&self, p: Vec3) -> f32 {
        let d = p.truncate() - self.axis;
        let Some(r) = self.radius_at(p.z) else { return 0.0 };
        let distance_sq = d.length_squared();
        if distance_sq > (1.45 * r) * (1.45 * r) {
            return 0.0;
        }
        let r = r * self.lobing(d, p.z);
        if distance_sq >= r * r {
            return 0.0;
        }
        let inner = distance_sq.sqrt() / r;
        self.extinction_per_m * (0.45 + 0.75 * inner)
    }

    /// Whether a place lies in the stem.
    pub fn is_in_stem(&self, p: Vec3) -> bool {
        let up = (p.z - self.foot_z) / (self.top_z - self.foot_z);
        let r = self.stem_radius_m * (1.0 - up);
        (0.0..1.0).contains(&up) && (p.truncate() - self.axis).length_squared() < r * r
    }

    /// Height of the crown's upper surface over a place.
    pub fn surface_at(&self, p: Vec2) -> Option<f32> {
        let d = p - self.axis;
        let distance = d.length();
        if distance > self.reach_m() {
            return None;
        }
        const STEPS: i32 = 48;
        let covers = |z: f32| {
            self.radius_at(z).is_some_and(|r| r > 0.0 && distance <= r * self.lobing(d, z))
        };
        let step = (self.top_z - self.base_z) / STEPS as f32;
        let at = |i: i32| self.top_z - step * i as f32;
        let first = (0..=STEPS).find(|&i| covers(at(i)))?;
        let (mut inside, mut outside) = (at(first), at((first - 1).max(0)));
        for _ in 0..5 {
            let middle = 0.5 * (inside + outside);
            if covers(middle) { inside = middle } else { outside = middle }
        }
        Some(inside)
    }
}

/// Linear between the pairs (height, radius), which rise in height.
fn outline(profile: &[[f32; 2]], t: f32) -> f32 {
    let next = profile.partition_point(|p| p[0] < t);
    match (next.checked_sub(1).and_then(|i| profile.get(i)), profile.get(next)) {
        (Some(a), Some(b)) => a[1] + (b[1] - a[1]) * (t - a[0]) / (b[0] - a[0]).max(1e-6),
        (Some(only), None) | (None, Some(only)) => only[1],
        (None, None) => 1.0 - t,
    }
}

/// Trees by place, for rays and pixels.
pub(super) struct Grove<'a> {
    shapes: &'a [Shape],
    cell_m: f32,
    cells: i32,
    /// Trees over each cell, and the highest top among them.
    trees: Vec<Vec<u32>>,
    top_z: Vec<f32>,
}

impl<'a> Grove<'a> {
    pub fn new(shapes: &'a [Shape], side_m: f32) -> Grove<'a> {
        let cell_m = (side_m / 512.0).max(2.0);
        let cells = (side_m / cell_m).ceil().max(1.0) as i32;
        let mut trees = vec![Vec::new(); (cells * cells) as usize];
        let mut top_z = vec![f32::MIN; trees.len()];
        for (id, s) in shapes.iter().enumerate() {
            let reach = Vec2::splat(s.reach_m());
            let lo = ((s.axis - reach) / cell_m).floor().as_ivec2().max(glam::IVec2::ZERO);
            let hi =
                ((s.axis + reach) / cell_m).floor().as_ivec2().min(glam::IVec2::splat(cells - 1));
            for y in lo.y..=hi.y {
                for x in lo.x..=hi.x {
                    let i = (y * cells + x) as usize;
                    trees[i].push(id as u32);
                    top_z[i] = top_z[i].max(s.top_z);
                }
            }
        }
        Grove { shapes, cell_m, cells, trees, top_z }
    }

    fn cell(&self, p: Vec2) -> Option<usize> {
        let c = (p / self.cell_m).floor().as_ivec2();
        let inside = c.x >= 0 && c.y >= 0 && c.x < self.cells && c.y < self.cells;
        inside.then(|| (c.y * self.cells + c.x) as usize)
    }

    /// Trees whose crown may be over a place, with ids.
    pub fn over(&self, p: Vec2) -> impl Iterator<Item = (u32, &'a Shape)> + '_ {
        let ids = self.cell(p).map_or(&[][..], |i| &self.trees[i]);
        ids.iter().map(|&id| (id, &self.shapes[id as usize]))
    }

    /// Height above which nothing grows over a place.
    pub fn top_at(&self, p: Vec2) -> f32 {
        self.cell(p).map_or(f32::MIN, |i| self.top_z[i])
    }

    pub fn highest(&self) -> f32 {
        self.shapes.iter().map(|s| s.top_z).fold(f32::MIN, f32::max)
    }
}
