//! What was found beside what is true.
//!
//! Matching is one to one, nearest first: of all pairs within reach, the pair with the least
//! horizontal distance is taken, both leave, and so on. A found tree is within reach of a true one
//! when it stands nearer than the greater of 2 m and half of the true crown's radius, and its
//! height differs by no more than the greater of 3 m and 35 %: a shrub under a larch is not that
//! larch.

use std::collections::BTreeMap;

use glam::Vec2;
use serde::Serialize;

use super::stand::TrueTree;

/// A tree as found; local metres of the stand's frame.
#[derive(Debug, Clone, PartialEq)]
pub struct FoundTree {
    pub position: Vec2,
    pub height_m: f32,
    pub crown_diameter_m: f32,
    /// [`crate::species::Species::id`], where it was named.
    pub species: Option<String>,
}

/// Errors of a measure: found less true.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Deviation {
    pub count: usize,
    pub rmse: f64,
    pub bias: f64,
}

impl Deviation {
    /// Zero for no differences.
    fn of(differences: impl Iterator<Item = f64>) -> Deviation {
        let (mut count, mut sum, mut squares) = (0, 0.0, 0.0);
        for d in differences {
            count += 1;
            sum += d;
            squares += d * d;
        }
        let n = f64::from(u32::try_from(count).unwrap_or(u32::MAX)).max(1.0);
        Deviation { count, rmse: (squares / n).sqrt(), bias: sum / n }
    }
}

#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Comparison {
    pub truth: usize,
    pub found: usize,
    pub matched: usize,
    /// True trees without a found one.
    pub missed: usize,
    /// Found trees without a true one.
    pub invented: usize,
    pub recall: f64,
    pub precision: f64,
    pub f1: f64,
    /// Horizontal distance of matched trees; metres.
    pub position_rmse_m: f64,
    pub height_m: Deviation,
    pub crown_diameter_m: Deviation,
    /// Matched trees whose found species is named.
    pub species_named: usize,
    pub species_right: usize,
    /// Matched trees by true species, then by found species.
    pub confusion: BTreeMap<String, BTreeMap<String, usize>>,
    /// (true, found) indices, by true index.
    #[serde(skip)]
    pub pairs: Vec<(u32, u32)>,
}

/// Matches found trees to true ones and measures both.
pub fn compare(truth: &[TrueTree], found: &[FoundTree]) -> Comparison {
    let pairs = matching(truth, found);
    let of = |pair: &(u32, u32)| (&truth[pair.0 as usize], &found[pair.1 as usize]);
    let distance = |p: &(u32, u32)| {
        let (t, f) = of(p);
        f64::from(t.position.truncate().distance(f.position))
    };
    let height = |p: &(u32, u32)| f64::from(of(p).1.height_m) - f64::from(of(p).0.height_m);
    let diameter =
        |p: &(u32, u32)| f64::from(of(p).1.crown_diameter_m) - f64::from(of(p).0.crown_diameter_m);
    let (mut named, mut right) = (0, 0);
    let mut confusion: BTreeMap<String, BTreeMap<String, usize>> = BTreeMap::new();
    for (t, f) in pairs.iter().map(of) {
        let Some(species) = &f.species else { continue };
        named += 1;
        right += usize::from(*species == t.species);
        *confusion.entry(t.species.clone()).or_default().entry(species.clone()).or_default() += 1;
    }
    let share = |whole: usize| pairs.len() as f64 / (whole as f64).max(1.0);
    let (recall, precision) = (share(truth.len()), share(found.len()));
    Comparison {
        truth: truth.len(),
        found: found.len(),
        matched: pairs.len(),
        missed: truth.len() - pairs.len(),
        invented: found.len() - pairs.len(),
        recall,
        precision,
        f1: 2.0 * pairs.len() as f64 / ((truth.len() + found.len()) as f64).max(1.0),
        position_rmse_m: Deviation::of(pairs.iter().map(distance)).rmse,
        height_m: Deviation::of(pairs.iter().map(height)),
        crown_diameter_m: Deviation::of(pairs.iter().map(diameter)),
        species_named: named,
        species_right: right,
        confusion,
        pairs,
    }
}

fn matching(truth: &[TrueTree], found: &[FoundTree]) -> Vec<(u32, u32)> {
    // Found trees by column of 2 m, so that each true tree looks at few.
    const COLUMN_M: f32 = 2.0;
    let mut columns: BTreeMap<i32, Vec<u32>> = BTreeMap::new();
    for (i, f) in found.iter().enumerate().filter(|(_, f)| f.position.is_finite()) {
        columns.entry((f.position.x / COLUMN_M).floor() as i32).or_default().push(i as u32);
    }
    let mut candidates: Vec<(f32, u32, u32)> = Vec::new();
    for (i, t) in truth.iter().enumerate() {
        let reach = (t.crown_diameter_m * 0.25).max(2.0);
        let height_reach = (t.height_m * 0.35).max(3.0);
        let first = ((t.position.x - reach) / COLUMN_M).floor() as i32;
        let last = ((t.position.x + reach) / COLUMN_M).floor() as i32;
        for &j in columns.range(first..=last.max(first)).flat_map(|c| c.1) {
            let f = &found[j as usize];
            let distance = t.position.truncate().distance(f.position);
            if distance <= reach && (f.height_m - t.height_m).abs() <= height_reach {
                candidates.push((distance, i as u32, j));
            }
        }
    }
    candidates.sort_by(|a, b| a.0.total_cmp(&b.0).then((a.1, a.2).cmp(&(b.1, b.2))));
    let (mut is_taken, mut is_used) = (vec![false; truth.len()], vec![false; found.len()]);
    let mut pairs = Vec::new();
    for (_, i, j) in candidates {
        if !is_taken[i as usize] && !is_used[j as usize] {
            (is_taken[i as usize], is_used[j as usize]) = (true, true);
            pairs.push((i, j));
        }
    }
    pairs.sort_unstable();
    pairs
}

/// Errors of heights at places (x, y), local metres of the stand's frame, against its relief.
pub fn terrain_error(
    stand: &super::Stand,
    places: impl IntoIterator<Item = [f64; 2]>,
    height_at: impl Fn([f64; 2]) -> f64,
) -> Deviation {
    Deviation::of(places.into_iter().map(|p| height_at(p) - stand.relief.height_at(p[0], p[1])))
}
