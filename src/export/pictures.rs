//! The textures of a scene as PNG, JPEG or WebP, encoded once for all files.

use bytes::Bytes;
use rayon::prelude::*;

use super::OutputFile;
use crate::diagnostic::{Error, Result};
use crate::scene::{Colorspace, Material, Texture, ValidScene};

/// How a picture is coded.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum PictureFormat {
    /// Without loss.
    Png,
    /// Opaque colours and normals with loss that the eye does not see, in a quarter and in half of the
    /// bytes; all else as PNG.
    Jpeg,
    /// Colour with loss that the eye does not see, alpha nearly without; normals and the like at a
    /// higher quality, as their errors light a surface.
    WebP,
}

impl PictureFormat {
    pub fn extension(self) -> &'static str {
        match self {
            PictureFormat::Png => "png",
            PictureFormat::Jpeg => "jpg",
            PictureFormat::WebP => "webp",
        }
    }

    pub fn mime_type(self) -> &'static str {
        match self {
            PictureFormat::Png => "image/png",
            PictureFormat::Jpeg => "image/jpeg",
            PictureFormat::WebP => "image/webp",
        }
    }
}

/// JPEG quality of colours (bark keeps 42 dB) and of normals (2° from those of PNG on average, which
/// stand 30° off the surface).
const JPEG_COLOUR_QUALITY: u8 = 92;
const JPEG_NORMAL_QUALITY: u8 = 95;
/// WebP quality of colours and of everything else.
const COLOUR_QUALITY: f32 = 80.0;
const RAW_QUALITY: f32 = 90.0;

/// Bytes of an earlier run, found by what decides them, or else those that the call gives, which it
/// may keep.
pub type Keeper<'k> = dyn Fn(&[&[u8]], &dyn Fn() -> Result<Bytes>) -> Result<Bytes> + Sync + 'k;

/// One picture for each of [`ValidScene::textures`], in each way of coding that is asked for.
#[derive(Clone)]
pub struct Pictures {
    png: Vec<Bytes>,
    jpeg: Vec<Bytes>,
    webp: Vec<Bytes>,
}

impl Pictures {
    /// # Errors
    /// A picture larger than a format takes.
    pub fn encode(scene: &ValidScene, kinds: &[PictureFormat]) -> Result<Self> {
        Pictures::encode_once(scene, kinds, &|_, encode| encode())
    }

    /// The same, to the byte; what takes long may come from `keeper`.
    ///
    /// # Errors
    /// As [`Pictures::encode`].
    pub fn encode_once(
        scene: &ValidScene,
        kinds: &[PictureFormat],
        keeper: &Keeper<'_>,
    ) -> Result<Self> {
        let all = |kind: PictureFormat| -> Result<Vec<Bytes>> {
            if !kinds.contains(&kind) {
                return Ok(Vec::new());
            }
            let encode =
                |(number, t): (usize, &Texture)| encoded(scene, number as u32, t, kind, keeper);
            scene.textures().par_iter().enumerate().map(encode).collect()
        };
        Ok(Pictures {
            png: all(PictureFormat::Png)?,
            jpeg: all(PictureFormat::Jpeg)?,
            webp: all(PictureFormat::WebP)?,
        })
    }

    /// Another picture, coded as the texture of this number is.
    ///
    /// # Errors
    /// As [`Pictures::encode`].
    pub(super) fn encoded(
        &self,
        scene: &ValidScene,
        number: u32,
        texture: &Texture,
        kind: PictureFormat,
    ) -> Result<Bytes> {
        // Nor are others PNG.
        let kind = self.format_of(number, kind);
        encoded(scene, number, texture, kind, &|_, encode| encode())
    }

    /// The same but for the textures of these numbers.
    pub(super) fn with(&self, kind: PictureFormat, others: Vec<(u32, Bytes)>) -> Self {
        let mut pictures = self.clone();
        let all = match kind {
            PictureFormat::Png => &mut pictures.png,
            PictureFormat::Jpeg => &mut pictures.jpeg,
            PictureFormat::WebP => &mut pictures.webp,
        };
        for (number, bytes) in others {
            if let Some(of_number) = all.get_mut(number as usize) {
                *of_number = bytes;
            }
        }
        pictures
    }

    /// Of the scene's texture of this number; empty where this way of coding was not asked for.
    pub fn of(&self, texture: u32, kind: PictureFormat) -> Bytes {
        let all = match kind {
            PictureFormat::Png => &self.png,
            PictureFormat::Jpeg => &self.jpeg,
            PictureFormat::WebP => &self.webp,
        };
        all.get(texture as usize).cloned().unwrap_or_default()
    }

    /// What [`Pictures::of`] gives where this way of coding is asked for.
    pub fn format_of(&self, texture: u32, kind: PictureFormat) -> PictureFormat {
        match kind {
            PictureFormat::Jpeg if !self.of(texture, kind).starts_with(JPEG_START) => {
                PictureFormat::Png
            }
            kind => kind,
        }
    }

    /// `textures/STEM_NAME.png`, as the other files refer to them.
    pub fn files<'a>(
        &'a self,
        scene: &'a ValidScene,
        stem: &'a str,
        kind: PictureFormat,
    ) -> impl Iterator<Item = OutputFile<'a>> {
        (0u32..).zip(scene.textures()).map(move |(number, texture)| {
            let path = texture_path(stem, &texture.name, self.format_of(number, kind));
            OutputFile::new(path, self.of(number, kind))
        })
    }
}

fn encoded(
    scene: &ValidScene,
    number: u32,
    texture: &Texture,
    kind: PictureFormat,
    keeper: &Keeper<'_>,
) -> Result<Bytes> {
    match kind {
        PictureFormat::Png => texture.image.png(),
        PictureFormat::Jpeg => match jpeg_quality(scene, number, texture) {
            Some(quality) => jpeg(texture, quality, keeper),
            None => texture.image.png(),
        },
        PictureFormat::WebP => webp(texture, keeper),
    }
}

const JPEG_START: &[u8] = &[0xFF, 0xD8];

/// None for what stays PNG: what shows through, and masks, which chroma would bleed into.
fn jpeg_quality(scene: &ValidScene, number: u32, texture: &Texture) -> Option<u8> {
    let image = &texture.image;
    let longest = image.width().max(image.height());
    if longest > crate::raster::MOST_JPEG_PX || !image.is_opaque() {
        return None;
    }
    let is_normal = |m: &Material| m.normal_texture == Some(number);
    match texture.colorspace {
        Colorspace::Srgb => Some(JPEG_COLOUR_QUALITY),
        Colorspace::Raw => scene.materials().iter().any(is_normal).then_some(JPEG_NORMAL_QUALITY),
    }
}

fn jpeg(texture: &Texture, quality: u8, keeper: &Keeper<'_>) -> Result<Bytes> {
    /// To be raised with every change of the coder or of how it is called.
    const CODER: &[u8] = b"jpeg 1";
    let encode = || {
        crate::raster::jpeg(texture.image.picture(), quality)
            .map_err(|e| Error::new(format!("texture `{}`: {e}", texture.name)))
    };
    kept(texture, CODER, &[quality], keeper, &encode)
}

fn kept(
    texture: &Texture,
    coder: &[u8],
    quality: &[u8],
    keeper: &Keeper<'_>,
    encode: &dyn Fn() -> Result<Bytes>,
) -> Result<Bytes> {
    match texture.image.known_png() {
        Some(png) => keeper(&[coder, quality, png], encode),
        // Drawn for this scene alone.
        None => encode(),
    }
}

fn webp(texture: &Texture, keeper: &Keeper<'_>) -> Result<Bytes> {
    /// To be raised with every change of the coder or of how it is called.
    const CODER: &[u8] = b"webp 1";
    let quality = match texture.colorspace {
        Colorspace::Srgb => COLOUR_QUALITY,
        Colorspace::Raw => RAW_QUALITY,
    };
    let encode = || {
        crate::raster::webp(texture.image.picture(), quality)
            .map_err(|e| Error::new(format!("texture `{}`: {e}", texture.name)))
    };
    kept(texture, CODER, &quality.to_le_bytes(), keeper, &encode)
}

/// `textures/STEM_NAME.png`: the stem keeps scenes in one folder apart.
pub(super) fn texture_path(stem: &str, name: &str, kind: PictureFormat) -> String {
    format!("textures/{}_{name}.{}", plain(stem), kind.extension())
}

/// Characters of the stem that mean something to a format or a file system as `_`.
pub(super) fn plain(stem: &str) -> String {
    let plain = |c: char| if c.is_alphanumeric() || "-_.".contains(c) { c } else { '_' };
    stem.chars().map(plain).collect()
}
