//! The whole chain on a simulated stand: scan to trees, trees to scene, scene to bytes.
//!
//! `cargo bench --bench chain`

use std::io::Cursor;

use larix::export::{self, Format, Pictures, WindAs};
use larix::ground::Method;
use larix::pipeline::{self, ForestJob, SurveyJob};
use larix::report::{Recorder, Silent};
use larix::seed::Seed;
use larix::simulate::StandOptions;
use larix::species::assign::SpeciesBy;
use larix::species::{self, Species};

fn main() {
    divan::main();
}

/// The survey of 240 trees as a file, and the job that rebuilds them.
fn job() -> (tempfile::TempDir, ForestJob) {
    let names = ["larix_sibirica", "betula_pendula", "pinus_sylvestris", "picea_obovata"];
    let species: Vec<Species> = names.iter().map(|n| species::load(n).expect("built in")).collect();
    let seed = Seed::new(1);
    let mut run = Recorder::new(&Silent);
    let made = pipeline::demo::survey_of_stand(&StandOptions::default(), &species, seed, &mut run)
        .expect("a stand");
    let dir = tempfile::tempdir().expect("a temporary folder");
    let scan = dir.path().join("scan.laz");
    std::fs::write(&scan, made.scan).expect("room for the scan");
    let survey = SurveyJob {
        scans: [scan].into(),
        ground: Method::Smrf,
        cell_m: None,
        tile_m: None,
        photo: None,
        species,
        species_by: SpeciesBy::Auto,
        voxel_m: None,
        min_height_m: 2.0,
        effort: pipeline::Effort::Normal,
        seed,
    };
    (dir, ForestJob::new(survey))
}

#[divan::bench(sample_count = 10)]
fn inventory(bencher: divan::Bencher) {
    let (_dir, job) = job();
    bencher.bench(|| {
        pipeline::survey::inventory(&job.survey, &mut Recorder::new(&Silent)).expect("trees")
    });
}

#[divan::bench(sample_count = 5)]
fn forest(bencher: divan::Bencher) {
    let (_dir, job) = job();
    bencher.bench(|| pipeline::forest::forest(&job, &mut Recorder::new(&Silent)).expect("a scene"));
}

#[divan::bench(sample_count = 10, args = [Format::Glb, Format::Usda])]
fn export(bencher: divan::Bencher, format: Format) {
    let (_dir, job) = job();
    let forest = pipeline::forest::forest(&job, &mut Recorder::new(&Silent)).expect("a scene");
    let formats = [format];
    let job = export::Job { wind: WindAs::Color, ..export::Job::new("forest", &formats) };
    bencher.bench(|| {
        let pictures = Pictures::encode(&forest.scene, &job.picture_formats()).expect("pictures");
        let files = export::files(&forest.scene, &pictures, &job).expect("files");
        for file in files.value {
            file.content.write(Cursor::new(Vec::new())).expect("bytes");
        }
    });
}
