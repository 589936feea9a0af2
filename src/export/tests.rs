//! Files read back by another reader, goldens of a small scene, and what happens on a bad disk.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use ::gltf::mesh::util::ReadIndices;
use glam::{Mat4, Vec2, Vec3};

use super::*;
use crate::mesh::Surface;
use crate::scene::sample::{forest, tetrahedron};
use crate::scene::{Collider, ColliderShape, Scene, ValidScene};

const ALL: [Format; 7] =
    [Format::Glb, Format::Gltf, Format::Usda, Format::Usdc, Format::Usdz, Format::X3d, Format::Obj];

/// A file as it would be on disk.
#[derive(PartialEq)]
struct Made {
    path: PathBuf,
    bytes: Vec<u8>,
}

fn made(scene: &ValidScene, stem: &str, formats: &[Format], profile: Profile) -> Vec<Made> {
    let job = Job { profile, wind: WindAs::Color, ..Job::new(stem, formats) };
    let pictures = Pictures::encode(scene, &job.picture_formats()).unwrap();
    let files = super::files(scene, &pictures, &job).unwrap();
    assert!(files.warnings.is_empty());
    let read = |f: OutputFile<'_>| Made { path: f.path.clone(), bytes: f.into_bytes() };
    files.value.into_iter().map(read).collect()
}

fn files(scene: &ValidScene, stem: &str, formats: &[Format]) -> Vec<Made> {
    made(scene, stem, formats, Profile::Dcc)
}

fn sample() -> Scene {
    forest(&["Larix sibirica", "Betula pendula", "Pinus sylvestris"], 50, 60.0)
}

/// Names of the variants, and of each primitive what it is in each of them.
#[test]
fn variants_are_on_every_primitive() {
    let mut scene = forest(&["Larix sibirica", "Betula pendula"], 3, 20.0);
    for (owner, name) in [
        ("Larix_sibirica_leaf", "autumn"),
        ("Betula_pendula_leaf", "dying"),
        ("Betula_pendula_leaf", "autumn"),
    ] {
        let material = scene.materials.iter_mut().find(|m| m.name == owner).unwrap();
        material.variants.push(crate::scene::Variant {
            name: name.into(),
            base_color: [1.0, 0.5, 0.1],
            base_color_texture: material.base_color_texture,
        });
    }
    let scene = scene.validate().unwrap();
    let files = files(&scene, "x", &[Format::Gltf]);
    let json = files.iter().find(|f| f.path.ends_with("x.gltf")).unwrap();
    let json: serde_json::Value = serde_json::from_slice(&json.bytes).unwrap();
    const KEY: &str = "KHR_materials_variants";
    let leaves = ["KHR_materials_diffuse_transmission", "KHR_materials_specular"];
    assert_eq!(json["extensionsUsed"], serde_json::json!([leaves[0], leaves[1], KEY]));
    let names = &json["extensions"][KEY]["variants"];
    assert_eq!(
        *names,
        serde_json::json!([{ "name": "own" }, { "name": "autumn" }, { "name": "dying" }])
    );
    let primitives = json["meshes"].as_array().unwrap().iter();
    let mut seen = std::collections::BTreeSet::new();
    for primitive in primitives.flat_map(|m| m["primitives"].as_array().unwrap()) {
        let name = |index: &serde_json::Value| {
            let index = index.as_u64().unwrap() as usize;
            json["materials"][index]["name"].as_str().unwrap().to_owned()
        };
        let mut shown = vec![String::new(); 3];
        for mapping in primitive["extensions"][KEY]["mappings"].as_array().unwrap() {
            for variant in mapping["variants"].as_array().unwrap() {
                let slot = &mut shown[variant.as_u64().unwrap() as usize];
                assert!(slot.is_empty(), "a variant is mapped once");
                *slot = name(&mapping["material"]);
            }
        }
        seen.insert((name(&primitive["material"]), shown.join(" ")));
    }
    let expected = [
        ("Betula_pendula_bark", "Betula_pendula_bark Betula_pendula_bark"),
        ("Betula_pendula_leaf", "Betula_pendula_leaf_autumn Betula_pendula_leaf_dying"),
        ("Larix_sibirica_bark", "Larix_sibirica_bark Larix_sibirica_bark"),
        ("Larix_sibirica_leaf", "Larix_sibirica_leaf_autumn Larix_sibirica_leaf"),
        ("ground", "ground ground"),
    ];
    let expected = expected.map(|(own, shown)| (own.to_owned(), format!("{own} {shown}")));
    assert_eq!(seen, expected.into_iter().collect());
}

/// Two trees, each part a triangle or two, textures of one colour.
fn two_trees() -> ValidScene {
    let mut scene = forest(&["Larix sibirica"], 2, 4.0);
    for texture in &mut scene.textures {
        texture.image = crate::raster::Picture::filled(1, 1, [90, 80, 70, 255]).into();
    }
    // Round numbers, so that the goldens do not depend on a machine's sine.
    let level = Surface {
        position: vec![Vec3::ZERO, Vec3::X * 4.0, Vec3::new(4.0, 4.0, 0.5), Vec3::Y * 4.0],
        normal: vec![Vec3::Z; 4],
        uv: vec![Vec2::ZERO, Vec2::X, Vec2::ONE, Vec2::Y],
        index: vec![0, 1, 2, 0, 2, 3],
        ..Surface::default()
    };
    let upright = Surface {
        position: vec![Vec3::ZERO, Vec3::X * 0.5, Vec3::Z * 12.5],
        normal: vec![Vec3::NEG_Y; 3],
        uv: vec![Vec2::ZERO, Vec2::X, Vec2::Y * 12.5],
        index: vec![0, 1, 2],
        ..Surface::default()
    };
    for part in scene.prototypes.iter_mut().flat_map(|p| &mut p.parts).chain(&mut scene.terrain) {
        part.surface = match part.name.as_str() {
            "wood" => upright.clone(),
            _ => level.clone(),
        };
    }
    for (at, tree) in scene.instances.iter_mut().enumerate() {
        tree.position = Vec3::new(0.5 + at as f32, 0.25, 0.0);
        tree.yaw_rad = 0.0;
        tree.scale = Vec3::new(1.0, 1.0, 1.0 + at as f32 * 0.5);
        tree.facts.height_m = 12.5;
        tree.facts.crown_diameter_m = 3.0;
        tree.facts.stem_diameter_m = 0.25;
        tree.facts.confidence = 0.75;
    }
    scene.validate().unwrap()
}

/// Writes the sample for `tools/validate.py` and for Blender:
/// `LARIX_SAMPLE=DIR cargo test --lib export::tests::sample_on_disk -- --ignored`.
#[test]
#[ignore = "for checks outside of Rust"]
fn sample_on_disk() {
    let dir = std::env::var("LARIX_SAMPLE").expect("LARIX_SAMPLE names a folder");
    let scene = sample().validate().unwrap();
    let files = files(&scene, "forest", &ALL);
    let files = files.into_iter().map(|f| OutputFile::new(f.path, f.bytes)).collect();
    write_all(Path::new(&dir), files).unwrap();
}

#[test]
fn the_gltf_of_two_trees() {
    let all = files(&two_trees(), "two trees", &[Format::Gltf]);
    insta::assert_snapshot!(text_of(&all[0]));
}

#[test]
fn the_usda_of_two_trees() {
    let all = files(&two_trees(), "two trees", &[Format::Usda]);
    // Colours hang on a machine's powers, and on draws.
    let colours = ["color3f[] primvars:displayColor = ", "color3f[] primvars:tint = "];
    let line = |line: &str| match colours.iter().find(|c| line.trim_start().starts_with(**c)) {
        Some(colour) => format!("            {colour}[…] ("),
        None => line.to_owned(),
    };
    let root: Vec<String> = text_of(&all[0]).lines().map(line).collect();
    insta::assert_snapshot!("the_usda_of_two_trees", root.join("\n"));
    insta::assert_snapshot!("the_usda_of_a_model", text_of(&all[1]));
}

/// The tree's second form is one triangle of bark.
fn two_trees_of_two_forms() -> ValidScene {
    let mut scene = two_trees().into_scene();
    for prototype in &mut scene.prototypes {
        prototype.levels.push(crate::scene::Level {
            name: "LOD1".into(),
            parts: prototype.parts[..1].to_vec(),
            silhouette: crate::scene::Apart { worst_m: 0.5, rms_m: 0.125 },
            octahedral: None,
        });
    }
    scene.validate().unwrap()
}

#[test]
fn the_x3d_of_two_trees() {
    let scene = two_trees_of_two_forms();
    insta::assert_snapshot!(text_of(&files(&scene, "two trees", &[Format::X3d])[0]));
    let compact = made(&two_trees(), "two trees", &[Format::X3d], Profile::Web);
    insta::assert_snapshot!(text_of(&compact[0]));
}

#[test]
fn the_obj_of_two_trees() {
    let all = files(&two_trees_of_two_forms(), "two trees", &[Format::Obj]);
    let names: Vec<&str> = all.iter().map(|f| f.path.to_str().unwrap()).collect();
    assert_eq!(
        names[..4],
        ["two trees.obj", "two_trees.mtl", "two trees_LOD1.obj", "two_trees_LOD1.mtl"]
    );
    insta::assert_snapshot!(text_of(&all[0]));
    insta::assert_snapshot!(text_of(&all[1]));
}

/// Every number of the compact form is within half a place of the scene's.
#[test]
fn compact_x3d_is_markedly_smaller_and_rounded_as_stated() {
    let scene = sample().validate().unwrap();
    let plain = text_of(&files(&scene, "forest", &[Format::X3d])[0]);
    let compact = text_of(&made(&scene, "forest", &[Format::X3d], Profile::Web)[0]);
    let of = |text: &str, list: &str| -> Vec<f32> {
        let lists = text.split(list).skip(1).map(|rest| rest.split('"').next().unwrap());
        lists.flat_map(|list| list.split_whitespace().map(|n| n.parse().unwrap())).collect()
    };
    for (list, most) in [
        ("<Coordinate point=\"", 5e-4),
        ("<Normal vector=\"", 5e-3),
        ("<TextureCoordinate point=\"", 5e-5),
    ] {
        let (exact, rounded) = (of(&plain, list), of(&compact, list));
        assert!(exact.len() == rounded.len() && exact.len() > 1000);
        let worst = exact.iter().zip(&rounded).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!(worst > 0.1 * most && worst < 1.01 * most, "{list} {worst}");
    }
    let geometry = |text: &str| -> usize {
        let nodes = text.split("<Indexed").skip(1);
        nodes.map(|rest| rest.split("</Indexed").next().unwrap().len()).sum()
    };
    let (plain, compact) = (geometry(&plain), geometry(&compact));
    assert!(3 * compact < 2 * plain, "{compact} of {plain}");
}

/// By the reader that the species room uses for twigs.
#[test]
fn obj_reads_back_as_the_scene() {
    let scene = sample().validate().unwrap();
    let all = files(&scene, "forest", &[Format::Obj]);
    let obj = std::str::from_utf8(&all[0].bytes).unwrap();
    let options = tobj::LoadOptions { single_index: true, ..Default::default() };
    let mtl = |_: &Path| tobj::load_mtl_buf(&mut std::io::Cursor::new(&all[1].bytes));
    let (models, materials) =
        tobj::load_obj_buf(&mut std::io::Cursor::new(obj), &options, mtl).unwrap();
    let materials = materials.unwrap();
    let written: std::collections::BTreeSet<&Path> = all.iter().map(|f| f.path.as_path()).collect();
    for material in &materials {
        let texture = material.diffuse_texture.as_deref().unwrap();
        assert!(written.contains(Path::new(texture)), "{texture}");
    }
    let by_name: BTreeMap<String, _> = models.into_iter().map(|m| (m.name.clone(), m)).collect();
    assert_eq!(by_name.len(), 1 + 2 * scene.instances().len());
    for tree in scene.instances() {
        for part in &scene.prototypes()[tree.prototype as usize].parts {
            let mesh = &by_name[&format!("{}_{}", tree.name, part.name)].mesh;
            let name = &materials[mesh.material_id.unwrap()].name;
            assert_eq!(*name, scene.materials()[part.material as usize].name);
            assert_eq!(mesh.indices.len(), part.surface.index.len());
            for (&theirs, &ours) in mesh.indices.iter().zip(&part.surface.index) {
                let (theirs, ours) = (theirs as usize, ours as usize);
                let at = |column: &[f32], n| column[theirs * n..theirs * n + n].to_vec();
                let p = tree.place(part.surface.position[ours]);
                assert_eq!(at(&mesh.positions, 3), [p.x, p.z, 0.0 - p.y]);
                assert_eq!(at(&mesh.texcoords, 2), part.surface.uv[ours].to_array());
                let n = Vec3::from_slice(&at(&mesh.normals, 3));
                assert!((n.length() - 1.0).abs() < 2e-4);
            }
        }
    }
}

fn text_of(file: &Made) -> String {
    String::from_utf8(file.bytes.clone()).unwrap().replace(env!("CARGO_PKG_VERSION"), "VERSION")
}

#[test]
fn names_of_files_and_textures_shared_by_formats() {
    let twice: Vec<Format> = ALL.into_iter().rev().chain(ALL).collect();
    let all = files(&two_trees(), "two trees", &twice);
    let names: Vec<&str> = all.iter().map(|f| f.path.to_str().unwrap()).collect();
    assert_eq!(
        names,
        [
            "two trees.glb",
            "two trees.gltf",
            "two trees.bin",
            "two trees.usda",
            "assets/two_trees_Larix_sibirica_00.usda",
            "assets/two_trees_Larix_sibirica_01.usda",
            "two trees.usdc",
            "assets/two_trees_Larix_sibirica_00.usdc",
            "assets/two_trees_Larix_sibirica_01.usdc",
            "two trees.usdz",
            "two trees.x3d",
            "two trees.obj",
            "two_trees.mtl",
            "textures/two_trees_photo.png",
            "textures/two_trees_Larix_sibirica_bark.png",
            "textures/two_trees_Larix_sibirica_bark_normal.png",
            "textures/two_trees_Larix_sibirica_leaf.png",
            "textures/two_trees_Larix_sibirica_bark_orm.png",
        ]
    );
    let glb_alone = files(&two_trees(), "two trees", &[Format::Glb]);
    assert_eq!(glb_alone.len(), 1);
}

/// Heights lie beside every format once, and those that have a word for them say where.
#[test]
fn heights_of_bark_lie_beside_and_are_named() {
    let mut scene = forest(&["Larix sibirica"], 2, 20.0);
    let image: crate::raster::Image =
        crate::raster::Picture::filled(4, 4, [99, 99, 99, 255]).into();
    let bark = scene.materials.iter_mut().find(|m| m.name == "Larix_sibirica_bark").unwrap();
    bark.relief = Some(crate::scene::Relief { image: image.clone(), depth_m: 0.025 });
    let scene = scene.validate().unwrap();
    let path = "textures/x_Larix_sibirica_bark_height.png";
    for format in ALL {
        let all = files(&scene, "x", &[format]);
        let found: Vec<_> = all.iter().filter(|f| f.path == Path::new(path)).collect();
        // A package holds its own.
        assert_eq!(found.len(), usize::from(format != Format::Usdz), "{format:?}");
        assert!(found.iter().all(|file| file.bytes == image.png().unwrap()));
    }
    let all = files(&scene, "x", &ALL);
    assert_eq!(all.iter().filter(|f| f.path == Path::new(path)).count(), 1);
    let of = |name: &str| all.iter().find(|f| f.path.ends_with(name)).unwrap();
    let json: serde_json::Value = serde_json::from_slice(&of("x.gltf").bytes).unwrap();
    let told: Vec<_> = json["materials"].as_array().unwrap().iter().map(|m| &m["extras"]).collect();
    let height = serde_json::json!({ "height": { "uri": path, "depth_m": 0.025 } });
    assert_eq!(told.iter().filter(|extras| ***extras == height).count(), 1, "{told:?}");
    assert_eq!(told.iter().filter(|extras| !extras.is_null()).count(), 1, "{told:?}");
    let mtl = String::from_utf8_lossy(&of("x.mtl").bytes).into_owned();
    assert!(mtl.contains(&format!("\ndisp -mm -0.0125 0.025 {path}\n")), "{mtl}");
    let within = |f: &Made| f.bytes.windows(path.len()).any(|bytes| bytes == path.as_bytes());
    assert!(within(of("x.usdz")), "the package holds it");
    let layers: Vec<_> =
        all.iter().filter(|f| f.path.extension().is_some_and(|e| e == "usda")).collect();
    assert_eq!(layers.iter().filter(|layer| within(layer)).count(), 2, "one layer a model");
}

/// Opaque colours and normals are JPEG for engines, everything else PNG; USD beside them needs PNG throughout.
#[test]
fn engines_and_others_share_a_folder() {
    let scene = forest(&["Larix sibirica"], 2, 20.0).validate().unwrap();
    let all = made(&scene, "x", &[Format::Gltf, Format::Usda], Profile::Engine);
    let json = all.iter().find(|f| f.path.ends_with("x.gltf")).unwrap();
    let json: serde_json::Value = serde_json::from_slice(&json.bytes).unwrap();
    let names = |extension: &str| -> Vec<String> {
        let of_kind = all.iter().filter(|f| f.path.extension().is_some_and(|e| e == extension));
        of_kind.map(|f| f.path.display().to_string()).collect()
    };
    assert_eq!(names("png").len(), scene.textures().len());
    let jpeg = ["photo", "Larix_sibirica_bark", "Larix_sibirica_bark_normal"];
    assert_eq!(names("jpg"), jpeg.map(|name| format!("textures/x_{name}.jpg")));
    for (image, texture) in json["images"].as_array().unwrap().iter().zip(scene.textures()) {
        let file =
            all.iter().find(|f| f.path == Path::new(image["uri"].as_str().unwrap())).unwrap();
        let read = crate::raster::Picture::from_bytes(&file.bytes).unwrap();
        assert_eq!((read.width, read.height), (texture.image.width(), texture.image.height()));
        let is_jpeg = image["uri"].as_str().unwrap().ends_with(".jpg");
        assert!(is_jpeg || read == *texture.image.picture(), "{image}");
    }
    let glb = &made(&scene, "x", &[Format::Glb], Profile::Engine)[0];
    let kinds = ["image/jpeg", "image/png"].map(|kind| {
        glb.bytes.windows(kind.len()).filter(|bytes| *bytes == kind.as_bytes()).count()
    });
    assert_eq!(kinds, [jpeg.len(), scene.textures().len() - jpeg.len()]);
}

/// The vertices of every tree, where the gltf crate puts them, are where the scene does.
#[test]
fn glb_reads_back_as_the_scene() {
    let scene = sample().validate().unwrap();
    let glb = &files(&scene, "forest", &[Format::Glb])[0];
    let (document, buffers, images) = ::gltf::import_slice(&glb.bytes).unwrap();
    assert_eq!(images.len(), scene.textures().len());
    assert_eq!(document.meshes().len(), 1 + scene.prototypes().len());
    let by_name: BTreeMap<&str, _> =
        scene.instances().iter().map(|i| (i.name.as_str(), i)).collect();

    let root = document.default_scene().unwrap().nodes().next().unwrap();
    assert_eq!(root.name(), Some("forest"));
    let groups: Vec<_> = root.children().map(|n| n.name().unwrap().to_owned()).collect();
    assert_eq!(groups, ["terrain", "Larix_sibirica", "Betula_pendula", "Pinus_sylvestris"]);

    let mut seen = 0;
    for node in root.children().skip(1).flat_map(|group| group.children()) {
        let tree = by_name[node.name().unwrap()];
        let matrix = Mat4::from_cols_array_2d(&node.transform().matrix());
        let prototype = &scene.prototypes()[tree.prototype as usize];
        let mesh = node.mesh().unwrap();
        assert_eq!(mesh.name(), Some(prototype.name.as_str()));
        for (primitive, part) in mesh.primitives().zip(&prototype.parts) {
            let reader = primitive.reader(|b| Some(&buffers[b.index()]));
            let positions: Vec<[f32; 3]> = reader.read_positions().unwrap().collect();
            for (&p, &ours) in positions.iter().zip(&part.surface.position) {
                let theirs = matrix.transform_point3(Vec3::from(p));
                let ours = tree.place(ours);
                let off = theirs - Vec3::new(ours.x, ours.z, -ours.y);
                assert!(off.length() < 1e-4, "{theirs} {ours}");
            }
            assert_eq!(positions.len(), part.surface.position.len());
            let uv: Vec<[f32; 2]> = reader.read_tex_coords(0).unwrap().into_f32().collect();
            let ours: Vec<[f32; 2]> = part.surface.uv.iter().map(|c| [c.x, 1.0 - c.y]).collect();
            assert_eq!(uv, ours);
            let index: Vec<u32> = reader.read_indices().unwrap().into_u32().collect();
            assert_eq!(index, part.surface.index);
            let normals = reader.read_normals().unwrap();
            for (n, ours) in normals.zip(&part.surface.normal) {
                assert_eq!(Vec3::from(n), Vec3::new(ours.x, ours.z, -ours.y));
            }
            assert_eq!(reader.read_tangents().is_some(), part.name == "wood");
        }
        let extras: serde_json::Value =
            serde_json::from_str(node.extras().as_ref().unwrap().get()).unwrap();
        assert_eq!(extras["id"], tree.facts.id.as_str());
        assert_eq!(extras["height_m"].as_f64().unwrap() as f32, tree.facts.height_m);
        seen += 1;
    }
    assert_eq!(seen, 150);
}

#[test]
fn surfaces_of_more_vertices_than_16_bits_reach_get_long_indices() {
    let mut scene = forest(&["Larix"], 1, 600.0);
    scene.prune();
    let scene = scene.validate().unwrap();
    let vertices = scene.terrain().unwrap().surface.position.len();
    assert!(vertices > 65_535, "{vertices}");
    let glb = &files(&scene, "forest", &[Format::Glb])[0];
    let (document, buffers, _) = ::gltf::import_slice(&glb.bytes).unwrap();
    let kinds: Vec<bool> = document
        .meshes()
        .flat_map(|mesh| mesh.primitives().collect::<Vec<_>>())
        .map(|primitive| {
            let reader = primitive.reader(|b| Some(&buffers[b.index()]));
            matches!(reader.read_indices().unwrap(), ReadIndices::U32(_))
        })
        .collect();
    assert_eq!(kinds, [true, false, false]);
}

#[test]
fn the_same_scene_gives_the_same_bytes_on_any_number_of_threads() {
    let scene = forest(&["Larix", "Betula"], 20, 400.0).validate().unwrap();
    let on = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| files(&scene, "forest", &ALL))
    };
    assert!(on(1) == on(3));
}

fn file(path: &str, text: &'static str) -> OutputFile<'static> {
    OutputFile::new(path, text)
}

/// Every file below `dir` with its text.
fn tree(dir: &Path) -> Vec<(PathBuf, String)> {
    let mut found = Vec::new();
    let mut waiting = vec![dir.to_path_buf()];
    while let Some(folder) = waiting.pop() {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                found.push((path.clone(), "a folder".into()));
                waiting.push(path);
            } else {
                let text = fs::read_to_string(&path).unwrap();
                found.push((path, text));
            }
        }
    }
    found.sort();
    found
}

#[test]
fn writing_makes_folders_and_replaces_old_files() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("a/b");
    write_all(&out, vec![file("x.glb", "old"), file("textures/y.png", "old")]).unwrap();
    write_all(&out, vec![file("x.glb", "new")]).unwrap();
    let expected = [
        (out.join("textures"), "a folder".to_owned()),
        (out.join("textures/y.png"), "old".to_owned()),
        (out.join("x.glb"), "new".to_owned()),
    ];
    assert_eq!(tree(&out), expected);
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        let usual = fs::File::create(dir.path().join("usual")).unwrap().metadata().unwrap();
        let ours = fs::metadata(out.join("x.glb")).unwrap();
        assert_eq!(ours.permissions().mode(), usual.permissions().mode());
    }
}

/// Failures that even the superuser meets: a file where a folder should be, and the reverse.
#[test]
fn a_failure_leaves_everything_as_it_was() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("out");
    write_all(&out, vec![file("a.glb", "old"), file("taken", "old"), file("c/d", "old")]).unwrap();
    let before = tree(dir.path());
    let cases = [
        ("out", vec![file("a.glb", "new"), file("new/e", "new"), file("taken/b", "new")]),
        ("out", vec![file("a.glb", "new"), file("new/e", "new"), file("c", "new")]),
        ("out/a.glb", vec![file("x", "new")]),
        ("out/a.glb/sub", vec![file("x", "new")]),
        ("out", vec![file("a.glb", "new"), file("../x", "new")]),
        ("out", vec![file("a.glb", "new"), file("a.glb", "newer")]),
    ];
    let mut told = Vec::new();
    for (folder, files) in cases {
        let error = write_all(&dir.path().join(folder), files).unwrap_err();
        told.push(format!("{error:?}").replace(dir.path().to_str().unwrap(), "DIR"));
        assert_eq!(tree(dir.path()), before, "{}", told.last().unwrap());
    }
    insta::assert_snapshot!(told.join("\n"));
}

/// A killed run drops its locks; a running one holds them, here in the same process.
#[test]
fn temporary_files_of_a_killed_run_are_removed() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("out");
    let mut running = Staged::new(&out).unwrap();
    running.add(vec![file("a.glb", "slow"), file("sub/b", "slow")]).unwrap();
    for killed in ["", "sub"] {
        for (name, files) in [(".larix-dead.part", &["lock", "1", "2"][..]), (".larix-x.part", &[])]
        {
            let folder = out.join(killed).join(name);
            fs::create_dir(&folder).unwrap();
            files.iter().for_each(|f| fs::write(folder.join(f), "left").unwrap());
        }
    }
    fs::write(out.join(".larix-mine.part"), "a file").unwrap();
    fs::create_dir(out.join(".larix-mine")).unwrap();
    let before = tree(dir.path()).len();
    write_all(&out, vec![file("c.glb", "new"), file("sub/d", "new")]).unwrap();
    // Two folders of a killed run each, with three files, or none.
    assert_eq!(tree(dir.path()).len(), before - 2 * (4 + 1) + 2);
    running.commit().unwrap();
    assert_eq!(fs::read(out.join("a.glb")).unwrap(), b"slow");
    assert_eq!(fs::read(out.join("sub/b")).unwrap(), b"slow");
}

#[test]
fn forms_of_an_earlier_run_are_told_and_stay() {
    let dir = tempfile::tempdir().unwrap();
    for name in [
        "tree.glb",
        "tree_LOD1.glb",
        "tree_LOD2.glb",
        "tree_LOD2.obj",
        "tree_2.glb",
        "tree_impostor.glb",
        "tree_LOD.glb",
        "tree_old_LOD2.glb",
        "trees_LOD2.glb",
        "other_LOD2.glb",
        "tree_x0_y12.glb",
        "tree_x0_y12_LOD1.glb",
        "tree_terrain.glb",
        "tree_x0_old.glb",
    ] {
        fs::write(dir.path().join(name), "old").unwrap();
    }
    let before = tree(dir.path()).len();
    let mut staged = Staged::new(dir.path()).unwrap();
    staged.add(vec![file("tree.glb", "new"), file("tree_LOD1.glb", "new")]).unwrap();
    // Another tree may well be `tree_2`.
    let told = staged.of_earlier_runs("tree");
    let left = [
        "tree_LOD2.glb",
        "tree_impostor.glb",
        "tree_terrain.glb",
        "tree_x0_y12.glb",
        "tree_x0_y12_LOD1.glb",
    ];
    assert_eq!(told, left);
    // Nor is a whole where this run wrote parts.
    let mut parts = Staged::new(dir.path()).unwrap();
    parts.add(vec![file("tree_x0_y12.glb", "new")]).unwrap();
    assert!(parts.of_earlier_runs("tree").starts_with(&["tree.glb".to_owned()]));
    drop(parts);
    staged.commit().unwrap();
    assert_eq!(tree(dir.path()).len(), before);
}

/// `/proc` takes no new folders or files, whoever asks.
#[test]
#[cfg(target_os = "linux")]
fn a_folder_that_takes_no_files_is_named_with_a_remedy() {
    for folder in ["/proc/larix", "/proc"] {
        let error = write_all(Path::new(folder), vec![file("a.glb", "new")]).unwrap_err();
        assert!(error.to_string().starts_with(folder), "{error:?}");
        assert_eq!(
            error.remedy_text(),
            Some("choose an output folder that you may write to"),
            "{error:?}"
        );
    }
}

/// No disk is filled for this: the message is tested alone.
#[test]
fn a_full_disk_says_how_much_to_free() {
    let full = std::io::Error::from(std::io::ErrorKind::StorageFull);
    let error = disk::unwritable(Path::new("out/forest.glb"), &full, 4_200_000);
    assert_eq!(
        error.remedy_text(),
        Some(
            "the disk was full after 4.2 MB of output: free more, or choose another output folder"
        )
    );
}

/// A collider and wind on every prototype of the sample.
fn with_extras() -> ValidScene {
    let mut scene = sample();
    let body = tetrahedron();
    for prototype in &mut scene.prototypes {
        let collider = Collider { shape: ColliderShape::Convex, body: body.clone() };
        prototype.colliders = vec![collider; 2];
        for (k, part) in prototype.parts.iter_mut().enumerate() {
            let count = part.surface.position.len();
            part.surface.wind = (0..count).map(|i| [i as u8, k as u8, 3, 255]).collect();
        }
    }
    scene.validate().unwrap()
}

#[test]
fn colliders_and_wind_read_back_as_they_were() {
    let scene = with_extras();
    let glb = &files(&scene, "forest", &[Format::Glb])[0];
    let (document, buffers, _) = ::gltf::import_slice(&glb.bytes).unwrap();
    let root = document.default_scene().unwrap().nodes().next().unwrap();
    let mut trees = 0;
    for node in root.children().skip(1).flat_map(|group| group.children()) {
        let name = node.name().unwrap();
        let bodies: Vec<_> = node.children().map(|c| c.name().unwrap().to_owned()).collect();
        assert_eq!(bodies, [format!("UCX_{name}_00"), format!("UCX_{name}_01")]);
        for child in node.children() {
            let primitive = child.mesh().unwrap().primitives().next().unwrap();
            let reader = primitive.reader(|b| Some(&buffers[b.index()]));
            assert_eq!(reader.read_positions().unwrap().count(), 4);
            assert_eq!(reader.read_indices().unwrap().into_u32().count(), 12);
            assert!(reader.read_normals().is_none() && primitive.material().index().is_none());
        }
        for (k, primitive) in node.mesh().unwrap().primitives().enumerate() {
            let reader = primitive.reader(|b| Some(&buffers[b.index()]));
            let colours: Vec<[u8; 4]> = reader.read_colors(0).unwrap().into_rgba_u8().collect();
            assert_eq!(colours.len(), reader.read_positions().unwrap().count());
            let as_written = |(i, c): (usize, &[u8; 4])| *c == [i as u8, k as u8, 3, 255];
            assert!(colours.iter().enumerate().all(as_written));
        }
        trees += 1;
    }
    assert_eq!(trees, scene.instances().len());
}

#[test]
fn a_collider_that_encloses_nothing_is_refused() {
    let mut scene = with_extras().into_scene();
    scene.prototypes[1].colliders[0].body.index.reverse();
    let error = scene.validate().unwrap_err();
    assert!(error.to_string().contains("encloses no volume"), "{error}");
}
