//! A store that fails on demand.

use std::sync::{
    Arc,
    atomic::{AtomicBool, AtomicUsize, Ordering},
};

use bytes::Bytes;
use hullcast::store::{BlobStore, HullId, StoreError, StoredBlob, blobs};
use tokio::sync::watch;

type Future<'a, T> = futures_util::future::BoxFuture<'a, Result<T, StoreError>>;

/// A store in memory with switches for faults and counters of operations.
#[derive(Debug)]
pub(crate) struct FaultyStore {
    inner: Arc<dyn BlobStore>,
    /// Every operation fails.
    pub(crate) unreadable: AtomicBool,
    /// Every write fails because the store is full.
    pub(crate) full: AtomicBool,
    /// One bit of every blob that is read is flipped.
    pub(crate) corrupt: AtomicBool,
    /// While this is true, operations that begin do not return.
    pub(crate) hangs: watch::Sender<bool>,
    /// The number of operations begun, without probes and without writes to a full store.
    pub(crate) begun: AtomicUsize,
    /// The number of reads begun.
    pub(crate) reads: AtomicUsize,
    /// The number of listings begun.
    pub(crate) listings: AtomicUsize,
}

impl FaultyStore {
    pub(crate) fn new() -> Arc<Self> {
        Arc::new(Self {
            inner: blobs::open("memory://").unwrap(),
            unreadable: false.into(),
            full: false.into(),
            corrupt: false.into(),
            hangs: watch::Sender::new(false),
            begun: 0.into(),
            reads: 0.into(),
            listings: 0.into(),
        })
    }

    async fn returns(&self) {
        let _ = self.hangs.subscribe().wait_for(|hangs| !hangs).await;
    }

    async fn readable(&self) -> Result<(), StoreError> {
        self.begun.fetch_add(1, Ordering::SeqCst);
        self.returns().await;
        match self.unreadable.load(Ordering::SeqCst) {
            true => Err(StoreError::Unavailable("on purpose".into())),
            false => Ok(()),
        }
    }
}

impl BlobStore for FaultyStore {
    fn put(&self, id: HullId, blob: Bytes) -> Future<'_, ()> {
        Box::pin(async move {
            if self.full.load(Ordering::SeqCst) {
                return Err(StoreError::Full("on purpose".into()));
            }
            self.readable().await?;
            self.inner.put(id, blob).await
        })
    }

    fn get(&self, id: HullId, max_bytes: u64) -> Future<'_, Option<Bytes>> {
        Box::pin(async move {
            self.reads.fetch_add(1, Ordering::SeqCst);
            self.readable().await?;
            let blob = self.inner.get(id, max_bytes).await?;
            if !self.corrupt.load(Ordering::SeqCst) {
                return Ok(blob);
            }
            Ok(blob.map(|blob| {
                let mut bytes = blob.to_vec();
                bytes[40] ^= 1;
                bytes.into()
            }))
        })
    }

    fn size(&self, id: HullId) -> Future<'_, Option<u64>> {
        Box::pin(async move {
            self.readable().await?;
            self.inner.size(id).await
        })
    }

    fn delete(&self, id: HullId) -> Future<'_, ()> {
        Box::pin(async move {
            self.readable().await?;
            self.inner.delete(id).await
        })
    }

    fn shards(&self) -> Future<'_, Vec<u8>> {
        Box::pin(async move {
            self.listings.fetch_add(1, Ordering::SeqCst);
            self.readable().await?;
            self.inner.shards().await
        })
    }

    fn list(
        &self,
        shard: u8,
        after: Option<HullId>,
        count: usize,
        max_bytes: u64,
    ) -> Future<'_, Vec<StoredBlob>> {
        Box::pin(async move {
            self.readable().await?;
            self.inner.list(shard, after, count, max_bytes).await
        })
    }

    fn set_aside(&self, id: HullId, blob: Bytes) -> Future<'_, String> {
        Box::pin(async move {
            self.readable().await?;
            self.inner.set_aside(id, blob).await
        })
    }

    fn probe(&self) -> Future<'_, ()> {
        Box::pin(async move {
            self.returns().await;
            if self.unreadable.load(Ordering::SeqCst) {
                return Err(StoreError::Unavailable("on purpose".into()));
            }
            self.inner.probe().await
        })
    }
}
