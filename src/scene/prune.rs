//! Leaves out what a scene does not need, and says how much that was.

use std::fmt;

use rayon::prelude::*;

use super::{Material, Part, Prototype, Scene, Texture};
use crate::mesh::Surface;

/// How many things [`Scene::prune`] left out.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct LeftOut {
    /// Triangles without area.
    pub triangles: usize,
    /// Vertices of no triangle.
    pub vertices: usize,
    /// Parts without triangles.
    pub parts: usize,
    /// Prototypes without instances.
    pub prototypes: usize,
    pub materials: usize,
    pub textures: usize,
    /// Of those textures, four a pixel.
    pub texture_bytes: u64,
}

impl LeftOut {
    pub fn is_empty(&self) -> bool {
        *self == LeftOut::default()
    }
}

impl fmt::Display for LeftOut {
    /// `2 triangles, 1 texture`; `nothing` if empty.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let counts = [
            (self.triangles, "triangle", "triangles"),
            (self.vertices, "vertex", "vertices"),
            (self.parts, "part", "parts"),
            (self.prototypes, "prototype", "prototypes"),
            (self.materials, "material", "materials"),
            (self.textures, "texture", "textures"),
        ];
        let said: Vec<String> = counts
            .iter()
            .filter(|(count, ..)| *count > 0)
            .map(|(count, one, more)| format!("{count} {}", if *count == 1 { one } else { more }))
            .collect();
        f.write_str(if said.is_empty() { "nothing".into() } else { said.join(", ") }.as_str())
    }
}

/// Whether three corners span no area: exactly (f64 products of f32 edges lose nothing that
/// matters), or in the f32 arithmetic that readers use.
pub(super) fn is_degenerate(surface: &Surface, triangle: &[u32]) -> bool {
    let &[a, b, c] = triangle else { return true };
    if a == b || b == c || c == a {
        return true;
    }
    let corner = |i: u32| surface.position.get(i as usize).copied();
    let (Some(a), Some(b), Some(c)) = (corner(a), corner(b), corner(c)) else { return false };
    let exact = (b.as_dvec3() - a.as_dvec3()).cross(c.as_dvec3() - a.as_dvec3());
    exact.length_squared() == 0.0 || (b - a).cross(c - a) == glam::Vec3::ZERO
}

impl Scene {
    /// Drops triangles without area, vertices of no triangle, parts without triangles, prototypes without
    /// instances, and materials and textures that nothing refers to. The order of the rest stays.
    pub fn prune(&mut self) -> LeftOut {
        let mut left_out = LeftOut::default();

        let all_parts = self.prototypes.iter_mut().flat_map(Prototype::all_parts_mut);
        for part in all_parts.chain(&mut self.terrain) {
            left_out.triangles += drop_degenerate(&mut part.surface);
            left_out.vertices += drop_unused(&mut part.surface);
        }
        let has_triangles = |part: &Part| !part.surface.is_empty();
        for prototype in &mut self.prototypes {
            let forms = prototype.levels.iter_mut().map(|l| &mut l.parts);
            for parts in forms.chain([&mut prototype.parts]) {
                let before = parts.len();
                parts.retain(has_triangles);
                left_out.parts += before - parts.len();
            }
        }
        for prototype in &mut self.prototypes {
            let before = prototype.scattered.len();
            prototype.scattered.retain(|s| has_triangles(&s.part) && !s.places.is_empty());
            left_out.parts += before - prototype.scattered.len();
        }
        if self.terrain.as_ref().is_some_and(|t| !has_triangles(t)) {
            self.terrain = None;
            left_out.parts += 1;
        }

        let used = self.uses().prototypes;
        let moved = keep(&mut self.prototypes, &used, &mut left_out.prototypes);
        for instance in &mut self.instances {
            moved.follow(&mut instance.prototype);
        }
        let used = self.uses().materials;
        let moved = keep(&mut self.materials, &used, &mut left_out.materials);
        let parts = self.prototypes.iter_mut().flat_map(Prototype::all_parts_mut);
        let parts = parts.chain(&mut self.terrain);
        for part in parts {
            moved.follow(&mut part.material);
        }
        let used = self.uses().textures;
        let unused = self.textures.iter().zip(&used).filter(|(_, used)| !**used);
        let bytes = |t: &Texture| 4 * u64::from(t.image.width()) * u64::from(t.image.height());
        left_out.texture_bytes = unused.map(|(t, _)| bytes(t)).sum();
        let moved = keep(&mut self.textures, &used, &mut left_out.textures);
        for material in &mut self.materials {
            material.textures_mut().for_each(|texture| moved.follow(texture));
        }
        left_out
    }

    /// Whether something refers to each thing. Indices out of range are for `validate` to tell.
    pub(super) fn uses(&self) -> Uses {
        let parts = self.prototypes.iter().flat_map(Prototype::all_parts).chain(&self.terrain);
        let slots =
            self.materials.iter().flat_map(Material::textures).map(|(_, texture, _)| texture);
        Uses {
            prototypes: flags(self.prototypes.len(), self.instances.iter().map(|i| i.prototype)),
            materials: flags(self.materials.len(), parts.map(|p| p.material)),
            textures: flags(self.textures.len(), slots),
        }
    }
}

/// One flag a prototype, a material, a texture.
pub(super) struct Uses {
    pub prototypes: Vec<bool>,
    pub materials: Vec<bool>,
    pub textures: Vec<bool>,
}

fn flags(count: usize, used: impl Iterator<Item = u32>) -> Vec<bool> {
    let mut flags = vec![false; count];
    for index in used {
        if let Some(flag) = flags.get_mut(index as usize) {
            *flag = true;
        }
    }
    flags
}

fn drop_degenerate(surface: &mut Surface) -> usize {
    // Hardly any surface has one.
    let triangles = surface.index.par_chunks_exact(3);
    if !triangles.into_par_iter().any(|t| is_degenerate(surface, t)) {
        return 0;
    }
    let whole = surface.index.len() / 3 * 3;
    let mut kept = 0;
    for from in (0..whole).step_by(3) {
        if !is_degenerate(surface, &surface.index[from..from + 3]) {
            surface.index.copy_within(from..from + 3, kept);
            kept += 3;
        }
    }
    // A ragged end is a fault that `validate` must see.
    let ragged = surface.index.len() - whole;
    surface.index.copy_within(whole.., kept);
    surface.index.truncate(kept + ragged);
    (whole - kept) / 3
}

/// A branch's foot takes the place of corners of its parent's facets; such a parent has vertices too many.
fn drop_unused(surface: &mut Surface) -> usize {
    let count = surface.position.len();
    let mut used = vec![false; count];
    for &i in &surface.index {
        match used.get_mut(i as usize) {
            Some(used) => *used = true,
            // A fault that `validate` must see.
            None => return 0,
        }
    }
    let mut dropped = 0;
    if surface.index.is_empty() || used.iter().all(|used| *used) {
        return 0;
    }
    let Surface { position, normal, uv, index, wind, lightmap_uv } = surface;
    let moved = keep(position, &used, &mut dropped);
    let rest = &mut 0;
    keep(normal, &used, rest);
    keep(uv, &used, rest);
    keep(wind, &used, rest);
    keep(lightmap_uv, &used, rest);
    index.iter_mut().for_each(|i| moved.follow(i));
    dropped
}

/// New index of each old one.
struct Moved(Vec<u32>);

impl Moved {
    /// An index out of range stays so, for `validate` to see.
    fn follow(&self, index: &mut u32) {
        *index = self.0.get(*index as usize).copied().unwrap_or(u32::MAX);
    }
}

fn keep<T>(items: &mut Vec<T>, used: &[bool], dropped: &mut usize) -> Moved {
    let mut next = 0;
    let moved = used.iter().map(|&used| {
        let index = next;
        next += u32::from(used);
        index
    });
    let moved = Moved(moved.collect());
    let before = items.len();
    let mut flags = used.iter();
    items.retain(|_| flags.next().copied().unwrap_or(true));
    *dropped += before - items.len();
    moved
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::sample::forest;

    #[test]
    fn what_nothing_uses_goes_and_the_rest_still_refers_right() {
        let mut scene = forest(&["Larix", "Betula", "Pinus"], 4, 20.0);
        // No birches: their two models, two materials and four textures go with them.
        scene.instances.retain(|i| i.facts.species != "Betula");
        let wood = &mut scene.prototypes[0].parts[0].surface;
        let triangles = wood.triangles();
        wood.index.extend([3, 3, 4]);
        let (corners, lost) = (wood.position.clone(), wood.position.len() / 2);
        wood.position.insert(lost, corners[0]);
        wood.normal.insert(lost, wood.normal[0]);
        wood.uv.insert(lost, wood.uv[0]);
        wood.index.iter_mut().filter(|i| **i >= lost as u32).for_each(|i| *i += 1);
        let empty = Part { surface: Surface::default(), ..scene.prototypes[4].parts[0].clone() };
        scene.prototypes[4].parts.insert(0, Part { name: "roots".into(), ..empty });

        let names = |scene: &Scene| -> Vec<(String, String, String)> {
            let model = |i: &crate::scene::Instance| &scene.prototypes[i.prototype as usize];
            let leaf = |i: &crate::scene::Instance| {
                let part = model(i).parts.last().unwrap();
                &scene.materials[part.material as usize]
            };
            let texture = |i: &crate::scene::Instance| {
                let index = leaf(i).base_color_texture.unwrap() as usize;
                scene.textures[index].name.clone()
            };
            let all = scene.instances.iter();
            all.map(|i| (model(i).name.clone(), leaf(i).name.clone(), texture(i))).collect()
        };
        let before = names(&scene);
        let left_out = scene.prune();
        let expected = LeftOut {
            triangles: 1,
            vertices: 1,
            parts: 1,
            prototypes: 2,
            materials: 2,
            textures: 4,
            texture_bytes: 4 * 4 * 32 * 32,
        };
        assert_eq!(left_out, expected);
        assert_eq!(
            left_out.to_string(),
            "1 triangle, 1 vertex, 1 part, 2 prototypes, 2 materials, 4 textures"
        );
        assert_eq!(names(&scene), before);
        let wood = &scene.prototypes[0].parts[0].surface;
        assert_eq!((wood.triangles(), &wood.position), (triangles, &corners));
        assert_eq!(scene.prune().to_string(), "nothing");
        scene.validate().unwrap();
    }

    #[test]
    fn a_wrong_index_stays_for_validate_to_tell() {
        let mut scene = forest(&["Larix"], 2, 20.0);
        scene.instances[1].prototype = 9;
        scene.prototypes[0].parts[0].material = 99;
        scene.prune();
        let error = format!("{:?}", scene.validate().unwrap_err());
        assert!(error.contains("does not exist"), "{error}");
    }
}
