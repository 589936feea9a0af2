//! A tree that weakens and dies (the categories of [`Condition`]): which branches are dry, and what
//! has broken off.
//!
//! Conifers dry branch by branch from the foot of the crown, where the light is least, broadleaved trees
//! from the top and from the ends of their limbs; both with chance. What is dry is so to its tips, and
//! loses some of its twigs. An old dead tree has lost its top, its thin twigs and the ends of its branches: those of
//! conifers, in which resin is, last for longer. Pure: the same arguments give the same result.

use super::{Axis, Skeleton};
use crate::seed::{Draws, Seed};
use crate::species::model::Kind;
use crate::species::state::Condition;

/// The skeleton in a condition.
pub fn in_condition(s: &Skeleton, kind: Kind, condition: Condition, seed: Seed) -> Skeleton {
    let seed = seed.derive("decline", 0);
    let wood = if kind == Kind::Conifer { &CONIFER } else { &BROADLEAF };
    match condition {
        Condition::Healthy => s.clone(),
        Condition::Weakened => dried(s, 0.12, wood, seed),
        Condition::StronglyWeakened => dried(s, 0.42, wood, seed),
        Condition::Dying => dried(s, 0.75, wood, seed),
        // What died this year was killed within it, as by beetles, more often than it had been dying for long: its
        // leaves hang, dry, on more of the crown, and fall all over it.
        Condition::FreshDead => {
            dried(s, 0.55, &Decline { later: AT_ONCE * wood.later, ..*wood }, seed)
        }
        Condition::OldDead => broken(s, wood, seed),
    }
}

/// How a kind of tree dies.
struct Decline {
    /// How much later than one at the crown's foot a branch at its top dries, over the span of chance; below
    /// 0 the top is first.
    later: f32,
    /// Whether the ends of limbs and each of their branches dry for themselves.
    by_ends: bool,
    /// How much of the crown's height stands when the top has broken off.
    stands: [f32; 2],
    /// How much of its length is left of a branch; of how many side branches anything is, and how much.
    branch: [f32; 2],
    sides: f32,
    side: [f32; 2],
}

const CONIFER: Decline = Decline {
    later: 2.2,
    by_ends: false,
    stands: [0.6, 0.97],
    branch: [0.25, 1.0],
    sides: 0.55,
    side: [0.3, 0.95],
};
const BROADLEAF: Decline = Decline {
    later: -0.7,
    by_ends: true,
    stands: [0.45, 0.85],
    branch: [0.1, 0.85],
    sides: 0.35,
    side: [0.2, 0.8],
};

/// By how much less than that of one that weakens for years the crown of a tree killed at once dries in order.
const AT_ONCE: f32 = 0.5;
/// Share of a dry branch's twigs that have fallen.
const DRY_TWIGS_LOST: f32 = 0.45;

/// So large a share of the branches dead.
fn dried(s: &Skeleton, share: f32, wood: &Decline, seed: Seed) -> Skeleton {
    let is_stem = s.is_stem();
    let base_m = s.crown_base_m();
    let crown_m = (s.height_m() - base_m).max(1e-6);
    let mut branches = Vec::new();
    let axes = s.axes();
    for axis in axes.iter() {
        let of_limb = wood.by_ends && axis.order == 1;
        let begins = match axis.order {
            1 if of_limb => axis.nodes.get(axis.nodes.len() / 2),
            1 => axis.nodes.first(),
            2 if wood.by_ends => axis.nodes.first(),
            _ => None,
        };
        let Some(&i) = begins.filter(|i| !is_stem[**i as usize]) else { continue };
        let chance = seed.derive("branch", u64::from(i)).draws().unit();
        let up = (s.position[i as usize].z - base_m) / crown_m;
        branches.push((wood.later * up + chance, i));
    }
    branches.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    // What springs from a dry branch is dry, too: the fewest branches that leave so many dry.
    let wanted = (share * branches.len() as f32).round() as usize;
    let dead_of = |count: usize| {
        let mut dead = vec![false; s.len()];
        branches[..count].iter().for_each(|(_, i)| dead[*i as usize] = true);
        for i in 1..s.len() {
            dead[i] = !is_stem[i] && (dead[i] || dead[s.parent[i] as usize]);
        }
        dead
    };
    let dry = |count: usize| {
        let dead = dead_of(count);
        branches.iter().filter(|(_, i)| dead[*i as usize]).count()
    };
    let (mut low, mut high) = (0, branches.len());
    while low < high {
        let middle = usize::midpoint(low, high);
        if dry(middle) < wanted { low = middle + 1 } else { high = middle }
    }
    let mut out = s.clone();
    out.dead = dead_of(low);
    let lost = |i: usize| {
        let twig = out.dead[i] && s.order[i] >= 2;
        twig && seed.derive("twig", s.axis[i].into()).draws().unit() < DRY_TWIGS_LOST
    };
    let keep: Vec<bool> = (0..s.len()).map(|i| !lost(i)).collect();
    out.subset(&keep)
}

/// Sine of the slope from which on a side branch hangs, and how much less of such a one is left: what hangs
/// is thin and sways until it breaks.
const HANGS: f32 = 0.6;
const HANGING: f32 = 0.25;

/// Dead for years.
fn broken(s: &Skeleton, wood: &Decline, seed: Seed) -> Skeleton {
    let is_stem = s.is_stem();
    // Within the crown, where the stem is thin.
    let base_m = s.crown_base_m();
    let stands = within(wood.stands, &mut seed.derive("top", 0).draws());
    let top_m = base_m + (s.height_m() - base_m) * stands;
    // Nodes along each axis: the last of them break off.
    let axes = s.axes();
    let mut keep = vec![true; s.len()];
    for (k, axis) in axes.iter().enumerate() {
        let mut draws = seed.derive("axis", k as u64).draws();
        let held = match axis.order {
            0 => 1.0,
            1 => within(wood.branch, &mut draws),
            2 if draws.unit() < wood.sides => {
                let held = within(wood.side, &mut draws);
                if falls(s, &axis) > HANGS { HANGING * held } else { held }
            }
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

/// How much lower an axis ends than it begins, over the way between.
fn falls(s: &Skeleton, axis: &Axis<'_>) -> f32 {
    let (Some(base), Some(&tip)) = (axis.base, axis.nodes.last()) else { return 0.0 };
    let way = s.position[base as usize] - s.position[tip as usize];
    way.z / way.length().max(1e-6)
}

fn within([low, high]: [f32; 2], draws: &mut Draws) -> f32 {
    draws.between(low, high)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::skeleton::{Detail, Target, grow};
    use crate::species::load;

    fn grown(name: &str) -> (Skeleton, Kind) {
        let target = Target::FromSpecies { height_m: None };
        let species = load(name).unwrap();
        (grow(&species, target, Detail::FOREST, Seed::new(3)).unwrap(), species.kind)
    }

    #[test]
    fn every_condition_keeps_the_invariants_and_changes_no_place() {
        for name in ["larix_sibirica", "betula_pendula", "corylus_avellana", "table3/05"] {
            let (healthy, kind) = grown(name);
            for condition in Condition::ALL {
                for seed in 1..4 {
                    let s = in_condition(&healthy, kind, condition, Seed::new(seed));
                    s.check().unwrap_or_else(|e| panic!("{name}, {condition:?}: {e}"));
                    assert!(s.len() >= 2, "{name}: something stands");
                    assert!(s.position.iter().all(|p| healthy.position.contains(p)));
                    assert_eq!(s, in_condition(&healthy, kind, condition, Seed::new(seed)));
                }
            }
            assert_eq!(in_condition(&healthy, kind, Condition::Healthy, Seed::new(1)), healthy);
        }
    }

    /// Dry strings straight down are what no tree keeps.
    #[test]
    fn whips_of_an_old_dead_tree_hang_no_longer_than_stubs() {
        let (healthy, kind) = grown("larix_decidua");
        let mut hung = 0;
        for seed in 1..6 {
            let s = in_condition(&healthy, kind, Condition::OldDead, Seed::new(seed));
            let axes = s.axes();
            for axis in axes.iter().filter(|axis| axis.order == 2) {
                let whole = healthy.axes();
                let of_it = |a: &Axis<'_>| {
                    let at = |nodes: &[u32], s: &Skeleton| s.position[nodes[0] as usize];
                    at(a.nodes, &healthy) == at(axis.nodes, &s)
                };
                let whole = whole.iter().find(of_it).expect("it stood before");
                if falls(&healthy, &whole) > HANGS && whole.nodes.len() > 3 {
                    hung += 1;
                    assert!(2 * axis.nodes.len() <= whole.nodes.len() + 1, "{axis:?}");
                }
            }
        }
        assert!(hung > 20, "{hung}");
    }

    #[test]
    fn branches_dry_as_the_scale_says_and_the_lower_first() {
        let (healthy, kind) = grown("picea_abies");
        let mut before = 0.0;
        for (condition, least, most) in [
            (Condition::Weakened, 0.0, 0.25),
            (Condition::StronglyWeakened, 0.25, 0.667),
            (Condition::Dying, 0.667, 0.95),
        ] {
            let s = in_condition(&healthy, kind, condition, Seed::new(1));
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

    /// Killed within a year it holds no line between what is in needles and what is bare.
    #[test]
    fn a_fresh_dead_conifer_is_bare_in_places_all_over() {
        for name in ["picea_obovata", "pinus_sibirica"] {
            let (healthy, kind) = grown(name);
            let s = in_condition(&healthy, kind, Condition::FreshDead, Seed::new(1));
            let is_stem = s.is_stem();
            let mut roots: Vec<usize> =
                (1..s.len()).filter(|&i| !is_stem[i] && is_stem[s.parent[i] as usize]).collect();
            roots.sort_by(|&a, &b| s.position[a].z.total_cmp(&s.position[b].z));
            let (low, high) = roots.split_at(roots.len() / 2);
            let [low, high] = [low, high]
                .map(|half| half.iter().filter(|&&i| s.dead[i]).count() as f32 / half.len() as f32);
            assert!(
                (0.4..0.9).contains(&low) && (0.1..0.6).contains(&high),
                "{name}: {low} {high}"
            );
        }
    }

    #[test]
    fn broadleaved_trees_dry_from_the_top_and_from_the_ends_of_their_limbs() {
        let (healthy, kind) = grown("quercus_robur");
        let mut before = 0.0;
        for condition in [Condition::Weakened, Condition::StronglyWeakened, Condition::Dying] {
            let s = in_condition(&healthy, kind, condition, Seed::new(1));
            s.check().unwrap();
            let dry = s.dead.iter().filter(|d| **d).count() as f32 / s.len() as f32;
            assert!(dry > before && dry < 0.9, "{condition:?}: {dry}");
            before = dry;
            let axes = s.axes();
            let is_limb = |axis: &Axis| axis.order == 1 && axis.nodes.len() > 2;
            let limbs: Vec<_> = axes.iter().filter(is_limb).collect();
            assert!(limbs.iter().all(|limb| !s.dead[limb.nodes[0] as usize]), "they live");
            let ends = limbs.iter().map(|limb| limb.nodes[limb.nodes.len() - 1] as usize);
            let mean = |of: &mut dyn Iterator<Item = usize>| {
                let (sum, count) = of.fold((0.0, 0), |(s2, n), i| (s2 + s.position[i].z, n + 1));
                sum / count.max(1) as f32
            };
            let all = mean(&mut ends.clone());
            let dead = mean(&mut ends.filter(|i| s.dead[*i]));
            assert!(dead > all, "{condition:?}: {dead} {all}");
        }
    }

    #[test]
    fn an_old_dead_tree_is_broken_and_bears_nothing() {
        for (name, most) in [("pinus_sylvestris", 0.97), ("betula_pendula", 0.85)] {
            let (healthy, kind) = grown(name);
            let s = in_condition(&healthy, kind, Condition::OldDead, Seed::new(2));
            let (base_m, height_m) = (healthy.crown_base_m(), healthy.height_m());
            let most_m = base_m + most * (height_m - base_m);
            assert!(s.height_m() > base_m && s.height_m() <= most_m, "{name}: {}", s.height_m());
            assert!(s.length_m() < 0.5 * healthy.length_m());
            assert!(s.bears_leaves(1.0).iter().all(|b| !b));
        }
    }
}
