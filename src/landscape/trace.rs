//! Rays through the landscape (TD17: rays stepped through the voxels, the octree to skip what is
//! empty, trilinear interpolation where it is not).
//!
//! Where a voxel looks smaller than the footprint of the ray (a pixel, say) its walk ends at the cell
//! that is as large as the footprint; nearer by, vegetation is where the interpolated density passes
//! one half, and ground is the bilinear patch between four heights, met exactly. Known limits:
//! vegetation seen from afar is as wide as the cells it is in, up to a footprint too wide; a hill in a
//! single footprint may be missed.

use glam::{DVec3, Vec3};

use super::Landscape;
use super::brick::{Brick, Crust, Fills, along_cells};
use super::dag::{BITS, Ref, SIDE};
use super::pack::{LANES, Pack};
use super::walk::{Begin, Cell, Way, greater, lesser, walk};

/// A half line in voxels from the centre of the first voxel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Ray {
    pub origin: DVec3,
    pub direction: DVec3,
    /// Breadth in voxels at the origin, and by how much more a length of `direction`.
    pub breadth: [f32; 2],
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
/// Voxels that a ray is broad up to which it sees gaps between leaves.
pub(super) const FINEST: f32 = 0.6;

/// Rays on one thread, with the bricks that were last gathered.
pub(super) struct Tracer<'a> {
    pub scene: &'a Landscape,
    keys: Vec<u64>,
    bricks: Vec<Brick>,
    /// Of bricks and their neighbours, with their keys; none until they are asked for.
    fills: Vec<(u64, Fills)>,
    /// Whether vegetation seen from near has gaps finer than voxels.
    is_leafy: bool,
    /// Whether the processor has what [`Tracer::first_by_bits`] needs.
    #[cfg(target_arch = "x86_64")]
    counts_bits: bool,
}

impl<'a> Tracer<'a> {
    pub fn new(scene: &'a Landscape) -> Tracer<'a> {
        Tracer {
            scene,
            keys: vec![u64::MAX; SHELF],
            bricks: vec![Brick::EMPTY; SHELF],
            fills: Vec::new(),
            is_leafy: false,
            #[cfg(target_arch = "x86_64")]
            counts_bits: is_x86_feature_detected!("avx2")
                && is_x86_feature_detected!("bmi1")
                && is_x86_feature_detected!("bmi2")
                && is_x86_feature_detected!("lzcnt")
                && is_x86_feature_detected!("popcnt"),
        }
    }

    /// For pictures: from near, vegetation has gaps as leaves leave them.
    pub fn of_leaves(scene: &'a Landscape) -> Tracer<'a> {
        Tracer { is_leafy: true, ..Tracer::new(scene) }
    }

    /// The brick whose first voxel is at `low`.
    fn brick(&mut self, low: [u32; 3], own: Option<Ref>) -> &Brick {
        let (key, place) = shelved(low);
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
    #[inline(always)]
    fn enter(&self, way: &Way, from: f64, to: f64) -> Result<[f64; 2], Option<Hit>> {
        let Way { o, d, inverse, .. } = way;
        let (mut t, mut end, mut axis) = (greater(from, 0.0), to, None);
        let reach = self.scene.reach();
        for a in 0..3 {
            let side = f64::from(reach[a] as i32);
            let (near, far) = if d[a] > 0.0 { (0.0, side) } else { (side, 0.0) };
            let (near, far) = ((near - o[a]) * inverse[a], (far - o[a]) * inverse[a]);
            if near > t {
                (t, axis) = (near, Some(a));
            }
            end = lesser(end, far);
        }
        if t > end {
            return Err(None);
        }
        if let Some(a) = axis {
            let z = o[2] + d[2] * t;
            // From above nothing is cut.
            if z > -1e-6
                && z < f64::from(reach[2]) - 1e-6
                && self.scene.height(o[0] + d[0] * t, o[1] + d[1] * t).is_some_and(|h| z < h)
            {
                return Err(Some(Hit { t, what: What::Cut(a as u8), size: 1, around: (0, 0) }));
            }
        }
        Ok([t, end])
    }

    /// The first thing that a ray meets between `from` and `to` of its direction's lengths.
    pub fn trace(&mut self, ray: &Ray, from: f64, to: f64) -> Option<Hit> {
        #[cfg(target_arch = "x86_64")]
        if self.counts_bits {
            // SAFETY: the processor was asked when the tracer was made.
            return unsafe { self.first_by_bits(ray, from, to) };
        }
        self.first_anywhere(ray, from, to)
    }

    /// The first things that rays of one origin meet.
    pub fn trace_all(&mut self, rays: &[Ray; LANES]) -> [Option<Hit>; LANES] {
        #[cfg(target_arch = "x86_64")]
        if self.counts_bits {
            // SAFETY: the processor was asked when the tracer was made.
            return unsafe { self.all_by_bits(rays) };
        }
        self.all(rays)
    }

    /// As [`Tracer::first_by_bits`].
    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2,bmi1,bmi2,lzcnt,popcnt")]
    #[inline(never)]
    fn all_by_bits(&mut self, rays: &[Ray; LANES]) -> [Option<Hit>; LANES] {
        self.all(rays)
    }

    #[inline(always)]
    fn all(&mut self, rays: &[Ray; LANES]) -> [Option<Hit>; LANES] {
        let pack = Pack::new(self.scene, rays);
        let mut hits = [None; LANES];
        for (lane, (ray, hit)) in rays.iter().zip(&mut hits).enumerate() {
            if pack.is_past(lane) {
                continue;
            }
            *hit = match pack.begin(lane, ray) {
                Some((way, begin)) => {
                    walk(self.scene, &way, begin, |cell| self.content(&way, cell))
                }
                None => self.trace(ray, 0.0, f64::INFINITY),
            };
        }
        hits
    }

    #[inline(never)]
    fn first_anywhere(&mut self, ray: &Ray, from: f64, to: f64) -> Option<Hit> {
        self.first(ray, from, to)
    }

    /// [`Tracer::first`] with the instructions of newer processors, which count bits in one. Nothing
    /// in it rounds otherwise.
    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2,bmi1,bmi2,lzcnt,popcnt")]
    #[inline(never)]
    fn first_by_bits(&mut self, ray: &Ray, from: f64, to: f64) -> Option<Hit> {
        self.first(ray, from, to)
    }

    #[inline(always)]
    fn first(&mut self, ray: &Ray, from: f64, to: f64) -> Option<Hit> {
        self.walk(ray, from, to, |tracer, way, cell| tracer.content(way, cell))
    }

    /// The greatest density, 0 to 1, on the ray's way before the ground: the share of its voxels' full
    /// density that the neighbourhood of a brick has, where the eight voxels about the way are full.
    pub fn densest(&mut self, ray: &Ray) -> (f32, Option<Hit>) {
        // As if it were narrow everywhere, so that it comes to every brick.
        let ray = Ray { breadth: [0.0; 2], ..*ray };
        let mut most = 0.0f32;
        let hit = self.walk(&ray, 0.0, f64::INFINITY, |tracer, way, cell| {
            let Way { o, d, .. } = way;
            let [t, mut out] = cell.span;
            let ground = cell.child.has(Ref::GROUND);
            let ground = ground.then(|| tracer.ground(o, d, cell.low, cell.span)).flatten();
            out = ground.unwrap_or(out);
            if cell.child.has(Ref::VEGETATION | Ref::CELLS) {
                let fills = tracer.fills(cell.low);
                if fills.most() > most {
                    let at = |a: usize| (o[a] + d[a] * t - f64::from(cell.low[a])) as f32;
                    let p = Vec3::new(at(0), at(1), at(2));
                    let direction = Vec3::from(d.map(|d| d as f32));
                    let brick = tracer.brick(cell.low, Some(cell.child));
                    along_cells(p, direction, (out - t) as f32, |_, slot| {
                        most = most.max(brick.mean(slot) * fills.at(slot));
                        true
                    });
                }
            }
            let t = ground?;
            Some(Hit { t, what: What::Ground, size: 1, around: (0, 0) })
        });
        (most, hit)
    }

    /// How full the bricks around and at a place are.
    fn fills(&mut self, low: [u32; 3]) -> Fills {
        if self.fills.is_empty() {
            self.fills = vec![(u64::MAX, Fills::default()); SHELF];
        }
        let (key, place) = shelved(low);
        if self.fills[place].0 != key {
            self.fills[place] = (key, Fills::gather(&self.scene.dag, low));
        }
        self.fills[place].1
    }

    /// Takes a ray from cell to cell until `meet` has something to give.
    #[inline(always)]
    fn walk(
        &mut self,
        ray: &Ray,
        from: f64,
        to: f64,
        mut meet: impl FnMut(&mut Self, &Way, &Cell) -> Option<Hit>,
    ) -> Option<Hit> {
        let way = Way::new(ray);
        match self.enter(&way, from, to) {
            Ok(span) => {
                let begin = Begin::new(&self.scene.blocks, &way, span)?;
                walk(self.scene, &way, begin, |cell| meet(self, &way, cell))
            }
            Err(met) => met,
        }
    }

    #[inline(always)]
    fn content(&mut self, way: &Way, cell: &Cell) -> Option<Hit> {
        if cell.bits as i32 <= cell.fine {
            let (t, what) = self.far(&way.o, &way.d, cell.child, cell.span)?;
            Some(Hit { t, what, size: 1 << cell.bits, around: cell.around })
        } else {
            self.near(way, cell)
        }
    }

    /// In a cell as small as the ray is broad.
    #[inline(always)]
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
    #[inline(never)]
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
            let depth = if self.is_leafy { 1.0 - way.breadth(t as f32) / FINEST } else { 0.0 };
            let fine = self.scene.boughs_in_voxel();
            let brick = self.brick(low, Some(child));
            let along = match depth > 0.0 {
                true => brick.first_leaf(p, direction, length, Crust { low, depth, fine }),
                false => brick.first(p, direction, 0.0, length),
            };
            along.map(|along| (along, (0, 0)))
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

/// A brick's key, and where it is on a shelf.
fn shelved(low: [u32; 3]) -> (u64, usize) {
    let [x, y, z] = low.map(|low| low >> BITS);
    let key = u64::from(x) | u64::from(y) << 21 | u64::from(z) << 42;
    (key, (x ^ y << 3 ^ z << 6) as usize & (SHELF - 1))
}

/// The first voxel of a brick that a ray meets, and how far along.
fn first_voxel(solid: u64, p: Vec3, d: Vec3, to: f32) -> Option<(f32, u32)> {
    let is_full = |number: &u32| solid >> number & 1 != 0;
    let mut met = None;
    if solid != 0 {
        along_cells(p, d, to, |t, number| {
            met = is_full(&number).then_some((t, number));
            met.is_none()
        });
    }
    met
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
