//! Space colonization (Runions, Lane & Prusinkiewicz 2007; method "Space colonization").
//!
//! Every attractor belongs to its nearest node within the influence distance d_i. A node with
//! attractors grows a child a step D along the mean direction to them; attractors within the kill
//! distance d_k of a node are removed. Only new nodes look for attractors, through a `grid`, and
//! a node reads no attractors but those it won when it was new, so the cost is close to linear in
//! the number of attractors. Trees grown together compete: an attractor feeds one of them.
//!
//! What the method leaves open is settled so:
//! - *n ≈ 0* (symmetric attractors): the node grows towards its nearest attractor.
//! - *Oscillation* (an attractor between two steps that neither reaches): a step is no longer than
//!   the way to the nearest of the node's attractors, and a node does not grow twice in the same
//!   direction.
//! - *Duplicates*: a child that would fall into the same cell, D/20 wide, as an earlier node is not
//!   grown, nor one after a step below D/100.
//! - In both cases the node tries the way to its nearest attractor; if that is no better it is
//!   closed: it grows no more, though its attractors may pass to nearer nodes.
//! - *Out of reach*: when growth ends with attractors left, d_i is doubled, `bridges` times. What
//!   is still out of reach is left alone and counted.
//! - *Obstacles*: attractors where no wood may be are left out first, and counted. A step that
//!   would enter an obstacle follows its surface; where that is shut too, it is not taken.
//! - *Order of D, d_i, d_k*: [`Reach::new`] brings them to D/2 ≤ d_k < d_i, D ≤ d_i and says so.
//!
//! Additions: a node keeps part of its heading (`inertia`) and turns at most `max_turn_rad` a
//! step and `max_bend_rad` in all, which wood does and a mean of directions does not; `pull` is the
//! tropism vector of Runions' ĝ, here a field, so that twigs can be led away from the stem.
//!
//! Limit: a node has at most [`MAX_CHILDREN`] colonized children.

use std::collections::HashSet;
use std::hash::{BuildHasherDefault, Hasher};

use glam::Vec3;

use super::surroundings::Space;
use grid::{Grid, NOBODY, cell};

mod grid;

/// Children that one node may grow.
pub const MAX_CHILDREN: u8 = 3;
/// Children of one node point at least this far apart (cosine).
const SAME_DIRECTION: f32 = 0.99;

/// D, d_k and d_i in metres, positive and in order.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reach {
    step_m: f32,
    kill_m: f32,
    influence_m: f32,
}

impl Reach {
    /// Takes D, d_k and d_i as wished and gives them in order, with a sentence for each change.
    pub fn new(step_m: f32, kill_m: f32, influence_m: f32) -> (Reach, Vec<String>) {
        let mut said = Vec::new();
        let sound = |v: f32| v.is_finite() && v > 0.0;
        let mut settle = |name: &str, value: f32, is_right: bool, instead: f32, why: &str| {
            if is_right {
                return value;
            }
            said.push(format!("{name} of {value} m {why}; {instead} m taken"));
            instead
        };
        let step = settle("step D", step_m, sound(step_m), 0.1, "is no length").clamp(1e-4, 1e4);
        let kill = settle("kill distance d_k", kill_m, sound(kill_m), step, "is no length");
        let kill = settle(
            "kill distance d_k",
            kill,
            kill >= 0.5 * step,
            0.5 * step,
            "is below half a step, so a node could pass an attractor for ever",
        );
        let least = (1.25 * kill).max(step);
        let influence = settle(
            "influence distance d_i",
            influence_m,
            sound(influence_m) && influence_m >= least,
            least,
            "does not reach beyond the kill distance and a step",
        );
        (Reach { step_m: step, kill_m: kill, influence_m: influence }, said)
    }

    pub fn step_m(&self) -> f32 {
        self.step_m
    }

    pub fn kill_m(&self) -> f32 {
        self.kill_m
    }

    pub fn influence_m(&self) -> f32 {
        self.influence_m
    }
}

/// How a node answers its attractors.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Habit {
    /// Weight of the node's heading against the unit mean direction to its attractors.
    pub inertia: f32,
    /// Greatest turn from the heading in one step.
    pub max_turn_rad: f32,
    /// Greatest turn of a twig from the direction in which it left the node it sprang from.
    pub max_bend_rad: f32,
}

impl Default for Habit {
    /// Runions' own: straight to the mean.
    fn default() -> Self {
        Habit {
            inertia: 0.0,
            max_turn_rad: std::f32::consts::PI,
            max_bend_rad: std::f32::consts::PI,
        }
    }
}

/// Bounds on work and size.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limits {
    /// New nodes at most.
    pub max_nodes: usize,
    /// Rounds at most, over all bridges.
    pub max_rounds: usize,
    /// How often d_i is doubled for attractors out of reach.
    pub bridges: u8,
}

/// A node that may grow: place, unit heading (zero: none), and whether it is wood that grows at
/// all. Closed nodes still remove attractors near them and own those nearest to them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Start {
    pub position: Vec3,
    pub heading: Vec3,
    pub is_open: bool,
}

/// New nodes; ids go on from those of the starts, and parents come first.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Colonized {
    pub position: Vec<Vec3>,
    pub parent: Vec<u32>,
    /// Attractors no node came near.
    pub left: usize,
    /// Attractors where no wood may be; not among those left.
    pub blocked: usize,
    pub rounds: usize,
}

/// Grows from `starts` into `attractors`, never out of what is free in `space`; `pull` is added to
/// the direction of growth at a place. Attractors and starts that are not finite are left out.
pub fn colonize<S: Space>(
    starts: &[Start],
    attractors: &[Vec3],
    reach: &Reach,
    habit: &Habit,
    pull: impl Fn(Vec3) -> Vec3,
    space: &S,
    limits: &Limits,
) -> Colonized {
    let sound: Vec<Vec3> = attractors.iter().copied().filter(|p| p.is_finite()).collect();
    let mut living: Vec<Vec3> = sound.iter().copied().filter(|&p| space.is_free(p)).collect();
    let blocked = sound.len() - living.len();
    let mut front = Front::new(starts, living.len(), reach, habit, pull, space, limits);
    let mut influence_m = reach.influence_m;
    for _ in 0..=limits.bridges {
        let Some(mut grid) = Grid::new(&living, influence_m) else { break };
        front.grow(&mut grid);
        living = grid.living();
        influence_m *= 2.0;
    }
    let first = starts.len();
    Colonized {
        position: front.node.drain(first..).collect(),
        parent: front.parent.drain(first..).collect(),
        left: living.len(),
        blocked,
        rounds: front.rounds,
    }
}

/// Growth of one node so far.
#[derive(Clone, Copy)]
struct Shoot {
    heading: Vec3,
    /// Direction in which the node's twig left the node it sprang from; zero for starts.
    left_at: Vec3,
    /// Directions of the first children, to tell a repeated one.
    grown: [Vec3; MAX_CHILDREN as usize],
    /// Children grown so far; at [`MAX_CHILDREN`] the node is closed.
    children: u8,
}

impl Shoot {
    fn new(heading: Vec3, left_at: Vec3, is_open: bool) -> Shoot {
        let children = if is_open { 0 } else { MAX_CHILDREN };
        Shoot { heading, left_at, grown: [Vec3::ZERO; MAX_CHILDREN as usize], children }
    }
}

/// What a node gathered in one round.
struct Call {
    sum: Vec3,
    nearest: Vec3,
    nearest_sq: f32,
}

/// A node that may grow, and how many attractors it won when it was new.
#[derive(Clone, Copy)]
struct Caller {
    node: u32,
    count: u32,
}

/// Greatest angle between two directions.
struct Bound {
    sin: f32,
    cos: f32,
}

impl Bound {
    fn new(angle_rad: f32) -> Bound {
        let (sin, cos) = angle_rad.clamp(0.0, std::f32::consts::PI).sin_cos();
        Bound { sin, cos }
    }

    /// `wish`, or where it turns too far from `heading`, the direction that far towards it.
    fn keep(&self, heading: Vec3, wish: Vec3) -> Vec3 {
        let along = heading.dot(wish);
        if along >= self.cos || self.cos <= -1.0 || heading == Vec3::ZERO {
            return wish;
        }
        let side = (wish - heading * along).try_normalize();
        let side = side.unwrap_or_else(|| heading.any_orthonormal_vector());
        (heading * self.cos + side * self.sin).normalize_or(wish)
    }
}

struct Front<'a, P, S> {
    step_m: f32,
    kill_sq: f32,
    inertia: f32,
    turn: Bound,
    bend: Bound,
    pull: P,
    space: &'a S,
    limits: &'a Limits,
    first_new: usize,
    node: Vec<Vec3>,
    parent: Vec<u32>,
    shoot: Vec<Shoot>,
    /// Cells, D/20 wide, with a node in them.
    taken: HashSet<(i32, i32, i32), BuildHasherDefault<CellHasher>>,
    /// Nodes that may grow, in the order of their ids, and the attractors they won, in that order.
    callers: Vec<Caller>,
    won: Vec<u32>,
    rounds: usize,
}

/// A quick hash for a set of cells.
#[derive(Default)]
struct CellHasher(u64);

impl Hasher for CellHasher {
    fn finish(&self) -> u64 {
        // Both ends count: the low bits choose the place, the high ones the tag.
        self.0 ^ (self.0 >> 32)
    }

    fn write(&mut self, bytes: &[u8]) {
        for &b in bytes {
            self.write_i32(i32::from(b));
        }
    }

    fn write_i32(&mut self, value: i32) {
        self.0 =
            (self.0.rotate_left(21) ^ u64::from(value as u32)).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    }
}

impl<'a, P: Fn(Vec3) -> Vec3, S: Space> Front<'a, P, S> {
    fn new(
        starts: &[Start],
        attractors: usize,
        reach: &Reach,
        habit: &Habit,
        pull: P,
        space: &'a S,
        limits: &'a Limits,
    ) -> Self {
        let shoot = |s: &Start| {
            let is_sound = s.position.is_finite() && s.heading.is_finite();
            Shoot::new(s.heading.normalize_or_zero(), Vec3::ZERO, s.is_open && is_sound)
        };
        let mut front = Front {
            step_m: reach.step_m,
            kill_sq: reach.kill_m * reach.kill_m,
            inertia: habit.inertia,
            turn: Bound::new(habit.max_turn_rad),
            bend: Bound::new(habit.max_bend_rad),
            pull,
            space,
            limits,
            first_new: starts.len(),
            node: starts.iter().map(|s| s.position).collect(),
            parent: vec![NOBODY; starts.len()],
            shoot: starts.iter().map(shoot).collect(),
            taken: HashSet::default(),
            callers: Vec::new(),
            won: Vec::new(),
            rounds: 0,
        };
        // About as many nodes as attractors, where one is removed a step.
        let nodes = attractors.min(limits.max_nodes);
        front.node.reserve(nodes);
        front.parent.reserve(nodes);
        front.shoot.reserve(nodes);
        front.taken.reserve(starts.len() + nodes);
        for s in starts {
            front.take(s.position);
        }
        front
    }

    /// Claims the cell of a place; false where it is another node's.
    fn take(&mut self, p: Vec3) -> bool {
        let [x, y, z] = cell(p, 20.0 / self.step_m);
        self.taken.insert((x, y, z))
    }

    /// Rounds of growth in one grid, until nothing grows or a limit is met.
    fn grow(&mut self, grid: &mut Grid) {
        self.callers.clear();
        self.won.clear();
        self.visit_from(0, grid);
        while self.rounds < self.limits.max_rounds {
            self.rounds += 1;
            let before = self.node.len();
            self.round(grid);
            if self.node.len() == before {
                break;
            }
            self.visit_from(before, grid);
        }
    }

    /// Lets the nodes from `first` on win their attractors.
    fn visit_from(&mut self, first: usize, grid: &mut Grid) {
        for i in first..self.node.len() {
            if self.node[i].is_finite() {
                let before = self.won.len();
                grid.visit(i as u32, self.node[i], self.kill_sq, &mut self.won);
                let count = (self.won.len() - before) as u32;
                if self.shoot[i].children < MAX_CHILDREN {
                    self.callers.push(Caller { node: i as u32, count });
                } else {
                    self.won.truncate(before);
                }
            }
        }
    }

    /// Every caller that still has attractors grows. What later nodes took from it, it forgets.
    fn round(&mut self, grid: &Grid) {
        let (mut read, mut written) = (0, 0);
        let mut callers = 0;
        for c in 0..self.callers.len() {
            let Caller { node, count } = self.callers[c];
            let at = self.node[node as usize];
            let first = written;
            let mut call = Call { sum: Vec3::ZERO, nearest: at, nearest_sq: f32::INFINITY };
            for r in read..read + count as usize {
                let id = self.won[r];
                let attractor = grid.attractor[id as usize];
                if attractor.owner != node {
                    continue;
                }
                self.won[written] = id;
                written += 1;
                let way = attractor.at - at;
                let d_sq = way.length_squared();
                call.sum += way / d_sq.sqrt();
                if d_sq < call.nearest_sq {
                    call.nearest_sq = d_sq;
                    call.nearest = attractor.at;
                }
            }
            read += count as usize;
            if written == first {
                continue;
            }
            if self.node.len() - self.first_new < self.limits.max_nodes {
                self.sprout(node, &call);
            }
            if self.shoot[node as usize].children < MAX_CHILDREN {
                self.callers[callers] = Caller { node, count: (written - first) as u32 };
                callers += 1;
            } else {
                written = first;
            }
        }
        self.callers.truncate(callers);
        self.won.truncate(written);
    }

    /// Grows one child of `parent`, or closes `parent`.
    fn sprout(&mut self, parent: u32, call: &Call) {
        let p = parent as usize;
        let at = self.node[p];
        let shoot = self.shoot[p];
        let to_nearest = (call.nearest - at).normalize_or_zero();
        let mut direction = call.sum.normalize_or_zero();
        // n ≈ 0: attractors pull evenly.
        if call.sum.length_squared() < 1e-4 {
            direction = to_nearest;
        }
        let blended = direction + self.inertia * shoot.heading + (self.pull)(at);
        let direction = blended.try_normalize().unwrap_or(to_nearest);
        let step = self.step_m.min(call.nearest_sq.sqrt());
        // The mean first; where that leads nowhere new, the nearest attractor.
        let new = [direction, to_nearest].into_iter().find_map(|wish| {
            let direction = self.turn.keep(shoot.heading, wish);
            let direction = self.bend.keep(shoot.left_at, direction);
            let direction = along(self.space, at, direction, step)?;
            let child = at + direction * step;
            let earlier = &shoot.grown[..usize::from(shoot.children)];
            let repeats = earlier.iter().any(|d| d.dot(direction) > SAME_DIRECTION);
            let is_short = step < 0.01 * self.step_m || child == at || !child.is_finite();
            (!repeats && !is_short && self.take(child)).then_some((direction, child))
        });
        let Some((direction, child)) = new else {
            self.shoot[p].children = MAX_CHILDREN;
            return;
        };
        let goes_on = shoot.children == 0 && shoot.left_at != Vec3::ZERO;
        self.shoot[p].grown[usize::from(shoot.children)] = direction;
        self.shoot[p].children += 1;
        self.node.push(child);
        self.parent.push(parent);
        let left_at = if goes_on { shoot.left_at } else { direction };
        self.shoot.push(Shoot::new(direction, left_at, true));
    }
}

/// The direction of a free step: as wished, or along what is in the way, or in the corner of two
/// such things along both.
fn along<S: Space>(space: &S, at: Vec3, wish: Vec3, step: f32) -> Option<Vec3> {
    let meets = |way: Vec3| space.meets(at, at + way * step);
    let Some(first) = meets(wish) else { return Some(wish) };
    // A little off the surface, so that rounding does not lead into it.
    let slide = |normal: Vec3, way: Vec3| {
        let flat = (way - normal * way.dot(normal)).try_normalize()?;
        (flat + 0.02 * normal).try_normalize()
    };
    let way = slide(first, wish)?;
    let Some(second) = meets(way) else { return Some(way) };
    let edge = first.cross(second).try_normalize()?;
    let way = (edge * edge.dot(wish).signum() + 0.02 * (first + second)).try_normalize()?;
    meets(way).is_none().then_some(way)
}

#[cfg(test)]
mod tests;
