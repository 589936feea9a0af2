//! A forest within a stated error or time: settings are chosen on a front that a report measured
//! on the reference stand (`front.json`, written by `larix report --write-front`), and what was
//! reached is measured on the scan at hand.
//!
//! The error of a forest is the greater of two: that of its terrain, and the mean distance from the
//! points of its trees to the wood of the models that stand in their places. Seconds of the front
//! go with points (survey) and models (the rest); a calibration of a tenth of a second tells how fast
//! this machine is. Where the trees at hand are harder than those of the reference, the setting is
//! chosen once more with that known. Seconds are those of a run that finds its pictures in the
//! cache; where they are not there they are drawn before anything is chosen, so that their time is
//! known. Known limit: the seconds of the front are those of GLB and USDA.

use std::time::Instant;

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::cover::Subject;
use super::detail::mesh_options;
use super::forest::{Forest, raise};
use super::survey::{self, Survey};
use super::view;
use super::{Effort, ForestJob, Sharing};
use crate::diagnostic::{Error, Result};
use crate::report::document::Machine;
use crate::report::{Outcome, Recorder, significant};
use crate::scan;
use crate::seed::Seed;
use crate::skeleton::{self, Detail, Target};
use crate::{species, texture};

/// What a run is to reach.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Goal {
    /// Of terrain and crowns, metres.
    Error(f64),
    /// Of the whole run, seconds.
    Time(f64),
}

/// What settings reached on the reference stand, and what they cost.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Reference {
    pub larix: String,
    pub machine: Machine,
    pub trees: usize,
    pub points: usize,
    /// Seconds of [`calibrate`].
    pub unit_s: f64,
    pub surveys: Vec<SurveyRate>,
    pub builds: Vec<BuildRate>,
}

/// Scan to trees.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SurveyRate {
    pub effort: String,
    pub terrain_error_m: f64,
    pub seconds_per_million_points: f64,
}

/// Trees to files.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct BuildRate {
    /// 0: each tree for itself.
    pub models_a_species: usize,
    pub triangles: usize,
    pub crown_error_m: f64,
    /// Of the picture, whose pixels are as many whatever stands in it.
    pub seconds_fixed: f64,
    pub seconds_per_model: f64,
    /// Of GLB and USDA, pictures among them.
    pub bytes_per_model: f64,
}

impl BuildRate {
    pub fn sharing(&self) -> Sharing {
        match self.models_a_species {
            0 => Sharing::None,
            n => Sharing::PerSpecies(n),
        }
    }

    fn models(&self, trees: usize, species: usize) -> usize {
        match self.models_a_species {
            0 => trees,
            n => (n * species).min(trees),
        }
    }

    fn seconds(&self, trees: usize, species: usize) -> f64 {
        self.seconds_fixed + self.seconds_per_model * self.models(trees, species) as f64
    }

    fn bytes(&self, trees: usize, species: usize) -> f64 {
        self.bytes_per_model * self.models(trees, species) as f64
    }

    pub fn text(&self) -> String {
        match self.models_a_species {
            0 => format!("each tree for itself, {} triangles", self.triangles),
            n => format!("{n} models a species, {} triangles", self.triangles),
        }
    }
}

impl SurveyRate {
    fn effort(&self) -> Effort {
        let named = Effort::ALL.iter().find(|e| e.0 == self.effort);
        named.map_or(Effort::default(), |e| e.1)
    }

    fn seconds(&self, points: f64) -> f64 {
        self.seconds_per_million_points * points * 1e-6
    }
}

/// What was chosen, and what came of it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Reached {
    pub setting: String,
    /// Held out; absent where no ground point can be.
    pub terrain_error_m: Option<f64>,
    /// Absent without trees.
    pub crown_error_m: Option<f64>,
    /// That the front foretold for the whole run on this machine.
    pub expected_seconds: f64,
}

impl Reached {
    /// The greater of the two.
    pub fn error_m(&self) -> f64 {
        self.terrain_error_m.unwrap_or(0.0).max(self.crown_error_m.unwrap_or(0.0))
    }

    /// What is told of it, and a warning where the goal is not met. `seconds`: of the whole run.
    pub fn told(&self, goal: Goal, seconds: f64) -> (String, Option<String>) {
        let metres =
            |m: Option<f64>| m.map_or("not known".into(), |m| format!("{} m", significant(m)));
        let told = format!(
            "chosen: {}; reached: terrain {} off (held out), crowns {} off (points to wood, mean), {:.1} s",
            self.setting,
            metres(self.terrain_error_m),
            metres(self.crown_error_m),
            seconds
        );
        let warning = match goal {
            Goal::Error(m) if self.error_m() > m => Some(format!(
                "--error {m}: the finest setting that was tried reaches {} m: {}",
                significant(self.error_m()),
                match self.terrain_error_m.unwrap_or(0.0) >= self.error_m() {
                    true => "the terrain of this scan is not known better (held-out RMSE)",
                    false => "the trees of this scan are not filled better",
                }
            )),
            Goal::Time(s) if seconds > s => Some(format!(
                "--time {s}: it took {seconds:.1} s with the setting that was foretold {:.1} s",
                self.expected_seconds
            )),
            _ => None,
        };
        (told, warning)
    }
}

/// The front that comes with the program.
///
/// # Errors
/// A damaged program.
pub fn reference() -> Result<Reference> {
    serde_json::from_str(include_str!("front.json")).map_err(|e| {
        Error::new(format!("the measured front in the program is damaged: {e}"))
            .remedy("write it anew with `larix report --write-front src/pipeline/front.json`")
    })
}

/// Seconds to grow and mesh two dozen trees: the unit in which machines are compared; the least of
/// three.
///
/// # Errors
/// A damaged program.
pub fn calibrate() -> Result<f64> {
    let species = species::load("betula_pendula")?;
    let textures = texture::plain(&species);
    let tree = |k: u64| {
        let seed = Seed::new(k);
        let target = Target::FromSpecies { height_m: None };
        let skeleton = skeleton::grow(&species, target, Detail::FOREST, seed)?;
        let subject = Subject { skeleton: &skeleton, species: &species, textures: &textures, seed };
        subject.mesh(&mesh_options(5_000))
    };
    let mut least = f64::INFINITY;
    for _ in 0..3 {
        let start = Instant::now();
        (0..24).into_par_iter().map(tree).collect::<Result<Vec<_>>>()?;
        least = least.min(start.elapsed().as_secs_f64());
    }
    Ok(least)
}

/// What a run may take longer than the front foretells without missing a stated time.
const MARGIN: f64 = 1.15;

/// A scan to a forest that meets the goal as far as any setting of the front does. The job's own
/// effort, sharing, triangles and tolerance are not looked at.
///
/// # Errors
/// Those of [`super::forest::forest`].
pub fn forest(job: &ForestJob, goal: Goal, run: &mut Recorder) -> Result<(Forest, Reached)> {
    let front = reference()?;
    let pace = calibrate()? / front.unit_s.max(1e-6);
    let species = job.survey.species.len();
    let points = scan::stated_points(&job.survey.scans) as f64;
    let survey_rate = choose_survey(&front, goal, points, pace, species)?;
    let mut job = job.clone();
    job.survey.effort = survey_rate.effort();
    let mut survey = survey::inventory(&job.survey, run)?;
    let held_out = run.stages.iter().rev().find(|s| s.stage == "terrain");
    let terrain_error_m = held_out.and_then(|s| s.error.as_ref()).map(|e| e.value);
    // Chosen for what will be made.
    let clipped = job.clip.take().map_or(Ok(0), |clip| view::clip(&mut survey, &clip))?;
    let trees = job.eye.as_ref().map_or(survey.trees.len(), |eye| view::in_sight(&survey, eye));
    let size = (pace, trees, species);
    if job.cache.is_on() {
        super::forest::paint_ahead(&job, &survey, run)?;
    }
    let left = match goal {
        Goal::Time(s) => Goal::Time(s - run.seconds()),
        error => error,
    };
    let mut build = choose_build(&front, left, 1.0, size)?;
    let mut is_first = true;
    loop {
        let expected_seconds = run.seconds() + pace * build.seconds(trees, species);
        foretell(build, size, run)?;
        let mut made = raised(&job, build, survey, run)?;
        // A second try is only for a missed error.
        let crown_error_m = made.crown_error_m;
        let is_missed = matches!(goal, Goal::Error(m) if crown_error_m.unwrap_or(0.0) > m);
        let harder = crown_error_m.map_or(1.0, |m| m / build.crown_error_m.max(1e-6));
        let next = choose_build(&front, goal, harder, size)?;
        if is_first && is_missed && next != build {
            (build, is_first, survey) = (next, false, made.survey);
            continue;
        }
        made.clipped = clipped;
        let setting = format!("--effort {}, {}", survey_rate.effort, build.text());
        let reached = Reached { setting, terrain_error_m, crown_error_m, expected_seconds };
        return Ok((made, reached));
    }
}

/// Files so large are warned of before they are made.
const LARGE_BYTES: f64 = 2e9;

/// Tells what a setting will take, before it is run.
fn foretell(
    build: &BuildRate,
    (pace, trees, species): (f64, usize, usize),
    run: &mut Recorder,
) -> Result<()> {
    run.stage("setting", |warnings| {
        let (models, bytes) = (build.models(trees, species), build.bytes(trees, species));
        let size = match bytes {
            b if b < 1e9 => format!("{:.0} MB", b * 1e-6),
            b => format!("{:.1} GB", b * 1e-9),
        };
        if bytes > LARGE_BYTES {
            warnings.push(format!(
                "what is asked for makes files of about {size}: each of {models} models has up to {} \
                 triangles; a larger --error makes less, and --clip a part",
                build.triangles
            ));
        }
        let seconds = significant(pace * build.seconds(trees, species));
        let outcome = Outcome::items(trees, "trees", models, "models")
            .note(build.text())
            .note(format!("foretold: {seconds} s more, {size} as GLB and USDA"));
        Ok(((), outcome))
    })
}

fn raised(
    job: &ForestJob,
    build: &BuildRate,
    survey: Survey,
    run: &mut Recorder,
) -> Result<Forest> {
    let mut job = ForestJob {
        sharing: build.sharing(),
        triangles: build.triangles,
        tells_fit: true,
        ..job.clone()
    };
    job.wood.tolerance_m = None;
    raise(&job, survey, run)
}

/// With an error, the quickest whose terrain keeps to it, else the most right; with a time, the
/// most right of those that leave the trees half of it, and what they take at least, else the quickest.
fn choose_survey(
    front: &Reference,
    goal: Goal,
    points: f64,
    pace: f64,
    species: usize,
) -> Result<&SurveyRate> {
    let trees = (points * front.trees as f64 / front.points.max(1) as f64) as usize;
    let least_build = front.builds.iter().map(|b| b.seconds(trees, species));
    let least_build = least_build.fold(f64::INFINITY, f64::min);
    let fits = |s: &&SurveyRate| match goal {
        Goal::Error(m) => s.terrain_error_m <= m,
        Goal::Time(t) => {
            let survey_s = s.seconds(points);
            MARGIN * pace * survey_s.max(0.5 * (survey_s + least_build)) <= 0.5 * t
        }
    };
    let quick = |a: &&SurveyRate, b: &&SurveyRate| {
        a.seconds_per_million_points.total_cmp(&b.seconds_per_million_points)
    };
    let right = |a: &&SurveyRate, b: &&SurveyRate| a.terrain_error_m.total_cmp(&b.terrain_error_m);
    let fitting = front.surveys.iter().filter(fits);
    let chosen = match goal {
        Goal::Error(_) => fitting.min_by(quick).or_else(|| front.surveys.iter().min_by(right)),
        Goal::Time(_) => fitting.min_by(right).or_else(|| front.surveys.iter().min_by(quick)),
    };
    chosen.ok_or_else(|| Error::new("the measured front in the program holds no survey"))
}

/// With an error, the quickest that keeps to it where trees are so many times `harder` than the
/// reference's, else the most right; with a time, the most right that keeps to it, else the quickest.
fn choose_build(
    front: &Reference,
    goal: Goal,
    harder: f64,
    (pace, trees, species): (f64, usize, usize),
) -> Result<&BuildRate> {
    let seconds = |b: &BuildRate| pace * b.seconds(trees, species);
    let fits = |b: &&BuildRate| match goal {
        Goal::Error(m) => b.crown_error_m * harder <= m,
        Goal::Time(t) => MARGIN * seconds(b) <= t,
    };
    let quick = |a: &&BuildRate, b: &&BuildRate| seconds(a).total_cmp(&seconds(b));
    let right = |a: &&BuildRate, b: &&BuildRate| a.crown_error_m.total_cmp(&b.crown_error_m);
    let fitting = front.builds.iter().filter(fits);
    let chosen = match goal {
        Goal::Error(_) => fitting.min_by(quick).or_else(|| front.builds.iter().min_by(right)),
        Goal::Time(_) => fitting.min_by(right).or_else(|| front.builds.iter().min_by(quick)),
    };
    chosen.ok_or_else(|| Error::new("the measured front in the program holds no setting"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn front() -> Reference {
        let build = |models_a_species, triangles, crown_error_m, seconds_per_model| BuildRate {
            models_a_species,
            triangles,
            crown_error_m,
            seconds_fixed: 1.0,
            seconds_per_model,
            bytes_per_model: 1e6,
        };
        let survey = |effort: &str, terrain_error_m, seconds_per_million_points| SurveyRate {
            effort: effort.into(),
            terrain_error_m,
            seconds_per_million_points,
        };
        Reference {
            builds: vec![
                build(2, 500, 0.8, 0.01),
                build(5, 5_000, 0.5, 0.05),
                build(0, 5_000, 0.2, 0.05),
            ],
            surveys: vec![survey("fast", 0.02, 1.0), survey("best", 0.01, 3.0)],
            ..reference().unwrap()
        }
    }

    #[test]
    fn the_cheapest_that_meets_an_error_is_taken() {
        let f = front();
        let of =
            |m, harder| choose_build(&f, Goal::Error(m), harder, (1.0, 100, 2)).unwrap().triangles;
        assert_eq!([of(1.0, 1.0), of(0.6, 1.0)], [500, 5_000]);
        let models = |m, harder| {
            choose_build(&f, Goal::Error(m), harder, (1.0, 100, 2)).unwrap().models_a_species
        };
        assert_eq!([models(0.6, 1.0), models(0.6, 2.0), models(0.1, 1.0)], [5, 0, 0]);
        let effort = |m| &choose_survey(&f, Goal::Error(m), 1e6, 1.0, 2).unwrap().effort;
        assert_eq!([effort(0.05), effort(0.015), effort(0.001)], ["fast", "best", "best"]);
    }

    #[test]
    fn the_most_right_within_a_time_is_taken_and_else_the_quickest() {
        let f = front();
        let of =
            |s, pace| choose_build(&f, Goal::Time(s), 1.0, (pace, 100, 2)).unwrap().crown_error_m;
        assert_eq!([of(10.0, 1.0), of(3.0, 1.0), of(0.1, 1.0)], [0.2, 0.5, 0.8]);
        // A machine half as fast can afford less.
        assert_eq!(of(10.0, 2.0), 0.5);
        // The better survey takes 3 s: half of the time is for the trees.
        let effort = |s| &choose_survey(&f, Goal::Time(s), 1e6, 1.0, 2).unwrap().effort;
        assert_eq!([effort(8.0), effort(6.0), effort(0.1)], ["best", "fast", "fast"]);
    }

    #[test]
    fn what_is_missed_is_told() {
        let reached = Reached {
            setting: "x".into(),
            terrain_error_m: Some(0.3),
            crown_error_m: Some(0.2),
            expected_seconds: 5.0,
        };
        assert!(reached.told(Goal::Error(0.25), 4.0).1.unwrap().contains("reaches 0.300 m"));
        assert_eq!(reached.told(Goal::Error(0.3), 4.0).1, None);
        assert!(reached.told(Goal::Time(3.0), 4.0).1.unwrap().contains("took 4.0 s"));
        assert_eq!(reached.told(Goal::Time(5.0), 4.0).1, None);
    }

    /// Ratios, not times: finer settings of the front are more right, sharing is less.
    #[test]
    fn the_front_of_the_program_is_whole() {
        let f = reference().unwrap();
        let error = |models: usize, triangles: usize| {
            let is_it = |b: &&BuildRate| (b.models_a_species, b.triangles) == (models, triangles);
            f.builds.iter().find(is_it).map_or(f64::NAN, |b| b.crown_error_m)
        };
        assert!(f.unit_s > 0.0 && f.surveys.len() == Effort::ALL.len());
        for [coarse, fine] in [[5_000, 15_000], [15_000, 40_000], [40_000, 60_000]] {
            assert!(error(0, fine) < error(0, coarse) && error(5, fine) < error(5, coarse));
            assert!(error(0, fine) < 0.95 * error(5, fine), "{fine}");
        }
        assert!(f.surveys.iter().all(|s| s.terrain_error_m < 0.05));
    }
}
