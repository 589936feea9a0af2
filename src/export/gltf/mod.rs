//! glTF 2.0 (Khronos, ISO/IEC 12113:2022), as GLB and as .gltf + .bin + textures, in three
//! profiles ([`Profile`]; docs/gltf.md says what each holds and who reads it).
//!
//! Y up is made here and nowhere else: the vertices themselves are turned, (x, y, z) → (x, z, −y),
//! a rotation by −90° about X, so no node needs a correcting turn. Parts with a normal map carry
//! tangents. A GLB holds less than 4 GiB, for its lengths are 32-bit: a larger scene is split by
//! place into several.

mod buffer;
mod cells;
mod compress;
mod document;
mod json;
mod quantize;
mod tangent;
mod variants;

use glam::Vec3;

use self::document::{Beside, Built, build};
use self::quantize::Grid;
use super::PictureFormat;
use super::{Content, OutputFile, Pictures};
use crate::diagnostic::{Error, Result, Warned};
use crate::scene::{Forms, Selection, ValidScene};

/// For whom a glTF file is.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Profile {
    /// Digital content creation: what every importer reads. No extension is required, a node a
    /// tree shares its model's mesh; one form a file.
    #[default]
    Dcc,
    /// Game engines: trees drawn together by cells, forms in one file with the share of the
    /// picture at which they change, directions and texture coordinates in fewer bits, opaque
    /// colours and normals as JPEG.
    Engine,
    /// Browsers: trees drawn together, numbers of fewer bits, compressed; WebP textures; one form
    /// a file.
    Web,
}

impl Profile {
    pub fn holds_all_forms(self) -> bool {
        self == Profile::Engine
    }

    fn has_instances(self) -> bool {
        self != Profile::Dcc
    }

    fn is_quantized(self) -> bool {
        self != Profile::Dcc
    }

    /// Engines keep models as assets, whose own size must be true: there, positions stay metres.
    fn has_counted_positions(self) -> bool {
        self == Profile::Web
    }

    fn is_compressed(self) -> bool {
        self == Profile::Web
    }

    /// How its textures are coded.
    pub fn picture_format(self) -> PictureFormat {
        match self {
            Profile::Dcc => PictureFormat::Png,
            Profile::Engine => PictureFormat::Jpeg,
            Profile::Web => PictureFormat::WebP,
        }
    }
}

/// Farthest that a vertex of a model, or of the terrain, is moved along an axis by the numbers that
/// a profile counts positions in, metres.
pub fn worst_shift_m(scene: &ValidScene, profile: Profile) -> f32 {
    if !profile.has_counted_positions() {
        return 0.0;
    }
    let selection = Selection::of(scene, Forms::All);
    let models = selection.models.iter().map(|model| {
        let parts = model.forms.iter().flat_map(|f| f.parts);
        parts.map(|p| document::grid_of(model).shift_m(&p.surface)).fold(0.0, f32::max)
    });
    let terrain = selection.terrain.map(|t| {
        let grid = Grid::around([&t.surface].into_iter());
        let is_counted = grid.error_m() <= document::MOST_TERRAIN_ERROR_M;
        if is_counted { grid.shift_m(&t.surface) } else { 0.0 }
    });
    models.chain(terrain).fold(0.0, f32::max)
}

/// Where it is said how vertices move in the wind.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum WindAs {
    /// `_WIND`, which readers that do not know it pass by.
    #[default]
    Attribute,
    /// `COLOR_0`, the one that engines' importers keep; viewers multiply the base colour and alpha
    /// with it, as the standard says.
    Color,
}

/// What to make of a selection.
#[derive(Debug, Clone, Copy)]
pub(super) struct Recipe<'a> {
    /// GLB, or .gltf and .bin.
    pub is_binary: bool,
    pub profile: Profile,
    pub wind: WindAs,
    /// Name of the file, without extension.
    pub stem: &'a str,
    /// Stem of the textures beside it.
    pub textures_of: &'a str,
    /// Most bytes of a GLB.
    pub most_bytes: u64,
}

/// What a GLB's 32-bit lengths can tell.
pub(super) const MOST_GLB_BYTES: u64 = u32::MAX as u64;

/// `STEM.glb`, or `STEM_1.glb`, `STEM_2.glb`, … where one would be too large; `STEM.gltf` and
/// `STEM.bin`, whose textures are [`Pictures::files`].
///
/// # Errors
/// A single tree too large for a GLB; compression's.
pub(super) fn files<'a>(
    selection: &Selection<'a>,
    pictures: &Pictures,
    recipe: &Recipe<'_>,
) -> Result<Warned<Vec<OutputFile<'a>>>> {
    let Recipe { stem, textures_of, .. } = *recipe;
    if !recipe.is_binary {
        let buffer = format!("{stem}.bin");
        let beside = Beside::Files { buffer: &buffer, stem: textures_of };
        let Built { mut json, body, .. } = build(selection, pictures, recipe, beside)?;
        json.push(b'\n');
        let body = Content::stream(move |sink| body.write(sink));
        return Ok(Warned::new(vec![
            OutputFile::new(format!("{stem}.gltf"), json),
            OutputFile { path: buffer.into(), content: body },
        ]));
    }
    let mut made = Vec::new();
    let mut waiting = vec![selection.clone()];
    let mut whole_bytes = None;
    while let Some(part) = waiting.pop() {
        let mut built = build(&part, pictures, recipe, Beside::Nothing)?;
        built.json.resize(built.json.len().next_multiple_of(4), b' ');
        let bytes = HEADERS + built.json.len() as u64 + built.bytes;
        whole_bytes.get_or_insert(bytes);
        if bytes <= recipe.most_bytes {
            made.push((built, bytes as u32));
            continue;
        }
        let halves = part.halves().ok_or_else(|| too_large(bytes, stem))?;
        // The first half next, so that files are numbered as places are.
        waiting.extend(halves.into_iter().rev());
    }
    let count = made.len();
    let name = |k: usize| match count {
        1 => format!("{stem}.glb"),
        _ => format!("{stem}_{}.glb", k + 1),
    };
    let files = made.into_iter().enumerate();
    let files = files.map(|(k, (built, bytes))| OutputFile {
        path: name(k).into(),
        content: Content::stream(move |sink| {
            let Built { json, body, bytes: binary } = &built;
            sink.write_all(b"glTF")?;
            // Lengths fit, for the whole does.
            for word in [2, bytes, json.len() as u32] {
                sink.write_all(&word.to_le_bytes())?;
            }
            sink.write_all(b"JSON")?;
            sink.write_all(json)?;
            sink.write_all(&(*binary as u32).to_le_bytes())?;
            sink.write_all(b"BIN\0")?;
            body.write(sink)
        }),
    });
    let files = files.collect();
    let warning = (count > 1).then(|| {
        let gib = whole_bytes.unwrap_or(0) as f64 / GIB;
        format!(
            "{stem}.glb would be {gib:.1} GiB, more than a GLB holds: split by place into {count} \
             files, {stem}_1.glb to {stem}_{count}.glb, that share one origin"
        )
    });
    Ok(Warned::with(files, warning.into_iter().collect()))
}

/// Of the file and of its two chunks.
const HEADERS: u64 = 12 + 8 + 8;
const GIB: f64 = (1u64 << 30) as f64;

/// Scene metres to Y up, for every format that has it. `0 − y` rather than `−y`, so that 0 stays without a sign.
pub(super) fn y_up(p: Vec3) -> [f32; 3] {
    [p.x, p.z, 0.0 - p.y]
}

fn too_large(bytes: u64, stem: &str) -> Error {
    let gib = bytes as f64 / GIB;
    Error::new(format!("terrain and a single tree need {gib:.1} GiB, and a GLB holds less than 4"))
        .in_file(format!("{stem}.glb"))
        .remedy("ask for fewer triangles (--triangles), or write --format gltf or usdc")
}

#[cfg(test)]
mod tests;

#[cfg(test)]
mod split_tests {
    use super::*;
    use crate::scene::Forms;
    use crate::scene::sample::forest;

    #[test]
    fn y_up_is_a_turn_that_keeps_hands() {
        let [x, y, z] = [Vec3::X, Vec3::Y, Vec3::Z].map(|p| Vec3::from(y_up(p)));
        assert_eq!((x, y, z), (Vec3::X, -Vec3::Z, Vec3::Y));
        assert_eq!(x.cross(y), z);
    }

    type Named = (String, Vec<u8>);

    fn split(most_bytes: u64) -> Result<Warned<Vec<Named>>> {
        let scene = forest(&["Larix", "Betula"], 30, 60.0).validate()?;
        let pictures = Pictures::encode(&scene, &[PictureFormat::Png])?;
        let recipe = Recipe {
            is_binary: true,
            profile: Profile::Dcc,
            wind: WindAs::Color,
            stem: "forest",
            textures_of: "forest",
            most_bytes,
        };
        let Warned { value, warnings } =
            files(&Selection::of(&scene, Forms::One(0)), &pictures, &recipe)?;
        let read = |f: OutputFile<'_>| (f.path.display().to_string(), f.into_bytes());
        Ok(Warned::with(value.into_iter().map(read).collect(), warnings))
    }

    #[test]
    fn a_scene_too_large_for_one_file_is_split_by_place() {
        let whole = split(MOST_GLB_BYTES).unwrap();
        assert_eq!((whole.value.len(), whole.warnings.len()), (1, 0));
        let most = whole.value[0].1.len() as u64;
        assert_eq!(split(most).unwrap().value.len(), 1);

        let parts = split(most * 3 / 4).unwrap();
        let names: Vec<String> =
            (1..=parts.value.len()).map(|k| format!("forest_{k}.glb")).collect();
        assert!(parts.value.iter().map(|(n, _)| n).eq(&names), "{names:?}");
        assert_eq!(
            parts.warnings,
            [format!(
                "forest.glb would be 0.0 GiB, more than a GLB holds: split by place into {n} \
                 files, forest_1.glb to forest_{n}.glb, that share one origin",
                n = names.len()
            )]
        );
        let mut trees = Vec::new();
        let mut terrains = 0;
        for (_, bytes) in &parts.value {
            assert!(bytes.len() as u64 <= most * 3 / 4);
            let (document, _, _) = ::gltf::import_slice(bytes).unwrap();
            for node in document.nodes().filter(|n| n.extras().is_some()) {
                trees.push(node.name().unwrap().to_owned());
            }
            terrains += document.nodes().filter(|n| n.name() == Some("terrain")).count();
        }
        trees.sort_unstable();
        trees.dedup();
        assert_eq!((trees.len(), terrains), (60, 1));
    }

    #[test]
    fn what_can_not_be_split_is_refused() {
        let error = split(1000).err().unwrap();
        let text = format!("{error:?}");
        assert!(text.starts_with("forest.glb: terrain and a single tree need 0.0 GiB"), "{text}");
    }
}
