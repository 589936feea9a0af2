//! How well a skeleton and a cloud agree.

use glam::Vec3;
use rayon::prelude::*;

use super::near::{Cone, Points, Wood};

/// Wood farther than this from every point is outside the cloud, metres.
pub const OUTSIDE_M: f32 = 0.1;
/// Wood is looked at in pieces of about this length.
const PIECE_M: f32 = 0.02;
const MOST_PIECES: usize = 200;

/// Distances between points and wood.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Fit {
    pub mean_m: f64,
    pub p95_m: f64,
    /// Shares of the wood whose surface is farther than [`OUTSIDE_M`] from every point.
    pub outside_length: f64,
    pub outside_volume: f64,
}

/// Every point counts, those inside the wood with their depth.
pub(super) fn fit(points: &[Vec3], cones: &[Cone]) -> Fit {
    let wood = Wood::new(cones.to_vec());
    let mut apart: Vec<f32> =
        points.par_iter().filter_map(|p| wood.nearest(*p).map(|(_, d)| d.abs())).collect();
    apart.par_sort_unstable_by(f32::total_cmp);
    let count = apart.len().max(1);
    let mean_m = apart.iter().map(|&d| f64::from(d)).sum::<f64>() / count as f64;
    let last = apart.len().saturating_sub(1);
    let p95_m = apart.get((0.95 * last as f64).round() as usize).map_or(0.0, |&d| f64::from(d));
    let near = Points::new(points);
    let shares: Vec<[f64; 4]> = cones
        .par_iter()
        .map(|cone| {
            let length_m = cone.from.distance(cone.to);
            let pieces = ((length_m / PIECE_M).ceil() as usize).clamp(1, MOST_PIECES);
            let mut sum = [0.0; 4];
            for k in 0..pieces {
                let t = (k as f32 + 0.5) / pieces as f32;
                let radius_m = cone.radius_m[0] + (cone.radius_m[1] - cone.radius_m[0]) * t;
                let off = near.nearest(cone.from.lerp(cone.to, t));
                let is_out = off.is_none_or(|(_, d)| d - radius_m > OUTSIDE_M);
                let length = f64::from(length_m) / pieces as f64;
                let volume = length * f64::from(radius_m * radius_m);
                let out = f64::from(u8::from(is_out));
                for (s, v) in sum.iter_mut().zip([length, volume, length * out, volume * out]) {
                    *s += v;
                }
            }
            sum
        })
        .collect();
    let mut sum = [0.0f64; 4];
    for piece in &shares {
        for (s, v) in sum.iter_mut().zip(piece) {
            *s += v;
        }
    }
    let [length, volume, outside_length, outside_volume] = sum;
    Fit {
        mean_m,
        p95_m,
        outside_length: outside_length / length.max(1e-12),
        outside_volume: outside_volume / volume.max(1e-12),
    }
}
