//! The outline of a leaf: its margin from petiole to tip as a curve through a few points, then its
//! teeth, which point to the tip, set along the curve.
//!
//! Limits: both halves have one outline, and what overhangs (the lobes of an oak, deep teeth across
//! the tip) is filled below.

use glam::Vec2;

use crate::species::model::{Foliage, LeafShape};

/// Stretches along a leaf in which its half width is known.
const STEPS: usize = 256;
/// Points of the margin between two of those that are given, without teeth.
const FINE: usize = 64;

/// Half widths along a leaf, from its lowest to its highest point, as shares of its length.
#[derive(Debug, Clone, PartialEq)]
pub struct Outline {
    outer: [f32; STEPS + 1],
    /// Of the gap between the lobes of a heart-shaped base.
    inner: [f32; STEPS + 1],
    /// Where the petiole meets the blade, share of the length: 0 unless the base is heart-shaped.
    pub foot: f32,
    pub widest: f32,
}

#[derive(Clone, Copy, PartialEq)]
enum Tooth {
    /// Sharp, pointing to the tip.
    Serrate,
    /// Sharp, each with smaller ones.
    Biserrate,
    /// Blunt, with narrow bays.
    Crenate,
}

impl Tooth {
    /// How far the margin lies within the leaf at a share of a tooth, 0 at its point … 1.
    fn inset(self, phase: f32) -> f32 {
        const POINT: f32 = 0.78;
        let saw = |p: f32| if p < POINT { 1.0 - p / POINT } else { (p - POINT) / (1.0 - POINT) };
        match self {
            Tooth::Serrate => saw(phase),
            Tooth::Biserrate => 0.6 * saw(phase) + 0.4 * saw((3.0 * phase).fract()),
            Tooth::Crenate => 1.0 - (std::f32::consts::PI * phase).sin().sqrt(),
        }
    }
}

struct Form {
    /// The right half's margin from petiole to tip: share of the width from the midrib, share of
    /// the length.
    margin: &'static [[f32; 2]],
    tooth: Tooth,
    /// Teeth a side, their depth as a share of the length.
    teeth: f32,
    depth: f32,
    /// Share of the margin without teeth, at the base.
    entire: f32,
}

fn form(shape: LeafShape) -> Form {
    match shape {
        LeafShape::Ovate => Form {
            margin: &[
                [0.0, 0.0],
                [0.14, 0.035],
                [0.34, 0.18],
                [0.47, 0.36],
                [0.5, 0.52],
                [0.45, 0.7],
                [0.31, 0.85],
                [0.12, 0.95],
                [0.0, 1.0],
            ],
            tooth: Tooth::Crenate,
            teeth: 13.0,
            depth: 0.008,
            entire: 0.2,
        },
        LeafShape::Deltoid => Form {
            margin: &[
                [0.0, 0.0],
                [0.2, 0.06],
                [0.41, 0.16],
                [0.5, 0.29],
                [0.43, 0.44],
                [0.28, 0.61],
                [0.14, 0.77],
                [0.05, 0.9],
                [0.0, 1.0],
            ],
            tooth: Tooth::Biserrate,
            teeth: 8.0,
            depth: 0.042,
            entire: 0.2,
        },
        LeafShape::Round => Form {
            margin: &[
                [0.0, 0.0],
                [0.15, 0.005],
                [0.32, 0.075],
                [0.45, 0.24],
                [0.5, 0.43],
                [0.46, 0.65],
                [0.33, 0.83],
                [0.15, 0.945],
                [0.05, 0.98],
                [0.0, 1.0],
            ],
            tooth: Tooth::Crenate,
            teeth: 9.0,
            depth: 0.028,
            entire: 0.12,
        },
        LeafShape::Cordate => Form {
            margin: &[
                [0.0, 0.11],
                [0.07, 0.03],
                [0.2, 0.0],
                [0.36, 0.055],
                [0.47, 0.2],
                [0.5, 0.36],
                [0.45, 0.54],
                [0.33, 0.7],
                [0.18, 0.82],
                [0.07, 0.9],
                [0.02, 0.96],
                [0.0, 1.0],
            ],
            tooth: Tooth::Serrate,
            teeth: 20.0,
            depth: 0.018,
            entire: 0.16,
        },
        LeafShape::Obovate => Form {
            margin: &[
                [0.0, 0.06],
                [0.06, 0.015],
                [0.15, 0.0],
                [0.28, 0.07],
                [0.4, 0.23],
                [0.48, 0.42],
                [0.5, 0.59],
                [0.45, 0.75],
                [0.3, 0.855],
                [0.14, 0.9],
                [0.05, 0.935],
                [0.0, 1.0],
            ],
            tooth: Tooth::Biserrate,
            teeth: 10.0,
            depth: 0.042,
            entire: 0.12,
        },
        LeafShape::Lobed => Form {
            margin: &[
                [0.0, 0.015],
                [0.055, 0.0],
                [0.1, 0.025],
                [0.075, 0.07],
                [0.1, 0.12],
                [0.225, 0.165],
                [0.25, 0.212],
                [0.215, 0.25],
                [0.135, 0.285],
                [0.342, 0.36],
                [0.38, 0.407],
                [0.327, 0.445],
                [0.2, 0.485],
                [0.441, 0.565],
                [0.49, 0.612],
                [0.421, 0.65],
                [0.27, 0.69],
                [0.387, 0.76],
                [0.43, 0.807],
                [0.37, 0.845],
                [0.25, 0.875],
                [0.24, 0.925],
                [0.17, 0.985],
                [0.07, 0.985],
                [0.0, 1.0],
            ],
            tooth: Tooth::Crenate,
            teeth: 0.0,
            depth: 0.0,
            entire: 1.0,
        },
        LeafShape::Pinnate => Form {
            margin: &[
                [0.0, 0.0],
                [0.2, 0.025],
                [0.41, 0.13],
                [0.5, 0.32],
                [0.48, 0.55],
                [0.37, 0.74],
                [0.2, 0.88],
                [0.07, 0.965],
                [0.0, 1.0],
            ],
            tooth: Tooth::Serrate,
            teeth: 12.0,
            depth: 0.03,
            entire: 0.24,
        },
        // A needle has no outline of its own here: it is drawn as a stroke.
        LeafShape::Lanceolate | LeafShape::Needle | LeafShape::Tuft | LeafShape::Bundle => Form {
            margin: &[
                [0.0, 0.0],
                [0.15, 0.05],
                [0.38, 0.2],
                [0.5, 0.4],
                [0.45, 0.6],
                [0.31, 0.78],
                [0.13, 0.93],
                [0.0, 1.0],
            ],
            tooth: Tooth::Serrate,
            teeth: 24.0,
            depth: 0.005,
            entire: 0.1,
        },
    }
}

impl Outline {
    /// Of a leaf `ratio` times as wide as long, of a compound one a leaflet.
    pub fn new(shape: LeafShape, ratio: f32) -> Outline {
        let form = form(shape);
        let points: Vec<Vec2> = form.margin.iter().map(|&[x, y]| Vec2::new(x * ratio, y)).collect();
        let margin = toothed(&curve(&points), &form);
        let lowest = (0..margin.len()).min_by(|&a, &b| margin[a].y.total_cmp(&margin[b].y));
        let (gap, side) = margin.split_at(lowest.unwrap_or(0));
        let outer = widths(side);
        let widest = outer.iter().copied().fold(0.0, f32::max);
        let gap: Vec<Vec2> = gap.iter().chain(side.first()).copied().collect();
        Outline { outer, inner: widths(&gap), foot: points[0].y, widest }
    }

    /// Of a species' leaves; a leaflet is three times as long as wide.
    pub fn of(foliage: &Foliage) -> Outline {
        let ratio = match foliage.shape {
            LeafShape::Pinnate => 0.34,
            _ => foliage.leaf_width_m / foliage.leaf_length_m.max(1e-6),
        };
        Outline::new(foliage.shape, ratio.clamp(0.01, 1.6))
    }

    /// From the midrib to the gap's side and to the margin, at `t` 0…1 from the lowest point.
    pub fn at(&self, t: f32) -> [f32; 2] {
        let at = t.clamp(0.0, 1.0) * STEPS as f32;
        let k = (at as usize).min(STEPS - 1);
        let part = at - k as f32;
        [&self.inner, &self.outer].map(|table| table[k] + (table[k + 1] - table[k]) * part)
    }

    /// Greatest half width between two shares of the length.
    pub fn reach(&self, from: f32, to: f32) -> f32 {
        let [from, to] = [from, to].map(|t| (t.clamp(0.0, 1.0) * STEPS as f32) as usize);
        self.outer[from..=to].iter().copied().fold(0.0, f32::max)
    }

    /// Over the square of the length.
    pub fn area(&self) -> f32 {
        let both = self.outer.iter().zip(&self.inner);
        2.0 * both.map(|(outer, inner)| outer - inner).sum::<f32>() / STEPS as f32
    }
}

/// A curve through all points (Catmull and Rom), straight at its ends.
fn curve(points: &[Vec2]) -> Vec<Vec2> {
    let last = points.len() - 1;
    let mut out = Vec::with_capacity(FINE * last + 1);
    for k in 0..last {
        let (b, c) = (points[k], points[k + 1]);
        let a = if k > 0 { points[k - 1] } else { 2.0 * b - c };
        let d = if k + 1 < last { points[k + 2] } else { 2.0 * c - b };
        out.extend((0..FINE).map(|i| {
            let t = i as f32 / FINE as f32;
            let bend =
                (c - a) + (2.0 * a - 5.0 * b + 4.0 * c - d) * t + (3.0 * (b - c) + d - a) * (t * t);
            b + 0.5 * bend * t
        }));
    }
    out.push(points[last]);
    out
}

/// The margin with its teeth cut in; they begin past what is entire and are shallow at both ends.
fn toothed(margin: &[Vec2], form: &Form) -> Vec<Vec2> {
    let mut so_far = vec![0.0];
    for w in margin.windows(2) {
        so_far.push(so_far[so_far.len() - 1] + w[0].distance(w[1]));
    }
    let whole = so_far[so_far.len() - 1].max(1e-9);
    let inset = |k: usize| {
        let share = (so_far[k] / whole - form.entire) / (1.0 - form.entire);
        let ends = (share * 6.0).min((1.0 - share) * 10.0).clamp(0.0, 1.0);
        form.depth * ends * form.tooth.inset((share.max(0.0) * form.teeth).fract())
    };
    let inward = |k: usize| {
        let (a, b) = (margin[k.saturating_sub(1)], margin[(k + 1).min(margin.len() - 1)]);
        (b - a).normalize_or_zero().perp()
    };
    let moved = |k: usize| margin[k] + inward(k) * inset(k);
    (0..margin.len()).map(moved).map(|p| p.max(Vec2::ZERO)).collect()
}

/// The greatest distance of a line from the midrib at every step of the length.
fn widths(line: &[Vec2]) -> [f32; STEPS + 1] {
    let mut table = [0.0f32; STEPS + 1];
    for w in line.windows(2) {
        let (low, high) = if w[0].y < w[1].y { (w[0], w[1]) } else { (w[1], w[0]) };
        let [from, to] = [low.y, high.y].map(|y| (y * STEPS as f32).clamp(0.0, STEPS as f32));
        for (k, half) in
            table.iter_mut().enumerate().take(to as usize + 1).skip(from.ceil() as usize)
        {
            let share = (k as f32 - from) / (to - from).max(1e-6);
            *half = half.max(low.x + (high.x - low.x) * share);
        }
    }
    table
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::species::load;

    fn of(name: &str) -> Outline {
        Outline::of(&load(name).unwrap().foliage)
    }

    /// Bays of a species' margin above the middle of its leaves.
    fn bays(name: &str) -> usize {
        let f = load(name).unwrap().foliage;
        let form = form(f.shape);
        let ratio = f.leaf_width_m / f.leaf_length_m;
        let points: Vec<Vec2> = form.margin.iter().map(|&[x, y]| Vec2::new(x * ratio, y)).collect();
        let smooth = widths(&curve(&points));
        let toothed = Outline::new(f.shape, ratio).outer;
        let depth = |k: usize| smooth[k] - toothed[k];
        (STEPS / 2..STEPS * 19 / 20)
            .filter(|&k| depth(k) > depth(k - 1) + 1e-5 && depth(k) > depth(k + 1) + 1e-5)
            .count()
    }

    #[test]
    fn a_lime_leaf_is_heart_shaped_and_drawn_out() {
        let lime = of("tilia_cordata");
        assert!(lime.foot > 0.08);
        let [gap, margin] = lime.at(0.04);
        assert!(gap > 0.02 && margin > 2.0 * gap, "{gap} {margin}");
        assert_eq!(lime.at(lime.foot + 0.02)[0], 0.0);
        // Concave below the tip.
        let half = |t: f32| lime.at(t)[1];
        assert!(half(0.92) < 0.4 * half(0.82) && half(0.92) < 0.5 * (half(0.82) + half(1.0)));
    }

    #[test]
    fn a_hazel_leaf_is_widest_above_its_middle_and_ends_abruptly() {
        let hazel = of("corylus_avellana");
        let half = |t: f32| hazel.at(t)[1];
        assert!(hazel.reach(0.5, 0.7) >= hazel.widest - 1e-6 && half(0.25) < 0.9 * half(0.6));
        assert!(half(0.85) > 0.55 * hazel.widest && half(0.95) < 0.15 * hazel.widest);
    }

    #[test]
    fn margins_have_the_teeth_of_their_species() {
        let teeth = |name: &str| bays(name);
        assert!((3..=8).contains(&teeth("sorbus_aucuparia")), "{}", teeth("sorbus_aucuparia"));
        assert!((5..=14).contains(&teeth("tilia_cordata")), "{}", teeth("tilia_cordata"));
        assert!((2..=5).contains(&teeth("populus_tremula")), "{}", teeth("populus_tremula"));
        for name in ["corylus_avellana", "betula_pendula"] {
            assert!(teeth(name) > 6, "{name}: {}", teeth(name));
        }
        assert_eq!(teeth("quercus_robur"), 0);
    }

    #[test]
    fn an_oak_leaf_has_lobes() {
        let oak = of("quercus_robur");
        let half = |t: f32| oak.at(t)[1];
        let is_bay = |k: &usize| {
            let t = *k as f32 / 100.0;
            half(t) < 0.8 * oak.reach(t - 0.12, t) && half(t) < 0.8 * oak.reach(t, t + 0.12)
        };
        let bays: Vec<usize> = (15..88).filter(is_bay).collect();
        let apart = bays.windows(2).filter(|w| w[1] > w[0] + 1).count() + 1;
        assert!((3..=4).contains(&apart), "{bays:?}");
    }

    #[test]
    fn leaves_are_as_wide_as_they_are_said_to_be() {
        for name in ["tilia_cordata", "quercus_robur", "salix_caprea", "betula_pendula"] {
            let f = load(name).unwrap().foliage;
            let off = 2.0 * of(name).widest * f.leaf_length_m / f.leaf_width_m;
            assert!((0.88..1.03).contains(&off), "{name}: {off}");
        }
    }
}
