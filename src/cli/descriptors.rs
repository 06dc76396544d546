//! File descriptors. Each connection needs one, and so do the store and the admin port.

use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};

/// Descriptors that are reserved for the store, the admin port, the listeners and the runtime. If the
/// process may open only a few, half of them are reserved.
const KEPT: u64 = 128;

/// Raises the limit of open descriptors as far as the system allows, and returns `max_connections`,
/// lowered if the limit leaves too few descriptors for it.
pub(crate) fn connections(max_connections: u32) -> u32 {
    let Some(limit) = raised() else { return max_connections };
    let allowed = room(limit);
    if allowed >= u64::from(max_connections) {
        return max_connections;
    }
    tracing::warn!(
        max_connections,
        open_files = limit,
        allowed,
        "the system allows too few open files for max_connections: fewer connections are accepted; \
         raise the limit (ulimit -n, LimitNOFILE)"
    );
    u32::try_from(allowed).unwrap_or(max_connections)
}

/// Raises the limit and returns how many descriptors the process may open, or `None` if there is no limit.
fn raised() -> Option<u64> {
    let Rlimit { current, maximum } = getrlimit(Resource::Nofile);
    if current != maximum && setrlimit(Resource::Nofile, Rlimit { current: maximum, maximum }).is_ok() {
        return maximum;
    }
    current
}

/// The number of connections that a limit of open descriptors allows; at least one.
fn room(limit: u64) -> u64 {
    (limit - KEPT.min(limit / 2)).max(1)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Catches connections that take the store's descriptors, and a limit so low that no connections remain.
    #[test]
    fn some_descriptors_are_kept() {
        assert_eq!([1, 64, 256, 1024].map(room), [1, 32, 128, 896]);
    }
}
