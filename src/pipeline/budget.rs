//! A scene's triangles shared out among its models.

use super::forest::ForestJob;
use super::survey::Survey;
use super::view;
use crate::mesh::TreeMesh;
use crate::scene::sharing::Model;

/// Fewest triangles that a model with a crown of its own is given.
pub(super) const LEAST_TRIANGLES: usize = 200;
/// Most that one in its coarsest form has.
const MOST_COARSEST: usize = 80;
/// Share of `--scene-triangles` below which it is told what holds trees back.
const UNSPENT: f64 = 0.8;

/// How a model is meshed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Plan {
    /// At most.
    pub triangles: usize,
    /// Whether the roundness of its wood gives way to that.
    pub is_rough: bool,
    /// Two cones and a cylinder stand for it.
    pub is_coarsest: bool,
    pub bound: Bound,
}

/// What says how many triangles a tree may have.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Bound {
    Triangles,
    Scene,
    Tolerance,
}

impl Bound {
    /// What to do for more than a tree has; `needed`: about as many as are wanted, where that is known.
    pub fn remedy(self, needed: Option<f32>) -> String {
        match (self, needed) {
            (Bound::Triangles, Some(needed)) => format!("give about {needed} --triangles"),
            (Bound::Triangles, None) => "give more --triangles".to_owned(),
            (Bound::Scene, _) => "give more --scene-triangles".to_owned(),
            (Bound::Tolerance, _) => "give a smaller --tolerance".to_owned(),
        }
    }
}

impl Plan {
    pub fn of(triangles: usize) -> Plan {
        Plan { triangles, is_rough: false, is_coarsest: false, bound: Bound::Triangles }
    }

    const COARSEST: Plan = Plan {
        triangles: LEAST_TRIANGLES,
        is_rough: false,
        is_coarsest: true,
        bound: Bound::Scene,
    };
}

/// How each model is meshed by the triangles that are given.
pub(super) fn plans(job: &ForestJob, survey: &Survey, models: &[Model]) -> Vec<Plan> {
    let Some(total) = job.shared_by_size() else {
        return vec![Plan::of(job.triangles); models.len()];
    };
    let size = |m: &Model| {
        let crown = &survey.trees[m.exemplar].crown;
        (crown.height_m.max(crown.diameter_m), m.members.len())
    };
    let sizes: Vec<(f32, usize)> = models.iter().map(size).collect();
    shared_out(&sizes, total, job.triangles.max(LEAST_TRIANGLES), job.forms().is_empty())
}

/// Triangles of a scene shared out among models by their size (and trees). Where each cannot have as
/// many as a crown takes, as few of the smallest as it takes are in their coarsest form, if they
/// may be.
fn shared_out(
    sizes: &[(f32, usize)],
    total: usize,
    most: usize,
    may_be_coarsest: bool,
) -> Vec<Plan> {
    let mut small: Vec<usize> = (0..sizes.len()).collect();
    small.sort_by(|&a, &b| sizes[a].0.total_cmp(&sizes[b].0));
    let mut least: usize = sizes.iter().map(|s| s.1 * LEAST_TRIANGLES).sum();
    let is_too_many = |&&k: &&usize| {
        let is = may_be_coarsest && least > total;
        least -= if is { sizes[k].1 * (LEAST_TRIANGLES - MOST_COARSEST) } else { 0 };
        is
    };
    let coarsest = small.iter().take_while(is_too_many).count();
    let (few, rest) = small.split_at(coarsest);
    let held = few.iter().map(|&k| sizes[k].1 * MOST_COARSEST).sum();
    let of: Vec<(f32, usize)> = rest.iter().map(|&k| sizes[k]).collect();
    let given = view::shared_budget(&of, total.saturating_sub(held), [LEAST_TRIANGLES, most]);
    let mut plans = vec![Plan::COARSEST; sizes.len()];
    for (&k, triangles) in rest.iter().zip(given) {
        let bound = if triangles < most { Bound::Scene } else { Bound::Triangles };
        plans[k] = Plan { bound, ..Plan::of(triangles) };
    }
    plans
}

/// What to say where all trees together take more triangles than they may, or leave many unspent as no model
/// may have more.
pub(super) fn off_budget(
    job: &ForestJob,
    models: &[Model],
    plans: &[Plan],
    meshes: &[Vec<TreeMesh>],
) -> Option<String> {
    let total = job.shared_by_size()?;
    let finest = meshes.iter().filter_map(|of_model| of_model.first());
    let taken = models.iter().zip(finest).map(|(m, mesh)| m.members.len() * mesh.triangles());
    let (taken, trees) =
        (taken.sum::<usize>(), models.iter().map(|m| m.members.len()).sum::<usize>());
    let told = format!("--scene-triangles {total}: {trees} trees take {taken}");
    if taken > total {
        let why = match job.forms().is_empty() {
            true => "two cones and a cylinder are the coarsest form of any".into(),
            false => format!("no finest form has fewer than about {LEAST_TRIANGLES}"),
        };
        return Some(format!("{told}, for {why}; give more, or fewer trees (--clip, --camera)"));
    }
    let most = job.triangles;
    let is_held = !plans.is_empty() && plans.iter().all(|p| p.triangles >= most && !p.is_coarsest);
    let is_unspent = is_held && (taken as f64) < UNSPENT * total as f64;
    is_unspent.then(|| format!("{told}, as no model has more than {most}; give more --triangles"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_scene_s_triangles_suffice_for_the_smallest_in_their_coarsest_form() {
        let sizes: Vec<(f32, usize)> = (0..40).map(|k| (3.0 + k as f32, 1 + k % 5)).collect();
        let trees: usize = sizes.iter().map(|s| s.1).sum();
        let taken = |plans: &[Plan]| -> usize {
            let one = |p: &Plan| if p.is_coarsest { MOST_COARSEST } else { p.triangles };
            plans.iter().zip(&sizes).map(|(p, s)| s.1 * one(p)).sum()
        };
        let coarsest = |plans: &[Plan]| plans.iter().filter(|p| p.is_coarsest).count();
        let mut before = sizes.len();
        for each in [80, 100, 150, 199, 200, 230, 2_000] {
            let plans = shared_out(&sizes, each * trees, 5_000, true);
            let is_spent = (each * trees - 5 * 120..=each * trees).contains(&taken(&plans));
            assert!(is_spent, "{each}: {}", taken(&plans));
            let few = coarsest(&plans);
            assert!(plans[..few].iter().all(|p| p.is_coarsest), "the smallest");
            assert!(few <= before && (few == 0) == (each >= 200), "{each}: {few} after {before}");
            before = few;
            // One less would be too many.
            if few > 0 {
                assert!(taken(&plans) + 120 * sizes[few - 1].1 > each * trees, "{each}");
            }
            assert_eq!(coarsest(&shared_out(&sizes, each * trees, 5_000, false)), 0);
        }
        assert_eq!(coarsest(&shared_out(&sizes, trees, 5_000, true)), sizes.len());
        assert!(shared_out(&[], 1_000, 5_000, true).is_empty());
    }
}
