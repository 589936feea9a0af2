//! The species of each crown, from the aerial photo where there is one (T15, Table 1).
//!
//! A crown's luminance Y = 0.299 R + 0.587 G + 0.114 B (0…255) is the mean of its sunlit pixels:
//! those from the median to the 95th percentile inside the outline, so that neither shade nor
//! glare counts. The species whose range is nearest takes the crown; 0 is inside the range.
//! Ranges within `TIE` of the nearest tie (birch and broadleaf overlap, conifers share one
//! range), and the crown's shape decides between them: height over diameter and crown base against
//! the species' typical sizes, and no crown much taller than its species grows.
//!
//! Exposure differs from flight to flight and acts on all crowns alike, as a gain. Where the median
//! crown lies farther than `FAR` from every range, the gain is sought that brings the crowns
//! nearest, changes of exposure costing by their size; the ranges then apply to Y times that gain,
//! and a warning says so.
//!
//! Limits: a stand that is dark as a whole and bright as a whole look alike once one of them falls
//! into a range; hue, which a spectrozonal photo would need, is not used. Without a photo (or where
//! it has no pixels) species are drawn in proportion to how well they fit the crown's shape, by the
//! tree's key, so that a tree keeps its species whatever other trees there are.

use glam::{DVec3, Vec2, Vec3};
use rayon::prelude::*;

use super::Species;
use super::model::Kind;
use crate::crown::Crown;
use crate::diagnostic::{Error, Result, Warned};
use crate::frame::Frame;
use crate::raster::GridGeometry;
use crate::raster::geotiff::{Raster, Samples};
use crate::seed::Seed;

/// Species of a stand of which nothing is known.
pub const DEFAULT_MIX: [&str; 4] =
    ["larix_sibirica", "betula_pendula", "pinus_sylvestris", "picea_obovata"];

/// Distances in luminance that do not tell species apart.
const TIE: f32 = 3.0;
/// Median distance beyond which the photo's exposure is in doubt.
const FAR: f32 = 12.0;
/// Luminance that a factor e of exposure costs per crown.
const GAIN_COST: f32 = 12.0;
/// Greatest number of samples along a side of a crown.
const SAMPLES: usize = 32;

/// A photo placed over the scan; read in local metres.
#[derive(Debug, Clone)]
pub struct Photo {
    raster: Raster,
    /// World units.
    geometry: GridGeometry,
    frame: Frame,
    /// From the file's numbers to 0…255.
    scale: f32,
}

impl Photo {
    /// Places a photo over a scan whose points fill `min..max` (local metres of `frame`). `name`
    /// stands in messages. The numbers are brought to 0…255: 16-bit and float photos by the least
    /// power of two (or 1) that holds 99.9 % of them. A fourth band is ignored.
    ///
    /// # Errors
    /// No georeference, no band, or no overlap with the scan.
    pub fn new(name: &str, raster: Raster, frame: &Frame, min: Vec2, max: Vec2) -> Result<Photo> {
        let Some(geometry) = raster.geometry else {
            return Err(Error::new("the photo has no georeference")
                .in_file(name)
                .remedy("give a GeoTIFF, or put a world file (.tfw) beside the photo"));
        };
        let sampled = raster.width.saturating_mul(raster.height).saturating_mul(raster.bands);
        let held = match &raster.samples {
            Samples::U8(v) => v.len(),
            Samples::U16(v) => v.len(),
            Samples::F32(v) => v.len(),
        };
        if raster.bands == 0 || sampled == 0 || held < sampled {
            return Err(Error::new("the photo holds no pixels")
                .in_file(name)
                .remedy("give a photo of one, three or more bands"));
        }
        let low = frame.world_from_local(Vec3::new(min.x, min.y, 0.0));
        let high = frame.world_from_local(Vec3::new(max.x, max.y, 0.0));
        let is_apart = geometry.west > high.x
            || geometry.east() < low.x
            || geometry.south() > high.y
            || geometry.north < low.y;
        if is_apart {
            let scan_epsg = frame.crs.as_ref().and_then(|c| c.epsg);
            return Err(Error::new(format!(
                "the photo lies elsewhere than the scan: photo x {:.0} to {:.0}, y {:.0} to {:.0}{}; \
                 scan x {:.0} to {:.0}, y {:.0} to {:.0}{}",
                geometry.west,
                geometry.east(),
                geometry.south(),
                geometry.north,
                epsg_text(raster.epsg),
                low.x,
                high.x,
                low.y,
                high.y,
                epsg_text(scan_epsg),
            ))
            .in_file(name)
            .remedy("give a photo of the scanned place, in the scan's coordinate system"));
        }
        let scale = scale(&raster);
        Ok(Photo { raster, geometry, frame: frame.clone(), scale })
    }

    /// Red, green and blue, 0…255, at a place in local metres; a grey photo gives three equal
    /// values. `None` outside the photo and where it has no data (its nodata value, a NaN, or the
    /// pure black that fills the edges of mosaics).
    pub fn sample(&self, p: Vec2) -> Option<[f32; 3]> {
        let world = self.frame.world_from_local(Vec3::new(p.x, p.y, 0.0));
        self.sample_world(world)
    }

    /// [`Photo::sample`] at a place in world coordinates.
    pub fn sample_world(&self, world: DVec3) -> Option<[f32; 3]> {
        let (col, row) = self.geometry.cell_of(world.x, world.y)?;
        if col >= self.raster.width || row >= self.raster.height {
            return None;
        }
        let bands = if self.raster.bands >= 3 { [0, 1, 2] } else { [0, 0, 0] };
        let raw = bands.map(|b| self.raster.value(col, row, b));
        let is_nodata = |v: f32| self.raster.nodata.is_some_and(|n| v == n as f32);
        if raw.iter().any(|v| !v.is_finite()) || raw.iter().all(|&v| is_nodata(v) || v == 0.0) {
            return None;
        }
        Some(raw.map(|v| (v * self.scale).clamp(0.0, 255.0)))
    }

    /// Side of a pixel, local metres.
    pub fn pixel_m(&self) -> f32 {
        let unit = self.frame.unit_m();
        (self.geometry.cell_x * unit.x).min(self.geometry.cell_y * unit.y) as f32
    }

    /// Luminance of the sunlit part of a crown, `None` where the photo shows nothing of it.
    pub fn luminance(&self, outline: &[Vec2]) -> Option<f32> {
        let first = *outline.first()?;
        let (min, max) =
            outline.iter().fold((first, first), |(lo, hi), p| (lo.min(*p), hi.max(*p)));
        let step = self.pixel_m().max((max - min).max_element() / SAMPLES as f32);
        if !(step > 0.0 && step.is_finite()) {
            return None;
        }
        let count = ((max - min) / step).ceil().max(Vec2::ONE);
        let mut values = Vec::new();
        for row in 0..count.y as usize {
            for col in 0..count.x as usize {
                let p = min + (Vec2::new(col as f32, row as f32) + 0.5) * (max - min) / count;
                if contains(outline, p)
                    && let Some(rgb) = self.sample(p)
                {
                    values.push(luminance(rgb));
                }
            }
        }
        values.sort_by(f32::total_cmp);
        // From the median to the 95th percentile, at least one value.
        let from = values.len() / 2;
        let to = (values.len() * 19 / 20).max(from + 1);
        let lit = values.get(from..to.min(values.len()))?;
        (!lit.is_empty()).then(|| lit.iter().sum::<f32>() / lit.len() as f32)
    }
}

fn epsg_text(epsg: Option<u32>) -> String {
    epsg.map_or_else(String::new, |code| format!(" (EPSG {code})"))
}

/// Luminance of a colour, in its own units (T15).
pub fn luminance([r, g, b]: [f32; 3]) -> f32 {
    0.299 * r + 0.587 * g + 0.114 * b
}

/// What brings the file's numbers to 0…255.
fn scale(raster: &Raster) -> f32 {
    let pixels = raster.width * raster.height;
    let colours = raster.bands.min(3);
    // Some 100,000 pixels tell the range.
    let stride = pixels.div_ceil(100_000).max(1);
    let mut values: Vec<f32> = match &raster.samples {
        Samples::U8(_) => return 1.0,
        _ => (0..pixels)
            .step_by(stride)
            .flat_map(|i| (0..colours).map(move |b| (i % raster.width, i / raster.width, b)))
            .map(|(col, row, b)| raster.value(col, row, b))
            .filter(|v| v.is_finite() && raster.nodata.is_none_or(|n| *v != n as f32))
            .collect(),
    };
    values.sort_by(f32::total_cmp);
    let most = values.get(values.len().saturating_sub(1 + values.len() / 1000)).copied();
    let most = most.unwrap_or(255.0);
    let is_float = matches!(raster.samples, Samples::F32(_));
    let full = [1.0, 255.0, 1023.0, 4095.0, 16383.0, 65535.0]
        .into_iter()
        .find(|full| most <= full * 1.001 && (is_float || *full > 1.0))
        .unwrap_or(most);
    255.0 / full
}

/// Whether a point lies inside a polygon (even-odd rule).
fn contains(polygon: &[Vec2], p: Vec2) -> bool {
    let mut inside = false;
    let mut previous = polygon.last().copied().unwrap_or_default();
    for &corner in polygon {
        if (corner.y > p.y) != (previous.y > p.y) {
            let t = (p.y - corner.y) / (previous.y - corner.y);
            if p.x < corner.x + t * (previous.x - corner.x) {
                inside = !inside;
            }
        }
        previous = corner;
    }
    inside
}

/// Where a crown's species comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum How {
    /// Luminance of the photo.
    Photo,
    /// Drawn among the species the user named, by shape.
    Requested,
    /// Drawn among the default mix, by shape.
    DefaultMix,
}

/// The species of one crown.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Assignment {
    /// Index into the species given.
    pub species: usize,
    /// Luminance of the sunlit crown as photographed, 0…255.
    pub luminance: Option<f32>,
    /// From the luminance (after correction of exposure) to the species' range; 0 inside, and
    /// where no photo was used.
    pub distance: f32,
    pub how: How,
}

/// The species of every crown, in the crowns' order. `is_requested`: the species are the user's
/// own choice rather than the default mix; the photo then chooses among those.
///
/// # Errors
/// No species to choose from.
pub fn assign(
    crowns: &[Crown],
    photo: Option<&Photo>,
    species: &[Species],
    is_requested: bool,
    seed: Seed,
) -> Result<Warned<Vec<Assignment>>> {
    if species.is_empty() {
        return Err(Error::new("no species to choose from")
            .remedy("name at least one, for example `--species larix_sibirica`"));
    }
    let mut warnings = Vec::new();
    let lights: Vec<Option<f32>> = match photo {
        Some(photo) => crowns.par_iter().map(|c| photo.luminance(&c.outline)).collect(),
        None => vec![None; crowns.len()],
    };
    let ranges: Vec<(usize, [f32; 2])> =
        species.iter().enumerate().filter_map(|(i, s)| Some((i, s.luminance?))).collect();
    let lit: Vec<f32> = lights.iter().copied().flatten().collect();
    if photo.is_some() {
        if ranges.is_empty() {
            warnings.push(
                "The photo is not used for the species: none of them states a range `luminance`."
                    .into(),
            );
        }
        let dark = lights.len() - lit.len();
        if dark > 0 {
            warnings.push(format!(
                "The photo shows nothing of {dark} of {} crowns; their species come from their shape.",
                lights.len()
            ));
        }
    }
    let gain = exposure(&lit, &ranges);
    if gain != 1.0 {
        warnings.push(format!(
            "The photo's exposure does not fit the luminance ranges of the species; its luminance \
             was multiplied by {gain:.2}."
        ));
    }
    let drawn = if is_requested { How::Requested } else { How::DefaultMix };
    let assignments = crowns
        .iter()
        .zip(&lights)
        .map(|(crown, &light)| {
            match light.and_then(|y| nearest(crown, y * gain, &ranges, species)) {
                Some((species, distance)) => {
                    Assignment { species, luminance: light, distance, how: How::Photo }
                }
                None => Assignment {
                    species: by_shape(crown, species, seed),
                    luminance: light,
                    distance: 0.0,
                    how: drawn,
                },
            }
        })
        .collect();
    Ok(Warned::with(assignments, warnings))
}

fn distance(y: f32, [low, high]: [f32; 2]) -> f32 {
    (low - y).max(y - high).max(0.0)
}

/// The gain that brings the crowns' luminances to the ranges; 1 where they are near as they are.
fn exposure(lit: &[f32], ranges: &[(usize, [f32; 2])]) -> f32 {
    if lit.is_empty() || ranges.is_empty() {
        return 1.0;
    }
    let off = |y: f32| ranges.iter().map(|(_, r)| distance(y, *r)).fold(f32::INFINITY, f32::min);
    let mut distances: Vec<f32> = lit.iter().map(|y| off(*y)).collect();
    distances.sort_by(f32::total_cmp);
    if distances.get(distances.len() / 2).is_none_or(|median| *median <= FAR) {
        return 1.0;
    }
    // From a third to three times the exposure, in steps of 1 %; one far crown counts no more
    // than another.
    let steps = (3.0f32.ln() / 0.01) as i32;
    let cost = |step: i32| {
        let log_gain = step as f32 * 0.01;
        let total: f32 = lit.iter().map(|y| off(y * log_gain.exp()).min(2.0 * FAR)).sum();
        total / lit.len() as f32 + GAIN_COST * log_gain.abs()
    };
    let best = (-steps..=steps).map(|s| (cost(s), s)).min_by(|a, b| {
        // The lesser change where two are as good.
        a.0.total_cmp(&b.0).then(a.1.abs().cmp(&b.1.abs()))
    });
    best.map_or(1.0, |(_, step)| (step as f32 * 0.01).exp())
}

/// The species of nearest range, the best shape among ties, with the distance.
fn nearest(
    crown: &Crown,
    y: f32,
    ranges: &[(usize, [f32; 2])],
    species: &[Species],
) -> Option<(usize, f32)> {
    // A shrub does not grow into a tree, whatever its colour.
    let fits = |s: &Species| s.kind != Kind::Shrub || crown.height_m <= 1.8 * s.size.height_m;
    let known: Vec<(f32, usize, &Species)> = ranges
        .iter()
        .filter_map(|(i, range)| Some((distance(y, *range), *i, species.get(*i)?)))
        .collect();
    let allowed: Vec<_> = known.iter().filter(|(_, _, s)| fits(s)).collect();
    let pool = if allowed.is_empty() { known.iter().collect() } else { allowed };
    let least = pool.iter().map(|(d, _, _)| *d).fold(f32::INFINITY, f32::min);
    pool.into_iter()
        .filter(|(d, _, _)| *d <= least + TIE)
        .min_by(|a, b| misfit(crown, a.2).total_cmp(&misfit(crown, b.2)).then(a.1.cmp(&b.1)))
        .map(|(d, i, _)| (*i, *d))
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

/// A species drawn in proportion to exp(−4 misfit), by the tree's key.
fn by_shape(crown: &Crown, species: &[Species], seed: Seed) -> usize {
    let misfits: Vec<f32> = species.iter().map(|s| misfit(crown, s)).collect();
    let least = misfits.iter().copied().fold(f32::INFINITY, f32::min);
    let weights: Vec<f32> = misfits.iter().map(|m| (-4.0 * (m - least)).exp()).collect();
    let mut left = seed.derive("species", crown.key).draws().unit() * weights.iter().sum::<f32>();
    for (i, weight) in weights.iter().enumerate() {
        if left < *weight {
            return i;
        }
        left -= weight;
    }
    misfits.iter().position(|m| *m == least).unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::species;

    fn raster(samples: Samples, side: usize, bands: usize) -> Raster {
        let geometry = GridGeometry {
            west: 500_000.0,
            north: 6_000_000.0 + side as f64,
            cell_x: 1.0,
            cell_y: 1.0,
            cols: side,
            rows: side,
        };
        let geometry = Some(geometry);
        Raster { width: side, height: side, bands, samples, geometry, epsg: None, nodata: None }
    }

    fn frame() -> Frame {
        Frame::local(DVec3::new(500_000.0, 6_000_000.0, 100.0))
    }

    fn place(raster: Raster) -> Result<Photo> {
        Photo::new("photo.tif", raster, &frame(), Vec2::ZERO, Vec2::splat(10.0))
    }

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
        let side = greys.len() * 4;
        let value = |i: usize| greys[(i / 3) % side / 4];
        let samples = Samples::F32((0..side * side * 3).map(value).collect());
        place(raster(samples, side, 3)).unwrap()
    }

    #[test]
    fn numbers_of_every_kind_become_0_to_255() {
        let middle = |samples, bands| {
            let photo = place(raster(samples, 10, bands)).unwrap();
            photo.sample(Vec2::new(5.5, 5.5)).unwrap()
        };
        let float = |full: f32, bands: usize| {
            let mut v = vec![full * 0.5; 100 * bands];
            v[..10].fill(full);
            Samples::F32(v)
        };
        for full in [1.0, 255.0, 4095.0, 65535.0] {
            for bands in [1, 3, 4] {
                let rgb = middle(float(full, bands), bands);
                assert!(rgb.iter().all(|v| (v - 127.5).abs() < 0.2), "{full} {bands}: {rgb:?}");
            }
        }
        assert_eq!(middle(Samples::U8(vec![51; 300]), 3), [51.0; 3]);
        let mut deep = vec![2048u16; 300];
        deep[..9].fill(4095);
        assert!((middle(Samples::U16(deep), 3)[0] - 127.5).abs() < 0.1);
        // One hot pixel changes nothing.
        let mut hot = vec![0.5f32; 30_000];
        hot[7] = 9e9;
        let photo = place(raster(Samples::F32(hot), 100, 3)).unwrap();
        assert!((photo.sample(Vec2::splat(50.0)).unwrap()[0] - 127.5).abs() < 0.1);
    }

    #[test]
    fn pixels_lie_where_the_world_says() {
        let mut v = vec![9u8; 300];
        // Third column, second row from the north.
        v[(10 + 2) * 3..(10 + 3) * 3].copy_from_slice(&[10, 20, 30]);
        let photo = place(raster(Samples::U8(v), 10, 3)).unwrap();
        assert_eq!(photo.sample(Vec2::new(2.5, 8.5)), Some([10.0, 20.0, 30.0]));
        assert_eq!(photo.sample(Vec2::new(2.5, 7.5)), Some([9.0; 3]));
        assert_eq!(photo.sample(Vec2::new(-0.5, 5.0)), None);
        assert_eq!(photo.sample(Vec2::new(f32::NAN, 5.0)), None);
    }

    #[test]
    fn nodata_is_nothing() {
        let mut r = raster(Samples::F32(vec![-9999.0; 300]), 10, 3);
        r.nodata = Some(-9999.0);
        let photo = place(r).unwrap();
        assert_eq!(photo.sample(Vec2::splat(5.0)), None);
        assert_eq!(photo.luminance(&crown(1, 5.0, 10.0, 4.0).outline), None);
    }

    #[test]
    fn a_photo_without_a_place_or_elsewhere_is_refused() {
        let mut r = raster(Samples::U8(vec![9; 300]), 10, 3);
        r.geometry = None;
        insta::assert_snapshot!(format!("{:?}", place(r).unwrap_err()), @"photo.tif: the photo has no georeference (remedy: give a GeoTIFF, or put a world file (.tfw) beside the photo)");
        let mut r = raster(Samples::U8(vec![9; 300]), 10, 3);
        r.epsg = Some(32617);
        if let Some(g) = &mut r.geometry {
            g.west += 5000.0;
        }
        insta::assert_snapshot!(format!("{:?}", place(r).unwrap_err()), @"photo.tif: the photo lies elsewhere than the scan: photo x 505000 to 505010, y 6000000 to 6000010 (EPSG 32617); scan x 500000 to 500010, y 6000000 to 6000010 (remedy: give a photo of the scanned place, in the scan's coordinate system)");
        assert!(place(raster(Samples::U8(vec![]), 10, 3)).is_err());
    }

    #[test]
    fn luminance_gives_the_class_of_table_1() {
        let species = all(&["larix_sibirica", "betula_pendula", "picea_obovata", "salix_caprea"]);
        let photo = stripes(&[169.0, 189.0, 78.0, 120.0, 100.0]);
        let crowns: Vec<Crown> = (0..5).map(|i| crown(i, i as f32 * 4.0 + 2.0, 6.0, 2.0)).collect();
        let found = assign(&crowns, Some(&photo), &species, false, Seed::new(1)).unwrap();
        let chosen: Vec<(usize, f32)> =
            found.value.iter().map(|a| (a.species, a.distance)).collect();
        // The last is in no range: 15 from the shrubs, 15 from the conifers; shape decides.
        assert_eq!(chosen[..4], [(0, 0.0), (1, 0.0), (2, 0.0), (3, 0.0)]);
        assert_eq!(chosen[4].1, 15.0);
        assert!(found.value.iter().all(|a| a.how == How::Photo));
        assert!(found.warnings.is_empty(), "{:?}", found.warnings);
    }

    #[test]
    fn shape_decides_between_overlapping_ranges() {
        let species = all(&["betula_pendula", "quercus_robur"]);
        let photo = stripes(&[185.5; 8]);
        let crowns = [crown(1, 6.0, 20.0, 4.0), crown(2, 16.0, 12.0, 11.0)];
        let found = assign(&crowns, Some(&photo), &species, false, Seed::new(1)).unwrap().value;
        assert_eq!(found[0].species, 0, "tall and narrow: birch");
        assert_eq!(found[1].species, 1, "low and broad: oak");
    }

    #[test]
    fn a_tall_tree_is_no_shrub() {
        let species = all(&["picea_obovata", "salix_caprea"]);
        let photo = stripes(&[120.0; 4]);
        let found =
            assign(&[crown(1, 6.0, 28.0, 4.0)], Some(&photo), &species, false, Seed::new(1));
        assert_eq!(found.unwrap().value[0].species, 0);
    }

    #[test]
    fn exposure_is_found_and_said() {
        let species = all(&["larix_sibirica", "betula_pendula", "picea_obovata"]);
        let truth = [169.0, 189.0, 78.0, 188.0, 168.0, 79.0, 186.0, 170.0];
        let photo = stripes(&truth.map(|y| y * 0.75));
        let crowns: Vec<Crown> =
            (0..8).map(|i| crown(i, i as f32 * 4.0 + 2.0, 10.0, 2.0)).collect();
        let found = assign(&crowns, Some(&photo), &species, false, Seed::new(1)).unwrap();
        let chosen: Vec<usize> = found.value.iter().map(|a| a.species).collect();
        assert_eq!(chosen, [0, 1, 2, 1, 0, 2, 1, 0]);
        assert_eq!(found.warnings.len(), 1);
        assert!(found.warnings[0].contains("multiplied by 1.3"), "{}", found.warnings[0]);
    }

    #[test]
    fn without_a_photo_a_tree_keeps_its_species() {
        let species = all(&DEFAULT_MIX);
        let crowns: Vec<Crown> = (0..400).map(|i| crown(i, 0.0, 18.0, 5.0)).collect();
        let found = assign(&crowns, None, &species, false, Seed::new(1)).unwrap().value;
        assert!(found.iter().all(|a| a.how == How::DefaultMix && a.luminance.is_none()));
        for (s, wanted) in species.iter().enumerate() {
            assert!(found.iter().any(|a| a.species == s), "no {}", wanted.id);
        }
        let fewer = assign(&crowns[200..], None, &species, true, Seed::new(1)).unwrap().value;
        for (a, b) in found[200..].iter().zip(&fewer) {
            assert_eq!((a.species, b.how), (b.species, How::Requested));
        }
        assert!(assign(&crowns, None, &[], false, Seed::new(1)).is_err());
    }
}
