//! Where the scene stands on the Earth: an f64 origin, a coordinate reference system, and the
//! transform between world coordinates and local metres.
//!
//! Architecture invariant: everything downstream of a reader is f32, local, metres, Z up, X east,
//! Y north. World coordinates appear only in readers, writers and reports.

use glam::{DVec3, Vec3};
use rayon::prelude::*;

/// A coordinate reference system as the input states it; nothing is looked up.
#[derive(Debug, Clone, PartialEq)]
pub struct Crs {
    /// EPSG code of the projected system, where the file gives one.
    pub epsg: Option<u32>,
    /// WKT as found in the file.
    pub wkt: Option<String>,
    /// Metres per horizontal unit (1 for metres, 0.3048… for feet).
    pub horizontal_unit_m: f64,
    /// Metres per vertical unit.
    pub vertical_unit_m: f64,
}

impl Crs {
    /// A metric system known by its EPSG code alone.
    pub fn from_epsg(code: u32) -> Self {
        Crs { epsg: Some(code), wkt: None, horizontal_unit_m: 1.0, vertical_unit_m: 1.0 }
    }
}

/// The scene origin in world coordinates, and the system those are in.
#[derive(Debug, Clone, PartialEq)]
pub struct Frame {
    /// World coordinates, in the units of `crs`, of the local point (0, 0, 0).
    pub origin: DVec3,
    /// `None` where the input states no system; world units are then taken as metres.
    pub crs: Option<Crs>,
}

impl Frame {
    /// A frame at `origin` with no stated system, in metres.
    pub fn local(origin: DVec3) -> Self {
        Frame { origin, crs: None }
    }

    /// Metres per world unit, for x, y, z.
    pub fn unit_m(&self) -> DVec3 {
        match &self.crs {
            Some(crs) => {
                DVec3::new(crs.horizontal_unit_m, crs.horizontal_unit_m, crs.vertical_unit_m)
            }
            None => DVec3::ONE,
        }
    }

    /// World coordinates of a local point.
    pub fn world_from_local(&self, p: Vec3) -> DVec3 {
        self.origin + p.as_dvec3() / self.unit_m()
    }

    /// Local metres of a world point.
    pub fn local_from_world(&self, p: DVec3) -> Vec3 {
        ((p - self.origin) * self.unit_m()).as_vec3()
    }

    /// A key for a place, from its world position quantised to 1/4 m: the same tree has the same
    /// key whatever the origin, the tile or the other trees.
    pub fn key(&self, p: Vec3) -> u64 {
        let world_m = self.origin * self.unit_m() + p.as_dvec3();
        let east = (world_m.x * 4.0).floor() as i64 as u64;
        let north = (world_m.y * 4.0).floor() as i64 as u64;
        (east << 32) | (north & 0xffff_ffff)
    }
}

/// The least box about points; `None` without any.
pub fn bounds(points: &[Vec3]) -> Option<(Vec3, Vec3)> {
    let [low, high] = extremes(bytemuck::cast_slice(points), f32::INFINITY, f32::NEG_INFINITY)?;
    Some((low.into(), high.into()))
}

/// Least and greatest of each coordinate; `None` without points. NaN counts for nothing. `most` and
/// `least` are what no number is above and below.
pub(crate) fn extremes<T>(points: &[[T; 3]], most: T, least: T) -> Option<[[T; 3]; 2]>
where
    T: bytemuck::Pod + PartialOrd + Send + Sync,
{
    // Eight points at a time, as so many numbers that the compiler does them side by side; and not
    // by `min` and `max`, which ask for more than the one instruction that these are.
    const LANES: usize = 3 * 8;
    let less = |a: T, b: T| if b < a { b } else { a };
    let more = |a: T, b: T| if b > a { b } else { a };
    let of_run = |points: &[[T; 3]]| {
        let (together, rest) = bytemuck::cast_slice::<[T; 3], T>(points).as_chunks::<LANES>();
        let (mut low, mut high) = ([most; LANES], [least; LANES]);
        for values in together {
            for ((low, high), &v) in low.iter_mut().zip(&mut high).zip(values) {
                *low = less(*low, v);
                *high = more(*high, v);
            }
        }
        for (i, &v) in rest.iter().enumerate() {
            low[i] = less(low[i], v);
            high[i] = more(high[i], v);
        }
        let axis = |lanes: [T; LANES], axis: usize, of: &dyn Fn(T, T) -> T| {
            lanes[axis..].iter().step_by(3).copied().fold(lanes[axis], of)
        };
        [[0, 1, 2].map(|k| axis(low, k, &less)), [0, 1, 2].map(|k| axis(high, k, &more))]
    };
    let both = |a: [T; 3], b: [T; 3], of: &dyn Fn(T, T) -> T| [0, 1, 2].map(|k| of(a[k], b[k]));
    let runs = points.par_chunks(1 << 16).map(of_run);
    runs.reduce_with(|a, b| [both(a[0], b[0], &less), both(a[1], b[1], &more)])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bounds_are_those_of_every_point() {
        for n in [1usize, 7, 8, 9, 100, 70_000] {
            let at = |i: usize| Vec3::new((i * 7919 % n) as f32, -((i * 31 % n) as f32), i as f32);
            let mut points: Vec<Vec3> = (0..n).map(at).collect();
            let plain = |points: &[Vec3]| {
                // Of a number and NaN, these of single numbers give the number.
                let ends = |axis: usize| {
                    points.iter().fold((f32::INFINITY, f32::NEG_INFINITY), |(low, high), p| {
                        (low.min(p[axis]), high.max(p[axis]))
                    })
                };
                let [x, y, z] = [0, 1, 2].map(ends);
                (Vec3::new(x.0, y.0, z.0), Vec3::new(x.1, y.1, z.1))
            };
            assert_eq!(bounds(&points), Some(plain(&points)));
            points[n / 2] = Vec3::new(f32::NAN, -1e9, f32::INFINITY);
            assert_eq!(bounds(&points), Some(plain(&points)));
        }
        assert_eq!(bounds(&[]), None);
    }

    #[test]
    fn millimetres_survive_far_coordinates() {
        let frame = Frame::local(DVec3::new(6_000_000.0, 7_000_000.0, 0.0));
        let world = DVec3::new(6_000_123.456, 7_000_321.654, 98.765);
        let back = frame.world_from_local(frame.local_from_world(world));
        assert!((back - world).abs().max_element() < 1e-4);
    }

    #[test]
    fn feet_become_metres_and_return() {
        let mut crs = Crs::from_epsg(2229);
        crs.horizontal_unit_m = 0.3048;
        crs.vertical_unit_m = 0.3048;
        let frame = Frame { origin: DVec3::new(100.0, 200.0, 0.0), crs: Some(crs) };
        let local = frame.local_from_world(DVec3::new(110.0, 200.0, 10.0));
        assert!((local - Vec3::new(3.048, 0.0, 3.048)).length() < 1e-5);
        assert!((frame.world_from_local(local) - DVec3::new(110.0, 200.0, 10.0)).length() < 1e-5);
    }

    #[test]
    fn key_does_not_depend_on_the_origin() {
        let p = DVec3::new(500_010.1, 4_100_020.1, 55.0);
        let a = Frame::local(DVec3::new(500_000.0, 4_100_000.0, 0.0));
        let b = Frame::local(DVec3::new(499_000.0, 4_099_500.0, 10.0));
        assert_eq!(a.key(a.local_from_world(p)), b.key(b.local_from_world(p)));
    }
}
