//! The canopy height model: the greatest height above terrain in each cell, freed of pits and
//! smoothed by a kernel that grows with the height of the canopy.
//!
//! Cell size and kernel follow from the density of the points and from the heights alone, so that
//! one set of constants serves 1.8 points/m² from the air and a single tree from the ground.
//!
//! Pits (cells far below their neighbours, where the pulse passed the crown's surface; Khosravipour
//! et al. 2014) take the median of their neighbourhood; empty cells take the mean of filled
//! neighbours, a ring at a time. Known limit: gaps narrower than three cells are closed with them.

use std::ops::Range;

use glam::Vec3;
use rayon::prelude::*;

use crate::frame::bounds;
use crate::raster::{Grid, GridGeometry, floor, scatter};

/// Rings of empty cells that are filled from their neighbours; cells farther out are bare.
const FILL_RINGS: usize = 3;
/// A cell this far below the median of its neighbours is a pit, metres and part of the median.
const PIT_DEPTH_M: f32 = 1.0;
const PIT_DEPTH_RELATIVE: f32 = 0.1;
/// Kernel: standard deviation, metres, at no height and its growth per metre of height.
const KERNEL_BASE_M: f32 = 0.35;
const KERNEL_PER_M: f32 = 0.006;
/// Standard deviations of the precomputed levels grow by this factor.
const KERNEL_STEP: f32 = 1.5;

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

/// The height of a cell in which, and about which, nothing was seen.
const UNKNOWN: f32 = f32::NEG_INFINITY;

/// Calls `f` with the numbers of the up to 8 neighbours of a cell.
fn for_neighbours(g: &GridGeometry, i: usize, mut f: impl FnMut(usize)) {
    let (col, row) = (i % g.cols, i / g.cols);
    for r in row.saturating_sub(1)..=(row + 1).min(g.rows - 1) {
        for c in col.saturating_sub(1)..=(col + 1).min(g.cols - 1) {
            if (c, r) != (col, row) {
                f(g.index(c, r));
            }
        }
    }
}

/// Fills gaps among known cells. What is grown beyond the edge of all that is known is taken back
/// (a closing), so that the edge of a scan is where its points end, however large the grid is.
fn fill_voids(grid: &mut Grid<f32>) {
    let mut filled = grow(grid, FILL_RINGS);
    let mut is_filled = vec![false; grid.data.len()];
    filled.iter().for_each(|&i| is_filled[i as usize] = true);
    for _ in 0..FILL_RINGS {
        let outer: Vec<u32> = (filled.par_iter().copied())
            .filter(|&i| {
                let mut known = 0;
                for_neighbours(&grid.geometry, i as usize, |n| {
                    known += usize::from(grid.data[n] > UNKNOWN);
                });
                known < 8
            })
            .collect();
        if outer.is_empty() {
            break;
        }
        for &i in &outer {
            grid.data[i as usize] = UNKNOWN;
            is_filled[i as usize] = false;
        }
        filled.retain(|&i| is_filled[i as usize]);
    }
}

/// Gives unknown cells the mean of their known neighbours, where these are at least three, a ring at
/// a time; gives the numbers of these cells.
fn grow(grid: &mut Grid<f32>, rings: usize) -> Vec<u32> {
    let g = grid.geometry;
    let is_unknown = |i: &u32| grid.data[*i as usize] == UNKNOWN;
    let mut open: Vec<u32> = (0..g.len() as u32).into_par_iter().filter(is_unknown).collect();
    // Those that are looked at next.
    let mut is_open = vec![false; if open.is_empty() { 0 } else { g.len() }];
    let mut all = Vec::new();
    for _ in 0..rings {
        let filled: Vec<(u32, f32)> = open
            .par_iter()
            .filter_map(|&i| {
                let (mut sum, mut n) = (0.0, 0);
                for_neighbours(&g, i as usize, |near| {
                    let h = grid.data[near];
                    if h > UNKNOWN {
                        sum += h;
                        n += 1;
                    }
                });
                (n >= 3).then(|| (i, sum / n as f32))
            })
            .collect();
        if filled.is_empty() {
            break;
        }
        for &(i, h) in &filled {
            grid.data[i as usize] = h;
        }
        // Only beside what is new can another have become surrounded.
        open.clear();
        for &(i, _) in &filled {
            for_neighbours(&g, i as usize, |n| {
                if grid.data[n] == UNKNOWN && !is_open[n] {
                    is_open[n] = true;
                    open.push(n as u32);
                }
            });
        }
        open.iter().for_each(|&i| is_open[i as usize] = false);
        all.extend(filled.into_iter().map(|(i, _)| i));
    }
    all
}

fn fill_pits(grid: &mut Grid<f32>) {
    let g = grid.geometry;
    let mut raised = grid.data.clone();
    let line = |row: usize| &grid.data[row * g.cols..(row + 1) * g.cols];
    raised.par_chunks_mut(g.cols).enumerate().for_each_init(Vec::new, |higher, (row, out)| {
        // Neighbours higher by the least depth of a pit: few cells have enough.
        higher.clear();
        higher.resize(g.cols, 0u8);
        let own = line(row);
        for r in row.saturating_sub(1)..=(row + 1).min(g.rows - 1) {
            let mut count = |to: Range<usize>, from: &[f32]| {
                for ((n, h), v) in higher[to.clone()].iter_mut().zip(&own[to]).zip(from) {
                    *n += u8::from(v - PIT_DEPTH_M > *h);
                }
            };
            count(0..g.cols, line(r));
            count(0..g.cols - 1, &line(r)[1..]);
            count(1..g.cols, &line(r)[..g.cols - 1]);
        }
        for (col, out) in out.iter_mut().enumerate() {
            // Even five neighbours have three from the median up.
            if higher[col] < 3 {
                continue;
            }
            let h = *out;
            if h == UNKNOWN {
                continue;
            }
            let mut around = [0.0f32; 8];
            let mut n = 0;
            for_neighbours(&g, row * g.cols + col, |i| {
                if grid.data[i] > UNKNOWN {
                    around[n] = grid.data[i];
                    n += 1;
                }
            });
            if n < 5 {
                continue;
            }
            around[..n].sort_unstable_by(f32::total_cmp);
            let median = around[n / 2];
            if h < median - PIT_DEPTH_M - PIT_DEPTH_RELATIVE * median {
                *out = median;
            }
        }
    });
    grid.data = raised;
}

/// Each cell from the Gaussian whose width fits its height, linear between precomputed levels. Beyond
/// the edge of what is known, heights go on as they are at the edge.
fn smoothed(top: &Grid<f32>) -> Grid<f32> {
    let cell = top.geometry.cell_x as f32;
    let highest = top.data.par_iter().copied().reduce(|| 0.0f32, f32::max);
    let width = |h: f32| KERNEL_BASE_M + KERNEL_PER_M * h;
    let mut grid = top.clone();
    grow(&mut grid, (3.0 * width(highest) / cell).ceil() as usize);
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
