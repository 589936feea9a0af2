//! A stand with known truth, and the scan and photo that a survey of it would give. Knows nothing
//! of reconstruction.
//!
//! Trees are surfaces of revolution after their species' crown profile, lobed, and filled with
//! leaves that stop light by an exponential law. What is not modelled: branches, wind, the
//! pulse's waveform, buildings and water.

mod crown;
mod photo;
mod relief;
mod scanner;
mod stand;
pub mod truth;

pub use photo::{PhotoOptions, photo};
pub use relief::Relief;
pub use scanner::{ScannerOptions, scan};
pub use stand::{Stand, StandOptions, TrueTree, stand};
pub use truth::{Comparison, FoundTree, compare, terrain_error};

#[cfg(test)]
mod tests;
