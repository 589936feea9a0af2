//! Single voxels in the air: of a twig, a bird or noise, met by one pulse; in pictures they hang beside
//! crowns as crumbs.

use super::build::Voxel;

/// Voxels that touch each other are kept from so many on.
const FEWEST: u32 = 3;
/// Voxels above the ground up to which all are kept.
const NEAR_GROUND: f32 = 4.0;

/// Which voxels of columns, `cols` in a row, hang in the air with no more than one other that is at
/// least `half` full. `start` tells where the voxels of each column begin, and their end; heights of
/// the ground are in voxels.
pub(super) fn scraps(
    column: &[Voxel],
    start: &[u32],
    height: &[f32],
    cols: usize,
    half: u8,
) -> Vec<bool> {
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
    let mut count = vec![0u32; column.len()];
    let mut is_low = vec![false; column.len()];
    for (at, ground) in height.iter().enumerate() {
        for i in range(at).filter(dense) {
            let of = top(&mut root, i as u32) as usize;
            count[of] += 1;
            is_low[of] |= f32::from(column[i].z) < ground + NEAR_GROUND;
        }
    }
    let is_scrap = |i: usize| {
        let of = top(&mut root, i as u32) as usize;
        dense(&i) && count[of] < FEWEST && !is_low[of]
    };
    (0..column.len()).map(is_scrap).collect()
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

    /// Which of these voxels, x, y, z, over flat ground at 0, are scraps.
    fn of(mut voxels: Vec<[u32; 3]>) -> Vec<[u32; 3]> {
        const COLS: usize = 8;
        voxels.sort_unstable_by_key(|[x, y, z]| (*y, *x, *z));
        let mut start = vec![0u32; COLS * COLS + 1];
        for [x, y, _] in &voxels {
            start[*y as usize * COLS + *x as usize + 1] += 1;
        }
        for i in 1..start.len() {
            start[i] += start[i - 1];
        }
        let column: Vec<Voxel> =
            voxels.iter().map(|[_, _, z]| Voxel { z: *z as u16, density: 3 }).collect();
        let is_scrap = scraps(&column, &start, &[0.0; COLS * COLS], COLS, 2);
        voxels.into_iter().zip(is_scrap).filter(|(_, is)| *is).map(|(v, _)| v).collect()
    }

    #[test]
    fn only_one_or_two_in_the_air_are() {
        assert_eq!(of(vec![[1, 1, 20], [5, 5, 20], [6, 4, 21]]).len(), 3);
        // Touching by corners, in every direction.
        assert!(of(vec![[1, 2, 20], [2, 1, 21], [3, 2, 20]]).is_empty());
        assert!(of(vec![[7, 7, 20], [7, 7, 21], [6, 6, 22]]).is_empty());
        // Across the end of a row nothing touches.
        assert_eq!(of(vec![[7, 2, 20], [0, 3, 20], [7, 2, 21]]).len(), 3);
        // Shrubs and stumps.
        assert!(of(vec![[4, 4, 2]]).is_empty());
        assert!(of(vec![[4, 4, 4], [4, 4, 3]]).is_empty());
    }
}
