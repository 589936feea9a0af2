//! What commands tell at their end: lines for people, a report for programs.

use std::path::Path;

use serde_json::{Value, json};

use super::args::{LevelArgs, SceneArgs};
use super::jobs::{formats, level, levels_job, profile};
use crate::diagnostic::{Error, Result};
use crate::export::{Format, OutputFile};
use crate::mesh::FoliageLevel;
use crate::pipeline::left_out::{self, Saved};
use crate::pipeline::level_table::Row;
use crate::pipeline::{Forest, TreeJob};
use crate::report::{self, Recorder};
use crate::scene::ValidScene;

/// What a command tells at its end.
pub(super) struct Told {
    pub lines: Vec<String>,
    pub json: Value,
}

/// To standard output; a reader that has seen enough and closed it is no error. Tells whether anyone still reads.
pub(super) fn print(lines: &[String]) -> Result<bool> {
    use std::io::{ErrorKind, Write};
    let mut out = std::io::stdout().lock();
    let written = lines.iter().try_for_each(|line| writeln!(out, "{}", line.trim_end()));
    match written.and_then(|()| out.flush()) {
        Ok(()) => Ok(true),
        Err(e) if e.kind() == ErrorKind::BrokenPipe => Ok(false),
        Err(e) => Err(Error::new(format!("standard output can't be written: {e}"))),
    }
}

/// Share of the triangles asked for of which it is worth a word that a tree takes no more.
const SPARE: f32 = 0.5;

/// That a tree takes far fewer triangles than were asked for, and what would take more.
pub(super) fn spare_line(most: u32, taken: u64, is_thin: bool, job: &TreeJob) -> Option<String> {
    let species = &job.species;
    let has_leaves = species.foliage.cover > 0.0 && job.state.leaf_share(species) > 0.0;
    let finest = FoliageLevel::Geometry.of(species);
    let finer = match job.foliage < finest && finest == FoliageLevel::Geometry && has_leaves {
        true => "--foliage geometry has every leaf and takes more",
        // It would take more, as a warning has said.
        false if is_thin => return None,
        false => "this is its finest form",
    };
    let is_spare = (taken as f32) < SPARE * most as f32;
    is_spare.then(|| format!("{most} triangles were allowed, it needs no more than these; {finer}"))
}

/// What was noted of a stage.
pub(super) fn notes(run: &Recorder, stage: &str) -> Vec<String> {
    run.stages.iter().filter(|s| s.stage == stage).flat_map(|s| s.notes.clone()).collect()
}

/// Triangles and silhouette error of each level: the mean triangles and the worst error of all
/// models.
pub(super) fn level_lines(rows: &[Row]) -> Vec<String> {
    let mut names: Vec<&str> = Vec::new();
    for r in rows {
        if !names.contains(&r.level.as_str()) {
            names.push(&r.level);
        }
    }
    if names.is_empty() {
        return Vec::new();
    }
    let head =
        format!("{:>10} {:>10} {:>22} {:>8}", "level", "triangles", "silhouette worst m", "RMS m");
    let line = |name: &&str| {
        let of = || rows.iter().filter(|r| r.level == *name);
        let count = of().count().max(1);
        let triangles = of().map(|r| r.triangles).sum::<usize>() / count;
        let worst = of().map(|r| r.silhouette_worst_m).fold(0.0, f32::max);
        let rms = of().map(|r| r.silhouette_rms_m).fold(0.0, f32::max);
        format!("{name:>10} {triangles:>10} {worst:>22.3} {rms:>8.3}")
    };
    [head].into_iter().chain(names.iter().map(line)).collect()
}

pub(super) fn fit_lines(fit: &crate::skeleton::cloud::Report) -> Vec<String> {
    use crate::skeleton::cloud::Led;
    let led = match fit.led_by {
        Led::Stem => {
            format!("stem seen, {:.1} cm thick at breast height", 100.0 * fit.stem_diameter_m)
        }
        Led::Foot => "no stem measured; branches lead to the foot of the cloud".into(),
        Led::Crown => "no stem seen; the species' own wood inside the crown".into(),
    };
    vec![
        format!(
            "{} points measured; left out: {} of ground and low growth, {} strays",
            fit.measured, fit.ground, fit.strays
        ),
        led,
        format!(
            "points to wood: mean {:.1} cm, 95 % within {:.1} cm; farther than {:.0} cm from every \
             point: {:.1} % of the wood's length, {:.1} % of its volume",
            100.0 * fit.mean_m,
            100.0 * fit.p95_m,
            100.0 * fit.outside_beyond_m,
            100.0 * fit.outside_length,
            100.0 * fit.outside_volume
        ),
    ]
}

pub(super) fn forest_lines(
    forest: &Forest,
    typed: &SceneArgs,
    run: &Recorder,
    dir: &Path,
) -> Vec<String> {
    let stats = crate::scene::statistics(&forest.scene);
    let mut lines: Vec<String> = report::table(&run.stages).lines().map(str::to_owned).collect();
    lines.extend(level_lines(&forest.rows));
    lines.extend(["mesh", "export"].iter().flat_map(|stage| notes(run, stage)));
    lines.extend(left_out::lines(&forest_left_out(forest, typed, run)));
    lines.push(format!(
        "{} trees of {} models, {} triangles in place, {} unique, {} of both the terrain's; {:.1} s, {} MB at most",
        stats.trees,
        stats.prototypes,
        stats.instanced_triangles,
        stats.unique_triangles,
        stats.terrain_triangles,
        run.seconds(),
        run.peak_bytes() / 1_000_000
    ));
    lines.push(format!("written to {}", dir.display()));
    lines
}

/// The report of a run. `schema` counts changes of this layout.
pub(super) fn summary(
    command: &str,
    seed: Option<u64>,
    run: &Recorder,
    scene: Option<&ValidScene>,
) -> Value {
    let mut v = json!({
        "schema": 1,
        "larix": env!("CARGO_PKG_VERSION"),
        "command": command,
        "seed": seed,
        "threads": rayon::current_num_threads(),
        "seconds": run.seconds(),
        "peak_bytes": run.peak_bytes(),
        "stages": run.stages,
        "warnings": run.warnings,
    });
    if let Some(scene) = scene {
        let s = crate::scene::statistics(scene);
        let (low, high) = s.bounds;
        let frame = scene.frame();
        v["scene"] = json!({
            "trees": s.trees,
            "models": s.prototypes,
            "unique_triangles": s.unique_triangles,
            "instanced_triangles": s.instanced_triangles,
            "geometry_bytes": s.geometry_bytes,
            "texture_bytes": s.texture_bytes,
            "bounds_m": [low.to_array(), high.to_array()],
            "origin": frame.origin.to_array(),
            "epsg": frame.crs.as_ref().and_then(|c| c.epsg),
        });
    }
    v
}

/// Whether each form is a file that holds its pictures.
pub(super) fn repeats_pictures(levels: &LevelArgs, formats: &[Format]) -> bool {
    formats.contains(&Format::Glb) && !profile(levels.profile).holds_all_forms()
}

fn forest_left_out(forest: &Forest, typed: &SceneArgs, run: &Recorder) -> Vec<Saved> {
    let formats = formats(&typed.format);
    left_out::table(&left_out::Told {
        scene: &forest.scene,
        levels: &levels_job(&typed.levels, &formats),
        foliage: level(typed.foliage),
        repeats_pictures: repeats_pictures(&typed.levels, &formats),
        has_forms: typed.camera.is_some(),
        pruned: forest.pruned,
        clipped: forest.clipped,
        chosen: forest.chosen.as_ref(),
        stages: &run.stages,
    })
}

pub(super) fn forest_summary(
    command: &str,
    seed: u64,
    forest: &Forest,
    scene: &SceneArgs,
    run: &Recorder,
) -> Value {
    let mut summary = summary(command, Some(seed), run, Some(&forest.scene));
    summary["levels"] = json!(forest.rows);
    summary["camera"] = json!(forest.chosen);
    summary["left_out"] = json!(forest_left_out(forest, scene, run));
    summary
}

pub(super) fn report_file(summary: &Value) -> OutputFile<'static> {
    OutputFile::new("report.json", format!("{summary:#}\n"))
}
