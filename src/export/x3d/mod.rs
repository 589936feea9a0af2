//! X3D 4.0 (ISO/IEC 19775-1:2023) in its XML encoding (ISO/IEC 19776-1).
//!
//! A Transform a tree, with what is known of it as a MetadataSet; trees share models by DEF and
//! USE, a model being defined where its first tree stands, for some readers draw what a Switch
//! hides. Models of several forms are under an LOD. WorldInfo tells the place on the map. Y up:
//! vertices and places are turned as in glTF, so no node needs a correcting turn.
//!
//! The plain form is that of P18: IndexedFaceSet, every number the shortest that reads back as the
//! same f32. The compact form is IndexedTriangleSet, rounded ([`COMPACT`]).
//!
//! Materials are Material without gloss, which bark and leaves have little of, with the colour's
//! texture in the Appearance: x3dom (1.8.3) shows a standard PhysicalMaterial without its pictures.
//! Limits: roughness, octahedral impostors, which need a shader, wind colours, colliders and
//! material variants are not written.

mod xml;

use std::io;

use glam::{Vec2, Vec3};

use self::xml::{Xml, numbers, strings};
use super::blocks;
use super::gltf::y_up;
use super::number;
use super::pictures::texture_path;
use super::{Content, GENERATOR, OutputFile, PictureFormat};
use crate::frame::Frame;
use crate::mesh::Surface;
use crate::scene::{
    Alpha, Form, Material, Model, PICTURE_LINES, Part, Selection, Tree, ValidScene, Wrap,
};

/// Places after the point.
#[derive(Clone, Copy)]
struct Places {
    /// Metres.
    of_trees: u32,
    of_terrain: u32,
    normal: u32,
    uv: u32,
}

/// Positions are at most 0.05 mm off in trees (each coordinate) and 0.5 mm in the terrain, normals
/// 0.5°, texture coordinates 1/20 of a texel of 1024.
const COMPACT: Places = Places { of_trees: 4, of_terrain: 3, normal: 2, uv: 4 };

/// Farthest that rounding moves a vertex of the compact form along an axis, metres.
pub fn worst_shift_m(scene: &ValidScene) -> f32 {
    let shift = |parts: &[&Part], places: u32| {
        let unit = 10f32.powi(places as i32);
        let all = parts.iter().flat_map(|p| &p.surface.position).flat_map(|p| p.to_array());
        all.map(|v| ((v * unit).round() / unit - v).abs()).fold(0.0, f32::max)
    };
    let trees: Vec<&Part> = scene.prototypes().iter().flat_map(|p| p.all_parts()).collect();
    let terrain: Vec<&Part> = scene.terrain().into_iter().collect();
    shift(&trees, COMPACT.of_trees).max(shift(&terrain, COMPACT.of_terrain))
}

/// `STEM.x3d`; its textures are [`super::Pictures::files`] as PNG.
pub(super) fn file<'a>(selection: Selection<'a>, stem: &str, is_compact: bool) -> OutputFile<'a> {
    let textures_of = stem.to_owned();
    let content = Content::stream(move |sink| {
        blocks::through(sink, |blocks| {
            let writer = Writer {
                selection: &selection,
                stem: &textures_of,
                places: is_compact.then_some(COMPACT),
                has_material: vec![false; selection.materials.len()],
                has_texture: vec![false; selection.textures.len()],
                has_model: vec![false; selection.models.len()],
                xml: Xml::new(blocks),
            };
            writer.document()
        })
    });
    OutputFile { path: format!("{stem}.x3d").into(), content }
}

/// What was defined is used from then on.
struct Writer<'w, 'a> {
    selection: &'w Selection<'a>,
    stem: &'w str,
    /// Where numbers are rounded.
    places: Option<Places>,
    has_material: Vec<bool>,
    has_texture: Vec<bool>,
    has_model: Vec<bool>,
    xml: Xml<'a>,
}

impl<'a> Writer<'_, 'a> {
    fn document(mut self) -> io::Result<()> {
        let scene = self.selection.scene();
        self.xml.line("<?xml version=\"1.0\" encoding=\"UTF-8\"?>");
        self.xml.line(
            "<!DOCTYPE X3D PUBLIC \"ISO//Web3D//DTD X3D 4.0//EN\" \
             \"https://www.web3d.org/specifications/x3d-4.0.dtd\">",
        );
        self.xml.open(
            "X3D",
            &[
                ("profile", "Interchange"),
                ("version", "4.0"),
                ("xmlns:xsd", "http://www.w3.org/2001/XMLSchema-instance"),
                (
                    "xsd:noNamespaceSchemaLocation",
                    "https://www.web3d.org/specifications/x3d-4.0.xsd",
                ),
            ],
        );
        self.xml.open("head", &[]);
        // What the profile leaves out: LOD, and normal maps.
        self.xml.empty("component", &[("name", "Navigation"), ("level", "2")]);
        self.xml.empty("component", &[("name", "Shape"), ("level", "4")]);
        self.xml.empty("meta", &[("name", "title"), ("content", scene.name())]);
        self.xml.empty("meta", &[("name", "generator"), ("content", GENERATOR)]);
        self.xml.close("head");
        self.xml.open("Scene", &[]);
        self.world_info();
        self.view();
        if let Some(terrain) = self.selection.terrain {
            self.xml.open("Group", &[("DEF", "terrain-ground")]);
            self.shape(terrain, self.places.map(|p| Places { of_trees: p.of_terrain, ..p }))?;
            self.xml.close("Group");
        }
        for group in &self.selection.groups {
            self.xml.open("Group", &[("DEF", &format!("{}-species", group.name))]);
            for &t in &group.trees {
                let tree = self.selection.trees[t as usize];
                self.tree(&tree)?;
            }
            self.xml.close("Group");
        }
        self.xml.close("Scene");
        self.xml.close("X3D");
        self.xml.finish()
    }

    /// How to put the scene back on the map.
    fn world_info(&mut self) {
        let frame = self.selection.scene().frame();
        let Frame { origin, crs } = frame;
        let note = "east = origin[0] + x / unit_m[0], north = origin[1] - z / unit_m[1], up = \
                    origin[2] + y / unit_m[2]";
        let info = strings(&[GENERATOR, "Metres, Y up", note]);
        let title = self.selection.scene().name();
        self.xml.open("WorldInfo", &[("title", title), ("info", &info)]);
        self.xml.open("MetadataSet", &[("name", "place"), ("containerField", "metadata")]);
        if let Some(epsg) = crs.as_ref().and_then(|crs| crs.epsg) {
            self.fact("MetadataInteger", "epsg", &epsg.to_string());
        }
        for (name, of) in [("origin", *origin), ("unit_m", frame.unit_m())] {
            self.fact("MetadataDouble", name, &format!("{} {} {}", of.x, of.y, of.z));
        }
        if let Some(wkt) = crs.as_ref().and_then(|crs| crs.wkt.as_deref()) {
            self.fact("MetadataString", "wkt", &strings(&[wkt]));
        }
        self.xml.close("MetadataSet");
        self.xml.close("WorldInfo");
    }

    fn fact(&mut self, kind: &str, name: &str, value: &str) {
        self.xml.empty(kind, &[("name", name), ("containerField", "value"), ("value", value)]);
    }

    /// All of the scene, from the south and above.
    fn view(&mut self) {
        /// Of X3D's default field of view, 45°, with room to spare.
        const DISTANCE: f32 = 2.5;
        /// So that dark crowns show.
        const SKY: &str = "0.65 0.78 0.9";
        /// 20° down: the angle, its sine and cosine.
        const DOWN: (f32, f32, f32) = (0.349_066, 0.342_020, 0.939_693);
        let (lo, hi) = self.selection.scene().bounds();
        let radius = (0.5 * lo.distance(hi)).max(1.0);
        let centre = Vec3::from(y_up(0.5 * lo + 0.5 * hi));
        let eye = centre + DISTANCE * radius * Vec3::new(0.0, DOWN.1, DOWN.2);
        self.xml.empty(
            "NavigationInfo",
            &[
                ("type", &strings(&["EXAMINE", "WALK", "FLY", "ANY"])),
                ("speed", &numbers(&[(radius / 10.0).max(1.0)])),
            ],
        );
        self.xml.empty("Background", &[("skyColor", SKY)]);
        self.xml.empty(
            "Viewpoint",
            &[
                ("description", "From the south"),
                ("centerOfRotation", &numbers(&centre.to_array())),
                ("position", &numbers(&eye.to_array())),
                ("orientation", &numbers(&[1.0, 0.0, 0.0, -DOWN.0])),
            ],
        );
    }

    fn tree(&mut self, tree: &Tree<'a>) -> io::Result<()> {
        let instance = tree.instance;
        let facts = &instance.facts;
        let [x, y, z] = instance.scale.to_array();
        self.xml.open(
            "Transform",
            &[
                ("DEF", &instance.name),
                ("translation", &numbers(&y_up(instance.position))),
                ("rotation", &numbers(&[0.0, 1.0, 0.0, instance.yaw_rad])),
                ("scale", &numbers(&[x, z, y])),
            ],
        );
        self.xml.open("MetadataSet", &[("name", "tree"), ("containerField", "metadata")]);
        let words =
            [("id", &*facts.id), ("species", &*facts.species), ("condition", facts.condition)];
        for (name, word) in words {
            self.fact("MetadataString", name, &strings(&[word]));
        }
        for (name, value) in [
            ("height_m", facts.height_m),
            ("crown_diameter_m", facts.crown_diameter_m),
            ("crown_base_height_m", facts.crown_base_height_m),
            ("stem_diameter_m", facts.stem_diameter_m),
            ("confidence", facts.confidence),
        ] {
            self.fact("MetadataFloat", name, &numbers(&[value]));
        }
        self.xml.close("MetadataSet");
        self.model(tree.model)?;
        self.xml.close("Transform");
        self.xml.pass_on()
    }

    fn model(&mut self, number: u32) -> io::Result<()> {
        let selection = self.selection;
        let model = &selection.models[number as usize];
        let is_defined = std::mem::replace(&mut self.has_model[number as usize], true);
        let forms = shown(model);
        if forms.len() > 1 {
            let range = numbers(&ranges(&forms));
            self.xml.open("LOD", &[("center", &numbers(&centre(forms[0]))), ("range", &range)]);
        }
        for form in &forms {
            let name = format!("{}-{}", model.name, form.name);
            if is_defined {
                self.xml.empty("Group", &[("USE", &name)]);
                continue;
            }
            self.xml.open("Group", &[("DEF", &name)]);
            for part in form.parts {
                self.shape(part, self.places)?;
            }
            self.xml.close("Group");
        }
        if forms.len() > 1 {
            self.xml.close("LOD");
        }
        Ok(())
    }

    fn shape(&mut self, part: &'a Part, places: Option<Places>) -> io::Result<()> {
        self.xml.open("Shape", &[]);
        let number = self.selection.material(part) as usize;
        let material = self.selection.materials[number];
        self.appearance(number, material);
        let solid = if material.double_sided { "false" } else { "true" };
        let uvs = if material.has_textures() { &part.surface.uv[..] } else { &[] };
        match places {
            Some(places) => self.triangles(&part.surface, uvs, solid, places)?,
            None => self.faces(&part.surface, uvs, solid)?,
        }
        self.xml.close("Shape");
        Ok(())
    }

    /// As in P18.
    fn faces(&mut self, surface: &'a Surface, uvs: &'a [Vec2], solid: &str) -> io::Result<()> {
        let (triangles, _) = surface.index.as_chunks::<3>();
        let solid = [("solid", solid)];
        self.xml.open_list("IndexedFaceSet", &solid, "coordIndex", triangles, |out, corners| {
            number::spaced(out, corners, |out, &c| number::integer(out, i64::from(c)));
            out.text(b" -1");
        })?;
        self.columns(
            surface,
            uvs,
            |out, p| number::shortest_of(out, &y_up(*p)),
            // X3D takes no part above 1, which rounding may bring.
            |out, n| number::shortest_of(out, &y_up(n.clamp(Vec3::NEG_ONE, Vec3::ONE))),
            |out, c| number::shortest_of(out, &c.to_array()),
        )?;
        self.xml.close("IndexedFaceSet");
        Ok(())
    }

    fn triangles(
        &mut self,
        surface: &'a Surface,
        uvs: &'a [Vec2],
        solid: &str,
        places: Places,
    ) -> io::Result<()> {
        let (triangles, _) = surface.index.as_chunks::<3>();
        let solid = [("solid", solid)];
        self.xml.open_list("IndexedTriangleSet", &solid, "index", triangles, |out, corners| {
            number::spaced(out, corners, |out, &c| number::integer(out, i64::from(c)));
        })?;
        let round = |out: &mut number::Pen, values: &[f32], places| {
            number::spaced(out, values, |out, &v| number::rounded(out, v, places));
        };
        self.columns(
            surface,
            uvs,
            move |out, p| round(out, &y_up(*p), places.of_trees),
            move |out, n| round(out, &y_up(n.clamp(Vec3::NEG_ONE, Vec3::ONE)), places.normal),
            move |out, c| round(out, &c.to_array(), places.uv),
        )?;
        self.xml.close("IndexedTriangleSet");
        Ok(())
    }

    fn columns(
        &mut self,
        surface: &'a Surface,
        uvs: &'a [Vec2],
        position: impl Fn(&mut number::Pen, &Vec3) + Copy + Send + Sync + 'a,
        normal: impl Fn(&mut number::Pen, &Vec3) + Copy + Send + Sync + 'a,
        uv: impl Fn(&mut number::Pen, &Vec2) + Copy + Send + Sync + 'a,
    ) -> io::Result<()> {
        self.xml.list("Coordinate", "point", &surface.position, position)?;
        self.xml.list("Normal", "vector", &surface.normal, normal)?;
        if uvs.is_empty() {
            return Ok(());
        }
        self.xml.list("TextureCoordinate", "point", uvs, uv)
    }

    fn appearance(&mut self, number: usize, material: &Material) {
        let name = format!("{}-material", material.name);
        if std::mem::replace(&mut self.has_material[number], true) {
            self.xml.empty("Appearance", &[("USE", &name)]);
            return;
        }
        let mut attributes = vec![("DEF", name.as_str())];
        let cutoff;
        match material.alpha {
            Alpha::Opaque => attributes.push(("alphaMode", "OPAQUE")),
            Alpha::Mask { cutoff: at } => {
                cutoff = numbers(&[at]);
                attributes.extend([("alphaMode", "MASK"), ("alphaCutoff", cutoff.as_str())]);
            }
        }
        self.xml.open("Appearance", &attributes);
        let colour = numbers(&material.base_color);
        let lambert = [("diffuseColor", &*colour), ("specularColor", "0 0 0")];
        if material.normal_texture.is_some() {
            self.xml.open("Material", &lambert);
            self.texture("normalTexture", material.normal_texture);
            self.xml.close("Material");
        } else {
            self.xml.empty("Material", &lambert);
        }
        self.texture("texture", material.base_color_texture);
        self.xml.close("Appearance");
    }

    /// `texture`: one of the scene's.
    fn texture(&mut self, field: &str, texture: Option<u32>) {
        let Some(number) = texture else { return };
        let scene = self.selection.scene();
        let texture = &scene.textures()[number as usize].name;
        let name = format!("{texture}-texture");
        let at = self.selection.texture(number) as usize;
        if std::mem::replace(&mut self.has_texture[at], true) {
            self.xml.empty("ImageTexture", &[("USE", &name), ("containerField", field)]);
            return;
        }
        let url = strings(&[&texture_path(self.stem, texture, PictureFormat::Png)]);
        let mut attributes = vec![("DEF", name.as_str()), ("containerField", field), ("url", &url)];
        if scene.wrap(number) == Wrap::Clamp {
            attributes.extend([("repeatS", "false"), ("repeatT", "false")]);
        }
        self.xml.empty("ImageTexture", &attributes);
    }
}

/// All forms but those that need a shader.
fn shown<'m, 'a>(model: &'m Model<'a>) -> Vec<&'m Form<'a>> {
    let (finest, coarser) = match &model.forms[..] {
        [finest, coarser @ ..] => (Some(finest), coarser),
        [] => (None, &[][..]),
    };
    finest.into_iter().chain(coarser.iter().filter(|f| f.octahedral.is_none())).collect()
}

/// Middle of a form, Y up.
fn centre(form: &Form<'_>) -> [f32; 3] {
    let bounds = form.parts.iter().map(|part| part.surface.bounds());
    let (lo, hi) = bounds.reduce(|a, b| (a.0.min(b.0), a.1.max(b.1))).unwrap_or_default();
    y_up(0.5 * lo + 0.5 * hi)
}

/// How far away the next form takes over, metres, one value less than forms: where its silhouette
/// is off by a line (root mean square) of a picture of [`PICTURE_LINES`], in X3D's default field of view.
/// Always growing.
fn ranges(forms: &[&Form<'_>]) -> Vec<f32> {
    /// Between two changes.
    const LEAST_M: f32 = 0.01;
    // 45°.
    let metre_is_a_line_m = 0.5 * PICTURE_LINES / std::f32::consts::FRAC_PI_8.tan();
    let mut before = 0.0;
    let next = forms.iter().skip(1).map(|next| {
        before = (next.silhouette.rms_m * metre_is_a_line_m).max(before + LEAST_M);
        before
    });
    next.collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_form_is_shown_until_the_next_is_good_enough() {
        let of = |all: &[f32]| {
            let forms: Vec<_> = all.iter().map(|&rms_m| Form::off(rms_m)).collect();
            ranges(&forms.iter().collect::<Vec<_>>())
        };
        // 45° are 1080 lines: at 1303.7 m a line is 2 · 1303.7 · tan 22.5° / 1080 = 1 m high.
        let [first, second] = of(&[0.0, 0.1, 0.5])[..] else { panic!() };
        let line_m = |distance_m: f32| 2.0 * distance_m * 22.5f32.to_radians().tan() / 1080.0;
        assert!((line_m(first) - 0.1).abs() < 1e-5 && (line_m(second) - 0.5).abs() < 1e-5);
        // A coarser form that is nearer than a finer one still comes after it.
        let [first, second] = of(&[0.0, 0.5, 0.1])[..] else { panic!() };
        assert!(second > first && second < first + 0.1);
        assert!(of(&[0.0, 0.0])[0] > 0.0 && of(&[0.0]).is_empty());
    }
}
