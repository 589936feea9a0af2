//! What a run did (`run`), and the report of many: what accuracy costs, what converges, what stays
//! stable, what is left out, how it grows (`document`), as numbers (`stats`), plots (`plot`) and one
//! page (`html`). Knows nothing of how stages work.

pub mod document;
pub mod html;
pub mod plot;
mod run;
pub mod stats;

pub use document::Document;
pub use run::{
    ErrorMeasure, Items, Observer, Outcome, Recorder, Silent, StageRecord, grouped, significant,
    table,
};
