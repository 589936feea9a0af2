//! Where on a tree which bark is: old at its foot, younger above and on branches, that of twigs; and
//! how it is laid, around thick wood or there and back around thin wood.

use std::f32::consts::TAU;

use glam::{Vec2, Vec4};

use super::path::Ring;
use crate::seed::Seed;
use crate::species::model::Bark;
use crate::texture::bark::TILES;

/// Barks of a tree: old, that of the upper stem and branches, what lies between the two, that of twigs.
pub const BARKS: usize = 4;
pub const OLD: usize = 0;
pub const UPPER: usize = 1;
pub const TRANSITION: usize = 2;
const TWIG: usize = 3;
/// Each laid in one way or the other.
pub const COATS: usize = 2 * BARKS;

/// A bark, and how it is laid.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Coat(pub usize);

impl Coat {
    fn of(bark: usize, is_folded: bool) -> Coat {
        Coat(bark + if is_folded { BARKS } else { 0 })
    }

    pub fn bark(self) -> usize {
        self.0 % BARKS
    }

    /// Laid there and back, not around.
    pub fn is_folded(self) -> bool {
        self.0 >= BARKS
    }
}

/// How much finer than on thick stems bark is where less than one tile goes around: one does, to this
/// scale.
pub const FINEST: f32 = 3.0;
/// Bark is folded where a girth has fewer tiles than one that fine: from all around to all folded.
pub const FOLDED_GIRTH: [f32; 2] = [0.36, 0.27];

/// How bark is laid around a cylinder: tiles around, or on the way there where it is laid there and back; and tiles
/// along a metre.
pub struct Around {
    pub tiles: f32,
    pub is_folded: bool,
    pub per_m: f32,
}

impl Around {
    /// As around a tube so thick.
    pub fn cylinder(radius_m: f32, repeat_m: f32) -> Around {
        let girth = (TAU * radius_m / repeat_m).max(1e-6);
        if girth < FOLDED_GIRTH[1] {
            return Around {
                tiles: 0.5 * FINEST * girth,
                is_folded: true,
                per_m: FINEST / repeat_m,
            };
        }
        let tiles = girth.round().max(1.0);
        Around { tiles, is_folded: false, per_m: (tiles / girth).min(FINEST) / repeat_m }
    }

    /// Texture coordinates of a place so far around, share of a turn, and so high. There and back: from half a turn.
    pub fn at(&self, turn: f32, z: f32) -> Vec2 {
        let turn = if self.is_folded { (2.0 * turn - 1.0).abs() } else { turn };
        Vec2::new(self.tiles * turn, self.per_m * z)
    }
}

/// Where bark is young, from all old to all young; `None` where the species has no such bark.
#[derive(Debug, Clone, Copy, Default)]
pub struct Young {
    /// That of the upper stem: radii and heights, metres.
    pub upper: Option<Upper>,
    /// That of twigs: radii, metres.
    pub twig_m: Option<[f32; 2]>,
}

/// From all old to all young.
#[derive(Debug, Clone, Copy)]
pub struct Upper {
    pub radius_m: [f32; 2],
    pub height_m: [f32; 2],
}

impl Upper {
    /// Radii at which wood is thin, over that of the stem's foot; the species says how high is high up.
    const RADIUS: [f32; 2] = [0.5, 0.3];

    /// Of a tree of this height whose foot has this radius; `None` where its bark is one.
    pub fn of(bark: &Bark, foot_m: f32, height_m: f32) -> Option<Upper> {
        bark.upper?;
        Some(Upper {
            radius_m: Upper::RADIUS.map(|r| r * foot_m.max(1e-6)),
            height_m: bark.upper_from.map(|h| h * height_m.max(1e-6)),
        })
    }

    /// The height and the radius where it is half young.
    pub fn half(&self) -> [f32; 2] {
        [self.height_m, self.radius_m].map(|range| 0.5 * (range[0] + range[1]))
    }
}

/// Two coats, and the share of the second; between 0 and 1 the facets mix.
#[derive(Clone, Copy)]
pub struct Mix {
    pub coat: [Coat; 2],
    pub share: f32,
}

impl Mix {
    pub fn mixes(self) -> bool {
        self.share > 0.0 && self.share < 1.0
    }

    pub fn most(self) -> Coat {
        self.coat[usize::from(self.share >= 0.5)]
    }

    /// Its share of the second of two coats; `None` where it has another.
    pub fn share_of(self, pair: [Coat; 2]) -> Option<f32> {
        match self.coat {
            same if same == pair => Some(self.share),
            _ if self.mixes() => None,
            _ => pair.iter().position(|&b| b == self.most()).map(|k| k as f32),
        }
    }
}

/// A band through which the line between two coats winds: these, and the shares of the second at
/// its rings.
#[derive(Clone, Copy)]
pub struct Blend {
    pub pair: [Coat; 2],
    pub share: [f32; 2],
}

/// Fewest sides of such a band: the facets of thinner wood are small enough.
const LEAST_BLENDED: u32 = 6;

impl Blend {
    /// Of a band between two rings.
    pub fn of([low, high]: [Mix; 2], sides: [u32; 2]) -> Option<Blend> {
        if sides[0] != sides[1] || sides[0] < LEAST_BLENDED {
            return None;
        }
        let pair = if high.mixes() { high.coat } else { low.coat };
        let share = [low.share_of(pair)?, high.share_of(pair)?];
        (share != [0.0; 2] && share != [1.0; 2]).then_some(Blend { pair, share })
    }
}

/// A leader has the bark of twigs where it is this much thinner than a branch that does: wood of its
/// girth is older than theirs.
const LEADER: f32 = 0.4;

impl Young {
    /// Along a stem.
    pub fn of_stem(self) -> Young {
        Young { twig_m: self.twig_m.map(|r| r.map(|m| m * LEADER)), ..self }
    }

    pub fn is_there(&self, bark: usize) -> bool {
        match bark {
            OLD => true,
            TWIG => self.twig_m.is_some(),
            _ => self.upper.is_some(),
        }
    }

    /// How long the tiles of a transition are on wood of a radius; `None` where twigs' bark begins.
    pub fn transition_m(&self, radius_m: f32, repeat_m: f32) -> Option<f32> {
        let girth = TAU * radius_m / repeat_m;
        let is_twig = self.twig_m.is_some_and(|r| part(radius_m, r) > 0.0);
        let density = girth.round().max(1.0) / girth.max(1e-6);
        (!is_twig && girth > FOLDED_GIRTH[0]).then(|| TILES as f32 * repeat_m / density)
    }

    /// Whether wood of a radius has the bark of twigs.
    pub fn is_twig(&self, radius_m: f32) -> bool {
        self.twig_m.is_some_and(|range| part(radius_m, range) >= 0.5)
    }

    /// Of a ring whose bark is known but for twigs.
    pub fn at(&self, ring: &Ring) -> Mix {
        if ring.bark == TRANSITION {
            return Mix { coat: [Coat::of(TRANSITION, false); 2], share: 0.0 };
        }
        let twig = self.twig_m.map_or(0.0, |r| part(ring.radius_m, r));
        let folded = part(ring.girth, FOLDED_GIRTH);
        let mixes = |share: f32| share > 0.0 && share < 1.0;
        if mixes(folded) && !mixes(twig) {
            let bark = if twig > 0.0 { TWIG } else { ring.bark };
            return Mix { coat: [false, true].map(|f| Coat::of(bark, f)), share: folded };
        }
        Mix { coat: [ring.bark, TWIG].map(|b| Coat::of(b, folded >= 0.5)), share: twig }
    }
}

/// How far on the way from one end of a range to the other, 0…1.
fn part(x: f32, range: [f32; 2]) -> f32 {
    let span = range[1] - range[0];
    let span = if span.abs() < 1e-9 { 1e-9 } else { span };
    ((x - range[0]) / span).clamp(0.0, 1.0)
}

/// A tube's random phase, which few ask for: of its buttresses, and of where barks meet.
pub struct Luck {
    seed: Seed,
    key: u64,
    phase: Option<f32>,
}

impl Luck {
    pub fn new(seed: Seed, key: u64) -> Luck {
        Luck { seed, key, phase: None }
    }

    pub fn phase(&mut self) -> f32 {
        *self
            .phase
            .get_or_insert_with(|| self.seed.derive("bark", self.key).draws().between(0.0, TAU))
    }

    /// Share of a bark from which on a place has it, 0…1: one reaches into the other in tongues.
    /// `turn`: part of a full turn around the ring.
    pub fn limit(&mut self, turn: f32, ring: &Ring) -> f32 {
        limit(turn, self.waves(ring), heights(ring.sides))
    }

    /// Turns of the waves at a ring's first corner.
    fn waves(&mut self, ring: &Ring) -> Vec4 {
        const PHASE: Vec4 = Vec4::new(1.0, 2.3, 4.1, 5.2);
        const RISE: Vec4 = Vec4::new(0.25, -0.6, 0.9, -1.4);
        // Girths along the tube; few where it is thin.
        let is_folded = ring.girth < FOLDED_GIRTH[1];
        let along = ring.v / if is_folded { 0.25 } else { ring.repeats };
        PHASE * (self.phase() / TAU) + RISE * along
    }
}

/// Waves around a ring.
const AROUND: Vec4 = Vec4::new(2.0, 3.0, 5.0, 11.0);

/// Heights of the waves at a ring of so many corners: what is too fine for them would leave chips of single
/// facets.
fn heights(sides: u32) -> Vec4 {
    const HIGH: Vec4 = Vec4::new(0.16, 0.12, 0.14, 0.1);
    /// Corners a wave, from none of it to all.
    const SEEN: [f32; 2] = [2.5, 3.5];
    let corners = Vec4::splat(sides as f32) / AROUND;
    HIGH * ((corners - SEEN[0]) / (SEEN[1] - SEEN[0])).clamp(Vec4::ZERO, Vec4::ONE)
}

fn limit(turn: f32, waves: Vec4, heights: Vec4) -> f32 {
    (0.5 + heights.dot(sine(AROUND * turn + waves))).clamp(0.001, 0.999)
}

/// The limits at the corners of the rings of one band of a tube, the first of each again at the end.
#[derive(Default)]
pub struct Limits {
    below: Vec<f32>,
    above: Vec<f32>,
    /// The ring of those above.
    ring: usize,
}

impl Limits {
    /// Before a tube.
    pub fn begin(&mut self) {
        self.ring = usize::MAX;
    }

    /// Those of a band between two rings of as many sides, with the shares of the second bark at them;
    /// bands come from the foot up.
    pub fn band(
        &mut self,
        [low, high]: [usize; 2],
        share: [f32; 2],
        rings: &[Ring],
        luck: &mut Luck,
    ) {
        std::mem::swap(&mut self.below, &mut self.above);
        if self.ring != low || self.below.len() != rings[low].sides as usize + 1 {
            Self::fill(&mut self.below, &rings[low], rings[high].sides, luck);
        }
        Self::fill(&mut self.above, &rings[high], rings[high].sides, luck);
        self.join(share);
        self.ring = high;
    }

    /// A corner that differs from those beside and below it goes with them: it would be a chip.
    fn join(&mut self, share: [f32; 2]) {
        let sides = self.above.len().saturating_sub(1);
        for k in 0..sides {
            let beside = [(k + sides - 1) % sides, k + 1].map(|k| self.above[k]);
            let is_second = share[1] >= self.above[k];
            let is_alone = beside.iter().all(|limit| (share[1] >= *limit) != is_second)
                && (share[0] >= self.below[k]) != is_second;
            if is_alone {
                self.above[k] = 0.5 * (beside[0] + beside[1]);
            }
        }
        if sides > 0 {
            self.above[sides] = self.above[0];
        }
    }

    /// Of the lower ring and the upper one.
    pub fn at(&self, corner: u32) -> [f32; 2] {
        [&self.below, &self.above].map(|limits| limits.get(corner as usize).copied().unwrap_or(0.5))
    }

    fn fill(limits: &mut Vec<f32>, ring: &Ring, sides: u32, luck: &mut Luck) {
        let (waves, heights) = (luck.waves(ring), heights(sides));
        limits.clear();
        limits.extend((0..sides).map(|k| limit(k as f32 / sides as f32, waves, heights)));
        limits.extend(limits.first().copied());
    }
}

/// Sines of so many turns, fewer than a million, within 0.001.
fn sine(turns: Vec4) -> Vec4 {
    /// Adding it rounds to whole numbers.
    const ROUND: Vec4 = Vec4::splat(1.5 * (1 << 23) as f32);
    // −½…½, and the half turn that is left as a quarter about 0.
    let part = turns - ((turns + ROUND) - ROUND);
    let fold = 0.25 - (part.abs() - 0.25).abs();
    let y = fold * fold;
    let sine = fold * (TAU + y * (-41.341_7 + y * (81.605_2 - y * 76.705_9)));
    sine.copysign(part)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sines_are_those_of_the_library() {
        for k in -20_000..20_000 {
            let turns = k as f32 * 0.001_37;
            let true_sine = (f64::from(turns) * std::f64::consts::TAU).sin() as f32;
            assert!((sine(Vec4::splat(turns)).w - true_sine).abs() < 1e-3, "{turns}");
        }
    }
}
