//! What of a cloud is the tree: strays and the ground left out.

use std::collections::BTreeMap;

use glam::{Vec2, Vec3};
use rayon::prelude::*;

use super::graph::Sets;
use super::near::Points;

/// A point whose neighbours are farther than this many times the usual is a stray.
const STRAY: f32 = 12.0;
const STRAY_LEAST_M: f32 = 0.4;
const NEIGHBOURS: usize = 4;
/// Low growth goes with the ground up to this share of the height.
const LOW: f32 = 0.03;
/// Cells that must show ground.
const LEAST_CELLS: usize = 12;

/// Points with others near; the rest are counted.
pub(super) fn without_strays(points: &[Vec3]) -> (Vec<Vec3>, usize) {
    let near = Points::new(points);
    let apart_m = |p: &Vec3| near.around(*p).nth(NEIGHBOURS).map_or(f32::INFINITY, |n| n.1);
    let apart: Vec<f32> = points.par_iter().map(apart_m).collect();
    let mut sorted: Vec<f32> = apart.iter().copied().filter(|d| d.is_finite()).collect();
    sorted.sort_unstable_by(f32::total_cmp);
    let usual_m = sorted.get(sorted.len() / 2).copied().unwrap_or(0.0);
    let most_m = (STRAY * usual_m).max(STRAY_LEAST_M);
    let kept: Vec<Vec3> =
        points.iter().zip(&apart).filter(|(_, d)| **d <= most_m).map(|(p, _)| *p).collect();
    let strays = points.len() - kept.len();
    (kept, strays)
}

/// The ground as a plane.
#[derive(Debug, Clone, Copy)]
pub(super) struct Ground {
    /// Height = x·slope.x + y·slope.y + level.
    slope: Vec2,
    level_m: f32,
    /// Lower points away from the stem belong to the ground or to what grows on it.
    pub low_m: f32,
}

impl Ground {
    pub fn height_m(&self, at: Vec2) -> f32 {
        self.slope.dot(at) + self.level_m
    }

    pub fn above_m(&self, p: Vec3) -> f32 {
        p.z - self.height_m(p.truncate())
    }
}

/// The ground, where the lowest layer of the cloud is wide, thin and apart from the crown.
pub(super) fn ground(points: &[Vec3], height_m: f32) -> Option<Ground> {
    let (low, high) = bounds(points);
    let across_m = (high - low).truncate().max_element();
    let cell_m = (across_m / 12.0).clamp(0.1, 2.0);
    let mut lowest: BTreeMap<[i32; 2], Vec3> = BTreeMap::new();
    for &p in points {
        let cell = (p.truncate() / cell_m).floor();
        let entry = lowest.entry([cell.x as i32, cell.y as i32]).or_insert(p);
        if p.z < entry.z {
            *entry = p;
        }
    }
    // Slopes up to 45° count as one layer.
    let layer_m = (0.05 * height_m).max(0.1) + across_m;
    let all: Vec<Vec3> = lowest.into_values().collect();
    let mut cells: Vec<Vec3> =
        all.iter().copied().filter(|p| p.z < low.z + layer_m.min(0.2 * height_m)).collect();
    if cells.len() < LEAST_CELLS || 3 * cells.len() < all.len() {
        return None;
    }
    let thin_m = (0.015 * height_m).max(0.08);
    let mut plane = (Vec2::ZERO, 0.0);
    for _ in 0..6 {
        plane = fitted_plane(&cells)?;
        let off = |p: &Vec3| p.z - plane.0.dot(p.truncate()) - plane.1;
        let kept: Vec<Vec3> =
            cells.iter().copied().filter(|p| off(p).abs() < 2.0 * thin_m).collect();
        if kept.len() == cells.len() {
            break;
        }
        if kept.len() < LEAST_CELLS {
            // Start again from what is lowest.
            cells.sort_unstable_by(|a, b| a.z.total_cmp(&b.z));
            cells.truncate(3 * cells.len() / 4);
            if cells.len() < LEAST_CELLS {
                return None;
            }
        } else {
            cells = kept;
        }
    }
    let is_level = plane.0.length() < 1.2 && plane.0.is_finite();
    let is_wide = 4 * cells.len() >= all.len();
    (is_level && is_wide).then_some(Ground {
        slope: plane.0,
        level_m: plane.1,
        low_m: (LOW * height_m).max(0.12),
    })
}

fn fitted_plane(points: &[Vec3]) -> Option<(Vec2, f32)> {
    let n = points.len() as f64;
    let mean = points.iter().map(|p| p.as_dvec3()).sum::<glam::DVec3>() / n;
    let (mut xx, mut xy, mut yy, mut xz, mut yz) = (0.0, 0.0, 0.0, 0.0, 0.0);
    for p in points {
        let d = p.as_dvec3() - mean;
        xx += d.x * d.x;
        xy += d.x * d.y;
        yy += d.y * d.y;
        xz += d.x * d.z;
        yz += d.y * d.z;
    }
    let determinant = xx * yy - xy * xy;
    if determinant < 1e-9 * (xx + yy).powi(2) || !determinant.is_finite() {
        return None;
    }
    let slope = glam::DVec2::new(xz * yy - yz * xy, yz * xx - xz * xy) / determinant;
    Some((slope.as_vec2(), (mean.z - slope.dot(mean.truncate())) as f32))
}

/// Whether a tenth of the points or more stand apart from the rest, seen from above, by `gap_m`.
pub(super) fn is_parted(points: &[Vec3], gap_m: f32) -> bool {
    let plan: Vec<Vec3> = points.iter().map(|p| p.with_z(0.0)).collect();
    let edge_m = 0.2 * gap_m;
    let places = thinned(&plan, edge_m);
    let near = Points::new(&places);
    let mut sets = Sets::new(places.len());
    for (i, p) in places.iter().enumerate() {
        for (j, _) in near.within(*p, gap_m) {
            sets.join(i as u32, j);
        }
    }
    let mut sizes: BTreeMap<u32, usize> = BTreeMap::new();
    for (place, _) in plan.iter().filter_map(|p| near.nearest(*p)) {
        *sizes.entry(sets.find(place)).or_default() += 1;
    }
    sizes.values().filter(|&&size| 10 * size >= points.len()).count() > 1
}

/// Least and greatest corner; zero without points.
pub(super) fn bounds(points: &[Vec3]) -> (Vec3, Vec3) {
    let mut all = points.iter().copied();
    let Some(first) = all.next() else { return (Vec3::ZERO, Vec3::ZERO) };
    all.fold((first, first), |(low, high), p| (low.min(p), high.max(p)))
}

/// One point a cell of `edge_m`: of those in it the nearest to their mean, in the order of cells.
pub(super) fn thinned(points: &[Vec3], edge_m: f32) -> Vec<Vec3> {
    let cell = |p: Vec3| (p / edge_m).floor().as_ivec3().to_array();
    let mut order: Vec<([i32; 3], u32)> =
        points.par_iter().enumerate().map(|(i, p)| (cell(*p), i as u32)).collect();
    order.par_sort_unstable();
    order
        .chunk_by(|a, b| a.0 == b.0)
        .filter_map(|chunk| {
            let at = |e: &([i32; 3], u32)| points[e.1 as usize];
            let mean = chunk.iter().map(at).sum::<Vec3>() / chunk.len() as f32;
            chunk
                .iter()
                .map(at)
                .min_by(|a, b| a.distance_squared(mean).total_cmp(&b.distance_squared(mean)))
        })
        .collect()
}
