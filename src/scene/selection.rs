//! What one file shows of a scene: some of its trees, in one form or in all, and only the
//! materials and textures that these need, numbered anew.

use std::borrow::Cow;
use std::collections::BTreeMap;

use glam::Vec3;

use super::{
    Apart, Collider, Instance, Material, Octahedral, Part, Scattered, Texture, ValidScene, Wrap,
    plain_rms_m,
};

/// The finest form.
const FINEST: &str = "LOD0";

/// Which forms of the models are shown.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Forms {
    /// All, and colliders.
    All,
    /// The finest, those whose silhouette no coarser one equals or betters, and colliders: where forms
    /// are chosen by error the others would never be shown.
    Drawn,
    /// One: 0 is the finest, which brings the terrain and colliders, others come without.
    One(usize),
}

/// Borrowed from a [`ValidScene`]; every index leads somewhere.
#[derive(Debug, Clone)]
pub struct Selection<'a> {
    scene: &'a ValidScene,
    forms: Forms,
    pub terrain: Option<&'a Part>,
    pub models: Vec<Model<'a>>,
    pub trees: Vec<Tree<'a>>,
    pub groups: Vec<Group<'a>>,
    pub materials: Vec<&'a Material>,
    /// Indices into [`ValidScene::textures`].
    pub textures: Vec<u32>,
    material_number: Vec<u32>,
    texture_number: Vec<u32>,
}

/// A prototype in the forms that are shown, from fine to coarse.
#[derive(Debug, Clone)]
pub struct Model<'a> {
    /// Unique identifier.
    pub name: &'a str,
    pub forms: Vec<Form<'a>>,
    /// What its one form has beside.
    pub scattered: &'a [Scattered],
    pub colliders: &'a [Collider],
}

#[derive(Debug, Clone, Copy)]
pub struct Form<'a> {
    /// `LOD0`, `LOD1`, …, `impostor`.
    pub name: &'a str,
    pub parts: &'a [Part],
    /// How far its silhouette is from that of the finest form, metres.
    pub silhouette: Apart,
    pub octahedral: Option<Octahedral>,
}

impl<'a> Model<'a> {
    /// The parts of all forms, scattered ones once.
    pub fn parts(&self) -> impl Iterator<Item = &'a Part> + use<'a, '_> {
        let of_forms = self.forms.iter().flat_map(|f| f.parts);
        of_forms.chain(self.scattered.iter().map(|s| &s.part))
    }
}

impl Form<'_> {
    pub fn is_finest(&self) -> bool {
        self.name == FINEST
    }

    /// What something is called in this form: `Larix_sibirica_01`, `Larix_sibirica_01_LOD1`.
    pub fn name_of<'n>(&self, of: &'n str) -> Cow<'n, str> {
        if self.is_finest() { of.into() } else { format!("{of}_{}", self.name).into() }
    }

    /// As [`plain_rms_m`].
    pub fn plain_rms_m(&self) -> f32 {
        plain_rms_m(self.silhouette, self.octahedral)
    }
}

#[cfg(test)]
impl Form<'_> {
    /// Of nothing, with a silhouette so far off.
    pub fn off(rms_m: f32) -> Self {
        let silhouette = Apart { worst_m: 1.0, rms_m };
        Form { name: "", parts: &[], silhouette, octahedral: None }
    }
}

/// A tree and the number of its model.
#[derive(Debug, Clone, Copy)]
pub struct Tree<'a> {
    pub instance: &'a Instance,
    pub model: u32,
    /// Index into [`ValidScene::instances`].
    pub number: u32,
}

/// One species; none is empty.
#[derive(Debug, Clone)]
pub struct Group<'a> {
    /// Unique identifier.
    pub name: &'a str,
    /// Indices into [`Selection::models`].
    pub models: Vec<u32>,
    /// Indices into [`Selection::trees`].
    pub trees: Vec<u32>,
}

/// What is not shown has no number.
const NONE: u32 = u32::MAX;

impl<'a> Selection<'a> {
    /// All trees, in these forms.
    pub fn of(scene: &'a ValidScene, forms: Forms) -> Self {
        let all: Vec<u32> = (0..scene.instances().len() as u32).collect();
        Self::of_trees(scene, forms, &all, !matches!(forms, Forms::One(1..)))
    }

    /// Some trees (ascending indices into [`ValidScene::instances`]), in these forms.
    fn of_trees(scene: &'a ValidScene, forms: Forms, numbers: &[u32], has_terrain: bool) -> Self {
        let mut shown = vec![false; scene.prototypes().len()];
        for &i in numbers {
            shown[scene.instances()[i as usize].prototype as usize] = true;
        }
        let model_number = numbered(&shown);
        let kept = scene.prototypes().iter().zip(&shown).filter(|(_, shown)| **shown);
        let models: Vec<Model<'a>> = kept.map(|(p, _)| model(p, forms)).collect();
        let mut trees = Vec::with_capacity(numbers.len());
        let mut number_of = vec![NONE; scene.instances().len()];
        for &number in numbers {
            let instance = &scene.instances()[number as usize];
            number_of[number as usize] = trees.len() as u32;
            trees.push(Tree { instance, model: model_number[instance.prototype as usize], number });
        }
        let there = |of: &[u32], numbers: &[u32]| -> Vec<u32> {
            of.iter().map(|&i| numbers[i as usize]).filter(|&n| n != NONE).collect()
        };
        let groups = scene.groups().iter().map(|g| Group {
            name: &g.name,
            models: there(&g.prototypes, &model_number),
            trees: there(&g.instances, &number_of),
        });
        let groups = groups.filter(|g| !g.trees.is_empty()).collect();
        let terrain = scene.terrain().filter(|_| has_terrain);

        let mut used = vec![false; scene.materials().len()];
        for part in models.iter().flat_map(Model::parts).chain(terrain) {
            used[part.material as usize] = true;
        }
        let material_number = numbered(&used);
        let materials = scene.materials().iter().zip(used).filter(|(_, used)| *used);
        let materials: Vec<&Material> = materials.map(|(m, _)| m).collect();
        let mut used = vec![false; scene.textures().len()];
        for (_, texture, _) in materials.iter().flat_map(|m| m.textures()) {
            used[texture as usize] = true;
        }
        let texture_number = numbered(&used);
        let textures = (0u32..).zip(used).filter_map(|(t, used)| used.then_some(t)).collect();
        Selection {
            scene,
            forms,
            terrain,
            models,
            trees,
            groups,
            materials,
            textures,
            material_number,
            texture_number,
        }
    }

    /// Its trees by squares of ground, by column and row from the origin; without terrain.
    pub fn squares(&self, side_m: f32) -> BTreeMap<[i32; 2], Selection<'a>> {
        let mut by_place: BTreeMap<[i32; 2], Vec<u32>> = BTreeMap::new();
        for tree in &self.trees {
            // Saturates for places that no forest reaches.
            let at = (tree.instance.position.truncate() / side_m).floor().to_array();
            by_place.entry(at.map(|c| c as i32)).or_default().push(tree.number);
        }
        let of = |numbers: Vec<u32>| Self::of_trees(self.scene, self.forms, &numbers, false);
        by_place.into_iter().map(|(at, numbers)| (at, of(numbers))).collect()
    }

    /// The terrain without trees, where it is shown.
    pub fn terrain_alone(&self) -> Option<Selection<'a>> {
        self.terrain.map(|_| Self::of_trees(self.scene, self.forms, &[], true))
    }

    pub fn scene(&self) -> &'a ValidScene {
        self.scene
    }

    /// The terrain, then the parts of every form of every model.
    pub fn parts(&self) -> impl Iterator<Item = &'a Part> {
        self.terrain.into_iter().chain(self.models.iter().flat_map(Model::parts))
    }

    /// Number of the part's material among [`Selection::materials`].
    pub fn material(&self, part: &Part) -> u32 {
        self.material_number[part.material as usize]
    }

    /// Number among [`Selection::textures`] of one of the scene's.
    pub fn texture(&self, of_scene: u32) -> u32 {
        self.texture_number[of_scene as usize]
    }

    /// The textures with how each is wrapped.
    pub fn pictures(&self) -> impl Iterator<Item = (&'a Texture, Wrap)> {
        let scene = self.scene;
        self.textures.iter().map(move |&t| (&scene.textures()[t as usize], scene.wrap(t)))
    }

    /// Least and greatest corner of these trees (indices into [`Selection::trees`]) in their
    /// finest form, scene metres; `None` for none.
    pub fn bounds_of(&self, trees: &[u32]) -> Option<(Vec3, Vec3)> {
        let instances = trees.iter().map(|&t| self.trees[t as usize].instance);
        self.scene.bounds_of(instances)
    }
}

fn model(prototype: &super::Prototype, forms: Forms) -> Model<'_> {
    let finest = Form {
        name: FINEST,
        parts: &prototype.parts,
        silhouette: prototype.silhouette.unwrap_or(Apart::NONE),
        octahedral: prototype.octahedral,
    };
    let coarser = prototype.levels.iter().map(|level| Form {
        name: &level.name,
        parts: &level.parts,
        silhouette: level.silhouette,
        octahedral: level.octahedral,
    });
    let all = std::iter::once(finest).chain(coarser);
    let has_bodies = !matches!(forms, Forms::One(1..));
    Model {
        name: &prototype.name,
        forms: match forms {
            Forms::All => all.collect(),
            Forms::Drawn => drawn(all.collect()),
            Forms::One(k) => all.skip(k).take(1).collect(),
        },
        scattered: if matches!(forms, Forms::One(1..)) { &[] } else { &prototype.scattered },
        colliders: if has_bodies { &prototype.colliders } else { &[] },
    }
}

fn drawn(mut forms: Vec<Form<'_>>) -> Vec<Form<'_>> {
    let mut least_m = f32::INFINITY;
    let mut number = forms.len();
    forms.reverse();
    forms.retain(|form| {
        number -= 1;
        let is_drawn = number == 0 || form.plain_rms_m() < least_m;
        least_m = least_m.min(form.plain_rms_m());
        is_drawn
    });
    forms.reverse();
    forms
}

fn numbered(shown: &[bool]) -> Vec<u32> {
    let mut next = 0;
    let number = |&shown: &bool| {
        next += u32::from(shown);
        if shown { next - 1 } else { NONE }
    };
    shown.iter().map(number).collect()
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use glam::Vec2;

    use super::*;
    use crate::scene::Level;
    use crate::scene::sample::forest;

    /// Two forms beside the finest, the coarsest without leaves.
    fn with_levels() -> ValidScene {
        let mut scene = forest(&["Larix sibirica", "Betula pendula"], 12, 60.0);
        for prototype in &mut scene.prototypes {
            for (name, parts) in [("LOD1", 2), ("LOD2", 1)] {
                prototype.levels.push(Level {
                    name: name.into(),
                    parts: prototype.parts[..parts].to_vec(),
                    silhouette: Apart { worst_m: 0.5, rms_m: 0.1 },
                    octahedral: None,
                });
            }
        }
        scene.validate().unwrap()
    }

    #[test]
    fn a_form_brings_only_what_it_shows() {
        let scene = with_levels();
        assert_eq!(scene.level_names(), ["LOD1", "LOD2"]);
        let all = Selection::of(&scene, Forms::All);
        assert_eq!(all.parts().count(), 1 + 4 * 5);
        let finest = Selection::of(&scene, Forms::One(0));
        assert_eq!(finest.parts().count(), 1 + 4 * 2);
        assert_eq!(finest.materials.len(), scene.materials().len());
        let coarsest = Selection::of(&scene, Forms::One(2));
        assert!(coarsest.terrain.is_none());
        assert_eq!(coarsest.parts().count(), 4);
        assert!(coarsest.materials.iter().all(|m| m.name.ends_with("bark")));
        assert_eq!(coarsest.textures.len(), 2 * 3);
        for part in coarsest.parts() {
            let material = coarsest.materials[coarsest.material(part) as usize];
            assert_eq!(material.name, scene.materials()[part.material as usize].name);
            for (_, texture, _) in material.textures() {
                assert_eq!(coarsest.textures[coarsest.texture(texture) as usize], texture);
            }
        }
    }

    #[test]
    fn forms_that_a_coarser_one_betters_are_not_drawn() {
        let kept = |rms_m: &[f32]| -> Vec<f32> {
            let forms = drawn(rms_m.iter().map(|&m| Form::off(m)).collect());
            forms.iter().map(|f| f.silhouette.rms_m).collect()
        };
        assert_eq!(kept(&[0.0, 0.1, 0.2, 0.3]), [0.0, 0.1, 0.2, 0.3]);
        assert_eq!(kept(&[0.0, 0.05, 0.04, 0.12, 0.06]), [0.0, 0.04, 0.06]);
        assert_eq!(kept(&[0.0, 0.1, 0.1]), [0.0, 0.1]);
        assert_eq!(kept(&[0.0, 0.0]), [0.0, 0.0]);
        // An octahedral impostor is no better than its sheet where nothing turns it to the eye.
        let (centre, radius_m) = (Vec3::ZERO, 1.0);
        let octahedral = Octahedral { frames: 8, centre, radius_m, sheet_rms_m: 0.5 };
        let turning = Form { octahedral: Some(octahedral), ..Form::off(0.05) };
        assert_eq!(drawn(vec![Form::off(0.0), Form::off(0.1), turning]).len(), 3);
        let scene = with_levels();
        assert_eq!(Selection::of(&scene, Forms::Drawn).models[0].forms.len(), 2);
        assert!(kept(&[]).is_empty());
    }

    #[test]
    fn squares_hold_each_tree_once_with_its_own_model() {
        let scene = with_levels();
        let whole = Selection::of(&scene, Forms::One(0));
        let mut seen = vec![0; scene.instances().len()];
        let squares = whole.squares(16.0);
        assert!(squares.len() > 4);
        for (at, part) in squares {
            assert!(part.terrain.is_none() && !part.trees.is_empty());
            let used: BTreeSet<u32> = part.trees.iter().map(|t| t.model).collect();
            assert!(used.into_iter().eq(0..part.models.len() as u32));
            for tree in &part.trees {
                seen[tree.number as usize] += 1;
                let prototype = &scene.prototypes()[tree.instance.prototype as usize];
                assert_eq!(part.models[tree.model as usize].name, prototype.name);
                let within =
                    tree.instance.position.truncate() / 16.0 - Vec2::from(at.map(|c| c as f32));
                assert!((0.0..1.0).contains(&within.x) && (0.0..1.0).contains(&within.y));
            }
        }
        assert!(seen.iter().all(|&n| n == 1));
        let terrain = whole.terrain_alone().unwrap();
        assert_eq!((terrain.trees.len(), terrain.parts().count()), (0, 1));
        assert!(Selection::of(&scene, Forms::One(1)).terrain_alone().is_none());
    }
}
