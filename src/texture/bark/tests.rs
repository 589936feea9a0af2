use glam::Vec3;

use super::super::tests::assert_tiles;
use super::*;
use crate::species::load;
use BarkStyle::*;

const ALL: [BarkStyle; 10] =
    [Birch, Paper, Plates, Flakes, Ridges, Furrows, Scales, Smooth, Diamonds, Blisters];

fn draw(bark: &Bark, size_px: u32, seed: Seed) -> BarkPictures {
    super::draw(bark, size_px, seed).pictures
}

fn draw_upper(bark: &Bark, size_px: u32, seed: Seed) -> BarkPictures {
    super::draw_upper(bark, size_px, seed).unwrap().pictures
}

fn bark(style: BarkStyle, lost: f32) -> Bark {
    let own = load("quercus_robur").unwrap().bark;
    Bark { style, colour: [120, 100, 84], dark: [50, 40, 34], relief_m: 0.02, lost, ..own }
}

#[test]
fn every_picture_of_every_style_tiles() {
    for style in ALL {
        for lost in [0.0, 0.5] {
            let p = draw(&bark(style, lost), 256, Seed::new(5));
            for (what, picture) in [
                ("colour", &p.colour),
                ("normal", &p.normal),
                ("orm", &p.orm),
                ("height", &p.height),
            ] {
                assert_tiles(picture, &format!("{style:?}, {lost} lost, {what}"));
            }
        }
    }
}

/// Slopes read from the normals, summed along a line, are the differences of the heights.
#[test]
fn normals_are_the_slopes_of_the_height() {
    const RUN: usize = 12;
    let n = 256usize;
    for style in ALL {
        let p = draw(&bark(style, 0.0), n as u32, Seed::new(2));
        let tile = p.depth_m / BARK_REPEAT_M / 255.0;
        let height = |x: usize, y: usize| {
            f64::from(p.height.at((x % n) as u32, (y % n) as u32)[0]) * f64::from(tile)
        };
        let slope = |x: usize, y: usize| {
            let q = p.normal.at((x % n) as u32, (y % n) as u32);
            let [a, b, c] = [0, 1, 2].map(|k| f64::from(q[k]) / 127.5 - 1.0);
            [-a / c / n as f64, b / c / n as f64]
        };
        let (mut off, mut size) = (0.0, 0.0);
        for y in (0..n).step_by(7) {
            for x in (0..n).step_by(7) {
                for (axis, way) in [[1, 0], [0, 1]].into_iter().enumerate() {
                    let at = |k: usize| (x + way[0] * k, y + way[1] * k);
                    let sum: f64 = (1..=RUN).map(|k| slope(at(k).0, at(k).1)[axis]).sum();
                    let h = |k: usize| height(at(k).0, at(k).1);
                    let rise = 0.5 * (h(RUN + 1) + h(RUN) - h(1) - h(0));
                    off += (sum - rise).abs();
                    size += rise.abs();
                }
            }
        }
        assert!(off < 0.12 * size, "{style:?}: {off} of {size}");
        for q in &p.normal.data {
            let v = [0, 1, 2].map(|c| f32::from(q[c]) / 127.5 - 1.0);
            let length = (v[0] * v[0] + v[1] * v[1] + v[2] * v[2]).sqrt();
            assert!((length - 1.0).abs() < 0.02 && v[2] > 0.0, "{style:?}: {v:?}");
        }
    }
}

#[test]
fn a_bump_has_its_light_side_up_in_green() {
    let n = 32;
    let mut height = vec![0.0; n * n];
    for (i, h) in height.iter_mut().enumerate() {
        let (x, y) = ((i % n) as f32 - 16.0, (i / n) as f32 - 16.0);
        *h = (-(x * x + y * y) / 30.0).exp();
    }
    let p = normal_map(&height, n, 0.1);
    assert!(p.at(16, 10)[1] > 140, "above the bump normals lean up");
    assert!(p.at(22, 16)[0] > 140, "right of the bump normals lean right");
}

/// The mean over ridges is the species' colour; other seeds and sizes show the same bark.
#[test]
fn the_colour_is_held() {
    let mean = |p: &Picture, weight: &dyn Fn(usize) -> f64| -> [f64; 3] {
        let (mut sum, mut total) = ([0.0; 3], 0.0);
        for (i, q) in p.data.iter().enumerate() {
            total += weight(i);
            (0..3).for_each(|c| sum[c] += weight(i) * f64::from(q[c]));
        }
        sum.map(|s| s / total)
    };
    for style in ALL {
        for lost in [0.0, 0.6] {
            let b = bark(style, lost);
            let p = draw(&b, 256, Seed::new(1));
            let ridges = texels(style, &b, 256, Seed::new(1));
            let held = mean(&p.colour, &|i| f64::from(ridges[i].ridge().powi(4)));
            for c in 0..3 {
                let wanted = f64::from(b.colour[c]);
                assert!((held[c] - wanted).abs() < 2.5, "{style:?}: {held:?} for {:?}", b.colour);
            }
            let whole = mean(&p.colour, &|_| 1.0);
            for (size, seed) in [(128, 1), (256, 7)] {
                let other = mean(&draw(&b, size, Seed::new(seed)).colour, &|_| 1.0);
                let off = (0..3).map(|c| (whole[c] - other[c]).abs()).fold(0.0, f64::max);
                assert!(off < 9.0, "{style:?}: {whole:?}, at {size} with {seed}: {other:?}");
            }
        }
    }
}

#[test]
fn coarse_and_fine_bark_tile_and_have_features_of_that_size() {
    for style in ALL {
        for coarseness in [0.5, 0.77, 1.3, 2.0] {
            let b = Bark { coarseness, ..bark(style, 0.0) };
            assert_tiles(&draw(&b, 256, Seed::new(5)).height, &format!("{style:?}, {coarseness}"));
        }
    }
    // Places where the relief crosses its mean, along rows and columns.
    let crossings = |coarseness: f32| {
        let b = Bark { coarseness, ..bark(Plates, 0.0) };
        let height = draw(&b, 256, Seed::new(5)).height;
        let high: Vec<bool> = height.data.iter().map(|p| p[0] > 127).collect();
        let differ = |step: usize| high.iter().zip(&high[step..]).filter(|(a, b)| a != b).count();
        (differ(1) + differ(256)) as f32
    };
    let [fine, usual, coarse] = [0.5, 1.0, 2.0].map(crossings);
    assert!(fine > 1.3 * usual && usual > 1.3 * coarse, "{fine} {usual} {coarse}");
}

#[test]
fn as_much_bark_falls_as_is_asked_for() {
    for lost in [0.0, 0.2, 0.7, 1.0] {
        let texels = texels(Scales, &bark(Scales, lost), 128, Seed::new(3));
        let bare = texels.iter().filter(|t| t.wood > 0.5).count() as f32 / texels.len() as f32;
        assert!((bare - lost).abs() < 0.02, "{bare} for {lost}");
    }
}

/// Occlusion lies where the relief is low; nothing is metal.
#[test]
fn occlusion_follows_the_relief() {
    for style in [Plates, Furrows, Ridges] {
        let p = draw(&bark(style, 0.0), 128, Seed::new(1));
        let (mut low, mut high) = ((0u32, 0u32), (0u32, 0u32));
        for (h, o) in p.height.data.iter().zip(&p.orm.data) {
            assert_eq!((o[2], o[3]), (0, 255));
            assert!(o[1] > 100, "bark is rough");
            let side = if h[0] < 70 { &mut low } else { &mut high };
            *side = (side.0 + u32::from(o[0]), side.1 + 1);
        }
        let mean = |s: (u32, u32)| s.0 as f32 / s.1.max(1) as f32;
        assert!(mean(low) + 40.0 < mean(high), "{style:?}: {low:?} {high:?}");
    }
}

/// Furrows and plates run up the stem, the bands and lenticels of a birch around it.
#[test]
fn patterns_run_their_way() {
    let changes = |p: &Picture| {
        let step = |dx: u32, dy: u32| -> u64 {
            let n = p.width;
            let all = (0..n * n).map(|i| (i % n, i / n));
            all.map(|(x, y)| {
                let (a, b) = (p.at(x, y), p.at((x + dx) % n, (y + dy) % n));
                u64::from(a[1].abs_diff(b[1]))
            })
            .sum()
        };
        step(4, 0) as f64 / step(0, 4) as f64
    };
    for style in [Ridges, Furrows, Plates] {
        let ratio = changes(&draw(&bark(style, 0.0), 256, Seed::new(1)).colour);
        assert!(ratio > 1.1, "{style:?}: {ratio}");
    }
    let birch = load("betula_pendula").unwrap().bark;
    let upper = draw_upper(&birch, 256, Seed::new(1)).colour;
    assert!(changes(&upper) < 0.7, "{}", changes(&upper));
    let lower = draw(&birch, 256, Seed::new(1)).colour;
    let black =
        |p: &Picture| p.data.iter().filter(|q| q[1] < 90).count() as f32 / p.data.len() as f32;
    assert!((0.4..0.85).contains(&black(&lower)), "cork: {}", black(&lower));
    assert!(black(&upper) < 0.5 * black(&lower), "fewer above: {}", black(&upper));
}

#[test]
fn threads_change_nothing() {
    let one = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    for style in [Birch, Ridges] {
        let b = bark(style, 0.3);
        assert_eq!(draw(&b, 96, Seed::new(4)), one.install(|| draw(&b, 96, Seed::new(4))));
    }
}

/// Where branches have the stem's pattern, and twigs that of branches, it fades from one to the next.
#[test]
fn furrows_are_fainter_on_younger_wood() {
    let species = load("quercus_robur").unwrap();
    let own = Bark { twig: species.bark.upper, ..species.bark };
    let contrast = |p: &Picture| {
        let mut light: Vec<u32> =
            p.data.iter().map(|q| q[..3].iter().map(|c| *c as u32).sum()).collect();
        light.sort_unstable();
        let at = |share: f32| light[(share * light.len() as f32) as usize] as f32;
        at(0.9) / at(0.1)
    };
    let stem = draw(&own, 256, Seed::new(1));
    let branch = draw_upper(&own, 256, Seed::new(1));
    let twig = draw_twig(&own, 256, Seed::new(1)).unwrap();
    assert!(branch.depth_m < 0.6 * stem.depth_m);
    let [stem, branch, twig] =
        [contrast(&stem.colour), contrast(&branch.colour), contrast(twig.colour.picture())];
    assert!(branch < 0.8 * stem, "{branch} on branches, {stem} on the stem");
    assert!(twig < branch && twig > 1.1, "{twig} on twigs, {branch} on branches");
}

/// Bark falls in strips along the grain: what is left on a thin branch is no row of rings.
#[test]
fn bark_falls_in_strips_along_the_stem() {
    let n = 256;
    for style in ALL {
        let bare = texels(style, &bark(style, 0.5), n, Seed::new(3));
        let is_bare = |x: usize, y: usize| bare[y % n * n + x % n].wood > 0.5;
        let places = || (0..n).flat_map(|y| (0..n).map(move |x| (x, y)));
        let across = places().filter(|&(x, y)| is_bare(x, y) != is_bare(x + 1, y)).count();
        let along = places().filter(|&(x, y)| is_bare(x, y) != is_bare(x, y + 1)).count();
        assert!(
            across > 2 * along,
            "{style:?}: {across} borders across the stem, {along} along it"
        );
    }
}

fn off(a: [f32; 3], b: [f32; 3]) -> f32 {
    (0..3).map(|c| (a[c] - b[c]).abs()).fold(0.0, f32::max)
}

fn rgb(p: &Picture, x: u32, y: u32) -> [f32; 3] {
    [0, 1, 2].map(|c| f32::from(p.at(x, y)[c]))
}

/// What the rows of a bark show that are one row of a transition, and which those are: from the top, or with
/// the old bark from the foot.
fn rows_of(p: &Picture, x: u32, y: u32, is_old: bool) -> [f32; 3] {
    let (n, tiles) = (p.width, TILES as u32);
    let moved = (0.5 * PURE * ((tiles - 1) * n) as f32).round() as u32;
    let first = tiles * y + if is_old { moved } else { n - moved };
    let rows = (0..tiles).map(|k| rgb(p, x, (first + k) % n));
    let sum = rows.fold([0.0; 3], |sum, row| [0, 1, 2].map(|c| sum[c] + row[c]));
    sum.map(|c| c / tiles as f32)
}

/// It goes on from the one bark and into the other, row by row less of the one, and tiles around.
#[test]
fn a_transition_is_one_bark_at_its_foot_and_another_at_its_top() {
    let n = 128;
    for name in ["pinus_sylvestris", "populus_tremula", "betula_pendula", "quercus_robur"] {
        let bark = load(name).unwrap().bark;
        let seed = Seed::new(3);
        let [old, upper] =
            [super::draw(&bark, n, seed), super::draw_upper(&bark, n, seed).unwrap()];
        let between = draw_transition(&bark, &old, &upper, seed);
        let rows = (PURE * n as f32) as u32 - 1;
        let same: fn([f32; 3]) -> [f32; 3] = |rgb| rgb;
        // Normals are of one length again.
        let unit: fn([f32; 3]) -> [f32; 3] = |rgb| {
            let normal = (Vec3::from(rgb) - 127.5).normalize_or(Vec3::Z);
            (127.5 + 127.5 * normal).to_array()
        };
        let maps = [
            (&between.colour, &old.pictures.colour, &upper.pictures.colour, same),
            (&between.normal, &old.pictures.normal, &upper.pictures.normal, unit),
            (&between.orm, &old.pictures.orm, &upper.pictures.orm, same),
        ];
        for (own, low, high, as_there) in maps {
            for (y, x) in (0..rows).flat_map(|y| (0..n).map(move |x| (y, x))) {
                let near = |of: &Picture, y: u32, is_old: bool| {
                    off(rgb(own, x, y), as_there(rows_of(of, x, y, is_old))) <= 1.0
                };
                assert!(near(high, y, false), "{name}: {x}, row {y}");
                assert!(near(low, n - 1 - y, true), "{name}: {x}, row {y} from the foot");
            }
        }
        let own = &between.colour;
        let share = |y: u32| {
            let like = |x: &u32| {
                let [low, high] = [(&old, true), (&upper, false)].map(|(of, is_old)| {
                    off(rgb(own, *x, y), rows_of(&of.pictures.colour, *x, y, is_old))
                });
                high < low
            };
            (0..n).filter(like).count() as f32 / n as f32
        };
        let band = |k: u32| (0..n / 4).map(|y| share(k * n / 4 + y)).sum::<f32>() / (n / 4) as f32;
        let bands = [0, 1, 2, 3].map(band);
        assert!(bands.windows(2).all(|w| w[0] > w[1]), "{name}: {bands:?}");
        assert!(bands[0] > 0.8 && bands[3] < 0.2, "{name}: {bands:?}");
        let across =
            |x: u32, to: u32| (0..n).map(|y| off(rgb(own, x, y), rgb(own, to, y))).sum::<f32>();
        let within = (0..n - 1).map(|x| across(x, x + 1)).fold(0.0, f32::max);
        assert!(across(n - 1, 0) <= within, "{name}: a seam");
    }
}

/// The last of the old bark ends in tongues, not in a level hem.
#[test]
fn a_transition_ends_in_tongues() {
    const GROUPS: u32 = 16;
    let n = 128;
    for name in ["populus_tremula", "betula_pendula", "tilia_cordata"] {
        let bark = load(name).unwrap().bark;
        // Standard deviation of the height at which the old bark ends, in tiles.
        let uneven = |seed| {
            let [old, upper] =
                [super::draw(&bark, n, seed), super::draw_upper(&bark, n, seed).unwrap()];
            let own = draw_transition(&bark, &old, &upper, seed).colour;
            let upper = &upper.pictures.colour;
            let is_upper = |x, y| off(rgb(&own, x, y), rows_of(upper, x, y, false)) <= 1.0;
            let columns = |g: u32| g * n / GROUPS..(g + 1) * n / GROUPS;
            let top =
                |g: u32| (0..n).find(|&y| columns(g).any(|x| !is_upper(x, y))).unwrap_or(n) as f32;
            let tops: Vec<f32> = (0..GROUPS).map(|g| top(g) * TILES as f32 / n as f32).collect();
            let mean = tops.iter().sum::<f32>() / GROUPS as f32;
            (tops.iter().map(|t| (t - mean).powi(2)).sum::<f32>() / GROUPS as f32).sqrt()
        };
        let mean = [1, 2, 3].map(|k| uneven(Seed::new(k))).iter().sum::<f32>() / 3.0;
        assert!(mean > 0.14, "{name}: {mean}");
    }
}
