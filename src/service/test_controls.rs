//! Slows or stops the computation of pairs, so that tests of overload know the server's capacity.

use std::{
    cell::Cell,
    sync::{
        Arc, Condvar, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicBool, AtomicU64, Ordering},
    },
    thread,
    time::{Duration, Instant},
};

use tokio::{
    runtime::{Handle, RuntimeFlavor},
    task::block_in_place,
};

use crate::{batch, compute::Compute, lock::locked};

/// Controls for tests. By default they do nothing.
#[derive(Debug, Default)]
pub struct TestControls {
    /// The time in nanoseconds for which the thread sleeps per pair.
    delay: AtomicU64,
    gated: AtomicBool,
    /// The number of pairs that may pass the gate.
    allowed: Mutex<usize>,
    changed: Condvar,
}

thread_local! {
    /// The time at which this thread's last pairs were due.
    static DUE: Cell<Option<Instant>> = const { Cell::new(None) };
}

impl TestControls {
    /// An engine that waits before each chunk as these controls say.
    pub(super) fn engine(self: &Arc<Self>, compute: Compute, max_answer_bytes: usize) -> batch::Engine {
        let controls = self.clone();
        batch::Engine::with_hook(compute, max_answer_bytes, move |pairs| controls.pass(pairs))
    }

    /// Makes the thread sleep for this time per pair.
    pub fn delay(&self, per_pair: Duration) {
        self.delay.store(per_pair.as_nanos() as u64, Ordering::Relaxed);
    }

    /// Allows `pairs` more pairs to be computed. From the first call on, no others are computed
    /// until `open`.
    pub fn allow(&self, pairs: usize) {
        *self.allowed() += pairs;
        self.gated.store(true, Ordering::Relaxed);
        self.changed.notify_all();
    }

    /// Allows all pairs again.
    pub fn open(&self) {
        let allowed = self.allowed();
        self.gated.store(false, Ordering::Relaxed);
        drop(allowed);
        self.changed.notify_all();
    }

    /// Waits for as long as the test has configured. The engine calls this before it computes
    /// `pairs` pairs.
    fn pass(&self, pairs: usize) {
        // The engine computes cheap batches on the thread that serves the call. While that thread waits here,
        // another one has to take over its sockets and tasks.
        match Handle::try_current().map(|runtime| runtime.runtime_flavor()) {
            Ok(RuntimeFlavor::MultiThread) => block_in_place(|| self.wait(pairs)),
            _ => self.wait(pairs),
        }
    }

    fn wait(&self, pairs: usize) {
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

/// Sleeps for `duration`. If the system wakes a thread late, the thread sleeps less for its next
/// pairs. Otherwise a server on a busy machine would have less than the configured capacity.
fn sleep(duration: Duration) {
    let now = Instant::now();
    let late = DUE.get().filter(|due| *due <= now && now - *due < duration);
    let due = late.unwrap_or(now) + duration;
    thread::sleep(due.saturating_duration_since(now));
    DUE.set(Some(due));
}
