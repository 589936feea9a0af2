//! Wood bends, it has no corners: nodes added to the internodes of a grown tree, on the curve that
//! goes through all its nodes (cubic Hermite, tangents by the neighbours' distances as in
//! Catmull and Rom's splines). Limit: what is left lies within [`OFF_M`] of that curve, or within a
//! quarter of it where an internode would take more than [`MOST`] nodes.

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
                // No higher than the tree, no lower than its clearance.
                at.z = at.z.clamp(from.z.min(to.z), from.z.max(to.z));
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
