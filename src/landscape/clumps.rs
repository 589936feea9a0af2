//! Voxels in the air. One or two, of a twig, a bird or noise, met by one pulse, hang beside crowns as
//! crumbs. More are a crown below which thin scans have no returns; it would float without a stem. So
//! would the crowns of a closed canopy, which hold on to each other.

use std::cmp::Reverse;
use std::collections::BTreeMap;
use std::ops::Range;

use glam::Vec2;
use rayon::prelude::*;

use super::build::Voxel;

/// Voxels that touch each other are kept from so many on.
const FEWEST: u32 = 3;
/// Metres above the ground up to which all are kept, and how many voxels at least.
const NEAR_GROUND_M: f32 = 1.6;
const NEAR_GROUND: f32 = 2.0;

/// Share of a clump's height above the ground within which something that stands holds it.
const HELD: f32 = 0.15;

/// Metres above the ground from which on a top is a tree's, and shares of its height: within which it
/// is the highest and what stands is its own, and of a gap below it that calls for a stem.
const TALL_M: f32 = 4.0;
const OWN: f32 = 0.1;
const GAP: f32 = 0.15;
const GAP_M: f32 = 2.0;

/// Voxels of vegetation that touch each other, by faces, edges or corners.
pub(super) struct Clumps<'a> {
    column: &'a [Voxel],
    /// Where the voxels of each column begin, and their end.
    start: &'a [u32],
    /// Heights of the ground in voxels.
    height: &'a [f32],
    cols: usize,
    voxel_m: f32,
    /// Voxels above the ground up to which something is near it.
    near_ground: f32,
    /// The first voxel of the clump that a voxel is in; none where it is less than half full.
    of: Vec<Option<u32>>,
    /// By first voxel: how many they are, and whether any is near the ground.
    count: Vec<u32>,
    is_low: Vec<bool>,
}

impl<'a> Clumps<'a> {
    /// Of columns, `cols` in a row, the voxels of this edge that are at least `half` full.
    pub fn new(
        column: &'a [Voxel],
        start: &'a [u32],
        height: &'a [f32],
        cols: usize,
        (half, voxel_m): (u8, f32),
    ) -> Clumps<'a> {
        let near_ground = (NEAR_GROUND_M / voxel_m).max(NEAR_GROUND);
        let mut root: Vec<u32> = (0..column.len() as u32).collect();
        let range = |i: usize| start[i] as usize..start[i + 1] as usize;
        let dense = |i: &usize| column[*i].density >= half;
        for at in 0..height.len() {
            if range(at).is_empty() {
                continue;
            }
            // Of the neighbours those that come later; and the column itself, upward.
            let (x, is_last) = (at % cols, at / cols + 1 >= height.len() / cols);
            let beside = [
                Some(at),
                (x + 1 < cols).then_some(at + 1),
                (x > 0 && !is_last).then(|| at + cols - 1),
                (!is_last).then(|| at + cols),
                (x + 1 < cols && !is_last).then(|| at + cols + 1),
            ];
            for other in beside.into_iter().flatten() {
                let mut from = range(other).start;
                for i in range(at).filter(dense) {
                    let z = column[i].z;
                    while from < range(other).end && column[from].z + 1 < z {
                        from += 1;
                    }
                    let near = (from..range(other).end).take_while(|j| column[*j].z <= z + 1);
                    for j in near.filter(dense) {
                        let (a, b) = (top(&mut root, i as u32), top(&mut root, j as u32));
                        root[a.max(b) as usize] = a.min(b);
                    }
                }
            }
        }
        let of: Vec<Option<u32>> =
            (0..column.len()).map(|i| dense(&i).then(|| top(&mut root, i as u32))).collect();
        let (mut count, mut is_low) = (vec![0u32; column.len()], vec![false; column.len()]);
        for (at, ground) in height.iter().enumerate() {
            for i in range(at) {
                let Some(of) = of[i] else { continue };
                count[of as usize] += 1;
                is_low[of as usize] |= f32::from(column[i].z) < ground + near_ground;
            }
        }
        Clumps { column, start, height, cols, voxel_m, near_ground, of, count, is_low }
    }

    /// Which voxels hang in the air with no more than one other.
    pub fn scraps(&self) -> Vec<bool> {
        let is_scrap = |of: u32| self.count[of as usize] < FEWEST && !self.is_low[of as usize];
        self.of.iter().map(|of| of.is_some_and(is_scrap)).collect()
    }

    /// What is below the lowest voxel of a column where that is near the ground: a column and its layers.
    /// Of shrubs only the top returned pulses.
    pub fn feet(&self) -> Vec<(usize, Range<u16>)> {
        let foot = |at: usize| {
            let mut voxels = self.start[at] as usize..self.start[at + 1] as usize;
            let lowest = self.column[voxels.find(|i| self.of[*i].is_some())?].z;
            let ground = self.height[at].max(0.0);
            let is_near = f32::from(lowest) < ground + self.near_ground;
            let layers = ground.ceil() as u16..lowest;
            (is_near && !layers.is_empty()).then_some((at, layers))
        };
        (0..self.height.len()).filter_map(foot).collect()
    }

    /// What must stand below the other clumps in the air, of which no pulse came back: a column and the
    /// layers of a stem in its middle. Clumps beside a higher one that stands are its branches.
    pub fn stems(&self) -> Vec<(usize, Range<u16>)> {
        let voxels = (0..self.height.len())
            .flat_map(|at| (self.start[at]..self.start[at + 1]).map(move |i| (at, i as usize)));
        let mut standing = vec![0u16; self.height.len()];
        let mut hanging: BTreeMap<u32, Vec<(usize, u16)>> = BTreeMap::new();
        for (at, i) in voxels {
            let (Some(of), z) = (self.of[i], self.column[i].z) else { continue };
            if self.is_low[of as usize] {
                standing[at] = standing[at].max(z);
            } else if self.count[of as usize] >= FEWEST {
                hanging.entry(of).or_default().push((at, z));
            }
        }
        // What is small may be a branch of what is large.
        let mut hanging: Vec<Vec<(usize, u16)>> = hanging.into_values().collect();
        hanging.sort_by_key(|clump| Reverse(clump.len()));
        let mut stems = Vec::new();
        for clump in hanging {
            let place = |at: usize| Vec2::new((at % self.cols) as f32, (at / self.cols) as f32);
            let middle = clump.iter().map(|(at, _)| place(*at)).sum::<Vec2>() / clump.len() as f32;
            let off = |at: usize| place(at).distance_squared(middle);
            let nearest = clump.iter().min_by(|a, b| off(a.0).total_cmp(&off(b.0)));
            let Some(&(at, foot)) = nearest else { continue };
            let ground = self.height[at].max(0.0);
            if !self.is_held(&standing, at, foot, HELD * (f32::from(foot) - ground)) {
                stems.push((at, ground.ceil() as u16..foot));
            }
            for (at, z) in clump {
                standing[at] = standing[at].max(z);
            }
        }
        stems
    }

    /// Stems of trees, under tops that are the highest around, where of all that stands close by nothing
    /// shows for long on the way to the ground.
    pub fn trunks(&self) -> Vec<(usize, Range<u16>)> {
        let dense = |at: usize| {
            let voxels = self.start[at] as usize..self.start[at + 1] as usize;
            voxels.filter(|i| self.of[*i].is_some()).map(|i| self.column[i].z)
        };
        let tops: Vec<u16> =
            (0..self.height.len()).map(|at| dense(at).next_back().unwrap_or(0)).collect();
        let trunk = |at: usize| {
            let (top, ground) = (tops[at], self.height[at].max(0.0));
            let tall = f32::from(top) - ground;
            if tall * self.voxel_m < TALL_M {
                return None;
            }
            let reach = (OWN * tall).round().max(1.0);
            let is_higher = |i: usize| (tops[i], Reverse(i)) > (top, Reverse(at));
            if self.around(at, reach).any(is_higher) {
                return None;
            }
            let mut layers: Vec<u16> = self.around(at, reach).flat_map(dense).collect();
            layers.sort_unstable();
            let foot = ground.ceil() as u16;
            let gap = (GAP * tall).max(GAP_M / self.voxel_m);
            let mut below = foot;
            let above_gap = layers.into_iter().filter(|z| *z >= foot).find(|z| {
                let is_gap = f32::from(z - below) > gap;
                below = *z;
                is_gap
            })?;
            let own = dense(at).find(|z| *z >= above_gap)?;
            Some((at, foot..own))
        };
        (0..self.height.len()).into_par_iter().filter_map(trunk).collect()
    }

    /// Columns up to so many from one along x and y.
    fn around(&self, at: usize, reach: f32) -> impl Iterator<Item = usize> + use<'_> {
        let (rows, reach) = (self.height.len() / self.cols, reach.ceil() as usize);
        let near = |i: usize, most: usize| i.saturating_sub(reach)..(i + reach + 1).min(most);
        let (x, y) = (near(at % self.cols, self.cols), near(at / self.cols, rows));
        let cols = self.cols;
        y.flat_map(move |y| x.clone().map(move |x| y * cols + x))
    }

    /// Whether anything within `reach` columns of a place stands as high as `foot`.
    fn is_held(&self, standing: &[u16], at: usize, foot: u16, reach: f32) -> bool {
        self.around(at, reach).any(|i| standing[i] >= foot)
    }
}

/// The least of those that touch, halving the path on the way.
fn top(root: &mut [u32], mut i: u32) -> u32 {
    while root[i as usize] != i {
        let up = root[root[i as usize] as usize];
        root[i as usize] = up;
        i = up;
    }
    i
}

#[cfg(test)]
mod tests {
    use super::*;

    const COLS: usize = 8;

    /// What `look` says of these voxels, x, y, z, over flat ground at 0, sorted by column.
    fn of<T>(voxels: &mut [[u32; 3]], look: impl Fn(Clumps<'_>) -> T) -> T {
        voxels.sort_unstable_by_key(|[x, y, z]| (*y, *x, *z));
        let mut start = vec![0u32; COLS * COLS + 1];
        for [x, y, _] in &*voxels {
            start[*y as usize * COLS + *x as usize + 1] += 1;
        }
        for i in 1..start.len() {
            start[i] += start[i - 1];
        }
        let column: Vec<Voxel> =
            voxels.iter().map(|[_, _, z]| Voxel { z: *z as u16, density: 3 }).collect();
        look(Clumps::new(&column, &start, &[0.0; COLS * COLS], COLS, (2, 0.4)))
    }

    fn scraps(mut voxels: Vec<[u32; 3]>) -> Vec<[u32; 3]> {
        let is_scrap = of(&mut voxels, |clumps| clumps.scraps());
        voxels.into_iter().zip(is_scrap).filter(|(_, is)| *is).map(|(v, _)| v).collect()
    }

    #[test]
    fn a_crown_in_the_air_has_a_stem() {
        let stems = |mut voxels: Vec<[u32; 3]>| of(&mut voxels, |clumps| clumps.stems());
        let crown = vec![[2, 3, 12], [3, 3, 9], [3, 3, 10], [4, 3, 11]];
        assert_eq!(stems(crown.clone()), [(3 * COLS + 3, 0..9)]);
        // Its lower branches hang on it.
        let branch = [[5, 4, 8], [6, 4, 8], [6, 5, 8]];
        assert_eq!(stems([&crown[..], &branch].concat()).len(), 1);
        // So does a crown beside a tree that has returns from its foot up.
        let tree: Vec<[u32; 3]> = (0..20).map(|z| [5, 5, z]).collect();
        assert!(stems([&crown[..], &tree].concat()).is_empty());
        // Crumbs stand on nothing, as they are left out.
        assert!(stems(vec![[1, 1, 20], [1, 1, 21]]).is_empty());
    }

    #[test]
    fn a_crown_that_holds_on_to_another_has_a_trunk() {
        let trunks = |mut voxels: Vec<[u32; 3]>| of(&mut voxels, |clumps| clumps.trunks());
        let tree: Vec<[u32; 3]> = (0..20).map(|z| [0, 4, z]).collect();
        let crown: Vec<[u32; 3]> = (15..19).flat_map(|z| [[5, 4, z], [6, 4, z]]).collect();
        let bridge = [[1, 4, 17], [2, 4, 17], [3, 4, 17], [4, 4, 17]];
        let canopy = [&tree[..], &bridge, &crown].concat();
        assert_eq!(trunks(canopy.clone()), [(4 * COLS + 5, 0..15)]);
        // Returns from the stem, at its side and with gaps, are enough.
        let stem = [[6, 5, 4], [6, 5, 9], [6, 5, 12]];
        assert!(trunks([&canopy[..], &stem].concat()).is_empty());
        // Shrubs are none.
        assert!(trunks(vec![[2, 2, 8], [2, 2, 9]]).is_empty());
    }

    #[test]
    fn shrubs_reach_the_ground() {
        let feet = |mut voxels: Vec<[u32; 3]>| of(&mut voxels, |clumps| clumps.feet());
        // Up to 1.6 m in voxels of 0.4 m.
        assert_eq!(feet(vec![[4, 4, 3], [4, 4, 4]]), [(4 * COLS + 4, 0..3)]);
        assert!(feet(vec![[4, 4, 0], [4, 4, 3], [5, 4, 4], [6, 4, 9]]).is_empty());
    }

    #[test]
    fn only_one_or_two_in_the_air_are() {
        assert_eq!(scraps(vec![[1, 1, 20], [5, 5, 20], [6, 4, 21]]).len(), 3);
        // Touching by corners, in every direction.
        assert!(scraps(vec![[1, 2, 20], [2, 1, 21], [3, 2, 20]]).is_empty());
        assert!(scraps(vec![[7, 7, 20], [7, 7, 21], [6, 6, 22]]).is_empty());
        // Across the end of a row nothing touches.
        assert_eq!(scraps(vec![[7, 2, 20], [0, 3, 20], [7, 2, 21]]).len(), 3);
        // Shrubs and stumps.
        assert!(scraps(vec![[4, 4, 2]]).is_empty());
        assert!(scraps(vec![[4, 4, 4], [4, 4, 3]]).is_empty());
    }
}
