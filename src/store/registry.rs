//! Answers for hulls by id: from the cache, else from the store.

use std::{
    fmt,
    sync::{Arc, atomic::Ordering},
    time::{Duration, Instant},
};

use bytes::Bytes;
use futures_util::{StreamExt, stream};
use tracing::Instrument;

use super::{
    HullDefinition, HullId, Opened, StoreError, StoredBlob,
    cache::{Budget, Entry, Hold, HullCache, Hulls, NoRoom, Taking, cache},
    identity::id_of,
    quota::Quota,
};
use crate::{
    compute::{Compute, Panicked, Parts},
    contact::{ConvexHull, HullError},
    metrics::Metrics,
    trace,
};

/// What bounds a registry.
#[derive(Clone, Copy, Debug)]
pub struct Bounds {
    /// Heap of hulls: cached, and of those what requests hold.
    pub cache_bytes: u64,
    /// Blobs, summed; 0: unbounded.
    pub store_bytes: u64,
    /// A cached hull is checked to be still in the store when it was not for this long.
    pub cache_age: Duration,
    /// Extreme vertices of a hull that is registered.
    pub max_vertices: usize,
}

/// Why a hull cannot be answered for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Missing {
    /// The store does not have it, or what it has is not it: registering it (again) helps.
    Unknown,
    /// The store could not be read: trying again may help.
    Unavailable,
}

/// Why a request does not have a hull.
enum NotHeld {
    Missing(Missing),
    NoRoom(NoRoom),
}

impl From<Missing> for NotHeld {
    fn from(why: Missing) -> Self {
        Self::Missing(why)
    }
}

impl From<NoRoom> for NotHeld {
    fn from(why: NoRoom) -> Self {
        Self::NoRoom(why)
    }
}

/// Why a hull was not registered.
#[derive(Debug)]
pub enum RegisterError {
    /// Its points are no hull.
    Hull(HullError),
    /// The store did not take it.
    Store(StoreError),
    /// A bug: it could not be built.
    Internal(Panicked),
}

/// A hull that was registered, or why it was not.
pub type Registered = Result<(HullId, Arc<ConvexHull>), RegisterError>;

/// Hulls of one request that are read or written at a time: enough that a file system
/// gathers their syncs.
pub const AT_A_TIME: usize = 16;

/// Hulls to be built, each a part.
struct Building {
    definitions: Vec<HullDefinition>,
    max_vertices: usize,
}

impl Parts for Building {
    type Part = Result<ConvexHull, HullError>;
    type Whole = Vec<Self::Part>;

    fn count(&self) -> usize {
        self.definitions.len()
    }

    fn part(&self, index: usize) -> Self::Part {
        self.definitions[index].build(self.max_vertices)
    }

    fn whole(&self, parts: Vec<Self::Part>) -> Self::Whole {
        parts
    }
}

/// The registered hulls.
#[derive(Debug)]
pub struct Registry {
    blobs: Opened,
    cache: HullCache,
    budget: Arc<Budget>,
    compute: Compute,
    bounds: Bounds,
    started: Instant,
    quota: Quota,
    metrics: Arc<Metrics>,
}

impl Registry {
    /// Hulls in `blobs`, computed on `compute`. Reads nothing yet.
    pub fn new(blobs: Opened, compute: Compute, bounds: Bounds, metrics: Arc<Metrics>) -> Self {
        let cache = cache(bounds.cache_bytes, &metrics);
        let budget = Budget::new(bounds.cache_bytes, &metrics);
        let quota = Quota::new(bounds.store_bytes);
        Self { blobs, cache, budget, compute, bounds, started: Instant::now(), quota, metrics }
    }

    /// Whether the hull is at hand: no waiting, no store.
    pub fn is_cached(&self, id: HullId) -> bool {
        self.cached(&id, self.now_ms()).is_some()
    }

    /// A request's hulls, distinct: at hand, or read from the store, once however many ask.
    /// They count as in use until the hold is dropped.
    ///
    /// # Errors
    /// There is no room for all of them; none is held.
    pub async fn hold(&self, ids: &[HullId]) -> Result<(Hulls, Hold), NoRoom> {
        let taking = Taking::new(&self.budget);
        let now_ms = self.now_ms();
        let cached: Vec<_> = ids.iter().map(|id| self.cached(id, now_ms)).collect();
        let mut hold = taking.hold(cached.iter().flatten().cloned().collect())?;
        self.metrics.cache_hits.inc_by(cached.iter().flatten().count() as u64);
        let hull = |entry: Option<Arc<Entry>>| entry.map(|entry| entry.hull.clone()).ok_or(Missing::Unknown);
        let mut found: Hulls = cached.into_iter().map(hull).collect();
        let missing: Vec<usize> = (0..ids.len()).filter(|&i| found[i].is_err()).collect();
        let load = |i: usize| {
            let taking = &taking;
            async move { (i, self.held(ids[i], taking).await) }
        };
        let mut loading = stream::iter(missing).map(load).buffer_unordered(AT_A_TIME);
        while let Some((i, held)) = loading.next().await {
            found[i] = match held {
                Ok((hull, part)) => {
                    hold.join(part);
                    Ok(hull)
                }
                Err(NotHeld::Missing(why)) => Err(why),
                Err(NotHeld::NoRoom(why)) => return Err(why),
            };
        }
        Ok((found, hold))
    }

    /// One of them. Held before it is in the cache, which could have no room for it else.
    async fn held(&self, id: HullId, taking: &Taking) -> Result<(Arc<ConvexHull>, Hold), NotHeld> {
        let mut loaded = None;
        let load = async {
            let entry = self.load(id).await?;
            loaded = Some(taking.hold(vec![entry.clone()])?);
            Ok::<_, NotHeld>(entry)
        };
        let entry = self.cache.get_or_insert_async(&id, load).await?;
        let hold = match loaded {
            Some(hold) => hold,
            None => taking.hold(vec![entry.clone()])?,
        };
        if self.is_stale(&entry, self.now_ms()) {
            self.check(id, &entry).await?;
        }
        Ok((entry.hull.clone(), hold))
    }

    /// The hull; read from the store where it is not cached, once however many ask.
    ///
    /// # Errors
    /// Why it cannot be answered for.
    pub async fn get(&self, id: HullId) -> Result<Arc<ConvexHull>, Missing> {
        let entry = self.cache.get_or_insert_async(&id, self.load(id)).await?;
        if self.is_stale(&entry, self.now_ms()) {
            self.check(id, &entry).await?;
        }
        Ok(entry.hull.clone())
    }

    fn cached(&self, id: &HullId, now_ms: u64) -> Option<Arc<Entry>> {
        self.cache.get(id).filter(|entry| !self.is_stale(entry, now_ms))
    }

    /// The points that the hull was registered with, verified; always from the store.
    ///
    /// # Errors
    /// Why it cannot be answered for.
    pub async fn definition(&self, id: HullId) -> Result<HullDefinition, Missing> {
        let blob = self.blobs.get(id).await.map_err(|error| {
            self.metrics.store_errors.inc();
            tracing::warn!(hull = %id, %error, "cannot read a hull");
            Missing::Unavailable
        })?;
        let blob = blob.ok_or(Missing::Unknown)?;
        let intact = id_of(&blob) == id;
        let definition = intact.then(|| HullDefinition::from_identity_bytes(&blob)).flatten();
        if definition.is_none() {
            self.quarantine(id, blob, intact).await;
        }
        definition.ok_or(Missing::Unknown)
    }

    /// Registers hulls, built on all compute threads: durable when this returns.
    /// Registering one again changes nothing. A result each, in their order: of one that
    /// is refused nothing is stored.
    pub async fn register(&self, definitions: Vec<HullDefinition>) -> Vec<Registered> {
        let looked_up: Vec<_> = stream::iter(definitions)
            .map(|definition| async {
                let blob = definition.identity_bytes();
                let id = id_of(&blob);
                (id, blob, definition, self.known(id).await)
            })
            .buffered(AT_A_TIME)
            .collect()
            .await;
        let (mut new, mut known) = (Vec::new(), Vec::with_capacity(looked_up.len()));
        for (id, blob, definition, found) in looked_up {
            if let Ok(None) = found {
                new.push(definition);
            }
            known.push((id, blob, found));
        }
        let building = Building { definitions: new, max_vertices: self.bounds.max_vertices };
        let mut built = self.compute.split(building).await.map(Vec::into_iter);
        let results = known.into_iter().map(|(id, blob, found)| {
            let hull = found.and_then(|found| match (found, &mut built) {
                (Some(hull), _) => Ok((hull, false)),
                (None, Err(panicked)) => Err(RegisterError::Internal(panicked.clone())),
                (None, Ok(built)) => match built.next() {
                    Some(hull) => hull.map(|hull| (Arc::new(hull), true)).map_err(RegisterError::Hull),
                    None => Err(RegisterError::Internal(Panicked("a hull was not built".into()))),
                },
            });
            async move {
                let (hull, is_new) = hull?;
                if is_new {
                    self.store(id, blob, &hull).await?;
                }
                Ok((id, hull))
            }
        });
        stream::iter(results).buffered(AT_A_TIME).collect().await
    }

    /// Writes a new hull's blob; then it is at hand.
    async fn store(&self, id: HullId, blob: Vec<u8>, hull: &Arc<ConvexHull>) -> Result<(), RegisterError> {
        self.quota.put(&*self.blobs, id, blob.into()).await.map_err(|error| {
            self.metrics.store_errors.inc();
            RegisterError::Store(error)
        })?;
        self.metrics.registered.inc();
        self.cache.insert(id, self.entry(hull.clone(), true));
        Ok(())
    }

    /// A hull that this process wrote and that is still in the store.
    async fn known(&self, id: HullId) -> Result<Option<Arc<ConvexHull>>, RegisterError> {
        let Some(entry) = self.cache.get(&id).filter(|entry| entry.written) else { return Ok(None) };
        if self.blobs.size(id).await.map_err(RegisterError::Store)?.is_none() {
            return Ok(None);
        }
        self.saw(&entry);
        Ok(Some(entry.hull.clone()))
    }

    /// Removes a hull from the store and the cache; whether it was in the store.
    ///
    /// # Errors
    /// The store could not be read or written.
    pub async fn delete(&self, id: HullId) -> Result<bool, StoreError> {
        let size = self.blobs.size(id).await?;
        if size.is_some() {
            self.blobs.delete(id).await?;
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
    ) -> Result<(Vec<StoredBlob>, bool), StoreError> {
        let mut page = self.blobs.list(after, count.saturating_add(1)).await?;
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
        self.blobs.probe().await
    }

    /// How many hulls are cached.
    pub fn cached_hulls(&self) -> usize {
        self.cache.len()
    }

    /// Keeps a copy of a blob that is not its hull, for people to look at. The blob itself
    /// stays where it is, never served, until the hull is registered again: to move it would
    /// race with that.
    async fn quarantine(&self, id: HullId, blob: Bytes, intact: bool) {
        self.metrics.quarantined.inc();
        let bytes = blob.len();
        let kept = self.blobs.set_aside(id, blob).await;
        let copy = kept.as_ref().map_or_else(ToString::to_string, Clone::clone);
        tracing::error!(hull = %id, bytes, intact, copy, "the store's blob is not this hull; registering it again repairs it");
    }

    async fn load(&self, id: HullId) -> Result<Arc<Entry>, Missing> {
        self.metrics.cache_misses.inc();
        let started = Instant::now();
        let loaded = self.loaded(id).instrument(trace::load(&id)).await;
        self.metrics.load_seconds.observe(started.elapsed().as_secs_f64());
        loaded
    }

    async fn loaded(&self, id: HullId) -> Result<Arc<Entry>, Missing> {
        let definition = self.definition(id).await?;
        // What was once acknowledged is answered for, whatever the limit is by now.
        match self.compute.run(move || definition.build(usize::MAX)).await {
            Ok(Ok(hull)) => Ok(self.entry(Arc::new(hull), false)),
            Ok(Err(error)) => {
                tracing::error!(hull = %id, %error, "a stored hull is no hull to this version");
                Err(Missing::Unknown)
            }
            Err(error) => {
                tracing::error!(hull = %id, %error, "a stored hull cannot be built");
                Err(Missing::Unavailable)
            }
        }
    }

    /// Whether a cached hull is still in the store: another server may have deleted it.
    async fn check(&self, id: HullId, entry: &Entry) -> Result<(), Missing> {
        match self.blobs.size(id).await {
            Ok(Some(_)) => {
                self.saw(entry);
                Ok(())
            }
            Ok(None) => {
                self.cache.remove(&id);
                Err(Missing::Unknown)
            }
            Err(error) => {
                self.metrics.store_errors.inc();
                tracing::warn!(hull = %id, %error, "cannot check a cached hull");
                Err(Missing::Unavailable)
            }
        }
    }

    fn entry(&self, hull: Arc<ConvexHull>, written: bool) -> Arc<Entry> {
        Entry::new(hull, written, self.now_ms())
    }

    fn is_stale(&self, entry: &Entry, now_ms: u64) -> bool {
        let age = now_ms.saturating_sub(entry.seen_ms.load(Ordering::Relaxed));
        u128::from(age) >= self.bounds.cache_age.as_millis()
    }

    fn saw(&self, entry: &Entry) {
        entry.seen_ms.store(self.now_ms(), Ordering::Relaxed);
    }

    fn now_ms(&self) -> u64 {
        u64::try_from(self.started.elapsed().as_millis()).unwrap_or(u64::MAX)
    }
}

impl fmt::Display for RegisterError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Hull(error) => error.fmt(f),
            Self::Store(error) => error.fmt(f),
            Self::Internal(error) => error.fmt(f),
        }
    }
}

impl std::error::Error for RegisterError {}
