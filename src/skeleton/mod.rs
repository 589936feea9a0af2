//! Species, and a crown if there is one, to a skeleton: L-system, turtle, space colonization,
//! radii. Knows nothing of meshes.

mod bend;
pub mod cloud;
pub mod colonize;
pub mod decline;
pub mod derive;
pub mod envelope;
pub mod grow;
mod limb;
mod polish;
pub mod radii;
mod scaffold;
pub mod stability;
pub mod stage;
pub mod surroundings;
pub mod turtle;

use glam::Vec3;

use crate::diagnostic::{Error, Result};

pub use grow::{Detail, Target, grow, grow_among};
pub use stage::{STAGES, at_stage};

/// No parent: only the root has this.
pub const NO_PARENT: u32 = u32::MAX;

/// A tree of nodes as flat columns; a node and its parent span one internode. Tree-local metres:
/// the root collar is the origin, Z up.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Skeleton {
    pub position: Vec<Vec3>,
    /// Parents come before children; node 0 is the only root.
    pub parent: Vec<u32>,
    /// Radius of the wood at the node; never greater than at the parent.
    pub radius_m: Vec<f32>,
    /// The axis the node continues; 0 is the stem. A node whose parent has another axis starts one.
    pub axis: Vec<u32>,
    /// Branching order of the node's axis: 0 the stem, 1 its branches, …
    pub order: Vec<u8>,
    /// Stage of growth in which the node came, 0 for the root, up to [`STAGES`].
    pub birth: Vec<u16>,
    /// Whether the node is dead wood, as then is all that springs from it; empty where all live.
    pub dead: Vec<bool>,
}

/// Numbers from 0 on in groups: one flat list, in their order.
#[derive(Debug, Clone)]
struct Groups {
    start: Vec<u32>,
    list: Vec<u32>,
}

impl Groups {
    /// `group` of each; those of `count` or more are in none.
    fn new(group: &[u32], count: usize) -> Groups {
        let mut start = vec![0u32; count + 1];
        for &g in group.iter().filter(|&&g| (g as usize) < count) {
            start[g as usize + 1] += 1;
        }
        for i in 1..start.len() {
            start[i] += start[i - 1];
        }
        let mut next = start.clone();
        let mut list = vec![0u32; start[count] as usize];
        for (i, &g) in (0..).zip(group).filter(|(_, g)| (**g as usize) < count) {
            let slot = &mut next[g as usize];
            list[*slot as usize] = i;
            *slot += 1;
        }
        Groups { start, list }
    }

    fn of(&self, group: u32) -> &[u32] {
        let i = group as usize;
        match (self.start.get(i), self.start.get(i + 1)) {
            (Some(&a), Some(&b)) => &self.list[a as usize..b as usize],
            _ => &[],
        }
    }
}

/// The children of every node, in the order of their ids.
#[derive(Debug, Clone)]
pub struct Children(Groups);

impl Children {
    /// `parent` may hold [`NO_PARENT`]; ids out of range are left out.
    pub fn new(parent: &[u32]) -> Self {
        Children(Groups::new(parent, parent.len()))
    }

    pub fn of(&self, node: u32) -> &[u32] {
        self.0.of(node)
    }
}

/// One axis: a chain of nodes from base to tip.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Axis<'a> {
    /// The node of the parent axis it springs from; `None` for the stem.
    pub base: Option<u32>,
    /// Its own nodes, from base to tip; of a sound skeleton never empty.
    pub nodes: &'a [u32],
    /// Branching order.
    pub order: u8,
}

/// The axes of a skeleton.
#[derive(Debug, Clone)]
pub struct Axes<'a> {
    skeleton: &'a Skeleton,
    nodes: Groups,
    count: u32,
}

impl Axes<'_> {
    pub fn of(&self, axis: u32) -> Axis<'_> {
        let nodes = self.nodes.of(axis);
        let first = nodes.first().copied();
        Axis {
            base: first.and_then(|i| self.skeleton.parent_of(i)),
            nodes,
            order: first.map_or(0, |i| self.skeleton.order[i as usize]),
        }
    }

    /// In the order of their ids.
    pub fn iter(&self) -> impl ExactSizeIterator<Item = Axis<'_>> + Clone {
        (0..self.count).map(|k| self.of(k))
    }
}

impl Skeleton {
    pub fn len(&self) -> usize {
        self.position.len()
    }

    pub fn is_empty(&self) -> bool {
        self.position.is_empty()
    }

    /// The parent of a node; `None` for the root.
    pub fn parent_of(&self, node: u32) -> Option<u32> {
        self.parent.get(node as usize).copied().filter(|&p| p != NO_PARENT)
    }

    pub fn children(&self) -> Children {
        Children::new(&self.parent)
    }

    pub fn axes(&self) -> Axes<'_> {
        let count = self.axis.iter().max().map_or(0, |&most| most + 1);
        Axes { skeleton: self, nodes: Groups::new(&self.axis, count as usize), count }
    }

    /// How many stems spring from the root. Of a stool several do, whose root carries them all and is as
    /// thick as none.
    pub fn stems(&self) -> usize {
        self.parent.iter().filter(|&&p| p == 0).count()
    }

    pub fn is_stool(&self) -> bool {
        self.stems() > 1
    }

    /// Where an axis leaves `parent` that goes on with `node`: a stem of a stool beside the others.
    pub fn springs_at(&self, node: u32, parent: u32) -> Vec3 {
        let at = self.position[parent as usize];
        let stands = parent == 0 && self.is_stool();
        if stands { self.position[node as usize].with_z(at.z) } else { at }
    }

    /// Length of the internode that ends at `node`, metres; 0 for the root.
    pub fn internode_m(&self, node: u32) -> f32 {
        self.parent_of(node)
            .map_or(0.0, |p| self.position[node as usize].distance(self.position[p as usize]))
    }

    /// Length of all wood, metres.
    pub fn length_m(&self) -> f32 {
        (0..self.len() as u32).map(|i| f64::from(self.internode_m(i))).sum::<f64>() as f32
    }

    /// Highest node above the root collar, metres.
    pub fn height_m(&self) -> f32 {
        self.position.iter().map(|p| p.z).fold(0.0, f32::max)
    }

    /// Height of the lowest place at which a branch leaves a stem, metres; 0 without branches.
    pub fn crown_base_m(&self) -> f32 {
        let is_stem = self.is_stem();
        let bases = (1..self.len()).filter(|&i| !is_stem[i]).map(|i| self.parent[i] as usize);
        bases.filter(|&p| is_stem[p]).map(|p| self.position[p].z).reduce(f32::min).unwrap_or(0.0)
    }

    /// Mean calliper width of the nodes seen from above over 16 directions, metres.
    pub fn width_m(&self) -> f32 {
        const DIRECTIONS: usize = 16;
        let mut sum = 0.0;
        for k in 0..DIRECTIONS {
            let (s, c) = (std::f32::consts::PI * k as f32 / DIRECTIONS as f32).sin_cos();
            let (mut lo, mut hi) = (0.0f32, 0.0f32);
            for p in &self.position {
                let d = p.x * c + p.y * s;
                lo = lo.min(d);
                hi = hi.max(d);
            }
            sum += hi - lo;
        }
        sum / DIRECTIONS as f32
    }

    /// Length of all that is no stem.
    pub fn branch_m(&self) -> f32 {
        let is_stem = self.is_stem();
        (1..self.len()).filter(|&i| !is_stem[i]).map(|i| self.internode_m(i as u32)).sum()
    }

    /// Whether the internode that ends at each node bears leaves: it is alive, and thinner than
    /// `bearing_radius_m` or the last of its axis.
    pub fn bears_leaves(&self, bearing_radius_m: f32) -> Vec<bool> {
        self.bears_twigs(bearing_radius_m, false)
    }

    /// The same of twigs on the branches that live or on those that are dead.
    pub fn bears_twigs(&self, bearing_radius_m: f32, of_dead: bool) -> Vec<bool> {
        let mut is_tip = vec![true; self.len()];
        for &p in &self.parent {
            if let Some(tip) = is_tip.get_mut(p as usize) {
                *tip = false;
            }
        }
        (0..self.len())
            .map(|i| i != 0 && (is_tip[i] || self.radius_m[i] <= bearing_radius_m))
            .zip(self.dead.iter().copied().chain(std::iter::repeat(false)))
            .map(|(bears, is_dead)| bears && is_dead == of_dead)
            .collect()
    }

    /// Every invariant of the columns: equal lengths; one root, at the origin, on axis 0; parents
    /// first; all finite; no internode of length 0; radii positive and not growing outward; each
    /// axis one unbranched chain, its order one more than that of the axis it springs from; no node
    /// older than its parent.
    pub fn check(&self) -> Result<()> {
        let n = self.len();
        let fail = |what: String| Err(Error::new(format!("skeleton: {what}")));
        if n == 0 {
            return fail("no nodes".into());
        }
        let lengths = [
            self.parent.len(),
            self.radius_m.len(),
            self.axis.len(),
            self.order.len(),
            self.birth.len(),
        ];
        if lengths.iter().any(|&l| l != n) {
            return fail(format!("columns of unequal length: {n} positions, others {lengths:?}"));
        }
        if !self.dead.is_empty() && self.dead.len() != n {
            return fail(format!("{} nodes known dead or alive, of {n}", self.dead.len()));
        }
        if self.parent[0] != NO_PARENT || self.axis[0] != 0 || self.order[0] != 0 {
            return fail("node 0 is not the root of axis 0".into());
        }
        if self.position[0] != Vec3::ZERO {
            return fail(format!("the root is at {}, not at the origin", self.position[0]));
        }
        // The last node seen of each axis.
        let mut tip: Vec<Option<usize>> = vec![None; n];
        tip[0] = Some(0);
        for i in 0..n {
            if !self.position[i].is_finite() {
                return fail(format!("node {i} is at {}", self.position[i]));
            }
            let r = self.radius_m[i];
            if !(r.is_finite() && r > 0.0) {
                return fail(format!("node {i} has radius {r}"));
            }
            if i == 0 {
                continue;
            }
            let p = self.parent[i] as usize;
            if p >= i {
                return fail(format!("node {i} comes before its parent {p}"));
            }
            if self.birth[i] < self.birth[p] || self.birth[i] > STAGES {
                return fail(format!(
                    "node {i} grew in stage {}, its parent {p} in {}",
                    self.birth[i], self.birth[p]
                ));
            }
            if self.dead.get(p) == Some(&true) && self.dead.get(i) == Some(&false) {
                return fail(format!("node {i} lives on dead wood"));
            }
            if self.position[i] == self.position[p] {
                return fail(format!("node {i} lies on its parent {p}"));
            }
            if r > self.radius_m[p] {
                return fail(format!(
                    "node {i} (radius {r}) is thicker than its parent {p} ({})",
                    self.radius_m[p]
                ));
            }
            let Some(last) = tip.get_mut(self.axis[i] as usize) else {
                return fail(format!("node {i} is on axis {} of {n} nodes", self.axis[i]));
            };
            match last.replace(i) {
                Some(before) if before != p => {
                    return fail(format!("axis {} forks at node {p}", self.axis[i]));
                }
                Some(before) if self.order[i] != self.order[before] => {
                    return fail(format!("node {i} changes order along its axis"));
                }
                None if self.order[i] != self.order[p].saturating_add(1) => {
                    return fail(format!(
                        "node {i} starts an axis of order {} on one of order {}",
                        self.order[i], self.order[p]
                    ));
                }
                _ => {}
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fork() -> Skeleton {
        Skeleton {
            position: vec![Vec3::ZERO, Vec3::Z, Vec3::new(0.0, 0.0, 2.0), Vec3::new(1.0, 0.0, 1.0)],
            parent: vec![NO_PARENT, 0, 1, 1],
            radius_m: vec![0.3, 0.2, 0.1, 0.1],
            axis: vec![0, 0, 0, 1],
            order: vec![0, 0, 0, 1],
            birth: vec![0, 1, 2, 2],
            dead: Vec::new(),
        }
    }

    #[test]
    fn a_fork_has_two_axes_and_three_metres_of_wood() {
        let s = fork();
        s.check().unwrap();
        assert_eq!(s.children().of(1), &[2, 3]);
        assert_eq!(s.children().of(3), &[] as &[u32]);
        let axes = s.axes();
        assert_eq!(axes.of(0), Axis { base: None, nodes: &[0, 1, 2], order: 0 });
        assert_eq!(axes.of(1), Axis { base: Some(1), nodes: &[3], order: 1 });
        assert_eq!(axes.iter().count(), 2);
        assert_eq!(s.length_m(), 3.0);
        assert_eq!(s.height_m(), 2.0);
        assert_eq!(s.bears_leaves(0.15), vec![false, false, true, true]);
    }

    #[test]
    fn width_is_the_mean_calliper_of_the_plan() {
        let mut s = fork();
        s.position[3] = Vec3::new(1.0, 0.0, 1.0);
        // A segment of length 1 has mean calliper width 2/π.
        assert!((s.width_m() - std::f32::consts::FRAC_2_PI).abs() < 0.01);
    }

    /// Each defect must be seen, and named.
    #[test]
    fn every_broken_invariant_is_found() {
        type Breakage = fn(&mut Skeleton);
        let cases: [(&str, Breakage); 14] = [
            ("no nodes", |s| *s = Skeleton::default()),
            ("unequal length", |s| s.order.truncate(2)),
            ("not the root", |s| s.parent[0] = 1),
            ("not at the origin", |s| s.position[0] = Vec3::X),
            ("node 2 is at", |s| s.position[2].x = f32::NAN),
            ("has radius", |s| s.radius_m[1] = 0.0),
            ("before its parent", |s| s.parent[1] = 3),
            ("lies on its parent", |s| s.position[3] = Vec3::Z),
            ("thicker than its parent", |s| s.radius_m[3] = 0.25),
            ("axis 0 forks", |s| s.axis[3] = 0),
            ("grew in stage 0", |s| s.birth[3] = 0),
            ("grew in stage 99", |s| s.birth[3] = 99),
            ("2 nodes known dead or alive", |s| s.dead = vec![true; 2]),
            ("node 2 lives on dead wood", |s| s.dead = vec![false, true, false, true]),
        ];
        for (message, breakage) in cases {
            let mut s = fork();
            breakage(&mut s);
            let error = s.check().unwrap_err();
            assert!(error.message().contains(message), "{message}: {error}");
        }
    }
}
