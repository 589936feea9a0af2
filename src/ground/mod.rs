//! Which points are ground (L) and which vegetation (T). Knows nothing of terrain.

mod densify;
mod lowest;
mod morphology;
mod regrow;
mod smrf;
mod voxel_rules;

use glam::Vec3;
use lowest::Lowest;
use rayon::prelude::*;

use crate::diagnostic::{Error, Result, Warned};
use crate::raster::{GridGeometry, floor, scatter};
use crate::scan::PointCloud;

/// What a point is, VL = T ∪ L ∪ E (T15); E is what is neither (water, buildings, wires).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    Ground,
    Vegetation,
    Excluded,
}

/// A cloud with the kind of every point.
#[derive(Debug, Clone)]
pub struct Classified {
    pub cloud: PointCloud,
    /// As long as the cloud.
    pub kind: Vec<Kind>,
    /// The heights were already above ground when read (the ground is then the plane z = 0 of the
    /// world).
    pub is_normalised: bool,
}

/// How ground points are found.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Method {
    /// Simple morphological filter (Pingel 2013), coarse to fine.
    #[default]
    Smrf,
    /// Progressive densification of a triangulation (Axelsson 2000).
    Tin,
    /// The voxel rules of the source (T15).
    VoxelRules,
    /// Class 2 of the file.
    FileClasses,
}

/// ASPRS classes that are neither ground nor vegetation.
const NEITHER: [u8; 10] = [6, 7, 9, 10, 13, 14, 15, 16, 17, 18];
const FILE_GROUND: u8 = 2;
/// Ground of a cloud of normalised heights lies this close to zero, metres.
const NORMALISED_GROUND_M: f32 = 0.25;

/// Finds the kind of every point. Classes of the file are read for what is neither ground nor
/// vegetation, and for ground with [`Method::FileClasses`] only.
///
/// # Errors
/// No points; fewer than three that could be ground; no class 2 where that is asked for.
pub fn classify(cloud: PointCloud, method: Method) -> Result<Warned<Classified>> {
    if cloud.len() < 3 {
        return Err(Error::new(format!("too few points to find the ground: {}", cloud.len()))
            .remedy("give a whole scan: at least a few points that reached the ground"));
    }
    let last = last_returns(&cloud);
    // Return numbers may be wrong throughout; every point is then a candidate.
    let candidates = if last.len() < FEWEST { &cloud.position } else { &last };
    let is_normalised = Floor::of(candidates, zero_level(&cloud)).is_zero();
    let kind = Rule::learn(candidates, method, is_normalised).kinds(&cloud);
    let ground = kind.iter().filter(|&&k| k == Kind::Ground).count();
    let warnings = check(method, ground, is_normalised)?;
    Ok(Warned::with(Classified { cloud, kind, is_normalised }, warnings))
}

/// Fewest points that make ground.
const FEWEST: usize = 3;

/// Whether so many ground points will do, and what a user should know.
///
/// # Errors
/// Too few.
pub fn check(method: Method, ground_points: usize, is_normalised: bool) -> Result<Vec<String>> {
    if method == Method::FileClasses && ground_points == 0 {
        return Err(Error::new("the scan holds no ground points (class 2)")
            .remedy("let them be found: leave out --ground file"));
    }
    if ground_points < FEWEST && !is_normalised {
        return Err(Error::new("no ground was found in the scan").remedy(
            "give a scan whose lowest returns reach the ground, or try --ground voxel or --ground \
             file",
        ));
    }
    let normalised =
        "the heights are above ground already: the terrain is taken as the plane z = 0";
    Ok(is_normalised.then(|| normalised.to_owned()).into_iter().collect())
}

/// What tells the ground of an area from what stands on it, point by point: whatever part of the
/// area points come from, they are judged alike.
pub enum Rule {
    /// Near a surface through the lowest points.
    Surface(smrf::Surface),
    /// Near a triangulation of the lowest points.
    Tin(densify::Tin),
    /// Low in its column. Pieces of an area are to hold whole regions of columns, which are aligned
    /// to multiples of 8 m.
    Voxels,
    FileClasses,
    /// Near z = 0 of the world.
    Zero,
}

impl Rule {
    /// Whether the method looks at the lowest points of the whole area.
    pub fn looks_at_lowest(method: Method) -> bool {
        matches!(method, Method::Smrf | Method::Tin)
    }

    /// `candidates`: points that may be ground, or the [`lowest`] of them.
    pub fn learn(candidates: &[Vec3], method: Method, is_normalised: bool) -> Rule {
        match method {
            Method::FileClasses => Rule::FileClasses,
            _ if is_normalised => Rule::Zero,
            Method::VoxelRules => Rule::Voxels,
            Method::Smrf => Rule::Surface(smrf::surface(&Lowest::of(candidates))),
            Method::Tin => Rule::Tin(densify::densified(&Lowest::of(candidates))),
        }
    }

    /// The kind of every point.
    pub fn kinds(&self, cloud: &PointCloud) -> Vec<Kind> {
        let points = &cloud.position;
        let is_ground: Vec<bool> = match self {
            Rule::Surface(surface) => surface.ground(points),
            Rule::Tin(tin) => densify::ground(tin, points),
            Rule::Voxels => voxel_rules::ground(points),
            Rule::FileClasses => cloud.class.iter().map(|&c| c == FILE_GROUND).collect(),
            Rule::Zero => {
                let zero = zero_level(cloud);
                points.par_iter().map(|p| (p.z - zero).abs() <= NORMALISED_GROUND_M).collect()
            }
        };
        let kinds = is_ground.par_iter().zip(&cloud.class).map(|(&ground, class)| {
            match (NEITHER.contains(class), ground) {
                (true, _) => Kind::Excluded,
                (false, true) => Kind::Ground,
                (false, false) => Kind::Vegetation,
            }
        });
        kinds.collect()
    }
}

/// Sides of the areas in which [`Rule::learn`] looks at the lowest point of every half metre, and
/// how much more about them it is to see, so that it makes no difference where they end, metres. In
/// larger ones it looks at fewer.
pub const AREA_M: f64 = 1920.0;
pub const AREA_MARGIN_M: f64 = 384.0;

/// Of the points that may be ground the lowest in each of the cells that [`Rule::learn`] looks at;
/// of all points where `of_all`, for return numbers that are wrong throughout.
pub fn lowest(cloud: &PointCloud, of_all: bool) -> Vec<Vec3> {
    if of_all { lowest::thinned(&cloud.position) } else { lowest::thinned(&last_returns(cloud)) }
}

/// Points that may be ground: last returns of what may have ground below it.
fn last_returns(cloud: &PointCloud) -> Vec<Vec3> {
    (0..cloud.len())
        .into_par_iter()
        .filter(|&i| {
            cloud.return_number[i] >= cloud.return_count[i] && !NEITHER.contains(&cloud.class[i])
        })
        .map(|i| cloud.position[i])
        .collect()
}

/// Local height of z = 0 of the world.
fn zero_level(cloud: &PointCloud) -> f32 {
    (-cloud.frame.origin.z * cloud.frame.unit_m().z) as f32
}

/// Infinite the wrong way round for no points.
fn bounds(points: &[Vec3]) -> (Vec3, Vec3) {
    crate::frame::bounds(points).unwrap_or((Vec3::INFINITY, Vec3::NEG_INFINITY))
}

/// Whether heights are above ground already: of the lowest points of 5 m cells, a quarter or more
/// lie within 15 cm of z = 0 of the world and next to none below −50 cm. A level site at sea level
/// fits too; both readings of it agree.
#[derive(Debug, Clone, Copy, Default)]
pub struct Floor {
    cells: u32,
    near_zero: u32,
    below_zero: u32,
}

impl Floor {
    /// Of a piece of a cloud.
    pub fn of_piece(cloud: &PointCloud) -> Floor {
        Floor::of(&last_returns(cloud), zero_level(cloud))
    }

    fn of(candidates: &[Vec3], zero: f32) -> Floor {
        const CELL_M: f64 = 5.0;
        if candidates.is_empty() {
            return Floor::default();
        }
        let (low, high) = bounds(candidates);
        let geometry = GridGeometry::covering(
            [low.x.into(), low.y.into()],
            [high.x.into(), high.y.into()],
            // Few large cells where points are far apart, so that memory stays bounded.
            CELL_M.max(f64::from((high - low).truncate().max_element()) / 2000.0),
        );
        let heights = candidates.par_iter().filter_map(|p| {
            let (c, r) = geometry.cell_of(p.x.into(), p.y.into())?;
            Some((geometry.index(c, r), p.z - zero))
        });
        let lowest = scatter::least(geometry.len(), heights);
        let count = |is: &dyn Fn(f32) -> bool| {
            lowest.iter().filter(|&&z| z.is_finite() && is(z)).count() as u32
        };
        Floor {
            cells: count(&|_| true),
            near_zero: count(&|z| z.abs() < 0.15),
            below_zero: count(&|z| z < -0.5),
        }
    }

    pub fn add(&mut self, piece: Floor) {
        self.cells += piece.cells;
        self.near_zero += piece.near_zero;
        self.below_zero += piece.below_zero;
    }

    pub fn is_zero(&self) -> bool {
        let share = |n: u32| n as f32 / self.cells.max(1) as f32;
        share(self.near_zero) >= 0.25 && share(self.below_zero) < 0.02
    }
}

/// How thick the ground is: the RMS distance of ground points from the mean height of their 0.5 m
/// cell, over cells that hold two or more; `None` without such cells. Noise, slope and what is
/// wrongly ground all add to it. Of many points a share is measured, in cells drawn by a hash.
pub fn spread_m(classified: &Classified) -> Option<f64> {
    Spread::of(classified).rms_m()
}

/// [`spread_m`] of a scan in pieces.
#[derive(Debug, Clone, Copy, Default)]
pub struct Spread {
    sum_sq: f64,
    points: usize,
}

impl Spread {
    /// Of a piece.
    pub fn of(classified: &Classified) -> Spread {
        const MEASURED: usize = 100_000;
        let one_in = (classified.cloud.len() / MEASURED) as u64 + 1;
        let cell = |v: f32| floor(v * 2.0);
        let is_drawn = |x: i32, y: i32| {
            let mix =
                |h: u64, v: i32| (h ^ u64::from(v as u32)).wrapping_mul(0x9e37_79b9_7f4a_7c15);
            (mix(mix(0, x), y) >> 40).is_multiple_of(one_in)
        };
        let mut ground: Vec<(i32, i32, u32)> = (classified.cloud.position.par_iter())
            .zip(&classified.kind)
            .filter(|(_, k)| **k == Kind::Ground)
            .map(|(p, _)| (cell(p.x), cell(p.y), p.z.to_bits()))
            .filter(|(x, y, _)| is_drawn(*x, *y))
            .collect();
        ground.par_sort_unstable();
        let mut spread = Spread::default();
        for same in ground.chunk_by(|a, b| (a.0, a.1) == (b.0, b.1)).filter(|c| c.len() > 1) {
            let heights = || same.iter().map(|p| f64::from(f32::from_bits(p.2)));
            let mean = heights().sum::<f64>() / same.len() as f64;
            spread.sum_sq += heights().map(|z| (z - mean).powi(2)).sum::<f64>();
            spread.points += same.len();
        }
        spread
    }

    pub fn add(&mut self, piece: Spread) {
        self.sum_sq += piece.sum_sq;
        self.points += piece.points;
    }

    pub fn rms_m(&self) -> Option<f64> {
        (self.points > 0).then(|| (self.sum_sq / self.points as f64).sqrt())
    }
}

#[cfg(test)]
mod tests;
