//! Numbers of fewer bits (KHR_mesh_quantization): positions in 16 bits within a cube about the
//! model, normals and tangents in 8, texture coordinates in 16 within their range.
//!
//! Errors at most: positions half a step, which is half the cube's side / 65,534 (0.5 mm for a tree
//! of 33 m), along each axis; directions 0.5°; texture coordinates the range / 131,070.

use glam::{Vec2, Vec3};
use rayon::prelude::*;

use crate::mesh::Surface;
use crate::scene::Part;

/// Greatest whole number that stands for 1.
const MOST: f32 = i16::MAX as f32;

/// A cube that positions are counted in, from −1 to 1 along each axis; scene axes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Grid {
    pub centre: Vec3,
    /// Half the side, metres, > 0.
    pub half_m: f32,
}

impl Grid {
    /// About everything that these surfaces hold.
    pub fn around<'s>(surfaces: impl Iterator<Item = &'s Surface>) -> Grid {
        let (lo, hi) = bounds(surfaces);
        let centre = 0.5 * lo + 0.5 * hi;
        // From the rounded centre, so that no corner lies outside.
        Grid::reaching(centre, (hi - centre).max(centre - lo))
    }

    /// About the origin, which stays where it is: a tree's root.
    pub fn about_origin<'s>(surfaces: impl Iterator<Item = &'s Surface>) -> Grid {
        let (lo, hi) = bounds(surfaces);
        Grid::reaching(Vec3::ZERO, lo.abs().max(hi.abs()))
    }

    fn reaching(centre: Vec3, reach: Vec3) -> Grid {
        let half_m = reach.max_element();
        Grid { centre, half_m: if half_m > 0.0 { half_m } else { 1.0 } }
    }

    /// Farthest that a position moves along an axis, metres.
    pub fn error_m(&self) -> f32 {
        0.5 * self.half_m / MOST
    }

    /// Farthest that a position of the surface does move along an axis, metres.
    pub fn shift_m(&self, surface: &Surface) -> f32 {
        let back =
            |p: Vec3| Vec3::from(self.count(p).map(f32::from)) / MOST * self.half_m + self.centre;
        surface.position.iter().map(|&p| (back(p) - p).abs().max_element()).fold(0.0, f32::max)
    }

    pub fn count(&self, p: Vec3) -> [i16; 3] {
        let steps = (p - self.centre) / self.half_m * MOST;
        steps.to_array().map(|v| nearest(v.clamp(-MOST, MOST)) as i16)
    }
}

/// The nearest whole number of a small one; `f32::round` is a call where the machine is not known to
/// round by itself.
fn nearest(v: f32) -> i32 {
    (v + 0.5f32.copysign(v)) as i32
}

fn bounds<'s>(surfaces: impl Iterator<Item = &'s Surface>) -> (Vec3, Vec3) {
    let all = surfaces.filter(|s| !s.position.is_empty()).map(Surface::bounds);
    all.reduce(|a, b| (a.0.min(b.0), a.1.max(b.1))).unwrap_or_default()
}

/// Of a unit vector.
pub(super) fn direction(v: Vec3) -> [i8; 3] {
    v.to_array().map(|v| nearest(v * f32::from(i8::MAX)) as i8)
}

/// The range of texture coordinates, v downwards as glTF has it, that 16 bits are spread over.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct UvRange {
    pub offset: Vec2,
    pub scale: Vec2,
}

impl UvRange {
    /// The picture itself.
    pub const PICTURE: UvRange = UvRange { offset: Vec2::ZERO, scale: Vec2::ONE };
    /// Texture coordinates that are looked through at a time.
    const CHUNK: usize = 1 << 14;
    /// Texture coordinates so little outside the picture are drawn in.
    const TOLERANCE: f32 = 1e-3;

    /// Of all these parts, which share a material.
    pub fn of<'a>(parts: impl Iterator<Item = &'a Part>) -> UvRange {
        let nothing = (Vec2::INFINITY, Vec2::NEG_INFINITY);
        let both = |a: (Vec2, Vec2), b: (Vec2, Vec2)| (a.0.min(b.0), a.1.max(b.1));
        let of = |part: &Part| {
            let chunks = part.surface.uv.par_chunks(Self::CHUNK);
            let one = |uvs: &[Vec2]| uvs.iter().fold(nothing, |a, &uv| both(a, (uv, uv)));
            chunks.map(one).reduce(|| nothing, both)
        };
        let (low, high) = parts.map(of).fold(nothing, both);
        // v turns over.
        let (lo, hi) = (flipped(Vec2::new(low.x, high.y)), flipped(Vec2::new(high.x, low.y)));
        let inside =
            lo.min_element() >= -Self::TOLERANCE && hi.max_element() <= 1.0 + Self::TOLERANCE;
        if inside || !(lo.is_finite() && hi.is_finite()) {
            return Self::PICTURE;
        }
        UvRange { offset: lo, scale: (hi - lo).max(Vec2::splat(f32::MIN_POSITIVE)) }
    }

    /// `uv` with v upwards, as the scene has it.
    pub fn count(&self, uv: Vec2) -> [u16; 2] {
        let share = ((flipped(uv) - self.offset) / self.scale).clamp(Vec2::ZERO, Vec2::ONE);
        share.to_array().map(|v| nearest(v * f32::from(u16::MAX)) as u16)
    }
}

fn flipped(uv: Vec2) -> Vec2 {
    Vec2::new(uv.x, 1.0 - uv.y)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::sample::forest;
    use crate::seed::Seed;

    #[test]
    fn positions_move_by_half_a_step_at_most() {
        let mut draws = Seed::new(1).derive("grid", 0).draws();
        let mut between = |lo, hi| draws.between(lo, hi);
        let position = (0..5000)
            .map(|_| Vec3::new(between(-9.0, 4.0), between(-5.0, 6.0), between(-0.5, 31.0)))
            .collect();
        let surface = Surface { position, ..Surface::default() };
        let around = Grid::around([&surface].into_iter());
        let about_origin = Grid::about_origin([&surface].into_iter());
        assert!(around.error_m() < 0.000_25, "{}", around.error_m());
        assert!(about_origin.error_m() < 0.000_5, "{}", about_origin.error_m());
        assert_eq!(about_origin.count(Vec3::ZERO), [0; 3]);
        for grid in [around, about_origin] {
            for &p in &surface.position {
                let back = Vec3::from(grid.count(p).map(f32::from)) / MOST;
                let off = (back * grid.half_m + grid.centre - p).abs().max_element();
                assert!(off <= grid.error_m() * 1.01 + 4e-6, "{off}");
            }
        }
    }

    #[test]
    fn a_single_point_has_a_grid() {
        let surface = Surface { position: vec![Vec3::splat(3.0)], ..Surface::default() };
        assert_eq!(Grid::around([&surface].into_iter()).count(Vec3::splat(3.0)), [0; 3]);
    }

    #[test]
    fn directions_turn_by_half_a_degree_at_most() {
        let mut draws = Seed::new(2).derive("direction", 0).draws();
        for _ in 0..5000 {
            let mut one = || draws.between(-1.0, 1.0);
            let Some(v) = Vec3::new(one(), one(), one()).try_normalize() else { continue };
            let back = Vec3::from(direction(v).map(f32::from));
            assert!(back.angle_between(v).to_degrees() < 0.5);
        }
    }

    #[test]
    fn a_range_is_that_of_all_parts_of_a_material() {
        let scene = forest(&["Larix"], 2, 20.0);
        let of = |name: &str| {
            let parts = scene.prototypes.iter().flat_map(|p| &p.parts);
            UvRange::of(parts.filter(|p| p.name == name))
        };
        assert_eq!(of("foliage"), UvRange::PICTURE);
        // Bark goes up to 16 m in metres.
        let wood = of("wood");
        assert_eq!((wood.offset, wood.scale), (Vec2::new(0.0, -15.0), Vec2::new(1.0, 16.0)));
        assert_eq!(wood.count(Vec2::new(1.0, 0.0)), [u16::MAX, u16::MAX]);
        assert_eq!(wood.count(Vec2::new(0.0, 16.0)), [0, 0]);
    }
}
