//! Jobs run, and what they make written.

use std::collections::BTreeMap;
use std::path::PathBuf;

use bytes::Bytes;
use serde_json::{Value, json};

use super::args::{self, Cli, Command, SceneArgs};
use super::jobs::{
    TREE_TRIANGLES, check_held, check_levels, check_pictures, check_scene, check_twigs, extras,
    files, forest_job, formats, goal, level, levels_job, load_species, method, not_held, profile,
    scene_extensions, seed, state, survey_job, triangles, wind_as, wood,
};
use super::paths::{extension, folders, forest_folder, place, stem};
use super::progress::Terminal;
use super::told::{
    Told, fit_lines, forest_lines, forest_summary, level_lines, notes, print, repeats_pictures,
    report_file, spare_line, summary,
};
use crate::cache::Cache;
use crate::diagnostic::{Error, Result};
use crate::export::{self, Format, MOST_GLB_BYTES, OutputFile, Staged};
use crate::ground::Method;
use crate::mesh::{FoliageLevel, TwigsAs};
use crate::pipeline::tree::Grown;
use crate::pipeline::{self, Asked, Effort, Forest, LevelsJob, SurveyJob, TreeJob, left_out};
use crate::raster::{GridGeometry, cog};
use crate::report::{self, Outcome, Recorder, Silent};
use crate::scene::{Forms, Selection, ValidScene};
use crate::simulate::StandOptions;
use crate::species;
use crate::species::assign::SpeciesBy;

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

pub(super) fn cache(cli: &Cli) -> Cache {
    if cli.no_cache { Cache::off() } else { Cache::of_user() }
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
        let (scene, facets) = pipeline::floor::terrain_scene(frame, &terrain, error_m, run)?;
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
        size: match (a.height, a.age) {
            (Some(height_m), _) => Asked::HeightM(height_m),
            (None, Some(years)) => Asked::AgeYears(years),
            (None, None) => Asked::Typical,
        },
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
    let Grown { scene, rows, pruned, is_thin, fit } = pipeline::tree::tree(&job, run)?;
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
    let spare = |most| spare_line(most, stats.unique_triangles, is_thin, &job);
    lines.extend(a.triangles.and_then(spare));
    lines.extend(["mesh", "export"].iter().flat_map(|stage| notes(run, stage)));
    let mut summary = summary("tree", Some(a.seed), run, Some(&scene));
    summary["levels"] = json!(rows);
    let table = left_out::table(&left_out::Told {
        scene: &scene,
        levels: &job.levels,
        foliage,
        repeats_pictures: repeats_pictures(&a.levels, formats),
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
    let truth = pipeline::demo::compare(&survey.stand, &forest.survey, job.clip.as_ref());
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
