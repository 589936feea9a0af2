//! The types of a report: what `report.json` holds, and its schema.

use schemars::{JsonSchema, SchemaGenerator};
use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::stats::{self, Order};

/// Counts changes of the layout.
pub const SCHEMA: u32 = 2;

/// A whole report.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Document {
    /// Counts changes of this layout.
    pub schema: u32,
    pub about: About,
    /// The whole run with the usual settings, in figures.
    pub facts: Vec<Fact>,
    /// What accuracy costs.
    pub fronts: Vec<Front>,
    /// How errors fall when steps are halved.
    pub convergence: Vec<Ladder>,
    /// What happens at the edge.
    pub stability: Vec<Finding>,
    /// What scenes do without, and what that saves.
    pub left_out: Vec<Omissions>,
    /// How time and memory grow.
    pub scale: Vec<Scaling>,
}

/// The schema of `report.json` (draft 2020-12).
pub fn schema() -> Value {
    SchemaGenerator::default().into_root_schema_for::<Document>().to_value()
}

/// What was measured, where and how.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct About {
    /// Version of the program.
    pub larix: String,
    /// What was measured, in a sentence.
    pub subject: String,
    pub machine: Machine,
    pub is_quick: bool,
    pub seed: u64,
    /// Of the whole report.
    pub seconds: f64,
    pub warnings: Vec<String>,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Machine {
    pub system: String,
    /// Name of the processor; empty where the system does not tell.
    pub processor: String,
    /// Cores that the program may use.
    pub cores: usize,
    /// Worker threads, but where a table says otherwise.
    pub threads: usize,
    /// Whether the program was built with debug assertions, which cost time.
    pub has_assertions: bool,
}

/// A quantity and its unit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Quantity {
    pub name: String,
    /// `m`, `s`, `%`, `bytes`, …; empty of a bare number.
    pub unit: String,
}

impl Quantity {
    pub fn new(name: &str, unit: &str) -> Quantity {
        Quantity { name: name.into(), unit: unit.into() }
    }

    /// Three digits of a value and the unit.
    pub fn with_unit(&self, value: f64) -> String {
        format!("{} {}", super::significant(value), self.unit).trim_end().to_owned()
    }

    /// With the unit, as on an axis.
    pub fn label(&self) -> String {
        match self.unit.as_str() {
            "" => self.name.clone(),
            unit => format!("{}, {unit}", self.name),
        }
    }
}

/// A figure of the whole run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Fact {
    /// A word by which documents quote it.
    pub id: String,
    pub of: Quantity,
    pub value: f64,
    pub truth: Truth,
}

/// Seconds of repeated runs.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Timing {
    pub median_s: f64,
    pub least_s: f64,
    pub most_s: f64,
    pub runs: usize,
}

impl Timing {
    /// Zero of no runs.
    pub fn of(seconds: &[f64]) -> Timing {
        let runs = seconds.len();
        match stats::spread(seconds) {
            Some(s) => Timing { median_s: s.median, least_s: s.least, most_s: s.most, runs },
            None => Timing { median_s: 0.0, least_s: 0.0, most_s: 0.0, runs: 0 },
        }
    }
}

/// What an error is measured against.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Truth {
    /// The known truth of a simulated survey.
    Simulated,
    /// Points of the scan that were not used.
    HeldOut,
    /// What half of the scan's points give, beside the other half.
    Halves,
    /// All points of the scan, those that were used among them.
    Cloud,
    /// Points that were drawn, all of which were used.
    Drawn,
    /// A finer result of the same program.
    Finer,
    /// The numbers before they were written, or a closed form.
    Exact,
    /// Nothing: it is counted.
    Counted,
}

impl Truth {
    pub fn text(self) -> &'static str {
        match self {
            Truth::Simulated => "against the known truth of the simulated survey",
            Truth::HeldOut => "against points of the scan that were held out",
            Truth::Halves => "of one half of the scan's points against the other half",
            Truth::Cloud => "against all points of the scan, those it was made from among them",
            Truth::Drawn => "against the points that were drawn for it",
            Truth::Finer => "against a finer result of the program itself",
            Truth::Exact => "against what is known exactly",
            Truth::Counted => "as written to the disk",
        }
    }
}

/// Error against run time of one stage.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Front {
    /// Of plots and links.
    pub id: String,
    pub stage: String,
    pub title: String,
    pub error: Quantity,
    pub truth: Truth,
    /// What a setting costs beside seconds; the front is of this, where it is given.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub cost: Option<Quantity>,
    pub note: String,
    /// Groups are things of their own, each with a front.
    pub is_by_group: bool,
    pub points: Vec<Point>,
    /// Whether the default is on the front, and what beats it.
    pub verdict: String,
}

/// One setting of a stage.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Point {
    /// Settings of one kind, drawn alike.
    pub group: String,
    pub setting: String,
    pub error: f64,
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub cost: Option<f64>,
    pub time: Timing,
    /// What the program does when nothing is asked for.
    pub is_default: bool,
    /// No other setting is as cheap and as right.
    pub is_on_front: bool,
}

impl Front {
    /// Points of one subject, in their order: all, or those of each group.
    pub fn subjects(&self) -> Vec<Vec<&Point>> {
        let mut subjects: Vec<Vec<&Point>> = Vec::new();
        for p in &self.points {
            match subjects.iter_mut().find(|s| !self.is_by_group || s[0].group == p.group) {
                Some(subject) => subject.push(p),
                None => subjects.push(vec![p]),
            }
        }
        subjects
    }

    /// What a setting costs: seconds, or what the front has beside them.
    fn costs(&self, p: &Point) -> f64 {
        p.cost.filter(|_| self.cost.is_some()).unwrap_or(p.time.median_s)
    }

    /// Marks the settings that none undercuts in cost and error, and judges the default.
    pub fn marked(mut self) -> Front {
        let on: Vec<(String, String)> = self
            .subjects()
            .iter()
            .flat_map(|subject| {
                let pairs: Vec<[f64; 2]> =
                    subject.iter().map(|p| [self.costs(p), p.error]).collect();
                let is_on = stats::pareto(&pairs);
                let on = subject.iter().zip(is_on).filter(|(_, is_on)| *is_on);
                on.map(|(p, _)| (p.group.clone(), p.setting.clone())).collect::<Vec<_>>()
            })
            .collect();
        for p in &mut self.points {
            p.is_on_front =
                on.iter().any(|(group, setting)| (group, setting) == (&p.group, &p.setting));
        }
        self.verdict = self.judged();
        self
    }

    fn judged(&self) -> String {
        let mut said = Vec::new();
        for subject in self.subjects() {
            for default in subject.iter().filter(|p| p.is_default) {
                let beats =
                    |p: &&&Point| self.costs(p) <= self.costs(default) && p.error <= default.error;
                // What is cheaper by more than runs differ comes first.
                let is_sure = |p: &Point| {
                    self.cost.is_some()
                        || p.time.runs.min(default.time.runs) > 1
                            && p.time.most_s < default.time.least_s
                };
                let others = subject.iter().filter(|p| p.setting != default.setting);
                let best = others
                    .filter(beats)
                    .min_by(|a, b| is_sure(b).cmp(&is_sure(a)).then(a.error.total_cmp(&b.error)));
                said.push(match best {
                    _ if default.is_on_front => format!("{} is on the front.", default.setting),
                    Some(p) => format!(
                        "{} is off the front: {} {} {} {} instead of {}{}.",
                        default.setting,
                        p.setting,
                        match p.error < 0.99 * default.error {
                            true => format!(
                                "has {} instead of {}",
                                super::significant(p.error),
                                self.error.with_unit(default.error)
                            ),
                            false => "is as right".into(),
                        },
                        if self.cost.is_some() { "with" } else { "in" },
                        super::significant(self.costs(p)),
                        match &self.cost {
                            Some(cost) => cost.with_unit(self.costs(default)),
                            None => format!("{} s", super::significant(default.time.median_s)),
                        },
                        match p.time.runs.min(default.time.runs) {
                            _ if is_sure(p) => "",
                            1 => ", of which no spread is known",
                            _ => ", which is within the spread",
                        }
                    ),
                    None => format!("{} is off the front.", default.setting),
                });
            }
        }
        match said.is_empty() {
            true => String::new(),
            false => format!("The default: {}", said.join(" ")),
        }
    }
}

/// An error while a step is halved.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Ladder {
    pub id: String,
    pub stage: String,
    pub title: String,
    pub step: Quantity,
    pub error: Quantity,
    pub truth: Truth,
    pub note: String,
    /// Power of the step with which the error should fall.
    pub stated_order: f64,
    /// From coarse to fine.
    pub rungs: Vec<Rung>,
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub fit: Option<Fit>,
    /// Falls at the stated order, to a fifth, until the floor.
    pub converges: bool,
    pub verdict: String,
}

#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Rung {
    pub step: f64,
    pub error: f64,
}

/// e² = (c · step^order)² + floor².
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Fit {
    pub order: f64,
    /// c.
    pub factor: f64,
    pub floor: f64,
    /// RMS of the errors over the fit, minus one.
    pub off: f64,
}

/// Share of the stated order that a fitted one may be short of.
const SHORT: f64 = 0.2;
/// Errors this far off the fit, RMS, follow no single order; a rise by this above the least is told.
const LOOSE: f64 = 0.25;
/// How many times the finest error the coarsest must be for an order to be seen.
const SEEN: f64 = 2.0;

impl Ladder {
    /// Fits the rungs and judges them.
    pub fn judged(mut self) -> Ladder {
        let points: Vec<[f64; 2]> = self.rungs.iter().map(|r| [r.step, r.error]).collect();
        self.fit = stats::order(&points).map(|Order { order, factor, floor, off }| Fit {
            order,
            factor,
            floor,
            off,
        });
        let least = self.rungs.iter().map(|r| r.error).fold(f64::INFINITY, f64::min);
        // How far errors rise again below the step where they are least.
        let best = self.rungs.iter().position(|r| r.error == least).unwrap_or(0);
        let rises = |r: &Rung| r.error / least - 1.0;
        let risen = self.rungs[best.min(self.rungs.len())..].iter().map(rises).fold(0.0, f64::max);
        let fall = self.rungs.first().map_or(0.0, |r| r.error / least);
        let unit = &self.error.unit;
        (self.converges, self.verdict) = match self.fit {
            _ if self.rungs.iter().all(|r| r.error == 0.0) => (true, "no error at any step".into()),
            None => (false, "no order can be fitted".into()),
            Some(_) if fall < SEEN => {
                (false, format!("does not fall: the finest is {fall:.2} times better"))
            }
            Some(f) if f.order < (1.0 - SHORT) * self.stated_order => {
                (false, format!("falls with order {:.2}, not {}", f.order, self.stated_order))
            }
            Some(f) => {
                let floor = match f.floor {
                    x if x < 0.05 * least => "no floor within these steps".to_owned(),
                    x => format!("floor {} {unit}", super::significant(x)),
                };
                let off = match f.off {
                    x if x < LOOSE => String::new(),
                    x => format!("; no single order: errors lie {:.0} % off the fit", 100.0 * x),
                };
                let rise = match risen {
                    x if x < LOOSE => String::new(),
                    x => {
                        let step = super::significant(self.rungs[best].step);
                        let rise = 100.0 * x;
                        format!("; rises by {rise:.0} % below a step of {step} {}", self.step.unit)
                    }
                };
                (true, format!("falls with order {:.2}; {floor}{off}{rise}", f.order))
            }
        };
        self
    }

    /// Order between each rung and the one before it; `None` of the first, and of no error.
    pub fn orders(&self) -> Vec<Option<f64>> {
        let order = |pair: &[Rung]| {
            let order = (pair[0].error / pair[1].error).ln() / (pair[0].step / pair[1].step).ln();
            order.is_finite().then_some(order)
        };
        std::iter::once(None)
            .chain(self.rungs.windows(2).map(order))
            .take(self.rungs.len())
            .collect()
    }
}

/// An extreme or stiff case, run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Finding {
    pub stage: String,
    pub input: String,
    pub expected: String,
    /// What was measured, or the error that ended it.
    pub happened: String,
    /// How far from what was expected; absent where an error ended it.
    pub miss: Option<f64>,
    pub unit: String,
    /// Greatest miss that passes.
    pub limit: f64,
    pub seconds: f64,
    pub passes: bool,
}

/// What one scene does without.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Omissions {
    pub subject: String,
    pub rows: Vec<Omission>,
}

/// A thing a scene can do without.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Omission {
    pub what: String,
    /// What is not in the files without it.
    pub removed: String,
    /// Bytes of the files, with minus without.
    pub bytes_saved: i64,
    pub with: Timing,
    pub without: Timing,
    /// Greatest heap, with minus without.
    pub peak_bytes_saved: i64,
    /// Counted where the work is done.
    pub work: Vec<Counted>,
    /// All of the work is counted with it, and none without.
    pub is_proved: bool,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Counted {
    pub of: String,
    pub with: u64,
    pub without: u64,
}

/// Seconds and memory against a count.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Scaling {
    pub id: String,
    pub title: String,
    pub over: Quantity,
    pub series: Vec<Series>,
    pub note: String,
}

/// One number of threads.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Series {
    pub threads: usize,
    pub points: Vec<Scaled>,
    /// Seconds over the count to this power.
    pub time_exponent: Option<f64>,
    pub memory_exponent: Option<f64>,
    /// Between the two greatest counts, where what is the same for any count weighs least.
    pub last_time_exponent: Option<f64>,
    pub last_memory_exponent: Option<f64>,
}

#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Scaled {
    pub count: f64,
    pub time: Timing,
    pub peak_bytes: u64,
}

impl Series {
    pub fn fitted(threads: usize, points: Vec<Scaled>) -> Series {
        let exponent = |of: fn(&Scaled) -> f64, last: usize| {
            let from = points.len().saturating_sub(last);
            let pairs: Vec<[f64; 2]> = points[from..].iter().map(|p| [p.count, of(p)]).collect();
            stats::power(&pairs).map(|p| p.exponent)
        };
        let seconds: fn(&Scaled) -> f64 = |p| p.time.median_s;
        let bytes: fn(&Scaled) -> f64 = |p| p.peak_bytes as f64;
        let time_exponent = exponent(seconds, usize::MAX);
        let memory_exponent = exponent(bytes, usize::MAX);
        let last_time_exponent = exponent(seconds, 2);
        let last_memory_exponent = exponent(bytes, 2);
        Series {
            threads,
            points,
            time_exponent,
            memory_exponent,
            last_time_exponent,
            last_memory_exponent,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ladder(errors: [f64; 5], stated_order: f64) -> Ladder {
        let steps = [4.0, 2.0, 1.0, 0.5, 0.25];
        let rungs = steps.into_iter().zip(errors).map(|(step, error)| Rung { step, error });
        Ladder {
            id: "x".into(),
            stage: "x".into(),
            title: "x".into(),
            step: Quantity::new("step", "m"),
            error: Quantity::new("error", "m"),
            truth: Truth::Exact,
            note: String::new(),
            stated_order,
            rungs: rungs.collect(),
            fit: None,
            converges: false,
            verdict: String::new(),
        }
        .judged()
    }

    #[test]
    fn a_ladder_that_falls_short_says_so() {
        let fine = ladder([16.0, 4.0, 1.0, 0.25, 0.0625], 2.0);
        assert!(fine.converges && fine.verdict.contains("no floor"), "{}", fine.verdict);
        let floored = ladder([16.0, 4.0, 1.031, 0.354, 0.258], 2.0);
        assert!(floored.converges && floored.verdict.contains("floor 0.25"), "{}", floored.verdict);
        let slow = ladder([16.0, 8.0, 4.0, 2.0, 1.0], 2.0);
        assert!(!slow.converges && slow.verdict.contains("order 1.00, not 2"), "{}", slow.verdict);
        let flat = ladder([1.0, 1.1, 0.9, 1.0, 1.0], 1.0);
        assert!(!flat.converges && flat.verdict.contains("does not fall"), "{}", flat.verdict);
        let risen = ladder([16.0, 4.0, 1.0, 1.1, 1.4], 2.0);
        assert!(risen.verdict.contains("rises by 40 % below a step of"), "{}", risen.verdict);
        let level = ladder([16.0, 4.0, 1.0, 1.1, 1.2], 2.0);
        assert!(level.converges && !level.verdict.contains("rises"), "{}", level.verdict);
        assert!(ladder([0.0; 5], 1.0).converges);
        assert!(!ladder([1.0, f64::NAN, 0.1, 0.1, 0.1], 1.0).converges);
    }

    #[test]
    fn orders_are_told_step_by_step_and_loose_fits_as_such() {
        let l = ladder([16.0, 4.0, 1.0, 0.5, 0.5], 1.0);
        let orders: Vec<f64> = l.orders().into_iter().flatten().collect();
        assert_eq!((l.orders()[0], orders), (None, vec![2.0, 2.0, 1.0, 0.0]));
        let bent = ladder([4.0, 3.9, 3.0, 0.5, 0.02], 1.0);
        assert!(bent.converges && bent.verdict.contains("no single order"), "{}", bent.verdict);
    }

    fn point(setting: &str, error: f64, median_s: f64) -> Point {
        Point {
            group: "x".into(),
            setting: setting.into(),
            error,
            cost: None,
            time: Timing { median_s, least_s: 0.9 * median_s, most_s: 1.1 * median_s, runs: 3 },
            is_default: false,
            is_on_front: false,
        }
    }

    fn front(points: Vec<Point>) -> Front {
        Front {
            id: "x".into(),
            stage: "x".into(),
            title: "x".into(),
            error: Quantity::new("error", "m"),
            truth: Truth::Exact,
            cost: None,
            note: String::new(),
            is_by_group: false,
            points,
            verdict: String::new(),
        }
    }

    #[test]
    fn groups_that_are_things_of_their_own_have_fronts_of_their_own() {
        let point = |group: &str, error: f64, median_s: f64, is_default: bool| {
            let setting = format!("{group} {error}");
            Point { group: group.into(), is_default, ..point(&setting, error, median_s) }
        };
        let points = vec![
            point("oak", 1.0, 1.0, false),
            point("oak", 0.5, 2.0, true),
            point("fir", 9.0, 3.0, false),
            point("fir", 9.5, 4.0, true),
        ];
        let front = |is_by_group: bool| Front { is_by_group, ..front(points.clone()) };
        let on = |f: &Front| f.points.iter().map(|p| p.is_on_front).collect::<Vec<_>>();
        let (apart, together) = (front(true).marked(), front(false).marked());
        assert_eq!(on(&apart), [true, true, true, false]);
        assert_eq!(on(&together), [true, true, false, false]);
        assert_eq!(
            apart.verdict,
            "The default: oak 0.5 is on the front. fir 9.5 is off the front: fir 9 has 9.00 instead of \
             9.50 m in 3.00 instead of 4.00 s."
        );
    }

    #[test]
    fn a_verdict_names_first_what_is_quicker_for_certain() {
        let point = |setting: &str, error: f64, [least_s, median_s, most_s]: [f64; 3], runs| {
            let time = Timing { median_s, least_s, most_s, runs };
            Point { time, is_default: setting == "usual", ..point(setting, error, median_s) }
        };
        let verdict = |runs: usize| {
            let points = vec![
                point("usual", 2.0, [1.0, 1.2, 1.4], runs),
                point("best", 0.5, [0.9, 1.1, 1.3], runs),
                point("sure", 1.0, [0.5, 0.6, 0.7], runs),
            ];
            front(points).marked().verdict
        };
        assert!(
            verdict(3).ends_with("sure has 1.00 instead of 2.00 m in 0.600 instead of 1.20 s.")
        );
        assert!(verdict(1).contains("best has 0.500 instead of 2.00 m in 1.10"));
        assert!(verdict(1).ends_with(", of which no spread is known."), "{}", verdict(1));
    }

    #[test]
    fn a_front_is_of_the_cost_that_is_given() {
        let point = |setting: &str, error: f64, bytes: f64, median_s: f64| Point {
            cost: Some(bytes),
            is_default: setting == "large",
            ..point(setting, error, median_s)
        };
        let points = vec![
            point("large", 0.0, 9.0, 1.0),
            point("small", 0.0, 3.0, 2.0),
            point("tiny", 1.0, 1.0, 4.0),
        ];
        let front = Front { cost: Some(Quantity::new("size", "MB")), ..front(points) };
        let front = front.marked();
        assert_eq!(
            front.points.iter().map(|p| p.is_on_front).collect::<Vec<_>>(),
            [false, true, true]
        );
        assert_eq!(
            front.verdict,
            "The default: large is off the front: small is as right with 3.00 instead of 9.00 MB."
        );
    }

    #[test]
    fn exponents_are_fitted() {
        let at = |count: f64| Scaled {
            count,
            time: Timing::of(&[2.0 * count]),
            peak_bytes: (count * count) as u64,
        };
        let s = Series::fitted(1, vec![at(10.0), at(100.0), at(1000.0)]);
        assert!((s.time_exponent.unwrap() - 1.0).abs() < 1e-9);
        assert!((s.memory_exponent.unwrap() - 2.0).abs() < 1e-6);
        // A second that any count takes hides the power until counts are great.
        let slow = |count: f64| Scaled { time: Timing::of(&[1.0 + count]), ..at(count) };
        let s = Series::fitted(1, [1.0, 10.0, 1e4, 1e5].map(slow).to_vec());
        assert!(s.time_exponent.unwrap() < 0.97 && s.last_time_exponent.unwrap() > 0.999);
    }
}
