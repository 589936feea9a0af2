//! A twig leaf by leaf: a shoot with side shoots, and on them every needle or every leaf with its
//! petiole [P18].
//!
//! Needles and leaves stand about their shoot by the golden angle, or left and right of it in flat
//! sprays; they open from it, sink under their weight and turn their upper side to the light as
//! far as their heading allows; towards the tip of the shoot they are smaller. A needle is a
//! folded blade of two triangles, a leaf a card of its own cell, a compound leaf a rachis with its
//! leaflets. Needles of a triangle each share corners with their neighbours of one place.
//!
//! There are as many twigs as it takes for them to hide of the crown what cards do; what a twig hides is
//! measured on two of them. Every twig of a tree has the same number of triangles, so
//! that a budget is met exactly. A small budget simplifies first the wood of twigs and the form of
//! needles, of as many as it must, then leaves needles or leaves out and widens the rest until the
//! twig hides as much as before, and at last leaves out whole twigs and enlarges the rest. Limits:
//! twigs do not know of each other and may cross; leaves grow to no more than [`MOST_WIDENED`], past
//! which the crown is thinner than the species'.

use glam::{Quat, Vec2, Vec3};

use super::card::{Shape, emit};
use super::piece::{Piece, Room, fill};
use super::shade::hidden_sq_m;
use super::spot::{GOLDEN_RAD, Pose, stance};
use crate::seed::{Draws, Seed};
use crate::species::model::{Foliage, LeafShape};
use crate::texture::atlas::{Atlas, Cell, Row};

/// Least share of a twig's needles, or leaves, that a budget leaves on it before whole twigs go.
const LEAST_SHARE: [f32; 2] = [0.2, 0.5];
/// How far the area of needles, or leaves, may grow to make up for those left out.
const MOST_WIDENED: [f32; 2] = [16.0, 4.0];
/// Shares of what is to be hidden between which leaves hide enough.
const NEAR: f32 = 0.999;
const ENOUGH: f32 = 1.01;
/// The power of that by which a needle's length grows: it stays slender.
const LENGTHENED: f32 = 0.3;
/// How far twigs may grow to make up for twigs left out.
const MOST_ENLARGED: f32 = 2.4;
/// Places for needles or leaves on one shoot at most.
const MOST_PLACES: f32 = 4_000.0;
/// What leaves hide, mean over all directions, over their area.
const SEEN: f32 = 0.6;
/// Power of a twig's length, over the usual, by which its leaves are smaller.
const YOUNG_LEAF: f32 = 0.75;
/// Opening of a shoot's last leaf over that of the others.
const AT_TIP: f32 = 0.3;
/// Share of the crown's outside in the normals of needles, and of leaves.
const BENT: [f32; 2] = [0.45, 0.55];

/// How the shoots and needles of a twig are built.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Build {
    /// Shoots are tubes, needles folded.
    Full,
    /// The main shoot is a straight tube, side shoots and needles are a triangle each, leaves have
    /// fewer rows.
    Light,
}

impl Build {
    /// Straight pieces of the main shoot and of a side shoot; a side shoot of none is a triangle.
    fn pieces(self) -> [usize; 2] {
        match self {
            Build::Full => [3, 1],
            Build::Light => [1, 0],
        }
    }
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Organ {
    Needle,
    /// One blade on a petiole.
    Leaf,
    /// So many leaflets on a rachis.
    Compound(usize),
}

impl Organ {
    /// The form of a leaf or leaflet.
    fn blade(self, build: Build) -> Shape {
        match (self, build) {
            (Organ::Leaf, Build::Full) => Shape::Folded { rows: 3 },
            (Organ::Leaf, Build::Light) | (_, Build::Full) => Shape::Folded { rows: 2 },
            _ => Shape::Flat,
        }
    }

    fn room(self, build: Build) -> Room {
        let blade = self.blade(build).room();
        let with_stalk = |blade: Room, count: usize| Room {
            vertices: 3 + blade.vertices * count,
            triangles: 1 + blade.triangles * count,
        };
        match self {
            Organ::Needle if build == Build::Light => Room { vertices: 3, triangles: 1 },
            Organ::Needle => Room { vertices: 4, triangles: 2 },
            Organ::Leaf => with_stalk(blade, 1),
            Organ::Compound(count) => with_stalk(blade, count),
        }
    }
}

/// How a species' twigs are built.
pub struct Twig<'a> {
    foliage: &'a Foliage,
    atlas: &'a Atlas,
    outlines: &'a [Vec<Row>],
    organ: Organ,
    build: Build,
    /// Needles of a light twig that are folded all the same.
    folded: usize,
    /// Needles from one place.
    cluster: usize,
    /// Side shoots, and the length of the longest over the twig's.
    sides: usize,
    side_length: f32,
    /// Where on a shoot the leaves begin, 0…1.
    from: f32,
    /// Angle between leaf and shoot, radians.
    opening: [f32; 2],
    /// Places on the main shoot, and on each side shoot.
    places: [usize; 2],
    /// Length and width of a leaf over the species'.
    pub widened: Vec2,
    /// Length of most twigs: on shorter ones leaves are smaller, by [`YOUNG_LEAF`].
    usual_m: f32,
    /// Twigs that there are to be, and how much larger than in nature they are.
    pub count: usize,
    pub scale: f32,
    /// What they hide over what the species' leaves do, 0…1.
    pub cover: f32,
    /// Triangles of all leaves that hide as much at the species' own size.
    whole: usize,
}

/// How leaves that are meshed one by one stand for all of them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StandIn {
    /// Length and width over the species'.
    pub size: [f32; 2],
    /// Triangles that all leaves would take, of the species' own size.
    pub whole: usize,
}

impl<'a> Twig<'a> {
    /// A twig of the species' own leaves, all that the season leaves on it; and of the places along its shoots in
    /// summer.
    fn full(foliage: &'a Foliage, atlas: &'a Atlas) -> (Twig<'a>, [f32; 2]) {
        let (sides, side_length, from, opening) = match foliage.shape {
            LeafShape::Needle => (8, 0.45, 0.02, [0.6, 1.1]),
            LeafShape::Tuft => (5, 0.3, 0.06, [0.5, 1.35]),
            LeafShape::Bundle => (4, 0.4, 0.35, [0.4, 1.1]),
            LeafShape::Deltoid => (4, 0.35, 0.1, [0.8, 1.3]),
            LeafShape::Lanceolate => (4, 0.4, 0.1, [0.5, 0.9]),
            _ => (4, 0.4, 0.15, [0.8, 1.2]),
        };
        let cluster = foliage.cluster.clamp(1, 200) as usize;
        let is_needle = foliage.shape.is_needle();
        let organ = match foliage.shape {
            LeafShape::Pinnate => Organ::Compound(cluster),
            _ if is_needle => Organ::Needle,
            _ => Organ::Leaf,
        };
        // Places a leaf's length of shoot.
        let density = match foliage.shape {
            LeafShape::Needle => 16.0,
            LeafShape::Tuft => 3.3,
            LeafShape::Bundle => 45.0,
            LeafShape::Lanceolate => 4.0,
            LeafShape::Round | LeafShape::Cordate | LeafShape::Obovate => 1.6,
            LeafShape::Pinnate => 3.0,
            _ => 2.4,
        };
        let length = foliage.twig_length_m / foliage.leaf_length_m.max(1e-4) * (1.0 - from);
        let summer =
            [length, length * side_length * 0.75].map(|l| (l * density).clamp(1.0, MOST_PLACES));
        let kept = foliage.kept.clamp(0.0, 1.0);
        // Where few leaves are left, one on every side shoot would be many.
        let least = least(foliage);
        let [main, side] = summer.map(|n| (n * kept).round() as usize);
        let twig = Twig {
            foliage,
            atlas,
            outlines: atlas.leaf_outlines(organ.blade(Build::Full).rows()),
            organ,
            build: Build::Full,
            folded: 0,
            cluster: if organ == Organ::Needle { cluster } else { 1 },
            sides,
            side_length,
            from,
            opening,
            places: [main.max(least[0]), side.max(least[1])],
            widened: Vec2::ONE,
            usual_m: foliage.twig_length_m.max(1e-4),
            count: 1,
            scale: 1.0,
            cover: 1.0,
            whole: 0,
        };
        (twig, summer)
    }

    /// Twigs for a tree that has room for `spots` of them and `fewest` at least, whose leaves are so large
    /// together in summer, where it may spend `budget` triangles. Bare ones all stand.
    pub fn new(
        foliage: &'a Foliage,
        atlas: &'a Atlas,
        [fewest, spots]: [usize; 2],
        leaves_sq_m: f32,
        budget: usize,
    ) -> Twig<'a> {
        let (mut twig, summer) = Twig::full(foliage, atlas);
        let (sides, organ, kept) = (twig.sides, twig.organ, foliage.kept.clamp(0.0, 1.0));
        let (is_needle, least) = (organ == Organ::Needle, least(foliage));
        let one_sq_m = twig.own_sq_m();
        let needed = if foliage.is_bare() {
            spots as f32
        } else {
            (SEEN * kept * leaves_sq_m / one_sq_m.max(1e-9)).max(fewest as f32)
        };
        let enough = (needed.ceil() as usize).clamp(1, spots.max(1));
        let each = budget / enough;
        let full = twig.room().triangles;
        twig.build = Build::Light;
        // A flat needle hides less than a folded one.
        twig.whole = enough * if is_needle { full } else { twig.room().triangles };
        if each >= full {
            twig.build = Build::Full;
        } else {
            twig.outlines = atlas.leaf_outlines(organ.blade(Build::Light).rows());
            let (whole, wood) = (twig.room().triangles, twig.wood_room().triangles);
            let fewest = LEAST_SHARE[usize::from(!is_needle)];
            let share = each.saturating_sub(wood) as f32 / (whole - wood).max(1) as f32;
            let share = share.clamp(fewest, 1.0);
            // Few needles of each place, and few places; what rounding leaves goes to the main shoot.
            let (leaves, [most, _]) = (twig.leaves() as f32, twig.places);
            let each_place = twig.cluster as f32;
            let fewer = if twig.cluster > 3 { share.sqrt() } else { 1.0 };
            twig.cluster = ((each_place * fewer) as usize).max(1);
            let sparser = share * each_place / twig.cluster as f32;
            let all = (leaves / each_place * sparser) as usize;
            // The main shoot has no more than before.
            let beside = all.saturating_sub(most).div_ceil(sides);
            let side = ((summer[1] * kept * sparser) as usize).max(beside).max(least[1]);
            let main = all.saturating_sub(sides * side).clamp(least[0], most);
            twig.places = [main, side];
            if is_needle {
                twig.folded = each.saturating_sub(twig.room().triangles).min(twig.leaves());
            }
        }
        twig.count = (budget / twig.room().triangles.max(1)).min(enough);
        let missing = needed / twig.count.max(1) as f32;
        twig.scale = missing.sqrt().clamp(1.0, MOST_ENLARGED);
        let goal_sq_m = one_sq_m * (missing / (twig.scale * twig.scale)).max(1.0);
        if kept > 0.0 && twig.count > 0 {
            let hidden_sq_m =
                twig.widen(one_sq_m, goal_sq_m, MOST_WIDENED[usize::from(!is_needle)]);
            twig.cover = (hidden_sq_m / goal_sq_m.max(1e-12)).min(1.0);
        }
        twig
    }

    /// What one twig of the species counts for of the leaves' area in summer.
    pub fn counts_sq_m(foliage: &'a Foliage, atlas: &'a Atlas) -> f32 {
        Twig::full(foliage, atlas).0.own_sq_m() / SEEN
    }

    /// No less than [`Twig::counts_sq_m`], without measuring one: it would fill a square with its leaves around it.
    pub fn counts_at_most_sq_m(foliage: &Foliage) -> f32 {
        (foliage.twig_length_m + 2.0 * foliage.leaf_length_m).powi(2) / SEEN
    }

    /// Widens leaves by up to a factor of their area until the twig hides so much; gives what it does. `own_sq_m`:
    /// what one of all leaves does. By the secant through the last two logarithms: what is hidden grows by a power
    /// of the width that falls slowly, as leaves come to hide each other.
    fn widen(&mut self, own_sq_m: f32, goal_sq_m: f32, most: f32) -> f32 {
        const TRIES: u32 = 6;
        const POWERS: [f32; 2] = [0.2, 1.0];
        const NOTHING_SQ_M: f32 = 1e-12;
        let is_full = self.build == Build::Full;
        let is_needle = self.organ == Organ::Needle;
        let mut at = |wide: f32| {
            self.widened = if is_needle {
                Vec2::new(wide.powf(LENGTHENED), wide.powf(1.0 - LENGTHENED))
            } else {
                Vec2::splat(wide.sqrt())
            };
            self.hides_sq_m()
        };
        let own_sq_m = if is_full { own_sq_m } else { at(1.0) };
        let mut hidden_sq_m = own_sq_m.max(NOTHING_SQ_M);
        let (mut x, mut power, most) = (0.0, 0.9, most.ln());
        for _ in 0..TRIES {
            let is_enough = hidden_sq_m >= NEAR * goal_sq_m;
            if is_enough && (x == 0.0 || hidden_sq_m <= ENOUGH * goal_sq_m) {
                break;
            }
            let aim_sq_m = 0.5 * (NEAR + ENOUGH) * goal_sq_m;
            let next = (x + (aim_sq_m / hidden_sq_m).ln() / power).clamp(0.0, most);
            if next == x {
                break;
            }
            let before = (x, hidden_sq_m);
            (x, hidden_sq_m) = (next, at(next.exp()).max(NOTHING_SQ_M));
            power = (hidden_sq_m / before.1).ln() / (x - before.0);
            power = power.clamp(POWERS[0], POWERS[1]);
        }
        hidden_sq_m
    }

    pub fn stands_in(&self) -> StandIn {
        StandIn { size: self.widened.to_array(), whole: self.whole }
    }

    /// Makes leaves so much larger, as their twigs are.
    pub fn grow(&mut self, scale: f32) {
        self.widened *= scale;
        self.usual_m *= scale;
    }

    /// What a twig of the species' own leaves hides; this one is such.
    fn own_sq_m(&self) -> f32 {
        let f = self.foliage;
        let measures = [f.twig_length_m, f.leaf_length_m, f.leaf_width_m, f.kept];
        self.atlas.hidden_sq_m(measures, || self.hides_sq_m())
    }

    /// What one twig of the usual size hides, mean over the sides it is seen from.
    fn hides_sq_m(&self) -> f32 {
        const MEASURED: u64 = 2;
        let (room, pose) = (self.room(), Pose::measured(self.foliage));
        let of = |key: u64| {
            let draws = || Seed::new(0).derive("measured twig", key).draws();
            let twig = fill(1, room, |_, out| self.emit(&pose, &mut draws(), out), None);
            hidden_sq_m(&twig.position, &twig.index)
        };
        self.opaque() * (0..MEASURED).map(of).sum::<f32>() / MEASURED as f32
    }

    /// Opaque share of the outlines of leaves.
    fn opaque(&self) -> f32 {
        if self.organ == Organ::Needle {
            return 1.0;
        }
        let outlines: f32 = self.outlines.iter().map(|rows| area(rows)).sum();
        let seen: f32 = self.atlas.leaves().iter().map(|c| c.coverage).sum();
        (seen / outlines.max(1e-6)).clamp(0.1, 1.0)
    }

    /// Needles or leaves of a twig.
    fn leaves(&self) -> usize {
        (self.places[0] + self.sides * self.places[1]) * self.cluster
    }

    fn wood_room(&self) -> Room {
        let tube = |pieces: usize| match pieces {
            0 => Room { vertices: 3, triangles: 1 },
            _ => Room { vertices: 3 * (pieces + 1), triangles: 6 * pieces },
        };
        let [main, side] = self.build.pieces().map(tube);
        Room {
            vertices: main.vertices + self.sides * side.vertices,
            triangles: main.triangles + self.sides * side.triangles,
        }
    }

    /// Whether needles of one place share corners.
    fn has_fans(&self) -> bool {
        self.organ == Organ::Needle && self.build == Build::Light && self.cluster > 1
    }

    pub fn room(&self) -> Room {
        let (wood, leaf) = (self.wood_room(), self.organ.room(self.build));
        let leaves = self.leaves();
        let shared = if self.has_fans() { leaves - leaves / self.cluster } else { 0 };
        Room {
            vertices: wood.vertices + leaves * leaf.vertices - shared + self.folded,
            triangles: wood.triangles + leaves * leaf.triangles + self.folded,
        }
    }

    /// Share of the crown's outside in normals.
    pub fn bent(&self) -> f32 {
        BENT[usize::from(self.organ != Organ::Needle)]
    }

    /// One twig, its normals its own.
    pub fn emit(&self, pose: &Pose, draws: &mut Draws, out: &mut Piece) {
        let across = pose.heading.cross(pose.facing) * if pose.mirrored { -1.0 } else { 1.0 };
        let main = Shoot {
            base: pose.base,
            along: pose.heading,
            length: pose.size_m,
            sag: pose.sag,
            radius: 0.006 * pose.size_m,
        };
        self.shoot(&main, 0, pose, draws, out);
        let is_flat = stance(self.foliage.shape).is_flat || self.organ != Organ::Needle;
        for k in 0..self.sides {
            let t = 0.1 + 0.75 * (k as f32 + draws.between(0.2, 0.8)) / self.sides as f32;
            let side = if is_flat {
                across * if k % 2 == 0 { 1.0 } else { -1.0 }
            } else {
                Quat::from_axis_angle(pose.heading, k as f32 * GOLDEN_RAD) * across
            };
            let (sin, cos) = draws.between(0.65, 0.95).sin_cos();
            let along = (pose.heading * cos + side * sin + pose.facing * draws.between(-0.15, 0.2))
                .normalize_or(side);
            // Longest below the middle, short towards the tip.
            let shape = (t / 0.3).min(1.0).sqrt() * (1.15 - t);
            let length =
                (self.side_length * shape * draws.between(0.75, 1.2)).max(0.04) * pose.size_m;
            let (base, _) = main.at(t);
            let side = Shoot { base, along, length, sag: pose.sag, radius: 0.003 * pose.size_m };
            self.shoot(&side, k + 1, pose, draws, out);
        }
    }

    /// Whether the needle of a number, of those of a twig, is folded: evenly as many as are.
    fn is_folded(&self, number: usize) -> bool {
        let folded = |below: usize| below * self.folded / self.leaves().max(1);
        self.build == Build::Full || folded(number + 1) > folded(number)
    }

    /// The wood and leaves of a shoot: the main one (0), or a side shoot (from 1 on).
    fn shoot(&self, shoot: &Shoot, number: usize, pose: &Pose, draws: &mut Draws, out: &mut Piece) {
        let order = number.min(1);
        shoot.wood(self.build.pieces()[order], self.atlas.wood(), pose, out);
        let f = self.foliage;
        let places = self.places[order];
        let before = order * self.places[0] + number.saturating_sub(1) * self.places[1];
        let young_twig = (pose.size_m / self.usual_m).min(1.0).powf(YOUNG_LEAF);
        let leaf_m = Vec2::new(f.leaf_length_m, f.leaf_width_m) * self.widened * young_twig;
        // Turns as points of the unit circle.
        let mut around = Vec2::from_angle(draws.unit() * std::f32::consts::TAU);
        let golden = Vec2::from_angle(GOLDEN_RAD);
        let beside_it = Vec2::from_angle(self.step());
        for k in 0..places {
            let along_share = (k as f32 + draws.unit()) / places as f32;
            // A leafy shoot ends in a leaf.
            let is_last = self.organ != Organ::Needle && k + 1 == places;
            let along_share = if is_last { 1.0 } else { along_share };
            let t = self.from + (1.0 - self.from) * along_share;
            let (foot, along) = shoot.at(t);
            let across = along.any_orthonormal_vector();
            let beside = along.cross(across);
            let first = (before + k) * self.cluster;
            let place = Place { foot, along, across, beside, turn: around, t, leaf_m, first };
            around = around.rotate(golden);
            if self.has_fans() {
                self.fan(&place, pose, draws, out);
                continue;
            }
            let mut turn = place.turn;
            for nth in 0..self.cluster {
                let radial = place.radial(turn);
                turn = turn.rotate(beside_it);
                let leaf = self.leaf_pose(&place, radial, is_last, pose, draws);
                let cell = self.leaf_cell(draws);
                match self.organ {
                    Organ::Needle => {
                        let is_folded = self.is_folded(first + nth);
                        needle(&leaf, leaf_m.y, is_folded, cell.0, out);
                    }
                    Organ::Leaf => self.leaf(&leaf, cell, draws, out),
                    Organ::Compound(count) => self.compound(&leaf, count, cell, draws, out),
                }
            }
        }
    }

    /// How the next leaf of a place stands that leaves the shoot towards `radial`.
    fn leaf_pose(
        &self,
        place: &Place,
        radial: Vec3,
        is_last: bool,
        pose: &Pose,
        draws: &mut Draws,
    ) -> Pose {
        let Place { foot, along, t, leaf_m, .. } = *place;
        let radial = match self.organ {
            Organ::Needle => radial,
            // Broad leaves turn to the sides of their shoot.
            _ => (radial - pose.facing * 0.6 * radial.dot(pose.facing)).normalize_or(radial),
        };
        let spread = draws.between(self.opening[0], self.opening[1]);
        let spread = spread * if is_last { AT_TIP } else { 1.0 - 0.25 * t };
        let (sin, cos) = sin_cos(spread);
        let heading = along * cos + radial * sin;
        let heading = match self.organ {
            Organ::Needle => heading + pose.facing * 0.12,
            // Leaves hang a little from their petioles.
            _ => heading - Vec3::Z * draws.between(0.05, 0.45),
        };
        let heading = heading.normalize_or(along);
        let light = pose.facing + radial * 0.25 + draws.jitter() * 0.35;
        let facing = light - heading * light.dot(heading);
        let facing = facing.normalize_or(heading.any_orthonormal_vector());
        let young = 1.0 - 0.3 * t * t * t;
        let size_m = leaf_m.x * young * draws.between(0.75, 1.1);
        Pose { base: foot, heading, facing, size_m, ..*pose }
    }

    /// The angle from one needle or leaf of a place to the next, radians.
    fn step(&self) -> f32 {
        match self.cluster {
            4.. => GOLDEN_RAD,
            few => std::f32::consts::TAU / few.max(1) as f32 * 0.35,
        }
    }

    /// The needles of a place, a triangle each, or two that meet in a ridge: neighbours share a corner of
    /// their feet, which are laid end to end, each to the side on which they stay about the place.
    fn fan(&self, place: &Place, pose: &Pose, draws: &mut Draws, out: &mut Piece) {
        let cell = self.leaf_cell(draws).0;
        let half = 0.5 * RHOMBUS * place.leaf_m.y.max(1e-5);
        let (mut turn, step) = (place.turn, Vec2::from_angle(self.step()));
        let mut feet: Vec<Vec3> = Vec::with_capacity(self.cluster + 1);
        let mut needles: Vec<(Pose, Vec3)> = Vec::with_capacity(self.cluster);
        for _ in 0..self.cluster {
            let leaf = self.leaf_pose(place, place.radial(turn), false, pose, draws);
            turn = turn.rotate(step);
            let across = leaf.heading.cross(leaf.facing) * half;
            let low = *feet.last().unwrap_or(&(place.foot - across));
            let sides = [low + across * 2.0, low - across * 2.0];
            let [there, back] = sides.map(|p| p.distance_squared(place.foot));
            let high = sides[usize::from(back < there)];
            if feet.is_empty() {
                feet.push(low);
            }
            feet.push(high);
            let leaf = Pose { base: low.midpoint(high), ..leaf };
            // One side of all, so that one normal suits both needles of a corner.
            let like = needles.last().map_or(leaf.facing, |n| n.1);
            let front = if leaf.facing.dot(like) < 0.0 { -leaf.facing } else { leaf.facing };
            needles.push((leaf, front));
        }
        let mut before: Option<u32> = None;
        for (k, at) in feet.iter().enumerate() {
            let beside = needles[k.saturating_sub(1)..].iter().take(2 - usize::from(k == 0));
            let normal = beside.map(|n| n.1).sum();
            let u = if k % 2 == 0 { 0.35 } else { 0.65 };
            let corner = out.vertex(*at, normal, cell.uv(u, 0.4));
            if let Some(before) = before.replace(corner) {
                let (leaf, front) = &needles[k - 1];
                let (low, high) = (feet[k - 1], *at);
                let tip = out.vertex(leaf.tip(), *front, cell.uv(0.5, 0.95));
                let is_front = (high - low).cross(leaf.tip() - low).dot(*front) > 0.0;
                let [from, to] = if is_front { [before, corner] } else { [corner, before] };
                if self.is_folded(place.first + k - 1) {
                    let middle = low.midpoint(high) + *front * (0.6 * half);
                    let ridge = out.vertex(middle, *front, cell.uv(0.5, 0.4));
                    out.triangle([from, ridge, tip]);
                    out.triangle([ridge, to, tip]);
                } else {
                    out.triangle([from, to, tip]);
                }
            }
        }
    }

    fn leaf_cell(&self, draws: &mut Draws) -> (&Cell, &[Row]) {
        let cells = self.atlas.leaves();
        let pick = draws.index(cells.len());
        (&cells[pick], &self.outlines[pick])
    }

    /// A blade on a petiole.
    fn leaf(
        &self,
        pose: &Pose,
        (cell, outline): (&Cell, &[Row]),
        draws: &mut Draws,
        out: &mut Piece,
    ) {
        let f = self.foliage;
        let stalk = pose.size_m * draws.between(0.7, 1.1) * petiole(f.shape);
        let foot = pose.base + pose.heading * stalk;
        self.stalk(pose, foot, 0.02 * pose.size_m, out);
        let sag = draws.between(0.0, 0.2);
        // The cell holds a leaf and a margin.
        let size_m = pose.size_m * cell.size_m / f.leaf_length_m.max(1e-6);
        let base = foot - pose.heading * (cell.foot * size_m);
        let blade = Pose { base, size_m, sag, mirrored: draws.unit() < 0.5, ..*pose };
        let fold_rad = draws.between(0.1, 0.5);
        emit(&blade, self.organ.blade(self.build), fold_rad, cell, outline, out);
    }

    /// So many leaflets on a rachis.
    fn compound(
        &self,
        pose: &Pose,
        count: usize,
        (cell, outline): (&Cell, &[Row]),
        draws: &mut Draws,
        out: &mut Piece,
    ) {
        let f = self.foliage;
        let tip = pose.base + pose.heading * pose.size_m * 0.8;
        self.stalk(pose, tip, 0.012 * pose.size_m, out);
        let across = pose.heading.cross(pose.facing);
        let leaflet = 0.5 * f.leaf_width_m / f.leaf_length_m.max(1e-6) * pose.size_m;
        let size_m = leaflet.max(1e-5) * cell.size_m / (0.5 * f.leaf_width_m).max(1e-6);
        for n in 0..count {
            let is_last = n + 1 == count;
            let t = 0.25 + 0.55 * (n / 2) as f32 / ((count - 1) / 2).max(1) as f32;
            let t = if is_last { 0.8 } else { t.min(0.78) };
            let side = if n % 2 == 0 { across } else { -across };
            let turn = if is_last { 0.0 } else { draws.between(1.1, 1.3) };
            let heading = pose.heading * turn.cos() + side * turn.sin();
            let foot = pose.base + pose.heading * pose.size_m * t;
            let base = foot - heading * (cell.foot * size_m);
            let sag = draws.between(0.0, 0.15);
            let leaflet = Pose { base, heading, size_m, sag, ..*pose };
            emit(&leaflet, self.organ.blade(self.build), 0.2, cell, outline, out);
        }
    }

    /// A petiole or rachis: one triangle.
    fn stalk(&self, pose: &Pose, to: Vec3, half: f32, out: &mut Piece) {
        let across = pose.heading.cross(pose.facing) * half;
        let uv = self.atlas.fill();
        let corners =
            [pose.base - across, pose.base + across, to].map(|p| out.vertex(p, pose.facing, uv));
        out.triangle(corners);
    }
}

/// Leaves on the main shoot, and on each side shoot, however few hang.
fn least(foliage: &Foliage) -> [usize; 2] {
    [foliage.kept > 0.0, !foliage.is_bare()].map(usize::from)
}

/// Share of a cell within an outline.
fn area(outline: &[Row]) -> f32 {
    let wide = |r: &Row| r.right - r.left;
    outline.windows(2).map(|w| 0.5 * (w[1].t - w[0].t) * (wide(&w[0]) + wide(&w[1]))).sum()
}

/// Sine and cosine of an angle of 0…1.6 within 1e-6: Taylor's series.
fn sin_cos(x: f32) -> (f32, f32) {
    let y = x * x;
    let sin =
        1.0 - y / 6.0 * (1.0 - y / 20.0 * (1.0 - y / 42.0 * (1.0 - y / 72.0 * (1.0 - y / 110.0))));
    let cos =
        1.0 - y / 2.0 * (1.0 - y / 12.0 * (1.0 - y / 30.0 * (1.0 - y / 56.0 * (1.0 - y / 90.0))));
    (x * sin, cos)
}

/// Length of the petiole over that of the blade.
fn petiole(shape: LeafShape) -> f32 {
    match shape {
        LeafShape::Round => 0.7,
        LeafShape::Cordate => 0.45,
        LeafShape::Deltoid => 0.35,
        LeafShape::Lobed | LeafShape::Lanceolate => 0.08,
        _ => 0.2,
    }
}

/// A needle's silhouette over that of a rhombus as wide: a needle keeps its width to near its tip.
const RHOMBUS: f32 = 1.7;

/// A folded blade, widest below its middle, that hides as much as a needle; or a triangle that does.
fn needle(pose: &Pose, width_m: f32, is_folded: bool, cell: &Cell, out: &mut Piece) {
    let across = pose.heading.cross(pose.facing);
    let half = 0.5 * RHOMBUS * width_m.max(1e-5);
    let middle = pose.base + pose.heading * (0.4 * pose.size_m) - pose.facing * (0.6 * half);
    let ridge = pose.facing;
    let [right, left] = [0.5, -0.5].map(|lean| (ridge + across * lean).normalize_or(ridge));
    let tip = (pose.tip(), ridge, cell.uv(0.5, 0.95));
    if !is_folded {
        let right = (pose.base + across * half, right, cell.uv(0.65, 0.4));
        let left = (pose.base - across * half, left, cell.uv(0.35, 0.4));
        out.blade([right, tip, left], [[0, 1, 2]]);
        return;
    }
    out.blade(
        [
            (pose.base, ridge, cell.uv(0.5, 0.05)),
            (middle + across * half, right, cell.uv(0.65, 0.4)),
            tip,
            (middle - across * half, left, cell.uv(0.35, 0.4)),
        ],
        [[0, 1, 2], [0, 2, 3]],
    );
}

/// Where a shoot bears needles or leaves.
struct Place {
    foot: Vec3,
    /// Unit: the shoot's way, and two at right angles to it and each other.
    along: Vec3,
    across: Vec3,
    beside: Vec3,
    /// To which side the first leaf goes, as a point of the unit circle.
    turn: Vec2,
    /// Share of the shoot that lies before it.
    t: f32,
    /// Length and width of a leaf.
    leaf_m: Vec2,
    /// Number of its first leaf, of those of the twig.
    first: usize,
}

impl Place {
    fn radial(&self, turn: Vec2) -> Vec3 {
        self.across * turn.x + self.beside * turn.y
    }
}

/// A shoot of a twig, sinking towards its tip.
struct Shoot {
    base: Vec3,
    along: Vec3,
    length: f32,
    sag: f32,
    radius: f32,
}

impl Shoot {
    /// Place and unit direction at t, 0…1.
    fn at(&self, t: f32) -> (Vec3, Vec3) {
        let p = self.base + (self.along * t - Vec3::Z * (self.sag * t * t)) * self.length;
        let d = self.along - Vec3::Z * (2.0 * self.sag * t);
        (p, d.normalize_or(self.along))
    }

    /// Three-sided, thinning to its tip, where it is open; of no pieces a triangle.
    fn wood(&self, pieces: usize, uv: Vec2, pose: &Pose, out: &mut Piece) {
        if pieces == 0 {
            let across = self.along.cross(pose.facing).normalize_or(pose.heading) * self.radius;
            let corners = [self.base - across, self.base + across, self.at(1.0).0];
            let corners = corners.map(|p| out.vertex(p, pose.facing, uv));
            out.triangle(corners);
            return;
        }
        let mut before: Option<[u32; 3]> = None;
        let u = self.along.any_orthonormal_vector();
        let v = self.along.cross(u);
        for k in 0..=pieces {
            let t = k as f32 / pieces as f32;
            let (p, _) = self.at(t);
            let radius = self.radius * (1.0 - 0.75 * t);
            let ring = [0, 1, 2].map(|c| {
                let (sin, cos) = (c as f32 * std::f32::consts::TAU / 3.0).sin_cos();
                let away = u * cos + v * sin;
                out.vertex(p + away * radius, away, uv)
            });
            if let Some(low) = before {
                for c in 0..3 {
                    let d = (c + 1) % 3;
                    out.triangle([low[c], low[d], ring[d]]);
                    out.triangle([low[c], ring[d], ring[c]]);
                }
            }
            before = Some(ring);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::species::load;

    /// Of any species, and where leaves are longer than their twig.
    #[test]
    fn no_twig_counts_for_more_than_its_square() {
        for name in crate::species::builtin_names() {
            let species = load(name).unwrap();
            let atlas = crate::texture::tests::leafy(&species, 64, Seed::new(1)).atlas;
            let own = &species.foliage;
            let long = Foliage { leaf_length_m: 2.0 * own.twig_length_m, ..own.clone() };
            for f in [own, &long] {
                let [counts, most] = [Twig::counts_sq_m(f, &atlas), Twig::counts_at_most_sq_m(f)];
                assert!(counts <= most, "{name}: {counts} of {most} m²");
            }
        }
    }

    #[test]
    fn every_leafy_shoot_ends_in_a_leaf() {
        for name in ["corylus_avellana", "tilia_cordata", "sorbus_aucuparia"] {
            let species = load(name).unwrap();
            let atlas = crate::texture::tests::leafy(&species, 64, Seed::new(1)).atlas;
            let twig = Twig::new(&species.foliage, &atlas, [10; 2], 1.0, usize::MAX);
            let pose = Pose::measured(&species.foliage);
            let emit = |_, out: &mut Piece| twig.emit(&pose, &mut Seed::new(5).draws(), out);
            let s = fill(1, twig.room(), emit, None);
            let of = |uv: Vec2| {
                let with = s.uv.iter().zip(&s.position).filter(move |(at, _)| **at == uv);
                with.map(|(_, p)| *p).collect::<Vec<Vec3>>()
            };
            // Three rings more to the main shoot's tip, one to a side shoot's.
            let (wood, stalks) = (of(atlas.wood()), of(atlas.fill()));
            let ring = |k: usize| (wood[3 * k] + wood[3 * k + 1] + wood[3 * k + 2]) / 3.0;
            let tips =
                std::iter::once(ring(3)).chain((0..twig.sides).map(|side| ring(5 + 2 * side)));
            for tip in tips {
                let foot = |stalk: &[Vec3; 3]| 0.5 * (stalk[0] + stalk[1]);
                let near = stalks.as_chunks::<3>().0.iter().map(|k| foot(k).distance(tip));
                let nearest = near.fold(f32::INFINITY, f32::min);
                assert!(nearest < 1e-4, "{name}: a bare tip, the next leaf {nearest} m away");
            }
        }
    }

    /// Plainer leaves cost fewer triangles: where there is room for all of them, none is left out.
    #[test]
    fn plain_twigs_have_every_leaf_there_is_room_for() {
        for name in ["quercus_robur", "tilia_cordata", "populus_tremula", "salix_caprea"] {
            let species = load(name).unwrap();
            let atlas = crate::texture::tests::leafy(&species, 64, Seed::new(1)).atlas;
            let made = |budget| Twig::new(&species.foliage, &atlas, [10; 2], 1e-6, budget);
            let full = made(usize::MAX);
            let plain = made(10 * full.room().triangles - 1);
            assert_eq!(plain.build, Build::Light);
            assert_eq!(plain.leaves(), full.leaves(), "{name}");
        }
    }

    /// As many triangles as a twig says all of them take suffice for leaves of the species' own size.
    #[test]
    fn leaves_are_as_large_as_the_species_where_they_say_so() {
        for name in ["quercus_robur", "larix_sibirica", "picea_abies", "sorbus_aucuparia"] {
            let species = load(name).unwrap();
            let atlas = crate::texture::tests::leafy(&species, 64, Seed::new(1)).atlas;
            let made = |budget| Twig::new(&species.foliage, &atlas, [2_000; 2], 150.0, budget);
            let whole = made(usize::MAX).stands_in().whole;
            let size = |budget| made(budget).stands_in().size;
            assert!(size(whole).iter().all(|s| *s < 1.05), "{name}: {:?}", size(whole));
            assert!(size(whole / 3).iter().any(|s| *s > 1.1), "{name}: {:?}", size(whole / 3));
        }
    }

    /// Wider leaves hide what those left out did, and hardly more.
    #[test]
    fn leaves_are_no_wider_than_it_takes() {
        for name in ["quercus_robur", "larix_sibirica", "picea_abies", "sorbus_aucuparia"] {
            let species = load(name).unwrap();
            let atlas = crate::texture::tests::leafy(&species, 64, Seed::new(1)).atlas;
            let of = |budget| Twig::new(&species.foliage, &atlas, [2_000; 2], 150.0, budget);
            let whole = of(usize::MAX).stands_in().whole;
            let mut wider = 0;
            for share in 2..12 {
                let twig = of(whole / share);
                let all_sq_m = twig.hides_sq_m() * twig.count as f32 * twig.scale * twig.scale;
                let off = all_sq_m / (SEEN * 150.0);
                if twig.cover > 0.9999 && twig.widened.y > 1.02 {
                    assert!((0.998..1.012).contains(&off), "{name}, 1/{share}: {off}");
                    wider += 1;
                }
            }
            assert!(wider > 3, "{name}: {wider}");
        }
    }

    #[test]
    fn sines_are_those_of_the_library() {
        for k in 0..=1600 {
            let x = k as f32 * 1e-3;
            let (sin, cos) = sin_cos(x);
            assert!((sin - x.sin()).abs() < 1e-6 && (cos - x.cos()).abs() < 1e-6, "{x}");
        }
    }
}
