//! Which of many models a camera sees at all.

use glam::Vec3;
use rayon::prelude::*;

use super::camera::{self, Camera};
use super::draw::{Canvas, Sample, Scratch};
use super::texture::Purpose;
use super::{RenderOptions, View, stage};

/// Nearness, and whose it is.
struct Owners {
    nearness: Vec<f32>,
    owner: Vec<u32>,
    current: u32,
}

impl Canvas for Owners {
    const IS_SHADED: bool = false;
    fn begin(&mut self, place: u32) {
        self.current = place;
    }
    fn nearness(&self, i: usize) -> f32 {
        self.nearness[i]
    }
    fn put(&mut self, i: usize, sample: Sample) {
        self.nearness[i] = sample.nearness;
        self.owner[i] = self.current;
    }
}

/// Whether each placement of the view covers a sample of the picture; `None` for those out of the
/// picture altogether. What is smaller than a sample may be missed.
pub fn seen(view: &View<'_>, camera: &Camera, options: &RenderOptions) -> Vec<Option<bool>> {
    const ROWS: usize = 48;
    let per_pixel = options.supersample.clamp(1, 4) as usize;
    let [width, height] =
        [options.width, options.height].map(|n| n.clamp(1, 8192) as usize * per_pixel);
    let eye = camera::View::pinhole(camera, width, height);
    let stage = stage(view, Purpose::Outline, Some((&eye, options.triangle_budget)));
    let list = stage.list(&eye, ROWS, options.triangle_budget);
    let owners: Vec<Vec<u32>> = (0..height.div_ceil(ROWS))
        .into_par_iter()
        .map_init(Scratch::default, |scratch, band| {
            let samples = width * ROWS.min(height - band * ROWS);
            let mut canvas =
                Owners { nearness: vec![f32::MIN; samples], owner: vec![0; samples], current: 0 };
            stage.draw_band(&eye, &list, band, scratch, &mut canvas);
            canvas.owner.dedup();
            canvas.owner.sort_unstable();
            canvas.owner.dedup();
            canvas.owner
        })
        .collect();
    let mut out = vec![None; view.placements.len()];
    let mut note = |place: u32, is_seen: bool| {
        let placement = stage.places[place as usize].placement;
        if let Some(slot) = placement.and_then(|p| out.get_mut(p as usize)) {
            *slot = Some(is_seen || *slot == Some(true));
        }
    };
    for item in &stage.items {
        let (lo, hi): (Vec3, Vec3) = stage.bounds(item);
        if eye.cover(lo, hi).is_some() {
            note(item.place, false);
        }
    }
    owners.into_iter().flatten().for_each(|place| note(place, true));
    out
}
