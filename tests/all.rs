//! What the program does as a whole, by subject: one binary, for each would link the library again.
//! `cargo test --test all tiles` runs the tests of one.

mod abop;
mod budgets;
mod cli;
mod corpus;
mod crown_plots;
mod directions;
mod effort;
mod habits;
mod landscape;
mod readme;
mod report;
mod rule_guide;
mod simulated_stands;
mod species_cli;
mod species_plots;
mod species_simulated;
mod terrain_accuracy;
mod tiles;
