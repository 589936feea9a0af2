//! Scenes too large for one GLB, whose lengths have 32 bits: a file a square of ground with the models
//! that its trees need, and one of the terrain. All share the scene's origin.
//!
//! The side is the largest power of two, in metres, at which every file fits; coarser forms are cut
//! alike, so that a square's forms belong together. Files are built to be measured, and again when
//! they are written: no more than one is held. Limits: models and pictures that squares share stand
//! in the file of each; neither the terrain nor a tree is cut.

use super::super::{Content, OutputFile, Pictures};
use super::{Binary, Recipe, Square};
use crate::diagnostic::{Error, Result, Warned};
use crate::scene::Selection;

/// Sides at which one gives up.
const LEAST_SIDE_M: f32 = 1.0;
/// So many times the bytes of the wholes are too many.
const MOST_REPEATED: u64 = 10;

/// A file of the set.
struct Part<'a> {
    selection: Selection<'a>,
    square: Option<Square>,
    /// Of its name: `_x0_y1`, `_x0_y1_LOD1`, `_terrain`.
    suffix: String,
    bytes: u64,
}

/// Files of a scene in these forms, by the suffixes of their names, of which one would be of so many bytes.
///
/// # Errors
/// Terrain, or trees that stand together, too large for a GLB; models that would be repeated too
/// often; compression's.
pub(super) fn files<'a>(
    forms: &[(String, Selection<'a>)],
    (large, large_bytes): (&str, u64),
    pictures: &'a Pictures,
    recipe: Recipe<'a>,
) -> Result<Warned<Vec<OutputFile<'a>>>> {
    let Recipe { stem, most_bytes, .. } = recipe;
    let measure = |part: &Part<'a>| {
        Binary::of(&part.selection, pictures, &recipe, part.square).map(|b| b.bytes())
    };
    let mut parts = Vec::new();
    if let Some(selection) = forms.iter().find_map(|(_, whole)| whole.terrain_alone()) {
        let suffix = "_terrain".to_owned();
        let mut part = Part { selection, square: None, suffix, bytes: 0 };
        part.bytes = measure(&part)?;
        if part.bytes > most_bytes {
            return Err(too_large("the terrain needs", part.bytes, &recipe).remedy(
                "ask for a coarser one (--terrain-error), or write --format gltf or usdc",
            ));
        }
        parts.push(part);
    }
    let terrains = parts.len();
    let mut side_m = first_side_m(forms);
    loop {
        parts.truncate(terrains);
        squares(forms, side_m, &mut parts);
        // What does not fit is most likely where most trees are.
        let mut order: Vec<usize> = (terrains..parts.len()).collect();
        order.sort_by_key(|&k| std::cmp::Reverse(parts[k].selection.trees.len()));
        let mut crowded = None;
        for k in order {
            parts[k].bytes = measure(&parts[k])?;
            if parts[k].bytes > most_bytes {
                crowded = Some((parts[k].bytes, parts[k].selection.trees.len()));
                break;
            }
        }
        let Some((bytes, trees)) = crowded else { break };
        if trees < 2 || side_m <= LEAST_SIDE_M {
            let who = if trees < 2 { "a single tree needs" } else { "trees in one place need" };
            return Err(too_large(who, bytes, &recipe)
                .remedy("ask for fewer triangles (--triangles), or write --format gltf or usdc"));
        }
        side_m *= 0.5;
    }
    let all_bytes: u64 = parts.iter().map(|p| p.bytes).sum();
    if all_bytes > MOST_REPEATED.saturating_mul(large_bytes * forms.len() as u64) {
        let what = format!("{} files would repeat its models, and take", parts.len());
        return Err(too_large(&what, all_bytes, &recipe).remedy(
            "ask for fewer triangles (--triangles) or models (--unique), or write --format gltf or usdc",
        ));
    }
    let terrain = if terrains > 0 { " and one of the terrain" } else { "" };
    let warning = format!(
        "{stem}{large}.glb would be {}, more than a GLB may be ({}): split by place into {} files of {} together, by \
         squares of {side_m} m ({stem}_x0_y0.glb and so on){terrain}; all have one origin",
        amount(large_bytes),
        amount(most_bytes),
        parts.len(),
        amount(all_bytes),
    );
    let files = parts.into_iter().map(|part| OutputFile {
        path: format!("{stem}{}.glb", part.suffix).into(),
        content: Content::stream(move |sink| {
            let built = Binary::of(&part.selection, pictures, &recipe, part.square);
            built.map_err(|e| std::io::Error::other(e.to_string()))?.write(sink)
        }),
    });
    Ok(Warned::with(files.collect(), vec![warning]))
}

/// Adds the files of every form, square by square.
fn squares<'a>(forms: &[(String, Selection<'a>)], side_m: f32, parts: &mut Vec<Part<'a>>) {
    let first = parts.len();
    for (form, whole) in forms {
        let squares = whole.squares(side_m);
        // All forms are of the same trees.
        let least = squares.keys().copied().reduce(|a, b| [a[0].min(b[0]), a[1].min(b[1])]);
        let least = least.unwrap_or_default();
        for (at, selection) in squares {
            let [x, y] = [0, 1].map(|k| at[k].saturating_sub(least[k]));
            let square = Square { at: [x, y], side_m, corner: at.map(|c| c as f32 * side_m) };
            let suffix = format!("_x{x}_y{y}{form}");
            parts.push(Part { selection, square: Some(square), suffix, bytes: 0 });
        }
    }
    // A square's forms beside each other.
    parts[first..].sort_by_key(|p| p.square.map(|s| [s.at[1], s.at[0]]));
}

/// A power of two that is no less than the forest's extent.
fn first_side_m(forms: &[(String, Selection<'_>)]) -> f32 {
    let places = forms.iter().flat_map(|(_, whole)| &whole.trees);
    let places = places.map(|t| t.instance.position.truncate());
    let ends = places.map(|p| (p, p)).reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)));
    let extent_m = ends.map_or(0.0, |(lo, hi)| (hi - lo).max_element());
    extent_m.max(LEAST_SIDE_M).log2().ceil().exp2()
}

fn too_large(who: &str, bytes: u64, recipe: &Recipe<'_>) -> Error {
    let Recipe { stem, most_bytes, .. } = *recipe;
    let (bytes, most) = (amount(bytes), amount(most_bytes));
    Error::new(format!("{who} {bytes}, and a GLB may be {most}")).in_file(format!("{stem}.glb"))
}

fn amount(bytes: u64) -> String {
    match bytes as f64 {
        b if b >= 1e9 => format!("{:.1} GB", b * 1e-9),
        b => format!("{:.2} MB", b * 1e-6),
    }
}
