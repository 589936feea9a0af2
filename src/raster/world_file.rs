//! Rasters of any format read here, and the world files beside them: six lines that place a picture
//! (ESRI): width of a pixel, two rotations, height of a pixel (negative), x and y of the middle of
//! the upper left pixel. They tell no coordinate system.

use std::fs::File;
use std::io::Read as _;
use std::path::{Path, PathBuf};

use super::geotiff::{self, Raster};
use super::{GridGeometry, picture};
use crate::diagnostic::{Error, Result};

/// World files are a few numbers long.
const LONGEST: u64 = 4096;

/// Reads a GeoTIFF, a PNG or a JPEG. Where the file does not say where it lies, a world file beside
/// it does.
///
/// # Errors
/// Names the file: those of [`geotiff::read`], a picture that can't be read, a world file that is
/// none or that rotates.
pub fn read(path: &Path) -> Result<Raster> {
    let mut start = Vec::new();
    let opened = File::open(path).and_then(|file| file.take(4).read_to_end(&mut start));
    opened.map_err(|e| {
        Error::new(format!("cannot be opened: {e}"))
            .in_file(path)
            .remedy("check the path of the photo or raster")
    })?;
    let is_picture = start == [0x89, b'P', b'N', b'G'] || start.starts_with(&[0xff, 0xd8]);
    let mut raster = if is_picture { read_picture(path)? } else { geotiff::read(path)? };
    if raster.geometry.is_none()
        && let Some(world) = beside(path)
    {
        let text = text(&world).map_err(|e| e.in_file(&world))?;
        let geometry = place(&text, raster.width, raster.height).map_err(|e| e.in_file(&world))?;
        raster.geometry = Some(geometry);
    }
    Ok(raster)
}

fn read_picture(path: &Path) -> Result<Raster> {
    let fail = |e: Error| e.in_file(path);
    let bytes =
        std::fs::read(path).map_err(|e| fail(Error::new(format!("cannot be read: {e}"))))?;
    let (width, height, bands, samples) = picture::bands_from_bytes(&bytes).map_err(fail)?;
    Ok(Raster { width, height, bands, samples, geometry: None, epsg: None, nodata: None })
}

/// The world file of a picture: `a.pgw`, `a.pngw` or `a.wld` of `a.png`, also in capitals.
fn beside(path: &Path) -> Option<PathBuf> {
    let extension = path.extension()?.to_str()?;
    let (first, last) = (extension.chars().next()?, extension.chars().next_back()?);
    let names = [format!("{first}{last}w"), format!("{extension}w"), "wld".to_owned()];
    let cases = names.iter().flat_map(|name| [name.to_lowercase(), name.to_uppercase()]);
    cases.map(|name| path.with_extension(name)).find(|world| world.is_file())
}

fn text(world: &Path) -> Result<String> {
    let mut text = String::new();
    File::open(world)
        .and_then(|file| file.take(LONGEST).read_to_string(&mut text))
        .map_err(|e| Error::new(format!("cannot be read: {e}")).remedy(SIX))?;
    Ok(text)
}

const SIX: &str = "a world file holds six numbers, one a line";

fn place(text: &str, cols: usize, rows: usize) -> Result<GridGeometry> {
    let numbers: Vec<f64> =
        text.split_whitespace().filter_map(|word| word.replace(',', ".").parse().ok()).collect();
    let Some(&[cell_x, turn_y, turn_x, minus_cell_y, x, y]) = numbers.first_chunk::<6>() else {
        return Err(Error::new("is no world file").remedy(SIX));
    };
    if turn_x != 0.0 || turn_y != 0.0 {
        return Err(Error::new("the picture is rotated against north")
            .remedy("warp it to north-up first, e.g. `gdalwarp in.png out.tif`"));
    }
    let cell_y = -minus_cell_y;
    let is_finite = [cell_x, cell_y, x, y].iter().all(|v| v.is_finite());
    if !is_finite || cell_x <= 0.0 || cell_y <= 0.0 {
        return Err(Error::new("is no world file of a north-up picture").remedy(
            "its first number is the width of a pixel, its fourth the height with a minus sign",
        ));
    }
    Ok(GridGeometry { west: x - 0.5 * cell_x, north: y + 0.5 * cell_y, cell_x, cell_y, cols, rows })
}

#[cfg(test)]
mod tests {
    use super::super::Picture;
    use super::super::geotiff::Samples;
    use super::*;

    #[test]
    fn a_world_file_places_a_picture() {
        let folder = tempfile::tempdir().unwrap();
        let png = Picture { width: 3, height: 2, data: vec![[10, 20, 30, 255]; 6] };
        let path = folder.path().join("photo.png");
        std::fs::write(&path, png.to_png().unwrap()).unwrap();
        assert_eq!(read(&path).unwrap().geometry, None);
        for name in ["photo.wld", "photo.pgw", "photo.PGW", "photo.pngw"] {
            let world = folder.path().join(name);
            std::fs::write(&world, "0.5\n0\n0.0\n-0.5\n500000.25\r\n6200000,75\n").unwrap();
            let raster = read(&path).unwrap();
            let expected = GridGeometry {
                west: 500_000.0,
                north: 6_200_001.0,
                cell_x: 0.5,
                cell_y: 0.5,
                cols: 3,
                rows: 2,
            };
            assert_eq!(raster.geometry, Some(expected), "{name}");
            assert_eq!((raster.bands, raster.value(2, 1, 1)), (3, 20.0));
            std::fs::remove_file(world).unwrap();
        }
        for (text, message) in [
            ("0.5\n0.1\n0.1\n-0.5\n0\n0\n", "the picture is rotated against north"),
            ("0.5\n0\n0\n0.5\n0\n0\n", "is no world file of a north-up picture"),
            ("nan 0 0 -1 0 0", "is no world file of a north-up picture"),
            ("hello", "is no world file"),
        ] {
            let world = folder.path().join("photo.pgw");
            std::fs::write(&world, text).unwrap();
            let error = read(&path).unwrap_err();
            assert_eq!(error.message(), message);
            assert!(error.to_string().contains("photo.pgw") && error.remedy_text().is_some());
        }
    }

    #[test]
    fn pictures_keep_their_bits_and_their_holes() {
        let folder = tempfile::tempdir().unwrap();
        let holed = Picture { width: 2, height: 1, data: vec![[9, 8, 7, 0], [9, 8, 7, 255]] };
        let path = folder.path().join("holed.png");
        std::fs::write(&path, holed.to_png().unwrap()).unwrap();
        assert_eq!(read(&path).unwrap().samples, Samples::U8(vec![0, 0, 0, 0, 9, 8, 7, 255]));
        std::fs::write(&path, b"\x89PNG and no more").unwrap();
        let error = read(&path).unwrap_err();
        assert!(error.to_string().contains("holed.png"), "{error}");
    }
}
