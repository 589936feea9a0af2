//! Species on simulated stands, whose truth is known: with the photo, and by shape alone.

use larix::ground::Method;
use larix::pipeline::{Effort, SurveyJob, demo, survey};
use larix::report::{Recorder, Silent};
use larix::seed::Seed;
use larix::simulate::{Comparison, StandOptions};
use larix::species::assign::SpeciesBy;
use larix::species::model::Kind;
use larix::species::{self, Species};

fn stand(names: &[&str], seed: u64, with_photo: bool, by: SpeciesBy) -> Comparison {
    let species: Vec<Species> = names.iter().map(|n| species::load(n).unwrap()).collect();
    let (seed, mut run) = (Seed::new(seed), Recorder::new(&Silent));
    let options = StandOptions { trees: 150, ..StandOptions::default() };
    let made = demo::survey_of_stand(&options, &species, seed, &mut run).unwrap();
    let dir = tempfile::tempdir().unwrap();
    let (scan, photo) = (dir.path().join("scan.laz"), dir.path().join("photo.tif"));
    std::fs::write(&scan, made.scan).unwrap();
    std::fs::write(&photo, made.photo).unwrap();
    let job = SurveyJob {
        scans: [scan].into(),
        ground: Method::Smrf,
        cell_m: None,
        tile_m: None,
        photo: with_photo.then_some(photo),
        species,
        species_by: by,
        voxel_m: None,
        min_height_m: 2.0,
        effort: Effort::Normal,
        seed,
    };
    demo::compare(&made.stand, &survey::inventory(&job, &mut run).unwrap(), None)
}

/// Share of the matched trees whose kind, conifer or not, is right.
fn kind_accuracy(names: &[&str], c: &Comparison) -> f64 {
    let is_conifer =
        |k: usize| names.get(k).map(|n| species::load(n).unwrap().kind == Kind::Conifer);
    let cells = c.confusion.iter().enumerate();
    let all = cells.flat_map(|(t, row)| row.iter().enumerate().map(move |(f, n)| (t, f, *n)));
    let right = all.filter(|(t, f, _)| is_conifer(*t) == is_conifer(*f)).map(|(_, _, n)| n);
    right.sum::<usize>() as f64 / c.matched.max(1) as f64
}

const MIX: [&str; 5] =
    ["larix_sibirica", "betula_pendula", "pinus_sylvestris", "picea_obovata", "salix_caprea"];

#[test]
fn the_photo_of_a_mixed_stand_tells_its_species() {
    for seed in [1, 2] {
        let c = stand(&MIX, seed, true, SpeciesBy::Auto);
        println!(
            "seed {seed}: species right of {:.3}, kind of {:.3}",
            c.species_accuracy,
            kind_accuracy(&MIX, &c)
        );
        assert!(c.species_accuracy >= 0.85, "{:.3}", c.species_accuracy);
    }
}

#[test]
fn shape_alone_on_stands_of_known_species() {
    let stands: [(&str, &[&str]); 4] = [
        ("mixed", &MIX),
        ("pine and oak", &["pinus_sylvestris", "quercus_robur"]),
        ("spruce and birch", &["picea_abies", "betula_pendula"]),
        ("larch, fir and lime", &["larix_decidua", "abies_sibirica", "tilia_cordata"]),
    ];
    for (title, names) in stands {
        let c = stand(names, 3, false, SpeciesBy::Auto);
        println!(
            "{title}: species right of {:.3}, kind of {:.3}; {:?}",
            c.species_accuracy,
            kind_accuracy(names, &c),
            c.confusion
        );
        assert!(kind_accuracy(names, &c) >= 0.75, "{title}");
    }
}
