//! Crowns found and their heights, against seconds, over the effort.

use super::super::Effort;
use super::Bench;
use crate::crown::{self, Crown, CrownOptions};
use crate::diagnostic::Result;
use crate::ground::{self, Classified, Method};
use crate::report::document::{Front, Point, Quantity, Timing, Truth};
use crate::terrain::{self, Terrain, TerrainOptions};
use crate::voxel;

/// Lower trees are not looked for, metres.
const LEAST_HEIGHT_M: f32 = 2.0;
/// Two crowns of halves of a scan may be the same tree so far apart, metres, and if the lower one is
/// of this share of the other's height.
const REACH_M: f32 = 2.0;
const AS_HIGH: f32 = 0.75;

struct Setting {
    name: String,
    is_default: bool,
    terrain: TerrainOptions,
    crown: CrownOptions,
}

fn settings() -> Vec<Setting> {
    let efforts = Effort::ALL.map(|(name, effort)| Setting {
        name: format!("effort {name}"),
        is_default: effort == Effort::default(),
        terrain: effort.terrain(None),
        crown: effort.crown(LEAST_HEIGHT_M),
    });
    let usual = || Effort::Normal.crown(LEAST_HEIGHT_M);
    let cells = [0.25, 0.5, 1.0].map(|cell_m| Setting {
        name: format!("canopy cell {cell_m} m"),
        is_default: false,
        terrain: Effort::Normal.terrain(None),
        crown: CrownOptions { cell_m: Some(cell_m), ..usual() },
    });
    efforts.into_iter().chain(cells).collect()
}

pub(super) fn fronts(bench: &mut Bench<'_>) -> Result<Vec<Front>> {
    let halves = match bench.place.stand {
        Some(_) => None,
        None => Some([half(bench, 0)?, half(bench, 1)?]),
    };
    // Of a half it would be wider.
    let usual_cell_m = crown::usual_cell_m(&bench.place.classified.cloud.position);
    let (mut missed, mut heights) = (Vec::new(), Vec::new());
    let is_bare = bench.place.stand.is_none() && bench.place.survey.trees.is_empty();
    for mut s in settings().into_iter().filter(|_| !is_bare) {
        s.crown.cell_m.get_or_insert(usual_cell_m);
        let (found, time) = bench.timed(|| (), |()| find(&bench.place.classified, &s, bench))?;
        let (f1, rmse_m) = match &halves {
            None => {
                let frame = &bench.place.classified.cloud.frame;
                let Some(truth) = bench.place.truth_of(&found.0, frame, &found.1) else { continue };
                (truth.f1, truth.height.rmse_m)
            }
            Some([a, b]) => agreement(&find(a, &s, bench)?.1, &find(b, &s, bench)?.1),
        };
        missed.push(point(&s, 100.0 * (1.0 - f1), time));
        // Where no tree is found twice there is none whose height could be right.
        heights.extend((f1 > 0.0).then(|| point(&s, rmse_m, time)));
    }
    let truth = if halves.is_some() { Truth::Halves } else { Truth::Simulated };
    let how = match truth {
        Truth::Halves => {
            "Trees found in one half of the points beside those found in the other half: how far the \
             setting agrees with itself at half the density, which is not how right it is. Cells and seconds are those \
             of the whole scan."
        }
        _ => "Seconds are of terrain and crowns.",
    };
    let front = |id: &str, title: &str, error: Quantity, what: &str, points| Front {
        id: id.into(),
        stage: "crown".into(),
        title: title.into(),
        error,
        truth,
        cost: None,
        note: format!("{what} {how}"),
        is_by_group: false,
        points,
        verdict: String::new(),
    };
    let f1 = (Quantity::new("1 − F1", "%"), "Missed and invented trees.");
    let height = (Quantity::new("height RMSE", "m"), "Of the trees that were found.");
    Ok(vec![
        front("crowns", "Crowns: trees found", f1.0, f1.1, missed).marked(),
        front("heights", "Crowns: heights", height.0, height.1, heights).marked(),
    ])
}

fn point(s: &Setting, error: f64, time: Timing) -> Point {
    Point {
        group: s.name.split(' ').next().unwrap_or_default().into(),
        setting: s.name.clone(),
        error,
        cost: None,
        time,
        is_default: s.is_default,
        is_on_front: false,
    }
}

fn find(classified: &Classified, s: &Setting, bench: &Bench<'_>) -> Result<(Terrain, Vec<Crown>)> {
    let terrain = terrain::build(classified, &s.terrain)?.into_value(&mut Vec::new());
    let voxel_m = voxel::choose_size_m(bench.place.density_per_m2, 4.0);
    let crowns = crown::detect(classified, &terrain, voxel_m, &s.crown)?;
    Ok((terrain, crowns.into_value(&mut Vec::new())))
}

/// Every other point of the scan.
fn half(bench: &Bench<'_>, which: usize) -> Result<Classified> {
    let mut cloud = bench.place.cloud.clone();
    cloud.retain(|i| i % 2 == which);
    Ok(ground::classify(cloud, Method::Smrf)?.into_value(&mut Vec::new()))
}

/// F1 of two sets of crowns, matched from the nearest on, and the RMSE of their heights.
fn agreement(a: &[Crown], b: &[Crown]) -> (f64, f64) {
    let mut pairs: Vec<(f32, usize, usize)> = Vec::new();
    for (i, p) in a.iter().enumerate() {
        let is_like = |q: &Crown| {
            p.height_m.min(q.height_m) >= AS_HIGH * p.height_m.max(q.height_m)
                && p.root.distance(q.root) <= REACH_M
        };
        let near = b.iter().enumerate().filter(|(_, q)| is_like(q));
        pairs.extend(near.map(|(j, q)| (p.root.distance(q.root), i, j)));
    }
    pairs.sort_by(|p, q| p.0.total_cmp(&q.0).then(p.1.cmp(&q.1)).then(p.2.cmp(&q.2)));
    let (mut used, mut off_sq) = ([vec![false; a.len()], vec![false; b.len()]], Vec::new());
    for (_, i, j) in pairs {
        if !used[0][i] && !used[1][j] {
            (used[0][i], used[1][j]) = (true, true);
            off_sq.push(f64::from(a[i].height_m - b[j].height_m).powi(2));
        }
    }
    let matched = off_sq.len() as f64;
    let rmse_m = (off_sq.iter().sum::<f64>() / matched.max(1.0)).sqrt();
    (2.0 * matched / ((a.len() + b.len()) as f64).max(1.0), rmse_m)
}
