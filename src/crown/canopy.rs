//! The canopy height model: the greatest height above terrain in each cell, freed of pits and
//! smoothed by a kernel that grows with the height of the canopy.
//!
//! Cell size and kernel follow from the density of the points and from the heights alone, so that
//! one set of constants serves 1.8 points/m² from the air and a single tree from the ground.
//!
//! Pits (cells far below their neighbours, where the pulse passed the crown's surface; Khosravipour
//! et al. 2014) take the median of their neighbourhood; empty cells take the mean of filled
//! neighbours, a ring at a time. Known limit: gaps narrower than three cells are closed with them.

use glam::Vec3;
use rayon::prelude::*;

use super::voids::{UNKNOWN, fill_pits, fill_voids, grow};
use crate::frame::bounds;
use crate::raster::{Grid, GridGeometry, floor, scatter};

/// Kernel: standard deviation, metres, at no height and its growth per metre of height.
const KERNEL_BASE_M: f32 = 0.35;
const KERNEL_PER_M: f32 = 0.006;
/// Standard deviations of the precomputed levels grow by this factor.
const KERNEL_STEP: f32 = 1.5;
/// Heights go on so far beyond the edge of what is known: three deviations for a tree of 50 m. It is
/// the same whatever stands elsewhere, so that tiles and the whole scan agree.
const GROWN_M: f32 = 2.0;

/// Points per occupied square metre, over squares of 2 m; 0 for no points.
pub(super) fn density_per_sq_m(position: &[Vec3]) -> f64 {
    let Some((low, high)) = bounds(position) else { return 0.0 };
    let along = |v: f32| floor(v * 0.5);
    let of_squares = |n: usize| position.len() as f64 / (4 * n.max(1)) as f64;
    let [cols, rows] = [(low.x, high.x), (low.y, high.y)]
        .map(|(low, high)| (i64::from(along(high)) - i64::from(along(low)) + 1) as usize);
    if let Some(squares) = cols.checked_mul(rows).filter(|n| *n <= position.len().max(1 << 20)) {
        let place = |p: &Vec3| {
            (along(p.y) - along(low.y)) as usize * cols + (along(p.x) - along(low.x)) as usize
        };
        return of_squares(scatter::filled(squares, position.par_iter().map(place)));
    }
    // Column and row in one word, which sorts faster than a pair.
    let square = |p: &Vec3| u64::from(along(p.y) as u32) << 32 | u64::from(along(p.x) as u32);
    let mut squares: Vec<u64> = position
        .par_chunks(1 << 16)
        .flat_map_iter(|run| {
            let mut squares: Vec<u64> = run.iter().map(square).collect();
            squares.dedup();
            squares.sort_unstable();
            squares.dedup();
            squares
        })
        .collect();
    squares.par_sort_unstable();
    squares.dedup();
    of_squares(squares.len())
}

/// Cells that are chosen among, metres. Far apart, so that like densities give one cell; all
/// divide [`crate::scan::ALIGNMENT_M`] and are exact in binary, so that no point changes its cell
/// with the origin.
const CELLS_M: [f64; 6] = [0.3125, 0.375, 0.5, 0.625, 0.75, 1.0];

/// The cell that comes nearest to holding one point.
pub(super) fn cell_for_density(density_per_sq_m: f64) -> f64 {
    let wanted = 1.0 / density_per_sq_m.max(1e-9).sqrt();
    let off = |cell: &f64| (cell / wanted).ln().abs();
    CELLS_M.into_iter().min_by(|a, b| off(a).total_cmp(&off(b))).unwrap_or(1.0)
}

/// So many cells are no burden, however few points there are: more than a block of tiles has, so that
/// plots apart get the cells that each would get alone.
const FREE_CELLS: f64 = (1 << 23) as f64;

/// The smallest covering grid with no more cells than memory in proportion to `count` points
/// allows: a few points very far apart get larger cells.
pub(super) fn geometry(min: [f64; 2], max: [f64; 2], cell_m: f64, count: usize) -> GridGeometry {
    let limit = 16.0 * count as f64 + FREE_CELLS;
    let mut cell = cell_m;
    for _ in 0..64 {
        if ((max[0] - min[0]) / cell + 2.0) * ((max[1] - min[1]) / cell + 2.0) <= limit {
            break;
        }
        cell *= 1.5;
    }
    GridGeometry::covering(min, max, cell)
}

/// The canopy on one grid.
pub(super) struct Canopy {
    /// Greatest height in each cell, voids and pits filled; 0 where bare.
    pub top: Grid<f32>,
    /// That, smoothed: what crowns are told apart by. It spills over the crowns' edges.
    pub smooth: Grid<f32>,
}

/// `points`: place and height above terrain of each point that may be canopy; `bare`: places seen
/// to be ground.
///
/// With more than one of `grids`, the smooth surface is the mean of those on so many times so many
/// grids, each shifted by that part of a cell: where the cells happen to lie then matters less.
pub(super) fn build(
    geometry: GridGeometry,
    points: impl ParallelIterator<Item = (Vec3, f32)> + Clone,
    bare: impl ParallelIterator<Item = Vec3> + Clone,
    grids: usize,
) -> Canopy {
    let mut canopy = on_grid(geometry, points.clone(), bare.clone());
    for k in 1..grids * grids {
        let part = |k: usize| k as f64 / grids as f64;
        let shifted = GridGeometry {
            west: geometry.west - part(k % grids) * geometry.cell_x,
            north: geometry.north + part(k / grids) * geometry.cell_y,
            cols: geometry.cols + 1,
            rows: geometry.rows + 1,
            ..geometry
        };
        let other = on_grid(shifted, points.clone(), bare.clone()).smooth.resampled(geometry);
        let sum = canopy.smooth.data.par_iter_mut().zip(&other.data);
        sum.for_each(|(sum, other)| *sum += other);
    }
    let share = 1.0 / (grids * grids).max(1) as f32;
    if grids > 1 {
        canopy.smooth.data.par_iter_mut().for_each(|sum| *sum *= share);
    }
    canopy
}

fn on_grid(
    geometry: GridGeometry,
    points: impl ParallelIterator<Item = (Vec3, f32)>,
    bare: impl ParallelIterator<Item = Vec3>,
) -> Canopy {
    let heights = bare.map(|p| (p, 0.0)).chain(points).filter_map(|(p, height)| {
        let (c, r) = geometry.cell_of(f64::from(p.x), f64::from(p.y))?;
        Some((geometry.index(c, r), f32::max(height, 0.0)))
    });
    let data = scatter::greatest(geometry.len(), UNKNOWN, heights);
    let mut top = Grid { geometry, data };
    fill_voids(&mut top);
    fill_pits(&mut top);
    let smooth = smoothed(&top);
    top.data.par_iter_mut().for_each(|h| *h = h.max(0.0));
    Canopy { top, smooth }
}

/// Each cell from the Gaussian whose width fits its height, linear between precomputed levels. Beyond
/// the edge of what is known, heights go on as they are at the edge.
fn smoothed(top: &Grid<f32>) -> Grid<f32> {
    let cell = top.geometry.cell_x as f32;
    let highest = top.data.par_iter().copied().reduce(|| 0.0f32, f32::max);
    let width = |h: f32| KERNEL_BASE_M + KERNEL_PER_M * h;
    let mut grid = top.clone();
    grow(&mut grid, (GROWN_M / cell).ceil() as usize);
    grid.data.par_iter_mut().for_each(|h| *h = h.max(0.0));
    let grid = &grid;
    let mut level_m = KERNEL_BASE_M;
    let mut lower = gaussian(grid, level_m / cell);
    // The width is chosen by the mildly smoothed height: a single high return widens nothing.
    let guide = lower.data.clone();
    let mut out = lower.clone();
    while level_m < width(highest) {
        let upper_m = level_m * KERNEL_STEP;
        let upper = gaussian(grid, upper_m / cell);
        let levels = lower.data.par_iter().zip(&upper.data).zip(&guide);
        out.data.par_iter_mut().zip(levels).for_each(|(value, ((lower, upper), guide))| {
            let w = width(*guide);
            if w > level_m {
                let t = ((w - level_m) / (upper_m - level_m)).min(1.0);
                *value = lower + (upper - lower) * t;
            }
        });
        lower = upper;
        level_m = upper_m;
    }
    out
}

/// Separable Gaussian, `sigma` in cells, borders repeated.
fn gaussian(grid: &Grid<f32>, sigma: f32) -> Grid<f32> {
    let reach = (3.0 * sigma).ceil() as usize;
    if sigma < 0.2 || reach == 0 {
        return grid.clone();
    }
    let mut weight: Vec<f32> = (0..=2 * reach)
        .map(|i| (-0.5 * ((i as f32 - reach as f32) / sigma).powi(2)).exp())
        .collect();
    let total: f32 = weight.iter().sum();
    weight.iter_mut().for_each(|w| *w /= total);
    let (cols, rows) = (grid.geometry.cols, grid.geometry.rows);
    let mut across = vec![0.0f32; grid.data.len()];
    let lines = grid.data.par_chunks(cols).zip(across.par_chunks_mut(cols));
    lines.for_each_init(Vec::new, |padded: &mut Vec<f32>, (line, out)| {
        padded.clear();
        padded.extend(std::iter::repeat_n(line[0], reach));
        padded.extend_from_slice(line);
        padded.extend(std::iter::repeat_n(line[cols - 1], reach));
        weigh(out, &weight, |k| &padded[k..k + cols]);
    });
    let mut data = vec![0.0f32; grid.data.len()];
    data.par_chunks_mut(cols).enumerate().for_each(|(r, out)| {
        weigh(out, &weight, |k| {
            let from = (r + k).saturating_sub(reach).min(rows - 1) * cols;
            &across[from..from + cols]
        });
    });
    Grid { geometry: grid.geometry, data }
}

/// The weighted sum of lines, all as long as `out`. Sums of a few columns at a time stay in
/// registers.
fn weigh<'a>(out: &mut [f32], weight: &[f32], line: impl Fn(usize) -> &'a [f32]) {
    const ABREAST: usize = 32;
    let (blocks, rest) = out.as_chunks_mut::<ABREAST>();
    for (b, sums) in blocks.iter_mut().enumerate() {
        let mut acc = [0.0f32; ABREAST];
        for (k, w) in weight.iter().enumerate() {
            let (values, _) = line(k)[b * ABREAST..].as_chunks::<ABREAST>();
            for (sum, v) in acc.iter_mut().zip(&values[0]) {
                *sum += w * v;
            }
        }
        *sums = acc;
    }
    let from = blocks.len() * ABREAST;
    for (i, sum) in rest.iter_mut().enumerate() {
        *sum = weight.iter().enumerate().map(|(k, w)| w * line(k)[from + i]).sum();
    }
}
