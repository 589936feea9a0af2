//! Skeletons to triangle meshes: closed tubes for the wood, cards or geometry for the foliage.
//! Knows nothing of files or scenes.

use glam::{Vec2, Vec3};

/// An indexed triangle surface; columns of equal length, three indices a triangle,
/// counter-clockwise seen from outside. `uv` has v = 0 at the bottom of the picture.
#[derive(Debug, Clone, Default)]
pub struct Surface {
    pub position: Vec<Vec3>,
    /// Unit length.
    pub normal: Vec<Vec3>,
    pub uv: Vec<Vec2>,
    pub index: Vec<u32>,
}

impl Surface {
    pub fn triangles(&self) -> usize {
        self.index.len() / 3
    }

    pub fn is_empty(&self) -> bool {
        self.index.is_empty()
    }

    /// Least and greatest corner; zero for an empty surface.
    pub fn bounds(&self) -> (Vec3, Vec3) {
        let mut points = self.position.iter().copied();
        let Some(first) = points.next() else { return (Vec3::ZERO, Vec3::ZERO) };
        points.fold((first, first), |(lo, hi), p| (lo.min(p), hi.max(p)))
    }
}

/// A tree's mesh; tree-local metres, root collar at the origin, Z up.
#[derive(Debug, Clone, Default)]
pub struct TreeMesh {
    pub wood: Surface,
    /// Empty for a bare tree.
    pub foliage: Surface,
}
