//! LAS, LAZ and XYZ files to one [`PointCloud`] in local metres, with noise removed; and a cloud
//! back to LAZ. Knows nothing of what points mean.

mod crs;
mod epsg;
mod isolated;
mod las_file;
mod laz_chunks;
mod merge;
mod part;
mod shared;
#[cfg(test)]
mod tests;
mod text;
pub mod tiles;
mod wkt;
mod write;

use std::io::Write;
use std::ops::Deref;
use std::path::PathBuf;

use glam::Vec3;
use serde::Serialize;

use crate::diagnostic::{Error, Result, Warned};
use crate::frame::{Crs, Frame};

pub use crs::system;
pub use las_file::stated_points;
pub use merge::MAX_EXTENT_M;
pub use write::encode_laz;

/// Files of one area.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Files {
    pub paths: Vec<PathBuf>,
    /// Of those that state none; they count metres where it is `None`.
    pub crs: Option<Crs>,
}

impl Deref for Files {
    type Target = [PathBuf];

    fn deref(&self) -> &[PathBuf] {
        &self.paths
    }
}

impl<P: AsRef<[PathBuf]>> From<P> for Files {
    fn from(paths: P) -> Self {
        Files { paths: paths.as_ref().to_vec(), crs: None }
    }
}

impl From<&Files> for Files {
    fn from(files: &Files) -> Self {
        files.clone()
    }
}

/// Points as columns of equal length, in local metres, Z up.
#[derive(Debug, Clone)]
pub struct PointCloud {
    pub frame: Frame,
    pub position: Vec<Vec3>,
    pub intensity: Vec<u16>,
    /// 1-based; 1 where the file says nothing sound.
    pub return_number: Vec<u8>,
    /// Returns of the pulse, >= `return_number`.
    pub return_count: Vec<u8>,
    /// ASPRS class code, as in the file.
    pub class: Vec<u8>,
    /// 16-bit colour where the file carries it.
    pub rgb: Option<Vec<[u16; 3]>>,
}

impl PointCloud {
    pub fn len(&self) -> usize {
        self.position.len()
    }

    pub fn is_empty(&self) -> bool {
        self.position.is_empty()
    }

    /// Keeps the points for whose number `is_kept` holds.
    pub fn retain(&mut self, is_kept: impl Fn(usize) -> bool) {
        fn of<T>(column: &mut Vec<T>, is_kept: &impl Fn(usize) -> bool) {
            let mut numbers = 0..;
            column.retain(|_| numbers.next().is_some_and(is_kept));
        }
        of(&mut self.position, &is_kept);
        of(&mut self.intensity, &is_kept);
        of(&mut self.return_number, &is_kept);
        of(&mut self.return_count, &is_kept);
        of(&mut self.class, &is_kept);
        if let Some(rgb) = &mut self.rgb {
            of(rgb, &is_kept);
        }
    }

    /// What breaks the invariants: columns of equal length, finite positions, return numbers in
    /// 1..=count, a finite origin.
    pub fn check(&self) -> std::result::Result<(), String> {
        let n = self.len();
        let lengths = [
            ("intensity", self.intensity.len()),
            ("return_number", self.return_number.len()),
            ("return_count", self.return_count.len()),
            ("class", self.class.len()),
            ("rgb", self.rgb.as_ref().map_or(n, Vec::len)),
        ];
        if let Some((name, length)) = lengths.into_iter().find(|(_, length)| *length != n) {
            return Err(format!("{n} positions but {length} of {name}"));
        }
        if !self.frame.origin.is_finite() {
            return Err("the origin is not finite".into());
        }
        if let Some(i) = self.position.iter().position(|p| !p.is_finite()) {
            return Err(format!("point {i} is not finite"));
        }
        let returns = self.return_number.iter().zip(&self.return_count);
        if let Some(i) = returns.clone().position(|(number, count)| *number < 1 || number > count) {
            return Err(format!("point {i} has a return number outside 1..=count"));
        }
        Ok(())
    }
}

/// What [`read`] keeps.
#[derive(Debug, Clone, PartialEq)]
pub struct ReadOptions {
    /// Drop points of class 7 (low noise) and 18 (high noise).
    pub drop_noise_classes: bool,
    /// Drop points with almost nothing around them.
    pub drop_isolated: bool,
    /// Let the origin be a multiple of [`ALIGNMENT_M`], so that grids do not shift with what else
    /// is read.
    pub is_aligned: bool,
}

/// A multiple of every cell that is chosen from a density, and of the coarsest grids.
pub const ALIGNMENT_M: f64 = 480.0;

impl Default for ReadOptions {
    fn default() -> Self {
        ReadOptions { drop_noise_classes: true, drop_isolated: true, is_aligned: false }
    }
}

/// Points dropped at reading (set E of T15 as far as the file or the surroundings show it), by
/// reason. A point counts once, under the first reason that holds.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct Removed {
    pub not_finite: u64,
    /// The withheld flag is set: the producer asks that the point be left out.
    pub withheld: u64,
    /// Class 7.
    pub low_noise: u64,
    /// Class 18.
    pub high_noise: u64,
    pub isolated: u64,
}

impl Removed {
    pub fn total(&self) -> u64 {
        self.not_finite + self.withheld + self.low_noise + self.high_noise + self.isolated
    }

    fn add(&mut self, other: &Removed) {
        self.not_finite += other.not_finite;
        self.withheld += other.withheld;
        self.low_noise += other.low_noise;
        self.high_noise += other.high_noise;
        self.isolated += other.isolated;
    }
}

/// Where the points of the files went: `in_files` = `kept` + `removed.total()`.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct Census {
    pub files: u32,
    pub in_files: u64,
    pub kept: u64,
    pub removed: Removed,
}

/// An axis-aligned box in local metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bounds {
    pub min: Vec3,
    pub max: Vec3,
}

impl Bounds {
    /// Into another frame.
    pub fn moved(self, by: Vec3) -> Bounds {
        Bounds { min: self.min + by, max: self.max + by }
    }
}

/// A cloud as read, with what is known of it.
#[derive(Debug, Clone)]
pub struct Scan {
    pub cloud: PointCloud,
    pub census: Census,
    /// Points per occupied cell of 1 m × 1 m.
    pub density_per_m2: f32,
    /// Of the points kept.
    pub bounds: Bounds,
}

/// As [`read`], of the bytes of one LAS or LAZ file, by way of a temporary one.
///
/// # Errors
/// Those of [`read`]; a temporary folder that can't be written to.
pub fn read_bytes(bytes: &[u8], options: &ReadOptions) -> Result<Warned<Scan>> {
    let failed = |e: std::io::Error| Error::new(format!("no temporary file can be written: {e}"));
    let mut file = tempfile::Builder::new().suffix(".laz").tempfile().map_err(failed)?;
    file.write_all(bytes).map_err(failed)?;
    read([file.path().to_path_buf()], options)
}

/// Reads all files into one cloud in one frame. Never empty.
///
/// The origin is the least coordinate of the points kept, floored to 10 world units, or to
/// [`ALIGNMENT_M`] where asked for. Points keep
/// the order of the files and of the points in them.
///
/// # Errors
/// One that names the file: it is missing, is no scan, is damaged or cut short; it holds no
/// points; its coordinates are degrees; the files are in different systems; the points span more
/// than [`MAX_EXTENT_M`].
pub fn read(files: impl Into<Files>, options: &ReadOptions) -> Result<Warned<Scan>> {
    merge::read(&files.into(), options)
}
