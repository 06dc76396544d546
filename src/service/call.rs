//! A call in progress: its log span, and its end.

use std::{
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
    time::Instant,
};

use bytes::Bytes;
use http::HeaderMap;
use hyper::body::Frame;
use tonic::{Code, Status};
use tracing::{Span, span::Entered};

use super::{App, peers::CallSlot};
use crate::{
    budget::Permit,
    contact::Stop,
    metrics::{CallLabels, GaugeGuard},
    trace,
};

/// The header in which a client or a proxy names the call.
const REQUEST_ID: &str = "x-request-id";

/// Longer ids are not logged.
const REQUEST_ID_BYTES: usize = 64;

/// A span that names the call in every line logged for it. It has an id, given by the client or by
/// this server, and the id of the call's trace, taken from `traced` or else from a W3C
/// `traceparent` header.
pub(super) fn span(method: &'static str, headers: &HeaderMap, traced: &Span) -> Span {
    static NEXT: AtomicU64 = AtomicU64::new(1);
    let given = headers.get(REQUEST_ID).and_then(|value| value.to_str().ok());
    let given = given.filter(|id| !id.is_empty() && id.len() <= REQUEST_ID_BYTES);
    let (id, trace) = (tracing::field::Empty, tracing::field::Empty);
    let span = tracing::info_span!("call", method, id, trace);
    if span.is_disabled() {
        return span;
    }
    match given {
        Some(id) => span.record("id", id),
        None => span.record("id", NEXT.fetch_add(1, Ordering::Relaxed)),
    };
    let named = || headers.get("traceparent").and_then(|value| trace_id(value.to_str().ok()?));
    if let Some(trace) = trace::id(traced).as_deref().or_else(named) {
        span.record("trace", trace);
    }
    span
}

/// The trace id in `version-trace-parent-flags`.
fn trace_id(traceparent: &str) -> Option<&str> {
    let mut parts = traceparent.split('-');
    let (version, trace, parent) = (parts.next()?, parts.next()?, parts.next()?);
    let hex = |text: &str, digits: usize| {
        text.len() == digits && text.bytes().all(|b| matches!(b, b'0'..=b'9' | b'a'..=b'f'))
    };
    let good = hex(version, 2) && version != "ff" && hex(trace, 32) && hex(parent, 16);
    (good && trace.bytes().any(|b| b != b'0')).then_some(trace)
}

/// The resources that a call holds until it ends.
#[derive(Debug, Default)]
pub(super) struct CallResources {
    _memory: Option<Permit>,
    _call_slot: Option<CallSlot>,
}

impl CallResources {
    /// `memory` is the fixed cost of a call: its headers, and the state that the transport keeps.
    /// It is `None` for a health check, of which a connection may have a few without asking the
    /// budget. `call_slot` is for calls of which a connection may have only a limited number.
    pub(super) fn new(memory: Option<Permit>, call_slot: Option<CallSlot>) -> Self {
        Self { _memory: memory, _call_slot: call_slot }
    }
}

/// A call in progress. When it is dropped it is counted and logged, and its work stops.
#[derive(Debug)]
pub(super) struct Call {
    app: Arc<App>,
    span: Span,
    traced: Span,
    method: &'static str,
    started: Instant,
    code: Code,
    stop: Arc<Stop>,
    /// The resources of its connection and of the memory budget that the call holds.
    resources: Arc<CallResources>,
    _in_flight: GaugeGuard,
}

impl Call {
    /// A call; dropping it stops the work of `stop`.
    pub(super) fn new(
        app: Arc<App>,
        method: &'static str,
        span: Span,
        traced: Span,
        stop: Arc<Stop>,
        resources: CallResources,
    ) -> Self {
        let in_flight = GaugeGuard::new(&app.metrics().requests_in_flight, 1);
        Self {
            app,
            span,
            traced,
            method,
            started: Instant::now(),
            // This code stays if no other is recorded: a call that is dropped early was cancelled
            // by its client.
            code: Code::Cancelled,
            stop,
            resources: Arc::new(resources),
            _in_flight: in_flight,
        }
    }

    pub(super) fn app(&self) -> &App {
        &self.app
    }

    /// The resources that the call holds. They are held for as long as a clone lives.
    pub(super) fn resources(&self) -> Arc<CallResources> {
        self.resources.clone()
    }

    /// Enters the call's spans. While the guards live, every logged line names the call.
    pub(super) fn enter(&self) -> [Entered<'_>; 2] {
        [self.traced.enter(), self.span.enter()]
    }

    /// Records the code with which the call ends, as far as it is known.
    pub(super) fn ended_with(&mut self, code: Code) {
        self.code = code;
    }

    /// The trailers of an answer that has begun and ends with an error.
    pub(super) fn ended_early(&mut self, status: &Status) -> Result<Frame<Bytes>, Status> {
        self.code = status.code();
        let mut trailers = HeaderMap::new();
        status.add_header(&mut trailers)?;
        Ok(Frame::trailers(trailers))
    }
}

impl Drop for Call {
    fn drop(&mut self) {
        self.stop.stop();
        self.app.metrics().metered(self.stop.steps(), self.stop.largest_between_looks());
        let seconds = self.started.elapsed().as_secs_f64();
        let code = name(self.code);
        tracing::debug!(parent: &self.span, code, ms = seconds * 1e3, "ended");
        trace::ended(&self.traced, self.code);
        self.app.metrics().ended(&CallLabels { method: self.method, code }, seconds);
    }
}

/// The code's name in the gRPC protocol.
pub(super) fn name(code: Code) -> &'static str {
    match code {
        Code::Ok => "OK",
        Code::Cancelled => "CANCELLED",
        Code::Unknown => "UNKNOWN",
        Code::InvalidArgument => "INVALID_ARGUMENT",
        Code::DeadlineExceeded => "DEADLINE_EXCEEDED",
        Code::NotFound => "NOT_FOUND",
        Code::AlreadyExists => "ALREADY_EXISTS",
        Code::PermissionDenied => "PERMISSION_DENIED",
        Code::ResourceExhausted => "RESOURCE_EXHAUSTED",
        Code::FailedPrecondition => "FAILED_PRECONDITION",
        Code::Aborted => "ABORTED",
        Code::OutOfRange => "OUT_OF_RANGE",
        Code::Unimplemented => "UNIMPLEMENTED",
        Code::Internal => "INTERNAL",
        Code::Unavailable => "UNAVAILABLE",
        Code::DataLoss => "DATA_LOSS",
        Code::Unauthenticated => "UNAUTHENTICATED",
    }
}

pub(super) type BoxError = Box<dyn std::error::Error + Send + Sync>;

#[cfg(test)]
mod tests {
    use super::*;

    /// Catches a malformed trace context whose id is logged.
    #[test]
    fn trace_ids_are_of_well_formed_contexts() {
        let trace = "4bf92f3577b34da6a3ce929d0e0e4736";
        assert_eq!(trace_id(&format!("00-{trace}-00f067aa0ba902b7-01")), Some(trace));
        assert_eq!(trace_id(&format!("42-{trace}-00f067aa0ba902b7-01-more")), Some(trace));
        let zero = "0".repeat(32);
        for bad in [
            String::new(),
            format!("ff-{trace}-00f067aa0ba902b7-01"),
            format!("00-{zero}-00f067aa0ba902b7-01"),
            format!("00-{trace}-00f067aa0ba902b-01"),
            format!("00-{}-00f067aa0ba902b7-01", trace.to_uppercase()),
        ] {
            assert_eq!(trace_id(&bad), None, "{bad}");
        }
    }
}
