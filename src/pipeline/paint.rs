//! The pictures of a species, drawn or found where they were kept.

use crate::cache::{Cache, Key};
use crate::diagnostic::Result;
use crate::seed::Seed;
use crate::species::Species;
use crate::texture::{self, TreeTextures, stored};

/// The same pictures, to the byte, with or without a cache.
///
/// # Errors
/// A picture that can't be encoded.
pub(super) fn paint(
    species: &Species,
    size_px: u32,
    seed: Seed,
    cache: &Cache,
) -> Result<TreeTextures> {
    let decides = stored::decides(species, size_px, seed);
    let key = Key::of(decides.iter().map(Vec::as_slice));
    if let Some(kept) = cache.get(key)
        && let Ok(textures) = TreeTextures::from_parts(kept)
    {
        return Ok(textures);
    }
    let textures = texture::for_species(species, size_px, seed);
    if cache.is_on() {
        cache.put(key, &textures.to_parts()?);
    }
    Ok(textures)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn kept_drawn_and_mended_pictures_are_the_same() {
        let folder = tempfile::tempdir().unwrap();
        let cache = Cache::in_folder(folder.path());
        let species = crate::species::load("betula_pendula").unwrap();
        let of =
            |cache: &Cache| paint(&species, 64, Seed::new(1), cache).unwrap().to_parts().unwrap();
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
