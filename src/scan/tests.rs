//! Real scans, round trips and broken files.

mod damaged;

use std::path::{Path, PathBuf};

use glam::{DVec3, Vec3};

use super::tiles::TiledScan;
use super::*;
use crate::diagnostic::{Error, render};
use crate::frame::{Crs, Frame};
use crate::seed::Seed;

fn data() -> Option<PathBuf> {
    let folder = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../shared/data"));
    if folder.is_dir() {
        return Some(folder.to_path_buf());
    }
    println!("skipped: no real scans at {}", folder.display());
    None
}

fn read_one(path: &Path) -> Result<Warned<Scan>> {
    read(&[path.to_path_buf()], &ReadOptions::default())
}

fn write_file(folder: &tempfile::TempDir, name: &str, bytes: &[u8]) -> PathBuf {
    let path = folder.path().join(name);
    std::fs::write(&path, bytes).unwrap();
    path
}

fn error_of(path: &Path) -> Error {
    match read_one(path) {
        Ok(_) => panic!("{} was read", path.display()),
        Err(error) => error,
    }
}

fn sound(scan: &Scan) {
    scan.cloud.check().unwrap();
    assert_eq!(scan.census.in_files, scan.census.kept + scan.census.removed.total());
    assert_eq!(scan.census.kept, scan.cloud.len() as u64);
    assert!(!scan.cloud.is_empty());
    assert!(scan.density_per_m2 > 0.0);
    let (min, max) = (scan.bounds.min, scan.bounds.max);
    assert!(scan.cloud.position.iter().all(|p| p.cmpge(min).all() && p.cmple(max).all()));
    // The origin is the floor of the least point to 10 world units.
    let unit_m = scan.cloud.frame.unit_m().as_vec3();
    assert!(min.cmpge(Vec3::splat(-1e-3)).all() && min.cmple(unit_m * 10.001).all(), "{min}");
    assert_eq!(scan.cloud.frame.origin % 10.0, DVec3::ZERO);
}

/// A cloud whose coordinates are whole millimetres, so that LAS holds them exactly.
fn sample(n: usize, crs: Option<Crs>, with_rgb: bool) -> PointCloud {
    let mut draws = Seed::new(5).draws();
    let mut cloud = PointCloud {
        frame: Frame { origin: DVec3::new(500_000.0, 6_200_000.0, 120.0), crs },
        position: Vec::new(),
        intensity: Vec::new(),
        return_number: Vec::new(),
        return_count: Vec::new(),
        class: Vec::new(),
        rgb: with_rgb.then(Vec::new),
    };
    for i in 0..n {
        let millimetres = |range: usize, draws: &mut crate::seed::Draws| {
            draws.index(range * 1000) as f32 / 1000.0
        };
        let p = Vec3::new(
            millimetres(40, &mut draws),
            millimetres(30, &mut draws),
            millimetres(20, &mut draws),
        );
        cloud.position.push(if i == 0 { Vec3::ZERO } else { p });
        cloud.intensity.push(draws.index(65_536) as u16);
        let count = 1 + draws.index(5) as u8;
        cloud.return_count.push(count);
        cloud.return_number.push(1 + draws.index(usize::from(count)) as u8);
        cloud.class.push([1, 2, 5][draws.index(3)]);
        if let Some(rgb) = &mut cloud.rgb {
            rgb.push([draws.index(65_536) as u16, draws.index(65_536) as u16, 9]);
        }
    }
    cloud
}

fn wkt_crs() -> Crs {
    Crs {
        epsg: Some(32646),
        wkt: Some(
            "PROJCS[\"WGS 84 / UTM zone 46N\",UNIT[\"metre\",1],AUTHORITY[\"EPSG\",\"32646\"]]"
                .into(),
        ),
        horizontal_unit_m: 1.0,
        vertical_unit_m: 1.0,
    }
}

#[test]
fn every_real_scan_is_read_with_its_system() {
    let Some(data) = data() else { return };
    let mut scans = vec![
        // Path, EPSG code, points where the source states them.
        ("lidR/MixedConifer.laz", Some(26912), 37_657),
        ("lidR/Megaplot.laz", Some(26917), 81_590),
        ("lidR/Topography.laz", Some(2949), 73_403),
        ("lasR/bcts_1.laz", Some(3005), 0),
        ("lasR/bcts_2.laz", Some(3005), 0),
        ("pycrown/POINTS_abs.laz", Some(2193), 523_738),
        ("spanner/ALS_Clip.laz", Some(6341), 29_915),
        ("treels/pine.laz", None, 0),
        ("adtree/tree1.xyz", None, 11_855),
    ];
    let mut plots: Vec<String> = std::fs::read_dir(data.join("idtrees/las"))
        .unwrap()
        .map(|entry| format!("idtrees/las/{}", entry.unwrap().file_name().to_string_lossy()))
        .collect();
    plots.sort();
    assert_eq!(plots.len(), 42);
    scans.extend(plots.iter().map(|plot| (plot.as_str(), Some(32617), 0)));
    for (name, epsg, points) in scans {
        let read = read_one(&data.join(name)).unwrap_or_else(|e| panic!("{name}: {e:?}"));
        let scan = &read.value;
        sound(scan);
        let crs = scan.cloud.frame.crs.as_ref();
        assert_eq!(scan.census.removed.isolated, 0, "{name} is a clean scan");
        assert_eq!(read.warnings.len(), usize::from(epsg.is_none()), "{name} {:?}", read.warnings);
        assert_eq!(crs.and_then(|c| c.epsg), epsg, "{name}");
        if points > 0 {
            assert_eq!(scan.census.in_files, points, "{name}");
        }
    }
}

#[test]
fn neighbouring_tiles_become_one_cloud() {
    let Some(data) = data() else { return };
    let paths = [data.join("lasR/bcts_1.laz"), data.join("lasR/bcts_2.laz")];
    let both = read(&paths, &ReadOptions::default()).unwrap().value;
    sound(&both);
    let apart = paths.map(|path| read_one(&path).unwrap().value);
    assert_eq!(both.cloud.len(), apart[0].cloud.len() + apart[1].cloud.len());
    let n = apart[0].cloud.len();
    for (whole, tile, i) in [(0, 0, 0), (n - 1, 0, n - 1), (n, 1, 0)] {
        let world = both.cloud.frame.world_from_local(both.cloud.position[whole]);
        let alone = apart[tile].cloud.frame.world_from_local(apart[tile].cloud.position[i]);
        assert!((world - alone).length() < 1e-3, "{world} {alone}");
        assert_eq!(both.cloud.intensity[whole], apart[tile].cloud.intensity[i]);
    }
}

#[test]
fn a_cloud_survives_the_round_trip() {
    let folder = tempfile::tempdir().unwrap();
    // More points than a LAZ chunk (50,000) and than one slab.
    for (n, crs, with_rgb) in [
        (120_001, Some(wkt_crs()), true),
        (70_000, Some(wkt_crs()), false),
        (70_000, Some(Crs::from_epsg(32646)), true),
        (70_000, Some(Crs::from_epsg(32646)), false),
        (3, None, false),
        (1, None, true),
    ] {
        let cloud = sample(n, crs, with_rgb);
        let bytes = encode_laz(&cloud).unwrap();
        assert_eq!(bytes, encode_laz(&cloud).unwrap(), "the same cloud gives the same bytes");
        let path = write_file(&folder, "cloud.laz", &bytes);
        let options = ReadOptions { drop_isolated: false, ..ReadOptions::default() };
        let read = read(&[path], &options).unwrap();
        sound(&read.value);
        let back = &read.value.cloud;
        assert_eq!(back.frame, cloud.frame);
        assert_eq!(back.len(), n);
        for (a, b) in back.position.iter().zip(&cloud.position) {
            assert!(a.distance(*b) < 1e-5, "{a} {b}");
        }
        assert_eq!(back.intensity, cloud.intensity);
        assert_eq!(back.return_number, cloud.return_number);
        assert_eq!(back.return_count, cloud.return_count);
        assert_eq!(back.class, cloud.class);
        assert_eq!(back.rgb, cloud.rgb);
        assert_eq!(read.warnings.len(), usize::from(cloud.frame.crs.is_none()));
    }
}

#[test]
fn reading_does_not_depend_on_threads() {
    let folder = tempfile::tempdir().unwrap();
    let path = write_file(&folder, "a.laz", &encode_laz(&sample(130_000, None, true)).unwrap());
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| read_one(&path).unwrap().value)
    };
    let (one, three) = (on(1), on(3));
    assert_eq!(one.cloud.position, three.cloud.position);
    assert_eq!(one.cloud.rgb, three.cloud.rgb);
    assert_eq!((one.census, one.density_per_m2), (three.census, three.density_per_m2));
}

#[test]
fn a_system_that_is_named_is_of_files_that_state_none() {
    let folder = tempfile::tempdir().unwrap();
    let text: String = (0..900).map(|i| format!("{} {} 10\n", i % 30, i / 30)).collect();
    let text = write_file(&folder, "a.xyz", text.as_bytes());
    let las: Vec<_> = (0..900).map(|i| ([i % 30 * 1000, i / 30 * 1000, 10_000], 9, 1)).collect();
    let las = write_file(&folder, "b.las", &las_bytes(&las));
    let metric = encode_laz(&sample(900, Some(wkt_crs()), false)).unwrap();
    let metric = write_file(&folder, "c.laz", &metric);
    let of = |path: &Path| Files {
        paths: vec![path.to_path_buf()],
        crs: Some(system("EPSG:2229+5703").unwrap()),
    };
    for path in [&text, &las] {
        let whole = read(of(path), &ReadOptions::default()).unwrap();
        let tiled = tiles::TiledScan::read(of(path), &ReadOptions::default()).unwrap();
        let bounds = whole.value.bounds;
        assert!((bounds.max.x - bounds.min.x - 29.0 * 0.3048).abs() < 0.01, "{bounds:?}");
        assert_eq!(whole.value.cloud.frame.crs.as_ref().and_then(|crs| crs.epsg), Some(2229));
        assert_eq!(tiled.value.frame, whole.value.cloud.frame);
        assert!(!whole.warnings.iter().any(|w| w.contains("coordinate system")));
    }
    let stated = read(of(&metric), &ReadOptions::default()).unwrap();
    assert_eq!(stated.value.cloud.frame.crs.unwrap().horizontal_unit_m, 1.0);
    let told = stated.warnings.iter().find_map(|w| w.split_once("c.laz: "));
    assert!(
        told.is_some_and(|(_, w)| w.ends_with("goes before the EPSG:2229 of --crs")),
        "{told:?}"
    );
}

#[test]
fn feet_become_metres() {
    let folder = tempfile::tempdir().unwrap();
    let mut crs = Crs::from_epsg(2229);
    crs.horizontal_unit_m = 1200.0 / 3937.0;
    crs.vertical_unit_m = 0.3048;
    let cloud = sample(500, Some(crs), false);
    let path = write_file(&folder, "feet.laz", &encode_laz(&cloud).unwrap());
    let back = read_one(&path).unwrap().value.cloud;
    assert_eq!(back.frame, cloud.frame);
    for (a, b) in back.position.iter().zip(&cloud.position) {
        assert!(a.distance(*b) < 5e-4, "{a} {b}");
    }
}

/// Uncompressed LAS 1.2 with point format 0 and these records: x, y, z, return bits, class bits.
fn las_bytes(records: &[([i32; 3], u8, u8)]) -> Vec<u8> {
    let header = las::raw::Header {
        number_of_point_records: records.len() as u32,
        x_scale_factor: 0.001,
        y_scale_factor: 0.001,
        z_scale_factor: 0.001,
        // Bounds that are plainly wrong: they must not matter.
        min_x: f64::NAN,
        max_x: -1e300,
        ..las::raw::Header::default()
    };
    let mut bytes = Vec::new();
    header.write_to(&mut bytes).unwrap();
    for (steps, returns, class) in records {
        bytes.extend(steps.iter().flat_map(|s| s.to_le_bytes()));
        bytes.extend([7, 0, *returns, *class, 0, 0, 0, 0]);
    }
    bytes
}

#[test]
fn noise_is_counted_by_its_reason() {
    let folder = tempfile::tempdir().unwrap();
    let mut records: Vec<([i32; 3], u8, u8)> =
        (0..900).map(|i| ([i % 30 * 1000, i / 30 * 1000, 0], 0b001_001, 2)).collect();
    records.push(([0, 0, 90_000], 0b001_001, 18));
    records.push(([0, 0, -90_000], 0b001_001, 7));
    records.push(([0, 0, 60_000], 0b001_001, 7));
    records.push(([5000, 5000, 0], 0b001_001, 128 | 2));
    records.push(([15_000, 15_000, 80_000], 0b001_001, 1));
    // Return 3 of 2, and return 0 of 0.
    records.push(([1500, 1500, 0], 0b010_011, 2));
    records.push(([2500, 1500, 0], 0, 2));
    let path = write_file(&folder, "noise.las", &las_bytes(&records));
    let read = read_one(&path).unwrap();
    sound(&read.value);
    let census = read.value.census;
    let removed = Removed { not_finite: 0, withheld: 1, low_noise: 2, high_noise: 1, isolated: 1 };
    assert_eq!(census, Census { files: 1, in_files: 907, kept: 902, removed });
    assert_eq!(read.warnings.len(), 3);
    assert!(read.warnings[0].ends_with("2 return numbers outside 1..=count were repaired"));
    assert!(read.warnings[1].contains("the bounds in its header are wrong"));
    let cloud = &read.value.cloud;
    assert_eq!((cloud.return_number[900], cloud.return_count[900]), (3, 3));
    assert_eq!((cloud.return_number[901], cloud.return_count[901]), (1, 1));
    assert_eq!(read.value.density_per_m2, 902.0 / 900.0);

    let all =
        ReadOptions { drop_noise_classes: false, drop_isolated: false, ..ReadOptions::default() };
    let kept = super::read(&[path], &all).unwrap().value.census;
    assert_eq!((kept.kept, kept.removed.withheld), (906, 1));
}

#[test]
fn points_past_a_count_that_is_too_low_are_read_where_they_are_points() {
    let folder = tempfile::tempdir().unwrap();
    let records: Vec<_> =
        (0..900).map(|i| ([i % 30 * 1000, i / 30 * 1000, 0], 0b001_001, 2)).collect();
    let header = |points: u32| las::raw::Header {
        number_of_point_records: points,
        x_scale_factor: 0.001,
        y_scale_factor: 0.001,
        z_scale_factor: 0.001,
        max_x: 29.0,
        max_y: 29.0,
        ..las::raw::Header::default()
    };
    let with = |points: u32| {
        let mut bytes = Vec::new();
        header(points).write_to(&mut bytes).unwrap();
        let whole = las_bytes(&records);
        let from = bytes.len();
        bytes.extend_from_slice(&whole[from..]);
        bytes
    };
    let read = read_one(&write_file(&folder, "low.las", &with(450))).unwrap();
    assert_eq!(read.value.census.in_files, 900);
    let told = "the header promises 450 points but 900 are there; all were read";
    assert!(read.warnings.iter().any(|w| w.ends_with(told)), "{:?}", read.warnings);
    // What is no point is not taken for one.
    let mut odd = with(900);
    odd.extend([0x7f; 20]);
    let read = read_one(&write_file(&folder, "odd.las", &odd)).unwrap();
    assert_eq!(read.value.census.in_files, 900);
    assert!(
        read.warnings.iter().any(|w| w.contains("bytes for 1 more points")),
        "{:?}",
        read.warnings
    );
}

#[test]
fn points_that_stand_alone_are_told_and_most_of_them_refused() {
    let folder = tempfile::tempdir().unwrap();
    // A field of points, and points far from it and from each other.
    let text = |alone: usize| {
        let field = (0..900).map(|i| format!("{} {} 0\n", i % 30, i / 30));
        let strays = (0..alone).map(|i| format!("{} {} 0\n", 1000 + 100 * i, 50 * i));
        field.chain(strays).collect::<String>()
    };
    let few = read_one(&write_file(&folder, "few.xyz", text(30).as_bytes())).unwrap();
    assert!(!few.warnings.iter().any(|w| w.contains("stand alone")), "{:?}", few.warnings);
    let some = read_one(&write_file(&folder, "some.xyz", text(100).as_bytes())).unwrap();
    let told = "100 of 1000 points (10 %) stand alone and are left out as noise";
    assert!(some.warnings.iter().any(|w| w.starts_with(told)), "{:?}", some.warnings);
    let error = error_of(&write_file(&folder, "most.xyz", text(1000).as_bytes()));
    assert_eq!(error.message(), "1000 of 1900 points stand alone, as in no scan");
}

#[test]
fn points_far_from_all_others_are_told_with_their_place() {
    let folder = tempfile::tempdir().unwrap();
    let told = |strays: &str| -> Vec<String> {
        let field: String = (0..900).map(|i| format!("{} {} 0\n", i % 30, i / 30)).collect();
        let path = [write_file(&folder, "a.xyz", format!("{field}{strays}").as_bytes())];
        let whole = read(&path, &ReadOptions::default()).unwrap();
        let tiled = TiledScan::read(&path, &ReadOptions::default()).unwrap();
        assert_eq!(whole.value.census, tiled.value.census);
        let far = |warnings: Vec<String>| -> Vec<String> {
            let of_file = warnings.iter().filter_map(|w| w.split_once("a.xyz: "));
            of_file.map(|(_, told)| told.to_owned()).collect()
        };
        let [whole, tiled] = [whole.warnings, tiled.warnings].map(far);
        assert_eq!(whole, tiled);
        whole
    };
    assert_eq!(told("10 10 60\n"), [""; 0]);
    insta::assert_snapshot!(told("10 10 4000\n").join("\n"), @"a point that stands far from all others, up to 4000 m away (x 10.00, y 10.00, z 4000.00), left out as noise: remove what is stray from the file; what is right, give with the points around it in a run of its own");
    insta::assert_snapshot!(told("10 10 -700\n-50000 10 0\n1e9 10 0\n").join("\n"), @"3 points that stand far from all others, up to 1000000 km away (x 1000000000.00, y 10.00, z 0.00), left out as noise: remove what is stray from the file; what is right, give with the points around it in a run of its own");
}

#[test]
fn a_point_beyond_reason_does_not_hide_other_noise() {
    let folder = tempfile::tempdir().unwrap();
    let mut text: String = (0..900).map(|i| format!("{} {} 0\n", i % 30, i / 30)).collect();
    text += "1e30 0 0\n10 10 500\n";
    let scan = read_one(&write_file(&folder, "far.xyz", text.as_bytes())).unwrap().value;
    sound(&scan);
    assert_eq!(scan.census.removed.isolated, 2);
}

#[test]
fn columns_that_a_header_does_not_name_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let of = |text: &str| error_of(&write_file(&folder, "a.txt", text.as_bytes()));
    insta::assert_snapshot!(of("foo,bar,baz,qux\n1,2,3,4\n").message(), @"no column is named x in its first line: foo bar baz qux");
    insta::assert_snapshot!(of("id,x,y\n1,2,3\n").message(), @"no column is named z in its first line: id x y");
    insta::assert_snapshot!(of("x,y,z,x\n1,2,3,4\n").message(), @"2 columns are named x in its first line: x y z x");
}

#[test]
fn points_that_two_files_share_are_told() {
    let folder = tempfile::tempdir().unwrap();
    let lines = |columns: std::ops::Range<u32>| -> String {
        let places = columns.flat_map(|x| (0..200).map(move |y| (x, y)));
        places.map(|(x, y)| format!("{}.5 {}.25 {}\n", x, y, (x * y) % 7)).collect()
    };
    let file = |name: &str, text: String| write_file(&folder, name, text.as_bytes());
    let a = file("a.xyz", lines(0..100));
    let beside = file("beside.xyz", lines(100..200));
    let over = file("over.xyz", lines(75..175));
    let told = |paths: &[PathBuf]| -> Vec<Vec<String>> {
        let whole = read(paths, &ReadOptions::default()).unwrap().warnings;
        let tiled = TiledScan::read(paths, &ReadOptions::default()).unwrap().warnings;
        let shared = |w: Vec<String>| w.into_iter().filter(|w| w.contains("also in")).collect();
        vec![shared(whole), shared(tiled)]
    };
    assert_eq!(told(&[a.clone(), beside]), [[""; 0]; 2]);
    for warnings in told(&[a.clone(), over]) {
        let [warning] = &warnings[..] else { panic!("{warnings:?}") };
        let percent = warning.split(": about ").nth(1).unwrap().split(' ').next().unwrap();
        assert!((20.0..30.0).contains(&percent.parse::<f64>().unwrap()), "{warning}");
        assert!(warning.contains("over.xyz: about") && warning.contains(&*a.to_string_lossy()));
    }
    let twice = file("twice.xyz", lines(0..50) + &lines(0..50));
    let warnings = read(&[twice], &ReadOptions::default()).unwrap().warnings;
    assert!(
        warnings.iter().any(|w| w.contains("about 50 % of the points come a second time")),
        "{warnings:?}"
    );
}

#[test]
fn text_is_read_in_its_dialects() {
    let folder = tempfile::tempdir().unwrap();
    for (name, text) in [
        ("a.xyz", "1 2 3\n4 5 6\n"),
        ("a.txt", "# x y z\n\n1,2,3,99,7\n4, 5, 6, 0, 1"),
        ("a.asc", "\u{feff}X Y Z Intensity\r\n1;2;3;0\r\n4\t5\t6\t0\r\n"),
        ("a.pts", "2\n 1.0 2.0 3.0 -1200 255 0 0\n4e0 5 6.0 1 2 3 4\n// end\n"),
        ("A.XYZ", "1 2 3\n4 5 6"),
        ("b.xyz", "id x y z i\n7 1 2 3 9\n8 4 5 6 9"),
        ("b.txt", "//Z,Y,X\n3,2,1\n6,5,4"),
        ("b.asc", "\"northing\" \"easting\" \"height\"\n2 1 3\n5 4 6"),
        ("c.csv", "POINT_Y,POINT_X,POINT_Z\n2,1,3\n5,4,6"),
        ("d.txt", "Y_COORD Z_COORD coordX\n2 3 1\n5 6 4"),
        ("e.txt", "y(m) z(m) x(m) height_m\n2 3 1 9\n5 6 4 9"),
        ("f.txt", "# columns: y x elevation_m\n2 1 3\n5 4 6"),
        // No names of columns.
        ("g.txt", "# z y x of the old grid\n1 2 3\n4 5 6"),
    ] {
        let scan = read_one(&write_file(&folder, name, text.as_bytes())).unwrap().value;
        sound(&scan);
        assert_eq!(scan.cloud.position, [Vec3::new(1.0, 2.0, 3.0), Vec3::new(4.0, 5.0, 6.0)]);
        assert_eq!(scan.cloud.frame, Frame::local(DVec3::ZERO));
        assert_eq!(scan.cloud.return_count, [1, 1]);
    }
    let text = "1 2 3\nnan 5 6\n4 inf 6\n7 8 9\n";
    let read = read_one(&write_file(&folder, "b.xyz", text.as_bytes())).unwrap();
    assert_eq!(read.value.census.removed.not_finite, 2);
    assert_eq!(read.value.cloud.len(), 2);
    assert!(read.warnings[0].ends_with("2 points that are not finite were dropped"));
}

#[test]
fn a_column_that_counts_the_points_is_no_x() {
    let folder = tempfile::tempdir().unwrap();
    let place = |i: usize| (i % 30, i / 30, i % 7);
    let points = |first: &dyn Fn(usize) -> String| -> String {
        let line = |i: usize| {
            let (x, y, z) = place(i);
            format!("{}{x}.5 {y}.25 {z}.5 12\n", first(i))
        };
        (0..900).map(line).collect()
    };
    let counted = |from: usize| points(&|i| format!("{} ", from + i));
    let read = |text: &str| read_one(&write_file(&folder, "a.xyz", text.as_bytes())).unwrap();
    let told = |read: &Warned<Scan>| {
        let told = read.warnings.iter().find_map(|w| w.split_once("a.xyz: "));
        told.map(|(_, told)| told.to_owned())
    };
    let plain = read(&points(&|_| String::new()));
    assert_eq!(told(&plain), None);
    for text in [counted(0), counted(1), counted(500_001), format!("# points\n{}", counted(1))] {
        let read = read(&text);
        assert_eq!(read.value.cloud.position, plain.value.cloud.position);
        insta::allow_duplicates!(
            insta::assert_snapshot!(told(&read).unwrap(), @"its first column counts the points: x, y and z were taken from the second to the fourth; if it is x, put a first line of names: x y z")
        );
    }
    // What is named, does not go on, or is one line of a raster, is x.
    let raster: String = (0..900).map(|i| format!("{i} 7 {} 0\n", i % 3)).collect();
    let broken = counted(1).replace("\n899 ", "\n898 ");
    for text in [format!("x y z i j\n{}", counted(1)), broken, raster] {
        let read = read(&text);
        assert!(read.value.bounds.max.x - read.value.bounds.min.x > 800.0);
        assert_eq!(told(&read), None);
    }
}

#[test]
fn long_text_is_read_in_order() {
    let folder = tempfile::tempdir().unwrap();
    let n = 900_000;
    let text: String =
        (0..n).map(|i| format!("{}.25 {} 0.5 some 12345\n", i % 1000, i / 1000)).collect();
    assert!(text.len() > 17 << 20, "longer than a block");
    let scan = read_one(&write_file(&folder, "long.xyz", text.as_bytes())).unwrap().value;
    assert_eq!(scan.cloud.len(), n);
    for i in [0, 1, 654_321, n - 1] {
        let expected = Vec3::new((i % 1000) as f32 + 0.25, (i / 1000) as f32, 0.5);
        assert_eq!(scan.cloud.position[i], expected);
    }
    let bad = text.replace("\n321.25 700 ", "\n321,x 700 ");
    let warnings = read_one(&write_file(&folder, "bad.xyz", bad.as_bytes())).unwrap().warnings;
    let said = "line 700322 is no point: \"321,x 700 0.5 some 12345\"; 1 such line was left out";
    assert!(warnings.iter().any(|w| w.ends_with(said)), "{warnings:?}");
}

#[test]
fn one_point_is_a_scan() {
    let folder = tempfile::tempdir().unwrap();
    let scan = read_one(&write_file(&folder, "one.xyz", b"512345.25 6212345.5 -7")).unwrap().value;
    sound(&scan);
    assert_eq!(scan.cloud.frame.origin, DVec3::new(512_340.0, 6_212_340.0, -10.0));
    assert_eq!(scan.cloud.position, [Vec3::new(5.25, 5.5, 3.0)]);
    assert_eq!(scan.density_per_m2, 1.0);
}

#[test]
fn versions_that_are_not_known_are_read_with_a_warning() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("new.las");
    for (version, warns) in [([1, 2], false), ([1, 5], true), ([2, 0], true)] {
        let mut las = las_bytes(&[([1, 2, 3], 9, 1); 50]);
        las[24..26].copy_from_slice(&version);
        std::fs::write(&path, las).unwrap();
        let read = read(std::slice::from_ref(&path), &ReadOptions::default()).unwrap();
        assert_eq!(read.value.cloud.len(), 50);
        let said = format!("LAS {}.{}: it was read as LAS 1.4", version[0], version[1]);
        assert_eq!(read.warnings.iter().any(|w| w.contains(&said)), warns, "{:?}", read.warnings);
    }
}

#[test]
fn what_is_wrong_here_and_there_is_left_out_with_a_warning() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str, bytes: &[u8]| {
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        path
    };
    let lines = |bad: usize| -> String {
        let line = |i: usize| match i < 3 * bad && i % 3 == 2 {
            true => "no point\n".to_owned(),
            false => format!("{} {} 5.0\n", i % 30, i / 30),
        };
        (0..900).map(line).collect()
    };
    let options = ReadOptions::default();
    let text = read(&[file("few.xyz", lines(4).as_bytes())], &options).unwrap();
    assert_eq!(text.value.cloud.len(), 896);
    let said = "line 3 is no point: \"no point\"; 4 such lines were left out";
    assert!(text.warnings.iter().any(|w| w.ends_with(said)), "{:?}", text.warnings);
    let error = read(&[file("many.xyz", lines(40).as_bytes())], &options).unwrap_err();
    assert_eq!(error.message(), "line 3 is no point: \"no point\"");

    let place = |i: i32| ([i % 60 * 50, i / 60 * 50, i % 7], 9, 1);
    let sound: Vec<_> = (0..3000).map(place).collect();
    let mut strays = sound.clone();
    strays.extend([([2_000_000_000, 2_000_000_000, 0], 9, 1); 3]);
    let mut split = sound.clone();
    split.extend((0..3000).map(place).map(|(p, a, b)| ([p[0] + 2_000_000_000, p[1], p[2]], a, b)));
    let [sound, strays, split] = [sound, strays, split].map(|points| las_bytes(&points));
    let mut none = las_bytes(&[]);
    none.truncate(227);
    let beside = [file("none.las", &none), file("sound.las", &sound)];
    let read_both_ways = |paths: &[PathBuf]| {
        let whole = read(paths, &options).map(|s| (s.value.cloud.len(), s.warnings));
        let tiled = TiledScan::read(paths, &options);
        let tiled = tiled.map(|s| (s.value.census.kept as usize, s.warnings));
        [whole, tiled]
    };
    for (points, warnings) in read_both_ways(&beside).map(|read| read.unwrap()) {
        assert_eq!(points, 3000);
        assert!(warnings.iter().any(|w| w.ends_with("none.las: holds no points")), "{warnings:?}");
    }
    for (points, _) in read_both_ways(&[file("strays.las", &strays)]).map(|read| read.unwrap()) {
        assert_eq!(points, 3000);
    }
    for read in read_both_ways(&[file("split.las", &split)]) {
        assert!(read.unwrap_err().message().starts_with("the points span"));
    }
}

#[test]
fn bad_files_give_one_clear_error() {
    let folder = tempfile::tempdir().unwrap();
    let laz = encode_laz(&sample(60_000, Some(wkt_crs()), true)).unwrap();
    let las = las_bytes(&[([1, 2, 3], 9, 1); 50]);
    let patched = |at: usize, bytes: &[u8]| {
        let mut las = las.clone();
        las[at..at + bytes.len()].copy_from_slice(bytes);
        las
    };
    let nan = f64::NAN.to_le_bytes();
    let mut no_points = patched(107, &[0; 4]);
    no_points.truncate(227);
    let utf_16 = |bytes: fn(u16) -> [u8; 2], text: &str| -> Vec<u8> {
        text.encode_utf16().flat_map(bytes).collect()
    };
    for (name, bytes, message) in [
        ("empty.laz", vec![], "is empty"),
        (
            "text.las",
            b"hello, this is not a scan".to_vec(),
            "is no LAS or LAZ file: it does not begin with LASF",
        ),
        ("head.las", las[..100].to_vec(), "the file ends early"),
        ("none.las", las[..227].to_vec(), "none of its 50 points can be read"),
        ("no_points.las", no_points, "holds no points"),
        (
            "offset.las",
            patched(96, &u32::MAX.to_le_bytes()),
            "its points should begin at byte 4294967295 of 1227",
        ),
        ("format.las", patched(104, &[11]), "point format 11 does not exist"),
        (
            "length.las",
            patched(105, &[19, 0]),
            "its points have 19 bytes where point format 0 needs 20",
        ),
        (
            "scale.las",
            patched(131, &nan),
            "its scale [NaN, 0.001, 0.001] or offset [0.0, 0.0, 0.0] gives no coordinates",
        ),
        (
            "zero.las",
            patched(139, &[0; 8]),
            "its scale [0.001, 0.0, 0.001] or offset [0.0, 0.0, 0.0] gives no coordinates",
        ),
        (
            "offset_far.las",
            patched(155, &1e300f64.to_le_bytes()),
            "its scale [0.001, 0.001, 0.001] or offset [1e300, 0.0, 0.0] gives no coordinates",
        ),
        (
            "offset_nan.las",
            patched(155, &nan),
            "its scale [0.001, 0.001, 0.001] or offset [NaN, 0.0, 0.0] gives no coordinates",
        ),
        (
            "one_chunk.laz",
            laz[..laz.len() / 3].to_vec(),
            "none of its 60000 points can be read: its LAZ chunk table is absent; its chunks were \
             looked for one by one",
        ),
        ("words.xyz", b"1 2 3\nfour five six\n".to_vec(), "line 2 is no point: \"four five six\""),
        ("two.xyz", b"1 2\n3 4\n".to_vec(), "line 1 is no point: \"1 2\""),
        ("none.xyz", b"# nothing\n\n".to_vec(), "holds no points"),
        ("nan.xyz", b"nan nan nan\n".to_vec(), "no point is left of 1: 1 not finite"),
        (
            "grid.asc",
            b"ncols 4\nnrows 4\n".to_vec(),
            "is a raster (ESRI ASCII grid), not a point cloud",
        ),
        ("tree.e57", b"ASTM-E57".to_vec(), "files of type \"e57\" are not read"),
        ("wide.xyz", b"0 0 0\n1e7 0 0\n".to_vec(), "the points span 10000 km"),
        ("widest.xyz", b"0 0 0\n1e300 0 0\n".to_vec(), "the points span 1e297 km"),
        (
            "commas.xyz",
            b"x y z\n470654,320 5523010,1 -12,0 7\n".to_vec(),
            "has decimal commas: \"470654,320 5523010,1 -12,0 7\"",
        ),
        ("utf_16.xyz", utf_16(u16::to_le_bytes, "\u{feff}1 2 3\n"), "is UTF-16 text"),
        ("utf_16_be.txt", utf_16(u16::to_be_bytes, "\u{feff}1 2 3\r\n"), "is UTF-16 text"),
        ("utf_16_bare.csv", utf_16(u16::to_le_bytes, "1,2,3\n"), "is UTF-16 text"),
    ] {
        let error = error_of(&write_file(&folder, name, &bytes));
        assert_eq!(error.message(), message, "{name}");
        assert!(error.to_string().contains(name), "{name}: {error}");
        assert!(error.remedy_text().is_some(), "{name}");
    }
    let missing = error_of(&folder.path().join("missing.laz"));
    assert!(render(&missing).contains("missing.laz: there is no such file"), "{missing:?}");
    assert_eq!(error_of(folder.path()).message(), "is a folder, not a scan");
    assert_eq!(
        read(Files::default(), &ReadOptions::default()).unwrap_err().message(),
        "no scan is given"
    );
    let twice = vec![write_file(&folder, "good.las", &las); 2];
    assert_eq!(read(&twice, &ReadOptions::default()).unwrap_err().message(), "is given twice");
    let many: Vec<_> = (0..300).map(|i| ([i * 100, 0, 0], 0b001_001, 1)).collect();
    let alike = ["a.las", "b.las"].map(|name| write_file(&folder, name, &las_bytes(&many)));
    let error = read(&alike, &ReadOptions::default()).unwrap_err();
    assert!(error.message().starts_with("holds the same bytes as "), "{error}");
}

#[test]
fn degrees_are_refused_with_a_zone() {
    let folder = tempfile::tempdir().unwrap();
    let text: String = (0..99).map(|i| format!("92.{i:02} 56.0001 {i}\n")).collect();
    let near = text.replace("92.", "92.00");
    let error = error_of(&write_file(&folder, "degrees.xyz", near.as_bytes()));
    assert_eq!(error.message(), "its coordinates are degrees, not lengths");
    assert!(error.remedy_text().unwrap().contains("EPSG:32646"), "{error:?}");

    let mut cloud = sample(10, Some(wkt_crs()), false);
    cloud.frame.origin = DVec3::new(-80.0, -40.0, 0.0);
    cloud.frame.crs.as_mut().unwrap().wkt =
        Some("GEOGCS[\"WGS 84\",UNIT[\"degree\",0.0174],AUTHORITY[\"EPSG\",\"4326\"]]".into());
    let error = error_of(&write_file(&folder, "degrees.laz", &encode_laz(&cloud).unwrap()));
    assert!(error.remedy_text().unwrap().contains("UTM zone"), "{error:?}");

    // Though metres are stated.
    let mut cloud = sample(10, Some(wkt_crs()), false);
    cloud.frame.origin = DVec3::new(-105.0, 40.0, 0.0);
    for (k, p) in cloud.position.iter_mut().enumerate() {
        *p = glam::Vec3::new(1e-3 * k as f32, 2e-3 * k as f32, 30.0 * k as f32);
    }
    let error = error_of(&write_file(&folder, "stated.laz", &encode_laz(&cloud).unwrap()));
    assert_eq!(error.message(), "its coordinates are degrees, not lengths");
}

#[test]
fn different_systems_do_not_mix() {
    let folder = tempfile::tempdir().unwrap();
    let of = |name: &str, crs: Option<Crs>| {
        write_file(&folder, name, &encode_laz(&sample(9, crs, false)).unwrap())
    };
    let a = of("a.laz", Some(Crs::from_epsg(32646)));
    let same = of("same.laz", Some(wkt_crs()));
    let b = of("b.laz", Some(Crs::from_epsg(32647)));
    let none = of("none.laz", None);
    assert!(read(&[a.clone(), same], &ReadOptions::default()).is_ok());
    let error = read(&[a.clone(), b], &ReadOptions::default()).unwrap_err();
    let text = error.to_string();
    assert!(
        text.contains("b.laz: is in EPSG:32647, but ") && text.contains("a.laz is in EPSG:32646")
    );
    let error = read(&[a, none], &ReadOptions::default()).unwrap_err();
    assert!(error.message().starts_with("is in no stated coordinate system, but "), "{error}");
}

/// Every cut and many flipped bytes end in an error or a sound scan, never in a panic or in
/// memory that the file does not justify.
#[test]
fn damaged_scans_never_panic() {
    let folder = tempfile::tempdir().unwrap();
    let mut files = vec![
        ("new", encode_laz(&sample(3_000, Some(wkt_crs()), true)).unwrap()),
        ("old", encode_laz(&sample(3_000, Some(Crs::from_epsg(32646)), true)).unwrap()),
        ("plain", las_bytes(&[([1, 2, 3], 9, 1); 500])),
    ];
    if let Some(data) = data() {
        for name in ["lidR/MixedConifer.laz", "spanner/ALS_Clip.laz"] {
            files.push((name, std::fs::read(data.join(name)).unwrap()));
        }
    }
    let (mut errors, mut scans) = (0, 0);
    for (name, bytes) in files {
        let mut draws = Seed::new(11).derive(name, 0).draws();
        let mut try_bytes = |bytes: &[u8]| {
            let path = write_file(&folder, "damaged.laz", bytes);
            match read_one(&path) {
                Ok(read) => {
                    sound_enough(&read.value);
                    scans += 1;
                }
                Err(error) => {
                    assert!(error.remedy_text().is_some(), "{error:?}");
                    errors += 1;
                }
            }
        };
        // Real scans take a hundred times as long to be read.
        let (cuts, flips) = if bytes.len() > 100_000 { (12, 40) } else { (40, 160) };
        for i in 0..cuts {
            try_bytes(&bytes[..bytes.len() * i / cuts]);
        }
        for i in 0..flips {
            let mut flipped = bytes.clone();
            // The headers and the tail, where sizes are, more often than the rest.
            let at = match i % 4 {
                0 => draws.index(400.min(bytes.len())),
                1 => draws.index(2_000.min(bytes.len())),
                2 => bytes.len() - 1 - draws.index(60.min(bytes.len())),
                _ => draws.index(bytes.len()),
            };
            flipped[at] = draws.bits() as u8;
            if i % 3 == 0 {
                let end = (at + 4).min(bytes.len());
                flipped[at..end].fill(0xff);
            }
            try_bytes(&flipped);
        }
    }
    let tried = errors + scans;
    assert!(5 * errors > tried && 10 * scans > tried, "{errors} errors, {scans} scans");
}

fn sound_enough(scan: &Scan) {
    scan.cloud.check().unwrap();
    assert_eq!(scan.census.in_files, scan.census.kept + scan.census.removed.total());
}

#[test]
fn older_and_streamed_packings_are_read() {
    let folder = tempfile::tempdir().unwrap();
    let cloud = sample(2_000, Some(Crs::from_epsg(32646)), true);
    let bytes = encode_laz(&cloud).unwrap();
    let data = u32::from_le_bytes(bytes[96..100].try_into().unwrap()) as usize;
    let table = bytes[data..data + 8].to_vec();

    // A streaming writer leaves -1 at the front and puts the table's place at the end.
    let mut streamed = bytes.clone();
    streamed[data..data + 8].copy_from_slice(&(-1i64).to_le_bytes());
    streamed.extend(&table);

    // Before chunks there was neither a table nor a place for it.
    let name = bytes.windows(14).position(|w| w == b"laszip encoded").unwrap();
    let mut pointwise = bytes.clone();
    pointwise[name + 52] = 1;
    let end = i64::from_le_bytes(table.try_into().unwrap()) as usize;
    pointwise.truncate(end);
    pointwise.drain(data..data + 8);

    for (name, bytes) in [("streamed.laz", streamed), ("pointwise.laz", pointwise)] {
        let back = read_one(&write_file(&folder, name, &bytes)).unwrap().value.cloud;
        assert_eq!(back.intensity, cloud.intensity, "{name}");
        assert_eq!(back.rgb, cloud.rgb, "{name}");
    }
}
