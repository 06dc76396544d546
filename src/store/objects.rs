//! Blobs as objects, in an object store over the network or in memory.

use std::{error::Error as _, io, sync::Arc};

use bytes::Bytes;
use futures_util::{TryStreamExt, future::BoxFuture};
use object_store::{ObjectMeta, ObjectStore, ObjectStoreExt, PutPayload, path::Path};

use super::{
    BlobStore, HullId, StoreError, StoredBlob,
    blob_store::{FirstById, quarantine_name, shard_name, shard_of_name},
};
use crate::size::ByteSize;

/// A store over the network, and the words by which its errors say that an object is missing.
pub(super) type OpenedBucket = (Arc<dyn ObjectStore>, &'static str);

/// Blobs as objects, sharded by the first byte of their id.
#[derive(Debug)]
pub(super) struct ObjectBlobStore {
    objects: Arc<dyn ObjectStore>,
    absent: Option<&'static str>,
}

impl ObjectBlobStore {
    /// `absent` is for stores that give the same status for a missing object and for a missing
    /// bucket. A missing bucket is an outage of all hulls. An error is about a missing object if
    /// its text contains `absent`. If `absent` is not given, only the status decides.
    pub(super) fn new(objects: Arc<dyn ObjectStore>, absent: Option<&'static str>) -> Self {
        Self { objects, absent }
    }

    /// A "not found" is not an error if it is about the object itself.
    fn present<T>(&self, result: object_store::Result<T>) -> Result<Option<T>, StoreError> {
        match result {
            Ok(value) => Ok(Some(value)),
            Err(error @ object_store::Error::NotFound { .. })
                if self.absent.is_none_or(|absent| says(&error, absent)) =>
            {
                Ok(None)
            }
            Err(error) => Err(store_error(error)),
        }
    }

    /// The description of an object, or `None` if there is no such object.
    async fn meta(&self, path: &Path) -> Result<Option<ObjectMeta>, StoreError> {
        let mut found = self.objects.head(path).await;
        if self.absent.is_some() && matches!(found, Err(object_store::Error::NotFound { .. })) {
            // An answer without a body does not tell whether the object or the bucket is missing.
            found = self.objects.get(path).await.map(|found| found.meta);
        }
        self.present(found)
    }
}

/// `ab/ab12…`. The name is the whole id, so that a file can be checked in place.
fn key(id: HullId) -> Path {
    let name = id.to_string();
    Path::from_iter([&name[..2], &name])
}

fn id_of_key(key: &Path) -> Option<HullId> {
    key.filename()?.parse().ok()
}

impl BlobStore for ObjectBlobStore {
    fn put(&self, id: HullId, blob: Bytes) -> BoxFuture<'_, Result<(), StoreError>> {
        Box::pin(async move {
            let written = self.objects.put(&key(id), PutPayload::from_bytes(blob)).await;
            written.map(|_| ()).map_err(store_error)
        })
    }

    fn get(&self, id: HullId, max_bytes: u64) -> BoxFuture<'_, Result<Option<Bytes>, StoreError>> {
        Box::pin(async move {
            let Some(found) = self.present(self.objects.get(&key(id)).await)? else { return Ok(None) };
            if found.meta.size > max_bytes {
                let size = found.meta.size;
                let why =
                    format!("{id} has {}, but a hull has at most {}", ByteSize(size), ByteSize(max_bytes));
                return Err(StoreError::NotABlob(why));
            }
            // A blob that is deleted between opening and reading counts as deleted.
            self.present(found.bytes().await)
        })
    }

    fn size(&self, id: HullId) -> BoxFuture<'_, Result<Option<u64>, StoreError>> {
        Box::pin(async move { Ok(self.meta(&key(id)).await?.map(|meta| meta.size)) })
    }

    fn delete(&self, id: HullId) -> BoxFuture<'_, Result<(), StoreError>> {
        Box::pin(async move { self.present(self.objects.delete(&key(id)).await).map(|_| ()) })
    }

    fn shards(&self) -> BoxFuture<'_, Result<Vec<u8>, StoreError>> {
        Box::pin(async move {
            let found = self.objects.list_with_delimiter(None).await.map_err(store_error)?;
            let mut shards: Vec<_> =
                found.common_prefixes.iter().filter_map(|prefix| shard_of_name(prefix.as_ref())).collect();
            shards.sort_unstable();
            Ok(shards)
        })
    }

    fn list(
        &self,
        shard: u8,
        after: Option<HullId>,
        count: usize,
        max_bytes: u64,
    ) -> BoxFuture<'_, Result<Vec<StoredBlob>, StoreError>> {
        Box::pin(async move {
            let prefix = Path::from(shard_name(shard));
            let mut first = FirstById::new(count);
            let mut objects = self.objects.list(Some(&prefix));
            while let Some(meta) = objects.try_next().await.map_err(store_error)? {
                // Objects with other names are not hulls.
                let id = id_of_key(&meta.location).filter(|id| id.0[0] == shard);
                if let Some(id) = id.filter(|id| after.is_none_or(|after| *id > after))
                    && meta.size <= max_bytes
                {
                    let created_unix_ms = meta.last_modified.timestamp_millis();
                    first.offer(StoredBlob { id, created_unix_ms, bytes: meta.size });
                }
            }
            Ok(first.sorted())
        })
    }

    fn set_aside(&self, id: HullId, blob: Bytes) -> BoxFuture<'_, Result<String, StoreError>> {
        Box::pin(async move {
            let path = Path::from_iter(["quarantine", &quarantine_name(id, &blob)]);
            if self.meta(&path).await?.is_none() {
                self.objects.put(&path, PutPayload::from_bytes(blob)).await.map_err(store_error)?;
            }
            Ok(path.to_string())
        })
    }

    fn probe(&self) -> BoxFuture<'_, Result<(), StoreError>> {
        Box::pin(async move {
            // Each server on the store uses its own name.
            let path = Path::from(format!("probe-{}", std::process::id()));
            self.objects.put(&path, PutPayload::from_static(b"probe")).await.map_err(store_error)?;
            self.present(self.objects.delete(&path).await).map(|_| ())
        })
    }
}

/// Whether the text of an error, or of one of its causes, contains these words.
fn says(error: &dyn std::error::Error, words: &str) -> bool {
    error.to_string().contains(words) || error.source().is_some_and(|cause| says(cause, words))
}

fn store_error(error: object_store::Error) -> StoreError {
    use io::ErrorKind::{FileTooLarge, QuotaExceeded, StorageFull};
    let mut cause = error.source();
    while let Some(inner) = cause {
        if let Some(io) = inner.downcast_ref::<io::Error>()
            && matches!(io.kind(), StorageFull | QuotaExceeded | FileTooLarge)
        {
            return StoreError::Full(error.to_string());
        }
        cause = inner.source();
    }
    StoreError::Unavailable(error.to_string())
}
