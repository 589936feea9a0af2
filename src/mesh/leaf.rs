//! A twig leaf by leaf: a shoot with side shoots, and on them every needle or every leaf with its
//! petiole [P18].
//!
//! Needles and leaves stand about their shoot by the golden angle, or left and right of it in flat
//! sprays; they open from it, sink under their weight and turn their upper side to the light as
//! far as their heading allows; towards the tip of the shoot they are smaller. A needle is a
//! folded blade of two triangles, a leaf a card of its own cell, a compound leaf a rachis with its
//! leaflets.
//!
//! Every twig of a tree has the same number of triangles, so that a budget is met exactly. Limits:
//! twigs do not know of each other and may cross; needles are as wide as they must be to fill the
//! crown when a budget leaves some out, to [`MOST_WIDENED`].

use glam::{Quat, Vec2, Vec3};

use super::card::{Shape, emit};
use super::piece::{Piece, Room};
use super::spot::{GOLDEN_RAD, Pose, stance};
use crate::seed::Draws;
use crate::species::model::{Foliage, LeafShape};
use crate::texture::atlas::{Atlas, Cell, Row};

/// Least share of a twig's needles, or leaves, that a budget leaves on it before whole twigs go.
const LEAST_SHARE: [f32; 2] = [0.2, 0.5];
/// How far the area of needles or leaves may grow to make up for those left out.
const MOST_WIDENED: f32 = 3.0;
/// Places for needles or leaves on one shoot at most.
const MOST_PLACES: f32 = 4_000.0;
/// Share of the crown's outside in a normal.
const BENT: f32 = 0.45;
/// Straight pieces of a twig's main shoot and of a side shoot.
const PIECES: [usize; 2] = [3, 1];

#[derive(Debug, Clone, Copy, PartialEq)]
enum Organ {
    Needle,
    /// One blade on a petiole.
    Leaf,
    /// So many leaflets on a rachis.
    Compound(usize),
}

impl Organ {
    fn room(self) -> Room {
        let leaf = Shape::Folded { rows: 3 }.room();
        let leaflet = Shape::Folded { rows: 2 }.room();
        let with_stalk = |blade: Room, count: usize| Room {
            vertices: 3 + blade.vertices * count,
            triangles: 1 + blade.triangles * count,
        };
        match self {
            Organ::Needle => Room { vertices: 4, triangles: 2 },
            Organ::Leaf => with_stalk(leaf, 1),
            Organ::Compound(count) => with_stalk(leaflet, count),
        }
    }
}

/// How a species' twigs are built.
pub struct Twig<'a> {
    foliage: &'a Foliage,
    atlas: &'a Atlas,
    outlines: Vec<Vec<Row>>,
    organ: Organ,
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
    widened: Vec2,
}

impl<'a> Twig<'a> {
    /// The twig of a tree that may spend `budget` triangles on `spots` of them.
    pub fn new(foliage: &'a Foliage, atlas: &'a Atlas, spots: usize, budget: usize) -> Twig<'a> {
        let (sides, side_length, from, opening) = match foliage.shape {
            LeafShape::Needle => (8, 0.45, 0.02, [0.6, 1.1]),
            LeafShape::Tuft => (5, 0.3, 0.06, [0.5, 1.35]),
            LeafShape::Bundle => (4, 0.4, 0.35, [0.4, 1.1]),
            LeafShape::Deltoid => (4, 0.35, 0.1, [0.8, 1.3]),
            LeafShape::Lanceolate => (4, 0.4, 0.1, [0.5, 0.9]),
            _ => (4, 0.4, 0.15, [0.8, 1.2]),
        };
        let cluster = foliage.cluster.clamp(1, 200) as usize;
        let is_needle =
            matches!(foliage.shape, LeafShape::Needle | LeafShape::Tuft | LeafShape::Bundle);
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
            LeafShape::Round => 1.6,
            LeafShape::Pinnate => 3.0,
            _ => 2.4,
        };
        let length = foliage.twig_length_m / foliage.leaf_length_m.max(1e-4) * (1.0 - from);
        let kept = foliage.kept.clamp(0.0, 1.0);
        let full = [length, length * side_length * 0.75]
            .map(|l| (l * density).clamp(1.0, MOST_PLACES) * kept);
        let least = usize::from(kept > 0.0);
        let outlines = |rows| atlas.leaves().iter().map(|c| c.outline(rows)).collect();
        let mut twig = Twig {
            foliage,
            atlas,
            outlines: outlines(if organ == Organ::Leaf { 3 } else { 2 }),
            organ,
            cluster: if organ == Organ::Needle { cluster } else { 1 },
            sides,
            side_length,
            from,
            opening,
            places: full.map(|n| (n.round() as usize).max(least)),
            widened: Vec2::ONE,
        };
        let wood = twig.wood_room().triangles;
        let each = budget / spots.max(1);
        let whole = twig.room().triangles;
        if each < whole {
            let fewest = LEAST_SHARE[usize::from(!is_needle)];
            let share = each.saturating_sub(wood) as f32 / (whole - wood).max(1) as f32;
            let share = share.clamp(fewest, 1.0);
            // Of tufts some needles go, and some places.
            let [fewer, sparser] =
                if twig.cluster > 3 { [share.sqrt(), share.sqrt()] } else { [1.0, share] };
            twig.cluster = ((twig.cluster as f32 * fewer) as usize).max(1);
            twig.places = full.map(|n| ((n * sparser) as usize).max(least));
            let wide = (1.0 / share).min(MOST_WIDENED);
            twig.widened = if is_needle { Vec2::new(1.0, wide) } else { Vec2::splat(wide.sqrt()) };
        }
        twig
    }

    fn wood_room(&self) -> Room {
        let tube = |k: usize| Room { vertices: 3 * (PIECES[k] + 1), triangles: 6 * PIECES[k] };
        let (main, side) = (tube(0), tube(1));
        Room {
            vertices: main.vertices + self.sides * side.vertices,
            triangles: main.triangles + self.sides * side.triangles,
        }
    }

    pub fn room(&self) -> Room {
        let (wood, leaf) = (self.wood_room(), self.organ.room());
        let leaves = (self.places[0] + self.sides * self.places[1]) * self.cluster;
        Room {
            vertices: wood.vertices + leaves * leaf.vertices,
            triangles: wood.triangles + leaves * leaf.triangles,
        }
    }

    /// One twig.
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
            self.shoot(&side, 1, pose, draws, out);
        }
    }

    /// A shoot's wood and leaves; `order`: 0 the main one, 1 a side shoot.
    fn shoot(&self, shoot: &Shoot, order: usize, pose: &Pose, draws: &mut Draws, out: &mut Piece) {
        shoot.wood(PIECES[order], self.atlas.wood(), pose, out);
        let f = self.foliage;
        let places = self.places[order];
        // Turns as points of the unit circle.
        let mut around = Vec2::from_angle(draws.unit() * std::f32::consts::TAU);
        let golden = Vec2::from_angle(GOLDEN_RAD);
        let beside_it = match self.cluster {
            4.. => golden,
            few => Vec2::from_angle(std::f32::consts::TAU / few.max(1) as f32 * 0.35),
        };
        for k in 0..places {
            let along_share = (k as f32 + draws.unit()) / places as f32;
            let t = self.from + (1.0 - self.from) * along_share;
            let (foot, along) = shoot.at(t);
            let young = 1.0 - 0.3 * t * t * t;
            let across = along.any_orthonormal_vector();
            let beside = along.cross(across);
            // Needles of one place fan out about it.
            let mut turn = around;
            around = around.rotate(golden);
            for _ in 0..self.cluster {
                let mut radial = across * turn.x + beside * turn.y;
                turn = turn.rotate(beside_it);
                if self.organ != Organ::Needle {
                    // Broad leaves turn to the sides of their shoot.
                    radial =
                        (radial - pose.facing * 0.6 * radial.dot(pose.facing)).normalize_or(radial);
                }
                let spread = draws.between(self.opening[0], self.opening[1]);
                let (sin, cos) = sin_cos(spread * (1.0 - 0.25 * t));
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
                let size = f.leaf_length_m * young * draws.between(0.75, 1.1) * self.widened.x;
                let cell = self.leaf_cell(draws);
                let leaf = Pose { base: foot, heading, facing, size_m: size, ..*pose };
                self.leaf(&leaf, cell, draws, out);
            }
        }
    }

    fn leaf_cell(&self, draws: &mut Draws) -> (&Cell, &[Row]) {
        let cells = self.atlas.leaves();
        let pick = draws.index(cells.len());
        (&cells[pick], &self.outlines[pick])
    }

    fn leaf(
        &self,
        pose: &Pose,
        (cell, outline): (&Cell, &[Row]),
        draws: &mut Draws,
        out: &mut Piece,
    ) {
        let f = self.foliage;
        match self.organ {
            Organ::Needle => needle(pose, f.leaf_width_m * self.widened.y, cell, out),
            Organ::Leaf => {
                let stalk = pose.size_m * draws.between(0.7, 1.1) * petiole(f.shape);
                let foot = pose.base + pose.heading * stalk;
                self.stalk(pose, foot, 0.02 * pose.size_m, out);
                let sag = draws.between(0.0, 0.2);
                // The cell holds a leaf and a margin.
                let size_m = pose.size_m * cell.size_m / f.leaf_length_m.max(1e-6);
                let blade = Pose { base: foot, size_m, sag, mirrored: draws.unit() < 0.5, ..*pose };
                emit(
                    &blade,
                    Shape::Folded { rows: 3 },
                    draws.between(0.1, 0.5),
                    cell,
                    outline,
                    out,
                );
            }
            Organ::Compound(count) => {
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
                    let base = pose.base + pose.heading * pose.size_m * t;
                    let sag = draws.between(0.0, 0.15);
                    let leaflet = Pose { base, heading, size_m, sag, ..*pose };
                    emit(&leaflet, Shape::Folded { rows: 2 }, 0.2, cell, outline, out);
                }
            }
        }
    }

    /// A petiole or rachis: one triangle.
    fn stalk(&self, pose: &Pose, to: Vec3, half: f32, out: &mut Piece) {
        let across = pose.heading.cross(pose.facing) * half;
        let uv = self.atlas.fill();
        let corners = [pose.base - across, pose.base + across, to]
            .map(|p| out.vertex(p, pose.bent(pose.facing, p, BENT), uv));
        out.triangle(corners);
    }
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
        LeafShape::Round => 0.5,
        LeafShape::Deltoid => 0.35,
        LeafShape::Lobed | LeafShape::Lanceolate => 0.08,
        _ => 0.2,
    }
}

/// A needle's silhouette over that of a rhombus as wide: a needle keeps its width to near its tip.
const RHOMBUS: f32 = 1.7;

/// A folded blade, widest below its middle, that hides as much as a needle.
fn needle(pose: &Pose, width_m: f32, cell: &Cell, out: &mut Piece) {
    let across = pose.heading.cross(pose.facing);
    let half = 0.5 * RHOMBUS * width_m.max(1e-5);
    let middle = pose.base + pose.heading * (0.4 * pose.size_m) - pose.facing * (0.6 * half);
    // A needle is short: all of it lies one way from the crown's middle.
    let bent = pose.bent(pose.facing, middle, BENT);
    let lean = across * (0.5 * (1.0 - BENT));
    let [ridge, right, left] = [bent, bent + lean, bent - lean].map(|n| n.normalize_or(Vec3::Z));
    out.blade(
        [
            (pose.base, ridge, cell.uv(0.5, 0.05)),
            (middle + across * half, right, cell.uv(0.65, 0.4)),
            (pose.base + pose.heading * pose.size_m, ridge, cell.uv(0.5, 0.95)),
            (middle - across * half, left, cell.uv(0.35, 0.4)),
        ],
        [[0, 1, 2], [0, 2, 3]],
    );
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

    /// Three-sided, thinning to its tip, where it is open.
    fn wood(&self, pieces: usize, uv: Vec2, pose: &Pose, out: &mut Piece) {
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
                out.vertex(p + away * radius, pose.bent(away, p, 0.15), uv)
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

    #[test]
    fn sines_are_those_of_the_library() {
        for k in 0..=1600 {
            let x = k as f32 * 1e-3;
            let (sin, cos) = sin_cos(x);
            assert!((sin - x.sin()).abs() < 1e-6 && (cos - x.cos()).abs() < 1e-6, "{x}");
        }
    }
}
