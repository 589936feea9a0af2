//! Stages on the terminal: a spinner while one runs, a line when it ends.

use std::sync::Mutex;
use std::time::Duration;

use indicatif::{ProgressBar, ProgressStyle};

use crate::report::{Observer, StageRecord};

/// Writes to stderr; draws the spinner only where that is a terminal.
pub struct Terminal {
    bar: Mutex<Option<ProgressBar>>,
}

impl Terminal {
    pub fn new() -> Self {
        Terminal { bar: Mutex::new(None) }
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
        eprintln!(
            "{:<10}{:>8.2} s  {} {}",
            record.stage, record.seconds, record.items_out.count, record.items_out.of
        );
    }
}

impl Drop for Terminal {
    fn drop(&mut self) {
        if let Some(bar) = self.replace(None) {
            bar.finish_and_clear();
        }
    }
}
