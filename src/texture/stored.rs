//! The pictures of a species as bytes, and what decides them: for a store that outlives the run.

use bytes::Bytes;
use serde::{Deserialize, Serialize};

use super::{Atlas, BarkTextures, TreeTextures};
use crate::diagnostic::{Error, Result};
use crate::raster::Image;
use crate::seed::Seed;
use crate::species::Species;

/// The program that draws: with another, the pictures are others. All of this folder, what it asks of a species,
/// and what turns pixels into PNG.
const SOURCES: &[(&str, &str)] = &[
    ("atlas.rs", include_str!("atlas.rs")),
    ("bark/mark.rs", include_str!("bark/mark.rs")),
    ("bark/mod.rs", include_str!("bark/mod.rs")),
    ("bark/relief.rs", include_str!("bark/relief.rs")),
    ("bark/style.rs", include_str!("bark/style.rs")),
    ("bark/transition.rs", include_str!("bark/transition.rs")),
    ("canvas.rs", include_str!("canvas.rs")),
    ("ground.rs", include_str!("ground.rs")),
    ("mod.rs", include_str!("mod.rs")),
    ("noise.rs", include_str!("noise.rs")),
    ("outline.rs", include_str!("outline.rs")),
    ("stored.rs", include_str!("stored.rs")),
    ("twig.rs", include_str!("twig.rs")),
    ("twig/needle.rs", include_str!("twig/needle.rs")),
    ("../raster/cutout.rs", include_str!("../raster/cutout.rs")),
    ("../raster/pad.rs", include_str!("../raster/pad.rs")),
    ("../raster/encoded.rs", include_str!("../raster/encoded.rs")),
    ("../raster/picture.rs", include_str!("../raster/picture.rs")),
    ("../raster/png.rs", include_str!("../raster/png.rs")),
    ("../raster/srgb.rs", include_str!("../raster/srgb.rs")),
    ("../species/model.rs", include_str!("../species/model.rs")),
    ("../species/own.rs", include_str!("../species/own.rs")),
    ("../species/own/turn.rs", include_str!("../species/own/turn.rs")),
    ("../seed.rs", include_str!("../seed.rs")),
];

/// Everything that decides what [`super::for_species`] gives for these arguments.
pub fn decides(species: &Species, size_px: u32, seed: Seed) -> Vec<Vec<u8>> {
    let Species { name, kind, foliage, bark, own_bark, own_model, own_picture, .. } = species;
    let mut all: Vec<Vec<u8>> = vec![env!("CARGO_PKG_VERSION").into()];
    all.extend(SOURCES.iter().map(|(_, text)| text.as_bytes().to_vec()));
    // Floats print so that they read back as the same bits.
    all.push(format!("{name:?} {kind:?} {foliage:?} {bark:?} {size_px} {seed:?}").into());
    let bark = own_bark.as_ref();
    let pictures = [
        bark.map(|own| &*own.colour),
        bark.and_then(|own| own.normal.as_deref()),
        bark.and_then(|own| own.roughness.as_deref()),
        own_model.as_ref().map(|own| &own.picture),
        own_model.as_ref().and_then(|own| own.normals.as_ref()),
        own_picture.as_deref(),
    ];
    for picture in pictures {
        let about = picture.map(|p| (p.width, p.height));
        all.push(format!("{about:?}").into());
        all.extend(picture.map(|p| p.data.as_flattened().to_vec()));
    }
    all
}

/// What is not pixels.
#[derive(Serialize, Deserialize)]
struct Head {
    atlas: Atlas,
    bark: BarkHead,
    upper: Option<BarkHead>,
    transition: Option<BarkHead>,
    twig: Option<BarkHead>,
    has_leaf_normal: bool,
    crown: [u8; 3],
}

#[derive(Serialize, Deserialize)]
struct BarkHead {
    /// Whether there is a normal map, an ORM picture, a height.
    has: [bool; 3],
    depth_m: f32,
}

impl BarkHead {
    fn of(bark: &BarkTextures) -> BarkHead {
        let has = [&bark.normal, &bark.orm, &bark.height].map(Option::is_some);
        BarkHead { has, depth_m: bark.depth_m }
    }

    fn read(&self, parts: &mut impl Iterator<Item = Bytes>) -> Result<BarkTextures> {
        let mut image = || Image::from_png(parts.next().ok_or_else(missing)?);
        let colour = image()?;
        let mut optional = |has: bool| has.then(&mut image).transpose();
        let [normal, orm, height] = self.has;
        Ok(BarkTextures {
            colour,
            normal: optional(normal)?,
            orm: optional(orm)?,
            height: optional(height)?,
            depth_m: self.depth_m,
        })
    }
}

fn missing() -> Error {
    Error::new("a stored picture is missing")
}

impl TreeTextures {
    /// Parts that [`TreeTextures::from_parts`] reads.
    ///
    /// # Errors
    /// A picture whose size and pixels disagree.
    pub fn to_parts(&self) -> Result<Vec<Bytes>> {
        use rayon::prelude::*;
        let head = Head {
            atlas: self.atlas.clone(),
            bark: BarkHead::of(&self.bark),
            upper: self.bark_upper.as_ref().map(BarkHead::of),
            transition: self.bark_transition.as_ref().map(BarkHead::of),
            twig: self.bark_twig.as_ref().map(BarkHead::of),
            has_leaf_normal: self.leaf_normal.is_some(),
            crown: self.crown,
        };
        let of_bark = |b: &BarkTextures| {
            [Some(b.colour.clone()), b.normal.clone(), b.orm.clone(), b.height.clone()]
        };
        let leaf = [Some(self.leaf.clone()), self.leaf_normal.clone()].into_iter().flatten();
        let images: Vec<Image> = leaf.chain(self.barks().flat_map(of_bark).flatten()).collect();
        let head = serde_json::to_vec(&head).map_err(|e| Error::new(e.to_string()))?;
        let pictures: Vec<Bytes> = images.par_iter().map(Image::png).collect::<Result<_>>()?;
        Ok([Bytes::from(head)].into_iter().chain(pictures).collect())
    }

    /// # Errors
    /// Parts that are not those of [`TreeTextures::to_parts`].
    pub fn from_parts(parts: Vec<Bytes>) -> Result<TreeTextures> {
        let mut parts = parts.into_iter();
        let head = parts.next().ok_or_else(missing)?;
        let head: Head = serde_json::from_slice(&head).map_err(|e| Error::new(e.to_string()))?;
        let mut image = || Image::from_png(parts.next().ok_or_else(missing)?);
        let leaf = image()?;
        let leaf_normal = head.has_leaf_normal.then(image).transpose()?;
        Ok(TreeTextures {
            bark: head.bark.read(&mut parts)?,
            bark_upper: head.upper.as_ref().map(|b| b.read(&mut parts)).transpose()?,
            bark_transition: head.transition.as_ref().map(|b| b.read(&mut parts)).transpose()?,
            bark_twig: head.twig.as_ref().map(|b| b.read(&mut parts)).transpose()?,
            leaf,
            leaf_normal,
            atlas: head.atlas,
            crown: head.crown,
            leaf_variants: Vec::new(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::super::for_species;
    use super::*;
    use crate::raster::Picture;
    use crate::species::load;

    #[test]
    fn parts_are_the_pictures() {
        for name in ["pinus_sylvestris", "quercus_robur"] {
            let drawn = for_species(&load(name).unwrap(), 64, Seed::new(1));
            let parts = drawn.to_parts().unwrap();
            let read = TreeTextures::from_parts(parts.clone()).unwrap();
            assert_eq!(read, drawn);
            assert_eq!(read.leaf.png().unwrap(), drawn.leaf.png().unwrap());
            for cut in 0..parts.len() {
                assert!(TreeTextures::from_parts(parts[..cut].to_vec()).is_err(), "{cut} parts");
            }
        }
    }

    #[test]
    fn everything_that_decides_is_named() {
        let s = load("betula_pendula").unwrap();
        let first = decides(&s, 64, Seed::new(1));
        assert_eq!(first, decides(&s, 64, Seed::new(1)));
        let mut other = s.clone();
        other.bark.lost = 0.1;
        let mut leaf = s.clone();
        leaf.foliage.variation += 1e-6;
        let mut picture = s.clone();
        picture.own_picture = Some(Picture::filled(8, 8, [9; 4]).into());
        let mut edited = s.clone();
        edited.own_picture = Some(Picture::filled(8, 8, [10; 4]).into());
        assert_ne!(decides(&picture, 64, Seed::new(1)), decides(&edited, 64, Seed::new(1)));
        let others = [(&other, 64, 1), (&leaf, 64, 1), (&picture, 64, 1), (&s, 65, 1), (&s, 64, 2)];
        for (species, px, seed) in others {
            assert_ne!(first, decides(species, px, Seed::new(seed)));
        }
    }

    #[test]
    fn every_source_of_pictures_is_listed() {
        fn walk(folder: &std::path::Path, within: &str, found: &mut Vec<String>) {
            for entry in std::fs::read_dir(folder).unwrap() {
                let path = entry.unwrap().path();
                let name = format!("{within}{}", path.file_name().unwrap().to_string_lossy());
                if path.is_dir() {
                    walk(&path, &format!("{name}/"), found);
                } else if name.ends_with(".rs") && !name.ends_with("tests.rs") {
                    found.push(name);
                }
            }
        }
        let mut found = Vec::new();
        let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("src/texture");
        walk(&folder, "", &mut found);
        for name in found {
            assert!(SOURCES.iter().any(|(n, _)| *n == name), "{name} is not in SOURCES");
        }
    }
}
