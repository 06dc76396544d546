//! Whether the server accepts new calls, for probes.

use std::fmt;

/// The state of the server.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Readiness {
    /// The server does not serve yet.
    Starting,
    /// The server and its store work.
    Ready,
    /// The store fails, for the given reason; cached hulls are still served.
    Degraded(String),
    /// The server was told to stop.
    Stopping,
}

impl Readiness {
    /// Whether a load balancer should send calls to this server.
    pub fn accepts_calls(&self) -> bool {
        matches!(self, Self::Ready | Self::Degraded(_))
    }
}

impl fmt::Display for Readiness {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Starting => f.write_str("starting"),
            Self::Ready => f.write_str("ready"),
            Self::Degraded(why) => write!(f, "degraded: {why}"),
            Self::Stopping => f.write_str("stopping"),
        }
    }
}
