//! Polygons of an OBJ file as triangles.

use earcut::Earcut;
use glam::{DVec3, Vec3};

/// The corners of a mesh's faces, three a triangle, with the front that the face has. Where all the triangles from
/// its first corner have that front the face is cut into them; where not, as with a notch, it is laid flat along
/// its own normal and cut ear by ear.
pub fn triangles(mesh: &tobj::Mesh) -> Vec<u32> {
    if mesh.face_arities.is_empty() {
        return mesh.indices.clone();
    }
    let place = mesh.positions.as_chunks::<3>().0;
    let mut out = Vec::with_capacity(3 * mesh.indices.len());
    let (mut cutter, mut flat, mut ears) = (Earcut::new(), Vec::new(), Vec::<usize>::new());
    let mut rest = &mesh.indices[..];
    for &corners in &mesh.face_arities {
        let face;
        (face, rest) = rest.split_at((corners as usize).min(rest.len()));
        let Some((&first, others)) = face.split_first() else { continue };
        let at = |i: u32| DVec3::from(Vec3::from(place[i as usize]));
        let front = |[a, b, c]: [u32; 3]| (at(b) - at(a)).cross(at(c) - at(a));
        let fan = || others.windows(2).map(|pair| [first, pair[0], pair[1]]);
        let normal = fan().map(front).sum::<DVec3>().normalize_or_zero();
        let is_plain = fan().all(|face| front(face).dot(normal) >= 0.0);
        if !is_plain {
            let (u, v) = normal.any_orthonormal_pair();
            flat.clear();
            flat.extend(face.iter().map(|&i| [u.dot(at(i)), v.dot(at(i))]));
            cutter.earcut(flat.iter().copied(), &[], &mut ears);
        }
        let cut = || ears.as_chunks::<3>().0.iter().map(|ear| ear.map(|k| face[k]));
        if is_plain || cut().next().is_none() {
            out.extend(fan().flatten());
        } else if cut().map(front).sum::<DVec3>().dot(normal) < 0.0 {
            out.extend(cut().flat_map(|[a, b, c]| [a, c, b]));
        } else {
            out.extend(cut().flatten());
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn mesh(faces: &[&[[f32; 3]]]) -> tobj::Mesh {
        let positions = faces.iter().flat_map(|face| face.iter().flatten().copied()).collect();
        let corners = faces.iter().map(|face| face.len() as u32);
        let all = corners.clone().sum();
        tobj::Mesh {
            positions,
            indices: (0..all).collect(),
            face_arities: corners.collect(),
            ..tobj::Mesh::default()
        }
    }

    /// Areas of the triangles, seen from +z.
    fn areas(mesh: &tobj::Mesh) -> Vec<f32> {
        let at = |i: u32| Vec3::from(mesh.positions.as_chunks::<3>().0[i as usize]);
        let area = |t: &[u32; 3]| {
            let [a, b, c] = t.map(at);
            0.5 * (b - a).cross(c - a).z
        };
        triangles(mesh).as_chunks::<3>().0.iter().map(area).collect()
    }

    #[test]
    fn a_notch_stays_open_whichever_corner_is_first_and_whichever_side_is_the_front() {
        let flag = [[0.0, 0.0], [1.0, 0.0], [1.0, 3.0], [0.5, 1.0], [0.0, 3.0]];
        for turn in 0..flag.len() {
            let mut face = flag.map(|[x, y]| [x, y, 0.25]);
            face.rotate_left(turn);
            let front = areas(&mesh(&[&face]));
            assert_eq!(front.len(), 3);
            assert!(front.iter().all(|a| *a > 0.0), "from corner {turn}: {front:?}");
            assert_eq!(front.iter().sum::<f32>(), 2.0, "from corner {turn}");
            face.reverse();
            let back = areas(&mesh(&[&face]));
            assert!(back.iter().all(|a| *a < 0.0), "from corner {turn}: {back:?}");
            assert_eq!(back.iter().sum::<f32>(), -2.0, "from corner {turn}");
        }
    }

    #[test]
    fn faces_of_any_number_of_corners_lie_beside_each_other() {
        let square = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]];
        let dart = [[0.0, 0.0, 0.0], [2.0, -1.0, 0.0], [0.5, 0.0, 0.0], [2.0, 1.0, 0.0]];
        let point = [[1.0, 1.0, 1.0]; 5];
        let faces = mesh(&[&square, &dart, &square[..3], &point]);
        let areas = areas(&faces);
        assert_eq!(areas.len(), 2 + 2 + 1 + 3);
        assert_eq!(areas.iter().sum::<f32>(), 1.0 + 0.5 + 0.5);
        assert!(areas[..5].iter().all(|a| *a > 0.0), "{areas:?}");
    }

    proptest! {
        /// Around a middle, as lobed leaves are: the area is that of the polygon, and nothing lies twice.
        #[test]
        fn lobed_leaves_keep_their_outline(reach in proptest::collection::vec(0.2f32..2.0, 5..60)) {
            let n = reach.len() as f32;
            let corner = |(k, r): (usize, &f32)| {
                let turn = k as f32 / n * std::f32::consts::TAU;
                [r * turn.cos(), r * turn.sin(), 0.0]
            };
            let leaf: Vec<[f32; 3]> = reach.iter().enumerate().map(corner).collect();
            let around = leaf.iter().zip(leaf.iter().cycle().skip(1));
            let whole: f32 = around.map(|(a, b)| 0.5 * (a[0] * b[1] - a[1] * b[0])).sum();
            let areas = areas(&mesh(&[&leaf]));
            prop_assert!(areas.iter().all(|a| *a > -1e-5), "{:?}", areas);
            prop_assert!((areas.iter().sum::<f32>() - whole).abs() < 1e-3 * whole);
        }
    }
}
