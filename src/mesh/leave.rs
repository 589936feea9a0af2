//! Where a branch leaves the bark of its parent, and how it stands there: its line's way out of the
//! parent's cones, and the ellipse about that place that is its foot, long the way the branch leans.
//! A branch that never leaves the bark by more than its collar has none.

use std::f32::consts::{FRAC_PI_2, PI};

use glam::{Vec2, Vec3, Vec3A};

use super::path::{Knot, Least, Ring, Sides, Start};

/// Flare of a collar, and of a twig too thin for one: width of the hole over the branch's.
const COLLAR: f32 = 1.45;
const NO_COLLAR: f32 = 1.1;
/// Width of the ring that ends it, over the branch's.
pub const COLLAR_END: f32 = 1.1;
/// A foot is longer than wide by no more than the inverse.
const LEAST_LEAN: f32 = 0.45;

/// Near enough to the bark, in the branch's radii: its foot is laid onto it.
const ON_BARK: f32 = 0.05;

/// A branch's foot on its parent's path.
#[derive(Debug, Clone, Copy)]
pub struct Branch {
    pub child: u32,
    /// Which of two alike goes first.
    pub rank: u32,
    /// Middle and half length of the foot along the parent.
    pub arc_m: f32,
    pub half_m: f32,
    /// Angle of the middle from the frame's normal, −π…π, and half width as an angle.
    pub turn: f32,
    pub half_turn: f32,
    pub start: Start,
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
    // Never back: it comes to an end.
    for _ in 0..path.len() {
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

/// How a branch stands on the bark of its parent.
pub struct Stance {
    /// Cosine of the angle between it and the bark's normal.
    lean: f32,
    /// Unit; the way it leans, around the parent and along it.
    onward: Vec2,
}

impl Stance {
    pub fn of(direction: Vec3A, tangent: Vec3A, radial: Vec3A) -> Stance {
        let around = tangent.cross(radial);
        let onward = Vec2::new(direction.dot(around), direction.dot(tangent));
        let length = onward.length();
        let onward = if length > 0.05 { onward / length } else { Vec2::Y };
        Stance { lean: direction.dot(radial), onward }
    }

    /// Its foot over the width of its collar: where a corner of the unit circle lies around and
    /// along the parent. The first corner is the one it leans over.
    pub fn foot(&self) -> [Vec2; 2] {
        let Vec2 { x: around, y: along } = self.onward;
        let long = self.lean.clamp(LEAST_LEAN, 1.0).recip();
        [Vec2::new(long * around, -along), Vec2::new(long * along, around)]
    }

    /// How far along the branch a ring is clear of the bark and of the collar.
    pub fn rise_m(&self, radius_m: f32, wide_m: f32) -> f32 {
        let lean = self.lean.clamp(0.22, 1.0);
        let reach_m = (wide_m / lean.max(LEAST_LEAN)).max(radius_m / lean);
        0.5 * radius_m + reach_m * (1.0 - lean * lean).sqrt()
    }

    /// Unit; at right angles to the branch, in the bark.
    pub fn across(&self, tangent: Vec3A, radial: Vec3A) -> Vec3A {
        tangent.cross(radial) * self.onward.y - tangent * self.onward.x
    }
}

/// Whether a branch of this radius has a collar.
pub fn has_collar(radius_m: f32, sides: &Sides) -> bool {
    radius_m * (COLLAR - 1.0) > 0.5 * sides.tolerance_m
}

#[cfg(test)]
mod tests {
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
}
