//! Filling the unknown cells of a grid with the smoothest surface through the known ones: the
//! membrane (Laplace's equation) with free borders, which is the springs of Pingel et al. 2013
//! at rest. Solved coarse to fine: each level starts from the one above it, so the relaxation
//! has only short waves left to remove and the cost is linear in cells.
//!
//! Levels and the order of relaxation follow the cell's place in the plane, not its place in the
//! grid, and each cell comes to rest by itself: where a grid is cut does not change what is far from
//! the cut.
//!
//! Known limits: a membrane is level where nothing holds it, so a tilted surface runs flat beyond
//! its border. Callers remove the trend first.

use std::sync::atomic::{AtomicBool, AtomicU32, Ordering::Relaxed};

use rayon::prelude::*;

use super::Grid;

/// Sweeps of relaxation at one level, at most.
const MAX_SWEEPS: usize = 48;
/// Over-relaxation; below 2, fast for the short waves that are left at each level.
const OMEGA: f32 = 1.6;
/// A cell is at rest when it moves no further than this between sweeps, in the grid's unit.
const AT_REST: f32 = 1e-4;

struct Level {
    cols: usize,
    rows: usize,
    /// Column and row of the first cell, counted from the origin of coordinates.
    first: [i64; 2],
    value: Vec<f32>,
    is_known: Vec<bool>,
}

/// Replaces every cell whose `is_known` is false. With nothing known the grid becomes zero.
/// `is_known` is as long as the grid.
pub fn fill(grid: &mut Grid<f32>, is_known: &[bool]) {
    let geometry = grid.geometry;
    if is_known.iter().all(|&k| k) {
        return;
    }
    if !is_known.iter().any(|&k| k) {
        grid.data.fill(0.0);
        return;
    }
    let mut levels = vec![Level {
        cols: geometry.cols,
        rows: geometry.rows,
        first: [
            (geometry.west / geometry.cell_x).round() as i64,
            (-geometry.north / geometry.cell_y).round() as i64,
        ],
        value: std::mem::take(&mut grid.data),
        is_known: is_known.to_vec(),
    }];
    while let Some(fine) = levels.last()
        && fine.is_known.iter().any(|&k| !k)
    {
        let mut coarse = coarser(fine);
        // Cells on either side of the origin never become one.
        if coarse.cols.max(coarse.rows) <= 2 {
            coarse.fill_with_mean();
        }
        levels.push(coarse);
    }
    while levels.len() > 1 {
        let (Some(coarse), Some(fine)) = (levels.pop(), levels.last_mut()) else { break };
        refine(&coarse, fine);
        relax(fine);
    }
    if let Some(finest) = levels.pop() {
        grid.data = finest.value;
    }
}

/// Half as many cells each way; a cell is the mean of the known ones among its four.
fn coarser(fine: &Level) -> Level {
    let [odd_col, odd_row] = fine.odd();
    let (cols, rows) = ((fine.cols + odd_col).div_ceil(2), (fine.rows + odd_row).div_ceil(2));
    let mut value = vec![0.0; cols * rows];
    let mut is_known = vec![false; cols * rows];
    let span = |at: usize, odd: usize, end: usize| {
        (at * 2).saturating_sub(odd)..(at * 2 + 2 - odd).min(end)
    };
    let lines = value.par_chunks_mut(cols).zip(is_known.par_chunks_mut(cols)).enumerate();
    lines.with_min_len(rows_together(cols)).for_each(|(row, (value, is_known))| {
        for col in 0..cols {
            let (mut sum, mut count) = (0.0, 0);
            for r in span(row, odd_row, fine.rows) {
                for c in span(col, odd_col, fine.cols) {
                    if fine.is_known[r * fine.cols + c] {
                        sum += fine.value[r * fine.cols + c];
                        count += 1;
                    }
                }
            }
            if count > 0 {
                value[col] = sum / count as f32;
                is_known[col] = true;
            }
        }
    });
    Level { cols, rows, first: fine.first.map(|i| i.div_euclid(2)), value, is_known }
}

impl Level {
    /// 1 along an axis whose first cell is the second half of a coarser one.
    fn odd(&self) -> [usize; 2] {
        self.first.map(|i| i.rem_euclid(2) as usize)
    }

    fn fill_with_mean(&mut self) {
        let known = || self.value.iter().zip(&self.is_known).filter(|(_, k)| **k);
        let mean = known().map(|(v, _)| v).sum::<f32>() / known().count().max(1) as f32;
        for (value, known) in self.value.iter_mut().zip(&mut self.is_known) {
            if !std::mem::replace(known, true) {
                *value = mean;
            }
        }
    }
}

/// First guess of the unknown cells: bilinear from the coarser level.
fn refine(coarse: &Level, fine: &mut Level) {
    let [odd_col, odd_row] = fine.odd();
    let lines = fine.value.par_chunks_mut(fine.cols).zip(fine.is_known.par_chunks(fine.cols));
    lines.enumerate().with_min_len(rows_together(fine.cols)).for_each(
        |(row, (value, is_known))| {
            let v = (((row + odd_row) as f32 - 0.5) * 0.5).clamp(0.0, (coarse.rows - 1) as f32);
            let (r0, fv) = (v as usize, v.fract());
            let r1 = (r0 + 1).min(coarse.rows - 1);
            let [top, bottom] =
                [r0, r1].map(|r| &coarse.value[r * coarse.cols..(r + 1) * coarse.cols]);
            for (col, value) in value.iter_mut().enumerate().filter(|(col, _)| !is_known[*col]) {
                let u = (((col + odd_col) as f32 - 0.5) * 0.5).clamp(0.0, (coarse.cols - 1) as f32);
                let (c0, fu) = (u as usize, u.fract());
                let c1 = (c0 + 1).min(coarse.cols - 1);
                let mixed = |line: &[f32]| line[c0] * (1.0 - fu) + line[c1] * fu;
                *value = mixed(top) * (1.0 - fv) + mixed(bottom) * fv;
            }
        },
    );
}

/// Cells that one thread takes at a time, at least: fewer are done sooner than handed out.
const LEAST_CELLS: usize = 1 << 13;

fn rows_together(cols: usize) -> usize {
    LEAST_CELLS / cols.max(1) + 1
}

/// Gauss–Seidel with over-relaxation, alternating the colours of a chessboard. Cells of one colour
/// look at those of the other alone, so the order within a colour makes no difference. A cell is
/// visited as long as it or one beside it moves: what goes on elsewhere does not count.
fn relax(level: &mut Level) {
    let (cols, rows) = (level.cols, level.rows);
    let [odd_col, odd_row] = level.odd();
    let value: Vec<AtomicU32> =
        level.value.par_iter().with_min_len(1 << 12).map(|v| AtomicU32::new(v.to_bits())).collect();
    let is_moving: Vec<AtomicBool> =
        level.is_known.par_iter().with_min_len(1 << 12).map(|k| AtomicBool::new(!k)).collect();
    // Columns of the unknown cells, by row.
    let unknown = |colour: usize| -> Vec<Vec<u32>> {
        let of_row = |row: usize| {
            let known = &level.is_known[row * cols..(row + 1) * cols];
            let first = (row + odd_row + odd_col + colour) % 2;
            (first..cols).step_by(2).filter(|&c| !known[c]).map(|c| c as u32).collect()
        };
        (0..rows).into_par_iter().with_min_len(rows_together(cols)).map(of_row).collect()
    };
    let colours = [unknown(0), unknown(1)];
    // Whether any cell of a colour moves, by row.
    let row_moves = colours.each_ref().map(|rows| -> Vec<AtomicBool> {
        rows.iter().map(|unknown| AtomicBool::new(!unknown.is_empty())).collect()
    });
    let is_active = |colour: usize, row: usize| {
        let moves = |colour: usize, row: usize| {
            row_moves[colour].get(row).is_some_and(|moves| moves.load(Relaxed))
        };
        let other = 1 - colour;
        moves(colour, row)
            || moves(other, row.wrapping_sub(1))
            || moves(other, row)
            || moves(other, row + 1)
    };
    // Whether any of the cells moved.
    let sweep = |colour: usize, row: usize| {
        let mut any = false;
        for &col in &colours[colour][row] {
            let col = col as usize;
            let i = row * cols + col;
            let beside = [
                (col > 0).then(|| i - 1),
                (col + 1 < cols).then_some(i + 1),
                (row > 0).then(|| i - cols),
                (row + 1 < rows).then_some(i + cols),
            ];
            let beside = beside.into_iter().flatten();
            let moving = |i: usize| is_moving[i].load(Relaxed);
            if !moving(i) && !beside.clone().any(moving) {
                continue;
            }
            let at = |i: usize| f32::from_bits(value[i].load(Relaxed));
            let (sum, count) = beside.fold((0.0, 0.0), |(sum, n), i| (sum + at(i), n + 1.0));
            if count > 0.0 {
                let change = sum / count - at(i);
                value[i].store((at(i) + OMEGA * change).to_bits(), Relaxed);
                let moves = change.abs() >= AT_REST;
                is_moving[i].store(moves, Relaxed);
                any |= moves;
            }
        }
        row_moves[colour][row].store(any, Relaxed);
        any
    };
    for _ in 0..MAX_SWEEPS {
        let any_of = |colour: usize| {
            let active: Vec<usize> = (0..rows).filter(|row| is_active(colour, *row)).collect();
            let cells: usize = active.iter().map(|row| colours[colour][*row].len()).sum();
            let together = active.len() * LEAST_CELLS / cells.max(1) + 1;
            let any = active.into_par_iter().with_min_len(together);
            any.map(|row| sweep(colour, row)).reduce(|| false, |a, b| a | b)
        };
        let moves = [any_of(0), any_of(1)];
        if moves == [false; 2] {
            break;
        }
    }
    let values = level.value.par_iter_mut().with_min_len(1 << 12).zip(&value);
    values.for_each(|(v, bits)| *v = f32::from_bits(bits.load(Relaxed)));
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::raster::GridGeometry;

    fn wavy(cols: usize, rows: usize) -> Grid<f32> {
        let geometry = GridGeometry { west: 0.0, north: 0.0, cell_x: 1.0, cell_y: 1.0, cols, rows };
        let height = |i: usize| {
            let (x, y) = ((i % cols) as f32, (i / cols) as f32);
            (x * 0.3).sin() + (y * 0.2).cos()
        };
        Grid { geometry, data: (0..cols * rows).map(height).collect() }
    }

    #[test]
    fn a_hole_in_a_tilted_plane_takes_the_plane() {
        let mut grid = wavy(40, 30);
        let plane = |i: usize| 3.0 + 0.2 * (i % 40) as f32 - 0.1 * (i / 40) as f32;
        grid.data = (0..1200).map(plane).collect();
        let is_known: Vec<bool> = (0..1200)
            .map(|i| !(10..25).contains(&(i % 40)) || !(8..20).contains(&(i / 40)))
            .collect();
        for (z, known) in grid.data.iter_mut().zip(&is_known) {
            *z = if *known { *z } else { f32::NAN };
        }
        fill(&mut grid, &is_known);
        for (i, z) in grid.data.iter().enumerate() {
            assert!((z - plane(i)).abs() < 5e-3, "cell {i}: {z} for {}", plane(i));
        }
    }

    #[test]
    fn a_void_is_filled_alike_whatever_voids_are_far_from_it() {
        let near = |i: usize| (3..9).contains(&(i % 96)) && (4..8).contains(&(i / 96));
        // Wide, and slow to come to rest.
        let far = |i: usize| (40..90).contains(&(i % 96)) && (6..60).contains(&(i / 96));
        let filled = |is_void: &dyn Fn(usize) -> bool| {
            let mut grid = wavy(96, 64);
            let is_known: Vec<bool> = (0..96 * 64).map(|i| !is_void(i)).collect();
            fill(&mut grid, &is_known);
            grid.data
        };
        let (alone, both) = (filled(&near), filled(&|i| near(i) || far(i)));
        for i in (0..96 * 64).filter(|i| near(*i)) {
            assert_eq!(alone[i].to_bits(), both[i].to_bits(), "cell {i}");
        }
    }
}
