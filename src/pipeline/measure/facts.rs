//! The whole run with the usual settings, in figures: what README.md and a reader in a hurry quote.

use super::super::{demo, forest};
use super::whole::write;
use super::{Bench, repeats};
use crate::diagnostic::Result;
use crate::report::document::{Fact, Quantity, Timing, Truth};
use crate::report::stats::spread;
use crate::report::{Outcome, Recorder, Silent};

/// Pixels of the picture that a run writes.
const PREVIEW_PX: [u32; 2] = [1280, 720];

pub(super) fn facts(bench: &mut Bench<'_>) -> Result<Vec<Fact>> {
    let bench = &*bench;
    let job = bench.place.forest_job(bench.job);
    let (mut seconds, mut peaks, mut held_out) = (Vec::new(), Vec::new(), None);
    while seconds.is_empty() || seconds.len() < repeats(bench.job.is_quick, seconds.iter().sum()) {
        let mut run = Recorder::new(&Silent);
        let forest = forest::forest(&job, &mut run)?;
        run.stage("preview", |_| {
            let picture = forest::preview(&forest.scene, PREVIEW_PX).to_png()?;
            Ok::<_, crate::diagnostic::Error>((picture.len(), Outcome::default()))
        })?;
        run.stage("export", |_| {
            Ok((write(&forest.scene, &bench.job.scratch, &job.cache)?, Outcome::default()))
        })?;
        held_out = run.stages.iter().find(|s| s.stage == "terrain").and_then(|s| s.error.clone());
        seconds.push(run.seconds());
        peaks.push(run.peak_bytes() as f64);
    }
    let time = Timing::of(&seconds);
    let peak = spread(&peaks).map_or(0.0, |s| s.most);
    let fact = |id: &str, name: &str, unit: &str, value: f64, truth: Truth| Fact {
        id: id.into(),
        of: Quantity::new(name, unit),
        value,
        truth,
    };
    let counted =
        |id: &str, name: &str, unit: &str, value| fact(id, name, unit, value, Truth::Counted);
    let mut facts = vec![
        counted("points", "points read", "", bench.place.cloud.len() as f64),
        counted(
            "runs",
            "whole runs, scan to GLB and USDA, textures drawn anew",
            "",
            time.runs as f64,
        ),
        counted("whole", "whole run, median", "s", time.median_s),
        counted("whole_least", "whole run, least", "s", time.least_s),
        counted("whole_most", "whole run, most", "s", time.most_s),
        counted("whole_peak", "most heap held", "MB", peak * 1e-6),
        counted("trees_found", "trees found", "", bench.place.survey.trees.len() as f64),
    ];
    if let Some(e) = held_out {
        facts.push(fact("terrain_held_out", "terrain RMSE", &e.unit, e.value, Truth::HeldOut));
    }
    if let Some(stand) = &bench.place.stand {
        let c = demo::compare(stand, &bench.place.survey, None);
        let known =
            |id: &str, name: &str, unit: &str, value| fact(id, name, unit, value, Truth::Simulated);
        facts.extend([
            known("trees_planted", "trees planted", "", c.trees as f64),
            known("trees_matched", "trees found where one stands", "", c.matched as f64),
            known("trees_invented", "trees invented", "", c.invented as f64),
            known("f1", "F1 of trees", "", c.f1),
            known("position", "position RMSE", "m", c.position_rmse_m),
            known("height", "height RMSE", "m", c.height.rmse_m),
            known("height_bias", "height, mean error", "m", c.height.bias_m),
            known("crown_diameter", "crown diameter RMSE", "m", c.crown_diameter.rmse_m),
            known("terrain", "terrain RMSE", "m", c.terrain.rmse_m),
            known("species", "species right, of the trees found", "%", 100.0 * c.species_accuracy),
        ]);
    }
    Ok(facts)
}
