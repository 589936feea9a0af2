//! Randomness without order: every draw comes from `hash(seed, stage, key)`, so that neither the
//! number of threads nor the presence of other trees changes a result.
//!
//! The mixing function is the finaliser of SplitMix64 (Steele, Lea & Flood 2014).

use glam::Vec3;

/// A 64-bit seed from which further seeds are derived by name and key.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Seed(u64);

pub(crate) const fn mix(mut z: u64) -> u64 {
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

impl Seed {
    pub const fn new(value: u64) -> Self {
        Seed(mix(value ^ 0x9e37_79b9_7f4a_7c15))
    }

    /// The seed of one thing (`key`) in one stage.
    pub fn derive(self, stage: &str, key: u64) -> Seed {
        self.stage(stage).seed(key)
    }

    /// All seeds of one stage, for where there are many.
    pub fn stage(self, name: &str) -> Stage {
        let mut h = self.0;
        for byte in name.bytes() {
            h = mix(h ^ u64::from(byte)).wrapping_add(0x9e37_79b9_7f4a_7c15);
        }
        Stage(h)
    }

    /// A short stream of draws that belongs to this seed alone.
    pub fn draws(self) -> Draws {
        Draws { state: self.0 }
    }
}

/// A stage of which seeds are derived by key.
#[derive(Debug, Clone, Copy)]
pub struct Stage(u64);

impl Stage {
    /// [`Seed::derive`] in this stage.
    #[inline]
    pub fn seed(self, key: u64) -> Seed {
        Seed(mix(self.0 ^ mix(key.wrapping_add(0x9e37_79b9_7f4a_7c15))))
    }
}

/// A stream of draws owned by one derived seed.
#[derive(Debug, Clone)]
pub struct Draws {
    state: u64,
}

impl Draws {
    pub fn bits(&mut self) -> u64 {
        self.state = self.state.wrapping_add(0x9e37_79b9_7f4a_7c15);
        mix(self.state)
    }

    /// Uniform in [0, 1).
    pub fn unit(&mut self) -> f32 {
        (self.bits() >> 40) as f32 / (1u64 << 24) as f32
    }

    /// Uniform in [low, high).
    pub fn between(&mut self, low: f32, high: f32) -> f32 {
        low + (high - low) * self.unit()
    }

    /// Uniform index below `count`; 0 where `count` is 0.
    pub fn index(&mut self, count: usize) -> usize {
        ((u128::from(self.bits()) * count as u128) >> 64) as usize
    }

    /// Standard normal (Box & Muller 1958).
    pub fn normal(&mut self) -> f32 {
        let u = 1.0 - self.unit();
        let v = self.unit();
        (-2.0 * u.ln()).sqrt() * (std::f32::consts::TAU * v).cos()
    }

    /// Uniform in the cube −1…1, from one draw: as far from its middle on each axis as
    /// [`Draws::direction`].
    pub fn jitter(&mut self) -> Vec3 {
        let bits = self.bits();
        let part =
            |shift: u32| ((bits >> shift) & 0x1f_ffff) as f32 * (2.0 / 0x1f_ffff as f32) - 1.0;
        Vec3::new(part(43), part(22), part(1))
    }

    /// Uniform on the unit sphere.
    pub fn direction(&mut self) -> Vec3 {
        let z = self.between(-1.0, 1.0);
        let (s, c) = self.between(0.0, std::f32::consts::TAU).sin_cos();
        let r = (1.0 - z * z).max(0.0).sqrt();
        Vec3::new(r * c, r * s, z)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stages_and_keys_give_unrelated_seeds() {
        let s = Seed::new(7);
        assert_ne!(s.derive("crown", 1), s.derive("crown", 2));
        assert_ne!(s.derive("crown", 1), s.derive("mesh", 1));
        assert_eq!(s.derive("crown", 1), Seed::new(7).derive("crown", 1));
    }

    #[test]
    fn moments_are_those_of_the_distributions() {
        let mut d = Seed::new(1).draws();
        let n = 100_000;
        let mean: f32 = (0..n).map(|_| d.unit()).sum::<f32>() / n as f32;
        assert!((mean - 0.5).abs() < 0.005);
        let var: f32 = (0..n).map(|_| d.normal().powi(2)).sum::<f32>() / n as f32;
        assert!((var - 1.0).abs() < 0.02);
        assert!((0..1000).all(|_| d.index(3) < 3));
    }
}
