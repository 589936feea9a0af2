//! The stem in a cloud seen from the ground: circles in slices across it, followed up and down
//! from where they are soundest.
//!
//! A circle is the best of many through three points each (RANSAC, Fischler & Bolles 1981), then
//! brought to least squares of the distances by Gauss and Newton, inliers alone. It is sound where
//! most points near it lie on it, few inside it, and at least a quarter of it is seen.

use glam::{Vec2, Vec3};

use super::near::Points;
use crate::seed::{Draws, Seed};

/// Radii a stem may have.
const RADII_M: std::ops::RangeInclusive<f32> = 0.012..=2.0;
const TRIES: usize = 80;
/// Points of a slice that a circle is fitted to, at most.
const MOST_POINTS: usize = 300;
const LEAST_POINTS: usize = 10;
/// Slices without a sound circle after which the stem is lost.
const MOST_LOST: u32 = 12;
/// Sound circles that make a stem.
const LEAST_SLICES: usize = 5;
/// Sectors of a circle, and how many must be seen.
const SECTORS: usize = 24;
const LEAST_SECTORS: u32 = 6;

/// What makes a circle sound: the least share of points near it that lie on it, and the greatest
/// that lie well inside.
#[derive(Debug, Clone, Copy)]
struct Strictness {
    on: f32,
    inside: f32,
}

/// Where nothing else speaks for a stem.
const STRICT: Strictness = Strictness { on: 0.6, inside: 0.17 };
/// Where the slices below do.
const LENIENT: Strictness = Strictness { on: 0.4, inside: 0.3 };

/// A cross-section.
#[derive(Debug, Clone, Copy)]
pub(super) struct Slice {
    pub centre: Vec3,
    pub radius_m: f32,
}

/// A circle in a plane.
#[derive(Debug, Clone, Copy)]
struct Circle {
    centre: Vec2,
    radius_m: f32,
}

impl Circle {
    fn through(a: Vec2, b: Vec2, c: Vec2) -> Option<Circle> {
        let (u, v) = (b - a, c - a);
        let twice = 2.0 * u.perp_dot(v);
        if twice.abs() < 1e-9 {
            return None;
        }
        let (uu, vv) = (u.length_squared(), v.length_squared());
        let off = Vec2::new(v.y * uu - u.y * vv, u.x * vv - v.x * uu) / twice;
        Some(Circle { centre: a + off, radius_m: off.length() })
    }

    fn off_m(&self, p: Vec2) -> f32 {
        p.distance(self.centre) - self.radius_m
    }

    /// How far from the circle a point still belongs to it: bark is rougher on thick stems, but
    /// were this a mere share of the radius, the largest circle would always win.
    fn tolerance_m(&self) -> f32 {
        (0.006 + 0.1 * self.radius_m).min(0.022)
    }

    /// Least squares of the distances of the inliers, a few steps.
    fn refined(mut self, points: &[Vec2]) -> Circle {
        for _ in 0..8 {
            let tolerance_m = self.tolerance_m();
            // Normal equations of (dx, dy, dr), as the residual is |p − c| − r.
            let (mut m, mut b) = (glam::DMat3::ZERO, glam::DVec3::ZERO);
            for &p in points.iter().filter(|p| self.off_m(**p).abs() <= tolerance_m) {
                let out = (p - self.centre).normalize_or_zero().as_dvec2();
                let row = glam::DVec3::new(out.x, out.y, 1.0);
                m += glam::DMat3::from_cols(row * row.x, row * row.y, row * row.z);
                b += row * f64::from(self.off_m(p));
            }
            if m.determinant().abs() < 1e-6 {
                break;
            }
            let step = m.inverse() * b;
            if !step.is_finite() || step.length() > f64::from(0.5 * self.radius_m) {
                break;
            }
            self.centre += step.truncate().as_vec2();
            self.radius_m += step.z as f32;
        }
        self
    }

    fn is_sound(&self, points: &[Vec2], strictness: Strictness) -> bool {
        if !RADII_M.contains(&self.radius_m) || !self.centre.is_finite() {
            return false;
        }
        let tolerance_m = self.tolerance_m();
        let (mut on, mut inside, mut near, mut seen) = (0usize, 0usize, 0usize, 0u32);
        for &p in points {
            let off = self.off_m(p);
            near += usize::from(off < 0.5 * self.radius_m);
            inside += usize::from(off < -0.4 * self.radius_m);
            if off.abs() <= tolerance_m {
                on += 1;
                let turn = (p - self.centre).to_angle() / std::f32::consts::TAU;
                seen |= 1 << ((turn.rem_euclid(1.0) * SECTORS as f32) as usize).min(SECTORS - 1);
            }
        }
        on >= LEAST_POINTS
            && on as f32 >= strictness.on * near as f32
            && inside as f32 <= strictness.inside * near as f32
            && seen.count_ones() >= LEAST_SECTORS
    }
}

/// The best circle, if it is sound.
fn circle(points: &[Vec2], strictness: Strictness, draws: &mut Draws) -> Option<Circle> {
    if points.len() < LEAST_POINTS {
        return None;
    }
    let every = points.len().div_ceil(MOST_POINTS);
    let some: Vec<Vec2> = points.iter().step_by(every).copied().collect();
    let mut best: Option<(usize, Circle)> = None;
    for _ in 0..TRIES {
        let mut pick = || some.get(draws.index(some.len())).copied();
        let (Some(a), Some(b), Some(c)) = (pick(), pick(), pick()) else { continue };
        let Some(found) = Circle::through(a, b, c) else { continue };
        if !RADII_M.contains(&found.radius_m) {
            continue;
        }
        let tolerance_m = found.tolerance_m();
        let on = some.iter().filter(|p| found.off_m(**p).abs() <= tolerance_m).count();
        // Small circles have small tolerances: of two that hold as many the smaller is likelier.
        if best.is_none_or(|(most, b)| on > most || (on == most && found.radius_m < b.radius_m)) {
            best = Some((on, found));
        }
    }
    best.map(|(_, c)| c.refined(&some)).filter(|c| c.is_sound(&some, strictness))
}

/// What a stem is looked for in.
struct Search<'a> {
    points: &'a [Vec3],
    near: Points,
    slice_m: f32,
    seed: Seed,
}

impl Search<'_> {
    /// The cross-section about `centre` at right angles to `ahead`, of points within `reach_m`.
    fn slice(
        &self,
        centre: Vec3,
        ahead: Vec3,
        reach_m: f32,
        strictness: Strictness,
    ) -> Option<Slice> {
        let (x, y) = ahead.any_orthonormal_pair();
        let ball_m = reach_m.hypot(0.5 * self.slice_m);
        let mut flat: Vec<(u32, Vec2)> = self
            .near
            .within(centre, ball_m)
            .filter_map(|(i, _)| {
                let d = self.points[i as usize] - centre;
                let p = Vec2::new(d.dot(x), d.dot(y));
                let is_in = d.dot(ahead).abs() <= 0.5 * self.slice_m && p.length() <= reach_m;
                is_in.then_some((i, p))
            })
            .collect();
        flat.sort_unstable_by_key(|e| e.0);
        let flat: Vec<Vec2> = flat.into_iter().map(|e| e.1).collect();
        let key = u64::from(centre.z.to_bits());
        let found = circle(&flat, strictness, &mut self.seed.derive("circle", key).draws())?;
        let at = centre + x * found.centre.x + y * found.centre.y;
        Some(Slice { centre: at, radius_m: found.radius_m })
    }

    /// Follows the stem from a sound slice; `sign` 1 up, −1 down. The slice itself is not told.
    fn follow(&self, from: Slice, sign: f32) -> Vec<Slice> {
        let mut found: Vec<Slice> = vec![from];
        let mut ahead = Vec3::Z * sign;
        let (mut at, mut lost) = (from.centre, 0);
        for _ in 0..4000 {
            at += ahead * self.slice_m;
            let recent = &found[found.len().saturating_sub(5)..];
            let mut radii: Vec<f32> = recent.iter().map(|s| s.radius_m).collect();
            radii.sort_unstable_by(f32::total_cmp);
            let usual_m = radii.get(radii.len() / 2).copied().unwrap_or(from.radius_m);
            let reach_m = 1.6 * usual_m + 0.03 * (1.0 + lost as f32);
            let slice = self.slice(at, ahead, reach_m, LENIENT).filter(|s| {
                let ratio = s.radius_m / usual_m;
                // Roots widen a stem downwards.
                let range = if sign > 0.0 { 0.6..=1.15 } else { 0.8..=1.6 };
                range.contains(&ratio)
                    && s.centre.distance(at) <= (0.4 * usual_m + 0.01) * (1.0 + lost as f32)
            });
            let Some(slice) = slice else {
                lost += 1;
                if lost > MOST_LOST {
                    break;
                }
                continue;
            };
            lost = 0;
            found.push(slice);
            at = slice.centre;
            if let Some(back) = found.len().checked_sub(6).and_then(|i| found.get(i)) {
                let way = (slice.centre - back.centre).normalize_or(ahead);
                if way.dot(ahead) > 0.8 {
                    ahead = way;
                }
            }
        }
        found.split_off(1)
    }
}

/// The stem's cross-sections from the lowest up, radii not growing; empty where none is seen.
pub(super) fn stem(points: &[Vec3], floor_m: f32, height_m: f32, seed: Seed) -> Vec<Slice> {
    let slice_m = (0.01 * height_m).clamp(0.06, 0.25);
    let search = Search { points, near: Points::new(points), slice_m, seed };
    let reach_m = (0.03 * height_m).clamp(0.12, 0.9);
    let mut best: Vec<Slice> = Vec::new();
    for column in columns(points, floor_m, height_m) {
        for k in 0..12 {
            let z = floor_m + height_m * (0.03 + 0.03 * k as f32);
            if best.iter().any(|s| (s.centre.z - z).abs() < slice_m) {
                continue;
            }
            let Some(start) = search.slice(column.extend(z), Vec3::Z, reach_m, STRICT) else {
                continue;
            };
            let mut all = search.follow(start, -1.0);
            all.reverse();
            all.push(start);
            all.extend(search.follow(start, 1.0));
            if all.len() > best.len() {
                best = all;
            }
        }
    }
    if best.len() < LEAST_SLICES {
        return Vec::new();
    }
    tapered(&mut best);
    evened(&mut best);
    best
}

/// Places that are occupied at the most heights of the lower part, best first.
fn columns(points: &[Vec3], floor_m: f32, height_m: f32) -> Vec<Vec2> {
    let cell_m = (height_m / 60.0).clamp(0.05, 0.3);
    let mut seen: std::collections::BTreeMap<[i32; 2], (u64, Vec2, f32)> = Default::default();
    for p in points {
        let t = (p.z - floor_m) / (0.45 * height_m);
        if (0.05..1.0).contains(&t) {
            let cell = (p.truncate() / cell_m).floor();
            let entry = seen.entry([cell.x as i32, cell.y as i32]).or_default();
            entry.0 |= 1 << ((t * 64.0) as u32).min(63);
            entry.1 += p.truncate();
            entry.2 += 1.0;
        }
    }
    let mut ranked: Vec<(u32, [i32; 2], Vec2)> = Vec::with_capacity(seen.len());
    for &cell in seen.keys() {
        let (mut heights, mut sum, mut count) = (0u64, Vec2::ZERO, 0.0);
        for (dx, dy) in [-1, 0, 1].into_iter().flat_map(|x| [(x, -1), (x, 0), (x, 1)]) {
            if let Some(e) = seen.get(&[cell[0].saturating_add(dx), cell[1].saturating_add(dy)]) {
                heights |= e.0;
                sum += e.1;
                count += e.2;
            }
        }
        ranked.push((heights.count_ones(), cell, sum / count));
    }
    ranked.sort_by_key(|&(heights, cell, _)| (std::cmp::Reverse(heights), cell));
    let mut out: Vec<Vec2> = Vec::new();
    for (_, _, at) in ranked {
        if out.len() < 4 && out.iter().all(|o| o.distance(at) > 2.0 * cell_m) {
            out.push(at);
        }
    }
    out
}

/// Radii that do not grow upwards, nearest to the measured in least squares (pool adjacent
/// violators).
fn tapered(slices: &mut [Slice]) {
    let mut pools: Vec<(f32, usize)> = Vec::new();
    for s in slices.iter() {
        let mut pool = (s.radius_m, 1);
        while let Some(&(below, n)) = pools.last().filter(|p| p.0 < pool.0) {
            let all = n + pool.1;
            pool = ((below * n as f32 + pool.0 * pool.1 as f32) / all as f32, all);
            pools.pop();
        }
        pools.push(pool);
    }
    let radii = pools.into_iter().flat_map(|(r, n)| std::iter::repeat_n(r, n));
    for (s, r) in slices.iter_mut().zip(radii) {
        s.radius_m = r;
    }
}

/// Centres drawn towards the middle of their neighbours; the ends stay.
fn evened(slices: &mut [Slice]) {
    for _ in 0..2 {
        let before: Vec<Vec3> = slices.iter().map(|s| s.centre).collect();
        for (s, w) in slices.iter_mut().skip(1).zip(before.windows(3)) {
            s.centre = 0.25 * (w[0] + 2.0 * w[1] + w[2]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Half of a circle of 0.1 m, noise of 3 mm, and as much clutter beside it.
    #[test]
    fn a_circle_is_found_from_one_side_among_clutter() {
        let mut draws = Seed::new(3).draws();
        let mut points = Vec::new();
        for k in 0..60 {
            let way = Vec2::from_angle(std::f32::consts::PI * k as f32 / 60.0);
            points.push(Vec2::new(0.3, 0.2) + way * (0.1 + 0.003 * draws.normal()));
        }
        for _ in 0..25 {
            points.push(Vec2::new(draws.between(0.5, 0.9), draws.between(-0.2, 0.6)));
        }
        let found = circle(&points, STRICT, &mut draws).unwrap();
        assert!((found.radius_m - 0.1).abs() < 0.004, "{found:?}");
        assert!(found.centre.distance(Vec2::new(0.3, 0.2)) < 0.005, "{found:?}");
    }

    #[test]
    fn no_circle_in_a_cloud_or_on_a_line() {
        let mut draws = Seed::new(5).draws();
        let cloud: Vec<Vec2> = (0..200)
            .map(|_| Vec2::new(draws.between(-0.5, 0.5), draws.between(-0.5, 0.5)))
            .collect();
        assert!(circle(&cloud, LENIENT, &mut draws).is_none());
        let line: Vec<Vec2> = (0..50).map(|i| Vec2::splat(i as f32 * 0.01)).collect();
        assert!(circle(&line, LENIENT, &mut draws).is_none());
        assert!(circle(&[Vec2::ONE; 40], LENIENT, &mut draws).is_none());
    }
}
