//! Extreme and stiff cases of every stage, run and judged: those of growth
//! ([`crate::skeleton::stability`]), of what comes before it (`inputs`, `ground`), and of what is made
//! of trees (`models`) and of scenes (`scenes`).

/// `stage: input => expected, limit unit, measure;`
macro_rules! cases {
    ($($stage:ident: $input:literal => $expected:literal, $limit:literal $unit:literal, $measure:expr;)*) => {
        vec![$((stringify!($stage), Case::new($input, $expected, ($limit, $unit), $measure))),*]
    };
}

mod ground;
mod inputs;
mod models;
mod scenes;

use crate::diagnostic::Result;
use crate::report::document::Finding;
use crate::report::significant;
use crate::skeleton::stability::{self as growth, Case};

/// All cases with their stages.
fn cases() -> impl Iterator<Item = (&'static str, Case)> {
    let growth = growth::cases().into_iter().map(|case| ("skeleton", case));
    inputs::cases()
        .into_iter()
        .chain(ground::cases())
        .chain(growth)
        .chain(models::cases())
        .chain(scenes::cases())
}

/// How many were answered that should have been refused.
fn unrefused<T>(outcomes: impl IntoIterator<Item = Result<T>>) -> f64 {
    outcomes.into_iter().filter(Result::is_ok).count() as f64
}

/// Runs every case, one after another.
pub fn run() -> Vec<Finding> {
    cases().map(|(stage, case)| found(stage, &case)).collect()
}

fn found(stage: &str, case: &Case) -> Finding {
    let f = case.run();
    let happened = match &f.ended_by {
        Some(error) => format!("error: {error}"),
        None => format!("{} {}", plain(f.measured), f.unit),
    };
    Finding {
        stage: stage.into(),
        input: f.name.into(),
        expected: f.expectation.into(),
        happened,
        miss: f.measured.is_finite().then_some(f.measured),
        unit: f.unit.into(),
        limit: f.limit,
        seconds: f.seconds,
        passes: f.passes(),
    }
}

fn plain(value: f64) -> String {
    match value.abs() {
        v if v == v.trunc() && v < 1e6 => format!("{value}"),
        v if (1e-3..1e6).contains(&v) => significant(value),
        _ => format!("{value:.1e}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnostic::Error;

    /// Those of growth have a test of their own.
    #[test]
    fn every_case_before_and_after_growth_passes() {
        let all: Vec<Finding> = (inputs::cases().into_iter())
            .chain(ground::cases())
            .chain(models::cases())
            .chain(scenes::cases())
            .map(|(stage, case)| found(stage, &case))
            .collect();
        assert!(all.len() >= 60, "{}", all.len());
        let missed: Vec<String> = all
            .iter()
            .filter(|f| !f.passes)
            .map(|f| format!("{}: {}: {} (limit {})", f.stage, f.input, f.happened, f.limit))
            .collect();
        assert!(missed.is_empty(), "{}", missed.join("\n"));
    }

    #[test]
    fn a_miss_is_told_with_its_error() {
        let case = |measure| Case::new("x", "y", (1.0, "m"), measure);
        let missed = found("mesh", &case(|| Ok(1.5)));
        assert_eq!((missed.passes, missed.happened.as_str()), (false, "1.50 m"));
        let failed = found("mesh", &case(|| Err(Error::new("no room"))));
        assert_eq!((failed.passes, failed.happened.as_str()), (false, "error: no room"));
        assert_eq!(failed.miss, None);
        assert!(found("mesh", &case(|| Ok(1.0))).passes);
    }
}
