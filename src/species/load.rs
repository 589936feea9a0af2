//! A rule file, with what it extends, to a checked [`Species`].

use std::io::Read;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use schemars::JsonSchema;
use serde::Deserialize;
use serde::de::IgnoredAny;

use super::model::{
    Bark, Branching, DecayBy, Foliage, Fruit, Growth, Habit, Kind, OwnPart, Remark, Seasons, Size,
    Species, Young,
};
use super::near::suggest;
use super::node::{self, Node, Source, Sources, Value};
use super::{builtin, check, own, own_bark, rule};
use crate::diagnostic::{Error, Result};

/// Bytes of one rule file.
const MAX_BYTES: u64 = 4 << 20;
/// Files that one species may build on, one upon another.
const MAX_EXTENDS: usize = 16;
/// Errors shown of one file; a broken file repeats itself.
const MAX_ERRORS: usize = 40;

/// A species of tree: the rule it branches by, its size, growth and looks.
#[derive(Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[allow(dead_code)]
pub(super) struct Top {
    /// The file that this one is laid over, key by key: a built-in name such as `table3/13`, or a
    /// file beside this one with its `.toml`.
    #[serde(default)]
    extends: Option<String>,
    /// Scientific name.
    #[serde(default)]
    name: Option<String>,
    /// Name in plain words.
    #[serde(default)]
    common: Option<String>,
    /// The class that a photo shows it as.
    kind: Kind,
    /// How the main axis goes on.
    branching: Branching,
    /// Least and greatest luminance of its crowns in an aerial photo.
    #[serde(default)]
    #[schemars(extend("examples" = [[167, 171]]))]
    luminance: Option<[f32; 2]>,
    #[schemars(with = "rule::Section")]
    rule: IgnoredAny,
    #[schemars(with = "Size")]
    size: IgnoredAny,
    #[schemars(with = "Growth")]
    growth: IgnoredAny,
    #[schemars(with = "Young")]
    young: IgnoredAny,
    #[schemars(with = "Foliage")]
    foliage: IgnoredAny,
    #[schemars(with = "Bark")]
    bark: IgnoredAny,
    #[schemars(with = "Fruit")]
    fruit: IgnoredAny,
    #[schemars(with = "Seasons")]
    season: IgnoredAny,
}

/// The sections of a rule file with their keys; the first, without a name, is the top.
pub fn sections() -> [(&'static str, &'static [&'static str]); 11] {
    [
        ("", node::keys_of::<Top>()),
        ("rule", node::keys_of::<rule::Section>()),
        ("size", node::keys_of::<Size>()),
        ("growth", node::keys_of::<Growth>()),
        ("growth.decay_by", node::keys_of::<DecayBy>()),
        ("growth.order", node::keys_of::<Habit>()),
        ("young", node::keys_of::<Young>()),
        ("foliage", node::keys_of::<Foliage>()),
        ("bark", node::keys_of::<Bark>()),
        ("fruit", node::keys_of::<Fruit>()),
        ("season", node::keys_of::<Seasons>()),
    ]
}

/// Where a key belongs that is unknown where it stands.
pub(super) fn home(key: &str) -> Option<String> {
    let places: Vec<String> = sections()
        .iter()
        .filter(|(_, keys)| keys.contains(&key))
        .map(|(section, _)| match *section {
            "" => "at the top, before the first section".to_owned(),
            "growth.order" => "in [[growth.order]]".to_owned(),
            section => format!("in [{section}]"),
        })
        .collect();
    (!places.is_empty()).then(|| format!("it belongs {}", places.join(" or ")))
}

/// Names of the built-in species, in the order they are listed: species first, then Table 3.
pub fn builtin_names() -> Vec<&'static str> {
    builtin::FILES.iter().map(|(name, _)| *name).collect()
}

/// One line of the list of species.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize)]
pub struct Listed {
    pub id: &'static str,
    pub name: String,
    pub common: String,
    pub builds_on: Option<String>,
}

/// The built-in species with what each builds on.
///
/// # Errors
/// A built-in file that does not load.
pub fn list() -> Result<Vec<Listed>> {
    let listed = |id| {
        let Species { name, common, builds_on, .. } = load(id)?;
        Ok(Listed { id, name, common, builds_on })
    };
    builtin_names().into_iter().map(listed).collect()
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

/// A rule file, the files it extends and the model and picture they name, as far as they can be
/// read: those whose change changes the species. Built-in files are not among them.
pub fn files(path: &Path) -> Vec<PathBuf> {
    let mut files = vec![path.to_path_buf()];
    if let Ok(text) = read_file(path) {
        let shown = path.to_string_lossy().into_owned();
        let mut sources = Sources(vec![Source { name: shown, text: text.into() }]);
        let folder = Some(path.parent().unwrap_or(Path::new("")));
        let chain = read_chain("", folder, &mut sources, &mut Vec::new());
        let bases = sources.0.iter().skip(1).map(|s| s.name.as_str());
        let written = bases.filter(|name| builtin::text(name.trim_end_matches(".toml")).is_none());
        files.extend(written.map(PathBuf::from));
        let own = chain.iter().flatten().flat_map(|node| {
            OWN_FILES.iter().filter_map(|[section, key]| node.get(section)?.get(key))
        });
        files.extend(own.filter_map(|node| own_path(node, &sources)));
    }
    files
}

/// All keys of a loadable species with their values: its files laid over each other and over the
/// defaults.
pub(super) fn merged(name_or_path: &str) -> Result<Node> {
    load(name_or_path)?;
    let text = match builtin::text(name_or_path) {
        Some(text) => text.to_owned(),
        None => read_file(Path::new(name_or_path))?,
    };
    let folder = match builtin::text(name_or_path) {
        Some(_) => None,
        None => Path::new(name_or_path).parent(),
    };
    let mut sources = Sources(vec![Source { name: name_or_path.to_owned(), text: text.into() }]);
    let mut errors = Vec::new();
    let chain = read_chain(name_or_path, folder, &mut sources, &mut errors);
    match (chain, read_defaults(&mut errors)) {
        (Some(chain), Some(defaults)) if errors.is_empty() => Ok(lay(chain, defaults)),
        _ => Err(Error::several(errors)),
    }
}

/// The file over what it extends, nearest first, over the defaults; a picture of bark over what was
/// drawn below it.
fn lay(chain: Vec<Node>, defaults: Node) -> Node {
    let mut merged = chain.into_iter().rev().fold(defaults, |base, node| node.over(base));
    if let Some(bark) = merged.get_mut("bark") {
        own_bark::cover(bark);
    }
    merged
}

fn unknown(name: &str) -> String {
    let names = builtin_names();
    if let Some(near) = super::near::nearest(name, &names) {
        return format!("did you mean `{near}`?");
    }
    let like = called_like(name);
    match like.is_empty() {
        true => format!("{}.", suggest(name, &names)),
        false => format!("did you mean {}?", like.join(" or ")),
    }
}

/// Built-in species with that in one of their names, as they are shown.
fn called_like(name: &str) -> Vec<String> {
    const SHORTEST: usize = 3;
    let plain = |text: &str| text.to_lowercase().replace([' ', '-'], "_");
    let name = plain(name);
    if name.len() < SHORTEST {
        return Vec::new();
    }
    let all = list().unwrap_or_default().into_iter();
    let like = all.filter(|l| l.id.contains(&name) || plain(&l.common).contains(&name));
    like.map(|l| format!("`{}` ({})", l.id, l.common)).collect()
}

fn read_file(path: &Path) -> Result<String> {
    // What a pipe holds is not known beforehand.
    let read = std::fs::File::open(path).and_then(|file| {
        let mut bytes = Vec::new();
        file.take(MAX_BYTES + 1).read_to_end(&mut bytes).map(|_| bytes)
    });
    if read.as_ref().is_ok_and(|bytes| bytes.len() as u64 > MAX_BYTES) {
        return Err(Error::new(format!(
            "more than the {MAX_BYTES} bytes that a rule file may have"
        ))
        .in_file(path)
        .remedy("name a rule file; scans and pictures go elsewhere"));
    }
    let text = read.and_then(|bytes| {
        String::from_utf8(bytes)
            .map_err(|e| std::io::Error::new(std::io::ErrorKind::InvalidData, e))
    });
    text.map_err(|e| {
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
    let mut sources = Sources(vec![Source { name: shown.to_owned(), text: text.into() }]);
    let chain = read_chain(id, folder, &mut sources, errors)?;
    let defaults = read_defaults(errors)?;
    let builds_on = chain.first().and_then(|n| n.get("extends")).and_then(Node::as_text);
    let builds_on = builds_on.map(str::to_owned);
    let mut own = |key: &str| {
        let node = chain.first()?.get(key)?;
        check::a_name(key, node, &sources, errors);
        node.as_text().map(|name| name.trim().to_owned())
    };
    let (name, common) = (own("name"), own("common"));
    let merged = lay(chain, defaults.clone());

    check::finite(&merged, &sources, errors);
    let top: Top = node::typed(&merged, &defaults, &sources, errors)?;
    let mut section = Sections { merged: &merged, defaults: &defaults, sources: &sources, errors };
    let size: Option<Size> = section.read("size");
    let growth: Option<Growth> = section.read("growth");
    let young: Option<Young> = section.read("young");
    let foliage: Option<Foliage> = section.read("foliage");
    let bark: Option<Bark> = section.read("bark");
    let fruit: Option<Fruit> = section.read("fruit");
    let season: Option<Seasons> = section.read("season");
    let rule = match (merged.get("rule"), defaults.get("rule")) {
        (Some(rule), Some(defaults)) => {
            let of_tree = size.as_ref().map_or([f64::NAN; 3], Size::of_tree);
            rule::compile(rule, of_tree, defaults, &sources, errors)
        }
        _ => None,
    };
    let places = (&merged, &sources, folder.is_some());
    let own_model = own_file(places, ["foliage", "model"], own::model, errors);
    let own_picture = own_file(places, ["foliage", "picture"], own::twig_picture, errors);
    let own_fruit = own_file(places, ["fruit", "model"], own::model, errors);
    let read = own_bark::read(merged.get("bark")?, &sources, errors);
    let (own_bark, of_bark) =
        read.map_or((None, Vec::new()), |own| (Some(own.value), own.warnings));
    let of_model = |model: &Option<Arc<own::Model>>| {
        model.as_ref().map_or_else(Vec::new, |model| model.remarks.clone())
    };
    let mut of_fruit = of_model(&own_fruit);
    of_fruit.extend(modelless(merged.get("fruit")?, &sources));
    let all = [
        (OwnPart::Bark, of_bark),
        (OwnPart::Leaves, of_model(&own_model)),
        (OwnPart::Fruit, of_fruit),
    ];
    let remarks =
        all.into_iter().flat_map(|(on, of)| of.into_iter().map(move |text| Remark { on, text }));
    let remarks = remarks.collect();
    let name = name.unwrap_or_else(|| id.to_owned());
    let mut species = Species {
        id: id.to_owned(),
        common: common.unwrap_or_else(|| name.clone()),
        name,
        builds_on,
        kind: top.kind,
        branching: top.branching,
        luminance: top.luminance,
        size: size?,
        growth: growth?,
        young: young?,
        foliage: foliage?,
        bark: bark?,
        own_model,
        own_picture,
        fruit: fruit?,
        own_fruit,
        season: season?,
        own_bark,
        remarks,
        rule: rule?,
    };
    if let Some(picture) = species.own_leaves() {
        species.foliage.colour = own::leaf_colour(picture);
    }
    check::ranges(&species, &merged, &sources, errors);
    Some(species)
}

/// What is told of a section that says how its model is borne, and never which.
fn modelless(fruit: &Node, sources: &Sources) -> Option<String> {
    let given = fruit.entries().iter().find(|entry| !entry.node.place.is_nowhere())?;
    let file = sources.0.get(given.node.place.source)?;
    let is_left_out = fruit.get("model").is_none();
    is_left_out.then(|| {
        let (file, key) = (&file.name, &given.key);
        format!(
            "{file}: `fruit.{key}` bears nothing without a `fruit.model`; name an OBJ file, or \"\""
        )
    })
}

/// Keys that name files of the user's own.
const OWN_FILES: [[&str; 2]; 6] = [
    ["foliage", "model"],
    ["foliage", "picture"],
    ["fruit", "model"],
    ["bark", "picture"],
    ["bark", "normal"],
    ["bark", "roughness"],
];

/// The path that a key names, from the folder of the file that says so.
fn own_path(node: &Node, sources: &Sources) -> Option<PathBuf> {
    let name = node.as_text().filter(|name| !name.is_empty())?;
    let file = sources.0.get(node.place.source)?;
    Some(Path::new(&file.name).parent().unwrap_or(Path::new("")).join(name))
}

/// Reads the file that a key of a section names, if it names one. `has_folder`: the rule is a
/// file, not a text alone.
fn own_file<T>(
    (merged, sources, has_folder): (&Node, &Sources, bool),
    [section, key]: [&str; 2],
    read: fn(&Path) -> Result<T>,
    errors: &mut Vec<Error>,
) -> Option<Arc<T>> {
    let node = merged.get(section)?.get(key)?;
    let path = own_path(node, sources)?;
    let mut fail = |what: String, remedy: &str| {
        errors.push(sources.error(&node.place, what, "named here").remedy(remedy));
        None
    };
    if !has_folder {
        return fail(format!("`{key}` names a file"), "save the rule as a file beside it");
    }
    match read(&path) {
        Ok(own) => Some(Arc::new(own)),
        Err(e) => fail(format!("`{key}`: {e}"), e.remedy_text().unwrap_or("give another file")),
    }
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

pub(super) fn read_defaults(errors: &mut Vec<Error>) -> Option<Node> {
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
        if links.len() >= MAX_EXTENDS {
            let message = format!("`extends` goes over more than {MAX_EXTENDS} files");
            let error = sources.error(&place, message, "one too many");
            errors.push(error.remedy("lay the file over one that is nearer the base"));
            return None;
        }
        if links.iter().any(|l| l.identity == link.identity) {
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
        let source = Source { name: format!("{extends}.toml"), text: text.into() };
        return Ok((Link { identity: extends.to_owned(), folder: None }, source));
    }
    if let (Some(folder), true) = (&from.folder, extends.ends_with(".toml")) {
        let path = folder.join(extends);
        return match read_file(&path) {
            Ok(text) => Ok((
                Link { identity: identity(&path), folder: path.parent().map(Path::to_path_buf) },
                Source { name: path.to_string_lossy().into_owned(), text: text.into() },
            )),
            Err(e) => Err(format!("{}; it is looked for beside this file", e.message())),
        };
    }
    Err(format!("{} A file beside this one is named with its .toml", unknown(extends)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn every_built_in_file_loads_and_every_file_is_built_in() {
        for name in builtin_names() {
            load(name).unwrap_or_else(|e| panic!("{name}: {}", crate::diagnostic::render(&e)));
        }
        let folder = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/species"));
        for (sub, prefix) in [("", ""), ("table3", "table3/")] {
            for entry in std::fs::read_dir(folder.join(sub)).unwrap() {
                let path = entry.unwrap().path();
                if path.extension().is_some_and(|e| e == "toml") {
                    let name = format!("{prefix}{}", path.file_stem().unwrap().to_string_lossy());
                    assert!(builtin_names().contains(&name.as_str()), "{name} is not built in");
                }
            }
        }
    }

    /// What has no size beforehand, and no end.
    #[cfg(unix)]
    #[test]
    fn a_rule_file_without_an_end_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("endless.toml");
        std::os::unix::fs::symlink("/dev/zero", &path).unwrap();
        let error = load(&path.to_string_lossy()).unwrap_err();
        assert!(error.to_string().contains("more than the 4194304 bytes"), "{error}");
        assert_eq!(files(&path), [path]);
    }

    #[test]
    fn sections_merge_key_by_key() {
        let text = "extends = 'table3/10'\nname = 'Mine'\n[rule]\nangles = { alpha = 45, '!' = 10 }\n[size]\nheight_m = 3";
        let own = load_text("mine", text).unwrap();
        let base = load("table3/10").unwrap();
        assert_eq!((own.name.as_str(), own.common.as_str()), ("Mine", "Mine"));
        assert_eq!(own.builds_on.as_deref(), Some("table3/10"));
        assert_eq!(own.size.height_m, 3.0);
        assert_eq!(own.size.profile, base.size.profile);
        let angle = |rule: &rule::Rule, c: char| {
            let symbol = rule.symbols.iter().find(|s| s.name == c).unwrap();
            match symbol.action {
                rule::Action::Turn { angle, .. } => angle.to_degrees().abs().round(),
                _ => panic!("{c} does not turn"),
            }
        };
        // The file's own Greek letter beats the base's symbols; its own symbol beats both.
        let angles = |rule| ['^', '@', '!', '#'].map(|c| angle(rule, c));
        assert_eq!(angles(&base.rule), [30.0, 30.0, 50.0, 50.0]);
        assert_eq!(angles(&own.rule), [45.0, 30.0, 10.0, 50.0]);
    }

    #[test]
    fn files_extend_files_and_circles_are_named() {
        let folder = tempfile::tempdir().unwrap();
        let write = |name: &str, text: &str| {
            let path = folder.path().join(name);
            std::fs::write(&path, text).unwrap();
            path.to_string_lossy().into_owned()
        };
        write("base.toml", "extends = 'table3/13'\n[size]\nheight_m = 7\ncrown_diameter_m = 2");
        let top = write("top.toml", "extends = 'base.toml'\n[size]\nheight_m = 9");
        let species = load(&top).unwrap();
        assert_eq!((species.size.height_m, species.size.crown_diameter_m), (9.0, 2.0));
        assert_eq!(species.id, "top");

        write("a.toml", "extends = 'b.toml'");
        let b = write("b.toml", "extends = 'a.toml'");
        let error = load(&b).unwrap_err();
        assert_eq!(error.message(), "`extends` goes in a circle");
        assert!(error.remedy_text().unwrap().matches(" → ").count() == 2);
        let own = write("own.toml", "extends = 'own.toml'");
        assert_eq!(load(&own).unwrap_err().message(), "`extends` goes in a circle");
    }

    #[test]
    fn a_mistake_in_the_base_is_shown_in_the_base() {
        let folder = tempfile::tempdir().unwrap();
        let base = folder.path().join("base.toml");
        std::fs::write(&base, "extends = 'table3/13'\n[size]\nhieght_m = 7").unwrap();
        let top = folder.path().join("top.toml");
        std::fs::write(&top, "extends = 'base.toml'").unwrap();
        let shown = crate::diagnostic::render(&load(&top.to_string_lossy()).unwrap_err());
        assert!(shown.contains("base.toml:3:1"), "{shown}");
    }

    #[test]
    fn names_can_be_read() {
        for (key, name) in [("name", ""), ("name", " \t"), ("common", "a\\nb"), ("common", "")] {
            let text = format!("{key} = \"{name}\"\nextends = 'table3/13'");
            let error = load_text("x", &text).unwrap_err();
            assert!(error.message().starts_with(&format!("`{key}` ")), "{error}");
            let shown = crate::diagnostic::render(&error);
            assert!(shown.contains(&format!("x.toml:1:{}", key.len() + 4)), "{shown}");
        }
        let named = load_text("x", "name = ' Ива '\nextends = 'table3/13'").unwrap();
        assert_eq!((named.name.as_str(), named.common.as_str()), ("Ива", "Ива"));
    }

    #[test]
    fn strangers_are_named() {
        let error = load("larix_sibrica").unwrap_err();
        assert_eq!(error.message(), "unknown species `larix_sibrica`");
        assert!(error.remedy_text().unwrap().contains("did you mean `larix_sibirica`?"));
        for (typed, meant) in [
            ("oak", "`quercus_robur` (Pedunculate oak)?"),
            ("Silver Birch", "did you mean `betula_pendula` (Silver birch)?"),
            ("quercus", "did you mean `quercus_robur`"),
        ] {
            let told = load(typed).unwrap_err().remedy_text().unwrap().to_owned();
            assert!(told.contains(meant), "{told}");
        }
        assert!(load("baobab").unwrap_err().remedy_text().unwrap().starts_with("known here: "));
        let error = load("nowhere/at_all.toml").unwrap_err();
        assert!(error.to_string().starts_with("nowhere/at_all.toml: can't read the rule file"));
    }

    /// Whatever an author types, the answer is a species or an error that can be shown.
    fn survives(text: &str) {
        if let Err(error) = load_text("any", text) {
            assert!(error.count() > 0);
            assert!(error.labels_lie_within(), "{error:?}");
            let _ = crate::diagnostic::render(&error);
        }
    }

    /// What no author types, and a program might: everything is answered, and soon.
    #[test]
    fn extremes_are_answered() {
        let deep = 100_000;
        let rule = |axiom: &str, production: &str| {
            format!(
                "[rule]\naxiom = '{axiom}'\nproductions = ['{production}']\nangles = {{ alpha = 30 }}"
            )
        };
        let many = |piece: &str| piece.repeat(deep);
        let production = |piece: &str| rule("F(a)", &format!("F(a) -> F(a){}", many(piece)));
        for text in [
            production("["),
            production("]"),
            production("[^F(a)]"),
            production("é"),
            production(" \u{2003}"),
            production("-> "),
            rule("F(a)", &format!("F(a) -> F({}a{})", many("("), many(")"))),
            rule("F(a)", &format!("F(a) -> F({}a)", many("-"))),
            rule("F(a)", &format!("F(a) -> F({}a)", many("!"))),
            rule("F(a)", &format!("F(a) -> F({}a)", many("2("))),
            rule("F(a)", &format!("F(a) -> F({}a)", many("sqrt("))),
            rule("F(a)", &format!("F(a) -> F(a{})", many("^a"))),
            rule("F(a)", &format!("F(a) -> F(a{})", many("+a"))),
            rule("F(a)", &format!("F(a) -> F(a{})", many(",a"))),
            rule("F(a)", &format!("F(a) -> F({})", many("9"))),
            rule("F(a)", &format!("F(a) -> F(1e{})", many("9"))),
            rule("F(a)", "F(a) -> F(1e308*1e308)"),
            rule("F(a)", &format!("F({}) -> F(1)", many("a"))),
            rule("F(a)", &format!("{} F(a) -> F(a)", many("A"))),
            rule("F(a)", &format!("F(a) > {} -> F(a)", many("[A"))),
            rule(&many("F(a)"), "F(a) -> F(a)"),
            rule(
                &('a'..='z').chain('а'..='я').chain('一'..='僿').collect::<String>(),
                "F(a) -> F(a)",
            ),
            format!("[rule]\nproductions = [{}]", many("'F -> F',")),
            format!(
                "[rule]\naxiom = 'F'\nconstants = {{ {}z = 1 }}",
                (0..deep).map(|i| format!("k{i} = 1, ")).collect::<String>()
            ),
            format!("[rule]\n{}", (0..20_000).map(|i| format!("k{i} = 1\n")).collect::<String>()),
            format!("x = {}", many("[")),
            format!("x = {}1{}", many("["), many("]")),
            format!("x{} = 1", many(".x")),
            format!("[x{}]", many(".x")),
            format!("x = {}", many("{ x = ")),
            format!("# {}", many("long")),
            format!("name = '{}'", many("long")),
            "[size]\nheight_m = 1e999".into(),
            "[size]\nheight_m = 99999999999999999999999999".into(),
            "[rule]\niterations = 99999999999999999999".into(),
        ] {
            survives(&text);
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(400))]

        #[test]
        fn no_bytes_panic(bytes in prop::collection::vec(any::<u8>(), 0..300)) {
            survives(&String::from_utf8_lossy(&bytes));
        }

        #[test]
        fn no_shuffled_file_panics(
            name in prop::sample::select(builtin_names()),
            cuts in prop::collection::vec((any::<prop::sample::Index>(), any::<prop::sample::Index>()), 1..6),
        ) {
            let mut text: Vec<char> = builtin::text(name).unwrap_or("").chars().collect();
            for (from, to) in cuts {
                let (i, j) = (from.index(text.len()), to.index(text.len()));
                let piece: Vec<char> = text[i..(i + 12).min(text.len())].to_vec();
                text.splice(j..j, piece);
            }
            survives(&text.into_iter().collect::<String>());
        }

        #[test]
        fn no_text_panics(text in "\\PC{0,200}") {
            survives(&text);
        }

        #[test]
        fn no_rule_panics(
            axiom in "[FAXS\\[\\]()a0-9.,^&+*/ é→-]{0,40}",
            production in "[FAXS\\[\\]()<>:a0-9.,^&|!=+*/ é→-]{0,60}",
            heading in any::<bool>(),
        ) {
            let turtle = if heading { "heading" } else { "upright" };
            survives(&format!("[rule]\nturtle = '{turtle}'\naxiom = '{axiom}'\nproductions = ['F(a) -> {production}', '{production}']"));
        }

        #[test]
        fn no_edit_of_a_sound_file_panics(at in 0usize..400, put in "\\PC{0,3}", cut in 0usize..4) {
            let mut text: Vec<char> = builtin::text("table3/09").unwrap_or("").chars().collect();
            let at = at.min(text.len());
            let end = (at + cut).min(text.len());
            text.splice(at..end, put.chars());
            survives(&text.into_iter().collect::<String>());
        }
    }
}
