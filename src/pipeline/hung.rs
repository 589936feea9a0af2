//! How the models of a forest look: twigs of young trees hang less, and few looks serve them all.

use std::collections::HashMap;

use crate::species::Species;

/// How species look whose twigs hang as those of trees of a height do.
pub(super) struct Hung {
    looks: Vec<Species>,
    /// Of each model, which of them it has.
    of: Vec<usize>,
}

impl Hung {
    /// Of models of species and heights, metres.
    pub(super) fn of(models: impl Iterator<Item = (usize, f32)>, looks: &[Species]) -> Hung {
        /// Of young trees, so many between twigs that stand out and that hang: hundreds of models share them.
        const STEPS: f32 = 32.0;
        let mut hung = Hung { looks: looks.to_vec(), of: Vec::new() };
        let mut known = HashMap::new();
        for (species, height_m) in models {
            let look = &looks[species];
            let (own, droop) = (look.foliage.droop, look.droop_at(height_m));
            let droop = if droop == own { own } else { (droop * STEPS).round() / STEPS };
            let place = *known.entry((species, droop.to_bits())).or_insert_with(|| {
                if droop == own {
                    return species;
                }
                let mut look = look.clone();
                look.foliage.droop = droop;
                hung.looks.push(look);
                hung.looks.len() - 1
            });
            hung.of.push(place);
        }
        hung
    }

    /// Of a model.
    pub(super) fn look(&self, model: usize) -> &Species {
        &self.looks[self.of[model]]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Grown trees have the species' own look, and hundreds of young ones share few.
    #[test]
    fn twigs_of_a_forest_s_models_hang_by_their_height() {
        let looks = ["picea_abies", "betula_pendula"].map(|n| crate::species::load(n).unwrap());
        let heights = (0..400).map(|k| 1.0 + 0.05 * k as f32);
        let models: Vec<(usize, f32)> = heights.flat_map(|m| [(0, m), (1, m)]).collect();
        let hung = Hung::of(models.iter().copied(), &looks);
        assert!(hung.looks.len() < 60, "{}", hung.looks.len());
        for (&(species, height_m), &place) in models.iter().zip(&hung.of) {
            let (look, own) = (&hung.looks[place], &looks[species]);
            assert_eq!(look.id, own.id);
            let off = look.foliage.droop - own.droop_at(height_m);
            assert!(off.abs() <= 1.0 / 64.0, "{}, {height_m} m: {off}", own.id);
            assert!(height_m < 17.0 || place == species, "{}, {height_m} m", own.id);
        }
    }
}
