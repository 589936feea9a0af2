//! Plain text points: x y z at the start of each line, the rest of the line ignored; separators
//! are spaces, tabs, commas or semicolons; `#` and `//` begin comments.
//!
//! The first line may be a header of names or, as in PTS files, the number of points. The names of a
//! header, or of a comment before the points, tell which columns x, y and z are; a header that does
//! not is refused, and so are decimal commas and UTF-16. Without names a first column that counts the
//! points is left out: integers that rise by one from line to line, three plausible coordinates behind.

use std::fs::File;
use std::io::Read;
use std::path::Path;

use glam::DVec3;
use rayon::prelude::*;

use super::Removed;
use super::las_file::io_error;
use super::part::{ColourScale, Columns, Coordinates, Part};
use crate::diagnostic::{Error, Result};
use crate::frame::Crs;

/// Text in memory at a time; no line may be longer.
const BLOCK_BYTES: usize = 16 << 20;
const PIECE_BYTES: usize = 256 << 10;

/// Points and dropped lines of a piece of text.
#[derive(Default)]
struct Lines {
    world: Vec<DVec3>,
    not_finite: u64,
    /// Lines that are no points, and the offset of the first.
    bad: u64,
    first_bad: Option<usize>,
}

/// This part of the lines may be no points.
const MOST_BAD: f64 = 0.01;

/// Reads one file, which is in this system.
pub(super) fn read(path: &Path, crs: &Option<Crs>) -> Result<Part> {
    read_inner(path, crs).map_err(|error| error.in_file(path))
}

fn read_inner(path: &Path, crs: &Option<Crs>) -> Result<Part> {
    let mut file = File::open(path).map_err(io_error)?;
    let mut all = Lines::default();
    let mut block: Vec<u8> = Vec::new();
    let mut lines_before = 0;
    let mut is_first = true;
    let mut columns = [0, 1, 2];
    let mut warnings = Vec::new();
    let mut first_bad: Option<String> = None;
    loop {
        let kept = block.len();
        let read = file
            .by_ref()
            .take((BLOCK_BYTES - kept.min(BLOCK_BYTES)) as u64)
            .read_to_end(&mut block)
            .map_err(io_error)?;
        if block.is_empty() {
            break;
        }
        // Whole lines only, unless the file ends here.
        let is_last = read == 0;
        let whole = match block.iter().rposition(|b| *b == b'\n') {
            Some(_) if is_last => block.len(),
            Some(end) => end + 1,
            None if is_last => block.len(),
            None if block.len() >= BLOCK_BYTES => {
                return Err(Error::new(format!("line {} has no end", lines_before + 1))
                    .remedy("give text with one point a line: x y z"));
            }
            None => continue,
        };
        let text = &block[..whole];
        let mut start = 0;
        if is_first {
            refuse_utf_16(text)?;
            let named;
            (start, named) = heading(text)?;
            let points = &text[start..];
            refuse_decimal_commas(points)?;
            columns = match named {
                Some(named) => named,
                None if counts_points(points) => {
                    warnings.push(COUNTED.into());
                    [1, 2, 3]
                }
                None => columns,
            };
            is_first = false;
        }
        let pieces = pieces(&text[start..]);
        let parsed: Vec<Lines> = pieces.par_iter().map(|piece| parse(piece, columns)).collect();
        let mut piece_start = start;
        for (piece, mut lines) in pieces.iter().zip(parsed) {
            all.world.append(&mut lines.world);
            all.not_finite += lines.not_finite;
            all.bad += lines.bad;
            if let (None, Some(at)) = (&first_bad, lines.first_bad) {
                first_bad = Some(bad_line(text, piece_start + at, lines_before));
            }
            piece_start += piece.len();
        }
        if let Some(what) = &first_bad
            && all.bad as f64 > MOST_BAD * (all.world.len() as f64 + all.not_finite as f64)
        {
            return Err(Error::new(what.clone()).remedy(
                "give text with one point a line: x y z, decimal points, `#` before comments",
            ));
        }
        lines_before += count_lines(text);
        block.drain(..whole);
    }
    let n = all.world.len();
    let in_file = n as u64 + all.not_finite;
    if let Some(what) = first_bad {
        let lines = if all.bad == 1 { "line was" } else { "lines were" };
        warnings.push(format!("{what}; {} such {lines} left out", all.bad));
    }
    let bounds = all.world.iter().map(|p| (*p, *p)).reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)));
    Ok(Part {
        path: path.to_path_buf(),
        crs: crs.clone(),
        in_degrees: false,
        coordinates: Coordinates::Real(all.world),
        columns: Columns {
            intensity: vec![0; n],
            return_number: vec![1; n],
            return_count: vec![1; n],
            class: vec![0; n],
            rgb: None,
        },
        bounds,
        colour: ColourScale::None,
        in_file,
        removed: Removed { not_finite: all.not_finite, ..Removed::default() },
        warnings,
    })
}

fn count_lines(text: &[u8]) -> usize {
    text.iter().filter(|b| **b == b'\n').count()
}

fn fields(line: &[u8]) -> impl Iterator<Item = &[u8]> {
    line.split(|b| b.is_ascii_whitespace() || *b == b',' || *b == b';').filter(|f| !f.is_empty())
}

/// By the first line of the points.
fn refuse_decimal_commas(text: &[u8]) -> Result<()> {
    let line = text.split(|b| *b == b'\n').next().unwrap_or_default();
    if !has_decimal_commas(line) {
        return Ok(());
    }
    let shown: String = String::from_utf8_lossy(line.trim_ascii())
        .chars()
        .filter(|c| !c.is_control())
        .take(40)
        .collect();
    Err(Error::new(format!("has decimal commas: \"{shown}\""))
        .remedy("write decimal points, e.g. with: tr , . < IN > OUT"))
}

/// Whether spaces or semicolons part three numbers with one comma each, among digits.
fn has_decimal_commas(line: &[u8]) -> bool {
    let is_number = |field: &[u8]| {
        let digits = |part: &[u8]| {
            let part = part.strip_prefix(b"-").unwrap_or(part);
            !part.is_empty() && part.iter().all(u8::is_ascii_digit)
        };
        let parts: Vec<&[u8]> = field.split(|b| *b == b',').collect();
        parts.len() == 2 && parts.iter().all(|part| digits(part))
    };
    let fields = line.split(|b| b.is_ascii_whitespace() || *b == b';').filter(|f| !f.is_empty());
    let first: Vec<bool> = fields.take(3).map(is_number).collect();
    first == [true; 3]
}

fn is_comment(line: &[u8]) -> bool {
    let line = line.trim_ascii_start();
    line.is_empty() || line.starts_with(b"#") || line.starts_with(b"//")
}

fn number(field: &[u8]) -> Option<f64> {
    std::str::from_utf8(field).ok()?.parse().ok()
}

/// Two bytes a letter: a byte order mark, or digits with a zero beside each.
fn refuse_utf_16(text: &[u8]) -> Result<()> {
    let has_mark = text.starts_with(b"\xff\xfe") || text.starts_with(b"\xfe\xff");
    let (pairs, _) = text[..text.len().min(1024)].as_chunks::<2>();
    let half = |k: usize| {
        let is_half = |pair: &&[u8; 2]| pair[k] == 0 && pair[1 - k].is_ascii() && pair[1 - k] != 0;
        !pairs.is_empty() && pairs.iter().filter(is_half).count() == pairs.len()
    };
    if !has_mark && !half(0) && !half(1) {
        return Ok(());
    }
    Err(Error::new("is UTF-16 text")
        .remedy("save it as UTF-8, e.g. with: iconv -f UTF-16 -t UTF-8 IN > OUT"))
}

const COUNTED: &str = "its first column counts the points: x, y and z were taken from the second to the \
                       fourth; if it is x, put a first line of names: x y z";
/// Fewer lines may rise by chance.
const LEAST_COUNTED: usize = 10;

/// Whether the first column counts the lines, with numbers behind it that spread in x and in y: along a
/// single line of a raster x may rise by one as well.
fn counts_points(text: &[u8]) -> bool {
    let (mut low, mut high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    let mut last: Option<i64> = None;
    let mut count = 0;
    let mut lines = text.split_inclusive(|b| *b == b'\n').filter(|line| !is_comment(line));
    let counts = lines.all(|line| {
        let mut fields = fields(line);
        let number_of_line = fields.next().and_then(|f| std::str::from_utf8(f).ok()?.parse().ok());
        let place: Vec<f64> = fields.take(3).filter_map(number).collect();
        let (Some(now), &[x, y, z]) = (number_of_line, &place[..]) else { return false };
        let is_next = last.is_none_or(|last: i64| last.checked_add(1) == Some(now));
        let place = DVec3::new(x, y, z);
        if place.is_finite() {
            (low, high) = (low.min(place), high.max(place));
        }
        (last, count) = (Some(now), count + 1);
        is_next
    });
    let spread = high - low;
    counts && count >= LEAST_COUNTED && spread.x > 0.0 && spread.y > 0.0 && spread.is_finite()
}

/// Bytes of the heading (a byte order mark, comments, and one line of names or one count), and the
/// columns of x, y and z where names tell them.
fn heading(text: &[u8]) -> Result<(usize, Option<[usize; 3]>)> {
    let mut at = if text.starts_with(b"\xef\xbb\xbf") { 3 } else { 0 };
    let mut columns = None;
    while let Some(rest) = text.get(at..).filter(|rest| !rest.is_empty()) {
        let length = rest.iter().position(|b| *b == b'\n').map_or(rest.len(), |end| end + 1);
        let line = &rest[..length];
        if is_comment(line) {
            let after = rest[length..].split(|b| *b == b'\n').find(|line| !is_comment(line));
            columns = commented_columns(line, after.unwrap_or_default()).or(columns);
            at += length;
            continue;
        }
        let first = fields(line).next().unwrap_or_default();
        if first.eq_ignore_ascii_case(b"ncols") {
            return Err(Error::new("is a raster (ESRI ASCII grid), not a point cloud")
                .remedy("give the scan itself, not a height model made from it"));
        }
        let is_count = fields(line).count() == 1 && first.iter().all(u8::is_ascii_digit);
        let is_names = number(first).is_none()
            && fields(line).count() >= 3
            && fields(line).all(|f| number(f).is_none() && f.iter().all(|b| b.is_ascii_graphic()));
        if is_names {
            let text = String::from_utf8_lossy(line);
            let names: Vec<&str> = split(text.trim()).collect();
            let named = columns_of(&names).map_err(|what| {
                let shown: String = names.join(" ").chars().take(60).collect();
                Error::new(format!("{what} in its first line: {shown}")).remedy(
                    "name the columns x, y and z, or leave the line out where they come first",
                )
            })?;
            columns = Some(named);
        }
        return Ok((if is_count || is_names { at + length } else { at }, columns));
    }
    Ok((at, columns))
}

/// Names of coordinates.
const NAMES: [&[&str]; 3] = [
    &["x", "easting", "east"],
    &["y", "northing", "north"],
    &["z", "elevation", "elev", "height", "altitude"],
];
/// What may stand beside them.
const BESIDE: [&str; 8] = ["point", "coord", "coordinate", "m", "ft", "metres", "meters", "utm"];

/// The axis that a name tells, as of `x`, `"Y"`, `POINT_X`, `Z_COORD`, `coordX`, `x(m)`, `elevation_m`,
/// and whether by its letter.
fn axis(name: &str) -> Option<(usize, bool)> {
    let name = name.to_ascii_lowercase();
    let words = name.split(|c: char| !c.is_ascii_alphanumeric()).filter(|w| !w.is_empty());
    let mut words = words.filter(|word| !BESIDE.contains(word));
    let word = words.next()?;
    let word = ["coord", "point"].iter().find_map(|w| word.strip_prefix(w)).unwrap_or(word);
    let axis = NAMES.iter().position(|known| known.contains(&word))?;
    words.next().is_none().then_some((axis, word.len() == 1))
}

/// The columns of x, y and z by their names. A letter goes before a word: z before height.
fn columns_of(names: &[&str]) -> std::result::Result<[usize; 3], String> {
    let mut columns = [0; 3];
    for (k, letter) in ["x", "y", "z"].into_iter().enumerate() {
        let of = |by_letter: bool| -> Vec<usize> {
            let named = names.iter().map(|name| axis(name));
            let found = named.enumerate().filter(|(_, a)| *a == Some((k, by_letter)));
            found.map(|(column, _)| column).collect()
        };
        let found = Some(of(true)).filter(|found| !found.is_empty()).unwrap_or_else(|| of(false));
        columns[k] = match found[..] {
            [column] => column,
            [] => return Err(format!("no column is named {letter}")),
            _ => return Err(format!("{} columns are named {letter}", found.len())),
        };
    }
    Ok(columns)
}

/// The columns by a comment of as many names as `point` has numbers; `None` where it is another.
fn commented_columns(comment: &[u8], point: &[u8]) -> Option<[usize; 3]> {
    let text = String::from_utf8_lossy(comment.trim_ascii_start());
    let text = text.trim_start_matches(['#', '/']);
    let names = text.split_once(':').map_or(text, |(_, names)| names);
    let names: Vec<&str> = split(names).collect();
    (names.len() == fields(point).count()).then(|| columns_of(&names).ok()).flatten()
}

fn split(line: &str) -> impl Iterator<Item = &str> {
    let is_between = |c: char| c.is_ascii_whitespace() || c == ',' || c == ';';
    line.split(is_between).filter(|name| !name.is_empty())
}

/// Cuts text after line ends into pieces of about [`PIECE_BYTES`].
fn pieces(text: &[u8]) -> Vec<&[u8]> {
    let mut pieces = Vec::with_capacity(text.len() / PIECE_BYTES + 1);
    let mut rest = text;
    while !rest.is_empty() {
        let from = PIECE_BYTES.min(rest.len());
        let end =
            rest[from..].iter().position(|b| *b == b'\n').map_or(rest.len(), |e| from + e + 1);
        let (piece, others) = rest.split_at(end);
        pieces.push(piece);
        rest = others;
    }
    pieces
}

/// The points of whole lines, by the columns of x, y and z.
fn parse(text: &[u8], columns: [usize; 3]) -> Lines {
    let mut lines = Lines::default();
    let most = columns.into_iter().max().unwrap_or(0);
    let mut at = 0;
    for line in text.split_inclusive(|b| *b == b'\n') {
        if !is_comment(line) {
            let mut place = [None; 3];
            for (column, field) in fields(line).take(most + 1).enumerate() {
                if let Some(axis) = columns.iter().position(|c| *c == column) {
                    place[axis] = number(field);
                }
            }
            match place {
                [Some(x), Some(y), Some(z)] => {
                    let p = DVec3::new(x, y, z);
                    match p.is_finite() {
                        true => lines.world.push(p),
                        false => lines.not_finite += 1,
                    }
                }
                _ => {
                    lines.bad += 1;
                    lines.first_bad.get_or_insert(at);
                }
            }
        }
        at += line.len();
    }
    lines
}

/// What is wrong with the line at an offset.
fn bad_line(text: &[u8], at: usize, lines_before: usize) -> String {
    let line_number = lines_before + count_lines(&text[..at.min(text.len())]) + 1;
    let line = text.get(at..).unwrap_or_default().split(|b| *b == b'\n').next().unwrap_or_default();
    let shown: String =
        String::from_utf8_lossy(line).chars().filter(|c| !c.is_control()).take(40).collect();
    format!("line {line_number} is no point: \"{shown}\"")
}
