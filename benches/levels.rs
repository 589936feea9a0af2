//! Triangles against silhouette error and time, of every species: `cargo bench --bench levels`
//! prints the table; with `UPDATE_DOCS=1` it writes docs/levels-by-species.md and its plot.

use std::fmt::Write;
use std::path::Path;
use std::time::Instant;

use larix::cache::Cache;
use larix::lod::{Silhouettes, Views};
use larix::mesh::{MeshOptions, TreeMesh};
use larix::pipeline::cover::{self, Subject};
use larix::pipeline::detail::{coarser, mesh_options};
use larix::pipeline::model::model_scene;
use larix::render::capture::Sitter;
use larix::seed::Seed;
use larix::skeleton::{self, Detail, Target};
use larix::species;
use larix::texture;
use plotters::prelude::*;

/// The tree that others are measured against; the tree whose cover coarser ones keep, and these.
const REFERENCE: usize = 300_000;
const FINE: [usize; 3] = [80_000, 40_000, 20_000];
const COARSE: [usize; 6] = [8_000, 3_000, 1_000, 500, 250, 125];
const REPEATS: usize = 3;

struct Point {
    triangles: usize,
    cover: f32,
    worst_m: f32,
    rms_m: f32,
    ms: f64,
}

fn measure(name: &str) -> Vec<Point> {
    let species = species::load(name).expect("built in");
    let seed = Seed::new(1);
    let detail = Detail { max_nodes: (REFERENCE / 6) as u32, attractor_spacing_m: None };
    let target = Target::FromSpecies { height_m: None };
    let skeleton = skeleton::grow(&species, target, detail, seed).expect("grows");
    let textures = texture::for_species(&species, 512, seed);
    let subject = Subject { skeleton: &skeleton, species: &species, textures: &textures, seed };
    let built = |options: &MeshOptions| subject.mesh(options).expect("meshes");
    let kept = mesh_options(FINE[FINE.len() - 1]);
    let mut forms: Vec<MeshOptions> = FINE.into_iter().map(mesh_options).collect();
    forms.extend(COARSE.map(|n| coarser(&kept, n)));
    let mut meshes: Vec<TreeMesh> = forms.iter().map(built).collect();
    let (_, levels) = meshes.split_at_mut(FINE.len() - 1);
    cover::keep(&subject, &forms[FINE.len()..], levels, &Cache::off()).expect("meshes");
    let covers = cover::shares(&subject, &meshes[FINE.len() - 1], meshes.clone()).expect("finite");
    let mut points = Vec::new();
    for ((options, mesh), cover) in forms.iter().zip(&meshes).zip(covers) {
        let mut times = Vec::new();
        for _ in 0..REPEATS {
            let start = Instant::now();
            std::hint::black_box(built(options));
            times.push(start.elapsed().as_secs_f64() * 1e3);
        }
        times.sort_by(f64::total_cmp);
        points.push(Point {
            triangles: mesh.triangles(),
            cover,
            worst_m: 0.0,
            rms_m: 0.0,
            ms: times[REPEATS / 2],
        });
    }
    meshes.insert(0, built(&mesh_options(REFERENCE)));
    let bounds = meshes
        .iter()
        .map(|m| m.bounds())
        .fold(meshes[0].bounds(), |a, b| (a.0.min(b.0), a.1.max(b.1)));
    let scene = model_scene(&species, meshes, textures.clone());
    let models: Vec<_> = scene.prototypes.iter().map(|p| &p.parts[..]).collect();
    let sitter = Sitter::covers(&models, &scene.materials, &scene.textures);
    let of = |model: u32| Silhouettes::of(&sitter, model, bounds, Views::All).expect("finite");
    let finest = of(0);
    for (k, point) in (1u32..).zip(&mut points) {
        let apart = finest.apart(&of(k));
        (point.worst_m, point.rms_m) = (apart.worst_m, apart.rms_m);
    }
    points
}

fn main() {
    let names: Vec<String> = species::builtin_names()
        .into_iter()
        .filter(|n| !n.starts_with("table3/"))
        .map(str::to_owned)
        .collect();
    let mut page = String::from(
        "# Triangles against error and time\n\n\
         One tree a species (seed 1), meshed at nine budgets from the skeleton of 300,000 triangles, and how\n\
         far its silhouette is from that of 300,000: RMS and worst, in metres; what it covers over what the\n\
         tree of 20,000 does, which coarser ones are made to keep as levels are; and milliseconds to mesh it\n\
         once on one machine, medians of three. `cargo bench --bench levels` makes this page.\n\n\
         ![Silhouette error over triangles: green RMS, brown worst](levels-by-species.svg)\n",
    );
    let mut all = Vec::new();
    for name in &names {
        let points = measure(name);
        let _ = write!(
            page,
            "\n## {name}\n\n| triangles | cover | RMS m | worst m | ms |\n|---:|---:|---:|---:|---:|\n"
        );
        for p in &points {
            let _ = writeln!(
                page,
                "| {} | {:.2} | {:.3} | {:.2} | {:.1} |",
                p.triangles, p.cover, p.rms_m, p.worst_m, p.ms
            );
        }
        eprintln!("{name}: done");
        all.push(points);
    }
    println!("{page}");
    if std::env::var_os("UPDATE_DOCS").is_some() {
        let docs = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs");
        std::fs::write(docs.join("levels-by-species.md"), page).expect("docs can be written");
        plot(&docs.join("levels-by-species.svg"), &names, &all).expect("the plot can be drawn");
    }
}

fn plot(
    path: &Path,
    names: &[String],
    all: &[Vec<Point>],
) -> Result<(), Box<dyn std::error::Error>> {
    const COLUMNS: usize = 4;
    let rows = names.len().div_ceil(COLUMNS);
    let root = SVGBackend::new(path, (1120, 260 * rows as u32)).into_drawing_area();
    root.fill(&WHITE)?;
    for ((area, name), points) in root.split_evenly((rows, COLUMNS)).iter().zip(names).zip(all) {
        let mut chart = ChartBuilder::on(area)
            .caption(name, ("sans-serif", 15))
            .margin(8)
            .x_label_area_size(28)
            .y_label_area_size(44)
            .build_cartesian_2d((100f32..100_000f32).log_scale(), (0.005f32..3f32).log_scale())?;
        chart.configure_mesh().x_desc("triangles").y_desc("m").draw()?;
        for (colour, value) in [
            (RGBColor(38, 97, 60), (|p: &Point| p.rms_m) as fn(&Point) -> f32),
            (RGBColor(170, 120, 60), |p: &Point| p.worst_m),
        ] {
            let line: Vec<(f32, f32)> =
                points.iter().map(|p| (p.triangles as f32, value(p).max(0.005))).collect();
            chart.draw_series(LineSeries::new(line.clone(), colour.stroke_width(2)))?;
            chart.draw_series(line.into_iter().map(|at| Circle::new(at, 3, colour.filled())))?;
        }
    }
    root.present()?;
    Ok(())
}
