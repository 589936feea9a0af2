//! Triangles by error: the fewest at which a tree's silhouette is off by no more than asked for.
//!
//! The tree is meshed at a ladder of budgets from one skeleton, and the silhouette of each form
//! measured against that of a finer one, as levels of detail are: what is bounded is the RMS over
//! all places and sides, as one leaf may be the worst. Rounding of the wood, axes made straight,
//! twigs and leaves left out count alike. Limits: nothing below a sample of the silhouettes, a
//! 320th of the tree, is told apart; the finer form has facets of its own.

use glam::Vec3;
use rayon::prelude::*;

use super::budget::Bound;
use super::cover::Subject;
use super::model::model_scene;
use crate::diagnostic::Result;
use crate::lod::{Silhouettes, Views};
use crate::mesh::{FoliageLevel, MAX_SIDES, MeshOptions, TreeMesh};
use crate::render::capture::Sitter;
use crate::report::{ErrorMeasure, Outcome};
use crate::scene::Apart;

/// Triangles of the form that others are measured against; with every leaf of it.
const REFERENCE: [usize; 2] = [100_000, 1_000_000];
/// Fewest triangles tried.
const LEAST: usize = 200;
/// Room about the finest form for larger twigs, share of its size; farther out nothing is seen.
const ROOM: f32 = 0.1;
/// Steps into which the last rung is cut.
const STEPS: usize = 4;

/// What a number of triangles comes to.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reached {
    /// As a budget, and as they come.
    pub triangles: usize,
    pub made: usize,
    pub rms_m: f32,
    pub worst_m: f32,
    /// Asked for.
    pub tolerance_m: f32,
    /// Triangles of the form that it was measured against.
    pub finest: usize,
    /// Facets may be farther from the wood's roundness than asked for: what that would take is spent on
    /// branches, where so few triangles do not do for both.
    pub is_rough: bool,
}

impl Reached {
    pub fn is_within(&self) -> bool {
        self.rms_m <= self.tolerance_m && self.made <= self.triangles
    }

    /// Too near to the finest form for that to tell its error.
    fn is_untold(&self) -> bool {
        2 * self.triangles > self.finest
    }
}

/// Triangles of the form that a tree of so many is measured against.
pub fn reference(most: usize, foliage: FoliageLevel) -> usize {
    most.max(REFERENCE[usize::from(foliage == FoliageLevel::Geometry)])
}

/// How a tree is meshed with so many triangles.
type Options<'a> = &'a (dyn Fn(usize) -> MeshOptions + Sync);

/// The fewest triangles within the tolerance, to a fifth; `most` where none are.
///
/// # Errors
/// Those of [`crate::mesh::build`].
pub fn fewest(
    subject: &Subject<'_>,
    options: Options<'_>,
    most: usize,
    tolerance_m: f32,
) -> Result<Reached> {
    let rungs = std::iter::successors(Some(most), |n| Some(n / 2));
    let ladder: Vec<usize> =
        rungs.enumerate().take_while(|&(k, n)| k == 0 || n >= LEAST).map(|r| r.1).collect();
    let finest = Finest::of(subject, options, most)?;
    let found = finest.reached(options, &ladder, tolerance_m)?;
    let Some(k) = found.iter().rposition(Reached::is_within) else {
        let rough = |n: usize| options(n).roughened();
        let freed = finest.reached(&rough, &[most], tolerance_m)?[0];
        let is_worse = freed.rms_m >= found[0].rms_m && found[0].made <= most;
        return Ok(if is_worse { found[0] } else { Reached { is_rough: true, ..freed } });
    };
    let Some(coarser) = found.get(k + 1) else { return Ok(found[k]) };
    let (low, high) = (coarser.triangles, found[k].triangles);
    let between: Vec<usize> = (1..STEPS).map(|i| low + (high - low) * i / STEPS).collect();
    let between = finest.reached(options, &between, tolerance_m)?;
    Ok(between.into_iter().find(Reached::is_within).unwrap_or(found[k]))
}

/// The form that others are measured against.
struct Finest<'a> {
    subject: &'a Subject<'a>,
    /// As a budget.
    triangles: usize,
    silhouettes: Silhouettes,
    /// Where one looks, the same for all forms: errors of a sample or two go with where its grid lies.
    around: (Vec3, Vec3),
}

impl<'a> Finest<'a> {
    fn of(subject: &'a Subject<'a>, options: Options<'_>, most: usize) -> Result<Finest<'a>> {
        let triangles = reference(most, options(most).foliage.of(subject.species));
        let mesh = subject.mesh(&options(triangles))?;
        let (low, high) = mesh.bounds();
        let room = (high - low) * ROOM;
        let around = (low - room, high + room);
        let silhouettes = silhouettes(subject, vec![mesh], around)?.remove(0);
        Ok(Finest { subject, triangles, silhouettes, around })
    }

    fn reached(
        &self,
        options: Options<'_>,
        budgets: &[usize],
        tolerance_m: f32,
    ) -> Result<Vec<Reached>> {
        let meshes: Vec<TreeMesh> =
            budgets.par_iter().map(|&n| self.subject.mesh(&options(n))).collect::<Result<_>>()?;
        let made: Vec<usize> = meshes.iter().map(TreeMesh::triangles).collect();
        let forms = silhouettes(self.subject, meshes, self.around)?;
        let reached = forms.par_iter().zip(budgets).zip(made).map(|((form, &triangles), made)| {
            let Apart { rms_m, worst_m } = self.silhouettes.apart(form);
            let finest = self.triangles;
            Reached { triangles, made, rms_m, worst_m, tolerance_m, finest, is_rough: false }
        });
        Ok(reached.collect())
    }
}

fn silhouettes(
    subject: &Subject<'_>,
    meshes: Vec<TreeMesh>,
    around: (Vec3, Vec3),
) -> Result<Vec<Silhouettes>> {
    let scene = model_scene(subject.species, meshes, subject.textures.clone());
    let models: Vec<_> = scene.prototypes.iter().map(|p| &p.parts[..]).collect();
    let sitter = Sitter::covers(&models, &scene.materials, &scene.textures);
    (0..models.len() as u32)
        .into_par_iter()
        .map(|m| Silhouettes::of(&sitter, m, around, Views::All))
        .collect()
}

/// What a report says of the trees; a warning where any is not within its tolerance. `bound`: what said how many
/// triangles they may have.
pub(super) fn outcome(reached: &[Reached], bound: Bound, warnings: &mut Vec<String>) -> Outcome {
    let triangles = reached.iter().map(|r| r.triangles).sum();
    let rms_m = reached.iter().map(|r| r.rms_m).fold(0.0, f32::max);
    let worst_m = reached.iter().map(|r| r.worst_m).fold(0.0, f32::max);
    let beyond: Vec<&Reached> = reached.iter().filter(|r| !r.is_within()).collect();
    if let Some(most) = beyond.iter().map(|r| r.triangles).max() {
        warnings.push(format!(
            "--tolerance: {} of {} models would take more than {most} triangles each; their \
             silhouettes are off by up to {rms_m:.3} m (RMS); {}",
            beyond.len(),
            reached.len(),
            bound.remedy(None)
        ));
    }
    let untold = || reached.iter().filter(|r| r.is_within() && r.is_untold());
    if let Some(Reached { finest, tolerance_m, .. }) = untold().next() {
        warnings.push(format!(
            "--tolerance: {} of {} models take more than half of the {finest} triangles that they are \
             measured against, so whether they keep to {tolerance_m} m can't be told",
            untold().count(),
            reached.len()
        ));
    }
    Outcome::items(reached.len(), "models", triangles, "triangles")
        .error(ErrorMeasure::new("silhouette RMS", rms_m.into(), "m"))
        .note(format!("silhouettes at worst {worst_m:.3} m off"))
}

/// How far the facets of the wood are from their circles; a warning where that is more than asked
/// for.
pub fn sagitta<'a>(
    trees: impl Iterator<Item = &'a TreeMesh>,
    tolerance_m: Option<f32>,
    warnings: &mut Vec<String>,
) -> ErrorMeasure {
    let worst = trees.max_by(|a, b| a.sagitta_m.total_cmp(&b.sagitta_m));
    let (worst_m, sides) = worst.map_or((0.0, 0), |t| (t.sagitta_m, t.sagitta_sides));
    warnings.extend(tolerance_m.and_then(|asked_m| too_flat(worst_m, sides, asked_m)));
    ErrorMeasure::new("sagitta", worst_m.into(), "m")
}

fn too_flat(worst_m: f32, sides: u32, asked_m: f32) -> Option<String> {
    let remedy = match sides < MAX_SIDES {
        true => "; give more --triangles",
        false => ", and no wood has more sides",
    };
    (worst_m > asked_m * 1.01).then(|| {
        format!(
            "--tolerance: facets of wood of {sides} sides are up to {:.2} mm from its roundness, more than {:.2} mm{remedy}",
            1e3 * worst_m,
            1e3 * asked_m
        )
    })
}

#[cfg(test)]
mod tests {
    use super::super::detail::mesh_options;
    use super::*;
    use crate::seed::Seed;
    use crate::skeleton::{self, Detail, Target};
    use crate::{species, texture};

    #[test]
    fn what_makes_wood_too_flat_is_told() {
        assert_eq!(too_flat(0.005, 12, 0.005), None);
        let told = |sides| too_flat(0.0053, sides, 0.005).unwrap();
        assert!(told(64).contains("wood of 64 sides are up to 5.30 mm"));
        assert!(told(64).ends_with("more than 5.00 mm, and no wood has more sides"));
        assert!(told(12).ends_with("more than 5.00 mm; give more --triangles"));
    }

    #[test]
    fn a_tree_takes_the_fewest_triangles_within_its_tolerance() {
        let species = species::load("betula_pendula").unwrap();
        let seed = Seed::new(1);
        let detail = Detail { max_nodes: 8_000, attractor_spacing_m: None };
        let target = Target::FromSpecies { height_m: Some(12.0) };
        let skeleton = skeleton::grow(&species, target, detail, seed).unwrap();
        let textures = texture::for_species(&species, 64, seed);
        let subject = Subject { skeleton: &skeleton, species: &species, textures: &textures, seed };
        let fewest = |most, tolerance_m| fewest(&subject, &mesh_options, most, tolerance_m);
        let mut last = usize::MAX;
        for tolerance_m in [0.035, 0.045, 0.2] {
            let got = fewest(10_000, tolerance_m).unwrap();
            assert!(got.is_within() && got.triangles < last, "{tolerance_m}: {got:?}");
            // About half as many would be too coarse, but for one that happens to fit.
            let about_half: Vec<usize> =
                (40..65).step_by(5).map(|k| got.triangles * k / 100).collect();
            let finest = Finest::of(&subject, &mesh_options, 10_000).unwrap();
            let fewer = finest.reached(&mesh_options, &about_half, tolerance_m).unwrap();
            let within = fewer.iter().filter(|f| f.is_within()).count();
            assert!(got.triangles < 400 || within <= 1, "{got:?} {fewer:?}");
            last = got.triangles;
        }
        let mut warnings = Vec::new();
        let got = fewest(300, 0.01).unwrap();
        assert_eq!((got.triangles, got.is_within()), (300, false));
        outcome(&[got], Bound::Triangles, &mut warnings);
        assert!(warnings[0].contains("1 of 1 models would take more than 300"), "{warnings:?}");
        // However round wood is to be.
        let round =
            |n: usize| MeshOptions { tolerance_m: 1e-5, sagitta_m: 1e-5, ..mesh_options(n) };
        let got = super::fewest(&subject, &round, 300, 1e-5).unwrap();
        assert!(got.is_rough && got.made <= 300 && got.rms_m < 0.5, "{got:?}");
        let mut warnings = Vec::new();
        let got = fewest(100_000, 0.001).unwrap();
        outcome(&[got], Bound::Triangles, &mut warnings);
        assert!(
            warnings[0].contains("of the 100000 triangles that they are measured against"),
            "{warnings:?}"
        );
    }
}
