//! Living attractors in cells, by which a new node finds those it is nearest to.
//!
//! A cell knows how far its worst-served attractor is from its node; cells in which a new node
//! could better nothing are passed over. Attractors of a cell stand side by side in groups of
//! [`LANES`], coordinates apart, so that a group is measured at once.

use std::ops::Range;

use glam::Vec3;

pub(super) const NOBODY: u32 = u32::MAX;
/// Owner of an attractor that was removed.
const GONE: u32 = u32::MAX - 1;
/// Attractors measured together.
const LANES: usize = 4;
/// Widening of a cell against rounding, in cells.
const SLACK: f32 = 0.01;

/// Distance of an attractor that is not there: none is below.
const NONE_SQ: f32 = -1.0;

/// Attractors side by side, a cache line of them.
#[derive(Clone, Copy)]
#[repr(align(64))]
struct Group {
    x: [f32; LANES],
    y: [f32; LANES],
    z: [f32; LANES],
    /// To the nearest node so far, at most the influence distance.
    distance_sq: [f32; LANES],
}

const FREE: Group =
    Group { x: [0.0; LANES], y: [0.0; LANES], z: [0.0; LANES], distance_sq: [NONE_SQ; LANES] };

pub(super) struct Grid {
    /// The width of cells.
    influence_m: f32,
    cells_per_m: f32,
    table: Table,
    /// Where the groups of each bucket begin (one more at the end), and the greatest of their
    /// distances.
    first_group: Vec<u32>,
    far_sq: Vec<f32>,
    group: Vec<Group>,
    /// Ids of the attractors of each group.
    id: Vec<[u32; LANES]>,
    /// By id, cell after cell.
    pub attractor: Vec<Attractor>,
}

/// An attractor, and its nearest node within the influence distance.
#[derive(Clone, Copy)]
pub(super) struct Attractor {
    pub at: Vec3,
    pub owner: u32,
}

impl Grid {
    pub fn new(points: &[Vec3], influence_m: f32) -> Option<Grid> {
        if points.is_empty() {
            return None;
        }
        let influence_sq = influence_m * influence_m;
        let cells_per_m = 1.0 / influence_m;
        let (table, buckets) = Table::new(points, cells_per_m);
        let in_bucket: Vec<u32> =
            points.iter().map(|&p| table.home(p, cells_per_m) as u32).collect();
        let mut count = vec![0u32; buckets];
        for &b in &in_bucket {
            count[b as usize] += 1;
        }
        let mut first_group = Vec::with_capacity(buckets + 1);
        let mut first_id = Vec::with_capacity(buckets);
        let (mut groups, mut ids) = (0, 0);
        for &n in &count {
            first_group.push(groups);
            first_id.push(ids);
            groups += n.div_ceil(LANES as u32);
            ids += n;
        }
        first_group.push(groups);
        let far_sq = count.iter().map(|&n| if n > 0 { influence_sq } else { NONE_SQ }).collect();
        let mut group = vec![FREE; groups as usize];
        let mut id = vec![[0; LANES]; groups as usize];
        let mut attractor = vec![Attractor { at: Vec3::ZERO, owner: NOBODY }; points.len()];
        let mut filled = vec![0u32; buckets];
        for (&p, &b) in points.iter().zip(&in_bucket) {
            let b = b as usize;
            let nth = filled[b] as usize;
            filled[b] += 1;
            let (place, lane) = (first_group[b] as usize + nth / LANES, nth % LANES);
            let own_id = first_id[b] + nth as u32;
            attractor[own_id as usize].at = p;
            id[place][lane] = own_id;
            let place = &mut group[place];
            (place.x[lane], place.y[lane], place.z[lane]) = (p.x, p.y, p.z);
            place.distance_sq[lane] = influence_sq;
        }
        Some(Grid { influence_m, cells_per_m, table, first_group, far_sq, group, id, attractor })
    }

    /// Gives `node` the attractors it is nearest to, writes their ids to `gained`, and removes
    /// those within the kill distance.
    pub fn visit(&mut self, node: u32, at: Vec3, kill_sq: f32, gained: &mut Vec<u32>) {
        let centre = cell(at, self.cells_per_m);
        // Squared distance from the node to each layer of cells, along each axis.
        let layers: [[f32; 3]; 3] = std::array::from_fn(|k| {
            let inside = at[k] * self.cells_per_m - centre[k] as f32;
            [inside, 0.0, 1.0 - inside].map(|gap| {
                let gap_m = (gap - SLACK).max(0.0) * self.influence_m;
                gap_m * gap_m
            })
        });
        let near = self.table.near(centre);
        for z in near[2].clone() {
            for y in near[1].clone() {
                let side_sq = layers[2][z] + layers[1][y];
                for x in near[0].clone() {
                    let b = self.table.bucket([x, y, z], centre);
                    if side_sq + layers[0][x] < self.far_sq[b] {
                        self.search(b, node, at, kill_sq, gained);
                    }
                }
            }
        }
    }

    fn search(&mut self, b: usize, node: u32, at: Vec3, kill_sq: f32, gained: &mut Vec<u32>) {
        let groups = self.first_group[b] as usize..self.first_group[b + 1] as usize;
        let mut far_sq = [NONE_SQ; LANES];
        let mut is_better = false;
        for (group, ids) in self.group[groups.clone()].iter_mut().zip(&self.id[groups]) {
            let mut d = [0.0f32; LANES];
            let mut is_nearer = false;
            #[allow(clippy::needless_range_loop)] // one vector operation a line
            for i in 0..LANES {
                let (x, y, z) = (group.x[i] - at.x, group.y[i] - at.y, group.z[i] - at.z);
                d[i] = x * x + y * y + z * z;
                is_nearer |= d[i] < group.distance_sq[i];
            }
            if is_nearer {
                is_better = true;
                for i in 0..LANES {
                    if d[i] < group.distance_sq[i] {
                        let id = ids[i];
                        if d[i] <= kill_sq {
                            group.distance_sq[i] = NONE_SQ;
                            self.attractor[id as usize].owner = GONE;
                        } else {
                            group.distance_sq[i] = d[i];
                            self.attractor[id as usize].owner = node;
                            gained.push(id);
                        }
                    }
                }
            }
            for (far, &d) in far_sq.iter_mut().zip(&group.distance_sq) {
                *far = if d > *far { d } else { *far };
            }
        }
        if is_better {
            self.far_sq[b] = far_sq.into_iter().fold(NONE_SQ, f32::max);
        }
    }

    pub fn living(&self) -> Vec<Vec3> {
        self.attractor.iter().filter(|a| a.owner != GONE).map(|a| a.at).collect()
    }
}

/// Where the attractors of a cell are.
enum Table {
    /// All cells of a box, row after row: for clouds that fill a good part of their box.
    Box { low: [i32; 3], size: [i32; 3] },
    /// Cells by hash, for those that do not.
    Hash { mask: u32 },
}

impl Table {
    /// The table and its number of buckets.
    fn new(points: &[Vec3], cells_per_m: f32) -> (Table, usize) {
        let (mut low, mut high) = ([i32::MAX; 3], [i32::MIN; 3]);
        for &p in points {
            let c = cell(p, cells_per_m);
            for k in 0..3 {
                low[k] = low[k].min(c[k]);
                high[k] = high[k].max(c[k]);
            }
        }
        let extent = |k: usize| i64::from(high[k]) - i64::from(low[k]) + 1;
        let most = (8 * points.len() as i64 + 4096).min(1 << 30);
        let is_compact = (0..3).all(|k| extent(k) <= most)
            && (extent(0) * extent(1)).saturating_mul(extent(2)) <= most;
        if is_compact {
            let size = [extent(0) as i32, extent(1) as i32, extent(2) as i32];
            let cells = size.iter().map(|&s| s as usize).product();
            return (Table::Box { low, size }, cells);
        }
        let buckets = points.len().next_power_of_two().min(1 << 26);
        (Table::Hash { mask: buckets as u32 - 1 }, buckets)
    }

    /// The bucket of a point the table was made for.
    fn home(&self, p: Vec3, cells_per_m: f32) -> usize {
        self.bucket([1; 3], cell(p, cells_per_m))
    }

    /// Which of the 27 cells around `centre` may hold anything, per axis.
    fn near(&self, centre: [i32; 3]) -> [Range<usize>; 3] {
        std::array::from_fn(|k| match *self {
            Table::Hash { .. } => 0..3,
            Table::Box { low, size } => {
                let first = low[k].saturating_sub(centre[k]).saturating_add(1);
                let end = first.saturating_add(size[k]);
                first.clamp(0, 3) as usize..end.clamp(0, 3) as usize
            }
        })
    }

    /// Bucket of one of the 27 cells around `centre`; in a box, one that is [`near`](Self::near).
    fn bucket(&self, at: [usize; 3], centre: [i32; 3]) -> usize {
        let c: [i32; 3] = std::array::from_fn(|k| centre[k] - 1 + at[k] as i32);
        match *self {
            Table::Hash { mask } => (hash(c) & mask) as usize,
            Table::Box { low, size } => {
                let [x, y, z] = std::array::from_fn(|k| (c[k] - low[k]) as usize);
                (z * size[1] as usize + y) * size[0] as usize + x
            }
        }
    }
}

pub(super) fn cell(p: Vec3, cells_per_m: f32) -> [i32; 3] {
    // Saturating casts; the clamp keeps the neighbours' indices in range.
    let index = |v: f32| {
        let v = v * cells_per_m;
        let whole = v as i32;
        (whole - i32::from(whole as f32 > v)).clamp(-(1 << 30), 1 << 30)
    };
    [index(p.x), index(p.y), index(p.z)]
}

/// Teschner et al. 2003, then mixed so that low bits depend on all.
fn hash(c: [i32; 3]) -> u32 {
    let h = (c[0] as u32).wrapping_mul(73_856_093)
        ^ (c[1] as u32).wrapping_mul(19_349_663)
        ^ (c[2] as u32).wrapping_mul(83_492_791);
    let h = (h ^ (h >> 15)).wrapping_mul(0x2c1b_3c6d);
    h ^ (h >> 13)
}
