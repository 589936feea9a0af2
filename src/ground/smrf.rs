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
//! - The coarsest level stands on planes fitted to the surroundings of each of its cells.
//! - Low outliers are found before ([`super::lowest`]) and after each level (opening of the inverted
//!   surface).
//! - What the opening took from crests and cliff edges is grown back ([`super::regrow`]).
//! - Voids are filled by the membrane of [`crate::raster::inpaint`].
//!
//! Known limits: a building wider than the largest window is ground; undergrowth so dense that no
//! pulse passes lifts the ground; of a plot with fewer than six squares of 8 m no trend is known, and of
//! a steep one only the lower part is found.

use glam::{Vec2, Vec3};
use rayon::prelude::*;

use super::lowest::{CELL_M, Lowest};
use super::morphology::{Image, open_disk};
use super::regrow::regrow;
use crate::raster::{Grid, GridGeometry, inpaint, scatter};

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

/// Cells that one thread takes at a time.
const TOGETHER: usize = 1 << 12;

/// Heights, reaching a cell beyond the points.
pub struct Surface(Grid<f32>);

impl Surface {
    /// Which of `points` are ground.
    pub fn ground(&self, points: &[Vec3]) -> Vec<bool> {
        let is_ground = |p: &Vec3| {
            let at = p.truncate();
            let beyond = (p.z - self.height_at(at)).abs() - NEAR_M;
            // The gradient is asked for only where it decides.
            beyond <= 0.0
                || beyond <= NEAR_SLOPE * STEEPEST
                    && beyond <= NEAR_SLOPE * self.gradient(at, CELL_M as f32).min(STEEPEST)
        };
        points.par_iter().map(is_ground).collect()
    }

    fn height_at(&self, p: Vec2) -> f32 {
        self.0.bilinear(p.x.into(), p.y.into())
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
}

/// Through the ground, as far as the lowest points show it.
pub fn surface(lowest: &Lowest) -> Surface {
    let mut surface = Surface(lowest.trend.clone());
    for level in (0..=LEVELS).rev() {
        let geometry = lowest.geometry(2f64.powi(level));
        let trend = surface.0.resampled(geometry);
        let low = lowest_heights(&lowest.points, &surface, geometry);
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
        surface.0 = sum(&above, &trend);
    }
    surface
}

fn sum(a: &Grid<f32>, b: &Grid<f32>) -> Grid<f32> {
    let sums = a.data.par_iter().with_min_len(TOGETHER).zip(&b.data).map(|(a, b)| a + b);
    Grid { geometry: a.geometry, data: sums.collect() }
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
        let cells = is_object.par_iter_mut().with_min_len(TOGETHER).zip(&last.data);
        cells.zip(&opened.data).zip(tolerance).for_each(|(((object, last), opened), tolerance)| {
            *object |= last - opened > *tolerance;
        });
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

/// Least height above the surface by cell; infinite where there is no point.
fn lowest_heights(points: &[Vec3], surface: &Surface, geometry: GridGeometry) -> Grid<f32> {
    let above = points.par_iter().filter_map(|p| {
        let (c, r) = geometry.cell_of(p.x.into(), p.y.into())?;
        Some((geometry.index(c, r), p.z - surface.height_at(p.truncate())))
    });
    Grid { geometry, data: scatter::least(geometry.len(), above) }
}

/// Binomial filter of 3 × 3 cells.
fn smooth(grid: &mut Grid<f32>) {
    let (cols, rows) = (grid.geometry.cols, grid.geometry.rows);
    let mean = |a: f32, b: f32, c: f32| 0.25 * a + 0.5 * b + 0.25 * c;
    let mut across = grid.data.clone();
    let lines = across.par_chunks_mut(cols).zip(grid.data.par_chunks(cols));
    lines.with_min_len(TOGETHER / cols + 1).for_each(|(out, row)| {
        for (c, z) in out.iter_mut().enumerate() {
            *z = mean(row[c.saturating_sub(1)], row[c], row[(c + 1).min(cols - 1)]);
        }
    });
    let lines = grid.data.par_chunks_mut(cols).enumerate();
    lines.with_min_len(TOGETHER / cols + 1).for_each(|(r, out)| {
        let line = |r: usize| &across[r * cols..(r + 1) * cols];
        let (above, own, below) = (line(r.saturating_sub(1)), line(r), line((r + 1).min(rows - 1)));
        for (c, z) in out.iter_mut().enumerate() {
            *z = mean(above[c], own[c], below[c]);
        }
    });
}
