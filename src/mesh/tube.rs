//! Rings to triangles: one closed tube an axis, P18's truncated cones with shared rings.
//!
//! The rings' circles come from tables, so a vertex costs no trigonometry. A ring of N sides has
//! N + 1 vertices: the first and the last lie in one place and part the texture. Bark is finer on
//! thinner wood, as in nature: where less than a tile would go around one does, up to three times as
//! fine. Around still thinner wood, bark that fine is laid there and back: it meets itself at the first
//! corner and turns at another, whose twin is the last vertex. The foot of a
//! branch is a hole in the facets of one band (see `junction`); its corners are the first ring of
//! the branch.
//! Old bark goes over into that of the upper stem in one picture between two rings (see `transition`). Where bark
//! gives way to that of twigs, the line between them winds through the facets of thick wood (see `blend`) and
//! goes around those of thin wood. Rings between two barks are in both surfaces; together all are closed.

use std::f32::consts::TAU;

use glam::{Vec2, Vec3, Vec3A};

use super::Surface;
use super::blend::{self, Spot};
use super::facing::{Facing, may_stray, mend_last};
use super::junction::{Hole, mask};
use super::patch::{fill, on_edge};
use super::path::{MAX_SIDES, MIN_SIDES, Ring, fold};
use super::transition::SPAN;
use super::wind::{Sway, Wind};
use super::young::{
    BARKS, Blend, COATS, Coat, FINEST, FOLDED_GIRTH, Limits, Luck, Mix, OLD, TRANSITION, Young,
};
use crate::seed::Seed;
use crate::texture::bark::TILES;

/// Tables of the rings of every number of sides.
pub struct Circles([Vec<Laid>; 2]);

/// The vertices of a ring: its corners, the first of them again, and where bark is folded the fold
/// again.
struct Laid {
    /// Cosine and sine.
    corner: Vec<Vec2>,
    /// Texture coordinate around: of one tile around, or of a folded ring whose girth is one tile.
    around: Vec<f32>,
}

impl Laid {
    fn new(sides: u32, is_folded: bool) -> Laid {
        let n = sides.max(1);
        let corner = |k: u32| {
            // The last corner is the first, to the bit.
            let (s, c) = ((k % n) as f32 / n as f32 * TAU).sin_cos();
            Vec2::new(c, s)
        };
        let twin = is_folded.then_some(fold(sides));
        let around = |k: u32| {
            if is_folded { folded(n, k as f32, k > fold(n)) } else { k as f32 / n as f32 - 0.5 }
        };
        Laid {
            corner: (0..=sides).chain(twin).map(corner).collect(),
            around: (0..=sides).map(around).chain(twin.map(|_| 0.0)).collect(),
        }
    }
}

impl Circles {
    pub fn new() -> Self {
        let all = |is_folded| (0..=MAX_SIDES).map(|n| Laid::new(n, is_folded)).collect();
        Circles([false, true].map(all))
    }

    /// Cosines and sines of the corners, the first again at the end.
    pub fn of(&self, sides: u32) -> &[Vec2] {
        &self.laid(sides, false).corner
    }

    fn laid(&self, sides: u32, is_folded: bool) -> &Laid {
        &self.0[usize::from(is_folded)][sides.min(MAX_SIDES) as usize]
    }
}

/// Bounds of texel density, as tiles a tile's length.
const DENSITY: [f32; 2] = [0.7, FINEST];
/// Bark winds about its stem, as the grain of wood does, by so many tiles a tile along: the marks of a
/// tile do not stand in a column.
const SPIRAL: f32 = 0.16;
/// How far below a tile between two barks, in tiles.
const NEAR_TILES: f32 = 1.5;
/// Tiles around change where the density is off by more than this factor.
const OFF: f32 = 1.45;
/// Where a tube flares, its radius grows towards its foot by more than this share of the way; and
/// times the girth above that it may have there.
const FLARES: f32 = 0.1;
const FLARED: f32 = 1.8;

/// How a tile between two barks is laid.
#[derive(Clone, Copy)]
struct Laying {
    /// The ring from which on its tiles around count.
    changes: usize,
    /// Its first ring above its foot, and its last.
    first: usize,
    last: usize,
    /// Tiles along a metre, and around.
    per_m: f32,
    repeats: f32,
}

/// Lays bark along a tube: whole tiles around, so that it closes on itself, and as many along as
/// there are around a metre, so that a taper does not stretch it. Where the number around changes,
/// a band shears the bark by half a tile at its seam; not so over the flare of a foot, which has the
/// tiles of the tube above, wider. How many there are at first follows a radius at so far along it, which are
/// the same however coarse it is. It winds to the left or the right, by `key`. Where bark is folded (see
/// `young`) all of it is as fine and none winds; thin tubes begin anywhere in the tile, by `key`.
pub fn lay_bark(
    rings: &mut [Ring],
    repeat_m: f32,
    (radius_m, from_m): (impl FnOnce() -> f32, f32),
    key: u32,
) {
    // Of the polygon: N sin(π / N) / π of the circle's.
    let around = |ring: &Ring| {
        let x = std::f32::consts::PI / ring.sides.max(MIN_SIDES) as f32;
        let chords = 1.0 - x * x / 6.0 * (1.0 - x * x / 20.0);
        (ring.radius_m * TAU * chords).max(1e-6) / repeat_m
    };
    let whole = |girth: f32| ((girth + 0.5) as u32).clamp(1, 1024) as f32;
    let Some(&first) = rings.first() else { return };
    let mut below = first;
    below.girth = around(&first);
    let flare = rings.iter().take_while(|r| r.slope < -FLARES);
    let flare = flare.take_while(|r| around(r) * FLARED > below.girth).count();
    // Around what is thinner than a tile there is one.
    let is_thin = TAU * first.radius_m < repeat_m;
    below.repeats = if is_thin { 1.0 } else { whole(TAU * radius_m() / repeat_m) };
    if below.girth < FOLDED_GIRTH[1] {
        // Multiples of the plastic number's inverses, as shares of 2³², lie evenly on a square.
        let share = |inverse: u32| key.wrapping_mul(inverse) as f32 * 2f32.powi(-32);
        (below.u, below.v) = (share(0xc13f_a9a9), share(0x91e1_0da6));
    }
    // A tile between two barks is laid whole, from its foot on.
    // Their number around changes over the longest band near below, where that shears least.
    let transition = rings.iter().position(|r| r.bark == TRANSITION).map(|first| {
        let past = rings[first..].iter().position(|r| r.bark != TRANSITION);
        let last = past.map_or(rings.len(), |n| first + n) - 1;
        let [low, high] = [&rings[first - 1], &rings[last]];
        let per_m = SPAN / (high.arc_m - low.arc_m).max(1e-6);
        // As wide as it is high, whatever the tiles below.
        let repeats = whole(0.5 * TAU * (low.radius_m + high.radius_m) / repeat_m);
        let near = |k: &usize| rings[*k].arc_m >= low.arc_m - NEAR_TILES * repeat_m;
        let long_m = |k: &usize| rings[*k].arc_m - rings[*k - 1].arc_m;
        let bands = (flare + 1..first).rev().take_while(near);
        let changes = bands.max_by(|a, b| long_m(a).total_cmp(&long_m(b))).unwrap_or(first - 1);
        Laying { changes, first, last, per_m, repeats }
    });
    let spiral = if key.is_multiple_of(2) { SPIRAL } else { -SPIRAL };
    for (i, ring) in rings.iter_mut().enumerate() {
        (ring.u, ring.girth) = (below.u, around(ring));
        // Not of the polygon: that differs from level to level.
        let round = TAU * ring.radius_m / repeat_m;
        let is_off = below.repeats > OFF * round || round > OFF * below.repeats;
        // The apex is a point.
        let is_foot = i <= flare || ring.arc_m <= from_m;
        let stays = is_foot || ring.radius_m == 0.0 || !is_off;
        let own = if stays { below.repeats } else { whole(round) };
        let laid = transition.filter(|t| (t.changes..=t.last).contains(&i));
        ring.repeats = laid.map_or(own, |t| t.repeats);
        let girth = 0.5 * (below.girth + ring.girth);
        let repeats = 0.5 * (below.repeats + ring.repeats);
        let is_folded = girth < FOLDED_GIRTH[1];
        let density =
            if is_folded { FINEST } else { (repeats / girth).clamp(DENSITY[0], DENSITY[1]) };
        let between = transition.filter(|t| (t.first..=t.last).contains(&i));
        let per_m = between.map_or(density / repeat_m, |t| t.per_m);
        ring.v = below.v + (ring.arc_m - below.arc_m) * per_m;
        if !is_folded {
            let tiles = between.map_or(1.0, |_| TILES as f32);
            ring.u = below.u + spiral * tiles * (ring.v - below.v);
        }
        below = *ring;
    }
    if let Some(Laying { first, .. }) = transition {
        let foot = rings[first - 1].v - 0.5 * (1.0 - SPAN);
        let back = foot - foot.floor();
        rings.iter_mut().for_each(|ring| ring.v -= back);
    }
}

/// One tube, and how it is joined to others.
pub struct Shape<'a> {
    /// The last is the apex. The first beyond a hole may be raised out of the bark about that.
    pub rings: &'a mut [Ring],
    /// In the order of their bands.
    pub holes: &'a [Hole],
    /// Closed by a fan where it comes out of none.
    pub out_of: Option<Outlet>,
    /// The tree's only one.
    pub is_stem: bool,
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

/// What a tube begins with where it comes out of a hole: the corners of that, their middle, and which way the
/// tube goes from there. They lie on the facets of the parent, which are within its circles.
#[derive(Default)]
struct Base {
    corners: Vec<Corner>,
    centre: Vec3A,
    axis: Vec3A,
}

impl Base {
    fn is_none(&self) -> bool {
        self.corners.is_empty()
    }
}

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
    /// Of the tube at hand: how its rings swing, and what it begins with.
    sway: Vec<Sway>,
    base: Base,
    /// What coats its rings have, but for the apex.
    mixes: Vec<Mix>,
    /// Index and place of the corners about a hole.
    about: Vec<(u32, Vec2)>,
    limits: Limits,
    facing: Facing,
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
            base: Base::default(),
            mixes: Vec::new(),
            about: Vec::new(),
            limits: Limits::default(),
            facing: Facing::default(),
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

    /// Room for so many triangles in the bark of thin wood, which is most of a large tree; what stays free is
    /// given back at the end. The rest grows as it comes: each column costs a page though it stays empty.
    pub fn reserve(&mut self, triangles: usize) {
        // Large trees have six vertices to seven triangles, or somewhat more.
        let vertices = triangles / 8 * 7;
        let most = (0..BARKS).rev().find(|&k| k != TRANSITION && self.young.is_there(k));
        let s = &mut self.surface[most.unwrap_or(OLD)];
        s.position.reserve(vertices);
        s.normal.reserve(vertices);
        s.uv.reserve(vertices);
        s.index.reserve(triangles * 3);
        if self.wind.is_some() {
            s.wind.reserve(vertices);
        }
    }

    pub fn triangles(&self) -> usize {
        self.surface.iter().map(Surface::triangles).sum()
    }

    pub fn finish(self) -> [Surface; BARKS] {
        let wind = self.wind;
        self.surface.map(|mut s| {
            if let Some(wind) = wind {
                wind.rise(&mut s);
            }
            s.position.shrink_to_fit();
            s.normal.shrink_to_fit();
            s.uv.shrink_to_fit();
            s.index.shrink_to_fit();
            s.wind.shrink_to_fit();
            s
        })
    }

    /// Appends a tube.
    pub fn tube(&mut self, shape: Shape) {
        let n = shape.rings.len();
        if n < 2 {
            return;
        }
        let Shape { rings, mut holes, out_of, key, .. } = self.begin(shape);
        let rings = &*rings;
        let start = self.surface.each_ref().map(|s| s.index.len());
        let Bark {
            surface,
            wind,
            seed,
            circles,
            rims,
            sway,
            base,
            mixes,
            about,
            limits,
            facing,
            ..
        } = self;
        let has_collar = out_of.is_some_and(|o| o.has_collar);
        let mut luck = Luck::new(*seed, key);
        let swing = wind.map(|w| (w, &sway[..]));
        let maker = Maker { rings, base, has_collar, circles, swing };
        facing.begin();
        limits.begin();
        let coat = mixes[0].most();
        if holes.is_empty() && mixes.iter().all(|m| !m.mixes() && m.most() == coat) {
            maker.plain(coat, &mut luck, surface, facing);
            facing.mend(surface, start);
            return;
        }
        // Where the corners of the last ring start in each coat, once they are there.
        let mut below = [None; COATS];
        let (mut blend_below, mut taken_below) = (None, 0);
        for i in 0..n - 1 {
            let mix = mixes[i];
            let strays = maker.may_stray(i);
            let mut here = [None; COATS];
            let corners_in = |i: usize,
                              coat: Coat,
                              slot: &mut [Option<u32>; COATS],
                              out: &mut Surface,
                              luck: &mut Luck| {
                *slot[coat.0].get_or_insert_with(|| maker.ring(i, coat, luck, out))
            };
            if i == 0 {
                let coat = mix.most();
                let out = &mut surface[coat.bark()];
                let first = corners_in(0, coat, &mut here, out, &mut luck);
                maker.cap(first, out);
            } else {
                let (sides, next) = (rings[i - 1].sides, rings[i].sides);
                let (is_mixed, side) = (mix.mixes(), mix.most());
                let count = holes.iter().take_while(|h| h.band as usize == i - 1).count();
                let (opened, rest) = holes.split_at(count);
                holes = rest;
                let taken = facets_of(opened, sides);
                let blend = Blend::of([mixes[i - 1], mix], [sides, next]);
                let meets = |a: Option<Blend>, b: Option<Blend>| {
                    a.zip(b).is_some_and(|(a, b)| a.pair == b.pair)
                };
                if let Some(blended) = blend {
                    let above = (i + 2 < n)
                        .then(|| Blend::of([mix, mixes[i + 1]], [next, rings[i + 1].sides]))
                        .flatten();
                    // A foot's block is cut nowhere.
                    let open_above = rest.iter().take_while(|h| h.band as usize == i).count();
                    let taken_above = facets_of(&rest[..open_above], next);
                    let [cut_low, cut_high] = [
                        if meets(blend_below, blend) { !taken_below } else { 0 },
                        if meets(blend, above) { !taken_above } else { 0 },
                    ];
                    let [p, q] = [(i - 1, &mut below), (i, &mut here)].map(|(i, slots)| {
                        blended
                            .pair
                            .map(|c| corners_in(i, c, slots, &mut surface[c.bark()], &mut luck))
                    });
                    let [low, high] = [0, 1].map(|r| (&rings[i - 1 + r], blended.share[r]));
                    limits.band([i - 1, i], blended.share, rings, &mut luck);
                    let field = |k: u32| {
                        let limit = limits.at(k);
                        [low.1 - limit[0], high.1 - limit[1]]
                    };
                    let is_in = |facets: u64, k: u32| facets >> (k % sides) & 1 == 1;
                    let mut left = field(0);
                    for k in 0..sides {
                        let right = field(k + 1);
                        let at = [left[0], right[0], right[1], left[1]];
                        left = right;
                        if is_in(taken, k) {
                            continue;
                        }
                        let corners = |b: usize| {
                            let left = k + twin(&rings[i], blended.pair[b].is_folded(), k);
                            [p[b] + left, p[b] + k + 1, q[b] + k + 1, q[b] + left]
                        };
                        let is_above = at.map(|f| f >= 0.0);
                        if is_above == [is_above[0]; 4] {
                            let b = usize::from(is_above[0]);
                            let [c0, c1, c2, c3] = corners(b);
                            let out = &mut surface[blended.pair[b].bark()];
                            out.index.extend([c0, c1, c2, c0, c2, c3]);
                            continue;
                        }
                        let may_cut = [
                            is_in(cut_low, k),
                            !is_in(taken, k + 1),
                            is_in(cut_high, k),
                            !is_in(taken, k + sides - 1),
                        ];
                        // Of each coat, by the facet's edge.
                        let mut on_edges = [[None; 4]; 2];
                        let corner = [0, 1].map(corners);
                        blend::cut(at, may_cut, |is_second, spots| {
                            let b = usize::from(is_second);
                            let out = &mut surface[blended.pair[b].bark()];
                            let corners = spots.map(|s| match s {
                                Spot::Corner(k) => corner[b][k],
                                Spot::Edge(edge, t) => *on_edges[b][edge]
                                    .get_or_insert_with(|| on_edge(edge, t, corner[b], out)),
                            });
                            out.index.extend(corners);
                        });
                    }
                    for hole in opened {
                        let turn = hole.facet as f32 + hole.x;
                        let turn = turn / sides as f32;
                        let share = low.1 + (high.1 - low.1) * hole.t;
                        let b = usize::from(share >= luck.limit(turn.fract(), low.0));
                        let coat = blended.pair[b];
                        let out = &mut surface[coat.bark()];
                        let first = maker.foot(i, hole, coat, [p[b], q[b]], strays, about, out);
                        rims.push(Rim { side: coat.bark(), first });
                    }
                } else if count == 0 && !(is_mixed && sides == next) {
                    let out = &mut surface[side.bark()];
                    let p = corners_in(i - 1, side, &mut below, out, &mut luck);
                    let q = corners_in(i, side, &mut here, out, &mut luck);
                    band([p, q], [sides, next], side.is_folded(), &mut out.index);
                } else {
                    for k in (0..sides).filter(|k| taken >> k & 1 == 0) {
                        let coat = if is_mixed {
                            let turn = (k as f32 + 0.5) / sides as f32;
                            mix.coat[usize::from(luck.limit(turn, &rings[i]) < mix.share)]
                        } else {
                            side
                        };
                        let out = &mut surface[coat.bark()];
                        let p = corners_in(i - 1, coat, &mut below, out, &mut luck) + k;
                        let q = corners_in(i, coat, &mut here, out, &mut luck) + k;
                        let twin = twin(&rings[i], coat.is_folded(), k);
                        out.index.extend([p + twin, p + 1, q + 1, p + twin, q + 1, q + twin]);
                    }
                    for hole in opened {
                        let out = &mut surface[side.bark()];
                        let p = corners_in(i - 1, side, &mut below, out, &mut luck);
                        let q = corners_in(i, side, &mut here, out, &mut luck);
                        let first = maker.foot(i, hole, side, [p, q], strays, about, out);
                        rims.push(Rim { side: side.bark(), first });
                    }
                }
                (blend_below, taken_below) = (blend, taken);
            }
            if i == n - 2 {
                let coat = mix.most();
                let out = &mut surface[coat.bark()];
                let last = corners_in(i, coat, &mut here, out, &mut luck);
                maker.tip(last, coat, out);
            }
            below = here;
            facing.band(surface, strays);
        }
        facing.mend(surface, start);
    }

    /// Finds the corners that a tube begins with, its barks, and how its rings swing.
    fn begin<'s>(&mut self, shape: Shape<'s>) -> Shape<'s> {
        self.mixes.clear();
        let below_apex = &shape.rings[..shape.rings.len() - 1];
        let young = if shape.is_stem { self.young.of_stem() } else { self.young };
        self.mixes.extend(below_apex.iter().map(|ring| young.at(ring)));
        let base = &mut self.base;
        base.corners.clear();
        let rim = shape.out_of.and_then(|o| self.rims.get(o.hole as usize));
        if let Some(&Rim { side, first }) = rim {
            let s = &self.surface[side];
            let sides = shape.rings[0].sides;
            let corners = (first..first + sides).map(|k| k as usize);
            base.corners.extend(
                corners.map(|k| {
                    (s.position[k], s.normal[k], s.wind.get(k).copied().unwrap_or_default())
                }),
            );
            let sum = base.corners.iter().map(|corner| Vec3A::from(corner.0)).sum::<Vec3A>();
            base.centre = sum / sides.max(1) as f32;
            let beyond = clear(base, shape.rings[0].radius_m, shape.rings[1].centre.into());
            shape.rings[1].centre = beyond.into();
            base.axis = (beyond - base.centre).normalize_or(shape.rings[0].tangent.into());
        }
        self.sway.clear();
        if let Some(wind) = self.wind {
            let at_m = shape.rings.iter().map(|r| r.arc_m - shape.shift_m);
            wind.along(shape.line, shape.arcs_m, at_m, &mut self.sway);
        }
        shape
    }
}

/// A place beyond a hole, raised where it would be within the bark about it: the facets about a hole lie within the
/// parent's circles and may face another way, and out of one that faces away a tube would be inside out. It keeps
/// near its skeleton.
fn clear(base: &Base, radius_m: f32, beyond: Vec3A) -> Vec3A {
    /// Sine of the slope at which it is to leave the facets; and how far it may move for that, beside a radius.
    const RISE: f32 = 0.1;
    const MOST_M: f32 = 0.055;
    let Some(last) = base.corners.last() else { return beyond };
    let mut before = Vec3A::from(last.0) - base.centre;
    // Twice the area, as a vector.
    let mut area = Vec3A::ZERO;
    for corner in &base.corners {
        let here = Vec3A::from(corner.0) - base.centre;
        area += before.cross(here);
        before = here;
    }
    let way = beyond - base.centre;
    let rise = area.dot(way);
    let enough_sq = RISE * RISE * area.length_squared() * way.length_squared();
    if rise > 0.0 && rise * rise >= enough_sq {
        return beyond;
    }
    let out = area.normalize_or_zero();
    let by_m = RISE * way.length() - out.dot(way);
    beyond + out * by_m.min(MOST_M + radius_m)
}

/// What a tube is made of.
struct Maker<'a> {
    rings: &'a [Ring],
    base: &'a Base,
    has_collar: bool,
    circles: &'a Circles,
    swing: Option<(&'a Wind, &'a [Sway])>,
}

impl Maker<'_> {
    /// The corners of a ring in a coat; gives the first.
    fn ring(&self, i: usize, coat: Coat, luck: &mut Luck, out: &mut Surface) -> u32 {
        let Maker { base, circles, swing, .. } = *self;
        let start = out.position.len() as u32;
        let (ring, is_folded) = (&self.rings[i], coat.is_folded());
        if i == 0 && !base.is_none() {
            rim(ring, circles, base, self.has_collar, is_folded, out);
            if swing.is_some() {
                let again = [Some(0), is_folded.then_some(ring.fold() as usize)];
                out.wind.extend(base.corners.iter().map(|corner| corner.2));
                out.wind.extend(again.into_iter().flatten().map(|k| base.corners[k].2));
            }
        } else {
            let phase = if ring.lobe == 0.0 { 0.0 } else { luck.phase() };
            corners(ring, circles, phase, is_folded, out);
            if let Some((wind, sway)) = swing {
                wind.ring(sway[i], out);
            }
        }
        start
    }

    /// Whether normals may look away between a ring and the one below, and for the last between it
    /// and the apex.
    fn may_stray(&self, i: usize) -> bool {
        let rings = self.rings;
        if is_plain_cone(rings, self.base, self.has_collar) {
            return false;
        }
        let is_rim = i == 1 && !self.base.is_none();
        let is_last = i + 2 == rings.len();
        i == 0
            || is_rim
            || may_stray(&rings[i - 1], &rings[i])
            || is_last && may_stray(&rings[i], &rings[i + 1])
    }

    /// Closes the base by a fan where it comes out of no hole: it lies inside the parent or below
    /// ground.
    fn cap(&self, first: u32, out: &mut Surface) {
        let sides = self.rings[0].sides;
        if self.base.is_none() {
            // About the first corner's other vertex: both sides of a fold hang together.
            for k in 1..sides - 1 {
                out.index.extend([first + sides, first + k + 1, first + k]);
            }
        }
    }

    /// The facets about a foot between a ring and the one below, whose corners in a coat start at
    /// `first`; gives the first corner of the foot.
    #[expect(clippy::too_many_arguments)]
    fn foot(
        &self,
        i: usize,
        hole: &Hole,
        coat: Coat,
        first: [u32; 2],
        strays: bool,
        about: &mut Vec<(u32, Vec2)>,
        out: &mut Surface,
    ) -> u32 {
        let pair = [&self.rings[i - 1], &self.rings[i]];
        let last = out.index.len();
        let foot = fill(hole, pair, coat.is_folded(), first, self.circles, about, out);
        // Within one facet normals are those of its corners.
        if strays || (hole.facets > 1 && pair[0].sides < 6) {
            mend_last(out, last);
        }
        if let Some((wind, sway)) = self.swing {
            let place = |c: &Vec2| hole.t + hole.half_t * hole.foot[1].dot(*c);
            let foot = self.circles.of(hole.start.sides).iter().map(place);
            wind.each(foot.map(|t| sway[i - 1].between(sway[i], t)), out);
        }
        foot
    }

    /// The apex, above the ring whose corners start at `last`.
    fn tip(&self, last: u32, coat: Coat, out: &mut Surface) {
        let [.., below, apex] = self.rings else { return };
        let is_folded = coat.is_folded();
        let tip = out.position.len() as u32;
        // One for each side of a fold.
        let tips = 1 + u32::from(is_folded);
        let u = apex.u - if is_folded { 0.25 * FINEST * below.girth } else { 0.0 };
        // A lone cone's line begins in the middle of its foot.
        let is_cone = self.rings.len() == 2 && !self.base.is_none();
        let onward = if is_cone { self.base.axis.into() } else { apex.tangent };
        for _ in 0..tips {
            out.position.push(apex.centre);
            out.normal.push(onward);
            out.uv.push(Vec2::new(u, apex.v));
        }
        if let Some((wind, sway)) = self.swing {
            wind.ring(sway[self.rings.len() - 1], out);
        }
        let fold = if is_folded { below.fold() } else { u32::MAX };
        for k in 0..below.sides {
            let left = last + if k == fold { below.sides + 1 } else { k };
            out.index.extend([left, last + k + 1, tip + u32::from(k >= fold)]);
        }
    }

    /// The whole of a tube without holes in one coat.
    fn plain(
        &self,
        coat: Coat,
        luck: &mut Luck,
        surface: &mut [Surface; BARKS],
        facing: &mut Facing,
    ) {
        let bark = coat.bark();
        let mut below = self.ring(0, coat, luck, &mut surface[bark]);
        self.cap(below, &mut surface[bark]);
        for i in 1..self.rings.len() - 1 {
            let out = &mut surface[bark];
            let here = self.ring(i, coat, luck, out);
            let sides = [self.rings[i - 1].sides, self.rings[i].sides];
            band([below, here], sides, coat.is_folded(), &mut out.index);
            facing.band(surface, self.may_stray(i));
            below = here;
        }
        self.tip(below, coat, &mut surface[bark]);
        facing.band(surface, self.may_stray(self.rings.len() - 2));
    }
}

/// Whether a tube is one cone out of a hole about its own line, longer than the hole slants: then each
/// facet faces away from that line, and upwards, as the normals of its corners do.
fn is_plain_cone(rings: &[Ring], base: &Base, has_collar: bool) -> bool {
    /// Length over the radius of the foot.
    const SLENDER: f32 = 4.0;
    let ([foot, apex], Some(last)) = (rings, base.corners.last()) else { return false };
    let mut before = Vec3A::from(last.0) - base.centre;
    let goes_around = |corner: &Corner| {
        let here = Vec3A::from(corner.0) - base.centre;
        let turn = before.cross(here).dot(base.axis);
        before = here;
        turn > 0.0
    };
    !has_collar
        && apex.arc_m - foot.arc_m > SLENDER * foot.radius_m
        && base.corners.iter().all(goes_around)
}

/// Bits of the facets that the blocks of some feet take.
fn facets_of(holes: &[Hole], sides: u32) -> u64 {
    holes.iter().fold(0, |m, h| m | mask(h.facet, h.facets, sides))
}

/// Texture coordinate around, of a corner (or a place between corners); of folded bark, on the way
/// there or back.
pub fn around(ring: &Ring, corner: f32, back: Option<bool>) -> f32 {
    let Some(back) = back else {
        return ring.u + (corner / ring.sides as f32 - 0.5) * ring.repeats;
    };
    ring.u + FINEST * ring.girth * folded(ring.sides, corner, back)
}

/// Texture coordinate around of a folded ring whose girth is one tile, from its fold.
fn folded(sides: u32, corner: f32, back: bool) -> f32 {
    let [sides, there] = [sides, fold(sides)].map(|k| k as f32);
    // There and back may have a facet more and less: both are off by as much.
    let high = (there * (sides - there)).sqrt() / sides;
    let share = if back { (sides - corner) / (sides - there) } else { corner / there };
    high * (share - 1.0)
}

/// Texture coordinates of a ring, as [`around`] has them to the bit: seams must meet.
fn lay(ring: &Ring, laid: &Laid, is_folded: bool, uv: &mut Vec<Vec2>) {
    let scale = if is_folded { FINEST * ring.girth } else { ring.repeats };
    uv.extend(laid.around.iter().map(|share| Vec2::new(ring.u + scale * share, ring.v)));
}

/// From the first corner of a facet to the vertex that stands for it: its twin, at a fold.
fn twin(ring: &Ring, is_folded: bool, facet: u32) -> u32 {
    if is_folded && facet == ring.fold() { ring.sides + 1 - facet } else { 0 }
}

/// The first ring of a branch: the corners of its hole. A collar goes over into the parent's
/// bark; a twig keeps its own roundness.
fn rim(
    ring: &Ring,
    circles: &Circles,
    base: &Base,
    is_collar: bool,
    is_folded: bool,
    out: &mut Surface,
) {
    let laid = circles.laid(ring.sides, is_folded);
    let Base { corners, centre, axis } = base;
    let [u, v] = [ring.normal, ring.binormal()].map(Vec3A::from);
    let start = out.position.len();
    out.position.extend(corners.iter().map(|corner| corner.0));
    out.normal.extend(corners.iter().zip(&laid.corner).map(|(&(position, parent, _), c)| {
        // Its own roundness, as the hole has it.
        let away = Vec3A::from(position) - centre;
        let away = away - axis * axis.dot(away);
        let own = away.try_normalize().unwrap_or(u * c.x + v * c.y);
        if !is_collar {
            return Vec3::from(own);
        }
        // In a crotch the branch's side faces the parent: there its own counts most.
        let parent = Vec3A::from(parent);
        (parent + own * (2.0 - 2.0 * parent.dot(own))).normalize_or(own).into()
    }));
    close(ring, start, is_folded, out);
    lay(ring, laid, is_folded, &mut out.uv);
}

/// Repeats the first corner of a ring, and the one at its fold, whose places and normals start at
/// `start`.
fn close(ring: &Ring, start: usize, is_folded: bool, out: &mut Surface) {
    let fold = is_folded.then_some(start + ring.fold() as usize);
    for k in std::iter::once(start).chain(fold) {
        out.position.push(out.position[k]);
        out.normal.push(out.normal[k]);
    }
}

pub fn corners(
    ring: &Ring,
    circles: &Circles,
    lobe_phase: f32,
    is_folded: bool,
    out: &mut Surface,
) {
    let laid = circles.laid(ring.sides, is_folded);
    let (normal, binormal) = (Vec3A::from(ring.normal), Vec3A::from(ring.binormal()));
    let lift = 1.0 / (1.0 + ring.slope * ring.slope).sqrt();
    let rise = Vec3A::from(ring.tangent) * (-ring.slope * lift);
    if ring.lobe == 0.0 {
        let centre = Vec3A::from(ring.centre);
        let place = |[u, v]: [Vec3A; 2], from: Vec3A| {
            laid.corner.iter().map(move |c| Vec3::from(from + u * c.x + v * c.y))
        };
        let [u, v] = [normal, binormal];
        out.position.extend(place([u * ring.radius_m, v * ring.radius_m], centre));
        out.normal.extend(place([u * lift, v * lift], rise));
    } else {
        // Buttresses, uneven: r(θ) = r (1 + lobe · (¾ cos(5θ + φ) + ½ cos(2θ + 2φ))).
        for c in &laid.corner {
            let turn = c.to_angle();
            let (s5, c5) = (5.0 * turn + lobe_phase).sin_cos();
            let (s2, c2) = (2.0 * (turn + lobe_phase)).sin_cos();
            let (out_by, change) = (0.75 * c5 + 0.5 * c2, -3.75 * s5 - s2);
            let out_dir = normal * c.x + binormal * c.y;
            let around = binormal * c.x - normal * c.y;
            let radius = ring.radius_m * (1.0 + ring.lobe * out_by);
            let turned = ring.lobe * change / (1.0 + ring.lobe * out_by);
            out.position.push(ring.centre + Vec3::from(out_dir * radius));
            let normal = (out_dir - around * turned) * lift + rise;
            out.normal.push(normal.normalize_or(out_dir).into());
        }
    }
    lay(ring, laid, is_folded, &mut out.uv);
}

/// Joins two rings; where their sides differ, by walking both around in step. What lies beyond a fold
/// has the twins of its corners.
fn band(first: [u32; 2], sides: [u32; 2], is_folded: bool, index: &mut Vec<u32>) {
    let [a, b] = first;
    if sides[0] == sides[1] {
        let start = index.len();
        index.resize(start + 6 * sides[0] as usize, 0);
        let facets = index[start..].as_chunks_mut::<6>().0;
        for (facet, k) in facets.iter_mut().zip(0..) {
            let (p, q) = (a + k, b + k);
            *facet = [p, p + 1, q + 1, p, q + 1, q];
        }
        if is_folded && let Some(facet) = facets.get_mut(fold(sides[0]) as usize) {
            let [p, q] = first.map(|f| f + sides[0] + 1);
            (facet[0], facet[3], facet[5]) = (p, p, q);
        }
        return;
    }
    let folds = sides.map(|n| if is_folded { fold(n) } else { u32::MAX });
    let (mut i, mut j) = (0, 0);
    while i < sides[0] || j < sides[1] {
        // The ring whose next corner comes first goes on: (i + 1) / a against (j + 1) / b.
        let on_first = j == sides[1] || (i < sides[0] && (i + 1) * sides[1] <= (j + 1) * sides[0]);
        let is_beyond = if on_first { i >= folds[0] } else { j >= folds[1] };
        let at =
            |r: usize, k: u32| first[r] + if is_beyond && k == folds[r] { sides[r] + 1 } else { k };
        let (p, q) = (at(0, i), at(1, j));
        if on_first {
            index.extend([p, a + i + 1, q]);
            i += 1;
        } else {
            index.extend([p, b + j + 1, q]);
            j += 1;
        }
    }
}
