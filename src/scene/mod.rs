//! Prototypes, instances and terrain as one scene, and the proof that it is sound. Knows nothing
//! of formats.
//!
//! A [`Scene`] is built freely, relieved of what it does not use by [`Scene::prune`], and turned
//! by [`Scene::validate`] into a [`ValidScene`], the only thing that writers accept.

mod level;
mod name;
mod prune;
#[cfg(test)]
pub(crate) mod sample;
mod selection;
pub mod sharing;
mod standing;
mod statistics;
pub mod turn;
mod valid;

pub use level::{
    Apart, Collider, ColliderShape, Level, Octahedral, PICTURE_ASPECT, PICTURE_LINES, plain_rms_m,
};
pub use name::{identifier, is_identifier};
pub use prune::LeftOut;
pub use selection::{Form, Forms, Group, Model, Selection, Tree};
pub use standing::{OFF_TERRAIN_M, ROOT_TOLERANCE_M};
pub use statistics::{Statistics, statistics};
pub use valid::{SpeciesGroup, ValidScene, Wrap};

use glam::{Vec2, Vec3};

use crate::frame::Frame;
use crate::mesh::{Place, Surface};
use crate::raster::Image;

/// How a material's alpha is used.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Alpha {
    Opaque,
    /// Drawn where alpha >= cutoff.
    Mask {
        cutoff: f32,
    },
}

/// What the numbers of a texture are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Colorspace {
    Srgb,
    /// Normal maps and the like.
    Raw,
}

#[derive(Debug, Clone)]
pub struct Texture {
    /// File stem: unique, letters, digits and `_` only.
    pub name: String,
    pub image: Image,
    pub colorspace: Colorspace,
}

/// A metallic-roughness material; metallic is 0 for everything in a forest.
#[derive(Debug, Clone)]
pub struct Material {
    /// Unique identifier, e.g. `Larix_sibirica_bark`.
    pub name: String,
    /// Linear RGB, multiplies the texture.
    pub base_color: [f32; 3],
    /// Index into [`Scene::textures`].
    pub base_color_texture: Option<u32>,
    pub normal_texture: Option<u32>,
    /// Occlusion in red, roughness in green, metalness in blue.
    pub orm_texture: Option<u32>,
    /// Heights of what the normals bend, for those who displace; nothing draws it by itself.
    pub relief: Option<Relief>,
    /// Multiplies the texture.
    pub roughness: f32,
    /// What it mirrors over what common dielectrics do (4 %, seen straight on), 0…1.
    pub specular: f32,
    /// Share of the light that comes through, diffusely, 0…1.
    pub translucency: f32,
    pub alpha: Alpha,
    pub double_sided: bool,
    /// Its other colours; no two of one name.
    pub variants: Vec<Variant>,
}

/// A picture of heights, laid as the material's textures are.
#[derive(Debug, Clone)]
pub struct Relief {
    /// Grey, from the deepest place (0) to the highest (255).
    pub image: Image,
    /// How far those are apart, metres.
    pub depth_m: f32,
}

/// What writers call the look that is none of a scene's variants.
pub const OWN_LOOK: &str = "own";

/// Another colour of a material, by a name that materials share, e.g. `autumn`.
#[derive(Debug, Clone)]
pub struct Variant {
    /// Identifier; not [`OWN_LOOK`].
    pub name: String,
    /// As in the [`Material`].
    pub base_color: [f32; 3],
    pub base_color_texture: Option<u32>,
}

/// A surface with its material (index into [`Scene::materials`]).
#[derive(Debug, Clone)]
pub struct Part {
    /// `wood`, `foliage`, `terrain`.
    pub name: String,
    pub surface: Surface,
    pub material: u32,
}

/// A part of a model that stands at many places of it.
#[derive(Debug, Clone)]
pub struct Scattered {
    pub part: Part,
    /// Never empty.
    pub places: Vec<Place>,
}

/// A model that instances share; root collar at the origin.
#[derive(Debug, Clone)]
pub struct Prototype {
    /// Unique identifier, e.g. `Larix_sibirica_03`.
    pub name: String,
    /// Display name of the species, e.g. `Larix sibirica`.
    pub species: String,
    /// Its finest form.
    pub parts: Vec<Part>,
    /// What the finest form has beside, each stored once; only of models without coarser forms.
    pub scattered: Vec<Scattered>,
    /// Coarser forms, from fine to coarse.
    pub levels: Vec<Level>,
    pub colliders: Vec<Collider>,
    /// How far its finest form is from one that the scene has done without.
    pub silhouette: Option<Apart>,
    /// Where the parts show views of an octahedral impostor.
    pub octahedral: Option<Octahedral>,
}

impl Prototype {
    /// The parts of all its forms.
    pub fn all_parts(&self) -> impl Iterator<Item = &Part> {
        let scattered = self.scattered.iter().map(|s| &s.part);
        self.parts.iter().chain(scattered).chain(self.levels.iter().flat_map(|l| &l.parts))
    }

    /// Vertices of what is scattered: all that can bound it, however it is turned about Z.
    pub fn outer_scattered(&self) -> Vec<Vec3> {
        let forms: Vec<_> =
            self.scattered.iter().map(|s| (&s.part.surface, &s.places[..])).collect();
        crate::mesh::outer(&forms)
    }

    /// Least and greatest corner of the finest form; zero for none.
    pub fn bounds(&self) -> (Vec3, Vec3) {
        let scattered = self.outer_scattered().into_iter().map(|p| (p, p));
        let parts = self.parts.iter().map(|p| p.surface.bounds());
        let all = parts.chain(scattered);
        all.reduce(|a, b| (a.0.min(b.0), a.1.max(b.1))).unwrap_or_default()
    }

    /// Triangles of the finest form: as they are stored, and as they are seen.
    pub fn triangles(&self) -> [u64; 2] {
        let of = |part: &Part| part.surface.triangles() as u64;
        let once: u64 = self.parts.iter().map(of).sum();
        let scattered = |times: fn(&Scattered) -> u64| -> u64 {
            self.scattered.iter().map(|s| times(s) * of(&s.part)).sum()
        };
        [once + scattered(|_| 1), once + scattered(|s| s.places.len() as u64)]
    }

    fn all_parts_mut(&mut self) -> impl Iterator<Item = &mut Part> {
        let scattered = self.scattered.iter_mut().map(|s| &mut s.part);
        self.parts
            .iter_mut()
            .chain(scattered)
            .chain(self.levels.iter_mut().flat_map(|l| &mut l.parts))
    }
}

/// What is known of one tree; travels to the files as extras.
#[derive(Debug, Clone, PartialEq)]
pub struct TreeFacts {
    /// Stable id, unique in the scene.
    pub id: String,
    pub species: String,
    pub height_m: f32,
    pub crown_diameter_m: f32,
    pub crown_base_height_m: f32,
    pub stem_diameter_m: f32,
    /// Sanitary category, `I` healthy … `VI` old dead.
    pub condition: &'static str,
    pub confidence: f32,
}

impl TreeFacts {
    /// To millimetres and thousandths: no scan tells more, and files are shorter.
    pub fn rounded(self) -> Self {
        let thousandths = |v: f32| ((f64::from(v) * 1e3).round() * 1e-3) as f32;
        TreeFacts {
            height_m: thousandths(self.height_m),
            crown_diameter_m: thousandths(self.crown_diameter_m),
            crown_base_height_m: thousandths(self.crown_base_height_m),
            stem_diameter_m: thousandths(self.stem_diameter_m),
            confidence: thousandths(self.confidence),
            ..self
        }
    }
}

/// One tree in its place: scale, then turn about Z, then move.
#[derive(Debug, Clone)]
pub struct Instance {
    /// Unique identifier, e.g. `Larix_sibirica_0421`.
    pub name: String,
    /// Index into [`Scene::prototypes`].
    pub prototype: u32,
    /// Root, scene metres.
    pub position: Vec3,
    pub yaw_rad: f32,
    pub scale: Vec3,
    pub facts: TreeFacts,
}

impl Material {
    /// One colour, opaque and rough.
    pub fn plain(name: impl Into<String>, base_color: [f32; 3]) -> Material {
        Material {
            name: name.into(),
            base_color,
            base_color_texture: None,
            normal_texture: None,
            orm_texture: None,
            relief: None,
            roughness: 1.0,
            specular: 1.0,
            translucency: 0.0,
            alpha: Alpha::Opaque,
            double_sided: false,
            variants: Vec::new(),
        }
    }

    /// The textures that it shows, each with what it is for.
    pub fn textures(&self) -> impl Iterator<Item = (&'static str, u32, Colorspace)> {
        let own = [
            ("base colour", self.base_color_texture, Colorspace::Srgb),
            ("normal", self.normal_texture, Colorspace::Raw),
            ("occlusion and roughness", self.orm_texture, Colorspace::Raw),
        ];
        let variants = self.variants.iter().map(|v| v.base_color_texture);
        own.into_iter()
            .chain(variants.map(|texture| ("variant's base colour", texture, Colorspace::Srgb)))
            .filter_map(|(slot, texture, colorspace)| Some((slot, texture?, colorspace)))
    }

    /// Its picture of heights, by the name that files give it.
    pub fn relief(&self) -> Option<(String, &Relief)> {
        self.relief.as_ref().map(|relief| (format!("{}_height", self.name), relief))
    }

    /// Whether surfaces of it need texture coordinates.
    pub fn has_textures(&self) -> bool {
        self.textures().next().is_some()
    }

    pub(super) fn textures_mut(&mut self) -> impl Iterator<Item = &mut u32> {
        [&mut self.base_color_texture, &mut self.normal_texture, &mut self.orm_texture]
            .into_iter()
            .chain(self.variants.iter_mut().map(|v| &mut v.base_color_texture))
            .flatten()
    }
}

impl Instance {
    /// Scene metres of a point of the prototype.
    pub fn place(&self, p: Vec3) -> Vec3 {
        let p = self.scale * p;
        let turned = Vec2::from_angle(self.yaw_rad).rotate(Vec2::new(p.x, p.y));
        self.position + turned.extend(p.z)
    }
}

/// Everything a writer needs; scene metres (local to `frame`), Z up.
#[derive(Debug, Clone)]
pub struct Scene {
    /// Identifier, e.g. `forest`.
    pub name: String,
    pub frame: Frame,
    pub textures: Vec<Texture>,
    pub materials: Vec<Material>,
    pub terrain: Option<Part>,
    pub prototypes: Vec<Prototype>,
    pub instances: Vec<Instance>,
}

impl Scene {
    /// A scene that holds nothing yet.
    pub fn empty(name: String, frame: Frame) -> Scene {
        Scene {
            name,
            frame,
            textures: Vec::new(),
            materials: Vec::new(),
            terrain: None,
            prototypes: Vec::new(),
            instances: Vec::new(),
        }
    }
}
