use std::process::ExitCode;

/// Counts the heap, so that reports can state the peak of each stage.
#[global_allocator]
static ALLOCATOR: peak_alloc::PeakAlloc = peak_alloc::PeakAlloc;

fn main() -> ExitCode {
    larix::cli::run()
}
