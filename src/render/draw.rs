//! What is drawn in a view, in which detail, and the drawing itself: bands of rows are filled
//! independently of each other, each from its own list in a fixed order, so that the number of
//! threads can't change a sample.

use std::cell::OnceCell;

use glam::{Mat3, Vec2, Vec3};

use super::camera::{Projected, View, corner};
use super::dither;
use super::model::{Mesh, Order};
use super::raster::{Corner, Rect, clip, fill};
use super::texture::{Edge, Pyramid};

/// A material ready to be drawn.
pub(super) struct Paint {
    pub base_color: [f32; 3],
    pub colour: Option<u32>,
    pub normal: Option<u32>,
    /// Occlusion in red.
    pub orm: Option<u32>,
    pub cutoff: Option<f32>,
    pub is_double_sided: bool,
    /// The ground that stands in for a terrain.
    pub is_floor: bool,
}

/// A model's place: `linear * p + origin`.
pub(super) struct Place {
    pub linear: Mat3,
    pub origin: Vec3,
    /// Turns normals, which scale by one over.
    pub normal: Mat3,
    pub is_mirrored: bool,
    /// Of the view; the terrain has none.
    pub placement: Option<u32>,
}

impl Place {
    /// Of a mesh in the scene.
    fn bounds(&self, mesh: &Mesh) -> (Vec3, Vec3) {
        (0..8).fold((Vec3::MAX, Vec3::MIN), |(lo, hi), i| {
            let p = self.linear * corner(mesh.bounds.0, mesh.bounds.1, i) + self.origin;
            (lo.min(p), hi.max(p))
        })
    }

    /// Its mean scale.
    fn size(&self) -> f32 {
        self.linear.determinant().abs().cbrt().max(1e-6)
    }
}

/// A mesh in its place.
pub(super) struct Item {
    pub mesh: u32,
    pub place: u32,
}

/// All that can be drawn; ids refer between the columns and are in range.
pub(super) struct Stage<'a> {
    pub textures: Vec<Option<Pyramid<'a>>>,
    pub paints: Vec<Paint>,
    pub meshes: Vec<Mesh>,
    pub places: Vec<Place>,
    pub items: Vec<Item>,
}

/// An item as one view shows it.
struct Draw {
    item: u32,
    triangles: usize,
    grow: f32,
    rows: [usize; 2],
    depth: f32,
}

/// What a visible surface gives to the light.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sample {
    pub nearness: f32,
    pub albedo: [f32; 3],
    pub normal: Vec3,
    /// 1 for leaves, which let light through; 0 for what is solid.
    pub leaf: f32,
    /// Share of the sky that its relief leaves open.
    pub open: f32,
    pub is_floor: bool,
}

impl Sample {
    pub const NOTHING: Sample = Sample {
        nearness: f32::MIN,
        albedo: [0.0; 3],
        normal: Vec3::Z,
        leaf: 0.0,
        open: 1.0,
        is_floor: false,
    };
}

/// A band of samples that can be drawn on.
pub(super) trait Canvas {
    /// Whether colours and normals are wanted.
    const IS_SHADED: bool;
    /// Whether leaves are lit as part of a rounded crown.
    const IS_CROWN_LIT: bool = Self::IS_SHADED;
    /// What comes next belongs to a place.
    fn begin(&mut self, _place: u32) {}
    fn nearness(&self, i: usize) -> f32;
    fn put(&mut self, i: usize, sample: Sample);
}

/// Samples with colour and normal.
impl Canvas for [Sample] {
    const IS_SHADED: bool = true;
    fn nearness(&self, i: usize) -> f32 {
        self[i].nearness
    }
    fn put(&mut self, i: usize, sample: Sample) {
        self[i] = sample;
    }
}

/// Nearness alone.
impl Canvas for [f32] {
    const IS_SHADED: bool = false;
    fn nearness(&self, i: usize) -> f32 {
        self[i]
    }
    fn put(&mut self, i: usize, sample: Sample) {
        self[i] = sample.nearness;
    }
}

/// Samples that a card spans at least, in the finest detail that is drawn; how much more where that
/// is too many triangles, and how often more at most.
pub(super) const FINEST_CARD_SAMPLES: f32 = 3.0;
pub(super) const COARSER: f32 = 1.2;
pub(super) const MOST_COARSER: usize = 16;

/// Metres of a mesh that a sample of the view is wide, where the mesh is in that place.
fn sample_m(view: &View, place: &Place, (lo, hi): (Vec3, Vec3)) -> f32 {
    let middle = view.view_from_scene((lo + hi) * 0.5);
    1.0 / (view.samples_per_m(middle.z) * place.size())
}

/// Triangles of a mesh that are drawn of it in each of its places.
pub(super) fn needed<'p>(
    mesh: &Mesh,
    view: &View,
    card_samples: f32,
    places: impl Iterator<Item = &'p Place>,
) -> impl Iterator<Item = usize> {
    places.map(move |place| {
        let sample_m = sample_m(view, place, place.bounds(mesh));
        mesh.detail(sample_m, card_samples).0
    })
}

/// What a view shows, near things first, sorted into bands of rows.
pub(super) struct DrawList {
    draws: Vec<Draw>,
    bands: Vec<Vec<u32>>,
    rows_per_band: usize,
}

impl DrawList {
    fn sorted(draws: Vec<Draw>, view: &View, rows_per_band: usize) -> DrawList {
        let mut bands = vec![Vec::new(); view.height.div_ceil(rows_per_band)];
        for (i, d) in draws.iter().enumerate() {
            let last = (d.rows[1] - 1) / rows_per_band;
            for band in &mut bands[d.rows[0] / rows_per_band..=last] {
                band.push(i as u32);
            }
        }
        DrawList { draws, bands, rows_per_band }
    }
}

impl Stage<'_> {
    /// Bounds of an item in the scene.
    pub fn bounds(&self, item: &Item) -> (Vec3, Vec3) {
        self.places[item.place as usize].bounds(&self.meshes[item.mesh as usize])
    }

    /// Lists what the view shows, as detailed as `triangle_budget` allows.
    pub fn list(&self, view: &View, rows_per_band: usize, triangle_budget: usize) -> DrawList {
        let mut card_samples = FINEST_CARD_SAMPLES;
        let mut draws = self.draws(view, Some(card_samples));
        for _ in 0..MOST_COARSER {
            if draws.iter().map(|d| d.triangles).sum::<usize>() <= triangle_budget {
                break;
            }
            card_samples *= COARSER;
            draws = self.draws(view, Some(card_samples));
        }
        draws.sort_by(|a, b| a.depth.total_cmp(&b.depth).then(a.item.cmp(&b.item)));
        DrawList::sorted(draws, view, rows_per_band)
    }

    /// Lists what is in one place, every triangle of it.
    pub fn list_whole(&self, view: &View, place: u32, rows_per_band: usize) -> DrawList {
        let mut draws = self.draws(view, None);
        draws.retain(|d| self.items[d.item as usize].place == place);
        DrawList::sorted(draws, view, rows_per_band)
    }

    /// `card_samples`: how small cards may become before some are left out; `None`: nothing is.
    fn draws(&self, view: &View, card_samples: Option<f32>) -> Vec<Draw> {
        let mut out = Vec::new();
        for (i, item) in self.items.iter().enumerate() {
            let (mesh, place) =
                (&self.meshes[item.mesh as usize], &self.places[item.place as usize]);
            let (mut lo, mut hi) = self.bounds(item);
            let (scale, sample_m) = (place.size(), sample_m(view, place, (lo, hi)));
            let (triangles, grow) = match card_samples {
                Some(card_samples) => mesh.detail(sample_m, card_samples),
                None => (mesh.triangle.len(), 1.0),
            };
            if let Order::Cards { side_m, .. } = mesh.order {
                let margin = Vec3::splat((grow - 1.0) * side_m * scale * 2.0);
                lo -= margin;
                hi += margin;
            }
            if triangles == 0 {
                continue;
            }
            if let Some(([_, y0, _, y1], depth)) = view.cover(lo, hi) {
                out.push(Draw { item: i as u32, triangles, grow, rows: [y0, y1], depth });
            }
        }
        out
    }

    /// Draws one band of the list onto its samples, row-major and as wide as the view.
    pub fn draw_band<C: Canvas + ?Sized>(
        &self,
        view: &View,
        list: &DrawList,
        band: usize,
        scratch: &mut Scratch,
        canvas: &mut C,
    ) {
        let y0 = band * list.rows_per_band;
        let rect = Rect {
            x0: 0,
            y0: y0 as i32,
            x1: view.width as i32,
            y1: (y0 + list.rows_per_band).min(view.height) as i32,
        };
        for &i in &list.bands[band] {
            self.draw(view, &list.draws[i as usize], rect, scratch, canvas);
        }
    }

    fn draw<C: Canvas + ?Sized>(
        &self,
        view: &View,
        draw: &Draw,
        rect: Rect,
        scratch: &mut Scratch,
        canvas: &mut C,
    ) {
        let item = &self.items[draw.item as usize];
        canvas.begin(item.place);
        let (mesh, place) = (&self.meshes[item.mesh as usize], &self.places[item.place as usize]);
        let paint = &self.paints[mesh.material as usize];
        let texture = |id: Option<u32>| id.and_then(|i| self.textures[i as usize].as_ref());
        let brush = Brush {
            view,
            rect,
            colour: texture(paint.colour),
            bumps: texture(paint.normal),
            orm: texture(paint.orm),
            paint,
            edge: mesh.edge,
            is_leaf: matches!(mesh.order, Order::Cards { .. }),
            is_mirrored: place.is_mirrored,
        };
        let used = mesh.vertex_end[draw.triangles - 1] as usize;
        scratch.corner.clear();
        scratch.place.clear();
        for (i, v) in mesh.vertex[..used].iter().enumerate() {
            let (mut p, mut bulge) = (v.position, Vec3::ZERO);
            if let Order::Cards { middle, crown, .. } = &mesh.order {
                p = middle[i] + (p - middle[i]) * draw.grow;
                if C::IS_CROWN_LIT {
                    bulge = place.normal * ((p - crown.0) * crown.1);
                }
            }
            let view_p = view.view_from_scene(place.linear * p + place.origin);
            let normal = if C::IS_SHADED { place.normal * v.normal } else { Vec3::ZERO };
            scratch.corner.push(Corner { view: view_p, uv: v.uv, normal, bulge });
            scratch.place.push(view.is_drawable(view_p).then(|| view.project(view_p)));
        }
        for t in &mesh.triangle[..draw.triangles] {
            let [a, b, c] = t.map(|i| i as usize);
            let at = [scratch.place[a], scratch.place[b], scratch.place[c]];
            let corners = || [&scratch.corner[a], &scratch.corner[b], &scratch.corner[c]];
            if let [Some(a), Some(b), Some(c)] = at {
                brush.triangle([&a, &b, &c], corners(), canvas);
            } else {
                let mut polygon = [Corner::default(); 8];
                let count = clip(view, corners().map(|c| *c), &mut polygon);
                for i in 2..count {
                    let fan = [&polygon[0], &polygon[i - 1], &polygon[i]];
                    let at = fan.map(|c| view.project(c.view));
                    brush.triangle([&at[0], &at[1], &at[2]], fan, canvas);
                }
            }
        }
    }
}

/// Buffers kept from one mesh to the next.
#[derive(Default)]
pub(super) struct Scratch {
    corner: Vec<Corner>,
    place: Vec<Option<Projected>>,
}

/// Everything that stays the same over one mesh.
struct Brush<'a> {
    view: &'a View,
    rect: Rect,
    colour: Option<&'a Pyramid<'a>>,
    bumps: Option<&'a Pyramid<'a>>,
    orm: Option<&'a Pyramid<'a>>,
    paint: &'a Paint,
    edge: Edge,
    is_leaf: bool,
    is_mirrored: bool,
}

/// What is more see-through is not there.
const LEAST_ALPHA: f32 = 1.0 / 255.0;

impl Brush<'_> {
    fn triangle<C: Canvas + ?Sized>(
        &self,
        at: [&Projected; 3],
        corner: [&Corner; 3],
        canvas: &mut C,
    ) {
        let rect = self.rect;
        let [a, b, c] = at.map(|p| p.at);
        let (top, bottom) = (a.y.min(b.y).min(c.y), a.y.max(b.y).max(c.y));
        if bottom < rect.y0 as f32 || top > rect.y1 as f32 {
            return;
        }
        let (left, right) = (a.x.min(b.x).min(c.x), a.x.max(b.x).max(c.x));
        if right < rect.x0 as f32 || left > rect.x1 as f32 {
            return;
        }
        // Rows go down, so that a front face is clockwise here: its area is negative.
        let area = (b - a).perp_dot(c - a);
        let is_back = (area > 0.0) != self.is_mirrored;
        if is_back && !self.paint.is_double_sided {
            return;
        }
        let inv_w = at.map(|p| p.inv_w);
        // Both are only asked for where a sample is seen.
        let lod_at_depth_1 = OnceCell::new();
        let lod_at_depth_1 = || {
            *lod_at_depth_1.get_or_init(|| {
                let Some(texture) = self.colour else { return 0.0 };
                let uv = (corner[1].uv - corner[0].uv).perp_dot(corner[2].uv - corner[0].uv).abs();
                let ratio = uv * texture.texels() / area.abs().max(1e-9);
                0.5 * (ratio * inv_w[0] * inv_w[1] * inv_w[2]).max(1e-30).log2()
            })
        };
        let is_large = area.abs() > 512.0;
        let mean_lod = OnceCell::new();
        let mean_lod = || {
            *mean_lod.get_or_init(|| {
                let mean_w = 3.0 / (inv_w[0] + inv_w[1] + inv_w[2]);
                lod_at_depth_1() + 1.5 * mean_w.log2()
            })
        };
        let tangent = OnceCell::new();
        let tangent = || *tangent.get_or_init(|| tangents(self.view, corner));
        // Sheets behind each other let different samples through: the noise is repeated and shifted.
        let noise = |x: i32, y: i32| {
            let bits = at[0].nearness.to_bits().wrapping_mul(0x9e37_79b9);
            let (times, shift) = (1 + (bits >> 29), (bits >> 8 & 0xffff) as f32 / 65_536.0);
            (dither(x as u32, y as u32) * times as f32 + shift).fract()
        };
        let facing = if is_back { -1.0 } else { 1.0 };
        let width = self.view.width;
        fill([a, b, c], rect, |x, y, weight| {
            let nearness = weight[0] * at[0].nearness
                + weight[1] * at[1].nearness
                + weight[2] * at[2].nearness;
            let i = (y - rect.y0) as usize * width + x as usize;
            if nearness <= canvas.nearness(i) {
                return;
            }
            if !C::IS_SHADED && self.paint.cutoff.is_none() {
                return canvas.put(i, Sample { nearness, ..Sample::NOTHING });
            }
            let k = [weight[0] * inv_w[0], weight[1] * inv_w[1], weight[2] * inv_w[2]];
            let w = 1.0 / (k[0] + k[1] + k[2]);
            let k = k.map(|v| v * w);
            let uv = corner[0].uv * k[0] + corner[1].uv * k[1] + corner[2].uv * k[2];
            let lod = if is_large { lod_at_depth_1() + 1.5 * w.log2() } else { mean_lod() };
            if let (Some(mut cutoff), Some(texture)) = (self.paint.cutoff, self.colour) {
                if C::IS_SHADED && texture.is_averaged(lod) {
                    cutoff = noise(x, y).max(LEAST_ALPHA);
                }
                if texture.alpha(uv, lod, self.edge) < cutoff {
                    return;
                }
            }
            if !C::IS_SHADED {
                return canvas.put(i, Sample { nearness, ..Sample::NOTHING });
            }
            let mut albedo = self.paint.base_color;
            if let Some(texture) = self.colour {
                let t = texture.colour(uv, lod, self.edge);
                albedo = std::array::from_fn(|i| albedo[i] * t[i]);
            }
            let mut normal =
                (corner[0].normal * k[0] + corner[1].normal * k[1] + corner[2].normal * k[2])
                    .normalize_or(Vec3::Z)
                    * facing;
            if let Some(bumps) = self.bumps
                && let Some((along, across)) = tangent()
            {
                let b = bumps.colour(uv, lod, self.edge).map(|v| v * 2.0 - 1.0);
                normal = (along * b[0] + across * b[1] + normal * b[2]).normalize_or(normal);
            }
            if self.is_leaf && C::IS_CROWN_LIT {
                // A crown is lit as a whole: single leaves only ripple its rounded surface.
                let bulge =
                    corner[0].bulge * k[0] + corner[1].bulge * k[1] + corner[2].bulge * k[2];
                normal = (normal * 0.45 + bulge.normalize_or_zero() * 0.6 + Vec3::Z * 0.2)
                    .normalize_or(normal);
            }
            let leaf = f32::from(u8::from(self.is_leaf));
            let open = self.orm.map_or(1.0, |orm| orm.colour(uv, lod, self.edge)[0]);
            let is_floor = self.paint.is_floor;
            canvas.put(i, Sample { nearness, albedo, normal, leaf, open, is_floor });
        });
    }
}

/// Unit directions of growing u and v in the scene; `None` where the texture is degenerate.
fn tangents(view: &View, corner: [&Corner; 3]) -> Option<(Vec3, Vec3)> {
    let (p, q) = (corner[1].view - corner[0].view, corner[2].view - corner[0].view);
    let (s, t): (Vec2, Vec2) = (corner[1].uv - corner[0].uv, corner[2].uv - corner[0].uv);
    let det = s.perp_dot(t);
    let along = (p * t.y - q * s.y) * det.signum();
    let across = (q * s.x - p * t.x) * det.signum();
    Some((
        view.scene_from_view(along.try_normalize()?),
        view.scene_from_view(across.try_normalize()?),
    ))
}
