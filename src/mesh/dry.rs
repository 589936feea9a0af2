//! Dry branches of a tree that weakens or dies bear the twigs that their needles and leaves have left: bare ones,
//! as all of a tree's are in winter. They share its picture, and get as many of the triangles for twigs as there
//! are places for them.

use super::foliage::{FoliageLevel, HEIGHTS, Order, Stalks, foliage};
use super::{MeshOptions, Surface, TwigsAs};
use crate::diagnostic::Result;
use crate::skeleton::Skeleton;
use crate::species::Species;
use crate::texture::Atlas;

/// Twigs of the branches of a tree that are dead, beside others that live.
pub struct Dry {
    species: Species,
    atlas: Atlas,
    /// Of the triangles for twigs, those that go to these.
    pub share: f32,
}

impl Dry {
    /// Greatest share: the tree lives, and what does is seen first.
    const MOST: f32 = 0.5;

    /// `None` where no branch is dead, or no picture shows its twigs.
    pub fn of(
        skeleton: &Skeleton,
        species: &Species,
        atlas: &Atlas,
        options: &MeshOptions,
    ) -> Option<Dry> {
        let f = &species.foliage;
        match options.foliage {
            FoliageLevel::None => return None,
            // A hull hides them.
            FoliageLevel::Shell if !f.is_bare() => return None,
            _ => {}
        }
        let atlas = if f.is_bare() { atlas.clone() } else { atlas.dry()? };
        let [alive, dead] = [false, true].map(|of_dead| {
            let bears = skeleton.bears_twigs(f.bearing_radius_m, of_dead);
            let bearing = (0..skeleton.len() as u32).filter(|&i| bears[i as usize]);
            bearing.map(|i| skeleton.internode_m(i)).sum::<f32>()
        });
        let share = dead / (dead + alive * options.leaf_share).max(1e-6);
        let species =
            Species { foliage: f.dry(), own_model: None, own_picture: None, ..species.clone() };
        (dead > 0.0).then_some(Dry { species, atlas, share: share.min(Dry::MOST) })
    }

    /// `beside`: the order of those in leaf, but for the triangles.
    pub fn made(&self, skeleton: &Skeleton, beside: &Order<'_>) -> Result<Surface> {
        let stalks = match beside.stalks {
            Stalks::None => Stalks::None,
            _ => Stalks::All,
        };
        let order = Order {
            species: &self.species,
            atlas: &self.atlas,
            is_on_dead: true,
            share: 1.0,
            larger: [1.0; HEIGHTS],
            twigs: TwigsAs::Merged,
            stalks,
            ..*beside
        };
        Ok(foliage(skeleton, &order)?.surface)
    }
}
