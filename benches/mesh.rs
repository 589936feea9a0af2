//! Meshing of one tree's wood, with normals and texture coordinates, on one thread; triangles a
//! second.
//!
//! `cargo bench --bench mesh`

use divan::Bencher;
use divan::counter::ItemsCount;
use larix::mesh::{self, FoliageLevel, Junctions, MeshOptions};
use larix::seed::Seed;
use larix::skeleton::{Detail, Skeleton, Target, grow};
use larix::species::{self, Species};
use larix::texture::Atlas;

fn main() {
    divan::main();
}

const SPECIES: [&str; 4] = ["larix_sibirica", "picea_obovata", "betula_pendula", "quercus_robur"];

fn grown(name: &str, max_nodes: u32) -> (Species, Skeleton) {
    let species = species::load(name).expect("built in");
    let detail = Detail { max_nodes, attractor_spacing_m: None };
    let target = Target::FromSpecies { height_m: None };
    let skeleton = grow(&species, target, detail, Seed::new(1)).expect("a tree");
    (species, skeleton)
}

fn measure(bencher: Bencher, name: &str, max_nodes: u32, options: MeshOptions) {
    let (species, skeleton) = grown(name, max_nodes);
    let options = MeshOptions { foliage: FoliageLevel::None, ..options };
    let atlas = Atlas::whole(0.4);
    let build = || mesh::build(&skeleton, &species, &atlas, &options, Seed::new(1)).expect("wood");
    bencher.counter(ItemsCount::new(build().triangles())).bench(build);
}

/// 20 000 triangles, what a tree seen from near has.
#[divan::bench(args = SPECIES, sample_count = 30)]
fn hero(bencher: Bencher, name: &str) {
    measure(bencher, name, 3_333, MeshOptions::HERO);
}

#[divan::bench(args = SPECIES, sample_count = 10)]
fn without_a_budget(bencher: Bencher, name: &str) {
    measure(bencher, name, 100_000, MeshOptions { triangle_budget: None, ..MeshOptions::HERO });
}

/// The cheap form: tubes pass through each other.
#[divan::bench(args = SPECIES, sample_count = 10)]
fn intersecting(bencher: Bencher, name: &str) {
    let junctions = Junctions::Intersecting;
    let options = MeshOptions { triangle_budget: None, junctions, ..MeshOptions::HERO };
    measure(bencher, name, 100_000, options);
}
