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
    // Adding zero makes −0 the same place as 0.
    let key = |p: Vec3| (p + Vec3::ZERO).to_array().map(f32::to_bits);
    let mut place = std::collections::HashMap::new();
    let mut part: Vec<u32> = Vec::new();
    for s in surfaces {
        let ids: Vec<u32> = s
            .position
            .iter()
            .map(|&p| {
                let next = part.len() as u32;
                let id = *place.entry(key(p)).or_insert(next);
                if id == next {
                    part.push(id);
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
    (0..part.len()).filter(|&i| part[i] == i as u32).count()
}

fn root(part: &mut [u32], mut i: u32) -> u32 {
    while part[i as usize] != i {
        part[i as usize] = part[part[i as usize] as usize];
        i = part[i as usize];
    }
    i
}

/// Directed edges without exactly one partner in the other direction, after corners in one place
/// are welded; 0 where all is closed and wound one way. Tubes that pass through each other may have
/// edges in one place: then corners are welded within each connected part alone.
pub fn open_edges(surfaces: &[&Surface]) -> usize {
    let ways = [Weld::All, Weld::Normals, Weld::Folds, Weld::Bark];
    let mut least = usize::MAX;
    for way in ways {
        least = least.min(open_edges_of(weld(surfaces, way)));
        if least == 0 {
            break;
        }
    }
    least
}

/// Which corners in one place are one.
#[derive(Clone, Copy, PartialEq)]
enum Weld {
    All,
    /// Those of a connected part. Parts of two surfaces are connected where corners agree in place
    /// and normal.
    Normals,
    /// Parts of one surface are so, too, where bark is as far along, as at folds.
    Folds,
    /// Parts are connected where corners agree in place and bark is as far along.
    Bark,
}

/// As [`open_edges`], all corners in one place welded.
#[cfg(test)]
pub fn open_edges_welded(surfaces: &[&Surface]) -> usize {
    open_edges_of(weld(surfaces, Weld::All))
}

fn open_edges_of((index, welded): (Vec<u32>, Vec<u32>)) -> usize {
    let mut edges: Vec<(u32, u32)> = index
        .chunks_exact(3)
        .flat_map(|t| {
            let [a, b, c] = [0, 1, 2].map(|k| welded[t[k] as usize]);
            [(a, b), (b, c), (c, a)]
        })
        .collect();
    edges.sort_unstable();
    let mut open = 0;
    let mut i = 0;
    while i < edges.len() {
        let same = edges[i..].iter().take_while(|e| **e == edges[i]).count();
        let back = (edges[i].1, edges[i].0);
        let start = edges.partition_point(|e| *e < back);
        let backs = edges[start..].iter().take_while(|e| **e == back).count();
        if same != 1 || backs != 1 {
            open += same;
        }
        i += same;
    }
    open
}

/// The surfaces' indices as one list, and for every vertex one that stands for all in its place.
fn weld(surfaces: &[&Surface], way: Weld) -> (Vec<u32>, Vec<u32>) {
    let by_part = way != Weld::All;
    let (mut index, mut position, mut normal) = (vec![], vec![], vec![]);
    let (mut along, mut owner) = (vec![], vec![]);
    for (k, s) in surfaces.iter().enumerate() {
        let base = position.len() as u32;
        index.extend(s.index.iter().map(|i| i + base));
        position.extend_from_slice(&s.position);
        normal.extend_from_slice(&s.normal);
        along.extend(s.uv.iter().map(|uv| uv.y));
        owner.resize(position.len(), k);
    }
    let n = position.len();
    let mut part: Vec<u32> = (0..n as u32).collect();
    for t in index.chunks_exact(3).filter(|_| by_part) {
        for &k in &t[1..] {
            let (a, b) = (root(&mut part, t[0]), root(&mut part, k));
            part[b as usize] = a;
        }
    }
    // Adding zero makes −0 the same place as 0.
    let key = |p: Vec3| (p + Vec3::ZERO).to_array().map(f32::to_bits);
    let mut order: Vec<u32> = (0..n as u32).collect();
    let place = |i: u32| {
        let i = i as usize;
        let more = if way == Weld::Bark { Vec3::splat(along[i]) } else { normal[i] };
        (key(position[i]), key(more))
    };
    if by_part {
        order.sort_unstable_by_key(|&i| (place(i), i));
        for w in order.windows(2) {
            let [a, b] = [w[0], w[1]].map(|i| i as usize);
            let joins = way == Weld::Bark
                || owner[a] != owner[b]
                || way == Weld::Folds && along[a] == along[b];
            if joins && place(w[0]) == place(w[1]) {
                let (a, b) = (root(&mut part, w[0]), root(&mut part, w[1]));
                part[b as usize] = a;
            }
        }
    }
    let parts: Vec<u32> =
        (0..n as u32).map(|i| if by_part { root(&mut part, i) } else { 0 }).collect();
    let place = |i: u32| (parts[i as usize], key(position[i as usize]));
    order.sort_unstable_by_key(|&i| (place(i), i));
    let mut welded = vec![0; n];
    let mut head = 0;
    for (k, &i) in order.iter().enumerate() {
        if k == 0 || place(order[k - 1]) != place(i) {
            head = i;
        }
        welded[i as usize] = head;
    }
    (index, welded)
}
