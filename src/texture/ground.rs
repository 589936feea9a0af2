//! A tile of forest floor for terrain without a photo: moss and soil under needles and litter.

use rayon::prelude::*;

use super::noise::{Noise, mix, smoothstep};
use crate::raster::Picture;
use crate::seed::Seed;

/// One tile of forest floor shows this many metres.
pub const GROUND_REPEAT_M: f32 = 4.0;

const MOSS: [f32; 3] = [84.0, 92.0, 52.0];
const PALE_MOSS: [f32; 3] = [112.0, 114.0, 70.0];
const SOIL: [f32; 3] = [74.0, 60.0, 45.0];
const LITTER: [[f32; 3]; 5] = [
    [128.0, 98.0, 64.0],
    [104.0, 78.0, 50.0],
    [146.0, 122.0, 82.0],
    [88.0, 70.0, 52.0],
    [118.0, 112.0, 70.0],
];

/// The tile, `size_px` square, opaque, seamless.
pub fn draw(size_px: u32, seed: Seed) -> Picture {
    let n = size_px.max(16) as usize;
    let broad = Noise::new(seed, "ground-broad");
    let fine = Noise::new(seed, "ground-fine");
    let mut colour: Vec<[f32; 3]> = (0..n * n)
        .into_par_iter()
        .with_min_len(n)
        .map(|i| {
            let (u, v) = (((i % n) as f32 + 0.5) / n as f32, ((i / n) as f32 + 0.5) / n as f32);
            let cover = broad.fractal(u, v, [5, 5], 5);
            let clump = broad.fractal(u + 0.5, v, [22, 22], 3);
            let grain = fine.fractal(u, v, [90, 90], 2);
            let moss = smoothstep(-0.25, 0.3, cover + 0.25 * clump);
            let pale = smoothstep(0.0, 0.6, clump + 0.5 * grain);
            [0, 1, 2].map(|c| {
                let green = mix(MOSS[c], PALE_MOSS[c], 0.6 * pale);
                mix(SOIL[c], green, 0.75 * moss) * (1.0 + 0.22 * grain + 0.12 * clump)
            })
        })
        .collect();
    let mut draws = seed.derive("litter", 0).draws();
    let metre = n as f32 / GROUND_REPEAT_M;
    for _ in 0..5200 {
        let at = [draws.between(0.0, n as f32), draws.between(0.0, n as f32)];
        let cover = broad.fractal(at[0] / n as f32, at[1] / n as f32, [5, 5], 5);
        // Litter lies thinner on moss.
        if draws.unit() < 0.75 * smoothstep(-0.3, 0.4, cover) {
            continue;
        }
        let leaf = draws.unit() < 0.45;
        let length =
            metre * if leaf { draws.between(0.02, 0.045) } else { draws.between(0.03, 0.13) };
        let half = if leaf { 0.3 * length } else { (0.004 * metre).max(0.5) };
        let (sin, cos) = draws.between(0.0, std::f32::consts::TAU).sin_cos();
        let tone = LITTER[draws.index(LITTER.len())];
        let shade = draws.between(0.75, 1.15);
        let reach = (length * 0.5 + 1.0).ceil() as i64;
        for dy in -reach..=reach {
            for dx in -reach..=reach {
                let (x, y) = (dx as f32 * cos + dy as f32 * sin, dy as f32 * cos - dx as f32 * sin);
                let along = (2.0 * x / length).abs();
                if along >= 1.0 {
                    continue;
                }
                let width = if leaf { half * (1.0 - along * along) } else { half };
                let opacity = (width - y.abs() + 0.5).clamp(0.0, 1.0) * 0.8;
                let px = (at[0] as i64 + dx).rem_euclid(n as i64) as usize;
                let py = (at[1] as i64 + dy).rem_euclid(n as i64) as usize;
                let c = &mut colour[py * n + px];
                let light = shade * (1.0 - 0.15 * (y / half.max(0.5)).clamp(-1.0, 1.0));
                for k in 0..3 {
                    c[k] = mix(c[k], tone[k] * light, opacity);
                }
            }
        }
    }
    let byte = |c: f32| c.round().clamp(0.0, 255.0) as u8;
    let data = colour.iter().map(|c| [byte(c[0]), byte(c[1]), byte(c[2]), 255]).collect();
    Picture { width: n as u32, height: n as u32, data }
}
