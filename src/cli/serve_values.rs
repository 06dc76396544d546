//! Values of the server's settings: addresses, limits, log filters.
//!
//! As in `values`, the command line's parser adds the option's name and the value to a message.

use std::{net::IpAddr, path};

use hullcast::{service::Limits, size::ByteSize};
use tracing_subscriber::{EnvFilter, filter::LevelFilter};

use super::memory::MemorySize;
use super::values::count;

/// The range of a limit.
fn range(name: &str) -> (u64, u64) {
    Limits::range(name).unwrap_or((0, u64::MAX))
}

/// A parser of the limit called `name`.
pub(crate) fn limit<T: TryFrom<u64>>(name: &'static str) -> impl Fn(&str) -> Result<T, String> + Clone {
    let (least, most) = range(name);
    let parse = count(least, most);
    move |text| parse(text)?.try_into().map_err(|_| format!("expected a whole number from {least} to {most}"))
}

/// A parser of the size called `name`.
pub(crate) fn bytes(name: &'static str) -> impl Fn(&str) -> Result<ByteSize, String> + Clone {
    let (least, most) = range(name);
    let range = Limits::shown_range(name).unwrap_or_default();
    move |text| {
        let size: Option<ByteSize> = text.parse().ok();
        size.filter(|ByteSize(bytes)| (least..=most).contains(bytes))
            .ok_or_else(|| format!("expected {range} (a number of bytes, or with KiB, MiB, GiB or TiB)"))
    }
}

/// A parser of a size within the range of the limit called `name`, or of a percentage of the memory.
pub(crate) fn size(name: &'static str) -> impl Fn(&str) -> Result<MemorySize, String> + Clone {
    let (least, most) = range(name);
    let range = Limits::shown_range(name).unwrap_or_default();
    move |text| {
        let size: Option<MemorySize> = text.parse().ok();
        let allowed = |size: &MemorySize| match size {
            MemorySize::Bytes(bytes) => (least..=most).contains(bytes),
            MemorySize::Share(_) => true,
        };
        size.filter(allowed).ok_or_else(|| {
            format!(
                "expected {range} (a number of bytes, or with KiB, MiB, GiB or TiB), or a percentage of \
                 the memory above 0% and up to 100%"
            )
        })
    }
}

/// The least and the most bytes of a directory of records.
pub(crate) const RECORD_BYTES: (u64, u64) = (1 << 20, 1 << 50);

/// The size of a directory of records.
///
/// # Errors
/// It is no size, or out of its range.
pub(crate) fn record_size(text: &str) -> Result<ByteSize, String> {
    let size: Option<ByteSize> = text.parse().ok();
    size.filter(|ByteSize(bytes)| (RECORD_BYTES.0..=RECORD_BYTES.1).contains(bytes)).ok_or_else(|| {
        "expected 1 MiB to 1024 TiB (a number of bytes, or with KiB, MiB, GiB or TiB)".to_owned()
    })
}

/// Where hulls are kept.
///
/// # Errors
/// It is empty.
pub(crate) fn store_url(text: &str) -> Result<String, String> {
    if text.is_empty() {
        return Err(
            "expected a directory, file://PATH, memory://, or a bucket as in s3://BUCKET/PREFIX".into()
        );
    }
    Ok(text.into())
}

/// An address to answer on.
///
/// # Errors
/// It is neither host and port nor a Unix socket.
pub(crate) fn listen_address(text: &str) -> Result<String, String> {
    let is_unix = text.strip_prefix("unix:").is_some_and(|path| !path.is_empty());
    if is_unix || is_host_and_port(text) {
        return Ok(text.into());
    }
    Err("expected host:port with a port from 0 to 65535 (0: any free one), or unix:PATH".into())
}

/// An address of the admin port; empty means no such port.
///
/// # Errors
/// It is not host and port.
pub(crate) fn admin_address(text: &str) -> Result<String, String> {
    if text.is_empty() || is_host_and_port(text) {
        return Ok(text.into());
    }
    Err("expected host:port with a port from 0 to 65535 (0: any free one), or nothing".into())
}

/// Whether two addresses cannot be bound both: the same path, or the same port of the same host, or of
/// one that includes the other. Port 0 is another port each time.
pub(crate) fn overlap(a: &str, b: &str) -> bool {
    if let (Some(a), Some(b)) = (a.strip_prefix("unix:"), b.strip_prefix("unix:")) {
        return path::absolute(a).ok() == path::absolute(b).ok();
    }
    let parts = |text: &str| {
        text.rsplit_once(':').and_then(|(host, port)| Some((host.to_lowercase(), port.parse::<u16>().ok()?)))
    };
    let (Some((host, port)), Some((other_host, other_port))) = (parts(a), parts(b)) else { return false };
    if port != other_port || port == 0 {
        return false;
    }
    let ip = |host: &str| host.trim_matches(['[', ']']).parse::<IpAddr>().ok();
    match (ip(&host), ip(&other_host)) {
        (Some(a), Some(b)) => {
            a == b || (a.is_ipv4() == b.is_ipv4() && (a.is_unspecified() || b.is_unspecified()))
        }
        // Both names are looked up when they are bound.
        _ => host == other_host,
    }
}

fn is_host_and_port(text: &str) -> bool {
    let Some((host, port)) = text.rsplit_once(':') else { return false };
    let bare = host.strip_prefix('[').and_then(|host| host.strip_suffix(']'));
    // The brackets keep the colons of an IPv6 address apart from the port's.
    let is_host = match bare {
        Some(bare) => bare.parse::<IpAddr>().is_ok_and(|address| address.is_ipv6()),
        None => !host.is_empty() && !host.contains(|c: char| c.is_whitespace() || ":/?#@[]".contains(c)),
    };
    is_host && port.parse::<u16>().is_ok()
}

/// A proxy's address.
///
/// # Errors
/// It is not an IP address.
pub(crate) fn proxy(text: &str) -> Result<IpAddr, String> {
    text.parse().map_err(|_| "expected an IP address, as in 10.0.0.1 or ::1".into())
}

/// The address of a collector of traces; empty means no traces.
///
/// # Errors
/// It is not a URL of `http` or `https` with a host.
pub(crate) fn collector(text: &str) -> Result<String, String> {
    let rest = text.strip_prefix("http://").or_else(|| text.strip_prefix("https://"));
    if text.is_empty() || rest.is_some_and(|rest| text.parse::<http::Uri>().is_ok() && !rest.starts_with('/'))
    {
        return Ok(text.into());
    }
    Err("expected http://HOST:PORT or https://HOST:PORT, or nothing".into())
}

/// Checks a filter of the log.
///
/// # Errors
/// It is neither a level nor a filter.
pub(crate) fn log_filter(text: &str) -> Result<String, String> {
    filter(text).map(|_| text.into())
}

/// Silences the libraries that read the bytes of callers.
const QUIET: &str = "h2=off,hyper=off,hyper_util=off,rustls=off,tokio_rustls=off,tonic=off,tower=off";

/// The filter that a setting of the log stands for.
///
/// A single level applies to hullcast. The libraries below it log at `info` at most. The libraries that read
/// the bytes of callers ([`QUIET`]) log nothing, because nothing limits their lines: the HTTP/2 library
/// warns of every unexpected frame. A filter of several parts is used as it is.
///
/// # Errors
/// It is neither a level nor a filter.
pub(crate) fn filter(text: &str) -> Result<EnvFilter, String> {
    let allowed = "expected error, warn, info, debug, trace or off, or a filter as in hullcast=debug,h2=info";
    let filter = match level(text) {
        Some(level) if level > LevelFilter::INFO => {
            EnvFilter::try_new(format!("info,hullcast={level},{QUIET}"))
        }
        Some(level) => EnvFilter::try_new(format!("{level},{QUIET}")),
        // A part without a level would count as the name of a module, and everything of that
        // module would be logged. A misspelt level looks like such a name.
        None if !text.contains('[') && text.split(',').any(is_no_directive) => return Err(allowed.into()),
        None => EnvFilter::try_new(text),
    };
    filter.map_err(|error| format!("{allowed} ({error})"))
}

fn is_no_directive(part: &str) -> bool {
    !part.contains('=') && level(part).is_none()
}

fn level(text: &str) -> Option<LevelFilter> {
    // An empty text would mean the level `error`.
    text.parse().ok().filter(|_| !text.is_empty())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Catches an address that is refused, and one that the system would refuse later without the
    /// option's name.
    #[test]
    fn addresses_have_a_host_and_a_port() {
        for good in ["localhost:0", "0.0.0.0:50051", "[::1]:1", "a.example:65535"] {
            assert!(listen_address(good).is_ok() && admin_address(good).is_ok(), "{good}");
        }
        assert!(listen_address("unix:/run/x").is_ok() && admin_address("unix:/run/x").is_err());
        assert!(admin_address("").is_ok() && listen_address("").is_err());
        for wrong in ["x", ":1", "a:", "a:65536", "a:-1", "::1:1", "[a]:1", "http://a:1", "a b:1", "unix:"] {
            assert!(listen_address(wrong).is_err() && admin_address(wrong).is_err(), "{wrong}");
        }
        for good in ["", "http://a:1", "https://a"] {
            assert!(collector(good).is_ok(), "{good}");
        }
        for wrong in ["a:1", "http://", "ftp://a", "http:///x", "http://a b"] {
            assert!(collector(wrong).is_err(), "{wrong}");
        }
    }

    /// Catches two addresses of which only one can be bound, and two that can both be bound but are
    /// taken for one.
    #[test]
    fn addresses_that_exclude_each_other_overlap() {
        for (a, b) in [
            ("127.0.0.1:5", "127.0.0.1:5"),
            ("0.0.0.0:5", "127.0.0.1:5"),
            ("[::1]:5", "[::]:5"),
            ("[::1]:5", "[0:0::1]:5"),
            ("Host:5", "host:5"),
            ("unix:a/b", "unix:./a/b"),
        ] {
            assert!(overlap(a, b) && overlap(b, a), "{a} {b}");
        }
        for (a, b) in [
            ("127.0.0.1:0", "127.0.0.1:0"),
            ("127.0.0.1:5", "127.0.0.1:6"),
            ("127.0.0.1:5", "127.0.0.2:5"),
            ("127.0.0.1:5", "[::1]:5"),
            ("unix:a", "unix:b"),
            ("unix:a:5", "a:5"),
        ] {
            assert!(!overlap(a, b) && !overlap(b, a), "{a} {b}");
        }
    }

    /// Catches a misspelt level that is taken for a module's name, so that nothing is logged; and levels that
    /// let lines through of which callers can cause any number.
    #[test]
    fn a_level_is_that_of_hullcast() {
        let parts = |text: &str| filter(text).map(|filter| filter.to_string());
        assert!(parts("warn").is_ok_and(|filter| filter.contains("warn") && filter.contains("h2=off")));
        for (level, own) in [("debug", "hullcast=debug"), ("TRACE", "hullcast=trace")] {
            let filter = parts(level).expect(level);
            assert!(
                filter.contains(own) && filter.contains("info") && filter.contains("rustls=off"),
                "{filter}"
            );
        }
        assert!(parts("debug,h2=debug").is_ok_and(|filter| filter.contains("h2=debug")));
        assert!(parts("hullcast[{id=1}]=debug").is_ok());
        for wrong in ["verbose", "", "debugg", "hullcast", "info,verbose", "hullcast=loud", "6"] {
            assert!(filter(wrong).is_err(), "{wrong}");
        }
    }
}
