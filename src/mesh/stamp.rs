//! A user's own twig or leaf, set at the places of twigs; or cone, beside them.

use glam::{Mat3, Quat, Vec2, Vec3};

use super::Surface;
use super::piece::{Piece, Room};
use super::spot::Pose;
use super::twigs::{Place, Twigs};
use crate::species::own::Model;

/// Share of the crown's outside in the normals of twigs; that of cones in theirs.
pub const BENT: f32 = 0.35;
pub const BENT_FRUIT: f32 = 0.1;

pub fn room(model: &Model) -> Room {
    Room { vertices: model.position.len(), triangles: model.index.len() / 3 }
}

/// Adds a copy: the model's y goes along the twig, its z to the light, its height is the twig's
/// length; `bent`: share of the crown's outside in normals.
pub fn emit(model: &Model, pose: &Pose, bent: f32, out: &mut Piece) {
    let across = pose.heading.cross(pose.facing);
    let turned = |v: Vec3| across * v.x + pose.heading * v.y + pose.facing * v.z;
    for ((p, n), uv) in model.position.iter().zip(&model.normal).zip(&model.uv) {
        let at = pose.base + turned(Vec3::from(*p)) * pose.size_m;
        let normal = pose.bent(turned(Vec3::from(*n)).into(), at.into(), bent);
        out.vertex(at, normal.into(), Vec2::from(*uv));
    }
    for &t in model.index.as_chunks::<3>().0 {
        out.triangle(t);
    }
}

/// The model once, `twig_m` high, and a place for every pose.
pub fn gather(model: &Model, twig_m: f32, poses: &[Pose]) -> Twigs {
    let place = |pose: &Pose| {
        let axes = Mat3::from_cols(pose.heading.cross(pose.facing), pose.heading, pose.facing);
        let turn = Quat::from_mat3(&axes).normalize();
        Place { position: pose.base, turn, scale: pose.size_m / twig_m }
    };
    let form = Surface {
        position: model.position.iter().map(|p| Vec3::from(*p) * twig_m).collect(),
        normal: model.normal.iter().map(|n| Vec3::from(*n).normalize_or(Vec3::Z)).collect(),
        uv: model.uv.iter().map(|uv| Vec2::from(*uv)).collect(),
        index: model.index.clone(),
        ..Surface::default()
    };
    Twigs { form, places: poses.iter().map(place).collect() }
}
