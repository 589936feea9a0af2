//! What is typed, as jobs; what can't be made or held is refused before any work.

use super::args::{self, ScanArgs, SceneArgs, TreeArgs};
use crate::cache::Cache;
use crate::diagnostic::{Error, Result};
use crate::export::{Format, Profile, WindAs};
use crate::ground::Method;
use crate::lod;
use crate::mesh::{FoliageLevel, Junctions, WindProfile, lightmap};
use crate::pipeline::goal::Goal;
use crate::pipeline::{self, Effort, ForestJob, LevelsJob, Sharing, SurveyJob, WoodJob};
use crate::report::Recorder;
use crate::scan;
use crate::scene::{ColliderShape, identifier};
use crate::seed::Seed;
use crate::species::assign::SpeciesBy;
use crate::species::state::State;
use crate::species::{self, Species};

/// Species to choose among where none are named.
const DEFAULT_MIX: [&str; 5] =
    ["larix_sibirica", "betula_pendula", "pinus_sylvestris", "picea_obovata", "salix_caprea"];

/// Most triangles of a tree model in a forest, and of a tree alone; with every leaf of it.
const FOREST_TRIANGLES: [usize; 2] = [5_000, 200_000];
pub(super) const TREE_TRIANGLES: [usize; 2] = [20_000, 1_000_000];
/// Where the tolerance says how many they are.
const TOLERANCE_TRIANGLES: [usize; 2] = [100_000, 1_000_000];

pub(super) fn seed(value: u64) -> Seed {
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
    .remedy("give one of them a `name` that differs in its letters or digits")
}

pub(super) fn survey_job(scan: &ScanArgs, tree: &TreeArgs) -> Result<SurveyJob> {
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

pub(super) fn files(scan: &ScanArgs) -> scan::Files {
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
pub(super) fn scene_extensions(others: &[&'static str]) -> Vec<&'static str> {
    Format::ALL.iter().map(|format| format.extension()).chain(others.iter().copied()).collect()
}

pub(super) fn formats(typed: &[args::Format]) -> Vec<Format> {
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

pub(super) fn level(typed: args::Foliage) -> FoliageLevel {
    match typed {
        args::Foliage::Geometry => FoliageLevel::Geometry,
        args::Foliage::Cards => FoliageLevel::Cards,
        args::Foliage::Sparse => FoliageLevel::Sparse,
        args::Foliage::Shell => FoliageLevel::Shell,
        args::Foliage::None => FoliageLevel::None,
    }
}

/// `usual`: without and with every leaf.
pub(super) fn triangles(
    typed: Option<u32>,
    wood: &args::WoodArgs,
    usual: [usize; 2],
    level: FoliageLevel,
) -> usize {
    let usual = if wood.tolerance.is_some() { TOLERANCE_TRIANGLES } else { usual };
    typed.map_or(usual[usize::from(level == FoliageLevel::Geometry)], |n| n as usize)
}

pub(super) fn wood(a: &args::WoodArgs) -> WoodJob {
    let junctions = match a.junctions {
        args::JoinedBy::Weld => Junctions::Welded,
        args::JoinedBy::Intersect => Junctions::Intersecting,
    };
    WoodJob { junctions, tolerance_m: a.tolerance }
}

pub(super) fn forest_job(survey: SurveyJob, scene: &SceneArgs, cache: Cache) -> ForestJob {
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

pub(super) fn state(typed: &args::StateArgs) -> State {
    State { condition: typed.condition, season: typed.season }
}

pub(super) fn goal(a: &args::Forest) -> Option<Goal> {
    a.goal.error.map(Goal::Error).or(a.goal.time.map(Goal::Time))
}

/// As typed; what is not typed is as the profile's readers expect it, where one of the formats holds it.
pub(super) fn levels_job(typed: &args::LevelArgs, formats: &[Format]) -> LevelsJob {
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

pub(super) fn profile(typed: args::Profile) -> Profile {
    match typed {
        args::Profile::Dcc => Profile::Dcc,
        args::Profile::Engine => Profile::Engine,
        args::Profile::Web => Profile::Web,
    }
}

pub(super) fn wind_as(typed: args::WindAs) -> WindAs {
    match typed {
        args::WindAs::Attribute => WindAs::Attribute,
        args::WindAs::Color => WindAs::Color,
    }
}

/// Before any work: whether this program can make what is asked for.
pub(super) fn check_levels(typed: &args::LevelArgs, formats: &[Format]) -> Result<()> {
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

/// Before any work.
pub(super) fn check_scene(scene: &SceneArgs, run: &mut Recorder) -> Result<()> {
    let formats = formats(&scene.format);
    check_levels(&scene.levels, &formats)?;
    check_pictures(scene.texture, scene.height_maps)?;
    run.warnings.extend(check_held(&extras(&scene.levels, &scene.state), &formats)?);
    run.warnings.extend(not_held(&scene.levels, &formats));
    let levels = levels_job(&scene.levels, &formats);
    let plain = extensions(formats.iter().filter(|f| !f.holds_extras()));
    if scene.camera.is_some()
        && scene.levels.impostor == Some(args::Impostor::Octahedral)
        && !plain.is_empty()
    {
        let error = format!(
            "--camera may show a tree by its impostor alone, and {plain} files hold no octahedral one"
        );
        return Err(Error::new(error).remedy("take --impostor cross, or write other files"));
    }
    if scene.camera.is_some() && (levels.meshed > 0 || levels.impostor.is_some()) {
        run.warnings.push(
            "--camera shows each tree in the one form that serves its distance: no other levels or impostors \
             are written; leave --camera out for those"
                .into(),
        );
    }
    Ok(())
}

/// Whether there are twigs to store once each, and nothing asked for that differs from one to another.
pub(super) fn check_twigs(
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

/// Whether a file will hold what is asked for. A warning where another does not.
pub(super) fn check_held(asked: &[&str], formats: &[Format]) -> Result<Option<String>> {
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

pub(super) fn check_pictures(texture_px: u32, height_maps: bool) -> Result<()> {
    if height_maps && texture_px == 0 {
        return Err(Error::new("--height-maps asks for pictures, and --texture 0 for none")
            .remedy("give --texture a size, or leave out --height-maps"));
    }
    Ok(())
}

/// Options by which something is asked for that not every file holds.
pub(super) fn extras(levels: &args::LevelArgs, state: &args::StateArgs) -> Vec<&'static str> {
    let asked = [
        ("--impostor octahedral", levels.impostor == Some(args::Impostor::Octahedral)),
        ("--collision", !matches!(levels.collision, None | Some(args::Collision::None))),
        ("--wind", !matches!(levels.wind, None | Some(args::Wind::None))),
        ("--lightmap-uv", levels.lightmap_uv.is_some()),
        ("--variants", state.variants),
    ];
    asked.into_iter().filter_map(|(option, is_asked)| is_asked.then_some(option)).collect()
}

/// A warning of what a profile stands for and a file does not hold.
pub(super) fn not_held(levels: &args::LevelArgs, formats: &[Format]) -> Option<String> {
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

#[cfg(test)]
mod tests {
    use super::*;

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
            (file("a.toml", "Ель"), file("b.toml", "El"), file("c.toml", "Oak"));
        assert_eq!(load_species(&[one.clone(), three.clone(), one.clone()]).unwrap().len(), 2);
        let told = load_species(&[one, three.clone(), two]).unwrap_err();
        assert!(told.message().contains("are both `El` in a scene"), "{told}");
        let told = load_species(&[three, file("d.toml", "Oak")]).unwrap_err();
        assert!(told.message().contains("are both named Oak"), "{told}");
    }
}
