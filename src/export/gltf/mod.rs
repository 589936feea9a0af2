//! glTF 2.0 (Khronos, ISO/IEC 12113:2022), as GLB and as .gltf + .bin + textures, in three
//! profiles ([`Profile`]; docs/gltf.md says what each holds and who reads it).
//!
//! Y up is made here and nowhere else: the vertices themselves are turned, (x, y, z) → (x, z, −y),
//! a rotation by −90° about X, so no node needs a correcting turn. Parts with a normal map carry
//! tangents. A larger scene than a GLB holds is split by place into several (`split`).

mod buffer;
mod cells;
mod compress;
mod crop;
mod document;
mod json;
mod quantize;
mod split;
mod tangent;
mod variants;

use std::io;

use glam::Vec3;

use self::document::{Beside, Built, build};
use self::quantize::Grid;
use super::PictureFormat;
use super::{Content, OutputFile, Pictures, Sink};
use crate::diagnostic::{Result, Warned};
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
        let Some(grid) = document::grid_of(model, profile) else { return 0.0 };
        let parts = model.forms.iter().flat_map(|f| f.parts);
        parts.map(|p| grid.shift_m(&p.surface)).fold(0.0, f32::max)
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

/// What to make of a scene.
#[derive(Debug, Clone, Copy)]
pub(super) struct Recipe<'a> {
    /// GLB, or .gltf and .bin.
    pub is_binary: bool,
    pub profile: Profile,
    pub wind: WindAs,
    /// Name of the files, without what tells forms and places apart.
    pub stem: &'a str,
    /// Most bytes of a GLB.
    pub most_bytes: u64,
}

/// What a GLB's 32-bit lengths can tell.
pub const MOST_GLB_BYTES: u64 = u32::MAX as u64;

/// The ground whose trees, or terrain, a file holds, where a scene is split.
#[derive(Debug, Clone, Copy)]
struct Square {
    /// Column and row from the south-western one.
    at: [i32; 2],
    side_m: f32,
    /// Its south-western corner, scene metres.
    corner: [f32; 2],
    /// About the whole of a terrain that is cut, so that what is counted alike meets alike.
    terrain_grid: Option<Grid>,
}

/// `STEM.glb` of each form, or `STEM_x0_y0.glb` and so on where one would be too large; `STEM.gltf`
/// and `STEM.bin`, whose textures are [`Pictures::files`]. Forms come with the suffixes of their names.
///
/// # Errors
/// What is too large for a GLB and can't be split; compression's.
pub(super) fn files<'a>(
    forms: Vec<(String, Selection<'a>)>,
    pictures: &'a Pictures,
    recipe: Recipe<'a>,
) -> Result<Warned<Vec<OutputFile<'a>>>> {
    let stem = recipe.stem;
    let mut files = Vec::new();
    if !recipe.is_binary {
        for (form, selection) in &forms {
            let buffer = format!("{stem}{form}.bin");
            let beside = Beside::Files { buffer: &buffer, stem };
            let Built { mut json, body, .. } = build(selection, pictures, &recipe, None, beside)?;
            json.push(b'\n');
            files.push(OutputFile::new(format!("{stem}{form}.gltf"), json));
            let content = Content::stream(move |sink| body.write(sink));
            files.push(OutputFile { path: buffer.into(), content });
        }
        return Ok(Warned::new(files));
    }
    for (form, selection) in &forms {
        let binary = Binary::of(selection, pictures, &recipe, None)?;
        let bytes = binary.bytes();
        if bytes > recipe.most_bytes {
            drop((binary, files));
            return split::files(&forms, (form, bytes), pictures, recipe);
        }
        let content = Content::stream(move |sink| binary.write(sink));
        files.push(OutputFile { path: format!("{stem}{form}.glb").into(), content });
    }
    Ok(Warned::new(files))
}

/// A GLB to be written.
struct Binary<'a>(Built<'a>);

impl<'a> Binary<'a> {
    fn of(
        selection: &Selection<'a>,
        pictures: &Pictures,
        recipe: &Recipe<'_>,
        square: Option<Square>,
    ) -> Result<Self> {
        let mut built = build(selection, pictures, recipe, square, Beside::Nothing)?;
        built.json.resize(built.json.len().next_multiple_of(4), b' ');
        Ok(Binary(built))
    }

    fn bytes(&self) -> u64 {
        /// Of the file and of its two chunks.
        const HEADERS: u64 = 12 + 8 + 8;
        HEADERS + self.0.json.len() as u64 + self.0.bytes
    }

    /// No more than [`MOST_GLB_BYTES`].
    fn write(&self, sink: &mut dyn Sink) -> io::Result<()> {
        let Built { json, body, bytes } = &self.0;
        sink.write_all(b"glTF")?;
        // Lengths fit, for the whole does.
        for word in [2, self.bytes() as u32, json.len() as u32] {
            sink.write_all(&word.to_le_bytes())?;
        }
        sink.write_all(b"JSON")?;
        sink.write_all(json)?;
        sink.write_all(&(*bytes as u32).to_le_bytes())?;
        sink.write_all(b"BIN\0")?;
        body.write(sink)
    }
}

/// Scene metres to Y up, for every format that has it. `0 − y` rather than `−y`, so that 0 stays without a sign.
pub(super) fn y_up(p: Vec3) -> [f32; 3] {
    [p.x, p.z, 0.0 - p.y]
}

#[cfg(test)]
mod tests;

#[cfg(test)]
mod y_up_tests {
    use super::*;

    #[test]
    fn y_up_is_a_turn_that_keeps_hands() {
        let [x, y, z] = [Vec3::X, Vec3::Y, Vec3::Z].map(|p| Vec3::from(y_up(p)));
        assert_eq!((x, y, z), (Vec3::X, -Vec3::Z, Vec3::Y));
        assert_eq!(x.cross(y), z);
    }
}
