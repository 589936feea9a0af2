//! Arguments as typed.

use std::ops::RangeInclusive;
use std::path::PathBuf;
use std::str::FromStr;

use clap::{Args, Parser, Subcommand, ValueEnum};
use glam::{DVec3, Vec2};

use crate::frame::Crs;
use crate::pipeline::view::{Clip, Eye};
use crate::scan;
use crate::skeleton::STAGES;
use crate::species::state::{Condition, Season};

/// Vertical angle of view of `--camera`.
const FOV_DEG: f32 = 40.0;

/// From a laser scan of a forest to a forest scene an artist can open.
#[derive(Debug, Parser)]
#[command(name = "larix", version, max_term_width = 100, arg_required_else_help = true)]
#[command(
    after_help = "Examples:\n  larix demo\n  larix forest scan.laz --photo photo.tif -o out\n  \
                        larix tree larix_sibirica --height 22 -o larch.glb"
)]
pub struct Cli {
    #[command(subcommand)]
    pub command: Command,
    /// Worker threads; all cores where absent. The output does not depend on it.
    #[arg(long, global = true, value_name = "N", allow_negative_numbers = true, value_parser = clap::value_parser!(u16).range(1..))]
    pub threads: Option<u16>,
    /// Print errors only; of lists and tables, the bare lines.
    #[arg(long, short, global = true)]
    pub quiet: bool,
    /// Make textures and impostors and measure levels anew, instead of keeping all that in the user's
    /// cache folder. The output does not depend on it.
    #[arg(long, global = true)]
    pub no_cache: bool,
    /// Print the result as JSON to standard output: a run's report, a species command's answer.
    #[arg(long, global = true)]
    pub json: bool,
}

#[derive(Debug, Subcommand)]
pub enum Command {
    /// Simulate a stand with known truth, survey it, rebuild it and compare.
    #[command(after_help = "Example:\n  larix demo -o output/demo")]
    Demo(Demo),
    /// Scan to forest scene: terrain, every tree in its place, glTF and USD.
    #[command(
        after_help = "Example:\n  larix forest north.laz south.laz --photo ortho.tif -o out \
                            --format glb,usda --species larix_sibirica,betula_pendula"
    )]
    Forest(Forest),
    /// Scan to a table of trees, one polygon each.
    #[command(after_help = "Example:\n  larix inventory scan.laz -o trees.geojson")]
    Inventory(Inventory),
    /// Scan to terrain: a raster of heights, or a mesh within a stated error of it.
    #[command(after_help = "Example:\n  larix terrain scan.laz --cell 0.5 -o dtm.tif\n  \
                            larix terrain scan.laz --terrain-error 0.1 -o dtm.glb")]
    Terrain(Terrain),
    /// Grow one tree from a species rule file; no scan needed.
    #[command(
        after_help = "Example:\n  larix tree betula_pendula --height 18 --seed 3 -o birch.glb"
    )]
    Tree(Tree),
    /// Scan to a voxel landscape and ray-traced pictures of it, with snow, fog and rain.
    #[command(
        after_help = "Examples:\n  larix landscape scan.laz --photo ortho.tif --snow 0.1 -o winter.png\n  \
                      larix landscape scan.laz --save scan.voxels\n  \
                      larix landscape scan.voxels --view north --fog 400 -o fog.png"
    )]
    Landscape(super::landscape::Landscape),
    /// What accuracy costs, what converges, what stays stable, what is left out, how it grows: one
    /// page, measured on the spot.
    #[command(after_help = "Examples:\n  larix report\n  larix report --quick -o out\n  \
                            larix report scan.laz --photo ortho.tif -o out")]
    Report(super::report::Report),
    /// Write rule files: begin one, check it, see it, derive it; list those built in.
    #[command(after_help = "Example:\n  larix species new my_birch --from betula_pendula\n  \
                      larix species check --watch my_birch.toml")]
    Species(Species),
}

/// Where the ground comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Ground {
    /// Simple morphological filter (Pingel 2013).
    Smrf,
    /// Progressive densification of a triangulation (Axelsson 2000).
    Tin,
    /// The voxel rules of the source.
    Voxel,
    /// Class 2 of the file.
    File,
}

/// How branches join their parents.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum JoinedBy {
    /// Out of holes in the parent's bark.
    Weld,
    /// Closed tubes pass through each other.
    Intersect,
}

/// How twigs are stored.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum TwigsAs {
    /// In one mesh, within --triangles.
    Merge,
    /// Each form once, and the places where it stands.
    Instance,
}

/// Time against error.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Effort {
    /// Coarser terrain, no lower storey.
    Fast,
    Normal,
    /// Finer terrain, crowns from several grids.
    Best,
}

/// What stands for the leaves.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Foliage {
    /// Every leaf with its petiole, every needle.
    Geometry,
    /// A card with its picture for every twig.
    Cards,
    /// Few enlarged cards.
    Sparse,
    /// One closed hull of the crown.
    Shell,
    /// Bare trees.
    None,
}

/// What tells the species of a tree.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum SpeciesBy {
    /// The photo's luminance where it bears out the species' ranges, else the shape.
    Auto,
    /// The photo's luminance.
    Luminance,
    /// Shape of the crown, brightness of its returns, unevenness in the photo.
    Shape,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Format {
    /// One binary glTF file.
    Glb,
    /// .gltf, .bin and textures.
    Gltf,
    /// USD as text, a layer a model, and textures.
    Usda,
    /// The same in binary layers.
    Usdc,
    /// USD with everything in one file.
    Usdz,
    /// X3D (XML) and textures; compact with --profile web.
    X3d,
    /// OBJ with every tree written out, MTL and textures.
    Obj,
}

/// How many models the trees share.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Unique {
    /// Each tree is grown for itself.
    All,
    /// So many models a species.
    Shared(usize),
}

fn unique(text: &str) -> Result<Unique, String> {
    match text {
        "all" => Ok(Unique::All),
        n => match n.parse() {
            Ok(n @ 1..=1000) => Ok(Unique::Shared(n)),
            _ => Err("give `all` or a number of models a species from 1 to 1000".into()),
        },
    }
}

fn texture_px(text: &str) -> Result<u32, String> {
    match text.parse::<u32>() {
        Ok(px) if px == 0 || (64..=4096).contains(&px) && px.is_multiple_of(2) => Ok(px),
        _ => Err("give an even number of pixels from 64 to 4096, or 0 for none".into()),
    }
}

fn seed(text: &str) -> Result<u64, String> {
    text.parse().map_err(|_| format!("give a whole number from 0 to {}", u64::MAX))
}

/// Reads a number of metres within `range`.
fn within(range: RangeInclusive<f32>) -> impl Fn(&str) -> Result<f32, String> + Clone {
    move |text| match text.parse() {
        Ok(value) if range.contains(&value) => Ok(value),
        _ => Err(format!("give a number from {} to {}, in metres", range.start(), range.end())),
    }
}

/// Reads a finite number of `units` above 0.
pub(super) fn above_zero<N>(units: &'static str) -> impl Fn(&str) -> Result<N, String> + Clone
where
    N: FromStr + Into<f64> + Copy,
{
    move |text| match text.parse::<N>() {
        Ok(value) if value.into() > 0.0 && value.into().is_finite() => Ok(value),
        _ => Err(format!("give a number greater than 0, in {units}")),
    }
}

fn place(text: &str) -> Result<Vec2, String> {
    let numbers: Vec<f32> = text.split(',').filter_map(|n| n.trim().parse().ok()).collect();
    match numbers[..] {
        [x, y] if text.matches(',').count() == 1 && (0.3..=1000.0).contains(&x.hypot(y)) => {
            Ok(Vec2::new(x, y))
        }
        _ => Err("give two numbers, metres east and north, 0.3 to 1000 m away: 3,-1.5".into()),
    }
}

fn numbers<const N: usize>(text: &str) -> Option<[f64; N]> {
    let parsed: Result<Vec<f64>, _> = text.split(',').map(|n| n.trim().parse::<f64>()).collect();
    let numbers: [f64; N] = parsed.ok()?.try_into().ok()?;
    numbers.iter().all(|n| n.is_finite()).then_some(numbers)
}

pub(super) fn eye(text: &str) -> Result<Eye, String> {
    let refusal = || "give where the eye is and what it looks at: X,Y,Z,X,Y,Z".to_owned();
    let [x, y, z, to_x, to_y, to_z] = numbers(text).ok_or_else(refusal)?;
    let (at, look) = (DVec3::new(x, y, z), DVec3::new(to_x, to_y, to_z));
    if at.distance(look) < 0.01 {
        return Err("the eye looks at itself: give two places".into());
    }
    Ok(Eye { at, look, fov_deg: FOV_DEG })
}

fn clip(text: &str) -> Result<Clip, String> {
    match numbers(text) {
        Some([west, south, east, north]) if west < east && south < north => {
            Ok(Clip { west, south, east, north })
        }
        _ => Err("give WEST,SOUTH,EAST,NORTH in the scan's coordinates, growing".into()),
    }
}

/// The scans, and how they are read as terrain.
#[derive(Debug, Args)]
pub struct ScanArgs {
    /// LAS, LAZ or XYZ files of one area.
    #[arg(required = true, value_name = "SCAN")]
    pub scans: Vec<PathBuf>,
    /// The scans' coordinate system, where their files state none: EPSG code, with that of the heights
    /// behind a plus where they are of another unit. It tells feet from metres.
    #[arg(long, value_name = "EPSG:CODE[+CODE]", value_parser = scan::system)]
    pub crs: Option<Crs>,
    /// How ground points are found.
    #[arg(long, value_enum, default_value = "smrf")]
    pub ground: Ground,
    /// Terrain cell in metres; from the density where absent.
    #[arg(long, value_name = "M", allow_negative_numbers = true, value_parser = within(0.01..=100.0))]
    pub cell: Option<f32>,
    /// Work through the scan in tiles of this side in metres (steps of 64, at least 128). Half a
    /// gigabyte of points is held, what is more waits in a temporary file. Scans of more than 30 million
    /// points, or with wide gaps, go so by themselves.
    #[arg(long, value_name = "M", allow_negative_numbers = true, value_parser = within(128.0..=100_000.0))]
    pub tile: Option<f32>,
}

/// How trees are told apart and named.
#[derive(Debug, Args)]
pub struct TreeArgs {
    /// Georeferenced aerial photo: GeoTIFF, or PNG or JPEG with a world file beside it.
    #[arg(long, value_name = "FILE", required_if_eq("species_by", "luminance"))]
    pub photo: Option<PathBuf>,
    /// Species to choose among, comma separated; `larix species list` shows them.
    #[arg(long, value_name = "A,B,…", value_delimiter = ',')]
    pub species: Vec<String>,
    /// What tells the species: the photo's luminance, or the crown's shape and the brightness of
    /// its returns; `auto` takes the luminance where the photo bears out the species' ranges.
    #[arg(long, value_enum, default_value = "auto")]
    pub species_by: SpeciesBy,
    /// Voxel in metres; from the density where absent.
    #[arg(long, value_name = "M", allow_negative_numbers = true, value_parser = within(0.01..=20.0))]
    pub voxel: Option<f32>,
    /// How much time may be taken for how small an error.
    #[arg(long, value_enum, default_value = "normal")]
    pub effort: Effort,
    /// Trees lower than this are left out.
    #[arg(long, value_name = "M", default_value = "2", allow_negative_numbers = true, value_parser = above_zero::<f32>("metres"))]
    pub min_height: f32,
    /// Same seed, same bytes.
    #[arg(long, default_value_t = 1, allow_negative_numbers = true, value_parser = seed)]
    pub seed: u64,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Impostor {
    None,
    /// Two upright sheets that cross; any renderer shows them.
    Cross,
    /// Views from all sides and from above, for shaders that blend them.
    Octahedral,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Collision {
    None,
    /// One capsule, `UCP_…`.
    Capsule,
    /// Convex bodies along the stem, `UCX_…`.
    Convex,
}

/// Whose channels the vertex colours of wind are.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Wind {
    None,
    Unity,
    Cryengine,
    SpeedtreeLike,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum WindAs {
    Attribute,
    Color,
}

/// For whom glTF files are.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Profile {
    /// Blender and its like: what every importer reads.
    Dcc,
    /// Game engines: instances by cells, levels in one file, numbers of 16 and 8 bits; with
    /// `--lods 3 --impostor cross --collision convex --wind unity` unless given otherwise.
    Engine,
    /// Browsers: instances, meshopt compression, WebP textures.
    Web,
}

/// Forms of the trees beside the finest, and how they are written.
#[derive(Debug, Args)]
pub struct LevelArgs {
    /// For whom glTF files are.
    #[arg(long, value_enum, value_name = "PROFILE", default_value = "dcc")]
    pub profile: Profile,
    /// Coarser levels of detail, in files beside (in one with --profile engine): NAME_LOD1,
    /// NAME_LOD2, NAME_LOD3, and NAME_LOD4, which is two cones and a cylinder.
    #[arg(long, value_name = "N", allow_negative_numbers = true, value_parser = clap::value_parser!(u8).range(0..=4))]
    pub lods: Option<u8>,
    /// Each model as pictures of itself, in a file beside: NAME_impostor.
    #[arg(long, value_enum, value_name = "KIND")]
    pub impostor: Option<Impostor>,
    /// Views along a side of an octahedral impostor's picture, 4 to 32; 8 where absent. An odd number has
    /// one from above.
    #[arg(long, value_name = "N", allow_negative_numbers = true, value_parser = clap::value_parser!(u32).range(4..=32))]
    pub impostor_views: Option<u32>,
    /// Bodies about the stems for collisions, beside each tree in the scene.
    #[arg(long, value_enum, value_name = "KIND")]
    pub collision: Option<Collision>,
    /// How each vertex moves in the wind, in the channels that shaders of this kind read.
    #[arg(long, value_enum, value_name = "PROFILE")]
    pub wind: Option<Wind>,
    /// Where glTF says so: the attribute _WIND, or COLOR_0, which engines keep and with which viewers
    /// tint the trees.
    #[arg(long, value_enum, value_name = "PLACE", default_value = "attribute")]
    pub wind_as: WindAs,
    /// A second set of texture coordinates without overlaps, for light maps (TEXCOORD_1,
    /// primvars:st1); their charts are for a map of at most PX texels a side. Needs a program built with
    /// the feature `atlas`.
    #[arg(long, value_name = "PX", num_args = 0..=1, require_equals = true, default_missing_value = "1024", value_parser = clap::value_parser!(u32).range(256..=8192))]
    pub lightmap_uv: Option<u32>,
}

/// How the scene is built and written.
#[derive(Debug, Args)]
pub struct SceneArgs {
    /// `all` grows each tree for itself; a number shares so many models a species.
    #[arg(long, value_name = "N|all", value_parser = unique, default_value = "5")]
    pub unique: Unique,
    /// Most triangles of one tree model, 200 to 10000000; 5000 where absent, 200000 with --foliage
    /// geometry.
    #[arg(long, value_name = "N", allow_negative_numbers = true, value_parser = clap::value_parser!(u32).range(200..=10_000_000))]
    pub triangles: Option<u32>,
    /// Most triangles of all trees in their places, 1000 or more, shared out by size; with --camera by
    /// distance.
    #[arg(long, value_name = "N", allow_negative_numbers = true, value_parser = clap::value_parser!(u64).range(1000..=1_000_000_000_000))]
    pub scene_triangles: Option<u64>,
    /// Keep what lies in this box, in the scan's coordinates.
    #[arg(long, value_name = "WEST,SOUTH,EAST,NORTH", allow_hyphen_values = true, value_parser = clip)]
    pub clip: Option<Clip>,
    /// Keep what is seen from X,Y,Z towards X,Y,Z in the scan's coordinates (40 degrees high): trees
    /// out of sight are left out, far ones become coarse.
    #[arg(long, value_name = "X,Y,Z,X,Y,Z", allow_hyphen_values = true, value_parser = eye)]
    pub camera: Option<Eye>,
    /// What stands for the leaves.
    #[arg(long, value_enum, value_name = "LEVEL", default_value = "cards")]
    pub foliage: Foliage,
    #[command(flatten)]
    pub wood: WoodArgs,
    /// How near the terrain's triangles keep to its heights, in metres.
    #[arg(long, value_name = "M", default_value = "0.05", allow_negative_numbers = true, value_parser = above_zero::<f32>("metres"))]
    pub terrain_error: f32,
    /// Side of the tree textures in pixels, 64 to 4096; 0 for none: bark and leaves in a colour each.
    #[arg(long, value_name = "PX", default_value_t = 512, allow_negative_numbers = true, value_parser = texture_px)]
    pub texture: u32,
    /// Heights of the bark, too, for those who displace: pictures in `textures` beside the scene.
    #[arg(long)]
    pub height_maps: bool,
    #[command(flatten)]
    pub state: StateArgs,
    #[command(flatten)]
    pub levels: LevelArgs,
    /// Files to write, comma separated.
    #[arg(long, value_enum, value_delimiter = ',', default_value = "glb,usda")]
    pub format: Vec<Format>,
    /// Largest GLB in megabytes, 4294 where absent; a scene that needs more is split by place.
    #[arg(long, value_name = "MB", allow_negative_numbers = true, value_parser = above_zero::<f64>("megabytes"))]
    pub largest_glb: Option<f64>,
}

/// How the trees stand.
#[derive(Debug, Args)]
pub struct StateArgs {
    /// Condition of the trees on the sanitary scale: I healthy, II and III weakened, IV dying, V dead
    /// this year, VI dead for long. Numbers do as well.
    #[arg(long, value_name = "I…VI", default_value = "I", allow_negative_numbers = true)]
    pub condition: Condition,
    /// spring, summer, autumn (or fall) or winter.
    #[arg(long, value_name = "SEASON", default_value = "summer")]
    pub season: Season,
    /// Leaves in the colours of other seasons and conditions, too: as glTF material variants, and as the
    /// USD variant set `look`.
    #[arg(long)]
    pub variants: bool,
}

/// How the wood is meshed.
#[derive(Debug, Args)]
pub struct WoodArgs {
    /// How branches join: `weld` makes one closed surface of a stem and all that springs from it,
    /// `intersect` is cheaper: tubes pass through each other.
    #[arg(long, value_enum, value_name = "HOW", default_value = "weld")]
    pub junctions: JoinedBy,
    /// How far a tree's silhouette may be off, in metres RMS, 0.00001 to 1: it takes the fewest triangles that
    /// keep to it, up to --triangles (then 100000 where absent, 1000000 with --foliage geometry). With
    /// --camera, far trees may be off by a pixel.
    #[arg(long, value_name = "M", allow_negative_numbers = true, value_parser = within(1e-5..=1.0))]
    pub tolerance: Option<f32>,
}

#[derive(Debug, Args)]
pub struct Demo {
    /// Folder for everything written.
    #[arg(short, long, value_name = "DIR", default_value = "output/demo")]
    pub output: PathBuf,
    /// Trees of the stand.
    #[arg(long, default_value_t = 240, allow_negative_numbers = true, value_parser = clap::value_parser!(u32).range(1..=20_000))]
    pub trees: u32,
    #[arg(long, default_value_t = 1, allow_negative_numbers = true, value_parser = seed)]
    pub seed: u64,
    #[command(flatten)]
    pub scene: SceneArgs,
}

#[derive(Debug, Args)]
pub struct Forest {
    #[command(flatten)]
    pub scan: ScanArgs,
    #[command(flatten)]
    pub tree: TreeArgs,
    #[command(flatten)]
    pub scene: SceneArgs,
    #[command(flatten)]
    pub goal: GoalArgs,
    /// Folder for everything written, made where it is missing; `output/` and the scan's name where absent.
    #[arg(short, long, value_name = "DIR")]
    pub output: Option<PathBuf>,
}

/// What a run is to reach; settings follow from a measured front.
#[derive(Debug, Args)]
pub struct GoalArgs {
    /// The cheapest settings whose terrain (held out) and crowns (points to wood, mean) are off by no
    /// more than this, in metres.
    #[arg(long, value_name = "M", allow_negative_numbers = true, value_parser = above_zero::<f64>("metres"),
        conflicts_with_all = ["time", "effort", "tolerance", "triangles", "unique", "scene_triangles"])]
    pub error: Option<f64>,
    /// The settings with the least such error that take no longer than this, in seconds.
    #[arg(long, value_name = "S", allow_negative_numbers = true, value_parser = above_zero::<f64>("seconds"),
        conflicts_with_all = ["effort", "tolerance", "triangles", "unique", "scene_triangles"])]
    pub time: Option<f64>,
}

#[derive(Debug, Args)]
pub struct Inventory {
    #[command(flatten)]
    pub scan: ScanArgs,
    #[command(flatten)]
    pub tree: TreeArgs,
    /// .geojson, .fgb (FlatGeobuf) or .csv; a missing folder is made
    #[arg(short, long, value_name = "FILE")]
    pub output: PathBuf,
}

#[derive(Debug, Args)]
pub struct Terrain {
    #[command(flatten)]
    pub scan: ScanArgs,
    /// How near a mesh keeps to every height of the raster, in metres; 0.05 where absent. With it
    /// the triangles that each error takes are told for a raster too.
    #[arg(long, value_name = "M", allow_negative_numbers = true, value_parser = above_zero::<f32>("metres"))]
    pub terrain_error: Option<f32>,
    /// .tif (Cloud Optimized GeoTIFF) for heights; .glb, .gltf, .usda, .usdc, .usdz, .x3d or .obj for a
    /// mesh; a missing folder is made
    #[arg(short, long, value_name = "FILE")]
    pub output: PathBuf,
}

#[derive(Debug, Args)]
pub struct Tree {
    /// A name from `larix species list`, or a rule file.
    pub species: String,
    /// Height in metres; the species' typical height where absent.
    #[arg(long, value_name = "M", allow_negative_numbers = true, value_parser = above_zero::<f32>("metres"))]
    pub height: Option<f32>,
    /// Height by the species' growth in so many years.
    #[arg(long, value_name = "YEARS", allow_negative_numbers = true, value_parser = above_zero::<f32>("years"), conflicts_with = "height")]
    pub age: Option<f32>,
    /// The same tree as it stood at stage 1 to 12 of its life; each stage holds the one before.
    #[arg(long, value_name = "K", allow_negative_numbers = true, value_parser = clap::value_parser!(u16).range(1..=i64::from(STAGES)))]
    pub stage: Option<u16>,
    /// An upright wall through X,Y metres east and north of the stem, square to the way there.
    #[arg(long, value_name = "X,Y", allow_hyphen_values = true, value_parser = place, conflicts_with = "cloud")]
    pub wall: Vec<Vec2>,
    /// A tree like this one at X,Y metres east and north, whose crown is left free.
    #[arg(long, value_name = "X,Y", allow_hyphen_values = true, value_parser = place, conflicts_with = "cloud")]
    pub neighbour: Vec<Vec2>,
    /// A scan of one tree, from the ground or the air, to fit the tree to (.las, .laz, .xyz).
    #[arg(long, value_name = "SCAN", conflicts_with_all = ["height", "age", "stage"])]
    pub cloud: Option<PathBuf>,
    #[arg(long, default_value_t = 1, allow_negative_numbers = true, value_parser = seed)]
    pub seed: u64,
    /// Most triangles, 200 to 40000000; 20000 where absent, 1000000 with --foliage geometry.
    #[arg(long, value_name = "N", allow_negative_numbers = true, value_parser = clap::value_parser!(u32).range(200..=40_000_000))]
    pub triangles: Option<u32>,
    /// Side of the textures in pixels, 64 to 4096; 0 for none: bark and leaves in a colour each.
    #[arg(long, value_name = "PX", default_value_t = 1024, allow_negative_numbers = true, value_parser = texture_px)]
    pub texture: u32,
    /// Heights of the bark, too, for those who displace: pictures in `textures` beside the scene.
    #[arg(long)]
    pub height_maps: bool,
    #[command(flatten)]
    pub state: StateArgs,
    /// What stands for the leaves.
    #[arg(long, value_enum, value_name = "LEVEL", default_value = "cards")]
    pub foliage: Foliage,
    /// Without leaves: --foliage none.
    #[arg(long, conflicts_with = "foliage")]
    pub bare: bool,
    /// How twigs of --foliage geometry, or of the species' own model, are stored: `instance` is for
    /// close-ups: every leaf and needle at its size, a few forms of twigs in a small file, and
    /// --triangles counts what is stored.
    #[arg(long, value_enum, value_name = "HOW", default_value = "merge")]
    pub twigs: TwigsAs,
    #[command(flatten)]
    pub wood: WoodArgs,
    #[command(flatten)]
    pub levels: LevelArgs,
    /// .glb, .gltf, .usda, .usdc, .usdz, .x3d, .obj or .png (a picture); a missing folder is made
    #[arg(short, long, value_name = "FILE")]
    pub output: PathBuf,
}

#[derive(Debug, Args)]
pub struct Species {
    #[command(subcommand)]
    pub command: SpeciesCommand,
}

#[derive(Debug, Subcommand)]
pub enum SpeciesCommand {
    /// The built-in species and what each builds on; --quiet: one name a line.
    #[command(after_help = "Example:\n  larix species list --quiet")]
    List,
    /// What a rule derives to: modules, draws, brackets, length, nodes.
    #[command(after_help = "Example:\n  larix species derive table3/05 --json\n  \
                      larix species derive --all")]
    Derive(Derive),
    /// Check rule files: that they read, derive and grow a tree. Exit code 1 if any does not.
    #[command(after_help = "Example:\n  larix species check --watch my_birch.toml")]
    Check(Check),
    /// Begin a rule file: every key, explained, growing a tree as it stands.
    #[command(after_help = "Example:\n  larix species new my_birch --from betula_pendula")]
    New(New),
    /// JSON schema of rule files, for editors that complete and check TOML.
    #[command(after_help = "Example:\n  larix species schema -o larix.schema.json")]
    Schema(Schema),
    /// A contact sheet: three trees in leaf and bare, with a person of 1.8 m beside each.
    #[command(after_help = "Example:\n  larix species show larix_sibirica -o sheet.png")]
    Show(Show),
}

#[derive(Debug, Args)]
pub struct Derive {
    /// Names from `larix species list`, or rule files.
    #[arg(required_unless_present = "all", value_name = "NAME|FILE")]
    pub species: Vec<String>,
    /// The thirteen rules of Table 3, beside Table 4 of the source.
    #[arg(long, conflicts_with = "species")]
    pub all: bool,
    /// Instead of the rule's own.
    #[arg(long, value_name = "N", allow_negative_numbers = true, value_parser = clap::value_parser!(u32).range(0..=64))]
    pub iterations: Option<u32>,
    /// For rules with chance.
    #[arg(long, default_value_t = 1, allow_negative_numbers = true, value_parser = seed)]
    pub seed: u64,
    /// Print the derived string.
    #[arg(long)]
    pub text: bool,
}

#[derive(Debug, Args)]
pub struct Check {
    #[arg(required = true, value_name = "FILE")]
    pub files: Vec<PathBuf>,
    /// Check again on every save and draw the tree, until Ctrl-C.
    #[arg(long)]
    pub watch: bool,
    /// Picture that --watch draws; beside the file and named like it where absent.
    #[arg(short, long, value_name = "PNG", requires = "watch")]
    pub output: Option<PathBuf>,
    #[arg(long, default_value_t = 1, allow_negative_numbers = true, value_parser = seed)]
    pub seed: u64,
}

#[derive(Debug, Args)]
pub struct New {
    /// Letters, digits, `_` and `-`, such as `betula_nana`.
    #[arg(value_name = "NAME")]
    pub name: String,
    /// A name from `larix species list`, or a rule file, whose values it begins with.
    #[arg(long, value_name = "BASE", default_value = crate::species::TEMPLATE_BASE)]
    pub from: String,
    /// NAME.toml where absent.
    #[arg(short, long, value_name = "FILE")]
    pub output: Option<PathBuf>,
    /// Write over a file that is there.
    #[arg(long)]
    pub force: bool,
}

#[derive(Debug, Args)]
pub struct Schema {
    /// Standard output where absent.
    #[arg(short, long, value_name = "FILE")]
    pub output: Option<PathBuf>,
}

#[derive(Debug, Args)]
pub struct Show {
    /// A name from `larix species list`, or a rule file.
    #[arg(value_name = "NAME|FILE")]
    pub species: String,
    /// .png
    #[arg(short, long, value_name = "FILE")]
    pub output: PathBuf,
    /// Height in metres; the species' typical height where absent.
    #[arg(long, value_name = "M", allow_negative_numbers = true, value_parser = above_zero::<f32>("metres"))]
    pub height: Option<f32>,
    /// Longer side of the sheet in pixels.
    #[arg(long, value_name = "PX", default_value_t = 1600, allow_negative_numbers = true, value_parser = clap::value_parser!(u32).range(300..=6000))]
    pub size: u32,
    /// Of the first tree; the others have the next ones.
    #[arg(long, default_value_t = 1, allow_negative_numbers = true, value_parser = seed)]
    pub seed: u64,
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory;

    #[test]
    fn arguments_are_consistent() {
        super::Cli::command().debug_assert();
    }
}
