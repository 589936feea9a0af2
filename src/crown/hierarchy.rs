//! Basins merge, the least distinct pair first, into a forest of nested regions; of these the set
//! of disjoint regions is chosen that promises the most trees found.
//!
//! Each region gets the chance of being one tree from its shape ([`chance`]). F1 is greatest where
//! the sum of `chance − F1/2` over the chosen regions is, so a region stays whole where it is worth
//! more than its parts (a cut through the hierarchy, found bottom up in one pass). It takes the
//! place of the threshold radius of T15 §4, which is thereby adaptive to every crown.
//!
//! The chance is a logistic model of ten measures of shape, fitted by `tools/fit_crowns.py` to the
//! boxes of the 615 annotated crowns of the IDTReeS plots (a closed broadleaf canopy and an open pine
//! stand). By that tool, for the canopy without its lower storey, F1 is 0.54 fitted on all plots and
//! 0.53 cross-validated over plots; on the broadleaf site 0.58, fitted on the pines alone 0.48; on the
//! pine site 0.46, fitted on the broadleaves alone 0.44. The constants here are of an earlier fit, which
//! scores 0.53 on all plots. Cell and kernel were chosen on all plots at once; the price on the plots
//! and on simulated stands. Outside the measures' range in those plots
//! the nearest value inside it is taken.
//!
//! Known limit: what does not show on this surface is left to the lower storey.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BinaryHeap};

use super::basins::{Basins, Extent, NONE};

/// A region: one basin, or two regions merged.
pub(super) struct Region {
    pub extent: Extent,
    pub parts: Option<[u32; 2]>,
    /// Height of the lower top over the pass inside, part of the lower top; 0 for one basin.
    inner_prominence: f32,
    /// Distance of the two tops inside, cells.
    inner_distance: f32,
    /// Highest pass to another crown; 0 where none touches.
    outer_saddle_m: f32,
}

/// Regions, parts before the wholes they make.
pub(super) struct Hierarchy {
    pub region: Vec<Region>,
    /// Whether the region is part of no other.
    is_whole: Vec<bool>,
}

impl Hierarchy {
    /// For each basin the place in `chosen` of the region that holds it, `NONE` for no region.
    pub fn tree_of_basin(&self, chosen: &[Chosen], basins: usize) -> Vec<u32> {
        let mut tree = vec![NONE; basins];
        for (place, c) in chosen.iter().enumerate() {
            let mut stack = vec![c.region];
            while let Some(i) = stack.pop() {
                match self.region[i as usize].parts {
                    Some(parts) => stack.extend(parts),
                    None => tree[i as usize] = place as u32,
                }
            }
        }
        tree
    }
}

/// A region chosen as one tree.
pub(super) struct Chosen {
    pub region: u32,
    pub chance: f32,
    /// Wide enough for a crown, and next to no other touches it: what else could it be?
    pub is_alone: bool,
}

/// Crowns that touch no more of the border, or no higher up, than this leave a region alone.
const ALONE: f64 = 0.15;
const ALONE_DIAMETER_M: f64 = 2.0;

#[derive(Clone, Copy, Default)]
struct Link {
    saddle_m: f32,
    sides: f64,
    sum_height: f64,
}

/// Weight of the distance of two tops against their prominence.
const DISTANCE_WEIGHT: f32 = 0.5;
/// No region grows wider than this, metres and part of its height.
const WIDEST_M: f32 = 4.0;
const WIDEST_RELATIVE: f32 = 0.9;

fn tops_apart(a: &Extent, b: &Extent, cols: usize) -> f32 {
    let (a, b) = (a.top_cell as usize, b.top_cell as usize);
    let dx = (a % cols) as f32 - (b % cols) as f32;
    let dy = (a / cols) as f32 - (b / cols) as f32;
    dx.hypot(dy)
}

/// A top lower than this part of its neighbour's is another tree, not a bough.
const LOWEST_BOUGH: f32 = 0.5;

/// The place in the queue of a pair of neighbours; none where they can't be one tree.
/// Non-negative floats sort like their bits.
fn rank(
    region: &[Region],
    (a, b): (u32, u32),
    saddle_m: f32,
    cols: usize,
    cell_m: f32,
) -> Option<Reverse<(u32, u32, u32)>> {
    let (ea, eb) = (&region[a as usize].extent, &region[b as usize].extent);
    let (low, high) = (ea.top_m.min(eb.top_m), ea.top_m.max(eb.top_m));
    let width =
        (0..2).map(|k| ea.max[k].max(eb.max[k]) - ea.min[k].min(eb.min[k]) + 1).fold(0, u32::max);
    let distance_m = tops_apart(ea, eb, cols) * cell_m;
    let distinct = (low - saddle_m).max(0.0) / low + DISTANCE_WEIGHT * distance_m / (low + 5.0);
    let may_be_one =
        low >= LOWEST_BOUGH * high && width as f32 * cell_m <= WIDEST_M + WIDEST_RELATIVE * high;
    may_be_one.then(|| Reverse((distinct.to_bits(), a.min(b), a.max(b))))
}

/// `cols` and `cell_m` of the canopy grid.
pub(super) fn merge(basins: &Basins, cols: usize, cell_m: f32) -> Hierarchy {
    let mut region: Vec<Region> = basins
        .extent
        .iter()
        .map(|&extent| Region {
            extent,
            parts: None,
            inner_prominence: 0.0,
            inner_distance: 0.0,
            outer_saddle_m: 0.0,
        })
        .collect();
    let mut is_whole = vec![true; region.len()];
    let mut links: Vec<BTreeMap<u32, Link>> = vec![BTreeMap::new(); region.len()];
    let mut queue = BinaryHeap::new();
    for t in &basins.contact {
        let link = Link { saddle_m: t.saddle_m, sides: t.sides, sum_height: t.sum_height };
        links[t.a as usize].insert(t.b, link);
        links[t.b as usize].insert(t.a, link);
        for side in [t.a, t.b] {
            let outer_saddle_m = &mut region[side as usize].outer_saddle_m;
            *outer_saddle_m = outer_saddle_m.max(t.saddle_m);
        }
        queue.extend(rank(&region, (t.a, t.b), t.saddle_m, cols, cell_m));
    }
    while let Some(Reverse((_, a, b))) = queue.pop() {
        if !(is_whole[a as usize] && is_whole[b as usize]) {
            continue;
        }
        let mut around = std::mem::take(&mut links[a as usize]);
        let mut other = std::mem::take(&mut links[b as usize]);
        let shared = around.remove(&b).unwrap_or_default();
        other.remove(&a);
        if around.len() < other.len() {
            std::mem::swap(&mut around, &mut other);
        }
        for (n, link) in other {
            let into = around.entry(n).or_default();
            into.saddle_m = into.saddle_m.max(link.saddle_m);
            into.sides += link.sides;
            into.sum_height += link.sum_height;
        }
        let (ea, eb) = (&region[a as usize].extent, &region[b as usize].extent);
        let low = ea.top_m.min(eb.top_m);
        let inner_distance = tops_apart(ea, eb, cols);
        let mut extent = *ea;
        extent.absorb(eb);
        extent.border -= 2.0 * shared.sides;
        extent.border_height -= 2.0 * shared.sum_height;
        let id = region.len() as u32;
        region.push(Region {
            extent,
            parts: Some([a, b]),
            inner_prominence: (low - shared.saddle_m).max(0.0) / low,
            inner_distance,
            outer_saddle_m: around.values().map(|l| l.saddle_m).fold(0.0, f32::max),
        });
        is_whole[a as usize] = false;
        is_whole[b as usize] = false;
        is_whole.push(true);
        for (&n, &link) in &around {
            let there = &mut links[n as usize];
            there.remove(&a);
            there.remove(&b);
            there.insert(id, link);
            queue.extend(rank(&region, (n, id), link.saddle_m, cols, cell_m));
        }
        links.push(around);
    }
    Hierarchy { region, is_whole }
}

const MEASURES: usize = 9;
/// First and 99th percentile of each measure over all regions of the annotated plots.
const LOWEST: [f64; MEASURES] = [-0.426, 1.208, 0.656, 0.209, 0.417, 0.005, 0.0, 0.0, 0.0];
const HIGHEST: [f64; MEASURES] = [3.077, 3.575, 0.977, 1.0, 1.0, 0.683, 0.415, 0.982, 0.965];
const BIAS: f64 = -8.441;
const WEIGHT: [f64; MEASURES] = [5.25, 1.03, 1.459, 0.871, -0.024, -0.63, -7.208, -0.28, 0.094];
/// Of diameter², diameter · height and height² (logarithms).
const WEIGHT_SIZE: [f64; 3] = [-2.908, 1.653, -0.511];
/// Of the logarithm of the drop from the top to the highest pass out, over [`LEAST_DROP_M`].
const WEIGHT_DROP: f64 = 0.292;
const LEAST_DROP_M: f64 = 0.1;
/// A drop is taken as no more than this part of the top.
const GREATEST_DROP: f64 = 0.8;

/// What a region looks like, in this order: logarithm of the diameter (m) of the circle of equal
/// area; logarithm of the height (m); area over that of the ellipse of equal second moments; minor
/// over major axis of that ellipse; area over that of the bounding box; distance of the top from
/// the middle, over the diameter; inner prominence; distance of the tops inside, over the
/// diameter; how much of the border, and how high up, other crowns touch.
fn measures(region: &Region, cols: usize, cell_m: f32) -> [f64; MEASURES] {
    let e = &region.extent;
    let cell = f64::from(cell_m);
    let diameter = (4.0 * e.cells / std::f64::consts::PI).sqrt();
    let height = f64::from(e.top_m);
    let (mx, my) = (e.sum[0] / e.cells, e.sum[1] / e.cells);
    // A cell has a spread of its own: 1/12 of its squared side.
    let xx = e.sum_sq[0] / e.cells - mx * mx + 1.0 / 12.0;
    let xy = e.sum_sq[1] / e.cells - mx * my;
    let yy = e.sum_sq[2] / e.cells - my * my + 1.0 / 12.0;
    let det = (xx * yy - xy * xy).max(1e-9);
    let mean = 0.5 * (xx + yy);
    let half = (mean * mean - det).max(0.0).sqrt();
    let wide = f64::from(e.max[0] - e.min[0] + 1);
    let deep = f64::from(e.max[1] - e.min[1] + 1);
    let (tx, ty) = ((e.top_cell as usize % cols) as f64, (e.top_cell as usize / cols) as f64);
    [
        (diameter * cell).ln(),
        height.ln(),
        e.cells / (4.0 * std::f64::consts::PI * det.sqrt()),
        ((mean - half).max(1e-9) / (mean + half)).sqrt(),
        e.cells / (wide * deep),
        (tx - mx).hypot(ty - my) / diameter,
        f64::from(region.inner_prominence),
        f64::from(region.inner_distance) / diameter,
        e.border_height / height / e.border.max(1.0),
    ]
}

/// How far the surface falls from the region's top to the highest pass to another crown.
fn drop_m(region: &Region) -> f64 {
    let top = f64::from(region.extent.top_m);
    (top - f64::from(region.outer_saddle_m)).clamp(0.0, GREATEST_DROP * top)
}

/// The chance that a region is one tree: that its box and an annotated one overlap to 0.4 of their
/// union.
fn chance(region: &Region, cols: usize, cell_m: f32) -> f32 {
    if region.extent.cells < 1.0 {
        return 0.0;
    }
    let mut m = measures(region, cols, cell_m);
    for k in 0..MEASURES {
        m[k] = m[k].clamp(LOWEST[k], HIGHEST[k]);
    }
    let (d, h) = (m[0], m[1]);
    let z = BIAS
        + (0..MEASURES).map(|k| WEIGHT[k] * m[k]).sum::<f64>()
        + WEIGHT_SIZE[0] * d * d
        + WEIGHT_SIZE[1] * d * h
        + WEIGHT_SIZE[2] * h * h
        + WEIGHT_DROP * (drop_m(region) + LEAST_DROP_M).ln();
    (1.0 / (1.0 + (-z).exp())) as f32
}

/// What a chosen region must be worth. Half the F1 to be expected gives the greatest F1 where
/// chances are independent; those of a whole and of its parts are not, and more than half keeps
/// large crowns whole.
const PRICE: f32 = 0.38;

/// The disjoint regions, together all there is, that are worth most; by region.
pub(super) fn choose(h: &Hierarchy, cols: usize, cell_m: f32) -> Vec<Chosen> {
    let chance: Vec<f32> = h.region.iter().map(|r| chance(r, cols, cell_m)).collect();
    let mut value: Vec<f32> = Vec::with_capacity(h.region.len());
    let mut is_own: Vec<bool> = Vec::with_capacity(h.region.len());
    for (r, &p) in h.region.iter().zip(&chance) {
        let worth = p - PRICE;
        // A part of no worth can be left out later: it counts for nothing, unless both do.
        let parts = r.parts.map(|[a, b]| {
            let (a, b) = (value[a as usize], value[b as usize]);
            if a.max(b) > 0.0 { a.max(0.0) + b.max(0.0) } else { a + b }
        });
        is_own.push(parts.is_none_or(|parts| worth >= parts));
        value.push(parts.map_or(worth, |parts| parts.max(worth)));
    }
    let mut chosen = Vec::new();
    let mut stack: Vec<u32> =
        (0..h.region.len() as u32).filter(|&i| h.is_whole[i as usize]).collect();
    while let Some(i) = stack.pop() {
        match h.region[i as usize].parts {
            Some(parts) if !is_own[i as usize] => stack.extend(parts),
            _ => {
                let m = measures(&h.region[i as usize], cols, cell_m);
                let is_alone = m[8] < ALONE && m[0].exp() >= ALONE_DIAMETER_M;
                chosen.push(Chosen { region: i, chance: chance[i as usize], is_alone });
            }
        }
    }
    chosen.sort_unstable_by_key(|c| c.region);
    chosen
}

#[cfg(test)]
mod training {
    //! The regions of scans as tables, to which [`chance`] is fitted.

    use std::fmt::Write as _;
    use std::path::{Path, PathBuf};

    use rayon::prelude::*;

    use super::*;
    use crate::crown::{basins, canopy};
    use crate::ground::{self, Kind, Method};
    use crate::scan::{self, ReadOptions};
    use crate::terrain::{self, TerrainOptions};

    /// Region, its parts, whether it is whole, its box in world coordinates, its measures.
    fn table(path: &Path) -> String {
        let scan = scan::read(&[path.to_path_buf()], &ReadOptions::default()).unwrap().value;
        let c = ground::classify(scan.cloud, Method::Smrf).unwrap().value;
        let terrain = terrain::build(&c, &TerrainOptions::default()).unwrap().value;
        let points = || c.cloud.position.iter().zip(&c.kind);
        let vegetation: Vec<_> = points()
            .filter(|(_, k)| **k == Kind::Vegetation)
            .map(|(p, _)| (*p, p.z - terrain.height_at(p.truncate())))
            .collect();
        let tall = || vegetation.iter().filter(|v| v.1 >= 2.0).map(|v| v.0.as_dvec3());
        let low = tall().fold(glam::DVec3::INFINITY, |a, p| a.min(p));
        let high = tall().fold(glam::DVec3::NEG_INFINITY, |a, p| a.max(p));
        let cell = canopy::cell_for_density(canopy::density_per_sq_m(&c.cloud.position));
        let g = canopy::geometry([low.x, low.y], [high.x, high.y], cell, c.cloud.len());
        let bare = points().filter(|(_, k)| **k == Kind::Ground).map(|(p, _)| *p);
        let bare: Vec<_> = bare.collect();
        let (vegetation, bare) = (vegetation.par_iter().copied(), bare.par_iter().copied());
        let surface = canopy::build(g, vegetation, bare, 1);
        let h = merge(&basins::find(&surface, 2.0), g.cols, g.cell_x as f32);
        let origin = c.cloud.frame.origin;
        let mut out = String::new();
        for (i, r) in h.region.iter().enumerate() {
            let [a, b] = r.parts.map_or([-1, -1], |p| p.map(i64::from));
            let e = &r.extent;
            let west = origin.x + g.west + f64::from(e.min[0]) * g.cell_x;
            let east = origin.x + g.west + f64::from(e.max[0] + 1) * g.cell_x;
            let north = origin.y + g.north - f64::from(e.min[1]) * g.cell_y;
            let south = origin.y + g.north - f64::from(e.max[1] + 1) * g.cell_y;
            write!(out, "{i},{a},{b},{},{west},{south},{east},{north}", u8::from(h.is_whole[i]))
                .unwrap();
            for m in measures(r, g.cols, g.cell_x as f32) {
                write!(out, ",{m}").unwrap();
            }
            writeln!(out, ",{}", (drop_m(r) + LEAST_DROP_M).ln()).unwrap();
        }
        out
    }

    #[test]
    #[ignore = "writes training tables: REGIONS_OUT=DIR REGIONS_IN=DIR of scans"]
    fn write_regions() {
        let folder = |name| PathBuf::from(std::env::var_os(name).unwrap());
        for entry in std::fs::read_dir(folder("REGIONS_IN")).unwrap() {
            let path = entry.unwrap().path();
            let name = path.file_stem().unwrap().to_str().unwrap();
            let out = folder("REGIONS_OUT").join(format!("{name}.csv"));
            std::fs::write(out, table(&path)).unwrap();
        }
    }
}
