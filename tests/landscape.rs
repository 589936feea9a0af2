//! `larix landscape` as a user meets it.

use std::fmt::Write;
use std::fs;
use std::path::Path;

use assert_cmd::Command;

fn larix(dir: &Path, args: &[&str]) -> std::process::Output {
    Command::cargo_bin("larix").unwrap().current_dir(dir).args(args).output().unwrap()
}

fn done(dir: &Path, args: &[&str]) -> String {
    let out = larix(dir, args);
    let err = String::from_utf8_lossy(&out.stderr).into_owned();
    assert!(out.status.success(), "{args:?}: {err}");
    err
}

fn refused(dir: &Path, args: &[&str], says: &[&str]) {
    let out = larix(dir, args);
    let err = String::from_utf8_lossy(&out.stderr).into_owned();
    assert!(!out.status.success(), "{args:?} succeeded");
    assert!(!err.contains("panicked"), "{err}");
    let joined = err.split_whitespace().filter(|w| *w != "│").collect::<Vec<_>>().join(" ");
    for part in says {
        assert!(joined.contains(part), "{args:?}: no `{part}` in:\n{err}");
    }
}

/// A gentle slope of 40 m with nine round crowns over it, as text.
fn scan(dir: &Path) {
    let mut text = String::new();
    let height = |x: f64, y: f64| 100.0 + 0.05 * x + 0.5 * (y * 0.2).sin();
    for i in 0..80 {
        for j in 0..80 {
            let (x, y) = (f64::from(i) * 0.5 + 0.1, f64::from(j) * 0.5 + 0.2);
            writeln!(text, "{x} {y} {:.3}", height(x, y)).unwrap();
        }
    }
    for k in 0..1800 {
        let tree = f64::from(k % 9);
        let (cx, cy) = (8.0 + 12.0 * (tree % 3.0), 8.0 + 12.0 * (tree / 3.0).floor());
        let (turn, up) = (f64::from(k) * 2.399_963, 1.0 - f64::from(k) / 1800.0);
        let out = 2.5 * (1.0 - up * up).max(0.0).sqrt();
        let (x, y) = (cx + out * turn.cos(), cy + out * turn.sin());
        writeln!(text, "{x:.3} {y:.3} {:.3}", height(cx, cy) + 6.0 + 3.0 * up).unwrap();
    }
    fs::write(dir.join("scan.xyz"), text).unwrap();
}

const SMALL: [&str; 6] = ["--size", "96x64", "--effort", "2", "--voxel", "0.5"];

#[test]
fn a_scan_becomes_pictures_layers_and_a_file() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    scan(dir);
    let all = ["-o", "a.png", "--save", "a.voxels", "--aov", "depth,normal,class,depth"];
    done(dir, &[&["landscape", "scan.xyz"], &SMALL[..], &all].concat());
    for name in ["a.png", "a_depth.png", "a_normal.png", "a_class.png"] {
        let size = larix::raster::Picture::size_of(&fs::read(dir.join(name)).unwrap()).unwrap();
        assert_eq!(size, (96, 64), "{name}");
    }
    // One thread, and from the file: the same picture.
    done(dir, &[&["landscape", "scan.xyz", "--threads", "1", "-o", "b.png"], &SMALL[..]].concat());
    done(dir, &[&["landscape", "a.voxels", "-o", "c.png"], &SMALL[..4]].concat());
    let bytes = |name: &str| fs::read(dir.join(name)).unwrap();
    assert!(bytes("a.png") == bytes("b.png"));
    assert!(bytes("a.png") == bytes("c.png"));
    // Weather, views and modes make others.
    let mut seen = vec![bytes("a.png")];
    for other in [
        &["--snow", "0.3"][..],
        &["--fog", "60"],
        &["--rain", "20"],
        &["--view", "north"],
        &["--view", "top"],
        &["--mode", "mip"],
        &["--mode", "splat"],
        &["--sun", "90,20"],
        &["--camera", "20,-30,130,20,20,105"],
    ] {
        done(dir, &[&["landscape", "a.voxels", "--out", "d.png"], &SMALL[..4], other].concat());
        assert!(!seen.contains(&bytes("d.png")), "{other:?} changes nothing");
        seen.push(bytes("d.png"));
    }
}

#[test]
fn what_cannot_be_done_is_refused_before_anything_is_written() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    scan(dir);
    fs::write(dir.join("kept.png"), "kept").unwrap();
    refused(dir, &["landscape", "scan.xyz"], &["--output", "--save"]);
    refused(dir, &["landscape", "scan.xyz", "-o", "a.jpg"], &["a.jpg", ".png"]);
    refused(dir, &["landscape", "scan.xyz", "--save", "a.bin"], &["a.bin", ".voxels"]);
    refused(dir, &["landscape", "none.laz", "-o", "kept.png"], &["none.laz"]);
    let o = ["-o", "kept.png"];
    let with = |more: &[&str]| {
        refused(dir, &[&["landscape", "scan.xyz"], &o[..], more].concat(), &[more[0]])
    };
    with(&["--size", "0x10"]);
    with(&["--size", "99999x10"]);
    with(&["--snow", "-1"]);
    with(&["--snow", "1000"]);
    with(&["--rain", "501"]);
    with(&["--fog", "nan"]);
    with(&["--sun", "10"]);
    with(&["--effort", "0"]);
    with(&["--voxel", "0"]);
    with(&["--density-bits", "5"]);
    refused(
        dir,
        &["landscape", "scan.xyz", "-o", "kept.png", "--voxel", "0.00001"],
        &["scan.xyz", "voxels", "give a larger --voxel"],
    );
    refused(
        dir,
        &["landscape", "scan.xyz", "-o", "kept.png", "--voxel", "1000"],
        &["scan.xyz", "voxels of 1000 m over", "give a --voxel of at most"],
    );
    with(&["--snow", "1", "--mode", "mip"]);
    done(dir, &["landscape", "scan.xyz", "--save", "a.voxels", "--voxel", "1"]);
    let whole = fs::read(dir.join("a.voxels")).unwrap();
    fs::write(dir.join("cut.voxels"), &whole[..whole.len() - 40]).unwrap();
    refused(
        dir,
        &["landscape", "cut.voxels", "-o", "kept.png"],
        &["cut.voxels", "cut short", "--save"],
    );
    fs::write(dir.join("odd.voxels"), "?").unwrap();
    refused(dir, &["landscape", "odd.voxels", "-o", "kept.png"], &["odd.voxels", "--save"]);
    refused(
        dir,
        &["landscape", "a.voxels", "--save", "a.voxels"],
        &["a.voxels", "would be written over"],
    );
    refused(
        dir,
        &["landscape", "scan.xyz", "--photo", "kept.png", "-o", "kept.png"],
        &["kept.png", "would be written over"],
    );
    let saved = ["landscape", "a.voxels", "-o", "kept.png"];
    refused(
        dir,
        &[&saved[..], &["--camera", "20,20,90,20,30,90"]].concat(),
        &["20,20,90 is below the ground, which is 100.", "--camera a third number above 100."],
    );
    refused(
        dir,
        &[&saved[..], &["--camera", "20,-30,130,20,-60,130"]].concat(),
        &["20,-30,130 sees nothing of the landscape, which reaches from ", "between these corners"],
    );
    for option in ["--voxel 1", "--cell 1", "--ground tin", "--density-bits 4", "--photo p.tif"] {
        let words: Vec<&str> = option.split(' ').collect();
        let says = format!("leave out {}", words[0]);
        refused(dir, &[&saved[..], &words].concat(), &["a.voxels", &says]);
    }
    refused(dir, &["landscape", "none.voxels", "-o", "kept.png"], &["none.voxels", "--save"]);
    refused(
        dir,
        &["landscape", "a.voxels", "scan.xyz", "-o", "kept.png"],
        &["a.voxels", "one saved"],
    );
    assert_eq!(fs::read(dir.join("kept.png")).unwrap(), b"kept");
}
