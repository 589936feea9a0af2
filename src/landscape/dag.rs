//! Sparse voxels with shared subtrees: equal parts of the landscape are kept once.
//!
//! TD17 keeps voxels in a sparse octree; Kämpe, Sintorn & Assarsson (2013) let equal subtrees of
//! such an octree be one, which makes it a directed acyclic graph. Departures: two levels of the
//! octree are one here, so that a node has up to 64 children under a 64-bit mask, as in the
//! "64-trees" of recent voxel engines — half the steps from the root to a voxel, and fewer bytes
//! where little is shared. The lowest node is a brick of 4 × 4 × 4 densities of a few bits, kept as
//! bit planes. Known limits: 2²⁹ words; sides of 4¹² voxels.
//!
//! Everything is in one array of words. A node at `i` has its mask in words `i` and `i + 1` and then
//! one reference a child, in the order of the mask's bits: x runs fastest, then y, then z. A brick
//! has two words a plane, the highest plane first. References come after what they refer to.

use hashbrown::HashTable;

use super::blocks::BLOCK_LEVEL;
use crate::diagnostic::{Error, Result};

/// A child: where its words begin, and what is somewhere within.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Ref(pub u32);

impl Ref {
    /// The ground's surface passes through.
    pub const GROUND: u32 = 1 << 31;
    /// Vegetation of at least half the full density.
    pub const VEGETATION: u32 = 1 << 30;
    /// Cells between voxel centres where the density may pass one half.
    pub const CELLS: u32 = 1 << 29;
    const FLAGS: u32 = Ref::GROUND | Ref::VEGETATION | Ref::CELLS;
    const MOST: usize = 1 << 29;

    pub fn index(self) -> usize {
        (self.0 & !Ref::FLAGS) as usize
    }

    pub fn flags(self) -> u32 {
        self.0 & Ref::FLAGS
    }

    pub fn has(self, flag: u32) -> bool {
        self.0 & flag != 0
    }
}

/// Voxels along the side of a brick, and children of a node along an axis.
pub(super) const SIDE: u32 = 4;
/// Bits that an index loses from one level to the next.
pub(super) const BITS: u32 = 2;
/// Levels above the voxels, at most.
pub(super) const MOST_LEVELS: u32 = 12;
/// Bits of a density, at most.
pub(super) const MOST_PLANES: u32 = 4;

/// The number of a child or voxel among 64.
pub(super) fn slot(x: u32, y: u32, z: u32) -> u32 {
    x & 3 | (y & 3) << 2 | (z & 3) << 4
}

#[derive(Debug, Clone, PartialEq)]
pub(super) struct Dag {
    pub words: Vec<u32>,
    /// `None` where there is nothing at all.
    pub root: Option<Ref>,
    /// The root's side is 4^levels voxels; bricks are level 1.
    pub levels: u32,
    /// Bits of a density.
    pub planes: u32,
}

impl Dag {
    fn word_pair(&self, at: usize) -> u64 {
        u64::from(self.words[at]) | u64::from(self.words[at + 1]) << 32
    }

    /// Which children a node has.
    pub fn mask(&self, node: usize) -> u64 {
        self.word_pair(node)
    }

    /// The child in `slot`, if the node has one.
    pub fn child(&self, node: usize, slot: u32) -> Option<Ref> {
        let mask = self.mask(node);
        let bit = 1u64 << slot;
        let rank = (mask & (bit - 1)).count_ones() as usize;
        (mask & bit != 0).then(|| Ref(self.words[node + 2 + rank]))
    }

    /// The child in `slot` of a node that has it, and these in all.
    #[inline(always)]
    pub fn nth(&self, node: usize, mask: u64, slot: u32) -> Ref {
        let rank = (mask & ((1u64 << slot) - 1)).count_ones() as usize;
        Ref(self.words[node + 2 + rank])
    }

    /// What some of a node's children hold, of which no one is meant.
    #[inline(always)]
    pub fn flags(&self, node: usize, mask: u64, mut some: u64) -> Ref {
        let mut flags = 0;
        while some != 0 {
            flags |= self.nth(node, mask, some.trailing_zeros()).flags();
            some &= some - 1;
        }
        Ref(flags)
    }

    /// The highest plane of a brick: voxels of at least half the full density.
    pub fn solid(&self, brick: usize) -> u64 {
        self.word_pair(brick)
    }

    /// A plane of a brick, the highest being 0.
    pub fn plane(&self, brick: usize, plane: u32) -> u64 {
        self.word_pair(brick + 2 * plane as usize)
    }

    /// The sum of a brick's densities over what it would be if all were full.
    pub fn fill(&self, brick: usize) -> f32 {
        let ones = |plane: u32| self.plane(brick, plane).count_ones() << (self.planes - 1 - plane);
        let sum: u32 = (0..self.planes).map(ones).sum();
        sum as f32 / (64 * ((1u32 << self.planes) - 1)) as f32
    }

    /// The brick around a voxel.
    pub fn brick(&self, [x, y, z]: [u32; 3]) -> Option<Ref> {
        if (x | y | z) >> (BITS * self.levels) != 0 {
            return None;
        }
        let mut at = self.root?;
        for level in (1..self.levels).rev() {
            let shift = BITS * level;
            at = self.child(at.index(), slot(x >> shift, y >> shift, z >> shift))?;
        }
        Some(at)
    }

    /// What breaks the invariants: references to earlier words only, masks that are not empty,
    /// bricks that hold something, no reference cut by the end.
    pub fn check(&self) -> std::result::Result<(), String> {
        if !(BLOCK_LEVEL..=MOST_LEVELS).contains(&self.levels) {
            return Err(format!("{} levels", self.levels));
        }
        if !(1..=MOST_PLANES).contains(&self.planes) {
            return Err(format!("densities of {} bits", self.planes));
        }
        let Some(root) = self.root else { return Ok(()) };
        // One visit a node and level; a well-made graph has each node on one level only.
        let mut level_of = vec![0u8; self.words.len()];
        let mut open = vec![(root, self.levels)];
        while let Some((at, level)) = open.pop() {
            let i = at.index();
            let Some(known) = level_of.get_mut(i) else {
                return Err(format!("a reference to word {i} of {}", self.words.len()));
            };
            if *known != 0 && u32::from(*known) != level {
                return Err(format!("the node at {i} is on two levels"));
            }
            let is_new = *known == 0;
            *known = level as u8;
            if level == 1 {
                if self.words.len() < i + 2 * self.planes as usize {
                    return Err(format!("the brick at {i} is cut short"));
                }
                if at.has(Ref::VEGETATION) != (self.solid(i) != 0) {
                    return Err(format!("the reference to the brick at {i} is mistaken in it"));
                }
                if at.flags() == 0 && (0..self.planes).all(|plane| self.plane(i, plane) == 0) {
                    return Err(format!("the brick at {i} holds nothing"));
                }
                continue;
            }
            if !is_new {
                continue;
            }
            if self.words.len() < i + 2 {
                return Err(format!("the node at {i} is cut short"));
            }
            let mask = self.mask(i);
            let end = i + 2 + mask.count_ones() as usize;
            let Some(children) = self.words.get(i + 2..end) else {
                return Err(format!("the node at {i} is cut short"));
            };
            if mask == 0 {
                return Err(format!("the node at {i} has no child"));
            }
            for &child in children {
                if Ref(child).index() >= i {
                    return Err(format!("the node at {i} refers to a later one"));
                }
                open.push((Ref(child), level - 1));
            }
        }
        Ok(())
    }

    /// Bytes held.
    pub fn memory_bytes(&self) -> usize {
        size_of::<Self>() + 4 * self.words.capacity()
    }
}

/// Builds a [`Dag`] from below. What is equal is given the same reference.
#[derive(Debug)]
pub(super) struct Builder {
    words: Vec<u32>,
    /// Where bricks and nodes are, and how long.
    known: [HashTable<(u32, u32)>; 2],
    planes: u32,
    /// Bricks that were asked for, equal ones and all.
    pub bricks: u64,
}

fn hash(words: &[u32]) -> u64 {
    let mut h = words.len() as u64;
    for &word in words {
        h = (h ^ u64::from(word)).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        h ^= h >> 29;
    }
    h.wrapping_mul(0xbf58_476d_1ce4_e5b9) ^ h >> 32
}

impl Builder {
    pub fn new(planes: u32) -> Builder {
        Builder { words: Vec::new(), known: Default::default(), planes, bricks: 0 }
    }

    fn keep(&mut self, new: &[u32], is_node: bool) -> Result<u32> {
        let Builder { words, known, .. } = self;
        let known = &mut known[usize::from(is_node)];
        let key = hash(new);
        let slice = |&(at, length): &(u32, u32)| &words[at as usize..(at + length) as usize];
        if let Some((at, _)) = known.find(key, |entry| slice(entry) == new) {
            return Ok(*at);
        }
        let at = words.len();
        if at + new.len() > Ref::MOST {
            return Err(Error::new("the landscape has too many different voxels")
                .remedy("give a larger --voxel or a smaller area"));
        }
        let entry = (at as u32, new.len() as u32);
        known.insert_unique(key, entry, |entry| hash(slice(entry)));
        words.extend_from_slice(new);
        Ok(at as u32)
    }

    /// A brick of bit planes, the highest first; `flags` beside those that follow from it.
    pub fn brick(&mut self, planes: &[u64], flags: u32) -> Result<Ref> {
        debug_assert_eq!(planes.len() as u32, self.planes);
        self.bricks += 1;
        let mut words = [0; 2 * MOST_PLANES as usize];
        for (pair, plane) in words.chunks_exact_mut(2).zip(planes) {
            pair.copy_from_slice(&[*plane as u32, (*plane >> 32) as u32]);
        }
        let at = self.keep(&words[..2 * planes.len()], false)?;
        let solid = planes.first().is_some_and(|plane| *plane != 0);
        Ok(Ref(at | flags | if solid { Ref::VEGETATION } else { 0 }))
    }

    /// A node over children by slot; `None` without any.
    pub fn node(&mut self, children: &[Option<Ref>; 64]) -> Result<Option<Ref>> {
        let mut words = [0u32; 66];
        let (mut mask, mut length, mut flags) = (0u64, 2, 0);
        for (slot, child) in children.iter().enumerate() {
            if let Some(child) = child {
                mask |= 1 << slot;
                words[length] = child.0;
                length += 1;
                flags |= child.flags();
            }
        }
        if mask == 0 {
            return Ok(None);
        }
        words[0] = mask as u32;
        words[1] = (mask >> 32) as u32;
        Ok(Some(Ref(self.keep(&words[..length], true)? | flags)))
    }

    /// Puts nodes of one level, each with its indices on that level, under one root.
    pub fn root(mut self, mut level: u32, mut nodes: Vec<([u32; 3], Ref)>) -> Result<Dag> {
        while nodes.len() > 1 || nodes.iter().any(|(index, _)| *index != [0; 3]) {
            nodes = self.above(nodes)?;
            level += 1;
        }
        let root = nodes.first().map(|(_, node)| *node);
        self.words.shrink_to_fit();
        Ok(Dag { words: self.words, root, levels: level, planes: self.planes })
    }

    fn above(&mut self, mut nodes: Vec<([u32; 3], Ref)>) -> Result<Vec<([u32; 3], Ref)>> {
        let up = |index: [u32; 3]| index.map(|i| i >> BITS);
        nodes.sort_unstable_by_key(|(index, _)| (up(*index), *index));
        let mut above = Vec::new();
        for siblings in nodes.chunk_by(|a, b| up(a.0) == up(b.0)) {
            let mut children = [None; 64];
            for ([x, y, z], child) in siblings {
                children[slot(*x, *y, *z) as usize] = Some(*child);
            }
            if let Some(node) = self.node(&children)? {
                above.push((up(siblings[0].0), node));
            }
        }
        Ok(above)
    }
}
