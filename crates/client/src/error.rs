//! The errors of the client.

use std::error::Error as StdError;
use std::fmt;
use std::time::Duration;

use tonic::{Code, Status, TimeoutExpired};
use tonic_types::StatusExt;

use crate::address::AddressError;
use crate::checked::Malformed;
use crate::reach::{Unreachable, causes, root_cause};

/// Why a call failed.
///
/// The variants, [`Refusal::code`] and [`Refusal::reason`] are stable; the texts are for people and may
/// change.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The address of the server has none of the forms of an address.
    #[error(transparent)]
    Address(#[from] AddressError),
    /// A certificate, a key or the token cannot be used.
    #[error(transparent)]
    Setting(#[from] SettingError),
    /// No server answers, or the peer does not fit the settings of the connection.
    #[error(transparent)]
    Unreachable(#[from] Unreachable),
    /// The server or the connection to it was lost during the call. Another attempt may succeed: it
    /// connects again.
    #[error("{0}")]
    Lost(String),
    /// The server reset the call, because the answer was not read in time.
    #[error(
        "Cancelled: the server reset the call, because the answer was not read in time; the server's \
         settings answer_seconds and max_deadline_seconds decide how long that is"
    )]
    Cut,
    /// The client's own timeout ended before the server answered ([`Builder::timeout`](crate::Builder::timeout)).
    #[error(
        "the server did not answer within the timeout of the client; raise it, or ask for less at a time"
    )]
    TimedOut,
    /// The server refused the call, or failed.
    #[error(transparent)]
    Refused(#[from] Refusal),
    /// The server refused hulls, each for its own reason. The other hulls of the call are registered.
    #[error("{}", first(.0))]
    HullsRefused(Vec<HullRefused>),
    /// The answer is not one that a correct server gives to the request.
    #[error(transparent)]
    Malformed(#[from] Malformed),
    /// The server's version does not know a field or an output of the request, such as `margins`, and ignored it: its
    /// answer is one to another question.
    #[error(
        "the server's version {version} does not know all fields of the request: its answers have the contract \
         number {contract}, expected {needed} or more; update the server"
    )]
    TooOld {
        /// The version of the server.
        version: String,
        /// The contract number of its answers (`QueryContactsResponse.contract`).
        contract: u32,
        /// The contract number that the request needs.
        needed: u32,
    },
    /// A column of a step does not have one entry per body of the session.
    #[error("{field} has {found} entries, expected {expected}: one per body of the session")]
    WrongLength {
        /// The column, such as `positions`.
        field: &'static str,
        /// The number of entries.
        found: usize,
        /// The number of bodies.
        expected: usize,
    },
}

/// The refusal of a call by the server. docs/errors.md lists the codes and reasons.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Refusal {
    /// The gRPC code.
    pub code: Code,
    /// The stable reason in upper case, such as `TOO_MANY_PAIRS`. Empty if the refusal is not a hullcast
    /// server's own, but for example a proxy's.
    pub reason: String,
    /// The message for people.
    pub message: String,
    /// The field of the request that is at fault, if a single one is.
    pub field: Option<String>,
    /// The index of the element of the field that is at fault, if a single one is.
    pub index: Option<usize>,
    /// The time after which the same call may succeed. `None` if the server states none.
    pub retry_after: Option<Duration>,
}

/// The refusal of one hull.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct HullRefused {
    /// The index of the hull among those of the call.
    pub hull: usize,
    /// The field at fault: `vertices`, `contraction_point`, `simplification` or `planarity`.
    pub field: String,
    /// The index of the point at fault, if a single one is.
    pub index: Option<usize>,
    /// The stable reason in upper case, such as `COPLANAR`. `HullError` of the contract lists the reasons.
    pub reason: String,
    /// The message for people.
    pub message: String,
}

/// A setting of the connection that cannot be used.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{setting}: {defect}")]
pub struct SettingError {
    /// The setting.
    pub setting: Setting,
    /// The fault of its value.
    pub defect: Defect,
}

/// A setting of a connection.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Setting {
    /// [`Builder::authority`](crate::Builder::authority).
    Authority,
    /// The certificate of [`Builder::identity`](crate::Builder::identity).
    Certificate,
    /// The key of [`Builder::identity`](crate::Builder::identity).
    Key,
    /// [`Builder::token`](crate::Builder::token).
    Token,
}

/// The fault of a setting of a connection.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum Defect {
    /// The text is not in PEM form.
    #[error("not a PEM file (it has no line -----BEGIN ...-----)")]
    NotPem,
    /// TLS cannot use the content; the text gives the reason.
    #[error("{0}")]
    Unusable(String),
    /// The token is empty, or has characters other than visible ASCII.
    #[error("expected one or more visible ASCII characters")]
    NotAToken,
    /// The setting is for encrypted connections, and the address does not begin with `https://`.
    #[error("only connections to an address that begins with https:// are encrypted")]
    NotEncrypted,
}

impl Error {
    /// The time after which the same call may succeed, if the server stated one.
    pub fn retry_after(&self) -> Option<Duration> {
        match self {
            Self::Refused(refusal) => refusal.retry_after,
            _ => None,
        }
    }

    /// Whether the server refused the call for this reason.
    pub(crate) fn is_for(&self, reasons: &[&str]) -> bool {
        matches!(self, Self::Refused(refusal) if reasons.contains(&refusal.reason.as_str()))
    }
}

impl From<Status> for Error {
    fn from(status: Status) -> Self {
        let has_cause = |is: fn(&(dyn StdError + 'static)) -> bool| {
            status.source().is_some_and(|source| causes(source).any(is))
        };
        if has_cause(|cause| cause.is::<TimeoutExpired>()) {
            return Self::TimedOut;
        }
        // Nothing in this process cancels a call and then reads its status. So the server cancelled the call,
        // unless hyper did because the connection broke.
        let is_broken = has_cause(|cause| cause.downcast_ref().is_some_and(hyper::Error::is_canceled));
        if status.code() == Code::Cancelled && !is_broken {
            return Self::Cut;
        }
        let refusal = Refusal::of(&status);
        // A status with a cause was made by tonic in this process, not sent by a server.
        if refusal.retry_after.is_some() || (status.code() != Code::Unavailable && status.source().is_none())
        {
            return Self::Refused(refusal);
        }
        Self::Lost(match (status.code(), status.source()) {
            // If the failure is tonic's own, the cause says more than tonic's message.
            (Code::Unknown | Code::Unavailable, Some(source)) => root_cause(source),
            _ => refusal.to_string(),
        })
    }
}

impl Refusal {
    fn of(status: &Status) -> Self {
        let details = status.get_error_details();
        let metadata = |key: &str| details.error_info().and_then(|info| info.metadata.get(key)).cloned();
        Self {
            code: status.code(),
            reason: details.error_info().map(|info| info.reason.clone()).unwrap_or_default(),
            message: status.message().to_owned(),
            field: metadata("field"),
            index: metadata("index").and_then(|index| index.parse().ok()),
            retry_after: details.retry_info().and_then(|info| info.retry_delay),
        }
    }
}

impl StdError for Refusal {}

impl fmt::Display for Refusal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:?}: {}", self.code, self.message)
    }
}

impl StdError for HullRefused {}

impl fmt::Display for HullRefused {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "hulls[{}].{}", self.hull, self.field)?;
        if let Some(index) = self.index {
            write!(f, "[{index}]")?;
        }
        write!(f, ": {}: {}", self.reason, self.message)
    }
}

impl fmt::Display for Setting {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Authority => "authority",
            Self::Certificate => "certificate",
            Self::Key => "key",
            Self::Token => "token",
        })
    }
}

/// The first refusal, and the number of the others.
fn first(refused: &[HullRefused]) -> String {
    match refused {
        [] => "no hull was refused".into(),
        [one] => one.to_string(),
        [one, others @ ..] => format!("{one} (and {} more refused)", others.len()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Catches a call that the server cut and that looks like a lost server: another server would be asked,
    /// and the reader would not learn the reason.
    #[test]
    fn a_call_that_was_cut_is_not_a_lost_server() {
        let cut = Error::from(Status::cancelled("h2 protocol error: stream error received"));
        assert_eq!(cut, Error::Cut);
        assert!(cut.to_string().contains("answer_seconds"));
        assert_eq!(
            Error::from(Status::unavailable("gone")),
            Error::Lost("Unavailable: gone".into()),
            "a proxy answers so if it has lost its server"
        );
    }

    /// Catches a timeout of the client itself that is taken for a cancellation by the server.
    #[test]
    fn a_timeout_of_this_process_is_one() {
        assert_eq!(Error::from(Status::from_error(Box::new(TimeoutExpired(())))), Error::TimedOut);
    }

    /// Catches a refusal whose reason, place or pause is lost, and a busy server that is taken for a lost
    /// one.
    #[test]
    fn a_refusal_keeps_its_details() {
        use tonic_types::ErrorDetails;
        let mut details = ErrorDetails::new();
        let place = [("field", "pairs"), ("index", "17")].map(|(k, v)| (k.to_owned(), v.to_owned()));
        details.set_error_info(
            "INDEX_OUT_OF_RANGE",
            "hullcast",
            place.into_iter().collect::<std::collections::HashMap<_, _>>(),
        );
        let status = Status::with_error_details(Code::InvalidArgument, "beyond", details);
        let expected = Refusal {
            code: Code::InvalidArgument,
            reason: "INDEX_OUT_OF_RANGE".into(),
            message: "beyond".into(),
            field: Some("pairs".into()),
            index: Some(17),
            retry_after: None,
        };
        assert_eq!(Error::from(status), Error::Refused(expected));
        let pause = Duration::from_millis(20);
        let status =
            Status::with_error_details(Code::Unavailable, "busy", ErrorDetails::with_retry_info(Some(pause)));
        assert_eq!(Error::from(status).retry_after(), Some(pause));
    }

    /// Catches a message about several hulls that hides how many are refused.
    #[test]
    fn refused_hulls_are_counted() {
        let one = HullRefused {
            hull: 3,
            field: "vertices".into(),
            index: Some(9),
            reason: "NOT_FINITE".into(),
            message: "a NaN".into(),
        };
        let text = |refused: &[HullRefused]| Error::HullsRefused(refused.to_vec()).to_string();
        assert_eq!(text(std::slice::from_ref(&one)), "hulls[3].vertices[9]: NOT_FINITE: a NaN");
        assert!(text(&[one.clone(), one.clone(), one]).ends_with("(and 2 more refused)"));
    }
}
