//! Where the twigs lie in a leaf picture: what a texture tells a mesh. No pixels, no triangles.

use std::collections::BTreeMap;
use std::sync::{Mutex, OnceLock, PoisonError};

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
    /// Where the stalk ends in a leaf's cell, share of the side from the bottom; of a twig 0.
    pub foot: f32,
}

impl Cell {
    /// Half the width of the stem at the foot of a twig, share of the side; 0 where there is none, or leaves are.
    pub fn stem(&self) -> f32 {
        const MOST: f32 = 0.02;
        let [left, right] = self.reach[0];
        Some(0.5 * (right - left)).filter(|half| *half <= MOST).unwrap_or(0.0)
    }
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
        // Of all sets of knots between first and last band, the one that encloses least.
        let knots = |inner: &[usize]| -> Vec<usize> { [&[low], inner, &[high + 1]].concat() };
        let inner = (count - 2).min(high - low);
        let mut chosen: Vec<usize> =
            (1..=inner).map(|k| low + k * (high + 1 - low) / (inner + 1)).collect();
        let mut best = self.cut(&knots(&chosen));
        // One knot after the other: few bands, few knots.
        for _ in 0..3 {
            for k in 0..inner {
                let from = if k == 0 { low } else { chosen[k - 1] } + 1;
                let to = chosen.get(k + 1).copied().unwrap_or(high + 1);
                for band in from..to {
                    let before = std::mem::replace(&mut chosen[k], band);
                    let cut = self.cut(&knots(&chosen));
                    if area(&cut) < area(&best) - 1e-6 {
                        best = cut;
                    } else {
                        chosen[k] = before;
                    }
                }
            }
        }
        // Fewer bands than rows asked for: the last row is split.
        while best.len() < count {
            let Some(&[a, b]) = best.last_chunk::<2>() else { break };
            let half = |x: f32, y: f32| 0.5 * (x + y);
            let row = Row {
                t: half(a.t, b.t),
                left: half(a.left, b.left),
                right: half(a.right, b.right),
            };
            best.insert(best.len() - 1, row);
        }
        best
    }

    /// The least outline found with rows at these band edges.
    fn cut(&self, knots: &[usize]) -> Vec<Row> {
        let left = reaches(knots, &|b| 0.5 - self.reach[b][0]);
        let right = reaches(knots, &|b| self.reach[b][1] - 0.5);
        let row = |k: usize| Row {
            t: knots[k] as f32 / BANDS as f32,
            left: 0.5 - left[k],
            right: 0.5 + right[k],
        };
        (0..knots.len()).map(row).collect()
    }
}

/// Least reach of a row from the middle of a cell.
const LEAST_REACH: f32 = 0.02;

/// Reach at each knot, so that the lines between them clear `reach` of every band: the smallest
/// area of several tries, each from another reach at the first knot.
fn reaches(knots: &[usize], reach: &dyn Fn(usize) -> f32) -> Vec<f32> {
    const TRIES: usize = 24;
    // What one end of a stretch needs where the other is known.
    let need = |k: usize, other: f32, is_last: bool| -> f32 {
        let (from, to) = (knots[k], knots[k + 1]);
        let mut least = LEAST_REACH;
        for band in from..to {
            for edge in [band, band + 1] {
                let f = (edge - from) as f32 / (to - from) as f32;
                let own = if is_last { f } else { 1.0 - f };
                let short = reach(band) - (1.0 - own) * other;
                if short > 0.0 {
                    least = least.max(if own > 0.0 { short / own } else { f32::INFINITY });
                }
            }
        }
        least
    };
    let last = knots.len() - 1;
    let mut best = vec![0.5; knots.len()];
    let mut least = f32::INFINITY;
    for start in 0..=TRIES {
        let mut value = vec![LEAST_REACH + (0.5 - LEAST_REACH) * start as f32 / TRIES as f32];
        for k in 0..last {
            // Never less than its own bands: a low knot here would be a high one there.
            let own =
                reach(knots[k + 1] - 1).max(if k + 1 < last { reach(knots[k + 1]) } else { 0.0 });
            value.push(need(k, value[k], true).max(own));
        }
        for k in (0..=last).rev() {
            let before = if k > 0 { need(k - 1, value[k - 1], true) } else { LEAST_REACH };
            let after = if k < last { need(k, value[k + 1], false) } else { LEAST_REACH };
            value[k] = before.max(after);
        }
        let width = |k: usize| (knots[k + 1] - knots[k]) as f32;
        let sum: f32 = (0..last).map(|k| width(k) * (value[k] + value[k + 1])).sum();
        if sum < least && value.iter().all(|v| *v <= 0.5) {
            (best, least) = (value, sum);
        }
    }
    best
}

/// Share of its cell that an outline encloses.
fn area(rows: &[Row]) -> f32 {
    let width = |r: &Row| r.right - r.left;
    rows.windows(2).map(|w| 0.5 * (w[1].t - w[0].t) * (width(&w[0]) + width(&w[1]))).sum()
}

/// What follows from cells, and tells no two atlases apart. It is found when first asked for: trees by
/// the hundred share one picture.
#[derive(Debug, Default)]
struct Found<T>(T);

impl<T: Default> Clone for Found<T> {
    fn clone(&self) -> Self {
        Found::default()
    }
}

impl<T> PartialEq for Found<T> {
    fn eq(&self, _: &Self) -> bool {
        true
    }
}

/// Outlines of some cells by the number of rows.
type Outlines = Found<[OnceLock<Vec<Vec<Row>>>; BANDS + 1]>;

impl Outlines {
    fn of(&self, cells: &[Cell], count: usize) -> &[Vec<Row>] {
        let count = count.clamp(2, BANDS);
        self.0[count].get_or_init(|| cells.iter().map(|c| c.outline(count)).collect())
    }
}

/// What twigs of these leaves hide, by their measures.
type Hidden = Found<Mutex<BTreeMap<[u32; 4], f32>>>;

/// The twigs of one leaf picture, never empty.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Atlas {
    cells: Vec<Cell>,
    leaves: Vec<Cell>,
    /// Twigs of dry branches beside those in leaf, where there are.
    dry: Vec<Cell>,
    wood: Vec2,
    fill: Vec2,
    /// Without a picture.
    #[serde(skip)]
    is_plain: bool,
    /// The last of the cells again, darker.
    shade: Option<Cell>,
    #[serde(skip)]
    outlines: Outlines,
    #[serde(skip)]
    leaf_outlines: Outlines,
    #[serde(skip)]
    hidden_sq_m: Hidden,
}

impl Atlas {
    /// `leaves`: cells of single leaves or needles, that grow up like twigs; `plain`: places in
    /// the middle of plain bark and of the leaves' mean colour. `None` without cells of both.
    pub fn new(cells: Vec<Cell>, leaves: Vec<Cell>, plain: [Vec2; 2]) -> Option<Self> {
        let has_both = !cells.is_empty() && !leaves.is_empty();
        let [wood, fill] = plain;
        has_both.then(|| Atlas::with(cells, leaves, wood, fill))
    }

    /// One cell that fills the picture, which shows `size_m` metres.
    pub fn whole(size_m: f32) -> Self {
        let reach = [[0.0, 1.0]; BANDS];
        Atlas::of_one(Cell {
            min: Vec2::ZERO,
            max: Vec2::ONE,
            size_m,
            reach,
            coverage: 0.5,
            foot: 0.0,
        })
    }

    /// One cell, for twig and leaf.
    pub fn of_one(cell: Cell) -> Self {
        let middle = Vec2::splat(0.5);
        Atlas::with(vec![cell.clone()], vec![cell], middle, middle)
    }

    fn with(cells: Vec<Cell>, leaves: Vec<Cell>, wood: Vec2, fill: Vec2) -> Self {
        let [outlines, leaf_outlines] = Default::default();
        let (dry, is_plain, shade, hidden_sq_m) = (Vec::new(), false, None, Hidden::default());
        Atlas {
            cells,
            leaves,
            dry,
            wood,
            fill,
            is_plain,
            shade,
            outlines,
            leaf_outlines,
            hidden_sq_m,
        }
    }

    /// With twigs of dry branches in the same picture.
    pub fn with_dry(self, dry: Vec<Cell>) -> Self {
        Atlas { dry, ..self }
    }

    /// With the last of its cells again in shade, of the same form.
    pub fn with_shade(self, shade: Option<Cell>) -> Self {
        Atlas { shade, ..self }
    }

    /// A cell as it is in shade, if that is in the picture.
    pub fn shade(&self, id: usize) -> Option<&Cell> {
        self.shade.as_ref().filter(|_| id + 1 == self.cells.len())
    }

    /// That of dry branches; `None` where the picture shows no twigs of theirs.
    pub fn dry(&self) -> Option<Atlas> {
        let of = |cells| Atlas::with(cells, self.leaves.clone(), self.wood, self.fill);
        (!self.dry.is_empty()).then(|| of(self.dry.clone()))
    }

    /// Of no picture: cards are of one colour all over, `size_m` along, and single leaves have their outline.
    pub fn plain(size_m: f32, leaf: Cell) -> Self {
        Atlas { is_plain: true, ..Atlas::whole(size_m).with_leaf(leaf) }
    }

    pub fn is_plain(&self) -> bool {
        self.is_plain
    }

    /// With a cell of its own for single leaves.
    fn with_leaf(self, leaf: Cell) -> Self {
        let (leaf_outlines, hidden_sq_m) = Default::default();
        Atlas { leaves: vec![leaf], leaf_outlines, hidden_sq_m, ..self }
    }

    /// With the mean colour of the leaves at `fill`.
    pub fn filled_at(self, fill: Vec2) -> Self {
        Atlas { fill, ..self }
    }

    pub fn leaves(&self) -> &[Cell] {
        &self.leaves
    }

    /// [`Cell::outline`] of each of [`Atlas::leaves`].
    pub fn leaf_outlines(&self, count: usize) -> &[Vec<Row>] {
        self.leaf_outlines.of(&self.leaves, count)
    }

    /// Texture coordinates of plain bark.
    pub fn wood(&self) -> Vec2 {
        self.wood
    }

    /// Texture coordinates of the leaves' mean colour, opaque around.
    pub fn fill(&self) -> Vec2 {
        self.fill
    }

    pub fn cells(&self) -> &[Cell] {
        &self.cells
    }

    /// [`Cell::outline`] of each of [`Atlas::cells`].
    pub fn outlines(&self, count: usize) -> &[Vec<Row>] {
        self.outlines.of(&self.cells, count)
    }

    /// What a twig of such measures hides, as `measure` finds the first time.
    pub fn hidden_sq_m(&self, twig: [f32; 4], measure: impl FnOnce() -> f32) -> f32 {
        let twig = twig.map(f32::to_bits);
        let found = || self.hidden_sq_m.0.lock().unwrap_or_else(PoisonError::into_inner);
        let known = found().get(&twig).copied();
        known.unwrap_or_else(|| {
            let hidden_sq_m = measure();
            found().insert(twig, hidden_sq_m);
            hidden_sq_m
        })
    }

    /// How many scales its cells have.
    pub fn scales(&self) -> usize {
        let is_new =
            |(k, c): &(usize, &Cell)| self.cells[..*k].iter().all(|b| b.size_m != c.size_m);
        self.cells.iter().enumerate().filter(is_new).count()
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

    /// A disc: the least trapezoid of two rows is its square, three rows cut the corners, and
    /// more rows never enclose more.
    #[test]
    fn more_rows_enclose_less() {
        let mut cell = Atlas::whole(0.4).cells()[0].clone();
        for (b, r) in cell.reach.iter_mut().enumerate() {
            let from_middle = |edge: usize| (edge as f32 / BANDS as f32 - 0.5).abs();
            let nearest = if b < BANDS / 2 { from_middle(b + 1) } else { from_middle(b) };
            let half = (0.25 - nearest * nearest).max(0.0).sqrt();
            *r = [0.5 - half, 0.5 + half];
        }
        let areas: Vec<f32> = (2..=5).map(|count| area(&cell.outline(count))).collect();
        assert!(areas.windows(2).all(|w| w[1] <= w[0] + 1e-6), "{areas:?}");
        assert!(areas[0] > 0.99 && areas[1] < 0.95 && areas[3] < 0.935, "{areas:?}");
    }

    #[test]
    fn outlines_that_are_kept_are_those_of_the_cells() {
        let atlas = Atlas::whole(0.4);
        let whole = atlas.leaf_outlines(3).to_vec();
        assert_eq!(whole, [atlas.leaves()[0].outline(3)]);
        assert_eq!(atlas.outlines(0), [atlas.cells()[0].outline(2)], "two rows at least");
        let mut leaf = atlas.leaves()[0].clone();
        leaf.reach = [[0.3, 0.6]; BANDS];
        let other = atlas.with_leaf(leaf.clone());
        assert_eq!(other.leaf_outlines(3), [leaf.outline(3)]);
        assert_ne!(other.leaf_outlines(3), whole);
    }

    #[test]
    fn an_empty_cell_still_has_an_outline_with_area() {
        let mut cell = Atlas::whole(0.4).cells()[0].clone();
        cell.reach = [[0.5, 0.5]; BANDS];
        assert!(cell.outline(3).iter().all(|r| r.left < 0.5 && r.right > 0.5));
    }
}
