//! Columns made small by meshoptimizer's codecs, as EXT_meshopt_compression has them: attributes in
//! version 0, triangles in version 1. Without loss.

use std::fmt::Display;

use glam::{I64Vec3, Vec3};
use meshopt::{encode_index_buffer, encode_vertex_buffer_level, optimize_vertex_cache};

use super::quantize::Grid;
use crate::diagnostic::{Error, Result};
use crate::mesh::Surface;

/// Bytes that a decoder turns back into `count` elements of `stride`.
pub(super) struct Encoded {
    pub bytes: Vec<u8>,
    pub stride: usize,
    pub count: usize,
    pub mode: &'static str,
}

/// The surface with triangles and vertices in the order in which a graphics card draws them
/// fastest, which is also the order that compresses best; without the triangles that have no area in `grid`.
pub(super) fn ordered(surface: &Surface, grid: Option<Grid>) -> Surface {
    const UNSEEN: u32 = u32::MAX;
    /// Triangles from which on the order they were made in stays: finding the best would take most of
    /// the time, and save a larch of 900,000 triangles 1.2 % of its bytes.
    const MANY: usize = 1 << 16;
    let vertices = surface.position.len();
    let mut index = match grid {
        Some(grid) => with_area(surface, grid),
        None => surface.index.clone(),
    };
    if index.len() < 3 * MANY {
        index = optimize_vertex_cache(&index, vertices);
    }
    // Vertices in the order of their first use; those of no triangle go.
    let mut moved = vec![UNSEEN; vertices];
    let mut from = Vec::with_capacity(vertices);
    for i in &mut index {
        let to = &mut moved[*i as usize];
        if *to == UNSEEN {
            *to = from.len() as u32;
            from.push(*i);
        }
        *i = *to;
    }
    fn gather<T: Copy>(from: &[u32], column: &[T]) -> Vec<T> {
        if column.is_empty() {
            return Vec::new();
        }
        from.iter().map(|&old| column[old as usize]).collect()
    }
    Surface {
        position: gather(&from, &surface.position),
        normal: gather(&from, &surface.normal),
        uv: gather(&from, &surface.uv),
        wind: gather(&from, &surface.wind),
        lightmap_uv: gather(&from, &surface.lightmap_uv),
        index,
    }
}

/// The triangles that have an area where positions are counted in a grid; all if none has.
fn with_area(surface: &Surface, grid: Grid) -> Vec<u32> {
    let place = |&p: &Vec3| I64Vec3::from_array(grid.count(p).map(i64::from));
    let places: Vec<I64Vec3> = surface.position.iter().map(place).collect();
    let has_area = |t: &&[u32; 3]| {
        let [a, b, c] = t.map(|i| places[i as usize]);
        (b - a).cross(c - a) != I64Vec3::ZERO
    };
    let kept: Vec<u32> =
        surface.index.as_chunks::<3>().0.iter().filter(has_area).flatten().copied().collect();
    if kept.is_empty() { surface.index.clone() } else { kept }
}

/// Elements of 4, 8, 12 or 16 bytes.
pub(super) fn attributes(raw: &[u8], stride: usize) -> Result<Encoded> {
    fn encode<const N: usize>(raw: &[u8]) -> meshopt::Result<Vec<u8>> {
        /// Means nothing in version 0.
        const LEVEL: i32 = 2;
        let (elements, _) = raw.as_chunks::<N>();
        encode_vertex_buffer_level(elements, LEVEL, Some(0))
    }
    let bytes = match stride {
        4 => encode::<4>(raw),
        8 => encode::<8>(raw),
        12 => encode::<12>(raw),
        16 => encode::<16>(raw),
        _ => return Err(refused(&format!("elements of {stride} bytes"))),
    };
    let bytes = bytes.map_err(|e| refused(&e))?;
    Ok(Encoded { bytes, stride, count: raw.len() / stride, mode: "ATTRIBUTES" })
}

/// Indices of 2 or 4 bytes, three a triangle. A decoder may begin a triangle at another corner.
pub(super) fn triangles(raw: &[u8], stride: usize) -> Result<Encoded> {
    let index: Vec<u32> = match stride {
        2 => raw.as_chunks().0.iter().map(|&b| u32::from(u16::from_le_bytes(b))).collect(),
        _ => raw.as_chunks().0.iter().map(|&b| u32::from_le_bytes(b)).collect(),
    };
    let vertices = index.iter().max().map_or(0, |&i| i as usize + 1);
    let bytes = encode_index_buffer(&index, vertices).map_err(|e| refused(&e))?;
    Ok(Encoded { bytes, stride, count: index.len(), mode: "TRIANGLES" })
}

pub(super) fn refused(why: &dyn Display) -> Error {
    Error::new(format!("the geometry could not be compressed: {why}"))
        .remedy("choose --profile dcc or engine, and report this with the command that led here")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::sample::forest;

    fn corners(surface: &Surface) -> Vec<[[u32; 8]; 3]> {
        let corner = |&i: &u32| {
            let i = i as usize;
            let (p, n, uv) = (surface.position[i], surface.normal[i], surface.uv[i]);
            [p.x, p.y, p.z, n.x, n.y, n.z, uv.x, uv.y].map(f32::to_bits)
        };
        let triangle = |t: &[u32]| {
            let mut corners = [corner(&t[0]), corner(&t[1]), corner(&t[2])];
            // The same triangle, begun at its least corner.
            let least = (0..3).min_by_key(|&k| corners[k]).unwrap_or(0);
            corners.rotate_left(least);
            corners
        };
        let mut all: Vec<_> = surface.index.chunks_exact(3).map(triangle).collect();
        all.sort_unstable();
        all
    }

    #[test]
    fn ordering_keeps_every_triangle_as_it_was() {
        let scene = forest(&["Larix"], 2, 60.0);
        for part in scene.prototypes.iter().flat_map(|p| &p.parts).chain(&scene.terrain) {
            assert!(
                corners(&part.surface) == corners(&ordered(&part.surface, None)),
                "{}",
                part.name
            );
        }
        // Vertices that no triangle uses.
        let mut part = scene.prototypes[0].parts[0].surface.clone();
        part.index.drain(..part.index.len() / 2);
        let kept = ordered(&part, None);
        assert!(corners(&part) == corners(&kept));
        assert!(kept.position.len() < part.position.len());
    }

    #[test]
    fn triangles_thinner_than_a_step_go() {
        let corners = [[0.0, 0.0], [0.5, 0.0], [0.5, 0.5], [1e-6, 1e-6], [0.0, 0.5]];
        let surface = Surface {
            position: corners.map(|[x, y]| Vec3::new(x, y, 0.0)).to_vec(),
            index: vec![0, 1, 2, 0, 1, 3, 0, 3, 4, 0, 2, 4],
            ..Surface::default()
        };
        let whole = |surface: &Surface| ordered(surface, None).triangles();
        let grid = Grid::about_origin([&surface].into_iter());
        assert_eq!((whole(&surface), ordered(&surface, Some(grid)).triangles()), (4, 2));
        // Nothing at all would be no mesh.
        let flat = Surface { index: vec![0, 1, 3, 0, 3, 4], ..surface };
        assert_eq!(ordered(&flat, Some(grid)).triangles(), 2);
    }

    #[test]
    fn codecs_read_back() {
        let scene = forest(&["Larix"], 1, 100.0);
        let surface = ordered(&scene.terrain.unwrap().surface, None);
        let raw: Vec<u8> = surface
            .position
            .iter()
            .flat_map(|p| p.to_array().map(f32::to_le_bytes))
            .flatten()
            .collect();
        let encoded = attributes(&raw, 12).unwrap();
        assert_eq!(encoded.bytes[0], 0xa0, "version 0");
        let decoded: Vec<[u8; 12]> =
            meshopt::decode_vertex_buffer(&encoded.bytes, encoded.count).unwrap();
        assert!(decoded.as_flattened() == raw);

        let raw: Vec<u8> = surface.index.iter().flat_map(|i| i.to_le_bytes()).collect();
        let encoded = triangles(&raw, 4).unwrap();
        assert_eq!(encoded.bytes[0], 0xe1, "version 1");
        let index: Vec<u32> = meshopt::decode_index_buffer(&encoded.bytes, encoded.count).unwrap();
        assert!(corners(&Surface { index, ..surface.clone() }) == corners(&surface));
        assert!(encoded.bytes.len() < raw.len() / 8, "{} of {}", encoded.bytes.len(), raw.len());
    }
}
