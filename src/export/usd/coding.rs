//! The two codings of crate files: LZ4 blocks with a count of chunks before them, and integers as
//! differences in 0, 1, 2 or 4 bytes (0, 2, 4 or 8 for long ones), as OpenUSD's `fastCompression`
//! and `integerCoding` read them.

use lz4_flex::block::{compress_into, get_maximum_output_size};

/// The longest input of one LZ4 block.
const MOST_IN_BLOCK: usize = 0x7E00_0000;
/// Differences of a smaller size than this are counted for the most common one.
const COUNTED: i64 = 1 << 15;

/// A byte that says how many blocks follow, each after its length; 0 for one block without.
pub(super) fn compressed(bytes: &[u8]) -> Vec<u8> {
    in_blocks(bytes, MOST_IN_BLOCK)
}

fn in_blocks(bytes: &[u8], most: usize) -> Vec<u8> {
    let is_one = bytes.len() <= most;
    let count = bytes.len().div_ceil(most);
    let room = bytes.chunks(most).map(|b| 4 + get_maximum_output_size(b.len())).sum::<usize>();
    let mut out = vec![0; 1 + room.max(get_maximum_output_size(0))];
    out[0] = if is_one { 0 } else { count as u8 };
    let mut at = 1;
    // Nothing is a block, too.
    for block in bytes.chunks(most).chain(bytes.is_empty().then_some(bytes)) {
        let start = if is_one { at } else { at + 4 };
        // Cannot fail: there is room for the longest output.
        let length = compress_into(block, &mut out[start..]).unwrap_or(0);
        if !is_one {
            out[at..start].copy_from_slice(&(length as i32).to_le_bytes());
        }
        at = start + length;
    }
    out.truncate(at);
    out
}

pub(super) fn ints(values: &[i32]) -> Vec<u8> {
    let differences = || {
        let before = [0].into_iter().chain(values.iter().copied());
        values.iter().zip(before).map(|(&v, b)| i64::from(v.wrapping_sub(b)))
    };
    compressed(&coded::<4, _>(values.len(), differences))
}

pub(super) fn unsigned(values: &[u32]) -> Vec<u8> {
    ints(bytemuck::cast_slice(values))
}

pub(super) fn long_ints(values: &[i64]) -> Vec<u8> {
    let differences = || {
        let before = [0].into_iter().chain(values.iter().copied());
        values.iter().zip(before).map(|(&v, b)| v.wrapping_sub(b))
    };
    compressed(&coded::<8, _>(values.len(), differences))
}

/// `count` times the same.
pub(super) fn repeated(value: i32, count: usize) -> Vec<u8> {
    let differences = || std::iter::once(i64::from(value)).chain(std::iter::repeat_n(0, count - 1));
    if count == 0 { compressed(&[]) } else { compressed(&coded::<4, _>(count, differences)) }
}

/// The most common difference, two bits a difference, then those that are not the most common in
/// as few bytes as hold them. `WIDTH`: bytes of the integers.
fn coded<const WIDTH: usize, I: Iterator<Item = i64>>(
    count: usize,
    differences: impl Fn() -> I,
) -> Vec<u8> {
    if count == 0 {
        return Vec::new();
    }
    let common = most_common(differences());
    let codes = count.div_ceil(4);
    let mut out = vec![0; WIDTH + codes + count * WIDTH];
    let (head, rest) = out.split_at_mut(WIDTH + codes);
    head[..WIDTH].copy_from_slice(&common.to_le_bytes()[..WIDTH]);
    let mut at = 0;
    for (k, difference) in differences().enumerate() {
        let (code, bytes) = if difference == common {
            (0, 0)
        } else if fits(difference, WIDTH / 4) {
            (1, WIDTH / 4)
        } else if fits(difference, WIDTH / 2) {
            (2, WIDTH / 2)
        } else {
            (3, WIDTH)
        };
        head[WIDTH + k / 4] |= code << (2 * (k % 4));
        rest[at..at + bytes].copy_from_slice(&difference.to_le_bytes()[..bytes]);
        at += bytes;
    }
    out.truncate(WIDTH + codes + at);
    out
}

fn fits(value: i64, bytes: usize) -> bool {
    let bits = 8 * bytes as u32 - 1;
    (-(1i64 << bits)..1i64 << bits).contains(&value)
}

/// Of those of fewer than 16 bits; the largest of several.
fn most_common(differences: impl Iterator<Item = i64>) -> i64 {
    let mut counts = vec![0u32; 2 * COUNTED as usize];
    for difference in differences.filter(|d| (-COUNTED..COUNTED).contains(d)) {
        counts[(difference + COUNTED) as usize] += 1;
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
