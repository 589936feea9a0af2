//! The objects of a glTF file as the standard and its extensions name them, each member written
//! only where it says something.

use std::borrow::Cow;

use serde::Serialize;

pub(super) const FLOAT: u32 = 5126;
pub(super) const UNSIGNED_INT: u32 = 5125;
pub(super) const UNSIGNED_SHORT: u32 = 5123;
pub(super) const SHORT: u32 = 5122;
pub(super) const UNSIGNED_BYTE: u32 = 5121;
pub(super) const BYTE: u32 = 5120;
pub(super) const ARRAY_BUFFER: u32 = 34962;
pub(super) const ELEMENT_ARRAY_BUFFER: u32 = 34963;
pub(super) const LINEAR: u32 = 9729;
pub(super) const LINEAR_MIPMAP_LINEAR: u32 = 9987;
pub(super) const CLAMP_TO_EDGE: u32 = 33071;
pub(super) const REPEAT: u32 = 10497;

#[derive(Serialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Document<'a> {
    pub asset: Asset<'a>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub extensions_used: Vec<&'static str>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub extensions_required: Vec<&'static str>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub extensions: Option<super::variants::Extensions<'a>>,
    pub scene: u32,
    pub scenes: [SceneNodes<'a>; 1],
    pub nodes: Vec<Node<'a>>,
    pub meshes: Vec<Mesh<'a>>,
    pub materials: Vec<Material<'a>>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub textures: Vec<Texture<'a>>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub samplers: Vec<Sampler>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub images: Vec<Image<'a>>,
    pub accessors: Vec<Accessor>,
    pub buffer_views: Vec<View>,
    pub buffers: Vec<Buffer>,
}

#[derive(Serialize)]
pub(super) struct Asset<'a> {
    pub version: &'static str,
    pub generator: &'static str,
    pub extras: Place<'a>,
}

/// How to put the scene back on the map.
#[derive(Serialize)]
pub(super) struct Place<'a> {
    #[serde(skip_serializing_if = "Option::is_none")]
    pub epsg: Option<u32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub wkt: Option<&'a str>,
    pub origin: [f64; 3],
    pub unit_m: [f64; 3],
    pub note: &'static str,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub square: Option<SquareExtras>,
}

/// The ground whose trees are here, where a scene is split; metres east and north of the origin.
#[derive(Serialize)]
pub(super) struct SquareExtras {
    pub column: i32,
    pub row: i32,
    pub side_m: f32,
    pub south_west_m: [f32; 2],
}

#[derive(Serialize)]
pub(super) struct SceneNodes<'a> {
    pub name: &'a str,
    pub nodes: [u32; 1],
}

#[derive(Serialize, Default)]
pub(super) struct Node<'a> {
    pub name: Cow<'a, str>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub mesh: Option<u32>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub children: Vec<u32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub translation: Option<[f32; 3]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rotation: Option<[f32; 4]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub scale: Option<[f32; 3]>,
    #[serde(skip_serializing_if = "NodeExtensions::is_empty")]
    pub extensions: NodeExtensions,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub extras: Option<NodeExtras<'a>>,
}

#[derive(Serialize, Default)]
pub(super) struct NodeExtensions {
    #[serde(rename = "EXT_mesh_gpu_instancing", skip_serializing_if = "Option::is_none")]
    pub instancing: Option<Instancing>,
    #[serde(rename = "MSFT_lod", skip_serializing_if = "Option::is_none")]
    pub lod: Option<Lod>,
}

impl NodeExtensions {
    fn is_empty(&self) -> bool {
        self.instancing.is_none() && self.lod.is_none()
    }
}

#[derive(Serialize, Clone, Copy)]
pub(super) struct Instancing {
    pub attributes: InstanceAttributes,
}

#[derive(Serialize, Clone, Copy)]
#[serde(rename_all = "UPPERCASE")]
pub(super) struct InstanceAttributes {
    pub translation: u32,
    pub rotation: u32,
    pub scale: u32,
}

impl From<u32> for InstanceAttributes {
    /// Of three accessors from this one on.
    fn from(first: u32) -> Self {
        InstanceAttributes { translation: first, rotation: first + 1, scale: first + 2 }
    }
}

/// Nodes of coarser forms, from fine to coarse.
#[derive(Serialize)]
pub(super) struct Lod {
    pub ids: Vec<u32>,
}

#[derive(Serialize)]
#[serde(untagged)]
pub(super) enum NodeExtras<'a> {
    Tree(TreeExtras<'a>),
    Trees(TreesExtras<'a>),
}

/// [`crate::scene::TreeFacts`] by their own names.
#[derive(Serialize)]
pub(super) struct TreeExtras<'a> {
    pub id: &'a str,
    pub species: &'a str,
    pub height_m: f32,
    pub crown_diameter_m: f32,
    pub crown_base_height_m: f32,
    pub stem_diameter_m: f32,
    pub condition: &'a str,
    pub confidence: f32,
}

/// The same for instances of a node, a column each, in their order.
#[derive(Serialize)]
pub(super) struct TreesExtras<'a> {
    #[serde(rename = "MSFT_screencoverage", skip_serializing_if = "Vec::is_empty")]
    pub screen_coverage: Vec<f32>,
    pub species: &'a str,
    pub trees: TreeColumns<'a>,
}

#[derive(Serialize)]
pub(super) struct TreeColumns<'a> {
    pub id: Vec<&'a str>,
    pub height_m: Vec<f32>,
    pub crown_diameter_m: Vec<f32>,
    pub crown_base_height_m: Vec<f32>,
    pub stem_diameter_m: Vec<f32>,
    pub condition: Vec<&'a str>,
    pub confidence: Vec<f32>,
}

#[derive(Serialize)]
pub(super) struct Mesh<'a> {
    pub name: Cow<'a, str>,
    pub primitives: Vec<Primitive>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub extras: Option<MeshExtras>,
}

/// How far a coarser form is from the finest.
#[derive(Serialize)]
pub(super) struct MeshExtras {
    pub silhouette_worst_m: f32,
    pub silhouette_rms_m: f32,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub octahedral: Option<OctahedralExtras>,
}

/// [`crate::scene::Octahedral`] by its own names, Y up.
#[derive(Serialize)]
pub(super) struct OctahedralExtras {
    pub frames: u32,
    pub centre: [f32; 3],
    pub radius_m: f32,
    pub note: &'static str,
}

#[derive(Serialize)]
pub(super) struct Primitive {
    pub attributes: Attributes,
    pub indices: u32,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub material: Option<u32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub extensions: Option<super::variants::PrimitiveExtensions>,
}

#[derive(Serialize, Default, Clone, Copy)]
#[serde(rename_all = "UPPERCASE")]
pub(super) struct Attributes {
    pub position: u32,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub normal: Option<u32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub texcoord_0: Option<u32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub texcoord_1: Option<u32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tangent: Option<u32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub color_0: Option<u32>,
    #[serde(rename = "_WIND", skip_serializing_if = "Option::is_none")]
    pub wind: Option<u32>,
}

#[derive(Serialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Material<'a> {
    pub name: Cow<'a, str>,
    pub pbr_metallic_roughness: MetallicRoughness,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub normal_texture: Option<TextureRef>,
    /// Red of the texture that holds the roughness, too.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub occlusion_texture: Option<TextureRef>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub alpha_mode: Option<&'static str>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub alpha_cutoff: Option<f32>,
    #[serde(skip_serializing_if = "is_false")]
    pub double_sided: bool,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub extensions: Option<MaterialExtensions>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub extras: Option<MaterialExtras>,
}

#[derive(Serialize)]
pub(super) struct MaterialExtras {
    /// glTF has no word for it.
    pub height: Height,
}

/// A picture beside the file; from 0 to 1 it rises by so much.
#[derive(Serialize)]
pub(super) struct Height {
    pub uri: String,
    pub depth_m: f32,
}

#[derive(Serialize)]
pub(super) struct MaterialExtensions {
    #[serde(
        rename = "KHR_materials_diffuse_transmission",
        skip_serializing_if = "Option::is_none"
    )]
    pub transmission: Option<DiffuseTransmission>,
    #[serde(rename = "KHR_materials_specular", skip_serializing_if = "Option::is_none")]
    pub specular: Option<Specular>,
}

#[derive(Serialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Specular {
    pub specular_factor: f32,
}

/// Light that comes through, in the colour of the surface.
#[derive(Serialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct DiffuseTransmission {
    pub diffuse_transmission_factor: f32,
    pub diffuse_transmission_color_factor: [f32; 3],
    #[serde(skip_serializing_if = "Option::is_none")]
    pub diffuse_transmission_color_texture: Option<TextureRef>,
}

#[derive(Serialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct MetallicRoughness {
    #[serde(skip_serializing_if = "is_white")]
    pub base_color_factor: [f32; 4],
    #[serde(skip_serializing_if = "Option::is_none")]
    pub base_color_texture: Option<TextureRef>,
    pub metallic_factor: f32,
    pub roughness_factor: f32,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub metallic_roughness_texture: Option<TextureRef>,
}

#[derive(Serialize, Clone, Copy)]
pub(super) struct TextureRef {
    pub index: u32,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub extensions: Option<TextureRefExtensions>,
}

#[derive(Serialize, Clone, Copy)]
pub(super) struct TextureRefExtensions {
    #[serde(rename = "KHR_texture_transform")]
    pub transform: TextureTransform,
}

#[derive(Serialize, Clone, Copy)]
pub(super) struct TextureTransform {
    pub offset: [f32; 2],
    pub scale: [f32; 2],
}

#[derive(Serialize)]
pub(super) struct Texture<'a> {
    pub name: &'a str,
    pub sampler: u32,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub source: Option<u32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub extensions: Option<TextureExtensions>,
}

#[derive(Serialize)]
pub(super) struct TextureExtensions {
    #[serde(rename = "EXT_texture_webp")]
    pub webp: Source,
}

#[derive(Serialize)]
pub(super) struct Source {
    pub source: u32,
}

#[derive(Serialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Sampler {
    pub mag_filter: u32,
    pub min_filter: u32,
    pub wrap_s: u32,
    pub wrap_t: u32,
}

#[derive(Serialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Image<'a> {
    pub name: &'a str,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub uri: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub mime_type: Option<&'static str>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub buffer_view: Option<u32>,
}

#[derive(Serialize, Clone)]
#[serde(rename_all = "camelCase")]
pub(super) struct Accessor {
    pub buffer_view: u32,
    #[serde(skip_serializing_if = "is_zero")]
    pub byte_offset: u64,
    pub component_type: u32,
    pub count: usize,
    pub r#type: &'static str,
    #[serde(skip_serializing_if = "is_false")]
    pub normalized: bool,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub min: Option<Bound>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max: Option<Bound>,
}

/// As the accessor's components are: whole numbers without a point.
#[derive(Serialize, Clone, Copy)]
#[serde(untagged)]
pub(super) enum Bound {
    Float([f32; 3]),
    Short([i16; 3]),
}

#[derive(Serialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct View {
    pub buffer: u32,
    #[serde(skip_serializing_if = "is_zero")]
    pub byte_offset: u64,
    pub byte_length: u64,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub byte_stride: Option<u64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub target: Option<u32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub extensions: Option<ViewExtensions>,
}

#[derive(Serialize)]
pub(super) struct ViewExtensions {
    #[serde(rename = "EXT_meshopt_compression")]
    pub meshopt: Compressed,
}

#[derive(Serialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Compressed {
    pub buffer: u32,
    #[serde(skip_serializing_if = "is_zero")]
    pub byte_offset: u64,
    pub byte_length: u64,
    pub byte_stride: u64,
    pub count: usize,
    pub mode: &'static str,
}

#[derive(Serialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Buffer {
    pub byte_length: u64,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub uri: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub extensions: Option<BufferExtensions>,
}

#[derive(Serialize)]
pub(super) struct BufferExtensions {
    #[serde(rename = "EXT_meshopt_compression")]
    pub meshopt: Fallback,
}

/// A buffer that holds nothing and stands for what its views are once decoded.
#[derive(Serialize)]
pub(super) struct Fallback {
    pub fallback: bool,
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
