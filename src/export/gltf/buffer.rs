//! The binary buffer: which columns there are, where each lies, then the bytes, streamed.
//!
//! Plain columns of a kind lie together (all positions, then all normals, …, then pictures): a
//! handful of buffer views however many prototypes there are. Compressed ones have a view each.

use std::io::{self, Write};
use std::sync::Arc;

use bytemuck::NoUninit;
use bytes::Bytes;
use glam::Vec3;
use rayon::prelude::*;

use super::compress::{self, Encoded};
use super::json::{
    ARRAY_BUFFER, Accessor, BYTE, Bound, Compressed, ELEMENT_ARRAY_BUFFER, FLOAT, SHORT,
    UNSIGNED_BYTE, UNSIGNED_INT, UNSIGNED_SHORT, View, ViewExtensions,
};
use super::quantize::{Grid, UvRange, direction};
use super::tangent::tangents;
use super::y_up;
use crate::mesh::Surface;

/// Indices of 16 bits reach so many vertices: the highest value is reserved.
const MOST_SHORT_VERTICES: usize = u16::MAX as usize;

/// Columns in the order of their views.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Kind {
    Position,
    Normal,
    Uv,
    LightmapUv,
    Tangent,
    Wind,
    LongIndex,
    ShortIndex,
    Translation,
    Rotation,
    Scale,
}

/// What the numbers of a column come from.
#[derive(Clone)]
enum Source<'a> {
    Positions(&'a Surface),
    Counted(&'a Surface, Grid),
    Normals(&'a Surface),
    NormalBytes(&'a Surface),
    Uvs(&'a Surface),
    UvShorts(&'a Surface, UvRange),
    LightmapUvs(&'a Surface),
    LightmapUvShorts(&'a Surface),
    Tangents(&'a Surface),
    TangentBytes(&'a Surface),
    Winds(&'a Surface),
    LongIndices(&'a Surface),
    ShortIndices(&'a Surface),
    Vectors(Arc<[[f32; 3]]>),
    Turns(Arc<[[i16; 4]]>),
    Encoded(Arc<Encoded>),
    Picture(Bytes),
}

/// An accessor and what it shows.
struct Column<'a> {
    kind: Kind,
    source: Source<'a>,
    accessor: Accessor,
}

/// How the numbers of a surface are written.
#[derive(Debug, Clone, Copy)]
pub(super) struct Piece<'a> {
    pub surface: &'a Surface,
    /// Where there is one, positions are counted in it.
    pub grid: Option<Grid>,
    /// Where there is one, texture coordinates are counted in it, and directions in 8 bits.
    pub uv_range: Option<UvRange>,
    pub has_uvs: bool,
    pub has_tangents: bool,
}

/// Numbers of a piece's accessors.
#[derive(Debug, Clone, Copy)]
pub(super) struct PieceAccessors {
    pub position: u32,
    pub normal: Option<u32>,
    pub uv: Option<u32>,
    pub lightmap_uv: Option<u32>,
    pub tangent: Option<u32>,
    pub wind: Option<u32>,
    pub index: u32,
}

impl<'a> Piece<'a> {
    /// The kinds of its columns, in the order of its accessors.
    fn kinds(&self) -> Vec<Kind> {
        let surface = self.surface;
        let is_short = surface.position.len() <= MOST_SHORT_VERTICES;
        let all = [
            (Kind::Position, true),
            (Kind::Normal, !surface.normal.is_empty()),
            (Kind::Uv, self.has_uvs),
            (Kind::LightmapUv, !surface.lightmap_uv.is_empty()),
            (Kind::Tangent, self.has_tangents),
            (Kind::Wind, !surface.wind.is_empty()),
            (Kind::LongIndex, !is_short),
            (Kind::ShortIndex, is_short),
        ];
        all.into_iter().filter(|(_, is_there)| *is_there).map(|(kind, _)| kind).collect()
    }

    fn column(&self, kind: Kind) -> Column<'a> {
        let surface = self.surface;
        let count = surface.position.len();
        let accessor = |component_type, r#type, normalized| Accessor {
            buffer_view: 0,
            byte_offset: 0,
            component_type,
            count,
            r#type,
            normalized,
            min: None,
            max: None,
        };
        let index = |component_type| Accessor {
            count: surface.index.len(),
            ..accessor(component_type, "SCALAR", false)
        };
        let is_small = self.uv_range.is_some();
        let (source, accessor) = match kind {
            Kind::Position => {
                let (lo, hi) = surface.bounds();
                let (source, plain, [min, max]) = match self.grid {
                    None => {
                        let (a, b) = (Vec3::from(y_up(lo)), Vec3::from(y_up(hi)));
                        let ends = [a.min(b), a.max(b)].map(|v| Bound::Float(v.to_array()));
                        (Source::Positions(surface), accessor(FLOAT, "VEC3", false), ends)
                    }
                    Some(grid) => {
                        let (a, b) = (y_up_count(grid.count(lo)), y_up_count(grid.count(hi)));
                        let each = |pick: fn(i16, i16) -> i16| {
                            Bound::Short(std::array::from_fn(|k| pick(a[k], b[k])))
                        };
                        let ends = [each(i16::min), each(i16::max)];
                        (Source::Counted(surface, grid), accessor(SHORT, "VEC3", true), ends)
                    }
                };
                (source, Accessor { min: Some(min), max: Some(max), ..plain })
            }
            Kind::Normal if is_small => {
                (Source::NormalBytes(surface), accessor(BYTE, "VEC3", true))
            }
            Kind::Normal => (Source::Normals(surface), accessor(FLOAT, "VEC3", false)),
            Kind::Uv => match self.uv_range {
                None => (Source::Uvs(surface), accessor(FLOAT, "VEC2", false)),
                Some(range) => {
                    (Source::UvShorts(surface, range), accessor(UNSIGNED_SHORT, "VEC2", true))
                }
            },
            Kind::LightmapUv if is_small => {
                let short = accessor(UNSIGNED_SHORT, "VEC2", true);
                (Source::LightmapUvShorts(surface), short)
            }
            Kind::LightmapUv => (Source::LightmapUvs(surface), accessor(FLOAT, "VEC2", false)),
            Kind::Tangent if is_small => {
                (Source::TangentBytes(surface), accessor(BYTE, "VEC4", true))
            }
            Kind::Tangent => (Source::Tangents(surface), accessor(FLOAT, "VEC4", false)),
            Kind::LongIndex => (Source::LongIndices(surface), index(UNSIGNED_INT)),
            Kind::ShortIndex => (Source::ShortIndices(surface), index(UNSIGNED_SHORT)),
            _ => (Source::Winds(surface), accessor(UNSIGNED_BYTE, "VEC4", true)),
        };
        Column { kind, source, accessor }
    }
}

/// Columns in the order of their accessors.
#[derive(Default)]
pub(super) struct Plan<'a> {
    pieces: Vec<Piece<'a>>,
    placed: Vec<Column<'a>>,
    accessors: u32,
}

impl<'a> Plan<'a> {
    /// Every piece must come before the first instances.
    pub fn piece(&mut self, piece: Piece<'a>) -> PieceAccessors {
        let mut numbers = PieceAccessors {
            position: 0,
            normal: None,
            uv: None,
            lightmap_uv: None,
            tangent: None,
            wind: None,
            index: 0,
        };
        for (number, kind) in (self.accessors..).zip(piece.kinds()) {
            match kind {
                Kind::Position => numbers.position = number,
                Kind::Normal => numbers.normal = Some(number),
                Kind::Uv => numbers.uv = Some(number),
                Kind::LightmapUv => numbers.lightmap_uv = Some(number),
                Kind::Tangent => numbers.tangent = Some(number),
                Kind::Wind => numbers.wind = Some(number),
                _ => numbers.index = number,
            }
            self.accessors = number + 1;
        }
        self.pieces.push(piece);
        numbers
    }

    /// Places, turns (quaternions x, y, z, w; in 16 bits) and sizes of instances, Y up; the number
    /// of the first of their three accessors.
    pub fn instances(
        &mut self,
        places: Vec<[f32; 3]>,
        turns: Vec<[i16; 4]>,
        scales: Vec<[f32; 3]>,
    ) -> u32 {
        let first = self.accessors;
        let accessor = |component_type, r#type, normalized| Accessor {
            buffer_view: 0,
            byte_offset: 0,
            component_type,
            count: places.len(),
            r#type,
            normalized,
            min: None,
            max: None,
        };
        let vectors = accessor(FLOAT, "VEC3", false);
        let quaternions = accessor(SHORT, "VEC4", true);
        let columns = [
            (Kind::Translation, Source::Vectors(places.into()), vectors.clone()),
            (Kind::Rotation, Source::Turns(turns.into()), quaternions),
            (Kind::Scale, Source::Vectors(scales.into()), vectors),
        ];
        let columns =
            columns.into_iter().map(|(kind, source, accessor)| Column { kind, source, accessor });
        self.placed.extend(columns);
        self.accessors += 3;
        first
    }

    /// Where everything lies, with these pictures behind it.
    pub fn layout(self, pictures: Vec<Bytes>) -> Layout<'a> {
        let of_piece = |p: &Piece<'a>| -> Vec<Column<'a>> {
            p.kinds().into_iter().map(|kind| p.column(kind)).collect()
        };
        let columns = self.pieces.iter().flat_map(of_piece).chain(self.placed);
        let columns: Vec<Column<'a>> = columns.collect();
        let mut order: Vec<usize> = (0..columns.len()).collect();
        order.sort_by_key(|&c| columns[c].kind);
        let mut layout = Layout::default();
        let mut accessors: Vec<Accessor> = columns.iter().map(|c| c.accessor.clone()).collect();
        let mut last = None;
        for c in order {
            let Column { kind, source, .. } = &columns[c];
            if last != Some(*kind) {
                layout.open(view(*kind, source));
            }
            last = Some(*kind);
            accessors[c].buffer_view = layout.views.len() as u32 - 1;
            accessors[c].byte_offset = layout.append(source.clone());
        }
        layout.accessors = accessors;
        layout.append_pictures(pictures);
        layout
    }

    /// The same, compressed (EXT_meshopt_compression); nothing borrowed remains.
    ///
    /// # Errors
    /// The encoder's.
    pub fn compressed(self, pictures: Vec<Bytes>) -> crate::diagnostic::Result<Layout<'static>> {
        type Set = Vec<(Kind, Accessor, Arc<Encoded>)>;
        let of_piece = |p: &Piece<'_>| -> crate::diagnostic::Result<Set> {
            // Colliders, which have no texture, stay closed.
            let grid = p.grid.filter(|_| p.uv_range.is_some());
            let ordered = compress::ordered(p.surface, grid);
            let piece = Piece { surface: &ordered, ..*p };
            piece.kinds().into_par_iter().map(|kind| piece.column(kind).encoded()).collect()
        };
        let pieces: Vec<Set> = self.pieces.par_iter().map(of_piece).collect::<Result<_, _>>()?;
        let mut layout = Layout::default();
        for (kind, mut accessor, encoded) in pieces.into_iter().flatten() {
            accessor.buffer_view = layout.append_compressed(kind, encoded);
            layout.accessors.push(accessor);
        }
        let mut accessors: Vec<Accessor> = self.placed.iter().map(|c| c.accessor.clone()).collect();
        // All instances' columns of a kind as one: a view of its own says more than a few trees do.
        for kind in [Kind::Translation, Kind::Rotation, Kind::Scale] {
            let of_kind = || self.placed.iter().enumerate().filter(|(_, c)| c.kind == kind);
            let Some((_, first)) = of_kind().next() else { continue };
            let mut raw = Vec::new();
            for (c, column) in of_kind() {
                accessors[c].buffer_view = layout.views.len() as u32;
                accessors[c].byte_offset = raw.len() as u64;
                column.source.write(&mut raw).map_err(|e| compress::refused(&e))?;
            }
            let encoded = compress::attributes(&raw, first.source.stride() as usize)?;
            layout.append_compressed(kind, Arc::new(encoded));
        }
        layout.accessors.extend(accessors);
        layout.append_pictures(pictures);
        Ok(layout)
    }
}

impl Column<'_> {
    fn encoded(&self) -> crate::diagnostic::Result<(Kind, Accessor, Arc<Encoded>)> {
        let mut raw = Vec::with_capacity(self.source.bytes() as usize);
        self.source.write(&mut raw).map_err(|e| compress::refused(&e))?;
        let is_index = matches!(self.kind, Kind::LongIndex | Kind::ShortIndex);
        let encoded = match is_index {
            true => compress::triangles(&raw, self.source.stride() as usize)?,
            false => compress::attributes(&raw, self.source.stride() as usize)?,
        };
        Ok((self.kind, self.accessor.clone(), Arc::new(encoded)))
    }
}

fn view(kind: Kind, source: &Source<'_>) -> View {
    let (byte_stride, target) = match kind {
        Kind::LongIndex | Kind::ShortIndex => (None, Some(ELEMENT_ARRAY_BUFFER)),
        // No vertex attributes, so the standard allows neither.
        Kind::Translation | Kind::Rotation | Kind::Scale => (None, None),
        _ => (Some(source.stride()), Some(ARRAY_BUFFER)),
    };
    View { buffer: 0, byte_offset: 0, byte_length: 0, byte_stride, target, extensions: None }
}

/// Where everything lies.
#[derive(Default)]
pub(super) struct Layout<'a> {
    pub views: Vec<View>,
    pub accessors: Vec<Accessor>,
    /// Number of the first picture's view.
    pub first_picture: u32,
    /// Length of the buffer, a multiple of 4.
    pub bytes: u64,
    /// Length of what the compressed views stand for; 0 where nothing is compressed.
    pub decoded_bytes: u64,
    pub body: Body<'a>,
}

/// What the buffer holds, in its order.
#[derive(Default)]
pub(super) struct Body<'a> {
    sources: Vec<Source<'a>>,
}

impl<'a> Layout<'a> {
    /// A view that starts here.
    fn open(&mut self, view: View) {
        self.views.push(View { byte_offset: self.bytes, ..view });
    }

    /// Adds to the view opened last; gives the place within it.
    fn append(&mut self, source: Source<'a>) -> u64 {
        let bytes = source.bytes();
        let within = self.views.last_mut().map_or(0, |view| {
            let within = self.bytes - view.byte_offset;
            view.byte_length = within + bytes;
            within
        });
        self.body.sources.push(source);
        self.bytes = (self.bytes + bytes).next_multiple_of(4);
        within
    }

    /// A view of decoded bytes, of which the encoded ones are added here; its number.
    fn append_compressed(&mut self, kind: Kind, encoded: Arc<Encoded>) -> u32 {
        let target = match kind {
            Kind::LongIndex | Kind::ShortIndex => Some(ELEMENT_ARRAY_BUFFER),
            Kind::Translation | Kind::Rotation | Kind::Scale => None,
            _ => Some(ARRAY_BUFFER),
        };
        let byte_length = (encoded.stride * encoded.count) as u64;
        let byte_stride = (target == Some(ARRAY_BUFFER)).then_some(encoded.stride as u64);
        let meshopt = Compressed {
            buffer: 0,
            byte_offset: self.bytes,
            byte_length: encoded.bytes.len() as u64,
            byte_stride: encoded.stride as u64,
            count: encoded.count,
            mode: encoded.mode,
        };
        self.views.push(View {
            buffer: 1,
            byte_offset: self.decoded_bytes,
            byte_length,
            byte_stride,
            target,
            extensions: Some(ViewExtensions { meshopt }),
        });
        self.decoded_bytes = (self.decoded_bytes + byte_length).next_multiple_of(4);
        let source = Source::Encoded(encoded);
        self.bytes = (self.bytes + source.bytes()).next_multiple_of(4);
        self.body.sources.push(source);
        self.views.len() as u32 - 1
    }

    fn append_pictures(&mut self, pictures: Vec<Bytes>) {
        self.first_picture = self.views.len() as u32;
        for picture in pictures {
            self.open(View {
                buffer: 0,
                byte_offset: 0,
                byte_length: 0,
                byte_stride: None,
                target: None,
                extensions: None,
            });
            self.append(Source::Picture(picture));
        }
    }
}

impl Body<'_> {
    /// The buffer.
    pub fn write(&self, out: &mut (dyn Write + Send)) -> io::Result<()> {
        for source in &self.sources {
            source.write(out)?;
            let rest = source.bytes().next_multiple_of(4) - source.bytes();
            out.write_all(&[0; 3][..rest as usize])?;
        }
        Ok(())
    }
}

impl Source<'_> {
    /// Bytes of one element.
    fn stride(&self) -> u64 {
        match self {
            Source::Positions(_) | Source::Normals(_) | Source::Vectors(_) => 12,
            Source::Counted(..) | Source::Uvs(_) | Source::LightmapUvs(_) | Source::Turns(_) => 8,
            Source::Tangents(_) => 16,
            Source::NormalBytes(_) | Source::TangentBytes(_) | Source::UvShorts(..) => 4,
            Source::LightmapUvShorts(_) | Source::Winds(_) | Source::LongIndices(_) => 4,
            Source::ShortIndices(_) => 2,
            Source::Encoded(_) | Source::Picture(_) => 1,
        }
    }

    fn count(&self) -> usize {
        match self {
            Source::LongIndices(s) | Source::ShortIndices(s) => s.index.len(),
            Source::Positions(s)
            | Source::Counted(s, _)
            | Source::Normals(s)
            | Source::NormalBytes(s)
            | Source::Uvs(s)
            | Source::UvShorts(s, _)
            | Source::LightmapUvs(s)
            | Source::LightmapUvShorts(s)
            | Source::Tangents(s)
            | Source::TangentBytes(s)
            | Source::Winds(s) => s.position.len(),
            Source::Vectors(v) => v.len(),
            Source::Turns(t) => t.len(),
            Source::Encoded(e) => e.bytes.len(),
            Source::Picture(p) => p.len(),
        }
    }

    fn bytes(&self) -> u64 {
        self.stride() * self.count() as u64
    }

    fn write(&self, out: &mut (dyn Write + Send)) -> io::Result<()> {
        match self {
            Source::Positions(s) => pour(out, &s.position, |&p| y_up(p)),
            Source::Counted(s, grid) => pour(out, &s.position, |&p| {
                let [x, y, z] = y_up_count(grid.count(p));
                [x, y, z, 0]
            }),
            Source::Normals(s) => pour(out, &s.normal, |&n| y_up(n)),
            Source::NormalBytes(s) => pour(out, &s.normal, |&n| {
                let [x, y, z] = direction(Vec3::from(y_up(n)));
                [x, y, z, 0]
            }),
            // v = 0 is the bottom of the picture in the scene, the top in glTF.
            Source::Uvs(s) => pour(out, &s.uv, |uv| [uv.x, 1.0 - uv.y]),
            Source::UvShorts(s, range) => pour(out, &s.uv, |&uv| range.count(uv)),
            Source::LightmapUvs(s) => pour(out, &s.lightmap_uv, |uv| [uv.x, 1.0 - uv.y]),
            Source::LightmapUvShorts(s) => {
                pour(out, &s.lightmap_uv, |&uv| UvRange::PICTURE.count(uv))
            }
            Source::Tangents(s) => pour(out, &tangents(s), |t| {
                let [x, y, z] = y_up(t.truncate());
                [x, y, z, t.w]
            }),
            Source::TangentBytes(s) => pour(out, &tangents(s), |t| {
                let [x, y, z] = direction(Vec3::from(y_up(t.truncate())));
                [x, y, z, if t.w < 0.0 { -i8::MAX } else { i8::MAX }]
            }),
            Source::Winds(s) => out.write_all(s.wind.as_flattened()),
            Source::LongIndices(s) => pour(out, &s.index, |&i| i),
            Source::ShortIndices(s) => pour(out, &s.index, |&i| i as u16),
            Source::Vectors(v) => out.write_all(bytemuck::cast_slice(v)),
            Source::Turns(t) => out.write_all(bytemuck::cast_slice(t)),
            Source::Encoded(e) => out.write_all(&e.bytes),
            Source::Picture(p) => out.write_all(p),
        }
    }
}

/// Scene steps to glTF's Y up.
fn y_up_count([x, y, z]: [i16; 3]) -> [i16; 3] {
    [x, z, -y]
}

/// Writes what becomes of items, by lots: one goes to the disk while the next is made on all threads.
fn pour<T: Sync, N: NoUninit + Send + Sync>(
    out: &mut (dyn Write + Send),
    items: &[T],
    numbers: impl Fn(&T) -> N + Sync,
) -> io::Result<()> {
    // glTF's numbers are little-endian, and so are those of every machine this is built for.
    const { assert!(cfg!(target_endian = "little")) };
    /// Large enough to go to the disk as they are.
    const LOT: usize = 1 << 16;
    /// That are worth a thread.
    const SHARE: usize = 1 << 13;
    let (mut made, mut next) = (Vec::new(), Vec::new());
    for items in items.chunks(LOT) {
        next.clear();
        let (written, ()) = rayon::join(
            || out.write_all(bytemuck::cast_slice(&made)),
            || next.par_extend(items.par_iter().with_min_len(SHARE).map(&numbers)),
        );
        written?;
        std::mem::swap(&mut made, &mut next);
    }
    out.write_all(bytemuck::cast_slice(&made))
}
