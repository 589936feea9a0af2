//! A mixed boreal stand: places by a hard-core process (random sequential, large trees first),
//! with gaps that shrubs fill, denser and thinner patches, and young trees.

use glam::{DVec3, Vec2, Vec3};
use serde::Serialize;

use super::crown::Shape;
use super::relief::Relief;
use crate::diagnostic::{Error, Result};
use crate::frame::{Crs, Frame};
use crate::seed::{Draws, Seed};
use crate::species::Species;
use crate::species::model::Kind;

/// Two crowns' axes are at least this share of the sum of their radii apart.
pub const LEAST_SPACING: f32 = 0.62;

#[derive(Debug, Clone)]
pub struct StandOptions<'a> {
    pub trees: usize,
    /// Species with their shares, > 0, of any sum.
    pub mix: Vec<(&'a Species, f32)>,
    /// Sum of crown areas over the stand's area, 0.1…0.9.
    pub crown_cover: f32,
    /// Highest less lowest ground.
    pub relief_m: f32,
    pub seed: Seed,
}

impl<'a> StandOptions<'a> {
    /// 240 trees of equal shares on 20 m of relief.
    pub fn of(species: &[&'a Species], seed: Seed) -> Self {
        let mix = species.iter().map(|&s| (s, 1.0)).collect();
        StandOptions { trees: 240, mix, crown_cover: 0.62, relief_m: 20.0, seed }
    }
}

/// What is true of one tree.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TrueTree {
    /// Stem foot, local metres of the stand's frame.
    #[serde(serialize_with = "as_array")]
    pub position: Vec3,
    pub height_m: f32,
    pub crown_diameter_m: f32,
    pub crown_base_height_m: f32,
    pub stem_diameter_m: f32,
    /// [`Species::id`].
    pub species: String,
}

fn as_array<S: serde::Serializer>(p: &Vec3, s: S) -> std::result::Result<S::Ok, S::Error> {
    p.to_array().serialize(s)
}

/// A square stand from (0, 0) to (side, side), with everything that is true of it.
pub struct Stand {
    pub frame: Frame,
    pub side_m: f32,
    pub relief: Relief,
    pub trees: Vec<TrueTree>,
    pub(super) shapes: Vec<Shape>,
    /// Luminance range and leaf colour of each tree's species.
    pub(super) looks: Vec<Look>,
    pub(super) seed: Seed,
}

#[derive(Debug, Clone, Copy)]
pub(super) struct Look {
    pub luminance: Option<[f32; 2]>,
    pub leaf: [u8; 3],
}

/// Plants a stand.
///
/// # Errors
/// No species, no tree or more than a million, or a share that is not above 0.
pub fn stand(options: &StandOptions<'_>) -> Result<Stand> {
    let sum: f32 = options.mix.iter().map(|m| m.1).sum();
    let is_share = |share: f32| share > 0.0 && share.is_finite();
    if options.mix.is_empty() || !options.mix.iter().all(|m| is_share(m.1)) {
        return Err(Error::new("a simulated stand needs species with shares above 0"));
    }
    if options.trees == 0 || options.trees > 1_000_000 {
        return Err(Error::new("a simulated stand needs 1 to 1,000,000 trees"));
    }
    let seed = options.seed.derive("stand", 0);
    let mut sizes: Vec<(usize, TrueTree)> = (0..options.trees)
        .map(|i| {
            // Exact quotas: tree i takes the species that holds its share of the sum.
            let mut left = (i as f32 + 0.5) / options.trees as f32 * sum;
            let which = options.mix.iter().position(|m| {
                left -= m.1;
                left < 0.0
            });
            let which = which.unwrap_or(options.mix.len() - 1);
            (which, sized(options.mix[which].0, &mut seed.derive("size", i as u64).draws()))
        })
        .collect();
    sizes.sort_by(|a, b| b.1.crown_diameter_m.total_cmp(&a.1.crown_diameter_m));
    let crown_area: f32 = sizes.iter().map(|s| 0.785 * s.1.crown_diameter_m.powi(2)).sum();
    let cover = options.crown_cover.clamp(0.1, 0.9);
    let mut side_m = (crown_area / cover).sqrt() + 2.0 * EDGE_M;
    let mut places = None;
    for attempt in 0..60 {
        places = scatter(&sizes, &options.mix, side_m, seed.derive("places", attempt));
        if places.is_some() {
            break;
        }
        side_m *= 1.03;
    }
    let places = places.ok_or_else(|| {
        Error::new("a simulated stand could not be planted").remedy("ask for a lower crown cover")
    })?;
    let side_m = side_m.ceil();
    let relief = Relief::new(side_m, options.relief_m, seed);
    let mut planted: Vec<(usize, TrueTree)> = sizes;
    for ((_, tree), p) in planted.iter_mut().zip(places) {
        let z = relief.height_at(f64::from(p.x), f64::from(p.y)) as f32;
        tree.position = p.extend(z);
    }
    // In reading order of the map, so that lists are easy to follow.
    planted.sort_by(|a, b| {
        let key = |t: &TrueTree| (-(t.position.y / 5.0).floor(), t.position.x);
        let (ka, kb) = (key(&a.1), key(&b.1));
        ka.0.total_cmp(&kb.0).then(ka.1.total_cmp(&kb.1))
    });
    // Krasnoyarsk region, UTM zone 46 north.
    let origin = DVec3::new(571_200.0, 6_214_800.0, 240.0);
    let frame = Frame { origin, crs: Some(Crs::from_epsg(32646)) };
    let shapes = planted
        .iter()
        .map(|(s, t)| Shape::new(t, options.mix[*s].0, seed.derive("shape", frame.key(t.position))))
        .collect();
    let looks = planted
        .iter()
        .map(|(s, _)| {
            let species = options.mix[*s].0;
            Look { luminance: species.luminance, leaf: species.foliage.colour }
        })
        .collect();
    let trees = planted.into_iter().map(|p| p.1).collect();
    Ok(Stand { frame, side_m, relief, trees, shapes, looks, seed })
}

/// Bare strip along the stand's edge, so that crowns are seen whole.
const EDGE_M: f32 = 3.0;

/// A tree of typical shape: one in eight is young.
fn sized(species: &Species, draws: &mut Draws) -> TrueTree {
    let size = &species.size;
    let is_young = draws.unit() < 0.125 && species.kind != Kind::Shrub;
    let scale = if is_young {
        draws.between(0.35, 0.55)
    } else {
        (0.86 + 0.13 * draws.normal()).clamp(0.55, 1.15)
    };
    let height_m = size.height_m * scale;
    let wide = 1.0 + 0.1 * draws.normal().clamp(-2.0, 2.0);
    let base = (size.crown_base + 0.05 * draws.normal()).clamp(0.0, 0.8);
    TrueTree {
        position: Vec3::ZERO,
        height_m,
        crown_diameter_m: size.crown_diameter_m * scale.powf(0.85) * wide,
        crown_base_height_m: base * height_m,
        stem_diameter_m: size.stem_diameter_m * scale.powf(1.2),
        species: species.id.clone(),
    }
}

/// A place for each tree, or `None` where one finds none.
fn scatter(
    sizes: &[(usize, TrueTree)],
    mix: &[(&Species, f32)],
    side_m: f32,
    seed: Seed,
) -> Option<Vec<Vec2>> {
    const TRIES: usize = 600;
    let mut draws = seed.draws();
    // Shrubs grow where the sun reaches them: the gaps have room for all.
    let shrubs = sizes.iter().filter(|s| mix[s.0].0.kind == Kind::Shrub);
    let shrub_area: f32 = shrubs.map(|s| 0.785 * s.1.crown_diameter_m.powi(2)).sum();
    let gap_area = (0.03 * side_m * side_m).max(2.2 * shrub_area).min(0.5 * side_m * side_m);
    let gaps: Vec<(Vec2, f32)> = [0.5f32, 0.3, 0.2]
        .into_iter()
        .map(|share| {
            let at = Vec2::new(draws.between(0.2, 0.8), draws.between(0.2, 0.8)) * side_m;
            (at, (gap_area * share / std::f32::consts::PI).sqrt())
        })
        .collect();
    let patch = Vec2::new(draws.between(0.06, 0.12), draws.between(0.06, 0.12));
    let turn = draws.between(0.0, 6.0);
    let widest = sizes.first().map_or(1.0, |s| s.1.crown_diameter_m).max(0.5);
    let cells = (side_m / widest).ceil().max(1.0) as i32;
    let mut grid: Vec<Vec<u32>> = vec![Vec::new(); (cells * cells) as usize];
    let cell_of =
        |p: Vec2| ((p / widest).as_ivec2()).clamp(glam::IVec2::ZERO, glam::IVec2::splat(cells - 1));
    let mut places: Vec<Vec2> = Vec::with_capacity(sizes.len());
    for (which, tree) in sizes {
        let is_shrub = mix[*which].0.kind == Kind::Shrub;
        let radius = tree.crown_diameter_m * 0.5;
        let margin = (radius + EDGE_M * 0.5).min(side_m * 0.5);
        let mut found = None;
        for attempt in 0..TRIES {
            let mut p = Vec2::new(
                draws.between(margin, side_m - margin),
                draws.between(margin, side_m - margin),
            );
            let is_picky = attempt < TRIES * 3 / 4;
            if is_shrub && is_picky {
                let gap = gaps[draws.index(gaps.len())];
                let (s, c) = draws.between(0.0, std::f32::consts::TAU).sin_cos();
                p = gap.0 + Vec2::new(c, s) * (gap.1 * 0.85 * draws.unit().sqrt());
                p = p.clamp(Vec2::splat(margin), Vec2::splat(side_m - margin));
            } else if is_picky {
                let density = 0.65 + 0.35 * (p.dot(patch) + turn).sin() * p.perp_dot(patch).cos();
                let in_gap = gaps.iter().any(|g| g.0.distance(p) < g.1 + radius * 0.8);
                if in_gap || draws.unit() > density {
                    continue;
                }
            }
            // Crowns mostly touch; where room runs out they may lean into each other.
            let ease = attempt as f32 / TRIES as f32;
            let spacing = 0.95 + (LEAST_SPACING - 0.95) * ease;
            let cell = cell_of(p);
            let is_free = (-1..=1).all(|dy| {
                (-1..=1).all(|dx| {
                    let c = cell + glam::IVec2::new(dx, dy);
                    if c.x < 0 || c.y < 0 || c.x >= cells || c.y >= cells {
                        return true;
                    }
                    grid[(c.y * cells + c.x) as usize].iter().all(|&i| {
                        let other = sizes[i as usize].1.crown_diameter_m * 0.5;
                        places[i as usize].distance(p) >= spacing * (radius + other)
                    })
                })
            });
            if is_free {
                found = Some((p, cell));
                break;
            }
        }
        let (p, cell) = found?;
        grid[(cell.y * cells + cell.x) as usize].push(places.len() as u32);
        places.push(p);
    }
    Some(places)
}
