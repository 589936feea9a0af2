//! Everything a report measures, by running the stages: what accuracy costs (`terrain`, `crowns`,
//! `growth`, `models`, `files`), what converges (`convergence`), what is stable (`stability`), what
//! is left out (`omissions`), how it grows (`scale`). Makes a [`Document`], writes only what is
//! measured by writing, into a folder that it is given.

mod convergence;
mod crowns;
mod facts;
mod files;
mod growth;
mod models;
mod omissions;
mod place;
mod scale;
pub mod stability;
mod terrain;
mod whole;

use std::path::PathBuf;
use std::time::Instant;

use place::Place;
pub use whole::reference;

use crate::diagnostic::Result;
use crate::report::document::{About, Document, Machine, SCHEMA, Timing};
use crate::seed::Seed;
use crate::species::Species;

/// What is to be measured.
#[derive(Debug, Clone)]
pub struct ReportJob {
    /// A simulated survey with known truth where there are none.
    pub scans: Vec<PathBuf>,
    pub photo: Option<PathBuf>,
    /// To choose among, never empty.
    pub species: Vec<Species>,
    pub seed: u64,
    /// Fewer settings, smaller tasks.
    pub is_quick: bool,
    /// A folder for what is written only to be measured.
    pub scratch: PathBuf,
}

/// Told how far the report has come, so that a person can wait.
pub trait Progress: Sync {
    /// `share` of all the work is done, 0…1; `what` begins.
    fn at(&self, share: f64, what: &str);
}

/// What every chapter measures with.
struct Bench<'a> {
    job: &'a ReportJob,
    place: Place,
    warnings: Vec<String>,
}

impl Bench<'_> {
    fn seed(&self) -> Seed {
        Seed::new(self.job.seed)
    }

    /// Runs `work` on what `prepare` gives, as often as repeats are asked for; the last value.
    fn timed<P, T>(
        &self,
        mut prepare: impl FnMut() -> P,
        mut work: impl FnMut(P) -> Result<T>,
    ) -> Result<(T, Timing)> {
        let mut seconds = Vec::new();
        loop {
            let prepared = prepare();
            let start = Instant::now();
            let value = work(prepared)?;
            seconds.push(start.elapsed().as_secs_f64());
            if seconds.len() >= repeats(self.job.is_quick, seconds.iter().sum()) {
                return Ok((value, Timing::of(&seconds)));
            }
        }
    }
}

/// How often a task is run that has taken so many seconds by now: at least three times, quick ones
/// more often, long ones twice.
fn repeats(is_quick: bool, spent_s: f64) -> usize {
    match (is_quick, spent_s) {
        (false, s) if s < 0.2 => 5,
        (true, s) if s > 0.5 => 1,
        (_, s) if s > 4.0 => 2,
        _ => 3,
    }
}

type Task = fn(&mut Bench<'_>, &mut Document) -> Result<()>;

/// The tasks, with about the share of the time that each takes.
const TASKS: [(&str, f64, Task); 11] = [
    ("whole run as usual", 0.05, |b, d| extend(&mut d.facts, facts::facts(b))),
    ("terrain", 0.04, |b, d| add(&mut d.fronts, terrain::front(b))),
    ("crowns", 0.05, |b, d| extend(&mut d.fronts, crowns::fronts(b))),
    ("growth", 0.05, |b, d| extend(&mut d.fronts, growth::fronts(b))),
    ("models", 0.16, |b, d| extend(&mut d.fronts, models::fronts(b))),
    ("files", 0.1, |b, d| extend(&mut d.fronts, files::fronts(b))),
    ("whole run", 0.1, |b, d| add(&mut d.fronts, whole::front(b))),
    ("convergence", 0.08, |b, d| extend(&mut d.convergence, convergence::ladders(b))),
    ("stability", 0.15, |_, d| extend(&mut d.stability, Ok(stability::run()))),
    ("what is left out", 0.15, |b, d| extend(&mut d.left_out, omissions::all(b))),
    ("scale", 0.22, |b, d| extend(&mut d.scale, scale::all(b))),
];

fn add<T>(list: &mut Vec<T>, one: Result<T>) -> Result<()> {
    list.push(one?);
    Ok(())
}

fn extend<T>(list: &mut Vec<T>, more: Result<Vec<T>>) -> Result<()> {
    list.extend(more?);
    Ok(())
}

/// Measures everything.
///
/// # Errors
/// Scans or a photo that can't be used; a scratch folder that can't be written to.
pub fn report(job: &ReportJob, progress: &dyn Progress) -> Result<Document> {
    let start = Instant::now();
    progress.at(0.0, "survey");
    let mut warnings = Vec::new();
    let place = Place::of(job, &mut warnings)?;
    let mut bench = Bench { job, place, warnings };
    let mut document = Document {
        schema: SCHEMA,
        about: About {
            larix: env!("CARGO_PKG_VERSION").into(),
            subject: bench.place.subject.clone(),
            machine: machine(),
            is_quick: job.is_quick,
            seed: job.seed,
            seconds: 0.0,
            warnings: Vec::new(),
        },
        facts: Vec::new(),
        fronts: Vec::new(),
        convergence: Vec::new(),
        stability: Vec::new(),
        left_out: Vec::new(),
        scale: Vec::new(),
    };
    let all: f64 = TASKS.iter().map(|t| t.1).sum();
    let mut done = 0.0;
    for (name, share, task) in TASKS {
        progress.at(done / all, name);
        task(&mut bench, &mut document)?;
        done += share;
    }
    progress.at(1.0, "page");
    left_unmeasured(&mut document, &mut bench.warnings);
    document.about.warnings = bench.warnings;
    document.about.seconds = start.elapsed().as_secs_f64();
    Ok(document)
}

/// What a scan gives no numbers for is told instead of shown: ground known to be level, no trees.
fn left_unmeasured(document: &mut Document, warnings: &mut Vec<String>) {
    let told = |title: &str| format!("{title}: this scan gives nothing to measure it on");
    for front in document.fronts.extract_if(.., |f| f.points.is_empty()) {
        warnings.push(told(&front.title));
    }
    for ladder in document.convergence.extract_if(.., |l| l.rungs.is_empty()) {
        warnings.push(told(&ladder.title));
    }
}

fn machine() -> Machine {
    let told = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let name = told.lines().find_map(|l| l.strip_prefix("model name")?.split_once(':'));
    Machine {
        system: format!("{} {}", std::env::consts::OS, std::env::consts::ARCH),
        processor: name.map_or(String::new(), |n| n.1.trim().to_owned()),
        cores: std::thread::available_parallelism().map_or(1, usize::from),
        threads: rayon::current_num_threads(),
        has_assertions: cfg!(debug_assertions),
    }
}
