//! Heights on a grid from scattered points: at each cell's centre a plane through the points about
//! it, by moving least squares (Lancaster & Salkauskas 1981) with weights that fall with distance.
//! It averages the scanner's noise and costs a fraction of a triangulation.
//!
//! The plane reaches over no more cells than it needs for points all around the centre. Where they
//! lie on one side only within [`MOST_REACH`] cells, or too few, there is no height: hulls and voids are
//! left to the triangulation. What is farther away plays no part in a plane.
//!
//! Known limit: edges sharper than two cells are rounded.

use glam::Vec3;
use rayon::prelude::*;

use crate::raster::{Grid, GridGeometry};

/// Cells to each side that a plane may take in, and the part of them that must hold points: among
/// fewer a plane rounds what a triangulation keeps.
const MOST_REACH: usize = 2;
const FILLED: f32 = 0.5;
/// Squared distance, cells, within which nearness counts no more.
const NEAR_SQ: f32 = 0.3;

const NONE: u32 = u32::MAX;

/// Height at the centre of every cell that has points around it; NaN elsewhere. `vertices` are at
/// most one a cell, in the order of the cells that `cell_of_vertex` holds.
pub fn heights(vertices: &[Vec3], cell_of_vertex: &[u32], geometry: GridGeometry) -> Grid<f32> {
    let mut vertex_of_cell = vec![NONE; geometry.len()];
    for (v, &cell) in (0u32..).zip(cell_of_vertex) {
        vertex_of_cell[cell as usize] = v;
    }
    let mut grid = Grid::filled(geometry, f32::NAN);
    let lines = grid.data.par_chunks_mut(geometry.cols.max(1)).enumerate();
    lines.for_each(|(row, out)| {
        let near = Near { vertices, vertex_of_cell: &vertex_of_cell, geometry, row };
        for (col, z) in out.iter_mut().enumerate() {
            *z = near.height(col);
        }
    });
    grid
}

struct Near<'a> {
    vertices: &'a [Vec3],
    vertex_of_cell: &'a [u32],
    geometry: GridGeometry,
    row: usize,
}

impl Near<'_> {
    fn height(&self, col: usize) -> f32 {
        (1..=MOST_REACH).find_map(|reach| self.plane(col, reach)).unwrap_or(f32::NAN)
    }

    fn plane(&self, col: usize, reach: usize) -> Option<f32> {
        let g = &self.geometry;
        let [x, y] = g.centre(col, self.row);
        let per_m = (1.0 / g.cell_x) as f32;
        let radius_sq = (reach as f32 + 1.0).powi(2);
        let (from, end) = (col.saturating_sub(reach), (col + reach + 1).min(g.cols));
        let (mut n, mut octants, mut base) = (0, 0u8, None);
        let (mut s, mut sx, mut sy, mut sz) = (0.0f32, 0.0f32, 0.0f32, 0.0f32);
        let (mut xx, mut xy, mut yy, mut xz, mut yz) = (0.0f32, 0.0f32, 0.0f32, 0.0f32, 0.0f32);
        for row in self.row.saturating_sub(reach)..(self.row + reach + 1).min(g.rows) {
            let line = &self.vertex_of_cell[row * g.cols + from..row * g.cols + end];
            for &v in line.iter().filter(|&&v| v != NONE) {
                let p = self.vertices[v as usize];
                // Cells from the centre.
                let dx = (f64::from(p.x) - x) as f32 * per_m;
                let dy = (f64::from(p.y) - y) as f32 * per_m;
                let dz = p.z - *base.get_or_insert(p.z);
                let d_sq = dx * dx + dy * dy;
                let taper = (1.0 - d_sq / radius_sq).max(0.0);
                let w = taper * taper / (d_sq + NEAR_SQ);
                n += 1;
                octants |= 1 << octant(dx, dy);
                s += w;
                sx += w * dx;
                sy += w * dy;
                sz += w * dz;
                xx += w * dx * dx;
                xy += w * dx * dy;
                yy += w * dy * dy;
                xz += w * dx * dz;
                yz += w * dy * dz;
            }
        }
        let window = (2.0 * reach as f32 + 1.0).powi(2);
        if (n as f32) < FILLED * window || !is_around(octants) {
            return None;
        }
        let (mx, my, mz) = (sx / s, sy / s, sz / s);
        let (xx, xy, yy) = (xx - sx * mx, xy - sx * my, yy - sy * my);
        let (xz, yz) = (xz - sx * mz, yz - sy * mz);
        let det = xx * yy - xy * xy;
        // In a line, or nearly.
        if det <= 1e-3 * (xx + yy).powi(2) {
            return None;
        }
        let (slope_x, slope_y) = ((xz * yy - yz * xy) / det, (yz * xx - xz * xy) / det);
        Some(base? + mz - slope_x * mx - slope_y * my)
    }
}

/// Which eighth of the circle a direction lies in, counter-clockwise.
fn octant(dx: f32, dy: f32) -> u32 {
    match (dy >= 0.0, dx >= 0.0) {
        (true, true) => u32::from(dy > dx),
        (true, false) => 2 + u32::from(-dx > dy),
        (false, false) => 4 + u32::from(-dy > -dx),
        (false, true) => 6 + u32::from(dx > -dy),
    }
}

/// Whether no half of the circle is empty.
fn is_around(octants: u8) -> bool {
    let empty = !octants;
    let run = |n: u32| empty & empty.rotate_right(n);
    run(1) & run(1).rotate_right(2) == 0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn octants_go_round() {
        for i in 0..64 {
            let (dy, dx) = ((i as f32 + 0.5) / 64.0 * std::f32::consts::TAU).sin_cos();
            assert_eq!(octant(dx, dy), i / 8, "{i}");
        }
        assert!(is_around(0b0001_0001) && is_around(0b0100_1001));
        assert!(!is_around(0b0000_1111) && !is_around(0b1000_0001) && !is_around(0));
    }

    #[test]
    fn a_plane_is_met_where_points_lie_around_and_nothing_is_said_elsewhere() {
        let g = GridGeometry::covering([0.0, 0.0], [40.0, 40.0], 1.0);
        let height = |x: f32, y: f32| 5.0 + 0.3 * x - 0.7 * y;
        let mut found: Vec<(u32, Vec3)> = Vec::new();
        for i in 0..g.len() {
            let (col, row) = (i % g.cols, i / g.cols);
            if (col * 7 + row * 5) % 3 != 0 && col < 25 {
                let [x, y] = g.centre(col, row).map(|v| v as f32 + 0.3);
                found.push((i as u32, Vec3::new(x, y, height(x, y))));
            }
        }
        let (cells, points): (Vec<u32>, Vec<Vec3>) = found.into_iter().unzip();
        let grid = heights(&points, &cells, g);
        for row in 3..38 {
            for col in 3..22 {
                let [x, y] = g.centre(col, row).map(|v| v as f32);
                assert!((grid.at(col, row) - height(x, y)).abs() < 1e-3, "{col} {row}");
            }
            assert!(grid.at(36, row).is_nan());
        }
    }
}
