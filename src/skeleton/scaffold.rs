//! What the species' rule writes, as a tree of shoots: which springs from which, at what angle and
//! to what side, and how long beside its parent. Sizes come later.

use crate::species::Species;

/// One drawn module of the rule.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Shoot {
    /// Earlier in the list; `None` where it stands on the ground.
    pub parent: Option<u32>,
    /// Brackets around it beyond those of the stem: 0 the stem, 1 its laterals, …
    pub depth: u8,
    /// Angle from the parent's direction.
    pub tilt_rad: f32,
    /// Side of the parent it leans to.
    pub azimuth_rad: f32,
    /// Length over the parent's.
    pub ratio: f32,
    /// Place among the laterals its parent has, 0 the first the rule writes (the newest).
    pub rank: u32,
    /// Number of laterals its parent has.
    pub siblings: u32,
}

/// A stem of `internodes` shoots, each rewritten by the rule.
pub fn scaffold(species: &Species, internodes: u32) -> Vec<Shoot> {
    let sym = species.builds_on.as_deref() == Some("table3/04");
    let stool = species.builds_on.as_deref() == Some("table3/08");
    let n = 3;
    let mut out = Vec::new();
    let mut below = None;
    for _ in 0..if stool { 4 } else { internodes } {
        if stool { below = None; }
        let id = out.len() as u32;
        out.push(Shoot { parent: below, depth: 0, tilt_rad: 0.0, azimuth_rad: 0.0, ratio: 1.0, rank: 0, siblings: 0 });
        laterals(&mut out, id, n, 1, sym);
        below = Some(id);
    }
    out
}

fn laterals(out: &mut Vec<Shoot>, parent: u32, generations: u32, depth: u8, sym: bool) {
    if sym && generations == 0 { return; }
    for g in if sym { generations - 1..generations } else { 0..generations } {
        for k in 0..4 {
            let id = out.len() as u32;
            out.push(Shoot {
                parent: Some(parent),
                depth,
                tilt_rad: 0.5,
                azimuth_rad: k as f32 * std::f32::consts::FRAC_PI_2,
                ratio: 0.5,
                rank: if sym { k } else { g * 4 + k },
                siblings: if sym { 4 } else { generations * 4 },
            });
            laterals(out, id, g, depth + 1, sym);
        }
    }
}
