//! The impostor of each model, baked, or found where it was kept.

use glam::Vec3;
use rayon::prelude::*;

use super::levels::{IMPOSTOR, bounds};
use crate::cache::{Cache, Key};
use crate::diagnostic::Result;
use crate::lod::stored::{Decides, Stored};
use crate::lod::{self, impostor};
use crate::raster::{Image, linear_from_srgb};
use crate::render::capture::Sitter;
use crate::scene::{Colorspace, Material, Octahedral, Part, Prototype, Scene, Texture, Variant};

/// An impostor's sheet and its pictures.
pub(super) struct Baked {
    pub part: Part,
    pub colour: Texture,
    pub normal: Texture,
    pub octahedral: Option<Octahedral>,
    /// Colours of the model's other looks, by their names.
    pub others: Vec<(String, Texture)>,
}

/// Of an impostor's view, where trees themselves have small pictures or none: a stem is less than a texel
/// wide in smaller ones, and is cut away.
const LEAST_VIEW_PX: u32 = 64;

/// Texels count as so much smaller, for rounding.
const SAME: f32 = 0.99;

/// The impostor of each model, in all looks that its materials know; the same, to the byte, with or without
/// a cache. `None` for a model that nobody looks at (`told_m` is), or whose texels would be larger than what can
/// be told of it, metres.
///
/// # Errors
/// A model that is not finite; a picture that can't be encoded.
pub(super) fn bake(
    scene: &Scene,
    kind: lod::Kind,
    texture_px: u32,
    cache: &Cache,
    told_m: impl Fn(usize) -> Option<f32>,
) -> Result<Vec<Option<Baked>>> {
    // A sheet is shown where the tree is some 200 lines high or less; near by twice as many hold up.
    let size_px = match kind {
        lod::Kind::Cross => texture_px.max(LEAST_VIEW_PX),
        lod::Kind::Octahedral { views } => (2 * texture_px).max(LEAST_VIEW_PX * views),
    };
    let Scene { prototypes, materials, textures, .. } = scene;
    let is_shown = |(m, p): (usize, &Prototype)| {
        let texel_m = match kind {
            lod::Kind::Cross => impostor::cross_texel_m(bounds(&p.parts), size_px as usize),
            lod::Kind::Octahedral { .. } => 0.0,
        };
        told_m(m).is_some_and(|told_m| SAME * texel_m <= told_m)
    };
    let shown: Vec<bool> = prototypes.iter().enumerate().map(is_shown).collect();
    let key = |(p, shown): (&Prototype, &bool)| -> Result<Option<Key>> {
        if !cache.is_on() || !shown {
            return Ok(None);
        }
        key_of(p, scene, kind, size_px).map(Some)
    };
    let keys: Vec<Option<Key>> =
        prototypes.par_iter().zip(&shown).map(key).collect::<Result<_>>()?;
    let kept = |key: &Option<Key>| Stored::from_parts(cache.get((*key)?)?);
    let mut all: Vec<Option<Stored>> = keys.par_iter().map(kept).collect();
    let missing: Vec<usize> = (0..all.len()).filter(|&m| shown[m] && all[m].is_none()).collect();
    if !missing.is_empty() {
        let models: Vec<&[Part]> = prototypes.iter().map(|p| &p.parts[..]).collect();
        let sitter = Sitter::new(&models, materials, textures);
        let one = |m: usize| {
            let prototype = &prototypes[m];
            let looks = most_looks(prototype, materials);
            let tints = looks.map_or(Vec::new(), |material| tints(material, scene));
            let around = bounds(&prototype.parts);
            let baked = impostor::bake(&sitter, m as u32, around, kind, size_px, &tints)?;
            let stored = Stored::from(baked);
            if let Some(key) = keys[m] {
                cache.put(key, &stored.to_parts()?);
            }
            Ok((m, stored))
        };
        let baked: Vec<(usize, Stored)> =
            missing.into_par_iter().map(one).collect::<Result<_>>()?;
        baked.into_iter().for_each(|(m, stored)| all[m] = Some(stored));
    }
    let named = |(stored, prototype): (Option<Stored>, &Prototype)| {
        let looks = most_looks(prototype, materials).map_or(&[][..], |m| &m.variants);
        Some(named(stored?, prototype, looks))
    };
    Ok(all.into_iter().zip(prototypes).map(named).collect())
}

/// What decides an impostor, its tints too, which are found here.
fn key_of(prototype: &Prototype, scene: &Scene, kind: lod::Kind, size_px: u32) -> Result<Key> {
    let Scene { materials, textures, .. } = scene;
    let decides = Decides::new(&prototype.parts, materials, textures, kind, size_px)?;
    Ok(Key::of(std::iter::once(include_bytes!("impostors.rs").as_slice()).chain(decides.parts())))
}

/// The material of a model that has the most looks beside its own.
fn most_looks<'m>(prototype: &Prototype, materials: &'m [Material]) -> Option<&'m Material> {
    let shown = prototype.parts.iter().map(|part| &materials[part.material as usize]);
    shown.max_by_key(|m| m.variants.len()).filter(|m| !m.variants.is_empty())
}

/// With the names of its files.
fn named(stored: Stored, prototype: &Prototype, looks: &[Variant]) -> Baked {
    let texture = |suffix: &str, image: Image, colorspace| Texture {
        name: format!("{}_{IMPOSTOR}{suffix}", prototype.name),
        image,
        colorspace,
    };
    let other = |(look, image): (&Variant, Image)| {
        (look.name.clone(), texture(&format!("_{}", look.name), image, Colorspace::Srgb))
    };
    Baked {
        part: Part { name: IMPOSTOR.into(), surface: stored.surface, material: 0 },
        others: looks.iter().zip(stored.tinted).map(other).collect(),
        colour: texture("", stored.colour, Colorspace::Srgb),
        normal: texture("_normal", stored.normal, Colorspace::Raw),
        octahedral: stored.octahedral,
    }
}

/// Most that a leaf's own colour is taken times.
const MOST_TINT: f32 = 8.0;

/// The mean colour of each other look of a material over that of its own.
fn tints(material: &Material, scene: &Scene) -> Vec<Vec3> {
    let mean = |base_color: [f32; 3], texture: Option<u32>| {
        let Some(texture) = texture else { return Vec3::from(base_color) };
        let data = &scene.textures[texture as usize].image.picture().data;
        let seen = || data.iter().filter(|p| p[3] >= 128);
        let light = |p: &[u8; 4]| Vec3::from([0, 1, 2].map(|k| linear_from_srgb(p[k])));
        let mean = seen().map(light).sum::<Vec3>() / seen().count().max(1) as f32;
        mean * Vec3::from(base_color)
    };
    let own = mean(material.base_color, material.base_color_texture).max(Vec3::splat(1e-3));
    let each = material.variants.iter().map(|v| mean(v.base_color, v.base_color_texture));
    each.map(|other| (other / own).min(Vec3::splat(MOST_TINT))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::sample;

    #[test]
    fn an_impostor_is_the_same_kept_or_baked() {
        let mut scene = sample::forest(&["Betula pendula", "Picea abies"], 4, 60.0);
        let leaf = scene.prototypes[0].parts.last().unwrap().material as usize;
        let looks = [("spring", 0.3), ("autumn", 0.9)];
        scene.materials[leaf].variants = looks
            .map(|(name, red)| Variant {
                name: name.into(),
                base_color: [red, 0.2, 0.1],
                base_color_texture: scene.materials[leaf].base_color_texture,
            })
            .to_vec();
        let folder = tempfile::tempdir().unwrap();
        let cache = Cache::in_folder(folder.path());
        for kind in [lod::Kind::Cross, lod::Kind::Octahedral { views: 4 }] {
            let told = |cache: &Cache| {
                let all = bake(&scene, kind, 64, cache, |_| Some(f32::INFINITY)).unwrap();
                all.into_iter().flatten().map(told).collect::<Vec<_>>()
            };
            let baked = told(&Cache::off());
            let last = scene.prototypes.len() - 1;
            assert_eq!(baked.len(), last + 1);
            assert_eq!(baked[0].3.len(), 2, "looks");
            assert_eq!(told(&cache), baked);
            let entries = || std::fs::read_dir(folder.path()).unwrap().count();
            let count = entries();
            assert_eq!(told(&cache), baked);
            assert_eq!(entries(), count);
            // What is kept is taken, even if it is another's; a broken entry is baked anew.
            let size_px = if kind == lod::Kind::Cross { 64 } else { 64 * 4 };
            let key = |p: &Prototype| key_of(p, &scene, kind, size_px).unwrap();
            let [birch, spruce] = [0, last].map(|m| key(&scene.prototypes[m]));
            cache.put(spruce, &cache.get(birch).unwrap());
            assert_ne!(baked[last].0, baked[0].0);
            assert_eq!(told(&cache)[last].0, baked[0].0);
            cache.put(spruce, &cache.get(birch).unwrap()[..4]);
            assert_eq!(told(&cache), baked);
        }
    }

    type Told = (Vec<Vec3>, Vec<[u8; 4]>, Vec<[u8; 4]>, Vec<(String, Vec<[u8; 4]>)>, String);

    fn told(baked: Baked) -> Told {
        let pixels = |t: &Texture| t.image.picture().data.clone();
        let others = baked.others.iter().map(|(name, t)| (name.clone(), pixels(t)));
        let rest = format!("{:?} {:?}", baked.part.surface, baked.octahedral);
        (
            baked.part.surface.position.clone(),
            pixels(&baked.colour),
            pixels(&baked.normal),
            others.collect(),
            rest,
        )
    }
}
