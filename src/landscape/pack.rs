//! Rays from one place side by side, eight at a time, over all columns that are lower than they are:
//! processors step them at once.

use super::Landscape;
use super::dag::SIDE;
use super::trace::Ray;
use super::walk::{Begin, COARSE, Columns, LEAST, Way, greater, lesser, whole};

/// Rays side by side.
pub(super) const LANES: usize = 8;
type Lanes = [f64; LANES];

/// Columns that are passed over at most; who is over more of them steps on alone.
const MOST_STEPS: usize = 24;

/// All bits where something holds.
#[inline(always)]
fn mask(holds: bool) -> u64 {
    u64::from(holds).wrapping_neg()
}

#[inline(always)]
fn kept(value: f64, mask: u64) -> f64 {
    f64::from_bits(value.to_bits() & mask)
}

#[inline(always)]
fn pick(mask: u64, yes: f64, no: f64) -> f64 {
    f64::from_bits(yes.to_bits() & mask | no.to_bits() & !mask)
}

/// Rays and how far they have come.
pub(super) struct Pack {
    d: [Lanes; 3],
    inverse: [Lanes; 3],
    t: Lanes,
    end: Lanes,
    x: Lanes,
    y: Lanes,
    place: [u32; LANES],
    /// All bits of rays that have passed over columns, and of those that pass by everything.
    over: [u64; LANES],
    past: [u64; LANES],
}

impl Pack {
    /// `rays` have one origin.
    #[inline(always)]
    pub fn new(scene: &Landscape, rays: &[Ray; LANES]) -> Pack {
        let blocks = &scene.blocks;
        let reach = scene.reach().map(|side| f64::from(side as i32));
        let side = f64::from(COARSE);
        let o = rays[0].origin.to_array();
        let zeros = [0.0; LANES];
        let (mut d, mut inverse) = ([zeros; 3], [zeros; 3]);
        let (mut t, mut end) = (zeros, [f64::INFINITY; LANES]);
        for a in 0..3 {
            for l in 0..LANES {
                let part = rays[l].direction[a];
                d[a][l] = pick(mask(part.abs() < LEAST), LEAST, part);
                inverse[a][l] = 1.0 / d[a][l];
                let (low, high) = (-o[a] * inverse[a][l], (reach[a] - o[a]) * inverse[a][l]);
                t[l] = greater(t[l], lesser(low, high));
                end[l] = lesser(end[l], greater(low, high));
            }
        }
        let (mut x, mut y) = (zeros, zeros);
        let (mut goes, mut over, mut past) = ([0u64; LANES], [0u64; LANES], [0u64; LANES]);
        let mut place = [0u32; LANES];
        let last = [blocks.sides[0], blocks.sides[1]].map(|blocks| blocks * SIDE - 1);
        for l in 0..LANES {
            let is_within = mask(t[l] <= end[l]);
            past[l] = !is_within;
            let at = |a: usize| {
                let number = whole((o[a] + d[a][l] * t[l]) * (1.0 / side)).min(last[a]);
                let face = f64::from((number + u32::from(d[a][l] > 0.0)) as i32) * side;
                (number, (face - o[a]) * inverse[a][l])
            };
            let ((col, next_x), (row, next_y)) = (at(0), at(1));
            place[l] = blocks.place([col, row]) as u32;
            (x[l], y[l]) = (next_x, next_y);
            // Those that rise, or enter where they may be below the surface, are told singly.
            let enters = o[2] + d[2][l] * t[l];
            let is_over = mask(t[l] <= 0.0) | mask(enters >= reach[2] - 1e-6);
            goes[l] = mask(d[2][l] < 0.0) & is_within;
            over[l] = goes[l] & is_over;
        }
        let row = blocks.row() as u32;
        for _ in 0..MOST_STEPS {
            let mut top = zeros;
            for l in 0..LANES {
                top[l] = f64::from(i32::from(blocks.over(place[l] as usize)) * SIDE as i32);
            }
            let mut any = 0;
            for l in 0..LANES {
                let out = greater(lesser(lesser(x[l], y[l]), end[l]), t[l]);
                let passes = (top[l] - o[2]) * inverse[2][l];
                let is_under = mask(greater(t[l], passes) <= out);
                let is_last = mask(out >= end[l]);
                let goes_on = goes[l] & !is_under & !is_last;
                past[l] |= goes[l] & !is_under & is_last;
                over[l] |= goes_on;
                t[l] = pick(goes_on, out, t[l]);
                let is_x = mask(x[l] <= y[l]);
                let (step_x, step_y) = (side * inverse[0][l].abs(), side * inverse[1][l].abs());
                x[l] += kept(step_x, is_x & goes_on);
                y[l] += kept(step_y, !is_x & goes_on);
                let one = |a: usize, by: u32| if d[a][l] > 0.0 { by } else { by.wrapping_neg() };
                let by = one(0, 1) & is_x as u32 | one(1, row) & !is_x as u32;
                place[l] = place[l].wrapping_add(by & goes_on as u32);
                goes[l] = goes_on;
                any |= goes_on;
            }
            if any == 0 {
                break;
            }
        }
        Pack { d, inverse, t, end, x, y, place, over, past }
    }

    /// Whether a ray meets nothing at all.
    #[inline(always)]
    pub fn is_past(&self, lane: usize) -> bool {
        self.past[lane] != 0
    }

    /// How a ray goes on, if it has passed over columns.
    #[inline(always)]
    pub fn begin(&self, lane: usize, ray: &Ray) -> Option<(Way, Begin)> {
        let of = |lanes: &[Lanes; 3]| [lanes[0][lane], lanes[1][lane], lanes[2][lane]];
        let begin = Begin {
            span: [self.t[lane], self.end[lane]],
            columns: Columns { place: self.place[lane] as usize, x: self.x[lane], y: self.y[lane] },
        };
        (self.over[lane] != 0).then(|| (Way::of(ray, of(&self.d), of(&self.inverse)), begin))
    }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use crate::landscape::tests::Made;
    use crate::landscape::trace::{Ray, Tracer};
    use crate::seed::Seed;

    use super::LANES;

    #[test]
    fn rays_side_by_side_meet_what_each_meets_alone() {
        let mut draws = Seed::new(31).draws();
        let (mut met, mut past) = (0, 0);
        for seed in 0..4 {
            let scene = Made::wood(150, 400, seed).built();
            let mut tracer = Tracer::new(&scene);
            for round in 0..400 {
                // From without, from within, and level with the cut faces.
                let from = [-90.0, 10.0][round % 2];
                let mut place = |low: f32, high: f32| f64::from(draws.between(low, high));
                let origin = DVec3::new(place(from, 240.0), place(from, 240.0), place(1.0, 120.0));
                let rays: [Ray; LANES] = std::array::from_fn(|_| {
                    let target =
                        DVec3::new(place(0.0, 150.0), place(0.0, 150.0), place(-9.0, 40.0));
                    Ray { origin, direction: target - origin, breadth: [0.0, 0.4] }
                });
                let all = tracer.trace_all(&rays);
                for (ray, hit) in rays.iter().zip(all) {
                    let alone = tracer.trace(ray, 0.0, f64::INFINITY);
                    let what = |hit: Option<_>| hit.map(|h: crate::landscape::trace::Hit| h.what);
                    assert_eq!(what(hit), what(alone), "{ray:?}");
                    if let (Some(hit), Some(alone)) = (hit, alone) {
                        assert!((hit.t - alone.t).abs() < 1e-6, "{ray:?}");
                        met += 1;
                    } else {
                        past += 1;
                    }
                }
            }
        }
        assert!(met > 1000 && past > 1000, "{met} met, {past} past");
    }
}
