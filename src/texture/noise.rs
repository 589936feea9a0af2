//! Noise that repeats: gradient noise (Perlin 2002, with quintic fade) and cellular noise
//! (Worley 1996) on a torus, so that a picture made from them tiles without a seam.

use crate::seed::Seed;

/// A field of noise of its own.
#[derive(Debug, Clone, Copy)]
pub struct Noise {
    seed: u32,
    /// Lattice cells a side beyond which octaves are left out.
    finest: u32,
    /// How much smaller its features are than the periods say, to whole cells a side.
    finer: f32,
}

/// What cellular noise finds around a place.
#[derive(Debug, Clone, Copy)]
pub struct Cellular {
    /// Distance to the cell's border, in widths of a cell, whatever its height.
    pub border: f32,
    /// Draw of the nearest cell, 0…1.
    pub draw: f32,
}

/// The topmost scale at a place.
#[derive(Debug, Clone, Copy)]
pub struct Scale {
    /// 0…1; 0 where there is none.
    pub height: f32,
    /// From its edge (0) to its middle (1).
    pub rim: f32,
    /// Its own draw, 0…1.
    pub draw: f32,
}

/// `floor`, which the plainest processors have as a call only; for |x| below 2³¹.
fn floor(x: f32) -> i32 {
    let whole = x as i32;
    whole - i32::from((whole as f32) > x)
}

fn fade(t: f32) -> f32 {
    t * t * t * (t * (t * 6.0 - 15.0) + 10.0)
}

/// A lattice coordinate within its period; division only far outside it.
fn wrap(x: i32, period: u32) -> u32 {
    let p = period as i32;
    if (0..p).contains(&x) {
        x as u32
    } else if (-p..0).contains(&x) {
        (x + p) as u32
    } else if (p..2 * p).contains(&x) {
        (x - p) as u32
    } else {
        x.rem_euclid(p.max(1)) as u32
    }
}

pub fn mix(a: f32, b: f32, t: f32) -> f32 {
    a + (b - a) * t
}

/// 0 below `low`, 1 above `high`, smooth between.
pub fn smoothstep(low: f32, high: f32, x: f32) -> f32 {
    let t = ((x - low) / (high - low)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

impl Noise {
    pub fn new(seed: Seed, name: &str) -> Self {
        Noise { seed: seed.derive(name, 0).draws().bits() as u32, finest: u32::MAX, finer: 1.0 }
    }

    /// The same field for a picture of that side, without octaves finer than two pixels.
    pub fn for_side(self, pixels: usize) -> Self {
        Noise { finest: (pixels / 2) as u32, ..self }
    }

    /// The same field with features so much larger.
    pub fn coarser(self, coarser: f32) -> Self {
        Noise { finer: coarser.recip(), ..self }
    }

    fn periods(self, period: [u32; 2]) -> [u32; 2] {
        period.map(|p| ((p as f32 * self.finer + 0.5) as u32).max(1))
    }

    /// 32 bits for a lattice point within the period.
    fn hash(self, x: u32, y: u32) -> u32 {
        let mut h = self.seed ^ x.wrapping_mul(0x9e37_79b1) ^ y.wrapping_mul(0x85eb_ca77);
        h = (h ^ (h >> 16)).wrapping_mul(0x7feb_352d);
        h = (h ^ (h >> 15)).wrapping_mul(0x846c_a68b);
        h ^ (h >> 16)
    }

    /// Gradient noise, about −1…1; `period` lattice cells fill the unit square.
    pub fn gradient(self, u: f32, v: f32, period: [u32; 2]) -> f32 {
        self.octave(u, v, self.periods(period))
    }

    fn octave(self, u: f32, v: f32, period: [u32; 2]) -> f32 {
        let (x, y) = (u * period[0] as f32, v * period[1] as f32);
        let (ix, iy) = (floor(x), floor(y));
        let (fx, fy) = (x - ix as f32, y - iy as f32);
        let xs = [wrap(ix, period[0]), wrap(ix + 1, period[0])];
        let ys = [wrap(iy, period[1]), wrap(iy + 1, period[1])];
        let corner = |dx: usize, dy: usize| {
            let h = self.hash(xs[dx], ys[dy]);
            // Eight even directions.
            const D: f32 = std::f32::consts::FRAC_1_SQRT_2;
            const DIRECTIONS: [[f32; 2]; 8] = [
                [1.0, 0.0],
                [D, D],
                [0.0, 1.0],
                [-D, D],
                [-1.0, 0.0],
                [-D, -D],
                [0.0, -1.0],
                [D, -D],
            ];
            let g = DIRECTIONS[(h & 7) as usize];
            g[0] * (fx - dx as f32) + g[1] * (fy - dy as f32)
        };
        let (sx, sy) = (fade(fx), fade(fy));
        let low = mix(corner(0, 0), corner(1, 0), sx);
        let high = mix(corner(0, 1), corner(1, 1), sx);
        1.5 * mix(low, high, sy)
    }

    /// Octaves of gradient noise, each twice as fine and half as strong; about −1…1.
    pub fn fractal(self, u: f32, v: f32, period: [u32; 2], octaves: u32) -> f32 {
        let (mut sum, mut weight, mut total) = (0.0, 1.0, 0.0);
        let mut field = self;
        let mut p = self.periods(period);
        for _ in 0..octaves.min(8) {
            if p[0].max(p[1]) > self.finest && total > 0.0 {
                total += weight;
                weight *= 0.5;
                continue;
            }
            sum += weight * field.octave(u, v, p);
            total += weight;
            weight *= 0.5;
            p = [p[0] * 2, p[1] * 2];
            field.seed = field.seed.wrapping_add(0x9e37_79b9);
        }
        sum / total
    }

    /// Even grain: octaves turned against each other, so that no direction shows.
    pub fn grain(self, u: f32, v: f32, period: u32, octaves: u32) -> f32 {
        let (mut sum, mut weight, mut total) = (0.0, 1.0, 0.0);
        let mut field = self;
        let (mut p, mut at) = (self.periods([period; 2])[0], [u, v]);
        for _ in 0..octaves.min(6) {
            if p > self.finest && total > 0.0 {
                total += weight;
                weight *= 0.6;
                continue;
            }
            sum += weight * field.octave(at[0], at[1], [p, p]);
            total += weight;
            weight *= 0.6;
            // A turn by an eighth and a stretch by the root of 2; whole numbers keep the torus.
            at = [at[0] + at[1], at[1] - at[0]].map(|c| c - floor(c) as f32);
            p += p / 4;
            field.seed = field.seed.wrapping_add(0x9e37_79b9);
        }
        sum / total
    }

    /// Cellular noise with `period` cells a side; `jitter` 0 (grid) … 1 (free).
    pub fn cells(self, u: f32, v: f32, period: [u32; 2], jitter: f32) -> Cellular {
        let period = self.periods(period);
        let (x, y) = (u * period[0] as f32, v * period[1] as f32);
        let (ix, iy) = (floor(x), floor(y));
        let mut near = [[0.0f32; 2]; 9];
        let (mut first, mut first_sq, mut draw) = (0, f32::INFINITY, 0.0);
        for (k, near) in near.iter_mut().enumerate() {
            let (dx, dy) = (k as i32 % 3 - 1, k as i32 / 3 - 1);
            let h = self.hash(wrap(ix + dx, period[0]), wrap(iy + dy, period[1]));
            let jx = 0.5 + jitter * ((h & 0xffff) as f32 / 65536.0 - 0.5);
            let jy = 0.5 + jitter * ((h >> 16) as f32 / 65536.0 - 0.5);
            *near = [(ix + dx) as f32 + jx - x, (iy + dy) as f32 + jy - y];
            let d_sq = near[0] * near[0] + near[1] * near[1];
            if d_sq < first_sq {
                (first, first_sq) = (k, d_sq);
                draw = (h.wrapping_mul(0x9e37_79b1) >> 8) as f32 / (1u32 << 24) as f32;
            }
        }
        // The nearest of the bisectors with all others, its distance measured on the picture.
        let own = near[first];
        let stretch = period[1] as f32 / period[0].max(1) as f32;
        let mut border = f32::INFINITY;
        for (k, other) in near.iter().enumerate() {
            let apart = [other[0] - own[0], other[1] - own[1]];
            let slope = (apart[0] * apart[0] + apart[1] * apart[1] * stretch * stretch).sqrt();
            if k != first && slope > 1e-6 {
                let middle = [0.5 * (other[0] + own[0]), 0.5 * (other[1] + own[1])];
                border = border.min((middle[0] * apart[0] + middle[1] * apart[1]) / slope);
            }
        }
        Cellular { border: border.max(0.0), draw }
    }

    /// Overlapping scales, one a cell, drawn one over the other: `reach` is their radius in
    /// cells, up to 1. Each lies a little higher at its lower end.
    pub fn scales(self, u: f32, v: f32, period: [u32; 2], reach: f32) -> Scale {
        let period = self.periods(period);
        let (x, y) = (u * period[0] as f32, v * period[1] as f32);
        let (ix, iy) = (floor(x), floor(y));
        let mut top = Scale { height: 0.0, rim: 0.0, draw: 0.5 };
        for dy in -1..=1 {
            let row = wrap(iy + dy, period[1]);
            for dx in -1..=1 {
                let h = self.hash(wrap(ix + dx, period[0]), row);
                let jx = 0.5 + 0.8 * ((h & 0xffff) as f32 / 65536.0 - 0.5);
                let jy = 0.5 + 0.8 * ((h >> 16) as f32 / 65536.0 - 0.5);
                let (ox, oy) = (x - (ix + dx) as f32 - jx, y - (iy + dy) as f32 - jy);
                let rim = 1.0 - (ox * ox + oy * oy).sqrt() / reach;
                if rim <= 0.0 {
                    continue;
                }
                let draw = (h.wrapping_mul(0x9e37_79b1) >> 8) as f32 / (1u32 << 24) as f32;
                let height = 0.15 + 0.6 * draw + 0.25 * (0.5 - 0.5 * oy);
                if height > top.height {
                    top = Scale { height, rim, draw };
                }
            }
        }
        top
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noise_repeats_and_stays_in_range() {
        let n = Noise::new(Seed::new(3), "test");
        let mut spread = (f32::INFINITY, f32::NEG_INFINITY);
        for i in 0..4000 {
            let (u, v) = ((i as f32 * 0.618_034).fract(), (i as f32 * 0.414_214).fract());
            let here = n.fractal(u, v, [5, 3], 4);
            assert!((here - n.fractal(u + 1.0, v - 1.0, [5, 3], 4)).abs() < 2e-3);
            let (a, b) = (n.cells(u, v, [6, 4], 0.9), n.cells(u - 1.0, v + 1.0, [6, 4], 0.9));
            assert!((a.border - b.border).abs() < 1e-4 && a.draw == b.draw);
            spread = (spread.0.min(here), spread.1.max(here));
        }
        assert!(spread.0 > -1.2 && spread.1 < 1.2 && spread.1 - spread.0 > 0.8, "{spread:?}");
    }
}
