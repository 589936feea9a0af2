//! Normals of wood where a tube's own roundness misleads: in crotches and sharp bends, where rings lie
//! aslant, a normal may look away from a triangle it belongs to. Such a one becomes the mean of the
//! fronts about its corner, each by its angle there (Thürmer & Wüthrich 1998), and is turned on
//! where that is not enough. Limit: where the surface is folded back on itself no normal suits all.

use std::ops::Range;

use glam::Vec3;

use super::Surface;
use super::path::Ring;
use super::piece::turn;
use super::young::BARKS;

/// Turns for one triangle that may matter to its neighbour.
const ROUNDS: i8 = 12;
const NEVER: i8 = -1;

/// What one tube has in each bark: its first vertex and index.
pub type Starts = [(usize, usize); BARKS];

/// The bands of a tube's triangles.
#[derive(Default)]
struct Bands {
    /// Where each ends in each bark's index, and whether a normal may look away there.
    end: Vec<([usize; BARKS], bool)>,
    /// Those where one does.
    hot: Vec<usize>,
    /// Of the ring with most.
    sides: u32,
}

/// Finds and mends such normals; its buffers are kept for the next tube.
#[derive(Default)]
pub struct Facing {
    bands: Bands,
    /// Vertices whose normals look away, and for each vertex which of these stands for it.
    astray: Vec<u32>,
    stands: Vec<u32>,
    mean: Vec<Vec3>,
    /// Vertices of triangles with such a vertex, and the corners of all triangles that have one of
    /// those: as far as turning a normal reaches.
    is_beside: Vec<bool>,
    near: Vec<u32>,
    /// In which round each vertex was turned last.
    turned: Vec<i8>,
}

const NONE: u32 = u32::MAX;

/// Whether the normals between two rings may look away from its triangles: not where they are nearly
/// square to the way between them, change their radius by less than half of it, and are far from
/// meeting. Then a normal is within 60° and twice 27° of a front, less what these bounds leave.
pub fn may_stray(low: &Ring, high: &Ring) -> bool {
    const SQUARE: f32 = 0.98;
    const STEEP: f32 = 0.5;
    const MEETING: f32 = 0.4;
    let way = high.centre - low.centre;
    let length = way.length();
    let (thick, change) = (low.radius_m.max(high.radius_m), (high.radius_m - low.radius_m).abs());
    let is_plain = low.tangent.dot(way).min(high.tangent.dot(way)) >= SQUARE * length
        && change <= STEEP * length
        && low.slope.abs().max(high.slope.abs()) <= STEEP
        && thick * (high.tangent - low.tangent).length() <= MEETING * length
        && low.lobe.max(high.lobe) == 0.0;
    // NaN is not plain.
    !is_plain
}

impl Bands {
    /// Where bands are in a bark's index, which begins at `start`.
    fn span(&self, bark: usize, start: usize, bands: Range<usize>) -> Range<usize> {
        let end = |band: usize| self.end[band].0[bark];
        let from = if bands.start == 0 { start } else { end(bands.start - 1) };
        from..end(bands.end - 1)
    }

    /// Calls `f` with the triangles of the hot bands and of so many on both sides.
    fn around(
        &self,
        bark: usize,
        (start, index): (usize, &[u32]),
        reach: usize,
        mut f: impl FnMut(&[u32; 3]),
    ) {
        let mut done = 0;
        for &hot in &self.hot {
            let bands = hot.saturating_sub(reach).max(done)..(hot + reach + 1).min(self.end.len());
            if !bands.is_empty() {
                done = bands.end;
                index[self.span(bark, start, bands)].as_chunks().0.iter().for_each(&mut f);
            }
        }
    }
}

impl Facing {
    /// Before a tube.
    pub fn begin(&mut self, rings: &[Ring]) {
        self.bands.end.clear();
        self.bands.sides = rings.iter().map(|r| r.sides).max().unwrap_or(0);
    }

    /// After each band of triangles: whether it may have a normal that looks away.
    pub fn band(&mut self, surface: &[Surface; BARKS], may_stray: bool) {
        self.bands.end.push((surface.each_ref().map(|s| s.index.len()), may_stray));
    }

    /// Mends the normals of a tube, once all its bands are there.
    pub fn mend(&mut self, surface: &mut [Surface; BARKS], starts: Starts) {
        for (bark, (surface, start)) in surface.iter_mut().zip(starts).enumerate() {
            self.find(bark, surface, start);
            if !self.bands.hot.is_empty() {
                self.mend_found(bark, surface, start);
            }
        }
    }

    fn find(&mut self, bark: usize, surface: &Surface, (_, start): (usize, usize)) {
        let Surface { position, normal, index, .. } = surface;
        let Facing { bands, astray, .. } = self;
        astray.clear();
        bands.hot.clear();
        for band in (0..bands.end.len()).filter(|&band| bands.end[band].1) {
            let before = astray.len();
            for t in index[bands.span(bark, start, band..band + 1)].as_chunks::<3>().0 {
                let [a, b, c] = t.map(|i| position[i as usize]);
                let front = (b - a).cross(c - a);
                let [d, e, f] = t.map(|i| normal[i as usize].dot(front));
                if d.min(e).min(f) < 0.0 {
                    astray.extend(t.iter().filter(|&&i| normal[i as usize].dot(front) < 0.0));
                }
            }
            if astray.len() > before {
                bands.hot.push(band);
            }
        }
        astray.sort_unstable();
        astray.dedup();
    }

    fn mend_found(&mut self, bark: usize, surface: &mut Surface, (first, start): (usize, usize)) {
        let Surface { position, normal, index, .. } = surface;
        let Facing { bands, astray, stands, mean, is_beside, near, .. } = self;
        mean.clear();
        mean.resize(astray.len(), Vec3::ZERO);
        stands.clear();
        stands.resize(position.len() - first, NONE);
        is_beside.clear();
        is_beside.resize(position.len() - first, false);
        for (k, &i) in astray.iter().enumerate() {
            let i = i as usize;
            if stands[i - first] != NONE {
                continue;
            }
            // Others in its place with its normal are the same corner: at a seam, or a fold.
            // A ring has two vertices more than sides.
            let reach = bands.sides as usize + 1;
            for j in i.saturating_sub(reach).max(first)..(i + reach + 1).min(position.len()) {
                if position[j] == position[i] && normal[j] == normal[i] {
                    stands[j - first] = k as u32;
                }
            }
        }
        bands.around(bark, (start, index), 1, |t| {
            let own = t.map(|i| stands[i as usize - first]);
            if own == [NONE; 3] {
                return;
            }
            t.iter().for_each(|&i| is_beside[i as usize - first] = true);
            let [a, b, c] = t.map(|i| position[i as usize]);
            let front = (b - a).cross(c - a).normalize_or_zero();
            for (k, [at, to, from]) in own.into_iter().zip([[a, b, c], [b, c, a], [c, a, b]]) {
                if let Some(mean) = mean.get_mut(k as usize) {
                    *mean += front * (to - at).angle_between(from - at);
                }
            }
        });
        for (n, &k) in normal[first..].iter_mut().zip(&*stands) {
            if let Some(mean) = mean.get(k as usize) {
                *n = mean.normalize_or(*n);
            }
        }
        near.clear();
        bands.around(bark, (start, index), 2, |t| {
            if t.iter().any(|&i| is_beside[i as usize - first]) {
                near.extend(t);
            }
        });
        self.straighten(&position[first..], &mut normal[first..], first);
    }

    /// Turns normals until none looks away, or [`ROUNDS`] times, where one has become the mean or has
    /// been turned since.
    fn straighten(&mut self, position: &[Vec3], normal: &mut [Vec3], first: usize) {
        let Facing { near, turned, stands, .. } = self;
        turned.clear();
        turned.extend(stands.iter().map(|k| if *k == NONE { NEVER } else { 0 }));
        for round in 1..=ROUNDS {
            let mut is_straight = true;
            for t in near.as_chunks::<3>().0 {
                let corners = t.map(|i| i as usize - first);
                if corners.iter().any(|&i| turned[i] >= round - 1) {
                    turn(position, normal, corners, |i| {
                        turned[i] = round;
                        is_straight = false;
                    });
                }
            }
            if is_straight {
                return;
            }
        }
    }
}
