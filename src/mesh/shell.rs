//! The crown as one closed surface: for the farthest level, and to cast shadows.
//!
//! Rings about an upright axis through the crown's middle; in each sector of each ring the radius
//! within which nine tenths of the twigs stand. Limit: what a ray from the axis meets twice is
//! filled.

use glam::{Vec2, Vec3};

use super::Surface;
use super::piece::straighten;
use super::spot::{Hull, Spot};
use crate::skeleton::Skeleton;

/// How far up a shell stems go on in it, share of its height.
const INTO: f32 = 0.3;

/// Share of the twigs within the shell.
const WITHIN: f32 = 0.9;

/// A skeleton without the wood that a shell around its leaves hides: the feet of stems are left, on into the
/// shell, and what lies lower than any leaf.
pub fn outside(skeleton: &Skeleton, bearing_radius_m: f32) -> Skeleton {
    let bears = skeleton.bears_leaves(bearing_radius_m);
    let height_m = |i: usize| skeleton.position[i].z;
    let lowest_m = (0..skeleton.len()).filter(|&i| bears[i]).map(height_m).reduce(f32::min);
    let Some(lowest_m) = lowest_m else { return skeleton.clone() };
    let stem_m = lowest_m + INTO * (skeleton.height_m() - lowest_m);
    let is_stem = skeleton.is_stem();
    // Something stands, however low the tree.
    let is_foot = |i: usize| is_stem[i] && skeleton.parent_of(i as u32) == Some(0);
    let is_shown = |i: usize| height_m(i) < if is_stem[i] { stem_m } else { lowest_m };
    let mut keep: Vec<bool> = (0..skeleton.len()).map(|i| is_foot(i) || is_shown(i)).collect();
    for i in (1..skeleton.len()).rev() {
        if keep[i] {
            keep[skeleton.parent[i] as usize] = true;
        }
    }
    skeleton.subset(&keep)
}

/// A closed hull of about `budget` triangles at most, 48 at least; `margin_m` is how far twigs
/// reach beyond their places.
pub fn shell(spots: &[Spot], hull: &Hull, margin_m: f32, budget: usize) -> Surface {
    let (sectors, rings) = match budget {
        400.. => (16usize, 12usize),
        160..400 => (10, 8),
        _ => (6, 4),
    };
    let axis = hull.centre.truncate();
    let (low, high) = spots
        .iter()
        .fold((f32::INFINITY, f32::NEG_INFINITY), |(l, h), s| (l.min(s.at.z), h.max(s.at.z)));
    // What reaches into the ground would be cut off, and the shell be open.
    let (low, high) = ((low - 0.5 * margin_m).max(0.0), high + 0.5 * margin_m);
    let band_m = ((high - low) / rings as f32).max(1e-3);
    let mut reach = vec![Vec::new(); rings * sectors];
    for s in spots {
        let away = s.at.truncate() - axis;
        let turn = (away.to_angle() / std::f32::consts::TAU).rem_euclid(1.0);
        let sector = ((turn * sectors as f32) as usize).min(sectors - 1);
        let ring = (((s.at.z - low) / band_m).max(0.0) as usize).min(rings - 1);
        reach[ring * sectors + sector].push(away.length());
    }
    let radius: Vec<Option<f32>> = reach
        .iter_mut()
        .map(|r| {
            r.sort_unstable_by(f32::total_cmp);
            r.get((r.len().saturating_sub(1) as f32 * WITHIN) as usize).copied()
        })
        .collect();
    let of_ring = |ring: usize| {
        let known: Vec<f32> = (0..sectors).filter_map(|s| radius[ring * sectors + s]).collect();
        known.iter().sum::<f32>() / known.len().max(1) as f32
    };
    // Gaps filled, then evened out around and along, so that no place stands out as a spike.
    let known: Vec<f32> = (0..rings)
        .flat_map(|ring| {
            let mean = of_ring(ring);
            (0..sectors).map(move |s| (ring * sectors + s, 0.6 * mean))
        })
        .map(|(k, usual)| radius[k].unwrap_or(usual))
        .collect();
    let around = |ring: usize, sector: usize| {
        let at = |d: usize| known[ring * sectors + (sector + d) % sectors];
        0.25 * at(sectors - 1) + 0.5 * at(0) + 0.25 * at(1)
    };
    let mut position = Vec::with_capacity(sectors * rings + 2);
    for ring in 0..rings {
        let z = low + band_m * (ring as f32 + 0.5);
        let (below, above) = (ring.saturating_sub(1), (ring + 1).min(rings - 1));
        for sector in 0..sectors {
            let r = 0.25 * around(below, sector)
                + 0.5 * around(ring, sector)
                + 0.25 * around(above, sector);
            let angle = (sector as f32 + 0.5) / sectors as f32 * std::f32::consts::TAU;
            let r = (r + 0.5 * margin_m).max(0.02 + 0.1 * margin_m);
            position.push((axis + Vec2::from_angle(angle) * r).extend(z));
        }
    }
    let (bottom, top) = (position.len() as u32, position.len() as u32 + 1);
    position.push(axis.extend(low));
    position.push(axis.extend(high));
    let mut index = Vec::with_capacity(6 * sectors * rings);
    let at = |ring: usize, sector: usize| (ring * sectors + sector % sectors) as u32;
    for s in 0..sectors {
        index.extend([bottom, at(0, s + 1), at(0, s)]);
        for r in 1..rings {
            let [a, b] = [at(r - 1, s), at(r - 1, s + 1)];
            let [d, e] = [at(r, s), at(r, s + 1)];
            index.extend([a, b, e, a, e, d]);
        }
        index.extend([at(rings - 1, s), at(rings - 1, s + 1), top]);
    }
    let mut normal = vec![Vec3::ZERO; position.len()];
    for t in index.chunks_exact(3) {
        let [a, b, c] = [0, 1, 2].map(|k| position[t[k] as usize]);
        for &i in t {
            normal[i as usize] += (b - a).cross(c - a);
        }
    }
    for (n, p) in normal.iter_mut().zip(&position) {
        *n = n.normalize_or((*p - hull.centre).normalize_or(Vec3::Z));
    }
    (0..8).find(|_| !straighten(&position, &mut normal, &index, 0));
    let uv = vec![Vec2::ZERO; position.len()];
    Surface { position, normal, uv, index, ..Surface::default() }
}
