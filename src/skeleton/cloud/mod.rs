//! One tree fitted to a laser scan of it.
//!
//! 1. Strays are dropped, and the ground, where the lowest layer is wide and thin, with the low
//!    growth on it.
//! 2. The stem: circles in slices across it, followed up and down (`stem`). Its foot is the root.
//! 3. The rest of the points become a graph, each joined to its neighbours and parts to one
//!    another by short bridges; from each, the cheapest way leads to the stem (`graph`, after
//!    Verroust & Lazarus 2000 and Xu, Gossett & Chen 2007).
//! 4. The longest ways become branches, then what is still farthest, until the nodes are used;
//!    branches are drawn to the middle of their points (`trace`).
//! 5. Radii: the stem's as measured; the branches' by the pipe model, scaled to the stem where
//!    they leave it.
//!
//! Where no stem is seen but the foot of the cloud is narrow, ways lead to that foot. Where the
//! cloud shows a crown alone, as from the air, the species is grown into it ([`grow`]) and ways
//! lead to that tree.
//!
//! The distance told is that of every point left to the surface of the wood as truncated cones;
//! points inside the wood count with their depth. Leaves are points like others.
//!
//! Limits: a stem thinner than 2.4 cm is not measured; without ground in the cloud the lowest
//! point stands for it; where crowns of two trees meet, both are taken for one; hidden sides of
//! a crown stay empty unless the cloud is from the air.

mod graph;
mod measure;
mod near;
mod parts;
mod stem;
mod trace;

use glam::Vec3;
use serde::Serialize;

use self::measure::Fit;
use self::near::{Points, Wood};
use self::parts::{Ground, bounds, thinned};
use self::trace::Nodes;
use super::grow::{self, Detail, HEIGHTS_M, Target};
use super::radii::{Pipes, radii};
use super::stage::births;
use super::{NO_PARENT, Skeleton, polish};
use crate::crown::Crown;
use crate::diagnostic::{Error, Result};
use crate::seed::Seed;
use crate::species::Species;

pub use measure::OUTSIDE_M;

/// Fewer points are no tree.
const LEAST_POINTS: usize = 20;
/// Wider clouds are forests, metres.
const MOST_WIDTH_M: f32 = 60.0;
/// Lower clouds are no tree, metres.
const LEAST_HEIGHT_M: f32 = 0.3;
/// Vertices of the graph.
const VERTICES: std::ops::RangeInclusive<usize> = 5_000..=80_000;
/// Finest cell that vertices are thinned to, metres.
const FINEST_M: f32 = 0.01;
/// Points nearer to wood than this need no way of their own, however sparse the cloud, metres.
const FINEST_WAY_M: f32 = 0.15;
/// Points within this share of the stem's radius from its surface are bark, and bear no branch.
const BARK: f32 = 0.45;
/// How often longer internodes are tried where nodes are few.
const STEP_TRIES: usize = 4;
/// Parts this share of the height apart, seen from above, are trees of their own; and the least
/// such distance in metres.
const APART: f32 = 0.15;
const APART_LEAST_M: f32 = 1.5;

/// What the tree was led by.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Led {
    /// A stem measured in the cloud.
    Stem,
    /// The narrow foot of the cloud.
    Foot,
    /// A crown, with the species' own wood inside.
    Crown,
}

/// How the fit went. Lengths in metres, shares 0…1.
#[derive(Debug, Clone, Serialize)]
pub struct Report {
    pub led_by: Led,
    /// Points given, and of those the ones left out: not finite, with almost nothing around them,
    /// ground with the low growth on it.
    pub points: usize,
    pub not_finite: usize,
    pub strays: usize,
    pub ground: usize,
    /// Points that the distances count.
    pub measured: usize,
    pub height_m: f32,
    /// Stem diameter at 1.3 m (at a tenth of the height of trees below 2.6 m).
    pub stem_diameter_m: f32,
    /// From a point to the surface of the wood.
    pub mean_m: f64,
    pub p95_m: f64,
    /// Wood farther than this from every point is outside the cloud.
    pub outside_beyond_m: f32,
    pub outside_length: f64,
    pub outside_volume: f64,
}

/// A tree and how it fits its cloud.
#[derive(Debug, Clone)]
pub struct Fitted {
    pub skeleton: Skeleton,
    /// Where in the cloud the skeleton's origin is.
    pub root: Vec3,
    pub report: Report,
}

/// Known wood that ways lead to, about the root.
struct Start {
    led_by: Led,
    nodes: Nodes,
    radius_m: Vec<f32>,
    /// Axis of each node.
    axis: Vec<u32>,
}

/// Fits a tree of the species to the points of one tree, metres, Z up. Same arguments, same bytes.
///
/// # Errors
/// Clouds that are no single tree: too few points, too low, too wide, in parts far apart.
pub fn fit(species: &Species, points: &[Vec3], detail: Detail, seed: Seed) -> Result<Fitted> {
    let sound: Vec<Vec3> = points.iter().copied().filter(|p| p.is_finite()).collect();
    checked(&sound)?;
    let (mut kept, strays) = parts::without_strays(&sound);
    let (low, high) = checked(&kept)?;
    let ground = parts::ground(&kept, high.z - low.z);
    let floor_m = |p: Vec3| ground.map_or(low.z, |g| g.height_m(p.truncate()));
    let height_m = high.z - floor_m(0.5 * (low + high));
    let standing: Vec<Vec3> = match ground {
        Some(g) => kept.iter().copied().filter(|p| g.above_m(*p) > g.low_m).collect(),
        None => kept.clone(),
    };
    let (_, top) = checked(&standing)?;
    let gap_m = (APART * (top.z - low.z)).max(APART_LEAST_M);
    if parts::is_parted(&standing, gap_m) {
        return Err(Error::new(format!("the cloud is in parts more than {gap_m:.1} m apart"))
            .remedy("cut one tree out of it, or use `larix forest` for all of them"));
    }
    let slices = stem::stem(&standing, floor_m(0.5 * (low + high)), height_m, seed);
    let root = match slices.first() {
        Some(lowest) => {
            let ahead =
                slices.get(8).or(slices.last()).map_or(Vec3::Z, |s| s.centre - lowest.centre);
            let lean = if ahead.z > 0.0 { ahead / ahead.z } else { Vec3::Z };
            let down = lowest.centre.z - floor_m(lowest.centre);
            let foot = lowest.centre - lean * down;
            foot.with_z(floor_m(foot).min(lowest.centre.z))
        }
        None => foot(&standing, ground, high.z - low.z),
    };
    let before = kept.len();
    if let Some(g) = ground {
        let near_stem = slices.first().map(|s| (s.radius_m + 0.05, s.centre));
        kept.retain(|p| {
            let is_stem = near_stem.is_some_and(|(reach, c)| {
                p.truncate().distance(c.truncate()) <= reach && g.above_m(*p) > 0.03
            });
            is_stem || g.above_m(*p) > g.low_m
        });
    }
    let left_out = before - kept.len();
    kept.iter_mut().for_each(|p| *p -= root);
    let (_, high) = checked(&kept)?;
    let start = start(species, &kept, root, high, &slices, detail, seed)?;
    let max_nodes = (detail.max_nodes as usize).clamp(40, 200_000);
    let skeleton = grown(species, &kept, high.z, start.led_by, &start, max_nodes)?;
    skeleton.check()?;
    let nodes = Nodes { position: skeleton.position.clone(), parent: skeleton.parent.clone() };
    let Fit { mean_m, p95_m, outside_length, outside_volume } =
        measure::fit(&kept, &trace::cones(&nodes, Some(&skeleton.radius_m)));
    let report = Report {
        led_by: start.led_by,
        points: points.len(),
        not_finite: points.len() - sound.len(),
        strays,
        ground: left_out,
        measured: kept.len(),
        height_m: skeleton.height_m(),
        stem_diameter_m: 2.0 * breast_radius(&skeleton),
        mean_m,
        p95_m,
        outside_beyond_m: OUTSIDE_M,
        outside_length,
        outside_volume,
    };
    Ok(Fitted { skeleton, root, report })
}

/// Refuses clouds that cannot be one tree; their bounds otherwise.
fn checked(points: &[Vec3]) -> Result<(Vec3, Vec3)> {
    let refuse = |why: String, remedy: &str| Err(Error::new(why).remedy(remedy.to_owned()));
    let (low, high) = bounds(points);
    let size = high - low;
    let n = points.len();
    let width_m = size.x.max(size.y);
    if n < LEAST_POINTS {
        return refuse(
            format!("a cloud of {n} points is no tree"),
            "give a cloud of one tree, with at least 20 points above the ground",
        );
    }
    if width_m > MOST_WIDTH_M {
        return refuse(
            format!("a cloud {width_m:.0} m wide is no single tree"),
            "cut one tree out of it, or use `larix forest` for all of them",
        );
    }
    if size.z < LEAST_HEIGHT_M {
        return refuse(
            format!("a cloud of {n} points {:.1} m high is no tree", size.z),
            "give a cloud of one tree, at least 0.3 m high, heights in metres",
        );
    }
    if size.z > *HEIGHTS_M.end() {
        return refuse(
            format!("a cloud {:.0} m high is no tree", size.z),
            "trees up to 130 m are fitted; look for strays far above or below",
        );
    }
    Ok((low, high))
}

/// Foot of a tree whose stem is not seen.
fn foot(points: &[Vec3], ground: Option<Ground>, height_m: f32) -> Vec3 {
    let low = bounds(points).0;
    let lowest: Vec<Vec3> =
        points.iter().copied().filter(|p| p.z <= low.z + 0.05 * height_m).collect();
    let mean = |of: &[Vec3]| of.iter().sum::<Vec3>() / of.len().max(1) as f32;
    let mut at = mean(&lowest);
    let is_narrow = lowest.iter().all(|p| p.truncate().distance(at.truncate()) < 0.08 * height_m);
    if !is_narrow || ground.is_some() {
        // Under the top, where a crown alone is seen.
        let top = low.z + height_m;
        let high: Vec<Vec3> =
            points.iter().copied().filter(|p| p.z >= top - 0.15 * height_m).collect();
        at = mean(&high).lerp(mean(points), 0.5);
    }
    at.with_z(ground.map_or(low.z, |g| g.height_m(at.truncate())))
}

/// The wood known before branches are traced.
fn start(
    species: &Species,
    points: &[Vec3],
    root: Vec3,
    high: Vec3,
    slices: &[stem::Slice],
    detail: Detail,
    seed: Seed,
) -> Result<Start> {
    let single = |led_by, nodes: Nodes, radius_m: Vec<f32>| {
        let axis = vec![0; radius_m.len()];
        Start { led_by, nodes, radius_m, axis }
    };
    if let Some(first) = slices.first() {
        let mut nodes = Nodes { position: vec![Vec3::ZERO], parent: vec![NO_PARENT] };
        let mut radius_m = vec![first.radius_m];
        for s in slices {
            let at = s.centre - root;
            let last = nodes.position.len() - 1;
            if at.distance(nodes.position[last]) > 0.02 && at.z > 0.0 {
                nodes.position.push(at);
                nodes.parent.push(last as u32);
                radius_m.push(s.radius_m);
            }
        }
        return Ok(single(Led::Stem, nodes, radius_m));
    }
    let lowest = points.iter().filter(|p| p.z <= 0.05 * high.z);
    let reach_m = 0.1 * high.z;
    let (at_foot, elsewhere) =
        lowest.fold(
            (0, 0),
            |(a, b), p| {
                if p.truncate().length() <= reach_m { (a + 1, b) } else { (a, b + 1) }
            },
        );
    if at_foot >= 3 && at_foot > 4 * elsewhere {
        let radius = 0.5 * species.size.stem_diameter_at(high.z);
        let nodes = Nodes {
            position: vec![Vec3::ZERO, Vec3::Z * 0.005 * high.z],
            parent: vec![NO_PARENT, 0],
        };
        return Ok(single(Led::Foot, nodes, vec![radius; 2]));
    }
    let crown = crown(points, high);
    let half = Detail { max_nodes: detail.max_nodes / 2, ..detail };
    let grown = grow::grow(species, Target::FromCrown(&crown), half, seed)?;
    Ok(Start {
        led_by: Led::Crown,
        nodes: Nodes { position: grown.position, parent: grown.parent },
        radius_m: grown.radius_m,
        axis: grown.axis,
    })
}

/// The points about the root as a crown to grow into.
fn crown(points: &[Vec3], high: Vec3) -> Crown {
    let apex = points
        .iter()
        .copied()
        .fold(high.with_x(0.0).with_y(0.0), |a, p| if p.z >= high.z { p } else { a });
    let mut heights: Vec<f32> = points.iter().map(|p| p.z).collect();
    heights.sort_unstable_by(f32::total_cmp);
    let low = heights.get(heights.len() / 20).copied().unwrap_or(0.0);
    let base_height_m = low.clamp(0.0, 0.8 * high.z);
    // The circle of the area seen from above, on cells that hold a few points each.
    let (from, to) = bounds(points);
    let cell_m = ((to - from).truncate().max_element() / 12.0).max(0.05);
    let cells: std::collections::BTreeSet<[i32; 2]> =
        points.iter().map(|p| (p.truncate() / cell_m).floor().as_ivec2().to_array()).collect();
    let area_sq = cells.len() as f32 * cell_m * cell_m;
    Crown {
        key: 1,
        root: Vec3::ZERO,
        apex,
        height_m: high.z,
        base_height_m,
        diameter_m: (2.0 * (area_sq / std::f32::consts::PI).sqrt()).max(0.05),
        spread_m: (to - from).truncate().max_element(),
        volume_cu_m: area_sq * (high.z - base_height_m),
        surface_sq_m: area_sq,
        is_understory: false,
        outline: Vec::new(),
        attractors: points.to_vec(),
        point_count: points.len() as u32,
        confidence: 1.0,
    }
}

/// Branches from the known wood into the points, and radii.
fn grown(
    species: &Species,
    points: &[Vec3],
    height_m: f32,
    led_by: Led,
    start: &Start,
    max_nodes: usize,
) -> Result<Skeleton> {
    let known = start.nodes.position.len();
    let stem = Nodes { position: start.nodes.position.clone(), parent: start.nodes.parent.clone() };
    let wood = Wood::new(trace::cones(&stem, Some(&start.radius_m)));
    let most = (20 * max_nodes).clamp(*VERTICES.start(), *VERTICES.end());
    let mut edge_m = FINEST_M.max(0.0005 * height_m);
    let mut free = thinned(points, edge_m);
    while free.len() > most {
        edge_m *= 1.3;
        free = thinned(points, edge_m);
    }
    // What lies on the stem or in it needs no branch.
    free.retain(|p| {
        wood.nearest(*p).is_none_or(|(cone, d)| {
            d > (BARK * cone.radius_m[0].max(cone.radius_m[1])).max(0.015).max(edge_m)
        })
    });
    let near = Points::new(&free);
    let mut gaps: Vec<f32> =
        free.iter().filter_map(|p| near.around(*p).nth(1)).map(|n| n.1).collect();
    gaps.sort_unstable_by(f32::total_cmp);
    let spacing_m = gaps.get(gaps.len() / 2).copied().unwrap_or(edge_m).max(edge_m);
    let mut vertices = start.nodes.position.clone();
    vertices.extend_from_slice(&free);
    let top_m = start.radius_m.last().copied().unwrap_or(0.05);
    let ways = graph::ways(&vertices, known, &near, &wood, 2.5 * spacing_m + 0.03 + BARK * top_m);
    let mut limits = trace::Bounds {
        max_nodes,
        step_m: (0.005 * height_m).clamp(0.03, 0.15).max(2.0 * spacing_m),
        spacing_m,
        finest_m: (1.5 * spacing_m).min(FINEST_WAY_M),
        limb_m: if led_by == Led::Stem { top_m } else { 0.5 * top_m },
        coarse_m: (0.04 * height_m).clamp(0.1, 0.8).max(4.0 * spacing_m),
    };
    // Few nodes are better spent on many coarse branches than on some fine ones.
    let mut nodes = stem.clone();
    for _ in 0..STEP_TRIES {
        let (traced, allowed_m) =
            trace::trace(&vertices, stem.clone(), &near, &wood, &ways, &limits);
        nodes = traced;
        if allowed_m <= 2.0 * limits.step_m {
            break;
        }
        limits.step_m = (1.5 * limits.step_m).max(0.6 * allowed_m);
    }
    let scaffold: Vec<u32> = (0..nodes.position.len())
        .map(|i| start.axis.get(i).copied().unwrap_or(polish::FREE))
        .collect();
    let (axis, order) = polish::axes(&nodes.position, &nodes.parent, &scaffold);
    let mut heir = vec![NO_PARENT; axis.len()];
    for i in 1..axis.len() {
        let parent = nodes.parent[i] as usize;
        if axis[parent] == axis[i] {
            heir[parent] = i as u32;
        }
    }
    trace::centre(&mut nodes, &start.radius_m, &free, &heir, limits.coarse_m);
    let radius_m = thickness(species, &nodes, &axis, start, height_m);
    let birth = vec![0; radius_m.len()];
    let (position, parent) = (nodes.position, nodes.parent);
    let dead = Vec::new();
    let mut tree = Skeleton { position, parent, radius_m, axis, order, birth, dead };
    tree.birth = births(&tree, &species.size);
    Ok(tree)
}

/// Radii: known ones as they are, the others by the pipe model in the ratio that it has to the
/// known ones where they begin.
fn thickness(
    species: &Species,
    nodes: &Nodes,
    axis: &[u32],
    start: &Start,
    height_m: f32,
) -> Vec<f32> {
    let growth = &species.growth;
    let mut pipes = Pipes::for_height(
        growth.pipe_exponent,
        growth.tip_radius_m,
        species.size.height_m,
        species.size.stem_diameter_m,
        height_m,
    );
    if start.led_by == Led::Stem {
        let at = start.nodes.position.iter().zip(&start.radius_m);
        let breast = at.rev().find(|(p, _)| p.z <= pipes.measured_at_m);
        pipes.stem_radius_m = breast.map_or(pipes.stem_radius_m, |(_, &r)| r);
        pipes.tip_radius_m = pipes.tip_radius_m.min(0.5 * pipes.stem_radius_m);
    }
    let is_stem: Vec<bool> = axis.iter().map(|&a| a == 0).collect();
    let piped = radii(&nodes.position, &nodes.parent, &is_stem, &pipes);
    let is_known = |i: usize| start.led_by != Led::Foot && i < start.radius_m.len();
    let mut factor = vec![1.0f32; piped.len()];
    let mut radius_m = vec![0.0f32; piped.len()];
    for i in 0..piped.len() {
        let parent = nodes.parent[i];
        if is_known(i) {
            factor[i] = (start.radius_m[i] / piped[i].max(1e-6)).min(1.0);
            radius_m[i] = start.radius_m[i];
        } else {
            factor[i] = factor.get(parent as usize).copied().unwrap_or(1.0);
            let tip = pipes.tip_radius_m.min(piped[i]);
            radius_m[i] = (piped[i] * factor[i]).max(tip);
        }
        if let Some(&most) = radius_m.get(parent as usize).filter(|_| parent != NO_PARENT) {
            radius_m[i] = radius_m[i].min(most);
        }
    }
    radius_m
}

/// Stem radius where its diameter is told.
fn breast_radius(skeleton: &Skeleton) -> f32 {
    let height_m = skeleton.height_m();
    let at_m = if height_m > 2.6 { super::radii::BREAST_HEIGHT_M } else { 0.1 * height_m };
    let stem = (0..skeleton.len()).filter(|&i| skeleton.axis[i] == 0);
    stem.take_while(|&i| skeleton.position[i].z <= at_m)
        .last()
        .and_then(|i| skeleton.radius_m.get(i).copied())
        .unwrap_or(0.0)
}

#[cfg(test)]
mod tests;
