//! Where the bark of a stem's foot gives way to that of its upper part: one tile that is the one at its foot
//! and the other at its top, texel by texel. It goes on from a tile of the one and into a tile of the other
//! without a seam where all three are laid in the same way; only around does it tile.

use rayon::prelude::*;

use super::super::noise::{Noise, mix, smoothstep};
use super::{BARK_REPEAT_M, BarkPictures, Drawn, relief};
use crate::raster::Picture;
use crate::seed::Seed;
use crate::species::model::BarkStyle;

/// From its foot and from its top, so much of it is one bark alone: what reads it there, however coarse, finds
/// no other.
pub const PURE: f32 = 0.1;
/// Share of chance in which of the two a place has; the rest is the relief of the old one.
const CHANCE: f32 = 0.6;
/// How gradual it is within a texel's surroundings.
const SOFT: f32 = 0.035;

/// Whether plates are the last that is left of old bark, and not its furrows: where it falls off.
fn falls_off(upper: BarkStyle) -> bool {
    matches!(upper, BarkStyle::Flakes | BarkStyle::Scales | BarkStyle::Plates)
}

/// Pictures of the same size.
pub fn draw(old: &Drawn, upper: &Drawn, style: BarkStyle, seed: Seed) -> BarkPictures {
    let n = old.pictures.colour.width as usize;
    let share = shares(&old.heights, n, falls_off(style), seed);
    let mixed = |a: &Picture, b: &Picture| {
        let pixel = |((a, b), t): ((&[u8; 4], &[u8; 4]), &f32)| {
            std::array::from_fn(|c| mix(a[c].into(), b[c].into(), *t).round() as u8)
        };
        let data = a.data.par_iter().zip(&b.data).zip(&share).map(pixel).collect();
        Picture { width: a.width, height: a.height, data }
    };
    let [a, b] = [&old.pictures, &upper.pictures];
    let depth_m = a.depth_m.max(b.depth_m);
    // Both reach as far out.
    let level =
        |height: f32, of: &BarkPictures| 1.0 + (height - 1.0) * of.depth_m / depth_m.max(1e-9);
    let both = old.heights.par_iter().zip(&upper.heights).zip(&share);
    let heights: Vec<f32> = both.map(|((&h, &k), &t)| mix(level(h, a), level(k, b), t)).collect();
    let normal = match a.depth_m > 0.0 {
        true => normals(&heights, depth_m, [a, b], &share),
        false => mixed(&a.normal, &b.normal),
    };
    let height = heights.iter().map(|h| (255.0 * h).round().clamp(0.0, 255.0) as u8);
    BarkPictures {
        colour: mixed(&a.colour, &b.colour),
        normal,
        orm: mixed(&a.orm, &b.orm),
        height: Picture { data: height.map(|h| [h, h, h, 255]).collect(), ..a.height },
        depth_m,
    }
}

/// Those of the heights, but where there is one bark alone: foot and top have other neighbours than each other.
fn normals(
    heights: &[f32],
    depth_m: f32,
    [old, upper]: [&BarkPictures; 2],
    share: &[f32],
) -> Picture {
    let n = old.normal.width as usize;
    let mut normal = relief::normal_map(heights, n, depth_m / BARK_REPEAT_M);
    let rows = normal.data.par_chunks_mut(n).zip(share.par_chunks(n));
    let rows = rows.zip(old.normal.data.par_chunks(n)).zip(upper.normal.data.par_chunks(n));
    rows.for_each(|(((row, share), old), upper)| {
        if share.iter().all(|t| *t == 0.0) {
            row.copy_from_slice(old);
        } else if share.iter().all(|t| *t == 1.0) {
            row.copy_from_slice(upper);
        }
    });
    normal
}

/// Of the upper bark, texel by texel, the first row on top: over each row as much as it is high.
fn shares(old: &[f32], n: usize, falls_off: bool, seed: Seed) -> Vec<f32> {
    let noise = Noise::new(seed.derive("transition", 0), "tongues").for_side(n);
    let rank = ranks(old);
    let place = |i: usize| [i % n, i / n].map(|k| (k as f32 + 0.5) / n as f32);
    let every = || (0..n * n).into_par_iter().with_min_len(n);
    let chance = |i: usize| {
        let [u, v] = place(i);
        // Tongues are longer than they are wide.
        0.5 + 0.5 * noise.fractal(u, v, [5, 2], 4)
    };
    let chance = ranks(&every().map(chance).collect::<Vec<_>>());
    let holds = |i: usize| mix(if falls_off { rank[i] } else { 1.0 - rank[i] }, chance[i], CHANCE);
    let holds = ranks(&every().map(holds).collect::<Vec<_>>());
    let share = |i: usize| {
        let up = (1.0 - place(i)[1] - PURE) / (1.0 - 2.0 * PURE);
        let up = -SOFT + (1.0 + 2.0 * SOFT) * up.clamp(0.0, 1.0);
        smoothstep(holds[i] - SOFT, holds[i] + SOFT, up)
    };
    every().map(share).collect()
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
