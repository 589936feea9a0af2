//! Resolved jobs, run and written.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use bytes::Bytes;
use serde_json::{Value, json};

use super::args::{self, Cli, Command, ScanArgs, SceneArgs, TreeArgs};
use super::progress::Terminal;
use crate::cache::Cache;
use crate::diagnostic::{Error, Result};
use crate::export::{self, Format, MOST_GLB_BYTES, OutputFile, Profile, Staged, WindAs};
use crate::ground::Method;
use crate::lod;
use crate::mesh::{FoliageLevel, Junctions, TwigsAs, WindProfile, lightmap};
use crate::pipeline::goal::Goal;
use crate::pipeline::left_out::{self, Saved};
use crate::pipeline::tree::Grown;
use crate::pipeline::{
    self, Effort, Forest, ForestJob, LevelsJob, Sharing, SurveyJob, TreeJob, WoodJob, levels,
};
use crate::raster::{GridGeometry, cog};
use crate::report::{self, Outcome, Recorder, Silent};
use crate::scan;
use crate::scene::{ColliderShape, Forms, Selection, ValidScene, identifier};
use crate::seed::Seed;
use crate::simulate::StandOptions;
use crate::species::assign::SpeciesBy;
use crate::species::state::State;
use crate::species::{self, Species};

/// Species to choose among where none are named.
const DEFAULT_MIX: [&str; 5] =
    ["larix_sibirica", "betula_pendula", "pinus_sylvestris", "picea_obovata", "salix_caprea"];

/// Most triangles of a tree model in a forest, and of a tree alone; with every leaf of it.
const FOREST_TRIANGLES: [usize; 2] = [5_000, 200_000];
const TREE_TRIANGLES: [usize; 2] = [20_000, 1_000_000];
/// Where the tolerance says how many they are.
const TOLERANCE_TRIANGLES: [usize; 2] = [100_000, 1_000_000];
/// Of a terrain mesh where none is asked for, metres.
const TERRAIN_ERROR_M: f32 = 0.05;
const PREVIEW_PX: [u32; 2] = [1280, 720];
const PORTRAIT_PX: [u32; 2] = [900, 1200];

pub fn run(cli: &Cli) -> Result<()> {
    let terminal = Terminal::new();
    let observer: &dyn report::Observer = if cli.quiet { &Silent } else { &terminal };
    let mut run = Recorder::new(observer);
    let cache = cache(cli);
    let made: Vec<PathBuf> =
        folders(&cli.command)?.into_iter().filter(|dir| !dir.exists()).collect();
    let told = match &cli.command {
        Command::Demo(a) => demo(a, cache, &mut run),
        Command::Forest(a) => forest(a, cache, &mut run),
        Command::Inventory(a) => inventory(a, &mut run),
        Command::Terrain(a) => terrain(a, &mut run),
        Command::Tree(a) => tree(a, cache, &mut run),
        Command::Landscape(a) => super::landscape::run(a, &mut run),
        Command::Report(a) => super::report::run(a, cli.quiet),
        Command::Species(a) => {
            let none = Told { lines: Vec::new(), json: Value::Null };
            super::species::run(&a.command, cli, &mut run).map(|()| none)
        }
    };
    // What was found between stages; it may be why the run failed.
    run.warnings.iter().for_each(|warning| observer.warn(warning));
    let report = told?;
    if !cli.quiet {
        for line in &report.lines {
            tell!("{line}");
        }
        // One that was mistyped would not be missed.
        for dir in made.iter().filter(|dir| dir.is_dir()) {
            tell!("made the folder {}", dir.display());
        }
    }
    if cli.json && !report.json.is_null() {
        print(&[report.json.to_string()])?;
    }
    Ok(())
}

/// Those that a command writes into; what is missing of them is made.
fn folders(command: &Command) -> Result<Vec<PathBuf>> {
    use args::SpeciesCommand::{New, Schema, Show};
    let files: Vec<&PathBuf> = match command {
        Command::Demo(a) => return Ok(vec![a.output.clone()]),
        Command::Forest(a) => return Ok(vec![forest_folder(a)]),
        Command::Report(a) => match &a.write_front {
            Some(file) => vec![file],
            None => return Ok(vec![a.output.clone()]),
        },
        Command::Inventory(a) => vec![&a.output],
        Command::Terrain(a) => vec![&a.output],
        Command::Tree(a) => vec![&a.output],
        Command::Landscape(a) => a.output.iter().chain(&a.save).collect(),
        Command::Species(a) => match &a.command {
            New(a) => a.output.iter().collect(),
            Schema(a) => a.output.iter().collect(),
            Show(a) => vec![&a.output],
            _ => Vec::new(),
        },
    };
    let mut folders: Vec<PathBuf> =
        files.into_iter().map(|file| Ok(place(file)?.0)).collect::<Result<_>>()?;
    folders.dedup();
    Ok(folders)
}

fn forest_folder(a: &args::Forest) -> PathBuf {
    a.output.clone().unwrap_or_else(|| Path::new("output").join(stem(&a.scan.scans[0])))
}

/// What a command tells at its end.
pub(super) struct Told {
    pub lines: Vec<String>,
    pub json: Value,
}

pub(super) fn cache(cli: &Cli) -> Cache {
    if cli.no_cache { Cache::off() } else { Cache::of_user() }
}

fn seed(value: u64) -> Seed {
    Seed::new(value)
}

pub(super) fn load_species(names: &[String]) -> Result<Vec<Species>> {
    let names: Vec<&str> = if names.is_empty() {
        DEFAULT_MIX.to_vec()
    } else {
        names.iter().map(|n| n.trim()).collect()
    };
    let mut errors = Vec::new();
    let mut out: Vec<Species> = Vec::new();
    for name in names {
        match species::load(name) {
            Ok(s) => match out.iter().find(|o| identifier(&o.name) == identifier(&s.name)) {
                // Named twice is meant once; two files of one name can't be told apart in a scene.
                Some(same) if same.id == s.id => {}
                Some(same) => errors.push(of_one_name(same, &s)),
                None => out.push(s),
            },
            Err(e) => errors.push(e),
        }
    }
    if errors.is_empty() { Ok(out) } else { Err(Error::several(errors)) }
}

/// Models, materials and pictures are called after their species, in letters that every format takes.
fn of_one_name(one: &Species, other: &Species) -> Error {
    let (a, b) = (&one.id, &other.id);
    if one.name == other.name {
        return Error::new(format!("`{a}` and `{b}` are both named {}", one.name))
            .remedy("give one of them a `name` of its own");
    }
    let name = identifier(&one.name);
    Error::new(format!(
        "`{a}`, {}, and `{b}`, {}, are both `{name}` in a scene",
        one.name, other.name
    ))
    .remedy("give one of them a `name` that differs in its letters A to Z or digits")
}

fn survey_job(scan: &ScanArgs, tree: &TreeArgs) -> Result<SurveyJob> {
    Ok(SurveyJob {
        scans: files(scan),
        ground: method(scan.ground),
        cell_m: scan.cell,
        tile_m: scan.tile,
        photo: tree.photo.clone(),
        species: load_species(&tree.species)?,
        species_by: species_by(tree.species_by),
        voxel_m: tree.voxel,
        min_height_m: tree.min_height,
        effort: match tree.effort {
            args::Effort::Fast => Effort::Fast,
            args::Effort::Normal => Effort::Normal,
            args::Effort::Best => Effort::Best,
        },
        seed: seed(tree.seed),
    })
}

fn files(scan: &ScanArgs) -> scan::Files {
    scan::Files { paths: scan.scans.clone(), crs: scan.crs.clone() }
}

pub(super) fn method(ground: args::Ground) -> Method {
    match ground {
        args::Ground::Smrf => Method::Smrf,
        args::Ground::Tin => Method::Tin,
        args::Ground::Voxel => Method::VoxelRules,
        args::Ground::File => Method::FileClasses,
    }
}

fn species_by(by: args::SpeciesBy) -> SpeciesBy {
    match by {
        args::SpeciesBy::Auto => SpeciesBy::Auto,
        args::SpeciesBy::Luminance => SpeciesBy::Luminance,
        args::SpeciesBy::Shape => SpeciesBy::Shape,
    }
}

/// Of files of scenes, and others.
fn scene_extensions(others: &[&'static str]) -> Vec<&'static str> {
    Format::ALL.iter().map(|format| format.extension()).chain(others.iter().copied()).collect()
}

fn formats(typed: &[args::Format]) -> Vec<Format> {
    typed
        .iter()
        .map(|f| match f {
            args::Format::Glb => Format::Glb,
            args::Format::Gltf => Format::Gltf,
            args::Format::Usda => Format::Usda,
            args::Format::Usdc => Format::Usdc,
            args::Format::Usdz => Format::Usdz,
            args::Format::X3d => Format::X3d,
            args::Format::Obj => Format::Obj,
        })
        .collect()
}

fn level(typed: args::Foliage) -> FoliageLevel {
    match typed {
        args::Foliage::Geometry => FoliageLevel::Geometry,
        args::Foliage::Cards => FoliageLevel::Cards,
        args::Foliage::Sparse => FoliageLevel::Sparse,
        args::Foliage::Shell => FoliageLevel::Shell,
        args::Foliage::None => FoliageLevel::None,
    }
}

/// `usual`: without and with every leaf.
fn triangles(
    typed: Option<u32>,
    wood: &args::WoodArgs,
    usual: [usize; 2],
    level: FoliageLevel,
) -> usize {
    let usual = if wood.tolerance.is_some() { TOLERANCE_TRIANGLES } else { usual };
    typed.map_or(usual[usize::from(level == FoliageLevel::Geometry)], |n| n as usize)
}

fn wood(a: &args::WoodArgs) -> WoodJob {
    let junctions = match a.junctions {
        args::JoinedBy::Weld => Junctions::Welded,
        args::JoinedBy::Intersect => Junctions::Intersecting,
    };
    WoodJob { junctions, tolerance_m: a.tolerance }
}

fn forest_job(survey: SurveyJob, scene: &SceneArgs, cache: Cache) -> ForestJob {
    let sharing = match scene.unique {
        args::Unique::All => Sharing::None,
        args::Unique::Shared(n) => Sharing::PerSpecies(n),
    };
    ForestJob {
        survey,
        sharing,
        triangles: triangles(scene.triangles, &scene.wood, FOREST_TRIANGLES, level(scene.foliage)),
        foliage: level(scene.foliage),
        wood: wood(&scene.wood),
        texture_px: scene.texture,
        state: state(&scene.state),
        has_variants: scene.state.variants,
        has_height_maps: scene.height_maps,
        cache,
        levels: levels_job(&scene.levels, &formats(&scene.format)),
        scene_triangles: scene.scene_triangles.map(|n| n as usize),
        clip: scene.clip,
        eye: scene.camera,
        terrain_error_m: scene.terrain_error,
        tells_fit: false,
        name: "forest".into(),
    }
}

fn state(typed: &args::StateArgs) -> State {
    State { condition: typed.condition, season: typed.season }
}

/// Before any work: whether this program can make what is asked for.
fn check_levels(typed: &args::LevelArgs, formats: &[Format]) -> Result<()> {
    if typed.wind_as == args::WindAs::Color && levels_job(typed, formats).wind.is_none() {
        return Err(Error::new("--wind-as says where wind is written, and none is")
            .remedy("add --wind unity, cryengine or speedtree-like"));
    }
    if typed.impostor_views.is_some() && typed.impostor != Some(args::Impostor::Octahedral) {
        return Err(Error::new("--impostor-views is for octahedral impostors, and there is none")
            .remedy("add --impostor octahedral"));
    }
    let is_gltf = |f: &Format| matches!(f, Format::Glb | Format::Gltf);
    if typed.wind_as == args::WindAs::Color && !formats.iter().any(is_gltf) {
        let files = extensions(formats.iter());
        return Err(Error::new(format!("--wind-as is for glTF, not for {files} files"))
            .remedy("leave it out, or write a .glb"));
    }
    if typed.lightmap_uv.is_some() { lightmap::needed() } else { Ok(()) }
}

/// Options by which something is asked for that not every file holds.
fn extras(levels: &args::LevelArgs, state: &args::StateArgs) -> Vec<&'static str> {
    let asked = [
        ("--impostor octahedral", levels.impostor == Some(args::Impostor::Octahedral)),
        ("--collision", !matches!(levels.collision, None | Some(args::Collision::None))),
        ("--wind", !matches!(levels.wind, None | Some(args::Wind::None))),
        ("--lightmap-uv", levels.lightmap_uv.is_some()),
        ("--variants", state.variants),
    ];
    asked.into_iter().filter_map(|(option, is_asked)| is_asked.then_some(option)).collect()
}

/// Before any work.
fn check_scene(scene: &SceneArgs, run: &mut Recorder) -> Result<()> {
    let formats = formats(&scene.format);
    check_levels(&scene.levels, &formats)?;
    check_pictures(scene.texture, scene.height_maps)?;
    run.warnings.extend(check_held(&extras(&scene.levels, &scene.state), &formats)?);
    run.warnings.extend(not_held(&scene.levels, &formats));
    let levels = levels_job(&scene.levels, &formats);
    if scene.camera.is_some() && (levels.meshed > 0 || levels.impostor.is_some()) {
        run.warnings.push(
            "--camera shows each tree in the one form that serves its distance: no other levels or impostors \
             are written; leave --camera out for those"
                .into(),
        );
    }
    Ok(())
}

/// A warning of what a profile stands for and a file does not hold.
fn not_held(levels: &args::LevelArgs, formats: &[Format]) -> Option<String> {
    if levels.profile == args::Profile::Dcc {
        return None;
    }
    if levels.profile == args::Profile::Web {
        let is_alike = |f: &&Format| !matches!(f, Format::Glb | Format::Gltf | Format::X3d);
        let files = extensions(formats.iter().filter(is_alike));
        let told =
            || format!("{files} files are no smaller for --profile web, which is for glTF and X3D");
        return (!files.is_empty()).then(told);
    }
    let meant = [("wind", levels.wind.is_none()), ("bodies", levels.collision.is_none())];
    let meant: Vec<&str> = meant.into_iter().filter_map(|(m, is)| is.then_some(m)).collect();
    let files = extensions(formats.iter().filter(|f| !f.holds_extras()));
    let is_held = meant.is_empty() || files.is_empty();
    (!is_held).then(|| format!("{files} files hold no {} of --profile engine", meant.join(" and ")))
}

/// As they are told of: `.obj and .x3d`.
fn extensions<'a>(formats: impl Iterator<Item = &'a Format>) -> String {
    formats.map(|f| format!(".{}", f.extension())).collect::<Vec<_>>().join(" and ")
}

/// Whether a file will hold what is asked for. A warning where another does not.
fn check_held(asked: &[&str], formats: &[Format]) -> Result<Option<String>> {
    let (rich, plain): (Vec<&Format>, Vec<_>) = formats.iter().partition(|f| f.holds_extras());
    if asked.is_empty() || plain.is_empty() {
        return Ok(None);
    }
    let (files, asked) = (extensions(plain.into_iter()), asked.join(", "));
    if rich.is_empty() {
        return Err(Error::new(format!("{files} files hold nothing of {asked}"))
            .remedy("leave that out, or write a .glb or a .usda"));
    }
    Ok(Some(format!("{files} files hold nothing of {asked}; the other files do")))
}

fn check_pictures(texture_px: u32, height_maps: bool) -> Result<()> {
    if height_maps && texture_px == 0 {
        return Err(Error::new("--height-maps asks for pictures, and --texture 0 for none")
            .remedy("give --texture 512 or more, or leave out --height-maps"));
    }
    Ok(())
}

fn profile(typed: args::Profile) -> Profile {
    match typed {
        args::Profile::Dcc => Profile::Dcc,
        args::Profile::Engine => Profile::Engine,
        args::Profile::Web => Profile::Web,
    }
}

fn wind_as(typed: args::WindAs) -> WindAs {
    match typed {
        args::WindAs::Attribute => WindAs::Attribute,
        args::WindAs::Color => WindAs::Color,
    }
}

/// As typed; what is not typed is as the profile's readers expect it, where one of the formats holds it.
fn levels_job(typed: &args::LevelArgs, formats: &[Format]) -> LevelsJob {
    let is_engine = typed.profile == args::Profile::Engine;
    let is_rich = is_engine && formats.iter().any(|f| f.holds_extras());
    LevelsJob {
        meshed: usize::from(typed.lods.unwrap_or(if is_engine { 3 } else { 0 })),
        impostor: match typed.impostor {
            None => is_engine.then_some(lod::Kind::Cross),
            Some(args::Impostor::None) => None,
            Some(args::Impostor::Cross) => Some(lod::Kind::Cross),
            Some(args::Impostor::Octahedral) => {
                let views = typed.impostor_views.unwrap_or(lod::impostor::USUAL_VIEWS);
                Some(lod::Kind::Octahedral { views })
            }
        },
        collision: match typed.collision {
            None => is_rich.then_some(ColliderShape::Convex),
            Some(args::Collision::None) => None,
            Some(args::Collision::Capsule) => Some(ColliderShape::Capsule),
            Some(args::Collision::Convex) => Some(ColliderShape::Convex),
        },
        wind: match typed.wind {
            None => is_rich.then_some(WindProfile::Unity),
            Some(args::Wind::None) => None,
            Some(args::Wind::Unity) => Some(WindProfile::Unity),
            Some(args::Wind::Cryengine) => Some(WindProfile::CryEngine),
            Some(args::Wind::SpeedtreeLike) => Some(WindProfile::SpeedTreeLike),
        },
        lightmap_px: typed.lightmap_uv,
    }
}

fn forest(a: &args::Forest, cache: Cache, run: &mut Recorder) -> Result<Told> {
    let dir = forest_folder(a);
    check_scene(&a.scene, run)?;
    let job = forest_job(survey_job(&a.scan, &a.tree)?, &a.scene, cache);
    export::check_writable(&dir)?;
    let (forest, reached) = match goal(a) {
        None => (pipeline::forest::forest(&job, run)?, None),
        Some(goal) => {
            let (forest, reached) = pipeline::goal::forest(&job, goal, run)?;
            (forest, Some((goal, reached)))
        }
    };
    let mut staged = Staged::new(&dir)?;
    stage_forest(&forest, &a.scene, &job.cache, &mut staged, run)?;
    let mut told_of_goal = None;
    if let Some((goal, reached)) = &reached {
        let (told, warning) = reached.told(*goal, run.seconds());
        run.warnings.extend(warning);
        told_of_goal = Some(told);
    }
    let mut summary = forest_summary("forest", a.tree.seed, &forest, &a.scene, run);
    summary["goal"] = json!(reached.map(|r| r.1));
    staged.add(vec![report_file(&summary)])?;
    staged.commit()?;
    let mut lines = forest_lines(&forest, &a.scene, run, &dir);
    lines.extend(told_of_goal);
    Ok(Told { lines, json: summary })
}

fn goal(a: &args::Forest) -> Option<Goal> {
    a.goal.error.map(Goal::Error).or(a.goal.time.map(Goal::Time))
}

/// Everything a forest run writes but its report.
fn stage_forest(
    forest: &Forest,
    typed: &SceneArgs,
    cache: &Cache,
    staged: &mut Staged,
    run: &mut Recorder,
) -> Result<()> {
    let preview = run.stage("preview", |_| {
        let picture = pipeline::forest::preview(&forest.scene, PREVIEW_PX);
        let trees = forest.scene.instances().len();
        Ok((picture.to_png()?, Outcome::items(trees, "trees", 1, "picture")))
    })?;
    let survey = &forest.survey;
    let formats = formats(&typed.format);
    let job = export::Job {
        profile: profile(typed.levels.profile),
        wind: wind_as(typed.levels.wind_as),
        most_glb_bytes: typed.largest_glb.map_or(MOST_GLB_BYTES, |mb| (mb * 1e6) as u64),
        ..export::Job::new("forest", &formats)
    };
    stage_scene(&forest.scene, &job, cache, staged, run)?;
    run.warnings.extend(crate::inventory::unnamed_crs(&survey.frame));
    let inventory = crate::inventory::to_geojson(&survey.trees, &survey.frame);
    staged.add(vec![
        OutputFile::new("preview.png", preview),
        OutputFile::new("inventory.geojson", inventory),
        OutputFile::new("terrain.tif", terrain_tiff(&survey.frame, &survey.terrain)?),
    ])?;
    Ok(())
}

fn stage_scene(
    scene: &ValidScene,
    job: &export::Job<'_>,
    cache: &Cache,
    staged: &mut Staged,
    run: &mut Recorder,
) -> Result<()> {
    run.stage("export", |warnings| {
        let pictures = pipeline::paint::coded(scene, &job.picture_formats(), cache)?;
        let files = export::files(scene, &pictures, job)?;
        warnings.extend(files.warnings);
        let bytes = staged.add(files.value)?;
        let left = staged.of_earlier_runs(job.stem);
        if !left.is_empty() {
            warnings.push(format!(
                "forms of an earlier run stay in the output folder and are none of this scene: {}; \
                 delete them if nobody needs them",
                left.join(", ")
            ));
        }
        let trees = scene.instances().len();
        let mut outcome = Outcome::items(trees, "trees", bytes as usize, "bytes");
        if let Some(left) = forms_never_shown(scene).filter(|_| job.chooses_forms()) {
            outcome = outcome.note(left);
        }
        Ok(((), outcome))
    })
}

/// Forms that a file leaves out that says when each is shown: a coarser one is no farther off.
fn forms_never_shown(scene: &ValidScene) -> Option<String> {
    let all = Selection::of(scene, Forms::All);
    let drawn = Selection::of(scene, Forms::Drawn);
    let mut models: BTreeMap<&str, usize> = BTreeMap::new();
    for (all, drawn) in all.models.iter().zip(&drawn.models) {
        let is_left = |name: &&str| !drawn.forms.iter().any(|f| f.name == *name);
        for name in all.forms.iter().map(|f| f.name).filter(is_left) {
            *models.entry(name).or_default() += 1;
        }
    }
    let each: Vec<String> =
        models.iter().map(|(name, count)| format!("{name} of {count} models")).collect();
    (!each.is_empty())
        .then(|| format!("left out, as a coarser form is no farther off: {}", each.join(", ")))
}

/// Cells farther than this from all ground that was seen hold no data in the GeoTIFF, metres.
const UNSEEN_M: f64 = 50.0;
const NODATA: f32 = -9999.0;

/// Heights in the scan's own system and vertical unit; nodata far from all ground that was seen.
fn terrain_tiff(frame: &crate::frame::Frame, terrain: &crate::terrain::Terrain) -> Result<Vec<u8>> {
    let heights = &terrain.heights;
    let g = heights.geometry;
    let unit = frame.unit_m();
    let geometry = GridGeometry {
        west: frame.origin.x + g.west / unit.x,
        north: frame.origin.y + g.north / unit.y,
        cell_x: g.cell_x / unit.x,
        cell_y: g.cell_y / unit.y,
        ..g
    };
    let is_near = terrain.is_near_ground(UNSEEN_M);
    cog::encode(&cog::Sheet {
        width: g.cols,
        height: g.rows,
        bands: 1,
        kind: cog::Kind::F32,
        geometry: Some(geometry),
        crs: frame.crs.as_ref(),
        nodata: Some(NODATA.into()),
        unit: Some(match unit.z {
            1.0 => "metre",
            z if (z - 0.3048).abs() < 1e-9 => "foot",
            z if (z - 1200.0 / 3937.0).abs() < 1e-9 => "US survey foot",
            _ => "",
        }),
        value: &|col, row, _| match is_near[g.index(col, row)] {
            true => (frame.origin.z + f64::from(heights.at(col, row)) / unit.z) as f32,
            false => NODATA,
        },
    })
}

fn inventory(a: &args::Inventory, run: &mut Recorder) -> Result<Told> {
    let extension = extension(&a.output, &["geojson", "json", "fgb", "csv"])?;
    let job = survey_job(&a.scan, &a.tree)?;
    let (dir, name) = place(&a.output)?;
    export::check_writable(&dir)?;
    let survey = pipeline::survey::inventory(&job, run)?;
    let bytes = match extension {
        "csv" => crate::inventory::to_csv(&survey.trees, &survey.frame)?,
        "fgb" => crate::inventory::to_fgb(&survey.trees, &survey.frame)?,
        _ => {
            run.warnings.extend(crate::inventory::unnamed_crs(&survey.frame));
            crate::inventory::to_geojson(&survey.trees, &survey.frame)
        }
    };
    export::write_all(&dir, vec![OutputFile::new(name, bytes)])?;
    let line = format!("{} trees written to {}", survey.trees.len(), a.output.display());
    Ok(Told { lines: vec![line], json: summary("inventory", Some(a.tree.seed), run, None) })
}

fn terrain(a: &args::Terrain, run: &mut Recorder) -> Result<Told> {
    let extension = extension(&a.output, &scene_extensions(&["tif", "tiff"]))?;
    let format = Format::of_extension(extension);
    let job = SurveyJob {
        scans: files(&a.scan),
        ground: method(a.scan.ground),
        cell_m: a.scan.cell,
        tile_m: a.scan.tile,
        photo: None,
        species: Vec::new(),
        species_by: SpeciesBy::Auto,
        voxel_m: None,
        min_height_m: 2.0,
        effort: Effort::Normal,
        seed: seed(1),
    };
    let (dir, name) = place(&a.output)?;
    export::check_writable(&dir)?;
    let (frame, terrain) = pipeline::survey::terrain(&job, run)?;
    let g = terrain.heights.geometry;
    let mut lines = vec![format!("{} × {} cells of {} m", g.cols, g.rows, g.cell_x)];
    let mut told = json!({ "cols": g.cols, "rows": g.rows, "cell_m": g.cell_x });
    let mut staged = Staged::new(&dir)?;
    if format.is_none() {
        staged.add(vec![OutputFile::new(&name, terrain_tiff(&frame, &terrain)?)])?;
    }
    if format.is_some() || a.terrain_error.is_some() {
        let error_m = a.terrain_error.unwrap_or(TERRAIN_ERROR_M);
        let (scene, facets) = pipeline::forest::terrain_scene(frame, &terrain, error_m, run)?;
        if let Some(format) = format {
            let stem = stem(&a.output);
            let formats = [format];
            let job = export::Job::new(&stem, &formats);
            stage_scene(&scene, &job, &Cache::off(), &mut staged, run)?;
        }
        lines.push(format!(
            "{} triangles keep every height within {:.3} m",
            facets.triangles(),
            facets.worst_m
        ));
        lines.push(format!("{:>9} {:>10}", "error m", "triangles"));
        lines.extend(facets.ladder.iter().map(|(m, n)| format!("{m:>9} {n:>10}")));
        told["triangles"] = json!(facets.triangles());
        told["worst_m"] = json!(facets.worst_m);
        told["triangles_by_error_m"] =
            facets.ladder.iter().map(|(m, n)| json!({ "error_m": m, "triangles": n })).collect();
    }
    staged.commit()?;
    lines.push(format!("written to {}", a.output.display()));
    let mut summary = summary("terrain", None, run, None);
    summary["terrain"] = told;
    Ok(Told { lines, json: summary })
}

fn tree(a: &args::Tree, cache: Cache, run: &mut Recorder) -> Result<Told> {
    let extension = extension(&a.output, &scene_extensions(&["png"]))?;
    let format = Format::of_extension(extension);
    let formats = format.as_slice();
    check_levels(&a.levels, formats)?;
    check_pictures(a.texture, a.height_maps)?;
    let extras = extras(&a.levels, &a.state);
    let is_instanced = a.twigs == args::TwigsAs::Instance;
    let twigs = is_instanced.then_some("--twigs instance");
    check_held(&extras.iter().copied().chain(twigs).collect::<Vec<_>>(), formats)?;
    run.warnings.extend(not_held(&a.levels, formats));
    let levels = levels_job(&a.levels, formats);
    let is_plain = levels == LevelsJob::default() && !a.height_maps && extras.is_empty();
    if format.is_none() && !is_plain {
        let error = "a picture shows the finest form alone: it holds no levels, bodies, wind, looks or heights";
        return Err(Error::new(error).remedy(
            "leave out --lods, --impostor, --collision, --wind, --lightmap-uv, --profile, --variants \
             and --height-maps, or write a .glb",
        ));
    }
    let species = species::load(&a.species)?;
    let foliage = if a.bare { FoliageLevel::None } else { level(a.foliage) };
    if is_instanced {
        let look = state(&a.state).look_of_many(&species);
        check_twigs(&look, foliage, &levels, a)?;
    }
    let job = TreeJob {
        height_m: a.height.or(a.age.map(|years| species.size.height_at(years))),
        species,
        stage: a.stage,
        walls: a.wall.clone(),
        neighbours: a.neighbour.clone(),
        seed: seed(a.seed),
        triangles: triangles(a.triangles, &a.wood, TREE_TRIANGLES, foliage),
        wood: wood(&a.wood),
        texture_px: a.texture,
        foliage,
        twigs: if is_instanced { TwigsAs::Instanced } else { TwigsAs::Merged },
        levels,
        state: state(&a.state),
        has_variants: a.state.variants,
        has_height_maps: a.height_maps,
        cache,
        cloud: a.cloud.clone(),
    };
    let (dir, name) = place(&a.output)?;
    export::check_writable(&dir)?;
    let Grown { scene, rows, pruned, fit } = pipeline::tree::tree(&job, run)?;
    let stem = stem(&a.output);
    let mut staged = Staged::new(&dir)?;
    match format {
        Some(_) => {
            let (profile, wind) = (profile(a.levels.profile), wind_as(a.levels.wind_as));
            let files = export::Job { profile, wind, ..export::Job::new(&stem, formats) };
            stage_scene(&scene, &files, &job.cache, &mut staged, run)?;
        }
        None => run.stage("preview", |_| {
            let picture = pipeline::tree::preview(&scene, PORTRAIT_PX);
            staged.add(vec![OutputFile::new(name, picture.to_png()?)])?;
            Ok(((), Outcome::items(1, "tree", 1, "picture")))
        })?,
    }
    staged.commit()?;
    let stats = crate::scene::statistics(&scene);
    let line = format!(
        "{} of {:.1} m, {} triangles, written to {}",
        job.species.name,
        scene.instances()[0].facts.height_m,
        stats.unique_triangles,
        a.output.display()
    );
    let mut lines = vec![line];
    lines.extend(level_lines(&rows));
    lines.extend(a.triangles.and_then(|most| spare_line(most, stats.unique_triangles, foliage)));
    lines.extend(["mesh", "export"].iter().flat_map(|stage| notes(run, stage)));
    let mut summary = summary("tree", Some(a.seed), run, Some(&scene));
    summary["levels"] = json!(rows);
    let table = left_out::table(&left_out::Told {
        scene: &scene,
        levels: &job.levels,
        has_forms: false,
        pruned,
        clipped: 0,
        chosen: None,
        stages: &run.stages,
    });
    lines.extend(left_out::lines(&table));
    summary["left_out"] = json!(table);
    if let Some(fit) = fit {
        summary["fit"] = json!(fit);
        lines.splice(0..0, fit_lines(&fit));
    }
    Ok(Told { lines, json: summary })
}

/// Whether there are twigs to store once each, and nothing asked for that differs from one to another.
fn check_twigs(
    species: &Species,
    foliage: FoliageLevel,
    levels: &LevelsJob,
    a: &args::Tree,
) -> Result<()> {
    let is_set = matches!(foliage, FoliageLevel::Cards | FoliageLevel::Geometry);
    let has_twigs = is_set && species.own_model.is_some() || foliage == FoliageLevel::Geometry;
    if species.own_picture.is_some() {
        let error =
            "--twigs instance: the species' twigs are pictures, which are no larger than a place";
        return Err(Error::new(error).remedy("leave it out, or give the species a `model`"));
    }
    let hangs = state(&a.state).leaf_share(species) > 0.0;
    if !has_twigs || !hangs {
        let error = "--twigs instance: there are no twigs of leaves or needles to store";
        let remedy = match foliage {
            _ if !hangs => "leave it out: none hangs on a tree in this condition",
            FoliageLevel::None => "leave out --bare or --foliage none, or --twigs instance",
            _ => "add --foliage geometry",
        };
        return Err(Error::new(error).remedy(remedy));
    }
    let asked = [
        ("--lods", levels.meshed > 0),
        ("--impostor", levels.impostor.is_some()),
        ("--wind", levels.wind.is_some()),
        ("--lightmap-uv", levels.lightmap_px.is_some()),
        ("--tolerance", a.wood.tolerance.is_some()),
    ];
    let asked: Vec<&str> = asked.iter().filter(|(_, is)| *is).map(|(option, _)| *option).collect();
    if asked.is_empty() {
        return Ok(());
    }
    let asked = asked.join(", ");
    let given = a.triangles.map_or(0, |n| n as usize);
    let other = pipeline::tree::like_with_twigs_stored(given, foliage);
    let error =
        format!("--twigs instance is the form for close-ups alone: it goes without {asked}");
    Err(Error::new(error).remedy(format!(
        "leave that out (--profile engine asks for levels, impostor and wind), and write other forms in a \
         run of their own, where cards and --triangles {other} grow the same tree"
    )))
}

/// Share of the triangles asked for of which it is worth a word that a tree takes no more.
const SPARE: f32 = 0.5;

/// That a tree takes far fewer triangles than were asked for, and what would take more.
fn spare_line(most: u32, taken: u64, foliage: FoliageLevel) -> Option<String> {
    let finer = match foliage {
        FoliageLevel::Geometry => "this is its finest form",
        _ => "--foliage geometry has every leaf and takes more",
    };
    let is_spare = (taken as f32) < SPARE * most as f32;
    is_spare.then(|| format!("{most} triangles were allowed, it needs no more than these; {finer}"))
}

/// What was noted of a stage.
fn notes(run: &Recorder, stage: &str) -> Vec<String> {
    run.stages.iter().filter(|s| s.stage == stage).flat_map(|s| s.notes.clone()).collect()
}

/// Triangles and silhouette error of each level: the mean triangles and the worst error of all
/// models.
fn level_lines(rows: &[levels::Row]) -> Vec<String> {
    let mut names: Vec<&str> = Vec::new();
    for r in rows {
        if !names.contains(&r.level.as_str()) {
            names.push(&r.level);
        }
    }
    if names.is_empty() {
        return Vec::new();
    }
    let head =
        format!("{:>10} {:>10} {:>22} {:>8}", "level", "triangles", "silhouette worst m", "RMS m");
    let line = |name: &&str| {
        let of = || rows.iter().filter(|r| r.level == *name);
        let count = of().count().max(1);
        let triangles = of().map(|r| r.triangles).sum::<usize>() / count;
        let worst = of().map(|r| r.silhouette_worst_m).fold(0.0, f32::max);
        let rms = of().map(|r| r.silhouette_rms_m).fold(0.0, f32::max);
        format!("{name:>10} {triangles:>10} {worst:>22.3} {rms:>8.3}")
    };
    [head].into_iter().chain(names.iter().map(line)).collect()
}

fn fit_lines(fit: &crate::skeleton::cloud::Report) -> Vec<String> {
    use crate::skeleton::cloud::Led;
    let led = match fit.led_by {
        Led::Stem => {
            format!("stem seen, {:.1} cm thick at breast height", 100.0 * fit.stem_diameter_m)
        }
        Led::Foot => "no stem measured; branches lead to the foot of the cloud".into(),
        Led::Crown => "no stem seen; the species' own wood inside the crown".into(),
    };
    vec![
        format!(
            "{} points measured; left out: {} of ground and low growth, {} strays",
            fit.measured, fit.ground, fit.strays
        ),
        led,
        format!(
            "points to wood: mean {:.1} cm, 95 % within {:.1} cm; farther than {:.0} cm from every \
             point: {:.1} % of the wood's length, {:.1} % of its volume",
            100.0 * fit.mean_m,
            100.0 * fit.p95_m,
            100.0 * fit.outside_beyond_m,
            100.0 * fit.outside_length,
            100.0 * fit.outside_volume
        ),
    ]
}

fn demo(a: &args::Demo, cache: Cache, run: &mut Recorder) -> Result<Told> {
    export::check_writable(&a.output)?;
    check_scene(&a.scene, run)?;
    let species = load_species(&[])?;
    let options = StandOptions { trees: a.trees as usize, ..StandOptions::default() };
    let survey = pipeline::demo::survey_of_stand(&options, &species, seed(a.seed), run)?;
    // The pipeline reads the very files a surveyor would hand over.
    let held = tempfile::tempdir().map_err(|e| {
        Error::new(format!("no temporary folder can be made: {e}"))
            .remedy("set TMPDIR to one with room")
    })?;
    let (scan, photo) = (Bytes::from(survey.scan), Bytes::from(survey.photo));
    let inputs = || {
        vec![OutputFile::new("scan.laz", scan.clone()), OutputFile::new("photo.tif", photo.clone())]
    };
    export::write_all(held.path(), inputs())?;
    let job = forest_job(
        SurveyJob {
            scans: [held.path().join("scan.laz")].into(),
            ground: Method::Smrf,
            cell_m: None,
            tile_m: None,
            photo: Some(held.path().join("photo.tif")),
            species,
            species_by: SpeciesBy::Auto,
            voxel_m: None,
            min_height_m: 2.0,
            effort: Effort::Normal,
            seed: seed(a.seed),
        },
        &a.scene,
        cache,
    );
    let forest = pipeline::forest::forest(&job, run)?;
    let truth = pipeline::demo::compare(&survey.stand, &forest.survey);
    let mut staged = Staged::new(&a.output)?;
    stage_forest(&forest, &a.scene, &job.cache, &mut staged, run)?;
    let mut summary = forest_summary("demo", a.seed, &forest, &a.scene, run);
    summary["truth"] = json!(truth);
    staged.add(vec![report_file(&summary)])?;
    staged.add(inputs())?;
    staged.commit()?;
    let mut lines = forest_lines(&forest, &a.scene, run, &a.output);
    lines.splice(0..0, pipeline::demo::lines(&truth));
    Ok(Told { lines, json: summary })
}

/// To standard output; a reader that has seen enough and closed it is no error.
/// Whether anyone still reads.
pub(super) fn print(lines: &[String]) -> Result<bool> {
    use std::io::{ErrorKind, Write};
    let mut out = std::io::stdout().lock();
    let written = lines.iter().try_for_each(|line| writeln!(out, "{}", line.trim_end()));
    match written.and_then(|()| out.flush()) {
        Ok(()) => Ok(true),
        Err(e) if e.kind() == ErrorKind::BrokenPipe => Ok(false),
        Err(e) => Err(Error::new(format!("standard output can't be written: {e}"))),
    }
}

fn forest_lines(forest: &Forest, typed: &SceneArgs, run: &Recorder, dir: &Path) -> Vec<String> {
    let stats = crate::scene::statistics(&forest.scene);
    let mut lines: Vec<String> = report::table(&run.stages).lines().map(str::to_owned).collect();
    lines.extend(level_lines(&forest.rows));
    lines.extend(["mesh", "export"].iter().flat_map(|stage| notes(run, stage)));
    lines.extend(left_out::lines(&forest_left_out(forest, typed, run)));
    lines.push(format!(
        "{} trees of {} models, {} triangles in place, {} unique; {:.1} s, {} MB at most",
        stats.trees,
        stats.prototypes,
        stats.instanced_triangles,
        stats.unique_triangles,
        run.seconds(),
        run.peak_bytes() / 1_000_000
    ));
    lines.push(format!("written to {}", dir.display()));
    lines
}

/// The report of a run. `schema` counts changes of this layout.
pub(super) fn summary(
    command: &str,
    seed: Option<u64>,
    run: &Recorder,
    scene: Option<&ValidScene>,
) -> Value {
    let mut v = json!({
        "schema": 1,
        "larix": env!("CARGO_PKG_VERSION"),
        "command": command,
        "seed": seed,
        "threads": rayon::current_num_threads(),
        "seconds": run.seconds(),
        "peak_bytes": run.peak_bytes(),
        "stages": run.stages,
        "warnings": run.warnings,
    });
    if let Some(scene) = scene {
        let s = crate::scene::statistics(scene);
        let (low, high) = s.bounds;
        let frame = scene.frame();
        v["scene"] = json!({
            "trees": s.trees,
            "models": s.prototypes,
            "unique_triangles": s.unique_triangles,
            "instanced_triangles": s.instanced_triangles,
            "geometry_bytes": s.geometry_bytes,
            "texture_bytes": s.texture_bytes,
            "bounds_m": [low.to_array(), high.to_array()],
            "origin": frame.origin.to_array(),
            "epsg": frame.crs.as_ref().and_then(|c| c.epsg),
        });
    }
    v
}

fn forest_left_out(forest: &Forest, typed: &SceneArgs, run: &Recorder) -> Vec<Saved> {
    left_out::table(&left_out::Told {
        scene: &forest.scene,
        levels: &levels_job(&typed.levels, &formats(&typed.format)),
        has_forms: typed.camera.is_some(),
        pruned: forest.pruned,
        clipped: forest.clipped,
        chosen: forest.chosen.as_ref(),
        stages: &run.stages,
    })
}

fn forest_summary(
    command: &str,
    seed: u64,
    forest: &Forest,
    scene: &SceneArgs,
    run: &Recorder,
) -> Value {
    let mut summary = summary(command, Some(seed), run, Some(&forest.scene));
    summary["levels"] = json!(forest.rows);
    summary["camera"] = json!(forest.chosen);
    summary["left_out"] = json!(forest_left_out(forest, scene, run));
    summary
}

fn report_file(summary: &Value) -> OutputFile<'static> {
    OutputFile::new("report.json", format!("{summary:#}\n"))
}

pub(super) fn stem(path: &Path) -> String {
    path.file_stem().map_or_else(|| "output".into(), |s| s.to_string_lossy().into_owned())
}

/// The folder and the name of an output file.
pub(super) fn place(path: &Path) -> Result<(PathBuf, String)> {
    let Some(name) = path.file_name() else {
        return Err(Error::new("is not a file name").in_file(path).remedy("give -o a file"));
    };
    let dir = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    Ok((dir.to_path_buf(), name.to_string_lossy().into_owned()))
}

/// The extension of an output file in lower case, one of `known`.
pub(super) fn extension<'a>(path: &Path, known: &[&'a str]) -> Result<&'a str> {
    let typed = path.extension().map(|e| e.to_string_lossy().to_lowercase());
    known.iter().copied().find(|&k| typed.as_deref() == Some(k)).ok_or_else(|| {
        let list: Vec<String> = known.iter().map(|k| format!(".{k}")).collect();
        Error::new("the extension says no format that can be written here")
            .in_file(path)
            .remedy(format!("end the name with {}", list.join(", ")))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_extension_chooses_or_refuses() {
        assert_eq!(extension(Path::new("a/B.GLB"), &["glb", "usda"]).unwrap(), "glb");
        let e = extension(Path::new("tree.obj"), &["glb", "usda"]).unwrap_err();
        assert_eq!(e.remedy_text(), Some("end the name with .glb, .usda"));
        assert!(extension(Path::new("tree"), &["glb"]).is_err());
    }

    #[test]
    fn species_that_a_scene_would_call_the_same_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let file = |file: &str, name: &str| {
            let path = folder.path().join(file);
            let text = format!("extends = 'betula_pendula'\nname = '{name}'");
            std::fs::write(&path, text).unwrap();
            path.to_string_lossy().into_owned()
        };
        let (one, two, three) =
            (file("a.toml", "Ель"), file("b.toml", "Дуб"), file("c.toml", "Oak"));
        assert_eq!(load_species(&[one.clone(), three.clone(), one.clone()]).unwrap().len(), 2);
        let told = load_species(&[one, three.clone(), two]).unwrap_err();
        assert!(told.message().contains("are both `___` in a scene"), "{told}");
        let told = load_species(&[three, file("d.toml", "Oak")]).unwrap_err();
        assert!(told.message().contains("are both named Oak"), "{told}");
    }

    #[test]
    fn a_bare_file_name_lies_in_the_current_folder() {
        assert_eq!(place(Path::new("x.tif")).unwrap(), (PathBuf::from("."), "x.tif".into()));
        assert!(place(Path::new("/")).is_err());
    }
}
