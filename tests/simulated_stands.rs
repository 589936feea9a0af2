//! Trees found in simulated stands of several mixes beside the truth, with one set of defaults.

use std::path::Path;

use glam::{DVec3, Vec3};
use larix::crown::Crown;
use larix::ground::Method;
use larix::pipeline::{self, Survey, SurveyJob};
use larix::report::{Recorder, Silent};
use larix::scan::{self, ReadOptions};
use larix::seed::Seed;
use larix::simulate::{Comparison, Stand, StandOptions, TrueTree};
use larix::species::assign::SpeciesBy;
use larix::species::{self, Species};

const DEMO: [&str; 5] =
    ["larix_sibirica", "betula_pendula", "pinus_sylvestris", "picea_obovata", "salix_caprea"];

/// A stand, and what is found in it.
fn survey(mix: &[&str], options: &StandOptions, seed: u64, dir: &Path) -> (Stand, Survey) {
    let species: Vec<Species> = mix.iter().map(|n| species::load(n).unwrap()).collect();
    let seed = Seed::new(seed);
    let mut run = Recorder::new(&Silent);
    let made = pipeline::demo::survey_of_stand(options, &species, seed, &mut run).unwrap();
    let scan = dir.join("scan.laz");
    std::fs::write(&scan, &made.scan).unwrap();
    let job = SurveyJob {
        scans: [scan].into(),
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
    pipeline::demo::compare(&stand, &survey, None)
}

#[test]
fn stands_of_every_mix_are_found() {
    let dir = tempfile::tempdir().unwrap();
    let options = StandOptions { trees: 160, ..StandOptions::default() };
    // The least F1, and the greatest RMSE of height, over two stands of each mix.
    let mixes: [(&str, &[&str], f64, f64); 6] = [
        ("demo", &DEMO, 0.89, 1.0),
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

/// A tree of the lower storey, as the simulator plants it.
fn is_low(t: &TrueTree) -> bool {
    t.crown_base_height_m == 0.2 * t.height_m
}

#[test]
fn trees_under_taller_crowns_are_found_and_marked() {
    let dir = tempfile::tempdir().unwrap();
    let options = StandOptions { trees: 80, understory: 40, ..StandOptions::default() };
    let mixes: [(&str, &[&str], f64); 3] = [
        ("pine", &["pinus_sylvestris"], 0.9),
        ("demo", &DEMO, 0.6),
        ("aspen", &["betula_pendula", "populus_tremula", "tilia_cordata"], 0.6),
    ];
    for (name, mix, least_found) in mixes {
        // Lower trees, those that at least 80 returns show, and how many of these were found; trees
        // marked, and how many of these are such trees.
        let (mut lower, mut shown, mut found, mut marked, mut right) = (0, 0, 0, 0, 0);
        for seed in 1..5 {
            let (stand, survey) = survey(mix, &options, seed, dir.path());
            let local =
                |p: Vec3| stand.frame.local_from_world(survey.frame.world_from_local(p)).as_dvec3();
            let is_same = |t: &TrueTree, f: &Crown| {
                let p = local(f.root);
                (t.x - p.x).hypot(t.y - p.y) < 1.5 && (t.height_m - f.height_m).abs() < 2.0
            };
            let crowns: Vec<&Crown> = survey.trees.iter().map(|t| &t.crown).collect();
            let under: Vec<&&Crown> = crowns.iter().filter(|c| c.is_understory).collect();
            marked += under.len();
            let is_of_stand = |f: &Crown| stand.trees.iter().any(|t| is_low(t) && is_same(t, f));
            right += under.iter().filter(|f| is_of_stand(f)).count();

            let read = ReadOptions { drop_isolated: false, ..ReadOptions::default() };
            let scan = scan::read(&[dir.path().join("scan.laz")], &read).unwrap().value.cloud;
            let place = |p: &Vec3| stand.frame.local_from_world(scan.frame.world_from_local(*p));
            let returns: Vec<DVec3> = scan.position.iter().map(|p| place(p).as_dvec3()).collect();
            for t in stand.trees.iter().filter(|t| is_low(t)) {
                let [base, top] =
                    [t.crown_base_height_m + 0.5, t.height_m].map(|h| t.z + f64::from(h));
                let reach_m = 0.4 * f64::from(t.crown_diameter_m);
                let is_in = |p: &&DVec3| {
                    (base..top).contains(&p.z) && (p.x - t.x).hypot(p.y - t.y) < reach_m
                };
                let is_shown = returns.iter().filter(is_in).count() >= 80;
                lower += 1;
                shown += usize::from(is_shown);
                found += usize::from(is_shown && crowns.iter().any(|f| is_same(t, f)));
            }
        }
        println!(
            "{name:6} {lower} lower trees, {shown} with 80 returns and more: {found} found; \
             {marked} marked, {right} right"
        );
        assert!(found as f64 >= least_found * shown as f64, "{name}: {found} of {shown}");
        assert!(right as f64 >= 0.85 * marked as f64, "{name}: {right} of {marked}");
    }
}
