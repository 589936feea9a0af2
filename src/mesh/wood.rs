//! Which axes of a skeleton become tubes, and how finely, within a budget of triangles.

use super::path::{Foot, Knot, Ring, Scratch, rings};
use super::tube::{Barks, Circles, count, tube};
use super::{FoliageLevel, MeshOptions, Surface};
use crate::seed::Seed;
use crate::skeleton::{Axis, Skeleton};
use crate::texture::BARK_REPEAT_M;

/// The rings of all tubes; axis k has `ring[span[k].0..span[k].1]`.
pub struct Wood {
    ring: Vec<Ring>,
    span: Vec<(usize, usize)>,
    pub triangles: usize,
    vertices: usize,
}

/// How much coarser each attempt to meet a budget is, and how many are made.
const COARSER: f32 = 1.25;
const ATTEMPTS: u32 = 36;

/// Plans the wood; with a budget, coarser until it fits: thin axes, which foliage hides, go first,
/// then sides and rings. The stem always stays.
pub fn plan(
    skeleton: &Skeleton,
    axes: &[Axis],
    options: &MeshOptions,
    budget: Option<usize>,
    has_young: bool,
) -> Wood {
    let height_m = skeleton.height_m();
    let mixed_m = has_young.then(|| YOUNG_HEIGHT.map(|h| h * height_m));
    let tolerance_m = options.tolerance_m.clamp(1e-5, 1.0);
    let mut wood = attempt(skeleton, axes, tolerance_m, 0.0, options.detail, mixed_m);
    let Some(budget) = budget else { return wood };
    // Bare twigs are the crown: there sides go before axes.
    let is_bare = options.foliage == FoliageLevel::None;
    let thin_m = if is_bare { 0.0003 } else { 0.0015 };
    let mut coarse = 1.0;
    for _ in 0..ATTEMPTS {
        if wood.triangles <= budget {
            return wood;
        }
        // Far from the budget, larger steps.
        let over = wood.triangles as f32 / budget.max(1) as f32;
        coarse *= COARSER.powf(over.log2().clamp(1.0, 4.0));
        let cut_m = thin_m * (coarse - 1.0);
        let detail = options.detail && coarse < 3.0;
        wood = attempt(skeleton, axes, tolerance_m * coarse.powf(0.6), cut_m, detail, mixed_m);
    }
    wood
}

fn attempt(
    skeleton: &Skeleton,
    axes: &[Axis],
    tolerance_m: f32,
    cut_m: f32,
    detail: bool,
    mixed_m: Option<[f32; 2]>,
) -> Wood {
    let mut wood = Wood { ring: Vec::new(), span: Vec::new(), triangles: 0, vertices: 0 };
    wood.ring.reserve(skeleton.len() * 2);
    let mut knots = Vec::new();
    let mut scratch = Scratch::default();
    for (k, axis) in axes.iter().enumerate() {
        let Some(&first) = axis.nodes.first() else { continue };
        // Radii never grow outward: what springs from a dropped axis is thinner still.
        if k > 0 && skeleton.radius_m[first as usize] < cut_m {
            continue;
        }
        let foot = knots_of(skeleton, axis, mixed_m, &mut knots);
        let start = wood.ring.len();
        rings(&knots, foot, tolerance_m, detail, &mut scratch, &mut wood.ring);
        let (triangles, vertices) = count(&wood.ring[start..]);
        if triangles > 0 {
            wood.span.push((start, wood.ring.len()));
            wood.triangles += triangles;
            wood.vertices += vertices;
        }
    }
    wood
}

/// The knots of an axis: from its parent's axis to its tip, radii as the mean of both nodes at a
/// shared base (P18).
fn knots_of(
    skeleton: &Skeleton,
    axis: &Axis,
    mixed_m: Option<[f32; 2]>,
    knots: &mut Vec<Knot>,
) -> Foot {
    knots.clear();
    let at = |i: u32| skeleton.position[i as usize];
    let radius = |i: u32| skeleton.radius_m[i as usize].min(1e4);
    let mut foot = Foot::Ground { mixed_m };
    if let (Some(base), Some(&first)) = (axis.base, axis.nodes.first()) {
        knots.push(Knot { at: at(base), radius_m: radius(first) });
        // Several stems may spring from the root.
        if base != 0 {
            let before = skeleton.parent_of(base).unwrap_or(base);
            foot = Foot::Branch {
                parent_radius_m: radius(base),
                parent_direction: (at(base) - at(before)).normalize_or_zero(),
            };
        }
    }
    for (k, &i) in axis.nodes.iter().enumerate() {
        let next = axis.nodes.get(k + 1).copied().unwrap_or(i);
        let mean = if k == 0 && axis.base.is_none() {
            radius(i)
        } else {
            0.5 * (radius(i) + radius(next))
        };
        knots.push(Knot { at: at(i), radius_m: mean });
    }
    foot
}

/// Bark is young where the wood is thin, or high up: radius over that of the stem's foot and height
/// over the tree's, from all old to all young.
const YOUNG_RADIUS: [f32; 2] = [0.5, 0.3];
const YOUNG_HEIGHT: [f32; 2] = [0.3, 0.6];

impl Wood {
    /// The triangles of all tubes: old bark, and young bark where `has_young`.
    pub fn surfaces(&self, skeleton: &Skeleton, has_young: bool, seed: Seed) -> [Surface; 2] {
        let circles = Circles::new();
        let [mut old, mut young] = [Surface::default(), Surface::default()];
        if !has_young {
            old.position.reserve_exact(self.vertices);
            old.normal.reserve_exact(self.vertices);
            old.uv.reserve_exact(self.vertices);
            old.index.reserve_exact(self.triangles * 3);
        }
        let (foot_m, height_m) = (skeleton.radius_m[0].max(1e-6), skeleton.height_m().max(1e-6));
        let part = |x: f32, range: [f32; 2]| (x - range[0]) / (range[1] - range[0]);
        let share = |ring: &Ring| {
            let thin = part(ring.radius_m / foot_m, YOUNG_RADIUS);
            let high = part(ring.centre.z / height_m, YOUNG_HEIGHT);
            if has_young { thin.max(high).clamp(0.0, 1.0) } else { 0.0 }
        };
        for (k, &(start, end)) in self.span.iter().enumerate() {
            let mut barks = Barks {
                surface: [&mut old, &mut young],
                young: &share,
                draws: seed.derive("bark", k as u64).draws(),
                repeat_m: BARK_REPEAT_M,
            };
            tube(&self.ring[start..end], &circles, &mut barks);
        }
        [old, young]
    }
}
