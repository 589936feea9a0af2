//! Coarser forms of every model, from one skeleton: meshes of fewer triangles, then an impostor,
//! each with how far its silhouette is from the finest form's. What nobody asked for is not made.

use glam::Vec2;
use rayon::prelude::*;

use super::coarsest;
use super::cover::{self, Subject};
use super::detail::{coarser, levels_fall_from};
use super::impostors::{self, Baked};
use super::kept;
use super::model::{Look, parts_of};
use crate::cache::{Cache, Key};
use crate::diagnostic::Result;
use crate::lod::stored::Decides;
use crate::lod::{self, Silhouettes, Views, impostor};
use crate::mesh::{FoliageLevel, MeshOptions, TreeMesh, WindProfile, p18};
use crate::render::capture::Sitter;
use crate::scene::{
    Alpha, Apart, ColliderShape, Level, Material, Part, Prototype, Scene, Texture, Variant,
};
use crate::work::{self, Work};

/// Which forms are made of a model beside the finest.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct LevelsJob {
    /// Meshed levels after the finest, as many as [`SHARES`] says; one more is the scheme of P18.
    pub meshed: usize,
    pub impostor: Option<lod::Kind>,
    pub collision: Option<ColliderShape>,
    pub wind: Option<WindProfile>,
    /// Places on light maps of at most that side, texels, for every form; and for the terrain.
    pub lightmap_px: Option<u32>,
}

/// Triangles of LOD1, LOD2, LOD3 over those of the finest form: 20,000 give 8,000, 3,000 and 500.
/// Of small trees [`share`] gives more; of trees with every leaf [`triangles_of`] tells.
pub const SHARES: [f32; 3] = [0.4, 0.15, 0.025];

/// Triangles below which a crown of cards falls into pieces, and two cones and a cylinder are closer to it.
const LEAST: f32 = 250.0;

/// Triangles of level `k` + 1 over those of the finest, which may have `most`.
pub fn share(most: usize, k: usize) -> f32 {
    let least = LEAST / most.max(1) as f32 / FALL.powi((SHARES.len() - 1 - k) as i32);
    SHARES[k].max(least.min(FALL.powi(k as i32 + 1)))
}

/// Triangles of level `k` + 1 of a tree whose finest form has `most` with this foliage.
pub fn triangles_of(most: usize, foliage: FoliageLevel, k: usize) -> usize {
    let from = levels_fall_from(most, foliage);
    (from as f32 * share(from, k)) as usize
}

/// The name of the last form.
pub(super) const IMPOSTOR: &str = "impostor";

impl LevelsJob {
    pub fn is_empty(&self) -> bool {
        self.meshed == 0 && self.impostor.is_none()
    }
}

/// A model's meshes, from fine to coarse, whose twigs are so large that they cover as much as the
/// finest's, at one scale: whatever grows over the height that is
/// asked for in the finest is shrunk in all, so that stems stay where they are. With how many times as large as
/// the skeleton they are.
///
/// # Errors
/// Those of [`crate::mesh::build`]; a tree that is not finite.
pub fn meshes(
    subject: &Subject<'_>,
    options: &MeshOptions,
    meshed: usize,
    height_m: Option<f32>,
    cache: &Cache,
) -> Result<(Vec<TreeMesh>, f32)> {
    work::count(Work::CoarserForms, meshed);
    let mut out = vec![subject.mesh(options)?];
    let mut forms: Vec<MeshOptions> = Vec::new();
    let mut is_full = true;
    let foliage = options.foliage.of(subject.species);
    for k in 0..meshed.min(SHARES.len()) {
        let form = match (options.triangle_budget, out.last()) {
            (Some(most), Some(finer)) => {
                let even = triangles_of(most, foliage, k);
                let most = levels_fall_from(most, foliage);
                let used = finer.triangles().min(most);
                let given = forms.last().and_then(|form| form.triangle_budget).unwrap_or(most);
                is_full &= used as f32 > FULL * given as f32;
                let triangles = if is_full { even } else { less(most, used, k) };
                MeshOptions { triangle_budget: Some(triangles), ..coarser(options, even) }
            }
            _ => *options,
        };
        out.push(subject.mesh(&form)?);
        forms.push(form);
    }
    cover::keep(subject, &forms, &mut out, cache)?;
    let factor = out.first().map_or(1.0, |finest| height_m.map_or(1.0, |h| finest.factor_to(h)));
    out.par_iter_mut().for_each(|mesh| mesh.scale(factor));
    // Leaves reach above the skeleton, by whose height they were made.
    if let Some(profile) = options.wind {
        let height_m = out[0].bounds().1.z;
        let surfaces = out.par_iter_mut().flat_map_iter(TreeMesh::surfaces_mut);
        surfaces.for_each(|surface| profile.over(height_m, surface));
    }
    if meshed > SHARES.len() {
        out.push(coarsest::of(&out[0], factor, subject, options, p18::MANY_BOUGHS)?);
    }
    Ok((out, factor))
}

/// Share of the triangles given from which on they are taken for all used.
const FULL: f32 = 0.8;
/// Triangles of a small tree's level over those of the one before, at most, as a mean of all to come.
const FALL: f32 = 0.6;

/// Triangles of level `k` + 1 where the one before has all it needs within its own, `used`: the levels fall
/// from those to what the last may have.
fn less(most: usize, used: usize, k: usize) -> usize {
    let last = share(most, SHARES.len() - 1);
    let before = k.checked_sub(1).map_or(1.0, |k| share(most, k));
    let used = used.max(1) as f32;
    let lowest = (most as f32 * last / used).min(FALL.powi((SHARES.len() - k) as i32));
    let steps = (share(most, k) / before).ln() / (last / before).ln();
    (used * lowest.powf(steps)) as usize
}

/// Adds to every prototype of `scene` its coarser meshes (`coarse`, of each prototype from fine to
/// coarse) and its impostor. `told_m`: the error, metres, from which on those who look at any tree of a
/// prototype can tell it; `None` where nobody looks: that prototype gets no other form. No impostor is made
/// whose texels are larger.
///
/// # Errors
/// A model that is not finite.
pub fn add(
    scene: &mut Scene,
    coarse: Vec<Vec<TreeMesh>>,
    looks: &[Look],
    job: &LevelsJob,
    texture_px: u32,
    cache: &Cache,
    told_m: impl Fn(usize) -> Option<f32>,
) -> Result<()> {
    let of_each = scene.prototypes.iter_mut().zip(coarse).zip(looks).enumerate();
    for (_, ((prototype, meshes), look)) in of_each.filter(|(p, _)| told_m(*p).is_some()) {
        for (k, mesh) in meshes.into_iter().enumerate() {
            prototype.levels.push(Level {
                name: format!("LOD{}", k + 1),
                parts: parts_of(mesh, *look),
                silhouette: Apart { worst_m: 0.0, rms_m: 0.0 },
                octahedral: None,
            });
        }
    }
    let bake = |kind| impostors::bake(scene, kind, texture_px, cache, told_m);
    let baked = job.impostor.map(bake).transpose()?;
    for (p, baked) in baked.into_iter().flatten().enumerate() {
        let Some(baked) = baked else { continue };
        let (first_texture, first_material) = (scene.textures.len(), scene.materials.len());
        let Baked { mut part, colour, normal, octahedral, others } = baked;
        if let Some(profile) = job.wind {
            let height_m = bounds(&scene.prototypes[p].parts).1.z;
            profile.whole_tree(height_m, &mut part.surface);
        }
        scene.textures.extend([colour, normal]);
        let variants = others.into_iter().map(|(name, colour)| {
            scene.textures.push(colour);
            let base_color_texture = Some(scene.textures.len() as u32 - 1);
            Variant { name, base_color: [1.0; 3], base_color_texture }
        });
        let variants = variants.collect();
        let stem = scene.prototypes[p].name.clone();
        let shown = scene.prototypes[p].parts.iter().filter(|part| !part.surface.is_empty());
        let shown = shown.map(|part| &scene.materials[part.material as usize]);
        let translucency = shown.clone().map(|m| m.translucency).fold(0.0, f32::max);
        let specular = shown.map(|m| m.specular).fold(1.0, f32::min);
        scene.materials.push(Material {
            base_color_texture: Some(first_texture as u32),
            normal_texture: Some(first_texture as u32 + 1),
            specular,
            translucency,
            alpha: Alpha::Mask { cutoff: impostor::CUTOFF },
            // A cross has sheets for either side.
            double_sided: octahedral.is_some(),
            variants,
            ..Material::plain(format!("{stem}_impostor"), [1.0; 3])
        });
        scene.prototypes[p].levels.push(Level {
            name: IMPOSTOR.into(),
            parts: vec![Part { material: first_material as u32, ..part }],
            silhouette: Apart { worst_m: 0.0, rms_m: 0.0 },
            octahedral,
        });
    }
    measure(scene, cache)
}

/// How far each form's silhouette is from the finest's; of octahedral impostors, as a shader shows
/// them that takes the nearest view.
fn measure(scene: &mut Scene, cache: &Cache) -> Result<()> {
    let Scene { prototypes, materials, textures, .. } = &*scene;
    let with_levels: Vec<&Prototype> = prototypes.iter().filter(|p| !p.levels.is_empty()).collect();
    let key = |p: &&Prototype| -> Result<Option<Key>> {
        if !cache.is_on() {
            return Ok(None);
        }
        let levels = p.levels.iter().map(|level| (&level.parts[..], level.octahedral));
        let forms = std::iter::once((&p.parts[..], None)).chain(levels);
        let decides = Decides::of_forms(forms, materials, textures)?;
        Ok(Some(Key::of(
            [include_bytes!("levels.rs").as_slice()].into_iter().chain(decides.parts()),
        )))
    };
    let keys: Vec<Option<Key>> = with_levels.par_iter().map(key).collect::<Result<_>>()?;
    let kept = |(key, p): (&Option<Key>, &&Prototype)| {
        kept::get(cache, (*key)?, p.levels.len() * OfLevel::NUMBERS)
    };
    let kept: Vec<Option<Vec<f32>>> = keys.iter().zip(&with_levels).map(kept).collect();
    let missing = with_levels.iter().zip(&kept).filter(|(_, kept)| kept.is_none());
    let missing: Vec<&Prototype> = missing.map(|(p, _)| *p).collect();
    let mut found = apart(&missing, materials, textures)?.into_iter();
    let all = keys.iter().zip(kept).map(|(key, kept)| {
        kept.unwrap_or_else(|| {
            let found = found.next().unwrap_or_default();
            let numbers: Vec<f32> = found.into_iter().flat_map(OfLevel::to_array).collect();
            key.iter().for_each(|key| kept::put(cache, *key, &numbers));
            numbers
        })
    });
    let all: Vec<Vec<f32>> = all.collect();
    let with_levels = scene.prototypes.iter_mut().filter(|p| !p.levels.is_empty());
    for (p, numbers) in with_levels.zip(all) {
        let of_each = numbers.as_chunks::<{ OfLevel::NUMBERS }>().0;
        for (level, numbers) in p.levels.iter_mut().zip(of_each) {
            let OfLevel { plain, shown } = OfLevel::from_array(*numbers);
            level.silhouette = shown;
            if let Some(octahedral) = &mut level.octahedral {
                octahedral.sheet_rms_m = plain.rms_m;
            }
        }
    }
    Ok(())
}

/// How far a level's silhouette is from the finest's: as it is, and as its shader shows it.
#[derive(Clone, Copy)]
struct OfLevel {
    plain: Apart,
    shown: Apart,
}

impl OfLevel {
    const NUMBERS: usize = 4;

    fn to_array(self) -> [f32; OfLevel::NUMBERS] {
        let OfLevel { plain, shown } = self;
        [plain.worst_m, plain.rms_m, shown.worst_m, shown.rms_m]
    }

    fn from_array([a, b, c, d]: [f32; OfLevel::NUMBERS]) -> OfLevel {
        let [plain, shown] = [[a, b], [c, d]].map(|[worst_m, rms_m]| Apart { worst_m, rms_m });
        OfLevel { plain, shown }
    }
}

/// Those of all levels of some prototypes.
fn apart(
    prototypes: &[&Prototype],
    materials: &[Material],
    textures: &[Texture],
) -> Result<Vec<Vec<OfLevel>>> {
    let turned: Vec<Vec<Part>> = (prototypes.iter().flat_map(|p| &p.levels))
        .filter_map(|level| Some((level.octahedral.as_ref()?, level.parts.first()?)))
        .flat_map(|(octahedral, part)| {
            let sheet = |eye| impostor::sheet_towards(octahedral, eye);
            lod::looks().map(move |look| vec![Part { surface: sheet(-look), ..part.clone() }])
        })
        .collect();
    let mut models: Vec<&[Part]> = Vec::new();
    let mut first = Vec::new();
    let mut sheets = turned.iter();
    for p in prototypes {
        first.push(models.len() as u32);
        models.push(&p.parts);
        for level in &p.levels {
            models.push(&level.parts);
            if level.octahedral.is_some() {
                models.extend(sheets.by_ref().take(lod::looks().count()).map(|s| &s[..]));
            }
        }
    }
    let sitter = Sitter::covers(&models, materials, textures);
    let of = |(p, &first): (&&Prototype, &u32)| {
        let around = |level: &Level| match &level.octahedral {
            None => bounds(&level.parts),
            Some(octahedral) => {
                let aside_m = lod::looks().map(|look| impostor::aside_m(octahedral, -look));
                let aside = Vec2::splat(aside_m.fold(0.0, f32::max)).extend(0.0);
                let (low, high) = bounds(&p.parts);
                (low - aside, high + aside)
            }
        };
        let all = p.levels.iter().map(around).fold(bounds(&p.parts), union);
        let finest = Silhouettes::of(&sitter, first, all, Views::All)?;
        let mut model = first + 1;
        let each = p.levels.iter().map(|level| {
            let one = model;
            let views = if level.name == IMPOSTOR { Views::Sides } else { Views::All };
            let plain = finest.apart(&Silhouettes::of(&sitter, one, all, views)?);
            model += 1;
            if level.octahedral.is_none() {
                return Ok(OfLevel { plain, shown: plain });
            }
            model += lod::looks().count() as u32;
            let turned = |look| one + 1 + look as u32;
            let shown = Silhouettes::turning(&sitter, turned, all, Views::All)?;
            Ok(OfLevel { plain, shown: finest.apart(&shown) })
        });
        each.collect()
    };
    prototypes.par_iter().zip(&first).map(of).collect()
}

type Box3 = (glam::Vec3, glam::Vec3);

pub(super) fn union(a: Box3, b: Box3) -> Box3 {
    (a.0.min(b.0), a.1.max(b.1))
}

pub(super) fn bounds(parts: &[Part]) -> Box3 {
    let filled = parts.iter().filter(|p| !p.surface.is_empty());
    filled.map(|p| p.surface.bounds()).reduce(union).unwrap_or_default()
}

#[cfg(test)]
pub(super) mod tests {
    use super::super::detail::{WoodJob, detail};
    use super::*;
    use crate::mesh::Surface;
    use crate::raster::linear_from_srgb;
    use crate::seed::Seed;
    use crate::skeleton::{self, Target};
    use crate::species::state::{Season, State};
    use crate::texture::LeafVariant;

    /// Where a level plane cuts closed wood: each line's ends, and a way out of the wood there.
    fn cuts(tree: &TreeMesh, z: f32) -> Vec<([Vec2; 2], Vec2)> {
        let cut = |wood: &Surface, t: &[u32]| {
            let [a, b, c] = [0, 1, 2].map(|k| wood.position[t[k] as usize]);
            let cut = [(a, b), (b, c), (c, a)].into_iter().filter_map(|(p, q)| {
                let is_cut = (p.z < z) != (q.z < z);
                is_cut.then(|| p.lerp(q, (z - p.z) / (q.z - p.z)).truncate())
            });
            let ends: Vec<Vec2> = cut.collect();
            Some(([*ends.first()?, *ends.get(1)?], (b - a).cross(c - a).truncate()))
        };
        let woods = tree.woods().into_iter();
        woods.flat_map(|w| w.index.chunks_exact(3).filter_map(move |t| cut(w, t))).collect()
    }

    /// What a level plane cuts out of closed wood: the diameter of a circle of that area, and its middle.
    fn section(tree: &TreeMesh, z: f32) -> (f32, Vec2) {
        let (mut twice, mut moment) = (0.0, Vec2::ZERO);
        for ([p, q], out) in cuts(tree, z) {
            let part = p.perp_dot(q) * (q - p).perp_dot(-out).signum();
            (twice, moment) = (twice + part, moment + (p + q) * part);
        }
        ((2.0 * twice.abs() / std::f32::consts::PI).sqrt(), moment / (3.0 * twice))
    }

    /// How wide the same looks, the mean over all sides.
    fn width_m(tree: &TreeMesh, z: f32) -> f32 {
        const SIDES: u32 = 36;
        let cuts = cuts(tree, z);
        let from = |side: u32| {
            let across = Vec2::from_angle(side as f32 * std::f32::consts::PI / SIDES as f32);
            let at = cuts.iter().map(|(ends, _)| ends[0].dot(across));
            at.clone().fold(f32::MIN, f32::max) - at.fold(f32::MAX, f32::min)
        };
        (0..SIDES).map(from).sum::<f32>() / SIDES as f32
    }

    /// A tree of the species grown for so many triangles, and how one of `budget` is meshed.
    pub fn tree_of(
        (name, triangles, budget): (&str, usize, usize),
        make: impl Fn(&Subject<'_>, &MeshOptions) -> Result<Vec<TreeMesh>>,
    ) -> Vec<TreeMesh> {
        let species = crate::species::load(name).unwrap();
        let seed = Seed::new(1);
        let detail = detail(triangles, FoliageLevel::Cards);
        let target = Target::FromSpecies { height_m: None };
        let skeleton = skeleton::grow(&species, target, detail, seed).unwrap();
        let textures = crate::texture::for_species(&species, 64, seed);
        let subject = Subject { skeleton: &skeleton, species: &species, textures: &textures, seed };
        make(&subject, &WoodJob::default().options(budget, FoliageLevel::Cards)).unwrap()
    }

    /// With what an earlier run kept, to the byte; another model or form is another entry.
    #[test]
    fn silhouettes_are_the_same_from_a_cache() {
        let scene = crate::scene::sample::forest(&["Betula pendula", "Picea abies"], 12, 60.0);
        let folder = tempfile::tempdir().unwrap();
        let cache = Cache::in_folder(folder.path());
        let octahedral = lod::Kind::Octahedral { views: 4 };
        let entries = || std::fs::read_dir(folder.path()).unwrap().count();
        let mut before = 0;
        for kind in [lod::Kind::Cross, octahedral] {
            let job = LevelsJob { impostor: Some(kind), ..LevelsJob::default() };
            let told = |cache: &Cache| {
                let mut scene = scene.clone();
                add(&mut scene, Vec::new(), &[], &job, 64, cache, |_| Some(f32::INFINITY)).unwrap();
                let levels = scene.prototypes.iter().flat_map(|p| &p.levels);
                levels.map(|l| (l.silhouette, l.octahedral)).collect::<Vec<_>>()
            };
            let plain = told(&Cache::off());
            assert!(plain.iter().any(|l| l.0.worst_m > 0.0));
            assert_eq!(told(&cache), plain);
            // Of every model an impostor and its silhouettes.
            assert_eq!(entries(), before + 2 * scene.prototypes.len());
            assert_eq!(told(&cache), plain);
            assert_eq!(entries(), before + 2 * scene.prototypes.len());
            before = entries();
        }
    }

    #[test]
    fn every_form_sways_by_the_height_of_the_whole_tree() {
        let trees = tree_of(("quercus_robur", 6_000, 6_000), |subject, options| {
            let options = MeshOptions { wind: Some(WindProfile::Unity), ..*options };
            meshes(subject, &options, SHARES.len() + 1, Some(20.0), &Cache::off())
                .map(|(meshes, _)| meshes)
        });
        assert_eq!(trees.len(), 2 + SHARES.len());
        for (k, tree) in trees.iter().enumerate() {
            let surfaces = tree.woods().into_iter().chain([&tree.foliage]);
            let swaying = surfaces.flat_map(|s| s.position.iter().zip(&s.wind));
            let mut most = 0;
            for (p, colour) in swaying {
                let wanted = 255.0 * (p.z / 20.0).clamp(0.0, 1.0).powi(2);
                assert!((f32::from(colour[2]) - wanted).abs() < 0.6, "form {k}: {colour:?} at {p}");
                most = most.max(colour[2]);
            }
            assert!(most > 230, "form {k}: {most}");
        }
    }

    #[test]
    fn an_impostor_has_the_looks_of_its_tree() {
        let mut scene = crate::scene::sample::forest(&["Betula pendula"], 4, 60.0);
        let leaf = scene.prototypes[0].parts.last().unwrap().material as usize;
        let green = scene.materials[leaf].base_color;
        let red = [green[0], 0.2 * green[1], 0.2 * green[2]];
        let variant = |name: &str, base_color| Variant {
            name: name.into(),
            base_color,
            base_color_texture: scene.materials[leaf].base_color_texture,
        };
        scene.materials[leaf].variants = vec![variant("same", green), variant("autumn", red)];
        let job = LevelsJob { impostor: Some(lod::Kind::Cross), ..LevelsJob::default() };
        add(&mut scene, Vec::new(), &[], &job, 64, &Cache::off(), |_| Some(f32::INFINITY)).unwrap();
        let level = scene.prototypes[0].levels.last().unwrap();
        let material = &scene.materials[level.parts[0].material as usize];
        let picture = |texture: Option<u32>| {
            let texture = &scene.textures[texture.unwrap() as usize];
            (texture.name.clone(), texture.image.picture().data.clone())
        };
        let (own_name, own) = picture(material.base_color_texture);
        let [same, autumn] = &material.variants[..] else { panic!("{:?}", material.variants) };
        assert_eq!((&same.name[..], &autumn.name[..]), ("same", "autumn"));
        assert_eq!(picture(same.base_color_texture).1, own);
        let (name, other) = picture(autumn.base_color_texture);
        assert_eq!(name, format!("{own_name}_autumn"));
        assert!(own.iter().zip(&other).all(|(a, b)| a[3] == b[3]), "cut alike");
        let sum = |all: &[[u8; 4]], k: usize| all.iter().map(|p| u64::from(p[k])).sum::<u64>();
        assert!(4 * sum(&other, 1) < 3 * sum(&own, 1) && sum(&other, 0) == sum(&own, 0));
        scene.prune();
        scene.validate().unwrap();
    }

    /// Pictures of leaves are for leaves.
    #[test]
    fn a_hull_has_a_colour_and_no_picture() {
        let species = crate::species::load("betula_pendula").unwrap();
        let mut textures = crate::texture::for_species(&species, 64, Seed::new(1));
        let (leaf, crown) = (textures.leaf.clone(), [90, 40, 0]);
        textures.leaf_variants.push(LeafVariant { name: "autumn", leaf, crown });
        let hulls = [FoliageLevel::Shell, FoliageLevel::Cards].map(|level| {
            let mut trees = tree_of(("betula_pendula", 2_000, 2_000), |subject, options| {
                let options = MeshOptions { foliage: level, ..*options };
                meshes(subject, &options, SHARES.len() + 1, None, &Cache::off())
                    .map(|(meshes, _)| meshes)
            });
            if level == FoliageLevel::Shell { trees.remove(0) } else { trees.pop().unwrap() }
        });
        for (k, tree) in hulls.into_iter().enumerate() {
            let scene = super::super::model::model_scene(&species, vec![tree], textures.clone());
            let part = scene.prototypes[0].parts.iter().find(|p| p.name == "foliage").unwrap();
            let material = &scene.materials[part.material as usize];
            assert_eq!(material.name, "Betula_pendula_crown", "{k}");
            assert_eq!(material.base_color, textures.crown.map(linear_from_srgb), "{k}");
            assert_eq!(material.textures().count(), 0, "{k}");
            assert_eq!((material.alpha, material.double_sided), (Alpha::Opaque, false), "{k}");
            assert_eq!(material.variants[0].base_color, crown.map(linear_from_srgb), "{k}");
        }
    }

    #[test]
    fn bark_of_a_stem_changes_at_one_height_at_every_level() {
        for name in ["pinus_sibirica", "larix_sibirica", "pinus_sylvestris", "betula_pendula"] {
            let trees = tree_of((name, 20_000, 20_000), |subject, options| {
                meshes(subject, options, SHARES.len() + 1, None, &Cache::off())
                    .map(|(meshes, _)| meshes)
            });
            let height_m = trees[0].bounds().1.z;
            // Branches are too thin for old bark; a cylinder may end below that, in the crown.
            let changes = trees.iter().filter(|t| !t.upper_wood.is_empty());
            let ends_m: Vec<f32> = changes.map(|t| t.wood.bounds().1.z).collect();
            assert!(ends_m.len() > SHARES.len(), "{name}");
            let between_m = trees[0].transition_wood.bounds().1.z - ends_m[0];
            assert!(between_m > 0.0, "{name}");
            let middle_m = ends_m[0] + 0.5 * between_m;
            for (k, end_m) in ends_m.iter().enumerate() {
                let off_m = (end_m - middle_m).abs();
                let most_m = 0.6 * between_m + 0.03 * height_m;
                assert!(off_m < most_m, "{name}, LOD{k}: {end_m} beside {middle_m}");
            }
        }
    }

    #[test]
    fn a_trunk_is_as_thick_and_as_deep_at_every_level() {
        let names = [
            "quercus_robur",
            "larix_sibirica",
            "pinus_sylvestris",
            "betula_pendula",
            "populus_tremula",
        ];
        for (name, triangles) in names.into_iter().flat_map(|n| [(n, 20_000), (n, 5_000)]) {
            let mut all = tree_of((name, triangles, triangles), |subject, options| {
                meshes(subject, options, SHARES.len() + 1, None, &Cache::off())
                    .map(|(meshes, _)| meshes)
            });
            let feet: Vec<f32> = all.iter().map(|tree| tree.bounds().0.z).collect();
            assert!(feet.iter().all(|foot| (foot - feet[0]).abs() < 0.01), "{name}: {feet:?}");
            all.pop();
            if triangles == 20_000 {
                let reach = |tree: &TreeMesh| {
                    let at_ground = |p: &&glam::Vec3| (-0.01..0.05).contains(&p.z);
                    let woods = tree.woods();
                    let foot = woods.iter().flat_map(|wood| &wood.position).filter(at_ground);
                    foot.map(|p| p.truncate().length()).fold(0.0, f32::max)
                };
                let [finest, next] = [0, 1].map(|k| reach(&all[k]));
                assert!((next / finest - 1.0).abs() < 0.03, "{name}: lobes {finest} {next}");
            }
            // Lobes that a coarser level lacks are made up for.
            let of: Vec<f32> = all.iter().map(|tree| width_m(tree, 0.05)).collect();
            let is_kept = of.iter().all(|m| (m / of[0] - 1.0).abs() < 0.05);
            assert!(is_kept, "{name} {triangles}, at the ground: {of:?}");
            for z in [0.05, 0.7, 1.3, 2.5] {
                let of: Vec<f32> = all.iter().map(|tree| section(tree, z).0).collect();
                let is_kept = of.iter().all(|m| (m / of[0] - 1.0).abs() < 0.12);
                assert!(is_kept, "{name} {triangles}, {z} m up: {of:?}");
            }
        }
    }

    /// A birch's leans and bends below its crown.
    #[test]
    fn a_trunk_stays_in_its_place_at_every_level() {
        let all = tree_of(("betula_pendula", 20_000, 20_000), |subject, options| {
            meshes(subject, options, SHARES.len(), None, &Cache::off()).map(|(meshes, _)| meshes)
        });
        for z in [2.0, 3.0, 4.0, 5.0] {
            let of: Vec<_> = all.iter().map(|tree| section(tree, z)).collect();
            let (wide_m, middle) = of[0];
            let is_kept = of.iter().all(|(_, m)| m.distance(middle) < 0.2 * wide_m);
            assert!(is_kept, "{z} m up: {of:?}");
        }
    }

    /// Twigs that stand for many reach inwards.
    #[test]
    fn levels_of_small_bare_trees_are_about_as_wide() {
        let (seed, winter) = (Seed::new(1), State { season: Season::Winter, ..State::default() });
        let trees = [
            ("tilia_cordata", 5.0),
            ("tilia_cordata", 2.0),
            ("sorbus_aucuparia", 5.0),
            ("salix_caprea", 2.0),
            ("quercus_robur", 3.0),
        ];
        for (name, height_m) in trees {
            let species = winter.look(&crate::species::load(name).unwrap(), seed);
            let target = Target::FromSpecies { height_m: Some(height_m) };
            let detail = detail(20_000, FoliageLevel::Cards);
            let skeleton = skeleton::grow(&species, target, detail, seed).unwrap();
            let textures = crate::texture::for_species(&species, 128, seed);
            let subject =
                Subject { skeleton: &skeleton, species: &species, textures: &textures, seed };
            let options = WoodJob::default().options(20_000, FoliageLevel::Cards);
            let all = meshes(&subject, &options, SHARES.len(), None, &Cache::off()).unwrap().0;
            let wide_m: Vec<f32> = all
                .iter()
                .map(|tree| tree.bounds())
                .map(|(low, high)| (high - low).truncate().element_sum())
                .collect();
            let is_kept = wide_m.iter().all(|m| (0.8..1.25).contains(&(m / wide_m[0])));
            assert!(is_kept, "{name}: {wide_m:?}");
        }
    }

    /// Branches that are as thick as each other do not all go at once.
    #[test]
    fn levels_of_a_sapling_keep_some_branches() {
        let species = crate::species::load("pinus_sylvestris").unwrap();
        let seed = Seed::new(1);
        let target = Target::FromSpecies { height_m: Some(2.0) };
        let skeleton =
            skeleton::grow(&species, target, detail(20_000, FoliageLevel::Cards), seed).unwrap();
        let textures = crate::texture::for_species(&species, 64, seed);
        let subject = Subject { skeleton: &skeleton, species: &species, textures: &textures, seed };
        let options = WoodJob::default().options(20_000, FoliageLevel::Cards);
        let all = meshes(&subject, &options, SHARES.len(), None, &Cache::off()).unwrap().0;
        let wood: Vec<usize> = all.iter().map(TreeMesh::wood_triangles).collect();
        assert!(wood[1] * 12 > wood[0] && wood[2] * 2 > wood[3] * 3, "{wood:?}");
    }

    #[test]
    fn few_triangles_are_not_all_the_stem_s() {
        for name in ["larix_sibirica", "pinus_sylvestris", "pinus_sibirica", "populus_tremula"] {
            let made =
                tree_of((name, 20_000, 130), |subject, options| Ok(vec![subject.mesh(options)?]));
            made[0].check().unwrap();
            let [all, leaves] = [made[0].triangles(), made[0].foliage.triangles()];
            assert!(leaves >= 40 && all <= 130, "{name}: {leaves} of {all}");
        }
    }

    #[test]
    fn levels_have_triangles_enough_for_a_crown_and_fall() {
        let of = |most: usize| [0, 1, 2].map(|k| (most as f32 * share(most, k)) as usize);
        assert_eq!(of(20_000), [8_000, 3_000, 500]);
        assert_eq!(of(5_000), [2_000, 750, 250]);
        let of_leaves =
            |most: usize| [0, 1, 2].map(|k| triangles_of(most, FoliageLevel::Geometry, k));
        assert_eq!(of_leaves(1_000_000), [40_000, 15_000, 2_500]);
        assert_eq!(of_leaves(20_000), of(20_000));
        for most in (100..20_000).step_by(7) {
            let fall = [most].into_iter().chain(of(most)).collect::<Vec<_>>();
            assert!(fall.is_sorted_by(|a, b| *b as f32 <= 0.61 * *a as f32), "{fall:?}");
        }
    }

    #[test]
    fn levels_of_a_small_tree_fall_from_what_the_one_before_has() {
        for most in [20_000, 1_000_000] {
            for used in [300, 2_403, 7_426, 17_000] {
                let mut before = used;
                for k in 0..SHARES.len() {
                    let of = less(most, before, k);
                    let is_less = 0 < of && of as f32 <= 0.71 * before as f32;
                    assert!(is_less, "{most} {used} {k}: {of} after {before}");
                    before = of;
                }
                assert!(before <= most / 40, "{most} {used}: {before}");
            }
        }
    }
}
