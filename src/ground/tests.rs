//! Ground on simulated slopes, and the refusals.

use glam::DVec3;

use super::*;
use crate::frame::Frame;
use crate::seed::Seed;

fn cloud(position: Vec<Vec3>, class: Vec<u8>) -> PointCloud {
    let n = position.len();
    PointCloud {
        frame: Frame::local(DVec3::new(0.0, 0.0, 500.0)),
        position,
        intensity: vec![0; n],
        return_number: vec![1; n],
        return_count: vec![1; n],
        class,
        rgb: None,
    }
}

/// A slope with waves under blobs of canopy that hide two thirds of it. Gives the points and
/// which are ground.
fn forest(slope: f32) -> (Vec<Vec3>, Vec<bool>) {
    let ground = |x: f32, y: f32| slope * x + 1.5 * (x * 0.12).sin() + (y * 0.15).cos();
    let mut d = Seed::new(11).draws();
    let trees: Vec<[f32; 3]> = (0..160)
        .map(|_| [d.between(0.0, 100.0), d.between(0.0, 80.0), d.between(8.0, 22.0)])
        .collect();
    let mut out = (Vec::new(), Vec::new());
    for _ in 0..60_000 {
        let (x, y) = (d.between(0.0, 100.0), d.between(0.0, 80.0));
        let over = trees.iter().find(|t| (t[0] - x).hypot(t[1] - y) < 3.0);
        let z = ground(x, y);
        match over {
            Some(t) if d.unit() < 0.85 => {
                let reach = (t[0] - x).hypot(t[1] - y) / 3.0;
                out.0.push(Vec3::new(x, y, z + t[2] * (1.0 - 0.5 * reach) * d.between(0.5, 1.0)));
                out.1.push(false);
            }
            _ => {
                out.0.push(Vec3::new(x, y, z + 0.03 * d.normal()));
                out.1.push(true);
            }
        }
    }
    out
}

#[test]
fn filters_find_the_ground_on_level_and_steep_slopes() {
    for (slope, method) in
        [0.0, 0.35, 0.7].into_iter().flat_map(|s| [(s, Method::Smrf), (s, Method::Tin)])
    {
        let (points, truth) = forest(slope);
        let n = points.len();
        let c = classify(cloud(points, vec![1; n]), method).unwrap().value;
        let mut tally = [0; 4];
        for (kind, truth) in c.kind.iter().zip(truth) {
            tally[usize::from(*kind == Kind::Ground) * 2 + usize::from(truth)] += 1;
        }
        let [_, missed, wrong, right] = tally;
        let recall = right as f32 / (right + missed) as f32;
        let precision = right as f32 / (right + wrong) as f32;
        assert!(
            recall > 0.93 && precision > 0.98,
            "{method:?}, slope {slope}: {recall} {precision}"
        );
    }
}

/// Share of bare ground of the given shape that is found within `reach` of x = 50.
fn found_near_the_middle(ground: impl Fn(f32, f32) -> f32, reach: f32) -> f32 {
    let mut d = Seed::new(5).draws();
    let points: Vec<Vec3> = (0..40_000)
        .map(|_| [d.between(0.0, 100.0), d.between(0.0, 100.0)])
        .map(|[x, y]| Vec3::new(x, y, ground(x, y)))
        .collect();
    let n = points.len();
    let c = classify(cloud(points, vec![1; n]), Method::Smrf).unwrap().value;
    let near: Vec<bool> = c
        .cloud
        .position
        .iter()
        .zip(&c.kind)
        .filter(|(p, _)| (p.x - 50.0).abs() < reach)
        .map(|(_, k)| *k == Kind::Ground)
        .collect();
    near.iter().filter(|g| **g).count() as f32 / near.len() as f32
}

#[test]
fn ridges_gullies_and_waves_keep_their_points() {
    let tilted = found_near_the_middle(|x, y| 0.8 * x - 0.5 * y, 50.0);
    assert_eq!(tilted, 1.0);
    let waves = |x: f32, y: f32| 4.0 * (x * 0.15).sin() + 4.0 * (y * 0.15).cos();
    let waves = found_near_the_middle(waves, 50.0);
    assert!(waves > 0.97, "{waves}");
    for slope in [0.4, 0.7] {
        // An edge as sharp as a roof: the last metre of it is rounded.
        let ridge = found_near_the_middle(|x, _| 60.0 - slope * (x - 50.0).abs(), 10.0);
        assert!(ridge > 0.85, "{slope}: {ridge}");
        let gully = found_near_the_middle(|x, _| slope * (x - 50.0).abs(), 10.0);
        assert!(gully > 0.85, "{slope}: {gully}");
    }
}

#[test]
fn a_cliff_keeps_the_ground_above_and_below_it() {
    // Twelve metres high; some metres beside its edge are lost.
    let cliff = |x: f32, y: f32| if x < 50.0 { 0.02 * y } else { 12.0 + 0.02 * y };
    assert!(found_near_the_middle(cliff, 50.0) > 0.9);
}

#[test]
fn voxel_rules_find_most_of_a_gentle_slope() {
    let (points, truth) = forest(0.1);
    let n = points.len();
    let method = Method::VoxelRules;
    let c = classify(cloud(points, vec![1; n]), method).unwrap().value;
    let right = c.kind.iter().zip(&truth).filter(|(k, t)| (**k == Kind::Ground) == **t).count();
    assert!(right as f32 / n as f32 > 0.85, "{right} of {n}");
}

/// A scan cut in two gives the ground that the whole gives, away from the cut.
#[test]
fn a_cut_does_not_change_the_ground_far_from_it() {
    let (points, _) = forest(0.4);
    let n = points.len();
    for method in [Method::Smrf, Method::Tin] {
        let found = |points: Vec<Vec3>| {
            let n = points.len();
            classify(cloud(points, vec![1; n]), method).unwrap().value.kind
        };
        let whole = found(points.clone());
        // Not at a multiple of any cell.
        let part: Vec<usize> = (0..n).filter(|&i| points[i].x < 77.3).collect();
        let cut = found(part.iter().map(|&i| points[i]).collect());
        let far = || part.iter().zip(&cut).filter(|(i, _)| points[**i].x < 50.0);
        let differ = far().filter(|(i, kind)| whole[**i] != **kind).count();
        assert!(differ * 1000 <= far().count(), "{method:?}: {differ} of {}", far().count());
    }
}

#[test]
fn ground_learned_of_pieces_is_that_of_the_whole() {
    let (points, _) = forest(0.3);
    let n = points.len();
    let whole = cloud(points, vec![1; n]);
    let kept = |is_kept: &dyn Fn(Vec3) -> bool| {
        let mut piece = whole.clone();
        piece.retain(|i| is_kept(whole.position[i]));
        piece
    };
    let pieces = [kept(&|p| p.x < 32.0), kept(&|p| p.x >= 32.0)];
    for method in [Method::Smrf, Method::Tin, Method::VoxelRules] {
        let lowest: Vec<Vec3> = pieces.iter().flat_map(|p| lowest(p, false)).collect();
        let rule = Rule::learn(&lowest, method, false);
        let of_pieces = pieces.iter().flat_map(|p| p.position.iter().zip(rule.kinds(p)));
        let mut of_pieces: Vec<_> = of_pieces.map(|(p, k)| (p.to_array(), k)).collect();
        let found = classify(whole.clone(), method).unwrap().value;
        let mut of_whole: Vec<_> =
            found.cloud.position.iter().map(|p| p.to_array()).zip(found.kind).collect();
        for kinds in [&mut of_pieces, &mut of_whole] {
            kinds.sort_by(|a, b| a.0.partial_cmp(&b.0).unwrap());
        }
        assert!(of_pieces == of_whole, "{method:?}");
    }
}

#[test]
fn low_strays_do_not_pull_the_ground_down() {
    let (mut points, _) = forest(0.2);
    // Twelve strays, a few near each other, as scanners make them.
    let mut d = Seed::new(2).draws();
    for _ in 0..12 {
        points.push(Vec3::new(d.between(0.0, 100.0), d.between(0.0, 80.0), -25.0));
    }
    let n = points.len();
    let c = classify(cloud(points, vec![1; n]), Method::Smrf).unwrap().value;
    assert!(c.kind[n - 12..].iter().all(|k| *k != Kind::Ground));
    let ground = c.kind.iter().filter(|k| **k == Kind::Ground).count();
    assert!(ground > 20_000, "{ground}");
}

#[test]
fn the_files_own_classes_only_on_request() {
    let (points, truth) = forest(0.1);
    let class: Vec<u8> = truth.iter().map(|&g| if g { 2 } else { 5 }).collect();
    let method = Method::FileClasses;
    let c = classify(cloud(points.clone(), class), method).unwrap().value;
    assert!(c.kind.iter().zip(&truth).all(|(k, t)| (*k == Kind::Ground) == *t));
    let n = points.len();
    let e = classify(cloud(points, vec![1; n]), method).unwrap_err();
    assert_eq!(e.message(), "the scan holds no ground points (class 2)");
}

#[test]
fn water_and_buildings_are_excluded() {
    let (points, _) = forest(0.1);
    let n = points.len();
    let class: Vec<u8> = (0..n).map(|i| if i % 10 == 0 { 9 } else { 1 }).collect();
    let c = classify(cloud(points, class.clone()), Method::Smrf).unwrap().value;
    for (k, c) in c.kind.iter().zip(class) {
        assert_eq!(*k == Kind::Excluded, c == 9);
    }
}

#[test]
fn normalised_heights_are_recognised_and_absolute_ones_are_not() {
    let (points, _) = forest(0.0);
    let flat: Vec<Vec3> = {
        let (slope, truth) = forest(0.0);
        slope
            .iter()
            .zip(truth)
            .map(|(p, g)| Vec3::new(p.x, p.y, if g { 0.0 } else { p.z.abs() + 3.0 }))
            .collect()
    };
    let n = points.len();
    let mut level = cloud(flat, vec![1; n]);
    level.frame.origin.z = 0.0;
    let c = classify(level, Method::Smrf).unwrap();
    assert!(c.value.is_normalised && c.warnings.len() == 1);
    assert!(!classify(cloud(points, vec![1; n]), Method::Smrf).unwrap().value.is_normalised);
}

#[test]
fn few_points_equal_points_and_far_points_do_not_panic() {
    for n in 0..3 {
        let points: Vec<Vec3> = (0..n).map(|i| Vec3::splat(i as f32)).collect();
        let e = classify(cloud(points, vec![1; n]), Method::Smrf).unwrap_err();
        assert!(e.message().contains("too few"), "{e:?}");
    }
    for method in [Method::Smrf, Method::Tin, Method::VoxelRules] {
        let alike = vec![Vec3::new(5.0, 5.0, 5.0); 100];
        assert!(classify(cloud(alike, vec![1; 100]), method).is_ok());
        let far = vec![
            Vec3::ZERO,
            Vec3::new(150_000.0, 0.0, 3.0),
            Vec3::new(0.0, 150_000.0, 9.0),
            Vec3::ONE,
        ];
        let _ = classify(cloud(far, vec![1; 4]), method);
    }
}
