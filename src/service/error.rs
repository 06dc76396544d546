//! The service's own errors. `wire` converts them to gRPC statuses.

use std::{fmt, time::Duration};

use thiserror::Error;

use super::reason::Reason;
use crate::contact::Stopped;

/// The location of the fault in the request.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FaultLocation {
    /// The field's name in the contract; a dotted path for nested messages.
    pub field: &'static str,
    /// The index of the element at fault, if a single element is.
    pub index: Option<usize>,
}

/// The error of a call that is refused or fails.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("{reason}{}: {message}", .location.as_ref().map(|location| format!(": {location}")).unwrap_or_default())]
pub struct ServiceError {
    /// The reason, to which the status's code belongs.
    pub reason: Reason,
    /// The message for people.
    pub message: String,
    /// The location of the fault in the request, if there is one.
    pub location: Option<FaultLocation>,
    /// The time to wait before a retry, if a later retry can succeed.
    pub retry_after: Option<Duration>,
}

impl ServiceError {
    /// No single field of the request is at fault, and a retry does not help.
    pub fn new(reason: Reason, message: impl Into<String>) -> Self {
        Self { reason, message: message.into(), location: None, retry_after: None }
    }

    /// The request is malformed at `field`.
    pub fn in_field(reason: Reason, field: &'static str, message: impl Into<String>) -> Self {
        Self { location: Some(FaultLocation { field, index: None }), ..Self::new(reason, message) }
    }

    /// The request is malformed at element `index` of `field`.
    pub fn in_entry(reason: Reason, field: &'static str, index: usize, message: impl Into<String>) -> Self {
        Self { location: Some(FaultLocation { field, index: Some(index) }), ..Self::new(reason, message) }
    }

    /// A retry after `retry_after` may succeed.
    pub fn unavailable(reason: Reason, retry_after: Duration, message: impl Into<String>) -> Self {
        Self { retry_after: Some(retry_after), ..Self::new(reason, message) }
    }

    /// The caller's deadline passed.
    pub fn deadline_exceeded() -> Self {
        Self::new(Reason::DeadlineExceeded, "the deadline passed")
    }

    /// A bug in the server; the log has the details.
    pub fn internal(message: impl Into<String>) -> Self {
        Self::new(Reason::Internal, message)
    }
}

/// Work is stopped if the caller has left, or if its deadline has passed.
impl From<Stopped> for ServiceError {
    fn from(_: Stopped) -> Self {
        Self::deadline_exceeded()
    }
}

impl fmt::Display for FaultLocation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.index {
            Some(index) => write!(f, "{}[{index}]", self.field),
            None => f.write_str(self.field),
        }
    }
}
