//! Shows the progress of a run.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressStyle};

/// Time between updates of the progress line.
const REFRESH: Duration = Duration::from_millis(200);
/// The counts that the progress line shows.
#[derive(Debug, Default)]
pub(super) struct LiveCounts {
    /// Batches begun.
    pub(super) begun: AtomicU64,
    pub(super) pairs: AtomicU64,
    pub(super) errors: AtomicU64,
    pub(super) last_nanos: AtomicU64,
}

/// Shows a progress line on standard error, if that is a terminal.
pub(super) async fn show_progress(live: Arc<LiveCounts>, started: Instant, limit: Duration) {
    let bar = ProgressBar::new(limit.as_millis().max(1) as u64);
    if let Ok(style) = ProgressStyle::with_template("{wide_bar} {msg}") {
        bar.set_style(style);
    }
    let _clear = ClearWhenDropped(bar.clone());
    let (mut then, mut before) = (started, 0);
    loop {
        tokio::time::sleep(REFRESH).await;
        let (now, pairs) = (Instant::now(), live.pairs.load(Ordering::Relaxed));
        let rate = (pairs - before) as f64 / (now - then).as_secs_f64();
        (then, before) = (now, pairs);
        bar.set_position(started.elapsed().as_millis() as u64);
        bar.set_message(format!(
            "{:.3} M pairs/s, last batch {:.2} ms, {} errors",
            rate / 1e6,
            live.last_nanos.load(Ordering::Relaxed) as f64 / 1e6,
            live.errors.load(Ordering::Relaxed)
        ));
    }
}

struct ClearWhenDropped(ProgressBar);

impl Drop for ClearWhenDropped {
    fn drop(&mut self) {
        self.0.finish_and_clear();
    }
}
