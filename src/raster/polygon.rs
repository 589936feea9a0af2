//! Polygons in the plane, as their corners.

use glam::Vec2;

/// Whether a polygon holds a point (even-odd rule).
pub fn contains(polygon: &[Vec2], p: Vec2) -> bool {
    const SIDES: usize = u64::BITS as usize;
    let Some(&last) = polygon.last() else { return false };
    let (mut is_inside, mut before) = (false, last);
    for corners in polygon.chunks(SIDES) {
        // Which sides pass the height of the point is found for all of them first: few do, and it can't
        // be foreseen which.
        let (mut passing, mut was_above) = (0u64, before.y > p.y);
        for (k, b) in corners.iter().enumerate() {
            let is_above = b.y > p.y;
            passing |= u64::from(is_above != was_above) << k;
            was_above = is_above;
        }
        while passing != 0 {
            let k = passing.trailing_zeros() as usize;
            passing &= passing - 1;
            let (a, b) = (if k == 0 { before } else { corners[k - 1] }, corners[k]);
            let [across, along] = [p.x - a.x, b.x - a.x].map(f64::from);
            let [up, rise] = [p.y - a.y, b.y - a.y].map(f64::from);
            let (point, edge) = (across * rise, up * along);
            is_inside ^= if rise > 0.0 { point < edge } else { point > edge };
        }
        before = corners[corners.len() - 1];
    }
    is_inside
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_ring_of_many_corners_holds_what_is_within_it() {
        let ring: Vec<Vec2> = (0..200)
            .map(|i| Vec2::from_angle(std::f32::consts::TAU * i as f32 / 200.0) * 5.0)
            .collect();
        for i in 0..400 {
            let at = Vec2::from_angle(0.7 * i as f32);
            assert!(contains(&ring, 4.98 * at), "{i}");
            assert!(!contains(&ring, 5.01 * at), "{i}");
        }
        assert!(!contains(&[], Vec2::ZERO));
    }
}
