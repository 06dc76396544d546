//! Leases: the cached hulls that requests use, and the share of the cache that each caller may
//! lease.
//!
//! A request leases all of its hulls or none, and leased hulls stay in the cache. The limit on all
//! leases is the size of the cache, so that the cache can always make room for them. Callers share
//! this limit by dynamic thresholds (see [`budget`](crate::budget)): a caller may lease more only
//! while it then holds at most as many bytes as stay free. A hull that several callers lease counts
//! once in the total and once for each of these callers, however many of a caller's requests lease
//! it.

use std::{
    collections::hash_map,
    sync::{
        Arc, Mutex,
        atomic::{AtomicU64, Ordering},
    },
};

use prometheus_client::metrics::gauge::Gauge;

use super::cache::CachedHull;
use crate::{
    budget::{ById, Caller, Shares},
    lock::locked,
    metrics::Metrics,
};

/// The reason why a request cannot lease its hulls.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LeaseError {
    /// The hulls take more than one caller may ever lease.
    TooLarge,
    /// Other requests hold too many bytes at the moment.
    Busy,
}

/// The leases of all requests.
#[derive(Debug)]
pub(super) struct Leases {
    state: Mutex<State>,
    gauge: Gauge,
}

#[derive(Debug)]
struct State {
    shares: Shares,
    /// How many of a caller's requests lease an entry, by the caller's id and the entry's address.
    counts: ById<(u64, usize), u32>,
}

impl Leases {
    pub(super) fn new(limit: u64, shares: bool, metrics: &Metrics) -> Arc<Self> {
        let state = State { shares: Shares::new(limit, shares), counts: ById::default() };
        Arc::new(Self { state: Mutex::new(state), gauge: metrics.held_bytes.clone() })
    }

    /// The most bytes that one caller can lease.
    pub(super) fn most_alone(&self) -> u64 {
        locked(&self.state).shares.most_alone()
    }
}

/// The leases of one request; each hull counts once.
#[derive(Debug)]
pub(super) struct LeaseRequest {
    leases: Arc<Leases>,
    caller: Caller,
    bytes: AtomicU64,
}

impl LeaseRequest {
    pub(super) fn new(leases: &Arc<Leases>, caller: &Caller) -> Self {
        Self { leases: leases.clone(), caller: caller.clone(), bytes: 0.into() }
    }

    /// Leases all of `entries`, or none.
    pub(super) fn lease(&self, entries: Vec<Arc<CachedHull>>) -> Result<Lease, LeaseError> {
        let mut lease =
            Lease { leases: self.leases.clone(), caller: self.caller.clone(), entries: Vec::new() };
        let bytes: u64 = entries.iter().map(|entry| entry.bytes).sum();
        let bytes_after = self.bytes.fetch_add(bytes, Ordering::Relaxed) + bytes;
        let mut guard = locked(&self.leases.state);
        let state = &mut *guard;
        if bytes_after > state.shares.most_alone() {
            return Err(LeaseError::TooLarge);
        }
        for (index, entry) in entries.iter().enumerate() {
            if state.add(&self.caller, entry).is_err() {
                entries[..index].iter().for_each(|entry| state.subtract(&self.caller, entry));
                return Err(LeaseError::Busy);
            }
        }
        lease.entries = entries;
        self.leases.gauge.set(state.shares.used() as i64);
        Ok(lease)
    }
}

impl State {
    fn add(&mut self, caller: &Caller, entry: &Arc<CachedHull>) -> Result<(), LeaseError> {
        let slot = self.counts.entry((caller.id(), Arc::as_ptr(entry).addr()));
        if let hash_map::Entry::Vacant(_) = slot {
            let is_unleased = entry.leases.load(Ordering::Relaxed) == 0;
            let new = if is_unleased { entry.bytes } else { 0 };
            self.shares.take_shared(caller, entry.bytes, new).map_err(|_| LeaseError::Busy)?;
        }
        *slot.or_insert(0) += 1;
        entry.leases.fetch_add(1, Ordering::Relaxed);
        Ok(())
    }

    fn subtract(&mut self, caller: &Caller, entry: &Arc<CachedHull>) {
        let is_last = entry.leases.fetch_sub(1, Ordering::Relaxed) == 1;
        let hash_map::Entry::Occupied(mut count) =
            self.counts.entry((caller.id(), Arc::as_ptr(entry).addr()))
        else {
            return;
        };
        *count.get_mut() -= 1;
        if *count.get() == 0 {
            count.remove();
            self.shares.give_back_shared(caller, entry.bytes, if is_last { entry.bytes } else { 0 });
        }
    }
}

/// Keeps a request's hulls in the cache until it is dropped.
#[derive(Debug)]
pub struct Lease {
    leases: Arc<Leases>,
    caller: Caller,
    entries: Vec<Arc<CachedHull>>,
}

impl Lease {
    /// Whether the store still has all of the hulls, as far as this server knows.
    pub fn is_current(&self) -> bool {
        self.entries.iter().all(|entry| !entry.is_removed.load(Ordering::Relaxed))
    }

    /// Adds the entries of `other`, a lease of the same request.
    pub(super) fn join(&mut self, mut other: Self) {
        self.entries.append(&mut other.entries);
    }
}

impl Drop for Lease {
    fn drop(&mut self) {
        if self.entries.is_empty() {
            return;
        }
        let mut state = locked(&self.leases.state);
        for entry in &self.entries {
            state.subtract(&self.caller, entry);
        }
        self.leases.gauge.set(state.shares.used() as i64);
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::{
        budget::{CallerKey, Callers},
        contact::ConvexHull,
    };

    pub(in crate::store) fn entries(count: usize) -> Vec<Arc<CachedHull>> {
        let corners = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        let hull = Arc::new(ConvexHull::new(&corners).unwrap());
        (0..count).map(|_| CachedHull::new(hull.clone(), false, 0)).collect()
    }

    fn callers(count: u32) -> Vec<Caller> {
        let callers = Arc::new(Callers::default());
        (0..count).map(|user| callers.get(CallerKey::User(user))).collect()
    }

    /// Catches a hull that counts twice if it is leased twice, one that is released while another
    /// request leases it, a part of a request that stays leased when the rest is refused, and a
    /// request that can never fit and is told to retry.
    #[test]
    fn all_or_nothing_within_the_limit() {
        let (entries, caller) = (entries(5), Caller::alone());
        let metrics = Metrics::default();
        let leases = Leases::new(3 * entries[0].bytes, false, &metrics);
        let lease = |range: std::ops::Range<usize>| {
            LeaseRequest::new(&leases, &caller).lease(entries[range].to_vec())
        };
        let used = || locked(&leases.state).shares.used() / entries[0].bytes;
        assert_eq!(lease(0..4).unwrap_err(), LeaseError::TooLarge);
        let first = lease(0..2).unwrap();
        let again = lease(0..2).unwrap();
        assert_eq!(used(), 2);
        assert_eq!(lease(1..4).unwrap_err(), LeaseError::Busy);
        assert_eq!(used(), 2, "nothing of it is leased");
        let all = lease(0..3).unwrap();
        drop(first);
        assert_eq!(used(), 3);
        drop(all);
        assert_eq!(used(), 2);
        drop(again);
        assert_eq!((used(), metrics.held_bytes.get()), (0, 0));
        // The leases of one request count together, even if it takes them one by one.
        let request = LeaseRequest::new(&leases, &caller);
        let mut whole = request.lease(entries[..2].to_vec()).unwrap();
        whole.join(request.lease(entries[2..3].to_vec()).unwrap());
        assert_eq!(request.lease(entries[3..4].to_vec()).unwrap_err(), LeaseError::TooLarge);
        assert_eq!(lease(3..4).unwrap_err(), LeaseError::Busy);
        drop(whole);
        assert_eq!(used(), 0);
        assert!(locked(&leases.state).counts.is_empty());
        assert!(entries.iter().all(|entry| entry.leases.load(Ordering::Relaxed) == 0));
    }

    /// Catches a caller that leases so much that nothing is left for others, at its share and one
    /// hull past it. Also catches a hull of two callers that counts twice in the total, or only for
    /// the first of them.
    #[test]
    fn callers_share_what_can_be_leased() {
        let (entries, callers) = (entries(20), callers(3));
        let leases = Leases::new(12 * entries[0].bytes, true, &Metrics::default());
        let lease = |caller: usize, range: std::ops::Range<usize>| {
            LeaseRequest::new(&leases, &callers[caller]).lease(entries[range].to_vec())
        };
        let used = || locked(&leases.state).shares.used() / entries[0].bytes;
        let held = |caller: usize| locked(&leases.state).shares.held(&callers[caller]) / entries[0].bytes;
        assert_eq!(lease(0, 0..7).unwrap_err(), LeaseError::TooLarge);
        let greedy = lease(0, 0..6).unwrap();
        assert_eq!(lease(0, 6..7).unwrap_err(), LeaseError::Busy);
        // Six are free. The next caller may lease up to six hulls that others have, or up to three
        // that no other caller has.
        let shared = lease(1, 0..3).unwrap();
        assert_eq!((used(), held(0), held(1)), (6, 6, 3));
        let own = lease(1, 6..7).unwrap();
        assert_eq!(lease(1, 7..9).unwrap_err(), LeaseError::Busy);
        let late = lease(2, 10..12).unwrap();
        assert_eq!((used(), held(2)), (9, 2));
        drop(greedy);
        assert_eq!((used(), held(0), held(1)), (6, 0, 4), "three of them are still leased");
        drop((shared, own, late));
        assert_eq!((used(), locked(&leases.state).counts.len()), (0, 0));
    }
}
