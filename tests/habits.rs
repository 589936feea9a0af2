//! The habit of each built-in species, measured on trees grown from its file, against the ranges
//! that its sources in `docs/species.md` name or draw.

use glam::Vec3;
use larix::seed::Seed;
use larix::skeleton::{Detail, Skeleton, Target, grow};
use larix::species;

/// Trees measured of each species; the median counts.
const SEEDS: [u64; 3] = [1, 2, 3];

type Range = (f32, f32);

/// What an observer would note of a tree.
#[derive(Debug, Clone, Copy)]
struct Habit<T> {
    /// Length of the crown over the height.
    crown: T,
    /// Width over height.
    width: T,
    /// Height of the widest tenth over the height.
    widest: T,
    /// Angle of first-order branches from the vertical in the crown's middle third, degrees.
    angle: T,
    /// How much the outer ends of first-order branches in the lower half rise beside their bases,
    /// degrees.
    rise: T,
    /// Share of the wood of second and higher order that leads downwards.
    hanging: T,
    /// Stems from the ground.
    stems: T,
}

fn mean(values: impl Iterator<Item = f32>) -> f32 {
    let (sum, count) = values.fold((0.0, 0.0f32), |(s, n), v| (s + v, n + 1.0));
    sum / count.max(1.0)
}

fn quantile(mut values: Vec<f32>, share: f32) -> f32 {
    values.sort_unstable_by(f32::total_cmp);
    let last = values.len().saturating_sub(1) as f32;
    values.get((share * last) as usize).copied().unwrap_or(0.0)
}

fn from_vertical_deg(way: Vec3) -> f32 {
    way.angle_between(Vec3::Z).to_degrees()
}

fn measured(s: &Skeleton) -> Habit<f32> {
    let height_m = s.height_m();
    // Stems of a stool all begin at the root; their branches are what others call first order.
    let axes = s.axes();
    let is_stem = |axis: u32| axis == 0 || axes.of(axis).base == Some(0);
    let of_stem: Vec<bool> = s.axis.iter().map(|&a| is_stem(a)).collect();
    let twigs: Vec<usize> = (1..s.len()).filter(|&i| !of_stem[i]).collect();
    let base_m = quantile(twigs.iter().map(|&i| s.position[i].z).collect(), 0.02);
    let crown_m = height_m - base_m;

    let tenth = |k: usize| {
        let inside = |i: &&usize| (s.position[**i].z / height_m * 10.0) as usize == k;
        let out = |i: &usize| s.position[*i].truncate().length();
        quantile(twigs.iter().filter(inside).map(out).collect(), 0.9)
    };
    let widest = (0..10).max_by(|&a, &b| tenth(a).total_cmp(&tenth(b))).unwrap_or(0);

    let first: Vec<(f32, f32, f32)> = axes
        .iter()
        .filter(|a| a.base.is_some_and(|b| of_stem[b as usize]) && !of_stem[a.nodes[0] as usize])
        .filter(|a| a.nodes.len() >= 3)
        .map(|a| {
            let base = s.position[a.base.unwrap_or(0) as usize];
            let at = |k: usize| s.position[a.nodes[k] as usize];
            let n = a.nodes.len();
            let (start, end) =
                (from_vertical_deg(at(0) - base), from_vertical_deg(at(n - 1) - at(n - 2)));
            ((base.z - base_m) / crown_m, start, start - end)
        })
        .collect();
    let within = |from: f32, to: f32| first.iter().filter(move |b| b.0 >= from && b.0 < to);

    let (mut down_m, mut all_m) = (0.0, 0.0);
    for &i in &twigs {
        let p = s.parent[i] as usize;
        if !of_stem[p] && s.order[i] >= 2 {
            let way = s.position[i] - s.position[p];
            all_m += way.length();
            down_m += if way.z < 0.0 { way.length() } else { 0.0 };
        }
    }
    Habit {
        crown: crown_m / height_m,
        width: s.width_m() / height_m,
        widest: 0.1 * widest as f32 + 0.05,
        angle: mean(within(0.33, 0.67).map(|b| b.1)),
        rise: mean(within(-1.0, 0.5).map(|b| b.2)),
        hanging: down_m / f32::max(all_m, 1e-6),
        stems: s.children().of(0).len() as f32,
    }
}

/// At a height, or at that of a grown tree.
fn typical(name: &str, height_m: Option<f32>) -> Habit<f32> {
    let species = species::load(name).unwrap();
    let all = SEEDS.map(|seed| {
        let target = Target::FromSpecies { height_m };
        measured(&grow(&species, target, Detail::HERO, Seed::new(seed)).unwrap())
    });
    let median = |of: fn(&Habit<f32>) -> f32| quantile(all.iter().map(of).collect(), 0.5);
    Habit {
        crown: median(|h| h.crown),
        width: median(|h| h.width),
        widest: median(|h| h.widest),
        angle: median(|h| h.angle),
        rise: median(|h| h.rise),
        hanging: median(|h| h.hanging),
        stems: median(|h| h.stems),
    }
}

#[rustfmt::skip]
const EXPECTED: &[(&str, Habit<Range>)] = &[
    ("larix_sibirica", Habit { crown: (0.6, 0.85), width: (0.18, 0.32), widest: (0.25, 0.5), angle: (70.0, 105.0), rise: (0.0, 70.0), hanging: (0.0, 0.45), stems: (1.0, 1.0) }),
    ("larix_decidua", Habit { crown: (0.6, 0.85), width: (0.25, 0.4), widest: (0.2, 0.45), angle: (70.0, 105.0), rise: (10.0, 90.0), hanging: (0.4, 1.0), stems: (1.0, 1.0) }),
    ("picea_obovata", Habit { crown: (0.9, 1.0), width: (0.15, 0.25), widest: (0.0, 0.25), angle: (70.0, 100.0), rise: (10.0, 80.0), hanging: (0.0, 0.7), stems: (1.0, 1.0) }),
    ("picea_abies", Habit { crown: (0.8, 1.0), width: (0.2, 0.33), widest: (0.0, 0.35), angle: (65.0, 100.0), rise: (15.0, 95.0), hanging: (0.5, 1.0), stems: (1.0, 1.0) }),
    ("abies_sibirica", Habit { crown: (0.9, 1.0), width: (0.12, 0.22), widest: (0.0, 0.25), angle: (65.0, 95.0), rise: (-5.0, 35.0), hanging: (0.0, 0.4), stems: (1.0, 1.0) }),
    ("pinus_sylvestris", Habit { crown: (0.3, 0.5), width: (0.22, 0.4), widest: (0.6, 0.9), angle: (55.0, 95.0), rise: (20.0, 100.0), hanging: (0.0, 0.35), stems: (1.0, 1.0) }),
    ("pinus_sibirica", Habit { crown: (0.75, 0.95), width: (0.25, 0.4), widest: (0.25, 0.65), angle: (50.0, 80.0), rise: (30.0, 100.0), hanging: (0.0, 0.3), stems: (1.0, 1.0) }),
    ("betula_pendula", Habit { crown: (0.6, 0.85), width: (0.25, 0.4), widest: (0.4, 0.65), angle: (30.0, 55.0), rise: (-150.0, -10.0), hanging: (0.5, 1.0), stems: (1.0, 1.0) }),
    ("populus_tremula", Habit { crown: (0.4, 0.6), width: (0.22, 0.4), widest: (0.55, 0.85), angle: (35.0, 65.0), rise: (-30.0, 60.0), hanging: (0.0, 0.4), stems: (1.0, 1.0) }),
    ("quercus_robur", Habit { crown: (0.7, 0.9), width: (0.75, 1.1), widest: (0.25, 0.65), angle: (45.0, 85.0), rise: (-40.0, 60.0), hanging: (0.0, 0.5), stems: (1.0, 1.0) }),
    ("tilia_cordata", Habit { crown: (0.8, 0.95), width: (0.33, 0.5), widest: (0.25, 0.6), angle: (40.0, 70.0), rise: (-90.0, 0.0), hanging: (0.1, 0.7), stems: (1.0, 1.0) }),
    ("sorbus_aucuparia", Habit { crown: (0.65, 0.9), width: (0.4, 0.7), widest: (0.4, 0.75), angle: (30.0, 65.0), rise: (-30.0, 60.0), hanging: (0.0, 0.5), stems: (2.0, 4.0) }),
    ("salix_caprea", Habit { crown: (0.8, 1.0), width: (0.6, 1.0), widest: (0.4, 0.8), angle: (30.0, 60.0), rise: (-30.0, 60.0), hanging: (0.0, 0.5), stems: (3.0, 8.0) }),
    ("corylus_avellana", Habit { crown: (0.8, 1.0), width: (0.75, 1.15), widest: (0.6, 0.9), angle: (25.0, 60.0), rise: (-30.0, 60.0), hanging: (0.0, 0.5), stems: (6.0, 20.0) }),
];

#[test]
fn every_species_has_the_habit_its_sources_describe() {
    let mut wrong = Vec::new();
    println!("{:18} crown width widest angle  rise hang stems", "species");
    for (name, expected) in EXPECTED {
        let h = typical(name, None);
        println!(
            "{name:18} {:5.2} {:5.2} {:6.2} {:5.0} {:5.0} {:4.2} {:5.0}",
            h.crown, h.width, h.widest, h.angle, h.rise, h.hanging, h.stems
        );
        for (what, value, (low, high)) in [
            ("crown", h.crown, expected.crown),
            ("width", h.width, expected.width),
            ("widest", h.widest, expected.widest),
            ("angle", h.angle, expected.angle),
            ("rise", h.rise, expected.rise),
            ("hanging", h.hanging, expected.hanging),
            ("stems", h.stems, expected.stems),
        ] {
            if !(low..=high).contains(&value) {
                wrong.push(format!("{name}: {what} {value:.2}, not {low} to {high}"));
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// Before it is grown each is widest lower down, and its crown, to the ground but for a few tenths, is no
/// shorter; Scots pines pass from a cone to an umbrella.
#[test]
fn young_trees_are_cones_whatever_they_become() {
    for (name, young_m) in [
        ("pinus_sylvestris", 4.0),
        ("pinus_sibirica", 2.0),
        ("populus_tremula", 4.0),
        ("quercus_robur", 4.0),
        ("tilia_cordata", 4.0),
    ] {
        let [young, grown] = [Some(young_m), None].map(|height_m| typical(name, height_m));
        println!("{name} {young:.2?}");
        assert!(young.crown > 0.75 && young.crown >= grown.crown - 0.05, "{name} {}", young.crown);
        assert!(young.widest < 0.5, "{name} {}", young.widest);
    }
    let pines = [4.0, 10.0, 14.0, 23.0].map(|height_m| typical("pinus_sylvestris", Some(height_m)));
    let crowns = pines.map(|h| h.crown);
    assert!(crowns.is_sorted_by(|a, b| a > b), "{crowns:?}");
    let widest = pines.map(|h| h.widest);
    assert!(widest.is_sorted() && widest[3] > widest[0] + 0.3, "{widest:?}");
}

/// A rule may write several laterals in line at the end of an axis: they are one. Else the stem's top would
/// be a bundle of shoots one in another, of which the one that is called the stem is the thinnest.
#[test]
fn a_stem_goes_on_in_one_shoot() {
    for name in ["pinus_sylvestris", "pinus_sibirica", "abies_sibirica", "table3/01"] {
        let species = species::load(name).unwrap();
        for seed in SEEDS {
            let target = Target::FromSpecies { height_m: None };
            let s = grow(&species, target, Detail::HERO, Seed::new(seed)).unwrap();
            let way = |i: usize| s.position[i] - s.position[s.parent[i] as usize];
            let of_stem: Vec<usize> = (1..s.len()).filter(|&i| s.axis[i] == 0).collect();
            for i in of_stem {
                let springs = |k: &usize| s.parent[*k] == s.parent[i] && s.axis[*k] != 0;
                for k in (1..s.len()).filter(springs).filter(|&k| s.radius_m[k] > 0.01) {
                    let apart_deg = way(i).angle_between(way(k)).to_degrees();
                    let share = s.radius_m[k] / s.radius_m[i];
                    assert!(apart_deg > 4.0 || share < 0.7, "{name} {seed}: {apart_deg} {share}");
                }
            }
        }
    }
}

/// Every built-in species, but for the bare productions.
fn built_in() -> Vec<&'static str> {
    species::builtin_names().into_iter().filter(|n| !n.starts_with("table3/")).collect()
}

#[test]
fn every_species_is_measured_described_and_built_on_a_production() {
    let page =
        std::fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/docs/species.md")).unwrap();
    for name in built_in() {
        assert!(EXPECTED.iter().any(|(n, _)| *n == name), "{name} has no habit to hold to");
        let row = page.lines().find(|l| l.starts_with(&format!("| `{name}`")));
        let builds_on = species::load(name).unwrap().builds_on.unwrap();
        assert!(
            row.is_some_and(|r| r.contains(&builds_on)),
            "{name} on {builds_on}: not in the page"
        );
        assert!(page.contains(&format!("### {name}")), "{name}: no sources in the page");
    }
}
