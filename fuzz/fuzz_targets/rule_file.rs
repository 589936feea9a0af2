//! Whatever stands in a rule file, it is refused with an error or grows a sound scaffold.
#![no_main]

use libfuzzer_sys::fuzz_target;

#[path = "../rule_file.rs"]
mod body;

fuzz_target!(|text: &str| body::survives(text));
