//! The hulls in memory: a cache with a limit in bytes. Leased hulls are never evicted
//! ([`lease`](super::lease)).

use std::sync::{
    Arc,
    atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering},
};

use prometheus_client::metrics::counter::Counter;
use quick_cache::{DefaultHashBuilder, Lifecycle, OptionsBuilder, Weighter, sync::Cache};

use super::HullId;
use crate::{contact::ConvexHull, metrics::Metrics};

/// Measured against moka 0.12 (2,000 entries, two busy cores, four shards): a hit takes 0.11 to
/// 0.25 us instead of 0.27 to 0.96 us, and the cache never exceeds its limit during 200,000
/// inserts.
pub(super) type HullCache = Cache<HullId, Arc<CachedHull>, HullWeight, DefaultHashBuilder, EvictionPolicy>;

/// The bytes of a cached hull besides its heap: the entry, the hull's own struct and the cache's
/// slot.
const ENTRY_BYTES: u64 = (size_of::<CachedHull>() + size_of::<ConvexHull>() + 128) as u64;

/// The size of a hull with about 50 vertices. The cache chooses the initial size of its tables by
/// it; the tables grow if hulls are smaller.
const TYPICAL_HULL_BYTES: u64 = 16 << 10;

/// A cache of at most `bytes` bytes.
pub(super) fn cache(bytes: u64, metrics: &Metrics) -> HullCache {
    let items = usize::try_from(bytes / TYPICAL_HULL_BYTES).unwrap_or(usize::MAX);
    let options = OptionsBuilder::new()
        // There is only one shard, because a hull that fits in the limit may not fit in the part of
        // one of several shards.
        .shards(1)
        .estimated_items_capacity(items.clamp(16, 1 << 20))
        .weight_capacity(bytes)
        .build()
        .unwrap_or_else(|_| unreachable!("both capacities are set"));
    let eviction = EvictionPolicy(metrics.cache_evictions.clone());
    Cache::with_options(options, HullWeight, DefaultHashBuilder::default(), eviction)
}

/// Counts evictions, and keeps leased hulls from being evicted.
#[derive(Clone, Debug)]
pub(super) struct EvictionPolicy(Counter);

impl Lifecycle<HullId, Arc<CachedHull>> for EvictionPolicy {
    type RequestState = ();

    fn is_pinned(&self, _: &HullId, entry: &Arc<CachedHull>) -> bool {
        entry.leases.load(Ordering::Relaxed) > 0
    }

    fn on_evict(&self, (): &mut (), _: HullId, _: Arc<CachedHull>) {
        self.0.inc();
    }
}

#[derive(Clone, Debug)]
pub(super) struct HullWeight;

impl Weighter<HullId, Arc<CachedHull>> for HullWeight {
    fn weight(&self, _: &HullId, entry: &Arc<CachedHull>) -> u64 {
        entry.bytes
    }
}

/// A hull in memory.
#[derive(Debug)]
pub(super) struct CachedHull {
    pub(super) hull: Arc<ConvexHull>,
    pub(super) bytes: u64,
    /// Whether this process wrote the hull, so that its blob is known to be synced.
    pub(super) written: bool,
    /// The time at which the hull was last known to be in the store, in milliseconds since the
    /// registry started.
    pub(super) seen_ms: AtomicU64,
    /// The number of leases on the hull. It is written only while the lock of all leases is held.
    pub(super) leases: AtomicU32,
    /// Whether the hull was removed from the cache, because the store no longer has it.
    pub(super) is_removed: AtomicBool,
}

impl CachedHull {
    pub(super) fn new(hull: Arc<ConvexHull>, written: bool, seen_ms: u64) -> Arc<Self> {
        let bytes = hull.heap_bytes() as u64 + ENTRY_BYTES;
        Arc::new(Self {
            hull,
            bytes,
            written,
            seen_ms: seen_ms.into(),
            leases: 0.into(),
            is_removed: false.into(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        budget::Caller,
        store::lease::{LeaseRequest, Leases, tests::entries},
    };

    /// Catches a hull that is evicted while it is leased, and a cache that exceeds its limit.
    #[test]
    fn leased_hulls_are_not_evicted() {
        let entries = entries(200);
        let bytes = 10 * entries[0].bytes;
        let metrics = Metrics::default();
        let cache = cache(bytes, &metrics);
        let leases = Leases::new(bytes, false, &metrics);
        let request = || LeaseRequest::new(&leases, &Caller::alone());
        let id = |i: usize| HullId([i as u8; 32]);
        let leased = request().lease(entries[..9].to_vec()).unwrap();
        for (i, entry) in entries.iter().enumerate() {
            cache.insert(id(i), entry.clone());
            assert!(cache.weight() <= bytes);
            assert!((0..9.min(i)).all(|i| cache.get(&id(i)).is_some()), "{i}");
        }
        // Hulls that are not leased are evicted in favour of other leased hulls.
        drop(leased);
        let leased = request().lease(entries[100..109].to_vec()).unwrap();
        (100..109).for_each(|i| cache.insert(id(i), entries[i].clone()));
        assert!((100..109).all(|i| cache.get(&id(i)).is_some()));
        assert!(cache.weight() <= bytes);
        drop(leased);
    }

    /// A flood of new hulls passes through the cache, each used 0, 1 or 3 times. Another caller
    /// uses 20 hulls after every hundred new ones. Catches a flood that evicts the other caller's
    /// hulls: with 0 or 1 uses none may be evicted; with 3 uses each of them at most twice, before
    /// the cache knows that it is in use.
    #[test]
    fn a_flood_does_not_evict_hulls_in_use() {
        for (uses, most_evicted) in [(0, 0), (1, 0), (3, 2)] {
            let entries = entries(1);
            let cache = cache(1000 * entries[0].bytes, &Metrics::default());
            let id = |i: u64| HullId(std::array::from_fn(|byte| i.to_le_bytes()[byte % 8]));
            let in_use = || (0..20).map(id);
            for id in in_use().chain(in_use()) {
                if cache.get(&id).is_none() {
                    cache.insert(id, entries[0].clone());
                }
            }
            let (mut used, mut evicted) = (0, 0);
            for new in 100..20_100 {
                cache.insert(id(new), entries[0].clone());
                (0..uses).for_each(|_| assert!(cache.get(&id(new)).is_some()));
                if new % 100 == 0 {
                    for id in in_use() {
                        used += 1;
                        if cache.get(&id).is_none() {
                            evicted += 1;
                            cache.insert(id, entries[0].clone());
                        }
                    }
                }
            }
            assert_eq!(used, 4000);
            assert!(evicted <= 20 * most_evicted, "{evicted} with {uses} uses");
        }
    }

    /// Catches a hull in steady use that is evicted in favour of hulls that are used once.
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
