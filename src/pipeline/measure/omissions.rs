//! What scenes do without, what that saves, and the counts that prove it.

use glam::Vec2;

use super::super::view::Eye;
use super::super::{ForestJob, forest, levels};
use super::Bench;
use super::place::Place;
use crate::diagnostic::Result;
use crate::export::{self, Format, Job, Pictures, Staged};
use crate::lod;
use crate::mesh::WindProfile;
use crate::report::document::{Counted, Omission, Omissions, Timing};
use crate::report::{Outcome, Recorder, Silent, grouped};
use crate::scene::{ColliderShape, Texture, ValidScene};
use crate::work::{self, Work};

/// One thing: whose work it is, and how it is asked for; what a usual scene has is left out instead.
struct Thing {
    what: &'static str,
    of: &'static [Work],
    is_usual: bool,
    change: fn(&mut ForestJob, &Place),
}

const THINGS: [Thing; 7] = [
    Thing {
        what: "photo on the terrain (--photo)",
        of: &[Work::PhotoSamples],
        is_usual: true,
        change: |job, _| job.survey.photo = None,
    },
    Thing {
        what: "textures of trees (--texture 0)",
        of: &[Work::TexturePixels, Work::Tangents],
        is_usual: true,
        change: |job, _| job.texture_px = 0,
    },
    Thing {
        what: "wind (--wind)",
        of: &[Work::WindNodes],
        is_usual: false,
        change: |job, _| job.levels.wind = Some(WindProfile::Unity),
    },
    Thing {
        what: "levels of detail (--lods)",
        of: &[Work::CoarserForms, Work::Silhouettes],
        is_usual: false,
        change: |job, _| job.levels.meshed = levels::SHARES.len(),
    },
    Thing {
        what: "impostors (--impostor)",
        of: &[Work::Impostors, Work::Silhouettes],
        is_usual: false,
        change: |job, _| job.levels.impostor = Some(lod::Kind::Cross),
    },
    Thing {
        what: "colliders (--collision)",
        of: &[Work::Colliders],
        is_usual: false,
        change: |job, _| job.levels.collision = Some(ColliderShape::Convex),
    },
    Thing {
        what: "choice by a camera among the trees (--camera)",
        of: &[Work::TreesLookedFor, Work::CoarserForms, Work::Silhouettes],
        is_usual: false,
        change: |job, place| job.eye = Some(eye(place)),
    },
];

/// Of the place, and of the simulated stand beside a scan.
pub(super) fn all(bench: &mut Bench<'_>) -> Result<Vec<Omissions>> {
    let mut tables = vec![of_place(bench, &bench.place)?];
    if bench.place.stand.is_none() {
        let simulated = Place::simulated(bench.job, &mut Vec::new())?;
        tables.push(of_place(bench, &simulated)?);
    }
    Ok(tables)
}

fn of_place(bench: &Bench<'_>, place: &Place) -> Result<Omissions> {
    let usual = || {
        let mut job = place.forest_job(bench.job);
        if bench.job.is_quick {
            (job.texture_px, job.triangles) = (128, 1_000);
        }
        job
    };
    let has = |t: &&Thing| place.photo.is_some() || !t.of.contains(&Work::PhotoSamples);
    let things: Vec<&Thing> = THINGS.iter().filter(has).collect();
    let changed = |thing: &&Thing| {
        let mut job = usual();
        (thing.change)(&mut job, place);
        job
    };
    let jobs: Vec<ForestJob> = std::iter::once(usual()).chain(things.iter().map(changed)).collect();
    // In turns, so that what else the machine does weighs on all alike.
    let rounds: Vec<Vec<Run>> = (0..ROUNDS[usize::from(bench.job.is_quick)])
        .map(|_| jobs.iter().map(|job| run(bench, job)).collect())
        .collect::<Result<_>>()?;
    let measured: Vec<Measured> = (0..jobs.len())
        .map(|k| Measured::of(&rounds.iter().map(|r| &r[k]).collect::<Vec<_>>()))
        .collect();
    let base = &measured[0];
    let row_of = |(thing, changed): (&&Thing, &Measured)| match thing.is_usual {
        true => row(thing, base, changed),
        false => row(thing, changed, base),
    };
    let rows = things.iter().zip(&measured[1..]).map(row_of).collect();
    let subject = place.subject.trim_start_matches("Measured on ").trim_end_matches('.').to_owned();
    Ok(Omissions { subject, rows })
}

fn row(thing: &Thing, with: &Measured, without: &Measured) -> Omission {
    let work: Vec<Counted> = thing
        .of
        .iter()
        .map(|&w| Counted {
            of: w.name().into(),
            with: with.work[w as usize],
            without: without.work[w as usize],
        })
        .collect();
    Omission {
        what: thing.what.into(),
        removed: removed(with, without),
        bytes_saved: with.bytes as i64 - without.bytes as i64,
        with: with.time,
        without: without.time,
        peak_bytes_saved: with.peak_bytes as i64 - without.peak_bytes as i64,
        is_proved: work.iter().all(|w| w.with > 0 && w.without == 0),
        work,
    }
}

/// What the scene holds only with it; and, where the thing itself leaves something out, what it
/// holds only without.
fn removed(with: &Measured, without: &Measured) -> String {
    let counts: Vec<(i64, &str)> = (with.holds.iter().zip(&without.holds))
        .map(|((of, a), (_, b))| (*a as i64 - *b as i64, *of))
        .filter(|c| c.0 != 0)
        .collect();
    let words = |sign: i64| -> String {
        let of = counts.iter().filter(|c| c.0 * sign > 0);
        let words: Vec<String> =
            of.map(|(n, of)| format!("{} {of}", grouped(n.unsigned_abs()))).collect();
        words.join(", ")
    };
    match (words(1), words(-1)) {
        (more, less) if more.is_empty() && less.is_empty() => "nothing".into(),
        (more, less) if less.is_empty() => more,
        (more, less) if more.is_empty() => format!("nothing; in its place come {less}"),
        (more, less) => format!("{more}; in their place come {less}"),
    }
}

/// What a scene holds in all its forms.
fn holds(scene: &ValidScene) -> Vec<(&'static str, u64)> {
    let (mut triangles, mut wind, mut forms, mut bodies) = (0, 0, 0, 0);
    for p in scene.prototypes() {
        triangles += p.all_parts().map(|q| q.surface.triangles() as u64).sum::<u64>();
        wind += p.all_parts().map(|q| q.surface.wind.len() as u64).sum::<u64>();
        forms += 1 + p.levels.len() as u64;
        bodies += p.colliders.len() as u64;
    }
    let texels = |t: &Texture| u64::from(t.image.width()) * u64::from(t.image.height());
    vec![
        ("texture pixels", scene.textures().iter().map(texels).sum()),
        ("triangles", triangles),
        ("forms of models", forms),
        ("vertices with wind", wind),
        ("bodies for collisions", bodies),
        ("trees", scene.instances().len() as u64),
    ]
}

/// Among the trees, in the middle of the scene at the height of a person's eyes, looking north-east.
fn eye(place: &Place) -> Eye {
    const EYES_M: f32 = 1.7;
    let survey = &place.survey;
    let g = &survey.terrain.heights.geometry;
    let middle =
        Vec2::new((0.5 * (g.west + g.east())) as f32, (0.5 * (g.north + g.south())) as f32);
    let over = |p: Vec2| {
        let at = p.extend(survey.terrain.height_at(p) + EYES_M);
        survey.frame.world_from_local(at)
    };
    let corner = Vec2::new(g.east() as f32, g.north as f32);
    Eye { at: over(middle), look: over(corner), fov_deg: 40.0 }
}

/// Times that every scene is made, in full and quick.
const ROUNDS: [usize; 2] = [2, 1];

struct Run {
    seconds: f64,
    peak_bytes: u64,
    bytes: u64,
    work: [u64; Work::ALL.len()],
    holds: Vec<(&'static str, u64)>,
}

struct Measured {
    bytes: u64,
    time: Timing,
    peak_bytes: u64,
    work: [u64; Work::ALL.len()],
    holds: Vec<(&'static str, u64)>,
}

impl Measured {
    /// Of runs of one scene: work and bytes are the same in each.
    fn of(runs: &[&Run]) -> Measured {
        let last = runs[runs.len() - 1];
        let seconds: Vec<f64> = runs.iter().map(|r| r.seconds).collect();
        Measured {
            bytes: last.bytes,
            time: Timing::of(&seconds),
            peak_bytes: runs.iter().map(|r| r.peak_bytes).min().unwrap_or(0),
            work: last.work,
            holds: last.holds.clone(),
        }
    }
}

/// A forest built and written as GLB.
fn run(bench: &Bench<'_>, job: &ForestJob) -> Result<Run> {
    let before = work::done();
    let mut run = Recorder::new(&Silent);
    let forest = forest::forest(job, &mut run)?;
    let formats = [Format::Glb];
    let to = Job::new("forest", &formats);
    let bytes = run.stage("export", |_| -> Result<(u64, Outcome)> {
        let pictures = Pictures::encode(&forest.scene, &to.picture_formats())?;
        let files = export::files(&forest.scene, &pictures, &to)?.value;
        Ok((Staged::new(&bench.job.scratch)?.add(files)?, Outcome::default()))
    })?;
    let after = work::done();
    Ok(Run {
        seconds: run.seconds(),
        peak_bytes: run.peak_bytes(),
        bytes,
        work: std::array::from_fn(|k| after[k] - before[k]),
        holds: holds(&forest.scene),
    })
}
