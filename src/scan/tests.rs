//! Real scans, round trips and broken files.

use std::path::{Path, PathBuf};

use glam::{DVec3, Vec3};

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
        ("lidR/MixedConifer.laz", Some(26912), 37_657),
        ("lidR/Megaplot.laz", Some(26917), 81_590),
        ("lidR/Topography.laz", Some(2949), 73_403),
        ("lasR/bcts_1.laz", Some(3005), 0),
        ("lasR/bcts_2.laz", Some(3005), 0),
        ("pycrown/POINTS_abs.laz", Some(2193), 523_738),
        ("spanner/ALS_Clip.laz", Some(0), 0),
        ("treels/pine.laz", None, 0),
        ("adtree/tree1.xyz", None, 11_854),
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
        println!(
            "{name}: {:?} {:.2}/m2 epsg {:?} {:?} rgb {} {:?}",
            scan.census,
            scan.density_per_m2,
            crs.and_then(|c| c.epsg),
            (scan.bounds.max - scan.bounds.min),
            scan.cloud.rgb.is_some(),
            read.warnings
        );
        if epsg != Some(0) {
            assert_eq!(crs.and_then(|c| c.epsg), epsg, "{name}");
        }
        if points > 0 {
            assert_eq!(scan.census.in_files, points, "{name}");
        }
    }
}
