//! Where along a tube old bark gives way to that of the upper stem and the branches: over the few tiles
//! of one picture that is old at its foot and young at its top, between two rings of its own. What is too thin, too
//! short or too coarse for that changes at a ring.

use super::junction::{self, Hole};
use super::path::{Least, Ring};
use super::young::{TRANSITION, UPPER, Upper, Young};
use crate::texture::bark::PURE;

/// How much of the tile is laid: what is left out at both ends is of one bark alone.
pub const SPAN: f32 = 1.0 - PURE;
/// How much longer or shorter than they are to scale tiles may be laid; and how much that counts beside how far
/// they are moved.
const STRETCH: f32 = 1.6;
const UNLIKE: f32 = 0.5;
/// A ring no farther from where the tiles end than this share of them is their end.
const NEAR: f32 = 0.05;
/// The same of a single ring where bark changes, share of the tube's length.
const NEAR_ALONG: f32 = 0.02;
/// Where tiles find no room they are moved by so much of their length, so often at most up and down.
const STEP: f32 = 0.05;
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
    let Some(middle) = middle(rings, upper) else { return };
    let mut from = 0;
    if let Middle::At { arc_m, radius_m } = middle {
        let long_m = tile_m(radius_m).map(|m| m * SPAN);
        if let Some([start, end]) = long_m.and_then(|m| ends(rings, holes, arc_m, m, least)) {
            rings[start + 1..=end].iter_mut().for_each(|r| r.bark = TRANSITION);
            from = end + 1;
        } else {
            let near_m = rings.last().map_or(0.0, |apex| NEAR_ALONG * apex.arc_m);
            let end = End::at(rings, holes, arc_m, near_m.max(2.0 * least.step_m));
            from = end.put(rings, holes, least) + 1;
            // What closes a tube has the bark of its last ring.
            if from + 1 == rings.len() {
                let above_m = 0.5 * (rings[from - 1].arc_m + rings[from].arc_m);
                End::at(rings, holes, above_m, 0.0).put(rings, holes, least);
            }
        }
    }
    rings[from..].iter_mut().for_each(|r| r.bark = UPPER);
}

/// Where a tube is half old.
enum Middle {
    BelowIt,
    At { arc_m: f32, radius_m: f32 },
}

/// `None` where all is old. The same however many rings a tube has: by its own height and radius, which are
/// straight between them.
fn middle(rings: &[Ring], upper: &Upper) -> Option<Middle> {
    let [high_m, thin_m] = upper.half();
    let is_upper = |r: &Ring| r.centre.z >= high_m || r.radius_m <= thin_m;
    if high_m <= 0.0 || rings.first().is_some_and(is_upper) {
        return Some(Middle::BelowIt);
    }
    let first = rings.iter().position(is_upper)?;
    let [low, high] = [&rings[first - 1], &rings[first]];
    let share = |a: f32, b: f32, x: f32| if a == b { 1.0 } else { (x - a) / (b - a) };
    let by_height = share(low.centre.z, high.centre.z, high_m);
    let by_radius = share(low.radius_m, high.radius_m, thin_m);
    // The one that it reaches first.
    let within = [by_height, by_radius].into_iter().filter(|t| (0.0..=1.0).contains(t));
    let t = within.fold(1.0, f32::min);
    let mix = |a: f32, b: f32| a + (b - a) * t;
    Some(Middle::At {
        arc_m: mix(low.arc_m, high.arc_m),
        radius_m: mix(low.radius_m, high.radius_m),
    })
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
    let within = |off_m: f32| {
        let low_m = (middle_m - 0.5 * long_m + off_m).max(within_m[0]);
        let [low, high] = [low_m, low_m + long_m].map(|m| End::at(rings, holes, m, near_m));
        let own_m = high.arc_m - low.arc_m;
        let fits =
            high.arc_m <= within_m[1] && own_m * STRETCH >= long_m && own_m <= long_m * STRETCH;
        let aside_m = (0.5 * (low.arc_m + high.arc_m) - middle_m).abs();
        fits.then_some(([low, high], aside_m + UNLIKE * (own_m - long_m).abs()))
    };
    // Of those that are as good, the first, which was moved least.
    let steps = (0..=STEPS).flat_map(|k| [k, -k]).map(|k| STEP * long_m * k as f32);
    let best =
        steps.filter_map(within).reduce(|best, next| if next.1 < best.1 { next } else { best });
    let found = best.map(|(ends, _)| ends);
    let [low, high] = found?;
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
