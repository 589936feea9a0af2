//! One tree: from its rule file, with no scan, or fitted to a scan of it.

use std::path::{Path, PathBuf};
use std::thread;

use glam::{DVec3, Vec2, Vec3};

use super::budget::Bound;
use super::cover::Subject;
use super::detail::{self, WoodJob};
use super::level_table::{self, Row};
use super::levels::{self, LevelsJob};
use super::light;
use super::model::{add_materials, prototype};
use super::paint::{Kept, leaf_variants, paint_unless_found, tell_no_variants};
use super::told;
use super::tolerance;
use crate::cache::Cache;
use crate::diagnostic::{Error, Result};
use crate::frame::Frame;
use crate::lod::collision::collision;
use crate::mesh::{FoliageLevel, MeshOptions, TwigsAs};
use crate::raster::Picture;
use crate::render::{self, Camera, RenderOptions};
use crate::report::{ErrorMeasure, Outcome, Recorder};
use crate::scan;
use crate::scene::{Instance, LeftOut, Scene, TreeFacts, ValidScene, identifier};
use crate::seed::Seed;
use crate::skeleton::envelope::Envelope;
use crate::skeleton::grow::HEIGHTS_M;
use crate::skeleton::surroundings::{Neighbour, Surroundings, Wall};
use crate::skeleton::{self, Detail, STAGES, Skeleton, Target, cloud, decline};
use crate::species::Species;
use crate::species::state::State;

/// What to grow.
#[derive(Debug, Clone)]
pub struct TreeJob {
    pub species: Species,
    pub size: Asked,
    /// The tree as it stood at a stage of its life; grown where `None`.
    pub stage: Option<u16>,
    /// Upright walls through these places about the stem, square to the way there, metres.
    pub walls: Vec<Vec2>,
    /// Where trees like this one stand about it, metres.
    pub neighbours: Vec<Vec2>,
    pub seed: Seed,
    pub triangles: usize,
    pub texture_px: u32,
    pub foliage: FoliageLevel,
    /// [`TwigsAs::Instanced`] goes with no coarser form, wind, light map or tolerance.
    pub twigs: TwigsAs,
    pub wood: WoodJob,
    pub levels: LevelsJob,
    pub cache: Cache,
    pub state: State,
    /// Whether the leaves come in the colours of other seasons and conditions, too.
    pub has_variants: bool,
    /// Whether heights of the bark are written, too.
    pub has_height_maps: bool,
    /// The scan of one tree to fit to, instead of growing one.
    pub cloud: Option<PathBuf>,
}

/// A tree, ready to write.
pub struct Grown {
    /// The tree at the origin.
    pub scene: ValidScene,
    /// What these forms are.
    pub rows: Vec<Row>,
    pub pruned: LeftOut,
    /// Whether more triangles would show more of its leaves.
    pub is_thin: bool,
    /// How the tree fits the scan, where there is one.
    pub fit: Option<cloud::Report>,
}

/// How large a tree is to be.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Asked {
    /// As the species' typical ones.
    Typical,
    HeightM(f32),
    /// By the species' growth.
    AgeYears(f32),
}

/// Times a species' height, and its age, from which on a tree is none of its kind: twice as high as its tallest
/// grow, older than its growth lasts.
const GIANT: f32 = 2.5;
const ANCIENT: f32 = 4.0;

impl Asked {
    /// # Errors
    /// An age at which a tree is too low to be one.
    fn check(self, species: &Species) -> Result<()> {
        let (size, least_m) = (&species.size, *HEIGHTS_M.start());
        match self {
            Asked::AgeYears(years) if size.height_at(years) < least_m => {
                let least = (100.0 * size.age_at(least_m)).ceil() / 100.0;
                Err(Error::new(format!(
                    "--age {years}: {} is lower than {least_m} m then, too low to be grown",
                    species.name
                ))
                .remedy(format!("give {least} years or more")))
            }
            _ => Ok(()),
        }
    }

    fn warning(self, species: &Species) -> Option<String> {
        let (name, size) = (&species.name, &species.size);
        match self {
            Asked::HeightM(high_m) if high_m > GIANT * size.height_m => Some(format!(
                "--height {high_m}: {:.1} times as high as {name} is as a rule, {} m; its shape is carried on from \
                 trees that there are",
                high_m / size.height_m,
                size.height_m
            )),
            Asked::AgeYears(years) if years > ANCIENT * size.age_years => Some(format!(
                "--age {years}: {name} grows no more after about {} years; it is as high as then, {:.1} m",
                ANCIENT * size.age_years,
                size.height_at(years)
            )),
            _ => None,
        }
    }
}

impl TreeJob {
    fn height_m(&self) -> f32 {
        let typical = &self.species.size;
        match self.size {
            Asked::Typical => typical.height_m,
            Asked::HeightM(height_m) => height_m,
            Asked::AgeYears(years) => typical.height_at(years),
        }
    }

    /// Twigs that are stored once stand on as many shoots, however few triangles are stored.
    fn detail(&self) -> Detail {
        let triangles = match self.twigs {
            TwigsAs::Instanced => self.triangles.max(INSTANCED),
            TwigsAs::Merged => self.triangles,
        };
        self.wood.detail(triangles, self.foliage.of(&self.species))
    }
}

/// Triangles at least by which a tree whose twigs are stored once branches.
const INSTANCED: usize = 1_000_000;

/// Triangles with which a tree with cards has the same branches as one whose twigs are stored once, in so
/// many, and what they are.
pub fn like_with_twigs_stored(triangles: usize, foliage: FoliageLevel) -> usize {
    detail::like_with_cards(triangles.max(INSTANCED), foliage)
}

/// Rule file, and a scan if there is one, to a validated scene of one tree.
///
/// # Errors
/// A rule that grows beyond its limits; a scan that can't be read or is no single tree.
pub fn tree(job: &TreeJob, run: &mut Recorder) -> Result<Grown> {
    match &job.cloud {
        Some(path) => {
            let (skeleton, frame, report) = fitted(job, path, run)?;
            let stem_m = report.stem_diameter_m;
            let skeleton =
                decline::in_condition(&skeleton, job.species.kind, job.state.condition, job.seed);
            let grown = stand(job, &skeleton, stem_m, frame, None, run)?;
            Ok(Grown { fit: Some(report), ..grown })
        }
        None => {
            let (skeleton, kept) = grown_beside(job, run);
            let skeleton = skeleton?;
            let stem_m = job.species.size.stem_diameter_at(skeleton.height_m());
            let skeleton =
                decline::in_condition(&skeleton, job.species.kind, job.state.condition, job.seed);
            stand(job, &skeleton, stem_m, Frame::local(DVec3::ZERO), kept, run)
        }
    }
}

/// The scan of one tree to a skeleton, and to the frame whose origin is its root.
fn fitted(
    job: &TreeJob,
    path: &Path,
    run: &mut Recorder,
) -> Result<(Skeleton, Frame, cloud::Report)> {
    let scan = run.stage("scan", |warnings| {
        let read = scan::read(&[path.to_path_buf()], &scan::ReadOptions::default())?;
        warnings.extend(read.warnings);
        let points = read.value.cloud.len();
        Ok((read.value, Outcome::items(1, "files", points, "points")))
    })?;
    run.stage("skeleton", |_| {
        let points = &scan.cloud.position;
        let detail = job.detail();
        let fitted =
            cloud::fit(&job.species, points, detail, job.seed).map_err(|e| e.in_file(path))?;
        let r = &fitted.report;
        let outcome = Outcome::items(points.len(), "points", fitted.skeleton.len(), "nodes")
            .error(ErrorMeasure::new("mean distance", r.mean_m, "m"))
            .note(format!(
                "left out: {} strays, {} points of ground and low growth",
                r.strays, r.ground
            ));
        let frame = scan.cloud.frame.clone();
        let origin = frame.world_from_local(fitted.root);
        Ok(((fitted.skeleton, Frame { origin, ..frame }, fitted.report), outcome))
    })
}

/// The skeleton; meanwhile the pictures of a tree of the height asked for are read, where there are any from
/// an earlier run.
fn grown_beside(job: &TreeJob, run: &mut Recorder) -> (Result<Skeleton>, Option<Kept>) {
    let read = || {
        let height_m = job.height_m();
        let look = job.state.look(&job.species.in_leaf_at(height_m), job.seed);
        Kept::find(&look, job.texture_px, &job.cache)
    };
    thread::scope(|scope| {
        let reading = thread::Builder::new().spawn_scoped(scope, read);
        let skeleton = grown(job, run);
        (skeleton, reading.ok().and_then(|reading| reading.join().ok()).flatten())
    })
}

fn grown(job: &TreeJob, run: &mut Recorder) -> Result<Skeleton> {
    let species = &job.species;
    run.stage("skeleton", |warnings| {
        let wanted = job.height_m();
        job.size.check(species)?;
        let target = Target::FromSpecies { height_m: Some(wanted) };
        let around = surroundings(job);
        let detail = job.detail();
        let skeleton = skeleton::grow_among(species, target, detail, &around, job.seed)?;
        warnings.extend(job.size.warning(species));
        let off = f64::from((skeleton.height_m() - wanted).abs());
        let skeleton = match job.stage {
            Some(stage) => skeleton::at_stage(&skeleton, species, stage)?,
            None => skeleton,
        };
        let mut outcome = Outcome::items(1, "rule file", skeleton.len(), "nodes")
            .error(ErrorMeasure::new("height error", off, "m"))
            .note(format!("about {:.0} years old", age_years(job, &skeleton)));
        if let Some(stage) = job.stage {
            outcome = outcome.note(format!("stage {stage} of {STAGES}"));
            let height_m = skeleton.height_m();
            if skeleton.branch_m() < height_m {
                warnings.push(format!(
                    "--stage {stage}: a stem of {height_m:.1} m and hardly a branch, as those it had then have died \
                     since; --height {height_m:.1} in its place grows a young tree"
                ));
            }
        }
        Ok((skeleton, outcome))
    })
}

fn surroundings(job: &TreeJob) -> Surroundings<'static> {
    let height_m = job.height_m();
    let size = &job.species.at_height(height_m).size;
    let own = Envelope::of_species(size, 0.0, height_m, job.seed);
    Surroundings {
        walls: job
            .walls
            .iter()
            .map(|at| Wall::Behind { point: at.extend(0.0), normal: -at.extend(0.0).normalize() })
            .collect(),
        neighbours: job
            .neighbours
            .iter()
            .map(|at| Neighbour {
                root: at.extend(0.0),
                height_m,
                crown_base_m: own.base_m,
                crown_radius_m: own.radius_m,
            })
            .collect(),
        ..Surroundings::none()
    }
}

/// A skeleton to a scene of that tree alone.
fn stand(
    job: &TreeJob,
    skeleton: &Skeleton,
    stem_diameter_m: f32,
    frame: Frame,
    kept: Option<Kept>,
    run: &mut Recorder,
) -> Result<Grown> {
    let own = job.species.in_leaf_at(skeleton.height_m());
    let species = &job.state.look(&own, job.seed);
    let leaf_share = job.state.leaf_share(&job.species);
    let textures = run.stage("texture", |warnings| {
        told::remarks(species, job.foliage, job.texture_px, warnings);
        let mut textures = paint_unless_found(species, job.texture_px, &job.cache, kept)?;
        if job.has_variants {
            if job.foliage != FoliageLevel::None {
                textures.leaf_variants =
                    leaf_variants(&own, job.state, job.texture_px, job.seed, &job.cache)?;
            }
            if textures.leaf_variants.is_empty() {
                tell_no_variants(&own, warnings);
            }
        }
        if !job.has_height_maps {
            textures.forget_heights();
        }
        let outcome = Outcome::items(1, "species", textures.pictures(), "pictures");
        Ok((textures, outcome))
    })?;
    let seed = job.seed.derive("mesh", 0);
    let options = |n: usize| {
        let twigs = job.twigs;
        MeshOptions { leaf_share, twigs, ..job.wood.options(n, job.foliage) }
    };
    let (mut triangles, mut is_rough, mut bound) = (job.triangles, false, Bound::Triangles);
    if let Some(tolerance_m) = job.wood.tolerance_m {
        (triangles, is_rough, bound) = run.stage("tolerance", |warnings| {
            let subject = Subject { skeleton, species, textures: &textures, seed };
            let reached = tolerance::fewest(&subject, &options, job.triangles, tolerance_m)?;
            let bound = if reached.is_within() { Bound::Tolerance } else { Bound::Triangles };
            let found = (reached.triangles, reached.is_rough, bound);
            Ok((found, tolerance::outcome(&[reached], Bound::Triangles, warnings)))
        })?;
    }
    let (mut meshes, factor) =
        run.stage("mesh", |warnings| {
            let mut options = MeshOptions { wind: job.levels.wind, ..options(triangles) };
            if is_rough {
                options = options.roughened();
            }
            // Wood fitted to a cloud stays where it is.
            let height_m = job.cloud.is_none().then(|| skeleton.height_m());
            let subject = Subject { skeleton, species, textures: &textures, seed };
            let (meshes, factor) =
                levels::meshes(&subject, &options, job.levels.meshed, height_m, &job.cache)?;
            let triangles = meshes.iter().map(|m| m.triangles()).sum();
            let outcome = Outcome::items(skeleton.len(), "nodes", triangles, "triangles");
            let outcome = told::twigs(meshes.first().into_iter(), outcome).error(
                tolerance::sagitta(meshes.first().into_iter(), job.wood.tolerance_m, warnings),
            );
            let outcome = told::unmeshed(meshes.first().into_iter(), outcome, warnings);
            told::over(meshes.first(), job.triangles, warnings);
            let instead = "; --twigs instance stores them in a few forms";
            let what = if species.foliage.is_bare() { "buds" } else { "leaves or needles" };
            let outcome = told::leaves(meshes.first().into_iter(), what, instead, outcome);
            told::thin(meshes.first().map(|mesh| (species, mesh, bound)).into_iter(), warnings);
            told::thin_levels([&meshes[..]].into_iter(), warnings);
            told::fruitless(species, job.foliage, meshes.first().into_iter(), warnings);
            Ok(((meshes, factor), outcome))
        })?;
    let name = identifier(&species.name);
    let mut scene = Scene::empty(name.clone(), frame);
    let look = add_materials(&mut scene, species, textures);
    let coarse = meshes.split_off(1);
    let is_thin = meshes.first().is_some_and(told::is_thin);
    for mesh in meshes {
        scene.prototypes.push(prototype(format!("{name}_01"), species, mesh, look));
    }
    let mut as_meshed = skeleton.clone();
    as_meshed.scale(factor);
    if let (Some(kind), Some(prototype)) = (job.levels.collision, scene.prototypes.first_mut()) {
        prototype.colliders = collision(&as_meshed, kind);
    }
    scene.instances.push(Instance {
        name: format!("{name}_tree"),
        prototype: 0,
        position: Vec3::ZERO,
        yaw_rad: 0.0,
        scale: Vec3::ONE,
        facts: facts(job, species, &as_meshed, [skeleton.height_m(), stem_diameter_m]),
    });
    let mut rows = Vec::new();
    if !job.levels.is_empty() {
        run.stage("levels", |warnings| {
            let (coarse, told_m) = (vec![coarse], |_| Some(f32::INFINITY));
            levels::add(
                &mut scene,
                coarse,
                &[look],
                &job.levels,
                job.texture_px,
                &job.cache,
                told_m,
            )?;
            rows = level_table::rows(&scene);
            Ok(((), level_table::outcome(&rows, 1, warnings)))
        })?;
    }
    if let Some(side_px) = job.levels.lightmap_px {
        run.stage("light map", |warnings| Ok(((), light::add(&mut scene, side_px, warnings)?)))?;
    }
    run.stage("scene", |_| {
        let left_out = scene.prune();
        let scene = scene.validate()?;
        let triangles = crate::scene::statistics(&scene).unique_triangles as usize;
        Ok((
            Grown { scene, rows, pruned: left_out, is_thin, fit: None },
            Outcome::items(1, "model", triangles, "triangles")
                .note(format!("left out: {left_out}")),
        ))
    })
}

/// Years the tree has stood; those of a stage are its share of the grown tree's.
fn age_years(job: &TreeJob, skeleton: &Skeleton) -> f32 {
    let size = &job.species.size;
    let share = f32::from(job.stage.unwrap_or(STAGES)) / f32::from(STAGES);
    let grown_m = match job.stage {
        Some(_) => job.height_m(),
        None => skeleton.height_m(),
    };
    share * size.age_at(grown_m)
}

/// `as_meshed`: its leaves reach up to `height_m`.
fn facts(
    job: &TreeJob,
    species: &Species,
    as_meshed: &Skeleton,
    [height_m, stem_diameter_m]: [f32; 2],
) -> TreeFacts {
    TreeFacts {
        id: "1".into(),
        species: species.name.clone(),
        height_m,
        crown_diameter_m: as_meshed.width_m(),
        crown_base_height_m: as_meshed.crown_base_m(),
        stem_diameter_m,
        condition: job.state.condition.numeral(),
        confidence: 1.0,
    }
}

/// A nearly level picture of the tree on a disc of ground.
pub fn preview(scene: &ValidScene, [width, height]: [u32; 2]) -> Picture {
    let model = &scene.prototypes()[0];
    let view = render::View::of_prototype(model, scene.materials(), scene.textures());
    let camera = Camera::portrait(&view, width as f32 / height as f32);
    render::picture(&view, &camera, &RenderOptions { width, height, ..RenderOptions::default() })
}
