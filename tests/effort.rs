//! What `--effort` buys: error against seconds on simulated stands and real scans. Prints the table
//! of docs/effort.md and writes it when `UPDATE_DOCS` is set. Seconds are not checked.

use std::path::{Path, PathBuf};

use glam::DVec3;
use larix::crown::{Crown, detect};
use larix::ground::{self, Method};
use larix::pipeline::{Effort, demo, survey};
use larix::raster::geotiff;
use larix::report::{Recorder, Silent};
use larix::scan;
use larix::seed::Seed;
use larix::simulate::StandOptions;
use larix::species;
use larix::terrain::{self, Terrain};
use larix::voxel;

fn data(name: &str) -> Option<PathBuf> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data").join(name);
    if !path.exists() {
        println!("skipped: {name} is not here");
        return None;
    }
    Some(path)
}

/// Seconds of CPU that this process has used; 0 where the system does not tell.
fn cpu_seconds() -> f64 {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let fields: Vec<&str> = stat.rsplit(')').next().unwrap_or("").split_whitespace().collect();
    let ticks = |i: usize| fields.get(i).and_then(|t| t.parse::<f64>().ok()).unwrap_or(0.0);
    (ticks(11) + ticks(12)) / 100.0
}

struct Found {
    frame: larix::frame::Frame,
    terrain: Terrain,
    crowns: Vec<Crown>,
    held_out_m: f64,
    seconds: f64,
}

/// Scan to crowns. Held-out errors do not count as time.
fn find(path: &Path, effort: Effort) -> Found {
    let start = cpu_seconds();
    let scan = scan::read(&[path.to_path_buf()], &survey::READ).unwrap().value;
    let size_m = voxel::choose_size_m(scan.density_per_m2, 4.0);
    let classified = ground::classify(scan.cloud, Method::Smrf).unwrap().value;
    let options = effort.terrain(None);
    let terrain = terrain::build(&classified, &options).unwrap().value;
    let crowns = detect(&classified, &terrain, size_m, &effort.crown(2.0)).unwrap().value;
    let seconds = cpu_seconds() - start;
    let held_out = terrain::held_out_error(&classified, &options).unwrap();
    Found {
        frame: classified.cloud.frame,
        terrain,
        crowns,
        held_out_m: held_out.map_or(0.0, |h| h.rmse_m),
        seconds,
    }
}

/// Stands of many species, with so many trees under others; RMSE of the terrain, F1, seconds.
fn simulated(effort: Effort, understory: usize, dir: &Path) -> [f64; 3] {
    let names =
        ["larix_sibirica", "betula_pendula", "pinus_sylvestris", "picea_obovata", "salix_caprea"];
    let species: Vec<_> = names.iter().map(|n| species::load(n).unwrap()).collect();
    let options = StandOptions { trees: 160, understory, ..StandOptions::default() };
    let mut sum = [0.0; 3];
    for seed in [1, 2] {
        let mut run = Recorder::new(&Silent);
        let made = demo::survey_of_stand(&options, &species, Seed::new(seed), &mut run).unwrap();
        let path = dir.join("scan.laz");
        std::fs::write(&path, &made.scan).unwrap();
        let found = find(&path, effort);
        let crowns = found.crowns.iter().map(|c| (c, ""));
        let c = demo::compare_crowns(&made.stand, &found.frame, &found.terrain, crowns);
        for (sum, v) in sum.iter_mut().zip([c.terrain.rmse_m, c.f1, found.seconds]) {
            *sum += 0.5 * v;
        }
    }
    sum
}

type Box4 = [f64; 4];

fn overlap(a: &Box4, b: &Box4) -> f64 {
    let area = |q: &Box4| (q[2] - q[0]) * (q[3] - q[1]);
    let w = (a[2].min(b[2]) - a[0].max(b[0])).max(0.0);
    let h = (a[3].min(b[3]) - a[1].max(b[1])).max(0.0);
    w * h / (area(a) + area(b) - w * h)
}

/// Pairs that overlap to 0.4 of their union, best first.
fn matches(truth: &[Box4], found: &[Box4]) -> usize {
    let mut pairs: Vec<(f64, usize, usize)> = Vec::new();
    for (i, t) in truth.iter().enumerate() {
        pairs.extend(found.iter().enumerate().map(|(j, f)| (overlap(t, f), i, j)));
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

/// The annotated plots: mean held-out RMSE, F1 of the trees that are not hidden from above, seconds.
fn plots(effort: Effort) -> Option<[f64; 3]> {
    let folder = data("idtrees/las")?;
    let mut truth: std::collections::BTreeMap<String, Vec<Box4>> = Default::default();
    for row in csv::Reader::from_path(data("idtrees/boxes.csv")?).unwrap().records() {
        let row = row.unwrap();
        let v = |k: usize| row[k].parse().unwrap();
        truth.entry(row[0].to_owned()).or_default().push([v(2), v(3), v(4), v(5)]);
    }
    let (mut matched, mut all, mut held_out, mut seconds) = (0, 0, 0.0, 0.0);
    for (plot, boxes) in &truth {
        let found = find(&folder.join(format!("{plot}.las")), effort);
        let boxed = |c: &Crown| {
            let low = c.outline.iter().copied().reduce(|a, b| a.min(b)).unwrap().as_dvec2();
            let high = c.outline.iter().copied().reduce(|a, b| a.max(b)).unwrap().as_dvec2();
            let o = found.frame.origin;
            [low.x + o.x, low.y + o.y, high.x + o.x, high.y + o.y]
        };
        let seen = found.crowns.iter().filter(|c| !c.is_understory);
        let there: Vec<Box4> = seen.map(boxed).collect();
        matched += matches(boxes, &there);
        all += boxes.len() + there.len();
        held_out += found.held_out_m / truth.len() as f64;
        seconds += found.seconds;
    }
    Some([held_out, 2.0 * matched as f64 / all as f64, seconds])
}

/// POINTS_abs: RMSE against the published terrain, seconds.
fn steep(effort: Effort) -> Option<[f64; 2]> {
    let model = geotiff::read(&data("pycrown/DTM.tif")?).unwrap();
    let found = find(&data("pycrown/POINTS_abs.laz")?, effort);
    let geometry = model.geometry.unwrap();
    let (mut sum, mut n) = (0.0f64, 0.0f64);
    for row in 0..model.height {
        for col in 0..model.width {
            let z = f64::from(model.value(col, row, 0));
            if z.is_finite() && model.nodata != Some(z) {
                let [x, y] = geometry.centre(col, row);
                let p = found.frame.local_from_world(DVec3::new(x, y, z));
                sum += f64::from(found.terrain.height_at(p.truncate()) - p.z).powi(2);
                n += 1.0;
            }
        }
    }
    Some([(sum / n).sqrt(), found.seconds])
}

const DOCS: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/docs/effort.md");
const HEAD: &str = "| effort | scans | terrain RMSE m | F1 | CPU s |\n|---|---|---|---|---|\n";

#[test]
fn effort_buys_what_its_page_says() {
    let dir = tempfile::tempdir().unwrap();
    let mut lines: Vec<(String, f64)> = Vec::new();
    for (name, effort) in Effort::ALL {
        let stands = [("simulated stands", 0, 0.85), ("the same over lower trees", 40, 0.75)];
        for (scans, understory, least) in stands {
            let [rmse, f1, s] = simulated(effort, understory, dir.path());
            assert!(rmse <= 0.04 && f1 >= least, "{name}, {scans}: {rmse:.3} m, F1 {f1:.3}");
            lines.push((format!("| {name} | {scans} | {rmse:.3} | {f1:.3} |"), s));
        }
        if let Some([held_out, f1, s]) = plots(effort) {
            assert!(f1 >= 0.50, "{name}: F1 {f1:.3}");
            lines.push((
                format!("| {name} | annotated plots | {held_out:.3} (held out) | {f1:.3} |"),
                s,
            ));
        }
        if let Some([rmse, s]) = steep(effort) {
            assert!(rmse <= 0.55, "{name}: {rmse:.3} m");
            lines.push((format!("| {name} | POINTS_abs | {rmse:.3} | – |"), s));
        }
    }
    let page = std::fs::read_to_string(DOCS).unwrap();
    let table: String = lines.iter().map(|(line, s)| format!("{line} {s:.2} |\n")).collect();
    println!("{HEAD}{table}");
    if std::env::var_os("UPDATE_DOCS").is_some() {
        let (before, rest) = page.split_once(HEAD).unwrap();
        let rows: usize =
            rest.lines().take_while(|l| l.starts_with('|')).map(|l| l.len() + 1).sum();
        std::fs::write(DOCS, format!("{before}{HEAD}{table}{}", &rest[rows..])).unwrap();
        return;
    }
    for (line, _) in lines {
        assert!(page.contains(&line), "set UPDATE_DOCS to write the page anew: {line}");
    }
}
