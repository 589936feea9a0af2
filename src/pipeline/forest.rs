//! From trees to a scene: which trees share a model, one skeleton and mesh a model, textures,
//! terrain with its photo, and everything in its place.

use glam::Vec3;
use rayon::prelude::*;

use super::budget::{Bound, Plan, off_budget, plans};
use super::coarsest;
use super::cover::Subject;
use super::detail::WoodJob;
use super::fit;
use super::floor::add_terrain;
use super::hung::Hung;
use super::level_table::{self, Row};
use super::levels::{self, LevelsJob};
use super::light;
use super::model::{Look, add_materials, prototype, tinted};
use super::paint::{leaf_variants, paint, tell_no_variants};
use super::skeletons::grow;
use super::survey;
use super::survey::{Survey, SurveyJob};
use super::told;
use super::tolerance;
use super::view::{self, Chosen, Clip, Eye};
use crate::cache::Cache;
use crate::diagnostic::Result;
use crate::lod::Kind;
use crate::lod::collision::collision;
use crate::mesh::{FoliageLevel, MeshOptions, TreeMesh};
use crate::raster::Picture;
use crate::render::{self, Camera, RenderOptions};
use crate::report::{ErrorMeasure, Outcome, Recorder};
use crate::scene::sharing::{Build, Model, share};
use crate::scene::turn;
use crate::scene::{Instance, LeftOut, Scene, TreeFacts, ValidScene, identifier};
use crate::skeleton::Skeleton;
use crate::species::Species;
use crate::species::state::State;
use crate::terrain::Facets;
use crate::texture::TreeTextures;

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
    pub(super) fn forms(&self) -> LevelsJob {
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
    pub(super) fn shared_by_size(&self) -> Option<usize> {
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
    pub rows: Vec<Row>,
    /// What the camera made of it.
    pub chosen: Option<Chosen>,
    /// Trees outside the box that was asked for.
    pub clipped: usize,
    pub pruned: LeftOut,
    /// From the points of trees to the wood of their models in place, mean, metres; where asked for.
    pub crown_error_m: Option<f64>,
    pub survey: Survey,
}

/// Most triangles of the terrain.
const TERRAIN_TRIANGLES: usize = 120_000;
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
    let (mut skeletons, shed_m) = grow(job, &survey, &models, &plans, run)?;
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
    let (meshes, scales) = build_meshes(job, &survey, of, &plans, run)?;
    // From here on as their meshes are.
    skeletons.iter_mut().zip(scales).for_each(|(skeleton, factor)| skeleton.scale(factor));
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
    let mut seen = None;
    if let Some(eye) = &job.eye {
        seen = Some(run.stage("camera", |warnings| {
            let mut seen = view::look(&mut scene, eye);
            seen.outside += unmade;
            let shown = scene.instances.len();
            if shown == 0 && !survey.trees.is_empty() {
                warnings.push(view::blind(&survey));
            }
            let outcome = Outcome::items(survey.trees.len(), "trees", shown, "seen")
                .note(format!("{} outside the picture, {} hidden", seen.outside, seen.hidden));
            Ok((seen, outcome))
        })?);
    }
    let tolerance_m = job.wood.tolerance_m.unwrap_or(0.0);
    let mut rows = Vec::new();
    let forms = job.forms();
    if !forms.is_empty() {
        run.stage("levels", |warnings| {
            let told_m =
                seen.as_ref().map(|seen| seen.told_m(&scene, tolerance_m, job.scene_triangles));
            let told_m = |p: usize| told_m.as_ref().map_or(Some(f32::INFINITY), |told| told[p]);
            let (sheet_px, cache) = (job.sheet_px(), &job.cache);
            levels::add(&mut scene, coarse, &materials, &forms, sheet_px, cache, told_m)?;
            rows = level_table::rows(&scene);
            Ok(((), level_table::outcome(&rows, scene.prototypes.len(), warnings)))
        })?;
    }
    let mut chosen = None;
    if let Some(seen) = &seen {
        chosen = Some(run.stage("choice", |warnings| {
            let chosen = view::choose(&mut scene, seen, tolerance_m, job.scene_triangles);
            let shown = scene.instances.len();
            let (total, taken) = (job.scene_triangles.unwrap_or(usize::MAX), chosen.triangles);
            if taken > total {
                warnings.push(format!(
                    "--scene-triangles {total}: the {shown} trees in the picture take {taken} in their \
                     coarsest forms; give more, or show fewer (--clip, --camera)"
                ));
            }
            let mut outcome = Outcome::items(shown, "trees", scene.prototypes.len(), "forms");
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
        let is_shared = plans.iter().any(|plan| plan.bound == Bound::Scene);
        let bound = if is_shared { Bound::Scene } else { Bound::Triangles };
        let outcome = tolerance::outcome(&reached, bound, warnings);
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
            let bound = if r.is_within() { Bound::Tolerance } else { plan.bound };
            *plan = Plan { is_rough: r.is_rough, bound, ..Plan::of(r.triangles) };
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
) -> Result<(Vec<Vec<TreeMesh>>, Vec<f32>)> {
    run.stage("mesh", |warnings| {
        let meshed = job.forms().meshed;
        let made: Vec<(Vec<TreeMesh>, f32)> = plans
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
                    let (mesh, factor) = coarsest::alone(&subject, &options, height_m)?;
                    return Ok((vec![mesh], factor));
                }
                levels::meshes(&subject, &options, meshed, height_m, &job.cache)
            })
            .collect::<Result<_>>()?;
        let (meshes, scales): (Vec<_>, Vec<_>) = made.into_iter().unzip();
        let Grown { models, skeletons, looks, textures, .. } = grown;
        let nodes = skeletons.iter().map(Skeleton::len).sum();
        let triangles = meshes.iter().flatten().map(TreeMesh::triangles).sum();
        let finest = meshes.iter().filter_map(|of_model| of_model.first());
        let outcome = Outcome::items(nodes, "nodes", triangles, "triangles")
            .error(tolerance::sagitta(finest.clone(), job.wood.tolerance_m, warnings));
        let is_bare = models.iter().any(|m| looks[m.species].foliage.is_bare());
        let what = if is_bare { "leaves, needles or buds" } else { "leaves or needles" };
        let outcome = told::leaves(finest.clone(), what, "", outcome);
        let planned = || {
            let planned = models.iter().zip(plans).filter(|(m, _)| textures[m.species].is_some());
            planned.zip(finest.clone()).map(|((m, plan), mesh)| (m.species, mesh, plan.bound))
        };
        told::thin(planned().map(|(k, mesh, bound)| (&looks[k], mesh, bound)), warnings);
        told::thin_levels(meshes.iter().map(|of_model| &of_model[..]), warnings);
        for (k, species) in looks.iter().enumerate() {
            let its = planned().filter(|its| its.0 == k).map(|its| its.1);
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
        Ok(((meshes, scales), outcome))
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
        for (look, _) in looks.iter().zip(&is_used).filter(|(_, used)| **used) {
            told::remarks(look, job.foliage, size_px, warnings);
        }
        let used = textures.iter().flatten();
        let pictures = used.clone().map(TreeTextures::pictures).sum();
        let outcome = Outcome::items(used.count(), "species", pictures, "pictures");
        Ok((textures, outcome))
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
