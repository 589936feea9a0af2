//! Counters of work done, one a kind and process, so that what was left out can be seen not to have
//! been done. Counted where the work is, once a call. Knows nothing.

use std::sync::atomic::{AtomicU64, Ordering};

/// Work that a run can do without.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Work {
    /// Pixels of bark and leaf pictures drawn.
    TexturePixels,
    /// Samples of the photo taken for the terrain.
    PhotoSamples,
    /// Nodes whose movement in the wind was worked out.
    WindNodes,
    /// Tangents of vertices.
    Tangents,
    /// Coarser forms meshed.
    CoarserForms,
    /// Models pictured as impostors.
    Impostors,
    /// Models given bodies for collisions.
    Colliders,
    /// Silhouettes drawn to be measured.
    Silhouettes,
    /// Trees looked for from a camera.
    TreesLookedFor,
}

impl Work {
    pub const ALL: [Work; 9] = [
        Work::TexturePixels,
        Work::PhotoSamples,
        Work::WindNodes,
        Work::Tangents,
        Work::CoarserForms,
        Work::Impostors,
        Work::Colliders,
        Work::Silhouettes,
        Work::TreesLookedFor,
    ];

    pub fn name(self) -> &'static str {
        match self {
            Work::TexturePixels => "texture pixels",
            Work::PhotoSamples => "photo samples",
            Work::WindNodes => "wind nodes",
            Work::Tangents => "tangents",
            Work::CoarserForms => "coarser forms",
            Work::Impostors => "impostors",
            Work::Colliders => "colliders",
            Work::Silhouettes => "silhouettes",
            Work::TreesLookedFor => "trees looked for",
        }
    }
}

static DONE: [AtomicU64; Work::ALL.len()] = [const { AtomicU64::new(0) }; Work::ALL.len()];

/// Adds to what this process has done.
pub fn count(work: Work, amount: usize) {
    DONE[work as usize].fetch_add(amount as u64, Ordering::Relaxed);
}

/// What this process has done of each kind, in the order of [`Work::ALL`].
pub fn done() -> [u64; Work::ALL.len()] {
    std::array::from_fn(|k| DONE[k].load(Ordering::Relaxed))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn kinds_are_in_the_order_of_their_list() {
        for (k, work) in Work::ALL.into_iter().enumerate() {
            assert_eq!(work as usize, k, "{}", work.name());
        }
    }

    #[test]
    fn what_is_counted_is_told() {
        let before = done()[Work::TreesLookedFor as usize];
        count(Work::TreesLookedFor, 7);
        assert!(done()[Work::TreesLookedFor as usize] >= before + 7);
    }
}
