//! The terrain as few triangles: greedy insertion (Garland & Heckbert 1995). From two triangles
//! over the whole, the grid height that is worst off becomes a vertex of a Delaunay triangulation,
//! until every height is within the error, or the triangles are used up.
//!
//! Heights are compared at the centres of all cells and along the border. Each step is the best of
//! that step alone, so fewer triangles may be possible; the bound itself is kept exactly. Errors of
//! all coarser terrains are met on the way and kept as a table.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use glam::{Vec2, Vec3};
use spade::handles::{FixedVertexHandle, InnerTag};
use spade::{DelaunayTriangulation, HasPosition, Point2, PositionInTriangulation, Triangulation};

use super::Terrain;
use crate::mesh::Surface;

/// Triangles of a regular or irregular terrain that is seen from all around.
#[derive(Debug)]
pub struct Facets {
    tin: DelaunayTriangulation<Vertex>,
    /// Greatest difference from the grid that is left, metres.
    pub worst_m: f32,
    /// Error and the triangles it takes, the coarsest first.
    pub ladder: Vec<(f32, usize)>,
    low: Vec2,
    size: Vec2,
}

/// Errors that the table lists, metres.
const LADDER_M: [f32; 10] = [10.0, 5.0, 2.0, 1.0, 0.5, 0.2, 0.1, 0.05, 0.02, 0.01];

#[derive(Debug, Clone, Copy)]
struct Vertex {
    position: Point2<f64>,
    z: f32,
    normal: Vec3,
}

impl HasPosition for Vertex {
    type Scalar = f64;
    fn position(&self) -> Point2<f64> {
        self.position
    }
}

type Face<'a> = spade::handles::FaceHandle<'a, InnerTag, Vertex, (), (), ()>;

/// The heights to be met: cell centres, and the border that cells reach halfway beyond them.
struct Nodes<'a> {
    terrain: &'a Terrain,
    x: Vec<f64>,
    /// Rising, south to north.
    y: Vec<f64>,
    z: Vec<f32>,
}

impl<'a> Nodes<'a> {
    fn new(terrain: &'a Terrain) -> Self {
        let g = &terrain.heights.geometry;
        let centres_x = (0..g.cols).map(|c| g.centre(c, 0)[0]);
        let centres_y = (0..g.rows).rev().map(|r| g.centre(0, r)[1]);
        let x: Vec<f64> = [g.west].into_iter().chain(centres_x).chain([g.east()]).collect();
        let y: Vec<f64> = [g.south()].into_iter().chain(centres_y).chain([g.north]).collect();
        let mut z = Vec::with_capacity(x.len() * y.len());
        for &north in &y {
            z.extend(x.iter().map(|&east| terrain.height_at(Vec2::new(east as f32, north as f32))));
        }
        Nodes { terrain, x, y, z }
    }

    fn vertex(&self, node: usize) -> Vertex {
        let (i, j) = (node % self.x.len(), node / self.x.len());
        let normal = self.terrain.normal_at(Vec2::new(self.x[i] as f32, self.y[j] as f32));
        Vertex { position: Point2::new(self.x[i], self.y[j]), z: self.z[node], normal }
    }

    /// The node of a face that is farthest from it, and how far.
    fn worst(&self, face: &Face<'_>) -> (f32, usize) {
        let corner = face.vertices().map(|v| *v.data());
        let [a, b, c] = corner.map(|v| v.position);
        let plane = Plane::through(&corner);
        let low = a.y.min(b.y).min(c.y);
        let high = a.y.max(b.y).max(c.y);
        let from = self.y.partition_point(|&y| y < low);
        let mut worst = (0.0f32, 0);
        for (j, &y) in self.y.iter().enumerate().skip(from) {
            if y > high {
                break;
            }
            // Where the row enters and leaves the triangle.
            let (mut west, mut east) = (f64::INFINITY, f64::NEG_INFINITY);
            for (p, q) in [(a, b), (b, c), (c, a)] {
                if (y < p.y) == (y < q.y) && y != p.y && y != q.y {
                    continue;
                }
                for x in if p.y == q.y {
                    [p.x, q.x]
                } else {
                    [p.x + (q.x - p.x) * (y - p.y) / (q.y - p.y); 2]
                } {
                    west = west.min(x);
                    east = east.max(x);
                }
            }
            let start = self.x.partition_point(|&x| x < west);
            let row = j * self.x.len();
            for (i, &x) in self.x.iter().enumerate().skip(start) {
                if x > east {
                    break;
                }
                let off = (self.z[row + i] - plane.at(x, y)).abs();
                if off > worst.0 {
                    worst = (off, row + i);
                }
            }
        }
        worst
    }
}

/// z over x, y from the first of three corners.
struct Plane {
    from: Point2<f64>,
    z: f64,
    slope: [f64; 2],
}

impl Plane {
    fn through(corner: &[Vertex; 3]) -> Plane {
        let [a, b, c] = corner.map(|v| v.position);
        let (ux, uy, uz) = (b.x - a.x, b.y - a.y, f64::from(corner[1].z - corner[0].z));
        let (vx, vy, vz) = (c.x - a.x, c.y - a.y, f64::from(corner[2].z - corner[0].z));
        let area = ux * vy - uy * vx;
        let slope = match area != 0.0 {
            true => [(uz * vy - vz * uy) / area, (vz * ux - uz * vx) / area],
            false => [0.0; 2],
        };
        Plane { from: a, z: f64::from(corner[0].z), slope }
    }

    fn at(&self, x: f64, y: f64) -> f32 {
        (self.z + self.slope[0] * (x - self.from.x) + self.slope[1] * (y - self.from.y)) as f32
    }
}

/// A face and its worst node; the worst of all comes first, then the lowest node.
type Candidate = (u32, Reverse<usize>, [FixedVertexHandle; 3]);

impl Terrain {
    /// Triangles within `error_m` of the grid, at most `max_triangles` of them (but two).
    pub fn facets(&self, error_m: f32, max_triangles: usize) -> Facets {
        let nodes = Nodes::new(self);
        let (nx, ny) = (nodes.x.len(), nodes.y.len());
        let mut tin = DelaunayTriangulation::<Vertex>::new();
        for node in [0, nx - 1, nx * (ny - 1), nx * ny - 1] {
            // Corners of a box with finite sides.
            let _ = tin.insert(nodes.vertex(node));
        }
        let least = error_m.max(1e-4);
        let mut heap: BinaryHeap<Candidate> = BinaryHeap::new();
        let candidate = |face: &Face<'_>| -> Option<Candidate> {
            let (off, node) = nodes.worst(face);
            let ids = face.vertices().map(|v| v.fix());
            // The bits of positive floats are in their order.
            (off > least).then_some((off.to_bits(), Reverse(node), ids))
        };
        heap.extend(tin.inner_faces().filter_map(|f| candidate(&f)));
        let mut ladder = Vec::new();
        let mut rungs = LADDER_M.into_iter().peekable();
        let mut worst_m = least;
        while let Some((bits, Reverse(node), ids)) = heap.pop() {
            if !is_face(&tin, ids) {
                continue;
            }
            let off = f32::from_bits(bits);
            while let Some(rung) = rungs.next_if(|&rung| rung >= off) {
                ladder.push((rung, tin.num_inner_faces()));
            }
            if tin.num_inner_faces() + 2 > max_triangles.max(2) {
                worst_m = off;
                break;
            }
            let Ok(new) = tin.insert_with_hint(nodes.vertex(node), ids[0]) else { break };
            heap.extend(
                tin.vertex(new)
                    .out_edges()
                    .filter_map(|e| e.face().as_inner())
                    .filter_map(|f| candidate(&f)),
            );
        }
        let met = tin.num_inner_faces();
        ladder.extend(rungs.take_while(|&rung| rung >= worst_m).map(|rung| (rung, met)));
        let g = &self.heights.geometry;
        let low = Vec2::new(g.west as f32, g.south() as f32);
        let size = Vec2::new((g.east() - g.west) as f32, (g.north - g.south()) as f32);
        Facets { tin, worst_m, ladder, low, size }
    }
}

fn is_face(tin: &DelaunayTriangulation<Vertex>, [a, b, c]: [FixedVertexHandle; 3]) -> bool {
    tin.get_edge_from_neighbors(a, b)
        .and_then(|e| e.face().as_inner())
        .is_some_and(|f| f.vertices().iter().any(|v| v.fix() == c))
}

impl Facets {
    pub fn triangles(&self) -> usize {
        self.tin.num_inner_faces()
    }

    /// Triangles with u = 0…1 eastward and v = 0…1 northward over the whole terrain.
    pub fn surface(&self) -> Surface {
        let mut surface = Surface::default();
        for v in self.tin.vertices() {
            let v = v.data();
            let at = Vec2::new(v.position.x as f32, v.position.y as f32);
            surface.position.push(at.extend(v.z));
            surface.normal.push(v.normal);
            surface.uv.push((at - self.low) / self.size);
        }
        for face in self.tin.inner_faces() {
            surface.index.extend(face.vertices().map(|v| v.index() as u32));
        }
        surface
    }

    /// Height of the triangles at a place; that of the nearest border beyond them.
    pub fn height_at(&self, p: Vec2) -> f32 {
        let p = p.clamp(self.low, self.low + self.size);
        let at = Point2::new(f64::from(p.x), f64::from(p.y));
        let on_face = |f: Face<'_>| Plane::through(&f.vertices().map(|v| *v.data())).at(at.x, at.y);
        match self.tin.locate(at) {
            PositionInTriangulation::OnVertex(v) => self.tin.vertex(v).data().z,
            PositionInTriangulation::OnFace(f) => on_face(self.tin.face(f)),
            PositionInTriangulation::OnEdge(e)
            | PositionInTriangulation::OutsideOfConvexHull(e) => {
                let e = self.tin.directed_edge(e);
                e.face().as_inner().or(e.rev().face().as_inner()).map_or(0.0, on_face)
            }
            PositionInTriangulation::NoTriangulation => 0.0,
        }
    }
}

#[cfg(test)]
mod tests {
    use glam::Vec2;

    use super::super::Terrain;
    use super::super::tests::from_function;
    use super::Facets;

    /// Greatest difference at the cells' centres.
    fn worst(facets: &Facets, terrain: &Terrain) -> f32 {
        let g = &terrain.heights.geometry;
        let mut worst: f32 = 0.0;
        for row in 0..g.rows {
            for col in 0..g.cols {
                let [x, y] = g.centre(col, row);
                let off =
                    facets.height_at(Vec2::new(x as f32, y as f32)) - terrain.heights.at(col, row);
                worst = worst.max(off.abs());
            }
        }
        worst
    }

    #[test]
    fn every_height_is_within_the_error() {
        let terrain = from_function(120, 90, 0.5, |x, y| (x * 0.4).sin() * 2.0 + y * y * 0.01);
        let mut before = usize::MAX;
        for error_m in [0.02, 0.1, 0.5, 2.0] {
            let facets = terrain.facets(error_m, usize::MAX);
            assert!(facets.worst_m <= error_m);
            let worst = worst(&facets, &terrain);
            assert!(worst <= error_m + 1e-4, "{worst} above {error_m}");
            assert!(facets.triangles() < before, "{error_m}: {}", facets.triangles());
            before = facets.triangles();
            let listed = facets.ladder.iter().find(|(e, _)| *e == error_m).unwrap();
            assert_eq!(listed.1, facets.triangles());
        }
    }

    #[test]
    fn a_plane_takes_two_triangles_and_a_roof_few() {
        let plane = from_function(200, 100, 0.5, |x, y| 7.0 + 0.5 * x - 0.25 * y);
        // The border lies half a cell beyond the last centres, where the grid goes on level.
        let facets = plane.facets(0.3, usize::MAX);
        assert_eq!(facets.triangles(), 2);
        let roof = from_function(201, 100, 0.5, |x, _| (x - 50.25).abs());
        let facets = roof.facets(0.6, usize::MAX);
        assert!(facets.triangles() <= 16, "{}", facets.triangles());
        assert!(worst(&facets, &roof) <= 0.6);
    }

    #[test]
    fn a_bound_on_triangles_is_kept_and_the_error_told() {
        let terrain = from_function(150, 150, 0.5, |x, y| (x * 0.9).sin() + (y * 0.7).cos());
        for most in [2, 50, 1001] {
            let facets = terrain.facets(0.001, most);
            assert!(facets.triangles() <= most);
            assert!(worst(&facets, &terrain) <= facets.worst_m + 1e-4);
        }
        let few = terrain.facets(0.001, 400).worst_m;
        assert!(terrain.facets(0.001, 4000).worst_m < 0.2 * few);
    }

    #[test]
    fn triangles_face_up_and_reach_the_border() {
        let terrain = from_function(40, 30, 0.5, |x, y| (x * 0.7).sin() * 2.0 + y * y * 0.03);
        let facets = terrain.facets(0.05, 900);
        let surface = facets.surface();
        assert_eq!(surface.triangles(), facets.triangles());
        for t in surface.index.chunks(3) {
            let [a, b, c] = [0, 1, 2].map(|k| surface.position[t[k] as usize]);
            assert!((b - a).cross(c - a).z > 0.0, "a triangle faces down");
            let middle = (a + b + c) / 3.0;
            assert!((facets.height_at(middle.truncate()) - middle.z).abs() < 1e-3);
        }
        let (low, high) = surface.bounds();
        assert_eq!((low.x, low.y), (0.0, 0.0));
        assert!((high.x - 20.0).abs() < 1e-4 && (high.y - 15.0).abs() < 1e-4);
        // Beyond the border its height goes on.
        let corner = surface.position.iter().find(|p| p.x == 0.0 && p.y == 0.0).unwrap();
        assert_eq!(facets.height_at(Vec2::splat(-50.0)), corner.z);
    }

    #[test]
    fn one_cell_is_a_terrain_too() {
        let facets = from_function(1, 1, 1.0, |_, _| 3.0).facets(0.1, 100);
        assert_eq!((facets.triangles(), facets.height_at(Vec2::splat(0.4))), (2, 3.0));
    }
}
