//! A small painter of twigs: tapered strokes and leaves with an outline, painted over each other
//! in order on a supersampled square, then averaged to pixels with clean alpha.

use glam::Vec2;

use super::outline::Outline;

/// A square canvas; coordinates 0…1, y up.
pub struct Canvas {
    side: usize,
    factor: usize,
    /// Alpha is 0 or 255 here; row 0 at the bottom.
    samples: Vec<[u8; 4]>,
}

/// A stroke from `from` to `to`, round ends.
#[derive(Debug, Clone, Copy)]
pub struct Stroke {
    pub from: Vec2,
    pub to: Vec2,
    /// Half width at both ends.
    pub half: [f32; 2],
    pub colour: [f32; 3],
    /// Brightness at both ends.
    pub light: [f32; 2],
}

/// A flat leaf as it is seen: its outline, leant, bent and lit.
#[derive(Debug, Clone, Copy)]
pub struct Leaf<'a> {
    pub outline: &'a Outline,
    /// Where the petiole meets the blade.
    pub base: Vec2,
    /// Unit direction from base to tip.
    pub along: Vec2,
    pub length: f32,
    /// Foreshortening of each half, 0…1.
    pub open: [f32; 2],
    /// Sideways bend of the midrib at the tip, share of the length.
    pub bend: f32,
    pub colour: [f32; 3],
    /// Brightness of each half.
    pub light: [f32; 2],
    /// How far the margin is shifted towards the tip on one side, and from it on the other, in the
    /// middle of the leaf, share of its length.
    pub skew: f32,
    /// Side veins a leaf; 0 for none.
    pub veins: f32,
}

impl Canvas {
    /// `side` pixels; each has `factor`² samples.
    pub fn new(side: usize, factor: usize) -> Self {
        let n = side * factor;
        Canvas { side, factor, samples: vec![[0; 4]; n * n] }
    }

    /// Size of a pixel in canvas coordinates.
    pub fn pixel(&self) -> f32 {
        1.0 / self.side as f32
    }

    fn range(&self, low: f32, high: f32) -> std::ops::Range<usize> {
        let n = (self.side * self.factor) as f32;
        let clip = |x: f32| (x * n).clamp(0.0, n) as usize;
        clip(low)..clip(high + 1.0 / n).max(clip(low))
    }

    /// Paints where `shade` gives a brightness-scaled colour.
    fn paint(&mut self, low: Vec2, high: Vec2, shade: impl Fn(Vec2) -> Option<[f32; 3]>) {
        let n = self.side * self.factor;
        let step = 1.0 / n as f32;
        let (xs, ys) = (self.range(low.x, high.x), self.range(low.y, high.y));
        for y in ys {
            let row = &mut self.samples[y * n..(y + 1) * n];
            for x in xs.clone() {
                let p = Vec2::new((x as f32 + 0.5) * step, (y as f32 + 0.5) * step);
                if let Some(c) = shade(p) {
                    let byte = |v: f32| v.clamp(0.0, 255.0) as u8;
                    row[x] = [byte(c[0]), byte(c[1]), byte(c[2]), 255];
                }
            }
        }
    }

    pub fn stroke(&mut self, s: &Stroke) {
        let reach = s.half[0].max(s.half[1]);
        let axis = s.to - s.from;
        let length_sq = axis.length_squared().max(1e-12);
        let side = axis.perp() / length_sq.sqrt();
        self.paint(s.from.min(s.to) - reach, s.from.max(s.to) + reach, |p| {
            let t = ((p - s.from).dot(axis) / length_sq).clamp(0.0, 1.0);
            let half = s.half[0] + (s.half[1] - s.half[0]) * t;
            let off = p - (s.from + axis * t);
            if off.length_squared() > half * half {
                return None;
            }
            let round = 1.0 - 0.3 * (off.dot(side) / half.max(1e-9) + 0.4).abs();
            let light = (s.light[0] + (s.light[1] - s.light[0]) * t) * round;
            Some(s.colour.map(|c| c * light))
        });
    }

    pub fn leaf(&mut self, l: &Leaf) {
        let foot = l.outline.foot;
        let reach = (l.outline.widest.max(foot) + l.bend.abs()) * l.length + self.pixel();
        let tip = l.base + l.along * (l.length * (1.0 - foot));
        let side = l.along.perp();
        let rib = (0.08 * l.outline.widest).min(0.018);
        self.paint(l.base.min(tip) - reach, l.base.max(tip) + reach, |p| {
            let q = (p - l.base) / l.length;
            let up = q.dot(l.along);
            let y = up + foot;
            if !(0.0..1.0).contains(&y) {
                return None;
            }
            let x = q.dot(side) - l.bend * up * up;
            let half = usize::from(x < 0.0);
            let x = x.abs() / l.open[half].max(0.05);
            let shifted = 4.0 * l.skew * y * (1.0 - y);
            let [gap, width] = l.outline.at(if half == 0 { y + shifted } else { y - shifted });
            if x > width || x < gap {
                return None;
            }
            let mut light = l.light[half] * (1.04 - 0.18 * (x / width.max(1e-6)).powi(3));
            if x < rib {
                light *= 1.16;
            } else if l.veins > 0.0 {
                let vein = ((up - 0.9 * x) * l.veins).rem_euclid(1.0);
                light *= if vein < 0.15 { 1.07 } else { 1.0 - 0.05 * vein };
            }
            Some(l.colour.map(|c| c * light))
        });
    }

    /// Pixels with straight alpha, row 0 at the bottom. `edge` lifts the alpha of partly covered
    /// pixels: above 1 keeps thin needles under a mask.
    pub fn resolve(&self, edge: f32) -> Vec<[u8; 4]> {
        let (f, n) = (self.factor, self.side * self.factor);
        let mut out = Vec::with_capacity(self.side * self.side);
        for y in 0..self.side {
            for x in 0..self.side {
                let (mut sum, mut count) = ([0u32; 3], 0u32);
                for sy in 0..f {
                    let at = (y * f + sy) * n + x * f;
                    for s in &self.samples[at..at + f] {
                        if s[3] != 0 {
                            count += 1;
                            for c in 0..3 {
                                sum[c] += u32::from(s[c]);
                            }
                        }
                    }
                }
                out.push(match count {
                    0 => [0; 4],
                    _ => {
                        let alpha = (edge * count as f32 / (f * f) as f32).min(1.0) * 255.0;
                        let mean = sum.map(|s| ((s + count / 2) / count) as u8);
                        [mean[0], mean[1], mean[2], alpha as u8]
                    }
                });
            }
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stroke_covers_its_area() {
        let mut canvas = Canvas::new(64, 4);
        canvas.stroke(&Stroke {
            from: Vec2::new(0.2, 0.5),
            to: Vec2::new(0.8, 0.5),
            half: [0.05, 0.05],
            colour: [200.0, 100.0, 50.0],
            light: [1.0, 1.0],
        });
        let area: f32 = canvas.resolve(1.0).iter().map(|p| f32::from(p[3]) / 255.0).sum::<f32>()
            / (64.0 * 64.0);
        let truth = 0.6 * 0.1 + std::f32::consts::PI * 0.05 * 0.05;
        assert!((area - truth).abs() < 0.002, "{area} {truth}");
    }
}
