//! GeoTIFF reading (OGC GeoTIFF 1.1 tags by hand over the `tiff` crate).
//!
//! Read: 8, 16 and 32-bit integer and 32/64-bit float samples, any number of interleaved or planar
//! bands, strips or tiles, uncompressed, LZW, deflate, PackBits or JPEG, the latter also of
//! luminance and chrominance. Numbers of 8 or 16 bits into a palette become its colours, and where 0 is
//! white, values are turned round. A pixel that its alpha band hides is black. A rotated raster is
//! refused, and so are other packings and samples of less than 8 bits. Written: as [`cog`] says.

use std::fs::File;
use std::io::{BufReader, Cursor, Read, Seek};
use std::path::Path;

use tiff::decoder::{ChunkType, Decoder, DecodingResult, Limits};
use tiff::tags::Tag;

use super::{GridGeometry, chunks, cog};
use crate::diagnostic::{Error, Result};
use crate::frame::Crs;

const KEY_MODEL_TYPE: u16 = 1024;
const KEY_RASTER_TYPE: u16 = 1025;
const KEY_GEODETIC_CRS: u16 = 2048;
const KEY_PROJECTED_CRS: u16 = 3072;
const MODEL_IS_GEOGRAPHIC: u16 = 2;
const PIXEL_IS_POINT: u16 = 2;

/// Pixel values as the file has them, interleaved by pixel; floats beyond ±1e30 are NaN.
#[derive(Debug, Clone, PartialEq)]
pub enum Samples {
    U8(Vec<u8>),
    U16(Vec<u16>),
    F32(Vec<f32>),
}

impl Samples {
    pub fn len(&self) -> usize {
        match self {
            Samples::U8(v) => v.len(),
            Samples::U16(v) => v.len(),
            Samples::F32(v) => v.len(),
        }
    }

    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

/// A raster as read: any number of bands, with its place in world units where the file has one.
#[derive(Debug, Clone, PartialEq)]
pub struct Raster {
    pub width: usize,
    pub height: usize,
    pub bands: usize,
    /// `width * height * bands` values.
    pub samples: Samples,
    /// `None` where the file has no georeference.
    pub geometry: Option<GridGeometry>,
    /// Of the projected system, or of the geographic one where the file counts degrees.
    pub epsg: Option<u32>,
    pub nodata: Option<f64>,
}

impl Raster {
    /// Value of a band at a pixel.
    pub fn value(&self, col: usize, row: usize, band: usize) -> f32 {
        let i = (row * self.width + col) * self.bands + band;
        match &self.samples {
            Samples::U8(v) => f32::from(v[i]),
            Samples::U16(v) => f32::from(v[i]),
            Samples::F32(v) => v[i],
        }
    }
}

/// Reads the first image of a GeoTIFF file.
///
/// # Errors
/// Names the file: missing, not a TIFF, cut short, rotated, or of a sample type not listed above.
pub fn read(path: &Path) -> Result<Raster> {
    let file = File::open(path).map_err(|e| {
        Error::new(format!("cannot be opened: {e}"))
            .in_file(path)
            .remedy("check the path of the photo or raster")
    })?;
    let size = file.metadata().map(|m| m.len()).unwrap_or(0);
    decode(BufReader::new(file), size).map_err(|e| e.in_file(path))
}

/// Reads GeoTIFF bytes.
pub fn from_bytes(bytes: &[u8]) -> Result<Raster> {
    decode(Cursor::new(bytes), bytes.len() as u64)
}

fn decode<R: Read + Seek>(reader: R, file_bytes: u64) -> Result<Raster> {
    let broken = |e: tiff::TiffError| {
        Error::new(format!("not a readable TIFF: {e}"))
            .remedy("give a complete GeoTIFF; `gdal_translate in.tif out.tif` rewrites odd ones")
    };
    let mut decoder = Decoder::new(reader).map_err(broken)?;
    let (width, height) = decoder.dimensions().map_err(broken)?;
    let (width, height) = (width as usize, height as usize);
    let bands = usize::from(
        decoder.find_tag_unsigned::<u16>(Tag::SamplesPerPixel).map_err(broken)?.unwrap_or(1),
    );
    let photometric = number(&mut decoder, Tag::PhotometricInterpretation, 1).map_err(broken)?;
    refuse_packing(number(&mut decoder, Tag::Compression, 1).map_err(broken)?)?;
    refuse_bits(number(&mut decoder, Tag::BitsPerSample, 1).map_err(broken)?, photometric)?;
    let values = width.checked_mul(height).and_then(|n| n.checked_mul(bands)).unwrap_or(usize::MAX);
    // Deflate cannot pack more than about 1:1032; a header that claims more is not believed.
    if values == 0 || values as u64 > file_bytes.saturating_mul(1100).max(1 << 16) {
        return Err(Error::new(format!(
            "the TIFF header claims {width} × {height} pixels of {bands} bands, which the file cannot hold"
        ))
        .remedy("the file is damaged or cut short; fetch it again"));
    }
    // The decoder takes room for a whole tile or strip.
    let (chunk_width, chunk_height) = decoder.chunk_dimensions();
    let in_chunk = u64::from(chunk_width) * u64::from(chunk_height);
    let believed = (values as u64).saturating_mul(4).saturating_add(1 << 24);
    let is_strip = decoder.get_chunk_type() == ChunkType::Strip;
    if in_chunk == 0 || (!is_strip && in_chunk.saturating_mul(bands as u64) > believed) {
        return Err(Error::new(format!(
            "the TIFF header claims tiles of {chunk_width} × {chunk_height} pixels in a picture of \
             {width} × {height}"
        ))
        .remedy("the file is damaged; fetch it again"));
    }
    let mut limits = Limits::default();
    limits.decoding_buffer_size = usize::try_from(believed.saturating_mul(8)).unwrap_or(usize::MAX);
    limits.intermediate_buffer_size = limits.decoding_buffer_size;
    limits.ifd_value_size = usize::try_from(file_bytes).unwrap_or(usize::MAX);
    let mut decoder = decoder.with_limits(limits);
    let geometry = georeference(&mut decoder, width, height)?;
    let is_geographic = geo_key(&mut decoder, KEY_MODEL_TYPE) == Some(MODEL_IS_GEOGRAPHIC);
    let system = if is_geographic { KEY_GEODETIC_CRS } else { KEY_PROJECTED_CRS };
    let epsg = geo_key(&mut decoder, system).map(u32::from).filter(|&c| c != 32767);
    let mut nodata = decoder
        .get_tag_ascii_string(Tag::GdalNodata)
        .ok()
        .and_then(|t| t.trim_matches(['\0', ' ']).parse::<f64>().ok());
    let is_planar = decoder
        .find_tag_unsigned::<u16>(Tag::PlanarConfiguration)
        .map_err(broken)?
        .is_some_and(|p| p == 2)
        && bands > 1;
    let shape = chunks::Shape { width, height, bands, is_planar };
    let samples = match chunks::read(&mut decoder, &shape).map_err(broken)? {
        Some(mut samples) => {
            if photometric == chunks::WHITE_IS_ZERO {
                turn_round(&mut samples);
            }
            Some(samples)
        }
        None if is_planar => read_planes(&mut decoder, width, height, bands).map_err(broken)?,
        None => to_samples(decoder.read_image().map_err(broken)?),
    };
    let mut samples = samples.ok_or_else(|| {
        Error::new("the TIFF's sample type is not supported")
            .remedy("convert it to 8 or 16 bits or float32, e.g. `gdal_translate -ot Float32`")
    })?;
    if bands > 3 && samples.len() == 3 * width * height {
        return Err(Error::new(format!(
            "the TIFF does not say what its {} bands beyond the colours are",
            bands - 3
        ))
        .remedy("keep the colours alone: `gdal_translate -b 1 -b 2 -b 3 in.tif out.tif`"));
    }
    if samples.len() < values {
        return Err(Error::new("the TIFF holds fewer pixels than its header says")
            .remedy("the file is cut short; fetch it again"));
    }
    if matches!(decoder.colortype(), Ok(tiff::ColorType::YCbCr(8)))
        && bands == 3
        && let Samples::U8(v) = &mut samples
    {
        v.chunks_exact_mut(3).for_each(rgb_from_ycbcr);
    }
    if photometric == chunks::WHITE_IS_ZERO {
        nodata = nodata.map(|value| match &samples {
            Samples::U8(_) => 255.0 - value,
            Samples::U16(_) => 65535.0 - value,
            Samples::F32(_) => 1.0 - value,
        });
    }
    let mut bands = bands;
    if photometric == chunks::PALETTE {
        let map = decoder.get_tag_u16_vec(Tag::ColorMap).map_err(broken)?;
        (samples, bands) = (painted(&samples, bands, &map, nodata)?, 3);
        // Black, as the edges of mosaics are.
        nodata = None;
    }
    let values = width * height * bands;
    // 1 and 2: the last band is alpha.
    let has_alpha = bands == 4
        && decoder
            .get_tag_u16_vec(Tag::ExtraSamples)
            .is_ok_and(|extra| matches!(extra.as_slice(), [1 | 2]));
    match &mut samples {
        Samples::U8(v) => {
            v.truncate(values);
            hide(v, has_alpha);
        }
        Samples::U16(v) => {
            v.truncate(values);
            hide(v, has_alpha);
        }
        Samples::F32(v) => {
            v.truncate(values);
            // Fillers near the end of the range, whose nodata text is often rounded.
            v.iter_mut().filter(|v| v.abs() > 1e30).for_each(|v| *v = f32::NAN);
            hide(v, has_alpha);
        }
    }
    Ok(Raster { width, height, bands, samples, geometry, epsg, nodata })
}

/// The first value of a tag.
fn number<R: Read + Seek>(
    decoder: &mut Decoder<R>,
    tag: Tag,
    absent: u64,
) -> tiff::TiffResult<u64> {
    let values = decoder.find_tag_unsigned_vec::<u64>(tag)?;
    Ok(values.and_then(|values| values.first().copied()).unwrap_or(absent))
}

/// Refuses what can't be unpacked, by its name (TIFF 6.0 and libtiff's tiff.h).
fn refuse_packing(compression: u64) -> Result<()> {
    let name = match compression {
        1 | 5 | 7 | 8 | 32773 | 32946 => return Ok(()),
        2..=4 | 32771 => "CCITT fax".to_owned(),
        6 => "JPEG of the old kind (TIFF 6.0)".to_owned(),
        32809 => "ThunderScan".to_owned(),
        33003..=33005 | 34712 => "JPEG 2000".to_owned(),
        34887 => "LERC".to_owned(),
        34925 => "LZMA".to_owned(),
        34926 | 50000 => "ZSTD".to_owned(),
        34927 | 50001 => "WebP".to_owned(),
        50002 | 52546 => "JPEG XL".to_owned(),
        other => format!("a method of number {other}"),
    };
    Err(Error::new(format!("the TIFF is packed by {name}, which is not read here"))
        .remedy("repack it: gdal_translate -co COMPRESS=DEFLATE in.tif out.tif"))
}

/// Refuses what is less than a byte.
fn refuse_bits(bits: u64, photometric: u64) -> Result<()> {
    let remedy = match (bits, photometric) {
        (8.., chunks::PALETTE) if bits <= 16 => return Ok(()),
        (_, chunks::PALETTE) => "spread its palette: gdal_translate -expand rgb in.tif out.tif",
        (8.., _) => return Ok(()),
        _ => "spread it: gdal_translate -ot Byte -scale in.tif out.tif",
    };
    Err(Error::new(format!("the TIFF has {bits} bits a pixel and band, which is not read here"))
        .remedy(remedy))
}

/// So that 0 is black.
fn turn_round(samples: &mut Samples) {
    match samples {
        Samples::U8(v) => v.iter_mut().for_each(|v| *v = !*v),
        Samples::U16(v) => v.iter_mut().for_each(|v| *v = !*v),
        Samples::F32(v) => v.iter_mut().for_each(|v| *v = 1.0 - *v),
    }
}

/// The colours of numbers into a palette: three bands of 8 bits. Its map holds all reds, then all
/// greens, then all blues (TIFF 6.0, section 5), of 16 bits, though some writers use 8. What has no
/// data, or is hidden by the band beside, is black.
fn painted(samples: &Samples, bands: usize, map: &[u16], nodata: Option<f64>) -> Result<Samples> {
    let number = |at: usize| match samples {
        Samples::U8(v) => usize::from(v[at]),
        Samples::U16(v) => usize::from(v[at]),
        Samples::F32(_) => usize::MAX,
    };
    let colours = map.len() / 3;
    if matches!(samples, Samples::F32(_)) || colours == 0 {
        return Err(Error::new("the TIFF's palette can't be read")
            .remedy("spread it: gdal_translate -expand rgb in.tif out.tif"));
    }
    let shift = if map.iter().any(|&v| v > 255) { 8 } else { 0 };
    let colour = |pixel: usize| {
        let at = number(pixel * bands);
        let is_hidden = bands == 2 && number(pixel * bands + 1) == 0;
        let is_shown = at < colours && !is_hidden && nodata != Some(at as f64);
        [0, 1, 2].map(|band| if is_shown { (map[band * colours + at] >> shift) as u8 } else { 0 })
    };
    Ok(Samples::U8((0..samples.len() / bands.max(1)).flat_map(colour).collect()))
}

/// JFIF 1.02, full range.
fn rgb_from_ycbcr(pixel: &mut [u8]) {
    if let [y, cb, cr] = pixel {
        let (luma, b, r) = (f32::from(*y), f32::from(*cb) - 128.0, f32::from(*cr) - 128.0);
        let rgb = [luma + 1.402 * r, luma - 0.344_136 * b - 0.714_136 * r, luma + 1.772 * b];
        [*y, *cb, *cr] = rgb.map(|v| v.round() as u8);
    }
}

/// Blackens the pixels of no alpha.
pub(super) fn hide<T: Copy + Default + PartialEq>(samples: &mut [T], has_alpha: bool) {
    if has_alpha {
        let hidden = samples.chunks_exact_mut(4).filter(|pixel| pixel[3] == T::default());
        hidden.for_each(|pixel| pixel.fill(T::default()));
    }
}

fn to_samples(data: DecodingResult) -> Option<Samples> {
    Some(match data {
        DecodingResult::U8(v) => Samples::U8(v),
        DecodingResult::U16(v) => Samples::U16(v),
        DecodingResult::F32(v) => Samples::F32(v),
        DecodingResult::F64(v) => Samples::F32(v.into_iter().map(|x| x as f32).collect()),
        DecodingResult::I8(v) => Samples::F32(v.into_iter().map(f32::from).collect()),
        DecodingResult::I16(v) => Samples::F32(v.into_iter().map(f32::from).collect()),
        DecodingResult::I32(v) => Samples::F32(v.into_iter().map(|x| x as f32).collect()),
        DecodingResult::U32(v) => Samples::F32(v.into_iter().map(|x| x as f32).collect()),
        _ => return None,
    })
}

/// Reads band-sequential chunks and interleaves them; values pass through f32, exact for 8 and 16
/// bits.
fn read_planes<R: Read + Seek>(
    decoder: &mut Decoder<R>,
    width: usize,
    height: usize,
    bands: usize,
) -> tiff::TiffResult<Option<Samples>> {
    let (chunk_w, chunk_h) = decoder.chunk_dimensions();
    let across = width.div_ceil(chunk_w.max(1) as usize);
    let down = height.div_ceil(chunk_h.max(1) as usize);
    let mut out = vec![0.0f32; width * height * bands];
    let mut is_u8 = false;
    let mut is_u16 = false;
    for band in 0..bands {
        for chunk in 0..across * down {
            let id = (band * across * down + chunk) as u32;
            let (w, h) = decoder.chunk_data_dimensions(id % (across * down) as u32);
            let data = decoder.read_chunk(id)?;
            is_u8 = matches!(data, DecodingResult::U8(_));
            is_u16 = matches!(data, DecodingResult::U16(_));
            let Some(samples) = to_samples(data) else { return Ok(None) };
            let (x0, y0) = (chunk % across * chunk_w as usize, chunk / across * chunk_h as usize);
            for (i, (y, x)) in
                (0..h as usize).flat_map(|y| (0..w as usize).map(move |x| (y, x))).enumerate()
            {
                let value = match &samples {
                    Samples::U8(v) => v.get(i).map(|&x| f32::from(x)),
                    Samples::U16(v) => v.get(i).map(|&x| f32::from(x)),
                    Samples::F32(v) => v.get(i).copied(),
                };
                let at = ((y0 + y) * width + x0 + x) * bands + band;
                if let (Some(value), Some(slot)) = (value, out.get_mut(at)) {
                    *slot = value;
                }
            }
        }
    }
    Ok(Some(if is_u8 {
        Samples::U8(out.into_iter().map(|x| x as u8).collect())
    } else if is_u16 {
        Samples::U16(out.into_iter().map(|x| x as u16).collect())
    } else {
        Samples::F32(out)
    }))
}

fn geo_key<R: Read + Seek>(decoder: &mut Decoder<R>, key: u16) -> Option<u16> {
    let keys = decoder.get_tag_u16_vec(Tag::GeoKeyDirectoryTag).ok()?;
    keys.get(4..)?.chunks_exact(4).find(|k| k[0] == key && k[1] == 0).map(|k| k[3])
}

fn georeference<R: Read + Seek>(
    decoder: &mut Decoder<R>,
    cols: usize,
    rows: usize,
) -> Result<Option<GridGeometry>> {
    let rotated = || {
        Error::new("the raster is rotated against north")
            .remedy("warp it to north-up first, e.g. `gdalwarp in.tif out.tif`")
    };
    let (mut west, mut north, cell_x, cell_y);
    if let Ok(m) = decoder.get_tag_f64_vec(Tag::ModelTransformationTag) {
        let [a, b, _, x, d, e, _, y] = *m.first_chunk::<8>().ok_or_else(rotated)?;
        if [a, b, x, d, e, y] == [1.0, 0.0, 0.0, 0.0, 1.0, 0.0] {
            // Columns and rows as they are: no place.
            return Ok(None);
        }
        if b != 0.0 || d != 0.0 {
            return Err(rotated());
        }
        if e >= 0.0 {
            return Err(Error::new("the raster's rows run from south to north")
                .remedy("turn it north up first, e.g. `gdalwarp in.tif out.tif`"));
        }
        (west, north, cell_x, cell_y) = (x, y, a, -e);
    } else if let (Ok(scale), Ok(tie)) = (
        decoder.get_tag_f64_vec(Tag::ModelPixelScaleTag),
        decoder.get_tag_f64_vec(Tag::ModelTiepointTag),
    ) {
        let (Some(&[sx, sy]), Some(&[i, j, _, x, y])) =
            (scale.first_chunk::<2>(), tie.first_chunk::<5>())
        else {
            return Ok(None);
        };
        (west, north, cell_x, cell_y) = (x - i * sx, y + j * sy, sx, sy);
    } else {
        return Ok(None);
    }
    if !(cell_x > 0.0
        && cell_y > 0.0
        && [west, north, cell_x, cell_y].iter().all(|v| v.is_finite()))
    {
        return Ok(None);
    }
    if geo_key(decoder, KEY_RASTER_TYPE) == Some(PIXEL_IS_POINT) {
        west -= 0.5 * cell_x;
        north += 0.5 * cell_y;
    }
    Ok(Some(GridGeometry { west, north, cell_x, cell_y, cols, rows }))
}

/// Cloud Optimized GeoTIFF bytes of a raster.
///
/// # Errors
/// A size that disagrees with the data, or a band count other than 1, 3 or 4.
pub fn encode(raster: &Raster) -> Result<Vec<u8>> {
    if raster.samples.len() != raster.width * raster.height * raster.bands {
        return Err(Error::new("a raster's size and data disagree"));
    }
    let crs = raster.epsg.map(Crs::from_epsg);
    cog::encode(&cog::Sheet {
        width: raster.width,
        height: raster.height,
        bands: raster.bands,
        kind: match raster.samples {
            Samples::U8(_) => cog::Kind::U8,
            Samples::U16(_) => cog::Kind::U16,
            Samples::F32(_) => cog::Kind::F32,
        },
        geometry: raster.geometry,
        crs: crs.as_ref(),
        nodata: raster.nodata,
        unit: None,
        value: &|col, row, band| raster.value(col, row, band),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample(bands: usize, samples: Samples) -> Raster {
        Raster {
            width: 4,
            height: 3,
            bands,
            samples,
            geometry: Some(GridGeometry {
                west: 500_000.25,
                north: 6_200_000.5,
                cell_x: 0.25,
                cell_y: 0.5,
                cols: 4,
                rows: 3,
            }),
            epsg: Some(32646),
            nodata: Some(-9999.0),
        }
    }

    #[test]
    fn round_trips_every_written_form() {
        for raster in [
            sample(1, Samples::F32((0..12).map(|i| i as f32 * 1.5 - 3.0).collect())),
            sample(3, Samples::U8((0..36).collect())),
            sample(4, Samples::U8((0..48).collect())),
            sample(1, Samples::U16((0..12).map(|i| i * 5000).collect())),
            sample(3, Samples::U16((0..36).map(|i| i * 1800).collect())),
            sample(4, Samples::F32((0..48).map(|i| i as f32 / 7.0 + 0.1).collect())),
        ] {
            assert_eq!(from_bytes(&encode(&raster).unwrap()).unwrap(), raster);
        }
    }

    #[test]
    fn a_fourth_band_that_nothing_is_said_of_hides_no_colours() {
        let rgba = sample(4, Samples::U8((1..49).collect()));
        let mut bytes = encode(&rgba).unwrap();
        let extra = [0x52, 0x01, 3, 0, 1, 0, 0, 0];
        let at = bytes.windows(8).position(|b| b == extra).unwrap();
        assert_ne!(bytes[at + 8], 0);
        bytes[at + 8] = 0;
        let back = from_bytes(&bytes).unwrap();
        for (i, band) in (0..12).flat_map(|i| (0..3).map(move |band| (i, band))) {
            assert_eq!(back.value(i % 4, i / 4, band), rgba.value(i % 4, i / 4, band));
        }
    }

    #[test]
    fn fillers_at_the_end_of_the_range_are_no_values() {
        let mut values: Vec<f32> = (0..12).map(|i| i as f32).collect();
        (values[3], values[4]) = (-3.4e38, 1.7e38);
        let mut raster = sample(1, Samples::F32(values));
        raster.nodata = Some(-3.4e38);
        let back = from_bytes(&encode(&raster).unwrap()).unwrap();
        assert!(back.value(3, 0, 0).is_nan() && back.value(0, 1, 0).is_nan());
        assert_eq!(back.value(1, 1, 0), 5.0);
    }

    /// A TIFF of 4 × 2 pixels in one strip, of these short fields beside its size.
    fn plain(fields: &[(u16, &[u16])], pixels: &[u8]) -> Vec<u8> {
        let mut all: Vec<(u16, &[u16])> = vec![
            (256, &[4]),
            (257, &[2]),
            (258, &[8]),
            (259, &[1]),
            (262, &[1]),
            (273, &[8]),
            (277, &[1]),
            (278, &[2]),
        ];
        all.retain(|(tag, _)| fields.iter().all(|(own, _)| own != tag));
        all.extend(fields);
        let length = [pixels.len() as u16];
        all.push((279, &length));
        all.sort();
        let mut out = [b"II*\0", &(8 + pixels.len() as u32).to_le_bytes()[..], pixels].concat();
        let mut behind = out.len() + 2 + 12 * all.len() + 4;
        let mut long = Vec::new();
        out.extend((all.len() as u16).to_le_bytes());
        for (tag, values) in &all {
            out.extend([tag.to_le_bytes(), [3, 0]].concat());
            out.extend((values.len() as u32).to_le_bytes());
            let bytes: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
            if bytes.len() <= 4 {
                out.extend([bytes, vec![0; 4]].concat().iter().take(4));
            } else {
                out.extend((behind as u32).to_le_bytes());
                behind += bytes.len();
                long.extend(bytes);
            }
        }
        out.extend([0; 4]);
        out.extend(long);
        out
    }

    #[test]
    fn numbers_into_a_palette_become_its_colours() {
        let numbers = [0, 1, 2, 255, 2, 2, 2, 0];
        let expected = [1, 11, 21, 0, 21, 21, 21, 1];
        let map = |shift: u32| -> Vec<u16> {
            let red = (0..256).map(|i| (10 * i + 1) % 256 * i32::from(i < 255));
            let all = red.clone().chain(red.clone().map(|v| v / 2)).chain(red.map(|v| v / 3));
            all.map(|v| (v as u16) << shift).collect()
        };
        for (what, packing, pixels) in [
            ("plain", 1, numbers.to_vec()),
            ("PackBits", 32773, vec![3, 0, 1, 2, 255, 0x80, 254, 2, 0, 0]),
        ] {
            for shift in [0, 8] {
                let bytes = plain(&[(259, &[packing]), (262, &[3]), (320, &map(shift))], &pixels);
                let raster = from_bytes(&bytes).unwrap();
                assert_eq!(raster.bands, 3, "{what}");
                for (i, red) in expected.into_iter().enumerate() {
                    let rgb = [0, 1, 2].map(|band| raster.value(i % 4, i / 4, band) as i32);
                    assert_eq!(rgb, [red, red / 2, red / 3], "{what}: pixel {i}");
                }
            }
        }
        let bare = from_bytes(&plain(&[(262, &[3])], &numbers)).unwrap_err();
        assert!(bare.message().starts_with("not a readable TIFF"), "{bare:?}");
        let few = plain(&[(258, &[4]), (262, &[3]), (320, &map(8)[..48])], &[0x01, 0x2f]);
        insta::assert_snapshot!(format!("{:?}", from_bytes(&few).unwrap_err()), @"the TIFF has 4 bits a pixel and band, which is not read here (remedy: spread its palette: gdal_translate -expand rgb in.tif out.tif)");
    }

    #[test]
    fn where_0_is_white_values_are_turned_round() {
        for (bands, packing) in [(1, 1), (2, 1), (1, 32773)] {
            let pixels: Vec<u8> = match packing {
                1 => (0..8 * bands as u8).collect(),
                _ => [7].into_iter().chain(0..8).collect(),
            };
            let bits = vec![8; bands];
            let fields = [(258, &bits[..]), (259, &[packing]), (262, &[0]), (277, &[bands as u16])];
            let raster = from_bytes(&plain(&fields, &pixels)).unwrap();
            for (i, k) in (0..8).flat_map(|i| (0..bands).map(move |k| (i, k))) {
                assert_eq!(raster.value(i % 4, i / 4, k), 255.0 - (i * bands + k) as f32);
            }
        }
    }

    #[test]
    fn packings_that_are_not_read_are_named() {
        let told = |number: u16| format!("{:?}", from_bytes(&plain(&[(259, &[number])], &[9; 8])));
        insta::assert_snapshot!(told(50000), @"Err(the TIFF is packed by ZSTD, which is not read here (remedy: repack it: gdal_translate -co COMPRESS=DEFLATE in.tif out.tif))");
        for (number, name) in
            [(50001, "WebP"), (34925, "LZMA"), (34712, "JPEG 2000"), (34887, "LERC"), (4, "CCITT")]
        {
            assert!(told(number).contains(&format!("packed by {name}")), "{}", told(number));
        }
        assert!(told(9999).contains("packed by a method of number 9999"), "{}", told(9999));
        let grey = from_bytes(&plain(&[(258, &[1])], &[9; 8])).unwrap_err();
        assert_eq!(
            grey.remedy_text(),
            Some("spread it: gdal_translate -ot Byte -scale in.tif out.tif")
        );
    }

    #[test]
    fn truncated_and_garbage_files_are_refused_in_words() {
        let bytes = encode(&sample(3, Samples::U8((0..36).collect()))).unwrap();
        for cut in 0..bytes.len() {
            let _ = from_bytes(&bytes[..cut]);
        }
        let mut draws = crate::seed::Seed::new(7).draws();
        for _ in 0..3000 {
            let mut mutated = bytes.clone();
            let at = draws.index(mutated.len());
            mutated[at] = [0, 0x7f, 0xff, draws.bits() as u8][draws.index(4)];
            let _ = from_bytes(&mutated);
        }
        let e = from_bytes(b"this is no picture").unwrap_err();
        assert!(e.message().starts_with("not a readable TIFF"), "{e:?}");
        assert!(e.remedy_text().is_some());
    }

    #[test]
    fn reads_the_real_rasters() {
        let data = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../shared/data"));
        if !data.exists() {
            eprintln!("skipped: no ../shared/data");
            return;
        }
        let photo = read(&data.join("idtrees/rgb/MLBS_10.tif")).unwrap();
        assert_eq!((photo.width, photo.height, photo.bands), (200, 200, 3));
        let g = photo.geometry.unwrap();
        assert!((g.cell_x - 0.1).abs() < 1e-9 && photo.epsg == Some(32617), "{photo:?}");
        let drone = read(&data.join("spanner/UAS_Clip_RGB.tif")).unwrap();
        assert_eq!(drone.bands, 4);
        let dtm = read(&data.join("pycrown/DTM.tif")).unwrap();
        assert_eq!((dtm.bands, dtm.epsg), (1, Some(2193)));
    }
}
