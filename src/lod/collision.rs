//! What a body that walks into a tree meets: the stem, without branches, up to where it is thin.
//!
//! *Capsule*: one, about the straight line from root to top. *Convex*: a stack of frusta whose
//! rings are level octagons, each a convex body; a curved stem takes more of them. The octagons
//! hold the stem's circles, so that nothing of it sticks out.

use std::f32::consts::{FRAC_PI_2, PI, TAU};

use glam::{Quat, Vec3};

use crate::mesh::Surface;
use crate::scene::{Collider, ColliderShape};
use crate::skeleton::Skeleton;
use crate::work::{self, Work};

/// The stem ends where it is thinner than this share of its foot.
const THIN: f32 = 0.3;
/// Frusta at most.
const MOST_PIECES: usize = 8;
const SIDES: usize = 8;

/// A place on the stem.
#[derive(Debug, Clone, Copy)]
struct Place {
    at: Vec3,
    radius_m: f32,
}

/// Closed convex bodies, tree-local metres. None for a skeleton
/// without a stem that rises.
pub fn collision(skeleton: &Skeleton, shape: ColliderShape) -> Vec<Collider> {
    work::count(Work::Colliders, 1);
    let stem = stem(skeleton);
    let (Some(&foot), Some(&top)) = (stem.first(), stem.last()) else { return Vec::new() };
    if stem.len() < 2 {
        return Vec::new();
    }
    let bodies = match shape {
        ColliderShape::Capsule => {
            let mean_m = stem.iter().map(|p| p.radius_m).sum::<f32>() / stem.len() as f32;
            vec![capsule(foot.at, top.at, mean_m)]
        }
        ColliderShape::Convex => {
            let kept = straightened(&stem);
            kept.windows(2).map(|w| frustum(w[0], w[1])).collect()
        }
    };
    bodies.into_iter().map(|body| Collider { shape, body }).collect()
}

/// The main axis while it rises and is thick.
fn stem(skeleton: &Skeleton) -> Vec<Place> {
    let mut out: Vec<Place> = Vec::new();
    let Some(&foot_m) = skeleton.radius_m.first() else { return out };
    for i in (0..skeleton.len()).filter(|&i| skeleton.axis[i] == 0) {
        let place = Place { at: skeleton.position[i], radius_m: skeleton.radius_m[i] };
        let rises = out.last().is_none_or(|p| place.at.z > p.at.z + 1e-3);
        if rises && place.radius_m >= THIN * foot_m {
            out.push(place);
        }
    }
    out
}

/// The fewest places between which the stem is straight within half its radius (Ramer 1972).
fn straightened(stem: &[Place]) -> Vec<Place> {
    let mut kept = vec![0, stem.len() - 1];
    while kept.len() <= MOST_PIECES {
        let worst = kept
            .windows(2)
            .flat_map(|w| (w[0] + 1..w[1]).map(move |i| (i, w[0], w[1])))
            .map(|(i, a, b)| (i, off(&stem[i], &stem[a], &stem[b])))
            .max_by(|a, b| a.1.total_cmp(&b.1));
        match worst {
            Some((i, off)) if off > 0.5 => kept.push(i),
            _ => break,
        }
        kept.sort_unstable();
    }
    kept.into_iter().map(|i| stem[i]).collect()
}

/// How far a place is from the frustum between two others, in its own radii.
fn off(p: &Place, a: &Place, b: &Place) -> f32 {
    let t = (p.at.z - a.at.z) / (b.at.z - a.at.z).max(1e-6);
    let radius_m = a.radius_m + (b.radius_m - a.radius_m) * t;
    (p.at.distance(a.at.lerp(b.at, t)) + (p.radius_m - radius_m).abs()) / p.radius_m.max(1e-6)
}

fn frustum(a: Place, b: Place) -> Surface {
    let mut out = Surface::default();
    // The octagon about the circle.
    let about = 1.0 / (PI / SIDES as f32).cos();
    for p in [a, b] {
        out.position.extend((0..SIDES).map(|k| {
            let (sin, cos) = (k as f32 / SIDES as f32 * TAU).sin_cos();
            p.at + Vec3::new(cos, sin, 0.0) * (p.radius_m * about)
        }));
    }
    let n = SIDES as u32;
    for k in 0..n {
        let (p, q) = (k, (k + 1) % n);
        out.index.extend([p, q, q + n, p, q + n, p + n]);
    }
    for k in 1..n - 1 {
        out.index.extend([0, k + 1, k, n, n + k, n + k + 1]);
    }
    out
}

/// A cylinder with half spheres on its ends, which are `a` and `b`.
fn capsule(a: Vec3, b: Vec3, radius_m: f32) -> Surface {
    const RINGS: usize = 3;
    let mut out = Surface::default();
    let turn = Quat::from_rotation_arc(Vec3::Z, (b - a).normalize_or(Vec3::Z));
    // Latitudes from below to above, the poles left out; the two equators are apart.
    let latitude = |k: usize| -FRAC_PI_2 + FRAC_PI_2 * k as f32 / RINGS as f32;
    let rings =
        (1..=RINGS).map(|k| (a, latitude(k))).chain((RINGS..2 * RINGS).map(|k| (b, latitude(k))));
    out.position.push(a - turn * Vec3::Z * radius_m);
    for (end, latitude) in rings {
        let (rise, reach) = latitude.sin_cos();
        out.position.extend((0..SIDES).map(|k| {
            let (sin, cos) = (k as f32 / SIDES as f32 * TAU).sin_cos();
            end + turn * Vec3::new(cos * reach, sin * reach, rise) * radius_m
        }));
    }
    out.position.push(b + turn * Vec3::Z * radius_m);
    let (n, last) = (SIDES as u32, out.position.len() as u32 - 1);
    let ring = |r: u32, k: u32| 1 + r * n + k % n;
    for k in 0..n {
        out.index.extend([0, ring(0, k + 1), ring(0, k)]);
        for r in 0..2 * RINGS as u32 - 1 {
            let [p, q] = [ring(r, k), ring(r, k + 1)];
            let [s, t] = [ring(r + 1, k), ring(r + 1, k + 1)];
            out.index.extend([p, q, t, p, t, s]);
        }
        let top = 2 * RINGS as u32 - 1;
        out.index.extend([last, ring(top, k), ring(top, k + 1)]);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::skeleton::NO_PARENT;

    fn stem(bend: f32) -> Skeleton {
        let n = 20;
        Skeleton {
            position: (0..n)
                .map(|i| {
                    let z = i as f32 * 0.5;
                    Vec3::new(bend * (z * 0.6).sin(), 0.0, z)
                })
                .collect(),
            parent: (0..n).map(|i| if i == 0 { NO_PARENT } else { i - 1 }).collect(),
            radius_m: (0..n).map(|i| 0.3 * (1.0 - i as f32 / 30.0)).collect(),
            axis: vec![0; n as usize],
            order: vec![0; n as usize],
            birth: vec![0; n as usize],
            dead: Vec::new(),
        }
    }

    /// No corner lies outside the plane of any face.
    fn is_convex(s: &Surface) -> bool {
        s.index.chunks_exact(3).all(|t| {
            let [a, b, c] = [0, 1, 2].map(|k| s.position[t[k] as usize]);
            let normal = (b - a).cross(c - a).normalize();
            s.position.iter().all(|p| (*p - a).dot(normal) < 1e-4)
        })
    }

    #[test]
    fn every_body_is_convex_closed_and_holds_the_stem() {
        for bend in [0.0, 0.4, 1.5] {
            let s = stem(bend);
            for shape in [ColliderShape::Capsule, ColliderShape::Convex] {
                let bodies = collision(&s, shape);
                assert!(!bodies.is_empty() && bodies.len() <= MOST_PIECES);
                for b in &bodies {
                    assert!(is_convex(&b.body), "{shape:?} {bend}");
                    assert!(b.body.volume_m3() > 0.0);
                }
            }
        }
        let straight = collision(&stem(0.0), ColliderShape::Convex);
        assert_eq!(straight.len(), 1, "a straight stem is one body");
        let volume = straight[0].body.volume_m3();
        let cones = std::f64::consts::PI * 9.5 / 3.0 * (0.09 + 0.3 * 0.11 + 0.11f64.powi(2));
        assert!(volume > cones && volume < 1.12 * cones, "{volume} {cones}");
        assert!(collision(&stem(1.5), ColliderShape::Convex).len() > 1, "a bent one is several");
    }

    #[test]
    fn a_capsule_has_its_volume() {
        let s = capsule(Vec3::ZERO, Vec3::new(0.0, 3.0, 4.0), 0.5);
        let truth = std::f64::consts::PI * 0.25 * (5.0 + 2.0 / 3.0);
        assert!((s.volume_m3() / truth - 0.9).abs() < 0.1, "{}", s.volume_m3());
    }
}
