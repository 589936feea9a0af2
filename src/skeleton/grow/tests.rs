use super::*;
use crate::skeleton::surroundings::{Neighbour, Wall};
use crate::species;
use proptest::prelude::*;

const NAMES: [&str; 14] = [
    "larix_sibirica",
    "larix_decidua",
    "picea_obovata",
    "picea_abies",
    "abies_sibirica",
    "pinus_sylvestris",
    "pinus_sibirica",
    "betula_pendula",
    "populus_tremula",
    "quercus_robur",
    "tilia_cordata",
    "sorbus_aucuparia",
    "salix_caprea",
    "corylus_avellana",
];

fn tree(name: &str, height_m: f32, max_nodes: u32, seed: u64) -> Skeleton {
    let species = species::load(name).unwrap();
    let detail = Detail { max_nodes, attractor_spacing_m: None };
    let target = Target::FromSpecies { height_m: Some(height_m) };
    grow(&species, target, detail, Seed::new(seed)).unwrap()
}

/// What every tree must be, whatever its species and size.
fn judge(s: &Skeleton, name: &str, height_m: f32, max_nodes: u32) {
    s.check().unwrap();
    assert!(s.len() <= max_nodes as usize, "{name}: {} nodes", s.len());
    assert!((s.height_m() / height_m - 1.0).abs() < 0.02, "{name}: {} m", s.height_m());
    let lowest = s.position.iter().skip(1).map(|p| p.z).fold(f32::INFINITY, f32::min);
    assert!(lowest > 0.0, "{name} of {height_m} m: a node at {lowest} m");
}

#[test]
fn every_species_reaches_its_height_and_width() {
    for name in NAMES {
        let size = species::load(name).unwrap().size;
        for seed in 0..4 {
            for nodes in [500, 2500] {
                let s = tree(name, size.height_m, nodes, seed);
                judge(&s, name, size.height_m, nodes);
                let width = s.width_m() / size.crown_diameter_m;
                assert!((width - 1.0).abs() < 0.12, "{name}: width {width}");
                assert!(s.len() as u32 > nodes / 2, "{name}: {} of {nodes} nodes", s.len());
            }
        }
    }
}

/// Turns of more than 35 degrees along wood that one sees, in a hundred metres; but for those where stems of a
/// stool part and rise.
fn corners(s: &Skeleton) -> f32 {
    let low_m = if s.stems() > 1 { 0.005 * s.height_m() } else { 0.0 };
    let is_low = |p: u32| p == 0 || s.position[p as usize].z < low_m;
    let seen = |i: usize| s.radius_m[i] > 0.003 && s.parent[i] != NO_PARENT && !is_low(s.parent[i]);
    let way = |i: usize| s.position[i] - s.position[s.parent[i] as usize];
    let (mut length_m, mut count) = (0.0, 0);
    for i in (0..s.len()).filter(|&i| seen(i)) {
        length_m += way(i).length();
        let p = s.parent[i] as usize;
        let is_on = s.axis[i] == s.axis[p];
        count += usize::from(is_on && way(i).angle_between(way(p)) > 35f32.to_radians());
    }
    100.0 * count as f32 / length_m
}

#[test]
fn trees_seen_from_near_have_few_corners() {
    for name in NAMES {
        let height_m = species::load(name).unwrap().size.height_m;
        let far = corners(&tree(name, height_m, BENT_NODES as u32 - 1, 1));
        let near = corners(&tree(name, height_m, BENT_NODES as u32, 1));
        assert!(near < 0.5 * far + 0.5, "{name}: {near} corners in 100 m, {far} before");
    }
}

#[test]
fn the_stem_has_its_diameter_at_breast_height() {
    for name in ["larix_sibirica", "picea_obovata", "pinus_sylvestris", "quercus_robur"] {
        let size = species::load(name).unwrap().size;
        let s = tree(name, size.height_m, 900, 5);
        let stem: Vec<bool> = s.axis.iter().map(|&a| a == 0).collect();
        let value: Vec<f64> = s.radius_m.iter().map(|&r| f64::from(r)).collect();
        let at = crate::skeleton::radii::radius_at(&s.position, &s.parent, &stem, 1.3, &value);
        let wrong = 2.0 * at / size.stem_diameter_m - 1.0;
        assert!(wrong.abs() < 0.01, "{name}: {wrong}");
    }
}

#[test]
fn all_nodes_keep_to_the_crown() {
    for name in NAMES {
        let species = species::load(name).unwrap();
        let height_m = species.size.height_m;
        let seed = Seed::new(11);
        let e = Envelope::of_species(&species.size, species.growth.uneven, height_m, seed);
        let s = tree(name, height_m, 1500, 11);
        let margin_m = 0.3 * e.radius_m;
        for (p, &axis) in s.position.iter().zip(&s.axis) {
            let out = p.truncate() - e.centre(p.z);
            // Twigs may hang from where the crown is wider, or rise from there.
            let r = (-5..8)
                .map(|k| p.z + 0.03 * k as f32 * e.crown_length_m())
                .map(|z| e.radius_at(z.clamp(e.base_m, e.height_m), out.y.atan2(out.x)))
                .fold(0.0, f32::max);
            assert!(out.length() < r + margin_m, "{name}: {p} beyond {r}");
            let floor = e.base_m - 0.12 * e.crown_length_m();
            assert!(axis == 0 || p.z > floor || s.children().of(0).len() > 1, "{name}: {p}");
        }
    }
}

/// However few nodes it has: none are left for the top where the lowest take all.
#[test]
fn a_young_spire_has_branches_up_to_its_leader() {
    let names = ["picea_abies", "picea_obovata", "abies_sibirica", "larix_sibirica"];
    for (name, height_m) in names.into_iter().flat_map(|n| [0.5, 1.0, 2.0, 2.5].map(|h| (n, h))) {
        let s = tree(name, height_m, 3_333, 1);
        let axes = s.axes();
        let first = axes.iter().filter(|a| a.order == 1).filter_map(|a| a.base);
        let mut heights: Vec<f32> = first.map(|i| s.position[i as usize].z / height_m).collect();
        heights.sort_by(f32::total_cmp);
        let highest = heights[heights.len() - 1];
        let gap = heights.windows(2).map(|w| w[1] - w[0]).fold(0.0, f32::max);
        assert!(highest > 0.6 && gap < 0.2, "{name} of {height_m} m: {highest}, {gap} apart");
    }
}

#[test]
fn a_habit_is_what_its_species_says() {
    // Insertion angles of first-order branches from the vertical, mean in a part of the crown.
    let angle = |name: &str, from: f32, to: f32| {
        let s = tree(name, species::load(name).unwrap().size.height_m, 2500, 3);
        let e = s.height_m();
        let first: Vec<f32> = s
            .axes()
            .iter()
            .filter(|a| a.order == 1)
            .filter_map(|a| {
                let base = s.position[a.base? as usize];
                let way = s.position[a.nodes[0] as usize] - base;
                (base.z > from * e && base.z < to * e).then(|| way.angle_between(Vec3::Z))
            })
            .collect();
        assert!(first.len() > 5, "{name}");
        (first.iter().sum::<f32>() / first.len() as f32).to_degrees()
    };
    let (low, high) = (angle("picea_obovata", 0.1, 0.3), angle("picea_obovata", 0.8, 0.95));
    assert!(low > 90.0 && high < 70.0, "spruce hangs low, rises high: {low} {high}");
    let larch = angle("larix_sibirica", 0.35, 0.6);
    assert!((75.0..110.0).contains(&larch), "larch stands level: {larch}");
    let birch = angle("betula_pendula", 0.3, 0.7);
    assert!(birch < 60.0, "birch rises: {birch}");
    // A birch's twigs hang: most wood of order 2 and more points down.
    let s = tree("betula_pendula", 20.0, 2500, 3);
    let (mut down, mut all) = (0.0, 0.0);
    for i in 1..s.len() {
        let p = s.parent[i] as usize;
        if s.order[i] >= 2 {
            all += s.internode_m(i as u32);
            down += (s.position[p].z - s.position[i].z).max(0.0);
        }
    }
    assert!(down / all > 0.4, "{}", down / all);
    // A shrub has several stems from the ground, a pine one and a clear bole.
    let s = tree("salix_caprea", 5.0, 1500, 1);
    assert!(s.children().of(0).len() >= 3);
    let s = tree("pinus_sylvestris", 23.0, 1500, 1);
    let low = (0..s.len()).filter(|&i| s.order[i] > 0).map(|i| s.position[i].z);
    assert!(low.fold(f32::INFINITY, f32::min) > 10.0);
}

/// One leader, thick enough to stand, side shoots from low on, none wider than high.
#[test]
fn seedlings_have_a_stem_and_side_shoots_along_it() {
    for name in
        ["larix_decidua", "picea_abies", "pinus_sylvestris", "betula_pendula", "quercus_robur"]
    {
        for height_m in [0.3, 0.6, 1.0] {
            let s = tree(name, height_m, 4000, 1);
            let what = format!("{name}, {height_m} m");
            let thick_mm = 2000.0 * s.radius_m[1];
            let usual_mm = 1.5 + 10.0 * height_m;
            assert!((0.9 * usual_mm..2.5 * usual_mm).contains(&thick_mm), "{what}: {thick_mm} mm");
            assert!(s.width_m() < 0.8 * height_m, "{what}: {} m wide", s.width_m());
            let from = |i: &usize| s.order[*i] == 1 && s.order[s.parent[*i] as usize] == 0;
            let starts: Vec<f32> =
                (1..s.len()).filter(from).map(|i| s.position[s.parent[i] as usize].z).collect();
            assert!(starts.len() >= 4, "{what}: {} side shoots", starts.len());
            let low = starts.iter().copied().fold(f32::INFINITY, f32::min);
            assert!(low < 0.45 * height_m, "{what}: the lowest at {low} m");
        }
    }
}

#[test]
fn same_seed_same_tree_other_seed_another() {
    let a = tree("betula_pendula", 18.0, 900, 9);
    assert_eq!(a, tree("betula_pendula", 18.0, 900, 9));
    assert_ne!(a.position, tree("betula_pendula", 18.0, 900, 10).position);
}

#[test]
fn a_height_out_of_range_is_refused() {
    let species = species::load("picea_obovata").unwrap();
    for height_m in [0.0, -3.0, 500.0, f32::NAN, f32::INFINITY] {
        let target = Target::FromSpecies { height_m: Some(height_m) };
        let error = grow(&species, target, Detail::FOREST, Seed::new(1)).unwrap_err();
        assert!(error.message().starts_with("a tree of "), "{error}");
        assert_eq!(error.remedy_text(), Some("heights from 0.1 to 130 m are grown"));
    }
}

/// A half crown to the east of its root, seen from above only: points at the surface.
fn half_crown() -> Crown {
    let root = Vec3::new(5000.0, -300.0, 120.0);
    let mut draws = Seed::new(2).draws();
    let mut attractors = Vec::new();
    for _ in 0..600 {
        let t = draws.unit();
        let azimuth = draws.between(-1.6, 1.6);
        let reach = 3.5 * (1.0 - t).sqrt();
        let out = Vec3::new(azimuth.cos() * reach, azimuth.sin() * reach, 5.0 + 13.0 * t);
        attractors.push(root + out);
    }
    Crown {
        key: 7,
        root,
        apex: root + Vec3::new(0.4, 0.0, 18.0),
        height_m: 18.0,
        base_height_m: 5.0,
        diameter_m: 5.0,
        spread_m: 5.0,
        volume_cu_m: 60.0,
        surface_sq_m: 90.0,
        is_understory: false,
        outline: Vec::new(),
        attractors,
        point_count: 600,
        confidence: 0.9,
    }
}

#[test]
fn a_tree_follows_the_crown_it_is_given() {
    let crown = half_crown();
    for name in NAMES {
        let species = species::load(name).unwrap();
        let s = grow(&species, Target::FromCrown(&crown), Detail::FOREST, Seed::new(1)).unwrap();
        judge(&s, name, 18.0, Detail::FOREST.max_nodes);
        let wrong = s.width_m() / crown.diameter_m - 1.0;
        assert!(wrong.abs() < 0.15, "{name}: width off by {wrong}");
        let east = s.position.iter().map(|p| p.x).fold(0.0, f32::max);
        let west = s.position.iter().map(|p| -p.x).fold(0.0, f32::max);
        assert!(east > 1.4 * west, "{name}: {east} east, {west} west");
    }
}

#[test]
fn odd_crowns_give_sound_trees() {
    let species = species::load("larix_sibirica").unwrap();
    let plain = half_crown();
    let root = plain.root;
    let clouds: [(&str, Vec<Vec3>); 5] = [
        ("none", Vec::new()),
        ("one point", vec![root + Vec3::Z * 9.0; 300]),
        ("a line", (0..300).map(|i| root + Vec3::Z * (i as f32 * 0.06)).collect()),
        ("1 km away", vec![root + Vec3::new(1000.0, 0.0, 10.0); 9]),
        ("not finite", vec![Vec3::NAN, Vec3::INFINITY, root + Vec3::Z * 9.0]),
    ];
    for (what, attractors) in clouds {
        let crown = Crown { attractors, ..plain.clone() };
        let s = grow(&species, Target::FromCrown(&crown), Detail::FOREST, Seed::new(1)).unwrap();
        judge(&s, what, 18.0, Detail::FOREST.max_nodes);
        assert!(s.width_m() < 8.0, "{what}: {}", s.width_m());
    }
    let broken = Crown { diameter_m: f32::NAN, ..plain };
    let error = grow(&species, Target::FromCrown(&broken), Detail::FOREST, Seed::new(1));
    assert!(error.unwrap_err().message().contains("is not finite"));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(60))]
    #[test]
    fn any_species_height_and_seed_grows_a_sound_tree(
        which in 0..NAMES.len(), height_m in 0.3f32..45.0, nodes in 0u32..1500, seed: u64,
    ) {
        let s = tree(NAMES[which], height_m, nodes, seed);
        judge(&s, NAMES[which], height_m, nodes.max(*NODES.start()));
    }
}

#[test]
fn the_thirteen_rules_grow_thirteen_different_trees() {
    let trees: Vec<Skeleton> = (1..=13)
        .map(|i| {
            let species = crate::species::load(&format!("table3/{i:02}")).unwrap();
            let target = Target::FromSpecies { height_m: None };
            grow(&species, target, Detail::FOREST, Seed::new(1)).unwrap()
        })
        .collect();
    for (i, a) in trees.iter().enumerate() {
        for (j, b) in trees.iter().enumerate().skip(i + 1) {
            assert!(a != b, "rules {} and {} grow one tree", i + 1, j + 1);
        }
    }
}

/// A species with other decay factors than its own.
fn with_decay(name: &str, keys: &str) -> Species {
    let text = format!("extends = '{name}'\n[growth]\ndecay = [1.0, 0.5]\ndecay_by = {{ {keys} }}");
    species::load_text("mine", &text).unwrap()
}

/// Wood of branches, metres: to the east and to the west of the stem, and in the lower and the
/// upper half of the crown.
fn branch_wood_m(species: &Species) -> [f32; 4] {
    let target = Target::FromSpecies { height_m: None };
    let detail = Detail { max_nodes: 2500, attractor_spacing_m: None };
    let mut sum = [0.0; 4];
    for seed in 0..3 {
        let s = grow(species, target, detail, Seed::new(seed)).unwrap();
        let middle = s.height_m() * (0.5 + 0.5 * species.size.crown_base);
        for i in (0..s.len()).filter(|&i| s.order[i] > 0) {
            let (at, wood_m) = (s.position[i], s.internode_m(i as u32));
            sum[usize::from(at.x < 0.0)] += wood_m;
            sum[2 + usize::from(at.z > middle)] += wood_m;
        }
    }
    sum
}

#[test]
fn decay_may_differ_over_the_crown() {
    let even = branch_wood_m(&with_decay("picea_obovata", ""));
    let sheltered = "azimuth_deg = [[0, 1], [90, 4], [180, 1], [270, 0], [359, 1]]";
    let windward = branch_wood_m(&with_decay("picea_obovata", sheltered));
    let west_share = |w: &[f32; 4]| w[1] / (w[0] + w[1]);
    assert!((west_share(&even) - 0.5).abs() < 0.1, "{even:?}");
    assert!(west_share(&windward) > 0.6, "{windward:?}");
    let lower = branch_wood_m(&with_decay("picea_obovata", "height = [[0.0, 3.0], [0.5, 1.0]]"));
    let low_share = |w: &[f32; 4]| w[2] / (w[2] + w[3]);
    assert!(low_share(&lower) < 0.9 * low_share(&even), "{lower:?} {even:?}");
    let shaded = branch_wood_m(&with_decay("picea_obovata", "light = [[0.0, 5.0], [0.9, 1.0]]"));
    assert!(low_share(&shaded) < 0.95 * low_share(&even), "{shaded:?} {even:?}");
}

/// Between forks wood narrows little by little: no step within an axis.
#[test]
fn taper_is_continuous() {
    for name in NAMES {
        let s = tree(name, species::load(name).unwrap().size.height_m, 2500, 2);
        let children = s.children();
        let mut worst: f32 = 1.0;
        for i in 1..s.len() {
            let p = s.parent[i] as usize;
            let is_tip = children.of(i as u32).is_empty();
            if children.of(p as u32).len() == 1 && !is_tip && p != 0 {
                worst = worst.min(s.radius_m[i] / s.radius_m[p]);
            }
        }
        assert!(worst > 0.75, "{name}: {worst}");
    }
}

/// The age of a smaller tree follows the species' growth in height.
#[test]
fn a_rule_grows_otherwise_when_the_tree_is_young() {
    let grown = |condition: &str, height_m: f32| {
        let text = format!(
            "extends = 'table3/13'\n[size]\nheight_m = 20\nage_years = 80
            [rule]\nproductions = ['F(a) {condition} -> F(a)[^F(0.5a)][&F(0.5a)][/F(0.5a)][\\F(0.5a)]']"
        );
        let species = species::load_text("aging", &text).unwrap();
        let detail = Detail { max_nodes: 600, attractor_spacing_m: None };
        let target = Target::FromSpecies { height_m: Some(height_m) };
        grow(&species, target, detail, Seed::new(1)).unwrap().position
    };
    // 28 years at 10 metres.
    assert_eq!(grown(": age > 28", 10.0), grown("", 10.0));
    assert_ne!(grown(": age > 29", 10.0), grown("", 10.0));
    assert_eq!(grown(": age > 79", 20.0), grown("", 20.0));
    assert_ne!(grown(": height < 9", 10.0), grown("", 10.0));
}

#[test]
fn branches_leave_walls_the_ground_and_neighbours_free() {
    let wall = Wall::Behind { point: Vec3::X * 1.2, normal: -Vec3::X };
    let slope = |p: Vec2| 5.0 * p.y;
    let neighbour =
        Neighbour { root: Vec3::X * 4.0, height_m: 40.0, crown_base_m: 0.0, crown_radius_m: 5.0 };
    let cases: [(&str, Surroundings); 3] = [
        ("wall", Surroundings { walls: vec![wall], ..Surroundings::none() }),
        ("ground", Surroundings { ground: Some(&slope), ..Surroundings::none() }),
        ("neighbour", Surroundings { neighbours: vec![neighbour], ..Surroundings::none() }),
    ];
    for (what, around) in cases {
        for name in ["picea_obovata", "betula_pendula", "quercus_robur"] {
            let species = species::load(name).unwrap();
            let target = Target::FromSpecies { height_m: None };
            let detail = Detail { max_nodes: 1200, attractor_spacing_m: None };
            let s = grow_among(&species, target, detail, &around, Seed::new(3)).unwrap();
            s.check().unwrap();
            let crown_radius_m = 0.5 * species.size.crown_diameter_m;
            let bound = Surroundings { crown_radius_m, ..around.clone() };
            let is_stem = s.is_stem();
            let inside = (0..s.len()).filter(|&i| !is_stem[i] && !bound.is_free(s.position[i]));
            assert_eq!(inside.count(), 0, "{name} in the {what}");
            assert!(s.len() > 300, "{name} by the {what}: {} nodes", s.len());
            let alone = grow(&species, target, detail, Seed::new(3)).unwrap();
            let there = (0..alone.len()).filter(|&i| !bound.is_free(alone.position[i])).count();
            assert!(there > 20, "{name}: nothing to leave free in the {what}");
        }
    }
}

#[test]
fn a_rule_that_draws_nothing_is_refused() {
    for production in ["F(a) -> F(0)", "F(a) -> ε"] {
        let text = format!("[rule]\naxiom = 'F(a)'\nproductions = ['{production}']");
        let species = species::load_text("nothing", &text).unwrap();
        let target = Target::FromSpecies { height_m: None };
        let error = grow(&species, target, Detail::FOREST, Seed::new(1)).unwrap_err();
        assert_eq!(error.message(), "the rule draws no shoot");
    }
}

#[test]
fn no_limb_hangs_to_the_ground() {
    let species = species::load("quercus_robur").unwrap();
    for seed in 1..9 {
        let target = Target::FromSpecies { height_m: None };
        let detail = Detail { max_nodes: 3333, attractor_spacing_m: None };
        let tree = grow(&species, target, detail, Seed::new(seed)).unwrap();
        let is_stem = tree.is_stem();
        let heights = (0..tree.len()).filter(|&i| !is_stem[i]).map(|i| tree.position[i].z);
        let lowest = heights.fold(f32::INFINITY, f32::min);
        assert!(lowest > 0.05 * tree.height_m(), "seed {seed}: {lowest} m");
    }
}

/// Where the crown takes the stem over, it leans into a limb: no corner, and no stump beside one.
#[test]
fn a_stem_that_ends_among_its_limbs_leans_over_into_one() {
    const THICK_M: f32 = 0.07;
    for (name, seed) in
        ["quercus_robur", "tilia_cordata"].iter().flat_map(|n| (1..=6).map(move |s| (n, s)))
    {
        let s = species::load(name).unwrap();
        let detail = Detail { max_nodes: 3_000, attractor_spacing_m: None };
        let target = Target::FromSpecies { height_m: None };
        let tree = grow(&s, target, detail, Seed::new(seed)).unwrap();
        let way = |i: usize| {
            (tree.position[i] - tree.position[tree.parent[i] as usize]).normalize_or(Vec3::Z)
        };
        // From the root, its axis goes on, or the thickest that springs from its end.
        let mut at = 1;
        while tree.radius_m[at] > THICK_M {
            let springs = (at + 1..tree.len()).filter(|&i| tree.parent[i] as usize == at);
            let rank = |i: &usize| (tree.axis[*i] == tree.axis[at], tree.radius_m[*i]);
            let Some(next) = springs.max_by(|a, b| rank(a).partial_cmp(&rank(b)).unwrap()) else {
                panic!("{name} {seed}: ends {} m thick", tree.radius_m[at]);
            };
            let turn_deg = way(at).angle_between(way(next)).to_degrees();
            assert!(turn_deg < 45.0, "{name} {seed}: a corner of {turn_deg:.0}°");
            at = next;
        }
    }
}
