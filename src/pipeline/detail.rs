//! How finely trees are grown and meshed for their triangles.

use super::tolerance;
use crate::mesh::{FoliageLevel, Junctions, MeshOptions};
use crate::skeleton::Detail;

/// Buttresses and finer rings are for trees that are seen from near.
pub fn mesh_options(triangles: usize) -> MeshOptions {
    let preset = if triangles < 10_000 { MeshOptions::FOREST } else { MeshOptions::HERO };
    MeshOptions { triangle_budget: Some(triangles), ..preset }
}

/// How wood is meshed.
#[derive(Debug, Clone, Copy, Default)]
pub struct WoodJob {
    pub junctions: Junctions,
    /// Triangles of a tree are the fewest whose silhouette is off by no more than this, RMS; as
    /// many as there may be where `None`.
    pub tolerance_m: Option<f32>,
}

impl WoodJob {
    pub(super) fn options(&self, triangles: usize, foliage: FoliageLevel) -> MeshOptions {
        let preset = mesh_options(triangles);
        let tolerance_m = self.tolerance_m.unwrap_or(f32::INFINITY).min(preset.tolerance_m);
        let sagitta_m = self.tolerance_m.unwrap_or(f32::INFINITY);
        MeshOptions { foliage, tolerance_m, sagitta_m, junctions: self.junctions, ..preset }
    }

    /// That of a skeleton for at most so many triangles.
    pub(super) fn detail(&self, triangles: usize, foliage: FoliageLevel) -> Detail {
        match self.tolerance_m {
            None => detail(triangles, foliage),
            Some(_) => detail(tolerance::reference(triangles, foliage), foliage),
        }
    }
}

/// The same with fewer triangles, for those who see it from farther.
pub fn coarser(options: &MeshOptions, triangles: usize) -> MeshOptions {
    let preset = mesh_options(triangles);
    MeshOptions {
        foliage: options.foliage.min(FoliageLevel::Cards),
        triangle_budget: Some(triangles),
        tolerance_m: options.tolerance_m.max(preset.tolerance_m),
        sagitta_m: f32::INFINITY,
        detail: options.detail && preset.detail,
        is_coarser: true,
        ..*options
    }
}

/// Triangles a node, wood and leaves; where every leaf is one, more, and then this many nodes at most.
const PER_NODE: usize = 6;
const PER_LEAFY_NODE: usize = 60;
const MOST_LEAFY_NODES: usize = 40_000;

/// Nodes enough to use so many triangles well. No fewer than it takes for twigs to be spread over the crown.
pub(super) fn detail(triangles: usize, foliage: FoliageLevel) -> Detail {
    const FEWEST_NODES: usize = 2_500;
    let max_nodes = match foliage {
        FoliageLevel::Geometry => (triangles / PER_LEAFY_NODE).clamp(2_000, MOST_LEAFY_NODES),
        _ => (triangles / PER_NODE).clamp(FEWEST_NODES, 100_000),
    };
    Detail { max_nodes: max_nodes as u32, attractor_spacing_m: None }
}

/// Triangles that coarser forms fall from: cards do with fewer than leaves one by one, and show nothing more with
/// as many.
pub(super) fn levels_fall_from(triangles: usize, foliage: FoliageLevel) -> usize {
    const ENOUGH: usize = 20_000;
    match foliage {
        FoliageLevel::Geometry => (triangles / 10).max(ENOUGH).min(triangles),
        _ => triangles,
    }
}

/// Triangles of cards for which as many nodes are grown as for these of `foliage`.
pub(super) fn like_with_cards(triangles: usize, foliage: FoliageLevel) -> usize {
    match foliage {
        FoliageLevel::Geometry => {
            (triangles / (PER_LEAFY_NODE / PER_NODE)).min(PER_NODE * MOST_LEAFY_NODES)
        }
        _ => triangles,
    }
}
