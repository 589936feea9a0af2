//! What reports and warnings say of meshes: branches without one or unwelded, leaves that stand for others,
//! crowns that are thin, cones that are not borne.

use super::budget::Bound;
use crate::mesh::{FoliageLevel, TreeMesh};
use crate::report::Outcome;
use crate::species::Species;
use crate::species::model::{OwnPart, Remark};

/// Share of the axes thick enough for a mesh above which it is worth a warning that they have none.
const MANY: f32 = 0.05;

/// Adds to a report how many branches of these (finest) meshes have none, or are not welded to their parent; to
/// the warnings where many have none.
pub fn unmeshed<'a>(
    meshes: impl Iterator<Item = &'a TreeMesh>,
    outcome: Outcome,
    warnings: &mut Vec<String>,
) -> Outcome {
    let (mut axes, mut unmeshed, mut unwelded) = (0, 0, 0);
    for mesh in meshes {
        axes += mesh.axes;
        unmeshed += mesh.unmeshed_axes;
        unwelded += mesh.unwelded_axes;
    }
    let outcome = match unwelded {
        0 => outcome,
        _ => outcome.note(format!(
            "{unwelded} of {axes} branches pass into their parent, closed for themselves: there is no room for as many \
             feet that 32-bit places could tell apart"
        )),
    };
    if unmeshed == 0 {
        return outcome;
    }
    let told = format!(
        "{unmeshed} of {axes} branches have no mesh: they end within their parent's bark or collar"
    );
    if unmeshed as f32 > MANY * axes as f32 {
        warnings.push(format!("{told}; --junctions intersect meshes them"));
    }
    outcome.note(told)
}

/// Warns where the finest mesh of a tree has more triangles than it may: a stem of each is kept.
pub fn over(mesh: Option<&TreeMesh>, most: usize, warnings: &mut Vec<String>) {
    let triangles = mesh.map_or(0, TreeMesh::triangles);
    if triangles > most {
        warnings.push(format!(
            "--triangles: {triangles} are made, more than {most}: stems stay, of six sides where they are thick"
        ));
    }
}

/// Adds to a report how much larger than the species' the leaves of these (finest) meshes are, where
/// each is meshed for itself: the largest. Of crowns that are thin all the same [`thin`] warns.
/// `what` they are; `instead`: what else could be done than give more triangles.
pub fn leaves<'a>(
    meshes: impl Iterator<Item = &'a TreeMesh>,
    what: &str,
    instead: &str,
    outcome: Outcome,
) -> Outcome {
    let each = meshes
        .filter(|mesh| mesh.leaf_cover >= THIN)
        .filter_map(|mesh| mesh.stand_in.map(|of| (of.size, whole(mesh, of.whole))));
    let area = |[long, wide]: [f32; 2]| long * wide;
    let largest = each.max_by(|a, b| area(a.0).total_cmp(&area(b.0)));
    match largest {
        Some(([long, wide], whole)) if long.max(wide) > 1.05 => outcome.note(format!(
            "{what} {long:.1} times as long and {wide:.1} times as wide as the species', to hide \
             as much as all of them, which would take about {} --triangles{instead}",
            rounded_up(whole),
        )),
        _ => outcome,
    }
}

/// Adds to a report how many twigs stand where few are stored, and what all of them would take.
pub fn twigs<'a>(meshes: impl Iterator<Item = &'a TreeMesh>, mut outcome: Outcome) -> Outcome {
    for mesh in meshes.filter(|mesh| !mesh.twigs.is_empty()) {
        let places: usize = mesh.twigs.iter().map(|twigs| twigs.places.len()).sum();
        outcome = outcome.note(format!(
            "forms of twigs: {}, at {places} places: {} triangles are seen where {} are stored",
            mesh.twigs.len(),
            mesh.shown_triangles(),
            mesh.triangles(),
        ));
    }
    outcome
}

/// About how many triangles a tree takes all of whose leaves take so many.
fn whole(mesh: &TreeMesh, leaves: usize) -> f32 {
    let [made, dry] = [&mesh.foliage, &mesh.dry].map(|s| s.triangles() as f32);
    let twigs = leaves as f32 * (1.0 + dry / made.max(1.0));
    // Where there are more triangles, wood takes more, but of them a smaller share.
    let wood = mesh.triangles() as f32 - made - dry;
    let times = (wood + twigs) / mesh.triangles().max(1) as f32;
    twigs + wood * times.max(1.0).sqrt()
}

/// To two digits.
fn rounded_up(number: f32) -> f32 {
    let unit = 10f32.powf(number.max(1.0).log10().floor() - 1.0);
    (number / unit).ceil() * unit
}

/// Share of what the species' leaves hide below which a crown is worth a warning.
const THIN: f32 = 0.75;

/// Passes on what is to be known of a user's own files, as far as a tree is made of them.
pub fn remarks(look: &Species, foliage: FoliageLevel, texture_px: u32, warnings: &mut Vec<String>) {
    let is_used = |remark: &&Remark| match remark.on {
        OwnPart::Bark => texture_px > 0,
        OwnPart::Leaves => foliage > FoliageLevel::Shell && look.own_model.is_some(),
        OwnPart::Fruit => foliage >= FoliageLevel::Cards,
    };
    warnings.extend(look.remarks.iter().filter(is_used).map(|remark| remark.text.clone()));
}

/// Whether leaves hide far less than the species' do.
pub(super) fn is_thin(mesh: &TreeMesh) -> bool {
    mesh.leaf_cover < THIN
}

/// Warns where so few leaves, cards or models of the user's stand for a crown that one sees through it.
pub(super) fn thin<'a>(
    meshes: impl Iterator<Item = (&'a Species, &'a TreeMesh, Bound)>,
    warnings: &mut Vec<String>,
) {
    let thinnest = meshes.min_by(|(_, a, _), (_, b, _)| a.leaf_cover.total_cmp(&b.leaf_cover));
    let Some((species, mesh, bound)) = thinnest.filter(|(_, mesh, _)| is_thin(mesh)) else {
        return;
    };
    if mesh.leaf_cover == 0.0 {
        warnings.push(format!(
            "--foliage geometry: there are too few triangles for any leaf; {}, or take --foliage cards",
            bound.remedy(None)
        ));
        return;
    }
    if !mesh.twigs.is_empty() {
        let places: usize = mesh.twigs.iter().map(|twigs| twigs.places.len()).sum();
        warnings.push(format!(
            "twigs at {places} places hide {:.0} % of what the species' leaves do; give more `twigs_per_m`, or a \
             larger `twig_length_m`",
            100.0 * mesh.leaf_cover
        ));
        return;
    }
    let needed = mesh.triangles() as f32 / mesh.leaf_cover.max(1e-6);
    let (what, or) = match (mesh.stand_in, &species.own_model) {
        (Some(_), _) => ("--foliage geometry: leaves", ", or take --foliage cards"),
        (None, Some(_)) => ("leaves by a model", ", or a model of fewer"),
        (None, None) => ("cards", ""),
    };
    warnings.push(format!(
        "{what} of {} triangles hide {:.0} % of what the species' leaves do; {}{or}",
        mesh.foliage.triangles(),
        100.0 * mesh.leaf_cover,
        bound.remedy(Some(rounded_up(needed))),
    ));
}

/// Warns of a model's coarser meshes that cover much less than its finest does: of the model whose are thinnest.
pub fn thin_levels<'a>(models: impl Iterator<Item = &'a [TreeMesh]>, warnings: &mut Vec<String>) {
    let share = |of: &[TreeMesh], k: usize| of[k].leaf_cover / of[0].leaf_cover.max(1e-6);
    let is_thin = |of: &&[TreeMesh], k: usize| !of[k].foliage.is_empty() && share(of, k) < THIN;
    let levels = models.flat_map(|of| (1..of.len()).map(move |k| (of, k)));
    let thinnest = levels
        .filter(|(of, k)| is_thin(of, *k))
        .min_by(|a, b| share(a.0, a.1).total_cmp(&share(b.0, b.1)));
    if let Some((of, k)) = thinnest {
        warnings.push(format!(
            "LOD{k} covers {:.0} % of what LOD0 does, for leaves may be no larger; give more --triangles, or \
             fewer --lods",
            100.0 * share(of, k)
        ));
    }
}

/// Warns where a species has cones of the user's own and no tree of it bears any, for want of triangles.
pub fn fruitless<'a>(
    species: &Species,
    foliage: FoliageLevel,
    meshes: impl Iterator<Item = &'a TreeMesh>,
    warnings: &mut Vec<String>,
) {
    let Some(model) = &species.own_fruit.as_ref().filter(|_| species.fruit.per_m > 0.0) else {
        return;
    };
    if matches!(foliage, FoliageLevel::Sparse | FoliageLevel::Shell) {
        let (name, fruit) = (&species.name, model.name.display());
        warnings.push(format!(
            "{name}: no {fruit} is borne beside --foliage sparse or shell; give cards or geometry"
        ));
        return;
    }
    let mut in_leaf = meshes.filter(|m| m.twig_scale > 0.0).peekable();
    let is_fruitless = in_leaf.peek().is_some() && in_leaf.all(|m| m.fruit.is_empty());
    if is_fruitless {
        warnings.push(format!(
            "{}: no {} is borne: one has {} triangles, and all of them may take a quarter of the crown's; \
             give more --triangles, or the model fewer",
            species.name,
            model.name.display(),
            model.index.len() / 3
        ));
    }
}
