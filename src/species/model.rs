//! What a species is once its rule file, and what that builds on, has been read and checked.
//!
//! The sections below are the tables of a rule file, one to one. Lengths are metres, angles
//! degrees, colours sRGB 0…255. The words at each field are those of the schema and of the template.

use std::sync::Arc;

use schemars::JsonSchema;
use serde::Deserialize;

use super::own::Model;
use crate::raster::Picture;

/// Decides the defaults of looks and the coarse class of a photo.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Kind {
    Conifer,
    Broadleaf,
    Shrub,
}

/// How the main axis goes on (T15).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Branching {
    /// One stem to the top, laterals along it.
    Monopodial,
    /// The leader gives way to laterals.
    Sympodial,
    /// Several stems from the ground, no clear leader.
    Ternary,
}

/// The size of a typical grown tree; others are scaled by height.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Size {
    /// Height of the tree, metres.
    pub height_m: f32,
    /// Diameter of its crown, metres.
    pub crown_diameter_m: f32,
    /// Age at which a tree is that tall, years.
    pub age_years: f32,
    /// Height of the crown's base over that of the tree.
    pub crown_base: f32,
    /// Stem diameter at 1.3 m, metres.
    pub stem_diameter_m: f32,
    /// Crown outline from base (0) to top (1): pairs (relative height, relative radius), rising in
    /// height; between them linear.
    pub profile: Vec<[f32; 2]>,
}

/// Shape of the growth in height: h(A) ∝ (1 − e^(−cA))^p, A in units of `age_years`
/// (Richards 1959). With these a tree of `age_years` has 0.83 of the height it may reach.
const RICHARDS: (f32, f32) = (2.0, 1.3);

impl Size {
    /// Height of a tree of that age, metres.
    pub fn height_at(&self, age_years: f32) -> f32 {
        let (c, p) = RICHARDS;
        let age = (age_years / self.age_years).max(0.0);
        self.height_m * ((-c * age).exp_m1() / (-c).exp_m1()).powf(p)
    }

    /// Age of a tree of that height, years; four times `age_years` for what it never reaches.
    pub fn age_at(&self, height_m: f32) -> f32 {
        let (c, p) = RICHARDS;
        let grown = (height_m / self.height_m).max(0.0).powf(1.0 / p);
        let left = 1.0 + grown * (-c).exp_m1();
        let age = if left > 0.0 { -left.ln() / c } else { f32::INFINITY };
        self.age_years * age.min(4.0)
    }

    /// Share of its life in which a tree reached a share of its height, both 0…1.
    pub fn age_share(&self, height_share: f32) -> f32 {
        (self.age_at(height_share.clamp(0.0, 1.0) * self.height_m) / self.age_years).min(1.0)
    }

    /// What a rule may read of the typical tree: the values of [`OF_TREE`].
    ///
    /// [`OF_TREE`]: crate::species::rule::OF_TREE
    pub fn of_tree(&self) -> [f64; 3] {
        [self.height_m, self.crown_diameter_m, self.age_years].map(f64::from)
    }

    /// Stem diameter of a tree of another height, metres: it goes with height^1.5 (elastic
    /// similarity, McMahon 1973).
    pub fn stem_diameter_at(&self, height_m: f32) -> f32 {
        let scale = (height_m / self.height_m.max(0.1)).max(1e-3);
        self.stem_diameter_m * scale.powf(1.5)
    }
}

/// From scaffold to filled crown.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Growth {
    /// α_i of the length decay, one an iteration, as a fraction of L_apex squared per metre of
    /// crown length; the last holds for the rest. 0: no decay.
    pub decay: Vec<f32>,
    /// How the decay differs over the crown.
    pub decay_by: DecayBy,
    /// Upward (+) or downward (−) turn of a shoot, degrees a metre at horizontal.
    pub tropism: f32,
    /// Random bend of an axis, degrees a metre.
    pub wander: f32,
    /// Segment length D over attractor spacing.
    pub step: f32,
    /// Influence distance d_i over attractor spacing.
    pub influence: f32,
    /// Kill distance d_k over attractor spacing.
    pub kill: f32,
    /// Pipe model exponent e: r_parent^e = Σ r_child^e. 2 is da Vinci's rule.
    pub pipe_exponent: f32,
    /// Radius of a last shoot, metres.
    pub tip_radius_m: f32,
    /// Shoots of the stem within the crown of a tree of `size.height_m`; each is rewritten by the
    /// rule into itself and its laterals. 1: the rule's axiom stands for the whole tree.
    pub internodes: u32,
    /// Turn about the stem from one group of laterals to the next, degrees; 137.5 is the golden
    /// angle.
    pub roll_deg: f32,
    /// Laterals that spring from one place: those of a whorl, or 1 for a spiral.
    pub whorl: u32,
    /// Share of a shoot, from its tip, over which the rule's laterals are spread: 0 leaves them at
    /// the tip, as the rule writes them.
    pub spread: f32,
    /// Share of the crown that the stem passes before it gives way to its laterals; 1: all.
    pub stem: f32,
    /// Unevenness of the crown outline.
    pub uneven: f32,
    /// Share of the crown's radius, from the axis, that bears no fine twigs.
    pub bare: f32,
    /// Weight of a twig's heading against its attractors: 0 follows them freely, 2 is stiff.
    pub inertia: f32,
    /// Weight of the way from the stem outwards in the growth of twigs.
    pub outward: f32,
    /// Density of attractors added to the scan's own inside the crown.
    pub fill: f32,
    /// Turn of the outer twigs towards the ground, degrees a metre.
    pub hang: f32,
    /// The habit of branches, one an order from 1 on; the last holds for the rest.
    pub order: Vec<Habit>,
}

/// Factors of the decay rates α_i, as pairs (place, factor) rising in the place, linear between
/// them; the three multiply.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct DecayBy {
    /// By height in the crown, 0 its base to 1 its top.
    pub height: Vec<[f32; 2]>,
    /// By the compass bearing a branch leaves to: 0 north, 90 east; goes round.
    pub azimuth_deg: Vec<[f32; 2]>,
    /// By the light at the branch's tip, 0 dark to 1 the open sky.
    pub light: Vec<[f32; 2]>,
}

impl DecayBy {
    /// Whether the decay is the same all over the crown.
    pub fn is_even(&self) -> bool {
        [&self.height, &self.azimuth_deg, &self.light].into_iter().all(|c| is_level(c))
    }
}

/// Whether a curve has one value everywhere.
pub fn is_level(pairs: &[[f32; 2]]) -> bool {
    pairs.windows(2).all(|w| w[0][1] == w[1][1])
}

/// The value at `t`, linear between pairs, level beyond them; 0 of none.
pub fn curve(pairs: &[[f32; 2]], t: f32) -> f32 {
    let mut before: Option<[f32; 2]> = None;
    for &[h, r] in pairs {
        if t <= h {
            return match before {
                Some([h0, r0]) if h > h0 => r0 + (r - r0) * (t - h0) / (h - h0),
                _ => r,
            };
        }
        before = Some([h, r]);
    }
    before.map_or(0.0, |[_, r]| r)
}

/// How a tree that is not grown yet differs from a grown one. What is absent is the same.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Young {
    /// Heights of the tree over `size.height_m`: all below holds up to the first, and less and less up
    /// to the second, from which on the tree is a grown one.
    pub until: [f32; 2],
    /// Height of the crown's base over that of the tree; absent: that of `[size]`, lower by the root
    /// of the tree's height over `size.height_m`.
    #[serde(default)]
    #[schemars(extend("examples" = [0.05]))]
    pub crown_base: Option<f32>,
    /// Diameter of the crown over what goes with the tree's height.
    #[serde(default)]
    #[schemars(extend("examples" = [0.8]))]
    pub crown_width: Option<f32>,
    /// Crown outline, as in `[size]`.
    #[serde(default)]
    #[schemars(extend("examples" = [[[0.0, 0.8], [0.2, 1.0], [1.0, 0.03]]]))]
    pub profile: Option<Vec<[f32; 2]>>,
    /// Shoots of the stem within the crown, as in `[growth]`.
    #[serde(default)]
    #[schemars(extend("examples" = [9]))]
    pub internodes: Option<u32>,
    /// Share of the crown that the stem passes.
    #[serde(default)]
    #[schemars(extend("examples" = [1.0]))]
    pub stem: Option<f32>,
    /// Unevenness of the crown outline.
    #[serde(default)]
    #[schemars(extend("examples" = [0.2]))]
    pub uneven: Option<f32>,
    /// Share of the crown's radius, from the axis, that bears no fine twigs.
    #[serde(default)]
    #[schemars(extend("examples" = [0.2]))]
    pub bare: Option<f32>,
    /// Angles of the branches of the stem, as in `[[growth.order]]`.
    #[serde(default)]
    #[schemars(extend("examples" = [[70, 45]]))]
    pub angle_deg: Option<[f32; 2]>,
    /// Spread of those angles, of the azimuth and of the place.
    #[serde(default)]
    #[schemars(extend("examples" = [0.2]))]
    pub irregular: Option<f32>,
    /// Share of those branches that live.
    #[serde(default)]
    #[schemars(extend("examples" = [1.0]))]
    pub keep: Option<f32>,
    /// Turn of the outer half of all branches, up (+) or down (−), degrees.
    #[serde(default)]
    #[schemars(extend("examples" = [[5, 0]]))]
    pub tip_deg: Option<[f32; 2]>,
    /// Turn of the outer twigs towards the ground, degrees a metre.
    #[serde(default)]
    #[schemars(extend("examples" = [10.0]))]
    pub hang: Option<f32>,
    /// Hang of a twig, as in `[foliage]`.
    #[serde(default)]
    #[schemars(extend("examples" = [0.1]))]
    pub droop: Option<f32>,
}

/// How branches of one order grow. Pairs hold at the base and at the top of the crown (for order
/// 1) or of the parent axis (from 2 on), with linear change between.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Habit {
    /// Angle from the parent's direction, degrees. Absent: the angle of the rule.
    #[serde(default)]
    #[schemars(extend("examples" = [[80, 50]]))]
    pub angle_deg: Option<[f32; 2]>,
    /// Spread of that angle, of the azimuth and of the place.
    pub irregular: f32,
    /// Turn of the first half of the branch, up (+) or down (−), degrees.
    pub curve_deg: [f32; 2],
    /// Turn of the outer half, degrees.
    pub tip_deg: [f32; 2],
    /// Length at the apex of the parent (L_apex) over the crown's radius (order 1) or the parent's
    /// length (from 2 on).
    pub length: f32,
    /// 0: laterals stand all around the parent; 1: in a flat spray beside it.
    pub flat: f32,
    /// Share of the rule's laterals that live.
    pub keep: f32,
}

/// The outline of a leaf, or needles.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum LeafShape {
    /// Single needles along the shoot (spruce, fir).
    Needle,
    /// Needles in tufts on short shoots (larch).
    Tuft,
    /// Needles in bundles, brush-like at the shoot's end (pine).
    Bundle,
    /// Pointed oval.
    Ovate,
    /// Rhombic to triangular with a long point (birch).
    Deltoid,
    /// Nearly round, with blunt teeth (aspen).
    Round,
    /// Heart-shaped, with a drawn-out tip (lime).
    Cordate,
    /// Widest above its middle, with a short abrupt tip (hazel).
    Obovate,
    /// Lobed (oak).
    Lobed,
    /// Narrow (willow).
    Lanceolate,
    /// Compound: leaflets in pairs along a rachis, one at its end (rowan).
    Pinnate,
}

impl LeafShape {
    pub fn is_needle(self) -> bool {
        matches!(self, LeafShape::Needle | LeafShape::Tuft | LeafShape::Bundle)
    }
}

/// With a smaller share of their leaves twigs are bare.
const LEAST_KEPT: f32 = 0.5;

/// Whether a twig that has kept this share of its leaves counts as bare.
pub(super) fn is_bare(kept: f32) -> bool {
    kept < LEAST_KEPT
}

/// Leaves or needles and how they sit on shoots.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Foliage {
    /// Outline of a leaf, or how needles stand.
    pub shape: LeafShape,
    /// Length of a leaf or needle, metres.
    pub leaf_length_m: f32,
    /// Width of a leaf or needle, metres.
    pub leaf_width_m: f32,
    /// Needles of one tuft or bundle, leaflets of a compound leaf.
    pub cluster: u32,
    /// Middle colour of a leaf in summer: red, green, blue. That of a `picture` or `model` is its own.
    pub colour: [u8; 3],
    /// Spread of the colour from leaf to leaf.
    pub variation: f32,
    /// Length of the leafy twig that one card shows, metres.
    pub twig_length_m: f32,
    /// Twig cards a metre of shoot that bears leaves.
    pub twigs_per_m: f32,
    /// Hang of a twig: 0 follows the shoot, 1 hangs straight down, −1 stands upright.
    pub droop: f32,
    /// Shoots of a radius below this bear leaves, metres.
    pub bearing_radius_m: f32,
    /// Leaf area over the area of the crown's hull, 0…1, below which twigs are drawn larger to make
    /// up for those a coarse model leaves out: near 1 hides the wood, a third lets the sky through.
    pub cover: f32,
    /// Your own twig, or single leaf, as OBJ, beside this file: it grows from its origin along y, its
    /// upper side to z, and is scaled to `twig_length_m`.
    #[serde(default)]
    #[schemars(extend("examples" = ["twig.obj"]))]
    pub model: Option<String>,
    /// Your own picture of a twig for the cards, a PNG with alpha beside this file: it grows up
    /// from the middle of the bottom edge.
    #[serde(default)]
    #[schemars(extend("examples" = ["twig.png"]))]
    pub picture: Option<String>,
    /// Share of a twig's leaves that still hang, 0…1. The season's, not the rule file's.
    #[serde(skip, default = "all")]
    pub kept: f32,
    /// Whether some branches are dry beside others in leaf. The condition's, not the rule file's.
    #[serde(skip)]
    pub has_dry: bool,
    /// Colour from which leaves turn to their own in autumn, each so far. The season's, not the rule file's.
    #[serde(skip)]
    pub turns_from: Option<[u8; 3]>,
}

fn all() -> f32 {
    1.0
}

/// Whether a tree is young: 1 up to a metre high … 0 from three metres on.
pub fn youth(height_m: f32) -> f32 {
    (0.5 * (3.0 - height_m)).clamp(0.0, 1.0)
}

impl Foliage {
    /// That of dry branches, which bear twigs alone.
    #[must_use]
    pub fn dry(&self) -> Foliage {
        Foliage { kept: 0.0, has_dry: false, turns_from: None, ..self.clone() }
    }

    /// Whether twigs are seen without most of their leaves: they hide no crown.
    pub fn is_bare(&self) -> bool {
        is_bare(self.kept)
    }

    /// Twigs at most so long: where they are shorter than usual they are closer, by the root of that,
    /// and their leaves a little smaller.
    #[must_use]
    pub fn within(&self, most_m: f32) -> Foliage {
        let short = (most_m / self.twig_length_m.max(1e-6)).clamp(1e-3, 1.0);
        let small = short.powf(0.3);
        Foliage {
            twig_length_m: self.twig_length_m * short,
            twigs_per_m: self.twigs_per_m / short.sqrt(),
            leaf_length_m: self.leaf_length_m * small,
            leaf_width_m: self.leaf_width_m * small,
            ..self.clone()
        }
    }
}

/// Cones, berries or catkins beside the leaves: a model of your own.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Fruit {
    /// Your own cone, berry or catkin as OBJ, beside this file: it hangs from its origin and grows
    /// along y.
    #[serde(default)]
    #[schemars(extend("examples" = ["cone.obj"]))]
    pub model: Option<String>,
    /// Length of one, to which the model is scaled, metres.
    pub length_m: f32,
    /// How many a metre of shoot that bears leaves.
    pub per_m: f32,
    /// Hang: 0 follows the shoot, 1 hangs straight down, −1 stands upright.
    pub droop: f32,
    /// Height in the crown, over the crown's, above which they are borne.
    pub from: f32,
}

/// What the seasons do to the leaves.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Seasons {
    /// Share of the leaves that hang on through the winter; 1 for conifers and 0 for others where
    /// absent.
    #[serde(default)]
    #[schemars(extend("examples" = [0.0]))]
    pub winter_leaves: Option<f32>,
    /// Share of the leaves still on the tree in autumn, of those it sheds.
    pub autumn_leaves: f32,
    /// Colours of autumn; each tree is somewhere on the way through them. Gold where absent, on
    /// trees that shed.
    #[serde(default)]
    #[schemars(extend("examples" = [[[226, 178, 50], [196, 84, 42]]]))]
    pub autumn: Option<Vec<[u8; 3]>>,
    /// Colour of young leaves in spring; a lighter green where absent.
    #[serde(default)]
    #[schemars(extend("examples" = [[150, 176, 84]]))]
    pub spring: Option<[u8; 3]>,
}

/// Patterns of bark.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum BarkStyle {
    /// White with dark lenticels, split by black diamonds (the foot of a birch).
    Birch,
    /// White with dark lenticels (the upper stem of a birch).
    Paper,
    /// Large plates of many flakes (the foot of a pine).
    Plates,
    /// Thin loose flakes (the upper stem of a pine).
    Flakes,
    /// Long thick plates between deep furrows (larch).
    Ridges,
    /// Long narrow ridges between furrows (oak, lime).
    Furrows,
    /// Small thin scales, one over the other (spruce).
    Scales,
    /// Smooth with fine streaks and pores (rowan, hazel).
    Smooth,
    /// Smooth with rows of dark diamonds (aspen, goat willow).
    Diamonds,
    /// Smooth with blisters of resin (fir).
    Blisters,
}

/// The look of the bark.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Bark {
    /// Pattern of the bark.
    pub style: BarkStyle,
    /// Colour of ridges or plates: red, green, blue.
    pub colour: [u8; 3],
    /// Colour of furrows or lenticels.
    pub dark: [u8; 3],
    /// Colour towards the top of the stem and on branches; `colour` where absent.
    #[serde(default)]
    #[schemars(extend("examples" = [[142, 118, 96]]))]
    pub upper: Option<[u8; 3]>,
    /// Pattern there; `style` where absent.
    #[serde(default)]
    #[schemars(extend("examples" = ["flakes"]))]
    pub upper_style: Option<BarkStyle>,
    /// Heights on the stem, over that of the tree, from which on that pattern begins to show and
    /// is alone.
    pub upper_from: [f32; 2],
    /// Colour of twigs; that of the wood they spring from where absent.
    #[serde(default)]
    #[schemars(extend("examples" = [[84, 56, 48]]))]
    pub twig: Option<[u8; 3]>,
    /// Wood of a radius below this has the colour of twigs, metres.
    pub twig_radius_m: f32,
    /// Depth of the relief, metres.
    pub relief_m: f32,
    /// Size of its plates, furrows, scales over that usual for the pattern.
    pub coarseness: f32,
    /// Share of the bark that has fallen off, so that grey wood shows.
    pub lost: f32,
    /// A picture of your own for the bark, PNG or JPEG, beside this file; it should tile, and show
    /// 1 m in width and in height. It covers stem and branches alike, unless this file names an
    /// upper bark.
    #[serde(default)]
    #[schemars(extend("examples" = ["bark.png"]))]
    pub picture: Option<String>,
    /// The normal map that goes with `picture`, +Y up as in OpenGL.
    #[serde(default)]
    #[schemars(extend("examples" = ["bark_normal.png"]))]
    pub normal: Option<String>,
    /// The roughness that goes with `picture`: white is rough.
    #[serde(default)]
    #[schemars(extend("examples" = ["bark_roughness.png"]))]
    pub roughness: Option<String>,
}

/// A user's own bark, read.
#[derive(Debug, Clone, PartialEq)]
pub struct OwnBark {
    pub colour: Arc<Picture>,
    pub normal: Option<Arc<Picture>>,
    /// Roughness in green.
    pub roughness: Option<Arc<Picture>>,
}

/// A species, complete and checked.
#[derive(Debug, Clone)]
pub struct Species {
    /// File stem: `larix_sibirica`, `table3/05`.
    pub id: String,
    /// Scientific name: `Larix sibirica`.
    pub name: String,
    /// English name: `Siberian larch`.
    pub common: String,
    /// What the file extends.
    pub builds_on: Option<String>,
    pub kind: Kind,
    pub branching: Branching,
    /// Range of photo luminance Y, 0…255 (T15, Table 1).
    pub luminance: Option<[f32; 2]>,
    /// Of a grown tree, as is `growth`; those of another are [`Species::at_height`]'s.
    pub size: Size,
    pub growth: Growth,
    pub young: Young,
    pub foliage: Foliage,
    pub bark: Bark,
    /// What `foliage.model` and `foliage.picture` name, read.
    pub own_model: Option<Arc<Model>>,
    pub own_picture: Option<Arc<Picture>>,
    pub fruit: Fruit,
    /// What `fruit.model` names, read.
    pub own_fruit: Option<Arc<Model>>,
    pub season: Seasons,
    /// Where `bark.picture` names one.
    pub own_bark: Option<OwnBark>,
    pub remarks: Vec<Remark>,
    /// How it branches.
    pub rule: crate::species::rule::Rule,
}

/// What the author of a file may want to know, though nothing is wrong.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Remark {
    pub on: OwnPart,
    pub text: String,
}

/// What of a tree may be made of a user's own files.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum OwnPart {
    Bark,
    Leaves,
    Fruit,
}

impl Species {
    /// The picture of its leaves, where that or their model is the user's.
    pub fn own_leaves(&self) -> Option<&Picture> {
        let of_model = self.own_model.as_ref().map(|model| &model.picture);
        of_model.or(self.own_picture.as_deref())
    }

    pub fn has_own_leaves(&self) -> bool {
        self.own_leaves().is_some()
    }
}
