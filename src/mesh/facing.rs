//! Normals of wood where a tube's own roundness misleads: in crotches and sharp bends, where rings lie
//! aslant, a normal may look away from a triangle it belongs to. Such a one is turned back, just far
//! enough. Limit: where the surface is folded back on itself no normal suits all.

use glam::Vec3A;

use super::Surface;
use super::path::Ring;
use super::piece::straighten;
use super::young::BARKS;

/// The bands of a tube's triangles: where each ends in each bark's index, and whether a normal may look
/// away there.
#[derive(Default)]
pub struct Facing(Vec<([usize; BARKS], bool)>);

/// Whether the normals between two rings may look away from its triangles: not where together the
/// half angle of a facet, the angle between a ring and the way to the next, and the change of radius
/// that a normal does not follow stay well below a right angle, and the rings are far from meeting.
pub fn may_stray(low: &Ring, high: &Ring) -> bool {
    /// Sine of what is left of a right angle, less a few degrees, by the number of sides from 3 on.
    const LEFT: [f32; 4] = [0.42, 0.64, 0.76, 0.82];
    const STEEP: f32 = 0.7;
    const MEETING: f32 = 0.5;
    let way = Vec3A::from(high.centre) - Vec3A::from(low.centre);
    let per_m = way.length_recip();
    let tangents = [low.tangent, high.tangent].map(Vec3A::from);
    let thick = low.radius_m.max(high.radius_m) * per_m;
    let change = (high.radius_m - low.radius_m) * per_m;
    let left = LEFT[low.sides.min(high.sides).clamp(3, 6) as usize - 3];
    let follows = |ring: &Ring, tangent: Vec3A| {
        let along = tangent.dot(way) * per_m;
        let left = left - (ring.slope - change).abs();
        along > 0.0 && left > 0.0 && 1.0 - along * along <= left * left
    };
    let bend_sq = (tangents[1] - tangents[0]).length_squared();
    let is_plain = follows(low, tangents[0])
        && follows(high, tangents[1])
        && change.abs() <= STEEP
        && thick * thick * bend_sq <= MEETING * MEETING
        && low.lobe.max(high.lobe) == 0.0;
    // NaN is not plain.
    !is_plain
}

/// Mends the normals of the triangles from `start` on, which fill the facets about a foot.
pub fn mend_last(surface: &mut Surface, start: usize) {
    let Surface { position, normal, index, .. } = surface;
    if straighten(position, normal, &index[start..], 0) {
        straighten(position, normal, &index[start..], 0);
    }
}

impl Facing {
    /// Before a tube.
    pub fn begin(&mut self) {
        self.0.clear();
    }

    /// After each band of triangles: whether it may have a normal that looks away.
    pub fn band(&mut self, surface: &[Surface; BARKS], may_stray: bool) {
        self.0.push((surface.each_ref().map(|s| s.index.len()), may_stray));
    }

    /// Mends the normals of a tube, whose first indices are given, once all its bands are there.
    pub fn mend(&self, surface: &mut [Surface; BARKS], start: [usize; BARKS]) {
        let bands = &self.0;
        let mut band = 0;
        while let Some(next) = bands[band..].iter().position(|b| b.1) {
            let from = band + next;
            let to = bands[from..].iter().position(|b| !b.1).map_or(bands.len(), |n| from + n);
            let index = |from: usize, to: usize, bark: usize| {
                let first = if from == 0 { start[bark] } else { bands[from - 1].0[bark] };
                first..bands[to - 1].0[bark]
            };
            for (bark, Surface { position, normal, index: all, .. }) in
                surface.iter_mut().enumerate()
            {
                if straighten(position, normal, &all[index(from, to, bark)], 0) {
                    // A turn for one triangle matters to its neighbours.
                    let beside = index(from.saturating_sub(1), (to + 1).min(bands.len()), bark);
                    straighten(position, normal, &all[beside], 0);
                }
            }
            band = to;
        }
    }
}
