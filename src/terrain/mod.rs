//! Ground points to a height grid that can be sampled anywhere, and to a mesh. Knows nothing of
//! trees. Heights are cell-centred ("cell-centred reading" of the method).

use glam::{Vec2, Vec3};

use crate::raster::Grid;

/// A height grid without voids, local metres.
#[derive(Debug, Clone)]
pub struct Terrain {
    pub heights: Grid<f32>,
    /// Which cells hold a ground point of their own.
    pub is_observed: Vec<bool>,
}

impl Terrain {
    /// Height at a place, bilinear; clamped to the border outside.
    pub fn height_at(&self, p: Vec2) -> f32 {
        self.heights.bilinear(f64::from(p.x), f64::from(p.y))
    }

    /// Unit normal at a place, from central differences one cell wide.
    pub fn normal_at(&self, p: Vec2) -> Vec3 {
        let d = self.heights.geometry.cell_x as f32 * 0.5;
        let dx = self.height_at(p + Vec2::X * d) - self.height_at(p - Vec2::X * d);
        let dy = self.height_at(p + Vec2::Y * d) - self.height_at(p - Vec2::Y * d);
        Vec3::new(-dx, -dy, 2.0 * d).normalize()
    }
}
