//! Reading a real LAZ scan and putting it into voxels.

use std::path::PathBuf;

use divan::counter::ItemsCount;
use larix::scan::{ReadOptions, Scan, encode_laz, read};
use larix::voxel::VoxelOctree;

const SCAN: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../shared/data/lasR/bcts_2.laz");

fn main() {
    if PathBuf::from(SCAN).is_file() {
        divan::main();
    } else {
        println!("skipped: no real scan at {SCAN}");
    }
}

fn scan(drop_isolated: bool) -> Scan {
    let options = ReadOptions { drop_isolated, ..ReadOptions::default() };
    read(&[PathBuf::from(SCAN)], &options).unwrap().value
}

#[divan::bench(args = [false, true], sample_count = 10)]
fn read_laz(bencher: divan::Bencher, drop_isolated: bool) {
    let points = scan(false).cloud.len();
    bencher.counter(ItemsCount::new(points)).bench(|| scan(drop_isolated));
}

#[divan::bench(sample_count = 5)]
fn write_laz(bencher: divan::Bencher) {
    let cloud = scan(false).cloud;
    bencher.counter(ItemsCount::new(cloud.len())).bench(|| encode_laz(&cloud).unwrap());
}

#[divan::bench(args = [0.25, 0.5, 1.0], sample_count = 10)]
fn build_octree(bencher: divan::Bencher, size_m: f32) {
    let points = scan(false).cloud.position;
    let tree = VoxelOctree::build(&points, size_m).unwrap();
    println!("{} voxels, {} nodes, {} bytes", tree.len(), tree.node_count(), tree.memory_bytes());
    bencher
        .counter(ItemsCount::new(points.len()))
        .bench(|| VoxelOctree::build(&points, size_m).unwrap());
}
