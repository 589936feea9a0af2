//! Where along a tube old bark gives way to that of the upper stem and the branches: over one tile of a
//! bark that is old at its foot and young at its top, between two rings of its own. What is too thin, too
//! short or too coarse for that changes at a ring.

use super::junction::{self, Hole};
use super::path::{Least, Ring};
use super::young::{TRANSITION, UPPER, Young};
use crate::texture::bark::PURE;

/// How much of the tile is laid: what is left out at both ends is of one bark alone.
pub const SPAN: f32 = 1.0 - PURE;
/// How much longer or shorter than it is to scale a tile may be laid.
const STRETCH: f32 = 1.6;
/// A ring no farther from where the tile ends than this share of it is its end.
const NEAR: f32 = 0.12;
/// Where a tile finds no room it is moved by so much of its length, so often at most up and down.
const STEP: f32 = 0.15;
const STEPS: i32 = 8;

/// Says of each ring of a tube, the last of which is the apex, which bark it and the band below it have;
/// adds the rings that the tile begins and ends at. `tile_m`: how long it is at a radius.
pub fn part(
    rings: &mut Vec<Ring>,
    holes: &mut [Hole],
    young: &Young,
    least: Least,
    tile_m: impl Fn(f32) -> Option<f32>,
) {
    let Some(upper) = &young.upper else { return };
    let share = |ring: &Ring| upper.share(ring);
    let below_apex = rings.len().saturating_sub(1);
    let Some(first) = rings[..below_apex].iter().position(|r| share(r) >= 0.5) else { return };
    let mut from = first;
    if let Some(before) = first.checked_sub(1) {
        let [a, b] = [share(&rings[before]), share(&rings[first])];
        let t = ((0.5 - a) / (b - a).max(1e-6)).clamp(0.0, 1.0);
        let [low, high] = [&rings[before], &rings[first]];
        let middle_m = low.arc_m + (high.arc_m - low.arc_m) * t;
        let radius_m = low.radius_m + (high.radius_m - low.radius_m) * t;
        let long_m = tile_m(radius_m).map(|m| m * SPAN);
        if let Some([start, end]) = long_m.and_then(|m| ends(rings, holes, middle_m, m, least)) {
            rings[start + 1..=end].iter_mut().for_each(|r| r.bark = TRANSITION);
            from = end + 1;
        }
    }
    rings[from..].iter_mut().for_each(|r| r.bark = UPPER);
}

/// The rings between which a tile lies so long, its middle where it is to be or as near as feet leave it room;
/// `None` where they leave none.
fn ends(
    rings: &mut Vec<Ring>,
    holes: &mut [Hole],
    middle_m: f32,
    long_m: f32,
    least: Least,
) -> Option<[usize; 2]> {
    let [foot, .., last, _] = &rings[..] else { return None };
    let within_m = [foot.arc_m, last.arc_m];
    let near_m = (NEAR * long_m).max(2.0 * least.step_m);
    let steps = (0..=STEPS).flat_map(|k| [k, -k]).map(|k| STEP * long_m * k as f32);
    let [low, high] = steps.into_iter().find_map(|off_m| {
        let low_m = (middle_m - 0.5 * long_m + off_m).max(within_m[0]);
        let [low, high] = [low_m, low_m + long_m].map(|m| End::at(rings, holes, m, near_m));
        let stretch = (high.arc_m - low.arc_m) / long_m;
        let fits = high.arc_m <= within_m[1] && stretch * STRETCH >= 1.0 && stretch <= STRETCH;
        fits.then_some([low, high])
    })?;
    // The upper one first: that moves nothing below.
    let end = high.put(rings, holes, least);
    let start = low.put(rings, holes, least);
    Some([start, end + usize::from(low.is_new)])
}

/// Where a tile may end: a ring that is near, or nearest about a foot, or a new one.
struct End {
    ring: usize,
    arc_m: f32,
    is_new: bool,
}

impl End {
    fn at(rings: &[Ring], holes: &[Hole], arc_m: f32, near_m: f32) -> End {
        let above = rings.partition_point(|r| r.arc_m <= arc_m).clamp(1, rings.len() - 1);
        let [to_low, to_high] = [arc_m - rings[above - 1].arc_m, rings[above].arc_m - arc_m];
        let is_free = !holes.iter().any(|h| h.band as usize == above - 1 && h.is_about(arc_m));
        let is_new = to_low.min(to_high) > near_m && is_free;
        let ring = if to_low < to_high && !is_new { above - 1 } else { above };
        End { ring, arc_m: if is_new { arc_m } else { rings[ring].arc_m }, is_new }
    }

    fn put(&self, rings: &mut Vec<Ring>, holes: &mut [Hole], least: Least) -> usize {
        if self.is_new {
            junction::part(rings, holes, self.ring, junction::at(rings, self.arc_m, least));
        }
        self.ring
    }
}
