use std::process::ExitCode;

/// Counts the heap, so that reports can state the peak of each stage.
#[global_allocator]
static ALLOCATOR: peak_alloc::PeakAlloc = peak_alloc::PeakAlloc;

/// Grids and columns come and go with every stage: kept between them, their pages are not mapped
/// and cleared anew each time.
#[cfg(target_env = "gnu")]
fn keep_freed_memory() {
    const MIB: libc::c_int = 1 << 20;
    // SAFETY: called before any other thread runs; the values are in mallopt's range.
    unsafe {
        libc::mallopt(libc::M_MMAP_THRESHOLD, 32 * MIB);
        libc::mallopt(libc::M_TRIM_THRESHOLD, 256 * MIB);
        libc::mallopt(libc::M_TOP_PAD, 16 * MIB);
    }
}

fn main() -> ExitCode {
    #[cfg(target_env = "gnu")]
    keep_freed_memory();
    larix::cli::run()
}
