//! Whether each tree stands on the terrain: its root against the terrain triangle above or below.

use rayon::prelude::*;

use glam::{DVec2, DVec3};

use super::Instance;
use crate::mesh::Surface;

/// A root may lie this far above or below the terrain mesh, metres.
pub const ROOT_TOLERANCE_M: f32 = 0.5;

/// A root may lie this far beside the terrain mesh, metres: a mesh may end up to half a coarse
/// cell before the scan does. Its height is then not judged.
pub const OFF_TERRAIN_M: f32 = 2.0;

/// Where a root is in relation to the terrain.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Standing {
    /// Root minus terrain height, metres.
    Above(f64),
    /// Metres in plan to the nearest terrain triangle, where none is above or below.
    Beside(f64),
}

/// Indices of `terrain` must be in range. Roots are sorted by x, so a triangle meets only those
/// in its own strip; memory is O(roots).
pub(super) fn standings(terrain: &Surface, instances: &[Instance]) -> Vec<Standing> {
    let mut roots: Vec<(f64, u32)> =
        (0u32..).zip(instances).map(|(i, tree)| (f64::from(tree.position.x), i)).collect();
    roots.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));

    let meet = |roots: &[(f64, u32)], margin: f64| -> Vec<(u32, Standing)> {
        terrain
            .index
            .par_chunks(3 * 4096)
            .flat_map_iter(|block| {
                let mut met = Vec::new();
                for corners in block.chunks_exact(3) {
                    let triangle =
                        [0, 1, 2].map(|k| terrain.position[corners[k] as usize].as_dvec3());
                    meet_triangle(&triangle, roots, instances, margin, &mut met);
                }
                met
            })
            .collect()
    };

    let mut result = vec![Standing::Beside(f64::INFINITY); instances.len()];
    for (tree, standing) in meet(&roots, 0.0) {
        nearer(&mut result[tree as usize], standing);
    }
    roots.retain(|&(_, tree)| matches!(result[tree as usize], Standing::Beside(_)));
    if !roots.is_empty() {
        for (tree, standing) in meet(&roots, f64::from(OFF_TERRAIN_M)) {
            nearer(&mut result[tree as usize], standing);
        }
    }
    result
}

/// On a shared edge, or under an overhang, the closest triangle counts.
fn nearer(old: &mut Standing, new: Standing) {
    let better = match (*old, new) {
        (Standing::Above(a), Standing::Above(b)) => b.abs() < a.abs(),
        (Standing::Beside(a), Standing::Beside(b)) => b < a,
        (Standing::Beside(_), Standing::Above(_)) => true,
        (Standing::Above(_), Standing::Beside(_)) => false,
    };
    if better {
        *old = new;
    }
}

fn meet_triangle(
    triangle: &[DVec3; 3],
    roots: &[(f64, u32)],
    instances: &[Instance],
    margin: f64,
    met: &mut Vec<(u32, Standing)>,
) {
    let lo = triangle[0].min(triangle[1]).min(triangle[2]) - margin;
    let hi = triangle[0].max(triangle[1]).max(triangle[2]) + margin;
    let first = roots.partition_point(|r| r.0 < lo.x);
    for &(x, tree) in roots[first..].iter().take_while(|r| r.0 <= hi.x) {
        let root = instances[tree as usize].position.as_dvec3();
        if root.y < lo.y || root.y > hi.y {
            continue;
        }
        let p = DVec2::new(x, root.y);
        if let Some(height) = height_at(triangle, p) {
            met.push((tree, Standing::Above(root.z - height)));
        } else if margin > 0.0 {
            met.push((tree, Standing::Beside(distance_in_plan(triangle, p))));
        }
    }
}

/// Height of the triangle's plane at `p`, if `p` is inside in plan.
fn height_at([a, b, c]: &[DVec3; 3], p: DVec2) -> Option<f64> {
    let (u, v, w) = (b.truncate() - a.truncate(), c.truncate() - a.truncate(), p - a.truncate());
    let area = u.perp_dot(v);
    let (s, t) = (w.perp_dot(v) / area, u.perp_dot(w) / area);
    // An upright triangle has no area in plan: s and t are then not finite and no bound holds.
    (s >= 0.0 && t >= 0.0 && s + t <= 1.0).then_some(a.z + s * (b.z - a.z) + t * (c.z - a.z))
}

/// From a point outside the triangle.
fn distance_in_plan(triangle: &[DVec3; 3], p: DVec2) -> f64 {
    let [a, b, c] = triangle.map(|corner| corner.truncate());
    [(a, b), (b, c), (c, a)]
        .map(|(from, to)| {
            let along = to - from;
            // An upright edge is a point in plan.
            let length_sq = along.length_squared().max(f64::MIN_POSITIVE);
            from.lerp(to, ((p - from).dot(along) / length_sq).clamp(0.0, 1.0)).distance(p)
        })
        .into_iter()
        .fold(f64::INFINITY, f64::min)
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::*;
    use crate::scene::sample::forest;

    /// Roots against the square 0…4 × 0…4 of the plane z = x.
    fn on_slope(roots: &[Vec3]) -> Vec<Standing> {
        let corners = [(0.0, 0.0), (4.0, 0.0), (4.0, 4.0), (0.0, 4.0)];
        let terrain = Surface {
            position: corners.map(|(x, y)| Vec3::new(x, y, x)).to_vec(),
            index: vec![0, 1, 2, 0, 2, 3],
            ..Surface::default()
        };
        let model = forest(&["Larix"], 1, 8.0).instances.remove(0);
        let trees: Vec<Instance> =
            roots.iter().map(|&position| Instance { position, ..model.clone() }).collect();
        standings(&terrain, &trees)
    }

    #[test]
    fn heights_inside_on_edges_and_on_corners() {
        let found = on_slope(&[
            Vec3::new(3.0, 1.0, 3.25),
            Vec3::new(1.0, 3.0, 0.0),
            Vec3::new(2.0, 2.0, 2.0),
            Vec3::new(4.0, 4.0, 4.0),
            Vec3::new(0.0, 2.0, 0.0),
        ]);
        let expected = [0.25, -1.0, 0.0, 0.0, 0.0].map(Standing::Above);
        assert_eq!(found, expected);
    }

    #[test]
    fn distances_beside_the_mesh() {
        let found = on_slope(&[
            Vec3::new(-1.5, 2.0, 50.0),
            Vec3::new(4.6, 4.8, 0.0),
            Vec3::new(9.0, 2.0, 0.0),
        ]);
        let Standing::Beside(side) = found[0] else { panic!("{found:?}") };
        let Standing::Beside(corner) = found[1] else { panic!("{found:?}") };
        assert!((side - 1.5).abs() < 1e-6 && (corner - 1.0).abs() < 1e-6, "{found:?}");
        assert_eq!(found[2], Standing::Beside(f64::INFINITY));
    }

    #[test]
    fn trees_of_a_rough_ground_are_all_met() {
        let scene = forest(&["Larix", "Betula"], 200, 80.0);
        let terrain = &scene.terrain.as_ref().unwrap().surface;
        for standing in standings(terrain, &scene.instances) {
            assert!(matches!(standing, Standing::Above(dz) if dz.abs() < 0.1), "{standing:?}");
        }
    }
}
