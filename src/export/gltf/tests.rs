//! The engine and web profiles, read back by a reader written for these tests, for the gltf crate
//! knows none of their extensions.

use std::collections::BTreeMap;

use glam::{Mat4, Quat, Vec3};
use serde_json::Value;

use super::super::{Format, Job, OutputFile, Pictures, files};
use super::*;
use crate::mesh::Surface;
use crate::raster::Picture;
use crate::scene::sample::{forest, tetrahedron};
use crate::scene::{Alpha, Apart, Collider, ColliderShape, Level, Part, Scene, ValidScene};

/// Three forms, a collider and wind on every model.
fn sample() -> ValidScene {
    let mut scene = forest(&["Larix sibirica", "Betula pendula"], 60, 200.0);
    let body = tetrahedron();
    for prototype in &mut scene.prototypes {
        prototype.colliders = vec![Collider { shape: ColliderShape::Convex, body: body.clone() }];
        for part in &mut prototype.parts {
            let count = part.surface.position.len();
            part.surface.wind = (0..count).map(|i| [i as u8, 7, 3, 255]).collect();
        }
        for (name, parts, rms_m) in [("LOD1", 2, 0.05), ("LOD2", 1, 0.4)] {
            prototype.levels.push(Level {
                name: name.into(),
                parts: prototype.parts[..parts].to_vec(),
                silhouette: Apart { worst_m: 1.0, rms_m },
                octahedral: None,
            });
        }
    }
    scene.validate().unwrap()
}

/// A GLB, its compressed views decoded.
struct Read {
    json: Value,
    buffers: Vec<Vec<u8>>,
}

impl Read {
    fn new(bytes: &[u8]) -> Read {
        let word = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize;
        assert_eq!(word(8), bytes.len());
        let end = 20 + word(12);
        let json: Value = serde_json::from_slice(&bytes[20..end]).unwrap();
        let binary = bytes[end + 8..].to_vec();
        assert_eq!(word(end), binary.len());
        let mut read = Read { buffers: vec![binary], json };
        if let Some(decoded) = read.json["buffers"].get(1) {
            assert_eq!(decoded["extensions"]["EXT_meshopt_compression"]["fallback"], true);
            read.buffers.push(vec![0; number(&decoded["byteLength"])]);
            read.decode();
        }
        read
    }

    fn decode(&mut self) {
        for view in self.json["bufferViews"].as_array().unwrap() {
            let packed = &view["extensions"]["EXT_meshopt_compression"];
            if packed.is_null() {
                continue;
            }
            let (count, stride) = (number(&packed["count"]), number(&packed["byteStride"]));
            let from = offset(packed);
            let encoded = &self.buffers[0][from..from + number(&packed["byteLength"])];
            let decoded: Vec<u8> = match (packed["mode"].as_str().unwrap(), stride) {
                ("TRIANGLES", 2) => {
                    let index: Vec<u16> = meshopt::decode_index_buffer(encoded, count).unwrap();
                    bytemuck::cast_slice(&index).to_vec()
                }
                ("TRIANGLES", _) => {
                    let index: Vec<u32> = meshopt::decode_index_buffer(encoded, count).unwrap();
                    bytemuck::cast_slice(&index).to_vec()
                }
                (_, 4) => vertices::<4>(encoded, count),
                (_, 8) => vertices::<8>(encoded, count),
                (_, 12) => vertices::<12>(encoded, count),
                (_, _) => vertices::<16>(encoded, count),
            };
            assert_eq!(decoded.len(), number(&view["byteLength"]));
            let to = offset(view);
            self.buffers[1][to..to + decoded.len()].copy_from_slice(&decoded);
        }
    }

    /// Elements as numbers, normalized where the accessor says so.
    fn accessor(&self, number_of: &Value) -> Vec<Vec<f64>> {
        let accessor = &self.json["accessors"][number(number_of)];
        let view = &self.json["bufferViews"][number(&accessor["bufferView"])];
        let buffer = &self.buffers[number(&view["buffer"])];
        let width = match accessor["type"].as_str().unwrap() {
            "SCALAR" => 1,
            "VEC2" => 2,
            "VEC3" => 3,
            _ => 4,
        };
        let kind = number(&accessor["componentType"]);
        let size = match kind {
            5120 | 5121 => 1,
            5122 | 5123 => 2,
            _ => 4,
        };
        let stride = view["byteStride"].as_u64().map_or(width * size, |s| s as usize);
        let first = offset(view) + offset(accessor);
        let is_normalized = accessor["normalized"] == true;
        let one = |at: usize| -> f64 {
            let b = &buffer[at..at + size];
            let (value, most) = match kind {
                5120 => (f64::from(b[0] as i8), 127.0),
                5121 => (f64::from(b[0]), 255.0),
                5122 => (f64::from(i16::from_le_bytes(b.try_into().unwrap())), 32767.0),
                5123 => (f64::from(u16::from_le_bytes(b.try_into().unwrap())), 65535.0),
                5125 => (f64::from(u32::from_le_bytes(b.try_into().unwrap())), 1.0),
                _ => (f64::from(f32::from_le_bytes(b.try_into().unwrap())), 1.0),
            };
            if is_normalized { value / most } else { value }
        };
        let element = |i: usize| (0..width).map(|k| one(first + i * stride + k * size)).collect();
        let elements: Vec<Vec<f64>> = (0..number(&accessor["count"])).map(element).collect();
        // Bounds are of the numbers as stored.
        for (end, pick) in [("min", f64::min as fn(f64, f64) -> f64), ("max", f64::max)] {
            let Some(told) = accessor[end].as_array() else { continue };
            for (k, told) in told.iter().enumerate() {
                assert!(kind == 5126 || told.is_i64(), "{told}");
                let found = elements.iter().map(|e| e[k]).reduce(pick).unwrap();
                let stored = if is_normalized { (found * 32767.0).round() } else { found };
                assert_eq!(told.as_f64().unwrap() as f32, stored as f32);
            }
        }
        elements
    }

    fn vectors(&self, number_of: &Value) -> Vec<Vec3> {
        let vector = |v: Vec<f64>| Vec3::new(v[0] as f32, v[1] as f32, v[2] as f32);
        self.accessor(number_of).into_iter().map(vector).collect()
    }

    fn node(&self, number_of: &Value) -> &Value {
        &self.json["nodes"][number(number_of)]
    }

    /// What places each instance of a node.
    fn instances(&self, node: &Value) -> Vec<Mat4> {
        let of = &node["extensions"]["EXT_mesh_gpu_instancing"]["attributes"];
        let t = node["translation"]
            .as_array()
            .map_or(Vec3::ZERO, |t| Vec3::from([0, 1, 2].map(|k| t[k].as_f64().unwrap() as f32)));
        let turns = self.accessor(&of["ROTATION"]);
        let placed = self.vectors(&of["TRANSLATION"]).into_iter().zip(self.vectors(&of["SCALE"]));
        let placed = placed.zip(turns).map(|((place, scale), q)| {
            let q = Quat::from_xyzw(q[0] as f32, q[1] as f32, q[2] as f32, q[3] as f32);
            Mat4::from_translation(t)
                * Mat4::from_scale_rotation_translation(scale, q.normalize(), place)
        });
        placed.collect()
    }
}

fn vertices<const N: usize>(encoded: &[u8], count: usize) -> Vec<u8>
where
    [u8; N]: Default,
{
    let decoded: Vec<[u8; N]> = meshopt::decode_vertex_buffer(encoded, count).unwrap();
    decoded.as_flattened().to_vec()
}

fn number(value: &Value) -> usize {
    value.as_u64().unwrap_or_else(|| panic!("{value} is no number")) as usize
}

fn offset(of: &Value) -> usize {
    of["byteOffset"].as_u64().unwrap_or(0) as usize
}

fn written(scene: &ValidScene, profile: Profile) -> Vec<(String, Read)> {
    let job = Job { profile, ..Job::new("forest", &[Format::Glb]) };
    let pictures = Pictures::encode(scene, &job.picture_formats()).unwrap();
    let files = files(scene, &pictures, &job).unwrap();
    let read = |f: OutputFile<'_>| (f.path.display().to_string(), Read::new(&f.into_bytes()));
    files.value.into_iter().map(read).collect()
}

/// Twigs of a tree stand where they are put, below its node.
#[test]
fn scattered_parts_are_instances_below_their_tree() {
    let mut scene = forest(&["Larix sibirica"], 2, 20.0);
    let mut draws = crate::seed::Seed::new(1).draws();
    for one in &mut scene.prototypes {
        let part = Part { name: "twig_01".into(), ..one.parts[1].clone() };
        let mut place = || crate::mesh::Place {
            position: draws.direction() * 3.0,
            turn: Quat::from_axis_angle(draws.direction(), draws.between(0.0, 3.0)),
            scale: draws.between(0.5, 2.0),
        };
        let places = (0..5).map(|_| place()).collect();
        one.scattered.push(crate::scene::Scattered { part, places });
    }
    let scene = scene.validate().unwrap();
    for profile in [Profile::Dcc, Profile::Engine, Profile::Web] {
        let (_, read) = written(&scene, profile).remove(0);
        let nodes = read.json["nodes"].as_array().unwrap();
        for tree in scene.instances() {
            let one = &scene.prototypes()[tree.prototype as usize];
            let node = nodes.iter().find(|n| n["name"] == tree.name.as_str()).unwrap();
            assert_eq!(node["extras"]["id"], tree.facts.id.as_str());
            let [twigs] = &node["children"].as_array().unwrap()[..] else { panic!("{node}") };
            let twigs = read.node(twigs);
            assert_eq!(twigs["name"], format!("{}_twig_01", tree.name));
            let mesh = &read.json["meshes"][number(&twigs["mesh"])];
            assert_eq!(mesh["name"], format!("{}_twig_01", one.name));
            let position = read.vectors(&mesh["primitives"][0]["attributes"]["POSITION"]);
            let placed = read.instances(twigs);
            assert_eq!(placed.len(), 5);
            let surface = &one.scattered[0].part.surface;
            let mut ours: Vec<Vec3> = surface.position.clone();
            for (matrix, place) in placed.iter().zip(&one.scattered[0].places) {
                let theirs: Vec<Vec3> =
                    position.iter().map(|p| matrix.transform_point3(*p)).collect();
                ours.clear();
                ours.extend(surface.position.iter().map(|p| Vec3::from(y_up(place.of(*p)))));
                for (a, b) in gist(&theirs).into_iter().zip(gist(&ours)) {
                    assert!((a - b).abs().max_element() < 1e-2, "{profile:?}: {a} {b}");
                }
            }
        }
    }
    let job = Job::new("forest", &[Format::Obj]);
    let pictures = Pictures::encode(&scene, &job.picture_formats()).unwrap();
    let error = files(&scene, &pictures, &job).err().unwrap();
    assert_eq!(error.message(), ".obj files hold no twigs that are stored once");
}

/// The corners of a part's triangles in their places, Y up, in the order of the indices.
fn corners(surface: &Surface, place: impl Fn(Vec3) -> Vec3) -> Vec<Vec3> {
    let at = |&i: &u32| Vec3::from(y_up(place(surface.position[i as usize])));
    surface.index.iter().map(at).collect()
}

/// Least and greatest corner and the mean, which no order of triangles changes.
fn gist(corners: &[Vec3]) -> [Vec3; 3] {
    let (mut lo, mut hi, mut sum) = (Vec3::INFINITY, Vec3::NEG_INFINITY, glam::DVec3::ZERO);
    for &p in corners {
        (lo, hi, sum) = (lo.min(p), hi.max(p), sum + p.as_dvec3());
    }
    [lo, hi, (sum / corners.len() as f64).as_vec3()]
}

/// Every instance of a node shows these parts, each where it should be.
fn check_node(
    read: &Read,
    node: &Value,
    scene: &ValidScene,
    ids: &[&str],
    parts: &dyn Fn(usize) -> Vec<Part>,
) {
    let by_id: BTreeMap<&str, usize> =
        scene.instances().iter().enumerate().map(|(i, t)| (t.facts.id.as_str(), i)).collect();
    let mesh = &read.json["meshes"][number(&node["mesh"])];
    let primitives = mesh["primitives"].as_array().unwrap();
    let placed = read.instances(node);
    assert_eq!(placed.len(), ids.len());
    for (matrix, id) in placed.iter().zip(ids) {
        let tree = &scene.instances()[by_id[id]];
        let parts = parts(by_id[id]);
        assert_eq!(primitives.len(), parts.len());
        for (primitive, part) in primitives.iter().zip(parts) {
            let position = read.vectors(&primitive["attributes"]["POSITION"]);
            let index = read.accessor(&primitive["indices"]);
            let theirs: Vec<Vec3> =
                index.iter().map(|i| matrix.transform_point3(position[i[0] as usize])).collect();
            let ours = corners(&part.surface, |p| tree.place(p));
            assert_eq!(theirs.len(), ours.len());
            for (a, b) in gist(&theirs).into_iter().zip(gist(&ours)) {
                // A step of the grid, and a turn of 16 bits at the end of a branch.
                assert!((a - b).abs().max_element() < 1e-3, "{a} {b}");
            }
        }
    }
}

fn ids(node: &Value) -> Vec<&str> {
    node["extras"]["trees"]["id"].as_array().unwrap().iter().map(|v| v.as_str().unwrap()).collect()
}

#[test]
fn an_engine_finds_trees_forms_and_colliders_where_they_are() {
    let scene = sample();
    let mut all = written(&scene, Profile::Engine);
    let (name, read) = all.remove(0);
    assert!(all.is_empty() && name == "forest.glb");
    let required = ["EXT_mesh_gpu_instancing", "KHR_mesh_quantization", "KHR_texture_transform"];
    assert_eq!(read.json["extensionsRequired"], serde_json::json!(required));
    let used = &read.json["extensionsUsed"];
    assert_eq!(used.as_array().unwrap().last().unwrap(), "MSFT_lod");

    let root = &read.json["nodes"][0];
    let mut seen = Vec::new();
    let mut colliders = 0;
    for group in &root["children"].as_array().unwrap()[1..] {
        for cell in read.node(group)["children"].as_array().unwrap() {
            let cell = read.node(cell);
            let of_prototype =
                |i: usize| &scene.prototypes()[scene.instances()[i].prototype as usize];
            let name = cell["name"].as_str().unwrap();
            if let Some(of) = name.strip_prefix("UCX_") {
                assert!(of.ends_with("_00"));
                let twin = read.json["nodes"].as_array().unwrap();
                let twin = twin
                    .iter()
                    .find(|n| {
                        of.starts_with(n["name"].as_str().unwrap())
                            && n["extras"]["trees"].is_object()
                            && of == format!("{}_00", n["name"].as_str().unwrap())
                    })
                    .unwrap();
                let body = |i: usize| {
                    let body = of_prototype(i).colliders[0].body.clone();
                    vec![Part { name: String::new(), surface: body, material: 0 }]
                };
                check_node(&read, cell, &scene, &ids(twin), &body);
                colliders += ids(twin).len();
                continue;
            }
            let ids = ids(cell);
            check_node(&read, cell, &scene, &ids, &|i| of_prototype(i).parts.clone());
            let coarser = cell["extensions"]["MSFT_lod"]["ids"].as_array().unwrap();
            assert_eq!(coarser.len(), 2);
            for (k, coarser) in coarser.iter().enumerate() {
                let node = read.node(coarser);
                assert_eq!(node["name"], format!("{name}_LOD{}", k + 1));
                let parts = |i: usize| of_prototype(i).levels[k].parts.clone();
                check_node(&read, node, &scene, &ids, &parts);
            }
            let covers = cell["extras"]["MSFT_screencoverage"].as_array().unwrap();
            let covers: Vec<f64> = covers.iter().map(|c| c.as_f64().unwrap()).collect();
            assert!(covers.len() == 3 && covers[0] > covers[1] && covers[2] == 0.0, "{covers:?}");
            seen.extend(ids.iter().map(|id| (*id).to_owned()));
        }
    }
    assert_eq!((seen.len(), colliders), (120, 120));
    seen.sort_unstable();
    seen.dedup();
    assert_eq!(seen.len(), 120);
}

#[test]
fn a_browser_finds_what_the_others_do_in_a_fraction_of_the_bytes() {
    let scene = sample();
    let all = written(&scene, Profile::Web);
    let names: Vec<&str> = all.iter().map(|(n, _)| n.as_str()).collect();
    assert_eq!(names, ["forest.glb", "forest_LOD1.glb", "forest_LOD2.glb"]);
    for (k, (_, read)) in all.iter().enumerate() {
        let root = &read.json["nodes"][0];
        let groups = root["children"].as_array().unwrap();
        let mut trees = 0;
        for group in &groups[usize::from(k == 0)..] {
            for cell in read.node(group)["children"].as_array().unwrap() {
                let cell = read.node(cell);
                if cell["extras"].is_null() {
                    continue;
                }
                let parts = |i: usize| {
                    let of = &scene.prototypes()[scene.instances()[i].prototype as usize];
                    if k == 0 { of.parts.clone() } else { of.levels[k - 1].parts.clone() }
                };
                check_node(read, cell, &scene, &ids(cell), &parts);
                trees += ids(cell).len();
            }
        }
        assert_eq!(trees, 120);
        for image in read.json["images"].as_array().unwrap() {
            assert_eq!(image["mimeType"], "image/webp");
            let view = &read.json["bufferViews"][number(&image["bufferView"])];
            assert_eq!(&read.buffers[0][offset(view) + 8..offset(view) + 12], b"WEBP");
        }
    }
    let decoded: usize = all.iter().map(|(_, r)| r.buffers[1].len()).sum();
    let told = |v: &Value| v["extensions"]["EXT_meshopt_compression"]["byteLength"].as_u64();
    let views = all.iter().flat_map(|(_, r)| r.json["bufferViews"].as_array().unwrap());
    let encoded: u64 = views.filter_map(told).sum();
    assert!(encoded * 2 < decoded as u64, "{encoded} of {decoded}");
}

/// By name; and what was said.
type Set = (BTreeMap<String, Vec<u8>>, Vec<String>);

fn at_most(scene: &ValidScene, profile: Profile, most_glb_bytes: u64) -> Result<Set> {
    let job = Job { profile, most_glb_bytes, ..Job::new("forest", &[Format::Glb]) };
    let pictures = Pictures::encode(scene, &job.picture_formats()).unwrap();
    let Warned { value, warnings } = files(scene, &pictures, &job)?;
    let read = |f: OutputFile<'_>| (f.path.display().to_string(), f.into_bytes());
    Ok((value.into_iter().map(read).collect(), warnings))
}

/// A form that a camera chose is the only one, and yet not the finest there is.
#[test]
fn the_only_form_tells_how_far_it_is_from_one_that_is_gone() {
    let mut scene = forest(&["Larix sibirica"], 12, 100.0);
    scene.prototypes[0].silhouette = Some(Apart { worst_m: 0.5, rms_m: 0.25 });
    let scene = scene.validate().unwrap();
    for profile in [Profile::Dcc, Profile::Engine] {
        let (_, read) = written(&scene, profile).remove(0);
        for mesh in read.json["meshes"].as_array().unwrap() {
            let of = |p: &crate::scene::Prototype| mesh["name"] == p.name.as_str();
            let Some(k) = scene.prototypes().iter().position(of) else { continue };
            let told = &mesh["extras"]["silhouette_rms_m"];
            assert_eq!(told.as_f64(), (k == 0).then_some(0.25), "{profile:?} {k}");
        }
    }
}

/// The nodes of trees or cells: those with extras, by name; without the numbers of this file.
fn trees_of(read: &Read) -> BTreeMap<&str, Value> {
    let nodes = read.json["nodes"].as_array().unwrap().iter().filter(|n| n["extras"].is_object());
    let own = nodes.map(|n| {
        let mut own = n.clone();
        own["mesh"] = read.json["meshes"][number(&n["mesh"])]["name"].clone();
        own.as_object_mut().unwrap().retain(|key, _| key != "children" && key != "extensions");
        (n["name"].as_str().unwrap(), own)
    });
    own.collect()
}

fn without_terrain(mut scene: Scene) -> Scene {
    scene.terrain = None;
    scene.prune();
    scene
}

#[test]
fn a_scene_too_large_for_one_file_is_split_by_place() {
    let scene = without_terrain(sample().into_scene()).validate().unwrap();
    let (whole, warnings) = at_most(&scene, Profile::Dcc, MOST_GLB_BYTES).unwrap();
    assert!(whole.len() == 3 && warnings.is_empty());
    let bytes = whole["forest.glb"].len() as u64;
    assert_eq!(at_most(&scene, Profile::Dcc, bytes).unwrap().0, whole);

    let most = bytes * 3 / 4;
    let (parts, warnings) = at_most(&scene, Profile::Dcc, most).unwrap();
    let [told] = &warnings[..] else { panic!("{warnings:?}") };
    let said = format!("split by place into {} files", parts.len());
    assert!(told.starts_with("forest.glb would be") && told.contains(&said), "{told}");
    let forms = ["", "_LOD1", "_LOD2"];
    assert!(parts.len() >= 4 * forms.len() && parts.len() % forms.len() == 0);
    for form in forms {
        let all = Read::new(&whole[&format!("forest{form}.glb")]);
        let expected = trees_of(&all);
        let mut seen = 0;
        for (name, bytes) in &parts {
            assert!(bytes.len() as u64 <= most);
            let read = Read::new(bytes);
            let place = &read.json["asset"]["extras"];
            let square = &place["square"];
            let stem = format!("forest_x{}_y{}", square["column"], square["row"]);
            if *name != format!("{stem}{form}.glb") {
                continue;
            }
            // Another reader's word for it, pictures too.
            ::gltf::import_slice(bytes).unwrap();
            assert_eq!(place["origin"], all.json["asset"]["extras"]["origin"]);
            let side_m = square["side_m"].as_f64().unwrap();
            let corner = |k: usize| square["south_west_m"][k].as_f64().unwrap();
            let trees = trees_of(&read);
            for (name, node) in &trees {
                assert_eq!(*node, expected[name]);
                let at = |k: usize| node["translation"][k].as_f64().unwrap();
                for from in [at(0) - corner(0), -at(2) - corner(1)] {
                    assert!((0.0..=side_m).contains(&from), "{name} of {stem}");
                }
            }
            seen += trees.len();
        }
        assert_eq!((seen, expected.len()), (120, 120), "each tree once");
    }
}

#[test]
fn the_terrain_of_a_split_scene_is_a_file_of_its_own() {
    let scene = sample();
    let (whole, _) = at_most(&scene, Profile::Dcc, MOST_GLB_BYTES).unwrap();
    let most = whole["forest.glb"].len() as u64 - 1;
    let (parts, warnings) = at_most(&scene, Profile::Dcc, most).unwrap();
    assert!(warnings[0].contains(" and one of the terrain; all have one origin"), "{warnings:?}");
    for (name, bytes) in &parts {
        let read = Read::new(bytes);
        let nodes = read.json["nodes"].as_array().unwrap();
        let terrains = nodes.iter().filter(|n| n["name"] == "terrain").count();
        let is_own = name == "forest_terrain.glb";
        assert_eq!((terrains == 1, nodes.len() == 2), (is_own, is_own), "{name}");
    }
}

/// Every triangle of the whole once, by the numbers of its corners: places and normals.
fn triangles_of_terrain(read: &Read) -> Vec<[[u64; 6]; 3]> {
    let nodes = read.json["nodes"].as_array().unwrap();
    let node = nodes.iter().find(|n| n["name"] == "terrain").unwrap();
    let mesh = &read.json["meshes"][number(&node["mesh"])];
    let primitive = &mesh["primitives"][0];
    let of = &primitive["attributes"];
    let (places, normals) = (read.accessor(&of["POSITION"]), read.accessor(&of["NORMAL"]));
    // What places are counted in is a part of where they are.
    let put: Vec<f64> = ["translation", "scale"]
        .iter()
        .flat_map(|key| node[key].as_array().into_iter().flatten())
        .map(|v| v.as_f64().unwrap())
        .collect();
    let (by, from) = match put[..] {
        [x, y, z, size, _, _] => (size, [x, y, z]),
        _ => (1.0, [0.0; 3]),
    };
    let corner = |i: usize| {
        let place: [f64; 3] = std::array::from_fn(|k| places[i][k] * by + from[k]);
        std::array::from_fn(|k| if k < 3 { place[k] } else { normals[i][k - 3] }.to_bits())
    };
    let index: Vec<usize> =
        read.accessor(&primitive["indices"]).iter().map(|i| i[0] as usize).collect();
    let mut all: Vec<[[u64; 6]; 3]> =
        index.as_chunks::<3>().0.iter().map(|t| t.map(corner)).collect();
    // Writers may begin a triangle with another corner.
    for triangle in &mut all {
        let first = (0..3).min_by_key(|&k| triangle[k]).unwrap();
        triangle.rotate_left(first);
    }
    all.sort_unstable();
    all
}

#[test]
fn a_terrain_too_large_for_one_file_is_cut_without_a_seam() {
    // Small enough for the web to count places in 16 bits.
    let scene = forest(&["Larix"], 20, 100.0).validate().unwrap();
    for profile in [Profile::Dcc, Profile::Engine, Profile::Web] {
        let (whole, _) = at_most(&scene, profile, MOST_GLB_BYTES).unwrap();
        let (one, _) = at_most(&scene, profile, whole["forest.glb"].len() as u64 - 1).unwrap();
        let most = one["forest_terrain.glb"].len() as u64 - 1;
        let (parts, warnings) = at_most(&scene, profile, most).unwrap();
        let mut terrains = parts.iter().filter(|(name, _)| name.starts_with("forest_terrain"));
        let count = terrains.clone().count();
        assert!(count > 1 && terrains.all(|(name, _)| name.starts_with("forest_terrain_x")));
        assert!(
            warnings[0].contains(&format!("{count} of the terrain by squares of")),
            "{warnings:?}"
        );
        let mut joined = Vec::new();
        for (name, bytes) in parts.iter().filter(|(name, _)| name.starts_with("forest_terrain")) {
            assert!(bytes.len() as u64 <= most);
            let read = Read::new(bytes);
            let square = &read.json["asset"]["extras"]["square"];
            let said = format!("forest_terrain_x{}_y{}.glb", square["column"], square["row"]);
            assert_eq!(*name, said);
            joined.extend(triangles_of_terrain(&read));
        }
        joined.sort_unstable();
        assert!(joined == triangles_of_terrain(&Read::new(&whole["forest.glb"])));
    }
}

/// The picture of a file's terrain, and texture coordinates of the terrain by place.
fn photo_of_terrain(read: &Read) -> (Picture, BTreeMap<[u64; 3], Vec<f64>>) {
    let meshes = read.json["meshes"].as_array().unwrap();
    let primitive = &meshes.iter().find(|m| m["name"] == "terrain").unwrap()["primitives"][0];
    let of = &primitive["attributes"];
    let colour = &read.json["materials"][number(&primitive["material"])]["pbrMetallicRoughness"];
    let texture = &read.json["textures"][number(&colour["baseColorTexture"]["index"])];
    let image = &read.json["images"][number(&texture["source"])];
    let view = &read.json["bufferViews"][number(&image["bufferView"])];
    let from = offset(view);
    let bytes = &read.buffers[0][from..from + number(&view["byteLength"])];
    let place = |p: Vec<f64>| std::array::from_fn(|k| p[k].to_bits());
    let places = read.accessor(&of["POSITION"]).into_iter().map(place);
    let uvs = places.zip(read.accessor(&of["TEXCOORD_0"])).collect();
    (Picture::from_bytes(bytes).unwrap(), uvs)
}

/// As readers draw it: between the middles of pixels, held at the edges.
fn bilinear(picture: &Picture, uv: &[f64]) -> [f64; 3] {
    let at = |share: f64, count: u32| {
        let place = (share * f64::from(count) - 0.5).clamp(0.0, f64::from(count - 1));
        (place as u32, (place as u32 + 1).min(count - 1), place.fract())
    };
    let (x, y) = (at(uv[0], picture.width), at(uv[1], picture.height));
    let mix = |a: f64, b: f64, share: f64| a + (b - a) * share;
    std::array::from_fn(|k| {
        let pixel = |x: u32, y: u32| f64::from(picture.at(x, y)[k]);
        let row = |y: u32| mix(pixel(x.0, y), pixel(x.1, y), x.2);
        mix(row(y.0), row(y.1), y.2)
    })
}

#[test]
fn pieces_of_the_terrain_have_their_own_crop_of_the_photo() {
    let (width, height) = (700, 500);
    let mut scene = forest(&["Larix"], 4, 100.0);
    let mut photo = Picture::filled(width, height, [255; 4]);
    for (x, y) in (0..height).flat_map(|y| (0..width).map(move |x| (x, y))) {
        let shade = 60 + (x * x / 31 + y * y / 17) % 90;
        photo.set(x, y, [(x * 255 / width) as u8, (y * 255 / height) as u8, shade as u8, 255]);
    }
    scene.textures[0].image = photo.into();
    let scene = scene.validate().unwrap();
    for profile in [Profile::Dcc, Profile::Engine] {
        let (whole, _) = at_most(&scene, profile, MOST_GLB_BYTES).unwrap();
        let (one, _) = at_most(&scene, profile, whole["forest.glb"].len() as u64 - 1).unwrap();
        let most = one["forest_terrain.glb"].len() as u64 / 2;
        let (parts, _) = at_most(&scene, profile, most).unwrap();
        let (whole, expected) = photo_of_terrain(&Read::new(&one["forest_terrain.glb"]));
        let (mut pixels, mut seen) = (0, BTreeMap::new());
        for (_, bytes) in parts.iter().filter(|(name, _)| name.starts_with("forest_terrain")) {
            let (picture, uvs) = photo_of_terrain(&Read::new(bytes));
            pixels += picture.data.len();
            for (place, uv) in uvs {
                let shown = bilinear(&picture, &uv);
                let of_whole = bilinear(&whole, &expected[&place]);
                // Texture coordinates of 16 bits are off by a hundredth of a pixel.
                let is_near = shown.iter().zip(of_whole).all(|(a, b)| (a - b).abs() < 1.5);
                assert!(is_near, "{profile:?}: {shown:?} and not {of_whole:?} at {uv:?}");
                *seen.entry(place).or_insert(0) += 1;
            }
        }
        assert_eq!(seen.len(), expected.len());
        // Borders are held by neighbours, too.
        let all = whole.data.len();
        assert!((all..2 * all).contains(&pixels), "{profile:?}: {pixels} of {all} pixels");
    }
}

#[test]
fn profiles_are_split_with_all_that_they_hold() {
    let scene = sample();
    for profile in [Profile::Engine, Profile::Web] {
        let (whole, _) = at_most(&scene, profile, MOST_GLB_BYTES).unwrap();
        let most = whole["forest.glb"].len() as u64 * 4 / 5;
        let (parts, warnings) = at_most(&scene, profile, most).unwrap();
        assert_eq!(warnings.len(), 1);
        let mut seen: BTreeMap<String, usize> = BTreeMap::new();
        let finest = parts.iter().filter(|(name, _)| !name.contains("_LOD"));
        for (name, bytes) in finest {
            assert!(bytes.len() as u64 <= most);
            let read = Read::new(bytes);
            let cells = read.json["nodes"].as_array().unwrap();
            for cell in cells.iter().filter(|n| n["extras"]["trees"].is_object()) {
                let ids = ids(cell);
                let parts = |i: usize| {
                    scene.prototypes()[scene.instances()[i].prototype as usize].parts.clone()
                };
                check_node(&read, cell, &scene, &ids, &parts);
                ids.iter().for_each(|id| *seen.entry((*id).into()).or_default() += 1);
                let levels = cell["extensions"]["MSFT_lod"]["ids"].as_array();
                assert_eq!(levels.map(Vec::len), profile.holds_all_forms().then_some(2), "{name}");
            }
        }
        assert!(seen.len() == 120 && seen.values().all(|&n| n == 1));
    }
}

/// As with `--texture 0`: readers that do not know what a file does not use can read it.
#[test]
fn extensions_of_pictures_are_required_where_there_are_pictures() {
    let mut scene = forest(&["Larix"], 4, 100.0);
    for material in &mut scene.materials {
        material.base_color_texture = None;
        material.normal_texture = None;
        material.orm_texture = None;
        material.variants.clear();
        material.alpha = Alpha::Opaque;
    }
    scene.prune();
    let scene = scene.validate().unwrap();
    for profile in [Profile::Engine, Profile::Web] {
        for (_, read) in written(&scene, profile) {
            let used = read.json["extensionsUsed"].as_array().unwrap();
            assert!(
                used.iter().all(|name| !name.as_str().unwrap().contains("texture")),
                "{used:?}"
            );
        }
    }
}

#[test]
fn what_can_not_be_split_is_refused() {
    let scene = sample();
    let told =
        |scene: &ValidScene, most| at_most(scene, Profile::Dcc, most).err().unwrap().to_string();
    let text = told(&scene, 1000);
    assert!(text.starts_with("forest.glb: the terrain needs"), "{text}");
    let one = without_terrain(forest(&["Larix"], 1, 60.0));
    let text = told(&one.validate().unwrap(), 1000);
    assert!(text.starts_with("forest.glb: a single tree needs"), "{text}");
    let mut together = without_terrain(scene.into_scene());
    let apart = together.clone().validate().unwrap();
    let least = at_most(&apart, Profile::Dcc, MOST_GLB_BYTES).unwrap().0["forest.glb"].len() as u64;
    let at = together.instances[0].position;
    together.instances.iter_mut().for_each(|t| t.position = at);
    let text = told(&together.validate().unwrap(), least * 3 / 4);
    assert!(text.starts_with("forest.glb: trees in one place need"), "{text}");
}

/// Texture coordinates, normals and wind of a surface, whichever way they are written.
#[test]
fn numbers_of_fewer_bits_say_nearly_the_same() {
    let scene = sample();
    let (_, read) = written(&scene, Profile::Engine).remove(0);
    let meshes = read.json["meshes"].as_array().unwrap();
    for prototype in scene.prototypes() {
        let mesh = meshes.iter().find(|m| m["name"] == prototype.name.as_str()).unwrap();
        let primitives = mesh["primitives"].as_array().unwrap();
        for (primitive, part) in primitives.iter().zip(&prototype.parts) {
            let of = &primitive["attributes"];
            let material = &read.json["materials"][number(&primitive["material"])];
            let shown = &material["pbrMetallicRoughness"]["baseColorTexture"];
            let transform = &shown["extensions"]["KHR_texture_transform"];
            let pair = |v: &Value, usual: f64| match v.as_array() {
                Some(v) => [v[0].as_f64().unwrap(), v[1].as_f64().unwrap()],
                None => [usual; 2],
            };
            let (offset, scale) = (pair(&transform["offset"], 0.0), pair(&transform["scale"], 1.0));
            assert_eq!(part.name == "wood", transform.is_object());
            for (theirs, ours) in read.accessor(&of["TEXCOORD_0"]).iter().zip(&part.surface.uv) {
                let [u, v] = [0, 1].map(|k| offset[k] + scale[k] * theirs[k]);
                assert!((u - f64::from(ours.x)).abs() < 2e-4, "{u} {ours}");
                assert!((v - 1.0 + f64::from(ours.y)).abs() < 2e-4, "{v} {ours}");
            }
            for (theirs, ours) in read.vectors(&of["NORMAL"]).iter().zip(&part.surface.normal) {
                assert!(theirs.angle_between(Vec3::from(y_up(*ours))).to_degrees() < 0.6);
            }
            for (theirs, ours) in read.accessor(&of["_WIND"]).iter().zip(&part.surface.wind) {
                let theirs: Vec<u8> = theirs.iter().map(|c| (c * 255.0).round() as u8).collect();
                assert_eq!(theirs, ours);
            }
            assert_eq!(of["TANGENT"].is_u64(), part.name == "wood");
        }
    }
}

#[test]
fn profiles_give_the_same_bytes_on_any_number_of_threads() {
    let scene = sample();
    for profile in [Profile::Dcc, Profile::Engine, Profile::Web] {
        let formats = [Format::Glb, Format::Gltf];
        let job = Job { profile, wind: WindAs::Color, ..Job::new("x", &formats) };
        let on = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| {
                let pictures = Pictures::encode(&scene, &job.picture_formats()).unwrap();
                let all = files(&scene, &pictures, &job).unwrap().value;
                all.into_iter().map(OutputFile::into_bytes).collect::<Vec<_>>()
            })
        };
        assert!(on(1) == on(3));
    }
}

#[test]
fn places_on_a_light_map_are_the_second_coordinates() {
    let mut scene = sample().into_scene();
    for part in scene.prototypes.iter_mut().flat_map(|p| &mut p.parts) {
        let count = part.surface.position.len();
        let at = |i: usize| glam::Vec2::new(i as f32 / count as f32, 0.25);
        part.surface.lightmap_uv = (0..count).map(at).collect();
    }
    // One that no texture covers: sets of coordinates are counted from 0 without a gap.
    let plain = scene.prototypes[0].parts[0].material as usize;
    let material = &mut scene.materials[plain];
    (material.base_color_texture, material.normal_texture) = (None, None);
    (material.orm_texture, material.relief) = (None, None);
    material.variants.clear();
    scene.prune();
    let scene = scene.validate().unwrap();
    for (profile, off) in
        [(Profile::Dcc, 0.0), (Profile::Engine, 1.0 / 65_535.0), (Profile::Web, 1.0 / 65_535.0)]
    {
        let (_, read) = written(&scene, profile).remove(0);
        let meshes = read.json["meshes"].as_array().unwrap();
        for prototype in scene.prototypes() {
            let mesh = meshes.iter().find(|m| m["name"] == prototype.name.as_str()).unwrap();
            let primitives = mesh["primitives"].as_array().unwrap();
            for (primitive, part) in primitives.iter().zip(&prototype.parts) {
                assert!(primitive["attributes"].get("TEXCOORD_0").is_some(), "{}", part.name);
                let mut got = read.accessor(&primitive["attributes"]["TEXCOORD_1"]);
                // The web's vertices are in another order.
                got.sort_by(|a, b| a[0].total_cmp(&b[0]));
                assert_eq!(got.len(), part.surface.lightmap_uv.len());
                for (got, uv) in got.iter().zip(&part.surface.lightmap_uv) {
                    assert!((got[0] - f64::from(uv.x)).abs() <= off, "{got:?} {uv}");
                    assert!((got[1] - 0.75).abs() <= off, "{got:?} {uv}");
                }
            }
        }
        let all = meshes.iter().flat_map(|m| m["primitives"].as_array().unwrap());
        let with = all.filter(|p| p["attributes"].get("TEXCOORD_1").is_some()).count();
        let parts: usize = scene.prototypes().iter().map(|p| p.parts.len()).sum();
        assert_eq!(with, parts, "none on terrain and coarser forms, which have no places");
    }
}
