//! What a scene weighs and where it ends.

use glam::{DVec2, Vec2, Vec3};
use rayon::prelude::*;

use super::{Instance, Prototype, ValidScene};

/// Numbers for reports.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Statistics {
    pub trees: usize,
    pub prototypes: usize,
    pub terrain_triangles: u64,
    /// Triangles of the terrain and of every prototype once: what a file holds.
    pub unique_triangles: u64,
    /// Triangles of the terrain and of every tree in its place: what a renderer draws.
    pub instanced_triangles: u64,
    /// Least and greatest corner of everything, scene metres, Z up.
    pub bounds: (Vec3, Vec3),
    /// Vertex and index data of the unique triangles at 32 bytes a vertex and 4 an index.
    pub geometry_bytes: u64,
    /// Textures as uncompressed RGBA, without mipmaps.
    pub texture_bytes: u64,
}

/// Exact, not from boxes of boxes: O(vertices log vertices + instances).
pub fn statistics(scene: &ValidScene) -> Statistics {
    let per_prototype: Vec<[u64; 2]> =
        scene.prototypes().iter().map(Prototype::triangles).collect();
    let terrain_triangles = scene.terrain().map_or(0, |t| t.surface.triangles() as u64);
    let in_place: u64 =
        scene.instances().iter().map(|i| per_prototype[i.prototype as usize][1]).sum();
    let surfaces = scene.parts().map(|p| &p.surface);
    Statistics {
        trees: scene.instances().len(),
        prototypes: scene.prototypes().len(),
        terrain_triangles,
        unique_triangles: terrain_triangles
            + per_prototype.iter().map(|[stored, _]| stored).sum::<u64>(),
        instanced_triangles: terrain_triangles + in_place,
        bounds: scene.bounds(),
        geometry_bytes: surfaces
            .map(|s| s.position.len() as u64 * 32 + s.index.len() as u64 * 4)
            .sum(),
        texture_bytes: scene
            .textures()
            .iter()
            .map(|t| u64::from(t.image.width()) * u64::from(t.image.height()) * 4)
            .sum(),
    }
}

/// Least and greatest corner of instances of prototypes with these outlines; `None` for no
/// instances. Indices must be in range.
pub(super) fn bounds_of<'a>(
    outlines: &[Outline],
    instances: impl IntoIterator<Item = &'a Instance>,
) -> Option<(Vec3, Vec3)> {
    instances
        .into_iter()
        .flat_map(|i| {
            let outline = &outlines[i.prototype as usize];
            outline.corners().map(|p| i.place(p))
        })
        .fold(None, |bounds, p| {
            let (lo, hi) = bounds.unwrap_or((p, p));
            Some((lo.min(p), hi.max(p)))
        })
}

/// The points that can bound a prototype however it is scaled and turned about Z: its convex
/// hull in plan, and its lowest and highest level.
#[derive(Debug, Clone)]
pub(super) struct Outline {
    hull: Vec<Vec2>,
    low: f32,
    high: f32,
}

impl Outline {
    pub fn of_all(prototypes: &[Prototype]) -> Vec<Outline> {
        prototypes.par_iter().map(Outline::of).collect()
    }

    fn of(prototype: &Prototype) -> Self {
        const CHUNK: usize = 1 << 15;
        let chunks = prototype.parts.par_iter().flat_map(|p| p.surface.position.par_chunks(CHUNK));
        // The hull of all is the hull of the chunks' hulls.
        let of_chunk = |points: &[Vec3]| {
            let hull = convex_hull(outer(points));
            let levels = points.iter().map(|p| (p.z, p.z));
            let (low, high) = levels
                .fold((f32::INFINITY, f32::NEG_INFINITY), |a, b| (a.0.min(b.0), a.1.max(b.1)));
            Outline { hull, low, high }
        };
        let scattered = prototype.outer_scattered();
        let chunks = chunks.chain(scattered.par_chunks(CHUNK));
        let outlines: Vec<Outline> = chunks.map(of_chunk).collect();
        Outline {
            hull: convex_hull(outlines.iter().flat_map(|o| &o.hull).copied().collect()),
            low: outlines.iter().map(|o| o.low).fold(f32::INFINITY, f32::min),
            high: outlines.iter().map(|o| o.high).fold(f32::NEG_INFINITY, f32::max),
        }
    }

    fn corners(&self) -> impl Iterator<Item = Vec3> + '_ {
        self.hull.iter().flat_map(|p| [p.extend(self.low), p.extend(self.high)])
    }
}

/// The points in plan that do not lie within the octagon of the farthest eight ways (Akl &
/// Toussaint 1978): few, and every corner of the hull.
fn outer(points: &[Vec3]) -> Vec<Vec2> {
    const WAYS: [Vec2; 8] = [
        Vec2::new(1.0, 0.0),
        Vec2::new(1.0, 1.0),
        Vec2::new(0.0, 1.0),
        Vec2::new(-1.0, 1.0),
        Vec2::new(-1.0, 0.0),
        Vec2::new(-1.0, -1.0),
        Vec2::new(0.0, -1.0),
        Vec2::new(1.0, -1.0),
    ];
    let Some(first) = points.first() else { return Vec::new() };
    let mut far = [(f32::NEG_INFINITY, first.truncate()); 8];
    for p in points {
        let p = p.truncate();
        for (way, far) in WAYS.iter().zip(&mut far) {
            let out = p.dot(*way);
            if out > far.0 {
                *far = (out, p);
            }
        }
    }
    // Counter-clockwise; one point may be the farthest several ways.
    let corner = |k: usize| far[k % 8].1.as_dvec2();
    let sides: Vec<(DVec2, DVec2)> = (0..8)
        .map(|k| (corner(k), corner(k + 1) - corner(k)))
        .filter(|(_, along)| *along != DVec2::ZERO)
        .collect();
    let is_within =
        |p: DVec2| !sides.is_empty() && sides.iter().all(|(a, along)| along.perp_dot(p - a) > 0.0);
    points.iter().map(|p| p.truncate()).filter(|p| !is_within(p.as_dvec2())).collect()
}

/// Andrew's monotone chain (1979).
fn convex_hull(mut points: Vec<Vec2>) -> Vec<Vec2> {
    points.sort_unstable_by(|a, b| a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)));
    points.dedup();
    let mut hull: Vec<Vec2> = Vec::new();
    let mut chain = |points: &mut dyn Iterator<Item = Vec2>| {
        let start = hull.len();
        for p in points {
            while let [.., a, b] = hull[start..] {
                let (a64, b64, p64) = (a.as_dvec2(), b.as_dvec2(), p.as_dvec2());
                if (b64 - a64).perp_dot(p64 - b64) > 0.0 {
                    break;
                }
                hull.pop();
            }
            hull.push(p);
        }
    };
    chain(&mut points.iter().copied());
    chain(&mut points.iter().rev().copied());
    hull
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::scene::sample::forest;

    #[test]
    fn counts_of_a_known_scene() {
        let scene = forest(&["Larix", "Betula"], 3, 20.0).validate().unwrap();
        let s = statistics(&scene);
        // A ground of 10 × 10 cells; a tree of 14 triangles of wood and 48 of foliage.
        assert_eq!((s.trees, s.prototypes, s.terrain_triangles), (6, 4, 200));
        assert_eq!((s.unique_triangles, s.instanced_triangles), (200 + 4 * 62, 200 + 6 * 62));
        assert_eq!(s.geometry_bytes, 32 * (121 + 4 * (16 + 96)) + 12 * s.unique_triangles);
        assert_eq!(s.texture_bytes, 9 * 32 * 32 * 4);
    }

    proptest! {
        /// On a coarse grid, for points in one place, on one line, on the octagon.
        #[test]
        fn the_hull_is_that_of_the_outer_points(
            grid in prop::collection::vec((-4i8..5, -4i8..5), 1..60),
            is_line in any::<bool>(),
        ) {
            let place = |&(x, y): &(i8, i8)| {
                Vec3::new(f32::from(x), f32::from(if is_line { x } else { y }), 0.5)
            };
            let points: Vec<Vec3> = grid.iter().map(place).collect();
            let all = points.iter().map(|p| p.truncate()).collect();
            prop_assert_eq!(convex_hull(outer(&points)), convex_hull(all));
        }

        #[test]
        fn bounds_are_those_of_every_vertex_in_its_place(
            yaw_rad in -7.0f32..7.0, x in 0.2f32..3.0, y in 0.2f32..3.0, z in 0.2f32..3.0,
        ) {
            let mut scene = forest(&["Larix"], 2, 20.0);
            for instance in &mut scene.instances {
                instance.yaw_rad += yaw_rad;
                instance.scale = Vec3::new(x, y, z);
            }
            let (lo, hi) = bounds_of(&Outline::of_all(&scene.prototypes), &scene.instances).unwrap();
            let all = scene.instances.iter().flat_map(|i| {
                let parts = &scene.prototypes[i.prototype as usize].parts;
                parts.iter().flat_map(|p| &p.surface.position).map(|&p| i.place(p))
            });
            let (mut least, mut most) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
            for p in all {
                (least, most) = (least.min(p), most.max(p));
            }
            prop_assert!((lo - least).abs().max_element() < 1e-4, "{lo} {least}");
            prop_assert!((hi - most).abs().max_element() < 1e-4, "{hi} {most}");
        }
    }
}
