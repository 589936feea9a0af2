//! One region and its points to a [`Crown`]: apex, root, crown base, attractors, outline.
//!
//! Root: T15 §4, the centre of mass of the layer (six voxels thick) with the most points of the
//! tree, projected onto the terrain. Two departures keep it sane: a layer seen from one side only
//! can't draw the root farther from the outline's middle than a quarter of the crown's diameter,
//! nor out of the outline; and on ground so steep that the apex would keep less than half its
//! height over that root, the root goes below the apex.

use glam::{Vec2, Vec3};

use super::{Crown, outline};
use crate::raster::polygon::contains;
use crate::terrain::Terrain;

/// T15: the layer of the root is five to six voxels thick.
const ROOT_LAYER_VOXELS: usize = 6;
/// Higher layers count as this one: no tree has so many of any sensible thickness.
const LAYERS_TOP: usize = 1 << 20;
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
    let (volume_cu_m, surface_sq_m) = solid(points, &outline, ground, base_height_m, height_m);
    Some(Crown {
        key: 0,
        root,
        apex,
        height_m,
        base_height_m,
        diameter_m,
        spread_m: outline::spread_m(&outline),
        volume_cu_m,
        surface_sq_m,
        is_understory: false,
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
    let layer = |h: f32| ((h.max(0.0) / voxel_m) as usize).min(LAYERS_TOP);
    let top = heights.iter().copied().map(layer).max().unwrap_or(0);
    let mut counts = vec![0u32; top + 1];
    for &h in heights {
        counts[layer(h)] += 1;
    }
    // The window of layers with the most points; of equals the lowest.
    let (mut most, mut best, mut within) = (0, 0, 0);
    for end in 0..counts.len() {
        within += counts[end];
        if let Some(below) = end.checked_sub(ROOT_LAYER_VOXELS) {
            within -= counts[below];
        }
        if within > most {
            (most, best) = (within, (end + 1).saturating_sub(ROOT_LAYER_VOXELS));
        }
    }
    let best = best..best + ROOT_LAYER_VOXELS;
    let mut sum = glam::DVec2::ZERO;
    for (p, &h) in points.iter().zip(heights) {
        if best.contains(&layer(h)) {
            sum += p.truncate().as_dvec2();
        }
    }
    let mass = (sum / f64::from(most.max(1))).as_vec2();
    let middle = outline::centroid(outline);
    let near = middle + (mass - middle).clamp_length_max(0.25 * diameter_m);
    if contains(outline, near) { near } else { middle }
}

/// Directions and heights at which the solid of a crown is sampled.
const SECTORS: usize = 16;
const SOLID_LAYERS: usize = 24;

/// Volume, m³, and mantle, m², of a crown: about the outline's middle the reach of its points in
/// each direction and layer between base and apex, as far as the outline; layers that show no
/// point of a direction lie on the line between those that do, and narrow to the apex. Pulses
/// from above see little of the underside: below the lowest point of a direction its reach goes
/// on unchanged.
fn solid(points: &[Vec3], outline: &[Vec2], ground: f32, base_m: f32, height_m: f32) -> (f32, f32) {
    let axis = outline::centroid(outline);
    let step = (height_m - base_m).max(0.01) / SOLID_LAYERS as f32;
    let width = std::f32::consts::TAU / SECTORS as f32;
    let dividers = outline::dividers::<{ SECTORS / 4 - 1 }>();
    let sector = |v: Vec2| outline::sector(v, &dividers);
    let mut limit = [0.0f32; SECTORS];
    for (i, &a) in outline.iter().enumerate() {
        let b = outline[(i + 1) % outline.len()];
        for part in 0..8 {
            let v = a.lerp(b, part as f32 / 8.0) - axis;
            let far = &mut limit[sector(v)];
            *far = far.max(v.length());
        }
    }
    let mut reach = [[None::<f32>; SECTORS]; SOLID_LAYERS];
    for p in points {
        let up = p.z - ground - base_m;
        if up >= 0.0 {
            let v = p.truncate() - axis;
            let s = sector(v);
            let layer = ((up / step) as usize).min(SOLID_LAYERS - 1);
            let far = v.length().min(limit[s]);
            reach[layer][s] = Some(reach[layer][s].map_or(far, |r| r.max(far)));
        }
    }
    // Radii at the middles of the layers, by direction.
    let mut radius = [[0.0f32; SECTORS]; SOLID_LAYERS];
    for s in 0..SECTORS {
        let seen: Vec<(usize, f32)> =
            (0..SOLID_LAYERS).filter_map(|l| Some((l, reach[l][s]?))).collect();
        let first = seen.first().map_or(limit[s], |f| f.1);
        let mut next = 0;
        for (l, row) in radius.iter_mut().enumerate() {
            while next < seen.len() && seen[next].0 < l {
                next += 1;
            }
            let before = next.checked_sub(1).map(|k| seen[k]);
            row[s] = match (before, seen.get(next)) {
                (_, Some(&(k, r))) if k == l => r,
                (None, _) => first,
                (Some((a, ra)), after) => {
                    let (b, rb) = after.copied().unwrap_or((SOLID_LAYERS, 0.0));
                    ra + (rb - ra) * (l - a) as f32 / (b - a) as f32
                }
            };
        }
    }
    let (mut volume, mut surface) = (0.0f32, 0.0f32);
    for s in 0..SECTORS {
        surface += 0.5 * width * radius[0][s] * step;
        for l in 0..SOLID_LAYERS {
            let here = radius[l][s];
            // From the middle of this layer to that of the next, or to the apex.
            let (above, rise) = radius.get(l + 1).map_or((0.0, 0.5 * step), |next| (next[s], step));
            volume += 0.5 * width * here.powi(2) * step;
            surface += 0.5 * width * (here + above) * rise.hypot(above - here);
        }
    }
    (volume.max(1e-3), surface.max(1e-3))
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
    fn a_cylinder_and_a_cone_have_their_volume_and_mantle() {
        use std::f32::consts::{PI, TAU};
        let ring: Vec<Vec2> =
            (0..64).map(|i| Vec2::from_angle(TAU * i as f32 / 64.0) * 3.0).collect();
        let mantle = |radius: &dyn Fn(f32) -> f32| -> Vec<Vec3> {
            (0..400)
                .flat_map(|k| (0..256).map(move |i| (k as f32 / 400.0, TAU * i as f32 / 256.0)))
                .map(|(t, a)| (Vec2::from_angle(a) * radius(t)).extend(4.0 + 8.0 * t))
                .collect()
        };
        let near = |found: f32, exact: f32| (found / exact - 1.0).abs() < 0.06;
        let (v, s) = solid(&mantle(&|_| 3.0), &ring, 0.0, 4.0, 12.0);
        // The top is closed within the last layer, which a flat top fills.
        assert!(near(v, PI * 9.0 * 8.0), "{v}");
        assert!((TAU * 3.0 * 8.0..TAU * 3.0 * 8.0 + PI * 9.5).contains(&s), "{s}");
        let (v, s) = solid(&mantle(&|t| 3.0 * (1.0 - t)), &ring, 0.0, 4.0, 12.0);
        // Each layer is as wide as it is at its foot.
        assert!((v / (PI * 9.0 * 8.0 / 3.0) - 1.06).abs() < 0.02, "{v}");
        assert!(near(s, PI * 3.0 * 3f32.hypot(8.0)), "{s}");
    }

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
