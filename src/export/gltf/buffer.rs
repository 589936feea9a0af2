//! The binary buffer: where everything lies, then the bytes, in one pass and without copies.
//!
//! All positions, then all normals, texture coordinates, tangents, indices, then pictures: a
//! handful of buffer views however many prototypes there are.

use std::ops::Range;

use super::super::Pictures;
use super::tangent::tangents;
use super::y_up;
use crate::mesh::Surface;
use crate::scene::{Part, ValidScene};

pub(super) const POSITION_BYTES: u64 = 12;
pub(super) const NORMAL_BYTES: u64 = 12;
pub(super) const UV_BYTES: u64 = 8;
pub(super) const TANGENT_BYTES: u64 = 16;
pub(super) const WIND_BYTES: u64 = 4;

/// Indices of 16 bits reach so many vertices: the highest value is reserved.
const MOST_SHORT_VERTICES: usize = u16::MAX as usize;

/// Whether the surface's indices fit in 16 bits.
pub(super) fn has_short_indices(surface: &Surface) -> bool {
    surface.position.len() <= MOST_SHORT_VERTICES
}

/// Whether the part's material needs tangents.
pub(super) fn has_tangents(scene: &ValidScene, part: &Part) -> bool {
    scene.materials()[part.material as usize].normal_texture.is_some()
}

/// Whether the surface says how it moves in the wind.
pub(super) fn has_wind(surface: &Surface) -> bool {
    !surface.wind.is_empty()
}

/// Byte ranges in the buffer; each starts at a multiple of 4.
pub(super) struct Layout {
    pub positions: Range<u64>,
    pub normals: Range<u64>,
    pub uvs: Range<u64>,
    /// Empty if no part needs them; so the next three.
    pub tangents: Range<u64>,
    pub winds: Range<u64>,
    pub long_indices: Range<u64>,
    pub short_indices: Range<u64>,
    /// One a texture; none where pictures are files of their own.
    pub pictures: Vec<Range<u64>>,
}

impl Layout {
    pub fn new(scene: &ValidScene, pictures: Option<&Pictures>) -> Self {
        let surfaces = || scene.parts().map(|p| &p.surface);
        let vertices: u64 = surfaces().map(|s| s.position.len() as u64).sum();
        let indices = |short: bool| -> u64 {
            let chosen = surfaces().filter(|s| has_short_indices(s) == short);
            chosen.map(|s| s.index.len() as u64).sum()
        };
        let bumpy = scene.parts().filter(|p| has_tangents(scene, p));
        let bumpy_vertices: u64 = bumpy.map(|p| p.surface.position.len() as u64).sum();
        let winds: u64 = surfaces().map(|s| s.wind.len() as u64).sum();
        let bodies = || scene.colliders().map(|c| &c.body);
        let body_vertices: u64 = bodies().map(|b| b.position.len() as u64).sum();
        let body_indices: u64 = bodies().map(|b| b.index.len() as u64).sum();
        let mut end = 0u64;
        let mut take = |bytes: u64| {
            let start = end.next_multiple_of(4);
            end = start + bytes;
            start..end
        };
        Layout {
            positions: take((vertices + body_vertices) * POSITION_BYTES),
            normals: take(vertices * NORMAL_BYTES),
            uvs: take(vertices * UV_BYTES),
            tangents: take(bumpy_vertices * TANGENT_BYTES),
            winds: take(winds * WIND_BYTES),
            long_indices: take(indices(false) * 4),
            short_indices: take((indices(true) + body_indices) * 2),
            pictures: pictures
                .map_or(Vec::new(), |p| p.png().iter().map(|png| take(png.len() as u64)).collect()),
        }
    }

    /// Length of the buffer, a multiple of 4.
    pub fn bytes(&self) -> u64 {
        let end = self.pictures.last().map_or(self.short_indices.end, |p| p.end);
        end.next_multiple_of(4)
    }

    /// Appends the buffer.
    pub fn write(&self, scene: &ValidScene, pictures: Option<&Pictures>, out: &mut Vec<u8>) {
        let start = out.len();
        out.reserve_exact(self.bytes() as usize);
        let surfaces = || scene.parts().map(|p| &p.surface);
        let bodies = || scene.colliders().map(|c| &c.body);
        for surface in surfaces().chain(bodies()) {
            for &p in &surface.position {
                push(out, y_up(p));
            }
        }
        for surface in surfaces() {
            for &n in &surface.normal {
                push(out, y_up(n));
            }
        }
        for surface in surfaces() {
            // v = 0 is the bottom of the picture in the scene, the top in glTF.
            for uv in &surface.uv {
                push(out, [uv.x, 1.0 - uv.y]);
            }
        }
        for part in scene.parts().filter(|p| has_tangents(scene, p)) {
            for tangent in tangents(&part.surface) {
                let [x, y, z] = y_up(tangent.truncate());
                push(out, [x, y, z, tangent.w]);
            }
        }
        for surface in surfaces() {
            out.extend_from_slice(surface.wind.as_flattened());
        }
        for surface in surfaces().filter(|s| !has_short_indices(s)) {
            for &i in &surface.index {
                out.extend_from_slice(&i.to_le_bytes());
            }
        }
        // A collider has few vertices.
        for surface in surfaces().filter(|s| has_short_indices(s)).chain(bodies()) {
            for &i in &surface.index {
                out.extend_from_slice(&(i as u16).to_le_bytes());
            }
        }
        for png in pictures.map_or(&[][..], Pictures::png) {
            pad(out, start);
            out.extend_from_slice(png);
        }
        pad(out, start);
    }
}

fn push<const N: usize>(out: &mut Vec<u8>, values: [f32; N]) {
    for value in values {
        out.extend_from_slice(&value.to_le_bytes());
    }
}

fn pad(out: &mut Vec<u8>, start: usize) {
    let length = (out.len() - start).next_multiple_of(4);
    out.resize(start + length, 0);
}
