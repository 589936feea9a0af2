//! A rule file, with what it extends, to a checked [`Species`].

use std::path::{Path, PathBuf};

use serde::Deserialize;
use serde::de::IgnoredAny;

use super::model::{Bark, Branching, Foliage, Growth, Kind, Size, Species};
use super::near::suggest;
use super::node::{self, Node, Source, Sources, Value};
use super::{builtin, check, rule};
use crate::diagnostic::{Error, Result};

/// Files that one species may build on, one upon another.
const MAX_EXTENDS: usize = 16;
/// Errors shown of one file; a broken file repeats itself.
const MAX_ERRORS: usize = 40;

/// The keys outside sections, and the sections by name.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
#[allow(dead_code)]
struct Top {
    #[serde(default)]
    name: Option<String>,
    #[serde(default)]
    common: Option<String>,
    #[serde(default)]
    extends: Option<String>,
    kind: Kind,
    branching: Branching,
    #[serde(default)]
    luminance: Option<[f32; 2]>,
    rule: IgnoredAny,
    size: IgnoredAny,
    growth: IgnoredAny,
    foliage: IgnoredAny,
    bark: IgnoredAny,
}

/// Names of the built-in species, in the order they are listed: species first, then Table 3.
pub fn builtin_names() -> Vec<&'static str> {
    builtin::FILES.iter().map(|(name, _)| *name).collect()
}

/// Loads a built-in species by name, or a rule file by path.
///
/// # Errors
/// An unknown name, an unreadable file, or anything wrong in the file or in what it extends.
pub fn load(name_or_path: &str) -> Result<Species> {
    if let Some(text) = builtin::text(name_or_path) {
        return load_text(name_or_path, text);
    }
    let path = Path::new(name_or_path);
    if path.extension().is_some_and(|e| e == "toml") || path.is_file() {
        let text = read_file(path)?;
        let id = path.file_stem().map_or_else(String::new, |s| s.to_string_lossy().into_owned());
        return build(&id, name_or_path, &text, path.parent());
    }
    Err(Error::new(format!("unknown species `{name_or_path}`")).remedy(format!(
        "{} A rule file is named by its path, ending in .toml",
        unknown(name_or_path)
    )))
}

/// Loads a rule file from its text; `name` is its id and stands in messages.
///
/// # Errors
/// As [`load`].
pub fn load_text(name: &str, text: &str) -> Result<Species> {
    build(name, &format!("{name}.toml"), text, None)
}

/// Checks a rule file: what [`load`] would say of it.
pub fn check_file(path: &Path) -> Result<()> {
    load(&path.to_string_lossy()).map(|_| ())
}

fn unknown(name: &str) -> String {
    let names = builtin_names();
    match super::near::nearest(name, &names) {
        Some(near) => format!("did you mean `{near}`?"),
        None => format!("{}.", suggest(name, &names)),
    }
}

fn read_file(path: &Path) -> Result<String> {
    std::fs::read_to_string(path).map_err(|e| {
        let remedy = match e.kind() {
            std::io::ErrorKind::NotFound => "check the path",
            std::io::ErrorKind::InvalidData => "save the file as UTF-8",
            _ => "check that the file can be read",
        };
        Error::new(format!("can't read the rule file: {e}")).in_file(path).remedy(remedy)
    })
}

/// One file of the chain and where names in its `extends` are looked up.
struct Link {
    identity: String,
    folder: Option<PathBuf>,
}

fn build(id: &str, shown: &str, text: &str, folder: Option<&Path>) -> Result<Species> {
    let mut errors = Vec::new();
    let species = build_reporting(id, shown, text, folder, &mut errors);
    match species {
        Some(species) if errors.is_empty() => Ok(species),
        _ => {
            let more = errors.len().saturating_sub(MAX_ERRORS);
            errors.truncate(MAX_ERRORS);
            if more > 0 {
                errors.push(Error::new(format!("… and {more} more errors")).in_file(shown));
            }
            Err(Error::several(errors))
        }
    }
}

fn build_reporting(
    id: &str,
    shown: &str,
    text: &str,
    folder: Option<&Path>,
    errors: &mut Vec<Error>,
) -> Option<Species> {
    let mut sources = Sources(vec![Source { name: shown.to_owned(), text: text.to_owned() }]);
    let chain = read_chain(id, folder, &mut sources, errors)?;
    let defaults = read_defaults(errors)?;
    let builds_on = chain.first().and_then(|n| n.get("extends")).and_then(Node::as_text);
    let builds_on = builds_on.map(str::to_owned);
    let own = |key: &str| {
        chain.first().and_then(|n| n.get(key)).and_then(Node::as_text).map(str::to_owned)
    };
    let (name, common) = (own("name"), own("common"));
    // The file over what it extends, nearest first, over the defaults.
    let merged = chain.into_iter().rev().fold(defaults.clone(), |base, node| node.over(base));

    check::finite(&merged, &sources, errors);
    let top: Top = node::typed(&merged, &defaults, &sources, errors)?;
    let mut section = Sections { merged: &merged, defaults: &defaults, sources: &sources, errors };
    let size: Option<Size> = section.read("size");
    let growth: Option<Growth> = section.read("growth");
    let foliage: Option<Foliage> = section.read("foliage");
    let bark: Option<Bark> = section.read("bark");
    let rule = match (merged.get("rule"), defaults.get("rule")) {
        (Some(rule), Some(defaults)) => rule::compile(rule, defaults, &sources, errors),
        _ => None,
    };
    let name = name.unwrap_or_else(|| id.to_owned());
    let species = Species {
        id: id.to_owned(),
        common: common.unwrap_or_else(|| name.clone()),
        name,
        builds_on,
        kind: top.kind,
        branching: top.branching,
        luminance: top.luminance,
        size: size?,
        growth: growth?,
        foliage: foliage?,
        bark: bark?,
        rule: rule?,
    };
    check::ranges(&species, &merged, &sources, errors);
    Some(species)
}

struct Sections<'a> {
    merged: &'a Node,
    defaults: &'a Node,
    sources: &'a Sources,
    errors: &'a mut Vec<Error>,
}

impl Sections<'_> {
    fn read<T: serde::de::DeserializeOwned>(&mut self, key: &str) -> Option<T> {
        let (node, defaults) = (self.merged.get(key)?, self.defaults.get(key)?);
        node::typed(node, defaults, self.sources, self.errors)
    }
}

fn read_defaults(errors: &mut Vec<Error>) -> Option<Node> {
    let sources = Sources(vec![Source {
        name: "defaults.toml".into(),
        text: include_str!("defaults.toml").into(),
    }]);
    match node::read(&sources, 0) {
        Ok(mut node) => {
            // No place in the species' own files.
            node.detach();
            Some(node)
        }
        Err(found) => {
            errors.extend(found);
            None
        }
    }
}

/// Reads the file and everything it extends, nearest first.
fn read_chain(
    id: &str,
    folder: Option<&Path>,
    sources: &mut Sources,
    errors: &mut Vec<Error>,
) -> Option<Vec<Node>> {
    let identity = match folder {
        Some(_) => sources.0.first().map(|s| identity(Path::new(&s.name))).unwrap_or_default(),
        None => id.to_owned(),
    };
    let mut links = vec![Link { identity, folder: folder.map(Path::to_path_buf) }];
    let mut chain = Vec::new();
    loop {
        let at = chain.len();
        match node::read(sources, at) {
            Ok(node) => chain.push(node),
            Err(found) => {
                errors.extend(found);
                return None;
            }
        }
        let node = chain.last_mut()?;
        let extends = node.get("extends").cloned();
        if at > 0 {
            // A base's own names are not the species'.
            if let Value::Table(entries) = &mut node.value {
                entries.retain(|e| !["extends", "name", "common"].contains(&e.key.as_str()));
            }
        }
        // A value of another type is reported with the rest of the keys.
        let Some((extends, place)) =
            extends.as_ref().and_then(|n| Some((n.as_text()?, n.place.clone())))
        else {
            return Some(chain);
        };
        let from = links.last()?;
        let (link, source) = match find(extends, from) {
            Ok(found) => found,
            Err(remedy) => {
                errors.push(
                    sources
                        .error(&place, format!("`extends`: no rule file `{extends}`"), "unknown")
                        .remedy(remedy),
                );
                return None;
            }
        };
        if links.iter().any(|l| l.identity == link.identity) || links.len() >= MAX_EXTENDS {
            let mut names: Vec<&str> = links.iter().map(|l| l.identity.as_str()).collect();
            names.push(&link.identity);
            errors.push(
                sources
                    .error(&place, "`extends` goes in a circle", "closes the circle")
                    .remedy(format!("break one of the steps {}", names.join(" → "))),
            );
            return None;
        }
        sources.0.push(source);
        links.push(link);
    }
}

fn identity(path: &Path) -> String {
    path.canonicalize().unwrap_or_else(|_| path.to_path_buf()).to_string_lossy().into_owned()
}

/// The file that `extends` names: a built-in, or a path beside the file that says so.
fn find(extends: &str, from: &Link) -> std::result::Result<(Link, Source), String> {
    if let Some(text) = builtin::text(extends) {
        let source = Source { name: format!("{extends}.toml"), text: text.to_owned() };
        return Ok((Link { identity: extends.to_owned(), folder: None }, source));
    }
    if let (Some(folder), true) = (&from.folder, extends.ends_with(".toml")) {
        let path = folder.join(extends);
        return match read_file(&path) {
            Ok(text) => Ok((
                Link { identity: identity(&path), folder: path.parent().map(Path::to_path_buf) },
                Source { name: path.to_string_lossy().into_owned(), text },
            )),
            Err(e) => Err(format!("{}; it is looked for beside this file", e.message())),
        };
    }
    Err(format!("{} A file beside this one is named with its .toml", unknown(extends)))
}
