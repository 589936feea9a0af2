//! Space colonization (Runions, Lane & Prusinkiewicz 2007; method "Space colonization").
//!
//! Every attractor belongs to its nearest node within the influence distance d_i. A node with
//! attractors grows a child a step D along the mean direction to them; attractors within the kill
//! distance d_k of a node are removed. Only new nodes look for attractors, through a grid of
//! cells d_i wide, so the cost is close to linear in the number of attractors.
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
//! - *Order of D, d_i, d_k*: [`Reach::new`] brings them to D/2 ≤ d_k < d_i, D ≤ d_i and says so.
//!
//! Additions: a node keeps part of its heading (`inertia`) and turns at most `max_turn_rad` a
//! step and `max_bend_rad` in all, which wood does and a mean of directions does not; `pull` is the tropism vector of Runions' ĝ, here
//! a field, so that twigs can be led away from the stem.
//!
//! Limit: a node has at most [`MAX_CHILDREN`] colonized children.

use std::collections::HashSet;
use std::hash::{BuildHasherDefault, Hasher};

use glam::Vec3;

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
    pub rounds: usize,
}

/// Grows from `starts` into `attractors`; `pull` is added to the direction of growth at a place.
/// Attractors and starts that are not finite are left out.
pub fn colonize(
    starts: &[Start],
    attractors: &[Vec3],
    reach: &Reach,
    habit: &Habit,
    pull: &dyn Fn(Vec3) -> Vec3,
    limits: &Limits,
) -> Colonized {
    let mut front = Front::new(starts, attractors, reach, habit, pull, limits);
    let mut influence_m = reach.influence_m;
    for _ in 0..=limits.bridges {
        let Some(mut grid) = Grid::new(&front.living, influence_m) else { break };
        front.grow(&mut grid);
        front.living = grid.living();
        influence_m *= 2.0;
    }
    let first = starts.len();
    Colonized {
        position: front.node.split_off(first),
        parent: front.parent.split_off(first),
        left: front.living.len(),
        rounds: front.rounds,
    }
}

const NOBODY: u32 = u32::MAX;

/// Living attractors in cells, those of a cell side by side.
struct Grid {
    cell_m: f32,
    table: Table,
    /// First attractor of each bucket; one more at the end.
    start: Vec<u32>,
    /// Living attractors of each bucket, at its front.
    count: Vec<u32>,
    point: Vec<Vec3>,
    /// Nearest node of each, and how far it is.
    owner: Vec<u32>,
    distance_sq: Vec<f32>,
    /// Buckets in which some attractor has an owner that may still grow, and whether a bucket is
    /// among them.
    active: Vec<u32>,
    is_active: Vec<bool>,
}

impl Grid {
    fn new(points: &[Vec3], cell_m: f32) -> Option<Grid> {
        if points.is_empty() {
            return None;
        }
        let (table, buckets) = Table::new(points, cell_m);
        let mut count = vec![0u32; buckets];
        let bucket: Vec<u32> =
            points.iter().map(|&p| table.bucket(cell(p, cell_m)).unwrap_or(0)).collect();
        for &b in &bucket {
            count[b as usize] += 1;
        }
        let mut start = vec![0u32; buckets + 1];
        for b in 0..buckets {
            start[b + 1] = start[b] + count[b];
        }
        let mut next = start.clone();
        let mut point = vec![Vec3::ZERO; points.len()];
        for (p, &b) in points.iter().zip(&bucket) {
            point[next[b as usize] as usize] = *p;
            next[b as usize] += 1;
        }
        let n = points.len();
        Some(Grid {
            cell_m,
            table,
            start,
            count,
            point,
            owner: vec![NOBODY; n],
            distance_sq: vec![f32::INFINITY; n],
            active: Vec::new(),
            is_active: vec![false; buckets],
        })
    }

    /// Gives `node` the attractors it is nearest to and removes those within the kill distance.
    fn visit(&mut self, node: u32, at: Vec3, influence_sq: f32, kill_sq: f32) {
        let centre = cell(at, self.cell_m);
        // Two of the cells may share a bucket; seeing its attractors twice changes nothing.
        for dz in -1..=1 {
            for dy in -1..=1 {
                for dx in -1..=1 {
                    let key = [centre[0] + dx, centre[1] + dy, centre[2] + dz];
                    let Some(bucket) = self.table.bucket(key) else { continue };
                    let bucket = bucket as usize;
                    if self.count[bucket] == 0 {
                        continue;
                    }
                    let first = self.start[bucket] as usize;
                    let mut end = first + self.count[bucket] as usize;
                    let mut i = first;
                    while i < end {
                        let d = self.point[i].distance_squared(at);
                        if d <= kill_sq {
                            end -= 1;
                            self.point.swap(i, end);
                            self.owner.swap(i, end);
                            self.distance_sq.swap(i, end);
                            continue;
                        }
                        if d < influence_sq && d < self.distance_sq[i] {
                            self.distance_sq[i] = d;
                            self.owner[i] = node;
                            if !self.is_active[bucket] {
                                self.is_active[bucket] = true;
                                self.active.push(bucket as u32);
                            }
                        }
                        i += 1;
                    }
                    self.count[bucket] = (end - first) as u32;
                }
            }
        }
    }

    fn living(&self) -> Vec<Vec3> {
        let mut out = Vec::new();
        for b in 0..self.count.len() {
            let first = self.start[b] as usize;
            out.extend_from_slice(&self.point[first..first + self.count[b] as usize]);
        }
        out
    }
}

/// Where the attractors of a cell are.
enum Table {
    /// All cells of a box, row after row: for clouds that fill a good part of their box.
    Box { low: [i32; 3], size: [i32; 3] },
    /// Cells by hash, for those that do not.
    Hash { mask: u32 },
}

impl Table {
    /// The table and its number of buckets.
    fn new(points: &[Vec3], cell_m: f32) -> (Table, usize) {
        let (mut low, mut high) = ([i32::MAX; 3], [i32::MIN; 3]);
        for &p in points {
            let c = cell(p, cell_m);
            for k in 0..3 {
                low[k] = low[k].min(c[k]);
                high[k] = high[k].max(c[k]);
            }
        }
        let extent = |k: usize| i64::from(high[k]) - i64::from(low[k]) + 1;
        let most = 2 * points.len() as i64 + 1024;
        let is_compact = (0..3).all(|k| extent(k) <= most)
            && (extent(0) * extent(1)).saturating_mul(extent(2)) <= most;
        if is_compact {
            let size = [extent(0) as i32, extent(1) as i32, extent(2) as i32];
            let cells = size.iter().map(|&s| s as usize).product();
            return (Table::Box { low, size }, cells);
        }
        let buckets = points.len().next_power_of_two().min(1 << 26);
        (Table::Hash { mask: buckets as u32 - 1 }, buckets)
    }

    /// `None` outside the box.
    fn bucket(&self, c: [i32; 3]) -> Option<u32> {
        match *self {
            Table::Hash { mask } => Some(hash(c) & mask),
            Table::Box { low, size } => {
                // What wraps is far outside, and stays so.
                let at: [i32; 3] = std::array::from_fn(|k| c[k].wrapping_sub(low[k]));
                let is_in = (0..3).all(|k| at[k] >= 0 && at[k] < size[k]);
                is_in.then(|| ((at[2] * size[1] + at[1]) * size[0] + at[0]) as u32)
            }
        }
    }
}

fn cell(p: Vec3, cell_m: f32) -> [i32; 3] {
    // Saturating casts; the clamp keeps the neighbours' indices in range.
    let index = |v: f32| ((v / cell_m).floor() as i32).clamp(-(1 << 30), 1 << 30);
    [index(p.x), index(p.y), index(p.z)]
}

/// Teschner et al. 2003, then mixed so that low bits depend on all.
fn hash(c: [i32; 3]) -> u32 {
    let h = (c[0] as u32).wrapping_mul(73_856_093)
        ^ (c[1] as u32).wrapping_mul(19_349_663)
        ^ (c[2] as u32).wrapping_mul(83_492_791);
    let h = (h ^ (h >> 15)).wrapping_mul(0x2c1b_3c6d);
    h ^ (h >> 13)
}

/// What a node gathered in one round.
#[derive(Clone, Copy)]
struct Call {
    round: u32,
    sum: Vec3,
    nearest: Vec3,
    nearest_sq: f32,
}

struct Front<'a> {
    reach: &'a Reach,
    habit: &'a Habit,
    pull: &'a dyn Fn(Vec3) -> Vec3,
    limits: &'a Limits,
    first_new: usize,
    node: Vec<Vec3>,
    parent: Vec<u32>,
    heading: Vec<Vec3>,
    /// Direction in which the node's twig left the node it sprang from; zero for starts.
    left_at: Vec<Vec3>,
    /// Children grown so far; at [`MAX_CHILDREN`] the node is closed.
    children: Vec<u8>,
    /// Directions of the first children, to tell a repeated one.
    grown: Vec<[Vec3; MAX_CHILDREN as usize]>,
    /// Cells, D/20 wide, with a node in them.
    taken: HashSet<[i32; 3], BuildHasherDefault<CellHasher>>,
    living: Vec<Vec3>,
    rounds: usize,
}

/// The grid's own hash, for a set of cells.
#[derive(Default)]
struct CellHasher(u64);

impl Hasher for CellHasher {
    fn finish(&self) -> u64 {
        self.0
    }

    fn write(&mut self, bytes: &[u8]) {
        for &b in bytes {
            self.write_i32(i32::from(b));
        }
    }

    fn write_usize(&mut self, _: usize) {}

    fn write_i32(&mut self, value: i32) {
        self.0 = (self.0 ^ u64::from(value as u32)).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        self.0 ^= self.0 >> 29;
    }
}

impl<'a> Front<'a> {
    fn new(
        starts: &[Start],
        attractors: &[Vec3],
        reach: &'a Reach,
        habit: &'a Habit,
        pull: &'a dyn Fn(Vec3) -> Vec3,
        limits: &'a Limits,
    ) -> Self {
        let sound = |s: &Start| s.position.is_finite() && s.heading.is_finite();
        Front {
            reach,
            habit,
            pull,
            limits,
            first_new: starts.len(),
            node: starts.iter().map(|s| s.position).collect(),
            parent: vec![NOBODY; starts.len()],
            heading: starts.iter().map(|s| s.heading.normalize_or_zero()).collect(),
            left_at: vec![Vec3::ZERO; starts.len()],
            children: starts
                .iter()
                .map(|s| if s.is_open && sound(s) { 0 } else { MAX_CHILDREN })
                .collect(),
            grown: vec![[Vec3::ZERO; MAX_CHILDREN as usize]; starts.len()],
            taken: starts.iter().map(|s| cell(s.position, 0.05 * reach.step_m)).collect(),
            living: attractors.iter().copied().filter(|p| p.is_finite()).collect(),
            rounds: 0,
        }
    }

    /// Rounds of growth in one grid, until nothing grows or a limit is met.
    fn grow(&mut self, grid: &mut Grid) {
        let influence_sq = grid.cell_m * grid.cell_m;
        let kill_sq = self.reach.kill_m * self.reach.kill_m;
        for i in 0..self.node.len() {
            if self.node[i].is_finite() {
                grid.visit(i as u32, self.node[i], influence_sq, kill_sq);
            }
        }
        let idle = Call { round: 0, sum: Vec3::ZERO, nearest: Vec3::ZERO, nearest_sq: 0.0 };
        let mut calls = vec![idle; self.node.len()];
        let mut called: Vec<u32> = Vec::new();
        let mut round = 0u32;
        while self.rounds < self.limits.max_rounds {
            self.rounds += 1;
            round += 1;
            called.clear();
            let mut active = std::mem::take(&mut grid.active);
            active.retain(|&b| {
                let first = grid.start[b as usize] as usize;
                let end = first + grid.count[b as usize] as usize;
                let mut is_active = false;
                for i in first..end {
                    let owner = grid.owner[i];
                    if owner == NOBODY || self.children[owner as usize] >= MAX_CHILDREN {
                        continue;
                    }
                    is_active = true;
                    let call = &mut calls[owner as usize];
                    if call.round != round {
                        *call = Call { round, nearest_sq: f32::INFINITY, ..idle };
                        called.push(owner);
                    }
                    let d_sq = grid.distance_sq[i];
                    call.sum += (grid.point[i] - self.node[owner as usize]) / d_sq.sqrt();
                    if d_sq < call.nearest_sq {
                        call.nearest_sq = d_sq;
                        call.nearest = grid.point[i];
                    }
                }
                grid.is_active[b as usize] = is_active;
                is_active
            });
            grid.active = active;
            called.sort_unstable();
            let before = self.node.len();
            for &parent in &called {
                if self.node.len() - self.first_new >= self.limits.max_nodes {
                    break;
                }
                self.sprout(parent, &calls[parent as usize]);
            }
            if self.node.len() == before {
                break;
            }
            calls.resize(self.node.len(), idle);
            for i in before..self.node.len() {
                grid.visit(i as u32, self.node[i], influence_sq, kill_sq);
            }
        }
    }

    /// Grows one child of `parent`, or closes `parent`.
    fn sprout(&mut self, parent: u32, call: &Call) {
        let p = parent as usize;
        let (at, heading) = (self.node[p], self.heading[p]);
        let to_nearest = (call.nearest - at).normalize_or_zero();
        let mut direction = call.sum.normalize_or_zero();
        // n ≈ 0: attractors pull evenly.
        if call.sum.length_squared() < 1e-4 {
            direction = to_nearest;
        }
        let blended = direction + self.habit.inertia * heading + (self.pull)(at);
        let direction = blended.try_normalize().unwrap_or(to_nearest);
        let step = self.reach.step_m.min(call.nearest_sq.sqrt());
        // The mean first; where that leads nowhere new, the nearest attractor.
        let new = [direction, to_nearest].into_iter().find_map(|wish| {
            let direction = turned_at_most(heading, wish, self.habit.max_turn_rad);
            let direction = turned_at_most(self.left_at[p], direction, self.habit.max_bend_rad);
            let child = at + direction * step;
            let earlier = &self.grown[p][..self.children[p] as usize];
            let repeats = earlier.iter().any(|d| d.dot(direction) > SAME_DIRECTION);
            let is_short = step < 0.01 * self.reach.step_m || child == at || !child.is_finite();
            let cell = cell(child, 0.05 * self.reach.step_m);
            (!repeats && !is_short && self.taken.insert(cell)).then_some((direction, child))
        });
        let Some((direction, child)) = new else {
            self.children[p] = MAX_CHILDREN;
            return;
        };
        self.grown[p][self.children[p] as usize] = direction;
        self.children[p] += 1;
        self.node.push(child);
        self.parent.push(parent);
        self.heading.push(direction);
        let goes_on = self.children[p] == 1 && self.left_at[p] != Vec3::ZERO;
        self.left_at.push(if goes_on { self.left_at[p] } else { direction });
        self.children.push(0);
        self.grown.push([Vec3::ZERO; MAX_CHILDREN as usize]);
    }
}

/// `wish`, or where it turns too far from `heading`, the direction that far towards it.
fn turned_at_most(heading: Vec3, wish: Vec3, max_turn_rad: f32) -> Vec3 {
    if heading == Vec3::ZERO || heading.angle_between(wish) <= max_turn_rad {
        return wish;
    }
    let side = wish - heading * heading.dot(wish);
    let side = side.try_normalize().unwrap_or_else(|| heading.any_orthonormal_vector());
    let (s, c) = max_turn_rad.sin_cos();
    (heading * c + side * s).normalize_or(wish)
}

#[cfg(test)]
mod tests;
