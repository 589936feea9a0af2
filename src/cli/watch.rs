//! `species check --watch`: files are checked and drawn anew on every save.
//!
//! Files are looked at a few times a second. That is cheap for a few small files, needs nothing of
//! the system, and doesn't mind editors that save by renaming, which take a file away for a
//! moment. A file is read only once it has stopped changing.

use std::fs;
use std::path::{Path, PathBuf};
use std::thread::sleep;
use std::time::{Duration, Instant, SystemTime};

use super::args::{Check, Cli};
use super::paths::{extension, place};
use super::species::{checked_json, checked_line, warn};
use super::told::print;
use crate::diagnostic::{self, Error, Result};
use crate::export::{self, OutputFile};
use crate::pipeline::rules::{self, Sound};
use crate::pipeline::sheet::{self, SheetJob};
use crate::report::{Recorder, Silent};
use crate::seed::Seed;
use crate::species;

const LOOK_EVERY: Duration = Duration::from_millis(150);
/// A file that two looks so far apart show alike is whole.
const SETTLED_AFTER: Duration = Duration::from_millis(30);
/// Looks at a file that never settles before it is read as it is.
const MAX_LOOKS: usize = 50;
/// A file gone for longer is spoken of.
const GONE_AFTER: Duration = Duration::from_secs(2);
/// Longer side of the picture.
const PICTURE_PX: u32 = 1200;

/// When a file was written and what it says; `None` while it is not there.
type Look = Option<(SystemTime, Vec<u8>)>;

fn look(path: &Path) -> Look {
    let written = fs::metadata(path).and_then(|m| m.modified()).ok()?;
    Some((written, fs::read(path).ok()?))
}

struct Watched {
    path: PathBuf,
    picture: PathBuf,
    /// The file and what it extends, with their last looks.
    files: Vec<(PathBuf, Look)>,
    gone_since: Option<Instant>,
}

impl Watched {
    fn new(path: &Path, picture: Option<&Path>) -> Self {
        Watched {
            path: path.to_path_buf(),
            picture: picture.map_or_else(|| path.with_extension("png"), Path::to_path_buf),
            files: Vec::new(),
            gone_since: None,
        }
    }

    fn looks(&self) -> Vec<(PathBuf, Look)> {
        self.files.iter().map(|(path, _)| (path.clone(), look(path))).collect()
    }

    /// Whether there is something new to check.
    fn has_changed(&mut self) -> bool {
        let mut now = self.looks();
        if now == self.files {
            if now.first().is_some_and(|(_, look)| look.is_some()) {
                self.gone_since = None;
            }
            return false;
        }
        for _ in 0..MAX_LOOKS {
            sleep(SETTLED_AFTER);
            let again = self.looks();
            if again == now {
                break;
            }
            now = again;
        }
        let is_there = now.first().is_some_and(|(_, look)| look.is_some());
        let is_new = is_there && now != self.files;
        if is_there {
            self.gone_since = None;
            self.files = now;
        } else {
            // What it said last still holds, until it is back.
            self.gone_since.get_or_insert_with(Instant::now);
        }
        is_new
    }

    /// Says once that the file is gone; then waits silently.
    fn speak_of_absence(&mut self, is_quiet: bool) {
        if self.gone_since.is_some_and(|t| t.elapsed() > GONE_AFTER) {
            if !is_quiet {
                tell!("{} is gone; waiting for it", self.path.display());
            }
            self.gone_since = None;
            self.files.truncate(1);
            if let Some((_, look)) = self.files.first_mut() {
                *look = None;
            }
        }
    }

    /// What the file extends may have changed with it. A change of the file itself since the last
    /// look is not overlooked: that look is kept.
    fn follow_bases(&mut self) {
        let own = self.files.first().and_then(|(_, look)| look.clone());
        let files = species::files(&self.path).into_iter();
        self.files = files
            .enumerate()
            .map(|(i, path)| {
                let look = if i == 0 { own.clone() } else { look(&path) };
                (path, look)
            })
            .collect();
    }
}

/// Checks now, and again on every change, until it is stopped or nobody reads any more.
pub fn watch(a: &Check, cli: &Cli) -> Result<()> {
    if let Some(picture) = &a.output {
        extension(picture, &["png"])?;
        if a.files.len() > 1 {
            return Err(Error::new("-o names one picture, and there are several files")
                .remedy("leave -o out: each picture goes beside its file"));
        }
    }
    let mut all: Vec<Watched> =
        a.files.iter().map(|path| Watched::new(path, a.output.as_deref())).collect();
    for watched in &mut all {
        watched.files = vec![(watched.path.clone(), look(&watched.path))];
        if !examine(watched, a.seed, cli)? {
            return Ok(());
        }
    }
    loop {
        sleep(LOOK_EVERY);
        for watched in &mut all {
            if watched.has_changed() && !examine(watched, a.seed, cli)? {
                return Ok(());
            }
            watched.speak_of_absence(cli.quiet);
        }
    }
}

/// Checks and draws one file, and tells; false when nobody listens.
fn examine(watched: &mut Watched, seed: u64, cli: &Cli) -> Result<bool> {
    let start = Instant::now();
    let path = watched.path.clone();
    watched.follow_bases();
    let checked = rules::check(&path, Seed::new(seed)).and_then(|sound| {
        draw(&sound, seed, &watched.picture, cli)?;
        Ok(sound)
    });
    let seconds = start.elapsed().as_secs_f64();
    let mut lines = Vec::new();
    if cli.json {
        let mut value = checked_json(&path, &checked);
        value["seconds"] = seconds.into();
        lines.push(value.to_string());
    }
    match checked {
        Ok(sound) => {
            warn(&sound, cli);
            if !cli.json && !cli.quiet {
                let picture = watched.picture.display();
                let line = checked_line(&path, &sound);
                lines.push(format!("{line}; {picture} in {seconds:.2} s"));
            }
        }
        Err(error) => {
            tell!("{}", diagnostic::render(&error).trim_end());
            if !cli.quiet {
                let (count, shown) = (error.count(), path.display());
                let s = if count == 1 { "" } else { "s" };
                tell!("{shown}: {count} mistake{s}, found in {seconds:.2} s");
            }
        }
    }
    print(&lines)
}

/// The tree in leaf and bare.
fn draw(sound: &Sound, seed: u64, picture: &Path, cli: &Cli) -> Result<()> {
    let job = SheetJob {
        seeds: vec![seed],
        size_px: PICTURE_PX,
        cache: super::commands::cache(cli),
        ..SheetJob::new(sound.species.clone())
    };
    let sheet = sheet::sheet(&job, &mut Recorder::new(&Silent))?;
    let (dir, name) = place(picture)?;
    export::write_all(&dir, vec![OutputFile::new(name, sheet.picture.to_png()?)])
}
