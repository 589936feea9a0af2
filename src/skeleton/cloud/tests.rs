use std::path::{Path, PathBuf};

use proptest::prelude::*;

use super::*;
use crate::species;

/// Points on the surface of a skeleton's wood: one a square of `grid_m`, at least one in twice
/// that length of twig, 2 mm of noise.
fn sampled(skeleton: &Skeleton, grid_m: f32) -> Vec<Vec3> {
    let mut draws = Seed::new(11).draws();
    let mut out = Vec::new();
    let mut due = 0.0;
    for i in 1..skeleton.len() {
        let p = skeleton.parent[i] as usize;
        let (a, b) = (skeleton.position[p], skeleton.position[i]);
        let radius_m = 0.5 * (skeleton.radius_m[p] + skeleton.radius_m[i]);
        let area_sq = std::f32::consts::TAU * radius_m * a.distance(b);
        due += (area_sq / (grid_m * grid_m)).max(0.5 * a.distance(b) / grid_m);
        let (x, y) = (b - a).normalize().any_orthonormal_pair();
        while due >= 1.0 {
            due -= 1.0;
            let t = draws.unit();
            let (s, c) = draws.between(0.0, std::f32::consts::TAU).sin_cos();
            let r = skeleton.radius_m[p] + (skeleton.radius_m[i] - skeleton.radius_m[p]) * t;
            out.push(a.lerp(b, t) + (x * c + y * s) * r + draws.direction() * 0.002);
        }
    }
    out
}

fn detail(max_nodes: u32) -> Detail {
    Detail { max_nodes, ..Detail::HERO }
}

fn known(name: &str, height_m: f32) -> (Species, Skeleton) {
    let species = species::load(name).unwrap();
    let target = Target::FromSpecies { height_m: Some(height_m) };
    let tree = grow::grow(&species, target, detail(1500), Seed::new(4)).unwrap();
    (species, tree)
}

#[test]
fn a_known_tree_is_found_again() {
    for (name, height_m) in [("larix_sibirica", 16.0), ("betula_pendula", 12.0)] {
        let (species, truth) = known(name, height_m);
        let place = Vec3::new(12.5, -7.0, 104.0);
        let points: Vec<Vec3> = sampled(&truth, 0.025).iter().map(|p| *p + place).collect();
        let fitted = fit(&species, &points, detail(5000), Seed::new(1)).unwrap();
        fitted.skeleton.check().unwrap();
        let r = &fitted.report;
        println!("{name}: {} points, {r:?}", points.len());
        assert_eq!(r.led_by, Led::Stem);
        assert!(r.mean_m <= 0.02, "{name}: {r:?}");
        assert!(r.outside_length < 0.05 && r.outside_volume < 0.05, "{name}: {r:?}");
        assert!((r.height_m / truth.height_m() - 1.0).abs() < 0.02, "{name}: {r:?}");
        assert!(fitted.root.distance(place) < 0.08, "{name}: {}", fitted.root);
        let ratio = r.stem_diameter_m / (2.0 * breast_radius(&truth));
        assert!((ratio - 1.0).abs() < 0.05, "{name}: diameter {ratio} times the truth");
        assert_eq!(r.points, r.measured + r.ground + r.strays + r.not_finite);
    }
}

/// Ground under a known tree is told from it, level or steep, and the stem stands on it.
#[test]
fn ground_is_left_out() {
    let (species, truth) = known("larix_sibirica", 16.0);
    for slope in [0.0, 0.3] {
        let mut points = sampled(&truth, 0.03);
        points.retain(|p| p.z > 0.02);
        let tree = points.len();
        for k in 0..3600 {
            let (x, y) = (k as f32 % 60.0 * 0.1 - 3.0, (k / 60) as f32 * 0.1 - 3.0);
            points.push(Vec3::new(x, y, slope * x));
        }
        let fitted = fit(&species, &points, detail(1500), Seed::new(1)).unwrap();
        let r = &fitted.report;
        assert!(r.ground >= 3500 && r.measured * 10 >= tree * 9, "{tree} of the tree: {r:?}");
        assert!(fitted.root.length() < 0.15, "{}", fitted.root);
        assert!(r.mean_m < 0.05, "{r:?}");
    }
}

/// From above: the uppermost point of each cell of 0.4 m, and some ground.
#[test]
fn a_crown_from_the_air_gives_a_whole_tree() {
    let (species, truth) = known("larix_sibirica", 18.0);
    let mut top = std::collections::BTreeMap::new();
    for p in sampled(&truth, 0.05) {
        let cell = (p.truncate() / 0.4).floor().as_ivec2().to_array();
        let highest = top.entry(cell).or_insert(p);
        if p.z > highest.z {
            *highest = p;
        }
    }
    let mut points: Vec<Vec3> = top.into_values().filter(|p| p.z > 3.0).collect();
    points.extend((0..100).map(|k| {
        Vec3::new((k % 10) as f32 * 0.8 - 3.6, (k / 10) as f32 * 0.8 - 3.6, 0.01 * (k % 3) as f32)
    }));
    let fitted = fit(&species, &points, detail(2000), Seed::new(1)).unwrap();
    let (s, r) = (&fitted.skeleton, &fitted.report);
    assert_eq!(r.led_by, Led::Crown);
    assert!((s.height_m() / truth.height_m() - 1.0).abs() < 0.05, "{r:?}");
    assert!(fitted.root.z.abs() < 0.1, "{}", fitted.root);
    assert!(r.mean_m < 0.15, "{r:?}");
    // Wood from the ground up, at every height.
    for k in 1..18 {
        let z = k as f32;
        let is_there = (1..s.len()).any(|i| {
            let p = s.parent[i] as usize;
            s.position[p].z.min(s.position[i].z) <= z && z <= s.position[p].z.max(s.position[i].z)
        });
        assert!(is_there, "no wood at {z} m");
    }
}

#[test]
fn clouds_that_are_no_tree_are_refused_in_words() {
    let species = species::load("betula_pendula").unwrap();
    let refused = |points: &[Vec3], says: &str, remedy: &str| {
        let e = fit(&species, points, detail(500), Seed::new(1)).unwrap_err();
        assert!(e.message().contains(says), "{e:?}");
        assert!(e.remedy_text().is_some_and(|r| r.contains(remedy)), "{e:?}");
    };
    refused(&[], "a cloud of 0 points is no tree", "at least 20 points");
    refused(&[Vec3::ONE], "a cloud of 1 points is no tree", "at least 20 points");
    refused(&[Vec3::ONE; 500], "0.0 m high", "at least 0.3 m high");
    refused(&[Vec3::NAN; 500], "a cloud of 0 points", "at least 20 points");
    let plane: Vec<Vec3> =
        (0..2500).map(|i| Vec3::new((i % 50) as f32, (i / 50) as f32, 0.0) * 0.1).collect();
    refused(&plane, "a cloud of 2500 points 0.0 m high is no tree", "at least 0.3 m high");
    let wide: Vec<Vec3> =
        (0..9000).map(|i| Vec3::new(0.1 * (i % 900) as f32, 0.0, (i / 900) as f32)).collect();
    refused(&wide, "a cloud 90 m wide is no single tree", "larix forest");
    let (_, tree) = known("betula_pendula", 8.0);
    let mut two = sampled(&tree, 0.05);
    two.extend(two.clone().iter().map(|p| *p + Vec3::X * 30.0));
    refused(&two, "the cloud is in parts", "larix forest");
}

/// A wall, a pole, a ball: no tree, but no reason to stop either.
#[test]
fn odd_shapes_do_no_harm() {
    let species = species::load("pinus_sylvestris").unwrap();
    let mut draws = Seed::new(2).draws();
    let wall: Vec<Vec3> = (0..4000)
        .map(|_| Vec3::new(draws.between(0.0, 5.0), 0.0, draws.between(0.0, 5.0)))
        .collect();
    let pole: Vec<Vec3> = (0..2000).map(|i| Vec3::Z * (i as f32 * 0.005)).collect();
    let ball: Vec<Vec3> = (0..4000).map(|_| draws.direction() * 2.0).collect();
    for points in [wall, pole, ball] {
        if let Ok(fitted) = fit(&species, &points, detail(300), Seed::new(1)) {
            fitted.skeleton.check().unwrap();
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]
    #[test]
    fn no_points_make_it_panic(
        points in prop::collection::vec(
            (-1e3f32..1e3, -1e3f32..1e3, prop_oneof![-50.0f32..50.0, Just(f32::NAN), Just(0.0)]),
            0..200),
        scale in prop_oneof![Just(1e-6f32), Just(1e-3), Just(0.02), Just(1.0), Just(1e6)],
        nodes in prop_oneof![Just(0u32), 40u32..400],
    ) {
        let species = species::load("salix_caprea").unwrap();
        let points: Vec<Vec3> =
            points.into_iter().map(|(x, y, z)| Vec3::new(x, y, z) * scale).collect();
        if let Ok(fitted) = fit(&species, &points, detail(nodes), Seed::new(1)) {
            prop_assert!(fitted.skeleton.check().is_ok());
        }
    }
}

fn real(name: &str) -> Option<(PathBuf, Vec<Vec3>)> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data").join(name);
    if !path.exists() {
        println!("skipped: no {}", path.display());
        return None;
    }
    let read = crate::scan::read(std::slice::from_ref(&path), &Default::default()).unwrap();
    Some((path, read.value.cloud.position))
}

const REAL: [(&str, &str); 2] =
    [("adtree/tree1.xyz", "betula_pendula"), ("treels/pine.laz", "pinus_sylvestris")];

#[test]
fn scanned_trees_are_met_within_five_centimetres() {
    for (name, species) in REAL {
        let Some((_, points)) = real(name) else { return };
        let species = species::load(species).unwrap();
        let fitted = fit(&species, &points, detail(3333), Seed::new(1)).unwrap();
        fitted.skeleton.check().unwrap();
        let r = &fitted.report;
        println!("{name}: {r:?}");
        assert_eq!(r.led_by, Led::Stem);
        assert!(r.mean_m <= 0.05, "{name}: {r:?}");
        assert!(r.outside_length < 0.05, "{name}: {r:?}");
        assert!(r.measured * 100 >= points.len() * 95, "{name}: {r:?}");
    }
}

/// Error against time: `cargo test --release -- --ignored --nocapture error_against`.
#[test]
#[ignore = "prints a table"]
fn error_against_nodes_and_seconds() {
    println!("{:<20}{:>8}{:>10}{:>10}{:>9}", "cloud", "nodes", "mean cm", "95 % cm", "seconds");
    for (name, species) in REAL {
        let Some((_, points)) = real(name) else { return };
        let species = species::load(species).unwrap();
        for nodes in [800, 3333, 12_000] {
            let begun = std::time::Instant::now();
            let fitted = fit(&species, &points, detail(nodes), Seed::new(1)).unwrap();
            let (r, seconds) = (&fitted.report, begun.elapsed().as_secs_f64());
            let (mean, p95) = (100.0 * r.mean_m, 100.0 * r.p95_m);
            println!("{name:<20}{nodes:>8}{mean:>10.2}{p95:>10.2}{seconds:>9.2}");
        }
    }
}
