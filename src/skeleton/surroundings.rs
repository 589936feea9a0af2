//! What a tree can't grow into: ground, walls, and the crowns of its neighbours.
//!
//! Two crowns that overlap are parted where their relative radii are equal: a place belongs to the
//! tree whose axis is nearest in units of that tree's crown radius.
//!
//! Limit: walls stop a shoot wherever it would cross them; ground and neighbours, whose borders
//! are curved, are looked for at its end and at three places on the way.

use glam::{Vec2, Vec3};

/// Where wood may be.
pub trait Space {
    /// Whether wood may be at a place.
    fn is_free(&self, p: Vec3) -> bool;

    /// What a shoot from `from` to `to` would enter: its unit normal, which points out of it.
    fn meets(&self, from: Vec3, to: Vec3) -> Option<Vec3>;
}

/// Space without obstacles.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Open;

impl Space for Open {
    #[inline]
    fn is_free(&self, _: Vec3) -> bool {
        true
    }

    #[inline]
    fn meets(&self, _: Vec3, _: Vec3) -> Option<Vec3> {
        None
    }
}

/// A solid with flat faces.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Wall {
    /// All behind a plane; the normal points to the free side.
    Behind { point: Vec3, normal: Vec3 },
    /// An upright box, turned by `yaw_rad` from east towards north.
    Box { centre: Vec3, half_m: Vec3, yaw_rad: f32 },
}

/// Another tree, as far as it takes up room.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Neighbour {
    /// Its root collar in the coordinates of the tree that grows.
    pub root: Vec3,
    pub height_m: f32,
    /// Height of its lowest branches above its root.
    pub crown_base_m: f32,
    pub crown_radius_m: f32,
}

/// Everything about a tree that bounds its growth, in its own coordinates (root collar at the
/// origin, Z up, metres).
#[derive(Clone, Default)]
pub struct Surroundings<'a> {
    /// Height of the ground at x, y.
    pub ground: Option<&'a (dyn Fn(Vec2) -> f32 + Sync)>,
    pub walls: Vec<Wall>,
    /// Crown radius of the tree itself, which parts it from its neighbours.
    pub crown_radius_m: f32,
    pub neighbours: Vec<Neighbour>,
}

/// Least crown radius that counts; below it the border runs close by the axis.
const LEAST_RADIUS_M: f32 = 1e-3;
/// Places on a shoot at which curved borders are looked for.
const LOOKS: [f32; 4] = [0.25, 0.5, 0.75, 1.0];

impl Surroundings<'static> {
    /// A tree that stands alone.
    pub fn none() -> Self {
        Surroundings::default()
    }
}

impl Surroundings<'_> {
    pub fn is_none(&self) -> bool {
        self.ground.is_none() && self.walls.is_empty() && self.neighbours.is_empty()
    }

    /// Whether wood of this tree may be at `p`.
    pub fn is_free(&self, p: Vec3) -> bool {
        self.ground.is_none_or(|height_m| p.z >= height_m(p.truncate()))
            && !self.walls.iter().any(|w| w.holds(p))
            && !self.neighbours.iter().any(|n| n.owns(p, self.crown_radius_m))
    }

    /// The normal of the ground at x, y, over 10 cm.
    fn ground_normal(height_m: &dyn Fn(Vec2) -> f32, at: Vec2) -> Vec3 {
        let d = 0.05;
        let rise = |side: Vec2| (height_m(at + side * d) - height_m(at - side * d)) / (2.0 * d);
        Vec3::new(-rise(Vec2::X), -rise(Vec2::Y), 1.0).normalize_or(Vec3::Z)
    }
}

impl Space for Surroundings<'_> {
    fn is_free(&self, p: Vec3) -> bool {
        Surroundings::is_free(self, p)
    }

    fn meets(&self, from: Vec3, to: Vec3) -> Option<Vec3> {
        if let Some(normal) = self.walls.iter().find_map(|w| w.entered(from, to)) {
            return Some(normal);
        }
        if self.ground.is_none() && self.neighbours.is_empty() {
            return None;
        }
        LOOKS.into_iter().find_map(|t| {
            let p = from.lerp(to, t);
            match self.ground {
                Some(height_m) if p.z < height_m(p.truncate()) => {
                    Some(Self::ground_normal(height_m, p.truncate()))
                }
                _ => self
                    .neighbours
                    .iter()
                    .find(|n| n.owns(p, self.crown_radius_m))
                    .map(|n| n.border_normal(p, self.crown_radius_m)),
            }
        })
    }
}

impl Wall {
    /// Whether `p` is inside; the surface is not.
    pub fn holds(&self, p: Vec3) -> bool {
        match *self {
            Wall::Behind { point, normal } => (p - point).dot(normal) < 0.0,
            Wall::Box { centre, half_m, yaw_rad } => {
                (turned(p - centre, -yaw_rad).abs()).cmplt(half_m).all()
            }
        }
    }

    /// The normal of the face through which a segment enters; from inside, of the nearest face.
    fn entered(&self, from: Vec3, to: Vec3) -> Option<Vec3> {
        match *self {
            Wall::Behind { normal, .. } => {
                (self.holds(to) || self.holds(from)).then(|| normal.normalize_or(Vec3::Z))
            }
            Wall::Box { centre, half_m, yaw_rad } => {
                let (a, b) = (turned(from - centre, -yaw_rad), turned(to - centre, -yaw_rad));
                let way = b - a;
                let (mut enter, mut leave) = (f32::NEG_INFINITY, f32::INFINITY);
                let mut face = Vec3::Z;
                for (k, axis) in [Vec3::X, Vec3::Y, Vec3::Z].into_iter().enumerate() {
                    if way[k] == 0.0 {
                        if a[k].abs() >= half_m[k] {
                            return None;
                        }
                        continue;
                    }
                    let near = (-half_m[k] * way[k].signum() - a[k]) / way[k];
                    let far = (half_m[k] * way[k].signum() - a[k]) / way[k];
                    if near > enter {
                        enter = near;
                        face = -axis * way[k].signum();
                    }
                    leave = leave.min(far);
                }
                let is_met = enter < leave && enter < 1.0 && leave > 0.0;
                is_met.then(|| turned(face, yaw_rad))
            }
        }
    }
}

/// About the vertical, from east towards north.
fn turned(p: Vec3, yaw_rad: f32) -> Vec3 {
    (glam::Vec2::from_angle(yaw_rad).rotate(p.truncate())).extend(p.z)
}

impl Neighbour {
    /// Whether a place is in this crown and nearer to its axis, in crown radii, than to the axis
    /// of a tree at the origin of that crown radius.
    fn owns(&self, p: Vec3, crown_radius_m: f32) -> bool {
        let above = p.z - self.root.z;
        if above < self.crown_base_m || above > self.height_m {
            return false;
        }
        let theirs = p.truncate().distance(self.root.truncate());
        let theirs = theirs / self.crown_radius_m.max(LEAST_RADIUS_M);
        theirs <= 1.0 && theirs < p.truncate().length() / crown_radius_m.max(LEAST_RADIUS_M)
    }

    /// Out of this crown, level: against the gradient of what `owns` compares.
    fn border_normal(&self, p: Vec3, crown_radius_m: f32) -> Vec3 {
        let away = |root: Vec2, radius_m: f32| {
            (p.truncate() - root).normalize_or_zero() / radius_m.max(LEAST_RADIUS_M)
        };
        let out = away(self.root.truncate(), self.crown_radius_m);
        let gradient = out - away(Vec2::ZERO, crown_radius_m);
        gradient.try_normalize().or_else(|| out.try_normalize()).unwrap_or(Vec2::X).extend(0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn close(a: Option<Vec3>, b: Vec3) -> bool {
        a.is_some_and(|a| (a - b).length() < 1e-5)
    }

    #[test]
    fn nothing_about_is_free_everywhere() {
        let alone = Surroundings::none();
        assert!(alone.is_none() && alone.is_free(Vec3::new(0.0, 0.0, -5.0)));
        assert_eq!(alone.meets(Vec3::ZERO, Vec3::splat(-9.0)), None);
    }

    #[test]
    fn a_plane_is_solid_behind() {
        let wall = Wall::Behind { point: Vec3::X * 2.0, normal: -Vec3::X };
        let s = Surroundings { walls: vec![wall], ..Surroundings::none() };
        assert!(s.is_free(Vec3::X * 1.9) && !s.is_free(Vec3::X * 2.1));
        assert!(close(s.meets(Vec3::ZERO, Vec3::X * 3.0), -Vec3::X));
        assert_eq!(s.meets(Vec3::ZERO, Vec3::new(1.0, 90.0, 0.0)), None);
    }

    #[test]
    fn a_box_is_met_by_its_face_even_where_a_shoot_passes_through() {
        let wall = Wall::Box {
            centre: Vec3::new(4.0, 0.0, 1.0),
            half_m: Vec3::new(0.1, 2.0, 1.0),
            yaw_rad: 0.0,
        };
        let s = Surroundings { walls: vec![wall], ..Surroundings::none() };
        let through = s.meets(Vec3::new(3.0, 0.0, 1.0), Vec3::new(5.0, 0.0, 1.0));
        assert!(close(through, -Vec3::X));
        let over = s.meets(Vec3::new(3.0, 0.0, 2.1), Vec3::new(5.0, 0.0, 2.1));
        assert_eq!(over, None);
        let down = s.meets(Vec3::new(4.0, 0.0, 2.5), Vec3::new(4.0, 0.0, 1.5));
        assert!(close(down, Vec3::Z));
        assert_eq!(s.meets(Vec3::new(4.0, 3.0, 1.0), Vec3::new(4.0, 3.0, -9.0)), None);
        // Turned a quarter, the same wall runs east and west.
        let Wall::Box { centre, half_m, .. } = wall else { unreachable!() };
        let yaw_rad = std::f32::consts::FRAC_PI_2;
        let turned = Wall::Box { centre, half_m, yaw_rad };
        assert!(turned.holds(Vec3::new(2.1, 0.0, 1.0)) && !turned.holds(Vec3::new(4.0, 1.0, 1.0)));
        let from_south = turned.entered(Vec3::new(3.0, -1.0, 1.0), Vec3::new(3.0, 1.0, 1.0));
        assert!(close(from_south, -Vec3::Y));
    }

    #[test]
    fn ground_rises_where_its_function_says() {
        let slope = |p: Vec2| 0.5 * p.x;
        let s = Surroundings { ground: Some(&slope), ..Surroundings::none() };
        assert!(s.is_free(Vec3::new(2.0, 0.0, 1.1)) && !s.is_free(Vec3::new(2.0, 0.0, 0.9)));
        let met = s.meets(Vec3::new(0.0, 0.0, 0.5), Vec3::new(4.0, 0.0, 0.5));
        assert!(close(met, Vec3::new(-0.5, 0.0, 1.0).normalize()));
    }

    #[test]
    fn crowns_are_parted_where_relative_radii_are_equal() {
        let neighbour = Neighbour {
            root: Vec3::X * 6.0,
            height_m: 20.0,
            crown_base_m: 5.0,
            crown_radius_m: 4.0,
        };
        let s = Surroundings {
            crown_radius_m: 2.0 * 4.0,
            neighbours: vec![neighbour],
            ..Surroundings::none()
        };
        // Twice as wide, so two thirds of the way.
        assert!(s.is_free(Vec3::new(3.9, 0.0, 10.0)) && !s.is_free(Vec3::new(4.1, 0.0, 10.0)));
        assert!(s.is_free(Vec3::new(6.0, 0.0, 4.0)) && s.is_free(Vec3::new(6.0, 0.0, 21.0)));
        // Beyond the neighbour's crown nobody is in the way.
        assert!(s.is_free(Vec3::new(11.0, 0.0, 10.0)));
        let met = s.meets(Vec3::new(3.0, 0.0, 10.0), Vec3::new(5.0, 0.0, 10.0));
        assert!(close(met, -Vec3::X), "{met:?}");
        // Seen from the neighbour the border is the same.
        let other = Surroundings {
            crown_radius_m: 4.0,
            neighbours: vec![Neighbour { root: Vec3::X * -6.0, crown_radius_m: 8.0, ..neighbour }],
            ..Surroundings::none()
        };
        assert!(!other.is_free(Vec3::new(-2.1, 0.0, 10.0)));
        assert!(other.is_free(Vec3::new(-1.9, 0.0, 10.0)));
    }
}
