//! Seconds and memory against points, trees and threads.

use std::time::Instant;

use glam::{Vec2, Vec3};

use super::super::{Sharing, forest, survey::Survey};
use super::Bench;
use crate::diagnostic::{Error, Result};
use crate::ground::{self, Method};
use crate::heap::held_bytes;
use crate::report::document::{Quantity, Scaled, Scaling, Series, Timing};
use crate::report::{Outcome, Recorder, Silent};
use crate::scan::PointCloud;
use crate::terrain::{self, Terrain};
use crate::{crown, voxel};

/// Points of the scans and trees of the scenes, in full and quick.
const POINTS: [&[usize]; 2] =
    [&[100_000, 300_000, 1_000_000, 5_000_000, 20_000_000], &[30_000, 100_000, 300_000]];
const TREES: [&[usize]; 2] = [&[10, 100, 1_000, 10_000], &[10, 30, 100]];
/// Triangles of each tree, grown for itself.
const TRIANGLES: usize = 400;

pub(super) fn all(bench: &mut Bench<'_>) -> Result<Vec<Scaling>> {
    let bench = &*bench;
    if bench.place.survey.trees.is_empty() {
        return Ok(Vec::new());
    }
    let most = rayon::current_num_threads();
    let threads: Vec<usize> = if most == 1 { vec![1] } else { vec![1, most] };
    let at = usize::from(bench.job.is_quick);
    let (mut by_points, mut by_trees) = (Vec::new(), Vec::new());
    for &n in &threads {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(n)
            .build()
            .map_err(|e| Error::new(format!("{n} threads can't be started: {e}")))?;
        by_points.push(pool.install(|| series(bench, n, POINTS[at], points))?);
        by_trees.push(pool.install(|| series(bench, n, TREES[at], trees))?);
    }
    let scaling = |id: &str, title: &str, over: Quantity, series, note: &str| Scaling {
        id: id.into(),
        title: title.into(),
        over,
        series,
        note: note.into(),
    };
    Ok(vec![
        scaling(
            "scale-points",
            "Points to trees",
            Quantity::new("points", ""),
            by_points,
            "The middle of the scan, or copies of it side by side, of so many points; ground, terrain and crowns. \
             Memory holds the points themselves.",
        ),
        scaling(
            "scale-trees",
            "Trees to a scene",
            Quantity::new("trees", ""),
            by_trees,
            "The trees found, side by side until there are so many, each grown and meshed for itself \
             with at most 400 triangles, without textures, in one valid scene. What is the same for any count (species, terrain, threads to start) \
             weighs on small ones.",
        ),
    ])
}

type Measure = fn(&Bench<'_>, usize) -> Result<Scaled>;

fn series(bench: &Bench<'_>, threads: usize, sizes: &[usize], of: Measure) -> Result<Series> {
    let points = sizes.iter().map(|&n| of(bench, n)).collect::<Result<_>>()?;
    Ok(Series::fitted(threads, points))
}

/// Runs `work` as often as its length allows; the peak is above what is held before, and the
/// greatest of the runs.
fn measured<P>(
    bench: &Bench<'_>,
    count: usize,
    mut prepare: impl FnMut() -> P,
    work: impl Fn(P, &mut Recorder) -> Result<()>,
) -> Result<Scaled> {
    /// Longer tasks are run once.
    const LONG_S: f64 = 1.5;
    let (mut seconds, mut peak_bytes) = (Vec::new(), 0);
    let held_bytes = held_bytes();
    loop {
        let prepared = prepare();
        let mut run = Recorder::new(&Silent);
        let start = Instant::now();
        work(prepared, &mut run)?;
        seconds.push(start.elapsed().as_secs_f64());
        peak_bytes = run.peak_bytes().saturating_sub(held_bytes).max(peak_bytes);
        let spent: f64 = seconds.iter().sum();
        if spent > LONG_S || seconds.len() >= super::repeats(bench.job.is_quick, spent) {
            let time = Timing::of(&seconds);
            return Ok(Scaled { count: count as f64, time, peak_bytes });
        }
    }
}

fn points(bench: &Bench<'_>, count: usize) -> Result<Scaled> {
    let cloud = tiled(&bench.place.cloud, count);
    let voxel_m = voxel::choose_size_m(bench.place.density_per_m2, 4.0);
    let work = |cloud: PointCloud, run: &mut Recorder| {
        run.stage("points", |_| {
            let classified = ground::classify(cloud, Method::Smrf)?.value;
            let terrain = terrain::build(&classified, &Default::default())?.value;
            let crowns = crown::detect(&classified, &terrain, voxel_m, &Default::default())?.value;
            Ok(((), Outcome::items(count, "points", crowns.len(), "trees")))
        })
    };
    measured(bench, count, || cloud.clone(), work)
}

/// So many points: of the middle of a scan, or of copies of it side by side.
fn tiled(cloud: &PointCloud, count: usize) -> PointCloud {
    let none = (Vec3::INFINITY, Vec3::NEG_INFINITY);
    let (low, high) = cloud.position.iter().fold(none, |(a, b), p| (a.min(*p), b.max(*p)));
    let side = (high - low).with_z(0.0);
    if count < cloud.len() {
        let off = |p: &Vec3| {
            let off = (*p - low).truncate() / side.truncate().max(Vec2::splat(1e-3)) - 0.5;
            off.abs().max_element()
        };
        let mut offs: Vec<f32> = cloud.position.iter().map(off).collect();
        let most = *offs.select_nth_unstable_by(count, f32::total_cmp).1;
        let mut cut = PointCloud { rgb: None, ..cloud.clone() };
        cut.retain(|i| off(&cloud.position[i]) < most);
        return cut;
    }
    let copies = count.div_ceil(cloud.len().max(1));
    let across = (copies as f64).sqrt().ceil() as usize;
    let shift =
        |k: usize| Vec3::new((k % across) as f32, (k / across) as f32, 0.0) * (side + Vec3::ONE);
    let mut out = PointCloud { position: Vec::with_capacity(count), rgb: None, ..cloud.clone() };
    out.position.clear();
    for column in [&mut out.return_number, &mut out.return_count, &mut out.class] {
        *column = column.iter().copied().cycle().take(count).collect();
    }
    out.intensity = cloud.intensity.iter().copied().cycle().take(count).collect();
    let all = (0..copies).flat_map(|k| cloud.position.iter().map(move |p| (k, p)));
    out.position.extend(all.take(count).map(|(k, p)| *p + shift(k)));
    out
}

fn trees(bench: &Bench<'_>, count: usize) -> Result<Scaled> {
    let mut job = bench.place.forest_job(bench.job);
    (job.sharing, job.triangles, job.texture_px) = (Sharing::None, TRIANGLES, 0);
    job.survey.photo = None;
    let work = |survey: Survey, run: &mut Recorder| forest::raise(&job, survey, run).map(drop);
    measured(bench, count, || planted(&bench.place.survey, count), work)
}

/// The trees of a survey in copies side by side, on level ground.
fn planted(survey: &Survey, count: usize) -> Survey {
    let copies = count.div_ceil(survey.trees.len());
    let across = (copies as f64).sqrt().ceil() as usize;
    let mut g = survey.terrain.heights.geometry;
    let side = Vec3::new((g.east() - g.west) as f32, (g.north - g.south()) as f32, 0.0);
    let (mut trees, mut species) = (Vec::with_capacity(count), Vec::with_capacity(count));
    for i in 0..count {
        let (copy, of) = (i / survey.trees.len(), i % survey.trees.len());
        let mut tree = survey.trees[of].clone();
        let at = side * Vec3::new((copy % across) as f32, (copy / across) as f32, 0.0);
        tree.crown = tree.crown.moved(at.with_z(-survey.trees[of].crown.root.z));
        tree.crown.key = tree.crown.key.wrapping_add((copy as u64) << 40);
        tree.id = format!("{}_{copy}", tree.id);
        trees.push(tree);
        species.push(survey.species[of]);
    }
    // Cells as wide as the whole is, so that level ground costs nothing.
    g.cell_x = (g.east() - g.west) * across as f64 / 2.0;
    g.cell_y = (g.north - g.south()) * across as f64 / 2.0;
    let south = survey.terrain.heights.geometry.south();
    (g.cols, g.rows, g.north) = (2, 2, south + 2.0 * g.cell_y);
    let heights = crate::raster::Grid::filled(g, 0.0);
    let terrain = Terrain { heights, is_observed: vec![true; 4] };
    Survey { frame: survey.frame.clone(), terrain, photo: None, trees, species }
}
