//! What a body that walks into a tree meets: its stems, without branches, up to where they are thin.
//! Beside the main one these are the thickest that spring near the ground and rise.
//!
//! *Capsule*: one a stem, about the straight line from root to top, as thick as the stem is where one walks
//! into it. *Convex*: a stack of frusta whose rings are level octagons about the stem's circles, each a convex
//! body; the more it bends and the less it tapers evenly, the more of them, up to eight. Between their rings the
//! stem is off their axes by up to half its radius. Three more hold the flare of its foot, and what of it is
//! below ground.

use std::f32::consts::{FRAC_PI_2, PI, TAU};

use glam::{Quat, Vec3};

use crate::mesh::{BELOW_GROUND_M, BURIED, FLARE, FLARED, LOBED, Surface};
use crate::scene::{Collider, ColliderShape};
use crate::skeleton::Skeleton;
use crate::work::{self, Work};

/// The stem ends where it is thinner than this share of its foot.
const THIN: f32 = 0.3;
/// What springs below this share of the height may be a stem, and a stem that ends there is a stool.
const STOOL: f32 = 0.2;
/// Sine of the least rise of a stem that is not the main one, and most of these.
const STEEP: f32 = 0.5;
const MOST_STEMS: usize = 6;
/// Stems beside the main one that are thinner at the foot give way.
const LEAST_RADIUS_M: f32 = 0.025;
/// What a stem's axis may be off that of its frusta, share of its radius and metres, whichever is more; and its
/// radius off theirs.
const ASIDE: (f32, f32) = (0.5, 0.05);
const THICKER: (f32, f32) = (0.08, 0.01);
/// Frusta of a stem at most.
const MOST_PIECES: usize = 8;
const SIDES: usize = 8;

/// A place on the stem.
#[derive(Debug, Clone, Copy)]
struct Place {
    at: Vec3,
    radius_m: f32,
}

/// Where bodies about a stem's foot meet and end, share of its flare's height.
const FLARE_HELD: [f32; 3] = [0.0, 0.28, 0.75];

/// How high above its foot a stem is met, and share of its height at most.
const MET_M: f32 = 1.3;
const MET: f32 = 0.3;

/// Closed convex bodies, tree-local metres. None for a skeleton
/// without a stem that rises.
pub fn collision(skeleton: &Skeleton, shape: ColliderShape) -> Vec<Collider> {
    work::count(Work::Colliders, 1);
    let stems = stems(skeleton);
    let height_m = skeleton.height_m();
    let is_flared = |k: usize| k == 0 && !is_stool(&stems[0], height_m);
    let bodies = stems.iter().enumerate().flat_map(|(k, stem)| match shape {
        ColliderShape::Capsule => capsule_about(stem, is_flared(k)).into_iter().collect(),
        ColliderShape::Convex => {
            let foot = if is_flared(k) { flare(stem, height_m) } else { Vec::new() };
            let kept = straightened(stem);
            foot.into_iter().chain(kept.windows(2).map(|w| frustum(w[0], w[1]))).collect::<Vec<_>>()
        }
    });
    bodies.map(|body| Collider { shape, body }).collect()
}

/// Whether the main stem of a tree so high is but a stool.
fn is_stool(main: &[Place], height_m: f32) -> bool {
    main.last().is_some_and(|top| top.at.z < STOOL * height_m)
}

/// How much wider a stem is for its flare, of whose height a share is still above; and where its lobes stand out.
fn flared(up: f32) -> [f32; 2] {
    let wider = 1.0 + FLARED * up * up * up;
    [wider, wider * (1.0 + LOBED * up * up)]
}

/// What holds the flare of a stem that stands in the ground: it narrows faster the nearer to that.
fn flare(stem: &[Place], height_m: f32) -> Vec<Surface> {
    let [foot, _, ..] = stem else { return Vec::new() };
    let above = |share: f32| {
        let held_m = share * FLARE * foot.radius_m;
        let next = stem.partition_point(|p| p.at.z <= foot.at.z + held_m).clamp(1, stem.len() - 1);
        let [low, high] = [stem[next - 1], stem[next]];
        let t = (foot.at.z + held_m - low.at.z) / (high.at.z - low.at.z).max(1e-6);
        let mix = |a: f32, b: f32| a + (b - a) * t.clamp(0.0, 1.0);
        // The flare widens what the stem is there.
        let radius_m = mix(low.radius_m, high.radius_m) * flared(1.0 - share)[1];
        Place { at: low.at.lerp(high.at, t.clamp(0.0, 1.0)), radius_m }
    };
    let [ground, middle, high] = FLARE_HELD.map(above);
    let below = Place {
        at: foot.at - Vec3::Z * BELOW_GROUND_M.min(0.1 * height_m),
        radius_m: ground.radius_m * BURIED,
    };
    [below, ground, middle, high].windows(2).map(|w| frustum(w[0], w[1])).collect()
}

fn capsule_about(stem: &[Place], is_flared: bool) -> Option<Surface> {
    let [foot, .., top] = stem else { return None };
    let met_m = MET_M.min(MET * (top.at.z - foot.at.z));
    let above = stem.partition_point(|p| p.at.z < foot.at.z + met_m).clamp(1, stem.len() - 1);
    let [low, high] = [stem[above - 1], stem[above]];
    let t = (foot.at.z + met_m - low.at.z) / (high.at.z - low.at.z).max(1e-6);
    let radius_m = low.radius_m + (high.radius_m - low.radius_m) * t.clamp(0.0, 1.0);
    let up = (1.0 - met_m / (FLARE * foot.radius_m).max(1e-6)).max(0.0);
    let wider = if is_flared { flared(up)[0] } else { 1.0 };
    Some(capsule(foot.at, top.at, radius_m * wider))
}

/// The main axis, and those that spring from stems near the ground, are as thick as stems and rise.
fn stems(skeleton: &Skeleton) -> Vec<Vec<Place>> {
    let main = stem(skeleton, 0);
    let low_m = STOOL * skeleton.height_m();
    // The first node of every axis that springs low, parents before their branches.
    let springs = |i: &u32| {
        let parent = skeleton.parent_of(*i);
        parent.is_some_and(|p| {
            let is_new = skeleton.axis[p as usize] != skeleton.axis[*i as usize];
            is_new && skeleton.position[p as usize].z < low_m
        })
    };
    let shoots: Vec<u32> = (0..skeleton.len() as u32).filter(springs).collect();
    let radius_m = |i: u32| skeleton.radius_m[i as usize];
    let thickest_m = if is_stool(&main, skeleton.height_m()) {
        shoots.iter().map(|&i| radius_m(i)).fold(0.0, f32::max)
    } else {
        main.first().map_or(0.0, |foot| foot.radius_m)
    };
    let mut found = vec![(main, f32::INFINITY)];
    let mut bears = vec![false; skeleton.axis.iter().max().map_or(1, |&a| a as usize + 1)];
    bears[0] = true;
    for i in shoots {
        let axis = skeleton.axis[i as usize];
        let from = skeleton.parent_of(i).map_or(0, |p| skeleton.axis[p as usize]);
        if !bears[from as usize] || radius_m(i) < LEAST_RADIUS_M.max(THIN * thickest_m) {
            continue;
        }
        let shoot = stem(skeleton, axis);
        if let ([foot, ..], [.., top]) = (&shoot[..], &shoot[..])
            && (top.at - foot.at).normalize_or_zero().z > STEEP
            && top.at.z > low_m
        {
            bears[axis as usize] = true;
            found.push((shoot, radius_m(i)));
        }
    }
    found[1..].sort_by(|a, b| b.1.total_cmp(&a.1));
    found.truncate(1 + MOST_STEMS);
    found.into_iter().map(|(stem, _)| stem).collect()
}

/// An axis from where it springs, while it rises and is thick.
fn stem(skeleton: &Skeleton, axis: u32) -> Vec<Place> {
    let mut out: Vec<Place> = Vec::new();
    let mut foot_m = None;
    let nodes: Vec<usize> = (0..skeleton.len()).filter(|&i| skeleton.axis[i] == axis).collect();
    let is_stool = skeleton.is_stool();
    for (k, &i) in nodes.iter().enumerate() {
        let of_stem = match nodes[k..] {
            [0, next, ..] if is_stool => next,
            _ => i,
        };
        let place = Place { at: skeleton.position[i], radius_m: skeleton.radius_m[of_stem] };
        if foot_m.is_none()
            && let Some(p) = skeleton.parent_of(i as u32)
        {
            out.push(Place { at: skeleton.springs_at(i as u32, p), ..place });
        }
        let rises = out.last().is_none_or(|p| place.at.z > p.at.z + 1e-3);
        if rises && place.radius_m >= THIN * *foot_m.get_or_insert(place.radius_m) {
            out.push(place);
        }
    }
    out
}

/// The fewest places between which the stem is straight enough that nobody who walks into it minds (Ramer 1972);
/// none where it does not rise.
fn straightened(stem: &[Place]) -> Vec<Place> {
    let [_, .., _] = stem else { return Vec::new() };
    let mut kept = vec![0, stem.len() - 1];
    while kept.len() <= MOST_PIECES {
        let worst = kept
            .windows(2)
            .flat_map(|w| (w[0] + 1..w[1]).map(move |i| (i, w[0], w[1])))
            .map(|(i, a, b)| (i, off(&stem[i], &stem[a], &stem[b])))
            .max_by(|a, b| a.1.total_cmp(&b.1));
        match worst {
            Some((i, off)) if off > 1.0 => kept.push(i),
            _ => break,
        }
        kept.sort_unstable();
    }
    kept.into_iter().map(|i| stem[i]).collect()
}

/// How far a place is from the frustum between two others, over how far it may be.
fn off(p: &Place, a: &Place, b: &Place) -> f32 {
    let t = (p.at.z - a.at.z) / (b.at.z - a.at.z).max(1e-6);
    let radius_m = a.radius_m + (b.radius_m - a.radius_m) * t;
    let over = |off_m: f32, (share, least_m): (f32, f32)| off_m / (share * p.radius_m).max(least_m);
    let aside = over(p.at.distance(a.at.lerp(b.at, t)), ASIDE);
    aside.max(over((p.radius_m - radius_m).abs(), THICKER))
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

    fn is_closed(s: &Surface) -> bool {
        let edges = |t: &[u32; 3]| [0, 1, 2].map(|k| (t[k], t[(k + 1) % 3]));
        let edges: Vec<_> = s.index.as_chunks::<3>().0.iter().flat_map(edges).collect();
        edges.iter().all(|&(a, b)| edges.iter().filter(|e| **e == (b, a)).count() == 1)
    }

    /// How far a place is out of some convex bodies; negative within.
    fn outside_m(bodies: &[Collider], p: Vec3) -> f32 {
        let of = |s: &Surface| {
            let planes = s.index.as_chunks::<3>().0.iter().map(|t| {
                let [a, b, c] = t.map(|i| s.position[i as usize]);
                (p - a).dot((b - a).cross(c - a).normalize_or_zero())
            });
            planes.fold(f32::NEG_INFINITY, f32::max)
        };
        bodies.iter().map(|b| of(&b.body)).fold(f32::INFINITY, f32::min)
    }

    /// A tapering stem whose foot swells, as an oak's does.
    #[test]
    fn a_stem_that_tapers_fast_at_its_foot_has_bodies_that_do() {
        let mut s = stem(0.0);
        s.radius_m.iter_mut().zip(&s.position).for_each(|(r, p)| *r *= 1.0 + 0.4 * (-p.z).exp());
        let bodies = collision(&s, ColliderShape::Convex);
        for (p, r) in s.position.iter().zip(&s.radius_m).filter(|(p, _)| p.z > 2.0 && p.z < 9.0) {
            // The middle of a side.
            let (sin, cos) = (PI / SIDES as f32).sin_cos();
            let at = |m: f32| outside_m(&bodies, *p + Vec3::new(cos, sin, 0.0) * m);
            assert!(at(1.1 * r + 0.01) > 0.0 && at(0.9 * r) < 1e-4, "{} of {r}", p.z);
        }
    }

    #[test]
    fn a_stem_that_does_not_rise_has_no_body() {
        let mut s = stem(0.0);
        s.position.iter_mut().for_each(|p| *p = Vec3::X * p.z);
        for shape in [ColliderShape::Capsule, ColliderShape::Convex] {
            assert!(collision(&s, shape).is_empty(), "{shape:?}");
            assert!(collision(&Skeleton::default(), shape).is_empty());
        }
    }

    #[test]
    fn every_body_is_convex_closed_and_holds_the_stem() {
        for bend in [0.0, 0.4, 1.5] {
            let s = stem(bend);
            for shape in [ColliderShape::Capsule, ColliderShape::Convex] {
                let bodies = collision(&s, shape);
                assert!(!bodies.is_empty() && bodies.len() <= 3 + MOST_PIECES);
                for b in &bodies {
                    assert!(is_convex(&b.body), "{shape:?} {bend}");
                    assert!(is_closed(&b.body));
                    assert!(b.body.volume_m3() > 0.0);
                }
            }
            let bodies = collision(&s, ColliderShape::Convex);
            // All of its middle.
            for place in &stems(&s)[0] {
                for side in [Vec3::X, Vec3::Y, Vec3::NEG_X, Vec3::NEG_Y] {
                    let off_m = outside_m(&bodies, place.at + side * (0.4 * place.radius_m));
                    assert!(off_m < 1e-4, "{off_m} at {} of {bend}", place.at);
                }
            }
        }
        let straight = collision(&stem(0.0), ColliderShape::Convex);
        assert_eq!(straight.len(), 4, "a straight stem is one body beside its foot's");
        let volume = straight[3].body.volume_m3();
        let cones = std::f64::consts::PI * 9.5 / 3.0 * (0.09 + 0.3 * 0.11 + 0.11f64.powi(2));
        assert!(volume > cones && volume < 1.12 * cones, "{volume} {cones}");
        assert!(collision(&stem(1.5), ColliderShape::Convex).len() > 4, "a bent one is several");
    }

    /// Whoever walks into a flare is stopped by its bark.
    #[test]
    fn the_bodies_of_a_foot_are_little_wider_than_its_flare() {
        let bodies = collision(&stem(0.0), ColliderShape::Convex);
        // Frusta: a level ring of corners, and another.
        let wide_m = |s: &Surface, z: f32| {
            let [low, high] = [s.position[0], s.position[SIDES]];
            let t = (z - low.z) / (high.z - low.z);
            let across_m = low.x + (high.x - low.x) * t;
            if (0.0..=1.0).contains(&t) { across_m * (PI / SIDES as f32).cos() } else { 0.0 }
        };
        for k in 0..40 {
            let up = 1.0 - 0.02 * k as f32;
            let z = (1.0 - up) * FLARE * 0.3;
            let bark_m = 0.3 * flared(up)[1];
            let held_m = bodies.iter().map(|b| wide_m(&b.body, z)).fold(0.0, f32::max);
            assert!(held_m < 1.1 * bark_m, "{held_m} about {bark_m} at {z}");
        }
    }

    /// A player is to be stopped by the bark, not within it: at the height of a chest, flare and all.
    #[test]
    fn a_capsule_is_as_thick_as_the_stem_where_one_walks_into_it() {
        let of = |thicker: f32| {
            let mut s = stem(0.0);
            s.radius_m.iter_mut().for_each(|r| *r *= thicker);
            let bodies = collision(&s, ColliderShape::Capsule);
            assert_eq!(bodies.len(), 1);
            let wide = bodies[0].body.position.iter().map(|p| p.truncate().length());
            wide.fold(0.0, f32::max)
        };
        // Radii fall by a thirtieth of the foot's each half metre.
        let at_chest = 0.3 * (1.0 - 2.6 / 30.0);
        assert!((of(1.0) - at_chest).abs() < 0.005, "{}", of(1.0));
        // The flare of a foot of 0.9 m ends at four metres.
        let up: f32 = 1.0 - 1.3 / (0.9 * FLARE);
        let flared = 1.0 + FLARED * up.powi(3);
        assert!((of(3.0) - 3.0 * at_chest * flared).abs() < 0.005, "{}", of(3.0));
    }

    #[test]
    fn shrubs_have_a_body_for_each_of_their_stems() {
        // A stool of half a metre with three stems of 4 m and a twig.
        let p = |x: f32, z: f32| Vec3::new(x, 0.0, z);
        let s = Skeleton {
            position: vec![
                p(0.0, 0.0),
                p(0.0, 0.5),
                p(1.0, 4.0),
                p(-1.0, 4.0),
                p(0.5, 4.0),
                p(0.2, 1.0),
            ],
            parent: vec![NO_PARENT, 0, 1, 1, 1, 1],
            radius_m: vec![0.2, 0.15, 0.04, 0.04, 0.03, 0.002],
            axis: vec![0, 0, 1, 2, 3, 4],
            order: vec![0, 0, 1, 1, 1, 1],
            birth: vec![0; 6],
            dead: Vec::new(),
        };
        s.check().unwrap();
        for shape in [ColliderShape::Capsule, ColliderShape::Convex] {
            let bodies = collision(&s, shape);
            assert_eq!(bodies.len(), 4, "stool and three stems, no twig");
            let top = bodies.iter().map(|b| b.body.bounds().1.z).fold(0.0, f32::max);
            assert!(top >= 4.0, "{top}");
            assert!(bodies.iter().all(|b| is_convex(&b.body)));
        }
    }

    #[test]
    fn stems_that_stand_apart_have_bodies_that_do() {
        let p = |x: f32, z: f32| Vec3::new(x, 0.0, z);
        let s = Skeleton {
            position: vec![p(0.0, 0.0), p(0.0, 0.5), p(0.0, 4.0), p(0.3, 0.5), p(0.3, 3.5)],
            parent: vec![NO_PARENT, 0, 1, 0, 3],
            radius_m: vec![0.2, 0.05, 0.04, 0.05, 0.04],
            axis: vec![0, 0, 0, 1, 1],
            order: vec![0, 0, 0, 1, 1],
            birth: vec![0; 5],
            dead: Vec::new(),
        };
        s.check().unwrap();
        for shape in [ColliderShape::Capsule, ColliderShape::Convex] {
            let bodies = collision(&s, shape);
            let bounds: Vec<_> = bodies.iter().map(|b| b.body.bounds()).collect();
            let [feet @ .., first, second] = &bounds[..] else { panic!("{shape:?}") };
            assert_eq!(feet.len(), if shape == ColliderShape::Convex { 3 } else { 0 });
            assert!(first.1.x < 0.1 && second.0.x > 0.2, "{shape:?} {bounds:?}");
            assert!(feet.iter().all(|foot| foot.1.x < 0.2), "{shape:?} {bounds:?}");
        }
    }

    #[test]
    fn every_stem_of_every_species_has_a_body() {
        use crate::skeleton::{Detail, Target, grow};
        let (mut bare, mut all, mut are_right) = (0, 0, true);
        for name in crate::species::builtin_names() {
            for seed in 1..=3 {
                let s = crate::species::load(name).unwrap();
                let target = Target::FromSpecies { height_m: None };
                let tree = grow(&s, target, Detail::HERO, crate::seed::Seed::new(seed)).unwrap();
                let bodies = collision(&tree, ColliderShape::Convex);
                let boxes: Vec<_> = bodies.iter().map(|b| b.body.bounds()).collect();
                let holds = |p: Vec3| {
                    boxes
                        .iter()
                        .any(|&(lo, hi)| p.cmpge(lo - 0.05).all() && p.cmple(hi + 0.05).all())
                };
                // Wood a fifth of the way up, half as thick as the thickest there, but no twigs.
                let band = [0.18, 0.22].map(|share| share * tree.height_m());
                let in_band = |i: &usize| (band[0]..band[1]).contains(&tree.position[*i].z);
                let wood: Vec<usize> = (0..tree.len()).filter(in_band).collect();
                let most_m = wood.iter().map(|&i| tree.radius_m[i]).fold(0.0, f32::max);
                let thick_m = (0.5 * most_m).max(0.015);
                let thick = || wood.iter().filter(|&&i| tree.radius_m[i] >= thick_m);
                let held = thick().filter(|&&i| holds(tree.position[i])).count();
                let stems = stems(&tree).len();
                bare += thick().count() - held;
                all += thick().count();
                are_right &= match name {
                    "salix_caprea" | "corylus_avellana" => stems >= 3,
                    "table3/08" => true,
                    _ => stems <= 2,
                };
            }
        }
        assert!(are_right && bare * 20 <= all, "{bare} of {all}");
    }

    /// What there is of bark near the ground, below it too, lies in a body.
    #[test]
    fn the_foot_of_a_stem_is_held() {
        use crate::mesh::{self, FoliageLevel, MeshOptions};
        use crate::skeleton::{Detail, Target, grow};
        for name in ["tilia_cordata", "pinus_sibirica", "quercus_robur", "betula_pendula"] {
            let species = crate::species::load(name).unwrap();
            let target = Target::FromSpecies { height_m: None };
            let seed = crate::seed::Seed::new(3);
            let tree = grow(&species, target, Detail::HERO, seed).unwrap();
            let options = MeshOptions { foliage: FoliageLevel::None, ..MeshOptions::HERO };
            let atlas = crate::texture::Atlas::whole(0.3);
            let mesh = mesh::build(&tree, &species, &atlas, &options, seed).unwrap();
            let bodies = collision(&tree, ColliderShape::Convex);
            let low = mesh.wood.position.iter().filter(|p| p.z < 1.0);
            let worst_m = low.map(|p| outside_m(&bodies, *p)).fold(0.0, f32::max);
            assert!(worst_m < 0.02, "{name}: {worst_m} m outside");
            // Nor far within, where one walks into it.
            let met = |p: &&Vec3| (0.8..2.5).contains(&p.z) && p.truncate().length() < 0.8;
            let bark = mesh.woods().into_iter().flat_map(|wood| &wood.position);
            let depths: Vec<f32> = bark.filter(met).map(|p| -outside_m(&bodies, *p)).collect();
            let mean_m = depths.iter().sum::<f32>() / depths.len() as f32;
            assert!(mean_m < 0.08, "{name}: {mean_m} m inside");
        }
    }

    #[test]
    fn a_capsule_has_its_volume() {
        let s = capsule(Vec3::ZERO, Vec3::new(0.0, 3.0, 4.0), 0.5);
        let truth = std::f64::consts::PI * 0.25 * (5.0 + 2.0 / 3.0);
        assert!((s.volume_m3() / truth - 0.9).abs() < 0.1, "{}", s.volume_m3());
    }
}
