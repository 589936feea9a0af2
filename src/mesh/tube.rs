//! Rings to triangles: one closed tube an axis, P18's truncated cones with shared rings.
//!
//! The rings' circles come from tables, so a vertex costs no trigonometry. A ring of N sides has
//! N + 1 vertices: the first and the last lie in one place and part the texture.
//! Where old bark gives way to young bark, facets of both mix and their rings are in both
//! surfaces; together the two are closed.

use glam::Vec2;

use super::Surface;
use super::path::{MAX_SIDES, Ring};
use crate::seed::Draws;

/// Cosines and sines of the corners of every ring.
pub struct Circles(Vec<Vec<Vec2>>);

impl Circles {
    pub fn new() -> Self {
        Circles(
            (0..=MAX_SIDES)
                .map(|n| {
                    (0..=n)
                        .map(|k| {
                            // The last corner is the first, to the bit.
                            let turn = (k % n.max(1)) as f32 / n.max(1) as f32;
                            let (s, c) = (turn * std::f32::consts::TAU).sin_cos();
                            Vec2::new(c, s)
                        })
                        .collect()
                })
                .collect(),
        )
    }

    fn of(&self, sides: u32) -> &[Vec2] {
        &self.0[sides.min(MAX_SIDES) as usize]
    }
}

/// Triangles and vertices that [`tube`] makes of these rings.
pub fn count(rings: &[Ring]) -> (usize, usize) {
    let n = rings.len();
    if n < 2 {
        return (0, 0);
    }
    let bands: usize = rings[..n - 1].windows(2).map(|w| (w[0].sides + w[1].sides) as usize).sum();
    let triangles = bands + rings[0].sides as usize - 2 + rings[n - 2].sides as usize;
    let vertices = rings[..n - 1].iter().map(|r| r.sides as usize + 1).sum::<usize>() + 1;
    (triangles, vertices)
}

/// Where a tube goes: old bark and young bark.
pub struct Barks<'a> {
    pub surface: [&'a mut Surface; 2],
    /// Share of young bark at a ring; between 0 and 1 the facets mix.
    pub young: &'a dyn Fn(&Ring) -> f32,
    /// Draws for that mixing, and the phase of buttresses.
    pub draws: Draws,
    /// Metres a tile of bark.
    pub repeat_m: f32,
}

/// Appends the tube of one axis; the last ring is the apex.
pub fn tube(rings: &[Ring], circles: &Circles, barks: &mut Barks) {
    let n = rings.len();
    if n < 2 {
        return;
    }
    // Whole tiles around, by the mean girth, so that the bark closes on itself.
    let girth = rings[..n - 1].iter().map(|r| r.radius_m).sum::<f32>() / (n - 1) as f32
        * std::f32::consts::TAU;
    let repeats = (girth / barks.repeat_m).round().clamp(1.0, 1024.0);
    let phase = barks.draws.between(0.0, std::f32::consts::TAU);
    let repeat_m = barks.repeat_m;
    // Where the corners of the last ring start in each surface, once they are there.
    let mut below = [None; 2];
    for i in 0..n - 1 {
        let share = (barks.young)(&rings[i]);
        let mut here = [None; 2];
        let corners_in = |b: usize, i: usize, slot: &mut [Option<u32>; 2], out: &mut Surface| {
            *slot[b].get_or_insert_with(|| {
                let start = out.position.len() as u32;
                let ring = &rings[i];
                corners(ring, circles.of(ring.sides), repeats, repeat_m, phase, out);
                start
            })
        };
        if i == 0 {
            // The base is closed by a fan: it lies inside the parent or below ground.
            let b = usize::from(share >= 0.5);
            let out = &mut *barks.surface[b];
            let first = corners_in(b, 0, &mut here, out);
            for k in 1..rings[0].sides - 1 {
                out.index.extend([first, first + k + 1, first + k]);
            }
        } else {
            let (sides, next) = (rings[i - 1].sides, rings[i].sides);
            if share > 0.0 && share < 1.0 && sides == next {
                for k in 0..sides {
                    let b = usize::from(barks.draws.unit() < share);
                    let out = &mut *barks.surface[b];
                    let p = corners_in(b, i - 1, &mut below, out) + k;
                    let q = corners_in(b, i, &mut here, out) + k;
                    out.index.extend([p, p + 1, q + 1, p, q + 1, q]);
                }
            } else {
                let b = usize::from(share >= 0.5);
                let out = &mut *barks.surface[b];
                let p = corners_in(b, i - 1, &mut below, out);
                let q = corners_in(b, i, &mut here, out);
                band(p, sides, q, next, &mut out.index);
            }
        }
        if i == n - 2 {
            let b = usize::from(share >= 0.5);
            let out = &mut *barks.surface[b];
            let last = corners_in(b, i, &mut here, out);
            let apex = &rings[n - 1];
            let tip = out.position.len() as u32;
            out.position.push(apex.centre);
            out.normal.push(apex.tangent);
            out.uv.push(Vec2::new(0.5 * repeats, apex.arc_m / repeat_m));
            for k in 0..rings[i].sides {
                out.index.extend([last + k, last + k + 1, tip]);
            }
        }
        below = here;
    }
}

fn corners(
    ring: &Ring,
    circle: &[Vec2],
    repeats: f32,
    repeat_m: f32,
    lobe_phase: f32,
    out: &mut Surface,
) {
    let binormal = ring.tangent.cross(ring.normal);
    let lift = 1.0 / (1.0 + ring.slope * ring.slope).sqrt();
    let (flat, rise) = (lift, ring.tangent * (-ring.slope * lift));
    let per_side = repeats / ring.sides as f32;
    let v = ring.arc_m / repeat_m;
    if ring.lobe == 0.0 {
        out.position.extend(
            circle
                .iter()
                .map(|c| ring.centre + (ring.normal * c.x + binormal * c.y) * ring.radius_m),
        );
        out.normal
            .extend(circle.iter().map(|c| (ring.normal * c.x + binormal * c.y) * flat + rise));
    } else {
        // Buttresses: r(θ) = r (1 + lobe · cos(5θ + φ)).
        for (k, c) in circle.iter().enumerate() {
            let turn = (k % ring.sides.max(1) as usize) as f32 / ring.sides as f32;
            let (s5, c5) = (5.0 * turn * std::f32::consts::TAU + lobe_phase).sin_cos();
            let out_dir = ring.normal * c.x + binormal * c.y;
            let around = binormal * c.x - ring.normal * c.y;
            let radius = ring.radius_m * (1.0 + ring.lobe * c5);
            let turned = -5.0 * ring.lobe * s5 / (1.0 + ring.lobe * c5);
            out.position.push(ring.centre + out_dir * radius);
            let normal = (out_dir - around * turned) * flat + rise;
            out.normal.push(normal.normalize_or(out_dir));
        }
    }
    out.uv.extend((0..circle.len()).map(|k| Vec2::new(k as f32 * per_side, v)));
}

/// Joins two rings; where their sides differ, by walking both around in step.
fn band(a: u32, a_sides: u32, b: u32, b_sides: u32, index: &mut Vec<u32>) {
    if a_sides == b_sides {
        index.extend((0..a_sides).flat_map(|k| {
            let (p, q) = (a + k, b + k);
            [p, p + 1, q + 1, p, q + 1, q]
        }));
        return;
    }
    let (mut i, mut j) = (0, 0);
    while i < a_sides || j < b_sides {
        // The ring whose next corner comes first goes on: (i + 1) / a against (j + 1) / b.
        let a_next = j == b_sides || (i < a_sides && (i + 1) * b_sides <= (j + 1) * a_sides);
        if a_next {
            index.extend([a + i, a + i + 1, b + j]);
            i += 1;
        } else {
            index.extend([a + i, b + j + 1, b + j]);
            j += 1;
        }
    }
}
