//! Progressive densification of a triangulation (Axelsson 2000): from a sparse triangulation of the
//! lowest points, points that lie near a facet, in distance and in angle to its corners, become
//! vertices, until none is left that does.
//!
//! Departures:
//! - Candidates come coarse to fine: the lowest of large cells first, of small ones last, so that a
//!   facet is held by ground all around before anything that stands on it is judged.
//! - "Lowest" is above the trend of the terrain ([`super::lowest`]), so that a slope gives points
//!   of all of it and not of its foot alone.
//! - What lies below a facet may lie farther from it than what lies above.
//! - The border stands on the trend, one of its nodes beyond the points.
//! - Thresholds are fixed, not taken from histograms of the scan: the same ground comes out
//!   wherever a scan is cut.
//!
//! Known limits: a wide building gives facets of its own where a large cell holds nothing else;
//! undergrowth that rises gently from the ground is climbed.

use glam::{DVec2, DVec3, Vec3};
use rayon::prelude::*;
use spade::handles::{FixedVertexHandle, InnerTag};
use spade::{DelaunayTriangulation, HasPosition, Point2, PositionInTriangulation, Triangulation};

use super::lowest::{Lowest, lowest};
use crate::raster::GridGeometry;

/// Cells of the first triangulation's points, in finest cells; each level halves them.
const SEED_CELLS: f64 = 16.0;
/// Levels below the first; the last takes every lowest point.
const LEVELS: i32 = 5;
/// Farthest from a facet, metres.
const DISTANCE_M: f64 = 1.4;
/// Greatest sine of the angle between a facet and the way to its nearest corner.
const SINE: f64 = 0.2;
/// So near to a facet the angle is not asked for, metres: it is noise.
const NEAR_M: f64 = 0.15;
/// Below a facet, distance and angle may be so many times as large.
const BELOW: f64 = 2.0;
/// Rounds of densification at one level, at most.
const MOST_ROUNDS: usize = 20;
/// Points that are located in a row, each from the last.
const RUN: usize = 1024;

#[derive(Clone, Copy)]
struct Vertex(DVec3);

impl HasPosition for Vertex {
    type Scalar = f64;
    fn position(&self) -> Point2<f64> {
        point(self.0.truncate())
    }
}

fn point(p: DVec2) -> Point2<f64> {
    Point2::new(p.x, p.y)
}

pub fn knob(name: &str, default: f64) -> f64 {
    std::env::var(name).ok().and_then(|v| v.parse().ok()).unwrap_or(default)
}

type Tin = DelaunayTriangulation<Vertex>;
type Face<'a> = spade::handles::FaceHandle<'a, InnerTag, Vertex, (), (), ()>;

/// Which of `points` are ground.
pub fn ground(lowest: &Lowest, points: &[Vec3]) -> Vec<bool> {
    let tin = densified(lowest);
    let near = |run: &[Vec3]| -> Vec<bool> {
        let mut hint = first_vertex();
        run.iter()
            .map(|p| {
                facet(&tin, p.as_dvec3(), &mut hint).is_some_and(|f| f.distance.abs() <= NEAR_M)
            })
            .collect()
    };
    points.par_chunks(RUN).flat_map_iter(near).collect()
}

fn first_vertex() -> FixedVertexHandle {
    FixedVertexHandle::from_index(0)
}

fn densified(low: &Lowest) -> Tin {
    let k = Knobs { sine: knob("SINE", SINE), distance: knob("DIST", DISTANCE_M), mirror: knob("MIRROR", 1.0) > 0.0, below: knob("BELOW", BELOW) };
    let mut tin = Tin::new();
    let seeds = seeds(low, knob("SEED", SEED_CELLS));
    for [x, y] in border(&low.trend.geometry) {
        let z = low.trend.bilinear(x, y).into();
        let _ = tin.insert(Vertex(DVec3::new(x, y, z)));
    }
    for p in seeds {
        let _ = tin.insert(Vertex(p.as_dvec3()));
    }
    for level in 1..=(knob("LEVELS", LEVELS.into()) as i32) {
        let mut open = lowest_above_trend(low, knob("SEED", SEED_CELLS) * 0.5f64.powi(level));
        for _ in 0..(knob("ROUNDS", MOST_ROUNDS as f64) as usize) {
            let is_near: Vec<bool> = open
                .par_chunks(RUN)
                .flat_map_iter(|run| {
                    let mut hint = first_vertex();
                    run.iter().map(|p| is_ground(&tin, p.as_dvec3(), &mut hint, &k)).collect::<Vec<_>>()
                })
                .collect();
            let before = tin.num_vertices();
            let mut hint = first_vertex();
            let mut left = Vec::new();
            for (p, near) in open.into_iter().zip(is_near) {
                if !near {
                    left.push(p);
                } else if let Ok(new) = tin.insert_with_hint(Vertex(p.as_dvec3()), hint) {
                    hint = new;
                }
            }
            open = left;
            if tin.num_vertices() == before || open.is_empty() {
                break;
            }
        }
    }
    tin
}

/// The lowest points of the largest cells, but those that stand above the ones around them.
fn seeds(low: &Lowest, cells: f64) -> Vec<Vec3> {
    let g = low.geometry(cells);
    let trend = |p: Vec3| low.trend.bilinear(p.x.into(), p.y.into());
    let above = low.points.iter().map(|p| Vec3::new(p.x, p.y, p.z - trend(*p)));
    let mut seed: Vec<Option<Vec3>> = lowest(above, &g).collect();
    let stand = knob("STAND", 2.0) as f32;
    for _ in 0..10 {
        let stands: Vec<bool> = (0..g.len()).map(|i| {
            let Some(p) = seed[i] else { return false };
            let (c, r) = (i % g.cols, i / g.cols);
            let mut around: Vec<f32> = Vec::new();
            for rr in r.saturating_sub(1)..(r + 2).min(g.rows) {
                for cc in c.saturating_sub(1)..(c + 2).min(g.cols) {
                    let k = g.index(cc, rr);
                    if k != i && let Some(q) = seed[k] { around.push(q.z); }
                }
            }
            around.sort_by(f32::total_cmp);
            around.len() >= 2 && p.z > around[(around.len() - 1) / 2] + stand
        }).collect();
        if !stands.contains(&true) { break; }
        for (s, st) in seed.iter_mut().zip(stands) { if st { *s = None; } }
    }
    seed.into_iter().flatten().map(|p| p + Vec3::Z * trend(p)).collect()
}

struct Knobs { sine: f64, distance: f64, mirror: bool, below: f64 }

/// Centres of the outermost cells.
fn border(g: &GridGeometry) -> Vec<[f64; 2]> {
    (0..g.len())
        .map(|i| (i % g.cols, i / g.cols))
        .filter(|&(c, r)| c == 0 || r == 0 || c + 1 == g.cols || r + 1 == g.rows)
        .map(|(c, r)| g.centre(c, r))
        .collect()
}

/// The point of each cell that is lowest above the trend.
fn lowest_above_trend(low: &Lowest, cells: f64) -> Vec<Vec3> {
    let trend = |p: Vec3| low.trend.bilinear(p.x.into(), p.y.into());
    let above = low.points.iter().map(|p| Vec3::new(p.x, p.y, p.z - trend(*p)));
    lowest(above, &low.geometry(cells)).flatten().map(|p| p + Vec3::Z * trend(p)).collect()
}

fn is_ground(tin: &Tin, p: DVec3, hint: &mut FixedVertexHandle, k: &Knobs) -> bool {
    let Some(f) = facet(tin, p, hint) else { return false };
    if f.is_near(k) {
        return true;
    }
    if !k.mirror { return false; }
    // At an edge of the terrain the facet cuts the corner, but the one on the other side of the
    // nearest vertex leads on to the point.
    let mirrored = 2.0 * f.nearest - p;
    let mut elsewhere = *hint;
    facet(tin, mirrored, &mut elsewhere).is_some_and(|m| {
        Facet { distance: -m.distance, nearest: f.nearest, to_nearest: f.to_nearest }.is_near(k)
    })
}

/// A point seen from the facet above or below it.
struct Facet {
    /// From the facet's plane, positive above it.
    distance: f64,
    /// The nearest corner, and how far it is.
    nearest: DVec3,
    to_nearest: f64,
}

impl Facet {
    fn is_near(&self, k: &Knobs) -> bool {
        let wide = if self.distance < 0.0 { k.below } else { 1.0 };
        let d = self.distance.abs();
        d <= NEAR_M || d <= wide * k.distance && d <= wide * k.sine * self.to_nearest
    }
}

/// `None` beyond the border. Leaves a vertex near the point in `hint`.
fn facet(tin: &Tin, p: DVec3, hint: &mut FixedVertexHandle) -> Option<Facet> {
    let face: Face<'_> = match tin.locate_with_hint(point(p.truncate()), *hint) {
        PositionInTriangulation::OnFace(f) => tin.face(f),
        PositionInTriangulation::OnEdge(e) => {
            let e = tin.directed_edge(e);
            e.face().as_inner().or(e.rev().face().as_inner())?
        }
        PositionInTriangulation::OnVertex(v) => {
            *hint = v;
            let nearest = tin.vertex(v).data().0;
            let distance = p.z - nearest.z;
            return Some(Facet { distance, nearest, to_nearest: distance.abs() });
        }
        _ => return None,
    };
    let [a, b, c] = face.vertices().map(|v| (v.data().0, v.fix()));
    *hint = a.1;
    let normal = (b.0 - a.0).cross(c.0 - a.0).try_normalize()?;
    let nearest = [a.0, b.0, c.0]
        .into_iter()
        .min_by(|s, t| s.distance_squared(p).total_cmp(&t.distance_squared(p)))?;
    Some(Facet { distance: normal.dot(p - a.0), nearest, to_nearest: nearest.distance(p) })
}
