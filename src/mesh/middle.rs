//! Where cards go that stand for many twigs: into the middle of those that are nearer to them than to any
//! other card (Lloyd 1982, "Least squares quantization in PCM"). So none stands out of the crown by itself,
//! and none leaves a gap beside it.
//!
//! Limit: a few rounds from an even choice, not the best places there are.

use glam::{Vec3, Vec4};
use rayon::prelude::*;
use rstar::RTree;
use rstar::primitives::GeomWithData;

use super::spot::{Hull, Spot, stands_for_many};

const ROUNDS: usize = 3;
/// Twigs looked at for each card, about.
const EACH: usize = 10;
/// Those that a thread takes at once.
const AT_ONCE: usize = 256;

/// How far cards go that way, 0…1: not where they stand for few twigs, which lie about them, nor where they are
/// many, of which one more or less shows little for the time it takes.
pub fn share(enlarge: f32, twigs: usize, cards: usize) -> f32 {
    const FEW_TWIGS: f32 = 2.0;
    const MANY_CARDS: f32 = 800.0;
    let each = twigs as f32 / cards.max(1) as f32;
    let by_twigs = (each / FEW_TWIGS - 1.0).clamp(0.0, 1.0);
    let by_cards = (2.0 - 2.0 * cards as f32 / MANY_CARDS).clamp(0.0, 1.0);
    stands_for_many(enlarge) * by_twigs * by_cards
}

/// Twigs of a crown, evenly many, as place and weight: what is deep inside is hidden.
pub fn sample(spots: &[Spot], hull: &Hull, cards: usize) -> Vec<Vec4> {
    let step = (spots.len() / (EACH * cards.max(1))).max(1);
    let weighted = |s: &Spot| {
        let weight = hull.weight(s.at);
        (s.at * weight).extend(weight)
    };
    spots.iter().step_by(step).map(weighted).collect()
}

/// The middle of the twigs for which each of the `kept` stands; that of a leader is its own place.
pub fn middles(kept: &[Spot], sample: &[Vec4]) -> Vec<Vec3> {
    let mut middle: Vec<Vec3> = kept.iter().map(|s| s.at).collect();
    for _ in 0..ROUNDS {
        let numbered = (0..).zip(&middle).map(|(k, m)| GeomWithData::new(m.to_array(), k));
        let tree: RTree<GeomWithData<[f32; 3], u32>> = RTree::bulk_load(numbered.collect());
        let mut sum = vec![Vec4::ZERO; kept.len()];
        let nearest = |twig: &Vec4| {
            let at = twig.truncate() / twig.w;
            tree.nearest_neighbor(at.to_array()).map_or(0, |found| found.data)
        };
        let nearest: Vec<u32> = sample.par_iter().with_min_len(AT_ONCE).map(nearest).collect();
        for (&twig, k) in sample.iter().zip(nearest) {
            sum[k as usize] += twig;
        }
        for ((middle, spot), sum) in middle.iter_mut().zip(kept).zip(sum) {
            if sum.w > 0.0 && !spot.is_leader {
                *middle = sum.truncate() / sum.w;
            }
        }
    }
    middle
}

#[cfg(test)]
mod tests {
    use super::*;

    fn spot(at: Vec3) -> Spot {
        Spot { at, shoot: Vec3::Z, turn: 0, is_tip: false, is_leader: false, key: 0 }
    }

    #[test]
    fn cards_go_to_the_middle_of_their_twigs() {
        let rows = (0..20).map(|k| Vec3::X * (k % 10) as f32 + Vec3::Y * (k / 10 * 100) as f32);
        let twigs: Vec<Vec4> = rows.map(|p| p.extend(1.0)).collect();
        let leader = Spot { is_leader: true, ..spot(Vec3::Z * 1e3) };
        let kept = [spot(Vec3::ZERO), spot(Vec3::new(9.0, 100.0, 0.0)), leader];
        let found = middles(&kept, &twigs);
        let wanted = [Vec3::new(4.5, 0.0, 0.0), Vec3::new(4.5, 100.0, 0.0), leader.at];
        for (found, wanted) in found.into_iter().zip(wanted) {
            assert!(found.distance(wanted) < 1e-4, "{found} {wanted}");
        }
    }
}
