//! Terrain of real scans and simulated stands against the truth, by every way of finding the
//! ground. Prints the table of docs/ground.md and writes it when `UPDATE_DOCS` is set; the default
//! must stay within the limits below. The reference of a real scan is the published terrain model
//! where there is one, else the triangulation of the file's own ground class at the centres of 1 m
//! cells inside its hull. No method but "file" sees that class.

use std::path::{Path, PathBuf};
use std::time::Instant;

use glam::{DVec3, Vec2, Vec3};
use larix::ground::{self, Method};
use larix::pipeline::survey::READ;
use larix::raster::geotiff;
use larix::scan::{self, PointCloud};
use larix::seed::Seed;
use larix::simulate::{self, Landform, ScannerOptions, StandOptions};
use larix::species::{self, Species};
use larix::terrain::{self, Terrain, TerrainOptions};
use spade::{DelaunayTriangulation, FloatTriangulation, HasPosition, Point2, Triangulation};

/// A scan and the heights that its terrain should have.
struct Scene {
    name: &'static str,
    cloud: PointCloud,
    /// Local places; empty where nobody knows.
    truth: Vec<Vec3>,
    /// Greatest RMSE of the default method, metres.
    limit_m: f64,
}

fn real(
    name: &'static str,
    limit_m: f64,
    truth: impl Fn(&PointCloud) -> Vec<Vec3>,
) -> Option<Scene> {
    let scan = scan::read(&[data(name)?], &READ).unwrap().value;
    let name = name.split('/').next_back()?;
    Some(Scene { name, truth: truth(&scan.cloud), cloud: scan.cloud, limit_m })
}

/// Scans of `../shared/data` that are there. The reference is the published terrain model where
/// there is one, else the triangulation of the file's own ground class.
fn real_scenes() -> Vec<Scene> {
    let model = |cloud: &PointCloud| {
        data("pycrown/DTM.tif").map_or_else(Vec::new, |path| modelled(&path, cloud))
    };
    [
        real("pycrown/POINTS_abs.laz", 0.50, model),
        real("lidR/Topography.laz", 0.22, triangulated),
        real("spanner/ALS_Clip.laz", 0.05, triangulated),
        real("lasR/bcts_1.laz", f64::INFINITY, |_| Vec::new()),
    ]
    .into_iter()
    .flatten()
    .collect()
}

/// Stands of 150 conifers and broadleaves. Ground returns carry class 2; only every nth is kept.
fn simulated(
    name: &'static str,
    limit_m: f64,
    planting: StandOptions,
    flight: ScannerOptions,
    nth_ground: u64,
) -> Scene {
    let species: Vec<Species> = ["picea_obovata", "pinus_sylvestris", "betula_pendula"]
        .map(|n| species::load(n).unwrap())
        .into();
    let seed = Seed::new(7);
    let stand = simulate::stand(&species, &StandOptions { trees: 150, ..planting }, seed).unwrap();
    let flight = ScannerOptions { has_classes: true, ..flight };
    let full = simulate::scan(&stand, &flight, seed);
    let kept: Vec<usize> = (0..full.len())
        .filter(|&i| {
            full.class[i] != 2
                || seed.derive("thin", i as u64).draws().unit() * nth_ground as f32 <= 1.0
        })
        .collect();
    fn pick<T: Copy>(column: &[T], kept: &[usize]) -> Vec<T> {
        kept.iter().map(|&i| column[i]).collect()
    }
    let cloud = PointCloud {
        frame: full.frame.clone(),
        position: pick(&full.position, &kept),
        intensity: pick(&full.intensity, &kept),
        return_number: pick(&full.return_number, &kept),
        return_count: pick(&full.return_count, &kept),
        class: pick(&full.class, &kept),
        rgb: None,
    };
    let side = stand.side_m as usize;
    let truth = (0..side * side)
        .map(|i| [(i % side) as f64 + 0.5, (i / side) as f64 + 0.5])
        .map(|[x, y]| DVec3::new(x, y, stand.relief.height_at(x, y)).as_vec3())
        .collect();
    Scene { name, cloud, truth, limit_m }
}

fn simulated_scenes() -> Vec<Scene> {
    let landform = |landform| StandOptions { landform, ..StandOptions::default() };
    let flight = ScannerOptions::default;
    let (hills, level) = (landform(Landform::Hills), landform(Landform::Level));
    let dense = StandOptions { cover: 0.8, ..hills.clone() };
    let sparse = ScannerOptions { pulses_per_m2: 1.0, ..flight() };
    let strays = ScannerOptions { strays_per_million: 1000.0, ..flight() };
    vec![
        simulated("level", 0.03, level, flight(), 1),
        simulated("hills", 0.03, hills.clone(), flight(), 1),
        simulated("slope of 45°", 0.05, landform(Landform::Slope(45.0)), flight(), 1),
        simulated("cliffs of 12 m", 3.0, landform(Landform::Cliffs(12.0)), flight(), 1),
        simulated("dense canopy, 1 ground hit in 30", 0.10, dense, flight(), 30),
        simulated("1 pulse/m²", 0.05, hills.clone(), sparse, 1),
        simulated("500 strays per million below the ground", 0.10, hills, strays, 1),
    ]
}

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

/// Seconds of CPU that this process has used; of the clock where the system does not tell.
fn cpu_seconds() -> f64 {
    let ticks = std::fs::read_to_string("/proc/self/stat").ok().and_then(|s| {
        let fields: Vec<&str> = s.rsplit(')').next()?.split_whitespace().collect();
        Some(fields.get(11)?.parse::<f64>().ok()? + fields.get(12)?.parse::<f64>().ok()?)
    });
    static START: std::sync::OnceLock<Instant> = std::sync::OnceLock::new();
    let clock = START.get_or_init(Instant::now).elapsed().as_secs_f64();
    ticks.map_or(clock, |t| t / 100.0)
}

const METHODS: [(&str, Method); 4] = [
    ("smrf", Method::Smrf),
    ("tin", Method::Tin),
    ("voxel", Method::VoxelRules),
    ("file", Method::FileClasses),
];

/// A line of the table for each method, without the last cell: seconds.
fn lines(scene: &Scene) -> Vec<(String, f64)> {
    let blind = reclassed(&scene.cloud, |c| if c == 2 { 1 } else { c });
    let mut out = Vec::new();
    for (name, method) in METHODS {
        let cloud = if method == Method::FileClasses { &scene.cloud } else { &blind };
        let start = cpu_seconds();
        let classified = ground::classify(cloud.clone(), method).unwrap().value;
        let found = cpu_seconds();
        let terrain = terrain::build(&classified, &TerrainOptions::default()).unwrap().value;
        let held_out =
            terrain::held_out_error(&classified, &TerrainOptions::default()).unwrap().unwrap();
        let [rmse, mean, worst] = errors(&terrain, &scene.truth);
        let known = match scene.truth.is_empty() {
            true => "– | – | –".to_owned(),
            false => format!("{rmse:.3} | {mean:+.3} | {worst:.2}"),
        };
        let line = format!(
            "| {} | {name} | {known} | {:.3} | {:.2} |",
            scene.name, held_out.rmse_m, held_out.max_m
        );
        out.push((line, found - start));
        if method == Method::Smrf && !scene.truth.is_empty() {
            assert!(rmse <= scene.limit_m, "{}: {rmse:.3} m", scene.name);
        }
    }
    out
}

const DOCS: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/docs/ground.md");
const TABLE_HEAD: &str = "| scan | ground by | RMSE m | bias m | worst m | held-out RMSE m | \
                          held-out worst m | CPU s |\n|---|---|---|---|---|---|---|---|\n";

#[test]
fn terrain_keeps_to_the_truth_and_the_table_stands_on_its_page() {
    let mut table = TABLE_HEAD.to_owned();
    let mut measured = Vec::new();
    for scene in real_scenes().into_iter().chain(simulated_scenes()) {
        for (line, seconds) in lines(&scene) {
            println!("{line} {seconds:.2} |");
            table += &format!("{line} {seconds:.2} |\n");
            measured.push(line);
        }
    }
    let page = std::fs::read_to_string(DOCS).unwrap();
    if std::env::var_os("UPDATE_DOCS").is_some() {
        let (before, rest) = page.split_once(TABLE_HEAD).unwrap();
        let rows: usize =
            rest.lines().take_while(|l| l.starts_with('|')).map(|l| l.len() + 1).sum();
        let after = &rest[rows..];
        std::fs::write(DOCS, format!("{before}{table}{after}")).unwrap();
        return;
    }
    for line in measured {
        assert!(page.contains(&line), "set UPDATE_DOCS to write the page anew: {line}");
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
        let scan = scan::read(&[path], &READ).unwrap().value;
        let found = ground::classify(scan.cloud, Method::Smrf).unwrap();
        assert_eq!(found.value.is_normalised, is_normalised, "{name}");
        assert_eq!(found.warnings.len(), usize::from(is_normalised), "{name}");
    }
}

/// Every height of the grid lies within the stated error of the triangles, and the table of
/// triangles against error only rises.
#[test]
fn meshes_of_real_terrain_keep_their_error() {
    for name in ["pycrown/POINTS_abs.laz", "lidR/Topography.laz", "lasR/bcts_1.laz"] {
        let Some(path) = data(name) else { continue };
        let scan = scan::read(&[path], &READ).unwrap().value;
        let classified = ground::classify(scan.cloud, Method::Smrf).unwrap().value;
        let options = TerrainOptions { cell_m: Some(1.0), ..TerrainOptions::default() };
        let terrain = terrain::build(&classified, &options).unwrap().value;
        for error_m in [0.5f32, 0.1] {
            let facets = terrain.facets(error_m, usize::MAX);
            let g = &terrain.heights.geometry;
            let worst = (0..g.len())
                .map(|i| {
                    let [x, y] = g.centre(i % g.cols, i / g.cols);
                    (facets.height_at(Vec2::new(x as f32, y as f32)) - terrain.heights.data[i])
                        .abs()
                })
                .fold(0.0, f32::max);
            println!(
                "{name}: {} triangles within {error_m} m, worst {worst:.4}",
                facets.triangles()
            );
            // f32 heights of hundreds of metres.
            assert!(worst <= error_m + 1e-3, "{name}: {worst} above {error_m}");
            assert!(facets.worst_m <= error_m);
            assert!(
                facets.ladder.is_sorted_by(|a, b| a.0 > b.0 && a.1 <= b.1),
                "{:?}",
                facets.ladder
            );
        }
    }
}
