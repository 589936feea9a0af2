use super::*;
use crate::seed::Seed;
use proptest::prelude::*;

fn free(_: Vec3) -> Vec3 {
    Vec3::ZERO
}

fn limits() -> Limits {
    Limits { max_nodes: 100_000, max_rounds: 2_000, bridges: 1 }
}

fn reach(step: f32, kill: f32, influence: f32) -> Reach {
    let (reach, said) = Reach::new(step, kill, influence);
    assert!(said.is_empty(), "{said:?}");
    reach
}

fn origin() -> [Start; 1] {
    [Start { position: Vec3::ZERO, heading: Vec3::ZERO, is_open: true }]
}

fn run(attractors: &[Vec3], reach: Reach) -> Colonized {
    let grown = colonize(&origin(), attractors, &reach, &Habit::default(), &free, &limits());
    sound(&grown, 1);
    grown
}

/// Parents first, no child on its parent, no two nodes in one place.
fn sound(grown: &Colonized, starts: usize) {
    let mut places = std::collections::BTreeSet::new();
    for (i, (&p, &parent)) in grown.position.iter().zip(&grown.parent).enumerate() {
        assert!((parent as usize) < starts + i);
        assert!(p.is_finite());
        let place = [p.x.to_bits(), p.y.to_bits(), p.z.to_bits()];
        assert!(places.insert(place), "node {i} repeats {p}");
    }
}

#[test]
fn a_row_of_attractors_is_walked_step_by_step() {
    let row: Vec<Vec3> = (1..=10).map(|i| Vec3::X * i as f32).collect();
    let grown = run(&row, reach(1.0, 0.5, 2.5));
    assert_eq!(grown.position, row);
    assert_eq!(grown.parent, (0..10).collect::<Vec<u32>>());
    assert_eq!(grown.left, 0);
}

#[test]
fn the_step_is_towards_the_mean_of_unit_directions() {
    let pull = [Vec3::new(2.0, 0.0, 0.0), Vec3::new(0.0, 3.0, 0.0)];
    let grown = run(&pull, reach(0.5, 0.3, 10.0));
    let expected = Vec3::new(1.0, 1.0, 0.0).normalize() * 0.5;
    assert!((grown.position[0] - expected).length() < 1e-6);
}

#[test]
fn symmetric_attractors_do_not_stall_growth() {
    for ring in [2, 3, 4, 6] {
        let around: Vec<Vec3> = (0..ring)
            .map(|i| {
                let (s, c) = (std::f32::consts::TAU * i as f32 / ring as f32).sin_cos();
                Vec3::new(c, s, 0.0) * 2.0
            })
            .collect();
        let grown = run(&around, reach(0.5, 0.4, 6.0));
        assert!(!grown.position.is_empty());
        assert!(grown.left < ring, "ring of {ring}: {} left", grown.left);
    }
}

#[test]
fn two_attractors_do_not_make_a_node_swing_for_ever() {
    // Closer together than a step, on both sides of the way of growth.
    for gap in [0.01, 0.3, 0.55, 0.9] {
        let pair = [Vec3::new(1.3, gap, 0.0), Vec3::new(1.3, -gap, 0.0)];
        let grown = run(&pair, reach(1.0, 0.5, 5.0));
        assert!(grown.position.len() < 10, "gap {gap}: {} nodes", grown.position.len());
        assert!(grown.rounds < 20);
    }
}

#[test]
fn attractors_out_of_reach_are_bridged_once_then_left() {
    let near = Vec3::X * 3.5;
    let far = Vec3::new(0.0, 0.0, 1000.0);
    let grown = run(&[near, far], reach(1.0, 0.6, 2.0));
    assert_eq!(grown.left, 1);
    assert_eq!(grown.position.len(), 3);
    assert!(grown.position.iter().all(|p| p.length() < 5.0));
}

#[test]
fn attractors_all_in_one_place_on_a_line_in_a_plane() {
    let one = vec![Vec3::new(1.0, 1.0, 1.0); 500];
    let grown = run(&one, reach(0.2, 0.2, 3.0));
    assert_eq!((grown.left, grown.position.len() < 12), (0, true));
    let line: Vec<Vec3> = (0..500).map(|i| Vec3::new(i as f32 * 0.02, 0.5, 0.0)).collect();
    assert_eq!(run(&line, reach(0.2, 0.2, 3.0)).left, 0);
    let plane: Vec<Vec3> =
        (0..400).map(|i| Vec3::new((i % 20) as f32 * 0.2, (i / 20) as f32 * 0.2, 1.0)).collect();
    // Nodes closed for symmetry may leave single attractors.
    assert!(run(&plane, reach(0.2, 0.2, 3.0)).left <= 4);
    assert_eq!(run(&[Vec3::ZERO], reach(0.2, 0.2, 3.0)).position.len(), 0);
    assert_eq!(run(&[], reach(0.2, 0.2, 3.0)).position.len(), 0);
}

#[test]
fn distances_in_a_wrong_order_are_put_right_and_said() {
    for d in [0.1, 1.0, 5.0] {
        for k in [0.01, 1.0, 7.0] {
            for i in [0.05, 1.0, 9.0] {
                let (r, said) = Reach::new(d, k, i);
                assert!(r.kill_m() >= 0.5 * r.step_m());
                assert!(r.influence_m() > r.kill_m() && r.influence_m() >= r.step_m());
                let is_changed = (r.step_m(), r.kill_m(), r.influence_m()) != (d, k, i);
                assert_eq!(is_changed, !said.is_empty(), "{d} {k} {i}");
            }
        }
    }
    let (r, said) = Reach::new(f32::NAN, -1.0, f32::INFINITY);
    assert!(r.step_m() > 0.0 && r.influence_m().is_finite());
    assert_eq!(said.len(), 3);
    assert_eq!(said[0], "step D of NaN m is no length; 0.1 m taken");
}

#[test]
fn caps_hold() {
    let row: Vec<Vec3> = (1..=100).map(|i| Vec3::X * i as f32).collect();
    let capped = |max_nodes, max_rounds| {
        let limits = Limits { max_nodes, max_rounds, bridges: 0 };
        let r = reach(1.0, 0.5, 2.5);
        colonize(&origin(), &row, &r, &Habit::default(), &free, &limits).position.len()
    };
    assert_eq!(capped(7, 1000), 7);
    assert_eq!(capped(1000, 12), 12);
    assert_eq!(capped(0, 12), 0);
}

#[test]
fn closed_starts_clear_attractors_but_do_not_grow() {
    let mut starts = origin();
    starts[0].is_open = false;
    let grown = colonize(
        &starts,
        &[Vec3::X * 0.1, Vec3::X * 2.0],
        &reach(1.0, 0.5, 5.0),
        &Habit::default(),
        &free,
        &limits(),
    );
    assert_eq!((grown.position.len(), grown.left), (0, 1));
}

#[test]
fn wood_turns_no_more_than_it_may() {
    let starts = [Start { position: Vec3::ZERO, heading: Vec3::Z, is_open: true }];
    let habit = Habit { max_turn_rad: 0.4, ..Habit::default() };
    let attractors = [Vec3::new(3.0, 0.0, 0.5)];
    let grown = colonize(&starts, &attractors, &reach(0.5, 0.4, 9.0), &habit, &free, &limits());
    assert!((grown.position[0].angle_between(Vec3::Z) - 0.4).abs() < 1e-3);
    assert_eq!(grown.left, 0);
}

#[test]
fn a_twig_does_not_curl_back() {
    // Attractors on a circle lead a free node round it.
    let circle: Vec<Vec3> = (1..60)
        .map(|i| {
            let (s, c) = (i as f32 * 0.1).sin_cos();
            Vec3::new(s, 1.0 - c, 0.0) * 3.0
        })
        .collect();
    let widest = |max_bend_rad: f32| {
        let habit = Habit { max_bend_rad, ..Habit::default() };
        let r = reach(0.2, 0.15, 0.7);
        let grown = colonize(&origin(), &circle, &r, &habit, &free, &limits());
        let first = grown.position[0].normalize();
        // Along the first child of each node; later children are twigs of their own.
        let (mut at, mut from, mut widest) = (0u32, Vec3::ZERO, 0.0f32);
        while let Some(next) = grown.parent.iter().position(|&p| p == at) {
            widest = widest.max((grown.position[next] - from).angle_between(first));
            from = grown.position[next];
            at = next as u32 + 1;
        }
        widest
    };
    assert!(widest(std::f32::consts::PI) > 2.5);
    assert!(widest(0.8) < 0.801);
}

/// The grid gives what the definition gives: every attractor with its nearest node.
#[test]
fn owners_are_the_nearest_nodes() {
    let mut draws = Seed::new(3).draws();
    let points: Vec<Vec3> = (0..500).map(|_| draws.direction() * draws.unit() * 4.0).collect();
    let nodes: Vec<Vec3> = (0..60).map(|_| draws.direction() * draws.unit() * 4.0).collect();
    let mut grid = Grid::new(&points, 0.9).unwrap();
    for (i, &n) in nodes.iter().enumerate() {
        grid.visit(i as u32, n, 0.81, 0.0);
    }
    for (i, p) in grid.point.iter().enumerate() {
        let near = nodes
            .iter()
            .map(|n| n.distance_squared(*p))
            .enumerate()
            .filter(|(_, d)| *d < 0.81)
            .min_by(|a, b| a.1.total_cmp(&b.1));
        assert_eq!(grid.owner[i], near.map_or(NOBODY, |(n, _)| n as u32));
    }
}

proptest! {
    #[test]
    fn any_cloud_ends_and_is_sound(
        cloud in prop::collection::vec((-9.0f32..9.0, -9.0f32..9.0, -9.0f32..9.0), 0..300),
        step in 0.01f32..3.0, kill in 0.01f32..3.0, influence in 0.01f32..9.0,
        inertia in 0.0f32..3.0, turn in 0.05f32..3.2, bend in 0.05f32..3.2,
    ) {
        let cloud: Vec<Vec3> = cloud.into_iter().map(|(x, y, z)| Vec3::new(x, y, z)).collect();
        let (reach, _) = Reach::new(step, kill, influence);
        let habit = Habit { inertia, max_turn_rad: turn, max_bend_rad: bend };
        let few = Limits { max_nodes: 3_000, max_rounds: 500, bridges: 2 };
        let grown = colonize(&origin(), &cloud, &reach, &habit, &free, &few);
        prop_assert!(grown.position.len() <= 3_000 && grown.left <= cloud.len());
        for (i, &parent) in grown.parent.iter().enumerate() {
            prop_assert!((parent as usize) <= i);
            prop_assert!(grown.position[i].is_finite());
        }
    }
}
