//! How wide voxels must be for the vegetation of a scan to hang together in them.
//!
//! Of n voxels in a string each touches two others at its sides, in a closed surface four. Where pulses
//! are further apart than voxels are wide, fewer do: crowns fall apart into shards.

use glam::{IVec3, Vec3};
use rayon::prelude::*;

use crate::ground::{Classified, Kind};
use crate::seed::Seed;
use crate::terrain::Terrain;

/// Voxels beside a voxel, on the mean.
const BESIDE: f64 = 2.0;
/// Steps of an edge, as shares of the least, and how many there are at most: three times as wide.
const STEP: f32 = 0.25;
const STEPS: u16 = 8;
/// What is lower over the terrain is no crown.
const LOW_M: f32 = 2.0;
/// Points that are looked at, at most, in whole plots of this side.
const ENOUGH: usize = 300_000;
const PLOT_M: f32 = 32.0;

/// The least edge, from `least_m` on in steps of a quarter of it and up to three times as wide, of
/// voxels that touch two others on the mean. `least_m` where nothing stands over the terrain.
pub fn connected_voxel_m(classified: &Classified, terrain: &Terrain, least_m: f32) -> f32 {
    let points = &classified.cloud.position;
    let is_tall = |i: &usize| {
        let p = points[*i];
        let ground = || terrain.heights.bilinear(f64::from(p.x), f64::from(p.y));
        classified.kind[*i] != Kind::Ground && p.z > ground() + LOW_M
    };
    let tall: Vec<Vec3> =
        (0..points.len()).into_par_iter().filter(is_tall).map(|i| points[i]).collect();
    least_connected(&sample(tall), least_m)
}

fn least_connected(points: &[Vec3], least_m: f32) -> f32 {
    let edge = |step: u16| least_m * (1.0 + STEP * f32::from(step));
    let is_wide = |edge: &f32| beside(points, *edge).is_none_or(|mean| mean >= BESIDE);
    (0..STEPS).map(edge).find(is_wide).unwrap_or(edge(STEPS))
}

/// All points, or those of plots drawn by lot.
fn sample(points: Vec<Vec3>) -> Vec<Vec3> {
    if points.len() <= ENOUGH {
        return points;
    }
    let lots = Seed::new(1).stage("plots");
    let lot = |p: &Vec3| {
        let [i, j] = [p.x, p.y].map(|v| (v / PLOT_M).floor() as i32 as u32);
        lots.seed(u64::from(i) << 32 | u64::from(j)).draws().bits()
    };
    let mut drawn: Vec<(u64, Vec3)> = points.into_par_iter().map(|p| (lot(&p), p)).collect();
    drawn.par_sort_by_key(|(lot, _)| *lot);
    let last = drawn[ENOUGH].0;
    drawn.into_iter().take_while(|(lot, _)| *lot <= last).map(|(_, p)| p).collect()
}

/// How many of the voxels at its sides are occupied too, on the mean of the voxels with points.
fn beside(points: &[Vec3], edge_m: f32) -> Option<f64> {
    let key = |p: IVec3| {
        // 21 bits an axis, with room on either side.
        let [x, y, z] = p.to_array().map(|v| (i64::from(v) + (1 << 20)) as u64 & 0x1f_ffff);
        x << 42 | y << 21 | z
    };
    let mut keys: Vec<u64> =
        points.par_iter().map(|p| key((*p / edge_m).floor().as_ivec3())).collect();
    keys.par_sort_unstable();
    keys.dedup();
    let touches = |step: u64| {
        keys.par_iter().filter(|key| keys.binary_search(&(*key + step)).is_ok()).count()
    };
    let pairs: usize = [1, 1 << 21, 1 << 42].map(touches).iter().sum();
    (!keys.is_empty()).then(|| 2.0 * pairs as f64 / keys.len() as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Points drawn evenly in a box.
    fn cloud(count: u64, side_m: f32) -> Vec<Vec3> {
        let stage = Seed::new(7).stage("points");
        let point = |i: u64| {
            let mut draws = stage.seed(i).draws();
            Vec3::from([(); 3].map(|()| draws.between(-0.5 * side_m, 0.5 * side_m)))
        };
        (0..count).map(point).collect()
    }

    #[test]
    fn strings_surfaces_and_boxes_have_the_neighbours_they_have() {
        let lattice = |sides: [i32; 3]| -> Vec<Vec3> {
            let at = |x, y, z| IVec3::new(x, y, z).as_vec3() + 0.5;
            let row = |z, y| (0..sides[0]).map(move |x| at(x, y, z));
            (0..sides[2]).flat_map(|z| (0..sides[1]).flat_map(move |y| row(z, y))).collect()
        };
        assert_eq!(beside(&[], 1.0), None);
        assert_eq!(beside(&lattice([1, 1, 1]), 1.0), Some(0.0));
        assert_eq!(beside(&lattice([10, 1, 1]), 1.0), Some(1.8));
        assert_eq!(beside(&lattice([10, 10, 1]), 1.0), Some(3.6));
        assert_eq!(beside(&lattice([10, 10, 10]), 1.0), Some(5.4));
    }

    #[test]
    fn voxels_are_as_wide_as_thin_scans_need() {
        // Of m points a voxel drawn evenly 1 − exp(−m) are occupied: two of six from m = 0.405 on.
        for (count, least) in [(100_000, 1.0f32), (4_000, 1.0), (1_000, 1.0), (20, 1.0)] {
            let edge = least_connected(&cloud(count, 20.0), least);
            let wanted = (0.405f32 * 8000.0 / count as f32).cbrt();
            let step = ((wanted.max(least) / least - 1.0) / STEP).ceil().min(f32::from(STEPS));
            // Those at the sides of the box have fewer.
            let steps = (edge / least - 1.0) / STEP;
            assert!((step..=step + 1.0).contains(&steps), "{count} points: {edge}");
            assert!(steps <= f32::from(STEPS));
        }
        assert_eq!(least_connected(&[], 0.4), 0.4);
    }

    #[test]
    fn of_many_points_whole_plots_are_looked_at() {
        let all = cloud(3 * ENOUGH as u64, 200.0);
        let few = sample(all.clone());
        assert!((ENOUGH..2 * ENOUGH).contains(&few.len()), "{}", few.len());
        let plot = |p: &Vec3| (*p / PLOT_M).floor().truncate().as_ivec2();
        let kept = |of: &[Vec3], at| of.iter().filter(|p| plot(p) == at).count();
        let at = plot(&few[0]);
        assert_eq!(kept(&few, at), kept(&all, at));
    }
}
