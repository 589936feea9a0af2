//! Medians, spreads, fronts and fits, as plain functions.

/// Median, least and most of repeated measurements.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Spread {
    pub median: f64,
    pub least: f64,
    pub most: f64,
}

/// `None` of no values, or of one that is not a number.
pub fn spread(values: &[f64]) -> Option<Spread> {
    if values.iter().any(|v| v.is_nan()) {
        return None;
    }
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let (least, most) = (*sorted.first()?, *sorted.last()?);
    let half = sorted.len() / 2;
    let median =
        if sorted.len() % 2 == 1 { sorted[half] } else { 0.5 * (sorted[half - 1] + sorted[half]) };
    Some(Spread { median, least, most })
}

/// Which pairs of cost and error no other pair undercuts in one and matches in the other. Of equal
/// pairs the first is kept; one that is not a number is on no front.
pub fn pareto(pairs: &[[f64; 2]]) -> Vec<bool> {
    let beats = |a: [f64; 2], b: [f64; 2], is_earlier: bool| {
        a[0] <= b[0] && a[1] <= b[1] && (a != b || is_earlier)
    };
    let is_beaten =
        |k: usize| pairs.iter().enumerate().any(|(i, a)| i != k && beats(*a, pairs[k], i < k));
    (0..pairs.len()).map(|k| !pairs[k].iter().any(|v| v.is_nan()) && !is_beaten(k)).collect()
}

/// y = factor · x^exponent.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Power {
    pub exponent: f64,
    pub factor: f64,
}

/// Least squares of the logarithms; `None` of fewer than two x, or of what is not positive.
pub fn power(points: &[[f64; 2]]) -> Option<Power> {
    let is_sound = |v: &f64| v.is_finite() && *v > 0.0;
    if points.len() < 2 || !points.iter().flatten().all(is_sound) {
        return None;
    }
    let n = points.len() as f64;
    let logs: Vec<[f64; 2]> = points.iter().map(|p| p.map(f64::ln)).collect();
    let mean = |k: usize| logs.iter().map(|p| p[k]).sum::<f64>() / n;
    let (mx, my) = (mean(0), mean(1));
    let across: f64 = logs.iter().map(|p| (p[0] - mx).powi(2)).sum();
    let along: f64 = logs.iter().map(|p| (p[0] - mx) * (p[1] - my)).sum();
    (across > 1e-12).then(|| {
        let exponent = along / across;
        Power { exponent, factor: (my - exponent * mx).exp() }
    })
}

/// How an error falls with a step: e² = (factor · h^order)² + floor².
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Order {
    pub order: f64,
    pub factor: f64,
    /// What is left however small the step.
    pub floor: f64,
    /// RMS of the errors over the fit, minus one.
    pub off: f64,
}

/// Orders that are tried.
const ORDERS: std::ops::RangeInclusive<u32> = 10..=450;

/// The order and floor that fit steps and errors best, relative errors counting alike; `None` of
/// fewer than four, or of what is not positive.
pub fn order(points: &[[f64; 2]]) -> Option<Order> {
    const FEWEST: usize = 4;
    let is_sound = |v: &f64| v.is_finite() && *v > 0.0;
    if points.len() < FEWEST || !points.iter().flatten().all(is_sound) {
        return None;
    }
    let fits = ORDERS.map(|k| with_order(points, f64::from(k) * 0.01));
    fits.min_by(|a, b| a.off.total_cmp(&b.off))
}

/// The floor and factor for a given order: least squares of e² over its own size, neither below 0.
fn with_order(points: &[[f64; 2]], order: f64) -> Order {
    // Rows: h^2p / e² · f² + 1 / e² · g² = 1. Steps are taken over the greatest, lest powers vanish.
    let widest = points.iter().map(|p| p[0]).fold(0.0, f64::max);
    let rows =
        points.iter().map(|&[h, e]| [(h / widest).powf(2.0 * order), 1.0].map(|v| v / e / e));
    let (mut aa, mut ab, mut bb, mut a1, mut b1) = (0.0, 0.0, 0.0, 0.0, 0.0);
    for [a, b] in rows.clone() {
        aa += a * a;
        ab += a * b;
        bb += b * b;
        a1 += a;
        b1 += b;
    }
    let determinant = aa * bb - ab * ab;
    let both = ((a1 * bb - b1 * ab) / determinant, (b1 * aa - a1 * ab) / determinant);
    let (factor_sq, floor_sq) = match both {
        (f, g) if f >= 0.0 && g >= 0.0 && determinant > 0.0 => (f, g),
        (f, _) if f < 0.0 => (0.0, b1 / bb),
        _ => (a1 / aa, 0.0),
    };
    let off_sq: f64 = rows
        .map(|[a, b]| ((a * factor_sq + b * floor_sq).max(0.0).sqrt() - 1.0).powi(2))
        .sum::<f64>()
        / points.len() as f64;
    let factor = factor_sq.max(0.0).sqrt() / widest.powf(order);
    Order { order, factor, floor: floor_sq.max(0.0).sqrt(), off: off_sq.sqrt() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_spread_has_the_middle_and_the_ends() {
        let of = |v: &[f64]| spread(v).map(|s| [s.median, s.least, s.most]);
        assert_eq!(of(&[3.0, 1.0, 2.0]), Some([2.0, 1.0, 3.0]));
        assert_eq!(of(&[4.0, 1.0, 2.0, 10.0]), Some([3.0, 1.0, 10.0]));
        assert_eq!(of(&[]), None);
        assert_eq!(of(&[1.0, f64::NAN]), None);
    }

    #[test]
    fn a_front_is_what_nothing_undercuts() {
        let pairs = [[1.0, 9.0], [2.0, 5.0], [3.0, 5.0], [2.0, 6.0], [4.0, 1.0], [4.0, 1.0]];
        assert_eq!(pareto(&pairs), [true, true, false, false, true, false]);
        assert_eq!(pareto(&[[f64::NAN, 0.0], [1.0, 1.0]]), [false, true]);
    }

    #[test]
    fn a_power_is_found_exactly() {
        let points: Vec<[f64; 2]> = [1.0, 10.0, 100.0].map(|x: f64| [x, 3.0 * x.powf(1.25)]).into();
        let p = power(&points).unwrap();
        assert!((p.exponent - 1.25).abs() < 1e-9 && (p.factor - 3.0).abs() < 1e-9);
        assert_eq!(power(&points[..1]), None);
        assert_eq!(power(&[[1.0, 1.0], [1.0, 2.0]]), None);
        assert_eq!(power(&[[1.0, 0.0], [2.0, 2.0]]), None);
    }

    #[test]
    fn orders_and_floors_are_found() {
        let steps = [8.0, 4.0, 2.0, 1.0, 0.5, 0.25f64];
        for (order_of, floor) in [(1.0, 0.0), (2.0, 0.01), (2.0, 0.0), (0.5, 0.1), (4.0, 1e-5)] {
            let points: Vec<[f64; 2]> =
                steps.map(|h| [h, (0.3 * h.powf(order_of)).hypot(floor)]).into();
            let found = order(&points).unwrap();
            assert!((found.order - order_of).abs() < 0.02, "{order_of} {floor}: {found:?}");
            assert!((found.factor - 0.3).abs() < 0.01, "{found:?}");
            assert!((found.floor - floor).abs() <= 0.02 * floor + 1e-6, "{floor}: {found:?}");
            assert!(found.off < 1e-3, "{found:?}");
        }
    }

    #[test]
    fn what_does_not_fall_has_a_floor_as_high_as_itself() {
        let flat: Vec<[f64; 2]> = [8.0, 4.0, 2.0, 1.0].map(|h| [h, 0.2]).into();
        let found = order(&flat).unwrap();
        assert!((found.floor - 0.2).abs() < 1e-3, "{found:?}");
        assert_eq!(order(&flat[..3]), None);
    }
}
