//! Where one bark gives way to another within a facet: the line between them, from a field that is
//! known at the facet's corners. Facets that share an edge meet in the same point of it.

use std::sync::OnceLock;

use glam::Vec2;

/// The line stays this far from corners, as a share of an edge: no slivers.
const MARGIN: f32 = 0.1;

/// A corner of a part: one of the facet's (counter-clockwise from the lower left), or a place on
/// one of its edges, as a share of the way between the edge's [`ENDS`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Spot {
    Corner(usize),
    Edge(usize, f32),
}

/// The ends of the edges, low, right, high, left: to the right, and upwards, on both sides of each.
pub const ENDS: [[usize; 2]; 4] = [[0, 1], [1, 2], [3, 2], [0, 3]];

/// Corners and edges in one row.
type Code = u8;

impl Spot {
    fn of(code: Code, field: &[f32; 4]) -> Spot {
        let Some(edge) = usize::from(code).checked_sub(4) else {
            return Spot::Corner(usize::from(code));
        };
        let [a, b] = ENDS[edge].map(|c| field[c]);
        Spot::Edge(edge, (a / (a - b)).clamp(MARGIN, 1.0 - MARGIN))
    }
}

/// Cuts a facet: gives triangles, counter-clockwise, each with whether the field is above 0 there.
/// `may_cut`: which edges may have corners of their own; elsewhere the line ends in a corner.
pub fn cut(field: [f32; 4], may_cut: [bool; 4], mut triangle: impl FnMut(bool, [Spot; 3])) {
    /// Of every case, once it is met.
    static CUTS: [OnceLock<Triangles>; 512] = [const { OnceLock::new() }; 512];
    let bit = |is: bool, k: usize| usize::from(is) << k;
    let case = (0..4).map(|k| bit(field[k] >= 0.0, k) | bit(may_cut[k], k + 4)).sum::<usize>()
        | bit(field.iter().sum::<f32>() >= 0.0, 8);
    for &(is_above, codes) in CUTS[case].get_or_init(|| triangles(case)) {
        triangle(is_above, codes.map(|code| Spot::of(code, &field)));
    }
}

/// The triangles of a facet, and whether the field is above 0 in each.
type Triangles = Vec<(bool, [Code; 3])>;

/// On which side of the line: below 0, on it, above.
type Side = i8;

/// The triangles of a case: which corners are above 0, which edges may be cut, whether the mean is
/// above 0.
fn triangles(case: usize) -> Triangles {
    let is = |k: usize| case >> k & 1 == 1;
    let is_above = [0, 1, 2, 3].map(is);
    let mut out = Vec::new();
    if is_above == [is_above[0]; 4] {
        return [[0, 1, 2], [0, 2, 3]].map(|t| (is_above[0], t)).to_vec();
    }
    let may_cut = [4, 5, 6, 7].map(is);
    let mut side: [Side; 4] = is_above.map(|a| if a { 1 } else { -1 });
    let turns = |k: usize| is_above[k] != is_above[(k + 1) % 4];
    for k in (0..4).filter(|&k| turns(k) && !may_cut[k]) {
        side[if is_above[k] { k } else { (k + 1) % 4 }] = 0;
    }
    let mut ring = Vec::new();
    for k in 0..4 {
        ring.push((k as Code, side[k]));
        if turns(k) && may_cut[k] {
            ring.push((k as Code + 4, 0));
        }
    }
    let has = |s: Side| ring.iter().any(|p| p.1 == s);
    // The corners off the line on one side are cut off, each run with what bounds it; the rest is
    // the other side.
    let off: Side = match (has(1), has(-1)) {
        (true, true) if is(8) => -1,
        (true, true) => 1,
        (above, _) => {
            fan(&ring, above, &mut out);
            return out;
        }
    };
    let rest: Vec<_> = ring.iter().filter(|p| p.1 != off).copied().collect();
    fan(&rest, off < 0, &mut out);
    let at = |k: usize| ring[k % ring.len()];
    for start in (0..ring.len()).filter(|&k| at(k).1 == off && at(k + ring.len() - 1).1 != off) {
        let end = (start..).find(|&k| at(k).1 != off).unwrap_or(start);
        let part: Vec<_> = (start + ring.len() - 1..=end + ring.len()).map(at).collect();
        fan(&part, off > 0, &mut out);
    }
    out
}

/// Triangles of a convex polygon, from the corner that makes the smallest of them largest where edges
/// are cut in the middle: some corners lie on a line.
fn fan(ring: &[(Code, Side)], is_above: bool, out: &mut Triangles) {
    const PLACE: [Vec2; 4] = [Vec2::ZERO, Vec2::X, Vec2::ONE, Vec2::Y];
    let place = |code: Code| match usize::from(code) {
        edge @ 4.. => ENDS[edge - 4].map(|c| PLACE[c]).iter().sum::<Vec2>() * 0.5,
        corner => PLACE[corner],
    };
    let n = ring.len();
    let fan = |from: usize| (2..n).map(move |k| [0, k - 1, k].map(|i| ring[(from + i) % n].0));
    let least = |from: usize| {
        let areas = fan(from).map(|t| {
            let [a, b, c] = t.map(place);
            (b - a).perp_dot(c - a)
        });
        areas.fold(f32::INFINITY, f32::min)
    };
    let best = (0..n).reduce(|best, k| if least(k) > least(best) { k } else { best });
    out.extend(best.into_iter().flat_map(fan).map(|t| (is_above, t)));
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    impl Spot {
        fn place(self) -> Vec2 {
            const PLACE: [Vec2; 4] = [Vec2::ZERO, Vec2::X, Vec2::ONE, Vec2::Y];
            match self {
                Spot::Corner(k) => PLACE[k],
                Spot::Edge(e, t) => PLACE[ENDS[e][0]].lerp(PLACE[ENDS[e][1]], t),
            }
        }
    }

    proptest! {
        /// Whatever the field: the parts cover the facet once, keep its corners, and have the points
        /// on its edges that a neighbour's have.
        #[test]
        fn parts_cover_the_facet_and_meet_their_neighbours(
            field in prop::array::uniform4(-1.0f32..1.0),
            may_cut in prop::array::uniform4(any::<bool>()),
        ) {
            let (mut area, mut spots) = (0.0, Vec::new());
            cut(field, may_cut, |_, t| {
                let [a, b, c] = t.map(Spot::place);
                let twice = (b - a).perp_dot(c - a);
                assert!(twice > 0.004, "{t:?}");
                area += 0.5 * twice;
                spots.extend(t);
            });
            prop_assert!((area - 1.0).abs() < 1e-5, "{area}");
            for e in 0..4 {
                let [a, b] = ENDS[e].map(|c| field[c]);
                let is_there = spots.iter().any(|s| matches!(s, Spot::Edge(edge, _) if *edge == e));
                prop_assert_eq!(is_there, may_cut[e] && (a >= 0.0) != (b >= 0.0), "edge {}", e);
                prop_assert!(spots.contains(&Spot::Corner(e)));
            }
        }
    }

    #[test]
    fn both_sides_have_their_corners() {
        let mut above = 0.0;
        let mut sum = |field, may_cut| {
            above = 0.0;
            cut(field, may_cut, |is_above, t| {
                let [a, b, c] = t.map(Spot::place);
                above += if is_above { 0.5 * (b - a).perp_dot(c - a) } else { 0.0 };
            });
            above
        };
        assert_eq!(sum([1.0; 4], [true; 4]), 1.0);
        assert_eq!(sum([-1.0; 4], [true; 4]), 0.0);
        assert!((sum([-1.0, -1.0, 1.0, 1.0], [true; 4]) - 0.5).abs() < 1e-6);
        assert!((sum([3.0, -1.0, -1.0, -1.0], [true; 4]) - 0.5 * 0.75 * 0.75).abs() < 1e-6);
    }
}
