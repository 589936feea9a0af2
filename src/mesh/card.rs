//! One twig card: a few rows across a cell of the atlas, cut to what is seen in it; its middle stands
//! out over its rim, or it is folded along the midrib or crossed with a second card; it sags towards
//! its tip. A single leaf is a folded one, small, from a cell that shows one leaf.
//!
//! Leafy twigs are domed: a fold runs where leaves are thickest, and seen from the side it cuts them
//! off in a straight line. Edges of a dome run out to its corners, where the picture has none.

use glam::{Quat, Vec3, Vec3A};

use super::piece::{Piece, Room};
use super::spot::Pose;
use crate::species::model::{Foliage, LeafShape};
use crate::texture::Cell;
use crate::texture::atlas::Row;

/// The form of cards.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Shape {
    /// Faces from all of the rim to the middle, which stands out.
    Domed { rows: usize },
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
            Shape::Domed { rows } | Shape::Folded { rows } | Shape::Crossed { rows } => rows.max(2),
            Shape::Flat => 2,
        }
    }

    /// That of a twig's card. The shoot of a bare one goes on straight along a fold.
    pub fn of(foliage: &Foliage, detail: bool) -> Shape {
        let rows = if detail { 3 } else { 2 };
        match foliage.shape {
            LeafShape::Bundle => Shape::Crossed { rows },
            _ if foliage.is_bare() => Shape::Folded { rows },
            _ => Shape::Domed { rows },
        }
    }

    /// What it shows over the opaque part of its picture, sunk and seen from all sides: so that crowns
    /// cover as much as leaf by leaf.
    pub fn shown(self) -> f32 {
        match self {
            Shape::Domed { .. } => 0.73,
            Shape::Folded { .. } => 0.75,
            Shape::Flat => 0.78,
            Shape::Crossed { .. } => 1.1,
        }
    }

    pub fn room(self) -> Room {
        let rows = self.rows();
        let (columns, sheets) = match self {
            Shape::Domed { .. } => return Room { vertices: 2 * rows + 1, triangles: 2 * rows },
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

/// Adds a card; `fold_rad`: how far its halves, or its rim, fold down.
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
        Shape::Domed { .. } => dome(pose, fold_rad, cell, outline, out),
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

/// Faces from every edge of the outline to its middle.
fn dome(pose: &Pose, fold_rad: f32, cell: &Cell, outline: &[Row], out: &mut Piece) {
    let [Some(low), Some(high)] = [outline.first(), outline.last()] else { return };
    let is_front = pose.facing.dot(pose.outward) >= 0.0;
    let sign = if is_front { 1.0 } else { -1.0 };
    let way = if pose.mirrored { -1.0 } else { 1.0 };
    let (sin, cos) = fold_rad.sin_cos();
    let [base, heading, facing] = [pose.base, pose.heading, pose.facing].map(Vec3A::from);
    let across = heading.cross(facing) * (cos * way);
    let middle = 0.5 * (low.t + high.t);
    let bent = pose.bent_near(base + heading * (0.5 * pose.size_m), BENT);
    let mut add = |u: f32, t: f32, up: f32, lean: Vec3A| {
        let fall = Vec3A::new(0.0, 0.0, -pose.sag * t * t);
        let p = base + (heading * t + across * (u - 0.5) + facing * up + fall) * pose.size_m;
        let normal = bent((facing * cos + lean * sin) * sign, p).normalize_or(Vec3A::Z);
        out.blade::<1, 0>([(p.into(), normal.into(), cell.uv(u, t))], [])
    };
    let half: f32 = outline.iter().map(|row| 0.5 * (row.right - row.left)).sum();
    let rise = sin * half / outline.len() as f32;
    let top = add(0.5, middle, rise, Vec3A::ZERO);
    for row in outline {
        for u in [row.left, row.right] {
            let lean = heading * (row.t - middle) + across * (u - 0.5);
            add(u, row.t, 0.0, lean.normalize_or_zero());
        }
    }
    // Once around the rim: up on the right, down on the left.
    let rows = outline.len() as u32;
    let right = (0..rows).map(|k| top + 2 * k + 2);
    let left = (0..rows).rev().map(|k| top + 2 * k + 1);
    let rim = right.chain(left).chain([top + 2]);
    let is_turned = is_front == pose.mirrored;
    for (a, b) in rim.clone().zip(rim.skip(1)) {
        out.triangle(if is_turned { [b, a, top] } else { [a, b, top] });
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
