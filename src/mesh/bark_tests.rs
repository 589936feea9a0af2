//! How evenly bark lies on the wood of every species.

use std::collections::HashMap;

use glam::{Vec2, Vec3};

use super::stalk::nearest;
use super::*;
use crate::skeleton::{Detail, NO_PARENT, Target, grow};
use crate::species;

/// Seen from near.
fn grown(name: &str, seed: u64) -> (Species, Skeleton) {
    let s = species::load(name).unwrap();
    let target = Target::FromSpecies { height_m: None };
    let skeleton = grow(&s, target, Detail::HERO, Seed::new(seed)).unwrap();
    (s, skeleton)
}

/// By area, the shares of a wood whose bark adjoins some of more than twice or less than half its
/// density: within a tube, across a seam, at a junction.
#[derive(Debug, Default)]
struct Evenness {
    jumps: [f32; 3],
    /// Edges of seams whose tiles do not meet.
    torn: usize,
}

fn evenness(surfaces: &[&Surface]) -> Evenness {
    let mut out = Evenness::default();
    let mut whole = 0.0;
    // Of every edge, by its places: area and density beside it, coordinates and normals at its ends, which
    // vertices these are.
    // The sign of the density is that of the side from which the tile is seen.
    type Side = (f32, f32, [(Vec2, Vec3); 2], (usize, u32, u32));
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
            let density = (flat.abs() / area).sqrt().copysign(flat);
            for k in 0..3 {
                let (i, j) = (t[k], t[(k + 1) % 3]);
                let ends = [i, j].map(|v| {
                    let v = v as usize;
                    (key(s.position[v]), (s.uv[v], s.normal[v]))
                });
                let (i, j, ends) =
                    if ends[0].0 < ends[1].0 { (i, j, ends) } else { (j, i, [ends[1], ends[0]]) };
                let side = (area / 3.0, density, [ends[0].1, ends[1].1], (which, i, j));
                edges.entry([ends[0].0, ends[1].0]).or_default().push(side);
            }
        }
    }
    for sides in edges.values() {
        let [a, b] = sides[..] else { continue };
        let gap = [0, 1].map(|k| b.2[k].0 - a.2[k].0);
        let is_smooth = [0, 1].iter().all(|&k| a.2[k].1 == b.2[k].1);
        let is_even = (gap[0] - gap[1]).length() < 0.01;
        let meets = gap.iter().all(|g| g.y.abs() < 1e-3 && (g.x - g.x.round()).abs() < 1e-3);
        // Not where bark turns back, nor where another way to lay it begins.
        let is_seam = is_smooth && a.3.0 == b.3.0 && (a.1 / b.1 - 1.0).abs() < 0.05;
        let nearly = gap.iter().all(|g| g.y.abs() < 0.2 && (g.x - g.x.round()).abs() < 0.3);
        let same = gap[0].x.round() == gap[1].x.round() && gap[0].x.abs() > 0.5;
        let kind = if a.3 == b.3 || gap == [Vec2::ZERO; 2] {
            0
        } else if meets || is_seam && is_even && nearly && same {
            out.torn += usize::from(!meets);
            1
        } else {
            2
        };
        let ratio = (a.1 / b.1).abs().max((b.1 / a.1).abs());
        out.jumps[kind] += (a.0 + b.0) * f32::from(u8::from(ratio > 2.0));
    }
    out.jumps.iter_mut().for_each(|share| *share /= whole);
    out
}

#[test]
fn bark_lies_evenly_across_seams_and_rings() {
    for name in species::builtin_names() {
        let (s, skeleton) = grown(name, 1);
        let options = MeshOptions { foliage: FoliageLevel::None, ..MeshOptions::HERO };
        let tree = build(&skeleton, &s, &Atlas::whole(0.4), &options, Seed::new(1)).unwrap();
        let e = evenness(&tree.woods());
        let [tube, seam, junction] = e.jumps;
        let is_even = tube < 0.01 && seam < 0.001 && junction < 0.03;
        // Where another way to lay bark begins, one or the other edge looks like a torn seam.
        let is_even = is_even && e.torn <= 1;
        assert!(is_even, "{name}: {e:?}");
    }
}

/// Least and greatest tiles of bark a metre, in any direction, with the area, of every triangle above
/// ground.
fn densities(surfaces: &[&Surface]) -> Vec<([f32; 2], f32)> {
    let mut out = Vec::new();
    for s in surfaces {
        for t in s.index.chunks_exact(3) {
            let [a, b, c] = [0, 1, 2].map(|k| s.position[t[k] as usize]);
            if a.z.min(b.z).min(c.z) < 0.0 {
                continue;
            }
            let [p, q, r] = [0, 1, 2].map(|k| s.uv[t[k] as usize]);
            // The singular values of the map from the triangle's plane to the texture.
            let (e, f) = (b - a, c - a);
            let x = e.normalize_or_zero();
            let (ex, fx) = (e.length(), f.dot(x));
            let fy = (f - x * fx).length();
            let du = (q - p) / ex;
            let dv = (r - p - du * fx) / fy;
            let (sum, det) = (du.length_squared() + dv.length_squared(), du.perp_dot(dv).abs());
            let high = (0.5 * (sum + (sum * sum - 4.0 * det * det).max(0.0).sqrt())).sqrt();
            out.push(([det / high.max(1e-12), high], 0.5 * ex * fy));
        }
    }
    out
}

/// From one tile a metre on thick stems to three on twigs, as wide as they are high.
#[test]
fn bark_is_as_fine_as_its_wood_is_thin() {
    let mut worst = [0.0f32; 3];
    for name in species::builtin_names() {
        let s = species::load(name).unwrap();
        let target = Target::FromSpecies { height_m: None };
        for (detail, options) in
            [(Detail::HERO, MeshOptions::HERO), (Detail::FOREST, MeshOptions::FOREST)]
        {
            let skeleton = grow(&s, target, detail, Seed::new(1)).unwrap();
            let options = MeshOptions { foliage: FoliageLevel::None, ..options };
            let tree = build(&skeleton, &s, &Atlas::whole(0.4), &options, Seed::new(1)).unwrap();
            let share = |surfaces: &[&Surface], [least, most]: [f32; 2], within: f32| {
                let all = densities(surfaces);
                let whole: f32 = all.iter().map(|d| d.1).sum();
                let is_off = |&[low, high]: &[f32; 2]| {
                    low < least / within || high > most * within || high > low * within * within
                };
                all.iter().filter(|d| is_off(&d.0)).map(|d| d.1).sum::<f32>() / whole.max(1e-9)
            };
            // What lies between two barks has a picture of several tiles.
            let woods = [&tree.wood, &tree.upper_wood, &tree.twig_wood];
            let [wide, far] = [1.5, 2.5].map(|f| share(&woods, [1.0, 3.0], f));
            let twigs = share(&[&tree.twig_wood], [3.0, 3.0], 2.0);
            worst = [worst[0].max(wide), worst[1].max(far), worst[2].max(twigs)];
        }
    }
    assert!(worst[0] < 0.17 && worst[1] < 0.07 && worst[2] < 0.16, "{worst:?}");
}

/// A leader is older than branches of its girth: the stem's bark goes higher than theirs would.
#[test]
fn a_leader_keeps_the_bark_of_its_stem() {
    let (s, skeleton) = grown("betula_pendula", 1);
    let options = MeshOptions { foliage: FoliageLevel::None, ..MeshOptions::HERO };
    let tree = build(&skeleton, &s, &Atlas::whole(0.4), &options, Seed::new(1)).unwrap();
    let thick =
        |k: &usize| skeleton.axis[*k] == 0 && skeleton.radius_m[*k] > 0.45 * s.bark.twig_radius_m;
    let height_m = |k: usize| skeleton.position[k].z;
    let stem_m = (0..skeleton.len()).filter(thick).map(height_m).fold(0.0, f32::max);
    let white_m = tree.upper_wood.position.iter().map(|p| p.z).fold(0.0, f32::max);
    assert!(white_m > stem_m, "white to {white_m} m of {stem_m} m");
}

/// It ends in tongues; chips of a few facets above them would look stuck on.
#[test]
fn old_bark_leaves_no_chips() {
    for (name, seed) in
        ["betula_pendula", "pinus_sylvestris"].iter().flat_map(|n| (1..=8).map(move |s| (n, s)))
    {
        let (s, skeleton) = grown(name, seed);
        let tree =
            build(&skeleton, &s, &Atlas::whole(0.4), &MeshOptions::HERO, Seed::new(seed)).unwrap();
        let old = &tree.wood;
        let mut place = HashMap::new();
        let key = |p: Vec3| (p + Vec3::ZERO).to_array().map(f32::to_bits);
        let of: Vec<usize> = (old.position.iter())
            .map(|p| {
                let next = place.len();
                *place.entry(key(*p)).or_insert(next)
            })
            .collect();
        let mut piece: Vec<usize> = (0..place.len()).collect();
        let root = |piece: &[usize], mut k: usize| {
            while piece[k] != k {
                k = piece[k];
            }
            k
        };
        for t in old.index.chunks_exact(3) {
            let [a, b, c] = [0, 1, 2].map(|k| of[t[k] as usize]);
            for (a, b) in [(a, b), (b, c)] {
                let (a, b) = (root(&piece, a), root(&piece, b));
                piece[a.max(b)] = a.min(b);
            }
        }
        let mut triangles: HashMap<usize, usize> = HashMap::new();
        for t in old.index.chunks_exact(3) {
            *triangles.entry(root(&piece, of[t[0] as usize])).or_default() += 1;
        }
        let chips = triangles.values().filter(|n| **n < 6).count();
        assert_eq!(chips, 0, "{name}, seed {seed}: {triangles:?}");
    }
}

/// The tile between two barks begins where the old one stands in its own tile, and ends where the upper one
/// does: all in one line around the stem, once, and well within the tile.
#[test]
fn one_bark_goes_over_into_another_without_a_seam() {
    let names = ["pinus_sylvestris", "pinus_sibirica", "populus_tremula", "larix_sibirica"];
    for (name, seed) in names.iter().flat_map(|n| (1..=4).map(move |s| (n, s))) {
        let (s, skeleton) = grown(name, seed);
        let tree =
            build(&skeleton, &s, &Atlas::whole(0.4), &MeshOptions::HERO, Seed::new(seed)).unwrap();
        let key = |p: Vec3| (p + Vec3::ZERO).to_array().map(f32::to_bits);
        let of = |surface: &Surface| -> HashMap<[u32; 3], Vec<Vec2>> {
            let mut out: HashMap<_, Vec<Vec2>> = HashMap::new();
            for (p, uv) in surface.position.iter().zip(&surface.uv) {
                out.entry(key(*p)).or_default().push(*uv);
            }
            out
        };
        let [old, upper] = [&tree.wood, &tree.upper_wood].map(of);
        let between = &tree.transition_wood;
        assert!(!between.is_empty(), "{name} {seed}");
        let mut met = [0, 0];
        for (p, uv) in between.position.iter().zip(&between.uv) {
            let place = uv.y.rem_euclid(1.0);
            let is_within = (0.049..0.951).contains(&place);
            assert!(is_within, "{name} {seed}: {place} of the tile");
            // Branches have the bark of their own girth.
            let ends = [(&old, 0.05), (&upper, 0.95)].map(|(o, end)| (o, place - end));
            for (k, (other, off)) in ends.into_iter().enumerate() {
                let others = other.get(&key(*p)).filter(|_| off.abs() < 1e-3);
                let Some(others) = others else { continue };
                met[k] += 1;
                // Whole tiles look alike.
                let near = |o: &&Vec2| (**o - *uv - (**o - *uv).round()).length() < 1e-3;
                assert!(others.iter().any(|o| near(&o)), "{name} {seed}: {uv} {others:?}");
            }
        }
        assert!(met.iter().all(|m| *m > 6), "{name} {seed}: {met:?}");
    }
}

/// As wide as its tiles are high, and about where it is on the level before.
#[test]
fn a_transition_is_to_scale_and_stays_from_level_to_level() {
    let names = ["quercus_robur", "pinus_sylvestris", "betula_pendula", "populus_tremula"];
    for (name, seed) in names.iter().flat_map(|n| (1..=4).map(move |s| (n, s))) {
        let (s, skeleton) = grown(name, seed);
        let mut middles_m = Vec::new();
        for triangles in [20_000, 8_000, 3_000] {
            let options = MeshOptions { triangle_budget: Some(triangles), ..MeshOptions::HERO };
            let tree = build(&skeleton, &s, &Atlas::whole(0.4), &options, Seed::new(seed)).unwrap();
            let all = densities(&[&tree.transition_wood]);
            let tiles = crate::texture::bark::TILES as f32;
            let as_wide = |[low, high]: [f32; 2]| (tiles * low / high).max(high / (tiles * low));
            let mut ratios: Vec<f32> = all.iter().map(|(d, _)| as_wide(*d)).collect();
            ratios.sort_by(f32::total_cmp);
            let middle = ratios[ratios.len() / 2];
            assert!(middle < 1.8, "{name} {seed}: {middle} times as long as wide");
            // On limbs, and about their feet, there are others.
            let stem = skeleton.axes().of(0).nodes.to_vec();
            let on_stem = |p: Vec3| {
                let near = |w: &[u32]| {
                    let [a, b] = [w[0], w[1]].map(|i| skeleton.position[i as usize]);
                    nearest(p, a, b).distance(p) < 1.3 * skeleton.radius_m[w[0] as usize]
                };
                stem.windows(2).any(near)
            };
            let Surface { position, index, .. } = &tree.transition_wood;
            let triangles = index.as_chunks::<3>().0.iter();
            let triangles = triangles.map(|t| t.map(|i| position[i as usize]));
            let stem = triangles.filter(|t| t.iter().all(|&p| on_stem(p))).flatten().map(|p| p.z);
            let ends = stem.fold([f32::INFINITY, 0.0], |[low, high], z| [low.min(z), high.max(z)]);
            middles_m.push(0.5 * (ends[0] + ends[1]));
        }
        let off_m = middles_m.iter().map(|z| (z - middles_m[0]).abs()).fold(0.0, f32::max);
        assert!(off_m < 0.5, "{name} {seed}: its middle is at {middles_m:?}");
    }
}

/// A stem of two nodes, foot and tip, has its upper bark from the same height on as one of many.
#[test]
fn bark_of_a_bare_spar_changes_where_that_of_a_longer_row_does() {
    let (species, _) = grown("pinus_sylvestris", 1);
    let spar = |nodes: u32| {
        let share = |i: u32| i as f32 / (nodes - 1) as f32;
        let s = Skeleton {
            position: (0..nodes).map(|i| Vec3::Z * (12.0 * share(i))).collect(),
            parent: (0..nodes).map(|i| i.checked_sub(1).unwrap_or(NO_PARENT)).collect(),
            radius_m: (0..nodes).map(|i| 0.2 - 0.19 * share(i)).collect(),
            axis: vec![0; nodes as usize],
            order: vec![0; nodes as usize],
            birth: vec![0; nodes as usize],
            dead: Vec::new(),
        };
        let options = MeshOptions { foliage: FoliageLevel::None, ..MeshOptions::HERO };
        let tree = build(&s, &species, &Atlas::whole(0.4), &options, Seed::new(1)).unwrap();
        tree.check().unwrap();
        (tree.wood.bounds().1.z, tree.upper_wood.bounds().0.z)
    };
    // Where there is no room for what lies between the two, they meet in its middle.
    let ((old_m, upper_m), (two_old_m, two_upper_m)) = (spar(60), spar(2));
    let middle_m = 0.5 * (old_m + upper_m);
    assert!(old_m < upper_m && upper_m < 12.0);
    assert!((two_old_m - middle_m).abs() < 0.1, "{two_old_m} beside {middle_m}");
    assert!((two_upper_m - middle_m).abs() < 0.1, "{two_upper_m} beside {middle_m}");
}
