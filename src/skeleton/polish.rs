//! From grown nodes to axes an eye accepts: which child continues an axis, kinks smoothed, outer
//! twigs hanging.

use glam::Vec3;

use super::limb::lifted;
use super::{Children, NO_PARENT};
use crate::seed::Seed;

/// No axis of the scaffold: a colonized node.
pub const FREE: u32 = u32::MAX;

/// A child continues its parent's axis only if it turns less than this (cosine).
const LEAST_STRAIGHT: f32 = 0.55;

/// Axis and order of each node. `scaffold` holds the scaffold's own axis of a node, or [`FREE`]:
/// along these an axis stays what it is. Elsewhere the child that is straightest and carries most
/// goes on.
pub fn axes(position: &[Vec3], parent: &[u32], scaffold: &[u32]) -> (Vec<u32>, Vec<u8>) {
    let n = position.len();
    let children = Children::new(parent);
    let mut carried = vec![1u32; n];
    for i in (1..n).rev() {
        carried[parent[i] as usize] += carried[i];
    }
    let (mut axis, mut order) = (vec![0u32; n], vec![0u8; n]);
    let mut next_axis = 1u32;
    for i in 0..n {
        let list = children.of(i as u32);
        let own = list
            .iter()
            .copied()
            .find(|&c| scaffold[i] != FREE && scaffold[c as usize] == scaffold[i]);
        let ahead = match parent[i] {
            NO_PARENT => Vec3::Z,
            p => (position[i] - position[p as usize]).normalize_or(Vec3::Z),
        };
        let heir = own.or_else(|| {
            let mut best: Option<(f32, u32)> = None;
            for &c in list {
                let straight =
                    ahead.dot((position[c as usize] - position[i]).normalize_or(Vec3::Z));
                let score = straight * (carried[c as usize] as f32).powf(0.3);
                let is_free = scaffold[c as usize] == FREE || scaffold[i] == FREE;
                if straight > LEAST_STRAIGHT && is_free && best.is_none_or(|(s, _)| score > s) {
                    best = Some((score, c));
                }
            }
            best.map(|(_, c)| c)
        });
        for &c in list {
            if Some(c) == heir {
                axis[c as usize] = axis[i];
                order[c as usize] = order[i];
            } else {
                axis[c as usize] = next_axis;
                order[c as usize] = order[i].saturating_add(1);
                next_axis += 1;
            }
        }
    }
    (axis, order)
}

/// Draws each free node towards the middle of its neighbours along the axis; `passes` times. Ends
/// and scaffold nodes stay.
pub fn smooth(position: &mut [Vec3], parent: &[u32], axis: &[u32], scaffold: &[u32], passes: u32) {
    let n = position.len();
    let mut heir = vec![NO_PARENT; n];
    for i in 1..n {
        let p = parent[i] as usize;
        if axis[i] == axis[p] {
            heir[p] = i as u32;
        }
    }
    for _ in 0..passes {
        let before = position.to_vec();
        for i in 1..n {
            if scaffold[i] == FREE && heir[i] != NO_PARENT {
                let middle = 0.5 * (before[parent[i] as usize] + before[heir[i] as usize]);
                let there = before[i].lerp(middle, 0.5);
                if there != position[parent[i] as usize] {
                    position[i] = there;
                }
            }
        }
    }
}

/// Lets shoots of order `from` and above turn towards the ground, by `hang` degrees a metre from
/// where they leave their parent, each axis by a share of its own; no lower than `clearance_m`.
/// Shoots of one node that come to hang side by side stay [`APART`].
pub fn hang(
    position: &mut [Vec3],
    parent: &[u32],
    (axis, order): (&[u32], &[u8]),
    from: u8,
    hang: f32,
    clearance_m: f32,
) {
    if hang == 0.0 {
        return;
    }
    let before = position.to_vec();
    let mut drop_deg = vec![0.0f32; position.len()];
    // The child of each node placed last, and that placed before each.
    let mut last = vec![NO_PARENT; position.len()];
    let mut earlier = vec![NO_PARENT; position.len()];
    for i in 1..position.len() {
        let p = parent[i] as usize;
        let edge = before[i] - before[p];
        let length = edge.length();
        if order[i] >= from {
            let share = 0.45 + 0.85 * Seed::new(u64::from(axis[i])).draws().unit();
            drop_deg[i] = drop_deg[p] + hang * length * share;
        }
        let mut turned =
            lifted(edge / length.max(1e-9), -drop_deg[i].to_radians().min(3.0)) * length;
        if order[i] >= from {
            let node = |j: u32| (j != NO_PARENT).then_some(j as usize);
            let siblings = || {
                std::iter::successors(node(last[p]), |&j| node(earlier[j]))
                    .map(|j| [before[j] - before[p], position[j] - position[p]])
            };
            turned = apart(edge, turned, siblings);
        }
        (earlier[i], last[p]) = (last[p], i as u32);
        let mut there = position[p] + turned;
        if there.z < clearance_m && there.z < before[i].z {
            there.z = clearance_m.min(before[i].z).max(there.z);
            if there.distance_squared(position[p]) < 0.04 * length * length {
                let out = Vec3::new(edge.x, edge.y, 0.0).normalize_or(Vec3::X);
                there += out * 0.5 * length;
            }
        }
        position[i] = there;
    }
}

/// Least distance of a shoot that hangs from those of the same node, share of its length.
const APART: f32 = 0.1;
/// How often it is moved away from all that it is near: away from one may be near another.
const ROUNDS: usize = 8;

/// A shoot that has turned from `edge` to `turned`, as long, and at least [`APART`] from its siblings,
/// each given as it was and as it is now; to the side on which it was of them.
fn apart<I: Iterator<Item = [Vec3; 2]>>(
    edge: Vec3,
    mut turned: Vec3,
    siblings: impl Fn() -> I,
) -> Vec3 {
    let length = edge.length();
    for _ in 0..ROUNDS {
        let mut is_apart = true;
        for [was, is] in siblings() {
            if turned.distance(is) >= APART * length {
                continue;
            }
            let way = edge - was;
            let aside = way - way.project_onto(is);
            let aside = aside
                .try_normalize()
                .unwrap_or_else(|| is.any_orthogonal_vector().normalize_or_zero());
            turned = (turned + aside * (2.0 * APART * length)).normalize_or_zero() * length;
            is_apart = false;
        }
        if is_apart {
            break;
        }
    }
    turned
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A stem with a fork: the straight child goes on, the other starts an axis.
    #[test]
    fn the_straight_child_continues_the_axis() {
        let position =
            vec![Vec3::ZERO, Vec3::Z, Vec3::new(0.9, 0.0, 1.3), Vec3::new(0.1, 0.0, 2.0)];
        let parent = vec![NO_PARENT, 0, 1, 1];
        let (axis, order) = axes(&position, &parent, &[FREE; 4]);
        assert_eq!(axis, [0, 0, 1, 0]);
        assert_eq!(order, [0, 0, 1, 0]);
        // A scaffold axis goes on whatever its angle.
        let (axis, _) = axes(&position, &parent, &[0, 0, 0, FREE]);
        assert_eq!(axis, [0, 0, 0, 1]);
    }

    #[test]
    fn hanging_keeps_lengths_and_turns_down_alone() {
        let mut position: Vec<Vec3> = (0..5).map(|i| Vec3::new(i as f32, 0.0, 10.0)).collect();
        let before = position.clone();
        let parent = vec![NO_PARENT, 0, 1, 2, 3];
        hang(&mut position, &parent, (&[0, 0, 1, 1, 1], &[0, 0, 2, 2, 2]), 2, 20.0, 0.1);
        assert_eq!(position[..2], before[..2]);
        for i in 2..5 {
            assert!((position[i].distance(position[i - 1]) - 1.0).abs() < 1e-5);
            assert!(position[i].z < position[i - 1].z);
        }
    }

    #[test]
    fn shoots_that_hang_from_one_node_stay_apart() {
        // Five leave a branch to one side, a little turned, and sink as far as they can.
        let side = |k: usize| Vec3::new(1.0, 0.15 * k as f32 - 0.3, 0.1).normalize();
        let node = Vec3::new(0.0, -1.0, 10.0);
        let mut position = vec![Vec3::Z * 10.0, node];
        position.extend((0..5).map(|k| node + side(k)));
        let parent = vec![NO_PARENT, 0, 1, 1, 1, 1, 1];
        let order = [0, 0, 2, 2, 2, 2, 2];
        hang(&mut position, &parent, (&[0, 0, 1, 2, 3, 4, 5], &order), 2, 400.0, 0.1);
        for i in 2..7 {
            assert!((position[i].distance(node) - 1.0).abs() < 1e-5);
            assert!(position[i].z < 9.5, "{}", position[i]);
            for j in 2..i {
                let apart = position[i].distance(position[j]);
                assert!(apart > 0.07, "{i} and {j}: {apart}");
            }
        }
    }

    #[test]
    fn what_does_not_hang_is_not_moved_aside() {
        // Two shoots of the first order within a hundredth of their length.
        let mut position = vec![Vec3::Z, Vec3::new(1.0, 0.0, 1.0), Vec3::new(1.0, 0.01, 1.0)];
        let before = position.clone();
        hang(&mut position, &[NO_PARENT, 0, 0], (&[0, 1, 2], &[0, 1, 1]), 2, 20.0, 0.1);
        assert_eq!(position, before);
    }
}
