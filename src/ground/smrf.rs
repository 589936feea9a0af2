//! The simple morphological filter of Pingel, Clarke & McBride (2013): a minimum surface, opened
//! with windows that grow, flags what drops by more than a slope allows; what is left carries a
//! provisional surface, and points near it are ground.
//!
//! Departures:
//! - The filter runs coarse to fine, each level on heights above the surface of the level before.
//!   A steep slope is then nearly level where it is filtered, so that one slope tolerance serves
//!   plains and mountains, and ridges keep their tops.
//! - The tolerance grows with the gradient of the coarser surface.
//! - What a window may take off is bounded by the rise over one cell, not over the whole window:
//!   windows grow by one cell, so terrain within the tolerance loses no more than that to any of
//!   them, while a closed canopy falls at once by its height (the increment of Zhang 2003).
//! - Low outliers are found before (a gap below which there are few points) and after each level
//!   (opening of the inverted surface).
//! - What the opening took from crests and cliff edges is grown back ([`super::regrow`]).
//! - Voids are filled by the membrane of [`crate::raster::inpaint`].
//!
//! Known limits: a building wider than the largest window is ground; undergrowth so dense that no
//! pulse passes lifts the ground.

use glam::{DMat3, DVec3, Vec2, Vec3};
use rayon::prelude::*;

use super::morphology::{Image, open_disk};
use super::regrow::regrow;
use crate::raster::{Grid, GridGeometry, inpaint};

/// Finest cell, metres; from the scan's density if that is lower.
const CELL_M: f32 = 1.0;
/// Levels above the finest; each doubles the cell.
const LEVELS: i32 = 5;
/// Largest object to be removed: radius of the last window.
const WINDOW_M: f32 = 18.0;
/// Rise per metre that is no object, on level ground.
const SLOPE: f32 = 0.25;
/// That tolerance grows by so much per unit of the coarser surface's gradient.
const SLOPE_OF_SLOPE: f32 = 0.5;
/// Share of the slope tolerance at the finest level: what is left above a surface known at twice
/// the cell is roughness, not slope.
const FINEST: f32 = 0.1;
/// Height that is no object at any window.
const STEP_M: f32 = 0.25;
/// Regrown ground may leave the plane of its surroundings by [`STEP_M`] and, above the finest
/// level, by so much per metre of cell.
const REGROW_SLOPE: f32 = 0.2;
/// A pit deeper than so many tolerances is an outlier.
const PIT: f32 = 1.5;
/// Ground lies this close to the surface, and farther on slopes.
const NEAR_M: f32 = 0.15;
const NEAR_SLOPE: f32 = 0.1;
/// Gradients are taken as no steeper than this.
const STEEPEST: f32 = 3.0;
/// A cluster of low points with so large a gap above is noise.
const GAP_M: f32 = 3.0;
/// Most cells of any grid here; larger areas get larger cells.
const MOST_CELLS: f64 = 30e6;

/// Heights above a plane.
struct Surface {
    plane: Plane,
    above: Grid<f32>,
}

impl Surface {
    fn height_at(&self, p: Vec2) -> f32 {
        self.plane.height_at(p) + self.above.bilinear(p.x.into(), p.y.into())
    }

    /// The steeper of the two sides along each axis, over `reach_m`: a crest is as steep as its
    /// flanks.
    fn gradient(&self, p: Vec2, reach_m: f32) -> f32 {
        let here = self.height_at(p);
        let side = |step: Vec2| (self.height_at(p + step * reach_m) - here).abs() / reach_m;
        let x = side(Vec2::X).max(side(Vec2::NEG_X));
        let y = side(Vec2::Y).max(side(Vec2::NEG_Y));
        x.hypot(y)
    }

    /// Heights above the plane at the centres of another grid.
    fn resampled(&self, geometry: GridGeometry) -> Grid<f32> {
        let mut out = Grid::filled(geometry, 0.0);
        out.data.par_chunks_mut(geometry.cols).enumerate().for_each(|(row, heights)| {
            for (col, z) in heights.iter_mut().enumerate() {
                let [x, y] = geometry.centre(col, row);
                *z = self.above.bilinear(x, y);
            }
        });
        out
    }
}

/// Which of `points` are ground, judged by a surface through the lowest `candidates` (at least
/// three, finite).
pub fn ground(candidates: &[Vec3], points: &[Vec3]) -> Vec<bool> {
    let surface = surface(candidates);
    points
        .par_iter()
        .map(|p| {
            let at = p.truncate();
            let beyond = (p.z - surface.height_at(at)).abs() - NEAR_M;
            // The gradient is asked for only where it decides.
            beyond <= 0.0
                || beyond <= NEAR_SLOPE * STEEPEST
                    && beyond <= NEAR_SLOPE * surface.gradient(at, CELL_M).min(STEEPEST)
        })
        .collect()
}

fn surface(candidates: &[Vec3]) -> Surface {
    let first = candidates[0];
    let (low, high) = candidates.iter().fold((first, first), |(a, b), p| (a.min(*p), b.max(*p)));
    let (min, max) = ([low.x, low.y].map(f64::from), [high.x, high.y].map(f64::from));
    let extent = (high - low).truncate().max_element();
    let area = f64::from((high.x - low.x).max(1.0)) * f64::from((high.y - low.y).max(1.0));
    let cell = CELL_M.max((area * 4.0 / MOST_CELLS).sqrt() as f32);

    let half = GridGeometry::covering(min, max, f64::from(cell) * 0.5);
    let thinned = lowest_points(candidates, &half);
    let coarse = GridGeometry::covering(min, max, f64::from(extent / 8.0).max(1.0));
    let rough = Plane::through(&lowest_points(&thinned, &coarse));
    let kept = without_low_outliers(&thinned, &rough, cell);
    let plane = Plane::through(&lowest_points(&kept, &coarse));

    let top = GridGeometry::covering(min, max, f64::from(cell) * 2f64.powi(LEVELS));
    let mut surface = Surface { plane, above: Grid::filled(top, 0.0) };
    for level in (0..=LEVELS).rev() {
        let geometry = GridGeometry::covering(min, max, f64::from(cell) * 2f64.powi(level));
        let trend = surface.resampled(geometry);
        let low = lowest_heights(&kept, &surface, geometry);
        let mut is_known: Vec<bool> = low.data.iter().map(|z| z.is_finite()).collect();
        let mut above = low.clone();
        inpaint::fill(&mut above, &is_known);
        if level < LEVELS {
            let share = if level == 0 { FINEST } else { 1.0 };
            let tolerance = tolerances(&surface, &geometry, share);
            remove_objects(&mut above, &mut is_known, &tolerance);
            remove_pits(&mut above, &mut is_known, &tolerance);
            let coarseness_m = if level == 0 { 0.0 } else { geometry.cell_x as f32 };
            regrow(&sum(&low, &trend), &mut is_known, STEP_M + REGROW_SLOPE * coarseness_m);
            above = low;
            inpaint::fill(&mut above, &is_known);
        }
        if level > 0 {
            smooth(&mut above);
        }
        surface.above = sum(&above, &trend);
    }
    surface
}

fn sum(a: &Grid<f32>, b: &Grid<f32>) -> Grid<f32> {
    Grid { geometry: a.geometry, data: a.data.iter().zip(&b.data).map(|(a, b)| a + b).collect() }
}

/// Height difference that a cell may rise over its neighbour, by cell.
fn tolerances(surface: &Surface, geometry: &GridGeometry, share: f32) -> Vec<f32> {
    let cell = geometry.cell_x as f32;
    (0..geometry.len())
        .into_par_iter()
        .map(|i| {
            let [x, y] = geometry.centre(i % geometry.cols, i / geometry.cols);
            let gradient = surface.gradient(Vec2::new(x as f32, y as f32), cell.max(2.0));
            share * (SLOPE + SLOPE_OF_SLOPE * gradient) * cell + STEP_M
        })
        .collect()
}

/// Progressive opening (Pingel 2013, section 3.2).
fn remove_objects(above: &mut Grid<f32>, is_known: &mut [bool], tolerance: &[f32]) {
    let g = above.geometry;
    let mut last = Image { cols: g.cols, rows: g.rows, data: above.data.clone() };
    let widest = (WINDOW_M / g.cell_x as f32).ceil() as usize;
    let mut is_object = vec![false; g.len()];
    for radius in 1..=widest.min(g.cols.max(g.rows)) {
        let opened = open_disk(&last, radius);
        for (i, object) in is_object.iter_mut().enumerate() {
            *object |= last.data[i] - opened.data[i] > tolerance[i];
        }
        last = opened;
    }
    for (known, object) in is_known.iter_mut().zip(is_object) {
        *known &= !object;
    }
    inpaint::fill(above, is_known);
}

/// Opening of the inverted surface with the smallest window (section 3.1).
fn remove_pits(above: &mut Grid<f32>, is_known: &mut [bool], tolerance: &[f32]) {
    let g = above.geometry;
    let inverted =
        Image { cols: g.cols, rows: g.rows, data: above.data.iter().map(|z| -z).collect() };
    let opened = open_disk(&inverted, 1);
    let mut any = false;
    for (i, known) in is_known.iter_mut().enumerate() {
        if *known && inverted.data[i] - opened.data[i] > PIT * tolerance[i] {
            *known = false;
            any = true;
        }
    }
    if any {
        inpaint::fill(above, is_known);
    }
}

/// The lowest point of each cell that holds any, in the order of the cells.
fn lowest_points(points: &[Vec3], geometry: &GridGeometry) -> Vec<Vec3> {
    let mut lowest: Vec<Option<Vec3>> = vec![None; geometry.len()];
    for p in points {
        if let Some((c, r)) = geometry.cell_of(p.x.into(), p.y.into()) {
            let best = &mut lowest[geometry.index(c, r)];
            if best.is_none_or(|b| p.z < b.z) {
                *best = Some(*p);
            }
        }
    }
    lowest.into_iter().flatten().collect()
}

/// Least height above the surface by cell; infinite where there is no point.
fn lowest_heights(points: &[Vec3], surface: &Surface, geometry: GridGeometry) -> Grid<f32> {
    let heights: Vec<f32> =
        points.par_iter().map(|p| p.z - surface.height_at(p.truncate())).collect();
    let mut grid = Grid::filled(geometry, f32::INFINITY);
    for (p, z) in points.iter().zip(heights) {
        if let Some((c, r)) = geometry.cell_of(p.x.into(), p.y.into()) {
            let i = geometry.index(c, r);
            grid.data[i] = grid.data[i].min(z);
        }
    }
    grid
}

/// Drops points that lie with at most two others below a gap of [`GAP_M`] among the lowest of
/// their surroundings. Heights are taken above the plane, so that a slope opens no gaps.
fn without_low_outliers(points: &[Vec3], plane: &Plane, cell: f32) -> Vec<Vec3> {
    const LOWEST: usize = 4;
    const ENOUGH: usize = 8;
    let Some(&first) = points.first() else { return Vec::new() };
    let (low, high) = points.iter().fold((first, first), |(a, b), p| (a.min(*p), b.max(*p)));
    let g = GridGeometry::covering(
        [low.x.into(), low.y.into()],
        [high.x.into(), high.y.into()],
        f64::from(cell) * 8.0,
    );
    let mut lowest: Vec<Vec<u32>> = vec![Vec::new(); g.len()];
    let height: Vec<f32> = points.iter().map(|p| p.z - plane.height_at(p.truncate())).collect();
    let z = |i: u32| height[i as usize];
    for (i, p) in points.iter().enumerate() {
        let Some((c, r)) = g.cell_of(p.x.into(), p.y.into()) else { continue };
        let own = &mut lowest[g.index(c, r)];
        let at = own.partition_point(|&o| z(o) <= height[i]);
        if at < LOWEST {
            own.insert(at, i as u32);
            own.truncate(LOWEST);
        }
    }
    let mut is_outlier = vec![false; points.len()];
    for row in 0..g.rows {
        for col in 0..g.cols {
            let mut around: Vec<u32> = Vec::with_capacity(9 * LOWEST);
            for r in row.saturating_sub(1)..(row + 2).min(g.rows) {
                for c in col.saturating_sub(1)..(col + 2).min(g.cols) {
                    around.extend(&lowest[g.index(c, r)]);
                }
            }
            if around.len() < ENOUGH {
                continue;
            }
            around.sort_by(|&a, &b| z(a).total_cmp(&z(b)).then(a.cmp(&b)));
            let gap = (1..LOWEST).rev().find(|&k| z(around[k]) - z(around[k - 1]) > GAP_M);
            for &i in &around[..gap.unwrap_or(0)] {
                is_outlier[i as usize] = true;
            }
        }
    }
    let mut kept = points.iter().zip(&is_outlier).filter(|(_, o)| !**o).map(|(p, _)| *p).peekable();
    if kept.peek().is_none() { points.to_vec() } else { kept.collect() }
}

/// Binomial filter of 3 × 3 cells.
fn smooth(grid: &mut Grid<f32>) {
    let (cols, rows) = (grid.geometry.cols, grid.geometry.rows);
    let mean = |a: f32, b: f32, c: f32| 0.25 * a + 0.5 * b + 0.25 * c;
    let source = grid.data.clone();
    for r in 0..rows {
        let row = &source[r * cols..(r + 1) * cols];
        for c in 0..cols {
            let (west, east) = (row[c.saturating_sub(1)], row[(c + 1).min(cols - 1)]);
            grid.data[r * cols + c] = mean(west, row[c], east);
        }
    }
    let source = grid.data.clone();
    for r in 0..rows {
        for c in 0..cols {
            let at = |r: usize| source[r * cols + c];
            grid.data[r * cols + c] =
                mean(at(r.saturating_sub(1)), at(r), at((r + 1).min(rows - 1)));
        }
    }
}

struct Plane {
    at: Vec2,
    height: f32,
    slope: Vec2,
}

impl Plane {
    fn height_at(&self, p: Vec2) -> f32 {
        self.height + self.slope.dot(p - self.at)
    }

    /// Robust fit: least squares, reweighted by Cauchy's function of the residuals. The residuals'
    /// median sets the scale.
    fn through(points: &[Vec3]) -> Self {
        const ROUNDS: usize = 10;
        let n = points.len().max(1) as f64;
        let at = points.iter().fold(DVec3::ZERO, |s, p| s + p.as_dvec3()) / n;
        let mut weight = vec![1.0f64; points.len()];
        let mut fit = DVec3::ZERO;
        for _ in 0..ROUNDS {
            let (mut m, mut b) = (DMat3::IDENTITY * 1e-9, DVec3::ZERO);
            for (p, &w) in points.iter().zip(&weight) {
                let d = p.as_dvec3() - at;
                let v = DVec3::new(1.0, d.x, d.y);
                m += DMat3::from_cols(v * v.x * w, v * v.y * w, v * v.z * w);
                b += v * d.z * w;
            }
            let next = m.inverse() * b;
            if !next.is_finite() {
                break;
            }
            fit = next;
            let residual: Vec<f64> = points
                .iter()
                .map(|p| {
                    let d = p.as_dvec3() - at;
                    (d.z - fit.dot(DVec3::new(1.0, d.x, d.y))).abs()
                })
                .collect();
            let mut sorted = residual.clone();
            sorted.sort_by(f64::total_cmp);
            let scale = 2.0 * sorted.get(sorted.len() / 2).copied().unwrap_or(0.0).max(1e-3);
            for (w, r) in weight.iter_mut().zip(residual) {
                *w = 1.0 / (1.0 + (r / scale).powi(2));
            }
        }
        Plane {
            at: at.truncate().as_vec2(),
            height: (at.z + fit.x) as f32,
            slope: Vec2::new(fit.y as f32, fit.z as f32),
        }
    }
}
