//! glTF 2.0 (Khronos, ISO/IEC 12113:2022), as GLB and as .gltf + .bin + textures.
//!
//! The profile is the one every importer reads: no extension but that for variants of materials
//! where there are any, one mesh a prototype, and one node a tree that shares it. Y up is made here and nowhere else: the vertices themselves are turned,
//! (x, y, z) → (x, z, −y), a rotation by −90° about X, so no node needs a correcting turn.
//!
//! Parts with a normal map carry tangents. Limit: a GLB holds less than 4 GiB, for its lengths
//! are 32-bit.

mod buffer;
mod document;
mod tangent;
mod variants;

use glam::Vec3;

use self::buffer::Layout;
use super::{OutputFile, Pictures};
use crate::diagnostic::{Error, Result};
use crate::scene::ValidScene;

/// `STEM.glb`.
pub fn glb(scene: &ValidScene, pictures: &Pictures, stem: &str) -> Result<OutputFile> {
    let layout = Layout::new(scene, Some(pictures));
    let mut json = serialized(serde_json::to_vec(&document::embedded(scene, &layout)))?;
    json.resize(json.len().next_multiple_of(4), b' ');

    let header = chunk_lengths(json.len() as u64, layout.bytes())
        .ok_or_else(|| too_large(layout.bytes(), stem))?;
    let mut bytes = Vec::with_capacity(header.total as usize);
    bytes.extend(b"glTF");
    bytes.extend(2u32.to_le_bytes());
    bytes.extend(header.total.to_le_bytes());
    bytes.extend(header.json.to_le_bytes());
    bytes.extend(b"JSON");
    bytes.extend(json);
    bytes.extend(header.binary.to_le_bytes());
    bytes.extend(b"BIN\0");
    layout.write(scene, Some(pictures), &mut bytes);
    Ok(OutputFile { path: format!("{stem}.glb").into(), bytes })
}

/// `STEM.gltf` and `STEM.bin`; the textures are [`Pictures::into_files`].
pub fn gltf(scene: &ValidScene, stem: &str) -> Result<[OutputFile; 2]> {
    let layout = Layout::new(scene, None);
    let mut json = serialized(serde_json::to_vec_pretty(&document::beside(scene, &layout, stem)))?;
    json.push(b'\n');
    let mut bytes = Vec::new();
    layout.write(scene, None, &mut bytes);
    Ok([
        OutputFile { path: format!("{stem}.gltf").into(), bytes: json },
        OutputFile { path: format!("{stem}.bin").into(), bytes },
    ])
}

fn serialized(json: serde_json::Result<Vec<u8>>) -> Result<Vec<u8>> {
    json.map_err(|e| Error::new(format!("the glTF description could not be written: {e}")))
}

/// Scene metres to glTF's Y up. `0 − y` rather than `−y`, so that 0 stays without a sign.
fn y_up(p: Vec3) -> [f32; 3] {
    [p.x, p.z, 0.0 - p.y]
}

struct ChunkLengths {
    total: u32,
    json: u32,
    binary: u32,
}

/// `None` where the file would not fit its own 32-bit lengths. Both are multiples of 4.
fn chunk_lengths(json: u64, binary: u64) -> Option<ChunkLengths> {
    const HEADERS: u64 = 12 + 8 + 8;
    Some(ChunkLengths {
        total: u32::try_from(HEADERS + json + binary).ok()?,
        json: u32::try_from(json).ok()?,
        binary: u32::try_from(binary).ok()?,
    })
}

fn too_large(binary: u64, stem: &str) -> Error {
    let gib = binary as f64 / (1u64 << 30) as f64;
    Error::new(format!("the scene needs {gib:.1} GiB, and a GLB file holds less than 4"))
        .in_file(format!("{stem}.glb"))
        .remedy("share models between trees (--unique 5), or write --format gltf or usda")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_over_4_gib_is_refused_and_one_just_below_is_not() {
        let most = u64::from(u32::MAX) - 28 - 1000;
        assert_eq!(chunk_lengths(1000, most).map(|l| l.total), Some(u32::MAX));
        assert!(chunk_lengths(1000, most + 1).is_none());
        let error = too_large(5 << 30, "forest");
        assert_eq!(
            format!("{error:?}"),
            "forest.glb: the scene needs 5.0 GiB, and a GLB file holds less than 4 (remedy: \
             share models between trees (--unique 5), or write --format gltf or usda)"
        );
    }

    #[test]
    fn y_up_is_a_turn_that_keeps_hands() {
        let [x, y, z] = [Vec3::X, Vec3::Y, Vec3::Z].map(|p| Vec3::from(y_up(p)));
        assert_eq!((x, y, z), (Vec3::X, -Vec3::Z, Vec3::Y));
        assert_eq!(x.cross(y), z);
    }
}
