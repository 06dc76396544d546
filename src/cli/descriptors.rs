//! File descriptors: each connection needs one, and so do the store and the admin port.

use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};

/// Descriptors that are kept for the store, the admin port, the listeners and the runtime. Of
/// a process that may open few, half are kept.
const KEPT: u64 = 128;

/// Raises the limit of open descriptors as far as the system allows, and lowers
/// `max_connections` to what the limit has room for.
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

/// The most descriptors that the process may open, now raised; none where there is no limit.
fn raised() -> Option<u64> {
    let Rlimit { current, maximum } = getrlimit(Resource::Nofile);
    if current != maximum && setrlimit(Resource::Nofile, Rlimit { current: maximum, maximum }).is_ok() {
        return maximum;
    }
    current
}

/// The connections that a limit of open descriptors has room for; at least one.
fn room(limit: u64) -> u64 {
    (limit - KEPT.min(limit / 2)).max(1)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Catches connections that take the store's descriptors, and a limit below which there
    /// are no connections at all.
    #[test]
    fn some_descriptors_are_kept() {
        assert_eq!([1, 64, 256, 1024].map(room), [1, 32, 128, 896]);
    }
}
