//! Explains why a server cannot be reached.
//!
//! The Python client gives the same explanations (`client/src/hullcast/_reach.py`).

use std::error::Error as StdError;
use std::fmt;
use std::io;
use std::iter;
use std::time::Duration;

use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt};
use tokio::net::{TcpStream, UnixStream};
use tokio_rustls::rustls::{self, CertificateError};

use crate::Address;

/// The time within which a peer must answer.
const PATIENCE: Duration = Duration::from_secs(2);
/// An HTTP/2 client's first bytes: the preface, and an empty SETTINGS frame.
const GREETING: &[u8] = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n\0\0\0\x04\0\0\0\0\0";

/// No hullcast server answers at the address, or the server does not fit the settings of the connection.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Unreachable {
    /// The address as the caller wrote it.
    pub address: String,
    /// The reason.
    pub cause: Cause,
}

/// Why no server can be reached.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Cause {
    /// Nothing listens at the address.
    Refused,
    /// There is no such Unix socket.
    NoSocket,
    /// The host's name has no address; the text is the system's.
    NoHost(String),
    /// The peer takes connections and sends nothing.
    Silent,
    /// The peer speaks TLS, and the address asks for a connection without it.
    SpeaksTls,
    /// The peer does not speak HTTP/2, so it is not a hullcast server.
    NotHttp2,
    /// The address asks for TLS, and the peer does not speak it.
    NotTls,
    /// The server's certificate is self-signed, and it is not among the trusted ones.
    SelfSigned,
    /// The server's certificate is for another host name.
    OtherName,
    /// The server's certificate is not trusted; the text is the reason.
    Untrusted(String),
    /// Another cause, as the operating system or TLS states it.
    Other(String),
}

impl StdError for Unreachable {}

impl fmt::Display for Unreachable {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { address, cause } = self;
        match cause {
            Cause::Refused => write!(
                f,
                "no hullcast server at {address} (connection refused); start one with `hullcast serve`"
            ),
            Cause::NoSocket => write!(
                f,
                "no hullcast server at {address} (no such socket); \
                 start one with `hullcast serve --listen {address}`"
            ),
            Cause::NoHost(why) => write!(f, "no host of the name in {address}: {why}"),
            Cause::Silent => write!(
                f,
                "the server at {address} accepts connections and does not answer: is it a hullcast server? It may \
                 be frozen, or a proxy that has lost its server"
            ),
            Cause::SpeaksTls => write!(f, "the server at {address} speaks TLS: use https://"),
            Cause::NotHttp2 => {
                write!(f, "the server at {address} does not speak HTTP/2: it is not a hullcast server")
            }
            Cause::NotTls => {
                write!(f, "the server at {address} does not speak TLS: use http:// in place of https://")
            }
            Cause::SelfSigned => write!(
                f,
                "the certificate of the server at {address} is self-signed, and it is not the one that is \
                 trusted; give the PEM file of this very certificate"
            ),
            Cause::OtherName => write!(
                f,
                "the certificate of the server at {address} is for another host name: connect to a name that \
                 the certificate has"
            ),
            Cause::Untrusted(why) => write!(
                f,
                "the certificate of the server at {address} is not trusted ({why}); \
                 give the PEM file of its authority"
            ),
            Cause::Other(why) => write!(f, "no server at {address}: {why}"),
        }
    }
}

/// The cause of a connection that failed with `error`.
pub(crate) async fn failed(address: &Address, error: &(dyn StdError + Send + Sync + 'static)) -> Cause {
    match system_error(error) {
        Some(io::ErrorKind::ConnectionRefused) => return Cause::Refused,
        Some(io::ErrorKind::NotFound) if address.socket().is_some() => return Cause::NoSocket,
        _ => {}
    }
    if let Some(authority) = address.authority()
        && let Err(why) = tokio::net::lookup_host(authority).await
    {
        return Cause::NoHost(why.to_string());
    }
    match mismatch(address, error).await {
        Some(cause) => cause,
        None => Cause::Other(root_cause(error)),
    }
}

/// The cause if a peer is there but is silent, or does not fit the address. `None` for other causes, which
/// may be temporary.
pub(crate) async fn mismatch(
    address: &Address,
    error: &(dyn StdError + Send + Sync + 'static),
) -> Option<Cause> {
    let Some(answer) = greeting(address).await else { return Some(Cause::Silent) };
    if address.is_encrypted() {
        return match tls_error(error)? {
            rustls::Error::InvalidMessage(_) => Some(Cause::NotTls),
            // `Other` means that the server showed the certificate of an authority, as it does if its
            // certificate is self-signed.
            rustls::Error::InvalidCertificate(CertificateError::Other(_)) => Some(Cause::SelfSigned),
            rustls::Error::InvalidCertificate(CertificateError::UnknownIssuer) => {
                Some(Cause::Untrusted("no trusted authority has signed it".into()))
            }
            rustls::Error::InvalidCertificate(
                CertificateError::NotValidForName | CertificateError::NotValidForNameContext { .. },
            ) => Some(Cause::OtherName),
            other @ rustls::Error::InvalidCertificate(_) => Some(Cause::Untrusted(other.to_string())),
            _ => None,
        };
    }
    if address.socket().is_some() {
        return None;
    }
    match answer.as_slice() {
        [0x15 | 0x16, 0x03, ..] => Some(Cause::SpeaksTls),
        // The fourth byte of a frame is its type; a server begins with SETTINGS, type 4.
        [_, _, _, kind, ..] if *kind != 4 => Some(Cause::NotHttp2),
        _ => None,
    }
}

/// Connects to the address and returns the result of [`answer_to_greeting`].
async fn greeting(address: &Address) -> Option<Vec<u8>> {
    match address.socket() {
        Some(path) => answer_to_greeting(UnixStream::connect(path)).await,
        None => answer_to_greeting(TcpStream::connect(address.authority().unwrap_or_default())).await,
    }
}

/// The first bytes of a peer's answer to the HTTP/2 preface; empty if there is no connection, or if the
/// peer closes it. `None` if the peer sends nothing in time.
async fn answer_to_greeting<S: AsyncRead + AsyncWrite + Unpin>(
    connect: impl Future<Output = io::Result<S>>,
) -> Option<Vec<u8>> {
    let Ok(Ok(mut stream)) = tokio::time::timeout(PATIENCE, connect).await else { return Some(Vec::new()) };
    let mut answer = [0; 9];
    let exchange = async {
        stream.write_all(GREETING).await?;
        stream.read(&mut answer).await
    };
    let count = tokio::time::timeout(PATIENCE, exchange).await.ok()?.unwrap_or(0);
    Some(answer[..count].to_vec())
}

/// An error and its causes, from the outermost to the innermost.
pub(crate) fn causes<'a>(
    error: &'a (dyn StdError + 'static),
) -> impl Iterator<Item = &'a (dyn StdError + 'static)> {
    iter::successors(Some(error), |&error| error.source())
}

/// The text of the innermost cause. If the failure is tonic's own, its message says less than the cause.
pub(crate) fn root_cause(error: &(dyn StdError + 'static)) -> String {
    causes(error).last().unwrap_or(error).to_string()
}

/// The kind of the first operating system error among the causes.
fn system_error(error: &(dyn StdError + 'static)) -> Option<io::ErrorKind> {
    causes(error)
        .filter_map(|cause| cause.downcast_ref::<io::Error>())
        .find(|cause| cause.raw_os_error().is_some())
        .map(io::Error::kind)
}

/// The first error of TLS among the causes. The system's error type contains it, but does not name it as
/// its source.
fn tls_error<'a>(error: &'a (dyn StdError + 'static)) -> Option<&'a rustls::Error> {
    causes(error).find_map(|cause| {
        let inner = cause.downcast_ref::<io::Error>().and_then(io::Error::get_ref);
        inner.and_then(|inner| inner.downcast_ref()).or_else(|| cause.downcast_ref())
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Catches a peer that accepts connections and sends nothing but is not reported as silent, and a peer
    /// that closes the connection, or does not exist, but is reported as silent.
    #[tokio::test]
    async fn a_peer_that_never_answers_is_named() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("socket");
        let on_path = tokio::net::UnixListener::bind(&path).expect("a socket");
        let silent = tokio::net::TcpListener::bind("127.0.0.1:0").await.expect("a port");
        let closing = tokio::net::TcpListener::bind("127.0.0.1:0").await.expect("a port");
        let port = |listener: &tokio::net::TcpListener| listener.local_addr().expect("an address").port();
        let (silent_port, closing_port) = (port(&silent), port(&closing));
        tokio::spawn(async move { while closing.accept().await.is_ok() {} });
        let error = io::Error::other("given up");
        for (url, expected) in [
            (format!("http://127.0.0.1:{silent_port}"), Some(Cause::Silent)),
            (format!("https://127.0.0.1:{silent_port}"), Some(Cause::Silent)),
            (format!("unix:{}", path.display()), Some(Cause::Silent)),
            (format!("http://127.0.0.1:{closing_port}"), None),
            ("unix:/nonexistent/socket".into(), None),
        ] {
            assert_eq!(mismatch(&url.parse().expect("an address"), &error).await, expected, "{url}");
        }
        drop((silent, on_path));
    }

    /// Catches an explanation that does not name the address.
    #[test]
    fn every_explanation_names_the_address() {
        let text = String::new;
        for cause in [
            Cause::Refused,
            Cause::NoSocket,
            Cause::NoHost(text()),
            Cause::Silent,
            Cause::SpeaksTls,
            Cause::NotHttp2,
            Cause::NotTls,
            Cause::SelfSigned,
            Cause::OtherName,
            Cause::Untrusted(text()),
            Cause::Other(text()),
        ] {
            let unreachable = Unreachable { address: "here:1".into(), cause };
            assert!(
                unreachable.to_string().contains(" at here:1")
                    || unreachable.to_string().contains("in here:1")
            );
        }
    }
}
