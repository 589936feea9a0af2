//! A region of cells to a simple polygon.
//!
//! Seen from the region's middle, the farthest cell corner in each of 20 sectors becomes a corner
//! of the outline. Corners in order of direction make a star-shaped polygon, which can't cross
//! itself. Where the middle sees the region only on one side, its convex hull is taken. Both are
//! drawn in to the region's area.

use glam::Vec2;

const SECTORS: usize = 20;

/// Which of `4 * part.len() + 4` equal sectors a direction lies in, counted counter-clockwise from
/// east. `part` holds the directions that divide a quarter of the circle. Many times faster than
/// by the angle.
pub(super) fn sector(v: Vec2, part: &[Vec2]) -> usize {
    let (quarter, v) = match (v.x > 0.0, v.y > 0.0) {
        (true, _) if v.y >= 0.0 => (0, v),
        (false, true) => (1, Vec2::new(v.y, -v.x)),
        (false, false) if v.x < 0.0 => (2, -v),
        _ => (3, Vec2::new(-v.y, v.x)),
    };
    let passed = part.iter().map(|d| usize::from(d.perp_dot(v) >= 0.0)).sum::<usize>();
    quarter * (part.len() + 1) + passed
}

/// The directions between the sectors of a quarter of the circle.
pub(super) fn dividers<const N: usize>() -> [Vec2; N] {
    let step = std::f32::consts::FRAC_PI_2 / (N + 1) as f32;
    std::array::from_fn(|k| Vec2::from_angle(step * (k + 1) as f32))
}

/// Twice the signed area of the triangle; > 0 where the turn is to the left.
fn turn(a: Vec2, b: Vec2, c: Vec2) -> f64 {
    let (u, v) = ((b - a).as_dvec2(), (c - a).as_dvec2());
    u.perp_dot(v)
}

/// Signed area, > 0 counter-clockwise.
pub(super) fn area_sq_m(polygon: &[Vec2]) -> f64 {
    let Some(&first) = polygon.first() else { return 0.0 };
    0.5 * polygon.windows(2).map(|w| turn(first, w[0], w[1])).sum::<f64>()
}

/// Centre of area; the mean of the corners where there is no area.
pub(super) fn centroid(polygon: &[Vec2]) -> Vec2 {
    let Some(&first) = polygon.first() else { return Vec2::ZERO };
    let (mut sum, mut total) = (glam::DVec2::ZERO, 0.0);
    for w in polygon.windows(2) {
        let t = turn(first, w[0], w[1]);
        sum += t / 3.0 * ((w[0] - first).as_dvec2() + (w[1] - first).as_dvec2());
        total += t;
    }
    if total > 0.0 { first + (sum / total).as_vec2() } else { first }
}

/// Mean of the greatest width of the corners and their width across it.
pub(super) fn spread_m(polygon: &[Vec2]) -> f32 {
    let mut longest = Vec2::ZERO;
    for (i, &a) in polygon.iter().enumerate() {
        for &b in &polygon[i + 1..] {
            if (b - a).length_squared() > longest.length_squared() {
                longest = b - a;
            }
        }
    }
    let across = longest.perp().normalize_or_zero();
    let along = polygon.iter().map(|p| p.dot(across));
    let (low, high) =
        along.fold((f32::INFINITY, f32::NEG_INFINITY), |(a, b), v| (a.min(v), b.max(v)));
    0.5 * (longest.length() + (high - low).max(0.0))
}

/// Whether no two sides touch but neighbours at their corner. Quadratic: outlines are short.
pub(super) fn is_simple(polygon: &[Vec2]) -> bool {
    let n = polygon.len();
    let side = |i: usize| (polygon[i], polygon[(i + 1) % n]);
    let crosses = |(a, b): (Vec2, Vec2), (c, d): (Vec2, Vec2)| {
        turn(a, b, c) * turn(a, b, d) <= 0.0
            && turn(c, d, a) * turn(c, d, b) <= 0.0
            && a.min(b).cmple(c.max(d)).all()
            && c.min(d).cmple(a.max(b)).all()
    };
    (0..n).all(|i| polygon[i] != polygon[(i + 1) % n])
        && (0..n)
            .all(|i| (i + 2..n).filter(|&j| (j + 1) % n != i).all(|j| !crosses(side(i), side(j))))
}

/// Outline of square cells given by their middles; counter-clockwise. `None` for no cells.
pub(super) fn trace(middle: &[Vec2], cell_m: f32) -> Option<Vec<Vec2>> {
    let mut sum = glam::DVec2::ZERO;
    for m in middle {
        sum += m.as_dvec2();
    }
    let centre = (sum / middle.len().max(1) as f64).as_vec2();
    let half = 0.5 * cell_m;
    let corners = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)];
    let all = middle.iter().flat_map(|&m| corners.map(|(x, y)| m + half * Vec2::new(x, y)));
    let dividers = dividers::<{ SECTORS / 4 - 1 }>();
    let mut farthest: [Option<(f32, Vec2)>; SECTORS] = [None; SECTORS];
    for p in all.clone() {
        let v = p - centre;
        let far_sq = v.length_squared();
        let best = &mut farthest[sector(v, &dividers)];
        if best.is_none_or(|(f, _)| far_sq > f) {
            *best = Some((far_sq, p));
        }
    }
    let mut star: Vec<(f32, Vec2)> = farthest
        .iter()
        .flatten()
        .map(|&(_, p)| {
            let v = p - centre;
            (v.y.atan2(v.x), p)
        })
        .collect();
    star.sort_by(|a, b| a.0.total_cmp(&b.0));
    star.dedup_by_key(|s| s.0);
    let widest_gap = (0..star.len())
        .map(|i| (star[(i + 1) % star.len()].0 - star[i].0).rem_euclid(std::f32::consts::TAU))
        .fold(0.0, f32::max);
    let star: Vec<Vec2> = star.into_iter().map(|s| s.1).collect();
    // Rounding may bring near corners out of order: the star is taken only if it holds.
    let is_star = star.len() >= 3 && widest_gap < 3.0 && is_simple(&star) && area_sq_m(&star) > 0.0;
    let polygon = if is_star { star } else { convex_hull(all.collect()) };
    let area = area_sq_m(&polygon);
    if polygon.len() < 3 || area <= 0.0 {
        return None;
    }
    // The farthest corners lie outside most of the border: shrunk to the area of the cells.
    let cells = middle.len() as f64 * f64::from(cell_m).powi(2);
    let scale = (cells / area).sqrt().min(1.0) as f32;
    let shrunk: Vec<Vec2> = polygon.iter().map(|&p| centre + scale * (p - centre)).collect();
    let is_sound = is_simple(&shrunk) && area_sq_m(&shrunk) > 0.0;
    Some(if is_sound { shrunk } else { polygon })
}

/// Andrew's monotone chain, counter-clockwise, no three corners in line.
fn convex_hull(mut points: Vec<Vec2>) -> Vec<Vec2> {
    points.sort_by(|a, b| a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)));
    points.dedup();
    let mut hull: Vec<Vec2> = Vec::new();
    for pass in 0..2 {
        let start = hull.len();
        let mut add = |p: Vec2| {
            while hull.len() >= start + 2
                && turn(hull[hull.len() - 2], hull[hull.len() - 1], p) <= 0.0
            {
                hull.pop();
            }
            hull.push(p);
        };
        if pass == 0 {
            points.iter().for_each(|&p| add(p));
        } else {
            points.iter().rev().for_each(|&p| add(p));
        }
        hull.pop();
    }
    hull
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::raster::polygon::contains;
    use proptest::prelude::*;

    #[test]
    fn a_square_of_cells_keeps_its_box_and_area() {
        let cells: Vec<Vec2> =
            (0..100).map(|i| Vec2::new((i % 10) as f32 + 0.5, (i / 10) as f32 + 0.5)).collect();
        let outline = trace(&cells, 1.0).unwrap();
        let area = area_sq_m(&outline);
        assert!((93.0..=100.0).contains(&area), "{area}");
        assert!((centroid(&outline) - Vec2::splat(5.0)).length() < 0.2);
        assert!(contains(&outline, Vec2::splat(5.0)) && !contains(&outline, Vec2::new(11.0, 5.0)));
    }

    #[test]
    fn sectors_are_those_of_the_angle() {
        let dividers = dividers::<4>();
        for i in 0..4000 {
            let turn = (i as f32 + 0.5) / 4000.0;
            let v = 3.0 * Vec2::from_angle(turn * std::f32::consts::TAU);
            assert_eq!(sector(v, &dividers), (turn * 20.0) as usize, "{turn}");
        }
        let axes = [Vec2::X, Vec2::Y, Vec2::NEG_X, Vec2::NEG_Y];
        assert_eq!(axes.map(|v| sector(v, &dividers)), [0, 5, 10, 15]);
    }

    #[test]
    fn the_spread_is_the_mean_of_two_widths() {
        let v = Vec2::new;
        let lozenge = [v(-4.0, 0.0), v(0.0, -1.5), v(4.0, 0.0), v(0.0, 1.5)];
        assert!((spread_m(&lozenge) - 5.5).abs() < 1e-5);
    }

    #[test]
    fn one_cell_is_a_square() {
        let outline = trace(&[Vec2::new(3.0, 4.0)], 0.5).unwrap();
        assert_eq!(outline.len(), 4);
        assert!((area_sq_m(&outline) - 0.25).abs() < 1e-6);
        assert!(trace(&[], 0.5).is_none());
    }

    #[test]
    fn a_bow_tie_is_not_simple() {
        let v = Vec2::new;
        assert!(!is_simple(&[v(0.0, 0.0), v(2.0, 2.0), v(2.0, 0.0), v(0.0, 2.0)]));
        assert!(is_simple(&[v(0.0, 0.0), v(2.0, 0.0), v(2.0, 2.0), v(0.0, 2.0)]));
    }

    proptest! {
        #[test]
        fn outlines_are_simple_and_counter_clockwise(
            cells in prop::collection::btree_set((0i32..12, 0i32..12), 1..40),
            cell in 0.1f32..3.0,
            at in -5000.0f32..5000.0,
        ) {
            let middle: Vec<Vec2> = cells
                .iter()
                .map(|&(x, y)| Vec2::new(x as f32 * cell + at, y as f32 * cell - at))
                .collect();
            let outline = trace(&middle, cell).unwrap();
            prop_assert!(outline.len() >= 3);
            prop_assert!(is_simple(&outline));
            prop_assert!(area_sq_m(&outline) > 0.0);
        }
    }
}
