//! Terrain error against seconds, over the method of the ground and the cell.

use super::Bench;
use crate::diagnostic::Result;
use crate::ground::{self, Classified, Method};
use crate::report::document::{Front, Point, Quantity, Timing, Truth};
use crate::terrain::{self, TerrainOptions};

const METHODS: [(&str, Method); 4] = [
    ("smrf", Method::Smrf),
    ("tin", Method::Tin),
    ("voxel", Method::VoxelRules),
    ("file", Method::FileClasses),
];
const CELLS_M: [f32; 5] = [0.25, 0.5, 1.0, 2.0, 4.0];
const FILE_GROUND: u8 = 2;

pub(super) fn front(bench: &mut Bench<'_>) -> Result<Front> {
    let place = &bench.place;
    let mut points = Vec::new();
    for (name, method) in METHODS {
        if method == Method::FileClasses && !place.cloud.class.contains(&FILE_GROUND) {
            continue;
        }
        let work = |cloud| Ok(ground::classify(cloud, method)?.into_value(&mut Vec::new()));
        let (classified, ground) = bench.timed(|| place.cloud.clone(), work)?;
        for cell_m in CELLS_M {
            points.extend(point(bench, name, &classified, cell_m, ground)?);
        }
    }
    let (truth, note) = match place.stand {
        Some(_) => {
            (Truth::Simulated, "Seconds are those of finding the ground and of making the grid.")
        }
        None => (
            Truth::HeldOut,
            "Held out are points that the method itself takes for ground: one that leaves out what is hard \
             has less to be wrong about, so each has a front of its own. Seconds are those of finding the \
             ground and of making the grid.",
        ),
    };
    Ok(Front {
        id: "terrain".into(),
        stage: "terrain".into(),
        title: "Terrain: cell and method".into(),
        error: Quantity::new("terrain RMSE", "m"),
        truth,
        cost: None,
        note: note.into(),
        is_by_group: place.stand.is_none(),
        points,
        verdict: String::new(),
    }
    .marked())
}

/// `None` where no point can be held out.
fn point(
    bench: &Bench<'_>,
    name: &str,
    classified: &Classified,
    cell_m: f32,
    ground: Timing,
) -> Result<Option<Point>> {
    let options = TerrainOptions { cell_m: Some(cell_m), ..TerrainOptions::default() };
    let work = |()| Ok(terrain::build(classified, &options)?.into_value(&mut Vec::new()));
    let (terrain, time) = bench.timed(|| (), work)?;
    let frame = &classified.cloud.frame;
    let error = match bench.place.truth_of(&terrain, frame, &[]) {
        Some(truth) => truth.terrain.rmse_m,
        None => match terrain::held_out_error(classified, &options)? {
            Some(held_out) => held_out.rmse_m,
            None => return Ok(None),
        },
    };
    let usual = bench.place.survey.terrain.heights.geometry.cell_x;
    Ok(Some(Point {
        group: name.into(),
        setting: format!("{name}, cell {cell_m} m"),
        error,
        cost: None,
        time: sum(ground, time),
        is_default: name == METHODS[0].0 && (usual - f64::from(cell_m)).abs() < 1e-6,
        is_on_front: false,
    }))
}

/// Of two tasks one after the other, each run so often by itself: `runs` of the more often run, as its
/// spread is in the sum.
pub(super) fn sum(a: Timing, b: Timing) -> Timing {
    Timing {
        median_s: a.median_s + b.median_s,
        least_s: a.least_s + b.least_s,
        most_s: a.most_s + b.most_s,
        runs: a.runs.max(b.runs),
    }
}
