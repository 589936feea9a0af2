//! The voxel landscape: terrain and vegetation of a scan in a few megabytes, and ray-traced
//! pictures of it with snow, fog and rain (TD17, method "Voxels"). Knows nothing of trees and
//! scenes.
//!
//! What is kept: vegetation as densities of a few bits in a graph of shared subtrees (`dag`); the
//! ground as heights on a lattice of every few voxels, of which the graph knows in which bricks they
//! are; and two colours, of the ground and of what stands on it, every few voxels and in ever coarser
//! means. Departure from the source: the colour of a voxel is that of its column, as in the photo,
//! and the ground is not as coarse as a voxel.
//!
//! Within the room places are in voxels from the centre of the first voxel, x east, y north, z up.

mod blocks;
mod brick;
mod build;
mod clumps;
mod columns;
mod dag;
mod grain;
mod layers;
mod lens;
mod light;
mod pack;
mod paint;
mod patchwork;
mod picture;
mod spacing;
mod splat;
mod store;
#[cfg(test)]
mod tests;
mod trace;
mod walk;
mod water;
mod weather;

use glam::{DVec3, Vec3};

use blocks::Blocks;
pub use build::{Detail, Source, Tally, Voxel};
pub use columns::{Columns, Mirrored, PaintedFrom, Seen};
use dag::Dag;
pub use layers::{Layers, layers};
pub use lens::View;
use patchwork::Patchwork;
pub use picture::{MOST_PIXELS, Mode, Rays, Shot, count_hits, draw};
pub use spacing::connected_voxel_m;
pub use weather::Weather;

use crate::frame::Frame;

/// Terrain and vegetation as voxels.
#[derive(Debug, Clone, PartialEq)]
pub struct Landscape {
    /// Where local metres are in the world.
    pub frame: Frame,
    /// The centre of the first voxel, local metres.
    first_m: Vec3,
    voxel_m: f32,
    /// Cells along x, y and z: one less than voxels.
    sides: [u32; 3],
    dag: Dag,
    /// Follows from `dag`.
    blocks: Blocks,
    heights: Heights,
    colours: Colours,
}

/// Heights of the ground at every `stride`-th voxel, bilinear in between.
#[derive(Debug, Clone, PartialEq)]
struct Heights {
    stride: u32,
    /// Height of sample 0, and from a sample's value to the next, in voxels.
    base: f32,
    step: f32,
    /// [`NO_GROUND`] where there is none.
    samples: Patchwork<u16>,
}

const NO_GROUND: u16 = u16::MAX;

impl Heights {
    fn of(&self, sample: u16) -> f64 {
        f64::from(self.base) + f64::from(sample) * f64::from(self.step)
    }

    /// The heights at the corners of the patch with number (i, j).
    #[inline]
    fn corners(&self, i: usize, j: usize) -> Option<[f64; 4]> {
        let four = self.samples.four(i, j);
        (!four.contains(&NO_GROUND)).then(|| four.map(|sample| self.of(sample)))
    }
}

/// Colours of the ground (low half of a sample) and of what stands on it (high half), sRGB in 5, 6
/// and 5 bits; level after level, each of twice the stride.
#[derive(Debug, Clone, PartialEq)]
struct Colours {
    stride: u32,
    levels: Vec<Patchwork<u32>>,
}

/// Bytes held, by part.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Memory {
    pub voxels: usize,
    pub heights: usize,
    pub colours: usize,
}

impl Memory {
    pub fn total(&self) -> usize {
        self.voxels + self.heights + self.colours
    }
}

impl Landscape {
    /// Edge of a voxel.
    pub fn voxel_m(&self) -> f32 {
        self.voxel_m
    }

    /// Voxels along x, y and z.
    pub fn voxels(&self) -> [u32; 3] {
        self.sides.map(|side| side + 1)
    }

    /// The least and the greatest corner, local metres.
    pub fn bounds_m(&self) -> [Vec3; 2] {
        let size = Vec3::from(self.sides.map(|side| side as f32)) * self.voxel_m;
        [self.first_m, self.first_m + size]
    }

    pub fn memory(&self) -> Memory {
        Memory {
            voxels: self.dag.memory_bytes() + self.blocks.memory_bytes(),
            heights: self.heights.samples.memory_bytes(),
            colours: self.colours.levels.iter().map(Patchwork::memory_bytes).sum(),
        }
    }

    /// What breaks the invariants of the parts and between them.
    pub(super) fn check(&self) -> Result<(), String> {
        self.dag.check()?;
        self.heights.samples.check()?;
        self.colours.levels.iter().try_for_each(Patchwork::check)?;
        // Of any survey on this planet.
        let is_near = |p: DVec3| p.is_finite() && p.abs().max_element() < 1e9;
        if !((1e-6..1e6).contains(&self.voxel_m) && is_near(self.first_m.as_dvec3())) {
            return Err(format!("voxels of {} m at {}", self.voxel_m, self.first_m));
        }
        let (origin, unit_m) = (self.frame.origin, self.frame.unit_m());
        if !(is_near(origin * unit_m) && unit_m.cmpge(DVec3::splat(1e-6)).all() && is_near(unit_m))
        {
            return Err(format!("an origin at {origin} in units of {unit_m} m"));
        }
        let reach = 1u64 << (dag::BITS * self.dag.levels);
        if self.sides.iter().any(|side| *side == 0 || u64::from(*side) > reach)
            || (0..3).any(|axis| self.sides[axis] >= build::MOST_VOXELS[axis])
            || !Blocks::hold(self.sides)
        {
            return Err(format!("{:?} cells in a graph {reach} wide", self.sides));
        }
        let stride = self.heights.stride;
        if !(dag::SIDE..=1 << 16).contains(&stride) || !stride.is_power_of_two() {
            return Err(format!("heights {stride} voxels apart"));
        }
        let Heights { base, step, .. } = self.heights;
        let most = f64::from(base) + f64::from(step) * f64::from(NO_GROUND);
        if !(step > 0.0 && base.abs() < 1e6 && most.abs() < 1e6) {
            return Err(format!("heights from {base} in steps of {step} voxels"));
        }
        if !(1..=1 << 16).contains(&self.colours.stride)
            || !(1..=24).contains(&self.colours.levels.len())
        {
            let levels = self.colours.levels.len();
            return Err(format!("{levels} levels of colours {} voxels apart", self.colours.stride));
        }
        Ok(())
    }

    /// Height of the ground under or over a place of the landscape, local metres.
    pub fn ground_m(&self, p: Vec3) -> Option<f32> {
        let at = self.to_voxels(p);
        let is_within = |a: usize| (0.0..=f64::from(self.sides[a])).contains(&at[a]);
        let height = self.height(at.x, at.y).filter(|_| is_within(0) && is_within(1))?;
        Some((height * f64::from(self.voxel_m)) as f32 + self.first_m.z)
    }

    /// How far above a place within vegetation the air is free, metres; `None` where it is free there.
    pub fn within_m(&self, p: Vec3) -> Option<f32> {
        let at = self.to_voxels(p);
        let last = self.sides.map(f64::from);
        let is_within = (0..3).all(|a| (0.0..=last[a]).contains(&at[a]));
        let mut tracer = trace::Tracer::new(self);
        let mut is_leafy = |up: u32| {
            let place = (at + DVec3::Z * f64::from(up)).as_vec3();
            place.z <= last[2] as f32 && tracer.density(place) >= brick::ISO
        };
        let up = (0..=self.sides[2]).take_while(|up| is_leafy(*up)).count();
        (is_within && up > 0).then_some(up as f32 * self.voxel_m)
    }

    /// Whether rays may meet anything.
    pub fn is_empty(&self) -> bool {
        self.dag.root.is_none()
    }

    /// Cells along x, y and z within which anything is.
    #[inline]
    fn reach(&self) -> [u32; 3] {
        let top = i32::from(self.blocks.top).max(0) as u32 * dag::SIDE;
        [self.sides[0], self.sides[1], self.sides[2].min(top)]
    }

    /// Boughs are no larger in larger voxels: how many are along a side.
    fn boughs_in_voxel(&self) -> f32 {
        const BOUGH_M: f32 = 0.5;
        (self.voxel_m / BOUGH_M).clamp(1.0, 4.0)
    }

    /// Local metres to voxels.
    fn to_voxels(&self, p: Vec3) -> DVec3 {
        (p.as_dvec3() - self.first_m.as_dvec3()) / f64::from(self.voxel_m)
    }

    /// Height of the ground over a place, in voxels.
    #[inline]
    fn height(&self, x: f64, y: f64) -> Option<f64> {
        // Exact, as the stride is a power of two.
        let per = 1.0 / f64::from(self.heights.stride);
        let (u, v) = (x.max(0.0) * per, y.max(0.0) * per);
        let (i, j) = (u as usize, v as usize);
        let [a, b, c, e] = self.heights.corners(i, j)?;
        let (u, v) = (u - i as f64, v - j as f64);
        let (low, high) = (a + (b - a) * u, c + (e - c) * u);
        Some(low + (high - low) * v)
    }

    /// The patch of ground over voxel column (x, y): its corner, its side, its four heights.
    #[inline]
    fn patch(&self, x: u32, y: u32) -> Option<([f64; 2], f64, [f64; 4])> {
        let stride = self.heights.stride;
        let (i, j) = (x / stride, y / stride);
        let four = self.heights.corners(i as usize, j as usize)?;
        Some(([f64::from(i * stride), f64::from(j * stride)], f64::from(stride), four))
    }

    /// The upward normal of the ground at a place, over a neighbourhood as wide as `breadth`.
    fn slope(&self, x: f64, y: f64, breadth: f64) -> Vec3 {
        let reach = (0.5 * breadth).max(0.75 * f64::from(self.heights.stride));
        let last = self.sides.map(f64::from);
        let at = |x: f64, y: f64| self.height(x.clamp(0.0, last[0]), y.clamp(0.0, last[1]));
        let fall = |low: Option<f64>, high: Option<f64>| match (low, high) {
            (Some(low), Some(high)) => (low - high) / (2.0 * reach),
            _ => 0.0,
        };
        let x_fall = fall(at(x - reach, y), at(x + reach, y));
        let y_fall = fall(at(x, y - reach), at(x, y + reach));
        DVec3::new(x_fall, y_fall, 1.0).normalize().as_vec3()
    }

    /// Linear colours of the ground and of the vegetation in a column, over a neighbourhood as wide
    /// as `breadth`.
    fn colours(&self, x: f64, y: f64, breadth: f32) -> [Vec3; 2] {
        let stride = self.colours.stride as f32;
        let last = self.colours.levels.len() - 1;
        let number = ((breadth / stride).max(1.0).log2() as usize).min(last);
        let level = &self.colours.levels[number];
        let step = (f64::from(stride) * f64::from(1u32 << number)).recip();
        let (u, v) = (x.max(0.0) * step, y.max(0.0) * step);
        let (i, j) = (u as usize, v as usize);
        let four = level.four(i, j);
        let (u, v) = ((u - i as f64) as f32, (v - j as f64) as f32);
        [0, 16].map(|shift| {
            let [a, b, c, d] = four.map(|sample| unpacked((sample >> shift) as u16));
            a.lerp(b, u).lerp(c.lerp(d, u), v)
        })
    }
}

/// How far the ground that is kept lies from the terrain it was made of.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SurfaceError {
    pub ground_rms_m: f64,
    pub ground_worst_m: f64,
}

/// Compares at the centre of every column.
pub fn surface_error(scene: &Landscape, source: &impl Source) -> SurfaceError {
    use rayon::prelude::*;
    let [cols, rows, _] = source.voxels();
    let row = |y: u32| {
        let off = |x: u32| {
            let kept = scene.height(f64::from(x), f64::from(y))?;
            Some(kept - f64::from(source.height(x, y)?))
        };
        let add = |(sum, worst, count): (f64, f64, u64), off: f64| {
            (sum + off * off, off.abs().max(worst), count + 1)
        };
        (0..cols).filter_map(off).fold((0.0, 0.0, 0), add)
    };
    let rows: Vec<(f64, f64, u64)> = (0..rows).into_par_iter().map(row).collect();
    let all = rows.iter().fold((0.0, 0.0f64, 0), |a, b| (a.0 + b.0, a.1.max(b.1), a.2 + b.2));
    let voxel_m = f64::from(scene.voxel_m);
    SurfaceError {
        ground_rms_m: (all.0 / all.2.max(1) as f64).sqrt() * voxel_m,
        ground_worst_m: all.1 * voxel_m,
    }
}

/// sRGB in 5, 6 and 5 bits.
fn packed([r, g, b]: [u8; 3]) -> u16 {
    let part = |value: u8, most: u32| ((u32::from(value) * most + 127) / 255) as u16;
    part(r, 31) << 11 | part(g, 63) << 5 | part(b, 31)
}

/// Linear light of a packed colour; a gamma of 2 stands for the sRGB curve.
fn unpacked(sample: u16) -> Vec3 {
    let part = |shift: u32, most: u16| f32::from(sample >> shift & most) / f32::from(most);
    let srgb = Vec3::new(part(11, 31), part(5, 63), part(0, 31));
    srgb * srgb
}
