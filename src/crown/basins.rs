//! The canopy surface, taken from the top down, falls apart into basins: the highest cell left is
//! a top, cells below it join the neighbour to which they rise most steeply (T15 §4 on the
//! canopy surface in place of single points; a watershed). Every local maximum gets a basin, so
//! one crown may hold several; `hierarchy` decides which belong together.

use rayon::prelude::*;

use super::canopy::Canopy;
use crate::raster::Grid;

pub(super) const NONE: u32 = u32::MAX;

/// Sums over cells that can be added when regions merge. Lengths in cells.
#[derive(Debug, Clone, Copy)]
pub(super) struct Extent {
    pub top_m: f32,
    pub top_cell: u32,
    pub cells: f64,
    pub sum: [f64; 2],
    pub sum_sq: [f64; 3],
    pub min: [u32; 2],
    pub max: [u32; 2],
    /// Cell sides towards anything that is not this region.
    pub border: f64,
    /// Sum of pass heights over the sides towards other crowns.
    pub border_height: f64,
}

impl Extent {
    pub fn absorb(&mut self, o: &Extent) {
        if o.top_m > self.top_m || (o.top_m == self.top_m && o.top_cell < self.top_cell) {
            self.top_m = o.top_m;
            self.top_cell = o.top_cell;
        }
        self.cells += o.cells;
        for k in 0..2 {
            self.sum[k] += o.sum[k];
            self.min[k] = self.min[k].min(o.min[k]);
            self.max[k] = self.max[k].max(o.max[k]);
        }
        for k in 0..3 {
            self.sum_sq[k] += o.sum_sq[k];
        }
        self.border += o.border;
        self.border_height += o.border_height;
    }
}

/// Where two basins touch.
#[derive(Debug, Clone, Copy)]
pub(super) struct Contact {
    pub a: u32,
    pub b: u32,
    /// Highest pass between them.
    pub saddle_m: f32,
    /// Cell sides in common, and the sum of pass heights over them.
    pub sides: f64,
    pub sum_height: f64,
}

pub(super) struct Basins {
    /// Basin of each cell, `NONE` for bare cells and for skirts.
    pub of_cell: Vec<u32>,
    pub extent: Vec<Extent>,
    /// Sorted by (a, b), a < b.
    pub contact: Vec<Contact>,
}

/// Cells lower than this part of their top are skirts: undergrowth beside the crown.
const SKIRT: f32 = 0.25;

/// Cells below `min_height_m` are bare, as are those that the smoothing alone has raised.
pub(super) fn find(canopy: &Canopy, min_height_m: f32) -> Basins {
    let Canopy { top: raw, smooth: canopy } = canopy;
    let g = canopy.geometry;
    let height_m = |i: usize| raw.data[i].min(canopy.data[i]);
    // The neighbour that each cell joins; itself at a top; `NONE` where bare.
    let mut joins = vec![NONE; g.len()];
    joins.par_chunks_mut(g.cols).enumerate().for_each(|(row, joins)| {
        for (col, to) in joins.iter_mut().enumerate() {
            if height_m(g.index(col, row)) >= min_height_m {
                *to = steepest(canopy, height_m, min_height_m, col, row);
            }
        }
    });
    let mut top: Vec<u32> =
        (0..g.len() as u32).into_par_iter().filter(|&i| joins[i as usize] == i).collect();
    top.par_sort_unstable_by(|&a, &b| {
        canopy.data[b as usize].total_cmp(&canopy.data[a as usize]).then(a.cmp(&b))
    });
    let mut basin_of_top = vec![NONE; g.len()];
    for (basin, &i) in (0u32..).zip(&top) {
        basin_of_top[i as usize] = basin;
    }
    let of_cell: Vec<u32> = (0..g.len())
        .into_par_iter()
        .map(|i| {
            let mut at = i;
            // Upwards at every step, so that it ends.
            while joins[at] != NONE && joins[at] as usize != at {
                at = joins[at] as usize;
            }
            let basin = basin_of_top[at];
            let is_skirt = basin != NONE && height_m(i) < SKIRT * canopy.data[at];
            if is_skirt { NONE } else { basin }
        })
        .collect();
    let (extent, contact) =
        rayon::join(|| extents(canopy, &of_cell, &top), || contacts(canopy, &of_cell));
    Basins { of_cell, extent, contact }
}

/// The neighbour to which the surface rises most steeply from a cell; the cell itself at a top.
/// Of equal heights the one that comes first on the grid counts as higher.
fn steepest(
    canopy: &Grid<f32>,
    height_m: impl Fn(usize) -> f32,
    min_height_m: f32,
    c: usize,
    r: usize,
) -> u32 {
    let g = canopy.geometry;
    let i = g.index(c, r);
    let h = canopy.data[i];
    let (mut steepest, mut to) = (f32::NEG_INFINITY, i);
    let (from, end) = (c.saturating_sub(1), (c + 2).min(g.cols));
    for nr in r.saturating_sub(1)..=(r + 1).min(g.rows - 1) {
        let start = g.index(from, nr);
        for (n, &there) in (start..).zip(&canopy.data[start..start + end - from]) {
            let is_higher = there > h || there == h && n < i;
            if !is_higher || height_m(n) < min_height_m {
                continue;
            }
            let far = if nr != r && n - start + from != c { std::f32::consts::SQRT_2 } else { 1.0 };
            let slope = (there - h) / far;
            if slope > steepest {
                (steepest, to) = (slope, n);
            }
        }
    }
    to as u32
}

fn extents(canopy: &Grid<f32>, of_cell: &[u32], top: &[u32]) -> Vec<Extent> {
    let g = canopy.geometry;
    let mut extent: Vec<Extent> = top
        .iter()
        .map(|&i| Extent {
            top_m: canopy.data[i as usize],
            top_cell: i,
            cells: 0.0,
            sum: [0.0; 2],
            sum_sq: [0.0; 3],
            min: [u32::MAX; 2],
            max: [0; 2],
            border: 0.0,
            border_height: 0.0,
        })
        .collect();
    let cells = (0..g.rows).flat_map(|r| (0..g.cols).map(move |c| (c, r)));
    for ((c, r), (i, &basin)) in cells.zip(of_cell.iter().enumerate()) {
        if basin == NONE {
            continue;
        }
        let (x, y, h) = (c as f64, r as f64, canopy.data[i]);
        let e = &mut extent[basin as usize];
        e.cells += 1.0;
        e.sum[0] += x;
        e.sum[1] += y;
        e.sum_sq[0] += x * x;
        e.sum_sq[1] += x * y;
        e.sum_sq[2] += y * y;
        e.min = [e.min[0].min(c as u32), e.min[1].min(r as u32)];
        e.max = [e.max[0].max(c as u32), e.max[1].max(r as u32)];
        let sides = [
            (c > 0).then(|| i - 1),
            (c + 1 < g.cols).then(|| i + 1),
            (r > 0).then(|| i - g.cols),
            (r + 1 < g.rows).then(|| i + g.cols),
        ];
        for side in sides {
            match side {
                None => e.border += 1.0,
                Some(n) if of_cell[n] == NONE => e.border += 1.0,
                Some(n) if of_cell[n] != basin => {
                    e.border += 1.0;
                    e.border_height += f64::from(h.min(canopy.data[n]));
                }
                Some(_) => {}
            }
        }
    }
    extent
}

fn contacts(canopy: &Grid<f32>, of_cell: &[u32]) -> Vec<Contact> {
    /// Rows that one thread looks at at a time.
    const ROWS: usize = 64;
    let g = canopy.geometry;
    let of_rows = |rows: std::ops::Range<usize>| {
        let mut all: Vec<Contact> = Vec::new();
        let mut touch = |i: usize, n: usize, side: f64| {
            let (a, b) = (of_cell[i].min(of_cell[n]), of_cell[i].max(of_cell[n]));
            if a != b && b != NONE {
                let saddle_m = canopy.data[i].min(canopy.data[n]);
                let sum_height = side * f64::from(saddle_m);
                all.push(Contact { a, b, saddle_m, sides: side, sum_height });
            }
        };
        for r in rows {
            for c in 0..g.cols {
                let i = g.index(c, r);
                if c + 1 < g.cols {
                    touch(i, i + 1, 1.0);
                }
                if r + 1 < g.rows {
                    touch(i, i + g.cols, 1.0);
                    if c + 1 < g.cols {
                        touch(i, i + g.cols + 1, 0.0);
                    }
                    if c > 0 {
                        touch(i, i + g.cols - 1, 0.0);
                    }
                }
            }
        }
        all.sort_by_key(|t| (t.a, t.b));
        add_up(&mut all);
        all
    };
    let mut all: Vec<Contact> = (0..g.rows.div_ceil(ROWS))
        .into_par_iter()
        .flat_map_iter(|k| of_rows(k * ROWS..((k + 1) * ROWS).min(g.rows)))
        .collect();
    all.par_sort_by_key(|t| (t.a, t.b));
    add_up(&mut all);
    all
}

/// Makes one contact of those of the same two basins, which stand next to each other.
fn add_up(contacts: &mut Vec<Contact>) {
    contacts.dedup_by(|later, first| {
        let same = (later.a, later.b) == (first.a, first.b);
        if same {
            first.saddle_m = first.saddle_m.max(later.saddle_m);
            first.sides += later.sides;
            first.sum_height += later.sum_height;
        }
        same
    });
}
