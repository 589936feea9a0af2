//! The colour of a user's own leaves, and the same leaves in another: as seasons and conditions turn them.
//!
//! Leaves are told from twigs, cones and flowers by their hue, which is green; in a picture with hardly
//! any green, of red-leaved trees or of autumn, all that is opaque counts as leaves. What is turned keeps
//! the light and shade of each pixel, and part of its difference in hue.
//!
//! Limits: a twig as green as its leaves turns with them, as do green cones; of leaves in strong light and shade the
//! mean comes out a little darker than asked for, as no pixel passes white.

use std::sync::LazyLock;

use glam::Vec3;
use rayon::prelude::*;

use crate::raster::{Picture, linear_from_srgb, srgb_from_linear};

/// Share of what is opaque that is green where leaves are.
const LEAST_GREEN: f32 = 0.2;
/// Part of a pixel's own hue that is kept.
const OWN_HUE: f32 = 0.35;
/// Light of red, green and blue, linear (Rec. 709).
const LIGHT: Vec3 = Vec3::new(0.2126, 0.7152, 0.0722);

/// Mean colour of the leaves that a picture shows, sRGB.
pub fn leaf_colour(picture: &Picture) -> [u8; 3] {
    Leaves::of(picture).colour()
}

/// The picture with leaves of another mean colour; the same where it is theirs already.
pub fn turned(picture: &Picture, colour: [u8; 3]) -> Picture {
    let leaves = Leaves::of(picture);
    if leaves.colour() == colour {
        return picture.clone();
    }
    let goal = Vec3::from(colour.map(linear_from_srgb));
    let mut out = picture.clone();
    out.data.par_iter_mut().for_each(|pixel| {
        let share = leaves.share(*pixel);
        if share > 0.0 {
            let own = linear(*pixel);
            let turned = leaves.turned(own, goal).min(Vec3::ONE);
            let [r, g, b] = own.lerp(turned, share).to_array().map(coded);
            *pixel = [r, g, b, pixel[3]];
        }
    });
    out
}

/// What a picture has for leaves.
struct Leaves {
    /// Mean, linear, above 0.
    mean: Vec3,
    is_green: bool,
}

impl Leaves {
    fn of(picture: &Picture) -> Leaves {
        // Sums of f64 by row, in the order of the rows: the same on any number of threads.
        let rows: Vec<[f64; 8]> = (picture.data.par_chunks(picture.width.max(1) as usize))
            .map(|row| {
                let mut sums = [0.0; 8];
                for p in row.iter().filter(|p| p[3] >= 128) {
                    let green = greenness(*p);
                    for (k, c) in linear(*p).to_array().into_iter().chain([1.0]).enumerate() {
                        sums[k] += f64::from(c);
                        sums[k + 4] += f64::from(c * green);
                    }
                }
                sums
            })
            .collect();
        let sum = |k: usize| rows.iter().map(|row| row[k]).sum::<f64>();
        let is_green = sum(7) > f64::from(LEAST_GREEN) * sum(3);
        let from = if is_green { 4 } else { 0 };
        let mean = |k: usize| (sum(from + k) / sum(from + 3).max(1.0)) as f32;
        Leaves { mean: Vec3::new(mean(0), mean(1), mean(2)).max(Vec3::splat(1e-4)), is_green }
    }

    fn colour(&self) -> [u8; 3] {
        self.mean.to_array().map(|c| srgb_from_linear(c).round() as u8)
    }

    /// How far a pixel is leaf, 0…1.
    fn share(&self, pixel: [u8; 4]) -> f32 {
        if self.is_green { greenness(pixel) } else { 1.0 }
    }

    /// A pixel of leaves whose mean is `goal`, linear; what is brighter than that nears white, and
    /// does not pass it.
    fn turned(&self, own: Vec3, goal: Vec3) -> Vec3 {
        let own = own.max(Vec3::splat(1e-4));
        let light = own.dot(LIGHT) / self.mean.dot(LIGHT);
        let hue = own / self.mean / light;
        let room = 1.0 / goal.max_element().max(1e-4) - 1.0;
        let over = (light - 1.0).max(0.0);
        let light = light.min(1.0) + over * room / (room + over).max(1e-4);
        goal * light * hue.clamp(Vec3::splat(0.25), Vec3::splat(4.0)).powf(OWN_HUE)
    }
}

fn linear([r, g, b, _]: [u8; 4]) -> Vec3 {
    Vec3::new(linear_from_srgb(r), linear_from_srgb(g), linear_from_srgb(b))
}

/// How green a pixel is, 0…1: by its hue, from yellow green to the blue green of some needles, and by
/// how much colour it has at all.
fn greenness([r, g, b, _]: [u8; 4]) -> f32 {
    let [r, g, b] = [r, g, b].map(f32::from);
    let most = r.max(g).max(b).max(1.0);
    let colour = (most - r.min(g).min(b)) / most;
    let hue_deg = (3f32.sqrt() * (g - b)).atan2(2.0 * r - g - b).to_degrees().rem_euclid(360.0);
    let rise = |from: f32, to: f32, x: f32| {
        let t = ((x - from) / (to - from)).clamp(0.0, 1.0);
        t * t * (3.0 - 2.0 * t)
    };
    rise(42.0, 58.0, hue_deg) * (1.0 - rise(200.0, 230.0, hue_deg)) * rise(0.04, 0.12, colour)
}

/// Steps of linear light; the darkest of sRGB's own are a twentieth of one in width.
const STEPS: usize = 1 << 14;

static CODED: LazyLock<Vec<u8>> = LazyLock::new(|| {
    (0..=STEPS).map(|i| srgb_from_linear(i as f32 / STEPS as f32).round() as u8).collect()
});

fn coded(c: f32) -> u8 {
    CODED[(c.clamp(0.0, 1.0) * STEPS as f32 + 0.5) as usize]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A green leaf of several lights over a brown twig, and clear pixels.
    fn twig() -> Picture {
        let mut picture = Picture::filled(16, 16, [40, 60, 30, 0]);
        for (x, y) in (0..16).flat_map(|y| (0..12).map(move |x| (x, y))) {
            let light = 90 + 4 * y as u8;
            picture.set(x, y, [light / 2, light, light / 3, 255]);
        }
        (0..16).for_each(|y| picture.set(12, y, [98, 74, 52, 255]));
        picture
    }

    #[test]
    fn leaves_turn_and_twigs_do_not() {
        let green = twig();
        let own = leaf_colour(&green);
        assert!(own[1] > own[0] + 30 && own[1] > own[2] + 30, "{own:?}");
        assert_eq!(turned(&green, own), green, "nothing to turn");
        for goal in [[206, 164, 56], [132, 102, 64], [188, 40, 30], [156, 184, 84]] {
            let autumn = turned(&green, goal);
            assert_eq!(autumn.at(12, 3), green.at(12, 3), "the twig");
            let alpha = |p: &Picture| p.data.iter().map(|p| p[3]).collect::<Vec<_>>();
            assert_eq!(alpha(&autumn), alpha(&green));
            let mut sum = Vec3::ZERO;
            (0..16).for_each(|y| sum += linear(autumn.at(3, y)));
            let mean = (sum / 16.0).to_array().map(srgb_from_linear);
            for (is, wanted) in mean.into_iter().zip(goal) {
                assert!((is - f32::from(wanted)).abs() < 10.0, "{goal:?}: {mean:?}");
            }
            let light = |y| linear(autumn.at(3, y)).dot(LIGHT);
            assert!((1..16).all(|y| light(y) > light(y - 1)), "{goal:?}: shade is kept");
        }
    }

    #[test]
    fn red_leaves_turn_as_well() {
        let mut red = twig();
        red.data.iter_mut().for_each(|p| *p = [p[1], p[2], p[0], p[3]]);
        let own = leaf_colour(&red);
        assert!(own[0] > own[1] + 30, "{own:?}");
        let turned = turned(&red, [206, 164, 56]);
        assert!(leaf_colour(&turned)[1] > own[1] + 40);
    }

    #[test]
    fn extreme_pictures_stay_pictures() {
        for pixel in [[0, 0, 0, 255], [255, 255, 255, 255], [0, 255, 0, 255], [9, 9, 9, 0]] {
            let picture = Picture::filled(3, 2, pixel);
            for goal in [[0; 3], [255; 3], [0, 0, 255]] {
                assert_eq!(turned(&picture, goal).data.len(), 6, "{pixel:?} {goal:?}");
            }
        }
        let none = Picture::filled(0, 0, [0; 4]);
        assert_eq!(turned(&none, [1, 2, 3]), none);
    }
}
