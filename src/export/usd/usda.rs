//! A layer as OpenUSD text (.usda), laid out as OpenUSD itself lays it out. Numbers are the
//! shortest that read back as the same.

use std::io::{self, Write};

use crate::export::Sink;
use crate::export::blocks::{self, Blocks};
use crate::export::number::{Pen, integer, shortest};

use super::layer::{Content, Field, Layer, Prim, Property, Specifier, Value};

pub(super) fn write(layer: &Layer, out: &mut dyn Sink) -> io::Result<()> {
    blocks::through(out, |blocks| {
        let mut text = Text { out: blocks, depth: 0 };
        text.line("#usda 1.0")?;
        text.metadata("", &layer.metadata)?;
        for prim in &layer.prims {
            text.line("")?;
            text.prim(prim)?;
        }
        text.out.finish()
    })
}

struct Text<'l> {
    out: Blocks<'l>,
    depth: usize,
}

impl<'l> Text<'l> {
    fn indent(&mut self) -> io::Result<()> {
        for _ in 0..self.depth {
            self.out.write_all(b"    ")?;
        }
        Ok(())
    }

    fn line(&mut self, text: &str) -> io::Result<()> {
        if !text.is_empty() {
            self.indent()?;
        }
        writeln!(self.out, "{text}")
    }

    fn open(&mut self, text: &str) -> io::Result<()> {
        self.line(text)?;
        self.depth += 1;
        Ok(())
    }

    fn close(&mut self, text: &str) -> io::Result<()> {
        self.depth -= 1;
        self.line(text)
    }

    /// `head (`, a line each, `)`; the head alone where there is none.
    fn metadata(&mut self, head: &str, fields: &'l [Field<'l>]) -> io::Result<()> {
        if fields.is_empty() {
            return if head.is_empty() { Ok(()) } else { self.line(head) };
        }
        self.open(if head.is_empty() { "(".to_owned() } else { format!("{head} (") }.as_str())?;
        for (name, value) in fields {
            self.field(name, value)?;
        }
        self.close(")")
    }

    fn field(&mut self, name: &str, value: &'l Value<'l>) -> io::Result<()> {
        match value {
            Value::Dictionary(entries) => self.dictionary(name, entries),
            Value::Selections(chosen) => {
                self.open(&format!("{name} = {{"))?;
                for (set, variant) in chosen {
                    self.line(&format!("string {set} = {}", quoted(variant)))?;
                }
                self.close("}")
            }
            Value::Prepended(names) => {
                let names: Vec<String> = names.iter().map(|name| quoted(name)).collect();
                self.line(&format!("prepend {name} = [{}]", names.join(", ")))
            }
            Value::Arc(arc) => {
                self.line(&format!("prepend {name} = @{}@<{}>", arc.asset, arc.prim))
            }
            other => {
                self.indent()?;
                write!(self.out, "{name} = ")?;
                self.value(other)?;
                writeln!(self.out)
            }
        }
    }

    fn dictionary(
        &mut self,
        name: &str,
        entries: &'l [(std::borrow::Cow<'l, str>, Value<'l>)],
    ) -> io::Result<()> {
        self.open(&format!("{name} = {{"))?;
        for (key, value) in entries {
            match value {
                Value::Dictionary(inner) => self.dictionary(&format!("dictionary {key}"), inner)?,
                other => self.field(&format!("{} {key}", type_of(other)), other)?,
            }
        }
        self.close("}")
    }

    fn prim(&mut self, prim: &'l Prim<'l>) -> io::Result<()> {
        let specifier = match prim.specifier {
            Specifier::Def => "def",
            Specifier::Over => "over",
        };
        let space = if prim.type_name.is_empty() { "" } else { " " };
        let head = format!("{specifier}{space}{} {}", prim.type_name, quoted(&prim.name));
        self.metadata_of(&head, prim)?;
        self.open("{")?;
        self.body(prim)?;
        self.close("}")
    }

    fn metadata_of(&mut self, head: &str, prim: &'l Prim<'l>) -> io::Result<()> {
        if prim.variant_sets.is_empty() {
            return self.metadata(head, &prim.metadata);
        }
        self.open(&format!("{head} ("))?;
        for (name, value) in &prim.metadata {
            self.field(name, value)?;
        }
        let names = prim.variant_sets.iter().map(|set| quoted(set.name));
        let names: Vec<String> = names.collect();
        self.line(&format!("prepend variantSets = [{}]", names.join(", ")))?;
        self.close(")")
    }

    fn body(&mut self, prim: &'l Prim<'l>) -> io::Result<()> {
        for property in &prim.properties {
            self.property(property)?;
        }
        let mut follows = !prim.properties.is_empty();
        for child in &prim.children {
            if follows {
                self.line("")?;
            }
            self.prim(child)?;
            follows = true;
        }
        for set in &prim.variant_sets {
            if follows {
                self.line("")?;
            }
            self.open(&format!("variantSet {} = {{", quoted(set.name)))?;
            for variant in &set.variants {
                self.metadata_of(&quoted(&variant.name), variant)?;
                self.open("{")?;
                self.body(variant)?;
                self.close("}")?;
            }
            self.close("}")?;
            follows = true;
        }
        Ok(())
    }

    fn property(&mut self, property: &'l Property<'l>) -> io::Result<()> {
        self.indent()?;
        match &property.content {
            Content::Relationship(targets) => {
                write!(self.out, "rel {}", property.name)?;
                match targets.as_slice() {
                    [one] => write!(self.out, " = <{one}>")?,
                    many => {
                        let list: Vec<String> = many.iter().map(|t| format!("<{t}>")).collect();
                        write!(self.out, " = [{}]", list.join(", "))?;
                    }
                }
                writeln!(self.out)
            }
            Content::Attribute { type_name, is_uniform, value, source, metadata } => {
                let uniform = if *is_uniform { "uniform " } else { "" };
                write!(self.out, "{uniform}{type_name} {}", property.name)?;
                if let Some(source) = source {
                    write!(self.out, ".connect = <{source}>")?;
                } else if let Some(value) = value {
                    write!(self.out, " = ")?;
                    self.value(value)?;
                }
                if metadata.is_empty() {
                    return writeln!(self.out);
                }
                writeln!(self.out, " (")?;
                self.depth += 1;
                for (name, value) in metadata {
                    self.field(name, value)?;
                }
                self.close(")")
            }
        }
    }

    fn value(&mut self, value: &'l Value<'l>) -> io::Result<()> {
        match value {
            Value::Bool(b) => write!(self.out, "{}", u8::from(*b)),
            Value::Int(i) => write!(self.out, "{i}"),
            Value::Float(f) => self.bytes_of(|out| shortest(out, *f)),
            Value::Double(d) => write!(self.out, "{}", d + 0.0),
            Value::String(text) | Value::Token(text) => write!(self.out, "{}", quoted(text)),
            Value::Asset(path) => write!(self.out, "@{path}@"),
            Value::Float3(v) => self.bytes_of(|out| tuple(out, b"(", *v)),
            Value::Float4(v) => self.bytes_of(|out| tuple(out, b"(", *v)),
            Value::Double3([x, y, z]) => write!(self.out, "({x}, {y}, {z})"),
            Value::Ints(items) => self.integers(items, |v| i64::from(*v)),
            Value::Repeated(item, count) => self.repeated(*item, *count),
            Value::Int64s(items) => self.integers(items, |v| *v),
            Value::Floats(items) => self.array(items, |out, v| shortest(out, *v)),
            Value::Float2s(items) => self.tuples(items, |v| v.to_array()),
            Value::Float3s(items) => self.tuples(items, |v| v.to_array()),
            Value::Unorm4s(items) => self.tuples(items, unorm4),
            Value::Quatfs(items) | Value::Quaths(items) => self.tuples(items, |v| *v),
            Value::Strings(items) => self.array(items, |out, v| out.text(quoted(v).as_bytes())),
            // Metadata alone, which `field` writes.
            Value::Dictionary(_) | Value::Prepended(_) | Value::Selections(_) | Value::Arc(_) => {
                Ok(())
            }
        }
    }

    fn bytes_of(&mut self, write: impl FnOnce(&mut Pen)) -> io::Result<()> {
        let mut out = Pen::new();
        write(&mut out);
        self.out.write_all(out.as_bytes())
    }

    fn repeated(&mut self, item: i32, count: usize) -> io::Result<()> {
        /// Written at a time.
        const BLOCK: usize = 1 << 14;
        let next = format!(", {item}");
        let block = next.repeat(count.saturating_sub(1).min(BLOCK));
        write!(self.out, "[")?;
        if count > 0 {
            write!(self.out, "{item}")?;
        }
        let mut left = count.saturating_sub(1);
        while left > 0 {
            let now = left.min(BLOCK);
            self.out.write_all(&block.as_bytes()[..now * next.len()])?;
            left -= now;
        }
        write!(self.out, "]")
    }

    fn array<T: Sync>(
        &mut self,
        items: &'l [T],
        write: impl Fn(&mut Pen, &T) + Copy + Send + Sync + 'l,
    ) -> io::Result<()> {
        self.out.write_all(b"[")?;
        if let Some((first, rest)) = items.split_first() {
            self.bytes_of(|out| write(out, first))?;
            self.out.rows(rest, move |out, item| {
                out.text(b", ");
                write(out, item);
            })?;
        }
        self.out.write_all(b"]")
    }

    fn integers<T: Sync>(
        &mut self,
        items: &'l [T],
        of: impl Fn(&T) -> i64 + Copy + Send + Sync + 'l,
    ) -> io::Result<()> {
        self.out.write_all(b"[")?;
        if let Some((first, rest)) = items.split_first() {
            self.bytes_of(|out| integer(out, of(first)))?;
            self.out.rows(rest, move |out, item| {
                out.row(|row| {
                    row.text(b", ");
                    row.integer(of(item));
                });
            })?;
        }
        self.out.write_all(b"]")
    }

    fn tuples<T: Sync, const N: usize>(
        &mut self,
        items: &'l [T],
        of: impl Fn(&T) -> [f32; N] + Copy + Send + Sync + 'l,
    ) -> io::Result<()> {
        self.out.write_all(b"[")?;
        if let Some((first, rest)) = items.split_first() {
            self.bytes_of(|out| tuple(out, b"(", of(first)))?;
            self.out.rows(rest, move |out, item| tuple(out, b", (", of(item)))?;
        }
        self.out.write_all(b"]")
    }
}

/// What an entry of a dictionary is declared as.
fn type_of(value: &Value) -> &'static str {
    match value {
        Value::Bool(_) => "bool",
        Value::Int(_) => "int",
        Value::Float(_) => "float",
        Value::Double(_) => "double",
        Value::Token(_) => "token",
        Value::Asset(_) => "asset",
        Value::Float3(_) => "float3",
        Value::Float4(_) => "float4",
        Value::Double3(_) => "double3",
        Value::Ints(_) | Value::Repeated(..) => "int[]",
        Value::Int64s(_) => "int64[]",
        Value::Floats(_) => "float[]",
        Value::Float2s(_) => "float2[]",
        Value::Float3s(_) => "float3[]",
        Value::Unorm4s(_) => "float4[]",
        Value::Quatfs(_) => "quatf[]",
        Value::Quaths(_) => "quath[]",
        Value::Strings(_) => "string[]",
        Value::Dictionary(_) => "dictionary",
        Value::String(_) | Value::Prepended(_) | Value::Selections(_) | Value::Arc(_) => "string",
    }
}

pub(super) fn unorm4(bytes: &[u8; 4]) -> [f32; 4] {
    bytes.map(|v| f32::from(v) / 255.0)
}

/// `a, b, …)` of at most four behind `open`.
#[inline]
fn tuple<const L: usize, const N: usize>(out: &mut Pen, open: &[u8; L], values: [f32; N]) {
    const { assert!(N <= 4) };
    out.row(|row| {
        row.text(open);
        for (k, value) in values.into_iter().enumerate() {
            if k > 0 {
                row.text(b", ");
            }
            row.shortest(value);
        }
        row.text(b")");
    });
}

/// A string literal.
fn quoted(text: &str) -> String {
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
    use glam::Vec2;

    use super::*;

    fn text_of(prim: Prim) -> String {
        let mut out = io::Cursor::new(Vec::new());
        write(&Layer { metadata: Vec::new(), prims: vec![prim] }, &mut out).unwrap();
        String::from_utf8(out.into_inner()).unwrap()
    }

    #[test]
    fn nesting_arrays_and_strings() {
        let mut prim = Prim::def("Mesh", "a")
            .kind("component")
            .attribute("int[]", "n", Value::Ints(vec![1, 20, 300].into()))
            .attribute("int[]", "counts", Value::Repeated(3, 3))
            .varying("float2[]", "st", Value::Float2s(vec![Vec2::new(-0.0, 0.1)].into()))
            .relationship("to", vec!["/a".into(), "/b".into()]);
        let variants = vec![Prim::variant("near").child(Prim::def("", "b")), Prim::variant("far")];
        prim.variant_sets.push(super::super::layer::VariantSet { name: "LOD", variants });
        let expected = r#"#usda 1.0

def Mesh "a" (
    kind = "component"
    prepend variantSets = ["LOD"]
)
{
    int[] n = [1, 20, 300]
    int[] counts = [3, 3, 3]
    float2[] st = [(0, 0.1)] (
        interpolation = "vertex"
    )
    rel to = [</a>, </b>]

    variantSet "LOD" = {
        "near"
        {
            def "b"
            {
            }
        }
        "far"
        {
        }
    }
}
"#;
        assert_eq!(text_of(prim), expected);
        assert_eq!(quoted("a\"b\\c\nd\u{1}е"), "\"a\\\"b\\\\c\\nd\\x01е\"");
    }

    #[test]
    fn arrays_longer_than_a_block_are_joined_without_a_seam() {
        let count = 300_005;
        let items: Vec<i32> = (0..count as i32).collect();
        let plain: Vec<String> = items.iter().map(i32::to_string).collect();
        let prim = Prim::def("", "a").attribute("int[]", "n", Value::Ints(items.into())).attribute(
            "int[]",
            "m",
            Value::Repeated(3, count),
        );
        let text = text_of(prim);
        assert!(text.contains(&format!("int[] n = [{}]\n", plain.join(", "))));
        assert!(text.contains(&format!("int[] m = [{}]\n", vec!["3"; count].join(", "))));
    }
}
