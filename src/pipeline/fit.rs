//! How far the points of trees lie from the wood that was grown for them.

use glam::Vec3;
use rayon::prelude::*;
use rstar::RTree;

use super::survey::Survey;
use crate::scene::Scene;
use crate::skeleton::Skeleton;

/// Wood is looked at this often along its length, metres.
const SAMPLE_M: f32 = 0.05;
/// Trees that are looked at, evenly over all; more would tell no more.
const MOST_TREES: usize = 400;

/// Sum of the distances from points to the middle of the wood, metres; in the tree's own place.
pub(super) fn total_m(tree: &Skeleton, points: &[Vec3]) -> f64 {
    placed_m(tree, points, |p| p)
}

fn placed_m(tree: &Skeleton, points: &[Vec3], place: impl Fn(Vec3) -> Vec3) -> f64 {
    let nodes: Vec<Vec3> = tree.position.iter().map(|p| place(*p)).collect();
    let mut wood: Vec<[f32; 3]> = nodes.iter().map(Vec3::to_array).collect();
    for i in 1..nodes.len() {
        let (from, to) = (nodes[tree.parent[i] as usize], nodes[i]);
        let steps = (from.distance(to) / SAMPLE_M).ceil() as usize;
        wood.extend((1..steps).map(|k| from.lerp(to, k as f32 / steps as f32).to_array()));
    }
    let wood = RTree::bulk_load(wood);
    let near = |p: &Vec3| wood.nearest_neighbor(p.to_array()).map(|q| p.distance(Vec3::from(*q)));
    points.iter().filter_map(near).map(f64::from).sum()
}

/// Mean distance from the points of the trees of a scene, one instance a tree and one prototype a
/// skeleton, to the wood of their models where they stand; `None` without points.
pub(super) fn in_place_m(survey: &Survey, scene: &Scene, skeletons: &[Skeleton]) -> Option<f64> {
    let every = scene.instances.len().div_ceil(MOST_TREES).max(1);
    // Instances are told from trees by their ids, as they stand model by model.
    let tree_of: std::collections::BTreeMap<&str, usize> =
        survey.trees.iter().enumerate().map(|(i, t)| (t.id.as_str(), i)).collect();
    let chosen: Vec<_> = scene.instances.iter().step_by(every).collect();
    let sums: Vec<(f64, usize)> = chosen
        .into_par_iter()
        .filter_map(|instance| {
            let tree = &survey.trees[*tree_of.get(instance.facts.id.as_str())?];
            let skeleton = skeletons.get(instance.prototype as usize)?;
            let points = &tree.crown.attractors;
            Some((placed_m(skeleton, points, |p| instance.place(p)), points.len()))
        })
        .collect();
    let (sum, count) = sums.iter().fold((0.0, 0), |(s, n), d| (s + d.0, n + d.1));
    (count > 0).then(|| sum / count as f64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::skeleton::NO_PARENT;

    #[test]
    fn points_beside_a_pole_are_as_far_as_they_stand_off() {
        let pole = Skeleton {
            position: vec![Vec3::ZERO, Vec3::Z * 10.0],
            parent: vec![NO_PARENT, 0],
            ..Skeleton::default()
        };
        let points = [Vec3::new(0.3, 0.0, 4.0), Vec3::new(0.0, -0.5, 7.02), Vec3::Z * 11.0];
        assert!((total_m(&pole, &points) - 1.8).abs() < 2e-3);
        let doubled = placed_m(&pole, &points[2..], |p| p * 2.0);
        assert!(doubled < 0.026, "{doubled}");
    }
}
