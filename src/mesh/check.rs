//! The invariants of a surface, and the proof that wood is closed.

use glam::Vec3;

use super::{Surface, lightmap};
use crate::diagnostic::{Error, Result};

/// Heights of a triangle below this are no area, metres.
const LEAST_HEIGHT_M: f32 = 1e-8;

impl Surface {
    /// Columns of equal length, all finite, normals of unit length, indices in range, every
    /// triangle with an area.
    pub fn check(&self) -> Result<()> {
        let n = self.position.len();
        if self.normal.len() != n || self.uv.len() != n {
            return Err(Error::new(format!(
                "a surface has {n} positions, {} normals and {} texture coordinates",
                self.normal.len(),
                self.uv.len()
            )));
        }
        if !(self.wind.is_empty() || self.wind.len() == n) {
            return Err(Error::new(format!(
                "a surface has {n} positions and {} wind colours",
                self.wind.len()
            )));
        }
        if !(self.lightmap_uv.is_empty() || self.lightmap_uv.len() == n) {
            return Err(Error::new(format!(
                "a surface has {n} positions and {} places on its light map",
                self.lightmap_uv.len()
            )));
        }
        if let Some(i) = self.lightmap_uv.iter().position(|c| !lightmap::is_on(*c)) {
            return Err(Error::new(format!("vertex {i} is off its light map")));
        }
        if !self.index.len().is_multiple_of(3) {
            return Err(Error::new(format!("a surface has {} indices", self.index.len())));
        }
        for i in 0..n {
            if !self.position[i].is_finite() || !self.uv[i].is_finite() {
                return Err(Error::new(format!("vertex {i} is not finite")));
            }
            let length = self.normal[i].length();
            if length.is_nan() || (length - 1.0).abs() >= 1e-4 {
                return Err(Error::new(format!("the normal of vertex {i} is {length} long")));
            }
        }
        for (t, corners) in self.index.chunks_exact(3).enumerate() {
            let at = |k: usize| self.position.get(corners[k] as usize).copied();
            let (Some(a), Some(b), Some(c)) = (at(0), at(1), at(2)) else {
                return Err(Error::new(format!("triangle {t} refers past the {n} vertices")));
            };
            let longest = a.distance(b).max(b.distance(c)).max(c.distance(a));
            let twice_area = (b - a).as_dvec3().cross((c - a).as_dvec3()).length() as f32;
            if twice_area.is_nan() || twice_area <= longest * LEAST_HEIGHT_M {
                return Err(Error::new(format!("triangle {t} has no area: {a} {b} {c}")));
            }
        }
        Ok(())
    }

    /// Enclosed volume by the divergence theorem, cubic metres; positive when wound outward.
    pub fn volume_m3(&self) -> f64 {
        self.volume_about_m3(self.position.first().copied().unwrap_or(Vec3::ZERO))
    }

    /// Its share of the volume of several that are closed together, all about one centre.
    pub fn volume_about_m3(&self, centre: Vec3) -> f64 {
        let centre = centre.as_dvec3();
        self.index
            .chunks_exact(3)
            .map(|t| {
                let [a, b, c] = [0, 1, 2].map(|k| self.position[t[k] as usize].as_dvec3() - centre);
                a.dot(b.cross(c)) / 6.0
            })
            .sum()
    }

    pub fn area_sq_m(&self) -> f64 {
        self.index
            .chunks_exact(3)
            .map(|t| {
                let [a, b, c] = [0, 1, 2].map(|k| self.position[t[k] as usize].as_dvec3());
                (b - a).cross(c - a).length() / 2.0
            })
            .sum()
    }
}

/// Connected parts, corners in one place taken for one.
#[cfg(test)]
pub fn parts(surfaces: &[&Surface]) -> usize {
    feet_m(surfaces).len()
}

/// The lowest place of each of these.
#[cfg(test)]
pub fn feet_m(surfaces: &[&Surface]) -> Vec<f32> {
    // Adding zero makes −0 the same place as 0.
    let key = |p: Vec3| (p + Vec3::ZERO).to_array().map(f32::to_bits);
    let mut place = std::collections::HashMap::new();
    let (mut part, mut height_m): (Vec<u32>, Vec<f32>) = Default::default();
    for s in surfaces {
        let ids: Vec<u32> = s
            .position
            .iter()
            .map(|&p| {
                let next = part.len() as u32;
                let id = *place.entry(key(p)).or_insert(next);
                if id == next {
                    part.push(id);
                    height_m.push(p.z);
                }
                id
            })
            .collect();
        for t in s.index.chunks_exact(3) {
            let [a, b, c] = [0, 1, 2].map(|k| ids[t[k] as usize]);
            for other in [b, c] {
                let (a, b) = (root(&mut part, a), root(&mut part, other));
                part[b as usize] = a;
            }
        }
    }
    let mut feet = std::collections::BTreeMap::new();
    for (i, z) in height_m.into_iter().enumerate() {
        let foot = feet.entry(root(&mut part, i as u32)).or_insert(z);
        *foot = z.min(*foot);
    }
    feet.into_values().collect()
}

#[cfg(test)]
fn root(part: &mut [u32], mut i: u32) -> u32 {
    while part[i as usize] != i {
        part[i as usize] = part[part[i as usize] as usize];
        i = part[i as usize];
    }
    i
}

/// Sides of triangles, corners in one place taken for one, that are not in exactly two triangles
/// wound one way: 0 where all is one closed manifold, or several apart.
pub fn open_edges(surfaces: &[&Surface]) -> usize {
    sides(surfaces).into_iter().filter(|ways| *ways != [1, 1]).map(|[along, _]| along).sum()
}

/// Sides of triangles without one that runs back along them: 0 where all is closed, tubes with sides
/// in one place included.
#[cfg(test)]
pub fn unmatched_sides(surfaces: &[&Surface]) -> usize {
    sides(surfaces).into_iter().map(|[along, back]| along.saturating_sub(back)).sum()
}

/// How many sides run along and how many back, for every two places that a side joins.
fn sides(surfaces: &[&Surface]) -> Vec<[usize; 2]> {
    // Adding zero makes −0 the same place as 0.
    let key = |p: Vec3| (p + Vec3::ZERO).to_array().map(f32::to_bits);
    let mut places: Vec<[u32; 3]> =
        surfaces.iter().flat_map(|s| s.position.iter().map(|&p| key(p))).collect();
    places.sort_unstable();
    places.dedup();
    let mut sides = Vec::new();
    for s in surfaces {
        let place: Vec<u32> =
            s.position.iter().map(|&p| places.partition_point(|q| *q < key(p)) as u32).collect();
        sides.extend(s.index.chunks_exact(3).flat_map(|t| {
            let [a, b, c] = [0, 1, 2].map(|k| place[t[k] as usize]);
            [[a, b], [b, c], [c, a]]
        }));
    }
    sides.sort_unstable();
    let count = |side: [u32; 2]| {
        let from = sides.partition_point(|other| *other < side);
        sides[from..].iter().take_while(|other| **other == side).count()
    };
    sides
        .chunk_by(|a, b| a == b)
        .map(|same| [same.len(), count([same[0][1], same[0][0]])])
        .collect()
}
