//! The colours of columns: of photos and points without the air's light, or by class, height and
//! brightness of the returns.

use glam::Vec3;

use super::water::WATER;

/// A point lower than this over the terrain colours the ground.
pub(super) const LEAST_HEIGHT_M: f32 = 1.0;
pub(super) const SOIL: Vec3 = Vec3::new(126.0, 116.0, 88.0);

pub(super) fn has_colour(rgb: &Option<Vec<[u16; 3]>>) -> bool {
    rgb.iter().flatten().any(|c| *c != [0; 3])
}

/// Colour by class (ASPRS), or by height above the terrain.
pub(super) fn tint(class: u8, height_m: f32) -> Vec3 {
    match class {
        6 => Vec3::new(150.0, 120.0, 108.0),
        WATER => Vec3::new(70.0, 100.0, 120.0),
        13..=16 => Vec3::new(120.0, 120.0, 125.0),
        _ => {
            let low = Vec3::new(108.0, 114.0, 70.0);
            let middle = Vec3::new(80.0, 98.0, 56.0);
            let high = Vec3::new(54.0, 78.0, 46.0);
            let t = (height_m / 30.0).clamp(0.0, 1.0) * 2.0;
            if t < 1.0 { low.lerp(middle, t) } else { middle.lerp(high, t - 1.0) }
        }
    }
}

/// Colour of the ground by the class of its points (ASPRS).
pub(super) fn soil(class: u8) -> Vec3 {
    match class {
        11 => Vec3::new(128.0, 126.0, 122.0),
        _ => SOIL,
    }
}

#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Cell {
    /// Of the ground and of what is above it.
    pub count: [f32; 2],
    pub intensity: [f32; 2],
    pub colour: [Vec3; 2],
    /// Above the terrain, of the highest point, and its class.
    pub height: f32,
    pub class: u8,
    /// The greatest class of the points at the ground.
    pub low: u8,
}

impl Cell {
    pub fn mean(&self) -> Option<Vec3> {
        let count = self.count[0] + self.count[1];
        (count > 0.0).then(|| (self.colour[0] + self.colour[1]) / count)
    }
}

/// Narrows channels that were stretched, takes off colours what even the darkest places show of the
/// air's own light: the blue of the darkest tells how much, and a scattering by the square of the
/// wavelength what that is in green and red (Chavez 1988). Then brings the brighter half's middle to what leaves in
/// the sun reflect, and draws what is brighter and darker towards it: the sun of the photo lit one side
/// of each crown already, and a renderer's sun does so once more.
///
/// In 43 photos of forests at three sites red is spread 0.95 to 1.13 times as widely as green and blue
/// 0.41 to 0.89 times; channels spread more widely were stretched each alone, which makes leaves
/// purple and emerald. What is greener there than any leaf in those photos is brought back to that.
pub(super) struct Clear {
    middle: Vec3,
    narrow: Vec3,
    dark: Vec3,
    gain: f32,
    /// Of the median, over its grey.
    hue: Vec3,
}

/// How widely red, green and blue may be spread, over the spread of green.
const SPREAD: Vec3 = Vec3::new(1.15, 1.0, 0.9);
/// Red and blue over green of the greenest hundredth of the green pixels in any of those photos.
const GREENEST: Vec3 = Vec3::new(0.62, 1.0, 0.36);
/// Share of the air's blue light that it has in red, green and blue: (0.45 µm / λ)².
const SCATTERED: Vec3 = Vec3::new(0.48, 0.67, 1.0);
/// Share of the darkest's light that is the air's: the rest comes off leaves in the shade.
const AIR: f32 = 0.5;
/// sRGB of leaves in the sun after that: of the upper quartile, whether shade takes half of the photo
/// or little.
const SUNLIT: f32 = 104.0;
/// Power of a brightness over that one that is left of it.
const LEFT: f32 = 0.55;

impl Clear {
    pub fn of(colours: impl Iterator<Item = Vec3>) -> Clear {
        let mut colours: Vec<Vec3> = colours.collect();
        let quantile = |values: &mut dyn Iterator<Item = f32>, share: f32| {
            let mut values: Vec<f32> = values.collect();
            values.sort_unstable_by(f32::total_cmp);
            values.get((values.len() as f32 * share) as usize).copied().unwrap_or(0.0)
        };
        let quantiles = |colours: &[Vec3], share: f32| {
            Vec3::from([0, 1, 2].map(|c: usize| quantile(&mut colours.iter().map(|v| v[c]), share)))
        };
        let middle = quantiles(&colours, 0.5);
        let spread = quantiles(&colours, 0.95) - quantiles(&colours, 0.05);
        let narrow = (SPREAD * spread.y.max(1.0) / spread.max(Vec3::ONE)).min(Vec3::ONE);
        for colour in &mut colours {
            *colour = middle + (*colour - middle) * narrow;
        }
        // Deep shade is not black.
        let least = (quantiles(&colours, 0.01) - 8.0).max(Vec3::ZERO);
        let dark = (SCATTERED * least.z).min(least) * AIR;
        let clear = || colours.iter().map(|v| (*v - dark).max(Vec3::ZERO));
        let sunlit = quantile(&mut clear().map(grey), 0.75);
        let gain = (SUNLIT / sunlit.max(1.0)).clamp(0.3, 3.0);
        let hue = (middle - dark).max(Vec3::ONE);
        Clear { middle, narrow, dark, gain, hue: hue / grey(hue) }
    }

    pub fn seen(&self, colour: Vec3) -> Vec3 {
        let natural = self.middle + (colour - self.middle) * self.narrow;
        let clear = (natural - self.dark).max(Vec3::ZERO) * self.gain;
        let leaf = if self.narrow == Vec3::ONE { clear } else { no_greener(clear) };
        let bright = grey(leaf).max(1.0) / SUNLIT;
        // The hue of shade is that of the sky.
        let hue = (leaf / (bright * SUNLIT)).lerp(self.hue, 1.0 - bright.min(1.0));
        (hue * (SUNLIT * bright.powf(LEFT))).min(Vec3::splat(255.0))
    }
}

fn grey(v: Vec3) -> f32 {
    v.dot(Vec3::new(0.299, 0.587, 0.114))
}

/// As bright, but no greener than leaves are.
fn no_greener(colour: Vec3) -> Vec3 {
    let leaf = colour.max(GREENEST * colour.y);
    leaf * (grey(colour) / grey(leaf).max(1.0))
}

/// sRGB of the ground's median, at least, and how much it may be brightened for that.
const GROUND_MEDIAN: f32 = 74.0;
const MOST_BRIGHTENED: f32 = 2.5;
const BRIGHTEST_GROUND: f32 = 165.0;

/// How to brighten the ground's colours: between crowns it is seen in their shadow, and a renderer
/// lays that upon it once more. What lies in the sun there is left as it is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Lifted {
    factor: f32,
}

impl Lifted {
    pub fn of(ground: impl Iterator<Item = Vec3>) -> Lifted {
        let mut levels: Vec<f32> = ground.map(grey).collect();
        levels.sort_unstable_by(f32::total_cmp);
        let median = levels.get(levels.len() / 2).copied().unwrap_or(GROUND_MEDIAN);
        Lifted { factor: (GROUND_MEDIAN / median.max(1.0)).clamp(1.0, MOST_BRIGHTENED) }
    }

    pub fn seen(self, colour: Vec3) -> Vec3 {
        // Up to the median all of it, from the brightest ground on nothing.
        let level = grey(colour).max(1.0);
        let from = GROUND_MEDIAN / self.factor;
        let over = ((level - from) / (BRIGHTEST_GROUND - from).max(1.0)).clamp(0.0, 1.0);
        let factor = self.factor + (1.0 - self.factor) * over.sqrt();
        // Bare ground is no brighter than this.
        colour * factor.min(BRIGHTEST_GROUND / level)
    }
}

/// The middle and the spread of intensities, of the ground and of what is above it.
pub(super) struct Brightness([(f32, f32); 2]);

impl Brightness {
    pub fn of(cells: &[Cell]) -> Brightness {
        Brightness([0, 1].map(|of| {
            let means =
                cells.iter().filter(|c| c.count[of] > 0.0).map(|c| c.intensity[of] / c.count[of]);
            let mut means: Vec<f32> = means.collect();
            means.sort_unstable_by(f32::total_cmp);
            let at = |share: usize| means.get(means.len() * share / 100).copied().unwrap_or(0.0);
            (at(50), (at(90) - at(10)).max(1e-6))
        }))
    }

    pub fn of_cell(&self, cell: &Cell, of: usize) -> f32 {
        let (middle, spread) = self.0[of];
        1.0 + 0.4 * ((cell.intensity[of] / cell.count[of] - middle) / spread).clamp(-1.0, 1.0)
    }
}

/// Deep, clear water from above.
pub(super) const DEEP: Vec3 = Vec3::new(46.0, 63.0, 68.0);

#[cfg(test)]
mod tests {
    use super::*;

    /// A grid of grey-green colours, brighter with i.
    fn greens(red: f32, blue: f32) -> Vec<Vec3> {
        let level = |i: u32| 40.0 + (i * 37 % 100) as f32;
        (0..1000)
            .map(level)
            .map(|g| {
                Vec3::new(60.0 + (g - 90.0) * red, g, 50.0 + (g - 90.0) * blue).max(Vec3::ZERO)
            })
            .collect()
    }

    #[test]
    fn stretched_channels_are_narrowed_and_others_left() {
        for (red, blue, is_narrowed) in [(0.9, 0.6, false), (1.9, 1.6, true)] {
            let colours = greens(red, blue);
            let clear = Clear::of(colours.iter().copied());
            assert_eq!(clear.narrow != Vec3::ONE, is_narrowed);
            let seen: Vec<Vec3> = colours.iter().map(|c| clear.seen(*c)).collect();
            let spread = |c: usize| {
                let mut v: Vec<f32> = seen.iter().map(|s| s[c]).collect();
                v.sort_unstable_by(f32::total_cmp);
                v[950] - v[50]
            };
            assert!(spread(0) < 1.2 * spread(1) && spread(2) < 0.98 * spread(1));
        }
    }

    #[test]
    fn stretched_leaves_are_no_greener_than_leaves_and_as_bright() {
        let clear = Clear::of(greens(1.9, 1.6).into_iter());
        for colour in [Vec3::new(2.0, 90.0, 40.0), Vec3::new(0.0, 60.0, 5.0)] {
            let seen = clear.seen(colour);
            assert!(seen.x > 0.61 * seen.y && seen.z > 0.35 * seen.y, "{seen}");
        }
        let plain = Vec3::new(90.0, 100.0, 60.0);
        assert!((grey(no_greener(plain)) - grey(plain)).abs() < 1e-3);
        assert!(
            (grey(no_greener(Vec3::new(0.0, 60.0, 5.0))) - grey(Vec3::new(0.0, 60.0, 5.0))).abs()
                < 1e-3
        );
    }

    #[test]
    fn the_light_of_a_photo_is_drawn_together() {
        let (lit, shade) = (Vec3::new(150.0, 160.0, 110.0), Vec3::new(28.0, 32.0, 48.0));
        for lit_in_ten in [4, 6, 9] {
            let of = |i: u32| match i % 50 {
                0 => Vec3::splat(9.0),
                i if i % 10 < lit_in_ten => lit,
                _ => shade,
            };
            let clear = Clear::of((0..1000).map(of));
            let seen = [lit, shade].map(|c| clear.seen(c));
            assert!((grey(seen[0]) - SUNLIT).abs() < 1.0, "{seen:?}");
            let ratio = grey(seen[0]) / grey(seen[1]);
            assert!(ratio > 1.5 && ratio < 0.6 * grey(lit) / grey(shade), "{seen:?}");
            // The sky's blue is no colour of leaves.
            assert!(lit_in_ten < 5 || seen[1].z < seen[1].y, "{seen:?}");
        }
    }

    #[test]
    fn dark_ground_is_brightened_and_bright_is_not() {
        let lifted = |level: f32| Lifted::of((0..99).map(move |_| Vec3::splat(level)));
        let seen = |of: f32, level: f32| lifted(of).seen(Vec3::splat(level)).x;
        assert!((seen(37.0, 37.0) - 74.0).abs() < 1e-3);
        assert!((seen(37.0, 20.0) - 40.0).abs() < 1e-3);
        assert!((seen(120.0, 120.0) - 120.0).abs() < 1e-3);
        assert_eq!((lifted(5.0).factor, lifted(120.0).factor), (MOST_BRIGHTENED, 1.0));
        assert_eq!(Lifted::of(std::iter::empty()).factor, 1.0);
        for of in [10.0, 37.0, 70.0] {
            let rising: Vec<f32> = (1..=255).map(|level| seen(of, level as f32)).collect();
            assert!(rising.iter().all(|v| *v < BRIGHTEST_GROUND + 0.01), "{of}");
            assert!(rising.windows(2).all(|v| v[1] > v[0] - 1.5), "{of}: {rising:?}");
        }
    }
}
