//! Log lines that callers can cause: at most one per second from each place in the code.
//!
//! A caller that sends the same bad request in a loop must not fill the disk with log lines. Therefore
//! every line of the levels `error`, `warn` and `info` that a caller can cause is written by the macro
//! `limited!`. Each place in the code owns a [`LogLimit`], and the next line that is written tells how
//! many were left out in the meantime:
//!
//! ```ignore
//! limited!(info, reason, "a call was refused for its token");
//! ```
//!
//! Lines of the levels `debug` and `trace` are not limited, because an operator who asks for them wants a
//! line for each call and each connection. No call writes more than a few of them.

use std::{
    sync::{
        LazyLock,
        atomic::{AtomicU64, Ordering},
    },
    time::{Duration, Instant},
};

/// The shortest time between two lines from one place.
const INTERVAL: Duration = Duration::from_secs(1);

/// The start of the times below.
static STARTED: LazyLock<Instant> = LazyLock::new(Instant::now);

/// One place in the code that writes a log line.
#[derive(Debug, Default)]
pub struct LogLimit {
    /// The time at which the next line may be written, in milliseconds since `STARTED`.
    next_ms: AtomicU64,
    left_out: AtomicU64,
}

impl LogLimit {
    /// A place that has not written a line yet.
    pub const fn new() -> Self {
        Self { next_ms: AtomicU64::new(0), left_out: AtomicU64::new(0) }
    }

    /// Returns the number of lines left out since the last one if a line may be written now. Otherwise
    /// counts this line as left out and returns `None`.
    pub fn due(&self) -> Option<u64> {
        self.due_at(STARTED.elapsed())
    }

    fn due_at(&self, now: Duration) -> Option<u64> {
        let ms = |time: Duration| u64::try_from(time.as_millis()).unwrap_or(u64::MAX);
        let (now_ms, next_ms) = (ms(now), self.next_ms.load(Ordering::Relaxed));
        let after = now_ms.saturating_add(ms(INTERVAL));
        let is_due = now_ms >= next_ms
            // If several threads find the line due, one of them writes it.
            && self.next_ms.compare_exchange(next_ms, after, Ordering::Relaxed, Ordering::Relaxed).is_ok();
        if is_due {
            return Some(self.left_out.swap(0, Ordering::Relaxed));
        }
        self.left_out.fetch_add(1, Ordering::Relaxed);
        None
    }
}

/// Writes a line of the given level, with the given fields and text, unless this place in the code has
/// already written a line within the last second. The field `left_out` counts the lines that were left out.
macro_rules! limited {
    ($level:ident, $($line:tt)+) => {{
        static LIMIT: $crate::log_limit::LogLimit = $crate::log_limit::LogLimit::new();
        if let Some(left_out) = LIMIT.due() {
            tracing::$level!(left_out, $($line)+);
        }
    }};
}
pub(crate) use limited;

#[cfg(test)]
mod tests {
    use std::{path::Path, sync::Arc};

    use tracing_subscriber::layer::SubscriberExt;

    use super::*;

    /// The lines that no caller causes, by the file: the server stops, the store is probed, files of the
    /// operator are read again.
    const OF_THE_OPERATOR: [(&str, usize); 2] =
        [("service/security/reloaded.rs", 3), ("service/server.rs", 4)];

    /// Counts the lines below `folder` that are logged without a limit, by file.
    fn unlimited(folder: &Path, root: &Path, found: &mut Vec<(String, usize)>) {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            let name = path.strip_prefix(root).unwrap().to_str().unwrap().to_owned();
            if path.is_dir() {
                // The command line has no callers.
                if name != "cli" {
                    unlimited(&path, root, found);
                }
                continue;
            }
            let text = std::fs::read_to_string(&path).unwrap();
            let count = ["error!(", "warn!(", "info!("].map(|level| {
                text.lines()
                    .filter(|line| !line.trim_start().starts_with("//") && line.contains(level))
                    .count()
            });
            found.push((name, count.iter().sum()));
        }
    }

    /// Catches a line that a caller can cause as often as it likes, and that therefore fills the disk.
    #[test]
    fn every_line_that_a_caller_can_cause_is_limited() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
        let mut found = Vec::new();
        unlimited(&root, &root, &mut found);
        found.retain(|(name, count)| *count > 0 && name != "log_limit.rs");
        found.sort();
        let allowed: Vec<_> = OF_THE_OPERATOR.iter().map(|&(name, count)| (name.to_owned(), count)).collect();
        assert_eq!(found, allowed, "use `limited!`, or list a line that no caller causes");
    }

    /// Catches a place that writes each line, and two places that share one limit.
    #[test]
    fn each_place_has_a_limit_of_its_own() {
        let written = Arc::new(AtomicU64::new(0));
        let counted = written.clone();
        let layer = tracing_subscriber::fmt::layer().with_writer(move || {
            counted.fetch_add(1, Ordering::Relaxed);
            std::io::sink()
        });
        let subscriber = tracing_subscriber::registry().with(layer);
        tracing::subscriber::with_default(subscriber, || {
            for number in 0..1000 {
                limited!(warn, number, "the first place");
                limited!(info, number, "the second place");
            }
        });
        // A slow machine may need more than a second for the loop.
        let written = written.load(Ordering::Relaxed);
        assert!((2..100).contains(&written), "{written} lines");
    }

    /// Catches a second line within the second, a line that is missing after it, and a wrong count of the
    /// lines that were left out.
    #[test]
    fn one_line_a_second_with_the_number_left_out() {
        let place = LogLimit::new();
        let due = |ms| place.due_at(Duration::from_millis(ms));
        assert_eq!(due(0), Some(0));
        assert_eq!((due(0), due(500), due(999)), (None, None, None));
        assert_eq!(due(1000), Some(3));
        assert_eq!((due(1999), due(5000), due(5001)), (None, Some(1), None));
    }

    /// Catches two threads that both write the line.
    #[test]
    fn one_of_many_threads_writes_the_line() {
        let place = LogLimit::new();
        let written = AtomicU64::new(0);
        std::thread::scope(|scope| {
            for _ in 0..8 {
                scope.spawn(|| {
                    let lines = (0..1000).filter(|_| place.due_at(Duration::from_millis(7)).is_some());
                    written.fetch_add(lines.count() as u64, Ordering::Relaxed);
                });
            }
        });
        assert_eq!(written.into_inner(), 1);
        assert_eq!(place.due_at(Duration::from_secs(2)), Some(7999));
    }
}
