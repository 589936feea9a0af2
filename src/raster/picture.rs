//! Eight-bit RGBA pictures and their PNG form.

use image::ImageBuffer;

use super::geotiff::{Samples, hide};
use super::png;
use crate::diagnostic::{Error, Result};

/// An sRGB picture with straight (not premultiplied) alpha, row 0 on top.
#[derive(Debug, Clone, PartialEq)]
pub struct Picture {
    pub width: u32,
    pub height: u32,
    /// `width * height` pixels, row-major.
    pub data: Vec<[u8; 4]>,
}

/// PNG bytes of 16-bit samples, row 0 on top: grey for one a pixel, RGB for three.
///
/// # Errors
/// A number of samples that is neither.
pub fn deep_png(width: u32, height: u32, samples: Vec<u16>) -> Result<Vec<u8>> {
    let mut out = std::io::Cursor::new(Vec::new());
    let pixels = width as usize * height as usize;
    let image = match samples.len() {
        n if n == pixels => ImageBuffer::<image::Luma<u16>, _>::from_raw(width, height, samples)
            .map(image::DynamicImage::ImageLuma16),
        n if n == 3 * pixels => ImageBuffer::<image::Rgb<u16>, _>::from_raw(width, height, samples)
            .map(image::DynamicImage::ImageRgb16),
        _ => None,
    };
    let image = image.ok_or_else(|| Error::new("a picture's size and data disagree"))?;
    image
        .write_to(&mut out, image::ImageFormat::Png)
        .map_err(|e| Error::new(format!("a picture could not be encoded: {e}")))?;
    Ok(out.into_inner())
}

impl Picture {
    pub fn filled(width: u32, height: u32, colour: [u8; 4]) -> Self {
        Picture { width, height, data: vec![colour; width as usize * height as usize] }
    }

    /// Whether a mask hides some of it.
    pub fn is_cut(&self) -> bool {
        self.data.iter().any(|p| p[3] < 128)
    }

    /// Of the opaque pixels.
    pub fn mean_colour(&self) -> [u8; 4] {
        let opaque = || self.data.iter().filter(|p| p[3] >= 128);
        let count = opaque().count().max(1) as u64;
        let mean = |k: usize| (opaque().map(|p| u64::from(p[k])).sum::<u64>() / count) as u8;
        [mean(0), mean(1), mean(2), 255]
    }

    pub fn at(&self, x: u32, y: u32) -> [u8; 4] {
        self.data[(y * self.width + x) as usize]
    }

    pub fn set(&mut self, x: u32, y: u32, colour: [u8; 4]) {
        self.data[(y * self.width + x) as usize] = colour;
    }

    /// PNG bytes; RGB if every pixel is opaque, RGBA otherwise.
    pub fn to_png(&self) -> Result<Vec<u8>> {
        if !self.is_opaque() {
            return png::encode(self.width, self.height, &self.data);
        }
        let raw: Vec<[u8; 3]> = self.data.iter().map(|p| [p[0], p[1], p[2]]).collect();
        png::encode(self.width, self.height, &raw)
    }

    /// Of another size, each pixel the mean of those it covers.
    pub fn resized(&self, width: u32, height: u32) -> Picture {
        let raw = self.data.as_flattened().to_vec();
        let filter = image::imageops::FilterType::Triangle;
        ImageBuffer::<image::Rgba<u8>, _>::from_raw(self.width, self.height, raw).map_or_else(
            || Picture::filled(width, height, self.mean_colour()),
            |own| {
                let out = image::imageops::resize(&own, width, height, filter);
                let data = out.pixels().map(|p| p.0).collect();
                Picture { width, height, data }
            },
        )
    }

    pub fn is_opaque(&self) -> bool {
        self.data.iter().all(|p| p[3] == 255)
    }

    /// Decodes PNG or JPEG bytes of at most `most_px` pixels a side; the size is looked at first.
    pub fn from_bytes_within(bytes: &[u8], most_px: u32) -> Result<Self> {
        let reader = image::ImageReader::new(std::io::Cursor::new(bytes)).with_guessed_format();
        let size = reader.ok().and_then(|r| r.into_dimensions().ok());
        match size {
            Some((w, h)) if w > most_px || h > most_px => {
                Err(Error::new(format!("a picture of {w} × {h} pixels"))
                    .remedy(format!("give one of at most {most_px} × {most_px}")))
            }
            _ => Picture::from_bytes(bytes),
        }
    }

    /// Width and height that PNG or JPEG bytes announce; nothing is decoded.
    pub fn size_of(bytes: &[u8]) -> Result<(u32, u32)> {
        let reader = image::ImageReader::new(std::io::Cursor::new(bytes));
        let reader = reader.with_guessed_format().map_err(|e| refused(bytes, &e.into()))?;
        reader.into_dimensions().map_err(|e| refused(bytes, &e))
    }

    /// Decodes PNG or JPEG bytes.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self> {
        let image = decoded(bytes)?.to_rgba8();
        let (width, height) = image.dimensions();
        Ok(Picture { width, height, data: image.pixels().map(|p| p.0).collect() })
    }
}

fn decoded(bytes: &[u8]) -> Result<image::DynamicImage> {
    if is_cut_short(bytes) {
        return Err(Error::new("not a sound JPEG: it is cut short").remedy("give the whole file"));
    }
    image::load_from_memory(bytes).map_err(|e| refused(bytes, &e))
}

/// What is wrong with bytes that do not decode, without the decoder's own words.
fn refused(bytes: &[u8], why: &image::ImageError) -> Error {
    use image::{ImageError, ImageFormat};
    let kind = match image::guess_format(bytes) {
        Ok(ImageFormat::Png) => "PNG",
        Ok(ImageFormat::Jpeg) => "JPEG",
        _ => {
            return Error::new("not a readable picture: neither PNG nor JPEG")
                .remedy("give a PNG or JPEG file");
        }
    };
    match why {
        ImageError::Limits(_) => Error::new(format!("a {kind} too large to be read"))
            .remedy("save it again with fewer pixels"),
        ImageError::Unsupported(_) => Error::new(format!("a {kind} of a kind that is not read"))
            .remedy(format!("save it again as an ordinary {kind} of 8 bits, RGB")),
        _ => Error::new(format!("not a sound {kind}: it is damaged or cut short"))
            .remedy("open it in an image editor and save it again as PNG or JPEG"),
    }
}

/// Whether a JPEG ends before its marker of the end: decoders fill the rest with grey. A preview in its
/// head has an end of its own, before the scan of the picture begins.
fn is_cut_short(bytes: &[u8]) -> bool {
    let last = |marker: u8| bytes.windows(2).rposition(|pair| pair == [0xff, marker]);
    let (end, scan) = (last(0xd9), last(0xda));
    bytes.starts_with(&[0xff, 0xd8]) && scan.is_some() && end < scan
}

/// Width, height, bands and values of PNG or JPEG bytes: one band of grey, three of colour, four
/// with alpha; 8 or 16 bits. A pixel that its alpha hides is black.
pub(super) fn bands_from_bytes(bytes: &[u8]) -> Result<(usize, usize, usize, Samples)> {
    use image::DynamicImage;
    let image = decoded(bytes)?;
    let (width, height) = (image.width() as usize, image.height() as usize);
    let (bands, samples) = match image {
        DynamicImage::ImageLuma8(p) => (1, Samples::U8(p.into_raw())),
        DynamicImage::ImageRgb8(p) => (3, Samples::U8(p.into_raw())),
        DynamicImage::ImageLuma16(p) => (1, Samples::U16(p.into_raw())),
        DynamicImage::ImageRgb16(p) => (3, Samples::U16(p.into_raw())),
        DynamicImage::ImageRgba16(p) => {
            let mut raw = p.into_raw();
            hide(&mut raw, true);
            (4, Samples::U16(raw))
        }
        other => {
            let mut raw = other.to_rgba8().into_raw();
            hide(&mut raw, true);
            (4, Samples::U8(raw))
        }
    };
    Ok((width, height, bands, samples))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_jpeg_that_is_cut_short_is_refused() {
        let mut p = Picture::filled(64, 64, [90, 120, 60, 255]);
        (0..64).for_each(|i| p.set(i, i, [i as u8, 200, 3, 255]));
        let whole = crate::raster::jpeg(&p, 90).unwrap();
        assert!(Picture::from_bytes(&whole).is_ok());
        for cut in [2, whole.len() / 4] {
            let told = Picture::from_bytes(&whole[..whole.len() - cut]).unwrap_err();
            assert_eq!(told.message(), "not a sound JPEG: it is cut short");
        }
    }

    #[test]
    fn what_is_broken_is_told_in_plain_words() {
        let whole = Picture::filled(64, 64, [1, 2, 3, 255]).to_png().unwrap();
        // The name of the second chunk spoilt, its check sum, the end missing.
        let at = whole.windows(4).position(|name| name == b"IDAT").unwrap();
        let mut spoilt = whole.clone();
        spoilt[at..at + 4].copy_from_slice(b"bage");
        let mut flipped = whole.clone();
        flipped[at + 6] ^= 0xff;
        let cut = whole[..whole.len() / 2].to_vec();
        let mut head = whole.clone();
        head[12..16].copy_from_slice(b"bage");
        for bytes in [spoilt, flipped, cut, head.clone(), whole[..20].to_vec()] {
            let told = Picture::from_bytes(&bytes).unwrap_err();
            assert_eq!(told.message(), "not a sound PNG: it is damaged or cut short");
            assert!(told.remedy_text().unwrap().contains("save it again"));
        }
        assert!(Picture::size_of(&head).unwrap_err().message().starts_with("not a sound PNG"));
        let jpeg = Picture::from_bytes(b"\xff\xd8\xff\xe0 and no more").unwrap_err();
        assert!(jpeg.message().starts_with("not a sound JPEG"), "{jpeg}");
        let text = Picture::from_bytes(b"a text").unwrap_err();
        assert_eq!(text.message(), "not a readable picture: neither PNG nor JPEG");
    }

    #[test]
    fn png_round_trip_with_and_without_alpha() {
        for alpha in [255, 90] {
            let mut p = Picture::filled(5, 3, [1, 2, 3, 255]);
            p.set(4, 2, [9, 8, 7, alpha]);
            assert_eq!(Picture::from_bytes(&p.to_png().unwrap()).unwrap(), p);
        }
    }
}
