//! Where one bark gives way to another within a facet: the line between them, from a field that is
//! known at the facet's corners. Facets that share an edge meet in the same point of it.

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
const PLACE: [Vec2; 4] = [Vec2::ZERO, Vec2::X, Vec2::ONE, Vec2::Y];

impl Spot {
    fn place(self) -> Vec2 {
        match self {
            Spot::Corner(k) => PLACE[k],
            Spot::Edge(e, t) => PLACE[ENDS[e][0]].lerp(PLACE[ENDS[e][1]], t),
        }
    }
}

/// On which side of the line: below 0, on it, above.
type Side = i8;

/// A polygon of few corners, and where they are within the facet.
#[derive(Clone, Copy)]
struct Ring {
    spot: [(Spot, Side, Vec2); 8],
    len: usize,
}

impl Ring {
    fn new() -> Ring {
        Ring { spot: [(Spot::Corner(0), 0, Vec2::ZERO); 8], len: 0 }
    }

    fn push(&mut self, spot: (Spot, Side, Vec2)) {
        self.spot[self.len] = spot;
        self.len += 1;
    }

    fn all(&self) -> &[(Spot, Side, Vec2)] {
        &self.spot[..self.len]
    }
}

/// Cuts a facet: gives triangles, counter-clockwise, each with whether the field is above 0 there.
/// `may_cut`: which edges may have corners of their own; elsewhere the line ends in a corner.
pub fn cut(field: [f32; 4], may_cut: [bool; 4], mut triangle: impl FnMut(bool, [Spot; 3])) {
    let is_above = field.map(|f| f >= 0.0);
    if is_above == [is_above[0]; 4] {
        triangle(is_above[0], [0, 1, 2].map(Spot::Corner));
        triangle(is_above[0], [0, 2, 3].map(Spot::Corner));
        return;
    }
    let mut side: [Side; 4] = is_above.map(|a| if a { 1 } else { -1 });
    let turns = |k: usize| is_above[k] != is_above[(k + 1) % 4];
    for k in (0..4).filter(|&k| turns(k) && !may_cut[k]) {
        side[if is_above[k] { k } else { (k + 1) % 4 }] = 0;
    }
    let mut ring = Ring::new();
    let mut push = |spot: Spot, side: Side| ring.push((spot, side, spot.place()));
    for k in 0..4 {
        push(Spot::Corner(k), side[k]);
        if turns(k) && may_cut[k] {
            let [a, b] = ENDS[k].map(|c| field[c]);
            push(Spot::Edge(k, (a / (a - b)).clamp(MARGIN, 1.0 - MARGIN)), 0);
        }
    }
    let has = |s: Side| ring.all().iter().any(|p| p.1 == s);
    let mean: f32 = field.iter().sum();
    // The corners off the line on one side are cut off, each run with what bounds it; the rest is
    // the other side.
    let off: Side = match (has(1), has(-1)) {
        (true, true) if mean >= 0.0 => -1,
        (true, true) => 1,
        (above, _) => return fan(&ring, above, &mut triangle),
    };
    let mut rest = Ring::new();
    ring.all().iter().filter(|p| p.1 != off).for_each(|&p| rest.push(p));
    fan(&rest, off < 0, &mut triangle);
    let at = |k: usize| ring.spot[k % ring.len];
    for start in (0..ring.len).filter(|&k| at(k).1 == off && at(k + ring.len - 1).1 != off) {
        let mut part = Ring::new();
        part.push(at(start + ring.len - 1));
        let mut k = start;
        while at(k).1 == off {
            part.push(at(k));
            k += 1;
        }
        part.push(at(k));
        fan(&part, off > 0, &mut triangle);
    }
}

/// Triangles of a convex polygon, from the corner that makes the smallest of them largest: some
/// corners lie on a line.
fn fan(ring: &Ring, is_above: bool, triangle: &mut impl FnMut(bool, [Spot; 3])) {
    let n = ring.len;
    if n < 3 {
        return;
    }
    let wrapped = |i: usize| &ring.spot[if i < n { i } else { i - n }];
    let least = |from: usize| {
        let a = ring.spot[from].2;
        let mut edge = wrapped(from + 1).2 - a;
        let mut least = f32::INFINITY;
        for k in 2..n {
            let next = wrapped(from + k).2 - a;
            least = least.min(edge.perp_dot(next));
            edge = next;
        }
        least
    };
    let (mut from, mut largest) = (0, f32::NEG_INFINITY);
    if n > 3 {
        // From opposite corners four are cut alike.
        for k in 0..if n == 4 { 2 } else { n } {
            let least = least(k);
            if least > largest {
                (from, largest) = (k, least);
            }
        }
    }
    for k in 2..n {
        triangle(is_above, [from, from + k - 1, from + k].map(|i| wrapped(i).0));
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

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
