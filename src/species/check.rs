//! Values that have the right type and make no sense, each at its place.

use super::model::Species;
use super::node::{Node, Sources, Value};
use crate::diagnostic::Error;

/// Refuses NaN and infinity anywhere.
pub fn finite(node: &Node, sources: &Sources, errors: &mut Vec<Error>) {
    let mut rest = vec![node];
    while let Some(node) = rest.pop() {
        match &node.value {
            Value::Float(x) if !x.is_finite() => errors.push(
                sources
                    .error(&node.place, "not a finite number", "here")
                    .remedy("give an ordinary number"),
            ),
            Value::Array(items) => rest.extend(items.iter().rev()),
            Value::Table(entries) => rest.extend(entries.iter().rev().map(|e| &e.node)),
            _ => {}
        }
    }
}

struct Ranges<'a> {
    merged: &'a Node,
    sources: &'a Sources,
    errors: &'a mut Vec<Error>,
}

impl Ranges<'_> {
    fn fail(&mut self, path: &[&str], message: String, remedy: &str) {
        let mut node = self.merged;
        for key in path {
            match node.get(key) {
                Some(next) => node = next,
                None => break,
            }
        }
        self.errors.push(self.sources.error(&node.place, message, "here").remedy(remedy));
    }

    /// `value` must lie in `low..=high`.
    fn within(&mut self, section: &str, key: &str, value: f32, low: f32, high: f32) {
        if value.is_finite() && !(low..=high).contains(&value) {
            self.fail(
                &[section, key],
                format!("`{key}` is {value}, outside {low} to {high}"),
                &format!("give a number from {low} to {high}"),
            );
        }
    }

    /// `value` must lie above 0 and not above `high`.
    fn above_zero(&mut self, section: &str, key: &str, value: f32, high: f32) {
        if value.is_finite() && !(value > 0.0 && value <= high) {
            self.fail(
                &[section, key],
                format!("`{key}` is {value}, not above 0 and up to {high}"),
                &format!("give a number above 0, at most {high}"),
            );
        }
    }
}

/// Checks every number of the sections against its range.
pub fn ranges(species: &Species, merged: &Node, sources: &Sources, errors: &mut Vec<Error>) {
    let mut r = Ranges { merged, sources, errors };
    if let Some([low, high]) = species.luminance
        && !(0.0 <= low && low <= high && high <= 255.0)
    {
        r.fail(
            &["luminance"],
            format!("`luminance` [{low}, {high}] is not a range"),
            "give the least and the greatest luminance, 0 to 255",
        );
    }
    let s = &species.size;
    r.above_zero("size", "height_m", s.height_m, 150.0);
    r.above_zero("size", "crown_diameter_m", s.crown_diameter_m, 100.0);
    r.within("size", "crown_base", s.crown_base, 0.0, 0.95);
    r.above_zero("size", "stem_diameter_m", s.stem_diameter_m, 20.0);
    let unit = |x: &f32| (0.0..=1.0).contains(x);
    if s.profile.len() < 2 || !s.profile.iter().any(|p| p[1] > 0.0) {
        r.fail(
            &["size", "profile"],
            "`profile` needs two points or more, one with a radius above 0".into(),
            "give pairs [height, radius] from [0.0, …] to [1.0, …]",
        );
    }
    if let Some(p) = s.profile.iter().find(|p| !p.iter().all(unit)) {
        r.fail(
            &["size", "profile"],
            format!("`profile` point [{}, {}] is outside 0 to 1", p[0], p[1]),
            "give height and radius as parts of the crown's, 0 to 1",
        );
    }
    if let Some(w) = s.profile.windows(2).find(|w| w[1][0] <= w[0][0]) {
        r.fail(
            &["size", "profile"],
            format!("`profile` does not rise: height {} follows {}", w[1][0], w[0][0]),
            "order the pairs [height, radius] from the crown's base to its top",
        );
    }
    let g = &species.growth;
    if g.decay.is_empty() {
        r.fail(
            &["growth", "decay"],
            "`decay` is empty".into(),
            "give one number an iteration; `[0.0]` for no decay",
        );
    }
    r.within("growth", "tropism", g.tropism, -360.0, 360.0);
    r.within("growth", "wander", g.wander, 0.0, 360.0);
    r.above_zero("growth", "step", g.step, 100.0);
    r.above_zero("growth", "influence", g.influence, 1000.0);
    r.above_zero("growth", "kill", g.kill, 1000.0);
    r.within("growth", "pipe_exponent", g.pipe_exponent, 1.0, 6.0);
    r.above_zero("growth", "tip_radius_m", g.tip_radius_m, 0.5);
    let f = &species.foliage;
    r.above_zero("foliage", "leaf_length_m", f.leaf_length_m, 5.0);
    r.above_zero("foliage", "leaf_width_m", f.leaf_width_m, 5.0);
    r.within("foliage", "variation", f.variation, 0.0, 1.0);
    r.above_zero("foliage", "twig_length_m", f.twig_length_m, 10.0);
    r.within("foliage", "twigs_per_m", f.twigs_per_m, 0.0, 1000.0);
    r.within("foliage", "droop", f.droop, -1.0, 1.0);
    r.within("foliage", "bearing_radius_m", f.bearing_radius_m, 0.0, 10.0);
    r.within("bark", "relief_m", species.bark.relief_m, 0.0, 0.5);
}
