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

/// Greatest factor of a decay.
const MAX_FACTOR: f32 = 100.0;

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

    /// Pairs (place, factor) with places rising within 0 to `end`.
    fn factors(&mut self, path: &[&str], pairs: &[[f32; 2]], end: f32) {
        let key = path.last().copied().unwrap_or_default();
        let outside = |p: &&[f32; 2]| {
            p.iter().all(|x| x.is_finite())
                && !((0.0..=end).contains(&p[0]) && (0.0..=MAX_FACTOR).contains(&p[1]))
        };
        if pairs.is_empty() {
            let remedy = "give pairs [place, factor]; `[[0.0, 1.0]]` for no change";
            self.fail(path, format!("`{key}` is empty"), remedy);
        } else if let Some([place, factor]) = pairs.iter().find(outside) {
            self.fail(
                path,
                format!("`{key}` has a pair out of range: [{place}, {factor}]"),
                &format!("give places from 0 to {end} and factors from 0 to {MAX_FACTOR}"),
            );
        } else if let Some(w) = pairs.windows(2).find(|w| w[1][0] <= w[0][0]) {
            self.fail(
                path,
                format!("`{key}` does not rise: {} follows {}", w[1][0], w[0][0]),
                "order the pairs [place, factor] by their places",
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
    r.above_zero("size", "age_years", s.age_years, 5000.0);
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
    let by = &g.decay_by;
    r.factors(&["growth", "decay_by", "height"], &by.height, 1.0);
    r.factors(&["growth", "decay_by", "azimuth_deg"], &by.azimuth_deg, 360.0);
    r.factors(&["growth", "decay_by", "light"], &by.light, 1.0);
    r.within("growth", "tropism", g.tropism, -360.0, 360.0);
    r.within("growth", "wander", g.wander, 0.0, 360.0);
    r.above_zero("growth", "step", g.step, 100.0);
    r.above_zero("growth", "influence", g.influence, 1000.0);
    r.above_zero("growth", "kill", g.kill, 1000.0);
    r.within("growth", "pipe_exponent", g.pipe_exponent, 1.0, 6.0);
    r.above_zero("growth", "tip_radius_m", g.tip_radius_m, 0.5);
    r.within("growth", "internodes", g.internodes as f32, 1.0, 200.0);
    r.within("growth", "roll_deg", g.roll_deg, -360.0, 360.0);
    r.within("growth", "whorl", g.whorl as f32, 1.0, 20.0);
    for (key, value) in [
        ("spread", g.spread),
        ("stem", g.stem),
        ("uneven", g.uneven),
        ("bare", g.bare),
        ("fill", g.fill),
    ] {
        r.within("growth", key, value, 0.0, 1.0);
    }
    r.within("growth", "inertia", g.inertia, 0.0, 10.0);
    r.within("growth", "outward", g.outward, 0.0, 10.0);
    r.within("growth", "hang", g.hang, -360.0, 360.0);
    if g.order.is_empty() {
        r.fail(
            &["growth", "order"],
            "`order` is empty".into(),
            "give one [[growth.order]] for each branching order, at least one",
        );
    }
    for (i, h) in g.order.iter().enumerate() {
        let angles = h.angle_deg.iter().flatten().all(|a| (0.0..=180.0).contains(a));
        let curves = h.curve_deg.iter().chain(&h.tip_deg).all(|c| c.abs() <= 360.0);
        let shares = [h.irregular, h.flat, h.keep].iter().all(unit);
        if !(angles && curves && shares && (0.0..=20.0).contains(&h.length)) {
            r.fail(
                &["growth", "order"],
                format!("[[growth.order]] number {} has a value out of range", i + 1),
                "angle_deg 0 to 180, curve_deg and tip_deg -360 to 360, length 0 to 20, \
                 irregular, flat and keep 0 to 1",
            );
        }
    }
    let f = &species.foliage;
    r.above_zero("foliage", "leaf_length_m", f.leaf_length_m, 5.0);
    r.above_zero("foliage", "leaf_width_m", f.leaf_width_m, 5.0);
    r.within("foliage", "variation", f.variation, 0.0, 1.0);
    r.above_zero("foliage", "twig_length_m", f.twig_length_m, 10.0);
    r.within("foliage", "twigs_per_m", f.twigs_per_m, 0.0, 1000.0);
    r.within("foliage", "droop", f.droop, -1.0, 1.0);
    r.within("foliage", "bearing_radius_m", f.bearing_radius_m, 0.0, 10.0);
    r.within("foliage", "cover", f.cover, 0.0, 1.0);
    r.within("bark", "relief_m", species.bark.relief_m, 0.0, 0.5);
}
