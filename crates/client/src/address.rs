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
/// An address without a port means port 50051. Only `https://` is encrypted. It is displayed as a URL with
/// scheme and port.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Address {
    url: String,
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
        self.url.starts_with("https://")
    }

    /// `host:port`, or `None` for a Unix socket.
    pub(crate) fn authority(&self) -> Option<&str> {
        self.url.split_once("://").filter(|_| self.socket().is_none()).map(|(_, authority)| authority)
    }

    /// The path of a Unix socket.
    pub(crate) fn socket(&self) -> Option<&str> {
        self.url.strip_prefix("unix:").map(|path| path.trim_start_matches("//"))
    }
}

impl fmt::Display for Address {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.url)
    }
}

impl FromStr for Address {
    type Err = AddressError;

    fn from_str(text: &str) -> Result<Self, AddressError> {
        if text.starts_with("unix:") {
            return Ok(Self { url: text.to_owned() });
        }
        let (scheme, rest) = text.split_once("://").unwrap_or(("http", text));
        let wrong = || AddressError::Malformed(text.to_owned());
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
            return Err(AddressError::OnlyAPort(bare.to_owned()));
        }
        let port = match port {
            None => DEFAULT_PORT,
            Some(text) => text.parse().ok().filter(|&port| port > 0).ok_or_else(wrong)?,
        };
        Ok(Self { url: format!("{scheme}://{host}:{port}") })
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

    /// Catches a socket's path that is dialled as a host, and a host that is opened as a socket.
    #[test]
    fn an_address_is_a_host_or_a_socket() {
        let parts = |text: &str| {
            let address: Address = text.parse().expect(text);
            (address.authority().map(str::to_owned), address.socket().map(str::to_owned))
        };
        assert_eq!(parts("localhost"), (Some("localhost:50051".into()), None));
        assert_eq!(parts("unix:/run/x"), (None, Some("/run/x".into())));
        assert_eq!(parts("unix:///run/x"), (None, Some("/run/x".into())));
    }
}
