//! The scheme of a tree for forestry (P18, fig. 1): two cones imitate the crown, a cylinder the
//! stem.
//!
//! h1 is the free stem, h4 the cylinder from the ground to the crown's widest part, h2 the upper
//! cone of base R2 and h3 the lower cone, which narrows from R3 to R4 downward; R5 is the
//! cylinder's radius. Where the source leaves it open: the cylinder ends where the cones meet, so
//! R3 = R2 = CW / 2, and R4 is the share of R3 that the caller gives, at least R5. The cones are one
//! closed surface, the cylinder another that goes into it. A tree without leaves has boughs up to the cones
//! in their place, as sheets with pictures of its twigs where it has any; one whose lower branches are dead has
//! some below them. Limit: crowns of one height round about.

use std::f32::consts::TAU;

use glam::{Quat, Vec2, Vec3};

use super::spot::GOLDEN_RAD;
use super::{Surface, TreeMesh};
use crate::diagnostic::{Error, Result};
use crate::texture::Atlas;

/// Boughs of a bare crown, of no more triangles than the cones; and more of them, to show more of its twigs.
pub const BOUGHS: u32 = 13;
pub const MANY_BOUGHS: u32 = 36;
/// Share of the crown up to which boughs leave the stem; how far they rise by the way they go outwards; and the
/// width of one at the stem over its length.
const HIGHEST: f32 = 0.92;
const RISE: f32 = 0.6;
const STOUT: f32 = 0.14;
/// Width of a sheet of twigs over that of its picture.
const WIDE: f32 = 1.4;

/// The measures of a tree, metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Measures {
    /// H.
    pub height_m: f32,
    /// D, at breast height.
    pub stem_diameter_m: f32,
    /// CW, the greatest.
    pub crown_width_m: f32,
    /// CL, from the lowest branch to the top.
    pub crown_length_m: f32,
    /// CH, height of the widest part above ground.
    pub widest_m: f32,
    /// R4 over R3.
    pub lower_share: f32,
}

/// The parameters of the scheme, metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Scheme {
    /// Free stem.
    pub h1_m: f32,
    /// Upper cone.
    pub h2_m: f32,
    /// Lower cone.
    pub h3_m: f32,
    /// Cylinder.
    pub h4_m: f32,
    /// Base of the upper cone.
    pub r2_m: f32,
    /// Bases of the lower cone, upper and lower.
    pub r3_m: f32,
    pub r4_m: f32,
    /// Cylinder.
    pub r5_m: f32,
}

impl Scheme {
    /// # Errors
    /// A measure that is not above zero or not finite; a crown longer than the tree, whose widest
    /// part is not within it, or that is narrower than the stem.
    pub fn new(m: &Measures) -> Result<Scheme> {
        let wrong = |what: String| Err(Error::new(format!("no scheme of a tree: {what}")));
        let named = [
            ("height", m.height_m),
            ("stem diameter", m.stem_diameter_m),
            ("crown width", m.crown_width_m),
            ("crown length", m.crown_length_m),
        ];
        for (name, value) in named {
            if !(value > 0.0 && value < 1e4) {
                return wrong(format!("its {name} is {value} m"));
            }
        }
        let h1_m = m.height_m - m.crown_length_m;
        if h1_m < 0.0 {
            return wrong(format!("a crown of {} m on {} m", m.crown_length_m, m.height_m));
        }
        if !(m.widest_m > h1_m && m.widest_m < m.height_m) {
            return wrong(format!("its widest part at {} m is not in its crown", m.widest_m));
        }
        let (r3_m, r5_m) = (0.5 * m.crown_width_m, 0.5 * m.stem_diameter_m);
        if r3_m <= r5_m {
            return wrong(format!("its crown of {} m is no wider than its stem", m.crown_width_m));
        }
        Ok(Scheme {
            h1_m,
            h2_m: m.height_m - m.widest_m,
            h3_m: m.widest_m - h1_m,
            h4_m: m.widest_m,
            r2_m: r3_m,
            r3_m,
            r4_m: (m.lower_share.clamp(0.0, 1.0) * r3_m).max(r5_m),
            r5_m,
        })
    }

    /// Volume of both cones, cubic metres.
    pub fn crown_volume_m3(&self) -> f64 {
        let [h2, h3, r2, r3, r4] =
            [self.h2_m, self.h3_m, self.r2_m, self.r3_m, self.r4_m].map(f64::from);
        std::f64::consts::PI / 3.0 * (h2 * r2 * r2 + h3 * (r3 * r3 + r3 * r4 + r4 * r4))
    }

    /// Volume of the cylinder, cubic metres.
    pub fn stem_volume_m3(&self) -> f64 {
        std::f64::consts::PI * f64::from(self.r5_m).powi(2) * f64::from(self.h4_m)
    }

    /// The cylinder as wood and the cones as foliage, of so many sides (3 to 64), with hard edges;
    /// root collar at the origin. From a height on the cylinder is upper wood.
    pub fn mesh(&self, sides: u32, upper_from_m: Option<f32>) -> TreeMesh {
        let n = sides.clamp(3, 64);
        let (r, h) = (self.r5_m, self.h4_m);
        let [foot, top] = [[(0.0, 0.0), (r, 0.0)], [(r, h), (0.0, h)]];
        let (wood, upper_wood) = match upper_from_m.filter(|z| *z < h) {
            Some(z) if z > 0.0 => {
                let line = [(r, z)];
                (turned(&[&foot[..], &line].concat(), n), turned(&[&line[..], &top].concat(), n))
            }
            Some(_) => (Surface::default(), turned(&[foot, top].concat(), n)),
            None => (turned(&[foot, top].concat(), n), Surface::default()),
        };
        let (low, wide, top) = (self.h1_m, self.h4_m, self.h4_m + self.h2_m);
        let crown = [(0.0, low), (self.r4_m, low), (self.r3_m, wide), (0.0, top)];
        let foliage = turned(&crown, n);
        TreeMesh { wood, upper_wood, foliage, is_hull: true, ..TreeMesh::default() }
    }

    /// For a tree without twigs, which one sees through: in place of both cones a leader, and boughs that end on
    /// them, a triangle of two faces each.
    pub fn bare_crown(&self) -> Surface {
        let mut out = self.leader();
        out.append(self.boughs(self.top_m()));
        out
    }

    pub fn top_m(&self) -> f32 {
        self.h4_m + self.h2_m
    }

    /// The stem from the cylinder to the top. Its foot is within the cylinder: edges of its own.
    pub fn leader(&self) -> Surface {
        let foot_m = self.h4_m - self.r5_m.min(0.5 * self.h4_m);
        turned(&[(0.0, foot_m), (self.r5_m, foot_m), (0.0, self.top_m())], 3)
    }

    /// Those of the boughs of a bare crown that leave the stem below a height: of a crown that is dead there.
    pub fn boughs(&self, below_m: f32) -> Surface {
        let mut out = Surface::default();
        for Bough { foot, way, across } in self.each_bough(BOUGHS, below_m) {
            let length_m = way.length();
            let normal = across.cross(way / length_m.max(1e-6));
            let half = across * (0.5 * STOUT * length_m);
            for side in [1.0, -1.0] {
                let first = out.position.len() as u32;
                out.position.extend([foot - half * side, foot + half * side, foot + way]);
                out.normal.extend([normal * side; 3]);
                out.uv.extend([Vec2::ZERO, Vec2::X, Vec2::new(0.5, length_m)]);
                out.index.extend([first, first + 1, first + 2]);
            }
        }
        out
    }

    /// For a tree of bare twigs: so many boughs, each a sheet with the picture of a twig; those that leave the stem
    /// below a height.
    pub fn twigs(&self, boughs: u32, below_m: f32, atlas: &Atlas) -> Surface {
        let outlines = atlas.outlines(2);
        let mut out = Surface::default();
        for (k, Bough { foot, way, across }) in self.each_bough(boughs, below_m).enumerate() {
            let length_m = way.length();
            let count = atlas.nearest(length_m).count().max(1);
            let id = atlas.nearest(length_m).nth(k % count).unwrap_or(0);
            let away = (way.with_z(0.0).normalize_or_zero() + Vec3::Z).normalize_or(Vec3::Z);
            let first = out.position.len() as u32;
            for row in &outlines[id] {
                for s in [row.left, row.right] {
                    let aside = across * ((s - 0.5) * WIDE * length_m);
                    out.position.push(foot + way * row.t + aside);
                    out.normal.push(away);
                    out.uv.push(atlas.cells()[id].uv(s, row.t));
                }
            }
            out.index.extend([0, 1, 3, 0, 3, 2].map(|i| first + i));
        }
        out
    }

    fn each_bough(&self, count: u32, below_m: f32) -> impl Iterator<Item = Bough> {
        let top_m = self.top_m();
        let rows = [(self.r4_m, self.h1_m), (self.r3_m, self.h4_m), (0.0, top_m)];
        let bough = move |k: u32| {
            let up = HIGHEST * (k as f32 / count as f32);
            let foot = Vec3::Z * (self.h1_m + up * (top_m - self.h1_m));
            let (s, c) = (k as f32 * GOLDEN_RAD).sin_cos();
            let away = Vec3::new(c, s, RISE);
            let way = away * rows.windows(2).find_map(|w| meets(foot.z, w)).unwrap_or(self.r5_m);
            let turn = Quat::from_axis_angle(away.normalize(), k as f32);
            Bough { foot, way, across: turn * Vec3::new(-s, c, 0.0) }
        };
        (0..count).map(bough).take_while(move |b| b.foot.z < below_m)
    }
}

/// From the stem to the cones.
struct Bough {
    foot: Vec3,
    way: Vec3,
    /// Unit, square to the way.
    across: Vec3,
}

/// How far from the axis a line that leaves it at a height, and rises, meets a cone between two (radius, height).
fn meets(from_m: f32, cone: &[(f32, f32)]) -> Option<f32> {
    let [(r0, z0), (r1, z1)] = [cone[0], cone[1]];
    let slope = (r1 - r0) / (z1 - z0).max(1e-6);
    let r = (r0 + slope * (from_m - z0)) / (1.0 - RISE * slope);
    (r > 0.0 && (z0..=z1).contains(&(from_m + RISE * r))).then_some(r)
}

/// The surface of a profile of (radius, height), closed if that goes from the axis up and back to it, turned about the
/// axis; u goes around once, v up in metres.
fn turned(profile: &[(f32, f32)], sides: u32) -> Surface {
    let mut out = Surface::default();
    for w in profile.windows(2) {
        let [(r0, z0), (r1, z1)] = [w[0], w[1]];
        let slope = Vec2::new(z1 - z0, r0 - r1).normalize_or(Vec2::X);
        let first = out.position.len() as u32;
        for k in 0..=sides {
            let share = k as f32 / sides as f32;
            // The last corner is the first, to the bit.
            let (s, c) = ((k % sides) as f32 / sides as f32 * TAU).sin_cos();
            for (r, z) in [(r0, z0), (r1, z1)] {
                out.position.push(Vec3::new(r * c, r * s, z));
                out.normal.push(Vec3::new(slope.x * c, slope.x * s, slope.y));
                out.uv.push(Vec2::new(share, z));
            }
        }
        for k in 0..sides {
            let p = first + 2 * k;
            if r0 > 0.0 {
                out.index.extend([p, p + 2, p + 3]);
            }
            if r1 > 0.0 {
                out.index.extend([p, p + 3, p + 1]);
            }
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::super::check::open_edges;
    use super::*;

    const PINE: Measures = Measures {
        height_m: 20.0,
        stem_diameter_m: 0.3,
        crown_width_m: 5.0,
        crown_length_m: 12.0,
        widest_m: 11.0,
        lower_share: 0.4,
    };

    #[test]
    fn the_scheme_has_the_measures_of_the_tree() {
        let s = Scheme::new(&PINE).unwrap();
        assert_eq!((s.h1_m, s.h2_m, s.h3_m, s.h4_m), (8.0, 9.0, 3.0, 11.0));
        assert_eq!((s.r2_m, s.r3_m, s.r4_m, s.r5_m), (2.5, 2.5, 1.0, 0.15));
        let mesh = s.mesh(16, None);
        let (low, high) = mesh.bounds();
        assert_eq!((low.z, high.z, high.x), (0.0, 20.0, 2.5));
        let width_m = s.mesh(8, None).crown_diameter_m();
        assert!((width_m - 5.0).abs() < 0.05, "{width_m}");
        // By hand: π/3 (9·6.25 + 3·(6.25 + 2.5 + 1)) and π·0.0225·11.
        assert!((s.crown_volume_m3() - 89.535_390_627).abs() < 1e-4);
        assert!((s.stem_volume_m3() - 0.777_544_181).abs() < 1e-6);
    }

    #[test]
    fn both_bodies_are_closed_and_have_the_volume_of_their_prisms() {
        let s = Scheme::new(&PINE).unwrap();
        for sides in [3u32, 6, 16, 64] {
            let mesh = s.mesh(sides, None);
            let n = f64::from(sides);
            // An N-gon's area over its circle's.
            let share = n / std::f64::consts::TAU * (std::f64::consts::TAU / n).sin();
            let bodies = [(&mesh.wood, s.stem_volume_m3()), (&mesh.foliage, s.crown_volume_m3())];
            for (surface, round) in bodies {
                surface.check().unwrap();
                assert_eq!(open_edges(&[surface]), 0);
                let volume = surface.volume_m3();
                assert!((volume / (round * share) - 1.0).abs() < 1e-5, "{sides}: {volume}");
            }
            assert_eq!(mesh.triangles(), 8 * sides as usize);
            // Two barks are closed together; a line beyond an end leaves one.
            let parted = s.mesh(sides, Some(3.0));
            let of = [&parted.wood, &parted.upper_wood];
            assert_eq!(open_edges(&of), 0);
            assert_eq!((of[0].bounds().1.z, of[1].bounds().0.z), (3.0, 3.0));
            assert_eq!(s.mesh(sides, Some(0.0)).upper_wood, mesh.wood);
            assert_eq!(s.mesh(sides, Some(11.0)), mesh);
        }
    }

    #[test]
    fn boughs_end_on_the_cones() {
        let wide = Measures { crown_width_m: 14.0, widest_m: 9.0, lower_share: 0.1, ..PINE };
        for measures in [PINE, wide] {
            let s = Scheme::new(&measures).unwrap();
            let bare = s.bare_crown();
            bare.check().unwrap();
            assert_eq!(open_edges(&[&bare]), 0);
            let cones = s.mesh(8, None).foliage;
            assert_eq!(bare.triangles(), cones.triangles());
            let ((_, low), (_, top)) = (cones.bounds(), bare.bounds());
            assert_eq!(low.z, top.z);
            let out = |p: &Vec3| {
                let low = s.r4_m + (s.r3_m - s.r4_m) * (p.z - s.h1_m) / s.h3_m;
                let high = s.r2_m * (1.0 - (p.z - s.h4_m) / s.h2_m);
                p.truncate().length() - if p.z < s.h4_m { low } else { high }
            };
            let tips = bare.position.iter().filter(|p| out(p).abs() < 1e-3).count();
            assert!(tips >= 2 * BOUGHS as usize, "{tips}");
            assert!(bare.position.iter().all(|p| out(p) < 0.3));
        }
    }

    #[test]
    fn twigs_reach_from_the_stem_to_the_cones() {
        let s = Scheme::new(&PINE).unwrap();
        let atlas = Atlas::whole(0.5);
        for boughs in [BOUGHS, MANY_BOUGHS] {
            let twigs = s.twigs(boughs, s.top_m(), &atlas);
            twigs.check().unwrap();
            assert_eq!(twigs.triangles(), 2 * boughs as usize);
            for sheet in twigs.position.as_chunks::<4>().0 {
                let [foot, tip] = [0, 2].map(|k| 0.5 * (sheet[k] + sheet[k + 1]));
                assert!(foot.truncate().length() < 1e-4, "{foot}");
                let low = s.r4_m + (s.r3_m - s.r4_m) * (tip.z - s.h1_m) / s.h3_m;
                let high = s.r2_m * (1.0 - (tip.z - s.h4_m) / s.h2_m);
                let reach = if tip.z < s.h4_m { low } else { high };
                assert!((tip.truncate().length() - reach).abs() < 1e-3, "{tip} {reach}");
            }
        }
        let leader = s.leader();
        assert_eq!((open_edges(&[&leader]), leader.bounds().1.z), (0, 20.0));
    }

    /// Not two closed surfaces that touch along an edge.
    #[test]
    fn of_a_bare_tree_every_edge_is_in_two_triangles() {
        let low = Measures { crown_length_m: 19.9, widest_m: 0.12, ..PINE };
        for measures in [PINE, low] {
            let s = Scheme::new(&measures).unwrap();
            let mut tree = s.mesh(8, None).wood;
            tree.append(s.bare_crown());
            let place =
                |i: u32| (tree.position[i as usize] + Vec3::ZERO).to_array().map(f32::to_bits);
            let mut edges = std::collections::HashMap::new();
            for t in tree.index.as_chunks::<3>().0 {
                for k in 0..3 {
                    let [a, b] = [t[k], t[(k + 1) % 3]].map(place);
                    *edges.entry([a.min(b), a.max(b)]).or_insert(0) += 1;
                }
            }
            assert!(edges.values().all(|&n| n == 2), "{edges:?}");
        }
    }

    #[test]
    fn impossible_measures_say_what_is_wrong() {
        let refused = |m: Measures| Scheme::new(&m).unwrap_err().message().to_owned();
        for (m, what) in [
            (Measures { height_m: f32::NAN, ..PINE }, "its height is NaN m"),
            (Measures { crown_length_m: 30.0, ..PINE }, "a crown of 30 m on 20 m"),
            (Measures { widest_m: 7.0, ..PINE }, "its widest part at 7 m is not in its crown"),
            (
                Measures { crown_width_m: 0.2, ..PINE },
                "its crown of 0.2 m is no wider than its stem",
            ),
        ] {
            assert_eq!(refused(m), format!("no scheme of a tree: {what}"));
        }
    }
}
