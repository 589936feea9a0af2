//! The bare shoots by which cards of twigs hang from wood that is meshed, where no leaves hide them or they would
//! hang in the air: a slender triangle each or, where others spring from it or leaves begin, a strip.
//!
//! They stand for shoots that have no triangles of their own, and part as these do: what springs from another is
//! no thicker than that is there. Limit: each is straight, and a triangle ends in a point: at its twig or, where
//! that is thicker than what it springs from, there.

use glam::{Vec2, Vec3};

use super::Surface;
use super::card::BENT;
use super::piece::{Piece, Room, fill};
use super::spot::{Pose, Spot};
use super::wind::Wind;
use crate::skeleton::Skeleton;

/// What a triangle takes, and a strip.
const POINTED: Room = Room { vertices: 3, triangles: 1 };
const STRIP: Room = Room { vertices: 4, triangles: 2 };
/// Thinner and shorter ones are not made, metres.
const LEAST_M: [f32; 2] = [0.002, 0.02];
/// Nor, beside leaves, those thinner than so much of their length.
const SLENDEREST: f32 = 0.012;

/// Triangles that one of a bare twig takes as a rule.
pub const EACH: f32 = 1.25;

/// Where each twig's stalk begins, and which others spring from it.
#[derive(Debug, Default)]
pub struct Feet {
    /// From the wood outwards.
    order: Vec<u32>,
    foot: Vec<Foot>,
}

#[derive(Debug, Clone, Copy, Default)]
struct Foot {
    at: Vec3,
    /// Of the thickest shoot that it stands for.
    radius_m: f32,
    /// With which it sways.
    node: u32,
    /// The stalk that it springs from.
    on: Option<u32>,
    /// Whether others spring from it.
    carries: bool,
}

impl Foot {
    fn room(&self, is_bare: bool) -> Room {
        if self.carries || !is_bare { STRIP } else { POINTED }
    }
}

impl Feet {
    /// At the next twig, or beside the next stalk, down the shoots that are not meshed, so that stalks part as these
    /// do; and only then at wood. Each as if it ended where its twig stands.
    pub fn of(skeleton: &Skeleton, is_meshed: &[bool], kept: &[Spot]) -> Feet {
        let bases: Vec<Vec3> = kept.iter().map(|s| s.at).collect();
        Feet::ending_at(&bases, skeleton, is_meshed, kept, f32::INFINITY)
    }

    /// The same where they end at `bases`; `stoutest`: radius over that of the shoot that the twig is on, at most.
    pub fn ending_at(
        bases: &[Vec3],
        skeleton: &Skeleton,
        is_meshed: &[bool],
        kept: &[Spot],
        stoutest: f32,
    ) -> Feet {
        let place = |node: u32| skeleton.position[node as usize];
        let base = |node: u32| place(skeleton.parent_of(node).unwrap_or(0));
        let mut order: Vec<u32> = (0..kept.len() as u32).collect();
        order.sort_by(|a, b| {
            let [a, b] = [a, b].map(|k| &kept[*k as usize]);
            let along = |s: &Spot| s.at.distance_squared(base(s.node()));
            a.node().cmp(&b.node()).then(along(a).total_cmp(&along(b))).then(a.key.cmp(&b.key))
        });
        // Of each shoot the twig farthest out so far, or else the ends of a stalk that passes it.
        let mut ends: Vec<Option<(u32, [Vec3; 2])>> = vec![None; skeleton.len()];
        let mut feet = vec![Foot::default(); kept.len()];
        for &k in &order {
            let (own, tip) = (kept[k as usize].node(), bases[k as usize]);
            let mut at = own;
            let mut foot = ends[own as usize].map(|(on, [_, twig])| (Some(on), twig));
            if is_meshed[own as usize] {
                foot = Some((None, kept[k as usize].at));
            }
            let mut thickest = own;
            while foot.is_none()
                && let Some(before) = skeleton.parent_of(at)
            {
                foot = match (is_meshed[before as usize], ends[before as usize]) {
                    (true, _) => Some((None, place(before))),
                    (false, Some((on, [a, b]))) => Some((Some(on), nearest(place(before), a, b))),
                    (false, None) => None,
                };
                thickest = at;
                at = before;
            }
            let (on, foot) = foot.unwrap_or((None, place(at)));
            let mut passed = own;
            while passed != at
                && let Some(before) = skeleton.parent_of(passed)
            {
                ends[passed as usize] = Some((k, [foot, tip]));
                passed = before;
            }
            ends[own as usize] = Some((k, [tip; 2]));
            let radius_m = |node: u32| skeleton.radius_m[node as usize];
            let radius_m = radius_m(thickest).min(stoutest * radius_m(own));
            if let Some(on) = on {
                feet[on as usize].carries = true;
            }
            let carries = feet[k as usize].carries;
            feet[k as usize] = Foot { at: foot, radius_m, node: at, on, carries };
        }
        Feet { order, foot: feet }
    }

    /// Triangles of them all, of bare twigs or of leafy ones.
    pub fn triangles(&self, is_bare: bool) -> usize {
        self.foot.iter().map(|foot| foot.room(is_bare).triangles).sum()
    }

    /// Half the width of each where it begins and ends. `stem_m`: of what its card shows at its foot.
    fn half_m(&self, poses: &[Pose], stem_m: &[f32], is_bare: bool) -> Vec<[f32; 2]> {
        let [thin_m, _] = LEAST_M;
        let slenderest = if is_bare { 0.0 } else { SLENDEREST };
        let length_m = |k: usize| self.foot[k].at.distance(poses[k].base);
        let wished_m = |k: usize| self.foot[k].radius_m.max(thin_m).max(slenderest * length_m(k));
        let mut half_m: Vec<[f32; 2]> = (0..poses.len()).map(|k| [wished_m(k), 0.0]).collect();
        for (k, foot) in self.foot.iter().enumerate() {
            if let Some(on) = foot.on {
                let end_m = &mut half_m[on as usize][1];
                *end_m = end_m.max(wished_m(k));
            }
        }
        for k in self.order.iter().map(|k| *k as usize) {
            let foot = self.foot[k];
            if let Some(on) = foot.on.map(|on| on as usize) {
                let share = self.foot[on].at.distance(foot.at) / length_m(on).max(1e-6);
                let [from_m, to_m] = half_m[on];
                let there_m = from_m + (to_m - from_m) * share.min(1.0);
                half_m[k][0] = half_m[k][0].min(there_m.max(thin_m));
            }
            let [from_m, to_m] = half_m[k];
            half_m[k][1] = to_m.min(from_m).max(stem_m[k]).max(thin_m);
        }
        half_m
    }
}

/// The stalks of cards of bare twigs, or of leafy ones, which hide the rest of them: as thick as the shoots that they
/// stand for. `stems`: half the width of what each card shows at its foot, share of its length.
pub fn stalks(
    feet: &Feet,
    kept: &[Spot],
    poses: &[Pose],
    stems: &[f32],
    (is_bare, uv): (bool, Vec2),
    wind: Option<&Wind>,
) -> Surface {
    let stem_m: Vec<f32> = poses.iter().zip(stems).map(|(p, stem)| stem * p.size_m).collect();
    let half_m = feet.half_m(poses, &stem_m, is_bare);
    let mut out = Surface::default();
    for room in [POINTED, STRIP] {
        let is_so = |k: &usize| feet.foot[*k].room(is_bare) == room;
        let which: Vec<usize> = (0..poses.len()).filter(is_so).collect();
        let each = |n: usize, out: &mut Piece| {
            let k = which[n];
            emit(&poses[k], feet.foot[k].at, half_m[k], room == STRIP, uv, out);
        };
        let mut part = fill(which.len(), room, each, None);
        if let Some(wind) = wind {
            let nodes = which.iter().flat_map(|&k| {
                let [foot, tip] = [feet.foot[k].node, kept[k].node()];
                // Where a triangle is wide it has two.
                let is_turned = room == POINTED && half_m[k][1] > half_m[k][0];
                let [two, rest] = if is_turned { [tip, foot] } else { [foot, tip] };
                (0..room.vertices).map(move |n| if n < 2 { two } else { rest })
            });
            wind.stalks(nodes, &mut part);
        }
        out.append(part);
    }
    out
}

/// The place between two others that is nearest to a third.
pub fn nearest(to: Vec3, a: Vec3, b: Vec3) -> Vec3 {
    let way = b - a;
    let along = (to - a).dot(way) / way.length_squared().max(1e-12);
    a + way * along.clamp(0.0, 1.0)
}

/// The bare shoot from wood to the foot of a card, of the colour at `uv`. `half_m`: half its width where it begins and
/// ends; of a slender triangle the wider end counts alone.
fn emit(pose: &Pose, foot: Vec3, half_m: [f32; 2], is_strip: bool, uv: Vec2, out: &mut Piece) {
    let [_, short_m] = LEAST_M;
    let way = pose.base - foot;
    let (way, from) = match way.length() < short_m {
        true => (pose.heading * short_m, pose.base - pose.heading * short_m),
        false => (way, foot),
    };
    let any = way.normalize_or(Vec3::Z).any_orthonormal_vector();
    let across = way.cross(pose.facing).normalize_or(any);
    let facing = across.cross(way).normalize_or(pose.facing);
    let [from_m, to_m] = half_m;
    let mut put = |p: Vec3| out.vertex(p, pose.bent(facing.into(), p.into(), BENT).into(), uv);
    let [foot, end] = [(from, from_m), (pose.base, to_m)]
        .map(|(at, half_m)| [at - across * half_m, at + across * half_m]);
    if is_strip {
        let [a, b, c, d] = [foot[0], foot[1], end[0], end[1]].map(&mut put);
        out.triangle([a, b, d]);
        out.triangle([a, d, c]);
        return;
    }
    let corners = match to_m > from_m {
        true => [end[1], end[0], from],
        false => [foot[0], foot[1], pose.base],
    };
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
        let feet = Feet { order: vec![0], foot: vec![foot] };
        let skeleton = Skeleton::default();
        let spot =
            Spot { at: Vec3::X, shoot: Vec3::X, turn: 0, is_tip: false, is_leader: false, key: 0 };
        assert_eq!(Feet::of(&skeleton, &[], &[]).triangles(true), 0);
        let made = |stem: f32| {
            let stalk = stalks(&feet, &[spot], &[pose], &[stem], (true, Vec2::ZERO), None);
            assert_eq!(stalk.triangles(), feet.triangles(true));
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
