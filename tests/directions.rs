//! The directions between rooms, as ARCHITECTURE.md states them, checked against the source.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

/// Rooms that each room may name. Everyone may use those at the bottom.
const BOTTOM: [&str; 6] = ["frame", "seed", "diagnostic", "raster", "heap", "work"];

fn allowed() -> BTreeMap<&'static str, &'static [&'static str]> {
    BTreeMap::from([
        ("frame", &[][..]),
        ("seed", &[]),
        ("diagnostic", &[]),
        ("work", &[]),
        ("heap", &[]),
        ("cache", &[]),
        ("raster", &[]),
        ("scan", &["voxel"]),
        ("voxel", &[]),
        ("ground", &["scan", "voxel"]),
        ("terrain", &["ground", "mesh"]),
        ("crown", &["ground", "terrain", "voxel"]),
        ("species", &["crown", "ground", "terrain"]),
        ("skeleton", &["species", "crown"]),
        ("mesh", &["skeleton", "species", "texture"]),
        ("texture", &["species"]),
        ("scene", &["mesh"]),
        ("export", &["scene", "mesh"]),
        ("render", &["scene", "mesh"]),
        ("landscape", &["ground", "terrain", "render"]),
        ("lod", &["mesh", "render", "scene", "skeleton"]),
        ("inventory", &["crown"]),
        ("simulate", &["scan", "species"]),
        ("report", &[]),
    ])
}

/// Rooms that may name any other.
const FREE: [&str; 2] = ["pipeline", "cli"];

/// Outside crates and the rooms that may use them.
const HOMES: [(&str, &[&str]); 30] = [
    ("hashbrown", &["landscape"]),
    ("ab_glyph", &["render"]),
    ("blake3", &["cache"]),
    ("directories", &["cache"]),
    ("crs_definitions", &["scan"]),
    ("las", &["scan"]),
    ("tiff", &["raster"]),
    ("image", &["raster"]),
    ("spade", &["terrain", "ground"]),
    ("delaunator", &["terrain"]),
    ("gltf_json", &["export"]),
    ("lz4_flex", &["export"]),
    ("crc32fast", &["export"]),
    ("clap", &["cli"]),
    ("indicatif", &["cli"]),
    ("csv", &["inventory"]),
    ("flatgeobuf", &["inventory"]),
    ("flate2", &["raster", "landscape"]),
    ("libdeflater", &["raster"]),
    ("webp", &["raster"]),
    ("weezl", &["raster"]),
    ("schemars", &["species", "report"]),
    ("plotters", &["report"]),
    ("meshopt", &["export"]),
    ("itoa", &["export"]),
    ("zmij", &["export"]),
    ("earcut", &["species"]),
    ("tobj", &["species"]),
    ("xatlas_rs_v2", &["mesh"]),
    ("tempfile", &["cache", "export", "cli", "scan"]),
];

/// Source without comments and without test modules (by convention the last item of a file).
fn code(path: &Path) -> String {
    let text = fs::read_to_string(path).unwrap();
    let body = text.split("#[cfg(test)]").next().unwrap_or("");
    body.lines().filter(|l| !l.trim_start().starts_with("//")).collect::<Vec<_>>().join("\n")
}

/// Tests may build what their room takes; by convention they are in `tests.rs` or `sample.rs`, or
/// in a folder `tests`.
fn is_test(path: &Path) -> bool {
    let in_folder = path.parent().is_some_and(|folder| folder.ends_with("tests"));
    in_folder
        || path.file_name().is_some_and(|n| {
            let n = n.to_string_lossy();
            n == "tests.rs" || n.ends_with("_tests.rs") || n == "sample.rs" || n == "messages.rs"
        })
}

fn sources(dir: &Path, out: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(dir).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            sources(&path, out);
        } else if path.extension().is_some_and(|e| e == "rs") && !is_test(&path) {
            out.push(path);
        }
    }
}

fn room_of(path: &Path, src: &Path) -> String {
    let first = path.strip_prefix(src).unwrap().components().next().unwrap();
    first.as_os_str().to_string_lossy().trim_end_matches(".rs").to_owned()
}

fn words_after<'a>(text: &'a str, prefix: &str) -> Vec<&'a str> {
    text.match_indices(prefix)
        .map(|(i, _)| {
            let rest = &text[i + prefix.len()..];
            let end = rest.find(|c: char| !(c.is_alphanumeric() || c == '_')).unwrap_or(rest.len());
            &rest[..end]
        })
        .collect()
}

#[test]
fn rooms_name_only_rooms_they_may() {
    let src = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut files = Vec::new();
    sources(&src, &mut files);
    assert!(files.len() > 20);
    let allowed = allowed();
    let mut wrong = Vec::new();
    for file in files {
        let room = room_of(&file, &src);
        if FREE.contains(&room.as_str()) || room == "lib" || room == "main" {
            continue;
        }
        let may = allowed.get(room.as_str()).unwrap_or_else(|| {
            panic!("room `{room}` is not in this test's table nor, perhaps, in ARCHITECTURE.md")
        });
        for named in words_after(&code(&file), "crate::") {
            if named != room
                && !BOTTOM.contains(&named)
                && !may.contains(&named)
                && !named.is_empty()
            {
                wrong.push(format!("{} names crate::{named}", file.display()));
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn outside_crates_stay_in_their_homes() {
    let src = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut files = Vec::new();
    sources(&src, &mut files);
    let mut wrong = Vec::new();
    for file in files {
        let (room, text) = (room_of(&file, &src), code(&file));
        for (name, homes) in HOMES {
            let uses = text.contains(&format!("use {name}::"))
                || text.match_indices(&format!("{name}::")).any(|(i, _)| {
                    let before = text[..i].chars().next_back();
                    !before.is_some_and(|c| c.is_alphanumeric() || c == '_' || c == ':')
                });
            if uses && !homes.contains(&room.as_str()) {
                wrong.push(format!("{} uses {name}", file.display()));
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn every_room_is_on_the_map() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let map = fs::read_to_string(root.join("ARCHITECTURE.md")).unwrap();
    let rooms = fs::read_dir(root.join("src"))
        .unwrap()
        .map(|e| room_of(&e.unwrap().path(), &root.join("src")));
    for room in rooms.filter(|r| r != "lib" && r != "main") {
        assert!(map.contains(&format!("| `{room}` |")), "ARCHITECTURE.md lacks `{room}`");
    }
}
