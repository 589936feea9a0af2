//! The sparse voxel octree (TD17): a node has eight children or none.
//!
//! The children of an inner node are its eight octants. An octant without points is a leaf that
//! takes no room: a bit in its parent's mask is all. The others lie next to each other, in Morton
//! order, in flat arrays: level after level from the root, then the voxels. So a lookup takes one
//! step a level, and says for an empty place how large the empty cube around it is, which is what
//! a ray needs to step over it.

use glam::Vec3;

use super::{Grid, Occupied, Voxel, VoxelIndex, morton};

/// Occupied voxels with their counts and centres of mass, under a sparse octree.
#[derive(Debug, Clone)]
pub struct VoxelOctree {
    grid: Grid,
    /// Levels of nodes above the voxels, at least 1.
    depth: u32,
    /// Which octants of a node hold points; root first, then level by level in Morton order.
    masks: Vec<u8>,
    /// The first child of a node: a node, or a voxel for the nodes of the last level.
    first_child: Vec<u32>,
    /// Points of each voxel, in Morton order.
    counts: Vec<u32>,
    /// As long as `counts`.
    centres_of_mass: Vec<Vec3>,
    spread_sq_m: f64,
}

/// What is at a voxel's place.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Place {
    /// A voxel, by its number in Morton order.
    Occupied(u32),
    /// Nothing, and neither in the cube of `edge` voxels (a power of two) around it whose corner
    /// has indices that are multiples of `edge`.
    Empty { edge: u32 },
}

impl VoxelOctree {
    pub(super) fn from_occupied(grid: Grid, occupied: Occupied) -> VoxelOctree {
        let side = grid.sides.into_iter().max().unwrap_or(1);
        let depth = side.next_power_of_two().trailing_zeros().max(1);
        // From the voxels up: the parents of sorted codes are sorted.
        let mut levels: Vec<(Vec<u8>, Vec<u32>)> = Vec::with_capacity(depth as usize);
        let mut codes = occupied.codes;
        for _ in 0..depth {
            let (mut masks, mut first_child, mut parents) = (Vec::new(), Vec::new(), Vec::new());
            let mut first = 0;
            for siblings in codes.chunk_by(|a, b| a >> 3 == b >> 3) {
                masks.push(siblings.iter().fold(0u8, |mask, code| mask | 1 << (code & 7)));
                first_child.push(first);
                parents.extend(siblings.first().map(|code| code >> 3));
                first += siblings.len() as u32;
            }
            levels.push((masks, first_child));
            codes = parents;
        }
        let nodes = levels.iter().map(|(masks, _)| masks.len()).sum();
        let mut tree = VoxelOctree {
            grid,
            depth,
            masks: Vec::with_capacity(nodes),
            first_child: Vec::with_capacity(nodes),
            counts: occupied.counts,
            centres_of_mass: occupied.centres_of_mass,
            spread_sq_m: occupied.spread_sq_m,
        };
        // Root first; children of a level begin where the level ends, but voxels begin at 0.
        for (up, (masks, first_child)) in levels.into_iter().enumerate().rev() {
            tree.masks.extend(masks);
            let start = if up == 0 { 0 } else { tree.masks.len() as u32 };
            tree.first_child.extend(first_child.iter().map(|child| child + start));
        }
        tree
    }

    /// Edge of a voxel.
    pub fn size_m(&self) -> f32 {
        self.grid.size_m
    }

    /// Voxels along x, y and z between the outermost occupied ones, these included.
    pub fn sides(&self) -> [u32; 3] {
        self.grid.sides
    }

    /// Occupied voxels.
    pub fn len(&self) -> usize {
        self.counts.len()
    }

    pub fn is_empty(&self) -> bool {
        self.counts.is_empty()
    }

    /// Levels of nodes above the voxels: the octree is a cube of 2^depth voxels.
    pub fn depth(&self) -> u32 {
        self.depth
    }

    /// Inner nodes.
    pub fn node_count(&self) -> usize {
        self.masks.len()
    }

    /// Centres of mass in Morton order, local metres.
    pub fn centres_of_mass(&self) -> &[Vec3] {
        &self.centres_of_mass
    }

    /// Points of each voxel in Morton order.
    pub fn counts(&self) -> &[u32] {
        &self.counts
    }

    /// RMS distance of the points from the centre of mass of their voxel.
    pub fn spread_m(&self) -> f64 {
        self.spread_sq_m.sqrt()
    }

    /// Bytes held.
    pub fn memory_bytes(&self) -> usize {
        size_of::<Self>()
            + self.masks.capacity()
            + 4 * (self.first_child.capacity() + self.counts.capacity())
            + size_of::<Vec3>() * self.centres_of_mass.capacity()
    }

    /// The voxel around a local point, occupied or not; `None` outside [`Self::sides`].
    pub fn index_of(&self, p: Vec3) -> Option<VoxelIndex> {
        self.grid.index_of(p)
    }

    /// The corner of a voxel of least x, y and z, local metres.
    pub fn corner_of(&self, index: VoxelIndex) -> Vec3 {
        self.grid.corner_of(index)
    }

    /// What is at `index`; outside the octree's cube, an empty voxel.
    pub fn place(&self, index: VoxelIndex) -> Place {
        if (index.r | index.c | index.l) >> self.depth != 0 {
            return Place::Empty { edge: 1 };
        }
        let mut at = 0u32;
        for shift in (0..self.depth).rev() {
            let node = at as usize;
            let (Some(&mask), Some(&first)) = (self.masks.get(node), self.first_child.get(node))
            else {
                return Place::Empty { edge: 1 << shift };
            };
            let bit = 1u8 << morton::octant(index, shift);
            if mask & bit == 0 {
                return Place::Empty { edge: 1 << shift };
            }
            at = first + (mask & (bit - 1)).count_ones();
        }
        Place::Occupied(at)
    }

    /// The voxel at `index`, if points are in it.
    pub fn get(&self, index: VoxelIndex) -> Option<Voxel> {
        match self.place(index) {
            Place::Occupied(number) => self.voxel(number as usize),
            Place::Empty { .. } => None,
        }
    }

    /// The voxel with this number in Morton order.
    pub fn voxel(&self, number: usize) -> Option<Voxel> {
        let centre_of_mass = *self.centres_of_mass.get(number)?;
        let count = *self.counts.get(number)?;
        // The centre lies in its voxel, so the indices need not be stored.
        Some(Voxel { index: self.index_of(centre_of_mass)?, count, centre_of_mass })
    }

    /// All voxels in Morton order.
    pub fn iter(&self) -> impl Iterator<Item = Voxel> {
        (0..self.len()).filter_map(|number| self.voxel(number))
    }

    /// The occupied ones of the 26 voxels around `index`, by l, then c, then r.
    pub fn neighbours(&self, index: VoxelIndex) -> impl Iterator<Item = Voxel> {
        let steps = |v: u32| [v.checked_sub(1), Some(v), v.checked_add(1)];
        let rows = steps(index.l)
            .into_iter()
            .flatten()
            .flat_map(move |l| steps(index.c).into_iter().flatten().map(move |c| (l, c)));
        rows.flat_map(move |(l, c)| {
            steps(index.r).into_iter().flatten().map(move |r| VoxelIndex { r, c, l })
        })
        .filter(move |near| *near != index)
        .filter_map(|near| self.get(near))
    }

    /// What breaks the invariants: every node has children, they follow each other without gaps,
    /// every voxel has points and its centre of mass is inside it and found there.
    pub fn check(&self) -> Result<(), String> {
        let n = self.len();
        if self.centres_of_mass.len() != n || self.first_child.len() != self.masks.len() {
            return Err("columns of unequal length".into());
        }
        if n == 0 && self.masks.is_empty() {
            return Ok(());
        }
        if let Some(i) = self.masks.iter().position(|mask| *mask == 0) {
            return Err(format!("node {i} has no children"));
        }
        let mut level = 0..1;
        for down in (0..self.depth).rev() {
            let mut next = if down == 0 { 0 } else { level.end };
            let start = next;
            for node in level {
                let (Some(&mask), Some(&first)) =
                    (self.masks.get(node), self.first_child.get(node))
                else {
                    return Err(format!("node {node} is missing"));
                };
                if first as usize != next {
                    return Err(format!(
                        "the children of node {node} begin at {first}, not {next}"
                    ));
                }
                next += mask.count_ones() as usize;
            }
            level = start..next;
        }
        if level != (0..n) {
            return Err(format!("the nodes lead to voxels {level:?}, but there are {n}"));
        }
        for number in 0..n {
            let Some(voxel) = self.voxel(number) else {
                return Err(format!("the centre of voxel {number} is outside the grid"));
            };
            if voxel.count == 0 {
                return Err(format!("voxel {number} has no points"));
            }
            if self.place(voxel.index) != Place::Occupied(number as u32) {
                return Err(format!("the centre of voxel {number} is in another voxel"));
            }
        }
        Ok(())
    }
}
