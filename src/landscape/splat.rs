//! Voxels as squares of their size in the picture (splatting, the first of TD17's four ways): what
//! is near hides what is far by a depth each pixel.
//!
//! The graph of voxels is visited down to single voxels, or to cells as small as a pixel; ground is
//! splatted a column at a time, and so is the earth where the scene ends. Bands of the picture are drawn apart, each in the same order.

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::Landscape;
use super::dag::{BITS, Ref};
use super::lens::Lens;
use super::trace::{Hit, What};

/// Rows that one thread draws at a time.
const BAND: usize = 64;

/// What each pixel shows, row by row.
pub(super) fn splat(scene: &Landscape, lens: &Lens, [width, height]: [u32; 2]) -> Vec<Option<Hit>> {
    let mut hits = vec![None; width as usize * height as usize];
    let Some(root) = scene.dag.root else { return hits };
    let draw = |(band, hits): (usize, &mut [Option<Hit>])| {
        let rows = hits.len() / width as usize;
        let mut sheet = Sheet {
            scene,
            lens,
            width: width as usize,
            first: band * BAND,
            rows,
            picture: [f64::from(width) / 2.0, f64::from(height) / 2.0],
            hits,
        };
        sheet.visit(root.index(), scene.dag.levels, [0; 3]);
        sheet.cuts();
    };
    hits.par_chunks_mut(BAND * width as usize).enumerate().for_each(draw);
    hits
}

struct Sheet<'a> {
    scene: &'a Landscape,
    lens: &'a Lens,
    width: usize,
    /// The first row.
    first: usize,
    rows: usize,
    /// Half the picture.
    picture: [f64; 2],
    hits: &'a mut [Option<Hit>],
}

/// A ball in the picture: its depth, and the pixel of its middle.
struct Seen {
    depth: f64,
    at: [f64; 2],
}

impl Sheet<'_> {
    /// Where a ball is; `None` where it is behind the eye or outside the band.
    fn seen(&self, centre: DVec3, radius: f64) -> Option<Seen> {
        let lens = self.lens;
        let v = centre - lens.eye;
        let depth = v.dot(lens.forward);
        if depth + radius <= 0.0 {
            return None;
        }
        let per = 1.0 / (lens.pixel * lens.pixel * depth.max(1e-6));
        let at =
            [v.dot(lens.right) * per + self.picture[0], v.dot(lens.down) * per + self.picture[1]];
        let nearest = depth - radius;
        let reach =
            if nearest > 0.0 { 1.3 * radius / (nearest * lens.pixel) } else { f64::INFINITY };
        let (top, bottom) = (self.first as f64, (self.first + self.rows) as f64);
        let is_beside = at[0] + reach < 0.0
            || at[0] - reach > self.width as f64
            || at[1] + reach < top
            || at[1] - reach > bottom;
        (!is_beside).then_some(Seen { depth, at })
    }

    fn visit(&mut self, node: usize, level: u32, low: [u32; 3]) {
        let shift = BITS * (level - 1);
        let dag = &self.scene.dag;
        let mask = dag.mask(node);
        let side = f64::from(1u32 << shift);
        for number in (0..64).filter(|number| mask >> number & 1 != 0) {
            let Some(child) = dag.child(node, number) else { continue };
            let at = [number & 3, number >> 2 & 3, number >> 4];
            let low = [0, 1, 2].map(|a: usize| low[a] + (at[a] << shift));
            let centre = Vec3::from(low.map(|v| v as f32)).as_dvec3() + DVec3::splat(0.5 * side);
            let Some(seen) = self.seen(centre, 0.867 * side) else { continue };
            let is_small = side <= self.lens.pixel * seen.depth;
            if !is_small && level > 2 {
                self.visit(child.index(), level - 1, low);
            } else if is_small && shift > 0 {
                let what = if child.has(Ref::VEGETATION) { What::Vegetation } else { What::Ground };
                if child.has(Ref::VEGETATION | Ref::GROUND) {
                    self.put(&seen, side, what, (mask, number), 1 << shift);
                }
            } else {
                self.brick(child, low);
            }
        }
    }

    fn brick(&mut self, child: Ref, low: [u32; 3]) {
        if child.has(Ref::VEGETATION) {
            let solid = self.scene.dag.solid(child.index());
            for number in (0..64).filter(|number| solid >> number & 1 != 0) {
                let at = [number & 3, number >> 2 & 3, number >> 4];
                let centre = [0, 1, 2].map(|a: usize| f64::from(low[a] + at[a]));
                if let Some(seen) = self.seen(DVec3::from(centre), 0.5) {
                    self.put(&seen, 1.0, What::Vegetation, (solid, number), 1);
                }
            }
        }
        if child.has(Ref::GROUND) {
            let [wide, deep, _] = self.scene.sides;
            let all = (0..4).flat_map(|y| (0..4).map(move |x| (low[0] + x, low[1] + y)));
            for (x, y) in all.filter(|(x, y)| *x <= wide && *y <= deep) {
                let (x, y) = (f64::from(x), f64::from(y));
                let Some(z) = self.scene.height(x, y) else { continue };
                if (f64::from(low[2])..f64::from(low[2] + 4)).contains(&z)
                    && let Some(seen) = self.seen(DVec3::new(x, y, z), 0.5)
                {
                    self.put(&seen, 1.0, What::Ground, (0, 0), 1);
                }
            }
        }
    }

    /// The faces of the earth towards the eye.
    fn cuts(&mut self) {
        let (eye, sides) = (self.lens.eye.to_array(), self.scene.sides.map(f64::from));
        for axis in 0..2 {
            let face = if eye[axis] < 0.0 { 0.0 } else { sides[axis] };
            if (0.0..=sides[axis]).contains(&eye[axis]) {
                continue;
            }
            let mut along = 0.0;
            while along <= sides[1 - axis] {
                let (x, y) = if axis == 0 { (face, along) } else { (along, face) };
                along += self.column(x, y, axis);
            }
        }
    }

    /// The earth below a place on a face across `axis`, in squares no smaller than pixels; gives their
    /// side.
    fn column(&mut self, x: f64, y: f64, axis: usize) -> f64 {
        let Some(top) = self.scene.height(x, y) else { return 1.0 };
        let depth = (DVec3::new(x, y, 0.5 * top) - self.lens.eye).dot(self.lens.forward);
        let side = (self.lens.pixel * depth).max(1.0).floor();
        let count = (top / side).ceil().max(0.0);
        let mut low = 0.0;
        while low < count {
            let z = ((low + 0.5) * side).min(top - 0.5 * side);
            if let Some(seen) = self.seen(DVec3::new(x, y, z), 0.5 * side) {
                self.put(&seen, side, What::Cut(axis as u8), (0, 0), side as u32);
            }
            low += 1.0;
        }
        side
    }

    fn put(&mut self, seen: &Seen, side: f64, what: What, around: (u64, u32), size: u32) {
        if seen.depth <= 0.0 {
            return;
        }
        // Wide enough that neighbours meet aslant.
        let half = 0.6 * side / (self.lens.pixel * seen.depth);
        let span = |at: f64, from: usize, count: usize| {
            let low = (at - half - 0.5).ceil().max(from as f64);
            let high = (at + half - 0.5).floor().min((from + count) as f64 - 1.0);
            // The nearest pixel where none has its centre within.
            let near = at.floor().clamp(from as f64, (from + count) as f64 - 1.0);
            if low <= high { low as usize..=high as usize } else { near as usize..=near as usize }
        };
        let is_outside = seen.at[1] + half < self.first as f64
            || seen.at[1] - half >= (self.first + self.rows) as f64
            || seen.at[0] + half < 0.0
            || seen.at[0] - half >= self.width as f64;
        if is_outside {
            return;
        }
        let hit = Hit { t: seen.depth, what, size, around };
        for row in span(seen.at[1], self.first, self.rows) {
            for col in span(seen.at[0], 0, self.width) {
                let place = &mut self.hits[(row - self.first) * self.width + col];
                if place.is_none_or(|before| hit.t < before.t) {
                    *place = Some(hit);
                }
            }
        }
    }
}
