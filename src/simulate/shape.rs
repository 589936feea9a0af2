//! The solid that a simulated crown fills: the species' profile turned about the stem, with lobes.

use std::f32::consts::TAU;

use super::planting::TrueTree;
use crate::seed::Seed;
use crate::species::Species;
use crate::species::model::curve;

/// Steps of the tabulated profile.
const STEPS: usize = 64;

/// One crown, ready for many queries.
#[derive(Debug, Clone)]
pub struct Shape {
    pub x: f32,
    pub y: f32,
    /// Heights in local metres.
    pub foot_z: f32,
    pub base_z: f32,
    pub top_z: f32,
    pub radius_m: f32,
    pub stem_radius_m: f32,
    /// Relative radius from base to top.
    profile: [f32; STEPS + 1],
    /// Amplitude, lobes, phase, twist per metre of height.
    lobes: [[f32; 4]; 2],
}

impl Shape {
    pub fn new(tree: &TrueTree, species: &Species, seed: Seed) -> Self {
        let mut d = seed.draws();
        let mut profile = [0.0; STEPS + 1];
        for (i, r) in profile.iter_mut().enumerate() {
            *r = curve(&species.size.profile, i as f32 / STEPS as f32);
        }
        let widest = profile.iter().copied().fold(1e-6, f32::max);
        profile.iter_mut().for_each(|r| *r /= widest);
        let mut lobe = |low: f32, high: f32| {
            [0.08, d.between(low, high).round(), d.between(0.0, TAU), d.between(-0.5, 0.5)]
        };
        Shape {
            x: tree.x as f32,
            y: tree.y as f32,
            foot_z: tree.z as f32,
            base_z: tree.z as f32 + tree.crown_base_height_m,
            top_z: tree.z as f32 + tree.height_m,
            radius_m: 0.5 * tree.crown_diameter_m,
            stem_radius_m: 0.5 * tree.stem_diameter_m,
            profile,
            lobes: [lobe(2.0, 4.0), lobe(5.0, 8.0)],
        }
    }

    /// Farthest any leaf is from the stem.
    pub fn reach_m(&self) -> f32 {
        self.radius_m * (1.0 + self.lobes[0][0] + self.lobes[1][0])
    }

    /// Crown radius at a height along a direction; 0 above and below the crown.
    pub fn radius_at(&self, z: f32, azimuth_rad: f32) -> f32 {
        let t = (z - self.base_z) / (self.top_z - self.base_z);
        if !(0.0..=1.0).contains(&t) {
            return 0.0;
        }
        let u = t * STEPS as f32;
        let i = (u as usize).min(STEPS - 1);
        let f = u - i as f32;
        let r = self.profile[i] * (1.0 - f) + self.profile[i + 1] * f;
        let lobes: f32 = self
            .lobes
            .iter()
            .map(|l| l[0] * (l[1] * (azimuth_rad + l[3] * (z - self.base_z)) + l[2]).sin())
            .sum();
        self.radius_m * r * (1.0 + lobes)
    }

    /// Share of a beam of radius `beam_m` that the crown fills, and how far inside the crown's
    /// surface its axis is, sideways; negative outside.
    pub fn filled(&self, x: f32, y: f32, z: f32, beam_m: f32) -> (f32, f32) {
        let (dx, dy) = (x - self.x, y - self.y);
        let reach = self.reach_m() + beam_m;
        if dx * dx + dy * dy > reach * reach {
            return (0.0, f32::NEG_INFINITY);
        }
        let radius = self.radius_at(z, dy.atan2(dx));
        let depth = radius - dx.hypot(dy);
        if beam_m <= 0.0 {
            return (if depth > 0.0 { 1.0 } else { 0.0 }, depth);
        }
        // Across a straight edge the share falls evenly; a crown thinner than the beam fills no
        // more of it than its own section.
        let across = ((depth + beam_m) / (2.0 * beam_m)).clamp(0.0, 1.0);
        (across.min((radius / beam_m).powi(2)), depth)
    }

    /// Height of the crown's surface seen from above; `None` beside the crown.
    pub fn surface_at(&self, x: f32, y: f32) -> Option<f32> {
        let (dx, dy) = (x - self.x, y - self.y);
        let distance = dx.hypot(dy);
        if distance > self.reach_m() {
            return None;
        }
        let azimuth = dy.atan2(dx);
        let z = |i: usize| self.base_z + (self.top_z - self.base_z) * i as f32 / (2 * STEPS) as f32;
        (0..=2 * STEPS).rev().map(z).find(|&z| self.radius_at(z, azimuth) >= distance)
    }
}

#[cfg(test)]
pub(super) fn cone(x: f32, y: f32, foot_z: f32, base_z: f32, top_z: f32, radius_m: f32) -> Shape {
    let mut profile = [0.0; STEPS + 1];
    for (i, r) in profile.iter_mut().enumerate() {
        *r = 1.0 - i as f32 / STEPS as f32;
    }
    let lobes = [[0.0; 4]; 2];
    Shape { x, y, foot_z, base_z, top_z, radius_m, stem_radius_m: 0.1, profile, lobes }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cone_is_a_cone() {
        let c = cone(3.0, 4.0, 0.0, 5.0, 15.0, 2.0);
        assert!((c.radius_at(10.0, 1.0) - 1.0).abs() < 1e-5);
        assert_eq!(c.radius_at(4.9, 0.0), 0.0);
        assert!((c.filled(3.5, 4.0, 10.0, 0.0).1 - 0.5).abs() < 1e-5);
        assert_eq!(c.filled(3.5, 4.0, 10.0, 0.0).0, 1.0);
        // An edge cuts the beam in half; a tip of 0.1 m fills a quarter of a beam of 0.2 m.
        assert!((c.filled(4.0, 4.0, 10.0, 0.2).0 - 0.5).abs() < 1e-4);
        assert!((c.filled(3.0, 4.0, 14.5, 0.2).0 - 0.25).abs() < 1e-3);
        let z = c.surface_at(4.0, 4.0).unwrap();
        assert!((z - 10.0).abs() <= 10.0 / 128.0 + 1e-4, "{z}");
        assert_eq!(c.surface_at(5.5, 4.0), None);
    }
}
