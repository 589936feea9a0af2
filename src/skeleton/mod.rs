//! Species, and a crown if there is one, to a skeleton: L-system, turtle, space colonization,
//! radii. Knows nothing of meshes.

pub mod derive;
pub mod turtle;

use glam::Vec3;

/// No parent: only the root has this.
pub const NO_PARENT: u32 = u32::MAX;

/// A tree of nodes as flat columns; a node and its parent span one internode. Tree-local metres:
/// the root collar is the origin, Z up.
#[derive(Debug, Clone, Default)]
pub struct Skeleton {
    pub position: Vec<Vec3>,
    /// Parents come before children; node 0 is the only root.
    pub parent: Vec<u32>,
    /// Radius of the wood at the node; never greater than at the parent.
    pub radius_m: Vec<f32>,
    /// The axis the node continues; 0 is the stem. A node whose parent has another axis starts one.
    pub axis: Vec<u32>,
    /// Branching order of the node's axis: 0 the stem, 1 its branches, …
    pub order: Vec<u8>,
}
