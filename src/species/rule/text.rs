//! Where each character of a TOML string stands in its file.

use std::ops::Range;

use crate::species::node::{Place, Sources};

/// The decoded text of a string with the place of its characters.
pub struct Text<'a> {
    pub text: &'a str,
    place: Place,
    /// Source offset of each byte of `text` and of its end; empty if unknown.
    offsets: Vec<usize>,
    /// A control character that the file writes as an escape.
    pub escaped_control: Option<(Range<usize>, char)>,
}

impl<'a> Text<'a> {
    /// `text`: the decoded value of the string at `place`, quotes included.
    pub fn new(text: &'a str, place: &Place, sources: &Sources) -> Self {
        let raw =
            sources.0.get(place.source).and_then(|s| s.text.get(place.span.clone())).unwrap_or("");
        let offsets = match decode(raw) {
            Some((decoded, offsets)) if decoded == text => {
                offsets.into_iter().map(|o| o + place.span.start).collect()
            }
            _ => Vec::new(),
        };
        let is_escape = |at: usize| {
            let start = offsets.get(at).and_then(|o| o.checked_sub(place.span.start));
            start.is_some_and(|s| raw.as_bytes().get(s) == Some(&b'\\'))
        };
        let escaped_control = text
            .char_indices()
            .find(|(at, c)| c.is_control() && is_escape(*at))
            .map(|(at, c)| (at..at + c.len_utf8(), c));
        Text { text, place: place.clone(), offsets, escaped_control }
    }

    /// The place of bytes of the decoded text; the whole string where that is unknown.
    pub fn place(&self, span: Range<usize>) -> Place {
        match (self.offsets.get(span.start), self.offsets.get(span.end)) {
            (Some(&start), Some(&end)) => {
                Place { source: self.place.source, span: start..end.max(start) }
            }
            _ => self.place.clone(),
        }
    }
}

/// Decodes a TOML string with its quotes, noting where each byte came from.
fn decode(raw: &str) -> Option<(String, Vec<usize>)> {
    let (quote, is_long) = ["'''", "\"\"\"", "'", "\""]
        .into_iter()
        .find(|q| raw.starts_with(q) && raw.len() >= 2 * q.len())
        .map(|q| (q, q.len() == 3))?;
    let is_literal = quote.starts_with('\'');
    let body_end = raw.len() - quote.len();
    let mut at = quote.len();
    if is_long {
        at += ["\r\n", "\n"].iter().find(|n| raw[at..].starts_with(*n)).map_or(0, |n| n.len());
    }
    let mut decoded = String::new();
    let mut offsets = Vec::new();
    while at < body_end {
        let c = raw.get(at..)?.chars().next()?;
        let (value, width) = if c == '\\' && !is_literal {
            let next = raw.get(at + 1..)?.chars().next()?;
            match next {
                'b' => (Some('\u{8}'), 2),
                't' => (Some('\t'), 2),
                'n' => (Some('\n'), 2),
                'f' => (Some('\u{c}'), 2),
                'r' => (Some('\r'), 2),
                'e' => (Some('\u{1b}'), 2),
                '"' | '\\' => (Some(next), 2),
                'x' | 'u' | 'U' => {
                    let width = match next {
                        'x' => 2,
                        'u' => 4,
                        _ => 8,
                    };
                    let digits = raw.get(at + 2..at + 2 + width)?;
                    (Some(char::from_u32(u32::from_str_radix(digits, 16).ok()?)?), 2 + width)
                }
                c if c.is_whitespace() => {
                    let rest = raw.get(at + 1..)?;
                    (None, 1 + rest.len() - rest.trim_start().len())
                }
                _ => return None,
            }
        } else if c == '\r' && raw.get(at + 1..)?.starts_with('\n') {
            (Some('\n'), 2)
        } else {
            (Some(c), c.len_utf8())
        };
        if let Some(value) = value {
            offsets.extend(std::iter::repeat_n(at, value.len_utf8()));
            decoded.push(value);
        }
        at += width;
    }
    offsets.push(at);
    Some((decoded, offsets))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn decodes_as_toml_does() {
        for raw in [
            r"'F(a) -> [^F]'",
            r#""a\\b\tc\u0041\n""#,
            "'''\nab\ncd'''",
            "\"\"\"a \\\n   b\"\"\"",
            "\"→é\"",
            "''",
        ] {
            let (decoded, offsets) = decode(raw).unwrap();
            let toml: toml::Table = format!("v = {raw}").parse().unwrap();
            assert_eq!(toml["v"].as_str(), Some(decoded.as_str()), "{raw}");
            assert_eq!(offsets.len(), decoded.len() + 1);
        }
        let (decoded, offsets) = decode(r#""a\\b""#).unwrap();
        assert_eq!(decoded, r"a\b");
        assert_eq!(offsets, [1, 2, 4, 5]);
    }
}
