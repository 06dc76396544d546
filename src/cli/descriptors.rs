//! File descriptors. Each connection needs one, and so do the store and the admin port.

use hullcast::{service::ADMIN_CONNECTIONS, store::blobs};
use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};

use super::{Error, exit::Exit, settings::Settings};

/// The descriptors of the process itself: standard input and output, the async runtime's, and those of
/// files that are read again and of names that are looked up.
const OF_THE_PROCESS: u64 = 24;

/// The least number of connections with which a server is useful: as many as are reserved for addresses
/// without a connection, unless `max_connections` is less.
const LEAST_CONNECTIONS: u32 = 16;

/// The descriptors that a server may open.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Descriptors {
    /// How many there are; none if the system sets no limit.
    limit: Option<u64>,
    /// How many the server needs besides its connections.
    reserved: u64,
}

/// Raises the limit of open descriptors as far as the system allows, and compares it with the settings.
///
/// # Errors
/// The server could not work with so few.
pub(crate) fn checked(settings: &Settings) -> Result<Descriptors, Error> {
    let admin = if settings.admin_listen.is_empty() { 0 } else { 1 + ADMIN_CONNECTIONS };
    let needs = [
        ("the process", OF_THE_PROCESS),
        ("listen", settings.listen.len() as u64),
        ("admin_listen", admin),
        ("store", blobs::descriptors(&settings.store)),
    ];
    let descriptors = Descriptors { limit: raised(), reserved: needs.iter().map(|(_, count)| count).sum() };
    descriptors
        .refusal(&needs, settings.max_connections)
        .map_or(Ok(descriptors), |why| Err(Exit::Failed.error(why)))
}

impl Descriptors {
    /// Why a server does not start with so few descriptors; none if it does.
    fn refusal(&self, needs: &[(&str, u64)], max_connections: u32) -> Option<String> {
        let connections = max_connections.min(LEAST_CONNECTIONS);
        let least = self.reserved + u64::from(connections);
        let limit = self.limit.filter(|&limit| limit < least)?;
        let parts: Vec<_> = needs
            .iter()
            .filter(|(_, count)| *count > 0)
            .map(|(name, count)| format!("{count} for {name}"))
            .collect();
        Some(format!(
            "the system allows {limit} open files, must be at least {least}: {} and {connections} for connections \
             (max_connections is {max_connections}); raise the limit (ulimit -n, LimitNOFILE)",
            parts.join(", ")
        ))
    }

    /// The number of connections that can be served, at most `max_connections`. Logs if it is less.
    pub(crate) fn connections(&self, max_connections: u32) -> u32 {
        let Some(limit) = self.limit else { return max_connections };
        let allowed = u32::try_from(limit.saturating_sub(self.reserved)).unwrap_or(u32::MAX);
        if allowed >= max_connections {
            return max_connections;
        }
        tracing::warn!(
            max_connections,
            open_files = limit,
            reserved = self.reserved,
            served = allowed,
            "the system allows too few open files for max_connections: fewer connections are served; \
             raise the limit (ulimit -n, LimitNOFILE)"
        );
        allowed
    }
}

/// Raises the limit and returns how many descriptors the process may open, or `None` if there is no limit.
fn raised() -> Option<u64> {
    let Rlimit { current, maximum } = getrlimit(Resource::Nofile);
    if current != maximum && setrlimit(Resource::Nofile, Rlimit { current: maximum, maximum }).is_ok() {
        return maximum;
    }
    current
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Catches connections that take the store's descriptors, a limit that is off by one, and a refusal
    /// without its numbers.
    #[test]
    fn the_least_number_of_descriptors_is_exact() {
        let needs = [("the process", 24), ("listen", 1), ("admin_listen", 0), ("store", 99)];
        let of = |limit| Descriptors { limit, reserved: 124 };
        let refused = of(Some(139)).refusal(&needs, 10_000).expect("one descriptor is missing");
        let parts =
            "must be at least 140: 24 for the process, 1 for listen, 99 for store and 16 for connections";
        assert!(refused.contains("allows 139 open files") && refused.contains(parts), "{refused}");
        assert_eq!(of(Some(140)).refusal(&needs, 10_000), None);
        assert_eq!(of(Some(126)).refusal(&needs, 2), None);
        assert!(of(Some(125)).refusal(&needs, 2).is_some());
        assert_eq!(of(None).refusal(&needs, u32::MAX), None);
        assert_eq!([140, 1024, 1 << 40].map(|limit| of(Some(limit)).connections(10_000)), [16, 900, 10_000]);
        assert_eq!(of(None).connections(10_000), 10_000);
    }
}
