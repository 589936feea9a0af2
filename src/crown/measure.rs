//! One region and its points to a [`Crown`]: apex, root, crown base, attractors, outline.
//!
//! Root: T15 §4, the centre of mass of the layer (six voxels thick) with the most points of the
//! tree, projected onto the terrain. Two departures keep it sane: a layer seen from one side only
//! can't draw the root farther from the outline's middle than a quarter of the crown's diameter,
//! nor out of the outline; and on ground so steep that the apex would keep less than half its
//! height over that root, the root goes below the apex.

use glam::{Vec2, Vec3};

use super::{Crown, outline};
use crate::terrain::Terrain;

/// T15: the layer of the root is five to six voxels thick.
const ROOT_LAYER_VOXELS: usize = 6;
/// The crown ends below where layers hold less than this part of the mean above, or spread less
/// than this part of the widest.
const BASE_COUNT: f32 = 0.1;
const BASE_SPREAD: f64 = 0.4;
/// Layers in the profile of the crown base.
const LAYERS_MIN: usize = 6;
const LAYERS_MAX: usize = 24;
/// Lower points of a tree's cells are undergrowth: metres, and part of the tree's height.
const UNDERGROWTH_M: f32 = 2.0;
const UNDERGROWTH_RELATIVE: f32 = 0.1;

/// Points whose height is below this belong to no tree of the given height.
pub(super) fn undergrowth_m(top_m: f32) -> f32 {
    (UNDERGROWTH_RELATIVE * top_m).clamp(0.3, UNDERGROWTH_M)
}

/// What belongs to one tree.
pub(super) struct Members<'a> {
    pub points: &'a [Vec3],
    /// Of the points, above the terrain under them.
    pub heights: &'a [f32],
    /// Centres of mass.
    pub voxels: &'a [Vec3],
    pub voxel_m: f32,
}

/// `cells`: middles of the region's cells. `None` for no points, or an outline too small for f32
/// at its place.
pub(super) fn crown(
    cells: &[Vec2],
    cell_m: f32,
    members: &Members<'_>,
    terrain: &Terrain,
    confidence: f32,
) -> Option<Crown> {
    let &Members { points, heights, voxels, voxel_m } = members;
    let (apex_index, &apex_height) =
        heights.iter().enumerate().max_by(|a, b| a.1.total_cmp(b.1).then(b.0.cmp(&a.0)))?;
    let apex = *points.get(apex_index)?;
    let outline = outline::trace(cells, cell_m)?;
    let area = outline::area_sq_m(&outline);
    let diameter_m = (2.0 * (area / std::f64::consts::PI).sqrt()) as f32;
    if diameter_m <= 0.0 {
        return None;
    }

    let mut foot = root_place(points, heights, voxel_m, &outline, diameter_m);
    let mut ground = terrain.height_at(foot);
    if apex.z - ground < 0.5 * apex_height {
        foot = apex.truncate();
        ground = terrain.height_at(foot);
    }
    let root = foot.extend(ground);
    let height_m = apex.z - ground;

    let base_height_m = base_height(voxels, ground, height_m);
    let mut attractors: Vec<Vec3> =
        voxels.iter().copied().filter(|v| v.z - ground >= base_height_m).collect();
    if attractors.is_empty() {
        attractors.push(apex);
    }
    Some(Crown {
        key: 0,
        root,
        apex,
        height_m,
        base_height_m,
        diameter_m,
        outline,
        attractors,
        point_count: u32::try_from(points.len()).unwrap_or(u32::MAX),
        confidence,
    })
}

fn root_place(
    points: &[Vec3],
    heights: &[f32],
    voxel_m: f32,
    outline: &[Vec2],
    diameter_m: f32,
) -> Vec2 {
    let layer = |h: f32| (h.max(0.0) / voxel_m) as usize;
    let mut sorted: Vec<(usize, u32)> =
        heights.iter().enumerate().map(|(i, &h)| (layer(h), i as u32)).collect();
    sorted.sort_unstable();
    // The window of layers with the most points; of equals the lowest.
    let (mut best, mut end) = (0..0, 0);
    for start in 0..sorted.len() {
        while end < sorted.len() && sorted[end].0 < sorted[start].0 + ROOT_LAYER_VOXELS {
            end += 1;
        }
        if end - start > best.len() {
            best = start..end;
        }
    }
    let mut sum = glam::DVec2::ZERO;
    for &(_, i) in &sorted[best.clone()] {
        sum += points[i as usize].truncate().as_dvec2();
    }
    let mass = (sum / best.len().max(1) as f64).as_vec2();
    let middle = outline::centroid(outline);
    let near = middle + (mass - middle).clamp_length_max(0.25 * diameter_m);
    if outline::contains(outline, near) { near } else { middle }
}

/// A layer of the vertical profile: voxels, and sums from which their spread follows.
#[derive(Clone, Copy, Default)]
struct Layer {
    count: u32,
    sum: glam::DVec2,
    sum_sq: f64,
}

impl Layer {
    /// Root mean square distance from the middle, metres.
    fn spread_m(&self) -> f64 {
        let n = f64::from(self.count.max(1));
        (self.sum_sq / n - (self.sum / n).length_squared()).max(0.0).sqrt()
    }
}

/// Crown base above the ground: from the fullest layer down, until two layers in a row hold few
/// voxels or are narrow; then the lowest voxel above them. Voxels are counted and not points, and
/// their spread is seen, so that a stem scanned from the ground, dense but narrow, is no crown.
/// Fewer voxels make thicker layers.
fn base_height(voxels: &[Vec3], ground: f32, height_m: f32) -> f32 {
    let Some(first) = voxels.first() else { return 0.0 };
    let layers = ((2.0 * voxels.len() as f32).sqrt() as usize).clamp(LAYERS_MIN, LAYERS_MAX);
    let step = height_m / layers as f32;
    let place = |v: &Vec3| (((v.z - ground).max(0.0) / step) as usize).min(layers - 1);
    let mut profile = vec![Layer::default(); layers];
    for v in voxels {
        let layer = &mut profile[place(v)];
        let p = (v - first).truncate().as_dvec2();
        layer.count += 1;
        layer.sum += p;
        layer.sum_sq += p.length_squared();
    }
    let fullest = (0..layers).max_by_key(|&k| profile[k].count).unwrap_or(0);
    let mut above: u32 = profile[fullest..].iter().map(|l| l.count).sum();
    let mut widest_m = profile[fullest].spread_m();
    let mut base = fullest;
    while base > 0 {
        let few = (BASE_COUNT * above as f32 / (layers - base) as f32).max(1.0);
        let is_stem = |l: &Layer| l.count >= 5 && l.spread_m() < BASE_SPREAD * widest_m;
        let is_thin = |l: &Layer| (l.count as f32) < few || is_stem(l);
        if profile[base.saturating_sub(2)..base].iter().all(is_thin) {
            break;
        }
        base -= 1;
        above += profile[base].count;
        widest_m = widest_m.max(profile[base].spread_m());
    }
    voxels
        .iter()
        .filter(|v| place(v) >= base)
        .map(|v| v.z - ground)
        .fold(0.95 * height_m, f32::min)
        .max(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stem_is_below_the_crown_base() {
        // A ball of 3 m radius at 9 m on a stem; 12 m high.
        let mut voxels = Vec::new();
        for x in -6..=6 {
            for y in -6..=6 {
                for z in -6..=6 {
                    let v = Vec3::new(x as f32, y as f32, z as f32) * 0.5;
                    if v.length() <= 3.0 {
                        voxels.push(v + Vec3::new(0.0, 0.0, 109.0));
                    }
                }
            }
        }
        voxels.extend((0..12).map(|z| Vec3::new(0.0, 0.0, 100.0 + 0.5 * z as f32)));
        let base = base_height(&voxels, 100.0, 12.0);
        assert!((5.5..=6.75).contains(&base), "{base}");
    }
}
