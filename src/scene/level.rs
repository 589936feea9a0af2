//! Coarser forms of a scene's models.

use glam::Vec3;

use super::Part;
use crate::mesh::Surface;

/// A coarser form of a prototype.
#[derive(Debug, Clone)]
pub struct Level {
    /// `LOD1`, `LOD2`, …, `impostor`: the same for every prototype of a scene.
    pub name: String,
    pub parts: Vec<Part>,
    /// How far its silhouette is from that of the finest form, metres; that of an octahedral
    /// impostor as its shader shows it.
    pub silhouette: Apart,
    /// Where the parts show views of an octahedral impostor.
    pub octahedral: Option<Octahedral>,
}

/// The picture for which forms are chosen by how many of its lines they are off: its lines, and width over height.
pub const PICTURE_LINES: f32 = 1080.0;
pub const PICTURE_ASPECT: f32 = 16.0 / 9.0;

/// How far a form is off, root mean square, metres, for readers that know no shader of its own.
pub fn plain_rms_m(silhouette: Apart, octahedral: Option<Octahedral>) -> f32 {
    octahedral.map_or(silhouette.rms_m, |o| o.sheet_rms_m)
}

/// How far apart two silhouettes are.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Apart {
    /// The farthest that any place of one is from the other (Hausdorff distance), metres.
    pub worst_m: f32,
    /// Root of the mean square over all places of both, metres.
    pub rms_m: f32,
}

impl Apart {
    pub const NONE: Apart = Apart { worst_m: 0.0, rms_m: 0.0 };
}

/// How a shader finds the views of an octahedral impostor: that from direction d (unit, towards
/// the eye, z ≥ 0) is in column and row (frames − 1)(e + 1)/2, where e = (p.x + p.y, p.x − p.y)
/// and p = d.xy / (|d.x| + |d.y| + d.z); row 0 is at the bottom of the picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Octahedral {
    /// Views along a side of the picture.
    pub frames: u32,
    /// Middle of every view, in the tree.
    pub centre: Vec3,
    /// Half the side of what every view shows, metres.
    pub radius_m: f32,
    /// How far the sheet that comes with it is off where it is shown alone, root mean square, metres.
    pub sheet_rms_m: f32,
}

/// A closed convex body that stands for a model in collisions.
#[derive(Debug, Clone)]
pub struct Collider {
    pub shape: ColliderShape,
    /// Positions and triangles alone.
    pub body: Surface,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ColliderShape {
    Capsule,
    Convex,
}

impl Collider {
    /// The name by which engines know the `number`th collider of an object.
    pub fn name(&self, object: &str, number: usize) -> String {
        let prefix = match self.shape {
            ColliderShape::Capsule => "UCP",
            ColliderShape::Convex => "UCX",
        };
        format!("{prefix}_{object}_{number:02}")
    }
}
