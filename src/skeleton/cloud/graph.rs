//! Ways through a cloud: each point to its neighbours, parts joined by the shortest bridges, and
//! from every point the cheapest way to wood that is known already.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BinaryHeap};

use glam::Vec3;
use rayon::prelude::*;

use super::near::{Points, Wood};

/// Neighbours a point is joined to.
const NEIGHBOURS: usize = 9;
/// A step costs its length to this power: many short steps through wood beat one across air.
const COST_POWER: f32 = 1.6;
/// Points of a part from which a bridge is looked for, and neighbours each of them tries.
const BRIDGE_STARTS: usize = 3000;
const BRIDGE_TRIES: usize = 120;
const MOST_ROUNDS: u32 = 40;

/// The cheapest ways to the known wood.
pub(super) struct Ways {
    /// The next vertex on the way; itself for known nodes.
    pub next: Vec<u32>,
    /// Length of the way, metres.
    pub length_m: Vec<f32>,
    /// Vertices from the nearest by cost to the farthest, known nodes first.
    pub order: Vec<u32>,
}

/// Disjoint sets of ids.
pub(super) struct Sets(Vec<u32>);

impl Sets {
    pub fn new(count: usize) -> Sets {
        Sets((0..count as u32).collect())
    }

    pub fn find(&mut self, mut i: u32) -> u32 {
        while self.0[i as usize] != i {
            let up = self.0[self.0[i as usize] as usize];
            self.0[i as usize] = up;
            i = up;
        }
        i
    }

    pub fn join(&mut self, a: u32, b: u32) {
        let (a, b) = (self.find(a), self.find(b));
        // The smaller id leads, so that the known wood, which holds id 0, keeps its name.
        self.0[a.max(b) as usize] = a.min(b);
    }
}

#[derive(Debug, Clone, Copy)]
struct Edge {
    ends: [u32; 2],
    length_m: f32,
}

/// `vertices` begin with the `known` nodes whose wood is `wood`; `near` holds the rest, counted
/// from 0. Points within `link_m` of the wood are joined to it.
pub(super) fn ways(
    vertices: &[Vec3],
    known: usize,
    near: &Points,
    wood: &Wood,
    link_m: f32,
) -> Ways {
    let n = vertices.len();
    let mut edges: Vec<Edge> = (known..n)
        .into_par_iter()
        .flat_map_iter(|i| {
            let p = vertices[i];
            let to_wood = wood.nearest(p).filter(|(_, d)| *d <= link_m);
            let link = to_wood.map(|(cone, d)| (cone.node, d.max(1e-3)));
            let around = near.around(p).take(NEIGHBOURS).map(move |(j, d)| (j + known as u32, d));
            around
                .chain(link)
                .filter(move |&(j, _)| j != i as u32)
                .map(move |(j, length_m)| Edge { ends: [i as u32, j], length_m })
        })
        .collect();
    let mut sets = Sets::new(n);
    for i in 1..known {
        sets.join(0, i as u32);
    }
    for e in &edges {
        sets.join(e.ends[0], e.ends[1]);
    }
    for _ in 0..MOST_ROUNDS {
        let label: Vec<u32> = (0..n as u32).map(|i| sets.find(i)).collect();
        let mut parts: BTreeMap<u32, Vec<u32>> = BTreeMap::new();
        for (i, &l) in label.iter().enumerate().filter(|(_, l)| **l != 0) {
            parts.entry(l).or_default().push(i as u32);
        }
        if parts.is_empty() {
            break;
        }
        let parts: Vec<Vec<u32>> = parts.into_values().collect();
        let bridges: Vec<Edge> = parts
            .par_iter()
            .filter_map(|part| bridge(vertices, known, near, wood, &label, part))
            .collect();
        for edge in bridges {
            sets.join(edge.ends[0], edge.ends[1]);
            edges.push(edge);
        }
    }
    let (next, length_m, order) = cheapest(n, known, &edges);
    Ways { next, length_m, order }
}

/// A short edge from a part to what is not of it; the shortest unless the part is large.
fn bridge(
    vertices: &[Vec3],
    known: usize,
    near: &Points,
    wood: &Wood,
    label: &[u32],
    part: &[u32],
) -> Option<Edge> {
    let own = label[*part.first()? as usize];
    let mut best: Option<Edge> = None;
    let every = part.len().div_ceil(BRIDGE_STARTS);
    for &i in part.iter().step_by(every) {
        let p = vertices[i as usize];
        let bound = best.map_or(f32::INFINITY, |b| b.length_m);
        let other = near
            .around(p)
            .take(BRIDGE_TRIES)
            .take_while(|&(_, d)| d < bound)
            .map(|(j, d)| (j + known as u32, d))
            .find(|&(j, _)| label[j as usize] != own);
        let to_wood = wood.nearest(p).map(|(cone, d)| (cone.node, d.max(1e-3)));
        for (j, length_m) in other.into_iter().chain(to_wood) {
            if best.is_none_or(|b| length_m < b.length_m) {
                best = Some(Edge { ends: [i, j], length_m });
            }
        }
    }
    best
}

/// Dijkstra from all known nodes.
fn cheapest(n: usize, known: usize, edges: &[Edge]) -> (Vec<u32>, Vec<f32>, Vec<u32>) {
    let mut start = vec![0u32; n + 1];
    for e in edges {
        start[e.ends[0] as usize + 1] += 1;
        start[e.ends[1] as usize + 1] += 1;
    }
    for i in 0..n {
        start[i + 1] += start[i];
    }
    let mut fill = start.clone();
    let mut list = vec![(0u32, 0.0f32); 2 * edges.len()];
    for e in edges {
        for [a, b] in [e.ends, [e.ends[1], e.ends[0]]] {
            list[fill[a as usize] as usize] = (b, e.length_m);
            fill[a as usize] += 1;
        }
    }
    let mut cost = vec![f32::INFINITY; n];
    let mut next: Vec<u32> = (0..n as u32).collect();
    let mut length_m = vec![0.0f32; n];
    let mut order = Vec::with_capacity(n);
    let mut is_done = vec![false; n];
    // Costs are not negative, so their bits are in order.
    let mut heap = BinaryHeap::new();
    for (i, cost) in cost.iter_mut().enumerate().take(known) {
        *cost = 0.0;
        heap.push(Reverse((0u32, i as u32)));
    }
    while let Some(Reverse((_, i))) = heap.pop() {
        if std::mem::replace(&mut is_done[i as usize], true) {
            continue;
        }
        order.push(i);
        let i = i as usize;
        for &(j, step_m) in &list[start[i] as usize..start[i + 1] as usize] {
            let through = cost[i] + step_m.powf(COST_POWER);
            let j = j as usize;
            if through < cost[j] {
                cost[j] = through;
                next[j] = i as u32;
                length_m[j] = length_m[i] + step_m;
                heap.push(Reverse((through.to_bits(), j as u32)));
            }
        }
    }
    (next, length_m, order)
}
