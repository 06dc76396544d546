//! A flag that stops a long computation, and a count of the work that it has done.
//!
//! A computation takes a [`Stop`] and calls [`Stop::spend`] with the number of elementary steps
//! that it has done or is about to do. The call adds the steps to the count, and fails once the
//! computation has been asked to stop. A step is about one nanosecond of plain arithmetic on the
//! reference machine; an exact predicate counts as the number of steps that it was measured to
//! take. A loop gathers small steps and spends them together, at most [`STEPS_BETWEEN_LOOKS`] at
//! a time, so that the flag is checked about once per millisecond.
//!
//! The count and the flag never change a result. They only end the computation early.

use std::{
    cell::Cell,
    fmt,
    sync::atomic::{AtomicBool, AtomicU64, Ordering},
};

/// The largest number of steps between two checks of the flag: about 1 ms.
pub const STEPS_BETWEEN_LOOKS: u64 = 1 << 20;

/// The number of steps that a [`Meter`] gathers before it spends them. It is a fraction of
/// [`STEPS_BETWEEN_LOOKS`], so that the steps of one more call of [`Meter::spend`] still fit.
const GATHERED: u64 = STEPS_BETWEEN_LOOKS / 16;

/// Asks a computation to stop, and counts its steps. The threads of one computation share it.
#[derive(Debug, Default)]
pub struct Stop {
    stopped: AtomicBool,
    steps: AtomicU64,
    largest: AtomicU64,
}

/// The computation was asked to stop before it ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stopped;

impl fmt::Display for Stopped {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("the computation was stopped")
    }
}

impl std::error::Error for Stopped {}

impl Stop {
    /// Asks the computation to stop.
    pub fn stop(&self) {
        self.stopped.store(true, Ordering::Relaxed);
    }

    /// Whether the computation was asked to stop.
    #[inline]
    pub fn is_stopped(&self) -> bool {
        self.stopped.load(Ordering::Relaxed)
    }

    /// Counts `steps` elementary steps.
    ///
    /// # Errors
    /// The computation was asked to stop.
    #[inline]
    pub fn spend(&self, steps: u64) -> Result<(), Stopped> {
        self.steps.fetch_add(steps, Ordering::Relaxed);
        // Most spends are not the largest, and reading costs less than an atomic change.
        if steps > self.largest.load(Ordering::Relaxed) {
            self.largest.fetch_max(steps, Ordering::Relaxed);
        }
        if self.is_stopped() { Err(Stopped) } else { Ok(()) }
    }

    /// The number of steps counted so far.
    pub fn steps(&self) -> u64 {
        self.steps.load(Ordering::Relaxed)
    }

    /// The largest number of steps in one call of [`Stop::spend`]: the longest time between two
    /// checks of the flag.
    pub fn largest_between_looks(&self) -> u64 {
        self.largest.load(Ordering::Relaxed)
    }
}

/// Gathers the small steps of one thread, so that a tight loop touches no shared memory.
///
/// The meter spends the gathered steps whenever there are enough of them, and spends the rest when
/// it is dropped.
#[derive(Debug)]
pub struct Meter<'a> {
    stop: &'a Stop,
    gathered: Cell<u64>,
}

impl<'a> Meter<'a> {
    /// A meter that spends its steps in `stop`.
    pub fn new(stop: &'a Stop) -> Self {
        Self { stop, gathered: Cell::new(0) }
    }

    /// Counts steps without checking the flag.
    #[inline]
    pub fn count(&self, steps: u64) {
        self.gathered.set(self.gathered.get() + steps);
    }

    /// Counts steps, and checks the flag if enough steps were gathered.
    ///
    /// # Errors
    /// The computation was asked to stop.
    #[inline]
    pub fn spend(&self, steps: u64) -> Result<(), Stopped> {
        self.count(steps);
        if self.gathered.get() < GATHERED { Ok(()) } else { self.look() }
    }

    /// Spends the gathered steps and checks the flag.
    #[cold]
    fn look(&self) -> Result<(), Stopped> {
        self.stop.spend(self.gathered.take())
    }
}

impl Drop for Meter<'_> {
    fn drop(&mut self) {
        // The computation has already ended, so only the count matters.
        let _ = self.look();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Catches a flag that is not checked, and steps that are lost once the flag is set.
    #[test]
    fn steps_are_counted_and_a_stop_ends_them() {
        let stop = Stop::default();
        assert_eq!(stop.spend(3), Ok(()));
        assert_eq!(stop.spend(7), Ok(()));
        stop.stop();
        assert_eq!(stop.spend(5), Err(Stopped));
        assert_eq!((stop.steps(), stop.largest_between_looks()), (15, 7));
    }

    /// Catches steps that a meter never passes on, a check of the flag for every step, and a stop
    /// that the meter does not see.
    #[test]
    fn a_meter_gathers_steps_and_sees_the_stop() {
        let stop = Stop::default();
        let meter = Meter::new(&stop);
        for _ in 0..GATHERED {
            assert_eq!(meter.spend(3), Ok(()));
        }
        let spent = stop.steps();
        assert!(spent <= 3 * GATHERED && spent > 2 * GATHERED);
        assert!((GATHERED..GATHERED + 3).contains(&stop.largest_between_looks()));
        stop.stop();
        let seen = (0..GATHERED).take_while(|_| meter.spend(1).is_ok()).count() as u64;
        assert!(seen < GATHERED);
        drop(meter);
        assert_eq!(stop.steps(), 3 * GATHERED + seen + 1);
    }
}
