//! Meshing of one tree, its wood alone or with its leaves, with normals and texture coordinates, on one thread: triangles a
//! second, in the quickest of the runs of one second.
//!
//! `cargo bench --bench mesh`, or with a part of a name: `cargo bench --bench mesh -- oak`

use std::time::{Duration, Instant};

use larix::mesh::{self, FoliageLevel, Junctions, MeshOptions, WindProfile};
use larix::seed::Seed;
use larix::skeleton::{Detail, Skeleton, Target, grow};
use larix::species::{self, Species};
use larix::texture::{self, Atlas};

#[global_allocator]
static ALLOCATOR: larix::heap::Counted = larix::heap::Counted;

const SPECIES: [(&str, &str); 4] = [
    ("oak", "quercus_robur"),
    ("larch", "larix_sibirica"),
    ("birch", "betula_pendula"),
    ("spruce", "picea_obovata"),
];

fn grown(name: &str, max_nodes: u32) -> (Species, Skeleton) {
    let species = species::load(name).expect("built in");
    let detail = Detail { max_nodes, attractor_spacing_m: None };
    let target = Target::FromSpecies { height_m: None };
    let skeleton = grow(&species, target, detail, Seed::new(1)).expect("a tree");
    (species, skeleton)
}

fn main() {
    rayon::ThreadPoolBuilder::new().num_threads(1).build_global().expect("the first pool");
    let only: Vec<String> = std::env::args().skip(1).filter(|a| !a.starts_with('-')).collect();
    let free =
        MeshOptions { triangle_budget: None, foliage: FoliageLevel::None, ..MeshOptions::HERO };
    let kinds = [
        ("without a budget", 100_000, free),
        ("intersecting", 100_000, MeshOptions { junctions: Junctions::Intersecting, ..free }),
        // Twigs of eight sides, as meshers have that do not go by the thickness.
        ("round twigs", 100_000, MeshOptions { tolerance_m: 1e-4, ..free }),
        ("hero", 3_333, MeshOptions { triangle_budget: Some(20_000), ..free }),
        ("20 000 of a large tree", 100_000, MeshOptions { triangle_budget: Some(20_000), ..free }),
        ("with cards", 100_000, MeshOptions { foliage: FoliageLevel::Cards, ..free }),
        (
            "leaf by leaf",
            20_000,
            MeshOptions {
                triangle_budget: Some(5_000_000),
                foliage: FoliageLevel::Geometry,
                ..free
            },
        ),
    ];
    println!("{:46} {:>9} {:>9} {:>7}", "", "triangles", "ms", "M/s");
    for (tree, name) in SPECIES {
        let title = |kind: &str| format!("{tree}, {kind}");
        let is_asked = |kind: &str| only.iter().all(|o| title(kind).contains(o.as_str()));
        let asked: Vec<_> = kinds.iter().filter(|k| is_asked(k.0)).collect();
        if asked.is_empty() {
            continue;
        }
        let atlas =
            texture::for_species(&species::load(name).expect("built in"), 512, Seed::new(1)).atlas;
        for &(kind, max_nodes, options) in asked {
            let title = title(kind);
            let (species, skeleton) = grown(name, max_nodes);
            for wind in [None, Some(WindProfile::Unity)] {
                measure(&title, &species, &atlas, &skeleton, &MeshOptions { wind, ..options });
            }
        }
    }
}

fn measure(
    title: &str,
    species: &Species,
    atlas: &Atlas,
    skeleton: &Skeleton,
    options: &MeshOptions,
) {
    let build = || mesh::build(skeleton, species, atlas, options, Seed::new(1)).expect("wood");
    let triangles = build().triangles();
    let mut least = Duration::MAX;
    let start = Instant::now();
    while start.elapsed() < Duration::from_secs(1) {
        let start = Instant::now();
        let tree = build();
        least = least.min(start.elapsed());
        drop(tree);
    }
    let title = format!("{title}{}", if options.wind.is_some() { ", wind" } else { "" });
    let seconds = least.as_secs_f64();
    let rate = triangles as f64 / seconds / 1e6;
    println!("{title:46} {triangles:9} {:9.2} {rate:7.1}", seconds * 1e3);
}
