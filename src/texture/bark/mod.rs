//! Bark as a relief and its colours, on a torus: the pictures tile in both directions.
//!
//! A style says of each place how high it lies and what it is made of; marks (lenticels, rifts,
//! scars) and the loss of bark are laid over that. Normals, occlusion and roughness follow from
//! the one height field. The colour of ridges is held to the species' own, whatever the pattern.
//!
//! Limit: a tile shows no change up or around the stem but that of the second bark, and of the one between
//! (see `transition`).

mod mark;
mod relief;
mod style;
mod transition;

use rayon::prelude::*;

use super::BarkTextures;
use super::noise::{mix, smoothstep};
use crate::raster::Picture;
use crate::seed::Seed;
use crate::species::model::{Bark, BarkStyle, OwnBark};

pub use relief::normal_map;
pub use transition::{PURE, TILES};

/// One tile of bark shows this many metres in both directions.
pub const BARK_REPEAT_M: f32 = 1.0;

/// Of a user's bark that says nothing of it, of 255.
const PLAIN_ROUGHNESS: u8 = 230;
/// How far the colour of young bark's furrows is from that of its ridges, over that of old bark's.
const YOUNG_FURROWS: f32 = 0.5;

/// What the bark is like at a place, whatever its colours.
#[derive(Debug, Clone, Copy, Default)]
struct Texel {
    /// Of the relief; scaled to 0…1 over the whole tile at the end.
    height: f32,
    /// From furrow (0) to ridge (1).
    tone: f32,
    /// Brightness.
    shade: f32,
    /// Shift to red; below 0 to grey.
    warm: f32,
    /// Share of buff fresh skin.
    fresh: f32,
    /// Share of green algae.
    moss: f32,
    roughness: f32,
    /// Share of a dark mark, and its brightness.
    mark: f32,
    mark_shade: f32,
    /// Share of bare wood, and its brightness.
    wood: f32,
    wood_shade: f32,
}

impl Texel {
    fn new(height: f32, tone: f32, shade: f32, warm: f32) -> Self {
        Texel { height, tone, shade, warm, roughness: 0.9, ..Texel::default() }
    }

    /// How much of the colour of ridges is seen here.
    fn ridge(&self) -> f32 {
        self.tone * (1.0 - self.mark) * (1.0 - self.wood) * (1.0 - self.fresh)
    }

    fn colour(&self, light: [f32; 3], dark: [f32; 3]) -> [f32; 3] {
        const RED: [f32; 3] = [1.0, -0.12, -0.6];
        // Bark is nowhere blue.
        const GREY: [f32; 3] = [0.9, 0.55, 0.2];
        const BUFF: [f32; 3] = [1.0, 0.84, 0.68];
        const ALGAE: [f32; 3] = [0.88, 1.0, 0.76];
        const WOOD: [f32; 3] = [158.0, 152.0, 142.0];
        let shift = if self.warm > 0.0 { RED } else { GREY };
        [0, 1, 2].map(|c| {
            let bark = mix(dark[c], light[c], self.tone)
                * self.shade
                * (1.0 + shift[c] * self.warm)
                * mix(1.0, BUFF[c], self.fresh)
                * mix(1.0, ALGAE[c], self.moss);
            let marked = mix(bark, dark[c] * self.mark_shade, self.mark);
            mix(marked, WOOD[c] * self.wood_shade, self.wood)
        })
    }
}

/// The pictures of one bark, each of the same size.
#[derive(Debug, Clone, PartialEq)]
pub struct BarkPictures {
    /// Base colour, sRGB.
    pub colour: Picture,
    /// Tangent-space normals, raw, +Y up the stem.
    pub normal: Picture,
    /// Occlusion in red, roughness in green, metalness (none) in blue, raw.
    pub orm: Picture,
    /// 0 the deepest, 255 the highest place, in all channels, raw.
    pub height: Picture,
    /// Metres between the deepest and the highest place.
    pub depth_m: f32,
}

/// Pictures, and the heights that their last one has in steps.
pub struct Drawn {
    pub pictures: BarkPictures,
    heights: Vec<f32>,
}

/// The bark of the stem, `size_px` square.
pub fn draw(bark: &Bark, size_px: u32, seed: Seed) -> Drawn {
    pictures(bark.style, bark.colour, bark.relief_m, bark, size_px, seed)
}

/// A user's own bark in a size: what is dark is deep, how deep is not known.
pub fn of_own(own: &OwnBark, size_px: u32) -> Drawn {
    let n = size_px.max(16);
    let sized = |picture: &Picture| picture.resized(n, n);
    let colour = sized(&own.colour);
    let heights = colour.data.iter().map(|p| {
        let [r, g, b] = [0, 1, 2].map(|c| f32::from(p[c]) / 255.0);
        0.2126 * r + 0.7152 * g + 0.0722 * b
    });
    let heights: Vec<f32> = heights.collect();
    let plain = |pixel| Picture::filled(n, n, pixel);
    let rough = own.roughness.as_deref().map(sized);
    let orm = rough.map_or(plain([255, PLAIN_ROUGHNESS, 0, 255]), |mut rough| {
        rough.data.iter_mut().for_each(|p| *p = [255, p[1], 0, 255]);
        rough
    });
    let normal = own.normal.as_deref().map_or(plain([128, 128, 255, 255]), sized);
    let height = plain([255; 4]);
    Drawn { pictures: BarkPictures { colour, normal, orm, height, depth_m: 0.0 }, heights }
}

/// A user's own bark off which as much has fallen as off the species'.
pub fn of_own_fallen(own: &OwnBark, bark: &Bark, size_px: u32, seed: Seed) -> Drawn {
    let mut drawn = of_own(own, size_px);
    if bark.lost <= 0.0 {
        return drawn;
    }
    let n = drawn.pictures.colour.width;
    let is_wood = texels(BarkStyle::Smooth, bark, n as usize, seed);
    let wood = pictures(BarkStyle::Smooth, bark.colour, bark.relief_m, bark, n, seed);
    let lay = |own: &mut Picture, wood: &Picture| {
        for ((own, wood), t) in own.data.iter_mut().zip(&wood.data).zip(&is_wood) {
            *own =
                std::array::from_fn(|c| mix(own[c].into(), wood[c].into(), t.wood).round() as u8);
        }
    };
    lay(&mut drawn.pictures.colour, &wood.pictures.colour);
    lay(&mut drawn.pictures.normal, &wood.pictures.normal);
    lay(&mut drawn.pictures.orm, &wood.pictures.orm);
    for ((own, wood), t) in drawn.heights.iter_mut().zip(&wood.heights).zip(&is_wood) {
        *own = mix(*own, *wood, t.wood);
    }
    drawn
}

/// What lies between the bark of the stem and that of its upper part.
pub fn draw_transition(bark: &Bark, old: &Drawn, upper: &Drawn, seed: Seed) -> BarkPictures {
    transition::draw(old, upper, bark.upper_style.unwrap_or(bark.style), seed)
}

/// The bark of the upper stem and the branches, where the species has one of its own.
pub fn draw_upper(bark: &Bark, size_px: u32, seed: Seed) -> Option<Drawn> {
    let colour = bark.upper?;
    let style = bark.upper_style.unwrap_or(bark.style);
    // Younger bark is thinner; of the same pattern, its furrows are not yet as dark.
    let (relief, furrows) = if style == bark.style { (0.5, YOUNG_FURROWS) } else { (0.3, 1.0) };
    let own = Bark { dark: darker(colour, bark, furrows), ..bark.clone() };
    Some(pictures(style, colour, relief * bark.relief_m, &own, size_px, seed.derive("upper", 0)))
}

/// The bark of twigs: its colour alone, at a quarter of the size. What furrows the bark of branches
/// is seen on them faintly, so that one goes over into the other.
pub fn draw_twig(bark: &Bark, size_px: u32, seed: Seed) -> Option<BarkTextures> {
    use BarkStyle::{Flakes, Furrows, Plates, Ridges, Scales, Smooth};
    let colour = bark.twig?;
    let (style, dark) = match bark.upper_style.unwrap_or(bark.style) {
        rough @ (Furrows | Ridges | Scales | Plates | Flakes) => {
            (rough, darker(colour, bark, YOUNG_FURROWS))
        }
        _ => (Smooth, colour.map(|c| c / 2)),
    };
    let own = Bark { dark, ..bark.clone() };
    let size_px = (size_px / 4).max(64);
    let drawn = pictures(style, colour, 0.002, &own, size_px, seed.derive("twig bark", 0));
    let p = drawn.pictures;
    Some(BarkTextures {
        colour: p.colour.into(),
        normal: None,
        orm: None,
        height: None,
        depth_m: 0.0,
    })
}

/// A share of the way from a colour to that of the bark's furrows.
fn darker(colour: [u8; 3], bark: &Bark, share: f32) -> [u8; 3] {
    [0, 1, 2].map(|c| mix(colour[c].into(), bark.dark[c].into(), share).round() as u8)
}

/// How much smoother the highest places are, which rain and wind have worn; and from which height on.
const WORN: f32 = 0.16;
const WORN_FROM: f32 = 0.35;

fn pictures(
    style: BarkStyle,
    light: [u8; 3],
    relief_m: f32,
    bark: &Bark,
    size_px: u32,
    seed: Seed,
) -> Drawn {
    let n = size_px.max(16) as usize;
    let mut texels = texels(style, bark, n, seed);
    let heights = relief::spread(&mut texels);
    let depth_m = relief_m.clamp(0.0, 0.2);
    let shaded = relief::occlusion(&heights, n, depth_m / BARK_REPEAT_M);
    // Dust lies in what is sheltered.
    texels.par_iter_mut().zip(&shaded).for_each(|(t, open)| t.shade *= 0.55 + 0.45 * open);

    let picture = |data: Vec<[u8; 4]>| Picture { width: n as u32, height: n as u32, data };
    let byte = |x: f32| (255.0 * x).round().clamp(0.0, 255.0) as u8;
    let orm = texels.par_iter().zip(&shaded).zip(&heights).map(|((t, &open), &height)| {
        let worn = WORN * smoothstep(WORN_FROM, 1.0, height);
        let rough = mix(t.roughness - worn, 0.95, 0.5 * (1.0 - open));
        [byte(open), byte(rough), 0, 255]
    });
    let pictures = BarkPictures {
        colour: picture(paint(&texels, light, bark.dark)),
        normal: normal_map(&heights, n, depth_m / BARK_REPEAT_M),
        orm: picture(orm.collect()),
        height: picture(heights.iter().map(|&h| [byte(h), byte(h), byte(h), 255]).collect()),
        depth_m,
    };
    Drawn { pictures, heights }
}

/// `n` × `n` texels, the first row on top.
fn texels(style: BarkStyle, bark: &Bark, n: usize, seed: Seed) -> Vec<Texel> {
    let painter = style::Painter::new(seed, n, bark.coarseness);
    let mut texels: Vec<Texel> = (0..n * n)
        .into_par_iter()
        .with_min_len(n)
        .map(|i| {
            let u = ((i % n) as f32 + 0.5) / n as f32;
            let v = 1.0 - ((i / n) as f32 + 0.5) / n as f32;
            painter.texel(style, u, v)
        })
        .collect();
    mark::marks(&mut texels, n, style, seed);
    mark::fallen(&mut texels, n, bark.lost, seed);
    texels
}

/// Colours whose mean over the ridges is `light`.
fn paint(texels: &[Texel], light: [u8; 3], dark: [u8; 3]) -> Vec<[u8; 4]> {
    let [light, dark] = [light, dark].map(|c| c.map(f32::from));
    let (mut sum, mut weight) = ([0.0f64; 3], 0.0f64);
    for t in texels {
        let ridge = f64::from(t.ridge().powi(4));
        weight += ridge;
        for (s, c) in sum.iter_mut().zip(t.colour(light, dark)) {
            *s += ridge * f64::from(c);
        }
    }
    let gain: [f32; 3] = std::array::from_fn(|c| {
        let mean = (sum[c] / weight.max(1e-9)) as f32;
        if weight > 0.0 { (light[c] / mean.max(1.0)).clamp(0.5, 2.0) } else { 1.0 }
    });
    let lit = |t: &Texel| {
        let colour = t.colour(light, dark);
        // What is bare wood is no bark.
        let [r, g, b] = [0, 1, 2].map(|c| {
            let x = colour[c] * mix(gain[c], 1.0, t.wood);
            x.round().clamp(0.0, 255.0) as u8
        });
        [r, g, b, 255]
    };
    texels.par_iter().map(lit).collect()
}

#[cfg(test)]
mod tests;
