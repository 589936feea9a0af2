//! How each vertex moves in the wind, as vertex colours in the channels that engines read.
//!
//! A vertex moves with the whole tree (more the higher it is), with the branch of the stem it
//! hangs on (more the farther out), and, on leaves, by itself (more towards the tip). Branches and
//! leaves swing out of step by a phase of their own. Weights are quadratic in distance, as a rod
//! held at one end bends under an even load near its foot. Channels, 0…255 for 0…1:
//!
//! | profile | R | G | B | A |
//! |---|---|---|---|---|
//! | `unity` (Tree Creator's `AnimateVertex`) | branch phase | leaf flutter | whole tree | branch |
//! | `cryengine` (Sousa 2007, GPU Gems 3, ch. 16) | leaf flutter | leaf or branch phase | branch | 255, no occlusion |
//! | `speedtree-like` | whole tree | branch | leaf flutter | branch or leaf phase |
//!
//! Wood does not flutter. Known limit: branches of the second order and on swing with the branch
//! of the first that bears them.

use glam::Vec3;

use crate::seed::Seed;
use crate::skeleton::Skeleton;

/// Whose channels are written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum WindProfile {
    Unity,
    CryEngine,
    SpeedTreeLike,
}

/// How one vertex moves; all 0…1.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Motion {
    tree: f32,
    branch: f32,
    branch_phase: f32,
    flutter: f32,
    leaf_phase: f32,
}

/// How every node of a tree moves.
pub struct Wind {
    profile: WindProfile,
    seed: Seed,
    height_m: f32,
    /// Distance along the wood from the stem over the longest such, and phase; one a node.
    out: Vec<[f32; 2]>,
}

impl Wind {
    pub fn new(skeleton: &Skeleton, profile: WindProfile, seed: Seed) -> Wind {
        let seed = seed.derive("wind", 0);
        let mut branch = vec![[0.0f32; 2]; skeleton.len()];
        for i in 1..skeleton.len() {
            let parent = skeleton.parent[i] as usize;
            if skeleton.order[i] == 0 {
                continue;
            }
            let phase = match skeleton.order[parent] {
                0 => seed.derive("branch", u64::from(skeleton.axis[i])).draws().unit(),
                _ => branch[parent][1],
            };
            branch[i] = [branch[parent][0] + skeleton.internode_m(i as u32), phase];
        }
        let longest = branch.iter().map(|b| b[0]).fold(1e-6, f32::max);
        branch.iter_mut().for_each(|b| b[0] /= longest);
        Wind { profile, seed, height_m: skeleton.height_m().max(1e-6), out: branch }
    }

    /// A vertex of the tube along a line of nodes, from the one it springs from to its tip.
    pub fn wood(&self, at: Vec3, skeleton: &Skeleton, line: &[u32]) -> [u8; 4] {
        let place = |i: u32| skeleton.position[i as usize];
        let mut nearest = (f32::INFINITY, 0.0, [0.0; 2]);
        for w in line.windows(2) {
            let (a, b) = (place(w[0]), place(w[1]));
            let chord = b - a;
            let share = ((at - a).dot(chord) / chord.length_squared().max(1e-12)).clamp(0.0, 1.0);
            let distance_sq = at.distance_squared(a + chord * share);
            if distance_sq < nearest.0 {
                let [from, to] = [w[0], w[1]].map(|i| self.out[i as usize]);
                nearest = (distance_sq, from[0] + (to[0] - from[0]) * share, to);
            }
        }
        let (_, out, [_, phase]) = nearest;
        self.channels(&self.motion(at, [out, phase]))
    }

    /// A vertex of a leaf or twig that hangs on a node; `out`: its distance from there over the
    /// farthest of the same twig; `key`: of the twig.
    pub fn leaf(&self, at: Vec3, node: u32, out: f32, key: u64) -> [u8; 4] {
        let leaf_phase = self.seed.derive("leaf", key).draws().unit();
        let flutter = out.clamp(0.0, 1.0).powi(2);
        let here = self.out.get(node as usize).copied().unwrap_or_default();
        self.channels(&Motion { flutter, leaf_phase, ..self.motion(at, here) })
    }

    fn motion(&self, at: Vec3, [out, branch_phase]: [f32; 2]) -> Motion {
        let tree = (at.z / self.height_m).clamp(0.0, 1.0).powi(2);
        Motion { tree, branch: out * out, branch_phase, flutter: 0.0, leaf_phase: 0.0 }
    }

    fn channels(&self, m: &Motion) -> [u8; 4] {
        let is_leaf = m.flutter > 0.0;
        let phase = if is_leaf { (m.branch_phase + m.leaf_phase).fract() } else { m.branch_phase };
        let channels = match self.profile {
            WindProfile::Unity => [m.branch_phase, m.flutter, m.tree, m.branch],
            WindProfile::CryEngine => [m.flutter, phase, m.branch, 1.0],
            WindProfile::SpeedTreeLike => [m.tree, m.branch, m.flutter, phase],
        };
        channels.map(|c| (c * 255.0).round() as u8)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::skeleton::NO_PARENT;

    /// A stem of 10 m with branches of 2 and 4 m at half its height, the longer of two axes.
    fn tree() -> Skeleton {
        let p = |x: f32, z: f32| Vec3::new(x, 0.0, z);
        Skeleton {
            position: vec![
                Vec3::ZERO,
                p(0.0, 5.0),
                p(0.0, 10.0),
                p(2.0, 5.0),
                p(-2.0, 5.0),
                p(-4.0, 5.0),
            ],
            parent: vec![NO_PARENT, 0, 1, 1, 1, 4],
            radius_m: vec![0.2, 0.1, 0.01, 0.02, 0.03, 0.01],
            axis: vec![0, 0, 0, 1, 2, 3],
            order: vec![0, 0, 0, 1, 1, 2],
            birth: vec![0; 6],
            dead: Vec::new(),
        }
    }

    #[test]
    fn what_is_high_far_out_or_at_a_tip_moves_more() {
        let s = tree();
        s.check().unwrap();
        let wind = Wind::new(&s, WindProfile::Unity, Seed::new(1));
        let lines: [&[u32]; 4] = [&[0, 1, 2], &[1, 3], &[1, 4], &[4, 5]];
        let wood = |i: u32| {
            let line = lines.iter().find(|l| l.iter().skip(1).any(|&k| k == i));
            wind.wood(s.position[i as usize], &s, line.unwrap_or(&lines[0]))
        };
        assert_eq!(wood(0), [0, 0, 0, 0], "the foot stands still");
        assert_eq!(wood(2), [0, 0, 255, 0], "the top sways, and is no branch");
        assert_eq!((wood(3)[2], wood(3)[3]), (64, 64), "half as far: a quarter");
        assert_eq!(wood(5)[3], 255);
        let half = wind.wood(Vec3::new(-3.0, 0.1, 5.0), &s, lines[3]);
        assert_eq!(half[3], (0.75f32 * 0.75 * 255.0).round() as u8, "between nodes, in between");
        assert_eq!(wood(5)[0], wood(4)[0], "a twig swings with its branch");
        assert_ne!(wood(3)[0], wood(4)[0], "and branches out of step");
        let leaf = |out: f32| wind.leaf(s.position[5], 5, out, 7);
        assert_eq!((leaf(0.0)[1], leaf(0.5)[1], leaf(1.0)[1]), (0, 64, 255));
    }

    #[test]
    fn profiles_hold_the_same_motion_in_their_own_channels() {
        let s = tree();
        let of = |profile| Wind::new(&s, profile, Seed::new(1)).leaf(s.position[5], 5, 1.0, 7);
        let [unity, cry, speed] =
            [WindProfile::Unity, WindProfile::CryEngine, WindProfile::SpeedTreeLike].map(of);
        assert_eq!([unity[1], unity[2], unity[3]], [cry[0], speed[0], cry[2]]);
        assert_eq!([speed[1], speed[2], speed[3]], [unity[3], unity[1], cry[1]]);
        assert_eq!(cry[3], 255);
    }
}
