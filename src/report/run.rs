//! What a run did: seconds, items, memory and error of each stage, warnings, results.

use std::time::Instant;

use serde::Serialize;

use crate::heap;

/// A figure a stage knows of its own error.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ErrorMeasure {
    /// What is measured, e.g. `held-out height RMSE`.
    pub measure: String,
    pub value: f64,
    /// `m`, `%`, …
    pub unit: String,
}

impl ErrorMeasure {
    pub fn new(measure: &str, value: f64, unit: &str) -> Self {
        ErrorMeasure { measure: measure.into(), value, unit: unit.into() }
    }
}

/// One stage of one run.
#[derive(Debug, Clone, Serialize)]
pub struct StageRecord {
    pub stage: String,
    pub seconds: f64,
    /// What went in and how many, e.g. `points`.
    pub items_in: Items,
    pub items_out: Items,
    /// Most heap bytes held at once by the process during the stage; 0 where the allocator does
    /// not count.
    pub peak_bytes: u64,
    /// Absent where the stage has nothing to be wrong about.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub error: Option<ErrorMeasure>,
    /// Further facts worth a line.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub notes: Vec<String>,
}

/// A count of named things.
#[derive(Debug, Clone, Serialize)]
pub struct Items {
    pub count: u64,
    pub of: String,
}

/// What a stage tells of itself when it ends.
#[derive(Debug, Default)]
pub struct Outcome {
    items_in: Option<Items>,
    items_out: Option<Items>,
    error: Option<ErrorMeasure>,
    notes: Vec<String>,
}

impl Outcome {
    pub fn items(in_count: usize, in_of: &str, out_count: usize, out_of: &str) -> Self {
        Outcome {
            items_in: Some(Items { count: in_count as u64, of: in_of.into() }),
            items_out: Some(Items { count: out_count as u64, of: out_of.into() }),
            ..Outcome::default()
        }
    }

    pub fn error(mut self, measure: ErrorMeasure) -> Self {
        self.error = Some(measure);
        self
    }

    pub fn note(mut self, text: impl Into<String>) -> Self {
        self.notes.push(text.into());
        self
    }
}

/// Told as stages begin and end, so that a person can watch.
pub trait Observer: Sync {
    fn begin(&self, stage: &str);
    fn end(&self, record: &StageRecord);
    /// At the end of the stage that found it, which may be followed by much work.
    fn warn(&self, warning: &str);
}

/// Observes nothing.
pub struct Silent;

impl Observer for Silent {
    fn begin(&self, _: &str) {}
    fn end(&self, _: &StageRecord) {}
    fn warn(&self, _: &str) {}
}

/// Collects the records of a run.
pub struct Recorder<'a> {
    observer: &'a dyn Observer,
    started: Instant,
    pub stages: Vec<StageRecord>,
    pub warnings: Vec<String>,
}

impl<'a> Recorder<'a> {
    pub fn new(observer: &'a dyn Observer) -> Self {
        Recorder { observer, started: Instant::now(), stages: Vec::new(), warnings: Vec::new() }
    }

    /// Runs one stage, timed; `work` may add warnings.
    ///
    /// # Errors
    /// Those of `work`.
    pub fn stage<T, E>(
        &mut self,
        name: &str,
        work: impl FnOnce(&mut Vec<String>) -> Result<(T, Outcome), E>,
    ) -> Result<T, E> {
        self.observer.begin(name);
        heap::forget_most();
        let start = Instant::now();
        let known = self.warnings.len();
        let done = work(&mut self.warnings);
        let tell = |of: &Self| of.warnings.iter().skip(known).for_each(|w| of.observer.warn(w));
        let (value, outcome) = done.inspect_err(|_| tell(self))?;
        let none = || Items { count: 0, of: "none".into() };
        let record = StageRecord {
            stage: name.into(),
            seconds: start.elapsed().as_secs_f64(),
            items_in: outcome.items_in.unwrap_or_else(none),
            items_out: outcome.items_out.unwrap_or_else(none),
            peak_bytes: heap::most_bytes(),
            error: outcome.error,
            notes: outcome.notes,
        };
        self.observer.end(&record);
        tell(self);
        self.stages.push(record);
        Ok(value)
    }

    /// Seconds since the recorder was made.
    pub fn seconds(&self) -> f64 {
        self.started.elapsed().as_secs_f64()
    }

    /// Greatest of the stages' peaks.
    pub fn peak_bytes(&self) -> u64 {
        self.stages.iter().map(|s| s.peak_bytes).max().unwrap_or(0)
    }
}

/// A table of the stages for a terminal, 100 columns wide.
pub fn table(stages: &[StageRecord]) -> String {
    use std::fmt::Write;
    let mut out = String::new();
    let _ = writeln!(
        out,
        "{:<12}{:>9}  {:>10} {:<10} {:>10} {:<12}{:>9}  error",
        "stage", "seconds", "in", "", "out", "", "peak"
    );
    for s in stages {
        let error = s.error.as_ref().map_or(String::new(), |e| {
            format!("{} {} {}", e.measure, significant(e.value), e.unit)
        });
        let _ = writeln!(
            out,
            "{:<12}{:>9.3}  {:>10} {:<10} {:>10} {:<12}{:>6} MB  {}",
            s.stage,
            s.seconds,
            s.items_in.count,
            s.items_in.of,
            s.items_out.count,
            s.items_out.of,
            s.peak_bytes / 1_000_000,
            error
        );
    }
    out
}

/// Three significant digits, plain notation.
pub fn significant(value: f64) -> String {
    if value == 0.0 || !value.is_finite() {
        return format!("{value}");
    }
    let digits = (2 - value.abs().log10().floor() as i32).clamp(0, 9) as usize;
    format!("{value:.digits$}")
}

/// In groups of three digits.
pub fn grouped(value: u64) -> String {
    let digits = value.to_string();
    let mut out = String::new();
    for (k, digit) in digits.chars().enumerate() {
        if k > 0 && (digits.len() - k).is_multiple_of(3) {
            out.push('\u{202f}');
        }
        out.push(digit);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_failing_stage_leaves_no_record() {
        let mut recorder = Recorder::new(&Silent);
        let r: Result<(), &str> = recorder.stage("ground", |_| Err("no ground"));
        assert_eq!(r, Err("no ground"));
        assert!(recorder.stages.is_empty());
    }

    #[test]
    fn records_keep_order_items_and_warnings() {
        let mut recorder = Recorder::new(&Silent);
        for name in ["scan", "ground"] {
            let value: Result<i32, ()> = recorder.stage(name, |w| {
                w.push(format!("{name} warns"));
                let measure = ErrorMeasure::new("RMSE", 0.123456, "m");
                Ok((7, Outcome::items(5, "files", 9, "points").error(measure)))
            });
            assert_eq!(value, Ok(7));
        }
        assert_eq!(recorder.warnings, ["scan warns", "ground warns"]);
        assert_eq!(recorder.stages[1].items_out.count, 9);
        let shown = table(&recorder.stages);
        assert!(shown.contains("RMSE 0.123 m"), "{shown}");
    }

    #[test]
    fn three_significant_digits() {
        let shown: Vec<_> = [1234.5, 12.345, 0.0123456, 0.0].map(significant).into();
        assert_eq!(shown, ["1234", "12.3", "0.0123", "0"]);
    }
}
