//! JPEG (ITU-T T.81), its colours at full resolution.

use bytes::Bytes;
use image::ExtendedColorType;
use image::codecs::jpeg::JpegEncoder;

use super::Picture;
use crate::diagnostic::{Error, Result};

/// Longest side that the format takes, pixels.
pub const MOST_JPEG_PX: u32 = 65_535;

/// Encodes the colours at `quality` 1…100; alpha is not kept.
///
/// # Errors
/// A picture whose size and pixels disagree, or with a side of more than [`MOST_JPEG_PX`].
pub fn encode(picture: &Picture, quality: u8) -> Result<Bytes> {
    let Picture { width, height, .. } = *picture;
    let refused = |why: String| Error::new(format!("can't be coded as JPEG: {why}"));
    if picture.data.len() as u64 != u64::from(width) * u64::from(height) {
        return Err(refused("its size and data disagree".into()));
    }
    let raw: Vec<u8> = picture.data.iter().flat_map(|p| [p[0], p[1], p[2]]).collect();
    let mut out = Vec::new();
    JpegEncoder::new_with_quality(&mut out, quality)
        .encode(&raw, width, height, ExtendedColorType::Rgb8)
        .map_err(|e| refused(e.to_string()))?;
    Ok(out.into())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colours_come_back_nearly() {
        let at = |k: u32| [(k % 97) as u8 * 2, (k / 64) as u8 * 3, 90, 255];
        let picture = Picture { width: 64, height: 48, data: (0..64 * 48).map(at).collect() };
        let bytes = encode(&picture, 92).unwrap();
        let back = Picture::from_bytes(&bytes).unwrap();
        assert_eq!((back.width, back.height), (64, 48));
        let off = |(a, b): (&[u8; 4], &[u8; 4])| (0..3).map(|c| a[c].abs_diff(b[c])).max();
        let worst = back.data.iter().zip(&picture.data).filter_map(off).max();
        assert!(worst < Some(60), "{worst:?}");
        let mean: f64 = back.data.iter().zip(&picture.data).filter_map(off).map(f64::from).sum();
        assert!(mean / 3072.0 < 6.0, "{mean}");
        assert!(encode(&Picture { width: 63, ..picture }, 92).is_err());
    }
}
