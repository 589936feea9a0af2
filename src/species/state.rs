//! How a tree fares and what time of year it is, and what that does to the look of its species.
//!
//! Conditions are the six categories of the sanitary rules for forests that are in use in Siberia,
//! from healthy to old dead; shares of foliage and of dead branches are chosen within the bounds
//! these give (dead branches: up to a quarter in II, up to two thirds in III, more in IV).
//!
//! The twigs of trees that shed are seen without the leaves that have fallen, or are not out yet.
//! A user's own twigs are there or not; where hardly any are, bare ones stand in their place.
//!
//! Limits: leaves of one tree turn all at once; flowers, fruit and snow are not shown.

use std::str::FromStr;

use super::model::{Kind, Species, is_bare};
use crate::seed::Seed;

/// Category of the sanitary scale.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Default)]
pub enum Condition {
    /// I.
    #[default]
    Healthy,
    /// II: thinner crown, single dry branches.
    Weakened,
    /// III: open crown, up to two thirds of the branches dry.
    StronglyWeakened,
    /// IV: the last leaves are yellowing.
    Dying,
    /// V: died this year; its last leaves still hang, dry.
    FreshDead,
    /// VI: bare, top and twigs broken, bark falling off.
    OldDead,
}

impl Condition {
    pub const ALL: [Condition; 6] = [
        Condition::Healthy,
        Condition::Weakened,
        Condition::StronglyWeakened,
        Condition::Dying,
        Condition::FreshDead,
        Condition::OldDead,
    ];

    /// `I` … `VI`.
    pub fn numeral(self) -> &'static str {
        NUMERALS[self as usize]
    }
}

const NUMERALS: [&str; 6] = ["I", "II", "III", "IV", "V", "VI"];

impl FromStr for Condition {
    type Err = String;

    /// `1` … `6` or `I` … `VI`.
    fn from_str(text: &str) -> Result<Self, String> {
        let text = text.trim();
        let at = match text.parse::<usize>() {
            Ok(number) => number.checked_sub(1),
            Err(_) => NUMERALS.iter().position(|r| r.eq_ignore_ascii_case(text)),
        };
        at.and_then(|i| Condition::ALL.get(i).copied())
            .ok_or_else(|| "give 1 (healthy) to 6 (old dead), or I to VI".into())
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Season {
    Spring,
    #[default]
    Summer,
    Autumn,
    Winter,
}

impl FromStr for Season {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text.trim().to_ascii_lowercase().as_str() {
            "spring" => Ok(Season::Spring),
            "summer" => Ok(Season::Summer),
            "autumn" | "fall" => Ok(Season::Autumn),
            "winter" => Ok(Season::Winter),
            _ => Err("give spring, summer, autumn or winter".into()),
        }
    }
}

/// The state of a tree; by default healthy, in summer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct State {
    pub condition: Condition,
    pub season: Season,
}

/// Leaves that yellow before they die.
const TIRED: [u8; 3] = [176, 158, 74];
/// Dry needles, and dry leaves.
const DRY_NEEDLES: [u8; 3] = [134, 80, 46];
const DRY_LEAVES: [u8; 3] = [132, 102, 64];
/// Share of the leaves that are out in spring, and their colour.
const IN_SPRING: f32 = 0.85;
const YOUNG: [u8; 3] = [156, 184, 84];
/// Autumn where the rule file says nothing.
const AUTUMN: [u8; 3] = [206, 164, 56];
/// What frost leaves of the green.
const FROSTED: [u8; 3] = [74, 82, 62];

impl State {
    /// Share of the twigs of a healthy tree in summer that are seen on the branches that live, 0…1.
    pub fn leaf_share(self, species: &Species) -> f32 {
        let of_season = if self.thins_twigs(species) { self.hang_on(species) } else { 1.0 };
        let of_condition = match self.condition {
            Condition::Healthy => 1.0,
            Condition::Weakened => 0.8,
            Condition::StronglyWeakened => 0.6,
            Condition::Dying => 0.45,
            Condition::FreshDead => 0.25,
            Condition::OldDead => 0.0,
        };
        of_season * of_condition
    }

    /// Share of the leaves that the season leaves on the tree.
    fn hang_on(self, species: &Species) -> f32 {
        let winter = winter_share(species);
        match self.season {
            Season::Spring => winter.max(IN_SPRING),
            Season::Summer => 1.0,
            Season::Autumn => winter.max(species.season.autumn_leaves),
            Season::Winter => winter,
        }
    }

    /// Whether whole twigs go with the leaves that have fallen: single leaves of a user's own picture or model
    /// can't.
    fn thins_twigs(self, species: &Species) -> bool {
        species.has_own_leaves() && !is_bare(self.hang_on(species))
    }

    /// The species as it looks in this state: colour of its leaves, loss of its bark. `seed` tells
    /// the autumn colours of one tree from those of another.
    pub fn look(self, species: &Species, seed: Seed) -> Species {
        self.look_by(species, |colours, summer| turned(colours, summer, seed))
    }

    /// The same for many trees that share their pictures, each with a [`State::tint`] of its own.
    pub fn look_of_many(self, species: &Species) -> Species {
        let most = |a: [u8; 3], b: &[u8; 3]| std::array::from_fn(|c| a[c].max(b[c]));
        self.look_by(species, |colours, summer| [summer, colours.iter().fold([0; 3], most)])
    }

    /// What the leaves of one of many trees are multiplied by, linear, at most 1: no two trees turn
    /// alike in autumn. `look`: of [`State::look_of_many`].
    pub fn tint(self, species: &Species, look: &Species, seed: Seed) -> [f32; 3] {
        let winter = winter_share(species);
        if self.season != Season::Autumn || winter > 0.5 || self.condition >= Condition::FreshDead {
            return [1.0; 3];
        }
        let colours = species.season.autumn.as_deref().filter(|c| !c.is_empty());
        let [_, goal] = turned(colours.unwrap_or(&[AUTUMN]), species.foliage.colour, seed);
        let mut draws = seed.derive("turned", 0).draws();
        let (left, light) = (draws.unit(), draws.between(0.88, 1.0));
        let colour = mixed(goal, species.foliage.colour, 0.55 * left * left);
        let linear = |c: u8| (f32::from(c.max(1)) / 255.0).powf(2.2);
        std::array::from_fn(|c| {
            light * (linear(colour[c]) / linear(look.foliage.colour[c])).min(1.0)
        })
    }

    /// `pick`: of the colours of autumn and that of summer, the one from which leaves turn and the one to which.
    fn look_by(
        self,
        species: &Species,
        pick: impl Fn(&[[u8; 3]], [u8; 3]) -> [[u8; 3]; 2],
    ) -> Species {
        let mut out = species.clone();
        let summer = species.foliage.colour;
        let winter = winter_share(species);
        let sheds = 1.0 - winter;
        if !self.thins_twigs(species) {
            out.foliage.kept = self.hang_on(species);
        }
        let dries = Condition::Weakened..=Condition::FreshDead;
        out.foliage.has_dry = dries.contains(&self.condition) && !species.has_own_leaves();
        if out.foliage.is_bare() {
            // All twigs are as those of dry branches.
            out.foliage.has_dry = false;
            // Drawn leaves are not the user's.
            if species.has_own_leaves() {
                out.foliage.kept = 0.0;
            }
            (out.own_model, out.own_picture) = (None, None);
        }
        let is_gone = self.condition >= Condition::FreshDead;
        let of_season = match self.season {
            Season::Summer => summer,
            Season::Spring => {
                let own = species.season.spring;
                own.unwrap_or_else(|| mixed(summer, YOUNG, 0.15 + 0.5 * sheds))
            }
            Season::Autumn => match species.season.autumn.as_deref() {
                Some(colours) if !colours.is_empty() => {
                    let [from, to] = pick(colours, summer);
                    out.foliage.turns_from = Some(from).filter(|_| !is_gone);
                    to
                }
                _ => mixed(summer, AUTUMN, sheds),
            },
            // What hangs on through the winter on a tree that sheds is dry.
            Season::Winter => mixed(mixed(summer, FROSTED, 0.25), DRY_LEAVES, sheds),
        };
        // Leaves that are dry already don't yellow.
        let is_dry = self.season == Season::Winter && sheds > 0.5;
        let tired = |share: f32| if is_dry { of_season } else { mixed(of_season, TIRED, share) };
        let dry = if species.kind == Kind::Conifer { DRY_NEEDLES } else { DRY_LEAVES };
        let (colour, more_variation) = match self.condition {
            Condition::Healthy => (of_season, 0.0),
            Condition::Weakened => (tired(0.15), 0.03),
            Condition::StronglyWeakened => (tired(0.35), 0.08),
            Condition::Dying => (tired(0.75), 0.12),
            Condition::FreshDead | Condition::OldDead => (dry, 0.1),
        };
        out.foliage.colour = colour;
        if self.season == Season::Autumn && sheds > 0.5 {
            out.foliage.variation = (out.foliage.variation + 0.1).min(1.0);
        }
        out.foliage.variation = (out.foliage.variation + more_variation).min(1.0);
        let fallen = match self.condition {
            Condition::FreshDead => 0.06,
            Condition::OldDead => 0.6,
            _ => 0.0,
        };
        out.bark.lost = out.bark.lost.max(fallen);
        out
    }
}

/// Share of the leaves that hang on through the winter. Conifers keep their needles, unless their
/// file says otherwise.
fn winter_share(species: &Species) -> f32 {
    let usual = if species.kind == Kind::Conifer { 1.0 } else { 0.0 };
    species.season.winter_leaves.unwrap_or(usual)
}

fn mixed(a: [u8; 3], b: [u8; 3], share: f32) -> [u8; 3] {
    std::array::from_fn(|c| {
        let (a, b) = (f32::from(a[c]), f32::from(b[c]));
        (a + (b - a) * share.clamp(0.0, 1.0)).round() as u8
    })
}

/// A place on the way through several colours; before it, one colour back, summer's before the first.
fn turned(colours: &[[u8; 3]], summer: [u8; 3], seed: Seed) -> [[u8; 3]; 2] {
    let Some(last) = colours.len().checked_sub(1) else { return [summer, AUTUMN] };
    let at = seed.derive("autumn", 0).draws().unit() * last as f32;
    let i = at as usize;
    let before = i.checked_sub(1).map_or(summer, |k| colours[k]);
    let [here, next] = [i, i + 1].map(|k| colours[k.min(last)]);
    [mixed(before, here, at.fract()), mixed(here, next, at.fract())]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::species::load;

    fn state(condition: &str, season: &str) -> State {
        State { condition: condition.parse().unwrap(), season: season.parse().unwrap() }
    }

    #[test]
    fn both_ways_to_write_a_condition() {
        for (i, roman) in ["I", "ii", "III", "iv", "V", "VI"].into_iter().enumerate() {
            let both = [roman.to_owned(), (i + 1).to_string()];
            assert!(both.iter().all(|t| t.parse() == Ok(Condition::ALL[i])), "{roman}");
        }
        for wrong in ["0", "7", "IIII", "", "-1", "healthy"] {
            assert!(wrong.parse::<Condition>().is_err(), "{wrong}");
        }
        assert!("spirng".parse::<Season>().is_err());
    }

    #[test]
    fn larch_and_broadleaves_are_bare_in_winter_and_spruce_is_not() {
        let share = |name: &str, season| state("I", season).leaf_share(&load(name).unwrap());
        let kept =
            |species: &Species, season| state("I", season).look(species, Seed::new(1)).foliage.kept;
        for name in ["larix_sibirica", "larix_decidua", "betula_pendula", "populus_tremula"] {
            let mut species = load(name).unwrap();
            assert_eq!((share(name, "winter"), kept(&species, "winter")), (1.0, 0.0), "{name}");
            assert_eq!((share(name, "autumn"), share(name, "spring")), (1.0, 1.0), "{name}");
            let autumn = kept(&species, "autumn");
            assert!((0.5..0.95).contains(&autumn), "{name}: leaves fall one by one, {autumn}");
            species.own_picture = Some(crate::raster::Picture::filled(8, 8, [9; 4]).into());
            let winter = state("I", "winter");
            assert_eq!((winter.leaf_share(&species), kept(&species, "winter")), (1.0, 0.0));
            assert!(!winter.look(&species, Seed::new(1)).has_own_leaves(), "{name}: drawn twigs");
            let autumn = state("I", "autumn");
            assert_eq!(autumn.look(&species, Seed::new(1)).foliage.kept, 1.0, "{name}");
            assert!((0.3..1.0).contains(&autumn.leaf_share(&species)), "{name}");
        }
        for name in ["picea_abies", "pinus_sylvestris", "abies_sibirica"] {
            for season in ["spring", "summer", "autumn", "winter"] {
                assert_eq!(share(name, season), 1.0, "{name}");
                assert_eq!(kept(&load(name).unwrap(), season), 1.0, "{name}");
            }
        }
    }

    #[test]
    fn leaves_get_fewer_and_less_green_from_i_to_vi() {
        let green = |c: [u8; 3]| i32::from(c[1]) - i32::from(c[0]);
        for name in ["picea_abies", "betula_pendula"] {
            let species = load(name).unwrap();
            let looks = ["I", "II", "III", "IV", "V"].map(|c| state(c, "summer"));
            for pair in looks.windows(2) {
                let colours =
                    [pair[0], pair[1]].map(|s| s.look(&species, Seed::new(1)).foliage.colour);
                assert!(green(colours[1]) < green(colours[0]), "{name}: {colours:?}");
            }
            for pair in looks.windows(2) {
                assert!(pair[1].leaf_share(&species) < pair[0].leaf_share(&species));
            }
            assert_eq!(state("VI", "summer").leaf_share(&species), 0.0);
            assert!(state("VI", "summer").look(&species, Seed::new(1)).bark.lost > 0.3);
            assert_eq!(state("I", "summer").look(&species, Seed::new(1)).bark, species.bark);
        }
    }

    #[test]
    fn dry_leaves_of_winter_are_of_one_colour_in_every_condition() {
        let oak = load("quercus_robur").unwrap();
        let colour = |c| state(c, "winter").look(&oak, Seed::new(1)).foliage.colour;
        assert!(colour("I")[0] > colour("I")[1], "brown");
        assert!(["II", "III", "IV"].iter().all(|c| colour(c) == colour("I")));
        let mut own = oak.clone();
        own.own_picture = Some(crate::raster::Picture::filled(8, 8, [9; 4]).into());
        let winter = state("I", "winter").look(&own, Seed::new(1)).foliage.kept;
        assert_eq!(winter, 0.0, "no drawn leaves beside one's own");
    }

    /// In degrees of the colour wheel: red 0, yellow 60, green 120.
    fn hue(c: [u8; 3]) -> f32 {
        let [r, g, b] = c.map(f32::from);
        (3f32.sqrt() * (g - b)).atan2(2.0 * r - g - b).to_degrees()
    }

    #[test]
    fn autumn_is_of_the_species() {
        let autumn = |name: &str, seed| {
            hue(state("I", "autumn").look(&load(name).unwrap(), Seed::new(seed)).foliage.colour)
        };
        for seed in 1..9 {
            for name in ["betula_pendula", "larix_sibirica", "larix_decidua"] {
                assert!((38.0..56.0).contains(&autumn(name, seed)), "{name}");
            }
            assert!(autumn("sorbus_aucuparia", seed) < 25.0);
            assert!((20.0..45.0).contains(&autumn("quercus_robur", seed)));
            assert!(autumn("picea_abies", seed) > 90.0);
        }
        // Some leaves are behind the others: green yet, or yellow where those are red.
        let from = |name: &str, seed, condition| {
            let look = state(condition, "autumn").look(&load(name).unwrap(), Seed::new(seed));
            look.foliage.turns_from.map(hue)
        };
        for seed in 1..9 {
            assert!(from("betula_pendula", seed, "I").unwrap() > 75.0);
            let aspen = autumn("populus_tremula", seed);
            assert!(from("populus_tremula", seed, "I").unwrap() > aspen + 2.0);
            assert_eq!(from("picea_abies", seed, "I"), None);
            assert_eq!(from("betula_pendula", seed, "V"), None);
        }
        let aspens: Vec<f32> = (1..30).map(|seed| autumn("populus_tremula", seed)).collect();
        assert!(aspens.iter().any(|h| *h > 42.0) && aspens.iter().any(|h| *h < 25.0), "{aspens:?}");
    }

    #[test]
    fn no_two_trees_turn_alike() {
        for name in ["betula_pendula", "populus_tremula", "larix_sibirica"] {
            let species = load(name).unwrap();
            let autumn = state("I", "autumn");
            let look = autumn.look_of_many(&species);
            let tints: Vec<_> =
                (0..5).map(|k| autumn.tint(&species, &look, Seed::new(k))).collect();
            for (k, a) in tints.iter().enumerate() {
                assert!(a.iter().all(|c| *c > 0.0 && *c <= 1.0), "{name}: {a:?}");
                assert!(tints[..k].iter().all(|b| a != b), "{name}: {tints:?}");
            }
            let summer = state("I", "summer");
            let look = summer.look_of_many(&species);
            assert_eq!(look.foliage, species.foliage);
            assert_eq!(summer.tint(&species, &look, Seed::new(1)), [1.0; 3]);
        }
        let spruce = load("picea_abies").unwrap();
        let autumn = state("I", "autumn");
        assert_eq!(autumn.tint(&spruce, &autumn.look_of_many(&spruce), Seed::new(1)), [1.0; 3]);
    }

    #[test]
    fn spring_is_lighter_where_leaves_are_new() {
        for name in ["betula_pendula", "larix_sibirica", "quercus_robur"] {
            let species = load(name).unwrap();
            let spring = state("I", "spring").look(&species, Seed::new(1)).foliage.colour;
            assert!(spring[1] > species.foliage.colour[1] + 15, "{name}: {spring:?}");
        }
    }
}
