//! Elements and attributes as text; long lists go to [`Blocks`].

use std::io;

use super::super::blocks::Blocks;
use super::super::number;

pub(super) struct Xml<'a> {
    blocks: Blocks<'a>,
    text: String,
    depth: usize,
}

type Attributes<'t> = [(&'t str, &'t str)];

impl<'a> Xml<'a> {
    pub fn new(blocks: Blocks<'a>) -> Self {
        Xml { blocks, text: String::new(), depth: 0 }
    }

    pub fn line(&mut self, text: &str) {
        self.text.extend(std::iter::repeat_n(' ', self.depth));
        self.text.push_str(text);
        self.text.push('\n');
    }

    pub fn open(&mut self, name: &str, attributes: &Attributes<'_>) {
        self.begin(name, attributes);
        self.text.push_str(">\n");
        self.depth += 1;
    }

    /// An element without content.
    pub fn empty(&mut self, name: &str, attributes: &Attributes<'_>) {
        self.begin(name, attributes);
        self.text.push_str("/>\n");
    }

    pub fn close(&mut self, name: &str) {
        self.depth = self.depth.saturating_sub(1);
        self.line(&format!("</{name}>"));
    }

    /// An element without content, whose attribute `list` holds the items, a line each.
    pub fn list<T: Sync>(
        &mut self,
        name: &str,
        list: &str,
        items: &'a [T],
        write: impl Fn(&mut number::Pen, &T) + Copy + Send + Sync + 'a,
    ) -> io::Result<()> {
        self.begin_list(name, &[], list, items, write)?;
        self.text.push_str("/>\n");
        Ok(())
    }

    /// As [`Xml::list`], with content.
    pub fn open_list<T: Sync>(
        &mut self,
        name: &str,
        attributes: &Attributes<'_>,
        list: &str,
        items: &'a [T],
        write: impl Fn(&mut number::Pen, &T) + Copy + Send + Sync + 'a,
    ) -> io::Result<()> {
        self.begin_list(name, attributes, list, items, write)?;
        self.text.push_str(">\n");
        self.depth += 1;
        Ok(())
    }

    fn begin_list<T: Sync>(
        &mut self,
        name: &str,
        attributes: &Attributes<'_>,
        list: &str,
        items: &'a [T],
        write: impl Fn(&mut number::Pen, &T) + Copy + Send + Sync + 'a,
    ) -> io::Result<()> {
        self.begin(name, attributes);
        self.text.push(' ');
        self.text.push_str(list);
        self.text.push_str("=\"");
        self.pass_on()?;
        let line = move |out: &mut number::Pen, item: &T| {
            write(out, item);
            out.push(b'\n');
        };
        self.blocks.rows(items, line)?;
        self.text.push('"');
        Ok(())
    }

    fn begin(&mut self, name: &str, attributes: &Attributes<'_>) {
        self.text.extend(std::iter::repeat_n(' ', self.depth));
        self.text.push('<');
        self.text.push_str(name);
        for (name, value) in attributes {
            // A list of strings stays readable between single quotes.
            let quote = if value.contains('"') { '\'' } else { '"' };
            self.text.push(' ');
            self.text.push_str(name);
            self.text.push('=');
            self.text.push(quote);
            escape(&mut self.text, value, quote);
            self.text.push(quote);
        }
    }

    /// What was written so far, on its way to the disk.
    pub fn pass_on(&mut self) -> io::Result<()> {
        self.blocks.text(&self.text)?;
        self.text.clear();
        Ok(())
    }

    pub fn finish(mut self) -> io::Result<()> {
        self.pass_on()?;
        self.blocks.finish()
    }
}

/// A character that XML can't hold becomes U+FFFD.
fn escape(out: &mut String, text: &str, quote: char) {
    for c in text.chars() {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '"' if quote == '"' => out.push_str("&quot;"),
            '\'' if quote == '\'' => out.push_str("&apos;"),
            '\t' | '\n' | '\r' => out.push_str(&format!("&#{};", c as u32)),
            '\0'..' ' | '\u{fffe}' | '\u{ffff}' => out.push('\u{fffd}'),
            c => out.push(c),
        }
    }
}

/// A list of strings as an attribute holds them.
pub(super) fn strings(items: &[&str]) -> String {
    let quoted = |s: &&str| format!("\"{}\"", s.replace('\\', "\\\\").replace('"', "\\\""));
    items.iter().map(quoted).collect::<Vec<_>>().join(" ")
}

pub(super) fn numbers(values: &[f32]) -> String {
    let mut out = number::Pen::new();
    number::shortest_of(&mut out, values);
    String::from_utf8_lossy(out.as_bytes()).into_owned()
}

#[cfg(test)]
mod tests {
    use super::super::super::blocks;
    use super::*;

    #[test]
    fn elements_attributes_and_lists() {
        let mut sink = io::Cursor::new(Vec::new());
        blocks::through(&mut sink, |blocks| {
            let mut xml = Xml::new(blocks);
            xml.open("A", &[("b", "1 < 2 & 'x'"), ("c", &strings(&["d \"e\" \\f", "it's"]))]);
            xml.empty("B", &[("t", "a\tb\u{1}é")]);
            let write = |out: &mut number::Pen, n: &u32| number::integer(out, i64::from(*n));
            xml.open_list("C", &[("d", &numbers(&[-0.0, 0.5]))], "e", &[1, 20], write)?;
            xml.list("D", "f", &[3], write)?;
            xml.close("C");
            xml.close("A");
            xml.finish()
        })
        .unwrap();
        let expected = "<A b=\"1 &lt; 2 &amp; 'x'\" c='\"d \\\"e\\\" \\\\f\" \"it&apos;s\"'>\n \
                        <B t=\"a&#9;b\u{fffd}é\"/>\n <C d=\"0 0.5\" e=\"1\n20\n\">\n  \
                        <D f=\"3\n\"/>\n </C>\n</A>\n";
        assert_eq!(String::from_utf8(sink.into_inner()).unwrap(), expected);
    }
}
