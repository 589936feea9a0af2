//! Scan to trees tile by tile, for scans larger than memory. What looks far, the ground and the
//! terrain, looks at few points of a cell: these are gathered from the tiles and looked at together, so
//! that nothing depends on where tiles end. Crowns are found in blocks of tiles with those about
//! them, on grids aligned to multiples of their cell that end where those of the whole scan end, and
//! kept by their apex. Densities and scales are those of the whole scan.
//!
//! Limit: the ground of scans wider than [`ground::AREA_M`] is learned in such areas with a margin.

use std::collections::{BTreeMap, BTreeSet};

use glam::{IVec2, Vec3};

use super::survey::{
    READ, SurveyJob, Whole, check_extent, check_ground, crown_outcome, ground_outcome, looked_at,
    scan_outcome, voxel_m, with_held_out,
};
use crate::crown::{self, Crown, CrownOptions, Extent, Found, Tally};
use crate::diagnostic::Result;
use crate::frame::Frame;
use crate::ground::{self, Classified, Floor, Kind, Method, Rule, Spread};
use crate::report::{Outcome, Recorder};
use crate::scan::Bounds;
use crate::scan::tiles::{TILE_M, Tile, TiledScan, Window, blocks_of, tile_of};
use crate::species::look::{self, GroundIntensity, Looks};
use crate::terrain::{self, Gathered, HeldOut, Terrain};

/// Tiles about a block that are worked on with it.
const MARGIN: i32 = 1;

/// A scan by tiles; after [`Tiled::classify`] with the kind of every point.
pub(super) struct Tiled {
    scan: TiledScan,
    /// By tile and point.
    kinds: BTreeMap<Tile, Vec<Kind>>,
    is_normalised: bool,
    ground_points: usize,
    ground_intensity: Option<f32>,
}

impl Tiled {
    pub fn read(job: &SurveyJob, run: &mut Recorder) -> Result<Tiled> {
        run.stage("scan", |warnings| {
            let scan = TiledScan::read(&job.scans, &READ)?.into_value(warnings);
            let points = scan.census.kept as usize;
            check_extent(job, &scan.bounds, points)?;
            let outcome = scan_outcome(&scan.census, scan.density_per_m2 as f32);
            let tiled = Tiled {
                scan,
                kinds: BTreeMap::new(),
                is_normalised: false,
                ground_points: 0,
                ground_intensity: None,
            };
            Ok((tiled, outcome))
        })
    }

    pub fn frame(&self) -> &Frame {
        &self.scan.frame
    }

    /// Of all points, local metres.
    pub fn bounds(&self) -> Bounds {
        self.scan.bounds
    }

    /// All points in one piece, once their kinds are known.
    pub fn into_whole(self) -> Result<Whole> {
        let tiles: Vec<Tile> = self.kinds.keys().copied().collect();
        let Window { cloud, tiles } = self.scan.load(&tiles, 0)?;
        let kinds = tiles.iter().filter_map(|(tile, _)| self.kinds.get(tile)).flatten();
        let classified =
            Classified { cloud, kind: kinds.copied().collect(), is_normalised: self.is_normalised };
        let density_per_m2 = self.scan.density_per_m2 as f32;
        Ok(Whole { classified, density_per_m2, bounds: self.scan.bounds })
    }

    /// Finds the kind of every point.
    pub fn classify(
        mut self,
        job: &SurveyJob,
        tiles_a_side: i32,
        run: &mut Recorder,
    ) -> Result<Tiled> {
        run.stage("ground", |warnings| {
            if job.ground == Method::VoxelRules {
                warnings.push(
                    "the voxel rules look at one tile at a time: a few trees differ from those of \
                     the scan in one piece"
                        .into(),
                );
            }
            let blocks = self.scan.blocks(tiles_a_side);
            let mut floor = Floor::default();
            for core in &blocks {
                floor.add(Floor::of_piece(&self.scan.load(core, 0)?.cloud));
            }
            self.is_normalised = floor.is_zero();
            let mut intensity = GroundIntensity::default();
            let mut spread = Spread::default();
            for area in self.scan.blocks((ground::AREA_M / TILE_M) as i32) {
                let rule = self.learn(&area, job.ground, tiles_a_side)?;
                for core in blocks_of(&area, tiles_a_side) {
                    let Window { cloud, tiles } = self.scan.load(&core, 0)?;
                    let kind = rule.kinds(&cloud);
                    let ground = |i: &usize| kind[*i] == Kind::Ground;
                    for i in (0..cloud.len()).filter(ground) {
                        self.ground_points += 1;
                        intensity.add(cloud.intensity[i]);
                    }
                    for (tile, range) in tiles {
                        self.kinds.insert(tile, kind[range].to_vec());
                    }
                    let is_normalised = self.is_normalised;
                    spread.add(Spread::of(&Classified { cloud, kind, is_normalised }));
                }
            }
            warnings.extend(
                ground::check(job.ground, self.ground_points, self.is_normalised)
                    .map_err(|e| e.in_file(&job.scans[0]))?,
            );
            self.ground_intensity = intensity.median();
            let points = self.scan.census.kept as usize;
            let outcome = ground_outcome(points, self.ground_points, spread.rms_m())
                .note(format!("by tiles, in {} blocks", blocks.len()));
            Ok((self, outcome))
        })
    }

    /// What tells ground in an area, learned from it and what is about it.
    fn learn(&self, area: &[Tile], method: Method, tiles_a_side: i32) -> Result<Rule> {
        let mut lowest = Vec::new();
        // Return numbers may be wrong throughout.
        for of_all in [false, true] {
            if !Rule::looks_at_lowest(method) || !lowest.is_empty() {
                break;
            }
            let about = self.scan.about(area, (ground::AREA_MARGIN_M / TILE_M) as i32);
            for core in blocks_of(&about, tiles_a_side) {
                lowest.extend(ground::lowest(&self.scan.load(&core, 0)?.cloud, of_all));
            }
        }
        Ok(Rule::learn(&lowest, method, self.is_normalised))
    }

    /// A block with its surroundings.
    fn window(&self, core: &[Tile], margin: i32) -> Result<Classified> {
        let Window { cloud, tiles } = self.scan.load(core, margin)?;
        let kinds = tiles.iter().filter_map(|(tile, _)| self.kinds.get(tile));
        Ok(Classified {
            cloud,
            kind: kinds.flatten().copied().collect(),
            is_normalised: self.is_normalised,
        })
    }

    fn is_in(&self, core: &BTreeSet<Tile>, p: Vec3) -> bool {
        core.contains(&tile_of(self.frame().world_from_local(p) * self.frame().unit_m()))
    }

    pub fn terrain(
        &self,
        job: &SurveyJob,
        tiles_a_side: i32,
        run: &mut Recorder,
    ) -> Result<Terrain> {
        run.stage("terrain", |warnings| {
            let bounds = self.scan.bounds;
            let options = job.effort.terrain(job.cell_m);
            let extent_m = (bounds.max - bounds.min).truncate();
            let cell = options.cell_m.map_or_else(
                || terrain::choose_cell_m(extent_m, self.ground_points, options.cell_in_spacings),
                f64::from,
            );
            let geometry = terrain::grid_over(bounds.min, bounds.max, cell)?;
            let blocks = self.scan.blocks(tiles_a_side);
            let mut gathered = Gathered::over(geometry);
            let mut level = self.is_normalised.then(|| Terrain::level(geometry, self.frame()));
            let mut held_out = HeldOut::default();
            for core in &blocks {
                let ground = terrain::ground_points(&self.window(core, 0)?);
                if let Some(terrain) = level.take() {
                    level = Some(terrain.with_observed(&ground));
                    continue;
                }
                gathered.add(&ground);
                if let Some(of_block) = terrain::held_out_of(&ground, cell, self.ground_points)? {
                    held_out.add(of_block);
                }
            }
            let whole = level.map_or_else(|| gathered.terrain(), Ok)?;
            let one_in = looked_at(self.scan.census.kept as usize);
            let mut near = (0, 0);
            for core in &blocks {
                let (low, all) = whole.near(&self.window(core, 0)?, one_in);
                near = (near.0 + low, near.1 + all);
            }
            check_ground(job, near, self.is_normalised, &whole)?;
            if !self.is_normalised {
                warnings.extend(whole.warning());
            }
            let mut outcome =
                Outcome::items(self.ground_points, "ground points", geometry.len(), "cells")
                    .note(format!("cell {cell} m"));
            if held_out.points > 0 {
                outcome = with_held_out(outcome, held_out);
            }
            Ok((whole, outcome))
        })
    }

    /// The part of an extent that a block and its surroundings cover.
    fn part_in_window(&self, core: &[Tile], (low, high): Extent) -> Option<Extent> {
        let tiles = core.iter().map(|t| IVec2::from_array(*t));
        let (first, last) =
            tiles.fold((IVec2::MAX, IVec2::MIN), |(low, high), t| (low.min(t), high.max(t)));
        let corner = |tile: IVec2| {
            let world = (tile.as_dvec2() * TILE_M).extend(0.0) / self.frame().unit_m();
            self.frame().local_from_world(world).truncate()
        };
        let low = low.max(corner(first - MARGIN));
        let high = high.min(corner(last + 1 + MARGIN));
        low.cmple(high).all().then_some((low, high))
    }

    pub fn crowns(
        &self,
        job: &SurveyJob,
        tiles_a_side: i32,
        terrain: &Terrain,
        run: &mut Recorder,
    ) -> Result<(Vec<Crown>, Looks)> {
        run.stage("crown", |warnings| {
            let options = CrownOptions {
                cell_m: Some(crown::cell_m(self.scan.density_2_per_m2)),
                ..job.effort.crown(job.min_height_m)
            };
            let size_m = voxel_m(job, self.scan.density_per_m2 as f32);
            let mut kept: BTreeMap<u64, (Crown, Option<look::Look>)> = BTreeMap::new();
            let mut tally = Tally::default();
            let blocks = self.scan.blocks(tiles_a_side);
            let mut canopy = None;
            for core in &blocks {
                let own = self.window(core, 0)?;
                let extent = crown::canopy_extent(&own, terrain, options.min_height_m);
                canopy = crown::join_extents(canopy, extent);
            }
            for core in blocks {
                let window = self.window(&core, MARGIN)?;
                let extent = canopy.and_then(|canopy| self.part_in_window(&core, canopy));
                let core: BTreeSet<Tile> = core.into_iter().collect();
                let is_own = |p| self.is_in(&core, p);
                let found =
                    crown::detect_within(&window, terrain, size_m, &options, extent, is_own)?;
                tally.add(found.tally);
                let crowns = found.crowns;
                let looks = look::measure(&crowns, &window, terrain).of_crown;
                for (mut crown, look) in crowns.into_iter().zip(looks) {
                    // As within one window: the next key that is free.
                    while kept.contains_key(&crown.key) {
                        crown.key = crown.key.wrapping_add(1);
                    }
                    kept.insert(crown.key, (crown, look));
                }
            }
            let (crowns, of_crown): (Vec<Crown>, Vec<_>) = kept.into_values().unzip();
            let found = Found { crowns, tally };
            warnings.extend(found.warnings(options.min_height_m));
            let outcome = crown_outcome(&found, &options, size_m);
            let looks = Looks { of_crown, ground_intensity: self.ground_intensity };
            Ok(((found.crowns, looks), outcome))
        })
    }
}
