//! The JSON schema of a rule file (draft 2020-12), for editors that complete and check TOML.
//!
//! Keys, types and words come from the structs that read a file, ranges from the table that checks
//! it, defaults from `defaults.toml`, so the schema can't drift from the program. It knows the
//! shape of a file alone: productions are strings to it.

use schemars::generate::SchemaSettings;
use serde_json::{Map, Value, json};

use super::check::{MAX_FACTOR, RANGES, Range};
use super::load::{Top, read_defaults};
use super::node::{self, Node};

/// The schema of a rule file.
pub fn schema() -> Value {
    let settings = SchemaSettings::draft2020_12().with(|s| s.inline_subschemas = true);
    let mut schema = settings.into_generator().into_root_schema_for::<Top>().to_value();
    if let Some(root) = schema.as_object_mut() {
        root.insert("title".into(), "Larix species".into());
        make_optional(root);
    }
    tidy(&mut schema);
    for (way, range) in RANGES {
        if let Some(key) = reached(&mut schema, way) {
            narrow(key, *range);
        }
    }
    if let Some(defaults) = read_defaults(&mut Vec::new()) {
        add_defaults(&mut schema, &defaults);
    }
    schema
}

/// What a file leaves unsaid comes from what it extends and from the defaults. Items of lists are
/// taken whole, so their keys stay required.
fn make_optional(table: &mut Map<String, Value>) {
    table.remove("required");
    let properties = table.get_mut("properties").and_then(Value::as_object_mut);
    for key in properties.into_iter().flat_map(|p| p.values_mut()) {
        key.as_object_mut().into_iter().for_each(make_optional);
    }
}

/// Takes out what TOML has not (null) and what says nothing to an author (widths of numbers).
fn tidy(schema: &mut Value) {
    match schema {
        Value::Object(map) => {
            map.remove("format");
            if map.get("default").is_some_and(Value::is_null) {
                map.remove("default");
            }
            if let Some(Value::Array(types)) = map.get_mut("type") {
                types.retain(|t| t != "null");
                if let [only] = &types[..] {
                    let only = only.clone();
                    map.insert("type".into(), only);
                }
            }
            if let Some(Value::String(words)) = map.get_mut("description") {
                *words = words.split_whitespace().collect::<Vec<_>>().join(" ");
            }
            map.values_mut().for_each(tidy);
        }
        Value::Array(items) => items.iter_mut().for_each(tidy),
        _ => {}
    }
}

/// The schema of the key that a dotted way leads to.
fn reached<'a>(schema: &'a mut Value, way: &str) -> Option<&'a mut Value> {
    way.split('.').try_fold(schema, |schema, key| {
        let table = if schema.get("items").is_some() { schema.get_mut("items")? } else { schema };
        table.get_mut("properties")?.get_mut(key)
    })
}

/// Bounds a number, or the numbers of a list.
fn narrow(mut schema: &mut Value, range: Range) {
    if let Range::Factors(end) = range {
        let pair = &mut schema["items"];
        let number = |high| json!({ "type": "number", "minimum": 0, "maximum": number(high) });
        pair["prefixItems"] = json!([number(end), number(MAX_FACTOR)]);
        pair.as_object_mut().and_then(|p| p.remove("items"));
        return;
    }
    while schema.get("items").is_some() {
        schema = &mut schema["items"];
    }
    match range {
        Range::Factors(_) => {}
        Range::Within(low, high) => {
            schema["minimum"] = number(low);
            schema["maximum"] = number(high);
        }
        Range::AboveZero(high) => {
            schema["exclusiveMinimum"] = json!(0);
            schema["maximum"] = number(high);
        }
    }
}

/// Whole numbers without a point.
fn number(x: f64) -> Value {
    if x.fract() == 0.0 { json!(x as i64) } else { json!(x) }
}

fn add_defaults(schema: &mut Value, defaults: &Node) {
    for entry in defaults.entries() {
        let Some(key) = schema.get_mut("properties").and_then(|p| p.get_mut(&entry.key)) else {
            continue;
        };
        match &entry.node.value {
            node::Value::Table(_) => add_defaults(key, &entry.node),
            _ => key["default"] = json(&entry.node),
        }
    }
}

fn json(node: &Node) -> Value {
    match &node.value {
        node::Value::Bool(b) => json!(b),
        node::Value::Integer(i) => json!(i),
        node::Value::Float(x) => json!(x),
        node::Value::Text(t) => json!(t),
        node::Value::Date => Value::Null,
        node::Value::Array(items) => items.iter().map(json).collect(),
        node::Value::Table(entries) => {
            entries.iter().map(|e| (e.key.clone(), json(&e.node))).collect::<Map<_, _>>().into()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::species::load::load_text;
    use crate::species::{builtin, load};

    fn toml_as_json(text: &str) -> Value {
        let sources = node::Sources(vec![node::Source { name: String::new(), text: text.into() }]);
        json(&node::read(&sources, 0).unwrap())
    }

    fn validator() -> jsonschema::Validator {
        jsonschema::draft202012::new(&schema()).unwrap()
    }

    #[test]
    fn it_is_a_schema_and_every_built_in_file_follows_it() {
        jsonschema::draft202012::meta::validate(&schema()).unwrap();
        let validator = validator();
        for (name, text) in builtin::FILES {
            let file = toml_as_json(text);
            let errors: Vec<String> = validator.iter_errors(&file).map(|e| e.to_string()).collect();
            assert!(errors.is_empty(), "{name}: {errors:?}");
        }
        assert!(validator.is_valid(&toml_as_json(include_str!("defaults.toml"))));
    }

    /// What the schema refuses the program refuses, and says so at the same key.
    #[test]
    fn it_refuses_what_the_program_refuses() {
        let validator = validator();
        for wrong in [
            "hieght_m = 3",
            "kind = 'tree'",
            "luminance = [1, 2, 3]",
            "luminance = [1, 256]",
            "[rule]\niteration = 3",
            "[rule]\niterations = 65",
            "[rule]\na = 0",
            "[rule]\nangles = { alpha = 361 }",
            "[size]\nheight_m = 0",
            "[size]\nheight_m = 151",
            "[size]\nheight_m = 'tall'",
            "[size]\nprofile = [[0, 2], [1, 0.5]]",
            "[growth]\nwhorl = 0",
            "[growth]\ndecay_by = { height = [[0, 101]] }",
            "[growth]\ndecay_by = { height = [[2, 1]] }",
            "[growth]\ndecay_by = { hieght = [[0, 1]] }",
            "[growth]\nwhorl = 1.5",
            "[[growth.order]]\nkeep = 1",
            "[foliage]\nshape = 'star'",
            "[foliage]\ncluster = 0",
            "[foliage]\nmodel = 3",
            "[foliage]\ncolour = [1, 2, 256]",
            "[bark]\ncolour = [1, 2]",
        ] {
            let text = format!("extends = 'table3/13'\n{wrong}");
            assert!(!validator.is_valid(&toml_as_json(&text)), "{wrong}");
            assert!(load_text("wrong", &text).is_err(), "{wrong}");
        }
    }

    #[test]
    fn every_range_is_in_it_and_every_number_has_one() {
        let mut schema = schema();
        for (way, _) in RANGES {
            assert!(reached(&mut schema, way).is_some(), "{way} is no key");
        }
        let mut todo = vec![(String::new(), &schema)];
        while let Some((way, key)) = todo.pop() {
            if let Some(properties) = key.get("properties").and_then(Value::as_object) {
                for (name, key) in properties {
                    assert!(key.get("description").is_some(), "{way}.{name} is not described");
                    todo.push((format!("{way}.{name}"), key));
                }
            }
            todo.extend(key.get("items").map(|items| (way.clone(), items)));
            let is_number = key["type"] == "number" || key["type"] == "integer";
            let is_bounded = key.get("maximum").is_some() || way == ".rule.a";
            assert!(!is_number || is_bounded, "{way} has no range");
        }
    }

    #[test]
    fn defaults_are_those_of_a_file_that_says_nothing() {
        let schema = schema();
        let species = load::load("table3/13").unwrap();
        let height = &schema["properties"]["size"]["properties"]["height_m"]["default"];
        assert_eq!(height.as_f64(), Some(f64::from(species.size.height_m)));
    }
}
