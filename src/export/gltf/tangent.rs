//! Tangents for normal maps, from how the texture lies on the triangles.
//!
//! Each vertex gets the sum of its triangles' u directions, weighted by their area, made
//! perpendicular to its normal (Lengyel, Foundations of Game Engine Development 2, 2019, §7.5);
//! w tells on which side v grows. Vertices are not split where neighbours disagree, as
//! MikkTSpace would: surfaces here are already split at their texture seams.

use glam::{Vec3, Vec4};

use crate::mesh::Surface;
use crate::work::{self, Work};

/// Unit xyz, w = ±1, one a vertex; the direction of growing u, and cross(normal, xyz) · w of
/// growing v (upwards in the picture). Indices must be in range.
pub(super) fn tangents(surface: &Surface) -> Vec<Vec4> {
    work::count(Work::Tangents, surface.position.len());
    let mut along_u = vec![Vec3::ZERO; surface.position.len()];
    let mut along_v = along_u.clone();
    for corners in surface.index.chunks_exact(3) {
        let [a, b, c] = [corners[0], corners[1], corners[2]].map(|i| i as usize);
        let (p, q) =
            (surface.position[b] - surface.position[a], surface.position[c] - surface.position[a]);
        let (s, t) = (surface.uv[b] - surface.uv[a], surface.uv[c] - surface.uv[a]);
        let area_uv = s.perp_dot(t);
        let weight = p.cross(q).length() * area_uv.signum();
        let u = (p * t.y - q * s.y).normalize_or_zero() * weight;
        let v = (q * s.x - p * t.x).normalize_or_zero() * weight;
        for vertex in [a, b, c] {
            along_u[vertex] += u;
            along_v[vertex] += v;
        }
    }
    let sums = along_u.iter().zip(&along_v).zip(&surface.normal);
    sums.map(|((&u, &v), &normal)| {
        // Where the texture has no direction, any will do.
        let tangent = (u - normal * normal.dot(u))
            .try_normalize()
            .unwrap_or_else(|| normal.any_orthonormal_vector());
        let side = normal.cross(tangent).dot(v);
        tangent.extend(if side < 0.0 { -1.0 } else { 1.0 })
    })
    .collect()
}

#[cfg(test)]
mod tests {
    use glam::Vec2;

    use super::*;

    /// A square in the plane z = 0, with its texture turned by `angle`, and mirrored or not.
    fn square(angle: f32, mirrored: bool) -> Surface {
        let corners = [Vec2::ZERO, Vec2::X, Vec2::ONE, Vec2::Y];
        let mirror = Vec2::new(1.0, if mirrored { -1.0 } else { 1.0 });
        Surface {
            position: corners.map(|p| p.extend(0.0)).to_vec(),
            normal: vec![Vec3::Z; 4],
            uv: corners.map(|p| Vec2::from_angle(-angle).rotate(p) * mirror).to_vec(),
            index: vec![0, 1, 2, 0, 2, 3],
            ..Surface::default()
        }
    }

    #[test]
    fn tangents_follow_u_and_w_follows_v() {
        for k in 0..12 {
            let angle = k as f32 * 0.5;
            for (mirrored, w) in [(false, 1.0), (true, -1.0)] {
                for tangent in tangents(&square(angle, mirrored)) {
                    let along_u = Vec2::from_angle(angle).extend(0.0);
                    assert!((tangent.truncate() - along_u).length() < 1e-5, "{angle} {tangent}");
                    assert_eq!(tangent.w, w);
                }
            }
        }
    }

    #[test]
    fn a_texture_without_extent_gives_unit_tangents_all_the_same() {
        let mut surface = square(0.0, false);
        surface.uv = vec![Vec2::splat(0.5); 4];
        for tangent in tangents(&surface) {
            assert!((tangent.truncate().length() - 1.0).abs() < 1e-5);
            assert!(tangent.z.abs() < 1e-5);
        }
    }
}
