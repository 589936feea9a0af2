//! The program as a user meets it: right files, clear refusals, earlier output left whole.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

use assert_cmd::Command;

fn larix(args: &[&str]) -> std::process::Output {
    Command::cargo_bin("larix").unwrap().args(args).output().unwrap()
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// A refusal: non-zero exit, one clear message that holds all of `says`, no panic.
fn refused(args: &[&str], says: &[&str]) {
    let out = larix(args);
    let err = text(&out.stderr);
    assert!(!out.status.success(), "{args:?} succeeded");
    assert!(!err.contains("panicked"), "{err}");
    let joined = err.split_whitespace().filter(|w| *w != "│").collect::<Vec<_>>().join(" ");
    for part in says {
        assert!(joined.contains(part), "{args:?}: no `{part}` in:\n{err}");
    }
}

fn data() -> Option<PathBuf> {
    let dir = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data");
    if !dir.exists() {
        eprintln!("skipped: no ../shared/data");
        return None;
    }
    Some(dir)
}

fn write(dir: &Path, name: &str, bytes: impl AsRef<[u8]>) -> String {
    let path = dir.join(name);
    fs::write(&path, bytes).unwrap();
    path.to_string_lossy().into_owned()
}

/// Every file under a folder with its bytes, but for the report, which holds times.
fn contents(dir: &Path) -> Vec<(PathBuf, Vec<u8>)> {
    let mut out = Vec::new();
    let mut todo = vec![dir.to_path_buf()];
    while let Some(d) = todo.pop() {
        for entry in fs::read_dir(d).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                todo.push(path);
            } else if path.file_name().unwrap() != "report.json" {
                out.push((path.strip_prefix(dir).unwrap().to_path_buf(), fs::read(&path).unwrap()));
            }
        }
    }
    out.sort();
    out
}

#[test]
fn a_crown_of_too_few_cards_is_told_thin() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("oak.glb");
    let said = |height_m: &str| {
        let args = ["tree", "quercus_robur", "--triangles", "5000", "--texture", "64", "--height"];
        let run = larix(&[&args[..], &[height_m, "-o", out.to_str().unwrap()]].concat());
        assert!(run.status.success(), "{}", text(&run.stderr));
        text(&run.stderr)
    };
    let few = said("45");
    assert!(few.contains("warning: cards of "), "{few}");
    assert!(few.contains(" % of what the species' leaves do; give about "), "{few}");
    let enough = said("25");
    assert!(!enough.contains("cards of "), "{enough}");
    // A picture of the user's is on cards at every level.
    let leaf = image::RgbaImage::from_fn(64, 64, |x, _| {
        image::Rgba([60, 120, 40, if (16..48).contains(&x) { 255 } else { 0 }])
    });
    leaf.save(dir.path().join("leaf.png")).unwrap();
    let rule = dir.path().join("own.toml");
    fs::write(&rule, "extends = 'quercus_robur'\n[foliage]\npicture = 'leaf.png'\n").unwrap();
    let args = ["tree", rule.to_str().unwrap(), "--height", "45", "--texture", "64"];
    let own = |foliage: &str| {
        let more = ["--triangles", "3000", "--foliage", foliage, "-o", out.to_str().unwrap()];
        let told = text(&larix(&[&args[..], &more].concat()).stderr);
        assert!(told.contains("warning: cards of "), "{told}");
        fs::read(&out).unwrap()
    };
    assert!(own("geometry") == own("cards"), "the same tree");
    let more = ["--height", "1", "--triangles", "1000000", "-o", out.to_str().unwrap()];
    let spare = text(&larix(&[&args[..2], &more, &["--texture", "64"]].concat()).stderr);
    assert!(spare.contains("no more than these; this is its finest form"), "{spare}");
}

#[test]
fn demo_is_whole_and_the_same_on_one_thread_and_two() {
    let dir = tempfile::tempdir().unwrap();
    let run = |name: &str, threads: &str| {
        let out = dir.path().join(name);
        let path = out.to_str().unwrap().to_owned();
        let done = larix(&[
            "demo",
            "--trees",
            "40",
            "--triangles",
            "1000",
            "--texture",
            "128",
            "-o",
            &path,
            "--threads",
            threads,
        ]);
        assert!(done.status.success(), "{}", text(&done.stderr));
        (contents(&out), text(&done.stderr))
    };
    let (one, said) = run("one", "1");
    let (two, _) = run("two", "2");
    let names: Vec<String> = one.iter().map(|(p, _)| p.display().to_string()).collect();
    for wanted in [
        "forest.glb",
        "forest.usda",
        "inventory.geojson",
        "photo.tif",
        "preview.png",
        "scan.laz",
        "terrain.tif",
    ] {
        assert!(names.iter().any(|n| n == wanted), "{wanted} is missing from {names:?}");
    }
    assert!(names.iter().any(|n| n.starts_with("textures")), "{names:?}");
    assert!(dir.path().join("one/report.json").exists());
    for (a, b) in one.iter().zip(&two) {
        assert_eq!(a.0, b.0);
        assert!(a.1 == b.1, "{} differs between 1 and 2 threads", a.0.display());
    }
    assert!(said.contains("matched") && said.contains("RMSE"), "{said}");
    let report: serde_json::Value =
        serde_json::from_slice(&fs::read(dir.path().join("one/report.json")).unwrap()).unwrap();
    for stage in report["stages"].as_array().unwrap() {
        assert!(stage["seconds"].as_f64().unwrap() >= 0.0);
        assert!(stage["peak_bytes"].as_u64().unwrap() > 0, "{stage}");
        assert!(stage["items_in"]["count"].is_u64() && stage["items_out"]["count"].is_u64());
    }
    assert!(report["truth"]["matched"].as_u64().unwrap() >= 20, "{}", report["truth"]);
}

#[test]
fn bad_scans_are_refused_in_words() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    let out = d.join("out").to_string_lossy().into_owned();
    let forest = |scan: &str, says: &[&str]| refused(&["forest", scan, "-o", &out], says);
    forest("nowhere.laz", &["nowhere.laz", "help:"]);
    forest(&write(d, "empty.las", b""), &["empty.las", "help:"]);
    forest(&write(d, "garbage.laz", [7u8; 5000]), &["garbage.laz", "help:"]);
    forest(&write(d, "nan.xyz", "nan nan nan\n"), &["nan.xyz", "help:"]);
    forest(&write(d, "words.xyz", "these are words\n"), &["words.xyz", "help:"]);
    forest(&write(d, "scan.docx", b"x"), &["scan.docx", "help:"]);
    forest(&write(d, "one.xyz", "1 2 3\n"), &["one.xyz", "help:"]);
    assert!(!d.join("out/forest.glb").exists());
}

#[test]
fn a_canopy_without_ground_is_refused_and_named() {
    let dir = tempfile::tempdir().unwrap();
    let mut points = String::new();
    let mut state = 1u64;
    let mut unit = || {
        state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (state >> 40) as f64 / (1u64 << 24) as f64
    };
    for _ in 0..8000 {
        let (x, y, z) = (30.0 * unit(), 30.0 * unit(), 12.0 + 10.0 * unit());
        points += &format!("{x:.3} {y:.3} {z:.3}\n");
    }
    let scan = write(dir.path(), "canopy.xyz", points);
    let out = dir.path().join("o").to_string_lossy().into_owned();
    refused(&["forest", &scan, "-o", &out], &["canopy.xyz", "no ground", "--ground file"]);
}

#[test]
fn a_species_named_twice_counts_once_and_a_balloon_is_no_tree() {
    let dir = tempfile::tempdir().unwrap();
    let mut points = String::new();
    for i in 0..60 {
        for j in 0..60 {
            points += &format!("{} {} 50\n", f64::from(i) * 0.5, f64::from(j) * 0.5);
        }
    }
    // A cone of points as a balloon might return them.
    for k in 0..2000 {
        let k = f64::from(k);
        let (r, turn) = (3.0 * (k * 0.618).fract().sqrt(), k * 2.4);
        let (x, y) = (15.0 + r * turn.cos(), 15.0 + r * turn.sin());
        points += &format!("{x:.3} {y:.3} {:.3}\n", 250.0 - 3.0 * r);
    }
    let scan = write(dir.path(), "balloon.xyz", points);
    let out = dir.path().join("o").to_string_lossy().into_owned();
    let twice = "betula_pendula,betula_pendula";
    let done = larix(&["forest", &scan, "-o", &out, "--species", twice]);
    let err = text(&done.stderr);
    assert!(done.status.success(), "{err}");
    assert!(err.contains("left out as no trees: 1"), "{err}");
}

#[test]
fn a_scan_cut_to_nothing_is_refused_and_earlier_output_stays() {
    let Some(data) = data() else { return };
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("out");
    fs::create_dir(&out).unwrap();
    fs::write(out.join("forest.glb"), b"precious").unwrap();
    // Its points are one chunk in layers, of which no part unpacks without the rest.
    let bytes = fs::read(data.join("spanner/ALS_Clip.laz")).unwrap();
    for share in [10, 50, 90] {
        let cut = write(dir.path(), "cut.laz", &bytes[..bytes.len() * share / 100]);
        refused(&["forest", &cut, "-o", out.to_str().unwrap()], &["cut.laz", "help:"]);
    }
    assert_eq!(fs::read(out.join("forest.glb")).unwrap(), b"precious");
    assert_eq!(fs::read_dir(&out).unwrap().count(), 1);
}

#[test]
fn a_scan_cut_short_gives_what_is_left_with_a_warning() {
    let Some(data) = data() else { return };
    let dir = tempfile::tempdir().unwrap();
    let bytes = fs::read(data.join("lidR/MixedConifer.laz")).unwrap();
    let cut = write(dir.path(), "cut.laz", &bytes[..bytes.len() / 2]);
    let tif = dir.path().join("dtm.tif");
    let run = assert_cmd::Command::cargo_bin("larix")
        .unwrap()
        .args(["terrain", &cut, "-o", tif.to_str().unwrap()])
        .assert()
        .success();
    let told = String::from_utf8_lossy(&run.get_output().stderr).into_owned();
    assert!(told.contains("the header promises 37657 points;"), "{told}");
    assert!(told.contains("are lost"), "{told}");
    assert!(tif.exists());
}

#[test]
fn photos_elsewhere_or_without_a_place_are_refused() {
    let Some(data) = data() else { return };
    let dir = tempfile::tempdir().unwrap();
    let scan = data.join("idtrees/las/OSBS_10.las");
    let scan = scan.to_str().unwrap();
    let out = dir.path().join("o").to_string_lossy().into_owned();
    let elsewhere = data.join("idtrees/rgb/MLBS_10.tif");
    let elsewhere = elsewhere.to_str().unwrap();
    refused(&["forest", scan, "--photo", elsewhere, "-o", &out], &["MLBS_10.tif", "help:"]);
    refused(&["forest", scan, "--photo", "no.tif", "-o", &out], &["no.tif", "help:"]);
    let raster = larix::raster::geotiff::Raster {
        width: 2,
        height: 2,
        bands: 3,
        samples: larix::raster::geotiff::Samples::U8(vec![9; 12]),
        geometry: None,
        epsg: None,
        nodata: None,
    };
    let bare = write(dir.path(), "bare.tif", larix::raster::geotiff::encode(&raster).unwrap());
    refused(&["forest", scan, "--photo", &bare, "-o", &out], &["bare.tif", "help:"]);
}

#[test]
fn unknown_species_and_unwritable_folders_are_refused_before_work() {
    let dir = tempfile::tempdir().unwrap();
    let file = write(dir.path(), "file", b"x");
    refused(
        &["tree", "larix_sibirika", "-o", "t.glb"],
        &["larix_sibirika", "larix_sibirica", "help:"],
    );
    refused(&["tree", "larix_sibirica", "-o", &format!("{file}/t.glb")], &["file", "help:"]);
    refused(
        &["tree", "larix_sibirica", "-o", "t.fbx"],
        &["t.fbx", ".glb, .gltf, .usda, .usdc, .usdz, .x3d, .obj, .png"],
    );
    refused(&["forest", "x.laz", "--species", "oak_of_mine", "-o", &file], &["oak_of_mine"]);
    refused(&["demo", "-o", &format!("{file}/demo")], &["file", "help:"]);
}

/// As a full disk or a limit of the user's does.
#[test]
#[cfg(target_os = "linux")]
fn a_file_that_may_not_grow_is_told_and_nothing_stays() {
    let dir = tempfile::tempdir().unwrap();
    write(dir.path(), "tree.glb", "old");
    let before = contents(dir.path());
    let program = assert_cmd::cargo::cargo_bin("larix");
    let limited =
        "ulimit -f 64 && exec \"$0\" tree betula_pendula --texture 512 --no-cache -o \"$1\"";
    let tree = dir.path().join("tree.glb");
    let run = Command::new("sh").args(["-c", limited]).args([&program, &tree]).output().unwrap();
    let told = text(&run.stderr);
    assert!(!run.status.success() && told.contains("ulimit -f"), "{}: {told}", run.status);
    assert_eq!(contents(dir.path()), before);
}

#[test]
fn a_picture_of_a_tree_holds_no_levels() {
    let dir = tempfile::tempdir().unwrap();
    let output = dir.path().join("birch.png").to_string_lossy().into_owned();
    let asked =
        [&["--lods", "2"][..], &["--wind", "unity"], &["--profile", "engine"], &["--variants"]];
    for more in asked {
        let says = ["a picture shows the finest form alone", "write a .glb"];
        refused(&[&["tree", "betula_pendula", "-o", &output], more].concat(), &says);
    }
    assert!(!dir.path().join("birch.png").exists());
    let scene = output.replace(".png", ".glb");
    let more = ["--height-maps", "--texture", "0"];
    let all = [&["tree", "betula_pendula", "-o", &scene], &more[..]].concat();
    refused(&all, &["--height-maps asks for pictures", "give --texture"]);
}

#[test]
fn a_run_goes_on_where_nobody_listens() {
    let dir = tempfile::tempdir().unwrap();
    let program = assert_cmd::cargo::cargo_bin("larix");
    let tree = dir.path().join("tree.glb");
    let unheard = "exec \"$0\" tree betula_pendula --texture 64 -o \"$1\" 2> /dev/full";
    let run = Command::new("sh").args(["-c", unheard]).args([&program, &tree]).output().unwrap();
    assert!(run.status.success() && tree.exists(), "{}", run.status);
}

#[test]
fn what_no_file_would_hold_is_refused_before_it_is_made() {
    let dir = tempfile::tempdir().unwrap();
    let file = |name: &str| dir.path().join(name).to_string_lossy().into_owned();
    let asked = [
        &["--wind", "unity"][..],
        &["--collision", "convex"],
        &["--impostor", "octahedral"],
        &["--variants"],
    ];
    for more in asked {
        for name in ["birch.obj", "birch.x3d"] {
            let says =
                [&name[5..], " files hold nothing of ", more[0], "leave that out, or write a .glb"];
            refused(&[&["tree", "betula_pendula", "-o", &file(name)], more].concat(), &says);
        }
        let folder = file("demo");
        let demo = ["demo", "--trees", "3", "--format", "obj,x3d", "-o", &folder];
        refused(&[&demo, more].concat(), &[".obj and .x3d files hold nothing of ", more[0]]);
    }
    let camera = ["--impostor", "octahedral", "--camera", "20,-30,130,20,20,105"];
    let demo = ["demo", "--trees", "3", "--format", "glb,obj", "-o", &file("demo")];
    refused(
        &[&demo[..], &camera].concat(),
        &[".obj files hold no octahedral one", "--impostor cross"],
    );
    assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 0);
    // What another file holds is made; what a profile alone asks for is not, where none does.
    let (folder, tree) = (file("two"), file("engine.obj"));
    let demo = ["demo", "--trees", "3", "--texture", "256", "--format", "obj,glb", "-o", &folder];
    let out = larix(&[&demo[..], &["--wind", "unity", "--impostor", "octahedral"]].concat());
    assert!(out.status.success(), "{}", text(&out.stderr));
    let told = text(&out.stderr);
    assert!(told.contains(".obj files hold nothing of --impostor octahedral, --wind"), "{told}");
    assert!(dir.path().join("two/forest_impostor.glb").exists());
    assert!(!dir.path().join("two/forest_impostor.obj").exists());
    let engine = ["tree", "betula_pendula", "--texture", "256", "--profile", "engine", "-o", &tree];
    let out = larix(&engine);
    assert!(out.status.success());
    let told = text(&out.stderr);
    assert!(told.contains(".obj files hold no wind and bodies of --profile engine"), "{told}");
}

#[test]
fn folders_that_are_missing_are_made_and_told() {
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path().join("a").join("b");
    let file = folder.join("rules.json");
    let said = || {
        let out = larix(&["species", "schema", "-o", file.to_str().unwrap()]);
        assert!(out.status.success());
        text(&out.stderr)
    };
    let told = format!("made the folder {}", folder.display());
    assert!(said().contains(&told) && file.exists());
    assert!(!said().contains(&told), "it is there by now");
}

#[test]
fn what_a_refusal_may_come_of_is_told_before_it() {
    let dir = tempfile::tempdir().unwrap();
    // Ids, and coordinates of which most stand alone.
    let place = |i: usize| if i < 150 { (i % 15, i / 15) } else { (i * 97, i * 400) };
    let line = |i: usize| format!("{i} {} {} 7\n", place(i).0, place(i).1);
    let lines: String = (1..500).map(line).collect();
    let scan = write(dir.path(), "ids.xyz", lines);
    let out = larix(&["terrain", &scan, "-o", dir.path().join("t.tif").to_str().unwrap()]);
    let err = text(&out.stderr);
    assert!(!out.status.success(), "{err}");
    let at = |what: &str| err.find(what).unwrap_or_else(|| panic!("no {what} in {err}"));
    assert!(at("warning: ") < at("stand alone"));
}

#[test]
fn a_scan_without_trees_gives_a_terrain_scene_and_a_warning() {
    let dir = tempfile::tempdir().unwrap();
    let mut points = String::new();
    for i in 0..40 {
        for j in 0..40 {
            points +=
                &format!("{} {} {}\n", 1000.0 + i as f64, 2000.0 + j as f64, 50.0 + 0.1 * i as f64);
        }
    }
    let scan = write(dir.path(), "bare.xyz", points);
    let out = dir.path().join("out");
    let done = larix(&["forest", &scan, "-o", out.to_str().unwrap()]);
    let err = text(&done.stderr);
    assert!(done.status.success(), "{err}");
    assert!(err.contains("warning") && err.contains("no trees"), "{err}");
    assert!(out.join("forest.glb").exists() && out.join("terrain.tif").exists());
}

#[test]
fn commands_stop_where_they_are_done() {
    let Some(data) = data() else { return };
    let dir = tempfile::tempdir().unwrap();
    let scan = data.join("idtrees/las/OSBS_10.las");
    let scan = scan.to_str().unwrap();
    let stages = |args: &[&str]| -> Vec<String> {
        let out = larix(args);
        assert!(out.status.success(), "{}", text(&out.stderr));
        let v: serde_json::Value = serde_json::from_slice(&out.stdout).unwrap();
        v["stages"]
            .as_array()
            .unwrap()
            .iter()
            .map(|s| s["stage"].as_str().unwrap().into())
            .collect()
    };
    let to = |name: &str| dir.path().join("new/folder").join(name).to_string_lossy().into_owned();
    let dtm = to("dtm.tif");
    assert_eq!(stages(&["terrain", scan, "-o", &dtm, "--json"]), ["scan", "ground", "terrain"]);
    let raster = larix::raster::geotiff::read(Path::new(&dtm)).unwrap();
    assert_eq!(raster.epsg, Some(32617));
    let mesh = to("dtm.glb");
    let with_mesh = ["scan", "ground", "terrain", "mesh", "export"];
    assert_eq!(
        stages(&["terrain", scan, "--terrain-error", "0.2", "-o", &mesh, "--json"]),
        with_mesh
    );
    let (document, ..) = gltf::import(&mesh).unwrap();
    let primitive = document.meshes().next().unwrap().primitives().next().unwrap();
    assert!(primitive.indices().unwrap().count() >= 6);
    for name in ["t.geojson", "t.csv"] {
        let found = stages(&["inventory", scan, "-o", &to(name), "--json"]);
        assert_eq!(found.last().unwrap(), "species");
        assert!(!found.contains(&"skeleton".to_owned()));
        assert!(Path::new(&to(name)).exists());
    }
    let grown =
        stages(&["tree", "betula_pendula", "--triangles", "2000", "-o", &to("b.glb"), "--json"]);
    assert_eq!(grown, ["skeleton", "texture", "mesh", "scene", "export"]);
}

/// A tree fitted to a scan tells how well it fits; a forest, a flat cloud and a height beside the
/// cloud are refused.
#[test]
fn a_tree_is_fitted_to_its_cloud() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    let out = d.join("out.glb").to_string_lossy().into_owned();
    // A pole of 10 cm radius with boughs, on far coordinates.
    let mut points = String::new();
    for k in 0..6000 {
        let (z, turn) = (k as f64 * 0.001, k as f64 * 2.399963);
        let (x, y) = (0.1 * turn.cos(), 0.1 * turn.sin());
        points += &format!("{:.3} {:.3} {:.3}\n", 6_000_000.0 + x, 500_000.0 + y, 120.0 + z);
    }
    for k in 0..2000 {
        let (bough, t) = (f64::from(k % 10), f64::from(k / 10) * 0.01);
        let (s, c) = (bough * 0.628).sin_cos();
        let z = 123.0 + 0.3 * bough + 0.5 * t;
        let (x, y) = ((0.1 + t) * c, (0.1 + t) * s);
        points += &format!("{:.3} {:.3} {:.3}\n", 6_000_000.0 + x, 500_000.0 + y, z);
    }
    let cloud = write(d, "one.xyz", &points);
    let tree = ["--json", "tree", "betula_pendula", "--texture", "64", "--bare", "-o", &out];
    let done = larix(&[&tree[..], &["--cloud", &cloud]].concat());
    let said = text(&done.stderr);
    assert!(done.status.success(), "{said}");
    assert!(said.contains("points to wood: mean") && said.contains("stem seen, 2"), "{said}");
    let report: serde_json::Value = serde_json::from_slice(&done.stdout).unwrap();
    let fit = &report["fit"];
    assert!(fit["mean_m"].as_f64().unwrap() < 0.01, "{fit}");
    assert!((fit["stem_diameter_m"].as_f64().unwrap() - 0.2).abs() < 0.01, "{fit}");
    assert!(fit["outside_length"].as_f64().unwrap() < 0.05, "{fit}");
    assert_eq!(fit["measured"], 8000);
    let origin = &report["scene"]["origin"];
    assert!((origin[0].as_f64().unwrap() - 6_000_000.0).abs() < 0.05, "{origin}");
    assert!(d.join("out.glb").exists());

    let refuse = |more: &[&str], says: &[&str]| refused(&[&tree[..], more].concat(), says);
    refuse(&["--cloud", &cloud, "--height", "6"], &["--height", "cannot be used with"]);
    let flat: String = (0..900).map(|i| format!("{} {} 0\n", i % 30, i / 30)).collect();
    let flat = write(d, "flat.xyz", flat);
    refuse(&["--cloud", &flat], &["flat.xyz", "0.0 m high is no tree", "help:"]);
    let wide: String = (0..9000).map(|i| format!("{} {} {}\n", i % 90, i / 900, i % 7)).collect();
    let wide = write(d, "wide.xyz", wide);
    refuse(&["--cloud", &wide], &["wide.xyz", "is no single tree", "larix forest"]);
    refuse(&["--cloud", "nowhere.laz"], &["nowhere.laz", "help:"]);
}

#[test]
fn a_tree_has_stages_and_an_age() {
    let dir = tempfile::tempdir().unwrap();
    let tree = |name: &str, more: &[&str]| -> serde_json::Value {
        let path = dir.path().join(name).to_string_lossy().into_owned();
        let mut args = vec!["tree", "picea_obovata", "--triangles", "2000", "--texture", "64"];
        args.extend_from_slice(&["--json", "-o", &path]);
        args.extend_from_slice(more);
        let out = larix(&args);
        assert!(out.status.success(), "{}", text(&out.stderr));
        serde_json::from_slice(&out.stdout).unwrap()
    };
    let nodes = |report: &serde_json::Value| {
        let stages = report["stages"].as_array().unwrap();
        let skeleton = stages.iter().find(|s| s["stage"] == "skeleton").unwrap();
        assert!(skeleton["notes"].to_string().contains("years old"), "{skeleton}");
        skeleton["items_out"]["count"].as_u64().unwrap()
    };
    let counts: Vec<u64> = ["2", "6", "11", "12"]
        .iter()
        .map(|k| nodes(&tree(&format!("stage{k}.glb"), &["--stage", k])))
        .collect();
    assert!(counts.is_sorted() && counts[0] < counts[2], "{counts:?}");
    assert_eq!(counts[3], nodes(&tree("grown.glb", &[])));
    let glb = |name: &str| fs::read(dir.path().join(name)).unwrap();
    assert!(glb("stage12.glb") == glb("grown.glb"), "the last stage is the grown tree");
    tree("young.glb", &["--age", "9"]);
    let o = dir.path().join("x.glb").to_string_lossy().into_owned();
    tree("hemmed.glb", &["--wall", "1,0", "--wall", "-1.5,-1", "--neighbour", "0,3"]);
    assert!(glb("hemmed.glb") != glb("grown.glb"));
    for bad in ["0,0", "3", "a,b", "1,2,3"] {
        refused(&["tree", "picea_obovata", "--wall", bad, "-o", &o], &["give two numbers"]);
    }
    refused(&["tree", "picea_obovata", "--stage", "13", "-o", &o], &["13 is not in 1..=12"]);
    refused(&["tree", "picea_obovata", "--age", "-4", "-o", &o], &["--age"]);
    refused(
        &["tree", "picea_obovata", "--age", "0.01", "-o", &o],
        &["--age 0.01: Picea obovata is lower than 0.1 m then", "years or more"],
    );
    refused(&["tree", "picea_obovata", "--height", "500", "-o", &o], &["can't be grown"]);
    refused(
        &["tree", "picea_obovata", "--age", "9", "--height", "3", "-o", &o],
        &["cannot be used with"],
    );
}

/// A small demo in a folder; gives its report.
fn small_demo(dir: &Path, more: &[&str]) -> serde_json::Value {
    let mut args = vec!["demo", "--trees", "12", "--triangles", "600", "--texture", "64"];
    args.extend(["--format", "glb", "--quiet", "-o", dir.to_str().unwrap()]);
    args.extend(more);
    let out = larix(&args);
    assert!(out.status.success(), "{}", text(&out.stderr));
    serde_json::from_slice(&fs::read(dir.join("report.json")).unwrap()).unwrap()
}

#[test]
fn levels_lie_beside_the_scene_and_say_how_far_off_they_are() {
    let dir = tempfile::tempdir().unwrap();
    let more = ["--lods", "2", "--impostor", "cross", "--collision", "convex", "--wind", "unity"];
    let report = small_demo(dir.path(), &more);
    let models = report["scene"]["models"].as_u64().unwrap() as usize;
    let rows = report["levels"].as_array().unwrap();
    assert_eq!(rows.len(), models * 4);
    for of_model in rows.chunks(4) {
        let names: Vec<_> = of_model.iter().map(|r| r["level"].as_str().unwrap()).collect();
        assert_eq!(names, ["LOD0", "LOD1", "LOD2", "impostor"]);
        let triangles: Vec<_> = of_model.iter().map(|r| r["triangles"].as_u64().unwrap()).collect();
        assert!(triangles.windows(2).all(|w| w[0] > w[1]), "{triangles:?}");
        let worst = |k: usize| of_model[k]["silhouette_worst_m"].as_f64().unwrap();
        assert_eq!(worst(0), 0.0);
        assert!(worst(1) > 0.0 && worst(2) > 0.0);
    }
    for (name, has_terrain) in [
        ("forest", true),
        ("forest_LOD1", false),
        ("forest_LOD2", false),
        ("forest_impostor", false),
    ] {
        let (document, ..) = gltf::import(dir.path().join(format!("{name}.glb"))).unwrap();
        assert_eq!(document.nodes().any(|n| n.name() == Some("terrain")), has_terrain, "{name}");
        let bodies = document.nodes().filter(|n| n.name().is_some_and(|n| n.starts_with("UCX_")));
        assert_eq!(bodies.count() > 0, has_terrain, "{name}");
        // Opened together, no two forms have one name.
        let level = name.strip_prefix("forest").unwrap();
        let is_tree = |n: &gltf::Node| n.extras().as_ref().is_some_and(|e| e.get().contains("id"));
        let root = document.default_scene().unwrap().nodes().next().unwrap();
        assert!(root.name().unwrap().ends_with(level), "{name}");
        let named: Vec<_> = document.nodes().map(|n| n.name().unwrap().to_owned()).collect();
        assert_eq!(named.iter().collect::<BTreeSet<_>>().len(), named.len(), "{named:?}");
        assert!(level.is_empty() || root.children().all(|n| n.name().unwrap().ends_with(level)));
        let trees: Vec<_> = document.nodes().filter(is_tree).collect();
        assert!(!trees.is_empty(), "{name}");
        for tree in trees {
            let (mesh, extras) = (tree.mesh().unwrap(), tree.extras().as_ref().unwrap().get());
            assert!(tree.name().unwrap().ends_with(level) && mesh.name().unwrap().ends_with(level));
            assert!(!extras.contains(level) || level.is_empty(), "{extras}");
            let off = mesh.extras().as_ref().map(|e| e.get().contains("silhouette_rms_m"));
            assert_eq!(off.unwrap_or(false), !level.is_empty(), "{name}");
        }
    }
}

/// Area of the crowns in a file that are no leaves, by the species that its meshes are named after, square
/// metres.
fn crown_area_sq_m(file: &Path) -> BTreeMap<String, f32> {
    let (document, buffers, _) = gltf::import(file).unwrap();
    let mut area_sq_m = BTreeMap::new();
    for mesh in document.meshes() {
        let species: Vec<&str> = mesh.name().unwrap().split('_').take(2).collect();
        let crowns = mesh
            .primitives()
            .filter(|p| p.material().name().is_some_and(|m| m.ends_with("_crown")));
        for primitive in crowns {
            let reader = primitive.reader(|b| Some(&buffers[b.index()]));
            let position: Vec<glam::Vec3> =
                reader.read_positions().unwrap().map(glam::Vec3::from).collect();
            let index: Vec<u32> = reader.read_indices().unwrap().into_u32().collect();
            let of_one = |corners: &[u32]| {
                let [a, b, c] = [0, 1, 2].map(|k| position[corners[k] as usize]);
                0.5 * (b - a).cross(c - a).length()
            };
            let total: f32 = index.chunks_exact(3).map(of_one).sum();
            *area_sq_m.entry(species.join("_")).or_default() += total;
        }
    }
    area_sq_m
}

/// The coarsest model of a bare tree is no whole crown, beside finer ones or alone.
#[test]
fn a_forest_in_winter_is_seen_through_from_near_and_far() {
    let dir = tempfile::tempdir().unwrap();
    let sheds =
        |species: &str| ["Betula", "Larix", "Populus"].iter().any(|g| species.starts_with(g));
    for (name, more) in
        [("forest_LOD4", &["--lods", "4"][..]), ("forest", &["--scene-triangles", "1000"])]
    {
        let made = |season: &str| {
            let to = dir.path().join(season);
            small_demo(&to, &[more, &["--season", season]].concat());
            crown_area_sq_m(&to.join(format!("{name}.glb")))
        };
        let (winter, summer) = (made("winter"), made("summer"));
        assert!(summer.keys().any(|s| sheds(s)) && summer.keys().any(|s| !sheds(s)));
        for (species, summer_sq_m) in &summer {
            // Bare twigs are pictures of leaves' own material.
            let share = winter.get(species).map_or(0.0, |sq_m| sq_m / summer_sq_m);
            assert_eq!(share < 0.2, sheds(species), "{name} {species}: {share}");
        }
    }
}

/// What is asked for and cannot be had is told, more as less.
#[test]
fn triangles_that_a_scene_leaves_unspent_are_told_of() {
    let dir = tempfile::tempdir().unwrap();
    let told = |scene: &str| -> String {
        let report = small_demo(dir.path(), &["--scene-triangles", scene]);
        report["warnings"].as_array().unwrap().iter().map(|w| w.as_str().unwrap()).collect()
    };
    let all = told("1000000");
    assert!(all.contains("as no model has more than 600; give more --triangles"), "{all}");
    let some = told("5000");
    assert!(!some.contains("--scene-triangles 5000"), "{some}");
}

/// A crown that has thinned out makes no stem thicker: models are as wide in place as when they were whole.
#[test]
fn trees_of_a_dying_forest_have_the_stems_they_had() {
    let dir = tempfile::tempdir().unwrap();
    let widths = |condition: &str| -> BTreeMap<String, f32> {
        let to = dir.path().join(condition);
        small_demo(&to, &["--condition", condition]);
        let (document, _, _) = gltf::import(to.join("forest.glb")).unwrap();
        let nodes = document.nodes().filter(|n| n.mesh().is_some());
        let width = |n: gltf::Node| (n.name().unwrap().to_owned(), n.transform().decomposed().2[0]);
        nodes.map(width).collect()
    };
    let healthy = widths("I");
    for condition in ["IV", "VI"] {
        let dying = widths(condition);
        assert!(dying.len() > 8 && dying.len() == healthy.len());
        let mean =
            dying.iter().map(|(tree, x)| x / healthy[tree]).sum::<f32>() / dying.len() as f32;
        assert!((0.85..1.12).contains(&mean), "{condition}: {mean}");
    }
}

/// Of an aspen 8 views of 32 pixels show no stem.
#[test]
fn an_octahedral_impostor_keeps_its_stem_with_small_pictures() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("aspen.glb");
    let of = ["tree", "populus_tremula", "--texture", "128", "--impostor", "octahedral"];
    let out = larix(&[&of[..], &["--json", "-o", file.to_str().unwrap()]].concat());
    assert!(out.status.success(), "{}", text(&out.stderr));
    let told: serde_json::Value = serde_json::from_slice(&out.stdout).unwrap();
    let last = told["levels"].as_array().unwrap().last().unwrap();
    let worst_m = last["silhouette_worst_m"].as_f64().unwrap();
    assert!(worst_m < 5.0, "{last}");
}

/// Importers number what has one name.
#[test]
fn nodes_of_a_tree_have_names_of_their_own() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("tree.glb");
    let of = ["tree", "corylus_avellana", "--triangles", "600", "--texture", "0"];
    let more = ["--lods", "1", "--collision", "convex", "-o", file.to_str().unwrap()];
    let out = larix(&[&of[..], &more].concat());
    assert!(out.status.success(), "{}", text(&out.stderr));
    let mut names = BTreeSet::new();
    for name in ["tree.glb", "tree_LOD1.glb"] {
        let (document, ..) = gltf::import(dir.path().join(name)).unwrap();
        for node in document.nodes() {
            let name = node.name().unwrap().to_owned();
            assert!(names.insert(name.clone()), "{name} twice");
        }
    }
    let roots = ["Corylus_avellana_root", "Corylus_avellana_root_LOD1"];
    assert!(roots.iter().all(|root| names.contains(*root)), "{names:?}");
}

#[test]
fn too_few_triangles_for_any_leaf_are_told_of() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("spruce.glb");
    let of = ["tree", "picea_obovata", "--foliage", "geometry", "--triangles", "200"];
    let out = larix(&[&of[..], &["--texture", "0", "-o", file.to_str().unwrap()]].concat());
    assert!(out.status.success(), "{}", text(&out.stderr));
    let told = text(&out.stderr) + &text(&out.stdout);
    assert!(told.contains("too few triangles for any leaf"), "{told}");
    assert!(!told.contains("needs no more"), "{told}");
}

#[test]
fn an_octahedral_impostor_is_measured_as_its_shader_shows_it() {
    let dir = tempfile::tempdir().unwrap();
    let rms_m = |kind: &str| {
        let file = dir.path().join(kind).join("tree.glb");
        let o = file.to_str().unwrap();
        let of = ["tree", "larix_sibirica", "--texture", "512", "--profile", "engine"];
        let out =
            larix(&[&of[..], &["--impostor", kind, "--lods", "1", "--json", "-o", o]].concat());
        assert!(out.status.success(), "{}", text(&out.stderr));
        let told: serde_json::Value = serde_json::from_slice(&out.stdout).unwrap();
        let last = told["levels"].as_array().unwrap().last().unwrap().clone();
        assert_eq!(last["level"], "impostor");
        // Readers without that shader show the sheet alone, and from farther away than LOD1.
        let file = text(&fs::read(&file).unwrap());
        assert!(file.contains("LOD1") && file.contains("MSFT_lod"), "{kind}");
        last["silhouette_rms_m"].as_f64().unwrap()
    };
    let (cross_m, octahedral_m) = (rms_m("cross"), rms_m("octahedral"));
    assert!(octahedral_m < cross_m, "{octahedral_m} {cross_m}");
}

/// What a run says all leaves would take is enough for them, though wood and dry twigs then take more, too.
#[test]
fn as_many_triangles_as_told_are_enough_for_all_leaves() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("tree.glb");
    let told = |triangles: &str| {
        let of = ["tree", "quercus_robur", "--height", "4", "--condition", "IV", "--texture", "64"];
        let asked = ["--foliage", "geometry", "--triangles", triangles, "-o"];
        let out = larix(&[&of[..], &asked, &[file.to_str().unwrap()]].concat());
        assert!(out.status.success(), "{}", text(&out.stderr));
        let words = text(&out.stderr).split_whitespace().collect::<Vec<_>>().join(" ");
        let (_, more) = words.split_once("which would take about ")?;
        Some(more.split_whitespace().next().unwrap().to_owned())
    };
    let enough = told("15000").unwrap();
    assert_eq!(told(&enough), None, "{enough}");
}

/// What looks through an impostor of leaves looks at bark where there are none; and of bare branches a picture
/// shows more than the few that a coarse mesh has.
#[test]
fn an_impostor_of_bare_wood_is_opaque_and_nearer_than_its_coarse_meshes() {
    let dir = tempfile::tempdir().unwrap();
    let made = |name: &str, more: &[&str]| {
        let file = dir.path().join(name).join("tree.glb");
        let of = ["tree", "quercus_robur", "--texture", "64", "--lods", "3", "--impostor", "cross"];
        let out = larix(&[&of[..], more, &["-o", file.to_str().unwrap()]].concat());
        assert!(out.status.success(), "{}", text(&out.stderr));
        let impostor = fs::read(file.with_file_name("tree_impostor.glb")).unwrap();
        let is_translucent = text(&impostor).contains("KHR_materials_diffuse_transmission");
        (is_translucent, text(&out.stderr).contains("much nearer to the finest than LOD3"))
    };
    assert_eq!(made("leaf", &[]), (true, false));
    assert_eq!(made("bare", &["--bare"]), (false, true));
}

/// Few leaves leave triangles over, and show what branches there are.
#[test]
fn coarser_forms_of_a_dying_tree_keep_its_branches() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("tree.glb");
    let of = ["tree", "picea_abies", "--condition", "IV", "--lods", "4", "--texture", "64"];
    let out = larix(&[&of[..], &["--json", "-o", file.to_str().unwrap()]].concat());
    assert!(out.status.success(), "{}", text(&out.stderr));
    let told: serde_json::Value = serde_json::from_slice(&out.stdout).unwrap();
    let levels = told["levels"].as_array().unwrap();
    let triangles = |k: usize| levels[k]["triangles"].as_u64().unwrap();
    let rms_m = |k: usize| levels[k]["silhouette_rms_m"].as_f64().unwrap();
    assert!(triangles(1) > 5_000 && triangles(1) <= 8_000, "{}", triangles(1));
    assert!(triangles(2) > 1_500 && triangles(2) <= 3_000, "{}", triangles(2));
    assert!(rms_m(1) < 0.1 && rms_m(2) < 0.25, "{levels:?}");
}

#[test]
fn a_tree_in_plain_colours_has_no_texture_coordinates() {
    let dir = tempfile::tempdir().unwrap();
    let made = |name: &str, px: &str| {
        let o = dir.path().join(name);
        let of = ["tree", "betula_pendula", "--triangles", "600", "--texture", px, "--quiet"];
        let looks: &[&str] =
            if name.ends_with(".glb") || name.ends_with(".usda") { &["--variants"] } else { &[] };
        let out = larix(&[&of[..], looks, &["-o", o.to_str().unwrap()]].concat());
        assert!(out.status.success(), "{}", text(&out.stderr));
        text(&fs::read(o).unwrap())
    };
    for (name, coordinates) in [
        ("a.glb", "TEXCOORD_0"),
        ("a.usda", "primvars:st ="),
        ("a.x3d", "<TextureCoordinate"),
        ("a.obj", "\nvt "),
    ] {
        assert!(made(name, "64").contains(coordinates), "{name}");
        let plain = made(name, "0");
        assert!(!plain.contains(coordinates) && !plain.contains(".png"), "{name}");
    }
}

#[test]
fn a_box_and_a_camera_leave_out_what_they_do_not_show() {
    let dir = tempfile::tempdir().unwrap();
    let whole = small_demo(dir.path(), &[]);
    let trees = |report: &serde_json::Value| report["scene"]["trees"].as_u64().unwrap();
    let number = |v: &serde_json::Value| v.as_f64().unwrap();
    let origin: Vec<f64> =
        whole["scene"]["origin"].as_array().unwrap().iter().map(number).collect();
    let [low, high] = [0, 1].map(|k| {
        let corner = whole["scene"]["bounds_m"][k].as_array().unwrap();
        [0, 1, 2].map(|i| origin[i] + number(&corner[i]))
    });
    let middle = [0, 1, 2].map(|i| 0.5 * (low[i] + high[i]));
    let half = format!("{},{},{},{}", low[0] - 9.0, low[1] - 9.0, middle[0], high[1] + 9.0);
    let clipped = small_demo(dir.path(), &["--clip", &half]);
    let saved = |report: &serde_json::Value, what: &str| {
        let lines = report["left_out"].as_array().unwrap();
        lines.iter().find(|l| l["what"] == what).map_or(0, |l| l["count"].as_u64().unwrap())
    };
    let left_out = saved(&clipped, "trees outside the box");
    assert!(left_out > 0 && trees(&clipped) > 0);
    assert_eq!(trees(&clipped) + left_out, trees(&whole));

    let place = |p: [f64; 3]| format!("{},{},{}", p[0], p[1], p[2]);
    let far = [middle[0], low[1] - 200.0, high[2] + 150.0];
    let seen = small_demo(dir.path(), &["--camera", &format!("{},{}", place(far), place(middle))]);
    assert_eq!(seen["camera"]["outside"], 0);
    let before = seen["camera"]["triangles_before"].as_u64().unwrap();
    // A pixel there is 17 cm wide: hardly a tree needs its finest form.
    assert!(seen["camera"]["triangles"].as_u64().unwrap() < before, "{:#}", seen["camera"]);
    let costs: Vec<f64> =
        seen["left_out"].as_array().unwrap().iter().map(|l| number(&l["cost_seconds"])).collect();
    let spent = |stage: &str| {
        let stages = seen["stages"].as_array().unwrap();
        stages.iter().find(|s| s["stage"] == stage).map_or(0.0, |s| number(&s["seconds"]))
    };
    // To choose forms they had to be made.
    assert_eq!(costs.iter().sum::<f64>(), spent("camera") + spent("levels") + spent("choice"));
    assert!(costs.iter().any(|s| *s > 0.0) && spent("levels") > 0.0);
    let both = format!("{},{}", place(far), place(middle));
    let forms = small_demo(dir.path(), &["--camera", &both, "--lods", "2"]);
    assert!(forms["warnings"].to_string().contains("no other levels or impostors are written"));
    let behind = [far[0], 2.0 * far[1] - middle[1], far[2]];
    let none = small_demo(dir.path(), &["--camera", &format!("{},{}", place(far), place(behind))]);
    assert_eq!(saved(&none, "trees the camera does not see"), trees(&whole));
    assert_eq!((trees(&none), &none["camera"]["hidden"]), (0, &serde_json::json!(0)));
    let warned = none["warnings"].to_string();
    assert!(warned.contains("the camera sees none of the"), "{warned}");
    assert!(warned.contains(&format!("{:.0},{:.0},", low[0], low[1])), "{warned}");

    let elsewhere =
        ["demo", "--trees", "12", "--clip", "0,0,1,1", "-o", dir.path().to_str().unwrap()];
    refused(&elsewhere, &["the box to clip to lies outside the scan", "give --clip"]);
    refused(&["demo", "--clip", "5,0,1,1"], &["WEST,SOUTH,EAST,NORTH"]);
    refused(&["demo", "--camera", "1,2,3,1,2,3"], &["looks at itself"]);
}

#[test]
fn a_goal_chooses_settings_and_says_what_was_reached() {
    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| dir.path().join(name).to_string_lossy().into_owned();
    let small = ["--trees", "12", "--texture", "64", "--triangles", "400", "--format", "glb"];
    let demo = larix(&[&["demo", "--quiet", "-o", &at("demo")][..], &small].concat());
    assert!(demo.status.success(), "{}", text(&demo.stderr));
    let scan = at("demo/scan.laz");
    let run = |goal: [&str; 2], out: &str| {
        let to = at(out);
        let usual = ["forest", &scan, "--texture", "64", "--format", "glb", "--json", "-o", &to];
        let out = larix(&[&usual[..], &goal].concat());
        let said = text(&out.stderr);
        assert!(out.status.success() && fs::exists(format!("{to}/forest.glb")).unwrap(), "{said}");
        let report: serde_json::Value = serde_json::from_slice(&out.stdout).unwrap();
        (report["goal"].clone(), said)
    };
    let (coarse, said) = run(["--error", "9"], "coarse");
    assert!(said.contains("chosen: ") && !said.contains("warning: --error"), "{said}");
    let (fine, said) = run(["--error", "0.001"], "fine");
    assert!(
        said.contains("warning: --error 0.001: the finest setting that was tried reaches"),
        "{said}"
    );
    let error = |goal: &serde_json::Value| goal["crown_error_m"].as_f64().unwrap();
    assert!(error(&fine) < 0.7 * error(&coarse), "{fine} {coarse}");
    let (hurried, said) = run(["--time", "0.001"], "hurried");
    assert_eq!(hurried["setting"], coarse["setting"], "{said}");
    assert!(said.contains("warning: --time 0.001: it took"), "{said}");
    // What is chosen is chosen for the trees within the box.
    let to = at("clipped");
    let usual = ["forest", &scan, "--texture", "64", "--format", "glb", "--json", "-o", &to];
    let clipped =
        larix(&[&usual[..], &["--error", "9", "--clip", "561199,6213399,561222,6213438"]].concat());
    assert!(clipped.status.success(), "{}", text(&clipped.stderr));
    let report: serde_json::Value = serde_json::from_slice(&clipped.stdout).unwrap();
    let of = |name: &str, side: &str| {
        let stage = report["stages"].as_array().unwrap().iter().find(|s| s["stage"] == name);
        stage.unwrap()[side]["count"].as_u64().unwrap()
    };
    assert!(of("setting", "items_in") < of("crown", "items_out"), "{report}");
    assert_eq!(of("setting", "items_in"), of("fit", "items_in"), "{report}");
    assert!(report["left_out"].to_string().contains("trees outside the box"), "{report}");
    // There is time enough for the most right of all.
    let (patient, _) = run(["--time", "100000"], "patient");
    assert!(error(&patient) <= error(&fine), "{patient} {fine}");
}

#[test]
fn goals_go_with_none_of_the_options_that_they_decide() {
    for decided in
        [["--effort", "best"], ["--tolerance", "0.1"], ["--triangles", "500"], ["--unique", "all"]]
    {
        for goal in [["--error", "0.25"], ["--time", "10"]] {
            let args = [&["forest", "x.laz"][..], &goal, &decided].concat();
            refused(&args, &["cannot be used with", goal[0], decided[0]]);
        }
    }
    refused(&["forest", "x.laz", "--error", "1", "--time", "1"], &["cannot be used with"]);
    refused(&["forest", "x.laz", "--error", "-1"], &["greater than 0"]);
    refused(&["forest", "x.laz", "--time", "soon"], &["greater than 0"]);
}

#[test]
fn a_forest_without_textures_has_colours_and_no_pictures_of_trees() {
    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| dir.path().join(name).to_string_lossy().into_owned();
    let small = ["--trees", "6", "--triangles", "400", "--format", "gltf", "--quiet"];
    let textures = |px: &str, out: &str| {
        let to = at(out);
        let run = larix(&[&["demo", "--texture", px, "-o", &to][..], &small].concat());
        assert!(run.status.success(), "{}", text(&run.stderr));
        let json = fs::read_to_string(format!("{to}/forest.gltf")).unwrap();
        let json: serde_json::Value = serde_json::from_str(&json).unwrap();
        json["textures"].as_array().map_or(0, Vec::len)
    };
    assert_eq!(textures("0", "plain"), 1, "the terrain's alone");
    assert!(textures("64", "pictured") > 10);
    refused(&["demo", "--texture", "63"], &["from 64 to 4096, or 0"]);
    refused(&["demo", "--texture", "513"], &["an even number of pixels"]);
    refused(
        &["demo", "--seed", "-1"],
        &["--seed", "a whole number from 0 to 18446744073709551615"],
    );
    let views = ["--impostor", "cross", "--impostor-views", "16", "-o", "birch.glb"];
    refused(
        &[&["tree", "betula_pendula"], &views[..]].concat(),
        &["there is none", "--impostor octahedral"],
    );
    let coloured = ["--wind", "unity", "--wind-as", "color", "-o", "birch.usda"];
    let coloured = [&["tree", "betula_pendula"], &coloured[..]].concat();
    refused(&coloured, &["--wind-as is for glTF, not for .usda files", "write a .glb"]);
}

/// Options of which nothing comes.
#[test]
fn what_has_no_effect_is_told() {
    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| dir.path().join(name).to_string_lossy().into_owned();
    let told = |species: &str, more: &[&str], file: &str| {
        let file = at(file);
        let out = larix(&[&["tree", species, "--texture", "64", "-o", &file], more].concat());
        assert!(out.status.success(), "{}", text(&out.stderr));
        text(&out.stderr) + &text(&out.stdout)
    };
    for bare in [&["--bare"][..], &["--condition", "VI"]] {
        let said = told("betula_pendula", &[bare, &["--variants"]].concat(), "bare.glb");
        assert!(said.contains("--variants: Betula pendula bears no leaves here"), "{said}");
    }
    assert!(!told("betula_pendula", &["--variants"], "leafy.glb").contains("--variants"));
    let said = told("betula_pendula", &["--profile", "web"], "birch.usda");
    assert!(said.contains(".usda files are no smaller for --profile web"), "{said}");
    assert!(!told("betula_pendula", &["--profile", "web"], "birch.glb").contains("no smaller"));
    let said = told("pinus_sylvestris", &["--stage", "4"], "pole.glb");
    assert!(said.contains("--stage 4: a stem of") && said.contains("--height"), "{said}");
    assert!(!told("pinus_sylvestris", &["--stage", "12"], "grown.glb").contains("--stage 12:"));
    let small = ["--height", "0.6", "--triangles", "100000"];
    let said = told("corylus_avellana", &small, "small.glb");
    assert!(said.contains("100000 triangles were allowed, it needs no more than these"), "{said}");
    let said =
        told("quercus_robur", &["--season", "winter", "--foliage", "geometry"], "winter.glb");
    assert!(!said.contains("leaves or needles"), "{said}");
}

/// Many trees of a species are stored with one set of pictures.
#[test]
fn trees_of_all_seeds_have_the_same_pictures() {
    let pictures = |seed: &str| {
        let dir = tempfile::tempdir().unwrap();
        let to = dir.path().join("birch.gltf").to_string_lossy().into_owned();
        let small = ["--height", "6", "--triangles", "1000", "--texture", "64", "--no-cache"];
        let grown = ["tree", "betula_pendula", "--seed", seed, "-o", &to];
        let out = larix(&[&grown[..], &small].concat());
        assert!(out.status.success(), "{}", text(&out.stderr));
        let mut found: Vec<(String, Vec<u8>)> = fs::read_dir(dir.path().join("textures"))
            .unwrap()
            .map(|file| file.unwrap().path())
            .map(|path| {
                (path.file_name().unwrap().to_string_lossy().into(), fs::read(path).unwrap())
            })
            .collect();
        found.sort();
        (found, fs::read(dir.path().join("birch.bin")).unwrap())
    };
    let [(one, tree), (other, other_tree)] = ["1", "7"].map(pictures);
    assert!(one.len() > 5 && tree != other_tree);
    assert!(one == other);
}

/// What a light map would take is told as it is.
#[cfg(feature = "atlas")]
/// Each level is a file with the pictures of its tree.
#[test]
fn levels_weigh_what_is_told() {
    let dir = tempfile::tempdir().unwrap();
    let of = |name: &str, more: &[&str]| {
        let to = dir.path().join(name).join("tree.glb").to_string_lossy().into_owned();
        let small = ["tree", "quercus_robur", "--triangles", "5000", "--texture", "256", "--json"];
        let out = larix(&[&small[..], &["-o", &to], more].concat());
        assert!(out.status.success(), "{}", text(&out.stderr));
        let report: serde_json::Value = serde_json::from_slice(&out.stdout).unwrap();
        let told = report["left_out"].as_array().unwrap().clone();
        let told = told.into_iter().find(|l| l["what"] == "coarser levels");
        let files = contents(&dir.path().join(name));
        (files.iter().map(|f| f.1.len()).sum::<usize>() as f64, told)
    };
    let ((one, told), (all, none)) = (of("one", &[]), of("all", &["--lods", "3"]));
    assert!(none.is_none());
    let share = told.unwrap()["bytes"].as_f64().unwrap() / (all - one);
    assert!((0.7..1.3).contains(&share), "{share} of what they take");
}

#[test]
fn places_on_a_light_map_weigh_what_is_told() {
    let dir = tempfile::tempdir().unwrap();
    let of = |more: &[&str]| {
        let to = dir.path().join("tree.glb").to_string_lossy().into_owned();
        let small = ["tree", "quercus_robur", "--triangles", "5000", "--texture", "0", "--json"];
        let out = larix(&[&small[..], &["-o", &to], more].concat());
        assert!(out.status.success(), "{}", text(&out.stderr));
        let report: serde_json::Value = serde_json::from_slice(&out.stdout).unwrap();
        let told = report["left_out"].as_array().unwrap().clone();
        let told = told.into_iter().find(|l| l["what"] == "places on a light map");
        (fs::metadata(&to).unwrap().len() as f64, told)
    };
    let ((plain, told), (lit, none)) = (of(&[]), of(&["--lightmap-uv"]));
    assert!(none.is_none());
    let told = told.unwrap();
    let share = told["bytes"].as_f64().unwrap() / (lit - plain);
    assert!((0.7..1.1).contains(&share), "{share} of what it takes");
    assert!(told["seconds"].as_f64().unwrap() > 0.2, "{told}");
}

#[test]
fn twigs_are_stored_once_or_refused_in_words() {
    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| dir.path().join(name).to_string_lossy().into_owned();
    let small =
        ["tree", "corylus_avellana", "--height", "1.5", "--texture", "64", "--twigs", "instance"];
    let with = |more: &[&'static str], file: &str| -> Vec<String> {
        let typed = small.iter().chain(more).map(|s| s.to_string());
        typed.chain(["-o".into(), at(file)]).collect()
    };
    let run = |args: &[String]| larix(&args.iter().map(String::as_str).collect::<Vec<_>>());
    let leafy = ["--foliage", "geometry", "--triangles", "8000"];
    for file in ["hazel.glb", "hazel.usdc", "hazel.png"] {
        let out = run(&with(&leafy, file));
        let told = text(&out.stderr);
        assert!(out.status.success() && told.contains("forms of twigs: "), "{told}");
        assert!(dir.path().join(file).exists());
    }
    let refusals: [(&[&str], &str, &[&str]); 6] = [
        (&["--foliage", "geometry", "--condition", "VI"], "no.glb", &["none hangs on a tree"]),
        (&[], "no.glb", &["no twigs of leaves or needles to store", "add --foliage geometry"]),
        (&["--bare"], "no.glb", &["leave out --bare"]),
        (&["--foliage", "geometry", "--lods", "2"], "no.glb", &["it goes without --lods"]),
        (
            &["--foliage", "geometry", "--profile", "engine"],
            "no.glb",
            &[
                "it goes without --lods, --impostor, --wind",
                "--triangles 100000 grow the same tree",
            ],
        ),
        (&["--foliage", "geometry"], "no.obj", &[".obj files hold nothing of --twigs instance"]),
    ];
    for (more, file, says) in refusals {
        let args = with(more, file);
        refused(&args.iter().map(String::as_str).collect::<Vec<_>>(), says);
        assert!(!dir.path().join(file).exists());
    }
    let spruce =
        ["tree", "picea_abies", "--texture", "64", "--twigs", "instance", "--triangles", "3000"];
    let file = at("no.glb");
    let args: Vec<&str> =
        spruce.into_iter().chain(["--foliage", "geometry", "-o", &file]).collect();
    refused(
        &args,
        &["a twig with all its leaves has 2650 triangles, the crown ", "--triangles more"],
    );
}
