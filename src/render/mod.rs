//! A scene to a picture: our own software rasteriser, for previews, thumbnails and impostors.
//! Knows nothing of files.
//!
//! Samples on a regular grid inside each pixel are filled from perspective-correct triangles with
//! masked textures, then each is lit once: sun with a shadow map, sky dimmed inside the canopy,
//! haze, film curve. Known limits: leaves are lit as part of a rounded crown rather than by their
//! own normal alone; mip levels are isotropic; nothing is reflected, so that roughness goes unseen.

mod camera;
pub mod capture;
mod draw;
pub mod label;
mod light;
mod model;
mod raster;
mod seen;
pub mod sky;
mod texture;

use std::collections::BTreeMap;

use glam::{Mat3, Vec2, Vec3};
use rayon::prelude::*;

pub use camera::Camera;
use draw::{Item, Paint, Place, Sample, Scratch, Stage};
use light::Light;
use model::{Mesh, Order};
pub use seen::seen;
use sky::film;
use texture::{Purpose, Pyramid};

use crate::mesh::Surface;
use crate::raster::{Picture, srgb_from_linear};
use crate::scene::{Alpha, Material, Part, Prototype, Scattered, Scene, Texture};

/// A model in its place: scale, then turn, then move.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Placement {
    /// Index into [`View::models`].
    pub model: u32,
    pub position: Vec3,
    /// A rotation.
    pub turn: Mat3,
    pub scale: Vec3,
}

/// What a picture shows. Ids out of range and triangles that can't be drawn are passed over.
#[derive(Debug, Clone)]
pub struct View<'a> {
    pub textures: &'a [Texture],
    pub materials: &'a [Material],
    pub terrain: Option<&'a Part>,
    pub models: Vec<&'a [Part]>,
    pub placements: Vec<Placement>,
}

impl Placement {
    /// Where a model stands by itself.
    pub const HOME: Placement =
        Placement { model: 0, position: Vec3::ZERO, turn: Mat3::IDENTITY, scale: Vec3::ONE };
}

impl<'a> View<'a> {
    /// One model on a disc of ground.
    pub fn of_model(parts: &'a [Part], materials: &'a [Material], textures: &'a [Texture]) -> Self {
        View {
            textures,
            materials,
            terrain: None,
            models: vec![parts],
            placements: vec![Placement::HOME],
        }
    }

    /// One model with all that is scattered over it, on a disc of ground.
    pub fn of_prototype(
        one: &'a Prototype,
        materials: &'a [Material],
        textures: &'a [Texture],
    ) -> Self {
        let mut view = View::of_model(&one.parts, materials, textures);
        for (model, Scattered { part, places }) in (1..).zip(&one.scattered) {
            view.models.push(std::slice::from_ref(part));
            view.placements.extend(places.iter().map(|place| Placement {
                model,
                position: place.position,
                turn: Mat3::from_quat(place.turn),
                scale: Vec3::splat(place.scale),
            }));
        }
        view
    }

    /// Points that span all that is shown: the corners of each model's bounds in its place, the
    /// terrain's vertices and the floor below them.
    pub fn extent(&self) -> Vec<Vec3> {
        let of_parts = |parts: &[Part]| {
            let filled = parts.iter().filter(|p| !p.surface.is_empty());
            filled.map(|p| p.surface.bounds()).reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)))
        };
        let models: Vec<_> = self.models.iter().map(|m| of_parts(m)).collect();
        let placed = self.placements.iter().filter_map(|p| {
            let (lo, hi) = models.get(p.model as usize).copied().flatten()?;
            let turn = p.turn * Mat3::from_diagonal(p.scale);
            Some((0..8).map(move |i| turn * camera::corner(lo, hi, i) + p.position))
        });
        let terrain = self.terrain.iter().flat_map(|t| {
            let floor = floor(t.surface.bounds());
            let position = t.surface.position.iter();
            position.flat_map(move |p| [*p, p.with_z(floor)])
        });
        placed.flatten().chain(terrain).filter(|p| p.is_finite()).collect()
    }

    /// Least and greatest corner of everything; zero where there is nothing.
    pub fn bounds(&self) -> (Vec3, Vec3) {
        let boxes = self.extent().into_iter().map(|p| (p, p));
        boxes.reduce(|a, b| (a.0.min(b.0), a.1.max(b.1))).unwrap_or((Vec3::ZERO, Vec3::ZERO))
    }
}

impl<'a> From<&'a Scene> for View<'a> {
    fn from(scene: &'a Scene) -> Self {
        View {
            textures: &scene.textures,
            materials: &scene.materials,
            terrain: scene.terrain.as_ref(),
            models: scene.prototypes.iter().map(|p| p.parts.as_slice()).collect(),
            placements: (scene.instances.iter())
                .map(|i| Placement {
                    model: i.prototype,
                    position: i.position,
                    turn: Mat3::from_rotation_z(i.yaw_rad),
                    scale: i.scale,
                })
                .collect(),
        }
    }
}

/// What stands behind everything.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Backdrop {
    /// Sky, haze and bare earth.
    Sky,
    /// A sheet of light paper that runs from a wall into a level floor; nothing of the ground is
    /// seen but the shadows on it. `horizon` is where floor meets wall, over the picture's height
    /// from the top.
    Paper { horizon: f32 },
}

impl Backdrop {
    /// Display-linear colour of the paper at a height over the picture's from the top; `None` for
    /// the sky.
    fn paper(self, down: f32) -> Option<Vec3> {
        const WALL: Vec3 = Vec3::new(0.905, 0.905, 0.89);
        const FLOOR: Vec3 = Vec3::new(0.76, 0.755, 0.725);
        let Backdrop::Paper { horizon } = self else { return None };
        let step = |x: f32| {
            let x = x.clamp(0.0, 1.0);
            x * x * (3.0 - 2.0 * x)
        };
        // The floor ends as softly as it begins, so that the picture can go over into a page.
        let depth = (1.0 - horizon).max(1e-3);
        let floor = step((down - horizon) / (0.4 * depth)) * step((1.0 - down) / (0.5 * depth));
        Some(WALL.lerp(FLOOR, floor))
    }
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RenderOptions {
    /// Pixels, 1…8192.
    pub width: u32,
    /// Pixels, 1…8192.
    pub height: u32,
    /// Samples along a side of a pixel, 1…4.
    pub supersample: u32,
    /// Towards the sun.
    pub sun: Vec3,
    /// Texels along the longer side of the shadow map, 64…8192.
    pub shadow_size: u32,
    /// Share of light the air takes a metre.
    pub haze_per_m: f32,
    /// Factor on all light.
    pub exposure: f32,
    /// Triangles drawn at most, more or less; far crowns are thinned to reach it.
    pub triangle_budget: usize,
    pub backdrop: Backdrop,
}

impl Default for RenderOptions {
    fn default() -> Self {
        RenderOptions {
            width: 1280,
            height: 720,
            supersample: 2,
            sun: Vec3::new(-0.72, -0.36, 0.66),
            shadow_size: 2560,
            haze_per_m: 0.0004,
            exposure: 0.52,
            triangle_budget: 6_000_000,
            backdrop: Backdrop::Sky,
        }
    }
}

/// Draws the view. The same input gives the same bytes on any number of threads.
pub fn picture(view: &View<'_>, camera: &Camera, options: &RenderOptions) -> Picture {
    let per_pixel = options.supersample.clamp(1, 4) as usize;
    let (width, height) =
        (options.width.clamp(1, 8192) as usize, options.height.clamp(1, 8192) as usize);
    let eye = camera::View::pinhole(camera, width * per_pixel, height * per_pixel);
    let stage = stage(view, Purpose::Picture, Some((&eye, options.triangle_budget)));
    let seen: Vec<Vec3> = (stage.items.iter())
        .map(|item| stage.bounds(item))
        .filter(|(lo, hi)| lo.is_finite() && hi.is_finite() && eye.cover(*lo, *hi).is_some())
        .flat_map(|(lo, hi)| (0..8).map(move |i| camera::corner(lo, hi, i)))
        .collect();
    let mut light = Light::new(
        &stage,
        options.sun,
        &seen,
        options.shadow_size.clamp(64, 8192) as usize,
        options.triangle_budget / 2,
        options.haze_per_m,
    );
    if options.backdrop != Backdrop::Sky {
        light.fill = 0.5;
    }
    const PIXEL_ROWS: usize = 24;
    let rows = PIXEL_ROWS * per_pixel;
    let list = stage.list(&eye, rows, options.triangle_budget);
    let mut out = Picture::filled(width as u32, height as u32, [0, 0, 0, 255]);
    out.data.par_chunks_mut(width * PIXEL_ROWS).enumerate().for_each_init(
        || (Scratch::default(), Vec::new()),
        |(scratch, samples), (band, pixels)| {
            samples.clear();
            samples.resize(pixels.len() * per_pixel * per_pixel, Sample::NOTHING);
            stage.draw_band(&eye, &list, band, scratch, samples.as_mut_slice());
            let first_row = band * rows;
            for (i, pixel) in pixels.iter_mut().enumerate() {
                let (px, py) = (i % width, i / width);
                let mut sum = Vec3::ZERO;
                let row = band * PIXEL_ROWS + py;
                let paper = options.backdrop.paper((row as f32 + 0.5) / height as f32);
                for k in 0..per_pixel * per_pixel {
                    let x = px * per_pixel + k % per_pixel;
                    let y = py * per_pixel + k / per_pixel;
                    let sample = &samples[y * width * per_pixel + x];
                    let is_hit = sample.nearness > f32::MIN;
                    if let Some(paper) = paper.filter(|_| !is_hit) {
                        sum += paper;
                        continue;
                    }
                    let at = Vec2::new(x as f32 + 0.5, (first_row + y) as f32 + 0.5);
                    let ray = eye.ray(at);
                    let depth = 1.0 / sample.nearness;
                    let place = eye.eye() + ray * depth;
                    let turn = (k + (px & 1) * 2 + (py & 1) * 3) as u32 % 4;
                    sum += match paper.filter(|_| sample.is_floor) {
                        Some(paper) => paper * light.on_paper(place, turn),
                        None if is_hit => {
                            let distance = depth * ray.length();
                            film(light.shade(sample, place, distance, ray, turn), options.exposure)
                        }
                        None => film(sky::sky(ray, light.sun), options.exposure),
                    };
                }
                let mean = sum / (per_pixel * per_pixel) as f32;
                let grain = dither(px as u32, row as u32);
                let code = |c: f32| (srgb_from_linear(c) + grain).clamp(0.0, 255.0) as u8;
                *pixel = [code(mean.x), code(mean.y), code(mean.z), 255];
            }
        },
    );
    out
}

/// Rounds smooth gradients up or down by place (interleaved gradient noise, Jimenez 2014): 0…1.
fn dither(x: u32, y: u32) -> f32 {
    let v = (0.067_110_56 * x as f32 + 0.005_837_15 * y as f32).fract();
    (52.982_918 * v).fract()
}

/// Lays out everything that can be drawn; for an eye with a budget of triangles no more of each model
/// than it gets to see, so that a large scene is not held twice.
fn stage<'a>(view: &View<'a>, purpose: Purpose, eye: Option<(&camera::View, usize)>) -> Stage<'a> {
    let mut cutoffs: BTreeMap<u32, f32> = BTreeMap::new();
    for material in view.materials {
        if let (Alpha::Mask { cutoff }, Some(t)) = (material.alpha, material.base_color_texture) {
            cutoffs.entry(t).or_insert(cutoff);
        }
    }
    // A texture that nothing here shows stays as it is.
    let mut is_used = vec![false; view.textures.len()];
    for part in view.models.iter().flat_map(|parts| parts.iter()).chain(view.terrain) {
        let Some(material) = view.materials.get(part.material as usize) else { continue };
        let shown = match purpose {
            Purpose::Picture => {
                [material.base_color_texture, material.normal_texture, material.orm_texture]
            }
            _ if matches!(material.alpha, Alpha::Mask { .. }) => {
                [material.base_color_texture, None, None]
            }
            _ => [None; 3],
        };
        for t in shown.into_iter().flatten() {
            if let Some(used) = is_used.get_mut(t as usize) {
                *used = true;
            }
        }
    }
    let textures: Vec<_> = (view.textures.par_iter().zip(&is_used).enumerate())
        .map(|(i, (t, &used))| {
            let cutoff = cutoffs.get(&(i as u32)).copied();
            let pyramid = || Pyramid::new(t.image.picture(), t.colorspace, cutoff, purpose);
            used.then(pyramid).flatten()
        })
        .collect();
    let known = |id: Option<u32>| id.filter(|&i| (i as usize) < textures.len());
    let mut paints: Vec<Paint> = (view.materials.iter())
        .map(|m| Paint {
            base_color: m.base_color,
            colour: known(m.base_color_texture),
            normal: known(m.normal_texture),
            orm: known(m.orm_texture),
            cutoff: match m.alpha {
                Alpha::Opaque => None,
                Alpha::Mask { cutoff } => Some(cutoff),
            },
            is_double_sided: m.double_sided,
            is_floor: false,
        })
        .collect();
    // Stands in for materials that are not there, and covers cut earth and bare ground.
    let earth = paints.len() as u32;
    for is_floor in [false, true] {
        paints.push(Paint {
            base_color: [0.105, 0.083, 0.056],
            colour: None,
            normal: None,
            orm: None,
            cutoff: None,
            is_double_sided: true,
            is_floor,
        });
    }
    let material = |id: u32| id.min(earth);

    let mut places = vec![Place::new(None, Placement::HOME)];
    // Of each model.
    let mut own_places: Vec<Vec<u32>> = vec![Vec::new(); view.models.len()];
    for (number, p) in (0u32..).zip(&view.placements) {
        let is_sound = p.position.is_finite() && p.scale.is_finite() && p.turn.is_finite();
        if let Some(own) = own_places.get_mut(p.model as usize)
            && is_sound
            && p.scale.min_element() != 0.0
        {
            own.push(places.len() as u32);
            places.push(Place::new(Some(number), *p));
        }
    }
    let parts: Vec<(usize, &Part)> = (view.models.iter().enumerate())
        .flat_map(|(model, parts)| parts.iter().map(move |part| (model, part)))
        .collect();
    let mesh = |part: &Part| {
        let paint = &paints[material(part.material) as usize];
        let mut mesh = if paint.cutoff.is_some() || paint.is_double_sided {
            Mesh::cards(part)
        } else {
            Mesh::solid(part)
        };
        mesh.material = material(part.material);
        mesh
    };
    let of_model = |model: usize| own_places[model].iter().map(|i| &places[*i as usize]);
    let truncate = |mesh: &mut Mesh, model: usize, card_samples: f32| {
        if let Some((eye, _)) = eye {
            let most = draw::needed(mesh, eye, card_samples, of_model(model)).max();
            mesh.truncate(most.unwrap_or(0));
        }
    };
    // Triangles that are shown of what is laid out.
    let shown = |meshes: &[Mesh], card_samples: f32| -> usize {
        let Some((eye, _)) = eye else { return 0 };
        let of = |(mesh, part): (&Mesh, &(usize, &Part))| -> usize {
            draw::needed(mesh, eye, card_samples, of_model(part.0)).sum()
        };
        meshes.par_iter().zip(&parts).map(of).sum()
    };
    /// Parts that are laid out at a time.
    const BATCH: usize = 256;
    let budget = eye.map_or(usize::MAX, |(_, budget)| budget);
    let (mut card_samples, mut coarser) = (draw::FINEST_CARD_SAMPLES, 0);
    let mut meshes: Vec<Mesh> = Vec::with_capacity(parts.len());
    for batch in parts.chunks(BATCH) {
        let lay = |part: &(usize, &Part)| {
            let mut mesh = mesh(part.1);
            truncate(&mut mesh, part.0, card_samples);
            mesh
        };
        meshes.par_extend(batch.par_iter().map(lay));
        while coarser < draw::MOST_COARSER && shown(&meshes, card_samples) > budget {
            (card_samples, coarser) = (card_samples * draw::COARSER, coarser + 1);
            let laid = meshes.par_iter_mut().zip(&parts);
            laid.for_each(|(mesh, part)| truncate(mesh, part.0, card_samples));
        }
    }
    let mut first_mesh = vec![0u32];
    for parts in &view.models {
        first_mesh.push(first_mesh[first_mesh.len() - 1] + parts.len() as u32);
    }
    let mut items = Vec::new();
    for (place, p) in (0u32..).zip(&places) {
        let Some(model) = p.placement.map(|i| view.placements[i as usize].model as usize) else {
            continue;
        };
        let own = first_mesh[model]..first_mesh[model + 1];
        items.extend(own.map(|mesh| Item { mesh, place }));
    }
    let mut ground = match view.terrain {
        Some(terrain) => {
            let mut m = Mesh::clusters(&terrain.surface, material(terrain.material));
            m.extend(Mesh::clusters(&skirt(&terrain.surface), earth));
            m
        }
        None if view.placements.is_empty() => Vec::new(),
        None => Mesh::clusters(&disc(view.bounds()), earth + 1),
    };
    for mesh in &mut ground {
        mesh.order = Order::Whole;
    }
    items.extend((0..ground.len()).map(|i| Item { mesh: (meshes.len() + i) as u32, place: 0 }));
    meshes.extend(ground);
    items.retain(|i| !meshes[i.mesh as usize].triangle.is_empty());
    Stage { textures, paints, meshes, places, items }
}

impl Place {
    fn new(placement: Option<u32>, at: Placement) -> Place {
        let Placement { position: origin, turn, scale, .. } = at;
        let linear = turn * Mat3::from_diagonal(scale);
        let normal = turn * Mat3::from_diagonal(1.0 / scale);
        Place { linear, origin, normal, is_mirrored: scale.x * scale.y * scale.z < 0.0, placement }
    }
}

/// Height of the level floor under a terrain of these bounds.
fn floor((lo, hi): (Vec3, Vec3)) -> f32 {
    lo.z - 0.01 * (hi - lo).truncate().length() - 0.3
}

/// Walls from the rim of a terrain down to a level floor: a piece of land, cut out.
fn skirt(terrain: &Surface) -> Surface {
    let mut edges: BTreeMap<(u32, u32), (u32, [u32; 2])> = BTreeMap::new();
    let count = terrain.position.len();
    for t in terrain.index.chunks_exact(3).filter(|t| t.iter().all(|&i| (i as usize) < count)) {
        for (a, b) in [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])] {
            edges.entry((a.min(b), a.max(b))).or_insert((0, [a, b])).0 += 1;
        }
    }
    let floor = floor(terrain.bounds());
    let mut out = Surface::default();
    for (uses, [a, b]) in edges.into_values() {
        let (p, q) = (terrain.position[a as usize], terrain.position[b as usize]);
        if uses != 1 || !p.is_finite() || !q.is_finite() {
            continue;
        }
        // The surface lies to the left of its rim, seen from above: out is to the right.
        let outward = (q - p).cross(Vec3::Z).normalize_or(Vec3::X);
        let first = out.position.len() as u32;
        for corner in [p, q, q.with_z(floor), p.with_z(floor)] {
            out.position.push(corner);
            out.normal.push(outward);
            out.uv.push(Vec2::ZERO);
        }
        out.index.extend([0, 2, 1, 0, 3, 2].map(|k| first + k));
    }
    out
}

/// A disc of ground under models that come without terrain.
fn disc(bounds: (Vec3, Vec3)) -> Surface {
    const CORNERS: u32 = 96;
    let middle = (bounds.0 + bounds.1) * 0.5;
    let span = bounds.1 - bounds.0;
    let radius = (0.7 * span.truncate().max_element()).max(0.4 * span.z).max(1e-3);
    let mut out = Surface::default();
    let mut push = |p: Vec3| {
        out.position.push(p);
        out.normal.push(Vec3::Z);
        out.uv.push(Vec2::ZERO);
    };
    // Models stand with their root collar at 0; roots may go below.
    let centre = middle.with_z(bounds.0.z.max(0.0).min(bounds.1.z));
    push(centre);
    for i in 0..CORNERS {
        let (s, c) = (i as f32 / CORNERS as f32 * std::f32::consts::TAU).sin_cos();
        push(centre + Vec3::new(c, s, 0.0) * radius);
    }
    out.index = (0..CORNERS).flat_map(|i| [0, 1 + i, 1 + (i + 1) % CORNERS]).collect();
    out
}

#[cfg(test)]
mod tests;
