//! Species, height and stem diameter on real scans, beside what was measured in the field: the
//! pipeline as users run it, on the annotated plots with and without the photo. Prints the tables of
//! docs/inventory.md and writes them when `UPDATE_DOCS` is set.
//!
//! With `FEATURES_CSV` set, what `tools/fit_kind.py` fits to is written there: the features of every
//! annotated crown.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use glam::{DVec2, DVec3, Vec2};
use larix::crown::Crown;
use larix::ground::{self, Method};
use larix::pipeline::survey::{self, READ, Survey};
use larix::pipeline::{Effort, SurveyJob};
use larix::raster::geotiff;
use larix::raster::polygon::contains;
use larix::report::{Recorder, Silent};
use larix::scan::read;
use larix::seed::Seed;
use larix::species::assign::SpeciesBy;
use larix::species::photo::Photo;
use larix::species::{self, look};
use larix::terrain::{self, TerrainOptions};

/// The default mix of the command line.
const MIX: [&str; 5] =
    ["larix_sibirica", "betula_pendula", "pinus_sylvestris", "picea_obovata", "salix_caprea"];
/// The genera of the USDA codes on the plots.
const GENERA: [(&str, &str); 14] = [
    ("AC", "Acer"),
    ("AM", "Amelanchier"),
    ("BE", "Betula"),
    ("CA", "Carya"),
    ("LITU", "Liriodendron"),
    ("MAGNO", "Magnolia"),
    ("NYSY", "Nyssa"),
    ("OXYDE", "Oxydendrum"),
    ("PI", "Pinus"),
    ("PRSE", "Prunus"),
    ("QU", "Quercus"),
    ("ROPS", "Robinia"),
    ("TSCA", "Tsuga"),
    ("", ""),
];
const CONIFERS: [&str; 5] = ["Abies", "Larix", "Picea", "Pinus", "Tsuga"];
const SITES: [&str; 2] = ["MLBS", "OSBS"];

fn data(name: &str) -> Option<PathBuf> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data").join(name);
    if !path.exists() {
        println!("skipped: {} is not here", path.display());
        return None;
    }
    Some(path)
}

/// A crown as annotated, with what was measured in the field where it was.
struct Annotated {
    /// World units: west, south, east, north.
    bounds: [f64; 4],
    /// USDA code; empty where nobody named it.
    taxon: String,
    genus: &'static str,
    stem_diameter_m: Option<f64>,
    height_m: Option<f64>,
}

impl Annotated {
    fn is_conifer(&self) -> bool {
        CONIFERS.contains(&self.genus)
    }
}

fn annotated() -> Option<BTreeMap<String, Vec<Annotated>>> {
    let mut plots: BTreeMap<String, Vec<Annotated>> = BTreeMap::new();
    for row in csv::Reader::from_path(data("idtrees/boxes.csv")?).unwrap().records() {
        let row = row.unwrap();
        let genus = GENERA.iter().find(|(code, _)| row[6].starts_with(code)).unwrap().1;
        assert!(row[6].is_empty() || !genus.is_empty(), "no genus for {}", &row[6]);
        plots.entry(row[0].to_owned()).or_default().push(Annotated {
            bounds: std::array::from_fn(|k| row[2 + k].parse().unwrap()),
            taxon: row[6].to_owned(),
            genus,
            stem_diameter_m: row[7].parse::<f64>().ok().map(|cm| 0.01 * cm),
            height_m: row[8].parse().ok(),
        });
    }
    Some(plots)
}

fn job(plot: &str, names: &[&str], by: SpeciesBy, with_photo: bool) -> SurveyJob {
    let file = |kind: &str, end: &str| data(&format!("idtrees/{kind}/{plot}.{end}")).unwrap();
    SurveyJob {
        scans: [file("las", "las")].into(),
        ground: Method::Smrf,
        cell_m: None,
        tile_m: None,
        photo: with_photo.then(|| file("rgb", "tif")),
        species: names.iter().map(|n| species::load(n).unwrap()).collect(),
        species_by: by,
        voxel_m: None,
        min_height_m: 2.0,
        effort: Effort::Normal,
        seed: Seed::new(1),
    }
}

fn bounds(crown: &Crown, origin: DVec3) -> [f64; 4] {
    let corner = |p: &Vec2| p.as_dvec2() + origin.truncate();
    let low = crown.outline.iter().map(corner).fold(DVec2::INFINITY, DVec2::min);
    let high = crown.outline.iter().map(corner).fold(DVec2::NEG_INFINITY, DVec2::max);
    [low.x, low.y, high.x, high.y]
}

fn overlap(a: &[f64; 4], b: &[f64; 4]) -> f64 {
    let area = |q: &[f64; 4]| (q[2] - q[0]) * (q[3] - q[1]);
    let w = (a[2].min(b[2]) - a[0].max(b[0])).max(0.0);
    let h = (a[3].min(b[3]) - a[1].max(b[1])).max(0.0);
    w * h / (area(a) + area(b) - w * h)
}

/// Annotated crowns and the trees found for them: pairs that overlap to 0.4 of their union, best
/// first, one to one.
fn matches<'a>(
    truth: &[Annotated],
    survey: &Survey,
    crowns: impl Iterator<Item = &'a Crown>,
) -> Vec<(usize, usize)> {
    let origin = survey.frame.origin;
    let found: Vec<[f64; 4]> = crowns.map(|c| bounds(c, origin)).collect();
    let mut pairs = Vec::new();
    for (i, t) in truth.iter().enumerate() {
        for (j, f) in found.iter().enumerate() {
            pairs.push((overlap(&t.bounds, f), i, j));
        }
    }
    pairs.retain(|p| p.0 >= 0.4);
    pairs.sort_by(|a, b| b.0.total_cmp(&a.0));
    let (mut used_t, mut used_f) = (vec![false; truth.len()], vec![false; found.len()]);
    let mut out = Vec::new();
    for (_, i, j) in pairs {
        if !used_t[i] && !used_f[j] {
            (used_t[i], used_f[j]) = (true, true);
            out.push((i, j));
        }
    }
    out
}

/// A tree of which the field and the inventory say what it is.
struct Named {
    site: usize,
    field: &'static str,
    found: String,
}

impl Named {
    fn are_conifers(&self) -> [bool; 2] {
        [self.field, &self.found].map(|genus| CONIFERS.contains(&genus))
    }

    fn has_kind(&self) -> bool {
        let [field, found] = self.are_conifers();
        field == found
    }

    fn has_genus(&self) -> bool {
        self.field == self.found
    }
}

/// Share of the trees of a site, or of all.
fn share(trees: &[Named], site: Option<usize>, is_right: impl Fn(&Named) -> bool) -> f64 {
    let here: Vec<&Named> = trees.iter().filter(|t| site.is_none_or(|s| s == t.site)).collect();
    here.iter().filter(|t| is_right(t)).count() as f64 / here.len().max(1) as f64
}

/// The trees, each taken for the commonest genus at its site of the commoner kind there.
fn commonest(trees: &[Named]) -> Vec<Named> {
    let usual = |site: usize| {
        let here: Vec<&Named> = trees.iter().filter(|t| t.site == site).collect();
        let conifers = here.iter().filter(|t| t.are_conifers()[0]).count();
        let of_kind = here.iter().filter(|t| t.are_conifers()[0] == (2 * conifers > here.len()));
        let mut count: BTreeMap<&str, usize> = BTreeMap::new();
        of_kind.for_each(|t| *count.entry(t.field).or_default() += 1);
        count.into_iter().max_by_key(|(_, n)| *n).map_or("", |(genus, _)| genus)
    };
    let found = SITES.iter().enumerate().map(|(site, _)| usual(site)).collect::<Vec<_>>();
    let taken = |t: &Named| Named { found: found[t.site].to_owned(), ..*t };
    trees.iter().map(taken).collect()
}

/// A table with `head` over the first column, as Markdown.
fn table(head: &[String], rows: &[Vec<String>]) -> String {
    let line = |cells: &[String]| format!("| {} |\n", cells.join(" | "));
    let mut out = line(head) + "|---" + &"|--:".repeat(head.len() - 1) + "|\n";
    rows.iter().for_each(|row| out += &line(row));
    out
}

fn accuracy(title: &str, trees: &[Named]) -> Vec<String> {
    let mut row = vec![title.to_owned()];
    for site in [None, Some(0), Some(1)] {
        row.push(format!("{:.3}", share(trees, site, Named::has_kind)));
    }
    row.push(format!("{:.3}", share(trees, None, Named::has_genus)));
    row
}

/// Confusion matrices: conifer or broadleaf, then genus. Rows are the field's.
fn matrices(title: &str, trees: &[Named]) -> String {
    let count = |is: &dyn Fn(&Named) -> bool| trees.iter().filter(|t| is(t)).count().to_string();
    let kinds = [("conifer", true), ("broadleaf", false)];
    let mut rows = Vec::new();
    for site in [Some(0), Some(1), None] {
        for (kind, of) in kinds {
            let here = |t: &Named| site.is_none_or(|s| s == t.site) && t.are_conifers()[0] == of;
            let mut row = vec![format!("{kind}, {}", site.map_or("both", |s| SITES[s]))];
            for (_, found) in kinds {
                row.push(count(&|t| here(t) && t.are_conifers()[1] == found));
            }
            rows.push(row);
        }
    }
    let head = ["field ↓ decided →", "conifer", "broadleaf"].map(str::to_owned);
    let out = format!("{title}:\n\n{}\n", table(&head, &rows));

    let genera = |of: &dyn Fn(&Named) -> String| {
        let all: BTreeSet<_> = trees.iter().map(of).collect();
        let (mut all, broadleaves): (Vec<_>, Vec<_>) =
            all.into_iter().partition(|g| CONIFERS.contains(&g.as_str()));
        all.extend(broadleaves);
        all
    };
    let found = genera(&|t| t.found.clone());
    let mut rows = Vec::new();
    for genus in genera(&|t| t.field.to_owned()) {
        let mut row = vec![genus.clone()];
        row.extend(found.iter().map(|f| count(&|t| t.field == genus && t.found == *f)));
        rows.push(row);
    }
    out + &table(&[&head[..1], &found].concat(), &rows)
}

#[derive(Default)]
struct Errors(Vec<f64>);

impl Errors {
    fn rmse(&self) -> f64 {
        (self.0.iter().map(|e| e * e).sum::<f64>() / self.0.len().max(1) as f64).sqrt()
    }

    fn bias(&self) -> f64 {
        self.0.iter().sum::<f64>() / self.0.len().max(1) as f64
    }
}

/// What one way of deciding the species gives.
#[derive(Default)]
struct Outcome {
    named: Vec<Named>,
    /// Of height, m, and stem diameter, m, by site.
    errors: [[Errors; 2]; 2],
    /// Crowns annotated, found and matched, by site: of all trees, and of those not hidden from above.
    crowns: [[[usize; 3]; 2]; 2],
}

fn run(
    plots: &BTreeMap<String, Vec<Annotated>>,
    names: &[&str],
    by: SpeciesBy,
    with_photo: bool,
) -> Outcome {
    let mut out = Outcome::default();
    for (plot, truth) in plots {
        let mut recorder = Recorder::new(&Silent);
        let survey = survey::inventory(&job(plot, names, by, with_photo), &mut recorder).unwrap();
        let site = usize::from(plot.starts_with("OSBS"));
        let every = matches(truth, &survey, survey.trees.iter().map(|t| &t.crown));
        let canopy: Vec<_> = survey.trees.iter().filter(|t| !t.crown.is_understory).collect();
        let pairs = matches(truth, &survey, canopy.iter().map(|t| &t.crown));
        let counts = [(survey.trees.len(), every.len()), (canopy.len(), pairs.len())];
        for (sums, (found, matched)) in out.crowns.iter_mut().zip(counts) {
            let counts = [truth.len(), found, matched];
            sums[site].iter_mut().zip(counts).for_each(|(sum, n)| *sum += n);
        }
        for (i, j) in pairs {
            let (t, tree) = (&truth[i], canopy[j]);
            if !t.taxon.is_empty() {
                let found = tree.species.split(' ').next().unwrap().to_owned();
                out.named.push(Named { site, field: t.genus, found });
            }
            let of = |found: f32, truth: Option<f64>| truth.map(|t| f64::from(found) - t);
            out.errors[site][0].0.extend(of(tree.crown.height_m, t.height_m));
            out.errors[site][1].0.extend(of(tree.stem_diameter_m, t.stem_diameter_m));
        }
    }
    out
}

/// Returns a square metre that scans are thinned to.
const THINNED: [f64; 4] = [12.0, 4.0, 2.0, 1.0];
/// Confidences from each to the next are counted together.
const STEPS: [f32; 7] = [0.0, 0.3, 0.4, 0.5, 0.6, 0.7, 1.01];

/// A scan with so many returns a square metre, each kept or not by its number.
fn thinned(path: &Path, per_sq_m: f64) -> Vec<u8> {
    let scan = read(&[path.to_owned()], &READ).unwrap().value;
    let share = per_sq_m / f64::from(scan.density_per_m2);
    let mut cloud = scan.cloud;
    cloud.retain(|i| f64::from(Seed::new(1).derive("thin", i as u64).draws().unit()) < share);
    larix::scan::encode_laz(&cloud).unwrap()
}

/// Of the canopy's trees at every density: F1, and how many are right by confidence.
fn confidences(plots: &BTreeMap<String, Vec<Annotated>>) -> Vec<Vec<String>> {
    let dir = tempfile::tempdir().unwrap();
    let densities: Vec<Option<f64>> = [None].into_iter().chain(THINNED.map(Some)).collect();
    densities
        .iter()
        .map(|&density| {
            let mut counts = [[0; 2]; STEPS.len() - 1];
            for (plot, truth) in plots {
                let mut job = job(plot, &MIX, SpeciesBy::Auto, false);
                if let Some(density) = density {
                    let file = dir.path().join("thin.laz");
                    std::fs::write(&file, thinned(&job.scans[0], density)).unwrap();
                    job.scans = [file].into();
                }
                // A plot so thin may show no ground.
                let Ok(survey) = survey::inventory(&job, &mut Recorder::new(&Silent)) else {
                    continue;
                };
                let crowns = || survey.trees.iter().map(|t| &t.crown).filter(|c| !c.is_understory);
                let pairs = matches(truth, &survey, crowns());
                let right: BTreeSet<usize> = pairs.into_iter().map(|(_, tree)| tree).collect();
                for (i, crown) in crowns().enumerate() {
                    let step = STEPS.iter().rposition(|s| *s <= crown.confidence).unwrap();
                    counts[step][0] += 1;
                    counts[step][1] += usize::from(right.contains(&i));
                }
            }
            let first = density.map_or("as flown".to_owned(), |d| format!("{d}"));
            let cells = counts.map(|[all, right]| {
                let share = right as f64 / all.max(1) as f64;
                if all == 0 { "—".to_owned() } else { format!("{share:.2} of {all}") }
            });
            let [found, right] =
                counts.iter().fold([0, 0], |[a, b], [all, right]| [a + all, b + right]);
            let annotated: usize = plots.values().map(Vec::len).sum();
            let f1 = 2.0 * right as f64 / (found + annotated) as f64;
            [&[first, format!("{f1:.2}")], cells.as_slice()].concat()
        })
        .collect()
}

const DOCS: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/docs/inventory.md");

/// The page with `text` between the marks of that name.
fn placed(page: &str, name: &str, text: &str) -> String {
    println!("{text}");
    let mark = format!("<!-- {name}, by tests/species_plots.rs -->\n");
    let (before, rest) = page.split_once(&mark).unwrap();
    let (_, after) = rest.split_once("<!-- end -->").unwrap();
    format!("{before}{mark}\n{text}\n<!-- end -->{after}")
}

#[test]
fn kinds_and_sizes_beside_the_field_stand_on_their_page() {
    let Some(plots) = annotated() else { return };
    let ranges = run(&plots, &MIX, SpeciesBy::Luminance, true).named;
    let alone = run(&plots, &MIX, SpeciesBy::Auto, false).named;
    let those_there =
        run(&plots, &["pinus_sylvestris", "quercus_robur"], SpeciesBy::Auto, true).named;
    let Outcome { named: both, errors, crowns } = run(&plots, &MIX, SpeciesBy::Auto, true);

    let head = ["", "kind right", "MLBS", "OSBS", "genus right"].map(str::to_owned);
    let rows = [
        accuracy("luminance ranges alone", &ranges),
        accuracy("without the photo", &alone),
        accuracy("with the photo", &both),
        accuracy("with the photo, pine and oak named", &those_there),
        accuracy("always the site's commoner kind", &commonest(&both)),
    ];
    let matrices = [
        matrices("Luminance ranges alone", &ranges),
        matrices("Without the photo", &alone),
        matrices("With the photo", &both),
    ];
    let kinds = format!("{}\n{}", table(&head, &rows), matrices.join("\n"));

    let head =
        ["", "annotated", "found", "matched", "F1", "canopy's", "matched", "F1"].map(str::to_owned);
    let of = |site: usize| crowns.map(|storeys| storeys[site]);
    let sum = |storey: usize| std::array::from_fn(|k| crowns[storey].iter().map(|c| c[k]).sum());
    let lines = [(SITES[0], of(0)), (SITES[1], of(1)), ("both", [sum(0), sum(1)])];
    let rows = lines.map(|(site, counts)| {
        let mut row = vec![site.to_owned(), counts[0][0].to_string()];
        for [annotated, found, matched] in counts {
            let f1 = 2.0 * matched as f64 / (annotated + found).max(1) as f64;
            row.extend([found.to_string(), matched.to_string(), format!("{f1:.3}")]);
        }
        row
    });
    let trees = table(&head, &rows);

    let head =
        ["", "trees", "height: RMSE, m", "bias, m", "stems", "diameter: RMSE, cm", "bias, cm"];
    let rows = [0, 1].map(|site| {
        let mut row = vec![SITES[site].to_owned()];
        for (errors, unit) in errors[site].iter().zip([1.0, 100.0]) {
            row.push(errors.0.len().to_string());
            row.push(format!("{:.2}", unit * errors.rmse()));
            row.push(format!("{:+.2}", unit * errors.bias()).replace('-', "−"));
        }
        row
    });
    let sizes = table(&head.map(str::to_owned), &rows);

    let steps = STEPS.windows(2).map(|s| format!("{} to {}", s[0], s[1].min(1.0)));
    let head: Vec<String> =
        ["returns a m²", "F1"].map(str::to_owned).into_iter().chain(steps).collect();
    let sure = table(&head, &confidences(&plots));

    let page = std::fs::read_to_string(DOCS).unwrap();
    let new = placed(&page, "trees", &trees);
    let new = placed(&new, "confidence", &sure);
    let new = placed(&new, "kinds", &kinds);
    let new = placed(&new, "sizes", &sizes);
    for (site, [height, stem]) in SITES.iter().zip(&errors) {
        assert!(height.rmse() < 6.0 && height.bias().abs() < 4.0, "{site}");
        assert!(stem.rmse() < 0.16 && stem.bias().abs() < 0.08, "{site}");
    }
    let right = |trees: &[Named], site| share(trees, site, Named::has_kind);
    // Held out plot by plot, the model reaches 0.9 and more; the ranges are right of a quarter.
    assert!(right(&alone, None) > 0.85 && right(&both, None) > 0.85);
    for (site, name) in SITES.iter().enumerate() {
        assert!(right(&both, Some(site)) > 0.8, "{name}");
    }
    assert!(right(&both, None) > right(&ranges, None));
    if std::env::var_os("UPDATE_DOCS").is_some() {
        std::fs::write(DOCS, new).unwrap();
        return;
    }
    assert!(page == new, "set UPDATE_DOCS to write the page anew: {DOCS}");
}

/// A crown as wide as its box, and nothing else known of it.
fn boxed(bounds: [f64; 4], origin: DVec3) -> Crown {
    let [west, south, east, north] = bounds;
    let middle = DVec2::new(0.5 * (west + east), 0.5 * (south + north)) - origin.truncate();
    let half = DVec2::new(0.5 * (east - west), 0.5 * (north - south));
    let corner = |k: i32| {
        let a = f64::from(k) * std::f64::consts::TAU / 32.0;
        (middle + half * DVec2::new(a.cos(), a.sin())).as_vec2()
    };
    Crown {
        key: 0,
        root: middle.as_vec2().extend(0.0),
        apex: middle.as_vec2().extend(1.0),
        height_m: 1.0,
        base_height_m: 0.0,
        diameter_m: 1.0,
        spread_m: 5.0,
        volume_cu_m: 60.0,
        surface_sq_m: 90.0,
        is_understory: false,
        outline: (0..32).map(corner).collect(),
        attractors: Vec::new(),
        point_count: 0,
        confidence: 1.0,
    }
}

/// How much greener a crown is than grey, of its mean colour: (2 G − R − B) / (R + G + B).
fn greenness(photo: &Photo, outline: &[Vec2]) -> Option<f32> {
    let low = outline.iter().copied().reduce(Vec2::min)?;
    let high = outline.iter().copied().reduce(Vec2::max)?;
    let at = |k: usize| (k as f32 + 0.5) / 24.0;
    let places = (0..576).map(|k| low + (high - low) * Vec2::new(at(k % 24), at(k / 24)));
    let colours = places.filter(|p| contains(outline, *p)).filter_map(|p| photo.sample(p));
    let [r, g, b] = colours.reduce(|a, b| std::array::from_fn(|k| a[k] + b[k]))?;
    Some((2.0 * g - r - b) / (r + g + b).max(1e-6))
}

#[test]
fn features_of_the_annotated_crowns() {
    let (Some(plots), Some(out)) = (annotated(), std::env::var_os("FEATURES_CSV")) else { return };
    let mut text = format!(
        "plot,taxon,is_conifer,{},luminance,greenness\n",
        species::kind::FEATURES.join(",")
    );
    for (plot, truth) in &plots {
        let job = job(plot, &MIX, SpeciesBy::Auto, true);
        let cloud = read(&job.scans, &READ).unwrap().value.cloud;
        let classified = ground::classify(cloud, Method::Smrf).unwrap().value;
        let terrain = terrain::build(&classified, &TerrainOptions::default()).unwrap().value;
        let frame = &classified.cloud.frame;
        let corners = classified.cloud.position.iter().map(|p| p.truncate());
        let (low, high) =
            corners.fold((Vec2::INFINITY, Vec2::NEG_INFINITY), |(l, h), p| (l.min(p), h.max(p)));
        let raster = geotiff::read(job.photo.as_deref().unwrap()).unwrap();
        let photo = Photo::new(plot, raster, frame, low, high).unwrap().value;
        let crowns: Vec<Crown> = truth.iter().map(|t| boxed(t.bounds, frame.origin)).collect();
        let looks = look::measure(&crowns, &classified, &terrain);
        for ((t, crown), l) in truth.iter().zip(&crowns).zip(&looks.of_crown) {
            let (Some(l), false) = (l, t.taxon.is_empty()) else { continue };
            let seen = photo.seen(&crown.outline);
            let values = [
                Some(l.mean_height),
                Some(l.height_spread),
                looks.intensity_over_ground(l),
                seen.and_then(|s| s.contrast),
                seen.map(|s| s.luminance),
                greenness(&photo, &crown.outline),
            ];
            let cells = values.map(|v| v.map_or(String::new(), |v| format!("{v:.5}")));
            let is_conifer = u8::from(t.is_conifer());
            writeln!(text, "{plot},{},{is_conifer},{}", t.taxon, cells.join(",")).unwrap();
        }
    }
    std::fs::write(out, text).unwrap();
}
