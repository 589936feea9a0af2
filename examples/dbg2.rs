use larix::pipeline; use larix::report::{Recorder, Silent}; use larix::seed::Seed; use larix::species::{self, Species};
fn main() {
    let mixes: [(&str, &[&str]); 7] = [
        ("demo", &["larix_sibirica","betula_pendula","pinus_sylvestris","picea_obovata","salix_caprea"]),
        ("spruce", &["picea_obovata"]), ("pine", &["pinus_sylvestris"]), ("larch", &["larix_sibirica"]), ("birch", &["betula_pendula"]),
        ("broad", &["quercus_robur","tilia_cordata","populus_tremula"]), ("cembra", &["pinus_sibirica","abies_sibirica","picea_abies"])];
    for (name, mix) in mixes { for seed in [11u64, 12] {
        let species: Vec<Species> = mix.iter().map(|n| species::load(n).unwrap()).collect();
        let made = pipeline::demo::survey_of_stand(200, &species, Seed::new(seed), &mut Recorder::new(&Silent)).unwrap();
        std::fs::write(format!("/tmp/reg/simscan/{name}_{seed}.laz"), &made.scan).unwrap();
        let mut t = String::new();
        let o = made.stand.frame.origin;
        for q in &made.stand.trees { let r = q.crown_diameter_m as f64/2.0; t += &format!("{},{},{},{},{}\n", o.x+q.x-r, o.y+q.y-r, o.x+q.x+r, o.y+q.y+r, q.species); }
        std::fs::write(format!("/tmp/reg/simscan/{name}_{seed}.truth"), t).unwrap();
    }}
}
