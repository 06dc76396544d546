//! Blobs as files in a local directory that is not trusted.
//!
//! Any kind of entry may have a blob's name: a file of several gigabytes, a FIFO, a device, a
//! symbolic link to a system file. Therefore every file is opened relative to the descriptor of its
//! directory, without following links and without blocking, and is examined through its own
//! descriptor before it is read: it must be a regular file within the size limit. At most one byte
//! past the limit is read, so a file that grows meanwhile is refused too. An entry that fails these
//! tests affects only its own hull ([`StoreError::NotABlob`]).
//!
//! The path of a blob is `ab/ab12…`: the id in hexadecimal, in a directory named by its first two
//! digits. The directory `quarantine/` lies beside these. A blob is written to `ab/ab12…#N`, synced
//! and renamed into place; then its directory is synced (docs/durability.md).

mod root;

use std::{io, path::Path, sync::Arc};

use bytes::Bytes;
use futures_util::future::BoxFuture;
use root::Root;

use super::{BlobStore, HullId, StoreError, StoredBlob, file_threads::FileThreads};

/// How many operations run at a time. One caller may have half of them, which is as many as one
/// request starts at a time, so that the file system can gather the syncs of a whole request.
const AT_A_TIME: usize = 32;

/// One thread more than `AT_A_TIME`, so that a probe never waits behind other operations.
pub(super) const THREADS: usize = AT_A_TIME + 1;

/// Blobs in a directory.
#[derive(Debug)]
pub(super) struct DirectoryStore {
    root: Arc<Root>,
    threads: FileThreads,
}

impl DirectoryStore {
    /// Opens the directory at `path`, which is created if it is missing.
    ///
    /// # Errors
    /// The path cannot be created or is not a directory.
    pub(super) fn open(path: &Path, threads: FileThreads) -> io::Result<Self> {
        Ok(Self { root: Arc::new(Root::open(path)?), threads })
    }

    fn run<T: Send + 'static>(
        &self,
        operation: impl FnOnce(&Root) -> Result<T, StoreError> + Send + 'static,
    ) -> BoxFuture<'_, Result<T, StoreError>> {
        let root = self.root.clone();
        Box::pin(async move {
            let done = self.threads.run(move || operation(&root)).await;
            done.unwrap_or_else(|why| Err(StoreError::Unavailable(why)))
        })
    }
}

impl BlobStore for DirectoryStore {
    fn put(&self, id: HullId, blob: Bytes) -> BoxFuture<'_, Result<(), StoreError>> {
        self.run(move |root| root.put(id, &blob))
    }

    fn get(&self, id: HullId, max_bytes: u64) -> BoxFuture<'_, Result<Option<Bytes>, StoreError>> {
        self.run(move |root| root.get(id, max_bytes))
    }

    fn size(&self, id: HullId) -> BoxFuture<'_, Result<Option<u64>, StoreError>> {
        self.run(move |root| root.size(id))
    }

    fn delete(&self, id: HullId) -> BoxFuture<'_, Result<(), StoreError>> {
        self.run(move |root| root.delete(id))
    }

    fn shards(&self) -> BoxFuture<'_, Result<Vec<u8>, StoreError>> {
        self.run(Root::shards)
    }

    fn list(
        &self,
        shard: u8,
        after: Option<HullId>,
        count: usize,
        max_bytes: u64,
    ) -> BoxFuture<'_, Result<Vec<StoredBlob>, StoreError>> {
        self.run(move |root| root.list(shard, after, count, max_bytes))
    }

    fn set_aside(&self, id: HullId, blob: Bytes) -> BoxFuture<'_, Result<String, StoreError>> {
        self.run(move |root| root.set_aside(id, &blob))
    }

    fn probe(&self) -> BoxFuture<'_, Result<(), StoreError>> {
        self.run(Root::probe)
    }

    fn operations_at_a_time(&self) -> u64 {
        AT_A_TIME as u64
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::blob_store;

    /// Catches a page that misses or repeats a blob, is out of order or too long, or ends early
    /// because some entries are not blobs.
    #[tokio::test]
    async fn pages_have_all_blobs_in_order() {
        let directory = tempfile::tempdir().unwrap();
        let store = DirectoryStore::open(directory.path(), FileThreads::start(1).unwrap()).unwrap();
        let mut sizes = Vec::new();
        for i in 0..600_u64 {
            let id = HullId(std::array::from_fn(|byte| match byte {
                0 => [0, 7, 7, 255][i as usize % 4],
                byte => (i.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> (8 * (byte % 8))) as u8,
            }));
            let (name, bytes) = (id.to_string(), i % 3);
            let shard = directory.path().join(&name[..2]);
            std::fs::create_dir_all(&shard).unwrap();
            if i % 5 == 0 {
                std::fs::create_dir(shard.join(&name)).unwrap();
            } else {
                std::fs::write(shard.join(&name), vec![0; bytes as usize]).unwrap();
                sizes.push((id, bytes));
            }
        }
        std::fs::write(directory.path().join("07/temporary#1"), "").unwrap();
        std::fs::write(directory.path().join("0b"), "not a shard").unwrap();
        sizes.sort_unstable();
        for (page, max_bytes) in [(1, 2), (7, 2), (100, 2), (1000, 2), (7, 1), (1000, 0)] {
            let wanted: Vec<_> = sizes.iter().filter(|(_, bytes)| *bytes <= max_bytes).collect();
            assert!(wanted.len() > 100);
            let (mut found, mut after) = (Vec::new(), None);
            loop {
                let blobs = blob_store::list(&store, after, page, max_bytes).await.unwrap();
                assert!(blobs.len() <= page);
                after = blobs.last().map(|blob| blob.id);
                let is_last = blobs.len() < page;
                found.extend(blobs.into_iter().map(|blob| (blob.id, blob.bytes)));
                if is_last {
                    break;
                }
            }
            assert!(found.iter().eq(wanted), "pages of {page}");
        }
    }
}
