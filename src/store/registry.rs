//! Finds hulls by id, in the cache or in the store, and registers new ones.

use std::{
    sync::{Arc, Mutex, atomic::Ordering},
    time::{Duration, Instant},
};

use futures_util::{StreamExt, stream};
use thiserror::Error;

use super::{
    BlobStore, HullDefinition, HullId, SharedBlobStore, StoreError, StoredBlob, blobs,
    building::{BuildWork, building_bytes},
    cache::{CachedHull, HullCache, cache},
    fair_slots::FairSlots,
    identity::id_of,
    lease::{Lease, LeaseError, LeaseRequest, Leases},
    quota::Quota,
    reader::{NotLeased, Reader, VERIFIED_IN_PLACE},
    scheduled::{CallerStore, ScheduledStore},
};
use crate::{
    batch::{Hulls, Missing},
    budget::{MemoryBudget, NoMemory, Part},
    compute::{Compute, ComputeError, Job, Panicked},
    contact::{ConvexHull, HullError, Stopped},
    metrics::Metrics,
};

/// The limits of a registry.
#[derive(Clone, Copy, Debug)]
pub struct RegistryLimits {
    /// The most heap bytes of cached hulls, leased ones included.
    pub cache_bytes: u64,
    /// The most bytes of all blobs together; 0 stands for no limit.
    pub store_bytes: u64,
    /// A cached hull that was not seen in the store for this long is checked against the store.
    pub cache_age: Duration,
    /// The most extreme vertices of a hull that is registered.
    pub max_vertices: usize,
    /// Larger blobs are never read: no accepted definition has more bytes.
    pub max_blob_bytes: u64,
    /// How long an operation of the store may take before the store counts as hung.
    pub store_limit: Duration,
    /// Whether callers share leases, loads and operations of the store by dynamic thresholds.
    pub shares: bool,
}

/// The reason why a hull was not registered.
#[derive(Debug, Error)]
pub enum RegisterError {
    /// The points have no valid hull.
    #[error(transparent)]
    Hull(HullError),
    /// The store did not accept the blob.
    #[error(transparent)]
    Store(StoreError),
    /// The caller's budget has no room for building it.
    #[error(transparent)]
    NoMemory(NoMemory),
    /// The caller has left, or its deadline has passed.
    #[error("{}", Stopped)]
    Stopped,
    /// Building the hull panicked, which is a bug.
    #[error(transparent)]
    Internal(Panicked),
}

/// The reason why hulls were not built.
#[derive(Clone, Debug)]
pub(super) enum BuildWorkError {
    NoMemory(NoMemory),
    Compute(ComputeError),
}

impl From<BuildWorkError> for RegisterError {
    fn from(error: BuildWorkError) -> Self {
        match error {
            BuildWorkError::NoMemory(why) => Self::NoMemory(why),
            BuildWorkError::Compute(error) => error.into(),
        }
    }
}

impl From<ComputeError> for RegisterError {
    fn from(error: ComputeError) -> Self {
        match error {
            ComputeError::Stopped => Self::Stopped,
            ComputeError::Panicked(panicked) => Self::Internal(panicked),
        }
    }
}

/// A hull that was registered, or why it was not.
pub type Registered = Result<(HullId, Arc<ConvexHull>), RegisterError>;

/// The most hulls of one request that are read or written at a time. They are enough for a file
/// system to combine their syncs.
pub const AT_A_TIME: usize = 16;

/// The most hulls that may wait to be loaded, over all requests.
const MOST_WAITING: u64 = 4096;

/// A definition with its stored bytes and its name.
struct IdentifiedHull {
    id: HullId,
    blob: Vec<u8>,
    definition: HullDefinition,
}

/// The registered hulls.
#[derive(Debug)]
pub struct Registry {
    pub(super) store: ScheduledStore,
    pub(super) cache: HullCache,
    leases: Arc<Leases>,
    pub(super) loading: Arc<FairSlots>,
    pub(super) compute: Compute,
    memory: Arc<MemoryBudget>,
    pub(super) limits: RegistryLimits,
    /// The start of the time that `CachedHull::seen_ms` counts.
    started: Instant,
    quota: Quota,
    pub(super) metrics: Arc<Metrics>,
}

impl Registry {
    /// A registry of the hulls in `blobs`. `compute` builds hulls, with memory from `memory`.
    pub fn new(
        blobs: SharedBlobStore,
        compute: Compute,
        limits: RegistryLimits,
        memory: Arc<MemoryBudget>,
        metrics: Arc<Metrics>,
    ) -> Self {
        Self {
            // There are as many loads as the store has operations. Each hull is read, verified
            // and, if necessary, built in one turn, which limits the blobs in memory.
            loading: FairSlots::new(blobs.operations_at_a_time(), MOST_WAITING, limits.shares),
            store: ScheduledStore::new(blobs, limits.store_limit, limits.shares),
            cache: cache(limits.cache_bytes, &metrics),
            leases: Leases::new(limits.cache_bytes, limits.shares, &metrics),
            compute,
            memory,
            limits,
            started: Instant::now(),
            quota: Quota::new(limits.store_bytes, limits.max_blob_bytes, limits.shares),
            metrics,
        }
    }

    /// A reader for one request.
    pub fn reader<'a>(&'a self, job: &'a Job) -> Reader<'a> {
        Reader::new(self, job)
    }

    /// Leases the hulls of a request, whose ids are distinct. A hull that is not cached is read
    /// from the store, once for all requests that wait for it. The hulls stay cached until the
    /// lease is dropped.
    ///
    /// # Errors
    /// There is no room for all of them. Then no hull is leased.
    pub async fn lease(&self, ids: &[HullId], job: &Job) -> Result<(Hulls, Lease), LeaseError> {
        let request = LeaseRequest::new(&self.leases, &job.caller);
        let now_ms = self.now_ms();
        let cached: Vec<_> = ids.iter().map(|id| self.cached(id, now_ms)).collect();
        let mut lease = request.lease(cached.iter().flatten().cloned().collect())?;
        self.metrics.cache_hits.inc_by(cached.iter().flatten().count() as u64);
        let hull =
            |entry: Option<Arc<CachedHull>>| entry.map(|entry| entry.hull.clone()).ok_or(Missing::Unknown);
        let mut found: Hulls = cached.into_iter().map(hull).collect();
        let missing: Vec<usize> = (0..ids.len()).filter(|&i| found[i].is_err()).collect();
        if missing.is_empty() {
            return Ok((found, lease));
        }
        let reader = self.reader(job);
        let load = |i: usize| {
            let (reader, request) = (&reader, &request);
            async move { (i, reader.leased(ids[i], request).await) }
        };
        let mut loading = stream::iter(missing).map(load).buffer_unordered(AT_A_TIME);
        while let Some((i, leased)) = loading.next().await {
            found[i] = match leased {
                Ok((hull, part)) => {
                    lease.join(part);
                    Ok(hull)
                }
                Err(NotLeased::Missing(why)) => Err(why),
                Err(NotLeased::Refused(why)) => return Err(why),
            };
        }
        Ok((found, lease))
    }

    /// Counts hulls of a request that an earlier message of its stream had leased already.
    pub fn count_leased_again(&self, hulls: usize) {
        self.metrics.cache_hits.inc_by(hulls as u64);
    }

    /// The most bytes of hulls that one caller can lease.
    pub fn most_leased_alone(&self) -> u64 {
        self.leases.most_alone()
    }

    pub(super) fn cached(&self, id: &HullId, now_ms: u64) -> Option<Arc<CachedHull>> {
        self.cache.get(id).filter(|entry| !self.is_stale(entry, now_ms))
    }

    /// Registers hulls, built on all compute threads. They are durable when this returns.
    /// Registering a hull again changes nothing. There is one result per definition, in order; a
    /// refused hull is not stored.
    pub async fn register(&self, definitions: Vec<HullDefinition>, job: &Job) -> Vec<Registered> {
        let store = &self.store.for_caller(&job.caller);
        let looked_up: Vec<_> = stream::iter(definitions)
            .map(|definition| async move {
                let identified = self.identify(definition, job).await?;
                let known = self.acknowledged(store, identified.id, identified.blob.len()).await?;
                Ok((identified, known))
            })
            .buffered(AT_A_TIME)
            .collect()
            .await;
        let (mut new, mut known) = (Vec::new(), Vec::with_capacity(looked_up.len()));
        for looked_up in looked_up {
            known.push(looked_up.map(|(IdentifiedHull { id, blob, definition }, found)| {
                if found.is_none() {
                    new.push(definition);
                }
                (id, blob, found)
            }));
        }
        let mut built = self.build(new, self.limits.max_vertices, job).await.map(Vec::into_iter);
        let results = known.into_iter().map(|known| {
            let hull = known.and_then(|(id, blob, found)| match (found, &mut built) {
                (Some(hull), _) => Ok((id, hull, None)),
                (None, Err(error)) => Err(error.clone().into()),
                (None, Ok(built)) => match built.next() {
                    Some(Ok(hull)) => Ok((id, Arc::new(hull), Some(blob))),
                    Some(Err(error)) => Err(RegisterError::Hull(error)),
                    None => Err(RegisterError::Internal(Panicked("a hull was not built".into()))),
                },
            });
            async move {
                let (id, hull, to_write) = hull?;
                if let Some(blob) = to_write {
                    self.write(store, id, blob, &hull).await?;
                }
                Ok((id, hull))
            }
        });
        stream::iter(results).buffered(AT_A_TIME).collect().await
    }

    /// Builds hulls on all free compute threads, until the job is stopped. Their memory is taken
    /// before the work is queued, and released when the work is done or dropped.
    pub(super) async fn build(
        &self,
        definitions: Vec<HullDefinition>,
        max_vertices: usize,
        job: &Job,
    ) -> Result<Vec<Result<ConvexHull, HullError>>, BuildWorkError> {
        let bytes =
            definitions.iter().map(|definition| building_bytes(definition.points.len())).sum::<usize>();
        let memory = self.memory.take(&job.caller, Part::Building, bytes as u64);
        let memory = memory.map_err(BuildWorkError::NoMemory)?;
        let (stop, memory) = (job.stop.clone(), Mutex::new(Some(memory)));
        let building = BuildWork { definitions, max_vertices, stop, memory };
        self.compute.run_parts(building, job).await.map_err(BuildWorkError::Compute)
    }

    /// Computes a definition's blob and id.
    async fn identify(&self, definition: HullDefinition, job: &Job) -> Result<IdentifiedHull, RegisterError> {
        let name = |definition: HullDefinition| {
            let blob = definition.identity_bytes();
            IdentifiedHull { id: id_of(&blob), blob, definition }
        };
        if size_of_val(&definition.points[..]) <= VERIFIED_IN_PLACE {
            return Ok(name(definition));
        }
        Ok(self.compute.run(move |_| name(definition), job).await?)
    }

    /// Writes a new hull's blob and then caches the hull.
    async fn write(
        &self,
        store: &CallerStore,
        id: HullId,
        blob: Vec<u8>,
        hull: &Arc<ConvexHull>,
    ) -> Result<(), RegisterError> {
        self.quota.put(store, store.caller(), id, blob.into()).await.map_err(|error| {
            self.metrics.store_errors.inc();
            RegisterError::Store(error)
        })?;
        self.metrics.registered.inc();
        self.cache.insert(id, self.entry(hull.clone(), true));
        Ok(())
    }

    /// The cached hull, if this process wrote it and the store still has it.
    async fn acknowledged(
        &self,
        store: &CallerStore,
        id: HullId,
        bytes: usize,
    ) -> Result<Option<Arc<ConvexHull>>, RegisterError> {
        let Some(entry) = self.cache.get(&id).filter(|entry| entry.written) else { return Ok(None) };
        if store.size(id).await.map_err(RegisterError::Store)? != Some(bytes as u64) {
            return Ok(None);
        }
        self.mark_seen(&entry);
        Ok(Some(entry.hull.clone()))
    }

    /// Removes a hull from the store and the cache. Returns whether it was in the store.
    ///
    /// # Errors
    /// The store could not be read or written.
    pub async fn delete(&self, id: HullId, job: &Job) -> Result<bool, StoreError> {
        let store = self.store.for_caller(&job.caller);
        let size = store.size(id).await?;
        if size.is_some() {
            store.delete(id).await?;
            self.metrics.deleted.inc();
        }
        // After the blob, so that a load under way also loses its place in the cache.
        self.uncache(&id);
        self.quota.freed(size.unwrap_or(0)).await;
        Ok(size.is_some())
    }

    /// At most `count` stored hulls after `after`, ordered by id, and whether there are more.
    ///
    /// # Errors
    /// The store could not be listed.
    pub async fn list(
        &self,
        after: Option<HullId>,
        count: usize,
        job: &Job,
    ) -> Result<(Vec<StoredBlob>, bool), StoreError> {
        let store = self.store.for_caller(&job.caller);
        let mut page =
            blobs::list(&store, after, count.saturating_add(1), self.limits.max_blob_bytes).await?;
        let more = page.len() > count;
        page.truncate(count);
        Ok((page, more))
    }

    /// The heap bytes of all cached hulls.
    pub fn cached_bytes(&self) -> u64 {
        self.cache.weight()
    }

    /// Tests whether the store can be written to.
    ///
    /// # Errors
    /// The reason why it cannot.
    pub async fn probe(&self) -> Result<(), StoreError> {
        self.store.probe().await
    }

    /// The number of cached hulls.
    pub fn cached_hulls(&self) -> usize {
        self.cache.len()
    }

    /// Removes a hull that the store no longer has from the cache.
    pub(super) fn uncache(&self, id: &HullId) {
        if let Some((_, entry)) = self.cache.remove(id) {
            entry.is_removed.store(true, Ordering::Relaxed);
        }
    }

    pub(super) fn entry(&self, hull: Arc<ConvexHull>, written: bool) -> Arc<CachedHull> {
        CachedHull::new(hull, written, self.now_ms())
    }

    pub(super) fn is_stale(&self, entry: &CachedHull, now_ms: u64) -> bool {
        let age = now_ms.saturating_sub(entry.seen_ms.load(Ordering::Relaxed));
        u128::from(age) >= self.limits.cache_age.as_millis()
    }

    pub(super) fn mark_seen(&self, entry: &CachedHull) {
        entry.seen_ms.store(self.now_ms(), Ordering::Relaxed);
    }

    pub(super) fn now_ms(&self) -> u64 {
        u64::try_from(self.started.elapsed().as_millis()).unwrap_or(u64::MAX)
    }
}
