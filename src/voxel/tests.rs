use std::collections::BTreeMap;

use glam::Vec3;
use proptest::prelude::*;

use super::*;
use crate::seed::Seed;

fn cloud(n: usize, extent_m: f32) -> Vec<Vec3> {
    let mut draws = Seed::new(3).draws();
    (0..n)
        .map(|_| {
            let mut along = || draws.between(-extent_m, extent_m);
            Vec3::new(along(), along(), along() * 0.3)
        })
        .collect()
}

proptest! {
    #[test]
    fn every_point_is_in_exactly_one_voxel(
        points in prop::collection::vec(
            (-50.0f32..50.0, -50.0f32..50.0, -5.0f32..40.0).prop_map(Vec3::from), 1..200),
        size_m in 0.05f32..20.0,
    ) {
        let tree = VoxelOctree::build(&points, size_m).unwrap();
        prop_assert_eq!(tree.check(), Ok(()));
        let mut expected: BTreeMap<VoxelIndex, u32> = BTreeMap::new();
        for p in &points {
            let index = tree.index_of(*p).unwrap();
            *expected.entry(index).or_default() += 1;
            let corner = tree.corner_of(index);
            let slack = Vec3::splat(1e-5);
            prop_assert!((*p - corner).cmpge(-slack).all());
            prop_assert!((*p - corner).cmple(slack + size_m).all());
        }
        let found: BTreeMap<VoxelIndex, u32> = tree.iter().map(|v| (v.index, v.count)).collect();
        prop_assert_eq!(&found, &expected);
        prop_assert_eq!(tree.len(), expected.len());
        prop_assert_eq!(tree.counts().iter().sum::<u32>() as usize, points.len());
        let centres = centres_of_mass(&points, size_m);
        prop_assert_eq!(tree.centres_of_mass(), centres.as_slice());
        // Empty cubes are empty, and hold the place asked for.
        for index in expected.keys().take(20) {
            for l in index.l.saturating_sub(2)..index.l + 3 {
                let near = VoxelIndex { l, ..*index };
                match tree.place(near) {
                    Place::Occupied(_) => prop_assert!(expected.contains_key(&near)),
                    Place::Empty { edge } => {
                        let cube = |v: VoxelIndex| (v.r / edge, v.c / edge, v.l / edge);
                        prop_assert!(expected.keys().all(|v| cube(*v) != cube(near)));
                    }
                }
            }
        }
    }

    #[test]
    fn neighbours_are_those_a_search_finds(
        points in prop::collection::vec(
            (0.0f32..6.0, 0.0f32..6.0, 0.0f32..6.0).prop_map(Vec3::from), 1..120),
    ) {
        let tree = VoxelOctree::build(&points, 1.0).unwrap();
        let all: Vec<Voxel> = tree.iter().collect();
        for voxel in &all {
            let near = |a: u32, b: u32| a.abs_diff(b) <= 1;
            let mut expected: Vec<VoxelIndex> = all.iter().map(|v| v.index).filter(|i| {
                *i != voxel.index && near(i.r, voxel.index.r) && near(i.c, voxel.index.c)
                    && near(i.l, voxel.index.l)
            }).collect();
            expected.sort_by_key(|i| (i.l, i.c, i.r));
            let found: Vec<VoxelIndex> = tree.neighbours(voxel.index).map(|v| v.index).collect();
            prop_assert_eq!(found, expected);
        }
    }

    #[test]
    fn a_crown_spans_four_to_ten_cells(density in 0.01f32..10_000.0, crown_m in 0.5f32..30.0) {
        let cells = crown_m / choose_size_m(density, crown_m);
        prop_assert!((3.999..=10.001).contains(&cells), "{cells}");
    }
}

#[test]
fn a_full_cube_has_the_closed_form() {
    // 8³ voxels: 1 + 8 + 64 nodes, every mask full.
    let axis = || (0..8).map(|i| i as f32 + 0.5);
    let points: Vec<Vec3> = axis()
        .flat_map(|x| axis().flat_map(move |y| axis().map(move |z| Vec3::new(x, y, z))))
        .collect();
    let tree = VoxelOctree::build(&points, 1.0).unwrap();
    tree.check().unwrap();
    assert_eq!((tree.depth(), tree.node_count(), tree.len()), (3, 73, 512));
    assert_eq!(tree.sides(), [8; 3]);
    assert!(tree.counts().iter().all(|n| *n == 1));
    for (number, voxel) in tree.iter().enumerate() {
        assert_eq!(morton::encode(voxel.index), number as u64);
        assert_eq!(voxel.centre_of_mass, tree.corner_of(voxel.index) + 0.5);
        let inside = |v: u32| usize::from(v > 0 && v < 7);
        let VoxelIndex { r, c, l } = voxel.index;
        let around = (2 + inside(r)) * (2 + inside(c)) * (2 + inside(l)) - 1;
        assert_eq!(tree.neighbours(voxel.index).count(), around);
    }
}

#[test]
fn an_empty_octant_is_known_as_a_whole() {
    let points = [Vec3::ZERO, Vec3::new(7.5, 7.5, 7.5)];
    let tree = VoxelOctree::build(&points, 1.0).unwrap();
    assert_eq!(tree.place(VoxelIndex { r: 7, c: 0, l: 0 }), Place::Empty { edge: 4 });
    assert_eq!(tree.place(VoxelIndex { r: 3, c: 3, l: 3 }), Place::Empty { edge: 2 });
    assert_eq!(tree.place(VoxelIndex { r: 1, c: 0, l: 0 }), Place::Empty { edge: 1 });
    assert_eq!(tree.place(VoxelIndex { r: 7, c: 7, l: 7 }), Place::Occupied(1));
    assert_eq!(tree.place(VoxelIndex { r: 8, c: 0, l: 0 }), Place::Empty { edge: 1 });
}

#[test]
fn the_centre_of_mass_is_the_mean() {
    let points = [Vec3::new(1.0, 1.0, 1.0), Vec3::new(1.5, 1.25, 1.0), Vec3::new(1.1, 1.5, 1.6)];
    let tree = VoxelOctree::build(&points, 1.0).unwrap();
    let voxel = tree.iter().next().unwrap();
    assert_eq!((tree.len(), voxel.count), (1, 3));
    assert!(voxel.centre_of_mass.distance(Vec3::new(1.2, 1.25, 1.2)) < 1e-6);
}

#[test]
fn a_voxel_stays_where_it_is_when_points_come_and_go() {
    let near = [Vec3::new(5.3, 2.2, 1.1), Vec3::new(5.6, 2.4, 1.2)];
    let alone = centres_of_mass(&near, 0.5);
    let mut more = near.to_vec();
    more.push(Vec3::new(-3.21, -7.77, 0.13));
    let together = centres_of_mass(&more, 0.5);
    assert!(alone.iter().all(|centre| together.contains(centre)));
}

#[test]
fn extreme_clouds() {
    let one = VoxelOctree::build(&[Vec3::new(-3.0, 4.0, 5.0)], 0.1).unwrap();
    one.check().unwrap();
    assert_eq!((one.len(), one.depth(), one.sides()), (1, 1, [1; 3]));

    let alike = VoxelOctree::build(&[Vec3::splat(7.0); 1000], 0.1).unwrap();
    alike.check().unwrap();
    assert_eq!((alike.len(), alike.counts()), (1, [1000u32].as_slice()));

    let far = VoxelOctree::build(&[Vec3::ZERO, Vec3::new(200_000.0, 0.0, 0.0)], 0.1).unwrap();
    far.check().unwrap();
    assert_eq!((far.len(), far.depth(), far.node_count()), (2, 21, 41));
    assert!(far.memory_bytes() < 1000);

    let points = [Vec3::ZERO, Vec3::splat(1e6)];
    let error = VoxelOctree::build(&points, 0.1).unwrap_err();
    assert_eq!(error.message(), "voxels of 0.1 m are too small for the extent of the points");
    assert_eq!(centres_of_mass(&points, 0.1).len(), 2);
    assert_eq!(centres_of_mass(&[Vec3::splat(-f32::MAX), Vec3::splat(f32::MAX)], 1.0).len(), 2);

    assert_eq!(centres_of_mass(&[], 1.0), []);
    assert_eq!(centres_of_mass(&[Vec3::NAN, Vec3::ONE], 1.0), [Vec3::ONE]);
    for size_m in [0.0, -1.0, f32::NAN, f32::INFINITY] {
        assert!(VoxelOctree::build(&[Vec3::ONE], size_m).is_err());
        assert_eq!(centres_of_mass(&[Vec3::ONE], size_m), [Vec3::ONE]);
    }
    let empty = VoxelOctree::build(&[], 1.0).unwrap();
    empty.check().unwrap();
    assert!(empty.is_empty() && empty.get(VoxelIndex { r: 0, c: 0, l: 0 }).is_none());
    let error = VoxelOctree::build(&[Vec3::ONE, Vec3::NAN], 1.0).unwrap_err();
    assert_eq!(error.message(), "point 1 is not finite");
}

#[test]
fn size_follows_density_between_its_limits() {
    assert_eq!(choose_size_m(1000.0, 5.0), 0.5);
    assert_eq!(choose_size_m(2.0, 5.0), 1.0);
    assert_eq!(choose_size_m(0.1, 5.0), 1.25);
    assert_eq!(choose_size_m(0.0, 5.0), 1.25);
    for (density, crown_m) in [(f32::NAN, 5.0), (1.0, f32::NAN), (1.0, -1.0), (f32::INFINITY, 0.0)]
    {
        let size_m = choose_size_m(density, crown_m);
        assert!(size_m.is_finite() && size_m > 0.0);
    }
}

#[test]
fn the_number_of_threads_changes_nothing() {
    let points = cloud(200_000, 40.0);
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| VoxelOctree::build(&points, 0.7).unwrap())
    };
    let (one, three) = (on(1), on(3));
    three.check().unwrap();
    assert_eq!(one.centres_of_mass(), three.centres_of_mass());
    assert_eq!(one.counts(), three.counts());
}
