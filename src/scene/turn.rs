//! Turns about Z that half floats hold. USD's `orientations` are quaternions of half floats, which turn
//! by up to 0.03° too far: 5 mm at the rim of a wide crown. For trees that may stand at any azimuth
//! it is drawn among those whose quaternion stays of unit length when its parts are rounded to
//! halves, so that all formats and readers put every twig to the same tenth of a millimetre.

use std::sync::LazyLock;

use crate::seed::Draws;

/// How far the squared length of the rounded quaternion may be off 1: 0.1 mm at 10 m.
const TOLERANCE: f64 = 8e-6;
/// Bits of the significand of a half float, with its leading one.
const HALF_BITS: i32 = 11;

/// In radians, 0 to 2π. 264 of them, nowhere more than 10° apart.
static TURNS: LazyLock<Vec<f32>> = LazyLock::new(|| {
    // Both parts as wholes times 2⁻¹⁶: the halves from 2⁻⁶, whose last bit stands for that, to 1.
    let of_real = |real: f64| -> Option<f64> {
        let other = nearest_half((1.0 - real * real).max(0.0).sqrt());
        let is_clean = nearest_half(real) == real
            && (real * real + other * other - 1.0).abs() < TOLERANCE
            && other > 0.0;
        is_clean.then(|| 2.0 * other.atan2(real))
    };
    let half_circle = (1 << 10..1 << 16).filter_map(|k| of_real(f64::from(k) / 65_536.0));
    let mut turns: Vec<f64> =
        half_circle.flat_map(|turn| [turn, std::f64::consts::TAU - turn]).collect();
    turns.sort_unstable_by(f64::total_cmp);
    turns.into_iter().map(|turn| turn as f32).collect()
});

/// Of a positive normal number.
fn nearest_half(v: f64) -> f64 {
    let exponent = (v.to_bits() >> 52) as i32 - 1023;
    let last_bit = f64::from(2.0f32.powi(exponent + 1 - HALF_BITS));
    (v / last_bit).round() * last_bit
}

/// One of them, radians.
pub fn draw(draws: &mut Draws) -> f32 {
    TURNS.get(draws.index(TURNS.len())).copied().unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn turns_survive_half_floats_and_lie_all_around() {
        assert_eq!(TURNS.len(), 264);
        let around = TURNS.iter().zip(TURNS.iter().skip(1)).map(|(a, b)| b - a);
        assert!(around.fold(0.0, f32::max) < 10f32.to_radians());
        assert!(TURNS[0] + std::f32::consts::TAU - TURNS[263] < 10f32.to_radians());
        for turn in TURNS.iter() {
            let (sin, cos) = (0.5 * turn).sin_cos();
            let half = |v: f32| nearest_half(f64::from(v.abs())) * f64::from(v.signum());
            let off = (half(sin).atan2(half(cos)) - f64::from(0.5 * turn)).abs();
            assert!(off < 1e-6, "{turn}: {off}");
            assert!((half(sin).hypot(half(cos)) - 1.0).abs() < TOLERANCE);
        }
    }
}
