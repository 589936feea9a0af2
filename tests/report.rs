//! `larix report` as a user runs it, quick: whole files, a document that fits its schema, and ratios
//! and orders that hold on any machine. No time is checked.

use std::fs;
use std::path::{Path, PathBuf};

use assert_cmd::Command;
use larix::report::Document;
use larix::report::document::{self, Front};
use serde_json::Value;

fn larix(args: &[&str]) -> std::process::Output {
    Command::cargo_bin("larix").unwrap().args(args).output().unwrap()
}

fn front<'a>(document: &'a Document, id: &str) -> &'a Front {
    let found = document.fronts.iter().find(|f| f.id == id);
    found.unwrap_or_else(|| panic!("no front {id}"))
}

/// One run serves all checks, for it takes a while; those of a browser, too, if `LARIX_KEEP_REPORT` says where
/// to leave it.
#[test]
fn a_quick_report_is_whole_and_holds_what_it_claims() {
    let dir = tempfile::tempdir().unwrap();
    let kept = std::env::var_os("LARIX_KEEP_REPORT").map(PathBuf::from);
    let out = kept.unwrap_or_else(|| dir.path().join("report"));
    let run = larix(&["report", "--quick", "-o", out.to_str().unwrap()]);
    let said = String::from_utf8_lossy(&run.stderr);
    assert!(run.status.success(), "{said}");
    assert!(said.contains("s left"), "no progress in {said}");

    let text = fs::read_to_string(out.join("report.json")).unwrap();
    let json: Value = serde_json::from_str(&text).unwrap();
    let schema: Value =
        serde_json::from_str(&fs::read_to_string(out.join("report.schema.json")).unwrap()).unwrap();
    assert_eq!(schema, document::schema());
    fits(&schema, &json);
    let document: Document = serde_json::from_str(&text).unwrap();
    assert!(document.about.is_quick && document.about.machine.threads > 0);

    figures_are_told(&document);
    settings_are_measured(&document);
    accuracy_has_its_price(&document);
    errors_fall(&document);
    nothing_missed(&document);
    what_is_left_out_was_not_made(&document);
    memory_grows_near_linearly(&document);
    the_page_holds_all(&document, &out);
}

fn fits(schema: &Value, json: &Value) {
    let validator = jsonschema::validator_for(schema).unwrap();
    let faults: Vec<String> = validator.iter_errors(json).map(|e| e.to_string()).collect();
    assert!(faults.is_empty(), "{}", faults.join("\n"));
    // A document without its stability table, or with a word for a number, must not fit.
    let mut without = json.clone();
    without.as_object_mut().unwrap().remove("stability");
    assert!(!validator.is_valid(&without));
    let mut wrong = json.clone();
    wrong["fronts"][0]["points"][0]["error"] = "small".into();
    assert!(!validator.is_valid(&wrong));
}

fn figures_are_told(document: &Document) {
    let fact = |id: &str| document.facts.iter().find(|f| f.id == id).unwrap().value;
    assert_eq!(fact("trees_planted"), 60.0);
    assert!(fact("trees_matched") > 50.0 && fact("trees_matched") <= fact("trees_found"));
    assert!(fact("terrain") < 0.03 && fact("position") < 1.0);
    assert!(fact("whole") > 0.0 && fact("whole_peak") > 1.0);
}

fn settings_are_measured(document: &Document) {
    let ids: Vec<&str> = document.fronts.iter().map(|f| f.id.as_str()).collect();
    let wanted = [
        "terrain", "crowns", "heights", "fill", "mesh", "levels", "textures", "files", "rounding",
        "whole",
    ];
    assert_eq!(ids, wanted);
    for f in &document.fronts {
        assert!(f.points.len() >= 4, "{}: {} settings", f.id, f.points.len());
        assert!(f.points.iter().any(|p| p.is_on_front), "{}: no front", f.id);
        assert!(f.points.iter().all(|p| p.error.is_finite() && p.error >= 0.0), "{}", f.id);
        let is_sound = |t: &document::Timing| {
            t.runs > 0 && t.least_s <= t.median_s && t.median_s <= t.most_s && t.least_s > 0.0
        };
        assert!(f.points.iter().all(|p| is_sound(&p.time)), "{}", f.id);
        let defaults = f.points.iter().filter(|p| p.is_default).count();
        // No level is made unless asked for.
        assert_eq!(defaults, usize::from(f.id != "levels"), "{}", f.id);
        assert_eq!(f.verdict.is_empty(), defaults == 0, "{}: {}", f.id, f.verdict);
    }
}

fn accuracy_has_its_price(document: &Document) {
    let error = |id: &str, part: &str| {
        let points = &front(document, id).points;
        let found = points.iter().find(|p| p.setting.contains(part));
        found.unwrap_or_else(|| panic!("{id}: no {part}")).error
    };
    assert!(error("terrain", "smrf, cell 0.5") < 0.03);
    assert!(error("terrain", "smrf, cell 4") > 4.0 * error("terrain", "smrf, cell 0.5"));
    assert!(error("crowns", "effort normal") < 25.0);
    assert!(error("fill", "200 nodes") > 1.2 * error("fill", "8000 nodes"));
    assert!(error("mesh", "at most 500") > 1.5 * error("mesh", "at most 10000"));
    assert!(error("levels", "LOD3") > error("levels", "LOD1"));
    assert!(error("whole", "each tree") < error("whole", "2 models"));
    assert_eq!(error("rounding", "GLB dcc"), 0.0);
    let web = error("rounding", "GLB web");
    assert!(web > 0.0 && web < 5.1, "{web} mm");
    assert!(error("files", "GLB web") < 0.5 * error("files", "GLB dcc"));
}

fn errors_fall(document: &Document) {
    assert_eq!(document.convergence.len(), 5);
    for l in &document.convergence {
        assert!(l.converges, "{}: {}", l.title, l.verdict);
        let fit = l.fit.unwrap();
        assert!(fit.order > 0.79 * l.stated_order, "{}: order {}", l.title, fit.order);
    }
}

fn nothing_missed(document: &Document) {
    let missed: Vec<String> = document
        .stability
        .iter()
        .filter(|f| !f.passes)
        .map(|f| format!("{}: {}: {}", f.stage, f.input, f.happened))
        .collect();
    assert!(missed.is_empty(), "{}", missed.join("\n"));
    assert!(document.stability.len() >= 88, "{}", document.stability.len());
}

fn what_is_left_out_was_not_made(document: &Document) {
    let [of_demo] = &document.left_out[..] else { panic!("{:?}", document.left_out) };
    assert_eq!(of_demo.rows.len(), 7);
    for row in &of_demo.rows {
        assert!(row.is_proved && !row.work.is_empty(), "{row:?}");
        assert!(row.work.iter().all(|w| w.with > 0 && w.without == 0), "{row:?}");
        // A photo may be smaller than the tile of forest floor in its stead; a camera leaves out.
        let may_spare = ["photo", "camera"].iter().any(|w| row.what.contains(w));
        assert!(row.bytes_saved > 0 || may_spare, "{row:?}");
        assert!(row.removed != "nothing", "{row:?}");
        assert_eq!(row.what.contains("camera"), row.removed.contains(" trees"), "{row:?}");
    }
}

fn memory_grows_near_linearly(document: &Document) {
    for s in document.scale.iter().flat_map(|s| &s.series) {
        // What else runs on the machine shows in it: a number is all that can be asked for.
        assert!(s.time_exponent.is_some_and(f64::is_finite), "{s:?}");
        assert!(s.memory_exponent.is_some_and(|e| (0.1..1.3).contains(&e)), "{s:?}");
    }
}

fn the_page_holds_all(document: &Document, out: &Path) {
    let page = fs::read_to_string(out.join("report.html")).unwrap();
    for f in &document.fronts {
        assert!(page.contains(&format!("<figure id=\"plot-{}\"><svg", f.id)), "{}", f.id);
        let plot = fs::read_to_string(out.join(format!("plots/{}.svg", f.id))).unwrap();
        assert!(plot.starts_with("<svg") && plot.contains("viewBox"), "{}", f.id);
    }
    for outside in ["http://", "https://", "<script", "url("] {
        let own = page.replace("http://www.w3.org/2000/svg", "");
        assert!(!own.contains(outside), "the page holds {outside}");
    }
    for f in &document.stability {
        assert!(page.contains(&f.input.replace('&', "&amp;")), "{}", f.input);
    }
}

/// Few trees, and none of the truth: every chapter has what it can have, or says why not.
#[test]
fn a_report_of_a_scan_is_whole() {
    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| dir.path().join(name).to_string_lossy().into_owned();
    let small = ["--trees", "9", "--texture", "64", "--triangles", "300", "--format", "glb"];
    let demo = larix(&[&["demo", "--quiet", "-o", &at("demo")][..], &small].concat());
    assert!(demo.status.success());
    let (scan, photo, out) = (at("demo/scan.laz"), at("demo/photo.tif"), at("report"));
    let run = larix(&["report", "--quick", "--quiet", &scan, "--photo", &photo, "-o", &out]);
    assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
    let text = fs::read_to_string(Path::new(&out).join("report.json")).unwrap();
    fits(&document::schema(), &serde_json::from_str(&text).unwrap());
    let document: Document = serde_json::from_str(&text).unwrap();
    assert_eq!(document.fronts.len(), 10);
    let [own, simulated] = &document.left_out[..] else { panic!("{:?}", document.left_out) };
    assert!(own.subject.contains("scan.laz") && simulated.subject.contains("simulated"));
    for row in own.rows.iter().chain(&simulated.rows) {
        assert!(row.is_proved, "{row:?}");
    }
    assert!(document.facts.iter().any(|f| f.id == "terrain_held_out"));
    assert!(!document.facts.iter().any(|f| f.id == "position"));
    assert_eq!(front(&document, "terrain").truth, document::Truth::HeldOut);
    nothing_missed(&document);
}

#[test]
fn what_can_not_be_measured_is_refused_and_nothing_is_written() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("out");
    let to = out.to_str().unwrap();
    for args in [
        &["report", "missing.laz", "-o", to][..],
        &["report", "--photo", "x.tif", "-o", to],
        &["report", "x.laz", "--simulated", "-o", to],
        &["report", "--species", "no_such_tree", "-o", to],
    ] {
        let run = larix(args);
        assert!(!run.status.success(), "{args:?}");
        assert!(!String::from_utf8_lossy(&run.stderr).contains("panicked"));
        assert!(!out.join("report.html").exists());
    }
}
