//! A georeferenced photo over the scan, and what it shows of a crown.

use glam::{DVec3, Vec2, Vec3};

use crate::diagnostic::{Error, Result, Warned};
use crate::frame::Frame;
use crate::raster::GridGeometry;
use crate::raster::geotiff::{Raster, Samples};
use crate::raster::polygon::contains;

/// Greatest number of samples along a side of a crown.
const SAMPLES: usize = 32;
/// Coarser photos do not show how uneven a crown is, nor do fewer samples; metres.
const FINE_M: f32 = 0.3;
const LEAST_SAMPLES: usize = 25;

/// What a photo shows of a crown.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Seen {
    /// Mean luminance of the sunlit part, 0…255: of the pixels from the median to the 95th
    /// percentile, so that neither shade nor glare counts.
    pub luminance: f32,
    /// Standard deviation of the luminance over its mean; `None` in coarse photos.
    pub contrast: Option<f32>,
}

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
    /// power of two (or 1, or 10,000, which is reflectance) that holds 99.9 % of them; where that is not the
    /// whole range of their type, a warning says which. A fourth band is ignored. A photo of less than
    /// three bands, or of three that are equal, has no colour; a warning says what follows.
    ///
    /// # Errors
    /// No georeference, no band, or no overlap with the scan.
    pub fn new(
        name: &str,
        raster: Raster,
        frame: &Frame,
        min: Vec2,
        max: Vec2,
    ) -> Result<Warned<Photo>> {
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
            if in_degrees(&geometry) {
                return Err(Error::new(format!(
                    "the photo is in degrees: {:.4} to {:.4} east, {:.4} to {:.4} north",
                    geometry.west,
                    geometry.east(),
                    geometry.south(),
                    geometry.north,
                ))
                .in_file(name)
                .remedy(format!(
                    "bring it into the scan's coordinate system: gdalwarp -t_srs {} {name} warped.tif",
                    scan_epsg.map_or("EPSG:…".into(), |code| format!("EPSG:{code}")),
                )));
            }
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
        let mut warnings = Vec::new();
        if !has_colour(&raster) {
            warnings.push(match raster.bands {
                1 | 2 => format!(
                    "{name}: the photo has no colour ({} of grey): what is painted with it is grey, and \
                     --species-by auto does not go by its luminance, which is that of colours",
                    if raster.bands == 1 { "one band" } else { "two bands" }
                ),
                _ => format!(
                    "{name}: the photo has no colour (its bands are equal): what is painted with it is \
                     grey, and luminance tells species only where grey stands for it"
                ),
            });
        }
        let full = full(&raster);
        let usual: &[f32] = match raster.samples {
            Samples::U8(_) => &[255.0],
            Samples::U16(_) => &[65535.0],
            Samples::F32(_) => &[1.0, 255.0],
        };
        if !usual.contains(&full) {
            warnings.push(format!(
                "{name}: its values, of {}, were taken for 0 to {full:.0}, by the greatest of them; if \
                 they are others, scale them: gdal_translate -ot Byte -scale 0 {full:.0} 0 255 in.tif \
                 out.tif",
                if matches!(raster.samples, Samples::U16(_)) { "16 bits" } else { "floating point" }
            ));
        }
        let photo = Photo { raster, geometry, frame: frame.clone(), scale: 255.0 / full };
        Ok(Warned::with(photo, warnings))
    }

    /// Whether it has bands of red, green and blue.
    pub fn has_colours(&self) -> bool {
        self.raster.bands >= 3
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

    /// What is seen inside a crown's outline; `None` where the photo shows nothing of it.
    pub fn seen(&self, outline: &[Vec2]) -> Option<Seen> {
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
        let mean = |v: &[f32]| v.iter().sum::<f32>() / v.len() as f32;
        let all = mean(&values);
        let is_fine = self.pixel_m() <= FINE_M && values.len() >= LEAST_SAMPLES && all > 0.0;
        let contrast = is_fine.then(|| {
            let squares: f32 = values.iter().map(|v| (v - all).powi(2)).sum();
            (squares / values.len() as f32).sqrt() / all
        });
        (!lit.is_empty()).then(|| Seen { luminance: mean(lit), contrast })
    }
}

fn epsg_text(epsg: Option<u32>) -> String {
    epsg.map_or_else(String::new, |code| format!(" (EPSG {code})"))
}

/// Luminance of a colour, in its own units (T15).
pub fn luminance([r, g, b]: [f32; 3]) -> f32 {
    0.299 * r + 0.587 * g + 0.114 * b
}

/// Some 100,000 pixels tell of all: column and row.
fn sampled(raster: &Raster) -> impl Iterator<Item = (usize, usize)> {
    let pixels = raster.width * raster.height;
    let stride = pixels.div_ceil(100_000).max(1);
    (0..pixels).step_by(stride).map(|i| (i % raster.width, i / raster.width))
}

/// Whether there are three bands that differ somewhere.
fn has_colour(raster: &Raster) -> bool {
    let value = |(col, row), band| raster.value(col, row, band);
    raster.bands >= 3
        && sampled(raster).any(|p| value(p, 0) != value(p, 1) || value(p, 0) != value(p, 2))
}

/// The file's number that is white.
fn full(raster: &Raster) -> f32 {
    let colours = raster.bands.min(3);
    let mut values: Vec<f32> = match &raster.samples {
        Samples::U8(_) => return 255.0,
        _ => sampled(raster)
            .flat_map(|(col, row)| (0..colours).map(move |b| raster.value(col, row, b)))
            .filter(|v| v.is_finite() && raster.nodata.is_none_or(|n| *v != n as f32))
            .collect(),
    };
    values.sort_by(f32::total_cmp);
    let most = values.get(values.len().saturating_sub(1 + values.len() / 1000)).copied();
    let most = most.filter(|most| *most > 0.0).unwrap_or(255.0);
    let is_float = matches!(raster.samples, Samples::F32(_));
    // Depths of cameras, 8, 10, 11, 12, 14 and 16 bits, and the 10,000 by which reflectance is scaled.
    [1.0, 255.0, 1023.0, 2047.0, 4095.0, 10_000.0, 16383.0, 65535.0]
        .into_iter()
        .find(|full| most <= full * 1.001 && (is_float || *full > 1.0))
        .unwrap_or(most)
}

/// Whether a photo's numbers are a small place on the globe rather than metres.
fn in_degrees(g: &GridGeometry) -> bool {
    g.west >= -180.0
        && g.east() <= 180.0
        && g.south() >= -90.0
        && g.north <= 90.0
        && g.cell_x < 1e-3
}

#[cfg(test)]
mod tests {
    use super::*;

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
        Ok(warned(raster)?.value)
    }

    fn warned(raster: Raster) -> Result<Warned<Photo>> {
        Photo::new("photo.tif", raster, &frame(), Vec2::ZERO, Vec2::splat(10.0))
    }

    #[test]
    fn what_is_taken_for_granted_of_a_photo_is_told() {
        let told = |samples, bands| warned(raster(samples, 10, bands)).unwrap().warnings;
        let colours: Vec<u8> = (0..300).map(|i| (i % 251) as u8).collect();
        assert_eq!(told(Samples::U8(colours), 3), [""; 0]);
        let grey = told(Samples::U8(vec![9; 100]), 1);
        insta::assert_snapshot!(grey.join("\n"), @"photo.tif: the photo has no colour (one band of grey): what is painted with it is grey, and --species-by auto does not go by its luminance, which is that of colours");
        let grey = told(Samples::U8(vec![9; 300]), 3);
        insta::assert_snapshot!(grey.join("\n"), @"photo.tif: the photo has no colour (its bands are equal): what is painted with it is grey, and luminance tells species only where grey stands for it");
        let reflectance: Vec<u16> = (0..300).map(|i| 9_000 - i * 20).collect();
        let deep = told(Samples::U16(reflectance), 3);
        insta::assert_snapshot!(deep.join("\n"), @"photo.tif: its values, of 16 bits, were taken for 0 to 10000, by the greatest of them; if they are others, scale them: gdal_translate -ot Byte -scale 0 10000 0 255 in.tif out.tif");
        let whole: Vec<u16> = (0..300).map(|i| 65_000 - i * 20).collect();
        assert_eq!(told(Samples::U16(whole), 3), [""; 0]);
        let shares: Vec<f32> = (0..300).map(|i| i as f32 / 300.0).collect();
        assert_eq!(told(Samples::F32(shares), 3), [""; 0]);
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
        for full in [1.0, 255.0, 2047.0, 4095.0, 65535.0] {
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
        assert_eq!(photo.seen(&[Vec2::ZERO, Vec2::new(9.0, 0.0), Vec2::splat(9.0)]), None);
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
        let mut r = raster(Samples::U8(vec![9; 300]), 10, 3);
        if let Some(g) = &mut r.geometry {
            (g.west, g.north, g.cell_x, g.cell_y) = (-80.5, 37.4, 1e-5, 1e-5);
        }
        insta::assert_snapshot!(format!("{:?}", place(r).unwrap_err()), @"photo.tif: the photo is in degrees: -80.5000 to -80.4999 east, 37.3999 to 37.4000 north (remedy: bring it into the scan's coordinate system: gdalwarp -t_srs EPSG:… photo.tif warped.tif)");
        assert!(place(raster(Samples::U8(vec![]), 10, 3)).is_err());
    }
}
