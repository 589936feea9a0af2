//! The commands of those who write rule files.

use std::path::{Path, PathBuf};

use serde_json::{Value, json};

use super::args::{self, Cli, SpeciesCommand};
use super::paths::{extension, place};
use super::told::print;
use super::watch;
use crate::diagnostic::{Error, Result};
use crate::export::{self, OutputFile};
use crate::pipeline::rules::{self, Sound};
use crate::pipeline::sheet::{self, SheetJob};
use crate::report::Recorder;
use crate::seed::Seed;
use crate::skeleton::derive::Stats;
use crate::species;

pub fn run(command: &SpeciesCommand, cli: &Cli, run: &mut Recorder) -> Result<()> {
    match command {
        SpeciesCommand::List => list(cli),
        SpeciesCommand::Derive(a) => derive(a, cli),
        SpeciesCommand::Check(a) if a.watch => watch::watch(a, cli),
        SpeciesCommand::Check(a) => check(a, cli),
        SpeciesCommand::New(a) => new(a, cli),
        SpeciesCommand::Schema(a) => schema(a, cli),
        SpeciesCommand::Show(a) => show(a, cli, run),
    }
}

/// The JSON answer where asked for, otherwise the lines unless they are to be spared.
fn answer(cli: &Cli, value: Value, lines: &[String]) -> Result<()> {
    match (cli.json, cli.quiet) {
        (true, _) => print(&[value.to_string()])?,
        (false, false) => print(lines)?,
        (false, true) => true,
    };
    Ok(())
}

fn list(cli: &Cli) -> Result<()> {
    if cli.quiet && !cli.json {
        let names = species::builtin_names().into_iter().map(str::to_owned).collect::<Vec<_>>();
        print(&names)?;
        return Ok(());
    }
    let all = species::list()?;
    let lines: Vec<String> = (all.iter())
        .map(|s| {
            let base = s.builds_on.as_deref().map_or(String::new(), |b| format!("builds on {b}"));
            format!("{:<20} {:<24} {:<20} {base}", s.id, s.name, s.common)
        })
        .collect();
    answer(cli, json!(all), &lines)
}

fn derive(a: &args::Derive, cli: &Cli) -> Result<()> {
    let names = match a.all {
        true => (1..=rules::TABLE_4.len()).map(|n| format!("table3/{n:02}")).collect(),
        false => a.species.clone(),
    };
    let (mut rows, mut texts, mut errors) = (Vec::new(), Vec::new(), Vec::new());
    for name in names {
        let derived = species::load(&name).and_then(|species| {
            let (string, stats) = rules::derive(&species, a.iterations, Seed::new(a.seed))
                .map_err(|e| e.in_file(&name))?;
            Ok((stats, a.text.then(|| string.to_text(&species.rule))))
        });
        match derived {
            Ok((stats, text)) => {
                rows.push((name, stats));
                texts.extend(text);
            }
            Err(e) => errors.push(e),
        }
    }
    if !errors.is_empty() {
        return Err(Error::several(errors));
    }
    let is_one = rows.len() == 1 && !a.all;
    if cli.json {
        let mut values: Vec<Value> = rows.iter().map(|(_, stats)| json!(stats)).collect();
        for (value, text) in values.iter_mut().zip(texts) {
            value["text"] = text.into();
        }
        if !is_one {
            for (value, (name, _)) in values.iter_mut().zip(&rows) {
                value["species"] = name.as_str().into();
                if let Some([faces, vertices, edges]) = rules::of_table_4(name) {
                    value["table_4"] =
                        json!({ "faces": faces, "vertices": vertices, "edges": edges });
                }
            }
        }
        let value = if is_one { values.remove(0) } else { Value::Array(values) };
        print(&[value.to_string()])?;
    } else if a.text {
        print(&texts)?;
    } else {
        print(&derived_table(&rows, !is_one, cli.quiet))?;
    }
    Ok(())
}

/// Our counts, and where asked for those of the source beside them.
fn derived_table(rows: &[(String, Stats)], with_source: bool, is_bare: bool) -> Vec<String> {
    let with_source = with_source && rows.iter().any(|(n, _)| rules::of_table_4(n).is_some());
    let first = rows.iter().map(|(n, _)| n.chars().count()).max().unwrap_or(0).max(9);
    let mut lines = Vec::new();
    if !is_bare {
        let head = format!(
            "{:<first$} {:>9} {:>9} {:>9} {:>12} {:>9}",
            "rule", "modules", "draws", "brackets", "length, m", "nodes"
        );
        let source = format!(" │ {:>6} {:>9} {:>6}", "faces", "vertices", "edges");
        lines.push(if with_source { head + &source } else { head });
    }
    for (name, s) in rows {
        let mut line = format!(
            "{name:<first$} {:>9} {:>9} {:>9} {:>12} {:>9}",
            s.modules,
            s.draws,
            s.brackets,
            format!("{:.4}", s.length),
            s.nodes
        );
        if let (true, Some([faces, vertices, edges])) = (with_source, rules::of_table_4(name)) {
            line += &format!(" │ {faces:>6} {vertices:>9} {edges:>6}");
        }
        lines.push(line);
    }
    if with_source && !is_bare {
        lines.push(String::new());
        lines.push(
            "Faces, vertices and edges: Table 4 of the source. It describes its author's mesh, \
             not the rules,"
                .into(),
        );
        lines.push(
            "and lists different counts for rules 1 and 2, whose production is one: no target."
                .into(),
        );
    }
    lines
}

fn check(a: &args::Check, cli: &Cli) -> Result<()> {
    let (mut values, mut lines, mut errors) = (Vec::new(), Vec::new(), Vec::new());
    for path in &a.files {
        let checked = rules::check(path, Seed::new(a.seed));
        values.push(checked_json(path, &checked));
        match checked {
            Ok(sound) => {
                warn(&sound, cli);
                lines.push(checked_line(path, &sound));
            }
            Err(e) => errors.push(e),
        }
    }
    answer(cli, Value::Array(values), &lines)?;
    if errors.is_empty() { Ok(()) } else { Err(Error::several(errors)) }
}

/// Tells what a run would warn of.
pub(super) fn warn(sound: &Sound, cli: &Cli) {
    if !cli.json && !cli.quiet {
        sound.species.remarks.iter().for_each(|remark| tell!("warning: {}", remark.text));
    }
}

pub(super) fn checked_line(path: &Path, sound: &Sound) -> String {
    format!(
        "{}: ok, {}: {} modules, a tree of {:.1} m with {} nodes",
        path.display(),
        sound.species.name,
        sound.stats.modules,
        sound.height_m,
        sound.nodes
    )
}

pub(super) fn checked_json(path: &Path, checked: &Result<Sound>) -> Value {
    let file = path.to_string_lossy();
    match checked {
        Ok(sound) => json!({
            "file": file,
            "ok": true,
            "name": sound.species.name,
            "derived": sound.stats,
            "tree": { "height_m": sound.height_m, "nodes": sound.nodes },
            "warnings": sound.species.remarks.iter().map(|r| &r.text).collect::<Vec<_>>(),
        }),
        Err(error) => {
            let one = |e: &Error| {
                let place = e.line_and_column();
                json!({
                    "message": e.message(),
                    "line": place.map(|p| p.0),
                    "column": place.map(|p| p.1),
                    "remedy": e.remedy_text(),
                })
            };
            json!({ "file": file, "ok": false, "errors": error.each().map(one).collect::<Vec<_>>() })
        }
    }
}

fn new(a: &args::New, cli: &Cli) -> Result<()> {
    let text = species::template(&a.name, &a.from)?;
    let path = a.output.clone().unwrap_or_else(|| PathBuf::from(format!("{}.toml", a.name)));
    extension(&path, &["toml"])?;
    let (dir, name) = place(&path)?;
    if path.exists() && !a.force {
        return Err(Error::new("is there already")
            .in_file(&path)
            .remedy("choose another name with -o, or give --force to write over it"));
    }
    export::write_all(&dir, vec![OutputFile::new(name, text.into_bytes())])?;
    let shown = path.display();
    answer(
        cli,
        json!({ "file": path.to_string_lossy(), "name": a.name, "from": a.from }),
        &[format!("{shown} written; see it change with: larix species check --watch {shown}")],
    )
}

/// The schema is its own JSON; there is nothing to spare.
fn schema(a: &args::Schema, cli: &Cli) -> Result<()> {
    let text = format!("{:#}", species::schema());
    let Some(path) = &a.output else {
        print(&[text])?;
        return Ok(());
    };
    let (dir, name) = place(path)?;
    export::write_all(&dir, vec![OutputFile::new(name, format!("{text}\n").into_bytes())])?;
    answer(
        cli,
        json!({ "file": path.to_string_lossy() }),
        &[format!("schema written to {}", path.display())],
    )
}

fn show(a: &args::Show, cli: &Cli, run: &mut Recorder) -> Result<()> {
    extension(&a.output, &["png"])?;
    let (dir, name) = place(&a.output)?;
    let job = SheetJob {
        height_m: a.height,
        seeds: (0..3).map(|i| a.seed.wrapping_add(i)).collect(),
        size_px: a.size,
        cache: super::commands::cache(cli),
        ..SheetJob::new(species::load(&a.species)?)
    };
    export::check_writable(&dir)?;
    let sheet = sheet::sheet(&job, run)?;
    export::write_all(&dir, vec![OutputFile::new(name, sheet.picture.to_png()?)])?;
    let value = json!({
        "species": job.species.name,
        "file": a.output.to_string_lossy(),
        "width": sheet.picture.width,
        "height": sheet.picture.height,
        "trees": sheet.trees,
    });
    let line = format!(
        "{}, {} × {} pixels, written to {}",
        job.species.name,
        sheet.picture.width,
        sheet.picture.height,
        a.output.display()
    );
    answer(cli, value, &[line])
}
