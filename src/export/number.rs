//! Numbers as text files hold them.

/// The fewest digits that read back as the same f32; zero has no sign.
pub(super) fn shortest(out: &mut Vec<u8>, value: f32) {
    let mut buffer = zmij::Buffer::new();
    // `+ 0.0` takes the sign off a zero.
    let text = buffer.format(value + 0.0);
    out.extend_from_slice(text.strip_suffix(".0").unwrap_or(text).as_bytes());
}

/// `values` by [`shortest`], a space between them.
pub(super) fn shortest_of(out: &mut Vec<u8>, values: &[f32]) {
    spaced(out, values, |out, &v| shortest(out, v));
}

/// Rounded to so many places (at most 9), without zeros that say nothing: `-.5`, `12`.
pub(super) fn rounded(out: &mut Vec<u8>, value: f32, places: u32) {
    /// Beyond, f32 has no places, and a product would leave i64.
    const LARGE: f32 = 1e9;
    if value.is_nan() || value.abs() >= LARGE {
        return shortest(out, value);
    }
    let unit = 10u64.pow(places.min(9));
    let scaled = (f64::from(value) * unit as f64).round() as i64;
    if scaled < 0 {
        out.push(b'-');
    }
    let (whole, part) = (scaled.unsigned_abs() / unit, scaled.unsigned_abs() % unit);
    if whole > 0 || part == 0 {
        integer(out, whole);
    }
    if part > 0 {
        out.push(b'.');
        let (mut rest, mut place) = (part, unit / 10);
        while rest > 0 {
            out.push(b'0' + (rest / place) as u8);
            rest %= place;
            place /= 10;
        }
    }
}

pub(super) fn integer(out: &mut Vec<u8>, value: impl itoa::Integer) {
    out.extend_from_slice(itoa::Buffer::new().format(value).as_bytes());
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
        ] {
            assert_eq!(text(|out| rounded(out, value, places)), expected);
        }
        assert_eq!(text(|out| shortest_of(out, &[1.0, 0.25])), "1 0.25");
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
