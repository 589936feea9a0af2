//! Scans larger than memory: points by square tiles of the world. What does not fit into a bounded
//! store in memory waits in an unnamed temporary file; a window of a few tiles is read back at a
//! time.
//!
//! Tiles are aligned to multiples of their side in world metres, and a point's tile follows from the
//! point alone, so that the same points make the same tiles however they are cut into files.
//! Limits: points of plain text files stay in memory; one point that is very far above or below the
//! rest makes the scan refused, where read whole it would be dropped as isolated.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::File;
use std::io::{Read, Seek, SeekFrom, Write};
use std::ops::Range;

use glam::{DVec2, DVec3, IVec2, Vec3};

use super::las_file::{self, Batch};
use super::merge::{self, Format, Strays};
use super::part::{ColourScale, Columns, Coordinates, Part};
use super::shared::Sample;
use super::{Bounds, Census, Files, PointCloud, ReadOptions, isolated, text};
use crate::diagnostic::{Error, Result, Warned};
use crate::frame::{Crs, Frame};

/// Side of a tile, world metres.
pub const TILE_M: f64 = 64.0;
/// Squares of 1 m along a tile's side.
const SIDE: usize = TILE_M as usize;
const LAST: IVec2 = IVec2::splat(SIDE as i32 - 1);
/// Tiles along the side of the blocks in which isolated points are looked for.
const ISOLATED_BLOCK: i32 = 6;
/// Bytes of points in memory before they go to the temporary file.
const HELD_BYTES: usize = 512 << 20;

/// Indices of a tile: its south-western corner over [`TILE_M`].
pub type Tile = [i32; 2];

/// Points of one file in one tile, where they wait.
enum Piece {
    Held(Batch),
    Spilled { at: u64, points: usize, has_colour: bool, scale: DVec3, offset: DVec3 },
}

impl Piece {
    fn points(&self) -> usize {
        match self {
            Piece::Held(batch) => batch.coordinates.len(),
            Piece::Spilled { points, .. } => *points,
        }
    }
}

#[derive(Default)]
struct Stack {
    /// With the number of the file.
    pieces: Vec<(usize, Piece)>,
    /// Numbers of the isolated points, rising.
    isolated: Vec<u32>,
}

/// A scan by tiles.
pub struct TiledScan {
    pub frame: Frame,
    pub census: Census,
    /// Points per occupied square of 1 m.
    pub density_per_m2: f64,
    /// The same over squares of 2 m.
    pub density_2_per_m2: f64,
    pub bounds: Bounds,
    tiles: BTreeMap<Tile, Stack>,
    spill: Spill,
    colours: Vec<ColourScale>,
    keeps_colour: bool,
}

/// The points of a window in the order of its tiles, and where each tile's points are among them.
pub struct Window {
    pub cloud: PointCloud,
    /// With the range of its points; in order.
    pub tiles: Vec<(Tile, Range<usize>)>,
}

impl TiledScan {
    /// Reads all files.
    ///
    /// # Errors
    /// Those of [`super::read`]; no room for the temporary file.
    pub fn read(files: impl Into<Files>, options: &ReadOptions) -> Result<Warned<TiledScan>> {
        Self::read_within(HELD_BYTES, &files.into(), options)
    }

    fn read_within(
        held_bytes: usize,
        files: &Files,
        options: &ReadOptions,
    ) -> Result<Warned<TiledScan>> {
        let mut warnings = Vec::new();
        match Self::read_inner(held_bytes, files, options, &mut warnings) {
            Ok(scan) => Ok(Warned::with(scan, warnings)),
            Err(error) => Err(error.noticed(warnings)),
        }
    }

    fn read_inner(
        held_bytes: usize,
        files: &Files,
        options: &ReadOptions,
        warnings: &mut Vec<String>,
    ) -> Result<TiledScan> {
        let paths = &files.paths[..];
        let formats = merge::formats(paths)?;
        let mut tiles: BTreeMap<Tile, Stack> = BTreeMap::new();
        let mut spill = Spill::default();
        let mut parts: Vec<Part> = Vec::with_capacity(paths.len());
        let mut sample = Sample::default();
        for (number, (path, format)) in paths.iter().zip(formats).enumerate() {
            let mut take = |crs: Option<&Crs>, batch: Batch| -> Result<()> {
                let unit_m = unit_m(crs);
                sample.add(number, &batch.coordinates, &batch.columns);
                spill.held += bytes_of(&batch);
                for (tile, batch) in by_tile(batch, unit_m) {
                    let stack = tiles.entry(tile).or_default();
                    stack.add(number, batch);
                }
                if spill.held > held_bytes {
                    spill.all(&mut tiles)?;
                }
                Ok(())
            };
            let part = match format {
                Format::Las => las_file::read(path, options, &files.crs, Some(&mut take))?,
                Format::Text => {
                    let mut part = text::read(path, &files.crs)?;
                    let none = Coordinates::Real(Vec::new());
                    let coordinates = std::mem::replace(&mut part.coordinates, none);
                    let columns = std::mem::take(&mut part.columns);
                    take(part.crs.as_ref(), Batch { coordinates, columns })?;
                    part
                }
            };
            merge::refuse(&parts, &part)?;
            parts.push(part);
        }
        sample.tell(paths, warnings);
        merge::refuse_no_points(&parts)?;
        let mut census = merge::census(&parts, warnings);
        let mut strays = Strays::default();
        if options.drop_isolated && merge::span_too_much(&parts) {
            census.removed.isolated += drop_far_tiles(&mut tiles, &mut parts, &spill, &mut strays)?;
        }
        let (frame, _) = merge::frame(paths, &parts, &census, options)?;
        let colours: Vec<ColourScale> = parts.iter().map(|p| p.colour).collect();
        let keeps_colour = merge::keeps_colour(&parts, warnings);
        let mut scan = TiledScan {
            census,
            density_per_m2: 0.0,
            density_2_per_m2: 0.0,
            bounds: Bounds { min: Vec3::ZERO, max: Vec3::ZERO },
            frame,
            tiles,
            spill,
            colours,
            keeps_colour,
        };
        scan.survey()?;
        if options.drop_isolated {
            scan.drop_isolated(&mut strays)?;
            merge::tell_isolated(paths, &scan.census, warnings)?;
            scan.survey()?;
            for part in &mut parts {
                part.bounds = None;
            }
            let unit_m = scan.frame.unit_m();
            let ends = [scan.bounds.min, scan.bounds.max];
            let [low, high] = ends.map(|p| scan.frame.world_from_local(p) * unit_m);
            if let Some(first) = parts.first_mut() {
                first.bounds = Some((low / unit_m, high / unit_m));
            }
            let bounds_m;
            (scan.frame, bounds_m) = merge::frame(paths, &parts, &scan.census, options)?;
            strays.tell(paths, bounds_m, unit_m, warnings);
            scan.survey()?;
        }
        Ok(scan)
    }

    /// Bounds, densities and the number of points that are kept.
    fn survey(&mut self) -> Result<()> {
        let (mut low, mut high) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
        let (mut kept, mut squares, mut squares_2) = (0u64, 0u64, 0u64);
        for tile in self.tiles.keys() {
            let cloud = self.load(std::slice::from_ref(tile), 0)?.cloud;
            kept += cloud.len() as u64;
            let corner = corner_m(&self.frame, *tile);
            let mut occupied = [0u64; SIDE];
            for p in &cloud.position {
                (low, high) = (low.min(*p), high.max(*p));
                let at = (*p - corner).truncate().as_ivec2().clamp(IVec2::ZERO, LAST);
                occupied[at.y as usize] |= 1 << at.x;
            }
            squares += occupied.iter().map(|row| u64::from(row.count_ones())).sum::<u64>();
            squares_2 += occupied
                .chunks(2)
                .map(|rows| {
                    let both = rows.iter().fold(0, |a, b| a | b);
                    u64::from(((both | both >> 1) & 0x5555_5555_5555_5555u64).count_ones())
                })
                .sum::<u64>();
        }
        self.census.kept = kept;
        self.bounds = Bounds { min: low, max: high };
        self.density_per_m2 = kept as f64 / squares.max(1) as f64;
        self.density_2_per_m2 = kept as f64 / (4 * squares_2.max(1)) as f64;
        Ok(())
    }

    /// Marks what has almost nothing around it; it is loaded no more.
    fn drop_isolated(&mut self, strays: &mut Strays) -> Result<()> {
        let mut isolated: BTreeMap<Tile, Vec<u32>> = BTreeMap::new();
        let mut places = Vec::new();
        for core in self.blocks(ISOLATED_BLOCK) {
            let Window { cloud, tiles } = self.load(&core, 1)?;
            let is_isolated = isolated::among(&cloud, self.density_per_m2);
            for (tile, range) in tiles.into_iter().filter(|(tile, _)| core.contains(tile)) {
                let out = range.clone().filter(|i| is_isolated[*i]).map(|i| cloud.position[i]);
                places.extend(out);
                let own = is_isolated[range].iter().zip(0u32..);
                isolated.insert(tile, own.filter(|(out, _)| **out).map(|(_, i)| i).collect());
            }
        }
        let frame = &self.frame;
        strays.add(places.iter().map(|p| frame.world_from_local(*p)), self.census.kept);
        for (tile, numbers) in isolated {
            self.census.removed.isolated += numbers.len() as u64;
            if let Some(stack) = self.tiles.get_mut(&tile) {
                stack.isolated = numbers;
            }
        }
        Ok(())
    }

    /// Squares of so many tiles' side that hold points, as the sets of their tiles; in order.
    pub fn blocks(&self, tiles_a_side: i32) -> Vec<Vec<Tile>> {
        blocks_of(self.tiles.keys(), tiles_a_side)
    }

    /// The tiles that hold points, of the given ones and of all within `margin` tiles of them.
    pub fn about(&self, core: &[Tile], margin: i32) -> BTreeSet<Tile> {
        let span = |i: i32| i - margin..=i + margin;
        let about = core.iter().flat_map(|[i, j]| span(*i).map(move |i| (i, *j)));
        let about = about.flat_map(|(i, j)| span(j).map(move |j| [i, j]));
        about.filter(|tile| self.tiles.contains_key(tile)).collect()
    }

    /// The points of the given tiles and of all within `margin` tiles of them.
    ///
    /// # Errors
    /// The temporary file can't be read.
    pub fn load(&self, core: &[Tile], margin: i32) -> Result<Window> {
        let mut cloud = PointCloud {
            frame: self.frame.clone(),
            position: Vec::new(),
            intensity: Vec::new(),
            return_number: Vec::new(),
            return_count: Vec::new(),
            class: Vec::new(),
            rgb: self.keeps_colour.then(Vec::new),
        };
        // Numbers of the isolated points, rising.
        let mut is_out: Vec<usize> = Vec::new();
        let mut ranges = Vec::new();
        for tile in self.about(core, margin) {
            let Some(stack) = self.tiles.get(&tile) else { continue };
            let (start, before) = (cloud.len(), is_out.len());
            for (file, piece) in &stack.pieces {
                let colour = self.colours.get(*file).copied().unwrap_or(ColourScale::None);
                match piece {
                    Piece::Held(batch) => {
                        append(&mut cloud, &batch.coordinates, &batch.columns, colour);
                    }
                    Piece::Spilled { .. } => {
                        let batch = self.spill.load(piece)?;
                        append(&mut cloud, &batch.coordinates, &batch.columns, colour);
                    }
                }
            }
            is_out.extend(stack.isolated.iter().map(|&i| start + i as usize));
            let dropped = is_out.len();
            ranges.push((tile, start - before..cloud.len() - dropped));
        }
        if !is_out.is_empty() {
            cloud.retain(|i| is_out.binary_search(&i).is_err());
        }
        Ok(Window { cloud, tiles: ranges })
    }
}

/// Squares of so many tiles' side, as the sets of those of the given tiles that lie in each; in
/// order.
pub fn blocks_of<'a>(
    tiles: impl IntoIterator<Item = &'a Tile>,
    tiles_a_side: i32,
) -> Vec<Vec<Tile>> {
    let mut blocks: BTreeMap<Tile, Vec<Tile>> = BTreeMap::new();
    for tile in tiles {
        blocks.entry(tile.map(|i| i.div_euclid(tiles_a_side.max(1)))).or_default().push(*tile);
    }
    blocks.into_values().collect()
}

/// Drops tiles far from the body of the scan where they hold few points; gives the number of these.
/// The parts get the bounds of the tiles that stay.
fn drop_far_tiles(
    tiles: &mut BTreeMap<Tile, Stack>,
    parts: &mut [Part],
    spill: &Spill,
    strays: &mut Strays,
) -> Result<u64> {
    let points =
        |stack: &Stack| stack.pieces.iter().map(|(_, piece)| piece.points()).sum::<usize>();
    let side = (isolated::BLOCK_M / TILE_M) as i64;
    let block = |[i, j]: &Tile| [i64::from(*i).div_euclid(side), i64::from(*j).div_euclid(side), 0];
    let mut blocks = isolated::Blocks::new();
    for (tile, stack) in tiles.iter() {
        *blocks.entry(block(tile)).or_default() += points(stack) as u64;
    }
    let Some(body) = isolated::body(&blocks) else { return Ok(0) };
    let far: Vec<Tile> = tiles.keys().filter(|t| !body.contains(&block(t))).copied().collect();
    let mut places = Vec::new();
    for (_, piece) in far.iter().filter_map(|tile| tiles.remove(tile)).flat_map(|s| s.pieces) {
        let batch = match piece {
            Piece::Held(batch) => batch,
            Piece::Spilled { .. } => spill.load(&piece)?,
        };
        places.extend((0..batch.coordinates.len()).filter_map(|i| batch.coordinates.get(i)));
    }
    strays.add(places.iter().copied(), blocks.values().sum());
    for (number, part) in parts.iter_mut().enumerate() {
        let unit_m = unit_m(part.crs.as_ref());
        let own = tiles.iter().filter(|(_, s)| s.pieces.iter().any(|(file, _)| *file == number));
        let corners = own.map(|([i, j], _)| DVec2::new(f64::from(*i), f64::from(*j)) * TILE_M);
        let ends = corners.map(|c| (c, c + TILE_M)).reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)));
        part.bounds = part.bounds.zip(ends).map(|((low, high), (a, b))| {
            (a.extend(low.z * unit_m.z) / unit_m, b.extend(high.z * unit_m.z) / unit_m)
        });
    }
    Ok(places.len() as u64)
}

fn unit_m(crs: Option<&Crs>) -> DVec3 {
    Frame { origin: DVec3::ZERO, crs: crs.cloned() }.unit_m()
}

/// Tiles from the world's origin; farther ones are one.
const FARTHEST: f64 = 1e9;

/// The tile of a world place in metres.
pub fn tile_of(world_m: DVec3) -> Tile {
    [world_m.x, world_m.y].map(|v| (v / TILE_M).floor().clamp(-FARTHEST, FARTHEST) as i32)
}

fn append(cloud: &mut PointCloud, from: &Coordinates, columns: &Columns, colour: ColourScale) {
    let frame = &cloud.frame;
    let places = (0..from.len()).filter_map(|i| from.get(i)).map(|p| frame.local_from_world(p));
    cloud.position.extend(places);
    cloud.intensity.extend_from_slice(&columns.intensity);
    cloud.return_number.extend_from_slice(&columns.return_number);
    cloud.return_count.extend_from_slice(&columns.return_count);
    cloud.class.extend_from_slice(&columns.class);
    if let Some(rgb) = &mut cloud.rgb {
        let mut own = columns.rgb.clone();
        colour.apply(&mut own);
        rgb.extend_from_slice(&own.unwrap_or_else(|| vec![[0; 3]; from.len()]));
    }
}

fn bytes_of(batch: &Batch) -> usize {
    let columns = 5 + if batch.columns.rgb.is_some() { 6 } else { 0 };
    let place = match batch.coordinates {
        Coordinates::Scaled { .. } => 12,
        Coordinates::Real(_) => 24,
    };
    batch.coordinates.len() * (place + columns)
}

/// A batch parted by tiles, the points of each in their order.
fn by_tile(batch: Batch, unit_m: DVec3) -> BTreeMap<Tile, Batch> {
    let mut out: BTreeMap<Tile, Vec<u32>> = BTreeMap::new();
    let n = batch.coordinates.len();
    let mut last: Option<(Tile, Vec<u32>)> = None;
    for (i, p) in (0..n as u32).filter_map(|i| Some((i, batch.coordinates.get(i as usize)?))) {
        let tile = tile_of(p * unit_m);
        match &mut last {
            Some((t, points)) if *t == tile => points.push(i),
            _ => {
                if let Some((t, points)) = last.take() {
                    out.insert(t, points);
                }
                let mut points = out.remove(&tile).unwrap_or_default();
                points.push(i);
                last = Some((tile, points));
            }
        }
    }
    out.extend(last);
    out.into_iter().map(|(tile, points)| (tile, batch.picked(&points))).collect()
}

fn picked<T: Copy>(column: &[T], points: &[u32]) -> Vec<T> {
    points.iter().filter_map(|&i| column.get(i as usize).copied()).collect()
}

impl Batch {
    fn picked(&self, points: &[u32]) -> Batch {
        let c = &self.columns;
        Batch {
            coordinates: match &self.coordinates {
                Coordinates::Scaled { steps, scale, offset } => Coordinates::Scaled {
                    steps: picked(steps, points),
                    scale: *scale,
                    offset: *offset,
                },
                Coordinates::Real(world) => Coordinates::Real(picked(world, points)),
            },
            columns: Columns {
                intensity: picked(&c.intensity, points),
                return_number: picked(&c.return_number, points),
                return_count: picked(&c.return_count, points),
                class: picked(&c.class, points),
                rgb: c.rgb.as_ref().map(|rgb| picked(rgb, points)),
            },
        }
    }
}

impl Stack {
    fn add(&mut self, file: usize, mut batch: Batch) {
        if let Some((last, Piece::Held(held))) = self.pieces.last_mut()
            && *last == file
            && held.coordinates.append(&mut batch.coordinates)
        {
            held.columns.append(&mut batch.columns);
            return;
        }
        self.pieces.push((file, Piece::Held(batch)));
    }
}

/// Points out of memory.
#[derive(Default)]
struct Spill {
    file: Option<File>,
    end: u64,
    /// Bytes of points still in memory.
    held: usize,
}

fn no_room(error: std::io::Error) -> Error {
    Error::new(format!("the points of a large scan can't be kept in a temporary file: {error}"))
        .remedy("set TMPDIR to a folder with room for the unpacked scan")
}

impl Spill {
    /// Moves all held points of LAS files to the file.
    fn all(&mut self, tiles: &mut BTreeMap<Tile, Stack>) -> Result<()> {
        let mut bytes = Vec::new();
        for (_, piece) in tiles.values_mut().flat_map(|s| &mut s.pieces) {
            let Piece::Held(batch) = piece else { continue };
            let Coordinates::Scaled { steps, scale, offset } = &batch.coordinates else { continue };
            bytes.clear();
            bytes.extend_from_slice(bytemuck::cast_slice(steps));
            let c = &batch.columns;
            bytes.extend_from_slice(bytemuck::cast_slice(&c.intensity));
            for column in [&c.return_number, &c.return_count, &c.class] {
                bytes.extend_from_slice(column);
            }
            bytes.extend_from_slice(bytemuck::cast_slice(c.rgb.as_deref().unwrap_or_default()));
            let file = match &mut self.file {
                Some(file) => file,
                none => none.insert(tempfile::tempfile().map_err(no_room)?),
            };
            file.write_all(&bytes).map_err(no_room)?;
            let (points, has_colour) = (steps.len(), c.rgb.is_some());
            let at = self.end;
            *piece = Piece::Spilled { at, points, has_colour, scale: *scale, offset: *offset };
            self.end += bytes.len() as u64;
        }
        self.held = 0;
        Ok(())
    }

    fn load(&self, piece: &Piece) -> Result<Batch> {
        let (&Piece::Spilled { at, points, has_colour, scale, offset }, Some(mut file)) =
            (piece, self.file.as_ref())
        else {
            return Err(Error::new("points were looked for where none were put"));
        };
        let record = 12 + 2 + 3 + if has_colour { 6 } else { 0 };
        let mut bytes = vec![0; points * record];
        file.seek(SeekFrom::Start(at)).map_err(no_room)?;
        file.read_exact(&mut bytes).map_err(no_room)?;
        let (steps, rest) = bytes.split_at(12 * points);
        let (intensity, rest) = rest.split_at(2 * points);
        let (return_number, rest) = rest.split_at(points);
        let (return_count, rest) = rest.split_at(points);
        let (class, rgb) = rest.split_at(points);
        Ok(Batch {
            coordinates: Coordinates::Scaled {
                steps: bytemuck::pod_collect_to_vec(steps),
                scale,
                offset,
            },
            columns: Columns {
                intensity: bytemuck::pod_collect_to_vec(intensity),
                return_number: return_number.to_vec(),
                return_count: return_count.to_vec(),
                class: class.to_vec(),
                rgb: has_colour.then(|| bytemuck::pod_collect_to_vec(rgb)),
            },
        })
    }
}

/// Local metres of a tile's south-western corner.
fn corner_m(frame: &Frame, tile: Tile) -> Vec3 {
    let world_m = DVec3::new(f64::from(tile[0]), f64::from(tile[1]), 0.0) * TILE_M;
    frame.local_from_world(world_m / frame.unit_m())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scan::encode_laz;
    use crate::seed::Seed;

    fn cloud(has_colour: bool) -> PointCloud {
        let mut d = Seed::new(6).draws();
        let n = 20_000;
        let position: Vec<Vec3> = (0..n)
            .map(|_| Vec3::new(d.between(0.0, 150.0), d.between(0.0, 90.0), d.between(0.0, 20.0)))
            .collect();
        PointCloud {
            frame: Frame::local(DVec3::new(500_030.0, 4_000_010.0, 0.0)),
            intensity: (0..n as u16).collect(),
            return_number: vec![1; n],
            return_count: (0..n).map(|i| 1 + (i % 3) as u8).collect(),
            class: (0..n).map(|i| (i % 5) as u8).collect(),
            rgb: has_colour.then(|| (0..n as u16).map(|i| [i, 1, 700]).collect()),
            position,
        }
    }

    /// Every column of a point, by its place.
    fn points(cloud: &PointCloud) -> Vec<[i64; 10]> {
        let mut all: Vec<[i64; 10]> = (0..cloud.len())
            .map(|i| {
                let world = cloud.frame.world_from_local(cloud.position[i]).to_array();
                let [x, y, z] = world.map(|v| (v * 1000.0).round() as i64);
                let [r, g, b] = cloud.rgb.as_ref().map_or([0; 3], |c| c[i]).map(i64::from);
                let flags = [cloud.return_number[i], cloud.return_count[i], cloud.class[i]];
                let [number, count, class] = flags.map(i64::from);
                [x, y, z, cloud.intensity[i].into(), number, count, class, r, g, b]
            })
            .collect();
        all.sort_unstable();
        all
    }

    #[test]
    fn points_come_back_from_memory_and_from_the_file_as_they_are_read_whole() {
        let dir = tempfile::tempdir().unwrap();
        for has_colour in [false, true] {
            let path = dir.path().join("scan.laz");
            std::fs::write(&path, encode_laz(&cloud(has_colour)).unwrap()).unwrap();
            let paths = [path];
            let options = ReadOptions::default();
            let whole = crate::scan::read(&paths, &options).unwrap().value;
            for held_bytes in [0, HELD_BYTES] {
                let tiled = TiledScan::read_within(held_bytes, &Files::from(&paths), &options)
                    .unwrap()
                    .value;
                assert_eq!(tiled.spill.file.is_some(), held_bytes == 0);
                assert_eq!(tiled.frame, whole.cloud.frame);
                assert_eq!(tiled.census, whole.census);
                assert!((tiled.density_per_m2 - f64::from(whole.density_per_m2)).abs() < 1e-3);
                let every: Vec<Tile> = tiled.tiles.keys().copied().collect();
                let window = tiled.load(&every, 0).unwrap();
                window.cloud.check().unwrap();
                assert_eq!(points(&window.cloud), points(&whole.cloud));
                let (tile, range) = window.tiles[1].clone();
                let alone = tiled.load(&[tile], 0).unwrap().cloud;
                assert_eq!(alone.position, window.cloud.position[range]);
            }
        }
    }

    #[test]
    fn a_point_very_far_away_is_dropped_as_isolated() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("scan.laz");
        let mut with_stray = cloud(false);
        with_stray.position[7] = Vec3::new(600_000.0, -3.0, 1.0);
        std::fs::write(&path, encode_laz(&with_stray).unwrap()).unwrap();
        let paths = [path];
        let whole = crate::scan::read(&paths, &ReadOptions::default()).unwrap().value;
        for held_bytes in [0, HELD_BYTES] {
            let options = ReadOptions::default();
            let tiled =
                TiledScan::read_within(held_bytes, &Files::from(&paths), &options).unwrap().value;
            assert_eq!(tiled.census.removed.isolated, 1);
            assert_eq!(tiled.census, whole.census);
            assert_eq!(tiled.frame, whole.cloud.frame);
        }
    }

    #[test]
    fn a_window_holds_its_tiles_and_those_about_them() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("scan.laz");
        std::fs::write(&path, encode_laz(&cloud(false)).unwrap()).unwrap();
        let tiled = TiledScan::read(&[path], &ReadOptions::default()).unwrap().value;
        let blocks = tiled.blocks(2);
        assert_eq!(blocks.iter().map(Vec::len).sum::<usize>(), tiled.tiles.len());
        let first = [blocks[0][0]];
        let window = tiled.load(&first, 1).unwrap();
        assert!(window.tiles.len() > 1 && window.tiles.iter().any(|(t, _)| *t == first[0]));
        for (tile, range) in &window.tiles {
            assert!((0..2).all(|k| (tile[k] - first[0][k]).abs() <= 1));
            for p in &window.cloud.position[range.clone()] {
                assert_eq!(tile_of(tiled.frame.world_from_local(*p)), *tile);
            }
        }
    }

    #[test]
    fn text_and_laz_lie_in_one_set_of_tiles() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.xyz");
        let line = |i: i32| format!("{} {} {}\n", 100 + i % 40, 200 + i / 40, i % 7);
        std::fs::write(&path, (0..1600).map(line).collect::<String>()).unwrap();
        let whole =
            crate::scan::read(std::slice::from_ref(&path), &ReadOptions::default()).unwrap().value;
        let tiled = TiledScan::read(&[path], &ReadOptions::default()).unwrap().value;
        let every: Vec<Tile> = tiled.tiles.keys().copied().collect();
        assert_eq!(points(&tiled.load(&every, 0).unwrap().cloud), points(&whole.cloud));
    }
}
