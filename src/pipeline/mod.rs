//! The stages in their order: the only room that knows every stage. Knows nothing of the command
//! line; takes resolved jobs, gives values, and records what each stage did.

mod budget;
mod coarsest;
pub mod cover;
pub mod demo;
pub mod detail;
mod drape;
pub mod effort;
mod figure;
mod fit;
pub mod floor;
pub mod forest;
pub mod goal;
mod hung;
mod impostors;
mod kept;
pub mod landscape;
pub mod left_out;
pub mod level_table;
pub mod levels;
mod light;
pub mod measure;
pub mod model;
pub mod paint;
pub mod rules;
pub mod sheet;
mod skeletons;
pub mod survey;
mod tiled;
mod told;
mod tolerance;
pub mod tree;
pub mod view;

pub use detail::WoodJob;
pub use effort::Effort;
pub use forest::{Forest, ForestJob, Sharing};
pub use levels::LevelsJob;
pub use sheet::{Sheet, SheetJob};
pub use survey::{Survey, SurveyJob};
pub use tree::{Asked, TreeJob};
