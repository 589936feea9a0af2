//! A tree as pictures of itself: colour, normal and alpha, baked from its mesh.
//!
//! *Cross*: two upright sheets that stand through the stem at right angles, each with the
//! orthographic view square to it on either side, so that light falls on both as on a round crown;
//! any renderer shows it. From above it shows its edges.
//! *Octahedral*: views from N × N directions over the upper half of the sky, laid out by the
//! hemi-octahedral map (Cigolle et al. 2014), for shaders that blend the nearest three; the
//! sheet that comes with it shows the view from the side.
//!
//! Samples are taken 3 × 3 a texel; colour is averaged in linear light over what is seen, alpha
//! is the share seen, scaled so that as much passes the cutoff, between texels too as viewers see
//! them, as was covered: single texels of a thin crown would vanish there. Normals are those
//! of the mesh in the sheet's own tangent space, nearer to the eye where leaves face all ways; what
//! lies deep between other leaves is darker. Known limit: a sheet has no depth, so that near
//! by its parts slide against the tree's.

use glam::{Vec2, Vec3};
use rayon::prelude::*;

use crate::diagnostic::Result;
use crate::mesh::Surface;
use crate::raster::{Picture, pad_transparent};
use crate::render::capture::{self, Sitter, Texel, Window};
use crate::render::srgb_from_linear;
use crate::scene::Octahedral;
use crate::work::{self, Work};

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    Cross,
    Octahedral,
}

/// The pictures and the sheets that carry them.
#[derive(Debug, Clone, PartialEq)]
pub struct Impostor {
    pub surface: Surface,
    /// sRGB with alpha, to be cut at [`CUTOFF`].
    pub colour: Picture,
    /// Tangent-space normals, raw, y up as in OpenGL; half as wide and high as `colour`. A leaf's own
    /// normal is noise where the sheet is shown.
    pub normal: Picture,
    pub octahedral: Option<Octahedral>,
}

/// Where alpha is cut.
pub const CUTOFF: f32 = 0.5;
/// Samples along a side of a texel.
const PER_TEXEL: usize = 3;
/// Greatest factor on alpha, and how often it is halved to find the right one.
const MOST_GAIN: f32 = 64.0;
const HALVINGS: u32 = 10;
/// How far behind its neighbours a leaf is wholly shaded, over the lesser side of the view; and how
/// much darker it is then.
const DEEP: f32 = 0.15;
const SHADED: f32 = 0.5;
/// Half the distance between both sides of a cross's sheet, metres.
const APART_M: f32 = 1e-3;
/// Texels between two views of a cross.
const GUTTER: usize = 8;
/// Views along a side of an octahedral picture.
pub(super) const FRAMES: u32 = 8;

/// Bakes a model, whose extent is `bounds` (tree-local metres). `size_px`: texels
/// along the longer side of a sheet and its gutters, or along the side of an octahedral picture;
/// powers of two are best.
///
/// How far an octahedral one's sheet is off is left to be measured.
///
/// # Errors
/// Bounds that are not finite.
pub fn bake(
    sitter: &Sitter<'_>,
    model: u32,
    bounds: (Vec3, Vec3),
    kind: Kind,
    size_px: u32,
) -> Result<Impostor> {
    work::count(Work::Impostors, 1);
    let of = Model { sitter, model };
    match kind {
        Kind::Cross => cross(&of, bounds, size_px as usize),
        Kind::Octahedral => octahedral(&of, bounds, size_px),
    }
}

/// Who is baked.
struct Model<'a> {
    sitter: &'a Sitter<'a>,
    model: u32,
}

/// A sheet: what it shows and where it lies.
struct Sheet {
    centre: Vec3,
    forward: Vec3,
    right: Vec3,
    /// Metres.
    size: Vec2,
}

fn cross(of: &Model<'_>, (lo, hi): (Vec3, Vec3), size_px: usize) -> Result<Impostor> {
    let lo = lo.with_z(lo.z.max(0.0));
    let span = (hi - lo).max(Vec3::splat(1e-3));
    let middle = 0.5 * (lo + hi);
    let upright = |forward: Vec3, right: Vec3, width: f32| Sheet {
        // Through the stem, whose root is the origin.
        centre: right * middle.dot(right) + Vec3::Z * middle.z,
        forward,
        right,
        size: Vec2::new(width, span.z),
    };
    let sheets = [upright(Vec3::Y, Vec3::X, span.x), upright(-Vec3::X, Vec3::Y, span.y)];
    let longest = sheets.iter().map(|s| s.size.max_element()).fold(0.0, f32::max);
    // With its gutters, the longer side of a sheet is that of the picture or less.
    let texel_m = longest / size_px.saturating_sub(GUTTER).max(8) as f32;
    let views: Vec<Frame> = sheets
        .par_iter()
        .map(|s| {
            let [w, h] = [s.size.x, s.size.y].map(|m| ((m / texel_m).ceil() as usize).max(4));
            Frame::take(of, s.centre, s.forward, texel_m, [w, h])
        })
        .collect::<Result<_>>()?;
    // Side by side, at the bottom of a picture whose sides are powers of two, as graphics cards
    // compress and shrink them best.
    let width = views.iter().map(|v| v.size[0] + GUTTER).sum::<usize>().next_power_of_two();
    let height = views.iter().map(|v| v.size[1]).fold(0, usize::max) + GUTTER;
    let height = height.next_power_of_two();
    let mut board = Board::new(width, height);
    let mut surface = Surface::default();
    let mut left = GUTTER / 2;
    for (view, sheet) in views.iter().zip(&sheets) {
        let corner = [left, GUTTER / 2];
        board.paste(view, corner);
        left += view.size[0] + GUTTER;
        let uv = |s: usize, t: usize| {
            Vec2::new(
                (corner[0] + s * view.size[0]) as f32 / width as f32,
                (corner[1] + t * view.size[1]) as f32 / height as f32,
            )
        };
        let half = Vec2::new(view.size[0] as f32, view.size[1] as f32) * (0.5 * texel_m);
        let sides = [sheet.right * half.x, Vec3::Z * half.y];
        // Both sides of a crown are round: seen from behind, what lies to the left still faces left.
        for normal in [-sheet.forward, sheet.forward] {
            quad(&mut surface, sheet.centre + normal * APART_M, sides, normal, uv);
        }
    }
    board.finish(surface, None)
}

fn octahedral(of: &Model<'_>, (lo, hi): (Vec3, Vec3), size_px: u32) -> Result<Impostor> {
    let centre = 0.5 * (lo + hi);
    let radius_m = (0.5 * (hi - lo).length()).max(1e-3);
    let side = (size_px / FRAMES).max(8).next_power_of_two() as usize;
    let texel_m = 2.0 * radius_m / side as f32;
    let cells: Vec<(u32, u32)> =
        (0..FRAMES).flat_map(|row| (0..FRAMES).map(move |col| (col, row))).collect();
    let views: Vec<Frame> = cells
        .par_iter()
        .map(|&(col, row)| {
            Frame::take(of, centre, -direction(col, row, FRAMES), texel_m, [side, side])
        })
        .collect::<Result<_>>()?;
    let whole = side * FRAMES as usize;
    let mut board = Board::new(whole, whole);
    for (&(col, row), view) in cells.iter().zip(&views) {
        board.paste(view, [col as usize * side, row as usize * side]);
    }
    let octahedral = Octahedral { frames: FRAMES, centre, radius_m, sheet_rms_m: f32::INFINITY };
    // The view from the south, whose plane is upright.
    let surface = sheet_towards(&octahedral, -Vec3::Y);
    board.finish(surface, Some(octahedral))
}

/// The view nearest to an eye in this direction (unit): its column, row and own direction.
fn nearest(frames: u32, eye: Vec3) -> (u32, u32, Vec3) {
    (0..frames * frames)
        .map(|k| (k % frames, k / frames, direction(k % frames, k / frames, frames)))
        .max_by(|a, b| a.2.dot(eye).total_cmp(&b.2.dot(eye)))
        .unwrap_or((0, 0, Vec3::Z))
}

/// The sheet that a shader shows to an eye in this direction (unit) where it takes one view: the
/// nearest, in its own plane.
pub fn sheet_towards(octahedral: &Octahedral, eye: Vec3) -> Surface {
    let Octahedral { frames, centre, radius_m, .. } = *octahedral;
    let (col, row, view) = nearest(frames, eye);
    let sides = capture::sides(-view).map(|side| side * radius_m);
    let mut surface = Surface::default();
    let uv = |s: usize, t: usize| {
        Vec2::new((col as usize + s) as f32, (row as usize + t) as f32) / frames as f32
    };
    quad(&mut surface, centre, sides, view, uv);
    surface
}

/// How far what [`sheet_towards`] shows may lie beside what it stands for, metres.
pub fn aside_m(octahedral: &Octahedral, eye: Vec3) -> f32 {
    octahedral.radius_m * nearest(octahedral.frames, eye).2.cross(eye).length()
}

/// Towards the eye of a view of the hemi-octahedral map of so many views along a side.
pub(super) fn direction(col: u32, row: u32, frames: u32) -> Vec3 {
    let e = Vec2::new(col as f32, row as f32) * (2.0 / (frames.max(2) - 1) as f32) - 1.0;
    let p = Vec2::new(e.x + e.y, e.x - e.y) * 0.5;
    p.extend(1.0 - p.x.abs() - p.y.abs()).normalize_or(Vec3::Z)
}

/// A sheet that shows its picture along `normal`.
fn quad(
    out: &mut Surface,
    centre: Vec3,
    [right, up]: [Vec3; 2],
    normal: Vec3,
    uv: impl Fn(usize, usize) -> Vec2,
) {
    let first = out.position.len() as u32;
    for (s, t) in [(0, 0), (1, 0), (1, 1), (0, 1)] {
        let side = |k: usize| 2.0 * k as f32 - 1.0;
        out.position.push(centre + right * side(s) + up * side(t));
        out.normal.push(normal);
        out.uv.push(uv(s, t));
    }
    let is_front = right.cross(up).dot(normal) >= 0.0;
    let corners = if is_front { [0, 1, 2, 0, 2, 3] } else { [0, 2, 1, 0, 3, 2] };
    out.index.extend(corners.map(|k| first + k));
}

/// A texel of a view.
#[derive(Debug, Clone, Copy, Default)]
struct Baked {
    /// Linear light, of what is seen.
    albedo: Vec3,
    /// In right, up, towards the eye.
    normal: Vec3,
    /// Share seen.
    alpha: f32,
    /// How far before the sheet, mean, metres.
    before_m: f32,
}

/// A view; row 0 on top.
struct Frame {
    size: [usize; 2],
    texel: Vec<Baked>,
}

impl Frame {
    fn take(
        of: &Model<'_>,
        centre: Vec3,
        forward: Vec3,
        texel_m: f32,
        [width, height]: [usize; 2],
    ) -> Result<Frame> {
        let n = PER_TEXEL;
        let window =
            Window { centre, forward, sample_m: texel_m / n as f32, size: [width * n, height * n] };
        let [right, up] = capture::sides(forward);
        let sample = of.sitter.portrait(of.model, &window)?;
        let texel = (0..width * height)
            .map(|i| {
                let (x, y) = (i % width, i / width);
                let of = (0..n * n).map(|k| sample[(y * n + k / n) * width * n + x * n + k % n]);
                let (mut sum, mut seen) = (Baked::default(), 0);
                for t in of.filter(Texel::is_seen) {
                    sum.albedo += Vec3::from(t.albedo);
                    sum.normal += t.normal;
                    sum.before_m += t.before_m;
                    seen += 1;
                }
                let share = (seen.max(1) as f32).recip();
                let m = sum.normal * share;
                // Leaves that face all ways are lit as one that faces the eye.
                let all_ways = (1.0 - m.length()).max(0.0);
                let local = Vec3::new(m.dot(right), m.dot(up), all_ways - m.dot(forward));
                Baked {
                    albedo: sum.albedo * share,
                    normal: local.normalize_or(Vec3::Z),
                    alpha: seen as f32 / (n * n) as f32,
                    before_m: sum.before_m * share,
                }
            })
            .collect();
        let mut frame = Frame { size: [width, height], texel };
        frame.shade(texel_m, DEEP * texel_m * width.min(height) as f32);
        Ok(frame)
    }

    /// Darkens what lies deep in the crown, behind what is about it: a sheet casts no shadow there.
    fn shade(&mut self, texel_m: f32, deep_m: f32) {
        let [w, h] = self.size;
        let reach = ((0.5 * deep_m / texel_m) as usize).clamp(1, 24);
        let depth = |t: &Baked| if t.alpha > 0.0 { t.before_m } else { f32::NEG_INFINITY };
        let before: Vec<f32> = self.texel.iter().map(depth).collect();
        // The nearest to the eye about each, along rows and then along columns.
        let nearest = |of: &[f32], len: usize, step: usize, from: usize, i: usize| {
            let (low, high) = (i.saturating_sub(reach), (i + reach).min(len - 1));
            (low..=high).map(|k| of[from + k * step]).fold(f32::NEG_INFINITY, f32::max)
        };
        let rows: Vec<f32> = (0..w * h).map(|i| nearest(&before, w, 1, i / w * w, i % w)).collect();
        let light = |(i, t): (usize, &Baked)| {
            let behind_m = nearest(&rows, h, w, i % w, i / w) - t.before_m;
            1.0 - SHADED * (behind_m / deep_m.max(1e-6)).clamp(0.0, 1.0)
        };
        let lights: Vec<f32> = self.texel.iter().enumerate().map(light).collect();
        let seen = || self.texel.iter().zip(&lights).filter(|(t, _)| t.alpha > 0.0);
        let mean = seen().map(|(_, light)| light).sum::<f32>() / seen().count().max(1) as f32;
        // As bright as before, on the whole.
        for (t, light) in self.texel.iter_mut().zip(&lights).filter(|(t, _)| t.alpha > 0.0) {
            t.albedo = (t.albedo * (light / mean.max(1e-3))).min(Vec3::ONE);
        }
    }

    /// Factor on alpha at which as much passes the cutoff as the model covers.
    fn gain(&self) -> f32 {
        let covered: f32 = self.texel.iter().map(|t| t.alpha).sum();
        let (mut low, mut high) = (0.0, MOST_GAIN.ln());
        for _ in 0..HALVINGS {
            let middle: f32 = 0.5 * (low + high);
            if self.passing(middle.exp()) < covered { low = middle } else { high = middle }
        }
        if low == 0.0 { 1.0 } else { low.exp() }
    }

    /// Texels' area that passes the cutoff, looked at in 2 × 2 places between texels' middles.
    fn passing(&self, gain: f32) -> f32 {
        let [w, h] = self.size;
        let alpha = |x: usize, y: usize| (self.texel[y * w + x].alpha * gain).min(1.0);
        let mut passing = 0;
        for y in 0..h - 1 {
            let mut left = [alpha(0, y), alpha(0, y + 1)];
            for x in 1..w {
                let right = [alpha(x, y), alpha(x, y + 1)];
                for t in [0.25, 0.75] {
                    let [top, bottom] = [0, 1].map(|k| left[k] + (right[k] - left[k]) * t);
                    for u in [0.25, 0.75] {
                        passing += u32::from(top + (bottom - top) * u >= CUTOFF);
                    }
                }
                left = right;
            }
        }
        passing as f32 * 0.25
    }
}

/// The pictures as they are put together.
struct Board {
    colour: Picture,
    normal: Picture,
}

impl Board {
    fn new(width: usize, height: usize) -> Board {
        let [w, h] = [width as u32, height as u32];
        Board {
            colour: Picture::filled(w, h, [0; 4]),
            normal: Picture::filled(w, h, [128, 128, 255, 0]),
        }
    }

    /// `corner`: texels from the left and from the bottom.
    fn paste(&mut self, frame: &Frame, corner: [usize; 2]) {
        let [w, h] = frame.size;
        let gain = frame.gain();
        for (i, t) in frame.texel.iter().enumerate().filter(|(_, t)| t.alpha > 0.0) {
            let x = (corner[0] + i % w) as u32;
            let y = self.colour.height - (corner[1] + h - i / w) as u32;
            let [r, g, b] = t.albedo.to_array().map(|c| srgb_from_linear(c).round() as u8);
            let alpha = (t.alpha * gain * 255.0).round().min(255.0) as u8;
            self.colour.set(x, y, [r, g, b, alpha]);
            let [nx, ny, nz] = t.normal.to_array().map(|c| ((c * 0.5 + 0.5) * 255.0).round() as u8);
            self.normal.set(x, y, [nx, ny, nz, alpha]);
        }
    }

    fn finish(mut self, surface: Surface, octahedral: Option<Octahedral>) -> Result<Impostor> {
        pad_transparent(&mut self.colour);
        let mut normal = halved(&self.normal);
        pad_transparent(&mut normal);
        for p in &mut normal.data {
            p[3] = 255;
        }
        Ok(Impostor { surface, colour: self.colour, normal, octahedral })
    }
}

/// Normals of 2 × 2 texels by their alpha, of which the mean is kept. Sides are even.
fn halved(fine: &Picture) -> Picture {
    let [w, h] = [fine.width / 2, fine.height / 2];
    let mut out = Picture::filled(w, h, [128, 128, 255, 0]);
    for (x, y) in (0..h).flat_map(|y| (0..w).map(move |x| (x, y))) {
        let four = [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(i, j)| fine.at(2 * x + i, 2 * y + j));
        let alpha = four.map(|p| f32::from(p[3])).iter().sum::<f32>() / 4.0;
        let sum: Vec3 = four
            .iter()
            .map(|p| {
                let part = |c: u8| f32::from(c) / 127.5 - 1.0;
                f32::from(p[3]) * Vec3::new(part(p[0]), part(p[1]), part(p[2]))
            })
            .sum();
        if let Some(mean) = sum.try_normalize() {
            let code = |c: f32| ((c * 0.5 + 0.5) * 255.0).round() as u8;
            out.set(x, y, [code(mean.x), code(mean.y), code(mean.z), alpha.ceil() as u8]);
        }
    }
    out
}
