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
    let mut tin = Tin::new();
    for edge in border(&low.trend.geometry) {
        let [x, y] = edge;
        let _ = tin.insert(Vertex(DVec3::new(x, y, low.trend.bilinear(x, y).into())));
    }
    for level in 0..=LEVELS {
        let candidates = lowest_above_trend(low, SEED_CELLS * 0.5f64.powi(level));
        if level == 0 {
            for p in candidates {
                let _ = tin.insert(Vertex(p.as_dvec3()));
            }
            continue;
        }
        let mut open = candidates;
        for _ in 0..MOST_ROUNDS {
            let is_near: Vec<bool> = open
                .par_chunks(RUN)
                .flat_map_iter(|run| {
                    let mut hint = first_vertex();
                    run.iter().map(|p| is_ground(&tin, p.as_dvec3(), &mut hint)).collect::<Vec<_>>()
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

fn is_ground(tin: &Tin, p: DVec3, hint: &mut FixedVertexHandle) -> bool {
    let Some(f) = facet(tin, p, hint) else { return false };
    if f.is_near() {
        return true;
    }
    // At an edge of the terrain the facet cuts the corner, but the one on the other side of the
    // nearest vertex leads on to the point.
    let mirrored = 2.0 * f.nearest - p;
    let mut elsewhere = *hint;
    facet(tin, mirrored, &mut elsewhere).is_some_and(|m| {
        Facet { distance: -m.distance, nearest: f.nearest, to_nearest: f.to_nearest }.is_near()
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
    fn is_near(&self) -> bool {
        let wide = if self.distance < 0.0 { BELOW } else { 1.0 };
        let d = self.distance.abs();
        d <= NEAR_M || d <= wide * DISTANCE_M && d <= wide * SINE * self.to_nearest
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
