//! From trees to a scene: which trees share a model, one skeleton and mesh a model, textures,
//! terrain with its photo, and everything in its place.

use glam::{Vec2, Vec3};
use rayon::prelude::*;
use rstar::RTree;
use rstar::primitives::GeomWithData;

use super::coarsest;
use super::cover::Subject;
use super::drape::drape;
use super::fit;
use super::hung::Hung;
use super::levels::{self, LevelsJob};
use super::light;
use super::model::{Look, add_materials, prototype, tinted};
use super::paint::{leaf_variants, paint, tell_no_variants};
use super::survey;
use super::survey::{Survey, SurveyJob};
use super::told;
use super::tolerance;
use super::view::{self, Chosen, Clip, Eye};
use crate::cache::Cache;
use crate::diagnostic::Result;
use crate::frame::Frame;
use crate::lod::Kind;
use crate::lod::collision::collision;
use crate::mesh::{FoliageLevel, Junctions, MeshOptions, Surface, TreeMesh, crown_diameter_m};
use crate::raster::Picture;
use crate::render::{self, Camera, RenderOptions};
use crate::report::{ErrorMeasure, Outcome, Recorder};
use crate::scene::sharing::{Build, Model, share};
use crate::scene::turn;
use crate::scene::{
    Alpha, Colorspace, Instance, LeftOut, Material, Part, Scene, Texture, TreeFacts, ValidScene,
    identifier,
};
use crate::seed::Seed;
use crate::skeleton::surroundings::{Neighbour, Surroundings};
use crate::skeleton::{self, Detail, Skeleton, Target, decline};
use crate::species::Species;
use crate::species::state::State;
use crate::terrain::{Facets, Terrain};
use crate::texture::{self, TreeTextures};

/// How many models the trees share.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Sharing {
    /// Each tree is grown for itself.
    None,
    /// At most so many models a species.
    PerSpecies(usize),
}

/// How the scene is built from the survey.
#[derive(Debug, Clone)]
pub struct ForestJob {
    pub survey: SurveyJob,
    pub sharing: Sharing,
    /// Most triangles of one tree model.
    pub triangles: usize,
    /// Most triangles of all trees in their places; models share it by size.
    pub scene_triangles: Option<usize>,
    /// What is left of the survey.
    pub clip: Option<Clip>,
    /// Where the scene will be looked at from; from everywhere where `None`.
    pub eye: Option<Eye>,
    pub foliage: FoliageLevel,
    pub wood: WoodJob,
    pub texture_px: u32,
    pub levels: LevelsJob,
    pub cache: Cache,
    /// Of every tree.
    pub state: State,
    /// Whether the leaves come in the colours of other seasons and conditions, too.
    pub has_variants: bool,
    /// Whether heights of the bark are written, too.
    pub has_height_maps: bool,
    /// The terrain's triangles keep this near to its heights, as far as their number allows.
    pub terrain_error_m: f32,
    /// Whether it is measured how far the points of trees are from the wood that stands for them.
    pub tells_fit: bool,
    /// Identifier of the scene.
    pub name: String,
}

impl ForestJob {
    /// The usual forest: shared models of 5,000 triangles, leaves on cards, nothing beside it.
    pub fn new(survey: SurveyJob) -> ForestJob {
        ForestJob {
            survey,
            sharing: Sharing::PerSpecies(5),
            triangles: 5_000,
            scene_triangles: None,
            clip: None,
            eye: None,
            foliage: FoliageLevel::Cards,
            wood: WoodJob::default(),
            texture_px: 512,
            levels: LevelsJob::default(),
            cache: Cache::off(),
            state: State::default(),
            has_variants: false,
            has_height_maps: false,
            terrain_error_m: 0.05,
            tells_fit: false,
            name: "forest".into(),
        }
    }

    /// What a camera chooses among is made, whether or not it is written beside.
    fn forms(&self) -> LevelsJob {
        match self.eye {
            None => self.levels,
            Some(_) => LevelsJob {
                meshed: self.levels.meshed.max(levels::SHARES.len()),
                impostor: self.levels.impostor.or(Some(Kind::Cross)),
                ..self.levels
            },
        }
    }

    /// Triangles of the scene that models share out by their size; a camera does by distance when it
    /// chooses.
    fn shared_by_size(&self) -> Option<usize> {
        self.scene_triangles.filter(|_| self.eye.is_none())
    }

    /// Of an impostor's picture.
    fn sheet_px(&self) -> u32 {
        match (&self.eye, self.levels.impostor) {
            (Some(_), None | Some(Kind::Cross)) => self.texture_px.min(CHOSEN_SHEET_PX),
            _ => self.texture_px,
        }
    }
}

/// Of a cross for a camera, which shows most of them where they are so many lines high or less.
const CHOSEN_SHEET_PX: u32 = 256;

/// A forest, ready to write.
pub struct Forest {
    pub scene: ValidScene,
    /// What the forms of every model are.
    pub rows: Vec<levels::Row>,
    /// What the camera made of it.
    pub chosen: Option<Chosen>,
    /// Trees outside the box that was asked for.
    pub clipped: usize,
    pub pruned: LeftOut,
    /// From the points of trees to the wood of their models in place, mean, metres; where asked for.
    pub crown_error_m: Option<f64>,
    pub survey: Survey,
}

/// Side of the square that one repeat of the forest floor covers, metres.
const FLOOR_TILE_M: f32 = 4.0;
/// Most triangles of the terrain.
const TERRAIN_TRIANGLES: usize = 120_000;
/// Fewest triangles that a model with a crown of its own is given.
const LEAST_TRIANGLES: usize = 200;
/// Most that one in its coarsest form has.
const MOST_COARSEST: usize = 80;
/// Share of `--scene-triangles` below which it is told what holds trees back.
const UNSPENT: f64 = 0.8;
/// A shared model is widened or narrowed against its height by no more than this factor.
const MOST_STRETCH: f32 = 1.5;

/// Scans to a validated scene.
///
/// # Errors
/// Those of the survey; a species that cannot grow.
pub fn forest(job: &ForestJob, run: &mut Recorder) -> Result<Forest> {
    let survey = survey::inventory(&job.survey, run)?;
    raise(job, survey, run)
}

/// A survey to a validated scene.
///
/// # Errors
/// A species that cannot grow; a box that holds nothing.
pub fn raise(job: &ForestJob, mut survey: Survey, run: &mut Recorder) -> Result<Forest> {
    let clipped = job.clip.map_or(Ok(0), |clip| view::clip(&mut survey, &clip))?;
    let mut models = models(job, &survey);
    let unmade = job.eye.as_ref().map_or(0, |eye| view::cull(&mut models, &survey, eye));
    let mut plans = plans(job, &survey, &models);
    let (skeletons, shed_m) = grow(job, &survey, &models, &plans, run)?;
    let looks = looks(job);
    let textures = paint_all(job, &models, &looks, run)?;
    let heights_m = |m: &Model| (m.species, survey.trees[m.exemplar].crown.height_m);
    let hung = Hung::of(models.iter().map(heights_m), &looks);
    let of = Grown {
        models: &models,
        skeletons: &skeletons,
        looks: &looks,
        hung: &hung,
        textures: &textures,
    };
    if let Some(tolerance_m) = job.wood.tolerance_m {
        plans = within(job, &survey, of, &plans, tolerance_m, run)?;
    }
    let meshes = build_meshes(job, &survey, of, &plans, run)?;
    let mut finest = Vec::with_capacity(meshes.len());
    let mut coarse = Vec::with_capacity(meshes.len());
    for mut of_model in meshes {
        coarse.push(of_model.split_off(1));
        finest.extend(of_model);
    }
    let facets = survey.terrain.facets(job.terrain_error_m, TERRAIN_TRIANGLES);
    let Assembled { mut scene, materials, stretch } =
        assemble(job, &survey, &facets, &models, (finest, &shed_m), &looks, textures);
    let mut crown_error_m = None;
    if job.tells_fit {
        crown_error_m = run.stage("fit", |_| {
            let (trees, models) = (scene.instances.len(), scene.prototypes.len());
            let mean_m = fit::in_place_m(&survey, &scene, &skeletons);
            let outcome = Outcome::items(trees, "trees", models, "models");
            let measure = |m| ErrorMeasure::new("points to wood in place, mean", m, "m");
            Ok((
                mean_m,
                match mean_m {
                    Some(m) => outcome.error(measure(m)),
                    None => outcome,
                },
            ))
        })?;
    }
    if let Some(kind) = job.levels.collision {
        for (prototype, skeleton) in scene.prototypes.iter_mut().zip(&skeletons) {
            prototype.colliders = collision(skeleton, kind);
        }
    }
    let mut rows = Vec::new();
    let forms = job.forms();
    if !forms.is_empty() {
        run.stage("levels", |warnings| {
            levels::add(&mut scene, coarse, &materials, &forms, job.sheet_px(), &job.cache)?;
            rows = levels::rows(&scene);
            Ok(((), levels::outcome(&rows, scene.prototypes.len(), warnings)))
        })?;
    }
    let mut chosen = None;
    if let Some(eye) = &job.eye {
        chosen = Some(run.stage("camera", |warnings| {
            let tolerance_m = job.wood.tolerance_m.unwrap_or(0.0);
            let mut chosen = view::choose(&mut scene, eye, tolerance_m, job.scene_triangles);
            chosen.outside += unmade;
            let shown = scene.instances.len();
            if shown == 0 && !survey.trees.is_empty() {
                warnings.push(view::blind(&survey));
            }
            let (total, taken) = (job.scene_triangles.unwrap_or(usize::MAX), chosen.triangles);
            if taken > total {
                warnings.push(format!(
                    "--scene-triangles {total}: the {shown} trees in the picture take {taken} in their \
                     coarsest forms; give more, or show fewer (--clip, --camera)"
                ));
            }
            let mut outcome = Outcome::items(survey.trees.len(), "trees", shown, "shown")
                .note(format!("{} outside the picture, {} hidden", chosen.outside, chosen.hidden));
            if chosen.off_px > 1.0 {
                let note = format!("{taken} triangles, off by up to {:.1} pixels", chosen.off_px);
                outcome = outcome.note(note);
            }
            Ok((chosen, outcome))
        })?);
    }
    if let Some(side_px) = job.levels.lightmap_px {
        run.stage("light map", |warnings| Ok(((), light::add(&mut scene, side_px, warnings)?)))?;
    }
    let (scene, pruned) = run.stage("scene", |warnings| {
        let left_out = scene.prune();
        let scene = scene.validate()?;
        if survey.trees.is_empty() {
            warnings.push("no trees were found: the scene holds the terrain alone".into());
        }
        let stats = crate::scene::statistics(&scene);
        let mut outcome = Outcome::items(
            survey.trees.len(),
            "trees",
            stats.instanced_triangles as usize,
            "triangles",
        )
        .note(format!("{} models, {} unique triangles", stats.prototypes, stats.unique_triangles))
        .note(format!("terrain of {} triangles within {:.3} m", facets.triangles(), facets.worst_m))
        .note(format!("left out: {left_out}"));
        if let Some(stretch) = stretch {
            outcome = outcome.error(ErrorMeasure::new("model stretch RMS", stretch, "%"));
        }
        Ok(((scene, left_out), outcome))
    })?;
    Ok(Forest { scene, rows, chosen, clipped, pruned, crown_error_m, survey })
}

/// The species as their trees look in the state that was asked for, by species index.
fn looks(job: &ForestJob) -> Vec<Species> {
    job.survey.species.iter().map(|s| job.state.look_of_many(s)).collect()
}

/// Models with their skeletons, and how their species look.
#[derive(Clone, Copy)]
struct Grown<'a> {
    models: &'a [Model],
    /// Of each model.
    skeletons: &'a [Skeleton],
    /// Of each species; textures where a model is of it.
    looks: &'a [Species],
    hung: &'a Hung,
    textures: &'a [Option<TreeTextures>],
}

impl<'a> Grown<'a> {
    /// What is meshed as model `m`; the seed is that of a tree's `mesh` stage.
    fn subject(&self, m: usize, job: &ForestJob, survey: &Survey) -> Option<Subject<'a>> {
        let model = &self.models[m];
        let textures = self.textures[model.species].as_ref()?;
        let key = survey.trees[model.exemplar].crown.key;
        let seed = job.survey.seed.derive("mesh", key);
        let species = self.hung.look(m);
        Some(Subject { skeleton: &self.skeletons[m], species, textures, seed })
    }
}

fn models(job: &ForestJob, survey: &Survey) -> Vec<Model> {
    match job.sharing {
        Sharing::None => (0..survey.trees.len())
            .map(|i| Model { species: survey.species[i], exemplar: i, members: vec![i] })
            .collect(),
        Sharing::PerSpecies(n) => {
            let builds: Vec<Build> = survey
                .trees
                .iter()
                .zip(&survey.species)
                .map(|(t, &species)| Build {
                    species,
                    height_m: t.crown.height_m,
                    crown_diameter_m: t.crown.diameter_m,
                })
                .collect();
            share(&builds, n)
        }
    }
}

/// How a model is meshed.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Plan {
    /// At most.
    triangles: usize,
    /// Whether the roundness of its wood gives way to that.
    is_rough: bool,
    /// Two cones and a cylinder stand for it.
    is_coarsest: bool,
}

impl Plan {
    fn of(triangles: usize) -> Plan {
        Plan { triangles, is_rough: false, is_coarsest: false }
    }

    const COARSEST: Plan = Plan { triangles: LEAST_TRIANGLES, is_rough: false, is_coarsest: true };
}

/// How each model is meshed by the triangles that are given.
fn plans(job: &ForestJob, survey: &Survey, models: &[Model]) -> Vec<Plan> {
    let Some(total) = job.shared_by_size() else {
        return vec![Plan::of(job.triangles); models.len()];
    };
    let size = |m: &Model| {
        let crown = &survey.trees[m.exemplar].crown;
        (crown.height_m.max(crown.diameter_m), m.members.len())
    };
    let sizes: Vec<(f32, usize)> = models.iter().map(size).collect();
    shared_out(&sizes, total, job.triangles.max(LEAST_TRIANGLES), job.forms().is_empty())
}

/// Triangles of a scene shared out among models by their size (and trees). Where each cannot have as
/// many as a crown takes, as few of the smallest as it takes are in their coarsest form, if they
/// may be.
fn shared_out(
    sizes: &[(f32, usize)],
    total: usize,
    most: usize,
    may_be_coarsest: bool,
) -> Vec<Plan> {
    let mut small: Vec<usize> = (0..sizes.len()).collect();
    small.sort_by(|&a, &b| sizes[a].0.total_cmp(&sizes[b].0));
    let mut least: usize = sizes.iter().map(|s| s.1 * LEAST_TRIANGLES).sum();
    let is_too_many = |&&k: &&usize| {
        let is = may_be_coarsest && least > total;
        least -= if is { sizes[k].1 * (LEAST_TRIANGLES - MOST_COARSEST) } else { 0 };
        is
    };
    let coarsest = small.iter().take_while(is_too_many).count();
    let (few, rest) = small.split_at(coarsest);
    let held = few.iter().map(|&k| sizes[k].1 * MOST_COARSEST).sum();
    let of: Vec<(f32, usize)> = rest.iter().map(|&k| sizes[k]).collect();
    let given = view::shared_budget(&of, total.saturating_sub(held), [LEAST_TRIANGLES, most]);
    let mut plans = vec![Plan::COARSEST; sizes.len()];
    for (&k, triangles) in rest.iter().zip(given) {
        plans[k] = Plan::of(triangles);
    }
    plans
}

/// What to say where all trees together take more triangles than they may, or leave many unspent as no model
/// may have more.
fn off_budget(
    job: &ForestJob,
    models: &[Model],
    plans: &[Plan],
    meshes: &[Vec<TreeMesh>],
) -> Option<String> {
    let total = job.shared_by_size()?;
    let finest = meshes.iter().filter_map(|of_model| of_model.first());
    let taken = models.iter().zip(finest).map(|(m, mesh)| m.members.len() * mesh.triangles());
    let (taken, trees) =
        (taken.sum::<usize>(), models.iter().map(|m| m.members.len()).sum::<usize>());
    let told = format!("--scene-triangles {total}: {trees} trees take {taken}");
    if taken > total {
        let why = match job.forms().is_empty() {
            true => "two cones and a cylinder are the coarsest form of any".into(),
            false => format!("no finest form has fewer than about {LEAST_TRIANGLES}"),
        };
        return Some(format!("{told}, for {why}; give more, or fewer trees (--clip, --camera)"));
    }
    let most = job.triangles;
    let is_held = !plans.is_empty() && plans.iter().all(|p| p.triangles >= most && !p.is_coarsest);
    let is_unspent = is_held && (taken as f64) < UNSPENT * total as f64;
    is_unspent.then(|| format!("{told}, as no model has more than {most}; give more --triangles"))
}

/// Skeletons of all models, and what each has lost of its width by its condition, metres.
fn grow(
    job: &ForestJob,
    survey: &Survey,
    models: &[Model],
    plans: &[Plan],
    run: &mut Recorder,
) -> Result<(Vec<Skeleton>, Vec<f32>)> {
    run.stage("skeleton", |_| {
        let roots = RTree::bulk_load(
            (0..survey.trees.len())
                .map(|i| GeomWithData::new(survey.trees[i].crown.root.truncate().to_array(), i))
                .collect(),
        );
        let widest_m = survey.trees.iter().map(|t| t.crown.diameter_m).fold(0.0, f32::max);
        let grown: Vec<(Skeleton, f32)> = models
            .par_iter()
            .zip(plans)
            .map(|(m, plan)| {
                let seed = job.survey.seed.derive("tree", survey.trees[m.exemplar].crown.key);
                let detail = job.wood.detail(plan.triangles, job.foliage);
                let whole = grow_one(job, survey, &roots, widest_m, m, detail, seed)?;
                let kind = job.survey.species[m.species].kind;
                let left = decline::in_condition(&whole, kind, job.state.condition, seed);
                let thin_m = job.survey.species[m.species].foliage.bearing_radius_m;
                let shed_m = (crown_m(&whole, thin_m) - crown_m(&left, thin_m)).max(0.0);
                Ok((left, shed_m))
            })
            .collect::<Result<_>>()?;
        let (skeletons, shed_m): (Vec<_>, Vec<_>) = grown.into_iter().unzip();
        let nodes = skeletons.iter().map(Skeleton::len).sum();
        let attractors: usize =
            models.iter().map(|m| survey.trees[m.exemplar].crown.attractors.len()).sum();
        let mut outcome = Outcome::items(attractors, "attractors", nodes, "nodes");
        let distances: Vec<(f64, usize)> = models
            .par_iter()
            .zip(&skeletons)
            .map(|(m, s)| fill_distance(s, &survey.trees[m.exemplar].crown))
            .collect();
        let (sum, count) = distances.iter().fold((0.0, 0), |(s, n), d| (s + d.0, n + d.1));
        if count > 0 {
            let mean = sum / count as f64;
            outcome = outcome.error(ErrorMeasure::new("crown point to wood, mean", mean, "m"));
        }
        Ok(((skeletons, shed_m), outcome))
    })
}

/// Diameter of what bears leaves, or of all where nothing does.
fn crown_m(skeleton: &Skeleton, bearing_radius_m: f32) -> f32 {
    let bears = skeleton.bears_leaves(bearing_radius_m);
    let bears_none = !bears.contains(&true);
    let places = skeleton.position.iter().zip(bears).filter(|(_, bears)| *bears || bears_none);
    crown_diameter_m(&places.map(|(p, _)| *p).collect::<Vec<_>>())
}

fn grow_one(
    job: &ForestJob,
    survey: &Survey,
    roots: &Roots,
    widest_m: f32,
    model: &Model,
    detail: Detail,
    seed: Seed,
) -> Result<Skeleton> {
    let crown = &survey.trees[model.exemplar].crown;
    let species = &job.survey.species[model.species];
    let target = Target::FromCrown(crown);
    // A model that several trees share stands in no one place.
    if model.members.len() > 1 {
        return skeleton::grow(species, target, detail, seed);
    }
    let ground = |p: Vec2| survey.terrain.height_at(p + crown.root.truncate()) - crown.root.z;
    let around = Surroundings {
        ground: Some(&ground),
        neighbours: neighbours(survey, roots, widest_m, model.exemplar),
        ..Surroundings::none()
    };
    skeleton::grow_among(species, target, detail, &around, seed)
}

/// Horizontal places of all roots, with the numbers of their trees.
type Roots = RTree<GeomWithData<[f32; 2], usize>>;

/// The trees whose crowns may touch that of tree `i`, in its own coordinates; `widest_m` is the
/// greatest crown diameter of all.
fn neighbours(survey: &Survey, roots: &Roots, widest_m: f32, i: usize) -> Vec<Neighbour> {
    let own = &survey.trees[i].crown;
    let reach_m = 0.5 * (own.diameter_m + widest_m);
    let mut near: Vec<usize> = roots
        .locate_within_distance(own.root.truncate().to_array(), reach_m * reach_m)
        .map(|r| r.data)
        .filter(|&k| k != i)
        .collect();
    near.sort_unstable();
    near.into_iter()
        .map(|k| &survey.trees[k].crown)
        .filter(|c| c.root.truncate().distance(own.root.truncate()) > 0.1)
        .map(|c| Neighbour {
            root: c.root - own.root,
            height_m: c.height_m,
            crown_base_m: c.base_height_m,
            crown_radius_m: 0.5 * c.diameter_m,
        })
        .collect()
}

/// Buttresses and finer rings are for trees that are seen from near.
pub fn mesh_options(triangles: usize) -> MeshOptions {
    let preset = if triangles < 10_000 { MeshOptions::FOREST } else { MeshOptions::HERO };
    MeshOptions { triangle_budget: Some(triangles), ..preset }
}

/// How wood is meshed.
#[derive(Debug, Clone, Copy, Default)]
pub struct WoodJob {
    pub junctions: Junctions,
    /// Triangles of a tree are the fewest whose silhouette is off by no more than this, RMS; as
    /// many as there may be where `None`.
    pub tolerance_m: Option<f32>,
}

impl WoodJob {
    pub(super) fn options(&self, triangles: usize, foliage: FoliageLevel) -> MeshOptions {
        let preset = mesh_options(triangles);
        let tolerance_m = self.tolerance_m.unwrap_or(f32::INFINITY).min(preset.tolerance_m);
        let sagitta_m = self.tolerance_m.unwrap_or(f32::INFINITY);
        MeshOptions { foliage, tolerance_m, sagitta_m, junctions: self.junctions, ..preset }
    }

    /// That of a skeleton for at most so many triangles.
    pub(super) fn detail(&self, triangles: usize, foliage: FoliageLevel) -> Detail {
        match self.tolerance_m {
            None => detail(triangles, foliage),
            Some(_) => detail(tolerance::reference(triangles, foliage), foliage),
        }
    }
}

/// The same with fewer triangles.
pub fn coarser(options: &MeshOptions, triangles: usize) -> MeshOptions {
    let preset = mesh_options(triangles);
    MeshOptions {
        foliage: options.foliage.min(FoliageLevel::Cards),
        triangle_budget: Some(triangles),
        tolerance_m: options.tolerance_m.max(preset.tolerance_m),
        sagitta_m: f32::INFINITY,
        detail: options.detail && preset.detail,
        ..*options
    }
}

/// Nodes enough to use so many triangles well: about six a node, wood and leaves; more where every
/// leaf is one. No fewer than it takes for twigs to be spread over the crown.
pub(super) fn detail(triangles: usize, foliage: FoliageLevel) -> Detail {
    const FEWEST_NODES: usize = 2_500;
    let max_nodes = match foliage {
        FoliageLevel::Geometry => (triangles / 60).clamp(2_000, 40_000),
        _ => (triangles / 6).clamp(FEWEST_NODES, 100_000),
    };
    Detail { max_nodes: max_nodes as u32, attractor_spacing_m: None }
}

/// Triangles of cards for which as many nodes are grown as for these of `foliage`.
pub(super) fn like_with_cards(triangles: usize, foliage: FoliageLevel) -> usize {
    match foliage {
        FoliageLevel::Geometry => (triangles / 10).min(240_000),
        _ => triangles,
    }
}

/// Sum of the distances from a crown's points to the nearest node, and their count.
fn fill_distance(skeleton: &Skeleton, crown: &crate::crown::Crown) -> (f64, usize) {
    let nodes: Vec<[f32; 3]> =
        skeleton.position.iter().map(|p| (*p + crown.root).to_array()).collect();
    let tree = RTree::bulk_load(nodes);
    let sum = crown
        .attractors
        .iter()
        .filter_map(|a| {
            tree.nearest_neighbor(a.to_array()).map(|n| f64::from(a.distance(Vec3::from(*n))))
        })
        .sum();
    (sum, crown.attractors.len())
}

/// Triangles of each model by the tolerance: that which was asked for, or what the camera can tell
/// of the nearest tree that shows the model, if that is more; and whether the roundness of its wood
/// must give way.
fn within(
    job: &ForestJob,
    survey: &Survey,
    grown: Grown<'_>,
    plans: &[Plan],
    tolerance_m: f32,
    run: &mut Recorder,
) -> Result<Vec<Plan>> {
    run.stage("tolerance", |warnings| {
        let told = |m: &Model| {
            let Some(eye) = &job.eye else { return tolerance_m };
            let of = |&i: &usize| {
                let crown = &survey.trees[i].crown;
                view::told_m(&survey.frame, eye, crown.root, crown.height_m, crown.diameter_m)
            };
            m.members.iter().map(of).fold(f32::INFINITY, f32::min).max(tolerance_m)
        };
        let reached: Vec<tolerance::Reached> = plans
            .par_iter()
            .enumerate()
            .filter(|(_, plan)| !plan.is_coarsest)
            .filter_map(|(m, plan)| Some((m, plan, grown.subject(m, job, survey)?)))
            .map(|(m, plan, subject)| {
                let leaf_share = job.state.leaf_share(subject.species);
                let options =
                    |n: usize| MeshOptions { leaf_share, ..job.wood.options(n, job.foliage) };
                let told_m = told(&grown.models[m]);
                tolerance::fewest(&subject, &options, plan.triangles, told_m)
            })
            .collect::<Result<_>>()?;
        let outcome = tolerance::outcome(&reached, warnings);
        let coarsest = plans.iter().filter(|plan| plan.is_coarsest).count();
        if coarsest > 0 {
            warnings.push(format!(
                "--tolerance: {coarsest} of {} models are two cones and a cylinder each, for \
                 --scene-triangles, and farther off; give more of those",
                plans.len()
            ));
        }
        let mut plans = plans.to_vec();
        for (plan, r) in plans.iter_mut().filter(|plan| !plan.is_coarsest).zip(&reached) {
            *plan = Plan { is_rough: r.is_rough, ..Plan::of(r.triangles) };
        }
        Ok((plans, outcome))
    })
}

fn build_meshes(
    job: &ForestJob,
    survey: &Survey,
    grown: Grown<'_>,
    plans: &[Plan],
    run: &mut Recorder,
) -> Result<Vec<Vec<TreeMesh>>> {
    run.stage("mesh", |warnings| {
        let meshed = job.forms().meshed;
        let meshes: Vec<Vec<TreeMesh>> = plans
            .par_iter()
            .enumerate()
            .filter_map(|(m, plan)| Some((m, plan, grown.subject(m, job, survey)?)))
            .map(|(m, plan, subject)| {
                let mut options = MeshOptions {
                    wind: job.levels.wind,
                    leaf_share: job.state.leaf_share(subject.species),
                    ..job.wood.options(plan.triangles, job.foliage)
                };
                if plan.is_rough {
                    options = options.roughened();
                }
                let height_m = Some(survey.trees[grown.models[m].exemplar].crown.height_m);
                if plan.is_coarsest {
                    return Ok(vec![coarsest::alone(&subject, &options, height_m)?]);
                }
                levels::meshes(&subject, &options, meshed, height_m)
            })
            .collect::<Result<_>>()?;
        let Grown { models, skeletons, looks, textures, .. } = grown;
        let nodes = skeletons.iter().map(Skeleton::len).sum();
        let triangles = meshes.iter().flatten().map(TreeMesh::triangles).sum();
        let finest = meshes.iter().filter_map(|of_model| of_model.first());
        let outcome = Outcome::items(nodes, "nodes", triangles, "triangles")
            .error(tolerance::sagitta(finest.clone(), job.wood.tolerance_m, warnings));
        let is_bare = models.iter().any(|m| looks[m.species].foliage.is_bare());
        let what = if is_bare { "leaves, needles or buds" } else { "leaves or needles" };
        let outcome = told::leaves(finest.clone(), what, "", outcome);
        let of_model =
            || models.iter().filter(|m| textures[m.species].is_some()).zip(finest.clone());
        told::thin(of_model().map(|(m, mesh)| (&looks[m.species], mesh)), warnings);
        for (k, species) in looks.iter().enumerate() {
            let its = of_model().filter(|(m, _)| m.species == k).map(|(_, mesh)| mesh);
            told::fruitless(species, job.foliage, its, warnings);
        }
        let mut outcome = told::unmeshed(finest, outcome, warnings);
        let coarsest = models.iter().zip(plans).filter(|(_, plan)| plan.is_coarsest);
        let (few, trees) = coarsest.fold((0, 0), |(n, t), (m, _)| (n + 1, t + m.members.len()));
        if few > 0 {
            outcome = outcome.note(format!(
                "{few} models of {trees} trees, the smallest, as two cones and a cylinder each"
            ));
        }
        warnings.extend(off_budget(job, models, plans, &meshes));
        Ok((meshes, outcome))
    })
}

/// Textures of the species that any model uses, by species index.
fn paint_all(
    job: &ForestJob,
    models: &[Model],
    looks: &[Species],
    run: &mut Recorder,
) -> Result<Vec<Option<TreeTextures>>> {
    let (species, size_px, seed) = (&job.survey.species, job.texture_px, job.survey.seed);
    run.stage("texture", |warnings| {
        let is_used: Vec<bool> =
            (0..species.len()).map(|s| models.iter().any(|m| m.species == s)).collect();
        let textures: Vec<Option<TreeTextures>> = species
            .par_iter()
            .zip(looks)
            .zip(&is_used)
            .map(|((s, look), &used)| {
                let draw = || {
                    let mut textures = paint(look, size_px, &job.cache)?;
                    if job.has_variants && job.foliage != FoliageLevel::None {
                        textures.leaf_variants =
                            leaf_variants(s, job.state, size_px, seed, &job.cache)?;
                    }
                    if !job.has_height_maps {
                        textures.forget_heights();
                    }
                    Ok(textures)
                };
                used.then(draw).transpose()
            })
            .collect::<Result<_>>()?;
        if job.has_variants {
            let drawn = species.iter().zip(&textures).filter_map(|(s, t)| Some((s, t.as_ref()?)));
            for (species, _) in drawn.filter(|(_, t)| t.leaf_variants.is_empty()) {
                tell_no_variants(species, warnings);
            }
        }
        for (s, _) in species.iter().zip(&is_used).filter(|(_, used)| **used) {
            warnings.extend(s.remarks.iter().cloned());
        }
        let used = is_used.iter().filter(|&&u| u).count();
        Ok((textures, Outcome::items(used, "species", used * 3, "pictures")))
    })
}

/// Draws the pictures that a scene of this survey will need, into the cache.
pub(super) fn paint_ahead(job: &ForestJob, survey: &Survey, run: &mut Recorder) -> Result<()> {
    paint_all(job, &models(job, survey), &looks(job), run).map(drop)
}

/// A scene before it is checked.
struct Assembled {
    scene: Scene,
    /// Of each prototype.
    materials: Vec<Look>,
    /// By how much models are widened or narrowed against their height to fit their trees, RMS in
    /// percent.
    stretch: Option<f64>,
}

fn assemble(
    job: &ForestJob,
    survey: &Survey,
    facets: &Facets,
    models: &[Model],
    (meshes, shed_m): (Vec<TreeMesh>, &[f32]),
    looks: &[Species],
    textures: Vec<Option<TreeTextures>>,
) -> Assembled {
    let species = &job.survey.species;
    let mut stretch_sq = Vec::new();
    let mut scene = Scene::empty(job.name.clone(), survey.frame.clone());
    add_terrain(&mut scene, &survey.terrain, facets, survey, job.survey.seed);
    let mut by_species = Vec::new();
    for (s, t) in looks.iter().zip(textures) {
        by_species.push(t.map(|t| add_materials(&mut scene, s, t)));
    }
    let mut materials = Vec::with_capacity(models.len());
    let mut numbers = vec![0; species.len()];
    for (m, (model, mesh)) in models.iter().zip(meshes).enumerate() {
        let Some(Some(look)) = by_species.get(model.species) else { continue };
        numbers[model.species] += 1;
        let s = &species[model.species];
        let of_model = job.survey.seed.derive("tint", survey.trees[model.exemplar].crown.key);
        let tint = job.state.tint(s, &looks[model.species], of_model);
        let look = &tinted(&mut scene, *look, tint, numbers[model.species]);
        materials.push(*look);
        // The scan's crown is that of the tree before it declined: fitted to what is left of it, its stem
        // would be as much too thick.
        let width_m = mesh.crown_diameter_m() + shed_m[m];
        let name = format!("{}_{:02}", identifier(&s.name), numbers[model.species]);
        scene.prototypes.push(prototype(name, s, mesh, *look));
        let exemplar = &survey.trees[model.exemplar].crown;
        for &i in &model.members {
            let tree = &survey.trees[i];
            let crown = &tree.crown;
            let up = crown.height_m / exemplar.height_m;
            let out =
                (crown.diameter_m / width_m.max(0.01)).clamp(up / MOST_STRETCH, up * MOST_STRETCH);
            // A model grown from this very crown keeps its azimuth.
            let yaw_rad = if i == model.exemplar {
                0.0
            } else {
                turn::draw(&mut job.survey.seed.derive("yaw", crown.key).draws())
            };
            stretch_sq.push(f64::from(out / up - 1.0).powi(2));
            scene.instances.push(Instance {
                name: format!("{}_{}", identifier(&s.name), tree.id),
                prototype: m as u32,
                // On the triangles that are seen, which on rough ground are not the grid.
                position: crown.root.truncate().extend(facets.height_at(crown.root.truncate())),
                yaw_rad,
                scale: Vec3::new(out, out, up),
                facts: TreeFacts {
                    id: tree.id.clone(),
                    species: tree.species.clone(),
                    height_m: crown.height_m,
                    crown_diameter_m: crown.diameter_m,
                    crown_base_height_m: crown.base_height_m,
                    stem_diameter_m: tree.stem_diameter_m,
                    condition: job.state.condition.numeral(),
                    confidence: crown.confidence,
                }
                .rounded(),
            });
        }
    }
    let count = stretch_sq.len() as f64;
    let stretch = (count > 0.0).then(|| 100.0 * (stretch_sq.iter().sum::<f64>() / count).sqrt());
    Assembled { scene, materials, stretch }
}

fn add_terrain(scene: &mut Scene, terrain: &Terrain, facets: &Facets, survey: &Survey, seed: Seed) {
    let mut surface = facets.surface();
    let outlines: Vec<&[Vec2]> = survey.trees.iter().map(|t| &t.crown.outline[..]).collect();
    let draped = survey.photo.as_ref().and_then(|p| drape(p, terrain, &outlines, seed));
    let picture = draped.unwrap_or_else(|| tiled_floor(&mut surface, terrain, seed));
    place_terrain(scene, surface, picture);
}

/// The bare forest floor in tiles over a surface.
fn tiled_floor(surface: &mut Surface, terrain: &Terrain, seed: Seed) -> Picture {
    let g = &terrain.heights.geometry;
    let size = Vec2::new((g.east() - g.west) as f32, (g.north - g.south()) as f32);
    for uv in &mut surface.uv {
        *uv *= size / FLOOR_TILE_M;
    }
    texture::ground(512, seed)
}

fn place_terrain(scene: &mut Scene, surface: Surface, picture: Picture) {
    scene.textures.push(Texture {
        name: "terrain".into(),
        image: picture.into(),
        colorspace: Colorspace::Srgb,
    });
    scene.materials.push(Material {
        name: "terrain".into(),
        base_color: [1.0; 3],
        base_color_texture: Some(scene.textures.len() as u32 - 1),
        normal_texture: None,
        orm_texture: None,
        relief: None,
        variants: Vec::new(),
        roughness: 1.0,
        specular: 1.0,
        translucency: 0.0,
        alpha: Alpha::Opaque,
        double_sided: false,
    });
    let material = scene.materials.len() as u32 - 1;
    scene.terrain = Some(Part { name: "terrain".into(), surface, material });
}

/// The terrain alone as a scene: triangles that keep every height within `error_m`, bare floor.
///
/// # Errors
/// A scene that does not hold together.
pub fn terrain_scene(
    frame: Frame,
    terrain: &Terrain,
    error_m: f32,
    run: &mut Recorder,
) -> Result<(ValidScene, Facets)> {
    run.stage("mesh", |_| {
        let facets = terrain.facets(error_m, usize::MAX);
        let mut scene = Scene::empty("terrain".into(), frame);
        let mut surface = facets.surface();
        let picture = tiled_floor(&mut surface, terrain, Seed::new(1));
        place_terrain(&mut scene, surface, picture);
        let cells = terrain.heights.data.len();
        let outcome = Outcome::items(cells, "cells", facets.triangles(), "triangles");
        let worst = ErrorMeasure::new("worst height", facets.worst_m.into(), "m");
        Ok(((scene.validate()?, facets), outcome.error(worst)))
    })
}

/// A bird's-eye picture of the whole scene.
pub fn preview(scene: &ValidScene, [width, height]: [u32; 2]) -> Picture {
    let view = render::View::from(scene.as_scene());
    let camera = Camera::overview(&view, width as f32 / height as f32);
    // What is drawn is laid out anew: of trees that all differ no more than a share of the scene.
    const TRIANGLES: usize = 2_000_000;
    let options =
        RenderOptions { width, height, triangle_budget: TRIANGLES, ..RenderOptions::default() };
    render::picture(&view, &camera, &options)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_scene_s_triangles_suffice_for_the_smallest_in_their_coarsest_form() {
        let sizes: Vec<(f32, usize)> = (0..40).map(|k| (3.0 + k as f32, 1 + k % 5)).collect();
        let trees: usize = sizes.iter().map(|s| s.1).sum();
        let taken = |plans: &[Plan]| -> usize {
            let one = |p: &Plan| if p.is_coarsest { MOST_COARSEST } else { p.triangles };
            plans.iter().zip(&sizes).map(|(p, s)| s.1 * one(p)).sum()
        };
        let coarsest = |plans: &[Plan]| plans.iter().filter(|p| p.is_coarsest).count();
        let mut before = sizes.len();
        for each in [80, 100, 150, 199, 200, 230, 2_000] {
            let plans = shared_out(&sizes, each * trees, 5_000, true);
            let is_spent = (each * trees - 5 * 120..=each * trees).contains(&taken(&plans));
            assert!(is_spent, "{each}: {}", taken(&plans));
            let few = coarsest(&plans);
            assert!(plans[..few].iter().all(|p| p.is_coarsest), "the smallest");
            assert!(few <= before && (few == 0) == (each >= 200), "{each}: {few} after {before}");
            before = few;
            // One less would be too many.
            if few > 0 {
                assert!(taken(&plans) + 120 * sizes[few - 1].1 > each * trees, "{each}");
            }
            assert_eq!(coarsest(&shared_out(&sizes, each * trees, 5_000, false)), 0);
        }
        assert_eq!(coarsest(&shared_out(&sizes, trees, 5_000, true)), sizes.len());
        assert!(shared_out(&[], 1_000, 5_000, true).is_empty());
    }
}
