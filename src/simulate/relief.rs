//! Terrain in closed form: a slope, smooth hills, a little roughness, cliffs.

use std::f64::consts::TAU;

use crate::seed::Seed;

/// A hill or hollow: a Gaussian.
#[derive(Debug, Clone, Copy)]
struct Hill {
    x: f64,
    y: f64,
    height_m: f64,
    radius_m: f64,
}

/// Ground that rises by its height within [`CLIFF_WIDTH_M`], along a line that winds northward.
#[derive(Debug, Clone, Copy)]
struct Cliff {
    x: f64,
    height_m: f64,
}

const CLIFF_WIDTH_M: f64 = 1.0;

/// What kind of terrain.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub enum Landform {
    /// A slope with hills and hollows.
    #[default]
    Hills,
    /// Next to level, with the roughness of the others.
    Level,
    /// A slope of this many degrees, with hills and hollows.
    Slope(f64),
    /// Hills with terraces, each behind a rise of so many metres.
    Cliffs(f64),
}

/// z(x, y) in local metres, defined everywhere.
#[derive(Debug, Clone)]
pub struct Relief {
    base_m: f64,
    slope: [f64; 2],
    hills: Vec<Hill>,
    waves: Vec<[f64; 4]>,
    cliffs: Vec<Cliff>,
}

impl Relief {
    /// About `range_m` between lowest and highest over a square of `side_m` from the origin.
    pub fn new(side_m: f64, range_m: f64, landform: Landform, seed: Seed) -> Self {
        let mut d = seed.derive("relief", 0).draws();
        let mut between = |low: f64, high: f64| low + (high - low) * f64::from(d.unit());
        let direction = between(0.0, TAU);
        let range_m = if landform == Landform::Level { 1.0 } else { range_m };
        let steepness = match landform {
            Landform::Slope(degrees) => degrees.to_radians().tan(),
            _ => 0.45 * range_m / side_m,
        };
        let cliffs = match landform {
            Landform::Cliffs(height_m) => {
                [0.25, 0.5, 0.75].map(|x| Cliff { x: x * side_m, height_m }).to_vec()
            }
            _ => Vec::new(),
        };
        let hills = (0..7)
            .map(|_| Hill {
                x: between(0.0, side_m),
                y: between(0.0, side_m),
                height_m: between(-0.3, 0.45) * range_m,
                radius_m: between(0.15, 0.3) * side_m,
            })
            .collect();
        let waves = (0..6)
            .map(|_| {
                let (angle, length) = (between(0.0, TAU), between(5.0, 14.0));
                let k = TAU / length;
                [k * angle.cos(), k * angle.sin(), between(0.0, TAU), 0.006 * length]
            })
            .collect();
        Relief {
            base_m: 240.0,
            slope: [steepness * direction.cos(), steepness * direction.sin()],
            hills,
            waves,
            cliffs,
        }
    }

    /// Level ground at a height.
    pub fn flat(height_m: f64) -> Self {
        Relief {
            base_m: height_m,
            slope: [0.0; 2],
            hills: Vec::new(),
            waves: Vec::new(),
            cliffs: Vec::new(),
        }
    }

    pub fn height_at(&self, x: f64, y: f64) -> f64 {
        let hills: f64 = self
            .hills
            .iter()
            .map(|h| {
                let d_sq = (x - h.x).powi(2) + (y - h.y).powi(2);
                h.height_m * (-d_sq / (2.0 * h.radius_m * h.radius_m)).exp()
            })
            .sum();
        let waves: f64 = self.waves.iter().map(|w| w[3] * (w[0] * x + w[1] * y + w[2]).sin()).sum();
        let cliffs: f64 = (self.cliffs.iter())
            .map(|c| {
                let beyond = x - c.x - 6.0 * (y / 25.0 + c.x).sin();
                c.height_m * (0.5 + beyond / CLIFF_WIDTH_M).clamp(0.0, 1.0)
            })
            .sum();
        self.base_m + self.slope[0] * x + self.slope[1] * y + hills + waves + cliffs
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn uneven_but_walkable() {
        for seed in 0..20 {
            let r = Relief::new(100.0, 20.0, Landform::Hills, Seed::new(seed));
            let (mut low, mut high, mut steepest) = (f64::MAX, f64::MIN, 0.0f64);
            for i in 0..100 {
                for j in 0..100 {
                    let (x, y) = (f64::from(i), f64::from(j));
                    let z = r.height_at(x, y);
                    low = low.min(z);
                    high = high.max(z);
                    let gradient =
                        (r.height_at(x + 0.5, y) - z).hypot(r.height_at(x, y + 0.5) - z) / 0.5;
                    steepest = steepest.max(gradient);
                }
            }
            assert!((5.0..45.0).contains(&(high - low)), "seed {seed}: {}", high - low);
            assert!(steepest < 1.5, "seed {seed}: {steepest}");
        }
    }
}
