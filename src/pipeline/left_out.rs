//! What a scene did without, and what that saved.
//!
//! Bytes are those the files would hold more, numbers uncompressed and pictures as PNG. Seconds are at this
//! run's own rates: of writing, for bytes; of meshing, for forms that were not made. They are the least: what
//! was never made has no measured time, and what a level covers is looked at many times until it is right.
//! Packing a light map has no rate of a run's own: it takes much longer than anything that was done.

use super::levels::{LevelsJob, SHARES, triangles_of};
use super::view::Chosen;
use crate::mesh::{FoliageLevel, Surface, lightmap};
use crate::report::StageRecord;
use crate::scene::{LeftOut, ValidScene};

/// A line of the table.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct Saved {
    pub what: String,
    pub count: u64,
    pub of: &'static str,
    pub bytes: u64,
    pub seconds: f64,
    /// That it took at least to find out what is not needed.
    pub cost_seconds: f64,
}

/// What decides what is left out.
pub struct Told<'a> {
    pub scene: &'a ValidScene,
    pub levels: &'a LevelsJob,
    pub foliage: FoliageLevel,
    /// Whether a coarser form is a file of its own that holds its pictures.
    pub repeats_pictures: bool,
    /// Whether forms were made for a camera to choose among.
    pub has_forms: bool,
    pub pruned: LeftOut,
    pub clipped: usize,
    pub chosen: Option<&'a Chosen>,
    pub stages: &'a [StageRecord],
}

/// Bytes of an attribute of a vertex.
const TANGENT: u64 = 16;
const WIND: u64 = 4;
const UV: u64 = 8;
const INDEX: u64 = 4;
/// Of places on a light map, with the vertices that charts part: bytes a vertex, and seconds a triangle. The
/// least of what trees of 5,000 and 20,000 triangles take.
const LIGHTMAP: u64 = 10;
const PACKING_S: f64 = 5e-5;
/// Of a tree in its place: name, matrix and facts as JSON.
const PLACE: u64 = 370;

/// The lines that say something.
pub fn table(told: &Told<'_>) -> Vec<Saved> {
    let seconds = |stage: &str| -> f64 {
        told.stages.iter().filter(|s| s.stage == stage).map(|s| s.seconds).sum()
    };
    let vertices = |of: &dyn Fn(&crate::scene::Part) -> bool| -> u64 {
        let parts = told.scene.parts().filter(|p| of(p));
        parts.map(|p| p.surface.position.len() as u64).sum()
    };
    let geometry: u64 = told.scene.parts().map(|p| p.surface.bytes()).sum();
    let pictures = crate::scene::statistics(told.scene).texture_bytes;
    let per_byte = seconds("export") / (geometry + pictures).max(1) as f64;
    let mut lines = Vec::new();
    let mut line = |what: &str, count: u64, of, bytes: u64, more_s: f64| {
        if count > 0 {
            let seconds = bytes as f64 * per_byte + more_s;
            let what = what.to_owned();
            lines.push(Saved { what, count, of, bytes, seconds, cost_seconds: 0.0 });
        }
    };
    let flat = |p: &crate::scene::Part| {
        told.scene.materials()[p.material as usize].normal_texture.is_none()
    };
    let count = vertices(&flat);
    line("tangents where no normal map needs them", count, "vertices", count * TANGENT, 0.0);
    let plain =
        |p: &crate::scene::Part| !told.scene.materials()[p.material as usize].has_textures();
    let count = vertices(&plain);
    line("texture coordinates of what no texture covers", count, "vertices", count * UV, 0.0);
    let still = |p: &crate::scene::Part| p.surface.wind.is_empty() && p.name != "terrain";
    let count = vertices(&still);
    line("vertex colours of wind", count, "vertices", count * WIND, 0.0);
    // Of models that may have one.
    let sums = |parts: &[crate::scene::Part]| {
        let surfaces = || parts.iter().map(|p| &p.surface);
        let is_unlit = surfaces().all(|s| s.lightmap_uv.is_empty());
        let vertices: usize = surfaces().map(|s| s.position.len()).sum();
        let triangles: usize = surfaces().map(Surface::triangles).sum();
        (is_unlit && triangles <= lightmap::MOST_TRIANGLES).then_some((vertices, triangles))
    };
    let unlit = told.scene.prototypes().iter().filter(|m| m.scattered.is_empty());
    let unlit = unlit.filter_map(|m| sums(&m.parts));
    let (count, packed) = unlit.fold((0, 0), |sum, more| (sum.0 + more.0, sum.1 + more.1));
    let (count, packing_s) = (count as u64, packed as f64 * PACKING_S);
    line("places on a light map", count, "vertices", count * LIGHTMAP, packing_s);
    let made = if told.has_forms { SHARES.len() } else { told.levels.meshed.min(SHARES.len()) };
    let models = told.scene.prototypes();
    let forms = (models.len() * (SHARES.len() - made)) as u64;
    let bytes: f64 = (models.iter())
        .map(|model| {
            let surfaces = || model.parts.iter().map(|p| &p.surface);
            let triangles = surfaces().map(Surface::triangles).sum();
            let bytes: u64 = surfaces().map(Surface::bytes).sum();
            let more = (made..SHARES.len()).map(|k| triangles_of(triangles, told.foliage, k));
            bytes as f64 * more.sum::<usize>() as f64 / triangles.max(1) as f64
        })
        .sum();
    let meshing_s = seconds("mesh") * bytes / geometry.max(1) as f64;
    let pngs = told.scene.textures().iter().filter_map(|texture| texture.image.png().ok());
    let pngs = if told.repeats_pictures { pngs.map(|png| png.len() as u64).sum() } else { 0 };
    let again = pngs * (SHARES.len() - made) as u64;
    line("coarser levels", forms, "meshes", bytes as u64 + again, meshing_s);
    let p = told.pruned;
    line(
        "triangles without area",
        p.triangles as u64,
        "triangles",
        3 * INDEX * p.triangles as u64,
        0.0,
    );
    line("textures no material uses", p.textures as u64, "textures", p.texture_bytes, 0.0);
    // With as many models to the trees as there are, at the time that those took.
    let (trees, clipped) = (told.scene.instances().len() as u64, told.clipped as u64);
    let more = clipped as f64 / trees.max(1) as f64;
    let trees_s = ["skeleton", "tolerance", "mesh", "levels"].map(seconds).iter().sum::<f64>();
    let models: u64 =
        told.scene.prototypes().iter().flat_map(|p| &p.parts).map(|p| p.surface.bytes()).sum();
    let bytes = clipped * PLACE + (models as f64 * more) as u64;
    line("trees outside the box", clipped, "trees", bytes, trees_s * more);
    if let Some(chosen) = told.chosen {
        let shown: usize = chosen.shown.values().sum();
        let all = (shown + chosen.outside + chosen.hidden) as u64;
        let spared = chosen.triangles_before.saturating_sub(chosen.triangles) as u64;
        let unseen = all - shown as u64;
        line("trees the camera does not see", unseen, "trees", unseen * PLACE, 0.0);
        let bytes = chosen.spared_bytes;
        let what = match chosen.off_px {
            more if more > 1.0 => format!("triangles in place, off by up to {more:.1} pixels"),
            _ => "triangles in place the camera can't tell".to_owned(),
        };
        line(&what, spared, "triangles", bytes, 0.0);
        // Forms were made to choose among.
        if let Some(line) = lines.last_mut().filter(|_| spared > 0) {
            line.cost_seconds = ["camera", "levels", "choice"].map(seconds).iter().sum();
        }
    }
    lines
}

/// Time, to two digits at least; nothing where none was measured.
fn spared(seconds: f64) -> String {
    match seconds {
        s if s >= 0.1 => format!(", {s:.2} s"),
        s if s > 0.0 => format!(", {:.2} ms", 1e3 * s),
        _ => String::new(),
    }
}

/// For people.
pub fn lines(table: &[Saved]) -> Vec<String> {
    let line = |s: &Saved| {
        let saved = match s.bytes {
            0 => String::new(),
            b => format!(": {:.1} MB{}", b as f64 / 1e6, spared(s.seconds)),
        };
        let cost = match s.cost_seconds {
            s if s > 0.0 => format!("; to find them took {s:.2} s"),
            _ => String::new(),
        };
        format!("left out: {}, {} {}{saved}{cost}", s.what, s.count, s.of)
    };
    table.iter().map(line).collect()
}
