//! Files: bytes, seconds to write and what rounding costs, over format and profile.

use super::super::forest;
use super::Bench;
use crate::diagnostic::Result;
use crate::export::{self, Format, Job, Pictures, Profile, Staged};
use crate::report::document::{Front, Point, Quantity, Truth};
use crate::report::{Recorder, Silent};

const FILES: [(&str, Format, Profile); 9] = [
    ("GLB dcc", Format::Glb, Profile::Dcc),
    ("GLB engine", Format::Glb, Profile::Engine),
    ("GLB web", Format::Glb, Profile::Web),
    ("USD crate", Format::Usdc, Profile::Dcc),
    ("USD package", Format::Usdz, Profile::Dcc),
    ("USD text", Format::Usda, Profile::Dcc),
    ("X3D", Format::X3d, Profile::Dcc),
    ("X3D compact", Format::X3d, Profile::Web),
    ("OBJ", Format::Obj, Profile::Dcc),
];

/// Written of the forest of the place; OBJ of the quick one alone, as it writes every tree out.
pub(super) fn fronts(bench: &mut Bench<'_>) -> Result<Vec<Front>> {
    let bench = &*bench;
    let mut job = bench.place.forest_job(bench.job);
    if bench.job.is_quick {
        (job.texture_px, job.triangles) = (128, 1_000);
    }
    let scene = forest::forest(&job, &mut Recorder::new(&Silent))?.scene;
    let (mut sizes, mut shifts) = (Vec::new(), Vec::new());
    for (name, format, profile) in FILES {
        let formats = [format];
        let job = Job { profile, ..Job::new("forest", &formats) };
        let write = |()| {
            let pictures = Pictures::encode(&scene, &job.picture_formats())?;
            let files = export::files(&scene, &pictures, &job)?;
            // Never put in its place: removed when dropped.
            Staged::new(&bench.job.scratch)?.add(files.value)
        };
        let (bytes, time) = bench.timed(|| (), write)?;
        let point = |error: f64, cost: Option<f64>| Point {
            group: name.split(' ').next().unwrap_or_default().into(),
            setting: name.into(),
            error,
            cost,
            time,
            is_default: format == Format::Glb && profile == Profile::Dcc,
            is_on_front: false,
        };
        let shift_mm = 1e3 * f64::from(export::worst_shift_m(&scene, format, profile));
        sizes.push(point(bytes as f64 * 1e-6, None));
        shifts.push(point(shift_mm, Some(bytes as f64 * 1e-6)));
    }
    let sizes = Front {
        id: "files".into(),
        stage: "export".into(),
        title: "Files: size and seconds to write".into(),
        error: Quantity::new("size", "MB"),
        truth: Truth::Counted,
        cost: None,
        note:
            "Pictures coded anew each time, written to the disk and flushed. OBJ writes every tree \
               out."
                .into(),
        is_by_group: false,
        points: sizes,
        verdict: String::new(),
    };
    let shifts = Front {
        id: "rounding".into(),
        stage: "export".into(),
        title: "Files: rounding and size".into(),
        error: Quantity::new("worst shift of a vertex", "mm"),
        truth: Truth::Exact,
        cost: Some(Quantity::new("size", "MB")),
        note:
            "Along an axis. 0 where the numbers of the file read back as the same f32. The engine \
               profile rounds directions and texture coordinates, not positions."
                .into(),
        is_by_group: false,
        points: shifts,
        verdict: String::new(),
    };
    Ok(vec![sizes.marked(), shifts.marked()])
}
