//! The table of levels: what each form of each model has and how far its silhouette is off; and warnings of
//! forms that a viewer should not show.

use super::levels::IMPOSTOR;
use super::model;
use crate::report::{ErrorMeasure, Outcome};
use crate::scene::{Part, Scene};

/// The last mesh that a model may have.
const PLAINEST: &str = "LOD4";

/// What is told of one form of one model.
#[derive(Debug, Clone, serde::Serialize)]
pub struct Row {
    pub model: String,
    pub level: String,
    pub triangles: usize,
    /// Of these, leaves and needles, or what stands for them and for twigs.
    pub leaf_triangles: usize,
    /// Farthest that its silhouette is from the finest form's; 0 for that itself.
    pub silhouette_worst_m: f32,
    pub silhouette_rms_m: f32,
}

/// All forms of all models, for the report.
pub fn rows(scene: &Scene) -> Vec<Row> {
    let count = |parts: &[Part]| parts.iter().map(|p| p.surface.triangles()).sum();
    let leaves =
        |part: &Part| if part.name == model::FOLIAGE { part.surface.triangles() } else { 0 };
    let mut rows = Vec::new();
    for p in scene.prototypes.iter().filter(|p| !p.levels.is_empty()) {
        rows.push(Row {
            model: p.name.clone(),
            level: "LOD0".into(),
            triangles: count(&p.parts),
            leaf_triangles: p.parts.iter().map(leaves).sum(),
            silhouette_worst_m: 0.0,
            silhouette_rms_m: 0.0,
        });
        rows.extend(p.levels.iter().map(|l| Row {
            model: p.name.clone(),
            level: l.name.clone(),
            triangles: count(&l.parts),
            leaf_triangles: l.parts.iter().map(leaves).sum(),
            silhouette_worst_m: l.silhouette.worst_m,
            silhouette_rms_m: l.silhouette.rms_m,
        }));
    }
    rows
}

/// The outcome of the stage that made these forms: the worst error of any. Warns of forms that a viewer should not
/// show: farther from the finest than a coarser one, of no fewer triangles than a finer one, or without leaves.
pub fn outcome(rows: &[Row], models: usize, warnings: &mut Vec<String>) -> Outcome {
    warn(rows, overtaken, "a coarser form is much nearer to the finest than", warnings);
    warn(rows, as_heavy, "no triangles are saved by", warnings);
    warn(rows, leafless, "no triangles are left for leaves and twigs in", warnings);
    let worst = rows.iter().map(|r| r.silhouette_worst_m).fold(0.0, f32::max);
    Outcome::items(models, "models", rows.len(), "forms").error(ErrorMeasure::new(
        "worst silhouette",
        worst.into(),
        "m",
    ))
}

/// Names the forms of the first model that has `faulty` ones, and says how many models more have.
fn warn(rows: &[Row], faulty: fn(&[Row]) -> Vec<&Row>, fault: &str, warnings: &mut Vec<String>) {
    let models = rows.chunk_by(|a, b| a.model == b.model);
    let mut found = models.map(faulty).filter(|of| !of.is_empty());
    let Some(first) = found.next() else { return };
    let names: Vec<&str> = first.iter().map(|r| &r.level[..]).collect();
    let others = match found.count() {
        0 => String::new(),
        n => format!(", and so it is with {n} more"),
    };
    warnings.push(format!(
        "{}: {fault} {}{others}; give more --triangles, or fewer --lods",
        first[0].model,
        names.join(", "),
    ));
}

/// The meshes of a model from fine to coarse.
fn meshed(of: &[Row]) -> impl Iterator<Item = &Row> + Clone {
    of.iter().filter(|row| row.level != IMPOSTOR)
}

/// Those without leaves, where another has any.
fn leafless(of: &[Row]) -> Vec<&Row> {
    let is_leafy = meshed(of).any(|row| row.leaf_triangles > 0);
    meshed(of).skip(1).filter(|row| is_leafy && row.leaf_triangles == 0).collect()
}

/// Those with as many triangles as the one before.
fn as_heavy(of: &[Row]) -> Vec<&Row> {
    let pairs = meshed(of).zip(meshed(of).skip(1));
    pairs.filter(|(finer, row)| row.triangles >= finer.triangles).map(|(_, row)| row).collect()
}

/// Those that are much farther from the finest than a coarser one, and at no place nearer. An impostor is a
/// picture, and nearer than the plain shapes of [`PLAINEST`] as a rule.
fn overtaken(of: &[Row]) -> Vec<&Row> {
    const MUCH: f32 = 0.8;
    let is_nearer = |coarser: &Row, row: &Row| {
        coarser.silhouette_worst_m <= row.silhouette_worst_m
            && coarser.silhouette_rms_m < MUCH * row.silhouette_rms_m
    };
    let impostor = of.iter().find(|row| row.level == IMPOSTOR);
    let is_overtaken = |(k, row): (usize, &Row)| {
        let mut coarser = meshed(of).skip(k + 1);
        coarser.any(|coarser| is_nearer(coarser, row))
            || row.level != PLAINEST && impostor.is_some_and(|impostor| is_nearer(impostor, row))
    };
    meshed(of).enumerate().filter(|&of| is_overtaken(of)).map(|(_, row)| row).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn forms_that_no_viewer_shows_are_told() {
        let row = |model: &str, level: &str, worst: f32, rms: f32| Row {
            model: model.into(),
            level: level.into(),
            triangles: 1000 - (level.as_bytes()[3] as usize),
            leaf_triangles: 0,
            silhouette_worst_m: worst,
            silhouette_rms_m: rms,
        };
        let sound = [
            row("oak_02", "LOD0", 0.0, 0.0),
            row("oak_02", "LOD1", 1.0, 0.1),
            row("oak_02", "LOD2", 0.9, 0.2),
            row("oak_02", "LOD4", 3.2, 0.7),
            row("oak_02", IMPOSTOR, 1.1, 0.21),
        ];
        let mut told = Vec::new();
        outcome(&sound, 1, &mut told);
        assert!(told.is_empty(), "{told:?}");
        let rows = [
            row("oak_01", "LOD0", 0.0, 0.0),
            row("oak_01", "LOD1", 4.0, 0.7),
            row("oak_01", "LOD2", 7.6, 1.8),
            row("oak_01", "LOD3", 8.7, 3.1),
            row("oak_01", "LOD4", 3.2, 0.7),
        ];
        let pictured = [&sound[..4], &[row("oak_02", IMPOSTOR, 0.9, 0.1)]].concat();
        outcome(&pictured, 1, &mut told);
        assert!(told.pop().is_some_and(|t| t.starts_with("oak_02") && t.contains("than LOD2;")));
        outcome(&[&rows[..], &sound].concat(), 2, &mut told);
        assert_eq!(
            told,
            [
                "oak_01: a coarser form is much nearer to the finest than LOD2, LOD3; give more --triangles, \
              or fewer --lods"
            ]
        );
    }

    #[test]
    fn forms_that_have_lost_their_leaves_are_told() {
        let row = |level: &str, leaf_triangles: usize| Row {
            model: "rowan_01".into(),
            level: level.into(),
            triangles: 1000 - (level.as_bytes()[3] as usize),
            leaf_triangles,
            silhouette_worst_m: 1.0,
            silhouette_rms_m: 0.1,
        };
        let told = |leaves: [usize; 4]| {
            let levels = ["LOD0", "LOD1", "LOD2", IMPOSTOR];
            let rows: Vec<Row> = levels.into_iter().zip(leaves).map(|(l, n)| row(l, n)).collect();
            let mut told = Vec::new();
            outcome(&rows, 1, &mut told);
            told
        };
        assert_eq!(told([50, 20, 8, 0]), [""; 0]);
        assert_eq!(told([0; 4]), [""; 0], "a bare tree");
        let lost = "rowan_01: no triangles are left for leaves and twigs in LOD2; give more \
                    --triangles, or fewer --lods";
        assert_eq!(told([50, 20, 0, 0]), [lost]);
        // Twigs of the finest that are stored once are in none of its parts.
        assert_eq!(told([0, 20, 0, 0]), [lost]);
    }

    #[test]
    fn forms_that_save_nothing_are_told() {
        let row = |(k, triangles): (usize, usize)| Row {
            model: "larch_01".into(),
            level: if k == 4 { IMPOSTOR.into() } else { format!("LOD{k}") },
            triangles,
            leaf_triangles: 1,
            silhouette_worst_m: k as f32,
            silhouette_rms_m: k as f32,
        };
        let told = |triangles: [usize; 5]| {
            let rows: Vec<Row> = triangles.into_iter().enumerate().map(row).collect();
            let mut told = Vec::new();
            outcome(&rows, 1, &mut told);
            told
        };
        assert_eq!(told([200, 70, 40, 39, 80]), [""; 0]);
        let saves_none = "larch_01: no triangles are saved by LOD2, LOD3; give more --triangles, or \
                          fewer --lods";
        assert_eq!(told([200, 70, 70, 80, 4]), [saves_none]);
    }
}
