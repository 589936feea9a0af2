//! Where water is: at points of its class, and in ponds.
//!
//! Still water returns few pulses: a hole in a scan that shows water beside it is water. Looked for on
//! cells of their own, so that voxels of any edge show the same ponds. Known limit: holes that reach the
//! end of the scan are none, as nobody may have flown there.

use glam::{Vec2, Vec3};

use crate::raster::{Grid, GridGeometry};

/// ASPRS class of water.
pub(super) const WATER: u8 = 9;

/// Side of a cell, and cells at most; wide areas have larger ones.
const CELL_M: f64 = 1.0;
const MOST_CELLS: f64 = 1.6e7;
/// Metres from a return up to which nothing is missing.
const HOLE_M: f64 = 2.5;

/// Shares of water, 0…1, without the steps of cells.
pub(super) struct Water(Grid<f32>);

impl Water {
    /// By the points of which `is_low` says that they are no higher than shrubs; `None` where the scan
    /// shows no water.
    pub fn of(position: &[Vec3], class: &[u8], is_low: impl Fn(usize) -> bool) -> Option<Water> {
        if !class.contains(&WATER) {
            return None;
        }
        let fold = |(low, high): (Vec2, Vec2), p: Vec2| (low.min(p), high.max(p));
        let plane = position.iter().map(|p| p.truncate());
        let (low, high) = plane.fold((Vec2::INFINITY, Vec2::NEG_INFINITY), fold);
        let (low, high) = (low.as_dvec2(), high.as_dvec2());
        let area = (high - low + CELL_M).element_product();
        let cell = CELL_M.max((area / MOST_CELLS).sqrt());
        let geometry = GridGeometry::covering(low.to_array(), high.to_array(), cell);
        let mut cells = vec![Cell::default(); geometry.len()];
        for (i, p) in position.iter().enumerate() {
            if let Some((col, row)) = geometry.cell_of(f64::from(p.x), f64::from(p.y)) {
                let cell = &mut cells[geometry.index(col, row)];
                cell.holds = true;
                if is_low(i) {
                    cell.votes += if class[i] == WATER { 1 } else { -1 };
                }
            }
        }
        let reach = (HOLE_M / cell).ceil() as usize;
        let is_pond = ponds(&cells, geometry.cols, reach);
        for (cell, _) in cells.iter_mut().zip(is_pond).filter(|(_, is_pond)| *is_pond) {
            cell.votes = 1;
        }
        Some(Water(Grid { geometry, data: shores(&cells, geometry.cols) }))
    }

    pub fn share(&self, p: Vec2) -> f32 {
        self.0.bilinear(f64::from(p.x), f64::from(p.y))
    }
}

/// What a cell's returns are of.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
struct Cell {
    holds: bool,
    /// Those of water less those of the ground.
    votes: i32,
}

/// Cells of ponds, of which all are so many cells from a return and some as near to water.
fn ponds(cells: &[Cell], cols: usize, reach: usize) -> Vec<bool> {
    let rows = cells.len() / cols.max(1);
    let holds: Vec<bool> = cells.iter().map(|c| c.holds).collect();
    let water: Vec<bool> = cells.iter().map(|c| c.votes > 0).collect();
    let near = widened(&holds, cols, reach);
    let beside = widened(&water, cols, reach + 1);
    let mut is_known = near.clone();
    let mut pond = vec![false; cells.len()];
    for seed in (0..cells.len()).filter(|i| !near[*i]) {
        if is_known[seed] {
            continue;
        }
        is_known[seed] = true;
        let (mut hole, mut next) = (vec![seed], 0);
        while let Some(&i) = hole.get(next) {
            next += 1;
            let (x, y) = (i % cols, i / cols);
            let sides = [
                (x > 0).then(|| i - 1),
                (x + 1 < cols).then_some(i + 1),
                (y > 0).then(|| i - cols),
                (y + 1 < rows).then_some(i + cols),
            ];
            for j in sides.into_iter().flatten() {
                if !std::mem::replace(&mut is_known[j], true) {
                    hole.push(j);
                }
            }
        }
        let is_edge = |i: &usize| {
            let (x, y) = (i % cols, i / cols);
            x == 0 || y == 0 || x + 1 == cols || y + 1 == rows
        };
        if hole.iter().any(|i| beside[*i]) && !hole.iter().any(is_edge) {
            hole.iter().for_each(|i| pond[*i] = true);
        }
    }
    let wide = widened(&pond, cols, reach);
    (0..cells.len()).map(|i| wide[i] && !holds[i]).collect()
}

/// Share of water about each cell: among the cells around that say what they are.
fn shores(cells: &[Cell], cols: usize) -> Vec<f32> {
    let part = |of: fn(&Cell) -> bool| {
        let mut share: Vec<f32> = cells.iter().map(|c| f32::from(u8::from(of(c)))).collect();
        smooth(&mut share, cols);
        share
    };
    let (water, known) = (part(|c| c.votes > 0), part(|c| c.votes != 0));
    let sharp = |(water, known): (f32, f32)| {
        let s = ((water / known.max(1e-3) - 0.3) / 0.4).clamp(0.0, 1.0);
        s * s * (3.0 - 2.0 * s)
    };
    water.into_iter().zip(known).map(sharp).collect()
}

/// Mixes each cell with those beside it, three times.
fn smooth(share: &mut [f32], cols: usize) {
    let rows = share.len() / cols.max(1);
    let mut line = Vec::new();
    for _ in 0..3 {
        for (count, step, lines, next) in [(cols, 1, rows, cols), (rows, cols, cols, 1)] {
            for first in (0..lines).map(|i| i * next) {
                line.clear();
                line.extend((0..count).map(|i| share[first + i * step]));
                for i in 0..count {
                    let (before, after) = (line[i.saturating_sub(1)], line[(i + 1).min(count - 1)]);
                    share[first + i * step] = 0.25 * (before + after) + 0.5 * line[i];
                }
            }
        }
    }
}

/// Cells up to `reach` cells along x and y from one that is set.
fn widened(set: &[bool], cols: usize, reach: usize) -> Vec<bool> {
    let rows = set.len() / cols.max(1);
    let mut wide = set.to_vec();
    let mut along = |lines: usize, line: usize, count: usize, step: usize| {
        for first in (0..lines).map(|i| i * line) {
            let old: Vec<bool> = (0..count).map(|i| wide[first + i * step]).collect();
            for i in (0..count).filter(|i| old[*i]) {
                for j in i.saturating_sub(reach)..=(i + reach).min(count - 1) {
                    wide[first + j * step] = true;
                }
            }
        }
    };
    along(rows, cols, cols, 1);
    along(cols, 1, rows, cols);
    wide
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cell(votes: i32) -> Cell {
        Cell { holds: true, votes }
    }

    #[test]
    fn water_is_where_most_low_points_are_of_it() {
        let (mut position, mut class) = (Vec::new(), Vec::new());
        // West of 20 m water, with a tree over it, and one point of water on land.
        for i in 0..1600u16 {
            let p = Vec2::new(f32::from(i % 40) + 0.5, f32::from(i / 40) + 0.5);
            position.push(p.extend(0.0));
            class.push(if p.x < 20.0 || i == 30 { WATER } else { 2 });
        }
        for k in 0..50 {
            position.push(Vec3::new(10.5, 20.5, 4.0 + 0.1 * k as f32));
            class.push(5);
        }
        let water = Water::of(&position, &class, |i| position[i].z < 1.0).unwrap();
        let share = |x: f32, y: f32| water.share(Vec2::new(x, y));
        assert_eq!([share(5.0, 5.0), share(10.5, 20.5), share(35.0, 35.0)], [1.0, 1.0, 0.0]);
        assert!((share(20.0, 20.0) - 0.5).abs() < 0.02 && share(30.5, 0.5) < 0.3);
        class.fill(2);
        assert!(Water::of(&position, &class, |_| true).is_none());
    }

    #[test]
    fn shores_have_no_steps() {
        let cols = 40;
        let of = |i: usize| cell(if i % cols + i / cols < cols { 1 } else { -1 });
        let mut cells: Vec<Cell> = (0..cols * cols).map(of).collect();
        let share = shores(&cells, cols);
        assert!(share.iter().all(|s| (0.0..=1.0).contains(s)));
        assert_eq!((share[0], share[cols * cols - 1]), (1.0, 0.0));
        // Along the shore, which runs aslant, the share stays.
        let along: Vec<f32> = (10..30).map(|x| share[(cols - 1 - x) * cols + x]).collect();
        assert!(along.iter().all(|s| (s - along[0]).abs() < 1e-4), "{along:?}");
        // Cells between that hold no return are as those around.
        cells.iter_mut().step_by(3).for_each(|c| *c = Cell::default());
        let thin = shores(&cells, cols);
        assert_eq!((thin[0], thin[cols * cols - 1]), (1.0, 0.0));
    }

    #[test]
    fn a_hole_beside_water_is_a_pond_and_no_other_is() {
        let (cols, rows) = (40, 20);
        let mut cells = vec![cell(-1); cols * rows];
        let hole = |cells: &mut Vec<Cell>, x: std::ops::Range<usize>, votes: i32| {
            for i in (5..15).flat_map(|y| x.clone().map(move |x| y * cols + x)) {
                cells[i] = Cell::default();
            }
            cells[10 * cols + x.start - 1].votes = votes;
        };
        hole(&mut cells, 4..14, 1);
        hole(&mut cells, 18..28, -1);
        hole(&mut cells, 32..40, 1);
        let pond = ponds(&cells, cols, 3);
        let at = |x: usize, y: usize| pond[y * cols + x];
        assert!(at(4, 5) && at(8, 10) && at(13, 14));
        assert!(!at(3, 10) && !at(22, 10) && !at(36, 10));
    }
}
