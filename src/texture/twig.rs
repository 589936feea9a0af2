//! The leaf picture of a species. Its quarters: a single twig; another, of leaves a longer one at a smaller scale, or
//! one of a dry branch where the tree has some; a bough at a still smaller scale, for large cards; and two single leaves
//! or needles beside plain bark and the leaves' mean colour, for a model of every leaf, and the bough again
//! as it is in shade, half as large: leaves of few large cards shade each other less than those they stand for.
//!
//! Leaves sit alternately, or all round for needles, as the golden angle seen from one side;
//! what lies deeper is painted first and darker.

mod needle;

use glam::Vec2;
use rayon::prelude::*;

use super::atlas::{Atlas, BANDS, Cell};
use super::canvas::{Canvas, Leaf, Stroke};
use super::outline::Outline;
use crate::raster::{Picture, keep_cover, pad_transparent, spread};
use crate::seed::{Draws, Seed};
use crate::species::model::{Bark, Foliage, LeafShape};
use crate::species::{Species, own};

/// A bough cell shows this many times the length of a twig cell; that of a longer twig lies halfway, by ratio.
const BOUGH: f32 = 2.4;
const LONGER: f32 = 1.55;
/// … and one of a dry branch, which serves for cards of all sizes, this many; how far its colour goes to grey.
const DRY: f32 = 1.5;
const GREY: f32 = 0.35;
/// What a bough in shade reflects, over one in light.
pub const SHADE: f32 = 0.6;
/// The same of sRGB values, which go with the light to this power.
const GAMMA: f32 = 1.0 / 2.2;
/// Golden angle.
const GOLDEN_RAD: f32 = 2.399_963;
/// Share of its cell that a single leaf is long, and where it begins.
const LEAF_SHARE: f32 = 0.96;
const LEAF_FROM: f32 = 0.02;
/// Where leaves have fallen, one twig has more left than the other, and than boughs: powers of the
/// share that is left.
const UNEVEN: [f32; 3] = [0.6, 1.6, 1.0];
/// Strokes and leaves a cell may take.
const PAINT_LIMIT: usize = 60_000;
/// How far behind the others the last leaves to turn are.
const TURNS_LATE: f32 = 0.6;

/// Alpha from which on a leaf is seen.
pub const CUTOFF: f32 = 0.5;
/// The most that smaller versions show, in parts of what the picture does.
const MOST_COVER: f32 = 1.1;
/// Pixels along a cell below which bare twigs, a pixel wide, would be too thick, and in which they are
/// drawn then; and along a block of pixels that shows as much of them.
const FINE: u32 = 512;
const BLOCK: usize = 5;
/// Sideways bend of a leaf's tip at most, share of its length.
const MOST_BENT: f32 = 0.14;
/// Shift of a leaf's halves against each other at most, share of its length.
const MOST_SKEWED: f32 = 0.045;
/// Half the width of a broadleaf's main shoot at its foot, on a twig and a bough: share of the cell. Of bare twigs thinner
/// shoots are drawn up to so thick, and so many times as thick as they are.
const TWIG_STEM: f32 = 0.008;
const BOUGH_STEM: f32 = 0.006;
const STOUT: f32 = 0.005;
const STOUTER: f32 = 1.6;
/// Half the width of a petiole over the leaf's length.
const PETIOLE: f32 = 0.014;
/// Least corners of the bough, in light and in shade, in quarters of the picture's side.
const BOUGH_AT: [u32; 2] = [0, 2];
const SHADE_AT: [u32; 2] = [2, 3];
/// Half the side of the plain squares over the picture's, to their middles.
const PLAIN: f32 = 1.0 / 16.0;

/// What a part of the picture shows.
#[derive(Clone, Copy, PartialEq)]
enum Part {
    Twig,
    Longer,
    Bough,
    Dry,
    Leaf,
}

/// Draws the picture, `size_px` square, and says where its twigs lie.
pub fn draw(species: &Species, size_px: u32, seed: Seed) -> (Picture, Atlas) {
    let f = &species.foliage;
    let quarter = (size_px / 2).max(16) & !1;
    let twig_m = f.twig_length_m.max(1e-3);
    // What is shown, and its least corner in quarters of the picture's side, from the bottom.
    // One tells the size of leaves, and little that of needles or bare shoots.
    let other = match f.has_dry {
        true => Part::Dry,
        false if f.is_bare() || f.shape.is_needle() => Part::Twig,
        false => Part::Longer,
    };
    let parts = [
        (Part::Twig, [0, 0]),
        (other, [2, 0]),
        (Part::Bough, BOUGH_AT),
        (Part::Leaf, [2, 2]),
        (Part::Leaf, [3, 2]),
    ];
    let outline = Outline::of(f);
    let dry = f.has_dry.then(|| dry(species));
    let drawn: Vec<(Vec<[u8; 4]>, u32, f32)> = parts
        .into_par_iter()
        .enumerate()
        .map(|(k, (part, _))| {
            let side = if part == Part::Leaf { quarter / 2 } else { quarter };
            // Bare twigs are never thinner than a pixel: coarse ones are drawn fine, and thinned.
            let species = dry.as_ref().filter(|_| part == Part::Dry).unwrap_or(species);
            let f = &species.foliage;
            let finer = if f.is_bare() && side < FINE { FINE.div_ceil(side) } else { 1 };
            let factor = if side > 600 { 2 } else { 3 };
            let size_m = match part {
                Part::Twig => twig_m,
                Part::Longer => twig_m * LONGER,
                Part::Bough => twig_m * BOUGH,
                Part::Dry => twig_m * DRY,
                Part::Leaf => leaf_length_m(f) / LEAF_SHARE,
            };
            let mut painter = Painter {
                canvas: Canvas::new((side * finer) as usize, factor),
                species,
                outline: &outline,
                size_m,
                draws: seed.derive("twig", k as u64).draws(),
                painted: 0,
                kept: f.kept.clamp(0.0, 1.0).powf(UNEVEN[k.min(2)]),
            };
            match part {
                Part::Leaf => painter.single(),
                _ => painter.cell(part == Part::Bough),
            }
            let pixels = painter.canvas.resolve(1.25);
            let pixels = match finer {
                1 => pixels,
                _ => reduced(&pixels, side as usize, finer as usize),
            };
            (pixels, side, size_m)
        })
        .collect();
    let mut picture = Picture::filled(quarter * 2, quarter * 2, [0; 4]);
    let (mut cells, mut leaves, mut dry) = (Vec::new(), Vec::new(), Vec::new());
    let (last, first): (Vec<_>, Vec<_>) =
        drawn.iter().zip(parts).partition(|(_, (part, _))| *part == Part::Dry);
    // Of bare twigs the mean is that of their bark.
    for (parts, are_in_leaf) in [(first, !f.is_bare()), (last, false)] {
        for ((pixels, side, size_m), (part, corner)) in parts {
            let [left, bottom] = corner.map(|c| c * quarter / 2);
            let span = *side as f32 / picture.width as f32;
            let min = Vec2::new(left as f32, bottom as f32) / picture.width as f32;
            let foot = if part == Part::Leaf { foot(&outline) } else { 0.0 };
            let cell = Cell { foot, ..describe(pixels, *side as usize, *size_m, min, span) };
            match part {
                Part::Leaf => leaves.push(cell),
                Part::Dry => dry.push(cell),
                Part::Twig | Part::Longer | Part::Bough => cells.push(cell),
            }
            for y in 0..*side {
                let row = picture.height - 1 - (bottom + y);
                for x in 0..*side {
                    picture.set(left + x, row, pixels[(y * side + x) as usize]);
                }
            }
        }
        if are_in_leaf {
            match_colour(&mut picture, f.colour);
        }
    }
    // Bare twigs hardly shade each other.
    let shade =
        cells.last().filter(|_| !f.is_bare()).map(|bough| shade(&mut picture, bough, quarter));
    let places = plain(&mut picture, species, quarter);
    finish(&mut picture);
    let atlas = Atlas::new(cells, leaves, places).unwrap_or_else(|| Atlas::whole(twig_m));
    (picture, atlas.with_dry(dry).with_shade(shade))
}

/// Draws the bough again as it is in shade.
fn shade(picture: &mut Picture, bough: &Cell, quarter: u32) -> Cell {
    let [from, to] = [BOUGH_AT, SHADE_AT].map(|at| at.map(|c| c * quarter / 2));
    let top = picture.height - 1;
    let row = |y: u32| top - y;
    let bright: Vec<[u8; 4]> = (0..quarter * quarter)
        .map(|i| picture.at(from[0] + i % quarter, row(from[1] + i / quarter)))
        .collect();
    let (side, darker) = (quarter / 2, SHADE.powf(GAMMA));
    for (i, [r, g, b, alpha]) in (0..).zip(reduced(&bright, side as usize, 2)) {
        let [r, g, b] = [r, g, b].map(|c| (darker * f32::from(c)).round() as u8);
        picture.set(to[0] + i % side, row(to[1] + i / side), [r, g, b, alpha]);
    }
    let [min, span] = [to, [side; 2]].map(|at| {
        let [x, y] = at.map(|c| c as f32 / picture.width as f32);
        Vec2::new(x, y)
    });
    Cell { min, max: min + span, ..bough.clone() }
}

/// The species as its dry branches are: without leaves, and grey.
fn dry(species: &Species) -> Species {
    let mut dry = species.clone();
    dry.foliage = species.foliage.dry();
    let colour = twig_colour(&species.bark);
    let grey = colour.iter().sum::<f32>() / 3.0 + 20.0;
    dry.bark.twig = Some(colour.map(|c| (c + (grey - c) * GREY) as u8));
    dry
}

/// A square picture of `side` pixels from one `times` as large, which shows as much.
fn reduced(fine: &[[u8; 4]], side: usize, times: usize) -> Vec<[u8; 4]> {
    let is_seen = |p: &[u8; 4]| f32::from(p[3]) >= 255.0 * CUTOFF;
    let block = |i: usize| {
        let at = (i / side * side * times + i % side) * times;
        let rows = (0..times).map(move |y| at + y * side * times);
        rows.flat_map(|row| &fine[row..row + times]).filter(|p| is_seen(p))
    };
    let count = |i: usize| block(i).count();
    let alpha: Vec<f32> =
        (0..side * side).map(|i| count(i) as f32 / (times * times) as f32).collect();
    let alpha = spread(&alpha, side, BLOCK);
    let pixel = |(i, alpha): (usize, f32)| {
        let all = count(i).max(1) as u32;
        let sum = block(i).fold([0; 3], |sum, p| [0, 1, 2].map(|c| sum[c] + u32::from(p[c])));
        let [r, g, b] = sum.map(|s| (s / all) as u8);
        [r, g, b, (255.0 * alpha).round() as u8]
    };
    alpha.into_iter().enumerate().map(pixel).collect()
}

/// The last eighth of the picture, half bark and half the leaves' mean colour; their middles.
fn plain(picture: &mut Picture, species: &Species, quarter: u32) -> [Vec2; 2] {
    let bark = &species.bark;
    let wood = twig_colour(bark).map(|c| c as u8);
    let side = quarter / 2;
    for y in 0..side {
        for x in 0..side {
            let [r, g, b] = if x < side / 2 { wood } else { species.foliage.colour };
            picture.set(quarter + side + x, side - 1 - y, [r, g, b, 255]);
        }
    }
    [1.0, 3.0].map(|s| Vec2::new(0.75 + s * PLAIN, 0.75 + 2.0 * PLAIN))
}

/// Colour of twigs, darker than that of branches where the species names none.
fn twig_colour(bark: &Bark) -> [f32; 3] {
    let [tone, dark] = [bark.upper.unwrap_or(bark.dark), bark.dark];
    bark.twig.unwrap_or([0, 1, 2].map(|c| u8::midpoint(tone[c], dark[c]))).map(f32::from)
}

/// Length of what a leaf's cell shows: of a compound leaf one leaflet.
fn leaf_length_m(foliage: &Foliage) -> f32 {
    match foliage.shape {
        LeafShape::Pinnate => 0.5 * foliage.leaf_width_m,
        _ => foliage.leaf_length_m,
    }
    .max(1e-4)
}

/// Where the petiole meets the blade in a leaf's cell, share of its side.
fn foot(outline: &Outline) -> f32 {
    LEAF_FROM + LEAF_SHARE * outline.foot
}

/// The cell of one leaf where there is no picture: its outline on a plain ground.
pub fn plain_leaf(foliage: &Foliage) -> Cell {
    let outline = Outline::of(foliage);
    let reach: [[f32; 2]; BANDS] = std::array::from_fn(|band| {
        let [from, to] = [band, band + 1].map(|b| b as f32 / BANDS as f32);
        let half = (LEAF_SHARE * outline.reach(from, to).max(0.01)).min(0.5);
        [0.5 - half, 0.5 + half]
    });
    Cell {
        min: Vec2::ZERO,
        max: Vec2::ONE,
        size_m: leaf_length_m(foliage) / LEAF_SHARE,
        reach,
        coverage: (LEAF_SHARE * outline.area()).min(1.0),
        foot: foot(&outline),
    }
}

/// A user's own picture of a twig `size_m` long: one cell.
pub fn own(picture: &Picture, size_m: f32) -> (Picture, Atlas) {
    let side = picture.width as usize;
    let bottom_up: Vec<[u8; 4]> =
        picture.data.chunks_exact(side).rev().flatten().copied().collect();
    let cell = describe(&bottom_up, side, size_m, Vec2::ZERO, 1.0);
    let atlas = Atlas::of_one(cell).filled_at(own::opaque_spot(picture));
    let mut picture = picture.clone();
    finish(&mut picture);
    (picture, atlas)
}

/// Colour under what is transparent, and alpha that smaller versions of the picture need.
fn finish(picture: &mut Picture) {
    pad_transparent(picture);
    keep_cover(picture, CUTOFF, MOST_COVER);
}

/// The square cell with the corner `min` and the side `span` of the picture's, from its pixels, row
/// 0 at the bottom.
fn describe(pixels: &[[u8; 4]], side: usize, size_m: f32, min: Vec2, span: f32) -> Cell {
    let mut reach = [[1.0f32, 0.0f32]; BANDS];
    let mut seen = 0usize;
    for y in 0..side {
        let band = &mut reach[y * BANDS / side];
        for x in 0..side {
            let alpha = pixels[y * side + x][3];
            if alpha >= 100 {
                band[0] = band[0].min(x as f32 / side as f32);
                band[1] = band[1].max((x + 1) as f32 / side as f32);
            }
            seen += usize::from(alpha >= 128);
        }
    }
    for band in &mut reach {
        if band[0] > band[1] {
            *band = [0.5, 0.5];
        }
    }
    let coverage = seen as f32 / (side * side).max(1) as f32;
    Cell { min, max: min + span, size_m, reach, coverage, foot: 0.0 }
}

/// Scales the pixels so that what is seen has the mean luminance of `colour`; hues stay.
fn match_colour(picture: &mut Picture, colour: [u8; 3]) {
    let luminance =
        |c: [u8; 3]| 0.2126 * f64::from(c[0]) + 0.7152 * f64::from(c[1]) + 0.0722 * f64::from(c[2]);
    let (mut sum, mut count) = (0.0f64, 0u32);
    for p in picture.data.iter().filter(|p| p[3] >= 128) {
        count += 1;
        sum += luminance([p[0], p[1], p[2]]);
    }
    let gain = (luminance(colour) * f64::from(count) / sum.max(1.0)).clamp(0.5, 2.5) as f32;
    for p in picture.data.iter_mut() {
        for c in &mut p[..3] {
            *c = (f32::from(*c) * gain).clamp(0.0, 255.0) as u8;
        }
    }
}

struct Painter<'a> {
    canvas: Canvas,
    species: &'a Species,
    outline: &'a Outline,
    size_m: f32,
    draws: Draws,
    painted: usize,
    /// Share of the leaves that hang.
    kept: f32,
}

/// Side veins of a leaf.
fn veins(shape: LeafShape) -> f32 {
    match shape {
        LeafShape::Lanceolate | LeafShape::Pinnate => 0.0,
        LeafShape::Lobed => 5.0,
        LeafShape::Obovate => 8.0,
        _ => 7.0,
    }
}

/// Whether leaves stand left and right of their shoot, rather than all round.
fn is_in_two_rows(shape: LeafShape) -> bool {
    matches!(shape, LeafShape::Cordate | LeafShape::Obovate)
}

/// Where a leaf stands, in cell coordinates.
struct Place {
    base: Vec2,
    /// Unit direction of petiole and blade.
    along: Vec2,
    /// Lengths of petiole and blade.
    stalk: f32,
    size: f32,
    /// Before its shoot, rather than behind it.
    is_front: bool,
}

/// A shoot in cell coordinates (0…1), bent evenly along its length.
#[derive(Clone, Copy)]
struct Shoot {
    base: Vec2,
    angle: f32,
    length: f32,
    /// Turn from base to tip, radians.
    bend: f32,
    /// 0 the deepest and darkest … 1.
    depth: f32,
}

impl Shoot {
    fn direction(&self, t: f32) -> Vec2 {
        let (s, c) = (self.angle + self.bend * t).sin_cos();
        Vec2::new(s, c)
    }

    fn at(&self, t: f32) -> Vec2 {
        // The mean direction up to t is that of t / 2, near enough for a bend below a radian.
        self.base + self.direction(t * 0.5) * (self.length * t)
    }
}

impl Painter<'_> {
    /// A length in metres as a share of the cell.
    fn share(&self, metres: f32) -> f32 {
        metres / self.size_m
    }

    fn jitter(&mut self, spread: f32) -> f32 {
        self.draws.between(-spread, spread)
    }

    fn tint(&mut self, depth: f32) -> ([f32; 3], f32) {
        let f = &self.species.foliage;
        let v = f.variation.clamp(0.0, 1.0);
        let light = (0.58 + 0.5 * depth) * (1.0 + v * self.draws.between(-0.5, 0.5));
        let warmth = self.draws.between(-0.4, 0.6);
        let warm = v * warmth;
        let mut colour = f.colour.map(f32::from);
        // No draw of its own: leaves lie as in summer.
        if let Some(from) = f.turns_from {
            let left = TURNS_LATE * (0.6 - warmth).powi(2);
            colour = [0, 1, 2].map(|c| colour[c] + (f32::from(from[c]) - colour[c]) * left);
        }
        ([colour[0] * (1.0 + 0.5 * warm), colour[1] * (1.0 + 0.12 * warm), colour[2]], light)
    }

    /// Whether the next leaf is one of those that do not hang any more.
    fn has_fallen(&mut self) -> bool {
        self.kept < 1.0 && self.draws.unit() >= self.kept
    }

    fn spent(&mut self) -> bool {
        self.painted += 1;
        self.painted > PAINT_LIMIT
    }

    fn wood(&mut self, shoot: &Shoot, base_half: f32, tip_half: f32) {
        let leafy = self.species.foliage.colour.map(f32::from);
        let tone = twig_colour(&self.species.bark);
        // Bare twigs are all there is to see: they stand for finer ones and buds, too, and thinner ones
        // would come out dotted at the cutoff.
        let is_bare = self.species.foliage.is_bare();
        let green = if is_bare { 0.0 } else { 0.1 };
        let colour = [0, 1, 2].map(|c| 0.78 * tone[c] + green * leafy[c]);
        let least = if is_bare { 1.0 } else { 0.45 } * self.canvas.pixel();
        let stout = |half: f32| (half * STOUTER).min(half.max(STOUT));
        let [base_half, tip_half] =
            [base_half, tip_half].map(|half| if is_bare { stout(half) } else { half });
        let steps = 10;
        for k in 0..steps {
            let (a, b) = (k as f32 / steps as f32, (k + 1) as f32 / steps as f32);
            let half = |t: f32| (base_half + (tip_half - base_half) * t).max(least);
            self.canvas.stroke(&Stroke {
                from: shoot.at(a),
                to: shoot.at(b),
                half: [half(a), half(b)],
                colour,
                light: [0.9; 2],
            });
        }
    }

    /// One leaf that fills the picture; for needles their colour from base to tip.
    fn single(&mut self) {
        let (colour, light) = self.tint(0.75);
        if self.species.foliage.shape.is_needle() {
            self.canvas.stroke(&Stroke {
                from: Vec2::new(0.5, -0.5),
                to: Vec2::new(0.5, 1.5),
                half: [2.0; 2],
                colour,
                light: [light * 0.75, light * 1.15],
            });
            return;
        }
        let outline = self.outline;
        let room = 0.48 - LEAF_SHARE * outline.widest;
        let bend = self.jitter(0.05).clamp(-room.max(0.0), room.max(0.0));
        let narrower = (1.0 + room.min(0.0) / 0.48).max(0.1);
        let shade = self.draws.between(0.88, 1.0);
        self.canvas.leaf(&Leaf {
            outline,
            base: Vec2::new(0.5, foot(outline)),
            along: Vec2::Y,
            length: LEAF_SHARE,
            open: [narrower; 2],
            bend,
            skew: self.draws.between(-MOST_SKEWED, MOST_SKEWED),
            colour,
            light: [light, light * shade],
            veins: veins(self.species.foliage.shape),
        });
    }

    fn cell(&mut self, bough: bool) {
        let bend = self.jitter(0.12);
        let lean = self.jitter(0.06);
        let main = Shoot { base: Vec2::new(0.5, 0.01), angle: lean, length: 0.9, bend, depth: 0.8 };
        match self.species.foliage.shape {
            LeafShape::Needle => self.spray(main),
            LeafShape::Tuft => self.tufts(main, bough),
            LeafShape::Bundle => self.brushes(main, bough),
            _ => self.leafy(main, bough),
        }
    }

    /// Side shoots of a shoot, alternately left and right, shaped to fill the cell but for a `margin`.
    fn laterals(
        &mut self,
        main: &Shoot,
        spacing: f32,
        [reach, angle, margin]: [f32; 3],
    ) -> Vec<Shoot> {
        let count = (main.length / spacing.max(0.01)).clamp(1.0, 60.0) as usize;
        let mut out = Vec::with_capacity(count);
        for k in 0..count {
            let t = 0.06 + 0.88 * (k as f32 + self.draws.between(0.2, 0.8)) / count as f32;
            let side = if k % 2 == 0 { 1.0 } else { -1.0 };
            // Longest below the middle, short towards the tip.
            let hull = (t / 0.3).min(1.0).powf(0.5) * (1.0 - t).max(0.0).powf(0.7) * 1.25;
            let length = reach * hull.max(0.12) * self.draws.between(0.5, 1.15);
            let turn = angle * (1.0 - 0.35 * t) * self.draws.between(0.85, 1.15);
            let base = main.at(t);
            let heading = main.angle + main.bend * t + side * turn;
            // Stay inside the cell.
            let room = if heading.sin() > 0.0 { 0.98 - base.x } else { base.x - 0.02 };
            let limit = (room - margin).max(0.01) / heading.sin().abs().max(0.05);
            out.push(Shoot {
                base,
                angle: heading,
                length: length.min(limit).min((0.97 - base.y - margin).max(0.02)),
                bend: -side * self.draws.between(0.15, 0.5),
                depth: self.draws.unit(),
            });
        }
        out.sort_by(|a, b| a.depth.total_cmp(&b.depth));
        out
    }

    fn leafy(&mut self, main: Shoot, bough: bool) {
        let shoots = self.clothed(main, bough);
        // Deep leaves first, then wood, then the leaves in front of it.
        for is_front in [false, true] {
            for (shoot, half, places) in &shoots {
                if is_front {
                    self.wood(shoot, *half, half * 0.4);
                }
                for place in places.iter().filter(|p| p.is_front == is_front) {
                    if self.spent() {
                        return;
                    }
                    if !self.has_fallen() {
                        self.hang(place, shoot.depth);
                    }
                }
            }
        }
    }

    /// Shoots, their half widths at the base, and where their leaves stand; without those on which
    /// no leaf has room.
    fn clothed(&mut self, main: Shoot, bough: bool) -> Vec<(Shoot, f32, Vec<Place>)> {
        let leaf = self.share(self.species.foliage.leaf_length_m).clamp(0.01, 0.5);
        // Room for the leaf at the tip.
        let main = Shoot { length: main.length.min(0.97 - leaf), ..main };
        let shape = self.species.foliage.shape;
        // Birch twigs hang in strands.
        let strands = bough && shape == LeafShape::Deltoid;
        let (angle, reach) = match shape {
            LeafShape::Lanceolate => (0.55, 0.75),
            _ if strands => (0.55, 0.75),
            LeafShape::Lobed => (0.95, 0.9),
            LeafShape::Round | LeafShape::Ovate | LeafShape::Cordate | LeafShape::Obovate => {
                (0.9, 0.75)
            }
            _ => (0.85, 0.6),
        };
        let spacing = 0.75 * leaf.max(0.03);
        let form = [reach, angle, 0.6 * leaf];
        let mut shoots = Vec::new();
        if bough {
            // Few uneven side shoots, each a clump of its own light: no leaf of leaves.
            for mut lateral in self.laterals(&main, (spacing * 1.8).max(0.085), form) {
                lateral.length *= self.draws.between(0.55, 1.05);
                let (gap, reach) = if strands { (1.2, 0.13) } else { (0.9, 0.24) };
                let form = [reach, angle, 0.6 * leaf];
                let twigs = self.laterals(&lateral, (leaf * gap).max(0.036), form);
                let of_clump =
                    |t: Shoot| Shoot { depth: 0.65 * lateral.depth + 0.35 * t.depth, ..t };
                shoots.extend(twigs.into_iter().map(|t| (of_clump(t), 0.0015)));
                shoots.push((lateral, 0.003));
            }
        } else {
            shoots.extend(self.laterals(&main, spacing, form).into_iter().map(|s| (s, 0.004)));
        }
        shoots.push((main, if bough { BOUGH_STEM } else { TWIG_STEM }));
        shoots
            .into_iter()
            .map(|(shoot, half)| (shoot, half, self.places(&shoot, leaf)))
            .filter(|(.., places)| !places.is_empty())
            .collect()
    }

    /// Where leaves stand on a shoot: whole ones. One that would leave the cell turns to the other
    /// side of its shoot, else of the cell; the last of a shoot is made smaller rather than left out.
    fn places(&mut self, shoot: &Shoot, leaf: f32) -> Vec<Place> {
        let shape = self.species.foliage.shape;
        let (gap, petiole) = match shape {
            LeafShape::Lanceolate => (0.13, 0.06),
            LeafShape::Lobed => (0.24, 0.05),
            LeafShape::Round => (0.5, 0.6),
            LeafShape::Cordate => (0.5, 0.4),
            LeafShape::Obovate => (0.5, 0.14),
            LeafShape::Deltoid => (0.34, 0.3),
            LeafShape::Pinnate => (0.18, 0.0),
            _ => (0.34, 0.14),
        };
        let in_two_rows = is_in_two_rows(shape);
        let count = (shoot.length / (gap * leaf)).clamp(1.0, 80.0) as usize;
        let mut places = Vec::with_capacity(count + 1);
        for k in 0..=count {
            let along = k as f32 / count as f32;
            // An oak's leaves crowd towards the tip.
            let along = if shape == LeafShape::Lobed { along.sqrt() } else { along };
            let t = (0.12 + 0.88 * along).min(1.0);
            let last = k == count;
            let (across, towards) = if in_two_rows {
                (if k % 2 == 0 { 1.0 } else { -1.0 }, self.jitter(1.0))
            } else {
                (k as f32 * GOLDEN_RAD + shoot.depth * 6.0).sin_cos()
            };
            let spread = if last { 0.1 } else { 0.95 };
            let swing = across * spread + self.jitter(0.35);
            let straight = shoot.angle + shoot.bend * t;
            let heading = straight + swing;
            let base = shoot.at(t);
            let size = leaf * self.draws.between(0.72, 1.08) * (1.0 - 0.25 * t * t);
            let stalk = petiole * self.draws.between(0.7, 1.1);
            let turns = [heading, heading - 2.0 * swing, -0.6 * heading];
            let sizes = if last { &[1.0, 0.8, 0.6][..] } else { &[1.0] };
            let place = |size: f32, heading: f32| Place {
                base,
                along: Vec2::new(heading.sin(), heading.cos()),
                stalk: stalk * size,
                size,
                is_front: last || towards > 0.0,
            };
            let tries = sizes.iter().flat_map(|s| turns.map(|turn| place(size * s, turn)));
            places.extend(tries.into_iter().find(|p| self.fits(p)));
        }
        places
    }

    /// Whether a leaf is within the cell however it bends.
    fn fits(&self, place: &Place) -> bool {
        let f = &self.species.foliage;
        let widest = match f.shape {
            LeafShape::Pinnate => 0.5 * f.leaf_width_m / f.leaf_length_m.max(1e-6),
            _ => self.outline.widest,
        };
        let Place { base, along, stalk, size, .. } = *place;
        let inside = |at: f32, half: f32| {
            let (middle, half) = (base + along * (stalk + at * size), along.perp() * (half * size));
            [middle - half, middle + half]
                .iter()
                .all(|p| p.x > 0.01 && p.x < 0.99 && p.y > 0.005 && p.y < 0.99)
        };
        // The bend moves the middle by a quarter of what it moves the tip.
        inside(1.0, MOST_BENT)
            && inside(0.3, widest + 0.1 * MOST_BENT)
            && inside(0.65, widest + 0.4 * MOST_BENT)
    }

    /// Paints the leaf of a place, and its petiole.
    fn hang(&mut self, place: &Place, depth: f32) {
        let Place { base, along, stalk, size, is_front } = *place;
        let shape = self.species.foliage.shape;
        let depth = if is_front { 0.4 + 0.6 * depth } else { 0.35 * depth };
        let (colour, light) = self.tint(depth);
        let foot = base + along * stalk;
        let thin = 0.4 * self.canvas.pixel();
        self.canvas.stroke(&Stroke {
            from: base,
            to: foot,
            half: [thin.max(PETIOLE * size); 2],
            colour,
            light: [light * 0.85; 2],
        });
        let least = match shape {
            LeafShape::Lobed => 0.66,
            _ if is_in_two_rows(shape) => 0.7,
            _ => 0.45,
        };
        let tilt = self.draws.between(least, 1.0);
        let other = (tilt + self.jitter(0.25)).clamp(0.3, 1.0);
        let shade = self.draws.between(0.86, 1.0);
        let open = if self.draws.unit() < 0.5 { [tilt, other] } else { [other, tilt] };
        let bend = self.jitter(MOST_BENT);
        let skew = self.jitter(MOST_SKEWED);
        if shape == LeafShape::Pinnate {
            self.compound(base, along, size, open, colour, light);
            return;
        }
        self.canvas.leaf(&Leaf {
            outline: self.outline,
            base: foot,
            along,
            length: size,
            open,
            bend,
            skew,
            colour,
            light: [light, light * shade],
            veins: veins(shape),
        });
    }

    /// Leaflets in pairs along a rachis.
    fn compound(
        &mut self,
        base: Vec2,
        along: Vec2,
        size: f32,
        open: [f32; 2],
        colour: [f32; 3],
        light: f32,
    ) {
        let f = &self.species.foliage;
        let half_width = 0.5 * f.leaf_width_m / f.leaf_length_m.max(1e-6) * size;
        let thin = (0.4 * self.canvas.pixel()).max(0.012 * size);
        self.canvas.stroke(&Stroke {
            from: base,
            to: base + along * (size * 0.8),
            half: [thin; 2],
            colour,
            light: [light * 0.85; 2],
        });
        let count = f.cluster.clamp(1, 60);
        for n in 0..count {
            let is_last = n + 1 == count;
            let pair = (n / 2) as f32 / ((count - 1) / 2).max(1) as f32;
            let t = if is_last { 0.8 } else { (0.25 + 0.55 * pair).min(0.78) };
            let side = if n % 2 == 0 { 1.0 } else { -1.0 };
            // Of a leaf that is turned away one side is seen shortened.
            let turn = if is_last { 0.0 } else { side * (1.2 + self.jitter(0.1)) };
            let heading = Vec2::from_angle(turn).rotate(along);
            let length = half_width * if is_last { 1.0 } else { open[n as usize % 2].max(0.5) };
            self.canvas.leaf(&Leaf {
                outline: self.outline,
                base: base + along * (size * t),
                along: heading,
                length,
                open: [0.9, 0.75],
                bend: 0.0,
                skew: 0.0,
                colour,
                light: [light, light * 0.92],
                veins: 0.0,
            });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_shoot_ends_in_a_leaf() {
        for name in ["corylus_avellana", "tilia_cordata", "betula_pendula", "quercus_robur"] {
            let species = crate::species::load(name).unwrap();
            let outline = Outline::of(&species.foliage);
            for seed in 0..20 {
                let mut painter = Painter {
                    canvas: Canvas::new(16, 1),
                    species: &species,
                    outline: &outline,
                    size_m: species.foliage.twig_length_m,
                    draws: Seed::new(seed).draws(),
                    painted: 0,
                    kept: 1.0,
                };
                let main = Shoot {
                    base: Vec2::new(0.5, 0.01),
                    angle: 0.0,
                    length: 0.9,
                    bend: 0.05,
                    depth: 0.8,
                };
                let shoots = painter.clothed(main, false);
                assert!(shoots.len() > 3, "{name} {seed}: {} shoots", shoots.len());
                for (shoot, _, places) in &shoots {
                    let end = shoot.at(1.0);
                    assert!(places.iter().any(|p| p.base == end), "{name} {seed}: a bare end");
                }
            }
        }
    }
}
