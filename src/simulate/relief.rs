//! The ground of a simulated stand: a function in closed form.

use std::f64::consts::TAU;

use crate::seed::Seed;

/// A plane wave of height.
#[derive(Debug, Clone, Copy)]
struct Wave {
    /// Radians a metre, east and north.
    k: [f64; 2],
    phase: f64,
    amplitude_m: f64,
}

/// Slope, hills and roughness; heights in local metres.
#[derive(Debug, Clone)]
pub struct Relief {
    base_m: f64,
    slope: [f64; 2],
    waves: Vec<Wave>,
}

impl Relief {
    /// Hills between 0 and `relief_m` over a square of `side_m`, with roughness of a few
    /// centimetres on top.
    pub fn new(side_m: f32, relief_m: f32, seed: Seed) -> Relief {
        let mut draws = seed.derive("relief", 0).draws();
        let side = f64::from(side_m).max(1.0);
        let mut wave = |length: [f32; 2], amplitude_m: f64| {
            let length = f64::from(draws.between(length[0], length[1]));
            let (s, c) = (f64::from(draws.unit()) * TAU).sin_cos();
            let k = TAU / length;
            Wave { k: [c * k, s * k], phase: f64::from(draws.unit()) * TAU, amplitude_m }
        };
        let long = side as f32;
        let mut waves: Vec<Wave> = [0.9f32, 0.6, 0.45, 0.3]
            .into_iter()
            .map(|share| {
                let length = (long * share).max(12.0);
                wave([length, length * 1.3], f64::from(share) * f64::from(share))
            })
            .collect();
        let hills = waves.len();
        waves.extend((0..4).map(|_| wave([4.0, 11.0], 0.035)));
        let mut relief = Relief { base_m: 0.0, slope: [0.4 / side, 0.25 / side], waves };
        // The hills alone are stretched to the asked range.
        let only_hills = Relief { waves: relief.waves[..hills].to_vec(), ..relief.clone() };
        let n = 96;
        let at = |i: i32| side * f64::from(i) / f64::from(n);
        let (mut low, mut high) = (f64::MAX, f64::MIN);
        for j in 0..=n {
            for i in 0..=n {
                let z = only_hills.height_at(at(i), at(j));
                low = low.min(z);
                high = high.max(z);
            }
        }
        let gain = f64::from(relief_m.max(0.0)) / (high - low).max(1e-9);
        for w in &mut relief.waves[..hills] {
            w.amplitude_m *= gain;
        }
        relief.slope = relief.slope.map(|s| s * gain);
        relief.base_m = -low * gain;
        relief
    }

    /// Height at a place, local metres.
    pub fn height_at(&self, x: f64, y: f64) -> f64 {
        let plane = self.base_m + self.slope[0] * x + self.slope[1] * y;
        let wave = |w: &Wave| w.amplitude_m * (w.k[0] * x + w.k[1] * y + w.phase).sin();
        plane + self.waves.iter().map(wave).sum::<f64>()
    }
}
