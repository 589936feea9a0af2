//! A picture as pixels, as PNG, or both.

use std::sync::{Arc, OnceLock};

use bytes::Bytes;

use super::Picture;
use crate::diagnostic::{Error, Result};

/// A picture of which pixels or PNG bytes are known; the other is made when first asked for, so
/// that what is only passed on is never decoded, and nothing is encoded twice.
#[derive(Debug, Clone)]
pub struct Image {
    width: u32,
    height: u32,
    pixels: OnceLock<Arc<Picture>>,
    png: OnceLock<Bytes>,
}

impl From<Picture> for Image {
    fn from(picture: Picture) -> Self {
        Image {
            width: picture.width,
            height: picture.height,
            pixels: OnceLock::from(Arc::new(picture)),
            png: OnceLock::new(),
        }
    }
}

/// By their pixels.
impl PartialEq for Image {
    fn eq(&self, other: &Self) -> bool {
        self.picture() == other.picture()
    }
}

impl Image {
    /// PNG bytes that [`Image::png`] gave; only their header is read here.
    ///
    /// # Errors
    /// Bytes that do not begin as a PNG does.
    pub fn from_png(png: Bytes) -> Result<Self> {
        let number = |at: usize| {
            let bytes = png.get(at..at + 4)?;
            Some(u32::from_be_bytes(bytes.try_into().ok()?))
        };
        match (png.get(..8), png.get(12..16), number(16), number(20)) {
            (Some(b"\x89PNG\r\n\x1a\n"), Some(b"IHDR"), Some(width), Some(height)) => {
                Ok(Image { width, height, pixels: OnceLock::new(), png: OnceLock::from(png) })
            }
            _ => Err(Error::new("not a PNG picture")),
        }
    }

    pub fn width(&self) -> u32 {
        self.width
    }

    pub fn height(&self) -> u32 {
        self.height
    }

    /// The pixels; grey where the PNG is broken.
    pub fn picture(&self) -> &Picture {
        self.pixels.get_or_init(|| {
            let decoded = self.png.get().and_then(|png| Picture::from_bytes(png).ok());
            Arc::new(decoded.unwrap_or_else(|| Picture::filled(1, 1, [128, 128, 128, 255])))
        })
    }

    /// The pixels, to change them.
    pub fn into_picture(self) -> Picture {
        self.picture();
        self.pixels.into_inner().map_or_else(|| Picture::filled(1, 1, [0; 4]), Arc::unwrap_or_clone)
    }

    /// PNG bytes as [`Picture::to_png`] gives them.
    ///
    /// # Errors
    /// A picture whose size and pixels disagree.
    pub fn png(&self) -> Result<Bytes> {
        if let Some(png) = self.png.get() {
            return Ok(png.clone());
        }
        let png = Bytes::from(self.picture().to_png()?);
        Ok(self.png.get_or_init(|| png).clone())
    }

    /// Whether no pixel lets anything through; of PNG bytes, whether they hold no alpha.
    pub fn is_opaque(&self) -> bool {
        /// Where the kind of colour stands, and RGB's.
        const COLOUR_TYPE: usize = 25;
        const RGB: u8 = 2;
        match self.png.get() {
            Some(png) => png.get(COLOUR_TYPE) == Some(&RGB),
            None => self.picture().is_opaque(),
        }
    }

    /// Its PNG bytes, where they need not be made.
    pub fn known_png(&self) -> Option<&Bytes> {
        self.png.get()
    }

    /// Whether as many pixels are held as the size says, and any.
    pub fn is_whole(&self) -> bool {
        let pixels = u64::from(self.width) * u64::from(self.height);
        let held = self.pixels.get().map_or(pixels, |p| p.data.len() as u64);
        pixels > 0 && pixels == held
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pixels_and_png_are_one_picture() {
        let mut picture = Picture::filled(7, 5, [10, 200, 30, 255]);
        picture.set(3, 2, [1, 2, 3, 40]);
        let drawn = Image::from(picture.clone());
        let read = Image::from_png(drawn.png().unwrap()).unwrap();
        assert_eq!((read.width(), read.height()), (7, 5));
        assert!(read.is_whole() && drawn.is_whole());
        assert_eq!(read, drawn);
        assert_eq!(read.png().unwrap(), drawn.png().unwrap());
        assert_eq!(read.into_picture(), picture);
    }

    #[test]
    fn what_is_no_png_is_refused_and_what_is_broken_is_grey() {
        for bytes in [&b""[..], b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff\xe0 a JPEG as it may begin"] {
            assert!(Image::from_png(Bytes::from_static(bytes)).is_err());
        }
        let mut png = Picture::filled(4, 4, [9; 4]).to_png().unwrap();
        png.truncate(40);
        assert_eq!(Image::from_png(png.into()).unwrap().picture().data.len(), 1);
    }
}
