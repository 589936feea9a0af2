//! Voids and pits of the canopy surface: what cells are by the eight around them. All threads take
//! rows, and of a row a block of cells at a time, whose sums stay in registers.

use rayon::prelude::*;

use crate::raster::Grid;

/// The height of a cell in which, and about which, nothing was seen.
pub(super) const UNKNOWN: f32 = f32::NEG_INFINITY;
/// Rings of empty cells that are filled from their neighbours; cells farther out are bare.
const FILL_RINGS: usize = 3;
/// A cell this far below the median of its neighbours is a pit, metres and part of the median.
const PIT_DEPTH_M: f32 = 1.0;
const PIT_DEPTH_RELATIVE: f32 = 0.1;
/// Cells of a block.
const BLOCK: usize = 16;

/// A row and those beside it, with unknown cells about them, as long as all blocks and two cells.
#[derive(Default)]
struct Lines([Vec<f32>; 3]);

/// Cells of a row, and their neighbours row by row from the north-west.
struct Block<'a> {
    /// Number of the first cell.
    first: usize,
    /// Cells that are on the grid.
    cells: usize,
    own: &'a [f32; BLOCK],
    around: [&'a [f32; BLOCK]; 8],
}

/// Cells of a row by number, and what they become.
type Changes = Vec<(usize, f32)>;

impl Lines {
    fn load(&mut self, grid: &Grid<f32>, row: usize) {
        let (cols, rows) = (grid.geometry.cols, grid.geometry.rows);
        for (line, row) in self.0.iter_mut().zip([row.wrapping_sub(1), row, row + 1]) {
            line.clear();
            line.push(UNKNOWN);
            if row < rows {
                line.extend_from_slice(&grid.data[row * cols..(row + 1) * cols]);
            }
            line.resize(cols.next_multiple_of(BLOCK) + 2, UNKNOWN);
        }
    }

    fn block(&self, cols: usize, row: usize, block: usize) -> Block<'_> {
        let col = block * BLOCK;
        let cells = |line: usize, k: usize| &self.0[line][col + k..].as_chunks().0[0];
        let beside = [(0, 0), (0, 1), (0, 2), (1, 0), (1, 2), (2, 0), (2, 1), (2, 2)];
        Block {
            first: row * cols + col,
            cells: BLOCK.min(cols - col),
            own: cells(1, 1),
            around: beside.map(|(line, k)| cells(line, k)),
        }
    }
}

impl Block<'_> {
    /// Heights of the known neighbours of a cell, and how many there are.
    fn known_around(&self, cell: usize) -> ([f32; 8], usize) {
        let (mut heights, mut n) = ([0.0; 8], 0);
        for line in self.around {
            if line[cell] > UNKNOWN {
                heights[n] = line[cell];
                n += 1;
            }
        }
        (heights, n)
    }
}

/// Without a branch for each, as `contains` has.
fn any(is: &[bool; BLOCK]) -> bool {
    is.iter().fold(false, |any, is| any | is)
}

/// What `look` finds to be changed in those blocks, given by row and number in it, that are `wanted`.
fn changes(
    grid: &Grid<f32>,
    wanted: impl Fn(usize, usize) -> bool + Sync,
    look: impl Fn(&Block<'_>, &mut Changes) + Sync,
) -> Vec<Changes> {
    let cols = grid.geometry.cols;
    let of_row = |lines: &mut Lines, row: usize| {
        let mut found = Vec::new();
        let mut blocks = (0..cols.div_ceil(BLOCK)).filter(|&block| wanted(row, block)).peekable();
        if blocks.peek().is_some() {
            lines.load(grid, row);
        }
        blocks.for_each(|block| look(&lines.block(cols, row, block), &mut found));
        found
    };
    (0..grid.geometry.rows).into_par_iter().map_init(Lines::default, of_row).collect()
}

/// False where nothing changes.
fn apply(grid: &mut Grid<f32>, changes: &[Changes]) -> bool {
    let cols = grid.geometry.cols;
    let lines = grid.data.par_chunks_mut(cols).zip(changes).enumerate();
    lines.for_each(|(row, (line, changes))| {
        changes.iter().for_each(|(i, height)| line[i - row * cols] = *height);
    });
    changes.iter().any(|row| !row.is_empty())
}

/// Gives unknown cells the mean of their known neighbours, where these are at least three, a ring at
/// a time.
pub(super) fn grow(grid: &mut Grid<f32>, rings: usize) {
    let (cols, rows) = (grid.geometry.cols, grid.geometry.rows);
    let blocks = cols.div_ceil(BLOCK);
    // Only beside what is new can a cell have become surrounded.
    let mut is_near_new = vec![true; blocks * rows];
    for _ in 0..rings {
        let wanted = |row: usize, block: usize| is_near_new[row * blocks + block];
        let filled = changes(grid, wanted, |block, filled| {
            let is_unknown = block.own.map(|height| height == UNKNOWN);
            if !any(&is_unknown) {
                return;
            }
            let (mut sum, mut n) = ([0.0f32; BLOCK], [0.0f32; BLOCK]);
            for line in block.around {
                for k in 0..BLOCK {
                    let is_known = line[k] > UNKNOWN;
                    sum[k] += if is_known { line[k] } else { 0.0 };
                    n[k] += if is_known { 1.0 } else { 0.0 };
                }
            }
            let surrounded = (0..block.cells).filter(|&k| is_unknown[k] && n[k] >= 3.0);
            filled.extend(surrounded.map(|k| (block.first + k, sum[k] / n[k])));
        });
        if !apply(grid, &filled) {
            break;
        }
        is_near_new.fill(false);
        for (row, filled) in filled.iter().enumerate() {
            let block_of = |change: &(usize, f32)| (change.0 - row * cols) / BLOCK;
            for new in filled.chunk_by(|a, b| block_of(a) == block_of(b)) {
                let block = block_of(&new[0]);
                let near = block.saturating_sub(1)..(block + 2).min(blocks);
                for row in row.saturating_sub(1)..(row + 2).min(rows) {
                    is_near_new[row * blocks..][near.clone()].fill(true);
                }
            }
        }
    }
}

/// Fills gaps among known cells. What is grown beyond the edge of all that is known is taken back
/// (a closing), so that the edge of a scan is where its points end, however large the grid is.
pub(super) fn fill_voids(grid: &mut Grid<f32>) {
    let is_seen: Vec<bool> = grid.data.par_iter().map(|height| *height > UNKNOWN).collect();
    grow(grid, FILL_RINGS);
    for _ in 0..FILL_RINGS {
        let outer = changes(
            grid,
            |_, _| true,
            |block, outer| {
                let mut known = [0.0f32; BLOCK];
                for line in block.around {
                    for k in 0..BLOCK {
                        known[k] += if line[k] > UNKNOWN { 1.0 } else { 0.0 };
                    }
                }
                let mut is_edge = [false; BLOCK];
                for k in 0..BLOCK {
                    is_edge[k] = known[k] < 8.0 && block.own[k] > UNKNOWN;
                }
                if any(&is_edge) {
                    let is_seen = &is_seen[block.first..block.first + block.cells];
                    let is_outer = |k: &usize| is_edge[*k] && !is_seen[*k];
                    outer.extend(
                        (0..block.cells).filter(is_outer).map(|k| (block.first + k, UNKNOWN)),
                    );
                }
            },
        );
        if !apply(grid, &outer) {
            break;
        }
    }
}

/// Raises pits to the median of their surroundings.
pub(super) fn fill_pits(grid: &mut Grid<f32>) {
    let raised = changes(
        grid,
        |_, _| true,
        |block, raised| {
            // Neighbours that are higher by a little less than a pit's depth: few cells have enough.
            let mut higher = [0.0f32; BLOCK];
            for line in block.around {
                for k in 0..BLOCK {
                    let rim = (1.0 - 0.999 * PIT_DEPTH_RELATIVE) * line[k] - 0.999 * PIT_DEPTH_M;
                    higher[k] += if rim > block.own[k] { 1.0 } else { 0.0 };
                }
            }
            // Even five neighbours have three from the median up.
            let may_be_pit: [bool; BLOCK] =
                std::array::from_fn(|k| higher[k] >= 3.0 && block.own[k] > UNKNOWN);
            if !any(&may_be_pit) {
                return;
            }
            for k in (0..block.cells).filter(|&k| may_be_pit[k]) {
                let (mut around, n) = block.known_around(k);
                if n < 5 {
                    continue;
                }
                around[..n].sort_unstable_by(f32::total_cmp);
                let median = around[n / 2];
                if block.own[k] < median - PIT_DEPTH_M - PIT_DEPTH_RELATIVE * median {
                    raised.push((block.first + k, median));
                }
            }
        },
    );
    apply(grid, &raised);
}
