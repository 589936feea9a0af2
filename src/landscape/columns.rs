//! A classified scan to columns of voxels (TD17: a voxel's value is its point count; T15: voxels of
//! at least tr points are vegetation), with the terrain under them and the colours of both.
//!
//! A voxel of tr points is full; tr is a quarter of the median count of occupied voxels, so that in
//! dense scans single stray points make no surface. An empty voxel between two full ones beside it
//! is half full: a scan shows a crown by samples, with gaps that are none in the crown. Colours
//! come from the photo, from the points, or from class, height and brightness of the returns, in
//! this order. Known limits: a column has one colour for its vegetation and one for its ground.

use std::ops::Range;

use glam::{Vec2, Vec3};
use rayon::prelude::*;

use super::build::{Detail, MOST_VOXELS, Source, Voxel};
use super::clumps::Clumps;
use super::paint::{
    Brightness, Cell, Clear, DEEP, LEAST_HEIGHT_M, Lifted, SOIL, has_colour, soil, tint,
};
use super::water::Water;
use crate::diagnostic::{Error, Result};
use crate::ground::{Classified, Kind};
use crate::raster::{Grid, GridGeometry, inpaint};
use crate::terrain::Terrain;

/// A scan as columns, in memory.
#[derive(Debug)]
pub struct Columns {
    /// As far as the scan reaches.
    voxels: [u32; 3],
    /// Columns along x and y that are known: whole patches of heights and colours.
    known: [u32; 2],
    /// The centre of the first voxel, local metres.
    pub first_m: Vec3,
    /// Where the voxels of each column begin, and their end.
    start: Vec<u32>,
    column: Vec<Voxel>,
    /// Heights by column, in voxels.
    height: Vec<f32>,
    paint: Paint,
}

/// Colours of ground and vegetation at every `stride`-th column.
#[derive(Debug)]
struct Paint {
    stride: u32,
    cols: usize,
    colours: Vec<[[u8; 3]; 2]>,
}

/// What a photo shows at a place: 0…255, or nothing.
pub type Seen<'a> = &'a (dyn Fn(Vec2) -> Option<[f32; 3]> + Sync);

/// Where colours came from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PaintedFrom {
    Photo,
    Points,
    Heights,
}

impl PaintedFrom {
    pub fn text(self) -> &'static str {
        match self {
            PaintedFrom::Photo => "the photo",
            PaintedFrom::Points => "the points",
            PaintedFrom::Heights => "class, height and intensity",
        }
    }
}

impl Columns {
    /// Voxels of edge `voxel_m` over a scan and its terrain.
    ///
    /// # Errors
    /// Voxels too small or too large for the extent; no points.
    pub fn of_scan(
        classified: &Classified,
        terrain: &Terrain,
        photo: Option<Seen<'_>>,
        voxel_m: f32,
        detail: &Detail,
    ) -> Result<(Columns, PaintedFrom)> {
        let points = &classified.cloud.position;
        let plane = |p: &Vec3| p.truncate();
        let fold = |(low, high): (Vec2, Vec2), p: Vec2| (low.min(p), high.max(p));
        let nothing = || (Vec2::INFINITY, Vec2::NEG_INFINITY);
        let (low, high) = (points.par_iter().map(plane))
            .fold(nothing, fold)
            .reduce(nothing, |a, b| (a.0.min(b.0), a.1.max(b.1)));
        if !(low.is_finite() && high.is_finite()) {
            return Err(Error::new("no points to make voxels of"));
        }
        let tile = detail.height_stride.max(detail.colour_stride);
        let across = |extent: f32| (f64::from(extent) / f64::from(voxel_m)).ceil() + 2.0;
        let size = [across(high.x - low.x), across(high.y - low.y)];
        let first = low - Vec2::splat(0.5 * voxel_m);
        let too_many = |sides: String| {
            Error::new(format!("voxels of {voxel_m} m make {sides} of them")).remedy(
                "at most 1,048,576 fit along x and y and 16,384 along z: give a larger --voxel",
            )
        };
        if size.iter().any(|side| *side > f64::from(MOST_VOXELS[0] - tile))
            || size[0] * size[1] > MOST_COLUMNS
        {
            return Err(too_many(format!("{} × {}", size[0], size[1])));
        }
        let cut = size.map(|side| side as u32);
        let [cols, rows] = cut.map(|side| side.next_multiple_of(tile) + 1);
        let place = |x: u32, y: u32| first + Vec2::new(x as f32, y as f32) * voxel_m;
        let heights: Vec<f32> = (0..rows)
            .into_par_iter()
            .flat_map_iter(|y| (0..cols).map(move |x| place(x, y)))
            .map(|p| terrain.heights.bilinear(f64::from(p.x), f64::from(p.y)))
            .collect();
        let is_above = |i: usize| classified.kind[i] != Kind::Ground;
        let range = |values: &mut dyn Iterator<Item = f32>| {
            values.fold((f32::INFINITY, f32::NEG_INFINITY), |(a, b), z| (a.min(z), b.max(z)))
        };
        let (floor, crest) = range(&mut heights.iter().copied());
        let (_, top) = range(&mut (0..points.len()).filter(|i| is_above(*i)).map(|i| points[i].z));
        let base = floor - voxel_m;
        let tall = (f64::from(crest.max(top) - base) / f64::from(voxel_m)).ceil() + 3.0;
        if !tall.is_finite() || tall >= f64::from(MOST_VOXELS[2]) {
            return Err(too_many(format!("{tall} layers")));
        }
        let first_m = Vec3::new(first.x, first.y, base);
        let height: Vec<f32> = heights.into_par_iter().map(|h| (h - base) / voxel_m).collect();

        // Points as sorted keys: column, then layer.
        let layers = (tall as u32).next_multiple_of(4);
        let at = |p: Vec3| ((p - first_m) / voxel_m + 0.5).max(Vec3::ZERO);
        let key = |i: usize| {
            let q = at(points[i]);
            let (x, y) = ((q.x as u32).min(cols - 1), (q.y as u32).min(rows - 1));
            let column = y as usize * cols as usize + x as usize;
            // What is in the ground can't be seen.
            let is_seen = is_above(i) && q.z - 0.5 > height[column] + 0.25;
            is_seen.then_some((column as u64) << 16 | u64::from((q.z as u32).min(layers - 1)))
        };
        let mut keys: Vec<u64> = (0..points.len()).into_par_iter().filter_map(key).collect();
        keys.par_sort_unstable();
        let counts: Vec<u32> = keys.chunk_by(|a, b| a == b).map(|same| same.len() as u32).collect();
        keys.dedup();
        let threshold = {
            let mut sorted = counts.clone();
            let middle = sorted.len() / 2;
            let median = if sorted.is_empty() { 1 } else { *sorted.select_nth_unstable(middle).1 };
            (median / 4).max(1)
        };
        let filled = filled(&keys, &counts, threshold, [cols, rows, layers]);
        let full = (1u32 << detail.density_bits) - 1;
        let half = 1u32 << (detail.density_bits - 1);
        let own = |(key, count): (&u64, &u32)| {
            let density = if *count >= threshold { full } else { count * half / threshold };
            (*key, density)
        };
        let mut voxels: Vec<(u64, u32)> = keys.iter().zip(&counts).map(own).collect();
        drop((keys, counts));
        voxels.extend(filled.into_iter().map(|key| (key, half)));
        gather(&mut voxels);
        voxels.retain(|(_, density)| *density > 0);
        let column = layers_of(&voxels);
        let start = starts(&voxels, height.len());
        let clumps = Clumps::new(&column, &start, &height, cols as usize, (half as u8, voxel_m));
        let (is_scrap, feet) = (clumps.scraps(), clumps.feet());
        let stems = clumps.stems().into_iter().chain(clumps.trunks());
        let mut kept = is_scrap.into_iter().map(|is| !is);
        voxels.retain(|_| kept.next().unwrap_or(true));
        // So full that the surface is about half a voxel wide.
        let slender = (2 * full).div_ceil(3);
        let layers_in = |density: u32| {
            move |(at, layers): (usize, Range<u16>)| {
                layers.map(move |z| ((at as u64) << 16 | u64::from(z), density))
            }
        };
        voxels.extend(stems.flat_map(layers_in(slender)));
        voxels.extend(feet.into_iter().flat_map(layers_in(full)));
        gather(&mut voxels);
        let start = starts(&voxels, height.len());
        let column = layers_of(&voxels);
        let mut columns = Columns {
            voxels: [cut[0], cut[1], layers],
            known: [cols, rows],
            first_m,
            start,
            column,
            height,
            paint: Paint { stride: detail.colour_stride, cols: 0, colours: Vec::new() },
        };
        let from = columns.paint(classified, terrain, photo, voxel_m);
        Ok((columns, from))
    }

    /// The least edge of voxels that are not too many over an area of this extent.
    pub fn least_voxel_m(extent_m: Vec2) -> f32 {
        // Some are added to make whole bricks.
        let extent = extent_m.max(Vec2::ONE).as_dvec2();
        (1.03 * extent.x * extent.y / MOST_COLUMNS).sqrt() as f32
    }

    /// Voxels with vegetation.
    pub fn len(&self) -> usize {
        self.column.len()
    }

    pub fn is_empty(&self) -> bool {
        self.column.is_empty()
    }

    fn range(&self, x: u32, y: u32) -> Range<usize> {
        let i = y as usize * self.known[0] as usize + x as usize;
        self.start[i] as usize..self.start[i + 1] as usize
    }

    /// The terrain under a column, in voxels.
    pub fn ground(&self, x: u32, y: u32) -> f32 {
        self.height[y as usize * self.known[0] as usize + x as usize]
    }

    fn paint(
        &mut self,
        classified: &Classified,
        terrain: &Terrain,
        photo: Option<Seen<'_>>,
        voxel_m: f32,
    ) -> PaintedFrom {
        let stride = self.paint.stride;
        let cell = f64::from(stride) * f64::from(voxel_m);
        let (cols, rows) = (
            (self.known[0].div_ceil(stride)) as usize + 1,
            (self.known[1].div_ceil(stride)) as usize + 1,
        );
        // Cell centres are where samples are; row 0 is the southernmost here.
        let west = f64::from(self.first_m.x) - 0.5 * cell;
        let south = f64::from(self.first_m.y) - 0.5 * cell;
        let geometry = GridGeometry {
            west,
            north: south + rows as f64 * cell,
            cell_x: cell,
            cell_y: cell,
            cols,
            rows,
        };
        let cell_of = |p: Vec3| {
            let i = ((f64::from(p.x) - west) / cell).max(0.0) as usize;
            let j = ((f64::from(p.y) - south) / cell).max(0.0) as usize;
            j.min(rows - 1) * cols + i.min(cols - 1)
        };
        // What each cell shows: height of the highest point, sums of colour and intensity.
        let cloud = &classified.cloud;
        let over = |p: Vec3| p.z - terrain.heights.bilinear(f64::from(p.x), f64::from(p.y));
        let mut seen = vec![Cell::default(); cols * rows];
        for (i, p) in cloud.position.iter().enumerate() {
            let cell = &mut seen[cell_of(*p)];
            let over = over(*p);
            let of = usize::from(classified.kind[i] != Kind::Ground && over > LEAST_HEIGHT_M);
            cell.count[of] += 1.0;
            cell.intensity[of] += f32::from(cloud.intensity[i]);
            if let Some(rgb) = &cloud.rgb {
                cell.colour[of] += Vec3::from(rgb[i].map(f32::from));
            }
            if of == 0 {
                cell.low = cell.low.max(cloud.class[i]);
            } else if over > cell.height {
                (cell.height, cell.class) = (over, cloud.class[i]);
            }
        }
        let from = if photo.is_some() {
            PaintedFrom::Photo
        } else if has_colour(&cloud.rgb) {
            PaintedFrom::Points
        } else {
            PaintedFrom::Heights
        };
        let place = |i: usize| {
            Vec2::new(
                self.first_m.x + ((i % cols) as f64 * cell) as f32,
                self.first_m.y + ((i / cols) as f64 * cell) as f32,
            )
        };
        // Eight or sixteen bits, as the file has them.
        let most = cloud.rgb.iter().flatten().flatten().copied().max().unwrap_or(0);
        let scale = if most > 255 { 255.0 / 65535.0 } else { 1.0 };
        let bright = Brightness::of(&seen);
        let water = match from {
            PaintedFrom::Heights => {
                let is_low = |i: usize| over(cloud.position[i]) <= LEAST_HEIGHT_M;
                Water::of(&cloud.position, &cloud.class, is_low)
            }
            _ => None,
        };
        let wet = |i: usize| water.as_ref().map_or(0.0, |water| water.share(place(i)));
        let clear = Clear::of((0..cols * rows).step_by(7).filter_map(|i| match (from, photo) {
            (PaintedFrom::Photo, Some(photo)) => photo(place(i)).map(Vec3::from),
            (PaintedFrom::Points, _) => seen[i].mean().map(|c| c * scale),
            _ => None,
        }));
        let known = |i: usize, of: usize| -> Option<Vec3> {
            let cell = &seen[i];
            match (from, photo) {
                (PaintedFrom::Photo, Some(photo)) => {
                    let is_high = cell.height > LEAST_HEIGHT_M;
                    (is_high == (of == 1)).then(|| photo(place(i)))?.map(|c| clear.seen(c.into()))
                }
                (PaintedFrom::Points, _) => {
                    let mean = || cell.colour[of] * (scale / cell.count[of]);
                    (cell.count[of] > 0.0).then(|| clear.seen(mean()))
                }
                // What lies under water is as its shores are.
                _ if of == 0 && wet(i) > 0.5 => None,
                _ => (cell.count[of] > 0.0).then(|| {
                    let tint = if of == 0 { soil(cell.low) } else { tint(cell.class, cell.height) };
                    tint * bright.of_cell(cell, of)
                }),
            }
        };
        let mut colours = vec![[[0u8; 3]; 2]; cols * rows];
        for of in 0..2 {
            let mut values: Vec<Option<Vec3>> =
                (0..cols * rows).into_par_iter().map(|i| known(i, of)).collect();
            if of == 0 && from != PaintedFrom::Heights {
                let lifted = Lifted::of(values.iter().copied().flatten());
                values.iter_mut().flatten().for_each(|v| *v = lifted.seen(*v));
            }
            let is_known: Vec<bool> = values.iter().map(Option::is_some).collect();
            if !is_known.contains(&true) {
                let plain = if of == 0 { SOIL } else { tint(5, 10.0) };
                colours.iter_mut().for_each(|c| c[of] = plain.to_array().map(|v| v as u8));
                continue;
            }
            let channels: Vec<Grid<f32>> = (0..3)
                .into_par_iter()
                .map(|channel| {
                    let data = values.iter().map(|v| v.map_or(0.0, |v| v[channel])).collect();
                    let mut grid = Grid { geometry, data };
                    inpaint::fill(&mut grid, &is_known);
                    grid
                })
                .collect();
            for (i, colour) in colours.iter_mut().enumerate() {
                colour[of] = [0, 1, 2].map(|c: usize| channels[c].data[i].clamp(0.0, 255.0) as u8);
            }
        }
        if water.is_some() {
            for (i, [ground, _]) in colours.iter_mut().enumerate() {
                let land = Vec3::from(ground.map(f32::from));
                *ground = land.lerp(DEEP, wet(i)).to_array().map(|v| v as u8);
            }
        }
        self.paint = Paint { stride, cols, colours };
        from
    }
}

/// Sorts densities by key; of those of one voxel the greatest counts.
fn gather(voxels: &mut Vec<(u64, u32)>) {
    voxels.par_sort_unstable();
    voxels.dedup_by(|next, kept| {
        let is_same = next.0 == kept.0;
        kept.1 = if is_same { kept.1.max(next.1) } else { kept.1 };
        is_same
    });
}

fn layers_of(voxels: &[(u64, u32)]) -> Vec<Voxel> {
    voxels.iter().map(|(key, d)| Voxel { z: *key as u16, density: *d as u8 }).collect()
}

/// Where the voxels of each of so many columns begin, and their end.
fn starts(voxels: &[(u64, u32)], columns: usize) -> Vec<u32> {
    let mut start = vec![0u32; columns + 1];
    for (key, _) in voxels {
        start[(key >> 16) as usize + 1] += 1;
    }
    for i in 1..start.len() {
        start[i] += start[i - 1];
    }
    start
}

/// Columns that are made of one scan, at most: they take 33 bytes each while they are.
const MOST_COLUMNS: f64 = 5e7;
/// Voxels that are not vegetation themselves between two on their sides that are; sorted.
fn filled(
    keys: &[u64],
    counts: &[u32],
    threshold: u32,
    [cols, rows, layers]: [u32; 3],
) -> Vec<u64> {
    let is_full = |(_, count): &(&u64, &u32)| **count >= threshold;
    let full: Vec<u64> = keys.iter().zip(counts).filter(is_full).map(|(key, _)| *key).collect();
    let beside = |key: &u64| {
        let (column, z) = (key >> 16, (key & 0xffff) as u32);
        let (x, y) = ((column % u64::from(cols)) as u32, (column / u64::from(cols)) as u32);
        let east = u64::from(cols) << 16;
        [
            (x > 0).then(|| key - (1 << 16)),
            (x + 1 < cols).then(|| key + (1 << 16)),
            (y > 0).then(|| key - east),
            (y + 1 < rows).then(|| key + east),
            (z > 0).then(|| key - 1),
            (z + 1 < layers).then(|| key + 1),
        ]
    };
    let mut near: Vec<u64> =
        full.par_iter().flat_map_iter(|key| beside(key).into_iter().flatten()).collect();
    near.par_sort_unstable();
    let pairs = near.chunk_by(|a, b| a == b).filter(|same| same.len() > 1).map(|same| same[0]);
    pairs.filter(|key| full.binary_search(key).is_err()).collect()
}

impl Source for Columns {
    fn voxels(&self) -> [u32; 3] {
        self.voxels
    }

    fn known(&self) -> [u32; 2] {
        self.known
    }

    fn column(&self, x: u32, y: u32) -> &[Voxel] {
        &self.column[self.range(x, y)]
    }

    fn height(&self, x: u32, y: u32) -> Option<f32> {
        Some(self.ground(x, y))
    }

    fn colours(&self, x: u32, y: u32) -> [[u8; 3]; 2] {
        let stride = self.paint.stride;
        let at = (y / stride) as usize * self.paint.cols + (x / stride) as usize;
        self.paint.colours.get(at).copied().unwrap_or([[127; 3]; 2])
    }
}

/// A source laid side by side with its mirror images over a larger square, without seams.
#[derive(Debug)]
pub struct Mirrored<'a, S> {
    pub tile: &'a S,
    /// Voxels of the tile that are laid along x and y.
    pub side: u32,
    /// Voxels along x, y and z of the whole.
    pub whole: [u32; 3],
}

impl<S: Source> Mirrored<'_, S> {
    fn fold(&self, i: u32) -> u32 {
        let at = i % (2 * self.side);
        if at < self.side { at } else { 2 * self.side - 1 - at }
    }
}

impl<S: Source> Source for Mirrored<'_, S> {
    fn voxels(&self) -> [u32; 3] {
        self.whole
    }

    fn column(&self, x: u32, y: u32) -> &[Voxel] {
        self.tile.column(self.fold(x), self.fold(y))
    }

    fn height(&self, x: u32, y: u32) -> Option<f32> {
        self.tile.height(self.fold(x), self.fold(y))
    }

    fn colours(&self, x: u32, y: u32) -> [[u8; 3]; 2] {
        self.tile.colours(self.fold(x), self.fold(y))
    }
}
