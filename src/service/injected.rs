//! What tests of overload put in the way of pairs, so that they know the capacity.

use std::{
    cell::Cell,
    sync::{
        Condvar, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicBool, AtomicU64, Ordering},
    },
    thread,
    time::{Duration, Instant},
};

use crate::lock::locked;

/// Nothing, but for tests.
#[derive(Debug, Default)]
pub struct Injected {
    /// Nanoseconds that a pair takes, asleep.
    delay: AtomicU64,
    gated: AtomicBool,
    /// Pairs that may pass the gate.
    allowed: Mutex<usize>,
    changed: Condvar,
}

thread_local! {
    /// When this thread's last pairs were to be done.
    static DUE: Cell<Option<Instant>> = const { Cell::new(None) };
}

impl Injected {
    /// Every pair takes so much longer, asleep.
    pub fn delay(&self, per_pair: Duration) {
        self.delay.store(per_pair.as_nanos() as u64, Ordering::Relaxed);
    }

    /// From now on so many more pairs are computed and no others, until `open`.
    pub fn allow(&self, pairs: usize) {
        *self.allowed() += pairs;
        self.gated.store(true, Ordering::Relaxed);
        self.changed.notify_all();
    }

    /// All pairs are computed again.
    pub fn open(&self) {
        let allowed = self.allowed();
        self.gated.store(false, Ordering::Relaxed);
        drop(allowed);
        self.changed.notify_all();
    }

    /// Before so many pairs are computed.
    pub(super) fn pass(&self, pairs: usize) {
        let delay = self.delay.load(Ordering::Relaxed);
        if delay > 0 {
            sleep(Duration::from_nanos(delay) * pairs as u32);
        }
        if self.gated.load(Ordering::Relaxed) {
            let mut allowed = self.allowed();
            while self.gated.load(Ordering::Relaxed) && *allowed < pairs {
                allowed = self.changed.wait(allowed).unwrap_or_else(PoisonError::into_inner);
            }
            *allowed = allowed.saturating_sub(pairs);
        }
    }

    fn allowed(&self) -> MutexGuard<'_, usize> {
        locked(&self.allowed)
    }
}

/// Asleep for so long; a thread that the system woke late makes up for it with its next pairs,
/// or a busy machine would be taken for a server that does less than it could.
fn sleep(duration: Duration) {
    let now = Instant::now();
    let late = DUE.get().filter(|due| *due <= now && now - *due < duration);
    let due = late.unwrap_or(now) + duration;
    thread::sleep(due.saturating_duration_since(now));
    DUE.set(Some(due));
}
