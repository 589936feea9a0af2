//! Numbers as text files hold them.

use std::hint::select_unpredictable;

/// A text that grows. A number is stored in a piece of one length, of which some is then written over.
pub(super) struct Pen {
    bytes: Vec<u8>,
    /// Of the text; beyond is room.
    end: usize,
}

/// Of the longest number in one piece.
const ROOM: usize = 24;
/// Of the longest row: four numbers with what is about them.
const ROW: usize = 128;

/// A few numbers that are stored as one.
pub(super) struct Row<'p> {
    bytes: &'p mut [u8; ROW],
    end: usize,
}

impl Row<'_> {
    #[inline(always)]
    pub fn text<const N: usize>(&mut self, text: &[u8; N]) {
        if let Some(room) = self.bytes.get_mut(self.end..self.end + N) {
            room.copy_from_slice(text);
        }
        self.end += N;
    }

    /// As [`shortest`] has it.
    #[inline(always)]
    pub fn shortest(&mut self, value: f32) {
        let room = self.bytes.get_mut(self.end..).and_then(|b| b.first_chunk_mut());
        if let Some(room) = room {
            self.end += shortest_in(room, value);
        }
    }

    #[inline(always)]
    pub fn integer(&mut self, value: i64) {
        let room = self.bytes.get_mut(self.end..).and_then(|b| b.first_chunk_mut());
        if let Some(room) = room {
            self.end += integer_in(room, value);
        }
    }
}

impl Pen {
    pub fn new() -> Self {
        Pen { bytes: Vec::new(), end: 0 }
    }

    pub fn clear(&mut self) {
        self.end = 0;
    }

    pub fn as_bytes(&self) -> &[u8] {
        self.bytes.get(..self.end).unwrap_or_default()
    }

    pub fn push(&mut self, byte: u8) {
        self.piece(|room| {
            room[0] = byte;
            1
        });
    }

    #[inline]
    pub fn text(&mut self, text: &[u8]) {
        let end = self.end + text.len();
        if self.bytes.len() < end {
            self.grow(text.len());
        }
        if let Some(room) = self.bytes.get_mut(self.end..end) {
            room.copy_from_slice(text);
            self.end = end;
        }
    }

    /// `store` gives how much of what it stored is text.
    #[inline(always)]
    fn piece(&mut self, store: impl FnOnce(&mut [u8; ROOM]) -> usize) {
        if self.bytes.len() < self.end + ROOM {
            self.grow(ROOM);
        }
        let room = self.bytes.get_mut(self.end..).and_then(|b| b.first_chunk_mut());
        if let Some(room) = room {
            self.end += store(room);
        }
    }

    #[inline(always)]
    pub fn row(&mut self, store: impl FnOnce(&mut Row<'_>)) {
        if self.bytes.len() < self.end + ROW {
            self.grow(ROW);
        }
        let room = self.bytes.get_mut(self.end..).and_then(|b| b.first_chunk_mut());
        if let Some(bytes) = room {
            let mut row = Row { bytes, end: 0 };
            store(&mut row);
            self.end += row.end;
        }
    }

    #[cold]
    fn grow(&mut self, by: usize) {
        const LEAST: usize = 1 << 10;
        self.bytes.resize((self.end + by).next_power_of_two().max(LEAST), 0);
    }
}

impl From<Vec<u8>> for Pen {
    fn from(bytes: Vec<u8>) -> Self {
        Pen { end: bytes.len(), bytes }
    }
}

/// The fewest digits that read back as the same f32, and of those the nearest; zero has no sign.
///
/// Between 0.0001 and 8192 in whole numbers, which is exact and has no branch that is hard to
/// foresee: the nearest decimal of a step no finer than f32's own is the shortest where it lies
/// within half of that, else one of a tenth of the step always does (the idea of Adams, *Ryū*,
/// PLDI 2018, and Giulietti, *The Schubfach way to render doubles*, 2020). All others, and ties, as
/// `zmij` has them.
#[inline]
pub(super) fn shortest(out: &mut Pen, value: f32) {
    out.piece(|to| shortest_in(to, value));
}

/// Gives how much of what it stored is text.
#[inline(always)]
fn shortest_in(to: &mut [u8; ROOM], value: f32) -> usize {
    let bits = value.to_bits();
    let exponent = (bits >> 23 & 0xFF).wrapping_sub((127 + LEAST_EXPONENT) as u32);
    let Some(binade) = BINADES.get(exponent as usize) else { return any_shortest(to, value) };
    let fraction = u64::from(bits & 0x7F_FFFF);
    // All binades have their point at one place.
    let exact = (fraction | 1 << 23) * binade.unit;
    let near = (exact + HALF) >> POINT;
    let twice_off = 2 * exact.abs_diff(near << POINT);
    // A power of two has a nearer neighbour below.
    if twice_off == binade.unit || (fraction == 0 && twice_off != 0) {
        return any_shortest(to, value);
    }
    let exact = 10 * exact;
    let finer = (exact + HALF - 1 + (exact >> POINT & 1)) >> POINT;
    let digits = select_unpredictable(twice_off < binade.unit, 10 * near, finer);
    put(to, bits >> 31 == 1, digits * binade.rest, false)
}

/// Numbers from 2^e on, below 2^(e + 1).
#[derive(Clone, Copy)]
struct Binade {
    /// What a step of f32 is in steps of 10^-n, 2^-[`POINT`] each, with the most places n whose step is
    /// no finer than that of f32.
    unit: u64,
    /// 10^([`PLACES`] − n − 1).
    rest: u64,
}

/// Exponents of the binades; below, there would be more places than [`PLACES`], above, more than
/// four digits before the point.
const LEAST_EXPONENT: i32 = -13;
const MOST_EXPONENT: i32 = 12;
const PLACES: usize = 12;
/// Binary places of the least binade.
const POINT: i32 = 23 - LEAST_EXPONENT;
const HALF: u64 = 1 << (POINT - 1);

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
        let steps = 1 << (POINT - k as i32);
        let mut n = 0;
        while TENS[n + 1] <= steps {
            n += 1;
        }
        all[k] = Binade { unit: TENS[n] << k, rest: TENS[PLACES - 1 - n] };
        k += 1;
    }
    all
};

#[cold]
fn any_shortest(to: &mut [u8; ROOM], value: f32) -> usize {
    let mut buffer = zmij::Buffer::new();
    // `+ 0.0` takes the sign off a zero.
    let text = buffer.format(value + 0.0);
    let text = text.strip_suffix(".0").unwrap_or(text).as_bytes();
    // No f32 has a longer one.
    let length = text.len().min(ROOM);
    to[..length].copy_from_slice(&text[..length]);
    length
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

/// Of a number below 10^8.
#[inline(always)]
fn eight_digits(k: u64) -> u64 {
    let four = |k: u64| u64::from(FOUR_DIGITS.get(k as usize).copied().unwrap_or(0));
    four(k / 10_000) | four(k % 10_000) << 32
}

/// `parts` / 10^[`PLACES`] < 10,000, without zeros at the end; `is_bare`: without the one before the
/// point. Gives how much of what it stored is text.
#[inline(always)]
fn put(to: &mut [u8; ROOM], is_negative: bool, parts: u64, is_bare: bool) -> usize {
    const LOW: u64 = 100_000_000;
    let (high, low) = (eight_digits(parts / LOW), eight_digits(parts % LOW));
    let (whole, first) = (high & 0xFFFF_FFFF, high >> 32);
    let places = match low {
        0 => 8 - first.leading_zeros() as usize / 8,
        _ => 12 - low.leading_zeros() as usize / 8,
    };
    let least = if is_bare && places > 0 { 1 << 32 } else { 1 << 24 };
    let unwritten = (whole | least).trailing_zeros() as usize / 8;
    to[0] = b'-';
    let at = usize::from(is_negative);
    let whole = (whole | ZEROS) >> (8 * unwritten);
    to[at..at + 4].copy_from_slice(&(whole as u32).to_le_bytes());
    let at = at + 4 - unwritten.min(4);
    to[at] = b'.';
    to[at + 1..at + 5].copy_from_slice(&((first | ZEROS) as u32).to_le_bytes());
    to[at + 5..at + 13].copy_from_slice(&(low | ZEROS).to_le_bytes());
    at + places + usize::from(places > 0)
}

/// `values` by [`shortest`], a space between them.
pub(super) fn shortest_of(out: &mut Pen, values: &[f32]) {
    spaced(out, values, |out, &v| shortest(out, v));
}

/// Rounded to so many places (at most 9), without zeros that say nothing: `-.5`, `12`.
#[inline]
pub(super) fn rounded(out: &mut Pen, value: f32, places: u32) {
    /// Of four digits, rounded.
    const LARGE: f32 = 9_999.0;
    let places = places.min(9) as usize;
    let size = value.abs();
    if size.is_nan() || size >= LARGE {
        return round_large(out, value, places);
    }
    let scaled = (f64::from(size) * TENS[places] as f64 + 0.5) as i64 as u64;
    out.piece(|to| put(to, value < 0.0 && scaled > 0, scaled * TENS[PLACES - places], true));
}

#[cold]
fn round_large(out: &mut Pen, value: f32, places: usize) {
    /// Beyond, f32 has no places.
    const WHOLE: f32 = 16_777_216.0;
    if value.is_nan() || value.abs() >= WHOLE {
        return out.piece(|to| any_shortest(to, value));
    }
    let text = format!("{value:.places$}");
    let text = if places > 0 { text.trim_end_matches('0').trim_end_matches('.') } else { &text };
    out.text(text.as_bytes());
}

#[inline]
pub(super) fn integer(out: &mut Pen, value: i64) {
    out.piece(|to| integer_in(to, value));
}

/// Gives how much of what it stored is text.
#[inline(always)]
fn integer_in(to: &mut [u8; ROOM], value: i64) -> usize {
    let Some(k) = u64::try_from(value).ok().filter(|k| *k < 100_000_000) else {
        return any_integer(to, value);
    };
    let digits = eight_digits(k);
    let unwritten = (digits | 1 << 56).trailing_zeros() / 8;
    to[..8].copy_from_slice(&((digits | ZEROS) >> (8 * unwritten)).to_le_bytes());
    8 - unwritten as usize
}

#[cold]
fn any_integer(to: &mut [u8; ROOM], value: i64) -> usize {
    let mut buffer = itoa::Buffer::new();
    let text = buffer.format(value).as_bytes();
    // None is longer.
    let length = text.len().min(ROOM);
    to[..length].copy_from_slice(&text[..length]);
    length
}

/// The items with a space between them.
pub(super) fn spaced<T>(out: &mut Pen, items: &[T], write: impl Fn(&mut Pen, &T)) {
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

    fn text(write: impl FnOnce(&mut Pen)) -> String {
        let mut out = Pen::new();
        write(&mut out);
        String::from_utf8(out.as_bytes().to_vec()).unwrap()
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
                let expected = text(|out| out.piece(|to| any_shortest(to, value)));
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
