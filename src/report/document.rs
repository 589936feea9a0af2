//! The types of a report: what `report.json` holds, and its schema.

use schemars::{JsonSchema, SchemaGenerator};
use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::stats::{self, Order};

/// Counts changes of the layout.
pub const SCHEMA: u32 = 1;

/// A whole report.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Document {
    /// Counts changes of this layout.
    pub schema: u32,
    pub about: About,
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

    /// With the unit, as on an axis.
    pub fn label(&self) -> String {
        match self.unit.as_str() {
            "" => self.name.clone(),
            unit => format!("{}, {unit}", self.name),
        }
    }
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
    /// All points of the scan, those that were used among them.
    Cloud,
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
            Truth::Cloud => "against all points of the scan, those it was made from among them",
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
    /// What a setting costs beside seconds.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub cost: Option<Quantity>,
    pub note: String,
    pub points: Vec<Point>,
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
    /// No other setting is as quick and as right.
    pub is_on_front: bool,
}

impl Front {
    /// Marks the settings that none undercuts in seconds and error.
    pub fn marked(mut self) -> Front {
        let pairs: Vec<[f64; 2]> = self.points.iter().map(|p| [p.time.median_s, p.error]).collect();
        for (point, is_on) in self.points.iter_mut().zip(stats::pareto(&pairs)) {
            point.is_on_front = is_on;
        }
        self
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
                (true, format!("falls with order {:.2}; {floor}", f.order))
            }
        };
        self
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
}

#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Scaled {
    pub count: f64,
    pub time: Timing,
    pub peak_bytes: u64,
}

impl Series {
    pub fn fitted(threads: usize, points: Vec<Scaled>) -> Series {
        let exponent = |of: fn(&Scaled) -> f64| {
            let pairs: Vec<[f64; 2]> = points.iter().map(|p| [p.count, of(p)]).collect();
            stats::power(&pairs).map(|p| p.exponent)
        };
        let time_exponent = exponent(|p| p.time.median_s);
        let memory_exponent = exponent(|p| p.peak_bytes as f64);
        Series { threads, points, time_exponent, memory_exponent }
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
        assert!(ladder([0.0; 5], 1.0).converges);
        assert!(!ladder([1.0, f64::NAN, 0.1, 0.1, 0.1], 1.0).converges);
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
    }
}
