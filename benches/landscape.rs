//! The voxel landscape: bytes, seconds and rays a second.
//!
//! A simulated stand is laid side by side with its mirror images over 8096 × 8096 × 256 voxels.
//! `cargo bench --bench landscape -- [scene.voxels]` keeps that scene too. Rays are told by core: the
//! figure of one thread, and of all over their number.

use std::path::Path;
use std::time::Instant;

use larix::diagnostic::Result;
use larix::ground::Method;
use larix::landscape::{
    Detail, Landscape, Mirrored, Shot, Source, View, Weather, count_hits, draw,
};
use larix::pipeline::landscape::{DETAIL, Voxelized, voxelize};
use larix::pipeline::{self, SurveyJob};
use larix::report::{Recorder, Silent};
use larix::seed::Seed;
use larix::simulate::StandOptions;
use larix::species;
use larix::species::assign::SpeciesBy;

#[global_allocator]
static ALLOCATOR: peak_alloc::PeakAlloc = peak_alloc::PeakAlloc;

const WHOLE: [u32; 3] = [8096, 8096, 256];
const VOXEL_M: f32 = 0.25;
const PICTURE: [u32; 2] = [1280, 720];

fn tile(dir: &Path, detail: &Detail) -> Result<Voxelized> {
    let names = ["larix_sibirica", "betula_pendula", "pinus_sylvestris", "picea_obovata"];
    let species = names.iter().map(|n| species::load(n)).collect::<Result<Vec<_>>>()?;
    let options = StandOptions { trees: 640, ..StandOptions::default() };
    let mut run = Recorder::new(&Silent);
    let made = pipeline::demo::survey_of_stand(&options, &species, Seed::new(1), &mut run)?;
    let (scan, photo) = (dir.join("stand.laz"), dir.join("stand.tif"));
    std::fs::write(&scan, &made.scan).expect("room for the scan");
    std::fs::write(&photo, &made.photo).expect("room for the photo");
    let job = SurveyJob {
        scans: vec![scan],
        ground: Method::Smrf,
        cell_m: None,
        tile_m: None,
        photo: Some(photo),
        species: Vec::new(),
        species_by: SpeciesBy::Auto,
        voxel_m: Some(VOXEL_M),
        min_height_m: 2.0,
        effort: pipeline::Effort::Normal,
        seed: Seed::new(1),
    };
    voxelize(&job, detail, &mut run)
}

fn on<T: Send>(threads: usize, work: impl FnOnce() -> T + Send) -> T {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
    pool.install(work)
}

/// The least seconds of three runs.
fn least(mut work: impl FnMut()) -> f64 {
    let run = |_| {
        let start = Instant::now();
        work();
        start.elapsed().as_secs_f64()
    };
    (0..3).map(run).fold(f64::INFINITY, f64::min)
}

fn main() -> Result<()> {
    let dir = tempfile::tempdir().expect("a folder");
    let detail = Detail { height_stride: 8, colour_stride: 4, ..DETAIL };
    let Voxelized { columns, frame, detail, .. } = tile(dir.path(), &detail)?;
    let [cols, rows, high] = columns.voxels();
    let side = 1 << cols.min(rows).ilog2();
    println!(
        "tile of {side} × {side} × {high} voxels of {VOXEL_M} m, {} with vegetation",
        columns.len()
    );
    println!(
        "{:>4} {:>9} {:>9} {:>9} {:>9} {:>9} {:>8} {:>9}",
        "bits", "voxels MB", "heights", "colours", "all MB", "file MB", "seconds", "peak MB"
    );
    let whole = Mirrored { tile: &columns, side, whole: WHOLE };
    let mut kept = None;
    for bits in [1, 2] {
        ALLOCATOR.reset_peak_usage();
        let start = Instant::now();
        let detail = Detail { density_bits: bits, ..detail };
        let (scene, _) =
            Landscape::build(&whole, &detail, frame.clone(), columns.first_m, VOXEL_M)?;
        let seconds = start.elapsed().as_secs_f64();
        let peak = ALLOCATOR.peak_usage_as_mb();
        let mut file = Vec::new();
        scene.write(&mut file).expect("memory for the file");
        let m = scene.memory();
        let mb = |bytes: usize| bytes as f64 / 1e6;
        println!(
            "{bits:>4} {:>9.2} {:>9.2} {:>9.2} {:>9.2} {:>9.2} {seconds:>8.1} {peak:>9.0}",
            mb(m.voxels),
            mb(m.heights),
            mb(m.colours),
            mb(m.total()),
            mb(file.len())
        );
        if let Some(path) = std::env::args().skip(1).find(|a| a.ends_with(".voxels")) {
            std::fs::write(path, &file).expect("room for the scene");
        }
        kept = Some(scene);
    }
    let Some(scene) = kept else { return Ok(()) };
    let off = larix::landscape::surface_error(&scene, &whole);
    println!(
        "ground off its terrain: {:.3} m RMS, {:.3} m worst",
        off.ground_rms_m, off.ground_worst_m
    );
    println!("{:>8} {:>16} {:>16}", "view", "1 thread M/s", "2 threads M/s");
    let pixels = f64::from(PICTURE[0]) * f64::from(PICTURE[1]) / 1e6;
    for (name, view) in View::ALL {
        let shot = Shot::new(scene.camera(view, 16.0 / 9.0), PICTURE);
        let rate = |threads| {
            on(threads, || {
                pixels
                    / least(|| {
                        std::hint::black_box(count_hits(&scene, &shot));
                    })
            })
        };
        println!("{name:>8} {:>16.2} {:>16.2}", rate(1), rate(2));
    }
    println!("{:>8} {:>8} {:>14} {:>8}", "view", "weather", "M rays/s lit", "cost");
    for (name, view) in View::ALL {
        let mut plain = 0.0;
        let kinds = [
            ("none", Weather::default()),
            ("snow", Weather { snow_m: 0.2, ..Weather::default() }),
            ("fog", Weather { fog_m: 1500.0, ..Weather::default() }),
            ("rain", Weather { rain_mm: 8.0, ..Weather::default() }),
        ];
        for (weather_name, weather) in kinds {
            let shot =
                Shot { effort: 1, weather, ..Shot::new(scene.camera(view, 16.0 / 9.0), PICTURE) };
            let seconds = least(|| {
                std::hint::black_box(draw(&scene, &shot, |_, _| Ok(true)).expect("a picture"));
            });
            if weather_name == "none" {
                plain = seconds;
            }
            println!(
                "{name:>8} {weather_name:>8} {:>14.2} {:>7.0}%",
                pixels / seconds,
                100.0 * (seconds / plain - 1.0)
            );
        }
    }
    Ok(())
}
