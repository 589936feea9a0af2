//! A rule file to begin with: every key, explained, with the values of what it builds on.
//!
//! Keys, words and ranges are those of the schema, so a template is never behind the program.

use serde_json::Value as Json;

use super::load::merged;
use super::node::{Entry, Node, Value};
use super::{builtin, load, schema};
use crate::diagnostic::{Error, Result};

/// What a template builds on where nothing is named.
pub const BASE: &str = "table3/13";
const WIDTH: usize = 100;
const MAX_NAME: usize = 64;

/// The text of a rule file for a species called `name`, a file name such as `betula_nana`, that
/// begins as `base`, a built-in species or a rule file. It grows a tree as it stands.
///
/// # Errors
/// A name that is no file name or is taken; a base that does not load.
pub fn template(name: &str, base: &str) -> Result<String> {
    check_name(name)?;
    // A file's own base: the new file may lie elsewhere, and holds every value anyway.
    let extends = match builtin::text(base) {
        Some(_) => Some(base.to_owned()),
        None => load(base)?.builds_on.filter(|b| builtin::text(b).is_some()),
    };
    let values = merged(base)?;
    let title = title(name);
    let mut out = Writer { text: String::new() };
    out.comment(&format!(
        "{title}, begun as {base}. Every key is here with its meaning; a line taken out falls back \
         to what the file extends, and that to the defaults."
    ));
    out.line("#");
    out.line(&format!(
        "#   larix species check --watch {name}.toml    checks and draws on every save"
    ));
    out.line(&format!("#   larix species show {name}.toml -o sheet.png"));
    out.line(&format!("#   larix tree {name}.toml -o {name}.glb"));
    out.line("");
    let schema = schema();
    let none = serde_json::Map::new();
    let properties = |schema: &Json| schema.get("properties").and_then(Json::as_object).cloned();
    let top = properties(&schema).unwrap_or(none);
    for (key, about) in top.iter().filter(|(_, about)| properties(about).is_none()) {
        let own = match key.as_str() {
            "extends" => match &extends {
                Some(base) => Some(Value::Text(base.clone())),
                None => continue,
            },
            "name" | "common" => Some(Value::Text(title.clone())),
            _ => values.get(key).map(|n| n.value.clone()),
        };
        out.key(key, about, own.as_ref());
    }
    for (section, about) in &top {
        let Some(keys) = properties(about) else { continue };
        let Some(node) = values.get(section) else { continue };
        out.line("");
        out.about(about);
        out.line(&format!("[{section}]"));
        let is_list = |key: &str| node.get(key).is_some_and(|n| !tables(n).is_empty());
        for (key, about) in keys.iter().filter(|(key, _)| !is_list(key)) {
            out.key(key, about, node.get(key).map(|n| &n.value));
        }
        for (key, about) in keys.iter().filter(|(key, _)| is_list(key)) {
            let items = node.get(key).map(tables).unwrap_or_default();
            let inner = about.get("items").and_then(properties).unwrap_or_default();
            for (i, item) in items.iter().enumerate() {
                out.line("");
                if i == 0 {
                    out.about(about);
                    about.get("items").into_iter().for_each(|each| out.about(each));
                }
                out.line(&format!("[[{section}.{key}]]"));
                for (key, about) in &inner {
                    let value = item.get(key).map(|n| &n.value);
                    match (i, value) {
                        (0, _) => out.key(key, about, value),
                        (_, Some(value)) => out.line(&format!("{key} = {}", toml(value))),
                        _ => {}
                    }
                }
            }
        }
    }
    Ok(out.text)
}

/// Letters, digits, `_` and `-`: a file name on every system, and a word on a command line.
fn check_name(name: &str) -> Result<()> {
    let is_plain = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '-';
    let wrong = |message: String, remedy: &str| Err(Error::new(message).remedy(remedy));
    if builtin::text(name).is_some() {
        return wrong(
            format!("`{name}` is a built-in species"),
            &format!("choose another name; `--from {name}` begins with its values"),
        );
    }
    let file = name.rsplit(['/', '\\']).next().unwrap_or(name);
    let stem = file.strip_suffix(".toml").unwrap_or(file);
    if file != name || stem != file {
        let path = if name.ends_with(".toml") { name.to_owned() } else { format!("{name}.toml") };
        // What is called like a built-in species, or not like a species at all, needs another name.
        let remedy = match check_name(stem) {
            Ok(()) if file == name => format!("give the name `{stem}`; the file is then `{path}`"),
            Ok(()) => format!("give the name alone, and the file with -o: `{stem} -o {path}`"),
            Err(_) => {
                "give a name alone, such as `betula_nana`; -o says where the file goes".into()
            }
        };
        let what = if stem == file { "a path" } else { "a file" };
        return wrong(format!("`{name}` is {what}, not a name"), &remedy);
    }
    if !name.starts_with(|c: char| c.is_ascii_alphanumeric())
        || !name.chars().all(is_plain)
        || name.len() > MAX_NAME
    {
        return wrong(
            format!("`{name}` can't be the name of a species"),
            "give one of letters, digits, `_` and `-`, such as `betula_nana`",
        );
    }
    Ok(())
}

/// `betula_nana` → `Betula nana`.
fn title(name: &str) -> String {
    let words = name.replace(['_', '-'], " ");
    let mut letters = words.chars();
    letters.next().map_or(String::new(), |c| c.to_uppercase().chain(letters).collect())
}

/// The items of a list of tables; none of anything else.
fn tables(node: &Node) -> Vec<&Node> {
    match &node.value {
        Value::Array(items) => {
            items.iter().filter(|n| matches!(n.value, Value::Table(_))).collect()
        }
        _ => Vec::new(),
    }
}

struct Writer {
    text: String,
}

impl Writer {
    fn line(&mut self, line: &str) {
        self.text.push_str(line);
        self.text.push('\n');
    }

    /// Words behind `#`, broken into lines.
    fn comment(&mut self, words: &str) {
        let mut line = String::from("#");
        for word in words.split_whitespace() {
            if line.len() > 1 && line.chars().count() + 1 + word.chars().count() > WIDTH {
                self.line(&std::mem::replace(&mut line, "#".into()));
            }
            line.push(' ');
            line.push_str(word);
        }
        self.line(&line);
    }

    fn about(&mut self, schema: &Json) {
        if let Some(words) = schema.get("description").and_then(Json::as_str) {
            self.comment(words);
        }
    }

    /// A key with its meaning above; without a value, an example that is commented out.
    fn key(&mut self, key: &str, about: &Json, value: Option<&Value>) {
        let mut words = about.get("description").and_then(Json::as_str).unwrap_or("").to_owned();
        if let Some(range) = range(about) {
            words = format!("{words} {range}.");
        }
        let choices = choices(about);
        if !choices.is_empty() {
            words = format!("{words} One of {}.", choices.join(", "));
        }
        self.comment(&words);
        for (name, about) in about.get("properties").and_then(Json::as_object).into_iter().flatten()
        {
            let words = about.get("description").and_then(Json::as_str).unwrap_or("");
            self.comment(&format!("· {name}: {words}"));
        }
        match value {
            Some(value) => self.line(&format!("{key} = {}", toml(value))),
            None => {
                let example = about.get("examples").and_then(|e| e.get(0)).map(from_json);
                if let Some(example) = example {
                    self.line(&format!("# {key} = {}", toml(&example)));
                }
            }
        }
    }
}

/// The bounds of a number, or of the numbers of a list, in words.
fn range(about: &Json) -> Option<String> {
    let mut about = about;
    while let Some(items) = about.get("items") {
        about = items;
    }
    let bound = |key: &str| about.get(key).and_then(Json::as_f64);
    match (bound("minimum"), bound("exclusiveMinimum"), bound("maximum")) {
        (Some(low), _, Some(high)) => Some(format!("From {low} to {high}")),
        (_, Some(low), Some(high)) => Some(format!("Above {low}, at most {high}")),
        (_, Some(low), None) => Some(format!("Above {low}")),
        _ => None,
    }
}

fn choices(about: &Json) -> Vec<&str> {
    let of = |key: &str| about.get(key).and_then(Json::as_array);
    match (of("oneOf"), of("enum")) {
        (Some(each), _) => each.iter().filter_map(|c| c.get("const")?.as_str()).collect(),
        (_, Some(each)) => each.iter().filter_map(Json::as_str).collect(),
        _ => Vec::new(),
    }
}

fn toml(value: &Value) -> String {
    match value {
        Value::Bool(b) => b.to_string(),
        Value::Integer(i) => i.to_string(),
        Value::Float(x) => format!("{x:?}"),
        Value::Text(text) => quoted(text),
        Value::Date => "\"\"".into(),
        Value::Array(items) => {
            let each: Vec<String> = items.iter().map(|n| toml(&n.value)).collect();
            let is_long = each.iter().map(|e| e.len() + 2).sum::<usize>() > WIDTH - 20;
            if is_long || items.iter().any(|n| matches!(n.value, Value::Text(_))) {
                format!("[\n{}]", each.iter().map(|e| format!("    {e},\n")).collect::<String>())
            } else {
                format!("[{}]", each.join(", "))
            }
        }
        Value::Table(entries) if entries.is_empty() => "{}".into(),
        Value::Table(entries) => {
            let is_bare = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '-';
            let each = entries.iter().map(|Entry { key, node, .. }| {
                let is_bare = !key.is_empty() && key.chars().all(is_bare);
                let key = if is_bare { key.clone() } else { quoted(key) };
                format!("{key} = {}", toml(&node.value))
            });
            format!("{{ {} }}", each.collect::<Vec<_>>().join(", "))
        }
    }
}

/// In single quotes where that spares escapes.
fn quoted(text: &str) -> String {
    let needs_escapes = |c: char| c == '\\' || c == '"' || c.is_control();
    if !text.chars().any(needs_escapes) {
        return format!("\"{text}\"");
    }
    if !text.contains('\'') && !text.contains(char::is_control) {
        return format!("'{text}'");
    }
    let escaped = text.chars().map(|c| match c {
        '\\' | '"' => format!("\\{c}"),
        c if c.is_control() => format!("\\u{:04X}", u32::from(c)),
        c => c.to_string(),
    });
    format!("\"{}\"", escaped.collect::<String>())
}

/// Where values of the schema stand: nowhere.
fn from_json(json: &Json) -> Value {
    let place = super::node::Place { source: usize::MAX, span: 0..0 };
    let node = |json: &Json| Node { place: place.clone(), value: from_json(json) };
    match json {
        Json::Bool(b) => Value::Bool(*b),
        Json::Number(n) => match n.as_i64() {
            Some(i) => Value::Integer(i),
            None => Value::Float(n.as_f64().unwrap_or_default()),
        },
        Json::String(text) => Value::Text(text.clone()),
        Json::Array(items) => Value::Array(items.iter().map(node).collect()),
        Json::Object(map) => {
            let entry = |(key, json): (&String, &Json)| {
                let key_place = place.clone();
                Entry { key: key.clone(), key_place, node: node(json) }
            };
            Value::Table(map.iter().map(entry).collect())
        }
        Json::Null => Value::Text(String::new()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::species::{builtin_names, load_text};

    /// Begun as any of them, a template is the same tree under another name.
    #[test]
    fn a_template_is_what_it_begins_as() {
        for base in builtin_names() {
            let text = template("own_tree", base).unwrap();
            let own = load_text("own_tree", &text)
                .unwrap_or_else(|e| panic!("{base}: {}\n{text}", crate::diagnostic::render(&e)));
            let base = load(base).unwrap();
            assert_eq!(own.name, "Own tree");
            assert_eq!(own.builds_on.as_deref(), Some(base.id.as_str()));
            assert_eq!(
                (own.kind, own.branching, own.luminance),
                (base.kind, base.branching, base.luminance)
            );
            assert_eq!((own.size, own.growth), (base.size, base.growth));
            assert_eq!((own.foliage, own.bark, own.rule), (base.foliage, base.bark, base.rule));
        }
    }

    #[test]
    fn a_template_has_every_key_and_fits_the_page() {
        let text = template("betula_nana", BASE).unwrap();
        let schema = schema();
        let top = schema["properties"].as_object().unwrap();
        for (key, about) in top {
            let keys = about.get("properties").and_then(Json::as_object);
            for key in keys.map_or(vec![key], |k| k.keys().collect()) {
                let says =
                    |line: &str| line.trim_start_matches("# ").starts_with(&format!("{key} ="));
                assert!(
                    text.lines().any(says) || text.contains(&format!(".{key}]]")),
                    "{key}\n{text}"
                );
            }
        }
        assert!(text.lines().all(|l| l.chars().count() <= WIDTH), "{text}");
        insta::assert_snapshot!("template", text);
    }

    #[test]
    fn names_are_file_names_and_free() {
        for name in ["", "a b", "../up", "a/b", ".hidden", "-o", "ель", "larix_sibirica", "x.toml"]
        {
            let error = template(name, BASE).unwrap_err();
            assert!(error.remedy_text().is_some(), "{name}");
        }
        for (name, says) in [
            ("/abs/path/x.toml", "`x -o /abs/path/x.toml`"),
            ("a/b", "`b -o a/b.toml`"),
            (r"C:\trees\x.toml", r"`x -o C:\trees\x.toml`"),
            ("x.toml", "give the name `x`; the file is then `x.toml`"),
            ("here/larix_sibirica.toml", "such as `betula_nana`; -o says"),
            ("here/", "such as `betula_nana`; -o says"),
        ] {
            let error = template(name, BASE).unwrap_err();
            assert!(error.remedy_text().unwrap().contains(says), "{error:?}");
        }
        let error = template("oak", "querkus_robur").unwrap_err();
        assert!(error.remedy_text().unwrap().contains("quercus_robur"), "{error:?}");
    }

    #[test]
    fn texts_survive_their_quotes() {
        assert!(["''", r#""""#].contains(&quoted("").as_str()));
        for text in ["plain", r"F[\F]", "it's", "a\"b\\c'd", "tab\there"] {
            let file = format!("name = {}", quoted(text));
            assert_eq!(
                load_text("x", &format!("extends = 'table3/13'\n{file}")).unwrap().name,
                text
            );
        }
    }
}
