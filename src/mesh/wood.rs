//! Which axes of a skeleton become tubes, and how finely, within a budget of triangles.

use std::ops::Range;

use glam::Vec3;

use super::junction::{self, Hole};
use super::path::{Foot, Knot, Least, Ring, Scratch, Sides, rings, simplify};
use super::tube::{Barks, Circles, Joints, count, lay_bark, tube};
use super::wind::Wind;
use super::{FoliageLevel, Junctions, MeshOptions, Surface};
use crate::seed::Seed;
use crate::skeleton::{Axis, Skeleton};
use crate::texture::BARK_REPEAT_M;

/// The tubes of a tree, parents before their branches.
pub struct Wood {
    ring: Vec<Ring>,
    hole: Vec<Hole>,
    tube: Vec<Tube>,
    pub triangles: usize,
    vertices: usize,
}

struct Tube {
    rings: Range<usize>,
    holes: Range<usize>,
    /// The hole it comes out of.
    out_of: Option<usize>,
    chain: usize,
    /// Of its random draws.
    key: u64,
}

/// Axes that run on from tip to base, as one tube: the thickest that springs from a tip goes on.
pub struct Chains {
    /// Nodes from base to tip, chain after chain; parents first.
    node: Vec<u32>,
    chain: Vec<Chain>,
    /// Of every node.
    of_node: Vec<u32>,
}

struct Chain {
    nodes: Range<usize>,
    /// The node of another chain it springs from.
    base: Option<u32>,
    axis: u32,
}

impl Chains {
    pub fn new(skeleton: &Skeleton, axes: &[Axis]) -> Chains {
        let n = skeleton.len();
        const NONE: u32 = u32::MAX;
        let mut is_tip = vec![false; n];
        let mut order: Vec<u32> = Vec::with_capacity(axes.len());
        for (k, axis) in axes.iter().enumerate() {
            if let Some(&tip) = axis.nodes.last() {
                is_tip[tip as usize] = true;
                order.push(k as u32);
            }
        }
        order.sort_unstable_by_key(|&k| axes[k as usize].nodes.first().copied());
        // The axis that goes on from each tip.
        let mut onward = vec![NONE; n];
        let radius =
            |k: u32| axes[k as usize].nodes.first().map_or(0.0, |&i| skeleton.radius_m[i as usize]);
        for &k in &order {
            if let Some(base) = axes[k as usize].base.filter(|&b| is_tip[b as usize]) {
                let on = &mut onward[base as usize];
                if *on == NONE || radius(k) > radius(*on) {
                    *on = k;
                }
            }
        }
        let mut chains = Chains {
            node: Vec::with_capacity(n),
            chain: Vec::with_capacity(axes.len()),
            of_node: vec![0; n],
        };
        for &k in &order {
            let base = axes[k as usize].base;
            if base.is_some_and(|b| onward[b as usize] == k) {
                continue;
            }
            let start = chains.node.len();
            let mut next = k;
            while next != NONE {
                let nodes = &axes[next as usize].nodes;
                chains.node.extend_from_slice(nodes);
                next = nodes.last().map_or(NONE, |&tip| onward[tip as usize]);
            }
            let nodes = start..chains.node.len();
            for &i in &chains.node[nodes.clone()] {
                chains.of_node[i as usize] = chains.chain.len() as u32;
            }
            chains.chain.push(Chain { nodes, base, axis: k });
        }
        chains
    }

    /// The nodes of a chain, with that of another chain it springs from.
    fn line(&self, chain: usize) -> Vec<u32> {
        let c = &self.chain[chain];
        c.base.into_iter().chain(self.node[c.nodes.clone()].iter().copied()).collect()
    }
}

/// How much coarser a wood may become for a budget, and how often that is tried.
const COARSEST: f32 = 3000.0;
const ATTEMPTS: u32 = 12;

/// Plans the wood; with a budget, coarser until it fits: thin axes, which foliage hides, go first,
/// then sides and rings. The stem always stays.
pub fn plan(
    skeleton: &Skeleton,
    chains: &Chains,
    options: &MeshOptions,
    budget: Option<usize>,
    has_young: bool,
) -> Wood {
    let height_m = skeleton.height_m();
    let reach = skeleton.position.iter().map(|p| p.abs().max_element()).fold(0.0, f32::max);
    let planner = Planner {
        skeleton,
        chains,
        mixed_m: has_young.then(|| YOUNG_HEIGHT.map(|h| h * height_m)),
        least: Least::within(reach),
        is_welded: options.junctions == Junctions::Welded,
    };
    let tolerance_m = options.tolerance_m.clamp(1e-5, 1.0);
    // Bare twigs are the crown: there sides go before axes.
    let is_bare = options.foliage == FoliageLevel::None;
    let thin_m = if is_bare { 0.0003 } else { 0.0015 };
    let attempt = |coarse: f32| {
        let detail = options.detail && coarse < 30.0;
        planner.attempt(tolerance_m * coarse.powf(0.6), thin_m * (coarse - 1.0), detail)
    };
    let finest = attempt(1.0);
    let Some(budget) = budget.filter(|&b| finest.triangles > b) else { return finest };
    // Triangles fall about with a power of the coarseness: false position between the logarithms,
    // until a wood uses most of the budget.
    let log = |triangles: usize| (triangles.max(1) as f32 / budget.max(1) as f32).ln();
    let (mut fine, mut over) = (0.0f32, log(finest.triangles));
    let (mut rough, mut under) = (COARSEST.ln(), None);
    let mut best = None;
    for k in 0..ATTEMPTS {
        let x = match under {
            None => (fine + over.max(0.1)).min(rough),
            Some(under) if k % 3 != 2 => fine + (rough - fine) * over / (over - under),
            Some(_) => 0.5 * (fine + rough),
        };
        let wood = attempt(x.exp());
        let off = log(wood.triangles);
        if off > 0.0 {
            (fine, over) = (x, off);
            if x >= rough {
                break;
            }
        } else {
            (rough, under) = (x, Some(off - 0.02));
            best = Some(wood);
            if off > -0.06 || rough - fine < 0.01 {
                break;
            }
        }
    }
    best.unwrap_or_else(|| attempt(COARSEST))
}

struct Planner<'a> {
    skeleton: &'a Skeleton,
    chains: &'a Chains,
    mixed_m: Option<[f32; 2]>,
    least: Least,
    is_welded: bool,
}

/// The paths of all chains, as straight pieces.
struct Pieces {
    knot: Vec<Knot>,
    /// Of every chain; empty where it has no mesh.
    span: Vec<Range<usize>>,
    /// Arc length at every node, from its chain's base.
    node_arc_m: Vec<f32>,
}

impl Planner<'_> {
    fn attempt(&self, tolerance_m: f32, cut_m: f32, detail: bool) -> Wood {
        let pieces = self.pieces(tolerance_m, cut_m);
        let sides = Sides::new(tolerance_m);
        let mut wood = Wood {
            ring: Vec::with_capacity(pieces.knot.len() * 2),
            hole: Vec::new(),
            tube: Vec::new(),
            triangles: 0,
            vertices: 0,
        };
        let count_of = pieces.span.len();
        let Some(root) = pieces.span.iter().position(|s| !s.is_empty()) else { return wood };
        let children = self.children(&pieces, root);
        let mut out_of: Vec<Option<usize>> = vec![None; count_of];
        let (mut scratch, mut path, mut branches) = (Scratch::default(), vec![], vec![]);
        for c in root..count_of {
            let knots = &pieces.knot[pieces.span[c].clone()];
            let foot = match out_of[c] {
                Some(hole) => Foot::Collar(wood.hole[hole].start),
                None if c == root || !self.is_welded => self.foot(c),
                None => continue,
            };
            path.clear();
            let shift = rings(knots, foot, self.least, &sides, detail, &mut scratch, &mut path);
            if path.is_empty() {
                continue;
            }
            branches.clear();
            let mut todo: Vec<(u32, f32)> = children.of(c).to_vec();
            while let Some((child, arc_m)) = todo.pop() {
                let knots = &pieces.knot[pieces.span[child as usize].clone()];
                let found = junction::leave(&path, arc_m + shift, knots, child, self.least, &sides);
                match found {
                    Some(branch) => branches.push(branch),
                    // What springs from a branch within the bark springs from the bark.
                    None => {
                        todo.extend(children.of(child as usize).iter().map(|&(k, _)| (k, arc_m)))
                    }
                }
            }
            let (first_ring, first_hole) = (wood.ring.len(), wood.hole.len());
            junction::open(&path, &mut branches, self.least, &mut wood.ring, &mut wood.hole);
            lay_bark(&mut wood.ring[first_ring..], BARK_REPEAT_M);
            for (k, hole) in wood.hole.iter().enumerate().skip(first_hole) {
                out_of[hole.child as usize] = Some(k);
            }
            let made = &wood.ring[first_ring..];
            let (triangles, vertices) = count(made, &wood.hole[first_hole..], out_of[c].is_some());
            wood.triangles += triangles;
            wood.vertices += vertices;
            wood.tube.push(Tube {
                rings: first_ring..wood.ring.len(),
                holes: first_hole..wood.hole.len(),
                out_of: out_of[c],
                chain: c,
                key: u64::from(self.chains.chain[c].axis),
            });
        }
        wood
    }

    /// The knots of every chain: from its parent's axis to its tip, radii as the mean of both nodes
    /// at a shared base (P18), without those a straight cone replaces.
    fn pieces(&self, tolerance_m: f32, cut_m: f32) -> Pieces {
        let s = self.skeleton;
        let mut out = Pieces {
            knot: Vec::with_capacity(s.len() + self.chains.chain.len()),
            span: Vec::with_capacity(self.chains.chain.len()),
            node_arc_m: vec![0.0; s.len()],
        };
        let (mut knots, mut arc) = (Vec::new(), Vec::new());
        let at = |i: u32| s.position[i as usize];
        let radius = |i: u32| s.radius_m[i as usize].min(1e4);
        for (c, chain) in self.chains.chain.iter().enumerate() {
            let nodes = &self.chains.node[chain.nodes.clone()];
            let start = out.knot.len();
            // Radii never grow outward: what springs from a dropped axis is thinner still.
            if nodes.is_empty() || (c > 0 && radius(nodes[0]) < cut_m) {
                out.span.push(start..start);
                continue;
            }
            knots.clear();
            arc.clear();
            if let Some(base) = chain.base {
                knots.push(Knot { at: at(base), radius_m: radius(nodes[0]) });
            }
            for (k, &i) in nodes.iter().enumerate() {
                let next = nodes.get(k + 1).copied().unwrap_or(i);
                let is_first = k == 0 && chain.base.is_none();
                let mean = if is_first { radius(i) } else { 0.5 * (radius(i) + radius(next)) };
                knots.push(Knot { at: at(i), radius_m: mean });
            }
            simplify(&knots, tolerance_m, self.least.step_m, &mut out.knot, &mut arc);
            let own = usize::from(chain.base.is_some());
            for (&i, &a) in nodes.iter().zip(&arc[own.min(arc.len())..]) {
                out.node_arc_m[i as usize] = a;
            }
            out.span.push(start..out.knot.len());
        }
        out
    }

    /// The branches of every chain that has a mesh, with the arc length where they spring. None
    /// where tubes merely pass through each other.
    fn children(&self, pieces: &Pieces, root: usize) -> Lists {
        if !self.is_welded {
            return Lists::new(pieces.span.len(), &[]);
        }
        let mut parent: Vec<(u32, f32)> = vec![(root as u32, 0.0); pieces.span.len()];
        let mut links = Vec::new();
        for (c, chain) in self.chains.chain.iter().enumerate().skip(root + 1) {
            if let Some(base) = chain.base {
                let p = self.chains.of_node[base as usize] as usize;
                // One without a mesh hands its branches on; before the root there is none.
                parent[c] = match pieces.span[p].is_empty() {
                    true => parent[p],
                    false => (p as u32, pieces.node_arc_m[base as usize]),
                };
            }
            if !pieces.span[c].is_empty() {
                links.push((c as u32, parent[c]));
            }
        }
        Lists::new(pieces.span.len(), &links)
    }

    /// How a chain begins that comes out of no hole.
    fn foot(&self, c: usize) -> Foot {
        let s = self.skeleton;
        match self.chains.chain[c].base {
            // Several stems may spring from the root.
            Some(base) if base != 0 && !self.is_welded => {
                let before = s.parent_of(base).unwrap_or(base);
                let along = s.position[base as usize] - s.position[before as usize];
                Foot::Inside {
                    parent_radius_m: s.radius_m[base as usize].min(1e4),
                    parent_direction: along.normalize_or_zero(),
                }
            }
            _ => Foot::Ground { mixed_m: self.mixed_m },
        }
    }
}

/// Lists of branches in one column.
struct Lists {
    start: Vec<usize>,
    list: Vec<(u32, f32)>,
}

impl Lists {
    /// Of `n` parents, from (child, (parent, arc length)).
    fn new(n: usize, links: &[(u32, (u32, f32))]) -> Lists {
        let mut start = vec![0; n + 1];
        for (_, (parent, _)) in links {
            start[*parent as usize + 1] += 1;
        }
        for i in 0..n {
            start[i + 1] += start[i];
        }
        let mut next = start.clone();
        let mut list = vec![(0, 0.0); links.len()];
        for &(child, (parent, arc_m)) in links {
            list[next[parent as usize]] = (child, arc_m);
            next[parent as usize] += 1;
        }
        Lists { start, list }
    }

    fn of(&self, parent: usize) -> &[(u32, f32)] {
        &self.list[self.start[parent]..self.start[parent + 1]]
    }
}

/// Bark is young where the wood is thin, or high up: radius over that of the stem's foot and height
/// over the tree's, from all old to all young.
const YOUNG_RADIUS: [f32; 2] = [0.5, 0.3];
const YOUNG_HEIGHT: [f32; 2] = [0.3, 0.6];

impl Wood {
    /// The triangles of all tubes: old bark, and young bark where `has_young`; with their wind where
    /// it is asked for.
    pub fn surfaces(
        &self,
        skeleton: &Skeleton,
        has_young: bool,
        wind: Option<(&Wind, &Chains)>,
        seed: Seed,
    ) -> [Surface; 2] {
        let circles = Circles::new();
        let [mut old, mut young] = [Surface::default(), Surface::default()];
        if !has_young {
            old.position.reserve_exact(self.vertices);
            old.normal.reserve_exact(self.vertices);
            old.uv.reserve_exact(self.vertices);
            old.index.reserve_exact(self.triangles * 3);
        }
        let (foot_m, height_m) = (skeleton.radius_m[0].max(1e-6), skeleton.height_m().max(1e-6));
        let part = |x: f32, range: [f32; 2]| (x - range[0]) / (range[1] - range[0]);
        let share = |ring: &Ring| {
            let thin = part(ring.radius_m / foot_m, YOUNG_RADIUS);
            let high = part(ring.centre.z / height_m, YOUNG_HEIGHT);
            if has_young { thin.max(high).clamp(0.0, 1.0) } else { 0.0 }
        };
        let rims: usize = self.hole.iter().map(|h| h.start.sides as usize).sum();
        let mut rim = vec![(Vec3::ZERO, Vec3::ZERO); rims];
        let mut first = Vec::with_capacity(self.hole.len() + 1);
        let mut next = 0;
        for hole in &self.hole {
            first.push(next);
            next += hole.start.sides as usize;
        }
        first.push(next);
        for t in &self.tube {
            // A tube's holes lie after the one it comes out of.
            let (before, rest) = rim.split_at_mut(first[t.holes.start]);
            let base = t.out_of.map_or(&[][..], |h| &before[first[h]..first[h + 1]]);
            let own = first[t.holes.end] - first[t.holes.start];
            let mut joints = Joints {
                base,
                is_collar: t.out_of.is_some_and(|h| self.hole[h].start.has_collar),
                holes: &self.hole[t.holes.clone()],
                rims: &mut rest[..own],
            };
            let mut barks = Barks {
                surface: [&mut old, &mut young],
                young: &share,
                draws: seed.derive("bark", t.key).draws(),
            };
            tube(&self.ring[t.rings.clone()], &circles, &mut joints, &mut barks);
            if let Some((wind, chains)) = wind {
                let line = chains.line(t.chain);
                for surface in [&mut old, &mut young] {
                    let new = &surface.position[surface.wind.len()..];
                    let wind = new.iter().map(|&p| wind.wood(p, skeleton, &line));
                    surface.wind.extend(wind);
                }
            }
        }
        [old, young]
    }
}
