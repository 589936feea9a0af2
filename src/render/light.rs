//! Sun and sky on surfaces: a shadow map, the share of the sky that each place sees, and haze.
//!
//! Sky visibility is read off a map of heights seen from above: along sixteen slanted directions
//! the length of the path below the canopy's surface dims the light by Beer and Lambert's law, so
//! crowns darken inwards and the ground darkens under them.

use std::sync::LazyLock;

use glam::{Vec2, Vec3};
use rayon::prelude::*;

use super::camera::View;
use super::draw::{Sample, Scratch, Stage};
use super::sky::{BOUNCE_COLOUR, SKY_COLOUR, SUN_COLOUR, haze};

/// Light lost a metre of path below the canopy's surface.
const CANOPY_EXTINCTION_PER_M: f32 = 0.30;
const ROWS: usize = 64;

/// Nearness over the whole grid of an orthographic view.
struct DepthMap {
    view: View,
    nearness: Vec<f32>,
}

impl DepthMap {
    fn draw(stage: &Stage<'_>, view: View, triangle_budget: usize) -> DepthMap {
        let list = stage.list(&view, ROWS, triangle_budget);
        let mut nearness = vec![f32::MIN; view.width * view.height];
        nearness
            .par_chunks_mut(view.width * ROWS)
            .enumerate()
            .for_each_init(Scratch::default, |scratch, (band, samples)| {
                stage.draw_band(&view, &list, band, scratch, samples)
            });
        DepthMap { view, nearness }
    }

    fn at(&self, x: i32, y: i32) -> Option<f32> {
        let inside = x >= 0 && y >= 0 && x < self.view.width as i32 && y < self.view.height as i32;
        inside.then(|| self.nearness[y as usize * self.view.width + x as usize])
    }
}

/// Heights seen from above, with ever coarser means.
struct Canopy {
    view: View,
    levels: Vec<(usize, usize, Vec<f32>)>,
}

impl Canopy {
    fn from_map(map: DepthMap) -> Canopy {
        let top = map.view.eye().z;
        let floor = map.nearness.iter().copied().filter(|&n| n > f32::MIN).fold(f32::MAX, f32::min);
        // Looking straight down, nearness is the height over the eye.
        let heights: Vec<f32> =
            map.nearness.iter().map(|&n| top + if n > f32::MIN { n } else { floor }).collect();
        let mut levels = vec![(map.view.width, map.view.height, heights)];
        while levels.len() < 5 {
            let (w, h, from) = &levels[levels.len() - 1];
            let (nw, nh) = (w / 2, h / 2);
            if nw < 2 || nh < 2 {
                break;
            }
            let mean = |i: usize| {
                let (x, y) = (i % nw * 2, i / nw * 2);
                0.25 * (from[y * w + x]
                    + from[y * w + x + 1]
                    + from[(y + 1) * w + x]
                    + from[(y + 1) * w + x + 1])
            };
            let next = (0..nw * nh).map(mean).collect();
            levels.push((nw, nh, next));
        }
        Canopy { view: map.view, levels }
    }

    fn height(&self, at: Vec2, level: usize) -> Option<f32> {
        let level = level.min(self.levels.len() - 1);
        let (w, h, data) = &self.levels[level];
        let p = at / (1 << level) as f32;
        if p.x < 0.0 || p.y < 0.0 {
            return None;
        }
        let (x, y) = (p.x as usize, p.y as usize);
        (x < *w && y < *h).then(|| data[y * w + x])
    }

    /// Share of the sky seen from a place, by `turn` of 4 interleaved sets of directions.
    fn visibility(&self, p: Vec3, normal: Vec3, turn: u32) -> f32 {
        let v = self.view.view_from_scene(p);
        let at = self.view.project(v).at;
        let (mut seen, mut sum) = (0.0, 0.0);
        for Probe { direction, steps } in &PROBES[turn as usize % PROBES.len()] {
            let cosine = (0.35 + 0.65 * normal.dot(*direction)).max(0.05);
            let mut path = 0.0f32;
            for Step { level, shift, rise } in steps.iter().flatten() {
                if let Some(top) = self.height(at + *shift * self.view.focal, *level) {
                    path = path.max(top - (p.z + rise));
                }
            }
            sum += cosine;
            seen += cosine * (-CANOPY_EXTINCTION_PER_M * path.max(0.0)).exp();
        }
        seen / sum
    }
}

/// A direction in which the sky is looked for, and where on the way the canopy's height is.
struct Probe {
    direction: Vec3,
    steps: [Option<Step>; 2],
}

struct Step {
    level: usize,
    /// On the map, whose rows go south, metres.
    shift: Vec2,
    /// Of the way, metres.
    rise: f32,
}

/// By turn: four directions all around, and the zenith.
static PROBES: LazyLock<[[Probe; 5]; 4]> = LazyLock::new(|| {
    std::array::from_fn(|turn| {
        std::array::from_fn(|i| {
            if i == 4 {
                let here = Step { level: 1, shift: Vec2::ZERO, rise: 0.0 };
                return Probe { direction: Vec3::Z, steps: [Some(here), None] };
            }
            let steep = [0.45f32, 0.8, 0.6, 1.1][(i + turn) % 4];
            let phi = (i as f32 + turn as f32 * 0.25) * std::f32::consts::FRAC_PI_2 + 0.3;
            let (east, north) = (phi.cos(), phi.sin());
            let step = |level: usize, reach_m: f32| Step {
                level,
                shift: Vec2::new(east, -north) * reach_m,
                rise: reach_m * steep.tan(),
            };
            Probe {
                direction: Vec3::new(east * steep.cos(), north * steep.cos(), steep.sin()),
                steps: [Some(step(2, 1.2)), Some(step(3, 4.5))],
            }
        })
    })
});

/// The light on a stage.
pub(super) struct Light {
    pub sun: Vec3,
    shadow: DepthMap,
    canopy: Canopy,
    haze_per_m: f32,
    /// White light from all around, as in a studio.
    pub fill: f32,
}

impl Light {
    /// `sun` points to the sun; `points` span what the picture shows.
    pub fn new(
        stage: &Stage<'_>,
        sun: Vec3,
        points: &[Vec3],
        shadow_size: usize,
        triangle_budget: usize,
        haze_per_m: f32,
    ) -> Light {
        let sun = sun.try_normalize().unwrap_or(Vec3::Z);
        let shadow_view = View::orthographic(-sun, points.iter().copied(), shadow_size);
        let down = View::orthographic(Vec3::NEG_Z, points.iter().copied(), shadow_size / 4);
        Light {
            sun,
            shadow: DepthMap::draw(stage, shadow_view, triangle_budget),
            canopy: Canopy::from_map(DepthMap::draw(stage, down, triangle_budget / 4)),
            haze_per_m,
            fill: 0.0,
        }
    }

    /// Share of the sun that reaches a place: a bilinear mean over 3 × 3 comparisons.
    fn sunlit(&self, p: Vec3, normal: Vec3, leaf: f32) -> f32 {
        let texel_m = 1.0 / self.shadow.view.focal;
        let lift =
            normal * (1.5 * texel_m * (1.0 - leaf)) + self.sun * (texel_m * 1.5 + 0.12 * leaf);
        let v = self.shadow.view.view_from_scene(p + lift);
        let at = self.shadow.view.project(v);
        let corner = at.at - 1.0;
        let base = corner.floor();
        let f = corner - base;
        let (x, y) = (base.x as i32, base.y as i32);
        let mut lit = 0.0;
        for (j, wy) in [1.0 - f.y, 1.0, f.y].into_iter().enumerate() {
            for (i, wx) in [1.0 - f.x, 1.0, f.x].into_iter().enumerate() {
                let is_shaded =
                    self.shadow.at(x + i as i32, y + j as i32).is_some_and(|n| n > at.nearness);
                lit += if is_shaded { 0.0 } else { wx * wy };
            }
        }
        lit * 0.25
    }

    /// Light towards the eye from a surface at `p`, seen over `distance` along `direction`.
    pub fn shade(&self, s: &Sample, p: Vec3, distance: f32, direction: Vec3, turn: u32) -> Vec3 {
        let albedo = Vec3::from(s.albedo);
        let toward = s.normal.dot(self.sun);
        let lit = self.sunlit(p, s.normal, s.leaf);
        let solid = toward.max(0.0);
        let leafy = ((toward + 0.35) / 1.35).max(0.0) * 0.75 + 0.25 * (-toward).max(0.0) + 0.05;
        let direct = SUN_COLOUR * (lit * (solid + (leafy - solid) * s.leaf));
        let open = 0.1 + 0.9 * self.canopy.visibility(p, s.normal, turn);
        let up = 0.5 + 0.5 * s.normal.z;
        let ambient = (BOUNCE_COLOUR * (1.0 - up) * (0.4 + 0.6 * open)) + SKY_COLOUR * (up * open);
        let fill = Vec3::splat(self.fill * (0.4 + 0.6 * open));
        // Light through a leaf loses blue and red: it comes out yellow-green.
        let through = Vec3::new(1.03, 1.04, 0.88) * s.leaf + Vec3::ONE * (1.0 - s.leaf);
        let out = albedo * (direct * through + (ambient + fill) * s.open);
        let clear = (-self.haze_per_m * distance.max(0.0)).exp();
        out * clear + haze(direction, self.sun) * (1.0 - clear)
    }

    /// What shadows leave of the light on white ground, a colour: they are cool, as the sky is.
    pub fn on_paper(&self, p: Vec3, turn: u32) -> Vec3 {
        let lit = self.sunlit(p, Vec3::Z, 0.0);
        let open = self.canopy.visibility(p, Vec3::Z, turn);
        let shade = Vec3::new(0.56, 0.59, 0.63).lerp(Vec3::ONE, lit);
        shade * (0.72 + 0.28 * open)
    }
}
