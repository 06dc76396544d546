//! Listens for connections on TCP and Unix sockets.

use std::{
    fmt, io,
    path::Path,
    pin::Pin,
    sync::Arc,
    task::{Context, Poll},
};

use tokio::{
    io::{AsyncRead, AsyncWrite, ReadBuf},
    net::{TcpListener, TcpStream, UnixListener, UnixStream},
};
use tokio_rustls::{TlsAcceptor, rustls::ServerConfig, server::TlsStream};

use super::{peers::Address, socket_file::SocketFile};

/// A bound address.
#[derive(Debug)]
pub enum Listener {
    /// `host:port`.
    Tcp(TcpListener),
    /// `unix:PATH`; the path is removed when the listener is dropped, unless another socket has it by then.
    Unix(UnixListener, SocketFile),
}

impl Listener {
    /// Binds `host:port` (port 0: any free port) or `unix:PATH`.
    ///
    /// # Errors
    /// The system's error, together with the address.
    pub async fn bind(address: &str) -> io::Result<Self> {
        let named = |error: io::Error| io::Error::new(error.kind(), format!("{address}: {error}"));
        match address.strip_prefix("unix:") {
            Some(path) => {
                let (listener, file) = SocketFile::bind(Path::new(path)).await.map_err(named)?;
                Ok(Self::Unix(listener, file))
            }
            None => Ok(Self::Tcp(TcpListener::bind(address).await.map_err(named)?)),
        }
    }

    /// Whether other machines can reach the address.
    ///
    /// # Errors
    /// The system cannot tell the bound address.
    pub fn is_exposed(&self) -> io::Result<bool> {
        match self {
            Self::Tcp(listener) => Ok(!listener.local_addr()?.ip().to_canonical().is_loopback()),
            Self::Unix(..) => Ok(false),
        }
    }

    /// Accepts the next connection; returns it with the peer's address.
    pub(super) async fn accept(&self) -> io::Result<(AcceptedConnection, Address)> {
        match self {
            Self::Tcp(listener) => {
                let (stream, peer) = listener.accept().await?;
                // Nagle's algorithm delays each call by 40 ms or more.
                stream.set_nodelay(true)?;
                Ok((AcceptedConnection::Tcp(stream), Address::Ip(peer.ip())))
            }
            Self::Unix(listener, _) => {
                let (stream, _) = listener.accept().await?;
                let user = stream.peer_cred()?.uid();
                Ok((AcceptedConnection::Unix(stream), Address::User(user)))
            }
        }
    }
}

/// The address as a client writes it, with the port that was bound.
impl fmt::Display for Listener {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Tcp(listener) => match listener.local_addr() {
                Ok(address) => write!(f, "{address}"),
                Err(error) => write!(f, "unknown address ({error})"),
            },
            Self::Unix(_, file) => write!(f, "unix:{}", file.path().display()),
        }
    }
}

/// An accepted connection.
#[derive(Debug)]
pub(super) enum AcceptedConnection {
    Tcp(TcpStream),
    Tls(Box<TlsStream<TcpStream>>),
    Unix(UnixStream),
}

impl AcceptedConnection {
    /// Encrypts a TCP connection. Other connections are returned unchanged.
    ///
    /// # Errors
    /// The peer does not speak TLS, or not as `config` requires.
    pub(super) async fn encrypted(self, config: Arc<ServerConfig>) -> io::Result<Self> {
        match self {
            Self::Tcp(stream) => {
                let stream = TlsAcceptor::from(config).accept(stream).await?;
                Ok(Self::Tls(Box::new(stream)))
            }
            other => Ok(other),
        }
    }
}

/// Calls a method of the stream, whatever its kind.
macro_rules! forward {
    ($connection:expr, $method:ident $(, $argument:expr)*) => {
        match $connection.get_mut() {
            AcceptedConnection::Tcp(stream) => Pin::new(stream).$method($($argument),*),
            AcceptedConnection::Tls(stream) => Pin::new(stream.as_mut()).$method($($argument),*),
            AcceptedConnection::Unix(stream) => Pin::new(stream).$method($($argument),*),
        }
    };
}

impl AsyncRead for AcceptedConnection {
    fn poll_read(
        self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        forward!(self, poll_read, cx, buffer)
    }
}

impl AsyncWrite for AcceptedConnection {
    fn poll_write(self: Pin<&mut Self>, cx: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        forward!(self, poll_write, cx, bytes)
    }

    fn poll_write_vectored(
        self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        slices: &[io::IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        forward!(self, poll_write_vectored, cx, slices)
    }

    fn is_write_vectored(&self) -> bool {
        true
    }

    fn poll_flush(self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        forward!(self, poll_flush, cx)
    }

    fn poll_shutdown(self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        forward!(self, poll_shutdown, cx)
    }
}
