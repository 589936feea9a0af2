//! The commands of those who write rule files, as they meet them.

use std::fs;
use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::process::{Child, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};

use assert_cmd::Command;
use serde_json::Value;

fn larix_in(dir: &Path, args: &[&str]) -> std::process::Output {
    Command::cargo_bin("larix").unwrap().current_dir(dir).args(args).output().unwrap()
}

fn larix(args: &[&str]) -> std::process::Output {
    larix_in(Path::new("."), args)
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// Standard output of a run that succeeds and says nothing else.
fn said(args: &[&str]) -> String {
    let out = larix(args);
    assert!(out.status.success(), "{args:?}: {}", text(&out.stderr));
    assert!(out.stderr.is_empty(), "{args:?}: {}", text(&out.stderr));
    text(&out.stdout)
}

fn json(args: &[&str]) -> Value {
    let said = said(args);
    serde_json::from_str(&said).unwrap_or_else(|e| panic!("{args:?}: {e} in {said}"))
}

/// Standard error of a run that fails, its lines run together.
fn refusal(dir: &Path, args: &[&str]) -> String {
    let out = larix_in(dir, args);
    assert!(!out.status.success(), "{args:?} succeeded");
    let err = text(&out.stderr);
    assert!(!err.contains("panicked"), "{err}");
    err.split_whitespace().filter(|w| *w != "│").collect::<Vec<_>>().join(" ")
}

fn write(dir: &Path, name: &str, text: &str) -> PathBuf {
    let path = dir.join(name);
    fs::write(&path, text).unwrap();
    path
}

const SOUND: &str = "extends = 'table3/13'\nname = 'Arbor nova'\n[size]\nheight_m = 5\n";

/// Method, §6: modules, draws, bracket pairs, length.
const TABLE_3: [(u64, u64, u64, f64); 13] = [
    (818, 216, 215, 42.875),
    (818, 216, 215, 42.875),
    (818, 216, 215, 22.4258),
    (337, 85, 84, 11.5),
    (337, 85, 84, 19.6),
    (337, 85, 84, 22.66),
    (998, 250, 250, 54.0),
    (1996, 500, 500, 108.0),
    (497, 125, 124, 27.0),
    (401, 101, 100, 38.0),
    (97, 25, 24, 5.3824),
    (97, 25, 24, 9.0),
    (497, 125, 124, 27.0),
];

fn agrees(stats: &Value, (modules, draws, brackets, length): (u64, u64, u64, f64)) {
    assert_eq!(stats["modules"], modules, "{stats}");
    assert_eq!(stats["draws"], draws, "{stats}");
    assert_eq!(stats["brackets"], brackets, "{stats}");
    assert_eq!(stats["nodes"], draws + 1, "{stats}");
    assert!((stats["length"].as_f64().unwrap() - length).abs() < 5e-5, "{stats}");
}

#[test]
fn all_thirteen_rules_derive_to_the_exact_table() {
    for (i, row) in TABLE_3.into_iter().enumerate() {
        let stats = json(&["species", "derive", &format!("table3/{:02}", i + 1), "--json"]);
        agrees(&stats, row);
        let keys: Vec<&String> = stats.as_object().unwrap().keys().collect();
        assert_eq!(keys, ["modules", "draws", "brackets", "length", "nodes"]);
    }
    let all = json(&["species", "derive", "--all", "--json"]);
    let all = all.as_array().unwrap();
    assert_eq!(all.len(), 13);
    for (stats, row) in all.iter().zip(TABLE_3) {
        agrees(stats, row);
        let t = &stats["table_4"];
        let count = |key: &str| t[key].as_i64().unwrap();
        assert_eq!(count("faces"), count("edges") - count("vertices") + 2);
    }
    assert_eq!(all[7]["species"], "table3/08");
    assert_eq!(all[7]["table_4"]["edges"], 728);
}

#[test]
fn the_table_stands_beside_that_of_the_source() {
    let table = said(&["species", "derive", "--all"]);
    let row = table.lines().find(|l| l.starts_with("table3/06")).unwrap();
    let numbers: Vec<&str> = row.split_whitespace().collect();
    assert_eq!(numbers, ["table3/06", "337", "85", "84", "22.6600", "86", "│", "102", "64", "164"]);
    assert!(table.contains("no target"), "{table}");
    let bare = said(&["species", "derive", "--all", "--quiet"]);
    assert_eq!(bare.lines().count(), 13);
    let one = said(&["species", "derive", "table3/12"]);
    assert!(one.lines().count() == 2 && !one.contains("faces"), "{one}");
}

#[test]
fn iterations_text_and_strangers() {
    let string = said(&["species", "derive", "table3/12", "--iterations", "1", "--text"]);
    assert_eq!(string, "F(1)[^F(0.5)][&F(0.5)][/F(0.5)][\\F(0.5)]\n");
    let both = json(&["species", "derive", "table3/12", "--iterations", "0", "--text", "--json"]);
    assert_eq!((both["text"].as_str(), both["draws"].as_u64()), (Some("F(1)"), Some(1)));
    let here = Path::new(".");
    let err = refusal(here, &["species", "derive", "table3/31", "larix_sibirika"]);
    assert!(err.contains("table3/31") && err.contains("`larix_sibirica`"), "{err}");
    let dir = tempfile::tempdir().unwrap();
    let text = "[rule]\naxiom = 'F(a)'\nproductions = ['F(a) -> F(a)F(a)']\niterations = 60\n";
    write(dir.path(), "endless.toml", text);
    let err = refusal(dir.path(), &["species", "check", "endless.toml"]);
    assert!(err.contains("endless.toml") && err.contains("F(a) -> F(a)F(a)"), "{err}");
}

#[test]
fn chance_goes_with_the_seed() {
    let dir = tempfile::tempdir().unwrap();
    let rule = "[rule]\naxiom = 'F(a)'\nproductions = ['F(a) -> (1) F(a)[^F(a)]', \
                'F(a) -> (1) F(a)']\nangles = { alpha = 30 }\niterations = 6\n";
    write(dir.path(), "chance.toml", rule);
    let derive = |seed: &str| {
        let out =
            larix_in(dir.path(), &["species", "derive", "chance.toml", "--text", "--seed", seed]);
        assert!(out.status.success(), "{}", text(&out.stderr));
        text(&out.stdout)
    };
    assert_eq!(derive("1"), derive("1"));
    assert_ne!(derive("1"), derive("2"));
}

#[test]
fn the_list_has_three_forms() {
    let names = said(&["species", "list", "--quiet"]);
    assert!(names.lines().any(|l| l == "table3/01") && names.lines().any(|l| l == "table3/13"));
    let all = json(&["species", "list", "--json"]);
    let all = all.as_array().unwrap();
    assert_eq!(all.len(), names.lines().count());
    let larch = all.iter().find(|s| s["id"] == "larix_sibirica").unwrap();
    assert_eq!(larch["name"], "Larix sibirica");
    assert!(larch["builds_on"].as_str().unwrap().starts_with("table3/"));
    assert!(said(&["species", "list"]).contains("builds on table3/13"));
}

#[test]
fn check_tells_sound_files_from_broken_ones() {
    let dir = tempfile::tempdir().unwrap();
    write(dir.path(), "sound.toml", SOUND);
    write(
        dir.path(),
        "broken.toml",
        "extends = 'table3/13'\n[size]\nhieght_m = 5\ncrown_base = 2\n",
    );
    write(dir.path(), "torn.toml", "[rule\n");
    let files = ["species", "check", "sound.toml", "broken.toml", "torn.toml"];
    let out = larix_in(dir.path(), &files);
    assert_eq!(out.status.code(), Some(1));
    let (said, err) = (text(&out.stdout), text(&out.stderr));
    assert_eq!(said.lines().count(), 1, "{said}");
    assert!(said.starts_with("sound.toml: ok, Arbor nova: 497 modules, a tree of 5.0 m"), "{said}");
    for shown in ["broken.toml:3:1", "broken.toml:4:14", "`height_m`?", "torn.toml:1:6", "help:"] {
        assert!(err.contains(shown), "{shown} is not in {err}");
    }
    let alone = larix_in(dir.path(), &["species", "check", "sound.toml", "--quiet"]);
    assert!(alone.status.success() && alone.stdout.is_empty() && alone.stderr.is_empty());

    let out = larix_in(dir.path(), &[&files[..], &["--json"]].concat());
    assert_eq!(out.status.code(), Some(1));
    let told: Value = serde_json::from_slice(&out.stdout).unwrap();
    assert_eq!(told[0]["ok"], true);
    assert_eq!(told[0]["derived"]["draws"], 125);
    assert_eq!(told[1]["ok"], false);
    let errors = told[1]["errors"].as_array().unwrap();
    assert_eq!(errors.len(), 2);
    assert_eq!((errors[0]["line"].as_u64(), errors[0]["column"].as_u64()), (Some(3), Some(1)));
}

#[test]
fn a_check_warns_of_what_a_run_would() {
    let dir = tempfile::tempdir().unwrap();
    let twig = "mtllib twig.mtl\nv -1 0 0\nv 1 0 0\nv 1 4 0\nv -1 4 0\nvt 0 0\nvt 1 0\nvt 1 1\n\
                vt 0 1\nusemtl leaf\nf 1/1 2/2 3/3 4/4\nusemtl stalk\nf 1/1 2/2 3/3\n";
    write(dir.path(), "twig.obj", twig);
    write(dir.path(), "twig.mtl", "newmtl leaf\nKd 0.2 0.6 0.1\n");
    write(dir.path(), "own.toml", "extends = 'table3/13'\n[foliage]\nmodel = 'twig.obj'\n");
    let check = |more: &[&str]| {
        let out = larix_in(dir.path(), &[&["species", "check", "own.toml"], more].concat());
        assert!(out.status.success(), "{}", text(&out.stderr));
        (text(&out.stdout), text(&out.stderr))
    };
    let (said, told) = check(&[]);
    assert!(said.starts_with("own.toml: ok"), "{said}");
    assert!(told.starts_with("warning: ") && told.contains("stalk"), "{told}");
    assert_eq!(check(&["--quiet"]), (String::new(), String::new()));
    let (json, told) = check(&["--json"]);
    let json: Value = serde_json::from_str(&json).unwrap();
    assert!(json[0]["warnings"][0].as_str().unwrap().contains("stalk"), "{json}");
    assert_eq!(told, "");
    let tree = ["tree", "own.toml", "-o", "own.glb", "--triangles", "2000", "--texture", "64"];
    assert!(
        text(&larix_in(dir.path(), &tree).stderr)
            .contains(json[0]["warnings"][0].as_str().unwrap())
    );
    // But where the model is not used.
    for foliage in ["none", "shell"] {
        let out = larix_in(dir.path(), &[&tree[..], &["--foliage", foliage]].concat());
        assert!(!text(&out.stderr).contains("stalk"), "{foliage}: {}", text(&out.stderr));
    }
    larix_in(dir.path(), &tree);
    // Nothing of it is transparent.
    let file = fs::read(dir.path().join("own.glb")).unwrap();
    let length = u32::from_le_bytes(file[12..16].try_into().unwrap()) as usize;
    let scene: Value = serde_json::from_slice(&file[20..20 + length]).unwrap();
    let materials = scene["materials"].as_array().unwrap();
    let leaf = materials.iter().find(|m| m["name"].as_str().unwrap().contains("_leaf")).unwrap();
    assert!(leaf["alphaMode"].is_null() && leaf["doubleSided"] == true, "{leaf}");
}

#[test]
fn a_file_that_is_no_rule_file_is_told_of_briefly() {
    let dir = tempfile::tempdir().unwrap();
    write(dir.path(), "model.obj", &"v 0 0 0\n".repeat(300));
    let said = refusal(dir.path(), &["tree", "model.obj", "-o", "e.glb"]);
    assert_eq!(said.matches("expected `=`").count(), 5, "{said}");
    for part in ["more places that are not TOML", "give a rule file"] {
        assert!(said.contains(part), "no `{part}` in {said}");
    }
}

#[test]
fn a_new_file_is_sound_and_grows() {
    let dir = tempfile::tempdir().unwrap();
    let run = |args: &[&str]| {
        let out = larix_in(dir.path(), args);
        assert!(out.status.success(), "{args:?}: {}", text(&out.stderr));
        text(&out.stdout)
    };
    let told = run(&["species", "new", "betula_nana"]);
    assert!(told.contains("betula_nana.toml"), "{told}");
    run(&["species", "new", "own-larch", "--from", "larix_sibirica", "-o", "trees/larch.toml"]);
    run(&["species", "check", "betula_nana.toml", "trees/larch.toml"]);
    let tree =
        ["tree", "betula_nana.toml", "-o", "b.glb", "--triangles", "2000", "--texture", "64"];
    run(&tree);
    assert!(fs::metadata(dir.path().join("b.glb")).unwrap().len() > 10_000);

    let first = fs::read(dir.path().join("betula_nana.toml")).unwrap();
    let again = ["species", "new", "betula_nana", "--from", "salix_caprea"];
    let err = refusal(dir.path(), &again);
    assert!(err.contains("betula_nana.toml: is there already") && err.contains("--force"), "{err}");
    assert_eq!(fs::read(dir.path().join("betula_nana.toml")).unwrap(), first);
    run(&[&again[..], &["--force"]].concat());
    assert_ne!(fs::read(dir.path().join("betula_nana.toml")).unwrap(), first);

    for (args, says) in [
        (&["species", "new", "../up"][..], "is a path, not a name"),
        (&["species", "new", "larix_sibirica"], "is a built-in species"),
        (&["species", "new", "fir.toml"], "give the name `fir`"),
        (&["species", "new", "fir", "--from", "oaks"], "unknown species `oaks`"),
        (&["species", "new", "fir", "-o", "fir.txt"], ".toml"),
    ] {
        let err = refusal(dir.path(), args);
        assert!(err.contains(says), "{args:?}: {err}");
    }
}

#[test]
fn the_schema_is_the_same_on_output_and_in_a_file() {
    let dir = tempfile::tempdir().unwrap();
    let schema = json(&["species", "schema"]);
    assert_eq!(schema["$schema"], "https://json-schema.org/draft/2020-12/schema");
    assert_eq!(schema["additionalProperties"], false);
    let validator = jsonschema::draft202012::new(&schema).unwrap();
    assert!(validator.is_valid(&serde_json::json!({ "size": { "height_m": 3 } })));
    assert!(!validator.is_valid(&serde_json::json!({ "size": { "height_m": -3 } })));
    assert!(!validator.is_valid(&serde_json::json!({ "size": { "hieght_m": 3 } })));
    let out = larix_in(dir.path(), &["species", "schema", "-o", "larix.schema.json"]);
    assert!(out.status.success());
    let file = fs::read(dir.path().join("larix.schema.json")).unwrap();
    assert_eq!(serde_json::from_slice::<Value>(&file).unwrap(), schema);
}

#[test]
fn a_sheet_is_drawn_and_told_of() {
    let dir = tempfile::tempdir().unwrap();
    let args = ["species", "show", "salix_caprea", "-o", "sheet.png", "--size", "400", "--json"];
    let show = || {
        let out = larix_in(dir.path(), &[&args[..], &["--quiet"]].concat());
        assert!(out.status.success() && out.stderr.is_empty(), "{}", text(&out.stderr));
        let told: Value = serde_json::from_slice(&out.stdout).unwrap();
        (told, fs::read(dir.path().join("sheet.png")).unwrap())
    };
    let (told, png) = show();
    let picture = larix::raster::Picture::from_bytes(&png).unwrap();
    assert_eq!(told["width"], picture.width);
    let trees = told["trees"].as_array().unwrap();
    let seen: Vec<_> =
        trees.iter().map(|t| (t["seed"].as_u64().unwrap(), t["is_bare"] == true)).collect();
    assert_eq!(seen, [(1, false), (1, true), (2, false), (2, true), (3, false), (3, true)]);
    assert!(show().1 == png, "two runs differ");
    let err = refusal(dir.path(), &["species", "show", "salix_caprea", "-o", "sheet.jpg"]);
    assert!(err.contains(".png"), "{err}");
}

/// A child that is stopped when the test ends, however it ends.
struct Watching {
    child: Child,
    lines: Receiver<String>,
}

impl Drop for Watching {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

impl Watching {
    fn start(dir: &Path, args: &[&str]) -> Watching {
        let mut child = std::process::Command::new(assert_cmd::cargo::cargo_bin("larix"))
            .current_dir(dir)
            .args(args)
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let (send, lines) = channel();
        let streams: [Box<dyn Read + Send>; 2] =
            [Box::new(child.stdout.take().unwrap()), Box::new(child.stderr.take().unwrap())];
        for stream in streams {
            let send = send.clone();
            std::thread::spawn(move || {
                for line in BufReader::new(stream).lines().map_while(Result::ok) {
                    let _ = send.send(line);
                }
            });
        }
        Watching { child, lines }
    }

    /// Waits for a line that holds `part`.
    fn hears(&mut self, part: &str) -> String {
        let end = Instant::now() + Duration::from_secs(120);
        let mut heard = String::new();
        while Instant::now() < end {
            match self.lines.recv_timeout(Duration::from_millis(200)) {
                Ok(line) if line.contains(part) => return line,
                Ok(line) => heard += &format!("{line}\n"),
                Err(_) => assert!(self.child.try_wait().unwrap().is_none(), "it ended: {heard}"),
            }
        }
        panic!("no `{part}` in:\n{heard}");
    }
}

#[test]
fn watching_follows_every_save_and_survives_editors() {
    let dir = tempfile::tempdir().unwrap();
    let file = write(dir.path(), "oak.toml", SOUND);
    let mut watching = Watching::start(dir.path(), &["species", "check", "--watch", "oak.toml"]);
    let first = watching.hears("oak.toml: ok");
    assert!(first.contains("a tree of 5.0 m") && first.contains("oak.png"), "{first}");
    let picture = dir.path().join("oak.png");
    let small = fs::read(&picture).unwrap();

    // A plain save.
    fs::write(&file, SOUND.replace("height_m = 5", "height_m = 7")).unwrap();
    watching.hears("a tree of 7.0 m");
    assert_ne!(fs::read(&picture).unwrap(), small);

    // A mistake; the picture stays.
    let before = fs::read(&picture).unwrap();
    fs::write(&file, SOUND.replace("height_m", "hieght_m")).unwrap();
    watching.hears("unknown key `hieght_m`");
    watching.hears("1 mistake");
    assert_eq!(fs::read(&picture).unwrap(), before);

    // A save by renaming, the file away for a moment.
    fs::remove_file(&file).unwrap();
    std::thread::sleep(Duration::from_millis(400));
    let next = write(dir.path(), "oak.toml~", &SOUND.replace("height_m = 5", "height_m = 8"));
    fs::rename(next, &file).unwrap();
    watching.hears("a tree of 8.0 m");

    // A base beside the file is followed as well.
    let base = write(dir.path(), "base.toml", SOUND);
    fs::write(&file, "extends = 'base.toml'\n").unwrap();
    watching.hears("a tree of 5.0 m");
    fs::write(base, SOUND.replace("height_m = 5", "height_m = 9")).unwrap();
    watching.hears("a tree of 9.0 m");
}

#[test]
fn one_picture_is_not_drawn_for_two_files() {
    let dir = tempfile::tempdir().unwrap();
    let args = ["species", "check", "--watch", "a.toml", "b.toml", "-o", "p.png"];
    assert!(refusal(dir.path(), &args).contains("one picture"));
    let err = refusal(dir.path(), &["species", "check", "a.toml", "-o", "p.png"]);
    assert!(err.contains("--watch"), "{err}");
}
