//! Species to bark and leaf pictures, made by the program or the user's own. Knows nothing of
//! meshes or disks.

pub mod atlas;
pub mod bark;
mod canvas;
mod ground;
mod noise;
mod outline;
pub mod stored;
mod twig;

pub use atlas::{Atlas, Cell};
pub use bark::BARK_REPEAT_M;
pub use ground::GROUND_REPEAT_M;
pub use twig::SHADE;

use crate::raster::{Image, Picture};
use crate::seed::Seed;
use crate::species::Species;
use crate::species::own::turned;
use crate::work::{self, Work};
use bark::BarkPictures;

/// The pictures of one species.
#[derive(Debug, Clone, PartialEq)]
pub struct TreeTextures {
    pub bark: BarkTextures,
    /// The bark of the upper stem and the branches, where the species has one of its own.
    pub bark_upper: Option<BarkTextures>,
    /// Between the two: as high as [`bark::TILES`] tiles, see [`bark::draw_transition`].
    pub bark_transition: Option<BarkTextures>,
    /// That of twigs: colour alone.
    pub bark_twig: Option<BarkTextures>,
    /// Twigs with alpha, sRGB; colour goes on under the transparent pixels.
    pub leaf: Image,
    /// Where the twigs of `leaf` lie.
    pub atlas: Atlas,
    /// Normals for it, as [`BarkTextures::normal`]; only of a user's own model that has some.
    pub leaf_normal: Option<Image>,
    /// Colour, sRGB, of the leaves as a whole crown shows them.
    pub crown: [u8; 3],
    /// The same twigs in other colours.
    pub leaf_variants: Vec<LeafVariant>,
}

/// Other colours of a species' leaves.
#[derive(Debug, Clone, PartialEq)]
pub struct LeafVariant {
    pub name: &'static str,
    /// As [`TreeTextures::leaf`].
    pub leaf: Image,
    /// As [`TreeTextures::crown`].
    pub crown: [u8; 3],
}

impl TreeTextures {
    /// Those there are, from the foot up.
    pub fn barks(&self) -> impl Iterator<Item = &BarkTextures> {
        let more = [&self.bark_upper, &self.bark_transition, &self.bark_twig];
        std::iter::once(&self.bark).chain(more.into_iter().flatten())
    }

    fn barks_mut(&mut self) -> impl Iterator<Item = &mut BarkTextures> {
        let more = [&mut self.bark_upper, &mut self.bark_transition, &mut self.bark_twig];
        std::iter::once(&mut self.bark).chain(more.into_iter().flatten())
    }

    fn pixels(&self) -> usize {
        let of = |image: &Image| image.width() as usize * image.height() as usize;
        let leaves = std::iter::once(&self.leaf).chain(&self.leaf_normal);
        self.barks().flat_map(BarkTextures::images).chain(leaves).map(of).sum()
    }

    /// How many there are; one of a single pixel is a colour.
    pub fn pictures(&self) -> usize {
        let variants = self.leaf_variants.iter().map(|variant| &variant.leaf);
        let leaves = std::iter::once(&self.leaf).chain(&self.leaf_normal).chain(variants);
        let all = self.barks().flat_map(BarkTextures::images).chain(leaves);
        all.filter(|image| image.width() > 1).count()
    }

    /// For who writes none.
    pub fn forget_heights(&mut self) {
        self.barks_mut().for_each(|bark| bark.height = None);
    }
}

/// The pictures of one bark; they tile in both directions, a tile is [`BARK_REPEAT_M`] wide and
/// high. A user's own bark has what the user gave.
#[derive(Debug, Clone, PartialEq)]
pub struct BarkTextures {
    /// Base colour, sRGB, opaque.
    pub colour: Image,
    /// Tangent-space normals, raw, x along u and y along v (up), as in OpenGL.
    pub normal: Option<Image>,
    /// Occlusion in red, roughness in green, metalness (none) in blue, raw.
    pub orm: Option<Image>,
    /// From the deepest (0) to the highest place (255), [`BarkTextures::depth_m`] apart, raw.
    pub height: Option<Image>,
    /// Depth of the relief, metres; 0 where it is not known.
    pub depth_m: f32,
}

impl BarkTextures {
    fn images(&self) -> impl Iterator<Item = &Image> {
        std::iter::once(&self.colour)
            .chain([&self.normal, &self.orm, &self.height].into_iter().flatten())
    }
}

impl From<bark::Drawn> for BarkTextures {
    fn from(drawn: bark::Drawn) -> Self {
        drawn.pictures.into()
    }
}

impl From<BarkPictures> for BarkTextures {
    fn from(p: BarkPictures) -> Self {
        BarkTextures {
            colour: p.colour.into(),
            normal: Some(p.normal.into()),
            orm: Some(p.orm.into()),
            height: Some(p.height.into()),
            depth_m: p.depth_m,
        }
    }
}

/// Picture sides that are made: what is asked for is clamped to these.
pub const SIZE_PX: std::ops::RangeInclusive<u32> = 64..=4096;

/// Draws all pictures of a species, `size_px` square (512 serves a forest, 1024 a single tree).
/// Same species, size and seed: same bytes.
pub fn for_species(species: &Species, size_px: u32, seed: Seed) -> TreeTextures {
    let size_px = size_px.clamp(*SIZE_PX.start(), *SIZE_PX.end()) & !1;
    let seed = seed.derive("texture", 0);
    let bark = &species.bark;
    // No two species have the same furrows, though their files say the same of them.
    let of_bark = seed.derive(&species.name, 0);
    let ((leaf, atlas), (lower, upper, between)) =
        rayon::join(|| leaves(species, size_px, seed), || barks(species, size_px, of_bark));
    let textures = TreeTextures {
        bark: lower,
        bark_upper: upper,
        bark_transition: between,
        bark_twig: bark::draw_twig(bark, size_px, of_bark),
        leaf: leaf.into(),
        leaf_normal: own_normals(species),
        atlas,
        crown: crown_colour(species),
        leaf_variants: Vec::new(),
    };
    work::count(Work::TexturePixels, textures.pixels());
    textures
}

/// The bark of the stem; where there are, that of its upper part and what lies between the two.
fn barks(
    species: &Species,
    size_px: u32,
    seed: Seed,
) -> (BarkTextures, Option<BarkTextures>, Option<BarkTextures>) {
    let bark = &species.bark;
    let own = own_bark(species).filter(|_| bark.lost <= 0.0);
    if let (Some(own), None) = (&own, bark.upper) {
        return (own.clone(), None, None);
    }
    let draw_lower = || match species.own_bark.as_ref() {
        Some(own) => bark::of_own_fallen(own, bark, size_px, seed),
        None => bark::draw(bark, size_px, seed),
    };
    let (lower, upper) = rayon::join(draw_lower, || bark::draw_upper(bark, size_px, seed));
    let between = upper.as_ref().map(|upper| bark::draw_transition(bark, &lower, upper, seed));
    // A whole one of the user's goes as it came; of others how deep they are is not known.
    let mut lower = own.unwrap_or_else(|| lower.into());
    if species.own_bark.is_some() {
        lower.height = None;
    }
    (lower, upper.map(BarkTextures::from), between.map(BarkTextures::from))
}

/// A species without pictures: bark and leaves in a colour each, one pixel wide. Leaves then fill
/// their cards; single ones have their outline.
pub fn plain(species: &Species) -> TreeTextures {
    let pixel = |[r, g, b]: [u8; 3]| Image::from(Picture::filled(1, 1, [r, g, b, 255]));
    let bark = BarkTextures {
        colour: pixel(species.bark.colour),
        normal: None,
        orm: None,
        height: None,
        depth_m: 0.0,
    };
    TreeTextures {
        bark,
        bark_upper: None,
        bark_transition: None,
        bark_twig: None,
        leaf: pixel(species.foliage.colour),
        leaf_normal: None,
        atlas: Atlas::plain(species.foliage.twig_length_m, twig::plain_leaf(&species.foliage)),
        crown: crown_colour(species),
        leaf_variants: Vec::new(),
    }
}

/// Light of a crown over that of a leaf, seen from all sides under sun and sky: leaves shade each
/// other, which a hull's don't.
const SHADED: f32 = 0.55;

/// The colour of a hull of leaves, sRGB.
pub fn crown_colour(species: &Species) -> [u8; 3] {
    species.foliage.colour.map(|c| (f32::from(c) * SHADED.powf(1.0 / 2.2)) as u8)
}

/// The leaf picture of [`for_species`] alone.
pub fn leaf(species: &Species, size_px: u32, seed: Seed) -> Image {
    let size_px = size_px.clamp(*SIZE_PX.start(), *SIZE_PX.end()) & !1;
    leaves(species, size_px, seed.derive("texture", 0)).0.into()
}

/// The user's own bark; `None` where the file names none.
fn own_bark(species: &Species) -> Option<BarkTextures> {
    let own = species.own_bark.as_ref()?;
    let orm = own.roughness.as_ref().map(|rough| {
        let data = rough.data.iter().map(|p| [255, p[1], 0, 255]).collect();
        Picture { data, ..**rough }.into()
    });
    let image = |picture: &Picture| Image::from(picture.clone());
    Some(BarkTextures {
        colour: image(&own.colour),
        normal: own.normal.as_deref().map(image),
        orm,
        height: None,
        depth_m: 0.0,
    })
}

/// The normals of a user's own model.
fn own_normals(species: &Species) -> Option<Image> {
    Some(Image::from(species.own_model.as_ref()?.normals.clone()?))
}

/// The picture of a user's own model or twig, its leaves in the colour of the species', or one drawn for it.
fn leaves(species: &Species, size_px: u32, seed: Seed) -> (Picture, Atlas) {
    let (twig_m, colour) = (species.foliage.twig_length_m, species.foliage.colour);
    match (&species.own_model, &species.own_picture) {
        (Some(model), _) => {
            let fill = crate::species::own::opaque_spot(&model.picture);
            (turned(&model.picture, colour), Atlas::whole(twig_m).filled_at(fill))
        }
        (None, Some(picture)) => twig::own(&turned(picture, colour), twig_m),
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
