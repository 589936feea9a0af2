//! The JSON of a glTF file: structures that mirror the standard's objects, each written only
//! where it says something.

use std::borrow::Cow;
use std::ops::Range;

use glam::Vec3;
use serde::Serialize;

use super::super::GENERATOR;
use super::super::pictures::texture_path;
use super::buffer::{
    Layout, NORMAL_BYTES, POSITION_BYTES, TANGENT_BYTES, UV_BYTES, WIND_BYTES, has_short_indices,
    has_tangents, has_wind,
};
use super::variants::{self, Extensions, PrimitiveExtensions};
use super::y_up;
use crate::frame::Frame;
use crate::mesh::Surface;
use crate::scene::{self, Alpha, Instance, ValidScene, Wrap};

const FLOAT: u32 = 5126;
const UNSIGNED_INT: u32 = 5125;
const UNSIGNED_SHORT: u32 = 5123;
const UNSIGNED_BYTE: u32 = 5121;
const ARRAY_BUFFER: u32 = 34962;
const ELEMENT_ARRAY_BUFFER: u32 = 34963;
const LINEAR: u32 = 9729;
const LINEAR_MIPMAP_LINEAR: u32 = 9987;
const CLAMP_TO_EDGE: u32 = 33071;
const REPEAT: u32 = 10497;

#[derive(Serialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Document<'a> {
    asset: Asset<'a>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    extensions_used: Vec<&'static str>,
    #[serde(skip_serializing_if = "Option::is_none")]
    extensions: Option<Extensions<'a>>,
    scene: u32,
    scenes: [SceneNodes<'a>; 1],
    nodes: Vec<Node<'a>>,
    meshes: Vec<Mesh<'a>>,
    materials: Vec<Material<'a>>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    textures: Vec<Texture<'a>>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    samplers: Vec<Sampler>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    images: Vec<Image<'a>>,
    accessors: Vec<Accessor>,
    buffer_views: Vec<View>,
    buffers: [Buffer; 1],
}

#[derive(Serialize)]
struct Asset<'a> {
    version: &'static str,
    generator: &'static str,
    extras: Place<'a>,
}

/// How to put the scene back on the map.
#[derive(Serialize)]
struct Place<'a> {
    #[serde(skip_serializing_if = "Option::is_none")]
    epsg: Option<u32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    wkt: Option<&'a str>,
    origin: [f64; 3],
    unit_m: [f64; 3],
    note: &'static str,
}

#[derive(Serialize)]
struct SceneNodes<'a> {
    name: &'a str,
    nodes: [u32; 1],
}

#[derive(Serialize, Default)]
struct Node<'a> {
    name: Cow<'a, str>,
    #[serde(skip_serializing_if = "Option::is_none")]
    mesh: Option<u32>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    children: Vec<u32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    translation: Option<[f32; 3]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    rotation: Option<[f32; 4]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    scale: Option<[f32; 3]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    extras: Option<TreeExtras<'a>>,
}

/// [`scene::TreeFacts`] by their own names.
#[derive(Serialize)]
struct TreeExtras<'a> {
    id: &'a str,
    species: &'a str,
    height_m: f32,
    crown_diameter_m: f32,
    crown_base_height_m: f32,
    stem_diameter_m: f32,
    confidence: f32,
}

#[derive(Serialize)]
struct Mesh<'a> {
    name: Cow<'a, str>,
    primitives: Vec<Primitive>,
    #[serde(skip_serializing_if = "Option::is_none")]
    extras: Option<MeshExtras>,
}

/// [`scene::Octahedral`] by its own names, Y up.
#[derive(Serialize)]
struct MeshExtras {
    octahedral: OctahedralExtras,
}

#[derive(Serialize)]
struct OctahedralExtras {
    frames: u32,
    centre: [f32; 3],
    radius_m: f32,
    note: &'static str,
}

#[derive(Serialize)]
struct Primitive {
    attributes: Attributes,
    indices: u32,
    #[serde(skip_serializing_if = "Option::is_none")]
    material: Option<u32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    extensions: Option<PrimitiveExtensions>,
}

#[derive(Serialize)]
#[serde(rename_all = "UPPERCASE")]
struct Attributes {
    position: u32,
    #[serde(skip_serializing_if = "Option::is_none")]
    normal: Option<u32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    texcoord_0: Option<u32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    tangent: Option<u32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    color_0: Option<u32>,
}

#[derive(Serialize)]
#[serde(rename_all = "camelCase")]
struct Material<'a> {
    name: Cow<'a, str>,
    pbr_metallic_roughness: MetallicRoughness,
    #[serde(skip_serializing_if = "Option::is_none")]
    normal_texture: Option<TextureRef>,
    /// Red of the texture that holds the roughness, too.
    #[serde(skip_serializing_if = "Option::is_none")]
    occlusion_texture: Option<TextureRef>,
    #[serde(skip_serializing_if = "Option::is_none")]
    alpha_mode: Option<&'static str>,
    #[serde(skip_serializing_if = "Option::is_none")]
    alpha_cutoff: Option<f32>,
    #[serde(skip_serializing_if = "is_false")]
    double_sided: bool,
}

#[derive(Serialize)]
#[serde(rename_all = "camelCase")]
struct MetallicRoughness {
    #[serde(skip_serializing_if = "is_white")]
    base_color_factor: [f32; 4],
    #[serde(skip_serializing_if = "Option::is_none")]
    base_color_texture: Option<TextureRef>,
    metallic_factor: f32,
    roughness_factor: f32,
    #[serde(skip_serializing_if = "Option::is_none")]
    metallic_roughness_texture: Option<TextureRef>,
}

#[derive(Serialize)]
struct TextureRef {
    index: u32,
}

#[derive(Serialize)]
struct Texture<'a> {
    name: &'a str,
    sampler: u32,
    source: u32,
}

#[derive(Serialize)]
#[serde(rename_all = "camelCase")]
struct Sampler {
    mag_filter: u32,
    min_filter: u32,
    wrap_s: u32,
    wrap_t: u32,
}

#[derive(Serialize)]
#[serde(rename_all = "camelCase")]
struct Image<'a> {
    name: &'a str,
    #[serde(skip_serializing_if = "Option::is_none")]
    uri: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    mime_type: Option<&'static str>,
    #[serde(skip_serializing_if = "Option::is_none")]
    buffer_view: Option<u32>,
}

#[derive(Serialize)]
#[serde(rename_all = "camelCase")]
struct Accessor {
    buffer_view: u32,
    #[serde(skip_serializing_if = "is_zero")]
    byte_offset: u64,
    component_type: u32,
    count: usize,
    r#type: &'static str,
    #[serde(skip_serializing_if = "is_false")]
    normalized: bool,
    #[serde(skip_serializing_if = "Option::is_none")]
    min: Option<[f32; 3]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    max: Option<[f32; 3]>,
}

#[derive(Serialize)]
#[serde(rename_all = "camelCase")]
struct View {
    buffer: u32,
    #[serde(skip_serializing_if = "is_zero")]
    byte_offset: u64,
    byte_length: u64,
    #[serde(skip_serializing_if = "Option::is_none")]
    byte_stride: Option<u64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    target: Option<u32>,
}

#[derive(Serialize)]
#[serde(rename_all = "camelCase")]
struct Buffer {
    byte_length: u64,
    #[serde(skip_serializing_if = "Option::is_none")]
    uri: Option<String>,
}

fn is_false(value: &bool) -> bool {
    !value
}

fn is_white(colour: &[f32; 4]) -> bool {
    *colour == [1.0; 4]
}

fn is_zero(value: &u64) -> bool {
    *value == 0
}

/// For a GLB: buffer and pictures in the file itself.
pub(super) fn embedded<'a>(scene: &'a ValidScene, layout: &Layout) -> Document<'a> {
    let (views, first_picture) = views(layout);
    let images = (first_picture..).zip(scene.textures()).map(|(view, texture)| Image {
        name: &texture.name,
        uri: None,
        mime_type: Some("image/png"),
        buffer_view: Some(view),
    });
    document(scene, layout, views, images.collect(), None)
}

/// For a .gltf: buffer and pictures in files beside it.
pub(super) fn beside<'a>(scene: &'a ValidScene, layout: &Layout, stem: &str) -> Document<'a> {
    let images = scene.textures().iter().map(|texture| Image {
        name: &texture.name,
        uri: Some(percent_encoded(&texture_path(stem, &texture.name))),
        mime_type: None,
        buffer_view: None,
    });
    let uri = percent_encoded(&format!("{stem}.bin"));
    document(scene, layout, views(layout).0, images.collect(), Some(uri))
}

fn document<'a>(
    scene: &'a ValidScene,
    layout: &Layout,
    buffer_views: Vec<View>,
    images: Vec<Image<'a>>,
    uri: Option<String>,
) -> Document<'a> {
    let (textures, samplers) = textures(scene);
    let extensions = variants::of_document(scene);
    Document {
        extensions_used: extensions.iter().map(|_| variants::EXTENSION).collect(),
        extensions,
        asset: Asset { version: "2.0", generator: GENERATOR, extras: place(scene.frame()) },
        scene: 0,
        scenes: [SceneNodes { name: scene.name(), nodes: [0] }],
        nodes: nodes(scene),
        meshes: meshes(scene),
        materials: materials(scene),
        textures,
        samplers,
        images,
        accessors: accessors(scene, layout),
        buffer_views,
        buffers: [Buffer { byte_length: layout.bytes(), uri }],
    }
}

fn place(frame: &Frame) -> Place<'_> {
    Place {
        epsg: frame.crs.as_ref().and_then(|crs| crs.epsg),
        wkt: frame.crs.as_ref().and_then(|crs| crs.wkt.as_deref()),
        origin: frame.origin.to_array(),
        unit_m: frame.unit_m().to_array(),
        note: "east = origin[0] + x / unit_m[0], north = origin[1] - z / unit_m[1], \
               up = origin[2] + y / unit_m[2]",
    }
}

/// The root, the terrain, then each species with its trees.
fn nodes(scene: &ValidScene) -> Vec<Node<'_>> {
    let mut nodes = vec![Node { name: scene.name().into(), ..Node::default() }];
    let mut push = |node| {
        nodes.push(node);
        nodes.len() as u32 - 1
    };
    let mut of_root = Vec::new();
    if let Some(terrain) = scene.terrain() {
        of_root.push(push(Node {
            name: terrain.name.as_str().into(),
            mesh: Some(0),
            ..Node::default()
        }));
    }
    let first_mesh = u32::from(scene.terrain().is_some());
    // Colliders follow the prototypes' meshes.
    let mut next_collider = first_mesh + scene.prototypes().len() as u32;
    let mut first_collider = Vec::with_capacity(scene.prototypes().len());
    for prototype in scene.prototypes() {
        first_collider.push(next_collider);
        next_collider += prototype.colliders.len() as u32;
    }
    for group in scene.groups() {
        let mut children = Vec::with_capacity(group.instances.len());
        for &i in &group.instances {
            let tree = &scene.instances()[i as usize];
            let first = first_collider[tree.prototype as usize];
            let bodies = &scene.prototypes()[tree.prototype as usize].colliders;
            let colliders = bodies.iter().enumerate().map(|(k, body)| {
                push(Node {
                    name: body.name(&tree.name, k).into(),
                    mesh: Some(first + k as u32),
                    ..Node::default()
                })
            });
            let colliders = colliders.collect();
            children.push(push(tree_node(tree, first_mesh, colliders)));
        }
        let name = group.name.as_str().into();
        of_root.push(push(Node { name, children, ..Node::default() }));
    }
    nodes[0].children = of_root;
    nodes
}

fn tree_node(tree: &Instance, first_mesh: u32, colliders: Vec<u32>) -> Node<'_> {
    let (sin, cos) = (tree.yaw_rad * 0.5).sin_cos();
    let facts = &tree.facts;
    Node {
        name: tree.name.as_str().into(),
        mesh: Some(first_mesh + tree.prototype),
        children: colliders,
        translation: Some(y_up(tree.position)),
        rotation: (sin != 0.0).then_some([0.0, sin, 0.0, cos]),
        scale: (tree.scale != Vec3::ONE).then_some([tree.scale.x, tree.scale.z, tree.scale.y]),
        extras: Some(TreeExtras {
            id: &facts.id,
            species: &facts.species,
            height_m: facts.height_m,
            crown_diameter_m: facts.crown_diameter_m,
            crown_base_height_m: facts.crown_base_height_m,
            stem_diameter_m: facts.stem_diameter_m,
            confidence: facts.confidence,
        }),
    }
}

/// The terrain if there is one, then one a prototype, then one a collider; a primitive a part, with
/// the accessors of [`accessors`].
fn meshes(scene: &ValidScene) -> Vec<Mesh<'_>> {
    let names = variants::names(scene);
    let mut next = 0u32..;
    let mut take = |is_there: bool| is_there.then(|| next.next().unwrap_or(0));
    let mut primitive = |part: &scene::Part| Primitive {
        attributes: Attributes {
            position: take(true).unwrap_or(0),
            normal: take(true),
            texcoord_0: take(true),
            tangent: take(has_tangents(scene, part)),
            color_0: take(has_wind(&part.surface)),
        },
        indices: take(true).unwrap_or(0),
        material: Some(part.material),
        extensions: variants::of_primitive(scene, part.material, &names),
    };
    let mut meshes = Vec::with_capacity(scene.prototypes().len() + 1);
    if let Some(terrain) = scene.terrain() {
        let name = terrain.name.as_str().into();
        meshes.push(Mesh { name, primitives: vec![primitive(terrain)], extras: None });
    }
    for prototype in scene.prototypes() {
        let primitives = prototype.parts.iter().map(&mut primitive).collect();
        let extras = prototype.octahedral.map(|o| MeshExtras {
            octahedral: OctahedralExtras {
                frames: o.frames,
                centre: y_up(o.centre),
                radius_m: o.radius_m,
                note: "towards the eye d, y up: p = d.xz / (|d.x| + |d.y| + |d.z|), \
                       e = (p.x - p.z, p.x + p.z); the view is in column, row (from below) \
                       (frames - 1) (e + 1) / 2",
            },
        });
        meshes.push(Mesh { name: prototype.name.as_str().into(), primitives, extras });
    }
    for prototype in scene.prototypes() {
        for (k, collider) in prototype.colliders.iter().enumerate() {
            let attributes = Attributes {
                position: take(true).unwrap_or(0),
                normal: None,
                texcoord_0: None,
                tangent: None,
                color_0: None,
            };
            let indices = take(true).unwrap_or(0);
            meshes.push(Mesh {
                name: collider.name(&prototype.name, k).into(),
                primitives: vec![Primitive {
                    attributes,
                    indices,
                    material: None,
                    extensions: None,
                }],
                extras: None,
            });
        }
    }
    meshes
}

/// What has been given out of one buffer view.
struct Column {
    view: u32,
    component_type: u32,
    r#type: &'static str,
    /// Bytes of one element.
    size: u64,
    given: u64,
}

impl Column {
    fn give(&mut self, count: usize) -> Accessor {
        let byte_offset = self.given;
        self.given += count as u64 * self.size;
        Accessor {
            buffer_view: self.view,
            byte_offset,
            component_type: self.component_type,
            count,
            r#type: self.r#type,
            min: None,
            max: None,
            normalized: false,
        }
    }
}

/// Of each part in [`ValidScene::parts`]: position, normal, texture coordinate, tangent where
/// the material needs it, wind where there is one, index; then of each collider position, index.
fn accessors(scene: &ValidScene, layout: &Layout) -> Vec<Accessor> {
    let mut views = 0u32..;
    let mut column = |range: &Range<u64>, component_type, r#type, size| Column {
        // An empty range has no view and gives nothing.
        view: if range.is_empty() { 0 } else { views.next().unwrap_or(0) },
        component_type,
        r#type,
        size,
        given: 0,
    };
    let mut positions = column(&layout.positions, FLOAT, "VEC3", POSITION_BYTES);
    let mut normals = column(&layout.normals, FLOAT, "VEC3", NORMAL_BYTES);
    let mut uvs = column(&layout.uvs, FLOAT, "VEC2", UV_BYTES);
    let mut tangents = column(&layout.tangents, FLOAT, "VEC4", TANGENT_BYTES);
    let mut winds = column(&layout.winds, UNSIGNED_BYTE, "VEC4", WIND_BYTES);
    let mut long_indices = column(&layout.long_indices, UNSIGNED_INT, "SCALAR", 4);
    let mut short_indices = column(&layout.short_indices, UNSIGNED_SHORT, "SCALAR", 2);

    let mut accessors = Vec::new();
    for part in scene.parts() {
        let surface = &part.surface;
        let vertices = surface.position.len();
        accessors.push(bounded(positions.give(vertices), surface));
        accessors.push(normals.give(vertices));
        accessors.push(uvs.give(vertices));
        if has_tangents(scene, part) {
            accessors.push(tangents.give(vertices));
        }
        if has_wind(surface) {
            accessors.push(Accessor { normalized: true, ..winds.give(vertices) });
        }
        let short = has_short_indices(surface);
        let indices = if short { &mut short_indices } else { &mut long_indices };
        accessors.push(indices.give(surface.index.len()));
    }
    for collider in scene.colliders() {
        let body = &collider.body;
        accessors.push(bounded(positions.give(body.position.len()), body));
        accessors.push(short_indices.give(body.index.len()));
    }
    accessors
}

fn bounded(positions: Accessor, surface: &Surface) -> Accessor {
    let (lo, hi) = surface.bounds();
    let (a, b) = (Vec3::from(y_up(lo)), Vec3::from(y_up(hi)));
    Accessor { min: Some(a.min(b).to_array()), max: Some(a.max(b).to_array()), ..positions }
}

/// The views in the order that [`accessors`] counts on, and the number of the first picture's.
fn views(layout: &Layout) -> (Vec<View>, u32) {
    let view = |range: &Range<u64>, byte_stride, target| View {
        buffer: 0,
        byte_offset: range.start,
        byte_length: range.end - range.start,
        byte_stride,
        target,
    };
    let columns = [
        (&layout.positions, Some(POSITION_BYTES), ARRAY_BUFFER),
        (&layout.normals, Some(NORMAL_BYTES), ARRAY_BUFFER),
        (&layout.uvs, Some(UV_BYTES), ARRAY_BUFFER),
        (&layout.tangents, Some(TANGENT_BYTES), ARRAY_BUFFER),
        (&layout.winds, Some(WIND_BYTES), ARRAY_BUFFER),
        (&layout.long_indices, None, ELEMENT_ARRAY_BUFFER),
        (&layout.short_indices, None, ELEMENT_ARRAY_BUFFER),
    ];
    let columns = columns.into_iter().filter(|(range, ..)| !range.is_empty());
    let mut views: Vec<View> =
        columns.map(|(range, stride, target)| view(range, stride, Some(target))).collect();
    let first_picture = views.len() as u32;
    views.extend(layout.pictures.iter().map(|range| view(range, None, None)));
    (views, first_picture)
}

/// The scene's, then their variants in the same order.
fn materials(scene: &ValidScene) -> Vec<Material<'_>> {
    let own = scene.materials().iter().map(material);
    let others = scene.materials().iter().flat_map(|m| {
        m.variants.iter().map(move |v| {
            let [r, g, b] = v.base_color;
            let mut other = material(m);
            other.name = format!("{}_{}", m.name, v.name).into();
            other.pbr_metallic_roughness.base_color_factor = [r, g, b, 1.0];
            other.pbr_metallic_roughness.base_color_texture =
                v.base_color_texture.map(|index| TextureRef { index });
            other
        })
    });
    own.chain(others).collect()
}

fn material(material: &scene::Material) -> Material<'_> {
    let [r, g, b] = material.base_color;
    let texture = |index: Option<u32>| index.map(|index| TextureRef { index });
    let (alpha_mode, alpha_cutoff) = match material.alpha {
        Alpha::Opaque => (None, None),
        Alpha::Mask { cutoff } => (Some("MASK"), Some(cutoff)),
    };
    Material {
        name: Cow::Borrowed(&material.name),
        pbr_metallic_roughness: MetallicRoughness {
            base_color_factor: [r, g, b, 1.0],
            base_color_texture: texture(material.base_color_texture),
            metallic_factor: 0.0,
            roughness_factor: material.roughness,
            metallic_roughness_texture: texture(material.orm_texture),
        },
        normal_texture: texture(material.normal_texture),
        occlusion_texture: texture(material.orm_texture),
        alpha_mode,
        alpha_cutoff,
        double_sided: material.double_sided,
    }
}

/// Textures as the scene numbers them, and a sampler for each way of wrapping that occurs.
fn textures(scene: &ValidScene) -> (Vec<Texture<'_>>, Vec<Sampler>) {
    let mut wraps: Vec<Wrap> = Vec::new();
    let textures = (0u32..).zip(scene.textures()).map(|(source, texture)| {
        let wrap = scene.wrap(source);
        let sampler = wraps.iter().position(|&w| w == wrap).unwrap_or_else(|| {
            wraps.push(wrap);
            wraps.len() - 1
        });
        Texture { name: &texture.name, sampler: sampler as u32, source }
    });
    let textures = textures.collect();
    let samplers = wraps.iter().map(|wrap| {
        let mode = match wrap {
            Wrap::Repeat => REPEAT,
            Wrap::Clamp => CLAMP_TO_EDGE,
        };
        Sampler { mag_filter: LINEAR, min_filter: LINEAR_MIPMAP_LINEAR, wrap_s: mode, wrap_t: mode }
    });
    (textures, samplers.collect())
}

/// A relative path as a URI (RFC 3986): everything but unreserved characters and `/` encoded.
fn percent_encoded(path: &str) -> String {
    let mut uri = String::with_capacity(path.len());
    for byte in path.bytes() {
        if byte.is_ascii_alphanumeric() || b"-._~/".contains(&byte) {
            uri.push(char::from(byte));
        } else {
            uri.push_str(&format!("%{byte:02X}"));
        }
    }
    uri
}

#[cfg(test)]
mod tests {
    use super::percent_encoded;

    #[test]
    fn uris_hold_no_reserved_character() {
        assert_eq!(percent_encoded("a b#1.bin"), "a%20b%231.bin");
        assert_eq!(percent_encoded("лес/x.png"), "%D0%BB%D0%B5%D1%81/x.png");
    }
}
