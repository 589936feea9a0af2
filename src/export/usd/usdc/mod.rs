//! A layer as a crate file (.usdc), version 0.8.0, which readers know since OpenUSD 19.11.
//!
//! Values first, then six sections: tokens, strings (which are tokens), fields (a name and a
//! value), sets of fields, paths, specs (a path, what is there, its fields). Small values stand in
//! the 8 bytes of a field itself, equal ones are written once, integers and all tables are
//! compressed. Arrays of floats are written as they are: they go from the scene's columns to the
//! file without a copy. Numbers are little-endian.

mod coding;
mod sections;
mod tables;
mod values;

use std::borrow::Cow;
use std::collections::HashMap;
use std::io::{self, Write};

use rayon::prelude::*;

use self::tables::{Paths, Table};
use self::values::{integer_bytes, prepended};
use super::layer::{Content, Field, Layer, Prim, Property, Specifier, Value};

/// Bytes that a file begins with: the magic word, the version, where the table of contents is, and
/// eight reserved words.
pub(super) const HEAD: usize = 88;
const END_OF_SET: u32 = u32::MAX;

/// Kinds of values, by the numbers that stand for them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[repr(u8)]
enum Kind {
    Bool = 1,
    Int = 3,
    Int64 = 5,
    Float = 8,
    Double = 9,
    String = 10,
    Token = 11,
    Asset = 12,
    Quatf = 17,
    Quath = 18,
    Float2 = 20,
    Double3 = 23,
    Float3 = 24,
    Float4 = 28,
    Dictionary = 31,
    TokenListOp = 32,
    StringListOp = 33,
    PathListOp = 34,
    ReferenceListOp = 35,
    TokenVector = 41,
    Specifier = 42,
    Variability = 44,
    Selections = 45,
    PayloadListOp = 55,
}

/// What is at a path.
#[derive(Debug, Clone, Copy)]
#[repr(u32)]
enum Spec {
    Attribute = 1,
    Prim = 6,
    Root = 7,
    Relationship = 8,
    Variant = 10,
    VariantSet = 11,
}

/// Where a value is, or the value itself.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
struct Rep(u64);

impl Rep {
    const ARRAY: u64 = 1 << 63;
    const COMPRESSED: u64 = 1 << 61;

    fn inlined(kind: Kind, payload: u32) -> Rep {
        Rep(1 << 62 | (kind as u64) << 48 | u64::from(payload))
    }

    fn at(kind: Kind, place: u64) -> Rep {
        Rep((kind as u64) << 48 | place)
    }

    fn array(kind: Kind, place: u64) -> Rep {
        Rep(Rep::ARRAY | (kind as u64) << 48 | place)
    }
}

/// Writes all of the file but its first [`HEAD`] bytes, and gives these. Long columns of integers
/// are coded while those of other numbers, which come first, go to the disk.
pub(super) fn write<W: Write + Send>(layer: &Layer, out: W) -> io::Result<Vec<u8>> {
    let mut file = Crate::new(out);
    let mut long = Vec::new();
    layer.prims.iter().for_each(|prim| long_columns(prim, &mut long));
    let (integers, others): (Vec<&Value>, Vec<&Value>) = long.into_iter().partition(|value| {
        matches!(value, Value::Ints(_) | Value::Repeated(..) | Value::Int64s(_))
    });
    let (coded, written) = rayon::join(
        || integers.par_iter().map(|v| Some((place(v), integer_bytes(v)?))).flatten().collect(),
        || others.into_iter().try_for_each(|value| file.value(value).map(drop)),
    );
    written?;
    file.coded = coded;
    file.root(layer)?;
    file.finish()
}

/// Those below a prim that are worth a thread.
fn long_columns<'l>(prim: &'l Prim<'l>, out: &mut Vec<&'l Value<'l>>) {
    const LONG: usize = 1 << 14;
    for property in &prim.properties {
        let Content::Attribute { value: Some(value), source: None, .. } = &property.content else {
            continue;
        };
        let length = match value {
            Value::Ints(items) => items.len(),
            Value::Repeated(_, count) => *count,
            Value::Int64s(items) => items.len(),
            Value::Floats(items) => items.len(),
            Value::Float2s(items) => items.len(),
            Value::Float3s(items) => items.len(),
            Value::Unorm4s(items) => items.len(),
            _ => 0,
        };
        if length >= LONG {
            out.push(value);
        }
    }
    let variants = prim.variant_sets.iter().flat_map(|set| &set.variants);
    prim.children.iter().chain(variants).for_each(|prim| long_columns(prim, out));
}

/// Tells a value of a layer from all others.
fn place(value: &Value) -> usize {
    std::ptr::from_ref(value).addr()
}

struct Crate<'l, W> {
    out: W,
    /// Bytes from the start of the file.
    at: u64,
    tokens: Table<Cow<'l, str>>,
    /// Tokens.
    strings: Table<u32>,
    fields: Table<(u32, Rep)>,
    sets: Vec<u32>,
    set_starts: HashMap<Vec<u32>, u32>,
    paths: Paths,
    /// Path, set, what.
    specs: Vec<[u32; 3]>,
    small: HashMap<(Kind, Vec<u8>), Rep>,
    arrays: HashMap<(Kind, u64), Vec<(&'l Value<'l>, Rep)>>,
    /// By [`place`].
    coded: HashMap<usize, Vec<u8>>,
}

impl<'l, W: Write> Crate<'l, W> {
    fn new(out: W) -> Self {
        let mut tokens = Table::default();
        // The names of properties are told from others by a minus sign, which 0 has not.
        tokens.number(Cow::Borrowed(";-)"));
        Crate {
            out,
            at: HEAD as u64,
            tokens,
            strings: Table::default(),
            fields: Table::default(),
            sets: Vec::new(),
            set_starts: HashMap::new(),
            paths: Paths::default(),
            specs: Vec::new(),
            small: HashMap::new(),
            arrays: HashMap::new(),
            coded: HashMap::new(),
        }
    }

    fn bytes(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.at += bytes.len() as u64;
        self.out.write_all(bytes)
    }

    fn align(&mut self) -> io::Result<()> {
        let gap = self.at.next_multiple_of(8) - self.at;
        self.bytes(&[0; 8][..gap as usize])
    }

    fn token(&mut self, text: impl Into<Cow<'l, str>>) -> u32 {
        self.tokens.number(text.into())
    }

    fn string(&mut self, text: impl Into<Cow<'l, str>>) -> u32 {
        let token = self.token(text);
        self.strings.number(token)
    }

    fn element(&mut self, parent: u32, name: &'l str, is_property: bool) -> u32 {
        let token = self.token(name);
        self.paths.number(parent, token, is_property)
    }

    /// The number of an absolute path: of a prim, or of a property after a dot.
    fn path(&mut self, path: &'l str) -> u32 {
        let (prim, property) = path.split_once('.').map_or((path, None), |(a, b)| (a, Some(b)));
        let mut at = Paths::ROOT;
        for name in prim.split('/').filter(|name| !name.is_empty()) {
            at = self.element(at, name, false);
        }
        property.map_or(at, |name| self.element(at, name, true))
    }

    fn root(&mut self, layer: &'l Layer<'l>) -> io::Result<()> {
        let mut fields = self.metadata(&layer.metadata)?;
        self.children(&mut fields, &layer.prims)?;
        self.spec(Paths::ROOT, Spec::Root, fields);
        layer.prims.iter().try_for_each(|prim| self.prim(Paths::ROOT, prim))
    }

    fn prim(&mut self, parent: u32, prim: &'l Prim<'l>) -> io::Result<()> {
        let path = self.element(parent, &prim.name, false);
        let specifier = match prim.specifier {
            Specifier::Def => 0,
            Specifier::Over => 1,
        };
        let mut fields = vec![self.field("specifier", Rep::inlined(Kind::Specifier, specifier))];
        if !prim.type_name.is_empty() {
            let token = self.token(prim.type_name);
            fields.push(self.field("typeName", Rep::inlined(Kind::Token, token)));
        }
        self.body(path, Spec::Prim, fields, prim)
    }

    fn body(
        &mut self,
        path: u32,
        what: Spec,
        mut fields: Vec<u32>,
        prim: &'l Prim<'l>,
    ) -> io::Result<()> {
        fields.extend(self.metadata(&prim.metadata)?);
        let properties: Vec<&'l str> = prim.properties.iter().map(|p| p.name.as_ref()).collect();
        self.names(&mut fields, "properties", &properties)?;
        self.children(&mut fields, &prim.children)?;
        let sets: Vec<&'l str> = prim.variant_sets.iter().map(|set| set.name).collect();
        self.names(&mut fields, "variantSetChildren", &sets)?;
        if !sets.is_empty() {
            let strings: Vec<u32> = sets.iter().map(|name| self.string(*name)).collect();
            let rep = self.small(Kind::StringListOp, prepended(&strings, u32::to_le_bytes))?;
            fields.push(self.field("variantSetNames", rep));
        }
        self.spec(path, what, fields);
        for property in &prim.properties {
            self.property(path, property)?;
        }
        for child in &prim.children {
            self.prim(path, child)?;
        }
        for set in &prim.variant_sets {
            let token = self.token(format!("{{{}=}}", set.name));
            let at = self.paths.number(path, token, false);
            let names: Vec<&'l str> = set.variants.iter().map(|v| v.name.as_ref()).collect();
            let mut fields = Vec::new();
            self.names(&mut fields, "variantChildren", &names)?;
            self.spec(at, Spec::VariantSet, fields);
            for variant in &set.variants {
                let token = self.token(format!("{{{}={}}}", set.name, variant.name));
                let at = self.paths.number(path, token, false);
                let over = self.field("specifier", Rep::inlined(Kind::Specifier, 1));
                self.body(at, Spec::Variant, vec![over], variant)?;
            }
        }
        Ok(())
    }

    fn property(&mut self, parent: u32, property: &'l Property<'l>) -> io::Result<()> {
        let path = self.element(parent, &property.name, true);
        let mut fields = vec![self.field("custom", Rep::inlined(Kind::Bool, 0))];
        let mut variability = |file: &mut Self, is_uniform: bool| {
            let rep = Rep::inlined(Kind::Variability, u32::from(is_uniform));
            fields.push(file.field("variability", rep));
        };
        let what = match &property.content {
            Content::Relationship(targets) => {
                variability(self, true);
                let rep = self.targets(targets)?;
                fields.push(self.field("targetPaths", rep));
                Spec::Relationship
            }
            Content::Attribute { type_name, is_uniform, value, source, metadata } => {
                variability(self, *is_uniform);
                let token = self.token(*type_name);
                fields.push(self.field("typeName", Rep::inlined(Kind::Token, token)));
                if let Some(source) = source {
                    let rep = self.targets(std::slice::from_ref(source))?;
                    fields.push(self.field("connectionPaths", rep));
                } else if let Some(value) = value {
                    let rep = self.value(value)?;
                    fields.push(self.field("default", rep));
                }
                fields.extend(self.metadata(metadata)?);
                Spec::Attribute
            }
        };
        self.spec(path, what, fields);
        Ok(())
    }

    fn spec(&mut self, path: u32, what: Spec, fields: Vec<u32>) {
        let next = self.sets.len() as u32;
        let set = *self.set_starts.entry(fields).or_insert_with_key(|fields| {
            self.sets.extend(fields);
            self.sets.push(END_OF_SET);
            next
        });
        self.specs.push([path, set, what as u32]);
    }

    fn field(&mut self, name: &'l str, rep: Rep) -> u32 {
        let token = self.token(name);
        self.fields.number((token, rep))
    }

    fn metadata(&mut self, fields: &'l [Field<'l>]) -> io::Result<Vec<u32>> {
        fields
            .iter()
            .map(|(name, value)| {
                let rep = match value {
                    Value::Arc(arc) => self.arc(name, arc)?,
                    other => self.value(other)?,
                };
                let name = if *name == "variants" { "variantSelection" } else { name };
                Ok(self.field(name, rep))
            })
            .collect()
    }

    fn children(&mut self, fields: &mut Vec<u32>, prims: &'l [Prim<'l>]) -> io::Result<()> {
        let names: Vec<&'l str> = prims.iter().map(|p| p.name.as_ref()).collect();
        self.names(fields, "primChildren", &names)
    }

    /// A field of the order of children; none for none.
    fn names(
        &mut self,
        fields: &mut Vec<u32>,
        field: &'static str,
        names: &[&'l str],
    ) -> io::Result<()> {
        if !names.is_empty() {
            let tokens: Vec<u32> = names.iter().map(|name| self.token(*name)).collect();
            let rep = self.small(Kind::TokenVector, counted(&tokens, u32::to_le_bytes))?;
            fields.push(self.field(field, rep));
        }
        Ok(())
    }
}

/// The number of items, then these.
fn counted<T: Copy, const B: usize>(items: &[T], le: impl Fn(T) -> [u8; B]) -> Vec<u8> {
    let mut out = (items.len() as u64).to_le_bytes().to_vec();
    out.extend(items.iter().flat_map(|item| le(*item)));
    out
}
