//! The terrain as triangles over a regular lattice that reaches the grid's edges.

use glam::{Vec2, Vec3};
use rayon::prelude::*;

use super::Terrain;
use crate::mesh::Surface;

/// Nodes of a regular lattice, row-major from the south-west.
#[derive(Debug, Clone)]
pub struct Lattice {
    /// South-west corner, local metres.
    corner: Vec2,
    step: Vec2,
    /// Squares along x and y.
    squares: [usize; 2],
    height: Vec<f32>,
    normal: Vec<Vec3>,
}

impl Terrain {
    /// A lattice of at most `max_triangles` (at least 2) that is no finer than the grid.
    pub fn lattice(&self, max_triangles: usize) -> Lattice {
        let g = &self.heights.geometry;
        let (width, depth) = ((g.east() - g.west) as f32, (g.north - g.south()) as f32);
        let most = (max_triangles / 2).max(1) as f32;
        // Squares of one size: nx · ny = most, nx / ny = width / depth.
        let nx = ((most * width / depth).sqrt().floor() as usize).clamp(1, g.cols);
        let ny = ((most / nx as f32).floor() as usize).clamp(1, g.rows);
        let corner = Vec2::new(g.west as f32, g.south() as f32);
        let step = Vec2::new(width / nx as f32, depth / ny as f32);
        let place =
            |i: usize| corner + step * Vec2::new((i % (nx + 1)) as f32, (i / (nx + 1)) as f32);
        let count = (nx + 1) * (ny + 1);
        let height = (0..count).into_par_iter().map(|i| self.height_at(place(i))).collect();
        let normal = (0..count).into_par_iter().map(|i| self.normal_at(place(i))).collect();
        Lattice { corner, step, squares: [nx, ny], height, normal }
    }
}

impl Lattice {
    fn node(&self, i: usize, j: usize) -> usize {
        j * (self.squares[0] + 1) + i
    }

    /// Whether a square is split from south-west to north-east: along the diagonal whose ends
    /// differ less, which follows ridges and valleys.
    fn is_split_north_east(&self, i: usize, j: usize) -> bool {
        let z = |di: usize, dj: usize| self.height[self.node(i + di, j + dj)];
        (z(0, 0) - z(1, 1)).abs() <= (z(1, 0) - z(0, 1)).abs()
    }

    /// Triangles with u = 0…1 eastward and v = 0…1 northward over the whole terrain.
    pub fn surface(&self) -> Surface {
        let [nx, ny] = self.squares;
        let mut surface = Surface { normal: self.normal.clone(), ..Surface::default() };
        for j in 0..=ny {
            for i in 0..=nx {
                let p = self.corner + self.step * Vec2::new(i as f32, j as f32);
                surface.position.push(p.extend(self.height[self.node(i, j)]));
                surface.uv.push(Vec2::new(i as f32 / nx as f32, j as f32 / ny as f32));
            }
        }
        for j in 0..ny {
            for i in 0..nx {
                let [sw, se, nw, ne] = [(0, 0), (1, 0), (0, 1), (1, 1)]
                    .map(|(di, dj)| self.node(i + di, j + dj) as u32);
                surface.index.extend(if self.is_split_north_east(i, j) {
                    [sw, se, ne, sw, ne, nw]
                } else {
                    [sw, se, nw, se, ne, nw]
                });
            }
        }
        surface
    }

    /// Height of the surface's triangles at a place; that of the border beyond it.
    pub fn height_at(&self, p: Vec2) -> f32 {
        let [nx, ny] = self.squares;
        let q = (p - self.corner) / self.step;
        let (u, v) = (q.x.clamp(0.0, nx as f32), q.y.clamp(0.0, ny as f32));
        let (i, j) = ((u as usize).min(nx - 1), (v as usize).min(ny - 1));
        let (u, v) = (u - i as f32, v - j as f32);
        let z = |di: usize, dj: usize| self.height[self.node(i + di, j + dj)];
        let (sw, se, nw, ne) = (z(0, 0), z(1, 0), z(0, 1), z(1, 1));
        if self.is_split_north_east(i, j) {
            if u >= v {
                sw + u * (se - sw) + v * (ne - se)
            } else {
                sw + v * (nw - sw) + u * (ne - nw)
            }
        } else if u + v <= 1.0 {
            sw + u * (se - sw) + v * (nw - sw)
        } else {
            ne + (1.0 - u) * (nw - ne) + (1.0 - v) * (se - ne)
        }
    }

    /// RMS difference between the triangles and the grid at the grid's centres, metres.
    pub fn error_m(&self, terrain: &Terrain) -> f32 {
        let g = &terrain.heights.geometry;
        let rows: Vec<f64> = (0..g.rows)
            .into_par_iter()
            .map(|row| {
                (0..g.cols)
                    .map(|col| {
                        let [x, y] = g.centre(col, row);
                        let off = self.height_at(Vec2::new(x as f32, y as f32))
                            - terrain.heights.at(col, row);
                        f64::from(off).powi(2)
                    })
                    .sum()
            })
            .collect();
        (rows.iter().sum::<f64>() / g.len() as f64).sqrt() as f32
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::from_function;

    #[test]
    fn the_surface_and_its_heights_agree() {
        let terrain = from_function(40, 30, 0.5, |x, y| (x * 0.7).sin() * 2.0 + y * y * 0.03);
        let lattice = terrain.lattice(600);
        let surface = lattice.surface();
        assert!(surface.triangles() <= 600 && surface.triangles() > 400);
        for t in surface.index.chunks(3) {
            let [a, b, c] = [0, 1, 2].map(|k| surface.position[t[k] as usize]);
            assert!((b - a).cross(c - a).z > 0.0, "a triangle faces down");
            let middle = (a + b + c) / 3.0;
            assert!((lattice.height_at(middle.truncate()) - middle.z).abs() < 1e-4);
        }
        let (low, high) = surface.bounds();
        assert_eq!((low.x, low.y), (0.0, 0.0));
        assert!((high.x - 20.0).abs() < 1e-4 && (high.y - 15.0).abs() < 1e-4);
    }

    #[test]
    fn finer_lattices_err_less() {
        let terrain = from_function(200, 200, 0.5, |x, y| (x * 0.3).sin() + (y * 0.2).cos());
        let errors = [200, 2_000, 20_000].map(|n| terrain.lattice(n).error_m(&terrain));
        assert!(errors[0] > 4.0 * errors[1] && errors[1] > 4.0 * errors[2], "{errors:?}");
    }
}
