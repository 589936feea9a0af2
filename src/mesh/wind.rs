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
//! Wood does not flutter. The corners of a ring share the distance of its middle; a branch's first
//! ring has the colours of the hole it comes out of, so that no seam opens. Known limit: branches of the second order and on swing with the branch
//! of the first that bears them.

use glam::Vec3;

use super::Surface;
use crate::seed::Seed;
use crate::skeleton::Skeleton;
use crate::work::{self, Work};

/// Whose channels are written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum WindProfile {
    Unity,
    CryEngine,
    SpeedTreeLike,
}

impl WindProfile {
    /// Where the weight of the whole tree is written.
    fn tree_channel(self) -> Option<usize> {
        match self {
            WindProfile::Unity => Some(2),
            WindProfile::CryEngine => None,
            WindProfile::SpeedTreeLike => Some(0),
        }
    }

    /// Colours a surface that moves with the whole tree, so high, and by itself not at all.
    pub fn whole_tree(self, height_m: f32, surface: &mut Surface) {
        let still = match self {
            WindProfile::CryEngine => [0, 0, 0, 255],
            _ => [0; 4],
        };
        surface.wind = vec![still; surface.position.len()];
        self.over(height_m, surface);
    }

    /// Says anew how much each vertex moves with the whole tree, now that it is known to be so high.
    pub fn over(self, height_m: f32, surface: &mut Surface) {
        let Some(k) = self.tree_channel() else { return };
        let per_m = height_m.max(1e-6).recip();
        let (bit, kept) = (8 * k, !(255 << (8 * k)));
        for (p, colour) in surface.position.iter().zip(&mut surface.wind) {
            let part = u32::from(byte((p.z * per_m).clamp(0.0, 1.0).powi(2)));
            *colour = (u32::from_le_bytes(*colour) & kept | part << bit).to_le_bytes();
        }
    }

    /// Where that of a leaf's own motion is.
    fn flutter_channel(self) -> usize {
        match self {
            WindProfile::Unity => 1,
            WindProfile::CryEngine => 0,
            WindProfile::SpeedTreeLike => 2,
        }
    }
}

/// How a place on the wood swings with its branch.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Sway {
    /// Distance from the stem over the longest such.
    out: f32,
    phase: f32,
}

impl Sway {
    /// Between two rings.
    pub fn between(self, other: Sway, t: f32) -> Sway {
        Sway { out: self.out + (other.out - self.out) * t, phase: other.phase }
    }
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
    per_m: f32,
    /// Distance along the wood from the stem over the longest such, and phase; one a node.
    out: Vec<[f32; 2]>,
}

impl Wind {
    /// `height_m`: of the whole tree, of which the skeleton may be a part.
    pub fn new(skeleton: &Skeleton, height_m: f32, profile: WindProfile, seed: Seed) -> Wind {
        work::count(Work::WindNodes, skeleton.len());
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
        Wind { profile, seed, per_m: height_m.max(1e-6).recip(), out: branch }
    }

    /// How the rings of a tube move, appended to `out`: at each of `at_m`, arc lengths along a line
    /// of nodes, themselves at `line_m`; both in ascending order.
    pub fn along(
        &self,
        line: &[u32],
        line_m: &[f32],
        at_m: impl Iterator<Item = f32>,
        out: &mut Vec<Sway>,
    ) {
        let of = |i: usize| self.out.get(line[i] as usize).copied().unwrap_or_default();
        let Some(last) = line.len().min(line_m.len()).checked_sub(1) else {
            return out.extend(at_m.map(|_| Sway::default()));
        };
        let mut to = last.min(1);
        let ([from, _], [next, _], [tip, phase]) = (of(0), of(to), of(last));
        if from > 0.0 || next > 0.0 {
            // All of it is branch: as far out as it is long.
            let per_m = (tip - from) / line_m[last].max(1e-9);
            out.extend(at_m.map(|at| {
                let at = at.clamp(0.0, line_m[last]);
                Sway { out: from + per_m * at, phase }
            }));
            return;
        }
        out.extend(at_m.map(|at| {
            while to < last && line_m[to] < at {
                to += 1;
            }
            let before = to.saturating_sub(1);
            let run = (line_m[to] - line_m[before]).max(1e-9);
            let share = ((at - line_m[before]) / run).clamp(0.0, 1.0);
            let ([from, _], [out, phase]) = (of(before), of(to));
            Sway { out: from + (out - from) * share, phase }
        }));
    }

    /// Colours the vertices of a surface that have none yet: they move as a ring does, but for the
    /// whole tree's part.
    pub fn ring(&self, sway: Sway, surface: &mut Surface) {
        surface.wind.resize(surface.position.len(), self.wood(sway));
    }

    /// The same, each by a sway of its own.
    pub fn each(&self, sways: impl Iterator<Item = Sway>, surface: &mut Surface) {
        let new = surface.position.len() - surface.wind.len();
        surface.wind.extend(sways.take(new).map(|sway| self.wood(sway)));
        debug_assert_eq!(surface.wind.len(), surface.position.len());
    }

    /// Adds the whole tree's part to the vertices of wood that move as rings do, which have none.
    pub fn rise(&self, surface: &mut Surface) {
        self.profile.over(self.per_m.recip(), surface);
    }

    /// Colours a surface that moves with the whole tree, and by itself not at all.
    pub fn whole_tree(&self, surface: &mut Surface) {
        self.profile.whole_tree(self.per_m.recip(), surface);
    }

    /// The colours of a leaf's or twig's vertices, which hangs from `foot` on a node; `key`: its own.
    /// It flutters with the distance from there over that of its farthest vertex.
    pub fn twig(&self, twig: &[Vec3], foot: Vec3, node: u32, key: u64, out: &mut [[u8; 4]]) {
        let leaf_phase = self.seed.derive("leaf", key).draws().unit();
        let here = self.out.get(node as usize).copied().unwrap_or_default();
        let per_sq_m = farthest_sq(twig, foot).recip();
        // What all vertices share is found once.
        let still = self.channels(&Motion { leaf_phase, flutter: 1.0, ..self.motion(0.0, here) });
        let flutter_bit = 8 * self.profile.flutter_channel();
        let still = u32::from_le_bytes(still) & !(255 << flutter_bit);
        // Profiles without the whole tree's part keep nothing of it.
        let (tree_bit, kept) = self.profile.tree_channel().map_or((0, 0), |k| (8 * k, 255));
        for (p, colour) in twig.iter().zip(out) {
            let flutter = byte((p.distance_squared(foot) * per_sq_m).min(1.0));
            let tree = byte(self.tree(p.z)) & kept;
            let parts = u32::from(flutter) << flutter_bit | u32::from(tree) << tree_bit;
            *colour = (still | parts).to_le_bytes();
        }
    }

    /// Colours stalks, of whose vertices each is at a node, that where they begin or that of their twig: they hold
    /// both together, and do not flutter.
    pub fn stalks(&self, nodes: impl Iterator<Item = u32>, surface: &mut Surface) {
        let here = nodes.map(|node| self.out.get(node as usize).copied().unwrap_or_default());
        let colours = surface.position.iter().zip(here);
        surface.wind = colours.map(|(p, here)| self.channels(&self.motion(p.z, here))).collect();
    }

    /// How much the whole tree moves at a height.
    fn tree(&self, z: f32) -> f32 {
        let share = (z * self.per_m).clamp(0.0, 1.0);
        share * share
    }

    /// The colour of wood where the whole tree stands still.
    fn wood(&self, sway: Sway) -> [u8; 4] {
        let (branch, phase) = (byte(sway.out * sway.out), byte(sway.phase));
        match self.profile {
            WindProfile::Unity => [phase, 0, 0, branch],
            WindProfile::CryEngine => [0, phase, branch, 255],
            WindProfile::SpeedTreeLike => [0, branch, 0, phase],
        }
    }

    fn motion(&self, z: f32, [out, branch_phase]: [f32; 2]) -> Motion {
        let tree = self.tree(z);
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
        channels.map(byte)
    }
}

/// Square of the distance of the farthest of some places.
fn farthest_sq(places: &[Vec3], from: Vec3) -> f32 {
    // Eight at a time, that none waits for the one before.
    let mut most = [1e-12f32; 8];
    let (eights, rest) = places.as_chunks::<8>();
    for eight in eights.iter().map(|e| &e[..]).chain([rest]) {
        for (most, place) in most.iter_mut().zip(eight) {
            let far = place.distance_squared(from);
            *most = if far > *most { far } else { *most };
        }
    }
    most.into_iter().fold(0.0, f32::max)
}

/// 0…1 as 0…255, rounded: adding 2²³ leaves whole numbers in the last bits.
fn byte(share: f32) -> u8 {
    (share * 255.0 + (1 << 23) as f32).to_bits() as u8
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
        let wind = Wind::new(&s, s.height_m(), WindProfile::Unity, Seed::new(1));
        let lines: [&[u32]; 4] = [&[0, 1, 2], &[1, 3], &[1, 4], &[4, 5]];
        let place = |i: u32| s.position[i as usize];
        // At a share of the way from the first node to the last.
        let at = |line: &[u32], share: f32| {
            let (from, to) = (place(line[0]), place(line[line.len() - 1]));
            let line_m: Vec<f32> = line.iter().map(|&i| place(i).distance(from)).collect();
            let at_m = share * from.distance(to);
            let mut sway = Vec::new();
            wind.along(line, &line_m, std::iter::once(at_m), &mut sway);
            let mut surface =
                Surface { position: vec![from.lerp(to, share)], ..Surface::default() };
            wind.ring(sway[0], &mut surface);
            wind.rise(&mut surface);
            surface.wind[0]
        };
        let wood = |i: u32| match i {
            0 => at(lines[0], 0.0),
            i => lines.iter().find(|l| l.last() == Some(&i)).map(|l| at(l, 1.0)).unwrap(),
        };
        assert_eq!(wood(0), [0, 0, 0, 0], "the foot stands still");
        assert_eq!(wood(2), [0, 0, 255, 0], "the top sways, and is no branch");
        assert_eq!((wood(3)[2], wood(3)[3]), (64, 64), "half as far: a quarter");
        assert_eq!(wood(5)[3], 255);
        assert_eq!(
            at(lines[3], 0.5)[3],
            (0.75f32 * 0.75 * 255.0).round() as u8,
            "between nodes, in between"
        );
        assert_eq!(wood(5)[0], wood(4)[0], "a twig swings with its branch");
        assert_ne!(wood(3)[0], wood(4)[0], "and branches out of step");
        let twig = [0.0, 0.5, 1.0].map(|x| s.position[5] + Vec3::X * x);
        let mut leaf = [[0; 4]; 3];
        wind.twig(&twig, s.position[5], 5, 7, &mut leaf);
        assert_eq!(leaf.map(|c| c[1]), [0, 64, 255]);
    }

    #[test]
    fn profiles_hold_the_same_motion_in_their_own_channels() {
        let s = tree();
        let of = |profile| {
            let mut leaf = [[0; 4]];
            let foot = s.position[5] + Vec3::X;
            Wind::new(&s, s.height_m(), profile, Seed::new(1)).twig(
                &[s.position[5]],
                foot,
                5,
                7,
                &mut leaf,
            );
            leaf[0]
        };
        let [unity, cry, speed] =
            [WindProfile::Unity, WindProfile::CryEngine, WindProfile::SpeedTreeLike].map(of);
        assert_eq!([unity[1], unity[2], unity[3]], [cry[0], speed[0], cry[2]]);
        assert_eq!([speed[1], speed[2], speed[3]], [unity[3], unity[1], cry[1]]);
        assert_eq!(cry[3], 255);
    }
}
