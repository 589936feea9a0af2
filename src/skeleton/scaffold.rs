//! What the species' rule writes, as a tree of shoots: which springs from which, at what angle and
//! to what side, and how long beside its parent. Sizes come later.

use glam::Vec3;

use super::derive::{Inputs, derive};
use super::limb::sides;
use super::turtle::draw;
use crate::diagnostic::Result;
use crate::seed::Seed;
use crate::species::rule::{Action, Rule};

/// Modules a scaffold may have; a rule that makes more is derived with fewer iterations.
const MODULE_LIMIT: usize = 400_000;

/// One drawn module of the rule.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Shoot {
    /// Earlier in the list; `None` where it stands on the ground.
    pub parent: Option<u32>,
    /// 0 for stems, 1 for their laterals, …
    pub depth: u8,
    /// Whether it goes on where its parent ends, on the same axis.
    pub goes_on: bool,
    /// Angle from the parent's direction.
    pub tilt_rad: f32,
    /// Side of the parent it leans to, counted as in [`sides`].
    pub azimuth_rad: f32,
    /// Length over the parent's.
    pub ratio: f32,
    /// Place among the laterals its parent has, 0 the first the rule writes (the newest).
    pub rank: u32,
    /// Number of laterals its parent has.
    pub siblings: u32,
}

impl Shoot {
    /// Whether it carries its parent's direction on.
    pub fn is_in_line(&self) -> bool {
        self.tilt_rad < 0.05
    }
}

/// The rule's shoots on a stem of `internodes` repetitions of its axiom, each rewritten by the
/// productions; `constants`: other values for those of the rule. An axiom all in brackets stands for several stems and is not repeated.
///
/// # Errors
/// A rule that derives to nothing drawn, or fails to derive.
pub fn scaffold(
    rule: &Rule,
    internodes: u32,
    constants: &[(&str, f64)],
    seed: Seed,
) -> Result<Vec<Shoot>> {
    let mut rule = rule.clone();
    if has_stem(&rule) {
        let axiom = rule.axiom.clone();
        for _ in 1..internodes {
            rule.axiom.symbols.extend_from_slice(&axiom.symbols);
            rule.axiom.arguments.extend_from_slice(&axiom.arguments);
        }
    }
    let constants = constants.iter().map(|(name, value)| ((*name).to_owned(), *value)).collect();
    let mut inputs = Inputs { module_limit: MODULE_LIMIT, constants, ..Inputs::new(seed) };
    let mut string = derive(&rule, &inputs);
    let mut iterations = rule.iterations;
    while string.is_err() && iterations > 1 {
        iterations -= 1;
        inputs.iterations = Some(iterations);
        string = derive(&rule, &inputs);
    }
    let drawn = draw(&rule, &string?)?;
    Ok(shoots(&drawn.position, &drawn.parent, &drawn.axis, &drawn.order))
}

/// Whether the axiom stands for growth outside brackets.
fn has_stem(rule: &Rule) -> bool {
    let mut depth = 0u32;
    for &id in &rule.axiom.symbols {
        match rule.symbol(id).map(|s| s.action) {
            Some(Action::Push) => depth += 1,
            Some(Action::Pop) => depth = depth.saturating_sub(1),
            Some(Action::Draw | Action::Nothing) if depth == 0 => return true,
            _ => {}
        }
    }
    false
}

/// The shoots of the turtle's nodes 1…: shoot i ends at node i + 1.
fn shoots(position: &[Vec3], parent: &[u32], axis: &[u32], order: &[u16]) -> Vec<Shoot> {
    let n = position.len();
    let way = |i: usize| position[i] - position[parent[i] as usize];
    let mut siblings = vec![0u32; n];
    let goes_on = |i: usize| {
        let p = parent[i] as usize;
        p != 0 && axis[i] == axis[p]
    };
    let mut rank = vec![0u32; n];
    for i in 1..n {
        if !goes_on(i) {
            let p = parent[i] as usize;
            rank[i] = siblings[p];
            siblings[p] += 1;
        }
    }
    (1..n)
        .map(|i| {
            let p = parent[i] as usize;
            let own = way(i);
            let ahead = if p == 0 { Vec3::Z } else { way(p) };
            let (across, other) = sides(ahead.normalize_or(Vec3::Z));
            Shoot {
                parent: (p != 0).then(|| p as u32 - 1),
                depth: order[i].min(u16::from(u8::MAX)) as u8,
                goes_on: goes_on(i),
                tilt_rad: ahead.angle_between(own),
                azimuth_rad: own.dot(other).atan2(own.dot(across)),
                ratio: own.length() / ahead.length().max(1e-9),
                rank: rank[i],
                siblings: siblings[p],
            }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::species;

    fn of(name: &str, internodes: u32) -> Vec<Shoot> {
        scaffold(&species::load(name).unwrap().rule, internodes, &[], Seed::new(1)).unwrap()
    }

    #[test]
    fn a_repeated_axiom_makes_a_stem_of_rewritten_shoots() {
        let one = of("table3/13", 1);
        assert_eq!(one.len(), 125);
        let five = of("table3/13", 5);
        assert_eq!(five.len(), 625);
        assert_eq!(five.iter().filter(|s| s.depth == 0).count(), 5);
        // 12 laterals of half the length, 30° from the stem, to four sides.
        let first: Vec<&Shoot> =
            five.iter().filter(|s| s.parent == Some(0) && !s.goes_on).collect();
        assert_eq!(first.len(), 12);
        for (rank, shoot) in first.iter().enumerate() {
            assert_eq!((shoot.rank, shoot.siblings, shoot.depth), (rank as u32, 12, 1));
            assert!((shoot.tilt_rad.to_degrees() - 30.0).abs() < 0.01);
            assert!((shoot.ratio - 0.5).abs() < 1e-5);
        }
        let quarter = |s: &Shoot| (s.azimuth_rad.to_degrees() / 90.0).round().rem_euclid(4.0) as u8;
        let mut quarters: Vec<u8> = first.iter().take(4).map(|s| quarter(s)).collect();
        quarters.sort_unstable();
        assert_eq!(quarters, [0, 1, 2, 3]);
    }

    #[test]
    fn an_axiom_in_brackets_is_a_stool_of_stems() {
        let stems = |s: &[Shoot]| s.iter().filter(|s| s.parent.is_none()).count();
        assert_eq!(stems(&of("table3/08", 7)), 4);
        assert_eq!(stems(&of("table3/07", 7)), 2);
        assert_eq!(stems(&of("table3/04", 3)), 1);
    }

    #[test]
    fn a_rule_reads_the_tree_it_grows() {
        let text = "[rule]\naxiom = 'F(a)'\niterations = 1\nangles = { alpha = 30 }
            productions = ['F(a) : age > 20 -> F(a)[^F(0.1*height/crown)]', 'F(a) -> F(a)']";
        let species = species::load_text("aging", text).unwrap();
        let tilted = |constants: &[(&str, f64)]| {
            let shoots = scaffold(&species.rule, 1, constants, Seed::new(1)).unwrap();
            let laterals = shoots.iter().filter(|s| !s.is_in_line());
            laterals.map(|s| (s.ratio * 1e4).round() / 1e4).collect::<Vec<f32>>()
        };
        // The typical tree: 12 m, 6 m across, 60 years.
        assert_eq!(tilted(&[]), [0.2]);
        assert_eq!(tilted(&[("age", 20.0)]), [] as [f32; 0]);
        assert_eq!(tilted(&[("height", 30.0), ("crown", 10.0)]), [0.3]);
        assert!(scaffold(&species.rule, 1, &[("girth", 1.0)], Seed::new(1)).is_err());
    }
}
