//! Many copies of one small surface, filled side by side: each copy takes the same room, so that
//! its place in the columns is known before it is made, on any number of threads.

use glam::{Vec2, Vec3, Vec3A};
use rayon::prelude::*;

use super::Surface;
use super::spot::Spot;
use super::wind::Wind;

/// Room that every copy takes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Room {
    pub vertices: usize,
    pub triangles: usize,
}

impl std::ops::Add for Room {
    type Output = Room;

    fn add(self, more: Room) -> Room {
        Room { vertices: self.vertices + more.vertices, triangles: self.triangles + more.triangles }
    }
}

/// Vertices that 32-bit indices reach, with room to spare.
const MOST_VERTICES: usize = 1 << 30;
/// Least cosine between a corner's normal and the front of its triangle.
pub const LEAST_COSINE: f32 = 0.03;

/// Copies that a thread makes before it looks for more.
const AT_ONCE: usize = 16;

/// The part of a surface's columns that is one copy's.
type Columns<'a> = (&'a mut [Vec3], &'a mut [Vec3], &'a mut [Vec2], &'a mut [u32]);

/// One copy while it is made.
pub struct Piece<'a> {
    position: &'a mut [Vec3],
    normal: &'a mut [Vec3],
    uv: &'a mut [Vec2],
    index: &'a mut [u32],
    /// Of its first vertex in the whole.
    first: u32,
    vertices: usize,
    corners: usize,
    /// Whether its normals have been seen to.
    is_straight: bool,
}

impl Piece<'_> {
    /// Adds a vertex and gives its number within the piece. `normal` may have any length.
    pub fn vertex(&mut self, position: Vec3, normal: Vec3, uv: Vec2) -> u32 {
        let k = self.vertices;
        if let (Some(p), Some(n), Some(t)) =
            (self.position.get_mut(k), self.normal.get_mut(k), self.uv.get_mut(k))
        {
            (*p, *n, *t) = (position, normal.normalize_or(Vec3::Z), uv);
            self.vertices += 1;
        }
        k as u32
    }

    /// Adds vertices, whose normals have unit length, and triangles of them; gives the first one's
    /// number within the piece.
    #[inline]
    pub fn blade<const V: usize, const T: usize>(
        &mut self,
        vertices: [(Vec3, Vec3, Vec2); V],
        triangles: [[u32; 3]; T],
    ) -> u32 {
        let (v, t) = (self.vertices, self.corners);
        let columns = (
            self.position.get_mut(v..v + V),
            self.normal.get_mut(v..v + V),
            self.uv.get_mut(v..v + V),
            self.index.get_mut(t..t + 3 * T),
        );
        if let (Some(position), Some(normal), Some(uv), Some(index)) = columns {
            for (k, vertex) in vertices.into_iter().enumerate() {
                (position[k], normal[k], uv[k]) = vertex;
            }
            let first = self.first + v as u32;
            for (slot, corner) in index.iter_mut().zip(triangles.as_flattened()) {
                *slot = first + corner;
            }
            (self.vertices, self.corners) = (v + V, t + 3 * T);
        }
        v as u32
    }

    /// The whole piece at once: as many vertices and triangles as it has room for. `place` gives the
    /// position and the normal, of unit length, of each vertex.
    pub fn copy(&mut self, place: impl Iterator<Item = (Vec3, Vec3)>, uv: &[Vec2], index: &[u32]) {
        for ((p, n), at) in self.position.iter_mut().zip(&mut *self.normal).zip(place) {
            (*p, *n) = at;
        }
        for (slot, uv) in self.uv.iter_mut().zip(uv) {
            *slot = *uv;
        }
        for (slot, corner) in self.index.iter_mut().zip(index) {
            *slot = self.first + corner;
        }
        (self.vertices, self.corners) = (uv.len(), index.len());
    }

    /// [`straighten`] for the whole piece, where normals can look away from triangles of these corners alone,
    /// counted within the piece.
    pub fn straighten(&mut self, corners: &[u32]) {
        if straighten(self.position, self.normal, corners, 0) {
            straighten(self.position, self.normal, self.index, self.first);
        }
        self.is_straight = true;
    }

    /// Adds a triangle of the piece's vertices, counter-clockwise seen from its front.
    pub fn triangle(&mut self, corners: [u32; 3]) {
        if let Some(slots) = self.index.get_mut(self.corners..self.corners + 3) {
            slots.copy_from_slice(&corners.map(|c| c + self.first));
            self.corners += 3;
        }
    }
}

/// Turns normals that look away from the front of one of their triangles back, just far enough;
/// indices count from `first`. Tells whether there were any: then a turn for one triangle may have
/// turned the normal away from another.
pub fn straighten(position: &[Vec3], normal: &mut [Vec3], index: &[u32], first: u32) -> bool {
    let mut has_turned = false;
    for t in index.as_chunks::<3>().0 {
        let corners = t.map(|i| (i - first) as usize);
        let [a, b, c] = corners.map(|i| Vec3A::from(position[i]));
        let front = (b - a).cross(c - a);
        let dots = corners.map(|i| Vec3A::from(normal[i]).dot(front));
        let [d, e, f] = dots;
        let least = if d < e { d } else { e };
        let least = if f < least { f } else { least };
        // Few need a root.
        let length_sq = front.length_squared();
        if least * least.abs() < LEAST_COSINE * LEAST_COSINE * length_sq {
            let per_length = length_sq.sqrt().recip();
            let front = front * per_length;
            for (i, dot) in corners.into_iter().zip(dots) {
                let turn = 2.0 * LEAST_COSINE - dot * per_length;
                if turn > LEAST_COSINE {
                    normal[i] = (Vec3A::from(normal[i]) + front * turn).normalize_or(front).into();
                    has_turned = true;
                }
            }
        }
    }
    has_turned
}

/// `count` pieces as one surface; `emit` must fill the whole room of each. In a wind each moves as
/// a twig that hangs from its spot.
pub fn fill(
    count: usize,
    room: Room,
    emit: impl Fn(usize, &mut Piece) + Sync,
    wind: Option<(&Wind, &[Spot])>,
) -> Surface {
    let count = count.min(MOST_VERTICES / room.vertices.max(1));
    if count == 0 || room.vertices == 0 || room.triangles == 0 {
        return Surface::default();
    }
    // Zeroed by the system, page by page as the threads come to it.
    let mut out = Surface {
        position: bytemuck::zeroed_vec(count * room.vertices),
        normal: bytemuck::zeroed_vec(count * room.vertices),
        uv: bytemuck::zeroed_vec(count * room.vertices),
        index: vec![0; count * room.triangles * 3],
        ..Surface::default()
    };
    let columns = (
        out.position.par_chunks_exact_mut(room.vertices),
        out.normal.par_chunks_exact_mut(room.vertices),
        out.uv.par_chunks_exact_mut(room.vertices),
        out.index.par_chunks_exact_mut(room.triangles * 3),
    );
    let one = |k: usize, (position, normal, uv, index): Columns, colour: &mut [[u8; 4]]| {
        let first = (k * room.vertices) as u32;
        let (vertices, corners, is_straight) = (0, 0, false);
        let mut piece =
            Piece { position, normal, uv, index, first, vertices, corners, is_straight };
        emit(k, &mut piece);
        debug_assert_eq!((piece.vertices, piece.corners), (room.vertices, 3 * room.triangles));
        // What was left open points at the piece itself.
        piece.index[piece.corners..].fill(first);
        if !piece.is_straight && straighten(piece.position, piece.normal, piece.index, first) {
            straighten(piece.position, piece.normal, piece.index, first);
        }
        if let Some((wind, spots)) = wind {
            let spot = &spots[k];
            wind.twig(piece.position, spot.at, spot.node(), spot.key, colour);
        }
    };
    let pieces = columns.into_par_iter().enumerate();
    if wind.is_some() {
        out.wind = bytemuck::zeroed_vec(count * room.vertices);
        let colours = out.wind.par_chunks_exact_mut(room.vertices);
        let pieces = pieces.zip(colours).with_min_len(AT_ONCE);
        pieces.for_each(|((k, columns), colour)| one(k, columns, colour));
    } else {
        pieces.with_min_len(AT_ONCE).for_each(|(k, columns)| one(k, columns, &mut []));
    }
    out
}
