//! What a model shows from one side, unlit: colour, normal and depth, for impostors; and its
//! silhouette, for measuring. Every triangle is drawn, whatever its size.

use glam::Vec3;
use rayon::prelude::*;

use super::draw::{Canvas, Sample, Scratch, Stage};
use super::texture::Purpose;
use super::{Placement, View, camera, stage};
use crate::diagnostic::{Error, Result};
use crate::scene::{Material, Part, Texture};

/// A window on a model, seen along a direction without perspective; samples are square.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Window {
    /// What the middle of the window shows.
    pub centre: Vec3,
    /// Unit; the way the eye looks.
    pub forward: Vec3,
    /// Side of a sample, metres.
    pub sample_m: f32,
    /// Samples across and down, 1…16,384.
    pub size: [usize; 2],
}

/// What one sample shows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Texel {
    /// Linear light.
    pub albedo: [f32; 3],
    /// Unit, in the model's axes, towards the eye.
    pub normal: Vec3,
    /// Distance before the window's plane through `centre`, metres; −∞ where nothing is seen.
    pub before_m: f32,
    /// 1 for leaves, 0 for wood.
    pub leaf: f32,
}

impl Texel {
    pub const NOTHING: Texel =
        Texel { albedo: [0.0; 3], normal: Vec3::Z, before_m: f32::NEG_INFINITY, leaf: 0.0 };

    pub fn is_seen(&self) -> bool {
        self.before_m > f32::NEG_INFINITY
    }
}

/// Models laid out for capturing, once for many windows.
pub struct Sitter<'a> {
    stage: Stage<'a>,
}

/// Colours and plain normals.
struct Portrait<'a> {
    texel: &'a mut [Texel],
    forward: Vec3,
}

impl Canvas for Portrait<'_> {
    const IS_SHADED: bool = true;
    const IS_CROWN_LIT: bool = false;
    fn nearness(&self, i: usize) -> f32 {
        self.texel[i].before_m
    }
    fn put(&mut self, i: usize, sample: Sample) {
        let away = sample.normal.dot(self.forward).max(0.0);
        let normal = (sample.normal - self.forward * (2.0 * away)).normalize_or(-self.forward);
        let Sample { albedo, nearness: before_m, leaf, .. } = sample;
        self.texel[i] = Texel { albedo, normal, before_m, leaf };
    }
}

/// What is covered is not looked at again.
struct Cover<'a>(&'a mut [bool]);

impl Canvas for Cover<'_> {
    const IS_SHADED: bool = false;
    fn nearness(&self, i: usize) -> f32 {
        if self.0[i] { f32::INFINITY } else { f32::MIN }
    }
    fn put(&mut self, i: usize, _: Sample) {
        self.0[i] = true;
    }
}

impl<'a> Sitter<'a> {
    /// Each model by itself, in its own coordinates.
    pub fn new(models: &[&'a [Part]], materials: &'a [Material], textures: &'a [Texture]) -> Self {
        Sitter::with(models, materials, textures, Purpose::Picture)
    }

    /// For silhouettes alone, with pictures read texel by texel, however small they are: samples
    /// together say how much a model covers, though each for itself is noise.
    pub fn covers(
        models: &[&'a [Part]],
        materials: &'a [Material],
        textures: &'a [Texture],
    ) -> Self {
        Sitter::with(models, materials, textures, Purpose::Cover)
    }

    fn with(
        models: &[&'a [Part]],
        materials: &'a [Material],
        textures: &'a [Texture],
        purpose: Purpose,
    ) -> Self {
        let alone = |model| Placement { model, ..Placement::HOME };
        let view = View {
            textures,
            materials,
            terrain: None,
            models: models.to_vec(),
            placements: (0..models.len() as u32).map(alone).collect(),
        };
        let mut stage = stage(&view, purpose, None);
        // What stands in for the ground is in place 0, models come after it in their order.
        stage.items.retain(|item| item.place > 0);
        Sitter { stage }
    }

    /// How far a model reaches from a place, metres.
    pub fn reach_m(&self, model: u32, from: Vec3) -> f32 {
        let items = self.stage.items.iter().filter(|item| item.place == model + 1);
        let vertices = items.flat_map(|item| &self.stage.meshes[item.mesh as usize].vertex);
        vertices.map(|v| v.position.distance_squared(from)).fold(0.0, f32::max).sqrt()
    }

    /// Vertices of a model.
    pub fn vertices(&self, model: u32) -> usize {
        let items = self.stage.items.iter().filter(|item| item.place == model + 1);
        items.map(|item| self.stage.meshes[item.mesh as usize].vertex.len()).sum()
    }

    /// Colour, normal and depth of every sample, `rows` at a time from the top: what `of` makes of a
    /// band, given its first row.
    ///
    /// # Errors
    /// A window of no size, or of more samples than 16,384 along a side.
    pub fn portrait<T: Send>(
        &self,
        model: u32,
        window: &Window,
        rows: usize,
        of: impl Fn(usize, &[Texel]) -> T + Sync,
    ) -> Result<Vec<T>> {
        let eye = window.eye()?;
        let rows = rows.clamp(1, eye.height);
        let list = self.stage.list_whole(&eye, model + 1, rows);
        let band = |(scratch, texel): &mut (Scratch, Vec<Texel>), band: usize| {
            let first = band * rows;
            texel.clear();
            texel.resize(eye.width * rows.min(eye.height - first), Texel::NOTHING);
            let mut canvas = Portrait { texel, forward: window.forward };
            self.stage.draw_band(&eye, &list, band, scratch, &mut canvas);
            of(first, texel)
        };
        let bands = (0..eye.height.div_ceil(rows)).into_par_iter();
        Ok(bands.map_init(Default::default, band).collect())
    }

    /// Whether each sample shows anything, row 0 on top.
    ///
    /// # Errors
    /// As [`Sitter::portrait`].
    pub fn silhouette(&self, model: u32, window: &Window) -> Result<Vec<bool>> {
        let eye = window.eye()?;
        let mut covered = vec![false; eye.width * eye.height];
        self.draw(model, &eye, &mut Cover(&mut covered));
        Ok(covered)
    }

    /// Distance before the window's plane of what is nearest in every sample, metres, row 0 on top;
    /// `f32::MIN` where nothing is.
    ///
    /// # Errors
    /// As [`Sitter::portrait`].
    pub fn nearest(&self, model: u32, window: &Window) -> Result<Vec<f32>> {
        let eye = window.eye()?;
        let mut before_m = vec![f32::MIN; eye.width * eye.height];
        self.draw(model, &eye, &mut before_m[..]);
        Ok(before_m)
    }

    fn draw<C: Canvas + ?Sized>(&self, model: u32, eye: &camera::View, canvas: &mut C) {
        let list = self.stage.list_whole(eye, model + 1, eye.height);
        self.stage.draw_band(eye, &list, 0, &mut Scratch::default(), canvas);
    }
}

/// Right and up of what is seen by an eye that looks this way, unit.
pub fn sides(forward: Vec3) -> [Vec3; 2] {
    camera::sides(forward)
}

impl Window {
    fn eye(&self) -> Result<camera::View> {
        let [width, height] = self.size;
        let is_sound = self.centre.is_finite()
            && self.forward.is_normalized()
            && self.sample_m.is_finite()
            && self.sample_m > 0.0
            && (1..=16_384).contains(&width)
            && (1..=16_384).contains(&height);
        if !is_sound {
            return Err(Error::new(format!("a window that shows nothing: {self:?}")));
        }
        Ok(camera::View::window(self.centre, self.forward, self.sample_m, self.size))
    }
}
