//! Whether new calls are welcome, for probes.

use std::fmt;

/// Where the server is in its life.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Readiness {
    /// It does not serve yet.
    Starting,
    /// All is well.
    Ready,
    /// What is cached is answered; the store fails, for this reason.
    Degraded(String),
    /// It was told to stop.
    Stopping,
}

impl Readiness {
    /// Whether a balancer should send calls here.
    pub fn welcomes(&self) -> bool {
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
