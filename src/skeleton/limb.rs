//! One branch of the scaffold: a curved chain of nodes that ends at the crown's envelope.
//!
//! A branch leaves its parent at an angle, turns by one amount over its first half and by another
//! over its outer half (the curve and curve-back of Weber & Penn 1995), bends with tropism and
//! wanders. Its length is what the rule and the length decay allow, or less where it meets the
//! envelope first; the curve is then that of the shortened branch.

use glam::{Quat, Vec3};

use super::envelope::Envelope;
use crate::seed::Draws;

/// Nodes of one branch at most.
const MAX_SEGMENTS: usize = 24;

/// A branch before it is drawn.
#[derive(Debug, Clone, Copy)]
pub struct Limb {
    pub base: Vec3,
    /// Unit.
    pub direction: Vec3,
    /// Length allowed, metres.
    pub length_m: f32,
    /// Turn up (+) or down (−) over the first and over the second half, degrees.
    pub curve_deg: f32,
    pub tip_deg: f32,
    /// Turn up (+) or down (−), degrees a metre.
    pub tropism: f32,
    /// Random turn, degrees a metre.
    pub wander: f32,
    /// Share of the envelope it reaches.
    pub reach: f32,
    /// Lowest height it may pass.
    pub clearance_m: f32,
    /// Wished length of a segment, metres.
    pub segment_m: f32,
}

impl Limb {
    /// The nodes after the base; empty where there is no room for even a short branch.
    pub fn trace(&self, envelope: &Envelope, draws: &mut Draws) -> Vec<Vec3> {
        if !(self.length_m.is_finite() && self.length_m > 0.0) {
            return Vec::new();
        }
        let bends: Vec<Vec3> = (0..MAX_SEGMENTS).map(|_| draws.direction()).collect();
        let mut length_m = self.length_m;
        let mut nodes = Vec::new();
        // A shorter branch curves in less space and so meets the envelope elsewhere; this settles
        // in two or three turns.
        for _ in 0..3 {
            let (path, reached_m) = self.walk(length_m, envelope, &bends);
            nodes = path;
            if reached_m >= 0.97 * length_m {
                break;
            }
            length_m = reached_m;
        }
        nodes
    }

    fn walk(&self, length_m: f32, envelope: &Envelope, bends: &[Vec3]) -> (Vec<Vec3>, f32) {
        let count = ((length_m / self.segment_m).ceil() as usize).clamp(2, MAX_SEGMENTS);
        let step = length_m / count as f32;
        let mut nodes = Vec::with_capacity(count);
        let (mut at, mut heading) = (self.base, self.direction);
        let mut done_m = 0.0;
        // A branch that starts outside may grow until it has left a little further.
        let limit = self.reach.max(envelope.relative_radius(at).min(1.0) + 0.02);
        for (i, bend) in bends.iter().enumerate().take(count) {
            let half =
                if (i as f32 + 0.5) < 0.5 * count as f32 { self.curve_deg } else { self.tip_deg };
            // The first segment keeps the angle of the fork.
            let along = if i == 0 { 0.5 } else { 1.0 };
            let lift = along * (2.0 * half / count as f32 + self.tropism * step);
            heading = lifted(heading, lift.to_radians());
            let wander = (self.wander * step).to_radians().min(0.6);
            heading = (heading + wander * *bend).normalize_or(heading);
            let mut next = at + heading * step;
            if next.z < self.clearance_m {
                heading.z = ((self.clearance_m - at.z) / step).clamp(-1.0, 0.3);
                heading = heading.normalize_or(Vec3::Z);
                next = at + heading * step;
                next.z = next.z.max(self.clearance_m);
            }
            if !is_inside(envelope, next, limit) {
                let (mut inside, mut outside) = (0.0f32, 1.0f32);
                for _ in 0..6 {
                    let middle = 0.5 * (inside + outside);
                    if is_inside(envelope, at + (next - at) * middle, limit) {
                        inside = middle;
                    } else {
                        outside = middle;
                    }
                }
                // Where a spire leaves little room even a stub counts: it is walked again, shorter.
                if inside > if nodes.is_empty() { 0.08 } else { 0.3 } {
                    nodes.push(at + (next - at) * inside);
                    done_m += inside * step;
                }
                return (nodes, done_m);
            }
            nodes.push(next);
            at = next;
            done_m += step;
        }
        (nodes, length_m)
    }
}

fn is_inside(envelope: &Envelope, p: Vec3, limit: f32) -> bool {
    // Drooping ends may hang below the crown's base.
    let z = p.z.max(envelope.base_m);
    z <= envelope.height_m && envelope.relative_radius(Vec3::new(p.x, p.y, z)) <= limit
}

/// `heading` turned towards the sky by `angle_rad`, never past the vertical.
pub fn lifted(heading: Vec3, angle_rad: f32) -> Vec3 {
    let across = heading.cross(Vec3::Z);
    let Some(axis) = across.try_normalize() else { return heading };
    // Angle from the sky, in (0, π).
    let from_sky = across.length().atan2(heading.z);
    let margin = 0.02f32.min(from_sky).min(std::f32::consts::PI - from_sky);
    let wished = (from_sky - angle_rad).clamp(margin, std::f32::consts::PI - margin);
    (Quat::from_axis_angle(axis, from_sky - wished) * heading).normalize_or(heading)
}

/// Two unit vectors across a unit direction: level to its right, and up from there; X and Y about
/// an upright one.
pub fn sides(ahead: Vec3) -> (Vec3, Vec3) {
    let is_level = ahead.x.hypot(ahead.y) > 0.05;
    let across = if is_level { ahead.cross(Vec3::Z).normalize_or(Vec3::X) } else { Vec3::X };
    (across, across.cross(ahead).normalize_or(Vec3::Y))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_lift_turns_by_its_angle_and_stops_at_the_vertical() {
        let up = lifted(Vec3::X, 30f32.to_radians());
        assert!((up - Vec3::new(30f32.to_radians().cos(), 0.0, 0.5)).length() < 1e-6);
        let down = lifted(Vec3::Y, -30f32.to_radians());
        assert!((down.z + 0.5).abs() < 1e-6 && down.y > 0.0);
        assert!(lifted(Vec3::X, 10.0).z > 0.999);
        assert!(lifted(Vec3::X, -10.0).z < -0.999);
        assert_eq!(lifted(Vec3::Z, 1.0), Vec3::Z);
    }
}
