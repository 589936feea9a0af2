//! A stand with known truth, and the scan and photo that a survey of it would give. Knows nothing
//! of reconstruction.
//!
//! - [`stand`] plants trees on closed-form terrain.
//! - [`scan`] flies a laser scanner over it, [`photo`] a camera.
//! - [`compare`] sets what somebody found beside the truth.

mod camera;
mod planting;
mod relief;
mod scanner;
mod shape;
mod truth;

pub use camera::{PhotoOptions, photo};
pub use planting::{Stand, StandOptions, TrueTree, stand};
pub use relief::{Landform, Relief};
pub use scanner::{ScannerOptions, scan};
pub use truth::{Comparison, FoundTree, Window, compare};
