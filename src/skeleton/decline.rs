//! A tree that weakens and dies (the categories of [`Condition`]): which branches are dry, and what
//! has broken off.
//!
//! Branches dry from below, where the light is least, with chance; a dry branch is dry to its
//! tips, and loses some of its twigs. An old dead tree has lost its top, its thin twigs and the
//! ends of its branches. Pure: the same skeleton, condition and seed give the same result.

use super::Skeleton;
use crate::seed::Seed;
use crate::species::state::Condition;

/// The skeleton in a condition.
pub fn in_condition(s: &Skeleton, condition: Condition, seed: Seed) -> Skeleton {
    let seed = seed.derive("decline", 0);
    match condition {
        Condition::Healthy | Condition::FreshDead => s.clone(),
        Condition::Weakened => dried(s, 0.12, seed),
        Condition::StronglyWeakened => dried(s, 0.42, seed),
        Condition::Dying => dried(s, 0.75, seed),
        Condition::OldDead => broken(s, seed),
    }
}

/// Share of a dry branch's twigs that have fallen.
const DRY_TWIGS_LOST: f32 = 0.45;

/// So large a share of the branches dead, the lower ones first.
fn dried(s: &Skeleton, share: f32, seed: Seed) -> Skeleton {
    let is_stem = s.is_stem();
    // The node in which each node's branch leaves the stem.
    let mut branch = vec![0u32; s.len()];
    let mut branches = Vec::new();
    let height_m = s.height_m().max(1e-6);
    for i in 1..s.len() {
        if is_stem[i] {
            continue;
        }
        let p = s.parent[i] as usize;
        if is_stem[p] {
            branch[i] = i as u32;
            let chance = seed.derive("branch", i as u64).draws().unit();
            branches.push((s.position[p].z / height_m + 0.9 * chance, i as u32));
        } else {
            branch[i] = branch[p];
        }
    }
    branches.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let count = (share * branches.len() as f32).round() as usize;
    let mut is_dry = vec![false; s.len()];
    for (_, root) in branches.iter().take(count) {
        is_dry[*root as usize] = true;
    }
    let mut out = s.clone();
    out.dead = (0..s.len()).map(|i| is_dry[branch[i] as usize]).collect();
    let lost = |i: usize| {
        let twig = out.dead[i] && s.order[i] >= 2;
        twig && seed.derive("twig", s.axis[i].into()).draws().unit() < DRY_TWIGS_LOST
    };
    let keep: Vec<bool> = (0..s.len()).map(|i| !lost(i)).collect();
    out.subset(&keep)
}

/// Dead for years.
fn broken(s: &Skeleton, seed: Seed) -> Skeleton {
    let is_stem = s.is_stem();
    // Within the crown, where the stem is thin.
    let base_m = s.crown_base_m();
    let top_m =
        base_m + (s.height_m() - base_m) * seed.derive("top", 0).draws().between(0.45, 0.85);
    // Nodes along each axis: the last of them break off.
    let axes = s.axes();
    let mut keep = vec![true; s.len()];
    for (k, axis) in axes.iter().enumerate() {
        let mut draws = seed.derive("axis", k as u64).draws();
        let held = match axis.order {
            0 => 1.0,
            1 => draws.between(0.1, 0.85),
            2 if draws.unit() < 0.35 => draws.between(0.2, 0.8),
            _ => 0.0,
        };
        let left = (held * axis.nodes.len() as f32).ceil() as usize;
        for &i in axis.nodes.iter().skip(left) {
            keep[i as usize] = false;
        }
    }
    // Something stands, however low the tree.
    let first = (1..s.len()).find(|&i| is_stem[i]);
    for (i, keep) in keep.iter_mut().enumerate().skip(1) {
        let is_above = s.position[i].z > top_m;
        *keep = Some(i) == first || (*keep && !is_above);
    }
    let mut out = s.clone();
    out.dead = vec![true; s.len()];
    out.subset(&keep)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::skeleton::{Detail, Target, grow};
    use crate::species::load;

    fn grown(name: &str) -> Skeleton {
        let target = Target::FromSpecies { height_m: None };
        grow(&load(name).unwrap(), target, Detail::FOREST, Seed::new(3)).unwrap()
    }

    #[test]
    fn every_condition_keeps_the_invariants_and_changes_no_place() {
        for name in ["larix_sibirica", "betula_pendula", "corylus_avellana", "table3/05"] {
            let healthy = grown(name);
            for condition in Condition::ALL {
                for seed in 1..4 {
                    let s = in_condition(&healthy, condition, Seed::new(seed));
                    s.check().unwrap_or_else(|e| panic!("{name}, {condition:?}: {e}"));
                    assert!(s.len() >= 2, "{name}: something stands");
                    assert!(s.position.iter().all(|p| healthy.position.contains(p)));
                    assert_eq!(s, in_condition(&healthy, condition, Seed::new(seed)));
                }
            }
            assert_eq!(in_condition(&healthy, Condition::Healthy, Seed::new(1)), healthy);
        }
    }

    #[test]
    fn branches_dry_as_the_scale_says_and_the_lower_first() {
        let healthy = grown("picea_abies");
        let mut before = 0.0;
        for (condition, least, most) in [
            (Condition::Weakened, 0.0, 0.25),
            (Condition::StronglyWeakened, 0.25, 0.667),
            (Condition::Dying, 0.667, 0.95),
        ] {
            let s = in_condition(&healthy, condition, Seed::new(1));
            let is_stem = s.is_stem();
            let roots: Vec<usize> =
                (1..s.len()).filter(|&i| !is_stem[i] && is_stem[s.parent[i] as usize]).collect();
            let dry: Vec<usize> = roots.iter().copied().filter(|&i| s.dead[i]).collect();
            let share = dry.len() as f32 / roots.len() as f32;
            assert!(share > before && share >= least && share <= most, "{condition:?}: {share}");
            before = share;
            let mean = |all: &[usize]| {
                all.iter().map(|&i| s.position[i].z).sum::<f32>() / all.len() as f32
            };
            assert!(mean(&dry) < mean(&roots), "the lower first");
            let bears = s.bears_leaves(0.01);
            assert!((0..s.len()).all(|i| !(s.dead[i] && bears[i])), "dry branches are bare");
            assert!(bears.iter().any(|b| *b), "some live");
        }
    }

    #[test]
    fn an_old_dead_tree_is_broken_and_bears_nothing() {
        for name in ["pinus_sylvestris", "betula_pendula"] {
            let healthy = grown(name);
            let s = in_condition(&healthy, Condition::OldDead, Seed::new(2));
            let (base_m, height_m) = (healthy.crown_base_m(), healthy.height_m());
            let most_m = base_m + 0.85 * (height_m - base_m);
            assert!(s.height_m() > base_m && s.height_m() <= most_m, "{name}: {}", s.height_m());
            assert!(s.length_m() < 0.5 * healthy.length_m());
            assert!(s.bears_leaves(1.0).iter().all(|b| !b));
        }
    }
}
