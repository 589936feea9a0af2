//! The space a crown may fill: a centre line from root to apex, and about it a radius by relative
//! height and azimuth.
//!
//! Without a scan the radius is the species' profile, made uneven by smooth noise. With one it is
//! the reach of the crown's attractors. A scan from the air sees the upper and outer crown, few
//! points inside and below: sectors without points take the mean of their neighbours drawn
//! towards the species' profile, sides without any point half of it, and no sector leaves half to
//! twice that profile.

use glam::{Vec2, Vec3};

use crate::crown::Crown;
use crate::seed::Seed;
use crate::species::model::{Size, curve, youth};

const ROWS: usize = 16;
const SECTORS: usize = 16;
/// The thinnest crown or thinnest part of one, metres.
const LEAST_RADIUS_M: f32 = 0.02;

/// Crown radius of a young tree over its height, at most; of one half as high as it grows and higher, less and less so.
const YOUNG_WIDTH: f32 = 0.26;

/// Tree-local metres, root at the origin, Z up.
#[derive(Debug, Clone)]
pub struct Envelope {
    pub height_m: f32,
    /// Height of the crown's base, < `height_m`.
    pub base_m: f32,
    /// Horizontal offset of the apex from the root.
    pub apex: Vec2,
    /// Greatest radius of the species' profile scaled to this tree.
    pub radius_m: f32,
    /// Radius in metres at ROWS heights from base to apex × SECTORS azimuths.
    radius: Vec<[f32; SECTORS]>,
    /// Greatest sector of each row.
    widest: Vec<f32>,
}

impl Envelope {
    /// The envelope of a tree of the species at `height_m`, whose size is that of
    /// [`crate::species::Species::at_height`]: crown diameter goes with height, a little less than in
    /// proportion (exponent 0.9); a young tree is slender whatever it becomes.
    pub fn of_species(size: &Size, uneven: f32, height_m: f32, seed: Seed) -> Envelope {
        let scale = (height_m / size.height_m.max(0.1)).powf(0.9);
        let grown_m = 0.5 * size.crown_diameter_m * scale;
        let slender_m = grown_m.min(YOUNG_WIDTH * height_m);
        // A shrub is grown however low it is.
        let grows = (2.0 - 2.0 * height_m / size.height_m.max(0.1)).clamp(0.0, 1.0);
        let radius_m = grown_m + (slender_m - grown_m) * youth(height_m) * grows;
        let radius_m = radius_m.max(LEAST_RADIUS_M);
        let base_m = height_m * size.crown_base.clamp(0.0, 0.9);
        let noise = Noise::new(seed);
        let mut radius = vec![[0.0; SECTORS]; ROWS];
        for (row, sectors) in radius.iter_mut().enumerate() {
            let t = row as f32 / (ROWS - 1) as f32;
            let r = radius_m * curve(&size.profile, t);
            for (k, sector) in sectors.iter_mut().enumerate() {
                let lobe = noise.at(t, k as f32 / SECTORS as f32);
                *sector = (r * (1.0 + 0.6 * uneven * lobe)).max(LEAST_RADIUS_M);
            }
        }
        let mut envelope =
            Envelope { height_m, base_m, apex: Vec2::ZERO, radius_m, radius, widest: Vec::new() };
        envelope.scale_to(2.0 * radius_m);
        envelope
    }

    /// The envelope that the attractors of a crown show, completed by the species' profile.
    /// `attractors` are tree-local.
    pub fn of_crown(size: &Size, crown: &Crown, attractors: &[Vec3]) -> Envelope {
        let height_m = crown.height_m.max(0.1);
        let base_m = crown.base_height_m.clamp(0.0, 0.9 * height_m);
        let radius_m = (0.5 * crown.diameter_m).max(LEAST_RADIUS_M);
        // The stem leads to the apex, as far as a stem leans.
        let apex = (crown.apex - crown.root).truncate().clamp_length_max(0.7 * radius_m);
        let mut envelope = Envelope {
            height_m,
            base_m,
            apex,
            radius_m,
            radius: vec![[0.0; SECTORS]; ROWS],
            widest: Vec::new(),
        };
        let mut reach = vec![[0.0f32; SECTORS]; ROWS];
        for p in attractors.iter().filter(|p| p.is_finite()) {
            let t = envelope.relative_height(p.z);
            if !(-0.1..=1.1).contains(&t) {
                continue;
            }
            let out = p.truncate() - envelope.centre(p.z);
            let row = ((t * (ROWS - 1) as f32).round().max(0.0) as usize).min(ROWS - 1);
            let k = sector_of(out.y.atan2(out.x)).round() as usize % SECTORS;
            reach[row][k] = reach[row][k].max(out.length());
        }
        let seen = reach.iter().flatten().filter(|&&r| r > 0.0).count();
        // From above a side without any point, beside sides full of them, is bare, not in shadow.
        let mut is_bare = [false; SECTORS];
        for (k, bare) in is_bare.iter_mut().enumerate() {
            let near = [k, (k + 1) % SECTORS, (k + SECTORS - 1) % SECTORS];
            *bare = seen >= 2 * SECTORS
                && near.iter().all(|&k| reach.iter().all(|r| r[k] < 0.3 * radius_m));
        }
        for row in 0..ROWS {
            let t = row as f32 / (ROWS - 1) as f32;
            let typical = (radius_m * curve(&size.profile, t)).max(LEAST_RADIUS_M);
            for (k, &is_bare) in is_bare.iter().enumerate() {
                let expected = if is_bare { 0.5 * typical } else { typical };
                // The sector and its eight neighbours; what none of them saw is as expected.
                let (mut sum, mut weight) = (expected * 0.5, 0.5);
                for (dr, dk, w) in NEIGHBOURS {
                    let r = row as i32 + dr;
                    if !(0..ROWS as i32).contains(&r) {
                        continue;
                    }
                    let side = (k as i32 + dk).rem_euclid(SECTORS as i32) as usize;
                    let seen = reach[r as usize][side];
                    if seen > 0.0 {
                        sum += w * seen;
                        weight += w;
                    }
                }
                let r: f32 = sum / weight;
                envelope.radius[row][k] =
                    r.clamp(0.5 * expected, 2.0 * expected.max(0.3 * radius_m));
            }
        }
        // Too few points say nothing of the shape.
        if seen < 4 {
            for (row, sectors) in envelope.radius.iter_mut().enumerate() {
                let t = row as f32 / (ROWS - 1) as f32;
                *sectors = [(radius_m * curve(&size.profile, t)).max(LEAST_RADIUS_M); SECTORS];
            }
        }
        envelope.scale_to(2.0 * radius_m);
        envelope
    }

    /// Scales all radii so that the mean diameter seen from above is `diameter_m`.
    fn scale_to(&mut self, diameter_m: f32) {
        let mut plan = [0.0f32; SECTORS];
        for row in &self.radius {
            for (p, &r) in plan.iter_mut().zip(row) {
                *p = p.max(r);
            }
        }
        let mean = plan.iter().sum::<f32>() / SECTORS as f32;
        let scale = 0.5 * diameter_m / mean.max(1e-6);
        for row in &mut self.radius {
            for r in row.iter_mut() {
                *r *= scale;
            }
        }
        self.widest = self.radius.iter().map(|r| r.iter().fold(0.0f32, |a, &b| a.max(b))).collect();
    }

    pub fn crown_length_m(&self) -> f32 {
        self.height_m - self.base_m
    }

    /// 0 at the crown's base, 1 at the apex; outside 0…1 below and above.
    pub fn relative_height(&self, z: f32) -> f32 {
        (z - self.base_m) / self.crown_length_m()
    }

    /// The centre line at height `z`: upright at the root, leaning to the apex.
    pub fn centre(&self, z: f32) -> Vec2 {
        let t = (z / self.height_m).clamp(0.0, 1.0);
        self.apex * (t * t * (3.0 - 2.0 * t))
    }

    /// Radius about the centre line, metres; 0 below the base and above the apex.
    pub fn radius_at(&self, z: f32, azimuth_rad: f32) -> f32 {
        let t = self.relative_height(z);
        if !(0.0..=1.0).contains(&t) {
            return 0.0;
        }
        let row = t * (ROWS - 1) as f32;
        let (r0, fr) = (row.floor() as usize, row.fract());
        let k = sector_of(azimuth_rad);
        let (k0, fk) = (k.floor() as usize % SECTORS, k.fract());
        let k1 = (k0 + 1) % SECTORS;
        let at = |r: usize| {
            let row = &self.radius[r.min(ROWS - 1)];
            row[k0] + fk * (row[k1] - row[k0])
        };
        at(r0) + fr * (at(r0 + 1) - at(r0))
    }

    /// How far out a point lies: 0 on the centre line, 1 on the envelope; infinite outside its
    /// heights.
    pub fn relative_radius(&self, p: Vec3) -> f32 {
        let out = p.truncate() - self.centre(p.z);
        let r = self.radius_at(p.z, out.y.atan2(out.x));
        if r > 0.0 { out.length() / r } else { f32::INFINITY }
    }

    /// Greatest radius at the height, metres.
    pub fn widest_at(&self, z: f32) -> f32 {
        let row = self.relative_height(z).clamp(0.0, 1.0) * (ROWS - 1) as f32;
        let (r0, f) = (row.floor() as usize, row.fract());
        let a = self.widest[r0.min(ROWS - 1)];
        let b = self.widest[(r0 + 1).min(ROWS - 1)];
        a + f * (b - a)
    }

    /// Volume, cubic metres.
    pub fn volume_m3(&self) -> f32 {
        let area: f32 = self
            .radius
            .iter()
            .map(|row| row.iter().map(|r| r * r).sum::<f32>() * std::f32::consts::PI)
            .sum::<f32>()
            / (ROWS * SECTORS) as f32;
        area * self.crown_length_m()
    }
}

const NEIGHBOURS: [(i32, i32, f32); 9] = [
    (0, 0, 4.0),
    (0, 1, 1.0),
    (0, -1, 1.0),
    (1, 0, 1.0),
    (-1, 0, 1.0),
    (1, 1, 0.5),
    (1, -1, 0.5),
    (-1, 1, 0.5),
    (-1, -1, 0.5),
];

/// Azimuth as a place among the sectors, 0…SECTORS.
fn sector_of(azimuth_rad: f32) -> f32 {
    let turn = azimuth_rad / std::f32::consts::TAU;
    (turn - turn.floor()) * SECTORS as f32
}

/// Light that reaches a place, 0…1: the share of the sky, weighted by the cosine from the zenith,
/// that the crown itself leaves (Beer–Lambert).
pub fn light_at(p: Vec3, e: &Envelope) -> f32 {
    const TURNS: u32 = 8;
    const STEPS: u32 = 10;
    let reach_m = 2.0 * e.radius_m;
    let step_m = reach_m / STEPS as f32;
    let (mut light, mut sky) = (0.0, 0.0);
    for from_zenith_deg in [15.0f32, 45.0, 75.0] {
        let (s, c) = from_zenith_deg.to_radians().sin_cos();
        // Ring of the sky: its area is as the sine.
        let weight = s * c;
        for k in 0..TURNS {
            let side = Vec2::from_angle(std::f32::consts::TAU * (k as f32 + 0.5) / TURNS as f32);
            let way = (side * s).extend(c);
            let shaded = (0..STEPS)
                .map(|i| p + way * (step_m * (i as f32 + 0.5)))
                .filter(|&q| e.relative_radius(q) < 1.0)
                .count() as f32;
            light += weight * (-OPACITY * shaded / STEPS as f32).exp();
            sky += weight;
        }
    }
    light / sky
}

/// Optical depth of a crown along its diameter.
const OPACITY: f32 = 2.0;

/// [`curve`] over degrees of a circle: the last pair leads round to the first.
pub fn round_curve(pairs: &[[f32; 2]], t_deg: f32) -> f32 {
    match (pairs.first(), pairs.last()) {
        (Some(&[first, low]), Some(&[last, high])) if t_deg < first || t_deg > last => {
            let gap = first + 360.0 - last;
            let past = (t_deg - last).rem_euclid(360.0);
            if gap > 0.0 { high + (low - high) * (past / gap).min(1.0) } else { low }
        }
        _ => curve(pairs, t_deg),
    }
}

/// Smooth noise in −1…1 on a cylinder: waves of a few lobes about the stem and along it.
struct Noise {
    waves: [(f32, f32, f32, f32); 6],
}

impl Noise {
    fn new(seed: Seed) -> Noise {
        let mut draws = seed.derive("envelope", 0).draws();
        let mut waves = [(0.0, 0.0, 0.0, 0.0); 6];
        for (i, wave) in waves.iter_mut().enumerate() {
            let lobes = (i % 4) as f32 + 1.0;
            *wave = (lobes, draws.between(1.0, 5.0), draws.unit(), draws.between(0.3, 0.6));
        }
        Noise { waves }
    }

    /// `t` along the crown, `turn` about it, both in units of the whole.
    fn at(&self, t: f32, turn: f32) -> f32 {
        let sum: f32 = self
            .waves
            .iter()
            .map(|&(lobes, along, phase, weight)| {
                weight * (std::f32::consts::TAU * (lobes * turn + along * t + phase)).sin()
            })
            .sum();
        sum.clamp(-1.0, 1.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn size() -> Size {
        Size {
            age_years: 60.0,
            height_m: 20.0,
            crown_diameter_m: 6.0,
            crown_base: 0.25,
            stem_diameter_m: 0.3,
            profile: vec![[0.0, 0.5], [0.4, 1.0], [1.0, 0.0]],
        }
    }

    #[test]
    fn a_profile_is_linear_between_its_pairs() {
        let pairs = [[0.0, 0.5], [0.5, 1.0], [1.0, 0.0]];
        for (t, r) in [(-1.0, 0.5), (0.0, 0.5), (0.25, 0.75), (0.75, 0.5), (2.0, 0.0)] {
            assert_eq!(curve(&pairs, t), r);
        }
        assert_eq!(curve(&[], 0.5), 0.0);
    }

    #[test]
    fn a_curve_of_bearings_goes_round() {
        let pairs = [[90.0, 2.0], [270.0, 0.0]];
        for (t, r) in
            [(90.0, 2.0), (180.0, 1.0), (270.0, 0.0), (0.0, 1.0), (45.0, 1.5), (315.0, 0.5)]
        {
            assert!((round_curve(&pairs, t) - r).abs() < 1e-6, "{t}");
        }
        assert_eq!(round_curve(&[[0.0, 3.0]], 200.0), 3.0);
    }

    #[test]
    fn light_falls_from_the_top_to_the_inside_and_the_foot() {
        let e = Envelope::of_species(&size(), 0.0, 20.0, Seed::new(1));
        let at = |x: f32, z: f32| light_at(Vec3::new(x, 0.0, z), &e);
        assert_eq!(at(0.0, 25.0), 1.0);
        let (top, edge, inside) = (at(0.0, 19.8), at(2.9, 11.0), at(0.0, 8.0));
        assert!(top > 0.9 && edge > inside + 0.1 && inside < 0.5, "{top} {edge} {inside}");
    }

    /// Saplings of a tree are slender, a low shrub that is grown is as wide as it says.
    #[test]
    fn low_shrubs_are_as_wide_as_they_say() {
        let wide_m = |grown_m: f32, height_m: f32| {
            let size = Size { height_m: grown_m, crown_diameter_m: 3.0 * grown_m, ..size() };
            2.0 * Envelope::of_species(&size, 0.0, height_m, Seed::new(1)).radius_m
        };
        assert!((wide_m(1.0, 1.0) - 3.0).abs() < 1e-4, "{}", wide_m(1.0, 1.0));
        assert!((wide_m(20.0, 1.0) - 2.0 * YOUNG_WIDTH).abs() < 1e-4, "{}", wide_m(20.0, 1.0));
    }

    #[test]
    fn a_species_envelope_has_its_height_width_and_base() {
        let e = Envelope::of_species(&size(), 0.0, 20.0, Seed::new(1));
        assert!((e.base_m - 5.0).abs() < 1e-4);
        assert!((e.radius_at(11.0, 1.0) - 3.0).abs() < 0.05);
        assert_eq!(e.radius_at(4.9, 0.0), 0.0);
        assert_eq!(e.radius_at(20.1, 0.0), 0.0);
        // Two cones: of 9 m (to 1) and 6 m (a frustum from 0.5 to 1).
        let cones = std::f32::consts::PI * 9.0 * (9.0 / 3.0 + 6.0 * (1.0 + 0.5 + 0.25) / 3.0);
        assert!((e.volume_m3() / cones - 1.0).abs() < 0.1, "{}", e.volume_m3());
    }

    fn crown(attractors: Vec<Vec3>) -> Crown {
        Crown {
            key: 1,
            root: Vec3::new(100.0, 50.0, 10.0),
            apex: Vec3::new(100.5, 50.0, 30.0),
            height_m: 20.0,
            base_height_m: 6.0,
            diameter_m: 6.0,
            spread_m: 5.0,
            volume_cu_m: 60.0,
            surface_sq_m: 90.0,
            is_understory: false,
            outline: Vec::new(),
            attractors,
            point_count: 100,
            confidence: 1.0,
        }
    }

    #[test]
    fn a_lopsided_crown_gives_a_lopsided_envelope() {
        let mut local = Vec::new();
        for i in 0..400 {
            let turn = i as f32 * 0.37;
            let reach = if turn.cos() > 0.0 { 4.0 } else { 2.0 };
            let z = 6.0 + 12.0 * (i as f32 / 400.0);
            local.push(Vec3::new(turn.cos() * reach, turn.sin() * reach, z));
        }
        let e = Envelope::of_crown(&size(), &crown(Vec::new()), &local);
        let (east, west) = (e.radius_at(11.0, 0.0), e.radius_at(11.0, std::f32::consts::PI));
        assert!(east > 1.5 * west, "{east} {west}");
        assert!((e.centre(20.0) - Vec2::new(0.5, 0.0)).length() < 1e-6);
        assert_eq!(e.centre(0.0), Vec2::ZERO);
    }

    #[test]
    fn a_crown_without_points_has_the_species_shape() {
        let e = Envelope::of_crown(&size(), &crown(Vec::new()), &[Vec3::NAN]);
        let f = Envelope::of_species(&size(), 0.0, 20.0, Seed::new(1));
        let t = |e: &Envelope| e.radius_at(e.base_m + 0.4 * e.crown_length_m(), 2.0);
        assert!((t(&e) - t(&f)).abs() < 0.05);
    }
}
