//! Gives back what the opening took from ridges and the edges of cliffs: flagged cells that go on
//! where the ground around them points, grown outward from it cell by cell. A crown stands off
//! the ground by a step and is not reached.
//!
//! Known limits: a smooth mound of dense undergrowth can be climbed; a crest sharper than the cell
//! stays rounded.

use std::ops::Range;

use glam::{DMat3, DVec3};
use rayon::prelude::*;

use crate::raster::{Grid, GridGeometry};

/// Cells either way that the ground's direction is taken from.
const REACH: usize = 2;
/// Fewest ground cells for a direction.
const FEWEST: i32 = 8;
/// Farthest that ground can grow, cells.
const MOST_ROUNDS: usize = 40;

/// Marks cells of `low` (infinite where there is no point) that lie within `tolerance_m` of the
/// plane through the ground cells around them.
pub fn regrow(low: &Grid<f32>, is_ground: &mut [bool], tolerance_m: f32) {
    let mut open: Vec<usize> = (0..is_ground.len())
        .into_par_iter()
        .filter(|&i| !is_ground[i] && low.data[i].is_finite())
        .collect();
    for _ in 0..MOST_ROUNDS {
        let seen: &[bool] = is_ground;
        let grown: Vec<usize> = open
            .par_iter()
            .copied()
            .filter(|&i| above_plane(low, seen, i).is_some_and(|h| h.abs() <= tolerance_m))
            .collect();
        if grown.is_empty() {
            break;
        }
        for &i in &grown {
            is_ground[i] = true;
        }
        // The others see the ground that they have been judged by.
        let g = &low.geometry;
        open = grown
            .par_iter()
            .flat_map_iter(|&i| {
                around(g, i).flat_map(|(row, cols)| cols.map(move |c| g.index(c, row)))
            })
            .filter(|&i| !is_ground[i] && low.data[i].is_finite())
            .collect();
        open.par_sort_unstable();
        open.dedup();
    }
}

/// Rows and columns within reach of a cell.
fn around(g: &GridGeometry, i: usize) -> impl Iterator<Item = (usize, Range<usize>)> {
    let (row, col) = (i / g.cols, i % g.cols);
    let cols = col.saturating_sub(REACH)..(col + REACH + 1).min(g.cols);
    (row.saturating_sub(REACH)..(row + REACH + 1).min(g.rows)).map(move |r| (r, cols.clone()))
}

/// Height of a cell above the least-squares plane of the ground cells around it, `None` where
/// these are too few or in a line.
fn above_plane(low: &Grid<f32>, is_ground: &[bool], i: usize) -> Option<f32> {
    let g = &low.geometry;
    let (row, col) = (i / g.cols, i % g.cols);
    let (mut n, mut m, mut b) = (0, DMat3::ZERO, DVec3::ZERO);
    for (r, cols) in around(g, i) {
        for c in cols {
            let k = g.index(c, r);
            if is_ground[k] {
                n += 1;
                let v = DVec3::new(1.0, c as f64 - col as f64, r as f64 - row as f64);
                m += DMat3::from_cols(v * v.x, v * v.y, v * v.z);
                b += v * f64::from(low.data[k] - low.data[i]);
            }
        }
    }
    if n < FEWEST || m.determinant() < 1e-3 * f64::from(n).powi(3) {
        return None;
    }
    Some(-(m.inverse() * b).x as f32)
}
