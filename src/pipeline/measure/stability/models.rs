//! The edge of tree models: skeletons, meshes, levels, textures.

use glam::{DVec3, Vec2, Vec3};

use super::super::super::cover::Subject;
use super::super::super::detail::mesh_options;
use super::super::super::levels::bounds;
use super::super::super::model::model_scene;
use super::unrefused;
use crate::diagnostic::Result;
use crate::lod::{Silhouettes, Views};
use crate::mesh::{self, FoliageLevel, Junctions, MeshOptions, TreeMesh};
use crate::render::capture::Sitter;
use crate::scene::Apart;
use crate::seed::Seed;
use crate::skeleton::stability::Case;
use crate::skeleton::{self, Detail, NO_PARENT, Skeleton, Target};
use crate::species::{self, Species};
use crate::texture::{self, Atlas};

pub(super) fn cases() -> Vec<(&'static str, Case)> {
    cases! {
        skeleton: "trees of 0.1 and 130 m" => "a sound tree of that height",
            0.02 "of the height", smallest_and_tallest;
        skeleton: "heights of 0, −5, 131 m and NaN" => "an error each", 0.0 "answers without one", no_heights;
        mesh: "a needle tree of 5 million triangles" => "sound, and nearly as many, but no more",
            0.05 "of them missing", needles;
        mesh: "200 triangles for a tree of 20,000 nodes" => "a sound tree of about as many",
            3.0 "times the budget", tiny_budget;
        mesh: "a pole of one internode" => "sound, closed", 1e-6 "of its area open", pole;
        mesh: "radii from 10⁻⁶ to 10³ m along one stem" => "sound", 0.0 "faults", radii;
        mesh: "nodes 10⁻⁶ m apart" => "sound", 0.0 "faults", crowded;
        mesh: "a stem that turns back on itself" => "sound", 0.0 "faults", turned_back;
        mesh: "a bend sharper than the stem is thick" => "sound, closed", 1e-6 "of its area open", sharp_bend;
        mesh: "64 branches out of one node" => "sound", 0.0 "faults", star;
        mesh: "tolerances of 0, 10⁻⁹, 10⁹ m and NaN" => "clamped, sound", 0.0 "faults", wild_tolerances;
        mesh: "a skeleton 20 km wide, one with NaN, one of a single node" => "an error each",
            0.0 "answers without one", no_trees;
        levels: "a silhouette beside itself" => "no distance", 0.0 "m", same_silhouette;
        levels: "a silhouette beside itself shifted by about 1 m, in whole samples" => "that, to one sample",
            1.0 "samples off", shifted_silhouette;
        levels: "a silhouette beside itself shifted by a quarter of a sample" => "half a sample, RMS",
            0.5 "samples", nearly_same_silhouette;
        levels: "the worst of that" => "a twig's length: a leaf smaller than a sample comes or goes",
            1.0 "of it", farthest_of_nearly_same;
        texture: "textures of 1 and 3 pixels asked for" => "64 drawn", 0.0 "pixels off", texture_sizes;
    }
}

fn birch() -> Result<Species> {
    species::load("betula_pendula")
}

fn grown(species: &Species, height_m: f32, max_nodes: u32) -> Result<Skeleton> {
    let detail = Detail { max_nodes, attractor_spacing_m: None };
    let target = Target::FromSpecies { height_m: Some(height_m) };
    skeleton::grow(species, target, detail, Seed::new(1))
}

fn meshed(skeleton: &Skeleton, options: &MeshOptions) -> Result<TreeMesh> {
    let tree = mesh::build(skeleton, &birch()?, &Atlas::whole(0.4), options, Seed::new(1))?;
    tree.check()?;
    Ok(tree)
}

const WOOD: MeshOptions =
    MeshOptions { triangle_budget: None, foliage: FoliageLevel::None, ..MeshOptions::FOREST };

/// Meshes it welded and intersecting.
fn faults(skeleton: &Skeleton) -> Result<f64> {
    let both = [Junctions::Welded, Junctions::Intersecting];
    for junctions in both {
        meshed(skeleton, &MeshOptions { junctions, ..WOOD })?;
    }
    Ok(0.0)
}

/// A stem through these places.
fn stem(places: &[(Vec3, f32)]) -> Skeleton {
    let n = places.len();
    Skeleton {
        position: places.iter().map(|p| p.0).collect(),
        parent: (0..n as u32).map(|i| if i == 0 { NO_PARENT } else { i - 1 }).collect(),
        radius_m: places.iter().map(|p| p.1).collect(),
        axis: vec![0; n],
        order: vec![0; n],
        birth: (0..n).map(|i| u16::from(i > 0)).collect(),
        dead: Vec::new(),
    }
}

fn smallest_and_tallest() -> Result<f64> {
    let mut worst = 0.0f64;
    for name in ["larix_sibirica", "betula_pendula", "corylus_avellana"] {
        let species = species::load(name)?;
        for height_m in [0.1, 130.0] {
            let tree = grown(&species, height_m, 700)?;
            tree.check()?;
            worst = worst.max(f64::from(tree.height_m() / height_m - 1.0).abs());
        }
    }
    Ok(worst)
}

fn no_heights() -> Result<f64> {
    let species = birch()?;
    Ok(unrefused([0.0, -5.0, 131.0, f32::NAN].map(|h| grown(&species, h, 300))))
}

fn needles() -> Result<f64> {
    const MOST: usize = 5_000_000;
    let species = species::load("larix_sibirica")?;
    let skeleton = grown(&species, species.size.height_m, 40_000)?;
    let options = MeshOptions {
        foliage: FoliageLevel::Geometry,
        triangle_budget: Some(MOST),
        ..mesh_options(MOST)
    };
    let atlas = Atlas::whole(species.foliage.twig_length_m);
    let tree = mesh::build(&skeleton, &species, &atlas, &options, Seed::new(1))?;
    tree.check()?;
    let missing = 1.0 - tree.triangles() as f64 / MOST as f64;
    Ok(if missing < 0.0 { f64::INFINITY } else { missing })
}

fn tiny_budget() -> Result<f64> {
    const MOST: usize = 200;
    let skeleton = grown(&birch()?, 20.0, 20_000)?;
    let tree = meshed(&skeleton, &mesh_options(MOST))?;
    Ok(tree.triangles() as f64 / MOST as f64)
}

fn pole() -> Result<f64> {
    open_share(&meshed(&stem(&[(Vec3::ZERO, 0.2), (Vec3::Z * 5.0, 0.1)]), &WOOD)?)
}

/// The areas of a closed surface, as vectors, add up to nothing.
fn open_share(tree: &TreeMesh) -> Result<f64> {
    let (mut sum, mut all) = (DVec3::ZERO, 0.0);
    for s in tree.woods() {
        let corner = |i: u32| s.position[i as usize].as_dvec3();
        for t in s.index.chunks_exact(3) {
            let a = corner(t[0]);
            let area = (corner(t[1]) - a).cross(corner(t[2]) - a);
            sum += area;
            all += area.length();
        }
    }
    Ok(sum.length() / all)
}

/// A stem of 1 m with bends of 120° after 0.2 m.
fn sharp_bend() -> Result<f64> {
    let mut at = Vec3::ZERO;
    let places = (0..8).map(|k| {
        let here = at;
        let side = if k % 2 == 0 { 0.17 } else { -0.17 };
        at += if k == 0 { Vec3::Z } else { Vec3::new(side, 0.0, 0.1) };
        (here, 0.5)
    });
    open_share(&meshed(&stem(&places.collect::<Vec<_>>()), &WOOD)?)
}

fn radii() -> Result<f64> {
    let radius_m = |k: i32| 1e3 * 10f32.powf(-f32::from(k as i16));
    let places: Vec<(Vec3, f32)> =
        (0..10).map(|k| (Vec3::Z * (500.0 * k as f32), radius_m(k))).collect();
    faults(&stem(&places))
}

fn crowded() -> Result<f64> {
    let places: Vec<(Vec3, f32)> = (0..200)
        .map(|k| {
            let z = if k < 100 { 1e-6 * k as f32 } else { 0.05 * (k - 99) as f32 };
            (Vec3::Z * z, 0.1 - 4e-4 * k as f32)
        })
        .collect();
    faults(&stem(&places))
}

fn turned_back() -> Result<f64> {
    let height = |k: i32| if k <= 10 { k as f32 } else { 20.0 - k as f32 };
    let places: Vec<(Vec3, f32)> = (0..18)
        .map(|k| (Vec3::new(0.01 * k as f32, 0.0, height(k)), 0.2 - 0.005 * k as f32))
        .collect();
    faults(&stem(&places))
}

fn star() -> Result<f64> {
    let mut s = stem(&[(Vec3::ZERO, 0.3), (Vec3::Z * 2.0, 0.25), (Vec3::Z * 4.0, 0.1)]);
    for k in 0..64 {
        let turned = Vec2::from_angle(k as f32 / 64.0 * std::f32::consts::TAU) * 2.0;
        s.position.push(turned.extend(2.5));
        s.parent.push(1);
        s.radius_m.push(0.05);
        s.axis.push(k + 1);
        s.order.push(1);
        s.birth.push(1);
    }
    faults(&s)
}

fn wild_tolerances() -> Result<f64> {
    let skeleton = grown(&birch()?, 10.0, 100)?;
    for tolerance_m in [0.0, 1e-9, 1e9, f32::NAN] {
        meshed(&skeleton, &MeshOptions { tolerance_m, ..WOOD })?;
    }
    Ok(0.0)
}

fn no_trees() -> Result<f64> {
    let wide = stem(&[(Vec3::ZERO, 1.0), (Vec3::Z * 2e4, 0.5)]);
    let unsound = stem(&[(Vec3::ZERO, 1.0), (Vec3::NAN, 0.5)]);
    let single = stem(&[(Vec3::ZERO, 1.0)]);
    Ok(unrefused([wide, unsound, single].map(|s| meshed(&s, &WOOD))))
}

/// A birch beside itself, moved sideways; metres, and the side of a sample.
fn beside(shift_m: f32) -> Result<(Apart, f32)> {
    let species = birch()?;
    let skeleton = grown(&species, 10.0, 300)?;
    let textures = texture::for_species(&species, 64, Seed::new(1));
    let subject =
        Subject { skeleton: &skeleton, species: &species, textures: &textures, seed: Seed::new(1) };
    let tree = subject.mesh(&mesh_options(2_000))?;
    let mut moved = tree.clone();
    for s in moved.surfaces_mut() {
        s.position.iter_mut().for_each(|p| p.z += shift_m);
    }
    let scene = model_scene(&species, vec![tree, moved], textures);
    let models: Vec<_> = scene.prototypes.iter().map(|p| &p.parts[..]).collect();
    let (a, b) = (bounds(models[0]), bounds(models[1]));
    let around = (a.0.min(b.0), a.1.max(b.1));
    let sitter = Sitter::covers(&models, &scene.materials, &scene.textures);
    let of = |model| Silhouettes::of(&sitter, model, around, Views::Sides);
    let (first, second) = (of(0)?, of(1)?);
    Ok((first.apart(&second), first.sample_m))
}

fn same_silhouette() -> Result<f64> {
    Ok(beside(0.0)?.0.worst_m.into())
}

fn shifted_silhouette() -> Result<f64> {
    let shift_m = in_samples(1.0)?;
    let (Apart { worst_m, .. }, sample_m) = beside(shift_m)?;
    // Leaves beside the way may be nearer than the place moved from, but the foot is alone.
    Ok(f64::from((worst_m - shift_m).abs() / sample_m))
}

/// About as far, in whole samples: no leaf smaller than one comes or goes. What is seen is as large as
/// both trees together, and so are samples.
fn in_samples(mut shift_m: f32) -> Result<f32> {
    for _ in 0..6 {
        let (_, sample_m) = beside(shift_m)?;
        shift_m = (shift_m / sample_m).round() * sample_m;
    }
    Ok(shift_m)
}

fn nearly_same_silhouette() -> Result<f64> {
    let (Apart { rms_m, .. }, sample_m) = by_a_quarter()?;
    Ok((rms_m / sample_m).into())
}

fn farthest_of_nearly_same() -> Result<f64> {
    Ok((by_a_quarter()?.0.worst_m / birch()?.foliage.twig_length_m).into())
}

fn by_a_quarter() -> Result<(Apart, f32)> {
    let (_, sample_m) = beside(0.0)?;
    beside(0.25 * sample_m)
}

fn texture_sizes() -> Result<f64> {
    let species = birch()?;
    let drawn = |px| f64::from(texture::leaf(&species, px, Seed::new(1)).width());
    Ok((drawn(1) - 64.0).abs() + (drawn(3) - 64.0).abs())
}
