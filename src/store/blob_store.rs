//! Stores of blobs that are named by the hash of their content.
//!
//! [`BlobStore`] is the interface that the registry needs. It has two implementations, and
//! [`blobs::open`](super::blobs::open) chooses one of them. `directory` keeps blobs as files and syncs
//! every write (the file and its directories) before it is acknowledged. `objects` keeps them through the
//! crate `object_store`, in an object store over the network (`remote`) or in memory, whose blobs are lost
//! at a restart.

use std::{collections::BinaryHeap, fmt, sync::Arc};

use bytes::Bytes;
use futures_util::future::BoxFuture;
use thiserror::Error;

use super::identity::{HullId, id_of};

/// How many operations of a bucket run at a time. Each has a connection.
pub(super) const OBJECTS_AT_A_TIME: u64 = 64;

/// The reason why an operation of the store failed.
#[derive(Clone, Debug, Error)]
pub enum StoreError {
    /// No room: the disk or the configured limit is full.
    #[error("the store is full: {0}")]
    Full(String),
    /// The store could not be read or written; trying again may help.
    #[error("the store is unavailable: {0}")]
    Unavailable(String),
    /// The store does not answer: an earlier operation has not returned in time.
    #[error("the store does not answer: {0}")]
    Hung(String),
    /// This caller waits for too many operations already; trying again may help.
    #[error("the store is busy: {0}")]
    Busy(String),
    /// There is an entry of this name that cannot be a blob: it is not a regular file, is too
    /// large, or may not be read. Its hull counts as missing; other hulls are not affected.
    #[error("the store's entry is not a blob: {0}")]
    NotABlob(String),
}

/// A blob, as a listing describes it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct StoredBlob {
    /// Its name.
    pub id: HullId,
    /// The time of the last write, in milliseconds since 1970 (UTC).
    pub created_unix_ms: i64,
    /// Its size in bytes.
    pub bytes: u64,
}

/// A durable map from id to bytes. Blobs whose ids share the first byte are one shard.
pub trait BlobStore: fmt::Debug + Send + Sync {
    /// Writes a blob, which is durable when this returns. An earlier blob of that name is replaced.
    fn put(&self, id: HullId, blob: Bytes) -> BoxFuture<'_, Result<(), StoreError>>;
    /// Reads a blob of at most `max_bytes`, or returns `None` if the store has no such blob.
    /// Whatever kind of entry has that name, at most one byte more is read.
    fn get(&self, id: HullId, max_bytes: u64) -> BoxFuture<'_, Result<Option<Bytes>, StoreError>>;
    /// The size of a blob in bytes, or `None` if the store has no such blob.
    fn size(&self, id: HullId) -> BoxFuture<'_, Result<Option<u64>, StoreError>>;
    /// Removes a blob. Succeeds too if the store has no such blob.
    fn delete(&self, id: HullId) -> BoxFuture<'_, Result<(), StoreError>>;
    /// The shards that may have blobs, in order.
    fn shards(&self) -> BoxFuture<'_, Result<Vec<u8>, StoreError>>;
    /// The first `count` blobs of a shard, by id, that come after `after` and have at most
    /// `max_bytes`; fewer only if there are no more.
    fn list(
        &self,
        shard: u8,
        after: Option<HullId>,
        count: usize,
        max_bytes: u64,
    ) -> BoxFuture<'_, Result<Vec<StoredBlob>, StoreError>>;
    /// Keeps a copy of `blob`, which was found under the name of `id` but is not that hull. Returns
    /// the copy's place.
    fn set_aside(&self, id: HullId, blob: Bytes) -> BoxFuture<'_, Result<String, StoreError>>;
    /// Writes and removes a small object, to test whether the store can be written to.
    fn probe(&self) -> BoxFuture<'_, Result<(), StoreError>>;
    /// How many operations the store runs at a time.
    fn operations_at_a_time(&self) -> u64 {
        OBJECTS_AT_A_TIME
    }
}

/// The first `count` blobs of a store, by id, that come after `after` and have at most
/// `max_bytes`; fewer only if there are no more. One shard is listed at a time.
///
/// # Errors
/// The store could not be listed.
pub async fn list(
    store: &dyn BlobStore,
    after: Option<HullId>,
    count: usize,
    max_bytes: u64,
) -> Result<Vec<StoredBlob>, StoreError> {
    let mut blobs = Vec::new();
    for shard in store.shards().await? {
        if blobs.len() >= count {
            break;
        }
        if after.is_none_or(|after| shard >= after.0[0]) {
            blobs.extend(store.list(shard, after, count - blobs.len(), max_bytes).await?);
        }
    }
    Ok(blobs)
}

/// An open store.
pub type SharedBlobStore = Arc<dyn BlobStore>;

/// The name of a shard's directory.
pub(super) fn shard_name(shard: u8) -> String {
    format!("{shard:02x}")
}

/// The shard of a directory, or `None` if the name is not a shard's.
pub(super) fn shard_of_name(name: &str) -> Option<u8> {
    let shard = u8::from_str_radix(name, 16).ok()?;
    (name == shard_name(shard)).then_some(shard)
}

/// The name for a copy of bytes that were found in place of the blob of `id`. It contains both
/// hashes, so that equal bytes are kept once, however often they are found.
pub(super) fn quarantine_name(id: HullId, found: &[u8]) -> String {
    let content = id_of(found).to_string();
    format!("{id}-{}", &content[..16])
}

/// Keeps the first `count` of the offered items, in their order.
pub(super) struct FirstById<T> {
    count: usize,
    first: BinaryHeap<T>,
}

impl<T: Ord> FirstById<T> {
    pub(super) fn new(count: usize) -> Self {
        Self { count, first: BinaryHeap::new() }
    }

    pub(super) fn offer(&mut self, item: T) {
        if self.first.len() < self.count {
            self.first.push(item);
        } else if let Some(mut last) = self.first.peek_mut()
            && item < *last
        {
            *last = item;
        }
    }

    pub(super) fn sorted(self) -> Vec<T> {
        self.first.into_sorted_vec()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Catches a listing that drops one of the first items, keeps a later one, or sorts them
    /// wrongly.
    #[test]
    fn the_first_items_are_kept_in_order() {
        let numbers: Vec<u32> = (0..500).map(|i| (i * 263) % 499).collect();
        let mut sorted = numbers.clone();
        sorted.sort_unstable();
        for count in [0, 1, 7, 499, 500, 1000] {
            let mut first = FirstById::new(count);
            numbers.iter().for_each(|&number| first.offer(number));
            assert_eq!(first.sorted(), sorted[..count.min(500)]);
        }
    }

    /// Catches a directory that is not a shard and is mistaken for one.
    #[test]
    fn shards_are_two_lower_case_digits() {
        assert!((0..=255).all(|shard| shard_of_name(&shard_name(shard)) == Some(shard)));
        for name in ["", "a", "AB", "+a", "0ab", "g0", "quarantine"] {
            assert_eq!(shard_of_name(name), None, "{name}");
        }
    }
}
