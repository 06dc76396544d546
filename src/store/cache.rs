//! The hulls in memory: a bounded cache, in which what requests use stays.
//!
//! A request holds all of its hulls or none. What requests hold together is bounded by the
//! cache's bytes, so that the cache can always make room for it; who comes when others hold
//! too much is sent away, and who needs more than there is at all is told so.

use std::sync::{
    Arc, Mutex, PoisonError,
    atomic::{AtomicU32, AtomicU64, Ordering},
};

use prometheus_client::metrics::{counter::Counter, gauge::Gauge};
use quick_cache::{DefaultHashBuilder, Lifecycle, OptionsBuilder, Weighter, sync::Cache};

use super::{HullId, Missing};
use crate::{contact::ConvexHull, metrics::Metrics};

/// Measured beside moka 0.12 (2,000 entries, two busy cores, four shards): a hit in 0.11 to
/// 0.25 us against 0.27 to 0.96, and never over its bytes while 200,000 inserts churn it.
pub(super) type HullCache = Cache<HullId, Arc<Entry>, HeapBytes, DefaultHashBuilder, Eviction>;

/// Of a cached hull beside its heap: the entry, the hull's own struct and the cache's slot.
const ENTRY_BYTES: u64 = (size_of::<Entry>() + size_of::<ConvexHull>() + 128) as u64;

/// For the cache's own tables, which grow when it is wrong: a hull of some 50 vertices.
const TYPICAL_HULL_BYTES: u64 = 16 << 10;

/// A cache of `bytes`.
pub(super) fn cache(bytes: u64, metrics: &Metrics) -> HullCache {
    let items = usize::try_from(bytes / TYPICAL_HULL_BYTES).unwrap_or(usize::MAX);
    let options = OptionsBuilder::new()
        // Each part has its share of the bytes: of several, one could not hold what all can.
        .shards(1)
        .estimated_items_capacity(items.clamp(16, 1 << 20))
        .weight_capacity(bytes)
        .build()
        .unwrap_or_else(|_| unreachable!("both capacities are set"));
    let eviction = Eviction(metrics.cache_evictions.clone());
    Cache::with_options(options, HeapBytes, DefaultHashBuilder::default(), eviction)
}

/// Counted; not of what a request holds.
#[derive(Clone, Debug)]
pub(super) struct Eviction(Counter);

impl Lifecycle<HullId, Arc<Entry>> for Eviction {
    type RequestState = ();

    fn is_pinned(&self, _: &HullId, entry: &Arc<Entry>) -> bool {
        entry.holders.load(Ordering::Relaxed) > 0
    }

    fn on_evict(&self, (): &mut (), _: HullId, _: Arc<Entry>) {
        self.0.inc();
    }
}

#[derive(Clone, Debug)]
pub(super) struct HeapBytes;

impl Weighter<HullId, Arc<Entry>> for HeapBytes {
    fn weight(&self, _: &HullId, entry: &Arc<Entry>) -> u64 {
        entry.bytes
    }
}

/// A hull in memory.
#[derive(Debug)]
pub(super) struct Entry {
    pub(super) hull: Arc<ConvexHull>,
    bytes: u64,
    /// This process wrote it: what it acknowledges again is known to be synced.
    pub(super) written: bool,
    /// When it was last known to be in the store, milliseconds since the registry started.
    pub(super) seen_ms: AtomicU64,
    /// Requests that hold it; written under the budget's lock.
    holders: AtomicU32,
}

impl Entry {
    pub(super) fn new(hull: Arc<ConvexHull>, written: bool, seen_ms: u64) -> Arc<Self> {
        let bytes = hull.heap_bytes() as u64 + ENTRY_BYTES;
        Arc::new(Self { hull, bytes, written, seen_ms: seen_ms.into(), holders: 0.into() })
    }
}

/// Why a request cannot have its hulls.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NoRoom {
    /// They take more than the cache's bytes.
    TooLarge,
    /// Other requests hold too much at the moment.
    Busy,
}

/// What all requests together may hold.
#[derive(Debug)]
pub(super) struct Budget {
    limit: u64,
    held: Mutex<u64>,
    gauge: Gauge,
}

impl Budget {
    pub(super) fn new(limit: u64, metrics: &Metrics) -> Arc<Self> {
        Arc::new(Self { limit, held: Mutex::new(0), gauge: metrics.held_bytes.clone() })
    }
}

/// What one request takes of a budget: every hull counts, once.
#[derive(Debug)]
pub(super) struct Taking {
    budget: Arc<Budget>,
    bytes: AtomicU64,
}

impl Taking {
    pub(super) fn new(budget: &Arc<Budget>) -> Self {
        Self { budget: budget.clone(), bytes: 0.into() }
    }

    /// Holds all of `entries`, or none.
    pub(super) fn hold(&self, entries: Vec<Arc<Entry>>) -> Result<Hold, NoRoom> {
        let Budget { limit, held, gauge } = &*self.budget;
        let bytes = entries.iter().map(|entry| entry.bytes).sum();
        if self.bytes.fetch_add(bytes, Ordering::Relaxed) + bytes > *limit {
            return Err(NoRoom::TooLarge);
        }
        let mut held = held.lock().unwrap_or_else(PoisonError::into_inner);
        let unheld = entries.iter().filter(|entry| entry.holders.load(Ordering::Relaxed) == 0);
        let after = *held + unheld.map(|entry| entry.bytes).sum::<u64>();
        if after > *limit {
            return Err(NoRoom::Busy);
        }
        for entry in &entries {
            entry.holders.fetch_add(1, Ordering::Relaxed);
        }
        *held = after;
        gauge.set(after as i64);
        Ok(Hold { budget: self.budget.clone(), entries })
    }
}

/// A request's hulls stay in the cache until it is dropped.
#[derive(Debug)]
pub struct Hold {
    budget: Arc<Budget>,
    entries: Vec<Arc<Entry>>,
}

impl Hold {
    /// Together with `other`, of the same budget.
    pub(super) fn join(&mut self, mut other: Self) {
        self.entries.append(&mut other.entries);
    }
}

impl Drop for Hold {
    fn drop(&mut self) {
        if self.entries.is_empty() {
            return;
        }
        let mut held = self.budget.held.lock().unwrap_or_else(PoisonError::into_inner);
        for entry in &self.entries {
            if entry.holders.fetch_sub(1, Ordering::Relaxed) == 1 {
                *held -= entry.bytes;
            }
        }
        self.budget.gauge.set(*held as i64);
    }
}

/// A request's hulls, in its order.
pub type Hulls = Vec<Result<Arc<ConvexHull>, Missing>>;

#[cfg(test)]
mod tests {
    use super::*;

    fn entries(count: usize) -> Vec<Arc<Entry>> {
        let corners = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        let hull = Arc::new(ConvexHull::new(&corners).unwrap());
        (0..count).map(|_| Entry::new(hull.clone(), false, 0)).collect()
    }

    /// Catches a hull held twice that counts twice, one that is free while somebody holds it,
    /// a part of a request that stays held when the rest is refused, and a request that is too
    /// large and is told to come back.
    #[test]
    fn all_or_nothing_within_the_budget() {
        let entries = entries(5);
        let metrics = Metrics::default();
        let budget = Budget::new(3 * entries[0].bytes, &metrics);
        let hold = |range: std::ops::Range<usize>| Taking::new(&budget).hold(entries[range].to_vec());
        let held = || *budget.held.lock().unwrap() / entries[0].bytes;
        assert_eq!(hold(0..4).unwrap_err(), NoRoom::TooLarge);
        let first = hold(0..2).unwrap();
        let again = hold(0..2).unwrap();
        assert_eq!(held(), 2);
        assert_eq!(hold(1..4).unwrap_err(), NoRoom::Busy);
        assert_eq!(held(), 2, "nothing of it is held");
        let all = hold(0..3).unwrap();
        drop(first);
        assert_eq!(held(), 3);
        drop(all);
        assert_eq!(held(), 2);
        drop(again);
        assert_eq!((held(), metrics.held_bytes.get()), (0, 0));
        // One after the other is together, too.
        let taking = Taking::new(&budget);
        let mut whole = taking.hold(entries[..2].to_vec()).unwrap();
        whole.join(taking.hold(entries[2..3].to_vec()).unwrap());
        assert_eq!(taking.hold(entries[3..4].to_vec()).unwrap_err(), NoRoom::TooLarge);
        assert_eq!(hold(3..4).unwrap_err(), NoRoom::Busy);
        drop(whole);
        assert_eq!(held(), 0);
        assert!(entries.iter().all(|entry| entry.holders.load(Ordering::Relaxed) == 0));
    }

    /// Catches a hull that is evicted while it is held, and a cache that stays over its bytes.
    #[test]
    fn what_is_held_is_not_evicted() {
        let entries = entries(200);
        let bytes = 10 * entries[0].bytes;
        let metrics = Metrics::default();
        let cache = cache(bytes, &metrics);
        let budget = Budget::new(bytes, &metrics);
        let id = |i: usize| HullId([i as u8; 32]);
        let held = Taking::new(&budget).hold(entries[..9].to_vec()).unwrap();
        for (i, entry) in entries.iter().enumerate() {
            cache.insert(id(i), entry.clone());
            assert!(cache.weight() <= bytes);
            assert!((0..9.min(i)).all(|i| cache.get(&id(i)).is_some()), "{i}");
        }
        // Then they give way to others that are.
        drop(held);
        let held = Taking::new(&budget).hold(entries[100..109].to_vec()).unwrap();
        (100..109).for_each(|i| cache.insert(id(i), entries[i].clone()));
        assert!((100..109).all(|i| cache.get(&id(i)).is_some()));
        assert!(cache.weight() <= bytes);
        drop(held);
    }

    /// Catches a hull in steady use that gives way to hulls that come once and never again.
    #[test]
    fn what_is_used_stays() {
        let entries = entries(250);
        let cache = cache(20 * entries[0].bytes, &Metrics::default());
        let id = |i: usize| HullId([i as u8; 32]);
        for (i, entry) in entries.iter().enumerate() {
            cache.insert(id(i), entry.clone());
            for used in 0..5.min(i) {
                assert!(cache.get(&id(used)).is_some(), "{used} after {i}");
            }
        }
    }
}
