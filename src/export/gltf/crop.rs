//! What a piece of the terrain needs of the pictures that the whole of it shows.
//!
//! A crop begins and ends at multiples of [`BORDER_PX`], with as much about what is shown: the blocks
//! of JPEG are those of the whole then, and so are the texels of coarser levels, down to one a border.
//! Pieces look alike on both sides of their seam. Limit: a picture that repeats, and pictures
//! of several sizes, are kept whole.

use std::ops::Range;

use glam::{DVec2, Vec2};

use super::super::{PictureFormat, Pictures};
use crate::diagnostic::Result;
use crate::mesh::Surface;
use crate::raster::Picture;
use crate::scene::{Selection, Texture, Wrap};

/// A power of two.
const BORDER_PX: u32 = 32;

/// Some of the pixels of a picture, row 0 on top.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Crop {
    x: Range<u32>,
    y: Range<u32>,
    whole: [u32; 2],
}

impl Crop {
    /// Of the pictures on these places; `None` where they are needed whole.
    pub fn of(selection: &Selection<'_>, shown: &[Vec2]) -> Option<Crop> {
        let size = |t: &Texture| [t.image.width(), t.image.height()];
        let whole = selection.pictures().map(|(t, _)| size(t)).next()?;
        let is_alike = |(t, wrap): (&Texture, Wrap)| wrap == Wrap::Clamp && size(t) == whole;
        if !selection.pictures().all(is_alike) {
            return None;
        }
        let nothing = (Vec2::INFINITY, Vec2::NEG_INFINITY);
        let (low, high) = shown.iter().fold(nothing, |(lo, hi), &uv| (lo.min(uv), hi.max(uv)));
        // v is upwards, rows go down.
        let x = with_border(low.x, high.x, whole[0])?;
        let y = with_border(1.0 - high.y, 1.0 - low.y, whole[1])?;
        let crop = Crop { x, y, whole };
        (crop.size() != whole).then_some(crop)
    }

    fn size(&self) -> [u32; 2] {
        [self.x.len() as u32, self.y.len() as u32]
    }

    /// Moves texture coordinates of the whole picture to where the crop has them.
    pub fn turn(&self, surface: &mut Surface) {
        let whole = DVec2::from(self.whole.map(f64::from));
        let size = DVec2::from(self.size().map(f64::from));
        let below = f64::from(self.whole[1] - self.y.end);
        let corner = DVec2::new(f64::from(self.x.start), below);
        for uv in &mut surface.uv {
            *uv = ((uv.as_dvec2() * whole - corner) / size).as_vec2();
        }
    }

    /// All pictures, with those of the selection cropped.
    ///
    /// # Errors
    /// A picture larger than a format takes.
    pub fn pictures(
        &self,
        selection: &Selection<'_>,
        pictures: &Pictures,
        kind: PictureFormat,
    ) -> Result<Pictures> {
        let cropped = |(&number, (texture, _)): (&u32, (&Texture, _))| {
            let image = self.cut(texture.image.picture()).into();
            let texture = Texture { image, ..texture.clone() };
            Ok((number, pictures.encoded(selection.scene(), number, &texture, kind)?))
        };
        let all: Result<Vec<_>> =
            selection.textures.iter().zip(selection.pictures()).map(cropped).collect();
        Ok(pictures.with(kind, all?))
    }

    fn cut(&self, whole: &Picture) -> Picture {
        let [width, height] = self.size();
        let row = |y: u32| {
            let start = y as usize * whole.width as usize;
            whole.data.get(start + self.x.start as usize..start + self.x.end as usize)
        };
        let data = self.y.clone().filter_map(row).flatten().copied().collect();
        Picture { width, height, data }
    }
}

/// Pixels of so many, from one share of them to another.
fn with_border(from: f32, to: f32, count: u32) -> Option<Range<u32>> {
    // Without corners there is no share.
    if from > to || from.is_nan() || to.is_nan() {
        return None;
    }
    let blocks = |share: f32| f64::from(share) * f64::from(count) / f64::from(BORDER_PX);
    // Conversions saturate.
    let first = (blocks(from).floor() as u32).saturating_sub(1);
    let end = (blocks(to).ceil() as u32).saturating_add(1);
    Some(first.saturating_mul(BORDER_PX).min(count)..end.saturating_mul(BORDER_PX).min(count))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn crops_have_a_border_within_the_picture() {
        assert_eq!(with_border(0.25, 0.5, 1000), Some(192..544));
        assert_eq!(with_border(0.0, 0.01, 1000), Some(0..64));
        assert_eq!(with_border(0.9, 1.0, 1000), Some(864..1000));
        assert_eq!(with_border(-0.001, 1.001, 1000), Some(0..1000));
        assert_eq!(with_border(f32::INFINITY, f32::NEG_INFINITY, 1000), None);
    }
}
