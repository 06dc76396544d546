//! Schedules and times the operations of a store.
//!
//! At most as many operations run at a time as the store supports, and callers take turns
//! ([`FairSlots`]). An operation that has started runs to its end even if its caller leaves, so that
//! its time is always measured. An operation that has not returned within the limit marks the store
//! as hung. Its caller, the callers that wait for a turn, and later callers then get
//! [`StoreError::Hung`] at once, and no operation starts until every operation that exceeded the
//! limit has returned. So a hung store holds a bounded number of operations, and no caller waits
//! for it longer than the limit.

use std::{
    future::Future,
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicUsize, Ordering},
    },
    time::Duration,
};

use bytes::Bytes;
use futures_util::future::BoxFuture;
use tokio::{
    pin,
    sync::oneshot,
    time::{Instant, timeout},
};
use tracing::Instrument;

use super::{
    BlobStore, HullId, SharedBlobStore, StoreError, StoredBlob,
    fair_slots::{FairSlots, NoSlot},
};
use crate::{budget::Caller, log_limit::limited};

/// How many operations may wait for their turn. One caller may have half of them, which is enough
/// for a hundred requests of many hulls each.
const MOST_WAITING: u64 = 4096;

/// A store, shared by callers.
#[derive(Clone, Debug)]
pub(super) struct ScheduledStore {
    shared: Arc<StoreState>,
}

#[derive(Debug)]
struct StoreState {
    blobs: SharedBlobStore,
    slots: Arc<FairSlots>,
    limit: Duration,
    /// Operations that have exceeded the limit and have not returned.
    hanging: AtomicUsize,
    probing: AtomicBool,
}

impl ScheduledStore {
    /// `limit` is the time that an operation may take. `shares` says whether callers share the
    /// operations by dynamic thresholds.
    pub(super) fn new(blobs: SharedBlobStore, limit: Duration, shares: bool) -> Self {
        let slots = FairSlots::new(blobs.operations_at_a_time(), MOST_WAITING, shares);
        let (hanging, probing) = (AtomicUsize::new(0), AtomicBool::new(false));
        Self { shared: Arc::new(StoreState { blobs, slots, limit, hanging, probing }) }
    }

    /// The store as `caller` uses it.
    pub(super) fn for_caller(&self, caller: &Caller) -> CallerStore {
        CallerStore { shared: self.shared.clone(), caller: caller.clone() }
    }

    /// Tests whether the store can be written to. A probe takes no turn, so that its result does
    /// not depend on callers; only one probe is under way at a time.
    ///
    /// # Errors
    /// The reason why the store cannot be written to.
    pub(super) async fn probe(&self) -> Result<(), StoreError> {
        let shared = &self.shared;
        shared.check_not_hung()?;
        if shared.probing.swap(true, Ordering::AcqRel) {
            return Err(StoreError::Hung("the previous probe has not returned".into()));
        }
        let probing = ProbeGuard(shared.clone());
        let blobs = shared.blobs.clone();
        shared.timed(async move { blobs.probe().await }, probing).await
    }
}

/// Marks a probe as under way until it is dropped.
struct ProbeGuard(Arc<StoreState>);

impl Drop for ProbeGuard {
    fn drop(&mut self) {
        self.0.probing.store(false, Ordering::Release);
    }
}

impl StoreState {
    /// Refuses an operation while the store hangs.
    fn check_not_hung(&self) -> Result<(), StoreError> {
        match self.hanging.load(Ordering::Acquire) {
            0 => Ok(()),
            operations => Err(StoreError::Hung(format!(
                "{operations} operations have not returned within {} s",
                self.limit.as_secs_f64()
            ))),
        }
    }

    /// Runs an operation to its end, and keeps `slot` until then. Returns the result, or that the
    /// operation has exceeded the limit.
    async fn timed<T: Send + 'static>(
        self: &Arc<Self>,
        operation: impl Future<Output = Result<T, StoreError>> + Send + 'static,
        slot: impl Send + 'static,
    ) -> Result<T, StoreError> {
        let (send, receive) = oneshot::channel();
        let shared = self.clone();
        let run = async move {
            let started = Instant::now();
            pin!(operation);
            let Ok(result) = timeout(shared.limit, &mut operation).await else {
                let hanging = HangingOperation::new(&shared);
                let _ = send.send(Err(shared.check_not_hung().err().unwrap_or_else(no_result)));
                let _ = operation.await;
                drop((hanging, slot));
                let seconds = started.elapsed().as_secs_f64();
                limited!(info, seconds, "an operation of the store that had exceeded its limit returned");
                return;
            };
            drop(slot);
            let _ = send.send(result);
        };
        tokio::spawn(run.in_current_span());
        receive.await.unwrap_or_else(|_| Err(no_result()))
    }
}

fn no_result() -> StoreError {
    StoreError::Unavailable("the operation ended without a result".into())
}

/// Counts an operation that has exceeded the limit, until it is dropped.
struct HangingOperation(Arc<StoreState>);

impl HangingOperation {
    fn new(shared: &Arc<StoreState>) -> Self {
        let before = shared.hanging.fetch_add(1, Ordering::AcqRel);
        if before == 0 {
            let limit_seconds = shared.limit.as_secs_f64();
            limited!(
                error,
                limit_seconds,
                "the store hangs: an operation has not returned; no other begins before it does"
            );
        }
        shared.slots.refuse_waiting();
        Self(shared.clone())
    }
}

impl Drop for HangingOperation {
    fn drop(&mut self) {
        self.0.hanging.fetch_sub(1, Ordering::AcqRel);
    }
}

/// The store as one caller uses it.
#[derive(Debug)]
pub(super) struct CallerStore {
    shared: Arc<StoreState>,
    caller: Caller,
}

impl CallerStore {
    pub(super) fn caller(&self) -> &Caller {
        &self.caller
    }

    /// Starts an operation when it is the caller's turn.
    fn run<T: Send + 'static, F>(
        &self,
        operation: impl FnOnce(SharedBlobStore) -> F + Send + 'static,
    ) -> BoxFuture<'_, Result<T, StoreError>>
    where
        F: Future<Output = Result<T, StoreError>> + Send + 'static,
    {
        Box::pin(async move {
            let shared = &self.shared;
            shared.check_not_hung()?;
            let slot = shared.slots.take(&self.caller).await.map_err(|why| match why {
                NoSlot::Busy => StoreError::Busy("too many operations of this caller are waiting".into()),
                NoSlot::Refused => shared.check_not_hung().err().unwrap_or_else(no_result),
            })?;
            // The store may hang since then.
            shared.check_not_hung()?;
            shared.timed(operation(shared.blobs.clone()), slot).await
        })
    }
}

impl BlobStore for CallerStore {
    fn put(&self, id: HullId, blob: Bytes) -> BoxFuture<'_, Result<(), StoreError>> {
        self.run(move |blobs| async move { blobs.put(id, blob).await })
    }

    fn get(&self, id: HullId, max_bytes: u64) -> BoxFuture<'_, Result<Option<Bytes>, StoreError>> {
        self.run(move |blobs| async move { blobs.get(id, max_bytes).await })
    }

    fn size(&self, id: HullId) -> BoxFuture<'_, Result<Option<u64>, StoreError>> {
        self.run(move |blobs| async move { blobs.size(id).await })
    }

    fn delete(&self, id: HullId) -> BoxFuture<'_, Result<(), StoreError>> {
        self.run(move |blobs| async move { blobs.delete(id).await })
    }

    fn shards(&self) -> BoxFuture<'_, Result<Vec<u8>, StoreError>> {
        self.run(|blobs| async move { blobs.shards().await })
    }

    fn list(
        &self,
        shard: u8,
        after: Option<HullId>,
        count: usize,
        max_bytes: u64,
    ) -> BoxFuture<'_, Result<Vec<StoredBlob>, StoreError>> {
        self.run(move |blobs| async move { blobs.list(shard, after, count, max_bytes).await })
    }

    fn set_aside(&self, id: HullId, blob: Bytes) -> BoxFuture<'_, Result<String, StoreError>> {
        self.run(move |blobs| async move { blobs.set_aside(id, blob).await })
    }

    fn probe(&self) -> BoxFuture<'_, Result<(), StoreError>> {
        self.run(|blobs| async move { blobs.probe().await })
    }

    fn operations_at_a_time(&self) -> u64 {
        self.shared.blobs.operations_at_a_time()
    }
}
