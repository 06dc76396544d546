//! Log lines that callers can cause: at most one per second from each place in the code.
//!
//! A caller that sends the same bad request in a loop must not fill the disk with log lines. Each place in
//! the code that writes such a line owns a [`Repeated`] and asks it first. The next line that is written
//! tells how many were left out:
//!
//! ```
//! use hullcast::log_limit::Repeated;
//!
//! static REFUSED: Repeated = Repeated::new();
//! if let Some(left_out) = REFUSED.due() {
//!     tracing::info!(left_out, "a token was refused");
//! }
//! ```

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
pub struct Repeated {
    /// The time at which the next line may be written, in milliseconds since `STARTED`.
    next_ms: AtomicU64,
    left_out: AtomicU64,
}

impl Repeated {
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

#[cfg(test)]
mod tests {
    use super::*;

    /// Catches a second line within the second, a line that is missing after it, and a wrong count of the
    /// lines that were left out.
    #[test]
    fn one_line_a_second_with_the_number_left_out() {
        let place = Repeated::new();
        let due = |ms| place.due_at(Duration::from_millis(ms));
        assert_eq!(due(0), Some(0));
        assert_eq!((due(0), due(500), due(999)), (None, None, None));
        assert_eq!(due(1000), Some(3));
        assert_eq!((due(1999), due(5000), due(5001)), (None, Some(1), None));
    }

    /// Catches two threads that both write the line.
    #[test]
    fn one_of_many_threads_writes_the_line() {
        let place = Repeated::new();
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
