//! The edge of voxels, ground, terrain and crowns.

use glam::{DVec3, Vec2, Vec3};

use super::super::convergence::{empty_cloud, push};
use super::unrefused;
use crate::crown::{self, Crown, CrownOptions};
use crate::diagnostic::{Error, Result};
use crate::frame::Frame;
use crate::ground::{self, Classified, Kind, Method};
use crate::raster::{Grid, GridGeometry, inpaint};
use crate::seed::Seed;
use crate::skeleton::stability::Case;
use crate::terrain::{self, Terrain, TerrainOptions};
use crate::voxel::{VoxelOctree, centres_of_mass};

pub(super) fn cases() -> Vec<(&'static str, Case)> {
    cases! {
        voxel: "voxels of 10⁻⁹ m and of no size, for one tree" => "raised to the least, points kept",
            0.0 "points lost", tiny_voxels;
        voxel: "an octree of voxels of 0, −1, NaN and 10⁻⁹ m" => "an error each",
            0.0 "answers without one", no_octree;
        voxel: "10⁵ points in one place" => "one voxel, its centre of mass there", 1e-6 "m", one_voxel;
        ground: "no point, one and two" => "an error that says how many", 0.0 "answers without one", too_few;
        ground: "10⁴ points all alike" => "an error, or level ground there", 1e-3 "m", all_alike;
        ground: "one point 1 km below the ground" => "the ground is not pulled down", 0.05 "m", stray_below;
        ground: "one point 1 km above the ground" => "the ground is not pulled up", 0.05 "m", stray_above;
        ground: "the points in reverse order" => "the same kinds", 0.0 "points differ", reversed;
        ground: "a slope of 60°, bare" => "nearly all of it is ground", 0.02 "of the points lost", steep;
        ground: "a slope of 45° on a plot of 16 m, where no trend is known" => "what is found lies on it",
            0.1 "m", small_steep;
        ground: "a cliff of 12 m across a plot" => "above and below, beyond 4 m of its edge, nearly all is ground",
            0.1 "of it lost", cliffs;
        ground: "a crest of two flanks of 45°" => "right beyond 4 m of it", 0.1 "m", crest;
        ground: "a house of 20 m" => "no ground", 0.02 "of its roof", house;
        ground: "a hall of 60 m, wider than any window" => "around it the ground is right", 0.1 "m", hall;
        ground: "undergrowth of 1 m that no pulse passes, 30 m wide" => "lifts the ground by no more than that",
            1.05 "m", undergrowth;
        ground: "a smooth mound of 2 m that no pulse passes, 30 m wide, by opening and by triangles" =>
            "lifts the ground by no more than that", 2.05 "m", mound;
        ground: "terraces 4 m wide and 1 m high, by triangles" => "off by no more than a rise", 1.0 "m", terraces;
        ground: "a bare slope of 45°, by rules of voxels" => "what is found lies on it", 0.1 "m", steep_by_rules;
        ground: "no returns from under a crown of 20 m, by rules of voxels" => "right beyond it", 0.5 "m", hidden;
        terrain: "10,000 points/m²" => "the plane they lie on", 0.01 "m", dense;
        terrain: "a plot of 24 m on a slope, 4 points/m²" => "the plane it lies on", 0.05 "m", small_plot;
        terrain: "0.01 points/m²" => "the plane they lie on", 0.05 "m", sparse;
        terrain: "a cliff of 12 m, its ground known" => "right beyond two cells of its edge", 0.05 "m", cliff;
        terrain: "points on a line" => "their heights, finite everywhere", 0.05 "m", on_a_line;
        terrain: "three points" => "a surface through them", 0.05 "m", three_points;
        terrain: "a gap of 60 m in a slope" => "the slope goes on through it", 0.3 "m", gap;
        terrain: "a strip of ground bowed to half a circle, with long triangles from end to end" =>
            "the slope goes on across", 0.3 "m", bowed;
        terrain: "a slope known on one half, the other filled by a membrane" => "level there, no height that is not known",
            1e-3 "m beyond", half_known;
        terrain: "cells of 10⁻⁶ m, 0 and NaN" => "an error before memory is taken",
            0.0 "answers without one", tiny_cells;
        terrain: "heights of 8,848 m, local" => "millimetres kept", 2e-3 "m", high;
        terrain: "asked far outside the scan" => "the height of the border", 1e-3 "m", far_outside;
        crown: "no vegetation" => "no trees", 0.0 "trees", no_trees;
        crown: "one dome alone on level ground" => "one tree of its height", 0.02 "of the height", one_dome;
        crown: "a lower tree beside a taller, and one whose top touches it" => "two trees, and one",
            0.0 "trees off", lower_tree;
        crown: "a tree of 5 m under a crown of 14 m whose base is at 9 m, 10 to 100 returns/m²" =>
            "two trees, the lower marked", 0.0 "trees off", under_a_crown;
        crown: "two level crowns 0.5 m apart, and 6 m" => "one tree, and two", 0.0 "trees off", level_crowns;
        crown: "1,000 points in one place, 10 m up" => "no crown that breaks its invariants",
            0.0 "unsound crowns", a_spot;
        crown: "voxels and cells that are no lengths" => "an error each", 0.0 "answers without one", no_lengths;
    }
}

/// Vegetation stands where `kind` says so.
fn classified(position: Vec<Vec3>, kind: impl Fn(Vec3) -> Kind) -> Classified {
    let mut cloud = empty_cloud();
    position.iter().for_each(|&p| push(&mut cloud, p));
    let kind = position.into_iter().map(kind).collect();
    Classified { cloud, kind, is_normalised: false }
}

fn all_ground(position: Vec<Vec3>) -> Classified {
    classified(position, |_| Kind::Ground)
}

fn found(position: Vec<Vec3>) -> Result<Classified> {
    found_by(position, Method::Smrf)
}

fn found_by(position: Vec<Vec3>, method: Method) -> Result<Classified> {
    let mut cloud = empty_cloud();
    position.into_iter().for_each(|p| push(&mut cloud, p));
    // So high that no heights are taken for heights above ground.
    cloud.frame = Frame::local(DVec3::new(0.0, 0.0, 5000.0));
    Ok(ground::classify(cloud, method)?.value)
}

fn built(classified: &Classified, cell_m: Option<f32>) -> Result<Terrain> {
    let options = TerrainOptions { cell_m, ..TerrainOptions::default() };
    let terrain = terrain::build(classified, &options)?.value;
    terrain.check().map_err(Error::new)?;
    Ok(terrain)
}

/// Chance places in a square from the origin at the height of a surface.
fn on(surface: impl Fn(Vec2) -> f32, side_m: f32, count: usize) -> Vec<Vec3> {
    let mut draws = Seed::new(9).derive("stability", count as u64).draws();
    (0..count)
        .map(|_| {
            let p = Vec2::new(draws.between(0.0, side_m), draws.between(0.0, side_m));
            p.extend(surface(p))
        })
        .collect()
}

fn slope(p: Vec2) -> f32 {
    0.4 * p.x - 0.2 * p.y + 50.0
}

/// Farthest that the terrain is from a surface, over the middle of a square, where `counts`.
fn worst(
    terrain: &Terrain,
    surface: impl Fn(Vec2) -> f32,
    side_m: f32,
    counts: impl Fn(Vec2) -> bool,
) -> f64 {
    const PLACES: usize = 60;
    let place = |k: usize| side_m * (0.1 + 0.8 * k as f32 / (PLACES - 1) as f32);
    let places = (0..PLACES).flat_map(|i| (0..PLACES).map(move |j| Vec2::new(place(i), place(j))));
    let off = |p: Vec2| match f64::from((terrain.height_at(p) - surface(p)).abs()) {
        d if d.is_finite() => d,
        _ => f64::INFINITY,
    };
    places.filter(|p| counts(*p)).map(off).fold(0.0, f64::max)
}

/// The filter knows no trend of a smaller plot.
const SIDE_M: f32 = 24.0;

fn tiny_voxels() -> Result<f64> {
    let points = on(slope, 10.0, 2_000);
    let kept = [1e-9, 0.0, -1.0, f32::NAN].map(|size| centres_of_mass(&points, size));
    let is_lost = |c: &Vec<Vec3>| c.len() + 10 < points.len() || c.iter().any(|p| !p.is_finite());
    Ok(kept.iter().filter(|c| is_lost(c)).count() as f64)
}

fn no_octree() -> Result<f64> {
    let points = on(slope, 100.0, 100);
    Ok(unrefused([0.0, -1.0, f32::NAN, 1e-9].map(|size| VoxelOctree::build(&points, size))))
}

fn one_voxel() -> Result<f64> {
    let at = Vec3::new(3.3, -7.7, 120.1);
    let tree = VoxelOctree::build(&vec![at; 100_000], 0.5)?;
    match tree.centres_of_mass() {
        [centre] => Ok(centre.distance(at).into()),
        _ => Ok(f64::INFINITY),
    }
}

fn too_few() -> Result<f64> {
    Ok(unrefused([0, 1, 2].map(|n| found(on(slope, 10.0, n)))))
}

fn all_alike() -> Result<f64> {
    let at = Vec3::new(5.0, 5.0, 100.0);
    let made = found(vec![at; 10_000]).and_then(|c| built(&c, None));
    Ok(made.map_or(0.0, |t| f64::from((t.height_at(Vec2::splat(5.0)) - at.z).abs())))
}

fn with_stray(z: f32) -> Result<f64> {
    let mut points = on(slope, 80.0, 20_000);
    points.push(Vec3::new(40.0, 40.0, z));
    let terrain = built(&found(points)?, Some(1.0))?;
    Ok(worst(&terrain, slope, 80.0, |_| true))
}

fn stray_below() -> Result<f64> {
    with_stray(-950.0)
}

fn stray_above() -> Result<f64> {
    with_stray(1050.0)
}

fn reversed() -> Result<f64> {
    let bump = |p: Vec2| slope(p) + if p.distance(Vec2::splat(30.0)) < 3.0 { 8.0 } else { 0.0 };
    let points = on(bump, 60.0, 15_000);
    let backwards: Vec<Vec3> = points.iter().rev().copied().collect();
    let (a, b) = (found(points)?, found(backwards)?);
    Ok(a.kind.iter().zip(b.kind.iter().rev()).filter(|(a, b)| a != b).count() as f64)
}

fn steep() -> Result<f64> {
    let cliff = |p: Vec2| 3f32.sqrt() * p.x;
    let made = found(on(cliff, 60.0, 20_000))?;
    let lost = made.kind.iter().filter(|&&k| k != Kind::Ground).count();
    Ok(lost as f64 / made.kind.len() as f64)
}

/// Farthest that points taken for ground are from a surface, where `counts`.
fn ground_off(
    made: &Classified,
    surface: impl Fn(Vec2) -> f32,
    counts: impl Fn(Vec2) -> bool,
) -> f64 {
    let ground = made.cloud.position.iter().zip(&made.kind).filter(|(_, k)| **k == Kind::Ground);
    let at = ground.map(|(p, _)| p).filter(|p| counts(p.truncate()));
    at.map(|p| f64::from((p.z - surface(p.truncate())).abs())).fold(0.0, f64::max)
}

fn small_steep() -> Result<f64> {
    let steep = |p: Vec2| p.x;
    let mut points = on(steep, 16.0, 2_500);
    points.extend(on(|p| p.x + 9.0, 16.0, 500));
    let made = found(points)?;
    if !made.kind.contains(&Kind::Ground) {
        return Err(Error::new("no ground was found"));
    }
    Ok(ground_off(&made, steep, |_| true))
}

fn cliffs() -> Result<f64> {
    let cliff = |p: Vec2| slope(p) + if p.x < 50.0 { 12.0 } else { 0.0 };
    let made = found(on(cliff, 100.0, 60_000))?;
    let beyond =
        made.cloud.position.iter().zip(&made.kind).filter(|(p, _)| (p.x - 50.0).abs() > 4.0);
    let (all, lost) =
        beyond.fold((0, 0), |(n, l), (_, k)| (n + 1, l + usize::from(*k != Kind::Ground)));
    Ok(lost as f64 / all as f64)
}

fn crest() -> Result<f64> {
    let crest = |p: Vec2| 40.0 - (p.x - 40.0).abs();
    let terrain = built(&found(on(crest, 80.0, 60_000))?, Some(1.0))?;
    Ok(worst(&terrain, crest, 80.0, |p| (p.x - 40.0).abs() > 4.0))
}

fn is_within(p: Vec2, middle_m: f32, half_m: f32) -> bool {
    (p - Vec2::splat(middle_m)).abs().max_element() < half_m
}

/// Points on a slope with a flat roof so wide, 6 m up, in its middle.
fn with_roof(side_m: f32, roof_m: f32) -> Vec<Vec3> {
    let middle = 0.5 * side_m;
    let top = slope(Vec2::splat(middle)) + 6.0 + 0.3 * roof_m;
    let surface = |p: Vec2| if is_within(p, middle, 0.5 * roof_m) { top } else { slope(p) };
    on(surface, side_m, (4.0 * side_m * side_m) as usize)
}

fn house() -> Result<f64> {
    let made = found(with_roof(100.0, 20.0))?;
    let roof = made.cloud.position.iter().zip(&made.kind);
    let roof = roof.filter(|(p, _)| is_within(p.truncate(), 50.0, 10.0));
    let (all, lost) =
        roof.fold((0, 0), |(n, l), (_, k)| (n + 1, l + usize::from(*k == Kind::Ground)));
    Ok(lost as f64 / all as f64)
}

fn hall() -> Result<f64> {
    let terrain = built(&found(with_roof(160.0, 60.0))?, Some(1.0))?;
    Ok(worst(&terrain, slope, 160.0, |p| !is_within(p, 80.0, 34.0)))
}

fn undergrowth() -> Result<f64> {
    let bushes = |p: Vec2| slope(p) + if is_within(p, 50.0, 15.0) { 1.0 } else { 0.0 };
    let terrain = built(&found(on(bushes, 100.0, 40_000))?, Some(1.0))?;
    Ok(worst(&terrain, slope, 100.0, |_| true))
}

fn mound() -> Result<f64> {
    let raised = |p: Vec2| {
        let off = p.distance(Vec2::splat(50.0)) / 15.0;
        slope(p) + 2.0 * (1.0 - off * off).max(0.0)
    };
    let mut most = 0.0f64;
    for method in [Method::Smrf, Method::Tin] {
        let terrain = built(&found_by(on(raised, 100.0, 40_000), method)?, Some(1.0))?;
        most = most.max(worst(&terrain, slope, 100.0, |_| true));
    }
    Ok(most)
}

fn steep_by_rules() -> Result<f64> {
    let steep = |p: Vec2| p.x;
    let made = found_by(on(steep, 60.0, 20_000), Method::VoxelRules)?;
    Ok(ground_off(&made, steep, |_| true))
}

fn terraces() -> Result<f64> {
    let steps = |p: Vec2| (p.x / 4.0).floor();
    let terrain = built(&found_by(on(steps, 60.0, 30_000), Method::Tin)?, Some(1.0))?;
    Ok(worst(&terrain, steps, 60.0, |p| (p.x / 4.0 - (p.x / 4.0).round()).abs() > 0.25))
}

fn hidden() -> Result<f64> {
    let seen = |p: Vec2| slope(p) + if is_within(p, 50.0, 10.0) { 15.0 } else { 0.0 };
    let made = found_by(on(seen, 100.0, 40_000), Method::VoxelRules)?;
    Ok(ground_off(&made, slope, |p| !is_within(p, 50.0, 14.0)))
}

fn dense() -> Result<f64> {
    let terrain = built(&found(on(slope, SIDE_M, 5_760_000))?, Some(0.25))?;
    Ok(worst(&terrain, slope, SIDE_M, |_| true))
}

fn small_plot() -> Result<f64> {
    let terrain = built(&found(on(slope, SIDE_M, 2_304))?, Some(0.25))?;
    Ok(worst(&terrain, slope, SIDE_M, |_| true))
}

fn sparse() -> Result<f64> {
    let terrain = built(&all_ground(on(slope, 400.0, 1_600)), None)?;
    Ok(worst(&terrain, slope, 400.0, |_| true))
}

fn cliff() -> Result<f64> {
    let step = |p: Vec2| if p.x < 40.0 { 12.0 } else { 0.0 };
    let terrain = built(&all_ground(on(step, 80.0, 60_000)), Some(1.0))?;
    Ok(worst(&terrain, step, 80.0, |p| (p.x - 40.0).abs() > 2.0))
}

fn on_a_line() -> Result<f64> {
    let line = (0..500).map(|i| Vec3::new(0.1 * i as f32, 20.0, 100.0 + 0.01 * i as f32));
    let terrain = built(&all_ground(line.collect()), Some(1.0))?;
    let off = |i: i32| {
        let x = 5.0 + i as f32;
        f64::from((terrain.height_at(Vec2::new(x, 20.0)) - 100.0 - 0.1 * x).abs())
    };
    Ok((0..40).map(off).fold(0.0, f64::max))
}

fn three_points() -> Result<f64> {
    let corners = [Vec2::ZERO, Vec2::new(30.0, 0.0), Vec2::new(0.0, 30.0)];
    let terrain = built(&all_ground(corners.map(|p| p.extend(slope(p))).to_vec()), Some(1.0))?;
    Ok(worst(&terrain, slope, 20.0, |p| p.x + p.y < 20.0))
}

fn gap() -> Result<f64> {
    let middle = Vec2::splat(60.0);
    let mut points = on(slope, 120.0, 30_000);
    points.retain(|p| p.truncate().distance(middle) > 30.0);
    let terrain = built(&all_ground(points), Some(1.0))?;
    Ok(worst(&terrain, slope, 120.0, |_| true))
}

fn bowed() -> Result<f64> {
    let mut points = on(slope, 100.0, 60_000);
    points.retain(|p| (40.0..44.0).contains(&p.truncate().distance(Vec2::new(50.0, 0.0))));
    let terrain = built(&all_ground(points), Some(1.0))?;
    Ok(worst(&terrain, slope, 100.0, |p| p.y < 40.0))
}

fn half_known() -> Result<f64> {
    let geometry = GridGeometry::covering([0.0; 2], [59.5; 2], 1.0);
    let mut grid = Grid::filled(geometry, 0.0f32);
    let mut is_known = vec![false; geometry.len()];
    for (row, col) in (0..geometry.rows).flat_map(|row| (0..30).map(move |col| (row, col))) {
        grid.set(col, row, col as f32);
        is_known[geometry.index(col, row)] = true;
    }
    inpaint::fill(&mut grid, &is_known);
    let beyond = |z: &f32| f64::from((-z).max(z - 29.0).max(0.0));
    Ok(grid.data.iter().map(beyond).fold(0.0, f64::max))
}

fn tiny_cells() -> Result<f64> {
    let made = all_ground(on(slope, 50.0, 1_000));
    Ok(unrefused([1e-6, 0.0, f32::NAN].map(|cell_m| built(&made, Some(cell_m)))))
}

fn high() -> Result<f64> {
    let peak = |p: Vec2| slope(p) + 8_848.0;
    let terrain = built(&all_ground(on(peak, 50.0, 20_000)), Some(1.0))?;
    Ok(worst(&terrain, peak, 50.0, |_| true))
}

fn far_outside() -> Result<f64> {
    let level = |_| 100.0;
    let terrain = built(&all_ground(on(level, 50.0, 5_000)), Some(1.0))?;
    let far = [1e4, -1e4, 1e9].map(|x| f64::from(terrain.height_at(Vec2::splat(x)) - 100.0).abs());
    Ok(far.into_iter().fold(0.0, f64::max))
}

fn crowns_of(points: Vec<Vec3>, is_tree: impl Fn(Vec3) -> bool) -> Result<Vec<Crown>> {
    let kind = |p: Vec3| if is_tree(p) { Kind::Vegetation } else { Kind::Ground };
    let classified = classified(points, kind);
    let terrain = built(&classified, Some(1.0))?;
    Ok(crown::detect(&classified, &terrain, 0.5, &CrownOptions::default())?.value)
}

fn no_trees() -> Result<f64> {
    Ok(crowns_of(on(slope, 50.0, 5_000), |_| false)?.len() as f64)
}

fn one_dome() -> Result<f64> {
    const HEIGHT_M: f32 = 18.0;
    let mut points = on(|_| 0.0, 50.0, 10_000);
    points.retain(|p| p.truncate().distance(Vec2::splat(25.0)) > 3.0);
    let dome = |p: Vec2| HEIGHT_M - (p - Vec2::splat(3.0)).length_squared();
    let crown = on(dome, 6.0, 3_000).into_iter().filter(|p| p.z > HEIGHT_M - 9.0);
    points.extend(crown.map(|p| p + Vec3::new(22.0, 22.0, 0.0)));
    match &crowns_of(points, |p| p.z > 1.0)?[..] {
        [crown] => Ok(f64::from(crown.height_m / HEIGHT_M - 1.0).abs()),
        _ => Ok(f64::INFINITY),
    }
}

fn lower_tree() -> Result<f64> {
    let dome = |x: f32, top_m: f32, half_m: f32| {
        let at = Vec2::new(x, 25.0);
        let height = move |p: Vec2| {
            let from_middle = (p - Vec2::splat(half_m)).length() / half_m;
            top_m - 0.5 * top_m * from_middle * from_middle
        };
        let points = on(height, 2.0 * half_m, 3_000).into_iter();
        let in_circle =
            points.filter(move |p| (p.truncate() - Vec2::splat(half_m)).length() < half_m);
        in_circle.map(move |p| p + (at - Vec2::splat(half_m)).extend(0.0))
    };
    let trees = |x: f32, top_m: f32| -> Result<f64> {
        let mut points = on(|_| 0.0, 50.0, 10_000);
        points.extend(dome(20.0, 20.0, 4.0).chain(dome(x, top_m, 2.0)));
        Ok(crowns_of(points, |p| p.z > 1.0)?.len() as f64)
    };
    Ok((trees(30.0, 11.0)? - 2.0).abs() + (trees(22.0, 16.0)? - 1.0).abs())
}

/// The upper tree lets every third pulse through, the lower one none.
fn under_a_crown() -> Result<f64> {
    let mut off = 0;
    for per_sq_m in [10, 20, 40, 100] {
        let side_m = 24.0;
        let mut draws = Seed::new(8).draws();
        let pulses = (side_m * side_m) as usize * per_sq_m;
        let points = (0..pulses).map(|k| {
            let p = Vec2::new(side_m * draws.unit(), side_m * draws.unit());
            let away = p.distance(Vec2::splat(12.0));
            let z = match away {
                r if r < 3.5 && k % 3 > 0 => 14.0 - r.powi(2) * (5.0 / 12.25) - draws.unit(),
                r if r < 1.8 => 5.0 - r,
                _ => 0.0,
            };
            p.extend(z)
        });
        let crowns = crowns_of(points.collect(), |p| p.z > 0.1)?;
        let marked = crowns.iter().filter(|c| c.is_understory).count();
        off += crowns.len().abs_diff(2) + marked.abs_diff(1);
    }
    Ok(off as f64)
}

fn level_crowns() -> Result<f64> {
    let trees = |gap_m: f32| -> Result<usize> {
        let mut points = on(|_| 0.0, 50.0, 40_000);
        for p in &mut points {
            let (along, across) = ((p.x - 25.0).abs() - 0.5 * gap_m, (p.y - 25.0).abs());
            if (0.0..5.0).contains(&along) && across < 2.5 {
                p.z = 15.0 - 0.05 * along;
            }
        }
        Ok(crowns_of(points, |p| p.z > 1.0)?.len())
    };
    Ok((trees(0.5)?.abs_diff(1) + trees(6.0)?.abs_diff(2)) as f64)
}

fn a_spot() -> Result<f64> {
    let mut points = on(|_| 0.0, 50.0, 10_000);
    points.extend([Vec3::new(25.0, 25.0, 10.0); 1_000]);
    let crowns = crowns_of(points, |p| p.z > 1.0)?;
    Ok(crowns.iter().filter(|c| c.check().is_err()).count() as f64)
}

fn no_lengths() -> Result<f64> {
    let classified = all_ground(on(slope, 50.0, 1_000));
    let terrain = built(&classified, Some(1.0))?;
    let usual = CrownOptions::default();
    let of = |voxel_m: f32, o: &CrownOptions| crown::detect(&classified, &terrain, voxel_m, o);
    let cell = |cell_m: f32| CrownOptions { cell_m: Some(cell_m), ..CrownOptions::default() };
    Ok(unrefused([
        of(0.0, &usual),
        of(-1.0, &usual),
        of(f32::NAN, &usual),
        of(0.5, &cell(0.0)),
        of(0.5, &cell(f32::NAN)),
    ]))
}
