//! Answers for hulls by id: from the cache, otherwise from the store.

use std::{
    fmt,
    sync::{Arc, Mutex, atomic::Ordering},
    time::{Duration, Instant},
};

use futures_util::{StreamExt, stream};

use super::{
    BlobStore, HullDefinition, HullId, Opened, StoreError, StoredBlob, blobs,
    building::{Building, building_bytes},
    cache::{Entry, HullCache, cache},
    identity::id_of,
    lease::{Hulls, Lease, LeaseError, LeaseRequest, Leases},
    quota::Quota,
    reader::{NotLeased, Reader, VERIFIED_IN_PLACE},
    scheduled::{CallerStore, ScheduledStore},
    turns::Turns,
};
use crate::{
    budget::{MemoryBudget, NoMemory, Part},
    compute::{Compute, ComputeError, Job, Panicked},
    contact::{ConvexHull, HullError, Stopped},
    metrics::Metrics,
};

/// What bounds a registry.
#[derive(Clone, Copy, Debug)]
pub struct Bounds {
    /// Heap of cached hulls, those that requests lease among them.
    pub cache_bytes: u64,
    /// Blobs, summed; 0: unbounded.
    pub store_bytes: u64,
    /// A cached hull is checked to be still in the store when it was not for this long.
    pub cache_age: Duration,
    /// Extreme vertices of a hull that is registered.
    pub max_vertices: usize,
    /// A larger blob is never read: no definition that is accepted has so many bytes.
    pub max_blob_bytes: u64,
    /// How long an operation of the store may take before the store is taken to hang.
    pub store_limit: Duration,
    /// Whether callers share leases, loads and operations of the store by dynamic thresholds.
    pub shares: bool,
}

/// Why a hull cannot be answered for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Missing {
    /// The store does not have the hull, or has something else under its name: registering the
    /// hull (again) helps.
    Unknown,
    /// The store could not be read: trying again may help.
    Unavailable,
}

/// Why a hull was not registered.
#[derive(Debug)]
pub enum RegisterError {
    /// Its points are no hull.
    Hull(HullError),
    /// The store did not take it.
    Store(StoreError),
    /// The caller's budget has no room for building it.
    NoMemory(NoMemory),
    /// Nobody waits for it any more.
    Stopped,
    /// A bug: it could not be built.
    Internal(Panicked),
}

/// Why hulls were not built.
#[derive(Clone, Debug)]
pub(super) enum BuildError {
    NoMemory(NoMemory),
    Compute(ComputeError),
}

impl From<BuildError> for RegisterError {
    fn from(error: BuildError) -> Self {
        match error {
            BuildError::NoMemory(why) => Self::NoMemory(why),
            BuildError::Compute(error) => error.into(),
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

/// Hulls of one request that are read or written at a time: enough that a file system
/// gathers their syncs.
pub const AT_A_TIME: usize = 16;

/// Hulls that may wait to be loaded, over all requests.
const MOST_WAITING: u64 = 4096;

/// A definition, the bytes that are stored of it, and their name.
struct Named {
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
    pub(super) loading: Arc<Turns>,
    pub(super) compute: Compute,
    memory: Arc<MemoryBudget>,
    pub(super) bounds: Bounds,
    /// What `Entry::seen_ms` counts from.
    started: Instant,
    quota: Quota,
    pub(super) metrics: Arc<Metrics>,
}

impl Registry {
    /// Hulls in `blobs`, built by `compute` with memory of `memory`.
    pub fn new(
        blobs: Opened,
        compute: Compute,
        bounds: Bounds,
        memory: Arc<MemoryBudget>,
        metrics: Arc<Metrics>,
    ) -> Self {
        Self {
            // As many as the store has operations: each is read, verified and perhaps built in
            // one turn, which bounds the blobs that are in memory.
            loading: Turns::new(blobs.operations_at_a_time(), MOST_WAITING, bounds.shares),
            store: ScheduledStore::new(blobs, bounds.store_limit, bounds.shares),
            cache: cache(bounds.cache_bytes, &metrics),
            leases: Leases::new(bounds.cache_bytes, bounds.shares, &metrics),
            compute,
            memory,
            bounds,
            started: Instant::now(),
            quota: Quota::new(bounds.store_bytes, bounds.max_blob_bytes, bounds.shares),
            metrics,
        }
    }

    /// Reads hulls for one request.
    pub fn reader<'a>(&'a self, job: &'a Job) -> Reader<'a> {
        Reader::new(self, job)
    }

    /// A request's hulls, distinct: from the cache, or read from the store, once however many
    /// ask. They stay cached until the lease is dropped.
    ///
    /// # Errors
    /// There is no room for all of them; none is leased.
    pub async fn lease(&self, ids: &[HullId], job: &Job) -> Result<(Hulls, Lease), LeaseError> {
        let request = LeaseRequest::new(&self.leases, &job.caller);
        let now_ms = self.now_ms();
        let cached: Vec<_> = ids.iter().map(|id| self.cached(id, now_ms)).collect();
        let mut lease = request.lease(cached.iter().flatten().cloned().collect())?;
        self.metrics.cache_hits.inc_by(cached.iter().flatten().count() as u64);
        let hull = |entry: Option<Arc<Entry>>| entry.map(|entry| entry.hull.clone()).ok_or(Missing::Unknown);
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
                Err(NotLeased::NoRoom(why)) => return Err(why),
            };
        }
        Ok((found, lease))
    }

    /// The most bytes of hulls that one caller can lease.
    pub fn most_leased_alone(&self) -> u64 {
        self.leases.most_alone()
    }

    pub(super) fn cached(&self, id: &HullId, now_ms: u64) -> Option<Arc<Entry>> {
        self.cache.get(id).filter(|entry| !self.is_stale(entry, now_ms))
    }

    /// Registers hulls, built on all compute threads: durable when this returns.
    /// Registering one again changes nothing. A result each, in their order: of one that
    /// is refused nothing is stored.
    pub async fn register(&self, definitions: Vec<HullDefinition>, job: &Job) -> Vec<Registered> {
        let store = &self.store.of(&job.caller);
        let looked_up: Vec<_> = stream::iter(definitions)
            .map(|definition| async move {
                let named = self.named(definition, job).await?;
                let known = self.known(store, named.id, named.blob.len()).await?;
                Ok((named, known))
            })
            .buffered(AT_A_TIME)
            .collect()
            .await;
        let (mut new, mut known) = (Vec::new(), Vec::with_capacity(looked_up.len()));
        for looked_up in looked_up {
            known.push(looked_up.map(|(Named { id, blob, definition }, found)| {
                if found.is_none() {
                    new.push(definition);
                }
                (id, blob, found)
            }));
        }
        let mut built = self.build(new, self.bounds.max_vertices, job).await.map(Vec::into_iter);
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

    /// Builds hulls on all compute threads that are free, until the job is stopped. The memory
    /// for it is taken before the work is queued, and given back when the work is done or
    /// dropped.
    pub(super) async fn build(
        &self,
        definitions: Vec<HullDefinition>,
        max_vertices: usize,
        job: &Job,
    ) -> Result<Vec<Result<ConvexHull, HullError>>, BuildError> {
        let bytes = definitions.iter().map(building_bytes).sum::<usize>();
        let memory = self.memory.take(&job.caller, Part::Building, bytes as u64);
        let memory = memory.map_err(BuildError::NoMemory)?;
        let (stop, memory) = (job.stop.clone(), Mutex::new(Some(memory)));
        let building = Building { definitions, max_vertices, stop, memory };
        self.compute.split(building, job).await.map_err(BuildError::Compute)
    }

    /// A definition with its name.
    async fn named(&self, definition: HullDefinition, job: &Job) -> Result<Named, RegisterError> {
        let name = |definition: HullDefinition| {
            let blob = definition.identity_bytes();
            Named { id: id_of(&blob), blob, definition }
        };
        if size_of_val(&definition.points[..]) <= VERIFIED_IN_PLACE {
            return Ok(name(definition));
        }
        Ok(self.compute.run(move |_| name(definition), job).await?)
    }

    /// Writes a new hull's blob; then the hull is cached.
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

    /// A hull that this process wrote and that is still in the store.
    async fn known(
        &self,
        store: &CallerStore,
        id: HullId,
        bytes: usize,
    ) -> Result<Option<Arc<ConvexHull>>, RegisterError> {
        let Some(entry) = self.cache.get(&id).filter(|entry| entry.written) else { return Ok(None) };
        if store.size(id).await.map_err(RegisterError::Store)? != Some(bytes as u64) {
            return Ok(None);
        }
        self.saw(&entry);
        Ok(Some(entry.hull.clone()))
    }

    /// Removes a hull from the store and the cache; whether it was in the store.
    ///
    /// # Errors
    /// The store could not be read or written.
    pub async fn delete(&self, id: HullId, job: &Job) -> Result<bool, StoreError> {
        let store = self.store.of(&job.caller);
        let size = store.size(id).await?;
        if size.is_some() {
            store.delete(id).await?;
            self.metrics.deleted.inc();
        }
        // After the blob: a load under way meanwhile loses its place in the cache too.
        self.cache.remove(&id);
        self.quota.freed(size.unwrap_or(0)).await;
        Ok(size.is_some())
    }

    /// At most `count` stored hulls after `after`, by id, and whether there are more.
    ///
    /// # Errors
    /// The store could not be listed.
    pub async fn list(
        &self,
        after: Option<HullId>,
        count: usize,
        job: &Job,
    ) -> Result<(Vec<StoredBlob>, bool), StoreError> {
        let store = self.store.of(&job.caller);
        let mut page =
            blobs::list(&store, after, count.saturating_add(1), self.bounds.max_blob_bytes).await?;
        let more = page.len() > count;
        page.truncate(count);
        Ok((page, more))
    }

    /// Heap bytes that the cache holds.
    pub fn cached_bytes(&self) -> u64 {
        self.cache.weight()
    }

    /// Whether the store can be written to.
    ///
    /// # Errors
    /// Why not.
    pub async fn probe(&self) -> Result<(), StoreError> {
        self.store.probe().await
    }

    /// How many hulls are cached.
    pub fn cached_hulls(&self) -> usize {
        self.cache.len()
    }

    pub(super) fn entry(&self, hull: Arc<ConvexHull>, written: bool) -> Arc<Entry> {
        Entry::new(hull, written, self.now_ms())
    }

    pub(super) fn is_stale(&self, entry: &Entry, now_ms: u64) -> bool {
        let age = now_ms.saturating_sub(entry.seen_ms.load(Ordering::Relaxed));
        u128::from(age) >= self.bounds.cache_age.as_millis()
    }

    pub(super) fn saw(&self, entry: &Entry) {
        entry.seen_ms.store(self.now_ms(), Ordering::Relaxed);
    }

    pub(super) fn now_ms(&self) -> u64 {
        u64::try_from(self.started.elapsed().as_millis()).unwrap_or(u64::MAX)
    }
}

impl fmt::Display for RegisterError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Hull(error) => error.fmt(f),
            Self::Store(error) => error.fmt(f),
            Self::NoMemory(error) => error.fmt(f),
            Self::Stopped => Stopped.fmt(f),
            Self::Internal(error) => error.fmt(f),
        }
    }
}

impl std::error::Error for RegisterError {}
