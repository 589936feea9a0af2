//! Blocks of voxels by their place: rays begin in them instead of at the root of the graph, which
//! would be the same few steps down for all.

use super::dag::{BITS, Dag, Ref};

/// The level of the graph whose nodes are blocks.
pub(super) const BLOCK_LEVEL: u32 = 3;
/// Voxels along the side of a block.
pub(super) const BLOCK: u32 = 1 << (BITS * BLOCK_LEVEL);

#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct Blocks {
    /// Blocks along x, y and z.
    pub sides: [u32; 3],
    /// x fastest; all bits 0 where a block is empty.
    nodes: Vec<u32>,
}

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
        let count = sides.iter().map(|side| *side as usize).product();
        let mut blocks = Blocks { sides, nodes: vec![0; count] };
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
            let at = self.index(low);
            self.nodes[at] = node.0;
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

    fn index(&self, [x, y, z]: [u32; 3]) -> usize {
        x as usize + self.sides[0] as usize * (y as usize + self.sides[1] as usize * z as usize)
    }

    /// Whether a place is among them.
    #[inline]
    pub fn holds(&self, [x, y, z]: [u32; 3]) -> bool {
        x < self.sides[0] && y < self.sides[1] && z < self.sides[2]
    }

    /// The block at a place that they hold.
    #[inline]
    pub fn at(&self, place: [u32; 3]) -> Option<Ref> {
        let node = self.nodes[self.index(place)];
        (node != 0).then_some(Ref(node))
    }

    /// Bytes held.
    pub fn memory_bytes(&self) -> usize {
        size_of::<Self>() + 4 * self.nodes.capacity()
    }
}
