//! OpenUSD: text (.usda), crate files (.usdc) and packages (.usdz) of the same scene.
//!
//! `/SCENE` holds `terrain` with its material, and under `trees` one PointInstancer a species, or
//! one a cell where there are many trees. Its prototypes are payloads, one layer each, which hold
//! surfaces, coarser forms, colliders and materials (UsdPreviewSurface); a package and a single
//! tree hold everything in one layer. Z up, metres, as the scene.

mod layer;
mod material;
mod package;
mod prototype;
mod stage;
#[cfg(test)]
mod tests;
mod usda;
mod usdc;

use std::io::{self, SeekFrom};

use self::layer::Layer;
use self::material::TexturePaths;
use self::package::{Nowhere, Package};
use super::pictures::{plain, texture_path};
use super::{Content, OutputFile, PictureFormat, Pictures, Sink};
use crate::diagnostic::{Error, Result};
use crate::mesh::Surface;
use crate::scene::{Material, ValidScene};

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
///
/// # Errors
/// More than a package holds.
pub fn package<'a>(
    scene: &'a ValidScene,
    pictures: &'a Pictures,
    stem: &'a str,
) -> Result<OutputFile<'a>> {
    package_within(scene, pictures, stem, package::MOST_BYTES)
}

fn package_within<'a>(
    scene: &'a ValidScene,
    pictures: &'a Pictures,
    stem: &'a str,
    most_bytes: u64,
) -> Result<OutputFile<'a>> {
    let path = format!("{stem}.usdz");
    let write = move |sink: &mut dyn Sink| write_package(scene, pictures, stem, most_bytes, sink);
    // Only what might be too large is encoded twice.
    let bytes = bytes_at_most(scene, pictures);
    if bytes > most_bytes && write(&mut Nowhere::default()).is_err() {
        return Err(Error::new(format!(
            "needs up to {:.1} GiB, and a package holds less than {:.0}",
            bytes as f64 / GIB,
            most_bytes as f64 / GIB
        ))
        .in_file(path)
        .remedy(
            "write --format usdc, whose files have no such limit, or ask for fewer --triangles",
        ));
    }
    Ok(OutputFile { path: path.into(), content: Content::stream(write) })
}

const GIB: f64 = (1u64 << 30) as f64;

/// More than a package of this takes.
fn bytes_at_most(scene: &ValidScene, pictures: &Pictures) -> u64 {
    /// Every column that there is.
    const VERTEX: u64 = 64;
    const CORNER: u64 = 8;
    const TREE: u64 = 512;
    const PLACE: u64 = 64;
    /// Names, materials, tables.
    const REST: u64 = 1 << 20;
    let surfaces = scene.prototypes().iter().flat_map(|p| p.all_parts());
    let surfaces = surfaces.chain(scene.terrain()).map(|part| &part.surface);
    let bodies = scene.colliders().map(|collider| &collider.body);
    // The coarsest form stands in a variant and as the proxy.
    let of = |s: &Surface| 2 * (VERTEX * s.position.len() as u64 + CORNER * s.index.len() as u64);
    let trees = scene.instances().iter().map(|tree| TREE + tree.facts.id.len() as u64);
    let textures = (0..).zip(scene.textures());
    let textures = textures.map(|(k, _)| REST + pictures.of(k, PictureFormat::Png).len() as u64);
    let reliefs = scene.materials().iter().filter_map(|m| m.relief.as_ref());
    let reliefs =
        reliefs.map(|r| REST + 4 * u64::from(r.image.width()) * u64::from(r.image.height()));
    let scattered = scene.prototypes().iter().flat_map(|p| &p.scattered);
    let scattered = scattered.map(|s| PLACE * s.places.len() as u64);
    surfaces
        .chain(bodies)
        .map(of)
        .chain(scattered)
        .chain(trees)
        .chain(textures)
        .chain(reliefs)
        .sum::<u64>()
        + REST
}

fn write_package(
    scene: &ValidScene,
    pictures: &Pictures,
    stem: &str,
    most_bytes: u64,
    sink: &mut dyn Sink,
) -> io::Result<()> {
    let layer = stage::scene_layer(scene, &TexturePaths { folder: "", stem }, None);
    let mut package = Package::new(sink, most_bytes);
    package.add_written(&format!("{}.usdc", plain(stem)), usdc::HEAD, |body| {
        usdc::write(&layer, body)
    })?;
    for (number, texture) in (0..).zip(scene.textures()) {
        let png = pictures.of(number, PictureFormat::Png);
        package.add(&texture_path(stem, &texture.name, PictureFormat::Png), &png)?;
    }
    for (name, relief) in scene.materials().iter().filter_map(Material::relief) {
        let png = relief.image.png().map_err(io::Error::other)?;
        package.add(&texture_path(stem, &name, PictureFormat::Png), &png)?;
    }
    package.finish()
}

fn write(layer: &Layer, encoding: Encoding, out: &mut dyn Sink) -> io::Result<()> {
    match encoding {
        Encoding::Text => usda::write(layer, out),
        Encoding::Crate => {
            out.write_all(&[0; usdc::HEAD])?;
            let head = usdc::write(layer, &mut *out)?;
            out.seek(SeekFrom::Start(0))?;
            out.write_all(&head)?;
            out.flush()
        }
    }
}
