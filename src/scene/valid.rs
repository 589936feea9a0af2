//! The proof that a scene is sound. Every check is made here, so that writers need none.

use std::collections::{BTreeMap, BTreeSet};

use glam::Vec3;
use rayon::prelude::*;

use super::prune::is_degenerate;
use super::standing::{Standing, standings};
use super::statistics::{Outline, bounds_of};
use super::{
    Alpha, Collider, Instance, Material, OFF_TERRAIN_M, OWN_LOOK, Part, Prototype,
    ROOT_TOLERANCE_M, Scattered, Scene, Texture, identifier, is_identifier,
};
use crate::diagnostic::{Error, Result};
use crate::frame::Frame;
use crate::mesh::{Place, Surface, lightmap};

/// How far a normal's length may be from 1.
const UNIT_TOLERANCE: f32 = 1e-4;
/// Texture coordinates this far outside the picture still count as inside.
const INSIDE_TOLERANCE: f32 = 1e-3;
/// No vertex may have the index `u32::MAX`, which formats reserve.
const MOST_VERTICES: usize = u32::MAX as usize;
/// Engines take convex bodies of few corners.
const MOST_COLLIDER_VERTICES: usize = 255;
/// Formats count nodes and instances in signed 32 bits; a few are needed for groups.
const MOST_INSTANCES: usize = (i32::MAX / 2) as usize;
/// So many faults are told one by one.
const MOST_FAULTS: usize = 20;

/// A scene in which every index leads somewhere, every number is finite, every name is legal
/// and unique, every tree stands on the terrain, and nothing is unused. Only
/// [`Scene::validate`] makes one.
#[derive(Debug, Clone)]
pub struct ValidScene {
    scene: Scene,
    groups: Vec<SpeciesGroup>,
    wraps: Vec<Wrap>,
    /// Of every prototype.
    outlines: Vec<Outline>,
    bounds: (Vec3, Vec3),
}

/// The prototypes and instances of one species, in scene order; none is empty.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SpeciesGroup {
    /// Unique identifier, e.g. `Larix_sibirica`.
    pub name: String,
    /// Display name, e.g. `Larix sibirica`.
    pub species: String,
    /// Indices into [`ValidScene::prototypes`].
    pub prototypes: Vec<u32>,
    /// Indices into [`ValidScene::instances`].
    pub instances: Vec<u32>,
}

/// What a texture shows outside its edges.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Wrap {
    Repeat,
    /// All coordinates lie inside the picture, so that opposite edges must not bleed in.
    Clamp,
}

impl ValidScene {
    pub fn name(&self) -> &str {
        &self.scene.name
    }

    pub fn frame(&self) -> &Frame {
        &self.scene.frame
    }

    pub fn textures(&self) -> &[Texture] {
        &self.scene.textures
    }

    /// As the surfaces that show it need it; `texture` indexes [`ValidScene::textures`].
    pub fn wrap(&self, texture: u32) -> Wrap {
        self.wraps[texture as usize]
    }

    pub fn materials(&self) -> &[Material] {
        &self.scene.materials
    }

    pub fn terrain(&self) -> Option<&Part> {
        self.scene.terrain.as_ref()
    }

    pub fn prototypes(&self) -> &[Prototype] {
        &self.scene.prototypes
    }

    pub fn instances(&self) -> &[Instance] {
        &self.scene.instances
    }

    /// Species in order of their first prototype.
    pub fn groups(&self) -> &[SpeciesGroup] {
        &self.groups
    }

    /// Least and greatest corner of everything in its place, scene metres; exact.
    pub fn bounds(&self) -> (Vec3, Vec3) {
        self.bounds
    }

    /// The same of these instances of the scene; `None` for none.
    pub fn bounds_of<'a>(
        &self,
        instances: impl IntoIterator<Item = &'a Instance>,
    ) -> Option<(Vec3, Vec3)> {
        bounds_of(&self.outlines, instances)
    }

    /// The terrain, then the parts of every prototype in its finest form, scattered ones once.
    pub fn parts(&self) -> impl Iterator<Item = &Part> {
        let finest = self
            .scene
            .prototypes
            .iter()
            .flat_map(|p| p.parts.iter().chain(p.scattered.iter().map(|s| &s.part)));
        self.scene.terrain.iter().chain(finest)
    }

    /// Names of the coarser forms, from fine to coarse: every prototype has them all.
    pub fn level_names(&self) -> Vec<&str> {
        let levels = self.scene.prototypes.first().map_or(&[][..], |p| &p.levels);
        levels.iter().map(|l| l.name.as_str()).collect()
    }

    /// The colliders of every prototype, in their order.
    pub fn colliders(&self) -> impl Iterator<Item = &Collider> {
        self.scene.prototypes.iter().flat_map(|p| &p.colliders)
    }

    pub fn as_scene(&self) -> &Scene {
        &self.scene
    }

    /// The scene, open to change again.
    pub fn into_scene(self) -> Scene {
        self.scene
    }
}

impl Scene {
    /// Checks everything that writers rely on; tells up to 20 faults at once.
    pub fn validate(self) -> Result<ValidScene> {
        let mut faults = Faults::default();
        self.check_names(&mut faults);
        self.check_frame(&mut faults);
        self.check_textures(&mut faults);
        self.check_materials(&mut faults);
        self.check_parts(&mut faults);
        let groups = self.check_groups(&mut faults);
        self.check_instances(&mut faults);
        self.check_use(&mut faults);
        // What follows relies on indices.
        if faults.is_empty() {
            self.check_standing(&mut faults);
        }
        faults.into_result(&self.name)?;

        let terrain = self.terrain.as_ref().map(|t| t.surface.bounds());
        let outlines = Outline::of_all(&self.prototypes);
        let bounds = match (terrain, bounds_of(&outlines, &self.instances)) {
            (Some(a), Some(b)) => (a.0.min(b.0), a.1.max(b.1)),
            (Some(one), None) | (None, Some(one)) => one,
            (None, None) => return Err(fault(&self.name, "has neither terrain nor trees")),
        };
        if !(bounds.0.is_finite() && bounds.1.is_finite()) {
            return Err(fault(&self.name, "has trees too large for 32-bit coordinates"));
        }
        let wraps = self.wraps();
        Ok(ValidScene { scene: self, groups, wraps, outlines, bounds })
    }

    fn check_names(&self, faults: &mut Faults) {
        faults.identifier("the scene", &self.name);
        // Textures become files, and some disks do not tell `Bark` from `bark`.
        let files: Vec<String> =
            self.textures.iter().map(|t| t.name.to_ascii_lowercase()).collect();
        faults.unique("texture", files.iter().map(String::as_str));
        faults.unique("material", self.materials.iter().map(|m| m.name.as_str()));
        faults.unique("prototype", self.prototypes.iter().map(|p| p.name.as_str()));
        for prototype in &self.prototypes {
            let what = format!("part of prototype `{}`", prototype.name);
            let scattered = prototype.scattered.iter().map(|s| &s.part);
            let parts = prototype.parts.iter().chain(scattered);
            faults.unique(&what, parts.map(|p| p.name.as_str()));
            for level in &prototype.levels {
                let what =
                    format!("part of prototype `{}`, level `{}`", prototype.name, level.name);
                faults.unique(&what, level.parts.iter().map(|p| p.name.as_str()));
            }
        }
        let names = |p: &Prototype| p.levels.iter().map(|l| l.name.clone()).collect::<Vec<_>>();
        if let Some(first) = self.prototypes.first().map(names) {
            faults.unique("level", first.iter().map(String::as_str));
            for prototype in self.prototypes.iter().filter(|p| names(p) != first) {
                let name = &prototype.name;
                faults.add(|| format!("prototype `{name}` has not the levels of the first one"));
            }
        }
        faults.unique("instance", self.instances.iter().map(|i| i.name.as_str()));
        if let Some(terrain) = self.terrain.as_ref().filter(|t| t.name != "terrain") {
            faults.add(|| format!("the terrain is named `{}`, not `terrain`", terrain.name));
        }
        let mut ids = BTreeSet::new();
        for (at, instance) in self.instances.iter().enumerate() {
            let id = instance.facts.id.as_str();
            if id.is_empty() || !ids.insert(id) {
                let why = if id.is_empty() { "is empty" } else { "is taken" };
                faults.add(|| format!("instance {at} `{}`: its id `{id}` {why}", instance.name));
            }
        }
    }

    fn check_frame(&self, faults: &mut Faults) {
        let unit = self.frame.unit_m();
        if !self.frame.origin.is_finite() {
            faults.add(|| format!("the origin {} is not finite", self.frame.origin));
        }
        if !(unit.is_finite() && unit.min_element() > 0.0) {
            faults.add(|| format!("the units of the coordinate system, {unit} m, are not lengths"));
        }
    }

    fn check_textures(&self, faults: &mut Faults) {
        for texture in &self.textures {
            let image = &texture.image;
            if !image.is_whole() {
                faults.add(|| {
                    format!(
                        "texture `{}`: {} × {} pixels announced, {} held",
                        texture.name,
                        image.width(),
                        image.height(),
                        image.picture().data.len()
                    )
                });
            }
        }
    }

    fn check_materials(&self, faults: &mut Faults) {
        let unit = 0.0..=1.0;
        for material in &self.materials {
            let mut wrong =
                |what: String| faults.add(|| format!("material `{}`: {what}", material.name));
            if !material.base_color.iter().all(|c| unit.contains(c)) {
                wrong(format!("base colour {:?} is not within 0…1", material.base_color));
            }
            if !unit.contains(&material.roughness) {
                wrong(format!("roughness {} is not within 0…1", material.roughness));
            }
            if !unit.contains(&material.specular) {
                wrong(format!("specular {} is not within 0…1", material.specular));
            }
            if !unit.contains(&material.translucency) {
                wrong(format!("translucency {} is not within 0…1", material.translucency));
            }
            if let Alpha::Mask { cutoff } = material.alpha {
                if !unit.contains(&cutoff) {
                    wrong(format!("alpha cutoff {cutoff} is not within 0…1"));
                }
                if material.base_color_texture.is_none() {
                    wrong("is masked but has no texture to take alpha from".into());
                }
            }
            for (at, variant) in material.variants.iter().enumerate() {
                let name = &variant.name;
                let is_taken =
                    name == OWN_LOOK || material.variants[..at].iter().any(|v| v.name == *name);
                if !is_identifier(name) || is_taken {
                    wrong(format!("its variant `{name}` has no name of its own"));
                }
                if !variant.base_color.iter().all(|c| unit.contains(c)) {
                    wrong(format!(
                        "base colour {:?} of `{name}` is not within 0…1",
                        variant.base_color
                    ));
                }
                if matches!(material.alpha, Alpha::Mask { .. })
                    && variant.base_color_texture.is_none()
                {
                    wrong(format!("its variant `{name}` has no texture to take alpha from"));
                }
            }
            for (slot, index, colorspace) in material.textures() {
                match self.textures.get(index as usize) {
                    None => {
                        let count = self.textures.len();
                        wrong(format!("{slot} texture {index} of {count} does not exist"));
                    }
                    Some(t) if t.colorspace != colorspace => wrong(format!(
                        "{slot} texture `{}` is {:?}, not {colorspace:?}",
                        t.name, t.colorspace
                    )),
                    Some(_) => {}
                }
            }
        }
    }

    fn check_parts(&self, faults: &mut Faults) {
        let of_prototypes = self.prototypes.iter().flat_map(|prototype| {
            prototype.all_parts().map(move |part| (Some(&prototype.name), part))
        });
        let all: Vec<_> = self.terrain.iter().map(|t| (None, t)).chain(of_prototypes).collect();
        let complaints: Vec<Vec<String>> =
            all.par_iter().map(|(_, part)| check_surface(&part.surface)).collect();
        for ((owner, part), complaints) in all.into_iter().zip(complaints) {
            let whose = match owner {
                Some(name) => format!("prototype `{name}`, part `{}`", part.name),
                None => "the terrain".to_owned(),
            };
            for complaint in complaints {
                faults.add(|| format!("{whose}: {complaint}"));
            }
            if part.material as usize >= self.materials.len() {
                let count = self.materials.len();
                faults.add(|| {
                    format!("{whose}: material {} of {count} does not exist", part.material)
                });
            }
        }
    }

    fn check_groups(&self, faults: &mut Faults) -> Vec<SpeciesGroup> {
        let mut groups: Vec<SpeciesGroup> = Vec::new();
        let mut by_species: BTreeMap<&str, usize> = BTreeMap::new();
        let mut group_of = Vec::with_capacity(self.prototypes.len());
        for (at, prototype) in (0u32..).zip(&self.prototypes) {
            let group = *by_species.entry(&prototype.species).or_insert_with(|| {
                groups.push(SpeciesGroup {
                    name: identifier(&prototype.species),
                    species: prototype.species.clone(),
                    prototypes: Vec::new(),
                    instances: Vec::new(),
                });
                groups.len() - 1
            });
            groups[group].prototypes.push(at);
            group_of.push(group);
            if prototype.species.is_empty() {
                faults.add(|| format!("prototype `{}`: its species has no name", prototype.name));
            }
            if prototype.parts.is_empty() {
                faults.add(|| format!("prototype `{}` has no parts", prototype.name));
            }
            for level in prototype.levels.iter().filter(|l| l.parts.is_empty()) {
                let (name, level) = (&prototype.name, &level.name);
                faults.add(|| format!("prototype `{name}`, level `{level}` has no parts"));
            }
            for complaint in check_scattered(prototype) {
                faults.add(|| format!("prototype `{}`, {complaint}", prototype.name));
            }
            for collider in &prototype.colliders {
                if let Some(complaint) = check_body(&collider.body) {
                    faults.add(|| format!("prototype `{}`, collider: {complaint}", prototype.name));
                }
            }
        }
        for (at, instance) in (0u32..).zip(&self.instances) {
            if let Some(&group) = group_of.get(instance.prototype as usize) {
                groups[group].instances.push(at);
            }
        }
        faults.unique("species", groups.iter().map(|g| g.name.as_str()));
        groups
    }

    fn check_instances(&self, faults: &mut Faults) {
        if self.instances.len() > MOST_INSTANCES {
            let count = self.instances.len();
            faults.add(|| format!("{count} instances are more than {MOST_INSTANCES}"));
        }
        for instance in &self.instances {
            let mut wrong =
                |what: String| faults.add(|| format!("instance `{}`: {what}", instance.name));
            match self.prototypes.get(instance.prototype as usize) {
                None => {
                    let count = self.prototypes.len();
                    wrong(format!("prototype {} of {count} does not exist", instance.prototype));
                }
                Some(p) if p.species != instance.facts.species => wrong(format!(
                    "is a {} but shows prototype `{}`, a {}",
                    instance.facts.species, p.name, p.species
                )),
                Some(_) => {}
            }
            if !instance.position.is_finite() {
                wrong(format!("its position {} is not finite", instance.position));
            }
            if !instance.yaw_rad.is_finite() {
                wrong(format!("its yaw {} is not finite", instance.yaw_rad));
            }
            if !(instance.scale.is_finite() && instance.scale.min_element() > 0.0) {
                wrong(format!("its scale {} is not positive", instance.scale));
            }
            let facts = &instance.facts;
            let lengths = [
                ("height", facts.height_m),
                ("crown diameter", facts.crown_diameter_m),
                ("crown base height", facts.crown_base_height_m),
                ("stem diameter", facts.stem_diameter_m),
            ];
            for (what, length) in lengths {
                if !(length.is_finite() && length >= 0.0) {
                    wrong(format!("its {what} {length} is not a length"));
                }
            }
            if !(0.0..=1.0).contains(&facts.confidence) {
                wrong(format!("its confidence {} is not within 0…1", facts.confidence));
            }
        }
    }

    fn check_use(&self, faults: &mut Faults) {
        let uses = self.uses();
        let kinds = [
            ("prototype", uses.prototypes, self.prototypes.iter().map(|p| &p.name).collect()),
            ("material", uses.materials, self.materials.iter().map(|m| &m.name).collect()),
            ("texture", uses.textures, self.textures.iter().map(|t| &t.name).collect::<Vec<_>>()),
        ];
        for (kind, used, names) in kinds {
            for (name, _) in names.iter().zip(used).filter(|(_, used)| !used) {
                faults.add(|| format!("{kind} `{name}` is not used: prune the scene"));
            }
        }
    }

    fn check_standing(&self, faults: &mut Faults) {
        let Some(terrain) = &self.terrain else { return };
        let standings = standings(&terrain.surface, &self.instances);
        for (instance, standing) in self.instances.iter().zip(standings) {
            let name = &instance.name;
            match standing {
                Standing::Above(dz) if dz.abs() > f64::from(ROOT_TOLERANCE_M) => {
                    let side = if dz < 0.0 { "below" } else { "above" };
                    faults.add(|| {
                        format!(
                            "instance `{name}`: its root is {:.2} m {side} the ground",
                            dz.abs()
                        )
                    });
                }
                Standing::Beside(distance) if distance > f64::from(OFF_TERRAIN_M) => {
                    faults.add(|| {
                        format!("instance `{name}`: its root is off the terrain by more than {OFF_TERRAIN_M} m")
                    });
                }
                Standing::Above(_) | Standing::Beside(_) => {}
            }
        }
    }

    /// Indices must be in range.
    fn wraps(&self) -> Vec<Wrap> {
        let inside = -INSIDE_TOLERANCE..=1.0 + INSIDE_TOLERANCE;
        let mut wraps = vec![Wrap::Clamp; self.textures.len()];
        let of_prototypes = self.prototypes.iter().flat_map(Prototype::all_parts);
        for part in self.terrain.iter().chain(of_prototypes) {
            let uv = &part.surface.uv;
            if uv.par_iter().all(|c| inside.contains(&c.x) && inside.contains(&c.y)) {
                continue;
            }
            let material = &self.materials[part.material as usize];
            for (_, texture, _) in material.textures() {
                wraps[texture as usize] = Wrap::Repeat;
            }
        }
        wraps
    }
}

/// What is wrong with where parts stand within a prototype.
fn check_scattered(prototype: &Prototype) -> Vec<String> {
    let mut wrong = Vec::new();
    if !(prototype.scattered.is_empty() || prototype.levels.is_empty()) {
        wrong.push("level: parts at many places have no coarser forms".to_owned());
    }
    for Scattered { part, places } in &prototype.scattered {
        let name = &part.name;
        if places.is_empty() {
            wrong.push(format!("part `{name}`: it stands nowhere"));
        }
        let is_sound = |p: &Place| {
            let is_finite = p.position.is_finite() && p.scale.is_finite() && p.scale > 0.0;
            is_finite && (p.turn.length() - 1.0).abs() <= UNIT_TOLERANCE
        };
        if let Some(at) = first(places, |p| !is_sound(p)) {
            wrong.push(format!("part `{name}`, place {at}: {:?} is none", places[at]));
        }
        if !(part.surface.wind.is_empty() && part.surface.lightmap_uv.is_empty()) {
            wrong.push(format!("part `{name}`: wind and light maps differ from place to place"));
        }
    }
    wrong
}

/// What is wrong with a body of positions and triangles alone.
fn check_body(body: &Surface) -> Option<String> {
    let vertices = body.position.len();
    let is_whole = body.index.len().is_multiple_of(3) && !body.index.is_empty();
    if !is_whole || body.index.iter().any(|&i| i as usize >= vertices) {
        return Some(format!("{} indices into {vertices} vertices", body.index.len()));
    }
    if vertices > MOST_COLLIDER_VERTICES {
        return Some(format!("{vertices} vertices are more than {MOST_COLLIDER_VERTICES}"));
    }
    let is_sound = body.position.iter().all(|p| p.is_finite()) && body.volume_m3() > 0.0;
    (!is_sound).then(|| "it encloses no volume".into())
}

/// What is wrong with a surface: the first case of each kind of fault.
fn check_surface(surface: &Surface) -> Vec<String> {
    let Surface { position, normal, uv, index, wind, lightmap_uv } = surface;
    let mut wrong = Vec::new();
    let vertices = position.len();
    if !(wind.is_empty() || wind.len() == vertices) {
        wrong.push(format!("{vertices} positions and {} wind colours", wind.len()));
    }
    if !(lightmap_uv.is_empty() || lightmap_uv.len() == vertices) {
        wrong.push(format!("{vertices} positions, {} places on the light map", lightmap_uv.len()));
    }
    if let Some(at) = first(lightmap_uv, |c| !lightmap::is_on(*c)) {
        wrong.push(format!("vertex {at}: {} is off the light map", lightmap_uv[at]));
    }
    if normal.len() != vertices || uv.len() != vertices {
        wrong.push(format!(
            "{vertices} positions, {} normals and {} texture coordinates",
            normal.len(),
            uv.len()
        ));
    }
    if index.is_empty() {
        wrong.push("no triangles".into());
    }
    if !index.len().is_multiple_of(3) {
        wrong.push(format!("{} indices are not whole triangles", index.len()));
    }
    if vertices > MOST_VERTICES {
        wrong.push(format!("{vertices} vertices are more than {MOST_VERTICES}"));
    }
    if let Some(at) = first(position, |p| !p.is_finite()) {
        wrong.push(format!("vertex {at}: position {} is not finite", position[at]));
    }
    // Written so that a NaN fails.
    let is_unit = |n: &Vec3| (n.length() - 1.0).abs() <= UNIT_TOLERANCE;
    if let Some(at) = first(normal, |n| !is_unit(n)) {
        let length = normal[at].length();
        wrong.push(format!("vertex {at}: normal {} has length {length}, not 1", normal[at]));
    }
    if let Some(at) = first(uv, |c| !c.is_finite()) {
        wrong.push(format!("vertex {at}: texture coordinate {} is not finite", uv[at]));
    }
    if let Some(at) = first(index, |&i| i as usize >= vertices) {
        let (triangle, vertex) = (at / 3, index[at]);
        wrong.push(format!("triangle {triangle}: vertex {vertex} of {vertices} does not exist"));
    } else if let Some(at) = first(index.as_chunks::<3>().0, |t| is_degenerate(surface, t)) {
        wrong.push(format!("triangle {at} {:?} has no area", &index[3 * at..3 * at + 3]));
    }
    wrong
}

/// Place of the first item that is wrong. In chunks: a search item by item asks at each of them whether
/// another thread has found one.
fn first<T: Sync>(items: &[T], is_wrong: impl Fn(&T) -> bool + Sync) -> Option<usize> {
    const CHUNK: usize = 1 << 14;
    items.par_chunks(CHUNK).enumerate().find_map_first(|(chunk, items)| {
        items.iter().position(&is_wrong).map(|at| chunk * CHUNK + at)
    })
}

#[derive(Default)]
struct Faults {
    told: Vec<String>,
    untold: usize,
}

impl Faults {
    fn is_empty(&self) -> bool {
        self.told.is_empty()
    }

    fn add(&mut self, text: impl FnOnce() -> String) {
        if self.told.len() < MOST_FAULTS {
            self.told.push(text());
        } else {
            self.untold += 1;
        }
    }

    fn identifier(&mut self, what: &str, name: &str) {
        if !is_identifier(name) {
            self.add(|| {
                format!("{what}: the name `{name}` is not made of letters, digits and `_` alone")
            });
        }
    }

    fn unique<'a>(&mut self, what: &str, names: impl Iterator<Item = &'a str>) {
        let mut seen = BTreeSet::new();
        for (at, name) in names.enumerate() {
            self.identifier(&format!("{what} {at}"), name);
            if !seen.insert(name) {
                self.add(|| format!("{what} {at}: the name `{name}` is taken"));
            }
        }
    }

    fn into_result(self, scene: &str) -> Result<()> {
        if self.told.is_empty() {
            return Ok(());
        }
        let mut errors: Vec<Error> = self.told.iter().map(|text| fault(scene, text)).collect();
        if self.untold > 0 {
            errors.push(fault(scene, &format!("and {} more faults", self.untold)));
        }
        Err(Error::several(errors))
    }
}

fn fault(scene: &str, text: &str) -> Error {
    Error::new(format!("scene `{scene}` is not sound: {text}")).remedy(
        "this is a defect of the stage that built it: report it with the command that led here",
    )
}

#[cfg(test)]
mod tests;
