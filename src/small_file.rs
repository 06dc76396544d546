//! Reads the small files of an operator: settings, tokens, certificates, keys.
//!
//! Any kind of entry may lie under the path of such a file, and the entry may be replaced while the
//! server runs. Therefore a file is opened without blocking and is examined through its own
//! descriptor before it is read: it must be a regular file of at most [`MAX_BYTES`]. A link to such
//! a file is followed, because Kubernetes mounts secrets as links.

use std::{
    fs::File,
    io::{self, Read},
    path::Path,
};

use rustix::fs::{CWD, FileType, Mode, OFlags, fstat, openat};

use crate::size::ByteSize;

/// The largest size of such a file, in bytes: 1 MiB.
pub const MAX_BYTES: u64 = 1 << 20;

/// Without `NONBLOCK`, opening a FIFO would wait for a writer.
const FLAGS: OFlags = OFlags::NONBLOCK.union(OFlags::NOCTTY).union(OFlags::CLOEXEC);

/// The contents of the regular file at `path`.
///
/// # Errors
/// The file cannot be opened or read, is not a regular file, or has more than [`MAX_BYTES`] bytes.
/// The text does not name the path.
pub fn read(path: &Path) -> io::Result<Vec<u8>> {
    let refused = |what: &str| {
        let why = format!("is {what}, must be a regular file of at most {}", ByteSize(MAX_BYTES));
        Err(io::Error::new(io::ErrorKind::InvalidInput, why))
    };
    let file = File::from(openat(CWD, path, FLAGS, Mode::empty())?);
    let status = fstat(&file)?;
    match FileType::from_raw_mode(status.st_mode) {
        FileType::RegularFile => {}
        FileType::Directory => return refused("a directory"),
        FileType::Fifo => return refused("a pipe"),
        FileType::CharacterDevice | FileType::BlockDevice => return refused("a device"),
        _ => return refused("not a regular file"),
    }
    let mut bytes = Vec::new();
    // At most one byte past the limit is read, also from a file that grows meanwhile.
    file.take(MAX_BYTES + 1).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > MAX_BYTES {
        return refused("larger");
    }
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Catches a FIFO that blocks its reader, a device without an end, and a size limit that is off
    /// by one or trusts the size that the system states.
    #[test]
    fn only_regular_files_within_the_limit_are_read() {
        let directory = tempfile::tempdir().unwrap();
        let at = |name: &str| directory.path().join(name);
        let limit = MAX_BYTES as usize;
        std::fs::write(at("limit"), vec![b'a'; limit]).unwrap();
        assert_eq!(read(&at("limit")).unwrap().len(), limit);
        std::fs::write(at("larger"), vec![b'a'; limit + 1]).unwrap();
        File::create(at("sparse")).unwrap().set_len(1 << 40).unwrap();
        std::os::unix::fs::symlink(at("limit"), at("link")).unwrap();
        assert_eq!(read(&at("link")).unwrap().len(), limit);
        rustix::fs::mkfifoat(CWD, at("fifo"), Mode::from_raw_mode(0o600)).unwrap();
        let _socket = std::os::unix::net::UnixListener::bind(at("socket")).unwrap();
        for (path, what) in [
            (at("larger"), "is larger, must be a regular file of at most 1 MiB"),
            (at("sparse"), "is larger"),
            (at("fifo"), "is a pipe"),
            (directory.path().into(), "is a directory"),
            (Path::new("/dev/zero").into(), "is a device"),
            (at("socket"), ""),
            (at("none"), "No such file"),
        ] {
            let error = read(&path).expect_err(what).to_string();
            assert!(error.contains(what), "{}: {error}", path.display());
        }
        // The system states a size of 0 for this file.
        assert!(!read(Path::new("/proc/self/status")).unwrap().is_empty());
    }
}
