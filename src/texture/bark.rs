//! Bark as a relief and its colours, on a torus: the picture tiles in both directions.

use rayon::prelude::*;

use super::noise::{Noise, mix, smoothstep};
use crate::raster::Picture;
use crate::seed::{Draws, Seed};
use crate::species::model::{Bark, BarkStyle};

/// One tile of bark shows this many metres in both directions.
pub const BARK_REPEAT_M: f32 = 1.0;

/// What the bark is like at a place, whatever its colours.
#[derive(Clone, Copy, Default)]
struct Texel {
    /// 0…1 of the relief.
    height: f32,
    /// From furrow (0) to ridge (1).
    tone: f32,
    /// Brightness.
    shade: f32,
    /// Shift to red.
    warm: f32,
    /// Share of buff fresh skin.
    fresh: f32,
    /// Share of a dark mark, and its brightness.
    mark: f32,
    mark_shade: f32,
}

impl Texel {
    fn new(height: f32, tone: f32, shade: f32, warm: f32) -> Self {
        Texel { height, tone, shade, warm, ..Texel::default() }
    }

    fn colour(&self, light: [f32; 3], dark: [f32; 3]) -> [u8; 4] {
        const RED: [f32; 3] = [1.0, 0.0, -1.0];
        const BUFF: [f32; 3] = [0.97, 0.87, 0.77];
        let [r, g, b] = [0, 1, 2].map(|c| {
            let bark = mix(dark[c], light[c], self.tone)
                * self.shade
                * (1.0 + RED[c] * self.warm)
                * mix(1.0, BUFF[c], self.fresh);
            mix(bark, dark[c] * self.mark_shade, self.mark).round().clamp(0.0, 255.0) as u8
        });
        [r, g, b, 255]
    }
}

/// The pictures of one bark.
pub struct BarkPictures {
    pub colour: Picture,
    /// In the colour of the upper stem.
    pub upper: Option<Picture>,
    /// Tangent-space normals, raw, +Y up the stem.
    pub normal: Picture,
}

/// Draws a bark, `size_px` square.
pub fn draw(bark: &Bark, size_px: u32, seed: Seed) -> BarkPictures {
    let n = size_px.max(16) as usize;
    let painter = Painter {
        warp: Noise::new(seed, "warp"),
        broad: Noise::new(seed, "broad"),
        fine: Noise::new(seed, "fine"),
        cells: Noise::new(seed, "cells"),
    };
    let mut texels: Vec<Texel> = (0..n * n)
        .into_par_iter()
        .with_min_len(n)
        .map(|i| {
            let u = ((i % n) as f32 + 0.5) / n as f32;
            // v up: row 0 is the top.
            let v = 1.0 - ((i / n) as f32 + 0.5) / n as f32;
            match bark.style {
                BarkStyle::Birch => painter.birch(u, v),
                BarkStyle::Plates => painter.plates(u, v),
                BarkStyle::Furrows => painter.furrows(u, v),
                BarkStyle::Scales => painter.scales(u, v),
                BarkStyle::Smooth => painter.smooth(u, v),
            }
        })
        .collect();
    marks(&mut texels, n, bark.style, &mut seed.derive("marks", 0).draws());
    let dark = bark.dark.map(f32::from);
    let paint = |light: [u8; 3]| {
        let light = light.map(f32::from);
        let data = texels.iter().map(|t| t.colour(light, dark)).collect();
        Picture { width: n as u32, height: n as u32, data }
    };
    let heights: Vec<f32> = texels.iter().map(|t| t.height).collect();
    BarkPictures {
        colour: paint(bark.colour),
        upper: bark.upper.map(paint),
        normal: normal_map(&heights, n, bark.relief_m.clamp(0.0, 0.2) / BARK_REPEAT_M),
    }
}

/// The normals of a tiling height field; `relief` is the height of 1 in tile widths.
pub fn normal_map(height: &[f32], n: usize, relief: f32) -> Picture {
    let mut picture = Picture::filled(n as u32, n as u32, [128, 128, 255, 255]);
    if height.len() != n * n || n == 0 {
        return picture;
    }
    // Central differences over two texels of 1 / n.
    let slope = relief * n as f32 * 0.5;
    for y in 0..n {
        let (above, below) = ((y + n - 1) % n * n, (y + 1) % n * n);
        for x in 0..n {
            let (left, right) = ((x + n - 1) % n, (x + 1) % n);
            let dx = (height[y * n + right] - height[y * n + left]) * slope;
            let dy = (height[above + x] - height[below + x]) * slope;
            let length = (dx * dx + dy * dy + 1.0).sqrt();
            let byte = |c: f32| (127.5 + 127.5 * c / length).round().clamp(0.0, 255.0) as u8;
            picture.data[y * n + x] = [byte(-dx), byte(-dy), byte(1.0), 255];
        }
    }
    picture
}

struct Painter {
    warp: Noise,
    broad: Noise,
    fine: Noise,
    cells: Noise,
}

impl Painter {
    /// Tall plates with stepped flakes, parted by deep furrows.
    fn plates(&self, u: f32, v: f32) -> Texel {
        let wu = u + 0.022 * self.warp.fractal(u, v, [9, 6], 3);
        let wv = v + 0.03 * self.broad.fractal(u, v, [8, 8], 3);
        let c = self.cells.cells(wu, wv, [8, 4], 0.95);
        let small = self.cells.cells(wu + 0.37, wv + 0.11, [16, 12], 0.9);
        let plate = smoothstep(0.0, 0.12, c.border + 0.03 * self.fine.gradient(u, v, [40, 30]));
        let crack = smoothstep(0.0, 0.07, small.border);
        let grain = self.fine.fractal(u, v, [30, 14], 4);
        // Flakes lie in layers: a quantised height with soft risers.
        let layer = 2.5 * (0.5 + 0.5 * self.broad.fractal(wu, wv, [12, 7], 4)) + 1.2 * c.draw;
        let step = layer.floor() + smoothstep(0.7, 1.0, layer.fract());
        let height = plate * (0.45 + 0.13 * step.min(4.0)) * mix(0.75, 1.0, crack) + 0.06 * grain;
        let shade = (0.86 + 0.1 * step.min(3.0) / 3.0 + 0.16 * grain) * (0.9 + 0.2 * c.draw);
        let warm = 0.10 * (small.draw - 0.5) + 0.06 * grain;
        Texel::new(height, plate * mix(0.6, 1.0, crack), shade, warm)
    }

    /// Long ridges that part and join, broken across by fine cracks.
    fn furrows(&self, u: f32, v: f32) -> Texel {
        let wu = u + 0.02 * self.warp.fractal(u, v, [7, 5], 3);
        let wv = v + 0.03 * self.broad.gradient(u, v, [6, 5]);
        // Furrows run where either of two stretched fields changes sign: they part and join.
        let one = self.cells.gradient(wu, wv, [15, 3]).abs();
        let two = self.warp.gradient(wu + 0.31, wv + 0.17, [19, 4]).abs();
        let ridge = smoothstep(0.03, 0.32, one) * (0.35 + 0.65 * smoothstep(0.0, 0.2, two));
        let grain = self.fine.fractal(wu, v, [44, 8], 4);
        let cross = self.broad.fractal(wu, wv, [16, 34], 3);
        let broken = 1.0 - 0.5 * smoothstep(0.2, 0.45, cross);
        let patch = self.broad.fractal(u + 0.6, v, [5, 3], 3);
        let height = ridge.powf(0.8) * (0.78 + 0.2 * grain) * broken;
        let tone = (ridge * broken).clamp(0.0, 1.0).powf(0.7);
        let shade = 0.95 + 0.26 * grain + 0.12 * patch;
        Texel::new(height, tone, shade, 0.05 * patch + 0.03 * cross)
    }

    /// Small thin scales, loose at their lower edge.
    fn scales(&self, u: f32, v: f32) -> Texel {
        let wu = u + 0.012 * self.warp.fractal(u, v, [14, 12], 3);
        let wv = v + 0.014 * self.broad.fractal(u, v, [12, 12], 3);
        let c = self.cells.cells(wu, wv, [22, 17], 0.9);
        let grain = self.fine.fractal(u, v, [48, 36], 3);
        let patch = self.broad.fractal(u, v, [4, 3], 3);
        let body = smoothstep(0.0, 0.16, c.border);
        // The scale lifts towards its lower end.
        let lift = (0.5 - 0.8 * c.offset[1]).clamp(0.0, 1.0);
        let height = body * (0.35 + 0.5 * lift + 0.2 * c.draw) + 0.1 * grain;
        let shade = 0.9 + 0.2 * (c.draw - 0.5) + 0.14 * grain + 0.1 * lift + 0.14 * patch;
        Texel::new(height, 0.25 + 0.75 * body, shade, 0.10 * (c.draw - 0.5))
    }

    /// Smooth skin with fine streaks and slight folds.
    fn smooth(&self, u: f32, v: f32) -> Texel {
        let wu = u + 0.02 * self.warp.fractal(u, v, [5, 4], 3);
        let broad = self.broad.fractal(wu, v, [4, 3], 4);
        let streak = self.fine.fractal(wu, v, [40, 5], 4);
        let crack = smoothstep(0.38, 0.62, self.warp.fractal(wu + 0.3, v, [16, 4], 4));
        let height = 0.6 + 0.2 * broad + 0.12 * streak - 0.35 * crack;
        let tone = (0.9 + 0.12 * broad - 0.5 * crack).clamp(0.0, 1.0);
        Texel::new(height, tone, 0.97 + 0.12 * streak, 0.04 * broad)
    }

    /// Paper-white skin in faint bands, peeling here and there.
    fn birch(&self, u: f32, v: f32) -> Texel {
        let wv = v + 0.012 * self.warp.fractal(u, v, [4, 9], 3);
        let band = self.broad.fractal(u, wv, [3, 26], 3);
        let cloud = self.broad.fractal(u + 0.4, v, [4, 4], 4);
        let thread = self.fine.fractal(u, wv, [10, 90], 2);
        let peel = smoothstep(0.42, 0.6, self.warp.fractal(u + 0.2, wv, [4, 14], 4));
        let height = 0.6 + 0.12 * band + 0.05 * thread - 0.25 * peel;
        let tone = (0.95 + 0.04 * band - 0.10 * smoothstep(0.1, 0.7, cloud)).clamp(0.0, 1.0);
        let shade = 0.985 + 0.035 * thread + 0.03 * band;
        // Fresh skin shows under the peel.
        Texel { fresh: 0.8 * peel, ..Texel::new(height, tone, shade, 0.015 * cloud) }
    }
}

/// What lies on the bark: lenticels, and for birch black scars.
fn marks(texels: &mut [Texel], n: usize, style: BarkStyle, draws: &mut Draws) {
    match style {
        BarkStyle::Birch => {
            for _ in 0..170 {
                let half = [draws.between(0.006, 0.045), draws.between(0.0012, 0.0035)];
                let at = [draws.unit(), draws.unit()];
                lens(texels, n, at, half, draws.between(0.45, 0.95), 0.2);
            }
            for _ in 0..9 {
                scar(texels, n, draws);
            }
        }
        BarkStyle::Smooth => {
            for _ in 0..110 {
                let w = draws.between(0.004, 0.013);
                let (at, tall) = ([draws.unit(), draws.unit()], draws.between(0.4, 0.9));
                lens(texels, n, at, [w, w * tall], draws.between(0.35, 0.8), -0.25);
            }
        }
        _ => {}
    }
}

/// A lens-shaped mark; `sink` lowers (or, below 0, raises) the relief.
fn lens(texels: &mut [Texel], n: usize, at: [f32; 2], half: [f32; 2], strength: f32, sink: f32) {
    stamp(texels, n, at, [half[0], half[1].max(0.7 / n as f32)], 1.0, sink, |x, y| {
        strength * smoothstep(0.0, 0.5, 1.0 - x * x - y.abs())
    });
}

/// The black moustache over an old branch, with a rough diamond below it.
fn scar(texels: &mut [Texel], n: usize, draws: &mut Draws) {
    let at = [draws.unit(), draws.unit()];
    let size = draws.between(0.035, 0.085);
    let rough = Noise::new(Seed::new(draws.bits()), "scar");
    stamp(texels, n, at, [1.5 * size, size], 0.7, 0.3, |x, y| {
        let edge = 0.22 * rough.fractal(x * 0.25 + 0.5, y * 0.25 + 0.5, [12, 12], 3);
        let brow = 0.35 - 0.9 * x.abs() + edge;
        let thick = 0.36 * (1.0 - x.abs());
        let arch = smoothstep(0.0, 0.16, thick - (y - brow).abs());
        let body = smoothstep(0.0, 0.25, 0.42 - x.abs() * 1.7 - (y + 0.05).abs() + edge);
        arch.max(body)
    });
}

/// Marks a box of half sizes `half` around `at`, wrapped; `shape` gives the opacity for x, y in
/// −1…1 (y up).
fn stamp(
    texels: &mut [Texel],
    n: usize,
    at: [f32; 2],
    half: [f32; 2],
    shade: f32,
    sink: f32,
    shape: impl Fn(f32, f32) -> f32,
) {
    let reach = |h: f32| ((h * n as f32).ceil() as i64 + 1).min(n as i64 / 2);
    let (rx, ry) = (reach(half[0]), reach(half[1]));
    let centre = [at[0] * n as f32, (1.0 - at[1]) * n as f32];
    for dy in -ry..=ry {
        for dx in -rx..=rx {
            let (px, py) = (centre[0].floor() as i64 + dx, centre[1].floor() as i64 + dy);
            let x = (px as f32 + 0.5 - centre[0]) / (half[0] * n as f32);
            let y = -(py as f32 + 0.5 - centre[1]) / (half[1] * n as f32);
            if x.abs() > 1.0 || y.abs() > 1.0 {
                continue;
            }
            let opacity = shape(x, y);
            if opacity > 0.0 {
                let at = py.rem_euclid(n as i64) as usize * n + px.rem_euclid(n as i64) as usize;
                let t = &mut texels[at];
                t.height -= sink * opacity;
                t.mark_shade = mix(t.mark_shade, shade, opacity / opacity.max(t.mark).max(1e-6));
                t.mark = 1.0 - (1.0 - t.mark) * (1.0 - opacity);
            }
        }
    }
}
