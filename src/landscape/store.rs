//! A landscape in a file of its own (`.voxels`): a line that names the format, then a line of JSON and
//! the arrays one after the other, deflated with a checksum (gzip). What is read is checked before it
//! is used: a cut, changed or foreign file is refused.

use std::io::{self, BufRead, BufReader, Read, Write};
use std::path::Path;

use flate2::Compression;
use flate2::bufread::GzDecoder;
use flate2::write::GzEncoder;
use glam::{DVec3, Vec3};
use serde::{Deserialize, Serialize};

use super::blocks::Blocks;
use super::dag::{Dag, Ref};
use super::patchwork::Patchwork;
use super::{Colours, Heights, Landscape};
use crate::diagnostic::{Error, Result};
use crate::frame::{Crs, Frame};

const NAME: &str = "larix voxels 1\n";

#[derive(Serialize, Deserialize)]
struct Head {
    origin: [f64; 3],
    crs: Option<HeadCrs>,
    first_m: [f32; 3],
    voxel_m: f32,
    sides: [u32; 3],
    words: usize,
    root: Option<u32>,
    levels: u32,
    density_bits: u32,
    height_stride: u32,
    height_base: f32,
    height_step: f32,
    heights: Sheet,
    colour_stride: u32,
    colours: Vec<Sheet>,
}

#[derive(Serialize, Deserialize)]
struct HeadCrs {
    epsg: Option<u32>,
    wkt: Option<String>,
    horizontal_unit_m: f64,
    vertical_unit_m: f64,
}

/// The measures of a patchwork.
#[derive(Serialize, Deserialize)]
struct Sheet {
    cols: usize,
    rows: usize,
    samples: usize,
}

impl Sheet {
    fn of<T>(work: &Patchwork<T>) -> Sheet {
        Sheet { cols: work.cols, rows: work.rows, samples: work.samples.len() }
    }
}

fn put<T: bytemuck::NoUninit>(values: &[T], out: &mut impl Write) -> io::Result<()> {
    #[cfg(target_endian = "big")]
    compile_error!("arrays are written as they are in memory, which is little endian");
    out.write_all(bytemuck::cast_slice(values))
}

/// Values of one array, at most.
const MOST_VALUES: usize = 1 << 29;
/// What is equal is kept once, so that little is left to deflate: bytes unpacked from one, at most,
/// and those that are free of this.
const MOST_UNPACKED: u64 = 64;
const FREE: u64 = 1 << 26;

/// Counts the bytes taken from a reader.
struct Counted<R> {
    from: R,
    taken: u64,
}

impl<R: BufRead> Read for Counted<R> {
    fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
        let count = self.from.read(into)?;
        self.taken += count as u64;
        Ok(count)
    }
}

impl<R: BufRead> BufRead for Counted<R> {
    fn fill_buf(&mut self) -> io::Result<&[u8]> {
        self.from.fill_buf()
    }

    fn consume(&mut self, count: usize) {
        self.taken += count as u64;
        self.from.consume(count);
    }
}

type Packed<R> = BufReader<GzDecoder<Counted<R>>>;

/// Reads as many values as the head says, without asking for their room before they are there.
fn get<T: bytemuck::AnyBitPattern>(
    count: usize,
    from: &mut Packed<impl BufRead>,
) -> io::Result<Vec<T>> {
    let mut values = Vec::new();
    let mut bytes = vec![0u8; (1 << 20) / size_of::<T>() * size_of::<T>()];
    if count > MOST_VALUES {
        return Err(io::Error::new(io::ErrorKind::InvalidData, "its description is out of range"));
    }
    let mut left = count * size_of::<T>();
    while left > 0 {
        let part = left.min(bytes.len());
        from.read_exact(&mut bytes[..part])?;
        values.extend(
            bytes[..part].chunks_exact(size_of::<T>()).map(bytemuck::pod_read_unaligned::<T>),
        );
        left -= part;
        let unpacked = (values.len() * size_of::<T>()) as u64;
        if unpacked > FREE + MOST_UNPACKED * from.get_ref().get_ref().taken {
            let why = "it unpacks to more than a landscape of its size holds";
            return Err(io::Error::new(io::ErrorKind::InvalidData, why));
        }
    }
    values.shrink_to_fit();
    Ok(values)
}

impl Landscape {
    /// The file's bytes, to a sink.
    ///
    /// # Errors
    /// Those of the sink.
    pub fn write(&self, out: &mut dyn Write) -> io::Result<()> {
        let crs = self.frame.crs.as_ref().map(|crs| HeadCrs {
            epsg: crs.epsg,
            wkt: crs.wkt.clone(),
            horizontal_unit_m: crs.horizontal_unit_m,
            vertical_unit_m: crs.vertical_unit_m,
        });
        let head = Head {
            origin: self.frame.origin.to_array(),
            crs,
            first_m: self.first_m.to_array(),
            voxel_m: self.voxel_m,
            sides: self.sides,
            words: self.dag.words.len(),
            root: self.dag.root.map(|root| root.0),
            levels: self.dag.levels,
            density_bits: self.dag.planes,
            height_stride: self.heights.stride,
            height_base: self.heights.base,
            height_step: self.heights.step,
            heights: Sheet::of(&self.heights.samples),
            colour_stride: self.colours.stride,
            colours: self.colours.levels.iter().map(Sheet::of).collect(),
        };
        out.write_all(NAME.as_bytes())?;
        let mut packed = GzEncoder::new(out, Compression::new(6));
        serde_json::to_writer(&mut packed, &head)?;
        packed.write_all(b"\n")?;
        put(&self.dag.words, &mut packed)?;
        put(&self.heights.samples.places, &mut packed)?;
        put(&self.heights.samples.samples, &mut packed)?;
        for level in &self.colours.levels {
            put(&level.places, &mut packed)?;
            put(&level.samples, &mut packed)?;
        }
        packed.finish()?.flush()
    }

    /// Whether a file is named as one of these, or says so of itself.
    pub fn is_stored(path: &Path) -> bool {
        let mut name = [0u8; NAME.len()];
        let read = std::fs::File::open(path).and_then(|mut file| file.read_exact(&mut name));
        let is_named = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("voxels"));
        is_named || read.is_ok() && name.starts_with(b"larix voxels ")
    }

    /// Reads a file that [`Landscape::write`] wrote.
    ///
    /// # Errors
    /// A file that can't be read, is none of these, of a later version, cut short or changed.
    pub fn read(path: &Path) -> Result<Landscape> {
        let file = std::fs::File::open(path)
            .map_err(|e| Error::new(format!("can't be read: {e}")).in_file(path))
            .map_err(|e| e.remedy("make it with `larix landscape SCAN --save FILE.voxels`"))?;
        Landscape::read_from(BufReader::new(file)).map_err(|e| e.in_file(path))
    }

    /// [`Landscape::read`] of bytes.
    ///
    /// # Errors
    /// As [`Landscape::read`].
    pub fn read_from(mut from: impl BufRead) -> Result<Landscape> {
        let remedy = "save the landscape again with --save";
        let broken =
            |why: &str| Error::new(format!("the landscape file is broken: {why}")).remedy(remedy);
        let cut = |e: io::Error| match e.kind() {
            io::ErrorKind::UnexpectedEof => broken("it is cut short"),
            _ => broken(&e.to_string()),
        };
        /// A line of JSON is no longer than this, projections as text included.
        const LONGEST: u64 = 1 << 20;
        let mut name = Vec::new();
        from.by_ref().take(NAME.len() as u64 + 8).read_until(b'\n', &mut name).map_err(cut)?;
        if name != NAME.as_bytes() {
            let is_other = name.starts_with(b"larix voxels ");
            return Err(match is_other {
                true => Error::new("a landscape of another version").remedy(remedy),
                false => Error::new("not a landscape file")
                    .remedy("give a scan (.las, .laz, .xyz) or a file made with --save"),
            });
        }
        let mut line = Vec::new();
        let mut packed = BufReader::new(GzDecoder::new(Counted { from, taken: 0 }));
        packed.by_ref().take(LONGEST).read_until(b'\n', &mut line).map_err(cut)?;
        let head: Head = serde_json::from_slice(&line)
            .map_err(|_| broken("its description can't be understood"))?;
        let words = get(head.words, &mut packed).map_err(cut)?;
        let count = |sheet: &Sheet| {
            sheet
                .cols
                .checked_mul(sheet.rows)
                .ok_or_else(|| broken("its description is out of range"))
        };
        let heights = Patchwork {
            cols: head.heights.cols,
            rows: head.heights.rows,
            places: get(count(&head.heights)?, &mut packed).map_err(cut)?,
            samples: get(head.heights.samples, &mut packed).map_err(cut)?,
        };
        let mut levels = Vec::new();
        for sheet in &head.colours {
            levels.push(Patchwork {
                cols: sheet.cols,
                rows: sheet.rows,
                places: get(count(sheet)?, &mut packed).map_err(cut)?,
                samples: get(sheet.samples, &mut packed).map_err(cut)?,
            });
        }
        // The checksum is looked at when the end is reached.
        let mut rest = [0u8; 1];
        if packed.read(&mut rest).map_err(cut)? != 0
            || !packed.into_inner().into_inner().from.fill_buf().map_err(cut)?.is_empty()
        {
            return Err(broken("there is more than it describes"));
        }
        let crs = head.crs.map(|crs| Crs {
            epsg: crs.epsg,
            wkt: crs.wkt,
            horizontal_unit_m: crs.horizontal_unit_m,
            vertical_unit_m: crs.vertical_unit_m,
        });
        let dag =
            Dag { words, root: head.root.map(Ref), levels: head.levels, planes: head.density_bits };
        let mut landscape = Landscape {
            // Only a sound graph has blocks.
            blocks: Blocks::default(),
            frame: Frame { origin: DVec3::from(head.origin), crs },
            first_m: Vec3::from(head.first_m),
            voxel_m: head.voxel_m,
            sides: head.sides,
            dag,
            heights: Heights {
                stride: head.height_stride,
                base: head.height_base,
                step: head.height_step,
                samples: heights,
            },
            colours: Colours { stride: head.colour_stride, levels },
        };
        landscape.check().map_err(|why| broken(&why))?;
        landscape.blocks = Blocks::of(&landscape.dag, landscape.sides);
        Ok(landscape)
    }
}
