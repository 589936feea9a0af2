//! What lies on the bark: lenticels, diamonds, rifts, the scars of branches; and where it has
//! fallen off.

use rayon::prelude::*;

use super::super::noise::{Noise, mix, smoothstep};
use super::Texel;
use crate::seed::{Draws, Seed};
use crate::species::model::BarkStyle;

pub fn marks(texels: &mut [Texel], n: usize, style: BarkStyle, seed: Seed) {
    let mut draws = seed.derive("marks", 0).draws();
    let mut tile = Tile { texels, n };
    match style {
        BarkStyle::Birch | BarkStyle::Paper => {
            tile.lenticels(150, [0.004, 0.02], [0.0011, 0.0024], 0.75, &mut draws);
            tile.lenticels(60, [0.02, 0.06], [0.0016, 0.0036], 0.9, &mut draws);
            // The foot has its own rifts.
            let (rifts, scars) = if style == BarkStyle::Birch { (0, 0) } else { (2, 6) };
            for _ in 0..scars {
                tile.scar(&mut draws);
            }
            for _ in 0..rifts {
                tile.rift(&mut draws);
            }
        }
        BarkStyle::Smooth => {
            tile.lenticels(220, [0.003, 0.012], [0.001, 0.0024], -0.6, &mut draws);
            tile.lenticels(110, [0.009, 0.024], [0.0022, 0.0046], -0.9, &mut draws);
        }
        BarkStyle::Diamonds => {
            for _ in 0..42 {
                tile.row_of_diamonds(&mut draws);
            }
            for _ in 0..3 {
                tile.scar(&mut draws);
            }
        }
        BarkStyle::Blisters => {
            for _ in 0..240 {
                tile.blister(&mut draws);
            }
        }
        BarkStyle::Plates
        | BarkStyle::Flakes
        | BarkStyle::Ridges
        | BarkStyle::Furrows
        | BarkStyle::Scales => {}
    }
}

struct Tile<'a> {
    texels: &'a mut [Texel],
    n: usize,
}

impl Tile<'_> {
    /// Changes the texels of a box of half sizes `half` around `at`, across the edges; `change`
    /// is given x, y in −1…1 (y up).
    fn stamp(&mut self, at: [f32; 2], half: [f32; 2], change: impl Fn(&mut Texel, f32, f32)) {
        let n = self.n;
        let half = half.map(|h| h.max(0.7 / n as f32));
        let reach = |h: f32| ((h * n as f32).ceil() as i64 + 1).min(n as i64 / 2);
        let (rx, ry) = (reach(half[0]), reach(half[1]));
        let centre = [at[0] * n as f32, (1.0 - at[1]) * n as f32];
        for dy in -ry..ry {
            for dx in -rx..rx {
                let (px, py) = (centre[0].floor() as i64 + dx, centre[1].floor() as i64 + dy);
                let x = (px as f32 + 0.5 - centre[0]) / (half[0] * n as f32);
                let y = -(py as f32 + 0.5 - centre[1]) / (half[1] * n as f32);
                if x.abs() > 1.0 || y.abs() > 1.0 {
                    continue;
                }
                let at = py.rem_euclid(n as i64) as usize * n + px.rem_euclid(n as i64) as usize;
                if let Some(texel) = self.texels.get_mut(at) {
                    change(texel, x, y);
                }
            }
        }
    }

    /// Lens-shaped pores across the stem; a negative `strength` raises them and darkens less.
    fn lenticels(
        &mut self,
        count: usize,
        width: [f32; 2],
        tall: [f32; 2],
        strength: f32,
        draws: &mut Draws,
    ) {
        for _ in 0..count {
            let at = [draws.unit(), draws.unit()];
            let half = [draws.between(width[0], width[1]), draws.between(tall[0], tall[1])];
            let dark = strength.abs() * draws.between(0.6, 1.1);
            let bow = draws.between(-0.35, 0.35);
            self.stamp(at, [half[0], half[1] * 1.4], |t, x, y| {
                let y = 1.4 * y - bow * x * x;
                let opacity = dark.min(1.0) * smoothstep(0.0, 0.5, 1.0 - x * x - y.abs());
                t.darken(opacity, 1.15);
                t.height -= 0.22 * strength.signum() * opacity;
                t.roughness = mix(t.roughness, 0.9, opacity);
            });
        }
    }

    /// The black moustache over an old branch, with a rough knot below it.
    fn scar(&mut self, draws: &mut Draws) {
        let at = [draws.unit(), draws.unit()];
        let size = draws.between(0.014, 0.05);
        let rough = Noise::new(Seed::new(draws.bits()), "scar");
        self.stamp(at, [1.9 * size, size], |t, x, y| {
            let edge = rough.fractal(x * 0.25 + 0.5, y * 0.25 + 0.5, [12, 12], 4);
            let brow = 0.42 - 0.85 * x.abs() + 0.12 * edge;
            let thick = 0.26 * (1.0 - x.abs()) + 0.06 * edge;
            let arch = smoothstep(0.0, 0.14, thick - (y - brow).abs());
            let (kx, ky) = (x * 2.6, (y + 0.28) * 1.7);
            let knot = smoothstep(0.0, 0.3, 1.0 - (kx * kx + ky * ky).sqrt() + 0.3 * edge);
            let opacity = arch.max(0.85 * knot);
            t.darken(opacity, 0.8 + 0.35 * edge);
            t.height += (0.25 * knot - 0.2 * arch) * (1.0 + edge);
            t.roughness = mix(t.roughness, 0.95, opacity);
        });
    }

    /// A diamond where the white skin has split over rough black bark.
    fn rift(&mut self, draws: &mut Draws) {
        let at = [draws.unit(), draws.unit()];
        let half = [draws.between(0.014, 0.03), draws.between(0.035, 0.09)];
        let rough = Noise::new(Seed::new(draws.bits()), "rift");
        self.stamp(at, [1.35 * half[0], 1.2 * half[1]], |t, x, y| {
            let (p, q) = (0.5 + 0.5 * x, 0.5 + 0.5 * y);
            let edge = rough.fractal(p, q, [7, 9], 4);
            let inside = 1.0 - (1.35 * x.abs()).powf(1.1) - 1.2 * y.abs() + 0.34 * edge;
            let split = smoothstep(0.0, 0.07, inside);
            let lip = smoothstep(-0.14, 0.0, inside) * (1.0 - split);
            let c = rough.cells(p + 0.08 * edge, q, [6, 5], 0.95);
            let cork = smoothstep(0.0, 0.3, c.border + 0.06 * edge);
            t.darken(split, 0.62 + 0.75 * cork * (0.7 + 0.5 * c.draw) + 0.2 * edge);
            t.darken(0.4 * lip, 2.2);
            t.height = mix(t.height, 0.05 + 0.95 * cork * (0.6 + 0.4 * c.draw), split) + 0.18 * lip;
            t.roughness = mix(t.roughness, 0.95, split);
        });
    }

    /// Dark diamonds side by side, as on young aspen and goat willow.
    fn row_of_diamonds(&mut self, draws: &mut Draws) {
        let (start, v) = (draws.unit(), draws.unit());
        let count = 1 + draws.index(6);
        let large = draws.between(0.6, 1.5);
        for k in 0..count {
            let at = [
                start + 0.021 * large * (k as f32 + draws.between(-0.3, 0.3)),
                v + draws.between(-0.012, 0.012),
            ];
            let w = large * draws.between(0.003, 0.0095);
            let half = [w, w * draws.between(0.8, 1.9)];
            let noise = Noise::new(Seed::new(draws.bits()), "diamond");
            let dark = draws.between(0.7, 1.0);
            self.stamp(at.map(|c| c.rem_euclid(1.0)), [1.5 * half[0], 1.5 * half[1]], |t, x, y| {
                let edge = noise.gradient(0.5 + 0.5 * x, 0.5 + 0.5 * y, [5, 5]);
                let inside = 1.0 - 1.5 * (x.abs() + y.abs()) + 0.25 * edge;
                let pit = smoothstep(0.0, 0.3, inside);
                let rim = smoothstep(-0.5, -0.1, inside) * (1.0 - pit);
                t.darken(dark * pit, 0.95 + 0.3 * edge);
                t.height += 0.35 * rim - 0.5 * pit;
                t.shade *= 1.0 + 0.05 * rim;
                t.roughness = mix(t.roughness, 0.92, pit);
            });
        }
    }

    /// A raised blister of resin, wider than high.
    fn blister(&mut self, draws: &mut Draws) {
        let at = [draws.unit(), draws.unit()];
        let w = draws.between(0.003, 0.011);
        self.stamp(at, [w, w * draws.between(0.45, 0.75)], |t, x, y| {
            let dome = smoothstep(0.0, 1.0, 1.0 - x * x - y * y);
            t.height += 0.6 * dome;
            t.shade *= 1.0 + 0.1 * dome - 0.1 * smoothstep(0.0, 0.4, dome) * (1.0 - dome);
            t.roughness = mix(t.roughness, 0.5, 0.6 * dome);
        });
    }
}

impl Texel {
    /// Lays a mark of this opacity and brightness over what is there.
    fn darken(&mut self, opacity: f32, shade: f32) {
        let opacity = opacity.clamp(0.0, 1.0);
        self.mark_shade = mix(self.mark_shade, shade, opacity / opacity.max(self.mark).max(1e-6));
        self.mark = 1.0 - (1.0 - self.mark) * (1.0 - opacity);
    }
}

/// Takes the bark off a share of the tile, in upright strips (short pieces would ring thin branches):
/// grey wood with upright cracks shows.
pub fn fallen(texels: &mut [Texel], n: usize, share: f32, seed: Seed) {
    let share = share.clamp(0.0, 1.0);
    if share <= 0.0 {
        return;
    }
    let [pieces, ragged, grain] = ["pieces", "ragged", "grain"].map(|name| Noise::new(seed, name));
    let place = |i: usize| {
        let u = ((i % n) as f32 + 0.5) / n as f32;
        (u, 1.0 - ((i / n) as f32 + 0.5) / n as f32)
    };
    let holds: Vec<f32> = (0..texels.len())
        .into_par_iter()
        .map(|i| {
            let (u, v) = place(i);
            let wu = u + 0.02 * ragged.fractal(u, v, [10, 8], 4);
            let c =
                pieces.cells(wu, v + 0.03 * ragged.fractal(u + 0.4, v, [9, 6], 3), [8, 1], 0.95);
            c.draw + 0.8 * pieces.fractal(u, v, [4, 1], 3) + 0.1 * ragged.fractal(u, v, [30, 24], 3)
        })
        .collect();
    let mut sorted = holds.clone();
    sorted.par_sort_unstable_by(f32::total_cmp);
    let limit = if share >= 1.0 {
        f32::INFINITY
    } else {
        sorted.get((share * sorted.len() as f32) as usize).copied().unwrap_or(f32::INFINITY)
    };
    texels.par_iter_mut().zip(holds).enumerate().for_each(|(i, (t, hold))| {
        let bare = smoothstep(-0.02, 0.02, limit - hold);
        if bare <= 0.0 {
            return;
        }
        let (u, v) = place(i);
        let lean = u + 0.04 * (std::f32::consts::TAU * v).sin() * 0.5;
        let fibre = grain.fractal(lean, v, [90, 5], 4);
        let stain = ragged.fractal(u + 0.7, v, [5, 2], 4);
        // Cracks along the fibre, that end.
        let line = grain.fractal(lean + 0.003 * fibre, v + 0.3, [22, 3], 2).abs();
        let here = smoothstep(-0.1, 0.25, ragged.fractal(lean + 0.2, v, [14, 4], 2));
        let check = here * (1.0 - smoothstep(0.005, 0.035, line));
        let wood = -0.35 + 0.1 * fibre - 0.3 * check;
        t.height = mix(t.height, wood, bare);
        t.wood = bare;
        t.wood_shade = (0.95 + 0.22 * fibre + 0.22 * stain) * (1.0 - 0.55 * check);
        t.roughness = mix(t.roughness, 0.85, bare);
    });
}
