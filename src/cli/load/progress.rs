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

/// Runs `work` with a progress line. Returns its result and the time that it took. `work` gets the counts to keep,
/// the time at which it begins, and the time at which it has to end.
pub(super) async fn timed<T>(
    seconds: f64,
    work: impl AsyncFnOnce(Arc<LiveCounts>, Instant, Instant) -> T,
) -> (T, Duration) {
    let live = Arc::new(LiveCounts::default());
    let started = Instant::now();
    let limit = Duration::from_secs_f64(seconds);
    let progress = tokio::spawn(show_progress(live.clone(), started, limit));
    let result = work(live, started, started + limit).await;
    let elapsed = started.elapsed();
    progress.abort();
    // The task has been aborted or has ended. Either way the progress line is removed before the
    // summary is printed.
    let _ = progress.await;
    (result, elapsed)
}

/// Shows a progress line on standard error, if that is a terminal.
async fn show_progress(live: Arc<LiveCounts>, started: Instant, limit: Duration) {
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
