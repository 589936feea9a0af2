//! What the laser shows of each crown, for telling conifers from broadleaves (`kind`): where in the
//! tree the returns lie, and how bright they are against the ground's. Free of the density of the
//! scan, of the size of the tree and of the scanner's scale of intensity.
//!
//! Limits: ground that hardly returns (water, wet asphalt) or returns more than any (snow) shifts
//! every intensity alike; a crown over another's undergrowth seems deeper than it is.

use glam::Vec2;
use rayon::prelude::*;

use crate::crown::Crown;
use crate::ground::{Classified, Kind};
use crate::raster::Groups;
use crate::raster::polygon::contains;
use crate::terrain::Terrain;

/// Returns lower than this above the ground say nothing of a crown, metres.
const LOW_M: f32 = 1.0;
/// Fewer returns show no shape, fewer first returns no slope.
const LEAST_RETURNS: u32 = 5;
const LEAST_FIRSTS: u32 = 20;
/// Side of the cells in which points are looked up, metres.
const CELL_M: f64 = 1.0;

/// One crown by its returns.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Look {
    /// Mean height of the returns over that of the highest, 0…1.
    pub mean_height: f32,
    /// Standard deviation of their heights over the height of the highest.
    pub height_spread: f32,
    /// How far the first returns sink a metre from the middle of the crown outwards, metres: by the
    /// regression of height on distance. 0 where they are too few to tell.
    pub steepness: f32,
    /// Mean intensity of the first returns, in the scan's own scale; `None` without any.
    pub intensity: Option<f32>,
}

/// The crowns of a scan.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Looks {
    /// One a crown; `None` where too few returns lie in its outline.
    pub of_crown: Vec<Option<Look>>,
    /// Median intensity of the ground's returns; `None` where the scan has no intensity.
    pub ground_intensity: Option<f32>,
}

impl Looks {
    /// Logarithm of a crown's intensity over the ground's.
    pub fn intensity_over_ground(&self, look: &Look) -> Option<f32> {
        let ground = self.ground_intensity?;
        look.intensity.map(|i| (i.max(1.0) / ground.max(1.0)).ln())
    }
}

/// Looks at every crown through the vegetation's returns inside its outline, in the crowns' order.
pub fn measure(crowns: &[Crown], classified: &Classified, terrain: &Terrain) -> Looks {
    let places = Places::new(classified);
    let of_crown = crowns
        .par_iter()
        .map(|c| look(&c.outline, classified, terrain, places.as_ref()?))
        .collect();
    Looks { of_crown, ground_intensity: ground_intensity(classified) }
}

fn look(
    outline: &[Vec2],
    classified: &Classified,
    terrain: &Terrain,
    places: &Places,
) -> Option<Look> {
    let cloud = &classified.cloud;
    let (mut count, mut sum, mut sum_sq, mut top) = (0u32, 0.0f64, 0.0f64, 0.0f64);
    let (mut firsts, mut light) = (0u32, 0.0f64);
    let mut slope = Slope::default();
    let (low, high) = bounds(outline);
    let middle = 0.5 * (low + high);
    for i in places.inside(outline) {
        let i = i as usize;
        let p = *cloud.position.get(i)?;
        let at = p.truncate();
        let is_in_box = at.cmpge(low).all() && at.cmple(high).all();
        if !(is_in_box && contains(outline, at)) {
            continue;
        }
        let height = p.z - terrain.height_at(at);
        if height < LOW_M {
            continue;
        }
        let height = f64::from(height);
        count += 1;
        sum += height;
        sum_sq += height * height;
        top = top.max(height);
        if cloud.return_number.get(i) == Some(&1) {
            firsts += 1;
            slope.add(p.truncate().distance(middle).into(), height);
            light += f64::from(*cloud.intensity.get(i)?);
        }
    }
    if count < LEAST_RETURNS {
        return None;
    }
    let mean = sum / f64::from(count);
    let spread = (sum_sq / f64::from(count) - mean * mean).max(0.0).sqrt();
    Some(Look {
        mean_height: (mean / top) as f32,
        height_spread: (spread / top) as f32,
        steepness: if firsts < LEAST_FIRSTS { 0.0 } else { -slope.value() as f32 },
        intensity: (firsts > 0).then(|| (light / f64::from(firsts)) as f32),
    })
}

/// Linear regression, point by point.
#[derive(Default)]
struct Slope {
    n: f64,
    x: f64,
    y: f64,
    xx: f64,
    xy: f64,
}

impl Slope {
    fn add(&mut self, x: f64, y: f64) {
        self.n += 1.0;
        self.x += x;
        self.y += y;
        self.xx += x * x;
        self.xy += x * y;
    }

    /// 0 where all points are at one place.
    fn value(&self) -> f64 {
        let spread = self.n * self.xx - self.x * self.x;
        if spread > 1e-6 { (self.n * self.xy - self.x * self.y) / spread } else { 0.0 }
    }
}

fn bounds(outline: &[Vec2]) -> (Vec2, Vec2) {
    let none = (Vec2::INFINITY, Vec2::NEG_INFINITY);
    outline.iter().fold(none, |(l, h), p| (l.min(*p), h.max(*p)))
}

/// How often each intensity occurs among the ground's returns.
pub struct GroundIntensity(Vec<u64>);

impl Default for GroundIntensity {
    fn default() -> Self {
        GroundIntensity(vec![0; usize::from(u16::MAX) + 1])
    }
}

impl GroundIntensity {
    pub fn add(&mut self, intensity: u16) {
        self.0[usize::from(intensity)] += 1;
    }

    /// `None` where the scan has no intensity.
    pub fn median(&self) -> Option<f32> {
        let mut left = self.0.iter().sum::<u64>() / 2;
        let median = self.0.iter().position(|&n| {
            let is_here = left < n;
            left = left.saturating_sub(n);
            is_here
        })?;
        (median > 0).then_some(median as f32)
    }
}

fn ground_intensity(classified: &Classified) -> Option<f32> {
    let mut counts = GroundIntensity::default();
    let returns = classified.cloud.intensity.iter().zip(&classified.kind);
    returns.filter(|(_, k)| **k == Kind::Ground).for_each(|(&i, _)| counts.add(i));
    counts.median()
}

/// Vegetation points by cell, in their order.
struct Places {
    low: Vec2,
    cell: f32,
    cols: usize,
    rows: usize,
    points: Groups,
}

impl Places {
    /// `None` without vegetation.
    fn new(classified: &Classified) -> Option<Places> {
        let points = || classified.cloud.position.par_iter().zip(&classified.kind);
        let add = |a: (Vec2, Vec2, usize), b: (Vec2, Vec2, usize)| {
            (a.0.min(b.0), a.1.max(b.1), a.2 + b.2)
        };
        let (low, high, count) = points()
            .filter(|(_, k)| **k == Kind::Vegetation)
            .map(|(p, _)| (p.truncate(), p.truncate(), 1))
            .reduce_with(add)?;
        let size = (high - low).as_dvec2();
        // No more cells than points, however far apart those lie.
        let least = (size.x.max(CELL_M) * size.y.max(CELL_M) / count as f64).sqrt();
        let cell = CELL_M.max(least) as f32;
        let cols = ((high.x - low.x) / cell) as usize + 1;
        let rows = ((high.y - low.y) / cell) as usize + 1;
        let place = |p: Vec2| place(p, low, cell, (cols, rows));
        let cell_of = points().map(|(p, k)| {
            let (col, row) = place(p.truncate());
            if *k == Kind::Vegetation { (row * cols + col) as u32 } else { u32::MAX }
        });
        let points = Groups::new(cols * rows, cell_of, |i| i);
        Some(Places { low, cell, cols, rows, points })
    }

    /// Points in the cells that a polygon's bounding box touches.
    fn inside(&self, outline: &[Vec2]) -> impl Iterator<Item = u32> + '_ {
        let (low, high) = bounds(outline);
        let [(west, south), (east, north)] =
            [low, high].map(|p| place(p, self.low, self.cell, (self.cols, self.rows)));
        (south..=north)
            .flat_map(move |row| (west..=east).map(move |col| row * self.cols + col))
            .flat_map(|cell| self.points.of(cell).iter().copied())
    }
}

/// Column and row of the cell nearest to a place.
fn place(p: Vec2, low: Vec2, cell: f32, (cols, rows): (usize, usize)) -> (usize, usize) {
    let c = (p - low) / cell;
    ((c.x.max(0.0) as usize).min(cols - 1), (c.y.max(0.0) as usize).min(rows - 1))
}

#[cfg(test)]
mod tests {
    use glam::{DVec3, Vec3};

    use super::*;
    use crate::frame::Frame;
    use crate::raster::{Grid, GridGeometry};
    use crate::scan::PointCloud;

    /// Ground at 100 m of intensity 50; crowns of radius 2 m whose returns stand 1 m apart from 1 m
    /// to `top` above it.
    fn scene(crowns: &[(Vec2, u16, u16)]) -> (Vec<Crown>, Classified, Terrain) {
        let g = GridGeometry::covering([-50.0, -50.0], [50.0, 50.0], 1.0);
        let terrain = Terrain { heights: Grid::filled(g, 100.0), is_observed: vec![true; g.len()] };
        let mut points: Vec<(Vec3, u16, Kind)> =
            (0..40).map(|i| (Vec3::new(i as f32 - 20.0, 0.0, 100.0), 50, Kind::Ground)).collect();
        for &(at, top, intensity) in crowns {
            points.extend(
                (1..=top).map(|z| (at.extend(100.0 + f32::from(z)), intensity, Kind::Vegetation)),
            );
        }
        let n = points.len();
        let cloud = PointCloud {
            frame: Frame::local(DVec3::ZERO),
            position: points.iter().map(|p| p.0).collect(),
            intensity: points.iter().map(|p| p.1).collect(),
            return_number: vec![1; n],
            return_count: vec![1; n],
            class: vec![0; n],
            rgb: None,
        };
        let kind = points.iter().map(|p| p.2).collect();
        let found = crowns.iter().map(|&(at, top, _)| Crown {
            key: 0,
            root: at.extend(100.0),
            apex: at.extend(100.0 + f32::from(top)),
            height_m: f32::from(top),
            base_height_m: 0.0,
            diameter_m: 4.0,
            spread_m: 5.0,
            volume_cu_m: 60.0,
            surface_sq_m: 90.0,
            is_understory: false,
            outline: [(-2., -2.), (2., -2.), (2., 2.), (-2., 2.)]
                .map(|(x, y)| at + Vec2::new(x, y))
                .to_vec(),
            attractors: Vec::new(),
            point_count: 1,
            confidence: 1.0,
        });
        (found.collect(), Classified { cloud, kind, is_normalised: false }, terrain)
    }

    #[test]
    fn a_crown_is_seen_by_its_own_returns() {
        let all = [(Vec2::new(-30.0, 7.0), 20, 100), (Vec2::new(31.0, -40.0), 9, 25)];
        let (crowns, classified, terrain) = scene(&all);
        let looks = measure(&crowns, &classified, &terrain);
        for (look, (_, top, intensity)) in looks.of_crown.iter().zip(all) {
            let (look, n) = (look.unwrap(), f32::from(top));
            assert!((look.mean_height - (n + 1.0) / 2.0 / n).abs() < 1e-4);
            assert!((look.height_spread - ((n * n - 1.0) / 12.0).sqrt() / n).abs() < 1e-4);
            let over = looks.intensity_over_ground(&look).unwrap();
            assert!((over - (f32::from(intensity) / 50.0).ln()).abs() < 1e-4);
        }
        let alone = measure(&crowns[1..], &classified, &terrain);
        assert_eq!(alone.of_crown[0], looks.of_crown[1]);
    }

    #[test]
    fn too_few_returns_or_no_intensity_tell_nothing() {
        let (crowns, mut classified, terrain) =
            scene(&[(Vec2::ZERO, 4, 9), (Vec2::splat(9.0), 5, 9)]);
        classified.cloud.intensity.fill(0);
        let looks = measure(&crowns, &classified, &terrain);
        assert_eq!(looks.of_crown[0], None);
        assert_eq!(looks.ground_intensity, None);
        assert_eq!(looks.intensity_over_ground(&looks.of_crown[1].unwrap()), None);
        classified.kind.fill(Kind::Ground);
        assert_eq!(measure(&crowns, &classified, &terrain).of_crown, [None, None]);
    }

    #[test]
    fn a_cone_is_as_steep_as_its_side() {
        let (mut crowns, mut classified, terrain) = scene(&[(Vec2::splat(5.0), 20, 9)]);
        classified.kind.fill(Kind::Excluded);
        let cloud = &mut classified.cloud;
        for i in 0..400u16 {
            let (x, y) = (f32::from(i % 20) * 0.2 - 1.9, f32::from(i / 20) * 0.2 - 1.9);
            let down = 4.0 * x.hypot(y);
            cloud.position.push(Vec3::new(5.0 + x, 5.0 + y, 120.0 - down));
            cloud.intensity.push(9);
            cloud.return_number.push(1);
            cloud.return_count.push(1);
            cloud.class.push(0);
            classified.kind.push(Kind::Vegetation);
        }
        let cone = measure(&crowns, &classified, &terrain).of_crown[0].unwrap();
        assert!((cone.steepness - 4.0).abs() < 1e-2, "{}", cone.steepness);
        crowns[0].outline =
            [(4.8, 4.8), (5.6, 4.8), (5.6, 5.6), (4.8, 5.6)].map(Vec2::from).to_vec();
        let few = measure(&crowns, &classified, &terrain).of_crown[0].unwrap();
        assert_eq!(few.steepness, 0.0);
    }
}
