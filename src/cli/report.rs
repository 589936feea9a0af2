//! The command `report`.

use std::path::PathBuf;

use clap::Args;
use serde_json::json;

use super::jobs::load_species;
use super::paths::place;
use super::progress::Bar;
use super::told::Told;
use crate::diagnostic::{Error, Result};
use crate::export::{self, OutputFile};
use crate::pipeline::measure::{self, ReportJob};
use crate::report::{Document, document, html, plot};

#[derive(Debug, Args)]
pub struct Report {
    /// LAS, LAZ or XYZ files of one area; the simulated stand of the demo, of which the truth is
    /// known, where absent.
    #[arg(value_name = "SCAN")]
    pub scans: Vec<PathBuf>,
    /// Georeferenced aerial photo of the scan.
    #[arg(long, value_name = "FILE", requires = "scans")]
    pub photo: Option<PathBuf>,
    /// The simulated stand: the default.
    #[arg(long, conflicts_with = "scans")]
    pub simulated: bool,
    /// Fewer settings, smaller tasks: under a minute.
    #[arg(long)]
    pub quick: bool,
    /// Species to choose among, comma separated; `larix species list` shows them.
    #[arg(long, value_name = "A,B,…", value_delimiter = ',')]
    pub species: Vec<String>,
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Measure instead the front that `larix forest --error` and `--time` choose on, into this file.
    #[arg(long, value_name = "FILE", hide = true, conflicts_with_all = ["scans", "quick"])]
    pub write_front: Option<PathBuf>,
    /// Folder for report.html, report.json with its schema, and the plots.
    #[arg(short, long, value_name = "DIR", default_value = "output/report")]
    pub output: PathBuf,
}

/// Seconds that it takes on two cores, in full and quick.
const USUAL_S: [f64; 2] = [240.0, 40.0];

pub(super) fn run(a: &Report, is_quiet: bool) -> Result<Told> {
    if a.write_front.is_none() {
        export::check_writable(&a.output)?;
    }
    let scratch = tempfile::tempdir().map_err(|e| {
        Error::new(format!("no temporary folder can be made: {e}"))
            .remedy("set TMPDIR to one with room")
    })?;
    let job = ReportJob {
        scans: a.scans.clone(),
        photo: a.photo.clone(),
        species: load_species(&a.species)?,
        seed: a.seed,
        is_quick: a.quick,
        scratch: scratch.path().to_path_buf(),
    };
    if let Some(path) = &a.write_front {
        let front = measure::reference(&job)?;
        let (dir, name) = place(path)?;
        let json = json(&front)?;
        export::write_all(&dir, vec![OutputFile::new(name, json)])?;
        let lines = vec![format!("written to {}", path.display())];
        return Ok(Told { lines, json: json!(front) });
    }
    let document = {
        let bar = Bar::new(USUAL_S[usize::from(a.quick)], is_quiet);
        measure::report(&job, &bar)?
    };
    export::write_all(&a.output, files(&document)?)?;
    let mut lines = summary(&document);
    lines.push(format!("written to {}", a.output.join("report.html").display()));
    Ok(Told { lines, json: json!(document) })
}

fn json(value: &impl serde::Serialize) -> Result<String> {
    let text = serde_json::to_string_pretty(value);
    text.map(|t| t + "\n").map_err(|e| Error::new(format!("what was measured is no JSON: {e}")))
}

fn files(document: &Document) -> Result<Vec<OutputFile<'static>>> {
    let mut files = vec![
        OutputFile::new("report.html", html::page(document)),
        OutputFile::new("report.json", json(document)?),
        OutputFile::new("report.schema.json", json(&document::schema())?),
    ];
    let plots = plot::all(document).into_iter();
    files.extend(plots.map(|p| OutputFile::new(format!("plots/{}.svg", p.id), p.svg)));
    Ok(files)
}

fn summary(document: &Document) -> Vec<String> {
    let missed: Vec<String> = document
        .stability
        .iter()
        .filter(|f| !f.passes)
        .map(|f| format!("missed: {}, {}: {}", f.stage, f.input, f.happened))
        .collect();
    let settings: usize = document.fronts.iter().map(|f| f.points.len()).sum();
    let short = document.convergence.iter().filter(|l| !l.converges);
    let mut lines = vec![format!(
        "{settings} settings of {} stages, {} stability cases with {} misses; {:.0} s",
        document.fronts.len(),
        document.stability.len(),
        missed.len(),
        document.about.seconds
    )];
    lines.extend(document.about.warnings.iter().map(|w| format!("warning: {w}")));
    lines.extend(missed);
    lines.extend(short.map(|l| format!("{}: {}", l.title, l.verdict)));
    lines
}
