//! The configuration of a server under attack.

use std::path::Path;

/// The size of an attack and of the budgets of the server under attack.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Size {
    /// A tenth of the default limits, for `make test-abuse-short`.
    Tenth,
    /// The default limits, for `make test-abuse`.
    Full,
}

impl Size {
    /// `full` at full size, otherwise a tenth of it.
    pub(crate) fn of(self, full: usize) -> usize {
        match self {
            Self::Full => full,
            Self::Tenth => full.div_ceil(10),
        }
    }
}

/// The settings with which a server is started.
pub(crate) struct Setup {
    pub(crate) size: Size,
    /// Command-line flags in addition to those of the size.
    pub(crate) arguments: Vec<String>,
    /// Whether calls need a token. The attacker has no token.
    pub(crate) tokens: bool,
    /// Whether TCP is encrypted.
    pub(crate) tls: bool,
    /// Whether the attacker connects over a Unix socket. The bystander always uses TCP.
    pub(crate) over_unix: bool,
    /// Arguments for the shell's `ulimit`, for example `-n 64`.
    pub(crate) ulimit: Option<String>,
    /// The size of the hull cache in bytes, or `None` for the default of the size.
    pub(crate) cache: Option<u64>,
    /// Fills the store's directory before the server starts.
    pub(crate) fill_store: Option<fn(&Path)>,
}

impl Setup {
    pub(crate) fn new(size: Size) -> Self {
        Self {
            size,
            arguments: Vec::new(),
            tokens: false,
            tls: false,
            over_unix: false,
            ulimit: None,
            cache: None,
            fill_store: None,
        }
    }

    pub(crate) fn tokens(self) -> Self {
        Self { tokens: true, ..self }
    }

    pub(crate) fn tls(self) -> Self {
        Self { tls: true, ..self }
    }

    pub(crate) fn over_unix(self) -> Self {
        Self { over_unix: true, ..self }
    }

    pub(crate) fn cache(self, bytes: u64) -> Self {
        Self { cache: Some(bytes), ..self }
    }

    pub(crate) fn with(mut self, argument: impl Into<String>) -> Self {
        self.arguments.push(argument.into());
        self
    }

    /// The memory budget in bytes.
    pub(crate) fn memory_bytes(&self) -> u64 {
        match self.size {
            Size::Full => 2 << 30,
            // The smallest budget that the server accepts.
            Size::Tenth => 256 << 20,
        }
    }

    /// The size of the hull cache in bytes.
    pub(crate) fn cache_bytes(&self) -> u64 {
        self.cache.unwrap_or(self.size.of(1 << 30) as u64)
    }

    /// The largest message in bytes.
    pub(crate) fn message_bytes(&self) -> usize {
        self.size.of(64 << 20)
    }

    /// The server's command-line flags for this size.
    pub(crate) fn flags(&self) -> Vec<String> {
        let tenth = |name: &str, full: usize| format!("--{name}={}", Size::Tenth.of(full));
        let mut flags = match self.size {
            Size::Full => vec![],
            Size::Tenth => vec![
                format!("--max-memory-bytes={}", self.memory_bytes()),
                tenth("max-message-bytes", 64 << 20),
                tenth("max-request-bytes-in-flight", 1 << 30),
                tenth("max-stream-state-bytes", 256 << 20),
                tenth("max-pairs-per-request", 131_072),
                tenth("max-bodies-per-request", 131_072),
                tenth("max-hulls-per-request", 16_384),
                // Enough for two faces with a tenth of the sides, rounded up.
                tenth("max-vertices-per-hull", 16_400),
                tenth("max-points-per-hull", 262_144),
                tenth("max-pairs-in-flight", 1 << 20),
                tenth("max-connections", 10_000),
                tenth("max-streams-per-connection", 1024),
                tenth("max-page-size", 10_000),
                tenth("max-deadline-seconds", 300),
                tenth("message-seconds", 30),
                tenth("answer-seconds", 30),
            ],
        };
        flags.push(format!("--cache-bytes={}", self.cache_bytes()));
        flags.extend(self.arguments.iter().cloned());
        flags
    }
}
