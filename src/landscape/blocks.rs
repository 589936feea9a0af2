//! Blocks of voxels by their place: rays begin in them instead of at the root of the graph, which
//! would be the same few steps down for all.

use std::collections::HashMap;

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
    /// By column of blocks, x fastest, which of the different stacks of blocks is there.
    stacks: Vec<u32>,
    /// Blocks of each different stack from the lowest up; all bits 0 where one is empty.
    nodes: Vec<u32>,
    /// Bricks up to which anything reaches in each different stack, by column of bricks.
    reaches: Vec<Reaches>,
}

/// Bricks along the side of a block.
const ROW: u32 = BLOCK / SIDE;
/// A number for each column of bricks of a block, x fastest.
pub(super) type Reaches = [i16; (ROW * ROW) as usize];
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
            stacks: Vec::with_capacity(columns),
            ..Blocks::default()
        };
        let high = sides[2] as usize;
        let mut nodes = vec![0; columns * high];
        if let Some(root) = dag.root {
            blocks.fill(&mut nodes, dag, root, dag.levels, [0; 3]);
        }
        let mut known: HashMap<&[u32], u32> = HashMap::new();
        for stack in nodes.chunks_exact(high) {
            let next = known.len() as u32;
            blocks.stacks.push(*known.entry(stack).or_insert_with(|| {
                blocks.nodes.extend_from_slice(stack);
                blocks.reaches.push(reaches(dag, stack));
                next
            }));
        }
        blocks.nodes.shrink_to_fit();
        blocks.reaches.shrink_to_fit();
        for (y, x) in (0..sides[1] * ROW).flat_map(|y| (0..sides[0] * ROW).map(move |x| (y, x))) {
            let reach = blocks.reach([x, y]);
            let (column, place) =
                (blocks.number(x / ROW, y / ROW), blocks.place([x / SIDE, y / SIDE]));
            blocks.tops[place] = blocks.tops[place].max(reach);
            blocks.highest[column] = blocks.highest[column].max(reach);
            blocks.top = blocks.top.max(reach);
        }
        blocks
    }

    /// Where blocks are in the graph, z fastest, then x.
    fn fill(&self, nodes: &mut [u32], dag: &Dag, node: Ref, level: u32, low: [u32; 3]) {
        if !self.holds(low) {
            return;
        }
        if level <= BLOCK_LEVEL {
            let column = self.number(low[0], low[1]);
            nodes[column * self.sides[2] as usize + low[2] as usize] = node.0;
            return;
        }
        let bits = BITS * (level - 1 - BLOCK_LEVEL);
        for slot in 0..64 {
            if let Some(child) = dag.child(node.index(), slot) {
                let at = [slot & 3, slot >> 2 & 3, slot >> 4];
                let low = [0, 1, 2].map(|axis: usize| low[axis] + (at[axis] << bits));
                self.fill(nodes, dag, child, level - 1, low);
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

    /// The blocks of a column from the lowest up, all bits 0 where one is empty; and bricks up to
    /// which anything reaches in it.
    #[inline(always)]
    pub fn stack(&self, [x, y]: [u32; 2]) -> (&[u32], &Reaches) {
        let (stack, high) = (self.stacks[self.number(x, y)] as usize, self.sides[2] as usize);
        (&self.nodes[stack * high..][..high], &self.reaches[stack])
    }

    /// Bricks up to which anything reaches in a column of bricks.
    #[inline(always)]
    pub fn reach(&self, [x, y]: [u32; 2]) -> i16 {
        let stack = self.stacks[self.number(x / ROW, y / ROW)];
        self.reaches[stack as usize][Blocks::slot([x, y])]
    }

    /// Where a column of bricks is among those of its block.
    #[inline(always)]
    pub fn slot([x, y]: [u32; 2]) -> usize {
        (x % ROW + y % ROW * ROW) as usize
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
            + size_of::<Reaches>() * self.reaches.capacity()
            + 4 * (self.nodes.capacity() + self.stacks.capacity())
    }
}

/// Columns of the children of so many blocks, and one at either end.
#[inline(always)]
fn around(blocks: u32) -> usize {
    (blocks * SIDE) as usize + 2
}

/// Bricks up to which anything reaches in a stack of blocks, by column of bricks.
fn reaches(dag: &Dag, stack: &[u32]) -> Reaches {
    let mut reaches = [-1; (ROW * ROW) as usize];
    for (low, &block) in (0..).step_by(ROW as usize).zip(stack).filter(|(_, block)| **block != 0) {
        let block = Ref(block).index();
        // From below, so that the highest is told last.
        for (z, number) in (0..SIDE).flat_map(|z| (0..16).map(move |flat| (z, flat | z << 4))) {
            let Some(child) = dag.child(block, number) else { continue };
            let mask = dag.mask(child.index());
            for slot in (0..64).filter(|slot| mask >> slot & 1 != 0) {
                let x = (number & 3) * SIDE + (slot & 3);
                let y = (number >> 2 & 3) * SIDE + (slot >> 2 & 3);
                reaches[Blocks::slot([x, y])] = (low + z * SIDE + (slot >> 4) + 1) as i16;
            }
        }
    }
    reaches
}
