//! Opens a store of blobs by its URL.

use std::{path::Path, sync::Arc};

use object_store::memory::InMemory;
use thiserror::Error;

#[cfg(not(feature = "remote"))]
use super::objects::OpenedBucket;
#[cfg(feature = "remote")]
use super::remote::open as remote;
use super::{
    blob_store::{OBJECTS_AT_A_TIME, SharedBlobStore},
    directory::{DirectoryStore, THREADS},
    file_threads::FileThreads,
    objects::ObjectBlobStore,
};

pub use super::blob_store::list;

/// The reason why a `--store` could not be opened.
#[derive(Debug, Error)]
pub enum StoreOpenError {
    /// The text names the store and the reason.
    #[error("{0}")]
    Store(String),
    /// The system does not start the store's threads; its reason.
    #[error("threads of the store: {0}")]
    Threads(String),
}

/// Opens a store: a directory (a plain path or `file://`), which is created if it is missing;
/// `memory://`, whose hulls are lost at a restart; or, with the feature of its provider, a bucket:
/// `s3://`, `gs://` or `az://` followed by its name and an optional prefix.
///
/// # Errors
/// The directory cannot be created or is not a directory, or this build does not support the
/// scheme. Whether a bucket can be reached is not tested.
pub fn open(url: &str) -> Result<SharedBlobStore, StoreOpenError> {
    refuse_half_a_scheme(url)?;
    match url.split_once("://") {
        Some(("memory", _)) => Ok(Arc::new(ObjectBlobStore::new(Arc::new(InMemory::new()), None))),
        Some((scheme, _)) if scheme != "file" => match remote(scheme, url) {
            Some(opened) => {
                let (objects, absent) = opened.map_err(|e| failed(url, &e))?;
                Ok(Arc::new(ObjectBlobStore::new(objects, Some(absent))))
            }
            None => Err(unknown_scheme(url, scheme)),
        },
        _ => {
            let path = url.strip_prefix("file://").unwrap_or(url);
            let threads =
                FileThreads::start(THREADS).map_err(|error| StoreOpenError::Threads(error.to_string()))?;
            let store = DirectoryStore::open(path.as_ref(), threads).map_err(|error| failed(url, &error))?;
            Ok(Arc::new(store))
        }
    }
}

/// The most file descriptors that the store at `url` has open at a time.
pub fn descriptors(url: &str) -> u64 {
    match url.split_once("://") {
        Some(("memory", _)) => 0,
        Some((scheme, _)) if scheme != "file" => OBJECTS_AT_A_TIME,
        // The root, a shard, and a file or a listing.
        _ => 3 * THREADS as u64,
    }
}

/// Opens a store as [`open`] does, but does not create a directory.
///
/// # Errors
/// The errors of [`open`], or that the directory does not exist.
pub fn open_existing(url: &str) -> Result<SharedBlobStore, StoreOpenError> {
    if url.starts_with("memory://") {
        return Err(StoreOpenError::Store(format!(
            "store {url}: each process has its own memory, so this store is empty; expected the directory or \
             the bucket that a server uses"
        )));
    }
    refuse_half_a_scheme(url)?;
    let path = url.strip_prefix("file://").unwrap_or(url);
    if !path.contains("://") && !Path::new(path).is_dir() {
        return Err(StoreOpenError::Store(format!("store {url}: no such directory")));
    }
    open(url)
}

/// Refuses `memory:` and its like. They would be directories of that name, which nobody means.
fn refuse_half_a_scheme(url: &str) -> Result<(), StoreOpenError> {
    match url.split_once(':') {
        Some((scheme @ ("file" | "memory" | "s3" | "gs" | "az"), rest)) if !rest.starts_with("//") => {
            Err(StoreOpenError::Store(format!(
                "store {url}: a scheme ends with ://, expected {scheme}://; a directory of this name is ./{url}"
            )))
        }
        _ => Ok(()),
    }
}

#[cfg(not(feature = "remote"))]
fn remote(_: &str, _: &str) -> Option<object_store::Result<OpenedBucket>> {
    None
}

fn unknown_scheme(url: &str, scheme: &str) -> StoreOpenError {
    let feature = match scheme {
        "s3" => "s3",
        "gs" => "gcs",
        "az" => "azure",
        _ => {
            return StoreOpenError::Store(format!(
                "store {url}: unknown scheme {scheme}://; a directory, file://, memory://, s3://, gs:// and az:// are known"
            ));
        }
    };
    StoreOpenError::Store(format!(
        "store {url}: this build does not support it; build hullcast with the feature \"{feature}\""
    ))
}

fn failed(url: &str, error: &dyn std::error::Error) -> StoreOpenError {
    StoreOpenError::Store(format!("store {url}: {error}"))
}
