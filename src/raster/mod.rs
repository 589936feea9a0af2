//! Grids with a place on the ground, and pictures. Knows nothing of points or trees.
//!
//! Every grid here is north-up and cell-centred ("pixel is area"): row 0 is the northernmost,
//! a value stands for the middle of its cell.

mod chunks;
pub mod cog;
mod cutout;
mod encoded;
pub mod geotiff;
mod groups;
pub mod inpaint;
mod jpeg;
mod pad;
pub mod picture;
mod png;
pub mod polygon;
pub mod scatter;
mod srgb;
pub mod trend;
mod webp;
mod world_file;

pub use cutout::{keep_cover, spread};
pub use encoded::Image;
pub use groups::Groups;
pub use jpeg::{MOST_JPEG_PX, encode as jpeg};
pub use pad::pad_transparent;
pub use picture::{Picture, deep_png};
use rayon::prelude::*;
pub use srgb::{LINEAR_FROM_SRGB, linear_from_srgb, srgb_from_linear};
pub use webp::encode as webp;
pub use world_file::read;

/// Placement of a north-up grid. Units are the owner's: local metres for terrain, world units for
/// a photo.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GridGeometry {
    /// x of the western edge of column 0.
    pub west: f64,
    /// y of the northern edge of row 0.
    pub north: f64,
    /// Width of a cell, > 0.
    pub cell_x: f64,
    /// Height of a cell, > 0.
    pub cell_y: f64,
    pub cols: usize,
    pub rows: usize,
}

impl GridGeometry {
    /// The smallest grid of square cells, aligned to multiples of `cell`, that covers the box.
    pub fn covering(min: [f64; 2], max: [f64; 2], cell: f64) -> Self {
        let west = (min[0] / cell).floor() * cell;
        let north = (max[1] / cell).ceil() * cell;
        let cols = ((max[0] - west) / cell).floor() as usize + 1;
        let rows = ((north - min[1]) / cell).floor() as usize + 1;
        GridGeometry { west, north, cell_x: cell, cell_y: cell, cols, rows }
    }

    /// The same grid with so many more cells on every side.
    pub fn grown(self, cells: usize) -> Self {
        GridGeometry {
            west: self.west - cells as f64 * self.cell_x,
            north: self.north + cells as f64 * self.cell_y,
            cols: self.cols + 2 * cells,
            rows: self.rows + 2 * cells,
            ..self
        }
    }

    pub fn len(&self) -> usize {
        self.cols * self.rows
    }

    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    pub fn index(&self, col: usize, row: usize) -> usize {
        row * self.cols + col
    }

    /// Column and row of the cell that holds the point, `None` outside.
    pub fn cell_of(&self, x: f64, y: f64) -> Option<(usize, usize)> {
        let c = quotient(x - self.west, self.cell_x);
        let r = quotient(self.north - y, self.cell_y);
        // Truncation is the floor of what is not negative, and faster.
        (c >= 0.0 && r >= 0.0 && c < self.cols as f64 && r < self.rows as f64)
            .then_some((c as i64 as usize, r as i64 as usize))
    }

    /// Middle of a cell.
    pub fn centre(&self, col: usize, row: usize) -> [f64; 2] {
        [
            self.west + (col as f64 + 0.5) * self.cell_x,
            self.north - (row as f64 + 0.5) * self.cell_y,
        ]
    }

    pub fn east(&self) -> f64 {
        self.west + self.cols as f64 * self.cell_x
    }

    pub fn south(&self) -> f64 {
        self.north - self.rows as f64 * self.cell_y
    }
}

/// `a / b`, in less time where `b` is a power of two, as most cells are.
fn quotient(a: f64, b: f64) -> f64 {
    const EXPONENT: u64 = 0x7ff << 52;
    // The exponent of 1 / b is that of 1 twice less that of b.
    let inverse = (2 * 1f64.to_bits()).wrapping_sub(b.to_bits());
    let is_normal = |bits: u64| bits & !EXPONENT == 0 && bits != 0 && bits != EXPONENT;
    if is_normal(b.to_bits()) && is_normal(inverse) { a * f64::from_bits(inverse) } else { a / b }
}

/// `v.floor() as i32`, without the call that this is where processors are not known to have it.
pub(crate) fn floor(v: f32) -> i32 {
    let whole = v as i32;
    whole.saturating_sub(i32::from(whole as f32 > v))
}

/// Values on a grid, row-major from the north-west.
#[derive(Debug, Clone, PartialEq)]
pub struct Grid<T> {
    pub geometry: GridGeometry,
    pub data: Vec<T>,
}

impl<T: Copy> Grid<T> {
    pub fn filled(geometry: GridGeometry, value: T) -> Self {
        Grid { geometry, data: vec![value; geometry.len()] }
    }

    pub fn at(&self, col: usize, row: usize) -> T {
        self.data[row * self.geometry.cols + col]
    }

    pub fn set(&mut self, col: usize, row: usize, value: T) {
        self.data[row * self.geometry.cols + col] = value;
    }
}

impl Grid<f32> {
    /// Bilinear between cell centres, clamped to the outermost centres beyond them.
    pub fn bilinear(&self, x: f64, y: f64) -> f32 {
        self.mixed(self.along_x(x), self.along_y(y))
    }

    /// Heights at the centres of another grid, as by [`Self::bilinear`].
    pub fn resampled(&self, geometry: GridGeometry) -> Grid<f32> {
        let columns: Vec<Between> =
            (0..geometry.cols).map(|col| self.along_x(geometry.centre(col, 0)[0])).collect();
        let mut out = Grid::filled(geometry, 0.0);
        out.data.par_chunks_mut(geometry.cols.max(1)).enumerate().for_each(|(row, line)| {
            let row = self.along_y(geometry.centre(0, row)[1]);
            for (z, column) in line.iter_mut().zip(&columns) {
                *z = self.mixed(*column, row);
            }
        });
        out
    }

    fn along_x(&self, x: f64) -> Between {
        let g = &self.geometry;
        Between::new(quotient(x - g.west, g.cell_x), g.cols)
    }

    fn along_y(&self, y: f64) -> Between {
        let g = &self.geometry;
        Between::new(quotient(g.north - y, g.cell_y), g.rows)
    }

    fn mixed(&self, x: Between, y: Between) -> f32 {
        let cols = self.geometry.cols;
        let across = |row: usize| {
            let line = &self.data[row * cols..(row + 1) * cols];
            line[x.first] * (1.0 - x.share) + line[x.second] * x.share
        };
        across(y.first) * (1.0 - y.share) + across(y.second) * y.share
    }
}

/// Two neighbouring cells along an axis, and the share of the second.
#[derive(Clone, Copy)]
struct Between {
    first: usize,
    second: usize,
    share: f32,
}

impl Between {
    /// `at` counts cells from the edge of the first of `cells`.
    fn new(at: f64, cells: usize) -> Between {
        let last = cells - 1;
        let at = (at - 0.5).clamp(0.0, last as f64);
        let first = (at as i64 as usize).min(cells.saturating_sub(2));
        Between { first, second: (first + 1).min(last), share: (at - first as f64) as f32 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quotients_are_those_of_division() {
        let mut d = crate::seed::Seed::new(3).draws();
        let divisors = [0.25, 0.5, 1.0, 2.0, 1024.0, 0.3125, 0.375, -2.0, 5e-324, 2f64.powi(1023)];
        for b in divisors.into_iter().chain([2f64.powi(-1022), f64::INFINITY, f64::NAN, 0.0]) {
            for a in [0.0, -0.0, 1.0, f64::MAX, 1e-310]
                .into_iter()
                .chain((0..50).map(|_| f64::from(d.between(-1e4, 1e4))))
            {
                let (is, expected) = (quotient(a, b), a / b);
                assert!(is == expected || is.is_nan() && expected.is_nan(), "{a} / {b}: {is}");
            }
        }
    }

    #[test]
    fn floors_are_those_of_the_library() {
        let mut d = crate::seed::Seed::new(4).draws();
        let at_ends = [0.0, -0.0, 0.5, -0.5, -1.0, 1e9, -1e9, 3e9, -3e9, f32::NAN, f32::INFINITY];
        for v in at_ends.into_iter().chain((0..1000).map(|_| d.between(-1e3, 1e3))) {
            assert_eq!(floor(v), v.floor() as i32, "{v}");
        }
    }

    #[test]
    fn covering_holds_every_corner() {
        for (min, max) in
            [([0.0, 0.0], [10.0, 10.0]), ([-3.2, 4.9], [7.7, 5.0]), ([1.0, 1.0], [1.0, 1.0])]
        {
            let g = GridGeometry::covering(min, max, 0.5);
            for p in [min, max, [min[0], max[1]], [max[0], min[1]]] {
                assert!(g.cell_of(p[0], p[1]).is_some(), "{p:?} not in {g:?}");
            }
        }
    }

    #[test]
    fn bilinear_is_exact_on_a_plane() {
        let g =
            GridGeometry { west: 10.0, north: 50.0, cell_x: 2.0, cell_y: 2.0, cols: 6, rows: 5 };
        let mut grid = Grid::filled(g, 0.0f32);
        for r in 0..5 {
            for c in 0..6 {
                let [x, y] = g.centre(c, r);
                grid.set(c, r, (3.0 * x - 2.0 * y) as f32);
            }
        }
        for (x, y) in [(12.3, 47.1), (18.0, 44.4), (15.5, 42.2)] {
            assert!((f64::from(grid.bilinear(x, y)) - (3.0 * x - 2.0 * y)).abs() < 1e-4);
        }
    }

    #[test]
    fn a_single_cell_is_constant() {
        let g = GridGeometry { west: 0.0, north: 1.0, cell_x: 1.0, cell_y: 1.0, cols: 1, rows: 1 };
        assert_eq!(Grid::filled(g, 4.0f32).bilinear(100.0, -3.0), 4.0);
    }
}
