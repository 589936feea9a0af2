//! Random layers for other readers, and scenes of every shape that the structure takes.

use std::path::Path;

use glam::{Vec2, Vec3};

use super::layer::{Arc, Content, Layer, Prim, Property, Specifier, Value, VariantSet};
use super::*;
use crate::export::{Format, Job, WindAs, files, write_all};
use crate::scene::sample::{forest, tetrahedron};
use crate::scene::{Apart, Collider, ColliderShape, Level, Scene, Variant};
use crate::seed::{Draws, Seed};

/// A layer of any structure that the encoders take, and values of every kind and size.
fn random_layer(seed: u64) -> Layer<'static> {
    let mut draws = Seed::new(seed).derive("layer", 0).draws();
    let count = draws.index(4);
    let prims: Vec<Prim> =
        (0..count).map(|k| random_prim(&mut draws, &format!("p{k}"), 0)).collect();
    let mut metadata = vec![("metersPerUnit", Value::Double(f64::from(draws.unit())))];
    if let Some(first) = prims.first() {
        metadata.push(("defaultPrim", Value::token(first.name.to_string())));
    }
    metadata.push(("customLayerData", random_dictionary(&mut draws, 0)));
    Layer { metadata, prims }
}

fn random_prim(draws: &mut Draws, name: &str, depth: usize) -> Prim<'static> {
    let specifier = if draws.index(4) == 0 { Specifier::Over } else { Specifier::Def };
    let type_name = ["", "Xform", "Mesh", "Scope"][draws.index(4)];
    let mut prim = Prim::new(specifier, type_name, name.to_owned());
    if draws.index(2) == 0 {
        prim = prim.kind("group");
    }
    if draws.index(3) == 0 {
        prim = prim.meta("apiSchemas", Value::Prepended(vec!["GeomModelAPI", "MotionAPI"]));
    }
    if draws.index(3) == 0 {
        prim = prim.meta("customData", random_dictionary(draws, 0));
    }
    for name in ["payload", "references"] {
        if draws.index(5) == 0 {
            let arc = Arc { asset: "./other.usda".into(), prim: "/a/b".into() };
            prim = prim.meta(name, Value::Arc(arc));
        }
    }
    for k in 0..draws.index(12) {
        let name = ["points", "primvars:st", "ids", "text"][draws.index(4)].to_owned();
        let name = format!("{name}{k}");
        prim = match draws.index(8) {
            0 => {
                let targets = (1..=1 + draws.index(3)).map(|k| format!("/p0/c{k}.x:y")).collect();
                prim.with(Property { name: name.into(), content: Content::Relationship(targets) })
            }
            1 => prim.connected("float", "inputs:a", "/p1/deep/er.outputs:r".into()),
            2 => prim.declared("token", "outputs:surface"),
            _ => {
                let (type_name, value) = random_value(draws);
                let mut property = Property::attribute(type_name, name, Some(value));
                if let Content::Attribute { is_uniform, metadata, .. } = &mut property.content {
                    *is_uniform = draws.index(3) == 0;
                    if draws.index(3) == 0 {
                        metadata.push(("interpolation", Value::token("vertex")));
                    }
                }
                prim.with(property)
            }
        };
        // A property is there once.
        let last = prim.properties.len() - 1;
        if prim.properties[..last].iter().any(|p| p.name == prim.properties[last].name) {
            prim.properties.pop();
        }
    }
    if depth < 4 {
        for k in 0..draws.index(4) {
            prim = prim.child(random_prim(draws, &format!("c{k}"), depth + 1));
        }
        if draws.index(3) == 0 {
            let variants: Vec<Prim> = (0..=draws.index(3))
                .map(|k| {
                    let variant = random_prim(draws, &format!("v{k}"), depth + 1);
                    Prim { specifier: Specifier::Over, type_name: "", ..variant }
                })
                .collect();
            let chosen = vec![("LOD", variants[0].name.to_string())];
            prim = prim.meta("variants", Value::Selections(chosen));
            prim.variant_sets.push(VariantSet { name: "LOD", variants });
        }
    }
    prim
}

fn random_dictionary(draws: &mut Draws, depth: usize) -> Value<'static> {
    let mut entries = Vec::new();
    for k in 0..draws.index(4) {
        let value = if depth < 3 && draws.index(3) == 0 {
            random_dictionary(draws, depth + 1)
        } else {
            random_value(draws).1
        };
        entries.push((format!("key{k}").into(), value));
    }
    Value::Dictionary(entries)
}

/// With the type that declares it.
fn random_value(draws: &mut Draws) -> (&'static str, Value<'static>) {
    let count = [0, 1, 3, 15, 16, 17, 100, 5000][draws.index(8)];
    let scale = [1.0, 100.0, 1e9][draws.index(3)];
    let mut number = || {
        let value = draws.between(-scale, scale);
        if draws.index(2) == 0 { value.round() } else { value }
    };
    let float3s: Vec<Vec3> = (0..count).map(|_| Vec3::new(number(), number(), number())).collect();
    let one = [number(), number(), number(), number()];
    let quats = || vec![one; count];
    let ints = || float3s.iter().map(|v| v.x as i32).collect::<Vec<_>>();
    match draws.index(18) {
        0 => ("bool", Value::Bool(one[0] > 0.0)),
        1 => ("int", Value::Int(one[0] as i32)),
        2 => ("float", Value::Float(one[0])),
        3 => ("double", Value::Double(f64::from(one[0]) * 1.1)),
        4 => ("string", Value::string(format!("text \"{}\"\n\\ и \u{7}", one[0]))),
        5 => ("token", Value::token(["", "a token", "vertex"][draws.index(3)])),
        6 => ("asset", Value::Asset("textures/a b.png".into())),
        7 => ("color3f", Value::Float3([one[0], one[1], one[2]])),
        8 => ("float4", Value::Float4(one)),
        9 => ("double3", Value::Double3([f64::from(one[0]) / 3.0, 1.0, -2.0])),
        10 => ("int[]", Value::Ints(ints().into())),
        11 => ("int[]", Value::Repeated(one[0] as i32, count)),
        12 => ("int64[]", Value::Int64s(ints().iter().map(|v| i64::from(*v) << 8).collect())),
        13 => ("float[]", Value::Floats(float3s.iter().map(|v| v.y).collect())),
        14 => {
            let values: Vec<Vec2> = float3s.iter().map(|v| v.truncate()).collect();
            ("texCoord2f[]", Value::Float2s(values.into()))
        }
        15 => ("point3f[]", Value::Float3s(float3s.into())),
        16 => ("quatf[]", Value::Quatfs(quats())),
        _ => {
            let texts = float3s.iter().map(|v| format!("{}", v.x as i32 % 7).into());
            ("string[]", Value::Strings(texts.collect()))
        }
    }
}

/// For `tools/validate.py --same`:
/// `LARIX_SAMPLE=DIR cargo test --lib usd::tests::layers_on_disk -- --ignored`.
#[test]
#[ignore = "for checks outside of Rust"]
fn layers_on_disk() {
    let dir = std::env::var("LARIX_SAMPLE").expect("LARIX_SAMPLE names a folder");
    for seed in 0..200 {
        let layer = random_layer(seed);
        for encoding in [Encoding::Text, Encoding::Crate] {
            let name = format!("layer{seed:03}.{}", encoding.extension());
            let file = std::fs::File::create(Path::new(&dir).join(name)).unwrap();
            write(&layer, encoding, &mut io::BufWriter::new(file)).unwrap();
        }
    }
}

/// Trees with two coarser forms, colliders and wind.
fn levelled() -> Scene {
    let mut scene = forest(&["Larix sibirica", "Betula pendula"], 12, 60.0);
    let body = tetrahedron();
    for prototype in &mut scene.prototypes {
        prototype.colliders = vec![Collider { shape: ColliderShape::Convex, body: body.clone() }];
        for part in &mut prototype.parts {
            part.surface.wind = vec![[10, 20, 30, 255]; part.surface.position.len()];
        }
        for (name, parts) in [("LOD1", 0..2), ("impostor", 1..2)] {
            prototype.levels.push(Level {
                name: name.into(),
                parts: prototype.parts[parts].to_vec(),
                silhouette: Apart { worst_m: 0.5, rms_m: 0.1 },
                octahedral: None,
            });
        }
    }
    scene
}

/// Larches know an autumn; birches know none.
#[test]
fn looks_are_chosen_for_the_scene_or_for_a_model() {
    let mut scene = forest(&["Larix", "Betula"], 3, 20.0);
    let leaf = scene.materials.iter_mut().find(|m| m.name == "Larix_leaf").unwrap();
    leaf.variants.push(Variant {
        name: "autumn".into(),
        base_color: [1.0, 0.5, 0.1],
        base_color_texture: leaf.base_color_texture,
    });
    let scene = scene.validate().unwrap();
    let texts: Vec<(String, String)> = layers(&scene, "wood", Encoding::Text)
        .into_iter()
        .map(|f| (f.path.display().to_string(), String::from_utf8(f.into_bytes()).unwrap()))
        .collect();
    let times = |text: &str, part: &str| text.matches(part).count();
    for (path, text) in &texts {
        let is_larch = path.contains("Larix");
        let looks = if path == "wood.usda" { 1 } else { usize::from(is_larch) };
        assert_eq!(times(text, "variantSet \"look\""), looks, "{path}");
        // The whole leaf in either look, so that nothing outside is stronger; the rest once.
        assert_eq!(times(text, "def Material \"Larix_leaf\""), 2 * usize::from(is_larch), "{path}");
        assert_eq!(times(text, "def Material \"Larix_bark\""), usize::from(is_larch), "{path}");
        assert_eq!(times(text, "(1, 0.5, 0.1, 1)"), usize::from(is_larch), "{path}");
    }
    // Own for the scene by default, and in the choice of each of the two larches.
    let [root, ..] = &texts[..] else { panic!() };
    assert_eq!(times(&root.1, "string look = \"own\""), 1 + 2);
    assert_eq!(times(&root.1, "string look = \"autumn\""), 2);
}

#[test]
fn a_package_too_large_is_refused_before_it_is_written() {
    let scene = levelled().validate().unwrap();
    let pictures = Pictures::encode(&scene, &[PictureFormat::Png]).unwrap();
    let package = |most| package_within(&scene, &pictures, "forest", most);
    let bytes = package(package::MOST_BYTES).unwrap().into_bytes().len() as u64;
    assert!(bytes < bytes_at_most(&scene, &pictures));
    assert_eq!(package(bytes).unwrap().into_bytes().len() as u64, bytes);
    let error = package(bytes - 1).err().unwrap();
    let text = format!("{error:?}");
    assert!(text.starts_with("forest.usdz: needs up to 0.0 GiB, and a package holds"), "{text}");
}

/// For `tools/validate.py`, as above: a scene with coarser forms, and one of many trees.
#[test]
#[ignore = "for checks outside of Rust"]
fn scenes_on_disk() {
    let dir = std::env::var("LARIX_SAMPLE").expect("LARIX_SAMPLE names a folder");
    let formats = [Format::Glb, Format::Usda, Format::Usdc, Format::Usdz];
    for (name, scene) in
        [("levels", levelled()), ("cells", forest(&["Larix sibirica"], 10_500, 500.0))]
    {
        let scene = scene.validate().unwrap();
        let job = Job { wind: WindAs::Color, ..Job::new("forest", &formats) };
        let pictures = Pictures::encode(&scene, &job.picture_formats()).unwrap();
        let files = files(&scene, &pictures, &job).unwrap().value;
        write_all(&Path::new(&dir).join(name), files).unwrap();
    }
}
