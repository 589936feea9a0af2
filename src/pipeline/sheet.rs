//! A contact sheet of a species: some trees of it, in leaf and bare, all to one scale, with a
//! person beside each.
//!
//! Every row is one picture of trees that stand in line, seen through a long lens so that scale
//! holds from left to right; lines every few metres give heights.

use glam::{Mat3, Vec3};
use rayon::prelude::*;

use super::detail::{detail, mesh_options};
use super::figure::{self, figure};
use super::model::model_scene;
use super::paint::paint;
use super::told;
use crate::cache::Cache;
use crate::diagnostic::Result;
use crate::mesh::{self, FoliageLevel, MeshOptions};
use crate::raster::Picture;
use crate::render::label::{Align, Pen, rule};
use crate::render::{self, Backdrop, Camera, Placement, RenderOptions, View};
use crate::report::{Outcome, Recorder};
use crate::scene::{Material, Part, Scene};
use crate::seed::Seed;
use crate::skeleton::{self, Target};
use crate::species::Species;

/// What to show.
#[derive(Debug, Clone)]
pub struct SheetJob {
    pub species: Species,
    /// The species' typical height where `None`.
    pub height_m: Option<f32>,
    /// One tree each, shown in leaf and bare.
    pub seeds: Vec<u64>,
    /// Of each tree.
    pub triangles: usize,
    pub texture_px: u32,
    pub cache: Cache,
    /// Longer side of the sheet.
    pub size_px: u32,
}

impl SheetJob {
    /// Three trees at a size that shows their twigs.
    pub fn new(species: Species) -> Self {
        SheetJob {
            species,
            height_m: None,
            seeds: vec![1, 2, 3],
            triangles: 20_000,
            texture_px: 512,
            cache: Cache::off(),
            size_px: 1600,
        }
    }
}

/// A tree on the sheet.
#[derive(Debug, Clone, serde::Serialize)]
pub struct Shown {
    pub seed: u64,
    pub is_bare: bool,
    pub height_m: f32,
    pub triangles: usize,
}

/// A drawn sheet.
pub struct Sheet {
    pub picture: Picture,
    pub trees: Vec<Shown>,
}

const INK: [u8; 3] = [44, 46, 43];
const PALE_INK: [u8; 3] = [104, 106, 100];
const PAPER: [u8; 4] = [244, 244, 242, 255];
const FIGURE_COLOUR: [f32; 3] = [0.055, 0.058, 0.062];
/// Height of the camera above the horizon: enough to see where a tree stands.
const ELEVATION_DEG: f32 = 5.0;
/// Towards the sun: from the left, before the trees.
const SUN: Vec3 = Vec3::new(-0.62, -0.62, 0.85);
/// Distance of the camera over the longer side of what it sees.
const LENS: f32 = 10.0;

/// Grows and draws the trees.
///
/// # Errors
/// A rule that grows beyond its limits; a height no tree has.
pub fn sheet(job: &SheetJob, run: &mut Recorder) -> Result<Sheet> {
    let species = &job.species;
    let target = Target::FromSpecies { height_m: job.height_m };
    let skeletons = run.stage("skeleton", |_| {
        let grow = |&seed: &u64| {
            skeleton::grow(
                species,
                target,
                detail(job.triangles, FoliageLevel::Cards),
                Seed::new(seed),
            )
        };
        let skeletons = job.seeds.par_iter().map(grow).collect::<Result<Vec<_>>>()?;
        let nodes = skeletons.iter().map(|s| s.len()).sum();
        Ok((skeletons, Outcome::items(job.seeds.len(), "seeds", nodes, "nodes")))
    })?;
    // Trees of a height look as `larix tree --height` makes them.
    let in_leaf = species.in_leaf_at(job.height_m.unwrap_or(species.size.height_m));
    let species = &in_leaf;
    let textures = run.stage("texture", |warnings| {
        told::remarks(species, FoliageLevel::Cards, job.texture_px, warnings);
        let textures = paint(species, job.texture_px, &job.cache)?;
        let outcome = Outcome::items(1, "species", textures.pictures(), "pictures");
        Ok((textures, outcome))
    })?;
    let mut wanted = Vec::new();
    for (seed, skeleton) in job.seeds.iter().zip(&skeletons) {
        wanted.extend([false, true].map(|is_bare| (*seed, skeleton, is_bare)));
    }
    let meshes = run.stage("mesh", |_| {
        let build = |&(seed, skeleton, is_bare): &(u64, &skeleton::Skeleton, bool)| {
            let foliage = if is_bare { FoliageLevel::None } else { FoliageLevel::Cards };
            let options = MeshOptions { foliage, ..mesh_options(job.triangles) };
            let seed = Seed::new(seed).derive("mesh", 0);
            let mut mesh = mesh::build(skeleton, species, &textures.atlas, &options, seed)?;
            mesh.fit_height(skeleton.height_m());
            mesh.clear_ground();
            Ok(mesh)
        };
        let meshes = wanted.par_iter().map(build).collect::<Result<Vec<_>>>()?;
        let triangles = meshes.iter().map(|m| m.triangles()).sum();
        Ok((meshes, Outcome::items(wanted.len(), "trees", triangles, "triangles")))
    })?;
    let trees: Vec<Shown> = (wanted.iter().zip(&meshes))
        .map(|(&(seed, skeleton, is_bare), mesh)| Shown {
            seed,
            is_bare,
            height_m: skeleton.height_m(),
            triangles: mesh.triangles(),
        })
        .collect();
    run.stage("picture", |_| {
        let mut scene = model_scene(species, meshes, textures);
        let picture = draw(job, &mut scene, &trees)?;
        let count = trees.len();
        Ok((Sheet { picture, trees }, Outcome::items(count, "trees", 1, "picture")))
    })
}

/// Room that one tree and its figure take, metres from the tree's axis, and where the figure is.
#[derive(Debug, Clone, Copy)]
struct Room {
    left: f32,
    right: f32,
    /// Ground before the axis.
    before: f32,
    height: f32,
    figure_x: f32,
}

impl Room {
    /// Holds each tree; `models` are in tree-local metres, seen along y.
    fn of(models: &[&[Part]]) -> Room {
        let mut room = Room { left: 0.5, right: 0.5, before: 0.5, height: 1.9, figure_x: -0.9 };
        for p in models.iter().flat_map(|m| m.iter()).flat_map(|part| &part.surface.position) {
            room.left = room.left.max(-p.x);
            room.right = room.right.max(p.x);
            room.height = room.height.max(p.z);
            if p.z < 0.5 {
                room.before = room.before.max(-p.y);
            }
            // Clear of the leaves around it.
            if p.z < figure::HEIGHT_M + 0.2 {
                room.figure_x = room.figure_x.min(p.x - 0.55);
            }
        }
        room.left = room.left.max(0.45 - room.figure_x);
        room
    }

    fn width(&self) -> f32 {
        self.left + self.right
    }
}

/// Where things are on the sheet.
struct Layout {
    columns: usize,
    rows: usize,
    width_px: u32,
    /// Of one row of trees.
    row_px: u32,
    title_px: u32,
    caption_px: u32,
    px_per_m: f32,
    cell_m: f32,
    margin_px: f32,
}

impl Layout {
    /// All in one line, or those in leaf above those that are bare: whichever shows more.
    fn new(job: &SheetJob, room: &Room) -> Layout {
        let size = job.size_px as f32;
        let (title, caption, margin) = (0.062 * size, 0.048 * size, 0.03 * size);
        let cell_m = room.width() * 1.1 + 0.4;
        let row_m = view_height_m(room);
        let arranged = [(job.seeds.len(), 2), (job.seeds.len() * 2, 1)].map(|(columns, rows)| {
            let across = (size - 2.0 * margin) / (cell_m * columns as f32);
            let down = (size - title - caption * rows as f32) / (row_m * rows as f32);
            // Captions need room as well.
            (across.min(down).max(0.075 * size / cell_m), columns, rows)
        });
        let [two, one] = arranged;
        let (px_per_m, columns, rows) = if one.0 > two.0 { one } else { two };
        Layout {
            columns,
            rows,
            width_px: (px_per_m * cell_m * columns as f32 + 2.0 * margin) as u32,
            row_px: (px_per_m * row_m) as u32,
            title_px: title as u32,
            caption_px: caption as u32,
            px_per_m,
            cell_m,
            margin_px: margin,
        }
    }

    /// Where the axis of a column's tree is.
    fn axis_px(&self, column: usize, room: &Room) -> f32 {
        let free = self.cell_m - room.width();
        let axis_m = self.cell_m * column as f32 + free * 0.5 + room.left;
        self.margin_px + axis_m * self.px_per_m
    }
}

/// Ground shown before the trees' axes and air above them, as heights in the picture plane.
fn view_height_m(room: &Room) -> f32 {
    below_m(room) + room.height * 1.06
}

fn below_m(room: &Room) -> f32 {
    let (rise, _) = ELEVATION_DEG.to_radians().sin_cos();
    (room.before + 0.5) * rise + 0.05 * room.height
}

fn draw(job: &SheetJob, scene: &mut Scene, trees: &[Shown]) -> Result<Picture> {
    scene.materials.push(Material::plain("figure", FIGURE_COLOUR));
    let material = scene.materials.len() as u32 - 1;
    let person = [Part { name: "figure".into(), surface: figure(), material }];
    let mut models: Vec<&[Part]> = scene.prototypes.iter().map(|p| &p.parts[..]).collect();
    let room = Room::of(&models);
    models.push(&person);
    let layout = Layout::new(job, &room);

    let height_px = layout.title_px + layout.rows as u32 * (layout.row_px + layout.caption_px);
    let mut sheet = Picture::filled(layout.width_px, height_px, PAPER);
    let pen = Pen::new()?;
    write_title(&mut sheet, &pen, job, &layout);
    for row in 0..layout.rows {
        // Two rows: in leaf, then bare. One row: both of each tree side by side.
        let shown: Vec<usize> =
            (0..trees.len()).filter(|i| layout.rows == 1 || i % 2 == row).collect();
        let placements = (shown.iter().enumerate()).flat_map(|(column, &tree)| {
            let x =
                (layout.axis_px(column, &room) - 0.5 * layout.width_px as f32) / layout.px_per_m;
            let stand = |model: usize, x: f32, y: f32| Placement {
                model: model as u32,
                position: Vec3::new(x, y, 0.0),
                turn: Mat3::IDENTITY,
                scale: Vec3::ONE,
            };
            [stand(tree, x, 0.0), stand(trees.len(), x + room.figure_x, -0.2)]
        });
        let view = View {
            textures: &scene.textures,
            materials: &scene.materials,
            terrain: None,
            models: models.clone(),
            placements: placements.collect(),
        };
        let picture = photograph(&view, &layout, &room);
        let top = layout.title_px + row as u32 * (layout.row_px + layout.caption_px);
        paste(&mut sheet, &picture, top);
        write_heights(&mut sheet, &pen, &layout, &room, top);
        write_captions(&mut sheet, &pen, &layout, &room, top, shown.iter().map(|&i| &trees[i]));
    }
    Ok(sheet)
}

/// One row of trees on paper.
fn photograph(view: &View<'_>, layout: &Layout, room: &Room) -> Picture {
    let (rise, level) = ELEVATION_DEG.to_radians().sin_cos();
    let (width_m, height_m) =
        (layout.width_px as f32 / layout.px_per_m, layout.row_px as f32 / layout.px_per_m);
    let distance = LENS * width_m.max(height_m);
    let middle = Vec3::Z * ((height_m * 0.5 - below_m(room)) / level);
    let camera = Camera {
        eye: middle + Vec3::new(0.0, -level, rise) * distance,
        target: middle,
        fov_y_rad: 2.0 * (height_m * 0.5 / distance).atan(),
    };
    let options = RenderOptions {
        width: layout.width_px,
        height: layout.row_px,
        supersample: 3,
        sun: SUN,
        haze_per_m: 0.0,
        backdrop: Backdrop::Paper { horizon: 1.0 - below_m(room) * 1.9 / height_m },
        ..RenderOptions::default()
    };
    render::picture(view, &camera, &options)
}

fn paste(sheet: &mut Picture, picture: &Picture, top: u32) {
    let start = top as usize * sheet.width as usize;
    if let Some(rows) = sheet.data.get_mut(start..start + picture.data.len()) {
        rows.copy_from_slice(&picture.data);
    }
}

fn write_title(sheet: &mut Picture, pen: &Pen, job: &SheetJob, layout: &Layout) {
    let (species, title) = (&job.species, layout.title_px as f32);
    let (large, small) = (title * 0.52, title * 0.30);
    let y = title * 0.66;
    pen.write(sheet, &species.name, [layout.margin_px, y], Align::Left, large, INK);
    let mut x = layout.margin_px + pen.width_px(&species.name, large) + large * 0.5;
    if species.common != species.name {
        pen.write(sheet, &species.common, [x, y], Align::Left, small, PALE_INK);
        x += pen.width_px(&species.common, small) + large * 0.5;
    }
    let base = species.builds_on.as_ref().map(|b| format!("builds on {b}")).unwrap_or_default();
    let edge = layout.width_px as f32 - layout.margin_px;
    if edge - pen.width_px(&base, small) > x {
        pen.write(sheet, &base, [edge, y], Align::Right, small, PALE_INK);
    }
}

/// Level lines every few metres, with their heights.
fn write_heights(sheet: &mut Picture, pen: &Pen, layout: &Layout, room: &Room, top: u32) {
    let step = [0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0]
        .into_iter()
        .find(|step| room.height / step <= 6.0)
        .unwrap_or(50.0);
    let level = ELEVATION_DEG.to_radians().cos();
    let foot = top as f32 + layout.row_px as f32 - below_m(room) * layout.px_per_m;
    let size = layout.margin_px * 0.42;
    let mut height = step;
    while height <= room.height {
        let y = foot - height * level * layout.px_per_m;
        let x = [layout.margin_px * 0.25, layout.width_px as f32 - layout.margin_px * 0.25];
        rule(sheet, x, y, PALE_INK, 0.14);
        let digits = if step < 1.0 { 1 } else { 0 };
        let text = format!("{height:.digits$} m");
        pen.write(sheet, &text, [x[0], y - size * 0.3], Align::Left, size, PALE_INK);
        height += step;
    }
}

fn write_captions<'a>(
    sheet: &mut Picture,
    pen: &Pen,
    layout: &Layout,
    room: &Room,
    top: u32,
    trees: impl Iterator<Item = &'a Shown>,
) {
    for (column, tree) in trees.enumerate().take(layout.columns) {
        let x = layout.axis_px(column, room) + (room.right - room.left) * 0.5 * layout.px_per_m;
        let state = if tree.is_bare { "bare" } else { "in leaf" };
        let first = format!("seed {}, {state}", tree.seed);
        let second = format!("{:.1} m · {} triangles", tree.height_m, grouped(tree.triangles));
        let widest = layout.cell_m * layout.px_per_m * 0.94;
        let size = layout.caption_px as f32 * 0.38;
        let size = size * (widest / pen.width_px(&second, size).max(1.0)).min(1.0);
        let y = (top + layout.row_px) as f32 + layout.caption_px as f32 * 0.40;
        pen.write(sheet, &first, [x, y], Align::Middle, size, INK);
        let y = y + size * 1.15;
        pen.write(sheet, &second, [x, y], Align::Middle, size, PALE_INK);
    }
}

/// Digits in threes.
fn grouped(n: usize) -> String {
    let digits = n.to_string();
    let mut out = String::new();
    for (i, c) in digits.chars().enumerate() {
        if i > 0 && (digits.len() - i).is_multiple_of(3) {
            out.push(',');
        }
        out.push(c);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::Silent;
    use crate::species;

    #[test]
    fn numbers_are_grouped_in_threes() {
        assert_eq!([0, 999, 1000, 1234567].map(grouped), ["0", "999", "1,000", "1,234,567"]);
    }

    /// Twigs of small trees are short and hang little, on their sheet as in their file.
    #[test]
    fn a_sheet_of_a_height_shows_trees_of_that_height() {
        let of = |species: &species::Species| {
            let job = SheetJob {
                triangles: 1500,
                texture_px: 64,
                size_px: 240,
                height_m: Some(1.0),
                seeds: vec![1],
                ..SheetJob::new(species.clone())
            };
            sheet(&job, &mut Recorder::new(&Silent)).unwrap().picture
        };
        let mut spruce = species::load("picea_abies").unwrap();
        spruce.young.droop = None;
        // One whose grown trees have such twigs: they stay as they are, but for how they hang.
        let mut small = spruce.in_leaf_at(1.0);
        small.foliage.droop /= 1.0 - 0.8;
        let [one, other] = [of(&spruce), of(&small)];
        let differ = one.data.iter().zip(&other.data).filter(|(a, b)| a != b).count();
        assert!(spruce.foliage.droop > 0.0 && spruce.foliage.twig_length_m > 0.35);
        assert!(differ * 100 < one.data.len(), "{differ} of {}", one.data.len());
    }

    /// Nothing is cropped: no tree touches the edge of its row; and all six are there.
    #[test]
    fn a_sheet_holds_every_tree_whole() {
        for name in ["larix_sibirica", "quercus_robur", "salix_caprea", "table3/11"] {
            let job = SheetJob {
                triangles: 1500,
                texture_px: 64,
                size_px: 480,
                ..SheetJob::new(species::load(name).unwrap())
            };
            let sheet = sheet(&job, &mut Recorder::new(&Silent)).unwrap();
            assert_eq!(sheet.trees.len(), 6);
            let (w, h) = (sheet.picture.width, sheet.picture.height);
            assert!(w.max(h) <= 600 && w.min(h) > 100, "{name}: {w} × {h}");
            for y in 0..h {
                for x in [0, w - 1] {
                    let dark = sheet.picture.at(x, y)[1] < 120;
                    assert!(!dark, "{name}: something dark at {x}, {y}");
                }
            }
            let dark = sheet.picture.data.iter().filter(|p| p[1] < 120).count();
            assert!(dark * 200 > sheet.picture.data.len(), "{name}: an empty sheet");
        }
    }
}
