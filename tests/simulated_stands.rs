//! Trees found in simulated stands of several mixes beside the truth, with one set of defaults.

use std::path::Path;

use larix::ground::Method;
use larix::pipeline::{self, SurveyJob};
use larix::report::{Recorder, Silent};
use larix::seed::Seed;
use larix::simulate::Comparison;
use larix::species::{self, Species};

fn found_in(mix: &[&str], trees: usize, seed: u64, dir: &Path) -> Comparison {
    let species: Vec<Species> = mix.iter().map(|n| species::load(n).unwrap()).collect();
    let seed = Seed::new(seed);
    let mut run = Recorder::new(&Silent);
    let made = pipeline::demo::survey_of_stand(trees, &species, seed, &mut run).unwrap();
    let scan = dir.join("scan.laz");
    std::fs::write(&scan, &made.scan).unwrap();
    let job = SurveyJob {
        scans: vec![scan],
        ground: Method::Smrf,
        cell_m: None,
        photo: None,
        species,
        species_are_requested: true,
        voxel_m: None,
        min_height_m: 2.0,
        seed,
    };
    let survey = pipeline::survey::inventory(&job, &mut run).unwrap();
    pipeline::demo::compare(&made.stand, &survey)
}

#[test]
fn stands_of_every_mix_are_found() {
    let dir = tempfile::tempdir().unwrap();
    let mixes: [(&str, &[&str]); 6] = [
        ("demo", &["larix_sibirica", "betula_pendula", "pinus_sylvestris", "picea_obovata", "salix_caprea"]),
        ("spruce", &["picea_obovata"]),
        ("pine", &["pinus_sylvestris"]),
        ("larch", &["larix_sibirica"]),
        ("birch", &["betula_pendula"]),
        ("broadleaf", &["quercus_robur", "tilia_cordata", "populus_tremula"]),
    ];
    for (name, mix) in mixes {
        for seed in [1, 2] {
            let c = found_in(mix, 160, seed, dir.path());
            println!(
                "{name:10} {seed}: found {:3} matched {:3} of {:3}, F1 {:.3}; position {:.2}, height {:.2} ({:+.2}), \
                 diameter {:.2} ({:+.2}) m",
                c.found, c.matched, c.trees, c.f1, c.position_rmse_m, c.height.rmse_m, c.height.bias_m,
                c.crown_diameter.rmse_m, c.crown_diameter.bias_m
            );
        }
    }
}
