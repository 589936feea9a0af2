//! Axes that run on from tip to base, as one tube: where an axis ends, the thickest that springs
//! from its tip goes on.

use std::ops::Range;

use super::path::{Knot, Least, Off, Sides, Stem, simplify};
use crate::skeleton::Skeleton;

/// By how much weights of branches as thick as each other differ, share of them.
const ALIKE: f32 = 0.06;
/// Most stems of a stool that are each as true as a trunk.
const FEW_STEMS: usize = 3;

/// The chains of a skeleton, each followed by those that spring from it.
pub struct Chains {
    /// Node and knot of every chain from base to tip, chain after chain; each begins with the node
    /// of another chain it springs from, where there is one.
    node: Vec<u32>,
    knot: Vec<Knot>,
    pub chain: Vec<Chain>,
    /// The branches of every chain, as (chain, place of its base in the columns), one after the
    /// other; and where those of each begin.
    branch: Vec<(u32, u32)>,
    first_branch: Vec<u32>,
}

pub struct Chain {
    line: Range<usize>,
    /// The node of another chain it springs from.
    pub base: Option<u32>,
    /// Its first own node, and the axis of that.
    pub first: u32,
    pub axis: u32,
    pub radius_m: f32,
    /// Its radius if the stem were as thick as at its foot where it, or what it springs from, leaves it:
    /// by this a budget chooses in a leafy crown seen from near, so that a thin top keeps its branches as the
    /// rest does. Elsewhere its radius.
    pub weight_m: f32,
    /// A stem of a stool, beside others on the ground.
    pub stands: bool,
    /// … that has many.
    pub is_one_of_many: bool,
    /// It, or what springs from it, reaches the tree's top.
    is_leader: bool,
}

impl Chains {
    /// `by_place`: weights go by the stem, too.
    pub fn new(skeleton: &Skeleton, by_place: bool) -> Chains {
        let n = skeleton.len();
        const NONE: u32 = u32::MAX;
        // The node that goes on from each: of the same axis, else the thickest.
        let mut onward = vec![NONE; n];
        for i in 1..n {
            let p = skeleton.parent[i] as usize;
            let on = onward[p] as usize;
            let is_next = |k: usize| skeleton.axis[k] == skeleton.axis[p];
            let wins = || !is_next(on) && skeleton.radius_m[i] > skeleton.radius_m[on];
            if is_next(i) || onward[p] == NONE || wins() {
                onward[p] = i as u32;
            }
        }
        // What else springs from each, as a list through the nodes.
        let (mut first, mut then) = (vec![NONE; n], vec![NONE; n]);
        let mut springs = 0;
        for i in (1..n).rev() {
            let p = skeleton.parent[i] as usize;
            if onward[p] != i as u32 {
                (then[i], first[p]) = (first[p], i as u32);
                springs += 1;
            }
        }
        let mut chains = Chains {
            node: Vec::with_capacity(n + springs),
            knot: Vec::with_capacity(n + springs),
            chain: Vec::with_capacity(1 + springs),
            branch: Vec::with_capacity(springs),
            first_branch: Vec::with_capacity(2 + springs),
        };
        chains.first_branch.push(0);
        // First node of a chain, the node it springs from, its place among the branches, and its parent.
        let mut todo = vec![(0, None, 0, 0)];
        let stems = skeleton.stems();
        while let Some((start, base, slot, parent)) = todo.pop() {
            let (from, k) = (chains.node.len(), chains.chain.len() as u32);
            let stands = stems > 1 && (start == 0 || base == Some(0));
            let radius_m = radius(skeleton, if stands && start == 0 { onward[0] } else { start });
            if let Some(base) = base {
                let at = skeleton.springs_at(start, base);
                chains.node.push(base);
                chains.knot.push(Knot { at, radius_m });
                chains.branch[slot].0 = k;
            }
            let mut next = start;
            while next != NONE {
                let (this, place) = (next, chains.node.len() as u32);
                let mut spring = first[this as usize];
                while spring != NONE {
                    todo.push((spring, Some(this), chains.branch.len(), k));
                    chains.branch.push((NONE, place));
                    spring = then[spring as usize];
                }
                next = onward[this as usize];
                // Radii as the mean of both nodes at a shared base (P18).
                let beyond = if next == NONE || this == 0 { this } else { next };
                let mean_m = 0.5 * (radius(skeleton, this) + radius(skeleton, beyond));
                let radius_m = if this == 0 { radius_m } else { mean_m };
                chains.node.push(this);
                chains.knot.push(Knot { at: skeleton.position[this as usize], radius_m });
            }
            let line = from..chains.node.len();
            let axis = skeleton.axis[start as usize];
            let is_leader = false;
            // Of those that are alike not all go at once: multiples of the golden section lie evenly.
            let spread =
                1.0 + ALIKE * ((k.wrapping_mul(0x9e37_79b9) >> 8) as f32 * 2f32.powi(-23) - 1.0);
            let most_m = chains.chain.get(parent as usize).map_or(f32::INFINITY, |on| on.weight_m);
            let weight_m = match (base, chains.chain.get(parent as usize)) {
                _ if stands || !by_place => radius_m,
                (Some(base), Some(on)) if parent == 0 || on.stands => {
                    radius_m * (on.radius_m / radius(skeleton, base).max(1e-6)).max(1.0)
                }
                (Some(_), Some(on)) => {
                    (radius_m * on.weight_m / on.radius_m.max(1e-6)).min(on.weight_m)
                }
                _ => radius_m,
            };
            // The first has no parent.
            let weight_m = if k == 0 { weight_m } else { (weight_m * spread).min(most_m) };
            chains.chain.push(Chain {
                line,
                base,
                first: start,
                axis,
                radius_m,
                weight_m,
                stands,
                is_one_of_many: stands && stems > FEW_STEMS,
                is_leader,
            });
            chains.first_branch.push(chains.branch.len() as u32);
        }
        chains.find_leaders(skeleton);
        chains
    }

    /// Radius of a chain so far along it; at its end where it is shorter.
    pub fn radius_after(&self, chain: u32, arc_m: f32) -> f32 {
        let knots = &self.knot[self.chain[chain as usize].line.clone()];
        let mut left_m = arc_m;
        for w in knots.windows(2) {
            let step_m = w[0].at.distance(w[1].at);
            if step_m >= left_m {
                let share = left_m / step_m.max(1e-9);
                return w[0].radius_m + (w[1].radius_m - w[0].radius_m) * share;
            }
            left_m -= step_m;
        }
        knots.last().map_or(0.0, |k| k.radius_m)
    }

    fn find_leaders(&mut self, skeleton: &Skeleton) {
        let height = |node: usize| skeleton.position[node].z;
        let top = (0..skeleton.len()).max_by(|&a, &b| height(a).total_cmp(&height(b)));
        let mut below = vec![false; skeleton.len()];
        let mut node = top.map(|top| top as u32);
        while let Some(i) = node {
            below[i as usize] = true;
            node = skeleton.parent_of(i);
        }
        for chain in &mut self.chain {
            chain.is_leader = below[chain.first as usize];
        }
    }

    /// Chains that spring from a chain, and the places of their bases in [`Pieces::arc_m`].
    pub fn branches(&self, chain: u32) -> &[(u32, u32)] {
        let [from, to] = [0, 1].map(|k| self.first_branch[chain as usize + k] as usize);
        &self.branch[from..to]
    }

    /// The nodes of a chain, with that of another chain it springs from.
    pub fn line(&self, chain: u32) -> &[u32] {
        &self.node[self.chain[chain as usize].line.clone()]
    }
}

fn radius(skeleton: &Skeleton, node: u32) -> f32 {
    skeleton.radius_m[node as usize].min(1e4)
}

/// The paths of all chains, as straight pieces.
#[derive(Default)]
pub struct Pieces {
    knot: Vec<Knot>,
    /// Of every chain; empty where it has no mesh.
    span: Vec<Range<u32>>,
    /// Arc length at every place of the chains' lines, each from its base.
    arc_m: Vec<f32>,
}

impl Pieces {
    /// The knots of every chain without those a straight cone replaces; of none whose base is
    /// thinner than `cut_m`, but for those that lead to the top where `keeps_top`.
    pub fn simplify(
        &mut self,
        chains: &Chains,
        sides: &Sides,
        (cut_m, keeps_top): (f32, bool),
        least: Least,
    ) {
        self.knot.clear();
        self.span.clear();
        self.arc_m.clear();
        self.knot.reserve(chains.knot.len());
        self.span.reserve(chains.chain.len());
        self.arc_m.reserve(chains.knot.len());
        for (c, chain) in chains.chain.iter().enumerate() {
            let start = self.knot.len() as u32;
            // Radii never grow outward: what springs from a dropped chain is thinner still.
            let has_all = chain.stands && sides.stem != Stem::PLAIN;
            let is_kept = c == 0 || has_all || keeps_top && chain.is_leader;
            if !is_kept && chain.weight_m < cut_m {
                self.arc_m.resize(chain.line.end, 0.0);
            } else {
                let knots = &chains.knot[chain.line.clone()];
                let mut off = Off::by(sides.tolerance_m);
                if chain.is_one_of_many {
                    (off.share, off.thick_m) = (Stem::PLAIN.off, 0.5 * chain.radius_m);
                } else if c == 0 || chain.stands {
                    (off.share, off.aside) = (sides.stem.off, sides.stem.aside);
                    off.thick_m = 0.5 * chain.radius_m;
                }
                simplify(knots, off, least.step_m, &mut self.knot, &mut self.arc_m);
            }
            self.span.push(start..self.knot.len() as u32);
        }
    }

    pub fn of(&self, chain: u32) -> &[Knot] {
        let span = &self.span[chain as usize];
        &self.knot[span.start as usize..span.end as usize]
    }

    /// Arc length at a place of [`Chains::branches`].
    pub fn arc_m(&self, place: u32) -> f32 {
        self.arc_m[place as usize]
    }

    /// Arc lengths at a chain's line.
    pub fn arcs_m(&self, chains: &Chains, chain: u32) -> &[f32] {
        &self.arc_m[chains.chain[chain as usize].line.clone()]
    }

    /// How many chains have a path.
    pub fn count(&self) -> usize {
        self.span.iter().filter(|s| !s.is_empty()).count()
    }
}
