//! The textures of a scene as PNG or WebP, encoded once for all files.

use bytes::Bytes;
use rayon::prelude::*;

use super::OutputFile;
use crate::diagnostic::{Error, Result};
use crate::scene::{Colorspace, Texture, ValidScene};

/// How a picture is coded.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum PictureFormat {
    /// Without loss.
    Png,
    /// Colour with loss that the eye does not see, alpha nearly without; normals and the like at a
    /// higher quality, as their errors light a surface.
    WebP,
}

impl PictureFormat {
    pub fn extension(self) -> &'static str {
        match self {
            PictureFormat::Png => "png",
            PictureFormat::WebP => "webp",
        }
    }

    pub fn mime_type(self) -> &'static str {
        match self {
            PictureFormat::Png => "image/png",
            PictureFormat::WebP => "image/webp",
        }
    }
}

/// WebP quality of colours and of everything else.
const COLOUR_QUALITY: f32 = 80.0;
const RAW_QUALITY: f32 = 90.0;

/// Bytes of an earlier run, found by what decides them, or else those that the call gives, which it
/// may keep.
pub type Keeper<'k> = dyn Fn(&[&[u8]], &dyn Fn() -> Result<Bytes>) -> Result<Bytes> + Sync + 'k;

/// One picture for each of [`ValidScene::textures`], in each way of coding that is asked for.
pub struct Pictures {
    png: Vec<Bytes>,
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
            let encode = |t: &Texture| match kind {
                PictureFormat::Png => t.image.png(),
                PictureFormat::WebP => webp(t, keeper),
            };
            scene.textures().par_iter().map(encode).collect()
        };
        Ok(Pictures { png: all(PictureFormat::Png)?, webp: all(PictureFormat::WebP)? })
    }

    /// Of the scene's texture of this number; empty where this way of coding was not asked for.
    pub fn of(&self, texture: u32, kind: PictureFormat) -> Bytes {
        let all = match kind {
            PictureFormat::Png => &self.png,
            PictureFormat::WebP => &self.webp,
        };
        all.get(texture as usize).cloned().unwrap_or_default()
    }

    /// `textures/STEM_NAME.png`, as the other files refer to them.
    pub fn files<'a>(
        &'a self,
        scene: &'a ValidScene,
        stem: &'a str,
        kind: PictureFormat,
    ) -> impl Iterator<Item = OutputFile<'a>> {
        (0u32..).zip(scene.textures()).map(move |(number, texture)| {
            OutputFile::new(texture_path(stem, &texture.name, kind), self.of(number, kind))
        })
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
    match texture.image.known_png() {
        Some(png) => keeper(&[CODER, &quality.to_le_bytes(), png], &encode),
        // Drawn for this scene alone.
        None => encode(),
    }
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
