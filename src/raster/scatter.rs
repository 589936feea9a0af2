//! The least or greatest of the values that fall on each cell, and whether any does, on all threads. The
//! outcome does not depend on their number or order.

use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering::Relaxed};

use rayon::prelude::*;

/// A number that sorts as the float does; NaN above all or below all.
fn rank(v: f32) -> u32 {
    let bits = v.to_bits();
    if bits >> 31 == 1 { !bits } else { bits | 1 << 31 }
}

fn value(rank: u32) -> f32 {
    f32::from_bits(if rank >> 31 == 1 { rank & !(1 << 31) } else { !rank })
}

/// The greatest value of each cell, `none` where there is none greater. Cells past the last count
/// for nothing.
pub fn greatest(
    cells: usize,
    none: f32,
    values: impl ParallelIterator<Item = (usize, f32)>,
) -> Vec<f32> {
    let ranks: Vec<AtomicU32> =
        rayon::iter::repeat_n(rank(none), cells).map(AtomicU32::new).collect();
    values.for_each(|(cell, v)| {
        if let Some(held) = ranks.get(cell)
            && held.load(Relaxed) < rank(v)
        {
            held.fetch_max(rank(v), Relaxed);
        }
    });
    ranks.into_par_iter().map(|r| value(r.into_inner())).collect()
}

/// The least value of each cell; infinite where there is none.
pub fn least(cells: usize, values: impl ParallelIterator<Item = (usize, f32)>) -> Vec<f32> {
    let mut greatest = greatest(cells, f32::NEG_INFINITY, values.map(|(cell, v)| (cell, -v)));
    greatest.par_iter_mut().for_each(|v| *v = -*v);
    greatest
}

/// The number of the least value of each cell, of equal ones the first; `None` where there is
/// none.
pub fn least_number(
    cells: usize,
    values: impl ParallelIterator<Item = (u32, usize, f32)>,
) -> Vec<Option<u32>> {
    let keys: Vec<AtomicU64> = rayon::iter::repeat_n(u64::MAX, cells).map(AtomicU64::new).collect();
    values.for_each(|(number, cell, v)| {
        let key = u64::from(rank(v)) << 32 | u64::from(number);
        if let Some(held) = keys.get(cell)
            && held.load(Relaxed) > key
        {
            held.fetch_min(key, Relaxed);
        }
    });
    let number =
        |key: AtomicU64| Some(key.into_inner()).filter(|k| *k < u64::MAX).map(|k| k as u32);
    keys.into_par_iter().map(number).collect()
}

/// How many cells something falls on. Cells past the last count for nothing.
pub fn filled(cells: usize, places: impl ParallelIterator<Item = usize>) -> usize {
    let is_filled: Vec<AtomicBool> =
        rayon::iter::repeat_n(false, cells).map(AtomicBool::new).collect();
    places.for_each(|cell| {
        if let Some(is_filled) = is_filled.get(cell)
            && !is_filled.load(Relaxed)
        {
            is_filled.store(true, Relaxed);
        }
    });
    is_filled.into_par_iter().filter(|filled| filled.load(Relaxed)).count()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranks_sort_as_floats_and_come_back() {
        let v = [f32::NEG_INFINITY, -3.5, -1e-30, -0.0, 0.0, 1e-30, 2.0, f32::INFINITY];
        for (a, b) in v.iter().zip(&v[1..]) {
            assert!(rank(*a) < rank(*b), "{a} {b}");
        }
        assert!(v.iter().all(|v| value(rank(*v)).to_bits() == v.to_bits()));
    }

    #[test]
    fn filled_cells_count_once() {
        assert_eq!(filled(4, [3, 0, 3, 9, 0].into_par_iter()), 2);
        assert_eq!(filled(0, [0].into_par_iter()), 0);
    }

    #[test]
    fn each_cell_keeps_its_extremes() {
        let values = [(0, 2.0), (2, -4.0), (0, -1.0), (2, -4.0), (9, 1.0)];
        let all = || values.into_par_iter();
        assert_eq!(greatest(3, -9.0, all()), [2.0, -9.0, -4.0]);
        assert_eq!(least(3, all()), [-1.0, f32::INFINITY, -4.0]);
        let numbered = (0..).zip(values).map(|(i, (cell, v))| (i, cell, v)).take(5);
        let numbered: Vec<(u32, usize, f32)> = numbered.collect();
        assert_eq!(least_number(3, numbered.into_par_iter()), [Some(2), None, Some(1)]);
    }
}
