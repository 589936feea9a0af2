//! "Did you mean …?"

/// Edits (insert, delete, replace, swap neighbours) that turn one word into the other, ignoring
/// case: the optimal string alignment distance.
fn distance(a: &str, b: &str) -> usize {
    let a: Vec<char> = a.chars().flat_map(char::to_lowercase).take(64).collect();
    let b: Vec<char> = b.chars().flat_map(char::to_lowercase).take(64).collect();
    let width = b.len() + 1;
    let mut table = vec![0usize; (a.len() + 1) * width];
    for i in 0..=a.len() {
        for j in 0..=b.len() {
            table[i * width + j] = if i == 0 || j == 0 {
                i + j
            } else {
                let differs = usize::from(a[i - 1] != b[j - 1]);
                let mut best = (table[(i - 1) * width + j] + 1)
                    .min(table[i * width + j - 1] + 1)
                    .min(table[(i - 1) * width + j - 1] + differs);
                if i > 1 && j > 1 && a[i - 1] == b[j - 2] && a[i - 2] == b[j - 1] {
                    best = best.min(table[(i - 2) * width + j - 2] + 1);
                }
                best
            };
        }
    }
    table[a.len() * width + b.len()]
}

/// The known word nearest to `word`, if it is near enough to be a slip.
pub fn nearest<'a, S: AsRef<str>>(word: &str, known: &'a [S]) -> Option<&'a str> {
    known
        .iter()
        .map(|k| (distance(word, k.as_ref()), k.as_ref()))
        .min_by_key(|(d, _)| *d)
        .filter(|(d, k)| *d <= 1 + k.chars().count() / 4 && *d < word.chars().count().max(1))
        .map(|(_, k)| k)
}

/// A remedy for an unknown word: the nearest known one, and otherwise the list.
pub fn suggest<S: AsRef<str>>(word: &str, known: &[S]) -> String {
    match nearest(word, known) {
        Some(near) => format!("did you mean `{near}`?"),
        None if known.is_empty() => "nothing is known here".into(),
        None => {
            let names: Vec<&str> = known.iter().map(AsRef::as_ref).collect();
            format!("known here: {}", names.join(", "))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn finds_slips_and_refuses_strangers() {
        let known = ["angles", "axiom", "iterations", "larix_sibirica"];
        assert_eq!(nearest("angels", &known), Some("angles"));
        assert_eq!(nearest("iteration", &known), Some("iterations"));
        assert_eq!(nearest("Larix_sibrica", &known), Some("larix_sibirica"));
        assert_eq!(nearest("oak", &known), None);
        assert_eq!(nearest("", &known), None);
    }
}
