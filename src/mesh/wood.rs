//! Which axes of a skeleton become tubes, and how finely, within a budget of triangles.

use super::chain::{Chains, Pieces};
use super::junction::{self, Hole};
use super::leave::{self, Branch};
use super::path::{FLARE, Foot, Knot, Least, Ring, Scratch, Sides, Start, Stem, rings};
use super::transition;
use super::tube::{self, Outlet, Shape, lay_bark};
use super::wind::Wind;
use super::young::{BARKS, Upper, Young};
use super::{FoliageLevel, Junctions, MeshOptions, Surface, reach_m};
use crate::seed::Seed;
use crate::skeleton::Skeleton;
use crate::species::Species;
use crate::species::model::Bark;
use crate::texture::BARK_REPEAT_M;

/// How much coarser a wood may become for a budget, unless branches are so thick that they would stay; how often that is tried, and by what steps of
/// the logarithm.
const COARSEST: f32 = 3000.0;
const ATTEMPTS: u32 = 8;
const STEP: f32 = 0.004;
const GUESSES: u32 = 16;
/// Share of a budget that is aimed at, and that is enough; and times the aim that the finest wood
/// may be guessed at for it to be tried.
const AIM: f32 = 0.96;
const ENOUGH: f32 = 0.92;
const LIKELY: f32 = 1.8;
/// Share of a tree's triangles that a true stem may take.
const MOST_STEM: f32 = 0.7;
/// Triangles of a tree from which on its foot has lobes: a first coarser level is looked at from as near.
const NEAR: usize = 6_000;
/// Triangles of a tree below which bark changes at a ring: it is seen from afar.
const FAR_BELOW: usize = 1_000;
/// What woods come to over their guesses, bare and leafy: where the search starts.
const USUAL: [f32; 2] = [0.93, 1.1];

/// Bark of twigs is where wood is thin, from none to all: radius over the radius that the species gives.
const TWIG_RADIUS: [f32; 2] = [1.4, 0.75];

/// The wood of a tree, bark by bark.
pub struct Wood {
    pub surface: [Surface; BARKS],
    pub count: Count,
    /// Of the skeleton's nodes, whether a tube goes along them.
    pub is_meshed: Vec<bool>,
}

/// Axes thick enough for the budget, those of them that have no tube or, though wood is welded, come out of no
/// hole in their parent's bark, and how far facets are from their circles.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Count {
    pub axes: usize,
    pub without: usize,
    pub unwelded: usize,
    /// Metres, and the sides of the ring that has it.
    pub sagitta: (f32, u32),
}

impl Wood {
    pub fn triangles(&self) -> usize {
        self.surface.iter().map(Surface::triangles).sum()
    }
}

/// Meshes the wood; with a budget, coarser until it fits: thin axes, which foliage hides, go first,
/// then sides and rings. The stem always stays.
pub fn wood(
    skeleton: &Skeleton,
    options: &MeshOptions,
    budget: Option<usize>,
    species: &Species,
    wind: Option<&Wind>,
    seed: Seed,
) -> Wood {
    let bark = &species.bark;
    let is_bare = options.foliage == FoliageLevel::None || species.foliage.is_bare();
    // Where leaves are near enough that one sees what they hang from.
    let by_place = budget.is_some() && !is_bare && !options.has_far_cards();
    let chains = Chains::new(skeleton, by_place);
    let height_m = skeleton.height_m();
    let foot_m = skeleton.radius_m.first().copied().unwrap_or(0.0).max(1e-6);
    let young = Young { upper: Upper::of(bark, foot_m, height_m), twig_m: twig_m(bark) };
    let planner = Planner {
        skeleton,
        chains: &chains,
        young,
        least: Least::within(reach_m(&skeleton.position)),
        is_welded: options.junctions == Junctions::Welded,
        stem: if options.has_far_cards() { Stem::TRUE } else { Stem::NEAR },
        is_bare,
        options: *options,
    };
    let mut bark = tube::Bark::new(young, wind, seed);
    let mut work = Work::default();
    let count = match budget {
        Some(budget) => planner.fit(budget, &mut work, &mut bark),
        None => planner.attempt(0.0, &mut work, &mut bark),
    };
    let mut is_meshed = vec![false; skeleton.len()];
    for c in (0..chains.chain.len() as u32).filter(|&c| !work.pieces.of(c).is_empty()) {
        for &node in chains.line(c) {
            is_meshed[node as usize] = true;
        }
    }
    Wood { surface: bark.finish(), count, is_meshed }
}

/// Height from which on the stem of a skeleton has the bark of the upper one, halfway; `None` where the
/// species has none.
pub fn upper_bark_from_m(skeleton: &Skeleton, bark: &Bark) -> Option<f32> {
    let foot_m = *skeleton.radius_m.first()?;
    let [high_m, thin_m] = Upper::of(bark, foot_m, skeleton.height_m())?.half();
    let axes = skeleton.axes();
    let stem = axes.iter().next()?;
    let of = |i: u32| (skeleton.position[i as usize].z, skeleton.radius_m[i as usize]);
    let thins_m = stem.nodes.windows(2).find_map(|w| {
        let [(low_m, thick), (above_m, thin)] = [of(w[0]), of(w[1])];
        let share = (thick - thin_m) / (thick - thin).max(1e-9);
        (thin <= thin_m).then(|| low_m + (above_m - low_m) * share.clamp(0.0, 1.0))
    });
    Some(thins_m.map_or(high_m, |z| z.min(high_m)))
}

fn twig_m(bark: &Bark) -> Option<[f32; 2]> {
    bark.twig.map(|_| TWIG_RADIUS.map(|r| r * bark.twig_radius_m))
}

/// Whether the stem of a skeleton has the bark of twigs from a third of its length on; of several, the thickest.
pub fn stem_is_twig(skeleton: &Skeleton, bark: &Bark) -> bool {
    let young = Young { upper: None, twig_m: twig_m(bark) };
    let is_stool = skeleton.is_stool();
    let stands = |&i: &usize| is_stool && skeleton.parent[i] == 0;
    let thickest = (1..skeleton.len()).filter(stands).map(|i| skeleton.radius_m[i]);
    if let Some(radius_m) = thickest.reduce(f32::max) {
        return young.is_twig(radius_m);
    }
    let axes = skeleton.axes();
    let stem = axes.iter().next().and_then(|stem| stem.nodes.get(stem.nodes.len() / 3).copied());
    stem.is_some_and(|i| young.of_stem().is_twig(skeleton.radius_m[i as usize]))
}

struct Planner<'a> {
    skeleton: &'a Skeleton,
    chains: &'a Chains,
    young: Young,
    least: Least,
    is_welded: bool,
    stem: Stem,
    /// Without leaves to hide branches, and to reach the top.
    is_bare: bool,
    options: MeshOptions,
}

/// Buffers of an attempt, kept for the next.
#[derive(Default)]
struct Work {
    pieces: Pieces,
    /// Of every chain: what it comes out of.
    from: Vec<Origin>,
    /// Of every hole so far.
    start: Vec<Start>,
    scratch: Scratch,
    path: Vec<Ring>,
    todo: Vec<(u32, f32)>,
    branches: Vec<Branch>,
    before: Vec<Branch>,
    rings: Vec<Ring>,
    holes: Vec<Hole>,
}

/// What a chain comes out of.
#[derive(Clone, Copy, PartialEq)]
enum Origin {
    /// Not known yet: that on which it begins.
    Parent,
    /// What its parent comes out of, in whose bark the parent still is where it begins.
    Bark,
    Hole(u32),
    /// Bark that had no room for its foot: closed for itself.
    Crowd,
}

impl Planner<'_> {
    /// A wood that uses most of a budget, or the coarsest of all. What woods would have is guessed
    /// from their straight pieces; each attempt tells how far off such guesses are.
    fn fit(&self, budget: usize, work: &mut Work, bark: &mut tube::Bark) -> Count {
        let mut ratio = USUAL[usize::from(!self.is_bare)];
        let aim = budget as f32 * AIM;
        let mut guesses = [0.0, COARSEST.ln()].map(|x| (x, self.guess(x, work))).to_vec();
        if guesses[1].1 * ratio > aim {
            let heaviest_m = self.chains.chain.iter().map(|c| c.weight_m).fold(0.0, f32::max);
            let bare = (1.0 + 1.01 * heaviest_m / self.cut_m()).ln();
            if bare > guesses[1].0 {
                guesses.push((bare, self.guess(bare, work)));
            }
        }
        let coarsest = guesses[guesses.len() - 1].0;
        if guesses[0].1 < LIKELY * aim {
            let count = self.attempt(0.0, work, bark);
            if bark.triangles() <= budget {
                return count;
            }
            ratio = bark.triangles() as f32 / guesses[0].1;
        }
        // Too fine, and coarse enough.
        let (mut fine, mut rough) = (0.0, coarsest);
        let mut best = None;
        for _ in 0..ATTEMPTS {
            let (mut x, mut guess) = self.near(aim / ratio, &mut guesses, work);
            if x < fine + STEP || (best.is_some() && x > rough - STEP) {
                // Attempts belie all guesses.
                x = 0.5 * (fine + rough);
                guess = self.guess(x, work);
            }
            let count = self.attempt(x, work, bark);
            let triangles = bark.triangles();
            ratio = triangles.max(1) as f32 / guess;
            if triangles > budget {
                fine = x;
                if fine >= rough {
                    let whole = self.options.triangle_budget.unwrap_or(usize::MAX);
                    if triangles as f32 <= MOST_STEM * whole as f32 {
                        return count;
                    }
                    let plain = Planner { stem: Stem::PLAIN, ..*self };
                    return plain.attempt(x, work, bark);
                }
            } else if triangles as f32 > ENOUGH * budget as f32 || rough - fine < 4.0 * STEP {
                return count;
            } else {
                (rough, best) = (x, Some(x));
            }
        }
        self.attempt(best.unwrap_or(rough), work, bark)
    }

    /// A coarseness whose guess is near the one given, and that guess; `guesses` are those known,
    /// in ascending order of coarseness, two at least.
    fn near(&self, aim: f32, guesses: &mut Vec<(f32, f32)>, work: &mut Work) -> (f32, f32) {
        let mut turn = 0;
        loop {
            let i = guesses.partition_point(|g| g.1 > aim).clamp(1, guesses.len() - 1);
            let [(fine, over), (rough, under)] = [guesses[i - 1], guesses[i]];
            if under > 0.99 * aim || rough - fine < STEP || turn == GUESSES {
                return (rough, under);
            }
            // False position between the logarithms, every third time by halves.
            let share = (over / aim).ln() / (over / under).ln();
            let is_turn = turn % 3 == 2 || share.is_nan();
            let share = if is_turn { 0.5 } else { share.clamp(0.05, 0.95) };
            let x = fine + (rough - fine) * share;
            guesses.insert(i, (x, self.guess(x, work)));
            turn += 1;
        }
    }

    /// Greatest distance from the skeleton, and least weight of a branch.
    fn limits(&self, coarse: f32) -> (f32, f32) {
        let finest_m = self.options.tolerance_m.clamp(1e-5, 1.0);
        let most_m = self.options.sagitta_m.max(finest_m);
        let tolerance_m = (finest_m * coarse.powf(0.6)).min(most_m);
        (tolerance_m, self.cut_m() * (coarse - 1.0))
    }

    /// Least weight of a branch where wood is twice as coarse as it need be.
    fn cut_m(&self) -> f32 {
        // Bare twigs are the crown, few leaves show them, and cards seen from near hang from them: there sides
        // go before axes.
        let is_seen = self.is_bare || self.options.is_thin() || self.options.has_near_cards();
        if is_seen { 0.0003 } else { 0.0015 }
    }

    /// About how many triangles a wood of this coarseness has.
    fn guess(&self, log_coarse: f32, work: &mut Work) -> f32 {
        let (tolerance_m, cut_m) = self.limits(log_coarse.exp());
        let sides = Sides::new(tolerance_m, self.stem);
        work.pieces.simplify(self.chains, &sides, (cut_m, self.is_bare), self.least);
        self.triangles(&work.pieces, &sides)
    }

    fn triangles(&self, pieces: &Pieces, sides: &Sides) -> f32 {
        let rest = |c: u32| {
            let knots = pieces.of(c);
            let Some(base) = knots.first() else { return 0 };
            let is_stem = c == 0 || self.stands(c);
            let around = |k: &Knot| match is_stem && !self.is_one_of_many(c) {
                true => sides.of_stem(k.radius_m, base.radius_m),
                false => sides.of(k.radius_m),
            };
            let rings: u32 = knots[1..].iter().map(|k| 2 * around(k)).sum();
            let around = sides.of(base.radius_m);
            // Its hole and a ring of its parent, less its tip, which is a point; or its base.
            let (collar_rings, more) = if self.is_welded { (2, 8) } else { (3, around) };
            let has_collar = leave::has_collar(base.radius_m, sides);
            rings + more + if has_collar { collar_rings * 2 * around } else { 0 }
        };
        (0..self.chains.chain.len() as u32).map(rest).sum::<u32>().max(1) as f32
    }

    /// Makes the tubes of a wood anew, parents before their branches.
    fn attempt(&self, log_coarse: f32, work: &mut Work, bark: &mut tube::Bark) -> Count {
        bark.clear();
        let coarse = log_coarse.exp();
        let (tolerance_m, cut_m) = self.limits(coarse);
        let is_near = self.options.triangle_budget.is_some_and(|most| most >= NEAR);
        let detail = is_near || self.options.detail && coarse < 30.0;
        let Work { pieces, from, start, scratch, path, todo, branches, before, rings: made, holes } =
            work;
        let sides = Sides::new(tolerance_m, self.stem);
        pieces.simplify(self.chains, &sides, (cut_m, self.is_bare), self.least);
        bark.reserve((self.triangles(pieces, &sides) * 1.2) as usize);
        let count_of = self.chains.chain.len() as u32;
        let Some(root) = (0..count_of).find(|&c| !pieces.of(c).is_empty()) else {
            return Count::default();
        };
        from.clear();
        from.resize(count_of as usize, Origin::Parent);
        start.clear();
        start.reserve(count_of as usize);
        let (mut tubes, mut unwelded, mut sagitta) = (0, 0, (0.0, 0));
        for c in root..count_of {
            let comes_from = from[c as usize];
            let foot = match comes_from {
                Origin::Hole(hole) => Foot::Collar(start[hole as usize]),
                _ if c == root || self.stands(c) => self.foot(c),
                Origin::Crowd => self.inside(c),
                _ if !self.is_welded => self.inside(c),
                _ => continue,
            };
            path.clear();
            let knots = pieces.of(c);
            let shift_m = rings(knots, foot, self.least, &sides, detail, scratch, path);
            if path.is_empty() {
                continue;
            }
            branches.clear();
            todo.clear();
            if self.is_welded {
                let at = |&(k, place): &(u32, u32)| (k, pieces.arc_m(place));
                let branches = self.chains.branches(c).iter();
                let own =
                    branches.filter(|b| !self.stands(b.0) && from[b.0 as usize] == Origin::Parent);
                todo.extend(own.map(at));
                if c == root {
                    // What springs from chains before the root springs from its foot.
                    let lost = (0..root).flat_map(|c| self.chains.branches(c));
                    let lost = lost.filter(|b| b.0 > root && !self.stands(b.0));
                    todo.extend(lost.map(|b| (b.0, 0.0)));
                }
            }
            while let Some((child, arc_m)) = todo.pop() {
                let knots = pieces.of(child);
                if knots.is_empty() && self.chains.chain[child as usize].weight_m < cut_m {
                    continue;
                }
                let arc = arc_m + shift_m;
                let ranked = [child, self.chains.chain[child as usize].first];
                let found = leave::leave(path, arc, knots, ranked, self.least, &sides);
                // What springs from a branch within the bark springs from the bark.
                match found {
                    Some(branch) => {
                        for &(k, place) in self.chains.branches(child) {
                            if pieces.arc_m(place) < branch.start.arc_m {
                                from[k as usize] = Origin::Bark;
                                todo.push((k, arc_m));
                            }
                        }
                        branches.push(branch);
                    }
                    None => {
                        todo.extend(self.chains.branches(child).iter().map(|b| (b.0, arc_m)));
                    }
                }
            }
            // Until they have their holes; what springs from a branch within the bark, where that has no room for
            // it, goes back to its branch.
            for branch in &*branches {
                let of = &mut from[branch.child as usize];
                *of = if *of == Origin::Bark { Origin::Parent } else { Origin::Crowd };
            }
            holes.clear();
            if branches.is_empty() {
                std::mem::swap(made, path);
            } else {
                made.clear();
                junction::open(path, branches, self.least, before, made, holes);
            }
            let is_stem = c == root && !self.is_one_of_many(c);
            let young = if is_stem { self.young.of_stem() } else { self.young };
            let is_far = self.options.triangle_budget.is_some_and(|most| most < FAR_BELOW);
            let tile_m =
                |radius_m: f32| young.transition_m(radius_m, BARK_REPEAT_M).filter(|_| !is_far);
            transition::part(made, holes, &young, self.least, tile_m);
            for hole in &*holes {
                from[hole.child as usize] = Origin::Hole(start.len() as u32);
                start.push(hole.start);
            }
            let out_of = match (foot, comes_from) {
                (Foot::Collar(Start { has_collar, .. }), Origin::Hole(hole)) => {
                    Some(Outlet { hole, has_collar })
                }
                _ => None,
            };
            tubes += 1;
            unwelded += usize::from(self.is_welded && matches!(foot, Foot::Inside { .. }));
            let of_tube = sides.sagitta(made);
            if of_tube.0 > sagitta.0 {
                sagitta = of_tube;
            }
            // Past a flare or a collar; the same whatever was left out of the axis.
            let foot_m = FLARE * knots[0].radius_m;
            let beyond = (|| self.chains.radius_after(c, foot_m), foot_m + shift_m);
            lay_bark(made, BARK_REPEAT_M, beyond, self.chains.chain[c as usize].axis);
            bark.tube(Shape {
                rings: made,
                holes,
                out_of,
                is_stem,
                line: self.chains.line(c),
                arcs_m: pieces.arcs_m(self.chains, c),
                shift_m,
                key: u64::from(self.chains.chain[c as usize].axis),
            });
        }
        let axes = pieces.count();
        Count { axes, without: axes - tubes, unwelded, sagitta }
    }

    /// A stem of a stool.
    fn stands(&self, c: u32) -> bool {
        self.chains.chain[c as usize].stands
    }

    fn is_one_of_many(&self, c: u32) -> bool {
        self.chains.chain[c as usize].is_one_of_many
    }

    /// How a stem begins.
    fn foot(&self, c: u32) -> Foot {
        let is_one_of_many = self.is_one_of_many(c);
        // Stems of a stool are thin for most of their length.
        let mixed_m = self.young.of_stem().twig_m.filter(|_| !is_one_of_many);
        Foot::Ground { mixed_m, is_one_of_many }
    }

    /// How a chain begins that comes out of no hole.
    fn inside(&self, c: u32) -> Foot {
        let s = self.skeleton;
        // Several stems may spring from the root.
        let base = self.chains.chain[c as usize].base.filter(|base| *base != 0);
        let Some(base) = base else { return self.foot(c) };
        let before = s.parent_of(base).unwrap_or(base);
        let along = s.position[base as usize] - s.position[before as usize];
        Foot::Inside {
            parent_radius_m: s.radius_m[base as usize].min(1e4),
            parent_direction: along.normalize_or_zero(),
        }
    }
}
