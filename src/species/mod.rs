//! Rule files to [`Species`]; the species of each crown from its returns and a photo; stem diameter
//! and biomass of a tree of that species. Knows nothing of geometry.
//!
//! A rule file is TOML. `extends = "table3/13"` lays it over another file, key by key within each
//! section; what no file says comes from `defaults.toml`. Names (`name`, `common`) are each
//! file's own. The `[rule]` section is compiled by [`rule`].

pub mod allometry;
pub mod assign;
mod builtin;
mod check;
pub mod kind;
mod load;
pub mod look;
#[cfg(test)]
mod messages;
pub mod model;
mod near;
mod node;
pub mod own;
mod own_bark;
pub mod photo;
pub mod rule;
mod schema;
pub mod state;
mod template;
mod young;

pub use load::{Listed, builtin_names, files, list, load, load_text, sections};
pub use model::Species;
pub use rule::Rule;
pub use schema::schema;
pub use template::{BASE as TEMPLATE_BASE, template};
