//! Writing, flushed to the disk, in GB/s and beside what the disk takes raw: a tree of 3 million
//! triangles, its textures coded before. Each format takes turns with a raw file of as many bytes;
//! the least of the runs counts.
//!
//! `cargo bench --bench export -- [--in FOLDER] [--runs N] [formats…]`; a folder of the system's
//! where none is named.

use std::fs::{self, File};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::Instant;

use larix::export::{self, Format, Job, Pictures, Profile};
use larix::mesh::{self, MeshOptions};
use larix::pipeline::detail::mesh_options;
use larix::pipeline::model::model_scene;
use larix::scene::{Instance, TreeFacts, ValidScene};
use larix::seed::Seed;
use larix::skeleton::{self, Detail, Target};
use larix::species;
use larix::texture;

#[global_allocator]
static ALLOCATOR: larix::heap::Counted = larix::heap::Counted;

const TRIANGLES: usize = 3_000_000;
const FORMATS: [(&str, Format, Profile); 9] = [
    ("GLB", Format::Glb, Profile::Dcc),
    ("GLB engine", Format::Glb, Profile::Engine),
    ("GLB web", Format::Glb, Profile::Web),
    ("usdc", Format::Usdc, Profile::Dcc),
    ("usdz", Format::Usdz, Profile::Dcc),
    ("usda", Format::Usda, Profile::Dcc),
    ("X3D", Format::X3d, Profile::Dcc),
    ("X3D compact", Format::X3d, Profile::Web),
    ("OBJ", Format::Obj, Profile::Dcc),
];

fn tree() -> ValidScene {
    let species = species::load("larix_sibirica").expect("built in");
    let seed = Seed::new(1);
    let detail = Detail { max_nodes: (TRIANGLES / 6) as u32, attractor_spacing_m: None };
    let target = Target::FromSpecies { height_m: None };
    let skeleton = skeleton::grow(&species, target, detail, seed).expect("grows");
    let textures = texture::for_species(&species, 512, seed);
    let options = MeshOptions { triangle_budget: Some(TRIANGLES), ..mesh_options(TRIANGLES) };
    let mesh = mesh::build(&skeleton, &species, &textures.atlas, &options, seed).expect("meshes");
    let mut scene = model_scene(&species, vec![mesh], textures);
    scene.instances.push(Instance {
        name: "tree".into(),
        prototype: 0,
        position: glam::Vec3::ZERO,
        yaw_rad: 0.0,
        scale: glam::Vec3::ONE,
        facts: TreeFacts {
            id: "1".into(),
            species: species.name.clone(),
            height_m: skeleton.height_m(),
            crown_diameter_m: skeleton.width_m(),
            crown_base_height_m: skeleton.crown_base_m(),
            stem_diameter_m: 0.3,
            condition: "I",
            confidence: 1.0,
        },
    });
    scene.prune();
    scene.validate().expect("sound")
}

/// Seconds to write so many bytes as they are.
fn raw(path: &Path, bytes: u64) -> f64 {
    const PIECE: usize = 1 << 20;
    let piece: Vec<u8> = (0..PIECE).map(|k| (k * k / 7) as u8).collect();
    let start = Instant::now();
    let mut file = File::create(path).expect("room");
    let mut left = bytes as usize;
    while left > 0 {
        let now = left.min(PIECE);
        file.write_all(&piece[..now]).expect("room");
        left -= now;
    }
    file.sync_all().expect("flushed");
    start.elapsed().as_secs_f64()
}

fn bytes_in(folder: &Path) -> u64 {
    let entries = fs::read_dir(folder).expect("own folder").map(|e| e.expect("own file").path());
    entries
        .map(|p| if p.is_dir() { bytes_in(&p) } else { fs::metadata(p).expect("own file").len() })
        .sum()
}

fn main() {
    let mut words: Vec<String> = std::env::args().skip(1).filter(|a| a != "--bench").collect();
    let mut option = |name: &str| {
        let at = words.iter().position(|w| w == name)?;
        words.drain(at..words.len().min(at + 2)).nth(1)
    };
    let folder = option("--in").map_or_else(std::env::temp_dir, PathBuf::from);
    let runs: usize = option("--runs").map_or(5, |n| n.parse().expect("a number of runs"));
    let scene = tree();
    let triangles = larix::scene::statistics(&scene).unique_triangles;
    println!("{triangles} triangles\n");
    println!("| | MB | s | GB/s | raw GB/s | share |\n|---|---:|---:|---:|---:|---:|");
    for (name, format, profile) in FORMATS {
        if !(words.is_empty() || words.iter().any(|w| w == name)) {
            continue;
        }
        let held = tempfile::tempdir_in(&folder).expect("a folder to write to");
        let formats = [format];
        let job = Job { profile, ..Job::new("tree", &formats) };
        let pictures = Pictures::encode(&scene, &job.picture_formats()).expect("sound pictures");
        let (mut least, mut least_raw, mut bytes) = (f64::MAX, f64::MAX, 0);
        for _ in 0..runs {
            let out = held.path().join("files");
            let start = Instant::now();
            let files = export::files(&scene, &pictures, &job).expect("fits").value;
            export::write_all(&out, files).expect("room");
            least = least.min(start.elapsed().as_secs_f64());
            bytes = bytes_in(&out);
            fs::remove_dir_all(&out).expect("own folder");
            least_raw = least_raw.min(raw(&held.path().join("raw"), bytes));
            fs::remove_file(held.path().join("raw")).expect("own file");
        }
        let gigabytes = bytes as f64 * 1e-9;
        println!(
            "| {name} | {:.1} | {least:.2} | {:.2} | {:.2} | {:.0} % |",
            gigabytes * 1e3,
            gigabytes / least,
            gigabytes / least_raw,
            100.0 * least_raw / least
        );
    }
}
