//! The address of a server.

use std::fmt;
use std::str::FromStr;

/// The port if the address has none.
const DEFAULT_PORT: u16 = 50051;
/// The forms of an address, for messages.
const FORMS: &str = "host, host:port, unix:PATH, http://host:port or https://host:port";

/// The address of a server, in one of these forms: `host`, `host:port`, `unix:PATH`, `http://host:port` or
/// `https://host:port`.
///
/// An address without a port means port 50051. Only connections to `https://` are encrypted. The address of a
/// host is displayed as a URL with scheme and port, and that of a Unix socket as it was given.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Address(Place);

/// The place at which a server listens.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
enum Place {
    /// A port of a host. An IPv6 address has its brackets.
    Host { is_encrypted: bool, host: String, port: u16 },
    /// A Unix socket: the text after `unix:`, which is its path, or `//` and its path.
    Socket(String),
}

/// The text is not an address.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum AddressError {
    /// The text has none of the forms of an address.
    #[error("{0:?} is not an address: expected {FORMS}")]
    Malformed(String),
    /// The text is only a number, which may be meant as a port.
    #[error("{0:?} is a port without a host: expected localhost:{0}, or {FORMS}")]
    OnlyAPort(String),
}

impl Address {
    /// Whether connections to this address are encrypted.
    pub fn is_encrypted(&self) -> bool {
        matches!(self.0, Place::Host { is_encrypted: true, .. })
    }

    /// `host:port`, or `None` for a Unix socket.
    pub(crate) fn authority(&self) -> Option<String> {
        match &self.0 {
            Place::Host { host, port, .. } => Some(format!("{host}:{port}")),
            Place::Socket(_) => None,
        }
    }

    /// The host that a certificate has to name, or `None` for a Unix socket.
    pub(crate) fn host(&self) -> Option<&str> {
        match &self.0 {
            Place::Host { host, .. } => Some(unbracketed(host)),
            Place::Socket(_) => None,
        }
    }

    /// The path of a Unix socket.
    pub(crate) fn socket(&self) -> Option<&str> {
        match &self.0 {
            Place::Host { .. } => None,
            Place::Socket(path) => Some(path.strip_prefix("//").unwrap_or(path)),
        }
    }
}

/// A host without the brackets of an IPv6 address.
fn unbracketed(host: &str) -> &str {
    host.strip_prefix('[').and_then(|host| host.strip_suffix(']')).unwrap_or(host)
}

impl fmt::Display for Address {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.0 {
            Place::Host { is_encrypted: true, host, port } => write!(f, "https://{host}:{port}"),
            Place::Host { is_encrypted: false, host, port } => write!(f, "http://{host}:{port}"),
            Place::Socket(path) => write!(f, "unix:{path}"),
        }
    }
}

impl FromStr for Address {
    type Err = AddressError;

    fn from_str(text: &str) -> Result<Self, AddressError> {
        if let Some(path) = text.strip_prefix("unix:") {
            return Ok(Self(Place::Socket(path.to_owned())));
        }
        let (scheme, rest) = text.split_once("://").unwrap_or(("http", text));
        let wrong = || AddressError::Malformed(text.to_owned());
        let is_encrypted = match scheme {
            "http" => false,
            "https" => true,
            _ => return Err(wrong()),
        };
        let rest = rest.strip_suffix('/').unwrap_or(rest);
        // The brackets of an IPv6 address separate its colons from the colon before the port.
        let (host, port) = match rest.rsplit_once(':') {
            Some((host, port)) if !port.contains(']') => (host, Some(port)),
            _ => (rest, None),
        };
        let bare = unbracketed(host);
        let bracketed = bare.len() < host.len();
        let foreign = |c: char| c.is_whitespace() || "/?#@[]".contains(c) || (c == ':' && !bracketed);
        if bare.is_empty() || bare.contains(foreign) {
            return Err(wrong());
        }
        if port.is_none() && bare.bytes().all(|byte| byte.is_ascii_digit()) {
            return Err(AddressError::OnlyAPort(bare.to_owned()));
        }
        let port = match port {
            None => DEFAULT_PORT,
            Some(text) => text.parse().ok().filter(|&port| port > 0).ok_or_else(wrong)?,
        };
        Ok(Self(Place::Host { is_encrypted, host: host.to_owned(), port }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
            assert_eq!(address.parse::<Address>().expect(address).to_string(), expected);
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
            assert_eq!(wrong.parse::<Address>(), Err(AddressError::Malformed(wrong.into())));
        }
        assert_eq!("7".parse::<Address>(), Err(AddressError::OnlyAPort("7".into())));
    }

    /// Catches a certificate that is compared with a host in brackets, or with its port.
    #[test]
    fn a_certificate_names_the_bare_host() {
        for (text, expected) in [("https://[::1]:7", Some("::1")), ("a:7", Some("a")), ("unix:/run/x", None)]
        {
            assert_eq!(text.parse::<Address>().expect(text).host(), expected);
        }
    }

    /// Catches a socket's path that is dialled as a host, and a host that is opened as a socket.
    #[test]
    fn an_address_is_a_host_or_a_socket() {
        let parts = |text: &str| {
            let address: Address = text.parse().expect(text);
            (address.authority(), address.socket().map(str::to_owned))
        };
        assert_eq!(parts("localhost"), (Some("localhost:50051".into()), None));
        assert_eq!(parts("unix:/run/x"), (None, Some("/run/x".into())));
        assert_eq!(parts("unix:///run/x"), (None, Some("/run/x".into())));
    }
}
