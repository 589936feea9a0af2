//! Where the trees of a stand are and how large: a hard-core process in which crowns touch but do
//! not hide one another, species in patches, a few gaps with shrubs.

use glam::DVec3;

use super::relief::{Landform, Relief};
use super::shape::Shape;
use crate::diagnostic::{Error, Result};
use crate::frame::{Crs, Frame};
use crate::seed::{Draws, Seed};
use crate::species::Species;
use crate::species::model::Kind;

#[derive(Debug, Clone)]
pub struct StandOptions {
    pub trees: usize,
    /// Crown area over ground area, 0…1.
    pub cover: f32,
    /// Between lowest and highest ground, metres.
    pub relief_m: f64,
    /// Lower trees beneath the crowns of others, beside `trees`.
    pub understory: usize,
    pub landform: Landform,
    /// Surveyed ground beyond the outermost trees, metres.
    pub margin_m: f64,
}

impl Default for StandOptions {
    fn default() -> Self {
        StandOptions {
            trees: 240,
            cover: 0.55,
            understory: 0,
            relief_m: 20.0,
            landform: Landform::Hills,
            margin_m: 8.0,
        }
    }
}

/// What there is to be found. Local metres.
#[derive(Debug, Clone, PartialEq)]
pub struct TrueTree {
    pub x: f64,
    pub y: f64,
    /// Terrain at the stem.
    pub z: f64,
    pub height_m: f32,
    pub crown_diameter_m: f32,
    pub crown_base_height_m: f32,
    pub stem_diameter_m: f32,
    /// Index into the species of the stand.
    pub species: usize,
}

/// A planted stand: a square from the local origin.
#[derive(Debug, Clone)]
pub struct Stand {
    pub frame: Frame,
    pub side_m: f64,
    pub relief: Relief,
    pub trees: Vec<TrueTree>,
    /// Scientific names.
    pub species: Vec<String>,
    pub(super) shapes: Vec<Shape>,
    pub(super) looks: Vec<Look>,
}

/// What a scanner and a camera see of a species.
#[derive(Debug, Clone)]
pub(super) struct Look {
    /// Mean luminance, 0…255.
    pub luminance: f32,
    /// Half the range.
    pub spread: f32,
    pub colour: [f32; 3],
}

/// Crowns may overlap to this share of the sum of their radii.
const CLOSEST: f32 = 0.85;
const TRIES: usize = 300;

/// Plants a stand.
///
/// # Errors
/// No species, or no trees asked for.
pub fn stand(species: &[Species], options: &StandOptions, seed: Seed) -> Result<Stand> {
    if species.is_empty() || options.trees == 0 {
        return Err(Error::new("a stand needs at least one tree of one species")
            .remedy("give --trees 1 or more"));
    }
    let seed = seed.derive("stand", 0);
    let sizes = sizes(species, options.trees, seed);
    let crown_area: f32 =
        sizes.iter().map(|t| std::f32::consts::FRAC_PI_4 * t.crown_diameter_m.powi(2)).sum();
    let planted_m = f64::from(crown_area / options.cover.clamp(0.05, 0.8)).sqrt().max(4.0);
    let side_m = planted_m + 2.0 * options.margin_m;
    let relief = Relief::new(side_m, options.relief_m, options.landform, seed);
    let mut trees = place(sizes, species, options.margin_m, planted_m, seed);
    plant_understory(&mut trees, options.understory, seed);
    for t in &mut trees {
        t.z = relief.height_at(t.x, t.y);
    }
    let shapes = trees
        .iter()
        .enumerate()
        .map(|(i, t)| Shape::new(t, &species[t.species], seed.derive("shape", i as u64)))
        .collect();
    Ok(Stand {
        frame: Frame {
            origin: DVec3::new(561_200.0, 6_213_400.0, 0.0),
            crs: Some(Crs::from_epsg(32646)),
        },
        side_m,
        relief,
        trees,
        species: species.iter().map(|s| s.name.clone()).collect(),
        shapes,
        looks: species.iter().map(look).collect(),
    })
}

fn look(species: &Species) -> Look {
    let fallback = if species.kind == Kind::Conifer { [72.0, 85.0] } else { [179.0, 187.0] };
    let [low, high] = species.luminance.unwrap_or(fallback);
    Look {
        luminance: 0.5 * (low + high),
        spread: 0.5 * (high - low),
        colour: species.foliage.colour.map(f32::from),
    }
}

/// Trees without a place, largest crown first. Shrubs are one in eight where there are others.
fn sizes(species: &[Species], count: usize, seed: Seed) -> Vec<TrueTree> {
    let (shrubs, tall): (Vec<usize>, Vec<usize>) =
        (0..species.len()).partition(|&i| species[i].kind == Kind::Shrub);
    let mut trees: Vec<TrueTree> = (0..count)
        .map(|i| {
            let mut d = seed.derive("size", i as u64).draws();
            let pick_shrub = !shrubs.is_empty() && (tall.is_empty() || i % 8 == 7);
            let among = if pick_shrub { &shrubs } else { &tall };
            let s = among[(if pick_shrub { i / 8 } else { i - i / 8 }) % among.len()];
            let size = &species[s].size;
            let relative = (0.86 + 0.14 * d.normal()).clamp(0.5, 1.2);
            let height_m = (size.height_m * relative).max(2.5);
            let spread = 1.0 + 0.1 * d.normal().clamp(-2.0, 2.0);
            TrueTree {
                x: 0.0,
                y: 0.0,
                z: 0.0,
                height_m,
                crown_diameter_m: size.crown_diameter_m * relative * spread,
                crown_base_height_m: height_m * (size.crown_base * d.between(0.9, 1.1)).min(0.8),
                stem_diameter_m: size.stem_diameter_m * relative.powf(1.5),
                species: s,
            }
        })
        .collect();
    trees.sort_by(|a, b| b.crown_diameter_m.total_cmp(&a.crown_diameter_m));
    trees
}

fn place(
    mut trees: Vec<TrueTree>,
    species: &[Species],
    margin_m: f64,
    planted_m: f64,
    seed: Seed,
) -> Vec<TrueTree> {
    let mut d = seed.derive("gaps", 0).draws();
    let gaps: Vec<[f64; 3]> = (0..2)
        .map(|_| {
            let [x, y] = spot(&mut d, margin_m, planted_m);
            [x, y, 0.07 * planted_m]
        })
        .collect();
    // A tall species likes to stand near its patch centres.
    let patches: Vec<Vec<[f64; 2]>> = (0..species.len())
        .map(|_| (0..3).map(|_| spot(&mut d, margin_m, planted_m)).collect())
        .collect();
    for i in 0..trees.len() {
        let mut d = seed.derive("place", i as u64).draws();
        let is_shrub = species[trees[i].species].kind == Kind::Shrub;
        let mut best = ([0.0; 2], f64::NEG_INFINITY);
        let mut sound = 0;
        for _ in 0..TRIES {
            let [x, y] = spot(&mut d, margin_m, planted_m);
            let in_gap = gaps.iter().any(|g| (x - g[0]).hypot(y - g[1]) < g[2]);
            if in_gap && !is_shrub {
                continue;
            }
            // Clearance beyond what is wanted; negative: crowns overlap too much.
            let clearance = trees[..i]
                .iter()
                .map(|o| {
                    let wanted = 0.5 * CLOSEST * (o.crown_diameter_m + trees[i].crown_diameter_m);
                    (x - o.x).hypot(y - o.y) - f64::from(wanted)
                })
                .fold(f64::MAX, f64::min);
            let patch = patches[trees[i].species]
                .iter()
                .map(|p| (x - p[0]).hypot(y - p[1]))
                .fold(f64::MAX, f64::min);
            let score = if clearance < 0.0 {
                clearance * 1e3
            } else {
                sound += 1;
                -patch * f64::from(d.between(0.3, 1.0))
            };
            if score > best.1 {
                best = ([x, y], score);
            }
            if sound >= 4 {
                break;
            }
        }
        [trees[i].x, trees[i].y] = best.0;
    }
    trees
}

/// Small trees of the same species under crowns that leave them room.
fn plant_understory(trees: &mut Vec<TrueTree>, count: usize, seed: Seed) {
    let over: Vec<TrueTree> =
        trees.iter().filter(|t| t.crown_base_height_m >= 7.0).cloned().collect();
    if over.is_empty() {
        return;
    }
    for i in 0..count {
        let mut d = seed.derive("understory", i as u64).draws();
        let t = &over[i % over.len()];
        let height_m = d.between(3.0, t.crown_base_height_m - 3.0);
        let shrink = height_m / t.height_m;
        let (away, azimuth) =
            (d.between(0.5, 0.6 + 0.2 * t.crown_diameter_m), d.between(0.0, std::f32::consts::TAU));
        trees.push(TrueTree {
            x: t.x + f64::from(away * azimuth.cos()),
            y: t.y + f64::from(away * azimuth.sin()),
            height_m,
            crown_diameter_m: (t.crown_diameter_m * shrink * 1.5).max(1.5),
            crown_base_height_m: 0.2 * height_m,
            stem_diameter_m: t.stem_diameter_m * shrink.powf(1.5),
            ..t.clone()
        });
    }
}

fn spot(d: &mut Draws, margin_m: f64, planted_m: f64) -> [f64; 2] {
    [(); 2].map(|()| margin_m + planted_m * f64::from(d.unit()))
}
