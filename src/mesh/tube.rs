//! Rings to triangles: one closed tube an axis, P18's truncated cones with shared rings.
//!
//! The rings' circles come from tables, so a vertex costs no trigonometry. A ring of N sides has
//! N + 1 vertices: the first and the last lie in one place and part the texture. The foot of a
//! branch is a hole in the facets of one band (see `junction`); its corners are the first ring of
//! the branch.
//! Where old bark gives way to young bark, facets of both mix and their rings are in both
//! surfaces; together the two are closed.

use std::f32::consts::TAU;

use glam::{Vec2, Vec3};

use super::Surface;
use super::junction::{Hole, mask};
use super::path::{MAX_SIDES, Ring};
use crate::seed::Draws;

/// Cosines and sines of the corners of every ring.
pub struct Circles(Vec<Vec<Vec2>>);

impl Circles {
    pub fn new() -> Self {
        Circles(
            (0..=MAX_SIDES)
                .map(|n| {
                    (0..=n)
                        .map(|k| {
                            // The last corner is the first, to the bit.
                            let turn = (k % n.max(1)) as f32 / n.max(1) as f32;
                            let (s, c) = (turn * TAU).sin_cos();
                            Vec2::new(c, s)
                        })
                        .collect()
                })
                .collect(),
        )
    }

    fn of(&self, sides: u32) -> &[Vec2] {
        &self.0[sides.min(MAX_SIDES) as usize]
    }
}

/// Triangles and vertices that [`tube`] makes of these rings and holes.
pub fn count(rings: &[Ring], holes: &[Hole], is_welded: bool) -> (usize, usize) {
    let n = rings.len();
    if n < 2 {
        return (0, 0);
    }
    let bands: usize = rings[..n - 1].windows(2).map(|w| (w[0].sides + w[1].sides) as usize).sum();
    let base = if is_welded { 0 } else { rings[0].sides as usize - 2 };
    let around: usize = holes.iter().map(|h| h.start.sides as usize + 2).sum();
    let triangles = bands + base + rings[n - 2].sides as usize + around;
    let vertices = rings[..n - 1].iter().map(|r| r.sides as usize + 1).sum::<usize>() + 1;
    (triangles, vertices + around)
}

/// Texel density, as tiles a tile's length: where thin wood cannot have fewer than one tile
/// around, the tiles grow smaller both ways, down to an eighth.
const DENSITY: [f32; 2] = [0.7, 8.0];
/// Tiles around change where the density is off by more than this factor.
const OFF: f32 = 1.45;

/// Lays bark along a tube: whole tiles around, so that it closes on itself, and as many along as
/// there are around a metre, so that a taper does not stretch it. Where the number around changes,
/// a band shears the bark by half a tile at its seam.
pub fn lay_bark(rings: &mut [Ring], repeat_m: f32) {
    let Some(first) = rings.first() else { return };
    let girth = |radius_m: f32| (radius_m * TAU).max(1e-6) / repeat_m;
    let whole = |girth: f32| girth.round().clamp(1.0, 1024.0);
    let mut below = *first;
    below.repeats = whole(girth(below.radius_m));
    for ring in rings {
        let off = below.repeats / girth(ring.radius_m);
        // The apex is a point.
        let stays = ring.radius_m == 0.0 || off.max(1.0 / off) < OFF;
        ring.repeats = if stays { below.repeats } else { whole(girth(ring.radius_m)) };
        let mean_m = 0.5 * (below.radius_m + ring.radius_m);
        let repeats = 0.5 * (below.repeats + ring.repeats);
        let density = (repeats / girth(mean_m)).clamp(DENSITY[0], DENSITY[1]) / repeat_m;
        ring.v = below.v + (ring.arc_m - below.arc_m) * density;
        below = *ring;
    }
}

/// Where a tube goes: old bark and young bark.
pub struct Barks<'a> {
    pub surface: [&'a mut Surface; 2],
    /// Share of young bark at a ring; between 0 and 1 the facets mix.
    pub young: &'a dyn Fn(&Ring) -> f32,
    /// Draws for that mixing, and the phase of buttresses.
    pub draws: Draws,
}

/// How a tube is joined to others.
pub struct Joints<'a> {
    /// Corners of the hole it comes out of, with the parent's normals; empty where its base is
    /// closed by a fan.
    pub base: &'a [(Vec3, Vec3)],
    /// Whether that hole goes over into the tube by a collar.
    pub is_collar: bool,
    /// Its own holes, in the order of their bands.
    pub holes: &'a [Hole],
    /// The corners of these holes, one after the other.
    pub rims: &'a mut [(Vec3, Vec3)],
}

/// Appends the tube of one axis; the last ring is the apex.
pub fn tube(rings: &[Ring], circles: &Circles, joints: &mut Joints, barks: &mut Barks) {
    let n = rings.len();
    if n < 2 {
        return;
    }
    let phase = barks.draws.between(0.0, TAU);
    let (base, is_collar) = (joints.base, joints.is_collar);
    let (mut holes, mut rims) = (joints.holes, &mut *joints.rims);
    // Where the corners of the last ring start in each surface, once they are there.
    let mut below = [None; 2];
    for i in 0..n - 1 {
        let share = (barks.young)(&rings[i]);
        let mut here = [None; 2];
        let corners_in = |b: usize, i: usize, slot: &mut [Option<u32>; 2], out: &mut Surface| {
            *slot[b].get_or_insert_with(|| {
                let start = out.position.len() as u32;
                let ring = &rings[i];
                if i == 0 && !base.is_empty() {
                    rim(ring, circles.of(ring.sides), base, is_collar, out);
                } else {
                    corners(ring, circles.of(ring.sides), phase, out);
                }
                start
            })
        };
        if i == 0 {
            // The base is closed by a fan: it lies inside the parent or below ground.
            let b = usize::from(share >= 0.5);
            let out = &mut *barks.surface[b];
            let first = corners_in(b, 0, &mut here, out);
            if base.is_empty() {
                for k in 1..rings[0].sides - 1 {
                    out.index.extend([first, first + k + 1, first + k]);
                }
            }
        } else {
            let (sides, next) = (rings[i - 1].sides, rings[i].sides);
            let mixes = share > 0.0 && share < 1.0;
            let side = usize::from(share >= 0.5);
            let count = holes.iter().take_while(|h| h.band as usize == i - 1).count();
            let (opened, rest) = holes.split_at(count);
            holes = rest;
            if count == 0 && !(mixes && sides == next) {
                let out = &mut *barks.surface[side];
                let p = corners_in(side, i - 1, &mut below, out);
                let q = corners_in(side, i, &mut here, out);
                band(p, sides, q, next, &mut out.index);
            } else {
                let taken = opened.iter().fold(0, |m, h| m | mask(h.facet, h.facets, sides));
                for k in (0..sides).filter(|k| taken >> k & 1 == 0) {
                    let b = if mixes { usize::from(barks.draws.unit() < share) } else { side };
                    let out = &mut *barks.surface[b];
                    let p = corners_in(b, i - 1, &mut below, out) + k;
                    let q = corners_in(b, i, &mut here, out) + k;
                    out.index.extend([p, p + 1, q + 1, p, q + 1, q]);
                }
                for hole in opened {
                    let out = &mut *barks.surface[side];
                    let p = corners_in(side, i - 1, &mut below, out);
                    let q = corners_in(side, i, &mut here, out);
                    let (own, others) = rims.split_at_mut(hole.start.sides as usize);
                    fill(hole, [&rings[i - 1], &rings[i]], [p, q], circles, own, out);
                    rims = others;
                }
            }
        }
        if i == n - 2 {
            let b = usize::from(share >= 0.5);
            let out = &mut *barks.surface[b];
            let last = corners_in(b, i, &mut here, out);
            let apex = &rings[n - 1];
            let tip = out.position.len() as u32;
            out.position.push(apex.centre);
            out.normal.push(apex.tangent);
            out.uv.push(Vec2::new(0.0, apex.v));
            for k in 0..rings[i].sides {
                out.index.extend([last + k, last + k + 1, tip]);
            }
        }
        below = here;
    }
}

/// Texture coordinate around, of a corner (or a place between corners).
fn around(ring: &Ring, corner: f32) -> f32 {
    (corner / ring.sides as f32 - 0.5) * ring.repeats
}

/// The first ring of a branch: the corners of its hole. A collar goes over into the parent's
/// bark; a twig keeps its own roundness.
fn rim(ring: &Ring, circle: &[Vec2], base: &[(Vec3, Vec3)], is_collar: bool, out: &mut Surface) {
    let binormal = ring.binormal();
    for (k, c) in circle.iter().enumerate() {
        let (position, parent) = base[k % base.len()];
        let own = ring.normal * c.x + binormal * c.y;
        // In a crotch the branch's side faces the parent: there both count alike.
        let weight = if is_collar { 0.6 - 0.6 * parent.dot(own) } else { 3.0 };
        let normal = (parent + own * weight).normalize_or(own);
        out.position.push(position);
        out.normal.push(normal);
        out.uv.push(Vec2::new(around(ring, k as f32), ring.v));
    }
}

/// Fills a block of facets but for the foot of a branch, whose corners go to `rim`. Both edges are
/// walked in step: all of it lies in the parent's facets.
fn fill(
    hole: &Hole,
    [low, high]: [&Ring; 2],
    [p, q]: [u32; 2],
    circles: &Circles,
    rim: &mut [(Vec3, Vec3)],
    out: &mut Surface,
) {
    let (sides, facets) = (low.sides, hole.facets);
    // Across the seam the block has corners of its own, whose texture goes on.
    let wraps = hole.facet + facets > sides;
    let mut edge = |from: u32, ring: &Ring| -> u32 {
        if !wraps {
            return from + hole.facet;
        }
        let start = out.position.len() as u32;
        for k in 0..=facets {
            let i = (from + (hole.facet + k) % sides) as usize;
            out.position.push(out.position[i]);
            out.normal.push(out.normal[i]);
            out.uv.push(Vec2::new(around(ring, (hole.facet + k) as f32), ring.v));
        }
        start
    };
    let (p, q) = (edge(p, low), edge(q, high));
    let first = out.position.len() as u32;
    let circle = circles.of(hole.start.sides);
    for (corner, c) in rim.iter_mut().zip(circle) {
        let x = hole.x - hole.half_x * c.y;
        let t = hole.t + hole.half_t * c.x;
        let k = (x as u32).min(facets - 1);
        let share = x - k as f32;
        let across = |column: &[Vec3]| {
            let at = |i: u32| column[i as usize];
            let (a, b) =
                (at(p + k).lerp(at(p + k + 1), share), at(q + k).lerp(at(q + k + 1), share));
            a.lerp(b, t)
        };
        let position = across(&out.position);
        let normal = across(&out.normal);
        let normal = normal.try_normalize().unwrap_or(out.normal[(p + k) as usize]);
        *corner = (position, normal);
        let place = hole.facet as f32 + x;
        let u = around(low, place) + (around(high, place) - around(low, place)) * t;
        out.position.push(position);
        out.normal.push(normal);
        out.uv.push(Vec2::new(u, low.v + (high.v - low.v) * t));
    }
    // Both counter-clockwise; the outer edge from its upper right, the inner one from its top. Each
    // inner edge takes the outer corner furthest out as it sees it, which is never hidden (the
    // block is convex and holds the foot), as two calipers turn around.
    let (outer, inner) = (2 * (facets + 1), hole.start.sides);
    let corner = |j: u32| {
        let j = j % outer;
        if j <= facets { q + facets - j } else { p + j - facets - 1 }
    };
    let place = |j: u32| {
        let k = j % outer;
        let (x, t) =
            if k <= facets { ((facets - k) as f32, 1.0) } else { ((k - facets - 1) as f32, 0.0) };
        Vec2::new((x - hole.x) / hole.half_x, (t - hole.t) / hole.half_t)
    };
    let away = |i: u32| {
        let sum = circle[i as usize] + circle[i as usize + 1];
        Vec2::new(-sum.y, sum.x)
    };
    let mut start = 0;
    for j in 1..outer {
        if place(j).dot(away(0)) > place(start).dot(away(0)) {
            start = j;
        }
    }
    let (mut j, last) = (start, start + outer);
    for i in 0..inner {
        while j < last && place(j + 1).dot(away(i)) > place(j).dot(away(i)) {
            out.index.extend([corner(j), corner(j + 1), first + i]);
            j += 1;
        }
        out.index.extend([corner(j), first + (i + 1) % inner, first + i]);
    }
    while j < last {
        out.index.extend([corner(j), corner(j + 1), first]);
        j += 1;
    }
}

fn corners(ring: &Ring, circle: &[Vec2], lobe_phase: f32, out: &mut Surface) {
    let binormal = ring.binormal();
    let lift = 1.0 / (1.0 + ring.slope * ring.slope).sqrt();
    let (flat, rise) = (lift, ring.tangent * (-ring.slope * lift));
    if ring.lobe == 0.0 {
        out.position.extend(
            circle
                .iter()
                .map(|c| ring.centre + (ring.normal * c.x + binormal * c.y) * ring.radius_m),
        );
        out.normal
            .extend(circle.iter().map(|c| (ring.normal * c.x + binormal * c.y) * flat + rise));
    } else {
        // Buttresses, uneven: r(θ) = r (1 + lobe · (¾ cos(5θ + φ) + ½ cos(2θ + 2φ))).
        for (k, c) in circle.iter().enumerate() {
            let turn = (k % ring.sides.max(1) as usize) as f32 / ring.sides as f32;
            let (s5, c5) = (5.0 * turn * TAU + lobe_phase).sin_cos();
            let (s2, c2) = (2.0 * (turn * TAU + lobe_phase)).sin_cos();
            let (out_by, change) = (0.75 * c5 + 0.5 * c2, -3.75 * s5 - s2);
            let out_dir = ring.normal * c.x + binormal * c.y;
            let around = binormal * c.x - ring.normal * c.y;
            let radius = ring.radius_m * (1.0 + ring.lobe * out_by);
            let turned = ring.lobe * change / (1.0 + ring.lobe * out_by);
            out.position.push(ring.centre + out_dir * radius);
            let normal = (out_dir - around * turned) * flat + rise;
            out.normal.push(normal.normalize_or(out_dir));
        }
    }
    out.uv.extend((0..circle.len()).map(|k| Vec2::new(around(ring, k as f32), ring.v)));
}

/// Joins two rings; where their sides differ, by walking both around in step.
fn band(a: u32, a_sides: u32, b: u32, b_sides: u32, index: &mut Vec<u32>) {
    if a_sides == b_sides {
        index.extend((0..a_sides).flat_map(|k| {
            let (p, q) = (a + k, b + k);
            [p, p + 1, q + 1, p, q + 1, q]
        }));
        return;
    }
    let (mut i, mut j) = (0, 0);
    while i < a_sides || j < b_sides {
        // The ring whose next corner comes first goes on: (i + 1) / a against (j + 1) / b.
        let a_next = j == b_sides || (i < a_sides && (i + 1) * b_sides <= (j + 1) * a_sides);
        if a_next {
            index.extend([a + i, a + i + 1, b + j]);
            i += 1;
        } else {
            index.extend([a + i, b + j + 1, b + j]);
            j += 1;
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::super::path::Start;
    use super::*;

    fn ring(z: f32, sides: u32) -> Ring {
        Ring {
            centre: Vec3::Z * z,
            tangent: Vec3::Z,
            normal: Vec3::X,
            radius_m: 1.0,
            arc_m: z,
            slope: 0.0,
            sides,
            lobe: 0.0,
            repeats: 6.0,
            v: z,
        }
    }

    proptest! {
        /// Feet of every shape anywhere in their block: laid flat, the filling covers the block but
        /// for the foot, once.
        #[test]
        fn the_filling_of_a_block_folds_nowhere(
            facet in 0u32..12,
            facets in 1u32..7,
            corners_of_foot in 3u32..24,
            across in 0.0f32..1.0,
            wide in 0.05f32..1.0,
            along in 0.0f32..1.0,
            high in 0.02f32..0.4,
        ) {
            let sides = 12;
            let circles = Circles::new();
            let (low, top) = (ring(0.0, sides), ring(0.7, sides));
            let mut out = Surface::default();
            corners(&low, circles.of(sides), 0.0, &mut out);
            corners(&top, circles.of(sides), 0.0, &mut out);
            let half_x = 0.42 * facets as f32 * wide;
            let room = facets as f32 - 2.0 * (half_x + 0.08);
            let start = Start {
                at: Vec3::ZERO,
                around: Vec3::Y,
                arc_m: 0.0,
                radius_m: 0.1,
                wide_m: 0.1,
                rise_m: 0.1,
                has_collar: true,
                sides: corners_of_foot,
            };
            let x = half_x + 0.08 + room.max(0.0) * across;
            let t = high + 0.06 + (1.0 - 2.0 * (high + 0.06)) * along;
            let hole = Hole::new(facet, facets, [x, half_x], [t, high], start);
            let mut rim = vec![(Vec3::ZERO, Vec3::ZERO); corners_of_foot as usize];
            fill(&hole, [&low, &top], [0, sides + 1], &circles, &mut rim, &mut out);
            prop_assert_eq!(out.triangles() as u32, 2 * facets + 2 + corners_of_foot);
            // The texture coordinates are the tube laid flat.
            let mut sum = 0.0;
            for t in out.index.chunks_exact(3) {
                let [a, b, c] = [0, 1, 2].map(|k| out.uv[t[k] as usize]);
                let area = 0.5 * (b - a).perp_dot(c - a);
                prop_assert!(area > 0.0, "{area}");
                sum += area;
            }
            let n = corners_of_foot as f32;
            let foot = 0.5 * n * (TAU / n).sin() * (half_x * 0.5) * (high * 0.7);
            prop_assert!((sum - (facets as f32 * 0.5 * 0.7 - foot)).abs() < 1e-4);
        }
    }
}
