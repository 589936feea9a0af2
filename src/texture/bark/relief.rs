//! What follows from a height field that tiles: its normals, and how open each place is.

use rayon::prelude::*;

use super::Texel;
use crate::raster::Picture;

/// Share of the texels that may lie beyond either end of the scale.
const OUTLIERS: f32 = 0.002;

/// Heights as 0…1, all but the outermost on a linear scale.
pub fn spread(texels: &mut [Texel]) -> Vec<f32> {
    let mut sorted: Vec<f32> = texels.iter().map(|t| t.height).collect();
    sorted.par_sort_unstable_by(f32::total_cmp);
    let last = sorted.len().saturating_sub(1);
    let at = |share: f32| sorted.get((last as f32 * share) as usize).copied().unwrap_or(0.0);
    let (low, high) = (at(OUTLIERS), at(1.0 - OUTLIERS));
    let span = (high - low).max(1e-6);
    texels.iter().map(|t| ((t.height - low) / span).clamp(0.0, 1.0)).collect()
}

/// The normals of a tiling height field `n` texels wide; `relief` is the height of 1 in tile widths.
pub fn normal_map(height: &[f32], n: usize, relief: f32) -> Picture {
    let rows = height.len() / n.max(1);
    let mut picture = Picture::filled(n as u32, rows as u32, [128, 128, 255, 255]);
    if rows == 0 || height.len() != rows * n {
        return picture;
    }
    // Central differences over two texels of 1 / n.
    let slope = relief * n as f32 * 0.5;
    picture.data.par_chunks_mut(n).enumerate().for_each(|(y, row)| {
        let (above, below) = ((y + rows - 1) % rows * n, (y + 1) % rows * n);
        for (x, pixel) in row.iter_mut().enumerate() {
            let (left, right) = ((x + n - 1) % n, (x + 1) % n);
            let dx = (height[y * n + right] - height[y * n + left]) * slope;
            let dy = (height[above + x] - height[below + x]) * slope;
            let length = (dx * dx + dy * dy + 1.0).sqrt();
            let byte = |c: f32| (127.5 + 127.5 * c / length).round().clamp(0.0, 255.0) as u8;
            *pixel = [byte(-dx), byte(-dy), byte(1.0), 255];
        }
    });
    picture
}

/// Share of the sky that each place sees, 0…1: how far it lies below the mean of its surroundings,
/// at three distances. `relief` is the height of 1 in tile widths.
pub fn occlusion(height: &[f32], n: usize, relief: f32) -> Vec<f32> {
    /// Radii in tile widths.
    const AROUND: [f32; 3] = [0.004, 0.012, 0.04];
    let mut shut = vec![0.0f32; height.len()];
    for radius in AROUND {
        let reach = ((radius * n as f32).round() as usize).clamp(1, n / 2);
        // Twice a box is nearly a cone.
        let mean = blurred(&blurred(height, n, reach), n, reach);
        let steep = 1.1 * relief / radius;
        shut.par_iter_mut().zip(height).zip(&mean).for_each(|((s, h), m)| {
            *s += (steep * (m - h)).max(0.0);
        });
    }
    shut.par_iter().map(|s| (-s).exp()).collect()
}

/// Mean over a square of 2 `reach` + 1 texels, across the edges.
fn blurred(field: &[f32], n: usize, reach: usize) -> Vec<f32> {
    let rows = |field: &[f32]| -> Vec<f32> {
        let mut out = vec![0.0f32; field.len()];
        let one = 1.0 / (2 * reach + 1) as f32;
        out.par_chunks_mut(n).zip(field.par_chunks(n)).for_each(|(out, row)| {
            let mut sum: f64 =
                (0..2 * reach + 1).map(|k| f64::from(row[(n + k - reach) % n])).sum();
            for (x, o) in out.iter_mut().enumerate() {
                *o = sum as f32 * one;
                sum += f64::from(row[(x + reach + 1) % n]) - f64::from(row[(x + n - reach) % n]);
            }
        });
        out
    };
    let turned = |field: &[f32]| -> Vec<f32> {
        (0..n * n).into_par_iter().map(|i| field[i % n * n + i / n]).collect()
    };
    turned(&rows(&turned(&rows(field))))
}
