//! The command line: arguments as typed to resolved jobs, progress, messages. Knows no algorithm.

mod args;

use std::process::ExitCode;

use clap::Parser;

/// Runs the program; exit code 0 only when the output is whole.
pub fn run() -> ExitCode {
    let _ = args::Cli::parse();
    ExitCode::SUCCESS
}
