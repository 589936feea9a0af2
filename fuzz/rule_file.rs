//! What the fuzz target does with one text; `tests/corpus.rs` does it with the corpus.

use larix::diagnostic::render;
use larix::seed::Seed;
use larix::skeleton::derive::{Inputs, derive};
use larix::skeleton::turtle::draw;
use larix::species::load_text;

/// # Panics
/// On a fault of the program: an error without a message, a scaffold that breaks its invariants.
pub fn survives(text: &str) {
    let species = match load_text("any", text) {
        Ok(species) => species,
        Err(error) => {
            assert!(error.count() > 0 && !render(&error).is_empty());
            assert!(error.labels_lie_within(), "{error:?}");
            return;
        }
    };
    let inputs = Inputs { module_limit: 10_000, ..Inputs::new(Seed::new(1)) };
    let Ok(string) = derive(&species.rule, &inputs) else { return };
    assert!(string.symbols.len() <= 10_000);
    let stats = string.stats(&species.rule);
    assert!(stats.draws <= stats.modules);
    assert!(!string.to_text(&species.rule).is_empty() || string.symbols.is_empty());
    if let Ok(scaffold) = draw(&species.rule, &string) {
        if let Err(fault) = scaffold.check() {
            panic!("{fault}");
        }
        assert!(scaffold.len() <= stats.nodes);
    }
}
