//! A rule file as a tree of values that remember where they stand, so that every later mistake
//! can be shown under the character that made it, in whichever file it was written.

use std::fmt;
use std::ops::Range;
use std::sync::Arc;

use serde::de::{self, DeserializeSeed, Deserializer, IntoDeserializer, Visitor};
use toml::de::{DeTable, DeValue};

use crate::diagnostic::Error;

/// A rule file's text and the name it is shown under.
#[derive(Debug, Clone)]
pub struct Source {
    pub name: String,
    pub text: Arc<str>,
}

/// The sources of one species: the file itself first, then what it extends, nearest first.
#[derive(Debug, Clone, Default)]
pub struct Sources(pub Vec<Source>);

/// Bytes of one source.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Place {
    /// Index into [`Sources`].
    pub source: usize,
    pub span: Range<usize>,
}

impl Place {
    /// Whether it lies in no file of the author's.
    pub fn is_nowhere(&self) -> bool {
        self.source == usize::MAX
    }

    fn holds(&self, other: &Place) -> bool {
        self.source == other.source
            && self.span.start <= other.span.start
            && other.span.end <= self.span.end
    }
}

impl Sources {
    /// An error with a caret at `place`.
    pub fn error(&self, place: &Place, message: impl Into<String>, label: &str) -> Error {
        match self.0.get(place.source) {
            Some(s) => Error::new(message).in_file(&s.name).at(
                &s.name,
                s.text.clone(),
                place.span.clone(),
                label,
            ),
            // A default: no text of the author's to show.
            None => match self.0.first() {
                Some(own) => Error::new(message).in_file(&own.name),
                None => Error::new(message),
            },
        }
    }
}

/// A value and its place.
#[derive(Debug, Clone)]
pub struct Node {
    pub place: Place,
    pub value: Value,
}

#[derive(Debug, Clone)]
pub enum Value {
    Bool(bool),
    Integer(i64),
    Float(f64),
    Text(String),
    Date,
    Array(Vec<Node>),
    Table(Vec<Entry>),
}

#[derive(Debug, Clone)]
pub struct Entry {
    pub key: String,
    pub key_place: Place,
    pub node: Node,
}

impl Node {
    pub fn get(&self, key: &str) -> Option<&Node> {
        self.entry(key).map(|e| &e.node)
    }

    pub fn get_mut(&mut self, key: &str) -> Option<&mut Node> {
        match &mut self.value {
            Value::Table(entries) => entries.iter_mut().find(|e| e.key == key).map(|e| &mut e.node),
            _ => None,
        }
    }

    pub fn entry(&self, key: &str) -> Option<&Entry> {
        self.entries().iter().find(|e| e.key == key)
    }

    /// The entries of a table, nothing of another value.
    pub fn entries(&self) -> &[Entry] {
        match &self.value {
            Value::Table(entries) => entries,
            _ => &[],
        }
    }

    pub fn as_text(&self) -> Option<&str> {
        match &self.value {
            Value::Text(t) => Some(t),
            _ => None,
        }
    }

    pub fn as_number(&self) -> Option<f64> {
        match self.value {
            Value::Integer(i) => Some(i as f64),
            Value::Float(f) => Some(f),
            _ => None,
        }
    }

    /// Forgets where the values stand: they belong to no source.
    pub fn detach(&mut self) {
        let nowhere = Place { source: usize::MAX, span: 0..0 };
        let mut rest = vec![self];
        while let Some(node) = rest.pop() {
            node.place = nowhere.clone();
            match &mut node.value {
                Value::Array(items) => rest.extend(items),
                Value::Table(entries) => rest.extend(entries.iter_mut().map(|e| {
                    e.key_place = nowhere.clone();
                    &mut e.node
                })),
                _ => {}
            }
        }
    }

    /// Lays `self` over `base`: tables merge key by key, anything else replaces.
    pub fn over(self, base: Node) -> Node {
        // TOML bounds its own nesting, so this recursion is shallow.
        match (self.value, base.value) {
            (Value::Table(own), Value::Table(mut entries)) => {
                let below = entries.len();
                for entry in own {
                    let mut known = entries.iter_mut().take(below);
                    match known.find(|e| e.key == entry.key) {
                        Some(slot) => {
                            let nothing =
                                Node { place: entry.node.place.clone(), value: Value::Date };
                            let base = std::mem::replace(&mut slot.node, nothing);
                            *slot = Entry { node: entry.node.over(base), ..entry };
                        }
                        None => entries.push(entry),
                    }
                }
                Node { place: self.place, value: Value::Table(entries) }
            }
            (value, _) => Node { place: self.place, value },
        }
    }
}

/// Syntax errors shown: a file that is none of TOML has one in every line.
const MAX_SYNTAX_ERRORS: usize = 5;

/// Reads TOML text as source number `source`. The first syntax errors are reported.
pub fn read(sources: &Sources, source: usize) -> Result<Node, Vec<Error>> {
    let Some(own) = sources.0.get(source) else {
        return Err(vec![Error::new("no text to read")]);
    };
    let (table, errors) = DeTable::parse_recoverable(&own.text);
    if !errors.is_empty() {
        let each = errors.iter().take(MAX_SYNTAX_ERRORS).map(|e| {
            let span = e.span().unwrap_or(0..0);
            let place = Place { source, span };
            let message = format!("not TOML: {}", e.message().trim().replace('\n', ", "));
            let remedy = remedy_of_syntax(&own.text, &place.span, &message);
            sources.error(&place, message, "here").remedy(remedy)
        });
        let mut all: Vec<Error> = each.collect();
        let more = errors.len() - all.len();
        if more > 0 {
            let more = Error::new(format!("… and {more} more places that are not TOML"));
            all.push(
                more.in_file(&own.name)
                    .remedy("give a rule file, or a name of `larix species list`"),
            );
        }
        return Err(all);
    }
    let span = table.span();
    let mut entries: Vec<Entry> =
        table.into_inner().into_iter().map(|(k, v)| entry(source, k, v)).collect();
    entries.sort_by_key(|e| e.key_place.span.start);
    Ok(Node { place: Place { source, span }, value: Value::Table(entries) })
}

/// What to do about a syntax error: said of the usual slips, and in general of the rest.
fn remedy_of_syntax(text: &str, span: &Range<usize>, message: &str) -> &'static str {
    let near = text.get(span.start..).unwrap_or("").chars().next().unwrap_or(' ');
    let before = text.get(..span.start).unwrap_or("").chars().next_back().unwrap_or(' ');
    let is_any = |set: &str| set.contains(near) || set.contains(before);
    if near.is_control() && !near.is_whitespace() {
        "remove the control character at the caret"
    } else if message.contains("escape") {
        r"write the text between single quotes, where `\` stands for itself"
    } else if message.contains("duplicate key") {
        "keep one of the two"
    } else if is_any("−–—") {
        "type the keyboard's minus sign, `-`"
    } else if is_any("“”‘’«»„") {
        "type straight quotes: `'…'`"
    } else if is_any("αβγδ") {
        "spell the letter: `alpha`, `beta`, `gamma`, `delta`"
    } else {
        "write keys as `name = value`, sections as `[rule]`, and productions between single quotes"
    }
}

type SpannedKey<'a> = toml::Spanned<toml::de::DeString<'a>>;
type SpannedValue<'a> = toml::Spanned<DeValue<'a>>;

fn entry(source: usize, key: SpannedKey<'_>, value: SpannedValue<'_>) -> Entry {
    let key_place = Place { source, span: key.span() };
    Entry { key: key.into_inner().into_owned(), key_place, node: node(source, value) }
}

fn node(source: usize, value: SpannedValue<'_>) -> Node {
    let place = Place { source, span: value.span() };
    let value = match value.into_inner() {
        DeValue::String(s) => Value::Text(s.into_owned()),
        DeValue::Boolean(b) => Value::Bool(b),
        DeValue::Integer(i) => match i64::from_str_radix(i.as_str(), i.radix()) {
            Ok(i) => Value::Integer(i),
            Err(_) => Value::Float(f64::INFINITY),
        },
        DeValue::Float(f) => Value::Float(f.as_str().parse().unwrap_or(f64::NAN)),
        DeValue::Datetime(_) => Value::Date,
        DeValue::Array(items) => Value::Array(items.into_iter().map(|v| node(source, v)).collect()),
        DeValue::Table(table) => {
            let mut entries: Vec<Entry> =
                table.into_iter().map(|(k, v)| entry(source, k, v)).collect();
            entries.sort_by_key(|e| e.key_place.span.start);
            Value::Table(entries)
        }
    };
    Node { place, value }
}

/// Why a value does not fit the type it is read as.
#[derive(Debug)]
pub struct Fault {
    message: String,
    remedy: Option<String>,
    place: Option<Place>,
    /// The key, where nothing of that name is known.
    stranger: Option<String>,
}

impl Fault {
    fn or_at(mut self, place: &Place) -> Self {
        self.place.get_or_insert_with(|| place.clone());
        self
    }
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.message)
    }
}

impl std::error::Error for Fault {}

/// The expectation in words of a rule file rather than of Rust.
fn plain(expected: &dyn de::Expected) -> String {
    match expected.to_string().as_str() {
        "f32" | "f64" => "a number".into(),
        "u8" => "a whole number from 0 to 255".into(),
        "u32" | "u64" | "usize" | "u16" => "a whole number, 0 or more".into(),
        "a sequence" => "a list `[…]`".into(),
        "a string" | "string or map" => "a text in quotes".into(),
        "an array of length 2" => "a list of 2".into(),
        "an array of length 3" => "a list of 3".into(),
        other if other.starts_with("struct ") => "a section of `key = value` lines".into(),
        other => other.into(),
    }
}

impl de::Error for Fault {
    fn custom<T: fmt::Display>(message: T) -> Self {
        Fault { message: message.to_string(), remedy: None, place: None, stranger: None }
    }

    fn invalid_type(found: de::Unexpected<'_>, expected: &dyn de::Expected) -> Self {
        let found = match found {
            de::Unexpected::Seq => "a list".into(),
            de::Unexpected::Map => "a table".into(),
            de::Unexpected::Str(s) => format!("the text \"{s}\""),
            de::Unexpected::Bool(b) => format!("`{b}`"),
            de::Unexpected::Signed(i) => format!("the number {i}"),
            de::Unexpected::Float(x) => format!("the number {x}"),
            de::Unexpected::Unit => "a date".into(),
            other => other.to_string(),
        };
        let expected = plain(expected);
        let mut fault = Fault::custom(format!("wrong type: {found}"));
        fault.remedy = Some(format!("give {expected}"));
        fault
    }

    fn invalid_value(found: de::Unexpected<'_>, expected: &dyn de::Expected) -> Self {
        let mut fault = Fault::custom(format!("out of range: {found}"));
        fault.remedy = Some(format!("give {}", plain(expected)));
        fault
    }

    fn invalid_length(found: usize, expected: &dyn de::Expected) -> Self {
        let mut fault = Fault::custom(format!("wrong length: {found} values"));
        fault.remedy = Some(format!("give {}", plain(expected)));
        fault
    }

    fn unknown_variant(found: &str, expected: &'static [&'static str]) -> Self {
        let mut fault = Fault::custom(format!("unknown value `{found}`"));
        fault.remedy = Some(super::near::suggest(found, expected));
        fault
    }

    fn unknown_field(found: &str, expected: &'static [&'static str]) -> Self {
        let mut fault = Fault::custom(format!("unknown key `{found}`"));
        fault.stranger = Some(found.to_owned());
        fault.remedy = Some(super::near::suggest(found, expected));
        fault
    }

    fn missing_field(field: &'static str) -> Self {
        let mut fault = Fault::custom(format!("`{field}` is missing"));
        fault.remedy = Some(format!("add a line `{field} = …`"));
        fault
    }
}

impl<'de> Deserializer<'de> for &'de Node {
    type Error = Fault;

    fn deserialize_any<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Fault> {
        match &self.value {
            Value::Bool(b) => visitor.visit_bool(*b),
            Value::Integer(i) => visitor.visit_i64(*i),
            Value::Float(x) => visitor.visit_f64(*x),
            Value::Text(t) => visitor.visit_str(t),
            Value::Date => visitor.visit_unit(),
            Value::Array(items) => {
                let mut rest = Items { items: items.iter(), total: items.len() };
                let value = visitor.visit_seq(&mut rest);
                match rest.items.len() {
                    0 => value,
                    _ if value.is_err() => value,
                    left => {
                        let wanted = format!("a list of {}", rest.total - left);
                        Err(de::Error::invalid_length(rest.total, &wanted.as_str()))
                    }
                }
            }
            Value::Table(entries) => {
                visitor.visit_map(Entries { entries: entries.iter(), current: None })
            }
        }
        .map_err(|fault: Fault| fault.or_at(&self.place))
    }

    fn deserialize_option<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Fault> {
        visitor.visit_some(self)
    }

    fn deserialize_enum<V: Visitor<'de>>(
        self,
        _name: &'static str,
        variants: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, Fault> {
        match &self.value {
            Value::Text(t) => visitor.visit_enum(t.as_str().into_deserializer()),
            _ => {
                let mut fault: Fault = de::Error::custom("wrong type: not a text");
                fault.remedy = Some(format!("give one of \"{}\"", variants.join("\", \"")));
                Err(fault)
            }
        }
        .map_err(|fault: Fault| fault.or_at(&self.place))
    }

    fn deserialize_newtype_struct<V: Visitor<'de>>(
        self,
        _name: &'static str,
        visitor: V,
    ) -> Result<V::Value, Fault> {
        visitor.visit_newtype_struct(self)
    }

    serde::forward_to_deserialize_any! {
        bool i8 i16 i32 i64 i128 u8 u16 u32 u64 u128 f32 f64 char str string bytes byte_buf
        unit unit_struct seq tuple tuple_struct map struct identifier ignored_any
    }
}

struct Items<'de> {
    items: std::slice::Iter<'de, Node>,
    total: usize,
}

impl<'de> de::SeqAccess<'de> for &mut Items<'de> {
    type Error = Fault;

    fn next_element_seed<T: DeserializeSeed<'de>>(
        &mut self,
        seed: T,
    ) -> Result<Option<T::Value>, Fault> {
        match self.items.next() {
            Some(node) => seed.deserialize(node).map(Some).map_err(|f| f.or_at(&node.place)),
            None => Ok(None),
        }
    }
}

struct Entries<'de> {
    entries: std::slice::Iter<'de, Entry>,
    current: Option<&'de Entry>,
}

impl<'de> de::MapAccess<'de> for Entries<'de> {
    type Error = Fault;

    fn next_key_seed<K: DeserializeSeed<'de>>(
        &mut self,
        seed: K,
    ) -> Result<Option<K::Value>, Fault> {
        self.current = self.entries.next();
        let Some(entry) = self.current else { return Ok(None) };
        let key: de::value::StrDeserializer<'_, Fault> = entry.key.as_str().into_deserializer();
        seed.deserialize(key).map(Some).map_err(|f| f.or_at(&entry.key_place))
    }

    fn next_value_seed<V: DeserializeSeed<'de>>(&mut self, seed: V) -> Result<V::Value, Fault> {
        match self.current {
            Some(entry) => seed.deserialize(&entry.node).map_err(|f| f.or_at(&entry.node.place)),
            None => Err(de::Error::custom("a value without a key")),
        }
    }
}

/// Reads a table as `T`, reporting every key that does not fit: a wrong value gives way to that of
/// `defaults`, an unknown key is dropped, and reading goes on. `None` only when nothing helps.
pub fn typed<T: de::DeserializeOwned>(
    node: &Node,
    defaults: &Node,
    sources: &Sources,
    errors: &mut Vec<Error>,
) -> Option<T> {
    let mut node = node.clone();
    // Each round settles one entry.
    for _ in 0..MAX_FAULTS {
        let fault = match T::deserialize(&node) {
            Ok(value) => return Some(value),
            Err(fault) => fault,
        };
        let place = fault.place.unwrap_or_else(|| node.place.clone());
        let culprit = node
            .entries()
            .iter()
            .position(|e| e.key_place.holds(&place) || e.node.place.holds(&place));
        let message = match culprit.and_then(|i| node.entries().get(i)) {
            Some(e) if !e.key_place.holds(&place) => format!("`{}`: {}", e.key, fault.message),
            _ => fault.message,
        };
        let mut error = sources.error(&place, message, "here");
        let home = fault.stranger.as_deref().and_then(super::load::home);
        if let Some(remedy) = home.or(fault.remedy) {
            error = error.remedy(remedy);
        }
        errors.push(error);
        let (Some(i), Value::Table(entries)) = (culprit, &mut node.value) else {
            return T::deserialize(defaults).ok();
        };
        match defaults.entry(&entries[i].key) {
            Some(default) => entries[i] = default.clone(),
            None => {
                entries.remove(i);
            }
        }
    }
    T::deserialize(defaults).ok()
}

/// Wrong keys reported of one section.
const MAX_FAULTS: usize = 64;

/// The keys of a section, as its type has them.
pub fn keys_of<'de, T: de::Deserialize<'de>>() -> &'static [&'static str] {
    let mut keys: &'static [&'static str] = &[];
    let _ = T::deserialize(Keys(&mut keys));
    keys
}

/// Gives no value, and notes the fields it is asked for.
struct Keys<'k>(&'k mut &'static [&'static str]);

impl<'de> Deserializer<'de> for Keys<'_> {
    type Error = Fault;

    fn deserialize_any<V: Visitor<'de>>(self, _visitor: V) -> Result<V::Value, Fault> {
        Err(de::Error::custom("no value"))
    }

    fn deserialize_struct<V: Visitor<'de>>(
        self,
        _name: &'static str,
        fields: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, Fault> {
        *self.0 = fields;
        self.deserialize_any(visitor)
    }

    serde::forward_to_deserialize_any! {
        bool i8 i16 i32 i64 i128 u8 u16 u32 u64 u128 f32 f64 char str string bytes byte_buf
        option unit unit_struct newtype_struct seq tuple tuple_struct map enum identifier
        ignored_any
    }
}
