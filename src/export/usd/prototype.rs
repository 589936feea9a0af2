//! A prototype: its surfaces, its coarser forms as variants, what physics sees, its materials.

use std::collections::BTreeSet;

use glam::Vec3;

use super::layer::{Prim, Property, Value, VariantSet};
use super::material::{Colours, TexturePaths, material};
use super::stage::extent;
use crate::raster::linear_from_srgb;
use crate::scene::{
    Apart, Collider, Level, Material, OWN_LOOK, Octahedral, Part, Prototype, SpeciesGroup,
    ValidScene,
};

/// The name of the variant that shows the finest form.
const FINEST: &str = "LOD0";
/// The variant set of seasons and conditions.
pub(super) const LOOKS: &str = "look";

/// Without coarser forms the surfaces stand in the prototype. With them they are chosen by the
/// variant set `LOD`, seen by final renderers (purpose `render`), and the coarsest form is what
/// viewports show (purpose `proxy`). Materials that know other seasons and conditions are in the
/// variant set `look`; `chooses_look`: where nothing stronger chooses. `parent` is the path of the
/// prim that it is put in.
pub(super) fn prototype<'a>(
    scene: &'a ValidScene,
    one: &'a Prototype,
    parent: &str,
    chooses_look: bool,
    textures: &TexturePaths,
) -> Prim<'a> {
    let path = format!("{parent}/{}", one.name);
    let materials = format!("{path}/materials");
    let mut prim = Prim::def("Xform", one.name.as_str())
        .kind("component")
        .meta("apiSchemas", Value::Prepended(vec!["GeomModelAPI"]));
    if let Some(silhouette) = &one.silhouette {
        prim = prim.meta("customData", told(silhouette, one.octahedral.as_ref()));
    }
    let proxy = coarsest(one);
    let chosen = |mut variant: Prim<'a>, parts: &'a [Part]| {
        variant = variant.with(hints_of(one, around(parts.iter().map(|p| p.surface.bounds()))));
        for part in parts {
            let mut shown = mesh(scene, part, &materials);
            if proxy.is_some() {
                shown = shown
                    .uniform("token", "purpose", Value::token("render"))
                    .relationship("proxyPrim", vec![format!("{path}/proxy")]);
            }
            variant = variant.child(shown);
        }
        variant
    };
    let looks = looks(scene, one);
    let mut selections = Vec::new();
    let library = |is_wanted: &dyn Fn(&Material) -> bool, look: &str| {
        let mut library = Prim::def("Scope", "materials");
        for shown in materials_of(scene, one).filter(|m| is_wanted(m)) {
            let colours = Colours::in_variant(shown, look);
            library = library.child(material(scene, shown, colours, &materials, textures));
        }
        library
    };
    prim = prim.child(library(&|m| m.variants.is_empty(), OWN_LOOK));
    if !looks.is_empty() {
        // Whole materials: what stood outside of the variants would be stronger than they.
        let look =
            |name: &'a str| Prim::variant(name).child(library(&|m| !m.variants.is_empty(), name));
        let variants = [OWN_LOOK].into_iter().chain(looks).map(look).collect();
        if chooses_look {
            selections.push((LOOKS, OWN_LOOK.to_owned()));
        }
        prim.variant_sets.push(VariantSet { name: LOOKS, variants });
    }
    if one.levels.is_empty() {
        prim = chosen(prim, &one.parts);
        if !one.scattered.is_empty() {
            prim = prim.child(scattered(scene, one, &path));
        }
    } else {
        let finest = chosen(Prim::variant(FINEST), &one.parts);
        let coarser = one.levels.iter().map(|level| {
            let variant = Prim::variant(level.name.as_str())
                .meta("customData", told(&level.silhouette, level.octahedral.as_ref()));
            chosen(variant, &level.parts)
        });
        let variants = [finest].into_iter().chain(coarser).collect();
        selections.insert(0, ("LOD", FINEST.to_owned()));
        prim.variant_sets.insert(0, VariantSet { name: "LOD", variants });
    }
    if !selections.is_empty() {
        prim = prim.meta("variants", Value::Selections(selections));
    }
    if let Some(level) = proxy {
        let mut shown =
            Prim::def("Xform", "proxy").uniform("token", "purpose", Value::token("proxy"));
        shown.children = level.parts.iter().map(|part| mesh(scene, part, &materials)).collect();
        prim = prim.child(shown);
    }
    for (k, collider) in one.colliders.iter().enumerate() {
        prim = prim.child(collider_mesh(collider, collider.name(&one.name, k)));
    }
    prim
}

/// What stands at many places of a prototype, as one instancer; `path`: the prototype's.
fn scattered<'a>(scene: &'a ValidScene, one: &'a Prototype, path: &str) -> Prim<'a> {
    const NAME: &str = "twigs";
    let places = || one.scattered.iter().flat_map(|s| &s.places);
    let turns: Vec<[f32; 4]> = places().map(|p| [p.turn.w, p.turn.x, p.turn.y, p.turn.z]).collect();
    let numbers = (0i32..).zip(&one.scattered);
    let numbers = numbers.flat_map(|(k, s)| std::iter::repeat_n(k, s.places.len()));
    let points = one.outer_scattered();
    let bounds = points.into_iter().map(|p| (p, p)).reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)));
    let targets = one.scattered.iter().map(|s| format!("{path}/{NAME}/{}", s.part.name));
    let mut prim = Prim::def("PointInstancer", NAME)
        .with(extent("extent", bounds.unwrap_or_default()))
        .attribute("quath[]", "orientations", Value::Quaths(turns.clone()))
        .attribute("quatf[]", "orientationsf", Value::Quatfs(turns))
        .attribute("point3f[]", "positions", Value::Float3s(places().map(|p| p.position).collect()))
        .attribute("int[]", "protoIndices", Value::Ints(numbers.collect()))
        .relationship("prototypes", targets.collect())
        .attribute(
            "float3[]",
            "scales",
            Value::Float3s(places().map(|p| Vec3::splat(p.scale)).collect()),
        );
    let materials = format!("{path}/materials");
    prim.children = one.scattered.iter().map(|s| mesh(scene, &s.part, &materials)).collect();
    prim
}

/// Those of all its forms, each once.
fn materials_of<'a>(
    scene: &'a ValidScene,
    one: &Prototype,
) -> impl Iterator<Item = &'a Material> + use<'a> {
    let used: BTreeSet<u32> = one.all_parts().map(|part| part.material).collect();
    used.into_iter().map(|index| &scene.materials()[index as usize])
}

/// Names of the other looks that its materials know, in the order they first occur.
pub(super) fn looks<'a>(scene: &'a ValidScene, one: &Prototype) -> Vec<&'a str> {
    let mut names: Vec<&str> = Vec::new();
    for variant in materials_of(scene, one).flat_map(|m| &m.variants) {
        if !names.contains(&variant.name.as_str()) {
            names.push(&variant.name);
        }
    }
    names
}

/// The coarsest form that any shader shows rightly.
fn coarsest(one: &Prototype) -> Option<&Level> {
    one.levels.iter().rev().find(|level| level.octahedral.is_none())
}

/// How far a coarser form is from the finest, and how its views are found.
fn told<'a>(silhouette: &Apart, octahedral: Option<&Octahedral>) -> Value<'a> {
    let float = |name: &'static str, value| (name.into(), Value::Float(value));
    let mut entries = vec![
        float("silhouette_rms_m", silhouette.rms_m),
        float("silhouette_worst_m", silhouette.worst_m),
    ];
    entries.extend(octahedral.map(views));
    Value::Dictionary(entries)
}

fn views<'a>(octahedral: &Octahedral) -> (std::borrow::Cow<'a, str>, Value<'a>) {
    let frames = octahedral.frames.min(i32::MAX as u32) as i32;
    let entries = vec![
        ("centre".into(), Value::Float3(octahedral.centre.to_array())),
        ("frames".into(), Value::Int(frames)),
        ("radius_m".into(), Value::Float(octahedral.radius_m)),
    ];
    ("octahedral".into(), Value::Dictionary(entries))
}

/// The bounds of a prototype in all its forms, whose layer need not be loaded for them: of what has no purpose,
/// then for `render`, `proxy` and `guide`, as far as there is something.
pub(super) fn hints<'a>(one: &Prototype) -> Property<'a> {
    let coarser = one.levels.iter().flat_map(|level| &level.parts);
    hints_of(one, around(one.parts.iter().chain(coarser).map(|p| p.surface.bounds())))
}

/// The same of one form; `bounds`: its own.
fn hints_of<'a>(one: &Prototype, bounds: (Vec3, Vec3)) -> Property<'a> {
    let [default, render, proxy] = match coarsest(one) {
        Some(level) => [NOTHING, bounds, around(level.parts.iter().map(|p| p.surface.bounds()))],
        None if one.levels.is_empty() => [one.bounds(), NOTHING, NOTHING],
        None => [bounds, NOTHING, NOTHING],
    };
    let guide = around(one.colliders.iter().map(|c| c.body.bounds()));
    let mut hints: Vec<Vec3> =
        [default, render, proxy, guide].into_iter().flat_map(|(lo, hi)| [lo, hi]).collect();
    while hints.len() > 2 && hints.ends_with(&[NOTHING.0, NOTHING.1]) {
        hints.truncate(hints.len() - 2);
    }
    Property::attribute("float3[]", "extentsHint", Some(Value::Float3s(hints.into())))
}

const NOTHING: (Vec3, Vec3) = (Vec3::splat(f32::MAX), Vec3::splat(f32::MIN));

fn around(bounds: impl Iterator<Item = (Vec3, Vec3)>) -> (Vec3, Vec3) {
    bounds.fold(NOTHING, |(lo, hi), (low, high)| (lo.min(low), hi.max(high)))
}

/// `materials`: the path of what its material is in.
pub(super) fn mesh<'a>(scene: &'a ValidScene, part: &'a Part, materials: &str) -> Prim<'a> {
    let surface = &part.surface;
    let shown = &scene.materials()[part.material as usize];
    let mut prim = Prim::def("Mesh", part.name.as_str())
        .meta("apiSchemas", Value::Prepended(vec!["MaterialBindingAPI"]));
    if shown.double_sided {
        prim = prim.uniform("bool", "doubleSided", Value::Bool(true));
    }
    prim = prim
        .with(extent("extent", surface.bounds()))
        .attribute("int[]", "faceVertexCounts", Value::Repeated(3, surface.triangles()))
        .attribute("int[]", "faceVertexIndices", Value::indices(&surface.index))
        .relationship("material:binding", vec![format!("{materials}/{}", shown.name)])
        .varying("normal3f[]", "normals", Value::Float3s(surface.normal.as_slice().into()))
        .attribute("point3f[]", "points", Value::Float3s(surface.position.as_slice().into()));
    if shown.has_textures() {
        let places = Value::Float2s(surface.uv.as_slice().into());
        prim = prim.varying("texCoord2f[]", "primvars:st", places);
    }
    if !surface.lightmap_uv.is_empty() {
        let places = Value::Float2s(surface.lightmap_uv.as_slice().into());
        prim = prim.varying("texCoord2f[]", "primvars:st1", places);
    }
    if !surface.wind.is_empty() {
        prim = prim.varying("float4[]", "primvars:wind", Value::Unorm4s(&surface.wind));
    }
    prim.uniform("token", "subdivisionScheme", Value::token("none"))
}

/// A body that physics sees and renderers do not.
fn collider_mesh(collider: &Collider, name: String) -> Prim<'_> {
    let body = &collider.body;
    let schemas = vec!["PhysicsCollisionAPI", "PhysicsMeshCollisionAPI"];
    Prim::def("Mesh", name)
        .meta("apiSchemas", Value::Prepended(schemas))
        .with(extent("extent", body.bounds()))
        .attribute("int[]", "faceVertexCounts", Value::Repeated(3, body.triangles()))
        .attribute("int[]", "faceVertexIndices", Value::indices(&body.index))
        .uniform("token", "physics:approximation", Value::token("convexHull"))
        .attribute("point3f[]", "points", Value::Float3s(body.position.as_slice().into()))
        .uniform("token", "purpose", Value::token("guide"))
        .uniform("token", "subdivisionScheme", Value::token("none"))
}

/// Mean linear colour of a species' leaves, or of its wood where it is bare: what viewports show
/// that draw no materials.
pub(super) fn shown_colour(scene: &ValidScene, group: &SpeciesGroup) -> Vec3 {
    let parts = group.prototypes.iter().flat_map(|&p| &scene.prototypes()[p as usize].parts);
    let materials: BTreeSet<u32> = parts.map(|part| part.material).collect();
    let mut of = materials.iter().map(|&m| &scene.materials()[m as usize]);
    // Wood is closed.
    let is_leaf = |m: &&Material| m.double_sided;
    let Some(material) = of.clone().find(is_leaf).or_else(|| of.next()) else { return Vec3::ONE };
    let base = Vec3::from(material.base_color);
    let Some(texture) = material.base_color_texture else { return base };
    let (mut sum, mut weight) = (Vec3::ZERO, 0.0);
    for [r, g, b, alpha] in &scene.textures()[texture as usize].image.picture().data {
        let alpha = f32::from(*alpha) / 255.0;
        sum += alpha * Vec3::from([r, g, b].map(|c| linear_from_srgb(*c)));
        weight += alpha;
    }
    base * sum / f32::max(weight, 1e-6)
}
