//! KHR_materials_variants: other colours under one name, on every primitive (Blender 4.2 fails where
//! only some have them).

use serde::Serialize;

use crate::scene::{OWN_LOOK, Selection};

pub(super) const EXTENSION: &str = "KHR_materials_variants";

#[derive(Serialize)]
pub(super) struct Extensions<'a> {
    #[serde(rename = "KHR_materials_variants")]
    variants: Variants<'a>,
}

#[derive(Serialize)]
struct Variants<'a> {
    variants: Vec<Named<'a>>,
}

#[derive(Serialize)]
struct Named<'a> {
    name: &'a str,
}

#[derive(Serialize)]
pub(super) struct PrimitiveExtensions {
    #[serde(rename = "KHR_materials_variants")]
    variants: Mappings,
}

#[derive(Serialize)]
struct Mappings {
    mappings: Vec<Mapping>,
}

#[derive(Serialize)]
struct Mapping {
    material: u32,
    variants: Vec<u32>,
}

/// Names of all variants in the scene, in the order they first occur, after the look that readers
/// begin with: by it they find back.
pub(super) fn names<'a>(selection: &Selection<'a>) -> Vec<&'a str> {
    let mut names: Vec<&'a str> = Vec::new();
    for variant in selection.materials.iter().flat_map(|m| &m.variants) {
        if !names.contains(&variant.name.as_str()) {
            names.push(&variant.name);
        }
    }
    if !names.is_empty() {
        names.insert(0, OWN_LOOK);
    }
    names
}

pub(super) fn of_document<'a>(selection: &Selection<'a>) -> Option<Extensions<'a>> {
    let variants: Vec<Named<'a>> =
        names(selection).into_iter().map(|name| Named { name }).collect();
    (!variants.is_empty()).then_some(Extensions { variants: Variants { variants } })
}

/// Which material a primitive has in each variant: its own where it knows no other. Variants'
/// materials follow all others, in the order of their owners.
pub(super) fn of_primitive(
    selection: &Selection<'_>,
    material: u32,
    names: &[&str],
) -> Option<PrimitiveExtensions> {
    if names.is_empty() {
        return None;
    }
    let (before, from) = selection.materials.split_at(material as usize);
    let count = |m: &&crate::scene::Material| m.variants.len();
    let first = selection.materials.len() + before.iter().map(count).sum::<usize>();
    let own = &from[0].variants;
    let mut mappings: Vec<Mapping> = Vec::new();
    for (at, name) in (0u32..).zip(names) {
        let other = own.iter().position(|v| v.name == *name);
        let shown = other.map_or(material, |k| (first + k) as u32);
        match mappings.iter_mut().find(|m| m.material == shown) {
            Some(mapping) => mapping.variants.push(at),
            None => mappings.push(Mapping { material: shown, variants: vec![at] }),
        }
    }
    Some(PrimitiveExtensions { variants: Mappings { mappings } })
}
