//! What becomes of a species' size and growth before its trees are grown: young trees keep their lower
//! branches, and where the species says so are of another outline and branch otherwise. Numbers change
//! evenly with height from those of `[young]` to those of a grown tree.

use super::model::{Foliage, Growth, Size, Species, Young, curve, youth};

/// The one or the other at 0 and 1, to the bit.
fn mix(young: f32, grown: f32, share: f32) -> f32 {
    young * (1.0 - share) + grown * share
}

/// One outline on the way to another, with the corners of both.
fn between(young: &[[f32; 2]], grown: &[[f32; 2]], share: f32) -> Vec<[f32; 2]> {
    let mut heights: Vec<f32> = young.iter().chain(grown).map(|p| p[0]).collect();
    heights.sort_by(f32::total_cmp);
    heights.dedup();
    heights.into_iter().map(|h| [h, mix(curve(young, h), curve(grown, h), share)]).collect()
}

impl Young {
    /// How far a tree of so much of the height of a grown one is grown, 0…1.
    fn grown(&self, height_share: f32) -> f32 {
        let [from, to] = self.until;
        match height_share < to {
            true => ((height_share - from) / (to - from).max(1e-6)).clamp(0.0, 1.0),
            false => 1.0,
        }
    }

    fn size(&self, size: &mut Size, height_share: f32, grown: f32) {
        let lifted = size.crown_base * height_share.clamp(0.0, 1.0).sqrt();
        size.crown_base = self.crown_base.map_or(lifted, |young| mix(young, lifted, grown));
        size.crown_diameter_m *= self.crown_width.map_or(1.0, |width| mix(width, 1.0, grown));
        if let Some(young) = self.profile.as_ref().filter(|_| grown < 1.0) {
            size.profile = between(young, &size.profile, grown);
        }
    }

    fn growth(&self, growth: &mut Growth, grown: f32) {
        let toward = |value: &mut f32, young: Option<f32>| {
            *value = young.map_or(*value, |young| mix(young, *value, grown));
        };
        toward(&mut growth.stem, self.stem);
        toward(&mut growth.uneven, self.uneven);
        toward(&mut growth.bare, self.bare);
        toward(&mut growth.hang, self.hang);
        // One is the rule's own tree, whole.
        if let Some(young) = self.internodes.filter(|_| growth.internodes > 1) {
            growth.internodes = mix(young as f32, growth.internodes as f32, grown).round() as u32;
        }
        if let Some(habit) = growth.order.first_mut() {
            toward(&mut habit.irregular, self.irregular);
            toward(&mut habit.keep, self.keep);
            if let Some([foot, top]) = self.angle_deg {
                let old = habit.angle_deg.unwrap_or([foot, top]);
                habit.angle_deg = Some([mix(foot, old[0], grown), mix(top, old[1], grown)]);
            }
        }
        for habit in &mut growth.order {
            let [foot, top] = &mut habit.tip_deg;
            toward(foot, self.tip_deg.map(|young| young[0]));
            toward(top, self.tip_deg.map(|young| young[1]));
        }
    }
}

impl Species {
    /// How much a tree's height is of a grown one's.
    fn height_share(&self, height_m: f32) -> f32 {
        height_m / self.size.height_m.max(0.1)
    }

    /// How twigs of a tree of that height hang: those of small ones little.
    pub fn droop_at(&self, height_m: f32) -> f32 {
        let grown = self.young.grown(self.height_share(height_m));
        let own = self.foliage.droop;
        let droop = self.young.droop.filter(|_| grown < 1.0).map_or(own, |d| mix(d, own, grown));
        if droop > 0.0 { droop * (1.0 - 0.8 * youth(height_m)) } else { droop }
    }

    /// Foliage of a tree of that height: a small one has short twigs.
    pub fn foliage_at(&self, height_m: f32) -> Foliage {
        Foliage { droop: self.droop_at(height_m), ..self.foliage.within(0.3 * height_m) }
    }

    /// The species with the foliage of its trees of that height.
    #[must_use]
    pub fn in_leaf_at(&self, height_m: f32) -> Species {
        Species { foliage: self.foliage_at(height_m), ..self.clone() }
    }

    /// The species as its trees of that height are, their crown's base among it.
    #[must_use]
    pub fn at_height(&self, height_m: f32) -> Species {
        let height_share = self.height_share(height_m);
        let grown = self.young.grown(height_share);
        let mut of_height = self.clone();
        self.young.size(&mut of_height.size, height_share, grown);
        if grown < 1.0 {
            self.young.growth(&mut of_height.growth, grown);
        }
        of_height
    }
}

#[cfg(test)]
mod tests {
    use crate::species::{Species, load_text};

    fn species() -> Species {
        let text = "extends = 'table3/13'
            [size]
            height_m = 20
            crown_base = 0.6
            profile = [[0, 0.4], [0.5, 1.0], [1, 0.2]]
            [growth]
            internodes = 4
            hang = 40
            bare = 0.8
            [[growth.order]]
            irregular = 0.5
            curve_deg = [0, 0]
            tip_deg = [-30, -20]
            length = 1
            flat = 0
            keep = 0.5
            [foliage]
            droop = 0.6
            [young]
            until = [0.2, 0.6]
            crown_base = 0.1
            crown_width = 0.5
            profile = [[0, 1.0], [1, 0.0]]
            internodes = 8
            bare = 0.2
            angle_deg = [60, 40]
            keep = 1
            tip_deg = [10, 20]
            hang = 8
            droop = 0.2";
        load_text("pine", text).unwrap()
    }

    #[test]
    fn young_trees_are_as_the_file_says_grown_ones_as_ever_and_others_between() {
        let grown = species();
        let young = grown.at_height(3.0);
        assert_eq!((young.size.crown_base, young.growth.internodes), (0.1, 8));
        assert_eq!(young.size.crown_diameter_m, 0.5 * grown.size.crown_diameter_m);
        assert_eq!((young.growth.bare, young.growth.order[0].keep), (0.2, 1.0));
        assert_eq!(young.growth.order[0].angle_deg, Some([60.0, 40.0]));
        assert_eq!(young.size.profile, [[0.0, 1.0], [0.5, 0.5], [1.0, 0.0]]);
        assert_eq!((young.growth.hang, young.growth.order[0].tip_deg), (8.0, [10.0, 20.0]));
        assert_eq!((grown.droop_at(4.0), grown.droop_at(12.0)), (0.2, 0.6));
        assert_eq!(young.growth.stem, grown.growth.stem, "what it does not say stays");
        let between = grown.at_height(8.0);
        assert_eq!((between.growth.internodes, between.growth.order[0].keep), (6, 0.75));
        assert!((between.size.profile[1][1] - 0.75).abs() < 1e-6);
        let [foot, top] = between.growth.order[0].tip_deg;
        let off = [(between.growth.hang, 24.0), (foot, -10.0), (top, 0.0)].map(|(a, b)| a - b);
        assert!(off.iter().all(|off: &f32| off.abs() < 1e-4), "{off:?}");
        assert!((grown.droop_at(8.0) - 0.4).abs() < 1e-6);
        for height_m in [20.0, 12.0, 30.0] {
            assert_eq!(grown.at_height(height_m).growth, grown.growth);
        }
        for height_m in [20.0, 30.0] {
            assert_eq!(grown.at_height(height_m).size, grown.size);
        }
    }

    #[test]
    fn without_a_word_young_trees_keep_their_lower_branches() {
        let text = "extends = 'table3/13'\n[size]\nheight_m = 16\ncrown_base = 0.6";
        let species = load_text("any", text).unwrap();
        for height_m in [1.0, 4.0, 7.3, 11.9, 16.0f32] {
            let lifted = species.size.crown_base * (height_m / 16.0).sqrt();
            assert_eq!(species.at_height(height_m).size.crown_base, lifted, "to the bit");
        }
        assert_eq!(species.at_height(4.0).growth, species.growth);
    }
}
