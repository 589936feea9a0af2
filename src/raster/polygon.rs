//! Polygons in the plane, as their corners.

use glam::Vec2;

/// Whether a polygon holds a point (even-odd rule).
pub fn contains(polygon: &[Vec2], p: Vec2) -> bool {
    let mut is_inside = false;
    let Some(mut a) = polygon.last().copied() else { return false };
    for &b in polygon {
        if (a.y > p.y) != (b.y > p.y) {
            let [across, along] = [p.x - a.x, b.x - a.x].map(f64::from);
            let [up, rise] = [p.y - a.y, b.y - a.y].map(f64::from);
            let (point, edge) = (across * rise, up * along);
            is_inside ^= if rise > 0.0 { point < edge } else { point > edge };
        }
        a = b;
    }
    is_inside
}
