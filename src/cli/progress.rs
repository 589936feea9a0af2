//! Stages on the terminal: a spinner while one runs, a line when it ends.

use std::collections::HashSet;
use std::sync::Mutex;
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressStyle};

use crate::pipeline::measure::Progress;
use crate::report::{Observer, StageRecord};

/// Writes to stderr; draws the spinner only where that is a terminal.
pub struct Terminal {
    bar: Mutex<Option<ProgressBar>>,
    told: Mutex<HashSet<String>>,
}

impl Terminal {
    pub fn new() -> Self {
        Terminal { bar: Mutex::new(None), told: Mutex::default() }
    }

    fn replace(&self, bar: Option<ProgressBar>) -> Option<ProgressBar> {
        let mut slot = self.bar.lock().unwrap_or_else(|e| e.into_inner());
        std::mem::replace(&mut *slot, bar)
    }
}

impl Observer for Terminal {
    fn begin(&self, stage: &str) {
        let style = ProgressStyle::with_template("{spinner} {msg} {elapsed}");
        let bar = ProgressBar::new_spinner().with_message(stage.to_owned());
        if let Ok(style) = style {
            bar.set_style(style);
        }
        bar.enable_steady_tick(Duration::from_millis(120));
        self.replace(Some(bar));
    }

    fn end(&self, record: &StageRecord) {
        if let Some(bar) = self.replace(None) {
            bar.finish_and_clear();
        }
        tell!(
            "{:<10}{:>8.2} s  {} {}",
            record.stage,
            record.seconds,
            record.items_out.count,
            record.items_out.of
        );
    }

    /// Once, though a stage be run again.
    fn warn(&self, warning: &str) {
        if self.told.lock().unwrap_or_else(|e| e.into_inner()).insert(warning.to_owned()) {
            let line = || tell!("warning: {warning}");
            match &*self.bar.lock().unwrap_or_else(|e| e.into_inner()) {
                Some(bar) => bar.suspend(line),
                None => line(),
            }
        }
    }
}

impl Drop for Terminal {
    fn drop(&mut self) {
        if let Some(bar) = self.replace(None) {
            bar.finish_and_clear();
        }
    }
}

/// A bar with the time left, for what takes minutes; a line a step where stderr is no terminal.
pub struct Bar {
    bar: ProgressBar,
    started: Instant,
    expected_s: f64,
    is_quiet: bool,
}

impl Bar {
    /// `expected_s`: what it takes on a usual machine, until its own pace is known.
    pub fn new(expected_s: f64, is_quiet: bool) -> Bar {
        let bar = if is_quiet { ProgressBar::hidden() } else { ProgressBar::new(100) };
        if let Ok(style) = ProgressStyle::with_template("{bar:24} {pos:>3} % {msg}") {
            bar.set_style(style);
        }
        Bar { bar, started: Instant::now(), expected_s, is_quiet }
    }

    /// Seconds left, by the pace so far and, at first, by what is expected.
    fn left_s(&self, share: f64) -> f64 {
        let spent_s = self.started.elapsed().as_secs_f64();
        let by_pace = if share > 0.0 { spent_s * (1.0 - share) / share } else { 0.0 };
        share * by_pace + (1.0 - share) * self.expected_s * (1.0 - share)
    }
}

impl Progress for Bar {
    fn at(&self, share: f64, what: &str) {
        let told = format!("{what}, about {:.0} s left", self.left_s(share));
        self.bar.set_position((100.0 * share) as u64);
        self.bar.set_message(told.clone());
        if self.bar.is_hidden() && !self.is_quiet {
            tell!("{:>3.0} %  {told}", 100.0 * share);
        }
    }
}

impl Drop for Bar {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
    }
}
