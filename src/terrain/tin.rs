//! Heights on a grid from scattered points: a Delaunay triangulation, linear in each triangle.
//!
//! The triangles are drawn onto the grid one after the other, so that no point location is needed
//! and the result does not depend on any order of queries. Known limit: long thin triangles along
//! the hull are as linear as the others.

use glam::{DVec3, Vec3};
use rayon::prelude::*;
use spade::{DelaunayTriangulation, HasPosition, Point2, Triangulation};

use crate::raster::{Grid, GridGeometry};

struct Vertex {
    position: Point2<f64>,
    z: f64,
}

impl HasPosition for Vertex {
    type Scalar = f64;
    fn position(&self) -> Point2<f64> {
        self.position
    }
}

/// The mean point of each square of `cell_m` that holds any, in the order of the squares: as many
/// vertices as the grid can show, and less noise in each.
pub fn thinned(points: &[Vec3], geometry: &GridGeometry) -> Vec<Vec3> {
    // Sorted rather than summed on the grid, which may have many more squares than points.
    let mut places: Vec<(u32, u32)> = points
        .iter()
        .enumerate()
        .filter_map(|(i, p)| {
            let (c, r) = geometry.cell_of(p.x.into(), p.y.into())?;
            Some((u32::try_from(geometry.index(c, r)).ok()?, u32::try_from(i).ok()?))
        })
        .collect();
    places.par_sort_unstable();
    places
        .chunk_by(|a, b| a.0 == b.0)
        .map(|same| {
            let sum = same.iter().map(|&(_, i)| points[i as usize].as_dvec3()).sum::<DVec3>();
            (sum / same.len() as f64).as_vec3()
        })
        .collect()
}

/// Height at every cell centre inside the points' hull; NaN outside. Points must be finite.
pub fn heights(points: &[Vec3], geometry: GridGeometry) -> Grid<f32> {
    let mut grid = Grid::filled(geometry, f32::NAN);
    let vertices = points
        .iter()
        .map(|p| Vertex { position: Point2::new(p.x.into(), p.y.into()), z: p.z.into() })
        .collect();
    let Ok(tin) = DelaunayTriangulation::<Vertex>::bulk_load(vertices) else { return grid };
    for face in tin.inner_faces() {
        let corners = face.vertices().map(|v| {
            let d = v.data();
            [d.position.x, d.position.y, d.z]
        });
        draw(&corners, &mut grid);
    }
    grid
}

fn draw([a, b, c]: &[[f64; 3]; 3], grid: &mut Grid<f32>) {
    let g = grid.geometry;
    let area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
    if area == 0.0 {
        return;
    }
    let least = |k: usize| a[k].min(b[k]).min(c[k]);
    let most = |k: usize| a[k].max(b[k]).max(c[k]);
    // Indices of the first and last centre within [low, high] along one axis.
    let span = |low: f64, high: f64, count: usize| {
        let first = (low - 0.5).ceil().max(0.0) as usize;
        let last = (high - 0.5).floor();
        if last < 0.0 { 0..0 } else { first..(last as usize + 1).min(count) }
    };
    let cols = span((least(0) - g.west) / g.cell_x, (most(0) - g.west) / g.cell_x, g.cols);
    let rows = span((g.north - most(1)) / g.cell_y, (g.north - least(1)) / g.cell_y, g.rows);
    for row in rows {
        for col in cols.clone() {
            let [x, y] = g.centre(col, row);
            let v = ((x - a[0]) * (c[1] - a[1]) - (y - a[1]) * (c[0] - a[0])) / area;
            let w = ((b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0])) / area;
            let u = 1.0 - v - w;
            if u.min(v).min(w) >= -1e-9 {
                grid.set(col, row, (u * a[2] + v * b[2] + w * c[2]) as f32);
            }
        }
    }
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
