//! Values that are read from files, and read again when the files change.

use std::{
    fmt,
    path::{Path, PathBuf},
    sync::{Arc, Mutex, PoisonError, RwLock},
};

use sha2::{Digest, Sha256};
use thiserror::Error;

use crate::{lock::locked, small_file};

/// A file that a setting names.
#[derive(Clone, Debug)]
pub(super) struct SettingFile {
    setting: &'static str,
    path: PathBuf,
}

impl SettingFile {
    pub(super) fn new(setting: &'static str, path: &Path) -> Self {
        Self { setting, path: path.to_owned() }
    }

    pub(super) fn path(&self) -> &Path {
        &self.path
    }
}

impl fmt::Display for SettingFile {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} {}", self.setting, self.path.display())
    }
}

/// The reason why files were refused.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum LoadError {
    /// The setting is empty, although another setting needs its file.
    #[error(
        "{setting} is missing: TLS needs tls_certificate and tls_key; tls_client_ca works only with both"
    )]
    Missing {
        /// The name of a field of `SecurityFiles`.
        setting: &'static str,
    },
    /// A file cannot be read or used.
    #[error("{setting} {}: {why}", .path.display())]
    File {
        /// The setting that names the file: a field of `SecurityFiles`.
        setting: &'static str,
        /// The file.
        path: PathBuf,
        /// The fault of the file, for display.
        why: String,
    },
}

impl LoadError {
    pub(super) fn new(file: &SettingFile, why: impl fmt::Display) -> Self {
        Self::File { setting: file.setting, path: file.path.clone(), why: why.to_string() }
    }
}

/// The contents of files, in the order of the files.
pub(super) type Contents<'a> = Vec<(&'a SettingFile, Vec<u8>)>;

/// Makes a value from the contents of the files.
type Parse<T> = fn(&[(&SettingFile, Vec<u8>)]) -> Result<T, LoadError>;

/// A value made from files.
#[derive(Debug)]
pub(super) struct Reloaded<T> {
    files: Vec<SettingFile>,
    parse: Parse<T>,
    current: RwLock<Current<T>>,
    /// The fault that was logged last, or `None` if the files could be used.
    fault: Mutex<Option<LoadError>>,
}

#[derive(Debug)]
struct Current<T> {
    value: Arc<T>,
    /// The digest of all contents. Modification times are not reliable, especially behind links.
    digest: [u8; 32],
}

impl<T> Reloaded<T> {
    /// # Errors
    /// A file cannot be read, or `parse` refuses it.
    pub(super) fn open(files: Vec<SettingFile>, parse: Parse<T>) -> Result<Self, LoadError> {
        let contents = read(&files)?;
        let value = Arc::new(parse(&contents)?);
        let current = RwLock::new(Current { value, digest: digest(&contents) });
        Ok(Self { files, parse, current, fault: Mutex::default() })
    }

    pub(super) fn get(&self) -> Arc<T> {
        self.current.read().unwrap_or_else(PoisonError::into_inner).value.clone()
    }

    /// Reads the files again and replaces the value, if they have changed and can be used. Logs a
    /// fault of the files once, however often they are read meanwhile.
    pub(super) fn reload(&self) {
        let seen = self.current.read().unwrap_or_else(PoisonError::into_inner).digest;
        let changed = read(&self.files).and_then(|contents| {
            let digest = digest(&contents);
            if digest == seen {
                return Ok(None);
            }
            let value = Arc::new((self.parse)(&contents)?);
            Ok(Some(Current { value, digest }))
        });
        let mut fault = locked(&self.fault);
        match changed {
            Ok(None) => {
                if fault.take().is_some() {
                    tracing::info!(files = %self.names(), "can be used again");
                }
            }
            Ok(Some(current)) => {
                *self.current.write().unwrap_or_else(PoisonError::into_inner) = current;
                *fault = None;
                tracing::info!(files = %self.names(), "certificates or tokens were read again");
            }
            Err(error) if fault.as_ref() == Some(&error) => {}
            Err(error) => {
                tracing::error!(%error, "a file of certificates or tokens cannot be used; the values that were read before stay in use");
                *fault = Some(error);
            }
        }
    }

    fn names(&self) -> String {
        self.files.iter().map(ToString::to_string).collect::<Vec<_>>().join(", ")
    }
}

fn read(files: &[SettingFile]) -> Result<Contents<'_>, LoadError> {
    let read = |file: &SettingFile| {
        small_file::read(&file.path).map_err(|error| LoadError::new(file, format!("cannot be read: {error}")))
    };
    files.iter().map(|file| Ok((file, read(file)?))).collect()
}

fn digest(contents: &[(&SettingFile, Vec<u8>)]) -> [u8; 32] {
    let mut all = Sha256::new();
    for (_, bytes) in contents {
        all.update(Sha256::digest(bytes));
    }
    all.finalize().into()
}
