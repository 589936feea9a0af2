//! Leaves out what a scene does not need, and says how much that was.

use std::fmt;

use super::{Part, Scene};
use crate::mesh::Surface;

/// How many things [`Scene::prune`] left out.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct LeftOut {
    /// Triangles without area.
    pub triangles: usize,
    /// Parts without triangles.
    pub parts: usize,
    /// Prototypes without instances.
    pub prototypes: usize,
    pub materials: usize,
    pub textures: usize,
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
            (self.triangles, "triangle"),
            (self.parts, "part"),
            (self.prototypes, "prototype"),
            (self.materials, "material"),
            (self.textures, "texture"),
        ];
        let said: Vec<String> = counts
            .iter()
            .filter(|(count, _)| *count > 0)
            .map(|(count, what)| format!("{count} {what}{}", if *count == 1 { "" } else { "s" }))
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
    /// Drops triangles without area, parts without triangles, prototypes without instances,
    /// and materials and textures that nothing refers to. The order of the rest stays.
    pub fn prune(&mut self) -> LeftOut {
        let mut left_out = LeftOut::default();

        let all_parts = self.prototypes.iter_mut().flat_map(|p| &mut p.parts);
        for part in all_parts.chain(&mut self.terrain) {
            left_out.triangles += drop_degenerate(&mut part.surface);
        }
        let has_triangles = |part: &Part| !part.surface.is_empty();
        for prototype in &mut self.prototypes {
            let before = prototype.parts.len();
            prototype.parts.retain(has_triangles);
            left_out.parts += before - prototype.parts.len();
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
        let parts = self.prototypes.iter_mut().flat_map(|p| &mut p.parts).chain(&mut self.terrain);
        for part in parts {
            moved.follow(&mut part.material);
        }
        let used = self.uses().textures;
        let moved = keep(&mut self.textures, &used, &mut left_out.textures);
        for material in &mut self.materials {
            let slots = [&mut material.base_color_texture, &mut material.normal_texture];
            for texture in slots.into_iter().flatten() {
                moved.follow(texture);
            }
        }
        left_out
    }

    /// Whether something refers to each thing. Indices out of range are for `validate` to tell.
    pub(super) fn uses(&self) -> Uses {
        let parts = self.prototypes.iter().flat_map(|p| &p.parts).chain(&self.terrain);
        let slots = self.materials.iter().flat_map(|m| [m.base_color_texture, m.normal_texture]);
        Uses {
            prototypes: flags(self.prototypes.len(), self.instances.iter().map(|i| i.prototype)),
            materials: flags(self.materials.len(), parts.map(|p| p.material)),
            textures: flags(self.textures.len(), slots.flatten()),
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
