//! Surfaces laid out for drawing at any distance.
//!
//! Leaves are drawn by stochastic simplification (Cook, Halstead, Planck & Ryu 2007): the cards of
//! a crown lie in a shuffled order, a far tree draws only the first of them, each enlarged so
//! that the leaf area stays. Wood lies from thick to thin, and what is thinner than a sample is
//! left out. Terrain lies in compact clusters that are culled one by one.

use glam::{Vec2, Vec3};

use super::texture::Edge;
use crate::mesh::Surface;
use crate::scene::Part;
use crate::seed::Seed;

#[derive(Debug, Clone, Copy)]
pub(super) struct Vertex {
    pub position: Vec3,
    pub normal: Vec3,
    pub uv: Vec2,
}

/// What may be left out, and how.
pub(super) enum Order {
    /// Nothing.
    Whole,
    /// The least altitude of each triangle, falling.
    ThickFirst(Vec<f32>),
    /// Cards in shuffled order.
    Cards {
        /// Middle of each vertex' card.
        middle: Vec<Vec3>,
        /// Triangles up to the end of each card.
        end: Vec<u32>,
        /// Cards of the whole crown.
        all: usize,
        /// Side of a square of a card's mean area.
        side_m: f32,
        /// Middle of the crown, and one over the square of its half axes.
        crown: (Vec3, Vec3),
    },
}

/// A part ready to be drawn.
pub(super) struct Mesh {
    pub vertex: Vec<Vertex>,
    pub triangle: Vec<[u32; 3]>,
    /// Vertices that the triangles up to each one need.
    pub vertex_end: Vec<u32>,
    pub order: Order,
    pub material: u32,
    pub edge: Edge,
    pub bounds: (Vec3, Vec3),
}

/// The triangles of a surface that can be drawn: indices in range, corners finite, area not zero.
fn sound_triangles(s: &Surface) -> Vec<[u32; 3]> {
    let at = |i: u32| s.position.get(i as usize).copied().filter(|p| p.is_finite());
    s.index
        .chunks_exact(3)
        .filter_map(|t| {
            let (a, b, c) = (at(t[0])?, at(t[1])?, at(t[2])?);
            let area = (b - a).cross(c - a).length_squared();
            (area > 0.0).then_some([t[0], t[1], t[2]])
        })
        .collect()
}

impl Mesh {
    /// Renumbers vertices in the order in which the triangles use them.
    fn new(surface: &Surface, triangles: &[[u32; 3]], material: u32) -> Mesh {
        let mut new_id = vec![u32::MAX; surface.position.len()];
        let (mut vertex, mut vertex_end) = (Vec::new(), Vec::with_capacity(triangles.len()));
        let (mut lo, mut hi) = (Vec3::MAX, Vec3::MIN);
        let mut triangle = Vec::with_capacity(triangles.len());
        for t in triangles {
            let ids = t.map(|i| {
                let old = i as usize;
                if new_id[old] == u32::MAX {
                    new_id[old] = vertex.len() as u32;
                    let position = surface.position[old];
                    lo = lo.min(position);
                    hi = hi.max(position);
                    let normal = surface.normal.get(old).copied().unwrap_or(Vec3::Z);
                    let uv = surface.uv.get(old).copied().unwrap_or(Vec2::ZERO);
                    vertex.push(Vertex {
                        position,
                        normal: if normal.is_finite() { normal } else { Vec3::Z },
                        uv: if uv.is_finite() { uv } else { Vec2::ZERO },
                    });
                }
                new_id[old]
            });
            triangle.push(ids);
            vertex_end.push(vertex.len() as u32);
        }
        if vertex.is_empty() {
            (lo, hi) = (Vec3::ZERO, Vec3::ZERO);
        }
        let unit = -1e-4..=1.0 + 1e-4;
        let is_once = |v: &Vertex| unit.contains(&v.uv.x) && unit.contains(&v.uv.y);
        let edge = if vertex.iter().all(is_once) { Edge::Clamp } else { Edge::Repeat };
        let bounds = (lo, hi);
        Mesh { vertex, triangle, vertex_end, order: Order::Whole, material, edge, bounds }
    }

    /// Wood: thick triangles first.
    pub fn solid(part: &Part) -> Mesh {
        let s = &part.surface;
        let mut keyed: Vec<(f32, [u32; 3])> = sound_triangles(s)
            .into_iter()
            .map(|t| {
                let [a, b, c] = t.map(|i| s.position[i as usize]);
                let longest = (b - a).length().max((c - b).length()).max((a - c).length());
                ((b - a).cross(c - a).length() / longest, t)
            })
            .collect();
        keyed.sort_by(|a, b| b.0.total_cmp(&a.0));
        let triangles: Vec<_> = keyed.iter().map(|k| k.1).collect();
        let mut mesh = Mesh::new(s, &triangles, part.material);
        mesh.order = Order::ThickFirst(keyed.iter().map(|k| k.0).collect());
        mesh
    }

    /// Leaves: triangles that share vertices are one card.
    pub fn cards(part: &Part) -> Mesh {
        let s = &part.surface;
        let mut triangles = sound_triangles(s);
        let mut root: Vec<u32> = (0..s.position.len() as u32).collect();
        for t in &triangles {
            let [a, b, c] = t.map(|i| find(&mut root, i));
            let least = a.min(b).min(c);
            for r in [a, b, c] {
                root[r as usize] = least;
            }
        }
        let seed = Seed::new(0x0_1ea7);
        triangles.sort_by_cached_key(|t| {
            let r = find(&mut root, t[0]);
            (seed.derive("card", u64::from(r)).draws().bits(), r)
        });
        let mut mesh = Mesh::new(s, &triangles, part.material);
        let (mut end, mut middle) = (Vec::new(), vec![Vec3::ZERO; mesh.vertex.len()]);
        let (mut area, mut first_vertex) = (0.0f64, 0usize);
        for (i, t) in triangles.iter().enumerate() {
            let [a, b, c] = t.map(|i| s.position[i as usize]);
            area += 0.5 * f64::from((b - a).cross(c - a).length());
            let here = find(&mut root, t[0]);
            let is_last = triangles.get(i + 1).is_none_or(|n| find(&mut root, n[0]) != here);
            if is_last {
                let last_vertex = mesh.vertex_end[i] as usize;
                let of_card = first_vertex..last_vertex;
                let sum: Vec3 = mesh.vertex[of_card.clone()].iter().map(|v| v.position).sum();
                middle[of_card.clone()].fill(sum / of_card.len().max(1) as f32);
                end.push(i as u32 + 1);
                first_vertex = last_vertex;
            }
        }
        let side_m = (area / end.len().max(1) as f64).sqrt() as f32;
        let half = ((mesh.bounds.1 - mesh.bounds.0) * 0.5).max(Vec3::splat(1e-3));
        let crown = ((mesh.bounds.0 + mesh.bounds.1) * 0.5, 1.0 / (half * half));
        let all = end.len();
        mesh.order = Order::Cards { middle, end, all, side_m, crown };
        mesh
    }

    /// Terrain: compact clusters in Morton order.
    pub fn clusters(surface: &Surface, material: u32) -> Vec<Mesh> {
        const TRIANGLES: usize = 512;
        let mut triangles = sound_triangles(surface);
        let (lo, hi) = surface.bounds();
        let scale = 1023.0 / (hi - lo).truncate().max(Vec2::splat(1e-6));
        triangles.sort_by_cached_key(|t| {
            let p: Vec3 = t.iter().map(|&i| surface.position[i as usize]).sum::<Vec3>() / 3.0;
            let q = ((p - lo).truncate() * scale).clamp(Vec2::ZERO, Vec2::splat(1023.0));
            spread(q.x as u32) | spread(q.y as u32) << 1
        });
        triangles.chunks(TRIANGLES).map(|c| Mesh::new(surface, c, material)).collect()
    }

    /// Lets go of all but the first triangles, a count that [`Mesh::detail`] gave.
    pub fn truncate(&mut self, triangles: usize) {
        if triangles >= self.triangle.len() {
            return;
        }
        let used = triangles.checked_sub(1).map_or(0, |i| self.vertex_end[i] as usize);
        self.vertex.truncate(used);
        self.vertex.shrink_to_fit();
        self.triangle.truncate(triangles);
        self.triangle.shrink_to_fit();
        self.vertex_end.truncate(triangles);
        self.vertex_end.shrink_to_fit();
        match &mut self.order {
            Order::Whole => {}
            Order::ThickFirst(thickness) => {
                thickness.truncate(triangles);
                thickness.shrink_to_fit();
            }
            Order::Cards { middle, end, .. } => {
                middle.truncate(used);
                middle.shrink_to_fit();
                end.truncate(end.partition_point(|&e| e as usize <= triangles));
                end.shrink_to_fit();
            }
        }
    }

    /// Triangles to draw where a sample is `sample_m` wide and a card shall span `card_samples`,
    /// and how much longer a card's sides become.
    pub fn detail(&self, sample_m: f32, card_samples: f32) -> (usize, f32) {
        match &self.order {
            Order::Whole => (self.triangle.len(), 1.0),
            Order::ThickFirst(thickness) => {
                let least = 0.35 * sample_m;
                (thickness.partition_point(|&t| t >= least), 1.0)
            }
            Order::Cards { end, all, side_m, .. } => {
                let wanted = (side_m / (sample_m * card_samples)).min(1.0);
                let share = (wanted * wanted).max(0.004);
                let cards = ((*all as f32 * share).ceil() as usize).min(end.len());
                let count = cards.checked_sub(1).map_or(0, |i| end[i] as usize);
                let kept = cards as f32 / (*all).max(1) as f32;
                (count, if kept > 0.0 { (1.0 / kept).sqrt() } else { 1.0 })
            }
        }
    }
}

/// Root of a vertex' card, halving the path on the way.
fn find(root: &mut [u32], mut i: u32) -> u32 {
    while root[i as usize] != i {
        let up = root[root[i as usize] as usize];
        root[i as usize] = up;
        i = up;
    }
    i
}

/// Ten bits with a gap after each.
fn spread(v: u32) -> u32 {
    let v = (v | (v << 8)) & 0x00ff_00ff;
    let v = (v | (v << 4)) & 0x0f0f_0f0f;
    let v = (v | (v << 2)) & 0x3333_3333;
    (v | (v << 1)) & 0x5555_5555
}

#[cfg(test)]
mod tests {
    use super::*;

    fn quads(count: usize) -> Part {
        let mut s = Surface::default();
        for i in 0..count {
            let o = Vec3::new(i as f32 * 3.0, 0.0, 0.0);
            let first = s.position.len() as u32;
            for d in [Vec3::ZERO, Vec3::X, Vec3::X + Vec3::Z, Vec3::Z] {
                s.position.push(o + d);
                s.normal.push(Vec3::Y);
                s.uv.push(Vec2::new(d.x, d.z));
            }
            s.index.extend([0, 1, 2, 0, 2, 3].map(|k| first + k));
        }
        Part { name: "foliage".into(), surface: s, material: 0 }
    }

    #[test]
    fn fewer_cards_keep_the_leaf_area() {
        let mesh = Mesh::cards(&quads(1000));
        let Order::Cards { end, side_m, middle, .. } = &mesh.order else { panic!() };
        assert_eq!(end.len(), 1000);
        assert!((side_m - 1.0).abs() < 1e-5);
        assert!(
            mesh.vertex
                .iter()
                .zip(middle)
                .all(|(v, m)| { ((v.position - *m).length() - 0.5f32.sqrt()).abs() < 1e-3 })
        );
        assert_eq!(mesh.detail(0.1, 2.0), (2000, 1.0));
        let (count, grow) = mesh.detail(1.0, 2.0);
        assert_eq!(count % 2, 0);
        assert!((count as f32 / 2.0 * grow * grow - 1000.0).abs() < 1.0);
        assert!(count < 600);
    }

    #[test]
    fn what_is_let_go_of_is_not_missed_in_that_detail() {
        for lay in [Mesh::cards as fn(&Part) -> Mesh, Mesh::solid] {
            let (whole, mut short) = (lay(&quads(1000)), lay(&quads(1000)));
            let (count, grow) = whole.detail(1.0, 2.0);
            short.truncate(count);
            assert_eq!(short.detail(1.0, 2.0), (count, grow));
            assert_eq!(short.detail(3.0, 2.0), whole.detail(3.0, 2.0));
            assert_eq!(short.triangle[..], whole.triangle[..count]);
            let most = short.triangle.iter().flatten().max().map_or(0, |i| *i as usize + 1);
            assert_eq!(short.vertex.len(), most);
        }
    }

    #[test]
    fn triangles_that_can_not_be_drawn_are_left_out() {
        let mut part = quads(2);
        part.surface.index.extend([0, 0, 1, 2, 3, 99]);
        part.surface.position[7].x = f32::NAN;
        assert_eq!(Mesh::solid(&part).triangle.len(), 3);
    }
}
