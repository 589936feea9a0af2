//! One twig card: a few rows across a cell of the atlas, cut to what is seen in it, folded along
//! the midrib or crossed with a second card, sagging towards its tip.

use glam::Vec3;

use super::Surface;
use crate::texture::Cell;
use crate::texture::atlas::Row;

/// The form of cards.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Shape {
    /// Two halves that meet in the midrib at an angle.
    Folded { rows: usize },
    /// Two flat cards that share the midrib.
    Crossed { rows: usize },
}

impl Shape {
    pub fn rows(self) -> usize {
        match self {
            Shape::Folded { rows } | Shape::Crossed { rows } => rows.max(2),
        }
    }

    pub fn triangles(self) -> usize {
        4 * (self.rows() - 1)
    }

    pub fn vertices(self) -> usize {
        match self {
            Shape::Folded { .. } => 3 * self.rows(),
            Shape::Crossed { .. } => 4 * self.rows(),
        }
    }
}

/// Where a card stands.
#[derive(Debug, Clone, Copy)]
pub struct Card {
    pub base: Vec3,
    /// Unit, from base to tip.
    pub heading: Vec3,
    /// Unit, at right angles to `heading`; the upper side.
    pub facing: Vec3,
    /// Side of the cell.
    pub size_m: f32,
    /// How far each half folds down.
    pub fold_rad: f32,
    /// Fall of the tip, share of the size.
    pub sag: f32,
    pub mirrored: bool,
    /// Unit, out of the crown.
    pub outward: Vec3,
    pub crown: Vec3,
}

/// Share of the crown's outside in a normal, against the card's own.
const BENT: f32 = 0.6;

pub fn emit(card: &Card, shape: Shape, cell: &Cell, outline: &[Row], out: &mut Surface) {
    let across = card.heading.cross(card.facing);
    match shape {
        Shape::Folded { .. } => {
            let (sin, cos) = card.fold_rad.sin_cos();
            // Across the midrib: left, middle, right, each with its direction and own normal.
            let left = (across * -cos) - card.facing * sin;
            let right = (across * cos) - card.facing * sin;
            let leans = [
                (card.facing * cos - across * sin),
                card.facing,
                (card.facing * cos + across * sin),
            ];
            sheet(card, cell, outline, &[(left, leans[0]), (right, leans[2])], Some(leans[1]), out);
        }
        Shape::Crossed { .. } => {
            sheet(card, cell, outline, &[(-across, card.facing), (across, card.facing)], None, out);
            let turned = Card { mirrored: !card.mirrored, ..*card };
            let flat = [(-card.facing, -across), (card.facing, -across)];
            sheet(&turned, cell, outline, &flat, None, out);
        }
    }
}

/// One sheet: a left and a right edge (direction away from the midrib, normal) and, where
/// `middle` is given, the midrib between them.
fn sheet(
    card: &Card,
    cell: &Cell,
    outline: &[Row],
    sides: &[(Vec3, Vec3); 2],
    middle: Option<Vec3>,
    out: &mut Surface,
) {
    let start = out.position.len() as u32;
    // Seen from outside the crown, the front shows: a viewer's light agrees with the normals.
    let own = middle.unwrap_or(sides[0].1);
    let is_front = own.dot(card.outward) >= 0.0;
    let sign = if is_front { 1.0 } else { -1.0 };
    let mut push = |s: f32, t: f32, edge: Vec3, reach: f32, lean: Vec3| {
        let fall = Vec3::new(0.0, 0.0, -card.sag * t * t);
        let p = card.base + (card.heading * t + edge * reach + fall) * card.size_m;
        let away = (p - card.crown).normalize_or(card.outward);
        let bent = card.outward * 0.6 + away * 0.4;
        let normal = lean * (sign * (1.0 - BENT)) + bent * BENT;
        out.position.push(p);
        out.normal.push(normal.normalize_or(card.outward));
        out.uv.push(cell.uv(s, t));
    };
    for row in outline {
        let (l, r) = (0.5 - row.left, row.right - 0.5);
        // A mirrored card swaps the two sides of the picture.
        let (l, r) = if card.mirrored { (r, l) } else { (l, r) };
        let s = |away: f32| if card.mirrored { 0.5 - away } else { 0.5 + away };
        push(s(-l), row.t, sides[0].0, l, sides[0].1);
        if let Some(lean) = middle {
            push(0.5, row.t, Vec3::ZERO, 0.0, lean);
        }
        push(s(r), row.t, sides[1].0, r, sides[1].1);
    }
    let columns = if middle.is_some() { 3 } else { 2 };
    for k in 0..outline.len() as u32 - 1 {
        for c in 0..columns - 1 {
            let a = start + k * columns + c;
            let (b, d) = (a + 1, a + columns);
            let e = d + 1;
            // Left to right by base to tip turns about the facing side: a, b, e is its front.
            if is_front {
                out.index.extend([a, b, e, a, e, d]);
            } else {
                out.index.extend([a, e, b, a, d, e]);
            }
        }
    }
}
