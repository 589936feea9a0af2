//! Names that every format takes: `[A-Za-z_][A-Za-z0-9_]*`.

/// Whether `name` may name a thing of a scene.
pub fn is_identifier(name: &str) -> bool {
    !name.starts_with(|c: char| c.is_ascii_digit())
        && !name.is_empty()
        && name.bytes().all(|b| b.is_ascii_alphanumeric() || b == b'_')
}

/// The nearest legal name: other characters become `_`, and a leading digit gets one in front.
pub fn identifier(text: &str) -> String {
    let mut name: String =
        text.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '_' }).collect();
    if !name.starts_with(|c: char| !c.is_ascii_digit()) {
        name.insert(0, '_');
    }
    name
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn makes_legal_names() {
        assert_eq!(identifier("Larix sibirica"), "Larix_sibirica");
        assert_eq!(identifier("3 pines"), "_3_pines");
        assert_eq!(identifier(""), "_");
        assert!(!is_identifier("") && !is_identifier("3a") && !is_identifier("a b"));
        assert!(!is_identifier("ель"));
    }

    proptest! {
        #[test]
        fn any_text_gives_a_legal_name_and_legal_names_stay(text in ".*") {
            let name = identifier(&text);
            prop_assert!(is_identifier(&name));
            prop_assert_eq!(identifier(&name), name);
        }
    }
}
