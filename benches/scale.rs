//! Scan to trees at three sizes: seconds beside those of unpacking the LAZ alone, and memory.
//!
//! A simulated stand is laid side by side. `cargo bench --bench scale -- [millions of points…]`;
//! 1 5 20 where absent. Each figure is the least of three runs.

use std::io::{Cursor, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::time::Instant;

use larix::ground::Method;
use larix::pipeline::{self, SurveyJob};
use larix::report::{Recorder, Silent};
use larix::scan::{PointCloud, ReadOptions, encode_laz, read};
use larix::seed::Seed;
use larix::simulate::StandOptions;
use larix::species::assign::SpeciesBy;
use larix::species::{self, Species};

/// Counts the heap, for the peak of each stage.
#[global_allocator]
static ALLOCATOR: larix::heap::Counted = larix::heap::Counted;

fn species() -> Vec<Species> {
    let names = ["larix_sibirica", "betula_pendula", "pinus_sylvestris", "picea_obovata"];
    names.iter().map(|n| species::load(n).expect("built in")).collect()
}

/// A stand of about 0.6 million points, and its side in metres.
fn stand(dir: &Path) -> (PointCloud, f32) {
    let options = StandOptions { trees: 500, relief_m: 0.0, ..StandOptions::default() };
    let mut run = Recorder::new(&Silent);
    let made = pipeline::demo::survey_of_stand(&options, &species(), Seed::new(1), &mut run)
        .expect("a stand");
    let path = dir.join("stand.laz");
    std::fs::write(&path, &made.scan).expect("room for the scan");
    let options = ReadOptions::default();
    (read(&[path], &options).expect("own scan").value.cloud, made.stand.side_m as f32)
}

/// The stand side by side until there are so many points.
fn scan_of(points: usize, stand: &PointCloud, side_m: f32, dir: &Path) -> PathBuf {
    let copies = points.div_ceil(stand.len());
    let across = (copies as f64).sqrt().ceil() as usize;
    let mut cloud = stand.clone();
    let shifted = |k: usize| {
        let shift = glam::Vec3::new((k % across) as f32, (k / across) as f32, 0.0) * side_m;
        stand.position.iter().map(move |p| *p + shift)
    };
    for k in 1..copies {
        cloud.position.extend(shifted(k));
        cloud.intensity.extend_from_slice(&stand.intensity);
        cloud.return_number.extend_from_slice(&stand.return_number);
        cloud.return_count.extend_from_slice(&stand.return_count);
        cloud.class.extend_from_slice(&stand.class);
    }
    let path = dir.join(format!("{points}.laz"));
    std::fs::write(&path, encode_laz(&cloud).expect("a sound cloud")).expect("room for the scan");
    path
}

/// Unpacks every point on all cores and keeps none; their number.
fn unpack(path: &Path) -> usize {
    let mut file = Cursor::new(std::fs::read(path).expect("own scan"));
    let header = las::raw::Header::read_from(&mut file).expect("own scan");
    let at = u64::from(header.header_size);
    file.seek(SeekFrom::Start(at)).expect("own scan");
    let mut laz_record = None;
    for _ in 0..header.number_of_variable_length_records {
        let mut head = [0; 54];
        file.read_exact(&mut head).expect("own scan");
        let mut data = vec![0; usize::from(u16::from_le_bytes([head[20], head[21]]))];
        file.read_exact(&mut data).expect("own scan");
        if u16::from_le_bytes([head[18], head[19]]) == 22204 {
            laz_record = Some(laz::LazVlr::from_buffer(&data).expect("own scan"));
        }
    }
    file.seek(SeekFrom::Start(u64::from(header.offset_to_point_data))).expect("own scan");
    let count = header.number_of_point_records as usize;
    let size = usize::from(header.point_data_record_length);
    let vlr = laz_record.expect("own scan");
    let mut unpacker = laz::ParLasZipDecompressor::new(file, vlr).expect("own scan");
    let mut slab = vec![0; size * (1 << 20)];
    let mut left = count;
    while left > 0 {
        let n = left.min(1 << 20);
        unpacker.decompress_many(&mut slab[..n * size]).expect("own scan");
        left -= n;
    }
    count
}

fn least_seconds(mut work: impl FnMut()) -> f64 {
    let mut least = f64::INFINITY;
    for _ in 0..3 {
        let start = Instant::now();
        work();
        least = least.min(start.elapsed().as_secs_f64());
    }
    least
}

fn main() {
    let sizes: Vec<usize> = std::env::args()
        .filter_map(|a| a.parse::<f64>().ok())
        .map(|millions| (millions * 1e6) as usize)
        .collect();
    let sizes = if sizes.is_empty() { vec![1_000_000, 5_000_000, 20_000_000] } else { sizes };
    let dir = tempfile::tempdir().expect("a temporary folder");
    let (stand, side_m) = stand(dir.path());
    println!("  M points   unpack s   trees s   ratio   trees   peak bytes a point");
    for points in sizes {
        let path = scan_of(points, &stand, side_m, dir.path());
        let mut count = 0;
        let unpacking = least_seconds(|| count = unpack(&path));
        let job = SurveyJob {
            scans: [path].into(),
            ground: Method::Smrf,
            cell_m: None,
            tile_m: None,
            photo: None,
            species: species(),
            species_by: SpeciesBy::Auto,
            voxel_m: None,
            min_height_m: 2.0,
            effort: pipeline::Effort::Normal,
            seed: Seed::new(1),
        };
        let (mut trees, mut peak, mut table) = (0, 0, String::new());
        let all = least_seconds(|| {
            let mut run = Recorder::new(&Silent);
            let survey = pipeline::survey::inventory(&job, &mut run).expect("trees");
            trees = survey.trees.len();
            peak = run.peak_bytes();
            table = larix::report::table(&run.stages);
        });
        println!(
            "{:10.1} {unpacking:10.2} {all:9.2} {:7.1} {trees:7} {:8.0}",
            count as f64 * 1e-6,
            all / unpacking,
            peak as f64 / count as f64
        );
        println!("{table}");
    }
}
