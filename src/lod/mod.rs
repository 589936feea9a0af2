//! Coarser forms of a tree and how far each is from the finest: silhouettes, impostors, and the
//! hull that engines collide with. Knows nothing of skeletons and files.

pub mod collision;
pub mod impostor;
mod light;
pub mod silhouette;
pub mod stored;

pub use impostor::{Impostor, Kind};
pub use silhouette::{Cover, Silhouettes, Views, looks};

#[cfg(test)]
mod tests;
