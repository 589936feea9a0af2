//! Where branches leave their parent: each through a hole of its own in the parent's grid of
//! facets, so that the wood of a stem is one closed surface.
//!
//! A parent's tube is bands of facets between rings. A branch's foot is an ellipse about the place
//! where the branch's line passes through the bark, long the way the branch leans; a block of facets
//! of one band that holds it is left out, and the surface between the block's edge and the ellipse is
//! filled flat with the parent's own facets (see `tube`). So the blocks of a tube must not share a
//! facet:
//! - feet that overlap along the tube lie side by side in one band, shifted around where needed;
//! - where there is no room, the later one goes up the tube into a band of its own;
//! - where a tube is too short for that, those below give way down the tube;
//! - where it is too short for that, too, all its feet are spread evenly and made smaller;
//! - where a tube has no room that f32 can tell apart, the thinnest are left out: their branches pass into the
//!   tube, closed for themselves;
//! - none lies across a bend of more than a right angle, where the tube has room elsewhere.
//!
//! Where one had to go far up the tube, those it gave way to go down by half as much.
//!
//! A ring that would cut through a foot moves to its edge, and a foot's band keeps its sides.

use std::f32::consts::TAU;

use glam::{Vec2, Vec3, Vec3A};

use super::leave::{Branch, Stance};
use super::path::{Least, Ring, Start};

/// Room about a foot within its block: along, times its half length, and no more than that share of the
/// band; around, in facets.
const ROOM_ALONG: f32 = 1.2;
const MOST_ALONG: f32 = 0.06;
const ROOM_AROUND: f32 = 0.08;

/// From so many half widths on a foot lies far from its place, and others give way to it.
const FAR: f32 = 3.0;

/// Least half height of a foot over that of its band, which may be most of a plain stem.
const LEAST_HALF: f32 = 0.002;

/// How many feet may lie side by side where they crowd, as is tried in turn.
const BESIDE: [f32; 3] = [4.0, 2.0, 1.0];

/// A foot in its block of facets.
#[derive(Debug, Clone, Copy)]
pub struct Hole {
    pub child: u32,
    /// The ring below, counted from the tube's first.
    pub band: u32,
    /// The block's first facet and how many it has.
    pub facet: u32,
    pub facets: u32,
    /// Middle and half width in facets from the block's first; middle and half height as shares
    /// of the band.
    pub x: f32,
    pub half_x: f32,
    pub t: f32,
    pub half_t: f32,
    /// Where a corner of the unit circle goes within these halves: around and along.
    pub foot: [Vec2; 2],
    pub start: Start,
    arc_m: f32,
    half_m: f32,
    /// How far up the tube it had to go, and how far off it lies in all.
    pushed_m: f32,
    moved_m: f32,
}

impl Hole {
    fn is_far(&self) -> bool {
        self.moved_m > FAR * self.start.wide_m
    }

    /// Whether the foot or the room about it lies at an arc length.
    pub fn is_about(&self, arc_m: f32) -> bool {
        (self.arc_m - arc_m).abs() <= self.half_m * ROOM_ALONG
    }
}

#[cfg(test)]
impl Hole {
    /// `x` and `t`: middle and half width.
    pub fn new(
        facet: u32,
        facets: u32,
        x: [f32; 2],
        t: [f32; 2],
        foot: [Vec2; 2],
        start: Start,
    ) -> Hole {
        let ([x, half_x], [t, half_t]) = (x, t);
        let (child, band, arc_m, half_m, pushed_m, moved_m) = (0, 0, 0.0, 0.0, 0.0, 0.0);
        Hole {
            child,
            band,
            facet,
            facets,
            x,
            half_x,
            t,
            half_t,
            foot,
            start,
            arc_m,
            half_m,
            pushed_m,
            moved_m,
        }
    }
}

/// The greatest whole number that is no greater; few machines do it in one step.
fn floor(x: f32) -> i32 {
    let whole = x as i32;
    whole - i32::from(x < whole as f32)
}

/// A ring of the path between two others.
fn between(a: &Ring, b: &Ring, t: f32) -> Ring {
    let lerp = |a: Vec3, b: Vec3| Vec3A::from(a).lerp(b.into(), t);
    let tangent = lerp(a.tangent, b.tangent).normalize_or(a.tangent.into());
    let normal = lerp(a.normal, b.normal);
    let normal = (normal - tangent * tangent.dot(normal))
        .try_normalize()
        .unwrap_or_else(|| tangent.any_orthonormal_vector());
    let mix = |a: f32, b: f32| a + (b - a) * t;
    Ring {
        centre: lerp(a.centre, b.centre).into(),
        tangent: tangent.into(),
        normal: normal.into(),
        radius_m: mix(a.radius_m, b.radius_m),
        arc_m: mix(a.arc_m, b.arc_m),
        slope: mix(a.slope, b.slope),
        lobe: mix(a.lobe, b.lobe),
        ..*a
    }
}

/// The ring at an arc length of the path.
pub fn at(path: &[Ring], arc_m: f32, least: Least) -> Ring {
    let i = path.partition_point(|r| r.arc_m <= arc_m).clamp(1, path.len() - 1);
    let (a, b) = (&path[i - 1], &path[i]);
    let t = (arc_m - a.arc_m) / (b.arc_m - a.arc_m).max(1e-9);
    let ring = between(a, b, t.clamp(0.0, 1.0));
    Ring { radius_m: ring.radius_m.max(least.radius_m), arc_m, ..ring }
}

/// Appends the rings of a tube with feet, and its holes. Takes the path of [`super::path::rings`]
/// and sorts the branches, the thinnest of which are dropped where f32 leaves no room. `before`: a buffer.
pub fn open(
    path: &[Ring],
    branches: &mut Vec<Branch>,
    least: Least,
    before: &mut Vec<Branch>,
    rings: &mut Vec<Ring>,
    holes: &mut Vec<Hole>,
) {
    let start = (rings.len(), holes.len());
    let mut again = |branches: &mut Vec<Branch>, holes: &mut Vec<Hole>| {
        rings.truncate(start.0);
        holes.truncate(start.1);
        lay(path, branches, least, rings, holes);
        // How far off all are.
        holes[start.1..].iter().map(|hole| hole.moved_m * hole.moved_m).sum::<f32>()
    };
    before.clone_from(branches);
    let off = again(branches, holes);
    if holes[start.1..].iter().any(Hole::is_far) {
        share_ways(branches, &holes[start.1..]);
        if again(branches, holes) > off {
            branches.clone_from(before);
            again(branches, holes);
        }
    }
}

/// Shifts each row of feet, of which all but the first had to go up, down by half of the longest way.
fn share_ways(branches: &mut [Branch], holes: &[Hole]) {
    const STILL_M: f32 = 1e-5;
    let is_pushed = |hole: &Hole| hole.pushed_m > STILL_M;
    let mut k = 0;
    while k < holes.len() {
        // Those of one band that stay, and all that they push.
        let row = holes[k..].iter().take_while(|h| !is_pushed(h) && h.band == holes[k].band);
        let stay = row.count();
        let pushed = holes[k + stay..].iter().take_while(|h| is_pushed(h)).count();
        let row = &holes[k..k + stay + pushed];
        let most_m = row.iter().map(|hole| hole.pushed_m).fold(0.0, f32::max);
        for (branch, hole) in branches[k..].iter_mut().zip(row) {
            branch.arc_m = hole.arc_m - 0.5 * most_m;
        }
        k += row.len().max(1);
    }
}

fn lay(
    path: &[Ring],
    branches: &mut Vec<Branch>,
    least: Least,
    rings: &mut Vec<Ring>,
    holes: &mut Vec<Hole>,
) {
    if branches.is_empty() || path.len() < 2 {
        rings.extend_from_slice(path);
        return;
    }
    let apex_m = path[path.len() - 1].arc_m;
    // A branch's own collar stays whole.
    let is_collar = path.len() > 2 && path[1].arc_m < (0.3 * apex_m).min(4.0 * path[0].radius_m);
    let low = if is_collar { path[1].arc_m } else { 0.0 };
    let high = apex_m - (0.1 * (apex_m - low)).min(least.step_m);
    let room = high - low;
    let most = (4.0 * room / least.step_m).floor().max(1.0) as usize;
    if branches.len() > most {
        branches.sort_by(|a, b| {
            b.start.radius_m.total_cmp(&a.start.radius_m).then(a.rank.cmp(&b.rank))
        });
        branches.truncate(most);
    }
    for b in branches.iter_mut() {
        b.half_m = b.half_m.min(0.3 * room);
        let block = b.half_m * ROOM_ALONG;
        b.arc_m = b.arc_m.clamp(low + block, high - block);
    }
    sort(branches);
    let start = (rings.len(), holes.len());
    let fits = |branches: &[Branch], rings: &mut Vec<Ring>, holes: &mut Vec<Hole>| {
        rings.truncate(start.0);
        holes.truncate(start.1);
        sweep(path, branches, high, least, rings, holes)
    };
    let is_laid = fits(branches, rings, holes)
        || BESIDE
            .into_iter()
            .any(|beside| sink(branches, low, high, beside) && fits(branches, rings, holes));
    if !is_laid {
        rings.truncate(start.0);
        holes.truncate(start.1);
        let each = room / branches.len() as f32;
        for (k, b) in branches.iter_mut().enumerate() {
            b.half_m = b.half_m.min(0.3 * each);
            b.arc_m = low + each * (k as f32 + 0.5);
        }
        sort(branches);
        sweep(path, branches, f32::INFINITY, least, rings, holes);
    }
    settle(&rings[start.0..], &mut holes[start.1..]);
}

/// Makes room where feet crowd towards the tip: each lies as far down the tube, and no farther, as those above
/// it need, of which so many lie side by side. False where that is below the tube's foot.
fn sink(branches: &mut [Branch], low_m: f32, high_m: f32, beside: f32) -> bool {
    let mut above_m = high_m;
    for b in branches.iter_mut().rev() {
        let block_m = b.half_m * ROOM_ALONG;
        b.arc_m = b.arc_m.min(above_m - block_m).min(high_m - block_m);
        above_m = b.arc_m + block_m - 2.0 * block_m / beside;
    }
    sort(branches);
    branches.first().is_none_or(|b| b.arc_m - b.half_m * ROOM_ALONG >= low_m)
}

fn sort(branches: &mut [Branch]) {
    let low = |b: &Branch| b.arc_m - b.half_m * ROOM_ALONG;
    branches.sort_by(|a, b| low(a).total_cmp(&low(b)).then(a.rank.cmp(&b.rank)));
}

/// The feet of the band that is being built: the facets taken, how far up they reach, and whether they
/// lie over a ring of the path.
struct Band {
    taken: u64,
    high_m: f32,
    lies_over: bool,
}

/// Whether a path turns by more than a right angle at one of its inner rings.
fn turns_back(path: &[Ring], i: usize) -> bool {
    let [a, b, c] = [i - 1, i, i + 1].map(|k| Vec3A::from(path[k].centre));
    (b - a).dot(c - b) < 0.0
}

/// One pass from base to tip; false where the feet do not fit below `high_m`.
fn sweep(
    path: &[Ring],
    branches: &[Branch],
    high_m: f32,
    least: Least,
    rings: &mut Vec<Ring>,
    holes: &mut Vec<Hole>,
) -> bool {
    let start = rings.len();
    let last = path.len() - 1;
    let step = least.step_m;
    rings.push(path[0]);
    let mut next = 1;
    let mut band: Option<Band> = None;
    // In place of the rings of the path that are too near.
    let end_band = |arc_m: f32, rings: &mut Vec<Ring>, next: &mut usize| {
        let sides = rings[rings.len() - 1].sides;
        rings.push(Ring { sides, ..at(path, arc_m, least) });
        while *next < last && path[*next].arc_m < arc_m + step {
            *next += 1;
        }
    };
    for b in branches {
        let half = b.half_m * ROOM_ALONG;
        let mut arc = b.arc_m;
        // Each turn takes a ring, starts a band or settles the foot.
        loop {
            let below = rings[rings.len() - 1];
            // Only what has been added tells how far a foot had to move.
            arc = arc.max(below.arc_m + half);
            let (lo, hi) = (arc - half, arc + half);
            if hi > high_m {
                return false;
            }
            let ring = (next < last).then(|| path[next]);
            if let Some(r) = ring.filter(|r| r.arc_m < hi && r.arc_m > below.arc_m + step)
                && high_m.is_finite()
                && turns_back(path, next)
            {
                // A band past it would be flat.
                let sides = if band.is_some() { below.sides } else { r.sides.min(below.sides) };
                rings.push(Ring { sides, ..r });
                next += 1;
                band = None;
                continue;
            }
            let Some(open) = &mut band else {
                match ring {
                    Some(r) if r.arc_m <= lo => {
                        rings.push(Ring { sides: r.sides.min(below.sides), ..r });
                        next += 1;
                        continue;
                    }
                    // A ring that would cut the foot moves down to its edge.
                    Some(r) if lo - below.arc_m > 2.0 * step && r.arc_m < hi => {
                        next += 1;
                        let low = at(path, lo, least);
                        rings.push(Ring { sides: low.sides.min(below.sides), ..low });
                    }
                    _ => {}
                }
                band = Some(Band { taken: 0, high_m: lo, lies_over: false });
                continue;
            };
            if open.lies_over && lo >= open.high_m {
                end_band(open.high_m, rings, &mut next);
                band = None;
                continue;
            }
            if let Some(r) = ring.filter(|r| r.arc_m >= open.high_m && r.arc_m <= lo)
                && open.taken != 0
            {
                rings.push(Ring { sides: below.sides, ..r });
                next += 1;
                band = None;
                continue;
            }
            if let Some(hole) = block(b, arc, below.sides, open.taken, open.taken == 0) {
                open.taken |= mask(hole.facet, hole.facets, below.sides);
                open.high_m = open.high_m.max(hi);
                let band = (rings.len() - 1 - start) as u32;
                holes.push(Hole { band, ..hole });
                while next < last && path[next].arc_m < open.high_m {
                    open.lies_over = true;
                    next += 1;
                }
                break;
            }
            let split = if lo > open.high_m { 0.5 * (lo + open.high_m) } else { open.high_m };
            end_band(split, rings, &mut next);
            band = None;
        }
    }
    if let Some(open) = band {
        let below = rings[rings.len() - 1];
        if next < last && !open.lies_over {
            rings.push(Ring { sides: below.sides, ..path[next] });
            next += 1;
        } else {
            rings.push(Ring { sides: below.sides, ..at(path, open.high_m, least) });
        }
    }
    while next < last {
        let below = rings[rings.len() - 1];
        if path[next].arc_m >= below.arc_m + step {
            rings.push(Ring { sides: path[next].sides.min(below.sides), ..path[next] });
        }
        next += 1;
    }
    rings.push(path[last]);
    true
}

/// Bits of the facets of a block; a ring has at most 64.
pub fn mask(facet: u32, facets: u32, sides: u32) -> u64 {
    let ones = |count: u32| u64::MAX >> (64 - count.clamp(1, 64));
    let before_seam = facets.min(sides - facet.min(sides - 1));
    let past = facets - before_seam;
    ones(before_seam) << facet.min(63) | if past > 0 { ones(past) } else { 0 }
}

/// A block of free facets for a foot: those about its place, else as few as hold it, else the same
/// shifted around; in an empty band always.
fn block(b: &Branch, arc_m: f32, sides: u32, taken: u64, is_empty: bool) -> Option<Hole> {
    let n = sides as i32;
    let per_turn = sides as f32 / TAU;
    let x = if b.turn < 0.0 { b.turn + TAU } else { b.turn } * per_turn;
    let half = b.half_turn * per_turn;
    let most = (n / 2).max(1);
    let reach = half + ROOM_AROUND;
    let wide = -floor(-x - reach) - floor(x - reach);
    let narrow = (-floor(-2.0 * reach)).clamp(1, most);
    let half_in = |count: i32| half.min(0.42 * count as f32);
    // Where the foot's middle comes to lie, in facets from the block's first.
    let middle = |(first, count): (i32, i32)| {
        let edge = half_in(count) + ROOM_AROUND;
        (x - first as f32).min(count as f32 - edge).max(edge)
    };
    let is_free = |&(first, count): &(i32, i32)| {
        is_empty || taken & mask(first.rem_euclid(n) as u32, count as u32, sides) == 0
    };
    let natural = (floor(x - reach), wide);
    let (first, count) = if wide <= most && is_free(&natural) {
        natural
    } else {
        let centred = floor(x - 0.5 * narrow as f32 + 0.5);
        // Shifted by no more than its half width: else it moves less by going up the tube.
        let may = half.max(0.5) + 1e-3;
        (0..=may as i32 + 1)
            .flat_map(|d| [(centred + d, narrow), (centred - d, narrow)])
            .filter(|&b| (b.0 as f32 + middle(b) - x).abs() <= may)
            .find(is_free)?
    };
    let (x, half_x) = (middle((first, count)), half_in(count));
    Some(Hole {
        child: b.child,
        band: 0,
        facet: first.rem_euclid(n) as u32,
        facets: count as u32,
        x,
        half_x,
        t: 0.5,
        half_t: 0.3,
        foot: [Vec2::NEG_Y, Vec2::X],
        start: b.start,
        arc_m,
        half_m: b.half_m,
        pushed_m: arc_m - b.arc_m,
        moved_m: 0.0,
    })
}

/// Puts a ring into the band below another, where no foot lies.
pub fn part(rings: &mut Vec<Ring>, holes: &mut [Hole], above: usize, ring: Ring) {
    rings.insert(above, ring);
    let parted = above as u32 - 1;
    for hole in &mut *holes {
        hole.band +=
            u32::from(hole.band > parted || hole.band == parted && hole.arc_m > ring.arc_m);
    }
    let of = |band: u32| holes.partition_point(|hole| hole.band < band);
    let moved = of(parted)..of(parted + 2);
    settle(rings, &mut holes[moved]);
}

/// Where feet lie within their bands, now that the rings stand; and where their branches begin.
fn settle(rings: &[Ring], holes: &mut [Hole]) {
    for hole in holes {
        let (a, b) = (&rings[hole.band as usize], &rings[hole.band as usize + 1]);
        let height = (b.arc_m - a.arc_m).max(1e-9);
        hole.half_t = (hole.half_m / height).clamp(LEAST_HALF, 0.4);
        let edge = (hole.half_t * ROOM_ALONG).min(hole.half_t + MOST_ALONG);
        hole.t = ((hole.arc_m - a.arc_m) / height).min(1.0 - edge).max(edge);
        let ring = between(a, b, hole.t);
        let tangent = Vec3A::from(ring.tangent);
        let (s, c) = ((hole.facet as f32 + hole.x) / a.sides as f32 * TAU).sin_cos();
        let radial = Vec3A::from(ring.normal) * c + Vec3A::from(ring.binormal()) * s;
        let start = &mut hole.start;
        let stance = Stance::of(start.direction.into(), tangent, radial);
        hole.foot = stance.foot().map(Vec2::normalize);
        let at = ring.centre + Vec3::from(radial * ring.radius_m);
        hole.moved_m = at.distance(start.at);
        start.at = at;
        start.away = radial.into();
        start.across = stance.across(tangent, radial).into();
        start.rise_m = stance.rise_m(start.radius_m, start.wide_m);
    }
}

#[cfg(test)]
mod tests {
    use super::super::leave::leave;
    use super::super::path::{Foot, Knot, Scratch, Sides, Stem, rings};
    use super::*;

    fn line(points: &[[f32; 3]]) -> Vec<Ring> {
        let knots: Vec<Knot> = points
            .iter()
            .map(|&[x, z, radius_m]| Knot { at: Vec3::new(x, 0.0, z), radius_m })
            .collect();
        let foot = Foot::Inside { parent_radius_m: points[0][2], parent_direction: Vec3::Z };
        let (mut scratch, mut path) = (Scratch::default(), Vec::new());
        rings(&knots, foot, LEAST, &sides(), false, &mut scratch, &mut path);
        path
    }

    fn sides() -> Sides {
        Sides::new(1e-3, Stem::TRUE)
    }

    const LEAST: Least = Least { radius_m: 5e-4, step_m: 2e-3 };

    /// Straight twigs from an axis along z: at which heights, and at which angles around.
    fn twigs(path: &[Ring], places: &[[f32; 2]], radius_m: f32) -> Vec<Branch> {
        let twig = |(k, &[z, turn]): (usize, &[f32; 2])| {
            let from = at(path, z, LEAST).centre;
            let (s, c) = turn.sin_cos();
            let knots = [0.0, 1.0].map(|m| Knot { at: from + Vec3::new(c, s, 0.0) * m, radius_m });
            leave(path, z, &knots, [k as u32; 2], LEAST, &sides()).unwrap()
        };
        places.iter().enumerate().map(twig).collect()
    }

    fn opened(path: &[Ring], mut branches: Vec<Branch>) -> (Vec<Ring>, Vec<Hole>) {
        let (mut made, mut holes) = (Vec::new(), Vec::new());
        open(path, &mut branches, LEAST, &mut Vec::new(), &mut made, &mut holes);
        assert_eq!(holes.len(), branches.len());
        (made, holes)
    }

    /// However long the band is.
    #[test]
    fn a_foot_alone_lies_where_its_branch_leaves() {
        let path = line(&[[0.0, 0.0, 0.05], [0.0, 10.0, 0.04]]);
        for z in [0.3, 0.7, 5.0, 9.5] {
            let (_, holes) = opened(&path, twigs(&path, &[[z, 1.0]], 0.004));
            assert!(holes[0].moved_m < 0.005, "{z}: {}", holes[0].moved_m);
        }
    }

    #[test]
    fn feet_in_one_place_share_the_way() {
        let path = line(&[[0.0, 0.0, 0.01], [0.0, 4.0, 0.008]]);
        let places = [[2.0, 1.0]; 4];
        let (_, holes) = opened(&path, twigs(&path, &places, 0.007));
        let off_m: Vec<f32> = holes.iter().map(|hole| hole.arc_m - 2.0).collect();
        let [low, high] = [off_m[0], off_m[3]];
        assert!(high > 0.01 && (high + low).abs() < 0.1 * high, "{off_m:?}");
    }

    /// A bend beside whose ring feet lie stays.
    #[test]
    fn a_tube_with_feet_keeps_its_bends() {
        for z in [1.97, 1.99, 2.0, 2.01, 2.03] {
            let path = line(&[[0.0, 0.0, 0.03], [0.0, 2.0, 0.03], [1.0, 4.0, 0.02]]);
            let bend = Vec3::Z * 2.0;
            let branches = twigs(&path, &[[z, 1.0], [z + 0.01, 3.0], [z - 0.5, 2.0]], 0.008);
            let (made, _) = opened(&path, branches);
            let off = |w: &[Ring]| {
                let (a, b) = (w[0].centre, w[1].centre);
                let share = (bend - a).dot(b - a) / (b - a).length_squared();
                bend.distance(a.lerp(b, share.clamp(0.0, 1.0)))
            };
            let off_m = made.windows(2).map(off).fold(f32::INFINITY, f32::min);
            assert!(off_m < 0.02, "{z}: {off_m} m");
        }
    }

    #[test]
    fn a_foot_is_shifted_around_by_no_more_than_its_half_width() {
        let start = Start::along_x(4);
        let mut found = 0;
        for sides in 3..=8u32 {
            for taken in 0..1u64 << sides {
                for k in 0..48 {
                    let (turn, half_turn) = (k as f32 * TAU / 24.0, 0.4 + 0.02 * k as f32);
                    let (rank, arc_m, half_m) = (0, 1.0, 0.1);
                    let b = Branch { child: 0, rank, arc_m, half_m, turn, half_turn, start };
                    let Some(hole) = block(&b, 1.0, sides, taken, taken == 0) else {
                        assert_ne!(taken, 0);
                        continue;
                    };
                    assert_eq!(taken & mask(hole.facet, hole.facets, sides), 0);
                    let at = (hole.facet as f32 + hole.x) * TAU / sides as f32;
                    let off = (at - turn + 0.5 * TAU).rem_euclid(TAU) - 0.5 * TAU;
                    let most = half_turn.max(0.5 * TAU / sides as f32) + 2e-3;
                    assert!(off.abs() <= most, "{sides} {taken:b} {turn}: {off}");
                    found += usize::from(taken != 0);
                }
            }
        }
        assert!(found > 1000);
    }
}
