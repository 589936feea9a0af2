//! The command `landscape`.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use clap::{Args, ValueEnum};
use glam::Vec3;
use serde_json::json;

use super::args::{self, Ground};
use super::jobs::method;
use super::paths::{extension, place, stem};
use super::told::{Told, summary};
use crate::diagnostic::{Error, Result};
use crate::export::{self, Content, OutputFile, Staged};
use crate::frame::Crs;
use crate::landscape::{Detail, Layers, MOST_PIXELS, Mode, Shot, View, Weather};
use crate::pipeline::landscape::{self, DETAIL};
use crate::pipeline::view::Eye;
use crate::pipeline::{Effort, SurveyJob};
use crate::raster::deep_png;
use crate::report::Recorder;
use crate::scan;
use crate::seed::Seed;
use crate::species::assign::SpeciesBy;

/// A view of all of it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Side {
    /// Northward, low over the horizon.
    North,
    /// From the south-east, as a bird.
    Oblique,
    /// From above, north up.
    Top,
}

/// How voxels are shown.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Shown {
    /// Their surface, lit.
    Surface,
    /// The greatest density on each ray's way.
    Mip,
    /// Each as a square of its size.
    Splat,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, ValueEnum)]
pub enum Layer {
    /// Distance along the camera's axis.
    Depth,
    /// Away from the surface: east, north, up.
    Normal,
    /// 2 ground, 5 vegetation, 0 nothing.
    Class,
}

#[derive(Debug, Args)]
#[command(group = clap::ArgGroup::new("to").required(true).multiple(true).args(["output", "save"]))]
pub struct Landscape {
    /// LAS, LAZ or XYZ files of one area, or a landscape made with --save.
    #[arg(required = true, value_name = "SCAN")]
    pub scans: Vec<PathBuf>,
    /// Georeferenced aerial photo that colours it: GeoTIFF, or PNG or JPEG with a world file.
    #[arg(long, value_name = "FILE")]
    pub photo: Option<PathBuf>,
    /// The scans' coordinate system, where their files state none: EPSG code, with that of the heights
    /// behind a plus where they are of another unit. It tells feet from metres.
    #[arg(long, value_name = "EPSG:CODE[+CODE]", value_parser = scan::system)]
    pub crs: Option<Crs>,
    /// How ground points are found; smrf where absent.
    #[arg(long, value_enum)]
    pub ground: Option<Ground>,
    /// Terrain cell in metres; from the density where absent.
    #[arg(long, value_name = "M", allow_negative_numbers = true, value_parser = args::above_zero::<f32>("metres"))]
    pub cell: Option<f32>,
    /// Edge of a voxel in metres; where absent the least in which the vegetation hangs together.
    #[arg(long, value_name = "M", allow_negative_numbers = true, value_parser = args::above_zero::<f32>("metres"))]
    pub voxel: Option<f32>,
    /// Bits kept of a voxel's density, 2 where absent: more make smoother surfaces of more bytes.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=4))]
    pub density_bits: Option<u32>,
    /// From X,Y,Z towards X,Y,Z in the scan's coordinates, 40 degrees high.
    #[arg(long, value_name = "X,Y,Z,X,Y,Z", allow_hyphen_values = true, value_parser = args::eye, conflicts_with = "view", requires = "output")]
    pub camera: Option<Eye>,
    /// A view of all of it.
    #[arg(long, value_enum, default_value = "oblique", requires = "output")]
    pub view: Side,
    /// Pixels of the picture.
    #[arg(long, value_name = "WxH", default_value = "1280x720", value_parser = size, requires = "output")]
    pub size: [u32; 2],
    /// Depth of fresh snow in the open, in metres.
    #[arg(long, value_name = "M", default_value_t = 0.0, allow_negative_numbers = true, value_parser = up_to(MOST_SNOW_M), requires = "output")]
    pub snow: f32,
    /// Fog that hides what is this far away, in metres; 0 for none.
    #[arg(long, value_name = "M", default_value_t = 0.0, allow_negative_numbers = true, value_parser = up_to(MOST_FOG_M), requires = "output")]
    pub fog: f32,
    /// Rain in millimetres an hour.
    #[arg(long, value_name = "MM", default_value_t = 0.0, allow_negative_numbers = true, value_parser = up_to(MOST_RAIN_MM), requires = "output")]
    pub rain: f32,
    /// Where the sun is: degrees clockwise from north, and above the horizon.
    #[arg(long, value_name = "AZIMUTH,HEIGHT", default_value = "240,44", allow_hyphen_values = true, value_parser = sun, requires = "output")]
    pub sun: Vec3,
    /// How voxels are shown.
    #[arg(long, value_enum, default_value = "surface", requires = "output")]
    pub mode: Shown,
    /// Rays a pixel. The picture is written early and refined until they are spent.
    #[arg(long, value_name = "N", default_value_t = 16, value_parser = clap::value_parser!(u32).range(1..=4096), requires = "output")]
    pub effort: u32,
    /// Further pictures beside -o, 16-bit PNG.
    #[arg(long, value_enum, value_name = "LAYER,…", value_delimiter = ',', requires = "output")]
    pub aov: Vec<Layer>,
    /// The picture (.png).
    #[arg(short, long, visible_alias = "out", value_name = "FILE")]
    pub output: Option<PathBuf>,
    /// Keep the landscape in this file (.voxels), to draw it again without the scan.
    #[arg(long, value_name = "FILE")]
    pub save: Option<PathBuf>,
}

fn size(text: &str) -> std::result::Result<[u32; 2], String> {
    let side =
        |text: &str| text.trim().parse::<u32>().ok().filter(|n| (1..=MOST_PIXELS).contains(n));
    let sides = text.split_once(['x', 'X', '×']).and_then(|(w, h)| Some([side(w)?, side(h)?]));
    sides.ok_or_else(|| format!("give width x height, each 1 to {MOST_PIXELS}, as 1280x720"))
}

/// Deeper than any snowfall, further than any eye sees, more than any cloudburst.
const MOST_SNOW_M: f32 = 10.0;
const MOST_FOG_M: f32 = 1e6;
const MOST_RAIN_MM: f32 = 500.0;

fn up_to(most: f32) -> impl Fn(&str) -> std::result::Result<f32, String> + Clone {
    move |text| {
        let value = text.parse::<f32>().ok().filter(|v| (0.0..=most).contains(v));
        value.ok_or_else(|| format!("give a number from 0 to {most}"))
    }
}

fn sun(text: &str) -> std::result::Result<Vec3, String> {
    let number = |text: &str| text.trim().parse::<f32>().ok().filter(|v| v.is_finite());
    let angles = text.split_once(',').and_then(|(a, h)| Some((number(a)?, number(h)?)));
    match angles {
        Some((azimuth, height)) if (1.0..=90.0).contains(&height) => {
            let ((sa, ca), (sh, ch)) =
                (azimuth.to_radians().sin_cos(), height.to_radians().sin_cos());
            Ok(Vec3::new(sa * ch, ca * ch, sh))
        }
        _ => {
            Err("give degrees clockwise from north, and 1 to 90 above the horizon, as 240,44"
                .into())
        }
    }
}

/// Pictures are written again while they are refined, but no more often.
const BETWEEN: Duration = Duration::from_secs(2);

pub(super) fn run(a: &Landscape, run: &mut Recorder) -> Result<Told> {
    if let Some(output) = &a.output {
        extension(output, &["png"])?;
        export::check_writable(&place(output)?.0)?;
    }
    if let Some(save) = &a.save {
        extension(save, &["voxels"])?;
        export::check_writable(&place(save)?.0)?;
    }
    let weather = [("--snow", a.snow), ("--fog", a.fog), ("--rain", a.rain)];
    let falling = weather.iter().find(|(_, amount)| *amount > 0.0);
    if let Some((option, _)) = falling.filter(|_| a.mode == Shown::Mip) {
        return Err(Error::new("--mode mip shows densities, which no weather changes")
            .remedy(format!("leave out {option}, or --mode mip")));
    }
    spare_inputs(a)?;
    let is_saved = landscape::is_saved(&a.scans)?;
    let of_scans = [
        ("--photo", a.photo.is_some()),
        ("--crs", a.crs.is_some()),
        ("--ground", a.ground.is_some()),
        ("--cell", a.cell.is_some()),
        ("--voxel", a.voxel.is_some()),
        ("--density-bits", a.density_bits.is_some()),
    ];
    if let Some((option, _)) = of_scans.iter().find(|(_, given)| is_saved && *given) {
        return Err(Error::new("a saved landscape keeps its voxels, terrain and colours")
            .in_file(&a.scans[0])
            .remedy(format!("leave out {option}, or give the scan")));
    }
    let scene = if is_saved {
        landscape::load(&a.scans[0], run)?
    } else {
        let density_bits = a.density_bits.unwrap_or(DETAIL.density_bits);
        let detail = Detail { density_bits, ..DETAIL };
        landscape::build(&job(a), &detail, run)?
    };
    let eye = a.camera.as_ref().filter(|_| a.output.is_some());
    let camera = eye.map(|eye| landscape::camera(&scene, eye, a.size)).transpose()?;
    let mut lines = Vec::new();
    let mut told = json!({
        "layers": {},
        "voxels": scene.voxels(),
        "voxel_m": scene.voxel_m(),
        "bytes": scene.memory().total(),
        "voxel_bytes": scene.memory().voxels,
        "height_bytes": scene.memory().heights,
        "colour_bytes": scene.memory().colours,
    });
    if let Some(save) = &a.save {
        let (dir, name) = place(save)?;
        let mut staged = Staged::new(&dir)?;
        let content = Content::stream(|mut sink| scene.write(&mut sink));
        let bytes = staged.add(vec![OutputFile::new(name, content)])?;
        staged.commit()?;
        lines.push(format!("{} ({:.2} MB)", save.display(), bytes as f64 / 1e6));
        told["file_bytes"] = json!(bytes);
    }
    if let Some(output) = &a.output {
        let [width, height] = a.size;
        let aspect = width as f32 / height as f32;
        let camera = camera.unwrap_or_else(|| scene.camera(side(a.view), aspect));
        let shot = Shot {
            effort: a.effort,
            mode: mode(a.mode),
            weather: Weather { snow_m: a.snow, fog_m: a.fog, rain_mm: a.rain },
            sun: a.sun,
            ..Shot::new(camera, a.size)
        };
        let (dir, name) = place(output)?;
        let mut written: Option<Instant> = None;
        let picture = landscape::draw(&scene, &shot, run, |picture, _| {
            if written.is_none_or(|at| at.elapsed() >= BETWEEN) {
                export::write_all(&dir, vec![OutputFile::new(&name, picture.to_png()?)])?;
                written = Some(Instant::now());
            }
            Ok(true)
        })?;
        let mut files = vec![OutputFile::new(&name, picture.to_png()?)];
        lines.push(output.display().to_string());
        if !a.aov.is_empty() {
            let layers = landscape::layers(&scene, &shot, run)?;
            let mut asked = a.aov.clone();
            asked.sort_unstable();
            asked.dedup();
            for layer in asked {
                let (path, (png, note)) = (layer.file(output), encoded(layer, &layers)?);
                lines.push(format!("{}: {note}", dir.join(&path).display()));
                told["layers"][&path] = json!(note);
                files.push(OutputFile::new(path, png));
            }
        }
        export::write_all(&dir, files)?;
    }
    let mut json = summary("landscape", None, run, None);
    json["landscape"] = told;
    Ok(Told { lines, json })
}

/// No file that is read may be written.
fn spare_inputs(a: &Landscape) -> Result<()> {
    let layers = a.aov.iter().zip(a.output.iter().cycle());
    let layers = layers.map(|(layer, output)| output.with_file_name(layer.file(output)));
    let written: Vec<PathBuf> = a.output.iter().chain(&a.save).cloned().chain(layers).collect();
    for input in a.scans.iter().chain(&a.photo) {
        let is_input = |path: &&PathBuf| match (path.canonicalize(), input.canonicalize()) {
            (Ok(path), Ok(input)) => path == input,
            _ => false,
        };
        if let Some(path) = written.iter().find(is_input) {
            return Err(Error::new("is read, and would be written over")
                .in_file(path)
                .remedy("give -o or --save another name"));
        }
    }
    Ok(())
}

impl Layer {
    /// Its name beside the picture.
    fn file(self, output: &Path) -> String {
        let kind = match self {
            Layer::Depth => "depth",
            Layer::Normal => "normal",
            Layer::Class => "class",
        };
        format!("{}_{kind}.png", stem(output))
    }
}

fn job(a: &Landscape) -> SurveyJob {
    SurveyJob {
        scans: scan::Files { paths: a.scans.clone(), crs: a.crs.clone() },
        ground: method(a.ground.unwrap_or(Ground::Smrf)),
        cell_m: a.cell,
        photo: a.photo.clone(),
        tile_m: None,
        species: Vec::new(),
        species_by: SpeciesBy::Auto,
        voxel_m: a.voxel,
        min_height_m: 2.0,
        effort: Effort::Normal,
        seed: Seed::new(1),
    }
}

fn side(view: Side) -> View {
    match view {
        Side::North => View::North,
        Side::Oblique => View::Oblique,
        Side::Top => View::Top,
    }
}

fn mode(shown: Shown) -> Mode {
    match shown {
        Shown::Surface => Mode::Surface,
        Shown::Mip => Mode::Densest,
        Shown::Splat => Mode::Splat,
    }
}

/// A layer as PNG, and how to read its numbers.
fn encoded(layer: Layer, layers: &Layers) -> Result<(Vec<u8>, String)> {
    let [width, height] = layers.size;
    /// Nothing is there.
    const NOTHING: u16 = u16::MAX;
    match layer {
        Layer::Depth => {
            let seen = layers.depth_m.iter().copied().filter(|d| d.is_finite());
            let far = seen.fold(0.0f32, f32::max).max(1e-6);
            let most = f32::from(NOTHING - 1);
            let sample = |d: &f32| match d.is_finite() {
                true => (d / far * most).round() as u16,
                false => NOTHING,
            };
            let samples = layers.depth_m.iter().map(sample).collect();
            let note = format!("metres = value × {}; {NOTHING} is nothing", far / most);
            Ok((deep_png(width, height, samples)?, note))
        }
        Layer::Normal => {
            let part = |v: f32| ((v * 0.5 + 0.5) * f32::from(u16::MAX)).round() as u16;
            let samples = layers.normal.iter().flat_map(|n| n.to_array().map(part)).collect();
            let note = "east, north, up = value / 32767.5 − 1; grey is nothing".to_owned();
            Ok((deep_png(width, height, samples)?, note))
        }
        Layer::Class => {
            let samples = layers.class.iter().map(|c| u16::from(*c)).collect();
            let note = "2 ground, 5 vegetation, 0 nothing".to_owned();
            Ok((deep_png(width, height, samples)?, note))
        }
    }
}
