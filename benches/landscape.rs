//! The voxel landscape: bytes, seconds and rays a second.
//!
//! A simulated stand is laid side by side with its mirror images over 8096 × 8096 × 256 voxels.
//! `cargo bench --bench landscape -- [scene.voxels]` keeps that scene too.

use std::path::Path;
use std::time::Instant;

use larix::diagnostic::Result;
use larix::ground::Method;
use larix::heap;
use larix::landscape::{
    Detail, Landscape, Layers, Mirrored, Shot, Source, View, Weather, count_hits, draw, layers,
};
use larix::pipeline::landscape::{DETAIL, Voxelized, voxelize};
use larix::pipeline::{self, SurveyJob};
use larix::render::Camera;
use larix::report::{Recorder, Silent};
use larix::seed::Seed;
use larix::simulate::StandOptions;
use larix::species;
use larix::species::assign::SpeciesBy;

#[global_allocator]
static ALLOCATOR: heap::Counted = heap::Counted;

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
        scans: [scan].into(),
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

/// A tile over the whole of the scene.
fn tiled<S>(tile: &S, side: u32) -> Mirrored<'_, S> {
    Mirrored { tile, side, whole: WHOLE }
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

/// What is straight below over the first tile, at every half voxel: near enough that the surface of
/// half density is met.
fn below(scene: &Landscape, side: u32) -> Result<Layers> {
    const FROM_M: f32 = 500.0;
    let half = 0.5 * side as f32 * VOXEL_M;
    let low = scene.bounds_m()[0] + glam::Vec3::new(half, half, 0.0);
    let eye = low + FROM_M * glam::Vec3::Z;
    let camera = Camera { eye, target: low, fov_y_rad: 2.0 * (half / FROM_M).atan() };
    layers(scene, &Shot::new(camera, [2 * side; 2]))
}

/// How far, along rays from above, a vegetation's surface lies from another: the share of rays that
/// meet it within a millimetre of the other, and the RMS of those within a voxel's diagonal in metres;
/// the share beyond, where one has a gap.
fn apart(surface: &Layers, other: &Layers) -> [f64; 3] {
    let both =
        surface.class.iter().zip(&other.class).zip(surface.depth_m.iter().zip(&other.depth_m));
    let off: Vec<f64> = both
        .filter(|((a, b), _)| **a == 5 || **b == 5)
        .map(|(_, (a, b))| f64::from((a - b).abs()))
        .collect();
    let reach = 3f64.sqrt() * f64::from(VOXEL_M);
    let near: Vec<f64> = off.iter().copied().filter(|d| *d <= reach).collect();
    let share = |count: usize| count as f64 / off.len().max(1) as f64;
    let squares = near.iter().map(|d| d * d).sum::<f64>() / near.len().max(1) as f64;
    let same = off.iter().filter(|d| **d < 1e-3).count();
    [share(same), squares.sqrt(), share(off.len() - near.len())]
}

fn main() -> Result<()> {
    let dir = tempfile::tempdir().expect("a folder");
    let detail = Detail { height_stride: 8, colour_stride: 4, density_bits: 4 };
    // The densities that the others are measured against.
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
    let fine = {
        let alone = Mirrored { whole: [side, side, WHOLE[2]], ..tiled(&columns, side) };
        below(&Landscape::build(&alone, &detail, frame.clone(), columns.first_m, VOXEL_M)?.0, side)?
    };
    let mut kept = None;
    for bits in [1, 2, 4] {
        let detail = Detail { density_bits: bits, ..detail };
        let Voxelized { columns, .. } = tile(dir.path(), &detail)?;
        let whole = tiled(&columns, side);
        heap::forget_most();
        let start = Instant::now();
        let (scene, _) =
            Landscape::build(&whole, &detail, frame.clone(), columns.first_m, VOXEL_M)?;
        let seconds = start.elapsed().as_secs_f64();
        let peak = heap::most_bytes() as f64 / f64::from(1 << 20);
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
        let [same, rms, gaps] = apart(&below(&scene, side)?, &fine);
        println!(
            "     vegetation off that of 4 bits: {:.1} % the same, {rms:.3} m RMS, {:.1} % gaps",
            100.0 * same,
            100.0 * gaps
        );
        if bits != DETAIL.density_bits {
            continue;
        }
        if let Some(path) = std::env::args().skip(1).find(|a| a.ends_with(".voxels")) {
            std::fs::write(path, &file).expect("room for the scene");
        }
        kept = Some(scene);
    }
    let Some(scene) = kept else { return Ok(()) };
    let off = larix::landscape::surface_error(&scene, &tiled(&columns, side));
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
