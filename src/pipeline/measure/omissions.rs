//! What scenes do without, what that saves, and the counts that prove it.

use std::time::Instant;

use glam::DVec3;

use super::super::view::Eye;
use super::super::{ForestJob, forest, levels};
use super::Bench;
use super::place::Place;
use crate::diagnostic::Result;
use crate::export::{self, Format, Job, Pictures, Profile, Staged, WindAs};
use crate::lod;
use crate::mesh::WindProfile;
use crate::report::document::{Counted, Omission, Omissions, Timing};
use crate::report::{Outcome, Recorder, Silent};
use crate::scene::{ColliderShape, Texture, ValidScene};
use crate::work::{self, Work};

/// One thing: how it is asked for, how it is left out, whose work it is.
struct Thing {
    what: &'static str,
    of: &'static [Work],
    with: fn(&mut ForestJob, &Place),
    without: fn(&mut ForestJob),
}

const THINGS: [Thing; 7] = [
    Thing {
        what: "photo on the terrain",
        of: &[Work::PhotoSamples],
        with: |job, place| job.survey.photo.clone_from(&place.photo),
        without: |job| job.survey.photo = None,
    },
    Thing {
        what: "textures of trees (--texture 0)",
        of: &[Work::TexturePixels, Work::Tangents],
        with: |_, _| {},
        without: |job| job.texture_px = 0,
    },
    Thing {
        what: "wind",
        of: &[Work::WindNodes],
        with: |job, _| job.levels.wind = Some(WindProfile::Unity),
        without: |_| {},
    },
    Thing {
        what: "levels of detail",
        of: &[Work::CoarserForms, Work::Silhouettes],
        with: |job, _| job.levels.meshed = levels::SHARES.len(),
        without: |_| {},
    },
    Thing {
        what: "impostors",
        of: &[Work::Impostors, Work::Silhouettes],
        with: |job, _| job.levels.impostor = Some(lod::Kind::Cross),
        without: |_| {},
    },
    Thing {
        what: "colliders",
        of: &[Work::Colliders],
        with: |job, _| job.levels.collision = Some(ColliderShape::Convex),
        without: |_| {},
    },
    Thing {
        what: "choice by a camera",
        of: &[Work::TreesLookedFor, Work::CoarserForms, Work::Impostors],
        with: |job, place| job.eye = Some(eye(place)),
        without: |_| {},
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
    let base = measured(bench, &usual())?;
    let mut rows = Vec::new();
    for thing in THINGS {
        if thing.of.contains(&Work::PhotoSamples) && place.photo.is_none() {
            continue;
        }
        let (mut with, mut without) = (usual(), usual());
        (thing.with)(&mut with, place);
        (thing.without)(&mut without);
        // One of the two is as usual, unless a scan has its photo.
        let is_added =
            matches!(thing.what, "photo on the terrain" | "textures of trees (--texture 0)");
        let (with, without) = match is_added {
            true => (base.clone(), measured(bench, &without)?),
            false => (measured(bench, &with)?, base.clone()),
        };
        rows.push(row(&thing, &with, &without));
    }
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

/// What the scene holds only with it, in words; and what it holds only without it.
fn removed(with: &Measured, without: &Measured) -> String {
    let counts: Vec<(i64, &str)> = (with.holds.iter().zip(&without.holds))
        .map(|((of, a), (_, b))| (*a as i64 - *b as i64, *of))
        .filter(|c| c.0 != 0)
        .collect();
    let words = |sign: i64| -> Vec<String> {
        let of = counts.iter().filter(|c| c.0 * sign > 0);
        of.map(|(n, of)| format!("{} {of}", n.abs())).collect()
    };
    match (words(1), words(-1)) {
        (more, less) if less.is_empty() => more.join(", "),
        (more, less) if more.is_empty() => format!("nothing; it spares {}", less.join(", ")),
        (more, less) => format!("{}; it spares {}", more.join(", "), less.join(", ")),
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

/// Over the south-western corner, looking at the middle of the scene from above its trees.
fn eye(place: &Place) -> Eye {
    let survey = &place.survey;
    let g = &survey.terrain.heights.geometry;
    let z = f64::from(survey.terrain.height_at(glam::Vec2::new(g.west as f32, g.south() as f32)));
    let world = |x: f64, y: f64, z: f64| {
        survey.frame.world_from_local(glam::Vec3::new(x as f32, y as f32, z as f32))
    };
    let (x, y) = (0.5 * (g.west + g.east()), 0.5 * (g.north + g.south()));
    let at: DVec3 = world(g.west, g.south(), z + 20.0);
    Eye { at, look: world(x, y, z + 5.0), fov_deg: 40.0 }
}

#[derive(Clone)]
struct Measured {
    bytes: u64,
    time: Timing,
    peak_bytes: u64,
    work: [u64; Work::ALL.len()],
    holds: Vec<(&'static str, u64)>,
}

/// A forest built and written as GLB.
fn measured(bench: &Bench<'_>, job: &ForestJob) -> Result<Measured> {
    let (mut seconds, mut peaks, mut last) = (Vec::new(), Vec::new(), None);
    let start = Instant::now();
    while last.is_none()
        || seconds.len() < super::repeats(bench.job.is_quick, start.elapsed().as_secs_f64())
    {
        let before = work::done();
        let mut run = Recorder::new(&Silent);
        let forest = forest::forest(job, &mut run)?;
        let formats = [Format::Glb];
        let (profile, wind) = (Profile::Dcc, WindAs::Attribute);
        let to = Job { stem: "forest", formats: &formats, profile, wind };
        let bytes = run.stage("export", |_| -> Result<(u64, Outcome)> {
            let pictures = Pictures::encode(&forest.scene, &to.picture_formats())?;
            let files = export::files(&forest.scene, &pictures, &to)?.value;
            Ok((Staged::new(&bench.job.scratch)?.add(files)?, Outcome::default()))
        })?;
        seconds.push(run.seconds());
        peaks.push(run.peak_bytes() as f64);
        let after = work::done();
        last = Some(Measured {
            bytes,
            time: Timing::of(&seconds),
            peak_bytes: crate::report::stats::spread(&peaks).map_or(0, |s| s.median as u64),
            work: std::array::from_fn(|k| after[k] - before[k]),
            holds: holds(&forest.scene),
        });
    }
    last.ok_or_else(|| crate::diagnostic::Error::new("nothing was measured"))
}
