//! Rays through the landscape (TD17: rays stepped through the voxels, the octree to skip what is
//! empty, trilinear interpolation where it is not).
//!
//! A ray steps from block to block and in them from child to child of a node (Amanatides & Woo 1987);
//! over an empty one it steps whole, into those that hold something it goes down, and comes back up to step on. A step is to
//! the next whole number along an axis, so that there is progress wherever the ray runs: along an
//! axis, on a face, through a corner. Where a voxel looks smaller than the footprint
//! of the ray (a pixel, say) the walk ends at the cell that is as large as the footprint; nearer by,
//! vegetation is where the interpolated density passes one half, and ground is the bilinear patch
//! between four heights, met exactly. Known limits: vegetation seen from afar is as wide as the
//! cells it is in, up to a footprint too wide; a hill in a single footprint may be missed.

use glam::{DVec3, Vec3};

use super::Landscape;
use super::blocks::{BLOCK, BLOCK_LEVEL};
use super::brick::Brick;
use super::dag::{BITS, Dag, Ref, SIDE};

/// A half line in voxels from the centre of the first voxel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Ray {
    pub origin: DVec3,
    pub direction: DVec3,
    /// Breadth in voxels at the origin, and by how much more a length of `direction`.
    pub breadth: [f32; 2],
}

/// A ray as cells see it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Way {
    o: [f64; 3],
    /// No part is 0.
    d: [f64; 3],
    inverse: [f64; 3],
    /// Absolute values of `inverse`.
    span: [f64; 3],
    /// What a step adds to an index: 1, or all bits for −1.
    step: [u32; 3],
}

impl Way {
    pub fn new(ray: &Ray) -> Way {
        let part = |d: f64| if d.abs() < LEAST { LEAST } else { d };
        let d = [part(ray.direction.x), part(ray.direction.y), part(ray.direction.z)];
        let step = |d: f64| if d > 0.0 { 1 } else { u32::MAX };
        let inverse = [1.0 / d[0], 1.0 / d[1], 1.0 / d[2]];
        Way {
            o: ray.origin.to_array(),
            d,
            inverse,
            span: inverse.map(f64::abs),
            step: [step(d[0]), step(d[1]), step(d[2])],
        }
    }
}

/// Where a ray is among equal cells, and where it leaves its cell across each axis.
#[derive(Debug, Clone, Copy, Default)]
struct Steps {
    child: [u32; 3],
    next: [f64; 3],
    /// Side of a cell in voxels.
    side: f64,
}

impl Steps {
    /// At `t`, among cells numbered from that at `low` to `last`.
    #[inline]
    fn new(low: [f64; 3], side: f64, last: [u32; 3], way: &Way, t: f64) -> Steps {
        let inverse = 1.0 / side;
        let mut steps = Steps { child: [0; 3], next: [0.0; 3], side };
        for a in 0..3 {
            // What is below 0 becomes 0.
            let child = ((way.o[a] + way.d[a] * t - low[a]) * inverse) as u32;
            steps.child[a] = child.min(last[a]);
            let face = f64::from(steps.child[a] + u32::from(way.step[a] == 1)) * side + low[a];
            steps.next[a] = (face - way.o[a]) * way.inverse[a];
        }
        steps
    }

    /// Into the next cell: where along the ray, and its number across the face that is passed; below
    /// 0 comes after the greatest.
    #[inline(always)]
    fn step(&mut self, way: &Way) -> (f64, u32) {
        let [x, y, z] = self.next;
        let (axis, t) = if x <= y && x <= z {
            (0, x)
        } else if y <= z {
            (1, y)
        } else {
            (2, z)
        };
        self.next[axis] = t + self.side * way.span[axis];
        self.child[axis] = self.child[axis].wrapping_add(way.step[axis]);
        (t, self.child[axis])
    }
}

/// A node on a ray's way, and where among its children the ray is.
#[derive(Debug, Clone, Copy, Default)]
struct Stage {
    node: usize,
    mask: u64,
    /// The node's first voxel.
    low: [u32; 3],
    steps: Steps,
}

impl Stage {
    /// Where the ray enters a node.
    #[inline]
    fn new(dag: &Dag, node: usize, low: [u32; 3], level: u32, way: &Way, t: f64) -> Stage {
        let side = f64::from(1u32 << (BITS * (level - 1)));
        let first = [f64::from(low[0]), f64::from(low[1]), f64::from(low[2])];
        let steps = Steps::new(first, side, [SIDE - 1; 3], way, t);
        Stage { node, mask: dag.mask(node), low, steps }
    }
}

/// A child of a node on a ray's way.
struct Cell {
    low: [u32; 3],
    /// Its side is 2^bits voxels.
    bits: u32,
    child: Ref,
    /// Children of the node, and which this is.
    around: (u64, u32),
    /// Where the ray enters and leaves it.
    span: [f64; 2],
    /// The ray is 2^fine voxels broad.
    fine: i32,
}

/// A part of a ray.
#[derive(Debug, Clone, Copy)]
struct Span {
    from: f64,
    to: f64,
}

/// What a ray meets.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum What {
    Ground,
    Vegetation,
    /// The earth below the surface where the scene ends, on a face across this axis.
    Cut(u8),
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Hit {
    /// How far along the ray, in lengths of its direction.
    pub t: f64,
    pub what: What,
    /// Side of the cell in which it was met, in voxels: 1, or more seen from afar.
    pub size: u32,
    /// Children of the cell's parent that hold anything, and which of them was met.
    pub around: (u64, u32),
}

const SHELF: usize = 1 << 9;

/// Rays on one thread, with the bricks that were last gathered.
pub(super) struct Tracer<'a> {
    pub scene: &'a Landscape,
    keys: Vec<u64>,
    bricks: Vec<Brick>,
}

/// A direction's part below this is taken as this.
const LEAST: f64 = 1e-12;

impl<'a> Tracer<'a> {
    pub fn new(scene: &'a Landscape) -> Tracer<'a> {
        Tracer { scene, keys: vec![u64::MAX; SHELF], bricks: vec![Brick::EMPTY; SHELF] }
    }

    /// The brick whose first voxel is at `low`.
    fn brick(&mut self, low: [u32; 3], own: Option<Ref>) -> &Brick {
        let (x, y, z) = (low[0] >> BITS, low[1] >> BITS, low[2] >> BITS);
        let key = u64::from(x) | u64::from(y) << 21 | u64::from(z) << 42;
        let place = (x ^ y << 3 ^ z << 6) as usize & (SHELF - 1);
        if self.keys[place] != key {
            self.keys[place] = key;
            self.bricks[place] = Brick::gather(&self.scene.dag, low, own);
        }
        &self.bricks[place]
    }

    /// Density of the vegetation, 0 to 1, at a place in voxels.
    pub fn density(&mut self, p: Vec3) -> f32 {
        let last = self.scene.sides.map(|side| (side as f32 - 0.001).max(0.0));
        let q = p.clamp(Vec3::ZERO, Vec3::from(last));
        let low = q.to_array().map(|v| v as u32 & !(SIDE - 1));
        let own = self.scene.dag.brick(low);
        let corner = Vec3::from(low.map(|v| v as f32));
        self.brick(low, own).density(q - corner)
    }

    /// Where a way enters the scene and where it leaves it; what it meets of the earth's cut face, or
    /// `None`, where it does not enter.
    fn enter(&self, way: &Way, from: f64, to: f64) -> Result<Span, Option<Hit>> {
        let Way { o, d, inverse, .. } = way;
        let (mut t, mut end, mut axis) = (from.max(0.0), to, None);
        for a in 0..3 {
            let (low, high) =
                (-o[a] * inverse[a], (f64::from(self.scene.sides[a]) - o[a]) * inverse[a]);
            if low.min(high) > t {
                (t, axis) = (low.min(high), Some(a));
            }
            end = end.min(low.max(high));
        }
        if t > end {
            return Err(None);
        }
        if let Some(a) = axis {
            let z = o[2] + d[2] * t;
            if z > -1e-6
                && self.scene.height(o[0] + d[0] * t, o[1] + d[1] * t).is_some_and(|h| z < h)
            {
                return Err(Some(Hit { t, what: What::Cut(a as u8), size: 1, around: (0, 0) }));
            }
        }
        Ok(Span { from: t, to: end })
    }

    /// Where a ray enters the box of the scene; 0 where it begins within.
    pub fn entry(&self, ray: &Ray) -> f64 {
        let way = Way::new(ray);
        let near = |a: usize| {
            let faces = [0.0, f64::from(self.scene.sides[a])];
            let [low, high] = faces.map(|face| (face - way.o[a]) * way.inverse[a]);
            low.min(high)
        };
        near(0).max(near(1)).max(near(2)).max(0.0)
    }

    /// The first thing that a ray meets between `from` and `to` of its direction's lengths.
    pub fn trace(&mut self, ray: &Ray, from: f64, to: f64) -> Option<Hit> {
        self.walk(ray, from, to, |tracer, way, cell| tracer.content(way, cell))
    }

    /// The greatest share of its voxels' full density that a brick on the ray's way has, before the
    /// ground.
    pub fn densest(&mut self, ray: &Ray) -> (f32, Option<Hit>) {
        // As if it were narrow everywhere, so that it comes to every brick.
        let ray = Ray { breadth: [0.0; 2], ..*ray };
        let mut most = 0.0f32;
        let hit = self.walk(&ray, 0.0, f64::INFINITY, |tracer, way, cell| {
            let dag = &tracer.scene.dag;
            if cell.child.has(Ref::VEGETATION | Ref::CELLS) {
                most = most.max(dag.fill(cell.child.index()));
            }
            let ground = cell.child.has(Ref::GROUND);
            let t = ground.then(|| tracer.ground(&way.o, &way.d, cell.low, cell.span))??;
            Some(Hit { t, what: What::Ground, size: 1, around: (0, 0) })
        });
        (most, hit)
    }

    /// Takes a ray from cell to cell until `meet` has something to give.
    #[inline]
    fn walk(
        &mut self,
        ray: &Ray,
        from: f64,
        to: f64,
        mut meet: impl FnMut(&mut Self, &Way, &Cell) -> Option<Hit>,
    ) -> Option<Hit> {
        let scene = self.scene;
        let way = Way::new(ray);
        let Span { from: start, to: end } = match self.enter(&way, from, to) {
            Ok(span) => span,
            Err(met) => return met,
        };
        let mut t = start;
        let last = scene.blocks.sides.map(|side| side - 1);
        let mut place = Steps::new([0.0; 3], f64::from(BLOCK), last, &way, t);
        loop {
            if let Some(block) = scene.blocks.at(place.child) {
                let low = place.child.map(|i| i * BLOCK);
                match self.through(block, low, &way, ray, (t, end), &mut meet) {
                    Ok(out) => t = t.max(out),
                    Err(hit) => return Some(hit),
                }
            }
            t = t.max(place.step(&way).0);
            if t >= end || !scene.blocks.holds(place.child) {
                return None;
            }
        }
    }

    /// Takes a ray through a block: what it met, or where it came out.
    #[inline]
    fn through(
        &mut self,
        block: Ref,
        low: [u32; 3],
        way: &Way,
        ray: &Ray,
        (mut t, end): (f64, f64),
        meet: &mut impl FnMut(&mut Self, &Way, &Cell) -> Option<Hit>,
    ) -> Result<f64, Hit> {
        let dag = &self.scene.dag;
        let mut level = BLOCK_LEVEL;
        let mut stack = [Stage::default(); BLOCK_LEVEL as usize + 1];
        let mut stage = Stage::new(dag, block.index(), low, level, way, t);
        loop {
            let child = stage.steps.child;
            let number = child[0] | child[1] << 2 | child[2] << 4;
            if stage.mask >> number & 1 != 0 {
                let rank = (stage.mask & ((1u64 << number) - 1)).count_ones() as usize;
                let node = Ref(dag.words[stage.node + 2 + rank]);
                let bits = BITS * (level - 1);
                let low = [
                    stage.low[0] + (child[0] << bits),
                    stage.low[1] + (child[1] << bits),
                    stage.low[2] + (child[2] << bits),
                ];
                // The largest power of two that is no broader than the ray.
                let breadth = ray.breadth[0] + ray.breadth[1] * t as f32;
                let fine = (breadth.to_bits() >> 23) as i32 - 127;
                if bits as i32 > fine && level > 2 {
                    stack[level as usize] = stage;
                    level -= 1;
                    stage = Stage::new(dag, node.index(), low, level, way, t);
                    continue;
                }
                let [x, y, z] = stage.steps.next;
                let span = [t, x.min(y).min(z).min(end).max(t)];
                let cell =
                    Cell { low, bits, child: node, around: (stage.mask, number), span, fine };
                if let Some(hit) = meet(self, way, &cell) {
                    return Err(hit);
                }
            }
            // Into the next cell, of the node or of one above.
            loop {
                let (out, index) = stage.steps.step(way);
                t = t.max(out);
                if index < SIDE {
                    break;
                }
                if level == BLOCK_LEVEL {
                    return Ok(t);
                }
                level += 1;
                stage = stack[level as usize];
            }
            if t >= end {
                return Ok(t);
            }
        }
    }

    #[inline]
    fn content(&mut self, way: &Way, cell: &Cell) -> Option<Hit> {
        if cell.bits as i32 <= cell.fine {
            let (t, what) = self.far(&way.o, &way.d, cell.child, cell.span)?;
            Some(Hit { t, what, size: 1 << cell.bits, around: cell.around })
        } else {
            self.near(way, cell)
        }
    }

    /// In a cell as small as the ray is broad.
    fn far(
        &self,
        o: &[f64; 3],
        d: &[f64; 3],
        child: Ref,
        [t, out]: [f64; 2],
    ) -> Option<(f64, What)> {
        if child.has(Ref::GROUND) {
            let over = |t: f64| {
                let z = o[2] + d[2] * t;
                self.scene.height(o[0] + d[0] * t, o[1] + d[1] * t).map(|h| z - h)
            };
            if let Some(start) = over(t) {
                if start <= 0.0 {
                    return Some((t, What::Ground));
                }
                if child.has(Ref::VEGETATION) {
                    return Some((t, What::Vegetation));
                }
                if let Some(end) = over(out).filter(|end| *end <= 0.0) {
                    return Some((t + (out - t) * (start / (start - end)), What::Ground));
                }
                return None;
            }
        }
        child.has(Ref::VEGETATION).then_some((t, What::Vegetation))
    }

    /// In a brick that is larger than the ray is broad; where its voxels are not, whole voxels are
    /// met.
    fn near(&mut self, way: &Way, cell: &Cell) -> Option<Hit> {
        let Way { o, d, .. } = way;
        let Cell { low, child, span: [t, mut out], fine, .. } = *cell;
        let is_coarse = fine >= 0;
        let mut hit = None;
        if child.has(Ref::GROUND)
            && let Some(ground) = self.ground(o, d, low, [t, out])
        {
            out = ground;
            hit = Some(Hit { t: ground, what: What::Ground, size: 1, around: (0, 0) });
        }
        // Near the brick, f32 is precise.
        let p = Vec3::new(
            (o[0] + d[0] * t - f64::from(low[0])) as f32,
            (o[1] + d[1] * t - f64::from(low[1])) as f32,
            (o[2] + d[2] * t - f64::from(low[2])) as f32,
        );
        let direction = Vec3::new(d[0] as f32, d[1] as f32, d[2] as f32);
        let length = (out - t) as f32;
        let met = if is_coarse {
            let solid =
                if child.has(Ref::VEGETATION) { self.scene.dag.solid(child.index()) } else { 0 };
            first_voxel(solid, p, direction, length).map(|(along, number)| (along, (solid, number)))
        } else if child.has(Ref::CELLS) {
            let brick = self.brick(low, Some(child));
            brick.first(p, direction, 0.0, length).map(|along| (along, (0, 0)))
        } else {
            None
        };
        match met {
            Some((along, around)) => {
                Some(Hit { t: t + f64::from(along), what: What::Vegetation, size: 1, around })
            }
            None => hit,
        }
    }

    /// Where the ray meets the patch of ground over a brick.
    fn ground(&self, o: &[f64; 3], d: &[f64; 3], low: [u32; 3], [t, out]: [f64; 2]) -> Option<f64> {
        let ([x0, y0], step, [a, b, c, e]) = self.scene.patch(low[0], low[1])?;
        // Heights over the unit square: a + u·bu + v·bv + uv·buv.
        let (bu, bv, buv) = (b - a, c - a, a - b - c + e);
        let (u0, v0) = ((o[0] + d[0] * t - x0) / step, (o[1] + d[1] * t - y0) / step);
        let (du, dv) = (d[0] / step, d[1] / step);
        // Height of the ray over the patch after s: p + q·s + r·s².
        let p = o[2] + d[2] * t - (a + u0 * bu + v0 * bv + u0 * v0 * buv);
        if p <= 0.0 {
            return Some(t);
        }
        let q = d[2] - (du * bu + dv * bv + (u0 * dv + v0 * du) * buv);
        let r = -du * dv * buv;
        let most = out - t;
        if p + most * (q + most * r) > 0.0 && (r <= 0.0 || q >= 0.0 || q * q < 4.0 * r * p) {
            return None;
        }
        let root = (q * q - 4.0 * r * p).max(0.0).sqrt();
        // The least root above 0, without subtracting what is nearly equal.
        let k = -0.5 * (q + root.copysign(q));
        let s = [k / r, p / k].into_iter().filter(|s| *s >= 0.0).fold(f64::INFINITY, f64::min);
        (s <= most).then_some(t + s)
    }

    /// The direction away from what was met, of unit length. `p` is where, in voxels.
    pub fn normal(&mut self, hit: &Hit, p: DVec3, breadth: f32) -> Vec3 {
        match hit.what {
            What::Ground => self.scene.slope(p.x, p.y, f64::from(breadth)),
            What::Vegetation if hit.around.0 == 0 => {
                let p = p.as_vec3();
                let mut gradient = Vec3::ZERO;
                for axis in [Vec3::X, Vec3::Y, Vec3::Z] {
                    gradient += axis * (self.density(p + axis) - self.density(p - axis));
                }
                (-gradient).try_normalize().unwrap_or(Vec3::Z)
            }
            What::Cut(axis) => {
                let middle = f64::from(self.scene.sides[usize::from(axis)]) / 2.0;
                let out = if p[usize::from(axis)] < middle { -1.0 } else { 1.0 };
                Vec3::AXES[usize::from(axis)] * out
            }
            What::Vegetation => away(hit.around.0, hit.around.1),
        }
    }
}

/// The first voxel of a brick that a ray meets, and how far along.
fn first_voxel(solid: u64, p: Vec3, d: Vec3, to: f32) -> Option<(f32, u32)> {
    if solid == 0 {
        return None;
    }
    let (p, d) = (p.to_array(), d.to_array());
    let mut cell = [0, 1, 2].map(|a| p[a].clamp(0.0, 3.0) as i32);
    let inverse = d.map(|d| 1.0 / d);
    let mut next =
        [0, 1, 2].map(|a| ((cell[a] + i32::from(d[a] > 0.0)) as f32 - p[a]) * inverse[a]);
    let mut t = 0.0f32;
    loop {
        let number = (cell[0] | cell[1] << 2 | cell[2] << 4) as u32;
        if solid >> number & 1 != 0 {
            return Some((t, number));
        }
        let axis = if next[0] <= next[1] && next[0] <= next[2] {
            0
        } else {
            1 + usize::from(next[2] < next[1])
        };
        t = next[axis];
        cell[axis] += if d[axis] > 0.0 { 1 } else { -1 };
        if t > to || !(0..SIDE as i32).contains(&cell[axis]) {
            return None;
        }
        next[axis] += inverse[axis].abs();
    }
}

/// From what is full around a child of a node to what is not.
fn away(mask: u64, number: u32) -> Vec3 {
    let at = [number & 3, number >> 2 & 3, number >> 4];
    let planes = [0x1111_1111_1111_1111u64, 0x000f_000f_000f_000f, 0x0000_0000_0000_ffff];
    let mut normal = Vec3::ZERO;
    for axis in 0..3 {
        let full = |i: u32| (mask & planes[axis] << (i << (2 * axis))).count_ones() as f32;
        let (mut below, mut above) = (0.0, 0.0);
        for i in 0..SIDE {
            match i.cmp(&at[axis]) {
                std::cmp::Ordering::Less => below += full(i),
                std::cmp::Ordering::Greater => above += full(i),
                std::cmp::Ordering::Equal => {}
            }
        }
        normal[axis] = below / at[axis].max(1) as f32 - above / (3 - at[axis]).max(1) as f32;
    }
    normal.try_normalize().unwrap_or(Vec3::Z)
}
