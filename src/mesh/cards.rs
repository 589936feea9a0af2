//! The cards of a crown: which picture each has, and the stalks that hold them to the wood.

use std::ops::Range;

use glam::Vec3;
use rayon::prelude::*;

use super::card::{self, Shape};
use super::foliage::Order;
use super::piece::{Piece, fill};
use super::spot::{Pose, Spot, stance};
use super::{Surface, stalk};
use crate::seed::Draws;
use crate::skeleton::Skeleton;
use crate::texture::{Atlas, Cell};

/// Cards take the picture for one so much larger or smaller, natural logarithm; bare ones rather a fuller one.
const BLEND: [f32; 2] = [-0.15, 0.15];
const BLEND_BARE: [f32; 2] = [-0.15, 0.9];
/// Most cards of a leafy tree have pictures of one scale, so that their leaves are of one size: those between
/// so many times the size that it is for; where there are pictures of more than two scales, halfway to the next.
const LIKE_USUAL: [f32; 2] = [0.5, 1.6];
const LIKE_USUAL_OF_MANY: [f32; 2] = [0.8, 1.25];
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
    /// Those that have the shape; the others are flat.
    pub is_raised: Vec<bool>,
    pub shape: Shape,
    /// The size for which the pictures of most are.
    pub usual_m: f32,
}

/// The pictures that most cards have, and for cards of which sizes over `usual_m`.
struct Usual {
    ids: Vec<usize>,
    like: Range<f32>,
}

/// How one stands and what it shows.
struct Card<'a> {
    pose: Pose,
    /// Of its halves, or its rim, radians.
    fold_rad: f32,
    id: usize,
    cell: &'a Cell,
}

impl<'a> Cards<'a> {
    /// All of them, as `stand` says.
    pub fn surface(&self, stand: &Stand<'_>) -> Surface {
        let (raised, flat): (Vec<usize>, Vec<usize>) =
            (0..self.kept.len()).partition(|&k| self.is_raised[k]);
        let usual = self.usual();
        let mut surface = self.of_shape(&raised, self.shape, &usual, stand);
        if raised.is_empty() {
            surface = self.of_shape(&flat, Shape::Flat, &usual, stand);
        } else if !flat.is_empty() {
            surface.append(self.of_shape(&flat, Shape::Flat, &usual, stand));
        }
        surface
    }

    fn of_shape(&self, which: &[usize], shape: Shape, usual: &Usual, stand: &Stand<'_>) -> Surface {
        let outlines = self.order.atlas.outlines(shape.rows());
        let emit = |k: usize, out: &mut Piece| {
            let Card { pose, fold_rad, id, cell } = self.card(which[k], usual, stand);
            card::emit(&pose, shape, fold_rad, cell, &outlines[id], out);
        };
        let spots: Vec<Spot> = match self.order.wind {
            Some(_) => which.iter().map(|&k| self.kept[k]).collect(),
            None => Vec::new(),
        };
        let wind = self.order.wind.map(|wind| (wind, spots.as_slice()));
        fill(which.len(), shape.room(), emit, wind)
    }

    fn usual(&self) -> Usual {
        let atlas = self.order.atlas;
        let [low, high] = if atlas.scales() > 2 { LIKE_USUAL_OF_MANY } else { LIKE_USUAL };
        Usual { ids: atlas.nearest(self.usual_m).collect(), like: low..high }
    }

    fn card(&self, k: usize, usual: &Usual, stand: &Stand<'_>) -> Card<'a> {
        let Order { species, atlas, .. } = *self.order;
        let is_bare = species.foliage.is_bare();
        let (pose, mut draws) = lifted(stand, k);
        // Pictures of one scale give way to those of the next little by little.
        let [least, most] = if is_bare { BLEND_BARE } else { BLEND };
        let size_m = pose.size_m * draws.between(least, most).exp();
        let like_usual = usual.like.contains(&(size_m / self.usual_m));
        let id = match like_usual && !is_bare {
            true => usual.ids[draws.index(usual.ids.len())],
            false => {
                let cells = atlas.nearest(size_m);
                let pick = draws.index(cells.clone().count());
                cells.clone().nth(pick).unwrap_or(0)
            }
        };
        let fold_rad = stance(species.foliage.shape).fold * draws.between(0.6, 1.3);
        let shade = atlas.shade(id).filter(|_| draws.unit() < self.order.shaded);
        Card { pose, fold_rad, id, cell: shade.unwrap_or(&atlas.cells()[id]) }
    }

    /// The stalks of some of them.
    pub fn stalks(&self, which: &[usize], stand: &Stand<'_>) -> Surface {
        let Order { species, atlas, is_meshed, wind, .. } = *self.order;
        let is_bare = species.foliage.is_bare();
        let usual = self.usual();
        let one = |&k: &usize| {
            let Card { pose, cell, .. } = self.card(k, &usual, stand);
            (pose, cell.stem())
        };
        let (poses, stems): (Vec<Pose>, Vec<f32>) = which.par_iter().map(one).unzip();
        let bases: Vec<Vec3> = poses.iter().map(|pose| pose.base).collect();
        let spots: Vec<Spot> = which.iter().map(|&k| self.kept[k]).collect();
        let stoutest = if is_bare { STOUTEST_BARE } else { f32::INFINITY };
        let feet = stalk::Feet::ending_at(&bases, self.skeleton, is_meshed, &spots, stoutest);
        stalk::stalks(&feet, &spots, &poses, &stems, (is_bare, atlas.wood()), wind)
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
