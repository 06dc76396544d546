//! Converts errors to gRPC statuses; every status carries an `ErrorInfo`.

use std::collections::HashMap;

use tonic::{Code, Status, metadata::MetadataMap};
use tonic_types::{ErrorDetails, StatusExt};

use crate::service::error::{Kind, ServiceError};

/// The domain of `ErrorInfo`.
pub const DOMAIN: &str = "hullcast";

/// The trailer that tells a gRPC client's retry policy when to retry.
const PUSHBACK: &str = "grpc-retry-pushback-ms";

impl From<ServiceError> for Status {
    fn from(error: ServiceError) -> Self {
        let mut about = HashMap::new();
        let mut details = ErrorDetails::new();
        if let Some(place) = &error.place {
            about.insert("field".to_owned(), place.field.to_owned());
            if let Some(index) = place.index {
                about.insert("index".to_owned(), index.to_string());
            }
            if error.kind == Kind::Invalid {
                details.add_bad_request_violation(place.to_string(), &error.message);
            }
        }
        details.set_error_info(error.reason, DOMAIN, about);

        let mut metadata = MetadataMap::new();
        if let Kind::Unavailable { retry_after } = error.kind {
            details.set_retry_info(Some(retry_after));
            metadata.insert(PUSHBACK, u64::try_from(retry_after.as_millis()).unwrap_or(u64::MAX).into());
        }
        Self::with_error_details_and_metadata(code(error.kind), error.to_string(), details, metadata)
    }
}

fn code(kind: Kind) -> Code {
    match kind {
        Kind::Invalid => Code::InvalidArgument,
        Kind::Unavailable { .. } => Code::Unavailable,
        Kind::Exhausted => Code::ResourceExhausted,
        Kind::Unauthenticated => Code::Unauthenticated,
        Kind::Forbidden => Code::PermissionDenied,
        Kind::DeadlineExceeded => Code::DeadlineExceeded,
        Kind::Internal => Code::Internal,
    }
}

/// Gives a status from the transport the code and details of the contract. A status that already
/// has details stays as it is.
pub(in crate::service) fn complete(status: Status) -> Status {
    if !status.details().is_empty() {
        return status;
    }
    let message = status.message();
    let (code, reason) = match status.code() {
        Code::OutOfRange => (Code::InvalidArgument, "MESSAGE_TOO_LARGE"),
        Code::Unimplemented if message.contains("compressed") => {
            (Code::Unimplemented, "COMPRESSION_UNSUPPORTED")
        }
        Code::Unimplemented => (Code::Unimplemented, "UNKNOWN_METHOD"),
        // tonic reports a message that cannot be parsed as an internal error.
        Code::Internal if message.contains("compress") => (Code::InvalidArgument, "COMPRESSION_UNSUPPORTED"),
        Code::Internal => (Code::InvalidArgument, "MALFORMED_MESSAGE"),
        Code::Cancelled => (Code::Cancelled, "CANCELLED"),
        Code::InvalidArgument => (Code::InvalidArgument, "MALFORMED_MESSAGE"),
        Code::NotFound => (Code::NotFound, "NOT_FOUND"),
        Code::Unavailable => (Code::Unavailable, "UNAVAILABLE"),
        Code::DeadlineExceeded => (Code::DeadlineExceeded, "DEADLINE_EXCEEDED"),
        other => (other, "UNKNOWN"),
    };
    let message = if message.is_empty() { reason.to_owned() } else { message.to_owned() };
    let details = ErrorDetails::with_error_info(reason, DOMAIN, HashMap::<String, String>::new());
    Status::with_error_details(code, message, details)
}
