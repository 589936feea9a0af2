//! What surfaces look like between the voxels: noise by place, the same in every picture.

use glam::{DVec3, Vec3};

use super::brick::trilinear;

/// A lattice of random numbers 0…1, smooth in between, and its slope.
fn lattice(p: DVec3) -> (f32, Vec3) {
    let cell = p.floor();
    let f = (p - cell).as_vec3();
    let corner = |k: u64| {
        let at = [cell.x, cell.y, cell.z].map(|v| v as i64 as u64);
        let mut h = (at[0].wrapping_add(k & 1)).wrapping_mul(0x9e37_79b9_7f4a_7c15)
            ^ (at[1].wrapping_add(k >> 1 & 1)).wrapping_mul(0xbf58_476d_1ce4_e5b9)
            ^ (at[2].wrapping_add(k >> 2)).wrapping_mul(0x94d0_49bb_1331_11eb);
        h = (h ^ h >> 29).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        (h >> 40) as f32 / (1u64 << 24) as f32
    };
    let c = [0, 1, 2, 3, 4, 5, 6, 7].map(corner);
    let s = f * f * (3.0 - 2.0 * f);
    let flat = |a: f32, b: f32, c: f32, d: f32, u: f32, v: f32| {
        let (low, high) = (a + (b - a) * u, c + (d - c) * u);
        low + (high - low) * v
    };
    let slope = Vec3::new(
        flat(c[1] - c[0], c[3] - c[2], c[5] - c[4], c[7] - c[6], s.y, s.z),
        flat(c[2] - c[0], c[3] - c[1], c[6] - c[4], c[7] - c[5], s.x, s.z),
        flat(c[4] - c[0], c[5] - c[1], c[6] - c[2], c[7] - c[3], s.x, s.y),
    );
    (trilinear(&c, s), slope * 6.0 * f * (1.0 - f))
}

/// Brightness by place, so that one tree's leaves are not all alike, two voxels apart.
pub(super) fn mottle(p: DVec3) -> f32 {
    0.82 + 0.36 * lattice(p * 0.5).0
}

/// Clumps of leaves finer than a voxel, where a ray is not broader than they are: their brightness,
/// and how far they turn the surface.
pub(super) fn clumps(p: DVec3, breadth: f32) -> (f32, Vec3) {
    let (mut shade, mut bump) = (1.0, Vec3::ZERO);
    for a_voxel in [1.7f32, 4.1] {
        let seen = 1.0 - breadth * a_voxel;
        if seen > 0.0 {
            let (value, slope) = lattice(p * f64::from(a_voxel));
            shade *= 1.0 + (value - 0.5) * seen;
            bump -= slope * 1.1 * seen;
        }
    }
    (shade, bump)
}

/// Colour of the earth where the scene is cut, darker with depth, in layers.
pub(super) fn earth(p: DVec3, surface: Option<f64>, voxel_m: f32) -> Vec3 {
    let deep = ((surface.unwrap_or(p.z) - p.z).max(0.0) as f32 * voxel_m).min(60.0);
    let layer = 0.9 + 0.1 * (deep * 1.3 + 0.4 * (deep * 0.37).sin()).sin();
    let top = Vec3::new(0.13, 0.085, 0.05);
    let below = Vec3::new(0.26, 0.22, 0.18);
    top.lerp(below, 1.0 - (-deep / 4.0).exp()) * layer
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_slope_of_noise_is_how_it_rises() {
        for i in 0..200 {
            let p = DVec3::new(0.37, -0.81, 0.59) * f64::from(i);
            let (_, slope) = lattice(p);
            for axis in 0..3 {
                let step = DVec3::AXES[axis] * 1e-3;
                let rise = (lattice(p + step).0 - lattice(p - step).0) / 2e-3;
                assert!((rise - slope[axis]).abs() < 0.02, "{rise} and {}", slope[axis]);
            }
        }
    }

    #[test]
    fn clumps_are_not_seen_from_afar() {
        let p = DVec3::new(3.3, 8.1, 2.7);
        assert_eq!(clumps(p, 0.6), (1.0, Vec3::ZERO));
        assert_ne!(clumps(p, 0.1).1, Vec3::ZERO);
    }
}
