//! Rings to triangles: one closed tube an axis, P18's truncated cones with shared rings.
//!
//! The rings' circles come from tables, so a vertex costs no trigonometry. A ring of N sides has
//! N + 1 vertices: the first and the last lie in one place and part the texture. The foot of a
//! branch is a hole in the facets of one band (see `junction`); its corners are the first ring of
//! the branch.
//! Where one bark gives way to a younger one, facets of both mix and their rings are in both
//! surfaces; together all are closed.

use std::f32::consts::TAU;

use glam::{Vec2, Vec3};

use super::Surface;
use super::junction::{Hole, mask};
use super::path::{MAX_SIDES, Ring};
use super::wind::{Sway, Wind};
use crate::seed::Seed;

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

/// Barks of a tree: old, that of the upper stem and branches, that of twigs.
pub const BARKS: usize = 3;

/// Where bark is young, from all old to all young; `None` where the species has no such bark.
#[derive(Debug, Clone, Copy, Default)]
pub struct Young {
    /// That of the upper stem: radii and heights, metres.
    pub upper: Option<Upper>,
    /// That of twigs: radii, metres.
    pub twig_m: Option<[f32; 2]>,
}

#[derive(Debug, Clone, Copy)]
pub struct Upper {
    pub radius_m: [f32; 2],
    pub height_m: [f32; 2],
}

/// Two barks, and the share of the second; between 0 and 1 the facets mix.
#[derive(Clone, Copy)]
struct Mix {
    bark: [usize; 2],
    share: f32,
}

impl Mix {
    fn mixes(self) -> bool {
        self.share > 0.0 && self.share < 1.0
    }

    fn most(self) -> usize {
        self.bark[usize::from(self.share >= 0.5)]
    }
}

impl Young {
    fn is_there(&self, bark: usize) -> bool {
        [true, self.upper.is_some(), self.twig_m.is_some()].get(bark).copied().unwrap_or(false)
    }

    fn at(&self, ring: &Ring) -> Mix {
        let part = |x: f32, range: [f32; 2]| {
            let span = range[1] - range[0];
            let span = if span.abs() < 1e-9 { 1e-9 } else { span };
            ((x - range[0]) / span).clamp(0.0, 1.0)
        };
        let upper = self
            .upper
            .map_or(0.0, |u| part(ring.radius_m, u.radius_m).max(part(ring.centre.z, u.height_m)));
        let twig = self.twig_m.map_or(0.0, |r| part(ring.radius_m, r));
        if twig > 0.0 {
            return Mix { bark: [usize::from(upper >= 0.5), 2], share: twig };
        }
        Mix { bark: [0, 1], share: upper }
    }
}

/// One tube, and how it is joined to others.
pub struct Shape<'a> {
    /// The last is the apex.
    pub rings: &'a [Ring],
    /// In the order of their bands.
    pub holes: &'a [Hole],
    /// Closed by a fan where it comes out of none.
    pub out_of: Option<Outlet>,
    /// Nodes it goes along, their arc lengths, and that from its first ring to the first of them.
    pub line: &'a [u32],
    pub arcs_m: &'a [f32],
    pub shift_m: f32,
    /// Of its random draws.
    pub key: u64,
}

/// The hole a tube comes out of, counted over all tubes, and whether it goes over into it by a
/// collar.
#[derive(Clone, Copy)]
pub struct Outlet {
    pub hole: u32,
    pub has_collar: bool,
}

/// Place, normal and wind.
type Corner = (Vec3, Vec3, [u8; 4]);

/// The corners of a hole: which surface, the first.
struct Rim {
    side: usize,
    first: u32,
}

/// The wood while tubes are added, parents before their branches, bark by bark.
pub struct Bark<'a> {
    surface: [Surface; BARKS],
    young: Young,
    wind: Option<&'a Wind>,
    seed: Seed,
    circles: Circles,
    rims: Vec<Rim>,
    /// Of the tube at hand: how its rings swing, and the corners it begins with.
    sway: Vec<Sway>,
    base: Vec<Corner>,
}

impl<'a> Bark<'a> {
    pub fn new(young: Young, wind: Option<&'a Wind>, seed: Seed) -> Bark<'a> {
        Bark {
            surface: Default::default(),
            young,
            wind,
            seed,
            circles: Circles::new(),
            rims: Vec::new(),
            sway: Vec::new(),
            base: Vec::new(),
        }
    }

    /// Without tubes again.
    pub fn clear(&mut self) {
        for s in &mut self.surface {
            s.position.clear();
            s.normal.clear();
            s.uv.clear();
            s.index.clear();
            s.wind.clear();
        }
        self.rims.clear();
    }

    /// Room for so many triangles in each bark; what stays free is given back at the end.
    pub fn reserve(&mut self, triangles: usize) {
        // Large trees have six vertices to seven triangles.
        let vertices = triangles / 7 * 6;
        let Bark { surface, young, .. } = self;
        for (_, s) in surface.iter_mut().enumerate().filter(|(k, _)| young.is_there(*k)) {
            s.position.reserve(vertices);
            s.normal.reserve(vertices);
            s.uv.reserve(vertices);
            s.index.reserve(triangles * 3);
            if self.wind.is_some() {
                s.wind.reserve(vertices);
            }
        }
    }

    pub fn triangles(&self) -> usize {
        self.surface.iter().map(Surface::triangles).sum()
    }

    pub fn finish(self) -> [Surface; BARKS] {
        self.surface.map(|mut s| {
            s.position.shrink_to_fit();
            s.normal.shrink_to_fit();
            s.uv.shrink_to_fit();
            s.index.shrink_to_fit();
            s.wind.shrink_to_fit();
            s
        })
    }

    /// Appends a tube.
    pub fn tube(&mut self, shape: &Shape) {
        let Shape { rings, mut holes, out_of, .. } = *shape;
        let n = rings.len();
        if n < 2 {
            return;
        }
        self.begin(shape);
        let Bark { surface, young, wind, seed, circles, rims, sway, base } = self;
        let has_collar = out_of.is_some_and(|o| o.has_collar);
        let mut luck = Luck { seed: *seed, key: shape.key, phase: None };
        let swing = wind.map(|w| (w, &sway[..]));
        // Where the corners of the last ring start in each surface, once they are there.
        let mut below = [None; BARKS];
        for i in 0..n - 1 {
            let mix = young.at(&rings[i]);
            let mut here = [None; BARKS];
            let corners_in =
                |i: usize, slot: &mut Option<u32>, out: &mut Surface, luck: &mut Luck| {
                    *slot.get_or_insert_with(|| {
                        let start = out.position.len() as u32;
                        let ring = &rings[i];
                        if i == 0 && !base.is_empty() {
                            rim(ring, circles.of(ring.sides), base, has_collar, out);
                            if swing.is_some() {
                                let again =
                                    (0..=ring.sides as usize).map(|k| base[k % base.len()].2);
                                out.wind.extend(again);
                            }
                        } else {
                            let phase = if ring.lobe == 0.0 { 0.0 } else { luck.phase() };
                            corners(ring, circles.of(ring.sides), phase, out);
                            if let Some((wind, sway)) = swing {
                                wind.ring(sway[i], out);
                            }
                        }
                        start
                    })
                };
            if i == 0 {
                // The base is closed by a fan: it lies inside the parent or below ground.
                let b = mix.most();
                let out = &mut surface[b];
                let first = corners_in(0, &mut here[b], out, &mut luck);
                if base.is_empty() {
                    for k in 1..rings[0].sides - 1 {
                        out.index.extend([first, first + k + 1, first + k]);
                    }
                }
            } else {
                let (sides, next) = (rings[i - 1].sides, rings[i].sides);
                let (mixes, side) = (mix.mixes(), mix.most());
                let count = holes.iter().take_while(|h| h.band as usize == i - 1).count();
                let (opened, rest) = holes.split_at(count);
                holes = rest;
                if count == 0 && !(mixes && sides == next) {
                    let out = &mut surface[side];
                    let p = corners_in(i - 1, &mut below[side], out, &mut luck);
                    let q = corners_in(i, &mut here[side], out, &mut luck);
                    band(p, sides, q, next, &mut out.index);
                } else {
                    let taken = opened.iter().fold(0, |m, h| m | mask(h.facet, h.facets, sides));
                    for k in (0..sides).filter(|k| taken >> k & 1 == 0) {
                        let b = if mixes {
                            mix.bark[usize::from(luck.limit(k, sides) < mix.share)]
                        } else {
                            side
                        };
                        let out = &mut surface[b];
                        let p = corners_in(i - 1, &mut below[b], out, &mut luck) + k;
                        let q = corners_in(i, &mut here[b], out, &mut luck) + k;
                        out.index.extend([p, p + 1, q + 1, p, q + 1, q]);
                    }
                    for hole in opened {
                        let out = &mut surface[side];
                        let p = corners_in(i - 1, &mut below[side], out, &mut luck);
                        let q = corners_in(i, &mut here[side], out, &mut luck);
                        let first = fill(hole, [&rings[i - 1], &rings[i]], [p, q], circles, out);
                        if let Some((wind, sway)) = swing {
                            let place = |c: &Vec2| hole.t + hole.half_t * c.x;
                            let foot = circles.of(hole.start.sides).iter().map(place);
                            wind.each(foot.map(|t| sway[i - 1].between(sway[i], t)), out);
                        }
                        rims.push(Rim { side, first });
                    }
                }
            }
            if i == n - 2 {
                let b = mix.most();
                let out = &mut surface[b];
                let last = corners_in(i, &mut here[b], out, &mut luck);
                let apex = &rings[n - 1];
                let tip = out.position.len() as u32;
                out.position.push(apex.centre);
                out.normal.push(apex.tangent);
                out.uv.push(Vec2::new(0.0, apex.v));
                if let Some((wind, sway)) = swing {
                    wind.ring(sway[n - 1], out);
                }
                for k in 0..rings[i].sides {
                    out.index.extend([last + k, last + k + 1, tip]);
                }
            }
            below = here;
        }
    }

    /// Finds the corners that a tube begins with, and how its rings swing.
    fn begin(&mut self, shape: &Shape) {
        self.base.clear();
        let rim = shape.out_of.and_then(|o| self.rims.get(o.hole as usize));
        if let Some(&Rim { side, first }) = rim {
            let s = &self.surface[side];
            let corners = (first..first + shape.rings[0].sides).map(|k| k as usize);
            self.base.extend(
                corners.map(|k| {
                    (s.position[k], s.normal[k], s.wind.get(k).copied().unwrap_or_default())
                }),
            );
        }
        self.sway.clear();
        if let Some(wind) = self.wind {
            let at_m = shape.rings.iter().map(|r| r.arc_m - shape.shift_m);
            wind.along(shape.line, shape.arcs_m, at_m, &mut self.sway);
        }
    }
}

/// A tube's random phase, which few ask for: of its buttresses, and of where barks meet.
struct Luck {
    seed: Seed,
    key: u64,
    phase: Option<f32>,
}

impl Luck {
    fn phase(&mut self) -> f32 {
        *self
            .phase
            .get_or_insert_with(|| self.seed.derive("bark", self.key).draws().between(0.0, TAU))
    }

    /// Share of a bark from which on a facet has it, 0…1: by the way it faces alone, so that one
    /// bark reaches into the other in tongues.
    fn limit(&mut self, facet: u32, sides: u32) -> f32 {
        let phase = self.phase();
        let turn = (facet as f32 + 0.5) / sides.max(1) as f32 * TAU;
        let [a, b, c] =
            [(2.0, 1.0), (5.0, 2.3), (11.0, 4.1)].map(|(n, p)| (n * turn + p * phase).sin());
        (0.5 + 0.16 * a + 0.2 * b + 0.14 * c).clamp(0.001, 0.999)
    }
}

/// Texture coordinate around, of a corner (or a place between corners).
fn around(ring: &Ring, corner: f32) -> f32 {
    (corner / ring.sides as f32 - 0.5) * ring.repeats
}

/// The first ring of a branch: the corners of its hole. A collar goes over into the parent's
/// bark; a twig keeps its own roundness.
fn rim(ring: &Ring, circle: &[Vec2], base: &[Corner], is_collar: bool, out: &mut Surface) {
    let binormal = ring.binormal();
    for (k, c) in circle.iter().enumerate() {
        let (position, parent, _) = base[k % base.len()];
        let own = ring.normal * c.x + binormal * c.y;
        // In a crotch the branch's side faces the parent: there both count alike.
        let weight = if is_collar { 0.6 - 0.6 * parent.dot(own) } else { 3.0 };
        let normal = (parent + own * weight).normalize_or(own);
        out.position.push(position);
        out.normal.push(normal);
        out.uv.push(Vec2::new(around(ring, k as f32), ring.v));
    }
}

/// Fills a block of facets but for the foot of a branch, whose first corner is returned. Both edges
/// are walked in step: all of it lies in the parent's facets.
fn fill(
    hole: &Hole,
    [low, high]: [&Ring; 2],
    [p, q]: [u32; 2],
    circles: &Circles,
    out: &mut Surface,
) -> u32 {
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
            if let Some(&colour) = out.wind.get(i) {
                out.wind.push(colour);
            }
        }
        start
    };
    let (p, q) = (edge(p, low), edge(q, high));
    let first = out.position.len() as u32;
    let circle = circles.of(hole.start.sides);
    let inner = hole.start.sides;
    for c in &circle[..inner as usize] {
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
        let place = hole.facet as f32 + x;
        let u = around(low, place) + (around(high, place) - around(low, place)) * t;
        out.position.push(position);
        out.normal.push(normal);
        out.uv.push(Vec2::new(u, low.v + (high.v - low.v) * t));
    }
    // Both counter-clockwise; the outer edge from its upper right, the inner one from its top. Each
    // inner edge takes the outer corner furthest out as it sees it, which is never hidden (the
    // block is convex and holds the foot), as two calipers turn around.
    let outer = 2 * (facets + 1);
    // Index and place of each outer corner.
    let mut corner = [(0, Vec2::ZERO); 2 * (MAX_SIDES as usize + 1)];
    let (upper, lower) = corner.split_at_mut(facets as usize + 1);
    let (top, bottom) = ((1.0 - hole.t) / hole.half_t, (0.0 - hole.t) / hole.half_t);
    for k in 0..=facets {
        let x = (k as f32 - hole.x) / hole.half_x;
        upper[(facets - k) as usize] = (q + k, Vec2::new(x, top));
        lower[k as usize] = (p + k, Vec2::new(x, bottom));
    }
    let corner = &corner[..outer as usize];
    let away = |i: u32| {
        let sum = circle[i as usize] + circle[i as usize + 1];
        Vec2::new(-sum.y, sum.x)
    };
    let onward = |j: usize| if j + 1 == corner.len() { 0 } else { j + 1 };
    let (mut j, mut far) = (0, f32::NEG_INFINITY);
    for (k, c) in corner.iter().enumerate() {
        let out = c.1.dot(away(0));
        if out > far {
            (j, far) = (k, out);
        }
    }
    let mut left = outer;
    for i in 0..inner {
        let away = away(i);
        while left > 0 && corner[onward(j)].1.dot(away) > corner[j].1.dot(away) {
            out.index.extend([corner[j].0, corner[onward(j)].0, first + i]);
            (j, left) = (onward(j), left - 1);
        }
        let next = if i + 1 == inner { first } else { first + i + 1 };
        out.index.extend([corner[j].0, next, first + i]);
    }
    for _ in 0..left {
        out.index.extend([corner[j].0, corner[onward(j)].0, first]);
        j = onward(j);
    }
    first
}

fn corners(ring: &Ring, circle: &[Vec2], lobe_phase: f32, out: &mut Surface) {
    let binormal = ring.binormal();
    let lift = 1.0 / (1.0 + ring.slope * ring.slope).sqrt();
    let (flat, rise) = (lift, ring.tangent * (-ring.slope * lift));
    if ring.lobe == 0.0 {
        let away = |c: &Vec2| ring.normal * c.x + binormal * c.y;
        out.position.extend(circle.iter().map(|c| ring.centre + away(c) * ring.radius_m));
        out.normal.extend(circle.iter().map(|c| away(c) * flat + rise));
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
        let start = index.len();
        index.resize(start + 6 * a_sides as usize, 0);
        for (facet, k) in index[start..].as_chunks_mut::<6>().0.iter_mut().zip(0..) {
            let (p, q) = (a + k, b + k);
            *facet = [p, p + 1, q + 1, p, q + 1, q];
        }
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
            fill(&hole, [&low, &top], [0, sides + 1], &circles, &mut out);
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
