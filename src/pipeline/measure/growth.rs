//! How well trees fill their crowns, against seconds, over nodes, D, d_i, d_k and the voxel.

use std::collections::{BTreeMap, BTreeSet};

use glam::Vec3;
use rayon::prelude::*;

use super::super::fit::total_m;
use super::Bench;
use crate::crown::{self, Crown, CrownOptions};
use crate::diagnostic::Result;
use crate::report::document::{Front, Point, Quantity, Truth};
use crate::skeleton::{self, Detail, Skeleton, Target};
use crate::species::Species;
use crate::voxel;

/// Trees grown, in full and quick.
const TREES: [usize; 2] = [24, 6];
/// Edge of the voxels whose centres of mass stand for the points of a tree, metres.
const FINEST_M: f32 = 0.2;
/// Edges of voxels that are tried, metres.
const VOXELS_M: [f32; 4] = [0.25, 0.5, 1.0, 2.0];
/// Nodes of a tree of a forest.
const USUAL_NODES: u32 = 833;

/// A tree to be grown: its species, the crown as the setting shows it, the points it should reach.
struct Wanted<'a> {
    species: &'a Species,
    crown: Crown,
    points: Vec<Vec3>,
}

pub(super) fn fronts(bench: &mut Bench<'_>) -> Result<Vec<Front>> {
    let usual_m = voxel::choose_size_m(bench.place.density_per_m2, 4.0);
    let sizes_m = [&[FINEST_M, usual_m][..], &VOXELS_M].concat();
    let all = sizes_m.iter().map(|&m| seen(bench, m)).collect::<Result<Vec<_>>>()?;
    let all = same_trees(all);
    let finest = &all[0];
    if finest.is_empty() {
        bench.warnings.push("no trees were found: the filling of crowns is not measured".into());
        return Ok(Vec::new());
    }
    let chosen = chosen(finest, TREES[usize::from(bench.job.is_quick)]);
    let survey = &bench.place.survey;
    let species_of: BTreeMap<[u32; 3], usize> =
        survey.trees.iter().map(|t| place(&t.crown)).zip(survey.species.iter().copied()).collect();
    let wanted = |crowns: &[Crown]| -> Vec<Wanted<'_>> {
        let of = |&i: &usize| {
            let points = finest[i].attractors.iter().map(|p| *p - crowns[i].root).collect();
            let species = species_of.get(&place(&finest[i])).copied().unwrap_or(0);
            Wanted { species: &bench.job.species[species], crown: crowns[i].clone(), points }
        };
        chosen.iter().map(of).collect()
    };
    let usual = wanted(&all[1]);
    let mut points = Vec::new();
    for nodes in [200, 400, USUAL_NODES, 2_500, 8_000] {
        let is_default = nodes == USUAL_NODES;
        let of = ("nodes", format!("{nodes} nodes"), is_default);
        points.push(point(bench, of, &usual, nodes, |_| {})?);
    }
    for factor in [0.5, 0.71, 1.41, 2.0] {
        type Change = fn(&mut Species, f32);
        let changes: [(&str, Change); 3] = [
            ("D", |s, f| s.growth.step *= f),
            ("d_i", |s, f| s.growth.influence *= f),
            ("d_k", |s, f| s.growth.kill *= f),
        ];
        for (name, change) in changes {
            let of = (name, format!("{name} × {factor}"), false);
            points.push(point(bench, of, &usual, USUAL_NODES, |s| change(s, factor))?);
        }
    }
    for (size_m, crowns) in VOXELS_M.iter().zip(&all[2..]) {
        let of = ("voxel", format!("voxel {size_m} m"), false);
        points.push(point(bench, of, &wanted(crowns), USUAL_NODES, |_| {})?);
    }
    let note = format!(
        "Mean distance from the points of {} trees, thinned to {FINEST_M} m, to the wood grown into \
         their crowns. The default has voxels of {usual_m:.2} m and {USUAL_NODES} nodes. D, d_i and d_k are \
         of the rule files, for the look of branches: longer steps that leave more out reach farther with \
         as few nodes, but in straighter, sparser twigs.",
        chosen.len()
    );
    let front = Front {
        id: "fill".into(),
        stage: "skeleton".into(),
        title: "Crown fill: nodes, D, d_i, d_k, voxel".into(),
        error: Quantity::new("points to wood, mean", "m"),
        truth: Truth::Cloud,
        cost: None,
        note,
        is_by_group: false,
        points,
        verdict: String::new(),
    };
    Ok(vec![front.marked()])
}

/// What a tree is known by whatever the voxels: its highest point.
fn place(crown: &Crown) -> [u32; 3] {
    crown.apex.to_array().map(f32::to_bits)
}

/// Of lists of crowns the trees that are in each of them, in one order: coarse voxels may merge a
/// tree's points into too little for a crown.
fn same_trees(mut all: Vec<Vec<Crown>>) -> Vec<Vec<Crown>> {
    let places = |list: &Vec<Crown>| list.iter().map(place).collect::<BTreeSet<_>>();
    let shared = all.iter().map(places).reduce(|a, b| &a & &b).unwrap_or_default();
    for list in &mut all {
        list.retain(|c| shared.contains(&place(c)));
        list.sort_by_key(place);
        list.dedup_by_key(|c| place(c));
    }
    all
}

/// The crowns with their points gathered in voxels of this edge.
fn seen(bench: &Bench<'_>, size_m: f32) -> Result<Vec<Crown>> {
    let classified = &bench.place.classified;
    let terrain =
        crate::terrain::build(classified, &Default::default())?.into_value(&mut Vec::new());
    let crowns = crown::detect(classified, &terrain, size_m, &CrownOptions::default())?;
    Ok(crowns.into_value(&mut Vec::new()))
}

/// Trees from the lowest to the highest, in even steps.
fn chosen(crowns: &[Crown], count: usize) -> Vec<usize> {
    let mut by_height: Vec<usize> = (0..crowns.len()).collect();
    by_height.sort_by(|&a, &b| crowns[a].height_m.total_cmp(&crowns[b].height_m));
    let count = count.min(crowns.len());
    (0..count).map(|k| by_height[(2 * k + 1) * crowns.len() / (2 * count)]).collect()
}

fn point(
    bench: &Bench<'_>,
    (group, setting, is_default): (&str, String, bool),
    wanted: &[Wanted<'_>],
    max_nodes: u32,
    change: impl Fn(&mut Species) + Sync,
) -> Result<Point> {
    let detail = Detail { max_nodes, attractor_spacing_m: None };
    let grow = |w: &Wanted<'_>| {
        let mut species = w.species.clone();
        change(&mut species);
        skeleton::grow(&species, Target::FromCrown(&w.crown), detail, bench.seed())
    };
    let all = |()| wanted.par_iter().map(grow).collect::<Result<Vec<Skeleton>>>();
    let (trees, time) = bench.timed(|| (), all)?;
    let distances: Vec<(f64, usize)> = trees
        .par_iter()
        .zip(wanted)
        .map(|(tree, w)| (total_m(tree, &w.points), w.points.len()))
        .collect();
    let (sum, count) = distances.iter().fold((0.0, 0), |(s, n), d| (s + d.0, n + d.1));
    let error = sum / count.max(1) as f64;
    let group = group.into();
    Ok(Point { group, setting, error, cost: None, time, is_default, is_on_front: false })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn trees_that_a_list_lacks_are_left_out_of_all() {
        let crown = |x: f32, root_m: f32| Crown {
            key: 0,
            root: Vec3::new(x, root_m, 0.0),
            apex: Vec3::new(x, 0.0, 10.0),
            height_m: 10.0,
            base_height_m: 2.0,
            diameter_m: 3.0,
            spread_m: 3.0,
            volume_cu_m: 20.0,
            surface_sq_m: 30.0,
            is_understory: false,
            outline: Vec::new(),
            attractors: Vec::new(),
            point_count: 9,
            confidence: 1.0,
        };
        let all = [&[1.0, 2.0, 3.0][..], &[3.0, 2.0], &[4.0, 3.0, 2.0]];
        let all = all
            .iter()
            .enumerate()
            .map(|(k, xs)| xs.iter().map(|x| crown(*x, 0.1 * k as f32)).collect::<Vec<_>>());
        for list in same_trees(all.collect()) {
            assert_eq!(list.iter().map(|c| c.apex.x).collect::<Vec<_>>(), [2.0, 3.0]);
        }
        assert!(same_trees(vec![vec![crown(1.0, 0.0)], Vec::new()])[0].is_empty());
    }
}
