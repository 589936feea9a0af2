//! Where a picture is taken from: a pinhole camera that frames a box, and the orthographic views
//! from which light arrives.

use glam::{Mat3, Vec2, Vec3};

/// A pinhole camera in scene metres, Z up.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Camera {
    pub eye: Vec3,
    pub target: Vec3,
    /// Vertical angle of view.
    pub fov_y_rad: f32,
}

/// Azimuth the cameras made here look from, clockwise from north. Off the axes, so that a square
/// stand shows a corner and fills a wide picture.
const AZIMUTH_DEG: f32 = 148.0;

impl Camera {
    /// An oblique bird's-eye view that frames everything as tightly as it allows.
    pub fn overview(view: &super::View<'_>, aspect: f32) -> Camera {
        Self::framing(&view.extent(), aspect, AZIMUTH_DEG, 30.0, 0.55, 0.96)
    }

    /// A nearly level view of a single tree, with room for the ground it stands on.
    pub fn portrait(view: &super::View<'_>, aspect: f32) -> Camera {
        Self::framing(&view.extent(), aspect, AZIMUTH_DEG, 7.0, 0.50, 0.86)
    }

    /// Frames points from a side.
    ///
    /// `azimuth_deg` and `elevation_deg` say where the eye is, seen from the points (clockwise
    /// from north; above the horizon); `fill` is the share of the picture's height or width that
    /// they may take. Without points, frames the origin.
    pub fn framing(
        points: &[Vec3],
        aspect: f32,
        azimuth_deg: f32,
        elevation_deg: f32,
        fov_y_rad: f32,
        fill: f32,
    ) -> Camera {
        let points = if points.is_empty() { &[Vec3::ZERO] } else { points };
        let (sa, ca) = azimuth_deg.to_radians().sin_cos();
        let (se, ce) = elevation_deg.clamp(-89.0, 89.0).to_radians().sin_cos();
        let basis = basis(-Vec3::new(sa * ce, ca * ce, se));
        let tan_y = (fov_y_rad * 0.5).tan().max(1e-3) * fill.clamp(0.05, 1.0);
        let tan_x = tan_y * aspect.max(1e-3);
        // Each side plane of the frustum touches a point; two opposite planes fix the eye's
        // sideways place and its least distance along the view.
        let (mut right, mut left, mut up, mut down) = (f32::MIN, f32::MIN, f32::MIN, f32::MIN);
        let mut nearest = f32::MAX;
        for p in points {
            let p = *p - points[0];
            let v = Vec3::new(p.dot(basis.x_axis), p.dot(basis.y_axis), p.dot(basis.z_axis));
            right = right.max(v.x - v.z * tan_x);
            left = left.max(-v.x - v.z * tan_x);
            up = up.max(v.y - v.z * tan_y);
            down = down.max(-v.y - v.z * tan_y);
            nearest = nearest.min(v.z);
        }
        let distance =
            ((right + left) / (2.0 * tan_x)).max((up + down) / (2.0 * tan_y)).max(0.1 - nearest);
        let (shift_x, shift_y) = ((right - left) * 0.5, (up - down) * 0.5);
        let on_axis = points[0] + basis.x_axis * shift_x + basis.y_axis * shift_y;
        let eye = on_axis - basis.z_axis * distance;
        // Where there is room, as much on either side.
        let seen: Vec<Vec3> = points.iter().map(|p| basis.transpose() * (*p - eye)).collect();
        let eye = eye
            + basis.x_axis * centring(seen.iter().map(|v| [v.x, v.z]))
            + basis.y_axis * centring(seen.iter().map(|v| [v.y, v.z]));
        Camera { eye, target: eye + basis.z_axis * distance.abs().max(0.1), fov_y_rad }
    }
}

/// How far to shift across, so that points at these places across and depths are seen as far on one
/// side as on the other.
fn centring(points: impl Iterator<Item = [f32; 2]> + Clone) -> f32 {
    let off = |shift: f32| {
        let slopes = points.clone().map(|[across, depth]| (across - shift) / depth.max(1e-6));
        let (low, high) =
            slopes.fold((f32::MAX, f32::MIN), |(low, high), s| (low.min(s), high.max(s)));
        low + high
    };
    let across = points.clone().map(|[across, _]| across);
    let (mut low, mut high) =
        across.fold((f32::MAX, f32::MIN), |(low, high), a| (low.min(a), high.max(a)));
    for _ in 0..40 {
        let middle = 0.5 * (low + high);
        (low, high) = if off(middle) > 0.0 { (middle, high) } else { (low, middle) };
    }
    0.5 * (low + high)
}

/// Corner `i` of 8 of a box.
pub(super) fn corner(lo: Vec3, hi: Vec3, i: usize) -> Vec3 {
    Vec3::new(
        if i & 1 == 0 { lo.x } else { hi.x },
        if i & 2 == 0 { lo.y } else { hi.y },
        if i & 4 == 0 { lo.z } else { hi.z },
    )
}

/// Right and up of a view along `forward`.
pub(super) fn sides(forward: Vec3) -> [Vec3; 2] {
    let axes = basis(forward);
    [axes.x_axis, axes.y_axis]
}

/// Right, up and forward of a view along `forward`; Z is up where it can be.
fn basis(forward: Vec3) -> Mat3 {
    let f = forward.try_normalize().unwrap_or(Vec3::NEG_Z);
    let helper = if f.z.abs() > 0.9999 { Vec3::Y } else { Vec3::Z };
    let right = f.cross(helper).normalize();
    Mat3::from_cols(right, right.cross(f), f)
}

/// A vertex on the sample grid of a view.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Projected {
    /// Samples from the left and from the top.
    pub at: Vec2,
    /// Greater is nearer; linear over the picture.
    pub nearness: f32,
    /// 1 over depth in a pinhole view, 1 in an orthographic one.
    pub inv_w: f32,
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Lens {
    Pinhole { near_m: f32 },
    Orthographic,
}

/// A view of the scene onto a grid of samples.
#[derive(Debug, Clone, Copy)]
pub(super) struct View {
    eye: Vec3,
    /// Rows: right, up, forward.
    axes: Mat3,
    lens: Lens,
    /// Samples a metre at depth 1 (pinhole) or anywhere (orthographic).
    pub focal: f32,
    centre: Vec2,
    pub width: usize,
    pub height: usize,
}

/// A pinhole view clips beyond this many samples from the middle, so that fixed-point
/// coordinates can't overflow.
const GUARD_SAMPLES: f32 = (1 << 18) as f32;

impl View {
    pub fn pinhole(camera: &Camera, width: usize, height: usize) -> View {
        let axes = basis(camera.target - camera.eye);
        let distance = camera.eye.distance(camera.target);
        View {
            eye: camera.eye,
            axes,
            lens: Lens::Pinhole { near_m: (distance * 1e-3).clamp(0.01, 1.0) },
            focal: height as f32 * 0.5 / (camera.fov_y_rad.clamp(1e-3, 3.0) * 0.5).tan(),
            centre: Vec2::new(width as f32, height as f32) * 0.5,
            width,
            height,
        }
    }

    /// An orthographic view along `forward` that holds all `points`, `size` samples across its
    /// longer side.
    pub fn orthographic(forward: Vec3, points: impl Iterator<Item = Vec3>, size: usize) -> View {
        let axes = basis(forward);
        let (mut lo, mut hi) = (Vec3::MAX, Vec3::MIN);
        for p in points {
            let v = axes.transpose() * p;
            lo = lo.min(v);
            hi = hi.max(v);
        }
        if lo.x > hi.x {
            (lo, hi) = (Vec3::ZERO, Vec3::ONE);
        }
        let span = (hi - lo).truncate().max(Vec2::splat(1e-3));
        let focal = size as f32 / (span.max_element() * 1.02);
        let samples =
            (span * 1.02 * focal).ceil().clamp(Vec2::splat(8.0), Vec2::splat(size as f32));
        let eye = axes * Vec3::new((lo.x + hi.x) * 0.5, (lo.y + hi.y) * 0.5, lo.z);
        View {
            eye,
            axes,
            lens: Lens::Orthographic,
            focal,
            centre: samples * 0.5,
            width: samples.x as usize,
            height: samples.y as usize,
        }
    }

    /// An orthographic view along `forward` whose middle shows `centre`.
    pub fn window(centre: Vec3, forward: Vec3, sample_m: f32, size: [usize; 2]) -> View {
        let [width, height] = size;
        View {
            eye: centre,
            axes: basis(forward),
            lens: Lens::Orthographic,
            focal: 1.0 / sample_m,
            centre: Vec2::new(width as f32, height as f32) * 0.5,
            width,
            height,
        }
    }

    pub fn eye(&self) -> Vec3 {
        self.eye
    }

    /// Right, up, depth of a scene point.
    pub fn view_from_scene(&self, p: Vec3) -> Vec3 {
        let d = p - self.eye;
        Vec3::new(d.dot(self.axes.x_axis), d.dot(self.axes.y_axis), d.dot(self.axes.z_axis))
    }

    /// Scene direction of a view direction.
    pub fn scene_from_view(&self, v: Vec3) -> Vec3 {
        self.axes * v
    }

    /// The clip planes as (normal, offset): inside where `normal·v + offset >= 0`.
    pub fn clip_planes(&self) -> [(Vec3, f32); 5] {
        let near = match self.lens {
            Lens::Pinhole { near_m } => (Vec3::Z, -near_m),
            Lens::Orthographic => (Vec3::ZERO, 1.0),
        };
        let g = GUARD_SAMPLES / self.focal;
        let side = |n: Vec3| match self.lens {
            Lens::Pinhole { .. } => (n + Vec3::Z * g, 0.0),
            Lens::Orthographic => (n, g),
        };
        [near, side(Vec3::X), side(Vec3::NEG_X), side(Vec3::Y), side(Vec3::NEG_Y)]
    }

    /// Whether no clip plane cuts the point off.
    pub fn is_drawable(&self, v: Vec3) -> bool {
        let g = GUARD_SAMPLES / self.focal;
        match self.lens {
            Lens::Pinhole { near_m } => {
                v.z >= near_m && v.x.abs() <= g * v.z && v.y.abs() <= g * v.z
            }
            Lens::Orthographic => v.x.abs() <= g && v.y.abs() <= g && v.z.is_finite(),
        }
    }

    /// The place of a drawable view point on the sample grid.
    pub fn project(&self, v: Vec3) -> Projected {
        let (scale, inv_w, nearness) = match self.lens {
            Lens::Pinhole { .. } => {
                let inv = 1.0 / v.z;
                (self.focal * inv, inv, inv)
            }
            Lens::Orthographic => (self.focal, 1.0, -v.z),
        };
        Projected {
            at: Vec2::new(self.centre.x + v.x * scale, self.centre.y - v.y * scale),
            nearness,
            inv_w,
        }
    }

    /// Direction, in the scene, through a place on the sample grid; not of unit length in a
    /// pinhole view: its depth is 1.
    pub fn ray(&self, at: Vec2) -> Vec3 {
        let x = (at.x - self.centre.x) / self.focal;
        let y = (self.centre.y - at.y) / self.focal;
        match self.lens {
            Lens::Pinhole { .. } => self.axes.z_axis + self.axes.x_axis * x + self.axes.y_axis * y,
            Lens::Orthographic => self.axes.z_axis,
        }
    }

    /// Samples a metre spans at a view depth.
    pub fn samples_per_m(&self, depth: f32) -> f32 {
        match self.lens {
            Lens::Pinhole { near_m } => self.focal / depth.max(near_m),
            Lens::Orthographic => self.focal,
        }
    }

    /// The samples a box may touch: (x0, y0, x1, y1), ends excluded, and its least depth; `None`
    /// where it is out of view.
    pub fn cover(&self, lo: Vec3, hi: Vec3) -> Option<([usize; 4], f32)> {
        let (mut min, mut max) = (Vec2::MAX, Vec2::MIN);
        let (mut nearest, mut farthest) = (f32::MAX, f32::MIN);
        let mut is_cut = false;
        for i in 0..8 {
            let v = self.view_from_scene(corner(lo, hi, i));
            if !v.is_finite() {
                return None;
            }
            nearest = nearest.min(v.z);
            farthest = farthest.max(v.z);
            if self.is_drawable(v) {
                let p = self.project(v).at;
                min = min.min(p);
                max = max.max(p);
            } else {
                is_cut = true;
            }
        }
        if matches!(self.lens, Lens::Pinhole { near_m } if farthest < near_m) {
            return None;
        }
        if is_cut {
            (min, max) = (Vec2::ZERO, Vec2::new(self.width as f32, self.height as f32));
        }
        let x0 = (min.x.floor() - 1.0).max(0.0) as usize;
        let y0 = (min.y.floor() - 1.0).max(0.0) as usize;
        let x1 = ((max.x.ceil() + 1.0).max(0.0) as usize).min(self.width);
        let y1 = ((max.y.ceil() + 1.0).max(0.0) as usize).min(self.height);
        (x0 < x1 && y0 < y1).then_some(([x0, y0, x1, y1], nearest))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn known_points_land_where_they_should() {
        let camera = Camera {
            eye: Vec3::new(0.0, -10.0, 0.0),
            target: Vec3::ZERO,
            fov_y_rad: std::f32::consts::FRAC_PI_2,
        };
        let view = View::pinhole(&camera, 200, 100);
        // Half the height of the picture spans the depth, 10 m, at 45°.
        for (p, x, y) in [
            (Vec3::ZERO, 100.0, 50.0),
            (Vec3::new(0.0, 0.0, 10.0), 100.0, 0.0),
            (Vec3::new(10.0, 0.0, 0.0), 150.0, 50.0),
            (Vec3::new(-20.0, 10.0, -20.0), 50.0, 100.0),
        ] {
            let got = view.project(view.view_from_scene(p)).at;
            assert!((got - Vec2::new(x, y)).length() < 1e-3, "{p} at {got}");
            let depth = view.view_from_scene(p).z;
            assert!((view.eye() + view.ray(got) * depth - p).length() < 1e-4);
        }
    }

    #[test]
    fn framing_holds_every_point_and_touches_the_frame() {
        for (lo, hi) in [
            (Vec3::ZERO, Vec3::new(100.0, 80.0, 30.0)),
            (Vec3::splat(-3.0), Vec3::new(-2.0, 50.0, 0.0)),
        ] {
            let points: Vec<Vec3> = (0..8).map(|i| corner(lo, hi, i)).collect();
            for aspect in [16.0 / 9.0, 1.0, 0.4] {
                let (h, w) = (1000usize, (1000.0 * aspect) as usize);
                let camera = Camera::framing(&points, aspect, 140.0, 33.0, 0.6, 0.96);
                let view = View::pinhole(&camera, w, h);
                let (mut low, mut high) = (Vec2::MAX, Vec2::MIN);
                for p in &points {
                    let at = view.project(view.view_from_scene(*p)).at;
                    let u = at / Vec2::new(w as f32, h as f32) * 2.0 - 1.0;
                    (low, high) = (low.min(u), high.max(u));
                }
                let reach = high.max(-low).max_element();
                assert!((0.95..=0.97).contains(&reach), "the points fill {reach}");
                assert!((low + high).abs().max_element() < 1e-3, "{low} {high}");
            }
        }
    }
}
