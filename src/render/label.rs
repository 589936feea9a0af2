//! Words on a picture. The font is Inter (SIL Open Font License, `font/OFL.txt`), cut down to
//! Latin, Greek and Cyrillic; other scripts show as boxes.

use ab_glyph::{Font, FontRef, PxScale, ScaleFont};

use crate::diagnostic::{Error, Result};
use crate::raster::Picture;

/// A font that draws on pictures.
pub struct Pen {
    font: FontRef<'static>,
}

/// Where along a text its place lies.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Align {
    Left,
    Middle,
    Right,
}

impl Pen {
    /// # Errors
    /// Never, but for a broken font file in the program.
    pub fn new() -> Result<Pen> {
        let font = FontRef::try_from_slice(include_bytes!("font/Inter-Medium.ttf"))
            .map_err(|e| Error::new(format!("the font can't be read: {e}")))?;
        Ok(Pen { font })
    }

    /// Width of a text whose capitals and descenders span about `size_px`.
    pub fn width_px(&self, text: &str, size_px: f32) -> f32 {
        let font = self.font.as_scaled(PxScale::from(size_px));
        text.chars().map(|c| font.h_advance(font.glyph_id(c))).sum()
    }

    /// Writes a text with its baseline at `y`; what lies outside the picture is left out.
    pub fn write(
        &self,
        picture: &mut Picture,
        text: &str,
        [x, y]: [f32; 2],
        align: Align,
        size_px: f32,
        colour: [u8; 3],
    ) {
        let font = self.font.as_scaled(PxScale::from(size_px));
        let mut x = match align {
            Align::Left => x,
            Align::Middle => x - self.width_px(text, size_px) * 0.5,
            Align::Right => x - self.width_px(text, size_px),
        };
        for c in text.chars() {
            let id = font.glyph_id(c);
            let at = ab_glyph::point(x, y);
            x += font.h_advance(id);
            let Some(outline) = font.outline_glyph(id.with_scale_and_position(size_px, at)) else {
                continue;
            };
            let bounds = outline.px_bounds();
            outline.draw(|dx, dy, coverage| {
                blend(
                    picture,
                    bounds.min.x + dx as f32,
                    bounds.min.y + dy as f32,
                    colour,
                    coverage,
                );
            });
        }
    }
}

/// A level line one pixel thick, from `x0` to `x1`.
pub fn rule(picture: &mut Picture, [x0, x1]: [f32; 2], y: f32, colour: [u8; 3], strength: f32) {
    let mut x = x0.floor();
    while x < x1.min(picture.width as f32) {
        blend(picture, x, y.floor(), colour, strength);
        x += 1.0;
    }
}

fn blend(picture: &mut Picture, x: f32, y: f32, colour: [u8; 3], share: f32) {
    if !(0.0..picture.width as f32).contains(&x) || !(0.0..picture.height as f32).contains(&y) {
        return;
    }
    let [r, g, b, a] = picture.at(x as u32, y as u32);
    let share = share.clamp(0.0, 1.0);
    let mix = |from: u8, to: u8| {
        (f32::from(from) + (f32::from(to) - f32::from(from)) * share).round() as u8
    };
    let mixed = [mix(r, colour[0]), mix(g, colour[1]), mix(b, colour[2]), a];
    picture.set(x as u32, y as u32, mixed);
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ink(picture: &Picture) -> usize {
        picture.data.iter().filter(|p| p[0] < 128).count()
    }

    #[test]
    fn words_stand_where_they_are_put_and_never_outside() {
        let pen = Pen::new().unwrap();
        let mut picture = Picture::filled(200, 60, [255; 4]);
        pen.write(&mut picture, "Larix · ель", [100.0, 40.0], Align::Middle, 24.0, [0; 3]);
        assert!(ink(&picture) > 100);
        let (left, right): (Vec<_>, Vec<_>) = (0..200u32 * 60)
            .filter(|i| picture.data[*i as usize][0] < 128)
            .partition(|i| i % 200 < 100);
        let share = left.len() as f32 / (left.len() + right.len()) as f32;
        assert!((0.3..0.7).contains(&share), "{share}");
        for at in [[-500.0, 20.0], [100.0, 900.0], [f32::NAN, 3.0], [190.0, 2.0]] {
            pen.write(&mut picture, "edge", at, Align::Right, 30.0, [9; 3]);
        }
    }

    #[test]
    fn every_letter_of_species_names_is_in_the_font() {
        let pen = Pen::new().unwrap();
        for c in "Abz19 .,·–—×%²°éøßŁ Ёжик ρ".chars() {
            assert_ne!(pen.font.glyph_id(c).0, 0, "{c}");
        }
        assert!(pen.width_px("wide", 20.0) > pen.width_px("ill", 20.0));
    }
}
