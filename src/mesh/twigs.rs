//! Twigs that are stored once a form and stand at many places: every needle of a crown, in the bytes of
//! a few twigs.

use glam::{Quat, Vec2, Vec3};
use rayon::prelude::*;

use super::Surface;
use crate::diagnostic::{Error, Result};

/// One form of a twig, its foot at the origin, and where it stands.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Twigs {
    pub form: Surface,
    pub places: Vec<Place>,
}

/// Scaled, then turned, then moved.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Place {
    pub position: Vec3,
    /// Unit length.
    pub turn: Quat,
    pub scale: f32,
}

impl Place {
    pub fn of(&self, p: Vec3) -> Vec3 {
        self.position + self.turn * (p * self.scale)
    }
}

/// A sphere.
#[derive(Debug, Clone, Copy)]
struct Ball {
    centre: Vec3,
    radius_m: f32,
}

impl Ball {
    fn around(surface: &Surface) -> Ball {
        let (low, high) = surface.bounds();
        let centre = 0.5 * low + 0.5 * high;
        let farthest = surface.position.iter().map(|p| p.distance_squared(centre));
        Ball { centre, radius_m: farthest.fold(0.0, f32::max).sqrt() }
    }

    /// A little larger, for what rounding does.
    fn at(self, place: &Place) -> Ball {
        Ball { centre: place.of(self.centre), radius_m: self.radius_m * place.scale * 1.001 }
    }
}

impl Twigs {
    /// Triangles of all of them in their places.
    pub fn shown_triangles(&self) -> usize {
        self.form.triangles() * self.places.len()
    }

    /// Where the tips of all of them are.
    pub(super) fn tips(&self) -> impl Iterator<Item = Vec3> + '_ {
        tips(&self.form, &self.places)
    }

    /// Scales all about the origin.
    pub(super) fn scale(&mut self, factor: f32) {
        for place in &mut self.places {
            place.position *= factor;
            place.scale *= factor;
        }
    }

    /// Drops those that hang into the ground, which is z = 0.
    pub(super) fn clear_ground(&mut self) {
        let ball = Ball::around(&self.form);
        let form = &self.form.position;
        self.places.retain(|place| {
            let Ball { centre, radius_m } = ball.at(place);
            centre.z >= radius_m || form.iter().all(|p| place.of(*p).z >= 0.0)
        });
    }

    /// A sound form, and places that are finite.
    pub fn check(&self) -> Result<()> {
        self.form.check()?;
        let is_sound = |p: &Place| {
            let is_finite = p.position.is_finite() && p.scale.is_finite() && p.scale > 0.0;
            is_finite && p.turn.is_normalized()
        };
        match self.places.iter().position(|p| !is_sound(p)) {
            None => Ok(()),
            Some(at) => Err(Error::new(format!("place {at} of a twig: {:?}", self.places[at]))),
        }
    }
}

/// Where the vertex of a form is that is farthest from its foot.
fn tips<'a>(form: &Surface, places: &'a [Place]) -> impl Iterator<Item = Vec3> + use<'a> {
    let far = |p: &&Vec3| p.length_squared();
    let tip = form.position.iter().max_by(|a, b| far(a).total_cmp(&far(b)));
    let tip = tip.copied().unwrap_or_default();
    places.iter().map(move |place| place.of(tip))
}

/// Level ways in which twigs are sought that reach farthest.
const WAYS: usize = 16;

/// Vertices of forms in their places: all that are corners of the convex hull in plan, or highest or
/// lowest, and few others. What lies within the polygon of the farthest tips is none of these (Akl &
/// Toussaint 1978).
pub fn outer(forms: &[(&Surface, &[Place])]) -> Vec<Vec3> {
    let ways: [Vec2; WAYS] =
        std::array::from_fn(|k| Vec2::from_angle(k as f32 * (std::f32::consts::TAU / WAYS as f32)));
    /// The farthest tip each way, and the lowest and highest.
    #[derive(Clone, Copy)]
    struct Far {
        out: [(f32, Vec2); WAYS],
        low: f32,
        high: f32,
    }
    let nowhere = Far {
        out: [(f32::NEG_INFINITY, Vec2::ZERO); WAYS],
        low: f32::INFINITY,
        high: f32::NEG_INFINITY,
    };
    let farther = |a: Far, b: Far| Far {
        out: std::array::from_fn(|k| if b.out[k].0 > a.out[k].0 { b.out[k] } else { a.out[k] }),
        low: a.low.min(b.low),
        high: a.high.max(b.high),
    };
    let mut far = nowhere;
    for (form, places) in forms {
        for p in tips(form, places) {
            let flat = p.truncate();
            let out = ways.map(|way| (way.dot(flat), flat));
            far = farther(far, Far { out, low: p.z, high: p.z });
        }
    }
    let is_within = |ball: Ball| {
        let Ball { centre, radius_m } = ball;
        let is_level = centre.z - radius_m >= far.low && centre.z + radius_m <= far.high;
        // The farthest, way by way, are a polygon's corners counter-clockwise.
        is_level
            && (0..WAYS).all(|k| {
                let (p, q) = (far.out[k].1, far.out[(k + 1) % WAYS].1);
                let side = q - p;
                side == Vec2::ZERO
                    || side.perp_dot(centre.truncate() - p) >= radius_m * side.length()
            })
    };
    let of = |&(form, places): &(&Surface, &[Place])| {
        let ball = Ball::around(form);
        let places = places.iter().filter(|place| !is_within(ball.at(place)));
        places.flat_map(|place| form.position.iter().map(|p| place.of(*p))).collect::<Vec<_>>()
    };
    forms.par_iter().flat_map_iter(of).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::seed::Seed;

    #[test]
    fn outer_vertices_bound_all() {
        let mut draws = Seed::new(4).draws();
        let mut form = Surface::default();
        for k in 0..60 {
            form.position.push(draws.direction() * draws.unit() * 0.4 + Vec3::X * 0.1);
            form.normal.push(Vec3::Z);
            form.uv.push(Vec2::ZERO);
            form.index.push(k);
        }
        let place = |_| Place {
            position: draws.direction() * draws.unit().cbrt() * Vec3::new(4.0, 3.0, 8.0),
            turn: Quat::from_axis_angle(draws.direction(), draws.between(0.0, 3.0)),
            scale: draws.between(0.5, 1.5),
        };
        let places: Vec<Place> = (0..4_000).map(place).collect();
        let all = places.iter().flat_map(|at| form.position.iter().map(|p| at.of(*p)));
        let all: Vec<Vec3> = all.collect();
        let outer = outer(&[(&form, &places)]);
        assert!(!outer.is_empty() && 2 * outer.len() < all.len(), "{} {}", outer.len(), all.len());
        for k in 0..360 {
            let way = Vec2::from_angle((k as f32).to_radians());
            let reach = |points: &[Vec3]| {
                points.iter().map(|p| way.dot(p.truncate())).fold(f32::NEG_INFINITY, f32::max)
            };
            assert_eq!(reach(&outer), reach(&all), "{k}");
        }
        let levels = |points: &[Vec3]| {
            points.iter().fold((0.0f32, 0.0f32), |(l, h), p| (l.min(p.z), h.max(p.z)))
        };
        assert_eq!(levels(&outer), levels(&all));
    }

    #[test]
    fn twigs_in_the_ground_are_dropped() {
        let form = Surface {
            position: vec![Vec3::ZERO, Vec3::X, Vec3::X + Vec3::Y * 0.1],
            normal: vec![Vec3::Z; 3],
            uv: vec![Vec2::ZERO; 3],
            index: vec![0, 1, 2],
            ..Surface::default()
        };
        let down = Quat::from_rotation_y(std::f32::consts::FRAC_PI_2);
        let at = |z: f32, turn: Quat| Place { position: Vec3::Z * z, turn, scale: 1.0 };
        let level = Quat::IDENTITY;
        let places = vec![at(0.1, level), at(0.9, down), at(1.1, down)];
        let mut twigs = Twigs { form, places };
        twigs.clear_ground();
        assert_eq!(twigs.places, [at(0.1, level), at(1.1, down)]);
        twigs.check().unwrap();
        twigs.places[0].scale = 0.0;
        assert!(twigs.check().is_err());
    }
}
