//! The way of a ray through the graph: which cells that hold something it passes, in its order.
//!
//! A ray steps from column to column (Amanatides & Woo 1987), of 16 × 16 voxels; where it stays above
//! what is in them for long, by 64 × 64. In a column that it comes under it steps over columns of
//! bricks, of 4 × 4 voxels, by how high each of them reaches, and looks into the graph only where it comes
//! under that: a node's mask tells which bricks are on its way there. There is progress wherever the ray
//! runs: along an axis, on a face, through a corner. All in f64.

use super::Landscape;
use super::blocks::{BLOCK, Blocks, Reaches};
use super::dag::{BITS, Dag, Ref, SIDE, slot};
use super::trace::{Hit, Ray};

/// A ray as cells see it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Way {
    pub o: [f64; 3],
    /// No part is 0.
    pub d: [f64; 3],
    pub inverse: [f64; 3],
    breadth: [f32; 2],
}

/// A direction's part below this is taken as this.
pub(super) const LEAST: f64 = 1e-12;

/// The lesser; in one instruction, as it cares for no NaN.
#[inline(always)]
pub(super) fn lesser(a: f64, b: f64) -> f64 {
    if a < b { a } else { b }
}

#[inline(always)]
pub(super) fn greater(a: f64, b: f64) -> f64 {
    if a > b { a } else { b }
}

impl Way {
    #[inline(always)]
    pub fn new(ray: &Ray) -> Way {
        let part = |d: f64| if d.abs() < LEAST { LEAST } else { d };
        let d = [part(ray.direction.x), part(ray.direction.y), part(ray.direction.z)];
        let inverse = [1.0 / d[0], 1.0 / d[1], 1.0 / d[2]];
        Way { o: ray.origin.to_array(), d, inverse, breadth: ray.breadth }
    }

    /// Of a ray of which the rest is known.
    #[inline(always)]
    pub fn of(ray: &Ray, d: [f64; 3], inverse: [f64; 3]) -> Way {
        Way { o: ray.origin.to_array(), d, inverse, breadth: ray.breadth }
    }

    /// Voxels that the ray is broad.
    #[inline(always)]
    pub fn breadth(&self, t: f32) -> f32 {
        self.breadth[0] + self.breadth[1] * t
    }

    /// Whether it is nearer to level than to upright. Such a ray passes many columns; and what is
    /// broader than it is shows less from the side than in outlines seen from above.
    #[inline(always)]
    fn slants(&self) -> bool {
        let [x, y, z] = self.d;
        z * z < x * x + y * y
    }

    /// The largest power of two that is no broader than the ray.
    #[inline(always)]
    fn fine(&self, t: f32) -> i32 {
        (self.breadth(t).to_bits() >> 23) as i32 - 127
    }
}

/// A child of a node on a ray's way.
pub(super) struct Cell {
    pub low: [u32; 3],
    /// Its side is 2^bits voxels.
    pub bits: u32,
    pub child: Ref,
    /// Children of the node, and which this is.
    pub around: (u64, u32),
    /// Where the ray enters and leaves it.
    pub span: [f64; 2],
    /// The ray is 2^fine voxels broad.
    pub fine: i32,
}

/// The whole number below 0 ≤ `v` < 2¹⁷, by the bits of 2¹⁷ + `v`.
#[inline(always)]
pub(super) fn whole(v: f64) -> u32 {
    ((greater(v, 0.0) + 131_072.0).to_bits() >> 35) as u32 & 0x1_ffff
}

/// Where, along an axis, a ray that is at `t` is among cells of a side, and where it leaves its cell.
#[inline(always)]
fn among(way: &Way, axis: usize, t: f64, side: f64, last: u32) -> (u32, f64) {
    let Way { o, d, inverse, .. } = way;
    let number = whole((o[axis] + d[axis] * t) * (1.0 / side)).min(last);
    let face = f64::from((number + u32::from(d[axis] > 0.0)) as i32) * side;
    (number, (face - o[axis]) * inverse[axis])
}

/// Columns of the children of blocks on a ray's way.
pub(super) struct Columns {
    /// The column's number; see [`Blocks::place`].
    pub place: usize,
    /// Where the ray leaves the column across x and across y.
    pub x: f64,
    pub y: f64,
}

impl Columns {
    #[inline(always)]
    fn new(blocks: &Blocks, way: &Way, t: f64) -> Columns {
        let side = f64::from(COARSE);
        let (col, x) = among(way, 0, t, side, blocks.sides[0] * SIDE - 1);
        let (row, y) = among(way, 1, t, side, blocks.sides[1] * SIDE - 1);
        Columns { place: blocks.place([col, row]), x, y }
    }
}

/// From where to where, of a ray from `t` to `out`, it is under a height of so many bricks.
#[inline(always)]
fn under<const RISES: bool>(way: &Way, bricks: i16, t: f64, out: f64) -> Option<[f64; 2]> {
    let top = f64::from(i32::from(bricks) * SIDE as i32);
    let passes = (top - way.o[2]) * way.inverse[2];
    let span = if RISES { [t, lesser(out, passes)] } else { [greater(t, passes), out] };
    (span[0] <= span[1]).then_some(span)
}

/// Side of a block's children in voxels, and of theirs.
pub(super) const COARSE: u32 = 1 << (2 * BITS);

/// Columns that a ray passes over before it looks whether it passes over a whole block.
const PATIENCE: u32 = 8;

/// Where a ray begins and ends, and the column it begins in.
pub(super) struct Begin {
    pub span: [f64; 2],
    pub columns: Columns,
}

impl Begin {
    /// Between `from` and `to`, if it comes under anything there.
    #[inline(always)]
    pub fn new(blocks: &Blocks, way: &Way, [from, to]: [f64; 2]) -> Option<Begin> {
        let span = if way.d[2] > 0.0 {
            under::<true>(way, blocks.top, from, to)?
        } else {
            under::<false>(way, blocks.top, from, to)?
        };
        Some(Begin { span, columns: Columns::new(blocks, way, span[0]) })
    }
}

/// Takes a ray from cell to cell until `meet` has something to give.
#[inline(always)]
pub(super) fn walk(
    scene: &Landscape,
    way: &Way,
    begin: Begin,
    meet: impl FnMut(&Cell) -> Option<Hit>,
) -> Option<Hit> {
    // Two ways, so that neither asks at every step.
    if way.d[2] > 0.0 {
        walk_to::<true>(scene, way, begin, meet)
    } else {
        walk_to::<false>(scene, way, begin, meet)
    }
}

/// As [`walk`] where it rises, or where it falls.
#[inline(always)]
fn walk_to<const RISES: bool>(
    scene: &Landscape,
    way: &Way,
    Begin { span: [mut t, end], mut columns }: Begin,
    mut meet: impl FnMut(&Cell) -> Option<Hit>,
) -> Option<Hit> {
    let (blocks, dag) = (&scene.blocks, &scene.dag);
    let Way { d, inverse, .. } = way;
    let side = f64::from(COARSE);
    let (step_x, step_y) = (side * inverse[0].abs(), side * inverse[1].abs());
    let one = |axis: usize| if d[axis] > 0.0 { 1 } else { usize::MAX };
    let (next_x, next_y) = (one(0), one(1).wrapping_mul(blocks.row()));
    let mut passed = 0;
    loop {
        let Columns { place, x, y } = columns;
        let out = greater(lesser(lesser(x, y), end), t);
        if let Some(span) = under::<RISES>(way, blocks.over(place), t, out) {
            passed = 0;
            if let Some(hit) = Column::of(blocks, place).pass::<RISES>(dag, way, span, &mut meet) {
                return Some(hit);
            }
        } else {
            passed += 1;
        }
        t = out;
        if t >= end {
            return None;
        }
        // Without a branch, as none could be foreseen.
        let is_x = u64::from(x <= y).wrapping_neg();
        columns.x = x + f64::from_bits(step_x.to_bits() & is_x);
        columns.y = y + f64::from_bits(step_y.to_bits() & !is_x);
        columns.place = place.wrapping_add(next_y ^ ((next_x ^ next_y) & is_x as usize));
        if passed >= PATIENCE {
            let far = over_blocks::<RISES>(blocks, way, t, end);
            if far > t {
                t = far;
                columns = Columns::new(blocks, way, t);
            }
            passed = 0;
        }
    }
}

/// How far a ray that is at `t` passes over whole blocks.
#[inline(never)]
fn over_blocks<const RISES: bool>(blocks: &Blocks, way: &Way, mut t: f64, end: f64) -> f64 {
    loop {
        let side = f64::from(BLOCK);
        let (x, next_x) = among(way, 0, t, side, blocks.sides[0] - 1);
        let (y, next_y) = among(way, 1, t, side, blocks.sides[1] - 1);
        let out = lesser(lesser(next_x, next_y), end);
        if out <= t || under::<RISES>(way, blocks.highest([x, y]), t, out).is_some() {
            return t;
        }
        t = out;
    }
}

/// A column of the children of blocks.
pub(super) struct Column<'a> {
    /// Its place among the others.
    at: [u32; 2],
    /// The blocks it is in.
    stack: &'a [u32],
    /// Bricks up to which anything reaches, by column of bricks of these.
    reaches: &'a Reaches,
}

/// A child of a block.
#[derive(Clone, Copy)]
struct Node {
    child: Ref,
    around: (u64, u32),
    /// Which of its children there are.
    mask: u64,
}

impl<'a> Column<'a> {
    /// The column with a number that [`Blocks::place`] gives.
    #[inline(always)]
    fn of(blocks: &'a Blocks, place: usize) -> Column<'a> {
        Column::at(blocks, blocks.at(place))
    }

    #[inline(always)]
    pub fn at(blocks: &'a Blocks, at: [u32; 2]) -> Column<'a> {
        let (stack, reaches) = blocks.stack(at.map(|i| i / SIDE));
        Column { at, stack, reaches }
    }

    /// The child of a block that is so many of them above the floor.
    #[inline(always)]
    fn node(&self, dag: &Dag, layer: u32) -> Option<Node> {
        let block = self.stack.get((layer / SIDE) as usize).copied().filter(|block| *block != 0)?;
        let block = Ref(block).index();
        let (mask, number) = (dag.mask(block), slot(self.at[0], self.at[1], layer));
        if mask >> number & 1 == 0 {
            return None;
        }
        let child = dag.nth(block, mask, number);
        Some(Node { child, around: (mask, number), mask: dag.mask(child.index()) })
    }

    /// Takes a ray through it.
    #[inline(always)]
    fn pass<const RISES: bool>(
        &self,
        dag: &Dag,
        way: &Way,
        span: [f64; 2],
        meet: &mut impl FnMut(&Cell) -> Option<Hit>,
    ) -> Option<Hit> {
        if way.fine(span[1] as f32) >= 2 * BITS as i32 {
            self.pass_nodes::<RISES>(dag, way, span, meet)
        } else if way.slants() && way.fine(span[0] as f32) > BITS as i32 {
            self.pass_columns::<RISES, 2>(dag, way, span, meet)
        } else {
            self.pass_columns::<RISES, 1>(dag, way, span, meet)
        }
    }

    /// Bricks up to which anything reaches in a column of `N` × `N` bricks.
    #[inline(always)]
    fn top<const N: u32>(&self, [col, row]: [u32; 2]) -> i16 {
        let of = |x: u32, y: u32| self.reaches[Blocks::slot([col * N + x, row * N + y])];
        match N {
            1 => of(0, 0),
            _ => of(0, 0).max(of(1, 0)).max(of(0, 1)).max(of(1, 1)),
        }
    }

    /// Takes a ray over its columns of `N` × `N` bricks.
    #[inline(always)]
    fn pass_columns<const RISES: bool, const N: u32>(
        &self,
        dag: &Dag,
        way: &Way,
        [mut t, out]: [f64; 2],
        meet: &mut impl FnMut(&Cell) -> Option<Hit>,
    ) -> Option<Hit> {
        let Way { o, d, inverse, .. } = way;
        let (side, across) = (f64::from(SIDE * N), SIDE / N);
        let among = |a: usize| {
            let first = self.at[a] * across;
            let number = whole((o[a] + d[a] * t) * (1.0 / side)).clamp(first, first + across - 1);
            let face = f64::from((number + u32::from(d[a] > 0.0)) as i32) * side;
            (number, (face - o[a]) * inverse[a])
        };
        let ((mut col, mut x), (mut row, mut y)) = (among(0), among(1));
        let one = |axis: usize| if d[axis] > 0.0 { 1 } else { u32::MAX };
        loop {
            let leave = greater(lesser(lesser(x, y), out), t);
            let top = self.top::<N>([col, row]);
            if let Some(span) = under::<RISES>(way, top, t, leave)
                && let Some(hit) =
                    self.pass_bricks::<RISES, N>(dag, way, ([col, row], top), span, meet)
            {
                return Some(hit);
            }
            if leave >= out {
                return None;
            }
            t = leave;
            if x <= y {
                x += side * inverse[0].abs();
                col = col.wrapping_add(one(0));
            } else {
                y += side * inverse[1].abs();
                row = row.wrapping_add(one(1));
            }
            if [col / across, row / across] != self.at {
                return None;
            }
        }
    }

    /// Takes a ray through a column of `N` × `N` bricks that reaches up to `top`.
    #[inline(always)]
    fn pass_bricks<const RISES: bool, const N: u32>(
        &self,
        dag: &Dag,
        way: &Way,
        ([col, row], top): ([u32; 2], i16),
        [t, out]: [f64; 2],
        meet: &mut impl FnMut(&Cell) -> Option<Hit>,
    ) -> Option<Hit> {
        let Way { o, d, inverse, .. } = way;
        let side = f64::from(SIDE);
        let most = (i32::from(top) - 1) as u32;
        let layer = |t: f64| whole((o[2] + d[2] * t) * (1.0 / side)).min(most);
        let (mut from, to) = (layer(t), layer(out));
        let flat = slot(col * N, row * N, 0);
        // The bricks of a layer.
        let layer_mask = if N == 1 { 0x01u64 } else { 0x33 };
        loop {
            let high = from / SIDE;
            let is_last = high == to / SIDE;
            if let Some(node) = self.node(dag, high) {
                let last = if is_last {
                    to & 3
                } else if RISES {
                    3
                } else {
                    0
                };
                let (low, top) = if RISES { (from & 3, last) } else { (last, from & 3) };
                let between = (u64::MAX << (16 * low)) & (u64::MAX >> (48 - 16 * top));
                let mut left = node.mask >> flat & (layer_mask * 0x0001_0001_0001_0001) & between;
                while left != 0 {
                    let bit = if RISES { left.trailing_zeros() } else { 63 - left.leading_zeros() };
                    let met = left & layer_mask << (bit & 48);
                    left ^= met;
                    let number = flat + bit;
                    let z = high * SIDE + (bit >> 4);
                    let faces = [z + u32::from(!RISES), z + u32::from(RISES)]
                        .map(|face| (f64::from(face as i32) * side - o[2]) * inverse[2]);
                    let start = greater(t, faces[0]);
                    let cell = Cell {
                        low: [col * N, row * N, z].map(|i| i * SIDE),
                        bits: BITS,
                        child: match N {
                            1 => dag.nth(node.child.index(), node.mask, number),
                            _ => dag.flags(node.child.index(), node.mask, met << flat),
                        },
                        around: (node.mask, number),
                        span: [start, greater(start, lesser(out, faces[1]))],
                        fine: way.fine(start as f32),
                    };
                    if let Some(hit) = meet(&cell) {
                        return Some(hit);
                    }
                }
            }
            if is_last {
                return None;
            }
            from = if RISES { (high + 1) * SIDE } else { high * SIDE - 1 };
        }
    }

    /// Takes a ray through it that is, or becomes, as broad as its nodes.
    #[inline(never)]
    fn pass_nodes<const RISES: bool>(
        &self,
        dag: &Dag,
        way: &Way,
        [mut t, out]: [f64; 2],
        meet: &mut impl FnMut(&Cell) -> Option<Hit>,
    ) -> Option<Hit> {
        let Way { o, d, inverse, .. } = way;
        let side = f64::from(COARSE);
        let mut layer = whole((o[2] + d[2] * t) * (1.0 / side));
        layer = layer.min(self.stack.len() as u32 * SIDE - 1);
        while layer < self.stack.len() as u32 * SIDE {
            let face = f64::from((layer + u32::from(RISES)) as i32) * side;
            let leave = greater((face - o[2]) * inverse[2], t);
            if let Some(Node { child, around, .. }) = self.node(dag, layer) {
                let low = [self.at[0] * COARSE, self.at[1] * COARSE, layer * COARSE];
                let (span, fine) = ([t, lesser(leave, out)], way.fine(t as f32));
                let hit = if fine >= 2 * BITS as i32 {
                    meet(&Cell { low, bits: 2 * BITS, child, around, span, fine })
                } else {
                    self.pass_columns::<RISES, 2>(dag, way, span, meet)
                };
                if hit.is_some() {
                    return hit;
                }
            }
            if leave >= out {
                break;
            }
            t = leave;
            layer = if RISES { layer + 1 } else { layer.wrapping_sub(1) };
        }
        None
    }
}
