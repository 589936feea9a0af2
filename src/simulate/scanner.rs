//! A flying laser scanner: pulses traced through crowns by the Beer–Lambert law, several returns a
//! pulse, ground, stems, ranging noise and a few stray points.
//!
//! A pulse has width: a crown thinner than it, such as a spruce's leader, gives fewer echoes than
//! its leaves would to a ray. Known limits: an echo lies on the pulse's axis, and crowns hold leaves
//! alone, thicker in an outer shell, as airborne pulses meet them.

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::planting::Stand;
use super::shape::Shape;
use crate::scan::PointCloud;
use crate::seed::{Draws, Seed};

#[derive(Debug, Clone)]
pub struct ScannerOptions {
    /// First returns per square metre, all flight lines together.
    pub pulses_per_m2: f64,
    /// Above the mean ground.
    pub altitude_m: f64,
    pub flight_lines: u32,
    /// Half the width of a pulse where it meets the trees: 0.5 mrad from 450 m.
    pub beam_radius_m: f32,
    /// Standard deviation of each coordinate.
    pub noise_m: f32,
    /// Stray points per million.
    pub strays_per_million: f32,
    /// Write class 2 on ground returns; else every return is class 1 (unclassified).
    pub has_classes: bool,
}

impl Default for ScannerOptions {
    fn default() -> Self {
        ScannerOptions {
            pulses_per_m2: 12.0,
            altitude_m: 450.0,
            flight_lines: 3,
            beam_radius_m: 0.11,
            noise_m: 0.025,
            strays_per_million: 150.0,
            has_classes: false,
        }
    }
}

/// Leaf area met per metre of path in the outer shell of a crown, and inside.
const SHELL_DENSITY: f32 = 0.75;
const INNER_DENSITY: f32 = 0.3;
const SHELL_M: f32 = 0.9;
/// Ranges closer than this merge into one return.
const RESOLUTION_M: f32 = 1.0;
/// Share of a pulse's energy that goes on after a return.
const LEFT_AFTER_RETURN: f32 = 0.6;
/// Weaker remainders are not recorded.
const LEAST_ENERGY: f32 = 0.1;
const MOST_RETURNS: usize = 5;
const STEP_M: f32 = 0.12;

/// Trees by square cells, for pulses and pixels.
pub(super) struct TreeGrid<'a> {
    cell_m: f32,
    side: usize,
    cells: Vec<Vec<u32>>,
    shapes: &'a [Shape],
}

impl<'a> TreeGrid<'a> {
    pub fn new(shapes: &'a [Shape], side_m: f32) -> Self {
        let cell_m = 3.0;
        let side = (side_m / cell_m).ceil().max(1.0) as usize;
        let mut cells = vec![Vec::new(); side * side];
        for (i, s) in shapes.iter().enumerate() {
            let reach = s.reach_m();
            let span = |c: f32| {
                let low = ((c - reach) / cell_m).floor().max(0.0) as usize;
                let high = (((c + reach) / cell_m).floor().max(0.0) as usize).min(side - 1);
                low..=high
            };
            for row in span(s.y) {
                for col in span(s.x) {
                    cells[row * side + col].push(i as u32);
                }
            }
        }
        TreeGrid { cell_m, side, cells, shapes }
    }

    /// Trees that may reach over a place, with their index.
    pub fn near(&self, x: f32, y: f32) -> impl Iterator<Item = (usize, &'a Shape)> + '_ {
        let (c, r) = (x / self.cell_m, y / self.cell_m);
        let inside = c >= 0.0 && r >= 0.0 && (c as usize) < self.side && (r as usize) < self.side;
        let cell = if inside { &self.cells[r as usize * self.side + c as usize][..] } else { &[] };
        cell.iter().map(|&i| (i as usize, &self.shapes[i as usize]))
    }
}

#[derive(Clone, Copy)]
struct Echo {
    position: Vec3,
    intensity: u16,
    number: u8,
    count: u8,
    class: u8,
}

/// Flies over a stand.
pub fn scan(stand: &Stand, options: &ScannerOptions, seed: Seed) -> PointCloud {
    let seed = seed.derive("scanner", 0);
    let grid = TreeGrid::new(&stand.shapes, stand.side_m as f32);
    let lines = options.flight_lines.max(1);
    let spacing_m = (f64::from(lines) / options.pulses_per_m2.max(1e-3)).sqrt();
    let per_side = (stand.side_m / spacing_m).ceil().max(1.0) as u64;
    let top_z =
        stand.shapes.iter().map(|s| s.top_z).fold(f32::MIN, f32::max).max(ground_top(stand));
    let rows: Vec<Vec<Echo>> = (0..u64::from(lines) * per_side)
        .into_par_iter()
        .map(|row| {
            let (line, along) = (row / per_side, row % per_side);
            let mut d = seed.derive("row", row).draws();
            let offset = (line as f64 + 0.5) / f64::from(lines) - 0.5;
            let sensor_y = stand.side_m * (0.5 + 1.6 * offset);
            let mut out = Vec::new();
            for across in 0..per_side {
                let x = (along as f64 + f64::from(d.unit())) * spacing_m;
                let y = (across as f64 + f64::from(d.unit())) * spacing_m;
                if x >= stand.side_m || y >= stand.side_m {
                    continue;
                }
                let ground_z = stand.relief.height_at(x, y);
                let target = DVec3::new(x, y, ground_z);
                let sensor = DVec3::new(x, sensor_y, ground_z + options.altitude_m);
                pulse(&grid, sensor, target, top_z, options, &mut d, &mut out);
            }
            out
        })
        .collect();
    let mut echoes: Vec<Echo> = rows.into_iter().flatten().collect();
    add_strays(&mut echoes, stand, options, seed);
    PointCloud {
        frame: stand.frame.clone(),
        position: echoes.iter().map(|e| e.position).collect(),
        intensity: echoes.iter().map(|e| e.intensity).collect(),
        return_number: echoes.iter().map(|e| e.number).collect(),
        return_count: echoes.iter().map(|e| e.count).collect(),
        class: echoes.iter().map(|e| e.class).collect(),
        rgb: None,
    }
}

fn ground_top(stand: &Stand) -> f32 {
    let at = |i: u32, j: u32| {
        stand
            .relief
            .height_at(f64::from(i) / 32.0 * stand.side_m, f64::from(j) / 32.0 * stand.side_m)
    };
    let highest = (0..=32).flat_map(|i| (0..=32).map(move |j| at(i, j))).fold(f64::MIN, f64::max);
    highest as f32 + 1.0
}

/// Follows one pulse from the canopy's top to the ground and appends its echoes.
fn pulse(
    grid: &TreeGrid,
    sensor: DVec3,
    target: DVec3,
    top_z: f32,
    options: &ScannerOptions,
    d: &mut Draws,
    out: &mut Vec<Echo>,
) {
    let direction = (target - sensor).normalize().as_vec3();
    let path_m = (top_z - target.z as f32).max(0.0) / -direction.z;
    let start = target.as_vec3() - direction * path_m;
    let steps = (path_m / STEP_M).ceil() as usize;
    let first = out.len();
    let mut energy = 1.0f32;
    let mut depth = 0.0;
    let mut wanted = exponential(d);
    let mut blind_until = 0.0f32;
    let mut stopped = false;
    for k in 0..steps {
        let along = (k as f32 + 0.5) * STEP_M;
        let p = start + direction * along;
        let mut density = 0.0f32;
        let mut bark = false;
        for (_, shape) in grid.near(p.x, p.y) {
            if p.z < shape.base_z || p.z > shape.top_z {
                let apart = (p.x - shape.x).hypot(p.y - shape.y);
                bark |= p.z < shape.base_z && p.z > shape.foot_z && apart < shape.stem_radius_m;
                continue;
            }
            let (share, inside) = shape.filled(p.x, p.y, p.z, options.beam_radius_m);
            if share > 0.0 {
                density += share * if inside < SHELL_M { SHELL_DENSITY } else { INNER_DENSITY };
            }
        }
        if bark {
            out.push(echo(p, 0.5 * energy, d));
            stopped = true;
            break;
        }
        depth += density * STEP_M;
        if depth >= wanted && along >= blind_until {
            out.push(echo(p, 0.35 * energy, d));
            depth = 0.0;
            wanted = exponential(d);
            blind_until = along + RESOLUTION_M;
            energy *= LEFT_AFTER_RETURN;
            if energy < LEAST_ENERGY || out.len() - first >= MOST_RETURNS {
                stopped = true;
                break;
            }
        }
    }
    if !stopped {
        let mut e = echo(target.as_vec3(), 0.6 * energy, d);
        e.class = if options.has_classes { 2 } else { 1 };
        out.push(e);
    }
    let count = (out.len() - first) as u8;
    for (i, e) in out[first..].iter_mut().enumerate() {
        e.number = i as u8 + 1;
        e.count = count;
        let noise = Vec3::new(d.normal(), d.normal(), d.normal());
        e.position += noise * options.noise_m;
    }
}

fn exponential(d: &mut Draws) -> f32 {
    -(1.0 - d.unit()).ln()
}

fn echo(position: Vec3, strength: f32, d: &mut Draws) -> Echo {
    let intensity = (strength * d.between(0.8, 1.2) * 3000.0) as u16;
    Echo { position, intensity, number: 1, count: 1, class: 1 }
}

/// Points that no surface returned: low and high noise with their classes, and as many that
/// nobody has marked.
fn add_strays(echoes: &mut Vec<Echo>, stand: &Stand, options: &ScannerOptions, seed: Seed) {
    let count = (echoes.len() as f32 * options.strays_per_million * 1e-6).ceil() as u64;
    for i in 0..count {
        let mut d = seed.derive("stray", i).draws();
        let (x, y) = (f64::from(d.unit()) * stand.side_m, f64::from(d.unit()) * stand.side_m);
        let ground = stand.relief.height_at(x, y) as f32;
        let is_low = d.unit() < 0.5;
        let z = ground + if is_low { -d.between(3.0, 12.0) } else { d.between(55.0, 120.0) };
        let is_marked = d.unit() < 0.5;
        let class = match (is_marked, is_low) {
            (false, _) => 1,
            (true, true) => 7,
            (true, false) => 18,
        };
        let position = Vec3::new(x as f32, y as f32, z);
        echoes.push(Echo { position, intensity: 5, number: 1, count: 1, class });
    }
}

#[cfg(test)]
mod tests {
    use super::super::planting::Stand;
    use super::super::relief::Relief;
    use super::super::shape::cone;
    use super::*;
    use crate::frame::Frame;

    fn bare(side_m: f64) -> Stand {
        Stand {
            frame: Frame::local(DVec3::ZERO),
            side_m,
            relief: Relief::flat(100.0),
            trees: Vec::new(),
            species: Vec::new(),
            shapes: Vec::new(),
            looks: Vec::new(),
        }
    }

    #[test]
    fn bare_ground_returns_lie_on_it_within_the_noise() {
        let options = ScannerOptions { strays_per_million: 0.0, ..ScannerOptions::default() };
        let cloud = scan(&bare(40.0), &options, Seed::new(3));
        let density = cloud.len() as f64 / (40.0 * 40.0);
        assert!((density - options.pulses_per_m2).abs() < 0.1 * options.pulses_per_m2, "{density}");
        let off: Vec<f64> = cloud.position.iter().map(|p| f64::from(p.z) - 100.0).collect();
        let rms = (off.iter().map(|z| z * z).sum::<f64>() / off.len() as f64).sqrt();
        assert!((rms - 0.025).abs() < 0.002, "{rms}");
    }

    #[test]
    fn first_returns_in_a_deep_crown_follow_beer_lambert() {
        // A crown as wide as the plot and 60 m deep: a vertical pulse starts at its top face.
        let mut stand = bare(8.0);
        stand.shapes = vec![cone(4.0, 4.0, 100.0, 101.0, 100_101.0, 500.0)];
        // Far down the cone its flank is distant, so that the density is the inner one.
        stand.shapes[0].top_z = 160.0;
        stand.shapes[0].radius_m = 5000.0;
        let options = ScannerOptions {
            strays_per_million: 0.0,
            noise_m: 0.0,
            altitude_m: 1e6,
            flight_lines: 1,
            pulses_per_m2: 60.0,
            ..ScannerOptions::default()
        };
        let cloud = scan(&stand, &options, Seed::new(5));
        let first: Vec<f64> = (0..cloud.len())
            .filter(|&i| cloud.return_number[i] == 1)
            .map(|i| 160.0 - f64::from(cloud.position[i].z))
            .collect();
        let mean = first.iter().sum::<f64>() / first.len() as f64;
        let expected = 1.0 / f64::from(INNER_DENSITY);
        assert!((mean - expected).abs() < 0.1 * expected, "{mean} against {expected}");
    }

    #[test]
    fn returns_are_numbered_within_their_pulse() {
        let mut stand = bare(20.0);
        stand.shapes = vec![cone(10.0, 10.0, 100.0, 103.0, 120.0, 4.0)];
        let cloud = scan(&stand, &ScannerOptions::default(), Seed::new(2));
        cloud.check().unwrap();
        assert!(cloud.return_count.iter().any(|&n| n > 1));
        assert!(cloud.position.iter().any(|p| p.z > 117.0 && p.z < 121.0));
    }
}
