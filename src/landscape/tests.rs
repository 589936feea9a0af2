use std::io::{Read, Write};

use glam::{DVec2, DVec3, Vec3};

use super::brick::{Brick, ISO};
use super::build::{Detail, Source, Voxel};
use super::dag::Ref;
use super::lens::Outline;
use super::trace::{Hit, Ray, Tracer, What};
use super::*;
use crate::frame::Crs;
use crate::seed::{Draws, Seed};

const DETAIL: Detail = Detail { density_bits: 2, height_stride: 4, colour_stride: 4 };

const FINEST: Detail = Detail { density_bits: 4, ..DETAIL };

/// Voxels by hand over a ground by formula.
pub(super) struct Made {
    voxels: [u32; 3],
    columns: Vec<Vec<Voxel>>,
    ground: Option<Box<dyn Fn(f32, f32) -> f32 + Sync>>,
}

impl Made {
    fn empty(voxels: [u32; 3]) -> Made {
        let columns = vec![Vec::new(); (voxels[0] * voxels[1]) as usize];
        Made { voxels, columns, ground: None }
    }

    fn with(mut self, [x, y, z]: [u32; 3], density: u8) -> Made {
        let column = &mut self.columns[(y * self.voxels[0] + x) as usize];
        if column.iter().all(|v| u32::from(v.z) != z) {
            column.push(Voxel { z: z as u16, density });
        }
        self
    }

    fn over(mut self, ground: impl Fn(f32, f32) -> f32 + Sync + 'static) -> Made {
        self.ground = Some(Box::new(ground));
        self
    }

    /// Voxels strewn at random, over hills.
    pub fn wood(side: u32, voxels: u32, seed: u64) -> Made {
        let mut draws = Seed::new(seed).draws();
        let hills = |x: f32, y: f32| 5.0 + 2.0 * (x * 0.2).sin() + 1.5 * (y * 0.13).cos();
        let mut made = Made::empty([side, side, 32]).over(hills);
        for _ in 0..voxels {
            let at =
                [0, 1, 2].map(|a: u32| draws.index(if a < 2 { side as usize } else { 32 }) as u32);
            made = made.with(at, 1 + draws.index(3) as u8);
        }
        made
    }

    pub fn built(&self) -> Landscape {
        self.built_with(&DETAIL)
    }

    fn built_with(&self, detail: &Detail) -> Landscape {
        let frame = Frame::local(DVec3::new(5e5, 6e6, 100.0));
        let (scene, _) = Landscape::build(self, detail, frame, Vec3::ZERO, 0.5).unwrap();
        scene.check().unwrap();
        scene
    }
}

impl Source for Made {
    fn voxels(&self) -> [u32; 3] {
        self.voxels
    }

    fn column(&self, x: u32, y: u32) -> &[Voxel] {
        &self.columns[(y * self.voxels[0] + x) as usize]
    }

    fn height(&self, x: u32, y: u32) -> Option<f32> {
        self.ground.as_ref().map(|ground| ground(x as f32, y as f32))
    }

    fn colours(&self, x: u32, _: u32) -> [[u8; 3]; 2] {
        [[120, 100, 80], [40, 90 + (x % 8) as u8, 40]]
    }
}

/// Narrow rays.
fn ray(origin: [f64; 3], direction: [f64; 3]) -> Ray {
    let direction = DVec3::from(direction).normalize();
    Ray { origin: DVec3::from(origin), direction, breadth: [0.0; 2] }
}

fn first(scene: &Landscape, ray: &Ray) -> Option<Hit> {
    Tracer::new(scene).trace(ray, 0.0, f64::INFINITY)
}

const NEAR: f64 = 1e-3;

#[test]
fn a_plane_is_met_where_it_is() {
    let plane = |x: f32, y: f32| 9.0 + 0.25 * x - 0.125 * y;
    let scene = Made::empty([65, 65, 64]).over(plane).built();
    let normal = DVec3::new(-0.25, 0.125, 1.0);
    let origins = [[30.3, 20.1, 50.0], [0.0, 0.0, 60.0], [64.0, 64.0, 63.0], [16.0, 32.0, 40.0]];
    let directions =
        [[0.0, 0.0, -1.0], [0.3, 0.2, -1.0], [-0.4, 0.1, -0.7], [0.5, 0.5, -0.5], [1.0, 0.0, -0.9]];
    let mut met = 0;
    for origin in origins {
        for direction in directions {
            let ray = ray(origin, direction);
            let expected = (9.0 - normal.dot(ray.origin)) / normal.dot(ray.direction);
            let at = ray.origin + ray.direction * expected;
            let is_inside = at.x > 0.0 && at.x < 64.0 && at.y > 0.0 && at.y < 64.0;
            let hit = first(&scene, &ray).filter(|hit| hit.what == What::Ground);
            if is_inside {
                let hit = hit.unwrap_or_else(|| panic!("{ray:?} misses"));
                assert!((hit.t - expected).abs() < NEAR, "{ray:?}: {} for {expected}", hit.t);
                met += 1;
            }
        }
    }
    assert!(met >= 10, "{met} rays met the plane within the scene");
}

#[test]
fn a_single_voxel_is_met_where_its_density_halves() {
    let scene = Made::empty([33, 33, 33]).with([16, 17, 15], 3).built();
    // Along an axis the density falls from 1 to 0 over a voxel.
    for (axis, sign) in (0..3).flat_map(|axis| [(axis, 1.0), (axis, -1.0)]) {
        let centre = [16.0, 17.0, 15.0];
        let (mut origin, mut direction) = (centre, [0.0; 3]);
        origin[axis] -= 12.0 * sign;
        direction[axis] = sign;
        let hit = first(&scene, &ray(origin, direction)).expect("the voxel");
        assert!((hit.t - 11.5).abs() < NEAR, "axis {axis} {sign}: {}", hit.t);
        let normal = Tracer::new(&scene).normal(
            &hit,
            DVec3::from(origin) + DVec3::from(direction) * hit.t,
            0.0,
        );
        let facing = -normal[axis] * sign as f32;
        assert!(facing > 0.999, "axis {axis}: normal {normal}");
    }
    // Through corners of cells all the way: (1 − u)³ is one half.
    let hit = first(&scene, &ray([6.0, 7.0, 5.0], [1.0, 1.0, 1.0])).expect("the voxel");
    let expected = (10.0 - (1.0 - 0.5f64.cbrt())) * 3f64.sqrt();
    assert!((hit.t - expected).abs() < NEAR, "{} for {expected}", hit.t);
    // Along an edge of cells beside it, where the density never reaches one half.
    assert_eq!(first(&scene, &ray([0.0, 17.0, 16.0], [1.0, 0.0, 0.0])), None);
    // From within it.
    let hit = first(&scene, &ray([16.0, 17.0, 15.0], [0.0, 0.6, 0.8])).expect("the voxel");
    assert!(hit.t < NEAR);
}

#[test]
fn nothing_is_met_where_nothing_is() {
    let bare = Made::empty([17, 17, 17]).built();
    assert!(bare.is_empty());
    assert_eq!(first(&bare, &ray([8.0, 8.0, 30.0], [0.0, 0.0, -1.0])), None);
    let scene = Made::empty([33, 33, 33]).with([16, 16, 16], 3).built();
    for (origin, direction) in [
        ([0.0, 0.0, 20.0], [1.0, 1.0, 0.0]),
        ([16.0, 16.0, 20.0], [0.0, 0.0, 1.0]),
        ([-5.0, 16.0, 16.0], [-1.0, 0.0, 0.0]),
        ([16.0, 40.0, 16.0], [1.0, 0.0, 0.0]),
    ] {
        assert_eq!(first(&scene, &ray(origin, direction)), None, "{origin:?} {direction:?}");
    }
}

#[test]
fn a_voxel_is_met_across_a_wide_plain() {
    let mut draws = Seed::new(17).draws();
    let target = [833, 411, 61];
    let scene = Made::empty([1025, 513, 130]).with(target, 3).over(|_, _| 2.0).built();
    let centre = DVec3::from(target.map(f64::from));
    for i in 0..400 {
        let mut place = |side: f32| f64::from(draws.between(0.0, side));
        // From within and from afar, from above and from below; some along an axis.
        let mut origin = DVec3::new(place(1024.0), place(512.0), 3.0 + place(200.0));
        if i % 4 == 0 {
            origin[i / 4 % 2] = centre[i / 4 % 2];
        }
        let away = centre - origin;
        if away.length() < 4.0 {
            continue;
        }
        let hit = first(&scene, &ray(origin.to_array(), away.to_array()));
        let hit = hit.unwrap_or_else(|| panic!("from {origin} it is missed"));
        assert_eq!(hit.what, What::Vegetation);
        // Half the density is at most half a voxel from the centre.
        let off = away.length() - hit.t;
        assert!((0.2..=0.5 + NEAR).contains(&off), "from {origin}: {off} before the centre");
    }
}

#[test]
fn tiles_that_see_nothing_have_no_ray_that_meets_anything() {
    let scene = Made::wood(48, 900, 5).built();
    let mut draws = Seed::new(6).draws();
    let (mut skipped, mut met) = (0, 0);
    for _ in 0..40 {
        let mut place = || draws.between(-40.0, 40.0);
        let eye = Vec3::new(12.0 + place(), 12.0 + place(), 8.0 + 0.5 * place());
        let target = Vec3::new(12.0 + 0.4 * place(), 12.0 + 0.4 * place(), 6.0);
        let camera = crate::render::Camera { eye, target, fov_y_rad: 0.9 };
        let lens = scene.lens(&camera, [64, 64]);
        let outline = Outline::new(&lens, scene.reach());
        let mut tracer = Tracer::new(&scene);
        for tile in 0..16u32 {
            let low = DVec2::new(f64::from(tile % 4), f64::from(tile / 4)) * 16.0;
            let is_seen = outline.is_seen(&lens, low, low + 16.0);
            skipped += u32::from(!is_seen);
            for i in 0..16u32 {
                let at = low + DVec2::new(f64::from(i % 4), f64::from(i / 4)) * 5.3;
                let is_met = tracer.trace(&lens.ray(at, 1.0), 0.0, f64::INFINITY).is_some();
                assert!(is_seen || !is_met, "{camera:?} {at}");
                met += u32::from(is_met);
            }
        }
    }
    assert!(skipped > 50 && met > 500, "{skipped} tiles skipped, {met} rays met something");
}

#[test]
fn tiles_in_the_corners_about_a_turned_box_see_nothing() {
    let scene = Made::wood(48, 900, 5).built();
    let lens = scene.lens(&scene.camera(View::Oblique, 1.5), [480, 320]);
    let outline = Outline::new(&lens, scene.reach());
    let tiles = (0..20u32).flat_map(|y| (0..30u32).map(move |x| (x, y)));
    let count = tiles
        .filter(|(x, y)| {
            let low = DVec2::new(f64::from(*x), f64::from(*y)) * 16.0;
            outline.is_seen(&lens, low, low + 16.0)
        })
        .count();
    // The box seen aslant fills about half of what is around it.
    assert!((150..420).contains(&count), "{count} of 600 tiles");
}

#[test]
fn interpolation_is_exact_on_linear_densities() {
    let field = |p: Vec3| 0.03 + 0.05 * p.x + 0.07 * p.y + 0.11 * p.z;
    let brick = Brick::from_fn(|x, y, z| field(Vec3::new(x as f32, y as f32, z as f32)));
    let mut draws = Seed::new(5).draws();
    for _ in 0..1000 {
        let p = Vec3::new(draws.unit(), draws.unit(), draws.unit()) * 4.0;
        assert!((brick.density(p) - field(p)).abs() < 1e-6, "{p}");
    }
    // And the place where it passes one half.
    for _ in 0..1000 {
        let from = Vec3::new(4.0 * draws.unit(), 4.0 * draws.unit(), 0.0);
        let to = Vec3::new(4.0 * draws.unit(), 4.0 * draws.unit(), 4.0);
        let (start, end) = (field(from), field(to));
        let expected = (ISO - start) / (end - start);
        if start < ISO && end > ISO {
            let t = brick.first(from, to - from, 0.0, 1.0).expect("a crossing");
            assert!((t - expected).abs() < 2e-5, "{t} for {expected}");
        }
    }
}

#[test]
fn a_sphere_is_met_where_it_is() {
    // Bricks about a piece of a sphere, whose density falls evenly through one half at its radius.
    let (centre, radius) = (Vec3::new(8.0, 8.0, -992.0), 1000.0f32);
    let density = |p: Vec3| 0.5 + 0.05 * (radius - p.distance(centre));
    let mut draws = Seed::new(6).draws();
    for _ in 0..500 {
        let from = Vec3::new(16.0 * draws.unit(), 16.0 * draws.unit(), 15.9);
        let to = Vec3::new(16.0 * draws.unit(), 16.0 * draws.unit(), 0.1);
        let d = (to - from).normalize();
        let (o, d64) = ((from - centre).as_dvec3(), d.as_dvec3());
        let b = o.dot(d64);
        let expected = -b - (b * b - (o.length_squared() - f64::from(radius).powi(2))).sqrt();
        let mut met: Option<f64> = None;
        for i in 0..64u32 {
            let low = Vec3::new((i & 3) as f32, (i >> 2 & 3) as f32, (i >> 4) as f32) * 4.0;
            let (a, b) = ((low - from) / d, (low + 4.0 - from) / d);
            let (enter, leave) = (a.min(b).max_element().max(0.0), a.max(b).min_element());
            if enter < leave {
                let brick = Brick::from_fn(|x, y, z| {
                    density(low + Vec3::new(x as f32, y as f32, z as f32))
                });
                let p = from + d * enter - low;
                let t = brick.first(p, d, 0.0, leave - enter).map(|t| f64::from(t + enter));
                met = [met, t].into_iter().flatten().reduce(f64::min);
            }
        }
        let met = met.unwrap_or_else(|| panic!("from {from} along {d} misses"));
        assert!((met - expected).abs() < NEAR, "{met} for {expected}");
    }
}

#[test]
fn interpolation_is_exact_on_linear_densities_across_bricks() {
    let mut made = Made::empty([12, 12, 12]);
    for (x, y, z) in (0..12 * 144u32).map(|i| (i % 12, i / 12 % 12, i / 144)) {
        if (1..=15).contains(&(x + y + z)) {
            made = made.with([x, y, z], (x + y + z) as u8);
        }
    }
    let scene = made.built_with(&FINEST);
    let mut tracer = Tracer::new(&scene);
    let mut draws = Seed::new(7).draws();
    for _ in 0..2000 {
        let p = Vec3::new(draws.unit(), draws.unit(), draws.unit()) * 4.9;
        let expected = p.element_sum() / 15.0;
        let density = tracer.density(p);
        assert!((density - expected).abs() < 1e-6, "{p}: {density} for {expected}");
    }
}

/// Density at a place in voxels, by the definition of trilinear interpolation.
fn density_at(made: &Made, full: f64, p: DVec3) -> f64 {
    let value = |x: i64, y: i64, z: i64| -> f64 {
        let inside =
            x >= 0 && y >= 0 && x < i64::from(made.voxels[0]) && y < i64::from(made.voxels[1]);
        let column = if inside { made.column(x as u32, y as u32) } else { &[] };
        column.iter().find(|v| i64::from(v.z) == z).map_or(0.0, |v| f64::from(v.density) / full)
    };
    let cell = p.floor();
    let (f, i) = (p - cell, cell.as_i64vec3());
    (0..8i64)
        .map(|k| {
            let (x, y, z) = (k & 1, k >> 1 & 1, k >> 2);
            let weight = |f: f64, far: i64| if far == 1 { f } else { 1.0 - f };
            weight(f.x, x) * weight(f.y, y) * weight(f.z, z) * value(i.x + x, i.y + y, i.z + z)
        })
        .sum()
}

/// What a ray meets first: by small steps through the same densities and heights, the last of them
/// halved.
fn by_steps(made: &Made, full: f64, scene: &Landscape, ray: &Ray) -> Option<f64> {
    const STEP: f64 = 0.004;
    let sides = DVec3::from(scene.sides.map(f64::from));
    let is_within = |t: f64| {
        let p = ray.origin + ray.direction * t;
        let is_inside = p.cmpge(DVec3::ZERO).all() && p.cmple(sides).all();
        is_inside
            && (density_at(made, full, p) >= 0.5
                || scene.height(p.x, p.y).is_some_and(|h| p.z <= h))
    };
    let mut met = (0..20_000).map(|i| f64::from(i) * STEP).find(|t| is_within(*t))?;
    let mut before = met - STEP;
    while met - before > 1e-6 {
        let middle = 0.5 * (met + before);
        if is_within(middle) {
            met = middle;
        } else {
            before = middle;
        }
    }
    Some(met)
}

#[test]
fn rays_meet_what_small_steps_meet() {
    let made = Made::wood(24, 700, 11);
    let scene = made.built();
    let mut draws = Seed::new(12).draws();
    let mut met = 0;
    for _ in 0..150 {
        let mut place = |side: f32| draws.between(0.5, side - 1.5);
        let (origin, target) =
            ([place(24.0), place(24.0), 30.0], [place(24.0), place(24.0), place(20.0)]);
        let origin = origin.map(f64::from);
        let direction = DVec3::from(target.map(f64::from)) - DVec3::from(origin);
        let ray = ray(origin, direction.to_array());
        match (first(&scene, &ray), by_steps(&made, 3.0, &scene, &ray)) {
            (Some(hit), Some(t)) => {
                assert!(hit.t < t + NEAR, "{ray:?}: {} but steps meet {t}", hit.t);
                // Small steps may pass over what a ray just touches.
                met += u32::from((hit.t - t).abs() < NEAR);
            }
            (hit, t) => {
                assert!(hit.is_some() || t.is_none(), "{ray:?}: {hit:?}, steps {t:?}");
                met += u32::from(hit.is_none());
            }
        }
    }
    assert!(met > 140, "{met} of 150 rays agree");
}

#[test]
fn a_sphere_that_is_kept_is_met_where_it_is() {
    // Three voxels wide between full and empty, in steps of a fifteenth.
    let (centre, radius, slope) = (DVec3::new(23.3, 24.1, 22.8), 14.6, 1.0 / 3.0);
    let mut made = Made::empty([48, 48, 48]);
    for (x, y, z) in (0..48 * 48 * 48u32).map(|i| (i % 48, i / 48 % 48, i / 2304)) {
        let p = DVec3::new(f64::from(x), f64::from(y), f64::from(z));
        let density: f64 = 0.5 + slope * (radius - p.distance(centre));
        let level = (15.0 * density.clamp(0.0, 1.0)).round() as u8;
        if level > 0 {
            made = made.with([x, y, z], level);
        }
    }
    let scene = made.built_with(&FINEST);
    let mut draws = Seed::new(9).draws();
    for _ in 0..100 {
        let mut away = || draws.direction().as_dvec3();
        let origin = centre + 22.0 * away();
        let target = centre + 0.8 * radius * away();
        let ray = ray(origin.to_array(), (target - origin).to_array());
        let hit = first(&scene, &ray).unwrap_or_else(|| panic!("{ray:?} misses"));
        // Where the densities that are kept pass one half.
        let kept = by_steps(&made, 15.0, &scene, &ray).expect("the sphere");
        assert!((hit.t - kept).abs() < NEAR, "{ray:?}: {} for {kept}", hit.t);
        // Half a step of density off the sphere itself, more between the corners of a cell.
        let off = (ray.origin + ray.direction * hit.t).distance(centre) - radius;
        assert!(off.abs() < 0.5 / 15.0 / slope + 0.05, "{ray:?}: {off} off the sphere");
    }
}

#[test]
fn broad_rays_meet_the_cells_that_are_as_broad() {
    // A canopy without gaps over a plain.
    let mut made = Made::empty([65, 65, 65]).over(|_, _| 3.0);
    for (x, y) in (0..65).flat_map(|y| (0..65).map(move |x| (x, y))) {
        made = made.with([x, y, 20], 3).with([x, y, 21], 3);
    }
    let scene = made.built();
    let mut draws = Seed::new(4).draws();
    for _ in 0..200 {
        let mut place = || f64::from(draws.between(8.0, 56.0));
        let (x, y) = (place(), place());
        let narrow = ray([x, y, 60.0], [0.3 * (place() - 32.0), 0.3 * (place() - 32.0), -40.0]);
        for breadth in [1.5f32, 4.5, 17.0] {
            let broad = Ray { breadth: [breadth, 0.0], ..narrow };
            let fine = first(&scene, &narrow).expect("the canopy").t;
            let coarse = first(&scene, &broad).expect("the canopy").t;
            let slack = 2.0 * f64::from(breadth);
            assert!((coarse - fine).abs() < slack, "{breadth} broad: {coarse}, narrow {fine}");
        }
    }
}

#[test]
fn broad_rays_that_slant_meet_columns_of_two_bricks_aside() {
    let mut made = Made::empty([65, 65, 65]).over(|_, _| 3.0);
    for i in 0..64 {
        made = made.with([40 + (i & 3), 40 + (i >> 2 & 3), 20 + (i >> 4)], 3);
    }
    let scene = made.built();
    // Past the brick, in the same 8 × 8 voxels.
    let met = |breadth, y, z, d_y| {
        let narrow = ray([46.0, y, z], [0.0, d_y, -1.0]);
        let hit = first(&scene, &Ray { breadth: [breadth, 0.0], ..narrow });
        hit.filter(|hit| hit.what == What::Vegetation)
    };
    // At the brick's height.
    let broad = met(9.0, 4.0, 43.0, 2.0).expect("the brick");
    assert!((broad.t - 19.0 * 5f64.sqrt()).abs() < NEAR);
    assert_eq!(met(7.0, 4.0, 43.0, 2.0), None);
    assert_eq!(met(9.0, 40.0, 43.0, 0.1), None);
}

#[test]
fn the_fullest_place_of_a_ray_rises_voxel_by_voxel() {
    let mut made = Made::empty([32, 32, 32]).over(|_, _| 1.0);
    for k in 0..12 * 12 * 12 {
        made = made.with([8 + k % 12, 8 + k / 12 % 12, 8 + k / 144], 3);
    }
    let scene = made.built();
    let mut tracer = Tracer::new(&scene);
    let mut densest = |x: f64| {
        let ray =
            Ray { origin: DVec3::new(x, 14.2, 60.0), direction: DVec3::NEG_Z, breadth: [0.0; 2] };
        tracer.densest(&ray)
    };
    let (inside, ground) = densest(14.0);
    assert!(inside > 0.999, "{inside}");
    assert!(ground.is_some_and(|hit| hit.what == What::Ground && (hit.t - 59.0).abs() < 0.01));
    assert_eq!(densest(3.0).0, 0.0);
    let across: Vec<f32> = (12..56).map(|k| densest(0.25 + 0.5 * f64::from(k)).0).collect();
    // A brick at a time they would step by 1.
    assert!(across.windows(2).all(|w| (w[1] - w[0]).abs() < 0.55), "{across:?}");
    let peak = across.iter().position(|d| *d > 0.999).unwrap();
    assert!(across[..peak].windows(2).all(|w| w[1] >= w[0]), "{across:?}");
}

#[test]
fn the_ground_is_cut_where_the_scene_ends() {
    let scene = Made::empty([33, 33, 33]).over(|_, _| 20.0).built();
    let below = first(&scene, &ray([16.0, 16.0, -5.0], [0.0, 0.0, 1.0])).expect("the bottom");
    assert_eq!(below.what, What::Cut(2));
    let hit = first(&scene, &ray([-10.0, 16.0, 10.0], [1.0, 0.0, 0.0])).expect("the face");
    assert_eq!(hit.what, What::Cut(0));
    assert!((hit.t - 10.0).abs() < NEAR);
    let normal = Tracer::new(&scene).normal(&hit, DVec3::new(0.0, 16.0, 10.0), 0.0);
    assert_eq!(normal, Vec3::NEG_X);
}

fn shot(scene: &Landscape, weather: Weather) -> Shot {
    Shot { effort: 3, weather, ..Shot::new(scene.camera(View::Oblique, 1.5), [48, 32]) }
}

fn drawn(scene: &Landscape, weather: Weather) -> crate::raster::Picture {
    draw(scene, &shot(scene, weather), |_, _| Ok(true)).unwrap().0
}

const ALL_WEATHER: Weather = Weather { snow_m: 0.2, fog_m: 500.0, rain_mm: 5.0 };

#[test]
fn pictures_are_the_same_on_any_number_of_threads() {
    let scene = Made::wood(48, 2000, 8).built();
    let on = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| (drawn(&scene, ALL_WEATHER), Made::wood(48, 2000, 8).built()))
    };
    let (one, two) = (on(1), on(2));
    assert_eq!(one.0, two.0);
    assert_eq!(one.1, two.1);
}

#[test]
fn each_mode_shows_something_of_its_own() {
    let scene = Made::wood(48, 2000, 8).built();
    let of = |mode| {
        let shot = Shot { mode, ..shot(&scene, Weather::default()) };
        draw(&scene, &shot, |_, _| Ok(true)).unwrap().0
    };
    let pictures = [Mode::Surface, Mode::Densest, Mode::Splat].map(of);
    let shades =
        |p: &crate::raster::Picture| p.data.iter().collect::<std::collections::BTreeSet<_>>().len();
    assert!(pictures.iter().all(|p| shades(p) > 50));
    assert!(pictures[0] != pictures[1] && pictures[0] != pictures[2]);
    // Splats are where surfaces are.
    let sky = pictures[0].data[0];
    let land = |p: &crate::raster::Picture| p.data.iter().filter(|c| **c != sky).count() as f64;
    assert!((land(&pictures[2]) / land(&pictures[0]) - 1.0).abs() < 0.1);
}

#[test]
fn splats_have_the_sides_that_rays_meet() {
    let scene = Made::empty([48, 48, 32]).over(|x, y| 9.0 + 0.2 * x + 0.1 * y).built();
    for view in [View::North, View::Oblique, View::Top] {
        let size = [192, 128];
        let lens = scene.lens(&scene.camera(view, 1.5), size);
        let splats = splat::splat(&scene, &lens, size);
        let mut tracer = Tracer::new(&scene);
        let (mut cut, mut alike) = (0, 0);
        for (i, splat) in splats.iter().enumerate() {
            let at = DVec2::new((i % 192) as f64, (i / 192) as f64) + 0.5;
            let Some(hit) = tracer.trace(&lens.ray(at, 1.0), 0.0, f64::INFINITY) else { continue };
            if let What::Cut(_) = hit.what {
                let near = |s: &Hit| s.what == hit.what && (s.t - hit.t).abs() < 4.0;
                cut += 1;
                alike += u32::from(splat.as_ref().is_some_and(near));
            }
        }
        assert_eq!(cut > 1000, view != View::Top, "{view:?}: {cut}");
        assert!(f64::from(alike) >= 0.9 * f64::from(cut), "{view:?}: {alike} of {cut}");
    }
}

#[test]
fn passes_lead_from_rough_to_whole() {
    let scene = Made::wood(48, 2000, 8).built();
    let mut passes = Vec::new();
    let shot = Shot { effort: 6, ..shot(&scene, Weather::default()) };
    draw(&scene, &shot, |_, rays| {
        passes.push(rays);
        Ok(true)
    })
    .unwrap();
    assert_eq!(passes, [0, 1, 2, 4]);
    let stopped = draw(&scene, &shot, |_, _| Ok(false)).unwrap().1;
    assert!(stopped.primary <= 12 * 8);
}

#[test]
fn layers_say_what_is_where() {
    let scene = Made::empty([65, 65, 33]).over(|_, _| 6.0).with([32, 32, 20], 3).built();
    let [low, high] = scene.bounds_m();
    let eye = Vec3::new(16.0, 16.0, 40.0);
    let camera = crate::render::Camera { eye, target: eye.with_z(0.0), fov_y_rad: 0.5 };
    let layers = layers(&scene, &Shot::new(camera, [65, 65])).unwrap();
    let middle = 32 * 65 + 32;
    // The voxel's upper face, half a voxel over its centre; gaps between leaves reach no deeper.
    assert_eq!(layers.class[middle], 5);
    let depth_m = layers.depth_m[middle];
    assert!((40.0 - 10.25 - 1e-3..=40.0 - 10.0 + 1e-3).contains(&depth_m), "{depth_m}");
    assert_eq!(layers.class[0], 2);
    // Depth is along the camera's axis, so a plain has one.
    assert!((layers.depth_m[0] - (40.0 - 3.0)).abs() < 1e-3, "{}", layers.depth_m[0]);
    assert!(layers.normal[0].z > 0.999);
    assert!(low.cmplt(high).all());
}

#[test]
fn a_saved_scene_gives_the_same_picture() {
    let scene = Made::wood(48, 2000, 9).built();
    let mut file = Vec::new();
    scene.write(&mut file).unwrap();
    let again = Landscape::read_from(&file[..]).unwrap();
    assert_eq!(again, scene);
    assert_eq!(again.memory(), scene.memory());
    assert_eq!(drawn(&again, ALL_WEATHER), drawn(&scene, ALL_WEATHER));
}

fn refusal(file: &[u8]) -> String {
    match Landscape::read_from(file) {
        Ok(_) => String::new(),
        Err(error) => crate::diagnostic::render(&error),
    }
}

#[test]
fn broken_files_are_refused_in_words() {
    let scene = Made::wood(24, 300, 10).built();
    let mut file = Vec::new();
    scene.write(&mut file).unwrap();
    assert!(refusal(b"LASF....").contains("not a landscape file"));
    assert!(refusal(b"").contains("not a landscape file"));
    assert!(refusal(b"larix voxels 9\n{}").contains("another version"));
    assert!(refusal(&file[..file.len() / 2]).contains("it is cut short"));
    for length in (0..file.len()).step_by(7) {
        assert!(!refusal(&file[..length]).is_empty(), "{length} of {} bytes", file.len());
    }
    // A byte changed anywhere is refused, or was of no consequence.
    for at in (15..file.len()).step_by(5) {
        let mut changed = file.clone();
        changed[at] ^= 0x10;
        if let Ok(read) = Landscape::read_from(&changed[..]) {
            assert!(read == scene, "byte {at}");
        }
    }
    assert!(refusal(&[&file[..], b"more"].concat()).contains("more than it describes"));
}

#[test]
fn a_file_that_unpacks_to_far_more_than_it_is_is_refused_early() {
    let scene = Made::wood(24, 300, 10).built();
    let mut file = Vec::new();
    scene.write(&mut file).unwrap();
    let (name, packed) = file.split_at(file.iter().position(|b| *b == b'\n').unwrap() + 1);
    let mut whole = Vec::new();
    flate2::read::GzDecoder::new(packed).read_to_end(&mut whole).unwrap();
    let end = whole.iter().position(|b| *b == b'\n').unwrap();
    let words = format!("\"words\":{}", scene.dag.words.len());
    let head = String::from_utf8_lossy(&whole[..=end]).replace(&words, "\"words\":60000000");
    let bomb = |zeros: usize| {
        let fast = flate2::Compression::fast();
        let mut packed = flate2::write::GzEncoder::new(name.to_vec(), fast);
        packed.write_all(head.as_bytes()).unwrap();
        packed.write_all(&vec![0; zeros]).unwrap();
        refusal(&packed.finish().unwrap())
    };
    assert!(bomb(1 << 20).contains("cut short"));
    assert!(bomb(100 << 20).contains("unpacks to more"));
}

#[test]
fn a_graph_that_is_not_sound_is_found_out() {
    let scene = Made::wood(24, 300, 10).built();
    let root = scene.dag.root.unwrap();
    let mut draws = Draws::clone(&Seed::new(3).draws());
    let broken = |change: &dyn Fn(&mut Landscape)| {
        let mut scene = scene.clone();
        change(&mut scene);
        scene.check().expect_err("a fault")
    };
    broken(&|s| s.dag.words.truncate(root.index() + 2));
    broken(&|s| s.dag.root = Some(Ref(s.dag.words.len() as u32 | Ref::GROUND)));
    broken(&|s| s.dag.words[root.index() + 2] = root.0);
    broken(&|s| s.dag.levels = 0);
    broken(&|s| s.dag.planes = 9);
    broken(&|s| s.heights.stride = 3);
    broken(&|s| s.heights.samples.places[0] = 1 << 20);
    broken(&|s| s.colours.levels.clear());
    broken(&|s| s.voxel_m = 4e9);
    broken(&|s| s.frame.origin.x = 1e300);
    broken(&|s| s.heights.step = 0.0);
    broken(&|s| s.heights.base = 1e30);
    for unit_m in [0.0, -1.0, f64::NAN, 1e30] {
        let crs = Crs { horizontal_unit_m: unit_m, ..Crs::from_epsg(32647) };
        broken(&|s| s.frame.crs = Some(crs.clone()));
    }
    // Whatever the words are, a scene that passes can be seen through without harm.
    for _ in 0..300 {
        let mut changed = scene.clone();
        let at = draws.index(changed.dag.words.len());
        changed.dag.words[at] = draws.bits() as u32;
        if changed.check().is_ok() {
            for x in 0..8 {
                first(&changed, &ray([f64::from(x) * 3.0, 11.0, 60.0], [0.01, 0.2, -1.0]));
            }
        }
    }
}

#[test]
fn equal_parts_are_kept_once() {
    let tile = Made::wood(64, 4000, 21);
    let size = |whole: u32| {
        let mirrored = Mirrored { tile: &tile, side: 64, whole: [whole, whole, 32] };
        let frame = Frame::local(DVec3::ZERO);
        let (scene, tally) = Landscape::build(&mirrored, &DETAIL, frame, Vec3::ZERO, 1.0).unwrap();
        (scene.memory().voxels, tally.voxels)
    };
    let ((small, few), (large, many)) = (size(128), size(1024));
    assert!(many > 60 * few && many < 64 * few + 1);
    assert!(large < 2 * small, "{large} bytes for 64 times the area of {small}");
}

#[test]
fn snow_lies_on_what_is_level_and_open() {
    let skin = |slope: f32| weather::Skin {
        albedo: Vec3::splat(0.1),
        normal: Vec3::new(slope.sin(), 0.0, slope.cos()),
        up: slope.cos(),
        holds_m: f32::INFINITY,
        gloss: 0.0,
    };
    let snow = Weather { snow_m: 0.1, ..Weather::default() };
    let white = |slope: f32, open: f32| snow.settle(skin(slope), open).albedo.x;
    assert!(white(0.0, 1.0) > 0.45);
    assert!(white(0.0, 1.0) > white(0.9, 1.0) && white(0.9, 1.0) > white(1.3, 1.0));
    assert!(white(0.0, 1.0) > white(0.0, 0.2));
    assert_eq!(white(1.6, 1.0), 0.1);
    // Leaves hold little, however much falls.
    let leaves = weather::Skin { holds_m: 0.02, ..skin(0.0) };
    let much = Weather { snow_m: 2.0, ..snow };
    assert!(much.settle(leaves, 1.0).albedo.x < white(0.0, 1.0) - 0.1);
    let none = Weather::default();
    assert_eq!(none.settle(skin(0.3), 1.0).albedo, Vec3::splat(0.1));
    assert_eq!(none.extinction_per_m(), 0.0);
    assert_eq!(none.sun(), 1.0);
}

#[test]
fn fog_leaves_a_twentieth_at_its_distance() {
    let fog = Weather { fog_m: 800.0, ..Weather::default() };
    assert!(((-fog.extinction_per_m() * 800.0).exp() - 0.05).abs() < 1e-6);
    let rain = Weather { rain_mm: 10.0, ..Weather::default() };
    assert!(rain.extinction_per_m() > 0.0 && rain.sun() < 0.2);
}

#[test]
fn cameras_hold_the_whole_scene() {
    let scene = Made::wood(48, 500, 2).built();
    for (name, view) in View::ALL {
        let lens = scene.lens(&scene.camera(view, 1.5), [300, 200]);
        for i in 0..8u32 {
            let corner = DVec3::from(
                [0, 1, 2].map(
                    |a: usize| {
                        if i >> a & 1 == 0 { 0.0 } else { f64::from(scene.sides[a]) }
                    },
                ),
            );
            let v = corner - lens.eye;
            let depth = v.dot(lens.forward);
            let at =
                DVec2::new(v.dot(lens.right), v.dot(lens.down)) / (lens.pixel * lens.pixel * depth);
            assert!(depth > 0.0 && at.x.abs() <= 150.0 && at.y.abs() <= 100.0, "{name}: {at}");
        }
    }
}

#[test]
fn what_is_shown_whole_is_not_lost_in_the_air_before_it() {
    let scene = Made::wood(48, 2000, 8).built();
    let contrast = |view, fog_m| {
        let weather = Weather { fog_m, ..Weather::default() };
        let shot = Shot { weather, ..Shot::new(scene.camera(view, 1.5), [48, 32]) };
        let picture = draw(&scene, &shot, |_, _| Ok(true)).unwrap().0;
        let middle = (12..36).flat_map(|x| (8..24).map(move |y| (x, y)));
        let green: Vec<u8> = middle.map(|(x, y)| picture.at(x, y)[1]).collect();
        green.iter().max().unwrap() - green.iter().min().unwrap()
    };
    for (name, view) in View::ALL {
        // The scene is 24 m wide.
        assert!(contrast(view, 0.0) > 60, "{name}");
        assert!(contrast(view, 100.0) > 25, "{name} in fog: {}", contrast(view, 100.0));
    }
}

#[test]
fn fog_begins_at_what_is_seen_and_not_at_a_mast_or_the_corner_of_the_box() {
    let mut made = Made::wood(48, 2000, 8);
    made.voxels[2] = 400;
    for z in 0..400 {
        made = made.with([44, 44, z], 3);
    }
    let scene = made.built();
    let near =
        |view| light::nearest(&scene, &scene.lens(&scene.camera(view, 1.5), [48, 32]), [48, 32]);
    let eye = |view| scene.lens(&scene.camera(view, 1.5), [48, 32]).eye;
    // From above the wood is some 370 voxels below the top of the mast and of the box.
    let below = near(View::Top) - (eye(View::Top).z - 400.0);
    assert!((350.0..400.0).contains(&below), "{below}");
    // From the south it is beyond the box's nearer face.
    assert!(near(View::North) > -eye(View::North).y);
    let within = crate::render::Camera {
        eye: Vec3::new(10.0, 10.0, 100.0),
        target: Vec3::ZERO,
        fov_y_rad: 1.0,
    };
    assert_eq!(light::nearest(&scene, &scene.lens(&within, [48, 32]), [48, 32]), 0.0);
}

#[test]
fn cameras_and_sizes_out_of_range_are_refused() {
    let scene = Made::wood(24, 100, 2).built();
    let good = shot(&scene, Weather::default());
    let refused =
        |shot: &Shot| draw(&scene, shot, |_, _| Ok(true)).unwrap_err().message().to_owned();
    assert!(refused(&Shot { size: [0, 10], ..good }).contains("0 × 10"));
    assert!(refused(&Shot { size: [16_000, 16_000], ..good }).contains("16000 × 16000"));
    let camera = crate::render::Camera { target: good.camera.eye, ..good.camera };
    assert!(refused(&Shot { camera, ..good }).contains("its own place"));
}
