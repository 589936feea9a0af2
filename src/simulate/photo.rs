//! An orthophoto of the stand: crowns seen from above, lit by the sun, on a forest floor.
//!
//! The luminance Y = 0.299 R + 0.587 G + 0.114 B of a crown's sunlit pixels has its mean in the
//! middle of its species' range ([T15], Table 1), up to a spread from tree to tree; light and
//! shade inside the crown vary around it.

use glam::{Vec2, Vec3};
use rayon::prelude::*;

use super::crown::Grove;
use super::stand::Stand;
use crate::raster::GridGeometry;
use crate::raster::geotiff::{Raster, Samples};
use crate::seed::Seed;

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PhotoOptions {
    /// Ground width of a pixel.
    pub pixel_m: f32,
    /// Towards the sun.
    pub sun: Vec3,
}

impl Default for PhotoOptions {
    fn default() -> Self {
        PhotoOptions { pixel_m: 0.2, sun: Vec3::new(0.30, -0.45, 0.95) }
    }
}

const NO_TREE: u32 = u32::MAX;

/// Height and tree of the topmost surface at a pixel.
#[derive(Clone, Copy)]
struct Top {
    z: f32,
    tree: u32,
}

/// Takes the photo; world coordinates, three bands of 8 bits.
pub fn photo(stand: &Stand, options: &PhotoOptions) -> Raster {
    let pixel = options.pixel_m.clamp(0.02, stand.side_m);
    let size = (stand.side_m / pixel).ceil().max(1.0) as usize;
    let grove = Grove::new(&stand.shapes, stand.side_m);
    let place = |col: usize, row: usize| {
        Vec2::new((col as f32 + 0.5) * pixel, stand.side_m - (row as f32 + 0.5) * pixel)
    };
    let tops: Vec<Top> = (0..size * size)
        .into_par_iter()
        .map(|i| {
            let p = place(i % size, i / size);
            let ground = stand.relief.height_at(f64::from(p.x), f64::from(p.y)) as f32;
            let on_ground = Top { z: ground, tree: NO_TREE };
            grove.over(p).fold(on_ground, |top, (tree, shape)| match shape.surface_at(p) {
                Some(z) if z > top.z => Top { z, tree },
                _ => top,
            })
        })
        .collect();
    let at = |col: i64, row: i64| {
        let last = size as i64 - 1;
        tops[row.clamp(0, last) as usize * size + col.clamp(0, last) as usize]
    };
    let sun = options.sun.normalize_or(Vec3::Z);
    let light: Vec<Light> = (0..size * size)
        .into_par_iter()
        .map(|i| {
            let (col, row) = ((i % size) as i64, (i / size) as i64);
            let top = at(col, row);
            // Slopes within one crown, kept gentle: leaves scatter light.
            let slope = |a: Top, b: Top| {
                let z = |t: Top| if t.tree == top.tree { t.z } else { top.z };
                let run = f32::from((a.tree == top.tree) as u8 + (b.tree == top.tree) as u8);
                ((z(b) - z(a)) / (run.max(1.0) * pixel)).clamp(-2.5, 2.5)
            };
            let dx = slope(at(col - 1, row), at(col + 1, row));
            let dy = slope(at(col, row + 1), at(col, row - 1));
            let lambert = Vec3::new(-dx, -dy, 1.0).normalize().dot(sun).max(0.0);
            Light { lambert, is_sunlit: is_sunlit(&at, col, row, sun, pixel) }
        })
        .collect();
    let crowns = crown_light(stand, &tops, &light);
    let seed = stand.seed.derive("photo", 0);
    let data: Vec<u8> = (0..size * size)
        .into_par_iter()
        .flat_map_iter(|i| {
            let p = place(i % size, i / size);
            let grain = 0.5 * noise(seed, p, 0.25) + 0.5 * noise(seed, p, 0.7);
            let shade = if light[i].is_sunlit { [1.0; 3] } else { [0.46, 0.49, 0.56] };
            let rgb = match crowns.get(tops[i].tree as usize) {
                Some(crown) => {
                    let relative = light[i].lambert / crown.mean_lambert.max(1e-3);
                    let y = crown.luminance * (1.0 + 0.30 * (relative - 1.0) + 0.2 * (grain - 0.5));
                    coloured(y.clamp(0.0, 250.0), crown.leaf)
                }
                None => floor(seed, p, grain, light[i].lambert),
            };
            std::array::from_fn::<u8, 3, _>(|k| (rgb[k] * shade[k]).round().clamp(0.0, 255.0) as u8)
        })
        .collect();
    let north = stand.frame.origin.y + f64::from(stand.side_m);
    Raster {
        width: size,
        height: size,
        bands: 3,
        samples: Samples::U8(data),
        geometry: Some(GridGeometry {
            west: stand.frame.origin.x,
            north,
            cell_x: f64::from(pixel),
            cell_y: f64::from(pixel),
            cols: size,
            rows: size,
        }),
        epsg: stand.frame.crs.as_ref().and_then(|c| c.epsg),
        nodata: None,
    }
}

#[derive(Clone, Copy)]
struct Light {
    lambert: f32,
    is_sunlit: bool,
}

/// Follows the line to the sun over the surfaces. The far side of a crown is not in its own
/// shadow: leaves pass light on, and its slope darkens it already.
fn is_sunlit(at: &impl Fn(i64, i64) -> Top, col: i64, row: i64, sun: Vec3, pixel: f32) -> bool {
    let here = at(col, row);
    let along = sun.truncate();
    let length = along.length();
    if length < 1e-3 {
        return true;
    }
    let rise = sun.z / length;
    let step = (2.0 * pixel).max(0.3);
    let toward = along / length;
    (2..=160).all(|i| {
        let d = i as f32 * step;
        let shift = toward * (d / pixel);
        let there = at(col + shift.x.round() as i64, row - shift.y.round() as i64);
        let is_own = there.tree == here.tree && here.tree != NO_TREE;
        is_own || there.z <= here.z + d * rise + 0.3
    })
}

/// How one crown is lit, and how bright and of what colour it is.
struct CrownLight {
    mean_lambert: f32,
    luminance: f32,
    leaf: [u8; 3],
}

fn crown_light(stand: &Stand, tops: &[Top], light: &[Light]) -> Vec<CrownLight> {
    let mut sums = vec![(0.0f64, 0u32); stand.trees.len()];
    for (top, light) in tops.iter().zip(light) {
        if let Some(sum) = sums.get_mut(top.tree as usize)
            && light.is_sunlit
            && light.lambert > 0.3
        {
            sum.0 += f64::from(light.lambert);
            sum.1 += 1;
        }
    }
    sums.iter()
        .zip(&stand.looks)
        .zip(&stand.trees)
        .map(|((&(sum, count), look), tree)| {
            let key = stand.frame.key(tree.position);
            let mut draws = stand.seed.derive("tone", key).draws();
            let [low, high] = look.luminance.unwrap_or_else(|| {
                let y = luminance(look.leaf.map(f32::from));
                [y * 0.95, y * 1.05]
            });
            // Spread inside the range, and now and then a little beyond it.
            let y = 0.5 * (low + high) + 0.28 * (high - low) * draws.normal().clamp(-2.5, 2.5);
            let mean_lambert = if count > 0 { (sum / f64::from(count)) as f32 } else { 1.0 };
            CrownLight { mean_lambert, luminance: y, leaf: look.leaf }
        })
        .collect()
}

/// Y of [T15].
fn luminance(rgb: [f32; 3]) -> f32 {
    0.299 * rgb[0] + 0.587 * rgb[1] + 0.114 * rgb[2]
}

/// The leaf's hue at a luminance, paler where a channel would pass 250.
fn coloured(y: f32, leaf: [u8; 3]) -> [f32; 3] {
    let leaf = leaf.map(f32::from);
    let own = luminance(leaf).max(1.0);
    let over = leaf.iter().map(|c| c / own - 1.0).fold(1e-6f32, f32::max);
    let saturation = ((250.0 / y.max(1.0) - 1.0) / over).clamp(0.0, 1.0);
    leaf.map(|c| y * (1.0 + saturation * (c / own - 1.0)))
}

/// Moss, dry grass and bare soil in patches.
fn floor(seed: Seed, p: Vec2, grain: f32, lambert: f32) -> [f32; 3] {
    const MOSS: Vec3 = Vec3::new(104.0, 112.0, 62.0);
    const GRASS: Vec3 = Vec3::new(150.0, 146.0, 96.0);
    const SOIL: Vec3 = Vec3::new(128.0, 110.0, 86.0);
    let seed = seed.derive("floor", 0);
    let a = noise(seed, p, 5.0);
    let b = noise(seed, p + 500.0, 2.2);
    let colour = MOSS.lerp(GRASS, a).lerp(SOIL, (b * 1.6 - 0.9).clamp(0.0, 1.0));
    (colour * (0.35 + 0.75 * lambert) * (0.85 + 0.3 * grain)).to_array()
}

/// Smooth noise 0…1 with features of a given size.
fn noise(seed: Seed, p: Vec2, size_m: f32) -> f32 {
    let q = p / size_m;
    let base = q.floor();
    let f = q - base;
    let f = f * f * (Vec2::splat(3.0) - 2.0 * f);
    let value = |dx: f32, dy: f32| {
        let (x, y) = ((base.x + dx) as i32 as u32, (base.y + dy) as i32 as u32);
        seed.derive("", u64::from(x) << 32 | u64::from(y)).draws().unit()
    };
    let low = value(0.0, 0.0) * (1.0 - f.x) + value(1.0, 0.0) * f.x;
    let high = value(0.0, 1.0) * (1.0 - f.x) + value(1.0, 1.0) * f.x;
    low * (1.0 - f.y) + high * f.y
}
