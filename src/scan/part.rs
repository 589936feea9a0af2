//! The points of one file, before the files share an origin.

use std::path::PathBuf;

use glam::DVec3;
use rayon::prelude::*;

use super::Removed;
use crate::frame::{Crs, extremes};

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

    /// World coordinates; `None` without points.
    pub fn bounds(&self) -> Option<(DVec3, DVec3)> {
        let [a, b] = match self {
            // World coordinates grow with the steps, or fall.
            Coordinates::Scaled { steps, scale, offset } => extremes(steps, i32::MAX, i32::MIN)?
                .map(|steps| world_from_steps(steps, *scale, *offset)),
            Coordinates::Real(world) => {
                extremes(bytemuck::cast_slice(world), f64::INFINITY, f64::NEG_INFINITY)?
                    .map(DVec3::from)
            }
        };
        Some((a.min(b), a.max(b)))
    }

    /// Takes the points of another piece of the same file; false, and nothing taken, where their
    /// steps differ.
    pub fn append(&mut self, other: &mut Coordinates) -> bool {
        use Coordinates::{Real, Scaled};
        match (self, other) {
            (Real(own), Real(more)) => own.append(more),
            (
                Scaled { steps: own, scale, offset },
                Scaled { steps: more, scale: other_scale, offset: other_offset },
            ) if (*scale, *offset) == (*other_scale, *other_offset) => own.append(more),
            _ => return false,
        }
        true
    }

    /// Without the points of these numbers, ascending.
    pub fn leave_out(&mut self, out: &[usize]) {
        match self {
            Coordinates::Scaled { steps, .. } => leave_out(steps, out),
            Coordinates::Real(world) => leave_out(world, out),
        }
    }
}

pub(super) fn world_from_steps(steps: [i32; 3], scale: DVec3, offset: DVec3) -> DVec3 {
    DVec3::new(f64::from(steps[0]), f64::from(steps[1]), f64::from(steps[2])) * scale + offset
}

/// What lies between two that go is moved in one piece: few go.
fn leave_out<T: Copy>(column: &mut Vec<T>, out: &[usize]) {
    let ends = out.iter().skip(1).copied().chain([column.len()]);
    let mut kept = out.first().copied().unwrap_or(column.len());
    for (gone, end) in out.iter().zip(ends) {
        column.copy_within(gone + 1..end, kept);
        kept += end - (gone + 1);
    }
    column.truncate(kept);
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

    /// Without the points of these numbers, ascending.
    pub fn leave_out(&mut self, out: &[usize]) {
        rayon::scope(|s| {
            s.spawn(|_| leave_out(&mut self.intensity, out));
            s.spawn(|_| leave_out(&mut self.return_number, out));
            s.spawn(|_| leave_out(&mut self.return_count, out));
            s.spawn(|_| leave_out(&mut self.class, out));
            if let Some(rgb) = &mut self.rgb {
                s.spawn(|_| leave_out(rgb, out));
            }
        });
    }
}

/// How a file's colours fill the 16-bit range.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum ColourScale {
    /// All are black, which is how files without colours fill the fields.
    None,
    /// Many writers store 8 bits in the 16-bit fields.
    Eight,
    Sixteen,
}

impl ColourScale {
    pub fn of(brightest: u16) -> Self {
        match brightest {
            0 => ColourScale::None,
            1..=255 => ColourScale::Eight,
            _ => ColourScale::Sixteen,
        }
    }

    /// Colours over the whole range, or none.
    pub fn apply(self, rgb: &mut Option<Vec<[u16; 3]>>) {
        match self {
            ColourScale::None => *rgb = None,
            ColourScale::Eight => {
                let rgb = rgb.as_deref_mut().unwrap_or_default().as_flattened_mut();
                rgb.par_iter_mut().for_each(|v| *v = v.saturating_mul(257));
            }
            ColourScale::Sixteen => {}
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
    /// Of the points kept, world coordinates; `None` without points.
    pub bounds: Option<(DVec3, DVec3)>,
    pub colour: ColourScale,
    pub in_file: u64,
    pub removed: Removed,
    pub warnings: Vec<String>,
}

impl Part {
    /// Places without a file, for what looks at places alone.
    pub fn of_places(world: Vec<DVec3>) -> Part {
        let coordinates = Coordinates::Real(world);
        Part {
            path: PathBuf::new(),
            crs: None,
            in_degrees: false,
            bounds: coordinates.bounds(),
            coordinates,
            columns: Columns::default(),
            colour: ColourScale::None,
            in_file: 0,
            removed: Removed::default(),
            warnings: Vec::new(),
        }
    }
}
