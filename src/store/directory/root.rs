//! The blocking operations of a directory store.

use std::{
    ffi::CStr,
    fs::File,
    io::{self, Read, Write},
    path::{Path, PathBuf},
    sync::atomic::{AtomicBool, AtomicU64, Ordering},
};

use bytes::Bytes;
use rustix::{
    fs::{
        AtFlags, CWD, Dir, FileType, Mode, OFlags, Stat, fstat, mkdirat, openat, renameat, statat, unlinkat,
    },
    io::Errno,
};

use crate::{
    log_limit::limited,
    size::ByteSize,
    store::{
        HullId, StoreError, StoredBlob,
        blob_store::{FirstById, quarantine_name, shard_name, shard_of_name},
    },
};

/// How many names are tried for a temporary file, and for a directory that is moved away.
const NAMES_TRIED: u64 = 1000;

const QUARANTINE: &str = "quarantine";

const DIRECTORY: OFlags = OFlags::DIRECTORY.union(OFlags::NOFOLLOW).union(OFlags::CLOEXEC);
/// Without `NONBLOCK`, opening a FIFO would wait for a writer.
const BLOB: OFlags = OFlags::NOFOLLOW.union(OFlags::NONBLOCK).union(OFlags::NOCTTY).union(OFlags::CLOEXEC);
const NEW: OFlags =
    OFlags::WRONLY.union(OFlags::CREATE).union(OFlags::EXCL).union(OFlags::NOFOLLOW).union(OFlags::CLOEXEC);

/// A store's root directory, with operations that block.
#[derive(Debug)]
pub(super) struct Root {
    /// The canonical path, resolved when the store was opened.
    path: PathBuf,
    /// The shards whose entry in the root this process has synced. Another server that created a
    /// shard may have been killed before its sync.
    synced_shards: [AtomicBool; 256],
    next_temporary: AtomicU64,
}

impl Root {
    /// Opens the directory at `path`, which is created if it is missing.
    pub(super) fn open(path: &Path) -> io::Result<Self> {
        std::fs::create_dir_all(path)?;
        // A server that was killed may have created the directory, or shards in it, without syncing
        // their entries.
        let path = path.canonicalize()?;
        File::from(openat(CWD, &path, DIRECTORY, Mode::empty())?).sync_all()?;
        if let Some(parent) = path.parent() {
            // A parent that this process may not open was not created by it.
            let _ = File::open(parent).and_then(|parent| parent.sync_all());
        }
        let synced_shards = std::array::from_fn(|_| AtomicBool::new(false));
        Ok(Self { path, synced_shards, next_temporary: 1.into() })
    }

    /// The root directory. It is opened for every operation, because it may have been mounted again
    /// meanwhile. A deleted directory would read as empty, so it is reported as unavailable.
    fn descriptor(&self) -> Result<File, StoreError> {
        match openat(CWD, &self.path, DIRECTORY, Mode::empty()) {
            Ok(root) => Ok(root.into()),
            Err(Errno::NOENT) => {
                Err(StoreError::Unavailable(format!("the directory {} does not exist", self.path.display())))
            }
            Err(error) => Err(self.failed("", error)),
        }
    }

    /// A subdirectory of the root, or `None` if it does not exist.
    fn subdirectory(&self, root: &File, name: &str) -> Result<Option<File>, StoreError> {
        match openat(root, name, DIRECTORY, Mode::empty()) {
            Ok(directory) => Ok(Some(directory.into())),
            Err(Errno::NOENT) => Ok(None),
            Err(Errno::NOTDIR | Errno::LOOP) => {
                Err(StoreError::NotABlob(format!("{} is not a directory", self.path.join(name).display())))
            }
            Err(error) => Err(self.failed(name, error)),
        }
    }

    /// A subdirectory of the root, created if it is missing, and whether it was created.
    fn made(&self, root: &File, name: &str) -> Result<(File, bool), StoreError> {
        let is_new = match mkdirat(root, name, Mode::from_raw_mode(0o777)) {
            Ok(()) => true,
            Err(Errno::EXIST) => false,
            Err(error) => return Err(self.failed(name, error)),
        };
        match self.subdirectory(root, name) {
            Ok(Some(directory)) => Ok((directory, is_new)),
            Ok(None) => Err(StoreError::Unavailable(format!("{name} was removed during the operation"))),
            // Nothing can be written there until an operator removes the entry.
            Err(error) => Err(StoreError::Unavailable(error.to_string())),
        }
    }

    pub(super) fn put(&self, id: HullId, blob: &[u8]) -> Result<(), StoreError> {
        let root = self.descriptor()?;
        let (shard, is_new) = self.made(&root, &shard_name(id.0[0]))?;
        let synced = &self.synced_shards[usize::from(id.0[0])];
        if is_new || !synced.load(Ordering::Acquire) {
            root.sync_all().map_err(|error| self.failed("", error))?;
            synced.store(true, Ordering::Release);
        }
        let name = id.to_string();
        match self.publish(&shard, &name, blob) {
            Err(Failed { errno: Some(Errno::ISDIR), .. }) => {
                self.move_away(&root, &shard, &name)?;
                self.publish(&shard, &name, blob).map_err(|failed| failed.why)
            }
            published => published.map_err(|failed| failed.why),
        }
    }

    /// Writes the file `name` in `directory`. It is complete and synced before it has that name.
    fn publish(&self, directory: &File, name: &str, bytes: &[u8]) -> Result<(), Failed> {
        let failed = |error: io::Error| Failed::new(self, name, error);
        let (temporary, mut file) = self.temporary(directory, name).map_err(failed)?;
        let written = (|| {
            file.write_all(bytes)?;
            file.sync_all()?;
            Ok::<_, io::Error>(renameat(directory, &temporary, directory, name)?)
        })();
        if let Err(error) = written {
            // No server reads a file of this name. If it stays, it only takes space.
            let _ = unlinkat(directory, &temporary, AtFlags::empty());
            return Err(failed(error));
        }
        directory.sync_all().map_err(failed)
    }

    /// Creates a file beside `name`; returns its name and the file.
    fn temporary(&self, directory: &File, name: &str) -> io::Result<(String, File)> {
        let mut last = Errno::EXIST;
        for _ in 0..NAMES_TRIED {
            let number = self.next_temporary.fetch_add(1, Ordering::Relaxed);
            let temporary = format!("{name}#{}-{number}", std::process::id());
            match openat(directory, &temporary, NEW, Mode::from_raw_mode(0o666)) {
                Ok(file) => return Ok((temporary, file.into())),
                Err(Errno::EXIST) => last = Errno::EXIST,
                Err(error) => return Err(error.into()),
            }
        }
        Err(last.into())
    }

    /// Moves a directory that lies under a blob's name to the quarantine, unchanged.
    fn move_away(&self, root: &File, shard: &File, name: &str) -> Result<(), StoreError> {
        let (quarantine, _) = self.made(root, QUARANTINE)?;
        for number in 1..=NAMES_TRIED {
            // If an empty directory has the new name, the rename replaces it and nothing is lost.
            match renameat(shard, name, &quarantine, format!("{name}-directory-{number}")) {
                Ok(()) => return Ok(()),
                Err(Errno::EXIST | Errno::NOTEMPTY | Errno::NOTDIR) => {}
                Err(error) => return Err(self.failed(name, error)),
            }
        }
        Err(self.failed(name, Errno::EXIST))
    }

    pub(super) fn get(&self, id: HullId, max_bytes: u64) -> Result<Option<Bytes>, StoreError> {
        let Some(shard) = self.subdirectory(&self.descriptor()?, &shard_name(id.0[0]))? else {
            return Ok(None);
        };
        let name = id.to_string();
        let refused = |what: String| Err(StoreError::NotABlob(format!("{name} is {what}")));
        let file: File = match openat(&shard, &name, BLOB, Mode::empty()) {
            Ok(file) => file.into(),
            Err(Errno::NOENT) => return Ok(None),
            Err(Errno::LOOP) => return refused("a symbolic link".into()),
            // The entry is a socket, or a device without a driver.
            Err(Errno::NXIO | Errno::NODEV) => return refused("not a regular file".into()),
            Err(Errno::ACCESS | Errno::PERM) => return refused("not readable for this process".into()),
            Err(error) => return Err(self.failed(&name, error)),
        };
        let status = fstat(&file).map_err(|error| self.failed(&name, error))?;
        let Some(size) = blob_size(&status) else { return refused(kind(&status).into()) };
        let too_large =
            |size: u64| format!("{} long, but a hull has at most {}", ByteSize(size), ByteSize(max_bytes));
        if size > max_bytes {
            return refused(too_large(size));
        }
        let mut bytes = Vec::with_capacity(size as usize + 1);
        file.take(max_bytes.saturating_add(1))
            .read_to_end(&mut bytes)
            .map_err(|error| self.failed(&name, error))?;
        if bytes.len() as u64 > max_bytes {
            return refused(too_large(bytes.len() as u64));
        }
        Ok(Some(bytes.into()))
    }

    pub(super) fn size(&self, id: HullId) -> Result<Option<u64>, StoreError> {
        let name = id.to_string();
        let shard = match self.subdirectory(&self.descriptor()?, &name[..2]) {
            Ok(Some(shard)) => shard,
            Ok(None) | Err(StoreError::NotABlob(_)) => return Ok(None),
            Err(error) => return Err(error),
        };
        match statat(&shard, &name, AtFlags::SYMLINK_NOFOLLOW) {
            Ok(status) => Ok(blob_size(&status)),
            Err(Errno::NOENT) => Ok(None),
            Err(error) => Err(self.failed(&name, error)),
        }
    }

    pub(super) fn delete(&self, id: HullId) -> Result<(), StoreError> {
        let name = id.to_string();
        let Some(shard) = self.subdirectory(&self.descriptor()?, &name[..2])? else { return Ok(()) };
        match unlinkat(&shard, &name, AtFlags::empty()) {
            Ok(()) | Err(Errno::NOENT) => Ok(()),
            Err(error) => Err(self.failed(&name, error)),
        }
    }

    pub(super) fn shards(&self) -> Result<Vec<u8>, StoreError> {
        let mut shards = Vec::new();
        self.each_name(&self.descriptor()?, "", |name| shards.extend(shard_of_name(name)))?;
        shards.sort_unstable();
        Ok(shards)
    }

    pub(super) fn list(
        &self,
        shard: u8,
        mut after: Option<HullId>,
        count: usize,
        max_bytes: u64,
    ) -> Result<Vec<StoredBlob>, StoreError> {
        let shard_name = shard_name(shard);
        let (mut blobs, mut first_bad, mut bad) = (Vec::new(), None, 0_u64);
        let directory = match self.subdirectory(&self.descriptor()?, &shard_name) {
            Ok(Some(directory)) => directory,
            Ok(None) => return Ok(blobs),
            Err(StoreError::NotABlob(why)) => {
                limited!(warn, why, "the listing of the store left a shard out");
                return Ok(blobs);
            }
            Err(error) => return Err(error),
        };
        // Reads all names, but keeps only as many as are wanted, however large the directory is. If
        // some of them turn out not to be blobs, continues with the names after them.
        while blobs.len() < count {
            let wanted = count - blobs.len();
            let mut first = FirstById::new(wanted);
            self.each_name(&directory, &shard_name, |name| {
                // Other names, such as those of temporary files, are not hulls.
                let id = name.parse::<HullId>().ok().filter(|id| id.0[0] == shard);
                if let Some(id) = id.filter(|id| after.is_none_or(|after| *id > after)) {
                    first.offer(id);
                }
            })?;
            let ids = first.sorted();
            for &id in &ids {
                match statat(&directory, id.to_string(), AtFlags::SYMLINK_NOFOLLOW) {
                    Ok(status) => {
                        if let Some(bytes) = blob_size(&status).filter(|size| *size <= max_bytes) {
                            let created_unix_ms = modified_unix_ms(&status);
                            blobs.push(StoredBlob { id, created_unix_ms, bytes });
                        } else {
                            first_bad.get_or_insert(id);
                            bad += 1;
                        }
                    }
                    Err(Errno::NOENT) => {}
                    Err(error) => return Err(self.failed(&id.to_string(), error)),
                }
            }
            after = ids.last().copied();
            if ids.len() < wanted {
                break;
            }
        }
        if let Some(first) = first_bad {
            limited!(warn, entries = bad, %first, "the listing of the store left out entries that are not blobs");
        }
        Ok(blobs)
    }

    /// Calls `with` for each name in a directory that is valid UTF-8.
    fn each_name(&self, directory: &File, path: &str, mut with: impl FnMut(&str)) -> Result<(), StoreError> {
        let failed = |error| self.failed(path, error);
        for entry in Dir::read_from(directory).map_err(failed)? {
            let entry = entry.map_err(failed)?;
            CStr::to_str(entry.file_name()).into_iter().for_each(&mut with);
        }
        Ok(())
    }

    pub(super) fn set_aside(&self, id: HullId, blob: &[u8]) -> Result<String, StoreError> {
        let root = self.descriptor()?;
        let (quarantine, is_new) = self.made(&root, QUARANTINE)?;
        if is_new {
            root.sync_all().map_err(|error| self.failed("", error))?;
        }
        let name = quarantine_name(id, blob);
        if statat(&quarantine, &name, AtFlags::SYMLINK_NOFOLLOW).is_err() {
            self.publish(&quarantine, &name, blob).map_err(|failed| failed.why)?;
        }
        Ok(format!("{QUARANTINE}/{name}"))
    }

    pub(super) fn probe(&self) -> Result<(), StoreError> {
        let root = self.descriptor()?;
        // Each server on the store uses its own name.
        let name = format!("probe-{}", std::process::id());
        self.publish(&root, &name, b"probe").map_err(|failed| failed.why)?;
        match unlinkat(&root, &name, AtFlags::empty()) {
            Ok(()) | Err(Errno::NOENT) => Ok(()),
            Err(error) => Err(self.failed(&name, error)),
        }
    }

    fn failed(&self, name: &str, error: impl Into<io::Error>) -> StoreError {
        use io::ErrorKind::{FileTooLarge, QuotaExceeded, StorageFull};
        let error = error.into();
        let why = format!("{}: {error}", self.path.join(name).display());
        match error.kind() {
            StorageFull | QuotaExceeded | FileTooLarge => StoreError::Full(why),
            _ => StoreError::Unavailable(why),
        }
    }
}

/// The error of a file that was not written.
struct Failed {
    errno: Option<Errno>,
    why: StoreError,
}

impl Failed {
    fn new(root: &Root, name: &str, error: io::Error) -> Self {
        Self { errno: Errno::from_io_error(&error), why: root.failed(name, error) }
    }
}

/// The size of a regular file, or `None` for any other kind of entry.
fn blob_size(status: &Stat) -> Option<u64> {
    let is_file = FileType::from_raw_mode(status.st_mode) == FileType::RegularFile;
    u64::try_from(status.st_size).ok().filter(|_| is_file)
}

fn kind(status: &Stat) -> &'static str {
    match FileType::from_raw_mode(status.st_mode) {
        FileType::Directory => "a directory",
        FileType::Fifo => "a FIFO",
        FileType::CharacterDevice | FileType::BlockDevice => "a device",
        _ => "not a regular file",
    }
}

#[allow(clippy::unnecessary_cast, reason = "the types differ between systems")]
fn modified_unix_ms(status: &Stat) -> i64 {
    (status.st_mtime as i64).saturating_mul(1000).saturating_add(status.st_mtime_nsec as i64 / 1_000_000)
}
