//! Heights on a grid from scattered points: a Delaunay triangulation, linear in each triangle. It
//! serves where cells are too coarse, or points too far apart, for `planes`.
//!
//! Large sets are triangulated in square blocks side by side, each with the vertices of a margin
//! around it. A triangle whose circumcircle is no wider than the margin is one of the whole
//! triangulation, in whichever block it shows: no vertex beyond the margin lies in its circle. Such
//! triangles are drawn. A vertex all around which such triangles lie is done with; the few others,
//! at the hull and about voids, have all the corners of the triangles still missing and are
//! triangulated once more, together. So the heights are those of one triangulation of all, but for
//! which way four corners of a rectangle are halved.
//!
//! The triangles are drawn onto the grid one after the other, so that no point location is needed
//! and the result does not depend on any order of queries. Known limit: long thin triangles along
//! the hull are as linear as the others.

use std::ops::Range;

use delaunator::{Point, triangulate};
use glam::{DVec3, Vec3};
use rayon::prelude::*;

use crate::raster::{Grid, GridGeometry, Groups};

/// Side of a block and width of its margin, cells.
const BLOCK: usize = 256;
const MARGIN: f64 = 8.0;
/// Fewer vertices are triangulated at once.
const FEW: usize = 20_000;

/// The mean point of the points in a square of a grid.
#[derive(Clone, Copy)]
pub struct Mean {
    pub square: u32,
    pub points: u32,
    pub at: Vec3,
}

/// The mean point of each square of a grid that holds any, in the order of the squares: as many
/// vertices as the grid can show, and less noise in each.
pub fn thinned(points: &[Vec3], squares: &GridGeometry) -> Vec<Mean> {
    let square_of = |p: &Vec3| {
        let (c, r) = squares.cell_of(p.x.into(), p.y.into())?;
        u32::try_from(squares.index(c, r)).ok()
    };
    let mean = |square: u32, numbers: &mut dyn ExactSizeIterator<Item = u32>| {
        let count = numbers.len();
        let sum = numbers.map(|i| points[i as usize].as_dvec3()).sum::<DVec3>();
        Mean { square, points: count as u32, at: (sum / count as f64).as_vec3() }
    };
    if squares.len() <= points.len() {
        let place = points.par_iter().map(|p| square_of(p).unwrap_or(u32::MAX));
        let groups = Groups::new(squares.len(), place, |i| i);
        let of = |square: u32| Some(groups.of(square as usize)).filter(|own| !own.is_empty());
        return (0..squares.len() as u32)
            .into_par_iter()
            .filter_map(|square| Some(mean(square, &mut of(square)?.iter().copied())))
            .collect();
    }
    // A grid may have many more squares than points.
    let place = |(i, p): (usize, &Vec3)| {
        Some(u64::from(square_of(p)?) << 32 | u64::from(u32::try_from(i).ok()?))
    };
    let mut places: Vec<u64> = Vec::with_capacity(points.len());
    places.par_extend(points.par_iter().enumerate().filter_map(place));
    places.par_sort_unstable();
    (places.par_chunk_by(|a, b| a >> 32 == b >> 32))
        .map(|own| mean((own[0] >> 32) as u32, &mut own.iter().map(|&place| place as u32)))
        .collect()
}

/// Height at every cell centre inside the points' hull; NaN outside. Points must be finite.
pub fn heights(points: &[Vec3], geometry: GridGeometry) -> Grid<f32> {
    let mut grid = Grid::filled(geometry, f32::NAN);
    let open: Vec<Vec3> = if points.len() <= FEW {
        points.to_vec()
    } else {
        let blocks = Blocks::new(points, geometry);
        let parts: Vec<(Vec<f32>, Vec<u32>)> =
            (0..blocks.len()).into_par_iter().map(|b| blocks.heights(points, b)).collect();
        let mut open = Vec::new();
        for (b, (heights, left)) in parts.into_iter().enumerate() {
            let (cols, rows) = blocks.cells(b);
            for (row, line) in rows.zip(heights.chunks(cols.len())) {
                let at = geometry.index(cols.start, row);
                grid.data[at..at + line.len()].copy_from_slice(line);
            }
            open.extend(left.into_iter().map(|i| points[i as usize]));
        }
        open
    };
    let all = (0..geometry.cols, 0..geometry.rows);
    for corners in triangles(&open) {
        draw(&corners.map(|i| open[i].as_dvec3()), &geometry, &all, |i, z| {
            // What the blocks have drawn stays.
            if points.len() <= FEW || grid.data[i].is_nan() {
                grid.data[i] = z;
            }
        });
    }
    grid
}

/// Corners of the Delaunay triangles; none for points in a line.
fn triangles(points: &[Vec3]) -> impl Iterator<Item = [usize; 3]> {
    let places: Vec<Point> =
        points.iter().map(|p| Point { x: p.x.into(), y: p.y.into() }).collect();
    let corners = triangulate(&places).triangles;
    (0..corners.len() / 3).map(move |t| [corners[3 * t], corners[3 * t + 1], corners[3 * t + 2]])
}

/// Vertices by the block of cells that they lie in; those off the grid in the nearest.
struct Blocks {
    geometry: GridGeometry,
    cols: usize,
    rows: usize,
    /// Where each block's vertices begin in `vertices`; one more than blocks.
    start: Vec<u32>,
    vertices: Vec<u32>,
}

impl Blocks {
    fn new(points: &[Vec3], geometry: GridGeometry) -> Blocks {
        let (cols, rows) = (geometry.cols.div_ceil(BLOCK), geometry.rows.div_ceil(BLOCK));
        let mut blocks =
            Blocks { geometry, cols, rows, start: vec![0; cols * rows + 1], vertices: Vec::new() };
        for p in points {
            let b = blocks.block_of(p);
            blocks.start[b + 1] += 1;
        }
        for b in 0..cols * rows {
            blocks.start[b + 1] += blocks.start[b];
        }
        let mut next = blocks.start.clone();
        blocks.vertices = vec![0; points.len()];
        for (i, p) in points.iter().enumerate() {
            let slot = &mut next[blocks.block_of(p)];
            blocks.vertices[*slot as usize] = i as u32;
            *slot += 1;
        }
        blocks
    }

    fn len(&self) -> usize {
        self.cols * self.rows
    }

    fn block_of(&self, p: &Vec3) -> usize {
        let g = &self.geometry;
        let col = (f64::from(p.x) - g.west) / (g.cell_x * BLOCK as f64);
        let row = (g.north - f64::from(p.y)) / (g.cell_y * BLOCK as f64);
        (row as usize).min(self.rows - 1) * self.cols + (col as usize).min(self.cols - 1)
    }

    /// Columns and rows of the grid.
    fn cells(&self, block: usize) -> (Range<usize>, Range<usize>) {
        let span = |at: usize, end: usize| at * BLOCK..((at + 1) * BLOCK).min(end);
        let (col, row) = (block % self.cols, block / self.cols);
        (span(col, self.geometry.cols), span(row, self.geometry.rows))
    }

    /// Heights of the block's cells, row by row, NaN where they are not known yet, and those of its
    /// vertices that are not done with.
    fn heights(&self, points: &[Vec3], block: usize) -> (Vec<f32>, Vec<u32>) {
        let g = &self.geometry;
        let (cols, rows) = self.cells(block);
        let mut heights = vec![f32::NAN; cols.len() * rows.len()];
        let own = self.start[block] as usize..self.start[block + 1] as usize;
        let margin_m = MARGIN * g.cell_x;
        let (west, east) = (
            g.west + cols.start as f64 * g.cell_x - margin_m,
            g.west + cols.end as f64 * g.cell_x + margin_m,
        );
        let (north, south) = (
            g.north - rows.start as f64 * g.cell_y + margin_m,
            g.north - rows.end as f64 * g.cell_y - margin_m,
        );
        // Its own vertices first.
        let mut near: Vec<u32> = self.vertices[own.clone()].to_vec();
        let (col, row) = (block % self.cols, block / self.cols);
        for r in row.saturating_sub(1)..(row + 2).min(self.rows) {
            for c in col.saturating_sub(1)..(col + 2).min(self.cols) {
                let other = r * self.cols + c;
                let theirs = self.start[other] as usize..self.start[other + 1] as usize;
                if other != block {
                    near.extend(self.vertices[theirs].iter().filter(|&&i| {
                        let [x, y] = points[i as usize].truncate().to_array().map(f64::from);
                        (west..=east).contains(&x) && (south..=north).contains(&y)
                    }));
                }
            }
        }
        let places: Vec<Point> = (near.iter())
            .map(|&i| points[i as usize])
            .map(|p| Point { x: p.x.into(), y: p.y.into() })
            .collect();
        let tin = triangulate(&places);
        let mut is_done = vec![!tin.triangles.is_empty(); own.len()];
        let mut leave = |i: usize| {
            if let Some(done) = is_done.get_mut(i) {
                *done = false;
            }
        };
        tin.hull.iter().for_each(|&i| leave(i));
        let all = (cols.clone(), rows.clone());
        for t in tin.triangles.chunks_exact(3) {
            let corners = [t[0], t[1], t[2]].map(|i| points[near[i] as usize].as_dvec3());
            if circle_diameter_sq(&corners) > margin_m * margin_m {
                t.iter().for_each(|&i| leave(i));
                continue;
            }
            draw(&corners, g, &all, |i, z| {
                let (col, row) = (i % g.cols - cols.start, i / g.cols - rows.start);
                heights[row * cols.len() + col] = z;
            });
        }
        let left = near.iter().zip(is_done).filter(|(_, done)| !done).map(|(i, _)| *i).collect();
        (heights, left)
    }
}

/// Infinite for three points in a line.
fn circle_diameter_sq([a, b, c]: &[DVec3; 3]) -> f64 {
    let (ab, ac) = ((*b - *a).truncate(), (*c - *a).truncate());
    let bc = ac - ab;
    let twice_area = ab.perp_dot(ac);
    let product = ab.length_squared() * ac.length_squared() * bc.length_squared();
    if twice_area == 0.0 { f64::INFINITY } else { product / (twice_area * twice_area) }
}

/// Calls `set` with the index and height of each cell of the given columns and rows whose centre
/// lies in the triangle.
fn draw(
    [a, b, c]: &[DVec3; 3],
    g: &GridGeometry,
    (cols, rows): &(Range<usize>, Range<usize>),
    mut set: impl FnMut(usize, f32),
) {
    let (least, most) = (a.min(*b).min(*c), a.max(*b).max(*c));
    // Indices of the first and last centre within [low, high] along one axis.
    let span = |low: f64, high: f64, within: &Range<usize>| {
        let low = (low - 0.5).max(0.0);
        let first = low as usize + usize::from(low > (low as usize) as f64);
        // A negative number becomes 0.
        first.max(within.start)..((high + 0.5) as usize).min(within.end)
    };
    let cols = span((least.x - g.west) / g.cell_x, (most.x - g.west) / g.cell_x, cols);
    if cols.is_empty() {
        return;
    }
    let rows = span((g.north - most.y) / g.cell_y, (g.north - least.y) / g.cell_y, rows);
    let area = (b.x - a.x) * (c.y - a.y) - (b.y - a.y) * (c.x - a.x);
    if rows.is_empty() || area == 0.0 {
        return;
    }
    // Shares of the corners b and c: how they change along x and y.
    let (vx, vy) = ((c.y - a.y) / area, (a.x - c.x) / area);
    let (wx, wy) = ((a.y - b.y) / area, (b.x - a.x) / area);
    for row in rows {
        let y = g.north - (row as f64 + 0.5) * g.cell_y - a.y;
        for col in between_sides([a, b, c], a.y + y, g, &cols) {
            let x = g.west + (col as f64 + 0.5) * g.cell_x - a.x;
            let (v, w) = (vx * x + vy * y, wx * x + wy * y);
            let u = 1.0 - v - w;
            if u.min(v).min(w) >= -1e-9 {
                set(g.index(col, row), (u * a.z + v * b.z + w * c.z) as f32);
            }
        }
    }
}

/// Those of the columns that the sides of a triangle may lie about at a latitude, with one to
/// spare: the box about a long thin triangle is mostly outside it.
fn between_sides(
    [a, b, c]: [&DVec3; 3],
    y: f64,
    g: &GridGeometry,
    cols: &Range<usize>,
) -> Range<usize> {
    const FEW_COLS: usize = 6;
    if cols.len() <= FEW_COLS {
        return cols.clone();
    }
    let (mut west, mut east) = (f64::INFINITY, f64::NEG_INFINITY);
    for (p, q) in [(a, b), (b, c), (c, a)] {
        if p.y != q.y && (p.y - y) * (q.y - y) <= 0.0 {
            let x = p.x + (y - p.y) / (q.y - p.y) * (q.x - p.x);
            (west, east) = (west.min(x), east.max(x));
        }
    }
    if west > east {
        return cols.clone();
    }
    // A negative number becomes 0.
    let first = ((west - g.west) / g.cell_x - 1.5) as usize;
    let end = ((east - g.west) / g.cell_x + 1.5) as usize;
    first.max(cols.start)..(end + 1).min(cols.end)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tilted_plane_is_exact_inside_the_hull_and_nan_outside() {
        let mut points = Vec::new();
        for i in 0..200 {
            let (x, y) = ((i * 37 % 101) as f32 * 0.1, (i * 53 % 97) as f32 * 0.1);
            points.push(Vec3::new(x, y, 3.0 + 0.7 * x - 0.4 * y));
        }
        let geometry = GridGeometry::covering([-2.0, -2.0], [12.0, 12.0], 0.25);
        let grid = heights(&points, geometry);
        let mut inside = 0;
        for row in 0..geometry.rows {
            for col in 0..geometry.cols {
                let [x, y] = geometry.centre(col, row);
                let z = grid.at(col, row);
                if z.is_nan() {
                    assert!((x - 5.0).hypot(y - 4.8) > 3.5, "hole at {x} {y}");
                } else {
                    inside += 1;
                    assert!((f64::from(z) - (3.0 + 0.7 * x - 0.4 * y)).abs() < 1e-4);
                }
            }
        }
        assert!(inside > 1000);
    }

    #[test]
    fn fewer_than_three_points_give_nothing() {
        let geometry = GridGeometry::covering([0.0, 0.0], [3.0, 3.0], 1.0);
        for n in 0..3 {
            let points: Vec<Vec3> = (0..n).map(|i| Vec3::splat(i as f32)).collect();
            assert!(heights(&points, geometry).data.iter().all(|z| z.is_nan()));
        }
    }
}
