//! Triangles to samples: clipping, and filling by integer edge functions with the top-left rule,
//! so that triangles that share an edge leave no gap and cover no sample twice.

use glam::{Vec2, Vec3};

use super::camera::View;

/// A rectangle of samples, ends excluded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Rect {
    pub x0: i32,
    pub y0: i32,
    pub x1: i32,
    pub y1: i32,
}

const SUBSAMPLES: f32 = 256.0;
const HALF: i64 = 128;
/// Samples across a triangle up to which each is looked at.
const NARROW: i32 = 8;

/// Calls `each(x, y, weights)` for every sample of `rect` whose middle the triangle covers;
/// weights belong to the corners in the order given. Corners must be within 2^20 samples of 0.
pub(super) fn fill(corner: [Vec2; 3], rect: Rect, mut each: impl FnMut(i32, i32, [f32; 3])) {
    // To the nearest.
    let whole = |v: f32| (f64::from(v * SUBSAMPLES) + 0.5f64.copysign(v.into())) as i64;
    let fixed = corner.map(|c| [whole(c.x), whole(c.y)]);
    let [a, mut b, mut c] = fixed;
    let mut area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
    if area == 0 {
        return;
    }
    let is_swapped = area < 0;
    if is_swapped {
        std::mem::swap(&mut b, &mut c);
        area = -area;
    }
    // First and last sample whose middle may lie inside.
    let first = |v: i64| ((v - HALF + 255) >> 8) as i32;
    let last = |v: i64| ((v - HALF) >> 8) as i32;
    let x0 = first(a[0].min(b[0]).min(c[0])).max(rect.x0);
    let x1 = last(a[0].max(b[0]).max(c[0])).min(rect.x1 - 1);
    let y0 = first(a[1].min(b[1]).min(c[1])).max(rect.y0);
    let y1 = last(a[1].max(b[1]).max(c[1])).min(rect.y1 - 1);
    if x0 > x1 || y0 > y1 {
        return;
    }
    let inv_area = 1.0 / area as f32;
    // Edge opposite each corner: value at the first sample, steps, and the rule for its own samples.
    let edge = |p: [i64; 2], q: [i64; 2]| {
        let (dx, dy) = (q[0] - p[0], q[1] - p[1]);
        let sx = (i64::from(x0) << 8) + HALF;
        let sy = (i64::from(y0) << 8) + HALF;
        let is_top_left = dy < 0 || (dy == 0 && dx > 0);
        let value = dx * (sy - p[1]) - dy * (sx - p[0]);
        (value, -dy * 256, dx * 256, i64::from(!is_top_left))
    };
    let (mut ra, ax, ay, at) = edge(b, c);
    let (mut rb, bx, by, bt) = edge(c, a);
    let (mut rc, cx, cy, ct) = edge(a, b);
    // Of wide triangles a row's ends are found by division, of narrow ones by looking.
    let is_wide = x1 - x0 > NARROW;
    for y in y0..=y1 {
        let (mut ea, mut eb, mut ec) = (ra, rb, rc);
        let (mut from, mut to) = (x0, x1);
        if is_wide {
            let mut ends = (0, i64::from(x1 - x0));
            for (value, step, least) in [(ra, ax, at), (rb, bx, bt), (rc, cx, ct)] {
                narrow(value, step, least, &mut ends);
            }
            if ends.0 > ends.1 {
                (ra, rb, rc) = (ra + ay, rb + by, rc + cy);
                continue;
            }
            (ea, eb, ec) = (ea + ax * ends.0, eb + bx * ends.0, ec + cx * ends.0);
            (from, to) = (x0 + ends.0 as i32, x0 + ends.1 as i32);
        }
        let mut was_inside = false;
        for x in from..=to {
            if ea >= at && eb >= bt && ec >= ct {
                was_inside = true;
                let wa = ea as f32 * inv_area;
                let wb = eb as f32 * inv_area;
                let wc = ec as f32 * inv_area;
                each(x, y, if is_swapped { [wa, wc, wb] } else { [wa, wb, wc] });
            } else if was_inside {
                break;
            }
            ea += ax;
            eb += bx;
            ec += cx;
        }
        ra += ay;
        rb += by;
        rc += cy;
    }
}

/// Draws in the ends of a row, in samples from its first, to where `value`, which grows by `step` each
/// sample, is `least` or more. Ends that cross hold none.
fn narrow(value: i64, step: i64, least: i64, (first, last): &mut (i64, i64)) {
    let short = least - value;
    if step > 0 {
        *first = (*first).max((short + step - 1).div_euclid(step));
    } else if step < 0 {
        *last = (*last).min((-short).div_euclid(-step));
    } else if short > 0 {
        *last = -1;
    }
}

/// A corner in view space with what is interpolated over the triangle.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Corner {
    pub view: Vec3,
    pub uv: Vec2,
    pub normal: Vec3,
    pub bulge: Vec3,
}

impl Corner {
    fn between(&self, other: &Corner, t: f32) -> Corner {
        Corner {
            view: self.view.lerp(other.view, t),
            uv: self.uv.lerp(other.uv, t),
            normal: self.normal.lerp(other.normal, t),
            bulge: self.bulge.lerp(other.bulge, t),
        }
    }
}

/// The part of a triangle inside the view's clip planes (Sutherland & Hodgman 1974): a convex
/// polygon of up to 8 corners in `out`, of which the count is returned.
pub(super) fn clip(view: &View, triangle: [Corner; 3], out: &mut [Corner; 8]) -> usize {
    let mut count = 3;
    out[..3].copy_from_slice(&triangle);
    for (normal, offset) in view.clip_planes() {
        let from = *out;
        let mut kept = 0;
        for i in 0..count {
            let (p, q) = (&from[i], &from[(i + 1) % count]);
            let (dp, dq) = (normal.dot(p.view) + offset, normal.dot(q.view) + offset);
            if dp >= 0.0 && kept < 8 {
                out[kept] = *p;
                kept += 1;
            }
            if (dp >= 0.0) != (dq >= 0.0) && kept < 8 {
                out[kept] = p.between(q, dp / (dp - dq));
                kept += 1;
            }
        }
        count = kept;
        if count < 3 {
            return 0;
        }
    }
    count
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const RECT: Rect = Rect { x0: 0, y0: 0, x1: 8, y1: 8 };

    fn covered(corner: [Vec2; 3]) -> Vec<(i32, i32)> {
        let mut out = Vec::new();
        fill(corner, RECT, |x, y, w| {
            assert!((w[0] + w[1] + w[2] - 1.0).abs() < 1e-4);
            out.push((x, y));
        });
        out
    }

    proptest! {
        /// Whether a sample is covered does not depend on how wide its triangle, or what is seen of it, is.
        #[test]
        fn wide_triangles_cover_what_narrow_windows_of_them_show(
            at in proptest::array::uniform6(-30.0f32..30.0),
        ) {
            let corner = [0, 2, 4].map(|i| Vec2::new(at[i], at[i + 1]));
            let seen = |rect: Rect| {
                let mut out = Vec::new();
                fill(corner, rect, |x, y, w| out.push((y, x, w.map(f32::to_bits))));
                out
            };
            let rect = Rect { x0: -30, y0: -30, x1: 30, y1: 30 };
            let strip = |x: i32| Rect { x0: x, x1: x + NARROW, ..rect };
            let mut strips: Vec<_> =
                (rect.x0..rect.x1).step_by(NARROW as usize).flat_map(|x| seen(strip(x))).collect();
            strips.retain(|s| s.1 < rect.x1);
            strips.sort_unstable();
            let mut whole = seen(rect);
            whole.sort_unstable();
            prop_assert_eq!(whole, strips);
        }
    }

    #[test]
    fn a_right_triangle_covers_exactly_these_samples() {
        let v = Vec2::new;
        // Legs of 3 samples: the diagonal passes through no sample middle.
        let got = covered([v(1.0, 1.0), v(4.2, 1.0), v(1.0, 4.2)]);
        assert_eq!(got, [(1, 1), (2, 1), (3, 1), (1, 2), (2, 2), (1, 3)]);
        // Either winding covers the same.
        assert_eq!(covered([v(1.0, 1.0), v(1.0, 4.2), v(4.2, 1.0)]), got);
        // Through sample middles: left and top edges own them, right and bottom do not.
        let square = [v(1.5, 1.5), v(3.5, 1.5), v(3.5, 3.5), v(1.5, 3.5)];
        let mut both = covered([square[0], square[1], square[2]]);
        both.extend(covered([square[0], square[2], square[3]]));
        both.sort();
        assert_eq!(both, [(1, 1), (1, 2), (2, 1), (2, 2)]);
    }

    #[test]
    fn weights_belong_to_their_corners() {
        let corner = [Vec2::new(0.5, 0.5), Vec2::new(7.5, 0.5), Vec2::new(0.5, 7.5)];
        for order in [[0, 1, 2], [1, 0, 2], [2, 1, 0]] {
            fill(order.map(|i| corner[i]), RECT, |x, y, w| {
                let p: Vec2 = (0..3).map(|k| corner[order[k]] * w[k]).sum();
                assert!((p - Vec2::new(x as f32 + 0.5, y as f32 + 0.5)).length() < 1e-3);
            });
        }
    }

    proptest! {
        /// A fan around an inner point tiles the square: each sample exactly once.
        #[test]
        fn shared_edges_leave_no_gap_and_no_overlap(x in 0.1f32..7.9, y in 0.1f32..7.9) {
            let ring = [Vec2::ZERO, Vec2::new(8.0, 0.0), Vec2::splat(8.0), Vec2::new(0.0, 8.0)];
            let mut count = [[0; 8]; 8];
            for i in 0..4 {
                fill([Vec2::new(x, y), ring[i], ring[(i + 1) % 4]], RECT, |x, y, _| {
                    count[y as usize][x as usize] += 1;
                });
            }
            prop_assert!(count.iter().flatten().all(|&c| c == 1), "{:?}", count);
        }
    }
}
