//! A person of 1.8 m, for scale.

use std::f32::consts::{FRAC_PI_2, TAU};

use glam::{Vec2, Vec3};

use crate::mesh::Surface;

/// Height of the figure, metres.
pub const HEIGHT_M: f32 = 1.8;

/// A limb: from a round end to another, metres; x to the left hand's side, −y ahead.
struct Limb {
    from: [f32; 3],
    to: [f32; 3],
    radius: [f32; 2],
}

const fn limb(from: [f32; 3], to: [f32; 3], radius: [f32; 2]) -> Limb {
    Limb { from, to, radius }
}

/// One side of the body; the other is its mirror image.
const LIMBS: [Limb; 10] = [
    limb([0.0, -0.01, 1.66], [0.0, 0.0, 1.70], [0.092, 0.100]), // head
    limb([0.0, 0.01, 1.44], [0.0, 0.0, 1.60], [0.058, 0.055]),
    limb([0.09, 0.01, 1.33], [0.15, 0.01, 1.42], [0.125, 0.070]), // shoulder
    limb([0.055, 0.01, 1.06], [0.08, 0.01, 1.34], [0.105, 0.125]), // flank
    limb([0.075, 0.0, 0.92], [0.055, 0.01, 1.06], [0.112, 0.108]), // hip
    limb([0.09, 0.0, 0.88], [0.115, -0.01, 0.50], [0.092, 0.062]),
    limb([0.115, -0.01, 0.50], [0.135, 0.02, 0.09], [0.062, 0.042]),
    limb([0.137, 0.02, 0.045], [0.16, -0.15, 0.035], [0.048, 0.035]), // foot
    limb([0.20, 0.01, 1.41], [0.265, 0.02, 1.12], [0.056, 0.044]),
    limb([0.265, 0.02, 1.12], [0.285, -0.05, 0.86], [0.042, 0.036]),
];

/// The figure, standing on the origin, [`HEIGHT_M`] high.
pub fn figure() -> Surface {
    let mut out = Surface::default();
    for l in &LIMBS {
        let is_middle = l.from[0] == 0.0 && l.to[0] == 0.0;
        for side in if is_middle { &[1.0][..] } else { &[1.0, -1.0] } {
            let at = |p: [f32; 3]| Vec3::new(p[0] * side, p[1], p[2]);
            rounded_cone(&mut out, at(l.from), at(l.to), l.radius);
        }
    }
    let (low, high) = out.bounds();
    let scale = HEIGHT_M / (high.z - low.z).max(1e-3);
    for p in &mut out.position {
        *p = (*p - Vec3::Z * low.z) * scale;
    }
    out
}

/// A cone between two half spheres.
fn rounded_cone(out: &mut Surface, from: Vec3, to: Vec3, radius: [f32; 2]) {
    const SIDES: u32 = 16;
    const CAP: u32 = 5;
    let along = (to - from).normalize_or(Vec3::Z);
    let across = along.any_orthonormal_vector();
    let other = along.cross(across);
    let first = out.position.len() as u32;
    for ring in 0..=2 * CAP + 1 {
        let is_far = ring > CAP;
        let (middle, r) = if is_far { (to, radius[1]) } else { (from, radius[0]) };
        let step = if is_far { ring - 1 } else { ring };
        let (rise, out_by) = ((step as f32 / CAP as f32 - 1.0) * FRAC_PI_2).sin_cos();
        for side in 0..SIDES {
            let (s, c) = (side as f32 / SIDES as f32 * TAU).sin_cos();
            let normal = along * rise + (across * c + other * s) * out_by;
            out.position.push(middle + normal * r);
            out.normal.push(normal);
            out.uv.push(Vec2::ZERO);
        }
    }
    for ring in 0..2 * CAP + 1 {
        for side in 0..SIDES {
            let at = |r: u32, s: u32| first + (ring + r) * SIDES + (side + s) % SIDES;
            out.index.extend([at(0, 0), at(0, 1), at(1, 1), at(0, 0), at(1, 1), at(1, 0)]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_figure_is_as_high_as_it_says_and_closed_outward() {
        let figure = figure();
        let (low, high) = figure.bounds();
        assert!(low.z.abs() < 1e-5 && (high.z - HEIGHT_M).abs() < 1e-5);
        assert!((high.x - low.x) < 0.8 && (high.y - low.y) < 0.6);
        for t in figure.index.chunks_exact(3) {
            let [a, b, c] = [t[0], t[1], t[2]].map(|i| figure.position[i as usize]);
            let face = (b - a).cross(c - a);
            let normal = t.iter().map(|&i| figure.normal[i as usize]).sum::<Vec3>();
            assert!(face.length() < 1e-7 || face.dot(normal) > 0.0);
        }
    }
}
