//! The service's own errors. `wire` converts them to gRPC statuses.

use std::{fmt, time::Duration};

use crate::contact::Stopped;

/// Error class: who caused the error, and whether a retry can succeed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// The request is malformed or over a limit; a retry fails too.
    Invalid,
    /// A later retry can succeed.
    Unavailable {
        /// The time to wait before the retry.
        retry_after: Duration,
    },
    /// A quota is used up.
    Exhausted,
    /// The call has no known token.
    Unauthenticated,
    /// The caller is known but may not make this call.
    Forbidden,
    /// The caller's deadline passed.
    DeadlineExceeded,
    /// A bug in the server.
    Internal,
}

/// The place of the fault in the request.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Place {
    /// The field's name in the contract; a dotted path for nested messages.
    pub field: &'static str,
    /// The index of the element at fault, if a single element is.
    pub index: Option<usize>,
}

/// The reason why a call is refused.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ServiceError {
    /// The error class.
    pub kind: Kind,
    /// The reason, stable and in upper case: `ErrorInfo.reason`.
    pub reason: &'static str,
    /// The message for people.
    pub message: String,
    /// The place of the fault in the request, if there is one.
    pub place: Option<Place>,
}

impl ServiceError {
    fn new(kind: Kind, reason: &'static str, message: String, place: Option<Place>) -> Self {
        Self { kind, reason, message, place }
    }

    /// The request is malformed at `field`.
    pub fn invalid(reason: &'static str, field: &'static str, message: impl Into<String>) -> Self {
        Self::new(Kind::Invalid, reason, message.into(), Some(Place { field, index: None }))
    }

    /// The request is malformed at element `index` of `field`.
    pub fn invalid_at(
        reason: &'static str,
        field: &'static str,
        index: usize,
        message: impl Into<String>,
    ) -> Self {
        Self::new(Kind::Invalid, reason, message.into(), Some(Place { field, index: Some(index) }))
    }

    /// The request is refused for its size or form, and no single field is at fault.
    pub fn refused(reason: &'static str, message: impl Into<String>) -> Self {
        Self::new(Kind::Invalid, reason, message.into(), None)
    }

    /// A retry after `retry_after` may succeed.
    pub fn unavailable(reason: &'static str, retry_after: Duration, message: impl Into<String>) -> Self {
        Self::new(Kind::Unavailable { retry_after }, reason, message.into(), None)
    }

    /// The call has no known token.
    pub fn unauthenticated(reason: &'static str, message: impl Into<String>) -> Self {
        Self::new(Kind::Unauthenticated, reason, message.into(), None)
    }

    /// The caller is known but may not make this call.
    pub fn forbidden(reason: &'static str, message: impl Into<String>) -> Self {
        Self::new(Kind::Forbidden, reason, message.into(), None)
    }

    /// The store has no room.
    pub fn store_full(message: impl Into<String>) -> Self {
        Self::new(Kind::Exhausted, "STORE_FULL", message.into(), None)
    }

    /// The caller's deadline passed.
    pub fn deadline_exceeded() -> Self {
        Self::new(Kind::DeadlineExceeded, "DEADLINE_EXCEEDED", "the deadline passed".into(), None)
    }

    /// The caller did not send the whole message in time.
    pub fn message_late(message: impl Into<String>) -> Self {
        Self::new(Kind::DeadlineExceeded, "MESSAGE_LATE", message.into(), None)
    }

    /// The caller has reached a limit on the number of things that it may have at
    /// the same time.
    pub fn exhausted(reason: &'static str, message: impl Into<String>) -> Self {
        Self::new(Kind::Exhausted, reason, message.into(), None)
    }

    /// A bug in the server; the log has the details.
    pub fn internal(message: impl Into<String>) -> Self {
        Self::new(Kind::Internal, "INTERNAL", message.into(), None)
    }
}

/// Work is stopped if the caller has left, or if its deadline has passed.
impl From<Stopped> for ServiceError {
    fn from(_: Stopped) -> Self {
        Self::deadline_exceeded()
    }
}

impl fmt::Display for ServiceError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.reason)?;
        if let Some(place) = &self.place {
            write!(f, ": {place}")?;
        }
        write!(f, ": {}", self.message)
    }
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.index {
            Some(index) => write!(f, "{}[{index}]", self.field),
            None => f.write_str(self.field),
        }
    }
}

impl std::error::Error for ServiceError {}
