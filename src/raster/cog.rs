//! Cloud Optimized GeoTIFF (OGC 21-026): tiles, overviews, and every directory before the pixels,
//! so that a reader fetches only what it shows. Georeference after OGC 19-008r4.
//!
//! Written: classic TIFF, tiles of 256, deflate with the predictor of its kind (TIFF 6.0 section
//! 14; for floats Adobe's TIFF Technical Note 3), overviews by averages of 2 × 2 down to one tile.
//! Files begin with the directories, largest picture first; the pixels follow, smallest first.
//!
//! Limits: 4 GB; a system without an EPSG code is carried as its WKT, as ESRI and GDAL do.

use std::io::Write as _;

use flate2::Compression;
use flate2::write::ZlibEncoder;
use rayon::prelude::*;

use super::GridGeometry;
use crate::diagnostic::{Error, Result};
use crate::frame::Crs;

/// Side of a tile in pixels, a multiple of 16.
const TILE: usize = 256;

/// What a band's values are stored as.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    U8,
    U16,
    F32,
}

impl Kind {
    fn bytes(self) -> usize {
        match self {
            Kind::U8 => 1,
            Kind::U16 => 2,
            Kind::F32 => 4,
        }
    }
}

/// A raster to be written.
pub struct Sheet<'a> {
    pub width: usize,
    pub height: usize,
    /// 1 grey, 3 red, green and blue, 4 with alpha.
    pub bands: usize,
    pub kind: Kind,
    /// World units.
    pub geometry: Option<GridGeometry>,
    pub crs: Option<&'a Crs>,
    /// Stands for a value that is not finite, too.
    pub nodata: Option<f64>,
    /// Name of the values' unit.
    pub unit: Option<&'a str>,
    /// Value at column, row and band.
    pub value: &'a (dyn Fn(usize, usize, usize) -> f32 + Sync),
}

/// The bytes of a file. Beside them a quarter of the raster is held.
///
/// # Errors
/// No pixels, bands other than 1, 3 or 4, or more than 4 GB.
pub fn encode(sheet: &Sheet<'_>) -> Result<Vec<u8>> {
    if sheet.width == 0 || sheet.height == 0 || ![1, 3, 4].contains(&sheet.bands) {
        return Err(Error::new(format!(
            "a raster of {} × {} pixels in {} bands cannot be written",
            sheet.width, sheet.height, sheet.bands
        )));
    }
    let mut levels = vec![pack(sheet, sheet.width, sheet.height, sheet.value)?];
    let mut overview = halve(sheet, sheet.width, sheet.height, sheet.value);
    while levels.last().is_some_and(|level| level.width.max(level.height) > TILE) {
        let (width, height, data) = overview;
        let value = |col: usize, row: usize, band: usize| {
            data.get((row * width + col) * sheet.bands + band).copied().unwrap_or(f32::NAN)
        };
        levels.push(pack(sheet, width, height, &value)?);
        overview = halve(sheet, width, height, &value);
    }
    assemble(sheet, &levels)
}

/// One picture of the file, its tiles packed.
struct Level {
    width: usize,
    height: usize,
    tiles: Vec<Vec<u8>>,
}

type Values<'a> = dyn Fn(usize, usize, usize) -> f32 + Sync + 'a;

/// A picture of half the size: the average of each 2 × 2 pixels that hold data. Nothing where the
/// picture fits a tile.
fn halve(
    sheet: &Sheet<'_>,
    width: usize,
    height: usize,
    value: &Values<'_>,
) -> (usize, usize, Vec<f32>) {
    if width.max(height) <= TILE {
        return (0, 0, Vec::new());
    }
    let (half_width, half_height) = (width.div_ceil(2), height.div_ceil(2));
    let nodata = sheet.nodata.map(|n| n as f32);
    let mut data = vec![f32::NAN; half_width * half_height * sheet.bands];
    data.par_chunks_mut(half_width * sheet.bands).enumerate().for_each(|(row, line)| {
        for (i, slot) in line.iter_mut().enumerate() {
            let (col, band) = (i / sheet.bands, i % sheet.bands);
            let (mut sum, mut count) = (0.0f64, 0u32);
            for (y, x) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
                let (x, y) = (2 * col + x, 2 * row + y);
                if x < width && y < height {
                    let v = value(x, y, band);
                    if v.is_finite() && Some(v) != nodata {
                        sum += f64::from(v);
                        count += 1;
                    }
                }
            }
            if count > 0 {
                *slot = (sum / f64::from(count)) as f32;
            }
        }
    });
    (half_width, half_height, data)
}

fn pack(sheet: &Sheet<'_>, width: usize, height: usize, value: &Values<'_>) -> Result<Level> {
    let across = width.div_ceil(TILE);
    let tiles = (0..across * height.div_ceil(TILE))
        .into_par_iter()
        .map(|number| {
            let (left, top) = (number % across * TILE, number / across * TILE);
            let mut bytes = Vec::with_capacity(TILE * TILE * sheet.bands * sheet.kind.bytes());
            let mut line = vec![0.0f32; TILE * sheet.bands];
            for y in 0..TILE {
                for (i, slot) in line.iter_mut().enumerate() {
                    // Past the edge the last pixel goes on, which packs best.
                    let col = (left + i / sheet.bands).min(width - 1);
                    let row = (top + y).min(height - 1);
                    let v = value(col, row, i % sheet.bands);
                    *slot = match sheet.nodata {
                        Some(nodata) if !v.is_finite() => nodata as f32,
                        _ => v,
                    };
                }
                push_line(&mut bytes, &line, sheet.kind, sheet.bands);
            }
            let mut encoder = ZlibEncoder::new(Vec::new(), Compression::default());
            encoder.write_all(&bytes)?;
            encoder.finish()
        })
        .collect::<std::io::Result<Vec<_>>>()
        .map_err(|e| Error::new(format!("a raster cannot be packed: {e}")))?;
    Ok(Level { width, height, tiles })
}

/// One line of a tile after its predictor.
fn push_line(bytes: &mut Vec<u8>, line: &[f32], kind: Kind, bands: usize) {
    let start = bytes.len();
    match kind {
        Kind::U8 => {
            bytes.extend(line.iter().map(|v| v.round() as u8));
            let line = &mut bytes[start..];
            for i in (bands..line.len()).rev() {
                line[i] = line[i].wrapping_sub(line[i - bands]);
            }
        }
        Kind::U16 => {
            let line: Vec<u16> = line.iter().map(|v| v.round() as u16).collect();
            bytes.extend(line.iter().enumerate().flat_map(|(i, v)| {
                let before = i.checked_sub(bands).and_then(|i| line.get(i)).copied().unwrap_or(0);
                v.wrapping_sub(before).to_le_bytes()
            }));
        }
        Kind::F32 => {
            // The greatest bytes of all values first, whatever the order of the file.
            for plane in 0..4 {
                bytes.extend(line.iter().map(|v| v.to_be_bytes()[plane]));
            }
            let line = &mut bytes[start..];
            for i in (bands..line.len()).rev() {
                line[i] = line[i].wrapping_sub(line[i - bands]);
            }
        }
    }
}

/// A field of a directory.
enum Field {
    Shorts(Vec<u16>),
    Longs(Vec<u32>),
    Doubles(Vec<f64>),
    Text(String),
}

impl Field {
    /// Type, count and bytes.
    fn parts(&self) -> (u16, usize, Vec<u8>) {
        match self {
            Field::Shorts(v) => (3, v.len(), v.iter().flat_map(|v| v.to_le_bytes()).collect()),
            Field::Longs(v) => (4, v.len(), v.iter().flat_map(|v| v.to_le_bytes()).collect()),
            Field::Doubles(v) => (12, v.len(), v.iter().flat_map(|v| v.to_le_bytes()).collect()),
            Field::Text(text) => (2, text.len() + 1, [text.as_bytes(), &[0]].concat()),
        }
    }
}

const TILE_OFFSETS: u16 = 324;

/// The fields of a picture, in the order of their tags; tile offsets are still 0.
fn fields(sheet: &Sheet<'_>, level: &Level, is_overview: bool) -> Vec<(u16, Field)> {
    use Field::{Doubles, Longs, Shorts, Text};
    let bits = 8 * sheet.kind.bytes() as u16;
    let (format, predictor) = match sheet.kind {
        Kind::F32 => (3, 3),
        Kind::U8 | Kind::U16 => (1, 2),
    };
    let mut fields = vec![
        (254, Longs(vec![u32::from(is_overview)])),
        (256, Longs(vec![level.width as u32])),
        (257, Longs(vec![level.height as u32])),
        (258, Shorts(vec![bits; sheet.bands])),
        (259, Shorts(vec![8])),
        (262, Shorts(vec![if sheet.bands >= 3 { 2 } else { 1 }])),
        (277, Shorts(vec![sheet.bands as u16])),
        (284, Shorts(vec![1])),
        (317, Shorts(vec![predictor])),
        (322, Shorts(vec![TILE as u16])),
        (323, Shorts(vec![TILE as u16])),
        (TILE_OFFSETS, Longs(vec![0; level.tiles.len()])),
        (325, Longs(level.tiles.iter().map(|tile| tile.len() as u32).collect())),
    ];
    if sheet.bands == 4 {
        fields.push((338, Shorts(vec![2])));
    }
    fields.push((339, Shorts(vec![format; sheet.bands])));
    if let (false, Some(g)) = (is_overview, &sheet.geometry) {
        fields.push((33550, Doubles(vec![g.cell_x, g.cell_y, 0.0])));
        fields.push((33922, Doubles(vec![0.0, 0.0, 0.0, g.west, g.north, 0.0])));
        // Of keys without a system readers make one of their own, in which nothing can be placed.
        if let Some(crs) = sheet.crs {
            let (keys, text) = geo_keys(crs);
            fields.push((34735, Shorts(keys)));
            if !text.is_empty() {
                fields.push((34737, Text(text)));
            }
        }
    }
    if let (false, Some(unit)) = (is_overview, sheet.unit.filter(|unit| !unit.is_empty())) {
        let text = format!(
            "<GDALMetadata>\n  <Item name=\"UNITTYPE\" sample=\"0\" role=\"unittype\">{unit}\
             </Item>\n</GDALMetadata>\n"
        );
        fields.push((42112, Text(text)));
    }
    if let Some(nodata) = sheet.nodata {
        fields.push((42113, Text(nodata.to_string())));
    }
    fields
}

/// The key directory, "pixel is area", and the text it points to.
fn geo_keys(crs: &Crs) -> (Vec<u16>, String) {
    const USER_DEFINED: u16 = 32767;
    let mut text = String::new();
    let code = crs.epsg.and_then(|code| u16::try_from(code).ok());
    let wkt = if code.is_none() { crs.wkt.as_deref() } else { None };
    let mut keys: Vec<[u16; 4]> = vec![
        // Only in a model that is neither projected nor geographic do readers look for a text.
        [1024, 0, 1, if wkt.is_some() { USER_DEFINED } else { 1 }],
        [1025, 0, 1, 1],
        [3072, 0, 1, code.unwrap_or(USER_DEFINED)],
    ];
    if let Some(wkt) = wkt {
        // A bar ends a text of this field.
        text = format!("ESRI PE String = {}|", wkt.replace('|', " "));
        keys.push([3073, 34737, u16::try_from(text.len()).unwrap_or(u16::MAX), 0]);
    }
    let is_unit = |m: f64| (crs.horizontal_unit_m - m).abs() < 1e-9;
    let unit = [(1.0, 9001), (0.3048, 9002), (1200.0 / 3937.0, 9003)]
        .into_iter()
        .find(|(m, _)| is_unit(*m));
    if let Some((_, code)) = unit {
        keys.push([3076, 0, 1, code]);
    }
    let mut flat = vec![1, 1, 0, keys.len() as u16];
    flat.extend(keys.iter().flatten());
    (flat, text)
}

fn assemble(sheet: &Sheet<'_>, levels: &[Level]) -> Result<Vec<u8>> {
    let mut directories: Vec<Vec<(u16, Field)>> =
        levels.iter().enumerate().map(|(i, level)| fields(sheet, level, i > 0)).collect();
    // Each directory with its values behind it, one behind the other from byte 8 on.
    let size = |directory: &[(u16, Field)]| {
        let values = directory.iter().map(|(_, field)| field.parts().2.len());
        2 + 12 * directory.len()
            + 4
            + values.map(|n| if n > 4 { n.next_multiple_of(2) } else { 0 }).sum::<usize>()
    };
    let starts: Vec<usize> = directories
        .iter()
        .scan(8, |at, directory| {
            let start = *at;
            *at += size(directory);
            Some(start)
        })
        .collect();
    let mut at: usize = 8 + directories.iter().map(|directory| size(directory)).sum::<usize>();
    for (level, directory) in levels.iter().zip(&mut directories).rev() {
        let mut offsets = Vec::with_capacity(level.tiles.len());
        for tile in &level.tiles {
            offsets.push(u32::try_from(at).map_err(|_| too_large())?);
            at += tile.len();
        }
        for (tag, field) in directory {
            if *tag == TILE_OFFSETS {
                *field = Field::Longs(std::mem::take(&mut offsets));
            }
        }
    }
    if u32::try_from(at).is_err() {
        return Err(too_large());
    }
    let mut out = Vec::with_capacity(at);
    out.extend(b"II*\0");
    out.extend(8u32.to_le_bytes());
    for (i, directory) in directories.iter().enumerate() {
        let mut values_at = starts[i] + 2 + 12 * directory.len() + 4;
        let mut values = Vec::new();
        out.extend((directory.len() as u16).to_le_bytes());
        for (tag, field) in directory {
            let (kind, count, mut bytes) = field.parts();
            out.extend(tag.to_le_bytes());
            out.extend(kind.to_le_bytes());
            out.extend((count as u32).to_le_bytes());
            if bytes.len() <= 4 {
                bytes.resize(4, 0);
                out.extend(bytes);
            } else {
                bytes.resize(bytes.len().next_multiple_of(2), 0);
                out.extend((values_at as u32).to_le_bytes());
                values_at += bytes.len();
                values.extend(bytes);
            }
        }
        let next = starts.get(i + 1).copied().unwrap_or(0);
        out.extend((next as u32).to_le_bytes());
        out.extend(values);
    }
    for level in levels.iter().rev() {
        level.tiles.iter().for_each(|tile| out.extend(tile));
    }
    Ok(out)
}

fn too_large() -> Error {
    Error::new("the raster is larger than the 4 GB of a TIFF").remedy("choose a larger cell")
}

#[cfg(test)]
mod tests {
    use super::super::geotiff;
    use super::*;

    fn heights(col: usize, row: usize) -> f32 {
        100.0 + (col as f32 * 0.37).sin() * 9.0 + row as f32 * 0.01
    }

    fn sheet<'a>(width: usize, height: usize, crs: &'a Crs, value: &'a Values<'a>) -> Sheet<'a> {
        Sheet {
            width,
            height,
            bands: 1,
            kind: Kind::F32,
            geometry: Some(GridGeometry {
                west: 500_000.25,
                north: 6_200_000.5,
                cell_x: 0.5,
                cell_y: 0.5,
                cols: width,
                rows: height,
            }),
            crs: Some(crs),
            nodata: Some(-9999.0),
            unit: Some("metre"),
            value,
        }
    }

    #[test]
    fn every_height_comes_back() {
        let crs = Crs::from_epsg(32646);
        for (width, height) in [(1, 1), (256, 256), (257, 3), (700, 1100)] {
            let value = |col: usize, row: usize, _| {
                if (col, row) == (2, 1) { f32::NAN } else { heights(col, row) }
            };
            let sheet = sheet(width, height, &crs, &value);
            let bytes = encode(&sheet).unwrap();
            assert_eq!(bytes, encode(&sheet).unwrap());
            let back = geotiff::from_bytes(&bytes).unwrap();
            assert_eq!((back.width, back.height, back.bands), (width, height, 1));
            assert_eq!((back.geometry, back.epsg), (sheet.geometry, Some(32646)));
            assert_eq!(back.nodata, Some(-9999.0));
            for row in 0..height {
                for col in 0..width {
                    let expected = value(col, row, 0);
                    let expected = if expected.is_nan() { -9999.0 } else { expected };
                    assert_eq!(back.value(col, row, 0), expected);
                }
            }
        }
    }

    #[test]
    fn directories_come_first_and_the_smallest_picture_after_them() {
        let crs = Crs::from_epsg(32646);
        let value = |col: usize, row: usize, _: usize| heights(col, row);
        let bytes = encode(&sheet(1100, 600, &crs, &value)).unwrap();
        let u16_at = |at: usize| usize::from(u16::from_le_bytes([bytes[at], bytes[at + 1]]));
        let u32_at = |at: usize| {
            u32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]]) as usize
        };
        let (mut at, mut seen) = (u32_at(4), Vec::new());
        assert_eq!(at, 8);
        while at != 0 {
            let count = u16_at(at);
            let field = |tag: usize| {
                (0..count).map(|i| at + 2 + 12 * i).find(|f| u16_at(*f) == tag).unwrap()
            };
            let tiles = u32_at(field(324) + 4);
            let place = u32_at(field(324) + 8);
            let first = if tiles == 1 { place } else { u32_at(place) };
            seen.push((u32_at(field(256) + 8), u32_at(field(257) + 8), first));
            let tags: Vec<usize> = (0..count).map(|i| u16_at(at + 2 + 12 * i)).collect();
            assert!(tags.is_sorted(), "{tags:?}");
            at = u32_at(at + 2 + 12 * count);
        }
        let sizes: Vec<(usize, usize)> = seen.iter().map(|(w, h, _)| (*w, *h)).collect();
        assert_eq!(sizes, [(1100, 600), (550, 300), (275, 150), (138, 75)]);
        assert!(seen.windows(2).all(|pair| pair[0].2 > pair[1].2), "{seen:?}");
    }

    #[test]
    fn without_a_coordinate_system_none_is_hinted_at() {
        let crs = Crs::from_epsg(32646);
        let value = |col: usize, row: usize, _: usize| heights(col, row);
        let sheet = Sheet { crs: None, ..sheet(30, 20, &crs, &value) };
        let level = Level { width: 30, height: 20, tiles: Vec::new() };
        let tags: Vec<u16> = fields(&sheet, &level, false).iter().map(|(tag, _)| *tag).collect();
        assert!(tags.contains(&33922) && !tags.contains(&34735), "{tags:?}");
        let back = geotiff::from_bytes(&encode(&sheet).unwrap()).unwrap();
        assert_eq!((back.geometry, back.epsg), (sheet.geometry, None));
    }
}
