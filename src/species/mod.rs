//! Rule files to [`Species`], and the species of each crown from a photo. Knows nothing of
//! geometry.

pub mod model;

pub use model::Species;
