//! Classified points over terrain to tree crowns with their measures (T15, method "Crowns").
//! Knows nothing of species.
//!
//! Heights above terrain make a canopy surface (`canopy`); from its tops down it falls apart into
//! basins (`basins`); these merge into nested regions, of which those are kept that most likely are
//! one tree each (`hierarchy`); a region and its points are measured (`measure`, `outline`). What
//! lies below those crowns' bases or beside their skirts then goes the same way once more: trees
//! under and between taller ones. Every scale follows from the density and height of the points.
//!
//! Known limit: a lower tree whose top touches the crown above it is taken for part of it.

mod basins;
mod canopy;
mod hierarchy;
mod measure;
mod outline;
#[cfg(test)]
mod tests;
mod voids;

use std::collections::BTreeSet;

use glam::{Vec2, Vec3};
use rayon::prelude::*;

use crate::diagnostic::{Error, Result, Warned};
use crate::ground::{Classified, Kind};
use crate::raster::{Grid, GridGeometry, Groups};
use crate::scan::PointCloud;
use crate::terrain::Terrain;
use crate::voxel;

/// One tree as the scan shows it. Coordinates are local metres with absolute heights.
#[derive(Debug, Clone, PartialEq)]
pub struct Crown {
    /// Stable key of the place ([`crate::frame::Frame::key`] of the apex).
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
    /// Mean of the outline's greatest width and the width across it, as crowns are measured from
    /// the ground.
    pub spread_m: f32,
    /// Of the crown above its base, by the reach of its returns (`measure` tells how), > 0.
    pub volume_cu_m: f32,
    /// Of the crown's mantle from base to apex, without its underside, > 0.
    pub surface_sq_m: f32,
    /// A taller crown hides the apex from the sky.
    pub is_understory: bool,
    /// Simple polygon, counter-clockwise, at least 3 corners, first not repeated.
    pub outline: Vec<Vec2>,
    /// Centres of mass of the crown's voxels: the growth volume. Never empty.
    pub attractors: Vec<Vec3>,
    /// Points of the tree, stem included, undergrowth not.
    pub point_count: u32,
    /// 0…1: the chance that this is one tree, as counted on the annotated crowns it was fitted to:
    /// of those given 0.4 to 0.5 it was right of 40 %, of those given 0.6 to 0.7 of 67 %
    /// (docs/inventory.md, also for sparser scans). From the size of the crown against its height, its
    /// shape, how deep the surface dips inside and beside it, and how many returns there are. Of a
    /// tree under a taller crown it says less: no such tree is annotated there.
    pub confidence: f32,
}

impl Crown {
    /// Into another frame.
    pub fn moved(self, by: Vec3) -> Crown {
        Crown {
            root: self.root + by,
            apex: self.apex + by,
            outline: self.outline.into_iter().map(|p| p + by.truncate()).collect(),
            attractors: self.attractors.into_iter().map(|p| p + by).collect(),
            ..self
        }
    }

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
        // A square is as wide as 0.886 of its circle along its sides.
        holds(self.spread_m >= 0.8 * self.diameter_m, "the spread is less than the diameter")?;
        holds(self.volume_cu_m > 0.0, "the volume is not positive")?;
        holds(self.surface_sq_m > 0.0, "the surface is not positive")?;
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
    /// Regions less sure to be a tree are left out, 0…1, unless they stand alone. F1 on the annotated
    /// plots changes little from 0.22 to 0.35; 0 keeps all of the canopy.
    pub min_confidence: f32,
    /// Cell of the canopy surface, metres; from the density where not given.
    pub cell_m: Option<f32>,
    /// The canopy surface is the mean of those on so many times so many shifted grids, 1 to 8.
    pub grids: usize,
    /// Whether a lower storey is looked for.
    pub has_understory: bool,
}

impl Default for CrownOptions {
    fn default() -> Self {
        CrownOptions {
            min_height_m: 2.0,
            min_confidence: 0.25,
            cell_m: None,
            grids: 1,
            has_understory: true,
        }
    }
}

impl CrownOptions {
    fn check(&self) -> Result<()> {
        length("the least tree height", self.min_height_m)?;
        if !(0.0..=1.0).contains(&self.min_confidence) {
            return Err(Error::new(format!("the least confidence is {}", self.min_confidence))
                .remedy("give a number from 0 to 1"));
        }
        if !(1..=8).contains(&self.grids) {
            return Err(Error::new(format!("the canopy on {} shifted grids", self.grids))
                .remedy("give a number from 1 to 8"));
        }
        self.cell_m.map_or(Ok(()), |v| length("the cell of the canopy surface", v))
    }
}

fn length(name: &str, value: f32) -> Result<()> {
    if value.is_finite() && value > 0.0 {
        return Ok(());
    }
    Err(Error::new(format!("{name} is {value}, which is no length"))
        .remedy("give a number of metres greater than 0"))
}

/// The cell of the canopy surface for so many points per occupied square of 2 m, metres.
pub fn cell_m(density_per_sq_m: f64) -> f32 {
    canopy::cell_for_density(density_per_sq_m) as f32
}

/// The cell of the canopy surface of these points where none is asked for, metres.
pub fn usual_cell_m(points: &[Vec3]) -> f32 {
    cell_m(canopy::density_per_sq_m(points))
}

/// The tallest tree known stands 116 m high.
const TALLEST_M: f32 = 120.0;

/// Trees, sorted by key, and what did not become one.
pub struct Found {
    pub crowns: Vec<Crown>,
    pub tally: Tally,
}

/// Counts from which warnings follow; those of the pieces of a scan add up to those of the whole.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Tally {
    /// Points.
    pub vegetation: usize,
    /// Of those, lower than the least tree.
    pub low: usize,
    /// Places in the canopy that look too little like one tree.
    pub left_out: usize,
    /// Higher than any tree.
    pub too_tall: usize,
}

impl Tally {
    pub fn add(&mut self, piece: Tally) {
        self.vegetation += piece.vegetation;
        self.low += piece.low;
        self.left_out += piece.left_out;
        self.too_tall += piece.too_tall;
    }
}

impl Found {
    /// Part of the canopy's places, and of its points, that may be no tree before the user is warned.
    const MUCH: f64 = 0.5;

    /// Places in the canopy, trees or not.
    fn places(&self) -> usize {
        self.tally.left_out + self.crowns.iter().filter(|c| !c.is_understory).count()
    }

    fn points_in_trees(&self) -> usize {
        self.crowns.iter().map(|c| c.point_count as usize).sum()
    }

    /// What belongs in a report. `min_height_m`: of the least tree.
    pub fn notes(&self, min_height_m: f32) -> [String; 2] {
        let Tally { vegetation, low, left_out, .. } = self.tally;
        let outside = vegetation.saturating_sub(self.points_in_trees());
        [
            format!(
                "{left_out} of {} places in the canopy look too little like one tree",
                self.places()
            ),
            format!(
                "{outside} of {vegetation} vegetation points belong to no tree; of all points {low} \
                 are lower than {min_height_m} m"
            ),
        ]
    }

    /// What a user should know.
    pub fn warnings(&self, min_height_m: f32) -> Vec<String> {
        let Tally { vegetation, low, left_out, too_tall } = self.tally;
        if low == vegetation && self.crowns.is_empty() {
            return vec![format!(
                "no tree found: none of the {vegetation} vegetation points is {min_height_m} m above \
                 the ground"
            )];
        }
        let mut warnings = Vec::new();
        if too_tall > 0 {
            warnings.push(format!(
                "higher than {TALLEST_M} m and left out as no trees: {too_tall} (masts, birds, clouds?)"
            ));
        }
        if self.crowns.is_empty() {
            warnings.push("no tree found".to_owned());
        }
        let [places, points] = self.notes(min_height_m);
        if left_out as f64 > Self::MUCH * self.places() as f64 {
            warnings.push(format!("{places} and are left out (buildings, wires, rocks?)"));
        }
        let tall = vegetation.saturating_sub(low);
        let outside = tall.saturating_sub(self.points_in_trees());
        if outside as f64 > Self::MUCH * tall as f64 {
            warnings.push(points);
        }
        warnings
    }
}

/// Finds the trees, sorted by key. A point belongs to the tree over which it lies; the points of a
/// tree are gathered in voxels of edge `voxel_m` (see [`voxel::choose_size_m`]).
///
/// A key that two trees would share (apexes in the same quarter metre) goes to the taller; the
/// other takes the next greater key that is free. The same points give the same crowns on any
/// number of threads.
///
/// # Errors
/// Kinds that are not as many as the points; options that make no sense.
pub fn detect(
    classified: &Classified,
    terrain: &Terrain,
    voxel_m: f32,
    options: &CrownOptions,
) -> Result<Warned<Vec<Crown>>> {
    let found = detect_within(classified, terrain, voxel_m, options, None, |_| true)?;
    let warnings = found.warnings(options.min_height_m);
    Ok(Warned::with(found.crowns, warnings))
}

/// A rectangle along the axes, its least and greatest corner, local metres.
pub type Extent = (Vec2, Vec2);

/// What encloses both.
pub fn join_extents(a: Option<Extent>, b: Option<Extent>) -> Option<Extent> {
    match (a, b) {
        (Some((a, b)), Some((c, d))) => Some((a.min(c), b.max(d))),
        (a, b) => a.or(b),
    }
}

/// Above the terrain, by point; NaN for what is no vegetation.
fn heights(classified: &Classified, terrain: &Terrain) -> Vec<f32> {
    let points = classified.cloud.position.par_iter().zip(&classified.kind);
    let height = |(p, kind): (&Vec3, &Kind)| match kind {
        Kind::Vegetation => p.z - terrain.height_at(p.truncate()),
        _ => f32::NAN,
    };
    points.map(height).collect()
}

/// Where vegetation stands at least so high; `None` where it nowhere does.
pub fn canopy_extent(
    classified: &Classified,
    terrain: &Terrain,
    min_height_m: f32,
) -> Option<Extent> {
    extent_of(&classified.cloud, &heights(classified, terrain), min_height_m)
}

fn extent_of(cloud: &PointCloud, height: &[f32], min_height_m: f32) -> Option<Extent> {
    let points = cloud.position.par_iter().zip(height);
    points
        .filter(|(_, height)| height.is_finite() && **height >= min_height_m)
        .map(|(p, _)| Some((p.truncate(), p.truncate())))
        .reduce(|| None, join_extents)
}

/// [`detect`] in a window of a scan: only what has its apex or place where `is_own` holds is given
/// and counted. `extent`: what there is of the scan's canopy within the bounds of the window; found
/// in its points where `None`.
///
/// # Errors
/// Those of [`detect`].
pub fn detect_within(
    classified: &Classified,
    terrain: &Terrain,
    voxel_m: f32,
    options: &CrownOptions,
    extent: Option<Extent>,
    is_own: impl Fn(Vec3) -> bool + Sync,
) -> Result<Found> {
    options.check()?;
    length("the edge of a voxel", voxel_m)?;
    let cloud = &classified.cloud;
    if classified.kind.len() != cloud.len() {
        return Err(Error::new(format!(
            "{} points have {} kinds",
            cloud.len(),
            classified.kind.len()
        ))
        .remedy("classify the cloud again"));
    }
    let height = heights(classified, terrain);
    let (all, bare) = rayon::join(
        || -> Vec<u32> {
            let points = height.par_iter().enumerate();
            points.filter(|(_, h)| h.is_finite()).map(|(i, _)| i as u32).collect()
        },
        || -> Vec<u32> {
            let points = classified.kind.par_iter().enumerate();
            points.filter(|(_, k)| **k == Kind::Ground).map(|(i, _)| i as u32).collect()
        },
    );
    let own = |i: &&u32| is_own(cloud.position[**i as usize]);
    let is_low = |i: &&u32| height[**i as usize] < options.min_height_m;
    let mut tally = Tally {
        vegetation: all.par_iter().filter(own).count(),
        low: all.par_iter().filter(is_low).filter(own).count(),
        ..Tally::default()
    };
    let extent = extent.or_else(|| extent_of(cloud, &height, options.min_height_m));
    let Some((low, high)) = extent else {
        return Ok(Found { crowns: Vec::new(), tally });
    };

    let cell = f64::from(options.cell_m.unwrap_or_else(|| usual_cell_m(&cloud.position)));
    let grid = |cell: f64| {
        let [low, high] = [low, high].map(|p| p.to_array().map(f64::from));
        canopy::geometry(low, high, cell, cloud.len())
    };
    let stand = Stand { cloud, height: &height, terrain, voxel_m, bare, options };
    let upper = stand.layer(grid(cell), &all, 1);
    let left = match options.has_understory {
        true => upper.left(&stand, &all),
        false => Vec::new(),
    };
    let points = LOWER_POINTS.max((LOWER_SQ_M / (cell * cell)) as usize);
    let lower = stand.layer(grid(LOWER_CELLS * cell), &left, points);
    tally.left_out = upper.left_out.iter().filter(|p| is_own(**p)).count();
    let mut crowns = join(upper, lower, left.iter().map(|&i| cloud.position[i as usize]));
    crowns.retain(|crown| is_own(crown.apex));
    let found = crowns.len();
    crowns.retain(|crown| crown.height_m <= TALLEST_M);
    tally.too_tall = found - crowns.len();
    give_keys(&mut crowns, |apex| cloud.frame.key(apex));
    Ok(Found { crowns, tally })
}

/// A lower tree is shown by this many returns at least, and by as many as the canopy has cells in so
/// many square metres: fewer are as often a bough or undergrowth. The annotated plots mark crowns seen
/// from above alone, and F1 there falls by 0.02 for every 40 lower trees.
const LOWER_POINTS: usize = 10;
const LOWER_SQ_M: f64 = 3.0;
/// Cells of the lower storey, which fewer points show, in those of the canopy.
const LOWER_CELLS: f64 = 2.0;
/// A lower tree ends this far below the crown over it, metres and part of that tree's height: what
/// hangs nearer is that crown's skirt.
const CLEARANCE_M: f32 = 3.0;
const CLEARANCE_RELATIVE: f32 = 0.15;
/// A crown hides what ends so far below its surface, metres.
const HIDES_M: f32 = 1.0;
/// What no crown hides was seen from above already, and is mostly the skirt of a crown beside it.
const SEEN_CONFIDENCE: f32 = 0.6;
/// So many returns halve the confidence in a tree.
const HALF_SURE: f32 = 8.0;
/// What is so near a stem is the stem, metres and part of the tree's height.
const STEM_M: f32 = 0.3;
const STEM_RELATIVE: f32 = 0.02;

/// What crowns are looked for in.
struct Stand<'a> {
    cloud: &'a PointCloud,
    /// Above the terrain, by point.
    height: &'a [f32],
    terrain: &'a Terrain,
    voxel_m: f32,
    /// Numbers of ground points.
    bare: Vec<u32>,
    options: &'a CrownOptions,
}

/// The trees of one storey.
struct Layer {
    trees: Vec<Crown>,
    /// Index into `trees` by cell; [`basins::NONE`] where there is no crown, [`LEFT_OUT`] where
    /// there is something too little like a tree.
    tree_of_cell: Vec<u32>,
    /// Greatest height by cell.
    top: Grid<f32>,
    /// Tops of the places that look too little like a tree.
    left_out: Vec<Vec3>,
}

const LEFT_OUT: u32 = basins::NONE - 1;

/// The cell of a grid over which a point lies.
fn cell_over(g: &GridGeometry, p: Vec3) -> Option<usize> {
    let (c, r) = g.cell_of(f64::from(p.x), f64::from(p.y))?;
    Some(g.index(c, r))
}

impl Stand<'_> {
    /// The trees that the points of given numbers show, by a canopy on the grid `g`; of fewer points
    /// than `least` there is none.
    fn layer(&self, g: GridGeometry, points: &[u32], least: usize) -> Layer {
        let cell_m = g.cell_x as f32;
        let at = |i: &u32| self.cloud.position[*i as usize];
        if points.len() < least {
            return Layer {
                trees: Vec::new(),
                tree_of_cell: vec![basins::NONE; g.len()],
                top: Grid::filled(g, 0.0),
                left_out: Vec::new(),
            };
        }
        let heights = points.par_iter().map(|i| (at(i), self.height[*i as usize]));
        let grids = self.options.grids;
        let canopy = canopy::build(g, heights, self.bare.par_iter().map(at), grids);
        let basins = basins::find(&canopy, self.options.min_height_m);
        let regions = hierarchy::merge(&basins, g.cols, cell_m);
        let top_of = |c: &hierarchy::Chosen| {
            let cell = regions.region[c.region as usize].extent.top_cell as usize;
            let [x, y] = g.centre(cell % g.cols, cell / g.cols);
            Vec3::new(x as f32, y as f32, canopy.top.data[cell])
        };
        let (chosen, out): (Vec<_>, Vec<_>) = (hierarchy::choose(&regions, g.cols, cell_m))
            .into_iter()
            .partition(|c| c.chance >= self.options.min_confidence || c.is_alone);
        let left_out = out.iter().map(top_of).collect();
        let tree_of_basin = regions.tree_of_basin(&chosen, basins.extent.len());
        let mut tree_of_cell: Vec<u32> = (basins.of_cell.par_iter())
            .map(|&basin| match tree_of_basin.get(basin as usize) {
                None => basins::NONE,
                Some(&basins::NONE) => LEFT_OUT,
                Some(&tree) => tree,
            })
            .collect();

        let tree_of_point = points.par_iter().map(|i| {
            let tree = cell_over(&g, at(i)).map_or(basins::NONE, |cell| tree_of_cell[cell]);
            let in_tree = chosen.get(tree as usize).is_some_and(|c| {
                let top_m = regions.region[c.region as usize].extent.top_m;
                let lowest_m = measure::undergrowth_m(top_m).min(self.options.min_height_m);
                self.height[*i as usize] >= lowest_m
            });
            if in_tree { tree } else { basins::NONE }
        });
        let (members, cells) = rayon::join(
            || Groups::new(chosen.len(), tree_of_point, |k| points[k as usize]),
            || Groups::new(chosen.len(), tree_of_cell.par_iter().copied(), |cell| cell),
        );
        let crowns: Vec<Option<Crown>> = (0..chosen.len())
            .into_par_iter()
            .map(|tree| {
                let own = members.of(tree);
                if own.len() < least {
                    return None;
                }
                let middle: Vec<Vec2> = (cells.of(tree).iter())
                    .map(|&i| {
                        let [x, y] = g.centre(i as usize % g.cols, i as usize / g.cols);
                        Vec2::new(x as f32, y as f32)
                    })
                    .collect();
                let points: Vec<Vec3> = own.iter().map(at).collect();
                let heights: Vec<f32> = own.iter().map(|&i| self.height[i as usize]).collect();
                let members = measure::Members {
                    points: &points,
                    heights: &heights,
                    voxels: &voxel::centres_of_mass(&points, self.voxel_m),
                    voxel_m: self.voxel_m,
                };
                measure::crown(&middle, cell_m, &members, self.terrain, chosen[tree].chance)
                    .filter(|c| c.height_m >= self.options.min_height_m)
            })
            .collect();

        // Places that gave no crown leave the numbering.
        let mut number = vec![basins::NONE; chosen.len()];
        let mut trees = Vec::with_capacity(chosen.len());
        for (tree, crown) in crowns.into_iter().enumerate() {
            if let Some(crown) = crown {
                number[tree] = trees.len() as u32;
                trees.push(crown);
            }
        }
        for tree in tree_of_cell.iter_mut() {
            *tree = number.get(*tree as usize).copied().unwrap_or(*tree);
        }
        Layer { trees, tree_of_cell, top: canopy.top, left_out }
    }
}

impl Layer {
    /// Numbers of the points that a lower storey may be made of: those that are tall enough and lie
    /// under a crown's base with some clearance, but are not its stem, or beside the skirts of the
    /// crowns.
    fn left(&self, stand: &Stand<'_>, points: &[u32]) -> Vec<u32> {
        let is_left = |i: u32| {
            let (p, height_m) = (stand.cloud.position[i as usize], stand.height[i as usize]);
            if height_m < stand.options.min_height_m {
                return false;
            }
            let Some(cell) = cell_over(&self.top.geometry, p) else { return false };
            let Some(crown) = self.trees.get(self.tree_of_cell[cell] as usize) else {
                return self.tree_of_cell[cell] == basins::NONE;
            };
            let up = p.z - crown.root.z;
            let clearance_m = CLEARANCE_M.max(CLEARANCE_RELATIVE * crown.height_m);
            if up > crown.base_height_m - clearance_m {
                return false;
            }
            let lean = (crown.apex - crown.root).truncate() * (up / crown.height_m);
            let from_stem = (p - crown.root).truncate().distance(lean);
            from_stem > STEM_M + STEM_RELATIVE * crown.height_m
        };
        points.par_iter().copied().filter(|&i| is_left(i)).collect()
    }
}

/// The trees of both storeys, the lower one made of `left`. Its points no longer count for the crowns
/// above.
fn join(upper: Layer, lower: Layer, left: impl Iterator<Item = Vec3>) -> Vec<Crown> {
    let mut crowns = upper.trees;
    let canopy_trees = crowns.len();
    let above = |p: Vec3| {
        let cell = cell_over(&upper.top.geometry, p)?;
        let tree = upper.tree_of_cell[cell] as usize;
        (tree < canopy_trees).then_some((tree, upper.top.data[cell]))
    };
    let is_hidden =
        |c: &Crown| above(c.apex).is_some_and(|(_, top_m)| top_m > c.height_m + HIDES_M);
    let trees: Vec<Option<Crown>> = (lower.trees.into_iter())
        .map(|crown| Crown { is_understory: is_hidden(&crown), ..crown })
        .map(|crown| Some(crown).filter(|c| c.is_understory || c.confidence >= SEEN_CONFIDENCE))
        .collect();
    for p in left {
        let of_lower = cell_over(&lower.top.geometry, p).map(|cell| lower.tree_of_cell[cell]);
        if of_lower.is_some_and(|tree| matches!(trees.get(tree as usize), Some(Some(_))))
            && let Some((tree, _)) = above(p)
        {
            crowns[tree].point_count = crowns[tree].point_count.saturating_sub(1).max(1);
        }
    }
    crowns.extend(trees.into_iter().flatten());
    for crown in &mut crowns {
        let n = crown.point_count as f32;
        crown.confidence *= n / (n + HALF_SURE);
    }
    crowns
}

/// Keys from the apexes, the taller first; sorted by key. An apex is one return, and stays where it is
/// when others go or cells change; a root is reckoned from many.
fn give_keys(crowns: &mut [Crown], key: impl Fn(Vec3) -> u64) {
    crowns.sort_by(|a, b| {
        b.height_m
            .total_cmp(&a.height_m)
            .then(a.apex.x.total_cmp(&b.apex.x))
            .then(a.apex.y.total_cmp(&b.apex.y))
    });
    let mut taken = BTreeSet::new();
    for crown in crowns.iter_mut() {
        crown.key = key(crown.apex);
        while !taken.insert(crown.key) {
            crown.key = crown.key.wrapping_add(1);
        }
    }
    crowns.sort_by_key(|c| c.key);
}
