//! A validated scene to files. Decides nothing; knows nothing but [`crate::scene`].
//!
//! [`files`] tells what files there will be and how each is written; [`write_all`] and [`Staged`]
//! put them on disk, all of them or none. Large files are streamed: none is held in memory.

mod blocks;
mod disk;
pub mod gltf;
mod number;
mod obj;
mod pictures;
pub mod usd;
mod x3d;

use std::collections::BTreeSet;
use std::io::{self, BufWriter, Seek, Write};
use std::path::PathBuf;

use bytes::Bytes;

pub use disk::{Staged, check_writable, survive_file_limits, write_all};
pub use gltf::{MOST_GLB_BYTES, Profile, WindAs};
pub use pictures::{Keeper, PictureFormat, Pictures};

use crate::diagnostic::{Error, Result, Warned};
use crate::scene::{Forms, Material, Selection, ValidScene};

/// What wrote the file, as the files say it.
const GENERATOR: &str = concat!("Larix ", env!("CARGO_PKG_VERSION"));

/// Where a file's bytes go.
pub trait Sink: Write + Seek + Send {}

impl<T: Write + Seek + Send> Sink for T {}

type Writer<'a> = dyn FnOnce(&mut dyn Sink) -> io::Result<()> + Send + 'a;

/// The bytes of a file, or what writes them.
pub enum Content<'a> {
    Bytes(Bytes),
    Stream(Box<Writer<'a>>),
}

impl<'a> Content<'a> {
    pub fn stream(write: impl FnOnce(&mut dyn Sink) -> io::Result<()> + Send + 'a) -> Self {
        Content::Stream(Box::new(write))
    }

    /// Writes all of it.
    pub fn write(self, sink: impl Sink) -> io::Result<()> {
        /// Gathers small pieces; larger ones pass by it uncopied.
        const BUFFER: usize = 1 << 16;
        let mut sink = BufWriter::with_capacity(BUFFER, sink);
        match self {
            Content::Bytes(bytes) => sink.write_all(&bytes)?,
            Content::Stream(write) => write(&mut sink)?,
        }
        sink.flush()
    }
}

impl<T: Into<Bytes>> From<T> for Content<'_> {
    fn from(bytes: T) -> Self {
        Content::Bytes(bytes.into())
    }
}

/// A file to be written.
pub struct OutputFile<'a> {
    /// Relative to the output folder.
    pub path: PathBuf,
    pub content: Content<'a>,
}

impl<'a> OutputFile<'a> {
    pub fn new(path: impl Into<PathBuf>, content: impl Into<Content<'a>>) -> Self {
        OutputFile { path: path.into(), content: content.into() }
    }

    /// What would be written.
    #[cfg(test)]
    pub fn into_bytes(self) -> Vec<u8> {
        let mut bytes = io::Cursor::new(Vec::new());
        self.content.write(&mut bytes).expect("memory takes all");
        bytes.into_inner()
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Format {
    /// Binary glTF, everything in one file.
    Glb,
    /// glTF with its buffer and textures beside it.
    Gltf,
    /// USD as text, with a layer a model and its textures beside it.
    Usda,
    /// The same as crate files.
    Usdc,
    /// USD with everything in one package.
    Usdz,
    /// X3D as XML, with its textures beside it.
    X3d,
    /// OBJ with its materials (MTL) and textures beside it.
    Obj,
}

impl Format {
    pub const ALL: [Format; 7] = [
        Format::Glb,
        Format::Gltf,
        Format::Usda,
        Format::Usdc,
        Format::Usdz,
        Format::X3d,
        Format::Obj,
    ];

    pub fn extension(self) -> &'static str {
        match self {
            Format::Glb => "glb",
            Format::Gltf => "gltf",
            Format::Usda => "usda",
            Format::Usdc => "usdc",
            Format::Usdz => "usdz",
            Format::X3d => "x3d",
            Format::Obj => "obj",
        }
    }

    /// `None` for what is no scene.
    pub fn of_extension(extension: &str) -> Option<Format> {
        Format::ALL.into_iter().find(|format| format.extension() == extension)
    }

    /// Whether it holds what not every renderer shows: wind, bodies for physics, looks, places on
    /// light maps, octahedral impostors, twigs stored once.
    pub fn holds_extras(self) -> bool {
        !matches!(self, Format::X3d | Format::Obj)
    }
}

/// What is to be written of a scene.
#[derive(Debug, Clone, Copy)]
pub struct Job<'a> {
    /// Name of the files, without extension.
    pub stem: &'a str,
    /// Those given twice count once.
    pub formats: &'a [Format],
    /// Of the glTF files, as `wind`; [`Profile::Web`] makes X3D compact, too.
    pub profile: Profile,
    pub wind: WindAs,
    /// A larger GLB is split; no more than [`MOST_GLB_BYTES`].
    pub most_glb_bytes: u64,
}

impl<'a> Job<'a> {
    /// As users who ask for nothing else get it.
    pub fn new(stem: &'a str, formats: &'a [Format]) -> Self {
        let (profile, wind) = Default::default();
        Job { stem, formats, profile, wind, most_glb_bytes: MOST_GLB_BYTES }
    }

    /// Whether a file says itself when each form is shown.
    pub fn chooses_forms(&self) -> bool {
        let is_gltf = |f: &Format| matches!(f, Format::Glb | Format::Gltf);
        let holds_all = self.profile.holds_all_forms();
        self.formats.iter().any(|f| *f == Format::X3d || holds_all && is_gltf(f))
    }

    /// How textures are coded in files of their own.
    fn pictures_beside(&self) -> BTreeSet<PictureFormat> {
        let of = |format: &Format| match format {
            Format::Glb | Format::Usdz => None,
            Format::Gltf => Some(self.profile.picture_format()),
            Format::Usda | Format::Usdc | Format::X3d | Format::Obj => Some(PictureFormat::Png),
        };
        self.formats.iter().filter_map(of).collect()
    }

    /// How textures are coded in any of the files.
    pub fn picture_formats(&self) -> Vec<PictureFormat> {
        let mut all = self.pictures_beside();
        if self.formats.contains(&Format::Glb) {
            all.insert(self.profile.picture_format());
        }
        if self.formats.contains(&Format::Usdz) {
            all.insert(PictureFormat::Png);
        }
        all.into_iter().collect()
    }
}

/// The files of a scene: `STEM.glb`, `STEM.gltf` + `STEM.bin`, `STEM.usda` or `STEM.usdc` +
/// `assets/STEM_MODEL`, `STEM.usdz`, `STEM.x3d`, `STEM.obj` + `STEM.mtl`, and the textures that
/// these refer to, each once. Where a glTF profile holds one form a file, as OBJ does, coarser forms
/// are `STEM_LOD1.glb` and so on; a GLB too large is split by place into `STEM_x0_y0.glb` and so on.
/// `pictures` must be of [`Job::picture_formats`].
///
/// # Errors
/// What is too large for a GLB and can't be split, a scene too large for a package; more vertices than
/// readers of OBJ count; twigs that are stored once, in X3D and OBJ.
pub fn files<'a>(
    scene: &'a ValidScene,
    pictures: &'a Pictures,
    job: &Job<'a>,
) -> Result<Warned<Vec<OutputFile<'a>>>> {
    let Job { stem, formats, profile, wind, most_glb_bytes } = *job;
    let has_scattered = scene.prototypes().iter().any(|p| !p.scattered.is_empty());
    if let Some(plain) = formats.iter().find(|f| has_scattered && !f.holds_extras()) {
        let told = format!(".{} files hold no twigs that are stored once", plain.extension());
        return Err(Error::new(told).remedy("merge the twigs, or write a .glb or a .usdc"));
    }
    let mut files = Vec::new();
    let mut warnings = Vec::new();
    for format in [Format::Glb, Format::Gltf].into_iter().filter(|f| formats.contains(f)) {
        let recipe = gltf::Recipe {
            is_binary: format == Format::Glb,
            profile,
            wind,
            stem,
            most_bytes: most_glb_bytes.min(MOST_GLB_BYTES),
        };
        let made = gltf::files(forms(scene, profile.holds_all_forms()), pictures, recipe)?;
        files.extend(made.value);
        warnings.extend(made.warnings);
    }
    if formats.contains(&Format::Usda) {
        files.extend(usd::layers(scene, stem, usd::Encoding::Text));
    }
    if formats.contains(&Format::Usdc) {
        files.extend(usd::layers(scene, stem, usd::Encoding::Crate));
    }
    if formats.contains(&Format::Usdz) {
        files.push(usd::package(scene, pictures, stem)?);
    }
    if formats.contains(&Format::X3d) {
        files.push(x3d::file(Selection::of(scene, Forms::Drawn), stem, profile == Profile::Web));
    }
    if formats.contains(&Format::Obj) {
        let needs_shader = |s: &Selection<'_>| {
            s.models.iter().flat_map(|m| &m.forms).any(|form| form.octahedral.is_some())
        };
        let all = forms(scene, false).into_iter();
        for (form, selection) in all.filter(|(_, selection)| !needs_shader(selection)) {
            let made = obj::files(selection, &format!("{stem}{form}"), stem)?;
            files.extend(made.value);
            warnings.extend(made.warnings);
        }
    }
    // What two formats need stands there once.
    let mut paths = BTreeSet::new();
    for kind in job.pictures_beside() {
        let files_of = pictures.files(scene, stem, kind);
        files.extend(files_of.filter(|file| paths.insert(file.path.clone())));
    }
    // A package holds its own.
    let has_loose = formats.iter().any(|&format| format != Format::Usdz);
    for (name, relief) in
        scene.materials().iter().filter(|_| has_loose).filter_map(Material::relief)
    {
        let path = pictures::texture_path(stem, &name, PictureFormat::Png);
        files.push(OutputFile::new(path, relief.image.png()?));
    }
    Ok(Warned::with(files, warnings))
}

/// Farthest that writing moves a vertex along an axis of its model, metres: 0 where the numbers of a
/// file read back as the same f32.
pub fn worst_shift_m(scene: &ValidScene, format: Format, profile: Profile) -> f32 {
    match format {
        Format::Glb | Format::Gltf => gltf::worst_shift_m(scene, profile),
        Format::X3d if profile == Profile::Web => x3d::worst_shift_m(scene),
        Format::X3d | Format::Usda | Format::Usdc | Format::Usdz | Format::Obj => 0.0,
    }
}

/// What goes into which file, by the suffix of its name.
fn forms(scene: &ValidScene, is_one_file: bool) -> Vec<(String, Selection<'_>)> {
    if is_one_file {
        return vec![(String::new(), Selection::of(scene, Forms::Drawn))];
    }
    let finest = (String::new(), Selection::of(scene, Forms::One(0)));
    let coarser = (1..)
        .zip(scene.level_names())
        .map(|(k, name)| (format!("_{name}"), Selection::of(scene, Forms::One(k))));
    std::iter::once(finest).chain(coarser).collect()
}

#[cfg(test)]
mod tests;
