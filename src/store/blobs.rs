//! Keeps blobs by the hash of their content.
//!
//! [`BlobStore`] is all that the registry asks of a store; [`Objects`] is the
//! one implementation, over the `object_store` crate: a local directory with
//! every write synced (file and directories) before it is acknowledged, an object
//! store (`remote`), or memory, which forgets.

use std::{
    error::Error as _,
    fmt, io,
    path::{Path as FsPath, PathBuf},
    sync::Arc,
};

use bytes::Bytes;
use futures_util::{TryStreamExt, future::BoxFuture};
use object_store::{
    ObjectMeta, ObjectStore, ObjectStoreExt, PutPayload, local::LocalFileSystem, memory::InMemory, path::Path,
};

use super::{HullId, identity::id_of};

/// Why the store did not do what was asked.
#[derive(Debug)]
pub enum StoreError {
    /// No room: the disk or the configured limit.
    Full(String),
    /// It could not be read or written; trying again may help.
    Unavailable(String),
}

impl fmt::Display for StoreError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Full(why) => write!(f, "the store is full: {why}"),
            Self::Unavailable(why) => write!(f, "the store is unavailable: {why}"),
        }
    }
}

impl std::error::Error for StoreError {}

/// A blob, as listed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StoredBlob {
    /// Its name.
    pub id: HullId,
    /// When it was last written, milliseconds since 1970 (UTC).
    pub created_unix_ms: i64,
    /// Its size.
    pub bytes: u64,
}

/// A durable map from id to bytes.
pub trait BlobStore: fmt::Debug + Send + Sync {
    /// Writes a blob; durable when it returns. An earlier one of that name is replaced.
    fn put(&self, id: HullId, blob: Bytes) -> BoxFuture<'_, Result<(), StoreError>>;
    /// Reads a blob; none when there is no such.
    fn get(&self, id: HullId) -> BoxFuture<'_, Result<Option<Bytes>, StoreError>>;
    /// A blob's size; none when there is no such.
    fn size(&self, id: HullId) -> BoxFuture<'_, Result<Option<u64>, StoreError>>;
    /// Removes a blob; none to remove is no error.
    fn delete(&self, id: HullId) -> BoxFuture<'_, Result<(), StoreError>>;
    /// At least `count` blobs, if there are, after `after`, by id; never a part of the
    /// blobs that share a first byte.
    fn list(&self, after: Option<HullId>, count: usize)
    -> BoxFuture<'_, Result<Vec<StoredBlob>, StoreError>>;
    /// Keeps `blob`, found under the name of `id` and not that hull, out of the way; where.
    fn set_aside(&self, id: HullId, blob: Bytes) -> BoxFuture<'_, Result<String, StoreError>>;
    /// Writes and removes something, to see whether it can.
    fn probe(&self) -> BoxFuture<'_, Result<(), StoreError>>;
}

/// Why a `--store` could not be opened.
#[derive(Debug)]
pub struct OpenError(String);

impl fmt::Display for OpenError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for OpenError {}

/// An opened store.
pub type Opened = Arc<dyn BlobStore>;

/// Opens a directory (a plain path or `file://`), created where it is missing, or
/// `memory://`, which keeps nothing over a restart, or by feature a bucket: `s3://`, `gs://`
/// or `az://` with its name and perhaps a prefix.
///
/// # Errors
/// The directory cannot be made or is not one, or the scheme is not of this build. Whether a
/// bucket can be reached is not asked.
pub fn open(url: &str) -> Result<Opened, OpenError> {
    let (objects, root, absent): (Arc<dyn ObjectStore>, _, _) = match url.split_once("://") {
        Some(("memory", _)) => (Arc::new(InMemory::new()), None, None),
        Some((scheme, _)) if scheme != "file" => match remote(scheme, url) {
            Some(opened) => {
                let (objects, absent) = opened.map_err(|e| failed(url, &e))?;
                (objects, None, Some(absent))
            }
            None => return Err(unknown_scheme(url, scheme)),
        },
        _ => {
            let path = url.strip_prefix("file://").unwrap_or(url);
            let (objects, root) = directory(path.as_ref()).map_err(|e| failed(url, &e))?;
            (Arc::new(objects), Some(root), None)
        }
    };
    Ok(Arc::new(Objects { objects, root, absent }))
}

/// The same, of a directory that is there already.
///
/// # Errors
/// As [`open`]; there is no such directory.
pub fn open_existing(url: &str) -> Result<Opened, OpenError> {
    let path = url.strip_prefix("file://").unwrap_or(url);
    if !path.contains("://") && !FsPath::new(path).is_dir() {
        return Err(OpenError(format!("store {url}: no such directory")));
    }
    open(url)
}

/// A store over the network, and what its answers say where an object is missing.
pub(super) type Remote = (Arc<dyn ObjectStore>, &'static str);

#[cfg(feature = "remote")]
use super::remote::open as remote;

#[cfg(not(feature = "remote"))]
fn remote(_: &str, _: &str) -> Option<object_store::Result<Remote>> {
    None
}

fn unknown_scheme(url: &str, scheme: &str) -> OpenError {
    let feature = match scheme {
        "s3" => "s3",
        "gs" => "gcs",
        "az" => "azure",
        _ => {
            return OpenError(format!(
                "store {url}: unknown scheme {scheme}://; a directory, file://, memory://, s3://, gs:// and az:// are known"
            ));
        }
    };
    OpenError(format!("store {url}: needs the feature \"{feature}\", which this build is without"))
}

fn failed(url: &str, error: &dyn std::error::Error) -> OpenError {
    OpenError(format!("store {url}: {error}"))
}

/// The store in a directory, and the directory's own path.
fn directory(path: &FsPath) -> io::Result<(LocalFileSystem, PathBuf)> {
    std::fs::create_dir_all(path)?;
    let store = LocalFileSystem::new_with_prefix(path).map_err(io::Error::other)?.with_fsync(true);
    // Makes durable what a killed server made here and did not come to sync: the
    // directory's own entry, and those of the shards in it.
    let path = path.canonicalize()?;
    std::fs::File::open(&path)?.sync_all()?;
    if let Some(parent) = path.parent() {
        // A parent that may not be opened is not one that was just made.
        let _ = std::fs::File::open(parent).and_then(|parent| parent.sync_all());
    }
    Ok((store, path))
}

/// Blobs as objects, sharded by the first byte of their id: no directory of a million files.
#[derive(Debug)]
struct Objects {
    objects: Arc<dyn ObjectStore>,
    /// Of a directory.
    root: Option<PathBuf>,
    /// What an answer has to say for an object to be missing, where a missing bucket, an
    /// outage of all hulls, has the same status; none: the status is enough.
    absent: Option<&'static str>,
}

impl Objects {
    /// A directory that is gone has nothing and takes everything: neither is what it says.
    async fn still_there(&self) -> Result<(), StoreError> {
        let Some(root) = &self.root else { return Ok(()) };
        match tokio::fs::try_exists(root).await {
            Ok(true) => Ok(()),
            Ok(false) => Err(StoreError::Unavailable(format!("{} is gone", root.display()))),
            Err(error) => Err(StoreError::Unavailable(format!("{}: {error}", root.display()))),
        }
    }

    /// Not found is no error, where it is the object that was not found.
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

    /// What is known of an object; none where there is no such.
    async fn meta(&self, path: &Path) -> Result<Option<ObjectMeta>, StoreError> {
        let mut found = self.objects.head(path).await;
        if self.absent.is_some() && matches!(found, Err(object_store::Error::NotFound { .. })) {
            // An answer without a body cannot say what is missing; a read's does.
            found = self.objects.get(path).await.map(|found| found.meta);
        }
        self.present(found)
    }
}

/// `ab/ab12…`: the whole id is the name, so that a file can be checked where it lies.
fn key(id: HullId) -> Path {
    let name = id.to_string();
    Path::from_iter([&name[..2], &name])
}

fn id_of_key(key: &Path) -> Option<HullId> {
    key.filename()?.parse().ok()
}

impl BlobStore for Objects {
    fn put(&self, id: HullId, blob: Bytes) -> BoxFuture<'_, Result<(), StoreError>> {
        Box::pin(async move {
            self.still_there().await?;
            let written = self.objects.put(&key(id), PutPayload::from_bytes(blob)).await;
            written.map(|_| ()).map_err(store_error)
        })
    }

    fn get(&self, id: HullId) -> BoxFuture<'_, Result<Option<Bytes>, StoreError>> {
        Box::pin(async move {
            let Some(found) = self.present(self.objects.get(&key(id)).await)? else {
                return self.still_there().await.map(|()| None);
            };
            // Deleted between opening and reading is deleted.
            self.present(found.bytes().await)
        })
    }

    fn size(&self, id: HullId) -> BoxFuture<'_, Result<Option<u64>, StoreError>> {
        Box::pin(async move {
            match self.meta(&key(id)).await? {
                Some(meta) => Ok(Some(meta.size)),
                None => self.still_there().await.map(|()| None),
            }
        })
    }

    fn delete(&self, id: HullId) -> BoxFuture<'_, Result<(), StoreError>> {
        Box::pin(async move { self.present(self.objects.delete(&key(id)).await).map(|_| ()) })
    }

    fn list(
        &self,
        after: Option<HullId>,
        count: usize,
    ) -> BoxFuture<'_, Result<Vec<StoredBlob>, StoreError>> {
        Box::pin(async move {
            let mut shards =
                self.objects.list_with_delimiter(None).await.map_err(store_error)?.common_prefixes;
            shards.sort();
            let first = after.map(|id| format!("{:02x}", id.0[0]));
            let mut blobs: Vec<StoredBlob> = Vec::new();
            for shard in shards {
                if first.as_ref().is_some_and(|first| shard.as_ref() < first.as_str()) {
                    continue;
                }
                if blobs.len() >= count {
                    break;
                }
                // What was set aside is not ours to list.
                if shard.as_ref().len() != 2 {
                    continue;
                }
                let start = blobs.len();
                let mut objects = self.objects.list(Some(&shard));
                while let Some(meta) = objects.try_next().await.map_err(store_error)? {
                    // What is not a hull's name is not ours to list.
                    let Some(id) =
                        id_of_key(&meta.location).filter(|id| after.is_none_or(|after| *id > after))
                    else {
                        continue;
                    };
                    let created_unix_ms = meta.last_modified.timestamp_millis();
                    blobs.push(StoredBlob { id, created_unix_ms, bytes: meta.size });
                }
                blobs[start..].sort_unstable_by_key(|blob| blob.id);
            }
            Ok(blobs)
        })
    }

    fn set_aside(&self, id: HullId, blob: Bytes) -> BoxFuture<'_, Result<String, StoreError>> {
        Box::pin(async move {
            // Named by both hashes: found again and again it is kept once.
            let content = id_of(&blob).to_string();
            let path = Path::from_iter(["quarantine", &format!("{id}-{}", &content[..16])]);
            if self.meta(&path).await?.is_none() {
                self.objects.put(&path, PutPayload::from_bytes(blob)).await.map_err(store_error)?;
            }
            Ok(path.to_string())
        })
    }

    fn probe(&self) -> BoxFuture<'_, Result<(), StoreError>> {
        Box::pin(async move {
            self.still_there().await?;
            // A name of its own for each server on the store.
            let path = Path::from(format!("probe-{}", std::process::id()));
            self.objects.put(&path, PutPayload::from_static(b"probe")).await.map_err(store_error)?;
            self.present(self.objects.delete(&path).await).map(|_| ())
        })
    }
}

/// Whether an error, or what caused it, has these words.
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
