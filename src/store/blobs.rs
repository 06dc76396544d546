//! Opens a store of blobs by its URL.

use std::{fmt, path::Path, sync::Arc};

use object_store::memory::InMemory;

#[cfg(not(feature = "remote"))]
use super::objects::Remote;
#[cfg(feature = "remote")]
use super::remote::open as remote;
use super::{blob_store::Opened, directory::DirectoryStore, objects::Objects};

pub use super::blob_store::list;

/// Why a `--store` could not be opened.
#[derive(Debug)]
pub struct OpenError(String);

impl fmt::Display for OpenError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for OpenError {}

/// Opens a store: a directory (a plain path or `file://`), which is created if it is missing;
/// `memory://`, which keeps nothing over a restart; or, with the feature of its provider, a bucket:
/// `s3://`, `gs://` or `az://` followed by its name and an optional prefix.
///
/// # Errors
/// The directory cannot be created or is not a directory, or this build does not support the
/// scheme. Whether a bucket can be reached is not tested.
pub fn open(url: &str) -> Result<Opened, OpenError> {
    match url.split_once("://") {
        Some(("memory", _)) => Ok(Arc::new(Objects::new(Arc::new(InMemory::new()), None))),
        Some((scheme, _)) if scheme != "file" => match remote(scheme, url) {
            Some(opened) => {
                let (objects, absent) = opened.map_err(|e| failed(url, &e))?;
                Ok(Arc::new(Objects::new(objects, Some(absent))))
            }
            None => Err(unknown_scheme(url, scheme)),
        },
        _ => {
            let path = url.strip_prefix("file://").unwrap_or(url);
            Ok(Arc::new(DirectoryStore::open(path.as_ref()).map_err(|e| failed(url, &e))?))
        }
    }
}

/// Opens a store as [`open`] does, but does not create a directory.
///
/// # Errors
/// Those of [`open`]; the directory does not exist.
pub fn open_existing(url: &str) -> Result<Opened, OpenError> {
    let path = url.strip_prefix("file://").unwrap_or(url);
    if !path.contains("://") && !Path::new(path).is_dir() {
        return Err(OpenError(format!("store {url}: no such directory")));
    }
    open(url)
}

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
    OpenError(format!(
        "store {url}: this build does not support it; build hullcast with the feature \"{feature}\""
    ))
}

fn failed(url: &str, error: &dyn std::error::Error) -> OpenError {
    OpenError(format!("store {url}: {error}"))
}
