//! What rules, turtle, space colonization and radii do at the edge of their numbers: one list of
//! cases, which tests run, `docs/stability.md` prints and a report may show. Every case measures
//! how far the outcome is from what it should be, so that smaller is better and 0 is exact.

use std::fmt::Write;
use std::panic::catch_unwind;
use std::time::Instant;

use glam::{DMat3, DVec3, Vec3};

use super::colonize::{Colonized, Habit, Limits, MAX_CHILDREN, Reach, Start, colonize};
use super::derive::{Inputs, ModuleString, derive};
use super::radii::{Pipes, radii, radius_at};
use super::surroundings::{Neighbour, Open, Space, Surroundings, Wall};
use super::turtle::{Pose, Scaffold, draw};
use super::{Detail, NO_PARENT, Target, grow};
use crate::diagnostic::{Error, Result};
use crate::frame::Frame;
use crate::seed::Seed;
use crate::species;
use crate::species::rule::{Axis, Dialect, Rule};

/// One case: what is tried, what should come of it, and how to measure the miss.
#[derive(Clone, Copy)]
pub struct Case {
    pub name: &'static str,
    pub expectation: &'static str,
    pub unit: &'static str,
    /// Greatest miss that passes.
    pub limit: f64,
    measure: fn() -> Result<f64>,
}

impl Case {
    /// `measure` gives how far the outcome is from the expectation; an error misses by all.
    pub const fn new(
        name: &'static str,
        expectation: &'static str,
        (limit, unit): (f64, &'static str),
        measure: fn() -> Result<f64>,
    ) -> Case {
        Case { name, expectation, unit, limit, measure }
    }
}

/// The outcome of a case.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct Finding {
    pub name: &'static str,
    pub expectation: &'static str,
    /// Infinite where the case failed with an error.
    pub measured: f64,
    pub unit: &'static str,
    pub limit: f64,
    pub seconds: f64,
    /// The error that ended the case.
    pub ended_by: Option<String>,
}

impl Finding {
    pub fn passes(&self) -> bool {
        self.measured <= self.limit
    }
}

impl Case {
    pub fn run(&self) -> Finding {
        let start = Instant::now();
        // A panic is a miss of its own, and no end of the others.
        let outcome = catch_unwind(self.measure).unwrap_or_else(|_| Err(Error::new("a panic")));
        let seconds = start.elapsed().as_secs_f64();
        let Case { name, expectation, unit, limit, .. } = *self;
        let (measured, ended_by) = match outcome {
            Ok(measured) => (measured, None),
            Err(error) => (f64::INFINITY, Some(error.message().to_owned())),
        };
        Finding { name, expectation, measured, unit, limit, seconds, ended_by }
    }
}

/// Runs all cases, one after another.
pub fn run() -> Vec<Finding> {
    cases().iter().map(Case::run).collect()
}

/// The findings as a table in Markdown.
pub fn table(findings: &[Finding]) -> String {
    let mut out = String::from("| case | expectation | measured | limit |\n|---|---|---|---|\n");
    for f in findings {
        let (name, expectation, unit) = (f.name, f.expectation, f.unit);
        let number = |x: f64| match x {
            x if x == x.trunc() && x.abs() < 1e6 => format!("{x}"),
            x => format!("{x:.1e}"),
        };
        let (measured, limit) = (number(f.measured), number(f.limit));
        let _ = writeln!(out, "| {name} | {expectation} | {measured} {unit} | {limit} |");
    }
    out
}

/// All cases.
pub fn cases() -> Vec<Case> {
    macro_rules! case {
        ($name:literal, $expectation:literal, $limit:literal $unit:literal, $measure:expr) => {
            Case {
                name: $name,
                expectation: $expectation,
                unit: $unit,
                limit: $limit,
                measure: $measure,
            }
        };
    }
    vec![
        case!("turtle frame after 10⁶ turns about three axes", "orthonormal",
            1e-5 "off the unit matrix", million_turns),
        case!("a full turn in 10⁶ steps", "ends where it began", 1e-9 "off the first frame", full_turn),
        case!("brackets nested 10⁵ deep", "all drawn, on the heap", 0.0 "nodes missing", deep_brackets),
        case!("a production that doubles for ever", "stops at the module limit and names the production",
            0.0 "answers without it", endless_doubling),
        case!("a production that shrinks for ever", "ends, with shoots that still are numbers",
            0.0 "nodes unsound", endless_shrinking),
        case!("α at and beyond its pole: lengths of 0 and below", "such shoots are not grown", 0.0 "nodes too many", negative_lengths),
        case!("division by an L_apex of 10⁻³⁰⁰", "shoots without a length, or an error that names the production",
            0.0 "nodes unsound", tiny_apex),
        case!("α of ±10³ in a species, the most a rule file may say", "a sound tree of its height", 0.02 "of the height", wild_decay),
        case!("lengths of 0 and 1 : 10⁶", "no node for 0, none lost beside 10⁶", 1e-6 "of the height", length_ratios),
        case!("angles of 0, 90, 180 and 360°", "exact places", 1e-6 "m", special_angles),
        case!("first shoot of 10⁻⁶ and 10⁶ m", "the same tree to scale", 1e-6 "of the height", scales),
        case!("attractors all in one point", "reached, then removed", 0.0 "left", one_point),
        case!("attractors on a line", "all reached", 0.0 "left", on_a_line),
        case!("attractors in a plane", "nearly all reached", 0.01 "of them left", in_a_plane),
        case!("attractors even about a node: pair, ring, sphere", "growth does not stall",
            0.05 "of them left", symmetric),
        case!("two attractors between which a node could swing", "ends within a few nodes", 9.0 "nodes", swing),
        case!("attractors 1 km away", "counted, and no node grown towards them", 0.0 "miscounted", far_away),
        case!("attractors that are not numbers", "left out", 0.0 "nodes unsound", not_numbers),
        case!("D, d_k, d_i in all six orders, at three magnitudes", "brought to order, growth ends",
            0.05 "of them left", all_orders),
        case!("a kill distance of 1/1000 and of 1000 times the step", "brought to order, growth ends with all reached",
            0.05 "of them left", kill_distances),
        case!("attractors in 30 places around one node", "no more children than a node may have",
            0.0 "children too many", many_children),
        case!("nodes that would fall on others", "not grown", 0.0 "in one place", duplicates),
        case!("wall, ground and neighbour about a crown", "nothing grows into them", 0.0 "nodes inside", obstacles),
        case!("UTM coordinates of 6 million metres", "millimetres kept", 5e-4 "m", utm),
        case!("radii from pipes of 10⁻⁶ to 10³ m", "never thicker than the parent, breast height kept",
            1e-5 "off at breast height", pipes),
    ]
}

fn rule(section: &str) -> Result<Rule> {
    Ok(species::load_text("stability", &format!("[rule]\n{section}"))?.rule)
}

fn derived(rule: &Rule) -> Result<ModuleString> {
    derive(rule, &Inputs::new(Seed::new(1)))
}

fn drawn(section: &str) -> Result<Scaffold> {
    let rule = rule(section)?;
    let scaffold = draw(&rule, &derived(&rule)?)?;
    scaffold.check().map_err(Error::new)?;
    Ok(scaffold)
}

fn off_identity(m: DMat3) -> f64 {
    (m - DMat3::IDENTITY).to_cols_array().iter().fold(0.0, |worst, x| f64::max(worst, x.abs()))
}

fn million_turns() -> Result<f64> {
    let mut pose = Pose::new(Dialect::Upright);
    let mut draws = Seed::new(3).draws();
    for axis in [Axis::H, Axis::L, Axis::U].into_iter().cycle().take(1_000_000) {
        pose.turn(axis, f64::from(draws.between(-3.0, 3.0)));
    }
    let frame = pose.frame();
    Ok(off_identity(frame.transpose() * frame))
}

fn full_turn() -> Result<f64> {
    let mut pose = Pose::new(Dialect::Upright);
    for _ in 0..1_000_000 {
        pose.turn(Axis::L, std::f64::consts::TAU / 1e6);
    }
    Ok(off_identity(pose.frame()))
}

fn deep_brackets() -> Result<f64> {
    let deep = 100_000;
    let axiom = format!("F{}{}", "[+F".repeat(deep), "]".repeat(deep));
    let drawn = drawn(&format!(
        "turtle = 'heading'\niterations = 0\nangles = {{ delta = 90 }}\naxiom = '{axiom}'"
    ))?;
    Ok(drawn.len().abs_diff(deep + 2) as f64)
}

fn endless_doubling() -> Result<f64> {
    let rule = rule("axiom = 'F(a)'\niterations = 64\nproductions = ['F(a) -> F(a)F(a)']")?;
    let inputs = Inputs { module_limit: 1_000_000, ..Inputs::new(Seed::new(1)) };
    let is_named = derive(&rule, &inputs).is_err_and(|e| e.message().contains("F(a) -> F(a)F(a)"));
    Ok(f64::from(!is_named))
}

fn endless_shrinking() -> Result<f64> {
    let drawn = drawn("axiom = 'F(a)'\niterations = 64\nproductions = ['F(a) -> F(a * 1e-6)']")?;
    Ok(drawn.position.iter().filter(|p| !p.is_finite()).count() as f64)
}

/// r of 0 to 3 m below an apex with shoots of 1 m, α = 0.5 m²: the last three of seven have no
/// length.
fn negative_lengths() -> Result<f64> {
    let side = |r: f64| format!("[^F(a - 0.5 / a * {r:.1})]");
    let sides: String = (0..7).map(|i| side(0.5 * f64::from(i))).collect();
    let drawn =
        drawn(&format!("axiom = 'F(a){sides}'\niterations = 0\nangles = {{ alpha = 30 }}"))?;
    Ok(drawn.len().abs_diff(1 + 1 + 4) as f64)
}

fn tiny_apex() -> Result<f64> {
    let mut unsound = 0;
    for production in ["F(a) -> F(a)[^F(a - 0.5 / (a * 1e-300))]", "F(a) -> F(a)[^F(a / (a - a))]"]
    {
        let rule = rule(&format!(
            "axiom = 'F(a)'\niterations = 2\nangles = {{ alpha = 30 }}\nproductions = ['{production}']"
        ))?;
        match derived(&rule).and_then(|string| draw(&rule, &string)) {
            Ok(drawn) => unsound += drawn.position.iter().filter(|p| !p.is_finite()).count(),
            Err(error) => unsound += usize::from(!error.message().contains(production)),
        }
    }
    Ok(unsound as f64)
}

fn wild_decay() -> Result<f64> {
    let mut worst = 0.0f64;
    for decay in ["1e3", "-1e3", "0.0, 1e3, -1e3"] {
        let text = format!("extends = 'larix_sibirica'\n[growth]\ndecay = [{decay}]");
        let species = species::load_text("stability", &text)?;
        let target = Target::FromSpecies { height_m: Some(12.0) };
        let tree = grow(&species, target, Detail::FOREST, Seed::new(1))?;
        tree.check()?;
        worst = worst.max(f64::from(tree.height_m() / 12.0 - 1.0).abs());
    }
    Ok(worst)
}

fn length_ratios() -> Result<f64> {
    let drawn = drawn("axiom = 'F(0)F(-1)F(a)F(1e-6)F(1e6)'\niterations = 0")?;
    let top = drawn.position.last().map_or(0.0, |p| f64::from(p.z));
    let is_complete = drawn.len() == 4;
    Ok(if is_complete { (top / 1_000_001.0 - 1.0).abs() } else { f64::INFINITY })
}

fn special_angles() -> Result<f64> {
    let mut worst = 0.0f64;
    for (degrees, end) in [
        (0, Vec3::new(0.0, 0.0, 2.0)),
        (90, Vec3::new(-1.0, 0.0, 1.0)),
        (180, Vec3::ZERO),
        (360, Vec3::new(0.0, 0.0, 2.0)),
    ] {
        let drawn = drawn(&format!(
            "axiom = 'F(a)&F(a)'\niterations = 0\nangles = {{ alpha = {degrees} }}"
        ))?;
        let last = drawn.position.last().copied().unwrap_or(Vec3::NAN);
        worst = worst.max(f64::from((last - end).length()));
    }
    Ok(worst)
}

fn scales() -> Result<f64> {
    let rule = species::load("table3/13")?.rule;
    let tree = |a: f64| {
        let inputs = Inputs { first_shoot_m: Some(a), ..Inputs::new(Seed::new(1)) };
        draw(&rule, &derive(&rule, &inputs)?)
    };
    let plain = tree(1.0)?;
    let height = plain.position.iter().map(|p| p.z).fold(0.0, f32::max);
    let mut worst = 0.0f64;
    for a in [1e-6, 1e6] {
        let scaled = tree(a)?;
        if scaled.len() != plain.len() {
            return Ok(f64::INFINITY);
        }
        for (p, q) in scaled.position.iter().zip(&plain.position) {
            let miss = (p.as_dvec3() / a - q.as_dvec3()).length();
            worst = worst.max(miss / f64::from(height));
        }
    }
    Ok(worst)
}

const MOST_NODES: usize = 20_000;

/// Grows from the origin, upwards.
fn colonized<S: Space>(attractors: &[Vec3], distances: [f32; 3], space: &S) -> Colonized {
    let start = Start { position: Vec3::ZERO, heading: Vec3::ZERO, is_open: true };
    let [step_m, kill_m, influence_m] = distances;
    let (reach, _) = Reach::new(step_m, kill_m, influence_m);
    let limits = Limits { max_nodes: MOST_NODES, max_rounds: 2_000, bridges: 1 };
    colonize(&[start], attractors, &reach, &Habit::default(), |_| Vec3::ZERO, space, &limits)
}

fn share_left(attractors: &[Vec3], distances: [f32; 3]) -> f64 {
    colonized(attractors, distances, &Open).left as f64 / attractors.len().max(1) as f64
}

/// Places in a ball about the origin.
fn ball(count: usize, radius_m: f32, seed: u64) -> Vec<Vec3> {
    let mut draws = Seed::new(seed).draws();
    (0..count).map(|_| draws.direction() * (radius_m * draws.unit().cbrt())).collect()
}

fn one_point() -> Result<f64> {
    let grown = colonized(&[Vec3::ONE; 500], [0.2, 0.2, 3.0], &Open);
    // As many nodes as steps lead there.
    Ok((grown.left + grown.position.len().saturating_sub(10)) as f64)
}

fn on_a_line() -> Result<f64> {
    let line: Vec<Vec3> = (0..500).map(|i| Vec3::new(i as f32 * 0.02, 0.5, 0.0)).collect();
    Ok(share_left(&line, [0.2, 0.2, 3.0]))
}

fn in_a_plane() -> Result<f64> {
    let place = |i: i32| Vec3::new((i % 20) as f32 * 0.2, (i / 20) as f32 * 0.2, 1.0);
    Ok(share_left(&(0..400).map(place).collect::<Vec<_>>(), [0.2, 0.2, 3.0]))
}

fn symmetric() -> Result<f64> {
    let around = |i: i32| (Vec3::X * 2.0).rotate_z(std::f32::consts::FRAC_PI_3 * i as f32);
    let ring: Vec<Vec3> = (0..6).map(around).collect();
    let mut draws = Seed::new(8).draws();
    let half: Vec<Vec3> = (0..200).map(|_| draws.direction() * 2.0).collect();
    let sphere: Vec<Vec3> = half.iter().flat_map(|&p| [p, -p]).collect();
    let pair = [Vec3::X * 2.0, Vec3::X * -2.0];
    let left = [
        share_left(&pair, [0.5, 0.4, 6.0]),
        share_left(&ring, [0.3, 0.3, 3.0]),
        share_left(&sphere, [0.3, 0.3, 3.0]),
    ];
    Ok(left.into_iter().fold(0.0, f64::max))
}

fn swing() -> Result<f64> {
    let pair = |gap: f32| [Vec3::new(1.3, gap, 0.0), Vec3::new(1.3, -gap, 0.0)];
    let nodes = |gap: f32| colonized(&pair(gap), [1.0, 0.5, 5.0], &Open).position.len();
    Ok([0.01, 0.3, 0.55, 0.9].map(nodes).into_iter().max().unwrap_or(0) as f64)
}

fn far_away() -> Result<f64> {
    let mut cloud = ball(300, 2.0, 1);
    let near = colonized(&cloud, [0.3, 0.3, 1.0], &Open);
    cloud.extend([Vec3::X * 1000.0, Vec3::Z * 1000.0]);
    let with = colonized(&cloud, [0.3, 0.3, 1.0], &Open);
    let astray = with.position.iter().filter(|p| p.length() > 3.0).count();
    Ok((with.left.abs_diff(near.left + 2) + astray) as f64)
}

fn not_numbers() -> Result<f64> {
    let mut cloud = ball(300, 2.0, 2);
    cloud.extend([Vec3::NAN, Vec3::INFINITY, Vec3::NEG_INFINITY, Vec3::MAX]);
    let grown = colonized(&cloud, [0.3, 0.3, 1.0], &Open);
    Ok(grown.position.iter().filter(|p| !p.is_finite() || p.length() > 3.0).count() as f64)
}

fn all_orders() -> Result<f64> {
    let mut worst = 0.0f64;
    for magnitude in [1e-3f32, 1.0, 1e3] {
        let [a, b, c] = [0.1, 0.35, 1.0].map(|x| x * magnitude);
        let cloud = ball(150, magnitude, 3);
        for order in [[a, b, c], [a, c, b], [b, a, c], [b, c, a], [c, a, b], [c, b, a]] {
            worst = worst.max(share_left(&cloud, order));
        }
    }
    Ok(worst)
}

fn kill_distances() -> Result<f64> {
    let cloud = ball(2_000, 2.0, 5);
    let mut worst = 0.0f64;
    for kill_m in [3e-4, 300.0] {
        let grown = colonized(&cloud, [0.3, kill_m, 1.2], &Open);
        if grown.position.len() >= MOST_NODES {
            return Ok(f64::INFINITY);
        }
        worst = worst.max(grown.left as f64 / cloud.len() as f64);
    }
    Ok(worst)
}

fn many_children() -> Result<f64> {
    let mut draws = Seed::new(11).draws();
    let places: Vec<Vec3> = (0..30).map(|_| draws.direction() * 2.0).collect();
    let around = |p: &Vec3| [0.0, 0.05, -0.05].map(|d| *p + Vec3::splat(d));
    let grown =
        colonized(&places.iter().flat_map(around).collect::<Vec<_>>(), [0.4, 0.3, 3.0], &Open);
    let mut children = vec![0usize; grown.position.len() + 1];
    grown.parent.iter().for_each(|&p| children[p as usize] += 1);
    let most = children.into_iter().max().unwrap_or(0);
    Ok(most.saturating_sub(usize::from(MAX_CHILDREN)) as f64)
}

fn duplicates() -> Result<f64> {
    let mut places: Vec<[u32; 3]> = colonized(&ball(5_000, 4.0, 4), [0.3, 0.3, 1.0], &Open)
        .position
        .iter()
        .map(|p| p.to_array().map(f32::to_bits))
        .collect();
    let all = places.len();
    places.sort_unstable();
    places.dedup();
    Ok((all - places.len()) as f64)
}

fn obstacles() -> Result<f64> {
    let slope = |p: glam::Vec2| 0.3 * p.x - 1.0;
    let wall = Wall::Box {
        centre: Vec3::new(0.0, 2.0, 0.0),
        half_m: Vec3::new(2.0, 0.3, 2.0),
        yaw_rad: 0.4,
    };
    let neighbour = Neighbour {
        root: Vec3::new(3.0, -1.0, -2.0),
        height_m: 8.0,
        crown_base_m: 1.0,
        crown_radius_m: 2.0,
    };
    let space = Surroundings {
        ground: Some(&slope),
        walls: vec![wall],
        crown_radius_m: 3.0,
        neighbours: vec![neighbour],
    };
    let grown = colonized(&ball(3_000, 4.0, 5), [0.3, 0.3, 1.0], &space);
    let inside = grown.position.iter().filter(|&&p| !space.is_free(p)).count();
    Ok(if grown.position.len() > 500 { inside as f64 } else { f64::INFINITY })
}

fn utm() -> Result<f64> {
    let frame = Frame::local(DVec3::new(500_000.0, 6_000_000.0, 0.0));
    let mut draws = Seed::new(6).draws();
    let mut worst = 0.0f64;
    for _ in 0..10_000 {
        let side = |d: f32| (f64::from(d) * 1000.0).round() / 1000.0;
        let (x, y) = (draws.between(-2_000.0, 2_000.0), draws.between(-2_000.0, 2_000.0));
        let offset = DVec3::new(side(x), side(y), side(draws.between(0.0, 100.0)));
        let back = frame.world_from_local(frame.local_from_world(frame.origin + offset));
        worst = worst.max((back - frame.origin - offset).abs().max_element());
    }
    Ok(worst)
}

/// A bole of 30 m with a branch on every metre.
fn pipes() -> Result<f64> {
    let (mut position, mut parent, mut is_stem) = (vec![Vec3::ZERO], vec![NO_PARENT], vec![true]);
    let mut last = 0;
    for i in 1..=30u32 {
        position.push(Vec3::Z * i as f32);
        parent.push(last);
        is_stem.push(true);
        last = position.len() as u32 - 1;
        position.push(Vec3::new(1.0, 0.0, i as f32));
        parent.push(last);
        is_stem.push(false);
    }
    let mut worst = 0.0f64;
    for (tip_radius_m, stem_radius_m) in [(1e-6, 1e-3), (1e-6, 1e3), (1e-3, 0.2), (1.0, 1e3)] {
        for exponent in [1.0, 2.3, 4.0] {
            let pipes = Pipes { exponent, tip_radius_m, stem_radius_m, measured_at_m: 1.3 };
            let radius_m = radii(&position, &parent, &is_stem, &pipes);
            let is_sound = (1..radius_m.len()).all(|i| {
                let carrier = radius_m.get(parent[i] as usize).copied().unwrap_or(0.0);
                radius_m[i] > 0.0 && radius_m[i] <= carrier
            });
            let value: Vec<f64> = radius_m.iter().map(|&r| f64::from(r)).collect();
            let at = radius_at(&position, &parent, &is_stem, 1.3, &value);
            let miss = f64::from(at / stem_radius_m - 1.0).abs();
            worst = worst.max(if is_sound { miss } else { f64::INFINITY });
        }
    }
    Ok(worst)
}

#[cfg(test)]
mod tests {
    use super::*;

    const DOCS: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/docs/stability.md");
    const HEAD: &str = "\
# Numerical stability

What growth does at the edge of its numbers. Each case measures how far the outcome is from what
it should be: smaller is better, 0 is exact. The list is `src/skeleton/stability.rs`; its tests run
every case, and write this page when `UPDATE_DOCS` is set.

";

    /// A line without its third cell, the measured one.
    fn unmeasured(line: &str) -> String {
        let cells = line.split(" | ").enumerate().filter(|(i, _)| *i != 2);
        cells.map(|(_, cell)| cell).collect::<Vec<_>>().join(" | ")
    }

    #[test]
    fn every_case_passes_and_stands_on_its_page() {
        let findings = run();
        for f in &findings {
            assert!(f.passes(), "{}: {} {} in {:.1} s", f.name, f.measured, f.unit, f.seconds);
        }
        let page = format!("{HEAD}{}", table(&findings));
        if std::env::var_os("UPDATE_DOCS").is_some() {
            std::fs::write(DOCS, &page).unwrap();
        }
        let written = std::fs::read_to_string(DOCS).unwrap();
        let strip = |page: &str| page.lines().map(unmeasured).collect::<Vec<_>>();
        assert_eq!(strip(&written), strip(&page), "set UPDATE_DOCS to write the page anew");
    }

    /// A miss above the limit, or one that is no number, does not pass.
    #[test]
    fn a_miss_fails() {
        let case = |measure| Case { name: "", expectation: "", unit: "", limit: 1.0, measure };
        assert!(case(|| Ok(1.0)).run().passes());
        assert!(!case(|| Ok(1.5)).run().passes());
        assert!(!case(|| Ok(f64::NAN)).run().passes());
        assert!(!case(|| Err(Error::new("no"))).run().passes());
    }
}
