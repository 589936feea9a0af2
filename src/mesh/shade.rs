//! How much a small surface hides: its silhouette, by a grid of samples, mean over all directions.
//! Limit: the grid tells shares of the whole to about a percent; details smaller than its step count
//! right on average.

use glam::{Vec2, Vec3};

/// Directions looked along: the six axes of an icosahedron, turned off those of twigs; from the other
/// end each shows the same.
const VIEWS: [Vec3; 6] = [
    Vec3::new(-0.942965, 0.189454, 0.273723),
    Vec3::new(0.423174, -0.817801, 0.390032),
    Vec3::new(-0.595529, -0.792608, 0.130838),
    Vec3::new(0.245510, 0.224079, -0.943140),
    Vec3::new(-0.705332, -0.148690, -0.693108),
    Vec3::new(0.138989, -0.771208, -0.621225),
];
/// Samples along either side of the grid.
const SAMPLES: usize = 128;
/// More than rounding moves an edge by, steps of the grid.
const ROUNDING: f32 = 0.01;

/// Area hidden, as square metres of a view; 0 of nothing.
pub fn hidden_sq_m(position: &[Vec3], index: &[u32]) -> f32 {
    let mut covered = vec![false; SAMPLES * SAMPLES];
    let sum: f32 = VIEWS
        .iter()
        .map(|view| {
            let (right, up) = view.any_orthonormal_pair();
            let seen = position.iter().map(|p| Vec2::new(p.dot(right), p.dot(up)));
            covered.fill(false);
            silhouette_sq_m(&seen.collect::<Vec<_>>(), index, &mut covered)
        })
        .sum();
    sum / VIEWS.len() as f32
}

fn silhouette_sq_m(seen: &[Vec2], index: &[u32], covered: &mut [bool]) -> f32 {
    let nothing = (Vec2::INFINITY, Vec2::NEG_INFINITY);
    let (low, high) = seen.iter().fold(nothing, |(l, h), &p| (l.min(p), h.max(p)));
    let step = (high - low) / SAMPLES as f32;
    if !(step.is_finite() && step.min_element() > 0.0) {
        return 0.0;
    }
    let on_grid = |i: u32| (seen[i as usize] - low) / step - 0.5;
    let last = (SAMPLES - 1) as f32;
    for t in index.as_chunks::<3>().0 {
        let [a, b, c] = t.map(on_grid);
        let (ab, bc, ca) = (b - a, c - b, a - c);
        let facing = if ab.perp_dot(bc) < 0.0 { -1.0 } else { 1.0 };
        let from = a.min(b).min(c).ceil().clamp(Vec2::ZERO, Vec2::splat(last));
        let to = a.max(b).max(c).floor().clamp(Vec2::ZERO, Vec2::splat(last));
        let edges = [(ab, a), (bc, b), (ca, c)].map(|(edge, foot)| (edge * facing, foot));
        let slopes = edges.map(|(edge, _)| edge.x / edge.y);
        for y in from.y as usize..=to.y as usize {
            // The stretch of the row between the edges, and a little beyond.
            let (mut first, mut end) = (from.x, to.x);
            for ((edge, foot), slope) in edges.iter().zip(slopes) {
                let x = foot.x + (y as f32 - foot.y) * slope;
                if edge.y > 0.0 && x + ROUNDING < end {
                    end = x + ROUNDING;
                } else if edge.y < 0.0 && x - ROUNDING > first {
                    first = x - ROUNDING;
                }
            }
            for x in first as usize..=end as usize {
                let p = Vec2::new(x as f32, y as f32);
                if edges.iter().all(|(edge, foot)| edge.perp_dot(p - *foot) >= 0.0) {
                    covered[y * SAMPLES + x] = true;
                }
            }
        }
    }
    covered.iter().filter(|c| **c).count() as f32 * step.x * step.y
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sheet_hides_its_projection_and_what_lies_behind_counts_once() {
        let square = |z: f32| {
            [(0.0, 0.0), (2.0, 0.0), (2.0, 1.0), (0.0, 1.0)].map(|(x, y)| Vec3::new(x, y, z))
        };
        let index = [0, 1, 2, 0, 2, 3];
        // Half its area, over all directions.
        let one = hidden_sq_m(&square(0.0), &index);
        assert!((one - 1.0).abs() < 0.03, "{one}");
        let twice = hidden_sq_m(
            &[square(0.0), square(1e-4)].concat(),
            &[index, index.map(|i| i + 4)].concat(),
        );
        assert!((twice / one - 1.0).abs() < 0.02, "{twice} {one}");
    }

    #[test]
    fn what_is_finer_than_the_grid_counts_on_average() {
        // Slats of a tenth of a sample, at places that share nothing with the grid's.
        let (mut position, mut index) = (Vec::new(), Vec::new());
        let wide = 0.1 / SAMPLES as f32;
        for k in 0..997u32 {
            let y = (k as f32 * 0.618_034).fract();
            let corners = [(0.0, y), (1.0, y), (1.0, y + wide), (0.0, y + wide)];
            position.extend(corners.map(|(x, y)| Vec3::new(x, y, 0.0)));
            index.extend([0, 1, 2, 0, 2, 3].map(|i| 4 * k + i));
        }
        let seen: Vec<Vec2> = position.iter().map(|p| p.truncate()).collect();
        let hidden = silhouette_sq_m(&seen, &index, &mut vec![false; SAMPLES * SAMPLES]);
        // Evenly spread, they hardly overlap.
        let sum = 997.0 * wide;
        assert!((hidden / sum - 1.0).abs() < 0.12, "{hidden} of {sum}");
    }

    #[test]
    fn nothing_and_what_has_no_extent_hides_nothing() {
        assert_eq!(hidden_sq_m(&[], &[]), 0.0);
        assert_eq!(hidden_sq_m(&[Vec3::ONE; 3], &[0, 1, 2]), 0.0);
        assert_eq!(hidden_sq_m(&[Vec3::NAN; 3], &[0, 1, 2]), 0.0);
    }
}
