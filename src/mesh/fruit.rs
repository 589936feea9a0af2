//! A user's own cones, berries or catkins, on the shoots that bear leaves.
//!
//! Each place a twig may have bears one by chance, so many a metre as the species says, more of them
//! outside; a smaller budget keeps some of the same.

use super::foliage::{FoliageLevel, Order};
use super::piece::{Piece, fill};
use super::spot::{Hull, Pose, spots};
use super::{Surface, stamp};
use crate::skeleton::Skeleton;
use crate::species::model::Foliage;

/// Share of the leaves' budget at most.
const SHARE: f32 = 0.25;
/// Triangles where there is no budget.
const MOST_TRIANGLES: usize = 4_000_000;

/// The fruit of a tree; none where the species has none, or too little is seen of it.
pub fn fruit(skeleton: &Skeleton, order: &Order<'_>) -> Surface {
    let (fruit, leaves) = (&order.species.fruit, &order.species.foliage);
    let is_seen = matches!(order.level, FoliageLevel::Cards | FoliageLevel::Geometry);
    let Some(model) = order.species.own_fruit.as_deref().filter(|_| is_seen) else {
        return Surface::default();
    };
    let bears = skeleton.bears_leaves(leaves.bearing_radius_m);
    let Some(hull) = Hull::around(skeleton, &bears).map(Hull::blunt) else {
        return Surface::default();
    };
    let from_m = hull.height_m(fruit.from);
    let stand = Foliage {
        twig_length_m: fruit.length_m.min(hull.longest_twig_m()),
        twigs_per_m: leaves.twigs_per_m.max(fruit.per_m),
        droop: fruit.droop,
        ..leaves.clone()
    };
    let (mut spots, per_m) = spots(skeleton, &stand, &bears, &hull);
    spots.retain(|s| !s.is_tip && s.at.z >= from_m);
    let room = stamp::room(model);
    let budget = order.budget.map_or(MOST_TRIANGLES, |b| (b as f32 * SHARE) as usize);
    let most = budget / room.triangles.max(1);
    // More of them in the light, outside.
    let weight = |at| hull.depth(at).clamp(0.3, 1.0).powi(3);
    let wanted = fruit.per_m / per_m.max(1e-6) * spots.len() as f32;
    let total: f32 = spots.iter().map(|s| weight(s.at)).sum();
    let share = wanted.min(most as f32) / total.max(1e-6);
    let seed = order.seed.derive("fruit", 0);
    spots.retain(|s| seed.derive("borne", s.key).draws().unit() < share * weight(s.at));
    spots.truncate(most);
    let emit = |k: usize, out: &mut Piece| {
        let mut draws = seed.derive("fruit", spots[k].key).draws();
        let pose = Pose::of(&spots[k], spots[k].at, &stand, &hull, [1.0; 2], &mut draws);
        stamp::emit(model, &pose, stamp::BENT_FRUIT, out);
    };
    fill(spots.len(), room, emit, order.wind.map(|wind| (wind, spots.as_slice())))
}
