use rstar::RTree;
use rstar::primitives::{GeomWithData, Rectangle};

use super::foliage::{Order, Stalks, foliage};
use super::tests::SPECIES;
use super::*;
use crate::skeleton::{Detail, Target, grow};
use crate::species::model::LeafShape;
use crate::species::{self, own};
use crate::texture::atlas::Cell;

const LEVELS: [FoliageLevel; 4] =
    [FoliageLevel::Shell, FoliageLevel::Sparse, FoliageLevel::Cards, FoliageLevel::Geometry];

fn grown(name: &str) -> (Skeleton, Species, Atlas) {
    grown_to(name, None)
}

fn grown_to(name: &str, height_m: Option<f32>) -> (Skeleton, Species, Atlas) {
    grown_with(name, height_m, 800, 3)
}

fn grown_with(
    name: &str,
    height_m: Option<f32>,
    max_nodes: u32,
    seed: u64,
) -> (Skeleton, Species, Atlas) {
    let s = species::load(name).unwrap();
    let detail = Detail { max_nodes, attractor_spacing_m: None };
    let skeleton = grow(&s, Target::FromSpecies { height_m }, detail, Seed::new(seed)).unwrap();
    let atlas = crate::texture::tests::leafy(&s, 64, Seed::new(1)).atlas;
    (skeleton, s, atlas)
}

fn leaves(
    tree: &(Skeleton, Species, Atlas),
    level: FoliageLevel,
    budget: Option<usize>,
) -> Surface {
    foliage(&tree.0, &order(tree, level, budget)).unwrap().surface
}

fn order(
    (_, species, atlas): &(Skeleton, Species, Atlas),
    level: FoliageLevel,
    budget: Option<usize>,
) -> Order<'_> {
    Order {
        species,
        atlas,
        level: level.of(species),
        is_meshed: &[],
        stalks: Stalks::None,
        nearness: 1.0,
        budget,
        detail: true,
        twigs: TwigsAs::Merged,
        is_on_dead: false,
        share: 1.0,
        larger: [1.0; HEIGHTS],
        shaded: 0.0,
        wind: None,
        seed: Seed::new(1),
    }
}

/// Least cosine between a corner's normal and the front of its triangle.
fn least_cosine(s: &Surface) -> f32 {
    let of = |t: &[u32]| {
        let [a, b, c] = [0, 1, 2].map(|k| s.position[t[k] as usize].as_dvec3());
        let front = (b - a).cross(c - a).normalize().as_vec3();
        t.iter().map(|&i| s.normal[i as usize].dot(front)).fold(1.0, f32::min)
    };
    s.index.chunks_exact(3).map(of).fold(1.0, f32::min)
}

#[test]
fn every_level_is_sound_within_budget_and_lit_from_its_front() {
    for name in SPECIES.into_iter().chain(["sorbus_aucuparia"]) {
        let tree = grown(name);
        let mut before = 0;
        for level in LEVELS {
            for budget in [60, 4_000, 60_000] {
                let s = leaves(&tree, level, Some(budget));
                let what = format!("{name} {level:?} {budget}");
                s.check().unwrap_or_else(|e| panic!("{what}: {e}"));
                assert!(s.triangles() <= budget, "{what}: {}", s.triangles());
                let least = least_cosine(&s);
                assert!(least > 0.0, "{what}: a normal leaves its front, cosine {least}");
                if budget == 60_000 {
                    assert!(s.triangles() > before, "{what}: {} after {before}", s.triangles());
                    before = s.triangles();
                }
            }
        }
        assert!(before > 30_000, "{name}: {before}");
    }
}

#[test]
fn leaves_are_the_same_on_any_number_of_threads() {
    let tree = grown("larix_sibirica");
    let one = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    let many = rayon::ThreadPoolBuilder::new().num_threads(5).build().unwrap();
    for level in LEVELS {
        let make = || leaves(&tree, level, Some(50_000));
        assert_eq!(one.install(make), many.install(make));
    }
}

/// Without a budget every needle stands: 30 in each tuft, and each has its length.
#[test]
fn a_larch_has_every_needle() {
    let (skeleton, mut species, atlas) = grown("larix_sibirica");
    // A single shoot need not hide what a crown does.
    species.foliage.cover = 0.0;
    let mut young = skeleton.clone();
    // A single leafy shoot.
    let keep = 3;
    for column in [&mut young.parent, &mut young.axis] {
        column.truncate(keep);
    }
    // Long beside its twigs, and no spire, so that these and their needles are as long as usual.
    young.position = vec![Vec3::ZERO, Vec3::Z * 4.0, Vec3::new(2.0, 0.0, 3.96)];
    young.radius_m = vec![0.004; keep];
    young.order.truncate(keep);
    young.birth.truncate(keep);
    young.axis.fill(0);
    young.order.fill(0);
    let f = &species.foliage;
    assert_eq!(f.cluster, 30);
    let length_m = f.leaf_length_m;
    let s = leaves(&(young, species, atlas), FoliageLevel::Geometry, None);
    // A needle: foot, right, tip, left and the two triangles between.
    let mut needles: Vec<f32> = s
        .index
        .chunks_exact(6)
        .filter(|t| t[0] == t[3] && t[2] == t[4] && t[2] == t[0] + 2)
        .map(|t| s.position[t[0] as usize].distance(s.position[t[2] as usize]))
        .collect();
    assert!(needles.len() > 2_000 && needles.len().is_multiple_of(30), "{}", needles.len());
    needles.sort_by(f32::total_cmp);
    // A few twigs beside the top are short, and so are their needles.
    let (lo, hi) = (needles[needles.len() / 20], needles[needles.len() - 1]);
    assert!(lo > 0.4 * length_m && hi < 1.2 * length_m, "{lo} to {hi}");
}

/// Needles of a triangle each take two corners, not three, where many spring from one place.
#[test]
fn needles_of_a_place_share_corners() {
    for (name, most) in
        [("larix_sibirica", 2.2), ("pinus_sibirica", 2.6), ("pinus_sylvestris", 2.6)]
    {
        let s = leaves(&grown(name), FoliageLevel::Geometry, Some(60_000));
        let each = s.position.len() as f64 / s.triangles() as f64;
        assert!(each < most, "{name}: {each} corners a triangle");
        let mut used = vec![false; s.position.len()];
        s.index.iter().for_each(|&i| used[i as usize] = true);
        assert!(used.iter().all(|u| *u), "{name}: corners of no triangle");
    }
}

/// Fewer, wider needles and leaves, and fewer, larger twigs, hide as much; until a crown needs more
/// triangles than there are, which is told.
#[test]
fn every_leaf_hides_as_much_at_any_budget() {
    for name in SPECIES.into_iter().chain(["sorbus_aucuparia"]) {
        let tree = grown_to(name, Some(5.0));
        let hidden = |budget: Option<usize>| {
            let order = order(&tree, FoliageLevel::Geometry, budget);
            let made = foliage(&tree.0, &order).unwrap();
            // About the stem.
            let lain: Vec<Vec3> =
                made.surface.position.iter().map(|p| Vec3::new(p.z, p.x, p.y)).collect();
            (shade::hidden_sq_m(&lain, &made.surface.index), made.cover, made.surface.triangles())
        };
        let (all, cover, triangles) = hidden(None);
        assert!(cover > 0.999, "{name}: {cover}");
        for share in [2, 4] {
            let (part, cover, _) = hidden(Some(triangles / share));
            assert!(cover > 0.999, "{name} 1/{share}: {cover}");
            assert!((0.75..1.25).contains(&(part / all)), "{name} 1/{share}: {part} of {all} m²");
        }
        let (_, cover, _) = hidden(Some(triangles / 2000));
        assert!(cover < 0.5, "{name}: {cover}");
    }
}

/// A seedling has needles along its stem, not at its top alone, and spends its budget on them.
#[test]
fn a_seedling_is_needled_all_along_and_uses_its_budget() {
    for name in ["larix_decidua", "picea_abies", "pinus_sylvestris"] {
        for height_m in [0.3, 0.6, 1.0] {
            let mut tree = grown_to(name, Some(height_m));
            tree.1.foliage = tree.1.foliage_at(height_m);
            let all = leaves(&tree, FoliageLevel::Geometry, None);
            let what = format!("{name}, {height_m} m");
            for share in [0.6, 0.75, 0.9] {
                let budget = (all.triangles() as f32 * share) as usize;
                let s = leaves(&tree, FoliageLevel::Geometry, Some(budget));
                let used = s.triangles() as f32 / budget as f32;
                assert!((0.85..=1.0).contains(&used), "{what}, {share}: {used}");
            }
            let high_m = all.bounds().1.z;
            let mut quarter = [0usize; 4];
            for p in &all.position {
                quarter[((p.z / high_m * 4.0).max(0.0) as usize).min(3)] += 1;
            }
            let least = all.position.len() / 60;
            assert!(quarter.iter().all(|n| *n > least), "{what}: {quarter:?}");
        }
    }
}

#[test]
fn a_shell_is_closed_and_holds_the_crown() {
    for name in SPECIES {
        let tree = grown(name);
        let s = leaves(&tree, FoliageLevel::Shell, None);
        assert_eq!(check::open_edges(&[&s]), 0, "{name}");
        assert!(s.volume_m3() > 0.0 && s.triangles() <= 400, "{name}");
        let cards = leaves(&tree, FoliageLevel::Cards, Some(20_000));
        let ((a, b), (c, d)) = (s.bounds(), cards.bounds());
        let size = (d - c) / (b - a);
        assert!(size.min_element() > 0.7 && size.max_element() < 1.7, "{name}: {size}");
    }
}

/// However near the ground leaves hang.
#[test]
fn a_shell_of_a_small_tree_stays_closed_above_the_ground() {
    for name in SPECIES {
        for height_m in [0.5, 1.0, 2.0, 4.0] {
            let mut s = leaves(&grown_to(name, Some(height_m)), FoliageLevel::Shell, None);
            let before = s.triangles();
            s.clear_ground();
            assert_eq!(s.triangles(), before, "{name}, {height_m} m");
            assert_eq!(check::open_edges(&[&s]), 0, "{name}, {height_m} m");
        }
    }
}

/// What one could not see of the wood is not there; of a seedling something stands.
#[test]
fn a_shell_hides_no_wood() {
    for (name, height_m) in SPECIES.into_iter().flat_map(|n| [None, Some(0.1)].map(|h| (n, h))) {
        let (skeleton, species, atlas) = grown_to(name, height_m);
        let of = |foliage| {
            let options = MeshOptions { foliage, ..MeshOptions::HERO };
            build(&skeleton, &species, &atlas, &options, Seed::new(1)).unwrap()
        };
        let tree = of(FoliageLevel::Shell);
        tree.check().unwrap();
        let all = of(FoliageLevel::Cards);
        let wood = |t: &TreeMesh| t.triangles() - t.foliage.triangles();
        assert!(wood(&tree) > 0 && wood(&tree) * 2 < wood(&all), "{name} {height_m:?}");
        let (low, high) = tree.foliage.bounds();
        let middle_m = 0.5 * (low.z + high.z);
        let above = tree.woods().into_iter().flat_map(|w| &w.position).filter(|p| p.z > middle_m);
        assert!(height_m.is_some() || above.count() == 0, "{name}");
    }
}

/// Of its upper three tenths no part is bare that is longer than a twentieth of the tree.
#[test]
fn a_young_tree_has_leaves_up_its_leader() {
    let names = ["larix_sibirica", "picea_abies", "betula_pendula"];
    for (name, height_m) in names.into_iter().flat_map(|n| [0.5f32, 1.0, 2.0].map(|h| (n, h))) {
        let mut tree = grown_to(name, Some(height_m));
        tree.1.foliage = tree.1.foliage_at(height_m);
        let stem = tree.0.axes().of(0).nodes.to_vec();
        let stem: Vec<Vec3> = stem.iter().map(|&i| tree.0.position[i as usize]).collect();
        let near = |p: Vec3| stem.iter().any(|s| s.distance(p) < 0.1 * height_m);
        for level in [FoliageLevel::Cards, FoliageLevel::Geometry] {
            let s = leaves(&tree, level, Some(20_000));
            let corners = s.index.chunks_exact(3);
            let corners = corners.map(|t| [0, 1, 2].map(|k| s.position[t[k] as usize]));
            let spans = corners.filter(|t| near((t[0] + t[1] + t[2]) / 3.0));
            let spans = spans.map(|t| t.map(|p| p.z));
            let mut spans: Vec<[f32; 2]> = spans
                .map(|z| {
                    [z.into_iter().fold(f32::MAX, f32::min), z.into_iter().fold(0.0, f32::max)]
                })
                .collect();
            spans.sort_by(|a, b| b[1].total_cmp(&a[1]));
            let mut low = stem[stem.len() - 1].z;
            let until = 0.7 * low;
            let mut gap = 0.0f32;
            for [from, to] in spans.into_iter().filter(|span| span[1] > until) {
                gap = gap.max(low - to);
                low = low.min(from);
            }
            let told = format!("{name} {height_m} {level:?}: {gap} above {low}");
            assert!(low < until && gap < 0.05 * height_m, "{told}");
        }
    }
}

/// The leader's tip stands, however much twigs hang.
#[test]
fn a_leader_stands() {
    for name in ["larix_sibirica", "picea_abies", "betula_pendula"] {
        let tree = grown(name);
        let higher = |a: Vec3, b: Vec3| if b.z > a.z { b } else { a };
        let s = leaves(&tree, FoliageLevel::Cards, Some(20_000));
        // A card ends in the middle of an edge.
        let edges =
            s.index.as_chunks::<3>().0.iter().flat_map(|&[a, b, c]| [[a, b], [b, c], [c, a]]);
        let ends =
            edges.map(|edge| edge.map(|i| s.position[i as usize])).map(|[a, b]| a.midpoint(b));
        let stem = tree.0.position.iter().copied().reduce(higher).unwrap();
        let way = ends.reduce(higher).unwrap() - stem;
        assert!(way.z > 1.5 * way.truncate().length(), "{name}: {way}");
    }
}

#[test]
fn fewer_twigs_are_larger_ones() {
    let tree = grown("betula_pendula");
    let mean = |budget| {
        let s = leaves(&tree, FoliageLevel::Cards, Some(budget));
        s.area_sq_m() / s.triangles() as f64
    };
    assert!(mean(2_000) > 1.3 * mean(20_000), "{} {}", mean(2_000), mean(20_000));
}

/// A model of one triangle.
fn triangle(name: &str) -> std::sync::Arc<own::Model> {
    std::sync::Arc::new(own::Model {
        name: name.into(),
        position: vec![[0.0; 3], [0.1, 0.5, 0.0], [0.0, 1.0, 0.0]],
        normal: vec![[0.0, 0.0, 1.0]; 3],
        uv: vec![[0.0, 0.0], [1.0, 0.5], [0.0, 1.0]],
        index: vec![0, 1, 2],
        picture: crate::raster::Picture::filled(4, 4, [1, 2, 3, 255]),
        normals: None,
        material: None,
        roughness: None,
        remarks: Vec::new(),
    })
}

/// Cones hang beside the leaves, as long and as high in the crown as is said, and of a smaller budget
/// the same ones remain.
#[test]
fn cones_hang_where_they_are_said_to() {
    let (skeleton, mut species, atlas) = grown("picea_abies");
    let build = |species: &Species, foliage, triangles| {
        let options = MeshOptions { foliage, triangle_budget: triangles, ..MeshOptions::HERO };
        build(&skeleton, species, &atlas, &options, Seed::new(1)).unwrap()
    };
    let without = build(&species, FoliageLevel::Cards, Some(20_000));
    assert!(without.fruit.is_empty());
    species.own_fruit = Some(triangle("cone.obj"));
    species.fruit.length_m = 0.15;
    species.fruit.droop = 0.9;
    species.fruit.from = 0.6;
    species.fruit.per_m = 8.0;
    let with = build(&species, FoliageLevel::Cards, Some(20_000));
    assert!(with.triangles() <= 20_000 && with.fruit.triangles() > 20);
    with.check().unwrap();
    let bears = skeleton.bears_leaves(species.foliage.bearing_radius_m);
    let heights = || (0..skeleton.len()).filter(|&i| bears[i]).map(|i| skeleton.position[i].z);
    let (low, high) = heights().fold((f32::MAX, 0.0f32), |(l, h), z| (l.min(z), h.max(z)));
    for t in with.fruit.position.as_chunks::<3>().0 {
        let [foot, _, tip] = *t;
        assert!((0.05..0.2).contains(&foot.distance(tip)), "{}", foot.distance(tip));
        assert!(tip.z < foot.z, "it hangs");
        assert!(foot.z > low + 0.55 * (high - low), "{} of {low}…{high}", foot.z);
    }
    let fewer = build(&species, FoliageLevel::Cards, Some(600));
    assert!(fewer.fruit.triangles() < with.fruit.triangles());
    assert!(fewer.fruit.position.iter().all(|p| with.fruit.position.contains(p)));
    for level in [FoliageLevel::None, FoliageLevel::Shell, FoliageLevel::Sparse] {
        assert!(build(&species, level, Some(5_000)).fruit.is_empty(), "{level:?}");
    }
}

/// Of a species with as many twigs as may be, cones are as many as is said.
#[test]
fn cones_are_as_many_whatever_the_twigs() {
    let mut tree = grown("picea_abies");
    tree.1.own_fruit = Some(triangle("cone.obj"));
    tree.1.fruit.per_m = 3.0;
    let mut cones = |twigs_per_m: f32| {
        tree.1.foliage.twigs_per_m = twigs_per_m;
        let order = order(&tree, FoliageLevel::Geometry, None);
        fruit::fruit(&tree.0, &order).triangles() as f32
    };
    let (few, many) = (cones(20.0), cones(800.0));
    assert!((0.85..1.15).contains(&(many / few)), "{many} beside {few}");
}

/// A user's twig stands where twigs stand, as long as they are, under the material's picture.
#[test]
fn a_user_s_model_stands_where_twigs_stand() {
    let (skeleton, mut species, _) = grown("quercus_robur");
    species.own_model = Some(triangle("twig.obj"));
    species.foliage.colour = [1, 2, 3];
    let textures = crate::texture::for_species(&species, 64, Seed::new(1));
    assert_eq!(textures.leaf.picture().at(2, 2), [1, 2, 3, 255]);
    let twig_m = species.foliage.twig_length_m;
    let tree = (skeleton, species, textures.atlas);
    for level in [FoliageLevel::Geometry, FoliageLevel::Cards] {
        let s = leaves(&tree, level, None);
        s.check().unwrap();
        assert!(least_cosine(&s) > 0.0);
        for t in s.index.chunks_exact(3) {
            let length = s.position[t[0] as usize].distance(s.position[t[2] as usize]);
            // So slender a model is as large as any may be, give or take a fifth.
            assert!((0.3 * twig_m..3.6 * twig_m).contains(&length), "{length}");
        }
    }
    let few = foliage(&tree.0, &order(&tree, FoliageLevel::Cards, Some(300))).unwrap();
    let more = foliage(&tree.0, &order(&tree, FoliageLevel::Cards, Some(3_000))).unwrap();
    assert!(few.cover < 0.75 && few.cover < more.cover && more.cover <= 1.0, "{}", few.cover);
    assert!(more.twig_scale <= few.twig_scale && few.twig_scale <= 3.0, "{}", few.twig_scale);
    let error = foliage(&tree.0, &order(&tree, FoliageLevel::Cards, Some(0))).unwrap_err();
    assert_eq!(error.message(), "the model twig.obj has 1 triangles, the crown 0");
}

/// However many triangles a model has.
#[test]
fn a_user_s_model_keeps_to_the_budget() {
    let (skeleton, mut species, atlas) = grown("quercus_robur");
    for faces in [2, 3, 24, 100] {
        let mut model = own::Model::clone(&triangle("fan.obj"));
        model.index = model.index.repeat(faces);
        species.own_model = Some(std::sync::Arc::new(model));
        for (level, budget) in [
            (FoliageLevel::Cards, 1_000),
            (FoliageLevel::Cards, 20_000),
            (FoliageLevel::Sparse, 20_000),
            (FoliageLevel::Geometry, 100_000),
        ] {
            let options =
                MeshOptions { foliage: level, triangle_budget: Some(budget), ..MeshOptions::HERO };
            let tree = build(&skeleton, &species, &atlas, &options, Seed::new(1)).unwrap();
            let [all, leaves] = [tree.triangles(), tree.foliage.triangles()];
            assert!(all <= budget, "{level:?}, {faces} faces: {all} of {budget}");
            assert!(leaves > 0, "{level:?}, {faces} faces: {leaves} of {budget}");
        }
    }
}

/// Cards that may not be larger say what they hide of a crown; enough of them, all.
#[test]
fn too_few_cards_say_what_they_hide() {
    let tree = grown_to("quercus_robur", Some(45.0));
    let cover = [100, 400, 20_000].map(|budget| {
        foliage(&tree.0, &order(&tree, FoliageLevel::Cards, Some(budget))).unwrap().cover
    });
    assert!(cover[0] < 0.5 && cover[0] < cover[1] && cover[1] < cover[2], "{cover:?}");
    assert!(cover[2] > 0.9, "{cover:?}");
}

/// Stored once and set at their places, they are the crown that has every leaf.
#[test]
fn twigs_stored_once_make_the_crown_of_all_leaves() {
    for name in ["pinus_sylvestris", "quercus_robur", "sorbus_aucuparia"] {
        let tree = grown_to(name, Some(4.0));
        let all = leaves(&tree, FoliageLevel::Geometry, None);
        const STORED: usize = 40_000;
        let few = order(&tree, FoliageLevel::Geometry, Some(STORED));
        let few = Order { twigs: TwigsAs::Instanced, ..few };
        let made = foliage(&tree.0, &few).unwrap();
        assert!(made.surface.is_empty() && made.twig_scale == 1.0, "{name}");
        made.twigs.iter().for_each(|twigs| twigs.check().unwrap());
        let sum = |of: &dyn Fn(&Twigs) -> usize| made.twigs.iter().map(of).sum::<usize>();
        let [stored, shown] = [sum(&|t| t.form.triangles()), sum(&Twigs::shown_triangles)];
        assert!(0 < stored && stored <= STORED, "{name}: {stored}");
        assert!(shown > STORED && shown == all.triangles(), "{name}: {shown}");
        let area = made.twigs.iter().map(|t| {
            let one_sq_m = t.form.area_sq_m();
            t.places.iter().map(|p| one_sq_m * f64::from(p.scale * p.scale)).sum::<f64>()
        });
        let (area, whole) = (area.sum::<f64>(), all.area_sq_m());
        // A form serves twigs of other sizes, whose leaves differ less than they.
        assert!((area / whole - 1.0).abs() < 0.1, "{name}: {area} of {whole}");
        let none = Order { budget: Some(100), ..few };
        let error = foliage(&tree.0, &none).unwrap_err();
        assert!(error.message().starts_with("a twig with all its leaves has "), "{error:?}");
        let crown = TreeMesh { twigs: made.twigs, ..TreeMesh::default() };
        let (low, high) = crown.bounds();
        let off = (low - all.bounds().0).abs().max((high - all.bounds().1).abs());
        assert!(off.max_element() < 0.1, "{name}: {off}");
    }
}

/// Distance of a point from a triangle.
fn off(p: Vec3, [a, b, c]: [Vec3; 3]) -> f32 {
    let edge = |from: Vec3, to: Vec3| {
        let way = to - from;
        let t = ((p - from).dot(way) / way.length_squared().max(1e-20)).clamp(0.0, 1.0);
        p.distance(from + way * t)
    };
    let normal = (b - a).cross(c - a).normalize_or_zero();
    let is_above = [(a, b), (b, c), (c, a)]
        .iter()
        .all(|(from, to)| (*to - *from).cross(p - *from).dot(normal) >= 0.0);
    let edges = edge(a, b).min(edge(b, c)).min(edge(c, a));
    if is_above { edges.min((p - a).dot(normal).abs()) } else { edges }
}

type Boxed = GeomWithData<Rectangle<[f32; 3]>, [Vec3; 3]>;

fn boxed(triangle: [Vec3; 3]) -> Boxed {
    let [a, b, c] = triangle;
    let about = Rectangle::from_corners(a.min(b).min(c).into(), a.max(b).max(c).into());
    GeomWithData::new(about, triangle)
}

fn from_wood(wood: &RTree<Boxed>, p: Vec3) -> f32 {
    let mut least = f32::INFINITY;
    for (triangle, box_sq) in wood.nearest_neighbor_iter_with_distance_2(p.into()) {
        if box_sq.sqrt() >= least {
            break;
        }
        least = least.min(off(p, triangle.data));
    }
    least
}

/// However crowded the feet of branches are along a shoot.
#[test]
fn twigs_leaf_by_leaf_begin_on_wood() {
    for name in ["pinus_sylvestris", "quercus_robur"] {
        let species = species::load(name).unwrap();
        let detail = Detail { max_nodes: 8_000, attractor_spacing_m: None };
        let target = Target::FromSpecies { height_m: None };
        let skeleton = grow(&species, target, detail, Seed::new(1)).unwrap();
        let atlas = crate::texture::tests::leafy(&species, 64, Seed::new(1)).atlas;
        let options = MeshOptions {
            foliage: FoliageLevel::Geometry,
            twigs: TwigsAs::Instanced,
            triangle_budget: Some(500_000),
            ..MeshOptions::HERO
        };
        let tree = build(&skeleton, &species, &atlas, &options, Seed::new(1)).unwrap();
        tree.check().unwrap();
        let corners = |s: &Surface| -> Vec<[Vec3; 3]> {
            let triangles = s.index.as_chunks::<3>().0.iter();
            triangles.map(|t| t.map(|i| s.position[i as usize])).collect()
        };
        let wood = tree.woods().into_iter().flat_map(corners);
        let wood = RTree::bulk_load(wood.map(boxed).collect());
        let feet: Vec<Vec3> = tree
            .twigs
            .iter()
            .flat_map(|t| t.places.iter().map(|p| p.position))
            .step_by(7)
            .collect();
        let mut far: Vec<f32> = feet.par_iter().map(|p| from_wood(&wood, *p)).collect();
        far.sort_by(f32::total_cmp);
        let at = |share: f32| far[(share * (far.len() - 1) as f32) as usize];
        assert!(far.len() > 300, "{name}: {}", far.len());
        assert!(at(0.97) < 0.02 && at(1.0) < 0.15, "{name}: {} {} m", at(0.97), at(1.0));
    }
}

/// A user's model is stored once, and stands where its copies would.
#[test]
fn a_user_s_model_is_stored_once() {
    let (skeleton, mut species, _) = grown("quercus_robur");
    species.own_model = Some(triangle("twig.obj"));
    let atlas = crate::texture::tests::leafy(&species, 64, Seed::new(1)).atlas;
    let tree = (skeleton, species, atlas);
    let copies = leaves(&tree, FoliageLevel::Cards, None);
    let once = order(&tree, FoliageLevel::Cards, Some(1));
    let made = foliage(&tree.0, &Order { twigs: TwigsAs::Instanced, ..once }).unwrap();
    let [twigs] = &made.twigs[..] else { panic!("{} forms", made.twigs.len()) };
    assert_eq!(twigs.form.triangles(), 1);
    let set = twigs.places.iter().flat_map(|at| twigs.form.position.iter().map(|p| at.of(*p)));
    let set: Vec<Vec3> = set.collect();
    assert_eq!(set.len(), copies.position.len());
    let off = set.iter().zip(&copies.position).map(|(a, b)| a.distance(*b)).fold(0.0, f32::max);
    assert!(off < 1e-4, "{off} m");
}

/// Without pictures leaves are as large as with them, not as twigs.
#[test]
fn leaves_are_as_large_without_pictures() {
    for name in ["quercus_robur", "betula_pendula", "sorbus_aucuparia"] {
        let (skeleton, species, _) = grown_to(name, Some(3.0));
        // The smallest pictures there are: coarser ones blur the edge of a leaf.
        let atlas = crate::texture::tests::leafy(&species, 512, Seed::new(1)).atlas;
        let plain = crate::texture::plain(&species).atlas;
        let area = |atlas: Atlas| {
            let tree = (skeleton.clone(), species.clone(), atlas);
            let s = leaves(&tree, FoliageLevel::Geometry, None);
            let at = |i: u32| s.position[i as usize];
            let areas = s
                .index
                .as_chunks::<3>()
                .0
                .iter()
                .map(|&[a, b, c]| 0.5 * (at(b) - at(a)).cross(at(c) - at(a)).length());
            areas.fold(0.0, f32::max)
        };
        let (with, without) = (area(atlas), area(plain));
        assert!(without < 1.6 * with && with < 1.6 * without, "{name}: {with} and {without}");
    }
}

/// As blades, against those of summer.
#[test]
fn few_leaves_hang_on_through_the_winter() {
    for (name, kept) in [("quercus_robur", 0.08), ("tilia_cordata", 0.05)] {
        let species = species::load(name).unwrap();
        let detail = Detail { max_nodes: 16_000, attractor_spacing_m: None };
        let target = Target::FromSpecies { height_m: None };
        let skeleton = grow(&species, target, detail, Seed::new(3)).unwrap();
        let atlas = crate::texture::tests::leafy(&species, 64, Seed::new(1)).atlas;
        let wood = atlas.wood();
        let mut tree = (skeleton, species, atlas);
        let mut blades = |kept: f32| {
            tree.1.foliage.kept = kept;
            let s = leaves(&tree, FoliageLevel::Geometry, Some(1_000_000));
            let is_blade = |t: &&[u32]| t.iter().any(|&i| s.uv[i as usize] != wood);
            let area = |t: &[u32]| {
                let [a, b, c] = [0, 1, 2].map(|k| s.position[t[k] as usize]);
                0.5 * (b - a).cross(c - a).length()
            };
            s.index.chunks_exact(3).filter(is_blade).map(area).sum::<f32>()
        };
        let share = blades(kept) / blades(1.0);
        assert!((0.3 * kept..2.0 * kept).contains(&share), "{name}: {share} of the leaves");
    }
}

/// On the cards of a tree seen from near: no leaf is much longer than its neighbour, no needle twice as long.
#[test]
fn leaves_on_cards_are_of_one_size() {
    for name in
        ["corylus_avellana", "salix_caprea", "populus_tremula", "pinus_sylvestris", "picea_abies"]
    {
        let species = species::load(name).unwrap();
        let target = Target::FromSpecies { height_m: None };
        let skeleton = grow(&species, target, Detail::HERO, Seed::new(1)).unwrap();
        let atlas = crate::texture::tests::leafy(&species, 64, Seed::new(1)).atlas;
        let tree = build(&skeleton, &species, &atlas, &MeshOptions::HERO, Seed::new(1)).unwrap();
        let s = &tree.foliage;
        // Of every triangle, over the size that leaves have in nature.
        let size = |t: &[u32]| {
            let [a, b, c] = [0, 1, 2].map(|k| t[k] as usize);
            let middle = (s.uv[a] + s.uv[b] + s.uv[c]) / 3.0;
            let is_in = |c: &&Cell| middle.cmpge(c.min).all() && middle.cmple(c.max).all();
            let cell = atlas.cells().iter().find(is_in).unwrap();
            let sides = [(a, b), (b, c), (c, a)];
            let m: f32 = sides.map(|(i, j)| s.position[i].distance(s.position[j])).iter().sum();
            let uv: f32 = sides.map(|(i, j)| s.uv[i].distance(s.uv[j])).iter().sum();
            m / uv * (cell.max.x - cell.min.x) / cell.size_m
        };
        let is_stalk = |t: &&[u32]| t.iter().all(|&i| s.uv[i as usize] == atlas.wood());
        let mut sizes: Vec<f32> =
            s.index.chunks_exact(3).filter(|t| !is_stalk(t)).map(size).collect();
        sizes.sort_by(f32::total_cmp);
        let [low, high] = [0.1, 0.9].map(|share| sizes[(share * sizes.len() as f32) as usize]);
        // Of leaves there are pictures of three scales.
        let [least, most, over] =
            if species.foliage.shape.is_needle() { [0.5, 1.8, 2.0] } else { [0.6, 1.5, 1.7] };
        assert!(low > least && high < most && high < over * low, "{name}: {low} to {high}");
    }
}

/// Half of them at least, of what is looked at from near.
#[test]
fn leafy_twigs_hang_near_wood() {
    const APART_M: f32 = 0.04;
    for (name, most_m) in [("quercus_robur", 0.25), ("betula_pendula", 0.05), ("picea_abies", 0.06)]
    {
        let species = species::load(name).unwrap();
        let target = Target::FromSpecies { height_m: None };
        let skeleton = grow(&species, target, Detail::HERO, Seed::new(1)).unwrap();
        let atlas = crate::texture::tests::leafy(&species, 512, Seed::new(1)).atlas;
        let tree = build(&skeleton, &species, &atlas, &MeshOptions::HERO, Seed::new(1)).unwrap();
        let mut wood = Vec::new();
        for s in tree.woods() {
            for t in s.index.chunks_exact(3) {
                let corner = [0, 1, 2].map(|k| s.position[t[k] as usize]);
                for k in 0..3 {
                    let (a, b) = (corner[k], corner[(k + 1) % 3]);
                    let steps = (a.distance(b) / APART_M).ceil().max(1.0);
                    wood.extend(
                        (0..steps as u32).map(|i| <[f32; 3]>::from(a.lerp(b, i as f32 / steps))),
                    );
                }
            }
        }
        let wood = RTree::bulk_load(wood);
        // Left and right of the foot and of the tip, after the middle of those that are raised; stalks come last.
        let leaves = &tree.foliage;
        let corners = if species.foliage.shape == LeafShape::Needle { 5 } else { 4 };
        let end = leaves.uv.iter().position(|uv| *uv == atlas.wood());
        let end = end.unwrap_or(leaves.uv.len());
        assert_eq!(end % corners, 0, "{name}");
        let cards = leaves.position[..end].chunks_exact(corners).step_by(4);
        let cards = cards.map(|card| &card[corners - 4..]);
        let gap = |p: &Vec3| {
            let nearest = wood.nearest_neighbor((*p).into()).expect("wood");
            p.distance(Vec3::from(*nearest))
        };
        let mut gaps: Vec<f32> = cards.map(|card| gap(&card[0].midpoint(card[1]))).collect();
        gaps.sort_by(f32::total_cmp);
        let half_m = gaps[gaps.len() / 2];
        assert!(half_m < most_m, "{name}: half the twigs are {half_m} m and more from wood");
    }
}

#[test]
fn wood_has_what_cards_leave_over() {
    for name in ["corylus_avellana", "larix_sibirica"] {
        let species = species::load(name).unwrap();
        let target = Target::FromSpecies { height_m: None };
        let detail = Detail { max_nodes: 30_000, attractor_spacing_m: None };
        let skeleton = grow(&species, target, detail, Seed::new(1)).unwrap();
        let atlas = crate::texture::tests::leafy(&species, 64, Seed::new(1)).atlas;
        let options = MeshOptions { triangle_budget: Some(80_000), ..MeshOptions::HERO };
        let tree = build(&skeleton, &species, &atlas, &options, Seed::new(1)).unwrap();
        let [wood, all] = [tree.wood_triangles(), tree.triangles()];
        assert!(all <= 80_000 && wood > 42_000, "{name}: {wood} of {all}");
    }
}

/// A budget keeps the thin branches of a spire's top beside the thick ones below, and cards on them.
#[test]
fn a_spire_is_as_wide_near_its_top_at_any_budget() {
    let (skeleton, species, atlas) = grown_with("picea_abies", None, 3_333, 1);
    let widths_m = |budget: Option<usize>| {
        let options = MeshOptions { triangle_budget: budget, ..MeshOptions::HERO };
        let tree = build(&skeleton, &species, &atlas, &options, Seed::new(1)).unwrap();
        let high_m = tree.bounds().1.z;
        [0.75, 0.8, 0.85, 0.9].map(|from| {
            let is_in = |p: &&glam::Vec3| (from..from + 0.05).contains(&(p.z / high_m));
            let out = tree.foliage.position.iter().filter(is_in).map(|p| p.truncate().length());
            let mut out: Vec<f32> = out.collect();
            out.sort_by(f32::total_cmp);
            out[out.len() * 95 / 100]
        })
    };
    let whole = widths_m(None);
    for budget in [6_000, 20_000] {
        let few = widths_m(Some(budget));
        let least = few.iter().zip(whole).map(|(few, whole)| few / whole).fold(1.0, f32::min);
        assert!(least > 0.88, "{budget}: {few:?} of {whole:?}");
    }
}

/// Few cards hang on wood that a budget left out, further from the rest, and from stalks, than they are long.
#[test]
fn cards_hang_on_wood_that_is_there() {
    for name in ["larix_sibirica", "betula_pendula"] {
        let (skeleton, species, atlas) = grown_with(name, None, 3_333, 1);
        let tree = build(&skeleton, &species, &atlas, &MeshOptions::HERO, Seed::new(1)).unwrap();
        let places = tree.woods().into_iter().flat_map(|s| &s.position);
        let of_leaves = tree.foliage.position.iter().zip(&tree.foliage.uv);
        let of_stalks = of_leaves.filter(|(_, uv)| **uv == atlas.wood()).map(|(at, _)| at);
        let mut wood: Vec<glam::Vec3> = places.chain(of_stalks).copied().collect();
        wood.sort_by(|a, b| a.z.total_cmp(&b.z));
        const FAR_M: f32 = 0.25;
        let is_near = |p: &glam::Vec3| {
            let from = wood.partition_point(|w| w.z < p.z - FAR_M);
            let near = wood[from..].iter().take_while(|w| w.z < p.z + FAR_M);
            near.into_iter().any(|w| w.distance(*p) < FAR_M)
        };
        // Triangles of a card follow each other, and share corners with those before.
        let (mut cards, mut afloat) = (0.0, 0.0);
        let mut until = 0;
        let mut card: Vec<glam::Vec3> = Vec::new();
        let leaves = &tree.foliage;
        let is_stalk = |t: &&[u32]| t.iter().all(|&i| leaves.uv[i as usize] == atlas.wood());
        for t in leaves.index.chunks_exact(3).filter(|t| !is_stalk(t)) {
            if t.iter().all(|&i| i >= until) && !card.is_empty() {
                cards += 1.0;
                afloat += f32::from(u8::from(!card.iter().any(is_near)));
                card.clear();
            }
            until = until.max(t[0].max(t[1]).max(t[2]) + 1);
            card.extend(t.iter().map(|&i| leaves.position[i as usize]));
        }
        assert!(cards > 2_000.0 && afloat / cards < 0.14, "{name}: {afloat} of {cards}");
    }
}

/// From healthy to dying a tree has ever fewer leaves; one that died this year, of whatever, fewer than one that is
/// strongly weakened; an old dead one has none.
#[test]
fn leaves_get_fewer_as_a_tree_declines() {
    use crate::skeleton::decline::in_condition;
    use crate::species::state::{Condition, State};
    for name in ["larix_sibirica", "betula_pendula", "picea_abies", "pinus_sylvestris"] {
        let (skeleton, species, atlas) = grown_to(name, Some(8.0));
        for level in [FoliageLevel::Geometry, FoliageLevel::Cards] {
            let area_sq_m = |condition| {
                let s = in_condition(&skeleton, species.kind, condition, Seed::new(1));
                let share = State { condition, ..State::default() }.leaf_share(&species);
                let tree = (s, species.clone(), atlas.clone());
                let order = Order { share, ..order(&tree, level, None) };
                foliage(&tree.0, &order).unwrap().surface.area_sq_m()
            };
            let areas = Condition::ALL.map(area_sq_m);
            assert!(areas[..4].windows(2).all(|w| w[1] < w[0]), "{name}, {level:?}: {areas:?}");
            assert!(areas[4] < areas[2], "{name}, {level:?}: {areas:?}");
            assert!(areas[3].min(areas[4]) > 0.0, "{name}, {level:?}: some still hang");
            assert_eq!(areas[5], 0.0, "{name}, {level:?}");
        }
    }
}

/// Branches that have dried bear bare twigs of the picture's own for them, which hang on dead wood, within the
/// budget; those of a healthy tree and of an old dead one, none.
#[test]
fn dry_branches_bear_bare_twigs() {
    use crate::skeleton::decline::in_condition;
    use crate::species::state::{Condition, Season, State};
    for (name, season) in [
        ("picea_abies", Season::Summer),
        ("quercus_robur", Season::Summer),
        ("quercus_robur", Season::Winter),
    ] {
        let (skeleton, own, _) = grown_with(name, None, 6_000, 3);
        let made = |condition, budget| {
            let state = State { condition, season };
            let species = state.look(&own, Seed::new(1));
            let s = in_condition(&skeleton, own.kind, condition, Seed::new(1));
            let atlas = crate::texture::tests::leafy(&species, 64, Seed::new(1)).atlas;
            let options = MeshOptions {
                triangle_budget: Some(budget),
                leaf_share: state.leaf_share(&own),
                ..MeshOptions::HERO
            };
            let tree = build(&s, &species, &atlas, &options, Seed::new(1)).unwrap();
            tree.check().unwrap();
            assert!(tree.triangles() <= budget, "{name}, {condition:?}");
            (s, tree, atlas)
        };
        for condition in [Condition::Healthy, Condition::OldDead] {
            assert!(made(condition, 20_000).1.dry.is_empty(), "{name}, {condition:?}");
        }
        for budget in [3_000, 20_000] {
            let (s, tree, atlas) = made(Condition::StronglyWeakened, budget);
            let what = format!("{name}, {season:?}, {budget}");
            let share = tree.dry.triangles() as f32 / tree.foliage.triangles() as f32;
            assert!((0.1..1.1).contains(&share), "{what}: {share}");
            let dead: Vec<Vec3> =
                (0..s.len()).filter(|&i| s.dead[i]).map(|i| s.position[i]).collect();
            let near = |p: &&Vec3| dead.iter().any(|d| d.distance(**p) < 1.5);
            let hung = tree.dry.position.iter().filter(near).count();
            assert!(hung as f32 > 0.99 * tree.dry.position.len() as f32, "{what}: {hung}");
            if season == Season::Summer {
                let dry = atlas.dry().unwrap();
                let cell = &dry.cells()[0];
                let shows = |uv: &&Vec2| {
                    **uv == atlas.wood()
                        || (uv.cmpge(cell.min - 1e-4) & uv.cmple(cell.max + 1e-4)).all()
                };
                assert_eq!(tree.dry.uv.iter().filter(shows).count(), tree.dry.uv.len(), "{what}");
                assert!(!tree.foliage.uv.iter().any(|uv| *uv != atlas.wood() && shows(&uv)));
            }
        }
    }
}

/// Cards of one colour all over would be a crown of squares.
#[test]
fn without_pictures_bare_twigs_have_no_cards() {
    use crate::skeleton::decline::in_condition;
    use crate::species::state::Condition;
    let mut tree = grown_with("betula_pendula", None, 3_000, 3);
    tree.1.foliage = tree.1.foliage.dry();
    tree.0 = in_condition(&tree.0, tree.1.kind, Condition::Weakened, Seed::new(1));
    let plain = crate::texture::plain(&tree.1).atlas;
    for (atlas, has_cards) in [(&tree.2, true), (&plain, false)] {
        let made = build(&tree.0, &tree.1, atlas, &MeshOptions::HERO, Seed::new(1)).unwrap();
        assert_eq!([made.foliage.is_empty(), made.dry.is_empty()], [!has_cards; 2]);
        assert!(made.triangles() > 10_000, "branches take what twigs leave: {}", made.triangles());
    }
    let single = MeshOptions { foliage: FoliageLevel::Geometry, ..MeshOptions::HERO };
    let made = build(&tree.0, &tree.1, &plain, &single, Seed::new(1)).unwrap();
    assert!(!made.foliage.is_empty(), "leaf by leaf they have their own form");
}
