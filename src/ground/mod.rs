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
use crate::raster::{GridGeometry, scatter};
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

#[derive(Debug, Clone, Default)]
pub struct GroundOptions {
    pub method: Method,
    /// Whether heights are above ground already; seen in the points where `None`.
    pub is_normalised: Option<bool>,
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
pub fn classify(cloud: PointCloud, options: &GroundOptions) -> Result<Warned<Classified>> {
    let last = last_returns(&cloud);
    // Return numbers may be wrong throughout; every point is then a candidate.
    let candidates = if last.len() < 3 { &cloud.position } else { &last };
    if cloud.len() < 3 {
        return Err(Error::new(format!("too few points to find the ground: {}", cloud.len()))
            .remedy("give a whole scan: at least a few points that reached the ground"));
    }
    let is_normalised = options
        .is_normalised
        .unwrap_or_else(|| Floor::of(candidates, zero_level(&cloud)).is_zero());
    let mut warnings = Vec::new();
    let is_ground: Vec<bool> = if options.method == Method::FileClasses {
        if !cloud.class.contains(&FILE_GROUND) {
            return Err(Error::new("the scan holds no ground points (class 2)")
                .remedy("let them be found: leave out --ground file"));
        }
        cloud.class.iter().map(|&c| c == FILE_GROUND).collect()
    } else if is_normalised {
        let zero = zero_level(&cloud);
        cloud.position.par_iter().map(|p| (p.z - zero).abs() <= NORMALISED_GROUND_M).collect()
    } else {
        match options.method {
            Method::Tin => densify::ground(&Lowest::of(candidates), &cloud.position),
            Method::VoxelRules => voxel_rules::ground(&cloud.position),
            _ => smrf::ground(&Lowest::of(candidates), &cloud.position),
        }
    };
    if is_normalised {
        warnings.push(
            "the heights are above ground already: the terrain is taken as the plane z = 0".into(),
        );
    }
    drop(last);
    let kind: Vec<Kind> = is_ground
        .par_iter()
        .zip(&cloud.class)
        .map(|(&ground, class)| match (NEITHER.contains(class), ground) {
            (true, _) => Kind::Excluded,
            (false, true) => Kind::Ground,
            (false, false) => Kind::Vegetation,
        })
        .collect();
    if !is_normalised && kind.iter().filter(|&&k| k == Kind::Ground).count() < 3 {
        return Err(Error::new("no ground was found in the scan").remedy(
            "give a scan whose lowest returns reach the ground, or try --ground voxel or --ground file",
        ));
    }
    Ok(Warned::with(Classified { cloud, kind, is_normalised }, warnings))
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
    let none = || (Vec3::INFINITY, Vec3::NEG_INFINITY);
    let both = |a: (Vec3, Vec3), b: (Vec3, Vec3)| (a.0.min(b.0), a.1.max(b.1));
    points.par_iter().fold(none, |b, p| both(b, (*p, *p))).reduce(none, both)
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
    Spread::of(classified, |_| true).rms_m()
}

/// [`spread_m`] of a scan in pieces.
#[derive(Debug, Clone, Copy, Default)]
pub struct Spread {
    sum_sq: f64,
    points: usize,
}

impl Spread {
    /// Of the points for which `is_own` holds.
    pub fn of(classified: &Classified, is_own: impl Fn(Vec3) -> bool + Sync) -> Spread {
        const MEASURED: usize = 100_000;
        let one_in = (classified.cloud.len() / MEASURED) as u64 + 1;
        let cell = |v: f32| (v * 2.0).floor() as i32;
        let is_drawn = |x: i32, y: i32| {
            let mix =
                |h: u64, v: i32| (h ^ u64::from(v as u32)).wrapping_mul(0x9e37_79b9_7f4a_7c15);
            (mix(mix(0, x), y) >> 40).is_multiple_of(one_in)
        };
        let mut ground: Vec<(i32, i32, u32)> = (classified.cloud.position.par_iter())
            .zip(&classified.kind)
            .filter(|(_, k)| **k == Kind::Ground)
            .map(|(p, _)| (cell(p.x), cell(p.y), p))
            .filter(|(x, y, p)| is_drawn(*x, *y) && is_own(**p))
            .map(|(x, y, p)| (x, y, p.z.to_bits()))
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
