//! Files read back by another reader, goldens of a small scene, and what happens on a bad disk.

use std::fs;
use std::path::Path;

use glam::{Mat4, Vec3};

use super::*;
use crate::scene::sample::forest;
use crate::scene::{Scene, statistics};

const ALL: [Format; 3] = [Format::Glb, Format::Gltf, Format::Usda];

fn sample() -> Scene {
    forest(&["Larix sibirica", "Betula pendula", "Pinus sylvestris"], 50, 60.0)
}

/// Writes the sample for `tools/validate.py` and for Blender:
/// `LARIX_SAMPLE=DIR cargo test --lib export::tests::sample_on_disk -- --ignored`.
#[test]
#[ignore = "for checks outside of Rust"]
fn sample_on_disk() {
    let dir = std::env::var("LARIX_SAMPLE").expect("LARIX_SAMPLE names a folder");
    let scene = sample().validate().unwrap();
    write_all(Path::new(&dir), &files(&scene, "forest", &ALL).unwrap()).unwrap();
}
