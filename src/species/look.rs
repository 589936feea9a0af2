//! What the laser shows of each crown, for telling conifers from broadleaves (`kind`): where in the
//! tree the returns lie, and how bright they are against the ground's. Free of the density of the
//! scan, of the size of the tree and of the scanner's scale of intensity.
//!
//! Limits: ground that hardly returns (water, wet asphalt) or returns more than any (snow) shifts
//! every intensity alike; a crown over another's undergrowth seems deeper than it is.

use glam::{DVec2, Vec2};
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
/// Side of the cells in which crowns are looked up, metres, at least.
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
/// Sums are of whole millimetres: they are the same in whatever order the returns come.
pub fn measure(crowns: &[Crown], classified: &Classified, terrain: &Terrain) -> Looks {
    let (ground_intensity, of_crown) =
        rayon::join(|| ground_intensity(classified), || looks(crowns, classified, terrain));
    Looks { of_crown, ground_intensity }
}

fn looks(crowns: &[Crown], classified: &Classified, terrain: &Terrain) -> Vec<Option<Look>> {
    let Some(places) = Places::new(crowns) else { return vec![None; crowns.len()] };
    let cloud = &classified.cloud;
    let together = cloud.len().div_ceil(2 * rayon::current_num_threads()).max(1 << 14);
    let sums = (cloud.position.par_chunks(together).enumerate())
        .map(|(run, points)| {
            let mut sums = vec![Sums::default(); crowns.len()];
            for (i, &p) in (run * together..).zip(points) {
                if classified.kind.get(i) != Some(&Kind::Vegetation) {
                    continue;
                }
                let at = p.truncate();
                let mut height_m = None;
                for &crown in places.near(at) {
                    let span = &places.span[crown as usize];
                    if !span.holds(at, &crowns[crown as usize].outline) {
                        continue;
                    }
                    let Span { low, high, .. } = *span;
                    let height_m = *height_m.get_or_insert_with(|| p.z - terrain.height_at(at));
                    if height_m >= LOW_M {
                        let first = (cloud.return_number.get(i) == Some(&1))
                            .then(|| (at.distance(0.5 * (low + high)), cloud.intensity.get(i)));
                        sums[crown as usize].add(height_m, first);
                    }
                }
            }
            sums
        })
        .reduce_with(|mut all, run| {
            all.iter_mut().zip(run).for_each(|(sum, more)| sum.join(&more));
            all
        });
    sums.unwrap_or_default().iter().map(Sums::look).collect()
}

/// Longer lengths are cut to this, so that no sum overflows: no tree is so tall.
const LONGEST_M: f32 = 200.0;

/// Of the returns of one crown; lengths in millimetres.
#[derive(Clone, Copy, Default)]
struct Sums {
    count: u64,
    height: u64,
    height_sq: u64,
    top: u64,
    /// Of the first returns: number, intensity, height, distance from the middle.
    firsts: u64,
    light: u64,
    first_height: u64,
    away: u64,
    away_sq: u64,
    away_height: u64,
}

impl Sums {
    /// `first`: of a first return, the distance from the middle and the intensity.
    fn add(&mut self, height_m: f32, first: Option<(f32, Option<&u16>)>) {
        // To the nearest, of what is not negative.
        let mm = |m: f32| (f64::from(m.min(LONGEST_M) * 1000.0) + 0.5) as u64;
        let height = mm(height_m);
        self.count += 1;
        self.height += height;
        self.height_sq += height * height;
        self.top = self.top.max(height);
        if let Some((away_m, intensity)) = first {
            let away = mm(away_m);
            self.firsts += 1;
            self.light += u64::from(intensity.copied().unwrap_or(0));
            self.first_height += height;
            self.away += away;
            self.away_sq += away * away;
            self.away_height += away * height;
        }
    }

    fn join(&mut self, more: &Sums) {
        self.count += more.count;
        self.height += more.height;
        self.height_sq += more.height_sq;
        self.top = self.top.max(more.top);
        self.firsts += more.firsts;
        self.light += more.light;
        self.first_height += more.first_height;
        self.away += more.away;
        self.away_sq += more.away_sq;
        self.away_height += more.away_height;
    }

    fn look(&self) -> Option<Look> {
        if self.count < u64::from(LEAST_RETURNS) {
            return None;
        }
        let (n, top) = (self.count as f64, self.top as f64);
        let mean = self.height as f64 / n;
        let spread = (self.height_sq as f64 / n - mean * mean).max(0.0).sqrt();
        let is_sloped = self.firsts >= u64::from(LEAST_FIRSTS);
        Some(Look {
            mean_height: (mean / top) as f32,
            height_spread: (spread / top) as f32,
            steepness: if is_sloped { -self.slope() as f32 } else { 0.0 },
            intensity: (self.firsts > 0).then(|| (self.light as f64 / self.firsts as f64) as f32),
        })
    }

    /// Of the first returns' height over their distance from the middle, by linear regression; 0
    /// where all are as far.
    fn slope(&self) -> f64 {
        let n = self.firsts as f64;
        let (x, y) = (self.away as f64 / n, self.first_height as f64 / n);
        let spread = self.away_sq as f64 / n - x * x;
        if spread > 1.0 { (self.away_height as f64 / n - x * y) / spread } else { 0.0 }
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

/// Bounding box of an outline, and how far from its middle the outline holds everything.
#[derive(Clone, Copy)]
struct Span {
    low: Vec2,
    high: Vec2,
    inner_sq: f32,
}

impl Span {
    fn of(outline: &[Vec2]) -> Span {
        let (low, high) = bounds(outline);
        let middle = 0.5 * (low + high);
        let from_edge = |i: usize| {
            let (a, b) = (outline[i], outline[(i + 1) % outline.len()]);
            let along = (b - a) / (b - a).length_squared().max(1e-12);
            (a.lerp(b, (middle - a).dot(along).clamp(0.0, 1.0))).distance(middle)
        };
        let nearest = (0..outline.len()).map(from_edge).fold(f32::INFINITY, f32::min);
        // Less by what rounding may take.
        let inner = 0.99 * nearest - 1e-6 * middle.abs().max_element();
        let is_known = contains(outline, middle) && inner > 0.0 && inner.is_finite();
        Span { low, high, inner_sq: if is_known { inner * inner } else { 0.0 } }
    }

    fn holds(&self, p: Vec2, outline: &[Vec2]) -> bool {
        p.cmpge(self.low).all()
            && p.cmple(self.high).all()
            && (p.distance_squared(0.5 * (self.low + self.high)) < self.inner_sq
                || contains(outline, p))
    }
}

/// Which crowns may hold a place: by the cells that their bounding boxes touch.
struct Places {
    low: Vec2,
    cell: f32,
    cols: usize,
    rows: usize,
    crowns: Groups,
    /// Of each crown.
    span: Vec<Span>,
}

impl Places {
    /// `None` without crowns.
    fn new(crowns: &[Crown]) -> Option<Places> {
        let span: Vec<Span> = crowns.par_iter().map(|c| Span::of(&c.outline)).collect();
        let (low, high) =
            span.iter().map(|s| (s.low, s.high)).reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)))?;
        // Cells and entries in proportion to the crowns, however large and far apart those are.
        let area = |low: Vec2, high: Vec2| {
            let size = (high - low).as_dvec2().max(DVec2::splat(CELL_M));
            size.x * size.y
        };
        let most = 64.0 * crowns.len() as f64 + 65_536.0;
        let all = span.iter().map(|s| area(s.low, s.high)).sum::<f64>().max(area(low, high));
        let cell = CELL_M.max((all / most).sqrt()) as f32;
        let count = |from: f32, to: f32| ((to - from) / cell) as usize + 1;
        let (cols, rows) = (count(low.x, high.x), count(low.y, high.y));
        let place = |p: Vec2| place(p, low, cell, (cols, rows));
        let mut touched: Vec<(u32, u32)> = Vec::new();
        for (crown, s) in (0u32..).zip(&span) {
            let [(west, south), (east, north)] = [s.low, s.high].map(place);
            for row in south..=north {
                touched.extend((west..=east).map(|col| ((row * cols + col) as u32, crown)));
            }
        }
        let crowns = Groups::new(cols * rows, touched.par_iter().map(|(cell, _)| *cell), |i| {
            touched[i as usize].1
        });
        Some(Places { low, cell, cols, rows, crowns, span })
    }

    /// Crowns that may hold a place.
    fn near(&self, p: Vec2) -> &[u32] {
        let (col, row) = place(p, self.low, self.cell, (self.cols, self.rows));
        self.crowns.of(row * self.cols + col)
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
