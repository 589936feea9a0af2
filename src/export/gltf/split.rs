//! Scenes too large for one GLB, whose lengths have 32 bits: a file a square of ground with the models
//! that its trees need, and the terrain in one of its own, or in one a square of its own side where it
//! is too large itself. All share the scene's origin.
//!
//! The side is the largest power of two, in metres, at which every file fits; coarser forms are cut
//! alike, so that a square's forms belong together. A triangle of the terrain is whole in the square of its
//! middle: squares meet along edges, whose vertices each has from the same numbers, so that there is no
//! seam. Files are built to be measured, and again when they are written: no more than one is held.
//! A piece of the terrain has its own crop of the photo (`crop`).
//! Limits: models and pictures that squares share stand in the file of each; no tree is cut.

use std::cmp::Reverse;
use std::collections::BTreeMap;
use std::ops::Range;
use std::sync::{Arc, OnceLock};

use glam::{Vec2, Vec3};
use rayon::prelude::*;

use super::super::{Content, OutputFile, Pictures};
use super::crop::Crop;
use super::quantize::Grid;
use super::{Binary, Recipe, Square};
use crate::diagnostic::{Error, Result, Warned};
use crate::mesh::Surface;
use crate::scene::{self, Selection};

/// Sides at which one gives up.
const LEAST_SIDE_M: f32 = 1.0;
/// So many times the bytes of the wholes are too many.
const MOST_REPEATED: u64 = 10;

/// A file of the set.
struct Part<'a> {
    selection: Selection<'a>,
    square: Option<Square>,
    /// Where not all of the terrain is shown.
    triangles: Option<Triangles>,
    /// Of its name: `_x0_y1`, `_x0_y1_LOD1`, `_terrain`.
    suffix: String,
    bytes: u64,
}

/// Some of a surface.
struct Triangles {
    /// All, square by square.
    order: Arc<[u32]>,
    range: Range<usize>,
    /// What they show of the pictures, coded when it is first asked for.
    cropped: OnceLock<Pictures>,
}

impl<'a> Part<'a> {
    /// Trees or triangles, of which a square may have fewer.
    fn count(&self) -> usize {
        self.triangles.as_ref().map_or(self.selection.trees.len(), |t| t.range.len())
    }

    /// # Errors
    /// Compression's.
    fn built<T>(
        &self,
        pictures: &Pictures,
        recipe: &Recipe<'_>,
        then: impl FnOnce(&Binary<'_>) -> T,
    ) -> Result<T> {
        let (Some(triangles), Some(whole)) = (&self.triangles, self.selection.terrain) else {
            return Ok(then(&Binary::of(&self.selection, pictures, recipe, self.square)?));
        };
        let own = &triangles.order[triangles.range.clone()];
        let mut surface = piece(&whole.surface, own);
        let mut pictures = pictures;
        if let Some(crop) = Crop::of(&self.selection, &surface.uv) {
            crop.turn(&mut surface);
            let kind = recipe.profile.picture_format();
            pictures = match triangles.cropped.get() {
                Some(cropped) => cropped,
                None => {
                    let cropped = crop.pictures(&self.selection, pictures, kind)?;
                    triangles.cropped.get_or_init(|| cropped)
                }
            };
        }
        let (name, material) = (whole.name.clone(), whole.material);
        let terrain = scene::Part { name, surface, material };
        let mut selection: Selection<'_> = self.selection.clone();
        selection.terrain = Some(&terrain);
        Ok(then(&Binary::of(&selection, pictures, recipe, self.square)?))
    }
}

/// Files of a scene in these forms, by the suffixes of their names, of which one would be of so many bytes.
///
/// # Errors
/// Terrain that is not to be cut small enough, or trees that stand together, too large for a GLB; what
/// would be repeated too often; compression's.
pub(super) fn files<'a>(
    forms: &[(String, Selection<'a>)],
    (large, large_bytes): (&str, u64),
    pictures: &'a Pictures,
    recipe: Recipe<'a>,
) -> Result<Warned<Vec<OutputFile<'a>>>> {
    let Recipe { stem, most_bytes, .. } = recipe;
    let measure = |part: &Part<'a>| part.built(pictures, &recipe, |binary| binary.bytes());
    let mut parts = Vec::new();
    let mut terrain_side_m = None;
    if let Some(selection) = forms.iter().find_map(|(_, whole)| whole.terrain_alone()) {
        let suffix = "_terrain".to_owned();
        let mut whole = Part { selection, square: None, triangles: None, suffix, bytes: 0 };
        whole.bytes = measure(&whole)?;
        if whole.bytes <= most_bytes {
            parts.push(whole);
        } else {
            let surfaces = whole.selection.terrain.into_iter().map(|t| t.surface.bounds());
            let first_side_m = first_side_m(surfaces.flat_map(|(lo, hi)| [lo, hi]));
            let squares = |side_m| terrain_squares(&whole.selection, side_m);
            let cut = fitting(squares, first_side_m, &recipe, measure)?;
            let (squares, side_m) = cut.map_err(|_| {
                too_large("the terrain needs", whole.bytes, &recipe).remedy(
                    "ask for a coarser one (--terrain-error), or write --format gltf or usdc",
                )
            })?;
            terrain_side_m = Some(side_m);
            parts = squares;
        }
    }
    let terrains = parts.len();
    let trees = forms.iter().flat_map(|(_, whole)| &whole.trees);
    let first_side_m = first_side_m(trees.map(|t| t.instance.position));
    let cut = fitting(|side_m| tree_squares(forms, side_m), first_side_m, &recipe, measure)?;
    let (squares, side_m) = cut.map_err(|Crowded { bytes, count }| {
        let who = if count < 2 { "a single tree needs" } else { "trees in one place need" };
        too_large(who, bytes, &recipe)
            .remedy("ask for fewer triangles (--triangles), or write --format gltf or usdc")
    })?;
    parts.extend(squares);
    let all_bytes: u64 = parts.iter().map(|p| p.bytes).sum();
    if all_bytes > MOST_REPEATED.saturating_mul(large_bytes * forms.len() as u64) {
        let what = format!("{} files would repeat its models, and take", parts.len());
        return Err(too_large(&what, all_bytes, &recipe).remedy(
            "ask for fewer triangles (--triangles) or models (--unique), or write --format gltf or usdc",
        ));
    }
    let squares =
        |side_m: f32, stem: &str| format!("squares of {side_m} m ({stem}_x0_y0.glb and so on)");
    let trees = (parts.len() > terrains).then(|| format!("by {}", squares(side_m, stem)));
    let terrain = match terrain_side_m {
        Some(side_m) => {
            let squares = squares(side_m, &format!("{stem}_terrain"));
            Some(format!("{terrains} of the terrain by {squares}"))
        }
        None => (terrains > 0).then(|| "one of the terrain".to_owned()),
    };
    let by_what: Vec<String> = trees.into_iter().chain(terrain).collect();
    let warning = format!(
        "{stem}{large}.glb would be {}, more than a GLB may be ({}): split by place into {} files of {} together, \
         {}; all have one origin",
        amount(large_bytes),
        amount(most_bytes),
        parts.len(),
        amount(all_bytes),
        by_what.join(" and "),
    );
    let files = parts.into_iter().map(|part| OutputFile {
        path: format!("{stem}{}.glb", part.suffix).into(),
        content: Content::stream(move |sink| {
            let written = part.built(pictures, &recipe, |binary| binary.write(sink));
            written.map_err(|e| std::io::Error::other(e.to_string()))?
        }),
    });
    Ok(Warned::with(files.collect(), vec![warning]))
}

/// The file that is too large however small its square, and what of the scene it has.
struct Crowded {
    bytes: u64,
    count: usize,
}

/// Files by squares of the largest side at which every one fits, measured; and that side.
///
/// # Errors
/// Those of `measure`.
fn fitting<'a>(
    squares: impl Fn(f32) -> Vec<Part<'a>>,
    first_side_m: f32,
    recipe: &Recipe<'_>,
    measure: impl Fn(&Part<'a>) -> Result<u64>,
) -> Result<std::result::Result<(Vec<Part<'a>>, f32), Crowded>> {
    let mut side_m = first_side_m;
    loop {
        let mut parts = squares(side_m);
        // What does not fit is most likely where most is.
        let mut order: Vec<usize> = (0..parts.len()).collect();
        order.sort_by_key(|&k| Reverse(parts[k].count()));
        let mut crowded = None;
        for k in order {
            parts[k].bytes = measure(&parts[k])?;
            if parts[k].bytes > recipe.most_bytes {
                crowded = Some(Crowded { bytes: parts[k].bytes, count: parts[k].count() });
                break;
            }
        }
        let Some(crowded) = crowded else { return Ok(Ok((parts, side_m))) };
        if crowded.count < 2 || side_m <= LEAST_SIDE_M {
            return Ok(Err(crowded));
        }
        side_m *= 0.5;
    }
}

/// The files of every form, square by square.
fn tree_squares<'a>(forms: &[(String, Selection<'a>)], side_m: f32) -> Vec<Part<'a>> {
    let mut parts = Vec::new();
    for (form, whole) in forms {
        let squares = whole.squares(side_m);
        // All forms are of the same trees.
        let least = least(squares.keys());
        for (at, selection) in squares {
            let square = Square::new(at, least, side_m, None);
            let suffix = format!("{}{form}", square.suffix());
            let square = Some(square);
            parts.push(Part { selection, square, triangles: None, suffix, bytes: 0 });
        }
    }
    // A square's forms beside each other.
    parts.sort_by_key(|p| p.square.map(|s| [s.at[1], s.at[0]]));
    parts
}

/// The files of the terrain.
fn terrain_squares<'a>(whole: &Selection<'a>, side_m: f32) -> Vec<Part<'a>> {
    let Some(terrain) = whole.terrain else { return Vec::new() };
    let (order, ranges) = by_square(&terrain.surface, side_m);
    let order: Arc<[u32]> = order.into();
    let least = least(ranges.keys());
    let grid = Grid::around([&terrain.surface].into_iter());
    let part = |([y, x], range): ([i32; 2], Range<usize>)| {
        let square = Square::new([x, y], [least[1], least[0]], side_m, Some(grid));
        Part {
            selection: whole.clone(),
            square: Some(square),
            triangles: Some(Triangles { order: order.clone(), range, cropped: OnceLock::new() }),
            suffix: format!("_terrain{}", square.suffix()),
            bytes: 0,
        }
    };
    ranges.into_iter().map(part).collect()
}

/// Numbers of all triangles by the square of their middle, and where those of each, by row and column
/// from the origin, are among them.
fn by_square(surface: &Surface, side_m: f32) -> (Vec<u32>, BTreeMap<[i32; 2], Range<usize>>) {
    let square = |triangle: &[u32; 3]| {
        let sum: Vec3 = triangle.iter().map(|&i| surface.position[i as usize]).sum();
        // Saturates for places that no scan reaches.
        let Vec2 { x, y } = (sum.truncate() / (3.0 * side_m)).floor();
        [y as i32, x as i32]
    };
    let corners = surface.index.as_chunks::<3>().0;
    let mut counts: BTreeMap<[i32; 2], usize> = BTreeMap::new();
    for triangle in corners {
        *counts.entry(square(triangle)).or_default() += 1;
    }
    let mut filled = 0;
    let mut ranges: BTreeMap<[i32; 2], Range<usize>> = BTreeMap::new();
    for (at, count) in counts {
        ranges.insert(at, filled..filled);
        filled += count;
    }
    let mut order = vec![0; filled];
    for (number, triangle) in (0u32..).zip(corners) {
        if let Some(range) = ranges.get_mut(&square(triangle)) {
            order[range.end] = number;
            range.end += 1;
        }
    }
    (order, ranges)
}

/// These triangles of a surface, with the vertices that they need in the order that they had.
fn piece(whole: &Surface, triangles: &[u32]) -> Surface {
    let corners = whole.index.as_chunks::<3>().0;
    let index: Vec<u32> = triangles.iter().flat_map(|&t| corners[t as usize]).collect();
    let mut used = index.clone();
    used.par_sort_unstable();
    used.dedup();
    // Every index is among them.
    let number = |i: &u32| used.partition_point(|u| u < i) as u32;
    fn of<T: Copy + Send + Sync>(column: &[T], used: &[u32]) -> Vec<T> {
        if column.is_empty() {
            return Vec::new();
        }
        used.iter().map(|&i| column[i as usize]).collect()
    }
    Surface {
        position: of(&whole.position, &used),
        normal: of(&whole.normal, &used),
        uv: of(&whole.uv, &used),
        wind: of(&whole.wind, &used),
        lightmap_uv: of(&whole.lightmap_uv, &used),
        index: index.par_iter().map(number).collect(),
    }
}

fn least<'s>(squares: impl Iterator<Item = &'s [i32; 2]>) -> [i32; 2] {
    let both = |a: [i32; 2], b: [i32; 2]| [a[0].min(b[0]), a[1].min(b[1])];
    squares.copied().reduce(both).unwrap_or_default()
}

impl Square {
    /// `at` and `least`, the south-western one, from the origin.
    fn new(at: [i32; 2], least: [i32; 2], side_m: f32, terrain_grid: Option<Grid>) -> Self {
        let [x, y] = [0, 1].map(|k| at[k].saturating_sub(least[k]));
        Square { at: [x, y], side_m, corner: at.map(|c| c as f32 * side_m), terrain_grid }
    }

    fn suffix(&self) -> String {
        format!("_x{}_y{}", self.at[0], self.at[1])
    }
}

/// A power of two that is no less than the extent of these places, metres.
fn first_side_m(places: impl Iterator<Item = Vec3>) -> f32 {
    let ends = places.map(|p| (p, p)).reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)));
    let extent_m = ends.map_or(0.0, |(lo, hi)| (hi - lo).truncate().max_element());
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
