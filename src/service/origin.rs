//! The origins of pages that may call this server from a browser.

use std::{net::Ipv6Addr, str::FromStr};

use http::uri::Authority;
use serde::Serialize;

/// An origin, as browsers write it: scheme and host in lower case, and the port if it is not the scheme's own.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[serde(transparent)]
pub struct Origin(String);

impl Origin {
    /// The text that browsers send in the header `origin`.
    #[must_use]
    pub fn as_str(&self) -> &str {
        &self.0
    }

    /// The host, without the port. An IPv6 address has its brackets.
    #[must_use]
    pub fn host(&self) -> &str {
        let authority = self.0.split_once("://").map_or("", |(_, authority)| authority);
        match authority.rsplit_once(':') {
            Some((host, port)) if !port.ends_with(']') => host,
            _ => authority,
        }
    }
}

impl FromStr for Origin {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let parsed = || {
            let text = text.to_ascii_lowercase();
            let (scheme, rest) = text.split_once("://")?;
            let own_port = match scheme {
                "http" => 80,
                "https" => 443,
                _ => return None,
            };
            let authority: Authority = rest.parse().ok()?;
            let host = authority.host();
            let is_name = |host: &str| {
                !host.is_empty() && host.bytes().all(|b| b.is_ascii_alphanumeric() || b"-._".contains(&b))
            };
            let in_brackets = host.strip_prefix('[').and_then(|host| host.strip_suffix(']'));
            let is_host = in_brackets.map_or_else(|| is_name(host), |host| host.parse::<Ipv6Addr>().is_ok());
            match rest.strip_prefix(host)? {
                _ if !is_host => None,
                "" => Some(Self(format!("{scheme}://{host}"))),
                port => match port.strip_prefix(':')?.parse::<u16>().ok()? {
                    0 => None,
                    port if port == own_port => Some(Self(format!("{scheme}://{host}"))),
                    port => Some(Self(format!("{scheme}://{host}:{port}"))),
                },
            }
        };
        parsed().ok_or_else(|| {
            "expected http://HOST or https://HOST, with :PORT if the page's address has it, and no path"
                .into()
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Catches an origin that is kept in a form that no browser sends, so that its pages are refused.
    #[test]
    fn an_origin_is_kept_as_browsers_send_it() {
        for (given, kept, host) in [
            ("https://app.example.org", "https://app.example.org", "app.example.org"),
            ("HTTPS://App.Example.org:443", "https://app.example.org", "app.example.org"),
            ("http://localhost:8000", "http://localhost:8000", "localhost"),
            ("http://10.0.0.1:80", "http://10.0.0.1", "10.0.0.1"),
            ("http://[::1]:3000", "http://[::1]:3000", "[::1]"),
            ("http://[::1]", "http://[::1]", "[::1]"),
        ] {
            let origin: Origin = given.parse().unwrap();
            assert_eq!((origin.as_str(), origin.host()), (kept, host));
        }
    }

    /// Catches a text that is accepted although it can be no origin, so that an operator believes in a list
    /// that allows nothing, or everything.
    #[test]
    fn other_texts_are_refused() {
        for given in [
            "",
            "*",
            "null",
            "app.example.org",
            "https://",
            "https://*",
            "https://*.example.org",
            "https://app.example.org/",
            "https://app.example.org/path",
            "https://user@app.example.org",
            "https://app.example.org:0",
            "https://app.example.org:65536",
            "https://app.example.org:",
            "https://b\u{fc}ro.example",
            "ftp://app.example.org",
            "http://[::1",
            "http://[zz]",
        ] {
            assert!(given.parse::<Origin>().is_err(), "{given}");
        }
    }
}
