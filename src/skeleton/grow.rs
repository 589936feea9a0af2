//! A species, and a crown if there is one, to a skeleton (T15, method "L-systems", "Length
//! decay" and "Space colonization").
//!
//! 1. The envelope: from the crown's attractors, or from the species.
//! 2. The stem, and along it the laterals that the species' rule writes. A rule puts all laterals
//!    of a shoot at its tip, one set an iteration; here the sets are spread along the shoot they
//!    belong to, the oldest lowest, and turned about it, as whorls of successive years stand.
//!    Angles and curves are those of the species' habit for the order and height; lengths follow
//!    L = L_apex − (α / L_apex)·r within the envelope.
//! 3. Space colonization from the scaffold into the crown's own centres of mass and into samples
//!    of the envelope where a scan sees nothing.
//! 4. Axes, smoothing, hanging twigs; height and width brought to the target; curves, of a tree seen from
//!    near.
//! 5. Radii.

use std::collections::{BTreeMap, BTreeSet};

use glam::{Quat, Vec2, Vec3};

use super::colonize::{Habit as Answer, Limits, Reach, Start, colonize};
use super::envelope::{Envelope, light_at, round_curve};
use super::limb::{Limb, sides};
use super::radii::{Pipes, radii};
use super::scaffold::{Shoot, scaffold};
use super::stage::births;
use super::surroundings::{Space, Surroundings};
use super::{NO_PARENT, Skeleton, bend, polish};
use crate::crown::Crown;
use crate::diagnostic::{Error, Result};
use crate::seed::Seed;
use crate::species::Species;
use crate::species::model::{Growth, Habit, curve, is_level, youth};
use crate::species::rule::OF_TREE;

/// Heights a tree may have, metres.
pub const HEIGHTS_M: std::ops::RangeInclusive<f32> = 0.1..=130.0;

/// The tree wanted.
#[derive(Debug, Clone, Copy)]
pub enum Target<'a> {
    /// A tree of the species, at its typical height where none is given.
    FromSpecies { height_m: Option<f32> },
    /// The tree that fills a crown of the scan.
    FromCrown(&'a Crown),
}

/// How finely a tree is grown.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Detail {
    /// Bound on the nodes that grow; about so many are used. Where it is 5,000 or more, internodes are
    /// bent, for which up to three nodes each are added.
    pub max_nodes: u32,
    /// Distance between attractors; from the crown's volume and `max_nodes` where `None`.
    pub attractor_spacing_m: Option<f32>,
}

impl Detail {
    /// One of many trees in a forest.
    pub const FOREST: Detail = Detail { max_nodes: 700, attractor_spacing_m: None };
    /// A tree seen from near.
    pub const HERO: Detail = Detail { max_nodes: 4000, attractor_spacing_m: None };
}

/// Nodes of a tree between which detail is bounded.
const NODES: std::ops::RangeInclusive<u32> = 40..=200_000;
/// Nodes of a young tree, and sets of laterals on its stem, at least.
const YOUNG_NODES: f32 = 300.0;
const YOUNG_INTERNODES: f32 = 8.0;
/// Nodes at which a species' counts of whorls are meant.
const FULL_NODES: f32 = 4000.0;
/// Nodes that may grow from which on internodes are bent: of trees of fewer triangles one sees no curves.
const BENT_NODES: usize = 5_000;
/// Nodes that a stem needs: a tree of few has fewer stems.
const NODES_OF_STEM: usize = 24;
/// Radius of the circle on which the stems of a stool stand, in their diameters, over their number: side by
/// side they take 1 / π.
const ABREAST: f32 = 0.36;
/// Stems of one tree; their axes have the first ids of the scaffold.
const MAX_STEMS: u32 = 64;
/// Share of the crown's height up to which a stem goes from which on it is the tree's top.
const STEM_TO_TOP: f32 = 0.95;
/// By how much a limb turns off the end of its stem over what limbs do beside one.
const LEANS: f32 = 0.35;
/// Share of the nodes that the scaffold may take.
const SCAFFOLD_SHARE: f32 = 0.65;

/// Grows a tree that stands alone. Same arguments, same bytes.
///
/// # Errors
/// A height outside [`HEIGHTS_M`] or a crown that is not finite.
pub fn grow(species: &Species, target: Target, detail: Detail, seed: Seed) -> Result<Skeleton> {
    grow_among(species, target, detail, &Surroundings::none(), seed)
}

/// Grows a tree whose branches leave its surroundings free: no wood but the stem's is in a wall,
/// in the ground or in a neighbour's crown. The tree's own crown radius is set here.
///
/// # Errors
/// As [`grow`].
pub fn grow_among(
    species: &Species,
    target: Target,
    detail: Detail,
    around: &Surroundings<'_>,
    seed: Seed,
) -> Result<Skeleton> {
    let of_height;
    let grown_crown_m = species.size.height_m * (1.0 - species.size.crown_base);
    let (envelope, seen) = match target {
        Target::FromSpecies { height_m } => {
            let height_m = checked_height(height_m.unwrap_or(species.size.height_m))?;
            of_height = species.at_height(height_m);
            let (size, uneven) = (&of_height.size, of_height.growth.uneven);
            (Envelope::of_species(size, uneven, height_m, seed), Vec::new())
        }
        Target::FromCrown(crown) => {
            of_height = species.at_height(checked_height(crown.height_m)?);
            if !(crown.root.is_finite() && crown.apex.is_finite() && crown.diameter_m.is_finite()) {
                return Err(Error::new(format!("the crown at {} is not finite", crown.root))
                    .remedy("look for NaN coordinates in the scan"));
            }
            let seen: Vec<Vec3> = crown.attractors.iter().map(|&p| p - crown.root).collect();
            (Envelope::of_crown(&of_height.size, crown, &seen), seen)
        }
    };
    let species = &of_height;
    let (max_nodes, spacing_m) = fineness(&envelope, species, detail);
    let around = Surroundings { crown_radius_m: envelope.radius_m, ..around.clone() };
    let mut tree =
        Tree::new(species, &envelope, &around, seed, spacing_m, max_nodes, grown_crown_m);
    tree.add_stem_and_branches()?;
    tree.colonize(&seen);
    Ok(tree.finish())
}

fn checked_height(height_m: f32) -> Result<f32> {
    if HEIGHTS_M.contains(&height_m) {
        return Ok(height_m);
    }
    Err(Error::new(format!("a tree of {height_m} m can't be grown")).remedy(format!(
        "heights from {} to {} m are grown",
        HEIGHTS_M.start(),
        HEIGHTS_M.end()
    )))
}

/// Least attractor spacing over the length of a leafy twig: what is finer is a card's own picture.
const TWIG_SHARE: f32 = 0.3;
/// How far down limbs may droop, share of the height of the crown's base.
const LOWEST_LIMB: f32 = 0.6;

/// The nodes the tree may take, and the attractor spacing at which the part of the crown that
/// bears twigs takes those left to it. A small tree needs fewer than it may have.
fn fineness(e: &Envelope, species: &Species, detail: Detail) -> (u32, f32) {
    let growth = &species.growth;
    let max_nodes = detail.max_nodes.clamp(*NODES.start(), *NODES.end());
    let twiggy = 1.0 - growth.bare.clamp(0.0, 0.9).powi(2);
    let share = growth.fill.clamp(0.1, 1.0);
    let volume_m3 = e.volume_m3() * twiggy * share / 0.75;
    let least_m = (TWIG_SHARE * species.foliage.twig_length_m).max(1e-3 * e.height_m);
    let wished = detail.attractor_spacing_m.filter(|s| s.is_finite() && *s > 0.0);
    match wished {
        Some(spacing_m) => (max_nodes, spacing_m.max(1e-3 * e.height_m)),
        None => {
            let fewest = *NODES.start() as f32;
            // Fewer would leave none for the branches of the top.
            let fewest = fewest + (YOUNG_NODES - fewest) * (2.0 * youth(e.height_m)).min(1.0);
            let max_nodes = max_nodes as f32;
            let most = (volume_m3 / least_m.powi(3)).clamp(fewest.min(max_nodes), max_nodes);
            (most as u32, (volume_m3 / most).cbrt())
        }
    }
}

/// A branch of the scaffold that has been drawn, to hang its laterals on.
#[derive(Clone, Default)]
struct Drawn {
    /// Base node and own nodes; empty: not grown.
    nodes: Vec<u32>,
    length_m: f32,
}

struct Tree<'a> {
    species: &'a Species,
    growth: &'a Growth,
    /// Length of the crown of a grown tree of the species.
    grown_crown_m: f32,
    envelope: &'a Envelope,
    around: &'a Surroundings<'a>,
    seed: Seed,
    spacing_m: f32,
    max_nodes: usize,
    /// Lowest height of any part of a branch.
    clearance_m: f32,
    position: Vec<Vec3>,
    parent: Vec<u32>,
    /// Axis of the scaffold, or [`polish::FREE`].
    scaffold: Vec<u32>,
    heading: Vec<Vec3>,
    /// Whether colonization may start here.
    is_open: Vec<bool>,
}

impl<'a> Tree<'a> {
    fn new(
        species: &'a Species,
        envelope: &'a Envelope,
        around: &'a Surroundings<'a>,
        seed: Seed,
        spacing_m: f32,
        max_nodes: u32,
        grown_crown_m: f32,
    ) -> Self {
        let mut tree = Tree {
            species,
            growth: &species.growth,
            grown_crown_m,
            envelope,
            around,
            seed,
            spacing_m,
            max_nodes: max_nodes as usize,
            clearance_m: (0.04 * envelope.height_m).min(0.25),
            position: Vec::new(),
            parent: Vec::new(),
            scaffold: Vec::new(),
            heading: Vec::new(),
            is_open: Vec::new(),
        };
        tree.push(Vec3::ZERO, NO_PARENT, 0, Vec3::Z, false);
        tree
    }

    fn push(&mut self, at: Vec3, parent: u32, axis: u32, heading: Vec3, is_open: bool) -> u32 {
        self.position.push(at);
        self.parent.push(parent);
        self.scaffold.push(axis);
        self.heading.push(heading);
        self.is_open.push(is_open);
        self.position.len() as u32 - 1
    }

    /// What the rule may read of this tree.
    fn of_tree(&self) -> [(&'static str, f64); OF_TREE.len()] {
        let (size, envelope) = (&self.species.size, self.envelope);
        let age_years = size.age_at(envelope.height_m);
        let values = [envelope.height_m, 2.0 * envelope.radius_m, age_years];
        let mut named = OF_TREE.map(|name| (name, 0.0));
        for ((_, slot), value) in named.iter_mut().zip(values) {
            *slot = f64::from(value);
        }
        named
    }

    /// Habit of branches of an order, 1 the first.
    fn habit(&self, order: u8) -> Habit {
        let index = usize::from(order.max(1)) - 1;
        let list = &self.growth.order;
        list.get(index).or(list.last()).cloned().unwrap_or(Habit {
            angle_deg: None,
            irregular: 0.2,
            curve_deg: [0.0; 2],
            tip_deg: [0.0; 2],
            length: 1.0,
            flat: 0.0,
            keep: 1.0,
        })
    }

    fn add_stem_and_branches(&mut self) -> Result<()> {
        let fineness = (self.max_nodes as f32 / FULL_NODES).cbrt().min(1.5);
        let tallness =
            (self.envelope.crown_length_m() / self.grown_crown_m.max(0.1)).powf(0.4).min(1.6);
        let young = youth(self.envelope.height_m);
        let fewest = 3 + ((YOUNG_INTERNODES - 3.0) * young).round() as u32;
        let internodes = match self.growth.internodes {
            0 | 1 => 1,
            n => ((n as f32 * fineness * tallness).round() as u32).max(fewest.min(n.max(3))),
        };
        let of_tree = self.of_tree();
        let seed = self.seed.derive("rule", 0);
        let shoots = scaffold(&self.species.rule, internodes, &of_tree, seed)?;
        if shoots.is_empty() {
            return Err(Error::new("the rule draws no shoot").remedy(
                "let the axiom or a production draw, for example `F(a)`, with a length above 0",
            ));
        }
        let mut drawn: Vec<Drawn> = vec![Drawn::default(); shoots.len()];
        let mut whorl = vec![0u32; shoots.len()];
        // Which shoot carries each on: the next of its axis, else the oldest lateral in line.
        let mut onward: Vec<Option<usize>> = vec![None; shoots.len()];
        for (id, shoot) in shoots.iter().enumerate() {
            let Some(parent) = shoot.parent else { continue };
            let on = &mut onward[parent as usize];
            if shoot.goes_on || shoot.is_in_line() && on.is_none_or(|k| !shoots[k].goes_on) {
                *on = Some(id);
            }
        }
        // A stem that ends among its limbs leans over into the last of them.
        let mut leans = vec![false; shoots.len()];
        if self.growth.stem < STEM_TO_TOP {
            let newest = shoots.iter().enumerate().filter(|(_, s)| s.depth == 1 && s.rank == 0);
            for (id, shoot) in newest {
                let ends = shoot.parent.is_some_and(|p| onward[p as usize].is_none());
                leans[id] = ends;
            }
        }
        self.draw_stems(&shoots, &mut drawn, &mut whorl);
        let budget = (SCAFFOLD_SHARE * self.max_nodes as f32) as usize;
        let deepest = shoots.iter().map(|s| s.depth).max().unwrap_or(0);
        // The other shoot on which one in line would lie.
        let lies_on = |id: usize, shoot: &Shoot| {
            onward[shoot.parent? as usize].filter(|&on| on != id && shoot.is_in_line())
        };
        // Order by order, so that what the budget leaves out is the finest.
        for depth in 1..=deepest {
            for (id, shoot) in shoots.iter().enumerate() {
                if shoot.depth != depth || self.position.len() >= budget {
                    continue;
                }
                let Some(parent) = shoot.parent.map(|p| p as usize) else { continue };
                let on = &drawn[parent];
                if on.nodes.len() >= 2
                    && lies_on(id, shoot).is_none()
                    && let Some(limb) = self.lateral(id as u32, shoot, on, whorl[parent], leans[id])
                {
                    drawn[id] = limb;
                }
            }
            // What springs from a lateral that would lie on another springs from that, to other sides.
            for (id, shoot) in shoots.iter().enumerate().filter(|(_, s)| s.depth == depth) {
                if let Some(on) = lies_on(id, shoot).filter(|&on| !shoots[on].goes_on) {
                    drawn[id] = drawn[on].clone();
                    whorl[id] = shoot.rank + 1;
                }
            }
        }
        Ok(())
    }

    /// Draws every stem: a chain of shoots of depth 0, each of which becomes some nodes.
    fn draw_stems(&mut self, shoots: &[Shoot], drawn: &mut [Drawn], whorl: &mut [u32]) {
        let feet: Vec<usize> = (0..shoots.len())
            .filter(|&i| shoots[i].depth == 0 && shoots[i].parent.is_none())
            .take((self.max_nodes / NODES_OF_STEM).clamp(1, MAX_STEMS as usize))
            .collect();
        for (number, &foot) in feet.iter().enumerate() {
            let mut chain = vec![foot];
            for (i, shoot) in shoots.iter().enumerate().skip(foot + 1) {
                if shoot.goes_on && shoot.parent == chain.last().map(|&c| c as u32) {
                    chain.push(i);
                }
            }
            let line = self.stem_line(number, feet.len());
            self.draw_stem(number, &line, &chain, drawn, whorl);
        }
    }

    /// The centre line of stem `number` of `count`.
    fn stem_line(&self, number: usize, count: usize) -> StemLine {
        let mut draws = self.seed.derive("stem", number as u64).draws();
        let e = self.envelope;
        let share = self.growth.stem.clamp(0.2, 1.0);
        let mut top_m = e.base_m + share * e.crown_length_m();
        let (mut spread, mut foot) = (Vec2::ZERO, Vec2::ZERO);
        if count > 1 {
            // Stems of a stool part around it; each a little shorter than the crown.
            let turn = (number as f32 + 0.35 * draws.between(-1.0, 1.0)) / count as f32;
            let side = Vec2::from_angle(std::f32::consts::TAU * turn);
            top_m = e.height_m * draws.between(0.78, 0.93);
            let t = if number == 0 { 0.15 } else { draws.between(0.35, 0.6) };
            spread = side * e.radius_m * t;
            if number == 0 {
                top_m = e.height_m;
            } else {
                let diameter_m = 2.0 * Pipes::of_species(self.species, e.height_m).stem_radius_m;
                foot = side * diameter_m * (ABREAST * count as f32).max(1.1);
            }
        }
        let amplitude = self.growth.wander.abs() * 0.0022 * e.height_m;
        let mut waves = [(Vec2::ZERO, 0.0, 0.0); 3];
        for (i, wave) in waves.iter_mut().enumerate() {
            let size = amplitude / (i + 1) as f32;
            *wave = (
                Vec2::from_angle(draws.between(0.0, std::f32::consts::TAU)) * size,
                (i + 1) as f32 * draws.between(0.8, 1.3),
                draws.unit(),
            );
        }
        StemLine { top_m, foot, spread, waves, is_straight_topped: share > STEM_TO_TOP }
    }

    fn draw_stem(
        &mut self,
        number: usize,
        line: &StemLine,
        chain: &[usize],
        drawn: &mut [Drawn],
        whorl: &mut [u32],
    ) {
        let e = self.envelope;
        // The bole takes a few nodes, the flare of its foot among them.
        let base_m = e.base_m.min(0.8 * line.top_m);
        let gap_m = (2.0 * self.spacing_m).max(base_m / 12.0);
        let bole = (base_m / gap_m).ceil().max(2.0) as usize;
        let mut last = 0;
        if base_m > 0.02 * e.height_m {
            // Below it those of a stool, which lean, are upright.
            let foot = if line.foot == Vec2::ZERO { 0.02 } else { 0.004 };
            let foot_m = (foot * e.height_m).min(0.5 * base_m / bole as f32);
            last = self.stem_node(line, number, foot_m, last);
            for i in 1..=bole {
                last = self.stem_node(line, number, base_m * i as f32 / bole as f32, last);
            }
        }
        // Internodes shorten towards the top, as shoots of an ageing crown do not but its young
        // top's whorls seem to.
        let n = chain.len();
        for (i, &shoot) in chain.iter().enumerate() {
            let place = |k: usize| {
                let t = k as f32 / n as f32;
                base_m + (line.top_m - base_m) * (1.25 * t - 0.25 * t * t)
            };
            let (from_m, to_m) = (place(i), place(i + 1));
            let pieces = ((to_m - from_m) / (1.2 * self.spacing_m)).ceil().clamp(1.0, 8.0) as usize;
            let mut nodes = vec![last];
            for k in 1..=pieces {
                let z = from_m + (to_m - from_m) * k as f32 / pieces as f32;
                last = self.stem_node(line, number, z, last);
                nodes.push(last);
            }
            drawn[shoot] = Drawn { nodes, length_m: to_m - from_m };
            whorl[shoot] = i as u32;
        }
        if let Some(open) = self.is_open.last_mut() {
            *open = true;
        }
    }

    fn stem_node(&mut self, line: &StemLine, number: usize, z: f32, last: u32) -> u32 {
        let at = line.at(z, self.envelope);
        let below = self.position[last as usize];
        let heading = (at - below).normalize_or(Vec3::Z);
        self.push(at, last, number as u32, heading, false)
    }

    /// Draws a lateral on its parent, if it lives and has room.
    fn lateral(
        &mut self,
        id: u32,
        shoot: &Shoot,
        on: &Drawn,
        internode: u32,
        leans: bool,
    ) -> Option<Drawn> {
        let habit = self.habit(shoot.depth);
        let mut draws = self.seed.derive("branch", u64::from(id)).draws();
        let lives = draws.unit() < habit.keep;
        let is_leader = shoot.is_in_line() || leans;
        if !lives && !is_leader {
            return None;
        }
        // Place on the parent: sets of laterals from the tip down, the newest first.
        let group = self.growth.whorl.max(1);
        let sets = shoot.siblings.div_ceil(group).max(1);
        let set = shoot.rank / group;
        let jitter = habit.irregular * draws.between(-0.5, 0.5);
        let back = ((set as f32 + jitter) / sets as f32).clamp(0.0, 0.97);
        let bare = if shoot.depth == 1 { 0.0 } else { 0.12 };
        let spread = self.growth.spread.clamp(0.0, 1.0);
        let along = if is_leader { 1.0 } else { 1.0 - spread * back * (1.0 - bare) };
        let (base, ahead) = self.place_on(on, along);
        let origin = self.position[base as usize];

        // Where along the crown, or along the parent, decides the habit.
        let top = if shoot.depth == 1 {
            self.envelope.relative_height(origin.z).clamp(0.0, 1.0)
        } else {
            along
        };
        // All branches of a young tree are such as are at the top of an old one.
        let place = top + (1.0 - top) * 0.7 * youth(self.envelope.height_m);
        let mix = |pair: [f32; 2]| pair[0] + (pair[1] - pair[0]) * place;
        let spin = self.growth.roll_deg.to_radians() * (internode * sets + (sets - 1 - set)) as f32;
        let azimuth = shoot.azimuth_rad + spin + habit.irregular * draws.between(-0.9, 0.9);
        let tilt = match habit.angle_deg {
            _ if shoot.is_in_line() => 0.0,
            Some(pair) => mix(pair).to_radians(),
            None => shoot.tilt_rad,
        };
        let tilt = if leans { LEANS * tilt } else { tilt };
        let tilt = tilt * (1.0 + 0.5 * habit.irregular * draws.between(-1.0, 1.0));
        let direction = leaned(ahead, azimuth, tilt, habit.flat);

        // L = L_apex − (α / L_apex)·r, with α a fraction of L_apex² over the axis' length.
        let (apex_m, from_apex) = if shoot.depth == 1 {
            (habit.length * self.envelope.radius_m, 1.0 - top)
        } else {
            (habit.length * 2.0 * shoot.ratio * on.length_m, 1.0 - along)
        };
        let index = usize::from(shoot.depth) - 1;
        let decay = self.growth.decay.get(index).or(self.growth.decay.last()).copied();
        let tip = origin + direction * apex_m;
        let decay = decay.unwrap_or(0.0) * self.decay_factor(origin, tip);
        let length_m = apex_m * (1.0 - decay * from_apex);
        // The newest sets are weaker than the oldest.
        let vigour = 1.0
            - 0.35 * habit.irregular * draws.unit()
            - if shoot.depth == 1 && sets > 1 { 0.25 * (1.0 - back) } else { 0.0 };
        let length_m = length_m * vigour;
        if length_m.is_nan() || length_m <= 0.4 * self.spacing_m {
            return None;
        }
        let limb = Limb {
            base: origin,
            direction,
            length_m,
            curve_deg: mix(habit.curve_deg) * (1.0 + habit.irregular * draws.between(-0.5, 0.5)),
            tip_deg: mix(habit.tip_deg) * (1.0 + habit.irregular * draws.between(-0.5, 0.5)),
            tropism: self.growth.tropism,
            wander: self.growth.wander * 4.0,
            reach: 1.0 - 0.3 * habit.irregular * draws.unit(),
            clearance_m: self.clearance_m,
            segment_m: 1.1 * self.spacing_m,
        };
        let mut path = limb.trace(self.envelope, &mut draws);
        self.cut(origin, &mut path);
        let axis = if is_leader { self.scaffold[base as usize] } else { id + MAX_STEMS };
        self.draw_branch(base, &path, axis, shoot.depth)
    }

    /// What the region of the crown makes of the decay, for a branch from `base` to about `tip`.
    fn decay_factor(&self, base: Vec3, tip: Vec3) -> f32 {
        let by = &self.growth.decay_by;
        let height = curve(&by.height, self.envelope.relative_height(base.z).clamp(0.0, 1.0));
        let bearing = (tip.x - base.x).atan2(tip.y - base.y).to_degrees().rem_euclid(360.0);
        let azimuth = round_curve(&by.azimuth_deg, bearing);
        let light = match is_level(&by.light) {
            true => curve(&by.light, 1.0),
            false => curve(&by.light, light_at(tip, self.envelope)),
        };
        height * azimuth * light
    }

    /// Ends a branch from `base` where it would enter something.
    fn cut(&self, base: Vec3, path: &mut Vec<Vec3>) {
        if self.around.is_none() {
            return;
        }
        let mut from = base;
        let met = path.iter().position(|&to| {
            let is_met = self.around.meets(from, to).is_some();
            from = to;
            is_met
        });
        path.truncate(met.unwrap_or(path.len()));
    }

    fn draw_branch(&mut self, base: u32, path: &[Vec3], axis: u32, depth: u8) -> Option<Drawn> {
        let mut nodes = vec![base];
        let mut length_m = 0.0;
        let mut last = base;
        for (i, &at) in path.iter().enumerate() {
            if self.position.len() >= self.max_nodes {
                break;
            }
            let before = self.position[last as usize];
            let heading = (at - before).normalize_or_zero();
            if heading == Vec3::ZERO {
                continue;
            }
            length_m += at.distance(before);
            let relative = self.envelope.relative_radius(at);
            let is_outer = relative > self.growth.bare;
            let is_open = is_outer || i + 1 == path.len() || depth > 1;
            last = self.push(at, last, axis, heading, is_open);
            nodes.push(last);
        }
        (nodes.len() >= 2).then_some(Drawn { nodes, length_m })
    }

    /// The node nearest to a share of a branch's length, and the branch's direction there.
    fn place_on(&self, on: &Drawn, along: f32) -> (u32, Vec3) {
        let wished = along * on.length_m;
        let mut done = 0.0;
        let mut best = (f32::INFINITY, on.nodes[on.nodes.len() - 1]);
        for pair in on.nodes.windows(2) {
            done += self.position[pair[0] as usize].distance(self.position[pair[1] as usize]);
            let miss = (done - wished).abs();
            if miss < best.0 {
                best = (miss, pair[1]);
            }
        }
        (best.1, self.heading[best.1 as usize])
    }

    /// Colonizes the crown's own points and the samples between them.
    fn colonize(&mut self, seen: &[Vec3]) {
        let room = self.max_nodes.saturating_sub(self.position.len());
        if room == 0 {
            return;
        }
        let mut attractors = thinned(seen, self.spacing_m, self.envelope, self.clearance_m);
        self.fill(&mut attractors);
        let s = self.spacing_m;
        let (reach, _) =
            Reach::new(self.growth.step * s, self.growth.kill * s, self.growth.influence * s);
        let answer = Answer {
            inertia: self.growth.inertia.clamp(0.0, 10.0),
            max_turn_rad: 1.2,
            max_bend_rad: 0.9,
        };
        // Away from the axis, as light comes from outside, and up or down with the tropism.
        let e = self.envelope;
        let up = Vec3::Z * (0.05 * self.growth.tropism).clamp(-0.6, 0.6);
        let outward = self.growth.outward.clamp(0.0, 10.0);
        let pull = |p: Vec3| {
            let out = p.truncate() - e.centre(p.z);
            up + (out / (out.length() + 0.2 * e.radius_m)).extend(0.0) * outward
        };
        let limits = Limits { max_nodes: room, max_rounds: 400, bridges: 1 };
        let starts: Vec<Start> = (0..self.position.len())
            .map(|i| Start {
                position: self.position[i],
                heading: self.heading[i],
                is_open: self.is_open[i],
            })
            .collect();
        let grown = colonize(&starts, &attractors, &reach, &answer, pull, self.around, &limits);
        for (at, parent) in grown.position.into_iter().zip(grown.parent) {
            let at = at.with_z(at.z.max(self.clearance_m));
            let heading = (at - self.position[parent as usize]).normalize_or_zero();
            if heading != Vec3::ZERO {
                self.push(at, parent, polish::FREE, heading, true);
            } else {
                // Keeps ids in step with those of the colonization.
                let up = self.position[parent as usize] + Vec3::Z * 0.01 * s;
                self.push(up, parent, polish::FREE, Vec3::Z, true);
            }
        }
    }

    /// Adds samples of the envelope's twig-bearing part, one a cell of the spacing at most, where
    /// no attractor is near.
    fn fill(&self, attractors: &mut Vec<Vec3>) {
        let (e, s) = (self.envelope, self.spacing_m);
        let share = self.growth.fill.clamp(0.0, 1.0);
        let reach = 1.3 * e.radius_m.max(e.widest_at(e.base_m)) + e.apex.length();
        let count = |length: f32| ((length / s).ceil() as i32).clamp(1, 400);
        let (across, up) = (count(2.0 * reach), count(e.crown_length_m()));
        let taken: BTreeSet<[i32; 3]> = attractors.iter().map(|p| cell_of(*p, s)).collect();
        // Where the decay differs over the crown, twigs keep to the branches it left.
        let near: Option<BTreeSet<[i32; 3]>> = (!self.growth.decay_by.is_even())
            .then(|| self.position.iter().map(|p| cell_of(*p, 2.0 * s)).collect());
        let has_branch = |p| near.as_ref().is_none_or(|n| n.contains(&cell_of(p, 2.0 * s)));
        for k in 0..up {
            for j in 0..across {
                for i in 0..across {
                    let key = (k as u64) << 40 | (j as u64) << 20 | i as u64;
                    let mut draws = self.seed.derive("fill", key).draws();
                    if draws.unit() >= share {
                        continue;
                    }
                    let p = Vec3::new(
                        (i as f32 + draws.unit()) * s - reach,
                        (j as f32 + draws.unit()) * s - reach,
                        e.base_m + (k as f32 + draws.unit()) * s,
                    );
                    let out = e.relative_radius(p);
                    let is_twiggy =
                        out <= 0.97 && (out >= self.growth.bare || p.z > 0.9 * e.height_m);
                    let is_free = p.z > self.clearance_m && !taken.contains(&cell_of(p, s));
                    if is_twiggy && is_free && has_branch(p) {
                        attractors.push(p);
                    }
                }
            }
        }
    }

    fn finish(mut self) -> Skeleton {
        let e = self.envelope;
        let (axis, order) = polish::axes(&self.position, &self.parent, &self.scaffold);
        polish::smooth(&mut self.position, &self.parent, &axis, &self.scaffold, 2);
        let from = if self.growth.stem < STEM_TO_TOP { 3 } else { 2 };
        let hang = self.growth.hang * (1.0 - youth(e.height_m));
        let placed = (axis.as_slice(), order.as_slice());
        polish::hang(&mut self.position, &self.parent, placed, from, hang, self.clearance_m);
        let n = self.position.len();
        let whole = Skeleton {
            position: self.position,
            parent: self.parent,
            radius_m: vec![0.0; n],
            axis,
            order,
            birth: vec![0; n],
            dead: Vec::new(),
        };
        // What hangs far below the crown is dropped: twigs soon, limbs that droop later.
        let floor_m = e.base_m - 0.05 * e.crown_length_m();
        let limbs_m = LOWEST_LIMB * e.base_m;
        let is_stem = whole.is_stem();
        let lowest_m = |i: usize| match self.scaffold[i] {
            polish::FREE => floor_m,
            _ if is_stem[i] => f32::NEG_INFINITY,
            _ => limbs_m.min(floor_m),
        };
        let keep: Vec<bool> = (0..n).map(|i| whole.position[i].z >= lowest_m(i)).collect();
        let mut tree = whole.subset(&keep);
        fit(&mut tree, e, self.around.is_none());
        if !self.around.is_none() {
            // Smoothing and hanging may have moved a shoot over a border.
            let is_stem = tree.is_stem();
            let is_free = |i: usize| is_stem[i] || self.around.is_free(tree.position[i]);
            let keep: Vec<bool> = (0..tree.len()).map(is_free).collect();
            tree = tree.subset(&keep);
        }
        if self.max_nodes >= BENT_NODES {
            tree = bend::bent(&tree, |at| self.around.is_none() || self.around.is_free(at));
        }
        tree.birth = births(&tree, &self.species.size);
        let pipes = Pipes::of_species(self.species, e.height_m);
        tree.radius_m = radii(&tree.position, &tree.parent, &tree.is_stem(), &pipes);
        tree
    }
}

/// Scales heights and widths so that the tree is as tall and as wide as the envelope; one that is
/// hemmed in is not widened.
fn fit(tree: &mut Skeleton, e: &Envelope, is_alone: bool) {
    let up = e.height_m / tree.height_m().max(1e-6);
    for p in &mut tree.position {
        p.z *= up;
    }
    let out =
        (2.0 * e.radius_m / tree.width_m().max(1e-6)).clamp(0.8, if is_alone { 1.25 } else { 1.0 });
    for p in &mut tree.position {
        let centre = e.centre(p.z);
        let side = centre + (p.truncate() - centre) * out;
        *p = side.extend(p.z);
    }
}

/// The course of a stem.
struct StemLine {
    top_m: f32,
    /// Horizontal offset of its foot.
    foot: Vec2,
    /// Horizontal offset of its top from the envelope's centre line.
    spread: Vec2,
    /// Side and size, waves over the height, phase.
    waves: [(Vec2, f32, f32); 3],
    is_straight_topped: bool,
}

impl StemLine {
    fn at(&self, z: f32, envelope: &Envelope) -> Vec3 {
        let t = (z / self.top_m).clamp(0.0, 1.0);
        // Waves leave foot and, where it must meet the apex, top in place.
        let hold = if self.is_straight_topped { 4.0 * t * (1.0 - t) } else { t };
        let mut side = envelope.centre(z) + self.foot * (1.0 - t).powi(4);
        side += self.spread * (0.35 * t + 0.65 * t.powf(0.7));
        for &(size, count, phase) in &self.waves {
            side += size * hold * (std::f32::consts::TAU * (count * t + phase)).sin();
        }
        side.extend(z)
    }
}

/// `ahead` leaned by `tilt_rad` to the side `azimuth_rad` about it, counted as in [`sides`].
/// `flat` draws the azimuth of a lateral on a leaning parent to left or right.
fn leaned(ahead: Vec3, azimuth_rad: f32, tilt_rad: f32, flat: f32) -> Vec3 {
    let level = (1.0 - ahead.z * ahead.z).max(0.0).sqrt();
    let (across, other) = sides(ahead);
    let flat = (flat * level).clamp(0.0, 1.0);
    let (s, c) = azimuth_rad.sin_cos();
    let side = across * (c.signum() * flat + (1.0 - flat) * c) + other * (s * (1.0 - flat));
    let side = side.normalize_or(across);
    let axis = ahead.cross(side).normalize_or(other);
    (Quat::from_axis_angle(axis, tilt_rad) * ahead).normalize_or(ahead)
}

fn cell_of(p: Vec3, spacing_m: f32) -> [i32; 3] {
    let c = (p / spacing_m).floor();
    [c.x as i32, c.y as i32, c.z as i32]
}

/// One attractor a cell of the spacing, the mean of those in it, within the envelope's heights and
/// not far beyond its radius.
fn thinned(seen: &[Vec3], spacing_m: f32, e: &Envelope, clearance_m: f32) -> Vec<Vec3> {
    let mut cells: BTreeMap<[i32; 3], (Vec3, f32)> = Default::default();
    for &p in seen {
        let is_near = p.is_finite() && p.z > clearance_m && e.relative_radius(p) < 1.15;
        if is_near {
            let cell = cells.entry(cell_of(p, spacing_m)).or_insert((Vec3::ZERO, 0.0));
            cell.0 += p;
            cell.1 += 1.0;
        }
    }
    cells.into_values().map(|(sum, n)| sum / n).collect()
}

#[cfg(test)]
mod tests;
