//! Where foliage grows: places along the shoots that bear leaves, and the crown around them.

use glam::{Quat, Vec3, Vec3A};

use super::foliage::HEIGHTS;
use crate::seed::Draws;
use crate::skeleton::{Axis, Skeleton};
use crate::species::model::{Foliage, LeafShape, youth};

/// Golden angle.
pub const GOLDEN_RAD: f32 = 2.399_963;
/// Places a tree may have at most.
const MOST_SPOTS: usize = 2_000_000;

/// Twigs on one internode are told apart by so many bits of their keys.
const KEY_BITS: u32 = 16;
/// Twigs beside one internode at most; the keys above are its tip's and those that clothe a leader.
const MOST_ON_NODE: usize = (1 << KEY_BITS) - 2 - MOST_CLOTHING as usize;

/// A place for a twig.
#[derive(Debug, Clone, Copy)]
pub struct Spot {
    pub at: Vec3,
    /// Direction of the shoot.
    pub shoot: Vec3,
    /// Count along the axis, for phyllotaxis.
    pub turn: u32,
    pub is_tip: bool,
    /// The twig at the apex, and those that clothe a young tree's leader: they stand, and always stay.
    pub is_leader: bool,
    pub key: u64,
}

impl Spot {
    /// The node at the end of the shoot it stands on.
    pub fn node(&self) -> u32 {
        (self.key >> KEY_BITS) as u32
    }
}

/// The crown as an upright ellipsoid: says which way is out; and how wide it is at each height.
#[derive(Debug, Clone, Copy)]
pub struct Hull {
    pub centre: Vec3,
    pub half: Vec3,
    /// The highest place for a twig.
    pub apex: Vec3,
    /// How far the crown's top reaches sideways for each metre below the apex.
    pub tip_slope: f32,
    /// How young it is, by [`youth`].
    pub young: f32,
    /// Half the crown's width in layers of one thickness, from its foot to its apex.
    half_width_m: [f32; LAYERS],
    /// Inverses of `half`.
    per_half: Vec3,
}

const LAYERS: usize = 24;
/// Longest cards for several twigs, over the half width of the crown at their height.
const FIT: f32 = 1.6;

/// Share of the crown's height that counts as its top.
const TOP: f32 = 0.1;
/// Twigs at the apex of a spire are so long, as a share of their usual length, and its leader.
const TIP_TWIG: f32 = 0.3;
const LEADER: f32 = 0.85;
/// The same of a young tree, which is no spire yet, and the least slope of its top.
const YOUNG_TIP: f32 = 0.6;
const YOUNG_SLOPE: f32 = 0.35;
/// No place for a twig counts more than so many of usual ones, however small its twig.
const MOST_WEIGHT: f32 = 6.0;
/// … and deep inside a crown no less than so much of one outside.
const LEAST_WEIGHT: f32 = 0.35;
/// Where every leaf is seen, so are bare ends of shoots: there a twig counts so much more than beside.
const TIP_WEIGHT: f32 = 4.0;
/// Length of a twig over half that of the crown, at most.
const MOST_OF_CROWN: f32 = 0.6;
/// The leader of a young tree has leaves of its own over so much of the tree's height, in twigs along
/// it that begin so much of their length apart, and no more than so many.
const CLOTHED: f32 = 0.4;
const APART: f32 = 0.6;
const MOST_CLOTHING: u32 = 64;

/// Twigs that trees of up to a height have at least; higher ones fewer by the square of that.
const FEWEST_TWIGS: f32 = 3_200.0;
const ALL_TWIGS_M: f32 = 2.0;

impl Hull {
    /// Around the nodes at the ends of the shoots that bear leaves; `None` for none.
    pub fn around(skeleton: &Skeleton, bears: &[bool]) -> Option<Hull> {
        let places =
            || skeleton.position.iter().zip(bears).filter(|(_, bears)| **bears).map(|(p, _)| *p);
        let highest = |a: Vec3, b: Vec3| if b.z > a.z { b } else { a };
        let apex = places().reduce(highest)?;
        let (lo, hi) = places().fold((apex, apex), |(lo, hi), p| (lo.min(p), hi.max(p)));
        let top_m = (TOP * (hi.z - lo.z)).max(0.05);
        let in_top = places().filter(|p| p.z >= apex.z - top_m);
        let reach_m = in_top.map(|p| (p - apex).truncate().length()).fold(0.0, f32::max);
        let mut layers = [None; LAYERS];
        let per_m = LAYERS as f32 / (hi.z - lo.z).max(1e-6);
        for p in places() {
            let layer = &mut layers[(((p.z - lo.z) * per_m) as usize).min(LAYERS - 1)];
            let p = p.truncate();
            let (low, high) = layer.unwrap_or((p, p));
            *layer = Some((p.min(low), p.max(high)));
        }
        let mut half_width_m = [0.0; LAYERS];
        let mut below_m = 0.0;
        for (half_m, layer) in half_width_m.iter_mut().zip(layers) {
            below_m = layer.map_or(below_m, |(low, high)| 0.25 * (high - low).element_sum());
            *half_m = below_m;
        }
        let centre =
            Vec3::new(0.5 * (lo.x + hi.x), 0.5 * (lo.y + hi.y), lo.z + 0.35 * (hi.z - lo.z));
        let half = ((hi - lo) * Vec3::new(0.5, 0.5, 0.65)).max(Vec3::splat(0.05));
        let young = youth(apex.z);
        let tip_slope = (reach_m / top_m).max(YOUNG_SLOPE * young);
        Some(Hull { centre, half, apex, tip_slope, young, half_width_m, per_half: half.recip() })
    }

    /// The same without a spire: nothing is shorter near its leader.
    pub fn blunt(self) -> Hull {
        Hull { tip_slope: 1e9, ..self }
    }

    /// The longest twig for which the crown has room.
    pub fn longest_twig_m(&self) -> f32 {
        MOST_OF_CROWN * self.half.max_element()
    }

    /// Twigs of the species' size that there are at least, where a crown has so many and bears a `share` of
    /// its leaves: the smaller a tree, the more of its shoots are in the light.
    pub fn fewest_twigs(&self, share: f32) -> usize {
        let small = (ALL_TWIGS_M / self.apex.z.max(ALL_TWIGS_M)).powi(2);
        (share * FEWEST_TWIGS * small) as usize
    }

    /// How much shorter a twig of a given length is, so that a spire narrows to its leader.
    fn tapered(&self, at: Vec3, twig_m: f32) -> f32 {
        if at == self.apex {
            return LEADER;
        }
        let room_m = (self.apex.z - at.z) * self.tip_slope;
        let tip = TIP_TWIG + (YOUNG_TIP - TIP_TWIG) * self.young;
        if room_m > twig_m { 1.0 } else { (room_m / twig_m + tip).min(1.0) }
    }

    /// Unit direction outwards at a place.
    fn outward(&self, p: Vec3) -> Vec3 {
        ((p - self.centre) * self.per_half * self.per_half).normalize_or(Vec3::Z)
    }

    /// How far out a place is: 1 at the hull.
    pub fn depth(&self, p: Vec3) -> f32 {
        ((p - self.centre) * self.per_half).length()
    }

    /// What a place counts, inside the crown less; not of a young one, which casts no shade.
    pub fn weight(&self, p: Vec3) -> f32 {
        self.depth(p).clamp(LEAST_WEIGHT + (1.0 - LEAST_WEIGHT) * self.young, 1.0)
    }

    /// Size of a twig at a place over its usual length: less towards the top, where shoots are
    /// young. `enlarge` makes up for twigs left out.
    pub fn scale(&self, p: Vec3, enlarge: f32) -> f32 {
        let height = ((p.z - self.centre.z) * self.per_half.z / 1.5).clamp(0.0, 1.0);
        (1.0 - 0.3 * height * height) * (1.0 + (enlarge - 1.0) * (1.0 - 0.35 * height))
    }

    /// The share of the crown's height that a place is at, 0…1.
    pub fn share(&self, z: f32) -> f32 {
        ((z - self.centre.z) * (0.65 * self.per_half.z) + 0.35).clamp(0.0, 1.0)
    }

    /// Length of a twig at a place, `twig_m` long as a rule; where it stands for several, no longer than
    /// suits the crown's width there, nor than it is above ground, from which it would have to be raised.
    pub fn twig_m(&self, at: Vec3, twig_m: f32, enlarge: f32) -> f32 {
        self.twigs_m(at, twig_m, [enlarge])[0]
    }

    /// The same of twigs that stand for more and for fewer.
    fn twigs_m<const N: usize>(&self, at: Vec3, twig_m: f32, enlarge: [f32; N]) -> [f32; N] {
        let twig_m = twig_m * self.tapered(at, twig_m);
        let layer = (self.share(at.z) * LAYERS as f32 - 0.5).clamp(0.0, (LAYERS - 1) as f32);
        let below = layer as usize;
        let t = layer - below as f32;
        let above = (below + 1).min(LAYERS - 1);
        let half_m = self.half_width_m[below] * (1.0 - t) + self.half_width_m[above] * t;
        let most_m = (FIT * half_m).min(at.z).max(twig_m * self.scale(at, 1.0));
        enlarge.map(|enlarge| (twig_m * self.scale(at, enlarge)).min(most_m))
    }

    /// The height at a share of the crown's.
    pub fn height_m(&self, share: f32) -> f32 {
        let high = self.half.z / 0.65;
        self.centre.z + (share - 0.35) * high
    }

    /// Square metres, near enough (Thomsen).
    pub fn area_sq_m(&self) -> f32 {
        const P: f32 = 1.6;
        let [a, b, c] = self.half.to_array().map(|h| h.powf(P));
        4.0 * std::f32::consts::PI * ((a * b + a * c + b * c) / 3.0).powf(1.0 / P)
    }
}

/// Every place for a twig, in the order of axes and from base to tip: where twigs are shorter, they
/// are as much closer; and how many a metre of shoots there are where they are not: fewer than the species
/// has where it would have more than [`MOST_SPOTS`]. `bears`: which nodes end a shoot with leaves.
pub fn spots(skeleton: &Skeleton, f: &Foliage, bears: &[bool], hull: &Hull) -> (Vec<Spot>, f32) {
    let twig_m = f.twig_length_m.max(1e-3);
    let shoots_m: f32 = (0..skeleton.len() as u32)
        .filter(|&i| bears[i as usize])
        .map(|i| skeleton.internode_m(i) / hull.tapered(skeleton.position[i as usize], twig_m))
        .sum();
    let per_m = f.twigs_per_m.max(0.01).min(MOST_SPOTS as f32 / shoots_m.max(1e-3));
    let axes = skeleton.axes();
    let mut out = Vec::with_capacity((shoots_m * per_m) as usize + axes.iter().len());
    for axis in axes.iter() {
        let count = axis.nodes.len();
        let mut due = 0.5;
        let mut turn = (axis.nodes.first().copied().unwrap_or(0)) % 89;
        let mut from = axis.base.map(|base| skeleton.position[base as usize]);
        for (k, &i) in axis.nodes.iter().enumerate() {
            let b = skeleton.position[i as usize];
            let Some(a) = from.replace(b).filter(|_| bears[i as usize]) else { continue };
            let step = b - a;
            let (shoot, run) = step.normalize_and_length();
            let first = due;
            let more = run * per_m / hull.tapered(b, twig_m);
            due += more;
            let twigs = (due as usize).min(MOST_ON_NODE);
            let per_twig = more.max(1e-9).recip();
            for c in 0..twigs {
                let t = ((c as f32 + 1.0 - first) * per_twig).clamp(0.0, 1.0);
                out.push(Spot {
                    at: a + step * t,
                    shoot,
                    turn,
                    is_tip: false,
                    is_leader: false,
                    key: (u64::from(i) << KEY_BITS) | c as u64,
                });
                turn += 1;
            }
            due = due.fract();
            if k + 1 == count {
                out.push(Spot {
                    at: b,
                    shoot,
                    turn,
                    is_tip: true,
                    is_leader: b == hull.apex,
                    key: (u64::from(i) << KEY_BITS) | ((1 << KEY_BITS) - 1),
                });
            }
        }
        if axis.order == 0 {
            clothe(skeleton, &axis, f, bears, hull, &mut out);
        }
    }
    (out, per_m)
}

/// Twigs along the leader of a young tree, which no branches hide, from its tip down.
fn clothe(
    skeleton: &Skeleton,
    axis: &Axis,
    f: &Foliage,
    bears: &[bool],
    hull: &Hull,
    out: &mut Vec<Spot>,
) {
    // Up to two metres whole, less up to three.
    let share = CLOTHED * (2.0 * hull.young).min(1.0);
    let lowest_m = hull.apex.z * (1.0 - share);
    let twig_m = f.twig_length_m.max(1e-3);
    let apart_m = |at: Vec3| APART * hull.twig_m(at, twig_m, 1.0);
    // Not the apex, where twigs are longer.
    let mut due_m = apart_m(hull.apex - 1e-3 * Vec3::Z);
    let mut count = 0;
    for &i in axis.nodes.iter().rev() {
        let Some(parent) = skeleton.parent_of(i).filter(|_| bears[i as usize]) else { return };
        let (tip, foot) = (skeleton.position[i as usize], skeleton.position[parent as usize]);
        let step = foot - tip;
        let run_m = step.length();
        while due_m < run_m {
            let at = tip + step * (due_m / run_m);
            if at.z < lowest_m || count == MOST_CLOTHING {
                return;
            }
            count += 1;
            out.push(Spot {
                at,
                shoot: (-step).normalize_or(Vec3::Z),
                turn: count,
                is_tip: true,
                is_leader: true,
                // Counted down from the tip's, which no twig beside the shoot comes to.
                key: (u64::from(i) << KEY_BITS) | u64::from((1 << KEY_BITS) - 1 - count),
            });
            due_m += apart_m(at);
        }
        due_m -= run_m;
    }
}

/// Layers of a crown in which so many twigs are spread evenly: about as far apart as the twigs around.
fn layers(twigs: usize) -> f32 {
    (0.7 * (twigs as f32).sqrt()).clamp(4.0, 64.0).floor()
}

/// What weights are taken times so that they come to `most` though none may come to more than 1.
fn rate(weights: &[f32], total: f64, most: f64) -> f64 {
    /// Each makes up by the rest for those that would come to more.
    const ROUNDS: usize = 12;
    let mut rate = most / total.max(1e-9);
    for _ in 0..ROUNDS {
        let full = weights.iter().map(|&w| f64::from(w)).filter(|w| w * rate >= 1.0);
        let (whole, sum) = full.fold((0.0, 0.0), |(n, sum), w| (n + 1.0, sum + w));
        rate = rate.max((most - whole) / (total - sum).max(1e-9));
    }
    rate
}

/// The numbers of things in the order of their places, which are below `places`; those of one place in their
/// own order.
fn by_place(place: &[u32], places: usize) -> Vec<u32> {
    // Sorted by counting.
    let mut next = vec![0; places];
    place.iter().for_each(|&p| next[p as usize] += 1);
    let mut before = 0;
    for n in &mut next {
        (*n, before) = (before, before + *n);
    }
    let mut out = vec![0; place.len()];
    for (k, &p) in (0..).zip(place) {
        let slot = &mut next[p as usize];
        out[*slot as usize] = k;
        *slot += 1;
    }
    out
}

/// Places around a crown, layer by layer. Layers and the directions in each are about as many as leave one
/// of `most` spots to each.
struct Places {
    layers: f32,
    turns: f32,
    in_layer: usize,
}

impl Places {
    fn new(most: usize) -> Places {
        const MOST_TURNS: f32 = 1_024.0;
        let layers = layers(most);
        let turns = (most as f32 / layers).clamp(4.0, MOST_TURNS).ceil();
        Places { layers, turns, in_layer: turns as usize }
    }

    fn count(&self) -> usize {
        (self.layers as usize + 2) * self.in_layer
    }

    /// The leader's is the first.
    fn of(&self, spot: &Spot, hull: &Hull) -> u32 {
        if spot.is_leader {
            return 0;
        }
        let layer = 1 + (hull.share(spot.at.z) * self.layers) as usize;
        // As angles do it grows around, from 0 to 4, without a root.
        let away = (spot.at - hull.centre).truncate();
        let x = away.x / (away.x.abs() + away.y.abs()).max(1e-9);
        let turn = if away.y < 0.0 { 3.0 + x } else { 1.0 - x };
        let turn = ((turn * 0.25 * self.turns) as usize).min(self.in_layer - 1);
        (layer * self.in_layer + turn) as u32
    }
}

/// About `most` of the spots, in their order, evenly over heights and directions: those deep inside the
/// crown go first, but of a young one, which casts no shade; where twigs, `twig_m` long as a rule, are
/// small more stay, so that a spire is as full at its tip, and a shrub at its foot, as between.
/// `keeps_tips`: more of those at the ends of shoots; `hold`: what else each counts, by its length. Tells how
/// evenly they count by that at each height: as if so large a share counted alike and the rest not at all.
pub fn thinned(
    mut spots: Vec<Spot>,
    hull: &Hull,
    most: usize,
    enlarge: f32,
    twig_m: f32,
    keeps_tips: bool,
    hold: impl Fn(&Spot, f32) -> f32,
) -> (Vec<Spot>, [f32; HEIGHTS]) {
    const STEPS: usize = 256;
    if spots.len() <= most {
        return (spots, [1.0; HEIGHTS]);
    }
    let usual_m = twig_m * hull.scale(Vec3::ZERO, enlarge);
    // Lengths change with height alone.
    let at_height: [_; STEPS] = std::array::from_fn(|step| {
        let z = hull.height_m((step as f32 + 0.5) / STEPS as f32);
        let twig_m = hull.twig_m(hull.centre.with_z(z), twig_m, enlarge);
        (twig_m, (usual_m / twig_m).powi(2).min(MOST_WEIGHT))
    });
    // At each height how many there are, what is missing where they do not count whole, and of their squares.
    let mut held = [(0u32, 0.0f64, 0.0f64); HEIGHTS];
    let mut weight = |s: &Spot| {
        let height = hull.share(s.at.z);
        let (twig_m, small) = at_height[((height * STEPS as f32) as usize).min(STEPS - 1)];
        let tip = if keeps_tips && s.is_tip { TIP_WEIGHT } else { 1.0 };
        let hold = hold(s, twig_m);
        let (count, less, less_sq) = &mut held[(height * (HEIGHTS - 1) as f32 + 0.5) as usize];
        *count += 1;
        if hold < 1.0 {
            *less += f64::from(1.0 - hold);
            *less_sq += f64::from(1.0 - hold * hold);
        }
        hold * tip * hull.weight(s.at) * small
    };
    let places = Places::new(most);
    let mut total = 0.0;
    let each = spots.iter().map(|s| {
        let weight = weight(s);
        total += f64::from(weight);
        (weight, places.of(s, hull))
    });
    let (weights, place): (Vec<f32>, Vec<u32>) = each.unzip();
    let evenness = held.map(|(count, less, less_sq)| {
        let count = f64::from(count.max(1));
        ((count - less).powi(2) / ((count - less_sq) * count)) as f32
    });
    let rate = match keeps_tips {
        true => rate(&weights, total, most as f64),
        false => most as f64 / total.max(1e-9),
    };
    // Its places come first.
    let leaders = place.iter().filter(|&&p| p == 0).count();
    let mut is_kept = vec![false; spots.len()];
    let (mut due, mut left) = (0.5, most);
    for (n, k) in by_place(&place, places.count()).into_iter().enumerate() {
        let k = k as usize;
        due += if n < leaders { 1.0 } else { (f64::from(weights[k]) * rate).min(1.0) };
        if due >= 1.0 && left > 0 {
            due -= 1.0;
            left -= 1;
            is_kept[k] = true;
        }
    }
    let mut is_kept = is_kept.into_iter();
    spots.retain(|_| is_kept.next() == Some(true));
    (spots, evenness)
}

/// How the twigs of a leaf shape stand.
pub struct Stance {
    /// Angle from the shoot, radians.
    angle: f32,
    /// Twigs left and right of the shoot in one plane, rather than all round.
    pub is_flat: bool,
    /// Downward (+) fold of both halves of a card, radians.
    pub fold: f32,
    /// Spread of the roll about the twig, radians.
    roll: f32,
    /// Share of the light from above against that from outside in turning a twig.
    from_above: f32,
}

pub fn stance(shape: LeafShape) -> Stance {
    let s =
        |angle, is_flat, fold, roll, from_above| Stance { angle, is_flat, fold, roll, from_above };
    match shape {
        LeafShape::Needle => s(0.85, true, 0.5, 0.45, 0.75),
        LeafShape::Tuft => s(0.75, false, 0.55, 0.9, 0.6),
        LeafShape::Bundle => s(0.75, false, 0.0, 0.9, 0.6),
        LeafShape::Deltoid => s(0.7, false, 0.45, 0.7, 0.35),
        LeafShape::Lanceolate => s(0.6, false, 0.45, 0.7, 0.45),
        LeafShape::Ovate
        | LeafShape::Round
        | LeafShape::Cordate
        | LeafShape::Obovate
        | LeafShape::Lobed
        | LeafShape::Pinnate => s(0.85, false, 0.5, 0.6, 0.55),
    }
}

/// Twigs enlarged more than so many times stand for boughs, which end where twigs do: the share of
/// what they are longer that lies further in.
const BOUGH_FROM: f32 = 2.4;
const INWARD: f32 = 0.75;
/// How far beyond a twig's end one that stands for more may reach, share of the crown's half width.
const OUT: f32 = 0.15;
/// … and from where on they turn from the light above to that from outside, and go where their twigs are.
const TURN_FROM: f32 = 1.6;

/// Whether cards enlarged so much stand for many twigs, 0…1.
pub fn stands_for_many(enlarge: f32) -> f32 {
    ((enlarge - TURN_FROM) / TURN_FROM).clamp(0.0, 1.0)
}

/// How far before its shoot a card begins, share of its length.
const STALK: f32 = 0.04;
/// The highest twig begins so much of its length below its place, or the shoot under it is bare; not of a
/// young tree, whose leader has twigs along it.
const CLOTHES: f32 = 0.5;
/// Fall of the tips of twigs that hang, share of their length.
pub const SAG: [f32; 2] = [0.05, 0.28];

/// Share of the way from the crown's middle in where its outside is; the rest is across its ellipsoid.
const AWAY: f32 = 0.4;

/// How one twig stands.
#[derive(Debug, Clone, Copy)]
pub struct Pose {
    pub base: Vec3,
    /// Unit, from base to tip.
    pub heading: Vec3,
    /// Unit, at right angles to `heading`; the side to the light.
    pub facing: Vec3,
    /// Length of the twig: the side of its cell on a card.
    pub size_m: f32,
    /// Fall of the tip, share of the size.
    pub sag: f32,
    pub mirrored: bool,
    /// Unit, out of the crown.
    pub outward: Vec3,
    pub crown: Vec3,
    /// Normals are a surface's own, not bent to the crown's outside.
    pub is_plain: bool,
}

impl Pose {
    /// Where it ends if it is straight.
    pub fn tip(&self) -> Vec3 {
        self.base + self.heading * self.size_m
    }

    /// A card that stands for several twigs, and would hang into the ground, is raised out of it where
    /// half its length will do.
    pub fn lift(&mut self) {
        let side = 0.5 * self.heading.cross(self.facing).z.abs();
        let low = self.size_m * (self.heading.z - self.sag).min(0.0) - self.size_m * side;
        let into_m = -(self.base.z + low);
        if (0.0..0.5 * self.size_m).contains(&into_m) {
            self.base.z += into_m;
        }
    }

    /// Begins on the shoot, not before it, where a card shows a bare stalk.
    pub fn begin_on_shoot(&mut self) {
        self.base += self.heading * (STALK * self.size_m);
    }

    /// Of a twig alone, along the x axis: what it hides is measured so.
    pub fn measured(f: &Foliage) -> Pose {
        Pose {
            base: Vec3::ZERO,
            heading: Vec3::X,
            facing: Vec3::Z,
            size_m: f.twig_length_m.clamp(1e-3, 20.0),
            sag: 0.1,
            mirrored: false,
            outward: Vec3::Z,
            crown: Vec3::ZERO,
            is_plain: true,
        }
    }

    /// A normal between a surface's own and the crown's outside at a place: soft from far, its own
    /// from near. `share`: of the crown.
    #[inline]
    pub fn bent(&self, own: Vec3A, at: Vec3A, share: f32) -> Vec3A {
        if self.is_plain {
            return own;
        }
        own * (1.0 - share) + self.out_at(at) * share
    }

    /// [`Pose::bent`] as a function of the own normal and the place, for places so near to one of them, `middle`,
    /// that they are about as far from the crown's.
    #[inline]
    pub fn bent_near(&self, middle: Vec3A, share: f32) -> impl Fn(Vec3A, Vec3A) -> Vec3A + use<> {
        let crown = Vec3A::from(self.crown);
        let share = if self.is_plain { 0.0 } else { share };
        let per_m = share * AWAY * (middle - crown).length().max(1e-6).recip();
        let still = Vec3A::from(self.outward) * ((1.0 - AWAY) * share) - crown * per_m;
        move |own, at| own * (1.0 - share) + still + at * per_m
    }

    /// Which way the crown's outside is at a place; of length 1 at most.
    #[inline]
    pub fn out_at(&self, at: Vec3A) -> Vec3A {
        let outward = Vec3A::from(self.outward);
        let away = (at - Vec3A::from(self.crown)).normalize_or(outward);
        outward * (1.0 - AWAY) + away * AWAY
    }

    /// Off the shoot by phyllotaxis, drawn down (or up) by the species' droop, turned to the light
    /// as far as its heading allows.
    /// `from`: where what it stands for leaves wood that shows. `enlarge`: for twigs left out; `larger`: how
    /// much more than that.
    pub fn of(
        spot: &Spot,
        from: Vec3,
        f: &Foliage,
        hull: &Hull,
        [enlarge, larger]: [f32; 2],
        draws: &mut Draws,
    ) -> Pose {
        let stance = stance(f.shape);
        let outward = hull.outward(spot.at);
        let shoot = spot.shoot;
        let side = if stance.is_flat {
            let flat = shoot.cross(Vec3::Z).try_normalize();
            let flat = flat.unwrap_or_else(|| shoot.any_orthonormal_vector());
            if spot.turn.is_multiple_of(2) { flat } else { -flat }
        } else {
            let start = shoot.any_orthonormal_vector();
            Quat::from_axis_angle(shoot, spot.turn as f32 * GOLDEN_RAD) * start
        };
        let angle = if spot.is_tip { 0.0 } else { stance.angle * draws.between(0.75, 1.2) };
        let mut heading = shoot * angle.cos() + side * angle.sin();
        // A card as large as a bough hangs out of the crown as boughs do.
        let beyond = (enlarge / BOUGH_FROM - 1.0).clamp(0.0, 2.0);
        heading += draws.direction() * 0.14 + outward * (0.2 + 0.3 * beyond);
        let droop = (f.droop * draws.between(0.7, 1.15)).clamp(-0.95, 0.95);
        let droop = if spot.is_leader { droop.min(0.0) } else { droop };
        heading = heading.normalize_or(shoot);
        heading = (heading * (1.0 - droop.abs()) - Vec3::Z * droop).normalize_or(heading);
        let roll = draws.between(-stance.roll, stance.roll);
        let twig_m = f.twig_length_m.clamp(1e-3, 20.0) * draws.between(0.8, 1.2);
        // Never longer than boughs may be.
        let most_m = (1.5 * hull.half.truncate().max_element()).max(BOUGH_FROM * twig_m);
        let lengths_m = hull.twigs_m(spot.at, twig_m, [enlarge, enlarge.min(BOUGH_FROM), 1.0]);
        let own_m = lengths_m[2];
        let [size_m, reach_m, twig_m] = lengths_m.map(|long_m| (long_m * larger).min(most_m));
        // Beyond a small crown nothing stands out.
        let reach_m = reach_m.min(own_m + OUT * hull.half.truncate().max_element());
        // What it is longer than a twig lies towards wood.
        let nearer = (from - spot.at).clamp_length_max((size_m - twig_m).max(0.0));
        let clothes = if spot.is_leader { CLOTHES * (1.0 - hull.young) } else { 0.0 };
        let inward_m = (INWARD * (size_m - reach_m) - nearer.length()).max(clothes * size_m);
        // The outer part sinks under its weight, except where it stands.
        let sag = if f.droop >= 0.0 { draws.between(SAG[0], SAG[1]) } else { 0.0 };
        // What would hang into the ground lies on it.
        let lowest = (sag - spot.at.z / size_m).min(0.5);
        if spot.at.z > 0.0 && heading.z < lowest {
            heading = heading.with_z(lowest).try_normalize().unwrap_or(Vec3::Z);
        }
        // Large cards turn to the side from where the tree is seen.
        let turned = stands_for_many(enlarge);
        let from_above = stance.from_above * (1.0 - 0.7 * turned);
        let light = Vec3::Z * from_above + outward * (1.0 - from_above);
        let facing = light - heading * light.dot(heading);
        let facing = facing.try_normalize().unwrap_or_else(|| heading.any_orthonormal_vector());
        let facing = Quat::from_axis_angle(heading, roll) * facing;
        Pose {
            base: spot.at + nearer - heading * (STALK * size_m + inward_m),
            heading,
            facing,
            size_m,
            sag,
            mirrored: draws.unit() < 0.5,
            outward,
            crown: hull.centre,
            is_plain: false,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::seed::Seed;

    /// However long an internode and however many its twigs, each has a key of its own, of that node.
    #[test]
    fn twigs_of_a_long_internode_are_told_apart() {
        let skeleton = Skeleton {
            position: vec![Vec3::ZERO, 120.0 * Vec3::Z],
            parent: vec![crate::skeleton::NO_PARENT, 0],
            radius_m: vec![0.2; 2],
            axis: vec![0; 2],
            order: vec![0; 2],
            birth: vec![0; 2],
            dead: Vec::new(),
        };
        let species = crate::species::load("betula_pendula").unwrap();
        let foliage = Foliage { twigs_per_m: 1_000.0, ..species.foliage };
        let bears = [true; 2];
        let hull = Hull::around(&skeleton, &bears).unwrap();
        let (spots, _) = spots(&skeleton, &foliage, &bears, &hull);
        assert!(spots.len() > 60_000 && spots.iter().all(|s| s.node() == 1));
        let mut keys: Vec<u64> = spots.iter().map(|s| s.key).collect();
        keys.sort_unstable();
        keys.dedup();
        assert_eq!(keys.len(), spots.len());
    }

    #[test]
    fn weights_come_to_the_number_asked_for() {
        let mut draws = Seed::new(1).draws();
        let weights: Vec<f32> = (0..1_000)
            .map(|k| draws.between(0.3, 1.0) * if k % 3 == 0 { 24.0 } else { 1.0 })
            .collect();
        let total = weights.iter().map(|&w| f64::from(w)).sum();
        for most in [1.0, 100.0, 500.0, 950.0, 1_000.0] {
            let rate = rate(&weights, total, most);
            let sum: f64 = weights.iter().map(|&w| (f64::from(w) * rate).min(1.0)).sum();
            assert!((sum / most - 1.0).abs() < 0.01, "{sum} of {most}");
        }
    }
}
