//! Limits the pairs that are computed at a time. Further batches wait or are refused.
//!
//! A batch takes a slot for each of its pairs before any work is done for it. If there are not enough
//! slots, it is refused. A single caller may hold `max_pairs_in_flight` slots. Several callers
//! share twice as many by dynamic thresholds ([`Shares`]): each of n greedy callers gets 2/(n+1) of
//! `max_pairs_in_flight`, and as much stays free for the next caller. If shares are off, all callers
//! together have `max_pairs_in_flight` slots. The memory of the pairs is limited separately, by the memory
//! budget.
//!
//! A caller's large batches then wait for their turn in the order of their arrival, so that they end one
//! after the other instead of all late. Small batches do not wait, and no batch waits for another caller's.
//! The compute threads take turns between callers and between batches, so a small batch is delayed by some
//! chunks, not by whole batches. A batch whose caller leaves also leaves the queue.
//!
//! This is our own code, because the limits of tower (load shedding, concurrency, buffers) count calls, and
//! know neither pairs nor callers.

use std::{
    sync::{
        Arc, Mutex,
        atomic::{AtomicUsize, Ordering},
    },
    time::{Duration, Instant},
};

use tokio::sync::{Notify, OwnedSemaphorePermit, Semaphore};

use super::{Reason, ServiceError};
use crate::{
    budget::{ById, Caller, Shares},
    lock::locked,
    metrics::{GaugeGuard, Metrics, Shed},
};

/// Batches of up to this many pairs do not wait. They take some milliseconds.
const SMALL_PAIRS: u32 = 4096;

/// The most pairs of one caller's large batches that are computed at a time. They keep all threads of the
/// largest machines busy and leave some pairs for the next batch, which can therefore begin before the last
/// chunk of a batch ends.
const MOST_COMPUTED_PAIRS: u32 = 65_536;

/// About this many lanes of callers without batches are kept before they are removed.
const SPARE_LANES: usize = 64;

/// The shortest time after which a refused caller is told to retry.
const SOONEST: Duration = Duration::from_millis(20);
/// The longest such time.
const LATEST: Duration = Duration::from_secs(5);

/// The throughput is measured again after this time.
const THROUGHPUT_EVERY: Duration = Duration::from_millis(100);

/// The slots for pairs, and the order in which large batches are computed.
#[derive(Debug)]
pub(super) struct AdmissionQueue {
    state: Mutex<State>,
    /// Notified when slots are given back and a batch waits for some.
    freed: Notify,
    /// The number of batches of all callers that wait for slots.
    waiting: AtomicUsize,
    throughput: Mutex<Throughput>,
    metrics: Arc<Metrics>,
}

#[derive(Debug)]
struct State {
    slots: Shares,
    /// The lanes of callers with batches, and of some callers without.
    lanes: ById<u64, Arc<Lane>>,
    /// The number of lanes at which those without batches are removed.
    forget_at: usize,
}

/// The batches of one caller.
#[derive(Debug)]
struct Lane {
    computing: Arc<Semaphore>,
    /// Held by the first batch that waits for slots.
    first: tokio::sync::Mutex<()>,
    /// The number of batches that wait for slots. New batches of this caller are refused meanwhile,
    /// because they would overtake the waiting ones.
    waiting: AtomicUsize,
}

/// The number of pairs computed per second, measured over the last moments.
#[derive(Debug)]
struct Throughput {
    measured: Instant,
    computed: u64,
    per_second: f64,
    refused: u32,
}

/// The slots of a batch, one per pair. They are free again when this is dropped.
#[derive(Debug)]
pub struct Admission {
    pairs: u32,
    queue: Arc<AdmissionQueue>,
    caller: Caller,
    lane: Arc<Lane>,
    computing: Option<OwnedSemaphorePermit>,
}

impl AdmissionQueue {
    /// A queue with `pairs` slots for one caller. If `shares` is true, several callers share twice as
    /// many.
    pub(super) fn new(pairs: u32, shares: bool, metrics: Arc<Metrics>) -> Arc<Self> {
        let limit = if shares { 2 * u64::from(pairs) } else { u64::from(pairs) };
        let slots = Shares::new(limit, shares);
        let measured = Instant::now();
        Arc::new(Self {
            state: Mutex::new(State { slots, lanes: ById::default(), forget_at: SPARE_LANES }),
            freed: Notify::new(),
            waiting: AtomicUsize::new(0),
            throughput: Mutex::new(Throughput { measured, computed: 0, per_second: 0.0, refused: 0 }),
            metrics,
        })
    }

    /// Takes the slots for a batch. `computed` is the number of pairs computed since the start.
    ///
    /// # Errors
    /// TOO_BUSY if there are not enough slots.
    pub(super) fn admit(
        self: &Arc<Self>,
        pairs: usize,
        caller: &Caller,
        computed: u64,
    ) -> Result<Admission, ServiceError> {
        self.take(weight(pairs), caller, false).ok_or_else(|| {
            self.metrics.shed(Shed::Pairs);
            let message = "too many pairs are in flight: retry later";
            ServiceError::unavailable(Reason::TooBusy, self.retry_after(computed), message)
        })
    }

    /// Takes the slots for a later part of a call; waits until there are enough.
    pub(super) async fn admit_when_free(self: &Arc<Self>, pairs: usize, caller: &Caller) -> Admission {
        let lane = locked(&self.state).lane(caller);
        let _waiting = [WaitingCount::new(&self.waiting), WaitingCount::new(&lane.waiting)];
        let _first = lane.first.lock().await;
        loop {
            let mut freed = std::pin::pin!(self.freed.notified());
            // From here on, no notification of freed slots is missed.
            freed.as_mut().enable();
            if let Some(admission) = self.take(weight(pairs), caller, true) {
                return admission;
            }
            freed.await;
        }
    }

    /// Takes the slots for a batch, if there are enough. `is_first` means that no other batch of the
    /// caller waits before this one.
    fn take(self: &Arc<Self>, pairs: u32, caller: &Caller, is_first: bool) -> Option<Admission> {
        let mut state = locked(&self.state);
        let lane = state.lane(caller);
        if !is_first && lane.waiting.load(Ordering::Relaxed) > 0 {
            return None;
        }
        state.slots.take(caller, pairs.into()).ok()?;
        self.metrics.pairs_in_flight.set(state.slots.used() as i64);
        drop(state);
        let (queue, caller) = (self.clone(), caller.clone());
        Some(Admission { pairs, queue, caller, lane, computing: None })
    }

    /// Waits until the batch may be computed.
    pub(super) async fn wait_to_compute(&self, admission: &mut Admission) {
        if !admission.must_wait() {
            return self.metrics.queue_seconds.observe(0.0);
        }
        let arrived = Instant::now();
        let _queued = GaugeGuard::new(&self.metrics.pairs_queued, admission.pairs as usize);
        // The semaphore is never closed, so there is no error.
        let computing = admission.lane.computing.clone();
        admission.computing =
            computing.acquire_many_owned(admission.pairs.min(MOST_COMPUTED_PAIRS)).await.ok();
        self.metrics.queue_seconds.observe(arrived.elapsed().as_secs_f64());
    }

    /// The time in which half of the pairs in flight will be computed, at the latest throughput. Callers
    /// that are refused one after the other get different times, so that they do not all return together.
    fn retry_after(&self, computed: u64) -> Duration {
        let mut throughput = locked(&self.throughput);
        let elapsed = throughput.measured.elapsed();
        if elapsed >= THROUGHPUT_EVERY {
            throughput.per_second =
                computed.saturating_sub(throughput.computed) as f64 / elapsed.as_secs_f64();
            (throughput.measured, throughput.computed) = (Instant::now(), computed);
        }
        throughput.refused = throughput.refused.wrapping_add(1);
        let spread = 0.75 + 0.5 * low_discrepancy(throughput.refused.into());
        let under_way = locked(&self.state).slots.used() as f64;
        let seconds = 0.5 * under_way / throughput.per_second.max(1.0) * spread;
        Duration::try_from_secs_f64(seconds).unwrap_or(LATEST).clamp(SOONEST, LATEST)
    }
}

impl State {
    /// The lane of a caller. It is the same lane for as long as any batch of the caller holds it.
    fn lane(&mut self, caller: &Caller) -> Arc<Lane> {
        if let Some(lane) = self.lanes.get(&caller.id()) {
            return lane.clone();
        }
        if self.lanes.len() >= self.forget_at {
            // No lane is cloned while the state is locked, so one without other clones has no batches.
            self.lanes.retain(|_, lane| Arc::strong_count(lane) > 1);
            self.forget_at = 2 * self.lanes.len() + SPARE_LANES;
        }
        let lane = Arc::new(Lane {
            computing: Arc::new(Semaphore::new(MOST_COMPUTED_PAIRS as usize)),
            first: tokio::sync::Mutex::default(),
            waiting: AtomicUsize::new(0),
        });
        self.lanes.insert(caller.id(), lane.clone());
        lane
    }
}

impl Drop for Admission {
    fn drop(&mut self) {
        let Self { queue, caller, pairs, .. } = self;
        let mut state = locked(&queue.state);
        state.slots.give_back(caller, u64::from(*pairs));
        queue.metrics.pairs_in_flight.set(state.slots.used() as i64);
        drop(state);
        // A batch counts as waiting before it locks the state to look for slots.
        if queue.waiting.load(Ordering::Relaxed) > 0 {
            queue.freed.notify_waiters();
        }
    }
}

impl Admission {
    /// Whether the batch waits for its turn.
    pub(super) fn must_wait(&self) -> bool {
        self.pairs > SMALL_PAIRS
    }
}

/// Adds one to a count of waiting batches until it is dropped.
struct WaitingCount<'a>(&'a AtomicUsize);

impl<'a> WaitingCount<'a> {
    fn new(count: &'a AtomicUsize) -> Self {
        count.fetch_add(1, Ordering::Relaxed);
        Self(count)
    }
}

impl Drop for WaitingCount<'_> {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Ordering::Relaxed);
    }
}

/// The `n`-th number of a sequence in [0, 1) that is evenly spread however many of its numbers are used:
/// the multiples of the golden ratio, modulo 1.
pub(super) fn low_discrepancy(n: u64) -> f64 {
    (n as f64 * 0.618_033_988_749_895).fract()
}

/// A batch without pairs has the weight of one pair.
fn weight(pairs: usize) -> u32 {
    u32::try_from(pairs.max(1)).unwrap_or(u32::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::budget::{CallerKey, Callers};

    fn queue(pairs: u32) -> Arc<AdmissionQueue> {
        AdmissionQueue::new(pairs, true, Arc::default())
    }

    fn callers<const N: usize>() -> [Caller; N] {
        let callers = Arc::new(Callers::default());
        std::array::from_fn(|user| callers.get(CallerKey::User(user as u32)))
    }

    /// Catches a slot that is not given back, a slot that is given away twice, and a single caller that
    /// gets less than all slots.
    #[test]
    fn slots_are_counted_in_pairs() {
        let (queue, caller) = (queue(100), &Caller::alone());
        let sixty = queue.admit(60, caller, 0).unwrap();
        let forty = queue.admit(40, caller, 0).unwrap();
        assert_eq!(queue.admit(0, caller, 0).unwrap_err().reason, Reason::TooBusy);
        drop(forty);
        assert!(queue.admit(41, caller, 0).is_err());
        let forty = queue.admit(40, caller, 0).unwrap();
        assert_eq!(queue.metrics.pairs_in_flight.get(), 100);
        drop((sixty, forty));
        assert_eq!(queue.metrics.pairs_in_flight.get(), 0);
        assert!(queue.admit(100, caller, 0).is_ok());
    }

    /// Catches a caller that is refused because others take everything, and thresholds that apply although
    /// shares are off.
    #[test]
    fn greedy_callers_leave_slots_for_others() {
        let queue = queue(900);
        let [a, b, late] = &callers();
        let mut held = Vec::new();
        for _ in 0..1000 {
            held.extend([a, b].into_iter().filter_map(|caller| queue.admit(10, caller, 0).ok()));
        }
        let of = |caller: &Caller| locked(&queue.state).slots.held(caller);
        assert_eq!((of(a), of(b)), (600, 600), "two thirds of 900 each");
        assert!(queue.admit(300, late, 0).is_ok());
        drop(held);
        assert!(queue.admit(900, late, 0).is_ok());

        let all = AdmissionQueue::new(900, false, Arc::default());
        let _whole = all.admit(900, a, 0).unwrap();
        assert!(all.admit(1, b, 0).is_err());
    }

    /// Catches a small batch that waits behind large ones, large batches out of order, a place in the queue
    /// that is kept after its batch has left, and a batch that waits for another caller's.
    #[tokio::test]
    async fn large_batches_wait_in_turn_and_small_ones_do_not() {
        let queue = queue(1 << 20);
        let [caller, other] = &callers();
        let mut first = queue.admit(MOST_COMPUTED_PAIRS as usize, caller, 0).unwrap();
        queue.wait_to_compute(&mut first).await;
        let mut admissions = [SMALL_PAIRS + 1, SMALL_PAIRS + 1, MOST_COMPUTED_PAIRS + 1, SMALL_PAIRS]
            .map(|pairs| queue.admit(pairs as usize, caller, 0).unwrap());
        let [gone, second, third, small] = &mut admissions;
        let mut gone = Box::pin(queue.wait_to_compute(gone));
        let mut second = Box::pin(queue.wait_to_compute(second));
        let mut third = Box::pin(queue.wait_to_compute(third));
        for waiting in [&mut gone, &mut second, &mut third] {
            assert!(futures_util::poll!(waiting.as_mut()).is_pending());
        }
        assert_eq!(queue.metrics.pairs_queued.get(), i64::from(2 * SMALL_PAIRS + MOST_COMPUTED_PAIRS + 3));
        queue.wait_to_compute(small).await;
        let mut of_other = queue.admit(MOST_COMPUTED_PAIRS as usize, other, 0).unwrap();
        queue.wait_to_compute(&mut of_other).await;
        drop(gone);
        drop(first);
        assert!(futures_util::poll!(third.as_mut()).is_pending(), "larger than what is left");
        second.await;
        assert!(futures_util::poll!(third.as_mut()).is_pending());
        drop(third);
        assert_eq!(queue.metrics.pairs_queued.get(), 0);
    }

    /// Catches a part of a call that waits for ever, a part that a new batch overtakes, and lanes that are
    /// never removed.
    #[tokio::test]
    async fn later_parts_wait_for_slots_in_order() {
        let queue = queue(100);
        let [caller, other] = &callers();
        let whole = queue.admit(100, caller, 0).unwrap();
        let mut first = Box::pin(queue.admit_when_free(60, caller));
        let mut second = Box::pin(queue.admit_when_free(40, caller));
        assert!(futures_util::poll!(first.as_mut()).is_pending());
        assert!(futures_util::poll!(second.as_mut()).is_pending());
        assert!(queue.admit(1, other, 0).is_ok());
        drop(whole);
        assert!(queue.admit(1, caller, 0).is_err(), "others wait");
        let first = first.await;
        let second = second.await;
        assert!(queue.admit(1, caller, 0).is_err(), "all slots are taken");
        drop((first, second));
        assert!(queue.admit(100, caller, 0).is_ok());
        for many in &callers::<1000>() {
            assert!(queue.admit(1, many, 0).is_ok());
        }
        assert!(locked(&queue.state).lanes.len() <= 2 * SPARE_LANES);
    }

    /// Catches a retry time that does not follow the backlog, or that is the same for all callers.
    #[test]
    fn the_busier_the_later() {
        let queue = queue(1000);
        let _all = queue.admit(1000, &Caller::alone(), 0).unwrap();
        locked(&queue.throughput).per_second = 1000.0;
        let times: Vec<_> = (0..100).map(|_| queue.retry_after(0)).collect();
        let distinct: std::collections::HashSet<_> = times.iter().collect();
        assert_eq!(distinct.len(), 100);
        for time in times {
            // Half of 1000 pairs takes half a second at 1000 pairs per second.
            assert!((0.375..=0.625).contains(&time.as_secs_f64()), "{time:?}");
        }
        locked(&queue.throughput).per_second = 1e9;
        assert_eq!(queue.retry_after(0), SOONEST);
        locked(&queue.throughput).per_second = 0.0;
        assert_eq!(queue.retry_after(0), LATEST);
    }
}
