//! The path of a Unix socket that a server listens on.

use std::{
    io,
    os::unix::fs::{FileTypeExt, MetadataExt},
    path::{Path, PathBuf},
};

use tokio::net::{UnixListener, UnixStream};

/// The path of a bound socket. It is removed when this is dropped, unless another socket has it by
/// then: a successor may already listen there.
#[derive(Debug)]
pub struct SocketFile {
    path: PathBuf,
    /// Device and inode of the entry, or `None` if the system did not report them.
    entry: Option<(u64, u64)>,
}

impl SocketFile {
    /// Binds `path`, after removing the socket that a killed server left behind there.
    ///
    /// # Errors
    /// The system's error; `AddrInUse` if a server listens there; `AlreadyExists` if there is a file that
    /// is not a socket, which is kept.
    pub(super) async fn bind(path: &Path) -> io::Result<(UnixListener, Self)> {
        if path.as_os_str().is_empty() {
            // Linux would bind an address without a name, which no client could find.
            return Err(io::Error::new(io::ErrorKind::InvalidInput, "the path is empty, must be unix:PATH"));
        }
        remove_stale(path).await?;
        let listener = UnixListener::bind(path)?;
        Ok((listener, Self { path: path.to_owned(), entry: entry(path) }))
    }

    pub(super) fn path(&self) -> &Path {
        &self.path
    }
}

impl Drop for SocketFile {
    fn drop(&mut self) {
        if self.entry.is_some() && entry(&self.path) == self.entry {
            let _ = std::fs::remove_file(&self.path);
        }
    }
}

fn entry(path: &Path) -> Option<(u64, u64)> {
    let metadata = std::fs::symlink_metadata(path).ok()?;
    Some((metadata.dev(), metadata.ino()))
}

/// Removes a socket that refuses connections, because no server listens there any more. Any other
/// failure, such as a server with too many connections to accept or a missing permission, does not
/// show that the socket is stale. The socket is then kept, and binding fails.
async fn remove_stale(path: &Path) -> io::Result<()> {
    let Ok(metadata) = std::fs::symlink_metadata(path) else { return Ok(()) };
    if !metadata.file_type().is_socket() {
        let why = "there is something else than a socket: choose another path, or remove it";
        return Err(io::Error::new(io::ErrorKind::AlreadyExists, why));
    }
    match UnixStream::connect(path).await {
        Err(error) if error.kind() == io::ErrorKind::ConnectionRefused => std::fs::remove_file(path),
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use tokio::net::UnixSocket;

    use super::*;

    /// Catches a socket that is removed although its server is alive, because a connection fails for
    /// another reason. Here the server accepts nothing, and its queue of connections is full.
    #[tokio::test]
    async fn only_a_socket_that_nobody_listens_on_is_removed() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("socket");
        let busy = UnixSocket::new_stream().unwrap();
        busy.bind(&path).unwrap();
        let busy = busy.listen(0).unwrap();
        let mut queued = Vec::new();
        while let Ok(stream) = UnixStream::connect(&path).await {
            queued.push(stream);
            assert!(queued.len() < 100, "the queue is never full");
        }
        let before = entry(&path);
        let error = SocketFile::bind(&path).await.map(|_| ()).unwrap_err();
        assert_eq!(error.kind(), io::ErrorKind::AddrInUse);
        assert_eq!(entry(&path), before);
        drop((busy, queued));
        let (_listener, file) = SocketFile::bind(&path).await.unwrap();
        assert!(entry(&path).is_some());
        drop(file);
        assert_eq!(entry(&path), None);
    }

    /// Catches a server that removes its successor's socket when it stops.
    #[tokio::test]
    async fn a_successors_socket_is_kept() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("socket");
        let (old, old_file) = SocketFile::bind(&path).await.unwrap();
        // An operator moves the socket away, so that a new server can start before the old one stops.
        std::fs::rename(&path, directory.path().join("old")).unwrap();
        let (_new, new_file) = SocketFile::bind(&path).await.unwrap();
        drop((old, old_file));
        UnixStream::connect(&path).await.unwrap();
        drop(new_file);
        assert_eq!(entry(&path), None);
        assert!(SocketFile::bind(Path::new("")).await.is_err());
    }
}
