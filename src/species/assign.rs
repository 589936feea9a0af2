//! The species of each crown: by the luminance of the photo (T15, Table 1), or conifer or broadleaf
//! by `kind` and then a species of that kind by its shape.
//!
//! **Luminance.** The species whose range is nearest to Y = 0.299 R + 0.587 G + 0.114 B (0…255) of
//! the sunlit crown takes it; 0 is inside the range. Ranges within `TIE` of the nearest tie (birch
//! and broadleaf overlap, conifers share one range), and the crown's shape decides between them:
//! height over diameter and crown base against the species' typical sizes, and no crown much taller
//! than its species grows. Exposure differs from flight to flight and acts on all crowns alike, as a
//! gain: the one that makes the crowns likeliest as a mixture of the ranges is taken, changes of
//! exposure costing a little by their size; the ranges then apply to Y times that gain, and a warning
//! says so.
//!
//! **Which of the two.** The ranges were measured in one survey; other cameras and places give
//! other luminances (docs/inventory.md); that of a photo of one band is another thing altogether. They
//! decide where the photo bears them out: most crowns lie
//! near ranges, and near ranges far apart (dark conifers beside brighter trees). A stand of one kind cannot be told from another exposure and
//! goes by `kind`.
//!
//! **Shape.** Among the species of the kind (all, where the kind is not known) one is drawn in
//! proportion to how well they fit the crown's shape, by the tree's key, so that a tree keeps its
//! species whatever other trees there are.
//!
//! Limit: hue, which a spectrozonal photo would need, is not used.

use rayon::prelude::*;

use super::Species;
use super::kind;
use super::look::Looks;
use super::model::Kind;
use super::photo::{Photo, Seen};
use crate::crown::Crown;
use crate::diagnostic::{Error, Result, Warned};
use crate::seed::Seed;

/// Distances in luminance that do not tell species apart.
const TIE: f32 = 3.0;
/// Luminance by which crowns lie outside their range, standard deviation.
const BEYOND: f32 = 3.0;
/// Log-likelihood of a crown that a factor e of exposure costs.
const GAIN_COST: f64 = 0.5;
/// Log-likelihood that a change of exposure must win at least: of a crown, and of all together.
const LEAST_GAINED: f64 = 0.05;
const LEAST_GAINED_OF_ALL: f64 = 6.0;
/// Steps of the logarithm of luminance, from 1 to 255, and of gain, to three times more or less.
const STEP: f32 = 0.01;
const STEPS: usize = 555;
const MOST_GAIN: i32 = 110;
/// The ranges hold for a photo that puts this share of the crowns near them, and this share near each
/// of two that lie `APART`, as dark conifers and other trees do.
const FITTING: f32 = 0.7;
const FITTING_EACH: f32 = 0.15;
const NEAR: f32 = 10.0;
const APART: f32 = 60.0;

/// What decides the species.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum SpeciesBy {
    /// The luminance where the photo bears out the ranges, else the shape.
    #[default]
    Auto,
    /// The luminance wherever the photo shows the crown.
    Luminance,
    /// Never the luminance.
    Shape,
}

/// Where a crown's species comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum How {
    /// It is the only one.
    Named,
    /// Luminance of the photo.
    Luminance,
    /// Kind by returns and photo, species by shape.
    ShapeAndPhoto,
    /// Kind by returns, species by shape.
    Shape,
}

impl How {
    pub const ALL: [How; 4] = [How::Named, How::Luminance, How::ShapeAndPhoto, How::Shape];

    /// As the inventory says it.
    pub fn text(self) -> &'static str {
        match self {
            How::Named => "named",
            How::Luminance => "luminance",
            How::ShapeAndPhoto => "shape and photo",
            How::Shape => "shape",
        }
    }
}

/// The species of one crown.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Assignment {
    /// Index into the species given.
    pub species: usize,
    /// Luminance of the sunlit crown as photographed, 0…255.
    pub luminance: Option<f32>,
    /// From the luminance (after correction of exposure) to the species' range, 0 inside; where
    /// luminance decided.
    pub luminance_distance: Option<f32>,
    /// How likely the kind (conifer or broadleaf) of the species is, 0…1; where shape decided
    /// between kinds.
    pub kind_chance: Option<f32>,
    pub how: How,
}

/// The species of every crown, in the crowns' order, of which `looks` and `photo` tell.
///
/// # Errors
/// No species to choose from.
pub fn assign(
    crowns: &[Crown],
    looks: &Looks,
    photo: Option<&Photo>,
    species: &[Species],
    by: SpeciesBy,
    seed: Seed,
) -> Result<Warned<Vec<Assignment>>> {
    if species.is_empty() {
        return Err(Error::new("no species to choose from")
            .remedy("name at least one, for example `--species larix_sibirica`"));
    }
    let mut warnings = Vec::new();
    let seen: Vec<Option<Seen>> = match photo {
        Some(photo) => crowns.par_iter().map(|c| photo.seen(&c.outline)).collect(),
        None => vec![None; crowns.len()],
    };
    let scale = match (photo, by) {
        _ if species.len() == 1 => None,
        (None, _) | (_, SpeciesBy::Shape) => None,
        (Some(photo), SpeciesBy::Auto) if !photo.has_colours() => None,
        _ => Scale::new(&seen, species, by == SpeciesBy::Luminance, &mut warnings),
    };
    let is_conifer = |s: &Species| s.kind == Kind::Conifer;
    let are_mixed = species.iter().any(is_conifer) && !species.iter().all(is_conifer);
    let every: Vec<usize> = (0..species.len()).collect();
    let assign = |i: usize, crown: &Crown| {
        let seen = seen.get(i).copied().flatten();
        let luminance = seen.map(|s| s.luminance);
        let base = Assignment {
            species: 0,
            luminance,
            luminance_distance: None,
            kind_chance: None,
            how: How::Named,
        };
        if species.len() == 1 {
            return base;
        }
        if let (Some(scale), Some(y)) = (&scale, luminance)
            && let Some((species, distance)) = scale.nearest(crown, y, species)
        {
            let luminance_distance = Some(distance);
            return Assignment { species, luminance_distance, how: How::Luminance, ..base };
        }
        let contrast = seen.and_then(|s| s.contrast);
        let chance = if are_mixed { conifer_chance(looks, i, contrast) } else { None };
        let how = match (chance, contrast) {
            (Some(_), Some(_)) => How::ShapeAndPhoto,
            _ => How::Shape,
        };
        let Some(chance) = chance else {
            return Assignment { species: by_shape(crown, species, &every, seed), how, ..base };
        };
        let wanted = chance >= 0.5;
        let of_kind = species.iter().enumerate().filter(|(_, s)| is_conifer(s) == wanted);
        let pool: Vec<usize> = of_kind.map(|(i, _)| i).collect();
        let species = by_shape(crown, species, &pool, seed);
        Assignment { species, kind_chance: Some(chance.max(1.0 - chance)), how, ..base }
    };
    let assignments = crowns.iter().enumerate().map(|(i, c)| assign(i, c)).collect();
    Ok(Warned::with(assignments, warnings))
}

fn conifer_chance(looks: &Looks, crown: usize, contrast: Option<f32>) -> Option<f32> {
    let look = looks.of_crown.get(crown).copied().flatten()?;
    let intensity = looks.intensity_over_ground(&look);
    let (mean, spread) = (Some(look.mean_height), Some(look.height_spread));
    kind::conifer_chance(&[mean, spread, intensity, contrast], look.steepness)
}

/// The species' ranges of luminance, and the photo's exposure against them.
struct Scale {
    ranges: Vec<(usize, [f32; 2])>,
    gain: f32,
}

impl Scale {
    /// `None` where the ranges are not to be used; `is_wanted`: use them though the photo does not
    /// bear them out.
    fn new(
        seen: &[Option<Seen>],
        species: &[Species],
        is_wanted: bool,
        warnings: &mut Vec<String>,
    ) -> Option<Scale> {
        let ranges: Vec<(usize, [f32; 2])> =
            species.iter().enumerate().filter_map(|(i, s)| Some((i, s.luminance?))).collect();
        if ranges.is_empty() {
            warnings.push(
                "The luminance is not used for the species: none of them states a range \
                 `luminance`."
                    .into(),
            );
            return None;
        }
        let lit: Vec<f32> = seen.iter().flatten().map(|s| s.luminance).collect();
        let dark = seen.len() - lit.len();
        if dark > 0 {
            warnings.push(format!(
                "The photo shows nothing of {dark} of {} crowns; their species come from their shape.",
                seen.len()
            ));
        }
        let scale = Scale { gain: exposure(&lit, &ranges), ranges };
        let is_fit = scale.fits(&lit);
        if !is_fit && !is_wanted {
            return None;
        }
        if scale.gain != 1.0 {
            warnings.push(format!(
                "The photo's exposure does not fit the luminance ranges of the species; its \
                 luminance was multiplied by {:.2}.",
                scale.gain
            ));
        }
        if !is_fit {
            warnings.push(
                "The photo does not bear out the luminance ranges of the species: the crowns lie \
                 outside them, or all in one; `--species-by auto` goes by the shape then."
                    .into(),
            );
        }
        Some(scale)
    }

    /// Whether the crowns lie where the ranges say, in more than one place.
    fn fits(&self, lit: &[f32]) -> bool {
        let share = |of: &dyn Fn(f32) -> bool| {
            lit.iter().filter(|y| of(**y * self.gain)).count() as f32 / lit.len().max(1) as f32
        };
        let is_near = |y: f32, range: &[f32; 2]| distance(y, *range) <= NEAR;
        if share(&|y| self.ranges.iter().any(|(_, r)| is_near(y, r))) < FITTING {
            return false;
        }
        let held: Vec<[f32; 2]> = self
            .ranges
            .iter()
            .map(|(_, r)| *r)
            .filter(|r| share(&|y| is_near(y, r)) >= FITTING_EACH)
            .collect();
        let lowest = held.iter().map(|r| r[1]).fold(f32::INFINITY, f32::min);
        held.iter().any(|r| r[0] - lowest >= APART)
    }

    /// The species of nearest range, the best shape among ties, with the distance.
    fn nearest(&self, crown: &Crown, y: f32, species: &[Species]) -> Option<(usize, f32)> {
        let known: Vec<(f32, usize, &Species)> = self
            .ranges
            .iter()
            .filter_map(|(i, range)| Some((distance(y * self.gain, *range), *i, species.get(*i)?)))
            .collect();
        let allowed: Vec<_> = known.iter().filter(|(_, _, s)| may_be(crown, s)).collect();
        let pool = if allowed.is_empty() { known.iter().collect() } else { allowed };
        let least = pool.iter().map(|(d, _, _)| *d).fold(f32::INFINITY, f32::min);
        pool.into_iter()
            .filter(|(d, _, _)| *d <= least + TIE)
            .min_by(|a, b| misfit(crown, a.2).total_cmp(&misfit(crown, b.2)).then(a.1.cmp(&b.1)))
            .map(|(d, i, _)| (*i, *d))
    }
}

fn distance(y: f32, [low, high]: [f32; 2]) -> f32 {
    (low - y).max(y - high).max(0.0)
}

/// The gain that makes the crowns' luminances likeliest, as a mixture of the ranges in unknown shares
/// and a few crowns of any luminance; 1 where that is hardly less likely. The same photo brightened
/// gives the same luminances times gain, but for what is clipped at its white.
fn exposure(lit: &[f32], ranges: &[(usize, [f32; 2])]) -> f32 {
    let mut classes: Vec<[f32; 2]> = ranges.iter().map(|(_, r)| *r).collect();
    classes.sort_by(|a, b| a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1])));
    classes.dedup();
    if lit.is_empty() || classes.is_empty() {
        return 1.0;
    }
    // Counts by luminance in steps of 1 %, as are the gains.
    let mut counts = [0u32; STEPS];
    for y in lit {
        counts[((y.max(1.0).ln() / STEP) as usize).min(STEPS - 1)] += 1;
    }
    let counts: Vec<(usize, f64)> =
        (0..).zip(counts).filter(|(_, n)| *n > 0).map(|(at, n)| (at, f64::from(n))).collect();
    let likelihood = |gain: i32| {
        let steps = f64::from(gain) * f64::from(STEP);
        mean_log_likelihood(&counts, &classes, gain) - GAIN_COST * steps.abs()
    };
    let best = (-MOST_GAIN..=MOST_GAIN).map(|gain| (likelihood(gain), gain)).max_by(|a, b| {
        // The lesser change where two are as good.
        a.0.total_cmp(&b.0).then(b.1.abs().cmp(&a.1.abs()))
    });
    let least = LEAST_GAINED + LEAST_GAINED_OF_ALL / lit.len() as f64;
    match best {
        Some((most, gain)) if most - likelihood(0) > least => (gain as f32 * STEP).exp(),
        _ => 1.0,
    }
}

/// Of the logarithms of luminances, counted in steps, at a gain of so many steps. The shares of the
/// classes are those that make it greatest (expectation maximisation).
fn mean_log_likelihood(counts: &[(usize, f64)], classes: &[[f32; 2]], gain: i32) -> f64 {
    const ROUNDS: usize = 12;
    const ANY: f64 = 0.05;
    let of_step = |at: usize, class: &[f32; 2]| {
        let y = ((at as f32 + 0.5 + gain as f32) * STEP).exp();
        let [width, off] = [class[1] - class[0], distance(y, *class)];
        let area = width + BEYOND * std::f32::consts::TAU.sqrt();
        f64::from(y / area * (-0.5 * (off / BEYOND).powi(2)).exp())
    };
    let density: Vec<Vec<f64>> = (counts.iter())
        .map(|(at, _)| classes.iter().map(|class| of_step(*at, class)).collect())
        .collect();
    // Any luminance is as likely as another.
    let any = |at: usize| f64::from((at as f32 * STEP).exp()) / 255.0;
    let all: f64 = counts.iter().map(|(_, n)| n).sum();
    let mut share = vec![(1.0 - ANY) / classes.len() as f64; classes.len()];
    let mut log_likelihood = f64::MIN;
    for _ in 0..ROUNDS {
        let mut held = vec![0.0; classes.len()];
        log_likelihood = 0.0;
        for ((at, n), of) in counts.iter().zip(&density) {
            let own: f64 = of.iter().zip(&share).map(|(d, s)| d * s).sum();
            let sum = own + ANY * any(*at);
            log_likelihood += n * sum.ln();
            for ((held, d), s) in held.iter_mut().zip(of).zip(&share) {
                *held += n * d * s / sum;
            }
        }
        let total: f64 = held.iter().sum();
        for (share, held) in share.iter_mut().zip(&held) {
            *share = (1.0 - ANY) * held / total.max(1e-300);
        }
    }
    log_likelihood / all
}

/// A shrub does not grow into a tree.
fn may_be(crown: &Crown, species: &Species) -> bool {
    species.kind != Kind::Shrub || crown.height_m <= 1.8 * species.size.height_m
}

/// How unlike the crown's shape is to the species' own; 0 is alike, 1 plainly unlike.
fn misfit(crown: &Crown, species: &Species) -> f32 {
    let size = &species.size;
    let slender = |height: f32, diameter: f32| (height.max(0.1) / diameter.max(0.1)).ln();
    let shape =
        slender(crown.height_m, crown.diameter_m) - slender(size.height_m, size.crown_diameter_m);
    let base = crown.base_height_m / crown.height_m.max(0.1) - size.crown_base;
    // Above its usual height a species grows ever less likely.
    let over = (crown.height_m.max(0.1) / size.height_m).ln().max(0.0);
    shape.abs() + 0.5 * base.abs() + 2.0 * over
}

/// A species of the pool drawn in proportion to exp(−4 misfit), by the tree's key.
fn by_shape(crown: &Crown, species: &[Species], pool: &[usize], seed: Seed) -> usize {
    let of_pool = || pool.iter().filter_map(|&i| Some((i, species.get(i)?)));
    let mut fits: Vec<(usize, f32)> =
        of_pool().filter(|(_, s)| may_be(crown, s)).map(|(i, s)| (i, misfit(crown, s))).collect();
    if fits.is_empty() {
        fits = of_pool().map(|(i, s)| (i, misfit(crown, s))).collect();
    }
    let least = fits.iter().map(|f| f.1).fold(f32::INFINITY, f32::min);
    let weight = |misfit: f32| (-4.0 * (misfit - least)).exp();
    let all: f32 = fits.iter().map(|f| weight(f.1)).sum();
    let mut left = seed.derive("species", crown.key).draws().unit() * all;
    for &(i, misfit) in &fits {
        if left < weight(misfit) {
            return i;
        }
        left -= weight(misfit);
    }
    fits.iter().find(|f| f.1 == least).map_or(0, |f| f.0)
}

#[cfg(test)]
mod tests {
    use glam::{DVec3, Vec2, Vec3};

    use super::*;
    use crate::frame::Frame;
    use crate::raster::GridGeometry;
    use crate::raster::geotiff::{Raster, Samples};
    use crate::species;

    fn crown(key: u64, x: f32, height_m: f32, diameter_m: f32) -> Crown {
        let r = diameter_m / 2.0;
        let corner = |dx: f32, dy: f32| Vec2::new(x + dx * r, 5.0 + dy * r);
        Crown {
            key,
            root: Vec3::new(x, 5.0, 0.0),
            apex: Vec3::new(x, 5.0, height_m),
            height_m,
            base_height_m: 0.3 * height_m,
            diameter_m,
            spread_m: 5.0,
            volume_cu_m: 60.0,
            surface_sq_m: 90.0,
            is_understory: false,
            outline: vec![corner(-1., -1.), corner(1., -1.), corner(1., 1.), corner(-1., 1.)],
            attractors: Vec::new(),
            point_count: 100,
            confidence: 1.0,
        }
    }

    fn all(names: &[&str]) -> Vec<Species> {
        names.iter().map(|n| species::load(n).unwrap()).collect()
    }

    /// A photo of vertical stripes 4 m wide, each of one grey.
    fn stripes(greys: &[f32]) -> Photo {
        striped(3, greys)
    }

    fn striped(bands: usize, greys: &[f32]) -> Photo {
        let side = greys.len() * 4;
        let value = |i: usize| greys[(i / bands) % side / 4];
        let samples = Samples::F32((0..side * side * bands).map(value).collect());
        let geometry = GridGeometry {
            west: 500_000.0,
            north: 6_000_000.0 + side as f64,
            cell_x: 1.0,
            cell_y: 1.0,
            cols: side,
            rows: side,
        };
        let geometry = Some(geometry);
        let raster = Raster {
            width: side,
            height: side,
            bands,
            samples,
            geometry,
            epsg: None,
            nodata: None,
        };
        let frame = Frame::local(DVec3::new(500_000.0, 6_000_000.0, 100.0));
        Photo::new("photo.tif", raster, &frame, Vec2::ZERO, Vec2::splat(10.0)).unwrap().value
    }

    #[test]
    fn luminance_gives_the_class_of_table_1() {
        let species = all(&["larix_sibirica", "betula_pendula", "picea_obovata", "salix_caprea"]);
        let photo = stripes(&[169.0, 189.0, 78.0, 120.0, 100.0]);
        let crowns: Vec<Crown> = (0..5).map(|i| crown(i, i as f32 * 4.0 + 2.0, 6.0, 2.0)).collect();
        let found = assign(
            &crowns,
            &Looks::default(),
            Some(&photo),
            &species,
            SpeciesBy::Auto,
            Seed::new(1),
        )
        .unwrap();
        let chosen: Vec<(usize, f32)> =
            found.value.iter().map(|a| (a.species, a.luminance_distance.unwrap())).collect();
        // The last is in no range: 15 from the shrubs, 15 from the conifers; shape decides.
        assert_eq!(chosen[..4], [(0, 0.0), (1, 0.0), (2, 0.0), (3, 0.0)]);
        assert_eq!(chosen[4].1, 15.0);
        assert!(found.value.iter().all(|a| a.how == How::Luminance));
        assert!(found.warnings.is_empty(), "{:?}", found.warnings);
        // Of one band, whose numbers are no luminance of colours.
        let photo = striped(1, &[169.0, 189.0, 78.0, 120.0, 100.0]);
        let by = |by| {
            assign(&crowns, &Looks::default(), Some(&photo), &species, by, Seed::new(1))
                .unwrap()
                .value
        };
        assert!(by(SpeciesBy::Auto).iter().all(|a| a.how == How::Shape && a.luminance.is_some()));
        assert!(by(SpeciesBy::Luminance).iter().all(|a| a.how == How::Luminance));
    }

    #[test]
    fn shape_decides_between_overlapping_ranges() {
        let species = all(&["betula_pendula", "quercus_robur"]);
        let photo = stripes(&[185.5; 8]);
        let crowns = [crown(1, 6.0, 20.0, 4.0), crown(2, 16.0, 12.0, 11.0)];
        let found = assign(
            &crowns,
            &Looks::default(),
            Some(&photo),
            &species,
            SpeciesBy::Luminance,
            Seed::new(1),
        )
        .unwrap()
        .value;
        assert_eq!(found[0].species, 0, "tall and narrow: birch");
        assert_eq!(found[1].species, 1, "low and broad: oak");
    }

    #[test]
    fn a_tall_tree_is_no_shrub() {
        let species = all(&["picea_obovata", "salix_caprea"]);
        let photo = stripes(&[120.0; 4]);
        let found = assign(
            &[crown(1, 6.0, 28.0, 4.0)],
            &Looks::default(),
            Some(&photo),
            &species,
            SpeciesBy::Luminance,
            Seed::new(1),
        );
        assert_eq!(found.unwrap().value[0].species, 0);
    }

    #[test]
    fn exposure_is_found_and_said() {
        let species = all(&["larix_sibirica", "betula_pendula", "picea_obovata"]);
        let truth = [169.0, 189.0, 78.0, 188.0, 168.0, 79.0, 186.0, 170.0];
        let photo = stripes(&truth.map(|y| y * 0.75));
        let crowns: Vec<Crown> =
            (0..8).map(|i| crown(i, i as f32 * 4.0 + 2.0, 10.0, 2.0)).collect();
        let found = assign(
            &crowns,
            &Looks::default(),
            Some(&photo),
            &species,
            SpeciesBy::Auto,
            Seed::new(1),
        )
        .unwrap();
        let chosen: Vec<usize> = found.value.iter().map(|a| a.species).collect();
        assert_eq!(chosen, [0, 1, 2, 1, 0, 2, 1, 0]);
        assert_eq!(found.warnings.len(), 1);
        assert!(found.warnings[0].contains("multiplied by 1.3"), "{}", found.warnings[0]);
    }

    #[test]
    fn a_brighter_or_darker_photo_gives_the_same_species() {
        let ranges: Vec<(usize, [f32; 2])> =
            [[167.0, 171.0], [184.0, 193.0], [72.0, 85.0], [115.0, 127.0]]
                .into_iter()
                .enumerate()
                .collect();
        let mut draws = Seed::new(8).draws();
        let lit: Vec<f32> = (0..300)
            .map(|i| {
                let [low, high] = ranges[[0, 1, 2, 2, 3][i % 5]].1;
                draws.between(low, high) + 3.0 * draws.normal()
            })
            .collect();
        for gain in [0.4, 0.55, 0.7, 0.85, 0.95, 1.0, 1.1, 1.25] {
            let seen: Vec<f32> = lit.iter().map(|y| y * gain).collect();
            let found = exposure(&seen, &ranges);
            assert!((found * gain - 1.0).abs() < 0.03, "{gain}: {found}");
        }
        // One species alone could be any at some exposure: it stays as it is.
        let spruces: Vec<f32> = (0..100).map(|_| 78.0 + 5.0 * draws.normal()).collect();
        assert_eq!(exposure(&spruces, &ranges), 1.0);
    }

    #[test]
    fn without_a_photo_a_tree_keeps_its_species() {
        let species =
            all(&["larix_sibirica", "betula_pendula", "pinus_sylvestris", "picea_obovata"]);
        let crowns: Vec<Crown> = (0..400).map(|i| crown(i, 0.0, 18.0, 5.0)).collect();
        let found =
            assign(&crowns, &Looks::default(), None, &species, SpeciesBy::Auto, Seed::new(1))
                .unwrap()
                .value;
        assert!(found.iter().all(|a| a.how == How::Shape && a.luminance.is_none()));
        for (s, wanted) in species.iter().enumerate() {
            assert!(found.iter().any(|a| a.species == s), "no {}", wanted.id);
        }
        let fewer = assign(
            &crowns[200..],
            &Looks::default(),
            None,
            &species,
            SpeciesBy::Auto,
            Seed::new(1),
        )
        .unwrap()
        .value;
        for (a, b) in found[200..].iter().zip(&fewer) {
            assert_eq!((a.species, b.how), (b.species, How::Shape));
        }
        assert!(
            assign(&crowns, &Looks::default(), None, &[], SpeciesBy::Auto, Seed::new(1)).is_err()
        );
    }
}
