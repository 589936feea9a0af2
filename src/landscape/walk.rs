//! The way of a ray through the graph: which cells that hold something it passes, in its order.
//!
//! A ray steps from column to column (Amanatides & Woo 1987), of 16 × 16 voxels, and goes down into
//! one only where it is lower than what is in it reaches; where it stays above for long, it steps by
//! 64 × 64. In a node only the children between the one it enters and the one it leaves can be on its
//! way: where none of them holds anything it passes without a step, else it steps until the last of
//! them is behind. There is progress wherever the ray runs: along an axis, on a face, through a corner.
//! Columns are passed in f64; in a node, places are in f32 from its corner, 1e-6 voxels fine.

use glam::Vec3A;

use super::Landscape;
use super::blocks::{BLOCK, Blocks};
use super::dag::{BITS, Dag, Ref, SIDE};
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

/// A direction among the 4³ children of a node.
#[derive(Debug, Clone, Copy)]
struct Near {
    d: Vec3A,
    inverse: Vec3A,
    /// Absolute values of `inverse`.
    step: Vec3A,
    /// 1 along axes where the ray rises, else 0.
    rises: Vec3A,
    /// What a step along an axis adds to a child's number.
    stride: [u32; 3],
}

/// Children by number whose index along x is from one to another; those along y and z follow from
/// it.
const BETWEEN: [[u64; 3]; 16] = {
    let mut table = [[0u64; 3]; 16];
    let mut pair = 0;
    while pair < 16 {
        let (a, b) = (pair as u64 & 3, pair as u64 >> 2);
        let mut number = 0;
        while number < 64 {
            let mut axis = 0;
            while axis < 3 {
                let i = number >> (2 * axis) & 3;
                let is_between = (a <= i && i <= b) || (b <= i && i <= a);
                table[pair][axis] |= (is_between as u64) << number;
                axis += 1;
            }
            number += 1;
        }
        pair += 1;
    }
    table
};

impl Near {
    #[inline(always)]
    fn new(way: &Way) -> Near {
        let single = |v: [f64; 3]| Vec3A::new(v[0] as f32, v[1] as f32, v[2] as f32);
        let (d, inverse) = (single(way.d), single(way.inverse));
        let is_rising = d.cmpgt(Vec3A::ZERO);
        let rising = is_rising.bitmask();
        // 1, or all bits for −1.
        let one = |axis: u32| ((rising >> axis & 1) << 1).wrapping_sub(1);
        Near {
            d,
            inverse,
            step: inverse.abs(),
            rises: Vec3A::select(is_rising, Vec3A::ONE, Vec3A::ZERO),
            stride: [one(0), one(1) << BITS, one(2) << (2 * BITS)],
        }
    }

    /// The children under `mask` that the ray passes from `p` over `length` of its direction's lengths,
    /// both in sides of a child, until `visit` has something to give. It is told a child's number, and
    /// from where to where the ray is within.
    #[inline(always)]
    fn pass<T>(
        &self,
        mask: u64,
        p: Vec3A,
        length: f32,
        mut visit: impl FnMut(u32, f32, f32) -> Option<T>,
    ) -> Option<T> {
        let (near, far) = (scaled(p), scaled(p + self.d * length));
        let (first, last) = (near.to_array().map(index), far.to_array().map(index));
        let x = BETWEEN[(first[0] | last[0] << 2) as usize][0];
        let y = BETWEEN[(first[1] | last[1] << 2) as usize][1];
        let z = BETWEEN[(first[2] | last[2] << 2) as usize][2];
        let mut left = mask & x & y & z;
        if left == 0 {
            return None;
        }
        let low = near.to_array().map(|v| f32::from_bits(v.to_bits() & !0x001f_ffff));
        let low = (Vec3A::from(low) - 1.0) * SIDE as f32;
        let mut next = ((low + self.rises - p) * self.inverse).to_array();
        let step = self.step.to_array();
        // No steps past the last.
        let mut steps =
            [first[0].abs_diff(last[0]), first[1].abs_diff(last[1]), first[2].abs_diff(last[2])];
        for a in 0..3 {
            next[a] = if steps[a] == 0 { f32::INFINITY } else { next[a] };
        }
        let mut number = first[0] | first[1] << 2 | first[2] << 4;
        let mut t = 0.0f32;
        loop {
            let (axis, out) = least(next);
            let bit = 1u64 << (number & 63);
            if left & bit != 0 {
                left ^= bit;
                if let Some(met) = visit(number, t, out.min(length).max(t)) {
                    return Some(met);
                }
                if left == 0 {
                    return None;
                }
            }
            if out == f32::INFINITY {
                return None;
            }
            t = t.max(out);
            number = number.wrapping_add(self.stride[axis]);
            steps[axis] -= 1;
            next[axis] = if steps[axis] == 0 { f32::INFINITY } else { out + step[axis] };
        }
    }
}

#[inline(always)]
fn least([x, y, z]: [f32; 3]) -> (usize, f32) {
    let (axis, least) = if y < x { (1, y) } else { (0, x) };
    if z < least { (2, z) } else { (axis, least) }
}

/// Numbers of 0…4 as 1…2, where the first two bits after the point are those of the whole number.
#[inline(always)]
fn scaled(p: Vec3A) -> Vec3A {
    let most = Vec3A::splat(1.999_999_9);
    (p * 0.25 + 1.0).max(Vec3A::ONE).min(most)
}

#[inline(always)]
fn index(scaled: f32) -> u32 {
    scaled.to_bits() >> 21 & 3
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
fn under(way: &Way, bricks: i16, t: f64, out: f64) -> Option<[f64; 2]> {
    let top = f64::from(i32::from(bricks) * SIDE as i32);
    let passes = (top - way.o[2]) * way.inverse[2];
    let span = if way.d[2] < 0.0 { [greater(t, passes), out] } else { [t, lesser(out, passes)] };
    (span[0] <= span[1]).then_some(span)
}

/// Side of a block's children in voxels, and of theirs.
pub(super) const COARSE: u32 = 1 << (2 * BITS);
const FINE: f32 = SIDE as f32;

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
        let span = under(way, blocks.top, from, to)?;
        Some(Begin { span, columns: Columns::new(blocks, way, span[0]) })
    }
}

/// Takes a ray from cell to cell until `meet` has something to give.
#[inline(always)]
pub(super) fn walk(
    scene: &Landscape,
    way: &Way,
    Begin { span: [mut t, end], mut columns }: Begin,
    mut meet: impl FnMut(&Cell) -> Option<Hit>,
) -> Option<Hit> {
    let (blocks, dag) = (&scene.blocks, &scene.dag);
    let Way { o, d, inverse, .. } = way;
    let near = Near::new(way);
    let side = f64::from(COARSE);
    let rises = u32::from(d[2] > 0.0);
    let (step_x, step_y) = (side * inverse[0].abs(), side * inverse[1].abs());
    let one = |axis: usize| if d[axis] > 0.0 { 1 } else { usize::MAX };
    let (next_x, next_y) = (one(0), one(1).wrapping_mul(blocks.row()));
    let mut passed = 0;
    loop {
        let Columns { place, x, y } = columns;
        let out = greater(lesser(lesser(x, y), end), t);
        if let Some([mut t, out]) = under(way, blocks.over(place), t, out) {
            passed = 0;
            let at = blocks.at(place);
            let stack = blocks.stack([at[0] / SIDE, at[1] / SIDE]);
            let flat = (at[0] & 3) | (at[1] & 3) << 2;
            let mut layer = whole((o[2] + d[2] * t) * (1.0 / side));
            layer = layer.min(stack.len() as u32 * SIDE - 1);
            while let Some(&block) = stack.get((layer / SIDE) as usize) {
                let face = f64::from((layer + rises) as i32) * side;
                let leave = greater((face - o[2]) * inverse[2], t);
                if block != 0 {
                    let block = Ref(block).index();
                    let (mask, number) = (dag.mask(block), flat | (layer & 3) << 4);
                    if mask >> number & 1 != 0 {
                        let node = Node {
                            child: dag.nth(block, mask, number),
                            around: (mask, number),
                            low: [at[0] * COARSE, at[1] * COARSE, layer * COARSE],
                        };
                        let span = [t, lesser(leave, out)];
                        if let Some(hit) = node.pass(dag, (way, &near), span, &mut meet) {
                            return Some(hit);
                        }
                    }
                }
                if leave >= out {
                    break;
                }
                t = leave;
                layer = layer.wrapping_add((rises * 2).wrapping_sub(1));
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
            let far = over_blocks(blocks, way, t, end);
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
fn over_blocks(blocks: &Blocks, way: &Way, mut t: f64, end: f64) -> f64 {
    loop {
        let side = f64::from(BLOCK);
        let (x, next_x) = among(way, 0, t, side, blocks.sides[0] - 1);
        let (y, next_y) = among(way, 1, t, side, blocks.sides[1] - 1);
        let out = lesser(lesser(next_x, next_y), end);
        if out <= t || under(way, blocks.highest([x, y]), t, out).is_some() {
            return t;
        }
        t = out;
    }
}

/// A child of a block.
struct Node {
    child: Ref,
    around: (u64, u32),
    low: [u32; 3],
}

impl Node {
    /// Takes a ray through it.
    #[inline(always)]
    fn pass(
        &self,
        dag: &Dag,
        (way, near): (&Way, &Near),
        [start, out]: [f64; 2],
        meet: &mut impl FnMut(&Cell) -> Option<Hit>,
    ) -> Option<Hit> {
        let Way { o, d, .. } = way;
        let Node { child, around, low } = *self;
        let fine = way.fine(start as f32);
        if 2 * BITS as i32 <= fine {
            return meet(&Cell { low, bits: 2 * BITS, child, around, span: [start, out], fine });
        }
        let corner = |a: usize| f64::from(low[a] as i32);
        let p = Vec3A::new(
            (o[0] + d[0] * start - corner(0)) as f32,
            (o[1] + d[1] * start - corner(1)) as f32,
            (o[2] + d[2] * start - corner(2)) as f32,
        );
        let mask = dag.mask(child.index());
        let length = (out - start) as f32 * (1.0 / FINE);
        near.pass(mask, p * (1.0 / FINE), length, |number, from, to| {
            let at = [number & 3, number >> 2 & 3, number >> 4 & 3];
            meet(&Cell {
                low: [0, 1, 2].map(|a: usize| low[a] + (at[a] << BITS)),
                bits: BITS,
                child: dag.nth(child.index(), mask, number),
                around: (mask, number),
                span: [start + f64::from(from * FINE), start + f64::from(to * FINE)],
                fine: way.fine(start as f32 + from * FINE),
            })
        })
    }
}
