//! How much light of the whole sky reaches a place in a tree, by what it shows towards many
//! directions of the sky (ambient occlusion; Zhukov et al. 1998), leaves letting some through.
//! For pictures of trees that are shown on sheets, which cannot shade themselves so.
//!
//! Known limit: what hides a place does so wholly, at the width of a sample of its maps.

use std::f32::consts::PI;

use glam::{Vec2, Vec3};
use rayon::prelude::*;

use crate::diagnostic::Result;
use crate::render::capture::{self, Sitter, Window};

/// Directions, over equal parts of the upper half of the sky.
const DIRECTIONS: usize = 32;
/// Samples along the longest line through the model: those of a tall tree are finer than its sprays of
/// leaves, which shade themselves.
const SAMPLES: f32 = 1024.0;
/// Samples that something must be nearer to the light to cast a shadow: less is the place itself.
const APART: f32 = 1.5;
/// How much of a leaf's light is that of leaves that face all ways.
const ANY_WAY: f32 = 0.1;
/// Light that comes through a leaf from behind.
const THROUGH: f32 = 0.25;
/// Light that others throw into the shade.
const BOUNCE: f32 = 0.2;
/// The golden angle, radians.
const TURN: f32 = 2.399_963_2;

/// What a model looks like from the sky.
pub(super) struct Sky {
    looks: Vec<Look>,
}

/// A place of a model to be lit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Spot {
    pub place: Vec3,
    /// Unit.
    pub normal: Vec3,
    /// Share of it that is leaf.
    pub leaf: f32,
}

struct Look {
    /// Unit.
    towards: Vec3,
    right: Vec3,
    up: Vec3,
    window: Window,
    /// Of what is nearest to the light, metres before the window's plane.
    before_m: Vec<f32>,
}

impl Sky {
    /// # Errors
    /// Bounds that are not finite.
    pub fn over(sitter: &Sitter<'_>, model: u32, (lo, hi): (Vec3, Vec3)) -> Result<Sky> {
        let centre = 0.5 * (lo + hi);
        let sample_m = (hi - lo).length().max(1e-3) / SAMPLES;
        let look = |k: usize| {
            let towards = direction(k);
            let [right, up] = capture::sides(-towards);
            let half = 0.5 * (hi - lo);
            let across = |side: Vec3| (2.0 * half.dot(side.abs()) / sample_m) as usize + 2;
            let size = [across(right), across(up)];
            let window = Window { centre, forward: -towards, sample_m, size };
            let before_m = sitter.nearest(model, &window)?;
            Ok(Look { towards, right, up, window, before_m })
        };
        Ok(Sky { looks: (0..DIRECTIONS).into_par_iter().map(look).collect::<Result<_>>()? })
    }

    /// Light on places of the model over that on open, level ground.
    pub fn light(&self, spots: &[Spot]) -> Vec<f32> {
        let mut light = vec![0.0; spots.len()];
        // Look by look, so that one map at a time is at hand.
        for look in &self.looks {
            for (sum, spot) in light.iter_mut().zip(spots) {
                let open = if look.reaches(spot.place) { 1.0 } else { BOUNCE };
                *sum += open * lit(spot.normal.dot(look.towards), spot.leaf);
            }
        }
        light.iter_mut().for_each(|sum| *sum *= 2.0 / DIRECTIONS as f32);
        light
    }
}

/// The directions of the sky, unit, on one side of a sheet.
pub(super) fn before(side: Vec3) -> Vec<Vec3> {
    (0..DIRECTIONS).map(direction).filter(|d| d.dot(side) > 0.0).collect()
}

/// Light on a sheet that has this sky [`before`] it and faces along `normal` (unit), over that on open,
/// level ground. What comes from behind does not reach it.
pub(super) fn on_sheet(normal: Vec3, before: &[Vec3]) -> f32 {
    before.iter().map(|d| lit(normal.dot(*d), 0.0)).sum::<f32>() * (2.0 / DIRECTIONS as f32)
}

/// Share of light at this cosine that is given back. A leaf is one of many about it that face all
/// ways, and lets light through.
fn lit(cosine: f32, leaf: f32) -> f32 {
    let facing = cosine.max(0.0);
    let of_leaf = facing + ANY_WAY * (0.5 - facing) + THROUGH * (-cosine).max(0.0);
    facing + (of_leaf - facing) * leaf
}

fn direction(k: usize) -> Vec3 {
    let z = (k as f32 + 0.5) / DIRECTIONS as f32;
    let (s, c) = (k as f32 * TURN % (2.0 * PI)).sin_cos();
    (Vec2::new(c, s) * (1.0 - z * z).sqrt()).extend(z)
}

impl Look {
    fn reaches(&self, place: Vec3) -> bool {
        let Window { centre, sample_m, size: [w, h], .. } = self.window;
        let d = place - centre;
        let x = d.dot(self.right) / sample_m + 0.5 * w as f32;
        let y = 0.5 * h as f32 - d.dot(self.up) / sample_m;
        let inside = |at: f32, count: usize| (at.max(0.0) as usize).min(count - 1);
        let here = |x: f32, y: f32| self.before_m[inside(y, h) * w + inside(x, w)];
        let most_m = d.dot(self.towards) + APART * sample_m;
        if here(x, y) <= most_m {
            return true;
        }
        // Of a plane aslant to the light, which may seem to shade itself, the mean of the samples around
        // is at the place itself.
        let (left, top) = ((x - 0.5).floor(), (y - 0.5).floor());
        let (s, t) = (x - 0.5 - left, y - 0.5 - top);
        let (mut sum, mut weight) = (0.0, 0.0);
        for (i, j) in [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)] {
            let before_m = here(left + i, top + j);
            if before_m > f32::MIN {
                let part = (1.0 - (s - i).abs()) * (1.0 - (t - j).abs());
                (sum, weight) = (sum + part * before_m, weight + part);
            }
        }
        sum <= most_m * weight
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::Surface;
    use crate::scene::{Material, Part};

    /// A level sheet of 4 m by 4 m this high.
    fn level(z: f32) -> Vec<Part> {
        let corners = [(-2.0, -2.0), (2.0, -2.0), (2.0, 2.0), (-2.0, 2.0)];
        let surface = Surface {
            position: corners.map(|(x, y)| Vec3::new(x, y, z)).to_vec(),
            normal: vec![Vec3::Z; 4],
            uv: vec![Vec2::ZERO; 4],
            index: vec![0, 1, 2, 0, 2, 3],
            ..Surface::default()
        };
        vec![Part { name: "roof".into(), surface, material: 0 }]
    }

    fn grey() -> [Material; 1] {
        [Material { double_sided: true, ..Material::plain("grey", [0.5; 3]) }]
    }

    #[test]
    fn a_roof_shades_what_is_under_it() {
        let roof = level(2.0);
        let materials = grey();
        let sitter = Sitter::new(&[&roof], &materials, &[]);
        let sky = Sky::over(&sitter, 0, (Vec3::new(-2.0, -2.0, 0.0), Vec3::new(2.0, 2.0, 2.0)));
        let sky = sky.unwrap();
        let lit = |place, normal, leaf| sky.light(&[Spot { place, normal, leaf }])[0];
        let light = |place| lit(place, Vec3::Z, 0.0);
        // Of a sky alike all over, in parts of which 32 are looked at, the roof's top sees all.
        let top = light(Vec3::Z * 2.0);
        assert!((top - 1.0).abs() < 0.01, "{top}");
        // The share of a level place's light that comes through a square of 4 m, 2 m over its middle:
        // 4 / π · 2 / √2 · atan(1 / √2) / √2 (a corner's quarter four times).
        let hidden = 4.0 / PI * 0.5f32.sqrt() * 0.5f32.sqrt().atan();
        let (got, wanted) = (light(Vec3::ZERO), 1.0 - hidden * (1.0 - BOUNCE));
        assert!((got - wanted).abs() < 0.06, "{got} {wanted}");
        assert!(light(Vec3::new(2.0, 0.0, 0.0)) > got + 0.1);
        // From below a roof that lets no light through is dark, a leaf is not.
        assert!(lit(Vec3::Z * 2.0, -Vec3::Z, 0.0) < 1e-6);
        assert!(lit(Vec3::Z * 2.0, -Vec3::Z, 1.0) > 0.2);
    }

    /// Needles of one spray, a hand's breadth apart.
    #[test]
    fn in_a_tall_tree_leaves_shade_those_close_below() {
        let roof = level(18.0);
        let materials = grey();
        let sitter = Sitter::new(&[&roof], &materials, &[]);
        let sky = Sky::over(&sitter, 0, (Vec3::new(-2.0, -2.0, 0.0), Vec3::new(2.0, 2.0, 20.0)));
        let below = Spot { place: Vec3::Z * 17.92, normal: Vec3::Z, leaf: 0.0 };
        let light = sky.unwrap().light(&[below])[0];
        // Of the sky between the sheet and the horizon next to nothing is left.
        assert!((light - BOUNCE).abs() < 0.02, "{light}");
    }

    #[test]
    fn a_sheet_gets_what_comes_from_before_it() {
        assert!((on_sheet(Vec3::Z, &before(Vec3::Z)) - 1.0).abs() < 0.01);
        for k in 0..8 {
            let (s, c) = (k as f32 * 0.7).sin_cos();
            let out = Vec3::new(c, s, 0.0);
            // Half of the sky, at right angles to the ground.
            assert!(
                (on_sheet(out, &before(out)) - 0.5).abs() < 0.03,
                "{k} {}",
                on_sheet(out, &before(out))
            );
            assert!((on_sheet(Vec3::Z, &before(out)) - 0.5).abs() < 0.03);
        }
    }
}
