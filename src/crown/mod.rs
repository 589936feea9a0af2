//! Classified points over terrain to tree crowns with their measures (T15, method "Crowns").
//! Knows nothing of species.
//!
//! Heights above terrain make a canopy surface (`canopy`); from its tops down it falls apart into
//! basins (`basins`); these merge into nested regions, of which those are kept that most likely are
//! one tree each (`hierarchy`); a region and its points are measured (`measure`, `outline`). Every
//! scale follows from the density and height of the points.

mod basins;
mod canopy;
mod hierarchy;
mod measure;
mod outline;
#[cfg(test)]
mod tests;

use std::collections::BTreeSet;

use glam::{Vec2, Vec3};
use rayon::prelude::*;

use crate::diagnostic::{Error, Result, Warned};
use crate::ground::{Classified, Kind};
use crate::terrain::Terrain;
use crate::voxel::VoxelOctree;

/// One tree as the scan shows it. Coordinates are local metres with absolute heights.
#[derive(Debug, Clone, PartialEq)]
pub struct Crown {
    /// Stable key of the place ([`crate::frame::Frame::key`] of the root).
    pub key: u64,
    /// Stem foot on the terrain.
    pub root: Vec3,
    /// Highest point above the terrain.
    pub apex: Vec3,
    /// Apex above the terrain under the root.
    pub height_m: f32,
    /// Crown base above the terrain under the root, < `height_m`.
    pub base_height_m: f32,
    /// Diameter of the circle of the outline's area.
    pub diameter_m: f32,
    /// Simple polygon, counter-clockwise, at least 3 corners, first not repeated.
    pub outline: Vec<Vec2>,
    /// Centres of mass of the crown's voxels: the growth volume. Never empty.
    pub attractors: Vec<Vec3>,
    /// Points of the tree, stem included, undergrowth not.
    pub point_count: u32,
    /// 0…1: the chance that this is one tree, as counted on the annotated crowns it was fitted to:
    /// of those given 0.4 to 0.5 it was right of 45 %, of those given 0.7 to 0.8 of 78 %. From the size of
    /// the crown against its height, its shape, and how deep the surface dips inside it.
    pub confidence: f32,
}

impl Crown {
    /// The invariants; the first that does not hold is named.
    pub fn check(&self) -> std::result::Result<(), String> {
        let holds = |ok: bool, what: &str| {
            if ok { Ok(()) } else { Err(format!("crown {:016x}: {what}", self.key)) }
        };
        let finite = self.root.is_finite()
            && self.apex.is_finite()
            && self.outline.iter().all(|p| p.is_finite())
            && self.attractors.iter().all(|p| p.is_finite());
        holds(finite, "a coordinate is not finite")?;
        holds(self.height_m > 0.0, "the height is not positive")?;
        holds(
            (self.apex.z - self.root.z - self.height_m).abs() <= 1e-3 * (1.0 + self.apex.z.abs()),
            "the height is not that of the apex above the root",
        )?;
        holds(
            (0.0..self.height_m).contains(&self.base_height_m),
            "the crown base is not between root and apex",
        )?;
        holds(self.outline.len() >= 3, "the outline has fewer than 3 corners")?;
        holds(outline::is_simple(&self.outline), "the outline crosses itself")?;
        let area = outline::area_sq_m(&self.outline);
        holds(area > 0.0, "the outline is not counter-clockwise")?;
        let circle = std::f64::consts::FRAC_PI_4 * f64::from(self.diameter_m).powi(2);
        holds((circle - area).abs() <= 1e-3 * area, "the diameter is not that of the outline")?;
        holds(!self.attractors.is_empty(), "there are no attractors")?;
        holds(self.point_count > 0, "there are no points")?;
        holds((0.0..=1.0).contains(&self.confidence), "the confidence is not between 0 and 1")
    }
}

/// What to look for. The defaults serve every scan.
#[derive(Debug, Clone, PartialEq)]
pub struct CrownOptions {
    /// Lower trees are left out, metres.
    pub min_height_m: f32,
    /// Regions less sure to be a tree are left out, 0…1. The default loses little of the canopy;
    /// 0.26 gives the best F1 on the annotated plots, 0 keeps all.
    pub min_confidence: f32,
    /// Cell of the canopy surface, metres; from the density where not given.
    pub cell_m: Option<f32>,
}

impl Default for CrownOptions {
    fn default() -> Self {
        CrownOptions { min_height_m: 2.0, min_confidence: 0.15, cell_m: None }
    }
}

impl CrownOptions {
    fn check(&self) -> Result<()> {
        let length = |name: &str, value: f32| {
            if value.is_finite() && value > 0.0 {
                return Ok(());
            }
            Err(Error::new(format!("{name} is {value}, which is no length"))
                .remedy("give a number of metres greater than 0"))
        };
        length("the least tree height", self.min_height_m)?;
        if !(0.0..=1.0).contains(&self.min_confidence) {
            return Err(Error::new(format!("the least confidence is {}", self.min_confidence))
                .remedy("give a number from 0 to 1"));
        }
        self.cell_m.map_or(Ok(()), |v| length("the cell of the canopy surface", v))
    }
}

/// The tallest tree known stands 116 m high.
const TALLEST_M: f32 = 120.0;

/// Finds the trees, sorted by key. `voxels` are those of the vegetation: each belongs to the tree
/// over which its centre of mass lies, and so to one tree at most.
///
/// A key that two trees would share (roots in the same quarter metre) goes to the taller; the
/// other takes the next greater key that is free. The same points give the same crowns on any
/// number of threads.
pub fn detect(
    classified: &Classified,
    terrain: &Terrain,
    voxels: &VoxelOctree,
    options: &CrownOptions,
) -> Result<Warned<Vec<Crown>>> {
    options.check()?;
    let cloud = &classified.cloud;
    if classified.kind.len() != cloud.len() {
        return Err(Error::new(format!(
            "{} points have {} kinds",
            cloud.len(),
            classified.kind.len()
        ))
        .remedy("classify the cloud again"));
    }
    let mut warnings = Vec::new();
    let is_vegetation = |i: usize| classified.kind[i] == Kind::Vegetation;

    let height: Vec<f32> = cloud
        .position
        .par_iter()
        .enumerate()
        .map(
            |(i, &p)| {
                if is_vegetation(i) { p.z - terrain.height_at(p.truncate()) } else { f32::NAN }
            },
        )
        .collect();
    let vegetation = || (0..cloud.len()).filter(|&i| is_vegetation(i) && height[i].is_finite());
    let tall = || vegetation().filter(|&i| height[i] >= options.min_height_m);
    if tall().next().is_none() {
        warnings.push(format!(
            "no tree found: none of the {} vegetation points is {} m above the ground",
            vegetation().count(),
            options.min_height_m
        ));
        return Ok(Warned::with(Vec::new(), warnings));
    }

    let density = canopy::density_per_sq_m(&cloud.position);
    let cell = options.cell_m.map_or_else(|| canopy::cell_for_density(density), f64::from);
    let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
    for i in tall() {
        let p = cloud.position[i].as_dvec3();
        low = [low[0].min(p.x), low[1].min(p.y)];
        high = [high[0].max(p.x), high[1].max(p.y)];
    }
    let geometry = canopy::geometry(low, high, cell, cloud.len());
    let cell_m = geometry.cell_x as f32;
    let bare = (0..cloud.len()).filter(|&i| classified.kind[i] == Kind::Ground);
    let surface = canopy::build(
        geometry,
        vegetation().map(|i| (cloud.position[i], height[i])),
        bare.map(|i| cloud.position[i]),
    );
    let basins = basins::find(&surface, options.min_height_m);
    let regions = hierarchy::merge(&basins, geometry.cols, cell_m);
    let mut chosen = hierarchy::choose(&regions, geometry.cols, cell_m);
    let candidates = chosen.len();
    chosen.retain(|c| c.chance >= options.min_confidence);
    if chosen.len() < candidates {
        warnings.push(format!(
            "{} of {candidates} places look too little like one tree and are left out",
            candidates - chosen.len()
        ));
    }

    let tree_of_basin = regions.tree_of_basin(&chosen, basins.extent.len());
    let tree_of_cell = |cell: usize| match basins.of_cell[cell] {
        basins::NONE => basins::NONE,
        basin => tree_of_basin[basin as usize],
    };
    let cells =
        grouped(chosen.len(), (0..geometry.len()).map(|cell| (tree_of_cell(cell), cell as u32)));
    let tree_at = |p: Vec3, height_m: f32| {
        let tree = geometry
            .cell_of(f64::from(p.x), f64::from(p.y))
            .map_or(basins::NONE, |(c, r)| tree_of_cell(geometry.index(c, r)));
        let in_tree = chosen.get(tree as usize).is_some_and(|c| {
            let top_m = regions.region[c.region as usize].extent.top_m;
            height_m >= measure::undergrowth_m(top_m).min(options.min_height_m)
        });
        if in_tree { tree } else { basins::NONE }
    };
    let members = grouped(
        chosen.len(),
        vegetation().map(|i| (tree_at(cloud.position[i], height[i]), i as u32)),
    );
    let centres = voxels.centres_of_mass();
    let voxels_of_tree = grouped(
        chosen.len(),
        centres
            .iter()
            .enumerate()
            .map(|(i, &p)| (tree_at(p, p.z - terrain.height_at(p.truncate())), i as u32)),
    );
    let crowns: Vec<Crown> = (0..chosen.len())
        .into_par_iter()
        .filter_map(|tree| {
            let middle: Vec<Vec2> = cells[tree]
                .iter()
                .map(|&i| {
                    let i = i as usize;
                    let [x, y] = geometry.centre(i % geometry.cols, i / geometry.cols);
                    Vec2::new(x as f32, y as f32)
                })
                .collect();
            let points: Vec<Vec3> =
                members[tree].iter().map(|&i| cloud.position[i as usize]).collect();
            let heights: Vec<f32> = members[tree].iter().map(|&i| height[i as usize]).collect();
            let own: Vec<Vec3> =
                voxels_of_tree[tree].iter().map(|&i| centres[i as usize]).collect();
            let members = measure::Members {
                points: &points,
                heights: &heights,
                voxels: &own,
                voxel_m: voxels.size_m(),
            };
            measure::crown(&middle, cell_m, &members, terrain, chosen[tree].chance)
        })
        .filter(|crown| crown.height_m >= options.min_height_m)
        .collect();
    let found = crowns.len();
    let mut crowns: Vec<Crown> =
        crowns.into_iter().filter(|crown| crown.height_m <= TALLEST_M).collect();
    if crowns.len() < found {
        warnings.push(format!(
            "higher than {TALLEST_M} m and left out as no trees: {} (masts, birds, clouds?)",
            found - crowns.len()
        ));
    }

    let outside =
        vegetation().count() - crowns.iter().map(|c| c.point_count as usize).sum::<usize>();
    if crowns.is_empty() {
        warnings.push("no tree found".to_owned());
    }
    if outside > 0 {
        let lower = vegetation().filter(|&i| height[i] < options.min_height_m).count();
        warnings.push(format!(
            "{outside} of {} vegetation points belong to no tree; of all points {lower} are lower than {} m",
            vegetation().count(),
            options.min_height_m
        ));
    }
    give_keys(&mut crowns, |root| cloud.frame.key(root));
    Ok(Warned::with(crowns, warnings))
}

/// Members of each group, in order; what is in no group is left out.
fn grouped(groups: usize, members: impl Iterator<Item = (u32, u32)>) -> Vec<Vec<u32>> {
    let mut out = vec![Vec::new(); groups];
    for (group, member) in members {
        if let Some(list) = out.get_mut(group as usize) {
            list.push(member);
        }
    }
    out
}

/// Keys from the roots, the taller first; sorted by key.
fn give_keys(crowns: &mut [Crown], key: impl Fn(Vec3) -> u64) {
    crowns.sort_by(|a, b| {
        b.height_m
            .total_cmp(&a.height_m)
            .then(a.apex.x.total_cmp(&b.apex.x))
            .then(a.apex.y.total_cmp(&b.apex.y))
    });
    let mut taken = BTreeSet::new();
    for crown in crowns.iter_mut() {
        crown.key = key(crown.root);
        while !taken.insert(crown.key) {
            crown.key = crown.key.wrapping_add(1);
        }
    }
    crowns.sort_by_key(|c| c.key);
}
