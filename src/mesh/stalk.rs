//! The bare shoots by which cards of twigs hang from wood that is meshed, where no leaves hide them or they would
//! hang in the air: a slender triangle each.
//!
//! They stand for shoots that have no triangles of their own, and part as these do. Limit: each is straight, and
//! ends in a point: at its twig or, where that is thicker than what it springs from, there.

use glam::{Vec2, Vec3};

use super::Surface;
use super::card::BENT;
use super::piece::{Piece, Room, fill};
use super::spot::{Pose, Spot};
use super::wind::Wind;
use crate::skeleton::Skeleton;

/// What a stalk takes.
pub const ROOM: Room = Room { vertices: 3, triangles: 1 };
/// Thinner and shorter ones are not made, metres.
const LEAST_M: [f32; 2] = [0.002, 0.02];
/// Nor, beside leaves, those thinner than so much of their length.
const SLENDEREST: f32 = 0.012;

/// Where a stalk begins.
#[derive(Debug, Clone, Copy, Default)]
pub struct Foot {
    at: Vec3,
    radius_m: f32,
    /// With which it sways.
    node: u32,
}

/// Where each twig's stalk begins, and how thick: at the next twig, or beside the next stalk, down the shoots that
/// are not meshed, so that stalks part as these do; and only then at wood. `bases`: where they end; `stoutest`:
/// radius over that of the shoot that the twig is on, at most.
pub fn feet(
    skeleton: &Skeleton,
    is_meshed: &[bool],
    kept: &[Spot],
    bases: &[Vec3],
    stoutest: f32,
) -> Vec<Foot> {
    let place = |node: u32| skeleton.position[node as usize];
    let base = |node: u32| place(skeleton.parent_of(node).unwrap_or(0));
    let mut order: Vec<u32> = (0..kept.len() as u32).collect();
    order.sort_by(|a, b| {
        let [a, b] = [a, b].map(|k| &kept[*k as usize]);
        let along = |s: &Spot| s.at.distance_squared(base(s.node()));
        a.node().cmp(&b.node()).then(along(a).total_cmp(&along(b))).then(a.key.cmp(&b.key))
    });
    // Of each shoot the twig farthest out so far, or else the ends of a stalk that passes it.
    let mut ends: Vec<Option<[Vec3; 2]>> = vec![None; skeleton.len()];
    let mut feet = vec![Foot::default(); kept.len()];
    for k in order {
        let (own, tip) = (kept[k as usize].node(), bases[k as usize]);
        let (mut at, mut foot) = (own, ends[own as usize].map(|[_, twig]| twig));
        if is_meshed[own as usize] {
            foot = Some(kept[k as usize].at);
        }
        let mut thickest = own;
        while foot.is_none()
            && let Some(before) = skeleton.parent_of(at)
        {
            foot = match (is_meshed[before as usize], ends[before as usize]) {
                (true, _) => Some(place(before)),
                (false, Some([a, b])) => Some(nearest(place(before), a, b)),
                (false, None) => None,
            };
            thickest = at;
            at = before;
        }
        let foot = foot.unwrap_or(place(at));
        let mut passed = own;
        while passed != at
            && let Some(before) = skeleton.parent_of(passed)
        {
            ends[passed as usize] = Some([foot, tip]);
            passed = before;
        }
        ends[own as usize] = Some([tip; 2]);
        let radius_m = |node: u32| skeleton.radius_m[node as usize];
        let radius_m = radius_m(thickest).min(stoutest * radius_m(own));
        feet[k as usize] = Foot { at: foot, radius_m, node: at };
    }
    feet
}

/// The stalks alone of twigs that leaves hide from near: as thick as the shoots that they stand for.
pub fn hung(
    skeleton: &Skeleton,
    is_meshed: &[bool],
    kept: &[Spot],
    poses: &[Pose],
    uv: Vec2,
    wind: Option<&Wind>,
) -> Surface {
    let bases: Vec<Vec3> = poses.iter().map(|pose| pose.base).collect();
    let mut feet = feet(skeleton, is_meshed, kept, &bases, f32::INFINITY);
    for (foot, base) in feet.iter_mut().zip(&bases) {
        foot.radius_m = foot.radius_m.max(SLENDEREST * foot.at.distance(*base));
    }
    let each = |k: usize, out: &mut Piece| emit(&poses[k], &feet[k], 0.0, uv, out);
    let mut stalks = fill(kept.len(), ROOM, each, None);
    if let Some(wind) = wind {
        wind.stalks(kept.iter().zip(&feet).map(|(s, foot)| [foot.node, s.node()]), &mut stalks);
    }
    stalks
}

/// The place between two others that is nearest to a third.
pub fn nearest(to: Vec3, a: Vec3, b: Vec3) -> Vec3 {
    let way = b - a;
    let along = (to - a).dot(way) / way.length_squared().max(1e-12);
    a + way * along.clamp(0.0, 1.0)
}

/// The bare shoot from wood to the foot of a card, as one slender triangle of the colour at `uv`. `stem`: half the
/// width of what the card shows at its foot, share of its length; the end of a thicker one would hang in the air.
pub fn emit(pose: &Pose, foot: &Foot, stem: f32, uv: Vec2, out: &mut Piece) {
    let [thin_m, short_m] = LEAST_M;
    let way = pose.base - foot.at;
    let (way, from) = match way.length() < short_m {
        true => (pose.heading * short_m, pose.base - pose.heading * short_m),
        false => (way, foot.at),
    };
    let any = way.normalize_or(Vec3::Z).any_orthonormal_vector();
    let across = way.cross(pose.facing).normalize_or(any);
    let facing = across.cross(way).normalize_or(pose.facing);
    let [foot_m, stem_m] = [foot.radius_m.max(thin_m), stem * pose.size_m];
    let corners = match stem_m > foot_m {
        true => [pose.base + across * stem_m, pose.base - across * stem_m, from],
        false => [from - across * foot_m, from + across * foot_m, pose.base],
    };
    let put = |p: Vec3| out.vertex(p, pose.bent(facing.into(), p.into(), BENT).into(), uv);
    let corners = corners.map(put);
    out.triangle(corners);
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Those of bare twigs, however long, show no more wood than there is.
    #[test]
    fn a_stalk_is_as_thick_as_its_foot() {
        let species = crate::species::load("betula_pendula").unwrap();
        let pose = Pose { base: Vec3::X, ..Pose::measured(&species.foliage) };
        let foot = Foot { radius_m: 0.003, ..Foot::default() };
        let made = |stem: f32| {
            let stalk = fill(1, ROOM, |_, out| emit(&pose, &foot, stem, Vec2::ZERO, out), None);
            [0, 1, 2].map(|k| stalk.position[k])
        };
        let [a, b, tip] = made(0.001);
        assert!((a.distance(b) - 0.006).abs() < 1e-6 && tip == Vec3::X, "{a} {b} {tip}");
        // Or as its twig, where that is thicker.
        let stem = 0.02 / pose.size_m;
        let [c, d, tip] = made(stem);
        assert!((c.distance(d) - 0.04).abs() < 1e-6 && c.midpoint(d).distance(Vec3::X) < 1e-6);
        assert!(tip == Vec3::ZERO && (d - c).cross(tip - c).dot((b - a).cross(Vec3::X - a)) > 0.0);
    }
}
