//! What a scene needs of its trees: those within a box; those that a camera sees, each in the
//! cheapest form that looks the same from there; triangles where they show.

use std::collections::BTreeMap;

use glam::{DVec3, Vec2, Vec3};

use super::levels;
use super::survey::Survey;
use crate::diagnostic::{Error, Result};
use crate::frame::Frame;
use crate::render::capture;
use crate::render::{self, Camera, RenderOptions};
use crate::scene::sharing::Model;
use crate::scene::{
    Instance, Level, PICTURE_ASPECT, PICTURE_LINES, Part, Prototype, Scene, plain_rms_m,
};
use crate::work::{self, Work};

/// Where a picture will be taken from; the scan's own coordinates.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Eye {
    pub at: DVec3,
    pub look: DVec3,
    /// Vertical angle of view.
    pub fov_deg: f32,
}

/// A box on the ground; the scan's own coordinates.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Clip {
    pub west: f64,
    pub south: f64,
    pub east: f64,
    pub north: f64,
}

/// What a camera made of a scene.
#[derive(Debug, Clone, Default, PartialEq, serde::Serialize)]
pub struct Chosen {
    /// Trees beside or behind the picture.
    pub outside: usize,
    /// Trees that others or the ground hide.
    pub hidden: usize,
    /// Trees shown in each form.
    pub shown: BTreeMap<String, usize>,
    /// Pixels that a silhouette is off at most: 1, or more where fewer triangles were to be had.
    pub off_px: f32,
    /// Triangles in place if all trees were shown in their finest form, and as they are.
    pub triangles_before: usize,
    pub triangles: usize,
    /// Bytes of the finest forms of all models that were made less those of the forms that are shown.
    pub spared_bytes: u64,
}

/// What a camera sees of a scene.
pub struct Seen {
    pub outside: usize,
    pub hidden: usize,
    /// Of all trees, in their finest form.
    triangles: usize,
    /// Of each tree that is left: what a pixel spans at its near side.
    pixel_m: Vec<f32>,
}

/// Drops the trees that the camera does not see. Known limit: shadows and reflections of what is dropped are
/// missing.
pub fn look(scene: &mut Scene, eye: &Eye) -> Seen {
    work::count(Work::TreesLookedFor, scene.instances.len());
    let camera = camera(&scene.frame, eye);
    let options = RenderOptions {
        width: (PICTURE_LINES * PICTURE_ASPECT) as u32,
        height: PICTURE_LINES as u32,
        supersample: 1,
        ..RenderOptions::default()
    };
    let seen = render::seen(&render::View::from(&*scene), &camera, &options);
    let of_each: Vec<usize> = scene.prototypes.iter().map(|p| triangles(&p.parts)).collect();
    let mut of_all = Seen { outside: 0, hidden: 0, triangles: 0, pixel_m: Vec::new() };
    let mut seen = seen.into_iter();
    scene.instances.retain(|tree| {
        of_all.triangles += of_each[tree.prototype as usize];
        match seen.next().flatten() {
            None => of_all.outside += 1,
            Some(false) => of_all.hidden += 1,
            Some(true) => {
                let size_m = [tree.facts.height_m, tree.facts.crown_diameter_m];
                of_all.pixel_m.push(pixel_m(&camera, tree.position, size_m));
                return true;
            }
        }
        false
    });
    of_all
}

impl Seen {
    /// Of each prototype: the largest error that the camera, whatever is asked of it, lets pass in one of its
    /// trees; `None` where it sees none.
    pub fn told_m(&self, scene: &Scene, tolerance_m: f32, most: Option<usize>) -> Vec<Option<f32>> {
        let mut out = vec![None; scene.prototypes.len()];
        for (tree, pixel_m) in scene.instances.iter().zip(&self.pixel_m) {
            let told_m = match most {
                None => pixel_m.max(tolerance_m) / tree.scale.max_element(),
                Some(_) => f32::INFINITY,
            };
            let of = &mut out[tree.prototype as usize];
            *of = Some(of.map_or(told_m, |m: f32| m.max(told_m)));
        }
        out
    }
}

/// Shows the trees that are left in the form of fewest
/// triangles whose silhouette is off by no more than a pixel of 1,080 lines, or `tolerance_m`,
/// RMS, and whose texels are no larger where it is an impostor. By as few pixels more, the same for
/// all, as make them take no more than `most` triangles, if their forms allow that. Forms become
/// prototypes of their own.
pub fn choose(scene: &mut Scene, seen: &Seen, tolerance_m: f32, most: Option<usize>) -> Chosen {
    let forms: Vec<Vec<Form>> = scene.prototypes.iter().map(|p| forms(p, scene)).collect();
    let mut chosen = Chosen {
        outside: seen.outside,
        hidden: seen.hidden,
        triangles_before: seen.triangles,
        ..Chosen::default()
    };
    let bytes = |scene: &Scene| -> u64 {
        scene.prototypes.iter().flat_map(|p| &p.parts).map(|part| part.surface.bytes()).sum()
    };
    let bytes_before = bytes(scene);
    // New prototypes, by the old one and its form.
    let mut number: BTreeMap<(u32, usize), u32> = BTreeMap::new();
    // Of each tree, and each of its forms: how far off, in pixels.
    let off = |(tree, pixel_m): (&Instance, &f32)| -> Vec<(usize, f32)> {
        let off = |form: &Form| {
            let off_m = form.error_m * tree.scale.max_element();
            if off_m <= tolerance_m { 0.0 } else { off_m / pixel_m }
        };
        forms[tree.prototype as usize].iter().map(|form| (form.triangles, off(form))).collect()
    };
    let off_px: Vec<_> = scene.instances.iter().zip(&seen.pixel_m).map(off).collect();
    chosen.off_px = least_off(&off_px, most.unwrap_or(usize::MAX));
    for (tree, off_px) in scene.instances.iter_mut().zip(&off_px) {
        let k = cheapest(off_px, chosen.off_px);
        let form = &forms[tree.prototype as usize][k];
        *chosen.shown.entry(form.name.clone()).or_default() += 1;
        chosen.triangles += form.triangles;
        let next = number.len() as u32;
        tree.prototype = *number.entry((tree.prototype, k)).or_insert(next);
    }
    let mut order: Vec<((u32, usize), u32)> = number.into_iter().collect();
    order.sort_unstable_by_key(|&(_, new)| new);
    scene.prototypes = order
        .into_iter()
        .map(|((old, form), _)| {
            let of = &scene.prototypes[old as usize];
            let Some(level) = form.checked_sub(1).and_then(|k| of.levels.get(k)) else {
                return Prototype { levels: Vec::new(), ..of.clone() };
            };
            Prototype {
                scattered: Vec::new(),
                name: format!("{}_{}", of.name, level.name),
                species: of.species.clone(),
                parts: level.parts.clone(),
                levels: Vec::new(),
                colliders: of.colliders.clone(),
                silhouette: Some(level.silhouette),
                octahedral: level.octahedral,
            }
        })
        .collect();
    chosen.spared_bytes = bytes_before.saturating_sub(bytes(scene));
    chosen
}

/// Of a tree's forms that are off by no more than so many pixels, that of fewest triangles.
fn cheapest(forms: &[(usize, f32)], off_px: f32) -> usize {
    let fit = (0..forms.len()).filter(|&k| forms[k].1 <= off_px);
    fit.min_by_key(|&k| forms[k].0).unwrap_or(0)
}

/// The fewest pixels, from 1 on, that trees must be off for all to take `most` triangles; if none are
/// enough, those at which all are as coarse as can be.
fn least_off(trees: &[Vec<(usize, f32)>], most: usize) -> f32 {
    let taken = |off_px| trees.iter().map(|of| of[cheapest(of, off_px)].0).sum::<usize>();
    if taken(1.0) <= most {
        return 1.0;
    }
    let of_forms = trees.iter().flatten().map(|&(_, px)| px);
    let mut steps: Vec<f32> = of_forms.filter(|px| px.is_finite() && *px > 1.0).collect();
    steps.sort_unstable_by(f32::total_cmp);
    let enough = steps.partition_point(|&off_px| taken(off_px) > most);
    steps.get(enough).or(steps.last()).copied().unwrap_or(1.0)
}

/// Drops the models none of whose trees can be in the picture, before they are made; gives how many
/// trees that leaves out. The other trees keep their models, whatever the camera.
pub(super) fn cull(models: &mut Vec<Model>, survey: &Survey, eye: &Eye) -> usize {
    let camera = camera(&survey.frame, eye);
    let mut dropped = 0;
    models.retain(|model| {
        let may_show = model.members.iter().any(|&i| may_show_tree(&camera, survey, i));
        if !may_show {
            dropped += model.members.len();
        }
        may_show
    });
    dropped
}

/// How many trees can be in the picture.
pub(super) fn in_sight(survey: &Survey, eye: &Eye) -> usize {
    let camera = camera(&survey.frame, eye);
    (0..survey.trees.len()).filter(|&i| may_show_tree(&camera, survey, i)).count()
}

fn may_show_tree(camera: &Camera, survey: &Survey, i: usize) -> bool {
    let crown = &survey.trees[i].crown;
    may_show(camera, crown.root, [crown.height_m, crown.diameter_m])
}

/// Whether a tree may be in the picture: false only where a sphere well about it is outside.
fn may_show(camera: &Camera, root: Vec3, [height_m, crown_diameter_m]: [f32; 2]) -> bool {
    let middle = root + Vec3::Z * (0.5 * height_m);
    let around_m = height_m.hypot(crown_diameter_m) + 1.0;
    let Some(forward) = (camera.target - camera.eye).try_normalize() else { return true };
    let [right, up] = capture::sides(forward);
    let to = middle - camera.eye;
    let ahead = to.dot(forward);
    let slope = (0.5 * camera.fov_y_rad).tan();
    let is_within = |aside: f32, slope: f32| {
        aside.abs() <= slope * ahead + around_m * (1.0 + slope * slope).sqrt()
    };
    ahead >= -around_m
        && is_within(to.dot(up), slope)
        && is_within(to.dot(right), slope * PICTURE_ASPECT)
}

/// What a pixel spans at the near side of a tree.
fn pixel_m(camera: &Camera, root: Vec3, [height_m, crown_diameter_m]: [f32; 2]) -> f32 {
    let middle = root + Vec3::Z * (0.5 * height_m);
    let reach = 0.5 * height_m.max(crown_diameter_m);
    let distance_m = (camera.eye.distance(middle) - reach).max(0.1);
    distance_m * 2.0 * (0.5 * camera.fov_y_rad).tan() / PICTURE_LINES
}

/// The least error that the camera can tell of a tree at a place of the frame, metres.
pub fn told_m(frame: &Frame, eye: &Eye, root: Vec3, height_m: f32, crown_diameter_m: f32) -> f32 {
    pixel_m(&camera(frame, eye), root, [height_m, crown_diameter_m])
}

pub(super) fn camera(frame: &Frame, eye: &Eye) -> Camera {
    Camera {
        eye: frame.local_from_world(eye.at),
        target: frame.local_from_world(eye.look),
        fov_y_rad: eye.fov_deg.to_radians(),
    }
}

/// A prototype's form as the choice sees it.
struct Form {
    name: String,
    triangles: usize,
    /// The silhouette's; a texel of an impostor where that is more.
    error_m: f32,
}

/// What a texel of an impostor's sheet spans; 0 of other forms.
fn texel_m(level: &Level, scene: &Scene) -> f32 {
    if level.name != levels::IMPOSTOR {
        return 0.0;
    }
    let [sheet] = &level.parts[..] else { return 0.0 };
    let texture = scene.materials[sheet.material as usize].base_color_texture;
    let lines = texture.map_or(1, |t| scene.textures[t as usize].image.height());
    let [low, high] =
        [Vec2::min, Vec2::max].map(|end| sheet.surface.uv.iter().copied().reduce(end));
    let shown = low.zip(high).map_or(1.0, |(low, high)| high.y - low.y) * lines as f32;
    let (low, high) = sheet.surface.bounds();
    (high.z - low.z) / shown.max(1.0)
}

fn triangles(parts: &[Part]) -> usize {
    parts.iter().map(|p| p.surface.triangles()).sum()
}

fn forms(prototype: &Prototype, scene: &Scene) -> Vec<Form> {
    let finest = Form { name: "LOD0".into(), triangles: triangles(&prototype.parts), error_m: 0.0 };
    let coarser = prototype.levels.iter().map(|l| Form {
        name: l.name.clone(),
        triangles: triangles(&l.parts),
        error_m: plain_rms_m(l.silhouette, l.octahedral).max(texel_m(l, scene)),
    });
    [finest].into_iter().chain(coarser).collect()
}

/// West, south, east and north end of the terrain, in the scan's coordinates.
fn extent(survey: &Survey) -> String {
    let g = &survey.terrain.heights.geometry;
    let corner = |x: f64, y: f64| survey.frame.world_from_local(Vec3::new(x as f32, y as f32, 0.0));
    let (a, b) = (corner(g.west, g.south()), corner(g.east(), g.north));
    format!("{:.0},{:.0},{:.0},{:.0}", a.x, a.y, b.x, b.y)
}

/// What to tell where the camera sees no tree.
pub fn blind(survey: &Survey) -> String {
    let heights = survey.terrain.heights.data.iter().filter(|z| z.is_finite());
    let (low, high) =
        heights.fold((f32::INFINITY, f32::NEG_INFINITY), |(a, b), z| (a.min(*z), b.max(*z)));
    let [low, high] = [low, high].map(|z| survey.frame.world_from_local(Vec3::Z * z).z);
    format!(
        "the camera sees none of the {} trees: the scan reaches from {} (west, south, east, north), its \
         ground from {low:.0} to {high:.0}",
        survey.trees.len(),
        extent(survey)
    )
}

/// Cuts terrain and trees to the box; gives how many trees stood outside.
///
/// # Errors
/// A box that shares no ground with the scan.
pub fn clip(survey: &mut Survey, clip: &Clip) -> Result<usize> {
    let world = |x, y| survey.frame.local_from_world(survey.frame.origin.with_x(x).with_y(y));
    let (low, high) = (world(clip.west, clip.south), world(clip.east, clip.north));
    let Some(terrain) = survey.terrain.cropped(low.truncate(), high.truncate()) else {
        return Err(Error::new("the box to clip to lies outside the scan")
            .remedy(format!("give --clip WEST,SOUTH,EAST,NORTH within {}", extent(survey))));
    };
    let is_inside = |p: Vec2| (p.cmpge(low.truncate()) & p.cmplt(high.truncate())).all();
    let before = survey.trees.len();
    let kept: Vec<bool> = survey.trees.iter().map(|t| is_inside(t.crown.root.truncate())).collect();
    let mut keep = kept.iter();
    survey.trees.retain(|_| keep.next().copied().unwrap_or(false));
    let mut keep = kept.iter();
    survey.species.retain(|_| keep.next().copied().unwrap_or(false));
    survey.terrain = terrain;
    Ok(before - survey.trees.len())
}

/// Triangles for each model, between `least` and `most`, so that all trees in their places take
/// `total` as far as these let them. A silhouette's error goes with size over the root of the
/// triangles; the sum of errors over all trees is least where a model's triangles go with its size to
/// the power 2/3, however many trees share it.
///
/// `models`: size in metres and trees of each.
pub fn shared_budget(
    models: &[(f32, usize)],
    total: usize,
    [least, most]: [usize; 2],
) -> Vec<usize> {
    /// Of halving what a model of one metre is given.
    const STEPS: usize = 64;
    let weight = |size_m: f32| f64::from(size_m.max(0.1)).powf(2.0 / 3.0);
    let given = |metre: f64| {
        let one = move |&(size_m, _): &(f32, usize)| {
            ((metre * weight(size_m)) as usize).clamp(least, most.max(least))
        };
        models.iter().map(one)
    };
    let taken = |metre: f64| -> f64 {
        given(metre).zip(models).map(|(t, &(_, trees))| t as f64 * trees as f64).sum()
    };
    // The smallest there is has a fifth of a metre's.
    let (mut fits, mut exceeds) = (0.0, 5.0 * most.max(least) as f64 + 5.0);
    for _ in 0..STEPS {
        let half = 0.5 * (fits + exceeds);
        if taken(half) <= total as f64 { fits = half } else { exceeds = half }
    }
    given(fits).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::Surface;
    use crate::raster::Picture;
    use crate::scene::{Apart, Colorspace, Texture, sample};

    #[test]
    fn a_budget_is_spent_whole_and_more_on_what_is_larger() {
        let models = [(8.0f32, 100usize), (27.0, 10), (1.0, 3)];
        let given = shared_budget(&models, 1_000_000, [200, 1_000_000]);
        let spent: usize = given.iter().zip(&models).map(|(t, m)| t * m.1).sum();
        assert!(spent <= 1_000_000 && spent > 999_000, "{spent}");
        // 27^(2/3) = 9, 8^(2/3) = 4.
        assert!((given[1] as f64 / given[0] as f64 - 2.25).abs() < 1e-2);
        // What one may not take the others do, and what one must have the others give.
        let spent =
            |given: &[usize]| given.iter().zip(&models).map(|(t, m)| t * m.1).sum::<usize>();
        for [least, most] in [[200, 10_000], [8_000, 12_000], [9_000, 9_500]] {
            let given = shared_budget(&models, 1_000_000, [least, most]);
            assert!(given.iter().all(|t| (least..=most).contains(t)), "{given:?}");
            let is_spent = (990_000..=1_000_000).contains(&spent(&given));
            assert!(is_spent || given.iter().all(|t| *t == least || *t == most), "{given:?}");
        }
        assert_eq!(shared_budget(&models, 100, [200, 5_000]), [200; 3]);
        assert_eq!(shared_budget(&models, usize::MAX, [200, 5_000]), [5_000; 3]);
        assert!(shared_budget(&[], 100, [200, 5_000]).is_empty());
    }

    #[test]
    fn what_may_not_show_is_outside_the_picture() {
        let scene = sample::forest(&["Betula pendula"], 60, 60.0);
        let middle = scene.frame.origin;
        let mut culled = 0;
        for k in 0..12 {
            let (s, c) = (0.5 * k as f64).sin_cos();
            let at = middle + DVec3::new(10.0 * c, 10.0 * s, 6.0 + k as f64);
            let look = at + DVec3::new(-s, c, -0.1 * (k % 4) as f64) * 30.0;
            let eye = Eye { at, look, fov_deg: 20.0 + 5.0 * k as f32 };
            let camera = camera(&scene.frame, &eye);
            let size = |t: &crate::scene::Instance| [t.facts.height_m, t.facts.crown_diameter_m];
            let mut near = scene.clone();
            near.instances.retain(|t| may_show(&camera, t.position, size(t)));
            culled += scene.instances.len() - near.instances.len();
            let names = |scene: &Scene| -> Vec<String> {
                let mut seen = scene.clone();
                super::look(&mut seen, &eye);
                seen.instances.iter().map(|t| t.name.clone()).collect()
            };
            assert_eq!(names(&near), names(&scene), "{k}");
        }
        assert!(culled > 200, "{culled}");
    }

    fn shown(scene: &mut Scene, eye: &Eye, most: Option<usize>) -> Chosen {
        let seen = look(scene, eye);
        choose(scene, &seen, 0.0, most)
    }

    #[test]
    fn a_camera_keeps_what_it_sees() {
        let scene = sample::forest(&["Betula pendula"], 40, 60.0);
        let mut seen = scene.clone();
        // From far away, everything; turned away, nothing.
        let middle = scene.frame.origin;
        let eye = |at: DVec3, look: DVec3| Eye { at, look, fov_deg: 40.0 };
        let far = eye(middle + DVec3::new(0.0, -300.0, 200.0), middle);
        let all = shown(&mut seen, &far, None);
        assert_eq!(all.outside, 0);
        assert_eq!(all.hidden + all.shown.values().sum::<usize>(), scene.instances.len());
        assert!(all.hidden < 4, "{all:?}");
        seen.prune();
        seen.validate().unwrap();
        let mut none = scene.clone();
        let away = eye(far.at, far.at * 2.0 - middle);
        assert_eq!(shown(&mut none, &away, None).outside, scene.instances.len());
        assert!(none.instances.is_empty() && none.prototypes.is_empty());
    }

    #[test]
    fn triangles_are_spent_where_the_camera_is_near() {
        let mut scene = sample::forest(&["Betula pendula"], 40, 60.0);
        // Levels of 8, 4, 2 and 1 in 16 of a model's triangles, off by more and more.
        let mut finest = scene.prototypes[0].parts.clone();
        finest.truncate(1);
        finest[0].surface.index = finest[0].surface.index.repeat(16);
        let level = |k: usize| {
            let mut parts = finest.clone();
            let index = &mut parts[0].surface.index;
            index.truncate(index.len() >> k);
            let silhouette = Apart { worst_m: 0.1, rms_m: 0.05 * k as f32 };
            Level { name: format!("LOD{k}"), parts, silhouette, octahedral: None }
        };
        let levels: Vec<Level> = (1..=4).map(level).collect();
        for prototype in &mut scene.prototypes {
            (prototype.parts, prototype.levels) = (finest.clone(), levels.clone());
        }
        let middle = scene.frame.origin;
        let eye = Eye { at: middle + DVec3::new(0.0, -60.0, 40.0), look: middle, fov_deg: 60.0 };
        let chosen = |most| {
            let mut scene = scene.clone();
            let chosen = shown(&mut scene, &eye, most);
            (chosen, scene)
        };
        let (free, _) = chosen(None);
        assert_eq!(free.off_px, 1.0);
        assert_eq!(chosen(Some(free.triangles)).0, free);
        let (_, coarsest) = chosen(Some(0));
        let least = chosen(Some(0)).0.triangles;
        let is_lod4 =
            |p: &Prototype| p.name.ends_with("LOD4") && p.silhouette == Some(levels[3].silhouette);
        assert!(coarsest.prototypes.iter().all(is_lod4));
        assert!(least < free.triangles / 3, "{least} {}", free.triangles);
        let mut before = f32::INFINITY;
        for share in 1..8 {
            let most = least + (free.triangles - least) * share / 8;
            let (of, scene) = chosen(Some(most));
            assert!(of.triangles <= most && of.off_px < before, "{of:?}");
            before = of.off_px;
            // No farther tree is finer than a nearer one, whose forms are the same.
            let camera = camera(&scene.frame, &eye);
            let mut trees: Vec<(f32, &str)> = scene
                .instances
                .iter()
                .map(|t| {
                    let size_m = [t.facts.height_m, t.facts.crown_diameter_m];
                    let pixel_m = pixel_m(&camera, t.position, size_m) / t.scale.max_element();
                    let name = &scene.prototypes[t.prototype as usize].name;
                    (pixel_m, name.rsplit_once("_LOD").map_or("0", |(_, k)| k))
                })
                .collect();
            trees.sort_by(|a, b| a.0.total_cmp(&b.0));
            assert!(trees.is_sorted_by_key(|t| t.1), "{trees:?}");
        }
    }

    /// What nobody could have chosen is not made, and nothing else is chosen for that.
    #[test]
    fn only_what_may_be_chosen_is_made() {
        let scene = sample::forest(&["Betula pendula", "Picea abies"], 60, 60.0);
        let middle = scene.frame.origin;
        let at = middle + DVec3::new(0.0, -260.0, 60.0);
        let eye = Eye { at, look: middle, fov_deg: 30.0 };
        let job = levels::LevelsJob {
            impostor: Some(crate::lod::Kind::Cross),
            ..levels::LevelsJob::default()
        };
        let made = |texture_px: u32, makes_all: bool| {
            let mut scene = scene.clone();
            let seen = look(&mut scene, &eye);
            let told_m = seen.told_m(&scene, 0.0, None);
            let told_m = |p: usize| if makes_all { Some(f32::INFINITY) } else { told_m[p] };
            let cache = crate::cache::Cache::off();
            levels::add(&mut scene, Vec::new(), &[], &job, texture_px, &cache, told_m).unwrap();
            let baked = scene.prototypes.iter().filter(|p| !p.levels.is_empty()).count();
            let chosen = choose(&mut scene, &seen, 0.0, None);
            (baked, chosen, scene.prototypes.iter().map(|p| p.name.clone()).collect::<Vec<_>>())
        };
        let models = scene.prototypes.len();
        for texture_px in [64, 128, 512] {
            let (all, needed) = (made(texture_px, true), made(texture_px, false));
            assert_eq!(all.0, models);
            assert_eq!((&all.1.shown, &all.2), (&needed.1.shown, &needed.2), "{texture_px}");
        }
        assert_eq!(made(64, false).0, 0, "texels are seen");
        assert!(made(512, false).1.shown.contains_key(levels::IMPOSTOR));
    }

    /// A sheet of 10 m that shows the upper half of a picture of 100 lines has texels of 0.2 m.
    #[test]
    fn an_impostor_is_not_shown_where_its_texels_are() {
        let mut scene = sample::forest(&["Betula pendula"], 4, 60.0);
        let picture = Picture::filled(100, 100, [255; 4]);
        let texture =
            Texture { name: "sheet".into(), image: picture.into(), colorspace: Colorspace::Srgb };
        let material = scene.prototypes[0].parts[0].material as usize;
        scene.materials[material].base_color_texture = Some(scene.textures.len() as u32);
        scene.textures.push(texture);
        let corner = |x: f32, z: f32| (Vec3::new(x, 0.0, z), Vec2::new(x, 0.5 + 0.05 * z));
        let (position, uv) =
            [corner(0.0, 0.0), corner(1.0, 0.0), corner(1.0, 10.0)].into_iter().unzip();
        let surface = Surface { position, uv, index: vec![0, 1, 2], ..Surface::default() };
        let part = Part { name: "sheet".into(), surface, material: material as u32 };
        let level = |name: &str| Level {
            name: name.into(),
            parts: vec![part.clone()],
            silhouette: Apart { worst_m: 0.1, rms_m: 0.05 },
            octahedral: None,
        };
        let levels = ["LOD1", levels::IMPOSTOR].map(level).to_vec();
        scene.prototypes[0].levels = levels;
        let errors: Vec<f32> =
            forms(&scene.prototypes[0], &scene).iter().map(|f| f.error_m).collect();
        assert_eq!(errors[..2], [0.0, 0.05]);
        assert!((errors[2] - 0.2).abs() < 1e-5, "{errors:?}");
    }
}
