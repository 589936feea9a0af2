//! An axis of a skeleton as a path of rings: the radii of P18, needless nodes left out within a
//! tolerance, a collar where a branch leaves its parent, a flare at the ground.
//!
//! Departures from P18: cones share their rings, so that an axis is one smooth tube; the radius
//! at a shared base is the mean of the two nodes, as there. Limits: at a bend sharper than the
//! radius, rings may pass through each other (the tube stays closed).
//!
//! Frames go by parallel transport (Bishop 1975: There is more than one way to frame a curve).

use glam::{Quat, Vec3};

use super::leave::COLLAR_END;

/// Least radius of a ring, and least distance between rings, metres; both grow with the distance
/// from the origin so that f32 still tells the corners apart.
const LEAST_RADIUS_M: f32 = 5e-4;
const LEAST_STEP_M: f32 = 2e-3;
/// Sides of the roundest and the plainest ring.
pub const MAX_SIDES: u32 = 64;
pub const MIN_SIDES: u32 = 3;
/// Radius of a stem over that of its foot down to which it has a trunk's sides.
const THICK: f32 = 0.5;
/// Radius of a foot from which on a stem is a trunk.
const TRUNK_M: f32 = 0.02;

/// How true a stem is: it is what one sees change from level to level.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stem {
    /// Sides of a trunk at least: with fewer its width would change with the side it is seen from.
    pub sides: u32,
    /// How far its radius may be off, share of it.
    pub off: f32,
    /// How far its axis may be, share of the radius.
    pub aside: f32,
}

impl Stem {
    /// Looked at from near.
    pub const NEAR: Stem = Stem { off: 0.05, ..Stem::TRUE };
    pub const TRUE: Stem = Stem { sides: 6, off: 0.08, aside: 0.35 };
    /// Where a true one would leave no triangles for a crown.
    pub const PLAIN: Stem = Stem { sides: 4, off: 0.25, aside: 1.0 };
}

/// How much thicker a tube of `n` sides is to be to look, from all around, as wide as a round one.
fn as_wide(n: u32) -> f32 {
    let half = std::f32::consts::PI / n as f32;
    half / half.sin()
}

/// Height of a stem's flare, in radii of its foot.
pub const FLARE: f32 = 4.5;
/// How much wider it is at the ground, and by how much its lobes stand out there.
pub const FLARED: f32 = 0.42;
pub const LOBED: f32 = 0.2;
/// By how much wider lobes look from the side, on the mean: times the square of how far they stand out.
const LOBES_SEEN: f32 = 2.4;
/// How much wider still where it ends below ground.
pub const BURIED: f32 = 1.12;
/// How far a stem goes on below ground, so that no slope shows its end.
pub const BELOW_GROUND_M: f32 = 0.3;
/// Rings where two barks mix, without and with detail; none in stems that are off by more than this share of their
/// foot.
const MIXED_RINGS: [u32; 2] = [3, 12];
const ROUGH: f32 = 0.1;
/// Nodes that one straight piece may replace.
const SPAN: usize = 24;

/// A cross-section of a tube.
#[derive(Debug, Clone, Copy)]
pub struct Ring {
    pub centre: Vec3,
    /// Unit; the tube's direction here.
    pub tangent: Vec3,
    /// Unit, at right angles to `tangent`; carried along without twist.
    pub normal: Vec3,
    pub radius_m: f32,
    /// Arc length from the axis' base.
    pub arc_m: f32,
    /// Change of radius over arc length.
    pub slope: f32,
    pub sides: u32,
    /// Amplitude of buttress lobes, share of the radius.
    pub lobe: f32,
    /// Tiles of bark around, to scale; and as a whole number.
    pub girth: f32,
    pub repeats: f32,
    /// Where its bark begins, and tiles of bark along.
    pub u: f32,
    pub v: f32,
    /// Which bark it and the band below have, but for twigs.
    pub bark: usize,
}

impl Ring {
    /// The corner where bark that is laid there and back turns.
    pub fn fold(&self) -> u32 {
        fold(self.sides)
    }

    /// Unit; at right angles to `tangent` and `normal`.
    pub fn binormal(&self) -> Vec3 {
        self.tangent.cross(self.normal)
    }
}

/// As [`Ring::fold`], by the number of sides.
pub fn fold(sides: u32) -> u32 {
    sides.div_ceil(2)
}

/// What f32 still tells apart at this distance from the origin.
#[derive(Debug, Clone, Copy)]
pub struct Least {
    pub radius_m: f32,
    pub step_m: f32,
}

impl Least {
    pub fn within(reach_m: f32) -> Least {
        Least {
            radius_m: LEAST_RADIUS_M.max(reach_m * 1e-5),
            step_m: LEAST_STEP_M.max(reach_m * 2e-5),
        }
    }
}

/// How an axis begins.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Foot {
    /// In the ground; rings enough where between these radii, metres, its bark gives way to that of twigs. One of
    /// many stems may be plainer.
    Ground { mixed_m: Option<[f32; 2]>, is_one_of_many: bool },
    /// On the axis of a parent of this radius and direction; the tubes pass through each other.
    Inside { parent_radius_m: f32, parent_direction: Vec3 },
    /// Out of a hole in the parent's bark.
    Collar(Start),
}

/// Where a branch leaves the bark of its parent.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Start {
    pub at: Vec3,
    /// Unit: out of the parent's bark; the branch's way; in the bark, square to that.
    pub away: Vec3,
    pub direction: Vec3,
    pub across: Vec3,
    /// Arc length of the branch up to here, from its parent's axis.
    pub arc_m: f32,
    pub radius_m: f32,
    /// Half the width of the hole.
    pub wide_m: f32,
    /// How far out a ring stands clear of the bark.
    pub rise_m: f32,
    /// A twig goes straight into its parent.
    pub has_collar: bool,
    /// Corners of the hole.
    pub sides: u32,
}

#[cfg(test)]
impl Start {
    /// A branch along x, a tenth of a metre thick, with so many corners about its foot.
    pub fn along_x(sides: u32) -> Start {
        Start {
            at: Vec3::ZERO,
            away: Vec3::X,
            direction: Vec3::X,
            across: Vec3::Y,
            arc_m: 0.0,
            radius_m: 0.1,
            wide_m: 0.1,
            rise_m: 0.1,
            has_collar: true,
            sides,
        }
    }
}

/// A point of the path before it is a ring.
#[derive(Debug, Clone, Copy)]
pub struct Knot {
    pub at: Vec3,
    pub radius_m: f32,
}

/// Fewest sides, 3…64, whose sagitta r(1 − cos(π/N)) stays within a tolerance.
#[derive(Debug, Clone)]
pub struct Sides {
    pub tolerance_m: f32,
    pub stem: Stem,
    /// Greatest radius for 3, 4, … sides.
    radius_m: [f32; (MAX_SIDES - MIN_SIDES) as usize],
    /// Sagitta over radius, by the number of sides.
    depth: [f32; MAX_SIDES as usize + 1],
}

impl Sides {
    pub fn new(tolerance_m: f32, stem: Stem) -> Sides {
        let depth = |sides: usize| {
            // 1 − cos x = 2 sin² (x / 2), without cancelling.
            let sine = (0.5 * std::f32::consts::PI / sides.max(1) as f32).sin();
            2.0 * sine * sine
        };
        Sides {
            tolerance_m,
            stem,
            radius_m: std::array::from_fn(|k| tolerance_m / depth(k + MIN_SIDES as usize)),
            depth: std::array::from_fn(depth),
        }
    }

    pub fn of(&self, radius_m: f32) -> u32 {
        // Most wood is thin.
        if radius_m <= self.radius_m[0] {
            return MIN_SIDES;
        }
        MIN_SIDES + self.radius_m.partition_point(|&r| r < radius_m) as u32
    }

    /// Of a stem whose foot has this radius.
    pub fn of_stem(&self, radius_m: f32, foot_m: f32) -> u32 {
        let is_trunk = foot_m >= TRUNK_M && radius_m >= THICK * foot_m;
        let least = if is_trunk { self.stem.sides } else { MIN_SIDES };
        self.of(radius_m).max(least)
    }

    /// The greatest sagitta of rings, metres, and the sides that leave it.
    pub fn sagitta(&self, rings: &[Ring]) -> (f32, u32) {
        let of = |r: &Ring| (r.radius_m * self.depth[r.sides.min(MAX_SIDES) as usize], r.sides);
        rings.iter().map(of).fold((0.0, 0), |a, b| if b.0 > a.0 { b } else { a })
    }
}

/// Reused between axes.
#[derive(Default)]
pub struct Scratch {
    path: Vec<Knot>,
    lobes: Vec<f32>,
}

/// Turns the knots of one axis, as [`simplify`] leaves them, into rings, appended to `out`; the
/// last ring is the apex, a point. Returns the arc length from the first ring to the first knot,
/// negative where the axis starts past it. Appends nothing where the axis has no length.
pub fn rings(
    kept: &[Knot],
    foot: Foot,
    least: Least,
    sides: &Sides,
    detail: bool,
    scratch: &mut Scratch,
    out: &mut Vec<Ring>,
) -> f32 {
    if kept.len() < 2 {
        return 0.0;
    }
    let tolerance_m = sides.tolerance_m;
    let Scratch { path, lobes } = scratch;
    path.clear();
    lobes.clear();
    let (mut shift, mut across, mut most_sides) = (0.0, None, MAX_SIDES);
    match foot {
        Foot::Ground { mixed_m, is_one_of_many } => {
            path.extend_from_slice(kept);
            let is_rough = tolerance_m > ROUGH * kept[0].radius_m;
            let thin = mixed_m.filter(|_| !is_rough).and_then(|[from, to]| {
                let at = |radius_m: f32| thins_m(path, radius_m);
                Some([at(from)?, at(to)?])
            });
            if let Some([low, high]) = thin {
                let rings = MIXED_RINGS[usize::from(detail)];
                for k in 0..rings {
                    let t = (k as f32 + 0.5) / rings as f32;
                    insert(path, low + (high - low) * t, least.step_m, |r| r);
                }
            }
            if is_one_of_many && is_rough {
                path.iter_mut().for_each(|k| k.radius_m *= as_wide(sides.of(k.radius_m)));
                shift = sink(path);
            } else {
                flare(path, lobes, least.step_m, detail);
                shift = path[0].at.distance(path[1].at);
            }
        }
        Foot::Inside { parent_radius_m, parent_direction } => {
            path.extend_from_slice(kept);
            collar(path, parent_radius_m, parent_direction, tolerance_m, least.step_m);
        }
        Foot::Collar(start) => {
            leave(kept, &start, least.step_m, path);
            shift = -start.arc_m;
            across = Some(start.across);
            most_sides = start.sides;
        }
    }
    blunt(path, tolerance_m, least.step_m);
    let start = out.len();
    frames(path, lobes, least, sides, across, out);
    if across.is_some() {
        // The first has the most.
        if out[start].sides > most_sides {
            out[start..].iter_mut().for_each(|r| r.sides = r.sides.min(most_sides));
        }
        out[start].sides = most_sides;
    }
    if let Foot::Ground { is_one_of_many: false, .. } = foot {
        for r in &mut out[start..] {
            r.sides = r.sides.max(sides.of_stem(r.radius_m, kept[0].radius_m));
        }
    }
    if let Foot::Ground { mixed_m: Some([a, b]), .. } = foot {
        // The line between two barks winds through facets: bands of one number of sides.
        for i in start + 1..out.len() {
            if (a.min(b)..=a.max(b)).contains(&out[i].radius_m) {
                out[i].sides = out[i - 1].sides;
            }
        }
    }
    shift
}

/// The path of a branch from its hole on, with a collar where it has one.
fn leave(kept: &[Knot], start: &Start, least_step: f32, path: &mut Vec<Knot>) {
    let r = start.radius_m;
    path.push(Knot { at: start.at, radius_m: start.wide_m });
    let mut from = start.arc_m + start.rise_m;
    // A foot that gave way to another takes the branch along, less and less, and not its tip where
    // there is room for that.
    let moved = locate(kept, start.arc_m).map_or(Vec3::ZERO, |(_, k)| start.at - k.at);
    let moved_m = moved.length();
    let whole_m = kept[0].at.distance(kept[kept.len() - 1].at);
    let reach = (8.0 * moved_m).min(0.8 * whole_m).max(3.0 * moved_m).max(1e-9);
    let shifted = |at: Vec3, arc: f32| {
        let left = (1.0 - (arc - start.arc_m) / reach).clamp(0.0, 1.0);
        at + moved * (left * left)
    };
    if start.has_collar {
        let length: f32 = kept.windows(2).map(|w| w[0].at.distance(w[1].at)).sum();
        let lean = start.direction.dot(start.away);
        let least_height_m = r * (0.1 + (1.0 - lean * lean).max(0.0).sqrt());
        for (rise, wide) in [(start.rise_m, COLLAR_END), (start.rise_m + 1.6 * r, 1.0)] {
            let arc = start.arc_m + rise;
            let Some((_, k)) = locate(kept, arc).filter(|_| arc + r < length) else { continue };
            let at = shifted(k.at, arc);
            // A moved foot may lie where its branch would go on within the parent.
            let low_m = least_height_m - (at - start.at).dot(start.away);
            let at = at + start.away * low_m.max(0.0);
            if at.distance(path[path.len() - 1].at) > 2.0 * least_step {
                path.push(Knot { at, radius_m: k.radius_m * wide });
                from = arc;
            }
        }
    }
    let mut walked = 0.0;
    for w in kept.windows(2) {
        walked += w[0].at.distance(w[1].at);
        let at = shifted(w[1].at, walked);
        let room = at.distance(path[path.len() - 1].at);
        if walked > from + least_step && room > least_step {
            path.push(Knot { at, ..w[1] });
        }
    }
    if let ([only], Some(tip)) = (&path[..], kept.last()) {
        let outward = (tip.at - only.at).try_normalize().unwrap_or(start.away);
        let at = only.at + outward.normalize_or(Vec3::X) * (2.0 * least_step);
        path.push(Knot { at, radius_m: tip.radius_m });
    }
}

/// How far what is left may be from what was there.
#[derive(Debug, Clone, Copy)]
pub struct Off {
    pub most_m: f32,
    /// Of a radius and of an axis too: shares of the radius or, where that is less, of `thick_m`.
    pub share: f32,
    pub aside: f32,
    pub thick_m: f32,
}

impl Off {
    pub fn by(most_m: f32) -> Off {
        Off { most_m, share: f32::INFINITY, aside: f32::INFINITY, thick_m: 1.0 }
    }
}

/// Leaves out knots that a straight cone replaces, and knots too close to tell
/// apart. First and last stay. Appends the rest to `kept`, and to `arc` how far along them each
/// knot lies.
pub fn simplify(
    knots: &[Knot],
    off: Off,
    least_step: f32,
    kept: &mut Vec<Knot>,
    arc: &mut Vec<f32>,
) {
    let Some(&first) = knots.first() else { return };
    let start = kept.len();
    kept.push(first);
    arc.push(0.0);
    let mut walked = 0.0;
    let mut from = 0;
    while from + 1 < knots.len() {
        let mut to = from + 1;
        while to + 1 < knots.len() && to - from < SPAN && straight(knots, from, to + 1, off) {
            to += 1;
        }
        let before = kept[kept.len() - 1];
        let chord = knots[to].at - before.at;
        let length = chord.length();
        let along = |k: &Knot| (k.at - before.at).dot(chord) / length.max(1e-12);
        arc.extend(knots[from + 1..=to].iter().map(|k| walked + along(k).clamp(0.0, length)));
        let last = to + 1 == knots.len();
        if length >= least_step {
            kept.push(knots[to]);
            walked += length;
        } else if last && kept.len() > start + 1 {
            // The tip wins over the knot before it, where that leaves room.
            let earlier = kept[kept.len() - 2];
            if earlier.at.distance(knots[to].at) >= least_step {
                kept.pop();
                kept.push(knots[to]);
            }
        }
        from = to;
    }
    if kept.len() == start + 1 {
        kept.pop();
    }
}

fn straight(knots: &[Knot], from: usize, to: usize, off: Off) -> bool {
    let (a, b) = (knots[from], knots[to]);
    let chord = b.at - a.at;
    let length_sq = chord.length_squared();
    knots[from + 1..to].iter().all(|k| {
        let t = if length_sq > 0.0 { (k.at - a.at).dot(chord) / length_sq } else { 0.0 };
        let inside = (0.0..=1.0).contains(&t);
        let cone = a.radius_m + (b.radius_m - a.radius_m) * t;
        let thick_m = k.radius_m.max(off.thick_m);
        let aside_m = off.most_m.min(off.aside * thick_m);
        inside
            && (k.at - a.at - chord * t).length_squared() <= aside_m * aside_m
            && (k.radius_m - cone).abs() <= off.most_m.min(off.share * thick_m)
    })
}

/// The place `arc_m` along the path: the knot to insert before, and what lies there.
fn locate(kept: &[Knot], arc_m: f32) -> Option<(usize, Knot)> {
    let mut walked = 0.0;
    for i in 1..kept.len() {
        let (a, b) = (kept[i - 1], kept[i]);
        let step = a.at.distance(b.at);
        if arc_m <= walked + step {
            let t = (arc_m - walked) / step.max(1e-12);
            let radius_m = a.radius_m + (b.radius_m - a.radius_m) * t;
            return Some((i, Knot { at: a.at.lerp(b.at, t), radius_m }));
        }
        walked += step;
    }
    None
}

/// Arc length at which a path is as thin as that, where it is thicker before.
fn thins_m(kept: &[Knot], radius_m: f32) -> Option<f32> {
    let mut walked = 0.0;
    for w in kept.windows(2) {
        let (a, b) = (w[0], w[1]);
        let step = a.at.distance(b.at);
        if a.radius_m > radius_m && b.radius_m <= radius_m {
            return Some(walked + step * (a.radius_m - radius_m) / (a.radius_m - b.radius_m));
        }
        walked += step;
    }
    None
}

/// Inserts a knot of its own radius (from the radius found there), unless another is too close.
fn insert(
    kept: &mut Vec<Knot>,
    arc_m: f32,
    least_step: f32,
    radius: impl Fn(f32) -> f32,
) -> Option<usize> {
    let (i, found) = locate(kept, arc_m)?;
    if found.at.distance(kept[i - 1].at) < 2.0 * least_step
        || found.at.distance(kept[i].at) < 2.0 * least_step
    {
        return None;
    }
    kept.insert(i, Knot { at: found.at, radius_m: radius(found.radius_m) });
    Some(i)
}

/// A branch starts on its parent's axis and is wider where it leaves the bark.
fn collar(
    kept: &mut Vec<Knot>,
    parent_radius_m: f32,
    parent_direction: Vec3,
    tolerance_m: f32,
    least_step: f32,
) {
    let radius = kept[0].radius_m.min(parent_radius_m);
    kept[0].radius_m = radius;
    let length: f32 = kept.windows(2).map(|w| w[0].at.distance(w[1].at)).sum();
    let direction = (kept[1].at - kept[0].at).normalize_or_zero();
    let across = direction.cross(parent_direction).length().max(0.5);
    let bark = parent_radius_m / across;
    let wide = (radius * 1.4).min(parent_radius_m * 0.95).max(radius);
    let end = bark + 2.2 * radius;
    if wide - radius < 0.5 * tolerance_m || end > 0.7 * length {
        return;
    }
    insert(kept, end, least_step, |r| r);
    insert(kept, bark + 0.7 * radius, least_step, |r| (0.4 * wide + 0.6 * r).max(r));
    insert(kept, 0.92 * bark, least_step, |r| wide.max(r));
    kept[0].radius_m = wide;
}

fn length_m(kept: &[Knot]) -> f32 {
    kept.windows(2).map(|w| w[0].at.distance(w[1].at)).sum()
}

/// A stem widens towards the ground, in lobes, and goes on below it.
fn flare(kept: &mut Vec<Knot>, lobes: &mut Vec<f32>, least_step: f32, detail: bool) {
    let radius = kept[0].radius_m;
    let length = length_m(kept);
    let height = (FLARE * radius).min(0.25 * length);
    let shares: &[f32] = if detail { &[1.0, 0.6, 0.32, 0.14] } else { &[1.0, 0.3] };
    for &s in shares {
        insert(kept, s * height, least_step, |r| r);
    }
    let mut walked = 0.0;
    let mut last = kept[0].at;
    for k in kept.iter_mut() {
        walked += k.at.distance(last);
        last = k.at;
        let up = 1.0 - (walked / height.max(1e-6)).min(1.0);
        let lobe = LOBED * up * up;
        k.radius_m *= 1.0 + FLARED * up * up * up;
        if !detail {
            k.radius_m *= 1.0 + LOBES_SEEN * lobe * lobe;
        }
        lobes.push(if detail { lobe } else { 0.0 });
    }
    let depth = depth_m(kept[0].at, length).max(2.0 * least_step);
    let base = kept[0];
    kept.insert(0, Knot { at: base.at - Vec3::Z * depth, radius_m: base.radius_m * BURIED });
    if let Some(&first) = lobes.first() {
        lobes.insert(0, first);
    }
}

/// A stem without a flare goes on below the ground the way it comes out of it; gives how far.
fn sink(kept: &mut [Knot]) -> f32 {
    let depth_m = depth_m(kept[0].at, length_m(kept));
    let [foot, next, ..] = kept else { return 0.0 };
    let along = (next.at - foot.at).normalize_or(Vec3::Z);
    // One that lies goes down steeper than it comes.
    let down = along.with_z(along.z.max(LEAST_RISE)).normalize_or(Vec3::Z);
    let depth = depth_m / down.z;
    foot.at -= down * depth;
    depth
}

/// How deep a stem of this length goes, whose root collar is the origin: deeper beside that, for slopes.
fn depth_m(foot: Vec3, length_m: f32) -> f32 {
    BELOW_GROUND_M.min(0.1 * length_m) + foot.truncate().length()
}

/// Sine of the least rise of a stem below the ground.
const LEAST_RISE: f32 = 0.5;

/// A tip that is too thick for a point gets a short cone on top.
fn blunt(kept: &mut Vec<Knot>, tolerance_m: f32, least_step: f32) {
    let n = kept.len();
    let (before, tip) = (kept[n - 2], kept[n - 1]);
    if tip.radius_m > (2.0 * tolerance_m).max(0.012) {
        let direction = (tip.at - before.at).normalize_or(Vec3::Z);
        let rise = (0.6 * tip.radius_m).max(least_step);
        kept.push(Knot { at: tip.at + direction * rise, radius_m: 0.0 });
    }
}

/// Tangents as bisectors, normals by the least turn from ring to ring (parallel transport). A
/// reversal turns in two steps of a right angle, so that no ring is mirrored.
fn frames(
    kept: &[Knot],
    lobes: &[f32],
    least: Least,
    sides: &Sides,
    across: Option<Vec3>,
    out: &mut Vec<Ring>,
) {
    let n = kept.len();
    let start = out.len();
    let step = |i: usize| {
        let step = kept[i + 1].at - kept[i].at;
        let length = step.length();
        let inverse = length.recip();
        (if inverse.is_finite() { step * inverse } else { Vec3::Z }, length)
    };
    let (mut onward, mut onward_m) = step(0);
    let mut tangent = onward;
    // A branch's corners begin at the end of its hole that it leans over.
    let side = across.and_then(|e| (tangent * tangent.dot(e) - e).try_normalize());
    let mut normal = match side {
        Some(side) => side.cross(tangent),
        None => tangent.any_orthonormal_vector(),
    };
    let mut arc = 0.0;
    out.reserve(n);
    for (i, knot) in kept.iter().enumerate() {
        if i > 0 {
            arc += onward_m;
            let from = onward;
            let mut next = from;
            if i + 1 < n {
                (onward, onward_m) = step(i);
                let sum = from + onward;
                next = if sum.length_squared() > 1e-4 {
                    sum.normalize()
                } else {
                    let across = tangent - from * tangent.dot(from);
                    if across.length_squared() > 0.01 { across.normalize() } else { normal }
                };
            }
            // The turn from one tangent to the next, without a quaternion: both are at right angles
            // to its axis, and the normal to the first.
            let cosine = next.dot(tangent);
            let carried = if cosine > 0.9999 {
                normal
            } else if cosine > -0.99 {
                normal - (tangent + next) * (next.dot(normal) / (1.0 + cosine))
            } else {
                Quat::from_rotation_arc(tangent, next) * normal
            };
            let flat = carried - next * carried.dot(next);
            // All but unit: a step of Newton's method spares a root.
            let off = 1.0 - flat.length_squared();
            normal = if off.abs() < 0.01 {
                flat * (1.0 + 0.5 * off)
            } else {
                flat.try_normalize().unwrap_or_else(|| next.any_orthonormal_vector())
            };
            tangent = next;
        }
        let lobe = lobes.get(i).copied().unwrap_or(0.0);
        // Five lobes need about five corners each.
        let least_sides = if lobe > 0.02 { 24 } else { MIN_SIDES };
        let radius_m = knot.radius_m.max(least.radius_m);
        out.push(Ring {
            centre: knot.at,
            tangent,
            normal,
            radius_m,
            arc_m: arc,
            slope: 0.0,
            sides: sides.of(radius_m).max(least_sides),
            lobe,
            girth: 1.0,
            repeats: 1.0,
            u: 0.0,
            v: 0.0,
            bark: 0,
        });
    }
    let rings = &mut out[start..];
    let last = n - 1;
    rings[last].radius_m = 0.0;
    // From the tip down: never fewer sides below, and a change only where it saves a quarter.
    let mut most = MIN_SIDES;
    for ring in rings[..last].iter_mut().rev() {
        most = most.max(ring.sides);
        ring.sides = most;
    }
    let slope = |a: &Ring, b: &Ring| {
        ((b.radius_m - a.radius_m) / (b.arc_m - a.arc_m).max(1e-6)).clamp(-2.0, 2.0)
    };
    rings[0].slope = slope(&rings[0], &rings[1]);
    for i in 1..last {
        let below = rings[i - 1].sides;
        if rings[i].sides * 4 > below * 3 {
            rings[i].sides = below;
        }
        rings[i].slope = slope(&rings[i - 1], &rings[i + 1]);
    }
    rings[last].sides = rings[last - 1].sides;
    rings[last].slope = slope(&rings[last - 1], &rings[last]);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sides_are_the_fewest_within_the_sagitta() {
        for tolerance in [1e-4f32, 1e-3, 5e-3] {
            for k in 1..200 {
                let r = k as f32 * 0.002;
                let n = Sides::new(tolerance, Stem::TRUE).of(r);
                let sagitta = |n: u32| r * (1.0 - (std::f32::consts::PI / n as f32).cos());
                assert!(n == MAX_SIDES || sagitta(n) <= tolerance * 1.001, "{r} {n}");
                assert!(n == MIN_SIDES || sagitta(n - 1) > tolerance * 0.999, "{r} {n}");
            }
        }
        assert_eq!(Sides::new(1e-3, Stem::TRUE).of(1e3), MAX_SIDES);
        assert_eq!(Sides::new(1e-3, Stem::TRUE).of(1e-6), MIN_SIDES);
    }

    fn path(points: &[Vec3], tolerance: f32) -> Vec<Ring> {
        let knots: Vec<Knot> = points.iter().map(|&at| Knot { at, radius_m: 0.02 }).collect();
        let (mut kept, mut arc, mut out) = (Vec::new(), Vec::new(), Vec::new());
        let foot = Foot::Inside { parent_radius_m: 0.02, parent_direction: Vec3::X };
        let least = Least::within(0.0);
        simplify(&knots, Off::by(tolerance), least.step_m, &mut kept, &mut arc);
        assert_eq!(arc.len(), knots.len());
        rings(
            &kept,
            foot,
            least,
            &Sides::new(tolerance, Stem::TRUE),
            true,
            &mut Scratch::default(),
            &mut out,
        );
        out
    }

    /// The line between barks winds through facets of about their width, not along them.
    #[test]
    fn rings_stand_close_where_twig_bark_begins_on_a_stem() {
        let kept = [0.0, 10.0].map(|z| Knot { at: Vec3::Z * z, radius_m: 0.1 - 0.01 * z });
        let mixed_m = Some([0.05, 0.03]);
        let mut out = Vec::new();
        rings(
            &kept,
            Foot::Ground { mixed_m, is_one_of_many: false },
            Least::within(10.0),
            &Sides::new(0.001, Stem::TRUE),
            true,
            &mut Scratch::default(),
            &mut out,
        );
        // From 5 m to 7 m.
        let within: Vec<&Ring> = out.iter().filter(|r| (5.0..7.0).contains(&r.centre.z)).collect();
        assert_eq!(within.len(), 12);
        assert!(within.windows(2).all(|w| w[1].centre.z - w[0].centre.z < 0.2));
        assert!(within.iter().all(|r| r.sides == within[0].sides && r.sides >= 6));
    }

    #[test]
    fn frames_are_orthonormal_and_do_not_twist() {
        // A flat arc: the normal keeps its angle to the plane.
        let arc: Vec<Vec3> = (0..40)
            .map(|k| {
                let (s, c) = (k as f32 * 0.1).sin_cos();
                Vec3::new(s, 0.0, 1.0 - c)
            })
            .collect();
        let rings = path(&arc, 1e-5);
        let tilt = rings[0].normal.y;
        for r in &rings {
            assert!((r.normal.length() - 1.0).abs() < 1e-5);
            assert!(r.normal.dot(r.tangent).abs() < 1e-5);
            assert!((r.normal.y - tilt).abs() < 1e-3);
        }
    }

    #[test]
    fn a_straight_run_keeps_its_ends_alone() {
        let line: Vec<Vec3> = (0..20).map(|k| Vec3::new(0.0, 0.0, k as f32)).collect();
        assert_eq!(path(&line, 1e-3).len(), 3, "base, tip and the cone on the tip");
    }

    #[test]
    fn a_reversal_and_standing_still_give_sound_frames() {
        let back = [0.0, 1.0, 0.0, 1.0, 1.0, 1.0].map(|z| Vec3::new(0.0, 0.0, z));
        let rings = path(&back, 1e-3);
        for w in rings.windows(2) {
            assert!(w[0].centre.distance(w[1].centre) >= LEAST_STEP_M);
            assert!(w[0].tangent.dot(w[1].tangent) > -0.5, "a ring is never mirrored");
        }
        assert!(path(&[Vec3::ONE; 5], 1e-3).is_empty());
    }
}
