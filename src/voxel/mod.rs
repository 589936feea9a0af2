//! Points to a sparse voxel octree with one centre of mass a voxel (TD17, method "Voxels").
//! Knows nothing of trees.
//!
//! A voxel of edge Δ at (x, y, z) has the indices r, c, l = ⌊x/Δ⌋ − ⌊x_min/Δ⌋ and so on for y and
//! z. Departures from the source: indices begin at 0, not 1; y is not flipped; and the grid is
//! aligned to whole multiples of Δ from the local origin instead of to x_min, so that a voxel does
//! not move when a point is added elsewhere. As in the source, no voxel stores its coordinates:
//! they follow from its place in the octree, or from its centre of mass.

mod morton;
mod octree;
#[cfg(test)]
mod tests;

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use crate::diagnostic::{Error, Result};

pub use octree::{Place, VoxelOctree};

/// Voxels along an axis, at most: three indices of 21 bits make a 63-bit Morton code.
pub const MAX_SIDE: u32 = 1 << morton::AXIS_BITS;

/// Cells across a crown: no finer than this many …
const MOST_CELLS: f32 = 10.0;
/// … and so much coarser.
const STEPS: [f32; 5] = [1.0, 1.25, 1.5, 2.0, 2.5];
/// Points wanted under a voxel's square metre of sky, on average.
const POINTS_PER_COLUMN: f32 = 2.0;

/// 0-based indices along x (`r`), y (`c`) and z (`l`), named as in TD17.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct VoxelIndex {
    pub r: u32,
    pub c: u32,
    pub l: u32,
}

/// An occupied voxel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Voxel {
    pub index: VoxelIndex,
    /// Points in it, at least 1.
    pub count: u32,
    /// Mean position of its points, local metres; inside the voxel.
    pub centre_of_mass: Vec3,
}

/// The edge of a voxel in metres for crowns of `crown_diameter_m` in a scan of `density_per_m2`.
///
/// The edge is such that a column of voxels holds about 2 points, but not less than 1/10 and not
/// more than 1/4 of the crown: the crown then spans at least 4 and at most 10 cells, 8–10
/// wherever the density carries it (TD17). In few steps, so that like densities give equal voxels.
pub fn choose_size_m(density_per_m2: f32, crown_diameter_m: f32) -> f32 {
    let crown_m = if crown_diameter_m.is_finite() { crown_diameter_m.max(0.1) } else { 0.1 };
    let sizes = STEPS.map(|step| crown_m / MOST_CELLS * step);
    let wanted = (POINTS_PER_COLUMN / density_per_m2.max(1e-9)).sqrt();
    let off = |size: &f32| (size / wanted).ln().abs();
    sizes.into_iter().min_by(|a, b| off(a).total_cmp(&off(b))).unwrap_or(crown_m)
}

/// The centre of mass of every occupied voxel of edge `size_m`, in Morton order, found on the
/// calling thread: for the points of one tree. Points that are not finite count for nothing. A size that is not positive, or too small for the extent, is
/// raised to the least that [`MAX_SIDE`] allows.
pub fn centres_of_mass(points: &[Vec3], size_m: f32) -> Vec<Vec3> {
    let finite: Vec<Vec3>;
    let points = if points.iter().all(|p| p.is_finite()) {
        points
    } else {
        finite = points.iter().copied().filter(|p| p.is_finite()).collect();
        &finite
    };
    let extent_m =
        bounds(points).map_or(0.0, |(min, max)| (max.as_dvec3() - min.as_dvec3()).max_element());
    // Two voxels less than fit: one for each end that the alignment may cut.
    let least_m = (extent_m / f64::from(MAX_SIDE - 2)).max(1e-3) as f32;
    let size_m = if size_m.is_finite() { size_m.max(least_m) } else { least_m };
    let Some(grid) = Grid::over(points, size_m) else { return Vec::new() };
    match grid.shift(points.len()) {
        Some(shift) => grid.centres::<u64>(points, shift),
        None => grid.centres::<u128>(points, u32::BITS),
    }
}

/// The code of a voxel and, in the lowest `shift` bits, the number of a point: sorts by both.
trait Key: Copy + Ord + Send + Sync {
    fn pack(code: u64, point: u32, shift: u32) -> Self;
    fn code(self, shift: u32) -> u64;
    fn point(self, shift: u32) -> usize;
}

impl Key for u64 {
    fn pack(code: u64, point: u32, shift: u32) -> u64 {
        code << shift | u64::from(point)
    }

    fn code(self, shift: u32) -> u64 {
        self >> shift
    }

    fn point(self, shift: u32) -> usize {
        (self & ((1 << shift) - 1)) as usize
    }
}

impl Key for u128 {
    fn pack(code: u64, point: u32, shift: u32) -> u128 {
        u128::from(code) << shift | u128::from(point)
    }

    fn code(self, shift: u32) -> u64 {
        (self >> shift) as u64
    }

    fn point(self, shift: u32) -> usize {
        (self & ((1 << shift) - 1)) as usize
    }
}

/// Where voxels are: the edge, and the indices of voxel (0, 0, 0) counted from the local origin.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Grid {
    size_m: f32,
    first: [i64; 3],
    /// Voxels along each axis.
    sides: [u32; 3],
}

/// Occupied voxels in Morton order, as columns.
#[derive(Debug, Default)]
struct Occupied {
    codes: Vec<u64>,
    counts: Vec<u32>,
    centres_of_mass: Vec<Vec3>,
    /// Mean squared distance of the points from their voxel's centre of mass, m².
    spread_sq_m: f64,
}

fn bounds(points: &[Vec3]) -> Option<(Vec3, Vec3)> {
    crate::frame::bounds(points).filter(|(min, max)| min.is_finite() && max.is_finite())
}

/// Centre of mass of the points of one voxel, summed in their order.
fn centre<K: Key>(run: &[K], points: &[Vec3], shift: u32) -> Vec3 {
    let place = |k: &K| points[k.point(shift)].as_dvec3();
    (run.iter().map(place).sum::<DVec3>() / run.len() as f64).as_vec3()
}

impl Grid {
    /// The grid over finite points; `None` without points or where an axis needs more than
    /// [`MAX_SIDE`] voxels.
    fn over(points: &[Vec3], size_m: f32) -> Option<Grid> {
        let (min, max) = bounds(points)?;
        let mut grid = Grid { size_m, first: [0; 3], sides: [1; 3] };
        let first = grid.cell(min);
        let last = grid.cell(max);
        for axis in 0..3 {
            // Cells beyond 2^53 are not told apart, and make more sides than fit anyway.
            let side = last[axis].saturating_sub(first[axis]).saturating_add(1);
            grid.sides[axis] = u32::try_from(side).ok().filter(|side| *side <= MAX_SIDE)?;
        }
        grid.first = first;
        Some(grid)
    }

    /// Indices counted from the local origin.
    fn cell(&self, p: Vec3) -> [i64; 3] {
        let floor = |v: f64| {
            let whole = v as i64;
            whole.saturating_sub(i64::from(v < whole as f64))
        };
        (p.as_dvec3() / f64::from(self.size_m)).to_array().map(floor)
    }

    /// Indices of the voxel around `p`; `None` outside the grid.
    fn index_of(&self, p: Vec3) -> Option<VoxelIndex> {
        if !p.is_finite() {
            return None;
        }
        let cell = self.cell(p);
        let along = |axis: usize| {
            let index = u32::try_from(cell[axis].checked_sub(self.first[axis])?).ok()?;
            (index < self.sides[axis]).then_some(index)
        };
        Some(VoxelIndex { r: along(0)?, c: along(1)?, l: along(2)? })
    }

    /// The corner of least x, y and z.
    fn corner_of(&self, index: VoxelIndex) -> Vec3 {
        let along = |axis: usize, index: u32| (self.first[axis] + i64::from(index)) as f64;
        let cell = DVec3::new(along(0, index.r), along(1, index.c), along(2, index.l));
        (cell * f64::from(self.size_m)).as_vec3()
    }

    /// Bits that the number of a point needs below the code of a voxel; `None` where both together
    /// need more than 64: extents of thousands of voxels with very many points.
    fn shift(&self, points: usize) -> Option<u32> {
        let side = self.sides.into_iter().max().unwrap_or(1);
        let bits = |most: u32| u32::BITS - most.leading_zeros();
        let shift = bits(points as u32);
        (3 * bits(side - 1) + shift <= u64::BITS).then_some(shift)
    }

    fn key<K: Key>(&self, p: Vec3, point: usize, shift: u32) -> Option<K> {
        self.index_of(p).map(|index| K::pack(morton::encode(index), point as u32, shift))
    }

    /// Centres of mass of the occupied voxels.
    fn centres<K: Key>(&self, points: &[Vec3], shift: u32) -> Vec<Vec3> {
        let keys = points.iter().enumerate().filter_map(|(i, p)| self.key(*p, i, shift));
        let mut keys: Vec<K> = keys.collect();
        keys.sort_unstable();
        keys.chunk_by(|a, b| a.code(shift) == b.code(shift))
            .map(|run| centre(run, points, shift))
            .collect()
    }

    /// Sorts the points into voxels. The sum of a voxel's points runs in the order of the points,
    /// so the result does not depend on the number of threads.
    fn occupied(&self, points: &[Vec3]) -> Occupied {
        match self.shift(points.len()) {
            Some(shift) => self.sorted::<u64>(points, shift),
            None => self.sorted::<u128>(points, u32::BITS),
        }
    }

    fn sorted<K: Key>(&self, points: &[Vec3], shift: u32) -> Occupied {
        let mut keys: Vec<K> = Vec::with_capacity(points.len());
        let places = points.par_iter().enumerate();
        keys.par_extend(places.filter_map(|(i, p)| self.key::<K>(*p, i, shift)));
        keys.par_sort_unstable();
        let code = |k: &K| k.code(shift);
        let count = keys.chunk_by(|a, b| code(a) == code(b)).count();
        let mut end: Vec<u32> = Vec::with_capacity(count);
        for run in keys.chunk_by(|a, b| code(a) == code(b)) {
            end.push(end.last().copied().unwrap_or(0) + run.len() as u32);
        }
        let start = |v: usize| v.checked_sub(1).map_or(0, |before| end[before]);
        let run = |v: usize| &keys[start(v) as usize..end[v] as usize];
        let centres_of_mass: Vec<Vec3> =
            (0..count).into_par_iter().map(|v| centre(run(v), points, shift)).collect();
        // Voxels whose sums are added up one after the other, whatever the threads.
        const TOGETHER: usize = 1 << 12;
        let moved: Vec<f64> = centres_of_mass
            .par_chunks(TOGETHER)
            .enumerate()
            .map(|(chunk, centres)| {
                let of_voxel = |(v, centre): (usize, &Vec3)| -> f64 {
                    let off = |k: &K| centre.distance_squared(points[k.point(shift)]);
                    run(v).iter().map(|k| f64::from(off(k))).sum()
                };
                (chunk * TOGETHER..).zip(centres).map(of_voxel).sum()
            })
            .collect();
        Occupied {
            spread_sq_m: moved.iter().sum::<f64>() / keys.len().max(1) as f64,
            codes: (0..count).into_par_iter().map(|v| code(&run(v)[0])).collect(),
            counts: (0..count).into_par_iter().map(|v| end[v] - start(v)).collect(),
            centres_of_mass,
        }
    }
}

impl VoxelOctree {
    /// Puts points (local metres) into voxels of edge `size_m`. No points make an empty octree.
    ///
    /// # Errors
    /// A point that is not finite, a size that is not positive, or one so small that
    /// the extent has more than [`MAX_SIDE`] voxels along an axis; more than 2³² points.
    pub fn build(points: &[Vec3], size_m: f32) -> Result<VoxelOctree> {
        if !(size_m.is_finite() && size_m > 0.0) {
            return Err(Error::new(format!("a voxel can't be {size_m} m wide"))
                .remedy("give a voxel size above 0"));
        }
        if points.is_empty() {
            let grid = Grid { size_m, first: [0; 3], sides: [0; 3] };
            return Ok(VoxelOctree::from_occupied(grid, Occupied::default()));
        }
        if u32::try_from(points.len()).is_err() {
            return Err(Error::new(format!("{} points are too many", points.len()))
                .remedy("work on smaller tiles"));
        }
        if let Some(i) = points.par_iter().position_first(|p| !p.is_finite()) {
            return Err(Error::new(format!("point {i} is not finite")));
        }
        let grid = Grid::over(points, size_m).ok_or_else(|| {
            Error::new(format!("voxels of {size_m} m are too small for the extent of the points"))
                .remedy(format!("at most {MAX_SIDE} voxels fit along an axis: give a larger size"))
        })?;
        Ok(VoxelOctree::from_occupied(grid, grid.occupied(points)))
    }
}
