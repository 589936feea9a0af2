//! Tangents for normal maps, from how the texture lies on the triangles, as MikkTSpace has them
//! (Mikkelsen 2008, Simulation of wrinkled surfaces revisited).
//!
//! Each vertex gets the sum of its triangles' u directions, each first laid into the plane of the
//! vertex' normal and brought to unit length, weighted by the triangle's angle there; w tells
//! whether the texture is mirrored. Departure: vertices are not split where neighbours disagree, for
//! surfaces here are already split at seams and folds of their texture; one whose triangles are partly
//! mirrored goes by those that have more of its angle.

use glam::{Vec3, Vec4};
use rayon::prelude::*;

use crate::mesh::Surface;
use crate::work::{self, Work};

/// What a triangle adds to a corner: a direction by the angle, and the angle.
type Share = (Vec3, f32);

/// Unit xyz, w = ±1, one a vertex; the direction of growing u, and cross(normal, xyz) · w of
/// growing v (upwards in the picture). Indices must be in range.
pub(super) fn tangents(surface: &Surface) -> Vec<Vec4> {
    /// Triangles that are looked at before they are added up, in their order.
    const LOT: usize = 1 << 14;
    work::count(Work::Tangents, surface.position.len());
    // Of the triangles whose texture reads right, and of the mirrored ones.
    let mut sum: Vec<[Share; 2]> = vec![[(Vec3::ZERO, 0.0); 2]; surface.position.len()];
    let mut shares = Vec::with_capacity(LOT);
    for triangles in surface.index.as_chunks::<3>().0.chunks(LOT) {
        shares.clear();
        shares
            .par_extend(triangles.par_iter().with_min_len(LOT / 16).map(|t| shares_of(surface, t)));
        for (corners, (shares, is_mirrored)) in triangles.iter().zip(&shares) {
            for (&vertex, (along, angle)) in corners.iter().zip(shares) {
                let (whole, angles) = &mut sum[vertex as usize][usize::from(*is_mirrored)];
                *whole += *along;
                *angles += *angle;
            }
        }
    }
    let whole = |([right, mirrored], &normal): (&[Share; 2], &Vec3)| {
        let (along, w) = if mirrored.1 > right.1 { (mirrored.0, -1.0) } else { (right.0, 1.0) };
        // What is left where directions cancel may stand on the plane. Where there is none, any will do.
        let flat = |v: Vec3| (v - normal * normal.dot(v)).try_normalize();
        let along = along.try_normalize().and_then(flat);
        along.unwrap_or_else(|| normal.any_orthonormal_vector()).extend(w)
    };
    sum.par_iter().zip(&surface.normal).with_min_len(LOT / 16).map(whole).collect()
}

/// Of each corner, and whether the texture is mirrored there; nothing where it has no extent.
fn shares_of(surface: &Surface, corners: &[u32; 3]) -> ([Share; 3], bool) {
    let corners = corners.map(|i| i as usize);
    let [a, b, c] = corners.map(|i| surface.position[i]);
    let [d, e, f] = corners.map(|i| surface.uv[i]);
    let (s, t) = (e - d, f - d);
    let area_uv = s.perp_dot(t);
    let u = ((b - a) * t.y - (c - a) * s.y) * area_uv.signum();
    let mut shares = [(Vec3::ZERO, 0.0); 3];
    if area_uv == 0.0 || u == Vec3::ZERO {
        return (shares, false);
    }
    let ends = [[b, c], [c, a], [a, b]];
    for (((share, vertex), at), ends) in shares.iter_mut().zip(corners).zip([a, b, c]).zip(ends) {
        let normal = surface.normal[vertex];
        let flat = |v: Vec3| (v - normal * normal.dot(v)).normalize_or_zero();
        let [to, from] = ends.map(|end| flat(end - at));
        let angle = to.dot(from).clamp(-1.0, 1.0).acos();
        *share = (flat(u) * angle, angle);
    }
    (shares, area_uv < 0.0)
}

#[cfg(test)]
mod tests {
    use bevy_mikktspace::{Geometry, TangentSpace, generate_tangents};
    use glam::Vec2;

    use super::*;
    use crate::mesh::{self, FoliageLevel, MeshOptions};
    use crate::seed::Seed;
    use crate::skeleton::{Detail, Target, grow};

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

    /// Tangents of every corner by the reference algorithm.
    struct Reference<'a>(&'a Surface, Vec<Vec4>);

    impl Reference<'_> {
        fn vertex(&self, face: usize, corner: usize) -> usize {
            self.0.index[3 * face + corner] as usize
        }
    }

    impl Geometry for Reference<'_> {
        fn num_faces(&self) -> usize {
            self.0.triangles()
        }
        fn num_vertices_of_face(&self, _: usize) -> usize {
            3
        }
        fn position(&self, face: usize, corner: usize) -> [f32; 3] {
            self.0.position[self.vertex(face, corner)].to_array()
        }
        fn normal(&self, face: usize, corner: usize) -> [f32; 3] {
            self.0.normal[self.vertex(face, corner)].to_array()
        }
        fn tex_coord(&self, face: usize, corner: usize) -> [f32; 2] {
            self.0.uv[self.vertex(face, corner)].to_array()
        }
        fn set_tangent(&mut self, space: Option<TangentSpace>, face: usize, corner: usize) {
            if let Some(space) = space {
                self.1[3 * face + corner] = Vec4::from_array(space.tangent_encoded());
            }
        }
    }

    #[test]
    fn tangents_of_wood_are_those_of_mikktspace() {
        let mut worst = [0.0f32; 3];
        for name in crate::species::builtin_names() {
            let species = crate::species::load(name).unwrap();
            let target = Target::FromSpecies { height_m: None };
            let skeleton = grow(&species, target, Detail::HERO, Seed::new(1)).unwrap();
            let options = MeshOptions { foliage: FoliageLevel::None, ..MeshOptions::HERO };
            let atlas = crate::texture::Atlas::whole(0.4);
            let tree = mesh::build(&skeleton, &species, &atlas, &options, Seed::new(1)).unwrap();
            let (mut angles_deg, mut turned) = (Vec::new(), 0);
            for wood in tree.woods().into_iter().filter(|w| !w.is_empty()) {
                let ours = tangents(wood);
                let mut reference = Reference(wood, vec![Vec4::ZERO; wood.index.len()]);
                generate_tangents(&mut reference).unwrap();
                for (&i, theirs) in wood.index.iter().zip(&reference.1) {
                    let ours = ours[i as usize];
                    turned += usize::from(ours.w != theirs.w);
                    let cosine = ours.truncate().dot(theirs.truncate()).clamp(-1.0, 1.0);
                    angles_deg.push(cosine.acos().to_degrees());
                }
            }
            angles_deg.sort_unstable_by(f32::total_cmp);
            let at = |share: f32| angles_deg[(share * (angles_deg.len() - 1) as f32) as usize];
            let turned = turned as f32 / angles_deg.len() as f32;
            worst = [worst[0].max(at(0.9)), worst[1].max(at(0.97)), worst[2].max(turned)];
        }
        assert!(worst[0] < 0.1 && worst[1] < 1.0 && worst[2] < 1e-3, "{worst:?}");
    }

    /// Also where the directions of a vertex' triangles cancel, and what is left is rounding.
    #[test]
    fn tangents_are_square_to_normals() {
        use crate::species::state::{Condition, State};
        for (name, seed) in [("quercus_robur", 7), ("picea_obovata", 3), ("larix_sibirica", 2)] {
            let seed = Seed::new(seed);
            let state = State { condition: Condition::OldDead, ..State::default() };
            let species = state.look(&crate::species::load(name).unwrap(), seed);
            let target = Target::FromSpecies { height_m: None };
            let skeleton = grow(&species, target, Detail::HERO, seed).unwrap();
            let skeleton = crate::skeleton::decline::in_condition(
                &skeleton,
                species.kind,
                state.condition,
                seed,
            );
            let options = MeshOptions { foliage: FoliageLevel::None, ..MeshOptions::HERO };
            let atlas = crate::texture::Atlas::whole(0.4);
            let tree = mesh::build(&skeleton, &species, &atlas, &options, seed).unwrap();
            for wood in tree.woods() {
                for (tangent, normal) in tangents(wood).iter().zip(&wood.normal) {
                    let along = tangent.truncate().dot(*normal).abs();
                    assert!(along < 1e-3, "{name}: {along}");
                }
            }
        }
        // Two triangles whose directions cancel but for a rest along the normal.
        let mut surface = square(0.0, false);
        surface.uv = [Vec2::ZERO, Vec2::X, Vec2::ZERO, Vec2::Y].to_vec();
        surface.normal = vec![Vec3::new(0.6, 0.0, 0.8); 4];
        for (tangent, normal) in tangents(&surface).iter().zip(&surface.normal) {
            assert!(tangent.truncate().dot(*normal).abs() < 1e-5);
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
