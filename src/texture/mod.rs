//! Species to bark and leaf pictures, made by the program. Knows nothing of meshes.

pub mod atlas;
pub mod bark;
mod canvas;
mod ground;
mod noise;
mod twig;

pub use atlas::{Atlas, Cell};
pub use bark::BARK_REPEAT_M;
pub use ground::GROUND_REPEAT_M;

use crate::raster::Picture;
use crate::seed::Seed;
use crate::species::Species;

/// The pictures of one species.
#[derive(Debug, Clone, PartialEq)]
pub struct TreeTextures {
    /// Base colour of the bark, sRGB, opaque; tiles in both directions, a tile is
    /// [`BARK_REPEAT_M`] wide and high.
    pub bark: Picture,
    /// The same bark in the colour of the upper stem and the branches, where the species has one.
    pub bark_upper: Option<Picture>,
    /// Tangent-space normals of both barks, raw, x along u and y along v (up), as in OpenGL.
    pub bark_normal: Picture,
    /// Twigs with alpha, sRGB; colour goes on under the transparent pixels.
    pub leaf: Picture,
    /// Where the twigs of `leaf` lie.
    pub atlas: Atlas,
}

/// Picture sides that are made: what is asked for is clamped to these.
pub const SIZE_PX: std::ops::RangeInclusive<u32> = 64..=4096;

/// Draws all pictures of a species, `size_px` square (512 serves a forest, 1024 a single tree).
/// Same species, size and seed: same bytes.
pub fn for_species(species: &Species, size_px: u32, seed: Seed) -> TreeTextures {
    let size_px = size_px.clamp(*SIZE_PX.start(), *SIZE_PX.end()) & !1;
    let seed = seed.derive("texture", 0);
    let ((leaf, atlas), bark) =
        rayon::join(|| leaves(species, size_px, seed), || bark::draw(&species.bark, size_px, seed));
    TreeTextures {
        bark: bark.colour,
        bark_upper: bark.upper,
        bark_normal: bark.normal,
        leaf,
        atlas,
    }
}

/// The picture of a user's own model or twig as it is, or one drawn for the species.
fn leaves(species: &Species, size_px: u32, seed: Seed) -> (Picture, Atlas) {
    let twig_m = species.foliage.twig_length_m;
    match (&species.own_model, &species.own_picture) {
        (Some(model), _) => {
            let fill = crate::species::own::opaque_spot(&model.picture);
            (model.picture.clone(), Atlas::whole(twig_m).filled_at(fill))
        }
        (None, Some(picture)) => twig::own(picture, twig_m),
        (None, None) => twig::draw(species, size_px, seed),
    }
}

/// A seamless tile of forest floor, [`GROUND_REPEAT_M`] wide, `size_px` square.
pub fn ground(size_px: u32, seed: Seed) -> Picture {
    let size_px = size_px.clamp(*SIZE_PX.start(), *SIZE_PX.end());
    ground::draw(size_px, seed.derive("texture", 1))
}

#[cfg(test)]
pub(crate) mod tests;
