//! The lowest points of small cells, which is what filters look at, with the trend of the terrain
//! about them and without low outliers. All grids are aligned to multiples of their cell, so that
//! none depends on where a scan is cut.

use glam::Vec3;
use rayon::prelude::*;

use crate::raster::trend::trend;
use crate::raster::{Grid, GridGeometry, scatter};

/// Finest cell of the filters, metres; larger where an area would have too many.
pub const CELL_M: f64 = 1.0;
/// Most half cells.
const MOST_CELLS: f64 = 30e6;
/// The trend is fitted to the lowest points of squares of so many cells.
const SQUARE: f64 = 8.0;
/// Low points with so large a gap above are noise.
const GAP_M: f32 = 3.0;

/// What filters start from.
pub struct Lowest {
    /// The lowest point of each half cell that holds any, without low outliers; never empty.
    pub points: Vec<Vec3>,
    /// Heights of the trend, reaching a node beyond the points.
    pub trend: Grid<f32>,
    cell: f64,
    min: [f64; 2],
    max: [f64; 2],
}

impl Lowest {
    /// Of the points that are candidates (at least one, all finite).
    pub fn of(candidates: &[Vec3]) -> Self {
        let (low, high) = super::bounds(candidates);
        let (min, max) = ([low.x, low.y].map(f64::from), [high.x, high.y].map(f64::from));
        let area = (max[0] - min[0]).max(1.0) * (max[1] - min[1]).max(1.0);
        let cell = CELL_M.max((area * 4.0 / MOST_CELLS).sqrt());
        let covering = |cells: f64| GridGeometry::covering(min, max, cell * cells);
        let thinned: Vec<Vec3> =
            lowest(candidates, |p| p.z, &covering(0.5)).into_iter().flatten().collect();
        let squares = covering(SQUARE);
        let trend_of = |points: &[Vec3]| trend(&lowest(points, |p| p.z, &squares), squares);
        let rough = trend_of(&thinned);
        let points = without_low_outliers(thinned, &rough, squares);
        let trend = trend_of(&points);
        Lowest { points, trend, cell, min, max }
    }

    /// A grid over the points, and one cell beyond, whose cells are `cells` of the finest.
    pub fn geometry(&self, cells: f64) -> GridGeometry {
        GridGeometry::covering(self.min, self.max, self.cell * cells).grown(1)
    }
}

/// The lowest point of each finest half cell that holds any.
pub fn thinned(points: &[Vec3]) -> Vec<Vec3> {
    if points.is_empty() {
        return Vec::new();
    }
    let (low, high) = super::bounds(points);
    let [min, max] = [low, high].map(|p| [p.x, p.y].map(f64::from));
    let cells = GridGeometry::covering(min, max, 0.5 * CELL_M);
    if cells.len() as f64 > MOST_CELLS {
        return points.to_vec();
    }
    lowest(points, |p| p.z, &cells).into_iter().flatten().collect()
}

/// The lowest point of each cell by the given height, in the order of the cells.
pub fn lowest(
    points: &[Vec3],
    height_m: impl Fn(&Vec3) -> f32 + Sync,
    geometry: &GridGeometry,
) -> Vec<Option<Vec3>> {
    let heights = points.par_iter().enumerate().filter_map(|(i, p)| {
        let (c, r) = geometry.cell_of(p.x.into(), p.y.into())?;
        Some((u32::try_from(i).ok()?, geometry.index(c, r), height_m(p)))
    });
    let numbers = scatter::least_number(geometry.len(), heights);
    numbers.into_par_iter().map(|i| points.get(i? as usize).copied()).collect()
}

/// Drops points that lie by [`GAP_M`] or more below the lowest few of their surroundings that
/// agree in height. Heights are taken above the trend, so that a slope opens no gaps.
fn without_low_outliers(points: Vec<Vec3>, trend: &Grid<f32>, g: GridGeometry) -> Vec<Vec3> {
    /// Kept of each square.
    const LOWEST: usize = 4;
    const ENOUGH: usize = 8;
    /// So many within [`LAYER_M`] are no strays.
    const AGREEING: usize = 4;
    const LAYER_M: f32 = 1.5;
    const NONE: u32 = u32::MAX;
    let height: Vec<f32> =
        points.par_iter().map(|p| p.z - trend.bilinear(p.x.into(), p.y.into())).collect();
    let z = |i: u32| height.get(i as usize).copied().unwrap_or(f32::INFINITY);
    let mut lowest = vec![[NONE; LOWEST]; g.len()];
    for (i, p) in points.iter().enumerate() {
        let Some((c, r)) = g.cell_of(p.x.into(), p.y.into()) else { continue };
        let own = &mut lowest[g.index(c, r)];
        let at = own.partition_point(|&o| z(o) <= height[i]);
        if at < LOWEST {
            own[at..].rotate_right(1);
            own[at] = i as u32;
        }
    }
    let mut is_outlier = vec![false; points.len()];
    let mut around: Vec<u32> = Vec::with_capacity(9 * LOWEST);
    for row in 0..g.rows {
        for col in 0..g.cols {
            around.clear();
            for r in row.saturating_sub(1)..(row + 2).min(g.rows) {
                for c in col.saturating_sub(1)..(col + 2).min(g.cols) {
                    around.extend(lowest[g.index(c, r)].iter().filter(|&&i| i != NONE));
                }
            }
            if around.len() < ENOUGH {
                continue;
            }
            around.sort_by(|&a, &b| z(a).total_cmp(&z(b)).then(a.cmp(&b)));
            let layer = around
                .windows(AGREEING)
                .find(|w| z(w[AGREEING - 1]) - z(w[0]) <= LAYER_M)
                .map_or(f32::NEG_INFINITY, |w| z(w[0]));
            for &i in around.iter().take_while(|&&i| z(i) < layer - GAP_M) {
                is_outlier[i as usize] = true;
            }
        }
    }
    if is_outlier.iter().all(|o| *o) {
        return points;
    }
    points.into_iter().zip(is_outlier).filter(|(_, o)| !o).map(|(p, _)| p).collect()
}
