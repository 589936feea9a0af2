//! Twigs leaf by leaf, made once in a few forms and set at all their places.
//!
//! What tells one twig from another is which way it hangs and how large it is: it is built in the
//! forms of a small table, over the direction of gravity in its own frame, the fall of its tip and
//! its size, and each place takes the form nearest to its own, turned and scaled to fit exactly.
//! Forms that no place takes are not built. Departures from a build at every place: leaves sink up
//! to 20 degrees off the plumb line, and are up to an eighth larger or smaller than they would be.
//! Where each form is stored but once, the few are taken that are nearest to all places (greedy
//! k-medians): more of both, and normals are the twig's own.

use glam::{Mat3A, Quat, Vec2, Vec3, Vec3A};
use rayon::prelude::*;

use super::Surface;
use super::leaf::Twig;
use super::piece::{LEAST_COSINE, Piece, fill};
use super::spot::{GOLDEN_RAD, Pose, SAG, Spot};
use super::twigs::{Place, Twigs};
use super::wind::Wind;
use crate::seed::Seed;

/// Directions of gravity in a twig's frame, evenly over the sphere: 25 degrees apart.
const DOWNS: usize = 64;
/// Steps of the fall of tips that hang.
const SAGS: usize = 3;
/// A size over the next smaller one.
const LARGER: f32 = 1.25;
/// A turn off the plumb line that counts as one step.
const UNLIKE_RAD: f32 = 0.35;

/// One twig of unit length at the origin, along x, its upper side to y.
struct Form {
    position: Vec<Vec3A>,
    normal: Vec<Vec3A>,
    uv: Vec<Vec2>,
    index: Vec<u32>,
    /// Corners of the triangles from which bent normals may look away.
    strays: Vec<u32>,
}

/// Which form a twig takes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct Kind {
    down: usize,
    /// Step of the fall, from 1 on; 0 for twigs that stand.
    sag: usize,
    /// Steps from a metre.
    size: i32,
}

impl Kind {
    fn of(pose: &Pose, downs: &[Vec3A; DOWNS]) -> Kind {
        let down = frame(pose).transpose() * Vec3A::NEG_Z;
        let mut nearest = (0, f32::NEG_INFINITY);
        for (k, d) in downs.iter().enumerate() {
            let along = d.dot(down);
            if along > nearest.1 {
                nearest = (k, along);
            }
        }
        let share = (pose.sag - SAG[0]) / (SAG[1] - SAG[0]);
        let step = (share * SAGS as f32).clamp(0.0, SAGS as f32 - 1.0) as usize;
        let sag = if pose.sag > 0.0 { 1 + step } else { 0 };
        let size = (pose.size_m.max(1e-6).ln() / LARGER.ln()).round() as i32;
        Kind { down: nearest.0, sag, size }
    }

    fn size_m(self) -> f32 {
        LARGER.powi(self.size)
    }

    /// How ill a form of another kind serves for one of this: squares of how far leaves hang off the plumb
    /// line, of steps of fall and of steps of size.
    fn unlike(self, other: Kind, downs: &[Vec3A; DOWNS]) -> f32 {
        let cosine = downs[self.down].dot(downs[other.down]).clamp(-1.0, 1.0);
        let turns = cosine.acos() / UNLIKE_RAD;
        let [sag, size] =
            [self.sag.abs_diff(other.sag) as f32, self.size.abs_diff(other.size) as f32];
        turns * turns + sag * sag + size * size
    }

    fn build(self, twig: &Twig, down: Vec3A, seed: Seed) -> Form {
        // The twig's own frame as it stands where gravity is -z.
        let stand = Quat::from_rotation_arc(Vec3::from(down), Vec3::NEG_Z);
        let size_m = self.size_m();
        let share = (self.sag as f32 - 0.5) / SAGS as f32;
        let facing = stand * Vec3::Y;
        let pose = Pose {
            base: Vec3::ZERO,
            heading: stand * Vec3::X,
            facing,
            size_m,
            sag: if self.sag > 0 { SAG[0] + share * (SAG[1] - SAG[0]) } else { 0.0 },
            mirrored: false,
            outward: facing,
            crown: Vec3::ZERO,
            is_plain: true,
        };
        let key = (self.down * (SAGS + 1) + self.sag) as u64;
        let seed = seed.derive("form", key << 32 | u64::from(self.size as u32));
        let emit = |_, out: &mut Piece| twig.emit(&pose, &mut seed.draws(), out);
        let made = fill(1, twig.room(), emit, None);
        let back = Mat3A::from_quat(stand.inverse());
        let per_m = size_m.recip();
        Form {
            strays: strays(&made, twig.bent()),
            position: made.position.iter().map(|p| back * Vec3A::from(*p) * per_m).collect(),
            normal: made.normal.iter().map(|n| back * Vec3A::from(*n)).collect(),
            uv: made.uv,
            index: made.index,
        }
    }
}

impl Form {
    fn surface(self, size_m: f32) -> Surface {
        Surface {
            position: self.position.into_iter().map(|p| Vec3::from(p * size_m)).collect(),
            normal: self.normal.into_iter().map(|n| Vec3::from(n).normalize_or(Vec3::Z)).collect(),
            uv: self.uv,
            index: self.index,
            ..Surface::default()
        }
    }
}

/// Corners of the triangles from whose front a normal may look away once a share of it is of the crown's
/// outside, whichever way that is.
///
/// A normal n at an angle θ to the front f becomes (1 − b) n + l − 2 n min(0, n · l), where |l| ≤ b (see
/// [`bend`]). Its product with f is least, (1 − b) cos θ − b sin θ, where l is at right angles to n and away
/// from f: of an l that looks into the crown the third term makes up for more than the second takes. It is no
/// longer than 1 + 2 b.
fn strays(made: &Surface, bent: f32) -> Vec<u32> {
    /// More than rounding does.
    const ROUNDING: f32 = 0.01;
    let least = LEAST_COSINE * (1.0 + 2.0 * bent) + ROUNDING;
    let may_stray = |t: &&[u32; 3]| {
        let corners = t.map(|i| i as usize);
        let [a, b, c] = corners.map(|i| Vec3A::from(made.position[i]));
        let front = (b - a).cross(c - a).normalize_or_zero();
        let is_sure = |i: usize| {
            let cosine = front.dot(made.normal[i].into());
            (1.0 - bent) * cosine - bent * (1.0 - cosine * cosine).max(0.0).sqrt() > least
        };
        !corners.into_iter().all(is_sure)
    };
    let triangles = made.index.as_chunks::<3>().0;
    triangles.iter().filter(may_stray).copied().flatten().collect()
}

/// Heading, upper side, and what is at right angles to both.
fn frame(pose: &Pose) -> Mat3A {
    Mat3A::from_cols(
        pose.heading.into(),
        pose.facing.into(),
        pose.heading.cross(pose.facing).into(),
    )
}

/// Directions on a spiral from pole to pole.
fn downs() -> [Vec3A; DOWNS] {
    std::array::from_fn(|k| {
        let up = 1.0 - (2 * k + 1) as f32 / DOWNS as f32;
        let (sin, cos) = (k as f32 * GOLDEN_RAD).sin_cos();
        let level = (1.0 - up * up).max(0.0).sqrt();
        Vec3A::new(level * cos, up, level * sin)
    })
}

/// That of every pose, and all that occur.
fn kinds(poses: &[Pose], downs: &[Vec3A; DOWNS]) -> (Vec<Kind>, Vec<Kind>) {
    let kind = |pose: &Pose| Kind::of(pose, downs);
    let kinds: Vec<Kind> = poses.par_iter().with_min_len(256).map(kind).collect();
    let mut used = kinds.clone();
    used.par_sort_unstable();
    used.dedup();
    (kinds, used)
}

/// A twig at every pose, of `most` forms at most, each of them stored once.
pub fn gather(twig: &Twig, poses: &[Pose], most: usize, seed: Seed) -> Vec<Twigs> {
    let downs = downs();
    let (kinds, used) = kinds(poses, &downs);
    let number = |kind: &Kind| used.binary_search(kind).unwrap_or(0);
    let mut count = vec![0.0f32; used.len()];
    kinds.iter().for_each(|kind| count[number(kind)] += 1.0);
    let chosen = medians(&used, &count, most, &downs);
    let build = |kind: &Kind| Twigs {
        form: kind.build(twig, downs[kind.down], seed).surface(kind.size_m()),
        places: Vec::new(),
    };
    let kinds_of: Vec<Kind> = chosen.kinds.iter().map(|k| used[*k]).collect();
    let mut out: Vec<Twigs> = kinds_of.par_iter().map(build).collect();
    for (kind, pose) in kinds.iter().zip(poses) {
        let form = chosen.of[number(kind)];
        out[form].places.push(Place {
            position: pose.base,
            turn: Quat::from_mat3a(&frame(pose)).normalize(),
            scale: pose.size_m / kinds_of[form].size_m(),
        });
    }
    out
}

/// Some of the kinds that occur, and which of those serves each of them.
struct Medians {
    kinds: Vec<usize>,
    of: Vec<usize>,
}

/// Chosen one by one, each that which brings all the others nearest to one of them.
fn medians(used: &[Kind], count: &[f32], most: usize, downs: &[Vec3A; DOWNS]) -> Medians {
    /// Farther than any kinds are apart.
    const FAR: f32 = 1e6;
    let mut out = Medians { kinds: Vec::new(), of: vec![0; used.len()] };
    let mut apart = vec![FAR; used.len()];
    while out.kinds.len() < most.max(1) {
        let gain = |&candidate: &usize| -> f32 {
            let nearer = |k: usize| (apart[k] - used[candidate].unlike(used[k], downs)).max(0.0);
            (0..used.len()).map(|k| count[k] * nearer(k)).sum()
        };
        let gains: Vec<f32> = (0..used.len()).into_par_iter().map(|k| gain(&k)).collect();
        // The first of the best.
        let best = (0..used.len()).rev().max_by(|a, b| gains[*a].total_cmp(&gains[*b]));
        let Some(best) = best.filter(|k| gains[*k] > 0.0) else { break };
        for (k, nearest) in apart.iter_mut().enumerate() {
            let off = used[best].unlike(used[k], downs);
            if off < *nearest {
                (*nearest, out.of[k]) = (off, out.kinds.len());
            }
        }
        out.kinds.push(best);
    }
    out
}

/// A twig at every pose.
pub fn set(twig: &Twig, poses: &[Pose], seed: Seed, wind: Option<(&Wind, &[Spot])>) -> Surface {
    let downs = downs();
    let (kinds, used) = kinds(poses, &downs);
    let build = |kind: &Kind| kind.build(twig, downs[kind.down], seed);
    let forms: Vec<Form> = used.par_iter().map(build).collect();
    let bent = twig.bent();
    let emit = |k: usize, out: &mut Piece| {
        if let Ok(form) = used.binary_search(&kinds[k]) {
            place(&forms[form], &poses[k], bent, out);
        }
    };
    fill(poses.len(), twig.room(), emit, wind)
}

/// A unit normal, a share of which is of the crown's outside: `lean`, no longer than that share.
#[inline]
fn bend(normal: Vec3A, lean: Vec3A, share: f32) -> Vec3A {
    // Of a side that looks into the crown, the light is that of its back.
    let n = normal * (1.0 - share) + lean - normal * (2.0 * normal.dot(lean).min(0.0));
    n * n.length_squared().max(1e-12).sqrt().recip()
}

fn place(form: &Form, pose: &Pose, bent: f32, out: &mut Piece) {
    let turn = frame(pose);
    let scaled = turn * pose.size_m;
    let base = Vec3A::from(pose.base);
    // All of a twig lies one way from the crown's middle.
    let middle = pose.base + pose.heading * (0.5 * pose.size_m);
    let lean = pose.out_at(middle.into()) * bent;
    let vertex = |(p, n): (&Vec3A, &Vec3A)| {
        let n = bend(turn * *n, lean, bent);
        (Vec3::from(base + scaled * *p), Vec3::from(n))
    };
    out.copy(form.position.iter().zip(&form.normal).map(vertex), &form.uv, &form.index);
    out.straighten(&form.strays);
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Few forms serve many places; as many as there are kinds serve each with its own.
    #[test]
    fn forms_that_are_chosen_are_near_to_all() {
        let downs = downs();
        let mut draws = Seed::new(2).draws();
        let mut used: Vec<Kind> = (0..400)
            .map(|_| Kind {
                down: draws.index(DOWNS),
                sag: draws.index(3),
                size: draws.index(3) as i32,
            })
            .collect();
        used.sort_unstable();
        used.dedup();
        let count: Vec<f32> = used.iter().map(|_| draws.between(1.0, 50.0)).collect();
        let off =
            |most: usize| {
                let chosen = medians(&used, &count, most, &downs);
                assert!(chosen.kinds.len() <= most.max(1));
                let each = used.iter().zip(&count).zip(&chosen.of);
                let unlike =
                    each.map(|((kind, count), of)| {
                        let of = used[chosen.kinds[*of]];
                        assert!(chosen.kinds.iter().all(|k| {
                            used[*k].unlike(*kind, &downs) >= of.unlike(*kind, &downs)
                        }));
                        count * of.unlike(*kind, &downs)
                    });
                unlike.sum::<f32>() / count.iter().sum::<f32>()
            };
        let mean: Vec<f32> = [0, 8, 48, 400].into_iter().map(off).collect();
        assert!(mean.is_sorted_by(|a, b| b < a), "{mean:?}");
        assert!(mean[2] < 2.0 && mean[3] < 1e-3, "{mean:?}");
    }

    /// Normals of all but a form's strays face with their triangles, however they are bent.
    #[test]
    fn what_is_no_stray_never_strays() {
        let mut draws = Seed::new(3).draws();
        for name in ["larix_sibirica", "picea_abies", "pinus_sylvestris", "quercus_robur"] {
            let species = crate::species::load(name).unwrap();
            let atlas = crate::texture::tests::leafy(&species, 64, Seed::new(1)).atlas;
            for budget in [usize::MAX, 200_000] {
                let twig = Twig::new(&species.foliage, &atlas, [2_000; 2], 150.0, budget);
                let kind = Kind { down: 7, sag: 1, size: -6 };
                let form = kind.build(&twig, downs()[7], Seed::new(1));
                let all = form.index.as_chunks::<3>().0;
                let strays = form.strays.as_chunks::<3>().0;
                let sure: Vec<_> = all.iter().filter(|t| !strays.contains(t)).collect();
                let bent = twig.bent();
                let mut least = 1.0f32;
                for _ in 0..200 {
                    let mut lean = Vec3A::from(draws.direction()) * bent;
                    if draws.unit() < 0.5 {
                        // What is worst lies along a triangle.
                        let t = sure[draws.index(sure.len())].map(|i| i as usize);
                        lean = (form.position[t[1]] - form.position[t[0]]).normalize() * bent;
                    }
                    for t in &sure {
                        let corners = t.map(|i| i as usize);
                        let [a, b, c] = corners.map(|i| form.position[i]);
                        let front = (b - a).cross(c - a).normalize();
                        for i in corners {
                            least = least.min(front.dot(bend(form.normal[i], lean, bent)));
                        }
                    }
                }
                assert!(least > LEAST_COSINE, "{name}: {least}");
                assert!(least < 0.5, "{name}: no lean came near the least, {least}");
                assert!(2 * strays.len() < all.len(), "{name}: {} of {}", strays.len(), all.len());
            }
        }
    }

    #[test]
    fn downs_leave_no_way_far_from_all_of_them() {
        let downs = downs();
        let mut draws = Seed::new(1).draws();
        let farthest = (0..20_000)
            .map(|_| {
                let way = Vec3A::from(draws.direction());
                downs.iter().map(|d| d.dot(way)).fold(-1.0, f32::max)
            })
            .fold(1.0, f32::min);
        assert!(farthest > 20f32.to_radians().cos(), "{}", farthest.acos().to_degrees());
        assert!(downs.iter().all(|d| (d.length() - 1.0).abs() < 1e-5));
    }
}
