//! Stem diameter and biomass of a tree from its height and crown, by published equations.
//!
//! - Jucker et al. 2017: Allometric equations for integrating remote sensing imagery into forest
//!   monitoring programmes. Global Change Biology 23(1): 177–190, doi 10.1111/gcb.13388. Stem
//!   diameter D (cm) = a (H CD)^b, by biome and functional group; above-ground biomass (kg) of
//!   gymnosperms and of angiosperms from H CD. H: height, CD: crown diameter, both metres.
//! - Marklund 1988: Biomassafunktioner för tall, gran och björk i Sverige. SLU, Rapport 45. Dry
//!   weight (kg) of the parts of pine and spruce from D (cm) and H (m): functions T and G.
//! - Smith, Granhus, Astrup, Bollandsås, Petersson 2014: Functions for estimating aboveground
//!   biomass of birch in Norway. Scandinavian Journal of Forest Research 29(6): 565–578.
//!
//! Siberian spruce takes the functions of Norway spruce, of which it is a close relative.
//!
//! Limits: a scan sees the crown that reaches the light; the crowns of the equations were measured
//! from below, and overlap. Outside the sizes the equations were fitted to (stems of some 1 to
//! 200 cm for Jucker, up to 50 cm for the others) they are extrapolations.

use super::Species;
use super::model::Kind;

/// D (cm) = a (H CD)^b (Jucker et al. 2017).
struct Stem {
    a: f64,
    b: f64,
}

/// All trees of the world, with the correction e^(0.056²/2) for the logarithm.
const GLOBAL: Stem = Stem { a: 0.557 * 1.001_569, b: 0.809 };
const BOREAL_BROADLEAF: Stem = Stem { a: 0.467, b: 0.839 };
const BOREAL_CONIFER: Stem = Stem { a: 1.43, b: 0.649 };
const TEMPERATE_BROADLEAF: Stem = Stem { a: 0.694, b: 0.73 };
const TEMPERATE_CONIFER: Stem = Stem { a: 1.004, b: 0.73 };

/// The stem equation of a species: of its biome in Eurasia, or the global one.
fn stem(species: &Species) -> Stem {
    match species.id.as_str() {
        "abies_sibirica" | "larix_sibirica" | "picea_obovata" | "pinus_sibirica"
        | "pinus_sylvestris" => BOREAL_CONIFER,
        "betula_pendula" | "populus_tremula" | "salix_caprea" | "sorbus_aucuparia" => {
            BOREAL_BROADLEAF
        }
        "larix_decidua" | "picea_abies" => TEMPERATE_CONIFER,
        "corylus_avellana" | "quercus_robur" | "tilia_cordata" => TEMPERATE_BROADLEAF,
        _ => GLOBAL,
    }
}

/// Stem diameter at 1.3 m, metres, of a tree of this height and crown diameter, metres. 0 for a
/// tree lower than that.
pub fn stem_diameter_m(species: &Species, height_m: f32, crown_diameter_m: f32) -> f32 {
    if height_m <= BREAST_HEIGHT_M {
        return 0.0;
    }
    let Stem { a, b } = stem(species);
    let size = f64::from(height_m) * f64::from(crown_diameter_m.max(0.0));
    (0.01 * a * size.powf(b)) as f32
}

const BREAST_HEIGHT_M: f32 = 1.3;

/// Dry above-ground biomass, kilograms, of a tree of this height and crown diameter, metres; where
/// the species' equation is of the stem, with the diameter of [`stem_diameter_m`].
pub fn biomass_kg(species: &Species, height_m: f32, crown_diameter_m: f32) -> f32 {
    let h = f64::from(height_m.max(0.0));
    let d = 100.0 * f64::from(stem_diameter_m(species, height_m, crown_diameter_m));
    let kg = match species.id.as_str() {
        "pinus_sylvestris" if d > 0.0 => marklund_pine(d, h),
        "picea_abies" | "picea_obovata" if d > 0.0 => marklund_spruce(d, h),
        "betula_pendula" if d > 0.0 => smith_birch(d, h),
        _ => jucker(species.kind == Kind::Conifer, h * f64::from(crown_diameter_m.max(0.0))),
    };
    kg as f32
}

/// Gymnosperm or angiosperm, with the correction e^(0.204²/2) for the logarithm.
fn jucker(is_gymnosperm: bool, size: f64) -> f64 {
    let (a, b) = if is_gymnosperm { (0.016 + 0.093, 2.013 - 0.223) } else { (0.016, 2.013) };
    a * size.powf(b) * (0.204f64.powi(2) / 2.0).exp()
}

/// Stem wood, bark, living branches with needles, dead branches; without the stump.
fn marklund_pine(d: f64, h: f64) -> f64 {
    let ln_h = h.ln();
    (-2.6864 + 7.6066 * d / (d + 14.0) + 0.0200 * h + 0.8658 * ln_h).exp()
        + (-3.2765 + 7.2482 * d / (d + 16.0) + 0.4487 * ln_h).exp()
        + (-2.5413 + 13.3955 * d / (d + 10.0) - 1.1955 * ln_h).exp()
        + (-5.8926 + 7.1270 * d / (d + 10.0) - 0.0465 * h + 1.1060 * ln_h).exp()
}

/// As [`marklund_pine`].
fn marklund_spruce(d: f64, h: f64) -> f64 {
    let ln_h = h.ln();
    (-2.3032 + 7.2309 * d / (d + 14.0) + 0.0355 * h + 0.7030 * ln_h).exp()
        + (-3.4020 + 8.3089 * d / (d + 15.0) + 0.0147 * h + 0.2295 * ln_h).exp()
        + (-1.2063 + 10.9708 * d / (d + 13.0) - 0.0124 * h - 0.4923 * ln_h).exp()
        + (-4.6351 + 3.6518 * d / (d + 18.0) + 0.0493 * h + 1.0129 * ln_h).exp()
}

/// Above the stump.
fn smith_birch(d: f64, h: f64) -> f64 {
    0.0521 * d.powf(2.1372) * h.powf(0.5570)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::species::{builtin_names, load};

    #[test]
    fn equations_give_what_their_papers_do() {
        // By hand: H CD = 100 m², 15 m high.
        let near = |a: f64, b: f64| assert!((a / b - 1.0).abs() < 1e-3, "{a} for {b}");
        near(jucker(true, 100.0), 423.12);
        near(jucker(false, 100.0), 173.44);
        let cm = |id: &str| 100.0 * f64::from(stem_diameter_m(&load(id).unwrap(), 20.0, 5.0));
        near(cm("larix_sibirica"), 28.40);
        near(cm("betula_pendula"), 22.25);
        near(cm("quercus_robur"), 20.02);
        let mut own = load("larix_sibirica").unwrap();
        own.id = "my_larch".into();
        near(100.0 * f64::from(stem_diameter_m(&own, 20.0, 5.0)), 23.15);
    }

    #[test]
    fn equations_of_the_same_tree_agree_roughly() {
        // 20 m high, 20 cm thick: each tells some 100 to 200 kg.
        for kg in [marklund_pine(20.0, 20.0), marklund_spruce(20.0, 20.0), smith_birch(20.0, 20.0)]
        {
            assert!((100.0..250.0).contains(&kg), "{kg}");
        }
    }

    #[test]
    fn a_larger_tree_is_thicker_and_heavier() {
        for name in builtin_names() {
            let Ok(species) = load(name) else { continue };
            let of = |h, cd| (stem_diameter_m(&species, h, cd), biomass_kg(&species, h, cd));
            let mut last = (0.0, 0.0);
            for size in 1..40 {
                let now = of(size as f32, 0.3 * size as f32);
                assert!(now.0 >= last.0 && now.1 > last.1, "{name} of {size} m: {now:?}");
                last = now;
            }
            assert_eq!(of(1.0, 1.0).0, 0.0);
        }
    }
}
