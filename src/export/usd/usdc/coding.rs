//! The two codings of crate files: LZ4 blocks with a count of chunks before them, and integers as
//! differences in 0, 1, 2 or 4 bytes (0, 2, 4 or 8 for long ones), as OpenUSD's `fastCompression`
//! and `integerCoding` read them.

use lz4_flex::block::{compress_into, get_maximum_output_size};
use rayon::prelude::*;

/// Longer input is split, so that blocks are compressed on all threads; readers take any length.
const BLOCK: usize = 1 << 20;
/// Most blocks: their count is a signed byte.
const MOST_BLOCKS: usize = 127;
/// Differences of a smaller size than this are counted for the most common one.
const COUNTED: i64 = 1 << 15;
/// Integers coded as one; a multiple of four, whose codes fill a byte.
const PIECE: usize = 1 << 16;

/// A byte that says how many blocks follow, each after its length; 0 for one block without.
pub(super) fn compressed(bytes: &[u8]) -> Vec<u8> {
    in_blocks(bytes, BLOCK.max(bytes.len().div_ceil(MOST_BLOCKS)))
}

fn in_blocks(bytes: &[u8], most: usize) -> Vec<u8> {
    let block = |bytes: &[u8], head: usize| {
        let mut out = vec![0; head + get_maximum_output_size(bytes.len())];
        // Cannot fail: there is room for the longest output.
        let length = compress_into(bytes, &mut out[head..]).unwrap_or(0);
        out.truncate(head + length);
        out
    };
    if bytes.len() <= most {
        return block(bytes, 1);
    }
    const LENGTH: usize = 4;
    let with_length = |bytes: &[u8]| {
        let mut out = block(bytes, LENGTH);
        let length = (out.len() - LENGTH) as i32;
        out[..LENGTH].copy_from_slice(&length.to_le_bytes());
        out
    };
    let blocks: Vec<Vec<u8>> = bytes.par_chunks(most).map(with_length).collect();
    joined(vec![blocks.len() as u8], &blocks)
}

fn joined(mut out: Vec<u8>, pieces: &[Vec<u8>]) -> Vec<u8> {
    out.reserve_exact(pieces.iter().map(Vec::len).sum());
    pieces.iter().for_each(|piece| out.extend_from_slice(piece));
    out
}

pub(super) fn ints(values: &[i32]) -> Vec<u8> {
    compressed(&coded::<4, _>(values))
}

pub(super) fn unsigned(values: &[u32]) -> Vec<u8> {
    ints(bytemuck::cast_slice(values))
}

pub(super) fn long_ints(values: &[i64]) -> Vec<u8> {
    compressed(&coded::<8, _>(values))
}

/// `count` times the same.
pub(super) fn repeated(value: i32, count: usize) -> Vec<u8> {
    /// From here on 0 is the most common difference.
    const FEW: usize = 4;
    if count < FEW {
        return ints(&vec![value; count]);
    }
    // The first difference is the value.
    let mut out = coded::<4, _>(&[value, value, value, value]);
    let rest = out.split_off(4 + 1);
    out.resize(4 + count.div_ceil(4), 0);
    out.extend(rest);
    compressed(&out)
}

trait Integer: Copy + Sync {
    /// The difference, in the integer's own width.
    fn after(self, before: Self) -> i64;
    const ZERO: Self;
}

impl Integer for i32 {
    fn after(self, before: i32) -> i64 {
        i64::from(self.wrapping_sub(before))
    }
    const ZERO: i32 = 0;
}

impl Integer for i64 {
    fn after(self, before: i64) -> i64 {
        self.wrapping_sub(before)
    }
    const ZERO: i64 = 0;
}

/// The most common difference, two bits a difference, then those that are not the most common in
/// as few bytes as hold them. `WIDTH`: bytes of the integers.
fn coded<const WIDTH: usize, T: Integer>(values: &[T]) -> Vec<u8> {
    if values.is_empty() {
        return Vec::new();
    }
    let common = most_common(values);
    let piece = |piece: usize| {
        let (from, to) = (piece * PIECE, values.len().min((piece + 1) * PIECE));
        let mut codes = vec![0; (to - from).div_ceil(4)];
        // Eight bytes are stored at a time, of which the next overwrite some.
        let mut rest = vec![0; (to - from) * WIDTH + 8];
        let mut at = 0;
        let mut before = from.checked_sub(1).map_or(T::ZERO, |k| values[k]);
        for (four, codes) in values[from..to].chunks(4).zip(&mut codes) {
            for (k, &value) in four.iter().enumerate() {
                let difference = value.after(before);
                before = value;
                let code = code::<WIDTH>(difference, common);
                *codes |= code << (2 * k);
                rest[at..at + 8].copy_from_slice(&difference.to_le_bytes());
                // 0, 1, 2 or 4 quarters.
                at += WIDTH / 4 * usize::from(code + u8::from(code == 3));
            }
        }
        rest.truncate(at);
        (codes, rest)
    };
    let pieces = (0..values.len().div_ceil(PIECE)).into_par_iter().map(piece);
    let (codes, rest): (Vec<Vec<u8>>, Vec<Vec<u8>>) = pieces.unzip();
    joined(joined(common.to_le_bytes()[..WIDTH].to_vec(), &codes), &rest)
}

/// 0 for the most common, else 1, 2 or 3 for the bytes that hold it. Without branches: which it is
/// can't be foreseen.
fn code<const WIDTH: usize>(difference: i64, common: i64) -> u8 {
    let (short, middle) = match WIDTH {
        4 => (i64::from(difference as i8), i64::from(difference as i16)),
        _ => (i64::from(difference as i16), i64::from(difference as i32)),
    };
    let bytes = 1 + u8::from(difference != short) + u8::from(difference != middle);
    bytes * u8::from(difference != common)
}

/// Of those of fewer than 16 bits; the largest of several. Long columns are sampled: any will do, and
/// it only has to be common.
fn most_common<T: Integer>(values: &[T]) -> i64 {
    /// Samples, and how many numbers each has.
    const SAMPLES: usize = 64;
    const SAMPLE: usize = 1 << 11;
    let is_short = values.len() <= SAMPLES * SAMPLE;
    let (step, length) =
        if is_short { (values.len(), values.len()) } else { (values.len() / SAMPLES, SAMPLE) };
    let mut counts = vec![0u32; 2 * COUNTED as usize];
    for (at, sample) in values.chunks(step.max(1)).enumerate() {
        let mut before = (at * step).checked_sub(1).map_or(T::ZERO, |k| values[k]);
        for &value in sample.iter().take(length) {
            let number = value.after(before).wrapping_add(COUNTED) as usize;
            before = value;
            if let Some(count) = counts.get_mut(number) {
                *count += 1;
            }
        }
    }
    let best = counts.iter().enumerate().max_by_key(|(_, count)| **count);
    best.map_or(0, |(at, _)| at as i64 - COUNTED)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn plain(bytes: &[u8], most: usize) -> Vec<u8> {
        if bytes[0] == 0 {
            return lz4_flex::block::decompress(&bytes[1..], most).unwrap();
        }
        let (mut out, mut rest) = (Vec::new(), &bytes[1..]);
        for _ in 0..bytes[0] {
            let length = i32::from_le_bytes(rest[..4].try_into().unwrap()) as usize;
            out.extend(lz4_flex::block::decompress(&rest[4..4 + length], most).unwrap());
            rest = &rest[4 + length..];
        }
        assert!(rest.is_empty());
        out
    }

    /// As the format is described, not as it is written above.
    fn decoded<const WIDTH: usize>(bytes: &[u8], count: usize) -> Vec<i64> {
        if count == 0 {
            return Vec::new();
        }
        let number = |b: &[u8]| {
            let fill = if b.last().unwrap() & 0x80 == 0 { 0 } else { 0xFF };
            let mut all = [fill; 8];
            all[..b.len()].copy_from_slice(b);
            i64::from_le_bytes(all)
        };
        let common = number(&bytes[..WIDTH]);
        let (codes, mut rest) = bytes[WIDTH..].split_at((count * 2).div_ceil(8));
        let mut value = 0i64;
        let mut out = Vec::new();
        for k in 0..count {
            let length =
                [0, WIDTH / 4, WIDTH / 2, WIDTH][usize::from(codes[k / 4] >> (2 * (k % 4)) & 3)];
            let step = if length == 0 { common } else { number(&rest[..length]) };
            rest = &rest[length..];
            value = value.wrapping_add(step);
            out.push(if WIDTH == 4 { i64::from(value as i32) } else { value });
        }
        assert!(rest.is_empty());
        out
    }

    #[test]
    fn the_example_of_the_format() {
        let values = [123, 124, 125, 100_125, 100_125, 100_126, 100_126];
        let bytes = plain(&ints(&values), 100);
        let expected =
            [&[1, 0, 0, 0, 0b1100_0001, 0b01_0001][..], &[123, 0xA0, 0x86, 0x01, 0x00, 0, 0]];
        assert_eq!(bytes, expected.concat());
    }

    #[test]
    fn several_blocks_have_their_lengths() {
        let bytes: Vec<u8> = (0..1000u32).map(|i| (i / 7) as u8).collect();
        for most in [10, 333, 1000, 2000] {
            assert_eq!(plain(&in_blocks(&bytes, most), 1000), bytes, "{most}");
        }
        assert_eq!(plain(&compressed(&[]), 10), b"");
    }

    #[test]
    fn long_columns_are_as_if_coded_at_once() {
        let values: Vec<i32> =
            (0..3 * PIECE as i64 + 5).map(|k| (k / 3 * 70_000 % 991) as i32).collect();
        let bytes = plain(&ints(&values), 20 * PIECE);
        let back = decoded::<4>(&bytes, values.len());
        assert!(back.iter().eq(&values.iter().map(|v| i64::from(*v)).collect::<Vec<_>>()));
        let noise: Vec<u8> = (0..3 * BLOCK as u64).map(|k| (k.pow(2) / 7) as u8).collect();
        let packed = compressed(&noise);
        assert!(packed[0] == 3 && plain(&packed, noise.len()) == noise);
    }

    #[test]
    fn repetition_is_as_if_written_out() {
        for count in [0, 1, 3, 4, 5, 1000] {
            assert_eq!(repeated(3, count), ints(&vec![3; count]));
        }
    }

    proptest! {
        #[test]
        fn short_integers_return(values in prop::collection::vec(
            prop_oneof![any::<i32>(), -200..200i32, 0..70_000i32], 0..300)) {
            let bytes = plain(&ints(&values), 10_000);
            let back = decoded::<4>(&bytes, values.len());
            prop_assert_eq!(back, values.iter().map(|v| i64::from(*v)).collect::<Vec<_>>());
        }

        #[test]
        fn long_integers_return(values in prop::collection::vec(
            prop_oneof![any::<i64>(), -200..200i64, any::<i32>().prop_map(i64::from)], 0..300)) {
            let bytes = plain(&long_ints(&values), 10_000);
            prop_assert_eq!(decoded::<8>(&bytes, values.len()), values);
        }
    }
}
