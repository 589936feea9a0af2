//! Normals of wood where a tube's own roundness misleads: in crotches and sharp bends, where rings lie
//! aslant, a normal may look away from a triangle it belongs to. Such a one becomes the mean of the
//! fronts about its corner, each by its angle there (Thürmer & Wüthrich 1998), and is turned on
//! where that is not enough. Limit: where the surface is folded back on itself no normal suits all.

use std::ops::Range;

use glam::Vec3;

use super::Surface;
use super::path::MAX_SIDES;
use super::piece::straighten;

/// Turns for one triangle that may matter to its neighbour.
const ROUNDS: usize = 12;

/// Buffers, kept for the next tube.
#[derive(Default)]
pub struct Facing {
    /// Vertices whose normals look away, and for each vertex which of these stands for it.
    astray: Vec<u32>,
    stands: Vec<u32>,
    mean: Vec<Vec3>,
}

const NONE: u32 = u32::MAX;

impl Facing {
    /// Mends the normals of what has been added since a surface had so many vertices and indices.
    pub fn mend(&mut self, surface: &mut Surface, (vertices, indices): (usize, usize)) {
        let Surface { position, normal, index, .. } = surface;
        let index = &index[indices..];
        self.astray.clear();
        for t in index.as_chunks::<3>().0 {
            let [a, b, c] = t.map(|i| position[i as usize]);
            let front = (b - a).cross(c - a);
            let [d, e, f] = t.map(|i| normal[i as usize].dot(front));
            if d.min(e).min(f) < 0.0 {
                self.astray.extend(t.iter().filter(|&&i| normal[i as usize].dot(front) < 0.0));
            }
        }
        if self.astray.is_empty() {
            return;
        }
        self.astray.sort_unstable();
        self.astray.dedup();
        self.mean.clear();
        self.mean.resize(self.astray.len(), Vec3::ZERO);
        self.stands.clear();
        self.stands.resize(position.len() - vertices, NONE);
        for (k, &i) in self.astray.iter().enumerate() {
            let i = i as usize;
            if self.stands[i - vertices] != NONE {
                continue;
            }
            // Others in its place with its normal are the same corner: at a seam, or a fold.
            for j in near(i, vertices, position.len()) {
                if position[j] == position[i] && normal[j] == normal[i] {
                    self.stands[j - vertices] = k as u32;
                }
            }
        }
        for t in index.as_chunks::<3>().0 {
            let stands = t.map(|i| self.stands[i as usize - vertices]);
            if stands == [NONE; 3] {
                continue;
            }
            let [a, b, c] = t.map(|i| position[i as usize]);
            let front = (b - a).cross(c - a).normalize_or_zero();
            for (k, [at, to, from]) in stands.into_iter().zip([[a, b, c], [b, c, a], [c, a, b]]) {
                if let Some(mean) = self.mean.get_mut(k as usize) {
                    *mean += front * (to - at).angle_between(from - at);
                }
            }
        }
        for (n, &k) in normal[vertices..].iter_mut().zip(&self.stands) {
            if let Some(mean) = self.mean.get(k as usize) {
                *n = mean.normalize_or(*n);
            }
        }
        straighten(&position[vertices..], &mut normal[vertices..], index, vertices as u32, ROUNDS);
    }
}

/// The vertices of a ring that one may belong to.
fn near(i: usize, first: usize, end: usize) -> Range<usize> {
    let reach = MAX_SIDES as usize + 1;
    i.saturating_sub(reach).max(first)..(i + reach + 1).min(end)
}
