//! Which points are ground (L) and which vegetation (T). Knows nothing of terrain.

use crate::scan::PointCloud;

/// What a point is, VL = T ∪ L ∪ E ([T15]); E is what is neither (water, buildings, wires).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    Ground,
    Vegetation,
    Excluded,
}

/// A cloud with the kind of every point.
#[derive(Debug, Clone)]
pub struct Classified {
    pub cloud: PointCloud,
    /// As long as the cloud.
    pub kind: Vec<Kind>,
    /// The heights were already above ground when read (the ground is then the plane z = 0 of the
    /// world).
    pub is_normalised: bool,
}
