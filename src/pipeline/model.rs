//! Models of a scene out of a tree's mesh and the pictures of its species: parts and their materials.

use crate::frame::Frame;
use crate::mesh::{TreeMesh, Twigs};
use crate::raster::{Image, Picture, linear_from_srgb};
use crate::scene::{
    Alpha, Colorspace, Material, Part, Prototype, Relief, Scattered, Scene, Texture, Variant,
    identifier,
};
use crate::species::{Species, own};
use crate::texture::{BarkTextures, TreeTextures};

/// Share of the light that leaves let through: about half of what they do not absorb (Jacquemoud &
/// Baret 1990, PROSPECT, over the visible).
const LEAF_TRANSLUCENCY: f32 = 0.3;
/// Normals of leaves are the crown's, and many lie across the view: as much as other surfaces do they
/// would mirror the sky, white.
const LEAF_SPECULAR: f32 = 0.3;

/// Indices of a species' materials.
#[derive(Debug, Clone, Copy)]
pub struct Look {
    bark: u32,
    upper_bark: u32,
    transition_bark: u32,
    twig_bark: u32,
    leaf: u32,
    /// Of hulls: one colour.
    crown: u32,
    /// The leaf's where there is none.
    fruit: u32,
}

pub(super) fn add_materials(scene: &mut Scene, species: &Species, textures: TreeTextures) -> Look {
    let stem = identifier(&species.name);
    let bark = add_bark(scene, &format!("{stem}_bark"), textures.bark);
    let upper_bark =
        textures.bark_upper.map_or(bark, |t| add_bark(scene, &format!("{stem}_bark_upper"), t));
    let transition_bark = textures
        .bark_transition
        .map_or(upper_bark, |t| add_bark(scene, &format!("{stem}_bark_transition"), t));
    let twig_bark =
        textures.bark_twig.map_or(upper_bark, |t| add_bark(scene, &format!("{stem}_bark_twig"), t));
    let name = own_name(&stem, "leaf", species.own_model.as_deref());
    let is_plain = (textures.leaf.width(), textures.leaf.height()) == (1, 1);
    let crown_variants = textures.leaf_variants.iter().map(|v| Variant {
        name: v.name.to_owned(),
        base_color: v.crown.map(linear_from_srgb),
        base_color_texture: None,
    });
    let crown_variants = crown_variants.collect();
    let (base_color, leaf) = colour(scene, &name, textures.leaf);
    let is_cut = species.own_model.as_ref().is_none_or(|model| model.picture.is_cut());
    let is_masked = is_cut && leaf.is_some();
    let alpha = if is_masked { Alpha::Mask { cutoff: 0.5 } } else { Alpha::Opaque };
    let normals = textures.leaf_normal;
    let normal_texture =
        normals.map(|i| add_texture(scene, &format!("{name}_normal"), i, Colorspace::Raw));
    let variants = textures.leaf_variants.into_iter().map(|v| {
        let (base_color, base_color_texture) = colour(scene, &format!("{name}_{}", v.name), v.leaf);
        Variant { name: v.name.to_owned(), base_color, base_color_texture }
    });
    let variants = variants.collect();
    let leaf = Material {
        base_color_texture: leaf,
        normal_texture,
        variants,
        roughness: species.own_model.as_ref().and_then(|own| own.roughness).unwrap_or(0.65),
        specular: LEAF_SPECULAR,
        translucency: if species.foliage.is_bare() { 0.0 } else { LEAF_TRANSLUCENCY },
        alpha,
        double_sided: true,
        ..Material::plain(name, base_color)
    };
    let crown = Material {
        name: format!("{stem}_crown"),
        base_color: textures.crown.map(linear_from_srgb),
        base_color_texture: None,
        normal_texture: None,
        variants: crown_variants,
        alpha: Alpha::Opaque,
        double_sided: false,
        ..leaf.clone()
    };
    scene.materials.push(leaf);
    let leaf = scene.materials.len() as u32 - 1;
    scene.materials.push(crown);
    let crown = scene.materials.len() as u32 - 1;
    let own = species.own_fruit.as_deref();
    let fruit = own.map_or(leaf, |model| {
        add_fruit(scene, &own_name(&stem, "fruit", Some(model)), model, is_plain)
    });
    Look { bark, upper_bark, transition_bark, twig_bark, leaf, crown, fruit }
}

/// What leaves or fruits are called in a scene; a user's own by their material, too.
fn own_name(stem: &str, what: &str, model: Option<&own::Model>) -> String {
    match model.and_then(|model| model.material.as_deref()).map(identifier) {
        Some(own) if own != what => format!("{stem}_{what}_{own}"),
        _ => format!("{stem}_{what}"),
    }
}

/// The material of a user's own cones; `is_plain`: in their mean colour.
fn add_fruit(scene: &mut Scene, name: &str, model: &own::Model, is_plain: bool) -> u32 {
    let picture = &model.picture;
    let is_cut = picture.is_cut();
    let picture = match is_plain {
        true => Picture::filled(1, 1, picture.mean_colour()),
        false => picture.clone(),
    };
    let (base_color, base_color_texture) = colour(scene, name, picture.into());
    let is_masked = is_cut && base_color_texture.is_some();
    let normals = model.normals.clone().filter(|_| !is_plain);
    let normal_texture =
        normals.map(|p| add_texture(scene, &format!("{name}_normal"), p.into(), Colorspace::Raw));
    scene.materials.push(Material {
        base_color_texture,
        normal_texture,
        roughness: model.roughness.unwrap_or(0.75),
        alpha: if is_masked { Alpha::Mask { cutoff: 0.5 } } else { Alpha::Opaque },
        double_sided: is_masked,
        ..Material::plain(name, base_color)
    });
    scene.materials.len() as u32 - 1
}

/// The same look, with leaves in a colour of their own; `number`: of the model.
pub(super) fn tinted(scene: &mut Scene, look: Look, tint: [f32; 3], number: u32) -> Look {
    if tint == [1.0; 3] {
        return look;
    }
    let mut of = |material: u32| {
        let Some(own) = scene.materials.get(material as usize).cloned() else { return material };
        let name = format!("{}_{number:02}", own.name);
        let base_color = std::array::from_fn(|k| own.base_color[k] * tint[k]);
        scene.materials.push(Material { name, base_color, ..own });
        scene.materials.len() as u32 - 1
    };
    Look { leaf: of(look.leaf), crown: of(look.crown), ..look }
}

fn add_texture(scene: &mut Scene, name: &str, image: Image, colorspace: Colorspace) -> u32 {
    scene.textures.push(Texture { name: name.to_owned(), image, colorspace });
    scene.textures.len() as u32 - 1
}

/// A picture of one pixel is a colour, and needs no texture.
fn colour(scene: &mut Scene, name: &str, image: Image) -> ([f32; 3], Option<u32>) {
    if (image.width(), image.height()) != (1, 1) {
        return ([1.0; 3], Some(add_texture(scene, name, image, Colorspace::Srgb)));
    }
    let [r, g, b, _] = image.picture().at(0, 0);
    ([r, g, b].map(linear_from_srgb), None)
}

fn add_bark(scene: &mut Scene, name: &str, bark: BarkTextures) -> u32 {
    let (base_color, colour) = colour(scene, name, bark.colour);
    let mut relief = |image: Option<Image>, kind: &str| {
        image.map(|i| add_texture(scene, &format!("{name}_{kind}"), i, Colorspace::Raw))
    };
    let (normal_texture, orm_texture) = (relief(bark.normal, "normal"), relief(bark.orm, "orm"));
    scene.materials.push(Material {
        base_color_texture: colour,
        normal_texture,
        orm_texture,
        relief: bark.height.map(|image| Relief { image, depth_m: bark.depth_m }),
        roughness: if orm_texture.is_some() { 1.0 } else { 0.9 },
        ..Material::plain(name, base_color)
    });
    scene.materials.len() as u32 - 1
}

/// The parts of a tree; those without triangles are left out when the scene is pruned.
pub(super) fn prototype(
    name: String,
    species: &Species,
    mut mesh: TreeMesh,
    look: Look,
) -> Prototype {
    let twigs = (1..).zip(std::mem::take(&mut mesh.twigs));
    let scattered = twigs.map(|(k, Twigs { form, places })| {
        let part = Part { name: format!("twig_{k:02}"), surface: form, material: look.leaf };
        Scattered { part, places }
    });
    let scattered = scattered.collect();
    Prototype {
        name,
        species: species.name.clone(),
        parts: parts_of(mesh, look),
        scattered,
        levels: Vec::new(),
        colliders: Vec::new(),
        silhouette: None,
        octahedral: None,
    }
}

/// Models of one species with its textures, none of them in a place.
pub fn model_scene(species: &Species, meshes: Vec<TreeMesh>, textures: TreeTextures) -> Scene {
    let name = identifier(&species.name);
    let (mut scene, look) = empty_scene(species, textures);
    for (k, mesh) in meshes.into_iter().enumerate() {
        scene.prototypes.push(prototype(format!("{name}_{:02}", k + 1), species, mesh, look));
    }
    scene
}

/// Without models, and what these are to look like.
pub(super) fn empty_scene(species: &Species, textures: TreeTextures) -> (Scene, Look) {
    let name = identifier(&species.name);
    let mut scene = Scene::empty(name, Frame::local(glam::DVec3::ZERO));
    let look = add_materials(&mut scene, species, textures);
    (scene, look)
}

/// The part that is leaves, or what stands for them and for twigs.
pub(super) const FOLIAGE: &str = "foliage";

pub(super) fn parts_of(mut mesh: TreeMesh, look: Look) -> Vec<Part> {
    // Beside leaves that have their picture, of one part with them.
    let mut dry = std::mem::take(&mut mesh.dry);
    if !mesh.is_hull {
        mesh.foliage.append(std::mem::take(&mut dry));
    }
    let part = |name: &str, surface, material| Part { name: name.into(), surface, material };
    let mut parts = vec![
        part("wood", mesh.wood, look.bark),
        part("upper_wood", mesh.upper_wood, look.upper_bark),
        part("transition_wood", mesh.transition_wood, look.transition_bark),
        part("twig_wood", mesh.twig_wood, look.twig_bark),
    ];
    // Without pictures all bark is the same.
    parts.dedup_by(|more, first| {
        let is_same = more.material == first.material;
        if is_same {
            first.surface.append(std::mem::take(&mut more.surface));
        }
        is_same
    });
    let leaves = if mesh.is_hull { look.crown } else { look.leaf };
    parts.extend([
        part(FOLIAGE, mesh.foliage, leaves),
        part("dry_twigs", dry, look.leaf),
        part("fruit", mesh.fruit, look.fruit),
    ]);
    parts
}
