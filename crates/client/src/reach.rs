//! Parses a server's address, and explains why a server cannot be reached.
//!
//! The Python client gives the same explanations (`client/src/hullcast/_channel.py`, `_reach.py`).

use std::error::Error as StdError;
use std::io;
use std::time::Duration;

use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt};
use tokio::net::TcpStream;

use super::Error;
use super::remote::root_cause;

/// The port if the address has none.
const DEFAULT_PORT: u16 = 50051;
/// The time within which a peer must answer.
const PATIENCE: Duration = Duration::from_secs(2);
/// An HTTP/2 client's first bytes: the preface, and an empty SETTINGS frame.
const GREETING: &[u8] = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n\0\0\0\x04\0\0\0\0\0";

/// Checks the addresses of an option, which are separated by commas.
///
/// # Errors
/// One of them is not an address.
pub(crate) fn addresses(text: &str) -> Result<String, String> {
    for address in text.split(',') {
        url(address).map_err(|error| error.to_string())?;
    }
    Ok(text.to_owned())
}

/// The URL of an address: `host`, `host:port`, `unix:PATH`, `http://host:port`, `https://host:port`.
///
/// # Errors
/// The address has none of these forms.
pub(crate) fn url(address: &str) -> Result<String, Error> {
    if address.starts_with("unix:") {
        return Ok(address.to_owned());
    }
    let (scheme, rest) = address.split_once("://").unwrap_or(("http", address));
    let forms = "host, host:port, unix:PATH, http://host:port or https://host:port";
    let wrong = || -> Error { format!("{address:?} is not an address: expected {forms}").into() };
    if !["http", "https"].contains(&scheme) {
        return Err(wrong());
    }
    let rest = rest.strip_suffix('/').unwrap_or(rest);
    // The brackets of an IPv6 address separate its colons from the colon before the port.
    let (host, port) = match rest.rsplit_once(':') {
        Some((host, port)) if !port.contains(']') => (host, Some(port)),
        _ => (rest, None),
    };
    let bare = host.strip_prefix('[').and_then(|h| h.strip_suffix(']')).unwrap_or(host);
    let bracketed = bare.len() < host.len();
    let foreign = |c: char| c.is_whitespace() || "/?#@[]".contains(c) || (c == ':' && !bracketed);
    if bare.is_empty() || bare.contains(foreign) {
        return Err(wrong());
    }
    if port.is_none() && bare.bytes().all(|byte| byte.is_ascii_digit()) {
        let text = format!("{bare:?} is a port without a host: expected localhost:{bare}, or {forms}");
        return Err(text.into());
    }
    let port = match port {
        None => DEFAULT_PORT,
        Some(text) => text.parse().ok().filter(|&port| port > 0).ok_or_else(wrong)?,
    };
    Ok(format!("{scheme}://{host}:{port}"))
}

/// A failed connection as a sentence that names the cause and, if it is known, the remedy.
pub(crate) async fn failed(address: &str, url: &str, error: &(dyn StdError + 'static)) -> String {
    match cause(error) {
        Some(io::ErrorKind::ConnectionRefused) => {
            return format!(
                "no hullcast server at {address} (connection refused); start one with `hullcast serve`"
            );
        }
        Some(io::ErrorKind::NotFound) if address.starts_with("unix:") => {
            return format!(
                "no hullcast server at {address} (no such socket); \
                 start one with `hullcast serve --listen {address}`"
            );
        }
        _ => {}
    }
    if let Some(text) = mismatch(address, url, error).await {
        return text;
    }
    let text = root_cause(error);
    if text.contains("lookup address") {
        return format!("no host of the name in {address}: {text}");
    }
    format!("no server at {address}: {text}")
}

/// The explanation for a peer that answers but speaks another protocol. None for other causes, which
/// may be temporary.
pub(crate) async fn mismatch(address: &str, url: &str, error: &(dyn StdError + 'static)) -> Option<String> {
    if is_silent(url).await {
        return Some(format!(
            "the server at {address} accepts connections and does not answer: is it a hullcast server? It may be \
             frozen, or a proxy that has lost its server"
        ));
    }
    if let Some(authority) = url.strip_prefix("http://") {
        return match greeting(authority).await.unwrap_or_default().as_slice() {
            [0x15 | 0x16, 0x03, ..] => Some(format!("the server at {address} speaks TLS: use https://")),
            // The fourth byte of a frame is its type; a server begins with SETTINGS, type 4.
            [_, _, _, kind, ..] if *kind != 4 => {
                let text = "does not speak HTTP/2: it is not a hullcast server";
                Some(format!("the server at {address} {text}"))
            }
            _ => None,
        };
    }
    let text = root_cause(error);
    if text.contains("InvalidContentType") || text.contains("corrupt message") {
        return Some(format!("the server at {address} does not speak TLS: use http:// in place of https://"));
    }
    text.contains("invalid peer certificate").then(|| untrusted(address, &text))
}

/// The explanation for a certificate that TLS refuses with this text.
fn untrusted(address: &str, text: &str) -> String {
    // The certificate of an authority is shown by a server whose certificate is self-signed.
    if text.contains("CaUsedAsEndEntity") {
        return format!(
            "the certificate of the server at {address} is self-signed, and it is not the one that is trusted; \
             give the PEM file of this very certificate by --tls-ca"
        );
    }
    let why = match text {
        _ if text.contains("UnknownIssuer") => "no trusted authority has signed it",
        _ => text,
    };
    format!(
        "the certificate of the server at {address} is not trusted ({why}); \
         give the PEM file of its authority by --tls-ca"
    )
}

/// Whether a peer takes the connection and then sends nothing, not even that it has another protocol.
async fn is_silent(url: &str) -> bool {
    if let Some((_, authority)) = url.split_once("://") {
        return greeting(authority).await.is_none();
    }
    let path = url.trim_start_matches("unix:").trim_start_matches("//");
    answer_to_greeting(tokio::net::UnixStream::connect(path)).await.is_none()
}

/// The first bytes of a TCP peer's answer to the HTTP/2 preface, as of [`answer_to_greeting`].
async fn greeting(authority: &str) -> Option<Vec<u8>> {
    answer_to_greeting(TcpStream::connect(authority)).await
}

/// The first bytes of a peer's answer to the HTTP/2 preface; empty if there is no connection, or if the
/// peer closes it. None if the peer sends nothing in time.
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

/// The kind of the first operating system error in the chain of causes.
fn cause(error: &(dyn StdError + 'static)) -> Option<io::ErrorKind> {
    let mut next = Some(error);
    while let Some(error) = next {
        if let Some(found) = error.downcast_ref::<io::Error>()
            && found.raw_os_error().is_some()
        {
            return Some(found.kind());
        }
        next = error.source();
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Catches a peer that accepts connections and says nothing, which the user is not told of; and one that
    /// closes the connection, or is not there, that is taken for silent.
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
        for (url, is_silent) in [
            (format!("http://127.0.0.1:{silent_port}"), true),
            (format!("https://127.0.0.1:{silent_port}"), true),
            (format!("unix:{}", path.display()), true),
            (format!("http://127.0.0.1:{closing_port}"), false),
            ("unix:/nonexistent/socket".into(), false),
        ] {
            let text = mismatch(&url, &url, &error).await;
            assert_eq!(text.is_some(), is_silent, "{url}: {text:?}");
            let expected = "accepts connections and does not answer: is it a hullcast server?";
            assert!(text.is_none_or(|text| text.contains(expected) && text.contains(&url)));
        }
        drop((silent, on_path));
    }

    /// Catches a missing port that becomes HTTP's default, and a malformed address that is dialled.
    #[test]
    fn addresses_have_a_port_and_a_scheme() {
        for (address, expected) in [
            ("localhost", "http://localhost:50051"),
            ("localhost:1", "http://localhost:1"),
            ("http://localhost", "http://localhost:50051"),
            ("https://localhost/", "https://localhost:50051"),
            ("https://10.0.0.1:443", "https://10.0.0.1:443"),
            ("[::1]", "http://[::1]:50051"),
            ("https://[::1]:7", "https://[::1]:7"),
            ("unix:/run/x", "unix:/run/x"),
        ] {
            assert_eq!(url(address).expect(address), expected);
        }
        for wrong in [
            "",
            ":1",
            "host:",
            "host:0",
            "host:65536",
            "host:x",
            "ftp://host",
            "http://a/b",
            "::1",
            "a b",
            "u@h",
        ] {
            assert!(url(wrong).is_err(), "{wrong}");
        }
    }
}
