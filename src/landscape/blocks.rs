//! Blocks of voxels by their place: rays begin in them instead of at the root of the graph, which
//! would be the same few steps down for all.

use super::dag::{BITS, Dag, Ref, SIDE};

/// The level of the graph whose nodes are blocks.
pub(super) const BLOCK_LEVEL: u32 = 3;
/// Voxels along the side of a block.
pub(super) const BLOCK: u32 = 1 << (BITS * BLOCK_LEVEL);

#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct Blocks {
    /// Blocks along x, y and z.
    pub sides: [u32; 3],
    /// 2^[`PER_ROW_BITS`] over what [`Blocks::row`] is, rounded up: exact for as many columns as can be.
    per_row: u64,
    /// Bricks up to which anything reaches; −1 where nothing is.
    pub top: i16,
    /// Bricks up to which anything reaches, by column of the children of blocks, x fastest, with one
    /// more column all around.
    tops: Vec<i16>,
    /// The same by column of blocks.
    highest: Vec<i16>,
    /// z fastest, then x; all bits 0 where a block is empty.
    nodes: Vec<u32>,
}

const PER_ROW_BITS: u32 = 47;
/// Blocks of one landscape, at most.
const MOST: u64 = 1 << 26;

impl Blocks {
    /// Whether so many cells along each axis are not too many.
    pub fn hold(cells: [u32; 3]) -> bool {
        let count = |cells: u32| u64::from(cells / BLOCK + 1);
        let flat = count(cells[0]).checked_mul(count(cells[1]));
        flat.and_then(|flat| flat.checked_mul(count(cells[2]))).is_some_and(|all| all <= MOST)
    }

    /// The blocks of a graph over so many cells along each axis.
    pub fn of(dag: &Dag, cells: [u32; 3]) -> Blocks {
        let sides = cells.map(|cells| cells / BLOCK + 1);
        let columns = sides[0] as usize * sides[1] as usize;
        let mut blocks = Blocks {
            sides,
            per_row: (1u64 << PER_ROW_BITS).div_ceil(around(sides[0]) as u64),
            top: -1,
            tops: vec![-1; around(sides[0]) * around(sides[1])],
            highest: vec![-1; columns],
            nodes: vec![0; columns * sides[2] as usize],
        };
        if let Some(root) = dag.root {
            blocks.fill(dag, root, dag.levels, [0; 3]);
        }
        blocks
    }

    fn fill(&mut self, dag: &Dag, node: Ref, level: u32, low: [u32; 3]) {
        if !self.holds(low) {
            return;
        }
        if level <= BLOCK_LEVEL {
            let column = self.number(low[0], low[1]);
            self.nodes[column * self.sides[2] as usize + low[2] as usize] = node.0;
            for flat in 0..SIDE * SIDE {
                let Some(reach) = reach(dag, node, flat) else { continue };
                let reach = (low[2] * BLOCK / SIDE + reach) as i16;
                let place = self.place([low[0] * SIDE + flat % SIDE, low[1] * SIDE + flat / SIDE]);
                self.tops[place] = self.tops[place].max(reach);
                self.highest[column] = self.highest[column].max(reach);
            }
            self.top = self.top.max(self.highest[column]);
            return;
        }
        let bits = BITS * (level - 1 - BLOCK_LEVEL);
        for slot in 0..64 {
            if let Some(child) = dag.child(node.index(), slot) {
                let at = [slot & 3, slot >> 2 & 3, slot >> 4];
                let low = [0, 1, 2].map(|axis: usize| low[axis] + (at[axis] << bits));
                self.fill(dag, child, level - 1, low);
            }
        }
    }

    fn number(&self, x: u32, y: u32) -> usize {
        x as usize + self.sides[0] as usize * y as usize
    }

    /// Whether a place is among them.
    fn holds(&self, [x, y, z]: [u32; 3]) -> bool {
        x < self.sides[0] && y < self.sides[1] && z < self.sides[2]
    }

    /// The number of a column of the children of blocks.
    #[inline(always)]
    pub fn place(&self, [x, y]: [u32; 2]) -> usize {
        x as usize + 1 + self.row() * (y as usize + 1)
    }

    /// From the number of a column to that of its northern neighbour.
    #[inline(always)]
    pub fn row(&self) -> usize {
        around(self.sides[0])
    }

    /// The column with a number that [`Blocks::place`] gives.
    #[inline(always)]
    pub fn at(&self, place: usize) -> [u32; 2] {
        let y = (place as u64 * self.per_row) >> PER_ROW_BITS;
        let x = place as u64 - y * self.row() as u64;
        [(x as u32).wrapping_sub(1), (y as u32).wrapping_sub(1)]
    }

    /// The blocks of a column from the lowest up; all bits 0 where one is empty.
    #[inline(always)]
    pub fn stack(&self, [x, y]: [u32; 2]) -> &[u32] {
        let (column, high) = (self.number(x, y), self.sides[2] as usize);
        &self.nodes[column * high..][..high]
    }

    /// Bricks up to which anything reaches in a column of the children of blocks.
    #[inline(always)]
    pub fn over(&self, place: usize) -> i16 {
        self.tops.get(place).copied().unwrap_or(-1)
    }

    /// Bricks up to which anything reaches in a column of blocks.
    #[inline(always)]
    pub fn highest(&self, [x, y]: [u32; 2]) -> i16 {
        self.highest[self.number(x, y)]
    }

    /// Bytes held.
    pub fn memory_bytes(&self) -> usize {
        size_of::<Self>()
            + 2 * (self.tops.capacity() + self.highest.capacity())
            + 4 * self.nodes.capacity()
    }
}

/// Columns of the children of so many blocks, and one at either end.
#[inline(always)]
fn around(blocks: u32) -> usize {
    (blocks * SIDE) as usize + 2
}

/// Bricks from the floor of a block up to which anything reaches in a column of its children.
fn reach(dag: &Dag, block: Ref, flat: u32) -> Option<u32> {
    let layer = (0..SIDE).rev().find_map(|z| Some((z, dag.child(block.index(), flat | z << 4)?)));
    let (z, child) = layer?;
    let highest = 3 - dag.mask(child.index()).leading_zeros() / 16;
    Some(z * SIDE + highest + 1)
}
