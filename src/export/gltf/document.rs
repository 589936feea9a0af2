//! From what a file shows to the JSON of glTF and the plan of its buffer.

use std::borrow::Cow;

use bytes::Bytes;
use glam::Vec3;

use super::super::GENERATOR;
use super::super::pictures::{PictureFormat, Pictures, texture_path};
use super::buffer::{Body, Layout, Piece, PieceAccessors, Plan};
use super::cells::{Cell, cells, screen_coverage};
use super::json::*;
use super::quantize::{Grid, UvRange};
use super::{Profile, Recipe, Square, WindAs, variants, y_up};
use crate::diagnostic::{Error, Result};
use crate::frame::Frame;
use crate::mesh::Surface;
use crate::scene::{self, Alpha, Apart, Form, Model, Part, Selection, TreeFacts, Wrap};

/// Terrain keeps its 32-bit positions where 16 bits would move it farther than this, metres.
pub(super) const MOST_TERRAIN_ERROR_M: f32 = 0.001;

/// Where buffer and pictures are.
#[derive(Debug, Clone, Copy)]
pub(super) enum Beside<'a> {
    /// In the file itself.
    Nothing,
    /// In files beside it: the buffer by this name, pictures by that stem.
    Files { buffer: &'a str, stem: &'a str },
}

/// A file's description, and its buffer of so many bytes.
pub(super) struct Built<'a> {
    pub json: Vec<u8>,
    pub body: Body<'a>,
    pub bytes: u64,
}

/// # Errors
/// Those of compression.
pub(super) fn build<'a>(
    selection: &Selection<'a>,
    pictures: &Pictures,
    recipe: &Recipe<'_>,
    square: Option<Square>,
    beside: Beside<'_>,
) -> Result<Built<'a>> {
    let profile = recipe.profile;
    let mut builder = Builder::new(selection, recipe);
    builder.terrain(square.and_then(|s| s.terrain_grid));
    builder.models();
    builder.groups();
    let Builder { plan, nodes, meshes, uv_ranges, .. } = builder;
    let coding = profile.picture_format();
    let inside: Vec<Bytes> = match beside {
        Beside::Nothing => selection.textures.iter().map(|&t| pictures.of(t, coding)).collect(),
        Beside::Files { .. } => Vec::new(),
    };
    let layout =
        if profile.is_compressed() { plan.compressed(inside)? } else { plan.layout(inside) };
    let Layout { views, accessors, first_picture, bytes, decoded_bytes, body } = layout;
    let mut buffers = vec![Buffer {
        byte_length: bytes,
        uri: match beside {
            Beside::Nothing => None,
            Beside::Files { buffer, .. } => Some(percent_encoded(buffer)),
        },
        extensions: None,
    }];
    if decoded_bytes > 0 {
        let extensions = Some(BufferExtensions { meshopt: Fallback { fallback: true } });
        buffers.push(Buffer { byte_length: decoded_bytes, uri: None, extensions });
    }
    let (textures, samplers) = textures(selection, coding);
    let extensions = variants::of_document(selection);
    let mut required = Vec::new();
    let mut used = Vec::new();
    let mut uses = |name, is_used: bool, is_required: bool| {
        used.extend(is_used.then_some(name));
        required.extend((is_used && is_required).then_some(name));
    };
    let has_instances = nodes.iter().any(|n| n.extensions.instancing.is_some());
    uses("EXT_mesh_gpu_instancing", has_instances, true);
    uses("EXT_meshopt_compression", decoded_bytes > 0, true);
    uses("EXT_texture_webp", textures.iter().any(|t| t.extensions.is_some()), true);
    let is_translucent = selection.materials.iter().any(|m| m.translucency > 0.0);
    uses("KHR_materials_diffuse_transmission", is_translucent, false);
    uses("KHR_materials_specular", selection.materials.iter().any(|m| m.specular < 1.0), false);
    uses(variants::EXTENSION, extensions.is_some(), false);
    uses("KHR_mesh_quantization", profile.is_quantized(), true);
    let mut ranges = selection.materials.iter().zip(&uv_ranges);
    let is_spread = |(m, &range): (&&scene::Material, &UvRange)| {
        range != UvRange::PICTURE && m.textures().next().is_some()
    };
    uses("KHR_texture_transform", ranges.any(is_spread), true);
    uses("MSFT_lod", nodes.iter().any(|n| n.extensions.lod.is_some()), false);
    let document = Document {
        asset: Asset {
            version: "2.0",
            generator: GENERATOR,
            extras: place(selection.scene().frame(), square),
        },
        extensions_used: used,
        extensions_required: required,
        extensions,
        scene: 0,
        scenes: [SceneNodes { name: selection.scene().name(), nodes: [0] }],
        nodes,
        meshes,
        materials: materials(selection, &uv_ranges, recipe.stem),
        textures,
        samplers,
        images: images(
            selection,
            selection.textures.iter().map(|&t| pictures.format_of(t, coding)),
            beside,
            first_picture,
        ),
        accessors,
        buffer_views: views,
        buffers,
    };
    let json = match beside {
        Beside::Nothing => serde_json::to_vec(&document),
        Beside::Files { .. } => serde_json::to_vec_pretty(&document),
    };
    let json =
        json.map_err(|e| Error::new(format!("the glTF description could not be written: {e}")))?;
    Ok(Built { json, body, bytes })
}

fn place(frame: &Frame, square: Option<Square>) -> Place<'_> {
    Place {
        epsg: frame.crs.as_ref().and_then(|crs| crs.epsg),
        wkt: frame.crs.as_ref().and_then(|crs| crs.wkt.as_deref()),
        origin: frame.origin.to_array(),
        unit_m: frame.unit_m().to_array(),
        note: "east = origin[0] + x / unit_m[0], north = origin[1] - z / unit_m[1], \
               up = origin[2] + y / unit_m[2]",
        square: square.map(|s| SquareExtras {
            column: s.at[0],
            row: s.at[1],
            side_m: s.side_m,
            south_west_m: s.corner,
        }),
    }
}

/// Nodes and meshes in the making: the root, the terrain, then each species with its trees.
struct Builder<'a, 's> {
    selection: &'s Selection<'a>,
    profile: Profile,
    wind: WindAs,
    plan: Plan<'a>,
    nodes: Vec<Node<'a>>,
    meshes: Vec<Mesh<'a>>,
    /// One a material.
    uv_ranges: Vec<UvRange>,
    /// One a model: its meshes, and how their positions are counted.
    models: Vec<Shared>,
    variant_names: Vec<&'a str>,
}

/// The meshes of a model.
struct Shared {
    /// A mesh a form.
    forms: Vec<u32>,
    /// A mesh a scattered part.
    scattered: Vec<u32>,
    colliders: Vec<u32>,
    grid: Option<Grid>,
}

impl<'a, 's> Builder<'a, 's> {
    fn new(selection: &'s Selection<'a>, recipe: &Recipe<'_>) -> Self {
        let Recipe { profile, wind, .. } = *recipe;
        let range = |material: u32| {
            UvRange::of(selection.parts().filter(move |p| selection.material(p) == material))
        };
        let count = selection.materials.len() as u32;
        let uv_ranges = (0..count).map(|m| match profile.is_quantized() {
            true => range(m),
            false => UvRange::PICTURE,
        });
        // Importers number what has one name.
        let scene = selection.scene().name();
        let name = match selection.groups.iter().any(|group| group.name == scene) {
            true => level_of(selection, &format!("{scene}_root")).into_owned().into(),
            false => level_of(selection, scene),
        };
        let root = Node { name, ..Node::default() };
        Builder {
            selection,
            profile,
            wind,
            plan: Plan::default(),
            nodes: vec![root],
            meshes: Vec::new(),
            uv_ranges: uv_ranges.collect(),
            models: Vec::new(),
            variant_names: variants::names(selection),
        }
    }

    fn node(&mut self, node: Node<'a>) -> u32 {
        self.nodes.push(node);
        self.nodes.len() as u32 - 1
    }

    fn mesh(
        &mut self,
        name: Cow<'a, str>,
        primitives: Vec<Primitive>,
        extras: Option<MeshExtras>,
    ) -> u32 {
        self.meshes.push(Mesh { name, primitives, extras });
        self.meshes.len() as u32 - 1
    }

    /// `grid`: of the whole terrain, where this is a part of it.
    fn terrain(&mut self, grid: Option<Grid>) {
        let Some(terrain) = self.selection.terrain else { return };
        let grid = grid.unwrap_or_else(|| Grid::around([&terrain.surface].into_iter()));
        let is_counted =
            self.profile.has_counted_positions() && grid.error_m() <= MOST_TERRAIN_ERROR_M;
        let grid = is_counted.then_some(grid);
        let primitive = self.primitive(terrain, grid);
        let name = terrain.name.as_str();
        let mesh = self.mesh(name.into(), vec![primitive], None);
        let node = self.node(Node {
            name: name.into(),
            mesh: Some(mesh),
            translation: grid.map(|g| y_up(g.centre)),
            scale: grid.map(|g| [g.half_m; 3]),
            ..Node::default()
        });
        self.nodes[0].children.push(node);
    }

    fn primitive(&mut self, part: &'a Part, grid: Option<Grid>) -> Primitive {
        let material = self.selection.material(part);
        let range = self.uv_ranges[material as usize];
        let shown = self.selection.materials[material as usize];
        let at = self.plan.piece(Piece {
            surface: &part.surface,
            grid,
            uv_range: self.profile.is_quantized().then_some(range),
            has_uvs: shown.has_textures(),
            has_tangents: shown.normal_texture.is_some(),
        });
        let extensions = variants::of_primitive(self.selection, material, &self.variant_names);
        Primitive {
            attributes: attributes(&at, self.wind),
            indices: at.index,
            material: Some(material),
            extensions,
        }
    }

    /// One mesh a form and one a collider of every model.
    fn models(&mut self) {
        for model in &self.selection.models {
            let grid = grid_of(model, self.profile);
            let mut forms = Vec::with_capacity(model.forms.len());
            for form in &model.forms {
                let primitives = form.parts.iter().map(|p| self.primitive(p, grid)).collect();
                let name = form.name_of(model.name);
                forms.push(self.mesh(name, primitives, extras_of(form)));
            }
            let mut scattered = Vec::with_capacity(model.scattered.len());
            for scene::Scattered { part, .. } in model.scattered {
                let primitives = vec![self.primitive(part, None)];
                scattered.push(self.mesh(
                    format!("{}_{}", model.name, part.name).into(),
                    primitives,
                    None,
                ));
            }
            self.models.push(Shared { forms, scattered, colliders: Vec::new(), grid });
        }
        for (m, model) in self.selection.models.iter().enumerate() {
            for (k, collider) in model.colliders.iter().enumerate() {
                let at = self.plan.piece(Piece {
                    surface: &collider.body,
                    grid: self.models[m].grid,
                    uv_range: None,
                    has_uvs: false,
                    has_tangents: false,
                });
                let primitive = Primitive {
                    attributes: attributes(&at, self.wind),
                    indices: at.index,
                    material: None,
                    extensions: None,
                };
                let mesh = self.mesh(collider.name(model.name, k).into(), vec![primitive], None);
                self.models[m].colliders.push(mesh);
            }
        }
    }

    fn groups(&mut self) {
        let selection = self.selection;
        for group in &selection.groups {
            // Instances have nothing below them.
            let has_node = |t: &u32| {
                let model = &selection.models[selection.trees[*t as usize].model as usize];
                !(self.profile.has_instances() && model.scattered.is_empty())
            };
            let (alone, together): (Vec<u32>, Vec<u32>) =
                group.trees.iter().partition(|t| has_node(t));
            let mut children: Vec<u32> = alone.into_iter().map(|t| self.tree(t)).collect();
            let cells = cells(selection, &together);
            children.extend(cells.iter().flat_map(|cell| self.cell(cell)));
            let name = level_of(selection, group.name);
            let node = self.node(Node { name, children, ..Node::default() });
            self.nodes[0].children.push(node);
        }
    }

    /// A node that shares its model's mesh; below it, what is scattered over the model, and colliders.
    fn tree(&mut self, t: u32) -> u32 {
        let tree = self.selection.trees[t as usize];
        let instance = tree.instance;
        let model = &self.selection.models[tree.model as usize];
        let mesh = self.models[tree.model as usize].forms[0];
        let bodies = self.models[tree.model as usize].colliders.clone();
        let named = model.colliders.iter().zip(bodies).enumerate();
        let mut children = Vec::new();
        let meshes = self.models[tree.model as usize].scattered.clone();
        for (scattered, mesh) in model.scattered.iter().zip(meshes) {
            children.push(self.scattered(&instance.name, scattered, mesh));
        }
        let colliders: Vec<u32> = named
            .map(|(k, (collider, mesh))| {
                let name = collider.name(&instance.name, k).into();
                self.node(Node { name, mesh: Some(mesh), ..Node::default() })
            })
            .collect();
        children.extend(colliders);
        let (sin, cos) = (instance.yaw_rad * 0.5).sin_cos();
        let scale = instance.scale;
        self.node(Node {
            name: model.forms[0].name_of(&instance.name),
            mesh: Some(mesh),
            children,
            translation: Some(y_up(instance.position)),
            rotation: (sin != 0.0).then_some([0.0, sin, 0.0, cos]),
            scale: (scale != Vec3::ONE).then_some([scale.x, scale.z, scale.y]),
            extras: Some(NodeExtras::Tree(facts(&instance.facts))),
            ..Node::default()
        })
    }

    /// A node of the instances of a part within a tree.
    fn scattered(&mut self, tree: &str, scattered: &scene::Scattered, mesh: u32) -> u32 {
        let places = || scattered.places.iter();
        let turns = places().map(|place| {
            let [x, y, z] = y_up(place.turn.xyz());
            [x, y, z, place.turn.w].map(|c| (c * f32::from(i16::MAX)).round() as i16)
        });
        let first = self.plan.instances(
            places().map(|place| y_up(place.position)).collect(),
            turns.collect(),
            places().map(|place| [place.scale; 3]).collect(),
        );
        self.node(Node {
            name: format!("{tree}_{}", scattered.part.name).into(),
            mesh: Some(mesh),
            extensions: NodeExtensions {
                instancing: Some(Instancing { attributes: InstanceAttributes::from(first) }),
                lod: None,
            },
            ..Node::default()
        })
    }

    /// A node of many instances, then one a collider. Nodes of coarser forms are reached from the
    /// first alone, so that readers that do not know them pass them by.
    fn cell(&mut self, cell: &Cell) -> Vec<u32> {
        let selection = self.selection;
        let model = &selection.models[cell.model as usize];
        let Shared { forms, colliders, grid, .. } = &self.models[cell.model as usize];
        let (forms, colliders) = (forms.clone(), colliders.clone());
        let unit_m = grid.map_or(1.0, |g| g.half_m);
        let trees = || cell.trees.iter().map(|&t| selection.trees[t as usize].instance);
        let places = trees().map(|t| y_up(t.position - cell.centre)).collect();
        let turns = trees().map(|t| {
            let (sin, cos) = (t.yaw_rad * 0.5).sin_cos();
            let steps = |c: f32| (c * f32::from(i16::MAX)).round() as i16;
            [0, steps(sin), 0, steps(cos)]
        });
        let scales =
            trees().map(|t| (Vec3::new(t.scale.x, t.scale.z, t.scale.y) * unit_m).to_array());
        let first = self.plan.instances(places, turns.collect(), scales.collect());
        let attributes = InstanceAttributes::from(first);
        let name = format!("{}_cell_{}_{}", model.name, cell.at[0], cell.at[1]);
        let node = |name: Cow<'_, str>, mesh: u32| Node {
            name: name.into_owned().into(),
            mesh: Some(mesh),
            translation: Some(y_up(cell.centre)),
            extensions: NodeExtensions { instancing: Some(Instancing { attributes }), lod: None },
            ..Node::default()
        };
        let coarser: Vec<u32> = model.forms[1..]
            .iter()
            .zip(&forms[1..])
            .map(|(form, &mesh)| self.node(node(form.name_of(&name), mesh)))
            .collect();
        let mut finest = node(model.forms[0].name_of(&name), forms[0]);
        let mut screen_cover = Vec::new();
        if !coarser.is_empty() {
            screen_cover = screen_coverage(&model.forms, cell.diameter_m);
            finest.extensions.lod = Some(Lod { ids: coarser });
        }
        let facts: Vec<&TreeFacts> = trees().map(|t| &t.facts).collect();
        finest.extras = Some(NodeExtras::Trees(TreesExtras {
            screen_coverage: screen_cover,
            species: facts.first().map_or("", |f| f.species.as_str()),
            trees: columns(&facts),
        }));
        let mut out = vec![self.node(finest)];
        for (k, (collider, mesh)) in model.colliders.iter().zip(colliders).enumerate() {
            out.push(self.node(node(collider.name(&name, k).into(), mesh)));
        }
        out
    }
}

fn attributes(at: &PieceAccessors, wind: WindAs) -> Attributes {
    let wind_as = |wanted: WindAs| at.wind.filter(|_| wind == wanted);
    Attributes {
        position: at.position,
        normal: at.normal,
        // Sets are counted from 0 without a gap: what no texture covers has its places on the light map twice.
        texcoord_0: at.uv.or(at.lightmap_uv),
        texcoord_1: at.lightmap_uv,
        tangent: at.tangent,
        color_0: wind_as(WindAs::Color),
        wind: wind_as(WindAs::Attribute),
    }
}

/// What all models together are called in the finest form that is shown.
fn level_of<'n>(selection: &Selection<'_>, of: &'n str) -> Cow<'n, str> {
    let finest = selection.models.first().and_then(|model| model.forms.first());
    finest.map_or(of.into(), |form| form.name_of(of))
}

/// One for all forms and colliders, so that instances of each stand alike; `None` where positions stay
/// metres: a node with others below it has no scale of its own.
pub(super) fn grid_of(model: &Model<'_>, profile: Profile) -> Option<Grid> {
    if !profile.has_counted_positions() || !model.scattered.is_empty() {
        return None;
    }
    let parts = model.forms.iter().flat_map(|f| f.parts).map(|p| &p.surface);
    let bodies: Vec<&Surface> = model.colliders.iter().map(|c| &c.body).collect();
    Some(Grid::about_origin(parts.chain(bodies)))
}

fn facts(facts: &TreeFacts) -> TreeExtras<'_> {
    TreeExtras {
        id: &facts.id,
        species: &facts.species,
        height_m: facts.height_m,
        crown_diameter_m: facts.crown_diameter_m,
        crown_base_height_m: facts.crown_base_height_m,
        stem_diameter_m: facts.stem_diameter_m,
        condition: facts.condition,
        confidence: facts.confidence,
    }
}

fn columns<'a>(facts: &[&'a TreeFacts]) -> TreeColumns<'a> {
    let number = |of: fn(&TreeFacts) -> f32| facts.iter().map(|f| of(f)).collect();
    TreeColumns {
        id: facts.iter().map(|f| f.id.as_str()).collect(),
        height_m: number(|f| f.height_m),
        crown_diameter_m: number(|f| f.crown_diameter_m),
        crown_base_height_m: number(|f| f.crown_base_height_m),
        stem_diameter_m: number(|f| f.stem_diameter_m),
        condition: facts.iter().map(|f| f.condition).collect(),
        confidence: number(|f| f.confidence),
    }
}

fn extras_of(form: &Form<'_>) -> Option<MeshExtras> {
    let octahedral = |o: scene::Octahedral| OctahedralExtras {
        frames: o.frames,
        centre: y_up(o.centre),
        radius_m: o.radius_m,
        note: "towards the eye d, y up: p = d.xz / (|d.x| + |d.y| + |d.z|), \
               e = (p.x - p.z, p.x + p.z); the view is in column, row (from below) \
               (frames - 1) (e + 1) / 2",
    };
    let is_coarser = !form.is_finest() || form.silhouette != Apart::NONE;
    is_coarser.then(|| MeshExtras {
        silhouette_worst_m: form.silhouette.worst_m,
        silhouette_rms_m: form.silhouette.rms_m,
        octahedral: form.octahedral.map(octahedral),
    })
}

/// The selection's, then their variants in the same order.
fn materials<'a>(selection: &Selection<'a>, ranges: &[UvRange], stem: &str) -> Vec<Material<'a>> {
    let all = || selection.materials.iter().zip(ranges);
    let own = all().map(|(m, &range)| material(selection, m, range, stem));
    let others = all().flat_map(|(m, &range)| {
        m.variants.iter().map(move |v| {
            let [r, g, b] = v.base_color;
            let mut other = material(selection, m, range, stem);
            other.name = format!("{}_{}", m.name, v.name).into();
            other.pbr_metallic_roughness.base_color_factor = [r, g, b, 1.0];
            other.pbr_metallic_roughness.base_color_texture =
                texture_ref(selection, v.base_color_texture, range);
            if let Some(MaterialExtensions { transmission: Some(transmission), .. }) =
                &mut other.extensions
            {
                transmission.diffuse_transmission_color_factor = v.base_color;
                transmission.diffuse_transmission_color_texture =
                    texture_ref(selection, v.base_color_texture, range);
            }
            other
        })
    });
    own.chain(others).collect()
}

fn texture_ref(selection: &Selection<'_>, of: Option<u32>, range: UvRange) -> Option<TextureRef> {
    let transform =
        TextureTransform { offset: range.offset.to_array(), scale: range.scale.to_array() };
    let extensions = (range != UvRange::PICTURE).then_some(TextureRefExtensions { transform });
    of.map(|texture| TextureRef { index: selection.texture(texture), extensions })
}

fn material<'a>(
    selection: &Selection<'a>,
    material: &'a scene::Material,
    range: UvRange,
    stem: &str,
) -> Material<'a> {
    let [r, g, b] = material.base_color;
    let texture = |of: Option<u32>| texture_ref(selection, of, range);
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
        extensions: (material.translucency > 0.0 || material.specular < 1.0).then(|| {
            MaterialExtensions {
                transmission: (material.translucency > 0.0).then(|| DiffuseTransmission {
                    diffuse_transmission_factor: material.translucency,
                    diffuse_transmission_color_factor: material.base_color,
                    diffuse_transmission_color_texture: texture(material.base_color_texture),
                }),
                specular: (material.specular < 1.0)
                    .then_some(Specular { specular_factor: material.specular }),
            }
        }),
        extras: material.relief().map(|(name, relief)| {
            let uri = percent_encoded(&texture_path(stem, &name, PictureFormat::Png));
            MaterialExtras { height: Height { uri, depth_m: relief.depth_m } }
        }),
    }
}

/// Textures as the selection numbers them, and a sampler for each way of wrapping that occurs.
fn textures<'a>(
    selection: &Selection<'a>,
    coding: PictureFormat,
) -> (Vec<Texture<'a>>, Vec<Sampler>) {
    let mut wraps: Vec<Wrap> = Vec::new();
    let textures = (0u32..).zip(selection.pictures()).map(|(number, (texture, wrap))| {
        let sampler = wraps.iter().position(|&w| w == wrap).unwrap_or_else(|| {
            wraps.push(wrap);
            wraps.len() - 1
        });
        let webp = coding == PictureFormat::WebP;
        Texture {
            name: &texture.name,
            sampler: sampler as u32,
            source: (!webp).then_some(number),
            extensions: webp.then_some(TextureExtensions { webp: Source { source: number } }),
        }
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

fn images<'a>(
    selection: &Selection<'a>,
    formats: impl Iterator<Item = PictureFormat>,
    beside: Beside<'_>,
    first_view: u32,
) -> Vec<Image<'a>> {
    let image =
        |((view, (texture, _)), format): ((u32, (&'a scene::Texture, _)), PictureFormat)| {
            let name = texture.name.as_str();
            match beside {
                Beside::Nothing => Image {
                    name,
                    uri: None,
                    mime_type: Some(format.mime_type()),
                    buffer_view: Some(view),
                },
                Beside::Files { stem, .. } => Image {
                    name,
                    uri: Some(percent_encoded(&texture_path(stem, name, format))),
                    mime_type: None,
                    buffer_view: None,
                },
            }
        };
    (first_view..).zip(selection.pictures()).zip(formats).map(image).collect()
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
