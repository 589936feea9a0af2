//! What a picture shows, as numbers: depths, normals and classes of what is at the centres of pixels.

use glam::{DVec2, Vec3};
use rayon::prelude::*;

use super::Landscape;
use super::picture::Shot;
use super::trace::{Tracer, What};
use crate::diagnostic::Result;

/// What is at each pixel's centre, row by row from the top.
#[derive(Debug, Clone, PartialEq)]
pub struct Layers {
    pub size: [u32; 2],
    /// Distance from the camera along its axis in metres; infinite where nothing is.
    pub depth_m: Vec<f32>,
    /// Away from the surface; zero where nothing is.
    pub normal: Vec<Vec3>,
    /// ASPRS class: 2 ground, 5 vegetation, 0 nothing.
    pub class: Vec<u8>,
}

/// What is at the centre of each pixel.
///
/// # Errors
/// As [`super::draw`].
pub fn layers(scene: &Landscape, shot: &Shot) -> Result<Layers> {
    shot.check()?;
    let lens = scene.lens(&shot.camera, shot.size);
    let [width, height] = shot.size.map(|side| side as usize);
    let row = |row: usize| {
        let mut tracer = Tracer::of_leaves(scene);
        let pixel = move |col: usize| {
            let ray = lens.ray(DVec2::new(col as f64 + 0.5, row as f64 + 0.5), 1.0);
            let Some(hit) = tracer.trace(&ray, 0.0, f64::INFINITY) else {
                return (f32::INFINITY, Vec3::ZERO, 0);
            };
            let p = ray.origin + ray.direction * hit.t;
            let normal = tracer.normal(&hit, p, ray.breadth[1] * hit.t as f32);
            let class = if hit.what == What::Vegetation { 5 } else { 2 };
            ((hit.t * f64::from(scene.voxel_m)) as f32, normal, class)
        };
        (0..width).map(pixel).collect::<Vec<_>>()
    };
    let rows: Vec<Vec<(f32, Vec3, u8)>> = (0..height).into_par_iter().map(row).collect();
    let all = || rows.iter().flatten();
    Ok(Layers {
        size: shot.size,
        depth_m: all().map(|p| p.0).collect(),
        normal: all().map(|p| p.1).collect(),
        class: all().map(|p| p.2).collect(),
    })
}
