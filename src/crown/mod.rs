//! Classified points over terrain to tree crowns with their measures ([T15], method "Crowns").
//! Knows nothing of species.

use glam::{Vec2, Vec3};

/// One tree as the scan shows it. Coordinates are local metres with absolute heights.
#[derive(Debug, Clone)]
pub struct Crown {
    /// Stable key of the place ([`crate::frame::Frame::key`] of the root).
    pub key: u64,
    /// Stem foot on the terrain.
    pub root: Vec3,
    /// Highest point.
    pub apex: Vec3,
    /// Apex above the terrain under the root.
    pub height_m: f32,
    /// Crown base above the terrain under the root, < `height_m`.
    pub base_height_m: f32,
    /// Diameter of the circle of the outline's area.
    pub diameter_m: f32,
    /// Simple polygon, counter-clockwise, at least 3 corners, first not repeated.
    pub outline: Vec<Vec2>,
    /// Centres of mass of the crown's voxels: the growth volume.
    pub attractors: Vec<Vec3>,
    pub point_count: u32,
    /// 0…1: how sure it is that this is one tree.
    pub confidence: f32,
}
