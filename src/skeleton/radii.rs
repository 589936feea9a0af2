//! Radii by the pipe model (Shinozaki et al. 1964; Leonardo's rule for e = 2): the wood at a node
//! carries what grows beyond it, r^e = Σ r_child^e.
//!
//! Departure: each metre of shoot adds pipes too, for the twigs too small to be nodes of their
//! own, so that an unbranched axis tapers, and a bole keeps a part of the disused pipes of the
//! branches it has shed. The foot of a stem flares. The number of pipes at the tips is not the tree's, it
//! follows the level of detail, so the sum is scaled to the allometric diameter at 1.3 m, keeping
//! every ratio; only the last node of an axis is then given the radius of a shoot's tip.

use glam::Vec3;

use super::{Children, NO_PARENT};
use crate::species::Species;

/// Height at which a stem's diameter is measured (breast height), metres.
pub const BREAST_HEIGHT_M: f32 = 1.3;

/// Part of the disused pipes of lost branches that still is in a stem, over a tree's whole height.
const SHED: f64 = 0.5;
/// Widening of a stem's foot.
const FLARE: f64 = 0.35;

/// Least diameter of a young tree's stem at a tenth of its height: metres, and metres a metre of
/// height. Seedlings are 50 to 80 times as high as thick at the root collar.
const SEEDLING: (f32, f32) = (0.0015, 0.01);

/// What radii follow from, besides the shape.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pipes {
    /// e of the pipe model; taken into 1…4.
    pub exponent: f32,
    /// Radius at the last node of an axis, metres.
    pub tip_radius_m: f32,
    /// Radius of the stem where it is measured, metres.
    pub stem_radius_m: f32,
    /// Height at which it is measured; trees below it are measured at a tenth of their height.
    pub measured_at_m: f32,
}

impl Pipes {
    /// Those of a tree of the species.
    pub fn of_species(species: &Species, height_m: f32) -> Pipes {
        let (growth, size) = (&species.growth, &species.size);
        let (e, tip) = (growth.pipe_exponent, growth.tip_radius_m);
        Pipes::for_height(e, tip, size.height_m, size.stem_diameter_m, height_m)
    }

    /// The allometric stem radius of a tree of `height_m`, from a grown tree of the species: stem
    /// diameter goes with height^1.5 (elastic similarity, McMahon 1973), but a young tree, measured at
    /// its foot, is no more slender than seedlings are.
    pub fn for_height(
        exponent: f32,
        tip_radius_m: f32,
        grown_height_m: f32,
        grown_diameter_m: f32,
        height_m: f32,
    ) -> Pipes {
        let scale = (height_m / grown_height_m.max(0.1)).max(1e-3);
        let elastic = 0.5 * grown_diameter_m * scale.powf(1.5);
        let (stem, measured_at_m) = if height_m > 2.0 * BREAST_HEIGHT_M {
            (elastic, BREAST_HEIGHT_M)
        } else {
            let least = 0.5 * (SEEDLING.0 + SEEDLING.1 * height_m);
            (elastic.max(least), 0.1 * height_m)
        };
        // A seedling's stem is no thinner than a few hundredths of a shoot's tip would allow.
        let tip = tip_radius_m.max(1e-4).min(0.5 * stem.max(4e-4));
        Pipes { exponent, tip_radius_m: tip, stem_radius_m: stem.max(2.0 * tip), measured_at_m }
    }
}

/// One radius a node: positive, never greater than at the parent. `is_stem` marks the nodes on
/// which the diameter is measured (the thickest stem of a shrub counts).
pub fn radii(position: &[Vec3], parent: &[u32], is_stem: &[bool], pipes: &Pipes) -> Vec<f32> {
    let n = position.len();
    let e = f64::from(pipes.exponent).clamp(1.0, 4.0);
    let mut carried = vec![0.0f64; n];
    let total_m: f64 = (1..n).map(|i| internode_m(position, parent, i)).sum();
    let tips = {
        let children = Children::new(parent);
        (0..n as u32).filter(|&i| children.of(i).is_empty()).count().max(1)
    };
    // Half of all pipes begin at tips, half along the way.
    let per_m = tips as f64 / total_m.max(1e-6);
    // The crown's length holds all pipes; a metre of bole once held its share, each stem of a stool
    // its part of it.
    let top_m = position.iter().map(|p| f64::from(p.z)).fold(1e-6, f64::max);
    let stems = (1..n).filter(|&i| is_stem[i] && parent[i] == 0).count().max(1);
    let shed_per_m = SHED * 2.0 * tips as f64 / (top_m * stems as f64);
    for i in (0..n).rev() {
        if carried[i] == 0.0 {
            carried[i] = 1.0;
        }
        if parent[i] != NO_PARENT {
            let mut along = per_m * internode_m(position, parent, i);
            if is_stem[i] {
                // The older the part of a stem, the more it has shed; the top nothing.
                let depth = 1.0 - f64::from(position[i].z) / top_m;
                along += 2.0 * depth.max(0.0) * shed_per_m * internode_m(position, parent, i);
            }
            carried[parent[i] as usize] += carried[i] + along;
        }
    }
    let flare_m = f64::from(pipes.stem_radius_m) * 2.5;
    let flare = |i: usize| match is_stem[i] {
        true => 1.0 + FLARE * (-f64::from(position[i].z.max(0.0)) / flare_m).exp(),
        false => 1.0,
    };
    let relative: Vec<f64> = (0..n).map(|i| carried[i].powf(1.0 / e) * flare(i)).collect();
    let at = f64::from(radius_at(position, parent, is_stem, pipes.measured_at_m, &relative));
    let scale = f64::from(pipes.stem_radius_m) / at.max(1e-12);
    let tip = f64::from(pipes.tip_radius_m);
    let mut radius = vec![0.0f32; n];
    for i in 0..n {
        let r = (relative[i] * scale) as f32;
        // A tip has no pipes but its own.
        let is_tip = carried[i] <= 1.0;
        let r = if is_tip { r.min(tip as f32) } else { r.max(tip as f32) };
        radius[i] = match parent[i] {
            NO_PARENT => r,
            p => r.min(radius[p as usize]),
        };
    }
    radius
}

fn internode_m(position: &[Vec3], parent: &[u32], i: usize) -> f64 {
    match parent[i] {
        NO_PARENT => 0.0,
        p => f64::from(position[i].distance(position[p as usize])),
    }
}

/// The greatest value, linear in height, where a stem's internode crosses `height_m`; the value at
/// the root where none does.
pub(super) fn radius_at(
    position: &[Vec3],
    parent: &[u32],
    is_stem: &[bool],
    height_m: f32,
    value: &[f64],
) -> f32 {
    let mut found = None::<f64>;
    for i in 1..position.len() {
        if !is_stem[i] || parent[i] == NO_PARENT {
            continue;
        }
        let p = parent[i] as usize;
        let (z0, z1) = (position[p].z, position[i].z);
        if z0 <= height_m && height_m < z1 {
            let t = f64::from((height_m - z0) / (z1 - z0));
            let v = value[p] + t * (value[i] - value[p]);
            found = Some(found.map_or(v, |f| f.max(v)));
        }
    }
    found.unwrap_or(value.first().copied().unwrap_or(1.0)) as f32
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn pipes(exponent: f32) -> Pipes {
        Pipes { exponent, tip_radius_m: 0.002, stem_radius_m: 0.1, measured_at_m: 1.3 }
    }

    /// A stem of 10 nodes with two equal branches on the last: far from tips the branches'
    /// cross-sections sum to the stem's above the fork.
    #[test]
    fn leonardos_rule_holds_at_a_fork() {
        let mut position: Vec<Vec3> = (0..10).map(|i| Vec3::Z * i as f32).collect();
        let mut parent: Vec<u32> = vec![NO_PARENT];
        parent.extend(0..9);
        for side in [-1.0f32, 1.0] {
            let mut p = 9;
            for k in 1..=200 {
                position.push(Vec3::new(side * k as f32 * 0.1, 0.0, 9.0));
                parent.push(p);
                p = position.len() as u32 - 1;
            }
        }
        let stem: Vec<bool> = (0..position.len()).map(|i| i < 10).collect();
        let r = radii(&position, &parent, &stem, &pipes(2.0));
        let (fork, left, right) = (r[9], r[10], r[210]);
        assert!((left - right).abs() < 1e-6);
        assert!(((left * left + right * right) / (fork * fork) - 1.0).abs() < 0.02);
        let value: Vec<f64> = r.iter().map(|&r| f64::from(r)).collect();
        assert!((radius_at(&position, &parent, &stem, 1.3, &value) - 0.1).abs() < 1e-4);
    }

    #[test]
    fn diameter_follows_height_and_small_trees_stay_sound() {
        let grown = Pipes::for_height(2.3, 0.002, 20.0, 0.3, 20.0);
        assert_eq!(grown.stem_radius_m, 0.15);
        let half = Pipes::for_height(2.3, 0.002, 20.0, 0.3, 10.0);
        assert!((half.stem_radius_m / grown.stem_radius_m - 0.5f32.powf(1.5)).abs() < 1e-4);
        let seedling = Pipes::for_height(2.3, 0.002, 20.0, 0.3, 0.1);
        assert!(seedling.stem_radius_m >= 2.0 * seedling.tip_radius_m);
        assert!(seedling.measured_at_m < 0.1);
    }

    #[test]
    fn seedlings_are_as_thick_as_seedlings_are() {
        for (height_m, low_mm, high_mm) in [(0.3, 4.0, 8.0), (0.6, 6.0, 12.0), (1.0, 9.0, 18.0)] {
            let pipes = Pipes::for_height(2.3, 0.0025, 28.0, 0.44, height_m);
            let mm = 2000.0 * pipes.stem_radius_m;
            assert!((low_mm..high_mm).contains(&mm), "{height_m} m: {mm} mm");
        }
    }

    proptest! {
        #[test]
        fn no_child_is_thicker_than_its_parent(
            links in prop::collection::vec((0.0f32..1.0, -1.0f32..1.0, -1.0f32..1.0), 1..200),
            exponent in -1.0f32..9.0,
        ) {
            let mut position = vec![Vec3::ZERO];
            let mut parent = vec![NO_PARENT];
            for (pick, x, y) in links {
                let p = (pick * position.len() as f32) as usize;
                position.push(position[p] + Vec3::new(x, y, 0.5));
                parent.push(p as u32);
            }
            let stem = vec![true; position.len()];
            let r = radii(&position, &parent, &stem, &pipes(exponent));
            for i in 1..r.len() {
                prop_assert!(r[i] > 0.0 && r[i] <= r[parent[i] as usize]);
            }
        }
    }
}
