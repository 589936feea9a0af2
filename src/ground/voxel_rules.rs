//! The source's voxel rules (T15; method "Ground and vegetation").
//!
//! Readings taken where the source is silent:
//! - Columns are one voxel wide; the terrain type is judged in regions of eight by eight columns
//!   (the source's "voxel many times enlarged"), from all of a region's points, as it says.
//! - The least z of a region is the lowest of [`TR`] points within the rise of [`STEEPEST`]: lone points
//!   below it are the source's P ≈ 0, and so E.
//! - R_i ≥ 0.75: the points of least z, which are ground, are those in the voxel above a region's
//!   least z.
//! - Otherwise h_min is the root mean square of the floors of the region's columns, counted from
//!   its least z; floors higher than [`STEEPEST`] allows are crowns and do not count.
//! - Rules judge voxels: one whose foot lies below h_min is ground as a whole. Either way a point
//!   is ground only in the lowest voxel of its own column.
//!
//! Taking the floors of all columns of a flat region for ground, or R_i from floors alone, lets
//! crowns in: both were measured and gave worse terrain.
//!
//! Known limits: as the source says, the result depends on the cloud. A region without ground
//! returns takes its floor from the crowns; on steep slopes only a part of a region's ground lies
//! below its limit.

use glam::Vec3;

use crate::raster::GridGeometry;

const VOXEL_M: f64 = 1.0;
/// Columns along a side of a region.
const REGION: usize = 8;
/// Points near each other that are not nothing.
const TR: usize = 3;
const FLAT: f64 = 0.75;
/// Rise of column floors over a region's side that is no crown.
const STEEPEST: f32 = 0.3;
const MOST_CELLS: f64 = 30e6;

/// Which points are ground. At least one point, all finite.
pub fn ground(points: &[Vec3]) -> Vec<bool> {
    let (low, high) = points
        .iter()
        .fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(a, b), p| (a.min(*p), b.max(*p)));
    let (min, max) = ([low.x, low.y].map(f64::from), [high.x, high.y].map(f64::from));
    let area = (max[0] - min[0]).max(1.0) * (max[1] - min[1]).max(1.0);
    let voxel = VOXEL_M.max((area / MOST_CELLS).sqrt());
    let regions = GridGeometry::covering(min, max, voxel * REGION as f64);
    let columns = GridGeometry::covering(min, max, voxel);
    let voxel = voxel as f32;
    let index =
        |g: &GridGeometry, p: &Vec3| g.cell_of(p.x.into(), p.y.into()).map(|(c, r)| g.index(c, r));

    let most_rise = STEEPEST * REGION as f32 * voxel;
    let mut heights: Vec<Vec<f32>> = vec![Vec::new(); regions.len()];
    for p in points {
        if let Some(i) = index(&regions, p) {
            heights[i].push(p.z);
        }
    }
    let mut limits: Vec<Limit> = heights.into_iter().map(|z| Limit::of(z, most_rise)).collect();
    let mut floor = vec![f32::INFINITY; columns.len()];
    for p in points {
        if let (Some(region), Some(i)) = (index(&regions, p), index(&columns, p))
            && p.z >= limits[region].least
        {
            floor[i] = floor[i].min(p.z);
        }
    }
    for (i, &z) in floor.iter().enumerate().filter(|(_, z)| z.is_finite()) {
        let [x, y] = columns.centre(i % columns.cols, i / columns.cols);
        if let Some((c, r)) = regions.cell_of(x, y) {
            limits[regions.index(c, r)].add_floor(z, most_rise);
        }
    }
    points
        .iter()
        .map(|p| {
            let (Some(region), Some(column)) = (index(&regions, p), index(&columns, p)) else {
                return false;
            };
            let limit = &limits[region];
            let h_min = if limit.is_flat { limit.least } else { limit.h_min() };
            p.z >= limit.least && p.z <= h_min.min(floor[column]) + voxel
        })
        .collect()
}

/// What a region says of its columns.
struct Limit {
    /// Local height.
    least: f32,
    is_flat: bool,
    /// Sum of the squared heights of floors above the least, and how many.
    floors: (f64, u32),
}

impl Limit {
    fn of(mut heights: Vec<f32>, most_rise: f32) -> Self {
        heights.sort_unstable_by(f32::total_cmp);
        let layer = heights.windows(TR).find(|w| w[TR - 1] - w[0] <= most_rise).map(|w| w[0]);
        let least = layer.or(heights.first().copied()).unwrap_or(f32::INFINITY);
        let above: Vec<f64> =
            heights.iter().filter(|&&z| z >= least).map(|z| f64::from(z - least)).collect();
        let mean = above.iter().sum::<f64>() / above.len().max(1) as f64;
        let rss: f64 = above.iter().map(|h| (h - mean).powi(2)).sum();
        let tss: f64 = above.iter().map(|h| h * h).sum();
        // Equal heights have no spread to explain and are as flat as can be.
        let r = if tss > 0.0 { 1.0 - rss / tss } else { 1.0 };
        Limit { least, is_flat: r >= FLAT, floors: (0.0, 0) }
    }

    fn add_floor(&mut self, z: f32, most_rise: f32) {
        let above = z - self.least;
        if above <= most_rise {
            self.floors.0 += f64::from(above).powi(2);
            self.floors.1 += 1;
        }
    }

    fn h_min(&self) -> f32 {
        self.least + (self.floors.0 / f64::from(self.floors.1.max(1))).sqrt() as f32
    }
}
