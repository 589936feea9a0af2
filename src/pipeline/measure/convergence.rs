//! How errors fall while a step is halved.

use glam::{DVec3, Vec3};

use super::super::fit::total_m;
use super::Bench;
use crate::diagnostic::Result;
use crate::frame::Frame;
use crate::ground::{Classified, Kind};
use crate::mesh::{self, FoliageLevel, MeshOptions, Surface, TreeMesh};
use crate::report::document::{Ladder, Quantity, Rung, Truth};
use crate::scan::PointCloud;
use crate::seed::Seed;
use crate::skeleton::colonize::{Habit, Limits, Reach, Start, colonize};
use crate::skeleton::surroundings::Open;
use crate::skeleton::{self, Detail, NO_PARENT, Skeleton, Target};
use crate::species;
use crate::terrain::{self, TerrainOptions};
use crate::texture::Atlas;
use crate::voxel::VoxelOctree;

pub(super) fn ladders(bench: &mut Bench<'_>) -> Result<Vec<Ladder>> {
    let bench = &*bench;
    let all =
        [exact_cells(bench)?, cells(bench)?, voxels(bench)?, steps(bench)?, tolerances(bench)?];
    Ok(all.into_iter().map(Ladder::judged).collect())
}

fn ladder(id: &str, stage: &str, title: &str, step: Quantity, error: Quantity) -> Ladder {
    Ladder {
        id: format!("convergence-{id}"),
        stage: stage.into(),
        title: title.into(),
        step,
        error,
        truth: Truth::Exact,
        note: String::new(),
        stated_order: 1.0,
        rungs: Vec::new(),
        fit: None,
        converges: false,
        verdict: String::new(),
    }
}

/// So many halvings of the widest.
fn halved(widest: f32, count: i32) -> impl Iterator<Item = f32> {
    (0..count).map(move |k| widest * 0.5f32.powi(k))
}

/// A smooth hill, without noise: what the grid itself costs.
fn exact_cells(bench: &Bench<'_>) -> Result<Ladder> {
    const SIDE_M: f32 = 96.0;
    const APART_M: f32 = 0.4;
    let hill = |x: f32, y: f32| 4.0 * (x / 9.0).sin() + 3.0 * (y / 7.0).cos();
    let mut draws = bench.seed().derive("exact cells", 0).draws();
    let count = (SIDE_M / APART_M).powi(2) as usize;
    let mut cloud = empty_cloud();
    for _ in 0..count {
        let (x, y) = (draws.between(0.0, SIDE_M), draws.between(0.0, SIDE_M));
        push(&mut cloud, Vec3::new(x, y, hill(x, y)));
    }
    let kind = vec![Kind::Ground; count];
    let classified = Classified { cloud, kind, is_normalised: false };
    let mut rungs = Vec::new();
    for cell_m in halved(8.0, 5) {
        let options = TerrainOptions { cell_m: Some(cell_m), ..TerrainOptions::default() };
        let terrain = terrain::build(&classified, &options)?.value;
        let places = (0..160).flat_map(|i| (0..160).map(move |j| [i as f32, j as f32]));
        let off = places.map(|[i, j]| {
            let (x, y) = (8.0 + i * 0.5, 8.0 + j * 0.5);
            f64::from(terrain.height_at(glam::Vec2::new(x, y)) - hill(x, y))
        });
        rungs.push(Rung { step: cell_m.into(), error: rms(off) });
    }
    let (step, error) = (Quantity::new("cell", "m"), Quantity::new("height RMSE", "m"));
    let title = "Terrain: cell, points without noise";
    let note = "A smooth hill known in closed form, with points 0.4 m apart. Bilinear heights are of \
                order 2.";
    let mut ladder = ladder("cell", "terrain", title, step, error);
    (ladder.stated_order, ladder.note, ladder.rungs) = (2.0, note.into(), rungs);
    Ok(ladder)
}

/// The survey's own ground.
fn cells(bench: &Bench<'_>) -> Result<Ladder> {
    let classified = &bench.place.classified;
    let (mut rungs, mut truth) = (Vec::new(), Truth::Simulated);
    for cell_m in halved(16.0, 7) {
        let options = TerrainOptions { cell_m: Some(cell_m), ..TerrainOptions::default() };
        let terrain = terrain::build(classified, &options)?.into_value(&mut Vec::new());
        let error = match bench.place.truth_of(&terrain, &classified.cloud.frame, &[]) {
            Some(c) => c.terrain.rmse_m,
            None => {
                truth = Truth::HeldOut;
                match terrain::held_out_error(classified, &options)? {
                    Some(held_out) => held_out.rmse_m,
                    None => continue,
                }
            }
        };
        rungs.push(Rung { step: cell_m.into(), error });
    }
    let (step, error) = (Quantity::new("cell", "m"), Quantity::new("height RMSE", "m"));
    let mut ladder = ladder("survey-cell", "terrain", "Terrain: cell, the survey", step, error);
    ladder.note =
        "Of ground no more is known than that its slope is bounded, for which heights between \
                   neighbours are of order 1. Order 2, as on the smooth hill, shows only where the cell is \
                   well below the shortest waves of the ground (5 to 14 m long and a hand high in the \
                   simulated survey) and bends outweigh the noise; above 1 m one point gives a cell's \
                   height, noise and all. The floor is the scanner's noise, what stands too low to be told \
                   from ground, and the gaps between ground points: cells finer than those average less."
            .into();
    (ladder.stated_order, ladder.truth, ladder.rungs) = (1.0, truth, rungs);
    Ok(ladder)
}

/// How far points lie from the centres of mass that stand for them.
fn voxels(bench: &Bench<'_>) -> Result<Ladder> {
    let points: Vec<Vec3> = bench
        .place
        .classified
        .cloud
        .position
        .iter()
        .zip(&bench.place.classified.kind)
        .filter(|(_, k)| **k == Kind::Vegetation)
        .map(|(p, _)| *p)
        .collect();
    let mut rungs = Vec::new();
    for size_m in halved(8.0, 6).filter(|_| !points.is_empty()) {
        let tree = VoxelOctree::build(&points, size_m)?;
        rungs.push(Rung { step: size_m.into(), error: tree.spread_m() });
    }
    let (step, error) =
        (Quantity::new("voxel", "m"), Quantity::new("points to centres of mass, RMS", "m"));
    let mut ladder = ladder("voxel", "voxel", "Voxels: edge", step, error);
    ladder.truth = Truth::Cloud;
    ladder.note =
        "Vegetation points. Voxels finer than the points are apart hold one point each, and \
                   the error falls faster than order 1."
            .into();
    ladder.rungs = rungs;
    Ok(ladder)
}

/// Space colonization of a ball, D and d_k halved together, d_i four times D.
fn steps(bench: &Bench<'_>) -> Result<Ladder> {
    const BALL: usize = 30_000;
    let mut draws = bench.seed().derive("steps", 0).draws();
    let cloud: Vec<Vec3> =
        (0..BALL).map(|_| draws.direction() * (3.0 * draws.unit().cbrt())).collect();
    let start = Start { position: Vec3::ZERO, heading: Vec3::ZERO, is_open: true };
    let limits = Limits { max_nodes: 200_000, max_rounds: 2_000, bridges: 1 };
    let rungs = halved(1.6, 5).map(|step_m| {
        let (reach, _) = Reach::new(step_m, step_m, 4.0 * step_m);
        let pull = |_| Vec3::ZERO;
        let grown = colonize(&[start], &cloud, &reach, &Habit::default(), pull, &Open, &limits);
        let mut tree = Skeleton { position: vec![Vec3::ZERO], ..Skeleton::default() };
        tree.parent = vec![NO_PARENT];
        tree.position.extend(grown.position);
        tree.parent.extend(grown.parent);
        let error = total_m(&tree, &cloud) / BALL as f64;
        Rung { step: step_m.into(), error }
    });
    let (step, error) = (Quantity::new("D", "m"), Quantity::new("points to wood, mean", "m"));
    let mut ladder = ladder("step", "skeleton", "Space colonization: step D", step, error);
    ladder.note = format!(
        "{BALL} attractors in a ball of 3 m. They are removed within d_k = D of a node, and the wood \
         comes no nearer than that takes."
    );
    ladder.truth = Truth::Drawn;
    ladder.rungs = rungs.collect();
    Ok(ladder)
}

/// The volume of a tree's wood, its tubes having as many sides as the tolerance asks for.
fn tolerances(bench: &Bench<'_>) -> Result<Ladder> {
    let seed = bench.seed();
    let species = species::load("betula_pendula")?;
    let detail = Detail { max_nodes: 400, attractor_spacing_m: None };
    let target = Target::FromSpecies { height_m: None };
    let skeleton = skeleton::grow(&species, target, detail, seed)?;
    let volume = |tolerance_m: f32| -> Result<f64> {
        let options = MeshOptions {
            tolerance_m,
            triangle_budget: None,
            foliage: FoliageLevel::None,
            ..MeshOptions::FOREST
        };
        let tree: TreeMesh =
            mesh::build(&skeleton, &species, &Atlas::whole(0.4), &options, Seed::new(1))?;
        Ok(tree.woods().into_iter().map(volume_cu_m).sum())
    };
    let finest = volume(2e-5)?;
    let mut rungs = Vec::new();
    for tolerance_m in halved(0.016, 7) {
        let error = 100.0 * (volume(tolerance_m)? / finest - 1.0).abs();
        rungs.push(Rung { step: f64::from(tolerance_m) * 1e3, error });
    }
    let (step, error) = (Quantity::new("tolerance", "mm"), Quantity::new("wood volume error", "%"));
    let mut ladder = ladder("tolerance", "mesh", "Mesh: tolerance of cones", step, error);
    ladder.note =
        "Wood of one birch as truncated cones, closed; beside its volume at 0.02 mm. A circle \
                   of n sides within s of its arc lacks a share of its area that goes with s."
            .into();
    (ladder.truth, ladder.rungs) = (Truth::Finer, rungs);
    Ok(ladder)
}

/// Of a part of a closed surface, by the divergence theorem; parts of one surface add up.
fn volume_cu_m(surface: &Surface) -> f64 {
    let corner = |i: u32| surface.position[i as usize].as_dvec3();
    let triangles = surface.index.chunks_exact(3);
    triangles.map(|t| corner(t[0]).dot(corner(t[1]).cross(corner(t[2]))) / 6.0).sum()
}

fn rms(off: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = off.fold((0.0, 0u32), |(s, n), d| (s + d * d, n + 1));
    (sum / f64::from(count.max(1))).sqrt()
}

pub(super) fn empty_cloud() -> PointCloud {
    PointCloud {
        frame: Frame::local(DVec3::ZERO),
        position: Vec::new(),
        intensity: Vec::new(),
        return_number: Vec::new(),
        return_count: Vec::new(),
        class: Vec::new(),
        rgb: None,
    }
}

/// An only return.
pub(super) fn push(cloud: &mut PointCloud, at: Vec3) {
    cloud.position.push(at);
    cloud.intensity.push(0);
    cloud.return_number.push(1);
    cloud.return_count.push(1);
    cloud.class.push(1);
}
