//! Crowns on real scans, LiDAR alone, over the files' own ground class: the score on the annotated
//! plots, and sane crowns on every other scan with the same defaults.
//!
//! With `CROWNS_DIR` set, the crowns of each plot are written there as GeoJSON in the scan's own
//! coordinates.

use std::path::{Path, PathBuf};

use glam::{DVec2, DVec3, Vec3};
use larix::crown::{Crown, CrownOptions, detect};
use larix::ground::{Classified, Kind};
use larix::pipeline::survey::READ;
use larix::raster::{Grid, GridGeometry};
use larix::scan::{PointCloud, read};
use larix::terrain::Terrain;
use larix::voxel;

fn data(name: &str) -> Option<PathBuf> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data").join(name);
    if !path.exists() {
        println!("skipped: {} is not here", path.display());
        return None;
    }
    Some(path)
}

/// The file's ground class as a grid of means, voids from their neighbours; the lowest point where
/// there is no ground class.
fn classify(cloud: PointCloud) -> (Classified, Terrain) {
    let position = &cloud.position;
    let low = position.iter().copied().fold(Vec3::INFINITY, Vec3::min).as_dvec3();
    let high = position.iter().copied().fold(Vec3::NEG_INFINITY, Vec3::max).as_dvec3();
    let kind: Vec<Kind> = cloud
        .class
        .iter()
        .map(|class| match class {
            2 => Kind::Ground,
            9 => Kind::Excluded,
            _ => Kind::Vegetation,
        })
        .collect();
    let g = GridGeometry::covering([low.x, low.y], [high.x, high.y], 1.0);
    let mut sum = vec![(0.0f64, 0u32); g.len()];
    for (p, k) in position.iter().zip(&kind) {
        if let (Kind::Ground, Some((c, r))) = (k, g.cell_of(f64::from(p.x), f64::from(p.y))) {
            let s = &mut sum[g.index(c, r)];
            *s = (s.0 + f64::from(p.z), s.1 + 1);
        }
    }
    let is_observed: Vec<bool> = sum.iter().map(|s| s.1 > 0).collect();
    let mut data: Vec<f32> = sum.iter().map(|s| (s.0 / f64::from(s.1)) as f32).collect();
    if !is_observed.contains(&true) {
        data.fill(low.z as f32);
    }
    while data.iter().any(|h| h.is_nan()) {
        let old = data.clone();
        for i in (0..g.len()).filter(|&i| old[i].is_nan()) {
            let (c, r) = (i % g.cols, i / g.cols);
            let around: Vec<f32> = (r.saturating_sub(1)..(r + 2).min(g.rows))
                .flat_map(|r| (c.saturating_sub(1)..(c + 2).min(g.cols)).map(move |c| (c, r)))
                .map(|(c, r)| old[g.index(c, r)])
                .filter(|h| !h.is_nan())
                .collect();
            data[i] = around.iter().sum::<f32>() / around.len() as f32;
        }
    }
    let terrain = Terrain { heights: Grid { geometry: g, data }, is_observed };
    (Classified { cloud, kind, is_normalised: false }, terrain)
}

fn crowns_of(path: &Path) -> (Vec<Crown>, DVec3, Vec<String>) {
    let scan = read(&[path.to_path_buf()], &READ).unwrap().value;
    let (classified, terrain) = classify(scan.cloud);
    let start = std::time::Instant::now();
    let size_m = voxel::choose_size_m(scan.density_per_m2, 4.0);
    let found = detect(&classified, &terrain, size_m, &CrownOptions::default()).unwrap();
    let seconds = start.elapsed().as_secs_f64();
    println!("{}: {} trees in {seconds:.3} s", path.display(), found.value.len());
    for crown in &found.value {
        crown.check().unwrap();
    }
    let origin = classified.cloud.frame.origin;
    (found.value, origin, found.warnings)
}

/// West, south, east, north.
type Box4 = [f64; 4];

fn world_box(crown: &Crown, origin: DVec3) -> Box4 {
    let corner = |p: &glam::Vec2| p.as_dvec2() + origin.truncate();
    let low = crown.outline.iter().map(corner).fold(DVec2::INFINITY, DVec2::min);
    let high = crown.outline.iter().map(corner).fold(DVec2::NEG_INFINITY, DVec2::max);
    [low.x, low.y, high.x, high.y]
}

fn overlap(a: &Box4, b: &Box4) -> f64 {
    let area = |q: &Box4| (q[2] - q[0]) * (q[3] - q[1]);
    let w = (a[2].min(b[2]) - a[0].max(b[0])).max(0.0);
    let h = (a[3].min(b[3]) - a[1].max(b[1])).max(0.0);
    w * h / (area(a) + area(b) - w * h)
}

/// Pairs that overlap to 0.4 of their union, best first: a lower bound of the best assignment.
fn matches(truth: &[Box4], found: &[Box4]) -> usize {
    let mut pairs: Vec<(f64, usize, usize)> = Vec::new();
    for (i, t) in truth.iter().enumerate() {
        for (j, f) in found.iter().enumerate() {
            pairs.push((overlap(t, f), i, j));
        }
    }
    pairs.retain(|p| p.0 >= 0.4);
    pairs.sort_by(|a, b| b.0.total_cmp(&a.0));
    let (mut used_t, mut used_f) = (vec![false; truth.len()], vec![false; found.len()]);
    let mut n = 0;
    for (_, i, j) in pairs {
        if !used_t[i] && !used_f[j] {
            (used_t[i], used_f[j]) = (true, true);
            n += 1;
        }
    }
    n
}

fn write_geojson(path: &Path, crowns: &[Crown], origin: DVec3) {
    let feature = |c: &Crown| {
        let mut ring: Vec<[f64; 2]> = c
            .outline
            .iter()
            .map(|p| [f64::from(p.x) + origin.x, f64::from(p.y) + origin.y])
            .collect();
        ring.extend(ring.first().copied());
        serde_json::json!({
            "type": "Feature",
            "properties": {"height_m": c.height_m, "confidence": c.confidence, "points": c.point_count,
                "is_understory": c.is_understory, "diameter_m": c.diameter_m},
            "geometry": {"type": "Polygon", "coordinates": [ring]},
        })
    };
    let all: Vec<_> = crowns.iter().map(feature).collect();
    let text = serde_json::json!({"type": "FeatureCollection", "features": all}).to_string();
    std::fs::write(path, text).unwrap();
}

#[test]
fn annotated_plots_reach_their_score() {
    let Some(folder) = data("idtrees/las") else { return };
    let boxes = data("idtrees/boxes.csv").unwrap();
    let mut truth: std::collections::BTreeMap<String, Vec<Box4>> = Default::default();
    for row in csv::Reader::from_path(boxes).unwrap().records() {
        let row = row.unwrap();
        let v = |k: usize| row[k].parse().unwrap();
        truth.entry(row[0].to_owned()).or_default().push([v(2), v(3), v(4), v(5)]);
    }
    // Matched, annotated, found: the broadleaf site, the pine site.
    let mut tally = [[0usize; 3]; 2];
    for (plot, boxes) in &truth {
        let (crowns, origin, _) = crowns_of(&folder.join(format!("{plot}.las")));
        let found: Vec<Box4> = crowns.iter().map(|c| world_box(c, origin)).collect();
        let site = &mut tally[usize::from(plot.starts_with("OSBS"))];
        site[0] += matches(boxes, &found);
        site[1] += boxes.len();
        site[2] += found.len();
        if let Some(out) = std::env::var_os("CROWNS_DIR") {
            write_geojson(&Path::new(&out).join(format!("{plot}.geojson")), &crowns, origin);
        }
    }
    let f1 = |t: [usize; 3]| 2.0 * t[0] as f64 / (t[1] + t[2]) as f64;
    let all = std::array::from_fn(|k| tally[0][k] + tally[1][k]);
    println!("F1 {:.3}: broadleaf {:.3}, pine {:.3}", f1(all), f1(tally[0]), f1(tally[1]));
    assert!(f1(all) >= 0.50, "F1 {:.3}", f1(all));
    assert!(f1(tally[0]) >= 0.53, "broadleaf F1 {:.3}", f1(tally[0]));
    assert!(f1(tally[1]) >= 0.43, "pine F1 {:.3}", f1(tally[1]));
}

#[test]
fn a_tree_scanned_from_the_ground_is_one_tree() {
    for name in ["treels/pine.laz", "adtree/tree1.xyz"] {
        let Some(path) = data(name) else { continue };
        let (crowns, _, warnings) = crowns_of(&path);
        for c in &crowns {
            println!(
                "  height {:.1} base {:.1} diameter {:.1} points {} attractors {} confidence {:.2}",
                c.height_m,
                c.base_height_m,
                c.diameter_m,
                c.point_count,
                c.attractors.len(),
                c.confidence
            );
        }
        println!("  {warnings:?}");
        assert_eq!(crowns.len(), 1, "{name}");
    }
}

#[test]
fn every_scan_gives_sane_crowns() {
    for name in [
        "lidR/MixedConifer.laz",
        "lidR/Megaplot.laz",
        "lidR/Topography.laz",
        "pycrown/POINTS_abs.laz",
        "spanner/ALS_Clip.laz",
        "lasR/bcts_1.laz",
    ] {
        let Some(path) = data(name) else { continue };
        let (crowns, _, warnings) = crowns_of(&path);
        let mean = |f: fn(&Crown) -> f32| crowns.iter().map(f).sum::<f32>() / crowns.len() as f32;
        println!(
            "  mean height {:.1} base {:.1} diameter {:.1} confidence {:.2}; {warnings:?}",
            mean(|c| c.height_m),
            mean(|c| c.base_height_m),
            mean(|c| c.diameter_m),
            mean(|c| c.confidence)
        );
        assert!(crowns.len() > 10, "{name}: {}", crowns.len());
    }
}
