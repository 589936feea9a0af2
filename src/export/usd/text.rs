//! Writes the nesting and the arrays of a .usda file into one buffer. Numbers are the shortest
//! that read back as the same f32.

use std::io::Write;

use glam::{Vec2, Vec3};
use rayon::prelude::*;

/// Arrays longer than this are formatted in blocks of it, in parallel.
const BLOCK: usize = 1 << 14;

pub(super) struct Text {
    out: Vec<u8>,
    depth: usize,
}

impl Text {
    pub fn new() -> Self {
        Text { out: Vec::new(), depth: 0 }
    }

    pub fn into_bytes(self) -> Vec<u8> {
        self.out
    }

    fn indent(&mut self) {
        self.out.resize(self.out.len() + 4 * self.depth, b' ');
    }

    pub fn line(&mut self, text: &str) {
        self.indent();
        self.out.extend(text.as_bytes());
        self.out.push(b'\n');
    }

    pub fn blank(&mut self) {
        self.out.push(b'\n');
    }

    /// Opens a prim with its metadata, a line each.
    pub fn open(&mut self, definition: &str, metadata: &[&str]) {
        if metadata.is_empty() {
            self.line(definition);
        } else {
            self.open_with(&format!("{definition} ("));
            for line in metadata {
                self.line(line);
            }
            self.close_with(")");
        }
        self.open_with("{");
    }

    pub fn close(&mut self) {
        self.close_with("}");
    }

    pub fn open_with(&mut self, text: &str) {
        self.line(text);
        self.depth += 1;
    }

    pub fn close_with(&mut self, text: &str) {
        self.depth = self.depth.saturating_sub(1);
        self.line(text);
    }

    /// `declaration = [items]`, with its interpolation if it is a primvar.
    pub fn array<T: Sync>(
        &mut self,
        declaration: &str,
        items: &[T],
        write: impl Fn(&mut Vec<u8>, &T) + Sync,
        interpolation: Option<&str>,
    ) {
        self.start_array(declaration);
        if items.len() <= BLOCK {
            join(&mut self.out, items, &write);
        } else {
            let block = |items: &[T]| {
                let mut out = Vec::new();
                join(&mut out, items, &write);
                out
            };
            let blocks: Vec<Vec<u8>> = items.par_chunks(BLOCK).map(block).collect();
            self.out.reserve(blocks.iter().map(|b| b.len() + 2).sum());
            for (at, block) in blocks.iter().enumerate() {
                if at > 0 {
                    self.out.extend(b", ");
                }
                self.out.extend(block);
            }
        }
        self.end_array(interpolation);
    }

    /// `declaration = [item, item, …]`.
    pub fn repeated(&mut self, declaration: &str, item: &str, count: usize) {
        self.start_array(declaration);
        for at in 0..count {
            if at > 0 {
                self.out.extend(b", ");
            }
            self.out.extend(item.as_bytes());
        }
        self.end_array(None);
    }

    fn start_array(&mut self, declaration: &str) {
        self.indent();
        self.out.extend(declaration.as_bytes());
        self.out.extend(b" = [");
    }

    fn end_array(&mut self, interpolation: Option<&str>) {
        self.out.extend(b"]");
        if let Some(interpolation) = interpolation {
            self.out.extend(b" (\n");
            self.depth += 1;
            self.line(&format!("interpolation = \"{interpolation}\""));
            self.close_with(")");
        } else {
            self.out.push(b'\n');
        }
    }

    pub fn int(out: &mut Vec<u8>, value: &u32) {
        // A Vec takes every write.
        let _ = write!(out, "{value}");
    }

    pub fn float(out: &mut Vec<u8>, value: &f32) {
        // `+ 0.0` takes the sign off a zero.
        let _ = write!(out, "{}", value + 0.0);
    }

    /// `(a, b, …)`.
    pub fn floats(out: &mut Vec<u8>, values: &[f32]) {
        out.push(b'(');
        join(out, values, &Text::float);
        out.push(b')');
    }

    pub fn vec2(out: &mut Vec<u8>, value: &Vec2) {
        Text::floats(out, &value.to_array());
    }

    pub fn vec3(out: &mut Vec<u8>, value: &Vec3) {
        Text::floats(out, &value.to_array());
    }
}

fn join<T>(out: &mut Vec<u8>, items: &[T], write: &impl Fn(&mut Vec<u8>, &T)) {
    for (at, item) in items.iter().enumerate() {
        if at > 0 {
            out.extend(b", ");
        }
        write(out, item);
    }
}

/// A string literal.
pub(super) fn quoted(text: &str) -> String {
    let mut literal = String::with_capacity(text.len() + 2);
    literal.push('"');
    for c in text.chars() {
        match c {
            '"' | '\\' => literal.extend(['\\', c]),
            '\n' => literal.push_str("\\n"),
            '\r' => literal.push_str("\\r"),
            '\t' => literal.push_str("\\t"),
            c if c.is_ascii_control() => literal.push_str(&format!("\\x{:02x}", c as u32)),
            c => literal.push(c),
        }
    }
    literal.push('"');
    literal
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn nesting_arrays_and_strings() {
        let mut text = Text::new();
        text.open("def Mesh \"a\"", &["kind = \"component\""]);
        text.array("int[] n", &[1, 20, 300], Text::int, None);
        text.repeated("int[] counts", "3", 3);
        text.array("float2[] st", &[Vec2::new(-0.0, 0.1)], Text::vec2, Some("vertex"));
        text.close();
        let expected = "def Mesh \"a\" (\n    kind = \"component\"\n)\n{\n    int[] n = [1, 20, 300]\n    \
                        int[] counts = [3, 3, 3]\n    float2[] st = [(0, 0.1)] (\n        \
                        interpolation = \"vertex\"\n    )\n}\n";
        assert_eq!(String::from_utf8(text.into_bytes()).unwrap(), expected);
        assert_eq!(quoted("a\"b\\c\nd\u{1}е"), "\"a\\\"b\\\\c\\nd\\x01е\"");
    }

    #[test]
    fn arrays_longer_than_a_block_are_joined_without_a_seam() {
        let items: Vec<u32> = (0..2 * BLOCK as u32 + 5).collect();
        let mut text = Text::new();
        text.array("int[] n", &items, Text::int, None);
        let plain: Vec<String> = items.iter().map(u32::to_string).collect();
        let expected = format!("int[] n = [{}]\n", plain.join(", "));
        assert_eq!(String::from_utf8(text.into_bytes()).unwrap(), expected);
    }

    proptest! {
        #[test]
        fn numbers_read_back_as_the_same(bits: u32) {
            let value = f32::from_bits(bits);
            prop_assume!(value.is_finite());
            let mut out = Vec::new();
            Text::float(&mut out, &value);
            let read: f32 = std::str::from_utf8(&out).unwrap().parse().unwrap();
            prop_assert_eq!(read, value);
        }
    }
}
