//! A validated scene to files. Decides nothing; knows nothing but [`crate::scene`].
//!
//! [`files`] turns a scene into bytes; [`write_all`] puts bytes on disk, all of them or none.

mod disk;
pub mod gltf;
mod pictures;
pub mod usd;

use std::path::PathBuf;

pub use disk::{check_writable, write_all};
pub use pictures::Pictures;

use crate::diagnostic::Result;
use crate::scene::ValidScene;

/// What wrote the file, as the files say it.
const GENERATOR: &str = concat!("Larix ", env!("CARGO_PKG_VERSION"));

/// A file to be written.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct OutputFile {
    /// Relative to the output folder.
    pub path: PathBuf,
    pub bytes: Vec<u8>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Format {
    /// Binary glTF, everything in one file.
    Glb,
    /// glTF with its buffer and textures beside it.
    Gltf,
    /// USD as text, with a layer a model and its textures beside it.
    Usda,
    /// The same as crate files.
    Usdc,
    /// USD with everything in one package.
    Usdz,
}

/// The scene in each format as `STEM.glb`, `STEM.gltf` + `STEM.bin`, `STEM.usda` or `STEM.usdc` +
/// `assets/STEM_MODEL`, `STEM.usdz`, and the textures that these refer to, each once. Formats given twice count once.
pub fn files(scene: &ValidScene, stem: &str, formats: &[Format]) -> Result<Vec<OutputFile>> {
    let pictures = Pictures::encode(scene)?;
    let mut files = Vec::new();
    if formats.contains(&Format::Glb) {
        files.push(gltf::glb(scene, &pictures, stem)?);
    }
    if formats.contains(&Format::Gltf) {
        files.extend(gltf::gltf(scene, stem)?);
    }
    if formats.contains(&Format::Usda) {
        files.extend(usd::layers(scene, stem, usd::Encoding::Text)?);
    }
    if formats.contains(&Format::Usdc) {
        files.extend(usd::layers(scene, stem, usd::Encoding::Crate)?);
    }
    if formats.contains(&Format::Usdz) {
        files.push(usd::usdz(scene, &pictures, stem)?);
    }
    let beside = [Format::Gltf, Format::Usda, Format::Usdc];
    if beside.iter().any(|format| formats.contains(format)) {
        files.extend(pictures.into_files(scene, stem));
    }
    Ok(files)
}

#[cfg(test)]
mod tests;
