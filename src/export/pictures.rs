//! The textures of a scene as PNG, encoded once for all formats.

use bytes::Bytes;
use rayon::prelude::*;

use super::OutputFile;
use crate::diagnostic::Result;
use crate::scene::ValidScene;

/// One PNG for each of [`ValidScene::textures`].
pub struct Pictures {
    png: Vec<Bytes>,
}

impl Pictures {
    pub fn encode(scene: &ValidScene) -> Result<Self> {
        let png = scene.textures().par_iter().map(|t| t.image.png()).collect::<Result<_>>()?;
        Ok(Pictures { png })
    }

    pub fn png(&self) -> &[Bytes] {
        &self.png
    }

    /// `textures/STEM_NAME.png`, as the other files refer to them.
    pub fn into_files(self, scene: &ValidScene, stem: &str) -> Vec<OutputFile> {
        let named = scene.textures().iter().zip(self.png);
        named
            .map(|(t, png)| OutputFile {
                path: texture_path(stem, &t.name).into(),
                bytes: png.to_vec(),
            })
            .collect()
    }
}

/// `textures/STEM_NAME.png`: the stem keeps scenes in one folder apart.
pub(super) fn texture_path(stem: &str, name: &str) -> String {
    format!("textures/{}_{name}.png", plain(stem))
}

/// Characters of the stem that mean something to a format or a file system as `_`.
pub(super) fn plain(stem: &str) -> String {
    let plain = |c: char| if c.is_alphanumeric() || "-_.".contains(c) { c } else { '_' };
    stem.chars().map(plain).collect()
}
