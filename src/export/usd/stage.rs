//! A validated scene as layers: what stands where, and the trees in their places.

use std::collections::BTreeMap;

use glam::Vec3;

use super::layer::{Arc, Layer, Prim, Property, Specifier, Value, VariantSet};
use super::material::{Colours, TexturePaths, material};
use super::prototype::{LOOKS, hints, looks, mesh, prototype, shown_colour};
use crate::export::GENERATOR;
use crate::frame::Frame;
use crate::scene::{Instance, OWN_LOOK, SpeciesGroup, TreeFacts, ValidScene};
use crate::seed::Seed;

/// A species of more trees than this is split into cells, which viewers cull and artists switch.
const CELLED_FROM: usize = 10_000;
/// Side of a cell, metres.
const CELL_M: f32 = 200.0;

/// The layer of the scene. `textures` are as this layer finds them; `asset` names the file of a
/// prototype that has a layer of its own, none where they are in this one.
pub(super) fn scene_layer<'a>(
    scene: &'a ValidScene,
    textures: &TexturePaths,
    asset: Option<&dyn Fn(&str) -> String>,
) -> Layer<'a> {
    let name = scene.name();
    let mut root = Prim::def("Xform", name)
        .kind("assembly")
        .meta("apiSchemas", Value::Prepended(vec!["GeomModelAPI"]))
        .with(extent("extentsHint", scene.bounds()));
    if let Some(terrain) = scene.terrain() {
        let parent = format!("/{name}/materials");
        let shown = &scene.materials()[terrain.material as usize];
        let shown = material(scene, shown, Colours::of(shown), &parent, textures);
        root = root
            .child(Prim::def("Scope", "materials").child(shown))
            .child(mesh(scene, terrain, &parent).kind("component"));
    }
    if !scene.groups().is_empty() {
        let mut trees = Prim::def("Xform", "trees").kind("group");
        let species = scene.groups().iter().map(|group| species(scene, group, textures, asset));
        trees.children = species.collect();
        root = root.child(trees);
        root = with_looks(scene, root);
    }
    let mut layer = bare_layer(name);
    layer.metadata.insert(0, ("customLayerData", about(scene)));
    layer.prims.push(root);
    layer
}

/// Seasons and conditions of all trees at once: a choice for every prototype that knows it.
fn with_looks<'a>(scene: &'a ValidScene, mut root: Prim<'a>) -> Prim<'a> {
    let all = scene.prototypes().iter().flat_map(|one| looks(scene, one));
    let mut names = vec![OWN_LOOK];
    for name in all {
        if !names.contains(&name) {
            names.push(name);
        }
    }
    if names.len() == 1 {
        return root;
    }
    let over = |name: &'a str| Prim::new(Specifier::Over, "", name);
    let chosen = |name: &'a str| {
        let mut trees = over("trees");
        for group in scene.groups() {
            let mut held = Vec::new();
            for &p in &group.prototypes {
                let one = &scene.prototypes()[p as usize];
                let known = looks(scene, one);
                if !known.is_empty() {
                    let look = if known.contains(&name) { name } else { OWN_LOOK };
                    let choice = Value::Selections(vec![(LOOKS, look.to_owned())]);
                    held.push(over(&one.name).meta("variants", choice));
                }
            }
            if held.is_empty() {
                continue;
            }
            let mut species = over(&group.name);
            if is_celled(group) {
                let mut prototypes = over("prototypes");
                prototypes.children = held;
                held = vec![prototypes];
            }
            species.children = held;
            trees = trees.child(species);
        }
        Prim::variant(name).child(trees)
    };
    let variants = names.into_iter().map(chosen).collect();
    root.variant_sets.push(VariantSet { name: LOOKS, variants });
    root.meta("variants", Value::Selections(vec![(LOOKS, OWN_LOOK.to_owned())]))
}

fn is_celled(group: &SpeciesGroup) -> bool {
    group.instances.len() > CELLED_FROM
}

/// The layer of one prototype, to be opened alone or referred to.
pub(super) fn prototype_layer<'a>(
    scene: &'a ValidScene,
    index: u32,
    textures: &TexturePaths,
) -> Layer<'a> {
    let one = &scene.prototypes()[index as usize];
    let mut layer = bare_layer(&one.name);
    layer.prims.push(prototype(scene, one, "", true, textures));
    layer
}

fn bare_layer<'a>(default_prim: &'a str) -> Layer<'a> {
    let metadata = vec![
        ("defaultPrim", Value::token(default_prim)),
        ("metersPerUnit", Value::Double(1.0)),
        ("upAxis", Value::token("Z")),
    ];
    Layer { metadata, prims: Vec::new() }
}

/// What puts the scene back on the map.
fn about(scene: &ValidScene) -> Value<'_> {
    let Frame { origin, crs } = scene.frame();
    let unit_m = scene.frame().unit_m();
    let note = "east = origin[0] + x / unit_m[0], north = origin[1] + y / unit_m[1], \
                up = origin[2] + z / unit_m[2]";
    let mut entries = Vec::new();
    let epsg = crs.as_ref().and_then(|crs| crs.epsg);
    if let Some(epsg) = epsg.and_then(|code| i32::try_from(code).ok()) {
        entries.push(("epsg".into(), Value::Int(epsg)));
    }
    entries.push(("generator".into(), Value::string(GENERATOR)));
    entries.push(("note".into(), Value::string(note)));
    entries.push(("origin".into(), Value::Double3(origin.to_array())));
    entries.push(("unit_m".into(), Value::Double3(unit_m.to_array())));
    if let Some(wkt) = crs.as_ref().and_then(|crs| crs.wkt.as_deref()) {
        entries.push(("wkt".into(), Value::string(wkt)));
    }
    Value::Dictionary(vec![("larix".into(), Value::Dictionary(entries))])
}

/// A species: one instancer with its prototypes in it, or one a cell beside them.
fn species<'a>(
    scene: &'a ValidScene,
    group: &'a SpeciesGroup,
    textures: &TexturePaths,
    asset: Option<&dyn Fn(&str) -> String>,
) -> Prim<'a> {
    let all: Vec<&Instance> =
        group.instances.iter().map(|&i| &scene.instances()[i as usize]).collect();
    let numbers = || group.instances.iter().copied().zip(all.iter().copied());
    let path = format!("/{}/trees/{}", scene.name(), group.name);
    let within = |path: &str| -> Vec<Prim<'a>> {
        group
            .prototypes
            .iter()
            .map(|&p| {
                let one = &scene.prototypes()[p as usize];
                let prim = match asset {
                    None => prototype(scene, one, path, false, textures),
                    Some(asset) => {
                        let prim = format!("/{}", one.name);
                        Prim::def("Xform", one.name.as_str())
                            .meta("payload", Value::Arc(Arc { asset: asset(&one.name), prim }))
                    }
                };
                // One that is held here tells those of its only form itself.
                match asset.is_none() && one.levels.is_empty() {
                    true => prim,
                    false => prim.with(hints(one)),
                }
            })
            .collect()
    };
    if !is_celled(group) {
        let trees: Vec<_> = numbers().collect();
        let mut prim = instancer(scene, group, group.name.clone(), &trees, &path);
        prim.children = within(&path);
        return prim;
    }
    let mut cells: BTreeMap<[i32; 2], Vec<(u32, &Instance)>> = BTreeMap::new();
    for (number, tree) in numbers() {
        let cell = [tree.position.y, tree.position.x].map(|v| (v / CELL_M).floor() as i32);
        cells.entry(cell).or_default().push((number, tree));
    }
    // Of an `over`, renderers show nothing but what instancers point at.
    let held = format!("{path}/prototypes");
    let mut prototypes = Prim::new(Specifier::Over, "", "prototypes");
    prototypes.children = within(&held);
    let mut prim = Prim::def("Xform", group.name.as_str()).kind("group").child(prototypes);
    for (number, trees) in cells.values().enumerate() {
        let name = format!("cell_{number:04}");
        prim = prim.child(instancer(scene, group, name, trees, &held));
    }
    prim
}

/// `held`: the path of what the prototypes are in. Orientations are written twice: as
/// `orientations` (half floats, which every reader knows; see [`crate::scene::turn`]) and as
/// `orientationsf` (exact, preferred by readers that know it).
fn instancer<'a>(
    scene: &'a ValidScene,
    group: &'a SpeciesGroup,
    name: String,
    trees: &[(u32, &'a Instance)],
    held: &str,
) -> Prim<'a> {
    let each = || trees.iter().map(|(_, tree)| *tree);
    let mut number = vec![0i32; scene.prototypes().len()];
    for (at, &prototype) in (0i32..).zip(&group.prototypes) {
        number[prototype as usize] = at;
    }
    let targets = group.prototypes.iter().map(|&p| &scene.prototypes()[p as usize].name);
    let turns: Vec<[f32; 4]> = each()
        .map(|tree| {
            let (sin, cos) = (tree.yaw_rad * 0.5).sin_cos();
            [cos, 0.0, 0.0, sin]
        })
        .collect();
    let shown = shown_colour(scene, group);
    let (tints, colours): (Vec<Vec3>, Vec<Vec3>) = each()
        .map(|tree| {
            let tint = tint(scene.frame().key(tree.position));
            (tint, (shown * tint).clamp(Vec3::ZERO, Vec3::ONE))
        })
        .unzip();
    let ids = trees.iter().map(|(number, _)| i64::from(*number)).collect();
    let mut prim = Prim::def("PointInstancer", name).kind("group");
    if let Some(bounds) = scene.bounds_of(each()) {
        prim = prim.with(extent("extent", bounds));
    }
    let fact = |prim: Prim<'a>, name: &'static str, fact: fn(&TreeFacts) -> f32| {
        let values: Vec<f32> = each().map(|tree| fact(&tree.facts)).collect();
        prim.varying("float[]", name, Value::Floats(values.into()))
    };
    prim = prim
        .attribute("int64[]", "ids", Value::Int64s(ids))
        .attribute("quath[]", "orientations", Value::Quaths(turns.clone()))
        .attribute("quatf[]", "orientationsf", Value::Quatfs(turns))
        .attribute("point3f[]", "positions", Value::Float3s(each().map(|t| t.position).collect()));
    prim = fact(prim, "primvars:confidence", |f| f.confidence);
    prim = fact(prim, "primvars:crown_base_height_m", |f| f.crown_base_height_m);
    prim = fact(prim, "primvars:crown_diameter_m", |f| f.crown_diameter_m);
    prim = prim.varying("color3f[]", "primvars:displayColor", Value::Float3s(colours.into()));
    prim = fact(prim, "primvars:height_m", |f| f.height_m);
    prim = fact(prim, "primvars:stem_diameter_m", |f| f.stem_diameter_m);
    let ids = each().map(|t| t.facts.id.as_str().into()).collect();
    prim.attribute("string", "primvars:species", Value::string(group.species.as_str()))
        .varying("color3f[]", "primvars:tint", Value::Float3s(tints.into()))
        .varying("string[]", "primvars:tree_id", Value::Strings(ids))
        .attribute(
            "int[]",
            "protoIndices",
            Value::Ints(each().map(|t| number[t.prototype as usize]).collect()),
        )
        .relationship("prototypes", targets.map(|name| format!("{held}/{name}")).collect())
        .attribute("float3[]", "scales", Value::Float3s(each().map(|t| t.scale).collect()))
}

/// What a tree's colours are multiplied by: up to a tenth lighter or darker, and a little to yellow
/// or to blue.
fn tint(key: u64) -> Vec3 {
    let mut draws = Seed::new(0).derive("tint", key).draws();
    let (light, warm) = (draws.between(0.9, 1.1), draws.between(-0.06, 0.06));
    light * Vec3::new(1.0 + warm, 1.0, 1.0 - warm)
}

pub(super) fn extent<'a>(name: &'static str, (low, high): (Vec3, Vec3)) -> Property<'a> {
    Property::attribute("float3[]", name, Some(Value::Float3s(vec![low, high].into())))
}
