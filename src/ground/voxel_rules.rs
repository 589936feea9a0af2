//! The source's voxel rules (T15; method "Ground and vegetation").
//!
//! Readings taken where the source is silent:
//! - A column is one voxel wide; the terrain type is judged in cells of ten columns by
//!   R_i = 1 − RSS_i/TSS_i with ẑ the mean z of a cell's column floors and z̄ their least z.
//! - R_i ≥ 0.75: the points within a voxel of their column's least z are ground.
//! - Otherwise h_min is the root mean square of the column floors above the cell's least z, and
//!   points of a voxel with P ≥ tr below h_min are ground.
//! - tr is 1 point: airborne scans leave most voxels of the ground with a point or two.
//!
//! Known limits: as the source says, the result depends on the cloud; a column without ground
//! returns has a floor in the canopy, which is why floors far above their neighbours are left out.

use glam::Vec3;

use crate::raster::GridGeometry;

const VOXEL_M: f64 = 1.0;
/// Columns along a side of a terrain cell.
const CELL: usize = 10;
const FLAT: f64 = 0.75;
/// A floor this far above the lowest of its cell, per metre of the cell's width, is canopy.
const STEEPEST: f32 = 1.0;
const MOST_CELLS: f64 = 30e6;

fn knob(name: &str, default: f64) -> f64 {
    std::env::var(name).ok().and_then(|v| v.parse().ok()).unwrap_or(default)
}

/// Which points are ground. At least one point, all finite.
pub fn ground(points: &[Vec3]) -> Vec<bool> {
    if knob("V", 0.0) > 0.0 { return variant(points); }
    let first = points[0];
    let (low, high) = points.iter().fold((first, first), |(a, b), p| (a.min(*p), b.max(*p)));
    let area = f64::from((high.x - low.x).max(1.0)) * f64::from((high.y - low.y).max(1.0));
    let voxel = VOXEL_M.max((area / MOST_CELLS).sqrt());
    let columns =
        GridGeometry::covering([low.x.into(), low.y.into()], [high.x.into(), high.y.into()], voxel);
    let mut floor = vec![f32::INFINITY; columns.len()];
    let place = |p: &Vec3| columns.cell_of(p.x.into(), p.y.into());
    for p in points {
        if let Some((c, r)) = place(p) {
            let i = columns.index(c, r);
            floor[i] = floor[i].min(p.z);
        }
    }
    let (across, down) = (columns.cols.div_ceil(CELL), columns.rows.div_ceil(CELL));
    let limits: Vec<Limit> = (0..across * down)
        .map(|i| {
            let (c0, r0) = (i % across * CELL, i / across * CELL);
            let floors: Vec<f32> = (r0..(r0 + CELL).min(columns.rows))
                .flat_map(|r| (c0..(c0 + CELL).min(columns.cols)).map(move |c| (c, r)))
                .map(|(c, r)| floor[columns.index(c, r)])
                .filter(|z| z.is_finite())
                .collect();
            Limit::of(&floors, STEEPEST * CELL as f32 * voxel as f32)
        })
        .collect();
    points
        .iter()
        .map(|p| {
            let Some((c, r)) = place(p) else { return false };
            let limit = &limits[r / CELL * across + c / CELL];
            let own = floor[columns.index(c, r)];
            if own > limit.highest_floor {
                return false;
            }
            let reach = if limit.is_flat { own + voxel as f32 } else { limit.h_min };
            p.z <= reach && p.z <= own + voxel as f32
        })
        .collect()
}

/// What a terrain cell says of its columns.
struct Limit {
    is_flat: bool,
    /// Local height.
    h_min: f32,
    highest_floor: f32,
}

impl Limit {
    fn of(floors: &[f32], most_rise: f32) -> Self {
        let least = floors.iter().copied().fold(f32::INFINITY, f32::min);
        let above: Vec<f64> = floors
            .iter()
            .map(|z| f64::from(z - least))
            .filter(|&h| h <= f64::from(most_rise))
            .collect();
        let n = above.len().max(1) as f64;
        let mean = above.iter().sum::<f64>() / n;
        let rss: f64 = above.iter().map(|h| (h - mean).powi(2)).sum();
        let tss: f64 = above.iter().map(|h| h * h).sum();
        // A cell of equal floors has no spread to explain and is as flat as can be.
        let r = if tss > 0.0 { 1.0 - rss / tss } else { 1.0 };
        Limit {
            is_flat: r >= FLAT,
            h_min: least + (tss / n).sqrt() as f32,
            highest_floor: least + most_rise,
        }
    }
}

fn variant(points: &[Vec3]) -> Vec<bool> {
    let mode = knob("V", 0.0) as i32;
    let region = knob("VR", 5.0);
    let steep = knob("VS", 1.0) as f32;
    let voxel = knob("VV", 1.0) as f32;
    let from_points = knob("VP", 1.0) > 0.0;
    let first = points[0];
    let (low, high) = points.iter().fold((first, first), |(a, b), p| (a.min(*p), b.max(*p)));
    let g = |c: f64| GridGeometry::covering([low.x.into(), low.y.into()], [high.x.into(), high.y.into()], c);
    let regions = g(region);
    let columns = g(f64::from(voxel));
    let mut floor = vec![f32::INFINITY; columns.len()];
    for p in points {
        if let Some((c, r)) = columns.cell_of(p.x.into(), p.y.into()) {
            let i = columns.index(c, r);
            floor[i] = floor[i].min(p.z);
        }
    }
    let mut members: Vec<Vec<f32>> = vec![Vec::new(); regions.len()];
    let mut floors: Vec<Vec<f32>> = vec![Vec::new(); regions.len()];
    for p in points {
        if let Some((c, r)) = regions.cell_of(p.x.into(), p.y.into()) {
            members[regions.index(c, r)].push(p.z);
        }
    }
    for (i, z) in floor.iter().enumerate() {
        let [x, y] = columns.centre(i % columns.cols, i / columns.cols);
        if z.is_finite() && let Some((c, r)) = regions.cell_of(x, y) {
            floors[regions.index(c, r)].push(*z);
        }
    }
    let stats: Vec<(f32, f32, f32)> = (0..regions.len()).map(|i| {
        let (m, f) = (&members[i], &floors[i]);
        let of = if from_points { m } else { f };
        let least = m.iter().copied().fold(f32::INFINITY, f32::min);
        let n = of.len().max(1) as f32;
        let mean = of.iter().map(|z| z - least).sum::<f32>() / n;
        let tss = of.iter().map(|z| (z - least).powi(2)).sum::<f32>();
        let rss = of.iter().map(|z| (z - least - mean).powi(2)).sum::<f32>();
        let r = if tss > 0.0 { 1.0 - rss / tss } else { 1.0 };
        let near: Vec<f32> = f.iter().map(|z| z - least).filter(|h| *h <= steep * region as f32).collect();
        let rms = (near.iter().map(|h| h * h).sum::<f32>() / near.len().max(1) as f32).sqrt();
        (least, r, least + rms)
    }).collect();
    points.iter().map(|p| {
        let Some((c, r)) = regions.cell_of(p.x.into(), p.y.into()) else { return false };
        let (least, flat, h_min) = stats[regions.index(c, r)];
        let own = columns.cell_of(p.x.into(), p.y.into()).map_or(f32::INFINITY, |(c, r)| floor[columns.index(c, r)]);
        match mode {
            // least of every region
            1 => p.z <= least,
            // least of flat, below h_min elsewhere
            2 => if flat >= 0.75 { p.z <= least } else { p.z <= h_min && p.z <= own + voxel },
            // the voxel of the least in flat, below h_min elsewhere
            3 => if flat >= 0.75 { p.z <= least + voxel && p.z <= own + voxel } else { p.z <= h_min && p.z <= own + voxel },
            // least of flat, nothing elsewhere
            4 => flat >= 0.75 && p.z <= least,
            // least of flat, least in others and below h_min floors
            5 => if flat >= 0.75 { p.z <= least } else { p.z <= h_min && p.z <= own },
            _ => p.z <= least + 0.3,
        }
    }).collect()
}
