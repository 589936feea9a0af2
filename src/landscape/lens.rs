//! From where a landscape is seen.

use glam::{DVec2, DVec3, Vec3};

use super::Landscape;
use super::trace::Ray;
use crate::render::Camera;

/// A way to look at a whole landscape.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum View {
    /// From the south, low over the horizon.
    North,
    /// From the south-east, as a bird.
    Oblique,
    /// From far above; north is up.
    Top,
}

impl View {
    pub const ALL: [(&'static str, View); 3] =
        [("north", View::North), ("oblique", View::Oblique), ("top", View::Top)];
}

/// Vertical angle of view of [`View::Top`]: next to no perspective.
const TOP_FOV_RAD: f32 = 0.02;

impl Landscape {
    /// A camera that shows all of it.
    pub fn camera(&self, view: View, aspect: f32) -> Camera {
        let [low, high] = self.bounds_m();
        let corner = |i: u32| {
            let pick = |axis: usize| if i >> axis & 1 == 0 { low[axis] } else { high[axis] };
            Vec3::new(pick(0), pick(1), pick(2))
        };
        let corners: Vec<Vec3> = (0..8).map(corner).collect();
        match view {
            View::North => Camera::framing(&corners, aspect, 180.0, 14.0, 0.5, 0.93),
            View::Oblique => Camera::framing(&corners, aspect, 148.0, 36.0, 0.5, 0.93),
            View::Top => {
                let middle = (low + high) * 0.5;
                let size = high - low;
                let tall = size.y.max(size.x / aspect) * 1.04;
                let away = 0.5 * tall / (0.5 * TOP_FOV_RAD).tan();
                let eye = middle.with_z(high.z + away);
                Camera { eye, target: middle, fov_y_rad: TOP_FOV_RAD }
            }
        }
    }

    /// A camera in voxels, for a picture of `width` × `height` pixels.
    pub(super) fn lens(&self, camera: &Camera, [width, height]: [u32; 2]) -> Lens {
        let (eye, target) = (self.to_voxels(camera.eye), self.to_voxels(camera.target));
        let forward = (target - eye).normalize_or(DVec3::Y);
        // Straight up or down, north is up.
        let right = forward.cross(DVec3::Z);
        let right = if right.length() > 1e-6 { right.normalize() } else { DVec3::X };
        let pixel = 2.0 * (0.5 * f64::from(camera.fov_y_rad)).tan() / f64::from(height.max(1));
        Lens {
            eye,
            forward,
            right: right * pixel,
            down: forward.cross(right) * pixel,
            middle: DVec2::new(f64::from(width), f64::from(height)) * 0.5,
            pixel,
        }
    }
}

/// A pinhole camera in voxels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Lens {
    pub eye: DVec3,
    /// Of unit length.
    pub forward: DVec3,
    /// A pixel to the right and a pixel down, on a plane at a distance of 1.
    pub right: DVec3,
    pub down: DVec3,
    /// The picture's middle, in pixels from its upper left corner.
    middle: DVec2,
    /// Breadth of a pixel at a distance of 1.
    pub pixel: f64,
}

impl Lens {
    /// The ray through a place in the picture; its direction has a depth of 1. It is as broad as
    /// `share` of a pixel.
    pub fn ray(&self, at: DVec2, share: f64) -> Ray {
        let off = at - self.middle;
        let direction = self.forward + self.right * off.x + self.down * off.y;
        Ray { origin: self.eye, direction, breadth: [0.0, (self.pixel * share) as f32] }
    }
}

/// A box from 0 to its sides, as it is seen from a place.
pub(super) struct Outline {
    /// Planes through the eye and edges, beyond which nothing of the box is.
    planes: Vec<DVec3>,
    corners: [DVec3; 8],
}

impl Outline {
    pub fn new(lens: &Lens, sides: [u32; 3]) -> Outline {
        let corners: [DVec3; 8] = std::array::from_fn(|i| {
            let corner = [0, 1, 2].map(|a| f64::from(i as u32 >> a & 1) * f64::from(sides[a]));
            DVec3::from(corner) - lens.eye
        });
        let edges =
            (0..8).flat_map(|i| (0..3).map(move |a| (i, i | 1 << a)).filter(|(i, j)| i < j));
        let mut planes = Vec::new();
        for (i, j) in edges {
            let normal = corners[i].cross(corners[j]).normalize_or_zero();
            let off = corners.map(|corner| normal.dot(corner) / corner.length().max(1e-9));
            /// What rounding may do.
            const NEAR: f64 = 1e-9;
            if off.iter().all(|off| *off >= -NEAR) {
                planes.push(normal);
            } else if off.iter().all(|off| *off <= NEAR) {
                planes.push(-normal);
            }
        }
        Outline { planes, corners }
    }

    /// Whether a ray through the picture between two of its places may meet the box: it may not if
    /// all of the box is beyond one side of these rays' pyramid, or all of that beyond an edge.
    pub fn is_seen(&self, lens: &Lens, low: DVec2, high: DVec2) -> bool {
        let mut is_beyond = [true; 4];
        for v in self.corners {
            let at = DVec2::new(v.dot(lens.right), v.dot(lens.down)) / (lens.pixel * lens.pixel);
            let (least, most) = (
                at - (low - lens.middle) * v.dot(lens.forward),
                at - (high - lens.middle) * v.dot(lens.forward),
            );
            let beyond = [least.x < 0.0, least.y < 0.0, most.x > 0.0, most.y > 0.0];
            for (all, this) in is_beyond.iter_mut().zip(beyond) {
                *all &= this;
            }
        }
        let rays = [low, DVec2::new(high.x, low.y), DVec2::new(low.x, high.y), high]
            .map(|at| lens.ray(at, 1.0).direction);
        let is_off = |plane: &DVec3| rays.iter().all(|ray| plane.dot(*ray) < -1e-7 * ray.length());
        !is_beyond.contains(&true) && !self.planes.iter().any(is_off)
    }
}
