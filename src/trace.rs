//! What a call is to a tracing system: a span of its own, beside the one that names it in
//! the logs, and in it one for each thing that takes time. Nobody sees them, and they cost
//! next to nothing, where nothing exports them (`--otlp-endpoint`, feature `otlp`).

use http::HeaderMap;
use tonic::Code;
use tracing::Span;

/// Target of the spans that are exported and not logged.
pub const TARGET: &str = "hullcast::trace";

/// A call's span; the caller's, by W3C `traceparent`, is its parent.
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

/// The trace that the span is in; none where nothing exports it.
pub(crate) fn id(span: &Span) -> Option<String> {
    #[cfg(feature = "otlp")]
    return otel::id(span);
    #[cfg(not(feature = "otlp"))]
    {
        let _ = span;
        None
    }
}

/// A batch's wait for its turn.
pub(crate) fn queue(pairs: usize) -> Span {
    tracing::info_span!(target: TARGET, "queue", pairs = number(pairs))
}

/// A batch's computation.
pub(crate) fn compute(pairs: usize) -> Span {
    tracing::info_span!(target: TARGET, "compute", pairs = number(pairs))
}

/// OpenTelemetry has no unsigned numbers: they would be text.
fn number(count: usize) -> i64 {
    i64::try_from(count).unwrap_or(i64::MAX)
}

/// Reading and building a hull that was not cached.
pub(crate) fn load(hull: &dyn std::fmt::Display) -> Span {
    tracing::info_span!(target: TARGET, "load", %hull)
}

/// The call ended.
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
            // Fails for a span that has begun: this one has not.
            let _ = span.set_parent(TraceContextPropagator::new().extract(&Headers(headers)));
        }
    }

    pub(super) fn id(span: &Span) -> Option<String> {
        let trace = || span.context().span().span_context().trace_id().to_string();
        (!span.is_disabled()).then(trace)
    }

    /// An error of the server's is the span's; the caller's own is not.
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
