//! From columns of voxels to a [`Landscape`], block by block: what is in memory is one batch of
//! blocks and what is different in all before.

use rayon::prelude::*;

use super::blocks::{BLOCK, BLOCK_LEVEL, Blocks};
use super::dag::{Builder, Ref, SIDE, slot};
use super::patchwork::Patchwork;
use super::{Colours, Heights, Landscape, NO_GROUND, packed, unpacked};
use crate::diagnostic::{Error, Result};
use crate::frame::Frame;

/// A voxel in its column.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Voxel {
    pub z: u16,
    /// 1 to 2^bits − 1.
    pub density: u8,
}

/// Where voxels come from.
pub trait Source: Sync {
    /// Voxels along x, y and z.
    fn voxels(&self) -> [u32; 3];
    /// Columns along x and y whose heights and colours are known: no fewer than there are voxels.
    fn known(&self) -> [u32; 2] {
        let [cols, rows, _] = self.voxels();
        [cols, rows]
    }
    /// Vegetation in column (x, y), each z once.
    fn column(&self, x: u32, y: u32) -> &[Voxel];
    /// The ground at the centre of column (x, y), in voxels from the centre of the lowest.
    fn height(&self, x: u32, y: u32) -> Option<f32>;
    /// sRGB of the ground and of what stands on it about column (x, y).
    fn colours(&self, x: u32, y: u32) -> [[u8; 3]; 2];
}

/// How much of it is kept.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Detail {
    /// Bits of a density, 1 to 4.
    pub density_bits: u32,
    /// Voxels from one height of the ground to the next: a power of two, at least 4.
    pub height_stride: u32,
    /// Voxels from one colour to the next.
    pub colour_stride: u32,
}

/// What was built, before equal parts were made one.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Tally {
    /// Voxels with vegetation.
    pub voxels: u64,
    /// Bricks of 4³ voxels with vegetation or ground.
    pub bricks: u64,
}

/// Voxels along an axis, at most: the height of a column is 16 bits, and places are exact in f64.
pub const MOST_VOXELS: [u32; 3] = [1 << 20, 1 << 20, 1 << 14];

struct Part {
    planes: [u64; 4],
    flags: u32,
}

/// The bricks of one block of columns, by place.
struct Block {
    /// 1 + the number of a part, or 0.
    places: Vec<u32>,
    parts: Vec<Part>,
    voxels: u64,
}

impl Block {
    fn new(layers: u32) -> Block {
        let across = (BLOCK / SIDE) as usize;
        Block { places: vec![0; across * across * layers as usize], parts: Vec::new(), voxels: 0 }
    }

    fn place(x: u32, y: u32, z: u32) -> usize {
        (x + (BLOCK / SIDE) * (y + (BLOCK / SIDE) * z)) as usize
    }

    fn part(&mut self, x: u32, y: u32, z: u32) -> Option<&mut Part> {
        let place = self.places.get_mut(Self::place(x, y, z))?;
        if *place == 0 {
            self.parts.push(Part { planes: [0; 4], flags: 0 });
            *place = self.parts.len() as u32;
        }
        self.parts.get_mut(*place as usize - 1)
    }

    /// Columns from (x0, y0), and of the next along each axis what reaches in.
    fn gather(
        source: &impl Source,
        heights: &Heights,
        detail: &Detail,
        [x0, y0]: [u32; 2],
    ) -> Block {
        let [cols, rows, high] = source.voxels();
        let layers = high.div_ceil(SIDE);
        let mut block = Block::new(layers);
        let bits = detail.density_bits;
        let half = 1u8 << (bits - 1);
        for (y, x) in (0..=BLOCK).flat_map(|y| (0..=BLOCK).map(move |x| (y, x))) {
            if x0 + x >= cols || y0 + y >= rows {
                continue;
            }
            let is_own = x < BLOCK && y < BLOCK;
            for &Voxel { z, density } in source.column(x0 + x, y0 + y) {
                let z = u32::from(z);
                if is_own && let Some(part) = block.part(x / SIDE, y / SIDE, z / SIDE) {
                    let bit = 1u64 << slot(x, y, z);
                    for (plane, bits) in part.planes.iter_mut().zip((0..bits).rev()) {
                        *plane |= if density >> bits & 1 != 0 { bit } else { 0 };
                    }
                }
                block.voxels += u64::from(is_own);
                if density < half {
                    continue;
                }
                // Cells before and after the voxel, along each axis, by the brick they are in.
                let cells = |i: u32| (i.saturating_sub(1) / SIDE)..=(i / SIDE);
                for bz in cells(z) {
                    for by in cells(y).filter(|by| by * SIDE < BLOCK) {
                        for bx in cells(x).filter(|bx| bx * SIDE < BLOCK) {
                            if let Some(part) = block.part(bx, by, bz) {
                                part.flags |= Ref::CELLS;
                            }
                        }
                    }
                }
            }
        }
        /// Voxels by which a brick counts as touched by the ground before it is.
        const MARGIN: f64 = 0.02;
        for (by, bx) in (0..BLOCK / SIDE).flat_map(|y| (0..BLOCK / SIDE).map(move |x| (y, x))) {
            let (x, y) = (x0 + bx * SIDE, y0 + by * SIDE);
            if x >= cols || y >= rows {
                continue;
            }
            let corner = |dx: u32, dy: u32| heights.at(x + dx * SIDE, y + dy * SIDE, x, y);
            let corners = [corner(0, 0), corner(1, 0), corner(0, 1), corner(1, 1)];
            let Some(corners) = corners.into_iter().collect::<Option<Vec<f64>>>() else { continue };
            let low = corners.iter().copied().fold(f64::INFINITY, f64::min) - MARGIN;
            let top = corners.iter().copied().fold(f64::NEG_INFINITY, f64::max) + MARGIN;
            let layer = |z: f64| (z.max(0.0) as u32 / SIDE).min(layers.saturating_sub(1));
            for bz in layer(low)..=layer(top) {
                if let Some(part) = block.part(bx, by, bz) {
                    part.flags |= Ref::GROUND;
                }
            }
        }
        block
    }

    /// Into the graph: the nodes of this block with their place.
    fn insert(
        &self,
        into: &mut Builder,
        planes: usize,
        at: [u32; 2],
    ) -> Result<Vec<([u32; 3], Ref)>> {
        let across = BLOCK / SIDE;
        let layers = self.places.len() as u32 / (across * across);
        let mut bricks = |x: u32, y: u32, z: u32| -> Result<Option<Ref>> {
            let number = self.places.get(Self::place(x, y, z)).copied().unwrap_or(0) as usize;
            let Some(part) = number.checked_sub(1).and_then(|i| self.parts.get(i)) else {
                return Ok(None);
            };
            into.brick(&part.planes[..planes], part.flags).map(Some)
        };
        let mut level: Vec<Option<Ref>> = Vec::with_capacity(self.places.len());
        for z in 0..layers {
            for y in 0..across {
                for x in 0..across {
                    level.push(bricks(x, y, z)?);
                }
            }
        }
        let mut side = across;
        let mut high = layers;
        while side > 1 {
            let (parents, tall) = (side / SIDE, high.div_ceil(SIDE));
            let mut above = Vec::with_capacity((parents * parents * tall) as usize);
            for z in 0..tall {
                for y in 0..parents {
                    for x in 0..parents {
                        let mut children = [None; 64];
                        for (number, child) in (0u32..).zip(&mut children) {
                            let [i, j, k] = [number & 3, number >> 2 & 3, number >> 4];
                            let (i, j, k) = (x * SIDE + i, y * SIDE + j, z * SIDE + k);
                            let at = (i + side * (j + side * k)) as usize;
                            *child = level.get(at).copied().flatten();
                        }
                        above.push(into.node(&children)?);
                    }
                }
            }
            (level, side, high) = (above, parents, tall);
        }
        let place = |(z, node): (u32, Option<Ref>)| node.map(|node| ([at[0], at[1], z], node));
        Ok((0..).zip(level).filter_map(place).collect())
    }
}

impl Heights {
    fn build(source: &impl Source, stride: u32) -> Heights {
        let [cols, rows, _] = source.voxels().map(|side| side.saturating_sub(1));
        let (width, height) = (cols.div_ceil(stride) as usize, rows.div_ceil(stride) as usize);
        let last = source.known().map(|side| side.saturating_sub(1));
        let at = |i: usize, j: usize| {
            let (x, y) = ((i as u32 * stride).min(last[0]), (j as u32 * stride).min(last[1]));
            source.height(x, y).filter(|h| h.is_finite())
        };
        let samples =
            (0..=height).into_par_iter().flat_map_iter(|j| (0..=width).map(move |i| (i, j)));
        let (low, high) = samples
            .filter_map(|(i, j)| at(i, j))
            .fold(|| (f32::INFINITY, f32::NEG_INFINITY), |(low, high), h| (low.min(h), high.max(h)))
            .reduce(|| (f32::INFINITY, f32::NEG_INFINITY), |a, b| (a.0.min(b.0), a.1.max(b.1)));
        let (base, range) = if low <= high { (low, high - low) } else { (0.0, 0.0) };
        let step = (range / f32::from(NO_GROUND - 1)).max(f32::MIN_POSITIVE);
        let sample = |i: usize, j: usize| match at(i, j) {
            Some(h) => ((h - base) / step).round().clamp(0.0, f32::from(NO_GROUND - 1)) as u16,
            None => NO_GROUND,
        };
        Heights { stride, base, step, samples: Patchwork::build(width, height, sample) }
    }

    /// At a corner of the brick that begins at column (bx, by), by the patch that the brick is in.
    fn at(&self, x: u32, y: u32, bx: u32, by: u32) -> Option<f64> {
        let (i, j) = (bx / self.stride, by / self.stride);
        let [a, b, c, d] = self.corners(i as usize, j as usize)?;
        let part = |along: u32, patch: u32| {
            f64::from(along - patch * self.stride) / f64::from(self.stride)
        };
        let (u, v) = (part(x, i), part(y, j));
        let (low, high) = (a + (b - a) * u, c + (d - c) * u);
        Some(low + (high - low) * v)
    }
}

impl Colours {
    fn build(source: &impl Source, stride: u32) -> Colours {
        let [cols, rows, _] = source.voxels().map(|side| side.saturating_sub(1));
        let (mut width, mut height) =
            (cols.div_ceil(stride) as usize, rows.div_ceil(stride) as usize);
        let last = source.known().map(|side| side.saturating_sub(1));
        let mut samples: Vec<u32> = (0..=height)
            .into_par_iter()
            .flat_map_iter(|j| {
                (0..=width).map(move |i| {
                    let (x, y) =
                        ((i as u32 * stride).min(last[0]), (j as u32 * stride).min(last[1]));
                    let [ground, above] = source.colours(x, y).map(packed);
                    u32::from(ground) | u32::from(above) << 16
                })
            })
            .collect();
        let mut levels = Vec::new();
        loop {
            levels.push(Patchwork::build(width, height, |i, j| samples[j * (width + 1) + i]));
            if width.max(height) <= 1 {
                break;
            }
            let (w, h) = (width.div_ceil(2), height.div_ceil(2));
            let mean = |i: usize, j: usize| {
                let mut sum = [glam::Vec3::ZERO; 2];
                for (dj, row) in [0.25, 0.5, 0.25].into_iter().enumerate() {
                    for (di, col) in [0.25, 0.5, 0.25].into_iter().enumerate() {
                        let x = (2 * i + di).saturating_sub(1).min(width);
                        let y = (2 * j + dj).saturating_sub(1).min(height);
                        let sample = samples[y * (width + 1) + x];
                        for (sum, shift) in sum.iter_mut().zip([0, 16]) {
                            *sum += unpacked((sample >> shift) as u16) * (row * col);
                        }
                    }
                }
                let byte = |linear: f32| (linear.sqrt() * 255.0 + 0.5) as u8;
                let [ground, above] = sum.map(|c| packed(c.to_array().map(byte)));
                u32::from(ground) | u32::from(above) << 16
            };
            let rows = (0..=h).into_par_iter().flat_map_iter(|j| (0..=w).map(move |i| mean(i, j)));
            samples = rows.collect();
            (width, height) = (w, h);
        }
        Colours { stride, levels }
    }
}

impl Landscape {
    /// Builds a landscape whose first voxel has its centre at `first_m`, local metres.
    ///
    /// # Errors
    /// More than 1,048,576 voxels along a side or 16,384 upward; more different voxels than
    /// references reach.
    pub fn build(
        source: &impl Source,
        detail: &Detail,
        frame: Frame,
        first_m: glam::Vec3,
        voxel_m: f32,
    ) -> Result<(Landscape, Tally)> {
        let voxels = source.voxels();
        let [cols, rows, high] = voxels;
        if (0..3).any(|axis| voxels[axis] > MOST_VOXELS[axis] || voxels[axis] < 2)
            || !Blocks::hold(voxels)
        {
            return Err(Error::new(format!(
                "{cols} × {rows} × {high} voxels are too many, or too few"
            ))
            .remedy("2 to 1,048,576 along x and y and 2 to 16,384 along z: give another --voxel"));
        }
        let heights = Heights::build(source, detail.height_stride);
        let mut builder = Builder::new(detail.density_bits);
        let (wide, deep) = (cols.div_ceil(BLOCK), rows.div_ceil(BLOCK));
        let places: Vec<[u32; 2]> =
            (0..deep).flat_map(|y| (0..wide).map(move |x| [x, y])).collect();
        let (mut nodes, mut tally) = (Vec::new(), Tally::default());
        /// Blocks gathered at a time.
        const BATCH: usize = 64;
        for batch in places.chunks(BATCH) {
            let gather =
                |at: &[u32; 2]| Block::gather(source, &heights, detail, at.map(|i| i * BLOCK));
            let blocks: Vec<Block> = batch.par_iter().map(gather).collect();
            for (block, at) in blocks.iter().zip(batch) {
                tally.voxels += block.voxels;
                nodes.extend(block.insert(&mut builder, detail.density_bits as usize, *at)?);
            }
        }
        tally.bricks = builder.bricks;
        let sides = voxels.map(|side| side - 1);
        let dag = builder.root(BLOCK_LEVEL, nodes)?;
        let landscape = Landscape {
            blocks: Blocks::of(&dag, sides),
            frame,
            first_m,
            voxel_m,
            sides,
            dag,
            heights,
            colours: Colours::build(source, detail.colour_stride),
        };
        Ok((landscape, tally))
    }
}
