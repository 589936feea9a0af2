//! The edge of scenes, files and landscapes.

use glam::{DVec3, Vec2, Vec3};

use super::super::super::landscape::DETAIL;
use super::super::super::model::model_scene;
use super::super::convergence::{empty_cloud, push};
use super::unrefused;
use crate::diagnostic::{Error, Result};
use crate::export::{self, Format, Job, Pictures, Profile};
use crate::frame::Frame;
use crate::ground::{Classified, Kind};
use crate::landscape::{self, Columns, Landscape, Layers, Shot, Source};
use crate::mesh::{Surface, TreeMesh};
use crate::render::Camera;
use crate::scene::{Instance, Scene, TreeFacts};
use crate::seed::Seed;
use crate::skeleton::stability::Case;
use crate::terrain::{self, TerrainOptions};
use crate::{species, texture};

pub(super) fn cases() -> Vec<(&'static str, Case)> {
    cases! {
        scene: "vertices and places that are not numbers" => "refused", 0.0 "scenes let through", not_numbers;
        scene: "a triangle without area, an index out of range" => "dropped; refused",
            0.0 "scenes let through", broken_triangles;
        export: "a scene of nothing" => "files, or an error; no panic",
            0.0 "formats that fail without an error", nothing;
        export: "positions counted in 16 bits, a tree of 33 m" => "within half a step, 0.5 mm",
            5.1e-4 "m", counted;
        export: "10⁵ trees of one model" => "a GLB of under 100 bytes a tree with instancing",
            100.0 "bytes a tree", many_instances;
        landscape: "a slope of 45° in voxels of 1 m" => "its ground within a voxel, at its border too",
            1.0 "m", sloping_voxels;
        landscape: "a scan of 39.5 m in voxels of 1.7 m" => "a block that ends within 1.5 voxels of it",
            1.5 "voxels", snug_landscape;
        landscape: "a mast one voxel thick, seen where a pixel is 8 voxels broad" =>
            "in every line of the picture, no wider than two pixels", 0.0 "lines off", far_mast;
        landscape: "a hill of 15 m, 4 m wide, seen from above by pixels of 4 m" => "no height that the ground has not",
            0.5 "m beyond", far_hill;
        landscape: "a cube of 5 m in voxels of 0.5 m, its sides touched by rays" => "as wide, to a voxel",
            0.5 "m", touched_cube;
        landscape: "a hole beside water amid a scan, and one at its end" => "a pond; land",
            0.0 "taken wrongly", holes;
        landscape: "voxels of 10⁻⁶ m, 0 and NaN" => "an error before memory is taken",
            0.0 "answers without one", tiny_landscape;
    }
}

/// A tree of one triangle standing in so many places.
fn scene_of(surface: Surface, places: impl Iterator<Item = Vec3>) -> Result<Scene> {
    let species = species::load("betula_pendula")?;
    let tree = TreeMesh { wood: surface, axes: 1, ..TreeMesh::default() };
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
    let job = Job { profile, ..Job::new("x", &formats) };
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

fn snug_landscape() -> Result<f64> {
    const VOXEL_M: f32 = 1.7;
    let columns = columns(VOXEL_M)?;
    let frame = Frame::local(DVec3::ZERO);
    let (scene, _) = Landscape::build(&columns, &DETAIL, frame, columns.first_m, VOXEL_M)?;
    let [low, high] = scene.bounds_m().map(|corner| corner.truncate());
    let beyond = low.abs().max(high - Vec2::splat(39.5));
    let short = (low.max(Vec2::splat(39.5) - high)).max_element() > 0.0;
    Ok(if short { f64::INFINITY } else { f64::from(beyond.max_element() / VOXEL_M) })
}

/// Voxels of 0.5 m of a cloud, and the terrain from it.
fn half_metre(classified: &Classified) -> Result<Landscape> {
    let options = TerrainOptions { cell_m: Some(0.5), ..TerrainOptions::default() };
    let terrain = terrain::build(classified, &options)?.value;
    let (columns, _) = Columns::of_scan(classified, &terrain, None, 0.5, &DETAIL)?;
    let frame = Frame::local(DVec3::ZERO);
    Ok(Landscape::build(&columns, &DETAIL, frame, columns.first_m, 0.5)?.0)
}

/// A picture of so many pixels across and down, each so wide where the camera looks at.
fn seen(
    scene: &Landscape,
    [eye, target]: [Vec3; 2],
    (pixels, pixel_m): (u32, f32),
) -> Result<Layers> {
    let half_m = 0.5 * pixels as f32 * pixel_m;
    let camera = Camera { eye, target, fov_y_rad: 2.0 * (half_m / eye.distance(target)).atan() };
    landscape::layers(scene, &Shot::new(camera, [pixels; 2]))
}

/// Ground of 40 m, a point every quarter metre.
fn ground_of(height: impl Fn(Vec2) -> f32) -> Classified {
    let mut cloud = empty_cloud();
    for i in 0..25_600 {
        let p = 0.25 * Vec2::new((i % 160) as f32, (i / 160) as f32);
        push(&mut cloud, p.extend(height(p)));
    }
    let kind = vec![Kind::Ground; cloud.len()];
    Classified { cloud, kind, is_normalised: false }
}

fn far_mast() -> Result<f64> {
    let mut classified = sloping();
    for k in 0..1_200 {
        push(&mut classified.cloud, Vec3::new(20.2, 20.2, 20.0 + 0.1 * k as f32));
        classified.kind.push(Kind::Vegetation);
    }
    // The middle pixels on the mast.
    let ends = [Vec3::new(20.2, -4_000.0, 90.0), Vec3::new(20.2, 20.2, 90.0)];
    let layers = seen(&half_metre(&classified)?, ends, (61, 4.0))?;
    let wide = |row: &[u8]| row.iter().filter(|class| **class == 5).count();
    let widths: Vec<usize> = layers.class.chunks_exact(61).map(wide).collect();
    // From 50 to 130 m: pixels of a height of 4 m about the middle at 90.
    Ok(widths[21..40].iter().filter(|wide| !(1..=2).contains(*wide)).count() as f64)
}

fn far_hill() -> Result<f64> {
    let hill = |p: Vec2| 15.0 * (-p.distance_squared(Vec2::splat(20.0)) / 4.0).exp();
    let eye = Vec3::new(20.0, 20.0, 4_000.0);
    let layers = seen(&half_metre(&ground_of(hill))?, [eye, eye.with_z(0.0)], (16, 4.0))?;
    let ground = layers.depth_m.iter().zip(&layers.class).filter(|(_, class)| **class == 2);
    let beyond = |depth: &f32| {
        let z = eye.z - depth;
        f64::from((-z).max(z - 15.0).max(0.0))
    };
    let all: Vec<f64> = ground.map(|(depth, _)| beyond(depth)).collect();
    match all.is_empty() {
        true => Err(Error::new("no ground was seen")),
        false => Ok(all.into_iter().fold(0.0, f64::max)),
    }
}

fn touched_cube() -> Result<f64> {
    let mut classified = ground_of(|_| 0.0);
    for k in 0..8_000 {
        let at = Vec3::new((k % 20) as f32, (k / 20 % 20) as f32, (k / 400) as f32);
        push(&mut classified.cloud, Vec3::new(17.6, 17.6, 10.1) + 0.25 * at);
        classified.kind.push(Kind::Vegetation);
    }
    // Its near side is 17.5 m north.
    let ends = [Vec3::new(20.0, -40.0, 12.5), Vec3::new(20.0, 17.5, 12.5)];
    let layers = seen(&half_metre(&classified)?, ends, (400, 0.05))?;
    let row = &layers.class[200 * 400..201 * 400];
    let wide_m = 0.05 * row.iter().filter(|class| **class == 5).count() as f64;
    Ok((wide_m - 5.0).abs())
}

fn holes() -> Result<f64> {
    let mut classified = ground_of(|_| 0.0);
    let is_hole =
        |p: Vec3, west_m: f32| (west_m..west_m + 12.0).contains(&p.x) && (p.y - 20.0).abs() < 6.0;
    for (p, class) in classified.cloud.position.iter().zip(&mut classified.cloud.class) {
        let is_shore = [5.0, 27.0]
            .iter()
            .any(|west_m| is_hole(*p + Vec3::X, *west_m) || is_hole(*p - Vec3::X, *west_m));
        *class = if is_shore { 9 } else { 2 };
    }
    // The second reaches the eastern end at 40 m.
    let kept: Vec<bool> = (classified.cloud.position.iter())
        .map(|p| !is_hole(*p, 5.0) && !is_hole(*p, 28.0))
        .collect();
    classified.cloud.retain(|i| kept[i]);
    classified.kind.truncate(classified.cloud.len());
    let terrain = terrain::build(&classified, &TerrainOptions::default())?.value;
    let (columns, _) = Columns::of_scan(&classified, &terrain, None, 0.5, &DETAIL)?;
    let is_blue = |x: u32| {
        let [red, _, blue] = columns.colours(x, 40)[0];
        blue > red
    };
    Ok(f64::from(u8::from(!is_blue(22)) + u8::from(is_blue(70))))
}

fn tiny_landscape() -> Result<f64> {
    Ok(unrefused([1e-6, 0.0, f32::NAN].map(columns)))
}
