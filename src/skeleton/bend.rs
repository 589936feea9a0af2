//! Wood bends, it has no corners: nodes added to the internodes of a grown tree, on the curve that
//! goes through all its nodes (cubic Hermite, tangents by the neighbours' distances as in
//! Catmull and Rom's splines). Limit: wood lies within [`OFF_M`] of that curve, or sixteen times as near
//! as before where an internode would take more than [`MOST`] nodes.

use glam::Vec3;

use super::{NO_PARENT, Skeleton};

/// How far an internode may be from the curve, metres.
const OFF_M: f32 = 0.006;
/// Nodes added to one internode at most.
const MOST: u32 = 3;

/// The same tree, its internodes bent: nodes keep their places and their order, and those added have the
/// other columns of the node beyond them. `may_stand` tells where one may be.
pub fn bent(tree: &Skeleton, may_stand: impl Fn(Vec3) -> bool) -> Skeleton {
    let n = tree.len();
    let onward = onward(tree);
    let way = |i: usize| tree.position[i] - tree.position[tree.parent[i] as usize];
    // Unit, at a node of the axis that goes on.
    let tangent = |i: usize| {
        let before = way(i);
        let Some(next) = onward[i] else { return before.normalize_or_zero() };
        let after = way(next);
        let (a, b) = (before.length(), after.length());
        (before.normalize_or_zero() * b + after.normalize_or_zero() * a).normalize_or_zero()
    };
    // No lower and no higher than what has grown.
    let all = (f32::INFINITY, f32::NEG_INFINITY);
    let (low_m, high_m) =
        tree.position.iter().skip(1).fold(all, |(l, h), p| (l.min(p.z), h.max(p.z)));
    let mut out = Skeleton::default();
    let mut new_id = vec![NO_PARENT; n];
    for i in 0..n {
        let mut parent = NO_PARENT;
        if let Some(p) = tree.parent_of(i as u32) {
            let p = p as usize;
            parent = new_id[p];
            let (from, to) = (tree.position[p], tree.position[i]);
            let length = from.distance(to);
            let chord = (to - from).normalize_or_zero();
            let goes_on = p != 0 && onward[p] == Some(i);
            let start = if goes_on { tangent(p) } else { chord };
            let end = tangent(i);
            let off_m = length * aside(start - chord, end - chord);
            let added = ((off_m / OFF_M).sqrt().floor() as u32).min(MOST);
            for k in 1..=added {
                let t = k as f32 / (added + 1) as f32;
                let s = 1.0 - t;
                let aside = (start - chord) * (t * s * s) - (end - chord) * (t * t * s);
                let mut at = from.lerp(to, t) + aside * length;
                at.z = at.z.clamp(low_m, high_m);
                if may_stand(at) {
                    parent = push(&mut out, tree, i, at, parent);
                }
            }
        }
        new_id[i] = push(&mut out, tree, i, tree.position[i], parent);
    }
    out
}

/// The greatest distance of a curve of length 1 from its chord, where its tangents are so far off it.
fn aside(start: Vec3, end: Vec3) -> f32 {
    let at = |t: f32| (start * (t * (1.0 - t) * (1.0 - t)) - end * (t * t * (1.0 - t))).length();
    at(0.25).max(at(0.5)).max(at(0.75))
}

/// Adds a node at a place, with the other columns of a node of the tree; gives its id.
fn push(out: &mut Skeleton, tree: &Skeleton, like: usize, at: Vec3, parent: u32) -> u32 {
    out.position.push(at);
    out.parent.push(parent);
    out.axis.push(tree.axis[like]);
    out.order.push(tree.order[like]);
    out.birth.push(tree.birth[like]);
    out.radius_m.push(tree.radius_m[like]);
    out.dead.extend(tree.dead.get(like));
    out.len() as u32 - 1
}

/// The node that goes on from each: of the same axis, else that which carries most.
fn onward(tree: &Skeleton) -> Vec<Option<usize>> {
    let n = tree.len();
    let mut carried = vec![1u32; n];
    for i in (1..n).rev() {
        carried[tree.parent[i] as usize] += carried[i];
    }
    let mut onward: Vec<Option<usize>> = vec![None; n];
    for i in 1..n {
        let p = tree.parent[i] as usize;
        let rank = |k: usize| (tree.axis[k] == tree.axis[p], carried[k]);
        if onward[p].is_none_or(|k| rank(i) > rank(k)) {
            onward[p] = Some(i);
        }
    }
    onward
}

#[cfg(test)]
mod tests {
    use super::*;

    /// One axis along so many points, with a branch from its middle.
    fn branched(points: &[Vec3]) -> Skeleton {
        let (n, middle) = (points.len() as u32, points.len() / 2);
        let tip = points[middle] + Vec3::new(0.3, 0.4, -0.2);
        let mut parent: Vec<u32> = (0..n).map(|i| i.checked_sub(1).unwrap_or(NO_PARENT)).collect();
        parent.push(middle as u32);
        let count = points.len() + 1;
        let mut axis = vec![0; count];
        axis[count - 1] = 1;
        Skeleton {
            position: points.iter().copied().chain([tip]).collect(),
            parent,
            radius_m: vec![0.01; count],
            order: axis.iter().map(|&a| a as u8).collect(),
            axis,
            birth: vec![0; count],
            dead: Vec::new(),
        }
    }

    fn on_circle(steps: usize) -> Vec<Vec3> {
        let at = |k: usize| (std::f32::consts::PI * k as f32 / steps as f32).sin_cos();
        (0..=steps).map(at).map(|(s, c)| Vec3::new(1.0 - c, 0.0, s)).collect()
    }

    #[test]
    fn nodes_stay_and_those_added_lie_on_the_curve() {
        for steps in [6, 8, 12] {
            let before = branched(&on_circle(steps));
            let after = bent(&before, |_| true);
            after.check().unwrap();
            let kept = before.position.iter().filter(|p| after.position.contains(p)).count();
            assert_eq!(kept, before.len());
            assert!(after.len() > before.len(), "{steps}");
            for (p, &axis) in after.position.iter().zip(&after.axis) {
                let off = p.distance(Vec3::X) - 1.0;
                // The curve's ends are straighter than the circle.
                let is_inner = (0.8..=1.2).contains(&p.x) || before.position.contains(p);
                assert!(axis != 0 || !is_inner || off.abs() < 0.02, "{steps}: {p} is {off} m off");
                assert!((-1e-6..=1.0).contains(&p.z), "{p}");
            }
            assert_eq!(bent(&before, |_| false), before);
        }
    }

    #[test]
    fn straight_wood_and_that_of_fine_steps_stays_as_it_is() {
        let straight: Vec<Vec3> = (0..6).map(|k| Vec3::new(0.1, 0.2, 1.0) * k as f32).collect();
        for points in [straight, on_circle(60)] {
            let tree = branched(&points);
            assert_eq!(bent(&tree, |_| true), tree);
        }
    }
}
