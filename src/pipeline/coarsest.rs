//! A tree's coarsest mesh: the scheme of P18, with the measures of its finest one.

use std::mem;

use super::cover::Subject;
use crate::diagnostic::Result;
use crate::mesh::{self, Around, MeshOptions, Surface, TreeMesh, p18};
use crate::texture::BARK_REPEAT_M;

/// A model as the scheme of P18 alone, of `height_m` where one is asked for; and how many times as large as the
/// skeleton it is.
///
/// # Errors
/// Those of [`mesh::build`].
pub fn alone(
    subject: &Subject<'_>,
    options: &MeshOptions,
    height_m: Option<f32>,
) -> Result<(TreeMesh, f32)> {
    let mut measured = subject.mesh(options)?;
    let factor = height_m.map_or(1.0, |h| measured.factor_to(h));
    measured.scale(factor);
    Ok((of(&measured, factor, subject, options, p18::BOUGHS)?, factor))
}

/// The scheme of a finest mesh, `factor` times as large as its skeleton, with the wind asked for, and so many
/// boughs where its twigs are bare.
pub fn of(
    finest: &TreeMesh,
    factor: f32,
    subject: &Subject<'_>,
    options: &MeshOptions,
    boughs: u32,
) -> Result<TreeMesh> {
    let Subject { skeleton, species, .. } = subject;
    let upper_from_m = mesh::upper_bark_from_m(skeleton, &species.bark).map(|z| z * factor);
    let base_m = skeleton.crown_base_m() * factor;
    let mut scheme = scheme(finest, base_m, upper_from_m, subject, boughs)?;
    if let Some(profile) = options.wind {
        let height_m = finest.bounds().1.z;
        let TreeMesh { wood, upper_wood, twig_wood, foliage, dry, .. } = &mut scheme;
        for surface in [wood, upper_wood, twig_wood, foliage, dry] {
            profile.whole_tree(height_m, surface);
        }
    }
    Ok(scheme)
}

/// The height above which nearly all leaves are; 0 without any.
fn lowest_leaves_m(tree: &TreeMesh) -> f32 {
    /// Share of them that may be lower.
    const LOWER: usize = 50;
    let mut heights: Vec<f32> = tree.foliage.position.iter().map(|p| p.z).collect();
    if heights.is_empty() {
        return 0.0;
    }
    let k = heights.len() / LOWER;
    *heights.select_nth_unstable_by(k, f32::total_cmp).1
}

/// Share of a tree's height over which the lower part of its crown has no leaves to be told.
const DEAD: f32 = 0.1;

/// Pixels along a picture of twigs from which on it shows boughs.
const LEAST_PX: u32 = 128;

/// A tree as two cones and a cylinder (P18); with boughs for cones where all its twigs are bare, so many where they
/// show the picture of one, and of wood where there are none.
fn scheme(
    tree: &TreeMesh,
    crown_base_m: f32,
    upper_from_m: Option<f32>,
    subject: &Subject<'_>,
    boughs: u32,
) -> Result<TreeMesh> {
    const SIDES: u32 = 8;
    let Subject { skeleton, species, textures, .. } = subject;
    let size = &species.size;
    let height_m = tree.bounds().1.z.max(0.01);
    let widest = size.profile.iter().fold([0.0f32; 2], |w, p| if p[1] > w[1] { *p } else { w });
    let stem_diameter_m = size.stem_diameter_at(height_m);
    let lowest = size.profile.first().map_or(1.0, |p| p[1]);
    let of_crown = |base_m: f32, width_m: f32| {
        let crown_length_m = (height_m - base_m).clamp(0.05 * height_m, height_m);
        p18::Scheme::new(&p18::Measures {
            height_m,
            stem_diameter_m,
            crown_width_m: width_m.max(1.1 * stem_diameter_m),
            crown_length_m,
            widest_m: height_m - crown_length_m * (1.0 - widest[0].clamp(0.02, 0.98)),
            lower_share: lowest / widest[1].max(1e-3),
        })
    };
    // A crown whose lower branches are dead is one of leaves above bare boughs.
    let in_leaf_m = tree.crown_diameter_m();
    let whole_m = in_leaf_m.max(mesh::crown_diameter_m(&tree.dry.position));
    let leaves_m = lowest_leaves_m(tree);
    let is_dead_below = leaves_m > crown_base_m + DEAD * height_m;
    let whole = of_crown(crown_base_m, if is_dead_below { whole_m } else { in_leaf_m })?;
    let scheme = if is_dead_below { of_crown(leaves_m, in_leaf_m)? } else { whole };
    let mut mesh = scheme.mesh(SIDES, upper_from_m);
    // As deep in the ground as the tree, for slopes.
    let foot_m = tree.bounds().0.z.min(0.0);
    for Surface { position, uv, .. } in [&mut mesh.wood, &mut mesh.upper_wood] {
        for (p, uv) in position.iter_mut().zip(&mut *uv).filter(|(p, _)| p.z == 0.0) {
            (p.z, uv.y) = (foot_m, foot_m);
        }
        let around = Around::cylinder(scheme.r5_m, BARK_REPEAT_M);
        uv.iter_mut().for_each(|uv| *uv = around.at(uv.x, uv.y));
    }
    let is_twig = mesh::stem_is_twig(skeleton, &species.bark);
    if is_twig {
        mesh.twig_wood = mem::take(&mut mesh.wood);
        mesh.twig_wood.append(mem::take(&mut mesh.upper_wood));
    }
    let is_bare = species.foliage.is_bare();
    // The user's own twigs may have no picture, and in small ones those of a bough are blots.
    let has_picture = !species.has_own_leaves() && textures.leaf.width() >= LEAST_PX;
    let mut of_wood = Surface::default();
    if tree.foliage.is_empty() {
        (of_wood, mesh.foliage) = (scheme.bare_crown(), Surface::default());
    } else if is_bare && has_picture {
        (of_wood, mesh.foliage) =
            (scheme.leader(), scheme.twigs(boughs, scheme.top_m(), &textures.atlas));
        mesh.is_hull = false;
    } else if is_bare {
        mesh.foliage = scheme.bare_crown();
    }
    if is_dead_below {
        let atlas = if is_bare { Some(textures.atlas.clone()) } else { textures.atlas.dry() };
        match atlas.filter(|_| has_picture) {
            Some(atlas) => mesh.dry = whole.twigs(boughs, leaves_m, &atlas),
            None => of_wood.append(whole.boughs(leaves_m)),
        }
    }
    let wood = match mesh.upper_wood.is_empty() {
        _ if is_twig => &mut mesh.twig_wood,
        true => &mut mesh.wood,
        false => &mut mesh.upper_wood,
    };
    wood.append(of_wood);
    mesh.leaf_cover = 1.0;
    Ok(mesh)
}

#[cfg(test)]
mod tests {
    use super::super::cover;
    use super::super::detail::{WoodJob, detail};
    use super::super::levels::tests::tree_of;
    use super::super::levels::{SHARES, meshes};
    use super::*;
    use crate::cache::Cache;
    use crate::mesh::FoliageLevel;
    use crate::scene::Alpha;
    use crate::seed::Seed;
    use crate::skeleton::{self, Target};
    use crate::species::state::{Condition, Season, State};

    #[test]
    fn the_coarsest_form_of_a_tree_without_twigs_reaches_its_top() {
        for name in ["picea_abies", "betula_pendula", "pinus_sylvestris"] {
            let trees = tree_of((name, 8_000, 8_000), |subject, options| {
                let options = MeshOptions { leaf_share: 0.0, ..*options };
                meshes(subject, &options, SHARES.len() + 1, None, &Cache::off())
                    .map(|(meshes, _)| meshes)
            });
            let (finest, coarsest) = (&trees[0], trees.last().unwrap());
            assert!(finest.foliage.is_empty() && coarsest.foliage.is_empty());
            let [top, top_of_coarsest] = [finest, coarsest].map(|tree| tree.bounds().1.z);
            assert!(
                (top_of_coarsest / top - 1.0).abs() < 0.02,
                "{name}: {top_of_coarsest} of {top}"
            );
            let reach_m = |tree: &TreeMesh| {
                let corners = tree.woods().into_iter().flat_map(|w| &w.position);
                corners.map(|p| p.truncate().length()).fold(0.0, f32::max)
            };
            let [reach, of_coarsest] = [finest, coarsest].map(reach_m);
            assert!(
                (0.6..1.1).contains(&(of_coarsest / reach)),
                "{name}: {of_coarsest} of {reach}"
            );
            coarsest.woods().iter().for_each(|w| w.check().unwrap());
        }
    }

    /// Bark of a sapling's stem is that of its finest form, as fine.
    #[test]
    fn the_coarsest_form_has_the_bark_of_the_finest() {
        let seed = Seed::new(1);
        let saplings = [
            ("salix_caprea", 0.5),
            ("populus_tremula", 0.5),
            ("sorbus_aucuparia", 0.5),
            ("sorbus_aucuparia", 1.0),
        ];
        for (name, height_m) in saplings {
            let species = crate::species::load(name).unwrap();
            let target = Target::FromSpecies { height_m: Some(height_m) };
            let detail = detail(20_000, FoliageLevel::Cards);
            let skeleton = skeleton::grow(&species, target, detail, seed).unwrap();
            let textures = crate::texture::plain(&species);
            let subject =
                Subject { skeleton: &skeleton, species: &species, textures: &textures, seed };
            let options = WoodJob::default().options(20_000, FoliageLevel::Cards);
            let all = meshes(&subject, &options, SHARES.len() + 1, None, &Cache::off()).unwrap().0;
            // Tiles along a metre of the largest triangles, of the bark that has most of them.
            let most = |tree: &TreeMesh| {
                let area = |s: &Surface| {
                    let of = |t: &[u32; 3]| {
                        let [a, b, c] = t.map(|i| s.position[i as usize]);
                        let [p, q, r] = t.map(|i| s.uv[i as usize]);
                        let in_picture = (q - p).perp_dot(r - p).abs();
                        ((b - a).cross(c - a).length(), in_picture)
                    };
                    let each = s.index.as_chunks::<3>().0.iter().map(of).filter(|a| a.1 > 0.0);
                    each.fold((0.0, 0.0), |sum, a| (sum.0 + a.0, sum.1 + a.1))
                };
                let woods = tree.woods().map(area);
                let k =
                    (0..woods.len()).max_by(|a, b| woods[*a].0.total_cmp(&woods[*b].0)).unwrap();
                (k, (woods[k].1 / woods[k].0).sqrt())
            };
            let [(bark, fine), (same, coarse)] = [&all[0], all.last().unwrap()].map(most);
            assert_eq!(bark, same, "{name}");
            assert!((0.6..1.6).contains(&(coarse / fine)), "{name}: {coarse} and {fine} a metre");
        }
    }

    /// One sees through it, and what one sees are twigs; without pictures these are plain boughs.
    #[test]
    fn the_coarsest_form_of_a_tree_in_winter_shows_its_twigs() {
        let (seed, winter) = (Seed::new(1), State { season: Season::Winter, ..State::default() });
        let species = winter.look(&crate::species::load("betula_pendula").unwrap(), seed);
        let detail = detail(20_000, FoliageLevel::Cards);
        let target = Target::FromSpecies { height_m: None };
        let skeleton = skeleton::grow(&species, target, detail, seed).unwrap();
        let pictured = crate::texture::for_species(&species, 256, seed);
        for (textures, is_masked) in [(pictured, true), (crate::texture::plain(&species), false)] {
            let subject =
                Subject { skeleton: &skeleton, species: &species, textures: &textures, seed };
            let options = WoodJob::default().options(20_000, FoliageLevel::Cards);
            let mut trees =
                meshes(&subject, &options, SHARES.len() + 1, None, &Cache::off()).unwrap().0;
            let coarsest = trees.pop().unwrap();
            assert!(coarsest.triangles() < 130, "{}", coarsest.triangles());
            let shown = cover::shares(&subject, &trees[0], vec![coarsest.clone()]).unwrap()[0];
            let scene = super::super::model::model_scene(&species, vec![coarsest], textures);
            let parts = &scene.prototypes[0].parts;
            let crown = parts.iter().find(|p| p.name == "foliage").unwrap();
            let material = &scene.materials[crown.material as usize];
            assert_eq!(material.alpha != Alpha::Opaque, is_masked);
            assert!(!is_masked || shown > 0.3, "{shown}");
        }
    }

    /// Below a crown in leaf dry boughs show their twigs, too, as wide as LOD0's; without pictures they are of wood.
    #[test]
    fn dry_boughs_of_the_coarsest_form_show_their_twigs() {
        let (seed, condition) = (Seed::new(1), Condition::StronglyWeakened);
        let state = State { condition, ..State::default() };
        let species = state.look(&crate::species::load("picea_abies").unwrap(), seed);
        let detail = detail(20_000, FoliageLevel::Cards);
        let target = Target::FromSpecies { height_m: None };
        let grown = skeleton::grow(&species, target, detail, seed).unwrap();
        let skeleton = skeleton::decline::in_condition(&grown, species.kind, condition, seed);
        let pictured = crate::texture::for_species(&species, 256, seed);
        let mut woods = Vec::new();
        for (textures, has_picture) in [(pictured, true), (crate::texture::plain(&species), false)]
        {
            let subject =
                Subject { skeleton: &skeleton, species: &species, textures: &textures, seed };
            let options = MeshOptions {
                leaf_share: state.leaf_share(&species),
                ..WoodJob::default().options(20_000, FoliageLevel::Cards)
            };
            let mut trees =
                meshes(&subject, &options, SHARES.len() + 1, None, &Cache::off()).unwrap().0;
            let coarsest = trees.pop().unwrap();
            assert!(trees.iter().all(|tree| tree.dry.is_empty() != has_picture));
            assert!(coarsest.triangles() < 130, "{}", coarsest.triangles());
            woods.push(coarsest.wood_triangles());
            let width_m = mesh::crown_diameter_m(&trees[0].dry.position);
            let scene = super::super::model::model_scene(&species, vec![coarsest], textures);
            let parts = &scene.prototypes[0].parts;
            let dry = parts.iter().find(|p| p.name == "dry_twigs" && !p.surface.is_empty());
            assert_eq!(dry.is_some(), has_picture);
            let Some(dry) = dry else { continue };
            assert!(scene.materials[dry.material as usize].alpha != Alpha::Opaque);
            let crown = parts.iter().find(|p| p.name == "foliage").unwrap();
            assert!(dry.surface.bounds().0.z < crown.surface.bounds().0.z);
            let shown_m = mesh::crown_diameter_m(&dry.surface.position);
            assert!((0.6..1.2).contains(&(shown_m / width_m)), "{shown_m} of {width_m}");
        }
        assert!(woods[1] > woods[0]);
    }
}
