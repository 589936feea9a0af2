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
//! - none lies across a bend of more than a right angle, where the tube has room elsewhere;
//! - a branch that never leaves the bark by more than its collar has no mesh.
//!
//! Where one had to go far up the tube, those it gave way to go down by half as much.
//!
//! A ring that would cut through a foot moves to its edge, and a foot's band keeps its sides.

use std::f32::consts::{FRAC_PI_2, PI, TAU};

use glam::{Vec2, Vec3, Vec3A};

use super::path::{Knot, Least, Ring, Sides, Start};

/// Flare of a collar, and of a twig too thin for one: width of the hole over the branch's.
const COLLAR: f32 = 1.45;
const NO_COLLAR: f32 = 1.1;
/// Width of the ring that ends it, over the branch's.
pub const COLLAR_END: f32 = 1.1;
/// Room about a foot within its block: along, times its half length, and no more than that share of the
/// band; around, in facets.
const ROOM_ALONG: f32 = 1.2;
const MOST_ALONG: f32 = 0.06;
const ROOM_AROUND: f32 = 0.08;

/// From so many half widths on a foot lies far from its place, and others give way to it.
const FAR: f32 = 3.0;

/// Least half height of a foot over that of its band, which may be most of a plain stem.
const LEAST_HALF: f32 = 0.002;

/// A foot is longer than wide by no more than the inverse.
const LEAST_LEAN: f32 = 0.45;

/// How many feet may lie side by side where they crowd, as is tried in turn.
const BESIDE: [f32; 3] = [4.0, 2.0, 1.0];

/// Near enough to the bark, in the branch's radii: its foot is laid onto it.
const ON_BARK: f32 = 0.05;

/// A branch's foot on its parent's path.
#[derive(Debug, Clone, Copy)]
pub struct Branch {
    pub child: u32,
    /// Which of two alike goes first.
    rank: u32,
    /// Middle and half length of the foot along the parent.
    arc_m: f32,
    half_m: f32,
    /// Angle of the middle from the frame's normal, −π…π, and half width as an angle.
    turn: f32,
    half_turn: f32,
    start: Start,
}

impl Branch {
    /// How far along it leaves its parent's bark.
    pub fn leaves_at_m(&self) -> f32 {
        self.start.arc_m
    }
}

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

/// A place on a path: its segment and share of that, the radius there, and how far another place
/// lies within the bark.
#[derive(Clone, Copy)]
struct Place {
    segment: usize,
    share: f32,
    radius_m: f32,
    depth_m: f32,
}

/// The place nearest to `p`, downhill from the segment given.
fn nearest(path: &[Ring], mut segment: usize, p: Vec3A) -> Place {
    let last = path.len() - 2;
    let mut came = 0;
    let mut share = 0.0;
    let (mut a, mut chord) = (Vec3A::ZERO, Vec3A::ZERO);
    for _ in 0..64 {
        a = path[segment].centre.into();
        chord = Vec3A::from(path[segment + 1].centre) - a;
        share = (p - a).dot(chord) / chord.length_squared().max(1e-20);
        if share > 1.0 && segment < last && came >= 0 {
            (segment, came) = (segment + 1, 1);
        } else if share < 0.0 && segment > 0 && came <= 0 {
            (segment, came) = (segment - 1, -1);
        } else {
            break;
        }
    }
    let share = share.clamp(0.0, 1.0);
    let [low, high] = [path[segment].radius_m, path[segment + 1].radius_m];
    let radius_m = low + (high - low) * share;
    let depth_m = radius_m - p.distance(a + chord * share);
    Place { segment, share, radius_m, depth_m }
}

/// Where a way from within the bark leaves it on one segment of the path, as a share of the way, and
/// the place there: its distance from the axis is the cone's radius, a quadratic equation.
fn outlet(path: &[Ring], segment: usize, from: Vec3A, way: Vec3A) -> Option<(f32, Place)> {
    let [low, high] = [&path[segment], &path[segment + 1]];
    let a = Vec3A::from(low.centre);
    let chord = Vec3A::from(high.centre) - a;
    let per_sq = chord.length_squared().max(1e-20).recip();
    let [at, onward] = [from - a, way].map(|v| v.dot(chord) * per_sq);
    let [near, away] = [from - a - chord * at, way - chord * onward];
    let wider = high.radius_m - low.radius_m;
    let [radius_m, change_m] = [low.radius_m + wider * at, wider * onward];
    let inside = near.length_squared() - radius_m * radius_m;
    let half = near.dot(away) - radius_m * change_m;
    let square = away.length_squared() - change_m * change_m;
    let t = -inside / (half + (half * half - square * inside).max(0.0).sqrt());
    let share = at + onward * t;
    let radius_m = radius_m + change_m * t;
    // NaN is no place.
    let is_there = inside < 0.0 && t > 0.0 && t <= 1.0 && (0.0..=1.0).contains(&share);
    is_there.then_some((t, Place { segment, share, radius_m, depth_m: 0.0 }))
}

/// The same over several segments, from the one given on, by halves; at the start where that is outside
/// the bark.
fn search(
    path: &[Ring],
    segment: usize,
    from: Vec3A,
    way: Vec3A,
    near_enough_m: f32,
) -> (f32, Place) {
    let mut inner = nearest(path, segment, from);
    if inner.depth_m <= 0.0 {
        return (0.0, inner);
    }
    let (mut lo, mut hi) = (0.0f32, 1.0f32);
    for _ in 0..6 {
        let middle = 0.5 * (lo + hi);
        let place = nearest(path, inner.segment, from + way * middle);
        if place.depth_m.abs() < near_enough_m {
            return (middle, place);
        }
        if place.depth_m > 0.0 { (lo, inner) = (middle, place) } else { hi = middle }
    }
    (hi, nearest(path, inner.segment, from + way * hi))
}

/// The foot of a branch whose knots begin near `base_arc_m` of the parent's path; `None` where it
/// stays within the bark.
pub fn leave(
    path: &[Ring],
    base_arc_m: f32,
    knots: &[Knot],
    [child, rank]: [u32; 2],
    least: Least,
    sides: &Sides,
) -> Option<Branch> {
    if path.len() < 2 || knots.len() < 2 {
        return None;
    }
    let first = path.partition_point(|r| r.arc_m <= base_arc_m).clamp(1, path.len() - 1) - 1;
    let at_knot = |i: usize| Vec3A::from(knots[i].at);
    let mut from = at_knot(0);
    let mut segment = first;
    let mut walked = 0.0;
    let mut found = None;
    for (i, w) in knots.windows(2).enumerate() {
        let way = at_knot(i + 1) - from;
        let step = way.length();
        let end = nearest(path, segment, from + way);
        if end.depth_m < 0.0 {
            let (out, place) = outlet(path, end.segment, from, way)
                .unwrap_or_else(|| search(path, segment, from, way, ON_BARK * w[0].radius_m));
            let radius = w[0].radius_m + (w[1].radius_m - w[0].radius_m) * out;
            let at = from + way * out;
            let direction = if step > 0.0 { way / step } else { Vec3A::Z };
            found = Some((walked + step * out, at, direction, radius, i + 1, place));
            walked += step;
            break;
        }
        segment = end.segment;
        from += way;
        walked += step;
    }
    let (on_branch_m, at, direction, radius, beyond, place) = found?;
    let [low, high] = [&path[place.segment], &path[place.segment + 1]];
    let mix = |of: fn(&Ring) -> Vec3| Vec3A::from(of(low)).lerp(of(high).into(), place.share);
    let tangent = mix(|r| r.tangent).normalize_or(low.tangent.into());
    // Its angle about the tangent counts alone.
    let normal = mix(|r| r.normal);
    let square = |v: Vec3A| (v - tangent * tangent.dot(v)).try_normalize();
    let radial = square(at - mix(|r| r.centre))
        .or_else(|| square(direction))
        .unwrap_or_else(|| tangent.any_orthonormal_vector());
    let host = place.radius_m.max(least.radius_m);
    let r = radius.max(least.radius_m).min(host);
    let has_collar = has_collar(r, sides);
    let wide = r * if has_collar { COLLAR } else { NO_COLLAR };
    let stance = Stance::of(direction, tangent, radial);
    let [half_around, half_along] = stance.foot().map(|axis| wide * axis.length());
    let sine = (half_around / host).min(0.94);
    let rise_m = stance.rise_m(r, wide);
    // A stub shorter than its collar is bark.
    let stub_m = (rise_m + r).max(2.0 * least.step_m);
    let mut further = knots[beyond..].windows(2);
    while walked - on_branch_m < stub_m {
        let w = further.next()?;
        walked += w[0].at.distance(w[1].at);
    }
    Some(Branch {
        child,
        rank,
        arc_m: low.arc_m + (high.arc_m - low.arc_m) * place.share,
        half_m: half_along,
        turn: angle(radial.dot(normal), radial.dot(tangent.cross(normal))),
        half_turn: angle((1.0 - sine * sine).sqrt(), sine),
        start: Start {
            at: at.into(),
            away: radial.into(),
            across: stance.across(tangent, radial).into(),
            direction: direction.into(),
            arc_m: on_branch_m,
            radius_m: r,
            wide_m: wide,
            rise_m,
            has_collar,
            // A ring of the collar may be wider than a foot on thinner wood.
            sides: sides.of(wide.max(COLLAR_END * radius)),
        },
    })
}

/// Angle of a direction from x towards y, −π…π, within 3e-4: near enough for a place around a tube.
fn angle(x: f32, y: f32) -> f32 {
    let (wide, high) = (x.abs(), y.abs());
    let (less, more) = if wide < high { (wide, high) } else { (high, wide) };
    let t = less / more.max(1e-30);
    let s = t * t;
    let octant = t * (1.0 + s * (-0.327_623 + s * (0.159_314 - s * 0.046_496_5)));
    let quarter = if wide < high { FRAC_PI_2 - octant } else { octant };
    let half = if x < 0.0 { PI - quarter } else { quarter };
    half.copysign(y)
}

/// The greatest whole number that is no greater; few machines do it in one step.
fn floor(x: f32) -> i32 {
    let whole = x as i32;
    whole - i32::from(x < whole as f32)
}

/// How a branch stands on the bark of its parent.
struct Stance {
    /// Cosine of the angle between it and the bark's normal.
    lean: f32,
    /// Unit; the way it leans, around the parent and along it.
    onward: Vec2,
}

impl Stance {
    fn of(direction: Vec3A, tangent: Vec3A, radial: Vec3A) -> Stance {
        let around = tangent.cross(radial);
        let onward = Vec2::new(direction.dot(around), direction.dot(tangent));
        let length = onward.length();
        let onward = if length > 0.05 { onward / length } else { Vec2::Y };
        Stance { lean: direction.dot(radial), onward }
    }

    /// Its foot over the width of its collar: where a corner of the unit circle lies around and
    /// along the parent. The first corner is the one it leans over.
    fn foot(&self) -> [Vec2; 2] {
        let Vec2 { x: around, y: along } = self.onward;
        let long = self.lean.clamp(LEAST_LEAN, 1.0).recip();
        [Vec2::new(long * around, -along), Vec2::new(long * along, around)]
    }

    /// How far along the branch a ring is clear of the bark and of the collar.
    fn rise_m(&self, radius_m: f32, wide_m: f32) -> f32 {
        let lean = self.lean.clamp(0.22, 1.0);
        let reach_m = (wide_m / lean.max(LEAST_LEAN)).max(radius_m / lean);
        0.5 * radius_m + reach_m * (1.0 - lean * lean).sqrt()
    }

    /// Unit; at right angles to the branch, in the bark.
    fn across(&self, tangent: Vec3A, radial: Vec3A) -> Vec3A {
        tangent.cross(radial) * self.onward.y - tangent * self.onward.x
    }
}

/// Whether a branch of this radius has a collar.
pub fn has_collar(radius_m: f32, sides: &Sides) -> bool {
    radius_m * (COLLAR - 1.0) > 0.5 * sides.tolerance_m
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
                rings.push(Ring { sides: below.sides, ..at(path, open.high_m, least) });
                while next < last && path[next].arc_m < open.high_m + step {
                    next += 1;
                }
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
            rings.push(Ring { sides: below.sides, ..at(path, split, least) });
            while next < last && path[next].arc_m < split + step {
                next += 1;
            }
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
    use super::super::path::{Foot, Scratch, Stem, rings};
    use super::*;

    #[test]
    fn angles_are_those_of_the_library() {
        for k in -3141..3142 {
            let turn = k as f32 * 0.001;
            let (y, x) = turn.sin_cos();
            assert!((angle(x * 0.01, y * 0.01) - turn).abs() < 3e-4, "{turn}");
        }
        assert_eq!(angle(0.0, 0.0), 0.0);
    }

    /// On one segment as over several, and where the way begins outside.
    #[test]
    fn a_way_leaves_the_bark_where_its_distance_is_the_radius() {
        let knots = [[0.0, 0.3], [1.0, 0.2], [2.5, 0.15], [4.0, 0.0]];
        let ring = |[z, radius_m]: [f32; 2]| Ring {
            centre: Vec3::Z * z,
            tangent: Vec3::Z,
            normal: Vec3::X,
            radius_m,
            arc_m: z,
            slope: 0.0,
            sides: 8,
            lobe: 0.0,
            girth: 1.0,
            repeats: 1.0,
            u: 0.0,
            v: 0.0,
            bark: 0,
        };
        let path = knots.map(ring);
        let mut found = 0;
        for k in 0..400 {
            let k = k as f32;
            let from = Vec3A::new(0.05 * (k * 1.7).sin(), 0.05 * k.cos(), 0.1 + 0.007 * k);
            let way = Vec3A::new((0.9 * k).sin(), (0.7 * k).cos(), (0.3 * k).sin()) * 0.8;
            let end = nearest(&path, 0, from + way);
            let near = search(&path, 0, from, way, 1e-3);
            if let Some((t, place)) = outlet(&path, end.segment, from, way) {
                let p = from + way * t;
                let axis = Vec3A::new(0.0, 0.0, p.z);
                assert!((p.distance(axis) - place.radius_m).abs() < 1e-5);
                assert!((near.0 - t).abs() < 0.05, "{t} {}", near.0);
                found += 1;
            }
        }
        assert!(found > 100, "{found}");
        let outside = Vec3A::new(0.5, 0.0, 1.0);
        assert!(outlet(&path, 0, outside, Vec3A::X).is_none());
        assert_eq!(search(&path, 0, outside, Vec3A::X, 1e-3).0, 0.0);
    }

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
