//! Converts errors to gRPC statuses; every status carries an `ErrorInfo`.

use std::collections::HashMap;

use tonic::{Code, Status, metadata::MetadataMap};
use tonic_types::{ErrorDetails, StatusExt};

use crate::service::{Reason, ServiceError};

/// The domain of `ErrorInfo`.
pub const DOMAIN: &str = "hullcast";

/// The trailer that tells a gRPC client's retry policy when to retry.
const PUSHBACK: &str = "grpc-retry-pushback-ms";

/// The header that lists the compressions that a server supports.
const SUPPORTED_COMPRESSIONS: &str = "grpc-accept-encoding";

impl From<ServiceError> for Status {
    fn from(error: ServiceError) -> Self {
        let mut about = HashMap::new();
        let mut details = ErrorDetails::new();
        if let Some(location) = &error.location {
            about.insert("field".to_owned(), location.field.to_owned());
            if let Some(index) = location.index {
                about.insert("index".to_owned(), index.to_string());
            }
            if error.reason.code() == Code::InvalidArgument {
                details.add_bad_request_violation(location.to_string(), &error.message);
            }
        }
        details.set_error_info(error.reason.name(), DOMAIN, about);

        let mut metadata = MetadataMap::new();
        if let Some(retry_after) = error.retry_after {
            details.set_retry_info(Some(retry_after));
            metadata.insert(PUSHBACK, u64::try_from(retry_after.as_millis()).unwrap_or(u64::MAX).into());
        }
        Self::with_error_details_and_metadata(error.reason.code(), error.to_string(), details, metadata)
    }
}

/// Gives a status from the transport the code and details of the contract. A status that already
/// has details stays as it is.
pub(in crate::service) fn complete(status: Status) -> Status {
    if !status.details().is_empty() {
        return status;
    }
    let reason = match status.code() {
        Code::OutOfRange => Reason::MessageTooLarge,
        // A refusal of a compression names the compressions that the server supports, as the protocol requires.
        Code::Unimplemented if status.metadata().contains_key(SUPPORTED_COMPRESSIONS) => {
            Reason::CompressionUnsupported
        }
        Code::Unimplemented => Reason::UnknownMethod,
        // tonic reports a message that cannot be parsed as an internal error.
        Code::Internal | Code::InvalidArgument => Reason::MalformedMessage,
        Code::NotFound => Reason::NotFound,
        Code::DeadlineExceeded => Reason::DeadlineExceeded,
        // The other codes come from a connection or a stream that broke.
        _ => Reason::Cancelled,
    };
    let message = if status.message().is_empty() { reason.name() } else { status.message() };
    let details = ErrorDetails::with_error_info(reason.name(), DOMAIN, HashMap::<String, String>::new());
    Status::with_error_details(reason.code(), message, details)
}
