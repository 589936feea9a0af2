//! The edge of meshes, levels, textures, scenes, files and landscapes.

use glam::{DVec3, Vec2, Vec3};

use super::super::super::cover::Subject;
use super::super::super::forest::{mesh_options, model_scene};
use super::super::super::landscape::DETAIL;
use super::super::super::levels::bounds;
use super::super::convergence::{empty_cloud, push};
use crate::diagnostic::{Error, Result};
use crate::export::{self, Format, Job, Pictures, Profile, WindAs};
use crate::frame::Frame;
use crate::ground::{Classified, Kind};
use crate::landscape::{self, Columns, Landscape};
use crate::lod::{Silhouettes, Views};
use crate::mesh::{self, FoliageLevel, Junctions, MeshOptions, Surface, TreeMesh};
use crate::render::capture::Sitter;
use crate::scene::{Instance, Scene, TreeFacts};
use crate::seed::Seed;
use crate::skeleton::stability::Case;
use crate::skeleton::{self, Detail, NO_PARENT, Skeleton, Target};
use crate::species::{self, Species};
use crate::terrain::{self, TerrainOptions};
use crate::texture::{self, Atlas};

pub(super) fn cases() -> Vec<(&'static str, Case)> {
    let case = Case::new;
    vec![
        (
            "skeleton",
            case(
                "trees of 0.1 and 130 m",
                "a sound tree of that height",
                (0.02, "of the height"),
                smallest_and_tallest,
            ),
        ),
        (
            "skeleton",
            case(
                "heights of 0, −5, 131 m and NaN",
                "an error each",
                (0.0, "answers without one"),
                no_heights,
            ),
        ),
        (
            "mesh",
            case(
                "a needle tree of 5 million triangles",
                "sound, and no more than that",
                (0.0, "triangles too many"),
                needles,
            ),
        ),
        (
            "mesh",
            case(
                "200 triangles for a tree of 20,000 nodes",
                "a sound tree of about as many",
                (3.0, "times the budget"),
                tiny_budget,
            ),
        ),
        (
            "mesh",
            case("a pole of one internode", "sound, closed", (1e-6, "of its area open"), pole),
        ),
        ("mesh", case("radii from 10⁻⁶ to 10³ m along one stem", "sound", (0.0, "faults"), radii)),
        ("mesh", case("nodes 10⁻⁶ m apart", "sound", (0.0, "faults"), crowded)),
        ("mesh", case("a stem that turns back on itself", "sound", (0.0, "faults"), turned_back)),
        ("mesh", case("64 branches out of one node", "sound", (0.0, "faults"), star)),
        (
            "mesh",
            case(
                "tolerances of 0, 10⁻⁹, 10⁹ m and NaN",
                "clamped, sound",
                (0.0, "faults"),
                wild_tolerances,
            ),
        ),
        (
            "mesh",
            case(
                "a skeleton 20 km wide, one with NaN, one of a single node",
                "an error each",
                (0.0, "answers without one"),
                no_trees,
            ),
        ),
        ("levels", case("a silhouette beside itself", "no distance", (0.0, "m"), same_silhouette)),
        (
            "levels",
            case(
                "a silhouette beside itself shifted by 1 m",
                "1 m, to one sample",
                (1.0, "samples off"),
                shifted_silhouette,
            ),
        ),
        (
            "texture",
            case(
                "textures of 1 and 3 pixels asked for",
                "64 drawn",
                (0.0, "pixels off"),
                texture_sizes,
            ),
        ),
        (
            "scene",
            case(
                "vertices and places that are not numbers",
                "refused",
                (0.0, "scenes let through"),
                not_numbers,
            ),
        ),
        (
            "scene",
            case(
                "a triangle without area, an index out of range",
                "dropped; refused",
                (0.0, "scenes let through"),
                broken_triangles,
            ),
        ),
        (
            "export",
            case(
                "a scene of nothing",
                "files, or an error; no panic",
                (0.0, "formats that fail without an error"),
                nothing,
            ),
        ),
        (
            "export",
            case(
                "positions counted in 16 bits, a tree of 33 m",
                "within half a step, 0.5 mm",
                (5.1e-4, "m"),
                counted,
            ),
        ),
        (
            "export",
            case(
                "10⁵ trees of one model",
                "a GLB of under 100 bytes a tree with instancing",
                (100.0, "bytes a tree"),
                many_instances,
            ),
        ),
        (
            "landscape",
            case(
                "a slope of 45° in voxels of 1 m",
                "its ground within a voxel, at its border too",
                (1.0, "m"),
                sloping_voxels,
            ),
        ),
        (
            "landscape",
            case(
                "voxels of 10⁻⁶ m, 0 and NaN",
                "an error before memory is taken",
                (0.0, "answers without one"),
                tiny_landscape,
            ),
        ),
    ]
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

fn unrefused<T>(outcomes: impl IntoIterator<Item = Result<T>>) -> f64 {
    outcomes.into_iter().filter(Result::is_ok).count() as f64
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
    if tree.triangles() < MOST / 2 {
        return Err(Error::new(format!("{} triangles of needles", tree.triangles())));
    }
    Ok(tree.triangles().saturating_sub(MOST) as f64)
}

fn tiny_budget() -> Result<f64> {
    const MOST: usize = 200;
    let skeleton = grown(&birch()?, 20.0, 20_000)?;
    let tree = meshed(&skeleton, &mesh_options(MOST))?;
    Ok(tree.triangles() as f64 / MOST as f64)
}

/// The areas of a closed surface, as vectors, add up to nothing.
fn pole() -> Result<f64> {
    let tree = meshed(&stem(&[(Vec3::ZERO, 0.2), (Vec3::Z * 5.0, 0.1)]), &WOOD)?;
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
fn beside(shift_m: f32) -> Result<(f32, f32)> {
    let species = birch()?;
    let skeleton = grown(&species, 10.0, 300)?;
    let textures = texture::for_species(&species, 64, Seed::new(1));
    let subject =
        Subject { skeleton: &skeleton, species: &species, textures: &textures, seed: Seed::new(1) };
    let tree = subject.mesh(&mesh_options(2_000))?;
    let mut moved = tree.clone();
    for s in [&mut moved.wood, &mut moved.upper_wood, &mut moved.twig_wood, &mut moved.foliage] {
        s.position.iter_mut().for_each(|p| p.z += shift_m);
    }
    let scene = model_scene(&species, vec![tree, moved], textures);
    let models: Vec<_> = scene.prototypes.iter().map(|p| &p.parts[..]).collect();
    let (a, b) = (bounds(models[0]), bounds(models[1]));
    let around = (a.0.min(b.0), a.1.max(b.1));
    let sitter = Sitter::outlines(&models, &scene.materials, &scene.textures);
    let of = |model| Silhouettes::of(&sitter, model, around, Views::Sides);
    let (first, second) = (of(0)?, of(1)?);
    Ok((first.apart(&second).worst_m, first.sample_m))
}

fn same_silhouette() -> Result<f64> {
    Ok(beside(0.0)?.0.into())
}

fn shifted_silhouette() -> Result<f64> {
    let (worst_m, sample_m) = beside(1.0)?;
    // Leaves beside the way may be nearer than the place moved from, but the foot is alone.
    Ok(f64::from((worst_m - 1.0).abs() / sample_m))
}

fn texture_sizes() -> Result<f64> {
    let species = birch()?;
    let drawn = |px| f64::from(texture::leaf(&species, px, Seed::new(1)).width());
    Ok((drawn(1) - 64.0).abs() + (drawn(3) - 64.0).abs())
}

/// A tree of one triangle standing in so many places.
fn scene_of(surface: Surface, places: impl Iterator<Item = Vec3>) -> Result<Scene> {
    let species = birch()?;
    let tree = TreeMesh {
        wood: surface,
        upper_wood: Surface::default(),
        twig_wood: Surface::default(),
        foliage: Surface::default(),
        axes: 1,
        unmeshed_axes: 0,
        sagitta_m: 0.0,
        twig_scale: 1.0,
    };
    let mut scene = model_scene(&species, vec![tree], texture::plain(&species));
    scene.instances = places
        .enumerate()
        .map(|(i, position)| Instance {
            name: format!("tree_{i}"),
            prototype: 0,
            position,
            yaw_rad: 0.0,
            scale: Vec3::ONE,
            facts: TreeFacts {
                id: i.to_string(),
                species: species.name.clone(),
                height_m: 1.0,
                crown_diameter_m: 1.0,
                crown_base_height_m: 0.1,
                stem_diameter_m: 0.1,
                condition: "I",
                confidence: 1.0,
            },
        })
        .collect();
    Ok(scene)
}

fn triangle(height_m: f32) -> Surface {
    Surface {
        position: vec![Vec3::ZERO, Vec3::X, Vec3::Z * height_m],
        normal: vec![Vec3::NEG_Y; 3],
        uv: vec![Vec2::ZERO, Vec2::X, Vec2::Y],
        index: vec![0, 1, 2],
        ..Surface::default()
    }
}

fn not_numbers() -> Result<f64> {
    let mut bent = triangle(1.0);
    bent.position[1] = Vec3::NAN;
    let mut dark = triangle(1.0);
    dark.normal[1] = Vec3::splat(f32::INFINITY);
    let one = || [Vec3::ZERO].into_iter();
    let scenes = [
        scene_of(bent, one())?,
        scene_of(dark, one())?,
        scene_of(triangle(1.0), [Vec3::NAN].into_iter())?,
        scene_of(triangle(1.0), [Vec3::splat(f32::INFINITY)].into_iter())?,
    ];
    Ok(unrefused(scenes.map(Scene::validate)))
}

fn broken_triangles() -> Result<f64> {
    let one = || [Vec3::ZERO].into_iter();
    let mut outside = triangle(1.0);
    outside.index[2] = 7;
    let refused = unrefused([scene_of(outside, one())?.validate()]);
    let mut flat = triangle(1.0);
    flat.index.extend([0, 1, 1]);
    let mut scene = scene_of(flat, one())?;
    let dropped = scene.prune().triangles;
    scene.validate()?;
    Ok(refused + f64::from(dropped != 1))
}

const FORMATS: [Format; 7] =
    [Format::Glb, Format::Gltf, Format::Usda, Format::Usdc, Format::Usdz, Format::X3d, Format::Obj];

/// Bytes of a scene's files.
fn bytes(scene: Scene, format: Format, profile: Profile) -> Result<usize> {
    let mut scene = scene;
    scene.prune();
    let scene = scene.validate()?;
    let formats = [format];
    let job = Job { stem: "x", formats: &formats, profile, wind: WindAs::Attribute };
    let pictures = Pictures::encode(&scene, &job.picture_formats())?;
    let mut all = 0;
    for file in export::files(&scene, &pictures, &job)?.value {
        let mut held = std::io::Cursor::new(Vec::new());
        file.content.write(&mut held).map_err(|e| Error::new(e.to_string()))?;
        all += held.into_inner().len();
    }
    Ok(all)
}

fn nothing() -> Result<f64> {
    let empty = || Scene::empty("nothing".into(), Frame::local(DVec3::ZERO));
    let failed = FORMATS.iter().filter(|&&format| {
        bytes(empty(), format, Profile::Dcc).is_err_and(|e| e.message().is_empty())
    });
    Ok(failed.count() as f64)
}

fn counted() -> Result<f64> {
    let mut scene = scene_of(triangle(33.0), [Vec3::ZERO].into_iter())?;
    let mut draws = Seed::new(4).draws();
    let surface = &mut scene.prototypes[0].parts[0].surface;
    for k in 0..1_000u32 {
        let corner = |x: f32, z: f32| Vec3::new(x, 0.1 * x, z);
        let (x, z) = (draws.between(-8.0, 8.0), draws.between(0.0, 32.0));
        surface.position.extend([corner(x, z), corner(x + 0.5, z), corner(x, z + 0.5)]);
        surface.normal.extend([Vec3::NEG_Y; 3]);
        surface.uv.extend([Vec2::ZERO, Vec2::X, Vec2::Y]);
        surface.index.extend([3 * k + 3, 3 * k + 4, 3 * k + 5]);
    }
    scene.prune();
    Ok(export::worst_shift_m(&scene.validate()?, Format::Glb, Profile::Web).into())
}

fn many_instances() -> Result<f64> {
    const TREES: usize = 100_000;
    let place = |i: usize| Vec3::new((i % 400) as f32, (i / 400) as f32, 0.0) * 5.0;
    let scene = scene_of(triangle(1.0), (0..TREES).map(place))?;
    Ok(bytes(scene, Format::Glb, Profile::Web)? as f64 / TREES as f64)
}

/// Ground of a slope, a point every half metre.
fn sloping() -> Classified {
    let mut cloud = empty_cloud();
    for i in 0..6_400 {
        let (x, y) = (0.5 * (i % 80) as f32, 0.5 * (i / 80) as f32);
        push(&mut cloud, Vec3::new(x, y, x));
    }
    let kind = vec![Kind::Ground; cloud.len()];
    Classified { cloud, kind, is_normalised: false }
}

fn columns(voxel_m: f32) -> Result<Columns> {
    let classified = sloping();
    let options = TerrainOptions { cell_m: Some(1.0), ..TerrainOptions::default() };
    let terrain = terrain::build(&classified, &options)?.value;
    Ok(Columns::of_scan(&classified, &terrain, None, voxel_m, &DETAIL)?.0)
}

fn sloping_voxels() -> Result<f64> {
    let columns = columns(1.0)?;
    let (first_m, frame) = (columns.first_m, Frame::local(DVec3::ZERO));
    let (scene, _) = Landscape::build(&columns, &DETAIL, frame, first_m, 1.0)?;
    Ok(landscape::surface_error(&scene, &columns).ground_worst_m)
}

fn tiny_landscape() -> Result<f64> {
    Ok(unrefused([1e-6, 0.0, f32::NAN].map(columns)))
}
