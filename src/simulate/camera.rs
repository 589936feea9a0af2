//! An orthophoto of the stand: crowns from above with sun, cast shadows and leaf texture. The sunlit
//! part of every crown has the luminance of its species (T15, Table 1) with a spread from tree to
//! tree.

use rayon::prelude::*;

use super::planting::Stand;
use super::scanner::TreeGrid;
use crate::raster::GridGeometry;
use crate::raster::geotiff::{Raster, Samples};
use crate::seed::Seed;

#[derive(Debug, Clone)]
pub struct PhotoOptions {
    pub pixel_m: f64,
    pub sun_elevation_deg: f64,
    pub sun_azimuth_deg: f64,
}

impl Default for PhotoOptions {
    fn default() -> Self {
        PhotoOptions { pixel_m: 0.2, sun_elevation_deg: 50.0, sun_azimuth_deg: 165.0 }
    }
}

const GROUND_LUMINANCE: f32 = 112.0;
const GROUND_COLOUR: [f32; 3] = [121.0, 117.0, 84.0];
/// Light left in a cast shadow.
const SHADE: f32 = 0.42;
/// Relative standard deviation from pixel to pixel.
const GRAIN: f32 = 0.05;

/// What one pixel shows.
#[derive(Clone, Copy)]
struct Seen {
    z: f32,
    /// Index of the tree; `u32::MAX` is ground.
    tree: u32,
}

const GROUND: u32 = u32::MAX;

/// Takes the photo: three bands of 8 bits over the whole stand, georeferenced.
pub fn photo(stand: &Stand, options: &PhotoOptions, seed: Seed) -> Raster {
    let seed = seed.derive("camera", 0);
    let pixel = options.pixel_m.max(0.01);
    let side = (stand.side_m / pixel).ceil().max(1.0) as usize;
    let north = side as f64 * pixel;
    let grid = TreeGrid::new(&stand.shapes, stand.side_m as f32);
    let at =
        |col: usize, row: usize| ((col as f64 + 0.5) * pixel, north - (row as f64 + 0.5) * pixel);
    let seen: Vec<Seen> = (0..side * side)
        .into_par_iter()
        .map(|i| {
            let (x, y) = at(i % side, i / side);
            let ground = Seen { z: stand.relief.height_at(x, y) as f32, tree: GROUND };
            grid.near(x as f32, y as f32)
                .filter_map(|(tree, s)| {
                    s.surface_at(x as f32, y as f32).map(|z| Seen { z, tree: tree as u32 })
                })
                .fold(ground, |best, s| if s.z > best.z { s } else { best })
        })
        .collect();
    let light = light(&seen, side, pixel, options, seed);
    let exposure = exposure(stand, &seen, &light);
    let samples: Vec<u8> = (0..side * side)
        .into_par_iter()
        .flat_map_iter(|i| {
            let (luminance, colour) = match seen[i].tree {
                GROUND => (GROUND_LUMINANCE * light[i], GROUND_COLOUR),
                t => {
                    let look = &stand.looks[stand.trees[t as usize].species];
                    (tree_luminance(stand, t, seed) * light[i] / exposure[t as usize], look.colour)
                }
            };
            let grain = 1.0 + GRAIN * seed.derive("grain", i as u64).draws().normal();
            let scale = luminance * grain / luminance_of(colour).max(1.0);
            colour.map(|c| (c * scale).round().clamp(0.0, 255.0) as u8)
        })
        .collect();
    let geometry = GridGeometry {
        west: stand.frame.origin.x,
        north: stand.frame.origin.y + north,
        cell_x: pixel,
        cell_y: pixel,
        cols: side,
        rows: side,
    };
    Raster {
        width: side,
        height: side,
        bands: 3,
        samples: Samples::U8(samples),
        geometry: Some(geometry),
        epsg: stand.frame.crs.as_ref().and_then(|c| c.epsg),
        nodata: None,
    }
}

fn luminance_of(c: [f32; 3]) -> f32 {
    0.299 * c[0] + 0.587 * c[1] + 0.114 * c[2]
}

fn tree_luminance(stand: &Stand, tree: u32, seed: Seed) -> f32 {
    let look = &stand.looks[stand.trees[tree as usize].species];
    let off = seed.derive("luminance", tree.into()).draws().normal().clamp(-2.0, 2.0);
    look.luminance + 0.45 * look.spread * off
}

/// Relative light of every pixel: sun by the slope of what is seen, softened as leaves do, and the
/// shadows that it casts.
fn light(seen: &[Seen], side: usize, pixel: f64, options: &PhotoOptions, seed: Seed) -> Vec<f32> {
    let (elevation, azimuth) =
        (options.sun_elevation_deg.to_radians(), options.sun_azimuth_deg.to_radians());
    let sun = [azimuth.sin() * elevation.cos(), azimuth.cos() * elevation.cos(), elevation.sin()]
        .map(|v| v as f32);
    let rise_per_m = (elevation.tan()) as f32;
    let top = seen.iter().map(|s| s.z).fold(f32::MIN, f32::max);
    let z = |col: isize, row: isize| {
        let clamp = |v: isize| v.clamp(0, side as isize - 1) as usize;
        seen[clamp(row) * side + clamp(col)].z
    };
    (0..side * side)
        .into_par_iter()
        .map(|i| {
            let (col, row) = ((i % side) as isize, (i / side) as isize);
            // Slopes over a metre, and no steeper than leaves let light see them.
            let reach = (0.5 / pixel).round().max(1.0) as isize;
            let run = 2.0 * reach as f32 * pixel as f32;
            let dx = ((z(col + reach, row) - z(col - reach, row)) / run).clamp(-1.5, 1.5);
            let dy = ((z(col, row - reach) - z(col, row + reach)) / run).clamp(-1.5, 1.5);
            let facing =
                (sun[2] - dx * sun[0] - dy * sun[1]) / (dx * dx + dy * dy + 1.0).sqrt() / sun[2];
            let clump = (i / side / 3 * side + i % side / 3) as u64;
            let texture = 1.0 + 0.07 * seed.derive("clump", clump).draws().normal();
            let lit = (0.55 + 0.45 * facing.clamp(0.0, 1.4)) * texture;
            let step_m = pixel as f32;
            let start = seen[i].z + 0.4;
            let is_shaded = (1..)
                .map(|k| k as f32 * step_m)
                .take_while(|m| start + m * rise_per_m < top)
                .any(|m| {
                    let c = col
                        + (m * options.sun_azimuth_deg.to_radians().sin() as f32 / step_m) as isize;
                    let r = row
                        - (m * options.sun_azimuth_deg.to_radians().cos() as f32 / step_m) as isize;
                    let inside = c >= 0 && r >= 0 && c < side as isize && r < side as isize;
                    inside && z(c, r) > start + m * rise_per_m
                });
            if is_shaded { lit * SHADE } else { lit }
        })
        .collect()
}

/// Mean light of each tree's sunlit pixels (of all, where none is), by which the camera exposes.
fn exposure(stand: &Stand, seen: &[Seen], light: &[f32]) -> Vec<f32> {
    let mut lit = vec![(0.0f64, 0u32); stand.shapes.len()];
    let mut any = lit.clone();
    for (s, &l) in seen.iter().zip(light) {
        if s.tree == GROUND {
            continue;
        }
        let t = s.tree as usize;
        any[t] = (any[t].0 + f64::from(l), any[t].1 + 1);
        if l > 0.55 {
            lit[t] = (lit[t].0 + f64::from(l), lit[t].1 + 1);
        }
    }
    let mean = |(sum, n): (f64, u32)| if n > 0 { (sum / f64::from(n)) as f32 } else { 1.0 };
    lit.iter().zip(any).map(|(&l, a)| if l.1 > 0 { mean(l) } else { mean(a) }).collect()
}

#[cfg(test)]
mod tests {
    use super::super::planting::{StandOptions, stand};
    use super::*;

    #[test]
    fn sunlit_crowns_have_the_luminance_of_their_species() {
        let species = crate::species::load("betula_pendula").unwrap();
        let options = StandOptions { trees: 12, ..StandOptions::default() };
        let stand = stand(std::slice::from_ref(&species), &options, Seed::new(4)).unwrap();
        let photo = photo(&stand, &PhotoOptions::default(), Seed::new(4));
        let g = photo.geometry.unwrap();
        let [low, high] = species.luminance.unwrap();
        for t in &stand.trees {
            let mut values = Vec::new();
            for row in 0..photo.height {
                for col in 0..photo.width {
                    let [x, y] = g.centre(col, row);
                    let (x, y) = (x - stand.frame.origin.x - t.x, y - stand.frame.origin.y - t.y);
                    if x.hypot(y) < 0.3 * f64::from(t.crown_diameter_m) {
                        let c = [0, 1, 2].map(|b| photo.value(col, row, b));
                        values.push(luminance_of(c));
                    }
                }
            }
            values.sort_by(f32::total_cmp);
            let bright = values[values.len() * 6 / 10];
            assert!(bright > low - 25.0 && bright < high + 25.0, "{bright} for {low}…{high}");
        }
        assert_eq!(photo.epsg, Some(32646));
    }
}
