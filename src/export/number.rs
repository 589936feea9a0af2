//! Numbers as text files hold them.

use std::hint::select_unpredictable;

/// The fewest digits that read back as the same f32, and of those the nearest; zero has no sign.
///
/// Between 0.0001 and 8192 in whole numbers, which is exact and has no branch that is hard to
/// foresee: the nearest decimal of a step no finer than f32's own is the shortest where it lies
/// within half of that, else one of a tenth of the step always does (the idea of Adams, *Ryū*,
/// PLDI 2018, and Giulietti, *The Schubfach way to render doubles*, 2020). All others, and ties, as
/// `zmij` has them.
#[inline]
pub(super) fn shortest(out: &mut Vec<u8>, value: f32) {
    let bits = value.to_bits();
    let exponent = (bits >> 23 & 0xFF) as i32 - 127;
    let Some(binade) = BINADES.get(exponent.wrapping_sub(LEAST_EXPONENT) as usize) else {
        return any_shortest(out, value);
    };
    let fraction = u64::from(bits & 0x7F_FFFF);
    let significand = fraction | 1 << 23;
    // Binary places of the significand.
    let places = (23 - exponent) as u32 & 63;
    let half = (1u64 << places) >> 1;
    let exact = significand * binade.unit;
    let near = (exact + half) >> places;
    let twice_off = 2 * exact.abs_diff(near << places);
    // A power of two has a nearer neighbour below.
    if twice_off == binade.unit || (fraction == 0 && twice_off != 0) {
        return any_shortest(out, value);
    }
    let exact = 10 * exact;
    let finer = (exact + half - 1 + (exact >> places & 1)) >> places;
    let digits = select_unpredictable(twice_off < binade.unit, 10 * near, finer);
    let unit = 10 * binade.unit;
    let whole = significand >> places;
    let part = digits - whole * unit;
    let (whole, part) = if part < unit { (whole, part) } else { (whole + 1, 0) };
    put(out, bits >> 31 == 1, whole, part * binade.rest, false);
}

/// Numbers from 2^e on, below 2^(e + 1).
#[derive(Clone, Copy)]
struct Binade {
    /// 10^n, with the most places n whose step is no finer than that of f32.
    unit: u64,
    /// 10^([`PLACES`] − n − 1).
    rest: u64,
}

/// Exponents of the binades; below, there would be more places than [`PLACES`], above, more than
/// four digits before the point.
const LEAST_EXPONENT: i32 = -13;
const MOST_EXPONENT: i32 = 12;
const PLACES: usize = 12;

/// Powers of ten.
static TENS: [u64; PLACES + 1] = {
    let mut all = [1; PLACES + 1];
    let mut k = 1;
    while k < all.len() {
        all[k] = 10 * all[k - 1];
        k += 1;
    }
    all
};

static BINADES: [Binade; (MOST_EXPONENT - LEAST_EXPONENT + 1) as usize] = {
    let mut all = [Binade { unit: 1, rest: 1 }; (MOST_EXPONENT - LEAST_EXPONENT + 1) as usize];
    let mut k = 0;
    while k < all.len() {
        let steps = 1 << (23 - LEAST_EXPONENT - k as i32);
        let mut n = 0;
        while TENS[n + 1] <= steps {
            n += 1;
        }
        all[k] = Binade { unit: TENS[n], rest: TENS[PLACES - 1 - n] };
        k += 1;
    }
    all
};

#[cold]
fn any_shortest(out: &mut Vec<u8>, value: f32) {
    let mut buffer = zmij::Buffer::new();
    // `+ 0.0` takes the sign off a zero.
    let text = buffer.format(value + 0.0);
    out.extend_from_slice(text.strip_suffix(".0").unwrap_or(text).as_bytes());
}

/// The values of four digits, the first in the lowest byte.
static FOUR_DIGITS: [u32; 10_000] = {
    let mut all = [0; 10_000];
    let mut k = 0;
    while k < all.len() {
        let (high, low) = ((k / 100) as u8, (k % 100) as u8);
        all[k] = u32::from_le_bytes([high / 10, high % 10, low / 10, low % 10]);
        k += 1;
    }
    all
};

const ZEROS: u64 = 0x3030_3030_3030_3030;

fn four_digits(k: u64) -> u64 {
    FOUR_DIGITS.get(k as usize).copied().unwrap_or(0).into()
}

/// `whole` < 10,000 and `part` / 10^[`PLACES`], without zeros at the end; `is_bare`: without the one
/// before the point.
#[inline(always)]
fn put(out: &mut Vec<u8>, is_negative: bool, whole: u64, part: u64, is_bare: bool) {
    const ROOM: usize = 1 + 4 + 1 + PLACES;
    let (high, last) = (part / 10_000, four_digits(part % 10_000));
    let first = four_digits(high / 10_000) | four_digits(high % 10_000) << 32;
    let places = match (first, last) {
        (0, 0) => 0,
        (_, 0) => 8 - first.leading_zeros() as usize / 8,
        _ => 16 - last.leading_zeros() as usize / 8,
    };
    let whole = four_digits(whole);
    let least = if is_bare && places > 0 { 1 << 32 } else { 1 << 24 };
    let unwritten = (whole | least).trailing_zeros() / 8;
    // Stored in pieces of one length, of which some is then cut off.
    let start = out.len();
    out.extend_from_slice(&[0; ROOM]);
    let Some(to) = out[start..].first_chunk_mut::<ROOM>() else { return };
    to[0] = b'-';
    let at = usize::from(is_negative);
    to[at..at + 4].copy_from_slice(&(((whole | ZEROS) >> (8 * unwritten)) as u32).to_le_bytes());
    let at = at + 4 - (unwritten as usize).min(4);
    to[at] = b'.';
    to[at + 1..at + 9].copy_from_slice(&(first | ZEROS).to_le_bytes());
    to[at + 9..at + 13].copy_from_slice(&((last | ZEROS) as u32).to_le_bytes());
    out.truncate(start + at + places + usize::from(places > 0));
}

/// `values` by [`shortest`], a space between them.
pub(super) fn shortest_of(out: &mut Vec<u8>, values: &[f32]) {
    spaced(out, values, |out, &v| shortest(out, v));
}

/// Rounded to so many places (at most 9), without zeros that say nothing: `-.5`, `12`.
#[inline]
pub(super) fn rounded(out: &mut Vec<u8>, value: f32, places: u32) {
    /// Of four digits, rounded.
    const LARGE: f32 = 9_999.0;
    let places = places.min(9) as usize;
    let size = value.abs();
    if size.is_nan() || size >= LARGE {
        return round_large(out, value, places);
    }
    let unit = TENS[places];
    let scaled = (f64::from(size) * unit as f64 + 0.5) as i64 as u64;
    let whole = u64::from(size as i32 as u32);
    let part = scaled - whole * unit;
    let (whole, part) = if part < unit { (whole, part) } else { (whole + 1, 0) };
    put(out, value < 0.0 && scaled > 0, whole, part * TENS[PLACES - places], true);
}

#[cold]
fn round_large(out: &mut Vec<u8>, value: f32, places: usize) {
    /// Beyond, f32 has no places.
    const WHOLE: f32 = 16_777_216.0;
    if value.is_nan() || value.abs() >= WHOLE {
        return any_shortest(out, value);
    }
    let text = format!("{value:.places$}");
    let text = if places > 0 { text.trim_end_matches('0').trim_end_matches('.') } else { &text };
    out.extend_from_slice(text.as_bytes());
}

#[inline]
pub(super) fn integer(out: &mut Vec<u8>, value: i64) {
    let Some(k) = u64::try_from(value).ok().filter(|k| *k < 100_000_000) else {
        return out.extend_from_slice(itoa::Buffer::new().format(value).as_bytes());
    };
    let digits = four_digits(k / 10_000) | four_digits(k % 10_000) << 32;
    let unwritten = (digits | 1 << 56).trailing_zeros() / 8;
    let length = out.len() + 8 - unwritten as usize;
    out.extend_from_slice(&((digits | ZEROS) >> (8 * unwritten)).to_le_bytes());
    out.truncate(length);
}

/// The items with a space between them.
pub(super) fn spaced<T>(out: &mut Vec<u8>, items: &[T], write: impl Fn(&mut Vec<u8>, &T)) {
    for (at, item) in items.iter().enumerate() {
        if at > 0 {
            out.push(b' ');
        }
        write(out, item);
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::seed::Seed;

    fn text(write: impl FnOnce(&mut Vec<u8>)) -> String {
        let mut out = Vec::new();
        write(&mut out);
        String::from_utf8(out).unwrap()
    }

    #[test]
    fn numbers_as_they_look() {
        for (value, expected) in
            [(0.0, "0"), (-0.0, "0"), (12.0, "12"), (-0.5, "-0.5"), (0.1, "0.1"), (1e-7, "1e-7")]
        {
            assert_eq!(text(|out| shortest(out, value)), expected);
        }
        for (value, places, expected) in [
            (0.0, 3, "0"),
            (-0.0, 3, "0"),
            (-0.0004, 3, "0"),
            (0.0005, 3, ".001"),
            (-0.5, 3, "-.5"),
            (0.9996, 3, "1"),
            (12.0301, 3, "12.03"),
            (-1234.5678, 2, "-1234.57"),
            (7.5, 0, "8"),
            (3e9, 3, "3000000000"),
            (9_998.999_9, 2, "9999"),
            (-12_345.678, 2, "-12345.68"),
            (20_000.0, 3, "20000"),
            (0.00004, 5, ".00004"),
        ] {
            assert_eq!(text(|out| rounded(out, value, places)), expected);
        }
        assert_eq!(text(|out| shortest_of(out, &[1.0, 0.25])), "1 0.25");
    }

    /// Against a formatter for all numbers: every sign and exponent, ties and borders among them.
    #[test]
    fn the_shortest_are_those_of_any_number() {
        let mut draws = Seed::new(1).derive("digits", 0).draws();
        let drawn: Vec<u32> = (0..3000).map(|_| draws.between(0.0, 8_388_608.0) as u32).collect();
        let border = [0, 1, 2, 3, 1 << 22, (1 << 23) - 2, (1 << 23) - 1];
        let ties = (0..13).flat_map(|k| [1, 3, 5].map(|odd| odd << k));
        let fractions: Vec<u32> = drawn.into_iter().chain(border).chain(ties).collect();
        for sign_and_exponent in 0..512u32 {
            for fraction in &fractions {
                let value = f32::from_bits(sign_and_exponent << 23 | fraction);
                let expected = text(|out| any_shortest(out, value));
                assert_eq!(text(|out| shortest(out, value)), expected);
            }
        }
    }

    #[test]
    fn integers_of_any_length() {
        let tens = (0..19).map(|k| 10i64.pow(k));
        for n in tens.flat_map(|n| [n - 1, n, 7 * (n / 3), -n]).chain([i64::MIN, i64::MAX]) {
            assert_eq!(text(|out| integer(out, n)), n.to_string());
        }
    }

    proptest! {
        #[test]
        fn the_shortest_reads_back_as_the_same(bits: u32) {
            let value = f32::from_bits(bits);
            prop_assume!(value.is_finite());
            let read: f32 = text(|out| shortest(out, value)).parse().unwrap();
            prop_assert_eq!(read, value);
        }

        #[test]
        fn what_is_rounded_is_within_half_a_place(value in -1e6f32..1e6, places in 0u32..5) {
            let written = text(|out| rounded(out, value, places));
            let read: f64 = written.parse().unwrap();
            let half = 0.5 / 10f64.powi(places as i32);
            prop_assert!((read - f64::from(value)).abs() <= half * (1.0 + 1e-6), "{}", written);
            prop_assert!(!written.contains('.') || !written.ends_with(['0', '.']), "{}", written);
            prop_assert!(!written.starts_with("0.") && written != "-0", "{}", written);
        }
    }
}
