//! Coarser forms of a tree that cover as much as its finest.
//!
//! Where twigs are left out, those that stay are enlarged (Cook et al. 2007, Stochastic
//! simplification of aggregate detail, who keep the sum of their areas). Large cards overlap less
//! evenly than small ones, so areas do not say it all: each form's foliage is made at several
//! scales, what it covers beside its wood is counted from the sides and from above, and the scale at
//! which it covers as much as the finest is found between them. Limit: one scale serves all sides
//! and heights.

use rayon::prelude::*;

use super::forest::model_scene;
use super::levels::{bounds, union};
use crate::diagnostic::Result;
use crate::lod;
use crate::mesh::{self, MeshOptions, TreeMesh};
use crate::render::capture::Sitter;
use crate::seed::Seed;
use crate::skeleton::Skeleton;
use crate::species::Species;
use crate::texture::TreeTextures;

/// Scales tried, over that which keeps the area of the foliage; how often the ladder is moved on
/// where the answer lies beyond it.
const LADDER: [f32; 4] = [0.72, 0.95, 1.25, 1.65];
const MOVES: usize = 3;
/// Sides looked from, and samples along the longer side of what is seen.
const SIDES: usize = 5;
const SAMPLES: usize = 192;

/// A tree to be meshed.
pub struct Subject<'a> {
    pub skeleton: &'a Skeleton,
    pub species: &'a Species,
    pub textures: &'a TreeTextures,
    pub seed: Seed,
}

impl Subject<'_> {
    /// Without leaves in the ground.
    ///
    /// # Errors
    /// Those of [`mesh::build`].
    pub fn mesh(&self, options: &MeshOptions) -> Result<TreeMesh> {
        let atlas = &self.textures.atlas;
        let mut tree = mesh::build(self.skeleton, self.species, atlas, options, self.seed)?;
        tree.clear_ground();
        Ok(tree)
    }

    /// The tree with its twigs at another scale.
    fn at_scale(&self, tree: &TreeMesh, options: &MeshOptions, scale: f32) -> Result<TreeMesh> {
        let options = MeshOptions { twig_scale: Some(scale), ..*options };
        let (atlas, rest) = (&self.textures.atlas, tree.triangles() - tree.foliage.triangles());
        let foliage = mesh::leaves(self.skeleton, self.species, atlas, &options, rest, self.seed)?;
        let [wood, upper_wood, twig_wood] = tree.woods().map(Clone::clone);
        let fruit = tree.fruit.clone();
        let mut tree =
            TreeMesh { wood, upper_wood, twig_wood, foliage, fruit, twig_scale: scale, ..*tree };
        tree.clear_ground();
        Ok(tree)
    }
}

/// Meshes a tree in several forms, the finest first; the twigs of the others are so large that they
/// cover as much as it does.
///
/// # Errors
/// Those of [`mesh::build`]; a tree that is not finite.
pub fn meshes(subject: &Subject<'_>, forms: &[MeshOptions]) -> Result<Vec<TreeMesh>> {
    let mut out: Vec<TreeMesh> =
        forms.par_iter().map(|options| subject.mesh(options)).collect::<Result<_>>()?;
    keep(subject, forms, &mut out)?;
    Ok(out)
}

/// Scales of twigs, and what each covers.
type Tried = Vec<(f32, f32)>;

/// Enlarges the twigs of all forms but the first until they cover as much as it does; `options`:
/// how each is meshed.
fn keep(subject: &Subject<'_>, options: &[MeshOptions], forms: &mut [TreeMesh]) -> Result<()> {
    let Some((finest, coarser)) = forms.split_first_mut() else { return Ok(()) };
    let area = |tree: &TreeMesh| tree.foliage.area_sq_m().max(1e-6);
    // Of every form: its number, the scale tried first, and what is known.
    let mut open: Vec<(usize, f32, Tried)> = coarser
        .iter()
        .enumerate()
        .filter(|(_, tree)| tree.twig_scale > 0.0 && finest.twig_scale > 0.0)
        .map(|(k, tree)| (k, tree.twig_scale * (area(finest) / area(tree)).sqrt() as f32, vec![]))
        .collect();
    for _ in 0..MOVES {
        let tries: Vec<(usize, f32)> =
            open.iter().flat_map(|(k, from, _)| LADDER.map(|rung| (*k, from * rung))).collect();
        if tries.is_empty() {
            break;
        }
        let plain: Vec<MeshOptions> =
            options.iter().map(|o| MeshOptions { wind: None, ..*o }).collect();
        let tried: Vec<TreeMesh> = tries
            .par_iter()
            .map(|&(k, scale)| subject.at_scale(&coarser[k], &plain[k + 1], scale))
            .collect::<Result<_>>()?;
        let shares = shares(subject, finest, tried)?;
        let mut shares = tries.iter().zip(shares);
        for (_, _, known) in &mut open {
            known.extend(shares.by_ref().take(LADDER.len()).map(|(t, share)| (t.1, share)));
            known.sort_by(|a, b| a.0.total_cmp(&b.0));
        }
        let mut still = Vec::new();
        for (k, from, known) in open {
            let [least, most] = [known.first(), known.last()].map(|e| e.map_or(1.0, |e| e.1));
            let ends = LADDER[LADDER.len() - 1] / LADDER[0];
            match found(&known) {
                Some(scale) => {
                    coarser[k] = subject.at_scale(&coarser[k], &options[k + 1], scale)?
                }
                None if most < 1.0 => still.push((k, from * ends, known)),
                None if least > 1.0 => still.push((k, from / ends, known)),
                None => {}
            }
        }
        open = still;
    }
    // Out of reach: the nearest that was tried.
    for (k, _, known) in open {
        let off = |e: &&(f32, f32)| (e.1 - 1.0).abs();
        let nearest = known.iter().min_by(|a, b| off(a).total_cmp(&off(b)));
        if let Some(&(scale, _)) = nearest {
            coarser[k] = subject.at_scale(&coarser[k], &options[k + 1], scale)?;
        }
    }
    Ok(())
}

/// The scale at which as much is covered as is to be, between two that are known.
fn found(known: &[(f32, f32)]) -> Option<f32> {
    let pair = known.windows(2).find(|w| w[0].1 <= 1.0 && w[1].1 >= 1.0)?;
    let [(a, low), (b, high)] = [pair[0], pair[1]];
    Some(a + (b - a) * ((1.0 - low) / (high - low).max(1e-6)))
}

/// What each tree covers over what the finest does: mean over sides and above.
///
/// # Errors
/// A tree that is not finite.
pub fn shares(subject: &Subject<'_>, finest: &TreeMesh, trees: Vec<TreeMesh>) -> Result<Vec<f32>> {
    let seen = seen(subject, finest, trees, SIDES, SAMPLES)?;
    let mean = |of: &Vec<f32>| of.iter().sum::<f32>() / of.len().max(1) as f32;
    Ok(seen.iter().map(mean).collect())
}

/// What each tree covers over what the finest does, from each side and, last, from above.
fn seen(
    subject: &Subject<'_>,
    finest: &TreeMesh,
    trees: Vec<TreeMesh>,
    sides: usize,
    samples: usize,
) -> Result<Vec<Vec<f32>>> {
    let models = [finest.clone()].into_iter().chain(trees).collect();
    let scene = model_scene(subject.species, models, subject.textures.clone());
    let models: Vec<_> = scene.prototypes.iter().map(|p| &p.parts[..]).collect();
    let around = models.iter().map(|parts| bounds(parts)).reduce(union).unwrap_or_default();
    let sitter = Sitter::covers(&models, &scene.materials, &scene.textures);
    let covered: Vec<Vec<usize>> = (0..models.len() as u32)
        .into_par_iter()
        .map(|m| lod::cover(&sitter, m, around, sides, samples))
        .collect::<Result<_>>()?;
    let (finest, others) = covered.split_at(1);
    let over = |of: &Vec<usize>| {
        of.iter().zip(&finest[0]).map(|(a, b)| *a as f32 / (*b).max(1) as f32).collect()
    };
    Ok(others.iter().map(over).collect())
}

#[cfg(test)]
mod tests {
    use super::super::forest::{WoodJob, detail};
    use super::super::levels::{self, SHARES};
    use super::*;
    use crate::mesh::FoliageLevel;
    use crate::skeleton::{self, Target};
    use crate::{species, texture};

    /// Sides and samples of the test: others than those of the search.
    const TEST_SIDES: usize = 7;
    const TEST_SAMPLES: usize = 400;

    /// What each coarser form covers over what the finest does: sides, then above.
    fn covers(name: &str, triangles: usize) -> Vec<Vec<f32>> {
        let species = species::load(name).unwrap();
        let seed = Seed::new(1);
        let target = Target::FromSpecies { height_m: None };
        let detail = detail(triangles, FoliageLevel::Cards);
        let skeleton = skeleton::grow(&species, target, detail, seed).unwrap();
        let textures = texture::for_species(&species, 256, seed);
        let subject = Subject { skeleton: &skeleton, species: &species, textures: &textures, seed };
        let options = WoodJob::default().options(triangles, FoliageLevel::Cards);
        let mut all = levels::meshes(&subject, &options, SHARES.len(), None).unwrap();
        for (mesh, share) in all.iter().zip([1.0].into_iter().chain(SHARES)) {
            mesh.check().unwrap();
            assert!(mesh.triangles() as f32 <= triangles as f32 * share, "{name} {share}");
        }
        let coarser = all.split_off(1);
        seen(&subject, &all[0], coarser, TEST_SIDES, TEST_SAMPLES).unwrap()
    }

    /// Of every level of every species: within 6 % on average, 12 % from any side, 20 % from above.
    #[test]
    fn coarser_forms_cover_as_much_as_the_finest() {
        let names = species::builtin_names().into_iter().filter(|n| !n.starts_with("table3/"));
        let mut off_by_more = Vec::new();
        for name in names {
            for (k, of) in covers(name, 20_000).iter().enumerate() {
                let mean = of.iter().sum::<f32>() / of.len() as f32;
                let (above, sides) = of.split_last().unwrap();
                println!("{name} LOD{}: {mean:.3} {sides:.3?} {above:.3}", k + 1);
                let off = |of: &f32, most: f32| (of - 1.0).abs() < most;
                let is_kept = off(&mean, 0.06) && sides.iter().all(|s| off(s, 0.12));
                if !is_kept || !off(above, 0.2) {
                    off_by_more.push(format!("{name} LOD{}: {of:.3?}", k + 1));
                }
            }
        }
        assert!(off_by_more.is_empty(), "{off_by_more:#?}");
    }
}
