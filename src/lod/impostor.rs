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
//! is the share seen: of a cross spread so that patch by patch as much passes the cutoff as was covered,
//! between texels and in smaller versions too; of octahedral views, which are blended first, raised where
//! less of one would pass than it covers. Colour is darker by what of the sky's light does not reach
//! a place in the tree though it would a sheet with these normals. Normals are in the sheet's own
//! tangent space: of an octahedral picture the mesh's, nearer to the eye where leaves face all ways;
//! of a cross those of a round crown, leaning outwards and up, so that light wanes across it as across
//! the tree though the other sheet meets it at the stem.
//!
//! Known limits: a sheet has no depth, so that near by its parts slide against the tree's; seen at
//! an angle to both sheets a cross is narrower than the tree, by up to 29 %; light that comes from
//! behind a sheet does not reach it in a path tracer, whatever its normals, and sheets throw
//! shadows on each other where they throw any.

use glam::{Vec2, Vec3};
use rayon::prelude::*;

use super::light::{self, Sky, Spot};
use crate::diagnostic::Result;
use crate::mesh::Surface;
use crate::raster::{Picture, keep_cover, pad_transparent, spread, srgb_from_linear};
use crate::render::capture::{self, Sitter, Texel, Window};
use crate::scene::Octahedral;
use crate::work::{self, Work};

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    Cross,
    /// With so many views along a side of the picture, as [`VIEWS`] says.
    Octahedral {
        views: u32,
    },
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
    /// `colour` with leaves of other colours, as asked for.
    pub tinted: Vec<Picture>,
}

/// Where alpha is cut.
pub const CUTOFF: f32 = 0.5;
/// Samples along a side of a texel.
const PER_TEXEL: usize = 3;
/// Samples of a view that are drawn at a time, at least.
const BAND: usize = 1 << 18;
/// Greatest factor on alpha, and how often its range is halved to find the right one.
const MOST_GAIN: f32 = 64.0;
const HALVINGS: u32 = 10;
/// Texels along a block that keeps its cover.
const BLOCK: usize = 5;
/// How much brighter than its own a place may be where its sheet gets less light than it does.
const BRIGHTER: f32 = 2.0;
/// How far a crown's edge faces away from the square view, and how fast that grows from the stem:
/// as `(distance / half width)^SOON`.
const EDGE_RAD: f32 = 0.9;
const SOON: f32 = 0.4;
/// How far up a crown faces at its foot and its top, over how far it faces outwards.
const UPWARDS: (f32, f32) = (0.5, 1.1);
/// Part of the rows over which a crown's half width is taken.
const ABOUT: f32 = 0.04;
/// How much of the mesh's own normals are seen in a round crown's.
const RELIEF: f32 = 1.5;
/// Half the distance between both sides of a cross's sheet, metres.
const APART_M: f32 = 1e-3;
/// Texels between two views of a cross.
const GUTTER: usize = 8;
/// What is left free about an octahedral view, of its half width: in smaller versions of the picture, too,
/// no view reaches into the next.
pub(super) const MARGIN: f32 = 1.0 / 24.0;
/// Views along a side of an octahedral picture, as a rule and at least and most. Of an odd number one is
/// that from above.
pub const USUAL_VIEWS: u32 = 8;
pub const VIEWS: std::ops::RangeInclusive<u32> = 4..=32;

/// Bakes a model, whose extent is `bounds` (tree-local metres). `size_px`: texels
/// along the longer side of a sheet and its gutters, or along the side of an octahedral picture;
/// powers of two are best. `tints`: factors on the linear light of leaves, for a picture each; the same
/// for all leaves, however these differ in themselves.
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
    tints: &[Vec3],
) -> Result<Impostor> {
    work::count(Work::Impostors, 1);
    let sky = Sky::over(sitter, model, bounds)?;
    let of = Model { sitter, model, sky, tints };
    match kind {
        Kind::Cross => cross(&of, bounds, size_px as usize),
        Kind::Octahedral { views } => {
            octahedral(&of, bounds, views.clamp(*VIEWS.start(), *VIEWS.end()), size_px)
        }
    }
}

/// Who is baked.
struct Model<'a> {
    sitter: &'a Sitter<'a>,
    model: u32,
    sky: Sky,
    tints: &'a [Vec3],
}

/// A sheet: what it shows and where it lies.
struct Sheet {
    centre: Vec3,
    forward: Vec3,
    right: Vec3,
    /// Metres.
    size: Vec2,
}

/// What a texel of a cross spans: with its gutters, the longer side of a sheet is that of the picture or less.
pub fn cross_texel_m((lo, hi): (Vec3, Vec3), size_px: usize) -> f32 {
    let span = (hi - lo.with_z(lo.z.max(0.0))).max(Vec3::splat(1e-3));
    span.max_element() / size_px.saturating_sub(GUTTER).max(8) as f32
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
    let texel_m = cross_texel_m((lo, hi), size_px);
    let views: Vec<Frame> = sheets
        .par_iter()
        .map(|s| {
            // The longest side takes all texels there are, which rounding must not exceed.
            let texels = |m: f32| ((m / texel_m - 1e-3).ceil() as usize).max(4);
            let [w, h] = [s.size.x, s.size.y].map(texels);
            Frame::take(of, s.centre, s.forward, texel_m, [w, h], Facing::Round)
        })
        .collect::<Result<_>>()?;
    // Side by side, at the bottom of a picture whose sides are powers of two, as graphics cards
    // compress and shrink them best.
    let width = views.iter().map(|v| v.size[0] + GUTTER).sum::<usize>().next_power_of_two();
    let height = views.iter().map(|v| v.size[1]).fold(0, usize::max) + GUTTER;
    let height = height.next_power_of_two();
    let mut board = Board::new(width, height, of.tints, false);
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

fn octahedral(
    of: &Model<'_>,
    (lo, hi): (Vec3, Vec3),
    frames: u32,
    size_px: u32,
) -> Result<Impostor> {
    let centre = 0.5 * (lo + hi);
    // A ball, not the box: views of a wide crown would be empty for the most part.
    let reach_m = of.sitter.reach_m(of.model, centre).min(0.5 * (hi - lo).length());
    let radius_m = reach_m.max(1e-3) * (1.0 + MARGIN);
    let side = view_px(size_px, frames);
    let texel_m = 2.0 * radius_m / side as f32;
    let cells: Vec<(u32, u32)> =
        (0..frames).flat_map(|row| (0..frames).map(move |col| (col, row))).collect();
    let views: Vec<Frame> = cells
        .par_iter()
        .map(|&(col, row)| {
            Frame::take(
                of,
                centre,
                -direction(col, row, frames),
                texel_m,
                [side, side],
                Facing::Own,
            )
        })
        .collect::<Result<_>>()?;
    let whole = side * frames as usize;
    let mut board = Board::new(whole, whole, of.tints, true);
    for (&(col, row), view) in cells.iter().zip(&views) {
        board.paste(view, [col as usize * side, row as usize * side]);
    }
    let octahedral = Octahedral { frames, centre, radius_m, sheet_rms_m: f32::INFINITY };
    // The view from the south, whose plane is upright.
    let surface = sheet_towards(&octahedral, -Vec3::Y);
    board.finish(surface, Some(octahedral))
}

/// Side of a view in a picture of about this side: a power of two, so that all of them are no wider
/// than a quarter more.
fn view_px(size_px: u32, frames: u32) -> usize {
    let side = (size_px / frames).max(8).next_power_of_two();
    let is_too_large = side > 8 && 4 * side * frames > 5 * size_px;
    (if is_too_large { side / 2 } else { side }) as usize
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
    /// The part of it that leaves have.
    leaves: Vec3,
    /// Mean, in right, up, towards the eye.
    normal: Vec3,
    /// Share seen.
    alpha: f32,
    /// Light of the sky that reaches it.
    light: f32,
}

/// Which way what a sheet shows faces.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Facing {
    /// As the mesh does.
    Own,
    /// As a round crown about the stem.
    Round,
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
        facing: Facing,
    ) -> Result<Frame> {
        let n = PER_TEXEL;
        let sample_m = texel_m / n as f32;
        let window = Window { centre, forward, sample_m, size: [width * n, height * n] };
        let [right, up] = capture::sides(forward);
        let axes = |v: Vec3| Vec3::new(v.dot(right), v.dot(up), -v.dot(forward));
        // Bands small enough for the processor's cache, and no more of them than a model's vertices, which
        // each lays out anew, are worth.
        let least = BAND.max(of.sitter.vertices(of.model));
        let rows = least.div_ceil(width * n * n);
        let band = |first: usize, sample: &[Texel]| -> Vec<Baked> {
            let place = |i: usize| {
                let (x, y) = (i % (width * n), first + i / (width * n));
                let across = (x as f32 + 0.5 - 0.5 * (width * n) as f32) * sample_m;
                let above = (0.5 * (height * n) as f32 - 0.5 - y as f32) * sample_m;
                centre + right * across + up * above - forward * sample[i].before_m
            };
            let texel = |i: usize| {
                let corner = i / width * n * width * n + i % width * n;
                let seen = (0..n * n)
                    .map(|k| corner + k / n * width * n + k % n)
                    .filter(|i| sample[*i].is_seen());
                let (mut sum, mut count) = (Baked::default(), 0);
                for t in seen.clone().map(|i| &sample[i]) {
                    sum.albedo += Vec3::from(t.albedo);
                    sum.leaves += Vec3::from(t.albedo) * t.leaf;
                    sum.normal += t.normal;
                    count += 1;
                }
                let share = (count.max(1) as f32).recip();
                // One place says how light it is in the texel.
                let spot = seen.clone().nth(count / 2).map(|i| {
                    let Texel { normal, leaf, .. } = sample[i];
                    Spot { place: place(i), normal, leaf }
                });
                let baked = Baked {
                    albedo: sum.albedo * share,
                    leaves: sum.leaves * share,
                    normal: axes(sum.normal * share),
                    alpha: count as f32 / (n * n) as f32,
                    light: 0.0,
                };
                (baked, spot)
            };
            let (mut baked, spots): (Vec<_>, Vec<_>) =
                (0..sample.len() / (n * n)).map(texel).unzip();
            let is_seen = baked.iter_mut().zip(&spots).filter(|(_, spot)| spot.is_some());
            let spots: Vec<Spot> = spots.iter().copied().flatten().collect();
            is_seen.zip(of.sky.light(&spots)).for_each(|((baked, _), light)| baked.light = light);
            baked
        };
        let texel = of.sitter.portrait(of.model, &window, rows * n, band)?.concat();
        let mut frame = Frame { size: [width, height], texel };
        match facing {
            Facing::Own => frame.face_the_eye(),
            // The stem's root is the origin.
            Facing::Round => frame.round(-centre.dot(right) / texel_m + 0.5 * width as f32),
        }
        let before = light::before(-forward);
        frame.texel.par_iter_mut().filter(|t| t.alpha > 0.0).for_each(|t| {
            let normal = right * t.normal.x + up * t.normal.y - forward * t.normal.z;
            let on_sheet = light::on_sheet(normal, &before).max(1e-3);
            let brighter = (t.light / on_sheet).min(BRIGHTER);
            (t.albedo, t.leaves) = (t.albedo * brighter, t.leaves * brighter);
        });
        Ok(frame)
    }

    /// Leaves that face all ways are lit as one that faces the eye.
    fn face_the_eye(&mut self) {
        for t in &mut self.texel {
            let all_ways = (1.0 - t.normal.length()).max(0.0);
            t.normal = (t.normal + Vec3::Z * all_ways).normalize_or(Vec3::Z);
        }
    }

    /// Normals of a round crown about a stem `axis` texels from the left.
    fn round(&mut self, axis: f32) {
        let [w, h] = self.size;
        let aside = |x: usize| x as f32 + 0.5 - axis;
        // Area and second moment about the stem, row by row.
        let rows: Vec<(f32, f32)> = (self.texel.chunks(w))
            .map(|row| {
                row.iter().enumerate().fold((0.0, 0.0), |(area, moment), (x, t)| {
                    (area + t.alpha, moment + t.alpha * aside(x) * aside(x))
                })
            })
            .collect();
        let about = (ABOUT * h as f32) as usize;
        for (y, row) in self.texel.chunks_mut(w).enumerate() {
            let near = &rows[y.saturating_sub(about)..(y + about + 1).min(h)];
            let (area, moment) = near.iter().fold((0.0, 0.0), |(a, m), (da, dm)| (a + da, m + dm));
            // Evenly filled from edge to edge.
            let half = (3.0 * moment / f32::max(area, 1e-6)).sqrt().max(1.0);
            let high = 1.0 - (y as f32 + 0.5) / h as f32;
            let upwards = UPWARDS.0 + (UPWARDS.1 - UPWARDS.0) * high;
            for (x, t) in row.iter_mut().enumerate() {
                let off = (aside(x) / half).clamp(-1.0, 1.0);
                let (s, c) = (EDGE_RAD * off.signum() * off.abs().powf(SOON)).sin_cos();
                let relief = RELIEF * Vec3::new(t.normal.x, t.normal.y, 0.0);
                t.normal = (Vec3::new(s, upwards, c) + relief).normalize_or(Vec3::Z);
            }
        }
    }
}

/// The pictures as they are put together.
struct Board {
    colour: Picture,
    normal: Picture,
    views: Vec<Place>,
    tinted: Vec<(Vec3, Picture)>,
    /// A shader blends views before it cuts.
    is_blended: bool,
}

/// Where a view lies: texels from the left and from the top, and its size.
struct Place {
    corner: [usize; 2],
    size: [usize; 2],
    /// Texels' area that the model covers.
    covered: f32,
}

impl Board {
    fn new(width: usize, height: usize, tints: &[Vec3], is_blended: bool) -> Board {
        let [w, h] = [width as u32, height as u32];
        let colour = Picture::filled(w, h, [0; 4]);
        Board {
            tinted: tints.iter().map(|tint| (*tint, colour.clone())).collect(),
            colour,
            normal: Picture::filled(w, h, [128, 128, 255, 0]),
            views: Vec::new(),
            is_blended,
        }
    }

    /// `corner`: texels from the left and from the bottom.
    fn paste(&mut self, frame: &Frame, corner: [usize; 2]) {
        let [w, h] = frame.size;
        let alphas: Vec<f32> = frame.texel.iter().map(|t| t.alpha).collect();
        let top = self.colour.height as usize - corner[1] - h;
        let covered = alphas.iter().sum::<f32>();
        self.views.push(Place { corner: [corner[0], top], size: [w, h], covered });
        let alphas = if self.is_blended { alphas } else { spread(&alphas, w, BLOCK) };
        for (i, t) in frame.texel.iter().enumerate().filter(|(_, t)| t.alpha > 0.0) {
            let x = (corner[0] + i % w) as u32;
            let y = (top + i / w) as u32;
            let alpha = (alphas[i] * 255.0).round() as u8;
            let coded = |c: Vec3| {
                let [r, g, b] = c.to_array().map(|c| srgb_from_linear(c).round() as u8);
                [r, g, b, alpha]
            };
            self.colour.set(x, y, coded(t.albedo));
            for (tint, picture) in &mut self.tinted {
                picture.set(x, y, coded(t.albedo + t.leaves * (*tint - 1.0)));
            }
            let normal = t.normal.normalize_or(Vec3::Z);
            let [nx, ny, nz] = normal.to_array().map(|c| ((c * 0.5 + 0.5) * 255.0).round() as u8);
            self.normal.set(x, y, [nx, ny, nz, alpha]);
        }
    }

    fn finish(mut self, surface: Surface, octahedral: Option<Octahedral>) -> Result<Impostor> {
        pad_transparent(&mut self.colour);
        // Alphas that are blended are never less than what is covered: their mean passes where one view covers
        // a place and another hardly does.
        let least = if self.is_blended {
            1.0
        } else {
            keep_cover(&mut self.colour, CUTOFF, 1.0);
            0.0
        };
        for view in &self.views {
            fit(&mut self.colour, view, least);
        }
        // All are cut alike.
        for (_, picture) in &mut self.tinted {
            pad_transparent(picture);
            picture.data.iter_mut().zip(&self.colour.data).for_each(|(p, own)| p[3] = own[3]);
        }
        let mut normal = halved(&self.normal);
        pad_transparent(&mut normal);
        for p in &mut normal.data {
            p[3] = 255;
        }
        let tinted = self.tinted.into_iter().map(|(_, picture)| picture).collect();
        Ok(Impostor { surface, colour: self.colour, normal, octahedral, tinted })
    }
}

/// Changes a view's alpha so that as much passes the cutoff as is covered: draws what is seen nearer
/// to the cutoff, or lifts all. `least`: as [`shifted`] has it.
fn fit(picture: &mut Picture, view: &Place, least: f32) {
    let (mut low, mut high) = (least, 2.0f32);
    for _ in 0..HALVINGS {
        let middle = 0.5 * (low + high);
        if passing(picture, view, middle) < view.covered { low = middle } else { high = middle }
    }
    let [left, top] = view.corner;
    for row in picture.data.chunks_mut(picture.width as usize).skip(top).take(view.size[1]) {
        for p in &mut row[left..left + view.size[0]] {
            let alpha = shifted(p[3], high) * 255.0;
            // Rounding takes nothing over the cutoff.
            let is_seen = alpha >= CUTOFF * 255.0;
            p[3] = if is_seen { alpha.ceil() } else { alpha.floor() } as u8;
        }
    }
}

/// Alpha, 0…1, as it is for `by` = 1; below that what is seen is nearer to the cutoff, above it all are
/// raised.
fn shifted(alpha: u8, by: f32) -> f32 {
    let alpha = f32::from(alpha) / 255.0;
    if by > 1.0 {
        (alpha * MOST_GAIN.powf(by - 1.0)).min(1.0)
    } else {
        alpha.min(CUTOFF + (alpha - CUTOFF) * by)
    }
}

/// Texels' area that passes the cutoff, looked at in 2 × 2 places between texels' middles, as viewers
/// see them: single texels of a thin crown would vanish there.
fn passing(picture: &Picture, view: &Place, by: f32) -> f32 {
    let table: Vec<f32> = (0..=255).map(|alpha| shifted(alpha, by)).collect();
    let ([w, h], width) = (view.size, picture.width as usize);
    let rows: Vec<&[[u8; 4]]> = picture.data.chunks(width).skip(view.corner[1]).take(h).collect();
    let alpha = |y: usize, x: usize| table[usize::from(rows[y][view.corner[0] + x][3])];
    let count = |y: usize| {
        let mut passing = 0;
        let mut left = [alpha(y, 0), alpha(y + 1, 0)];
        for x in 1..w {
            let right = [alpha(y, x), alpha(y + 1, x)];
            for t in [0.25, 0.75] {
                let [top, bottom] = [0, 1].map(|k| left[k] + (right[k] - left[k]) * t);
                for u in [0.25, 0.75] {
                    passing += usize::from(top + (bottom - top) * u >= CUTOFF);
                }
            }
            left = right;
        }
        passing
    };
    (0..h - 1).into_par_iter().map(count).sum::<usize>() as f32 * 0.25
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
