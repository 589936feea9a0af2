//! Pixels of a TIFF that the `tiff` crate (0.11) does not read right: packed by LZW (TIFF 6.0, sections
//! 13 and 14; floats after Adobe's Technical Note 3), or numbers of a palette's colours, or of colours
//! with further bands of no stated kind, or of several bands of which 0 is white, by LZW, deflate,
//! PackBits (section 9) or plain. Values are given as they are in the file.
//!
//! The crate fails on sound tiles whose last LZW code just fills its buffer, and on those without an end
//! code; here a chunk is done when it has all its bytes, as libtiff has it. Of the further bands it
//! takes the samples for those of the next pixels.

use std::io::{Read, Seek, SeekFrom};

use flate2::read::ZlibDecoder;
use tiff::decoder::{ChunkType, Decoder};
use tiff::tags::{ByteOrder, Tag};
use tiff::{ColorType, TiffResult};
use weezl::{BitOrder, LzwStatus, decode::Configuration};

use super::geotiff::Samples;

/// Size of a picture in the file.
pub(super) struct Shape {
    pub width: usize,
    pub height: usize,
    pub bands: usize,
    /// Each band for itself.
    pub is_planar: bool,
}

const PLAIN: u64 = 1;
const LZW: u64 = 5;
const DEFLATE: [u64; 2] = [8, 32946];
const PACK_BITS: u64 = 32773;
/// Photometric interpretations (TIFF 6.0, section 8).
pub(super) const WHITE_IS_ZERO: u64 = 0;
pub(super) const PALETTE: u64 = 3;

/// Reads a picture of 8 or 16 bits or of 32-bit floats; `None` where it is one that is left to the
/// `tiff` crate.
pub(super) fn read<R: Read + Seek>(
    decoder: &mut Decoder<R>,
    shape: &Shape,
) -> TiffResult<Option<Samples>> {
    let first = |decoder: &mut Decoder<R>, tag: Tag, default: u64| -> TiffResult<u64> {
        let values = decoder.find_tag_unsigned_vec::<u64>(tag)?;
        Ok(values.and_then(|v| v.first().copied()).unwrap_or(default))
    };
    let compression = first(decoder, Tag::Compression, 1)?;
    let bits = first(decoder, Tag::BitsPerSample, 1)?;
    let format = first(decoder, Tag::SampleFormat, 1)?;
    let predictor = first(decoder, Tag::Predictor, 1)?;
    let photometric = first(decoder, Tag::PhotometricInterpretation, 1)?;
    let bytes = match (bits, format) {
        (8, 1) => 1,
        (16, 1) => 2,
        (32, 3) => 4,
        _ => return Ok(None),
    };
    let is_predicted = match predictor {
        1 | 2 => true,
        3 => bytes == 4,
        _ => false,
    };
    let is_unnamed = shape.bands > 3 && matches!(decoder.colortype(), Ok(ColorType::RGB(_)));
    let is_known = [PLAIN, LZW, PACK_BITS].contains(&compression) || DEFLATE.contains(&compression);
    let is_left =
        compression != LZW && !is_unnamed && ![WHITE_IS_ZERO, PALETTE].contains(&photometric);
    if !is_known || is_left || !is_predicted {
        return Ok(None);
    }
    let (offset_tag, length_tag) = match decoder.get_chunk_type() {
        ChunkType::Tile => (Tag::TileOffsets, Tag::TileByteCounts),
        ChunkType::Strip => (Tag::StripOffsets, Tag::StripByteCounts),
    };
    let offsets = decoder.get_tag_u64_vec(offset_tag)?;
    let lengths = decoder.get_tag_u64_vec(length_tag)?;
    let is_big = decoder.byte_order() == ByteOrder::BigEndian;
    let (chunk_width, chunk_height) = decoder.chunk_dimensions();
    let (chunk_width, chunk_height) = (chunk_width as usize, chunk_height as usize);
    let stride = if shape.is_planar { 1 } else { shape.bands };
    let (across, down) =
        (shape.width.div_ceil(chunk_width.max(1)), shape.height.div_ceil(chunk_height.max(1)));
    let row_bytes = chunk_width.saturating_mul(stride).saturating_mul(bytes);
    if row_bytes == 0 || chunk_height == 0 {
        return Ok(None);
    }
    let mut out = vec![0u32; shape.width * shape.height * shape.bands];
    let mut packed = Vec::new();
    for (number, (offset, length)) in offsets.iter().zip(&lengths).enumerate() {
        let (plane, chunk) = (number / (across * down).max(1), number % (across * down).max(1));
        let (left, top) = (chunk % across * chunk_width, chunk / across * chunk_height);
        if plane >= shape.bands {
            break;
        }
        let rows = chunk_height.min(shape.height.saturating_sub(top));
        packed.clear();
        decoder.inner().seek(SeekFrom::Start(*offset))?;
        decoder.inner().take(*length).read_to_end(&mut packed)?;
        // A code of at least 9 bits stands for at most 4096 bytes; deflate packs to a 1032th.
        let room = row_bytes.saturating_mul(rows);
        if room > packed.len().saturating_mul(4096) {
            return Err(early().into());
        }
        let mut unpacked = vec![0u8; room];
        match compression {
            PLAIN => packed.as_slice().read_exact(&mut unpacked)?,
            LZW => unpack(&packed, &mut unpacked)?,
            PACK_BITS => unpack_bits(&packed, &mut unpacked)?,
            _ => ZlibDecoder::new(packed.as_slice()).read_exact(&mut unpacked)?,
        }
        for (y, row) in unpacked.chunks_exact_mut(row_bytes).enumerate() {
            let values = values(row, bytes, stride, predictor, is_big);
            let kept = chunk_width.min(shape.width.saturating_sub(left)) * stride;
            for (i, value) in values.take(kept).enumerate() {
                let (x, band) = (left + i / stride, plane + i % stride);
                let at = ((top + y) * shape.width + x) * shape.bands + band;
                if let Some(slot) = out.get_mut(at) {
                    *slot = value;
                }
            }
        }
    }
    Ok(Some(match bytes {
        1 => Samples::U8(out.into_iter().map(|v| v as u8).collect()),
        2 => Samples::U16(out.into_iter().map(|v| v as u16).collect()),
        _ => Samples::F32(out.into_iter().map(f32::from_bits).collect()),
    }))
}

fn early() -> std::io::Error {
    std::io::Error::new(std::io::ErrorKind::UnexpectedEof, "packed pixels end early")
}

/// Fills `out`: after a byte n come n + 1 bytes as they are, or, above 128, one for 257 - n times.
fn unpack_bits(packed: &[u8], out: &mut [u8]) -> std::io::Result<()> {
    let (mut packed, mut out) = (packed, out);
    while !out.is_empty() {
        let (&n, rest) = packed.split_first().ok_or_else(early)?;
        let (times, taken) = match n {
            0..=127 => (usize::from(n) + 1, usize::from(n) + 1),
            128 => (0, 0),
            _ => (257 - usize::from(n), 1),
        };
        let (bytes, rest) = rest.split_at_checked(taken).ok_or_else(early)?;
        let (filled, others) = out.split_at_mut(times.min(out.len()));
        filled.iter_mut().zip(bytes.iter().cycle()).for_each(|(to, from)| *to = *from);
        (packed, out) = (rest, others);
    }
    Ok(())
}

/// Fills `out`.
fn unpack(packed: &[u8], out: &mut [u8]) -> std::io::Result<()> {
    let mut decoder = Configuration::with_tiff_size_switch(BitOrder::Msb, 8).build();
    let (mut from, mut to) = (0, 0);
    while to < out.len() {
        let step = decoder.decode_bytes(
            packed.get(from..).unwrap_or_default(),
            out.get_mut(to..).unwrap_or_default(),
        );
        from += step.consumed_in;
        to += step.consumed_out;
        let is_stuck = step.consumed_in == 0 && step.consumed_out == 0;
        let is_over = !matches!(step.status, Ok(LzwStatus::Ok)) || is_stuck;
        if is_over && to < out.len() {
            return Err(early());
        }
    }
    Ok(())
}

/// The values of a row as bits, its predictor undone.
fn values(
    row: &mut [u8],
    bytes: usize,
    stride: usize,
    predictor: u64,
    is_big: bool,
) -> impl Iterator<Item = u32> {
    let count = row.len() / bytes;
    if predictor == 3 || bytes == 1 && predictor == 2 {
        for i in stride..row.len() {
            row[i] = row[i].wrapping_add(row[i - stride]);
        }
    }
    let mut values: Vec<u32> = (0..count)
        .map(|i| {
            (0..bytes).fold(0, |value, k| {
                // The greatest byte first.
                let at = match (predictor, is_big) {
                    (3, _) => k * count + i,
                    (_, true) => i * bytes + k,
                    (_, false) => i * bytes + bytes - 1 - k,
                };
                value << 8 | u32::from(row[at])
            })
        })
        .collect();
    if predictor == 2 && bytes > 1 {
        let mask = if bytes == 2 { 0xffff } else { u32::MAX };
        for i in stride..values.len() {
            values[i] = values[i].wrapping_add(values[i - stride]) & mask;
        }
    }
    values.into_iter()
}

#[cfg(test)]
mod tests {
    use super::super::geotiff;
    use super::*;

    /// A tiled TIFF of 20 × 18 grey pixels in tiles of 16, LZW, with or without end codes.
    fn tiled(has_end: bool, predictor: u16) -> Vec<u8> {
        let pixel = |x: usize, y: usize| ((x * 7 + y * 3) % 251) as u8;
        let tiles: Vec<Vec<u8>> = (0..4)
            .map(|tile| {
                let mut raw = Vec::new();
                for y in 0..16 {
                    for x in 0..16 {
                        let at = |x: usize| pixel(tile % 2 * 16 + x, tile / 2 * 16 + y);
                        let before = if predictor == 2 && x > 0 { at(x - 1) } else { 0 };
                        raw.push(at(x).wrapping_sub(before));
                    }
                }
                let mut bytes = weezl::encode::Encoder::with_tiff_size_switch(BitOrder::Msb, 8)
                    .encode(&raw)
                    .unwrap();
                if !has_end {
                    bytes.pop();
                }
                bytes
            })
            .collect();
        let fields: Vec<(u16, u16, Vec<u32>)> = vec![
            (256, 4, vec![20]),
            (257, 4, vec![18]),
            (258, 3, vec![8]),
            (259, 3, vec![5]),
            (262, 3, vec![1]),
            (277, 3, vec![1]),
            (317, 3, vec![predictor.into()]),
            (322, 3, vec![16]),
            (323, 3, vec![16]),
            (324, 4, vec![0; 4]),
            (325, 4, tiles.iter().map(|tile| tile.len() as u32).collect()),
        ];
        let values_at = 8 + 2 + 12 * fields.len() + 4;
        let data_at = (values_at + 32) as u32;
        let mut offsets = vec![data_at];
        tiles
            .iter()
            .take(3)
            .for_each(|t| offsets.push(offsets[offsets.len() - 1] + t.len() as u32));
        let mut out = b"II*\0\x08\0\0\0".to_vec();
        out.extend((fields.len() as u16).to_le_bytes());
        let mut long = Vec::new();
        for (tag, kind, values) in fields {
            let values = if tag == 324 { offsets.clone() } else { values };
            out.extend(tag.to_le_bytes());
            out.extend(kind.to_le_bytes());
            out.extend((values.len() as u32).to_le_bytes());
            if values.len() == 1 {
                out.extend(values[0].to_le_bytes());
            } else {
                out.extend(((values_at + long.len()) as u32).to_le_bytes());
                long.extend(values.iter().flat_map(|v| v.to_le_bytes()));
            }
        }
        out.extend([0; 4]);
        out.extend(long);
        tiles.iter().for_each(|tile| out.extend(tile));
        out
    }

    #[test]
    fn tiles_are_read_with_and_without_end_codes() {
        for (has_end, predictor) in [(true, 1), (true, 2), (false, 1), (false, 2)] {
            let bytes = tiled(has_end, predictor);
            let raster = geotiff::from_bytes(&bytes).unwrap();
            for y in 0..18 {
                for x in 0..20 {
                    let expected = ((x * 7 + y * 3) % 251) as f32;
                    assert_eq!(raster.value(x, y, 0), expected, "{x} {y} {has_end} {predictor}");
                }
            }
            // The last tile needs but two of its rows.
            for cut in 0..bytes.len() {
                let read = geotiff::from_bytes(&bytes[..cut]);
                assert!(read.is_err() || cut > bytes.len() * 3 / 4, "{cut} of {}", bytes.len());
            }
        }
    }
}
