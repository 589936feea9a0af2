//! Coarser forms of a scene's models.

use glam::Vec3;

use super::{Part, Prototype, Scene};
use crate::mesh::Surface;

/// A coarser form of a prototype.
#[derive(Debug, Clone)]
pub struct Level {
    /// `LOD1`, `LOD2`, …, `impostor`: the same for every prototype of a scene.
    pub name: String,
    pub parts: Vec<Part>,
    /// How far its silhouette is from that of the finest form, metres.
    pub silhouette: Apart,
    /// Where the parts show views of an octahedral impostor.
    pub octahedral: Option<Octahedral>,
}

/// How far apart two silhouettes are.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Apart {
    /// The farthest that any place of one is from the other (Hausdorff distance), metres.
    pub worst_m: f32,
    /// Root of the mean square over all places of both, metres.
    pub rms_m: f32,
}

/// How a shader finds the views of an octahedral impostor: that from direction d (unit, towards
/// the eye, z ≥ 0) is in column and row (frames − 1)(e + 1)/2, where e = (p.x + p.y, p.x − p.y)
/// and p = d.xy / (|d.x| + |d.y| + d.z); row 0 is at the bottom of the picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Octahedral {
    /// Views along a side of the picture.
    pub frames: u32,
    /// Middle of every view, in the tree.
    pub centre: Vec3,
    /// Half the side of what every view shows, metres.
    pub radius_m: f32,
}

/// A closed convex body that stands for a model in collisions.
#[derive(Debug, Clone)]
pub struct Collider {
    pub shape: ColliderShape,
    /// Positions and triangles alone.
    pub body: Surface,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ColliderShape {
    Capsule,
    Convex,
}

impl Collider {
    /// The name by which engines know the `number`th collider of an object.
    pub fn name(&self, object: &str, number: usize) -> String {
        let prefix = match self.shape {
            ColliderShape::Capsule => "UCP",
            ColliderShape::Convex => "UCX",
        };
        format!("{prefix}_{object}_{number:02}")
    }
}

impl Scene {
    /// Takes the coarser forms out: for each, from the finest on, its name and a scene of the same
    /// trees in that form, without terrain and without what it does not use.
    pub fn take_levels(&mut self) -> Vec<(String, Scene)> {
        let levels: Vec<Vec<Level>> =
            self.prototypes.iter_mut().map(|p| std::mem::take(&mut p.levels)).collect();
        let count = levels.iter().map(Vec::len).min().unwrap_or(0);
        let mut columns: Vec<_> = levels.into_iter().map(Vec::into_iter).collect();
        let mut out = Vec::with_capacity(count);
        for _ in 0..count {
            let row: Vec<Level> = columns.iter_mut().filter_map(Iterator::next).collect();
            let Some(name) = row.first().map(|l| l.name.clone()) else { break };
            let prototypes = self.prototypes.iter().zip(row).map(|(p, level)| Prototype {
                name: p.name.clone(),
                species: p.species.clone(),
                parts: level.parts,
                levels: Vec::new(),
                colliders: Vec::new(),
                octahedral: level.octahedral,
            });
            let mut scene = Scene {
                name: self.name.clone(),
                frame: self.frame.clone(),
                textures: self.textures.clone(),
                materials: self.materials.clone(),
                terrain: None,
                prototypes: prototypes.collect(),
                instances: self.instances.clone(),
            };
            scene.prune();
            out.push((name, scene));
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::sample::forest;

    #[test]
    fn levels_become_scenes_of_the_same_trees() {
        let mut scene = forest(&["Larix sibirica", "Betula pendula"], 12, 60.0);
        for prototype in &mut scene.prototypes {
            // The second form is the wood alone, which leaves leaf textures unused.
            for (name, parts) in [("LOD1", 2), ("LOD2", 1)] {
                prototype.levels.push(Level {
                    name: name.into(),
                    parts: prototype.parts[..parts].to_vec(),
                    silhouette: Apart { worst_m: 0.5, rms_m: 0.1 },
                    octahedral: None,
                });
            }
        }
        let whole = scene.clone().validate().unwrap();
        let levels = scene.take_levels();
        assert!(scene.prototypes.iter().all(|p| p.levels.is_empty()));
        let names: Vec<&str> = levels.iter().map(|(n, _)| n.as_str()).collect();
        assert_eq!(names, ["LOD1", "LOD2"]);
        for (_, level) in &levels {
            assert_eq!(level.instances.len(), whole.instances().len());
            assert!(level.terrain.is_none());
            level.clone().validate().unwrap();
        }
        assert!(levels[1].1.textures.len() < levels[0].1.textures.len());
        assert!(levels[1].1.materials.iter().all(|m| !m.name.contains("leaf")));
    }
}
