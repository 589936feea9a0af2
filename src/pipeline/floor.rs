//! The terrain of a scene, under its photo or in tiles of forest floor.

use glam::Vec2;

use super::drape::drape;
use super::survey::Survey;
use crate::diagnostic::Result;
use crate::frame::Frame;
use crate::mesh::Surface;
use crate::raster::Picture;
use crate::report::{ErrorMeasure, Outcome, Recorder};
use crate::scene::{Colorspace, Material, Part, Scene, Texture, ValidScene};
use crate::seed::Seed;
use crate::terrain::{Facets, Terrain};
use crate::texture;

/// Side of the square that one repeat of the forest floor covers, metres.
const FLOOR_TILE_M: f32 = 4.0;

pub(super) fn add_terrain(
    scene: &mut Scene,
    terrain: &Terrain,
    facets: &Facets,
    survey: &Survey,
    seed: Seed,
) {
    let mut surface = facets.surface();
    let outlines: Vec<&[Vec2]> = survey.trees.iter().map(|t| &t.crown.outline[..]).collect();
    let draped = survey.photo.as_ref().and_then(|p| drape(p, terrain, &outlines, seed));
    let picture = draped.unwrap_or_else(|| tiled_floor(&mut surface, terrain, seed));
    place_terrain(scene, surface, picture);
}

/// The bare forest floor in tiles over a surface.
fn tiled_floor(surface: &mut Surface, terrain: &Terrain, seed: Seed) -> Picture {
    let g = &terrain.heights.geometry;
    let size = Vec2::new((g.east() - g.west) as f32, (g.north - g.south()) as f32);
    for uv in &mut surface.uv {
        *uv *= size / FLOOR_TILE_M;
    }
    texture::ground(512, seed)
}

fn place_terrain(scene: &mut Scene, surface: Surface, picture: Picture) {
    scene.textures.push(Texture {
        name: "terrain".into(),
        image: picture.into(),
        colorspace: Colorspace::Srgb,
    });
    let base_color_texture = Some(scene.textures.len() as u32 - 1);
    scene.materials.push(Material { base_color_texture, ..Material::plain("terrain", [1.0; 3]) });
    let material = scene.materials.len() as u32 - 1;
    scene.terrain = Some(Part { name: "terrain".into(), surface, material });
}

/// The terrain alone as a scene: triangles that keep every height within `error_m`, bare floor.
///
/// # Errors
/// A scene that does not hold together.
pub fn terrain_scene(
    frame: Frame,
    terrain: &Terrain,
    error_m: f32,
    run: &mut Recorder,
) -> Result<(ValidScene, Facets)> {
    run.stage("mesh", |_| {
        let facets = terrain.facets(error_m, usize::MAX);
        let mut scene = Scene::empty("terrain".into(), frame);
        let mut surface = facets.surface();
        let picture = tiled_floor(&mut surface, terrain, Seed::new(1));
        place_terrain(&mut scene, surface, picture);
        let cells = terrain.heights.data.len();
        let outcome = Outcome::items(cells, "cells", facets.triangles(), "triangles");
        let worst = ErrorMeasure::new("worst height", facets.worst_m.into(), "m");
        Ok(((scene.validate()?, facets), outcome.error(worst)))
    })
}
