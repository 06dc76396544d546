//! Values that are read from files, and read again when the files change.

use std::{
    fmt, fs,
    path::{Path, PathBuf},
    sync::{Arc, PoisonError, RwLock},
};

use sha2::{Digest, Sha256};

/// Why files were refused; the text names the file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LoadError(String);

impl LoadError {
    pub(super) fn new(path: &Path, why: impl fmt::Display) -> Self {
        Self(format!("{}: {why}", path.display()))
    }
}

impl fmt::Display for LoadError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for LoadError {}

/// Makes a value from the contents of the files, in the order of their paths.
type Parse<T> = fn(&[(&Path, Vec<u8>)]) -> Result<T, LoadError>;

/// A value made from files.
#[derive(Debug)]
pub(super) struct Reloaded<T> {
    paths: Vec<PathBuf>,
    parse: Parse<T>,
    current: RwLock<Current<T>>,
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
    pub(super) fn open(paths: Vec<PathBuf>, parse: Parse<T>) -> Result<Self, LoadError> {
        let contents = read(&paths)?;
        let value = Arc::new(parse(&contents)?);
        let current = RwLock::new(Current { value, digest: digest(&contents) });
        Ok(Self { paths, parse, current })
    }

    pub(super) fn get(&self) -> Arc<T> {
        self.current.read().unwrap_or_else(PoisonError::into_inner).value.clone()
    }

    /// Reads the files again and replaces the value, if they have changed and can be used.
    pub(super) fn reload(&self) {
        let seen = self.current.read().unwrap_or_else(PoisonError::into_inner).digest;
        let changed = read(&self.paths).and_then(|contents| {
            let digest = digest(&contents);
            if digest == seen {
                return Ok(None);
            }
            let value = Arc::new((self.parse)(&contents)?);
            Ok(Some(Current { value, digest }))
        });
        match changed {
            Ok(None) => {}
            Ok(Some(current)) => {
                *self.current.write().unwrap_or_else(PoisonError::into_inner) = current;
                tracing::info!(files = ?self.paths, "read again");
            }
            Err(error) => tracing::error!(%error, "not taken: what was read before stays in force"),
        }
    }
}

fn read(paths: &[PathBuf]) -> Result<Vec<(&Path, Vec<u8>)>, LoadError> {
    let read = |path| fs::read(path).map_err(|error| LoadError::new(path, error));
    paths.iter().map(|path| Ok((path.as_path(), read(path)?))).collect()
}

fn digest(contents: &[(&Path, Vec<u8>)]) -> [u8; 32] {
    let mut all = Sha256::new();
    for (_, bytes) in contents {
        all.update(Sha256::digest(bytes));
    }
    all.finalize().into()
}
