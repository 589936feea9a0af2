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

/// Refuses what no line of a report can hold: nothing, and more than a line.
pub fn a_name(key: &str, node: &Node, sources: &Sources, errors: &mut Vec<Error>) {
    let Some(name) = node.as_text() else { return };
    let fault = if name.trim().is_empty() {
        "is empty"
    } else if name.trim().contains(|c: char| c.is_control() && c != '\t') {
        "is more than one line"
    } else {
        return;
    };
    let error = sources.error(&node.place, format!("`{key}` {fault}"), "here");
    errors.push(error.remedy(format!("give one line, or leave `{key}` out")));
}

/// The numbers that a key may hold.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Range {
    Within(f64, f64),
    /// Above 0, up to a greatest.
    AboveZero(f64),
    /// Pairs (place, factor): places from 0 to this, factors from 0 to [`MAX_FACTOR`].
    Factors(f64),
}
use Range::{AboveZero, Factors, Within};

/// Greatest factor of a decay.
pub const MAX_FACTOR: f64 = 100.0;

/// The range of every number outside `[rule]`, by its way through the file. Keys of a list hold
/// for each number in it. The schema shows the same.
pub const RANGES: &[(&str, Range)] = &[
    ("luminance", Within(0.0, 255.0)),
    ("size.height_m", Within(0.1, 130.0)),
    ("size.crown_diameter_m", AboveZero(100.0)),
    ("size.age_years", AboveZero(5000.0)),
    ("size.crown_base", Within(0.0, 0.95)),
    ("size.stem_diameter_m", AboveZero(20.0)),
    ("size.profile", Within(0.0, 1.0)),
    ("growth.decay", Within(-1000.0, 1000.0)),
    ("growth.decay_by.height", Factors(1.0)),
    ("growth.decay_by.azimuth_deg", Factors(360.0)),
    ("growth.decay_by.light", Factors(1.0)),
    ("growth.tropism", Within(-360.0, 360.0)),
    ("growth.wander", Within(0.0, 360.0)),
    ("growth.step", AboveZero(100.0)),
    ("growth.influence", AboveZero(1000.0)),
    ("growth.kill", AboveZero(1000.0)),
    ("growth.pipe_exponent", Within(1.0, 4.0)),
    ("growth.tip_radius_m", AboveZero(0.5)),
    ("growth.internodes", Within(1.0, 200.0)),
    ("growth.roll_deg", Within(-360.0, 360.0)),
    ("growth.whorl", Within(1.0, 20.0)),
    ("growth.spread", Within(0.0, 1.0)),
    ("growth.stem", Within(0.0, 1.0)),
    ("growth.uneven", Within(0.0, 1.0)),
    ("growth.bare", Within(0.0, 1.0)),
    ("growth.fill", Within(0.0, 1.0)),
    ("growth.inertia", Within(0.0, 10.0)),
    ("growth.outward", Within(0.0, 10.0)),
    ("growth.hang", Within(-360.0, 360.0)),
    ("growth.order.angle_deg", Within(0.0, 180.0)),
    ("growth.order.irregular", Within(0.0, 1.0)),
    ("growth.order.curve_deg", Within(-360.0, 360.0)),
    ("growth.order.tip_deg", Within(-360.0, 360.0)),
    ("growth.order.length", Within(0.0, 20.0)),
    ("growth.order.flat", Within(0.0, 1.0)),
    ("growth.order.keep", Within(0.0, 1.0)),
    ("young.until", Within(0.0, 1.0)),
    ("young.crown_base", Within(0.0, 0.95)),
    ("young.crown_width", AboveZero(5.0)),
    ("young.profile", Within(0.0, 1.0)),
    ("young.internodes", Within(1.0, 200.0)),
    ("young.stem", Within(0.0, 1.0)),
    ("young.uneven", Within(0.0, 1.0)),
    ("young.bare", Within(0.0, 1.0)),
    ("young.angle_deg", Within(0.0, 180.0)),
    ("young.irregular", Within(0.0, 1.0)),
    ("young.keep", Within(0.0, 1.0)),
    ("young.tip_deg", Within(-360.0, 360.0)),
    ("young.hang", Within(-360.0, 360.0)),
    ("young.droop", Within(-1.0, 1.0)),
    ("foliage.leaf_length_m", Within(0.001, 5.0)),
    ("foliage.leaf_width_m", Within(0.0001, 5.0)),
    ("foliage.cluster", Within(1.0, 200.0)),
    ("foliage.variation", Within(0.0, 1.0)),
    ("foliage.twig_length_m", Within(0.01, 10.0)),
    ("foliage.twigs_per_m", AboveZero(1000.0)),
    ("foliage.droop", Within(-1.0, 1.0)),
    ("foliage.cover", Within(0.0, 1.0)),
    ("foliage.bearing_radius_m", Within(0.0, 10.0)),
    ("fruit.length_m", Within(0.001, 1.0)),
    ("fruit.per_m", Within(0.0, 200.0)),
    ("fruit.droop", Within(-1.0, 1.0)),
    ("fruit.from", Within(0.0, 1.0)),
    ("season.winter_leaves", Within(0.0, 1.0)),
    ("season.autumn_leaves", Within(0.0, 1.0)),
    ("bark.upper_from", Within(0.0, 1.0)),
    ("bark.twig_radius_m", Within(0.0, 1.0)),
    ("bark.relief_m", Within(0.0, 0.5)),
    ("bark.coarseness", Within(0.5, 2.0)),
    ("bark.lost", Within(0.0, 1.0)),
];

/// Sizes over the height of the tree: no plant is more slender or more squat.
const SHARES_OF_HEIGHT: [(&str, [f64; 2]); 2] =
    [("size.stem_diameter_m", [0.001, 1.0]), ("size.crown_diameter_m", [0.005, 20.0])];

impl Range {
    /// What is wrong with a number outside, and what to give instead.
    fn fault(self, x: f64) -> Option<(String, String)> {
        let (is_inside, wrong, remedy) = match self {
            Within(low, high) => (
                (low..=high).contains(&x),
                format!("outside {low} to {high}"),
                format!("give a number from {low} to {high}"),
            ),
            AboveZero(high) => (
                x > 0.0 && x <= high,
                format!("not above 0 and up to {high}"),
                format!("give a number above 0, at most {high}"),
            ),
            Factors(_) => return None,
        };
        (x.is_finite() && !is_inside).then_some((wrong, remedy))
    }
}

/// All that a dotted way leads to, through every item of the lists on it.
fn reached<'a>(merged: &'a Node, way: &str) -> Vec<&'a Node> {
    let mut nodes = vec![merged];
    for key in way.split('.') {
        nodes = nodes.into_iter().flat_map(items).filter_map(|node| node.get(key)).collect();
    }
    nodes.into_iter().flat_map(items).flat_map(items).collect()
}

/// The items of a list; anything else alone.
fn items(node: &Node) -> &[Node] {
    match &node.value {
        Value::Array(items) => items,
        _ => std::slice::from_ref(node),
    }
}

/// Checks every number of the sections against its range, and lists against each other.
pub fn ranges(species: &Species, merged: &Node, sources: &Sources, errors: &mut Vec<Error>) {
    for (way, range) in RANGES {
        let key = way.rsplit('.').next().unwrap_or(way);
        for node in reached(merged, way) {
            if let Some(x) = node.as_number()
                && let Some((wrong, remedy)) = range.fault(x)
            {
                let message = format!("`{key}` is {x}, {wrong}");
                errors.push(sources.error(&node.place, message, "here").remedy(remedy));
            }
        }
    }
    shares_of_height(merged, sources, errors);
    let mut fail = |way: &str, message: String, remedy: &str| {
        let node = way.split('.').try_fold(merged, |node, key| node.get(key)).unwrap_or(merged);
        errors.push(sources.error(&node.place, message, "here").remedy(remedy));
    };
    if let Some([low, high]) = species.luminance
        && low > high
    {
        fail(
            "luminance",
            format!("`luminance` [{low}, {high}] is not a range"),
            "give the least and the greatest luminance, 0 to 255",
        );
    }
    let young = species.young.profile.as_ref();
    for (way, profile) in [("size.profile", Some(&species.size.profile)), ("young.profile", young)]
    {
        if let Some((message, remedy)) = profile.and_then(|profile| fault_of_profile(profile)) {
            fail(way, message, remedy);
        }
    }
    let [low, high] = species.young.until;
    if low > high {
        fail(
            "young.until",
            format!("`until` [{low}, {high}] is not a range"),
            "give up to which height a tree is young and from which it is grown, 0 to 1",
        );
    }
    let [low, high] = species.bark.upper_from;
    if low > high {
        fail(
            "bark.upper_from",
            format!("`upper_from` [{low}, {high}] is not a range"),
            "give where the upper bark begins and where it is alone, 0 to 1",
        );
    }
    if species.growth.decay.is_empty() {
        fail(
            "growth.decay",
            "`decay` is empty".into(),
            "give one number an iteration; `[0.0]` for no decay",
        );
    }
    let by = &species.growth.decay_by;
    for (key, pairs) in
        [("height", &by.height), ("azimuth_deg", &by.azimuth_deg), ("light", &by.light)]
    {
        let way = format!("growth.decay_by.{key}");
        let end = RANGES.iter().find_map(|(w, range)| match range {
            Factors(end) if *w == way => Some(*end),
            _ => None,
        });
        if let Some((message, remedy)) = fault_of_factors(key, pairs, end.unwrap_or(1.0)) {
            fail(&way, message, &remedy);
        }
    }
    if species.own_model.is_some() && species.own_picture.is_some() {
        fail(
            "foliage.picture",
            "`model` and `picture` are both given".into(),
            "keep one; `model = ''` takes away that of a file this one extends",
        );
    }
    if species.growth.order.is_empty() {
        fail(
            "growth.order",
            "`order` is empty".into(),
            "give one [[growth.order]] for each branching order, at least one",
        );
    }
}

/// Refuses sizes that no tree of that height has, of those within their own ranges.
fn shares_of_height(merged: &Node, sources: &Sources, errors: &mut Vec<Error>) {
    let in_range = |way: &str| {
        let range = RANGES.iter().find(|r| r.0 == way)?.1;
        let node = reached(merged, way).into_iter().next()?;
        let x = node.as_number().filter(|x| x.is_finite() && range.fault(*x).is_none())?;
        Some((x, &node.place, range))
    };
    let Some((height_m, height_at, _)) = in_range("size.height_m") else { return };
    for (way, shares) in SHARES_OF_HEIGHT {
        let Some((x, size_at, range)) = in_range(way) else { continue };
        let key = way.rsplit('.').next().unwrap_or(way);
        let [low, high] = shares.map(|share| share * height_m);
        // One of another file is as it was there.
        if (low..=high).contains(&x) || height_at.source != size_at.source {
            continue;
        }
        let most = if let AboveZero(most) = range { most } else { f64::INFINITY };
        let [low, high] = [low, high.min(most)].map(|m| m as f32);
        let remedy = format!("give a number from {low} to {high}, or another `height_m`");
        let message = format!("`{key}` is {x}, of a tree {height_m} m high");
        errors.push(sources.error(size_at, message, "here").remedy(remedy));
    }
}

/// What is wrong with an outline of a crown.
fn fault_of_profile(profile: &[[f32; 2]]) -> Option<(String, &'static str)> {
    if profile.len() < 2 || !profile.iter().any(|p| p[1] > 0.0) {
        return Some((
            "`profile` needs two points or more, one with a radius above 0".into(),
            "give pairs [height, radius] from [0.0, …] to [1.0, …]",
        ));
    }
    let w = profile.windows(2).find(|w| w[1][0] <= w[0][0])?;
    Some((
        format!("`profile` does not rise: height {} follows {}", w[1][0], w[0][0]),
        "order the pairs [height, radius] from the crown's base to its top",
    ))
}

/// What is wrong with pairs (place, factor), whose places must rise within 0 to `end`.
fn fault_of_factors(key: &str, pairs: &[[f32; 2]], end: f64) -> Option<(String, String)> {
    let outside = |p: &&[f32; 2]| {
        let [place, factor] = p.map(f64::from);
        place.is_finite()
            && factor.is_finite()
            && !((0.0..=end).contains(&place) && (0.0..=MAX_FACTOR).contains(&factor))
    };
    if pairs.is_empty() {
        return Some((
            format!("`{key}` is empty"),
            "give pairs [place, factor]; `[[0.0, 1.0]]` for no change".into(),
        ));
    }
    if let Some([place, factor]) = pairs.iter().find(outside) {
        return Some((
            format!("`{key}` has a pair out of range: [{place}, {factor}]"),
            format!("give places from 0 to {end} and factors from 0 to {MAX_FACTOR}"),
        ));
    }
    let w = pairs.windows(2).find(|w| w[1][0] <= w[0][0])?;
    Some((
        format!("`{key}` does not rise: {} follows {}", w[1][0], w[0][0]),
        "order the pairs [place, factor] by their places".into(),
    ))
}
