//! A call under way: its name, its log span, its bytes, and how it ended.

use std::{
    pin::Pin,
    sync::{
        Arc,
        atomic::{AtomicU64, AtomicUsize, Ordering},
    },
    task::{Context, Poll},
    time::Instant,
};

use bytes::Bytes;
use http::HeaderMap;
use hyper::body::{Body as HttpBody, Frame, SizeHint};
use tonic::{Code, Status, body::Body};
use tracing::Span;

use super::{App, ServiceError};
use crate::{
    metrics::{Call as Ended, Held, Shed},
    trace,
};

/// The methods of the contract, as metrics and logs name them.
const METHODS: [&str; 14] = [
    "/hullcast.v1.ContactService/QueryContacts",
    "/hullcast.v1.ContactService/FindContacts",
    "/hullcast.v1.ContactService/StreamContacts",
    "/hullcast.v1.HullService/RegisterHulls",
    "/hullcast.v1.HullService/GetHulls",
    "/hullcast.v1.HullService/HasHulls",
    "/hullcast.v1.HullService/ListHulls",
    "/hullcast.v1.HullService/DeleteHulls",
    "/hullcast.v1.ServerService/GetServerInfo",
    "/grpc.health.v1.Health/Check",
    "/grpc.health.v1.Health/Watch",
    "/grpc.health.v1.Health/List",
    "/grpc.reflection.v1.ServerReflection/ServerReflectionInfo",
    "/grpc.reflection.v1alpha.ServerReflection/ServerReflectionInfo",
];

/// Where a client or a proxy says which call this is.
const REQUEST_ID: &str = "x-request-id";

/// Longer ones are not ours to log.
const REQUEST_ID_BYTES: usize = 64;

/// The method without the slash before it; `other` for what is not of the contract, since
/// anybody can send anything.
pub(super) fn method(path: &str) -> &'static str {
    let known = METHODS.into_iter().find(|known| *known == path);
    known.and_then(|known| known.strip_prefix('/')).unwrap_or("other")
}

/// Whether a call of it may last as long as its client likes.
pub(super) fn is_long_lived(method: &str) -> bool {
    ["StreamContacts", "Watch", "ServerReflectionInfo"].iter().any(|name| method.ends_with(name))
}

/// A span that names the call in every line logged for it: the client's id, or one of ours,
/// and the trace that it is in: `traced`'s, else the one that a W3C `traceparent` names.
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

/// Of `version-trace-parent-flags`.
fn trace_id(traceparent: &str) -> Option<&str> {
    let mut parts = traceparent.split('-');
    let (version, trace, parent) = (parts.next()?, parts.next()?, parts.next()?);
    let hex = |text: &str, digits: usize| {
        text.len() == digits && text.bytes().all(|b| matches!(b, b'0'..=b'9' | b'a'..=b'f'))
    };
    let good = hex(version, 2) && version != "ff" && hex(trace, 32) && hex(parent, 16);
    (good && trace.bytes().any(|b| b != b'0')).then_some(trace)
}

/// A call under way; counted as ended when dropped.
#[derive(Debug)]
pub(super) struct Call {
    app: Arc<App>,
    span: Span,
    traced: Span,
    method: &'static str,
    started: Instant,
    code: Code,
    bytes: Arc<RequestBytes>,
    _in_flight: Held,
}

impl Call {
    pub(super) fn new(app: Arc<App>, method: &'static str, span: Span, traced: Span) -> Self {
        let in_flight = Held::new(&app.metrics().requests_in_flight, 1);
        let bytes = Arc::new(RequestBytes { app: app.clone(), held: AtomicUsize::new(0) });
        // Until it ends otherwise: whoever drops it has heard that the client left.
        let code = Code::Cancelled;
        Self { app, span, traced, method, started: Instant::now(), code, bytes, _in_flight: in_flight }
    }

    /// The request's body, counted.
    pub(super) fn metered<B>(&self, body: B) -> Metered<B> {
        Metered { body, bytes: self.bytes.clone() }
    }

    /// The response's body, whose end is the call's.
    pub(super) fn answered(mut self, response: http::Response<Body>) -> http::Response<Body> {
        if let Some(status) = Status::from_header_map(response.headers()) {
            self.code = status.code();
        }
        response.map(|body| Body::new(Answer { body, call: self }))
    }
}

impl Drop for Call {
    fn drop(&mut self) {
        let seconds = self.started.elapsed().as_secs_f64();
        let code = name(self.code);
        tracing::debug!(parent: &self.span, code, ms = seconds * 1e3, "ended");
        trace::ended(&self.traced, self.code);
        self.app.metrics().ended(&Ended { method: self.method, code }, seconds);
    }
}

/// As the protocol writes it.
fn name(code: Code) -> &'static str {
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

/// Of one call's request, counted among all calls'.
#[derive(Debug)]
struct RequestBytes {
    app: Arc<App>,
    held: AtomicUsize,
}

impl RequestBytes {
    fn take(&self, bytes: usize) -> Result<(), Status> {
        let gauge = &self.app.metrics().request_bytes_in_flight;
        let before = gauge.inc_by(bytes as i64);
        self.held.fetch_add(bytes, Ordering::Relaxed);
        if before as u64 + bytes as u64 <= self.app.limits().max_request_bytes_in_flight {
            return Ok(());
        }
        self.app.metrics().shed(Shed::RequestBytes);
        let message = "too many bytes of requests are under way; ask again";
        Err(ServiceError::unavailable("TOO_BUSY", BYTES_RETRY, message).into())
    }

    fn release(&self) {
        let held = self.held.swap(0, Ordering::Relaxed);
        self.app.metrics().request_bytes_in_flight.dec_by(held as i64);
    }
}

impl Drop for RequestBytes {
    fn drop(&mut self) {
        self.release();
    }
}

/// Requests that large take some 100 ms to arrive and be answered.
const BYTES_RETRY: std::time::Duration = std::time::Duration::from_millis(200);

pub(super) type BoxError = Box<dyn std::error::Error + Send + Sync>;

/// A request's body, its bytes counted as they come.
#[derive(Debug)]
pub(super) struct Metered<B> {
    body: B,
    bytes: Arc<RequestBytes>,
}

impl<B> HttpBody for Metered<B>
where
    B: HttpBody<Data = Bytes> + Unpin,
    B::Error: Into<BoxError>,
{
    type Data = Bytes;
    type Error = BoxError;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, BoxError>>> {
        let frame = match Pin::new(&mut self.body).poll_frame(cx) {
            Poll::Ready(Some(Ok(frame))) => frame,
            other => return other.map_err(Into::into),
        };
        let bytes = frame.data_ref().map_or(0, Bytes::len);
        Poll::Ready(Some(self.bytes.take(bytes).map(|()| frame).map_err(Into::into)))
    }

    fn is_end_stream(&self) -> bool {
        self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.body.size_hint()
    }
}

/// A response's body; the call ends with it.
struct Answer {
    body: Body,
    call: Call,
}

impl HttpBody for Answer {
    type Data = Bytes;
    type Error = Status;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, Status>>> {
        let this = &mut *self;
        let _entered = (this.call.traced.enter(), this.call.span.enter());
        let polled = Pin::new(&mut this.body).poll_frame(cx);
        if let Poll::Ready(Some(Ok(frame))) = &polled {
            // An answer is under way: what it answers is done with.
            this.call.bytes.release();
            if let Some(status) = frame.trailers_ref().and_then(Status::from_header_map) {
                this.call.code = status.code();
            }
        }
        polled
    }

    fn is_end_stream(&self) -> bool {
        self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.body.size_hint()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Catches a label that anybody can invent: each would be a time series for ever.
    #[test]
    fn methods_that_are_not_there_have_one_name() {
        assert_eq!(method("/hullcast.v1.HullService/GetHulls"), "hullcast.v1.HullService/GetHulls");
        for path in ["", "/", "other", "hullcast.v1.HullService/GetHulls", "/hullcast.v1.HullService/Get"] {
            assert_eq!(method(path), "other");
        }
        assert!(is_long_lived(method(METHODS[2])) && !is_long_lived(method(METHODS[0])));
    }

    /// Catches a malformed context that is logged as a trace.
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
