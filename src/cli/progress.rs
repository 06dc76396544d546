//! Shows the progress of work that takes longer than a second, on standard error.

use std::sync::mpsc::{self, RecvTimeoutError, Sender};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

/// Work that ends within this time shows nothing.
const PATIENCE: Duration = Duration::from_secs(1);
/// How often the line is drawn again.
const REFRESH: Duration = Duration::from_millis(200);

/// A line on standard error that appears after a second, and only on a terminal. It is removed
/// when this value is dropped.
#[derive(Debug)]
pub(crate) struct Progress {
    bar: ProgressBar,
    /// Dropped to end the thread that waits for the second to pass.
    ended: Option<Sender<()>>,
    waiting: Option<JoinHandle<()>>,
}

impl Progress {
    /// Progress of work in `total` parts. `what` names the work, as in "building hulls".
    pub(crate) fn new(what: &str, total: usize) -> Self {
        let template = "{msg} {bar:30} {pos}/{len}, {elapsed} so far, {eta} left";
        Self::begin(ProgressBar::with_draw_target(Some(total as u64), hidden()), template, what)
    }

    /// Progress of work in parts whose number is not known.
    pub(crate) fn counting(what: &str) -> Self {
        let bar = ProgressBar::with_draw_target(None, hidden());
        Self::begin(bar, "{spinner} {msg} {pos}, {elapsed} so far", what)
    }

    /// Progress of work for which only the elapsed time is known.
    pub(crate) fn waiting(what: &str) -> Self {
        Self::begin(ProgressBar::with_draw_target(None, hidden()), "{spinner} {msg}, {elapsed} so far", what)
    }

    fn begin(bar: ProgressBar, template: &str, what: &str) -> Self {
        if let Ok(style) = ProgressStyle::with_template(template) {
            bar.set_style(style);
        }
        bar.set_message(what.to_owned());
        let (ended, wait) = mpsc::channel::<()>();
        let shown = bar.clone();
        let waiting = thread::spawn(move || {
            if wait.recv_timeout(PATIENCE) == Err(RecvTimeoutError::Timeout) {
                // If standard error is not a terminal, this target draws nothing.
                shown.set_draw_target(ProgressDrawTarget::stderr());
                shown.enable_steady_tick(REFRESH);
            }
        });
        Self { bar, ended: Some(ended), waiting: Some(waiting) }
    }

    /// Adds this number of finished parts.
    pub(crate) fn add(&self, parts: usize) {
        self.bar.inc(parts as u64);
    }
}

fn hidden() -> ProgressDrawTarget {
    ProgressDrawTarget::hidden()
}

impl Drop for Progress {
    fn drop(&mut self) {
        self.ended = None;
        if let Some(waiting) = self.waiting.take() {
            // If the thread could not run, no line is shown.
            let _ = waiting.join();
        }
        self.bar.finish_and_clear();
    }
}
