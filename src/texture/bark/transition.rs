//! Where the bark of a stem's foot gives way to that of its upper part: [`TILES`] tiles, drawn as high as one,
//! that are the one at their foot and the other at their top, texel by texel. They go on from a tile of the one
//! and into a tile of the other without a seam where all are laid in the same way; only around do they tile.

use glam::Vec3;
use rayon::prelude::*;

use super::super::noise::{Noise, mix, smoothstep};
use super::{BARK_REPEAT_M, BarkPictures, Drawn, relief};
use crate::raster::Picture;
use crate::seed::Seed;
use crate::species::model::BarkStyle;

/// From its foot and from its top, so much of it is one bark alone: what reads it there, however coarse, finds
/// no other.
pub const PURE: f32 = 0.1;
/// How many tiles of bark are as long as the picture is high: over one, the change would be a cuff.
pub const TILES: usize = 3;
/// Share of chance in which of the two a place has; the rest is the relief of the old one.
const CHANCE: f32 = 0.6;
/// How gradual it is within a texel's surroundings.
const SOFT: f32 = 0.035;

/// Whether plates are the last that is left of old bark, and not its furrows: where it falls off.
fn falls_off(upper: BarkStyle) -> bool {
    matches!(upper, BarkStyle::Flakes | BarkStyle::Scales | BarkStyle::Plates)
}

/// A bark over [`TILES`] tiles, row by row from the top.
struct Tall<'a> {
    drawn: &'a Drawn,
    n: usize,
    /// By so many rows, so that it goes on in the tile that it meets.
    moved: usize,
}

impl Tall<'_> {
    /// Which texel of the tile one is.
    fn of(&self, texel: usize) -> usize {
        let n = self.n;
        (texel / n + self.moved) % n * n + texel % n
    }

    fn heights(&self) -> Vec<f32> {
        let all = (0..TILES * self.n * self.n).into_par_iter().with_min_len(self.n);
        all.map(|i| self.drawn.heights[self.of(i)]).collect()
    }
}

/// Pictures of the same size.
pub fn draw(old: &Drawn, upper: &Drawn, style: BarkStyle, seed: Seed) -> BarkPictures {
    let n = old.pictures.colour.width as usize;
    let moved = (0.5 * PURE * ((TILES - 1) * n) as f32).round() as usize % n.max(1);
    let old = Tall { drawn: old, n, moved };
    let upper = Tall { drawn: upper, n, moved: n - moved };
    let heights = [&old, &upper].map(Tall::heights);
    let share = shares(&heights[0], n, falls_off(style), seed);
    let [a, b] = [&old, &upper].map(|tall| &tall.drawn.pictures);
    let depth_m = a.depth_m.max(b.depth_m);
    let mixed = |i: usize, [a, b]: [&Picture; 2]| {
        let (a, b) = (a.data[old.of(i)], b.data[upper.of(i)]);
        std::array::from_fn(|c| mix(a[c].into(), b[c].into(), share[i]))
    };
    let picture = |data: Vec<[u8; 4]>| Picture { data, ..a.colour };
    let bytes = |texels: Vec<[f32; 4]>| texels.iter().map(|t| t.map(|c| c.round() as u8)).collect();
    let of = |pictures| picture(bytes(shortened(n, |i| mixed(i, pictures))));
    // Both reach as far out.
    let level =
        |height: f32, of: &BarkPictures| 1.0 + (height - 1.0) * of.depth_m / depth_m.max(1e-9);
    let both = heights[0].par_iter().zip(&heights[1]).zip(&share);
    let heights: Vec<f32> = both.map(|((&h, &k), &t)| mix(level(h, a), level(k, b), t)).collect();
    // Those of the heights, but where there is one bark alone: foot and top have other neighbours than each other.
    let normals = match a.depth_m > 0.0 {
        true => {
            let own = relief::normal_map(&heights, n, depth_m / BARK_REPEAT_M);
            let is_pure =
                |row: &[f32]| row.iter().all(|t| *t == row[0] && (*t == 0.0 || *t == 1.0));
            let is_pure: Vec<bool> = share.chunks_exact(n).map(is_pure).collect();
            shortened(n, |i| match is_pure[i / n] {
                true => mixed(i, [&a.normal, &b.normal]),
                false => own.data[i].map(f32::from),
            })
        }
        false => shortened(n, |i| mixed(i, [&a.normal, &b.normal])),
    };
    let unit = |[x, y, z, alpha]: [f32; 4]| {
        let [x, y, z] = (Vec3::new(x, y, z) - 127.5).normalize_or(Vec3::Z).to_array();
        [127.5 + 127.5 * x, 127.5 + 127.5 * y, 127.5 + 127.5 * z, alpha]
    };
    let height = shortened(n, |i| [heights[i]]);
    let height = height.iter().map(|[h]| (255.0 * h).round().clamp(0.0, 255.0) as u8);
    BarkPictures {
        colour: of([&a.colour, &b.colour]),
        normal: picture(bytes(normals.into_iter().map(unit).collect())),
        orm: of([&a.orm, &b.orm]),
        height: picture(height.map(|h| [h, h, h, 255]).collect()),
        depth_m,
    }
}

/// What is [`TILES`] tiles high, as high as one: the mean of as many rows.
fn shortened<const C: usize>(n: usize, texel: impl Fn(usize) -> [f32; C] + Sync) -> Vec<[f32; C]> {
    let mean = |i: usize| {
        let rows = (0..TILES).map(|k| texel((i / n * TILES + k) * n + i % n));
        let sum = rows.fold([0.0; C], |sum, t| std::array::from_fn(|c| sum[c] + t[c]));
        sum.map(|c| c / TILES as f32)
    };
    (0..n * n).into_par_iter().with_min_len(n.max(1)).map(mean).collect()
}

/// Of the upper bark, texel by texel of [`TILES`] tiles, the first row on top: over each row as much as it is
/// high.
fn shares(old: &[f32], n: usize, falls_off: bool, seed: Seed) -> Vec<f32> {
    let noise = Noise::new(seed.derive("transition", 0), "tongues").for_side(n);
    let rank = ranks(old);
    let every = |rows: usize| (0..rows * n).into_par_iter().with_min_len(n.max(1));
    let chance = |i: usize| {
        let [u, v] = [i % n, i / n].map(|k| (k as f32 + 0.5) / n as f32);
        // Tongues are longer than they are wide.
        0.5 + 0.5 * noise.fractal(u, v, [5, 3], 4)
    };
    let chance = ranks(&every(n).map(chance).collect::<Vec<_>>());
    let holds = |i: usize| {
        let chance = chance[i / n / TILES * n + i % n];
        mix(if falls_off { rank[i] } else { 1.0 - rank[i] }, chance, CHANCE)
    };
    let holds = ranks(&every(TILES * n).map(holds).collect::<Vec<_>>());
    let share = |i: usize| {
        let up = 1.0 - (i / n) as f32 / (TILES * n) as f32;
        let up = (up - PURE) / (1.0 - 2.0 * PURE);
        let up = -SOFT + (1.0 + 2.0 * SOFT) * up.clamp(0.0, 1.0);
        smoothstep(holds[i] - SOFT, holds[i] + SOFT, up)
    };
    every(TILES * n).map(share).collect()
}

/// Of each height, the share that is lower.
fn ranks(heights: &[f32]) -> Vec<f32> {
    const BINS: usize = 1024;
    let bin = |h: f32| ((h.clamp(0.0, 1.0) * BINS as f32) as usize).min(BINS - 1);
    let mut below = vec![0usize; BINS + 1];
    heights.iter().for_each(|h| below[bin(*h) + 1] += 1);
    for k in 0..BINS {
        below[k + 1] += below[k];
    }
    let all = heights.len().max(1) as f32;
    heights.par_iter().map(|&h| below[bin(h)] as f32 / all).collect()
}
