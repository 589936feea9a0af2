//! Whole runs: error of terrain and crowns against seconds, over effort, sharing and triangles; and
//! the front that `larix forest --error` and `--time` choose on.

use std::path::Path;
use std::time::Instant;

use super::super::goal::{self, BuildRate, Reference, SurveyRate};
use super::super::{Effort, ForestJob, forest, paint, survey};
use super::place::Place;
use super::{Bench, ReportJob};
use crate::cache::Cache;
use crate::diagnostic::Result;
use crate::export::{self, Format, Job, Staged};
use crate::report::document::{Front, Point, Quantity, Timing, Truth};
use crate::report::{Outcome, Recorder, Silent};

/// Models a species (0: each tree for itself) and triangles of each.
const BUILDS: [(usize, usize); 11] = [
    (2, 500),
    (2, 5_000),
    (5, 500),
    (5, 1_500),
    (5, 5_000),
    (5, 15_000),
    (20, 5_000),
    (0, 500),
    (0, 1_500),
    (0, 5_000),
    (0, 15_000),
];
/// What goals choose among besides: too long for a report.
const FINER_BUILDS: [(usize, usize); 11] = [
    (2, 1_500),
    (5, 25_000),
    (5, 40_000),
    (5, 60_000),
    (20, 1_500),
    (20, 15_000),
    (20, 40_000),
    (0, 8_000),
    (0, 25_000),
    (0, 40_000),
    (0, 60_000),
];
const QUICK_BUILDS: [(usize, usize); 4] = [(2, 500), (5, 1_500), (5, 5_000), (0, 1_500)];
/// Small, that drawing them does not hide what the settings cost.
const TEXTURE_PX: u32 = 128;
const DEFAULT: (usize, usize) = (5, 5_000);

/// A build and the seconds of its runs.
struct Built {
    rate: BuildRate,
    time: Timing,
}

pub(super) fn front(bench: &mut Bench<'_>) -> Result<Front> {
    let bench = &*bench;
    let builds: &[(usize, usize)] = match bench.job.is_quick {
        _ if bench.place.survey.trees.is_empty() => &[],
        true => &QUICK_BUILDS,
        false => &BUILDS,
    };
    let mut job = bench.place.forest_job(bench.job);
    job.texture_px = TEXTURE_PX;
    let runs = if bench.job.is_quick { 1 } else { 2 };
    let built = built(&bench.place, &job, builds, &bench.job.scratch, runs)?;
    let points = built.into_iter().map(|b| Point {
        group: match b.rate.models_a_species {
            0 => "each for itself".into(),
            n => format!("{n} a species"),
        },
        setting: b.rate.text(),
        error: b.rate.crown_error_m,
        cost: None,
        time: b.time,
        is_default: (b.rate.models_a_species, b.rate.triangles) == DEFAULT,
        is_on_front: false,
    });
    let front = Front {
        id: "whole".into(),
        stage: "forest".into(),
        title: "Trees to files: sharing and triangles".into(),
        error: Quantity::new("points to wood in place, mean", "m"),
        truth: Truth::Cloud,
        cost: None,
        note: "From the trees found to GLB and USDA on the disk, with textures of 128 pixels. The error is that of every tree as it \
               stands in the scene: where trees share a model, its branches are not their own. `larix \
               forest --error` and `--time` choose on such a front."
            .into(),
        is_by_group: false,
        points: points.collect(),
        verdict: String::new(),
    };
    Ok(front.marked())
}

/// The front of the reference stand, on this machine.
///
/// # Errors
/// A scratch folder that can't be written to.
pub fn reference(job: &ReportJob) -> Result<Reference> {
    const RUNS: usize = 3;
    let job = ReportJob { scans: Vec::new(), photo: None, is_quick: false, ..job.clone() };
    let place = Place::simulated(&job, &mut Vec::new())?;
    let mut usual = place.forest_job(&job);
    usual.cache = Cache::in_folder(&job.scratch.join("cache"));
    let points = place.cloud.len();
    let mut surveys = Vec::new();
    for (name, effort) in Effort::ALL {
        let mut survey_job = usual.survey.clone();
        survey_job.effort = effort;
        let (mut seconds, mut error) = (Vec::new(), 0.0);
        for _ in 0..RUNS {
            let mut run = Recorder::new(&Silent);
            let found = survey::inventory(&survey_job, &mut run)?;
            seconds.push(run.seconds());
            let truth = place.truth_of(&found.terrain, &found.frame, &[]);
            error = truth.map_or(0.0, |t| t.terrain.rmse_m);
        }
        surveys.push(SurveyRate {
            effort: name.into(),
            terrain_error_m: error,
            seconds_per_million_points: Timing::of(&seconds).least_s / (points as f64 * 1e-6),
        });
    }
    let all = [&BUILDS[..], &FINER_BUILDS].concat();
    let builds = built(&place, &usual, &all, &job.scratch, RUNS)?;
    Ok(Reference {
        larix: env!("CARGO_PKG_VERSION").into(),
        machine: super::machine(),
        trees: place.survey.trees.len(),
        points,
        unit_s: goal::calibrate()?,
        surveys,
        builds: builds.into_iter().map(|b| b.rate).collect(),
    })
}

fn built(
    place: &Place,
    usual: &ForestJob,
    builds: &[(usize, usize)],
    scratch: &Path,
    runs: usize,
) -> Result<Vec<Built>> {
    let one = |&(models_a_species, triangles): &(usize, usize)| {
        let mut rate = BuildRate {
            models_a_species,
            triangles,
            crown_error_m: 0.0,
            seconds_fixed: 0.0,
            seconds_per_model: 0.0,
            bytes_per_model: 0.0,
        };
        let job =
            ForestJob { sharing: rate.sharing(), triangles, tells_fit: true, ..usual.clone() };
        let (mut all, mut fixed, mut models) = (Vec::new(), Vec::new(), 1);
        for _ in 0..runs {
            let survey = place.survey.clone();
            let start = Instant::now();
            let mut run = Recorder::new(&Silent);
            let forest = forest::raise(&job, survey, &mut run)?;
            run.stage("preview", |_| {
                let picture = forest::preview(&forest.scene, [1280, 720]).to_png()?;
                Ok::<_, crate::diagnostic::Error>((picture, Outcome::default()))
            })?;
            let bytes = write(&forest.scene, scratch, &job.cache)?;
            all.push(start.elapsed().as_secs_f64());
            let seconds = |stage: &str| -> f64 {
                run.stages.iter().filter(|s| s.stage == stage).map(|s| s.seconds).sum()
            };
            fixed.push(seconds("texture") + seconds("preview"));
            models = forest.scene.prototypes().len().max(1);
            rate.bytes_per_model = bytes as f64 / models as f64;
            rate.crown_error_m = forest.crown_error_m.unwrap_or(0.0);
        }
        let time = Timing::of(&all);
        // The least is what the machine takes when nothing else runs on it.
        rate.seconds_fixed = Timing::of(&fixed).least_s;
        rate.seconds_per_model = (time.least_s - rate.seconds_fixed).max(0.0) / models as f64;
        Ok(Built { rate, time })
    };
    builds.iter().map(one).collect()
}

/// As a run without `--format` does; removed again.
pub(super) fn write(
    scene: &crate::scene::ValidScene,
    scratch: &Path,
    cache: &Cache,
) -> Result<u64> {
    let formats = [Format::Glb, Format::Usda];
    let job = Job::new("forest", &formats);
    let pictures = paint::coded(scene, &job.picture_formats(), cache)?;
    Staged::new(scratch)?.add(export::files(scene, &pictures, &job)?.value)
}
