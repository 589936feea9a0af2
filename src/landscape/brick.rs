//! Where a ray meets the surface of half density within a brick of cells (TD17: trilinear
//! interpolation between the eight neighbouring voxel centres).
//!
//! A cell lies between eight voxel centres. Along a ray the interpolated density is a cubic, which
//! four samples determine; its extremes part it into monotonic pieces, and the first piece that
//! passes one half is narrowed by the Illinois rule (after Marmitt et al. 2004, who narrow by
//! repeated linear interpolation). Exact to the precision of f32. Known limit: a surface that a ray
//! touches without crossing may be missed.

use glam::{DVec3, Vec3};

use super::dag::{Dag, Ref, SIDE};
use super::grain::gaps;

/// Voxel centres along the side of a brick with its far faces.
const ROW: usize = SIDE as usize + 1;
/// The surface lies where the density is this share of the full one.
pub(super) const ISO: f32 = 0.5;

/// Densities from 0 to 1 at 5³ voxel centres, and which of the 4³ cells between them may hold the
/// surface.
#[derive(Debug, Clone)]
pub(super) struct Brick {
    pub cells: u64,
    pub density: [f32; ROW * ROW * ROW],
}

impl Brick {
    pub const EMPTY: Brick = Brick { cells: 0, density: [0.0; ROW * ROW * ROW] };

    /// From a density at each of 5³ voxel centres.
    #[cfg(test)]
    pub fn from_fn(at: impl Fn(u32, u32, u32) -> f32) -> Brick {
        let mut brick = Brick::EMPTY;
        for (i, density) in brick.density.iter_mut().enumerate() {
            *density = at((i % ROW) as u32, (i / ROW % ROW) as u32, (i / (ROW * ROW)) as u32);
        }
        for slot in 0..64 {
            let corners = brick.corners(slot);
            brick.cells |= u64::from(corners.iter().any(|c| *c >= ISO)) << slot;
        }
        brick
    }

    /// The brick whose first voxel is at `low`, with the near faces of its seven neighbours.
    pub fn gather(dag: &Dag, low: [u32; 3], own: Option<Ref>) -> Brick {
        let full = 1.0 / ((1u32 << dag.planes) - 1) as f32;
        let mut brick = Brick::EMPTY;
        let mut high = [0u64; 8];
        for (number, high) in high.iter_mut().enumerate() {
            let step = [0, 1, 2].map(|axis| (number as u32 >> axis & 1) * SIDE);
            let part = match number {
                0 => own,
                _ => dag.brick([low[0] + step[0], low[1] + step[1], low[2] + step[2]]),
            };
            let Some(part) = part else { continue };
            let part = part.index();
            *high = dag.solid(part);
            let mut any = 0;
            for plane in 0..dag.planes {
                any |= dag.plane(part, plane);
            }
            // Of a neighbour only the face, edge or corner that is near.
            let near = [0x1111_1111_1111_1111u64, 0x000f_000f_000f_000f, 0x0000_0000_0000_ffff];
            for (axis, near) in near.into_iter().enumerate() {
                if step[axis] != 0 {
                    any &= near;
                    *high &= near;
                }
            }
            while any != 0 {
                let slot = any.trailing_zeros();
                any &= any - 1;
                let mut value = 0;
                for plane in 0..dag.planes {
                    value = value << 1 | (dag.plane(part, plane) >> slot & 1) as u32;
                }
                let at = (slot & 3)
                    + step[0]
                    + ROW as u32 * ((slot >> 2 & 3) + step[1])
                    + (ROW * ROW) as u32 * ((slot >> 4) + step[2]);
                brick.density[at as usize] = value as f32 * full;
            }
        }
        brick.cells = cells(high);
        brick
    }

    /// Densities at the corners of a cell, x fastest.
    fn corners(&self, slot: u32) -> [f32; 8] {
        let (x, y, z) = (slot as usize & 3, slot as usize >> 2 & 3, slot as usize >> 4);
        let at = x + ROW * y + ROW * ROW * z;
        let d = &self.density;
        let (j, k) = (at + ROW, at + ROW * ROW);
        let l = k + ROW;
        [d[at], d[at + 1], d[j], d[j + 1], d[k], d[k + 1], d[l], d[l + 1]]
    }

    /// The density at `p`, in voxels from the brick's first voxel centre; 0…4 along each axis.
    pub fn density(&self, p: Vec3) -> f32 {
        self.density_of(p).0
    }

    /// [`Brick::density`], and the greatest at the corners of the cell that it is of.
    fn density_of(&self, p: Vec3) -> (f32, f32) {
        let cell = p.clamp(Vec3::ZERO, Vec3::splat(3.999)).floor();
        let slot = cell.x as u32 | (cell.y as u32) << 2 | (cell.z as u32) << 4;
        let corners = self.corners(slot);
        (trilinear(&corners, p - cell), corners.into_iter().fold(0.0, f32::max))
    }

    /// The first place on the ray `p + t·d`, `t` in `from..=to`, where the density reaches one half,
    /// by its `t`. `p` is in voxels from the brick's first voxel centre; the ray is within the brick
    /// for those `t`.
    pub fn first(&self, p: Vec3, d: Vec3, from: f32, to: f32) -> Option<f32> {
        let (ray, direction) = (p, d);
        let (p, d) = (p.to_array(), d.to_array());
        let mut t = from;
        let start = (ray + direction * t).clamp(Vec3::ZERO, Vec3::splat(3.0));
        let mut cell = [start.x as i32, start.y as i32, start.z as i32];
        let next = |cell: i32, p: f32, d: f32| {
            let face = cell + i32::from(d > 0.0);
            if d == 0.0 { f32::INFINITY } else { (face as f32 - p) / d }
        };
        let mut next =
            [next(cell[0], p[0], d[0]), next(cell[1], p[1], d[1]), next(cell[2], p[2], d[2])];
        let step = [(1.0 / d[0]).abs(), (1.0 / d[1]).abs(), (1.0 / d[2]).abs()];
        // A ray passes ten cells at most.
        for _ in 0..3 * SIDE {
            let axis = if next[0] <= next[1] && next[0] <= next[2] {
                0
            } else {
                1 + usize::from(next[2] < next[1])
            };
            let end = next[axis].min(to);
            let slot = (cell[0] | cell[1] << 2 | cell[2] << 4) as u32;
            if self.cells >> slot & 1 != 0 && end >= t {
                let low = Vec3::new(cell[0] as f32, cell[1] as f32, cell[2] as f32);
                if let Some(t) = first_in_cell(&self.corners(slot), ray - low, direction, t, end) {
                    return Some(t);
                }
            }
            if next[axis] >= to {
                return None;
            }
            t = t.max(end);
            next[axis] += step[axis];
            cell[axis] += if d[axis] > 0.0 { 1 } else { -1 };
            if !(0..SIDE as i32).contains(&cell[axis]) {
                return None;
            }
        }
        None
    }
}

/// Where leaves begin below the surface: noise finer than voxels eats into it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Crust {
    /// The brick's first voxel.
    pub low: [u32; 3],
    /// 0…1: how deep the noise eats.
    pub depth: f32,
    /// How many times finer than in small voxels the finest of it is.
    pub fine: f32,
}

impl Brick {
    /// As [`Brick::first`], through the gaps of a crust.
    pub fn first_leaf(&self, p: Vec3, d: Vec3, to: f32, crust: Crust) -> Option<f32> {
        /// Voxels from one look to the next.
        const STEP: f32 = 0.14;
        let step = STEP / (crust.fine * d.length().max(1e-6));
        let corner = DVec3::from(crust.low.map(f64::from));
        let mut t = self.first(p, d, 0.0, to)?;
        loop {
            let at = p + d * t;
            let (density, most) = self.density_of(at);
            let over = density - ISO;
            // Of a stem or twig, which is full nowhere, noise eats less, as it would leave dots.
            let deep = (most - ISO).max(0.0).powi(2) / ISO;
            if over < 0.0 {
                t = self.first(p, d, t, to)?;
            } else if over >= deep * crust.depth * gaps(corner + at.as_dvec3(), crust.fine) {
                return Some(t);
            }
            t += step;
            if t > to {
                return None;
            }
        }
    }
}

impl Brick {
    /// The mean of a cell's corners.
    pub fn mean(&self, slot: u32) -> f32 {
        self.corners(slot).iter().sum::<f32>() / 8.0
    }
}

/// Shares of their voxels' full density that a brick and those around it have, x fastest.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Fills([f32; 27]);

impl Fills {
    /// About the brick whose first voxel is at `low`.
    pub fn gather(dag: &Dag, low: [u32; 3]) -> Fills {
        let near = |number: usize| {
            let step = [number % 3, number / 3 % 3, number / 9];
            let at = |a: usize| (low[a] + SIDE * step[a] as u32).checked_sub(SIDE);
            let (x, y, z) = (at(0)?, at(1)?, at(2)?);
            dag.brick([x, y, z]).map(|brick| dag.fill(brick.index()))
        };
        Fills(std::array::from_fn(|number| near(number).unwrap_or(0.0)))
    }

    pub fn most(&self) -> f32 {
        self.0.into_iter().fold(0.0, f32::max)
    }

    /// At the middle of a cell, between the middles of the bricks.
    pub fn at(&self, slot: u32) -> f32 {
        let along = |cell: u32| {
            // Middles of cells lie half a voxel up from their first corner, those of bricks 1.5.
            let off = 1.0 + (cell as f32 - 1.0) / SIDE as f32;
            ((off as usize).min(1), off - (off as usize).min(1) as f32)
        };
        let [x, y, z] = [slot & 3, slot >> 2 & 3, slot >> 4].map(along);
        let at = |i: usize| {
            let [i, j, k] = [x.0 + (i & 1), y.0 + (i >> 1 & 1), z.0 + (i >> 2)];
            self.0[i + 3 * j + 9 * k]
        };
        trilinear(&std::array::from_fn(at), Vec3::new(x.1, y.1, z.1))
    }
}

/// Takes a ray through the 4³ cells of a brick, from cell to cell, as long as `go` says so of where it
/// enters each and of its number.
pub(super) fn along_cells(p: Vec3, d: Vec3, to: f32, mut go: impl FnMut(f32, u32) -> bool) {
    let (p, d) = (p.to_array(), d.to_array());
    let mut cell = [0, 1, 2].map(|a| p[a].clamp(0.0, 3.0) as i32);
    let inverse = d.map(|d| 1.0 / d);
    let mut next =
        [0, 1, 2].map(|a| ((cell[a] + i32::from(d[a] > 0.0)) as f32 - p[a]) * inverse[a]);
    let mut t = 0.0f32;
    while go(t, (cell[0] | cell[1] << 2 | cell[2] << 4) as u32) {
        let axis = if next[0] <= next[1] && next[0] <= next[2] {
            0
        } else {
            1 + usize::from(next[2] < next[1])
        };
        t = next[axis];
        cell[axis] += if d[axis] > 0.0 { 1 } else { -1 };
        if t > to || !(0..SIDE as i32).contains(&cell[axis]) {
            return;
        }
        next[axis] += inverse[axis].abs();
    }
}

/// Cells with at least one corner in the solid voxels of a brick and of the near faces of its
/// neighbours, by number: bit 0 of the number a step along x, bit 1 along y, bit 2 along z.
fn cells(high: [u64; 8]) -> u64 {
    const X: u64 = 0x8888_8888_8888_8888;
    const Y: u64 = 0xf000_f000_f000_f000;
    const Z: u64 = 0xffff_0000_0000_0000;
    let along = |near: u64, far: u64, step: u32, last: u64| {
        near | near >> step & !last | far << (3 * step) & last
    };
    let x = [0, 2, 4, 6].map(|i| along(high[i], high[i + 1], 1, X));
    let y = [0, 2].map(|i| along(x[i], x[i + 1], 4, Y));
    along(y[0], y[1], 16, Z)
}

pub(super) fn trilinear(c: &[f32; 8], p: Vec3) -> f32 {
    let mix = |a: f32, b: f32, t: f32| a + (b - a) * t;
    let low = mix(mix(c[0], c[1], p.x), mix(c[2], c[3], p.x), p.y);
    let high = mix(mix(c[4], c[5], p.x), mix(c[6], c[7], p.x), p.y);
    mix(low, high, p.z)
}

/// `p` is in voxels from the cell's first corner.
fn first_in_cell(corners: &[f32; 8], p: Vec3, d: Vec3, from: f32, to: f32) -> Option<f32> {
    let over = |t: f32| trilinear(corners, p + d * t) - ISO;
    let start = over(from);
    if start >= 0.0 {
        return Some(from);
    }
    let span = to - from;
    if span <= 0.0 {
        return None;
    }
    let end = over(to);
    // The cubic a + b·s + c·s² + e·s³ over s = 0…1 through four samples.
    let (f1, f2) = (over(from + span / 3.0), over(from + span * (2.0 / 3.0)));
    let b = -5.5 * start + 9.0 * f1 - 4.5 * f2 + end;
    let c = 9.0 * start - 22.5 * f1 + 18.0 * f2 - 4.5 * end;
    let e = -4.5 * start + 13.5 * f1 - 13.5 * f2 + 4.5 * end;
    let at = |s: f32| start + s * (b + s * (c + s * e));
    // Where it turns: b + 2c·s + 3e·s² = 0.
    let mut turns = [1.0f32; 2];
    let root = c * c - 3.0 * b * e;
    if root > 0.0 {
        let q = -(c + root.sqrt().copysign(c));
        let roots = [q / (3.0 * e), b / q];
        let inside = |s: f32| if s > 0.0 && s < 1.0 { s } else { 1.0 };
        turns = roots.map(inside);
        if turns[0] > turns[1] {
            turns.swap(0, 1);
        }
    }
    let (mut low, mut below) = (0.0, start);
    for high in [turns[0], turns[1], 1.0] {
        let above = if high == 1.0 { end } else { at(high) };
        if above >= 0.0 {
            return Some(from + span * narrowed(at, (low, below), (high, above)));
        }
        (low, below) = (high, above);
    }
    None
}

/// The zero between a place where `f` is below 0 and one where it is not: regula falsi, halving
/// the weight of an end that stays (Illinois).
pub(super) fn narrowed(
    f: impl Fn(f32) -> f32,
    (mut a, mut fa): (f32, f32),
    (mut b, mut fb): (f32, f32),
) -> f32 {
    let mut side = 0;
    for _ in 0..16 {
        if (b - a).abs() < 1e-5 || fb == 0.0 {
            break;
        }
        let s = a + (b - a) * (fa / (fa - fb)).clamp(0.0, 1.0);
        let fs = f(s);
        if fs.abs() < 1e-6 {
            return s;
        }
        if fs < 0.0 {
            (a, fa) = (s, fs);
            fb *= if side == -1 { 0.5 } else { 1.0 };
            side = -1;
        } else {
            (b, fb) = (s, fs);
            fa *= if side == 1 { 0.5 } else { 1.0 };
            side = 1;
        }
    }
    b
}
