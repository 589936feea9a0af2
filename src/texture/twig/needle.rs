//! Twigs of conifers: sprays of spruce and fir, tufts of larch, brushes of pine.

use glam::Vec2;

use super::super::canvas::Stroke;
use super::{GOLDEN_RAD, Painter, Shoot};

/// Length and width of a larch's short shoot, metres.
const SPUR_M: [f32; 2] = [0.006, 0.004];

impl Painter<'_> {
    /// Needles along a stretch of a shoot. `spread`: angles to the shoot, `from`: where they begin.
    fn needles(
        &mut self,
        shoot: &Shoot,
        length: f32,
        per_length: f32,
        from: f32,
        spread: [f32; 2],
    ) {
        let count = (shoot.length * (1.0 - from) * per_length).clamp(4.0, 600.0) as usize;
        let half = 0.5 * self.share(self.species.foliage.leaf_width_m);
        let half = half.max(0.55 * self.canvas.pixel());
        for k in 0..count {
            if self.spent() {
                return;
            }
            if self.has_fallen() {
                continue;
            }
            let t = from + (1.0 - from) * (k as f32 + self.draws.unit()) / count as f32;
            let angle = k as f32 * GOLDEN_RAD;
            // Seen from one side: across the picture by the sine, shortened by the cosine.
            let opening = self.draws.between(spread[0], spread[1]) * (1.0 - 0.25 * t);
            let (across, towards) = angle.sin_cos();
            let along = shoot.direction(t);
            let dir = along * opening.cos() + along.perp() * (opening.sin() * across);
            let (colour, light) = self.tint(shoot.depth * 0.5 + 0.25 + 0.25 * towards);
            let size = length * self.draws.between(0.75, 1.08) * (1.0 - 0.3 * t * t * t);
            let base = shoot.at(t);
            let tip = base + dir * size;
            if tip.x < 0.005 || tip.x > 0.995 || tip.y > 0.995 {
                continue;
            }
            self.canvas.stroke(&Stroke {
                from: base,
                to: tip,
                half: [half, half * 0.55],
                colour,
                light: [light * 0.8, light * 1.08],
            });
        }
    }

    /// Flat sprays of spruce and fir: side shoots in one plane, needles all round.
    pub(super) fn spray(&mut self, main: Shoot) {
        let needle = self.share(self.species.foliage.leaf_length_m).clamp(0.006, 0.3);
        let density = 8.0 / needle.max(0.01);
        // Shoots stand so close that their needles meet.
        let gap = (1.35 * needle).clamp(0.045, 0.2);
        let mut shoots = Vec::new();
        for lateral in self.laterals(&main, gap, [0.62, 0.95, 0.0]) {
            if lateral.length > 4.0 * gap {
                let fine = self.laterals(&lateral, gap, [0.2, 0.85, 0.0]);
                shoots.extend(fine.into_iter().map(|s| (s, 0.0012)));
            }
            shoots.push((lateral, 0.0022));
        }
        shoots.push((main, 0.005));
        for (shoot, half) in shoots {
            self.wood(&shoot, half, half * 0.5);
            self.needles(&shoot, needle, density.min(500.0), 0.02, [0.5, 1.0]);
        }
    }

    /// Larch: rosettes on short shoots along few thin, long, hanging twigs, apart from each other.
    pub(super) fn tufts(&mut self, main: Shoot, bough: bool) {
        let needle = self.share(self.species.foliage.leaf_length_m).clamp(0.006, 0.3);
        // A bough is seen from afar: it fills its cell, and its tufts hold together.
        let (gap, reach, angle) = if bough { (0.075, 0.62, 0.85) } else { (0.11, 0.4, 0.7) };
        // On a seedling's short twig needles are long.
        let mut shoots = self.laterals(&main, f32::max(gap, 1.1 * needle), [reach, angle, 0.0]);
        if bough {
            let mut fine = Vec::new();
            for lateral in shoots.iter().filter(|l| l.length > 0.12) {
                fine.extend(self.laterals(lateral, 0.1, [0.1, 0.7, 0.0]));
            }
            shoots.extend(fine);
        }
        shoots.push(main);
        let half = 0.5 * self.share(self.species.foliage.leaf_width_m);
        let half = half.max(0.5 * self.canvas.pixel()) * if bough { 1.6 } else { 1.0 };
        let rays = if bough { 15 } else { 22 };
        let apart = if bough { 1.05 } else { 0.75 };
        for shoot in shoots {
            self.wood(&shoot, 0.003, 0.0012);
            let count = (shoot.length / (needle * apart)).clamp(2.0, 60.0) as usize;
            for k in 0..=count {
                let t =
                    (0.06 + 0.94 * (k as f32 + self.jitter(0.25)) / count as f32).clamp(0.0, 1.0);
                let side = if k % 2 == 0 { 1.0 } else { -1.0 };
                let heading = shoot.angle + shoot.bend * t + side * 0.9;
                let base = shoot.at(t);
                let large = self.draws.between(0.65, 1.0);
                if self.has_fallen() {
                    self.spur(base, heading);
                    continue;
                }
                for n in 0..rays {
                    if self.spent() {
                        return;
                    }
                    let swing = (n as f32 / (rays - 1) as f32 - 0.5) * 3.6 + self.jitter(0.2);
                    let dir = Vec2::new((heading + swing).sin(), (heading + swing).cos());
                    let size = needle * large * self.draws.between(0.65, 1.0);
                    let depth = self.draws.between(0.3, 1.0);
                    let (colour, light) = self.tint(depth);
                    let tip = base + dir * size;
                    if tip.x < 0.005 || tip.x > 0.995 || tip.y > 0.995 || tip.y < 0.0 {
                        continue;
                    }
                    self.canvas.stroke(&Stroke {
                        from: base,
                        to: tip,
                        half: [half, half * 0.6],
                        colour,
                        light: [light * 0.82, light * 1.06],
                    });
                }
            }
        }
    }

    /// The short shoot that a larch's needles have left.
    fn spur(&mut self, base: Vec2, heading: f32) {
        let out = Vec2::new(heading.sin(), heading.cos()) * self.share(SPUR_M[0]);
        let half = (0.5 * self.share(SPUR_M[1])).max(0.5 * self.canvas.pixel());
        let colour = super::twig_colour(&self.species.bark);
        self.canvas.stroke(&Stroke {
            from: base,
            to: base + out,
            half: [half; 2],
            colour,
            light: [0.8; 2],
        });
    }

    /// Pine: long needles crowded towards the ends of few stout shoots.
    pub(super) fn brushes(&mut self, main: Shoot, bough: bool) {
        let needle = self.share(self.species.foliage.leaf_length_m).clamp(0.02, 0.35);
        let gap = if bough { 0.05 } else { 0.12 };
        let mut shoots = self.laterals(&main, f32::max(gap, 0.5 * needle), [0.55, 0.9, 0.0]);
        if bough {
            let mut fine = Vec::new();
            for lateral in shoots.iter().filter(|l| l.length > 0.16) {
                fine.extend(self.laterals(lateral, 0.07, [0.14, 0.8, 0.0]));
            }
            shoots.extend(fine);
        }
        let main = Shoot { length: (0.97 - needle * 0.8).max(0.4), ..main };
        shoots.push(main);
        for shoot in shoots {
            self.wood(&shoot, if bough { 0.005 } else { 0.01 }, 0.004);
            let from =
                if shoot.length > 2.6 * needle { 1.0 - 2.6 * needle / shoot.length } else { 0.1 };
            self.needles(&shoot, needle, (38.0 / needle).min(700.0), from.max(0.0), [0.25, 1.15]);
        }
    }
}
