//! Skeletons to triangle meshes: closed tubes for the wood, cards or geometry for the foliage.
//! Knows nothing of files or scenes.

mod blend;
mod card;
mod cards;
mod chain;
mod check;
mod dry;
mod facing;
mod foliage;
mod form;
mod fruit;
mod junction;
mod leaf;
mod leave;
pub mod lightmap;
mod middle;
pub mod p18;
mod patch;
mod path;
mod piece;
mod shade;
mod shell;
mod spot;
mod stalk;
mod stamp;
mod transition;
mod tube;
mod twigs;
mod wind;
mod wood;
mod young;

use glam::{Vec2, Vec3};
use rayon::prelude::*;

use crate::diagnostic::{Error, Result};
use crate::seed::Seed;
use crate::skeleton::Skeleton;
use crate::species::Species;
use crate::texture::Atlas;
use young::BARKS;

pub use foliage::{FoliageLevel, HEIGHTS, at_heights};
pub use leaf::StandIn;
pub use path::{BELOW_GROUND_M, BURIED, FLARE, FLARED, LOBED, MAX_SIDES};
pub use twigs::{Place, Twigs, outer};
pub use wind::{Wind, WindProfile};
pub use wood::{stem_is_twig, upper_bark_from_m};
pub use young::Around;

/// Vertices that a thread takes at once.
const CHUNK: usize = 1 << 14;

/// An indexed triangle surface; columns of equal length, three indices a triangle,
/// counter-clockwise seen from outside. `uv` has v = 0 at the bottom of the picture.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Surface {
    pub position: Vec<Vec3>,
    /// Unit length.
    pub normal: Vec<Vec3>,
    pub uv: Vec<Vec2>,
    pub index: Vec<u32>,
    /// How each vertex moves in the wind, as a profile's channels; empty where nobody asked.
    pub wind: Vec<[u8; 4]>,
    /// Places on a light map, within 0…1, where no two triangles of a model overlap; empty where
    /// nobody asked. v = 0 at the bottom.
    pub lightmap_uv: Vec<Vec2>,
}

impl Surface {
    pub fn triangles(&self) -> usize {
        self.index.len() / 3
    }

    /// Bytes of places, normals, texture coordinates and indices.
    pub fn bytes(&self) -> u64 {
        32 * self.position.len() as u64 + 4 * self.index.len() as u64
    }

    pub fn is_empty(&self) -> bool {
        self.index.is_empty()
    }

    /// Adds the triangles of a surface with the same columns.
    pub fn append(&mut self, mut more: Surface) {
        let first = self.position.len() as u32;
        self.index.extend(more.index.iter().map(|i| first + i));
        self.position.append(&mut more.position);
        self.normal.append(&mut more.normal);
        self.uv.append(&mut more.uv);
        self.wind.append(&mut more.wind);
        self.lightmap_uv.append(&mut more.lightmap_uv);
    }

    /// Drops the triangles that reach below z = 0.
    fn clear_ground(&mut self) {
        let is_above = |i: u32| self.position.get(i as usize).is_some_and(|p| p.z >= 0.0);
        if self.position.par_iter().with_min_len(CHUNK).all(|p| p.z >= 0.0) {
            return;
        }
        let kept: Vec<u32> = self
            .index
            .chunks_exact(3)
            .filter(|t| t.iter().all(|&i| is_above(i)))
            .flatten()
            .copied()
            .collect();
        let mut place = vec![u32::MAX; self.position.len()];
        let mut out = Surface::default();
        for i in kept {
            let i = i as usize;
            if place[i] == u32::MAX {
                place[i] = out.position.len() as u32;
                out.position.push(self.position[i]);
                out.normal.push(self.normal[i]);
                out.uv.push(self.uv[i]);
                out.wind.extend(self.wind.get(i));
            }
            out.index.push(place[i]);
        }
        *self = out;
    }

    /// Least and greatest corner; zero for an empty surface.
    pub fn bounds(&self) -> (Vec3, Vec3) {
        if self.position.is_empty() {
            return (Vec3::ZERO, Vec3::ZERO);
        }
        let nothing = (Vec3::INFINITY, Vec3::NEG_INFINITY);
        let chunks = self.position.par_chunks(CHUNK);
        chunks.map(bounds_of).reduce(|| nothing, |a, b| (a.0.min(b.0), a.1.max(b.1)))
    }
}

fn bounds_of(points: &[Vec3]) -> (Vec3, Vec3) {
    /// Numbers of four points, which machines take at once.
    const LANES: usize = 12;
    let (fours, _) = bytemuck::cast_slice::<Vec3, f32>(points).as_chunks::<LANES>();
    let (mut lo, mut hi) = ([f32::INFINITY; LANES], [f32::NEG_INFINITY; LANES]);
    for four in fours {
        for (k, &v) in four.iter().enumerate() {
            lo[k] = if v < lo[k] { v } else { lo[k] };
            hi[k] = if v > hi[k] { v } else { hi[k] };
        }
    }
    let corners = lo.as_chunks().0.iter().zip(hi.as_chunks().0);
    let corners = corners.map(|(&lo, &hi)| (Vec3::from_array(lo), Vec3::from_array(hi)));
    let all = corners.chain(points[4 * fours.len()..].iter().map(|&p| (p, p)));
    let nothing = (Vec3::INFINITY, Vec3::NEG_INFINITY);
    all.fold(nothing, |(lo, hi), (low, high)| (lo.min(low), hi.max(high)))
}

/// Greatest coordinate.
fn reach_m(points: &[Vec3]) -> f32 {
    let (low, high) = bounds_of(points);
    (-low).max(high).max_element().max(0.0)
}

/// A tree's mesh; tree-local metres, root collar at the origin, Z up.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct TreeMesh {
    /// One closed surface a stem, or one closed tube an axis ([`Junctions`]), as is a branch without room for a
    /// foot; stems go on below ground. u
    /// counts whole tiles of bark around; v goes up along each axis, as fast as the tiles are wide.
    pub wood: Surface,
    /// The part of the wood with the bark of the upper stem and the branches; empty where the
    /// species has none. Closed only together with the other woods.
    pub upper_wood: Surface,
    /// The part between the two, a few tiles of bark long, likewise.
    pub transition_wood: Surface,
    /// The part with the bark of twigs, likewise.
    pub twig_wood: Surface,
    /// Empty for a bare tree, and where [`TreeMesh::twigs`] are its leaves.
    pub foliage: Surface,
    /// Bare twigs of branches that are dead, with the same picture.
    pub dry: Surface,
    /// Whether the foliage is a closed hull of the crown, without pictures of leaves.
    pub is_hull: bool,
    /// Leaves as twigs in many places; empty unless asked for.
    pub twigs: Vec<Twigs>,
    /// Cones, berries or catkins of the user's own; empty where the species has none.
    pub fruit: Surface,
    /// Axes thick enough for the budget.
    pub axes: usize,
    /// Those of them that have no mesh: they never clear their parent's bark.
    pub unmeshed_axes: usize,
    /// Those of them that are closed for themselves, though wood is welded: f32 cannot tell as many feet apart.
    pub unwelded_axes: usize,
    /// Greatest distance of the wood's facets from their circles, r (1 − cos(π / N)), metres.
    pub sagitta_m: f32,
    /// Sides of the ring that has it.
    pub sagitta_sides: u32,
    /// How much larger than in nature twigs are, to make up for those left out; 0 without any.
    pub twig_scale: f32,
    /// What leaves hide over what the species' do, 0…1, as far as that is known; 1 elsewhere.
    pub leaf_cover: f32,
    /// How such leaves stand for all of them; `None` elsewhere.
    pub stand_in: Option<StandIn>,
    /// Of the skeleton's nodes, whether wood goes along them; empty where one does not see what leaves
    /// hang from.
    pub is_meshed: Vec<bool>,
}

impl TreeMesh {
    /// What is stored: twigs once a form.
    pub fn triangles(&self) -> usize {
        let twigs: usize = self.twigs.iter().map(|t| t.form.triangles()).sum();
        let beside = self.dry.triangles() + self.fruit.triangles();
        self.wood_triangles() + self.foliage.triangles() + twigs + beside
    }

    /// What is seen: twigs wherever they stand.
    pub fn shown_triangles(&self) -> usize {
        let twigs = |of: fn(&Twigs) -> usize| self.twigs.iter().map(of).sum::<usize>();
        self.triangles() - twigs(|t| t.form.triangles()) + twigs(Twigs::shown_triangles)
    }

    /// The wood, bark by bark.
    pub fn woods(&self) -> [&Surface; BARKS] {
        [&self.wood, &self.upper_wood, &self.transition_wood, &self.twig_wood]
    }

    /// All but twigs that are stored once.
    pub fn surfaces_mut(&mut self) -> [&mut Surface; BARKS + 3] {
        let TreeMesh { wood, upper_wood, transition_wood, twig_wood, foliage, dry, fruit, .. } =
            self;
        [wood, upper_wood, transition_wood, twig_wood, foliage, dry, fruit]
    }

    pub fn wood_triangles(&self) -> usize {
        self.woods().iter().map(|s| s.triangles()).sum()
    }

    /// Least and greatest corner of all that is there.
    pub fn bounds(&self) -> (Vec3, Vec3) {
        self.woods()
            .into_iter()
            .chain([&self.foliage, &self.dry, &self.fruit])
            .filter(|s| !s.is_empty())
            .map(|s| s.bounds())
            .chain((!self.twigs.is_empty()).then(|| bounds_of(&self.outer_twigs())))
            .reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)))
            .unwrap_or_default()
    }

    fn outer_twigs(&self) -> Vec<Vec3> {
        let forms: Vec<_> = self.twigs.iter().map(|t| (&t.form, &t.places[..])).collect();
        outer(&forms)
    }

    /// [`crown_diameter_m`] of the leaves, or of the shoots where bare.
    pub fn crown_diameter_m(&self) -> f32 {
        let shoots: Vec<Vec3>;
        let crown = if !self.twigs.is_empty() {
            shoots = self.twigs.iter().flat_map(Twigs::tips).collect();
            &shoots
        } else if self.foliage.is_empty() {
            shoots = self.woods().into_iter().flat_map(|w| &w.position).copied().collect();
            &shoots
        } else {
            &self.foliage.position
        };
        crown_diameter_m(crown)
    }

    /// Scales the tree about its root collar until its highest leaf or shoot is at `height_m`. A
    /// skeleton of the right height bears twigs that reach beyond it.
    pub fn fit_height(&mut self, height_m: f32) {
        self.scale(self.factor_to(height_m));
    }

    /// The factor that brings the highest leaf or shoot to a height; 1 where there is none.
    pub fn factor_to(&self, height_m: f32) -> f32 {
        let top = self.bounds().1.z;
        if top > 0.0 && height_m > 0.0 { height_m / top } else { 1.0 }
    }

    /// Scales the tree about its root collar.
    pub fn scale(&mut self, factor: f32) {
        self.sagitta_m *= factor;
        for surface in self.surfaces_mut() {
            surface.position.par_iter_mut().with_min_len(CHUNK).for_each(|p| *p *= factor);
        }
        self.twigs.iter_mut().for_each(|twigs| twigs.scale(factor));
    }

    /// Drops the triangles of leaves that hang into the ground, which is z = 0; twigs whole.
    pub fn clear_ground(&mut self) {
        self.twigs.iter_mut().for_each(Twigs::clear_ground);
        self.twigs.retain(|twigs| !twigs.places.is_empty());
        for leaves in [&mut self.foliage, &mut self.dry] {
            leaves.clear_ground();
        }
    }

    /// All surfaces sound, and the wood closed.
    pub fn check(&self) -> Result<()> {
        self.woods().into_iter().try_for_each(Surface::check)?;
        self.foliage.check()?;
        self.dry.check()?;
        self.fruit.check()?;
        self.twigs.iter().try_for_each(Twigs::check)?;
        match check::open_edges(&self.woods()) {
            0 => Ok(()),
            n => Err(Error::new(format!("the wood has {n} open edges"))),
        }
    }
}

/// Diameter of the circle whose area is that of the crown seen from above: a star of 16 rays from the
/// crown's middle, each as long as nine tenths of the places in its sixteenth are near. The outermost
/// tenth is the tips of twigs, which an outline passes by. Of a crown of few places all count, and a
/// narrow gap between two sixteenths is as wide as they.
pub fn crown_diameter_m(crown: &[Vec3]) -> f32 {
    const SECTORS: usize = 16;
    const FEW: usize = 100;
    let within = if crown.len() < FEW { 1.0 } else { 0.9 };
    let sum = crown.iter().fold(glam::DVec2::ZERO, |s, p| s + p.truncate().as_dvec2());
    let middle = (sum / crown.len().max(1) as f64).as_vec2();
    let mut distance_sq = vec![Vec::new(); SECTORS];
    for p in crown {
        let d = p.truncate() - middle;
        let turn = (d.to_angle() / std::f32::consts::TAU).rem_euclid(1.0);
        let sector = ((turn * SECTORS as f32) as usize).min(SECTORS - 1);
        distance_sq[sector].push(d.length_squared());
    }
    let rays = distance_sq.iter_mut().map(|d| {
        d.sort_unstable_by(f32::total_cmp);
        let last = d.len().saturating_sub(1) as f32;
        d.get((last * within) as usize).copied()
    });
    let rays: Vec<Option<f32>> = rays.collect();
    let beside = |k: usize| [1, 2].iter().find_map(|step| rays[(k + step) % SECTORS]);
    let other = |k: usize| [1, 2].iter().find_map(|step| rays[(k + SECTORS - step) % SECTORS]);
    let sum = (0..SECTORS).fold(0.0, |sum, k| {
        sum + match (rays[k], beside(k), other(k)) {
            (Some(ray), ..) => ray,
            (None, Some(a), Some(b)) => 0.5 * (a + b),
            _ => 0.0,
        }
    });
    2.0 * (sum / SECTORS as f32).sqrt()
}

/// How finely a tree is meshed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MeshOptions {
    /// Greatest distance between a tube's facets and its circle, and between the mesh and nodes
    /// left out, metres; clamped to 1e-5…1. A budget coarsens it.
    pub tolerance_m: f32,
    /// How far a budget may coarsen the first of these distances, metres: then axes are left out.
    pub sagitta_m: f32,
    /// Triangles of the whole tree, wood and foliage; a stem alone may exceed a tiny budget.
    pub triangle_budget: Option<usize>,
    pub foliage: FoliageLevel,
    /// Vertex colours that say how vertices move; made for none where `None`.
    pub wind: Option<WindProfile>,
    /// Share of the places for leaves that bear them, 0…1.
    pub leaf_share: f32,
    /// How much larger twigs are than their number asks, at each height of the crown.
    pub larger: [f32; HEIGHTS],
    /// Share of the cards with pictures of boughs that show them in shade.
    pub shaded: f32,
    /// Buttresses at the ground, cards of more rows.
    pub detail: bool,
    pub junctions: Junctions,
    pub twigs: TwigsAs,
    /// Seen from farther than another form of the tree, whatever its triangles.
    pub is_coarser: bool,
}

/// How leaves, or a user's own twigs, are stored.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum TwigsAs {
    /// All of them in one surface, within the budget.
    #[default]
    Merged,
    /// A few forms of whole twigs, each at many places: all leaves of the species' own size. The budget
    /// is that of what is stored. Only leaf by leaf, or of a user's own model.
    Instanced,
}

/// How a branch joins its parent.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Junctions {
    /// Out of a hole in the parent's bark: the wood of a stem is one closed surface.
    #[default]
    Welded,
    /// Tubes closed each for itself pass through each other: fewer triangles.
    Intersecting,
}

impl MeshOptions {
    /// Whether leaves are cards from so far that one does not see what they hang from.
    fn has_far_cards(&self) -> bool {
        let is_far = self.is_coarser || self.triangle_budget.is_some_and(|b| b < FAR_BELOW);
        self.foliage == FoliageLevel::Sparse || self.foliage == FoliageLevel::Cards && is_far
    }

    /// Whether leaves are cards from so near that one sees what they hang from.
    fn has_near_cards(&self) -> bool {
        self.foliage == FoliageLevel::Cards && !self.has_far_cards()
    }

    /// From what is looked at from afar, 0, to what is from near.
    fn nearness(&self) -> f32 {
        let budget = self.triangle_budget.unwrap_or(NEAR_FROM);
        let way = budget.saturating_sub(FAR_BELOW) as f32 / (NEAR_FROM - FAR_BELOW) as f32;
        match self.foliage {
            _ if self.has_far_cards() => 0.0,
            FoliageLevel::Cards => way.min(1.0),
            _ => 1.0,
        }
    }

    /// Without leaves where none is borne, when shoots are the crown, and where cards without a picture would show
    /// bare twigs.
    fn as_borne(&self, species: &Species, atlas: &Atlas) -> MeshOptions {
        let foliage = self.foliage.of(species);
        let are_blank =
            foliage != FoliageLevel::Geometry && species.foliage.is_bare() && atlas.is_plain();
        let is_bare = self.leaf_share <= 0.0 || are_blank;
        let foliage = if is_bare { FoliageLevel::None } else { foliage };
        MeshOptions { foliage, ..*self }
    }

    /// Whether one sees between the leaves, which are few.
    fn is_thin(&self) -> bool {
        self.leaf_share < THIN
    }

    /// As rough as a budget asks, however round wood was to be.
    pub fn roughened(self) -> MeshOptions {
        let tolerance_m = self.tolerance_m.max(MeshOptions::HERO.tolerance_m);
        MeshOptions { tolerance_m, sagitta_m: f32::INFINITY, ..self }
    }

    /// One of many trees in a forest.
    pub const FOREST: MeshOptions = MeshOptions {
        tolerance_m: 0.004,
        sagitta_m: f32::INFINITY,
        triangle_budget: Some(5_000),
        foliage: FoliageLevel::Cards,
        wind: None,
        leaf_share: 1.0,
        larger: [1.0; HEIGHTS],
        shaded: 0.0,
        detail: false,
        junctions: Junctions::Welded,
        twigs: TwigsAs::Merged,
        is_coarser: false,
    };
    /// A tree seen from near.
    pub const HERO: MeshOptions = MeshOptions {
        tolerance_m: 0.0015,
        sagitta_m: f32::INFINITY,
        triangle_budget: Some(20_000),
        foliage: FoliageLevel::Cards,
        wind: None,
        leaf_share: 1.0,
        larger: [1.0; HEIGHTS],
        shaded: 0.0,
        detail: true,
        junctions: Junctions::Welded,
        twigs: TwigsAs::Merged,
        is_coarser: false,
    };
}

/// Share of a budget that the wood of a leafy tree may take, with leaves as geometry or near cards, with cards from
/// afar, and with bare twigs, which hide none of it.
const WOOD_SHARE: f32 = 0.45;
const WOOD_SHARE_FAR: f32 = 0.24;
const WOOD_SHARE_BARE: f32 = 0.55;
/// Share of its leaves below which a crown shows its branches.
const THIN: f32 = 0.5;
/// Of a tree of fewer triangles little of the wood shows from where it is seen; one of so many is seen from near.
const FAR_BELOW: usize = 12_000;
const NEAR_FROM: usize = 20_000;

/// Meshes a skeleton. `atlas` says where the twigs lie in the species' leaf picture. Same
/// arguments, same bytes.
///
/// # Errors
/// A skeleton that breaks its invariants, or of a single node: it has no wood. A model of the user's
/// own that alone exceeds the budget.
pub fn build(
    skeleton: &Skeleton,
    species: &Species,
    atlas: &Atlas,
    options: &MeshOptions,
    seed: Seed,
) -> Result<TreeMesh> {
    skeleton.check()?;
    let options = &options.as_borne(species, atlas);
    let far = reach_m(&skeleton.position);
    if far > 1e4 {
        return Err(Error::new(format!("a skeleton reaches {far} m from its root"))
            .remedy("give lengths in metres"));
    }
    let seed = seed.derive("mesh", 0);
    let level = options.foliage;
    let dry_twigs = dry::Dry::of(skeleton, species, atlas, options);
    let dry_share = dry_twigs.as_ref().map_or(0.0, |dry| dry.share);
    let wood_budget = options.triangle_budget.map(|b| {
        let of = |share: f32| (b as f32 * share) as usize;
        let usual = match level {
            FoliageLevel::None => b,
            _ if species.foliage.is_bare() => of(WOOD_SHARE_BARE),
            _ if options.is_thin() => of(WOOD_SHARE),
            _ => of(WOOD_SHARE_FAR + (WOOD_SHARE - WOOD_SHARE_FAR) * options.nearness()),
        };
        // What cards leave over is for more branches.
        let all = |in_leaf: usize| (in_leaf as f32 / (1.0 - dry_share)) as usize;
        let most = ((b - usual) as f32 * (1.0 - dry_share)) as usize;
        let taken = foliage::taken_by_cards(skeleton, species, atlas, options, most);
        taken.map_or(usual, |taken| b.saturating_sub(all(taken)))
    });
    let hides = level == FoliageLevel::Shell && !species.foliage.is_bare();
    let outside = hides.then(|| shell::outside(skeleton, species.foliage.bearing_radius_m));
    let with_wood = outside.as_ref().unwrap_or(skeleton);
    let wind = options.wind.map(|profile| Wind::new(with_wood, skeleton.height_m(), profile, seed));
    let made = wood::wood(with_wood, options, wood_budget, species, wind.as_ref(), seed);
    let triangles = made.triangles();
    if triangles == 0 {
        return Err(Error::new(format!("a skeleton of {} nodes has no wood", skeleton.len()))
            .remedy("give the species a greater height"));
    }
    let is_meshed = if options.has_near_cards() { made.is_meshed } else { Vec::new() };
    let beside = Beside { triangles, is_meshed: &is_meshed };
    let mut order = order(species, atlas, options, beside, wind.as_ref(), seed);
    let fruit = fruit::fruit(skeleton, &order);
    order.budget = order.budget.map(|b| b.saturating_sub(fruit.triangles()));
    let dry = match dry_twigs {
        Some(dry) => {
            let part = |b: usize| (b as f32 * dry.share) as usize;
            let made =
                dry.made(skeleton, &foliage::Order { budget: order.budget.map(part), ..order })?;
            order.budget = order.budget.map(|b| b.saturating_sub(made.triangles()));
            made
        }
        None => Surface::default(),
    };
    let leaves = foliage::foliage(skeleton, &order)?;
    let [wood, upper_wood, transition_wood, twig_wood] = made.surface;
    let wood::Count {
        axes,
        without: unmeshed_axes,
        unwelded: unwelded_axes,
        sagitta: (sagitta_m, sagitta_sides),
    } = made.count;
    Ok(TreeMesh {
        wood,
        upper_wood,
        transition_wood,
        twig_wood,
        foliage: leaves.surface,
        dry,
        is_hull: leaves.is_hull,
        twigs: leaves.twigs,
        fruit,
        axes,
        unmeshed_axes,
        unwelded_axes,
        sagitta_m,
        sagitta_sides,
        twig_scale: leaves.twig_scale,
        leaf_cover: leaves.cover,
        stand_in: leaves.stand_in,
        is_meshed,
    })
}

/// What foliage is made beside.
#[derive(Clone, Copy)]
pub struct Beside<'a> {
    /// Of wood and fruit.
    pub triangles: usize,
    /// [`TreeMesh::is_meshed`].
    pub is_meshed: &'a [bool],
}

/// The foliage alone of what [`build`] makes of the same arguments, beside its wood and fruit.
///
/// # Errors
/// A model of the user's own that alone exceeds the budget.
pub fn leaves(
    skeleton: &Skeleton,
    species: &Species,
    atlas: &Atlas,
    options: &MeshOptions,
    beside: Beside<'_>,
    seed: Seed,
) -> Result<Surface> {
    let options = &options.as_borne(species, atlas);
    let seed = seed.derive("mesh", 0);
    let wind = options.wind.map(|profile| Wind::new(skeleton, skeleton.height_m(), profile, seed));
    let order = order(species, atlas, options, beside, wind.as_ref(), seed);
    Ok(foliage::foliage(skeleton, &order)?.surface)
}

fn order<'a>(
    species: &'a Species,
    atlas: &'a Atlas,
    options: &MeshOptions,
    beside: Beside<'a>,
    wind: Option<&'a Wind>,
    seed: Seed,
) -> foliage::Order<'a> {
    foliage::Order {
        species,
        atlas,
        level: options.foliage,
        budget: options.triangle_budget.map(|b| b.saturating_sub(beside.triangles)),
        is_meshed: beside.is_meshed,
        stalks: foliage::stalks(species, options),
        nearness: options.nearness(),
        detail: options.detail,
        twigs: options.twigs,
        is_on_dead: false,
        share: options.leaf_share,
        larger: options.larger,
        shaded: options.shaded,
        wind,
        seed,
    }
}

#[cfg(test)]
mod bark_tests;
#[cfg(test)]
mod foliage_tests;
#[cfg(test)]
mod stalk_tests;
#[cfg(test)]
mod tests;
