//! How far apart the silhouettes of two models are.
//!
//! Both are drawn from nine sides and from above on one grid, with pictures read texel by texel; the
//! error is the Hausdorff distance of the covered samples: the farthest that any place covered by
//! one is from what the other covers. A sample is looked at in four places: it is covered where any
//! is, and counts in a mean by how many are, so that bare twigs weigh what they cover, whatever
//! the size of a sample or a texel. Distances are exact Euclidean (Felzenszwalb & Huttenlocher
//! 2012). Known limits: nothing below one sample of the grid is seen, so errors are stated to that,
//! and a gap in a crown counts only where it is farther than that from any leaf; a lone leaf no
//! larger than half a sample may show in one model and not in another, which counts as far
//! as the next leaf.

use glam::Vec3;
use rayon::prelude::*;

use crate::diagnostic::Result;
use crate::render::capture::{Sitter, Window};
use crate::scene::Apart;
use crate::work::{self, Work};

/// Samples along the longer side of the grid.
const SAMPLES: usize = 320;
/// Places looked at along a side of a sample.
const PLACES: usize = 2;
/// Sides looked from, about Z: an odd number, for which those of a quarter turn are nine, ten degrees apart. A
/// cross is seen square to a sheet and half way between them, where it is worst.
const SIDES: usize = 9;

/// Where models are looked at from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Views {
    All,
    /// Not from above, whence upright sheets show nothing.
    Sides,
}

/// What one model covers, seen from all sides.
pub struct Silhouettes {
    /// Side of a sample, metres.
    pub sample_m: f32,
    masks: Vec<Mask>,
}

struct Mask {
    /// Places of each sample that are covered.
    covered: Vec<u8>,
    /// Of each sample, to the nearest covered one, in samples, squared.
    distance_sq: Vec<f32>,
}

impl Silhouettes {
    /// Of a model within `bounds`, which all that are compared must share; give a sitter for covers
    /// ([`Sitter::covers`]).
    ///
    /// # Errors
    /// Bounds that are not finite.
    pub fn of(
        sitter: &Sitter<'_>,
        model: u32,
        bounds: (Vec3, Vec3),
        views: Views,
    ) -> Result<Silhouettes> {
        Silhouettes::turning(sitter, |_| model, bounds, views)
    }

    /// Of what turns to the eye: `model` of each of [`looks`], by its number.
    ///
    /// # Errors
    /// Bounds that are not finite.
    pub fn turning(
        sitter: &Sitter<'_>,
        model: impl Fn(usize) -> u32 + Sync,
        bounds: (Vec3, Vec3),
        views: Views,
    ) -> Result<Silhouettes> {
        let windows = windows(bounds, views, SIDES, SAMPLES);
        let masks = windows
            .par_iter()
            .enumerate()
            .map(|(k, w)| Ok(Mask::new(w.size[0], covered(sitter, model(k), w)?)))
            .collect::<Result<_>>()?;
        Ok(Silhouettes { sample_m: windows.first().map_or(0.0, |w| w.sample_m), masks })
    }

    /// Both ways, over the views that both have; infinite where one of the two covers nothing and the
    /// other does.
    pub fn apart(&self, other: &Silhouettes) -> Apart {
        let (mut worst_sq, mut sum, mut count) = (0.0f32, 0.0f64, 0u64);
        for (a, b) in self.masks.iter().zip(&other.masks) {
            for (from, to) in [(a, b), (b, a)] {
                for (&covered, &d) in from.covered.iter().zip(&to.distance_sq) {
                    if covered > 0 {
                        worst_sq = worst_sq.max(d);
                        sum += f64::from(d) * f64::from(covered);
                        count += u64::from(covered);
                    }
                }
            }
        }
        Apart {
            worst_m: worst_sq.sqrt() * self.sample_m,
            rms_m: (sum / count.max(1) as f64).sqrt() as f32 * self.sample_m,
        }
    }
}

/// Unit; the ways that [`Silhouettes`] look: from the sides, then from above.
pub fn looks() -> impl Iterator<Item = Vec3> {
    (0..SIDES).map(|k| sideways(k, SIDES)).chain([-Vec3::Z])
}

/// Off the axes, along which cards and walls may lie.
fn sideways(k: usize, sides: usize) -> Vec3 {
    let (sin, cos) = ((k as f32 + 0.37) / sides as f32 * std::f32::consts::TAU).sin_cos();
    Vec3::new(cos, sin, 0.0)
}

/// Windows on what is within bounds, from sides about Z and from above; so many samples along the
/// longer side.
fn windows((lo, hi): (Vec3, Vec3), views: Views, sides: usize, samples: usize) -> Vec<Window> {
    let span = hi - lo;
    let wide_m = span.truncate().length();
    let sample_m = wide_m.max(span.z).max(1e-3) / samples as f32;
    let samples = |m: f32| (m / sample_m).ceil() as usize + 2;
    let level = [samples(wide_m), samples(span.z)];
    let centre = 0.5 * (lo + hi);
    let side = |k: usize| Window { centre, forward: sideways(k, sides), sample_m, size: level };
    let above = Window { centre, forward: -Vec3::Z, sample_m, size: [samples(wide_m); 2] };
    (0..sides).map(side).chain((views == Views::All).then_some(above)).collect()
}

/// Places of each sample that a model covers.
fn covered(sitter: &Sitter<'_>, model: u32, window: &Window) -> Result<Vec<u8>> {
    let [width, height] = window.size;
    let fine = Window {
        sample_m: window.sample_m / PLACES as f32,
        size: [width * PLACES, height * PLACES],
        ..*window
    };
    let places = sitter.silhouette(model, &fine)?;
    let mut covered = vec![0; width * height];
    for (line, row) in places.chunks_exact(width * PLACES).zip(0..) {
        let samples = &mut covered[row / PLACES * width..][..width];
        for (sample, of) in samples.iter_mut().zip(line.chunks_exact(PLACES)) {
            *sample += of.iter().map(|&c| u8::from(c)).sum::<u8>();
        }
    }
    Ok(covered)
}

/// How many samples a model covers.
pub struct Cover {
    /// Seen from each side, row by row, the highest first.
    pub sides: Vec<Vec<usize>>,
    pub above: usize,
    /// Height of the highest row's middle, and between rows, metres.
    top_m: f32,
    sample_m: f32,
}

impl Cover {
    /// Of a model within `bounds`; give a sitter for covers ([`Sitter::covers`]), and the same bounds
    /// for what is compared.
    ///
    /// # Errors
    /// Bounds that are not finite.
    pub fn of(
        sitter: &Sitter<'_>,
        model: u32,
        bounds: (Vec3, Vec3),
        sides: usize,
        samples: usize,
    ) -> Result<Cover> {
        let windows = windows(bounds, Views::All, sides, samples);
        let mut sides: Vec<Vec<usize>> = windows
            .par_iter()
            .map(|w| {
                let covered = sitter.silhouette(model, w)?;
                let rows = covered.chunks_exact(w.size[0]);
                Ok(rows.map(|row| row.iter().filter(|c| **c).count()).collect())
            })
            .collect::<Result<_>>()?;
        let above = sides.pop().map_or(0, |rows| rows.iter().sum());
        let [_, height] = windows[0].size;
        let sample_m = windows[0].sample_m;
        let top_m = windows[0].centre.z + 0.5 * (height - 1) as f32 * sample_m;
        Ok(Cover { sides, above, top_m, sample_m })
    }

    /// Height of a row's middle, metres.
    pub fn height_m(&self, row: usize) -> f32 {
        self.top_m - row as f32 * self.sample_m
    }
}

impl Mask {
    fn new(width: usize, covered: Vec<u8>) -> Mask {
        work::count(Work::Silhouettes, 1);
        let height = covered.len() / width.max(1);
        let mut out: Vec<f32> =
            covered.iter().map(|&c| if c > 0 { 0.0 } else { f32::INFINITY }).collect();
        let longest = width.max(height);
        let (mut line, mut scratch) = (vec![0.0; longest], Envelope::of_length(longest));
        for x in 0..width {
            for y in 0..height {
                line[y] = out[y * width + x];
            }
            scratch.transform(&mut line[..height]);
            for y in 0..height {
                out[y * width + x] = line[y];
            }
        }
        for row in out.chunks_exact_mut(width.max(1)) {
            scratch.transform(row);
        }
        Mask { covered, distance_sq: out }
    }
}

/// The lower envelope of parabolas that stand on the samples of a line.
struct Envelope {
    value: Vec<f32>,
    vertex: Vec<usize>,
    start: Vec<f32>,
}

impl Envelope {
    fn of_length(n: usize) -> Envelope {
        Envelope { value: vec![0.0; n], vertex: vec![0; n], start: vec![0.0; n + 1] }
    }

    /// f(x) becomes the least of f(q) + (x − q)² over all q.
    fn transform(&mut self, line: &mut [f32]) {
        let n = line.len();
        self.value[..n].copy_from_slice(line);
        let f = &self.value;
        let mut count = 0;
        for q in (0..n).filter(|&q| f[q].is_finite()) {
            let mut from = f32::NEG_INFINITY;
            while count > 0 {
                let p = self.vertex[count - 1];
                let (pf, qf) = (p as f32, q as f32);
                from = ((f[q] + qf * qf) - (f[p] + pf * pf)) / (2.0 * (qf - pf));
                if from > self.start[count - 1] {
                    break;
                }
                count -= 1;
                from = f32::NEG_INFINITY;
            }
            self.vertex[count] = q;
            self.start[count] = from;
            count += 1;
        }
        let mut k = 0;
        for (x, out) in line.iter_mut().enumerate() {
            while k + 1 < count && self.start[k + 1] < x as f32 {
                k += 1;
            }
            *out = match count {
                0 => f32::INFINITY,
                _ => {
                    let away = x as f32 - self.vertex[k] as f32;
                    away * away + f[self.vertex[k]]
                }
            };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn distances_are_those_of_a_search(
            covered in prop::collection::vec(prop_oneof![9 => Just(0), 1 => 1u8..=4], 1..150),
            width in 1usize..15,
        ) {
            let height = covered.len() / width;
            prop_assume!(height > 0);
            let mask = Mask::new(width, covered[..width * height].to_vec());
            for (i, got) in mask.distance_sq.iter().enumerate() {
                let (x, y) = ((i % width) as f32, (i / width) as f32);
                let wanted = (0..width * height)
                    .filter(|&k| mask.covered[k] > 0)
                    .map(|k| ((k % width) as f32 - x).powi(2) + ((k / width) as f32 - y).powi(2))
                    .fold(f32::INFINITY, f32::min);
                prop_assert_eq!(*got, wanted);
            }
        }
    }
}
