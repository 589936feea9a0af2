use proptest::prelude::*;

use super::*;
use crate::skeleton::{Detail, NO_PARENT, Target, decline, grow};
use crate::species::{self, state::Condition};
use crate::texture;

pub(crate) const SPECIES: [&str; 6] = [
    "larix_sibirica",
    "picea_obovata",
    "pinus_sylvestris",
    "betula_pendula",
    "quercus_robur",
    "salix_caprea",
];

const LEVELS: [FoliageLevel; 5] = [
    FoliageLevel::None,
    FoliageLevel::Shell,
    FoliageLevel::Sparse,
    FoliageLevel::Cards,
    FoliageLevel::Geometry,
];

fn bare(tolerance_m: f32) -> MeshOptions {
    MeshOptions {
        tolerance_m,
        triangle_budget: None,
        foliage: FoliageLevel::None,
        ..MeshOptions::HERO
    }
}

fn oak() -> Species {
    species::load("quercus_robur").unwrap()
}

/// A chain of nodes with branches, from raw draws: all but reversals and standing still included.
fn skeleton(steps: &[(usize, [i8; 3], f32, bool)], radius: f32) -> Skeleton {
    let mut s = Skeleton {
        position: vec![Vec3::ZERO, Vec3::Z * 0.125],
        parent: vec![NO_PARENT, 0],
        radius_m: vec![radius; 2],
        axis: vec![0; 2],
        order: vec![0; 2],
        birth: vec![0, 1],
        dead: Vec::new(),
    };
    let mut tips = vec![1usize];
    for &(pick, step, shrink, branch) in steps {
        let axis = pick % tips.len();
        let parent = tips[axis];
        let node = s.position.len();
        // Edges of tubes in one place could not be told apart: each node is off a little.
        let off = [0.819_172_5, 0.671_043_6, 0.549_700_5].map(|k| (node as f32 * k).fract() - 0.5);
        let step = Vec3::from_array(step.map(f32::from)) * 0.125 + Vec3::from_array(off) * 4e-3;
        s.position.push(s.position[parent] + step);
        s.parent.push(parent as u32);
        s.radius_m.push(s.radius_m[parent] * shrink);
        s.birth.push(1);
        if branch {
            s.axis.push(tips.len() as u32);
            s.order.push(s.order[parent].saturating_add(1));
            tips.push(node);
        } else {
            s.axis.push(axis as u32);
            s.order.push(s.order[parent]);
            tips[axis] = node;
        }
    }
    s
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]
    #[test]
    fn every_edge_of_every_tube_has_two_triangles(
        steps in prop::collection::vec(
            (0usize..8, [-3i8..4, -3i8..4, -3i8..4], 0.5f32..1.0, any::<bool>()), 1..60),
        radius in prop::sample::select(vec![1e-6f32, 1e-3, 0.05, 0.3, 2.0]),
        tolerance in prop::sample::select(vec![1e-4f32, 2e-3, 0.05]),
        has_young in any::<bool>(),
        has_twigs in any::<bool>(),
        junctions in prop::sample::select(vec![Junctions::Welded, Junctions::Intersecting]),
    ) {
        let s = skeleton(&steps, radius);
        let mut species = oak();
        species.bark.upper = has_young.then_some([200, 120, 70]);
        species.bark.twig = has_twigs.then_some([90, 60, 50]);
        s.check().unwrap();
        let options = MeshOptions { foliage: FoliageLevel::Cards, junctions, ..bare(tolerance) };
        let tree = build(&s, &species, &Atlas::whole(0.4), &options, Seed::new(1)).unwrap();
        tree.woods().iter().for_each(|s| s.check().unwrap());
        tree.foliage.check().unwrap();
        let wood = tree.woods();
        match junctions {
            Junctions::Welded => {
                prop_assert_eq!(check::open_edges(&wood), 0);
                prop_assert!((1..=stems(&s)).contains(&check::parts(&wood)));
            }
            Junctions::Intersecting => prop_assert_eq!(check::unmatched_sides(&wood), 0),
        }
    }
}

/// A branch out of the turn of an axis that goes back along itself.
#[test]
fn a_branch_from_a_hairpin_has_facets_with_an_area() {
    // Eighths of a metre; parent and axis.
    let nodes: [([i8; 3], u32, u32); 14] = [
        ([0, 0, 0], NO_PARENT, 0),
        ([-3, 2, 0], 0, 1),
        ([1, 2, 0], 0, 0),
        ([1, 2, -1], 2, 2),
        ([1, 1, -1], 3, 3),
        ([-1, 3, 2], 2, 0),
        ([-2, 1, 0], 1, 4),
        ([-3, 2, 1], 1, 5),
        ([-1, 0, -1], 5, 6),
        ([1, 2, 1], 8, 6),
        ([3, -1, 1], 9, 6),
        ([1, 1, 3], 10, 6),
        ([3, 0, 6], 11, 7),
        ([2, 0, 2], 11, 6),
    ];
    let s = Skeleton {
        position: nodes.map(|n| Vec3::from_array(n.0.map(f32::from)) / 8.0).to_vec(),
        parent: nodes.map(|n| n.1).to_vec(),
        radius_m: vec![1e-6; nodes.len()],
        axis: nodes.map(|n| n.2).to_vec(),
        order: vec![0, 1, 0, 1, 2, 0, 2, 2, 1, 1, 1, 1, 2, 1],
        birth: vec![0; nodes.len()],
        dead: Vec::new(),
    };
    let tree = build(&s, &oak(), &Atlas::whole(0.4), &bare(2e-3), Seed::new(1)).unwrap();
    tree.check().unwrap();
    assert_eq!(check::parts(&tree.woods()), stems(&s));
}

/// A cone of the given base radius, closed forms known, with no collar and no flare.
fn cone(radius: f32, height: f32, tolerance: f32) -> Surface {
    let knots = [
        path::Knot { at: Vec3::ZERO, radius_m: radius },
        path::Knot { at: Vec3::Z * height, radius_m: 0.0 },
    ];
    let foot = path::Foot::Inside { parent_radius_m: radius, parent_direction: Vec3::X };
    let mut rings = Vec::new();
    let least = path::Least::within(height);
    let scratch = &mut path::Scratch::default();
    path::rings(
        &knots,
        foot,
        least,
        &path::Sides::new(tolerance, path::Stem::TRUE),
        false,
        scratch,
        &mut rings,
    );
    tube::lay_bark(&mut rings, 1.0, (|| knots[0].radius_m, 0.0), 0);
    let mut bark = tube::Bark::new(young::Young::default(), None, Seed::new(1));
    bark.tube(tube::Shape {
        rings: &mut rings,
        holes: &[],
        out_of: None,
        is_stem: false,
        line: &[],
        arcs_m: &[],
        shift_m: 0.0,
        key: 0,
    });
    let [out, ..] = bark.finish();
    out
}

#[test]
fn a_cone_has_the_volume_and_area_of_its_prism() {
    let (r, h) = (0.5f32, 3.0f32);
    let mut last = f64::INFINITY;
    for tolerance in [0.1, 0.02, 0.004] {
        let c = cone(r, h, tolerance);
        c.check().unwrap();
        let n = f64::from(path::Sides::new(tolerance, path::Stem::TRUE).of(r));
        let base = 0.5 * n * f64::from(r * r) * (std::f64::consts::TAU / n).sin();
        assert!((c.volume_m3() - base * f64::from(h) / 3.0).abs() < 1e-4);
        let truth = std::f64::consts::PI * f64::from(r * r * h) / 3.0;
        let error = truth - c.volume_m3();
        assert!(error > 0.0 && error < last);
        // Within the sagitta all round.
        assert!(error < std::f64::consts::PI * f64::from(r * h) * f64::from(tolerance));
        last = error;
        assert!(c.area_sq_m() > base);
    }
}

#[test]
fn seams_repeat_whole_tiles_and_a_taper_does_not_stretch_the_bark() {
    let c = cone(0.5, 3.0, 0.01);
    let n = path::Sides::new(0.01, path::Stem::TRUE).of(0.5) as usize;
    assert_eq!(c.position[0], c.position[n], "the seam closes to the bit");
    let u = c.uv[n].x - c.uv[0].x;
    assert_eq!(u, u.round());
    assert!(u >= 1.0);
    assert_eq!(c.uv[0].y, 0.0);
    // A stem that tapers to a fiftieth: tiles as wide as they are high, within what sides allow, and
    // one to a metre of a thick stem, three to one of thin wood.
    let knots: Vec<path::Knot> = (0..40)
        .map(|k| path::Knot { at: Vec3::Z * k as f32 * 0.5, radius_m: 0.5 * 0.905f32.powi(k) })
        .collect();
    let foot = path::Foot::Inside { parent_radius_m: 0.5, parent_direction: Vec3::X };
    let (least, mut rings) = (path::Least::within(20.0), Vec::new());
    path::rings(
        &knots,
        foot,
        least,
        &path::Sides::new(0.001, path::Stem::TRUE),
        true,
        &mut path::Scratch::default(),
        &mut rings,
    );
    tube::lay_bark(&mut rings, 1.0, (|| knots[0].radius_m, 0.0), 0);
    rings.pop();
    for w in rings.windows(2) {
        let around = |r: &path::Ring| r.repeats / (r.radius_m * std::f32::consts::TAU);
        let along = (w[1].v - w[0].v) / (w[1].arc_m - w[0].arc_m);
        let mean = (around(&w[0]) * around(&w[1])).sqrt();
        let girth = w[1].radius_m * std::f32::consts::TAU;
        let fine = girth.recip().clamp(1.0, 3.0);
        if girth > 0.36 {
            assert!((0.65..1.5).contains(&(along / mean)), "{along} {mean}");
            assert!((0.65..1.5).contains(&(mean / fine)), "{mean} tiles a metre");
        }
        assert!((0.65..1.5).contains(&(along / fine)), "{along} tiles a metre, not {fine}");
        assert_eq!(w[1].repeats, w[1].repeats.round());
    }
    assert!(rings[0].repeats >= 3.0 && rings[rings.len() - 1].repeats == 1.0);
}

#[test]
fn grown_trees_are_sound_closed_and_within_budget() {
    for name in SPECIES {
        let s = species::load(name).unwrap();
        let atlas = texture::tests::leafy(&s, 64, Seed::new(1)).atlas;
        for (detail, options) in
            [(Detail::FOREST, MeshOptions::FOREST), (Detail::HERO, MeshOptions::HERO)]
        {
            let target = Target::FromSpecies { height_m: None };
            let skeleton = grow(&s, target, detail, Seed::new(3)).unwrap();
            let tree = build(&skeleton, &s, &atlas, &options, Seed::new(3)).unwrap();
            tree.check().unwrap_or_else(|e| panic!("{name}: {e}"));
            let budget = options.triangle_budget.unwrap();
            assert!(tree.triangles() <= budget, "{name}: {}", tree.triangles());
            assert!(tree.triangles() > budget / 3, "{name}: {}", tree.triangles());
            assert_eq!(tree.upper_wood.is_empty(), s.bark.upper.is_none(), "{name}");
            // Where feet crowd, as on coarse wood, bark may change at a ring.
            let is_empty = tree.transition_wood.is_empty();
            assert!(is_empty || s.bark.upper.is_some(), "{name}");
            assert!(!is_empty || s.bark.upper.is_none() || detail == Detail::FOREST, "{name}");
            assert_eq!(tree.twig_wood.is_empty(), s.bark.twig.is_none(), "{name}");
            let low = tree.wood.bounds().0.z;
            assert!((-0.5..0.0).contains(&low), "{name}: goes on below ground, {low}");
            assert_eq!(tree, build(&skeleton, &s, &atlas, &options, Seed::new(3)).unwrap());
        }
    }
}

/// What springs from the root stands on the ground by itself.
fn stems(s: &Skeleton) -> usize {
    s.stems().max(1)
}

/// Every edge of the wood in two triangles, wound one way; a part for each stem, of positive volume.
fn assert_solid(tree: &TreeMesh, stems: usize, what: &str) {
    let wood = tree.woods();
    wood.iter().for_each(|s| s.check().unwrap_or_else(|e| panic!("{what}: {e}")));
    assert_eq!(check::open_edges(&wood), 0, "{what}");
    let parts = check::parts(&wood);
    assert!((1..=stems).contains(&parts), "{what}: {parts} parts of {stems} stems");
    let volume = wood.iter().map(|s| s.volume_about_m3(Vec3::ZERO)).sum::<f64>();
    assert!(volume > 0.0, "{what}: {volume} m³");
}

#[test]
fn the_wood_of_every_species_is_one_solid() {
    for name in species::builtin_names() {
        let s = species::load(name).unwrap();
        for seed in 1..=3 {
            for (detail, options) in
                [(Detail::FOREST, MeshOptions::FOREST), (Detail::HERO, MeshOptions::HERO)]
            {
                let target = Target::FromSpecies { height_m: None };
                let skeleton = grow(&s, target, detail, Seed::new(seed)).unwrap();
                for budget in [None, options.triangle_budget, Some(1000)] {
                    let options = MeshOptions {
                        triangle_budget: budget,
                        foliage: FoliageLevel::None,
                        ..options
                    };
                    let atlas = Atlas::whole(0.4);
                    let tree = build(&skeleton, &s, &atlas, &options, Seed::new(seed)).unwrap();
                    let stems = stems(&skeleton);
                    assert_solid(&tree, stems, &format!("{name} {seed} {budget:?}"));
                    if budget.is_none() {
                        assert_eq!(check::parts(&tree.woods()), stems, "{name} {seed}");
                    }
                }
            }
        }
    }
}

/// Where every leaf is meshed as beside cards.
#[test]
fn all_branches_are_welded_where_wood_is() {
    for name in ["picea_abies", "betula_pendula", "quercus_robur"] {
        let s = species::load(name).unwrap();
        let target = Target::FromSpecies { height_m: None };
        let skeleton = grow(&s, target, Detail::FOREST, Seed::new(1)).unwrap();
        for (foliage, junctions) in [
            (FoliageLevel::Geometry, Junctions::Welded),
            (FoliageLevel::Geometry, Junctions::Intersecting),
            (FoliageLevel::Cards, Junctions::Welded),
        ] {
            let triangle_budget = Some(200_000);
            let options = MeshOptions { triangle_budget, foliage, junctions, ..MeshOptions::HERO };
            let tree = build(&skeleton, &s, &Atlas::whole(0.4), &options, Seed::new(1)).unwrap();
            assert_eq!(tree.unwelded_axes, 0, "{name} {foliage:?}");
            let parts = check::parts(&tree.woods());
            assert_eq!(parts == 1, junctions == Junctions::Welded, "{name} {foliage:?}: {parts}");
        }
    }
}

/// Where f32 leaves room for few feet, the others' branches are closed for themselves.
#[test]
fn branches_that_are_not_welded_are_counted() {
    let mut steps = vec![(0, [1, 0, 0], 0.5, true)];
    // Off a twig a millimetre thick and a few centimetres long.
    let around = (0..400).map(|k| (0, [0, (k % 5) as i8 - 2, 3 - (k % 7) as i8], 0.5, true));
    steps.extend(around);
    let mut s = skeleton(&steps, 0.004);
    s.position[1] = Vec3::Z * 0.05;
    let tree = build(&s, &oak(), &Atlas::whole(0.4), &bare(2e-3), Seed::new(1)).unwrap();
    tree.check().unwrap();
    assert!(tree.unwelded_axes > 0);
    assert_eq!(check::parts(&tree.woods()), 1 + tree.unwelded_axes);
}

#[test]
fn every_stem_of_a_shrub_stands_in_the_ground_at_every_level() {
    for name in ["corylus_avellana", "salix_caprea", "sorbus_aucuparia"] {
        let s = species::load(name).unwrap();
        for seed in 1..=3 {
            let target = Target::FromSpecies { height_m: None };
            let skeleton = grow(&s, target, Detail::HERO, Seed::new(seed)).unwrap();
            for budget in [20_000, 8_000, 3_000, 500] {
                let options = MeshOptions { triangle_budget: Some(budget), ..MeshOptions::HERO };
                let tree =
                    build(&skeleton, &s, &Atlas::whole(0.4), &options, Seed::new(seed)).unwrap();
                let feet = check::feet_m(&tree.woods());
                assert!(feet.iter().all(|z| *z < -0.2), "{name} {seed} {budget}: {feet:?}");
            }
        }
    }
}

/// The same number of tiles around a stem, so that bark does not change its scale from level to level.
#[test]
fn bark_is_as_fine_at_every_level() {
    for name in ["larix_decidua", "quercus_robur", "tilia_cordata", "abies_sibirica"] {
        let s = species::load(name).unwrap();
        for seed in 1..=3 {
            let target = Target::FromSpecies { height_m: None };
            let skeleton = grow(&s, target, Detail::HERO, Seed::new(seed)).unwrap();
            let fine = |budget| {
                let options = MeshOptions { triangle_budget: Some(budget), ..MeshOptions::HERO };
                let atlas = Atlas::whole(0.4);
                let tree = build(&skeleton, &s, &atlas, &options, Seed::new(seed)).unwrap();
                let most_m = 1.5 * skeleton.radius_m[0];
                let (mut tiles, mut area) = (0.0, 0.0);
                for wood in tree.woods() {
                    for t in wood.index.chunks_exact(3) {
                        let [a, b, c] = [0, 1, 2].map(|k| t[k] as usize);
                        let [p, q, r] = [a, b, c].map(|i| wood.position[i]);
                        let middle = (p + q + r) / 3.0;
                        let is_stem = middle.truncate().length() < most_m;
                        if is_stem && (0.8..2.5).contains(&middle.z) {
                            let [u, v, w] = [a, b, c].map(|i| wood.uv[i]);
                            tiles += (v - u).perp_dot(w - u).abs();
                            area += (q - p).cross(r - p).length();
                        }
                    }
                }
                (tiles / area).sqrt()
            };
            let of = [20_000, 8_000, 3_000, 500].map(fine);
            assert!(of.iter().all(|f| (f / of[0] - 1.0).abs() < 0.1), "{name} {seed}: {of:?}");
        }
    }
}

/// A stem of few looks as thick at every level as it does from near.
#[test]
fn stems_of_a_small_stool_keep_their_flare() {
    let s = species::load("sorbus_aucuparia").unwrap();
    let target = Target::FromSpecies { height_m: None };
    let skeleton = grow(&s, target, Detail::HERO, Seed::new(3)).unwrap();
    let made = |budget| {
        let options = MeshOptions { triangle_budget: Some(budget), ..MeshOptions::HERO };
        build(&skeleton, &s, &Atlas::whole(0.4), &options, Seed::new(3)).unwrap()
    };
    // Their extent along y at a height, that between them included.
    let wide = |tree: &TreeMesh, z: f32| {
        let mut ends = [f32::INFINITY, f32::NEG_INFINITY];
        for wood in tree.woods() {
            for t in wood.index.chunks_exact(3) {
                let [a, b, c] = [0, 1, 2].map(|k| wood.position[t[k] as usize]);
                for (p, q) in [(a, b), (b, c), (c, a)] {
                    if (p.z < z) != (q.z < z) {
                        let y = p.lerp(q, (z - p.z) / (q.z - p.z)).y;
                        ends = [ends[0].min(y), ends[1].max(y)];
                    }
                }
            }
        }
        ends[1] - ends[0]
    };
    let finest = made(20_000);
    for budget in [8_000, 3_000, 500] {
        let tree = made(budget);
        for z in [0.02, 0.3, 0.6] {
            let [of, to] = [&tree, &finest].map(|tree| wide(tree, z));
            assert!((of / to - 1.0).abs() < 0.1, "{budget}, {z} m up: {of} {to}");
        }
    }
}

#[test]
fn normals_of_wood_look_where_its_triangles_do() {
    let (mut worst, mut turned) = ((0.0f32, String::new()), Vec::new());
    for name in species::builtin_names() {
        let s = species::load(name).unwrap();
        for seed in 1..=4 {
            let target = Target::FromSpecies { height_m: None };
            let options = MeshOptions { foliage: FoliageLevel::None, ..MeshOptions::HERO };
            let skeleton = grow(&s, target, Detail::HERO, Seed::new(seed)).unwrap();
            let tree = build(&skeleton, &s, &Atlas::whole(0.4), &options, Seed::new(seed)).unwrap();
            let mut away = 0;
            for wood in tree.woods() {
                for t in wood.index.as_chunks::<3>().0 {
                    let [a, b, c] = t.map(|i| wood.position[i as usize]);
                    let front = (b - a).cross(c - a);
                    let looks = t.map(|i| wood.normal[i as usize].dot(front) / front.length());
                    away += usize::from(looks.iter().any(|l| *l < 0.0));
                    // By more than sideways: six degrees.
                    if looks.iter().all(|l| *l < -0.1) {
                        turned.push(format!("{name} {seed}: {a} {b} {c}, {looks:.2?}"));
                    }
                }
            }
            let share = away as f32 / tree.wood_triangles() as f32;
            if share > worst.0 {
                worst = (share, format!("{name} {seed}"));
            }
        }
    }
    // What is left is folded back on itself.
    assert!(worst.0 < 0.004, "{worst:?}");
    // Twigs that would have to move far to stand clear of their parent's facets.
    assert!(turned.len() < 60, "{} {turned:?}", turned.len());
}

#[test]
fn bare_trees_keep_their_height_at_any_budget() {
    // An oak's top is not that of its stem.
    for name in ["quercus_robur", "tilia_cordata", "corylus_avellana"] {
        let species = species::load(name).unwrap();
        let target = Target::FromSpecies { height_m: None };
        let detail = Detail { max_nodes: 3333, attractor_spacing_m: None };
        let skeleton = grow(&species, target, detail, Seed::new(2)).unwrap();
        for budget in [300, 500, 3000] {
            let options = MeshOptions { triangle_budget: Some(budget), ..bare(0.002) };
            let tree =
                build(&skeleton, &species, &Atlas::whole(0.4), &options, Seed::new(2)).unwrap();
            assert!(tree.triangles() <= budget);
            let high = tree.bounds().1.z / skeleton.height_m();
            assert!(high > 0.99, "{name} of {budget}: {high}");
        }
    }
}

/// However far up its foot has to move: stems of a shrub all spring from one place.
#[test]
fn thick_tips_stay_where_they_are_at_any_budget() {
    let mut found = 0;
    let name = "corylus_avellana";
    for seed in [1, 2] {
        let (species, seed) = (species::load(name).unwrap(), Seed::new(seed));
        let target = Target::FromSpecies { height_m: None };
        let detail = Detail { max_nodes: 3333, attractor_spacing_m: None };
        let grown = grow(&species, target, detail, seed).unwrap();
        let dead = decline::in_condition(&grown, species.kind, Condition::OldDead, seed);
        let mut has_child = vec![false; dead.len()];
        (1..dead.len()).for_each(|i| has_child[dead.parent[i] as usize] = true);
        // A stub may be as short as its foot has to move.
        let is_high = |i: usize| dead.position[i].z > 0.5 * dead.height_m();
        let is_thick = |i: &usize| !has_child[*i] && dead.radius_m[*i] > 0.008 && is_high(*i);
        let tips: Vec<usize> = (0..dead.len()).filter(is_thick).collect();
        for budget in [1_000, 3_000, 20_000] {
            let options = MeshOptions { triangle_budget: Some(budget), ..bare(0.002) };
            let tree = build(&dead, &species, &Atlas::whole(0.4), &options, seed).unwrap();
            let wood = tree.woods();
            for &i in &tips {
                let (tip, radius_m) = (dead.position[i], dead.radius_m[i]);
                let corners = wood.iter().flat_map(|s| &s.position);
                let off = corners.map(|p| p.distance(tip)).fold(f32::INFINITY, f32::min);
                assert!(off < 0.05 + radius_m, "{name} of {budget}: {tip} is off by {off}");
                found += 1;
            }
        }
    }
    assert!(found > 12, "{found}");
}

#[test]
fn budgets_are_kept_down_to_a_stem() {
    let s = oak();
    let target = Target::FromSpecies { height_m: None };
    let skeleton = grow(&s, target, Detail::HERO, Seed::new(1)).unwrap();
    for foliage in LEVELS {
        for budget in [0usize, 100, 500, 2_000, 50_000] {
            let options =
                MeshOptions { triangle_budget: Some(budget), foliage, ..MeshOptions::HERO };
            let tree = build(&skeleton, &s, &Atlas::whole(0.4), &options, Seed::new(1)).unwrap();
            tree.check().unwrap();
            assert!(tree.triangles() <= budget.max(400), "{budget}: {}", tree.triangles());
        }
    }
}

#[test]
fn normals_point_out_of_the_wood() {
    let s = oak();
    let target = Target::FromSpecies { height_m: Some(8.0) };
    let skeleton = grow(&s, target, Detail::FOREST, Seed::new(2)).unwrap();
    let tree = build(&skeleton, &s, &Atlas::whole(0.4), &bare(0.002), Seed::new(2)).unwrap();
    let w = &tree.wood;
    assert!(w.volume_m3() > 0.0);
    let against = w
        .index
        .chunks_exact(3)
        // A base's cap shares the normals of its ring.
        .filter(|t| t.iter().any(|&k| w.uv[k as usize].y != w.uv[t[0] as usize].y))
        .filter(|t| {
            let [a, b, c] = [0, 1, 2].map(|k| w.position[t[k] as usize]);
            let face = (b - a).cross(c - a);
            t.iter().map(|&k| w.normal[k as usize]).sum::<Vec3>().dot(face) < 0.0
        })
        .count();
    // Sharp bends may turn a few.
    assert!(against * 200 < w.triangles(), "{against} of {}", w.triangles());
}

#[test]
fn extreme_radii_give_sound_wood() {
    for radius in [1e-6f32, 1e3] {
        let steps: Vec<_> = (0..12).map(|k| (0, [0, 1, 3], 0.9, k % 4 == 3)).collect();
        let s = skeleton(&steps, radius);
        let tree = build(&s, &oak(), &Atlas::whole(0.4), &bare(0.001), Seed::new(1)).unwrap();
        tree.check().unwrap();
    }
}

#[test]
fn a_single_node_has_no_wood_and_says_so() {
    let s = Skeleton {
        position: vec![Vec3::ZERO],
        parent: vec![NO_PARENT],
        radius_m: vec![0.1],
        axis: vec![0],
        order: vec![0],
        birth: vec![0],
        dead: Vec::new(),
    };
    let error = build(&s, &oak(), &Atlas::whole(0.4), &bare(0.001), Seed::new(1)).unwrap_err();
    assert_eq!(error.message(), "a skeleton of 1 nodes has no wood");
}

#[test]
fn a_surface_with_a_defect_is_refused() {
    let good = cone(0.5, 3.0, 0.01);
    let refused = |breakage: fn(&mut Surface), what: &str| {
        let mut s = good.clone();
        breakage(&mut s);
        let message = s.check().unwrap_err().to_string();
        assert!(message.contains(what), "{message}");
    };
    refused(|s| s.position[1].x = f32::NAN, "not finite");
    refused(|s| s.normal[2] *= 1.01, "long");
    refused(|s| s.index[0] = 1_000_000, "past");
    refused(|s| s.index[1] = s.index[0], "no area");
    refused(|s| s.uv.truncate(3), "texture coordinates");
    let mut open = good.clone();
    open.index.truncate(open.index.len() - 3);
    assert_eq!(check::open_edges(&[&open]), 3);
    let mut flipped = good.clone();
    flipped.index.swap(0, 1);
    assert!(check::open_edges(&[&flipped]) > 0);
}

/// Writes trees to look at: `cargo test --lib mesh -- --ignored`.
#[test]
#[ignore = "writes models to look at"]
fn contact_sheet() {
    use std::fmt::Write;
    let dir = std::env::temp_dir().join("larix-trees");
    std::fs::create_dir_all(&dir).unwrap();
    for name in SPECIES {
        let s = species::load(name).unwrap();
        let t = texture::for_species(&s, 512, Seed::new(1));
        let save = |kind: &str, image: &crate::raster::Image| {
            let path = dir.join(format!("{name}_{kind}.png"));
            std::fs::write(path, image.png().unwrap()).unwrap();
        };
        save("bark", &t.bark.colour);
        save("leaf", &t.leaf);
        t.bark.normal.iter().for_each(|p| save("normal", p));
        t.bark_upper.iter().for_each(|b| save("upper", &b.colour));
        for (level, detail, options) in [
            ("forest", Detail::FOREST, MeshOptions::FOREST),
            ("hero", Detail::HERO, MeshOptions::HERO),
        ] {
            let target = Target::FromSpecies { height_m: None };
            let skeleton = grow(&s, target, detail, Seed::new(3)).unwrap();
            let tree = build(&skeleton, &s, &t.atlas, &options, Seed::new(3)).unwrap();
            println!(
                "{name} {level}: {} nodes, wood {} foliage {}",
                skeleton.len(),
                tree.wood_triangles(),
                tree.foliage.triangles()
            );
            let mut text = String::new();
            let mut base = 1;
            for (part, surface) in [
                ("wood", &tree.wood),
                ("upper", &tree.upper_wood),
                ("transition", &tree.transition_wood),
                ("twig", &tree.twig_wood),
                ("foliage", &tree.foliage),
            ] {
                writeln!(text, "o {part}").unwrap();
                for ((p, n), uv) in surface.position.iter().zip(&surface.normal).zip(&surface.uv) {
                    writeln!(text, "v {} {} {}", p.x, p.y, p.z).unwrap();
                    writeln!(text, "vn {} {} {}", n.x, n.y, n.z).unwrap();
                    writeln!(text, "vt {} {}", uv.x, uv.y).unwrap();
                }
                for t in surface.index.chunks_exact(3) {
                    let [a, b, c] = [0, 1, 2].map(|k| t[k] as usize + base);
                    writeln!(text, "f {a}/{a}/{a} {b}/{b}/{b} {c}/{c}/{c}").unwrap();
                }
                base += surface.position.len();
            }
            std::fs::write(dir.join(format!("{name}_{level}.obj")), text).unwrap();
        }
    }
}

/// Prints triangles a second: `cargo test --release --lib mesh::tests::speed -- --ignored`.
#[test]
#[ignore = "measures"]
fn speed() {
    let s = oak();
    let detail = Detail { max_nodes: 100_000, attractor_spacing_m: None };
    let skeleton = grow(&s, Target::FromSpecies { height_m: None }, detail, Seed::new(1)).unwrap();
    let options = MeshOptions { tolerance_m: 1e-4, ..bare(1e-4) };
    let start = std::time::Instant::now();
    let wood = wood::wood(&skeleton, &options, None, &s, None, Seed::new(1));
    let rate = |n: usize, t: std::time::Duration| n as f64 / t.as_secs_f64() / 1e6;
    println!(
        "wood: {} triangles in {:?}: {:.1} M/s",
        wood.triangles(),
        start.elapsed(),
        rate(wood.triangles(), start.elapsed())
    );
    let atlas = texture::tests::leafy(&s, 128, Seed::new(1)).atlas;
    let start = std::time::Instant::now();
    let level = FoliageLevel::Cards;
    let seed = Seed::new(1);
    let order = foliage::Order {
        species: &s,
        atlas: &atlas,
        level,
        is_meshed: &[],
        stalks: foliage::Stalks::None,
        nearness: 1.0,
        budget: None,
        detail: true,
        twigs: TwigsAs::Merged,
        is_on_dead: false,
        share: 1.0,
        larger: [1.0; HEIGHTS],
        shaded: 0.0,
        wind: None,
        seed,
    };
    let cards = foliage::foliage(&skeleton, &order).unwrap();
    println!(
        "foliage: {} triangles in {:?}: {:.1} M/s",
        cards.surface.triangles(),
        start.elapsed(),
        rate(cards.surface.triangles(), start.elapsed())
    );
    let start = std::time::Instant::now();
    for _ in 0..20 {
        let small = build(&skeleton, &s, &atlas, &MeshOptions::HERO, Seed::new(1)).unwrap();
        assert!(small.triangles() > 0);
    }
    println!("hero from {} nodes: {:?}", skeleton.len(), start.elapsed() / 20);
}

#[test]
fn a_fitted_tree_has_the_height_asked_for_and_stays_closed() {
    let s = skeleton(&[(0, [0, 0, 3], 0.9, false), (0, [1, 0, 3], 0.9, false)], 0.05);
    let mut tree = build(
        &s,
        &oak(),
        &Atlas::whole(0.4),
        &MeshOptions { foliage: FoliageLevel::Cards, ..bare(1e-3) },
        Seed::new(1),
    )
    .unwrap();
    assert!(tree.bounds().1.z > s.height_m());
    tree.fit_height(12.0);
    assert!((tree.bounds().1.z - 12.0).abs() < 1e-4);
    tree.check().unwrap();
    tree.foliage.position.iter_mut().for_each(|p| p.z -= 11.0);
    let before = tree.foliage.triangles();
    tree.clear_ground();
    assert!(tree.foliage.bounds().0.z >= 0.0 && tree.foliage.triangles() < before);
    tree.foliage.check().unwrap();
}

#[test]
fn the_crown_of_a_disc_of_leaves_is_as_wide_as_the_disc() {
    let leaf = |k: u32| Vec3::new((k as f32 * 0.1).cos(), (k as f32 * 0.1).sin(), 5.0) * 2.0;
    let foliage = Surface {
        position: (0..63).map(leaf).collect(),
        index: vec![0, 1, 2],
        ..Surface::default()
    };
    let tree = TreeMesh { foliage, ..TreeMesh::default() };
    assert!((tree.crown_diameter_m() - 4.0).abs() < 0.05, "{}", tree.crown_diameter_m());
}

#[test]
fn every_vertex_knows_the_wind_where_it_is_asked_for() {
    let s = species::load("pinus_sylvestris").unwrap();
    let atlas = texture::tests::leafy(&s, 64, Seed::new(1)).atlas;
    let target = Target::FromSpecies { height_m: None };
    let skeleton = grow(&s, target, Detail::FOREST, Seed::new(3)).unwrap();
    let still = build(&skeleton, &s, &atlas, &MeshOptions::FOREST, Seed::new(3)).unwrap();
    let options = MeshOptions { wind: Some(WindProfile::Unity), ..MeshOptions::FOREST };
    let tree = build(&skeleton, &s, &atlas, &options, Seed::new(3)).unwrap();
    tree.check().unwrap();
    let woods = tree.woods().into_iter().zip(still.woods());
    for (a, b) in woods.chain([(&tree.foliage, &still.foliage)]) {
        assert_eq!((&a.position, &a.index), (&b.position, &b.index), "wind moves no vertex");
        assert!(b.wind.is_empty() && a.wind.len() == a.position.len());
    }
    let top = skeleton.height_m();
    for (p, c) in tree.wood.position.iter().zip(&tree.wood.wind) {
        assert_eq!(c[1], 0, "wood does not flutter");
        let sway = (p.z / top).clamp(0.0, 1.0).powi(2) * 255.0;
        assert!((f32::from(c[2]) - sway).abs() <= 0.51);
    }
    let most = tree.foliage.wind.iter().map(|c| c[1]).max();
    assert_eq!(most, Some(255), "the tip of a twig flutters most");
    // Below the crown there is the stem alone, which is no branch.
    let bare_m = 0.9 * skeleton.crown_base_m();
    for surface in tree.woods() {
        let moved = surface.position.iter().zip(&surface.wind);
        assert!(moved.filter(|(p, _)| p.z < bare_m).all(|(_, c)| c[3] == 0));
    }
    assert!(tree.twig_wood.wind.iter().any(|c| c[3] > 200), "tips of branches swing most");
}

#[test]
fn a_shell_moves_with_the_whole_tree() {
    let s = species::load("salix_caprea").unwrap();
    let target = Target::FromSpecies { height_m: None };
    let skeleton = grow(&s, target, Detail::FOREST, Seed::new(3)).unwrap();
    for (profile, channel) in [
        (WindProfile::Unity, Some(2)),
        (WindProfile::SpeedTreeLike, Some(0)),
        (WindProfile::CryEngine, None),
    ] {
        let options = MeshOptions {
            wind: Some(profile),
            foliage: FoliageLevel::Shell,
            ..MeshOptions::FOREST
        };
        let shell =
            build(&skeleton, &s, &Atlas::whole(0.4), &options, Seed::new(3)).unwrap().foliage;
        assert!(!shell.is_empty() && shell.wind.len() == shell.position.len(), "{profile:?}");
        for (p, c) in shell.position.iter().zip(&shell.wind) {
            let sway = (p.z / skeleton.height_m()).clamp(0.0, 1.0).powi(2) * 255.0;
            assert!(channel.is_none_or(|k: usize| (f32::from(c[k]) - sway).abs() <= 0.51));
        }
    }
}

#[test]
fn a_budget_coarsens_no_further_than_the_sagitta_asked_for() {
    let s = oak();
    let target = Target::FromSpecies { height_m: None };
    let skeleton = grow(&s, target, Detail::HERO, Seed::new(1)).unwrap();
    let made = |triangles: usize, sagitta_m: f32| {
        let options = MeshOptions {
            triangle_budget: Some(triangles),
            sagitta_m,
            foliage: FoliageLevel::None,
            ..MeshOptions::HERO
        };
        let atlas = Atlas::whole(0.4);
        build(&skeleton, &s, &atlas, &options, Seed::new(1)).unwrap()
    };
    let free = made(3_000, f32::INFINITY);
    assert!(free.sagitta_m > 0.03, "what is told is what there is: {}", free.sagitta_m);
    for sagitta_m in [0.02, 0.004] {
        let tree = made(3_000, sagitta_m);
        assert!(tree.sagitta_m <= sagitta_m * 1.001, "{} of {sagitta_m}", tree.sagitta_m);
        assert!(tree.triangles() <= 3_000 && tree.triangles() > 1_500, "{}", tree.triangles());
    }
    let fine = made(1_000_000, f32::INFINITY);
    // The foot takes more sides than there may be.
    assert!(fine.sagitta_m <= 0.0016, "the flare's, too: {}", fine.sagitta_m);
}

/// How far the wood above ground is from its skeleton, less two radii of that, at most.
fn off_skeleton_m(tree: &TreeMesh, skeleton: &Skeleton) -> f32 {
    let off_m = |at: Vec3| {
        let of = |i: usize| {
            let parent = skeleton.parent[i] as usize;
            let (a, b) = (skeleton.position[parent], skeleton.position[i]);
            let share = (at - a).dot(b - a) / (b - a).length_squared().max(1e-9);
            at.distance(a.lerp(b, share.clamp(0.0, 1.0))) - 2.0 * skeleton.radius_m[parent]
        };
        (1..skeleton.len()).map(of).fold(f32::INFINITY, f32::min)
    };
    let above = tree.woods().into_iter().flat_map(|w| &w.position).filter(|p| p.z > 0.0);
    above.map(|&p| off_m(p)).fold(0.0, f32::max)
}

/// Feet that crowd give way by little: no wood is farther from its skeleton than a few diameters.
#[test]
fn wood_keeps_to_its_skeleton() {
    const OFF_M: f32 = 0.06;
    let names = species::builtin_names().into_iter().filter(|n| !n.starts_with("table3/"));
    for name in names {
        let s = species::load(name).unwrap();
        let target = Target::FromSpecies { height_m: None };
        let skeleton = grow(&s, target, Detail::FOREST, Seed::new(1)).unwrap();
        let options = MeshOptions { foliage: FoliageLevel::None, ..MeshOptions::FOREST };
        let tree = build(&skeleton, &s, &Atlas::whole(0.4), &options, Seed::new(1)).unwrap();
        let worst_m = off_skeleton_m(&tree, &skeleton);
        assert!(worst_m < OFF_M, "{name}: {worst_m} m");
    }
}

/// A branch that runs within the bark for long, and what springs from it there, which leaves the same bark where
/// it springs.
#[test]
fn what_springs_within_the_bark_leaves_it_there() {
    let p = |x: f32, y: f32, z: f32| Vec3::new(x, y, z);
    let s = Skeleton {
        position: vec![
            Vec3::ZERO,
            p(0.0, 0.0, 2.0),
            p(0.0, 0.0, 10.0),
            p(0.1, 0.0, 3.0),
            p(0.5, 0.0, 7.0),
            p(0.1, 1.5, 3.0),
        ],
        parent: vec![NO_PARENT, 0, 1, 1, 3, 3],
        radius_m: vec![0.3, 0.3, 0.2, 0.05, 0.05, 0.02],
        axis: vec![0, 0, 0, 1, 1, 2],
        order: vec![0, 0, 0, 1, 1, 2],
        birth: vec![0; 6],
        dead: Vec::new(),
    };
    s.check().unwrap();
    let tree = build(&s, &oak(), &Atlas::whole(0.4), &bare(2e-3), Seed::new(1)).unwrap();
    tree.check().unwrap();
    assert_eq!(check::parts(&tree.woods()), 1);
    let off_m = off_skeleton_m(&tree, &s);
    assert!(off_m < 0.05, "{off_m} m");
}
