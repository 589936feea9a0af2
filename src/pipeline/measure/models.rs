//! Error of tree models against seconds: triangles of the finest form, levels of detail, textures.

use std::time::Instant;

use rayon::prelude::*;

use super::super::WoodJob;
use super::super::cover::Subject;
use super::super::detail::mesh_options;
use super::super::levels::{self, LevelsJob, bounds};
use super::super::model::model_scene;
use super::super::tree::{self, Asked, TreeJob};
use super::Bench;
use crate::cache::Cache;
use crate::diagnostic::Result;
use crate::lod::{self, Silhouettes, Views};
use crate::mesh::{FoliageLevel, TreeMesh, TwigsAs};
use crate::raster::Image;
use crate::render::capture::Sitter;
use crate::report::document::{Front, Point, Quantity, Timing, Truth};
use crate::report::{Recorder, Silent};
use crate::seed::Seed;
use crate::skeleton::{self, Detail, Target};
use crate::species::Species;
use crate::species::state::State;
use crate::texture::{self, TreeTextures};

/// Species that are measured, in full and quick.
const SPECIES: [usize; 2] = [3, 1];
/// Triangles of what others are measured against.
const REFERENCE: [usize; 2] = [200_000, 40_000];
/// What a model of a forest, and a tree alone, may have.
const FOREST: usize = 5_000;
const HERO: usize = 20_000;

pub(super) fn fronts(bench: &mut Bench<'_>) -> Result<Vec<Front>> {
    let bench = &*bench;
    let species = &bench.job.species[..SPECIES[at(bench)].min(bench.job.species.len())];
    let mut meshes = Vec::new();
    let mut forms = Vec::new();
    let mut textures = Vec::new();
    for s in species {
        meshes.extend(by_triangles(bench, s)?);
        forms.extend(by_level(bench, s)?);
        textures.extend(by_size(bench, s)?);
    }
    let triangles = || Some(Quantity::new("triangles", ""));
    let silhouette = || Quantity::new("silhouette error, RMS", "m");
    let reference = REFERENCE[at(bench)];
    let meshes = Front {
        id: "mesh".into(),
        stage: "mesh".into(),
        title: "Mesh: triangles of a tree".into(),
        error: silhouette(),
        truth: Truth::Finer,
        cost: triangles(),
        note: format!(
            "Silhouettes from nine sides and from above, beside those of {reference} triangles of the \
             same skeleton. Seconds are of meshing one tree. The default is that of a forest."
        ),
        is_by_group: true,
        points: meshes,
        verdict: String::new(),
    };
    let forms = Front {
        id: "levels".into(),
        stage: "levels".into(),
        title: "Levels of detail: triangles".into(),
        error: silhouette(),
        truth: Truth::Finer,
        cost: triangles(),
        note: format!(
            "Beside the finest form, of {HERO} triangles. Seconds are of making the form and all finer \
             ones and of measuring them. None is made unless asked for."
        ),
        is_by_group: true,
        points: forms,
        verdict: String::new(),
    };
    let textures = Front {
        id: "textures".into(),
        stage: "texture".into(),
        title: "Textures: pixels a side".into(),
        error: Quantity::new("colour RMSE", "of 255"),
        truth: Truth::Finer,
        cost: Some(Quantity::new("PNG", "bytes")),
        note: format!(
            "Bark and leaf colour, brought to {} pixels a side, beside pictures drawn so. The default is \
             that of a forest.",
            FINEST_PX
        ),
        is_by_group: true,
        points: textures,
        verdict: String::new(),
    };
    Ok(vec![meshes.marked(), forms.marked(), textures.marked()])
}

fn at(bench: &Bench<'_>) -> usize {
    usize::from(bench.job.is_quick)
}

fn by_triangles(bench: &Bench<'_>, species: &Species) -> Result<Vec<Point>> {
    let reference = REFERENCE[at(bench)];
    let ladder: &[usize] = match bench.job.is_quick {
        true => &[500, 2_000, 5_000, 10_000],
        false => &[250, 500, 1_000, 2_000, 5_000, 10_000, 20_000, 50_000],
    };
    let seed = bench.seed();
    let detail = Detail { max_nodes: (reference / 6) as u32, attractor_spacing_m: None };
    let skeleton = skeleton::grow(species, Target::FromSpecies { height_m: None }, detail, seed)?;
    let textures = texture::for_species(species, 256, seed);
    let subject = Subject { skeleton: &skeleton, species, textures: &textures, seed };
    let mut meshes = vec![subject.mesh(&mesh_options(reference))?];
    let mut timings = Vec::new();
    for &triangles in ladder {
        let (mesh, time) = bench.timed(|| (), |()| subject.mesh(&mesh_options(triangles)))?;
        meshes.push(mesh);
        timings.push(time);
    }
    let triangles: Vec<usize> = meshes.iter().skip(1).map(TreeMesh::triangles).collect();
    let off = silhouettes(species, meshes, textures)?;
    let point = |(k, &budget): (usize, &usize)| Point {
        group: species.name.clone(),
        setting: format!("{}, at most {budget}", species.name),
        error: off[k],
        cost: Some(triangles[k] as f64),
        time: timings[k],
        is_default: budget == FOREST,
        is_on_front: false,
    };
    Ok(ladder.iter().enumerate().map(point).collect())
}

/// RMS of how far the silhouette of each but the first is from the first's, metres.
fn silhouettes(
    species: &Species,
    meshes: Vec<TreeMesh>,
    textures: TreeTextures,
) -> Result<Vec<f64>> {
    let scene = model_scene(species, meshes, textures);
    let models: Vec<_> = scene.prototypes.iter().map(|p| &p.parts[..]).collect();
    let around = models.iter().map(|parts| bounds(parts)).reduce(levels::union).unwrap_or_default();
    let sitter = Sitter::covers(&models, &scene.materials, &scene.textures);
    let outlines: Vec<Silhouettes> = (0..models.len() as u32)
        .into_par_iter()
        .map(|m| Silhouettes::of(&sitter, m, around, Views::All))
        .collect::<Result<_>>()?;
    let (first, others) = outlines.split_at(1);
    Ok(others.iter().map(|o| f64::from(first[0].apart(o).rms_m)).collect())
}

fn by_level(bench: &Bench<'_>, species: &Species) -> Result<Vec<Point>> {
    let impostor = LevelsJob { impostor: Some(lod::Kind::Cross), ..LevelsJob::default() };
    let meshed = (1..=4).map(|meshed| LevelsJob { meshed, ..LevelsJob::default() });
    let mut points = Vec::new();
    for levels in meshed.chain([impostor]) {
        let job = TreeJob {
            species: species.clone(),
            size: Asked::Typical,
            stage: None,
            walls: Vec::new(),
            neighbours: Vec::new(),
            seed: bench.seed(),
            triangles: HERO,
            texture_px: 256,
            foliage: FoliageLevel::Cards,
            twigs: TwigsAs::Merged,
            wood: WoodJob::default(),
            levels,
            cache: Cache::off(),
            state: State::default(),
            has_variants: false,
            has_height_maps: false,
            cloud: None,
        };
        let mut seconds = Vec::new();
        let mut rows = Vec::new();
        let start = Instant::now();
        while seconds.len() < super::repeats(bench.job.is_quick, start.elapsed().as_secs_f64()) {
            let mut run = Recorder::new(&Silent);
            rows = tree::tree(&job, &mut run)?.rows;
            let of_forms = run.stages.iter().filter(|s| s.stage == "mesh" || s.stage == "levels");
            seconds.push(of_forms.map(|s| s.seconds).sum());
        }
        let Some(last) = rows.last() else { continue };
        points.push(Point {
            group: species.name.clone(),
            setting: format!("{}, {}", species.name, last.level),
            error: last.silhouette_rms_m.into(),
            cost: Some(last.triangles as f64),
            time: Timing::of(&seconds),
            is_default: false,
            is_on_front: false,
        });
    }
    Ok(points)
}

/// Side of the pictures that others are compared with.
const FINEST_PX: u32 = 1024;

fn by_size(bench: &Bench<'_>, species: &Species) -> Result<Vec<Point>> {
    const DEFAULT_PX: u32 = 512;
    let draw = |px: u32, seed: Seed| texture::for_species(species, px, seed);
    let finest = draw(FINEST_PX, bench.seed());
    let sizes = [64, 128, 256, 512].into_iter();
    sizes
        .map(|px| {
            let (drawn, time) = bench.timed(|| (), |()| Ok(draw(px, bench.seed())))?;
            let off_sq = [(&drawn.bark.colour, &finest.bark.colour), (&drawn.leaf, &finest.leaf)]
                .map(|(a, b)| off_sq(a, b));
            Ok(Point {
                group: species.name.clone(),
                setting: format!("{}, {px} px", species.name),
                error: (0.5 * off_sq.iter().sum::<f64>()).sqrt(),
                cost: Some(bytes(&drawn)? as f64),
                time,
                is_default: px == DEFAULT_PX,
                is_on_front: false,
            })
        })
        .collect()
}

/// As PNG.
fn bytes(textures: &TreeTextures) -> Result<usize> {
    let of_bark = textures
        .barks()
        .flat_map(|b| [Some(&b.colour), b.normal.as_ref(), b.orm.as_ref()].into_iter().flatten());
    of_bark.chain([&textures.leaf]).map(|image| Ok(image.png()?.len())).sum()
}

/// Mean squared difference of colours, what is transparent being black; `coarse` is drawn up to
/// the size of `fine`, bilinear between the middles of its pixels.
fn off_sq(coarse: &Image, fine: &Image) -> f64 {
    let (coarse, fine) = (coarse.picture(), fine.picture());
    let colour = |[r, g, b, a]: [u8; 4]| [r, g, b].map(|v| f64::from(v) * f64::from(a) / 255.0);
    let along = |i: u32, many: u32, few: u32| {
        let at = (f64::from(i) + 0.5) * f64::from(few) / f64::from(many) - 0.5;
        let first = at.floor();
        let wrap = |v: f64| v.rem_euclid(f64::from(few)) as u32;
        (wrap(first), wrap(first + 1.0), at - first)
    };
    let row = |y: u32| -> f64 {
        let (y0, y1, v) = along(y, fine.height, coarse.height);
        let pixel = |x: u32| -> f64 {
            let (x0, x1, u) = along(x, fine.width, coarse.width);
            let corners = [(x0, y0), (x1, y0), (x0, y1), (x1, y1)];
            let [a, b, c, d] = corners.map(|(x, y)| colour(coarse.at(x, y)));
            let wanted = colour(fine.at(x, y));
            let off = |k: usize| {
                let (upper, lower) = (a[k] + (b[k] - a[k]) * u, c[k] + (d[k] - c[k]) * u);
                upper + (lower - upper) * v - wanted[k]
            };
            (0..3).map(|k| off(k).powi(2)).sum()
        };
        (0..fine.width).map(pixel).sum()
    };
    let rows: Vec<f64> = (0..fine.height).into_par_iter().map(row).collect();
    rows.iter().sum::<f64>() / (3.0 * f64::from(fine.width) * f64::from(fine.height))
}
