//! A raster in square patches of which equal ones are kept once, as equal subtrees are in the graph
//! of voxels. Patches overlap by one sample, so that four neighbours are always in one patch.

use std::collections::HashMap;
use std::hash::Hash;

/// Steps between samples along the side of a patch.
pub(super) const PATCH: usize = 32;
const ROW: usize = PATCH + 1;

#[derive(Debug, Clone, PartialEq)]
pub(super) struct Patchwork<T> {
    /// Patches along x and y.
    pub cols: usize,
    pub rows: usize,
    /// Which patch is at a place, row after row.
    pub places: Vec<u32>,
    /// (PATCH + 1)² samples a patch.
    pub samples: Vec<T>,
}

impl<T: Copy + Eq + Hash + Default> Patchwork<T> {
    /// Samples 0..=width along x and 0..=height along y, asked for once a patch they are in.
    pub fn build(width: usize, height: usize, at: impl Fn(usize, usize) -> T) -> Patchwork<T> {
        let (cols, rows) = (width.div_ceil(PATCH).max(1), height.div_ceil(PATCH).max(1));
        let mut work = Patchwork { cols, rows, places: Vec::new(), samples: Vec::new() };
        let mut known: HashMap<Vec<T>, u32> = HashMap::new();
        for (row, col) in (0..rows).flat_map(|row| (0..cols).map(move |col| (row, col))) {
            let sample = |i: usize| {
                let (x, y) = (col * PATCH + i % ROW, row * PATCH + i / ROW);
                at(x.min(width), y.min(height))
            };
            let patch: Vec<T> = (0..ROW * ROW).map(sample).collect();
            let next = known.len() as u32;
            let samples = &mut work.samples;
            let place = *known.entry(patch).or_insert_with_key(|patch| {
                samples.extend_from_slice(patch);
                next
            });
            work.places.push(place);
        }
        work.places.shrink_to_fit();
        work.samples.shrink_to_fit();
        work
    }
}

impl<T: Copy> Patchwork<T> {
    /// The samples at (x, y), (x + 1, y), (x, y + 1) and (x + 1, y + 1); the nearest patch's outside.
    #[inline]
    pub fn four(&self, x: usize, y: usize) -> [T; 4] {
        let col = (x / PATCH).min(self.cols - 1);
        let row = (y / PATCH).min(self.rows - 1);
        let (i, j) = ((x - col * PATCH).min(PATCH - 1), (y - row * PATCH).min(PATCH - 1));
        let patch = self.places[row * self.cols + col] as usize * (ROW * ROW);
        let at = patch + j * ROW + i;
        [self.samples[at], self.samples[at + 1], self.samples[at + ROW], self.samples[at + ROW + 1]]
    }

    /// What breaks the invariants: a place for each patch, and each place's patch whole.
    pub fn check(&self) -> Result<(), String> {
        let patches = self.samples.len() / (ROW * ROW);
        if self.cols == 0
            || self.rows == 0
            || self.cols.checked_mul(self.rows) != Some(self.places.len())
        {
            return Err(format!(
                "{} places for {} × {} patches",
                self.places.len(),
                self.cols,
                self.rows
            ));
        }
        if patches * ROW * ROW != self.samples.len() {
            return Err("a patch is cut short".into());
        }
        match self.places.iter().find(|&&place| place as usize >= patches) {
            Some(place) => Err(format!("patch {place} of {patches}")),
            None => Ok(()),
        }
    }

    /// Bytes held.
    pub fn memory_bytes(&self) -> usize {
        size_of::<Self>() + 4 * self.places.capacity() + size_of::<T>() * self.samples.capacity()
    }
}
