//! Trees found in simulated stands of several mixes beside the truth, with one set of defaults.

use std::path::Path;

use larix::ground::Method;
use larix::pipeline::{self, Survey, SurveyJob};
use larix::report::{Recorder, Silent};
use larix::seed::Seed;
use larix::simulate::{Comparison, Stand, StandOptions};
use larix::species::assign::SpeciesBy;
use larix::species::{self, Species};

/// A stand, and what is found in it.
fn survey(mix: &[&str], options: &StandOptions, seed: u64, dir: &Path) -> (Stand, Survey) {
    let species: Vec<Species> = mix.iter().map(|n| species::load(n).unwrap()).collect();
    let seed = Seed::new(seed);
    let mut run = Recorder::new(&Silent);
    let made = pipeline::demo::survey_of_stand(options, &species, seed, &mut run).unwrap();
    let scan = dir.join("scan.laz");
    std::fs::write(&scan, &made.scan).unwrap();
    let job = SurveyJob {
        scans: vec![scan],
        ground: Method::Smrf,
        cell_m: None,
        tile_m: None,
        photo: None,
        species,
        species_by: SpeciesBy::Auto,
        voxel_m: None,
        min_height_m: 2.0,
        effort: pipeline::Effort::Normal,
        seed,
    };
    let survey = pipeline::survey::inventory(&job, &mut run).unwrap();
    (made.stand, survey)
}

fn found_in(mix: &[&str], options: &StandOptions, seed: u64, dir: &Path) -> Comparison {
    let (stand, survey) = survey(mix, options, seed, dir);
    pipeline::demo::compare(&stand, &survey)
}

#[test]
fn stands_of_every_mix_are_found() {
    let dir = tempfile::tempdir().unwrap();
    let demo =
        ["larix_sibirica", "betula_pendula", "pinus_sylvestris", "picea_obovata", "salix_caprea"];
    let options = StandOptions { trees: 160, ..StandOptions::default() };
    // The least F1, and the greatest RMSE of height, over two stands of each mix.
    let mixes: [(&str, &[&str], f64, f64); 6] = [
        ("demo", &demo, 0.89, 1.0),
        ("spruce", &["picea_obovata"], 0.98, 1.8),
        ("pine", &["pinus_sylvestris"], 0.82, 1.0),
        ("larch", &["larix_sibirica"], 0.98, 1.0),
        ("birch", &["betula_pendula"], 0.98, 0.6),
        ("aspen", &["betula_pendula", "populus_tremula", "tilia_cordata"], 0.75, 1.0),
    ];
    for (name, mix, least_f1, most_height_m) in mixes {
        let made = [1, 2].map(|seed| found_in(mix, &options, seed, dir.path()));
        for c in &made {
            println!(
                "{name:8} found {:3}, matched {:3} of {:3}, F1 {:.3}; position {:.2}, height {:.2} \
                 ({:+.2}), diameter {:.2} ({:+.2}) m",
                c.found,
                c.matched,
                c.trees,
                c.f1,
                c.position_rmse_m,
                c.height.rmse_m,
                c.height.bias_m,
                c.crown_diameter.rmse_m,
                c.crown_diameter.bias_m
            );
        }
        let mean = |f: fn(&Comparison) -> f64| 0.5 * (f(&made[0]) + f(&made[1]));
        assert!(mean(|c| c.f1) >= least_f1, "{name}");
        assert!(mean(|c| c.height.rmse_m) <= most_height_m, "{name}");
        assert!(mean(|c| c.crown_diameter.rmse_m) <= 1.5, "{name}");
        assert!(mean(|c| c.terrain.rmse_m) <= 0.03, "{name}");
    }
}

#[test]
fn trees_under_taller_crowns_are_found_and_marked() {
    let dir = tempfile::tempdir().unwrap();
    let options = StandOptions { trees: 80, understory: 40, ..StandOptions::default() };
    let (stand, survey) = survey(&["pinus_sylvestris"], &options, 3, dir.path());
    let is_low = |t: &larix::simulate::TrueTree| t.crown_base_height_m == 0.2 * t.height_m;
    let lower: Vec<_> = survey.trees.iter().filter(|t| t.crown.is_understory).collect();
    let mut found = 0;
    for t in stand.trees.iter().filter(|t| is_low(t)) {
        let hit = lower.iter().find(|f| {
            let p = stand.frame.local_from_world(survey.frame.world_from_local(f.crown.root));
            (t.x - f64::from(p.x)).hypot(t.y - f64::from(p.y)) < 1.5
                && (t.height_m - f.crown.height_m).abs() < 2.0
        });
        found += usize::from(hit.is_some());
    }
    println!("{found} of 40 lower trees found; {} marked", lower.len());
    assert!(found >= 6, "{found}");
    assert!(lower.len() <= found + 10, "{} marked, {found} found", lower.len());
}
