//! The pictures of a species, drawn, and those of a scene, coded; or found where they were kept.

use crate::cache::{Cache, Key};
use crate::diagnostic::Result;
use crate::export::{PictureFormat, Pictures};
use crate::raster::Image;
use crate::scene::ValidScene;
use crate::seed::Seed;
use crate::species::Species;
use crate::species::state::{Condition, Season, State};
use crate::texture::{self, LeafVariant, TreeTextures, stored};

/// What pictures are drawn by: the same for all trees of a species, whatever their seeds, so that many of
/// them share their pictures.
const DRAWN_BY: Seed = Seed::new(1);

/// The same pictures, to the byte, with or without a cache; none where they are to be 0 pixels wide.
///
/// # Errors
/// A picture that can't be encoded.
pub(super) fn paint(species: &Species, size_px: u32, cache: &Cache) -> Result<TreeTextures> {
    paint_unless_found(species, size_px, cache, None)
}

/// As [`paint`], where such pictures may have been found before.
///
/// # Errors
/// A picture that can't be encoded.
pub(super) fn paint_unless_found(
    species: &Species,
    size_px: u32,
    cache: &Cache,
    found: Option<Kept>,
) -> Result<TreeTextures> {
    if size_px == 0 {
        return Ok(texture::plain(species));
    }
    let key = key(species, size_px);
    let found = found.filter(|found| found.key == key).or_else(|| Kept::of(key, cache));
    if let Some(found) = found {
        return Ok(found.textures);
    }
    let textures = texture::for_species(species, size_px, DRAWN_BY);
    if cache.is_on() {
        cache.put(key, &textures.to_parts()?);
    }
    Ok(textures)
}

/// Pictures that were kept from an earlier run.
pub(super) struct Kept {
    key: Key,
    textures: TreeTextures,
}

impl Kept {
    /// Those of a species, if there are.
    pub(super) fn find(species: &Species, size_px: u32, cache: &Cache) -> Option<Kept> {
        if size_px == 0 { None } else { Kept::of(key(species, size_px), cache) }
    }

    fn of(key: Key, cache: &Cache) -> Option<Kept> {
        let textures = TreeTextures::from_parts(cache.get(key)?).ok()?;
        Some(Kept { key, textures })
    }
}

fn key(species: &Species, size_px: u32) -> Key {
    let decides = stored::decides(species, size_px, DRAWN_BY);
    Key::of(decides.iter().map(Vec::as_slice))
}

/// The leaves in the colours they have in other seasons and conditions, as far as these differ; `seed` tells
/// the autumn of one tree from that of another.
///
/// # Errors
/// A picture that can't be encoded.
pub(super) fn leaf_variants(
    species: &Species,
    state: State,
    size_px: u32,
    seed: Seed,
    cache: &Cache,
) -> Result<Vec<LeafVariant>> {
    const SEASONS: [(&str, Season); 3] =
        [("spring", Season::Spring), ("summer", Season::Summer), ("autumn", Season::Autumn)];
    const CONDITIONS: [(&str, Condition); 4] = [
        ("weakened", Condition::Weakened),
        ("strongly_weakened", Condition::StronglyWeakened),
        ("dying", Condition::Dying),
        ("fresh_dead", Condition::FreshDead),
    ];
    let seasons = SEASONS.map(|(name, season)| (name, State { season, ..state }));
    let conditions = CONDITIONS.map(|(name, condition)| (name, State { condition, ..state }));
    let own = state.look(species, seed).foliage;
    let mut variants = Vec::new();
    if state.leaf_share(species) == 0.0 || own.kept == 0.0 {
        return Ok(variants);
    }
    for (name, state) in seasons.into_iter().chain(conditions) {
        let mut look = state.look(species, seed);
        // Only colours differ. Twigs in leaf don't fit the cards of bare ones.
        if !look.foliage.is_bare() && !own.is_bare() {
            look.foliage.kept = own.kept;
        }
        look.foliage.has_dry = own.has_dry;
        if look.foliage != own && look.foliage.kept == own.kept {
            let crown = texture::crown_colour(&look);
            variants.push(LeafVariant { name, leaf: leaf(&look, size_px, cache)?, crown });
        }
    }
    Ok(variants)
}

/// Warns of looks asked for that a bare tree does not have.
pub(super) fn tell_no_variants(species: &Species, warnings: &mut Vec<String>) {
    let name = &species.name;
    warnings.push(format!("--variants: {name} bears no leaves here that other colours were for"));
}

fn leaf(species: &Species, size_px: u32, cache: &Cache) -> Result<Image> {
    if size_px == 0 {
        return Ok(texture::plain(species).leaf);
    }
    let mut decides = stored::decides(species, size_px, DRAWN_BY);
    decides.push("leaf".into());
    let key = Key::of(decides.iter().map(Vec::as_slice));
    if let Some(Ok(image)) = cache.get(key).and_then(|p| p.into_iter().next()).map(Image::from_png)
    {
        return Ok(image);
    }
    let image = texture::leaf(species, size_px, DRAWN_BY);
    if cache.is_on() {
        cache.put(key, &[image.png()?]);
    }
    Ok(image)
}

/// The pictures of a scene as its files hold them: the same, to the byte, with or without a cache.
///
/// # Errors
/// A picture that a format can't take.
pub fn coded(scene: &ValidScene, kinds: &[PictureFormat], cache: &Cache) -> Result<Pictures> {
    Pictures::encode_once(scene, kinds, &|decides, encode| {
        let key = Key::of(decides.iter().copied());
        if let Some(kept) = cache.get(key).and_then(|parts| parts.into_iter().next()) {
            return Ok(kept);
        }
        let coded = encode()?;
        cache.put(key, std::slice::from_ref(&coded));
        Ok(coded)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn variants_differ_in_colour_alone() {
        let species = crate::species::load("larix_sibirica").unwrap();
        let (state, cache) = (State::default(), Cache::off());
        let own = texture::leaf(&species, 64, Seed::new(1));
        let alpha = |i: &Image| i.picture().data.iter().map(|p| p[3]).collect::<Vec<_>>();
        let variants = leaf_variants(&species, state, 64, Seed::new(1), &cache).unwrap();
        let names: Vec<_> = variants.iter().map(|v| v.name).collect();
        let all = ["spring", "autumn", "weakened", "strongly_weakened", "dying", "fresh_dead"];
        assert_eq!(names, all);
        for LeafVariant { name, leaf: image, .. } in &variants {
            assert_ne!(*image, own, "{name}");
            assert_eq!(alpha(image), alpha(&own), "{name}: the same leaves");
        }
        let spruce = crate::species::load("picea_abies").unwrap();
        let variants = leaf_variants(&spruce, state, 64, Seed::new(1), &cache).unwrap();
        assert!(variants.iter().all(|v| v.name != "autumn"), "an evergreen has no autumn");
        let winter = State { season: Season::Winter, ..state };
        let variants = leaf_variants(&species, winter, 64, Seed::new(1), &cache).unwrap();
        assert!(variants.is_empty(), "no leaf hangs that could be of another colour");
        let dead = State { condition: Condition::OldDead, ..state };
        let variants = leaf_variants(&spruce, dead, 64, Seed::new(1), &cache).unwrap();
        assert!(variants.is_empty(), "no picture of leaves that are not there");
        let mut picture = crate::raster::Picture::filled(8, 8, [40, 90, 30, 255]);
        picture.set(0, 0, [0; 4]);
        let mut own = Species { own_picture: Some(picture.into()), ..species };
        own.foliage.colour = [40, 90, 30];
        let kept = texture::leaf(&own, 64, Seed::new(1));
        assert_eq!(kept.picture().at(4, 4), [40, 90, 30, 255], "as it came");
        let variants = leaf_variants(&own, state, 64, Seed::new(1), &cache).unwrap();
        assert_eq!(variants.iter().map(|v| v.name).collect::<Vec<_>>(), all);
        for LeafVariant { name, leaf, .. } in &variants {
            assert_eq!(alpha(leaf), alpha(&kept), "{name}: their picture");
            assert_ne!(leaf.picture().at(4, 4), [40, 90, 30, 255], "{name}: turned");
        }
        let bare = winter.look(&own, Seed::new(1));
        assert!(!bare.has_own_leaves(), "bare twigs are drawn");
        assert!(leaf_variants(&own, winter, 64, Seed::new(1), &cache).unwrap().is_empty());
    }

    #[test]
    fn materials_have_names_of_their_own_with_pictures_and_without() {
        use crate::frame::Frame;
        use crate::pipeline::model::add_materials;
        use crate::scene::Scene;
        let frame = Frame::local(glam::DVec3::ZERO);
        for (size_px, barks) in [(0, 2), (64, 4 + 4)] {
            let mut scene = Scene::empty("both".into(), frame.clone());
            for name in ["betula_pendula", "pinus_sylvestris"] {
                let species = crate::species::load(name).unwrap();
                let textures = paint(&species, size_px, &Cache::off()).unwrap();
                add_materials(&mut scene, &species, textures);
            }
            let names: Vec<_> = scene.materials.iter().map(|m| m.name.as_str()).collect();
            let once: std::collections::BTreeSet<_> = names.iter().collect();
            assert_eq!(once.len(), names.len(), "{names:?}");
            assert_eq!(names.iter().filter(|n| n.contains("_bark")).count(), barks, "{names:?}");
        }
    }

    #[test]
    fn coded_pictures_come_from_the_cache_as_they_would_be_made() {
        let folder = tempfile::tempdir().unwrap();
        let cache = Cache::in_folder(folder.path());
        let mut scene = crate::scene::sample::forest(&["Larix"], 2, 20.0);
        for texture in &mut scene.textures {
            texture.image = Image::from_png(texture.image.png().unwrap()).unwrap();
        }
        let scene = scene.validate().unwrap();
        let count = scene.textures().len() as u32;
        let of = |cache: &Cache| -> Vec<_> {
            let all = coded(&scene, &[PictureFormat::WebP], cache).unwrap();
            (0..count).map(|t| all.of(t, PictureFormat::WebP)).collect()
        };
        let made = of(&Cache::off());
        assert_eq!(of(&cache), made);
        let entries = || std::fs::read_dir(folder.path()).unwrap().map(|e| e.unwrap().path());
        assert!(entries().count() > 0 && of(&cache) == made);
        // Another entry in the place of each: it is taken.
        let other = bytes::Bytes::from_static(b"other");
        let keeper = |decides: &[&[u8]], _: &dyn Fn() -> Result<bytes::Bytes>| {
            cache.put(Key::of(decides.iter().copied()), std::slice::from_ref(&other));
            Ok(other.clone())
        };
        Pictures::encode_once(&scene, &[PictureFormat::WebP], &keeper).unwrap();
        assert!(of(&cache).iter().all(|bytes| *bytes == other));
    }

    #[test]
    fn kept_drawn_and_mended_pictures_are_the_same() {
        let folder = tempfile::tempdir().unwrap();
        let cache = Cache::in_folder(folder.path());
        let species = crate::species::load("betula_pendula").unwrap();
        let of = |cache: &Cache| paint(&species, 64, cache).unwrap().to_parts().unwrap();
        let drawn = of(&Cache::off());
        assert_eq!(of(&cache), drawn);
        let files = || std::fs::read_dir(folder.path()).unwrap().map(|e| e.unwrap().path());
        assert_eq!(files().count(), 1);
        assert_eq!(of(&cache), drawn, "from the cache");
        let entry = files().next().unwrap();
        std::fs::write(&entry, b"broken").unwrap();
        assert_eq!(of(&cache), drawn, "over a broken entry");
        assert!(std::fs::metadata(&entry).unwrap().len() > 1000, "which is mended");
    }
}
