//! Progressive densification of a triangulation (Axelsson 2000): from a sparse triangulation of the
//! lowest points, points that lie near a facet, in distance and in angle to its corners, become
//! vertices, until none is left that does.
//!
//! Departures:
//! - Candidates come coarse to fine: the lowest of large cells first, of small ones last, so that a
//!   facet is held by ground all around before anything that stands on it is judged.
//! - "Lowest" is above the trend of the terrain ([`super::lowest`]), so that a slope gives points
//!   of all of it and not of its foot alone.
//! - First points that stand out from those around them, and vertices that turn out to lie in a pit,
//!   are taken back.
//! - The border stands on the trend, one of its nodes beyond the points.
//! - Thresholds are fixed, not taken from histograms of the scan: the same ground comes out
//!   wherever a scan is cut.
//! - Mirroring at edges is left out: it climbs crowns on steep slopes.
//!
//! Known limits: terraces narrower than the first cells are cut, crests are rounded; undergrowth
//! that rises gently from the ground is climbed.

use glam::{DVec2, DVec3, Vec3};
use rayon::prelude::*;
use spade::handles::{FixedVertexHandle, InnerTag};
use spade::{DelaunayTriangulation, HasPosition, Point2, PositionInTriangulation, Triangulation};

use super::lowest::{Lowest, lowest};
use crate::raster::GridGeometry;

/// Cells of the first triangulation's points, in finest cells; each level halves them.
const SEED_CELLS: f64 = 32.0;
/// Levels below the first.
const LEVELS: i32 = 5;
/// A first point that lies so far above or below the middle of those around it is taken back, metres.
const STANDS_OUT_M: f32 = 2.0;
/// Farthest from a facet, metres.
const DISTANCE_M: f64 = 3.0;
/// Greatest sine of the angle between a facet and the way to its nearest corner.
const SINE: f64 = 0.25;
/// So near to a facet the angle is not asked for, metres: it is noise.
const NEAR_M: f64 = 0.15;
/// Below a facet, distance and sine may be so many times as large: hollows are ground, crowns are
/// not.
const BELOW: f64 = 2.0;
/// From a pit the way to every neighbour rises more than this above the trend. It is what the
/// facets about a stray rise by when nothing near them is taken for ground.
const PIT_SLOPE: f64 = 0.15;
/// Rounds of densification at one level, at most.
const MOST_ROUNDS: usize = 20;
/// Points that are located in a row, each from the last.
const RUN: usize = 1024;

#[derive(Clone, Copy)]
pub struct Vertex {
    at: DVec3,
    /// The trend, metres; `None` on the border.
    above: Option<f32>,
}

impl HasPosition for Vertex {
    type Scalar = f64;
    fn position(&self) -> Point2<f64> {
        point(self.at.truncate())
    }
}

fn point(p: DVec2) -> Point2<f64> {
    Point2::new(p.x, p.y)
}

pub type Tin = DelaunayTriangulation<Vertex>;
type Face<'a> = spade::handles::FaceHandle<'a, InnerTag, Vertex, (), (), ()>;

/// Which of `points` are ground.
pub fn ground(tin: &Tin, points: &[Vec3]) -> Vec<bool> {
    let near = |run: &[Vec3]| -> Vec<bool> {
        let mut hint = first_vertex();
        run.iter()
            .map(|p| {
                facet(tin, p.as_dvec3(), &mut hint).is_some_and(|f| f.distance.abs() <= NEAR_M)
            })
            .collect()
    };
    points.par_chunks(RUN).flat_map_iter(near).collect()
}

fn first_vertex() -> FixedVertexHandle {
    FixedVertexHandle::from_index(0)
}

/// A triangulation of the ground.
pub fn densified(low: &Lowest) -> Tin {
    let mut tin = Tin::new();
    for [x, y] in border(&low.trend.geometry) {
        let z = low.trend.bilinear(x, y).into();
        let _ = tin.insert(Vertex { at: DVec3::new(x, y, z), above: None });
    }
    let vertex = |p: Vec3| Vertex { at: p.as_dvec3(), above: Some(p.z - trend_at(low, p)) };
    for p in seeds(low) {
        let _ = tin.insert(vertex(p));
    }
    for level in 1..=LEVELS {
        remove_pits(&mut tin);
        let cells = SEED_CELLS * 0.5f64.powi(level);
        let mut open: Vec<Vec3> = lowest_above_trend(low, cells).into_iter().flatten().collect();
        for _ in 0..MOST_ROUNDS {
            let is_near: Vec<bool> = open
                .par_chunks(RUN)
                .flat_map_iter(|run| {
                    let mut hint = first_vertex();
                    let near = |p: &Vec3| is_ground(&tin, p.as_dvec3(), &mut hint);
                    run.iter().map(near).collect::<Vec<_>>()
                })
                .collect();
            let before = tin.num_vertices();
            let mut hint = first_vertex();
            let mut left = Vec::new();
            for (p, near) in open.into_iter().zip(is_near) {
                if !near {
                    left.push(p);
                } else if let Ok(new) = tin.insert_with_hint(vertex(p), hint) {
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

/// The lowest points of the largest cells, but those that stand out from the ones around them.
fn seeds(low: &Lowest) -> Vec<Vec3> {
    const MOST_ROUNDS: usize = 10;
    let g = low.geometry(SEED_CELLS);
    let mut seed = lowest_above_trend(low, SEED_CELLS);
    let height: Vec<f32> = seed.iter().map(|p| p.map_or(0.0, |p| p.z - trend_at(low, p))).collect();
    for _ in 0..MOST_ROUNDS {
        let stands_out = |i: usize| {
            let (col, row) = (i % g.cols, i / g.cols);
            let mut around: Vec<f32> = (row.saturating_sub(1)..(row + 2).min(g.rows))
                .flat_map(|r| (col.saturating_sub(1)..(col + 2).min(g.cols)).map(move |c| (c, r)))
                .map(|(c, r)| g.index(c, r))
                .filter(|&k| k != i && seed[k].is_some())
                .map(|k| height[k])
                .collect();
            around.sort_by(f32::total_cmp);
            around.len() >= 2 && (height[i] - around[(around.len() - 1) / 2]).abs() > STANDS_OUT_M
        };
        let out: Vec<usize> =
            (0..g.len()).filter(|&i| seed[i].is_some() && stands_out(i)).collect();
        if out.is_empty() {
            break;
        }
        for i in out {
            seed[i] = None;
        }
    }
    seed.into_iter().flatten().collect()
}

fn remove_pits(tin: &mut Tin) {
    let is_pit = |v: &spade::handles::VertexHandle<'_, Vertex>| {
        let Some(own) = v.data().above else { return false };
        v.out_edges().all(|e| {
            let to = e.to();
            let run = (to.data().at - v.data().at).truncate().length();
            let rise = f64::from(to.data().above.unwrap_or(0.0) - own);
            rise > PIT_SLOPE * run + NEAR_M
        })
    };
    let mut pits: Vec<FixedVertexHandle> = tin.vertices().filter(is_pit).map(|v| v.fix()).collect();
    // Removal moves the last vertex to the place that falls free.
    pits.sort_unstable_by_key(|v| std::cmp::Reverse(v.index()));
    for pit in pits {
        tin.remove(pit);
    }
}

/// Centres of the outermost cells.
fn border(g: &GridGeometry) -> Vec<[f64; 2]> {
    (0..g.len())
        .map(|i| (i % g.cols, i / g.cols))
        .filter(|&(c, r)| c == 0 || r == 0 || c + 1 == g.cols || r + 1 == g.rows)
        .map(|(c, r)| g.centre(c, r))
        .collect()
}

fn trend_at(low: &Lowest, p: Vec3) -> f32 {
    low.trend.bilinear(p.x.into(), p.y.into())
}

/// The point of each cell that is lowest above the trend.
fn lowest_above_trend(low: &Lowest, cells: f64) -> Vec<Option<Vec3>> {
    lowest(&low.points, |p| p.z - trend_at(low, *p), &low.geometry(cells))
}

fn is_ground(tin: &Tin, p: DVec3, hint: &mut FixedVertexHandle) -> bool {
    facet(tin, p, hint).is_some_and(|f| {
        let d = if f.distance < 0.0 { -f.distance / BELOW } else { f.distance };
        d <= NEAR_M || d <= DISTANCE_M && d <= SINE * f.to_nearest
    })
}

/// A point seen from the facet above or below it.
struct Facet {
    /// From the facet's plane, positive above it.
    distance: f64,
    /// To the nearest corner.
    to_nearest: f64,
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
            let distance = p.z - tin.vertex(v).data().at.z;
            return Some(Facet { distance, to_nearest: distance.abs() });
        }
        _ => return None,
    };
    let [a, b, c] = face.vertices().map(|v| v.data().at);
    *hint = face.vertices()[0].fix();
    let normal = (b - a).cross(c - a).try_normalize()?;
    let to_nearest = [a, b, c].map(|v| v.distance(p)).into_iter().fold(f64::INFINITY, f64::min);
    Some(Facet { distance: normal.dot(p - a), to_nearest })
}
