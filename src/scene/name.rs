//! Names that every format takes: `[A-Za-z_][A-Za-z0-9_]*`.

use any_ascii::any_ascii_char;

/// Whether `name` may name a thing of a scene.
pub fn is_identifier(name: &str) -> bool {
    !name.starts_with(|c: char| c.is_ascii_digit())
        && !name.is_empty()
        && name.bytes().all(|b| b.is_ascii_alphanumeric() || b == b'_')
}

/// The nearest legal name: letters of other scripts are written in Latin ones, other characters become `_`,
/// and a leading digit gets one in front.
pub fn identifier(text: &str) -> String {
    let legal = |c: char| if c.is_ascii_alphanumeric() { c } else { '_' };
    let mut name = String::with_capacity(text.len());
    for c in text.chars() {
        match any_ascii_char(c) {
            "" => name.push('_'),
            // Apostrophes and soft signs are no letters.
            latin => name.extend(latin.chars().filter(|c| *c != '\'').map(legal)),
        }
    }
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
        assert_eq!(identifier("Ель сибирская"), "El_sibirskaya");
        assert_eq!(identifier("Fougère — É, 樺"), "Fougere___E__Hua");
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
