//! Terrain of real scans against their reference terrain, by every way of finding the ground.
//! Prints a table; the default must stay within the limits below. The reference is the published
//! terrain model where there is one, else the triangulation of the file's own ground class at the
//! centres of 1 m cells inside its hull. No method but "file" sees that class.

use std::path::{Path, PathBuf};
use std::time::Instant;

use glam::{DVec3, Vec2, Vec3};
use larix::ground::{self, GroundOptions, Method};
use larix::raster::geotiff;
use larix::scan::{self, PointCloud, ReadOptions};
use larix::terrain::{self, Terrain, TerrainOptions};
use spade::{DelaunayTriangulation, FloatTriangulation, HasPosition, Point2, Triangulation};

struct Site {
    scan: &'static str,
    /// Reference terrain; the scan's class 2 where `None`.
    model: Option<&'static str>,
    /// Greatest RMSE of the default method, metres.
    limit_m: f64,
}

const SITES: [Site; 3] = [
    Site { scan: "lidR/Topography.laz", model: None, limit_m: 0.22 },
    Site { scan: "pycrown/POINTS_abs.laz", model: Some("pycrown/DTM.tif"), limit_m: 0.50 },
    Site { scan: "spanner/ALS_Clip.laz", model: None, limit_m: 0.05 },
];

fn data(name: &str) -> Option<PathBuf> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data").join(name);
    if !path.exists() {
        println!("skipped: {name} is not here");
        return None;
    }
    Some(path)
}

struct Corner(Vec3);

impl HasPosition for Corner {
    type Scalar = f64;

    fn position(&self) -> Point2<f64> {
        Point2::new(f64::from(self.0.x), f64::from(self.0.y))
    }
}

/// Heights of the file's ground class at the centres of 1 m cells.
fn triangulated(cloud: &PointCloud) -> Vec<Vec3> {
    let ground: Vec<Vec3> = cloud
        .position
        .iter()
        .zip(&cloud.class)
        .filter(|(_, class)| **class == 2)
        .map(|(p, _)| *p)
        .collect();
    let low = ground.iter().copied().fold(Vec3::INFINITY, Vec3::min).floor();
    let high = ground.iter().copied().fold(Vec3::NEG_INFINITY, Vec3::max);
    let tin: DelaunayTriangulation<Corner> =
        DelaunayTriangulation::bulk_load(ground.into_iter().map(Corner).collect()).unwrap();
    let tin = tin.barycentric();
    let mut out = Vec::new();
    for row in 0..(high.y - low.y) as usize {
        for col in 0..(high.x - low.x) as usize {
            let at = low.truncate() + Vec2::new(col as f32 + 0.5, row as f32 + 0.5);
            let place = Point2::new(f64::from(at.x), f64::from(at.y));
            if let Some(z) = tin.interpolate(|v| f64::from(v.data().0.z), place) {
                out.push(at.extend(z as f32));
            }
        }
    }
    out
}

/// Cells of a terrain model, as local points.
fn modelled(path: &Path, cloud: &PointCloud) -> Vec<Vec3> {
    let model = geotiff::read(path).unwrap();
    let geometry = model.geometry.unwrap();
    let mut out = Vec::new();
    for row in 0..model.height {
        for col in 0..model.width {
            let z = f64::from(model.value(col, row, 0));
            if z.is_finite() && model.nodata != Some(z) {
                let [x, y] = geometry.centre(col, row);
                out.push(cloud.frame.local_from_world(DVec3::new(x, y, z)));
            }
        }
    }
    out
}

/// RMSE, mean and greatest error, metres.
fn errors(terrain: &Terrain, reference: &[Vec3]) -> [f64; 3] {
    let off: Vec<f64> = reference
        .iter()
        .map(|p| f64::from(terrain.height_at(p.truncate())) - f64::from(p.z))
        .collect();
    let n = off.len() as f64;
    [
        (off.iter().map(|e| e * e).sum::<f64>() / n).sqrt(),
        off.iter().sum::<f64>() / n,
        off.iter().fold(0.0, |a, e| a.max(e.abs())),
    ]
}

fn reclassed(cloud: &PointCloud, change: impl Fn(u8) -> u8) -> PointCloud {
    let mut out = cloud.clone();
    out.class.iter_mut().for_each(|c| *c = change(*c));
    out
}

#[test]
fn terrain_keeps_to_the_reference() {
    println!(
        "{:24} {:12} {:>8} {:>8} {:>8} {:>9} {:>7}",
        "scan", "ground by", "RMSE m", "mean m", "worst m", "held out", "s"
    );
    for site in SITES {
        let Some(path) = data(site.scan) else { continue };
        let scan = scan::read(&[path], &ReadOptions::default()).unwrap().value;
        let reference = match site.model {
            Some(model) => modelled(&data(model).unwrap(), &scan.cloud),
            None => triangulated(&scan.cloud),
        };
        let blind = reclassed(&scan.cloud, |c| if c == 2 { 1 } else { c });
        for method in [Method::Smrf, Method::VoxelRules, Method::FileClasses] {
            let cloud = if method == Method::FileClasses { &scan.cloud } else { &blind }.clone();
            let start = Instant::now();
            let classified = ground::classify(cloud, &GroundOptions { method }).unwrap().value;
            let terrain = terrain::build(&classified, &TerrainOptions::default()).unwrap().value;
            let seconds = start.elapsed().as_secs_f64();
            let held_out =
                terrain::held_out_error(&classified, &TerrainOptions::default()).unwrap().unwrap();
            let [rmse, mean, worst] = errors(&terrain, &reference);
            println!(
                "{:24} {:12} {rmse:8.3} {mean:+8.3} {worst:8.2} {:9.3} {seconds:7.2}",
                site.scan,
                format!("{method:?}"),
                held_out.rmse_m,
            );
            if method == Method::Smrf {
                assert!(rmse <= site.limit_m, "{}: {rmse:.3} m", site.scan);
            }
        }
    }
}

#[test]
fn normalised_scans_are_told_from_absolute_ones() {
    for (name, is_normalised) in [
        ("lidR/MixedConifer.laz", true),
        ("lidR/Megaplot.laz", true),
        ("lidR/Topography.laz", false),
        ("lasR/bcts_1.laz", false),
        ("spanner/ALS_Clip.laz", false),
        ("idtrees/las/MLBS_10.las", false),
        ("idtrees/las/OSBS_10.las", false),
    ] {
        let Some(path) = data(name) else { continue };
        let scan = scan::read(&[path], &ReadOptions::default()).unwrap().value;
        let found = ground::classify(scan.cloud, &GroundOptions::default()).unwrap();
        assert_eq!(found.value.is_normalised, is_normalised, "{name}");
        assert_eq!(found.warnings.len(), usize::from(is_normalised), "{name}");
    }
}
