//! Ground points to a height grid that can be sampled anywhere, and to a mesh. Knows nothing of
//! trees.
//!
//! Heights are cell-centred: the "cell-centred reading" of the two that T15 allows. A cell takes
//! the height at its centre of the Delaunay triangulation of the ground points, or, where cells are
//! fine, of a plane through the nearest around it; cells outside the hull go on smoothly along the trend of the heights near them. Grids are aligned to multiples of
//! their cell.

mod facets;
mod planes;
mod tin;

use std::collections::BTreeMap;

use glam::{Vec2, Vec3};
use rayon::prelude::*;

use crate::diagnostic::{Error, Result, Warned};
use crate::frame::{Frame, bounds};
use crate::ground::{Classified, Kind};
use crate::raster::trend::trend;
use crate::raster::{Grid, GridGeometry, inpaint};

pub use facets::Facets;

/// A height grid without voids, local metres.
#[derive(Debug, Clone)]
pub struct Terrain {
    pub heights: Grid<f32>,
    /// Which cells hold a ground point of their own.
    pub is_observed: Vec<bool>,
}

/// How the grid is made.
#[derive(Debug, Clone)]
pub struct TerrainOptions {
    /// Side of a cell; from the density of ground points where `None`.
    pub cell_m: Option<f32>,
    /// What that side is at least, in mean distances between ground points.
    pub cell_in_spacings: f64,
}

impl Default for TerrainOptions {
    fn default() -> Self {
        TerrainOptions { cell_m: None, cell_in_spacings: 1.0 }
    }
}

/// Cells that are chosen among, metres.
const CELLS_M: [f64; 4] = [0.25, 0.5, 1.0, 2.0];
const MOST_CELLS: usize = 100_000_000;

/// Ground points to a terrain that covers the whole cloud.
///
/// # Errors
/// A cell that is not a positive number or makes more than 100 million cells; fewer than three
/// ground points where the heights are absolute.
pub fn build(classified: &Classified, options: &TerrainOptions) -> Result<Warned<Terrain>> {
    let ground = ground_points(classified);
    let geometry = geometry(classified, ground.len(), options)?;
    through(&ground, geometry, classified)
}

/// [`build`] and [`held_out_error`] side by side.
///
/// # Errors
/// Those of [`build`].
pub fn build_measured(
    classified: &Classified,
    options: &TerrainOptions,
) -> Result<(Warned<Terrain>, Option<HeldOut>)> {
    let ground = ground_points(classified);
    let geometry = geometry(classified, ground.len(), options)?;
    let (terrain, held_out) = rayon::join(
        || through(&ground, geometry, classified),
        || off_held_out(&ground, geometry, classified),
    );
    Ok((terrain?, held_out?))
}

fn through(
    ground: &[Vec3],
    geometry: GridGeometry,
    classified: &Classified,
) -> Result<Warned<Terrain>> {
    if classified.is_normalised {
        let terrain = Terrain::level(geometry, &classified.cloud.frame);
        return Ok(Warned::new(terrain.with_observed(ground)));
    }
    let terrain = from_points(ground, geometry)?;
    let warnings = terrain.warning().into_iter().collect();
    Ok(Warned::with(terrain, warnings))
}

/// The ground points of a cloud or a piece of one, local metres.
pub fn ground_points(classified: &Classified) -> Vec<Vec3> {
    let points = classified.cloud.position.par_iter().zip(&classified.kind);
    points.filter(|(_, k)| **k == Kind::Ground).map(|(p, _)| *p).collect()
}

fn from_points(ground: &[Vec3], geometry: GridGeometry) -> Result<Terrain> {
    let mut gathered = Gathered::over(geometry);
    gathered.add(ground);
    gathered.terrain()
}

/// Ground points by the squares of a terrain's grid, gathered piece by piece. Where pieces hold
/// whole squares, the terrain does not depend on how the points were parted.
pub struct Gathered {
    geometry: GridGeometry,
    /// A cell of the terrain may be parted into more squares of vertices.
    parts: usize,
    squares: GridGeometry,
    means: Vec<tin::Mean>,
    points: usize,
}

impl Gathered {
    /// For the terrain on a grid.
    pub fn over(geometry: GridGeometry) -> Gathered {
        let parts = if geometry.cell_x <= PLANES_UP_TO_M { 1 } else { 2 };
        let squares = GridGeometry {
            cell_x: geometry.cell_x / parts as f64,
            cell_y: geometry.cell_y / parts as f64,
            cols: geometry.cols * parts,
            rows: geometry.rows * parts,
            ..geometry
        };
        Gathered { geometry, parts, squares, means: Vec::new(), points: 0 }
    }

    /// More ground points; local metres, finite.
    pub fn add(&mut self, ground: &[Vec3]) {
        self.points += ground.len();
        self.means.extend(tin::thinned(ground, &self.squares));
    }

    /// The terrain through them.
    ///
    /// # Errors
    /// Fewer than three points.
    pub fn terrain(mut self) -> Result<Terrain> {
        if self.points < 3 {
            return Err(Error::new(format!("{} ground points make no terrain", self.points)).remedy(
                "give a scan whose lowest returns reach the ground, or try --ground voxel or --ground file",
            ));
        }
        self.merge();
        let Gathered { geometry, parts, squares, means, .. } = self;
        let vertices: Vec<Vec3> = means.iter().map(|m| m.at).collect();
        let square_of_vertex: Vec<u32> = means.into_iter().map(|m| m.square).collect();
        let mut is_observed = vec![false; geometry.len()];
        for &square in &square_of_vertex {
            let (col, row) = (square as usize % squares.cols, square as usize / squares.cols);
            is_observed[geometry.index(col / parts, row / parts)] = true;
        }
        let mut heights = match parts {
            1 => by_planes(&vertices, &square_of_vertex, geometry),
            _ => tin::heights(&vertices, geometry),
        };
        fill(&mut heights, &vertices);
        Ok(Terrain { heights, is_observed })
    }

    /// Into the order of the squares, each once.
    fn merge(&mut self) {
        if self.means.is_sorted_by(|a, b| a.square < b.square) {
            return;
        }
        self.means.par_sort_by_key(|m| m.square);
        self.means.dedup_by(|next, kept| {
            let is_same = next.square == kept.square;
            if is_same {
                let share = next.points as f32 / (next.points + kept.points) as f32;
                kept.at = kept.at.lerp(next.at, share);
                kept.points += next.points;
            }
            is_same
        });
    }
}

/// Up to this cell, metres, a plane gives the height: terrain hardly bends across a few such cells,
/// and the scanner's noise is averaged. Across larger ones it bends.
const PLANES_UP_TO_M: f64 = 1.0;

/// Planes where points lie around, and a triangulation of the rest.
fn by_planes(vertices: &[Vec3], cell_of_vertex: &[u32], geometry: GridGeometry) -> Grid<f32> {
    let mut heights = planes::heights(vertices, cell_of_vertex, geometry);
    let open = about_open_cells(&heights);
    if open.contains(&true) {
        let corners: Vec<Vec3> = (vertices.iter().zip(cell_of_vertex))
            .filter(|(_, cell)| open[**cell as usize])
            .map(|(v, _)| *v)
            .collect();
        let drawn = tin::heights(&corners, geometry);
        let cells = heights.data.par_iter_mut().zip(&drawn.data);
        cells.filter(|(z, _)| z.is_nan()).for_each(|(z, drawn)| *z = *drawn);
    }
    heights
}

/// Cells within so many of one without a height: they hold the corners of the triangles over it.
const CORNERS_WITHIN: usize = 16;

fn about_open_cells(heights: &Grid<f32>) -> Vec<bool> {
    let g = heights.geometry;
    let within = |at: usize, end: usize| {
        at.saturating_sub(CORNERS_WITHIN)..(at + CORNERS_WITHIN + 1).min(end)
    };
    let mut along = vec![false; g.len()];
    let lines = along.par_chunks_mut(g.cols).zip(heights.data.par_chunks(g.cols));
    lines.for_each(|(along, line)| {
        for col in (0..g.cols).filter(|&col| line[col].is_nan()) {
            along[within(col, g.cols)].fill(true);
        }
    });
    let mut about = vec![false; g.len()];
    about.par_chunks_mut(g.cols).enumerate().for_each(|(row, about)| {
        for r in within(row, g.rows) {
            let line = &along[r * g.cols..(r + 1) * g.cols];
            about.iter_mut().zip(line).for_each(|(about, along)| *about |= along);
        }
    });
    about
}

/// Side of the squares that the trend is fitted to; in cells where that is more.
const SQUARE_M: f64 = 8.0;
const SQUARE_CELLS: f64 = 4.0;

/// Heights of the cells that have none, as the smoothest surface about the trend.
fn fill(heights: &mut Grid<f32>, vertices: &[Vec3]) {
    if heights.data.iter().all(|z| z.is_finite()) {
        return;
    }
    let g = heights.geometry;
    let side = SQUARE_M.max(g.cell_x * SQUARE_CELLS);
    let inside = [g.east() - 0.5 * g.cell_x, g.north - 0.5 * g.cell_y];
    let squares = GridGeometry::covering([g.west, g.south()], inside, side);
    // Any one vertex of a square will do; the first is the same wherever the terrain is cut.
    let mut about: Vec<Option<Vec3>> = vec![None; squares.len()];
    for v in vertices {
        if let Some((c, r)) = squares.cell_of(v.x.into(), v.y.into()) {
            about[squares.index(c, r)].get_or_insert(*v);
        }
    }
    let trend = trend(&about, squares);
    let trend_here = trend.resampled(g);
    heights.data.par_iter_mut().zip(&trend_here.data).for_each(|(z, trend)| *z -= trend);
    for v in vertices {
        // At the hull, and where fewer than three points have none, each stands for its cell.
        if let Some((c, r)) = g.cell_of(v.x.into(), v.y.into())
            && heights.at(c, r).is_nan()
        {
            heights.set(c, r, v.z - trend.bilinear(v.x.into(), v.y.into()));
        }
    }
    let is_known: Vec<bool> = heights.data.iter().map(|z| z.is_finite()).collect();
    inpaint::fill(heights, &is_known);
    heights.data.par_iter_mut().zip(&trend_here.data).for_each(|(z, trend)| *z += trend);
}

fn geometry(
    classified: &Classified,
    ground_points: usize,
    options: &TerrainOptions,
) -> Result<GridGeometry> {
    let points = &classified.cloud.position;
    let Some((low, high)) = bounds(points) else {
        return Err(Error::new("no points, so no terrain").remedy("give a scan with points"));
    };
    let cell = match options.cell_m {
        Some(c) if c.is_finite() && c > 0.0 => f64::from(c),
        Some(c) => {
            return Err(Error::new(format!("a terrain cell of {c} m is not possible"))
                .remedy("give --cell a number greater than 0"));
        }
        None => choose_cell_m((high - low).truncate(), ground_points, options.cell_in_spacings),
    };
    grid_over(low, high, cell)
}

/// Cells that a terrain may have for each point of its scan, or in all where that is more: plots of a
/// survey lie kilometres apart.
const MOST_CELLS_A_POINT: usize = 64;
const FEW_CELLS: usize = 1 << 24;

/// Whether a terrain can be made over a box with so many points, told before any work is done.
///
/// # Errors
/// More than 100 million cells, or far more than points where no cell is asked for.
pub fn check_extent(low: Vec3, high: Vec3, points: usize, cell_m: Option<f32>) -> Result<()> {
    let asked = cell_m.filter(|c| c.is_finite() && *c > 0.0).map(f64::from);
    let coarsest = CELLS_M[CELLS_M.len() - 1];
    let cells = grid_over(low, high, asked.unwrap_or(coarsest))?.len();
    if asked.is_some() || cells <= (MOST_CELLS_A_POINT * points).max(FEW_CELLS) {
        return Ok(());
    }
    let km = (high - low) * 1e-3;
    Err(Error::new(format!("{points} points lie scattered over {:.1} × {:.1} km", km.x, km.y))
        .remedy("look for a wrong scale in the header or points far from the rest, or give --cell"))
}

/// The cell for so many ground points over an extent in metres, at least so many of their mean
/// distances.
pub fn choose_cell_m(extent_m: Vec2, ground_points: usize, in_spacings: f64) -> f64 {
    let area = f64::from(extent_m.x.max(1.0)) * f64::from(extent_m.y.max(1.0));
    let spacing = (area / ground_points.max(1) as f64).sqrt();
    CELLS_M.into_iter().find(|&c| c >= in_spacings * spacing).unwrap_or(2.0)
}

/// The grid of a terrain over a box, aligned to multiples of the cell.
///
/// # Errors
/// More than 100 million cells.
pub fn grid_over(low: Vec3, high: Vec3, cell: f64) -> Result<GridGeometry> {
    let across = f64::from(high.x - low.x) / cell + 2.0;
    let down = f64::from(high.y - low.y) / cell + 2.0;
    if across * down > MOST_CELLS as f64 {
        return Err(Error::new(format!(
            "a terrain of {across:.0} × {down:.0} cells of {cell} m is more than {MOST_CELLS} cells"
        ))
        .remedy("give a larger --cell, or look for points far from the rest"));
    }
    Ok(GridGeometry::covering([low.x.into(), low.y.into()], [high.x.into(), high.y.into()], cell))
}

/// How far the terrain is from ground points that it was not built from.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct HeldOut {
    pub rmse_m: f64,
    pub max_m: f64,
    pub points: usize,
}

impl HeldOut {
    /// With those of another piece.
    pub fn add(&mut self, other: HeldOut) {
        let sum_sq = |h: &HeldOut| h.rmse_m.powi(2) * h.points as f64;
        let points = self.points + other.points;
        self.rmse_m = ((sum_sq(self) + sum_sq(&other)) / points.max(1) as f64).sqrt();
        self.max_m = self.max_m.max(other.max_m);
        self.points = points;
    }
}

/// One ground point in so many is held out.
const HELD_OUT: u64 = 10;
/// With more ground points than this, a share of the area is measured that holds about so many.
const HELD_OUT_FROM: usize = 60_000;
/// Side of the squares that are then drawn, and the rim in which nothing is held out, metres.
const HELD_OUT_SQUARE_M: f32 = 32.0;
const HELD_OUT_RIM_M: f32 = 3.0;

/// Builds the terrain from nine tenths of the ground points and measures it at the others, chosen
/// by a hash of their place; of a large scan on squares chosen likewise. `None` for normalised
/// heights and for fewer than 30 points.
///
/// # Errors
/// Those of [`build`].
pub fn held_out_error(
    classified: &Classified,
    options: &TerrainOptions,
) -> Result<Option<HeldOut>> {
    let ground = ground_points(classified);
    let geometry = geometry(classified, ground.len(), options)?;
    off_held_out(&ground, geometry, classified)
}

fn off_held_out(
    ground: &[Vec3],
    geometry: GridGeometry,
    classified: &Classified,
) -> Result<Option<HeldOut>> {
    if classified.is_normalised || ground.len() < 30 {
        return Ok(None);
    }
    held_out_of(ground, geometry.cell_x, ground.len())
}

/// [`held_out_error`] of a piece of a scan that has so many ground points in all: of a large one, on
/// those of its squares that lie in the piece.
///
/// # Errors
/// More than 100 million cells.
pub fn held_out_of(ground: &[Vec3], cell_m: f64, whole: usize) -> Result<Option<HeldOut>> {
    let Some((low, high)) = bounds(ground) else { return Ok(None) };
    let one_in = (whole / HELD_OUT_FROM) as u64 + 1;
    let square = |p: &Vec3| (p.truncate() / HELD_OUT_SQUARE_M).floor();
    let in_drawn: Vec<Vec3> = (ground.par_iter())
        .filter(|p| hash(&square(p).to_array()).is_multiple_of(one_in))
        .copied()
        .collect();
    let mut drawn: BTreeMap<[i32; 2], Vec<Vec3>> = BTreeMap::new();
    for p in in_drawn {
        drawn.entry(square(&p).as_ivec2().to_array()).or_default().push(p);
    }
    let is_out = |p: &Vec3| hash(&p.to_array()).is_multiple_of(HELD_OUT);
    let measure = |out: Vec<Vec3>, kept: &[Vec3], geometry: GridGeometry| -> Result<Vec<f64>> {
        if kept.len() < 3 {
            return Ok(Vec::new());
        }
        let terrain = from_points(kept, geometry)?;
        let off = |p: &Vec3| f64::from(terrain.height_at(p.truncate()) - p.z).abs();
        Ok(out.iter().map(off).collect())
    };
    let off = if one_in == 1 || drawn.is_empty() {
        let (out, kept): (Vec<Vec3>, Vec<Vec3>) = ground.iter().partition(|p| is_out(p));
        measure(out, &kept, grid_over(low, high, cell_m)?.grown(1))?
    } else {
        let squares: Vec<([i32; 2], Vec<Vec3>)> = drawn.into_iter().collect();
        let off = squares.into_par_iter().map(|([i, j], points)| {
            let low = Vec2::new(i as f32, j as f32) * HELD_OUT_SQUARE_M;
            let high = low + HELD_OUT_SQUARE_M;
            let (out, kept): (Vec<Vec3>, Vec<Vec3>) = points.into_iter().partition(|p| {
                let rim = (p.truncate() - low).min(high - p.truncate()).min_element();
                is_out(p) && rim >= HELD_OUT_RIM_M
            });
            let corner = |v: Vec2| v.to_array().map(f64::from);
            let geometry = GridGeometry::covering(corner(low), corner(high), cell_m);
            measure(out, &kept, geometry)
        });
        off.collect::<Result<Vec<Vec<f64>>>>()?.concat()
    };
    if off.is_empty() {
        return Ok(None);
    }
    Ok(Some(HeldOut {
        rmse_m: (off.iter().map(|e| e * e).sum::<f64>() / off.len() as f64).sqrt(),
        max_m: off.iter().copied().fold(0.0, f64::max),
        points: off.len(),
    }))
}

fn hash(numbers: &[f32]) -> u64 {
    let mix = |h: u64, v: &f32| (h ^ u64::from(v.to_bits())).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    numbers.iter().fold(0, mix) >> 40
}

impl Terrain {
    /// The plane z = 0 of the world, none of it observed.
    pub fn level(geometry: GridGeometry, frame: &Frame) -> Terrain {
        let zero = (-frame.origin.z * frame.unit_m().z) as f32;
        Terrain { heights: Grid::filled(geometry, zero), is_observed: vec![false; geometry.len()] }
    }

    /// With the cells observed that hold one of the points.
    #[must_use]
    pub fn with_observed(mut self, ground: &[Vec3]) -> Terrain {
        let g = self.heights.geometry;
        for p in ground {
            if let Some((c, r)) = g.cell_of(p.x.into(), p.y.into()) {
                self.is_observed[g.index(c, r)] = true;
            }
        }
        self
    }

    /// By cell: whether ground was seen within so many metres, east or west and north or south.
    pub fn is_near_ground(&self, reach_m: f64) -> Vec<bool> {
        let g = self.heights.geometry;
        let [across, down] = [g.cell_x, g.cell_y].map(|cell| (reach_m / cell).floor() as usize);
        // Spreads what is set along each run of `n` cells, `stride` apart.
        let spread = |cells: &mut [bool], start: usize, n: usize, stride: usize, reach: usize| {
            let set: Vec<bool> = (0..n).map(|i| cells[start + i * stride]).collect();
            let (mut left, mut ahead) = (usize::MAX, 0);
            for i in 0..n {
                if set[i] {
                    left = i;
                }
                ahead = ahead.max(i);
                while ahead < n && !set[ahead] {
                    ahead += 1;
                }
                let is_near = |at: usize| at < n && at.abs_diff(i) <= reach;
                cells[start + i * stride] = is_near(left) || is_near(ahead);
            }
        };
        let mut cells = self.is_observed.clone();
        (0..g.rows).for_each(|row| spread(&mut cells, row * g.cols, g.cols, 1, across));
        (0..g.cols).for_each(|col| spread(&mut cells, col, g.rows, g.cols, down));
        cells
    }

    /// What a user should know.
    pub fn warning(&self) -> Option<String> {
        let (seen, cells) =
            (self.is_observed.iter().filter(|&&o| o).count(), self.is_observed.len());
        let share = 100.0 * seen as f64 / cells.max(1) as f64;
        (share < 5.0).then(|| {
            format!(
                "only {share:.1} % of the terrain's cells hold a ground point; the rest is \
                 interpolated"
            )
        })
    }

    /// Into another frame.
    pub fn moved(mut self, by: Vec3) -> Terrain {
        self.heights.geometry.west += f64::from(by.x);
        self.heights.geometry.north += f64::from(by.y);
        self.heights.data.par_iter_mut().for_each(|z| *z += by.z);
        self
    }

    /// Height at a place, bilinear; clamped to the border outside.
    pub fn height_at(&self, p: Vec2) -> f32 {
        self.heights.bilinear(f64::from(p.x), f64::from(p.y))
    }

    /// The cells whose centres lie in the box; `None` where there are none.
    pub fn cropped(&self, low: Vec2, high: Vec2) -> Option<Terrain> {
        let g = self.heights.geometry;
        let span = |low: f64, high: f64, count: usize| {
            let first = (low - 0.5).ceil().clamp(0.0, count as f64) as usize;
            let end = (high - 0.5).ceil().clamp(0.0, count as f64) as usize;
            (first, end)
        };
        let column = |x: f32| (f64::from(x) - g.west) / g.cell_x;
        let row = |y: f32| (g.north - f64::from(y)) / g.cell_y;
        let (c0, c1) = span(column(low.x), column(high.x), g.cols);
        let (r0, r1) = span(row(high.y), row(low.y), g.rows);
        if c0 >= c1 || r0 >= r1 {
            return None;
        }
        let geometry = GridGeometry {
            west: g.west + c0 as f64 * g.cell_x,
            north: g.north - r0 as f64 * g.cell_y,
            cols: c1 - c0,
            rows: r1 - r0,
            ..g
        };
        let cells = || (r0..r1).flat_map(|r| (c0..c1).map(move |c| g.index(c, r)));
        Some(Terrain {
            heights: Grid { geometry, data: cells().map(|i| self.heights.data[i]).collect() },
            is_observed: cells().map(|i| self.is_observed[i]).collect(),
        })
    }

    /// How many of the points that may show the ground lie between 0.3 m below and 0.3 m above it,
    /// and how many between 0.3 m below and 1 m above; of one point in `one_in`, a power of two, drawn
    /// by a hash of its place.
    pub fn near(&self, classified: &Classified, one_in: u64) -> (usize, usize) {
        let points = classified.cloud.position.par_iter().zip(&classified.kind);
        let count = |(p, kind): (&Vec3, &Kind)| {
            if hash(&p.to_array()) & (one_in - 1) != 0 {
                return (0, 0);
            }
            let above = p.z - self.height_at(p.truncate());
            let is_layer = *kind != Kind::Excluded && (-0.3..1.0).contains(&above);
            (usize::from(is_layer && above < 0.3), usize::from(is_layer))
        };
        points.map(count).reduce(|| (0, 0), |a, b| (a.0 + b.0, a.1 + b.1))
    }

    /// Unit normal at a place, from central differences one cell wide.
    pub fn normal_at(&self, p: Vec2) -> Vec3 {
        let d = self.heights.geometry.cell_x as f32 * 0.5;
        let dx = self.height_at(p + Vec2::X * d) - self.height_at(p - Vec2::X * d);
        let dy = self.height_at(p + Vec2::Y * d) - self.height_at(p - Vec2::Y * d);
        Vec3::new(-dx, -dy, 2.0 * d).normalize()
    }

    /// What breaks the invariants: every height finite, columns as long as the grid.
    pub fn check(&self) -> std::result::Result<(), String> {
        let n = self.heights.geometry.len();
        if self.heights.data.len() != n || self.is_observed.len() != n || n == 0 {
            return Err(format!("{n} cells, {} heights", self.heights.data.len()));
        }
        match self.heights.data.iter().position(|z| !z.is_finite()) {
            Some(i) => Err(format!("cell {i} has no finite height")),
            None => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;
    use crate::frame::Frame;
    use crate::scan::PointCloud;

    pub(super) fn from_function(
        cols: usize,
        rows: usize,
        cell: f64,
        f: impl Fn(f64, f64) -> f64,
    ) -> Terrain {
        let geometry = GridGeometry {
            west: 0.0,
            north: rows as f64 * cell,
            cell_x: cell,
            cell_y: cell,
            cols,
            rows,
        };
        let mut heights = Grid::filled(geometry, 0.0);
        for row in 0..rows {
            for col in 0..cols {
                let [x, y] = geometry.centre(col, row);
                heights.set(col, row, f(x, y) as f32);
            }
        }
        Terrain { heights, is_observed: vec![true; geometry.len()] }
    }

    fn classified(points: Vec<Vec3>, ground: impl Fn(&Vec3) -> bool) -> Classified {
        let kind = points
            .iter()
            .map(|p| if ground(p) { Kind::Ground } else { Kind::Vegetation })
            .collect();
        let n = points.len();
        Classified {
            cloud: PointCloud {
                frame: Frame::local(DVec3::ZERO),
                position: points,
                intensity: vec![0; n],
                return_number: vec![1; n],
                return_count: vec![1; n],
                class: vec![1; n],
                rgb: None,
            },
            kind,
            is_normalised: false,
        }
    }

    fn scattered(n: u32, f: impl Fn(f32, f32) -> f32) -> Vec<Vec3> {
        let mut d = crate::seed::Seed::new(9).draws();
        (0..n)
            .map(|_| {
                let (x, y) = (d.between(0.0, 60.0), d.between(0.0, 40.0));
                Vec3::new(x, y, f(x, y))
            })
            .collect()
    }

    #[test]
    fn a_tilted_plane_is_exact_up_to_and_beyond_the_hull() {
        let plane = |x: f32, y: f32| 100.0 + 0.5 * x - 0.3 * y;
        let mut points = scattered(3000, plane);
        // Vegetation widens the cloud beyond the ground.
        points.push(Vec3::new(-5.0, -5.0, 130.0));
        points.push(Vec3::new(66.0, 44.0, 130.0));
        let c = classified(points, |p| p.z < 129.0);
        let terrain = build(&c, &TerrainOptions::default()).unwrap().value;
        terrain.check().unwrap();
        for (x, y) in [(30.0, 20.0), (1.0, 39.0), (-4.0, -4.0), (65.0, 43.0), (-4.0, 43.0)] {
            let off = terrain.height_at(Vec2::new(x, y)) - plane(x, y);
            assert!(off.abs() < 0.02, "{off} at {x} {y}");
        }
        let error = held_out_error(&c, &TerrainOptions::default()).unwrap().unwrap();
        assert!(error.rmse_m < 1e-3 && error.points > 200, "{error:?}");
    }

    #[test]
    fn held_out_error_is_that_of_the_noise() {
        let mut d = crate::seed::Seed::new(4).draws();
        let points: Vec<Vec3> =
            scattered(8000, |_, _| 0.0).iter().map(|p| *p + Vec3::Z * 0.1 * d.normal()).collect();
        let error = held_out_error(&classified(points, |_| true), &TerrainOptions::default())
            .unwrap()
            .unwrap();
        assert!((0.1..0.16).contains(&error.rmse_m), "{error:?}");
    }

    #[test]
    fn a_large_void_is_filled_without_overshoot() {
        let hill = |x: f32, y: f32| {
            10.0 + 3.0 * (-((x - 20.0).powi(2) + (y - 20.0).powi(2)) / 300.0).exp()
        };
        let points: Vec<Vec3> =
            scattered(6000, hill).into_iter().filter(|p| p.x < 25.0 || p.x > 45.0).collect();
        let terrain =
            build(&classified(points, |_| true), &TerrainOptions::default()).unwrap().value;
        let (low, high) = terrain
            .heights
            .data
            .iter()
            .fold((f32::MAX, f32::MIN), |(a, b), &z| (a.min(z), b.max(z)));
        assert!(low > 9.5 && high < 13.5, "{low} {high}");
    }

    #[test]
    fn scattered_points_are_refused_unless_a_cell_is_asked_for() {
        let far = Vec3::new(20_000.0, 10_000.0, 50.0);
        let error = check_extent(Vec3::ZERO, far, 10_000, None).unwrap_err();
        assert_eq!(error.message(), "10000 points lie scattered over 20.0 × 10.0 km");
        check_extent(Vec3::ZERO, far, 10_000, Some(10.0)).unwrap();
        check_extent(Vec3::ZERO, far, 1_000_000, None).unwrap();
        check_extent(Vec3::ZERO, far * 0.05, 3, None).unwrap();
        assert!(check_extent(Vec3::ZERO, far, usize::MAX / 64, Some(0.1)).is_err());
    }

    #[test]
    fn too_few_points_or_too_fine_a_cell_are_refused() {
        let two = classified(vec![Vec3::ZERO, Vec3::ONE], |_| true);
        let e = build(&two, &TerrainOptions::default()).unwrap_err();
        assert_eq!(e.message(), "2 ground points make no terrain");
        let points = scattered(100, |_, _| 0.0);
        let options = TerrainOptions { cell_m: Some(1e-4), ..TerrainOptions::default() };
        let e = build(&classified(points, |_| true), &options).unwrap_err();
        assert!(e.remedy_text().unwrap().contains("--cell"), "{e:?}");
    }

    #[test]
    fn collinear_ground_still_gives_heights() {
        let points: Vec<Vec3> =
            (0..50).map(|i| Vec3::new(i as f32, i as f32, i as f32 * 0.1)).collect();
        let terrain =
            build(&classified(points, |_| true), &TerrainOptions::default()).unwrap().value;
        terrain.check().unwrap();
    }

    #[test]
    fn normalised_clouds_stand_on_the_plane_zero_of_the_world() {
        let mut c = classified(scattered(500, |_, _| 3.0), |_| false);
        c.is_normalised = true;
        c.cloud.frame.origin.z = -10.0;
        let terrain = build(&c, &TerrainOptions::default()).unwrap().value;
        assert!(terrain.heights.data.iter().all(|&z| z == 10.0));
    }
}
