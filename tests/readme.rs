//! The figures of README.md come from reports that are kept in `docs/reports`; each was written by
//! `larix report` (the JSON tells of what, where and when in the program's life). With `UPDATE_DOCS`
//! set the block is written anew, after newer reports were put there.

use std::fs;
use std::path::Path;

use larix::report::Document;
use larix::report::document::{self, Front, Series};

const BEGIN: &str = "<!-- figures of docs/reports, by tests/readme.rs -->\n";
const END: &str = "<!-- end of figures -->\n";

fn at(path: &str) -> std::path::PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(path)
}

fn report(name: &str) -> Document {
    let text = fs::read_to_string(at(&format!("docs/reports/{name}.json"))).unwrap();
    let json: serde_json::Value = serde_json::from_str(&text).unwrap();
    let schema = jsonschema::validator_for(&document::schema()).unwrap();
    let faults: Vec<String> = schema.iter_errors(&json).map(|e| e.to_string()).collect();
    assert!(faults.is_empty(), "{name}: {}", faults.join("\n"));
    let document: Document = serde_json::from_value(json).unwrap();
    assert!(!document.about.machine.has_assertions, "{name}: measured with debug assertions");
    let missed = document.stability.iter().filter(|f| !f.passes).count();
    assert_eq!(missed, 0, "{name}: stability cases missed");
    document
}

fn fact(document: &Document, id: &str) -> f64 {
    let found = document.facts.iter().find(|f| f.id == id);
    found.unwrap_or_else(|| panic!("{}: no {id}", document.about.subject)).value
}

/// Two digits.
fn short(value: f64) -> String {
    let digits = (1 - value.abs().log10().floor() as i32).max(0) as usize;
    format!("{value:.digits$}")
}

fn thousands(value: f64) -> String {
    let text = format!("{value:.0}");
    match text.len() {
        ..=3 => text,
        n => format!("{},{}", &text[..n - 3], &text[n - 3..]),
    }
}

fn front<'a>(document: &'a Document, id: &str) -> &'a Front {
    document.fronts.iter().find(|f| f.id == id).unwrap()
}

fn error(document: &Document, id: &str, setting: &str) -> f64 {
    let points = &front(document, id).points;
    points.iter().find(|p| p.setting == setting).unwrap_or_else(|| panic!("{id}: {setting}")).error
}

fn series<'a>(document: &'a Document, id: &str) -> &'a Series {
    document.scale.iter().find(|s| s.id == id).unwrap().series.last().unwrap()
}

fn list(series: &Series, least: f64, of: fn(&document::Scaled) -> f64) -> String {
    let values: Vec<String> =
        series.points.iter().filter(|p| p.count >= least).map(|p| short(of(p))).collect();
    let (last, first) = values.split_last().unwrap();
    format!("{} and {last}", first.join(", "))
}

fn figures() -> String {
    let demo = report("demo");
    let scans = [report("bcts_1"), report("POINTS_abs")];
    let machine = &demo.about.machine;
    let f = |id: &str| fact(&demo, id);
    let run = |d: &Document| {
        let [least, most, peak] = ["whole_least", "whole_most", "whole_peak"].map(|id| fact(d, id));
        let seconds = match (short(least), short(most)) {
            (least, most) if least == most => least,
            (least, most) => format!("{least}–{most}"),
        };
        format!("{seconds} s, {} GB", short(peak * 1e-3))
    };
    let millions = |d: &Document| format!("{} million points", short(fact(d, "points") * 1e-6));
    let trees = |d: &Document| thousands(fact(d, "trees_found"));
    let terrain = |d: &Document| format!("{} m held out", short(fact(d, "terrain_held_out")));
    let [a, b] = &scans;
    let (points, planted) = (series(&demo, "scale-points"), series(&demo, "scale-trees"));
    let fill = |setting: &str| short(error(&demo, "fill", setting));
    let sizes = error(&demo, "files", "GLB web") / error(&demo, "files", "GLB dcc");
    format!(
        "Measured by `larix report` on {} threads; [docs/reports](docs/reports) holds all of it.\n\
         \n\
         | | demo, {} trees, {} | a 4 ha scan of {} | a 3.6 ha steep scan of {} |\n\
         |---|---|---|---|\n\
         | whole run, textures drawn anew | {} | {} | {} |\n\
         | trees found | {} of {}, {} invented | {} | {} |\n\
         | terrain error | RMSE {:.3} m against the truth | {} | {} |\n\
         | position, height, crown diameter | RMSE {:.2}, {:.2}, {:.2} m | | |\n\
         | species right, of the trees found | {:.0} % | | |\n\
         \n\
         Heights come out {} on the mean: few pulses meet the thin tops of spruces. Points of crowns lie {} m\n\
         from the wood grown into them with 833 nodes, {} m with 8,000. A file for browsers has {:.0} % of the\n\
         plain one's bytes, and moves no vertex by more than {:.1} mm. Ground, terrain and crowns of 1, 5 and\n\
         20 million points take {} s (∝ n^{:.2}) and {} MB; {} and {} trees grown and meshed each for\n\
         itself {} s (∝ n^{:.2}).\n",
        machine.threads,
        thousands(f("trees_planted")),
        millions(&demo),
        millions(a),
        millions(b),
        run(&demo),
        run(a),
        run(b),
        thousands(f("trees_matched")),
        thousands(f("trees_planted")),
        thousands(f("trees_invented")),
        trees(a),
        trees(b),
        f("terrain"),
        terrain(a),
        terrain(b),
        f("position"),
        f("height"),
        f("crown_diameter"),
        f("species"),
        match f("height_bias") {
            bias if bias < 0.0 => format!("{:.1} m low", -bias),
            bias => format!("{bias:.1} m high"),
        },
        fill("833 nodes"),
        fill("8000 nodes"),
        100.0 * sizes,
        // Rounded up: it is a bound.
        (10.0 * error(&demo, "rounding", "GLB web")).ceil() / 10.0,
        list(points, 1e6, |p| p.time.median_s),
        points.last_time_exponent.unwrap(),
        list(points, 1e6, |p| p.peak_bytes as f64 * 1e-6),
        thousands(planted.points[planted.points.len() - 2].count),
        thousands(planted.points[planted.points.len() - 1].count),
        list(planted, 1e3, |p| p.time.median_s),
        planted.last_time_exponent.unwrap(),
    )
}

#[test]
fn the_figures_of_the_readme_are_those_of_the_reports() {
    let path = at("README.md");
    let readme = fs::read_to_string(&path).unwrap();
    let (before, rest) = readme.split_once(BEGIN).expect("the block of figures");
    let (held, after) = rest.split_once(END).expect("the end of the figures");
    let figures = figures();
    if std::env::var_os("UPDATE_DOCS").is_some() {
        fs::write(&path, [before, BEGIN, &figures, END, after].concat()).unwrap();
    } else {
        assert_eq!(held, figures, "set UPDATE_DOCS to write the figures anew");
    }
}
