//! Twig cards on the shoots that bear leaves.
//!
//! Cards stand along each bearing shoot by the species' phyllotaxis, one more prolongs its tip.
//! Each is turned to the light as far as its twig allows, hangs or stands by `droop`, and is
//! folded along its midrib or crossed with a second one, so that the crown has depth from every
//! side. Normals lean to the crown's outside, for soft shading.
//!
//! With a budget, cards are thinned evenly (inside the crown first) and the rest enlarged, with
//! boughs of the atlas in place of twigs.

use glam::{Quat, Vec3};

use super::card::{Card, Shape, emit};
use super::{MeshOptions, Surface};
use crate::seed::Seed;
use crate::skeleton::{Axis, Skeleton};
use crate::species::Species;
use crate::species::model::LeafShape;
use crate::texture::Atlas;
use crate::texture::atlas::Row;

const GOLDEN_RAD: f32 = 2.399_963;
/// Cards a tree may have at most.
const MOST_CARDS: usize = 2_000_000;
/// How far cards may grow to make up for those left out.
const MOST_ENLARGED: f32 = 2.8;

/// A place for a card.
#[derive(Debug, Clone, Copy)]
struct Spot {
    at: Vec3,
    /// Direction of the shoot.
    shoot: Vec3,
    /// Count along the axis, for phyllotaxis.
    turn: u32,
    is_tip: bool,
    key: u64,
}

/// The crown as an upright ellipsoid: says which way is out.
#[derive(Debug, Clone, Copy)]
struct Hull {
    centre: Vec3,
    half: Vec3,
}

impl Hull {
    fn around(spots: &[Spot]) -> Hull {
        let mut lo = Vec3::splat(f32::INFINITY);
        let mut hi = Vec3::splat(f32::NEG_INFINITY);
        for s in spots {
            lo = lo.min(s.at);
            hi = hi.max(s.at);
        }
        let centre =
            Vec3::new(0.5 * (lo.x + hi.x), 0.5 * (lo.y + hi.y), lo.z + 0.35 * (hi.z - lo.z));
        Hull { centre, half: ((hi - lo) * Vec3::new(0.5, 0.5, 0.65)).max(Vec3::splat(0.05)) }
    }

    /// Unit direction outwards at a place, and how far out that is (1 at the hull).
    fn outward(&self, p: Vec3) -> (Vec3, f32) {
        let q = (p - self.centre) / self.half;
        ((q / self.half).normalize_or(Vec3::Z), q.length())
    }

    /// Size of a card at a place over the length of a twig: less towards the top, where shoots are
    /// young.
    fn scale(&self, p: Vec3, enlarge: f32) -> f32 {
        let height = ((p.z - self.centre.z) / (1.5 * self.half.z)).clamp(0.0, 1.0);
        (1.0 - 0.4 * height * height) * (1.0 + (enlarge - 1.0) * (1.0 - 0.45 * height))
    }
}

/// Cards for a tree. `budget`: triangles they may take.
pub fn foliage(
    skeleton: &Skeleton,
    axes: &[Axis],
    species: &Species,
    atlas: &Atlas,
    budget: Option<usize>,
    options: &MeshOptions,
    seed: Seed,
) -> Surface {
    let shape = shape_of(species, options.detail);
    let mut spots = spots(skeleton, axes, species);
    // The crown is that of all spots, however few bear leaves; the same ones at any budget.
    let hull = Hull::around(&spots);
    let share = options.leaf_share.clamp(0.0, 1.0);
    if share < 1.0 {
        spots.retain(|s| seed.derive("borne", s.key).draws().unit() < share);
    }
    let mut out = Surface::default();
    if spots.is_empty() {
        return out;
    }
    let most = budget.map_or(MOST_CARDS, |b| b / shape.triangles()).min(MOST_CARDS);
    let kept = spots.len().min(most);
    let enlarge = enlarged(&hull, species, atlas, kept, spots.len(), share);
    // Cards deep inside the crown go first; where they are small more stay, so that a spire is as
    // full at its tip as below.
    let weight = |s: &Spot| {
        let small = hull.scale(Vec3::ZERO, enlarge) / hull.scale(s.at, enlarge);
        f64::from(hull.outward(s.at).1.clamp(0.35, 1.0) * small * small)
    };
    let weights: Vec<f64> = spots.iter().map(weight).collect();
    let total: f64 = weights.iter().sum();
    let rate = (most as f64 / total).min(f64::INFINITY);
    out.position.reserve(kept * shape.vertices());
    out.normal.reserve(kept * shape.vertices());
    out.uv.reserve(kept * shape.vertices());
    out.index.reserve(kept * shape.triangles() * 3);
    let outlines: Vec<Vec<Row>> = atlas.cells().iter().map(|c| c.outline(shape.rows())).collect();
    let mut due = 0.5;
    for (spot, weight) in spots.iter().zip(&weights) {
        if kept < spots.len() {
            due += (weight * rate).min(1.0);
            if due < 1.0 {
                continue;
            }
            due -= 1.0;
        }
        place(spot, species, atlas, &outlines, &hull, shape, enlarge, seed, &mut out);
    }
    out
}

/// How much larger than a twig cards are, so that the leaves cover as much of the crown's hull as the
/// species' do; bounded by what thinning took away.
fn enlarged(
    hull: &Hull,
    species: &Species,
    atlas: &Atlas,
    kept: usize,
    all: usize,
    share: f32,
) -> f32 {
    let cells = atlas.cells();
    let coverage = cells.iter().map(|c| c.coverage).sum::<f32>() / cells.len() as f32;
    // Area of an ellipsoid (Thomsen), near enough.
    let p = 1.6f32;
    let [a, b, c] = (hull.half.to_array()).map(|h| h.powf(p));
    let area = 4.0 * std::f32::consts::PI * ((a * b + a * c + b * c) / 3.0).powf(1.0 / p);
    let twig = species.foliage.twig_length_m.max(1e-3);
    let one = coverage.max(0.05) * twig * twig * 0.8;
    let wanted = share * species.foliage.cover.clamp(0.0, 1.0) * area / (kept.max(1) as f32 * one);
    let thinned = all as f32 / kept.max(1) as f32;
    wanted.min(thinned.max(3.0) * 2.0).max(1.0).sqrt().clamp(1.0, MOST_ENLARGED)
}

fn shape_of(species: &Species, detail: bool) -> Shape {
    match (species.foliage.shape, detail) {
        (LeafShape::Tuft | LeafShape::Bundle, false) => Shape::Crossed { rows: 2 },
        (LeafShape::Tuft | LeafShape::Bundle, true) => Shape::Crossed { rows: 3 },
        (_, false) => Shape::Folded { rows: 2 },
        (_, true) => Shape::Folded { rows: 3 },
    }
}

/// Every place for a card, in the order of axes and from base to tip.
fn spots(skeleton: &Skeleton, axes: &[Axis], species: &Species) -> Vec<Spot> {
    let f = &species.foliage;
    let bears = skeleton.bears_leaves(f.bearing_radius_m);
    let length: f32 = (0..skeleton.len() as u32)
        .filter(|&i| bears[i as usize])
        .map(|i| skeleton.internode_m(i))
        .sum();
    // Never more than the limit, however dense the species.
    let per_m = f.twigs_per_m.clamp(0.01, 200.0).min(MOST_CARDS as f32 / length.max(1e-3));
    let mut out = Vec::with_capacity((length * per_m) as usize + axes.len());
    for axis in axes {
        let count = axis.nodes.len();
        let mut due = 0.5;
        let mut turn = (axis.nodes.first().copied().unwrap_or(0)) % 89;
        for (k, &i) in axis.nodes.iter().enumerate() {
            let Some(parent) = skeleton.parent_of(i).filter(|_| bears[i as usize]) else {
                continue;
            };
            let (a, b) = (skeleton.position[parent as usize], skeleton.position[i as usize]);
            let step = b - a;
            let run = step.length();
            let shoot = step.normalize_or(Vec3::Z);
            let first = due;
            due += run * per_m;
            let cards = due.floor().max(0.0) as usize;
            for c in 0..cards {
                let t = ((c as f32 + 1.0 - first) / (run * per_m).max(1e-9)).clamp(0.0, 1.0);
                out.push(Spot {
                    at: a + step * t,
                    shoot,
                    turn,
                    is_tip: false,
                    key: (u64::from(i) << 16) | c as u64,
                });
                turn += 1;
            }
            due -= cards as f32;
            if k + 1 == count {
                out.push(Spot {
                    at: b,
                    shoot,
                    turn,
                    is_tip: true,
                    key: (u64::from(i) << 16) | 0xffff,
                });
            }
        }
    }
    out
}

/// How the twigs of a leaf shape stand.
struct Stance {
    /// Angle from the shoot, radians.
    angle: f32,
    /// Twigs left and right of the shoot in one plane, rather than all round.
    is_flat: bool,
    /// Downward (+) fold of both halves, radians.
    fold: f32,
    /// Spread of the roll about the twig, radians.
    roll: f32,
    /// Share of the light from above against that from outside in turning a card.
    from_above: f32,
}

fn stance(shape: LeafShape) -> Stance {
    let s =
        |angle, is_flat, fold, roll, from_above| Stance { angle, is_flat, fold, roll, from_above };
    match shape {
        LeafShape::Needle => s(0.85, true, 0.5, 0.45, 0.75),
        LeafShape::Tuft => s(0.9, false, 0.0, 0.6, 0.6),
        LeafShape::Bundle => s(0.75, false, 0.0, 0.9, 0.6),
        LeafShape::Deltoid => s(0.7, false, 0.45, 0.7, 0.35),
        LeafShape::Lanceolate => s(0.6, false, 0.45, 0.7, 0.45),
        LeafShape::Ovate | LeafShape::Round | LeafShape::Lobed => s(0.85, false, 0.5, 0.6, 0.55),
    }
}

#[allow(clippy::too_many_arguments)]
fn place(
    spot: &Spot,
    species: &Species,
    atlas: &Atlas,
    outlines: &[Vec<Row>],
    hull: &Hull,
    shape: Shape,
    enlarge: f32,
    seed: Seed,
    out: &mut Surface,
) {
    let f = &species.foliage;
    let stance = stance(f.shape);
    let mut draws = seed.derive("card", spot.key).draws();
    let (outward, _) = hull.outward(spot.at);
    let shoot = spot.shoot;

    // Heading: off the shoot by phyllotaxis, then drawn down (or up).
    let side = if stance.is_flat {
        let flat =
            shoot.cross(Vec3::Z).try_normalize().unwrap_or_else(|| shoot.any_orthonormal_vector());
        if spot.turn.is_multiple_of(2) { flat } else { -flat }
    } else {
        let start = shoot.any_orthonormal_vector();
        Quat::from_axis_angle(shoot, spot.turn as f32 * GOLDEN_RAD) * start
    };
    let angle = if spot.is_tip { 0.0 } else { stance.angle * draws.between(0.75, 1.2) };
    let mut heading = shoot * angle.cos() + side * angle.sin();
    heading += draws.direction() * 0.14 + outward * 0.2;
    let droop = (f.droop * draws.between(0.7, 1.15)).clamp(-0.95, 0.95);
    heading = heading.normalize_or(shoot);
    heading = (heading * (1.0 - droop.abs()) - Vec3::Z * droop).normalize_or(heading);

    // Face the light.
    let light = Vec3::Z * stance.from_above + outward * (1.0 - stance.from_above);
    let facing = light - heading * light.dot(heading);
    let facing = facing.try_normalize().unwrap_or_else(|| heading.any_orthonormal_vector());
    let roll = draws.between(-stance.roll, stance.roll);
    let facing = Quat::from_axis_angle(heading, roll) * facing;

    let size_m = f.twig_length_m.min(0.6 * hull.half.max_element()).clamp(1e-3, 20.0)
        * draws.between(0.8, 1.2)
        * hull.scale(spot.at, enlarge);
    let cells = atlas.nearest(size_m);
    let pick = draws.index(cells.clone().count());
    let Some(id) = cells.clone().nth(pick) else { return };
    let card = Card {
        base: spot.at - heading * (0.04 * size_m),
        heading,
        facing,
        size_m,
        fold_rad: stance.fold * draws.between(0.6, 1.3),
        // The outer part sinks under its weight, except where it stands.
        sag: if f.droop >= 0.0 { draws.between(0.05, 0.28) } else { 0.0 },
        mirrored: draws.unit() < 0.5,
        outward,
        crown: hull.centre,
    };
    emit(&card, shape, &atlas.cells()[id], &outlines[id], out);
}
