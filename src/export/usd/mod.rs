//! OpenUSD: text (.usda), crate files (.usdc) and packages (.usdz) of the same scene.
//!
//! `/SCENE` holds `terrain` with its material, and under `trees` one PointInstancer a species, or
//! one a cell where there are many trees. Its prototypes are payloads, one layer each, which hold
//! surfaces, coarser forms, colliders and materials (UsdPreviewSurface); a package and a single
//! tree hold everything in one layer. Z up, metres, as the scene.

mod coding;
mod layer;
mod material;
mod package;
mod prototype;
mod stage;
#[cfg(test)]
mod tests;
mod usda;
mod usdc;

use std::io::{self, Cursor, Seek, SeekFrom, Write};

use self::layer::Layer;
use self::material::TexturePaths;
use self::package::Package;
use super::pictures::{plain, texture_path};
use super::{OutputFile, Pictures};
use crate::diagnostic::{Error, Result};
use crate::scene::ValidScene;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Encoding {
    Text,
    Crate,
}

impl Encoding {
    fn extension(self) -> &'static str {
        match self {
            Encoding::Text => "usda",
            Encoding::Crate => "usdc",
        }
    }
}

/// `STEM.usda` or `STEM.usdc`, and `assets/STEM_PROTOTYPE` of the same kind; the textures are
/// [`Pictures::into_files`].
pub fn layers(scene: &ValidScene, stem: &str, encoding: Encoding) -> Result<Vec<OutputFile>> {
    let extension = encoding.extension();
    let file = |path: String, layer: &Layer| -> Result<OutputFile> {
        let mut out = Cursor::new(Vec::new());
        write(layer, encoding, &mut out).map_err(|e| Error::new(e.to_string()))?;
        Ok(OutputFile { path: path.into(), bytes: out.into_inner() })
    };
    let asset = |name: &str| format!("assets/{}_{name}.{extension}", plain(stem));
    let path = format!("{stem}.{extension}");
    let textures = TexturePaths { folder: "", stem };
    if scene.instances().len() <= 1 && scene.terrain().is_none() {
        return Ok(vec![file(path, &stage::scene_layer(scene, &textures, None))?]);
    }
    let mut files = vec![file(path, &stage::scene_layer(scene, &textures, Some(&asset)))?];
    let textures = TexturePaths { folder: "../", stem };
    for (index, prototype) in (0..).zip(scene.prototypes()) {
        let layer = stage::prototype_layer(scene, index, &textures);
        files.push(file(asset(&prototype.name), &layer)?);
    }
    Ok(files)
}

/// `STEM.usdz` with everything in it.
pub fn usdz(scene: &ValidScene, pictures: &Pictures, stem: &str) -> Result<OutputFile> {
    let mut out = Cursor::new(Vec::new());
    write_package(scene, pictures, stem, &mut out).map_err(|e| Error::new(e.to_string()))?;
    Ok(OutputFile { path: format!("{stem}.usdz").into(), bytes: out.into_inner() })
}

fn write<W: Write + Seek>(layer: &Layer, encoding: Encoding, mut out: W) -> io::Result<()> {
    match encoding {
        Encoding::Text => usda::write(layer, out),
        Encoding::Crate => {
            out.write_all(&[0; usdc::HEAD])?;
            let head = usdc::write(layer, &mut out)?;
            out.seek(SeekFrom::Start(0))?;
            out.write_all(&head)?;
            out.flush()
        }
    }
}

fn write_package<W: Write + Seek>(
    scene: &ValidScene,
    pictures: &Pictures,
    stem: &str,
    out: W,
) -> io::Result<()> {
    let textures = TexturePaths { folder: "", stem };
    let layer = stage::scene_layer(scene, &textures, None);
    let mut package = Package::new(out);
    package.add_written(&format!("{}.usdc", plain(stem)), usdc::HEAD, |body| {
        usdc::write(&layer, body)
    })?;
    for (texture, png) in scene.textures().iter().zip(pictures.png()) {
        package.add(&texture_path(stem, &texture.name), png)?;
    }
    package.finish()
}
