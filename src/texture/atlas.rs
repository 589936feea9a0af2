//! Where the twigs lie in a leaf picture: what a texture tells a mesh. No pixels, no triangles.

use glam::Vec2;
use serde::{Deserialize, Serialize};

/// Bands from the bottom to the top of a cell in which the reach of the leaves is known.
pub const BANDS: usize = 16;

/// One twig of the picture: a square cell. The twig starts at the middle of the bottom edge and
/// grows up.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Cell {
    /// Corner of least u, v (v = 0 at the bottom of the picture).
    pub min: Vec2,
    pub max: Vec2,
    /// Side of the square at the scale at which leaves have their true size, metres.
    pub size_m: f32,
    /// Least and greatest s of anything seen in each band; s runs 0…1 across the cell.
    pub reach: [[f32; 2]; BANDS],
    /// Opaque share of the cell's area, 0…1.
    pub coverage: f32,
}

/// A cross-section of a cell's outline.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Row {
    /// 0 at the bottom of the cell, 1 at the top.
    pub t: f32,
    /// Left and right end, left < 0.5 < right.
    pub left: f32,
    pub right: f32,
}

impl Cell {
    /// Texture coordinates of a point of the cell.
    pub fn uv(&self, s: f32, t: f32) -> Vec2 {
        self.min + (self.max - self.min) * Vec2::new(s, t)
    }

    /// An outline of `count` rows (at least 2) that encloses everything seen in the cell.
    pub fn outline(&self, count: usize) -> Vec<Row> {
        let count = count.clamp(2, BANDS);
        let seen: Vec<usize> =
            (0..BANDS).filter(|&b| self.reach[b][1] > self.reach[b][0]).collect();
        let (Some(&low), Some(&high)) = (seen.first(), seen.last()) else {
            return (0..count)
                .map(|k| Row { t: k as f32 / (count - 1) as f32, left: 0.0, right: 1.0 })
                .collect();
        };
        let (t0, t1) = (low as f32 / BANDS as f32, (high + 1) as f32 / BANDS as f32);
        let knot = |k: usize| t0 + (t1 - t0) * k as f32 / (count - 1) as f32;
        // `side` is the reach away from the middle; a chord is lifted until it clears its bands.
        let lift = |side: &dyn Fn(usize) -> f32| -> Vec<f32> {
            let at = |t: f32| side(((t * BANDS as f32) as usize).clamp(low, high));
            let mut value: Vec<f32> = (0..count).map(|k| at(knot(k)).max(0.06)).collect();
            for k in 0..count - 1 {
                let (a, b) = (knot(k), knot(k + 1));
                let mut short = 0.0f32;
                for band in low..=high {
                    for t in [band as f32, (band + 1) as f32].map(|e| e / BANDS as f32) {
                        if t >= a && t <= b {
                            let f = (t - a) / (b - a);
                            let chord = value[k] * (1.0 - f) + value[k + 1] * f;
                            short = short.max(side(band) - chord);
                        }
                    }
                }
                value[k] = (value[k] + short).min(0.5);
                value[k + 1] = (value[k + 1] + short).min(0.5);
            }
            value
        };
        let left = lift(&|b| 0.5 - self.reach[b][0]);
        let right = lift(&|b| self.reach[b][1] - 0.5);
        (0..count).map(|k| Row { t: knot(k), left: 0.5 - left[k], right: 0.5 + right[k] }).collect()
    }
}

/// The twigs of one leaf picture, never empty.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Atlas {
    cells: Vec<Cell>,
}

impl Atlas {
    /// `None` without cells.
    pub fn new(cells: Vec<Cell>) -> Option<Self> {
        (!cells.is_empty()).then_some(Atlas { cells })
    }

    /// One cell that fills the picture: for a user's own twig picture that shows `size_m` metres.
    pub fn whole(size_m: f32) -> Self {
        Atlas {
            cells: vec![Cell {
                min: Vec2::ZERO,
                max: Vec2::ONE,
                size_m,
                reach: [[0.0, 1.0]; BANDS],
                coverage: 0.5,
            }],
        }
    }

    pub fn cells(&self) -> &[Cell] {
        &self.cells
    }

    /// Ids of the cells whose scale is nearest to a card of `size_m`, by ratio; never empty.
    pub fn nearest(&self, size_m: f32) -> impl Iterator<Item = usize> + Clone {
        let off = move |c: &Cell| {
            let ratio = c.size_m.max(1e-6) / size_m.max(1e-6);
            ratio.max(ratio.recip())
        };
        let best = self.cells.iter().map(off).fold(f32::INFINITY, f32::min);
        let ids = self.cells.iter().enumerate().filter(move |(_, c)| off(c) <= best * 1.05);
        ids.map(|(i, _)| i)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_outline_encloses_what_is_seen() {
        let mut cell = Atlas::whole(0.4).cells()[0].clone();
        for (b, r) in cell.reach.iter_mut().enumerate() {
            let w = 0.45 * (1.0 - (b as f32 / 15.0 - 0.4).abs());
            *r = [0.5 - w, 0.5 + 0.8 * w];
        }
        for count in 2..=6 {
            let rows = cell.outline(count);
            assert_eq!(rows.len(), count);
            for (b, reach) in cell.reach.iter().enumerate() {
                let t = (b as f32 + 0.5) / BANDS as f32;
                let k = rows.windows(2).position(|w| t <= w[1].t).unwrap();
                let f = (t - rows[k].t) / (rows[k + 1].t - rows[k].t);
                let left = rows[k].left * (1.0 - f) + rows[k + 1].left * f;
                let right = rows[k].right * (1.0 - f) + rows[k + 1].right * f;
                assert!(left <= reach[0] + 1e-4 && right >= reach[1] - 1e-4, "{count} {b}");
            }
        }
    }

    #[test]
    fn an_empty_cell_still_has_an_outline_with_area() {
        let mut cell = Atlas::whole(0.4).cells()[0].clone();
        cell.reach = [[0.5, 0.5]; BANDS];
        assert!(cell.outline(3).iter().all(|r| r.left < 0.5 && r.right > 0.5));
    }
}
