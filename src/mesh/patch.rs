//! Parts of a tube's grid of facets that are no whole facets: about the foot of a branch, and where
//! two barks meet.

use glam::{Mat2, Vec2, Vec3, Vec3A};

use super::Surface;
use super::blend;
use super::junction::Hole;
use super::path::Ring;
use super::tube::{Circles, around};

/// Fills a block of facets but for the foot of a branch, whose first corner is returned. Both edges
/// are walked in step: all of it lies in the parent's facets. Folded bark is not folded within the
/// block.
pub fn fill(
    hole: &Hole,
    [low, high]: [&Ring; 2],
    is_folded: bool,
    [p, q]: [u32; 2],
    circles: &Circles,
    corner: &mut Vec<(u32, Vec2)>,
    out: &mut Surface,
) -> u32 {
    let (sides, facets) = (low.sides, hole.facets);
    // Folded bark goes on as in the block's middle: there, back, or there again past the seam.
    let middle = 2 * hole.facet + facets;
    let (back, past) = match middle {
        m if m <= 2 * low.fold() => (false, 0),
        m if m <= 2 * sides => (true, 0),
        _ => (false, sides),
    };
    // Across a seam or fold the block has corners of its own, whose texture goes on.
    let folds = is_folded && (hole.facet..hole.facet + facets).contains(&low.fold());
    let has_own = folds || hole.facet + facets > sides;
    let around = |ring: &Ring, place: f32| {
        if is_folded {
            around(ring, place - past as f32, Some(back))
        } else {
            around(ring, place, None)
        }
    };
    let mut edge = |from: u32, ring: &Ring| -> u32 {
        if !has_own {
            return from + hole.facet;
        }
        let start = out.position.len() as u32;
        for k in 0..=facets {
            let i = (from + (hole.facet + k) % sides) as usize;
            out.position.push(out.position[i]);
            out.normal.push(out.normal[i]);
            out.uv.push(Vec2::new(around(ring, (hole.facet + k) as f32), ring.v));
            if let Some(&colour) = out.wind.get(i) {
                out.wind.push(colour);
            }
        }
        start
    };
    let (p, q) = (edge(p, low), edge(q, high));
    let first = out.position.len() as u32;
    let circle = circles.of(hole.start.sides);
    let inner = hole.start.sides;
    // Texture coordinates around at the block's four corners: between them they are even.
    let [from, to] = [0, facets].map(|k| [p, q].map(|row| out.uv[(row + k) as usize].x));
    let per_facet = (facets as f32).recip();
    // Places and normals at the corners of the facet at hand.
    let mut cell = (u32::MAX, [Vec3A::ZERO; 4], [Vec3A::ZERO; 4]);
    for c in &circle[..inner as usize] {
        let x = hole.x + hole.half_x * hole.foot[0].dot(*c);
        let t = hole.t + hole.half_t * hole.foot[1].dot(*c);
        let k = (x as u32).min(facets - 1);
        if k != cell.0 {
            let corner = [p + k, p + k + 1, q + k, q + k + 1].map(|i| i as usize);
            let of = |column: &[Vec3]| corner.map(|i| Vec3A::from(column[i]));
            cell = (k, of(&out.position), of(&out.normal));
        }
        let share = x - k as f32;
        let weight = [(1.0 - share) * (1.0 - t), share * (1.0 - t), (1.0 - share) * t, share * t];
        let across = |[a, b, c, d]: [Vec3A; 4]| {
            (a * weight[0] + b * weight[1]) + (c * weight[2] + d * weight[3])
        };
        let along = [0, 1].map(|row| from[row] + (to[row] - from[row]) * (x * per_facet));
        out.position.push(across(cell.1).into());
        out.normal.push(across(cell.2).normalize_or(cell.2[0]).into());
        out.uv.push(Vec2::new(along[0] + (along[1] - along[0]) * t, low.v + (high.v - low.v) * t));
    }
    // Both counter-clockwise; the outer edge from its upper right, the inner one from its top. Each
    // inner edge takes the outer corner furthest out as it sees it, which is never hidden (the
    // block is convex and holds the foot), as two calipers turn around.
    let outer = 2 * (facets + 1);
    let (top, bottom) = ((1.0 - hole.t) / hole.half_t, (0.0 - hole.t) / hole.half_t);
    // As the foot's circle has it.
    let [x, t] = hole.foot;
    let to_circle = Mat2::from_cols(x, t).transpose().inverse();
    let place = |k: u32, y: f32| to_circle * Vec2::new((k as f32 - hole.x) / hole.half_x, y);
    corner.clear();
    corner.extend((0..=facets).rev().map(|k| (q + k, place(k, top))));
    corner.extend((0..=facets).map(|k| (p + k, place(k, bottom))));
    let away = |i: u32| circle[i as usize] + circle[i as usize + 1];
    let onward = |j: usize| if j + 1 == corner.len() { 0 } else { j + 1 };
    let (mut j, mut far) = (0, f32::NEG_INFINITY);
    for (k, c) in corner.iter().enumerate() {
        let out = c.1.dot(away(0));
        if out > far {
            (j, far) = (k, out);
        }
    }
    let start = out.index.len();
    out.index.resize(start + 3 * (outer + inner) as usize, first);
    let mut faces = out.index[start..].as_chunks_mut::<3>().0.iter_mut();
    let mut add = |face: [u32; 3]| {
        if let Some(slot) = faces.next() {
            *slot = face;
        }
    };
    let mut left = outer;
    for i in 0..inner {
        let away = away(i);
        let mut here = corner[j].1.dot(away);
        while left > 0 {
            let next = onward(j);
            let beyond = corner[next].1.dot(away);
            if beyond <= here {
                break;
            }
            add([corner[j].0, corner[next].0, first + i]);
            (j, here, left) = (next, beyond, left - 1);
        }
        let next = if i + 1 == inner { first } else { first + i + 1 };
        add([corner[j].0, next, first + i]);
    }
    for _ in 0..left {
        add([corner[j].0, corner[onward(j)].0, first]);
        j = onward(j);
    }
    first
}

/// A new vertex on an edge of a facet.
pub fn on_edge(edge: usize, t: f32, corner: [u32; 4], out: &mut Surface) -> u32 {
    let [a, b] = blend::ENDS[edge].map(|k| corner[k] as usize);
    let new = out.position.len() as u32;
    out.position.push(out.position[a].lerp(out.position[b], t));
    out.normal.push(out.normal[a].lerp(out.normal[b], t).normalize_or(out.normal[a]));
    out.uv.push(out.uv[a].lerp(out.uv[b], t));
    if let (Some(&from), Some(&to)) = (out.wind.get(a), out.wind.get(b)) {
        let mix = |c: usize| (f32::from(from[c]) * (1.0 - t) + f32::from(to[c]) * t + 0.5) as u8;
        out.wind.push(std::array::from_fn(mix));
    }
    new
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use std::f32::consts::TAU;

    use super::super::path::Start;
    use super::super::tube::corners;
    use super::*;

    fn ring(z: f32, sides: u32) -> Ring {
        Ring {
            centre: Vec3::Z * z,
            tangent: Vec3::Z,
            normal: Vec3::X,
            radius_m: 1.0,
            arc_m: z,
            slope: 0.0,
            sides,
            lobe: 0.0,
            girth: 6.0,
            repeats: 6.0,
            u: 0.0,
            v: z,
            bark: 0,
        }
    }

    proptest! {
        /// Feet of every shape anywhere in their block: laid flat, the filling covers the block but
        /// for the foot, once.
        #[test]
        fn the_filling_of_a_block_folds_nowhere(
            facet in 0u32..12,
            facets in 1u32..7,
            corners_of_foot in 3u32..24,
            across in 0.0f32..1.0,
            wide in 0.05f32..1.0,
            along in 0.0f32..1.0,
            high in 0.002f32..0.4,
            way in 0.0f32..6.3,
            long in 1.0f32..2.3,
        ) {
            let sides = 12;
            let circles = Circles::new();
            let (low, top) = (ring(0.0, sides), ring(0.7, sides));
            let mut out = Surface::default();
            corners(&low, &circles, 0.0, false, &mut out);
            corners(&top, &circles, 0.0, false, &mut out);
            let half_x = 0.42 * facets as f32 * wide;
            let room = facets as f32 - 2.0 * (half_x + 0.08);
            let x = half_x + 0.08 + room.max(0.0) * across;
            let t = high + 0.06 + (1.0 - 2.0 * (high + 0.06)) * along;
            let way = Vec2::from_angle(way);
            let foot = [Vec2::new(long * way.x, -way.y), Vec2::new(long * way.y, way.x)];
            let foot = foot.map(Vec2::normalize);
            let hole = Hole::new(facet, facets, [x, half_x], [t, high], foot, Start::along_x(corners_of_foot));
            fill(&hole, [&low, &top], false, [0, sides + 1], &circles, &mut Vec::new(), &mut out);
            prop_assert_eq!(out.triangles() as u32, 2 * facets + 2 + corners_of_foot);
            // The texture coordinates are the tube laid flat.
            let mut sum = 0.0;
            for t in out.index.chunks_exact(3) {
                let [a, b, c] = [0, 1, 2].map(|k| out.uv[t[k] as usize]);
                let area = 0.5 * (b - a).perp_dot(c - a);
                prop_assert!(area > 0.0, "{area}");
                sum += area;
            }
            let n = corners_of_foot as f32;
            let circle = 0.5 * n * (TAU / n).sin();
            let left_out = circle * (half_x * 0.5) * (high * 0.7) * foot[0].perp_dot(foot[1]);
            prop_assert!((sum - (facets as f32 * 0.5 * 0.7 - left_out)).abs() < 1e-4);
        }
    }
}
