use std::process::ExitCode;

/// Counts the heap, so that reports can state the peak of each stage.
#[global_allocator]
static ALLOCATOR: larix::heap::Counted = larix::heap::Counted;

fn main() -> ExitCode {
    larix::export::survive_file_limits();
    larix::cli::run()
}
