//! WebP with loss, by libwebp.

use bytes::Bytes;
use webp::{Encoder, WebPConfig};

use super::Picture;
use crate::diagnostic::{Error, Result};

/// Longest side that the format takes, pixels.
const MOST_PX: u32 = 16_383;

/// Encodes at `quality` 0…100. Colours under transparent pixels are kept, as renderers blend them
/// in at edges.
///
/// # Errors
/// A picture with a side of more than 16,383 pixels.
pub fn encode(picture: &Picture, quality: f32) -> Result<Bytes> {
    let Picture { width, height, .. } = *picture;
    if width.max(height) > MOST_PX {
        return Err(Error::new(format!(
            "{width} × {height} pixels are more than WebP's {MOST_PX} a side"
        ))
        .remedy("choose a smaller --texture, or a profile with PNG textures"));
    }
    let refused = |why: String| Error::new(format!("can't be coded as WebP: {why}"));
    let mut config = WebPConfig::new().map_err(|()| refused("no settings".into()))?;
    config.quality = quality;
    config.method = 4;
    config.exact = 1;
    config.use_sharp_yuv = 1;
    let pixels = picture.data.as_flattened();
    let encoded = Encoder::from_rgba(pixels, width, height).encode_advanced(&config);
    let encoded = encoded.map_err(|e| refused(format!("{e:?}")))?;
    Ok(Bytes::copy_from_slice(&encoded))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_picture_comes_back_nearly_as_it_was() {
        let mut picture = Picture::filled(64, 64, [0; 4]);
        for y in 0..64 {
            for x in 0..64 {
                let inside = (x as i32 - 32).pow(2) + (y as i32 - 32).pow(2) < 400;
                picture.set(x, y, [90, 2 * y as u8 + 60, 40, if inside { 255 } else { 0 }]);
            }
        }
        let bytes = encode(&picture, 80.0).unwrap();
        let decoded = webp::Decoder::new(&bytes).decode().unwrap();
        assert_eq!((decoded.width(), decoded.height()), (64, 64));
        for (theirs, ours) in decoded.chunks_exact(4).zip(&picture.data) {
            assert_eq!(theirs[3], ours[3]);
            // Under transparent pixels, too.
            for k in 0..3 {
                assert!(theirs[k].abs_diff(ours[k]) < 16, "{theirs:?} {ours:?}");
            }
        }
    }

    #[test]
    fn a_picture_too_large_is_refused() {
        let error = encode(&Picture::filled(16_384, 1, [0; 4]), 80.0).unwrap_err();
        assert_eq!(
            format!("{error:?}"),
            "16384 × 1 pixels are more than WebP's 16383 a side (remedy: choose a smaller \
             --texture, or a profile with PNG textures)"
        );
    }
}
