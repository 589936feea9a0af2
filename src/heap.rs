//! The heap: how much of it is held and was held at most.

use std::alloc::{GlobalAlloc, Layout};
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};

use mimalloc::MiMalloc;

static HELD: AtomicUsize = AtomicUsize::new(0);
static MOST: AtomicUsize = AtomicUsize::new(0);

/// Mimalloc, counting. Columns and meshes come and go on every thread: it keeps their pages for a while,
/// where the system's allocator maps and clears them anew. Without huge pages: most blocks are small, and the
/// system would clear two megabytes where one of them begins.
///
/// A program makes it the `#[global_allocator]`; without it nothing is counted.
pub struct Counted;

fn grow(bytes: usize) {
    let held = HELD.fetch_add(bytes, Relaxed) + bytes;
    if MOST.load(Relaxed) < held {
        MOST.fetch_max(held, Relaxed);
    }
}

fn shrink(bytes: usize) {
    HELD.fetch_sub(bytes, Relaxed);
}

// SAFETY: every call is the allocator's own with the caller's arguments; what is counted beside it
// touches no block.
unsafe impl GlobalAlloc for Counted {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        // SAFETY: the caller's duty.
        let block = unsafe { MiMalloc.alloc(layout) };
        if !block.is_null() {
            grow(layout.size());
        }
        block
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        // SAFETY: the caller's duty.
        let block = unsafe { MiMalloc.alloc_zeroed(layout) };
        if !block.is_null() {
            grow(layout.size());
        }
        block
    }

    unsafe fn dealloc(&self, block: *mut u8, layout: Layout) {
        // SAFETY: the caller's duty.
        unsafe { MiMalloc.dealloc(block, layout) };
        shrink(layout.size());
    }

    unsafe fn realloc(&self, block: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        // SAFETY: the caller's duty.
        let moved = unsafe { MiMalloc.realloc(block, layout, size) };
        if !moved.is_null() {
            match size.checked_sub(layout.size()) {
                Some(more) => grow(more),
                None => shrink(layout.size() - size),
            }
        }
        moved
    }
}

/// Bytes held now; 0 where [`Counted`] is not the allocator.
pub fn held_bytes() -> u64 {
    HELD.load(Relaxed) as u64
}

/// Bytes held at most since the last [`forget_most`].
pub fn most_bytes() -> u64 {
    MOST.load(Relaxed) as u64
}

/// From now on only what is held now and later counts for [`most_bytes`].
pub fn forget_most() {
    MOST.store(HELD.load(Relaxed), Relaxed);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blocks_keep_their_bytes_and_are_counted() {
        // The counters are of the whole process: other tests change them by less than this.
        const MUCH: usize = 1 << 30;
        let layout = Layout::from_size_align(MUCH, 16).expect("a power of two");
        let before = held_bytes();
        // SAFETY: each block is used within its size and given back with its layout.
        unsafe {
            let block = Counted.alloc_zeroed(layout);
            assert!(!block.is_null());
            assert_eq!((*block, *block.add(MUCH - 1)), (0, 0));
            block.write(7);
            assert!(held_bytes() >= before + MUCH as u64);
            let block = Counted.realloc(block, layout, 4096);
            assert_eq!(*block, 7);
            assert!(held_bytes() < before + MUCH as u64 / 2);
            assert!(most_bytes() >= before + MUCH as u64);
            Counted.dealloc(block, Layout::from_size_align(4096, 16).expect("a power of two"));
        }
        forget_most();
        assert!(most_bytes() < before + MUCH as u64 / 2);
    }
}
