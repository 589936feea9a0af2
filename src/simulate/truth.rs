//! What was found beside what is there.

use glam::DVec2;
use serde::Serialize;

use super::planting::{Stand, TrueTree};

/// A tree as somebody found it; the stand's local metres.
#[derive(Debug, Clone)]
pub struct FoundTree {
    pub x: f64,
    pub y: f64,
    pub height_m: f32,
    pub crown_diameter_m: f32,
    /// Scientific name.
    pub species: String,
}

/// A difference, found minus true.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct Difference {
    pub rmse_m: f64,
    pub bias_m: f64,
}

impl Difference {
    fn of(values: &[f64]) -> Self {
        let n = values.len().max(1) as f64;
        Difference {
            rmse_m: (values.iter().map(|v| v * v).sum::<f64>() / n).sqrt(),
            bias_m: values.iter().sum::<f64>() / n,
        }
    }
}

/// How close somebody came to the truth.
#[derive(Debug, Clone, Serialize)]
pub struct Comparison {
    pub trees: usize,
    pub found: usize,
    pub matched: usize,
    /// True trees without a match.
    pub missed: usize,
    /// Found trees without a match.
    pub invented: usize,
    /// 2 · matched / (trees + found).
    pub f1: f64,
    /// Distance between matched positions.
    pub position_rmse_m: f64,
    pub height: Difference,
    pub crown_diameter: Difference,
    pub terrain: Difference,
    /// Share of the matched trees with the right species.
    pub species_accuracy: f64,
    /// Rows: true species; columns: found species, in the stand's order; the last column holds
    /// any other.
    pub confusion: Vec<Vec<usize>>,
    pub species: Vec<String>,
}

/// A match may be this far off, or half a crown's radius if that is more.
const REACH_M: f64 = 2.0;

/// Part of a stand, the stand's local metres: its south-west and its north-east corner.
#[derive(Debug, Clone, Copy)]
pub struct Window {
    pub low: DVec2,
    pub high: DVec2,
}

impl Window {
    pub const ALL: Window = Window { low: DVec2::NEG_INFINITY, high: DVec2::INFINITY };

    fn holds(&self, x: f64, y: f64) -> bool {
        let p = DVec2::new(x, y);
        p.cmpge(self.low).all() && p.cmplt(self.high).all()
    }
}

/// Sets found trees beside a stand. A true and a found tree may match within 2 m or half the true
/// crown's radius; pairs are taken greedily from the nearest on, each tree once, a metre of height
/// counting as a third of a metre of distance. True trees that nobody found count `within` the part of
/// the stand that was looked at. `height_at` is the terrain as found, sampled every metre there.
pub fn compare(
    stand: &Stand,
    found: &[FoundTree],
    within: &Window,
    height_at: impl Fn(f64, f64) -> f64,
) -> Comparison {
    let mut pairs: Vec<(f64, usize, usize)> = Vec::new();
    for (i, t) in stand.trees.iter().enumerate() {
        let reach = REACH_M.max(0.25 * f64::from(t.crown_diameter_m));
        for (j, f) in found.iter().enumerate() {
            let distance = (t.x - f.x).hypot(t.y - f.y);
            if distance <= reach {
                pairs.push((distance + f64::from((t.height_m - f.height_m).abs()) / 3.0, i, j));
            }
        }
    }
    pairs.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)).then(a.2.cmp(&b.2)));
    let mut is_taken = (vec![false; stand.trees.len()], vec![false; found.len()]);
    let mut matches: Vec<(&TrueTree, &FoundTree)> = Vec::new();
    for (_, i, j) in pairs {
        if !is_taken.0[i] && !is_taken.1[j] {
            (is_taken.0[i], is_taken.1[j]) = (true, true);
            matches.push((&stand.trees[i], &found[j]));
        }
    }
    let all = |f: &dyn Fn(&TrueTree, &FoundTree) -> f64| -> Vec<f64> {
        matches.iter().map(|(t, m)| f(t, m)).collect()
    };
    let mut confusion = vec![vec![0; stand.species.len() + 1]; stand.species.len()];
    for (t, m) in &matches {
        let column = stand.species.iter().position(|s| *s == m.species);
        confusion[t.species][column.unwrap_or(stand.species.len())] += 1;
    }
    let right: usize = (0..stand.species.len()).map(|i| confusion[i][i]).sum();
    let matched = matches.len();
    let looked_at = stand.trees.iter().zip(&is_taken.0);
    let missed = looked_at.filter(|(t, is_taken)| !**is_taken && within.holds(t.x, t.y)).count();
    let trees = matched + missed;
    Comparison {
        trees,
        found: found.len(),
        matched,
        missed,
        invented: found.len() - matched,
        f1: 2.0 * matched as f64 / (trees + found.len()).max(1) as f64,
        position_rmse_m: Difference::of(&all(&|t, m| (t.x - m.x).hypot(t.y - m.y))).rmse_m,
        height: Difference::of(&all(&|t, m| f64::from(m.height_m - t.height_m))),
        crown_diameter: Difference::of(&all(&|t, m| {
            f64::from(m.crown_diameter_m - t.crown_diameter_m)
        })),
        terrain: terrain(stand, within, height_at),
        species_accuracy: right as f64 / matched.max(1) as f64,
        confusion,
        species: stand.species.clone(),
    }
}

fn terrain(stand: &Stand, within: &Window, height_at: impl Fn(f64, f64) -> f64) -> Difference {
    let n = stand.side_m.floor() as u32;
    let off: Vec<f64> = (0..n)
        .flat_map(|i| (0..n).map(move |j| (f64::from(i) + 0.5, f64::from(j) + 0.5)))
        .filter(|&(x, y)| within.holds(x, y))
        .map(|(x, y)| height_at(x, y) - stand.relief.height_at(x, y))
        .collect();
    Difference::of(&off)
}

#[cfg(test)]
mod tests {
    use super::super::relief::Relief;
    use super::*;
    use crate::frame::Frame;
    use glam::DVec3;

    fn tree(x: f64, y: f64, height_m: f32) -> TrueTree {
        TrueTree {
            x,
            y,
            z: 0.0,
            height_m,
            crown_diameter_m: 4.0,
            crown_base_height_m: 3.0,
            stem_diameter_m: 0.2,
            species: 0,
        }
    }

    fn stand(trees: Vec<TrueTree>) -> Stand {
        Stand {
            frame: Frame::local(DVec3::ZERO),
            side_m: 10.0,
            relief: Relief::flat(5.0),
            trees,
            species: vec!["Abies alba".into()],
            shapes: Vec::new(),
            looks: Vec::new(),
        }
    }

    fn found(x: f64, y: f64, height_m: f32, species: &str) -> FoundTree {
        FoundTree { x, y, height_m, crown_diameter_m: 5.0, species: species.into() }
    }

    #[test]
    fn matches_misses_and_inventions_are_counted() {
        let stand = stand(vec![tree(1.0, 1.0, 10.0), tree(5.0, 5.0, 12.0), tree(9.0, 9.0, 8.0)]);
        let found = [
            found(5.3, 5.4, 13.0, "Abies alba"),
            found(1.0, 1.0, 10.0, "Quercus"),
            found(5.0, 9.0, 10.0, "Abies alba"),
        ];
        let c = compare(&stand, &found, &Window::ALL, |_, _| 5.1);
        assert_eq!((c.matched, c.missed, c.invented), (2, 1, 1));
        assert!((c.position_rmse_m - (0.25f64 / 2.0).sqrt()).abs() < 1e-9);
        assert!((c.height.bias_m - 0.5).abs() < 1e-6);
        assert!((c.crown_diameter.bias_m - 1.0).abs() < 1e-6);
        assert!((c.terrain.bias_m - 0.1).abs() < 1e-9 && (c.terrain.rmse_m - 0.1).abs() < 1e-9);
        assert_eq!(c.confusion, [[1, 1]]);
        assert_eq!(c.species_accuracy, 0.5);
    }

    #[test]
    fn one_found_tree_matches_one_true_tree() {
        let stand = stand(vec![tree(1.0, 1.0, 10.0), tree(1.5, 1.0, 10.0)]);
        let c = compare(&stand, &[found(1.4, 1.0, 10.0, "")], &Window::ALL, |_, _| 5.0);
        assert_eq!((c.matched, c.missed, c.invented), (1, 1, 0));
        assert!((c.position_rmse_m - 0.1).abs() < 1e-9);
        assert_eq!(compare(&stand, &[], &Window::ALL, |_, _| 5.0).f1, 0.0);
    }

    /// A tree found within may stand without.
    #[test]
    fn what_nobody_looked_at_is_not_missed() {
        let stand = stand(vec![tree(1.0, 1.0, 10.0), tree(4.9, 5.0, 12.0), tree(9.0, 9.0, 8.0)]);
        let within = Window { low: DVec2::splat(5.0), high: DVec2::splat(10.0) };
        let found = [found(5.1, 5.0, 12.0, "")];
        let is_within = |x: f64, y: f64| x > 5.0 && y > 5.0;
        let c = compare(&stand, &found, &within, |x, y| if is_within(x, y) { 5.1 } else { 0.0 });
        assert_eq!((c.trees, c.matched, c.missed, c.invented), (2, 1, 1, 0));
        assert!((c.terrain.rmse_m - 0.1).abs() < 1e-9, "{}", c.terrain.rmse_m);
    }
}
