//! Colour under what is transparent.

use super::Picture;

/// Gives every transparent pixel the colour of what is seen around it (pull and push over a
/// pyramid, Gortler et al. 1996), alpha untouched: no filter or mip level ever mixes in black.
pub fn pad_transparent(picture: &mut Picture) {
    struct Level {
        width: usize,
        height: usize,
        /// Colour times weight, weight.
        data: Vec<[f32; 4]>,
    }
    let first = Level {
        width: picture.width as usize,
        height: picture.height as usize,
        data: picture
            .data
            .iter()
            .map(|p| {
                let w = f32::from(p[3]) / 255.0;
                [f32::from(p[0]) * w, f32::from(p[1]) * w, f32::from(p[2]) * w, w]
            })
            .collect(),
    };
    let mut levels = vec![first];
    while let Some(fine) = levels.last() {
        if fine.width <= 1 && fine.height <= 1 {
            break;
        }
        let (w, h) = (fine.width.div_ceil(2), fine.height.div_ceil(2));
        let mut data = vec![[0.0f32; 4]; w * h];
        for y in 0..fine.height {
            for x in 0..fine.width {
                let from = fine.data[y * fine.width + x];
                let to = &mut data[(y / 2) * w + x / 2];
                for c in 0..4 {
                    to[c] += from[c];
                }
            }
        }
        for p in &mut data {
            // Saturated weight: a level is filled as soon as anything is seen in it.
            let over = p[3].max(1.0);
            *p = p.map(|v| v / over);
        }
        levels.push(Level { width: w, height: h, data });
    }
    for k in (0..levels.len().saturating_sub(1)).rev() {
        let (fine, coarse) = levels.split_at_mut(k + 1);
        let (fine, coarse) = (&mut fine[k], &coarse[0]);
        for y in 0..fine.height {
            for x in 0..fine.width {
                let p = &mut fine.data[y * fine.width + x];
                let c = coarse.data[(y / 2) * coarse.width + x / 2];
                let missing = 1.0 - p[3].min(1.0);
                for i in 0..4 {
                    p[i] += c[i] * missing;
                }
            }
        }
    }
    for (pixel, filled) in picture.data.iter_mut().zip(&levels[0].data) {
        if pixel[3] < 255 && filled[3] > 0.0 {
            for c in 0..3 {
                pixel[c] = (filled[c] / filled[3]).round().clamp(0.0, 255.0) as u8;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn padding_fills_every_pixel_and_keeps_what_is_seen() {
        for size in [1, 7, 32] {
            let mut p = Picture::filled(size, size, [0, 0, 0, 0]);
            p.set(size / 2, size / 3, [90, 140, 40, 255]);
            pad_transparent(&mut p);
            assert!(p.data.iter().all(|q| q[..3] == [90, 140, 40]));
            assert_eq!(p.data.iter().filter(|q| q[3] == 255).count(), 1);
        }
        let mut empty = Picture::filled(4, 4, [0; 4]);
        pad_transparent(&mut empty);
        assert!(empty.data.iter().all(|q| q[3] == 0));
    }
}
