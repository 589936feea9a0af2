use super::*;
use crate::species::model::*;
use crate::species::state::{Season, State};

/// Species of every leaf shape and bark style, for tests of both rooms.
pub(crate) fn samples() -> Vec<Species> {
    type Row<'a> = (
        &'a str,
        Kind,
        LeafShape,
        [f32; 2],
        [u8; 3],
        f32,
        f32,
        BarkStyle,
        [u8; 3],
        [u8; 3],
        Option<[u8; 3]>,
    );
    let rows: Vec<Row> = vec![
        (
            "larch",
            Kind::Conifer,
            LeafShape::Tuft,
            [0.03, 0.0012],
            [118, 142, 58],
            0.35,
            0.3,
            BarkStyle::Furrows,
            [128, 102, 84],
            [58, 42, 34],
            None,
        ),
        (
            "spruce",
            Kind::Conifer,
            LeafShape::Needle,
            [0.018, 0.0013],
            [62, 84, 46],
            0.4,
            0.25,
            BarkStyle::Scales,
            [112, 92, 78],
            [62, 50, 44],
            None,
        ),
        (
            "pine",
            Kind::Conifer,
            LeafShape::Bundle,
            [0.06, 0.0015],
            [82, 106, 62],
            0.35,
            -0.2,
            BarkStyle::Plates,
            [134, 104, 82],
            [54, 40, 34],
            Some([196, 124, 72]),
        ),
        (
            "birch",
            Kind::Broadleaf,
            LeafShape::Deltoid,
            [0.05, 0.038],
            [104, 134, 52],
            0.4,
            0.6,
            BarkStyle::Birch,
            [226, 222, 212],
            [46, 40, 38],
            Some([120, 92, 78]),
        ),
        (
            "oak",
            Kind::Broadleaf,
            LeafShape::Lobed,
            [0.1, 0.06],
            [82, 112, 44],
            0.45,
            0.1,
            BarkStyle::Furrows,
            [122, 112, 100],
            [56, 48, 42],
            None,
        ),
        (
            "aspen",
            Kind::Broadleaf,
            LeafShape::Round,
            [0.05, 0.05],
            [100, 130, 66],
            0.4,
            0.2,
            BarkStyle::Smooth,
            [166, 168, 148],
            [70, 68, 58],
            None,
        ),
        (
            "willow",
            Kind::Shrub,
            LeafShape::Lanceolate,
            [0.08, 0.015],
            [112, 136, 84],
            0.4,
            0.3,
            BarkStyle::Smooth,
            [128, 120, 96],
            [66, 58, 46],
            None,
        ),
        (
            "linden",
            Kind::Broadleaf,
            LeafShape::Ovate,
            [0.07, 0.05],
            [88, 122, 48],
            0.4,
            0.1,
            BarkStyle::Furrows,
            [118, 110, 100],
            [60, 54, 50],
            None,
        ),
    ];
    let mut all: Vec<Species> = rows
        .into_iter()
        .map(|(id, kind, shape, leaf, colour, twig, droop, style, light, dark, upper)| {
            let mut s = crate::species::load("quercus_robur").unwrap();
            s.id = id.into();
            s.kind = kind;
            s.foliage.shape = shape;
            [s.foliage.leaf_length_m, s.foliage.leaf_width_m] = leaf;
            s.foliage.colour = colour;
            s.foliage.twig_length_m = twig;
            s.foliage.droop = droop;
            s.bark = Bark { style, colour: light, dark, upper, relief_m: 0.012, ..s.bark };
            s
        })
        .collect();
    all.push(crate::species::load("sorbus_aucuparia").unwrap());
    all
}

fn mean_step(p: &Picture, pair: impl Fn(u32) -> ([u32; 2], [u32; 2])) -> f64 {
    let mut sum = 0.0;
    for k in 0..p.width {
        let (a, b) = pair(k);
        for c in 0..3 {
            sum += (f64::from(p.at(a[0], a[1])[c]) - f64::from(p.at(b[0], b[1])[c])).abs();
        }
    }
    sum / f64::from(p.width)
}

/// The step over the seam is no larger than steps inside.
pub(crate) fn assert_tiles(p: &Picture, what: &str) {
    let n = p.width;
    let mut inside = [0.0f64; 2];
    for k in 8..n - 8 {
        inside[0] = inside[0].max(mean_step(p, |y| ([k, y], [k + 1, y])));
        inside[1] = inside[1].max(mean_step(p, |x| ([x, k], [x, k + 1])));
    }
    let across = mean_step(p, |y| ([n - 1, y], [0, y]));
    let down = mean_step(p, |x| ([x, n - 1], [x, 0]));
    assert!(across <= 1.25 * inside[0] + 1.0, "{what}: {across} over {}", inside[0]);
    assert!(down <= 1.25 * inside[1] + 1.0, "{what}: {down} over {}", inside[1]);
}

#[test]
fn the_ground_tiles() {
    assert_tiles(&ground(512, Seed::new(5)), "ground");
}

#[test]
fn leaf_pictures_have_sane_cover_colour_and_padding() {
    for s in samples() {
        let t = for_species(&s, 256, Seed::new(2));
        let leaf = t.leaf.picture();
        let seen: Vec<_> = leaf.data.iter().filter(|p| p[3] >= 128).collect();
        let cover = seen.len() as f64 / leaf.data.len() as f64;
        assert!((0.2..0.85).contains(&cover), "{}: cover {cover}", s.id);
        for c in 0..3 {
            let mean = seen.iter().map(|p| f64::from(p[c])).sum::<f64>() / seen.len() as f64;
            let wanted = f64::from(s.foliage.colour[c]);
            assert!((mean - wanted).abs() < 20.0, "{}: {mean} {wanted}", s.id);
        }
        // Nothing black hides under the transparent pixels.
        let least = s.foliage.colour.iter().map(|&c| u32::from(c)).sum::<u32>() / 4;
        for p in leaf.data.iter().filter(|p| p[3] < 128) {
            let sum = u32::from(p[0]) + u32::from(p[1]) + u32::from(p[2]);
            assert!(sum > least, "{}: {p:?}", s.id);
        }
        for cell in t.atlas.cells() {
            assert!(cell.coverage > 0.12 && cell.size_m > 0.0, "{}: {cell:?}", s.id);
        }
    }
}

#[test]
fn same_seed_same_bytes_other_seed_other_bytes() {
    let s = &samples()[3];
    let a = for_species(s, 128, Seed::new(9));
    let one = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    assert_eq!(a, one.install(|| for_species(s, 128, Seed::new(9))));
    assert_ne!(a.leaf, for_species(s, 128, Seed::new(10)).leaf);
    assert_eq!(ground(64, Seed::new(1)), ground(64, Seed::new(1)));
}

/// Though several say the same of it but for its colour.
#[test]
fn no_two_species_have_the_same_bark() {
    let names = crate::species::builtin_names();
    let mut seen = std::collections::BTreeMap::new();
    for name in names.iter().filter(|n| !n.contains('/')) {
        let t = for_species(&crate::species::load(name).unwrap(), 64, Seed::new(1));
        let relief = t.bark.height.as_ref().unwrap().picture().data.clone();
        if let Some(other) = seen.insert(relief, name) {
            panic!("{name} has the bark of {other}");
        }
    }
    assert!(seen.len() >= 14, "{}", seen.len());
}

#[test]
fn odd_sizes_and_odd_species_give_pictures() {
    let mut s = samples()[4].clone();
    s.foliage.leaf_length_m = 5.0;
    s.foliage.leaf_width_m = 0.0;
    s.foliage.twig_length_m = 1e-9;
    s.bark.relief_m = 1e9;
    for size in [0, 1, 63, 129, 257] {
        let t = for_species(&s, size, Seed::new(1));
        assert!(t.leaf.is_whole() && t.bark.colour.is_whole());
        assert!(t.bark.colour.width() >= 64);
    }
}

/// The share of the picture that a mask shows stays on smaller versions made by averaging.
#[test]
fn smaller_versions_keep_the_leaves() {
    let sizes = samples().into_iter().enumerate();
    // Finer ones of one species: they take long to draw.
    let of = sizes
        .flat_map(|(i, s)| if i == 0 { vec![(s.clone(), 512), (s, 1024)] } else { vec![(s, 512)] });
    for (s, size) in of {
        let p = for_species(&s, size, Seed::new(4)).leaf.into_picture();
        let cutoff = (twig::CUTOFF * 255.0) as u32;
        let seen = p.data.iter().filter(|q| u32::from(q[3]) >= cutoff).count();
        let whole = seen as f64 / p.data.len() as f64;
        for block in [2u32, 4, 8, 16, 32, 64].into_iter().filter(|block| *block <= size / 16) {
            let n = p.width / block;
            let mut passed = 0;
            for (x, y) in (0..n).flat_map(|y| (0..n).map(move |x| (x, y))) {
                let mut sum = 0;
                for (dx, dy) in (0..block).flat_map(|a| (0..block).map(move |b| (a, b))) {
                    sum += u32::from(p.at(x * block + dx, y * block + dy)[3]);
                }
                passed += u32::from(sum >= cutoff * block * block);
            }
            let share = f64::from(passed) / f64::from(n * n);
            // Of the smallest a pixel is many leaves.
            let most = if block * 16 <= size / 2 { 0.12 } else { 0.25 };
            assert!((share / whole - 1.0).abs() < most, "{} 1/{block}: {share} of {whole}", s.id);
        }
    }
}

/// Ridges are worn, furrows are not.
#[test]
fn high_places_of_bark_are_smoother() {
    for s in samples() {
        let textures = for_species(&s, 128, Seed::new(4));
        let [orm, height] = [textures.bark.orm, textures.bark.height].map(Option::unwrap);
        let (orm, height) = (orm.into_picture(), height.into_picture());
        let mut places: Vec<(u8, u8)> =
            height.data.iter().zip(&orm.data).map(|(h, orm)| (h[0], orm[1])).collect();
        places.sort_unstable();
        let mean = |part: &[(u8, u8)]| {
            part.iter().map(|p| f64::from(p.1)).sum::<f64>() / part.len() as f64
        };
        let tenth = places.len() / 10;
        let (low, high) = (mean(&places[..tenth]), mean(&places[places.len() - tenth..]));
        assert!(low > high + 10.0, "{}: {low} {high}", s.id);
    }
}

/// The leaves alone, for tests that see no bark.
pub(crate) fn leafy(species: &Species, size_px: u32, seed: Seed) -> TreeTextures {
    let (leaf, atlas) = leaves(species, size_px, seed.derive("texture", 0));
    TreeTextures { leaf: leaf.into(), atlas, ..plain(species) }
}

/// Twigs thinner than a pixel are thinned, not thickened.
#[test]
fn bare_twigs_show_as_much_in_small_pictures() {
    let winter = State { season: Season::Winter, ..State::default() };
    for name in ["larix_sibirica", "betula_pendula", "quercus_robur"] {
        let bare = winter.look(&crate::species::load(name).unwrap(), Seed::new(4));
        let shown = |size_px| {
            let atlas = for_species(&bare, size_px, Seed::new(4)).atlas;
            atlas.cells().iter().map(|c| c.coverage).sum::<f32>()
        };
        let whole = shown(1024);
        for (size_px, most) in [(64, 0.35), (128, 0.2), (256, 0.15), (384, 0.15), (512, 0.06)] {
            let share = shown(size_px) / whole;
            assert!((share - 1.0).abs() < most, "{name} {size_px}: {share}");
        }
    }
}

/// A bough in shade is the bough in light, half as large and as dark as is said.
#[test]
fn boughs_in_shade_are_those_in_light_but_darker() {
    for s in samples().into_iter().filter(|s| !s.foliage.is_bare()) {
        let t = for_species(&s, 512, Seed::new(4));
        let last = t.atlas.cells().len() - 1;
        let (light, shade) = (&t.atlas.cells()[last], t.atlas.shade(last).unwrap());
        assert!(t.atlas.shade(0).is_none());
        assert_eq!((light.reach, light.size_m), (shade.reach, shade.size_m), "{}", s.id);
        // Light of what is seen, and its share of the cell.
        let seen = |cell: &Cell| {
            let side = t.leaf.width() as f32;
            let [from, to] = [cell.min, cell.max].map(|c| c * side);
            let (mut sum, mut count) = (0.0f64, 0.0f64);
            let picture = t.leaf.picture();
            for y in from.y as u32..to.y as u32 {
                for x in from.x as u32..to.x as u32 {
                    let p = picture.at(x, picture.height - 1 - y);
                    if p[3] >= 128 {
                        sum += f64::from(crate::raster::linear_from_srgb(p[1]));
                        count += 1.0;
                    }
                }
            }
            (sum / count, count / f64::from((to.x - from.x) * (to.y - from.y)))
        };
        let [(bright, shown), (dark, also)] = [light, shade].map(seen);
        let darker = dark / bright;
        assert!((darker / f64::from(SHADE) - 1.0).abs() < 0.06, "{}: {darker}", s.id);
        assert!((also / shown - 1.0).abs() < 0.2, "{}: {also} of {shown}", s.id);
    }
}

/// Leaves of the geometry are opaque where their cell is cut, bark and mean colour all around.
#[test]
fn single_leaves_bark_and_mean_colour_are_where_the_atlas_says() {
    for s in samples() {
        let t = for_species(&s, 512, Seed::new(4));
        let at = |uv: glam::Vec2| {
            let x = (uv.x * t.leaf.width() as f32) as u32;
            let y = ((1.0 - uv.y) * t.leaf.height() as f32) as u32;
            (x, y)
        };
        let (x, y) = at(t.atlas.fill());
        for (dx, dy) in [(0, 0), (12, 12), (12, 0)] {
            assert_eq!(t.leaf.picture().at(x + dx, y + dy)[..3], s.foliage.colour, "{}", s.id);
            let (x, y) = at(t.atlas.wood());
            assert_eq!(t.leaf.picture().at(x - dx, y - dy)[3], 255, "{}", s.id);
        }
        assert_eq!(t.atlas.leaves().len(), 2);
        for cell in t.atlas.leaves() {
            let (x, y) = at(cell.uv(0.5, 0.5));
            assert_eq!(t.leaf.picture().at(x, y)[3], 255, "{}", s.id);
            let least = if cell.coverage > 0.99 { 0.99 } else { 0.05 };
            assert!(cell.coverage > least, "{}: {}", s.id, cell.coverage);
        }
    }
}

/// Writes a contact sheet: `cargo test --lib texture -- --ignored`.
#[test]
#[ignore = "writes pictures to look at"]
fn contact_sheet() {
    let dir = std::env::temp_dir().join("larix-textures");
    std::fs::create_dir_all(&dir).unwrap();
    for s in samples() {
        let start = std::time::Instant::now();
        let t = for_species(&s, 512, Seed::new(1));
        println!("{}: {:?}", s.id, start.elapsed());
        let mut pictures = vec![("leaf", t.leaf)];
        for (name, bark) in [("bark", Some(t.bark)), ("upper", t.bark_upper)] {
            pictures.extend(bark.map(|b| (name, b.colour)));
        }
        for (name, p) in pictures {
            let path = dir.join(format!("{}_{name}.png", s.id));
            std::fs::write(path, p.png().unwrap()).unwrap();
        }
    }
    std::fs::write(dir.join("ground.png"), ground(512, Seed::new(1)).to_png().unwrap()).unwrap();
}

/// No twig or leaf is cut at the border of its cell, nor touches its neighbour's.
#[test]
fn no_leaf_is_cut_at_the_border_of_its_cell() {
    for name in crate::species::builtin_names().into_iter().filter(|n| !n.starts_with("table3/")) {
        let species = crate::species::load(name).unwrap();
        if !species.foliage.shape.is_needle() {
            let (picture, atlas) = twig::draw(&species, 512, Seed::new(1));
            for (k, cell) in atlas.cells().iter().chain(atlas.leaves()).enumerate() {
                let at = |s: f32, t: f32| {
                    let uv = cell.uv(s, t);
                    let [x, y] = [uv.x, 1.0 - uv.y].map(|c| (c * 512.0) as u32);
                    picture.data[(y.min(511) * 512 + x.min(511)) as usize][3]
                };
                for step in 0..=400 {
                    let along = (step as f32 / 400.0).clamp(0.002, 0.998);
                    let sides = [at(0.002, along), at(0.998, along), at(along, 0.998)];
                    assert!(
                        sides.iter().all(|a| *a < 128),
                        "{name}, cell {k}: {sides:?} at {along}"
                    );
                }
            }
        }
    }
}

/// Beside twigs in leaf, whose colour stays that of the species; alike in other seasons.
#[test]
fn twigs_of_dry_branches_have_a_cell_of_their_own() {
    let state = State { condition: "III".parse().unwrap(), season: Season::Summer };
    for name in ["picea_abies", "betula_pendula"] {
        let own = crate::species::load(name).unwrap();
        let species = state.look(&own, Seed::new(1));
        let TreeTextures { leaf, atlas, .. } = for_species(&species, 256, Seed::new(1));
        let dry = atlas.dry().unwrap();
        assert_eq!((atlas.cells().len(), dry.cells().len()), (2, 1), "{name}");
        let mean = |cell: &Cell| {
            let picture = leaf.picture();
            let [min, max] = [cell.min, cell.max].map(|at| (at * 256.0).as_uvec2());
            let seen: Vec<[u8; 4]> = (min.y..max.y)
                .flat_map(|v| (min.x..max.x).map(move |u| (u, 255 - v)))
                .map(|(x, y)| picture.data[(y * 256 + x) as usize])
                .filter(|p| p[3] >= 128)
                .collect();
            assert!(seen.len() > 500, "{name}: {}", seen.len());
            [0, 1, 2].map(|c| seen.iter().map(|p| f32::from(p[c])).sum::<f32>() / seen.len() as f32)
        };
        let [green, grey] = [&atlas.cells()[0], &dry.cells()[0]].map(mean);
        assert!(green[1] > green[0] && green[1] > 1.3 * green[2], "{name}: {green:?}");
        assert!(grey[1] < 1.02 * grey[0] && grey[0] < 1.6 * grey[2], "{name}: {grey:?}");
        assert!(for_species(&own, 64, Seed::new(1)).atlas.dry().is_none(), "{name}: all live");
    }
}

/// By which the stalk of a card knows how thick it is to be: of bare twigs of every species, of user's pictures perhaps
/// none.
#[test]
fn a_cell_of_bare_twigs_tells_how_thick_its_stem_is() {
    let (seed, winter) = (Seed::new(1), State { season: Season::Winter, ..State::default() });
    for name in ["quercus_robur", "larix_sibirica", "betula_pendula", "sorbus_aucuparia"] {
        let species = winter.look(&crate::species::load(name).unwrap(), seed);
        for cell in for_species(&species, 1024, seed).atlas.cells() {
            assert!((0.003..0.014).contains(&cell.stem()), "{name}: {}", cell.stem());
        }
    }
}
