//! How evenly bark lies on the wood of every species.

use std::collections::HashMap;

use glam::{Vec2, Vec3};

use super::*;
use crate::skeleton::{Detail, Target, grow};
use crate::species;

/// By area, the shares of a wood whose bark adjoins some of more than twice or less than half its
/// density: within a tube, across a seam, at a junction.
#[derive(Debug, Default)]
struct Evenness {
    jumps: [f32; 3],
    /// Of all seams' edges: those whose tiles do not meet.
    torn: usize,
}

fn evenness(surfaces: &[&Surface]) -> Evenness {
    let mut out = Evenness::default();
    let mut whole = 0.0;
    // Of every edge, by its places: area and density beside it, coordinates at its ends, and which
    // vertices these are.
    type Side = (f32, f32, [Vec2; 2], (usize, u32, u32));
    let mut edges: HashMap<[[u32; 3]; 2], Vec<Side>> = Default::default();
    let key = |p: Vec3| (p + Vec3::ZERO).to_array().map(f32::to_bits);
    for (which, s) in surfaces.iter().enumerate() {
        for t in s.index.chunks_exact(3) {
            let [a, b, c] = [0, 1, 2].map(|k| s.position[t[k] as usize]);
            let [p, q, r] = [0, 1, 2].map(|k| s.uv[t[k] as usize]);
            let area = 0.5 * (b - a).cross(c - a).length();
            let flat = 0.5 * (q - p).perp_dot(r - p);
            // Below the ground, at the tips and in a twig's foot the bark may end as it likes.
            let is_seen = a.z.min(b.z).min(c.z) >= 0.0 && flat.abs() > 1e-9;
            if !is_seen {
                continue;
            }
            whole += area;
            let density = (flat.abs() / area).sqrt();
            for k in 0..3 {
                let (i, j) = (t[k], t[(k + 1) % 3]);
                let ends = [i, j].map(|v| (key(s.position[v as usize]), s.uv[v as usize]));
                let (i, j, ends) =
                    if ends[0].0 < ends[1].0 { (i, j, ends) } else { (j, i, [ends[1], ends[0]]) };
                let side = (area / 3.0, density, [ends[0].1, ends[1].1], (which, i, j));
                edges.entry([ends[0].0, ends[1].0]).or_default().push(side);
            }
        }
    }
    for sides in edges.values() {
        let [a, b] = sides[..] else { continue };
        let gap = [0, 1].map(|k| b.2[k] - a.2[k]);
        let meets = gap.iter().all(|g| g.y.abs() < 1e-3 && (g.x - g.x.round()).abs() < 1e-3);
        let kind = if a.3 == b.3 || gap == [Vec2::ZERO; 2] {
            0
        } else if meets
            || a.3.0 == b.3.0
                && gap[0].x.round() == gap[1].x.round()
                && gap[0].x.abs() > 0.5
                && gap[0].y.abs() < 0.2
        {
            out.torn += usize::from(!meets);
            1
        } else {
            2
        };
        let ratio = (a.1 / b.1).max(b.1 / a.1);
        out.jumps[kind] += (a.0 + b.0) * f32::from(u8::from(ratio > 2.0));
    }
    out.jumps.iter_mut().for_each(|share| *share /= whole);
    out
}

#[test]
fn bark_lies_evenly_across_seams_and_rings() {
    for name in species::builtin_names() {
        let s = species::load(name).unwrap();
        let target = Target::FromSpecies { height_m: None };
        let skeleton = grow(&s, target, Detail::HERO, Seed::new(1)).unwrap();
        let options = MeshOptions { foliage: FoliageLevel::None, ..MeshOptions::HERO };
        let tree = build(&skeleton, &s, &Atlas::whole(0.4), &options, Seed::new(1)).unwrap();
        let e = evenness(&tree.woods());
        let [tube, seam, junction] = e.jumps;
        let is_even = tube < 0.01 && seam < 0.001 && junction < 0.03 && e.torn == 0;
        assert!(is_even, "{name}: {e:?}");
    }
}
