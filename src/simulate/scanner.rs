//! A flying scanner: parallel flight lines with 50 % overlap, pulses traced through crowns, stems
//! and ground.
//!
//! Light meets leaves by the law of Beer and Lambert: the path to the next hit is exponential in
//! the leaf density passed. A hit keeps part of the pulse's energy, so that later returns come
//! from below, until too little is left.

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::crown::Grove;
use super::stand::Stand;
use crate::scan::PointCloud;
use crate::seed::Draws;

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ScannerOptions {
    /// Pulses from all flight lines, over the stand's area.
    pub pulses_per_sq_m: f32,
    /// Flying height above the middle ground.
    pub altitude_m: f32,
    /// Half of the scanner's angle of view.
    pub scan_angle_deg: f32,
    /// Standard deviation of the range.
    pub range_noise_m: f32,
    /// Stray points (birds, multiple paths) a thousand pulses.
    pub strays_per_mille: f32,
    /// ASPRS classes 2, 5, 7 and 18 as they truly are; otherwise all points are class 1 but for
    /// half of the strays.
    pub is_classified: bool,
}

impl Default for ScannerOptions {
    fn default() -> Self {
        ScannerOptions {
            pulses_per_sq_m: 12.0,
            altitude_m: 300.0,
            scan_angle_deg: 14.0,
            range_noise_m: 0.03,
            strays_per_mille: 0.4,
            is_classified: false,
        }
    }
}

const UNCLASSIFIED: u8 = 1;
const GROUND: u8 = 2;
const HIGH_VEGETATION: u8 = 5;
const LOW_NOISE: u8 = 7;
const HIGH_NOISE: u8 = 18;

struct Return {
    position: Vec3,
    intensity: u16,
    number: u8,
    count: u8,
    class: u8,
}

/// Scans the stand and cuts the points at its edge; in the order in which they were measured.
pub fn scan(stand: &Stand, options: &ScannerOptions) -> PointCloud {
    let grove = Grove::new(&stand.shapes, stand.side_m);
    let side = f64::from(stand.side_m);
    let middle = side * 0.5;
    let reference_z = stand.relief.height_at(middle, middle);
    let altitude = f64::from(options.altitude_m.clamp(60.0, 10_000.0));
    let half_swath =
        altitude * f64::from(options.scan_angle_deg.clamp(1.0, 60.0)).to_radians().tan();
    // Each place lies under two lines, each of which gives half of the pulses.
    let pulses = f64::from(options.pulses_per_sq_m.clamp(0.01, 1000.0));
    let spacing = (2.0 / pulses).sqrt();
    // Slanted pulses that end beyond the edge still meet crowns inside.
    let lean = half_swath / altitude;
    let margin = (f64::from(grove.highest()) - reference_z).max(0.0) * lean + 1.0;
    let rows = ((side + 2.0 * margin) / spacing).ceil() as u64;
    let lines = ((side + 2.0 * margin) / half_swath).ceil() as i64 + 2;
    let strips: Vec<(i64, u64)> =
        (0..lines).flat_map(|line| (0..rows).map(move |row| (line, row))).collect();
    let returns: Vec<Vec<Return>> = strips
        .par_iter()
        .map(|&(line, row)| {
            let key = (line as u64) << 40 | row;
            let mut draws = stand.seed.derive("scan line", key).draws();
            // Lines stand half a swath apart, the first a quarter of that beyond the western edge.
            let line_x = (line as f64 - 0.25) * half_swath - margin;
            let y = (row as f64 + 0.5) * spacing - margin;
            let mut out = Vec::new();
            let west = (line_x - half_swath).max(-margin);
            let east = (line_x + half_swath).min(side + margin);
            let count = ((east - west) / spacing).round().max(0.0) as u64;
            for i in 0..count {
                let x = west + (i as f64 + f64::from(draws.unit())) * spacing;
                let target =
                    DVec3::new(x, y + (f64::from(draws.unit()) - 0.5) * spacing, reference_z);
                let source = DVec3::new(line_x, y, reference_z + altitude);
                pulse(stand, &grove, options, source, target, &mut draws, &mut out);
            }
            out
        })
        .collect();
    let mut cloud = PointCloud {
        frame: stand.frame.clone(),
        position: Vec::new(),
        intensity: Vec::new(),
        return_number: Vec::new(),
        return_count: Vec::new(),
        class: Vec::new(),
        rgb: None,
    };
    let inside = |p: Vec3| p.x >= 0.0 && p.y >= 0.0 && p.x < stand.side_m && p.y < stand.side_m;
    for r in returns.into_iter().flatten().filter(|r| inside(r.position)) {
        cloud.position.push(r.position);
        cloud.intensity.push(r.intensity);
        cloud.return_number.push(r.number);
        cloud.return_count.push(r.count);
        cloud.class.push(r.class);
    }
    cloud
}

/// Traces one pulse from the source through the target on the reference plane.
fn pulse(
    stand: &Stand,
    grove: &Grove<'_>,
    options: &ScannerOptions,
    source: DVec3,
    target: DVec3,
    draws: &mut Draws,
    out: &mut Vec<Return>,
) {
    const MOST_RETURNS: u8 = 5;
    const LEAST_ENERGY: f32 = 0.10;
    /// Two echoes nearer than this melt into one.
    const LEAST_SEPARATION_M: f32 = 0.9;
    const STEP_M: f32 = 0.22;
    let direction = (target - source).normalize();
    let ground_t = ground_hit(stand, source, direction);
    let foot = source + direction * ground_t;
    let first = out.len();
    let mut echo = |t: f64, energy: f32, reflectance: f32, class: u8, draws: &mut Draws| {
        let range = t + f64::from(options.range_noise_m * draws.normal());
        let speckle = 1.0 + 0.15 * draws.normal();
        out.push(Return {
            position: (source + direction * range).as_vec3(),
            intensity: (42_000.0 * energy * reflectance * speckle).clamp(1.0, 65_535.0) as u16,
            number: 0,
            count: 0,
            class: if options.is_classified { class } else { UNCLASSIFIED },
        });
    };
    // Enter where the ray passes under the highest top.
    let above = source.z - f64::from(grove.highest());
    let mut t = (above / -direction.z).max(0.0) - f64::from(draws.unit() * STEP_M);
    let (mut energy, mut echoes, mut blind_until) = (1.0f32, 0u8, f64::MIN);
    let mut depth_left = -(1.0 - draws.unit()).ln();
    while t < ground_t && echoes < MOST_RETURNS - 1 {
        let p = (source + direction * (t + f64::from(STEP_M) * 0.5)).as_vec3();
        if p.z > grove.top_at(p.truncate()) {
            t += f64::from(STEP_M);
            continue;
        }
        let (mut extinction, mut in_stem) = (0.0f32, false);
        for (_, shape) in grove.over(p.truncate()) {
            extinction += shape.extinction_at(p);
            in_stem |= shape.is_in_stem(p);
        }
        if in_stem {
            echo(t, energy, 0.30, HIGH_VEGETATION, draws);
            energy = 0.0;
            break;
        }
        let depth = extinction * STEP_M;
        if depth < depth_left {
            depth_left -= depth;
            t += f64::from(STEP_M);
            continue;
        }
        let hit = t + f64::from(depth_left / extinction);
        depth_left = -(1.0 - draws.unit()).ln();
        if hit >= ground_t {
            break;
        }
        let kept = energy * draws.between(0.35, 0.85);
        if hit >= blind_until && kept > LEAST_ENERGY {
            echo(hit, kept, 0.48, HIGH_VEGETATION, draws);
            echoes += 1;
            blind_until = hit + f64::from(LEAST_SEPARATION_M);
        }
        energy -= kept;
        if energy < LEAST_ENERGY {
            break;
        }
        t = hit + 1e-3;
    }
    if energy >= LEAST_ENERGY && ground_t >= blind_until - f64::from(LEAST_SEPARATION_M) * 0.5 {
        echo(ground_t, energy, 0.34, GROUND, draws);
    }
    let count = (out.len() - first) as u8;
    for (i, r) in out[first..].iter_mut().enumerate() {
        (r.number, r.count) = (i as u8 + 1, count);
    }
    if draws.unit() * 1000.0 < options.strays_per_mille {
        let is_high = draws.unit() < 0.5;
        let lift = if is_high { draws.between(35.0, 80.0) } else { draws.between(-15.0, -3.0) };
        let is_marked = options.is_classified || draws.unit() < 0.5;
        let noise = if is_high { HIGH_NOISE } else { LOW_NOISE };
        out.push(Return {
            position: foot.as_vec3() + Vec3::Z * lift,
            intensity: draws.between(10.0, 900.0) as u16,
            number: 1,
            count: 1,
            class: if is_marked { noise } else { UNCLASSIFIED },
        });
    }
}

/// Distance to the ground: the ray meets the level plane through the ground under its last
/// meeting. A steep ray over gentle ground closes in by a factor of slope · tan(angle) a step.
fn ground_hit(stand: &Stand, source: DVec3, direction: DVec3) -> f64 {
    let mut t = source.z / -direction.z;
    for _ in 0..12 {
        let p = source + direction * t;
        let next = (source.z - stand.relief.height_at(p.x, p.y)) / -direction.z;
        if (next - t).abs() < 1e-5 {
            return next;
        }
        t = next;
    }
    t
}
