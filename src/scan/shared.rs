//! Points that come twice, in two files, as tiles cut with a buffer have them, or in one: told by a
//! sample.

use std::collections::{BTreeMap, HashMap};
use std::path::PathBuf;

use rayon::prelude::*;

use super::part::{Columns, Coordinates};
use crate::seed::mix;

/// Points looked at, at most: of more, fewer.
const MOST: usize = 1 << 17;
/// Points looked at at first, in powers of two: one of so many.
const FIRST_BITS: u32 = 4;
/// So many points of the sample come again before it is told, and this part of a file.
const LEAST: u64 = 16;
const LEAST_SHARE: f64 = 0.01;

/// Points by place and return, and the first file that holds each.
pub(super) struct Sample {
    bits: u32,
    first: HashMap<u64, usize>,
    /// By file, and by pair of files: how often there, and of how many points.
    looked: BTreeMap<usize, u64>,
    alike: BTreeMap<(usize, usize), [u64; 2]>,
}

impl Default for Sample {
    fn default() -> Self {
        Sample {
            bits: FIRST_BITS,
            first: HashMap::new(),
            looked: BTreeMap::new(),
            alike: BTreeMap::new(),
        }
    }
}

impl Sample {
    /// Looks at points of a file.
    pub fn add(&mut self, file: usize, coordinates: &Coordinates, columns: &Columns) {
        let bits = self.bits;
        let keys = (0..coordinates.len()).into_par_iter().filter_map(|i| {
            let place = coordinates.get(i)?;
            // To the nearest millimetre, without the call that rounding is.
            let [x, y, z] =
                (place * 1000.0).to_array().map(|v| (v + 0.5_f64.copysign(v)) as i64 as u64);
            let echo = u64::from(*columns.return_number.get(i)?) << 16
                | u64::from(*columns.intensity.get(i)?);
            let key = mix(mix(mix(mix(x) ^ y) ^ z) ^ echo);
            Some(key).filter(|key| key.trailing_zeros() >= bits)
        });
        let keys: Vec<u64> = keys.collect();
        for key in keys {
            if key.trailing_zeros() < self.bits {
                continue;
            }
            let points = 1 << self.bits;
            *self.looked.entry(file).or_default() += points;
            if let Some(first) = self.first.get(&key) {
                let [times, all] = self.alike.entry((*first, file)).or_default();
                (*times, *all) = (*times + 1, *all + points);
            } else {
                self.first.insert(key, file);
            }
            if self.first.len() > MOST {
                self.bits += 1;
                self.first.retain(|key, _| key.trailing_zeros() >= self.bits);
            }
        }
    }

    /// Tells which files hold points again.
    pub fn tell(&self, paths: &[PathBuf], warnings: &mut Vec<String>) {
        for ((first, second), [times, all]) in &self.alike {
            let looked = self.looked.get(second).copied().unwrap_or_default().max(1);
            let share = *all as f64 / looked as f64;
            if let (Some(first), Some(second)) = (paths.get(*first), paths.get(*second))
                && *times >= LEAST
                && share >= LEAST_SHARE
            {
                let (name, percent) = (second.display(), 100.0 * share);
                warnings.push(if first == second {
                    format!(
                        "{name}: about {percent:.0} % of the points come a second time and count \
                         twice: remove them, e.g. with lasduplicate"
                    )
                } else {
                    format!(
                        "{name}: about {percent:.0} % of the points are also in {} and count twice: \
                         give files that do not overlap",
                        first.display()
                    )
                });
            }
        }
    }
}
