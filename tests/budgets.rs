//! More triangles make no worse tree: at any budget, and from level to level.

use assert_cmd::Command;
use larix::mesh::{self, MeshOptions};
use larix::seed::Seed;
use larix::skeleton::{Detail, Target, grow};
use larix::{species, texture};
use serde_json::Value;

/// Cards stand for more leaves, and are larger, the fewer there are; from 12,000 triangles on some give way to
/// stalks, which hold others to the wood.
#[test]
fn more_triangles_enlarge_leaves_by_little() {
    for name in ["quercus_robur", "betula_pendula", "tilia_cordata"] {
        let species = species::load(name).unwrap();
        let detail = Detail { max_nodes: 3_333, attractor_spacing_m: None };
        let target = Target::FromSpecies { height_m: None };
        let skeleton = grow(&species, target, detail, Seed::new(1)).unwrap();
        let atlas = texture::for_species(&species, 64, Seed::new(1)).atlas;
        let mut least = f32::INFINITY;
        for budget in [5_000, 8_000, 11_990, 12_010, 14_000, 17_000, 19_990, 20_000, 40_000] {
            let options = MeshOptions { triangle_budget: Some(budget), ..MeshOptions::HERO };
            let tree = mesh::build(&skeleton, &species, &atlas, &options, Seed::new(1)).unwrap();
            let scale = tree.twig_scale;
            assert!(scale < 1.2 * least, "{name}, {budget}: {scale} after {least}");
            least = least.min(scale);
        }
    }
}

#[test]
fn each_coarser_level_is_farther_off() {
    let folder = tempfile::tempdir().unwrap();
    for (name, triangles) in [("quercus_robur", "31000"), ("picea_abies", "60000")] {
        let out = folder.path().join(name).with_extension("glb");
        let args = ["tree", name, "--triangles", triangles, "--lods", "3", "--texture", "64"];
        let args = args.into_iter().chain(["--json", "--quiet", "-o"]).chain(out.to_str());
        let run = Command::cargo_bin("larix").unwrap().args(args).output().unwrap();
        assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
        let report: Value = serde_json::from_slice(&run.stdout).unwrap();
        let levels = report["levels"].as_array().unwrap().iter();
        let rms_m: Vec<f64> =
            levels.map(|level| level["silhouette_rms_m"].as_f64().unwrap()).collect();
        assert_eq!(rms_m.len(), 4);
        assert!(rms_m.is_sorted_by(|a, b| a < b), "{name}: {rms_m:?}");
    }
}

/// Cards that stand for many twigs stand in the middle of them.
#[test]
fn the_outline_of_a_coarse_crown_is_near() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("lime.glb");
    let args =
        ["tree", "tilia_cordata", "--lods", "3", "--texture", "64", "--json", "--quiet", "-o"];
    let args = args.into_iter().chain(out.to_str());
    let run = Command::cargo_bin("larix").unwrap().args(args).output().unwrap();
    assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
    let report: Value = serde_json::from_slice(&run.stdout).unwrap();
    let last = report["levels"].as_array().unwrap().last().unwrap();
    assert!(last["triangles"].as_u64().unwrap() <= 500);
    let rms_m = last["silhouette_rms_m"].as_f64().unwrap();
    assert!(rms_m < 0.07, "{rms_m}");
}
