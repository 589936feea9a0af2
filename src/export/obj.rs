//! Wavefront OBJ with its materials in MTL, as readers of today take them (among them the PBR
//! keys `Pr`, `Pm` and `norm`).
//!
//! OBJ has no instances: every tree is written out in its place, and only the texture coordinates
//! of a model stand once. An `o` a tree, a `g` a part of it. Y up, as its readers expect.
//! Positions are the shortest digits that read back as the same f32; normals have 4 places.
//!
//! Limits: readers count vertices in 32 bits with a sign; roughness is one number a material, for
//! readers differ in which channel of a texture they take; no wind colours, colliders, variants.

use std::fmt::Write;
use std::io;

use glam::{Vec2, Vec3};

use super::blocks::{self, Blocks};
use super::gltf::y_up;
use super::number;
use super::pictures::{plain, texture_path};
use super::{Content, GENERATOR, OutputFile, PictureFormat};
use crate::diagnostic::{Error, Result, Warned};
use crate::scene::{Alpha, Instance, Material, Part, Selection};

/// The most vertices of a file, texture coordinates and normals counted each for themselves.
const MOST_VERTICES: u64 = i32::MAX as u64;
/// A file larger than this is warned of: other formats hold the same in a small part of it.
const LARGE_BYTES: u64 = 1_000_000_000;
/// Of a vertex with its normal, about.
const VERTEX_BYTES: u64 = 56;

const NORMAL_PLACES: u32 = 4;

/// `STEM.obj` and its `.mtl`; the textures, named after `textures_of`, are
/// [`super::Pictures::files`] as PNG.
///
/// # Errors
/// More vertices than readers count.
pub(super) fn files<'a>(
    selection: Selection<'a>,
    stem: &str,
    textures_of: &str,
) -> Result<Warned<Vec<OutputFile<'a>>>> {
    let size = Size::of(&selection);
    let file = format!("{stem}.obj");
    let gigabytes = size.bytes() as f64 * 1e-9;
    if size.vertices > MOST_VERTICES {
        return Err(Error::new(format!(
            "every tree written out makes {} vertices, {gigabytes:.0} GB, and readers of OBJ count \
             to {MOST_VERTICES}",
            size.vertices
        ))
        .in_file(file)
        .remedy(
            "write --format glb or usda, where trees share models, or ask for fewer --triangles",
        ));
    }
    let warning = (size.bytes() > LARGE_BYTES).then(|| {
        format!(
            "{file} is about {gigabytes:.1} GB, for OBJ has no instances: {} trees are written out \
             as {} triangles; --format glb or usda share models",
            selection.trees.len(),
            size.triangles
        )
    });
    // A blank would end the name for some readers.
    let library = format!("{}.mtl", plain(stem));
    let materials = mtl(&selection, textures_of);
    let named = library.clone();
    let content = Content::stream(move |sink| {
        blocks::through(sink, |blocks| {
            let writer = Writer {
                selection: &selection,
                vertices: 0,
                texture_coordinates: 0,
                first_uv: vec![None; selection.models.len()],
                blocks,
            };
            writer.document(&named)
        })
    });
    let files =
        vec![OutputFile { path: file.into(), content }, OutputFile::new(library, materials)];
    Ok(Warned::with(files, warning.into_iter().collect()))
}

/// Of a whole file.
#[derive(Default)]
struct Size {
    vertices: u64,
    triangles: u64,
}

impl Size {
    fn of(selection: &Selection<'_>) -> Size {
        let mut size = Size::default();
        let of_models: Vec<Size> =
            selection.models.iter().map(|m| Size::of_parts(parts_of(&m.forms))).collect();
        let models = selection.trees.iter().map(|tree| &of_models[tree.model as usize]);
        let terrain = Size::of_parts(selection.terrain);
        for part in models.chain([&terrain]) {
            size.vertices = size.vertices.saturating_add(part.vertices);
            size.triangles = size.triangles.saturating_add(part.triangles);
        }
        size
    }

    fn of_parts<'p>(parts: impl IntoIterator<Item = &'p Part>) -> Size {
        let mut size = Size::default();
        for part in parts {
            size.vertices += part.surface.position.len() as u64;
            size.triangles += part.surface.triangles() as u64;
        }
        size
    }

    /// About.
    fn bytes(&self) -> u64 {
        let digits = u64::from(self.vertices.max(1).ilog10()) + 1;
        let vertices = self.vertices.saturating_mul(VERTEX_BYTES);
        vertices.saturating_add(self.triangles.saturating_mul(3 * (3 * digits + 3) + 3))
    }
}

/// The parts of the finest form that is shown.
fn parts_of<'a>(forms: &[crate::scene::Form<'a>]) -> &'a [Part] {
    forms.first().map_or(&[], |form| form.parts)
}

struct Writer<'w, 'a> {
    selection: &'w Selection<'a>,
    /// Written so far.
    vertices: u64,
    texture_coordinates: u64,
    /// Number before the model's first texture coordinate, once written.
    first_uv: Vec<Option<u64>>,
    blocks: Blocks<'a>,
}

impl<'a> Writer<'_, 'a> {
    fn document(mut self, library: &str) -> io::Result<()> {
        let frame = self.selection.scene().frame();
        let (origin, unit_m) = (frame.origin, frame.unit_m());
        let mut head = format!(
            "# {GENERATOR}; metres, Y up\n# origin {} {} {}, unit_m {} {} {}: east = origin[0] + x \
             / unit_m[0], north = origin[1] - z / unit_m[1], up = origin[2] + y / unit_m[2]\n",
            origin.x, origin.y, origin.z, unit_m.x, unit_m.y, unit_m.z
        );
        if let Some(epsg) = frame.crs.as_ref().and_then(|crs| crs.epsg) {
            // A String takes every write.
            let _ = writeln!(head, "# epsg {epsg}");
        }
        let _ = writeln!(head, "mtllib {library}");
        self.blocks.text(&head)?;
        if let Some(terrain) = self.selection.terrain {
            self.blocks.text("o terrain\n")?;
            let first = self.uv(terrain)?;
            self.part(terrain, "terrain", &Place::default(), first)?;
        }
        for &t in self.selection.groups.iter().flat_map(|group| &group.trees) {
            let tree = self.selection.trees[t as usize];
            let forms = &self.selection.models[tree.model as usize].forms;
            let parts = parts_of(forms);
            let own = &tree.instance.name[..];
            let name = forms.first().map_or(own.into(), |form| form.name_of(own));
            self.blocks.text(&format!("o {name}\n"))?;
            let mut first_uv = match self.first_uv[tree.model as usize] {
                Some(first) => first,
                None => {
                    let first = self.texture_coordinates;
                    self.first_uv[tree.model as usize] = Some(first);
                    for part in parts {
                        self.uv(part)?;
                    }
                    first
                }
            };
            let place = Place::of(tree.instance);
            for part in parts {
                self.part(part, &format!("{name}_{}", part.name), &place, first_uv)?;
                first_uv += self.uvs(part).len() as u64;
            }
        }
        self.blocks.finish()
    }

    /// None where no texture needs them.
    fn uvs(&self, part: &'a Part) -> &'a [Vec2] {
        let material = self.selection.materials[self.selection.material(part) as usize];
        if material.has_textures() { &part.surface.uv } else { &[] }
    }

    /// Gives the number before the first.
    fn uv(&mut self, part: &'a Part) -> io::Result<u64> {
        let (first, uvs) = (self.texture_coordinates, self.uvs(part));
        self.texture_coordinates += uvs.len() as u64;
        self.blocks.rows(uvs, |out, uv| {
            out.text(b"vt ");
            number::shortest_of(out, &uv.to_array());
            out.push(b'\n');
        })?;
        Ok(first)
    }

    fn part(&mut self, part: &'a Part, name: &str, place: &Place, first_uv: u64) -> io::Result<()> {
        let place = *place;
        let surface = &part.surface;
        self.blocks.rows(&surface.position, move |out, &p| {
            out.text(b"v ");
            number::shortest_of(out, &y_up(place.point(p)));
            out.push(b'\n');
        })?;
        self.blocks.rows(&surface.normal, move |out, &n| {
            out.text(b"vn ");
            number::spaced(out, &y_up(place.normal(n)), |out, &v| {
                number::rounded(out, v, NORMAL_PLACES);
            });
            out.push(b'\n');
        })?;
        let material = self.selection.materials[self.selection.material(part) as usize];
        self.blocks.text(&format!("g {name}\nusemtl {}\n", material.name))?;
        // Normals are numbered as vertices are.
        let first = self.vertices as i64;
        self.vertices += surface.position.len() as u64;
        let (triangles, _) = surface.index.as_chunks::<3>();
        let first_uv = (!self.uvs(part).is_empty()).then_some(first_uv as i64);
        self.blocks.rows(triangles, move |out, corners| {
            out.push(b'f');
            for &corner in corners {
                // Readers count to i32::MAX.
                let corner = i64::from(corner) + 1;
                let vertex = first + corner;
                out.push(b' ');
                number::integer(out, vertex);
                out.push(b'/');
                if let Some(first_uv) = first_uv {
                    number::integer(out, first_uv + corner);
                }
                out.push(b'/');
                number::integer(out, vertex);
            }
            out.push(b'\n');
        })
    }
}

/// As [`Instance::place`], its angle worked out once.
#[derive(Clone, Copy)]
struct Place {
    position: Vec3,
    turn: Vec2,
    scale: Vec3,
}

impl Default for Place {
    fn default() -> Self {
        Place { position: Vec3::ZERO, turn: Vec2::X, scale: Vec3::ONE }
    }
}

impl Place {
    fn of(instance: &Instance) -> Place {
        let turn = Vec2::from_angle(instance.yaw_rad);
        Place { position: instance.position, turn, scale: instance.scale }
    }

    fn point(&self, p: Vec3) -> Vec3 {
        let p = self.scale * p;
        self.position + self.turn.rotate(p.truncate()).extend(p.z)
    }

    fn normal(&self, n: Vec3) -> Vec3 {
        let n = (n / self.scale).normalize_or(Vec3::Z);
        self.turn.rotate(n.truncate()).extend(n.z)
    }
}

fn mtl(selection: &Selection<'_>, textures_of: &str) -> String {
    let mut text = format!("# {GENERATOR}\n");
    for material in &selection.materials {
        text.push_str(&newmtl(selection, material, textures_of));
    }
    text
}

fn newmtl(selection: &Selection<'_>, material: &Material, textures_of: &str) -> String {
    let path = |texture: u32| {
        let texture = &selection.scene().textures()[texture as usize];
        texture_path(textures_of, &texture.name, PictureFormat::Png)
    };
    let [r, g, b] = material.base_color;
    let mut text = format!(
        "\nnewmtl {}\nKd {r} {g} {b}\nKs 0 0 0\nd 1\nillum 1\nPr {}\nPm 0\n",
        material.name, material.roughness
    );
    let mut line = |key: &str, texture: u32| {
        // A String takes every write.
        let _ = writeln!(text, "{key} {}", path(texture));
    };
    if let Some(colour) = material.base_color_texture {
        line("map_Kd", colour);
        if matches!(material.alpha, Alpha::Mask { .. }) {
            line("map_d", colour);
        }
    }
    if let Some(normal) = material.normal_texture {
        line("map_Bump", normal);
        line("norm", normal);
    }
    if let Some((name, relief)) = material.relief() {
        let (path, deep_m) = (texture_path(textures_of, &name, PictureFormat::Png), relief.depth_m);
        let _ = writeln!(text, "disp -mm {} {deep_m} {path}", -0.5 * deep_m);
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Forms;
    use crate::scene::sample::forest;

    #[test]
    fn a_tree_stands_where_its_instance_puts_it() {
        let scene = forest(&["Larix"], 5, 30.0);
        for instance in &scene.instances {
            let place = Place::of(instance);
            let p = Vec3::new(0.3, -1.2, 7.5);
            assert_eq!(place.point(p), instance.place(p));
            // A normal stays square to what it was square to.
            let (along, normal) = (Vec3::new(1.0, 2.0, 0.5), Vec3::new(2.0, -1.0, 0.0).normalize());
            let placed = place.point(along) - place.point(Vec3::ZERO);
            let turned = place.normal(normal);
            assert!(placed.dot(turned).abs() < 1e-4 && (turned.length() - 1.0).abs() < 1e-6);
        }
    }

    #[test]
    fn what_readers_can_not_count_is_refused_before_it_is_written() {
        let mut scene = forest(&["Larix"], 1, 30.0);
        let tree = scene.instances[0].clone();
        // 8 vertices a triangle of leaves, many times the same: no memory is taken for them.
        scene.instances = (0..30_000)
            .map(|k| crate::scene::Instance {
                name: format!("tree_{k}"),
                facts: crate::scene::TreeFacts { id: k.to_string(), ..tree.facts.clone() },
                ..tree.clone()
            })
            .collect();
        let part = &mut scene.prototypes[0].parts[1].surface;
        let copies = 800;
        let (one, corners) = (part.clone(), part.position.len() as u32);
        for k in 1..copies {
            part.position.extend(&one.position);
            part.normal.extend(&one.normal);
            part.uv.extend(&one.uv);
            part.index.extend(one.index.iter().map(|i| i + k * corners));
        }
        scene.prune();
        let scene = scene.validate().unwrap();
        let error = files(Selection::of(&scene, Forms::One(0)), "wood", "wood").err().unwrap();
        insta::assert_snapshot!(format!("{error:?}"));
    }

    #[test]
    fn the_size_that_is_told_is_about_that_written() {
        let scene = forest(&["Larix", "Betula"], 200, 200.0).validate().unwrap();
        let selection = Selection::of(&scene, Forms::One(0));
        let told = Size::of(&selection).bytes() as f64;
        let made = files(selection, "wood", "wood").unwrap();
        assert!(made.warnings.is_empty());
        let written = made.value.into_iter().next().unwrap().into_bytes().len() as f64;
        assert!((told / written - 1.0).abs() < 0.25, "{told} {written}");
    }
}
