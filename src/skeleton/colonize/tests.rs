use super::*;
use crate::seed::Seed;
use crate::skeleton::surroundings::{Neighbour, Open, Surroundings, Wall};
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
    let grown = colonize(&origin(), attractors, &reach, &Habit::default(), free, &Open, &limits());
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
    let cloud = filled(Vec3::splat(-1.0), Vec3::splat(1.0), 0.4, 9);
    let few = Limits { max_nodes: 2_000, max_rounds: 500, bridges: 1 };
    for magnitude in [1e-3f32, 1.0, 1e3] {
        let [a, b, c] = [0.1, 0.35, 1.0].map(|x| x * magnitude);
        for (d, k, i) in [(a, b, c), (a, c, b), (b, a, c), (b, c, a), (c, a, b), (c, b, a)] {
            let (r, _) = Reach::new(d, k, i);
            let scaled: Vec<Vec3> = cloud.iter().map(|p| *p * magnitude).collect();
            let h = Habit::default();
            let grown = colonize(&origin(), &scaled, &r, &h, free, &Open, &few);
            sound(&grown, 1);
            assert!(grown.left <= 5, "D {d} d_k {k} d_i {i}: {} of 125 left", grown.left);
            assert!(grown.rounds <= 20 && (10..200).contains(&grown.position.len()));
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
        colonize(&origin(), &row, &r, &Habit::default(), free, &Open, &limits).position.len()
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
        free,
        &Open,
        &limits(),
    );
    assert_eq!((grown.position.len(), grown.left), (0, 1));
}

#[test]
fn wood_turns_no_more_than_it_may() {
    let starts = [Start { position: Vec3::ZERO, heading: Vec3::Z, is_open: true }];
    let habit = Habit { max_turn_rad: 0.4, ..Habit::default() };
    let attractors = [Vec3::new(3.0, 0.0, 0.5)];
    let grown =
        colonize(&starts, &attractors, &reach(0.5, 0.4, 9.0), &habit, free, &Open, &limits());
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
        let grown = colonize(&origin(), &circle, &r, &habit, free, &Open, &limits());
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
    let mut won = Vec::new();
    for (i, &n) in nodes.iter().enumerate() {
        grid.visit(i as u32, n, 0.0, &mut won);
    }
    for (i, attractor) in grid.attractor.iter().enumerate() {
        let near = nodes
            .iter()
            .map(|n| n.distance_squared(attractor.at))
            .enumerate()
            .filter(|(_, d)| *d < 0.81)
            .min_by(|a, b| a.1.total_cmp(&b.1));
        let owner = near.map_or(NOBODY, |(n, _)| n as u32);
        assert_eq!(attractor.owner, owner);
        assert!(owner == NOBODY || won.contains(&(i as u32)));
    }
}

/// Attractors far apart go by hash instead of by box; the answer is the same.
#[test]
fn a_cloud_with_outliers_grows_as_without() {
    let cloud = filled(Vec3::splat(-2.0), Vec3::splat(2.0), 0.4, 5);
    let near = run(&cloud, reach(0.3, 0.3, 1.0));
    let mut with = cloud.clone();
    with.extend([Vec3::splat(1e5), Vec3::splat(-1e5), Vec3::X * 3e4]);
    let far = run(&with, reach(0.3, 0.3, 1.0));
    assert_eq!(far.left, near.left + 3);
    let (a, b) = (far.position.len() as f64, near.position.len() as f64);
    assert!((a / b - 1.0).abs() < 0.05, "{a} against {b}");
}

/// Jittered samples of a box, about one a cell of the spacing.
fn filled(low: Vec3, high: Vec3, spacing: f32, seed: u64) -> Vec<Vec3> {
    let mut draws = Seed::new(seed).draws();
    let n = ((high - low) / spacing).ceil().as_ivec3();
    let mut out = Vec::new();
    for k in 0..n.z {
        for j in 0..n.y {
            for i in 0..n.x {
                let within = Vec3::new(draws.unit(), draws.unit(), draws.unit());
                let p = low + (Vec3::new(i as f32, j as f32, k as f32) + within) * spacing;
                out.push(p.min(high));
            }
        }
    }
    out
}

fn run_in(space: &Surroundings, starts: &[Start], attractors: &[Vec3]) -> Colonized {
    let r = reach(0.3, 0.3, 1.0);
    let grown = colonize(starts, attractors, &r, &Habit::default(), free, space, &limits());
    sound(&grown, starts.len());
    for (i, &p) in grown.position.iter().enumerate() {
        assert!(space.is_free(p), "node {i} at {p} is within an obstacle");
        let from = match grown.parent[i] as usize {
            start if start < starts.len() => starts[start].position,
            parent => grown.position[parent - starts.len()],
        };
        for k in 0..=8 {
            let between = from.lerp(p, k as f32 / 8.0);
            // Curved borders are looked for at four places of a shoot.
            assert!(k % 2 == 1 || space.is_free(between), "the way to node {i} is shut");
        }
    }
    grown
}

fn upright(position: Vec3) -> Start {
    Start { position, heading: Vec3::Z, is_open: true }
}

#[test]
fn growth_stops_at_a_plane_and_counts_what_is_behind() {
    let cloud = filled(Vec3::splat(-2.0), Vec3::splat(2.0), 0.4, 1);
    let wall = Wall::Behind { point: Vec3::X * 0.7, normal: -Vec3::X };
    let space = Surroundings { walls: vec![wall], ..Surroundings::none() };
    let grown = run_in(&space, &[upright(Vec3::ZERO)], &cloud);
    assert_eq!(grown.blocked, cloud.iter().filter(|p| p.x > 0.7).count());
    let east = grown.position.iter().map(|p| p.x).fold(0.0, f32::max);
    assert!(east > 0.5, "{east}: the free side is filled up to the wall");
    assert!(grown.left < 20, "{}", grown.left);
}

#[test]
fn growth_goes_round_a_box() {
    // A wall across the way; what feeds the tree is behind it.
    let wall = Wall::Box { centre: Vec3::X * 1.5, half_m: Vec3::new(0.2, 1.0, 1.0), yaw_rad: 0.3 };
    let space = Surroundings { walls: vec![wall], ..Surroundings::none() };
    let cloud: Vec<Vec3> = filled(Vec3::new(-0.5, -2.0, -2.0), Vec3::new(3.0, 2.0, 2.0), 0.3, 2);
    let grown = run_in(&space, &[upright(Vec3::ZERO)], &cloud);
    assert!(grown.blocked > 0);
    let behind = grown.position.iter().filter(|p| p.x > 2.2 && p.truncate().y.abs() < 0.5).count();
    assert!(behind > 10, "{behind} nodes behind the wall");
}

#[test]
fn a_blocked_step_follows_the_surface_and_a_corner_shuts() {
    let wall = |normal: Vec3| Wall::Behind { point: -normal * 0.1, normal };
    let one = Surroundings { walls: vec![wall(-Vec3::X)], ..Surroundings::none() };
    // Straight on is shut, the attractor is before the wall, out of the way.
    let goal = [Vec3::new(0.09, 0.9, 0.0)];
    let grown = run_in(&one, &[upright(Vec3::ZERO)], &goal);
    assert_eq!(grown.left, 0);
    let all = [Vec3::X, Vec3::Y, Vec3::Z].into_iter().flat_map(|n| [wall(n), wall(-n)]);
    let shut = Surroundings { walls: all.collect(), ..Surroundings::none() };
    let grown = run_in(&shut, &[upright(Vec3::ZERO)], &[Vec3::splat(0.09), Vec3::ONE]);
    assert_eq!((grown.position.len(), grown.blocked), (0, 1));
}

#[test]
fn nothing_grows_into_the_ground_or_out_of_an_obstacle() {
    let hill = |p: glam::Vec2| -0.5 + 0.8 * p.x.sin() + 0.1 * p.y;
    let space = Surroundings { ground: Some(&hill), ..Surroundings::none() };
    let cloud = filled(Vec3::splat(-2.0), Vec3::splat(2.0), 0.35, 3);
    let grown = run_in(&space, &[upright(Vec3::ZERO)], &cloud);
    assert!(grown.blocked > 200 && grown.position.len() > 200);
    let buried = run_in(&space, &[upright(Vec3::Z * -5.0)], &cloud);
    assert_eq!(buried.position.len(), 0);
}

#[test]
fn crowns_meet_at_the_border_and_do_not_cross_it() {
    let neighbour = |x: f32| Neighbour {
        root: Vec3::X * x,
        height_m: 9.0,
        crown_base_m: 0.0,
        crown_radius_m: 2.0,
    };
    let grow = |x: f32| {
        let space = Surroundings {
            crown_radius_m: 2.0,
            neighbours: vec![neighbour(x)],
            ..Surroundings::none()
        };
        let cloud = filled(Vec3::new(-2.0, -2.0, 1.0), Vec3::new(2.0, 2.0, 5.0), 0.35, 4);
        run_in(&space, &[upright(Vec3::Z)], &cloud).position
    };
    let (west, east) = (grow(2.0), grow(-2.0));
    // Beside both crowns is room for either.
    let between = |p: &&Vec3| p.y.abs() < 1.5;
    assert!(west.iter().filter(between).all(|p| p.x <= 1.0));
    assert!(east.iter().filter(between).all(|p| p.x >= -1.0));
    assert!(west.iter().any(|p| p.x > 0.7) && east.iter().any(|p| p.x < -0.7));
}

/// Which start each node descends from.
fn trees(grown: &Colonized, starts: usize) -> Vec<usize> {
    let mut tree: Vec<usize> = (0..starts).collect();
    for &p in &grown.parent {
        tree.push(tree[p as usize]);
    }
    tree.split_off(starts)
}

/// Each attractor feeds one tree, so two that grow together share the room between them.
#[test]
fn trees_grown_together_do_not_grow_into_each_other() {
    let r = reach(0.3, 0.3, 1.0);
    let mut worst = 0.0f32;
    for (seed, is_mirrored) in [(1, true), (2, true), (3, false), (4, false), (5, false)] {
        let west = filled(Vec3::new(-3.0, -2.0, 0.0), Vec3::new(0.0, 2.0, 4.0), 0.35, seed);
        let east = match is_mirrored {
            true => west.iter().map(|p| Vec3::new(-p.x, p.y, p.z)).collect(),
            false => filled(Vec3::new(0.0, -2.0, 0.0), Vec3::new(3.0, 2.0, 4.0), 0.35, seed + 50),
        };
        let cloud = [west, east].concat();
        let starts = [upright(Vec3::new(-1.5, 0.0, 2.0)), upright(Vec3::new(1.5, 0.0, 2.0))];
        let grown = colonize(&starts, &cloud, &r, &Habit::default(), free, &Open, &limits());
        let tree = trees(&grown, 2);
        let reach_east = |of: usize| {
            let own = grown.position.iter().zip(&tree).filter(|(_, t)| **t == of);
            own.map(|(p, _)| p.x).fold(f32::NEG_INFINITY, f32::max)
        };
        let own = |of: usize| tree.iter().filter(|&&t| t == of).count();
        assert!(own(0) > 300 && own(1) > 300);
        if is_mirrored {
            // A last step may cross the plane, and a shorter one follow it.
            assert!(reach_east(0) <= 1.5 * r.step_m(), "{}", reach_east(0));
        }
        // No node stands in the other tree: of those within two steps a part are its own.
        for (i, &p) in grown.position.iter().enumerate() {
            let near = |j: &usize| grown.position[*j].distance(p) < 2.0 * r.step_m();
            let (own, other): (Vec<usize>, Vec<usize>) =
                (0..tree.len()).filter(near).partition(|&j| tree[j] == tree[i]);
            let share = other.len() as f32 / (own.len() + other.len()) as f32;
            worst = worst.max(share);
        }
    }
    assert!(worst < 0.8, "{worst}");
}

#[test]
fn attractors_even_about_a_node_do_not_stall_it() {
    let mut draws = Seed::new(8).draws();
    let sphere: Vec<Vec3> = (0..200)
        .flat_map(|_| {
            let p = draws.direction() * 2.0;
            [p, -p]
        })
        .collect();
    let grown = run(&sphere, reach(0.3, 0.3, 3.0));
    assert!(grown.left < 20, "{} of 400 left", grown.left);
    let opposite = [Vec3::X * 2.0, Vec3::X * -2.0];
    assert_eq!(run(&opposite, reach(0.5, 0.4, 6.0)).left, 0);
}

#[test]
fn growth_is_the_same_at_any_scale() {
    let cloud = filled(Vec3::splat(-2.0), Vec3::splat(2.0), 0.4, 6);
    let plain = run(&cloud, reach(0.3, 0.3, 1.0));
    // By powers of two, which f32 scales without rounding; about 1e-3 and 1e4.
    for scale in [2f32.powi(-10), 2f32.powi(13)] {
        let scaled: Vec<Vec3> = cloud.iter().map(|p| *p * scale).collect();
        let grown = run(&scaled, reach(0.3 * scale, 0.3 * scale, scale));
        assert_eq!(grown.position.len(), plain.position.len());
        for (a, b) in grown.position.iter().zip(&plain.position) {
            assert!((*a / scale - *b).length() < 1e-4);
        }
    }
}

#[test]
fn what_is_not_a_number_is_left_out() {
    let cloud = [Vec3::NAN, Vec3::INFINITY, Vec3::new(f32::NEG_INFINITY, 0.0, 0.0), Vec3::X];
    let grown = run(&cloud, reach(0.5, 0.4, 2.0));
    assert_eq!((grown.left, grown.blocked, grown.position.len()), (0, 0, 2));
    let starts = [upright(Vec3::NAN), upright(Vec3::ZERO)];
    let grown = run_in(&Surroundings::none(), &starts, &[Vec3::X * 0.6]);
    assert!(grown.parent.iter().all(|&p| p != 0) && grown.left == 0);
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
        let grown = colonize(&origin(), &cloud, &reach, &habit, free, &Open, &few);
        prop_assert!(grown.position.len() <= 3_000 && grown.left <= cloud.len());
        for (i, &parent) in grown.parent.iter().enumerate() {
            prop_assert!((parent as usize) <= i);
            prop_assert!(grown.position[i].is_finite());
        }
    }
}
