//! The photo on the terrain. A crown in the photo would lie painted on the ground beside the tree
//! that stands there, so what the crowns hide is filled from the ground seen around them, with the
//! grain of a forest floor. Where next to no ground is seen, under a closed canopy, the photo stays
//! as it is.

use glam::Vec2;
use rayon::prelude::*;

use crate::raster::polygon::contains;
use crate::raster::{Grid, GridGeometry, Picture, inpaint};
use crate::seed::Seed;
use crate::species::photo::Photo;
use crate::terrain::Terrain;
use crate::texture;
use crate::work::{self, Work};

/// Most pixels along a side.
const MOST_PX: u32 = 2048;
/// A crown is wider in the photo than its outline by about this much: its rim, and the lean of
/// the photo.
const RIM_M: f32 = 0.8;
/// Less of the ground than this seen is too little to go on.
const LEAST_SEEN: f32 = 0.05;
/// Side of the tile whose grain is taken, metres and pixels.
const GRAIN_M: f32 = 4.0;
const GRAIN_PX: u32 = 64;

/// The photo over the terrain's extent, going on smoothly where it does not reach; `None` where the
/// two do not meet. `outlines` are those of the crowns, local metres.
pub fn drape(
    photo: &Photo,
    terrain: &Terrain,
    outlines: &[&[Vec2]],
    seed: Seed,
) -> Option<Picture> {
    let g = &terrain.heights.geometry;
    let (width_m, height_m) = (g.east() - g.west, g.north - g.south());
    let pixel_m = f64::from(photo.pixel_m()).max(width_m.max(height_m) / f64::from(MOST_PX));
    let pixels = |m: f64| (m / pixel_m).round().clamp(1.0, f64::from(MOST_PX)) as usize;
    let (cols, rows) = (pixels(width_m), pixels(height_m));
    let geometry = GridGeometry {
        cell_x: width_m / cols as f64,
        cell_y: height_m / rows as f64,
        cols,
        rows,
        ..*g
    };
    work::count(Work::PhotoSamples, geometry.len());
    let place = |i: usize| {
        let [x, y] = geometry.centre(i % cols, i / cols);
        Vec2::new(x as f32, y as f32)
    };
    let seen: Vec<Option<[f32; 3]>> =
        (0..geometry.len()).into_par_iter().map(|i| photo.sample(place(i))).collect();
    let in_photo: Vec<bool> = seen.iter().map(Option::is_some).collect();
    if !in_photo.contains(&true) {
        return None;
    }
    let is_crown = under_crowns(&geometry, outlines);
    let is_ground: Vec<bool> = in_photo.iter().zip(&is_crown).map(|(&p, &c)| p && !c).collect();
    let share = is_ground.iter().filter(|&&k| k).count() as f32 / geometry.len() as f32;
    let is_cleared = share >= LEAST_SEEN;
    let is_known = if is_cleared { &is_ground } else { &in_photo };
    let bands = [0, 1, 2].map(|k| {
        let data = seen.iter().map(|c| c.map_or(0.0, |c| c[k])).collect();
        let mut band = Grid { geometry, data };
        inpaint::fill(&mut band, is_known);
        band.data
    });
    let grain = grain(seed);
    let data = (0..geometry.len())
        .map(|i| {
            let factor = if is_known[i] { 1.0 } else { grain(place(i)) };
            let byte = |k: usize| (bands[k][i] * factor).round().clamp(0.0, 255.0) as u8;
            [byte(0), byte(1), byte(2), 255]
        })
        .collect();
    Some(Picture { width: cols as u32, height: rows as u32, data })
}

/// Which cells lie inside an outline widened by the rim.
fn under_crowns(geometry: &GridGeometry, outlines: &[&[Vec2]]) -> Vec<bool> {
    let mut is_under = vec![false; geometry.len()];
    for outline in outlines.iter().filter(|o| o.len() >= 3) {
        let middle = outline.iter().sum::<Vec2>() / outline.len() as f32;
        let wide: Vec<Vec2> =
            outline.iter().map(|&p| p + (p - middle).normalize_or_zero() * RIM_M).collect();
        let (low, high) = wide.iter().fold((wide[0], wide[0]), |(a, b), p| (a.min(*p), b.max(*p)));
        let index = |v: f64, count: usize| v.clamp(0.0, count as f64) as usize;
        let cols = index((f64::from(low.x) - geometry.west) / geometry.cell_x, geometry.cols)
            ..index((f64::from(high.x) - geometry.west) / geometry.cell_x + 1.0, geometry.cols);
        let rows = index((geometry.north - f64::from(high.y)) / geometry.cell_y, geometry.rows)
            ..index((geometry.north - f64::from(low.y)) / geometry.cell_y + 1.0, geometry.rows);
        for row in rows {
            for col in cols.clone() {
                let [x, y] = geometry.centre(col, row);
                if contains(&wide, Vec2::new(x as f32, y as f32)) {
                    is_under[geometry.index(col, row)] = true;
                }
            }
        }
    }
    is_under
}

/// Brightness of a forest floor at a place, 1 on average.
fn grain(seed: Seed) -> impl Fn(Vec2) -> f32 {
    let tile = texture::ground(GRAIN_PX, seed);
    let light: Vec<f32> =
        tile.data.iter().map(|p| p[..3].iter().map(|&c| f32::from(c)).sum()).collect();
    let mean = (light.iter().sum::<f32>() / light.len().max(1) as f32).max(1.0);
    move |p| {
        let at = |v: f32| {
            ((v / GRAIN_M).rem_euclid(1.0) * tile.width as f32).min(tile.width as f32 - 1.0) as u32
        };
        light[(at(p.y) * tile.width + at(p.x)) as usize] / mean
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::Frame;
    use crate::raster::geotiff::{Raster, Samples};
    use glam::DVec3;

    fn scene(photo: impl Fn(usize, usize) -> [u8; 3]) -> (Photo, Terrain) {
        let geometry =
            GridGeometry { west: 0.0, north: 20.0, cell_x: 0.5, cell_y: 0.5, cols: 40, rows: 40 };
        let samples = (0..1600).flat_map(|i| photo(i % 40, i / 40)).collect();
        let raster = Raster {
            width: 40,
            height: 40,
            bands: 3,
            samples: Samples::U8(samples),
            geometry: Some(geometry),
            epsg: None,
            nodata: None,
        };
        let frame = Frame::local(DVec3::ZERO);
        let photo = Photo::new("p", raster, &frame, Vec2::ZERO, Vec2::splat(20.0)).unwrap().value;
        let terrain =
            Terrain { heights: Grid::filled(geometry, 0.0), is_observed: vec![true; 1600] };
        (photo, terrain)
    }

    #[test]
    fn crowns_are_cleared_and_the_ground_around_them_stays() {
        // A bright crown of 3 m radius at (10, 10) on even ground.
        let (photo, terrain) = scene(|c, r| {
            let d = (c as f32 * 0.5 + 0.25 - 10.0).hypot(19.75 - r as f32 * 0.5 - 10.0);
            if d < 3.0 { [20, 250, 20] } else { [110, 100, 80] }
        });
        let outline: Vec<Vec2> = (0..24)
            .map(|k| {
                Vec2::splat(10.0) + 2.8 * Vec2::from_angle(k as f32 / 24.0 * std::f32::consts::TAU)
            })
            .collect();
        let draped = drape(&photo, &terrain, &[&outline], Seed::new(1)).unwrap();
        assert!(draped.data.iter().all(|p| p[1] < 200), "a crown is still painted");
        assert_eq!(draped.at(2, 2), [110, 100, 80, 255]);
        let middle = draped.at(20, 20);
        assert!((60..170).contains(&middle[0]) && middle[0] > middle[2], "{middle:?}");
        let as_is = drape(&photo, &terrain, &[], Seed::new(1)).unwrap();
        assert_eq!(as_is.at(20, 20), [20, 250, 20, 255]);
    }

    #[test]
    fn a_closed_canopy_keeps_its_photo() {
        let (photo, terrain) = scene(|_, _| [30, 90, 30]);
        let all = [[-1.0, -1.0], [21.0, -1.0], [21.0, 21.0], [-1.0, 21.0]].map(Vec2::from);
        let draped = drape(&photo, &terrain, &[&all], Seed::new(1)).unwrap();
        assert!(draped.data.iter().all(|p| *p == [30, 90, 30, 255]));
    }
}
