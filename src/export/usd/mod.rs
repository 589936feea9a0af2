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

use std::io::{self, Seek, SeekFrom, Write};

use self::layer::Layer;
use self::material::TexturePaths;
use self::package::Package;
use super::pictures::{plain, texture_path};
use super::{Content, OutputFile, PictureFormat, Pictures};
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
/// [`Pictures::files`].
pub fn layers<'a>(scene: &'a ValidScene, stem: &'a str, encoding: Encoding) -> Vec<OutputFile<'a>> {
    let extension = encoding.extension();
    let asset = move |name: &str| format!("assets/{}_{name}.{extension}", plain(stem));
    let is_one_layer = scene.instances().len() <= 1 && scene.terrain().is_none();
    let root = Content::stream(move |sink| {
        let textures = TexturePaths { folder: "", stem };
        let asset: Option<&dyn Fn(&str) -> String> = if is_one_layer { None } else { Some(&asset) };
        write(&stage::scene_layer(scene, &textures, asset), encoding, sink)
    });
    let mut files = vec![OutputFile { path: format!("{stem}.{extension}").into(), content: root }];
    if !is_one_layer {
        files.extend((0u32..).zip(scene.prototypes()).map(|(index, prototype)| {
            let content = Content::stream(move |sink| {
                let textures = TexturePaths { folder: "../", stem };
                write(&stage::prototype_layer(scene, index, &textures), encoding, sink)
            });
            OutputFile { path: asset(&prototype.name).into(), content }
        }));
    }
    files
}

/// `STEM.usdz` with everything in it.
pub fn package<'a>(scene: &'a ValidScene, pictures: &'a Pictures, stem: &'a str) -> OutputFile<'a> {
    let content = Content::stream(move |sink| {
        let layer = stage::scene_layer(scene, &TexturePaths { folder: "", stem }, None);
        let mut package = Package::new(sink);
        package.add_written(&format!("{}.usdc", plain(stem)), usdc::HEAD, |body| {
            usdc::write(&layer, body)
        })?;
        for (number, texture) in (0..).zip(scene.textures()) {
            let png = pictures.of(number, PictureFormat::Png);
            package.add(&texture_path(stem, &texture.name, PictureFormat::Png), &png)?;
        }
        package.finish()
    });
    OutputFile { path: format!("{stem}.usdz").into(), content }
}

fn write(layer: &Layer, encoding: Encoding, mut out: impl Write + Seek) -> io::Result<()> {
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
