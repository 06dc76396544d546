//! How much is computed at a time, in pairs: what is beyond it waits, what is beyond
//! that is refused.
//!
//! A batch takes a place for each of its pairs before anything is done for it; without
//! room it is shed. Large batches then wait for their turn, first come, first served, so
//! that they end one after the other and not all late. Small ones do not wait: the
//! compute threads take chunks of all batches in turn, so a small one is delayed by
//! some chunks and not by some batches. Whoever gives up waiting leaves the queue.

use std::{
    sync::{Arc, Mutex, PoisonError},
    time::{Duration, Instant},
};

use tokio::sync::{OwnedSemaphorePermit, Semaphore};

use super::ServiceError;
use crate::metrics::{Held, Metrics, Shed};

/// Batches up to this many pairs do not wait: some milliseconds of work.
const SMALL_PAIRS: u32 = 4096;

/// Pairs of large batches that are computed at a time: enough chunks for every thread of
/// the largest machines, and one batch more so that none waits for another's last chunk.
const TURN_PAIRS: u32 = 65_536;

/// When a server with too much to do asks to be asked again, at the soonest and at the latest.
const SOONEST: Duration = Duration::from_millis(20);
const LATEST: Duration = Duration::from_secs(5);

/// So often the pace is taken.
const PACE_EVERY: Duration = Duration::from_millis(100);

/// The places and the turns.
#[derive(Debug)]
pub(super) struct Room {
    places: Arc<Semaphore>,
    turns: Arc<Semaphore>,
    size: u32,
    pace: Mutex<Pace>,
    metrics: Arc<Metrics>,
}

/// How fast pairs were computed of late.
#[derive(Debug)]
struct Pace {
    taken: Instant,
    computed: u64,
    per_second: f64,
    refused: u32,
}

/// A place for each pair of a batch, free again when dropped.
#[derive(Debug)]
pub struct Admission {
    pairs: u32,
    _places: OwnedSemaphorePermit,
    _counted: Held,
    turn: Option<OwnedSemaphorePermit>,
}

impl Room {
    pub(super) fn new(size: u32, metrics: Arc<Metrics>) -> Self {
        Self {
            places: Arc::new(Semaphore::new(size as usize)),
            turns: Arc::new(Semaphore::new(TURN_PAIRS as usize)),
            size,
            pace: Mutex::new(Pace { taken: Instant::now(), computed: 0, per_second: 0.0, refused: 0 }),
            metrics,
        }
    }

    /// Places for a batch; `computed` pairs are done since the start.
    ///
    /// # Errors
    /// TOO_BUSY.
    pub(super) fn admit(&self, pairs: usize, computed: u64) -> Result<Admission, ServiceError> {
        let pairs = weight(pairs);
        let Ok(places) = self.places.clone().try_acquire_many_owned(pairs) else {
            self.metrics.shed(Shed::Pairs);
            let message = "too many pairs are being computed; ask again";
            return Err(ServiceError::unavailable("TOO_BUSY", self.retry_after(computed), message));
        };
        Ok(self.admitted(pairs, places))
    }

    /// The same for the later parts of a call: waits until there are some.
    ///
    /// # Errors
    /// INTERNAL.
    pub(super) async fn next(&self, pairs: usize) -> Result<Admission, ServiceError> {
        let pairs = weight(pairs);
        let places = self.places.clone().acquire_many_owned(pairs).await;
        let places = places.map_err(|_| ServiceError::internal("there are no places any more"))?;
        Ok(self.admitted(pairs, places))
    }

    fn admitted(&self, pairs: u32, places: OwnedSemaphorePermit) -> Admission {
        let counted = Held::new(&self.metrics.pairs_in_flight, pairs as usize);
        Admission { pairs, _places: places, _counted: counted, turn: None }
    }

    /// Waits until the batch may be computed.
    pub(super) async fn turn(&self, admission: &mut Admission) {
        let arrived = Instant::now();
        if admission.pairs > SMALL_PAIRS {
            let _queued = Held::new(&self.metrics.pairs_queued, admission.pairs as usize);
            // Never closed: an error cannot be.
            admission.turn =
                self.turns.clone().acquire_many_owned(admission.pairs.min(TURN_PAIRS)).await.ok();
        }
        self.metrics.queue_seconds.observe(arrived.elapsed().as_secs_f64());
    }

    /// When half of what is under way is done, at the pace of late; neighbours in time are
    /// told different times, or they would come back together.
    fn retry_after(&self, computed: u64) -> Duration {
        let mut pace = self.pace.lock().unwrap_or_else(PoisonError::into_inner);
        let elapsed = pace.taken.elapsed();
        if elapsed >= PACE_EVERY {
            pace.per_second = computed.saturating_sub(pace.computed) as f64 / elapsed.as_secs_f64();
            (pace.taken, pace.computed) = (Instant::now(), computed);
        }
        pace.refused = pace.refused.wrapping_add(1);
        let spread = 0.75 + 0.5 * spread(pace.refused.into());
        let under_way = f64::from(self.size) - self.places.available_permits() as f64;
        let seconds = 0.5 * under_way / pace.per_second.max(1.0) * spread;
        Duration::try_from_secs_f64(seconds).unwrap_or(LATEST).clamp(SOONEST, LATEST)
    }
}

/// The `n`-th of numbers in [0, 1) that are spread evenly however many there are: multiples
/// of the golden ratio.
pub(super) fn spread(n: u64) -> f64 {
    (n as f64 * 0.618_033_988_749_895).fract()
}

/// No pairs are a batch too.
fn weight(pairs: usize) -> u32 {
    u32::try_from(pairs.max(1)).unwrap_or(u32::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn room(size: u32) -> Room {
        Room::new(size, Arc::default())
    }

    /// Catches a place that is not given back, and one too many given away.
    #[test]
    fn places_are_counted_in_pairs() {
        let room = room(100);
        let sixty = room.admit(60, 0).unwrap();
        let forty = room.admit(40, 0).unwrap();
        assert_eq!(room.admit(0, 0).unwrap_err().reason, "TOO_BUSY");
        drop(forty);
        assert!(room.admit(41, 0).is_err());
        let forty = room.admit(40, 0).unwrap();
        assert_eq!(room.metrics.pairs_in_flight.get(), 100);
        drop((sixty, forty));
        assert_eq!(room.metrics.pairs_in_flight.get(), 0);
        assert!(room.admit(100, 0).is_ok());
    }

    /// Catches a small batch that waits behind large ones, large ones out of turn, and a place
    /// in the queue kept by who has left it.
    #[tokio::test]
    async fn large_batches_wait_in_turn_and_small_ones_do_not() {
        let room = room(1 << 20);
        let mut first = room.admit(TURN_PAIRS as usize, 0).unwrap();
        room.turn(&mut first).await;
        let mut admissions = [SMALL_PAIRS + 1, SMALL_PAIRS + 1, TURN_PAIRS + 1, SMALL_PAIRS]
            .map(|pairs| room.admit(pairs as usize, 0).unwrap());
        let [gone, second, third, small] = &mut admissions;
        let mut gone = Box::pin(room.turn(gone));
        let mut second = Box::pin(room.turn(second));
        let mut third = Box::pin(room.turn(third));
        for waiting in [&mut gone, &mut second, &mut third] {
            assert!(futures_util::poll!(waiting.as_mut()).is_pending());
        }
        assert_eq!(room.metrics.pairs_queued.get(), i64::from(2 * SMALL_PAIRS + TURN_PAIRS + 3));
        room.turn(small).await;
        drop(gone);
        drop(first);
        assert!(futures_util::poll!(third.as_mut()).is_pending(), "larger than what is left");
        second.await;
        assert!(futures_util::poll!(third.as_mut()).is_pending());
        drop(third);
        assert_eq!(room.metrics.pairs_queued.get(), 0);
    }

    /// Catches a time to come back that does not follow the backlog, or is the same for all.
    #[test]
    fn the_busier_the_later() {
        let room = room(1000);
        let _all = room.admit(1000, 0).unwrap();
        room.pace.lock().unwrap().per_second = 1000.0;
        let times: Vec<_> = (0..100).map(|_| room.retry_after(0)).collect();
        let distinct: std::collections::HashSet<_> = times.iter().collect();
        assert_eq!(distinct.len(), 100);
        for time in times {
            // Half of 1000 pairs at 1000 a second.
            assert!((0.375..=0.625).contains(&time.as_secs_f64()), "{time:?}");
        }
        room.pace.lock().unwrap().per_second = 1e9;
        assert_eq!(room.retry_after(0), SOONEST);
        room.pace.lock().unwrap().per_second = 0.0;
        assert_eq!(room.retry_after(0), LATEST);
    }
}
