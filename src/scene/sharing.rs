//! Which trees share a model: k groups a species over (height, slenderness), each led by the tree
//! nearest to its middle.
//!
//! Implements Lloyd's k-means on two standardised features with a quantile start, so that the
//! result depends on the trees alone and not on their order beyond ties. Known limit: a local
//! optimum, which is enough for models that are scaled to fit anyway.

/// What decides how well a model fits a tree.
#[derive(Debug, Clone, Copy)]
pub struct Build {
    /// Index of the species.
    pub species: usize,
    pub height_m: f32,
    pub crown_diameter_m: f32,
}

/// One model and the trees that use it; indices into the input.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Model {
    pub species: usize,
    pub exemplar: usize,
    pub members: Vec<usize>,
}

const ROUNDS: usize = 20;

/// At most `per_species` models a species; every tree is a member of exactly one. Heights and
/// diameters must be positive.
pub fn share(trees: &[Build], per_species: usize) -> Vec<Model> {
    let species_count = trees.iter().map(|t| t.species + 1).max().unwrap_or(0);
    (0..species_count)
        .flat_map(|species| {
            let members: Vec<usize> =
                (0..trees.len()).filter(|&i| trees[i].species == species).collect();
            groups(trees, &members, per_species.max(1))
                .into_iter()
                .map(move |(exemplar, members)| Model { species, exemplar, members })
        })
        .collect()
}

/// Logarithms, so that scaling errors count alike for small and large trees.
fn features(tree: &Build) -> [f32; 2] {
    [tree.height_m.ln(), (tree.crown_diameter_m / tree.height_m).ln()]
}

fn distance_sq(a: [f32; 2], b: [f32; 2]) -> f32 {
    (a[0] - b[0]).powi(2) + (a[1] - b[1]).powi(2)
}

fn groups(trees: &[Build], members: &[usize], k: usize) -> Vec<(usize, Vec<usize>)> {
    if members.is_empty() {
        return Vec::new();
    }
    let k = k.min(members.len());
    let mut by_height = members.to_vec();
    by_height.sort_by(|&a, &b| trees[a].height_m.total_cmp(&trees[b].height_m).then(a.cmp(&b)));
    let mut centres: Vec<[f32; 2]> = (0..k)
        .map(|i| features(&trees[by_height[(2 * i + 1) * members.len() / (2 * k)]]))
        .collect();
    let nearest = |centres: &[[f32; 2]], f: [f32; 2]| {
        (0..centres.len())
            .min_by(|&a, &b| distance_sq(centres[a], f).total_cmp(&distance_sq(centres[b], f)))
            .unwrap_or(0)
    };
    for _ in 0..ROUNDS {
        let mut sums = vec![([0.0f64; 2], 0u32); k];
        for &i in members {
            let f = features(&trees[i]);
            let (sum, n) = &mut sums[nearest(&centres, f)];
            sum[0] += f64::from(f[0]);
            sum[1] += f64::from(f[1]);
            *n += 1;
        }
        let mut moved = false;
        for (centre, (sum, n)) in centres.iter_mut().zip(sums) {
            if n > 0 {
                let next = [(sum[0] / f64::from(n)) as f32, (sum[1] / f64::from(n)) as f32];
                moved |= next != *centre;
                *centre = next;
            }
        }
        if !moved {
            break;
        }
    }
    let mut out: Vec<(usize, Vec<usize>)> = Vec::new();
    for (g, &centre) in centres.iter().enumerate() {
        let own: Vec<usize> = members
            .iter()
            .copied()
            .filter(|&i| nearest(&centres, features(&trees[i])) == g)
            .collect();
        let middle = own.iter().copied().min_by(|&a, &b| {
            let d = |i: usize| distance_sq(features(&trees[i]), centre);
            d(a).total_cmp(&d(b))
        });
        if let Some(exemplar) = middle {
            out.push((exemplar, own));
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn tree(species: usize, height_m: f32, crown_diameter_m: f32) -> Build {
        Build { species, height_m, crown_diameter_m }
    }

    #[test]
    fn two_sizes_make_two_groups() {
        let trees: Vec<Build> =
            [10.0, 10.2, 9.9, 20.0, 20.5, 19.8].into_iter().map(|h| tree(0, h, h * 0.3)).collect();
        let models = share(&trees, 2);
        assert_eq!(models.len(), 2);
        assert_eq!(models[0].members, [0, 1, 2]);
        assert_eq!(models[1].members, [3, 4, 5]);
        assert_eq!(models[0].exemplar, 0);
    }

    proptest! {
        #[test]
        fn every_tree_has_one_model_of_its_species(
            sizes in prop::collection::vec((0usize..4, 2.0f32..40.0, 0.5f32..15.0), 0..200),
            k in 1usize..9,
        ) {
            let trees: Vec<Build> = sizes.iter().map(|&(s, h, d)| tree(s, h, d)).collect();
            let models = share(&trees, k);
            let mut seen = vec![0; trees.len()];
            for m in &models {
                prop_assert!(m.members.contains(&m.exemplar));
                for &i in &m.members {
                    seen[i] += 1;
                    prop_assert_eq!(trees[i].species, m.species);
                }
            }
            prop_assert!(seen.iter().all(|&n| n == 1));
            for s in 0..4 {
                prop_assert!(models.iter().filter(|m| m.species == s).count() <= k);
            }
        }
    }
}
