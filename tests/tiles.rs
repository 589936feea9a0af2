//! A scan worked through by tiles gives what it gives in one piece, however it is cut into files.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use larix::crown::Crown;
use larix::ground::Method;
use larix::pipeline::{self, Effort, Survey, SurveyJob};
use larix::report::{Recorder, Silent};
use larix::scan::{ReadOptions, encode_laz, read};
use larix::seed::Seed;
use larix::simulate::StandOptions;
use larix::species::assign::SpeciesBy;

fn survey(scans: &[PathBuf], tile_m: Option<f32>) -> Survey {
    let job = SurveyJob {
        scans: scans.into(),
        ground: Method::Smrf,
        cell_m: None,
        tile_m,
        photo: None,
        species: vec![larix::species::load("pinus_sylvestris").unwrap()],
        species_by: SpeciesBy::Auto,
        voxel_m: None,
        min_height_m: 2.0,
        effort: Effort::Normal,
        seed: Seed::new(1),
    };
    pipeline::survey::inventory(&job, &mut Recorder::new(&Silent)).unwrap()
}

/// The scan cut in four files through its middle.
fn quarters(scan: &Path, dir: &Path) -> Vec<PathBuf> {
    let options =
        ReadOptions { drop_noise_classes: false, drop_isolated: false, ..ReadOptions::default() };
    let whole = read(&[scan.to_path_buf()], &options).unwrap().value;
    let middle = 0.5 * (whole.bounds.min + whole.bounds.max);
    (0..4)
        .map(|k| {
            let mut cloud = whole.cloud.clone();
            let position = whole.cloud.position.clone();
            cloud.retain(|i| {
                let p = position[i];
                usize::from(p.x >= middle.x) + 2 * usize::from(p.y >= middle.y) == k
            });
            let path = dir.join(format!("{k}.laz"));
            std::fs::write(&path, encode_laz(&cloud).unwrap()).unwrap();
            path
        })
        .collect()
}

/// Nearer to the edge of a file, what lies beyond changes the crowns.
const EDGE_M: f64 = 10.0;

/// Trees that only one of two surveys has, and those of the same id whose crowns differ by more than
/// a millimetre.
fn differences(a: &Survey, b: &Survey) -> (usize, usize) {
    assert_eq!(a.terrain.heights.geometry, b.terrain.heights.geometry);
    assert_eq!(a.frame, b.frame);
    let by_key = |s: &Survey| -> BTreeMap<u64, Crown> {
        s.trees.iter().map(|t| (t.crown.key, t.crown.clone())).collect()
    };
    let (a, b) = (by_key(a), by_key(b));
    let only = a.keys().filter(|k| !b.contains_key(k)).count()
        + b.keys().filter(|k| !a.contains_key(k)).count();
    let near = |x: f32, y: f32| (x - y).abs() < 1e-3;
    let changed = a.iter().filter(|(k, x)| {
        b.get(k).is_some_and(|y| {
            !(near(x.height_m, y.height_m)
                && near(x.base_height_m, y.base_height_m)
                && near(x.diameter_m, y.diameter_m)
                && near(x.confidence, y.confidence)
                && x.point_count == y.point_count
                && x.outline.len() == y.outline.len()
                && x.outline.iter().zip(&y.outline).all(|(p, q)| p.distance(*q) < 1e-3))
        })
    });
    (only, changed.count())
}

fn compare(name: &str, scan: &Path, tile_m: f32, dir: &Path) {
    let whole = survey(&[scan.to_path_buf()], None);
    let quarters = quarters(scan, dir);
    let cut = differences(&whole, &survey(&quarters, None));
    let tiled = differences(&whole, &survey(&quarters, Some(tile_m)));
    println!(
        "{name}: {} trees in one piece; elsewhere or changed in four files {cut:?}, by tiles of \
         {tile_m} m {tiled:?}",
        whole.trees.len()
    );
    assert_eq!((cut, tiled), ((0, 0), (0, 0)), "{name}");
}

#[test]
fn stands_far_apart_have_all_their_trees() {
    let dir = tempfile::tempdir().unwrap();
    let species = [larix::species::load("pinus_sylvestris").unwrap()];
    let options = StandOptions { trees: 60, relief_m: 0.0, ..StandOptions::default() };
    let made = pipeline::demo::survey_of_stand(
        &options,
        &species,
        Seed::new(5),
        &mut Recorder::new(&Silent),
    );
    let one = dir.path().join("one.laz");
    std::fs::write(&one, made.unwrap().scan).unwrap();
    let alone = survey(std::slice::from_ref(&one), None).trees.len();
    for km in [0.5, 2.0, 4.0] {
        let mut cloud =
            read(std::slice::from_ref(&one), &ReadOptions::default()).unwrap().value.cloud;
        cloud.frame.origin += glam::DVec3::new(km * 1e3, km * 1e3, 0.0);
        let other = dir.path().join("other.laz");
        std::fs::write(&other, encode_laz(&cloud).unwrap()).unwrap();
        let both = survey(&[one.clone(), other], None).trees.len();
        assert!(both.abs_diff(2 * alone) <= alone / 20, "{km} km: {both}, alone {alone}");
    }
}

#[test]
fn a_simulated_scan_cut_in_four_is_the_same_forest() {
    let dir = tempfile::tempdir().unwrap();
    let species: Vec<_> = ["larix_sibirica", "betula_pendula", "pinus_sylvestris"]
        .map(|n| larix::species::load(n).unwrap())
        .to_vec();
    let options = StandOptions { trees: 700, ..StandOptions::default() };
    let mut run = Recorder::new(&Silent);
    let made = pipeline::demo::survey_of_stand(&options, &species, Seed::new(5), &mut run).unwrap();
    let scan = dir.path().join("whole.laz");
    std::fs::write(&scan, &made.scan).unwrap();
    compare("simulated", &scan, 64.0, dir.path());
}

#[test]
fn real_scans_cut_in_four_are_the_same_forest() {
    for name in ["lasR/bcts_1.laz", "pycrown/POINTS_abs.laz", "lidR/MixedConifer.laz"] {
        let scan = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data").join(name);
        if !scan.exists() {
            println!("skipped: {} is not here", scan.display());
            continue;
        }
        let dir = tempfile::tempdir().unwrap();
        compare(name, &scan, 128.0, dir.path());
    }
}

/// Grids span the gaps: their cells must not follow from that.
#[test]
fn plots_apart_keep_the_trees_they_have_alone() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data/idtrees/las");
    let files = ["MLBS_2.las", "MLBS_4.las", "MLBS_6.las"].map(|name| folder.join(name));
    if !files.iter().all(|f| f.exists()) {
        println!("skipped: {} is not here", folder.display());
        return;
    }
    let together = survey(&files, None);
    assert_eq!(differences(&together, &survey(&files, Some(256.0))), (0, 0));
    let ids = |s: &Survey| -> Vec<u64> { s.trees.iter().map(|t| t.crown.key).collect() };
    let alone: Vec<u64> =
        files.iter().flat_map(|f| ids(&survey(std::slice::from_ref(f), None))).collect();
    let together = ids(&together);
    // The terrain of all has larger cells, which moves a few roots.
    let same = together.iter().filter(|id| alone.contains(id)).count();
    println!("{same} of {} and {} trees are the same", together.len(), alone.len());
    assert!(2 * same > alone.len(), "{same} of {}", alone.len());
    assert!(together.len().abs_diff(alone.len()) * 4 < alone.len());
}

#[test]
fn neighbouring_files_make_one_forest_without_a_seam() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data/lasR");
    let files = ["bcts_1.laz", "bcts_2.laz"].map(|name| folder.join(name));
    if !files.iter().all(|f| f.exists()) {
        println!("skipped: {} is not here", folder.display());
        return;
    }
    let both = survey(&files, None);
    assert_eq!(differences(&both, &survey(&files, Some(128.0))), (0, 0));
    // Where the files meet the trees stand as close as elsewhere.
    let edge = |file: &PathBuf| {
        let scan = read(std::slice::from_ref(file), &ReadOptions::default()).unwrap().value;
        let corner = |p| scan.cloud.frame.world_from_local(p);
        (corner(scan.bounds.min), corner(scan.bounds.max))
    };
    let [(a_min, a_max), (b_min, b_max)] = [edge(&files[0]), edge(&files[1])];
    let gaps = [b_min.x - a_max.x, a_min.x - b_max.x, b_min.y - a_max.y, a_min.y - b_max.y];
    println!("files apart by {gaps:?}; {} trees", both.trees.len());
    let (along_x, seam) = if gaps[0].abs() < 2.0 {
        (true, a_max.x)
    } else if gaps[1].abs() < 2.0 {
        (true, a_min.x)
    } else if gaps[2].abs() < 2.0 {
        (false, a_max.y)
    } else {
        (false, a_min.y)
    };
    let count = |from: f64, to: f64| {
        both.trees
            .iter()
            .map(|t| both.frame.world_from_local(t.crown.root))
            .map(|p| if along_x { p.x } else { p.y } - seam)
            .filter(|d| (from..to).contains(d))
            .count()
    };
    let (at, beside) = (count(-4.0, 4.0), count(-28.0, -4.0) + count(4.0, 28.0));
    println!("{at} trees within 4 m of the seam, {beside} in six such strips beside it");
    assert!((6 * at).abs_diff(beside) * 3 < beside, "{at} {beside}");
}

#[test]
fn a_neighbouring_file_changes_next_to_no_id() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data/lasR");
    let files = ["bcts_1.laz", "bcts_2.laz"].map(|name| folder.join(name));
    if !files.iter().all(|f| f.exists()) {
        println!("skipped: {} is not here", folder.display());
        return;
    }
    let (alone, both) = (survey(&files[..1], None), survey(&files, None));
    let g = alone.terrain.heights.geometry;
    let corner = |x: f64, y: f64| alone.frame.origin.truncate() + glam::DVec2::new(x, y);
    let (low, high) = (corner(g.west, g.south()), corner(g.east(), g.north));
    let ids = |s: &Survey| -> std::collections::BTreeSet<u64> {
        let inside = s.trees.iter().filter(|t| {
            let p = s.frame.world_from_local(t.crown.root).truncate();
            (p - low).min(high - p).min_element() > EDGE_M
        });
        inside.map(|t| t.crown.key).collect()
    };
    let (alone, both) = (ids(&alone), ids(&both));
    let same = alone.intersection(&both).count();
    println!("{} trees, {} of them with the same id beside the other file", alone.len(), same);
    // Coordinates are rounded by another origin: a root between two equal layers may take the other.
    assert!((alone.len() - same).max(both.len() - same) * 500 <= alone.len());
}
