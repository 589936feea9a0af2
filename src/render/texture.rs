//! Textures as pyramids of ever smaller pictures, read at the size they have on the screen.
//!
//! Colour is averaged in linear light and weighted by alpha, so that no fringe of the colour
//! behind a leaf shows. A mean alpha is the share of the samples that a masked material hides (see
//! `draw`: Wyman and McGuire 2017, hashed alpha), so that far needles stay airy. For outlines, which
//! no samples are averaged over, alpha is rescaled on every level until as many texels pass the
//! cutoff as on the finest (Castaño 2010).

use std::borrow::Cow;

use glam::Vec2;
use rayon::prelude::*;

use crate::raster::{LINEAR_FROM_SRGB, Picture, floor, srgb_from_linear};
use crate::scene::Colorspace;

/// What is drawn, which says what of the textures is made ready.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Purpose {
    Picture,
    /// Only what masks hide, averaged over what a sample shows.
    Outline,
    /// Only what masks hide, texel by texel.
    Cover,
}

/// What lies beyond a texture's edges.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Edge {
    Repeat,
    /// The texels of the edge: for a photo of the whole terrain, whose opposite edges differ.
    Clamp,
}

struct Level<'a> {
    width: usize,
    height: usize,
    texels: Cow<'a, [[u8; 4]]>,
}

/// A texture ready to be read at any size; repeats in both directions, or ends at its edges.
pub(super) struct Pyramid<'a> {
    levels: Vec<Level<'a>>,
    is_srgb: bool,
}

/// Pictures smaller than this are not halved further: coverage needs texels to choose from.
const LEAST_SIDE: usize = 4;

impl<'a> Pyramid<'a> {
    /// `None` where the picture holds no texel, or fewer than its size says.
    pub fn new(
        picture: &'a Picture,
        colorspace: Colorspace,
        cutoff: Option<f32>,
        purpose: Purpose,
    ) -> Option<Self> {
        let (width, height) = (picture.width as usize, picture.height as usize);
        if width == 0 || height == 0 || picture.data.len() != width * height {
            return None;
        }
        let is_srgb = colorspace == Colorspace::Srgb;
        let mut levels = vec![Level { width, height, texels: Cow::Borrowed(&picture.data) }];
        if purpose == Purpose::Cover {
            return Some(Pyramid { levels, is_srgb });
        }
        let wanted = cutoff.map(|c| coverage(&levels[0], c, 1.0));
        while let Some(last) = levels.last() {
            if last.width.min(last.height) < 2 * LEAST_SIDE {
                break;
            }
            // What a mask hides counts for nothing, whatever its alpha: files have some there, for viewers that
            // average before they cut.
            let cut = cutoff.filter(|_| purpose == Purpose::Picture && levels.len() == 1);
            levels.push(halved(last, is_srgb, cut));
        }
        if let (Purpose::Outline, Some(cutoff), Some(wanted)) = (purpose, cutoff, wanted) {
            levels[1..].par_iter_mut().for_each(|level| keep_coverage(level, cutoff, wanted));
        }
        Some(Pyramid { levels, is_srgb })
    }

    /// Whether a texel read at a level is the mean of several.
    pub fn is_averaged(&self, lod: f32) -> bool {
        lod >= 0.5 && self.levels.len() > 1
    }

    /// Texels of the finest level.
    pub fn texels(&self) -> f32 {
        (self.levels[0].width * self.levels[0].height) as f32
    }

    fn corners(&self, uv: Vec2, lod: f32, edge: Edge) -> (&Level<'a>, [usize; 4], Vec2) {
        let i = ((lod + 0.5).max(0.0) as usize).min(self.levels.len() - 1);
        let level = &self.levels[i];
        let uv = match edge {
            Edge::Repeat => uv - Vec2::new(floor(uv.x) as f32, floor(uv.y) as f32),
            Edge::Clamp => uv.clamp(Vec2::ZERO, Vec2::ONE),
        };
        let x = uv.x * level.width as f32 - 0.5;
        let y = (1.0 - uv.y) * level.height as f32 - 0.5;
        let (col, row) = (floor(x), floor(y));
        let wrap = |v: i32, n: usize| -> usize {
            let last = n as i32 - 1;
            let inside = match edge {
                Edge::Repeat if v < 0 => last,
                Edge::Repeat if v > last => 0,
                _ => v.clamp(0, last),
            };
            inside as usize
        };
        let (x0, x1) = (wrap(col, level.width), wrap(col + 1, level.width));
        let (y0, y1) = (wrap(row, level.height), wrap(row + 1, level.height));
        let (w, share) = (level.width, Vec2::new(x - col as f32, y - row as f32));
        (level, [y0 * w + x0, y0 * w + x1, y1 * w + x0, y1 * w + x1], share)
    }

    /// Alpha 0…1, bilinear.
    pub fn alpha(&self, uv: Vec2, lod: f32, edge: Edge) -> f32 {
        let (level, at, f) = self.corners(uv, lod, edge);
        let a = at.map(|i| f32::from(level.texels[i][3]));
        let top = a[0] + (a[1] - a[0]) * f.x;
        let bottom = a[2] + (a[3] - a[2]) * f.x;
        (top + (bottom - top) * f.y) / 255.0
    }

    /// Linear RGB (or raw values 0…1), bilinear.
    pub fn colour(&self, uv: Vec2, lod: f32, edge: Edge) -> [f32; 3] {
        let (level, at, f) = self.corners(uv, lod, edge);
        let weight = [(1.0 - f.x) * (1.0 - f.y), f.x * (1.0 - f.y), (1.0 - f.x) * f.y, f.x * f.y];
        let table = &*LINEAR_FROM_SRGB;
        let mut sum = [0.0; 3];
        for (i, w) in at.into_iter().zip(weight) {
            let t = level.texels[i];
            for (s, c) in sum.iter_mut().zip(t) {
                *s += w * if self.is_srgb { table[usize::from(c)] } else { f32::from(c) / 255.0 };
            }
        }
        sum
    }
}

/// Half as large; `cutoff`: alpha counts whole from there on, and not at all below.
fn halved<'a>(from: &Level<'_>, is_srgb: bool, cutoff: Option<f32>) -> Level<'a> {
    let (width, height) = (from.width / 2, from.height / 2);
    let table = &*LINEAR_FROM_SRGB;
    let texels: Vec<[u8; 4]> = (0..height)
        .into_par_iter()
        .flat_map_iter(|y| {
            (0..width).map(move |x| {
                let mut colour = [0.0f32; 3];
                let (mut plain, mut alpha, mut weight) = ([0.0f32; 3], 0.0f32, 0.0f32);
                for i in [0, 1, from.width, from.width + 1] {
                    let t = from.texels[2 * y * from.width + 2 * x + i];
                    let a = f32::from(t[3]);
                    let a = cutoff.map_or(a, |c| if a >= 255.0 * c { 255.0 } else { 0.0 });
                    alpha += a;
                    weight += a;
                    for k in 0..3 {
                        let c = if is_srgb {
                            table[usize::from(t[k])]
                        } else {
                            f32::from(t[k]) / 255.0
                        };
                        colour[k] += c * a;
                        plain[k] += c * 0.25;
                    }
                }
                let rgb = if weight > 0.0 { colour.map(|c| c / weight) } else { plain };
                let code = |c: f32| {
                    if is_srgb {
                        srgb_from_linear(c).round() as u8
                    } else {
                        (c * 255.0).round() as u8
                    }
                };
                [code(rgb[0]), code(rgb[1]), code(rgb[2]), (alpha * 0.25).round() as u8]
            })
        })
        .collect();
    Level { width, height, texels: Cow::Owned(texels) }
}

/// Share of texels whose alpha, times `gain`, passes the cutoff.
fn coverage(level: &Level<'_>, cutoff: f32, gain: f32) -> f32 {
    let passed = level.texels.iter().filter(|t| f32::from(t[3]) * gain >= cutoff * 255.0).count();
    passed as f32 / level.texels.len() as f32
}

fn keep_coverage(level: &mut Level<'_>, cutoff: f32, wanted: f32) {
    let (mut low, mut high) = (0.0f32, 8.0f32);
    for _ in 0..16 {
        let gain = 0.5 * (low + high);
        if coverage(level, cutoff, gain) < wanted { low = gain } else { high = gain }
    }
    // Equal alphas pass together: of the two sides of the step, take the nearer.
    let miss = |gain| (coverage(level, cutoff, gain) - wanted).abs();
    let gain = if miss(low) < miss(high) { low } else { high };
    for t in level.texels.to_mut() {
        t[3] = (f32::from(t[3]) * gain).round().min(255.0) as u8;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::seed::Seed;

    #[test]
    fn thin_leaves_keep_their_coverage_on_every_level() {
        let mut picture = Picture::filled(256, 256, [200, 10, 10, 0]);
        let mut draws = Seed::new(3).draws();
        for _ in 0..250 {
            let (x, y) = (draws.index(240) as u32, draws.index(240) as u32);
            for i in 0..12 {
                for j in 0..3 {
                    picture.set(x + i, y + i / 2 + j, [20, 160, 30, 255]);
                }
            }
        }
        let pyramid =
            Pyramid::new(&picture, Colorspace::Srgb, Some(0.5), Purpose::Outline).unwrap();
        let wanted = coverage(&pyramid.levels[0], 0.5, 1.0);
        for level in &pyramid.levels[1..] {
            let got = coverage(level, 0.5, 1.0);
            let texel = 1.0 / level.texels.len() as f32;
            assert!((got - wanted).abs() < 0.03 + texel.sqrt(), "{got} for {wanted}");
        }
        // The red behind the leaves never bleeds into what is seen.
        assert!(pyramid.levels[3].texels.iter().all(|t| t[3] == 0 || t[1] > t[0]));
    }

    #[test]
    fn what_a_mask_hides_counts_for_nothing_in_smaller_pictures() {
        // Lines an eighth apart, and between them alpha that the mask hides.
        let mut picture = Picture::filled(64, 64, [20, 160, 30, 110]);
        for (x, y) in (0..64).flat_map(|y| (0..8).map(move |x| (8 * x, y))) {
            picture.set(x, y, [90, 60, 30, 255]);
        }
        let pyramid =
            Pyramid::new(&picture, Colorspace::Srgb, Some(0.5), Purpose::Picture).unwrap();
        for (x, y) in [(0.3, 0.4), (0.7, 0.2)] {
            let [r, g, b] =
                pyramid.colour(Vec2::new(x, y), 3.0, Edge::Repeat).map(srgb_from_linear);
            assert!((r - 90.0).abs() < 1.0 && (g - 60.0).abs() < 1.0 && (b - 30.0).abs() < 1.0);
            let alpha = pyramid.alpha(Vec2::new(x, y), 3.0, Edge::Repeat);
            assert!((alpha - 0.125).abs() < 0.01, "{alpha}");
        }
    }

    #[test]
    fn opposite_edges_meet_only_where_the_texture_repeats() {
        let mut picture = Picture::filled(8, 8, [0, 0, 0, 255]);
        for y in 0..8 {
            picture.set(7, y, [255; 4]);
        }
        let p = Pyramid::new(&picture, Colorspace::Srgb, None, Purpose::Picture).unwrap();
        let at = Vec2::new(0.0, 0.5);
        assert!((p.colour(at, 0.0, Edge::Repeat)[0] - 0.5).abs() < 0.01);
        assert!(p.colour(at, 0.0, Edge::Clamp)[0] < 0.01);
    }

    #[test]
    fn the_first_row_is_at_v_one_and_averages_are_of_light() {
        let mut picture = Picture::filled(8, 8, [0, 0, 0, 255]);
        for x in 0..8 {
            for y in 0..4 {
                picture.set(x, y, [255, 255, 255, 255]);
            }
        }
        let p = Pyramid::new(&picture, Colorspace::Srgb, None, Purpose::Picture).unwrap();
        assert!(p.colour(Vec2::new(0.5, 0.8), 0.0, Edge::Repeat)[0] > 0.99);
        assert!(p.colour(Vec2::new(0.5, 0.2), 0.0, Edge::Repeat)[0] < 0.01);
        assert!((p.colour(Vec2::new(0.5, 0.5), 0.0, Edge::Repeat)[0] - 0.5).abs() < 0.01);
    }
}
