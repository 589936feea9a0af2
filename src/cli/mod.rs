//! The command line: arguments as typed to resolved jobs, progress, messages. Knows no algorithm.

/// Writes a line to standard error. That nobody listens there is no reason to stop.
macro_rules! tell {
    ($($told:tt)*) => {{
        use std::io::Write as _;
        _ = writeln!(std::io::stderr(), $($told)*);
    }};
}

mod args;
mod commands;
mod jobs;
mod landscape;
mod paths;
mod progress;
mod report;
mod species;
mod told;
mod watch;

use std::process::ExitCode;

use clap::Parser;

use crate::diagnostic::{self, Error, Result};

/// Runs the program; exit code 0 only when the output is whole.
pub fn run() -> ExitCode {
    let cli = args::Cli::parse();
    match set_threads(cli.threads).and_then(|()| commands::run(&cli)) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            tell!("{}", diagnostic::render(&error).trim_end());
            ExitCode::FAILURE
        }
    }
}

fn set_threads(threads: Option<u16>) -> Result<()> {
    let Some(n) = threads else { return Ok(()) };
    rayon::ThreadPoolBuilder::new().num_threads(n.into()).build_global().map_err(|e| {
        Error::new(format!("{n} threads cannot be started: {e}")).remedy("give a smaller --threads")
    })
}
