//! The skeletons of all models, each grown among the neighbours of its tree.

use glam::{Vec2, Vec3};
use rayon::prelude::*;
use rstar::RTree;
use rstar::primitives::GeomWithData;

use super::budget::Plan;
use super::forest::ForestJob;
use super::survey::Survey;
use crate::crown::Crown;
use crate::diagnostic::Result;
use crate::mesh::crown_diameter_m;
use crate::report::{ErrorMeasure, Outcome, Recorder};
use crate::scene::sharing::Model;
use crate::seed::Seed;
use crate::skeleton::surroundings::{Neighbour, Surroundings};
use crate::skeleton::{self, Detail, Skeleton, Target, decline};

/// Skeletons of all models, and what each has lost of its width by its condition, metres.
pub(super) fn grow(
    job: &ForestJob,
    survey: &Survey,
    models: &[Model],
    plans: &[Plan],
    run: &mut Recorder,
) -> Result<(Vec<Skeleton>, Vec<f32>)> {
    run.stage("skeleton", |_| {
        let roots = RTree::bulk_load(
            (0..survey.trees.len())
                .map(|i| GeomWithData::new(survey.trees[i].crown.root.truncate().to_array(), i))
                .collect(),
        );
        let widest_m = survey.trees.iter().map(|t| t.crown.diameter_m).fold(0.0, f32::max);
        let grown: Vec<(Skeleton, f32)> = models
            .par_iter()
            .zip(plans)
            .map(|(m, plan)| {
                let seed = job.survey.seed.derive("tree", survey.trees[m.exemplar].crown.key);
                let foliage = job.foliage.of(&job.survey.species[m.species]);
                let detail = job.wood.detail(plan.triangles, foliage);
                let whole = grow_one(job, survey, &roots, widest_m, m, detail, seed)?;
                let kind = job.survey.species[m.species].kind;
                let left = decline::in_condition(&whole, kind, job.state.condition, seed);
                let thin_m = job.survey.species[m.species].foliage.bearing_radius_m;
                let shed_m = (crown_m(&whole, thin_m) - crown_m(&left, thin_m)).max(0.0);
                Ok((left, shed_m))
            })
            .collect::<Result<_>>()?;
        let (skeletons, shed_m): (Vec<_>, Vec<_>) = grown.into_iter().unzip();
        let nodes = skeletons.iter().map(Skeleton::len).sum();
        let attractors: usize =
            models.iter().map(|m| survey.trees[m.exemplar].crown.attractors.len()).sum();
        let mut outcome = Outcome::items(attractors, "attractors", nodes, "nodes");
        let distances: Vec<(f64, usize)> = models
            .par_iter()
            .zip(&skeletons)
            .map(|(m, s)| fill_distance(s, &survey.trees[m.exemplar].crown))
            .collect();
        let (sum, count) = distances.iter().fold((0.0, 0), |(s, n), d| (s + d.0, n + d.1));
        if count > 0 {
            let mean = sum / count as f64;
            outcome = outcome.error(ErrorMeasure::new("crown point to wood, mean", mean, "m"));
        }
        Ok(((skeletons, shed_m), outcome))
    })
}

/// Diameter of what bears leaves, or of all where nothing does.
fn crown_m(skeleton: &Skeleton, bearing_radius_m: f32) -> f32 {
    let bears = skeleton.bears_leaves(bearing_radius_m);
    let bears_none = !bears.contains(&true);
    let places = skeleton.position.iter().zip(bears).filter(|(_, bears)| *bears || bears_none);
    crown_diameter_m(&places.map(|(p, _)| *p).collect::<Vec<_>>())
}

fn grow_one(
    job: &ForestJob,
    survey: &Survey,
    roots: &Roots,
    widest_m: f32,
    model: &Model,
    detail: Detail,
    seed: Seed,
) -> Result<Skeleton> {
    let crown = &survey.trees[model.exemplar].crown;
    let species = &job.survey.species[model.species];
    let target = Target::FromCrown(crown);
    // A model that several trees share stands in no one place.
    if model.members.len() > 1 {
        return skeleton::grow(species, target, detail, seed);
    }
    let ground = |p: Vec2| survey.terrain.height_at(p + crown.root.truncate()) - crown.root.z;
    let around = Surroundings {
        ground: Some(&ground),
        neighbours: neighbours(survey, roots, widest_m, model.exemplar),
        ..Surroundings::none()
    };
    skeleton::grow_among(species, target, detail, &around, seed)
}

/// Horizontal places of all roots, with the numbers of their trees.
type Roots = RTree<GeomWithData<[f32; 2], usize>>;

/// The trees whose crowns may touch that of tree `i`, in its own coordinates; `widest_m` is the
/// greatest crown diameter of all.
fn neighbours(survey: &Survey, roots: &Roots, widest_m: f32, i: usize) -> Vec<Neighbour> {
    let own = &survey.trees[i].crown;
    let reach_m = 0.5 * (own.diameter_m + widest_m);
    let mut near: Vec<usize> = roots
        .locate_within_distance(own.root.truncate().to_array(), reach_m * reach_m)
        .map(|r| r.data)
        .filter(|&k| k != i)
        .collect();
    near.sort_unstable();
    near.into_iter()
        .map(|k| &survey.trees[k].crown)
        .filter(|c| c.root.truncate().distance(own.root.truncate()) > 0.1)
        .map(|c| Neighbour {
            root: c.root - own.root,
            height_m: c.height_m,
            crown_base_m: c.base_height_m,
            crown_radius_m: 0.5 * c.diameter_m,
        })
        .collect()
}

/// Sum of the distances from a crown's points to the nearest node, and their count.
fn fill_distance(skeleton: &Skeleton, crown: &Crown) -> (f64, usize) {
    let nodes: Vec<[f32; 3]> =
        skeleton.position.iter().map(|p| (*p + crown.root).to_array()).collect();
    let tree = RTree::bulk_load(nodes);
    let sum = crown
        .attractors
        .iter()
        .filter_map(|a| {
            tree.nearest_neighbor(a.to_array()).map(|n| f64::from(a.distance(Vec3::from(*n))))
        })
        .sum();
    (sum, crown.attractors.len())
}
