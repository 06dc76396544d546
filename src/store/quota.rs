//! Limits the total bytes of the store, if a limit is configured.

use std::sync::Arc;

use bytes::Bytes;
use tokio::sync::Mutex;

use super::{BlobStore, HullId, StoreError, blob_store::list, fair_slots::FairSlots};
use crate::{budget::Caller, size::ByteSize};

/// Writes blobs within a limit of bytes.
#[derive(Debug)]
pub(super) struct Quota {
    /// The limit in bytes; 0 means no limit.
    limit: u64,
    max_blob_bytes: u64,
    /// Lets one write run at a time, and callers take turns.
    slots: Arc<FairSlots>,
    /// The bytes in the store. They are counted when first needed, never at the start.
    used: Mutex<Option<u64>>,
}

impl Quota {
    /// Blobs of more than `max_blob_bytes` are not hulls and do not count. `shares` says whether
    /// callers share the places of waiting writes.
    pub(super) fn new(limit: u64, max_blob_bytes: u64, shares: bool) -> Self {
        let slots = FairSlots::new(1, MOST_WAITING, shares);
        Self { limit, max_blob_bytes, slots, used: Mutex::new(None) }
    }

    /// Writes a blob if it fits within the limit.
    pub(super) async fn put(
        &self,
        blobs: &dyn BlobStore,
        caller: &Caller,
        id: HullId,
        blob: Bytes,
    ) -> Result<(), StoreError> {
        if self.limit == 0 {
            return blobs.put(id, blob).await;
        }
        let _slot = self
            .slots
            .take(caller)
            .await
            .map_err(|_| StoreError::Busy("too many writes of this caller are waiting".into()))?;
        let mut used = self.used.lock().await;
        let before = match *used {
            Some(bytes) => bytes,
            None => count(blobs, self.max_blob_bytes).await?,
        };
        let replaced = blobs.size(id).await?.unwrap_or(0);
        let after = before.saturating_sub(replaced) + blob.len() as u64;
        if after > self.limit {
            *used = Some(before);
            let why = format!(
                "it would have {}, at most {} are allowed: delete hulls",
                ByteSize(after),
                ByteSize(self.limit)
            );
            return Err(StoreError::Full(why));
        }
        // The lock is held, so two writers cannot both use the last room. A write that fails or is
        // abandoned leaves the count unknown.
        *used = None;
        blobs.put(id, blob).await?;
        *used = Some(after);
        Ok(())
    }

    /// Subtracts the bytes of a deleted blob.
    pub(super) async fn freed(&self, bytes: u64) {
        if let Some(used) = self.used.lock().await.as_mut() {
            *used = used.saturating_sub(bytes);
        }
    }
}

/// The most writes that may wait, over all requests.
const MOST_WAITING: u64 = 4096;

/// Blobs per page of the listing that counts them.
const PAGE: usize = 10_000;

/// The total bytes of all blobs.
async fn count(blobs: &dyn BlobStore, max_blob_bytes: u64) -> Result<u64, StoreError> {
    let (mut bytes, mut after) = (0, None);
    loop {
        let listed = list(blobs, after, PAGE, max_blob_bytes).await?;
        let Some(last) = listed.last() else { return Ok(bytes) };
        after = Some(last.id);
        bytes += listed.iter().map(|blob| blob.bytes).sum::<u64>();
    }
}
