//! A skeleton through a cloud: the longest ways first, then what is still farthest, until the
//! nodes are used (after Sato et al. 2000, TEASAR); then nodes are drawn to the middle of the
//! points that are theirs (a principal curve, Hastie & Stuetzle 1989).
//!
//! A way ends where it comes as near to wood as that is thick, so that points from two sides of
//! a limb make one limb.

use glam::Vec3;
use rayon::prelude::*;

use super::graph::Ways;
use super::near::{Cone, Points, Wood};
use crate::skeleton::NO_PARENT;

/// From one level of detail to the next the distance allowed shrinks so.
const FINER: f32 = 0.7;
const ROUNDS: usize = 6;

/// A tree of nodes; the known ones first.
#[derive(Clone)]
pub(super) struct Nodes {
    pub position: Vec<Vec3>,
    pub parent: Vec<u32>,
}

/// What bounds the tracing.
pub(super) struct Bounds {
    pub max_nodes: usize,
    /// Length of an internode.
    pub step_m: f32,
    /// Usual distance between vertices.
    pub spacing_m: f32,
    /// Vertices nearer to wood than this are left alone.
    pub finest_m: f32,
    /// Radius of the wood that carries all vertices.
    pub limb_m: f32,
    /// Distance allowed on the first level.
    pub coarse_m: f32,
}

struct Tracing<'a> {
    vertices: &'a [Vec3],
    known: usize,
    near: &'a Points,
    ways: &'a Ways,
    bounds: &'a Bounds,
    /// Radius of the limb through a vertex, as the pipe model has it.
    limb_m: Vec<f32>,
    nodes: Nodes,
    /// The node at or below a vertex on a way taken.
    node_at: Vec<u32>,
    /// Distance to the skeleton's surface as far as looked at, and the node it is reached at.
    apart_m: Vec<f32>,
    nearest: Vec<u32>,
}

/// Adds ways through the vertices to the known nodes, as many as the bounds allow. Tells too how
/// far vertices were still allowed to be from wood when the nodes were used.
pub(super) fn trace(
    vertices: &[Vec3],
    known: Nodes,
    near: &Points,
    wood: &Wood,
    ways: &Ways,
    bounds: &Bounds,
) -> (Nodes, f32) {
    let (n, k) = (vertices.len(), known.position.len());
    let first: Vec<(f32, u32)> = vertices
        .par_iter()
        .map(|p| wood.nearest(*p).map_or((f32::INFINITY, 0), |(c, d)| (d.max(0.0), c.node)))
        .collect();
    let mut tracing = Tracing {
        vertices,
        known: k,
        near,
        ways,
        bounds,
        limb_m: limbs(vertices, near, ways, k, bounds.limb_m),
        nodes: known,
        node_at: (0..n as u32).map(|i| if (i as usize) < k { i } else { NO_PARENT }).collect(),
        apart_m: first.iter().map(|f| f.0).collect(),
        nearest: first.iter().map(|f| f.1).collect(),
    };
    let mut far: Vec<u32> = (k as u32..n as u32).collect();
    far.sort_by(|a, b| ways.length_m[*b as usize].total_cmp(&ways.length_m[*a as usize]));
    let mut allowed_m = bounds.coarse_m;
    while allowed_m >= bounds.finest_m && tracing.has_room() {
        for &v in &far {
            if !tracing.has_room() {
                break;
            }
            if tracing.apart_m[v as usize] > allowed_m {
                tracing.take(v, allowed_m);
            }
        }
        if tracing.has_room() {
            allowed_m *= FINER;
        }
    }
    (tracing.nodes, allowed_m)
}

/// Radius of the limb through each vertex, from the vertices whose ways lead through it or beside
/// it: ways along several sides of a limb are of one limb.
fn limbs(vertices: &[Vec3], near: &Points, ways: &Ways, known: usize, whole_m: f32) -> Vec<f32> {
    let n = vertices.len();
    let mut carried = vec![1.0f32; n];
    for &i in ways.order.iter().rev() {
        let next = ways.next[i as usize];
        if next != i && next as usize >= known {
            carried[next as usize] += carried[i as usize];
        }
    }
    let all = (n - known).max(1) as f32;
    let radius_m = |carried: f32| whole_m * (carried / all).min(1.0).powf(0.45);
    // As far as the limb is thick, all that crosses the same distance from the stem.
    let through = |i: usize| {
        let at_m = ways.length_m[i];
        let mut limb_m = whole_m;
        for _ in 0..3 {
            let crossing = near.within(vertices[i], 2.0 * limb_m).filter_map(|(j, _)| {
                let j = j as usize + known;
                let below_m = ways.length_m[ways.next[j] as usize];
                (below_m < at_m && at_m <= ways.length_m[j]).then_some(carried[j])
            });
            limb_m = radius_m(crossing.sum::<f32>().max(carried[i]));
        }
        limb_m
    };
    (0..n).into_par_iter().map(|i| if i < known { whole_m } else { through(i) }).collect()
}

impl Tracing<'_> {
    fn has_room(&self) -> bool {
        self.nodes.position.len() < self.bounds.max_nodes
    }

    /// Follows the way from a vertex to the skeleton and adds it.
    fn take(&mut self, tip: u32, allowed_m: f32) {
        let mut path = vec![tip];
        let mut at = tip;
        let base = loop {
            let next = self.ways.next[at as usize];
            if next == at {
                break 0;
            }
            at = next;
            let i = at as usize;
            if self.node_at[i] != NO_PARENT {
                break self.node_at[i];
            }
            let claim_m = (1.5 * self.bounds.spacing_m).max(1.6 * self.limb_m[i]).min(allowed_m);
            if self.apart_m[i] <= claim_m {
                break self.lower(self.nearest[i], self.vertices[i]);
            }
            path.push(at);
        };
        path.reverse();
        let mut last = base;
        let end = path.len() - 1;
        for (k, &v) in path.iter().enumerate() {
            let p = self.vertices[v as usize];
            let from = self.nodes.position[last as usize];
            let run_m = p.distance(from);
            let is_tip = k == end;
            if run_m >= self.bounds.step_m || (is_tip && run_m > 0.0) {
                if is_tip && last != base && run_m < 0.4 * self.bounds.step_m {
                    self.nodes.position[last as usize] = p;
                } else {
                    self.nodes.position.push(p);
                    self.nodes.parent.push(last);
                    last = self.nodes.position.len() as u32 - 1;
                    self.cover(last, from, p, allowed_m);
                }
            }
            self.node_at[v as usize] = last;
        }
        // A tip that coincides with a node would be looked at again and again.
        self.apart_m[tip as usize] = 0.0;
    }

    /// The node from which a branch to `p` leaves at an acute angle: as far below `node` as `p` is
    /// beside it.
    fn lower(&self, mut node: u32, p: Vec3) -> u32 {
        let beside_m = self.nodes.position[node as usize].distance(p);
        let mut gone_m = 0.0;
        while gone_m < beside_m {
            let parent = self.nodes.parent[node as usize];
            if parent == NO_PARENT {
                break;
            }
            let step_m =
                self.nodes.position[node as usize].distance(self.nodes.position[parent as usize]);
            if gone_m + 0.5 * step_m > beside_m {
                break;
            }
            gone_m += step_m;
            node = parent;
        }
        node
    }

    fn cover(&mut self, node: u32, from: Vec3, to: Vec3, reach_m: f32) {
        let cone = Cone { from, to, radius_m: [0.0; 2], node };
        let ball_m = reach_m + 0.5 * from.distance(to);
        for (i, _) in self.near.within(0.5 * (from + to), ball_m) {
            let i = i as usize + self.known;
            let (_, d) = cone.distance_m(self.vertices[i]);
            if d < self.apart_m[i] {
                self.apart_m[i] = d;
                self.nearest[i] = node;
            }
        }
    }
}

/// Draws the nodes after the known ones to the middle of the points nearest to them, and evens
/// them. Points farther than `reach_m` do not draw.
pub(super) fn centre(
    nodes: &mut Nodes,
    known_radius_m: &[f32],
    points: &[Vec3],
    heir: &[u32],
    reach_m: f32,
) {
    let (n, fixed) = (nodes.position.len(), known_radius_m.len());
    for _ in 0..ROUNDS {
        let wood = Wood::new(cones(nodes, Some(known_radius_m)));
        let pulls: Vec<Option<(u32, f32, Vec3)>> = points
            .par_iter()
            .map(|p| {
                let (cone, _) = wood
                    .nearest(*p)
                    .filter(|(c, d)| c.node as usize >= fixed && d.abs() <= reach_m)?;
                let (t, _) = cone.distance_m(*p);
                Some((cone.node, t, *p - cone.from.lerp(cone.to, t)))
            })
            .collect();
        let (mut pull, mut weight) = (vec![Vec3::ZERO; n], vec![1e-3f32; n]);
        for (node, t, off) in pulls.into_iter().flatten() {
            let ends = [(nodes.parent[node as usize], 1.0 - t), (node, t)];
            for (i, share) in ends {
                if let Some(sum) = pull.get_mut(i as usize) {
                    *sum += share * off;
                    weight[i as usize] += share;
                }
            }
        }
        let before = nodes.position.clone();
        for i in fixed..n {
            let mut to = before[i] + 0.7 * pull[i] / weight[i];
            let parent = nodes.parent[i];
            if let (Some(&up), Some(&down)) =
                (before.get(heir[i] as usize), before.get(parent as usize))
            {
                to = to.lerp(0.5 * (up + down), 0.2);
            }
            if to.is_finite() && to.z > 0.0 {
                nodes.position[i] = to;
            }
        }
    }
    for i in 1..n {
        let parent = nodes.parent[i] as usize;
        if nodes.position[i].distance_squared(nodes.position[parent]) < 1e-8 {
            nodes.position[i] = nodes.position[parent] + Vec3::Z * 1e-3;
        }
    }
}

/// The internodes of a tree; without radii, lines.
pub(super) fn cones(nodes: &Nodes, radius_m: Option<&[f32]>) -> Vec<Cone> {
    let r = |i: usize| radius_m.and_then(|r| r.get(i)).copied().unwrap_or(0.0);
    (0..nodes.position.len())
        .filter(|&i| nodes.parent[i] != NO_PARENT)
        .map(|i| {
            let p = nodes.parent[i] as usize;
            Cone {
                from: nodes.position[p],
                to: nodes.position[i],
                radius_m: [r(p), r(i)],
                node: i as u32,
            }
        })
        .collect()
}
