//! A layer of scene description before it is text or bytes: prims, their properties, variant sets
//! and arcs to other layers. Arrays are borrowed from the scene where it has them as USD wants them.

use std::borrow::Cow;

use glam::{Vec2, Vec3};

pub(super) struct Layer<'a> {
    pub metadata: Vec<Field<'a>>,
    pub prims: Vec<Prim<'a>>,
}

/// Metadata by its name in text.
pub(super) type Field<'a> = (&'static str, Value<'a>);

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Specifier {
    Def,
    Over,
}

/// Also what one variant adds to its prim; specifier and type are then not used.
pub(super) struct Prim<'a> {
    pub specifier: Specifier,
    /// Of the schema; empty for none.
    pub type_name: &'static str,
    pub name: Cow<'a, str>,
    pub metadata: Vec<Field<'a>>,
    pub properties: Vec<Property<'a>>,
    pub children: Vec<Prim<'a>>,
    pub variant_sets: Vec<VariantSet<'a>>,
}

pub(super) struct VariantSet<'a> {
    pub name: &'static str,
    pub variants: Vec<Prim<'a>>,
}

pub(super) struct Property<'a> {
    /// With its namespaces, e.g. `primvars:st`.
    pub name: Cow<'a, str>,
    pub content: Content<'a>,
}

pub(super) enum Content<'a> {
    Attribute {
        /// As text has it, e.g. `texCoord2f[]`; the value is of the form that it wants.
        type_name: &'static str,
        is_uniform: bool,
        value: Option<Value<'a>>,
        /// Path of an attribute that gives the value instead.
        source: Option<String>,
        metadata: Vec<Field<'a>>,
    },
    /// Paths of its targets.
    Relationship(Vec<String>),
}

#[derive(Debug, Clone, PartialEq)]
pub(super) enum Value<'a> {
    Bool(bool),
    Int(i32),
    Float(f32),
    Double(f64),
    String(Cow<'a, str>),
    Token(Cow<'a, str>),
    /// Path of a file, relative to the layer's.
    Asset(String),
    Float3([f32; 3]),
    Float4([f32; 4]),
    Double3([f64; 3]),
    Dictionary(Vec<(Cow<'a, str>, Value<'a>)>),
    /// Names put before those of weaker layers.
    Prepended(Vec<&'static str>),
    /// Choices in variant sets.
    Selections(Vec<(&'static str, String)>),
    Arc(Arc),
    Ints(Cow<'a, [i32]>),
    /// So many times the same.
    Repeated(i32, usize),
    Int64s(Vec<i64>),
    Floats(Cow<'a, [f32]>),
    Float2s(Cow<'a, [Vec2]>),
    Float3s(Cow<'a, [Vec3]>),
    /// Numbers of 0…255 that mean 0…1.
    Unorm4s(&'a [[u8; 4]]),
    /// Real part first.
    Quatfs(Vec<[f32; 4]>),
    /// Rounded to half floats.
    Quaths(Vec<[f32; 4]>),
    Strings(Vec<Cow<'a, str>>),
}

/// A reference or payload, by the name of the metadata that it is the value of.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Arc {
    /// Path of the layer's file, relative to this one's.
    pub asset: String,
    /// Path of the prim in it.
    pub prim: String,
}

impl<'a> Prim<'a> {
    pub fn new(
        specifier: Specifier,
        type_name: &'static str,
        name: impl Into<Cow<'a, str>>,
    ) -> Self {
        Prim {
            specifier,
            type_name,
            name: name.into(),
            metadata: Vec::new(),
            properties: Vec::new(),
            children: Vec::new(),
            variant_sets: Vec::new(),
        }
    }

    pub fn def(type_name: &'static str, name: impl Into<Cow<'a, str>>) -> Self {
        Prim::new(Specifier::Def, type_name, name)
    }

    pub fn variant(name: impl Into<Cow<'a, str>>) -> Self {
        Prim::new(Specifier::Over, "", name)
    }

    pub fn meta(mut self, name: &'static str, value: Value<'a>) -> Self {
        self.metadata.push((name, value));
        self
    }

    pub fn kind(self, kind: &'static str) -> Self {
        self.meta("kind", Value::token(kind))
    }

    pub fn with(mut self, property: Property<'a>) -> Self {
        self.properties.push(property);
        self
    }

    /// An attribute that may differ between moments, as most are declared.
    pub fn attribute(
        self,
        type_name: &'static str,
        name: impl Into<Cow<'a, str>>,
        value: Value<'a>,
    ) -> Self {
        self.with(Property::attribute(type_name, name, Some(value)))
    }

    pub fn uniform(self, type_name: &'static str, name: &'static str, value: Value<'a>) -> Self {
        let mut property = Property::attribute(type_name, name, Some(value));
        if let Content::Attribute { is_uniform, .. } = &mut property.content {
            *is_uniform = true;
        }
        self.with(property)
    }

    /// One value a vertex, or an instance.
    pub fn varying(self, type_name: &'static str, name: &'static str, value: Value<'a>) -> Self {
        let mut property = Property::attribute(type_name, name, Some(value));
        if let Content::Attribute { metadata, .. } = &mut property.content {
            metadata.push(("interpolation", Value::token("vertex")));
        }
        self.with(property)
    }

    /// An attribute without a value: what a shader gives.
    pub fn declared(self, type_name: &'static str, name: &'static str) -> Self {
        self.with(Property::attribute(type_name, name, None))
    }

    pub fn connected(self, type_name: &'static str, name: &'static str, from: String) -> Self {
        let mut property = Property::attribute(type_name, name, None);
        if let Content::Attribute { source, .. } = &mut property.content {
            *source = Some(from);
        }
        self.with(property)
    }

    pub fn relationship(self, name: &'static str, targets: Vec<String>) -> Self {
        self.with(Property { name: name.into(), content: Content::Relationship(targets) })
    }

    pub fn child(mut self, child: Prim<'a>) -> Self {
        self.children.push(child);
        self
    }
}

impl<'a> Property<'a> {
    pub fn attribute(
        type_name: &'static str,
        name: impl Into<Cow<'a, str>>,
        value: Option<Value<'a>>,
    ) -> Self {
        let metadata = Vec::new();
        let content =
            Content::Attribute { type_name, is_uniform: false, value, source: None, metadata };
        Property { name: name.into(), content }
    }
}

impl<'a> Value<'a> {
    pub fn token(text: impl Into<Cow<'a, str>>) -> Self {
        Value::Token(text.into())
    }

    pub fn string(text: impl Into<Cow<'a, str>>) -> Self {
        Value::String(text.into())
    }

    /// Indices; those of a valid scene are far below 2³¹.
    pub fn indices(column: &'a [u32]) -> Self {
        Value::Ints(Cow::Borrowed(bytemuck::cast_slice(column)))
    }
}
