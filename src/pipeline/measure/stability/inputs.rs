//! The edge of coordinates, files, clouds of one tree, allometry and shared models.

use glam::{DVec3, Vec2, Vec3};

use super::super::convergence::{empty_cloud, push};
use super::unrefused;
use crate::diagnostic::Result;
use crate::frame::Frame;
use crate::scan::{self, PointCloud, Scan};
use crate::scene::sharing::{Build, share};
use crate::seed::Seed;
use crate::skeleton::stability::Case;
use crate::skeleton::{Detail, cloud};
use crate::species::{self, allometry};

pub(super) fn cases() -> Vec<(&'static str, Case)> {
    cases! {
        frame: "coordinates of 10⁷ m" => "millimetres kept within 2 km", 1e-3 "m", ten_million;
        scan: "coordinates of 10⁷ m, through a LAZ file" => "millimetres kept", 1.1e-3 "m", through_a_file;
        scan: "a LAZ file cut in half" => "the points before the cut", 0.11 "of the points lost before it", cut;
        scan: "a LAZ file of which a half is overwritten" => "what can be told is read, or an error",
            0.0 "points that are no numbers", overwritten;
        scan: "a LAZ file whose table of chunks is nowhere" => "every point",
            0.0 "points lost", no_table;
        scan: "2 points and 30 together, 500 m over and 9,999 m under the rest" => "left out",
            0.0 "points off", clumps;
        scan: "a cliff of 100 m, a mast of 80 m with returns all the way up" => "every point kept",
            0.0 "points off", cliff_and_mast;
        scan: "a line in the air 30 m over the ground, one 60 m" => "kept; left out, and nothing else",
            0.0 "points off", lines_in_the_air;
        scan: "a shaft 24 m wide and 70 m deep, one 2 m" => "kept; left out, and nothing else",
            0.0 "points off", shafts;
        scan: "one point 1,000 km away" => "left out, the rest read", 0.0 "points off", stray;
        skeleton: "clouds of no point, one, 10⁴ alike, none that is a number, 100 m wide" => "an error each",
            0.0 "answers without one", no_clouds;
        skeleton: "the cloud of a pole 2 cm thick, too thin to be measured" => "wood along its points",
            0.05 "m from them, mean", thin_pole;
        species: "stems of trees of 1.4 to 130 m, crowns of 0.05 to 60 m, beyond what was fitted" =>
            "numbers above 0 that grow with the tree", 0.0 "faults", stems;
        species: "weights of the same" => "numbers above 0", 0.0 "faults", weights;
        scene: "100 trees all alike, five models a species; three trees, five" => "one model for all; one each",
            0.0 "models off", alike;
    }
}

fn ten_million() -> Result<f64> {
    let frame = Frame::local(DVec3::new(1e7, 1e7, 1e4));
    let mut draws = Seed::new(6).draws();
    let mut worst = 0.0f64;
    for _ in 0..10_000 {
        // Not as f32 has them.
        let mut fine = |r: f32| f64::from(draws.between(-r, r)) + 1e-4 * f64::from(draws.unit());
        let [x, y, z] = [2e3, 2e3, 100.0].map(&mut fine);
        let world = frame.origin + DVec3::new(x, y, z);
        let back = frame.world_from_local(frame.local_from_world(world));
        worst = worst.max((back - world).abs().max_element());
    }
    Ok(worst)
}

/// Ground of 100 m with chance places, south-west corner at `at`.
fn plot(at: DVec3, count: usize) -> PointCloud {
    let mut cloud = empty_cloud();
    cloud.frame = Frame::local(at);
    let mut draws = Seed::new(5).draws();
    for _ in 0..count {
        push(
            &mut cloud,
            Vec3::new(draws.between(0.0, 100.0), draws.between(0.0, 100.0), draws.unit()),
        );
    }
    cloud
}

fn read(bytes: &[u8]) -> Result<Scan> {
    Ok(scan::read_bytes(bytes, &crate::pipeline::survey::READ)?.value)
}

fn through_a_file() -> Result<f64> {
    let cloud = plot(DVec3::new(1e7, 1e7, 1e3), 20_000);
    let back = read(&scan::encode_laz(&cloud)?)?.cloud;
    if back.len() != cloud.len() {
        return Ok(f64::INFINITY);
    }
    let worlds = cloud.position.iter().zip(&back.position).map(|(a, b)| {
        let (a, b) = (cloud.frame.world_from_local(*a), back.frame.world_from_local(*b));
        (a - b).abs().max_element()
    });
    Ok(worlds.fold(0.0, f64::max))
}

/// Chunks hold 50,000 points; those of the one that is cut are lost.
const MANY: usize = 500_000;

fn cut() -> Result<f64> {
    let whole = scan::encode_laz(&plot(DVec3::ZERO, MANY))?;
    let back = read(&whole[..whole.len() / 2])?.cloud.len() as f64;
    Ok((0.5 - back / MANY as f64).abs())
}

fn overwritten() -> Result<f64> {
    let mut bytes = scan::encode_laz(&plot(DVec3::ZERO, 60_000))?;
    let half = bytes.len() / 2;
    let mut draws = Seed::new(2).draws();
    bytes[half..].iter_mut().for_each(|b| *b = (256.0 * draws.unit()) as u8);
    Ok(read(&bytes)
        .map_or(0.0, |s| s.cloud.position.iter().filter(|p| !p.is_finite()).count() as f64))
}

fn no_table() -> Result<f64> {
    let mut bytes = scan::encode_laz(&plot(DVec3::ZERO, 120_000))?;
    // LAS 1.4: the header says where the points begin, and there where the table is.
    let points = u32::from_le_bytes([bytes[96], bytes[97], bytes[98], bytes[99]]) as usize;
    bytes[points..points + 8].copy_from_slice(&(-1i64).to_le_bytes());
    Ok(read(&bytes)?.cloud.len().abs_diff(120_000) as f64)
}

fn clumps() -> Result<f64> {
    let mut off = 0;
    for (count, z) in [(2, 500.0), (30, 500.0), (2, -9_999.0), (30, -9_999.0)] {
        let mut cloud = plot(DVec3::ZERO, 40_000);
        (0..count).for_each(|k| push(&mut cloud, Vec3::new(50.0, 50.0 + 0.1 * k as f32, z)));
        off += read(&scan::encode_laz(&cloud)?)?.cloud.len().abs_diff(40_000);
    }
    Ok(off as f64)
}

fn cliff_and_mast() -> Result<f64> {
    let mut cloud = plot(DVec3::ZERO, 40_000);
    for p in &mut cloud.position {
        p.z += if p.x > 37.3 + 4.0 * (0.2 * p.y).sin() { 100.0 } else { 0.0 };
    }
    (0..160).for_each(|k| push(&mut cloud, Vec3::new(20.0, 20.0, 0.5 * k as f32)));
    Ok(read(&scan::encode_laz(&cloud)?)?.cloud.len().abs_diff(cloud.len()) as f64)
}

fn lines_in_the_air() -> Result<f64> {
    let off = |z: f32, is_kept: bool| -> Result<usize> {
        let mut cloud = plot(DVec3::ZERO, 40_000);
        (0..200).for_each(|k| push(&mut cloud, Vec3::new(0.5 * k as f32, 50.0, z)));
        let wanted = if is_kept { 40_200 } else { 40_000 };
        Ok(read(&scan::encode_laz(&cloud)?)?.cloud.len().abs_diff(wanted))
    };
    Ok((off(30.0, true)? + off(60.0, false)?) as f64)
}

fn shafts() -> Result<f64> {
    let off = |width_m: f32, is_kept: bool| -> Result<usize> {
        let mut cloud = plot(DVec3::ZERO, 40_000);
        let mut sunk = 0;
        for p in &mut cloud.position {
            if (p.truncate() - Vec2::splat(50.0)).abs().max_element() < 0.5 * width_m {
                p.z -= 70.0;
                sunk += 1;
            }
        }
        let wanted = if is_kept { 40_000 } else { 40_000 - sunk };
        Ok(read(&scan::encode_laz(&cloud)?)?.cloud.len().abs_diff(wanted))
    };
    Ok((off(24.0, true)? + off(2.0, false)?) as f64)
}

fn stray() -> Result<f64> {
    let mut cloud = plot(DVec3::ZERO, 40_000);
    push(&mut cloud, Vec3::new(1e6, 0.0, 0.0));
    Ok(read(&scan::encode_laz(&cloud)?)?.cloud.len().abs_diff(40_000) as f64)
}

fn no_clouds() -> Result<f64> {
    let species = species::load("pinus_sylvestris")?;
    let wide = (0..2_000).map(|k| Vec3::new(0.05 * k as f32, (k % 7) as f32, (k % 50) as f32));
    let clouds = [
        Vec::new(),
        vec![Vec3::ONE],
        vec![Vec3::ONE; 10_000],
        vec![Vec3::NAN; 10_000],
        wide.collect(),
    ];
    Ok(unrefused(clouds.map(|c| cloud::fit(&species, &c, Detail::FOREST, Seed::new(1)))))
}

fn thin_pole() -> Result<f64> {
    let species = species::load("pinus_sylvestris")?;
    let mut draws = Seed::new(3).draws();
    let around = (0..6_000).map(|k| {
        let side = Vec2::from_angle(draws.between(0.0, std::f32::consts::TAU)) * 0.01;
        side.extend(1e-3 * k as f32)
    });
    let fitted = cloud::fit(&species, &around.collect::<Vec<_>>(), Detail::FOREST, Seed::new(1))?;
    fitted.skeleton.check()?;
    Ok(fitted.report.mean_m)
}

/// Height and crown diameter from a sapling to more than any tree, metres.
fn sizes() -> impl Iterator<Item = (f32, f32)> {
    let share = |k: u8| f32::from(k) / 20.0;
    (0..=20).map(move |k| (1.4 * (130f32 / 1.4).powf(share(k)), 0.05 * 1200f32.powf(share(k))))
}

fn stems() -> Result<f64> {
    let mut faults = 0;
    for name in species::builtin_names() {
        let species = species::load(name)?;
        let all: Vec<f32> =
            sizes().map(|(h, d)| allometry::stem_diameter_m(&species, h, d)).collect();
        faults += all.iter().filter(|d| !(d.is_finite() && **d > 0.0)).count();
        faults += all.windows(2).filter(|pair| pair[1] <= pair[0]).count();
    }
    Ok(faults as f64)
}

fn weights() -> Result<f64> {
    let mut faults = 0;
    for name in species::builtin_names() {
        let species = species::load(name)?;
        let all = sizes().map(|(h, d)| allometry::biomass_kg(&species, h, d));
        faults += all.filter(|kg| !(kg.is_finite() && *kg > 0.0)).count();
    }
    Ok(faults as f64)
}

fn alike() -> Result<f64> {
    let tree = |height_m: f32| Build { species: 0, height_m, crown_diameter_m: 0.2 * height_m };
    let models = |trees: &[Build]| share(trees, 5).len() as f64;
    let three = [5.0, 10.0, 20.0].map(tree);
    Ok((models(&[tree(20.0); 100]) - 1.0).abs() + (models(&three) - 3.0).abs())
}
