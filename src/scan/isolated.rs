//! Isolated points. By the isolated voxel filter (IVF, as in lidR 4) a point is noise if the
//! 3 × 3 × 3 voxels around its own hold at most a few points. Besides, few points far above or below
//! all others of the 3 × 3 columns of voxels around are noise, however many stand together (flocks,
//! clouds, echoes of echoes): so far that no tree or slope fills the gap with nothing in it, and unless
//! they go on beside the columns, as the foot of a cliff does.
//!
//! Departures: the voxel size follows from the density, so that scans of every density are
//! treated alike, and voxels are counted as sorted keys, so that memory follows the occupied
//! voxels and not the extent.
//!
//! Known limits: what fills more than a tenth of its surroundings (0.3 more than 60 m below) is no
//! clump; the bottom of a shaft narrower than that, and power lines more than 40 m over the canopy, are.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::atomic::{AtomicU32, Ordering};

use glam::DVec3;
use rayon::prelude::*;

use super::PointCloud;
use super::part::Part;
use crate::raster::scatter;

/// Nothing stands between a clump of noise and the rest for so far, metres: below the rest, and above
/// it, where a stem may show no return up to the crown.
const GAP_BELOW_M: f64 = 20.0;
const GAP_FAR_BELOW_M: f64 = 60.0;
const GAP_ABOVE_M: f64 = 40.0;
/// The most of the points around that may be such noise.
const CLUMP_BELOW: f64 = 0.1;
const CLUMP_FAR_BELOW: f64 = 0.3;
const CLUMP_ABOVE: f64 = 0.05;

/// A neighbourhood with at most this many points, the point itself among them, is noise.
pub(super) const MOST_POINTS: u32 = 2;
/// Voxel edge in units of the mean distance between points.
const EDGE_IN_SPACINGS: f64 = 8.0;
/// With 2 m voxels, leaders of spruces 4 m above their crown and the rare ground points under dense
/// canopy went; with 5 m, none in nine real scans.
const LEAST_EDGE_M: f64 = 5.0;
/// Larger edges grow by this factor, so that like densities give equal voxels.
const EDGE_STEP: f64 = 1.5;
/// Points whose keys are sorted at a time.
const RUN_POINTS: usize = 1 << 18;
const AXIS_BITS: u32 = 21;
/// Voxels along an axis; one is left free at each end for the neighbours.
const AXIS_VOXELS: f64 = ((1u64 << AXIS_BITS) - 3) as f64;

/// World bounds in metres; `None` without points.
pub(super) fn bounds_m(parts: &[Part], unit_m: DVec3) -> Option<(DVec3, DVec3)> {
    let bounds = parts.iter().filter_map(|part| part.bounds);
    let (min, max) = bounds.reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)))?;
    Some((min * unit_m, max * unit_m))
}

/// Points per occupied square metre, on cells of 1 m × 1 m; 0 without points.
pub(super) fn density_per_m2(parts: &[Part], unit_m: DVec3) -> f64 {
    let Some((min, max)) = bounds_m(parts, unit_m) else { return 0.0 };
    let points: usize = parts.iter().map(|part| part.coordinates.len()).sum();
    let edge_m = ((max - min).truncate().max_element() / f64::from(i32::MAX)).max(1.0);
    let cells = Voxels::over(min, max, DVec3::new(edge_m, edge_m, f64::INFINITY), points);
    let key = |p: DVec3| cells.key(p * unit_m);
    let occupied = match cells.few {
        Some(keys) => {
            let of_run = |run: Run| run.points(parts).map(|p| key(p) as usize);
            scatter::filled(keys, runs(parts).into_par_iter().flat_map_iter(of_run))
        }
        None => count_sorted(parts, key).len(),
    };
    points as f64 / (occupied as f64 * edge_m * edge_m)
}

/// Which points to keep.
pub(super) struct Keep {
    /// Part by part, point by point.
    pub flags: Vec<Vec<bool>>,
    /// The extent forced voxels larger than the density asks for, so that less was found.
    pub is_coarse: bool,
}

/// Side of the blocks by which the body of a scan is told from points very far from it, metres.
pub(super) const BLOCK_M: f64 = 20_000.0;
/// More blocks are no scan with strays.
const MOST_BLOCKS: usize = 1 << 16;
/// So many points may be strays, or this part of all where that is more, but no more than the next.
const STRAYS: f64 = MOST_POINTS as f64;
const STRAYS_RELATIVE: f64 = 5e-3;
const MOST_STRAYS_RELATIVE: f64 = 1e-2;

/// The number of points by block.
pub(super) type Blocks = BTreeMap<[i64; 3], u64>;

/// The blocks that are connected to the fullest; `None` where too many points for strays lie in the
/// others.
pub(super) fn body(blocks: &Blocks) -> Option<BTreeSet<[i64; 3]>> {
    let fullest = blocks.iter().max_by_key(|(at, n)| (**n, Reverse(**at)))?;
    let mut body = BTreeSet::from([*fullest.0]);
    let mut open = vec![*fullest.0];
    while let Some(at) = open.pop() {
        for k in 0..27 {
            let beside = [
                at[0].wrapping_add(k % 3 - 1),
                at[1].wrapping_add(k / 3 % 3 - 1),
                at[2].wrapping_add(k / 9 - 1),
            ];
            if blocks.contains_key(&beside) && body.insert(beside) {
                open.push(beside);
            }
        }
    }
    let all: u64 = blocks.values().sum();
    let strays: u64 = blocks.iter().filter(|(at, _)| !body.contains(*at)).map(|(_, n)| n).sum();
    let (strays, all) = (strays as f64, all as f64);
    let few = STRAYS.max(STRAYS_RELATIVE * all).min(MOST_STRAYS_RELATIVE * all);
    (strays <= few).then_some(body)
}

/// Which points belong to the body of a scan; `None` where it can't be told.
pub(super) fn in_body(parts: &[Part], unit_m: DVec3) -> Option<Vec<Vec<bool>>> {
    let block = |p: DVec3| (p * unit_m / BLOCK_M).floor().to_array().map(|v| v as i64);
    let mut blocks = Blocks::new();
    for part in parts {
        for p in (0..part.coordinates.len()).filter_map(|i| part.coordinates.get(i)) {
            *blocks.entry(block(p)).or_default() += 1;
            if blocks.len() > MOST_BLOCKS {
                return None;
            }
        }
    }
    let body = body(&blocks)?;
    let is_in =
        |part: &Part, i: usize| part.coordinates.get(i).is_none_or(|p| body.contains(&block(p)));
    let of_part = |part: &Part| -> Vec<bool> {
        (0..part.coordinates.len()).into_par_iter().map(|i| is_in(part, i)).collect()
    };
    Some(parts.iter().map(of_part).collect())
}

/// Finds the isolated points; `None` where there are none.
pub(super) fn keep(parts: &[Part], unit_m: DVec3, density_per_m2: f64) -> Option<Keep> {
    let (min, max) = bounds_m(parts, unit_m)?;
    let least_m = (EDGE_IN_SPACINGS / density_per_m2.sqrt()).max(LEAST_EDGE_M);
    let wanted_m = LEAST_EDGE_M * EDGE_STEP.powf((least_m / LEAST_EDGE_M).log(EDGE_STEP).ceil());
    let edge_m = wanted_m.max((max - min).max_element() / AXIS_VOXELS);
    let points: usize = parts.iter().map(|part| part.coordinates.len()).sum();
    let grid = Voxels::over(min, max, DVec3::splat(edge_m), points);
    let voxels = grid.count(parts, unit_m);
    let mut isolated: Vec<u64> = voxels
        .par_iter()
        .filter(|(key, n)| *n <= MOST_POINTS && grid.is_lonely(*key, &voxels))
        .map(|(key, _)| *key)
        .collect();
    isolated.extend(grid.clumps(&voxels, edge_m));
    isolated.par_sort_unstable();
    isolated.dedup();
    // A scan of a few points has nothing to be isolated from.
    if isolated.is_empty() || isolated.len() == voxels.len() {
        return None;
    }
    isolated.shrink_to_fit();
    let mut by_key = vec![false; grid.few.unwrap_or(0)];
    let is_isolated: &(dyn Fn(u64) -> bool + Sync) = if grid.few.is_some() {
        isolated.iter().for_each(|&key| by_key[key as usize] = true);
        &|key| by_key[key as usize]
    } else {
        &|key| isolated.binary_search(&key).is_ok()
    };
    let is_kept = |p: DVec3| !is_isolated(grid.key(p * unit_m));
    let of_part = |part: &Part| {
        let points = (0..part.coordinates.len()).into_par_iter();
        points.map(|i| part.coordinates.get(i).is_none_or(is_kept)).collect()
    };
    let flags = parts.iter().map(of_part).collect();
    Some(Keep { flags, is_coarse: edge_m > wanted_m })
}

/// [`keep`] for a piece of a scan whose density is known: which points are isolated.
pub(super) fn among(cloud: &PointCloud, density_per_m2: f64) -> Vec<bool> {
    let frame = &cloud.frame;
    let world = cloud.position.iter().map(|p| frame.world_from_local(*p)).collect();
    let part = Part::of_places(world);
    keep(&[part], frame.unit_m(), density_per_m2)
        .and_then(|keep| keep.flags.into_iter().next())
        .map_or(vec![false; cloud.len()], |keep| keep.iter().map(|keep| !keep).collect())
}

/// Boxes aligned to multiples of their edges, so that none moves with the cut of the scan.
struct Voxels {
    per_m: DVec3,
    first: DVec3,
    /// Keys between neighbours along x, y and z.
    stride: [u64; 3],
    /// How many keys there are, where they are few enough to count each.
    few: Option<usize>,
}

impl Voxels {
    /// With a voxel's room on every side. An infinite edge makes a single layer.
    fn over(min: DVec3, max: DVec3, edge_m: DVec3, points: usize) -> Voxels {
        let per_m = edge_m.recip();
        let first = (min * per_m).floor() - 1.0;
        let sides = (max * per_m).floor() - first + 2.0;
        let most = (2 * points).max(1 << 20);
        let keys = sides.element_product();
        if keys <= most as f64 {
            let stride = [1, sides.x as u64, (sides.x * sides.y) as u64];
            return Voxels { per_m, first, stride, few: Some(keys as usize) };
        }
        let stride = match edge_m.z.is_finite() {
            true => [1, 1 << AXIS_BITS, 1 << (2 * AXIS_BITS)],
            false => [1, 1 << 32, 0],
        };
        Voxels { per_m, first, stride, few: None }
    }

    fn key(&self, place_m: DVec3) -> u64 {
        let voxel = place_m * self.per_m - self.first;
        let along = |v: f64, stride: u64| (v as i64 as u64).wrapping_mul(stride);
        let [x, y, z] = self.stride;
        along(voxel.x, x).wrapping_add(along(voxel.y, y)).wrapping_add(along(voxel.z, z))
    }

    /// Sorted keys of the points, each once, with how many points have it.
    fn count(&self, parts: &[Part], unit_m: DVec3) -> Vec<(u64, u32)> {
        let key = |p: DVec3| self.key(p * unit_m);
        let Some(keys) = self.few else { return count_sorted(parts, key) };
        let counts: Vec<AtomicU32> = (0..keys).map(|_| AtomicU32::new(0)).collect();
        runs(parts).into_par_iter().for_each(|run| {
            // Points come in the order of flight: many in a row lie in one voxel.
            let (mut last, mut in_a_row) = (0, 0);
            let add = |key: u64, points: u32| {
                if let Some(count) = counts.get(key as usize) {
                    count.fetch_add(points, Ordering::Relaxed);
                }
            };
            for key in run.points(parts).map(key) {
                if key != last {
                    add(last, in_a_row);
                    (last, in_a_row) = (key, 0);
                }
                in_a_row += 1;
            }
            add(last, in_a_row);
        });
        let counts = (0..).zip(counts).map(|(key, count)| (key, count.into_inner()));
        counts.filter(|(_, n)| *n > 0).collect()
    }

    /// Voxels of few points far above or below all others around.
    fn clumps(&self, voxels: &[(u64, u32)], edge_m: f64) -> Vec<u64> {
        // Layers and points by column, from the bottom up.
        let column = |key: u64| key % self.stride[2];
        let mut order: Vec<(u64, u64, u32)> =
            voxels.iter().map(|(key, n)| (column(*key), key / self.stride[2], *n)).collect();
        order.par_sort_unstable();
        let columns: Vec<&[(u64, u64, u32)]> = order.chunk_by(|a, b| a.0 == b.0).collect();
        let of = |at: u64| columns.binary_search_by_key(&at, |c| c[0].0).ok().map(|i| columns[i]);
        let layers_in = |gap_m: f64| (gap_m / edge_m).ceil() as u64;
        let found = |own: &&[(u64, u64, u32)]| -> Vec<u64> {
            let at = own[0].0;
            let mut layers: Vec<(u64, u32)> = Vec::new();
            for row in [-1i64, 0, 1] {
                let middle = at.wrapping_add_signed(row * self.stride[1] as i64);
                let beside = [middle.wrapping_sub(1), middle, middle.wrapping_add(1)];
                layers.extend(beside.into_iter().filter_map(of).flatten().map(|c| (c.1, c.2)));
            }
            layers.sort_unstable();
            let all: u64 = layers.iter().map(|(_, n)| u64::from(*n)).sum();
            // The first layer that is no clump from below, the last from above.
            let rest =
                |gap: u64, part: f64, mut layers: Box<dyn Iterator<Item = &(u64, u32)> + '_>| {
                    let mut last = layers.next().copied().unwrap_or_default();
                    let (mut passed, mut rest) = (u64::from(last.1), last.0);
                    for layer in layers {
                        if passed as f64 > part * all as f64 {
                            break;
                        }
                        if layer.0.abs_diff(last.0) > gap {
                            rest = layer.0;
                        }
                        (passed, last) = (passed + u64::from(layer.1), *layer);
                    }
                    rest
                };
            let below = |gap_m, part| rest(layers_in(gap_m), part, Box::new(layers.iter()));
            let first =
                below(GAP_BELOW_M, CLUMP_BELOW).max(below(GAP_FAR_BELOW_M, CLUMP_FAR_BELOW));
            let last = rest(layers_in(GAP_ABOVE_M), CLUMP_ABOVE, Box::new(layers.iter().rev()));
            let out = own.iter().filter(|c| c.1 < first || c.1 > last);
            out.map(|c| c.0 + c.1 * self.stride[2]).collect()
        };
        let mut found: Vec<u64> = columns.par_iter().flat_map_iter(found).collect();
        found.par_sort_unstable();
        // The foot of a cliff goes on beside it.
        let goes_on = |key: &u64| {
            let is_rest = |(k, _): &(u64, u32)| found.binary_search(k).is_err();
            self.around(*key, voxels).any(is_rest)
        };
        found.par_iter().copied().filter(|key| !goes_on(key)).collect()
    }

    /// The voxels of the 3 × 3 × 3 around one that hold points.
    fn around<'a>(
        &self,
        key: u64,
        voxels: &'a [(u64, u32)],
    ) -> impl Iterator<Item = &'a (u64, u32)> {
        let [_, row, layer] = self.stride.map(|s| s as i64);
        (0..9).flat_map(move |k| {
            // Three voxels in a row along x have successive keys.
            let middle = key.wrapping_add_signed((k / 3 - 1) * layer + (k % 3 - 1) * row);
            let (from, to) = (middle.wrapping_sub(1), middle.wrapping_add(1));
            let start = voxels.partition_point(|(k, _)| *k < from);
            voxels[start..].iter().take_while(move |(k, _)| *k <= to)
        })
    }

    /// Whether the neighbourhood of a voxel holds at most [`MOST_POINTS`] points.
    fn is_lonely(&self, key: u64, voxels: &[(u64, u32)]) -> bool {
        let mut points = 0;
        for (_, n) in self.around(key, voxels) {
            points += n;
            if points > MOST_POINTS {
                return false;
            }
        }
        true
    }
}

/// Points `start..end` of a part.
#[derive(Clone, Copy)]
struct Run {
    part: usize,
    start: usize,
    end: usize,
}

impl Run {
    fn points(self, parts: &[Part]) -> impl Iterator<Item = DVec3> {
        let part = parts.get(self.part);
        (self.start..self.end).filter_map(move |i| part?.coordinates.get(i))
    }
}

fn runs(parts: &[Part]) -> Vec<Run> {
    let of_part = |(part, p): (usize, &Part)| {
        let n = p.coordinates.len();
        (0..n).step_by(RUN_POINTS).map(move |start| Run {
            part,
            start,
            end: (start + RUN_POINTS).min(n),
        })
    };
    parts.iter().enumerate().flat_map(of_part).collect()
}

/// As [`Voxels::count`], where keys are too many to count each.
fn count_sorted(parts: &[Part], key: impl Fn(DVec3) -> u64 + Sync) -> Vec<(u64, u32)> {
    let mut counts: Vec<(u64, u32)> = runs(parts)
        .into_par_iter()
        .flat_map_iter(|run| {
            let mut counts: Vec<(u64, u32)> = Vec::new();
            for key in run.points(parts).map(&key) {
                match counts.last_mut() {
                    Some((last, n)) if *last == key => *n += 1,
                    _ => counts.push((key, 1)),
                }
            }
            counts.sort_unstable();
            add_up(&mut counts);
            counts
        })
        .collect();
    counts.par_sort_unstable();
    add_up(&mut counts);
    counts
}

/// Makes one count of those of one key, which stand next to each other.
fn add_up(counts: &mut Vec<(u64, u32)>) {
    counts.dedup_by(|next, kept| {
        let is_same = next.0 == kept.0;
        if is_same {
            kept.1 = kept.1.saturating_add(next.1);
        }
        is_same
    });
}
