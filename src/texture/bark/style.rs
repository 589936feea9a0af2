//! The patterns of bark, place by place.

use super::super::noise::{Noise, mix, smoothstep};
use super::Texel;
use crate::seed::Seed;
use crate::species::model::BarkStyle;

/// Fields of noise that the styles share.
pub struct Painter {
    warp: Noise,
    broad: Noise,
    fine: Noise,
    cells: Noise,
    flakes: Noise,
}

impl Painter {
    /// For pictures of `n` × `n` pixels, with features so much larger than is usual.
    pub fn new(seed: Seed, n: usize, coarseness: f32) -> Self {
        let field = |name| Noise::new(seed, name).for_side(n).coarser(coarseness.clamp(0.25, 4.0));
        Painter {
            warp: field("warp"),
            broad: field("broad"),
            fine: field("fine"),
            cells: field("cells"),
            flakes: field("flakes"),
        }
    }

    /// `v` is up.
    pub fn texel(&self, style: BarkStyle, u: f32, v: f32) -> Texel {
        match style {
            BarkStyle::Birch => self.birch(u, v),
            BarkStyle::Paper => self.paper(u, v),
            BarkStyle::Plates => self.plates(u, v),
            BarkStyle::Flakes => self.flakes(u, v),
            BarkStyle::Ridges => self.ridges(u, v),
            BarkStyle::Furrows => self.furrows(u, v),
            BarkStyle::Scales => self.scales(u, v),
            BarkStyle::Smooth => self.smooth(u, v),
            BarkStyle::Diamonds => self.diamonds(u, v),
            BarkStyle::Blisters => self.blisters(u, v),
        }
    }

    /// A gentle shift of columns of cells against each other, so that they stand in no rows.
    fn slip(&self, u: f32) -> f32 {
        0.1 * self.broad.gradient(u, 0.37, [5, 1])
    }

    /// Black furrowed cork that has burst the white skin; of that islands are left.
    fn birch(&self, u: f32, v: f32) -> Texel {
        let skin = self.paper(u, v);
        let jag = self.fine.grain(u, v, 36, 4);
        let wu = u + 0.03 * self.warp.fractal(u, v, [7, 5], 4) + 0.006 * jag;
        let wv = v + self.slip(u) + 0.05 * self.broad.fractal(u, v, [9, 6], 3) + 0.008 * jag;
        let big = self.cells.cells(wu, wv, [13, 6], 1.0);
        let small = self.flakes.cells(wu + 0.02 * jag, wv, [34, 20], 1.0);
        let ridge = smoothstep(0.0, 0.3, big.border + 0.06 * jag).sqrt();
        let crumb = smoothstep(0.0, 0.2, small.border + 0.05 * jag);
        let cork = ridge * (0.55 + 0.3 * big.draw + 0.15 * crumb) + 0.06 * jag;
        // Skin stays on the flat of some ridges, in upright rags.
        let hold = big.draw - 0.5 + 0.8 * self.warp.fractal(u + 0.4, wv, [6, 3], 3) + 0.25 * jag;
        let left = smoothstep(0.12, 0.2, hold) * smoothstep(0.06, 0.12, big.border + 0.04 * jag);
        let tone = (0.04 + 0.2 * ridge * (0.5 + 0.5 * crumb) * (0.6 + 0.4 * small.draw)).min(0.3);
        Texel {
            fresh: skin.fresh * left,
            roughness: mix(0.95, skin.roughness, left),
            ..Texel::new(
                mix(cork, 0.85 + 0.1 * skin.height, left),
                mix(tone, skin.tone, left),
                mix(0.9 + 0.3 * jag + 0.2 * (small.draw - 0.5), skin.shade, left),
                mix(0.06 * ridge, skin.warm, left),
            )
        }
    }

    /// Thick tall plates of many flakes, parted by deep furrows.
    fn plates(&self, u: f32, v: f32) -> Texel {
        let jag = self.fine.grain(u, v, 26, 4);
        let wu = u + 0.035 * self.warp.fractal(u, v, [6, 5], 4) + 0.008 * jag;
        let wv = v + self.slip(u) + 0.08 * self.broad.fractal(u, v, [7, 5], 3) + 0.008 * jag;
        let c = self.cells.cells(wu, wv, [10, 4], 1.0);
        let grain = self.warp.grain(u, v, 70, 3);
        // Furrows are wide here and a mere crack there.
        let gape = smoothstep(-0.5, 0.5, self.broad.fractal(u + 0.3, v + 0.6, [6, 4], 2));
        let border = c.border + 0.03 * jag;
        let plate = smoothstep(0.0, mix(0.05, 0.3, gape), border);
        let fu = u + 0.02 * self.fine.fractal(u, v, [16, 12], 4) + 0.003 * grain;
        let fv = v + 0.026 * self.cells.fractal(u, v, [14, 10], 4) + 0.003 * grain;
        let big = self.flakes.scales(fu, fv, [13, 7], 1.0);
        let small = self.cells.scales(fu, fv, [34, 20], 1.0);
        // Plates step down to their furrows, flake by flake.
        let steps = 1.0 / (1.0 + 6.0 * border);
        let layer = (0.55 * big.height + 0.25 * small.height + 0.2 * c.draw) * (1.0 - 0.5 * steps);
        let height = plate.sqrt() * (0.35 + 0.65 * layer) + 0.03 * grain + 0.02 * jag;
        let rim = smoothstep(0.0, 0.1, big.rim) * mix(0.75, 1.0, smoothstep(0.0, 0.18, small.rim));
        let tone = plate.sqrt() * mix(0.5, 1.0, rim);
        // Where a flake has gone, a redder one shows.
        let young = smoothstep(0.4, 0.8, 1.0 - layer);
        let shade = 0.92 + 0.26 * grain + 0.26 * (small.draw - 0.5) + 0.34 * (big.draw - 0.5);
        let warm = 0.3 * young * plate + 0.2 * (big.draw - 0.5) + 0.1 * (small.draw - 0.5);
        Texel { roughness: 0.86 + 0.06 * young, ..Texel::new(height, tone, shade, warm) }
    }

    /// Thin papery flakes that come loose.
    fn flakes(&self, u: f32, v: f32) -> Texel {
        let jag = self.fine.grain(u, v, 30, 4);
        let wu = u + 0.035 * self.warp.fractal(u, v, [9, 7], 5) + 0.006 * jag;
        let wv = v + 0.045 * self.broad.fractal(u, v, [9, 7], 5) + 0.006 * jag;
        let big = self.flakes.scales(wu, wv, [11, 7], 1.0);
        let small = self.cells.scales(wu + 0.21, wv + 0.43, [26, 16], 1.0);
        let grain = self.warp.grain(u, v, 64, 3);
        let cloud = self.broad.fractal(u + 0.3, v, [3, 4], 3);
        let curl = 1.0 - smoothstep(0.0, 0.09, big.rim);
        let height = 0.5 * big.height + 0.3 * small.height + 0.1 * curl + 0.06 * grain + 0.05 * jag;
        let edge = smoothstep(0.0, 0.05, big.rim) * mix(0.8, 1.0, smoothstep(0.0, 0.1, small.rim));
        let shade = 0.97
            + 0.12 * grain
            + 0.1 * jag
            + 0.16 * (big.draw - 0.5)
            + 0.2 * (small.draw - 0.5)
            + 0.1 * curl
            + 0.12 * cloud;
        let warm = 0.1 * (small.draw - 0.5) + 0.1 * (big.draw - 0.5) - 0.08 * cloud + 0.05 * jag;
        let loose = smoothstep(-0.2, 0.4, self.broad.fractal(u, v + 0.6, [6, 5], 3));
        let tone = mix(mix(0.9, 0.5, loose), 1.0, edge);
        let roughness = 0.7 + 0.1 * small.draw;
        Texel { roughness, ..Texel::new(height, tone, shade, warm) }
    }

    /// Long thick plates in layers between deep furrows.
    fn ridges(&self, u: f32, v: f32) -> Texel {
        let jag = self.fine.grain(u, v, 30, 4);
        let wu = u + 0.03 * self.warp.fractal(u, v, [7, 5], 4) + 0.008 * jag;
        let wv = v + self.slip(u) + 0.14 * self.broad.fractal(u, v, [8, 3], 3) + 0.01 * jag;
        let c = self.cells.cells(wu, wv, [13, 4], 1.0);
        let gape = smoothstep(-0.5, 0.5, self.broad.fractal(u + 0.3, v + 0.6, [8, 3], 2));
        let ridge = smoothstep(0.0, mix(0.1, 0.44, gape), c.border + 0.06 * jag);
        let fu = u + 0.014 * self.fine.fractal(u, v, [20, 10], 4) + 0.003 * jag;
        let fv = v + 0.03 * self.cells.fractal(u, v, [18, 8], 4) + 0.004 * jag;
        let big = self.flakes.scales(fu, fv, [22, 8], 1.0);
        let small = self.cells.scales(fu, fv, [44, 18], 1.0);
        let grain = self.warp.grain(u, v, 64, 3);
        let layer = 0.55 * big.height + 0.3 * small.height + 0.15 * c.draw;
        let height = ridge.sqrt() * (0.45 + 0.55 * layer) + 0.035 * grain + 0.03 * jag;
        let rim = smoothstep(0.0, 0.1, big.rim) * mix(0.75, 1.0, smoothstep(0.0, 0.16, small.rim));
        let tone = ridge.sqrt() * mix(0.5, 1.0, rim);
        // Red inner bark shows on the flanks and where flakes have gone.
        let flank = 4.0 * ridge * (1.0 - ridge);
        let young = smoothstep(0.3, 0.75, 1.0 - layer);
        let shade = 0.93 + 0.26 * grain + 0.26 * (small.draw - 0.5) + 0.26 * (big.draw - 0.5);
        let warm = 0.12 * flank + 0.14 * young * ridge + 0.1 * (big.draw - 0.5) + 0.04 * jag;
        Texel::new(height, tone, shade, warm)
    }

    /// Long ridges that part and join, broken across by fine cracks.
    fn furrows(&self, u: f32, v: f32) -> Texel {
        let rough = self.fine.grain(u, v, 34, 4);
        let wu = u + 0.032 * self.warp.fractal(u, v, [6, 4], 4) + 0.005 * rough;
        let wv = v + 0.08 * self.broad.fractal(u, v, [9, 4], 4);
        let c = self.cells.cells(wu, wv, [15, 4], 1.0);
        let split = self.flakes.cells(wu + 0.4, wv + 0.2, [30, 6], 1.0);
        let grain = self.fine.fractal(wu, v, [70, 12], 4);
        let gape = 0.5 + 0.5 * self.broad.fractal(u + 0.3, v + 0.6, [7, 4], 2);
        let wide = smoothstep(0.0, mix(0.2, 0.5, gape), c.border + 0.07 * rough);
        let narrow = smoothstep(0.0, 0.26, split.border + 0.08 * rough);
        // Cracks across come and go.
        let cross = self.warp.cells(wu, wv + 0.02 * rough, [12, 26], 1.0);
        let here = smoothstep(-0.1, 0.5, self.broad.fractal(u, v + 0.2, [8, 7], 2));
        let broken = mix(1.0, smoothstep(0.0, 0.1, cross.border + 0.05 * rough), 0.5 * here);
        let patch = self.broad.fractal(u + 0.6, v, [3, 2], 3);
        let ridge = wide.sqrt() * mix(0.72, 1.0, narrow) * mix(0.8, 1.0, broken);
        let height = ridge * (0.84 + 0.12 * c.draw) + 0.06 * grain + 0.06 * rough;
        let tone = (wide.sqrt() * mix(0.66, 1.0, narrow) * mix(0.75, 1.0, broken)).min(1.0);
        let shade = 0.95 + 0.22 * grain + 0.2 * rough + 0.12 * patch;
        let moss = 0.3 * smoothstep(0.1, 0.6, patch);
        let warm = 0.04 * patch + 0.05 * (1.0 - wide);
        Texel { moss, roughness: 0.92, ..Texel::new(height, tone, shade, warm) }
    }

    /// Small thin scales, one over the other, ragged and loose at their edges.
    fn scales(&self, u: f32, v: f32) -> Texel {
        let jag = self.fine.grain(u, v, 46, 5);
        let wu = u + 0.03 * self.warp.fractal(u, v, [11, 9], 5) + 0.012 * jag;
        let wv = v + 0.04 * self.broad.fractal(u, v, [9, 8], 5) + 0.012 * jag;
        let big = self.flakes.scales(wu, wv, [24, 13], 0.95);
        let small = self.cells.scales(wu + 0.3, wv + 0.1, [56, 34], 0.9);
        let grain = self.warp.grain(u, v, 90, 3);
        let patch = self.broad.fractal(u, v, [4, 3], 3);
        // Some scales lie flat against their neighbours, others stand off.
        let loose = smoothstep(-0.25, 0.35, self.cells.fractal(u + 0.2, v, [7, 6], 3));
        let height = 0.5 * big.height + 0.3 * small.height + 0.1 * grain + 0.1 * jag;
        let edge = smoothstep(0.0, mix(0.05, 0.2, loose), big.rim + 0.05 * jag);
        let fine = smoothstep(0.0, 0.25, small.rim + 0.08 * jag);
        let tone = mix(mix(0.85, 0.35, loose), 1.0, edge) * mix(0.82, 1.0, fine);
        let shade = 0.95
            + 0.16 * (big.draw - 0.5)
            + 0.22 * (small.draw - 0.5)
            + 0.2 * grain
            + 0.14 * jag
            + 0.14 * patch;
        let warm = 0.08 * (big.draw - 0.5) + 0.1 * (small.draw - 0.5) + 0.06 * patch;
        Texel { roughness: 0.85, ..Texel::new(height, tone, shade, warm) }
    }

    /// Smooth skin: soft clouds, fine powder, a crack here and there, and lichen.
    fn smooth(&self, u: f32, v: f32) -> Texel {
        let wu = u + 0.04 * self.warp.fractal(u, v, [4, 3], 4);
        let wv = v + 0.04 * self.broad.fractal(u, v, [4, 3], 4);
        let broad = self.broad.fractal(wu, wv, [5, 3], 4);
        let cloud = self.warp.grain(wu, wv, 9, 5);
        let powder = self.fine.grain(u, v, 60, 5);
        let crack = smoothstep(0.5, 0.64, self.cells.fractal(wu + 0.3, wv, [16, 4], 4));
        let lichen = smoothstep(0.25, 0.5, self.flakes.grain(wu + 0.2, wv + 0.7, 6, 6));
        let height = 0.6 + 0.2 * broad + 0.12 * cloud + 0.08 * powder - 0.3 * crack;
        let tone = (0.95 + 0.06 * broad - 0.25 * crack).clamp(0.0, 1.0);
        let shade = 0.97 + 0.2 * cloud + 0.14 * powder + 0.12 * lichen + 0.1 * broad;
        let moss = 0.2 * lichen;
        Texel { moss, roughness: 0.66, ..Texel::new(height, tone, shade, 0.05 * cloud) }
    }

    /// Smooth greenish skin, powdery, with faint wrinkles across.
    fn diamonds(&self, u: f32, v: f32) -> Texel {
        let wv = v + 0.02 * self.warp.fractal(u, v, [5, 6], 4);
        let broad = self.broad.fractal(u, v, [3, 3], 4);
        let powder = self.fine.grain(u, v, 50, 5);
        let wrinkle = self.warp.fractal(u, wv, [6, 40], 4);
        let algae = smoothstep(-0.2, 0.6, self.broad.grain(u + 0.5, wv, 4, 6));
        let height = 0.6 + 0.2 * broad + 0.1 * powder + 0.1 * wrinkle;
        let shade = 0.98 + 0.12 * powder + 0.04 * wrinkle + 0.1 * broad;
        let moss = 0.3 * algae;
        Texel { moss, roughness: 0.72, ..Texel::new(height, 0.97, shade, 0.02 * broad) }
    }

    /// Smooth grey skin with fine wrinkles.
    fn blisters(&self, u: f32, v: f32) -> Texel {
        let wv = v + 0.02 * self.warp.fractal(u, v, [5, 6], 4);
        let broad = self.broad.fractal(u, v, [4, 3], 4);
        let fine = self.fine.grain(u, v, 44, 5);
        let wrinkle = self.warp.grain(u, wv, 12, 4);
        let lichen = smoothstep(0.15, 0.5, self.broad.grain(u + 0.2, wv + 0.7, 6, 6));
        let height = 0.5 + 0.14 * broad + 0.1 * fine + 0.12 * wrinkle;
        let shade = 0.96 + 0.14 * fine + 0.07 * wrinkle + 0.1 * broad + 0.14 * lichen;
        Texel {
            moss: 0.14 * lichen,
            roughness: 0.7,
            ..Texel::new(height, 0.95, shade, 0.03 * broad)
        }
    }

    /// Paper-white skin in faint bands, peeling here and there.
    fn paper(&self, u: f32, v: f32) -> Texel {
        let wv = v + 0.012 * self.warp.fractal(u, v, [4, 9], 3);
        let band = self.broad.fractal(u, wv, [3, 26], 3);
        let cloud = self.broad.fractal(u + 0.4, v, [4, 4], 4);
        let thread = self.fine.fractal(u, wv, [8, 120], 2);
        let torn = self.warp.fractal(u + 0.2, wv, [4, 16], 5);
        let peel = smoothstep(0.40, 0.44, torn);
        // The skin rolls up where it is torn.
        let roll = smoothstep(0.33, 0.395, torn) * (1.0 - peel);
        let height = 0.6 + 0.08 * band + 0.05 * thread - 0.3 * peel + 0.25 * roll;
        let tone = (0.97 + 0.03 * band - 0.10 * smoothstep(0.1, 0.7, cloud)).clamp(0.0, 1.0);
        let shade = 0.985 + 0.04 * thread + 0.03 * band + 0.02 * roll;
        Texel {
            fresh: 0.75 * peel + 0.12 * smoothstep(0.0, 0.6, cloud),
            roughness: 0.56 + 0.15 * peel,
            ..Texel::new(height, tone, shade, 0.015 * cloud)
        }
    }
}
