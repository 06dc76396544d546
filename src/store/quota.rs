//! How many bytes the store may have, where they are bounded.

use bytes::Bytes;
use tokio::sync::Mutex;

use super::{BlobStore, HullId, StoreError};

/// Blobs are written through it, so that they stay within a limit.
#[derive(Debug)]
pub(super) struct Quota {
    /// 0: unbounded.
    limit: u64,
    /// Bytes in the store: counted when first needed, never at start.
    used: Mutex<Option<u64>>,
}

impl Quota {
    pub(super) fn new(limit: u64) -> Self {
        Self { limit, used: Mutex::new(None) }
    }

    /// Writes a blob, if there is room.
    pub(super) async fn put(&self, blobs: &dyn BlobStore, id: HullId, blob: Bytes) -> Result<(), StoreError> {
        if self.limit == 0 {
            return blobs.put(id, blob).await;
        }
        let mut used = self.used.lock().await;
        let before = match *used {
            Some(bytes) => bytes,
            None => count(blobs).await?,
        };
        let replaced = blobs.size(id).await?.unwrap_or(0);
        let after = before.saturating_sub(replaced) + blob.len() as u64;
        if after > self.limit {
            *used = Some(before);
            let why = format!("{after} bytes would pass the limit of {}", self.limit);
            return Err(StoreError::Full(why));
        }
        // Under the lock: two writers of the last room do not both find it. A write that
        // fails or is abandoned leaves the count unknown.
        *used = None;
        blobs.put(id, blob).await?;
        *used = Some(after);
        Ok(())
    }

    /// A blob of so many bytes was deleted.
    pub(super) async fn freed(&self, bytes: u64) {
        if let Some(used) = self.used.lock().await.as_mut() {
            *used = used.saturating_sub(bytes);
        }
    }
}

/// Bytes of all blobs.
async fn count(blobs: &dyn BlobStore) -> Result<u64, StoreError> {
    let (mut bytes, mut after) = (0, None);
    loop {
        let listed = blobs.list(after, 1).await?;
        let Some(last) = listed.last() else { return Ok(bytes) };
        after = Some(last.id);
        bytes += listed.iter().map(|blob| blob.bytes).sum::<u64>();
    }
}
