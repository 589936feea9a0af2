//! A layer as a crate file (.usdc), version 0.8.0, which readers know since OpenUSD 19.11.
//!
//! Values first, then six sections: tokens, strings (which are tokens), fields (a name and a
//! value), sets of fields, paths, specs (a path, what is there, its fields). Small values stand in
//! the 8 bytes of a field itself, equal ones are written once, integers and all tables are
//! compressed. Arrays of floats are written as they are: they go from the scene's columns to the
//! file without a copy. Numbers are little-endian.

use std::borrow::Cow;
use std::collections::HashMap;
use std::io::{self, Write};

use rayon::prelude::*;

use super::coding;
use super::layer::{Arc, Content, Field, Layer, Prim, Property, Specifier, Value};
use super::usda::unorm4;

const VERSION: [u8; 8] = [0, 8, 0, 0, 0, 0, 0, 0];
/// Bytes that a file begins with: the magic word, the version, where the table of contents is, and
/// eight reserved words.
pub(super) const HEAD: usize = 88;
const END_OF_SET: u32 = u32::MAX;
/// Shorter arrays of integers are not compressed.
const COMPRESSED_FROM: usize = 16;
/// Bytes that converted arrays are written in.
const BLOCK: usize = 1 << 16;

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

fn integer_bytes(value: &Value) -> Option<Vec<u8>> {
    match value {
        Value::Ints(items) => Some(coding::ints(items)),
        Value::Repeated(item, count) => Some(coding::repeated(*item, *count)),
        Value::Int64s(items) => Some(coding::long_ints(items)),
        _ => None,
    }
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

    // Specs

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

    // Values

    fn value(&mut self, value: &'l Value<'l>) -> io::Result<Rep> {
        match value {
            Value::Bool(b) => Ok(Rep::inlined(Kind::Bool, u32::from(*b))),
            Value::Int(i) => Ok(Rep::inlined(Kind::Int, *i as u32)),
            Value::Float(f) => Ok(Rep::inlined(Kind::Float, f.to_bits())),
            Value::Double(d) if f64::from(*d as f32) == *d => {
                Ok(Rep::inlined(Kind::Double, (*d as f32).to_bits()))
            }
            Value::Double(d) => self.small(Kind::Double, d.to_le_bytes().to_vec()),
            Value::String(text) => {
                let string = self.string(text.as_ref());
                Ok(Rep::inlined(Kind::String, string))
            }
            Value::Token(text) => {
                let token = self.token(text.as_ref());
                Ok(Rep::inlined(Kind::Token, token))
            }
            Value::Asset(path) => {
                let token = self.token(path.as_str());
                Ok(Rep::inlined(Kind::Asset, token))
            }
            Value::Float3(v) => self.vector(Kind::Float3, v, f32::to_le_bytes),
            Value::Float4(v) => self.vector(Kind::Float4, v, f32::to_le_bytes),
            Value::Double3(v) => self.vector(Kind::Double3, v, f64::to_le_bytes),
            Value::Dictionary(entries) => self.dictionary(entries),
            Value::Prepended(names) => {
                let tokens: Vec<u32> = names.iter().map(|name| self.token(*name)).collect();
                self.small(Kind::TokenListOp, prepended(&tokens, u32::to_le_bytes))
            }
            Value::Selections(chosen) => {
                let mut bytes = (chosen.len() as u64).to_le_bytes().to_vec();
                for (set, variant) in chosen {
                    bytes.extend(self.string(*set).to_le_bytes());
                    bytes.extend(self.string(variant.as_str()).to_le_bytes());
                }
                self.small(Kind::Selections, bytes)
            }
            // Metadata alone, which `metadata` writes.
            Value::Arc(arc) => self.arc("references", arc),
            Value::Ints(items) => self.array(Kind::Int, value, items.len()),
            Value::Repeated(_, count) => self.array(Kind::Int, value, *count),
            Value::Int64s(items) => self.array(Kind::Int64, value, items.len()),
            Value::Floats(items) => self.array(Kind::Float, value, items.len()),
            Value::Float2s(items) => self.array(Kind::Float2, value, items.len()),
            Value::Float3s(items) => self.array(Kind::Float3, value, items.len()),
            Value::Unorm4s(items) => self.array(Kind::Float4, value, items.len()),
            Value::Quatfs(items) => self.array(Kind::Quatf, value, items.len()),
            Value::Quaths(items) => self.array(Kind::Quath, value, items.len()),
            Value::Strings(items) => self.array(Kind::String, value, items.len()),
        }
    }

    /// Written once, however often it is asked for.
    fn small(&mut self, kind: Kind, bytes: Vec<u8>) -> io::Result<Rep> {
        if let Some(rep) = self.small.get(&(kind, bytes.clone())) {
            return Ok(*rep);
        }
        let rep = Rep::at(kind, self.at);
        self.bytes(&bytes)?;
        self.small.insert((kind, bytes), rep);
        Ok(rep)
    }

    /// In a byte a number where all are whole and fit.
    fn vector<T: Copy + Into<f64>, const N: usize, const B: usize>(
        &mut self,
        kind: Kind,
        numbers: &[T; N],
        le: impl Fn(T) -> [u8; B],
    ) -> io::Result<Rep> {
        let short = numbers.map(|n| n.into() as i8);
        if short.iter().zip(numbers).all(|(s, n)| f64::from(*s) == (*n).into()) {
            let mut payload = [0; 4];
            for (byte, s) in payload.iter_mut().zip(short) {
                *byte = s as u8;
            }
            return Ok(Rep::inlined(kind, u32::from_le_bytes(payload)));
        }
        self.small(kind, numbers.iter().flat_map(|n| le(*n)).collect())
    }

    fn dictionary(&mut self, entries: &'l [(Cow<'l, str>, Value<'l>)]) -> io::Result<Rep> {
        if entries.is_empty() {
            return Ok(Rep::inlined(Kind::Dictionary, 0));
        }
        let mut bytes = (entries.len() as u64).to_le_bytes().to_vec();
        for (key, value) in entries {
            let rep = self.value(value)?;
            bytes.extend(self.string(key.as_ref()).to_le_bytes());
            // From here to the value: what it is made of could stand between.
            bytes.extend(8i64.to_le_bytes());
            bytes.extend(rep.0.to_le_bytes());
        }
        self.small(Kind::Dictionary, bytes)
    }

    fn arc(&mut self, name: &str, arc: &'l Arc) -> io::Result<Rep> {
        let mut item = Vec::new();
        item.extend(self.string(arc.asset.as_str()).to_le_bytes());
        item.extend(self.path(&arc.prim).to_le_bytes());
        // No shift in time.
        item.extend(0f64.to_le_bytes());
        item.extend(1f64.to_le_bytes());
        let kind = if name == "payload" {
            Kind::PayloadListOp
        } else {
            // No entries of its own.
            item.extend(0u64.to_le_bytes());
            Kind::ReferenceListOp
        };
        let mut bytes = vec![PREPENDED];
        bytes.extend(1u64.to_le_bytes());
        bytes.extend(item);
        self.small(kind, bytes)
    }

    fn targets(&mut self, paths: &'l [String]) -> io::Result<Rep> {
        let numbers: Vec<u32> = paths.iter().map(|path| self.path(path)).collect();
        let mut bytes = vec![EXPLICIT];
        bytes.extend(counted(&numbers, u32::to_le_bytes));
        self.small(Kind::PathListOp, bytes)
    }

    fn array(&mut self, kind: Kind, value: &'l Value<'l>, count: usize) -> io::Result<Rep> {
        if count == 0 {
            return Ok(Rep::array(kind, 0));
        }
        let key = (kind, sample(value));
        if let Some(known) = self.arrays.get(&key)
            && let Some((_, rep)) =
                known.iter().find(|(other, _)| std::ptr::eq(*other, value) || *other == value)
        {
            return Ok(*rep);
        }
        let rep = self.new_array(kind, value, count)?;
        self.arrays.entry(key).or_default().push((value, rep));
        Ok(rep)
    }

    fn new_array(&mut self, kind: Kind, value: &'l Value<'l>, count: usize) -> io::Result<Rep> {
        self.align()?;
        let rep = Rep::array(kind, self.at);
        self.bytes(&(count as u64).to_le_bytes())?;
        let integers = match self.coded.remove(&place(value)) {
            _ if count < COMPRESSED_FROM => None,
            None => integer_bytes(value),
            coded => coded,
        };
        if let Some(integers) = integers {
            self.bytes(&(integers.len() as u64).to_le_bytes())?;
            self.bytes(&integers)?;
            return Ok(Rep(rep.0 | Rep::COMPRESSED));
        }
        match value {
            Value::Ints(items) => self.bytes(bytemuck::cast_slice(items))?,
            Value::Repeated(item, count) => {
                self.bytes(bytemuck::cast_slice(&vec![*item; *count]))?;
            }
            Value::Int64s(items) => self.bytes(bytemuck::cast_slice(items))?,
            Value::Floats(items) => self.bytes(bytemuck::cast_slice(items))?,
            Value::Float2s(items) => self.bytes(bytemuck::cast_slice(items))?,
            Value::Float3s(items) => self.bytes(bytemuck::cast_slice(items))?,
            Value::Unorm4s(items) => self.converted(items, |v| unorm4(v).map(f32::to_le_bytes))?,
            // The real part is last here.
            Value::Quatfs(items) => {
                self.converted(items, |[r, i, j, k]| [*i, *j, *k, *r].map(f32::to_le_bytes))?;
            }
            Value::Quaths(items) => {
                let half = |v: f32| half_bits(v).to_le_bytes();
                self.converted(items, |[r, i, j, k]| [*i, *j, *k, *r].map(half))?;
            }
            Value::Strings(items) => {
                let numbers: Vec<u32> = items.iter().map(|s| self.string(s.as_ref())).collect();
                self.bytes(bytemuck::cast_slice(&numbers))?;
            }
            _ => {}
        }
        Ok(rep)
    }

    fn converted<T, const B: usize>(
        &mut self,
        items: &[T],
        convert: impl Fn(&T) -> [[u8; B]; 4],
    ) -> io::Result<()> {
        let mut numbers: Vec<[[u8; B]; 4]> = Vec::new();
        for block in items.chunks(BLOCK / (4 * B)) {
            numbers.clear();
            numbers.extend(block.iter().map(&convert));
            self.bytes(numbers.as_flattened().as_flattened())?;
        }
        Ok(())
    }

    // Sections

    fn finish(mut self) -> io::Result<Vec<u8>> {
        let strings: Vec<u32> = std::mem::take(&mut self.strings.items);
        let tokens: Vec<u8> = self.tokens.items.iter().flat_map(|t| t.bytes().chain([0])).collect();
        let mut token_section = Vec::new();
        push(&mut token_section, self.tokens.items.len());
        push(&mut token_section, tokens.len());
        push_sized(&mut token_section, &coding::compressed(&tokens));

        let mut field_section = Vec::new();
        push(&mut field_section, self.fields.items.len());
        let names: Vec<u32> = self.fields.items.iter().map(|(name, _)| *name).collect();
        push_sized(&mut field_section, &coding::unsigned(&names));
        let reps: Vec<u8> =
            self.fields.items.iter().flat_map(|(_, rep)| rep.0.to_le_bytes()).collect();
        push_sized(&mut field_section, &coding::compressed(&reps));

        let mut set_section = Vec::new();
        push(&mut set_section, self.sets.len());
        push_sized(&mut set_section, &coding::unsigned(&self.sets));

        let mut path_section = Vec::new();
        let [numbers, names, jumps] = self.paths.tree();
        push(&mut path_section, numbers.len());
        push(&mut path_section, numbers.len());
        for column in [&numbers, &names, &jumps] {
            push_sized(&mut path_section, &coding::ints(column));
        }

        let mut spec_section = Vec::new();
        push(&mut spec_section, self.specs.len());
        for k in 0..3 {
            let column: Vec<u32> = self.specs.iter().map(|spec| spec[k]).collect();
            push_sized(&mut spec_section, &coding::unsigned(&column));
        }

        let sections = [
            ("TOKENS", token_section),
            ("STRINGS", counted(&strings, u32::to_le_bytes)),
            ("FIELDS", field_section),
            ("FIELDSETS", set_section),
            ("PATHS", path_section),
            ("SPECS", spec_section),
        ];
        let mut contents = Vec::new();
        push(&mut contents, sections.len());
        for (name, bytes) in &sections {
            let mut padded = [0; 16];
            padded[..name.len()].copy_from_slice(name.as_bytes());
            contents.extend(padded);
            contents.extend(self.at.to_le_bytes());
            contents.extend((bytes.len() as u64).to_le_bytes());
            self.bytes(bytes)?;
        }
        let contents_at = self.at;
        self.bytes(&contents)?;

        let mut head = b"PXR-USDC".to_vec();
        head.extend(VERSION);
        head.extend(contents_at.to_le_bytes());
        head.resize(HEAD, 0);
        self.out.flush()?;
        Ok(head)
    }
}

const EXPLICIT: u8 = 0b11;
const PREPENDED: u8 = 0b10_0000;

fn push(out: &mut Vec<u8>, number: usize) {
    out.extend((number as u64).to_le_bytes());
}

fn push_sized(out: &mut Vec<u8>, bytes: &[u8]) {
    push(out, bytes.len());
    out.extend(bytes);
}

fn counted<T: Copy, const B: usize>(items: &[T], le: impl Fn(T) -> [u8; B]) -> Vec<u8> {
    let mut out = (items.len() as u64).to_le_bytes().to_vec();
    out.extend(items.iter().flat_map(|item| le(*item)));
    out
}

fn prepended(items: &[u32], le: impl Fn(u32) -> [u8; 4]) -> Vec<u8> {
    let mut out = vec![PREPENDED];
    out.extend(counted(items, le));
    out
}

/// Each item once, by its number.
struct Table<T> {
    items: Vec<T>,
    numbers: HashMap<T, u32>,
}

impl<T> Default for Table<T> {
    fn default() -> Self {
        Table { items: Vec::new(), numbers: HashMap::new() }
    }
}

impl<T: Clone + Eq + std::hash::Hash> Table<T> {
    fn number(&mut self, item: T) -> u32 {
        if let Some(number) = self.numbers.get(&item) {
            return *number;
        }
        let number = self.items.len() as u32;
        self.items.push(item.clone());
        self.numbers.insert(item, number);
        number
    }
}

/// The paths of a file as a tree; 0 is its root.
struct Paths {
    /// Parent, and the token of the last element; negative for a property's.
    numbers: HashMap<(u32, i32), u32>,
    elements: Vec<i32>,
    children: Vec<Vec<u32>>,
}

impl Default for Paths {
    fn default() -> Self {
        Paths { numbers: HashMap::new(), elements: vec![0], children: vec![Vec::new()] }
    }
}

impl Paths {
    const ROOT: u32 = 0;

    fn number(&mut self, parent: u32, token: u32, is_property: bool) -> u32 {
        let element = if is_property { -(token as i32) } else { token as i32 };
        let next = self.elements.len() as u32;
        let number = *self.numbers.entry((parent, element)).or_insert(next);
        if number == next {
            self.elements.push(element);
            self.children.push(Vec::new());
            self.children[parent as usize].push(next);
        }
        number
    }

    /// Paths, each before what is below it: their numbers, their elements, and where the next
    /// sibling is: so many entries on; 0 for the next entry, of a path without children; −1 for
    /// none, of a path with children; −2 for neither.
    fn tree(&self) -> [Vec<i32>; 3] {
        let mut out = [Vec::new(), Vec::new(), Vec::new()];
        // Whether a sibling follows.
        let mut waiting = vec![(Paths::ROOT, false)];
        // Entries whose sibling is still to come, by depth of the stack under them.
        let mut open: Vec<(usize, usize)> = Vec::new();
        while let Some((path, has_sibling)) = waiting.pop() {
            let at = out[0].len();
            while let Some((_, entry)) = open.pop_if(|(depth, _)| *depth > waiting.len()) {
                out[2][entry] = (at - entry) as i32;
            }
            let children = &self.children[path as usize];
            out[0].push(path as i32);
            out[1].push(self.elements[path as usize]);
            out[2].push(match (has_sibling, children.is_empty()) {
                (true, true) => 0,
                (true, false) => {
                    open.push((waiting.len(), at));
                    0
                }
                (false, false) => -1,
                (false, true) => -2,
            });
            let last = children.len().saturating_sub(1);
            waiting.extend(children.iter().enumerate().rev().map(|(k, c)| (*c, k < last)));
        }
        out
    }
}

/// Of an array: its length and up to 64 of its items; equal ones have equal samples.
fn sample(value: &Value) -> u64 {
    fn of<T: bytemuck::Pod>(items: &[T]) -> u64 {
        let step = items.len().div_ceil(64).max(1);
        let sampled = items.iter().step_by(step).flat_map(|item| bytemuck::bytes_of(item));
        hash(sampled.copied(), items.len())
    }
    match value {
        Value::Ints(items) => of(items),
        Value::Repeated(item, count) => hash(item.to_le_bytes(), *count),
        Value::Int64s(items) => of(items),
        Value::Floats(items) => of(items),
        Value::Float2s(items) => of(items),
        Value::Float3s(items) => of(items),
        Value::Unorm4s(items) => of(items),
        Value::Quatfs(items) | Value::Quaths(items) => of(items),
        Value::Strings(items) => hash(items.iter().take(8).flat_map(|s| s.bytes()), items.len()),
        _ => 0,
    }
}

/// FNV-1a.
fn hash(bytes: impl IntoIterator<Item = u8>, length: usize) -> u64 {
    let start = 0xCBF2_9CE4_8422_2325 ^ length as u64;
    bytes.into_iter().fold(start, |h, b| (h ^ u64::from(b)).wrapping_mul(0x0100_0000_01B3))
}

/// The nearest half float, ties to even.
fn half_bits(value: f32) -> u16 {
    let bits = value.to_bits();
    let sign = (bits >> 16 & 0x8000) as u16;
    let exponent = (bits >> 23 & 0xFF) as i32 - 112;
    let fraction = bits & 0x7F_FFFF;
    if exponent >= 0x1F {
        // Too large, infinite, or no number.
        let is_nan = exponent == 0xFF - 112 && fraction != 0;
        return sign | 0x7C00 | u16::from(is_nan) << 9;
    }
    // Below the normal range the leading one is written out, and shifted down.
    let (significand, shift) = match exponent {
        1.. => ((exponent as u32) << 23 | fraction, 13),
        -10..=0 => (fraction | 0x80_0000, (14 - exponent) as u32),
        _ => return sign,
    };
    let (whole, rest, tie) =
        (significand >> shift, significand & ((1 << shift) - 1), 1 << (shift - 1));
    let up = rest > tie || (rest == tie && whole & 1 == 1);
    sign | (whole + u32::from(up)) as u16
}
