//! The trend of heights that are known here and there: a plane through those about each node of a
//! coarse grid, fitted robustly; between nodes it is bilinear. A node sees no farther than
//! `REACH` squares, so that the trend of a place does not depend on where the heights are cut.

use glam::{DMat3, DVec3, Vec2, Vec3};
use rayon::prelude::*;

use super::{Grid, GridGeometry, inpaint};

/// Between nodes, squares.
const NODE: f64 = 4.0;
/// Squares that a plane reaches from its node, each way.
const REACH: f64 = 6.0;
/// Fewest heights for a plane.
const FEWEST: usize = 6;

/// Trend on nodes of four squares' side, reaching one of them beyond the squares. `heights` holds
/// one place with its height for each cell of `squares`, `None` where it is not known.
pub fn trend(heights: &[Option<Vec3>], squares: GridGeometry) -> Grid<f32> {
    let (min, max) = ([squares.west, squares.south()], [squares.east(), squares.north]);
    // The far edges belong to the last squares, not to nodes of their own.
    let inside = [max[0] - 0.5 * squares.cell_x, max[1] - 0.5 * squares.cell_y];
    let nodes = GridGeometry::covering(min, inside, squares.cell_x * NODE).grown(1);
    let fitted: Vec<Option<f32>> = (0..nodes.len())
        .into_par_iter()
        .map(|i| {
            let [x, y] = nodes.centre(i % nodes.cols, i / nodes.cols);
            let span = |at: f64, count: usize| {
                let end = |v: f64| v.round().clamp(0.0, count as f64) as usize;
                end(at - REACH)..end(at + REACH)
            };
            let cols = span((x - squares.west) / squares.cell_x, squares.cols);
            let about: Vec<Vec3> = span((squares.north - y) / squares.cell_y, squares.rows)
                .flat_map(|r| cols.clone().map(move |c| squares.index(c, r)))
                .filter_map(|k| heights.get(k).copied().flatten())
                .collect();
            (about.len() >= FEWEST).then(|| plane_height(&about, Vec2::new(x as f32, y as f32)))
        })
        .collect();
    let is_known: Vec<bool> = fitted.iter().map(Option::is_some).collect();
    let data = fitted.into_iter().map(Option::unwrap_or_default).collect();
    let mut grid = Grid { geometry: nodes, data };
    if is_known.contains(&true) {
        inpaint::fill(&mut grid, &is_known);
    } else {
        let known = || heights.iter().flatten().map(|p| f64::from(p.z));
        grid.data.fill((known().sum::<f64>() / known().count().max(1) as f64) as f32);
    }
    grid
}

/// Height at a place of the plane through points: least squares, reweighted by Cauchy's function
/// of the residuals, whose median sets the scale.
fn plane_height(points: &[Vec3], at: Vec2) -> f32 {
    const ROUNDS: usize = 10;
    let place = |p: &Vec3| (*p - at.extend(0.0)).as_dvec3();
    let base = points.iter().map(|p| f64::from(p.z)).sum::<f64>() / points.len().max(1) as f64;
    let mut weight = vec![1.0f64; points.len()];
    let mut residual = weight.clone();
    let mut fit = DVec3::new(base, 0.0, 0.0);
    for _ in 0..ROUNDS {
        let (mut m, mut b) = (DMat3::IDENTITY * 1e-9, DVec3::ZERO);
        for (p, &w) in points.iter().map(place).zip(&weight) {
            let v = DVec3::new(1.0, p.x, p.y);
            m += DMat3::from_cols(v * v.x * w, v * v.y * w, v * v.z * w);
            b += v * (p.z - base) * w;
        }
        let next = m.inverse() * b;
        if !next.is_finite() {
            break;
        }
        fit = next + DVec3::new(base, 0.0, 0.0);
        for (r, p) in residual.iter_mut().zip(points.iter().map(place)) {
            *r = (p.z - fit.dot(DVec3::new(1.0, p.x, p.y))).abs();
        }
        weight.copy_from_slice(&residual);
        let middle = weight.len() / 2;
        let scale = 2.0 * weight.select_nth_unstable_by(middle, f64::total_cmp).1.max(1e-3);
        for (w, r) in weight.iter_mut().zip(&residual) {
            *w = 1.0 / (1.0 + (r / scale).powi(2));
        }
    }
    fit.x as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_plane_with_outliers_is_met_wherever_it_is_cut() {
        let height = |x: f64, y: f64| (200.0 + 0.8 * x - 0.5 * y) as f32;
        let trend_of = |min: [f64; 2], max: [f64; 2]| {
            let squares = GridGeometry::covering(min, max, 8.0);
            let heights: Vec<Option<Vec3>> = (0..squares.len())
                .map(|i| {
                    let [x, y] = squares.centre(i % squares.cols, i / squares.cols);
                    let stands_out = (x as i64 * 7 + y as i64 * 3) % 11 == 0;
                    let z = height(x, y) + if stands_out { 20.0 } else { 0.0 };
                    Some(Vec3::new(x as f32, y as f32, z))
                })
                .collect();
            trend(&heights, squares)
        };
        let whole = trend_of([0.0, 0.0], [400.0, 300.0]);
        let part = trend_of([0.0, 0.0], [230.0, 300.0]);
        for (x, y) in [(30.0, 40.0), (100.0, 250.0), (128.0, 128.0)] {
            assert!((whole.bilinear(x, y) - height(x, y)).abs() < 0.2);
            assert_eq!(whole.bilinear(x, y), part.bilinear(x, y), "at {x} {y}");
        }
        assert!((whole.bilinear(-10.0, -10.0) - height(-10.0, -10.0)).abs() < 0.5);
    }

    #[test]
    fn too_few_heights_give_their_mean() {
        let squares = GridGeometry::covering([0.0, 0.0], [8.0, 8.0], 8.0);
        let heights = vec![Some(Vec3::new(1.0, 1.0, 4.0)), Some(Vec3::new(9.0, 1.0, 6.0)), None];
        assert!(trend(&heights, squares).data.iter().all(|&z| z == 5.0));
        assert!(trend(&[], squares).data.iter().all(|&z| z == 0.0));
    }
}
