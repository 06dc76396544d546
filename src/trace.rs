//! Spans for tracing systems. Each call has a span in addition to the one that names it in the logs, and
//! inner spans for the parts that take time. If nothing exports the spans (`--otlp-endpoint`, feature
//! `otlp`), they are not visible and cost next to nothing.

use http::HeaderMap;
use tonic::Code;
use tracing::Span;

/// The target of the spans that are exported and not logged.
pub const TARGET: &str = "hullcast::trace";

/// The span of a call. Its parent is the caller's span, if a W3C `traceparent` header names one.
pub(crate) fn call(method: &'static str, headers: &HeaderMap) -> Span {
    let (service, name) = method.split_once('/').unwrap_or(("", method));
    let span = tracing::info_span!(
        target: TARGET,
        parent: None,
        "call",
        otel.name = method,
        otel.kind = "server",
        rpc.system = "grpc",
        rpc.service = service,
        rpc.method = name,
    );
    #[cfg(feature = "otlp")]
    otel::adopt(&span, headers);
    #[cfg(not(feature = "otlp"))]
    let _ = headers;
    span
}

/// The id of the trace that contains the span, or `None` if nothing exports it.
pub(crate) fn id(span: &Span) -> Option<String> {
    #[cfg(feature = "otlp")]
    return otel::id(span);
    #[cfg(not(feature = "otlp"))]
    {
        let _ = span;
        None
    }
}

/// The span of a batch's wait for its turn.
pub(crate) fn queue(pairs: usize) -> Span {
    tracing::info_span!(target: TARGET, "queue", pairs = number(pairs))
}

/// The span of a batch's computation.
pub(crate) fn compute(pairs: usize) -> Span {
    tracing::info_span!(target: TARGET, "compute", pairs = number(pairs))
}

/// OpenTelemetry has no unsigned numbers, and would export them as text.
fn number(count: usize) -> i64 {
    i64::try_from(count).unwrap_or(i64::MAX)
}

/// The span of reading and building a hull that was not cached.
pub(crate) fn load(hull: &dyn std::fmt::Display) -> Span {
    tracing::info_span!(target: TARGET, "load", %hull)
}

/// Records the code with which the call ended.
pub(crate) fn ended(span: &Span, code: Code) {
    #[cfg(feature = "otlp")]
    otel::ended(span, code);
    #[cfg(not(feature = "otlp"))]
    let _ = (span, code);
}

#[cfg(feature = "otlp")]
mod otel {
    use http::HeaderMap;
    use opentelemetry::{
        propagation::{Extractor, TextMapPropagator},
        trace::{Status, TraceContextExt},
    };
    use opentelemetry_sdk::propagation::TraceContextPropagator;
    use tonic::Code;
    use tracing::Span;
    use tracing_opentelemetry::OpenTelemetrySpanExt;

    struct Headers<'a>(&'a HeaderMap);

    impl Extractor for Headers<'_> {
        fn get(&self, key: &str) -> Option<&str> {
            self.0.get(key)?.to_str().ok()
        }

        fn keys(&self) -> Vec<&str> {
            self.0.keys().map(http::HeaderName::as_str).collect()
        }
    }

    pub(super) fn adopt(span: &Span, headers: &HeaderMap) {
        if !span.is_disabled() && headers.contains_key("traceparent") {
            // This fails only for a span that has already begun, and this one has not.
            let _ = span.set_parent(TraceContextPropagator::new().extract(&Headers(headers)));
        }
    }

    pub(super) fn id(span: &Span) -> Option<String> {
        let trace = || span.context().span().span_context().trace_id().to_string();
        (!span.is_disabled()).then(trace)
    }

    /// Marks the span as failed for the server's own errors only, not for errors of the caller.
    pub(super) fn ended(span: &Span, code: Code) {
        span.set_attribute("rpc.grpc.status_code", i64::from(i32::from(code)));
        if matches!(
            code,
            Code::Unknown
                | Code::DeadlineExceeded
                | Code::Unimplemented
                | Code::Internal
                | Code::Unavailable
                | Code::DataLoss
        ) {
            span.set_status(Status::error(code.description()));
        }
    }
}
