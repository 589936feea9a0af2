//! One twig card: a few rows across a cell of the atlas, cut to what is seen in it, folded along
//! the midrib or crossed with a second card, sagging towards its tip. A single leaf is the same,
//! small, from a cell that shows one leaf.

use glam::{Quat, Vec2, Vec3};

use super::piece::{Piece, Room};
use super::spot::Pose;
use crate::species::model::LeafShape;
use crate::texture::Cell;
use crate::texture::atlas::Row;

/// The form of cards.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Shape {
    /// Two halves that meet in the midrib at an angle.
    Folded { rows: usize },
    /// Two flat cards that share the midrib.
    Crossed { rows: usize },
    /// Four corners.
    Flat,
}

impl Shape {
    pub fn rows(self) -> usize {
        match self {
            Shape::Folded { rows } | Shape::Crossed { rows } => rows.max(2),
            Shape::Flat => 2,
        }
    }

    /// That of a twig's card.
    pub fn of(shape: LeafShape, detail: bool) -> Shape {
        let rows = if detail { 3 } else { 2 };
        match shape {
            LeafShape::Bundle => Shape::Crossed { rows },
            _ => Shape::Folded { rows },
        }
    }

    pub fn room(self) -> Room {
        let rows = self.rows();
        let (columns, sheets) = match self {
            Shape::Folded { .. } => (3, 1),
            Shape::Crossed { .. } => (2, 2),
            Shape::Flat => (2, 1),
        };
        Room {
            vertices: columns * sheets * rows,
            triangles: 2 * (columns - 1) * sheets * (rows - 1),
        }
    }
}

/// Share of the crown's outside in a normal, against the card's own.
const BENT: f32 = 0.5;

/// Adds a card; `fold_rad`: how far each half folds down.
pub fn emit(
    pose: &Pose,
    shape: Shape,
    fold_rad: f32,
    cell: &Cell,
    outline: &[Row],
    out: &mut Piece,
) {
    let (facing, across) = (pose.facing, pose.heading.cross(pose.facing));
    match shape {
        Shape::Folded { .. } => {
            let (sin, cos) = fold_rad.sin_cos();
            // Each half with its direction away from the midrib and its own normal.
            let left = (across * -cos - facing * sin, facing * cos - across * sin);
            let right = (across * cos - facing * sin, facing * cos + across * sin);
            sheet(pose, cell, outline, &[left, right], Some(facing), out);
        }
        Shape::Flat => {
            // One sheet for two halves lies as the one or the other does.
            let turn = if pose.mirrored { fold_rad } else { -fold_rad };
            let turn = Quat::from_axis_angle(pose.heading, turn);
            let (facing, across) = (turn * facing, turn * across);
            sheet(pose, cell, outline, &[(-across, facing), (across, facing)], None, out);
        }
        Shape::Crossed { .. } => {
            sheet(pose, cell, outline, &[(-across, facing), (across, facing)], None, out);
            let turned = Pose { mirrored: !pose.mirrored, ..*pose };
            let flat = [(-facing, -across), (facing, -across)];
            sheet(&turned, cell, outline, &flat, None, out);
        }
    }
}

/// What a stalk takes.
pub const STALK: Room = Room { vertices: 3, triangles: 1 };
/// Thinner and shorter ones are not made.
const LEAST_STALK_M: [f32; 2] = [0.002, 0.02];

/// The bare shoot from wood to the foot of a card, as one slender triangle of the colour at `uv`.
pub fn stalk(pose: &Pose, from: Vec3, radius_m: f32, uv: Vec2, out: &mut Piece) {
    let [thin_m, short_m] = LEAST_STALK_M;
    let way = pose.base - from;
    let (way, from) = match way.length() < short_m {
        true => (pose.heading * short_m, pose.base - pose.heading * short_m),
        false => (way, from),
    };
    let any = way.normalize_or(Vec3::Z).any_orthonormal_vector();
    let across = way.cross(pose.facing).normalize_or(any);
    let facing = across.cross(way).normalize_or(pose.facing);
    let half = across * radius_m.max(thin_m);
    let mut put = |p: Vec3| out.vertex(p, pose.bent(facing, p, BENT), uv);
    let corners = [put(from - half), put(from + half), put(pose.base)];
    out.triangle(corners);
}

/// One sheet: a left and a right edge (direction away from the midrib, normal) and, where
/// `middle` is given, the midrib between them.
fn sheet(
    pose: &Pose,
    cell: &Cell,
    outline: &[Row],
    sides: &[(Vec3, Vec3); 2],
    middle: Option<Vec3>,
    out: &mut Piece,
) {
    // Seen from outside the crown, the front shows: a viewer's light agrees with the normals.
    let own = middle.unwrap_or(sides[0].1);
    let is_front = own.dot(pose.outward) >= 0.0;
    let sign = if is_front { 1.0 } else { -1.0 };
    let mut first = None;
    for row in outline {
        let (l, r) = (0.5 - row.left, row.right - 0.5);
        // A mirrored card swaps the two sides of the picture.
        let (l, r) = if pose.mirrored { (r, l) } else { (l, r) };
        let s = |away: f32| if pose.mirrored { 0.5 - away } else { 0.5 + away };
        let mut put = |s: f32, edge: Vec3, reach: f32, lean: Vec3| {
            let t = row.t;
            let fall = Vec3::new(0.0, 0.0, -pose.sag * t * t);
            let p = pose.base + (pose.heading * t + edge * reach + fall) * pose.size_m;
            out.vertex(p, pose.bent(lean * sign, p, BENT), cell.uv(s, t))
        };
        let left = put(s(-l), sides[0].0, l, sides[0].1);
        first.get_or_insert(left);
        if let Some(lean) = middle {
            put(0.5, Vec3::ZERO, 0.0, lean);
        }
        put(s(r), sides[1].0, r, sides[1].1);
    }
    let columns = if middle.is_some() { 3 } else { 2 };
    for k in 0..outline.len().saturating_sub(1) as u32 {
        for c in 0..columns - 1 {
            let a = first.unwrap_or(0) + k * columns + c;
            let (b, d) = (a + 1, a + columns);
            let e = d + 1;
            // Left to right by base to tip turns about the facing side: a, b, e is its front.
            if is_front {
                out.triangle([a, b, e]);
                out.triangle([a, e, d]);
            } else {
                out.triangle([a, e, b]);
                out.triangle([a, d, e]);
            }
        }
    }
}
