//! Flat morphological opening with a disk.
//!
//! The disk is taken as the regular octagon about it: the Minkowski sum of a horizontal, a
//! vertical and two diagonal lines (Adams 1993), so a window costs four line filters whatever its
//! radius. A line filter of half-length h is built from steps that triple the length: if f holds
//! the minimum over [-h, h], the minimum of f at -s, 0, +s holds it over [-h-s, h+s] for every
//! s <= 2h + 1. That is log3 of the length in whole-row passes that vectorise, and needs no
//! per-line state as van Herk's filter does.
//!
//! Cells outside the grid take no part.

use rayon::prelude::*;

/// Cells that one thread takes at a time, at least: fewer are done sooner than handed out.
const LEAST_CELLS: usize = 1 << 13;

/// A single-channel image, row-major.
#[derive(Clone)]
pub struct Image {
    pub cols: usize,
    pub rows: usize,
    pub data: Vec<f32>,
}

/// Opening (erosion, then dilation) with a disk of `radius` cells.
pub fn open_disk(image: &Image, radius: usize) -> Image {
    let eroded = filter_disk(image.clone(), radius, |a, b| if b < a { b } else { a });
    filter_disk(eroded, radius, |a, b| if b > a { b } else { a })
}

fn filter_disk(
    mut image: Image,
    radius: usize,
    pick: impl Fn(f32, f32) -> f32 + Sync + Copy,
) -> Image {
    // Along an axis the octagon reaches axis + 2·diagonal, across a corner √2 (axis + diagonal).
    let diagonal = (radius as f32 * 0.293).round() as usize;
    let axis = radius.saturating_sub(2 * diagonal);
    let mut buffer = image.data.clone();
    for (direction, half) in
        [([1, 0], axis), ([0, 1], axis), ([1, 1], diagonal), ([-1, 1], diagonal)]
    {
        filter_line(&mut image, &mut buffer, direction, half, pick);
    }
    image
}

fn filter_line(
    image: &mut Image,
    buffer: &mut Vec<f32>,
    [dx, dy]: [isize; 2],
    half: usize,
    pick: impl Fn(f32, f32) -> f32 + Sync + Copy,
) {
    let (cols, rows) = (image.cols, image.rows);
    let mut reached = 0;
    while reached < half {
        let step = (2 * reached + 1).min(half - reached);
        reached += step;
        let source = &image.data;
        let lines = buffer.par_chunks_mut(cols).enumerate();
        lines.with_min_len(LEAST_CELLS / cols + 1).for_each(|(row, out)| {
            out.copy_from_slice(&source[row * cols..(row + 1) * cols]);
            for sign in [-1, 1] {
                let other = row as isize + sign * dy * step as isize;
                if other < 0 || other >= rows as isize {
                    continue;
                }
                let other = &source[other as usize * cols..(other as usize + 1) * cols];
                let shift = sign * dx * step as isize;
                let skip = shift.unsigned_abs().min(cols);
                let (to, from) = if shift >= 0 {
                    (&mut out[..cols - skip], &other[skip..])
                } else {
                    (&mut out[skip..], &other[..cols - skip])
                };
                for (a, b) in to.iter_mut().zip(from) {
                    *a = pick(*a, *b);
                }
            }
        });
        std::mem::swap(&mut image.data, buffer);
    }
}
