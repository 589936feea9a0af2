//! Stages of growth (P18: one iteration is one stage): when each node of a grown tree came, and
//! the tree as it stood then.
//!
//! The stem rises with the species' growth in height (Richards 1959). From where a branch leaves
//! the stem, each way out to a tip is walked until today, ever more slowly: its length goes with
//! the root of its age, as increments of ageing branches fall. So a stage holds every node of
//! the stages before it at the same place, and no wood of it is thinner than it was.
//!
//! Limit: a grown tree has lost the lower branches of its youth, and so has every stage of it. A
//! tree of small height grown for itself has them.

use super::radii::{Pipes, radii};
use super::{NO_PARENT, Skeleton};
use crate::diagnostic::{Error, Result};
use crate::species::Species;
use crate::species::model::Size;

/// Stages in the life of a tree, of equal time each.
pub const STAGES: u16 = 12;

/// The stage, 1 to [`STAGES`], in which each node grew; 0 for the root.
pub(super) fn births(s: &Skeleton, size: &Size) -> Vec<u16> {
    let n = s.len();
    // Longest way from each node out to a tip.
    let mut ahead_m = vec![0.0f32; n];
    for i in (1..n).rev() {
        let p = s.parent[i] as usize;
        ahead_m[p] = ahead_m[p].max(ahead_m[i] + s.internode_m(i as u32));
    }
    let is_stem = s.is_stem();
    let height_m = s.height_m().max(1e-6);
    // When the node's branch left the stem, as a share of the tree's life, and how far out it is.
    let mut left = vec![0.0f32; n];
    let mut out_m = vec![0.0f32; n];
    let mut time = vec![0.0f32; n];
    let mut birth = vec![0u16; n];
    for i in 1..n {
        let p = s.parent[i] as usize;
        let grown = if is_stem[i] {
            size.age_share(s.position[i].z / height_m)
        } else {
            left[i] = if is_stem[p] { time[p] } else { left[p] };
            out_m[i] = out_m[p] + s.internode_m(i as u32);
            let way = out_m[i] / (out_m[i] + ahead_m[i]).max(1e-9);
            left[i] + (1.0 - left[i]) * way * way
        };
        time[i] = grown.clamp(time[p], 1.0);
        birth[i] = match p {
            0 => 1,
            _ => ((time[i] * f32::from(STAGES)).ceil() as u16).clamp(birth[p].max(1), STAGES),
        };
    }
    birth
}

/// The tree as it stood at the end of `stage`: the same nodes as far as they had grown, with the
/// radii of a tree of that height.
///
/// # Errors
/// A stage outside 1 to [`STAGES`].
pub fn at_stage(grown: &Skeleton, species: &Species, stage: u16) -> Result<Skeleton> {
    if !(1..=STAGES).contains(&stage) {
        return Err(Error::new(format!("there is no stage {stage}"))
            .remedy(format!("a tree grows in stages 1 to {STAGES}; the last is the grown tree")));
    }
    // Pipes are shared out anew at each stage; what a later stage needs less, an earlier one never
    // had.
    let mut later = grown.clone();
    for k in (stage..STAGES).rev() {
        let keep: Vec<bool> = later.birth.iter().map(|&b| b <= k).collect();
        let mut younger = later.subset(&keep);
        let pipes = Pipes::of_species(species, younger.height_m());
        let own = radii(&younger.position, &younger.parent, &younger.is_stem(), &pipes);
        for (radius, own) in younger.radius_m.iter_mut().zip(own) {
            *radius = radius.min(own);
        }
        later = younger;
    }
    Ok(later)
}

impl Skeleton {
    /// Makes it so many times as large, about its root collar.
    pub fn scale(&mut self, factor: f32) {
        self.position.iter_mut().for_each(|p| *p *= factor);
        self.radius_m.iter_mut().for_each(|r| *r *= factor);
    }

    /// Whether each node is of a stem: of an axis that stands on the ground.
    pub(crate) fn is_stem(&self) -> Vec<bool> {
        let mut is_stem = vec![true; self.len()];
        for i in 1..self.len() {
            let p = self.parent[i] as usize;
            is_stem[i] = p == 0 || (is_stem[p] && self.axis[i] == self.axis[p]);
        }
        is_stem
    }

    /// The nodes marked in `keep` whose parents are kept too, axes numbered without gaps in the
    /// order they start. The root always stays.
    pub(crate) fn subset(&self, keep: &[bool]) -> Skeleton {
        let n = self.len();
        let mut new_id = vec![NO_PARENT; n];
        let mut new_axis = vec![NO_PARENT; n];
        let mut axes = 0;
        let mut out = Skeleton::default();
        for i in 0..n {
            let parent = match self.parent[i] {
                NO_PARENT => NO_PARENT,
                p if keep.get(i) == Some(&true) && new_id[p as usize] != NO_PARENT => {
                    new_id[p as usize]
                }
                _ => continue,
            };
            new_id[i] = out.len() as u32;
            let axis = &mut new_axis[self.axis[i] as usize];
            if *axis == NO_PARENT {
                *axis = axes;
                axes += 1;
            }
            out.position.push(self.position[i]);
            out.parent.push(parent);
            out.radius_m.push(self.radius_m[i]);
            out.axis.push(*axis);
            out.order.push(self.order[i]);
            out.birth.push(self.birth[i]);
            out.dead.extend(self.dead.get(i));
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::seed::Seed;
    use crate::skeleton::{Detail, Target, grow};
    use crate::species;

    #[test]
    fn every_stage_contains_the_one_before() {
        for name in species::builtin_names() {
            let species = species::load(name).unwrap();
            let target = Target::FromSpecies { height_m: None };
            let grown = grow(&species, target, Detail::FOREST, Seed::new(4)).unwrap();
            assert_eq!(at_stage(&grown, &species, STAGES).unwrap(), grown);
            let mut last: Option<Skeleton> = None;
            for stage in 1..=STAGES {
                let s = at_stage(&grown, &species, stage).unwrap();
                s.check().unwrap();
                assert!(s.birth.iter().all(|&b| b <= stage));
                if let Some(before) = &last {
                    contains(&s, before, name);
                    assert!(s.len() >= before.len());
                }
                last = Some(s);
            }
            let first = at_stage(&grown, &species, 1).unwrap();
            assert!(first.len() > 1 && first.height_m() < 0.35 * grown.height_m(), "{name}");
            let half = at_stage(&grown, &species, STAGES / 2).unwrap();
            assert!(half.len() < grown.len() && half.len() > first.len(), "{name}");
            assert!(half.radius_m[0] < grown.radius_m[0], "{name}");
        }
    }

    /// Every internode of `small` is one of `large`, and there at least as thick.
    fn contains(large: &Skeleton, small: &Skeleton, name: &str) {
        let key = |s: &Skeleton, i: usize| {
            let bits = |p: glam::Vec3| p.to_array().map(f32::to_bits);
            let from = s.parent_of(i as u32).map(|p| bits(s.position[p as usize]));
            (from, bits(s.position[i]), s.order[i])
        };
        let all: std::collections::HashMap<_, f32> =
            (0..large.len()).map(|i| (key(large, i), large.radius_m[i])).collect();
        for i in 0..small.len() {
            let radius_m = all.get(&key(small, i));
            assert!(radius_m.is_some_and(|&r| r >= small.radius_m[i]), "{name}: node {i}");
        }
    }

    #[test]
    fn a_stage_that_is_none_is_refused() {
        let species = species::load("picea_obovata").unwrap();
        for stage in [0, STAGES + 1, u16::MAX] {
            let error = at_stage(&Skeleton::default(), &species, stage).unwrap_err();
            assert_eq!(
                error.remedy_text(),
                Some("a tree grows in stages 1 to 12; the last is the grown tree")
            );
        }
    }

    #[test]
    fn height_and_age_are_each_others_inverse() {
        let size = species::load("larix_sibirica").unwrap().size;
        assert!((size.height_at(size.age_years) - size.height_m).abs() < 1e-3);
        assert_eq!(size.height_at(0.0), 0.0);
        for share in [0.01, 0.2, 0.5, 1.0, 1.15] {
            let height_m = share * size.height_m;
            let back = size.height_at(size.age_at(height_m));
            assert!((back / height_m - 1.0).abs() < 1e-3, "{share}: {back}");
        }
        assert_eq!(size.age_at(1000.0), 4.0 * size.age_years);
        assert_eq!((size.age_share(0.0), size.age_share(1.0)), (0.0, 1.0));
    }
}
