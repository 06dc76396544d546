//! Reads hulls for one request: from the cache, otherwise from the store.
//!
//! A request writes one log line when its reader is dropped, however many of its hulls are missing
//! or unusable.

use std::{
    sync::{Arc, Mutex, PoisonError},
    time::Instant,
};

use bytes::Bytes;
use futures_util::future::BoxFuture;
use tracing::Instrument;

use super::{
    BlobStore, HullDefinition, HullId, Registry, StoreError,
    cache::CachedHull,
    fair_slots::FairSlot,
    identity::id_of,
    lease::{Lease, LeaseError, LeaseRequest},
    registry::BuildWorkError,
    scheduled::CallerStore,
};
use crate::{
    batch::Missing,
    compute::{ComputeError, Job},
    contact::ConvexHull,
    lock::locked,
    log_limit::limited,
    size::ByteSize,
    trace,
};

/// Blobs up to this size are verified on the thread that received them, which takes about 100 us.
/// Larger ones are verified on the compute threads, so that they do not delay other calls.
pub(super) const VERIFIED_IN_PLACE: usize = 64 << 10;

/// Reads hulls for one request.
#[derive(Debug)]
pub struct Reader<'a> {
    registry: &'a Registry,
    store: CallerStore,
    job: &'a Job,
    faults: Mutex<Option<UnreadableHulls>>,
}

/// Summary of the hulls of a request that could not be read.
#[derive(Debug)]
struct UnreadableHulls {
    hulls: u64,
    first: HullId,
    why: String,
}

/// The reason why a request does not have a hull.
pub(super) enum NotLeased {
    Missing(Missing),
    Refused(LeaseError),
}

impl From<Missing> for NotLeased {
    fn from(why: Missing) -> Self {
        Self::Missing(why)
    }
}

impl From<LeaseError> for NotLeased {
    fn from(why: LeaseError) -> Self {
        Self::Refused(why)
    }
}

impl<'a> Reader<'a> {
    pub(super) fn new(registry: &'a Registry, job: &'a Job) -> Self {
        Self { registry, store: registry.store.for_caller(&job.caller), job, faults: Mutex::default() }
    }

    /// The hull. If it is not cached, it is read from the store, once for all requests that wait
    /// for it.
    ///
    /// # Errors
    /// The reason why the hull is missing.
    pub async fn get(&self, id: HullId) -> Result<Arc<ConvexHull>, Missing> {
        let entry = self.registry.cache.get_or_insert_async(&id, self.load(id)).await?;
        self.check_if_stale(id, &entry).await?;
        Ok(entry.hull.clone())
    }

    /// The points with which the hull was registered. They are always read from the store and
    /// verified.
    ///
    /// # Errors
    /// The reason why the hull is missing.
    pub async fn definition(&self, id: HullId) -> Result<HullDefinition, Missing> {
        let _slot = self.load_slot(id).await?;
        self.stored_definition(id).await
    }

    /// Whether the server can answer for the hull. It cannot if the blob of that name is not the
    /// hull. If the store hangs, a cached hull counts as present.
    ///
    /// # Errors
    /// The store could not be read.
    pub async fn has(&self, id: HullId) -> Result<bool, Missing> {
        if self.registry.cached(&id, self.registry.now_ms()).is_some() {
            return Ok(true);
        }
        let _slot = self.load_slot(id).await?;
        match self.verified(id).await {
            Ok(found) => Ok(found.is_some()),
            Err(StoreError::Hung(_)) if self.registry.cache.get(&id).is_some() => Ok(true),
            Err(error) => match self.reason_missing(id, &error) {
                Missing::Unknown => Ok(false),
                Missing::Unavailable => Err(Missing::Unavailable),
            },
        }
    }

    /// Reads and leases one hull of a request. It is leased before it is inserted into the cache,
    /// which could otherwise have no room for it.
    pub(super) async fn leased(
        &self,
        id: HullId,
        request: &LeaseRequest,
    ) -> Result<(Arc<ConvexHull>, Lease), NotLeased> {
        let mut loaded = None;
        let load = async {
            let entry = self.load(id).await?;
            loaded = Some(request.lease(vec![entry.clone()])?);
            Ok::<_, NotLeased>(entry)
        };
        let entry = self.registry.cache.get_or_insert_async(&id, load).await?;
        let lease = match loaded {
            Some(lease) => lease,
            None => request.lease(vec![entry.clone()])?,
        };
        self.check_if_stale(id, &entry).await?;
        Ok((entry.hull.clone(), lease))
    }

    fn load(&self, id: HullId) -> BoxFuture<'_, Result<Arc<CachedHull>, Missing>> {
        Box::pin(async move {
            self.registry.metrics.cache_misses.inc();
            let started = Instant::now();
            let loaded = self.read_and_build(id).instrument(trace::load(&id)).await;
            self.registry.metrics.load_seconds.observe(started.elapsed().as_secs_f64());
            loaded
        })
    }

    /// Reads and builds a hull when it is the caller's turn.
    async fn read_and_build(&self, id: HullId) -> Result<Arc<CachedHull>, Missing> {
        let _slot = self.load_slot(id).await?;
        let definition = self.stored_definition(id).await?;
        // A hull that was once acknowledged is served even if it exceeds the current limit of
        // vertices.
        let built = self.registry.build(vec![definition], usize::MAX, self.job).await;
        match built.map(|hulls| hulls.into_iter().next()) {
            Ok(Some(Ok(hull))) => Ok(self.registry.entry(Arc::new(hull), false)),
            Ok(Some(Err(error))) => {
                self.note_unreadable(id, format!("this version cannot build a stored hull: {error}"));
                Err(Missing::Unknown)
            }
            Ok(None) | Err(BuildWorkError::Compute(ComputeError::Stopped)) => Err(Missing::Unavailable),
            Err(BuildWorkError::NoMemory(why)) => {
                self.note_unreadable(id, why.to_string());
                Err(Missing::Unavailable)
            }
            Err(BuildWorkError::Compute(ComputeError::Panicked(why))) => {
                limited!(error, hull = %id, %why, "a stored hull cannot be built");
                Err(Missing::Unavailable)
            }
        }
    }

    /// Waits until this caller may load one more hull.
    async fn load_slot(&self, id: HullId) -> Result<FairSlot, Missing> {
        self.registry.loading.take(&self.job.caller).await.map_err(|_| {
            self.note_unreadable(id, "too many hulls of this caller wait to be loaded".into());
            Missing::Unavailable
        })
    }

    /// The definition of a hull, or the reason why it is missing.
    async fn stored_definition(&self, id: HullId) -> Result<HullDefinition, Missing> {
        self.verified(id).await.map_err(|error| self.reason_missing(id, &error))?.ok_or(Missing::Unknown)
    }

    /// The definition that the store has under this id. `None` if the store has nothing under it,
    /// or something else than this hull.
    async fn verified(&self, id: HullId) -> Result<Option<HullDefinition>, StoreError> {
        let Some(blob) = self.store.get(id, self.registry.limits.max_blob_bytes).await? else {
            return Ok(None);
        };
        let verified = if blob.len() <= VERIFIED_IN_PLACE {
            verify(id, &blob)
        } else {
            let blob = blob.clone();
            let verified = self.registry.compute.run(move |_| verify(id, &blob), self.job).await;
            verified.map_err(|error| StoreError::Unavailable(error.to_string()))?
        };
        match verified {
            Ok(definition) => Ok(Some(definition)),
            Err(why) => {
                self.quarantine(id, blob, why).await;
                Ok(None)
            }
        }
    }

    /// Keeps a copy of a blob that is not its hull, for an operator to examine. The blob itself
    /// stays in place and is never served, until the hull is registered again. Moving it could race
    /// with that registration.
    async fn quarantine(&self, id: HullId, blob: Bytes, why: Corrupt) {
        self.registry.metrics.quarantined.inc();
        let bytes = blob.len();
        let copy = self.store.set_aside(id, blob).await.unwrap_or_else(|error| error.to_string());
        let why = match why {
            Corrupt::Content => "the blob is not this hull; registering the hull again repairs it",
            Corrupt::Format => "the blob is of another version",
        };
        self.note_unreadable(id, format!("{why} ({}; copy: {copy})", ByteSize(bytes as u64)));
    }

    /// Asks the store whether it still has a cached hull that was not seen there for the cache age,
    /// because another server may have deleted it. While the store hangs this cannot be known, and
    /// the cached hull is used.
    async fn check_if_stale(&self, id: HullId, entry: &CachedHull) -> Result<(), Missing> {
        if !self.registry.is_stale(entry, self.registry.now_ms()) {
            return Ok(());
        }
        match self.store.size(id).await {
            Ok(Some(_)) => {
                self.registry.mark_seen(entry);
                Ok(())
            }
            Ok(None) => {
                self.registry.uncache(&id);
                Err(Missing::Unknown)
            }
            Err(StoreError::Hung(_)) => Ok(()),
            Err(error) => Err(self.reason_missing(id, &error)),
        }
    }

    /// Converts an error of the store to the reason why a hull is missing.
    fn reason_missing(&self, id: HullId, error: &StoreError) -> Missing {
        self.registry.metrics.store_errors.inc();
        self.note_unreadable(id, error.to_string());
        match error {
            StoreError::NotABlob(_) => Missing::Unknown,
            _ => Missing::Unavailable,
        }
    }

    fn note_unreadable(&self, id: HullId, why: String) {
        let mut faults = locked(&self.faults);
        match &mut *faults {
            Some(faults) => faults.hulls += 1,
            None => *faults = Some(UnreadableHulls { hulls: 1, first: id, why }),
        }
    }
}

impl Drop for Reader<'_> {
    fn drop(&mut self) {
        let faults = self.faults.get_mut().unwrap_or_else(PoisonError::into_inner).take();
        if let Some(UnreadableHulls { hulls, first, why }) = faults {
            limited!(warn, hulls, %first, why, "hulls of a request could not be read from the store");
        }
    }
}

/// The reasons for which a blob is not the hull of its name.
#[derive(Clone, Copy, Debug)]
enum Corrupt {
    /// The blob's hash is not its name.
    Content,
    /// The blob's hash is its name, but this version cannot read it.
    Format,
}

/// Checks that these bytes are the hull named `id`, and decodes them.
fn verify(id: HullId, blob: &[u8]) -> Result<HullDefinition, Corrupt> {
    if id_of(blob) != id {
        return Err(Corrupt::Content);
    }
    HullDefinition::from_identity_bytes(blob).ok_or(Corrupt::Format)
}
