use super::stalk::nearest;
use super::*;
use crate::skeleton::{Detail, Target, grow};
use crate::species;
use crate::texture::atlas::Cell;

/// The middles of a stalk's ends, and its width there.
#[derive(Debug, PartialEq)]
struct Stalk {
    ends: [Vec3; 2],
    wide_m: [f32; 2],
}

/// Those of cards: triangles of three corners that follow each other, and strips of four.
fn stalks_of(s: &Surface, wood: Vec2) -> Vec<Stalk> {
    let is_wood = |t: &&[u32; 3]| t.iter().all(|&i| s.uv[i as usize] == wood);
    let stalk = |t: &[u32; 3]| {
        let mut t = t.map(|i| i as usize);
        t.sort_unstable();
        let at = |a: usize, b: usize| (s.position[a], s.position[b]);
        let first = t[0];
        let ends = match [t[1] - first, t[2] - first] {
            [1, 2] => [at(first, first + 1), at(first + 2, first + 2)],
            [1, 3] => [at(first, first + 1), at(first + 2, first + 3)],
            _ => return None,
        };
        let wide_m = ends.map(|(a, b)| a.distance(b));
        Some(Stalk { ends: ends.map(|(a, b)| a.midpoint(b)), wide_m })
    };
    s.index.as_chunks::<3>().0.iter().filter(is_wood).filter_map(stalk).collect()
}

/// Where one springs from another, that is as thick at least, and both go on to what they hold.
#[test]
fn stalks_that_spring_from_each_other_do_not_end_in_points() {
    for (name, season) in
        [("populus_tremula", 1.0), ("tilia_cordata", 1.0), ("betula_pendula", 0.0)]
    {
        let mut species = species::load(name).unwrap();
        species.foliage.kept = season;
        let target = Target::FromSpecies { height_m: None };
        let skeleton = grow(&species, target, Detail::HERO, Seed::new(1)).unwrap();
        let atlas = crate::texture::tests::leafy(&species, 64, Seed::new(1)).atlas;
        let tree = build(&skeleton, &species, &atlas, &MeshOptions::HERO, Seed::new(1)).unwrap();
        let stalks = stalks_of(&tree.foliage, atlas.wood());
        let mut joints = 0;
        for own in &stalks {
            let carrier = |other: &&Stalk| {
                let [a, b] = other.ends;
                *other != own
                    && a.distance(own.ends[0]) > 1e-3
                    && nearest(own.ends[0], a, b).distance(own.ends[0]) < 1e-4
            };
            for other in stalks.iter().filter(carrier) {
                let [a, b] = other.ends;
                let share = own.ends[0].distance(a) / a.distance(b);
                let there_m = other.wide_m[0] + (other.wide_m[1] - other.wide_m[0]) * share;
                assert!(own.wide_m[0] < 1.01 * there_m, "{name}: {own:?} on {other:?}");
                joints += 1;
            }
        }
        assert!(joints > 50, "{name}: {joints}");
        let least_m = stalks.iter().flat_map(|s| s.wide_m).fold(f32::INFINITY, f32::min);
        assert!(season == 0.0 || least_m >= 0.0039, "{name}: {least_m}");
    }
}

/// No leaves hide where they hang.
#[test]
fn bare_twigs_have_stalks_from_wood_that_is_meshed() {
    for name in ["quercus_robur", "larix_sibirica", "betula_pendula"] {
        let mut species = species::load(name).unwrap();
        let detail = Detail { max_nodes: 6_000, attractor_spacing_m: None };
        let target = Target::FromSpecies { height_m: None };
        let skeleton = grow(&species, target, detail, Seed::new(3)).unwrap();
        species.foliage.kept = 0.0;
        let atlas = crate::texture::tests::leafy(&species, 64, Seed::new(1)).atlas;
        let options = MeshOptions { triangle_budget: Some(12_000), ..MeshOptions::FOREST };
        let tree = build(&skeleton, &species, &atlas, &options, Seed::new(1)).unwrap();
        tree.check().unwrap();
        assert!(tree.triangles() <= 12_000);
        let shoot = |n: usize| {
            let from = skeleton.parent_of(n as u32).map_or(n, |p| p as usize);
            [from, n].map(|n| skeleton.position[n])
        };
        let meshed: Vec<[Vec3; 2]> =
            (0..skeleton.len()).filter(|&n| tree.is_meshed[n]).map(shoot).collect();
        assert!(meshed.len() < skeleton.len(), "{name}: all branches are meshed");
        let twigs = &tree.foliage;
        let stalks = stalks_of(twigs, atlas.wood());
        // A stalk has an end at the foot of its card: below the middle of its picture.
        let cards = twigs.uv.iter().position(|uv| *uv == atlas.wood()).unwrap() / 4;
        assert_eq!(cards, stalks.len(), "{name}: a low row and a high one each");
        let base = |card: usize| {
            let [uv, at] = [&twigs.uv, &twigs.uv].map(|c| &c[4 * card..4 * card + 4]);
            let places = &twigs.position[4 * card..4 * card + 4];
            let within = |c: &&Cell| at.iter().all(|uv| uv.clamp(c.min, c.max) == *uv);
            let cell = atlas.cells().iter().find(within).unwrap();
            let middle = |row: usize| {
                let [l, r] = [2 * row, 2 * row + 1];
                let share = (cell.min.midpoint(cell.max).x - uv[l].x) / (uv[r].x - uv[l].x);
                places[l].lerp(places[r], if share.is_finite() { share } else { 0.0 })
            };
            let below = (cell.min.y - uv[0].y) / (uv[2].y - uv[0].y);
            middle(0).lerp(middle(1), below)
        };
        let bases: Vec<Vec3> = (0..cards).map(base).collect();
        let away_m = |p: Vec3| bases.iter().map(|b| b.distance(p)).fold(f32::INFINITY, f32::min);
        let at_wood =
            |foot: Vec3| meshed.iter().any(|[a, b]| nearest(foot, *a, *b).distance(foot) < 1e-3);
        let at_stalk = |foot: Vec3, own: &Stalk| {
            let near = |s: &&Stalk| nearest(foot, s.ends[0], s.ends[1]).distance(foot) < 1e-3;
            stalks.iter().filter(|other| *other != own).any(|other| near(&other))
        };
        // A triangle is wide at the one end or the other.
        let ways_of = |own: &Stalk| {
            let [a, b] = own.ends;
            let is_strip = own.wide_m[1] > 0.0;
            [([a, b], true), ([b, a], !is_strip)]
                .into_iter()
                .filter_map(|(way, may)| may.then_some(way))
        };
        // Sunk tips move the middle of a card.
        let hangs = |own: &&Stalk| {
            ways_of(own).any(|[foot, tip]| {
                let is_short = foot.distance(tip) < 0.021;
                away_m(tip) < 0.02 && (is_short || at_wood(foot) || at_stalk(foot, own))
            })
        };
        let afloat = stalks.iter().filter(|own| !hangs(own)).count();
        assert!(stalks.len() > 100 && afloat == 0, "{name}: {afloat} of {}", stalks.len());
        let long = |[foot, tip]: &[Vec3; 2]| foot.distance(*tip) > 0.021;
        let ways: Vec<[Vec3; 2]> = stalks.iter().flat_map(ways_of).filter(long).collect();
        // No more of them fan out from one place than shoots do.
        let beside = |own: Vec3| ways.iter().filter(|w| w[0].distance(own) < 1e-3).count();
        let most = ways.iter().map(|way| beside(way[0])).max().unwrap();
        assert!(most <= 8, "{name}: {most} stalks from one place");
        species.foliage.kept = 1.0;
        let leafy = build(&skeleton, &species, &atlas, &options, Seed::new(1)).unwrap();
        let leaves = &leafy.foliage;
        let few = stalks_of(leaves, atlas.wood()).len();
        assert!(3 * few < stalks.len(), "{name}: leaves hide where {few} hang");
        assert!(leafy.wood_triangles() < tree.wood_triangles());
    }
}

/// A crown for which the budget is small: few of its shoots are meshed, and leaves do not hide that.
#[test]
fn no_card_of_a_large_tree_hangs_in_the_air() {
    let species = species::load("quercus_robur").unwrap();
    let detail = Detail { max_nodes: 6_000, attractor_spacing_m: None };
    let target = Target::FromSpecies { height_m: Some(45.0) };
    let skeleton = grow(&species, target, detail, Seed::new(3)).unwrap();
    let atlas = crate::texture::tests::leafy(&species, 64, Seed::new(1)).atlas;
    let options = MeshOptions {
        triangle_budget: Some(20_000),
        wind: Some(WindProfile::Unity),
        ..MeshOptions::FOREST
    };
    let tree = build(&skeleton, &species, &atlas, &options, Seed::new(1)).unwrap();
    tree.check().unwrap();
    assert!((18_500..=20_000).contains(&tree.triangles()));
    let leaves = &tree.foliage;
    let faces = leaves.index.as_chunks::<3>().0.iter().map(|t| t.map(|i| i as usize));
    let is_stalk = |t: &[usize; 3]| t.iter().all(|&i| leaves.uv[i] == atlas.wood());
    let (stalks, cards): (Vec<_>, Vec<_>) = faces.partition(is_stalk);
    let own = stalks_of(leaves, atlas.wood());
    assert!(own.len() > 50 && 4 * own.len() < cards.len(), "{}", own.len());
    let shoots = (1..skeleton.len()).filter(|&n| tree.is_meshed[n]).map(|n| {
        let from = skeleton.parent_of(n as u32).unwrap() as usize;
        [from, n].map(|n| skeleton.position[n])
    });
    let corners = |t: &[usize; 3]| t.map(|i| leaves.position[i]);
    let of_stalks = own.iter().map(|stalk| stalk.ends);
    let ways: Vec<[Vec3; 2]> = shoots.chain(of_stalks).collect();
    // Of two faces each.
    let (cards, rest) = cards.as_chunks::<2>();
    assert!(rest.is_empty());
    for card in cards {
        let edges = card.iter().map(corners).flat_map(|[a, b, c]| [[a, b], [b, c], [c, a]]);
        let size_m = edges.clone().map(|[a, b]| a.distance(b)).fold(0.0, f32::max);
        let near = |at: Vec3| ways.iter().map(move |[p, q]| nearest(at, *p, *q).distance(at));
        let away_m = edges.flat_map(|[a, b]| near(a).chain(near(a.midpoint(b))));
        let away_m = away_m.fold(f32::INFINITY, f32::min);
        assert!(away_m < 0.7 * size_m, "{size_m} m long, {away_m} m away");
    }
    // A stalk holds a card to wood: it does not flutter.
    assert!(stalks.iter().flatten().all(|&i| leaves.wind[i][1] == 0));
}
