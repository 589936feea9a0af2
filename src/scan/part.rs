//! The points of one file, before the files share an origin.

use glam::DVec3;
use std::path::PathBuf;

use super::Removed;
use crate::frame::Crs;

/// World coordinates as the file holds them, so that the origin can be chosen from exact values.
#[derive(Debug)]
pub(super) enum Coordinates {
    /// Integers times scale plus offset (LAS). Every i32 gives a finite coordinate.
    Scaled { steps: Vec<[i32; 3]>, scale: DVec3, offset: DVec3 },
    /// As written (text). All finite.
    Real(Vec<DVec3>),
}

impl Coordinates {
    pub fn len(&self) -> usize {
        match self {
            Coordinates::Scaled { steps, .. } => steps.len(),
            Coordinates::Real(world) => world.len(),
        }
    }

    /// World coordinates of point `i`; `None` past the end.
    pub fn get(&self, i: usize) -> Option<DVec3> {
        match self {
            Coordinates::Scaled { steps, scale, offset } => {
                steps.get(i).map(|s| world_from_steps(*s, *scale, *offset))
            }
            Coordinates::Real(world) => world.get(i).copied(),
        }
    }

    /// Keeps the points whose flag is true; flags are as many as points.
    pub fn retain(&mut self, keep: &[bool]) {
        match self {
            Coordinates::Scaled { steps, .. } => retain(steps, keep),
            Coordinates::Real(world) => retain(world, keep),
        }
    }
}

pub(super) fn world_from_steps(steps: [i32; 3], scale: DVec3, offset: DVec3) -> DVec3 {
    DVec3::new(f64::from(steps[0]), f64::from(steps[1]), f64::from(steps[2])) * scale + offset
}

fn retain<T>(column: &mut Vec<T>, keep: &[bool]) {
    let mut flags = keep.iter();
    column.retain(|_| flags.next().copied().unwrap_or(true));
}

/// The columns beside the coordinates, of equal length.
#[derive(Debug, Default)]
pub(super) struct Columns {
    pub intensity: Vec<u16>,
    pub return_number: Vec<u8>,
    pub return_count: Vec<u8>,
    pub class: Vec<u8>,
    pub rgb: Option<Vec<[u16; 3]>>,
}

impl Columns {
    pub fn append(&mut self, other: &mut Columns) {
        self.intensity.append(&mut other.intensity);
        self.return_number.append(&mut other.return_number);
        self.return_count.append(&mut other.return_count);
        self.class.append(&mut other.class);
        if let (Some(rgb), Some(other)) = (&mut self.rgb, &mut other.rgb) {
            rgb.append(other);
        }
    }

    pub fn shrink_to_fit(&mut self) {
        self.intensity.shrink_to_fit();
        self.return_number.shrink_to_fit();
        self.return_count.shrink_to_fit();
        self.class.shrink_to_fit();
        if let Some(rgb) = &mut self.rgb {
            rgb.shrink_to_fit();
        }
    }

    pub fn retain(&mut self, keep: &[bool]) {
        retain(&mut self.intensity, keep);
        retain(&mut self.return_number, keep);
        retain(&mut self.return_count, keep);
        retain(&mut self.class, keep);
        if let Some(rgb) = &mut self.rgb {
            retain(rgb, keep);
        }
    }
}

/// One file as read.
#[derive(Debug)]
pub(super) struct Part {
    pub path: PathBuf,
    pub crs: Option<Crs>,
    /// The system is known to count degrees, so the coordinates are no lengths.
    pub in_degrees: bool,
    pub coordinates: Coordinates,
    pub columns: Columns,
    pub in_file: u64,
    pub removed: Removed,
    pub warnings: Vec<String>,
}
