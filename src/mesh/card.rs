//! One twig card: a few rows across a cell of the atlas, cut to what is seen in it, folded along
//! the midrib or crossed with a second card, sagging towards its tip. A single leaf is the same,
//! small, from a cell that shows one leaf.

use glam::{Quat, Vec3, Vec3A};

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

    /// What it shows over the opaque part of its picture, sunk and seen from all sides: so that crowns
    /// cover as much as leaf by leaf.
    pub fn shown(self) -> f32 {
        match self {
            Shape::Folded { .. } => 0.75,
            Shape::Flat => 0.78,
            Shape::Crossed { .. } => 1.1,
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
pub const BENT: f32 = 0.5;

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
            sheet(pose, cell, outline, [left, (Vec3::ZERO, facing), right], out);
        }
        Shape::Flat => {
            // One sheet for two halves lies as the one or the other does.
            let turn = if pose.mirrored { fold_rad } else { -fold_rad };
            let turn = Quat::from_axis_angle(pose.heading, turn);
            let (facing, across) = (turn * facing, turn * across);
            sheet(pose, cell, outline, [(-across, facing), (across, facing)], out);
        }
        Shape::Crossed { .. } => {
            sheet(pose, cell, outline, [(-across, facing), (across, facing)], out);
            let turned = Pose { mirrored: !pose.mirrored, ..*pose };
            let flat = [(-facing, -across), (facing, -across)];
            sheet(&turned, cell, outline, flat, out);
        }
    }
}

/// One sheet of so many columns, each with its direction away from the midrib and its normal: a left
/// and a right edge, and the midrib between them where there are three.
fn sheet<const COLUMNS: usize>(
    pose: &Pose,
    cell: &Cell,
    outline: &[Row],
    columns: [(Vec3, Vec3); COLUMNS],
    out: &mut Piece,
) {
    // Seen from outside the crown, the front shows: a viewer's light agrees with the normals.
    let is_front = columns[(COLUMNS - 1) / 2].1.dot(pose.outward) >= 0.0;
    let sign = if is_front { 1.0 } else { -1.0 };
    let columns = columns.map(|(edge, own)| (Vec3A::from(edge), Vec3A::from(own) * sign));
    let [base, heading] = [pose.base, pose.heading].map(Vec3A::from);
    let bent = pose.bent_near(base + heading * (0.5 * pose.size_m), BENT);
    let mut first = None;
    for row in outline {
        let t = row.t;
        let (left, right) = (0.5 - row.left, row.right - 0.5);
        // A mirrored card swaps the two sides of the picture.
        let (left, right, way) =
            if pose.mirrored { (right, left, -1.0) } else { (left, right, 1.0) };
        let fall = Vec3A::new(0.0, 0.0, -pose.sag * t * t);
        let vertices = std::array::from_fn(|k| {
            let (edge, own) = columns[k];
            let (reach, away) = match k {
                0 => (left, -left),
                _ if k + 1 == COLUMNS => (right, right),
                _ => (0.0, 0.0),
            };
            let p = base + (heading * t + edge * reach + fall) * pose.size_m;
            let normal = bent(own, p).normalize_or(Vec3A::Z);
            (p.into(), normal.into(), cell.uv(0.5 + way * away, t))
        });
        first.get_or_insert(out.blade::<COLUMNS, 0>(vertices, []));
    }
    let columns = COLUMNS as u32;
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
