//! Foliage on the shoots that bear leaves, at one of several levels.
//!
//! Twigs stand along each bearing shoot by the species' phyllotaxis, one more prolongs its tip;
//! each is turned to the light as far as its shoot allows, hangs or stands by `droop`. A level says
//! what stands there: every leaf, a card with the twig's picture, or fewer and larger cards; or a
//! shell around all of them.
//!
//! With a budget, twigs are thinned evenly (inside the crown first) and the rest enlarged, with
//! boughs of the atlas in place of twigs. Cards are flat, and as small as may be, until all leaves are stood for; what
//! triangles are left raise some of them. Normals lean to the crown's outside, for soft shading,
//! and never away from the front of their triangles.

use std::array;

use glam::Vec3;
use rayon::prelude::*;

use super::card::Shape;
use super::cards::{Cards, coverage, usual_picture_m};
use super::leaf::{StandIn, Twig};
use super::piece::{Piece, Room, fill};
use super::spot::{Hull, Pose, Spot, spots, thinned};
use super::twigs::Twigs;
use super::wind::Wind;
use super::{MeshOptions, Surface, TwigsAs, form, middle, shell, stalk, stamp};
use crate::diagnostic::{Error, Result};
use crate::seed::Seed;
use crate::skeleton::Skeleton;
use crate::species::Species;
use crate::species::model::{Foliage as Leaves, LeafShape};
use crate::texture::Atlas;

/// What stands for the leaves, from nothing to every one of them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Default)]
pub enum FoliageLevel {
    /// A bare tree.
    None,
    /// One closed low-poly hull of the crown.
    Shell,
    /// Few enlarged cards.
    Sparse,
    /// A card with its picture for every twig.
    #[default]
    Cards,
    /// Every leaf with its petiole, every needle.
    Geometry,
}

impl FoliageLevel {
    /// As the leaves of a species are meshed: pictures and models of a user's own hold no single ones.
    pub fn of(self, species: &Species) -> FoliageLevel {
        if species.has_own_leaves() { self.min(FoliageLevel::Cards) } else { self }
    }
}

/// Triangles of foliage where no budget says less.
const MOST_TRIANGLES: usize = 40_000_000;
/// Cards of the sparse level, and triangles of a shell, at most.
const MOST_SPARSE: usize = 600;
const MOST_SHELL: usize = 400;
/// Shares of a crown's cards that may have relief, in so many steps.
const RELIEF_PARTS: usize = 16;
/// How far models of the user's, cards with relief and flat ones may grow to make up for those left out: a leaf so much
/// larger would be seen to be, but pictures of large cards show boughs.
const MOST_ENLARGED_MODELS: f32 = 3.0;
const MOST_ENLARGED_CARDS: f32 = 5.0;
const MOST_ENLARGED_FLAT: f32 = 6.0;

/// Cards further from wood than they are long, which one sees float, count by the square of that, and no
/// less than so much of others.
const AFLOAT: f32 = 0.2;

/// A card hangs in the air whose foot is more of its length away from where it leaves wood.
const GAP: f32 = 0.1;

/// Cards that keep near wood hide one another: share of what is lost so, by the inverse of how evenly they
/// count, that they are larger in area.
const CLUMPED: f32 = 0.5;

/// Forms of twigs that are stored once each, at most.
const MOST_FORMS: usize = 48;

/// Share of what cards left out for stalks would have hidden that the others are larger by, in area: the rest lay
/// behind these.
const HIDDEN: f32 = 0.5;

/// Heights in the crown, evenly from its foot to its top, at which the size of twigs is set.
pub const HEIGHTS: usize = 6;

/// How much each of [`HEIGHTS`] says of a place at a share of the crown's height: two of them do, and
/// together 1.
pub fn at_heights(share: f32) -> [f32; HEIGHTS] {
    let at = share.clamp(0.0, 1.0) * (HEIGHTS - 1) as f32;
    array::from_fn(|k| (1.0 - (at - k as f32).abs()).max(0.0))
}

/// Which cards have stalks from the wood that is meshed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stalks {
    None,
    /// Those that would hang in the air.
    Afloat,
    /// Those of bare twigs, which no leaves hide.
    All,
}

/// What one tree's foliage is made of.
pub struct Order<'a> {
    pub species: &'a Species,
    pub atlas: &'a Atlas,
    /// One [`FoliageLevel::of`] the species.
    pub level: FoliageLevel,
    /// Triangles it may take.
    pub budget: Option<usize>,
    /// Of the skeleton's nodes, whether wood goes along them: cards hang near it. Empty where one does
    /// not see what they hang from.
    pub is_meshed: &'a [bool],
    pub stalks: Stalks,
    /// How far cards keep near that wood, 0…1.
    pub nearness: f32,
    /// Cards of more rows.
    pub detail: bool,
    pub twigs: TwigsAs,
    /// On the branches that are dead instead of those that live.
    pub is_on_dead: bool,
    /// Of the places for leaves, those that bear them.
    pub share: f32,
    /// How much larger twigs are at each height than their number asks.
    pub larger: [f32; HEIGHTS],
    /// Share of the cards with pictures of boughs that show them in shade.
    pub shaded: f32,
    /// Asked for as vertex colours.
    pub wind: Option<&'a Wind>,
    pub seed: Seed,
}

impl Order<'_> {
    fn triangles(&self) -> usize {
        self.budget.unwrap_or(MOST_TRIANGLES).min(MOST_TRIANGLES)
    }
}

/// Foliage, how much larger than in nature its twigs are (0 where there are none), and what it
/// hides over what the species' leaves do, as far as that is known (1 elsewhere).
#[derive(Debug, PartialEq)]
pub struct Foliage {
    pub surface: Surface,
    pub is_hull: bool,
    pub twigs: Vec<Twigs>,
    pub twig_scale: f32,
    pub cover: f32,
    /// How such leaves stand for all of them.
    pub stand_in: Option<StandIn>,
}

impl Default for Foliage {
    fn default() -> Foliage {
        Foliage {
            surface: Surface::default(),
            is_hull: false,
            twigs: Vec::new(),
            twig_scale: 0.0,
            cover: 1.0,
            stand_in: None,
        }
    }
}

/// Foliage for a tree.
///
/// # Errors
/// A model of the user's that alone exceeds the budget.
pub fn foliage(skeleton: &Skeleton, order: &Order<'_>) -> Result<Foliage> {
    let Order { species, level, seed, .. } = *order;
    let f = &species.foliage;
    if level == FoliageLevel::None {
        return Ok(Foliage::default());
    }
    let bears = skeleton.bears_twigs(f.bearing_radius_m, order.is_on_dead);
    // The crown is that of all shoots, however few bear leaves; the same at any budget.
    let Some(hull) = Hull::around(skeleton, &bears) else { return Ok(Foliage::default()) };
    let f = &f.within(hull.longest_twig_m());
    let (mut spots, _) = spots(skeleton, f, &bears, &hull);
    if spots.is_empty() {
        return Ok(Foliage::default());
    }
    let share = order.share.clamp(0.0, 1.0);
    if share < 1.0 {
        spots.retain(|s| seed.derive("borne", s.key).draws().unit() < share);
        if spots.is_empty() {
            return Ok(Foliage::default());
        }
    }
    // Bare twigs hide nothing.
    if level == FoliageLevel::Shell && !f.is_bare() {
        let margin_m = 0.5 * f.twig_length_m.min(hull.half.max_element());
        let most = order.triangles().min(MOST_SHELL);
        let mut surface = shell::shell(&spots, &hull, margin_m, most);
        if let Some(wind) = order.wind {
            wind.whole_tree(&mut surface);
        }
        return Ok(Foliage { surface, is_hull: true, ..Foliage::default() });
    }
    let Plan { relief, twig, is_instanced, room, most, enlarge, card_m, cover } =
        plan(order, f, &hull, spots.len())?;
    let model = species.own_model.as_deref();
    let keeps_tips = twig.is_some() || hull.young > 0.0;
    let hold = |s: &Spot, reach_m: f32| {
        if order.is_meshed.get(s.node() as usize) != Some(&false) {
            return 1.0;
        }
        let away_m = hangs_from(skeleton, order, s).distance(s.at);
        let hold = (reach_m / away_m.max(reach_m)).powi(2).max(AFLOAT);
        1.0 + (hold - 1.0) * order.nearness
    };
    let is_cards = twig.is_none() && model.is_none();
    // From afar one does not see what cards hang from.
    let moves = match order.is_meshed.is_empty() && is_cards {
        true => middle::share(enlarge, spots.len(), most),
        false => 0.0,
    };
    let sample = (moves > 0.0).then(|| middle::sample(&spots, &hull, most));
    let (mut kept, evenness) =
        thinned(spots, &hull, most, enlarge, f.twig_length_m, keeps_tips, hold);
    let clumped = evenness.map(|even| (1.0 + CLUMPED * (even.recip() - 1.0)).sqrt());
    let larger: [f32; HEIGHTS] =
        array::from_fn(|k| order.larger[k] * if is_cards { clumped[k] } else { 1.0 });
    let larger_at = |s: &Spot| {
        let height = at_heights(hull.share(s.at.z));
        height.iter().zip(larger).map(|(share, larger)| share * larger).sum::<f32>()
    };
    // Fewer twigs rather than smaller ones than the species'.
    kept.retain(|s| {
        let size = enlarge * larger_at(s);
        size >= 1.0 || seed.derive("kept", s.key).draws().unit() < size * size
    });
    if kept.is_empty() {
        let cover = if twig.is_some() { 0.0 } else { 1.0 };
        return Ok(Foliage { cover, ..Foliage::default() });
    }
    let (mut hung, mut stalks) = (Vec::new(), 0);
    // Those that stay are larger for those that are left out for stalks.
    let mut made_up = 1.0;
    if is_cards && order.stalks != Stalks::None {
        let all = kept.len() as f32;
        // Where cards are left out, others may become such as carry more.
        loop {
            made_up = (1.0 + HIDDEN * (all / kept.len().max(1) as f32 - 1.0)).sqrt();
            // However a card is moved as far as it is longer than a twig.
            let hangs = |s: &Spot| {
                let away_m = hangs_from(skeleton, order, s).distance(s.at);
                let size_m = |enlarge: f32| hull.twig_m(s.at, f.twig_length_m, enlarge);
                let size = [size_m(enlarge) * larger_at(s) * made_up, size_m(1.0)];
                order.stalks == Stalks::All
                    || away_m > 0.0 && away_m * order.nearness > size[0] * (1.0 + GAP) - size[1]
            };
            hung = (0..kept.len()).filter(|&k| hangs(&kept[k])).collect();
            let spots: Vec<Spot> = hung.iter().map(|&k| kept[k]).collect();
            let feet = stalk::Feet::of(skeleton, order.is_meshed, &spots);
            stalks = feet.triangles(f.is_bare());
            let over = (kept.len() * room.triangles + stalks).saturating_sub(order.triangles());
            if over == 0 {
                break;
            }
            let each = room.triangles as f32 + stalks as f32 / kept.len() as f32;
            leave_out(&mut kept, (over as f32 / each).ceil() as usize);
        }
    }
    let middles = sample.map(|sample| middle::middles(&kept, &sample));
    let wind = order.wind.map(|wind| (wind, kept.as_slice()));
    let cards = seed.stage("card");
    let stand = |k: usize| {
        let mut draws = cards.seed(kept[k].key).draws();
        let larger = (larger_at(&kept[k]) * made_up).max(enlarge.recip());
        let mut pose = Pose::of(
            &kept[k],
            hangs_from(skeleton, order, &kept[k]),
            f,
            &hull,
            [enlarge, larger],
            &mut draws,
        );
        if let Some(middles) = &middles {
            pose.base += (middles[k] - kept[k].at) * moves;
        }
        if twig.is_some() || model.is_some() {
            pose.begin_on_shoot();
        }
        (pose, draws)
    };
    if is_instanced {
        let poses: Vec<Pose> = (0..kept.len()).into_par_iter().map(|k| stand(k).0).collect();
        let forms = (order.triangles() / room.triangles.max(1)).min(MOST_FORMS);
        let twigs = match (model, &twig) {
            (Some(model), _) => vec![stamp::gather(model, f.twig_length_m.max(1e-3), &poses)],
            (None, Some(twig)) => form::gather(twig, &poses, forms, seed),
            (None, None) => Vec::new(),
        };
        return Ok(Foliage { twigs, twig_scale: enlarge, cover, ..Foliage::default() });
    }
    let surface = match (model, &twig) {
        (Some(model), _) => {
            let emit = |k, out: &mut Piece| stamp::emit(model, &stand(k).0, stamp::BENT, out);
            fill(kept.len(), room, emit, wind)
        }
        (None, Some(twig)) => {
            let poses: Vec<Pose> = (0..kept.len()).into_par_iter().map(|k| stand(k).0).collect();
            form::set(twig, &poses, seed, wind)
        }
        (None, None) => {
            let left = order.triangles().saturating_sub(kept.len() * room.triangles + stalks);
            let is_raised = relief.chosen(&kept, left, seed);
            let (kept, shape) = (kept.as_slice(), relief.shape);
            let usual_m = usual_picture_m(order.atlas, card_m * made_up);
            let cards = Cards { skeleton, order, kept, is_raised, shape, usual_m };
            let mut surface = cards.surface(&stand);
            if !hung.is_empty() {
                surface.append(cards.stalks(&hung, &stand));
            }
            surface
        }
    };
    let stand_in = twig.as_ref().map(Twig::stands_in);
    Ok(Foliage { surface, twig_scale: enlarge * made_up, cover, stand_in, ..Foliage::default() })
}

/// Cards of which some are flat.
#[derive(Clone, Copy)]
struct Relief {
    /// Of those that are raised, and how large a share they may be.
    shape: Shape,
    share: f32,
}

impl Relief {
    fn between(self, of: impl Fn(Shape) -> f32) -> f32 {
        let [flat, raised] = [Shape::Flat, self.shape].map(of);
        flat + (raised - flat) * self.share
    }

    fn triangles(self) -> f32 {
        self.between(|shape| shape.room().triangles as f32)
    }

    fn shown(self) -> f32 {
        self.between(Shape::shown)
    }

    /// That every card has.
    fn room(self) -> Room {
        if self.share < 1.0 { Shape::Flat.room() } else { self.shape.room() }
    }

    /// Which of some cards have relief, where so many triangles are left beside [`Relief::room`] for each; with
    /// more triangles the same ones, and others.
    fn chosen(self, spots: &[Spot], left: usize, seed: Seed) -> Vec<bool> {
        let more = self.shape.room().triangles.saturating_sub(self.room().triangles);
        let share = (self.share * spots.len() as f32) as usize;
        let count = left.checked_div(more).map_or(spots.len(), |most| share.min(most));
        let is_all = self.share > 0.0 && count == spots.len();
        let mut is_raised = vec![is_all; spots.len()];
        if count > 0 && !is_all {
            let turns = seed.stage("relief");
            let turn = |k: usize| (turns.seed(spots[k].key).draws().unit(), k);
            let mut order: Vec<(f32, usize)> = (0..spots.len()).map(turn).collect();
            order.select_nth_unstable_by(count, |a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
            order[..count].iter().for_each(|&(_, k)| is_raised[k] = true);
        }
        is_raised
    }
}

/// What stands for the leaves, how many of it and how large.
struct Plan<'a> {
    relief: Relief,
    /// Where every leaf stands for itself.
    twig: Option<Twig<'a>>,
    is_instanced: bool,
    /// Of one of them.
    room: Room,
    most: usize,
    enlarge: f32,
    /// About as large as most cards are.
    card_m: f32,
    /// What they hide over what the species' leaves do.
    cover: f32,
}

/// The plan for a crown of `all` places, whose leaves are `f`.
///
/// # Errors
/// A model of the user's, or a twig that is stored once, that alone exceeds the budget.
fn plan<'a>(order: &Order<'a>, f: &'a Leaves, hull: &Hull, all: usize) -> Result<Plan<'a>> {
    let Order { species, atlas, level, .. } = *order;
    let share = order.share.clamp(0.0, 1.0);
    let budget = order.triangles();
    let is_sparse = matches!(level, FoliageLevel::Sparse | FoliageLevel::Shell);
    let fewest = all.min(hull.fewest_twigs(share));
    let least_sq_m = least_sq_m(hull, f, atlas, fewest, share);
    let enough = |relief: Relief, coverage: f32| {
        let shown = relief.shown() * coverage;
        enough(hull, f, shown, all, share).max(least_sq_m / card_sq_m(f, shown))
    };
    // Cards of twigs' own size that hide as much as all leaves do.
    let covered = covered_by_twigs(atlas, f);
    let of_cards = |relief: Relief| all.min(enough(relief, covered).ceil() as usize);
    let fits = |of: &Relief| of.triangles() * of_cards(*of) as f32 <= budget as f32;
    // As many as that come first: small cards are nearer to leaves than raised ones. What triangles are left give
    // relief to some, and where there are enough to all, and finer relief.
    let parts = match is_sparse {
        true => 0,
        false if f.is_bare() => 1,
        false => RELIEF_PARTS,
    };
    let light = |part: usize| Relief {
        shape: Shape::of(f, false),
        share: part as f32 / parts.max(1) as f32,
    };
    // From near, pines' needles stand about their shoot, and sprays of spruces and firs hang as one.
    let is_near = parts == RELIEF_PARTS && order.nearness > 0.0;
    let all_raised = is_near && matches!(f.shape, LeafShape::Bundle | LeafShape::Needle);
    let mixed = || (1..=parts).rev().map(light).find(fits).unwrap_or(light(0));
    let relief = if all_raised { light(parts) } else { mixed() };
    let fine = Relief { shape: Shape::of(f, true), share: 1.0 };
    let is_fine = order.detail && relief.share == 1.0 && fits(&fine);
    let relief = if is_fine { fine } else { relief };
    let model = species.own_model.as_deref();
    let is_leaf_by_leaf = level == FoliageLevel::Geometry;
    // As many of a model as hide what the species' leaves do.
    let of_models = model.map(|m| self::enough(hull, f, m.shown(), all, share).max(1.0));
    // Then the budget is for the forms alone.
    let is_instanced = order.twigs == TwigsAs::Instanced && (is_leaf_by_leaf || model.is_some());
    let stored = budget;
    let budget = if is_instanced { usize::MAX } else { budget };
    let mut twig = is_leaf_by_leaf.then(|| {
        let leaves_sq_m = share * f.cover.clamp(0.0, 1.0) * hull.area_sq_m();
        Twig::new(f, atlas, [fewest, all], leaves_sq_m, budget)
    });
    let room = match (model, &twig) {
        (Some(model), _) => stamp::room(model),
        (None, Some(twig)) => twig.room(),
        (None, None) => relief.room(),
    };
    let more = |or: &str| {
        let beside = room.triangles.saturating_sub(stored);
        format!("give the tree {beside} --triangles more, and some for its wood{or}")
    };
    if let Some(model) = model
        && room.triangles > stored
    {
        let name = model.name.display();
        let n = room.triangles;
        return Err(Error::new(format!("the model {name} has {n} triangles, the crown {stored}"))
            .remedy(more(", or the model fewer")));
    }
    if is_instanced && room.triangles > stored {
        let n = room.triangles;
        let told = format!("a twig with all its leaves has {n} triangles, the crown {stored}");
        return Err(Error::new(told).remedy(more("")));
    }
    let stalks = if order.stalks == Stalks::All { stalk::EACH } else { 0.0 };
    let each = match model {
        Some(_) => room.triangles as f32,
        None => relief.triangles() + stalks,
    };
    let most = twig.as_ref().map_or((budget as f32 / each) as usize, |t| t.count);
    let most = if is_sparse { most.min(MOST_SPARSE) } else { most };
    let most = if twig.is_none() && model.is_none() { most.min(of_cards(relief)) } else { most };
    let limit = match model {
        _ if is_sparse => MOST_ENLARGED_FLAT,
        Some(_) => MOST_ENLARGED_MODELS,
        None if relief.share == 0.0 => MOST_ENLARGED_FLAT,
        None => MOST_ENLARGED_CARDS,
    };
    let by_cards = |coverage: f32| {
        let needed = of_models.unwrap_or_else(|| enough(relief, coverage));
        (needed / all.min(most).max(1) as f32).sqrt().clamp(1.0, limit)
    };
    // By the pictures that most cards have.
    let card_m = f.twig_length_m * by_cards(coverage(atlas, 0..atlas.cells().len()));
    let usual_m = usual_picture_m(atlas, card_m);
    let of_usual = || by_cards(coverage(atlas, atlas.nearest(usual_m)));
    let enlarge = twig.as_ref().map_or_else(of_usual, |t| t.scale);
    if let Some(twig) = &mut twig {
        twig.grow(enlarge);
    }
    let hides = |needed: f32| (all.min(most) as f32 * enlarge.powi(2) / needed).min(1.0);
    let cover = match (&twig, of_models) {
        (Some(twig), _) => twig.cover,
        (None, Some(needed)) => hides(needed),
        (None, None) if is_sparse || f.is_bare() => 1.0,
        (None, None) => hides(enough(relief, coverage(atlas, atlas.nearest(usual_m)))),
    };
    Ok(Plan { relief, twig, is_instanced, room, most, enlarge, card_m, cover })
}

/// Triangles that the cards of a leafy tree take though they may take `most`; `None` where that may be all of
/// them.
pub fn taken_by_cards(
    skeleton: &Skeleton,
    species: &Species,
    atlas: &Atlas,
    options: &MeshOptions,
    most: usize,
) -> Option<usize> {
    let f = &species.foliage;
    let is_other = species.own_model.is_some() || species.own_fruit.is_some();
    if options.foliage != FoliageLevel::Cards || f.is_bare() || is_other {
        return None;
    }
    let hull = Hull::around(skeleton, &skeleton.bears_leaves(f.bearing_radius_m))?;
    let f = &f.within(hull.longest_twig_m());
    let covered = covered_by_twigs(atlas, f);
    let share = options.leaf_share.clamp(0.0, 1.0);
    if least_sq_m(&hull, f, atlas, hull.fewest_twigs(share), share) > 0.0 {
        return None;
    }
    let taken = |shape: Shape| {
        let cards = enough(&hull, f, shape.shown() * covered, usize::MAX, share);
        shape.room().triangles * cards.ceil() as usize
    };
    let [fine, light] = [true, false].map(|fine| Shape::of(f, fine));
    let flat = (!options.has_near_cards()).then_some(Shape::Flat);
    let shapes = options.detail.then_some(fine).into_iter().chain([light]).chain(flat);
    shapes.map(taken).find(|taken| *taken <= most)
}

/// Which cards of a tree have stalks: seen from near, and with a picture that has wood.
pub fn stalks(species: &Species, options: &MeshOptions) -> Stalks {
    match options.has_near_cards() && !species.has_own_leaves() {
        false => Stalks::None,
        true if species.foliage.is_bare() => Stalks::All,
        true => Stalks::Afloat,
    }
}

/// Leaves out so many, evenly over all.
fn leave_out(spots: &mut Vec<Spot>, count: usize) {
    let (all, mut k) = (spots.len(), 0);
    spots.retain(|_| {
        k += 1;
        k * count / all == (k - 1) * count / all
    });
}

/// The wood to which a card is moved that is larger than a twig.
fn hangs_from(skeleton: &Skeleton, order: &Order<'_>, spot: &Spot) -> Vec3 {
    match order.is_meshed.get(spot.node() as usize) {
        Some(false) if order.stalks != Stalks::All => leaves_wood(skeleton, order.is_meshed, spot),
        _ => spot.at,
    }
}

/// Where the shoots on which a twig stands leave wood that is meshed.
fn leaves_wood(skeleton: &Skeleton, is_meshed: &[bool], spot: &Spot) -> Vec3 {
    let mut at = skeleton.parent_of(spot.node()).unwrap_or(0);
    while !is_meshed[at as usize]
        && let Some(before) = skeleton.parent_of(at)
    {
        at = before;
    }
    skeleton.position[at as usize]
}

/// How many cards as large as twigs cover as much of the crown's hull as the species' leaves do;
/// `shown`: of a card's square. Of bare twigs, all.
fn enough(hull: &Hull, f: &Leaves, shown: f32, all: usize, share: f32) -> f32 {
    if f.is_bare() {
        return all as f32;
    }
    leaves_sq_m(hull, f, share) / card_sq_m(f, shown)
}

/// Area of the cards, or of the leaves, that cover as much of the crown's hull as the species' leaves do.
fn leaves_sq_m(hull: &Hull, f: &Leaves, share: f32) -> f32 {
    share * f.kept.min(1.0) * f.cover.clamp(0.0, 1.0) * hull.area_sq_m()
}

/// Leaves of so many twigs, where they are more than the species' own; bare ones hide nothing.
fn least_sq_m(hull: &Hull, f: &Leaves, atlas: &Atlas, twigs: usize, share: f32) -> f32 {
    let own_sq_m = leaves_sq_m(hull, f, share);
    let of = |one_sq_m: f32| twigs as f32 * one_sq_m;
    // It takes long to measure a twig.
    if f.is_bare() || of(Twig::counts_at_most_sq_m(f)) <= own_sq_m {
        return 0.0;
    }
    let sq_m = of(Twig::counts_sq_m(f, atlas));
    if sq_m > own_sq_m { sq_m } else { 0.0 }
}

/// What a card as large as a twig shows, `shown` of its square.
fn card_sq_m(f: &Leaves, shown: f32) -> f32 {
    shown.max(0.03) * f.twig_length_m.max(1e-3).powi(2)
}

/// Opaque share of the pictures for cards as large as twigs.
fn covered_by_twigs(atlas: &Atlas, f: &Leaves) -> f32 {
    coverage(atlas, atlas.nearest(usual_picture_m(atlas, f.twig_length_m)))
}
