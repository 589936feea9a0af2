use glam::{Vec2, Vec3};

use super::crown::{Grove, Shape};
use super::stand::LEAST_SPACING;
use super::*;
use crate::raster::geotiff::Samples;
use crate::scan::PointCloud;
use crate::seed::Seed;
use crate::species::model::*;

fn species(id: &str, kind: Kind, height_m: f32, luminance: [f32; 2], colour: [u8; 3]) -> Species {
    Species {
        id: id.into(),
        name: id.into(),
        common: id.into(),
        builds_on: None,
        kind,
        branching: Branching::Monopodial,
        luminance: Some(luminance),
        size: Size {
            height_m,
            crown_diameter_m: if kind == Kind::Shrub { 2.6 } else { height_m * 0.24 },
            crown_base: if kind == Kind::Shrub { 0.05 } else { 0.3 },
            stem_diameter_m: height_m * 0.013,
            profile: match kind {
                Kind::Conifer => vec![[0.0, 0.7], [0.15, 1.0], [1.0, 0.0]],
                _ => vec![[0.0, 0.3], [0.4, 1.0], [0.8, 0.75], [1.0, 0.1]],
            },
        },
        growth: Growth {
            decay: vec![],
            tropism: 0.0,
            wander: 0.0,
            step: 1.0,
            influence: 1.0,
            kill: 1.0,
            pipe_exponent: 2.0,
            tip_radius_m: 0.01,
        },
        foliage: Foliage {
            shape: LeafShape::Ovate,
            leaf_length_m: 0.1,
            leaf_width_m: 0.1,
            colour,
            variation: 0.1,
            twig_length_m: 0.3,
            twigs_per_m: 4.0,
            droop: 0.0,
            bearing_radius_m: 0.02,
        },
        bark: Bark {
            style: BarkStyle::Smooth,
            colour: [90; 3],
            dark: [40; 3],
            upper: None,
            relief_m: 0.0,
        },
    }
}

fn four() -> Vec<Species> {
    vec![
        species("larch", Kind::Conifer, 24.0, [167.0, 171.0], [120, 160, 70]),
        species("birch", Kind::Broadleaf, 20.0, [184.0, 193.0], [110, 150, 60]),
        species("spruce", Kind::Conifer, 22.0, [72.0, 85.0], [50, 80, 45]),
        species("willow", Kind::Shrub, 3.5, [115.0, 127.0], [100, 130, 80]),
    ]
}

fn planted(trees: usize) -> Stand {
    let four = four();
    let mut options = StandOptions::of(&four.iter().collect::<Vec<_>>(), Seed::new(5));
    options.trees = trees;
    stand(&options).unwrap()
}

#[test]
fn the_stand_is_as_asked() {
    let stand = planted(240);
    assert_eq!(stand.trees.len(), 240);
    for id in ["larch", "birch", "spruce", "willow"] {
        assert_eq!(stand.trees.iter().filter(|t| t.species == id).count(), 60, "{id}");
    }
    for (i, a) in stand.trees.iter().enumerate() {
        let p = a.position;
        assert!(p.min_element() > -1.0 && p.x < stand.side_m && p.y < stand.side_m);
        let z = stand.relief.height_at(f64::from(p.x), f64::from(p.y));
        assert!((f64::from(p.z) - z).abs() < 1e-4);
        assert!(a.crown_base_height_m < a.height_m && a.stem_diameter_m > 0.0);
        for b in &stand.trees[..i] {
            let least = LEAST_SPACING * 0.5 * (a.crown_diameter_m + b.crown_diameter_m);
            assert!(p.truncate().distance(b.position.truncate()) >= least * 0.999);
        }
    }
    let area: f32 = stand.trees.iter().map(|t| 0.785 * t.crown_diameter_m.powi(2)).sum();
    let cover = area / stand.side_m.powi(2);
    assert!((0.4..0.63).contains(&cover), "crown cover {cover}");
    let z: Vec<f64> = (0..10_000)
        .map(|_| f64::from(stand.side_m) / 100.0)
        .enumerate()
        .map(|(i, d)| stand.relief.height_at((i % 100) as f64 * d, (i / 100) as f64 * d))
        .collect();
    let range =
        z.iter().copied().fold(f64::MIN, f64::max) - z.iter().copied().fold(f64::MAX, f64::min);
    assert!((range - 20.0).abs() < 0.8, "relief {range}");
}

#[test]
fn what_can_not_be_planted_is_refused() {
    let four = four();
    let mut options = StandOptions::of(&[], Seed::new(1));
    assert!(stand(&options).is_err());
    options.mix = vec![(&four[0], -1.0)];
    assert!(stand(&options).is_err());
    options.mix = vec![(&four[0], 1.0)];
    options.trees = 0;
    assert!(stand(&options).is_err());
    options.trees = 1;
    assert_eq!(stand(&options).unwrap().trees.len(), 1);
}

#[test]
fn a_cone_is_met_where_geometry_says() {
    let mut larch = four().remove(0);
    larch.size.profile = vec![[0.0, 1.0], [1.0, 0.0]];
    let tree = TrueTree {
        position: Vec3::new(10.0, 10.0, 2.0),
        height_m: 20.0,
        crown_diameter_m: 6.0,
        crown_base_height_m: 5.0,
        stem_diameter_m: 0.3,
        species: "larch".into(),
    };
    let shape = Shape::new(&tree, &larch, Seed::new(1));
    // The tip is over the axis; halfway up the radius is half.
    assert!((shape.surface_at(Vec2::splat(10.0)).unwrap() - 22.0).abs() < 0.02);
    assert!((shape.radius_at(14.5).unwrap() - 1.5).abs() < 1e-4);
    assert_eq!(shape.radius_at(6.9), None);
    assert_eq!(shape.surface_at(Vec2::new(14.6, 10.0)), None);
    assert_eq!(shape.extinction_at(Vec3::new(10.0, 10.0, 22.5)), 0.0);
    assert!(shape.extinction_at(Vec3::new(10.1, 10.0, 15.0)) > 0.0);
    assert!(shape.is_in_stem(Vec3::new(10.1, 10.0, 3.0)));
    assert!(!shape.is_in_stem(Vec3::new(10.2, 10.0, 3.0)));
    // Around the axis the lobes cancel: the mean radius at half height is the cone's.
    let mean: f32 = (0..360)
        .map(|i| {
            let (s, c) = (i as f32).to_radians().sin_cos();
            let inside =
                |r: f32| shape.extinction_at(Vec3::new(10.0 + c * r, 10.0 + s * r, 14.5)) > 0.0;
            (0..300).filter(|&k| inside(k as f32 * 0.01)).count() as f32 * 0.01
        })
        .sum::<f32>()
        / 360.0;
    assert!((mean - 1.5).abs() < 0.02, "{mean}");
    let shapes = [shape];
    let grove = Grove::new(&shapes, 20.0);
    assert_eq!(grove.over(Vec2::splat(9.0)).count(), 1);
    assert_eq!(grove.over(Vec2::splat(-9.0)).count(), 0);
}

fn flat_ground_of(cloud: &PointCloud) -> (usize, usize) {
    let first = cloud.return_number.iter().filter(|&&n| n == 1).count();
    (first, cloud.class.iter().filter(|&&c| c == 2).count())
}

#[test]
fn the_scan_is_as_dense_as_asked_and_its_ground_lies_on_the_relief() {
    let stand = planted(60);
    let options = ScannerOptions { is_classified: true, ..Default::default() };
    let cloud = scan(&stand, &options);
    let (pulses, ground) = flat_ground_of(&cloud);
    let density = pulses as f32 / stand.side_m.powi(2);
    assert!((density / 12.0 - 1.0).abs() < 0.04, "{density} pulses a square metre");
    // No corner of the stand is left out.
    for (x, y) in [(0.0, 0.0), (0.9, 0.0), (0.0, 0.9), (0.9, 0.9), (0.45, 0.45)] {
        let lo = Vec2::new(x, y) * stand.side_m;
        let inside = |p: &Vec3| {
            let d = p.truncate() - lo;
            d.min_element() >= 0.0 && d.max_element() < 0.1 * stand.side_m
        };
        let count = cloud.position.iter().filter(|p| inside(p)).count();
        assert!(count as f32 > 0.8 * 12.0 * (0.1 * stand.side_m).powi(2), "{count} at {lo}");
    }
    assert!(ground > pulses / 4, "{ground} of {pulses} pulses reach the ground");
    let mut squares = 0.0;
    for (p, _) in cloud.position.iter().zip(&cloud.class).filter(|(_, c)| **c == 2) {
        let d = f64::from(p.z) - stand.relief.height_at(f64::from(p.x), f64::from(p.y));
        assert!(d.abs() < 0.25);
        squares += d * d;
    }
    let rmse = (squares / ground as f64).sqrt();
    assert!((0.02..0.04).contains(&rmse), "{rmse} for a range noise of 0.03");
    for i in 0..cloud.len() {
        assert!(cloud.return_number[i] >= 1 && cloud.return_number[i] <= cloud.return_count[i]);
        assert!(cloud.return_count[i] <= 5);
    }
    assert!(cloud.return_count.iter().any(|&c| c >= 3));
    assert!(cloud.class.iter().any(|&c| c == 7 || c == 18));
}

#[test]
fn the_tops_of_trees_are_found_a_little_low() {
    let stand = planted(60);
    let cloud = scan(&stand, &ScannerOptions { strays_per_mille: 0.0, ..Default::default() });
    assert!(cloud.class.iter().all(|&c| c == 1));
    let mut low = Vec::new();
    for tree in stand.trees.iter().filter(|t| t.height_m > 12.0) {
        let near = cloud.position.iter().filter(|p| {
            p.truncate().distance(tree.position.truncate()) < 0.3 * tree.crown_diameter_m
        });
        let top = near.map(|p| p.z).fold(f32::MIN, f32::max);
        low.push(tree.position.z + tree.height_m - top);
    }
    let mean = low.iter().sum::<f32>() / low.len() as f32;
    assert!((0.05..1.6).contains(&mean), "tops are seen {mean} m low");
}

/// Depth of first hits in a deep, even, wide medium: the mean of an exponential law is 1/k.
#[test]
fn light_fades_by_the_exponential_law() {
    let mut shrub = species("block", Kind::Shrub, 40.0, [1.0, 2.0], [9; 3]);
    shrub.size.profile = vec![[0.0, 1.0], [1.0, 1.0]];
    shrub.size.crown_diameter_m = 4000.0;
    shrub.size.stem_diameter_m = 0.01;
    let mut options = StandOptions::of(&[&shrub], Seed::new(2));
    (options.trees, options.relief_m, options.crown_cover) = (1, 0.0, 0.9);
    let mut stand = stand(&options).unwrap();
    // Only the inner part is scanned, where the medium is even: 1.6 a metre × 0.45.
    let tree = stand.trees[0].clone();
    stand.shapes[0].axis = Vec2::splat(40.0);
    stand.side_m = 80.0;
    stand.relief = Relief::new(80.0, 0.0, Seed::new(2));
    let scanner = ScannerOptions {
        pulses_per_sq_m: 4.0,
        strays_per_mille: 0.0,
        range_noise_m: 0.0,
        scan_angle_deg: 2.0,
        ..Default::default()
    };
    let cloud = scan(&stand, &scanner);
    let top = tree.position.z + tree.height_m;
    let first: Vec<f64> = (0..cloud.len())
        .filter(|&i| cloud.return_number[i] == 1)
        // Pulses near the rim come in from where no leaves are known.
        .filter(|&i| (cloud.position[i].truncate() - 40.0).abs().max_element() < 30.0)
        .map(|i| f64::from(top - cloud.position[i].z))
        .collect();
    let mean = first.iter().sum::<f64>() / first.len() as f64;
    let variance = first.iter().map(|d| (d - mean).powi(2)).sum::<f64>() / first.len() as f64;
    let k = 1.6 * 0.46;
    assert!((mean * k - 1.0).abs() < 0.03, "mean depth {mean}, 1/k {}", 1.0 / k);
    assert!((variance.sqrt() / mean - 1.0).abs() < 0.03, "{} beside {mean}", variance.sqrt());
}

#[test]
fn one_thread_and_two_measure_the_same() {
    let stand = planted(30);
    let on = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let cloud = scan(&stand, &ScannerOptions::default());
            (cloud.position, cloud.intensity, photo(&stand, &PhotoOptions::default()))
        })
    };
    assert!(on(1) == on(2), "surveys differ");
}

#[test]
fn sunlit_crowns_have_their_species_luminance() {
    let stand = planted(120);
    let photo = photo(&stand, &PhotoOptions::default());
    assert_eq!((photo.bands, photo.epsg), (3, Some(32646)));
    let Samples::U8(data) = &photo.samples else { panic!("not 8 bits") };
    assert_eq!(data.len(), photo.width * photo.height * 3);
    let geometry = photo.geometry.unwrap();
    let mut right = 0;
    let looks: Vec<_> = four().into_iter().map(|s| (s.id, s.luminance.unwrap())).collect();
    let mut of_species: std::collections::BTreeMap<&str, Vec<f32>> = Default::default();
    for tree in &stand.trees {
        let mut values = Vec::new();
        for dy in -8..=8 {
            for dx in -8..=8 {
                let d = Vec2::new(dx as f32, dy as f32) * tree.crown_diameter_m / 32.0;
                let world = stand.frame.world_from_local(tree.position + d.extend(0.0));
                let Some((c, r)) = geometry.cell_of(world.x, world.y) else { continue };
                let v = |b| photo.value(c, r, b);
                values.push(0.299 * v(0) + 0.587 * v(1) + 0.114 * v(2));
            }
        }
        // Neighbours shade a part of many crowns: the brighter third is sunlit.
        values.sort_by(f32::total_cmp);
        let y = values[values.len() * 7 / 10];
        of_species.entry(&tree.species).or_default().push(y);
        let nearest = looks.iter().min_by(|a, b| {
            let off = |r: [f32; 2]| (y - 0.5 * (r[0] + r[1])).abs();
            off(a.1).total_cmp(&off(b.1))
        });
        right += usize::from(nearest.unwrap().0 == tree.species);
    }
    for (id, range) in &looks {
        let values = of_species.get_mut(id.as_str()).unwrap();
        values.sort_by(f32::total_cmp);
        let median = values[values.len() / 2];
        let middle = 0.5 * (range[0] + range[1]);
        assert!((median - middle).abs() < 10.0, "{id}: {median} for {middle}");
    }
    assert!(right * 10 >= stand.trees.len() * 7, "{right} of {}", stand.trees.len());
}

fn found(t: &TrueTree) -> FoundTree {
    FoundTree {
        position: t.position.truncate(),
        height_m: t.height_m,
        crown_diameter_m: t.crown_diameter_m,
        species: Some(t.species.clone()),
    }
}

#[test]
fn the_truth_in_any_order_is_wholly_matched() {
    let stand = planted(50);
    let mut all: Vec<FoundTree> = stand.trees.iter().map(found).collect();
    all.reverse();
    all.rotate_left(17);
    let c = compare(&stand.trees, &all);
    assert_eq!((c.matched, c.missed, c.invented), (50, 0, 0));
    assert_eq!((c.f1, c.position_rmse_m, c.height_m.rmse), (1.0, 0.0, 0.0));
    assert_eq!((c.species_named, c.species_right), (50, 50));
    for (t, f) in c.pairs {
        assert_eq!(stand.trees[t as usize].position.truncate(), all[f as usize].position);
    }
}

#[test]
fn known_errors_are_measured_as_they_are() {
    let stand = planted(40);
    let mut all: Vec<FoundTree> = stand.trees.iter().map(found).collect();
    for (i, f) in all.iter_mut().enumerate() {
        f.position += Vec2::new(0.3, 0.4);
        f.height_m += if i % 2 == 0 { 1.0 } else { -2.0 };
        f.crown_diameter_m -= 0.25;
        f.species = (i % 4 == 0).then(|| "larch".into());
    }
    all.truncate(38);
    all.push(FoundTree {
        position: Vec2::splat(1e6),
        height_m: 20.0,
        crown_diameter_m: 4.0,
        species: None,
    });
    let c = compare(&stand.trees, &all);
    assert_eq!((c.truth, c.found, c.matched, c.missed, c.invented), (40, 39, 38, 2, 1));
    assert!((c.position_rmse_m - 0.5).abs() < 1e-4);
    assert!((c.height_m.bias + 0.5).abs() < 1e-4);
    assert!((c.height_m.rmse - 2.5f64.sqrt()).abs() < 1e-4);
    assert!((c.crown_diameter_m.bias + 0.25).abs() < 1e-4);
    assert_eq!(c.species_named, 10);
    let right = (0..38).step_by(4).filter(|&i| stand.trees[i].species == "larch").count();
    assert_eq!(c.species_right, right);
    assert!(serde_json::to_string(&c).unwrap().contains("\"missed\":2"));
    assert_eq!(compare(&[], &[]).f1, 0.0);
}

#[test]
fn terrain_errors_are_measured_against_the_function() {
    let stand = planted(5);
    let places = [[1.0, 2.0], [5.0, 3.0]];
    let e = terrain_error(&stand, places, |p| stand.relief.height_at(p[0], p[1]) + 0.1);
    assert!((e.rmse - 0.1).abs() < 1e-9 && (e.bias - 0.1).abs() < 1e-9 && e.count == 2);
}
