use larix::ground::Method;
use larix::pipeline::{self, SurveyJob};
use larix::report::{Recorder, Silent};
use larix::seed::Seed;
use larix::species::{self, Species};
fn main() {
    let mix: Vec<String> = std::env::args().skip(1).collect();
    let species: Vec<Species> = mix.iter().map(|n| species::load(n).unwrap()).collect();
    let seed = Seed::new(1);
    let mut run = Recorder::new(&Silent);
    let made = pipeline::demo::survey_of_stand(60, &species, seed, &mut run).unwrap();
    let scan = std::path::PathBuf::from("/tmp/dbg.laz");
    std::fs::write(&scan, &made.scan).unwrap();
    let job = SurveyJob { scans: vec![scan], ground: Method::Smrf, cell_m: None, photo: None, species, species_are_requested: true, voxel_m: None, min_height_m: 2.0, seed };
    let survey = pipeline::survey::inventory(&job, &mut run).unwrap();
    let s = &made.stand;
    for t in &s.trees {
        println!("true {:6.1} {:6.1} h {:5.1} d {:4.1} base {:4.1} sp {}", t.x, t.y, t.height_m, t.crown_diameter_m, t.crown_base_height_m, t.species);
        for f in &survey.trees {
            let p = s.frame.local_from_world(survey.frame.world_from_local(f.crown.root));
            let d = (t.x - p.x as f64).hypot(t.y - p.y as f64);
            if d < 0.5 * t.crown_diameter_m as f64 + 0.3 {
                println!("      off {:4.1} h {:5.1} d {:4.1} base {:4.1} n {} conf {:.2}", d, f.crown.height_m, f.crown.diameter_m, f.crown.base_height_m, f.crown.point_count, f.crown.confidence);
            }
        }
    }
}
