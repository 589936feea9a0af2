//! Polygons in the plane, as their corners.

use glam::Vec2;

/// Whether a polygon holds a point (even-odd rule).
pub fn contains(polygon: &[Vec2], p: Vec2) -> bool {
    let mut is_inside = false;
    let Some(mut a) = polygon.last().copied() else { return false };
    for &b in polygon {
        if (a.y > p.y) != (b.y > p.y) {
            let t = f64::from(p.y - a.y) / f64::from(b.y - a.y);
            is_inside ^= f64::from(p.x - a.x) < t * f64::from(b.x - a.x);
        }
        a = b;
    }
    is_inside
}
