//! PNG of 8 bits a channel (ISO/IEC 15948), its lines as they are or by Paeth's filter, whichever
//! comes out smaller in a sample of them, deflated by libdeflate.

use libdeflater::{CompressionLvl, Compressor, crc32};

use crate::diagnostic::{Error, Result};

const SIGNATURE: &[u8] = b"\x89PNG\r\n\x1a\n";
/// Of libdeflate's 0…12: most of what the higher ones save, at a fraction of their time.
const LEVEL: i32 = 4;
/// Of the sample's.
const SAMPLE_LEVEL: i32 = 1;
/// Lines of the sample that follow each other, and how far apart such groups are.
const SAMPLED: usize = 8;
const APART: usize = 64;

/// Of `CHANNELS` bytes a pixel: 3 for RGB, 4 for RGBA.
///
/// # Errors
/// A picture whose size and pixels disagree.
pub(super) fn encode<const CHANNELS: usize>(
    width: u32,
    height: u32,
    pixels: &[[u8; CHANNELS]],
) -> Result<Vec<u8>> {
    let count = u64::from(width) * u64::from(height);
    if count != pixels.len() as u64 || count == 0 {
        return Err(Error::new("a picture's size and data disagree"));
    }
    let lines: Vec<&[[u8; CHANNELS]]> = pixels.chunks_exact(width as usize).collect();
    let sample = |filter| {
        let at = (0..lines.len()).filter(|y| y % APART < SAMPLED);
        let sampled = filtered(&lines, at, filter);
        deflated(&sampled, SAMPLE_LEVEL).map(|bytes| bytes.len())
    };
    let filter =
        if sample(Filter::None)? <= sample(Filter::Paeth)? { Filter::None } else { Filter::Paeth };
    let data = deflated(&filtered(&lines, 0..lines.len(), filter), LEVEL)?;
    let mut out = SIGNATURE.to_vec();
    let mut head = Vec::new();
    head.extend(width.to_be_bytes());
    head.extend(height.to_be_bytes());
    let colour_type = if CHANNELS == 4 { 6 } else { 2 };
    head.extend([8, colour_type, 0, 0, 0]);
    chunk(&mut out, b"IHDR", &head);
    // A chunk's length has 31 bits.
    data.chunks(i32::MAX as usize).for_each(|part| chunk(&mut out, b"IDAT", part));
    chunk(&mut out, b"IEND", &[]);
    Ok(out)
}

/// By the numbers that stand for them.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
enum Filter {
    None = 0,
    Paeth = 4,
}

fn filtered<const C: usize>(
    lines: &[&[[u8; C]]],
    at: impl Iterator<Item = usize>,
    filter: Filter,
) -> Vec<u8> {
    let bytes = C * lines.first().map_or(0, |line| line.len());
    let mut out = Vec::with_capacity(at.size_hint().1.unwrap_or(0) * (1 + bytes));
    // With the pixel that is thought to stand before a line.
    let [mut now, mut above] = [vec![0; C + bytes], vec![0; C + bytes]];
    for y in at {
        out.push(filter as u8);
        if filter == Filter::None {
            out.extend_from_slice(lines[y].as_flattened());
            continue;
        }
        now[C..].copy_from_slice(lines[y].as_flattened());
        match y.checked_sub(1) {
            Some(before) => above[C..].copy_from_slice(lines[before].as_flattened()),
            None => above.fill(0),
        }
        let lefts = now.iter().zip(&above);
        let here = now[C..].iter().zip(&above[C..]);
        out.extend(here.zip(lefts).map(|((now, above), (left, above_left))| {
            now.wrapping_sub(paeth(*left, *above, *above_left))
        }));
    }
    out
}

/// Whichever of left, above and above left is nearest to left + above − above left. Without branches,
/// so that many are done at once.
fn paeth(left: u8, above: u8, above_left: u8) -> u8 {
    let [a, b, c] = [left, above, above_left].map(i16::from);
    let [from_a, from_b, from_c] = [(b - c).abs(), (a - c).abs(), (a + b - 2 * c).abs()];
    let of_two = if from_b <= from_c { b } else { c };
    (if from_a <= from_b.min(from_c) { a } else { of_two }) as u8
}

fn deflated(bytes: &[u8], level: i32) -> Result<Vec<u8>> {
    let refused = |e: &dyn std::fmt::Debug| Error::new(format!("a picture can't be coded: {e:?}"));
    let level = CompressionLvl::new(level).map_err(|e| refused(&e))?;
    let mut compressor = Compressor::new(level);
    let mut out = vec![0; compressor.zlib_compress_bound(bytes.len())];
    let length = compressor.zlib_compress(bytes, &mut out).map_err(|e| refused(&e))?;
    out.truncate(length);
    Ok(out)
}

fn chunk(out: &mut Vec<u8>, kind: &[u8; 4], data: &[u8]) {
    out.extend((data.len() as u32).to_be_bytes());
    let start = out.len();
    out.extend(kind);
    out.extend(data);
    let sum = crc32(&out[start..]);
    out.extend(sum.to_be_bytes());
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::raster::Picture;

    /// As another reader has it.
    fn read(bytes: &[u8]) -> Vec<[u8; 4]> {
        Picture::from_bytes(bytes).unwrap().data
    }

    #[test]
    fn smooth_pictures_are_filtered_and_flat_ones_are_not() {
        let smooth: Vec<[u8; 3]> = (0..128 * 128u32)
            .map(|k| [(k % 128 + k / 128) as u8, (k / 128) as u8, (k % 131) as u8])
            .collect();
        let flat: Vec<[u8; 3]> =
            (0..128 * 128u32).map(|k| [[7, 9, 200], [90; 3]][(k * k % 7 / 5) as usize]).collect();
        for (pixels, expected) in [(smooth, Filter::Paeth), (flat, Filter::None)] {
            let bytes = encode(128, 128, &pixels).unwrap();
            let at = bytes.windows(4).position(|w| w == b"IDAT").unwrap() + 4;
            let length = u32::from_be_bytes(bytes[at - 8..at - 4].try_into().unwrap()) as usize;
            let mut plain = vec![0; 128 * (1 + 3 * 128)];
            let mut inflate = libdeflater::Decompressor::new();
            inflate.zlib_decompress(&bytes[at..at + length], &mut plain).unwrap();
            assert!(plain.chunks(1 + 3 * 128).all(|line| line[0] == expected as u8));
            assert!(read(&bytes).iter().zip(&pixels).all(|(a, b)| a[..3] == *b));
        }
    }

    #[test]
    fn a_wrong_size_is_refused() {
        assert!(encode(2, 2, &[[0; 3]; 3]).is_err());
        assert!(encode::<3>(0, 0, &[]).is_err());
    }

    proptest! {
        #[test]
        fn pixels_return(width in 1u32..40, height in 1u32..90, step in 1u32..90) {
            let value = |k: u32| (k.wrapping_mul(step) / 11) as u8;
            let pixels: Vec<[u8; 4]> =
                (0..width * height).map(|k| [value(k), value(k / 3), k as u8, value(7 * k)]).collect();
            prop_assert_eq!(read(&encode(width, height, &pixels).unwrap()), pixels);
        }
    }
}
