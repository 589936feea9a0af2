//! Nearest points and nearest wood.

use glam::Vec3;
use rstar::primitives::GeomWithData;
use rstar::{AABB, PointDistance, RTree, RTreeObject};

/// Points to look up by place.
pub(super) struct Points(RTree<GeomWithData<[f32; 3], u32>>);

impl Points {
    pub fn new(points: &[Vec3]) -> Points {
        let all = points.iter().enumerate();
        let entries = all.map(|(i, p)| GeomWithData::new(p.to_array(), i as u32)).collect();
        Points(RTree::bulk_load(entries))
    }

    /// Ids and distances in metres, nearest first; a point finds itself.
    pub fn around(&self, p: Vec3) -> impl Iterator<Item = (u32, f32)> + '_ {
        self.0
            .nearest_neighbor_iter_with_distance_2(p.to_array())
            .map(|(e, sq)| (e.data, sq.sqrt()))
    }

    pub fn nearest(&self, p: Vec3) -> Option<(u32, f32)> {
        self.around(p).next()
    }

    /// Ids and distances of all within `reach_m`, in no order that means anything.
    pub fn within(&self, p: Vec3, reach_m: f32) -> impl Iterator<Item = (u32, f32)> + '_ {
        self.0
            .locate_within_distance(p.to_array(), reach_m * reach_m)
            .map(move |e| (e.data, p.distance(Vec3::from(*e.geom()))))
    }
}

/// An internode as a truncated cone with round ends.
#[derive(Debug, Clone, Copy)]
pub(super) struct Cone {
    pub from: Vec3,
    pub to: Vec3,
    pub radius_m: [f32; 2],
    /// The node that ends it.
    pub node: u32,
}

impl Cone {
    /// Where along it (0…1) a point lies, and the distance to its surface, negative inside.
    pub fn distance_m(&self, p: Vec3) -> (f32, f32) {
        let edge = self.to - self.from;
        let t = ((p - self.from).dot(edge) / edge.length_squared().max(1e-12)).clamp(0.0, 1.0);
        let radius_m = self.radius_m[0] + (self.radius_m[1] - self.radius_m[0]) * t;
        (t, p.distance(self.from + edge * t) - radius_m)
    }
}

impl RTreeObject for Cone {
    type Envelope = AABB<[f32; 3]>;

    fn envelope(&self) -> Self::Envelope {
        let r = Vec3::splat(self.radius_m[0].max(self.radius_m[1]));
        let (low, high) = (self.from.min(self.to) - r, self.from.max(self.to) + r);
        AABB::from_corners(low.to_array(), high.to_array())
    }
}

impl PointDistance for Cone {
    fn distance_2(&self, point: &[f32; 3]) -> f32 {
        self.distance_m(Vec3::from(*point)).1.max(0.0).powi(2)
    }
}

/// The wood of a skeleton to look up by place.
pub(super) struct Wood(RTree<Cone>);

impl Wood {
    pub fn new(cones: Vec<Cone>) -> Wood {
        Wood(RTree::bulk_load(cones))
    }

    /// The nearest cone; of several that hold the point, the one that holds it deepest.
    pub fn nearest(&self, p: Vec3) -> Option<(&Cone, f32)> {
        let mut best: Option<(&Cone, f32)> = None;
        for (cone, outside_sq) in self.0.nearest_neighbor_iter_with_distance_2(p.to_array()) {
            let signed_m = cone.distance_m(p).1;
            if best.is_none_or(|(_, b)| signed_m < b) {
                best = Some((cone, signed_m));
            }
            if outside_sq > 0.0 {
                break;
            }
        }
        best
    }
}
