//! Growth: derivation, turtle, space colonization, whole skeletons. Items a second, one thread
//! except for the trees, which take two.
//!
//! `cargo bench --bench growth`

use divan::Bencher;
use divan::counter::ItemsCount;
use glam::Vec3;
use larix::seed::Seed;
use larix::skeleton::colonize::{Colonized, Habit, Limits, Reach, Start, colonize};
use larix::skeleton::derive::{Inputs, ModuleString, derive};
use larix::skeleton::surroundings::{Open, Surroundings, Wall};
use larix::skeleton::{Detail, Target, grow, turtle};
use larix::species::rule::Rule;
use larix::species::{self, Species};
use rayon::prelude::*;

#[global_allocator]
static ALLOCATOR: larix::heap::Counted = larix::heap::Counted;

fn main() {
    for n in ITERATIONS {
        let string = derived(&rule_13(), n);
        let bytes = string.symbols.len() + 8 * string.parameters.len();
        let modules = string.symbols.len();
        println!("n = {n}: {modules} modules, {:.2} bytes each", bytes as f64 / modules as f64);
    }
    divan::main();
}

const ITERATIONS: [u32; 3] = [8, 9, 10];

fn rule_13() -> Rule {
    species::load("table3/13").expect("built in").rule
}

fn derived(rule: &Rule, iterations: u32) -> ModuleString {
    let inputs = Inputs { iterations: Some(iterations), ..Inputs::new(Seed::new(1)) };
    derive(rule, &inputs).expect("within the limit")
}

/// Modules a second.
#[divan::bench(args = ITERATIONS, sample_count = 10)]
fn derivation(bencher: Bencher, iterations: u32) {
    let rule = rule_13();
    let modules = derived(&rule, iterations).symbols.len();
    bencher.counter(ItemsCount::new(modules)).bench(|| derived(&rule, iterations));
}

/// Segments a second.
#[divan::bench(args = ["table3/13 8", "table3/13 9", "table3/04 8", "table3/01 7"], sample_count = 10)]
fn turtle_segments(bencher: Bencher, what: &str) {
    let (name, n) = what.split_once(' ').expect("name and iterations");
    let rule = species::load(name).expect("built in").rule;
    let string = derived(&rule, n.parse().expect("a number"));
    let draw = || turtle::draw(&rule, &string).expect("in bounds");
    bencher.counter(ItemsCount::new(draw().len() - 1)).bench(draw);
}

/// Attractors in a ball, one a cubic metre.
fn ball(count: usize) -> Vec<Vec3> {
    let mut draws = Seed::new(7).draws();
    let radius_m = (count as f32 * 0.75 / std::f32::consts::PI).cbrt();
    (0..count).map(|_| draws.direction() * (radius_m * draws.unit().cbrt())).collect()
}

/// Grows into a ball from its lowest place, with the distances that the species' files give.
fn fill(attractors: &[Vec3], space: Option<&Surroundings>) -> Colonized {
    let lowest = attractors.iter().map(|p| p.z).fold(0.0, f32::min);
    let start = Start { position: Vec3::Z * lowest, heading: Vec3::Z, is_open: true };
    let (reach, _) = Reach::new(0.8, 0.9, 2.6);
    let limits = Limits { max_nodes: attractors.len(), max_rounds: 10_000, bridges: 1 };
    let (habit, pull) = (Habit::default(), |_| Vec3::ZERO);
    match space {
        None => colonize(&[start], attractors, &reach, &habit, pull, &Open, &limits),
        Some(space) => colonize(&[start], attractors, &reach, &habit, pull, space, &limits),
    }
}

/// New nodes a second.
#[divan::bench(args = [1_000, 10_000, 100_000, 1_000_000], sample_count = 10)]
fn colonization(bencher: Bencher, attractors: usize) {
    let cloud = ball(attractors);
    let nodes = fill(&cloud, None).position.len();
    bencher.counter(ItemsCount::new(nodes)).bench(|| fill(&cloud, None));
}

/// The same with ground and a wall that cuts the ball.
#[divan::bench(args = [100_000], sample_count = 10)]
fn colonization_before_a_wall(bencher: Bencher, attractors: usize) {
    let cloud = ball(attractors);
    let floor = |_| -100.0;
    let wall = Wall::Behind { point: Vec3::X * 10.0, normal: -Vec3::X };
    let space = Surroundings { ground: Some(&floor), walls: vec![wall], ..Surroundings::none() };
    let nodes = fill(&cloud, Some(&space)).position.len();
    bencher.counter(ItemsCount::new(nodes)).bench(|| fill(&cloud, Some(&space)));
}

/// A thousand unique trees of 20 m, skeletons only.
#[divan::bench(sample_count = 5)]
fn thousand_trees(bencher: Bencher) {
    let names = ["larix_sibirica", "picea_obovata", "pinus_sylvestris", "betula_pendula"];
    let species: Vec<Species> = names.iter().map(|n| species::load(n).expect("built in")).collect();
    let threads = rayon::ThreadPoolBuilder::new().num_threads(2).build().expect("two threads");
    let target = Target::FromSpecies { height_m: Some(20.0) };
    let tree = |i: usize| {
        let seed = Seed::new(1).derive("tree", i as u64);
        grow(&species[i % species.len()], target, Detail::FOREST, seed).expect("a tree").len()
    };
    bencher
        .counter(ItemsCount::new(1000usize))
        .bench(|| threads.install(|| (0..1000usize).into_par_iter().map(tree).sum::<usize>()));
}
