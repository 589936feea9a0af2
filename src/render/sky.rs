//! The colours of sun, sky and haze, and the film on which light falls.

use glam::Vec3;

pub const SUN_COLOUR: Vec3 = Vec3::new(3.9, 3.5, 2.85);
pub const SKY_COLOUR: Vec3 = Vec3::new(0.78, 0.98, 1.28);
pub const BOUNCE_COLOUR: Vec3 = Vec3::new(0.34, 0.33, 0.22);
const ZENITH: Vec3 = Vec3::new(0.20, 0.40, 0.78);
const HORIZON: Vec3 = Vec3::new(0.80, 0.92, 1.06);

/// Light of the air before what is far away, seen along `direction`.
pub fn haze(direction: Vec3, sun: Vec3) -> Vec3 {
    let toward = direction.normalize_or_zero().dot(sun).max(0.0);
    Vec3::new(0.62, 0.74, 0.88) + Vec3::new(0.35, 0.26, 0.12) * toward.powi(6)
}

/// The sky behind everything; below the horizon, the far haze.
pub fn sky(direction: Vec3, sun: Vec3) -> Vec3 {
    let d = direction.normalize_or(Vec3::Y);
    let up = d.z.max(0.0).powf(0.55);
    let below = (-d.z).max(0.0);
    let sky = HORIZON.lerp(ZENITH, up.min(1.0));
    let far = HORIZON.lerp(Vec3::new(0.56, 0.66, 0.72), (below * 1.5).min(1.0));
    let toward = d.dot(sun).max(0.0);
    (if d.z >= 0.0 { sky } else { far }) + Vec3::new(0.5, 0.4, 0.2) * toward.powi(24)
}

/// Display-linear colour on film: the curve fitted by Narkowicz (2015) to the ACES transform.
pub fn film(light: Vec3, exposure: f32) -> Vec3 {
    let x = light.max(Vec3::ZERO) * exposure;
    let y = (x * (x * 2.51 + 0.03)) / (x * (x * 2.43 + 0.59) + 0.14);
    y.clamp(Vec3::ZERO, Vec3::ONE)
}
