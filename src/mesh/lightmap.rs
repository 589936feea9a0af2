//! A second set of texture coordinates, for light maps: within 0…1, no two triangles of a model in
//! one place, charts apart by [`PADDING_TEXELS`] in a map of the size that is told.
//!
//! Charts and their places are those of xatlas (Young 2018, after Lévy et al. 2002), which the
//! feature `atlas` builds in. A terrain is a height field: seen from above it is one chart.
//! Limits: vertices on the edge of a chart are doubled; a triangle too small for xatlas to see
//! (1e-11 m²) lies on a point; charts of several thousand twigs are a few texels each.

use glam::Vec2;

use super::Surface;
use crate::diagnostic::{Error, Result};

/// Texels that charts are apart, in a map of the size told.
pub const PADDING_TEXELS: u32 = 2;
/// Times that charts are packed more coarsely for a map to be as small as told, and how much smaller
/// than it should be each is made.
#[cfg(feature = "atlas")]
const PACKINGS: u32 = 6;
#[cfg(feature = "atlas")]
const LOOSER: f32 = 0.97;
/// More triangles than this in one model have no light map: their charts are below a texel.
pub const MOST_TRIANGLES: usize = 300_000;

/// Whether a place is on a map; NaN is not.
pub fn is_on(place: Vec2) -> bool {
    let on = 0.0..=1.0;
    on.contains(&place.x) && on.contains(&place.y)
}

/// Width and height that a light map must have for its charts to stay apart, texels.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Size {
    pub width: u32,
    pub height: u32,
}

/// Lays the triangles of one model, which may have several surfaces, side by side in one map of at most
/// `side_px` texels a side, unless charts of a texel and what is between them take more.
/// Columns grow where charts part a vertex.
///
/// # Errors
/// A model of more than [`MOST_TRIANGLES`]; a program built without the feature `atlas`.
#[cfg(feature = "atlas")]
pub fn unwrap(surfaces: &mut [&mut Surface], side_px: u32) -> Result<Size> {
    use xatlas_rs_v2::{ChartOptions, IndexData, MeshData, MeshDecl, PackOptions, Xatlas};

    let mut surfaces: Vec<&mut Surface> =
        surfaces.iter_mut().map(|s| &mut **s).filter(|s| !s.is_empty()).collect();
    let triangles: usize = surfaces.iter().map(|s| s.triangles()).sum();
    if triangles > MOST_TRIANGLES {
        return Err(Error::new(format!(
            "a model of {triangles} triangles is too fine for a light map"
        ))
        .remedy(format!(
            "give --triangles {MOST_TRIANGLES} or fewer, or leave --lightmap-uv out"
        )));
    }
    if triangles == 0 {
        return Ok(Size { width: 1, height: 1 });
    }
    // In centimetres: xatlas leaves out triangles of less than about 1e-7 square units.
    let places: Vec<Vec<glam::Vec3>> =
        surfaces.iter().map(|s| s.position.iter().map(|p| *p * 100.0).collect()).collect();
    let meshes: Vec<MeshDecl> = surfaces
        .iter()
        .zip(&places)
        .map(|(s, place)| MeshDecl {
            vertex_position_data: MeshData::Contiguous(bytemuck::cast_slice(place)),
            vertex_normal_data: Some(MeshData::Contiguous(bytemuck::cast_slice(&s.normal))),
            index_data: Some(IndexData::U32(&s.index)),
            face_count: s.triangles() as u32,
            ..MeshDecl::default()
        })
        .collect();
    let (size, parted) = {
        let mut atlas = Xatlas::new();
        for mesh in &meshes {
            atlas.add_mesh(mesh).map_err(|e| Error::new(format!("no light map: {e:?}")))?;
        }
        let padding = PADDING_TEXELS;
        atlas.compute_charts(&ChartOptions::default());
        // Its guess first; that knows nothing of padding.
        let guess = PackOptions { padding, resolution: side_px, ..PackOptions::default() };
        atlas.pack_charts(&guess);
        for _ in 0..PACKINGS {
            let side = atlas.width().max(atlas.height());
            if side <= side_px {
                break;
            }
            let smaller = side_px as f32 / side as f32 * LOOSER;
            let texels_per_unit = atlas.texels_per_unit() * smaller;
            let pack = PackOptions { padding, texels_per_unit, ..PackOptions::default() };
            atlas.pack_charts(&pack);
        }
        let size = Size { width: atlas.width().max(1), height: atlas.height().max(1) };
        let texel = Vec2::new(size.width as f32, size.height as f32).recip();
        let at = |uv: [f32; 2]| (Vec2::from_array(uv) * texel).clamp(Vec2::ZERO, Vec2::ONE);
        let parted: Vec<(Vec<u32>, Vec<Placed>)> = atlas
            .meshes()
            .iter()
            .map(|m| {
                let vertices = m.vertex_array.iter().map(|v| (v.xref, at(v.uv)));
                (m.index_array.to_vec(), vertices.collect())
            })
            .collect();
        (size, parted)
    };
    drop(meshes);
    for (surface, (index, vertices)) in surfaces.iter_mut().zip(parted) {
        part(surface, index, &vertices);
    }
    Ok(size)
}

/// As with the feature `atlas`, which this program lacks.
///
/// # Errors
/// Those of [`needed`].
#[cfg(not(feature = "atlas"))]
pub fn unwrap(_: &mut [&mut Surface], _: u32) -> Result<Size> {
    needed()?;
    Ok(Size { width: 1, height: 1 })
}

/// # Errors
/// A program that is built without the feature `atlas`.
pub fn needed() -> Result<()> {
    if cfg!(feature = "atlas") {
        return Ok(());
    }
    Err(Error::new("this program is built without the packer of light maps").remedy(
        "build it with `cargo build --release --features atlas` (needs a C++ compiler and \
         libclang), or leave --lightmap-uv out",
    ))
}

/// One of the old vertices, and its place on the light map.
#[cfg(feature = "atlas")]
type Placed = (u32, Vec2);

/// Gives a surface other vertices.
#[cfg(feature = "atlas")]
fn part(surface: &mut Surface, index: Vec<u32>, vertices: &[Placed]) {
    fn pick<T: Copy>(column: &mut Vec<T>, vertices: &[Placed]) {
        *column = vertices.iter().filter_map(|v| column.get(v.0 as usize).copied()).collect();
    }
    pick(&mut surface.position, vertices);
    pick(&mut surface.normal, vertices);
    pick(&mut surface.uv, vertices);
    pick(&mut surface.wind, vertices);
    surface.lightmap_uv = vertices.iter().map(|v| v.1).collect();
    surface.index = index;
}

/// Gives a height field the light map of its plan, north up.
pub fn lay_flat(surface: &mut Surface) {
    let (lo, hi) = surface.bounds();
    let span = (hi - lo).truncate().max_element().max(1e-6);
    let flat = |p: &glam::Vec3| ((*p - lo).truncate() / span).clamp(Vec2::ZERO, Vec2::ONE);
    surface.lightmap_uv = surface.position.iter().map(flat).collect();
}

#[cfg(all(test, feature = "atlas"))]
mod tests {
    use std::collections::HashMap;

    use super::super::{MeshOptions, TreeMesh, build};
    use super::*;
    use crate::seed::Seed;
    use crate::skeleton::{Detail, Target, grow};
    use crate::species;
    use crate::texture;

    fn tree(name: &str) -> TreeMesh {
        let s = species::load(name).unwrap();
        let atlas = texture::tests::leafy(&s, 64, Seed::new(1)).atlas;
        let target = Target::FromSpecies { height_m: Some(6.0) };
        let skeleton = grow(&s, target, Detail::FOREST, Seed::new(1)).unwrap();
        let options = MeshOptions { triangle_budget: Some(1_500), ..MeshOptions::FOREST };
        build(&skeleton, &s, &atlas, &options, Seed::new(1)).unwrap()
    }

    fn find(root: &mut [u32], mut i: u32) -> u32 {
        while root[i as usize] != i {
            i = root[i as usize];
        }
        i
    }

    #[test]
    fn no_place_of_a_map_is_taken_twice_and_charts_stay_apart() {
        for (name, side_px) in [("betula_pendula", 1024), ("pinus_sylvestris", 2048)] {
            let mut tree = tree(name);
            let before = tree.clone();
            let parts = |t: &mut TreeMesh| unwrap(&mut t.surfaces_mut(), side_px).unwrap();
            let size = parts(&mut tree);
            tree.check().unwrap();
            assert_eq!(tree.triangles(), before.triangles());
            let mut again = before.clone();
            assert_eq!((parts(&mut again), &again), (size, &tree), "the same every time");
            let side = size.width.max(size.height);
            assert!((side_px * 3 / 4..=side_px).contains(&side), "{name}: {side}");
            // Of every texel: the chart whose triangle covers its middle.
            let [w, h] = [size.width as usize, size.height as usize];
            let mut map = vec![u32::MAX; w * h];
            let (mut charts, mut twice, mut covered) = (0, 0, 0);
            for s in tree.woods().into_iter().chain([&tree.foliage]) {
                // What meets in one place of both tree and map is one chart: a bark's seam.
                let mut known = HashMap::new();
                let mut root: Vec<u32> = (0u32..)
                    .zip(s.position.iter().zip(&s.lightmap_uv))
                    .map(|(v, (p, m))| {
                        let place =
                            (p.to_array().map(f32::to_bits), m.to_array().map(f32::to_bits));
                        *known.entry(place).or_insert(v)
                    })
                    .collect();
                for t in s.index.chunks_exact(3) {
                    for k in 1..3 {
                        let (a, b) = (find(&mut root, t[0]), find(&mut root, t[k]));
                        root[b as usize] = a;
                    }
                }
                for t in s.index.chunks_exact(3) {
                    let chart = charts + find(&mut root, t[0]);
                    let texel = Vec2::new(w as f32, h as f32);
                    let [a, b, c] = [0, 1, 2].map(|k| s.lightmap_uv[t[k] as usize] * texel);
                    let (lo, hi) = (a.min(b).min(c).floor(), a.max(b).max(c).ceil());
                    for y in lo.y as usize..(hi.y as usize).min(h) {
                        for x in lo.x as usize..(hi.x as usize).min(w) {
                            let p = Vec2::new(x as f32 + 0.5, y as f32 + 0.5);
                            let side = |a: Vec2, b: Vec2| {
                                (b - a).perp_dot(p - a) / (b - a).length().max(1e-9)
                            };
                            let sides = [side(a, b), side(b, c), side(c, a)];
                            // Inside by a hundredth of a texel, whichever way it is wound.
                            let is_in =
                                sides.iter().all(|d| *d > 0.01) || sides.iter().all(|d| *d < -0.01);
                            if is_in {
                                twice += usize::from(map[y * w + x] != u32::MAX);
                                covered += 1;
                                map[y * w + x] = chart;
                            }
                        }
                    }
                }
                charts += s.position.len() as u32;
            }
            assert_eq!(twice, 0, "{name}: of {covered} texels");
            assert!(covered * 5 > w * h, "{name}: {covered} texels of {w} × {h}");
            let reach = PADDING_TEXELS as usize;
            for (i, &own) in map.iter().enumerate().filter(|(_, c)| **c != u32::MAX) {
                let (x, y) = (i % w, i / w);
                for (nx, ny) in [(x + reach, y), (x, y + reach), (x + 1, y + 1)] {
                    if nx < w && ny < h {
                        let other = map[ny * w + nx];
                        assert!(other == own || other == u32::MAX, "{name}: at {x} {y}");
                    }
                }
            }
        }
    }

    #[test]
    fn too_fine_a_model_is_refused() {
        let mut s = tree("betula_pendula").wood;
        s.index = s.index.repeat(MOST_TRIANGLES / s.triangles() + 1);
        let error = unwrap(&mut [&mut s], 1024).unwrap_err();
        assert!(error.message().contains("too fine for a light map"), "{}", error.message());
    }
}
