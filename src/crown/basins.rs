//! The canopy surface, taken from the top down, falls apart into basins: the highest cell left is
//! a top, cells below it join the neighbour to which they rise most steeply (T15 §4 on the
//! canopy surface in place of single points; a watershed). Every local maximum gets a basin, so
//! one crown may hold several; `hierarchy` decides which belong together.

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
    let is_tall = |i: &u32| raw.data[*i as usize].min(canopy.data[*i as usize]) >= min_height_m;
    let mut order: Vec<u32> = (0..g.len() as u32).filter(is_tall).collect();
    order.sort_unstable_by(|&a, &b| {
        canopy.data[b as usize].total_cmp(&canopy.data[a as usize]).then(a.cmp(&b))
    });
    let mut of_cell = vec![NONE; g.len()];
    let mut top: Vec<u32> = Vec::new();
    for &i in &order {
        let (c, r) = (i as usize % g.cols, i as usize / g.cols);
        let h = canopy.data[i as usize];
        let mut steepest = f32::NEG_INFINITY;
        let mut basin = NONE;
        for nr in r.saturating_sub(1)..=(r + 1).min(g.rows - 1) {
            for nc in c.saturating_sub(1)..=(c + 1).min(g.cols - 1) {
                let n = g.index(nc, nr);
                if of_cell[n] == NONE || n == i as usize {
                    continue;
                }
                let far = if nc != c && nr != r { std::f32::consts::SQRT_2 } else { 1.0 };
                let slope = (canopy.data[n] - h) / far;
                if slope > steepest {
                    steepest = slope;
                    basin = of_cell[n];
                }
            }
        }
        if basin == NONE {
            basin = top.len() as u32;
            top.push(i);
        }
        of_cell[i as usize] = basin;
    }
    for &i in &order {
        let basin = &mut of_cell[i as usize];
        let height_m = raw.data[i as usize].min(canopy.data[i as usize]);
        if height_m < SKIRT * canopy.data[top[*basin as usize] as usize] {
            *basin = NONE;
        }
    }
    let extent = extents(canopy, &of_cell, &top);
    let contact = contacts(canopy, &of_cell);
    Basins { of_cell, extent, contact }
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
    for (i, &basin) in of_cell.iter().enumerate() {
        if basin == NONE {
            continue;
        }
        let (c, r) = (i % g.cols, i / g.cols);
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
    let g = canopy.geometry;
    let mut all: Vec<Contact> = Vec::new();
    let mut touch = |i: usize, n: usize, side: f64| {
        let (a, b) = (of_cell[i].min(of_cell[n]), of_cell[i].max(of_cell[n]));
        if a != b && b != NONE {
            let saddle_m = canopy.data[i].min(canopy.data[n]);
            all.push(Contact {
                a,
                b,
                saddle_m,
                sides: side,
                sum_height: side * f64::from(saddle_m),
            });
        }
    };
    for i in 0..g.len() {
        let (c, r) = (i % g.cols, i / g.cols);
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
    all.sort_by_key(|t| (t.a, t.b));
    all.dedup_by(|later, first| {
        let same = (later.a, later.b) == (first.a, first.b);
        if same {
            first.saddle_m = first.saddle_m.max(later.saddle_m);
            first.sides += later.sides;
            first.sum_height += later.sum_height;
        }
        same
    });
    all
}
