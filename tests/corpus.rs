//! The committed corpus of the fuzz target, replayed.

#[path = "../fuzz/rule_file.rs"]
mod body;

#[test]
fn every_text_of_the_corpus_is_survived() {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/fuzz/corpus/rule_file");
    let mut count = 0;
    for entry in std::fs::read_dir(folder).unwrap() {
        let bytes = std::fs::read(entry.unwrap().path()).unwrap();
        body::survives(&String::from_utf8_lossy(&bytes));
        count += 1;
    }
    assert!(count >= 9);
}
