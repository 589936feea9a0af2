//! The cards of a crown: which picture each has, and the stalks that hold them to the wood.

use glam::Vec3;
use rayon::prelude::*;

use super::card::{self, Shape};
use super::foliage::{Order, Stalks};
use super::piece::{Piece, Room, fill};
use super::spot::{Pose, Spot, stance};
use super::{Surface, stalk};
use crate::seed::Draws;
use crate::skeleton::Skeleton;
use crate::texture::Atlas;

/// Cards take the picture for one so much larger or smaller, natural logarithm; bare ones rather a fuller one.
const BLEND: [f32; 2] = [-0.15, 0.15];
const BLEND_BARE: [f32; 2] = [-0.15, 0.9];
/// Most cards of a leafy tree have pictures of one scale, so that their leaves are of one size: those between
/// so many times the size that it is for.
const LIKE_USUAL: [f32; 2] = [0.5, 1.6];
/// It is that for cards so much larger: leaves look too small rather than too large.
const FULLER: f32 = 1.1;

/// Radius of a bare twig's stalk over that of its shoot, at most. Where leaves hide the rest of a stalk, it is as
/// thick as the shoots that it stands for.
const STOUTEST_BARE: f32 = 1.5;

/// The cards of a tree.
pub struct Cards<'a> {
    pub skeleton: &'a Skeleton,
    pub order: &'a Order<'a>,
    /// Where they stand.
    pub kept: &'a [Spot],
    pub shape: Shape,
    /// The size for which the pictures of most are.
    pub usual_m: f32,
}

impl Cards<'_> {
    /// All of them, as `stand` says; with stalks where all have them.
    pub fn surface(&self, room: Room, stand: &Stand<'_>) -> Surface {
        let Order { species, atlas, is_meshed, .. } = *self.order;
        let is_bare = species.foliage.is_bare();
        let outlines = atlas.outlines(self.shape.rows());
        let fold = stance(species.foliage.shape).fold;
        // Found once: most cards take them.
        let usual: Vec<usize> = atlas.nearest(self.usual_m).collect();
        let mut feet = Vec::new();
        if self.order.stalks == Stalks::All {
            let bases = (0..self.kept.len()).into_par_iter().map(|k| lifted(stand, k).0.base);
            let bases: Vec<Vec3> = bases.collect();
            feet = stalk::feet(self.skeleton, is_meshed, self.kept, &bases, STOUTEST_BARE);
        }
        let emit = |k, out: &mut Piece| {
            let (pose, mut draws) = lifted(stand, k);
            // Pictures of one scale give way to those of the next little by little.
            let [least, most] = if is_bare { BLEND_BARE } else { BLEND };
            let size_m = pose.size_m * draws.between(least, most).exp();
            let like_usual = (LIKE_USUAL[0]..LIKE_USUAL[1]).contains(&(size_m / self.usual_m));
            let id = match like_usual && !is_bare {
                true => usual[draws.index(usual.len())],
                false => {
                    let cells = atlas.nearest(size_m);
                    let pick = draws.index(cells.clone().count());
                    cells.clone().nth(pick).unwrap_or(0)
                }
            };
            let fold = fold * draws.between(0.6, 1.3);
            let shade = atlas.shade(id).filter(|_| draws.unit() < self.order.shaded);
            let cell = shade.unwrap_or(&atlas.cells()[id]);
            card::emit(&pose, self.shape, fold, cell, &outlines[id], out);
            if let Some(foot) = feet.get(k) {
                stalk::emit(&pose, foot, cell.stem(), atlas.wood(), out);
            }
        };
        fill(self.kept.len(), room, emit, self.order.wind.map(|wind| (wind, self.kept)))
    }

    /// The stalks of those that would hang in the air.
    pub fn hung(&self, afloat: &[usize], stand: &Stand<'_>) -> Surface {
        let Order { atlas, is_meshed, wind, .. } = *self.order;
        let spots: Vec<Spot> = afloat.iter().map(|&k| self.kept[k]).collect();
        let poses: Vec<Pose> = afloat.par_iter().map(|&k| lifted(stand, k).0).collect();
        stalk::hung(self.skeleton, is_meshed, &spots, &poses, atlas.wood(), wind)
    }
}

/// How the card of a place stands, and the rest of its chance.
pub type Stand<'a> = dyn Fn(usize) -> (Pose, Draws) + Sync + 'a;

fn lifted(stand: &Stand<'_>, k: usize) -> (Pose, Draws) {
    let (mut pose, draws) = stand(k);
    pose.lift();
    (pose, draws)
}

/// The size for which the pictures of most cards are, whose own size is `card_m`.
pub fn usual_picture_m(atlas: &Atlas, card_m: f32) -> f32 {
    let nearest = atlas.nearest(card_m * FULLER).next();
    nearest.map_or(card_m, |id| atlas.cells()[id].size_m).max(1e-6)
}

/// Opaque share of cells, their mean.
pub fn coverage(atlas: &Atlas, ids: impl Iterator<Item = usize>) -> f32 {
    let (sum, count) =
        ids.fold((0.0, 0.0f32), |(sum, n), id| (sum + atlas.cells()[id].coverage, n + 1.0));
    sum / count.max(1.0)
}
