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

/// How deep gaps between leaves go at a place, 0…1. In large voxels there are some between boughs and
/// others, so many times finer, between leaves.
pub(super) fn gaps(p: DVec3, fine: f32) -> f32 {
    let noise = 0.6 * lattice(p * 2.3).0 + 0.4 * lattice(p * 5.9).0;
    let noise = match fine > 1.0 {
        true => 0.75 * noise + 0.25 * lattice(p * (5.9 * f64::from(fine))).0,
        false => noise,
    };
    ((noise - 0.32) * 2.6).clamp(0.0, 1.0)
}

/// Clumps of leaves finer than a voxel, where a ray is not broader than they are: their brightness,
/// and how far they turn the surface. In large voxels as [`gaps`] are.
pub(super) fn clumps(p: DVec3, breadth: f32, fine: f32) -> (f32, Vec3) {
    match fine > 1.0 {
        true => grain(p, breadth, [1.7, 4.1, 4.1 * fine], 1.1),
        false => grain(p, breadth, [1.7, 4.1], 1.1),
    }
}

/// The same of litter and stones on the ground; the frequencies are a metre.
pub(super) fn litter(p: DVec3, voxel_m: f32, breadth: f32) -> (f32, Vec3) {
    let (shade, bump) = grain(p * f64::from(voxel_m), breadth * voxel_m, [0.23, 0.9, 3.7], 0.3);
    (0.4 + 0.6 * shade, bump.with_z(0.0))
}

/// How much of its snow wind leaves at a place, 0.3…1.
pub(super) fn drift(p: DVec3, voxel_m: f32) -> f32 {
    let metres = p * f64::from(voxel_m);
    // Longer along the wind than across.
    let along = DVec3::new(0.03 * metres.x + 0.05 * metres.y, 0.11 * metres.y, 0.0);
    let noise =
        0.5 * lattice(along).0 + 0.3 * lattice(along * 3.1).0 + 0.2 * lattice(along * 9.7).0;
    0.3 + 0.7 * ((noise - 0.3) * 2.5).clamp(0.0, 1.0)
}

/// Noise of these frequencies, as far as it is not finer than a ray is broad.
fn grain<const N: usize>(p: DVec3, breadth: f32, frequencies: [f32; N], steep: f32) -> (f32, Vec3) {
    let (mut shade, mut bump) = (1.0, Vec3::ZERO);
    for frequency in frequencies {
        let seen = 1.0 - breadth * frequency;
        if seen > 0.0 {
            let (value, slope) = lattice(p * f64::from(frequency));
            shade *= 1.0 + (value - 0.5) * seen;
            bump -= slope * steep * seen;
        }
    }
    (shade, bump)
}

/// Colour of the earth where the scene is cut: soil on rock in uneven layers.
pub(super) fn earth(p: DVec3, surface: Option<f64>, voxel_m: f32) -> Vec3 {
    let metres = p * f64::from(voxel_m);
    let deep = (surface.unwrap_or(p.z) - p.z).max(0.0) as f32 * voxel_m;
    // Layers follow the surface less and less, and waver.
    let level = metres.z as f32 + 0.35 * deep + 5.0 * lattice(metres * 0.03).0;
    let along = |scale: f32, row: f64| lattice(DVec3::new(row, 0.5, f64::from(level * scale))).0;
    let layer = 0.5 * along(0.17, 0.5) + 0.3 * along(0.6, 9.5) + 0.2 * along(1.9, 17.5);
    let stone = 0.94 + 0.12 * lattice(metres * 1.3).0;
    let top = Vec3::new(0.085, 0.058, 0.036);
    let soil = Vec3::new(0.15, 0.113, 0.08);
    let rock = Vec3::new(0.27, 0.235, 0.20);
    let fade = |m: f32| (-deep / m).exp();
    let below = soil.lerp(rock, 1.0 - fade(6.0)) * (0.72 + 0.56 * layer);
    top.lerp(below, 1.0 - fade(0.6)) * stone
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
        assert_eq!(clumps(p, 0.6, 1.0), (1.0, Vec3::ZERO));
        assert_ne!(clumps(p, 0.1, 1.0).1, Vec3::ZERO);
    }
}
