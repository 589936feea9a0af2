//! Conifer or broadleaf, from what the laser and the photo show of a crown: linear discriminant
//! analysis (Fisher 1936) of four values that carry over between places.
//!
//! - mean height of the returns and their spread, over the height of the tree: a broadleaf's
//!   returns are strewn from top to ground, a pine's stay in its crown;
//! - intensity of first returns over the ground's: needles send back less at 1064 nm than leaves
//!   (Korpela et al. 2010, Silva Fennica 44(2));
//! - spread of the luminance over its mean, in photos fine enough to show branches.
//!
//! A spire is a conifer's, whatever the rest says: returns that sink 3 m and more for each metre from
//! the middle of the crown outwards. Of the annotated crowns, nearly all of them pines and
//! broadleaves, 9 of 551 do, 7 of them conifers; the bound parts the outlines of the spruces, firs
//! and larches of the rule files from those of the broadleaves.
//!
//! What is not known of a crown is left out: the means and covariances of the rest are those of a
//! model without it. `tools/fit_kind.py` fits the numbers and prints how well they do; what it
//! printed, and what was tried and left out (greenness, slenderness, roundness of the top, return
//! ratios), is in docs/inventory.md.
//!
//! Limits: fitted to pines and to broadleaves of two places; a spruce or larch that is no spire is
//! taken for a broadleaf where intensity does not tell. A columnar poplar is a spire.

/// Values of a crown that the model reads, in its order.
pub const FEATURES: [&str; 4] =
    ["mean_height", "height_spread", "intensity_over_ground", "contrast"];
const N: usize = FEATURES.len();

/// Values beyond these are taken for these.
const LIMITS: [[f32; 2]; N] = [[0.0, 1.0], [0.0, 0.5], [-2.0, 2.0], [0.0, 1.0]];

// By tools/fit_kind.py.
const BROADLEAF: [f64; N] = [0.74546, 0.20414, 1.13322, 0.26337];
const CONIFER: [f64; N] = [0.84814, 0.11496, -0.70412, 0.20784];
const COVARIANCE: [[f64; N]; N] = [
    [0.00597, -0.00267, 0.00415, -0.00050],
    [-0.00267, 0.00311, 0.00598, 0.00052],
    [0.00415, 0.00598, 0.68599, 0.00586],
    [-0.00050, 0.00052, 0.00586, 0.00470],
];

/// From this steepness on a crown is a spire, and so likely a conifer's.
const SPIRE: f32 = 3.0;
const SPIRE_CHANCE: f32 = 0.9;

/// The chance that a crown is a conifer's, 0…1, both being as likely before. `steepness` as in
/// [`Look`](super::look::Look). `None` where the spread of its returns is not known: the photo alone
/// does not tell.
pub fn conifer_chance(features: &[Option<f32>; N], steepness: f32) -> Option<f32> {
    let chance = chance_by_model(features)?;
    Some(if steepness >= SPIRE { chance.max(SPIRE_CHANCE) } else { chance })
}

fn chance_by_model(features: &[Option<f32>; N]) -> Option<f32> {
    features[1].filter(|v| v.is_finite())?;
    let known: Vec<(usize, f64)> = features
        .iter()
        .enumerate()
        .filter_map(|(i, v)| {
            let v = v.filter(|v| v.is_finite())?;
            Some((i, f64::from(v.clamp(LIMITS[i][0], LIMITS[i][1]))))
        })
        .collect();
    let difference: Vec<f64> = known.iter().map(|&(i, _)| CONIFER[i] - BROADLEAF[i]).collect();
    let rows: Vec<Vec<f64>> = known
        .iter()
        .map(|&(i, _)| known.iter().map(|&(j, _)| COVARIANCE[i][j]).collect())
        .collect();
    let weight = solve(rows, difference);
    let score: f64 = known
        .iter()
        .zip(weight)
        .map(|(&(i, v), w)| w * (v - 0.5 * (CONIFER[i] + BROADLEAF[i])))
        .sum();
    Some((1.0 / (1.0 + (-score).exp())) as f32)
}

/// Solves `a x = b` for positive definite `a` (Gauss elimination).
fn solve(mut a: Vec<Vec<f64>>, mut b: Vec<f64>) -> Vec<f64> {
    let n = b.len();
    for k in 0..n {
        for i in k + 1..n {
            let factor = a[i][k] / a[k][k];
            let pivot = a[k].clone();
            for (v, p) in a[i].iter_mut().zip(pivot) {
                *v -= factor * p;
            }
            b[i] -= factor * b[k];
        }
    }
    for k in (0..n).rev() {
        let known: f64 = (k + 1..n).map(|j| a[k][j] * b[j]).sum();
        b[k] = (b[k] - known) / a[k][k];
    }
    b
}

#[cfg(test)]
mod tests {
    use super::*;

    fn known(means: &[f64; N], is_known: [bool; N]) -> [Option<f32>; N] {
        std::array::from_fn(|i| is_known[i].then_some(means[i] as f32))
    }

    #[test]
    fn each_kind_is_told_by_its_own_means_whatever_is_missing() {
        for missing in 0..1 << N {
            let is_known = std::array::from_fn(|i| missing >> i & 1 == 0);
            let conifer = conifer_chance(&known(&CONIFER, is_known), 0.0);
            let broadleaf = conifer_chance(&known(&BROADLEAF, is_known), 0.0);
            let (Some(c), Some(b)) = (conifer, broadleaf) else {
                assert!(!is_known[1]);
                continue;
            };
            assert!(c > 0.5 && b < 0.5 && (c + b - 1.0).abs() < 1e-4, "{is_known:?}: {c} {b}");
        }
    }

    #[test]
    fn values_out_of_all_bounds_give_a_chance() {
        for v in [f32::MIN, -1.0, 0.0, 1e30, f32::MAX] {
            let p = conifer_chance(&[Some(v); N], v).unwrap();
            assert!((0.0..=1.0).contains(&p), "{v}: {p}");
        }
        let p =
            conifer_chance(&[Some(0.8), Some(0.2), Some(f32::NAN), Some(f32::INFINITY)], f32::NAN);
        assert_eq!(p, conifer_chance(&[Some(0.8), Some(0.2), None, None], 0.0));
    }

    #[test]
    fn a_spire_is_a_conifer() {
        let broadleaf = known(&BROADLEAF, [true; N]);
        assert!(conifer_chance(&broadleaf, 2.9).unwrap() < 0.1);
        assert_eq!(conifer_chance(&broadleaf, 3.1), Some(SPIRE_CHANCE));
        assert_eq!(conifer_chance(&[None; N], 3.1), None);
    }
}
