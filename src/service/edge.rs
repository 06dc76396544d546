//! The outermost layer: what holds for every call whatever its method.
//!
//! Names and counts the call, refuses callers without the token that its method
//! needs, enforces the deadline and gives the errors that the transport
//! makes by itself (a message too large, an unknown method, compression) the
//! code and details of the contract.

use std::{
    convert::Infallible,
    sync::Arc,
    task::{Context, Poll},
    time::Duration,
};

use bytes::Bytes;
use futures_util::future::BoxFuture;
use http::{HeaderMap, Request, Response};
use hyper::body::Body as HttpBody;
use tokio::{sync::watch, time::Instant};
use tonic::{Status, body::Body, service::Routes};
use tower::Service;
use tracing::Instrument;

use super::{
    App, Security,
    call::{self, BoxError, Call, is_long_lived},
    context::CallContext,
    error::ServiceError,
    wire,
};
use crate::{budget::Caller, trace};

/// When the caller stops waiting; an extension of requests that have one.
#[derive(Clone, Copy, Debug)]
pub(super) struct Deadline(pub(super) Instant);

/// True once the connection that a request came on is about to close; an extension of
/// every request.
#[derive(Clone, Debug)]
pub(super) struct Closing(pub(super) watch::Receiver<bool>);

impl Closing {
    /// Completes once it is about to close.
    pub(super) async fn heard(&mut self) {
        if self.0.wait_for(|closing| *closing).await.is_err() {
            // Nobody is left to say so.
            std::future::pending().await
        }
    }
}

/// Wraps all routes, for one connection.
#[derive(Clone, Debug)]
pub(super) struct Edge {
    app: Arc<App>,
    routes: Routes,
    security: Arc<Security>,
    closing: Closing,
}

impl Edge {
    pub(super) fn new(app: Arc<App>, routes: Routes, security: Arc<Security>, closing: Closing) -> Self {
        Self { app, routes, security, closing }
    }

    /// When the call ends at the latest: the caller's deadline, or the server's where that is
    /// sooner or there is none.
    fn deadline(&self, method: &str, headers: &HeaderMap) -> Option<Instant> {
        let most = Duration::from_secs(self.app.limits().max_deadline_seconds.into());
        let given = timeout(headers);
        let allowed = if is_long_lived(method) { given } else { Some(given.unwrap_or(most).min(most)) };
        allowed.and_then(|allowed| Instant::now().checked_add(allowed))
    }
}

impl<B> Service<Request<B>> for Edge
where
    B: HttpBody<Data = Bytes> + Send + Unpin + 'static,
    B::Error: Into<BoxError>,
{
    type Response = Response<Body>;
    type Error = Infallible;
    type Future = BoxFuture<'static, Result<Response<Body>, Infallible>>;

    fn poll_ready(&mut self, cx: &mut Context<'_>) -> Poll<Result<(), Infallible>> {
        Service::<Request<B>>::poll_ready(&mut self.routes, cx)
    }

    fn call(&mut self, mut request: Request<B>) -> Self::Future {
        let method = call::method(request.uri().path());
        let traced = trace::call(method, request.headers());
        let span = call::span(method, request.headers(), &traced);
        let call = Call::new(self.app.clone(), method, span.clone(), traced.clone());
        if let Err(refusal) = self.security.check(request.uri().path(), request.headers()) {
            let refused = Status::from(refusal).into_http();
            return Box::pin(std::future::ready(Ok(call.answered(refused))));
        }
        request.extensions_mut().insert(self.closing.clone());
        let context = CallContext::new(Caller::alone(), self.app.memory().clone());
        request.extensions_mut().insert(context);
        let deadline = self.deadline(method, request.headers());
        if let Some(at) = deadline {
            request.extensions_mut().insert(Deadline(at));
        }
        let answer = self.routes.call(request.map(|body| call.metered(body)));
        let answered = async move {
            let response = match deadline {
                None => answer.await?,
                // Dropping the call is what stops its computation.
                Some(at) => match tokio::time::timeout_at(at, answer).await {
                    Ok(response) => response?,
                    Err(_) => Status::from(ServiceError::deadline_exceeded()).into_http(),
                },
            };
            Ok(call.answered(completed(response)))
        };
        // What is traced finds the spans that are entered, whatever is logged.
        Box::pin(answered.instrument(span).instrument(traced))
    }
}

/// An error that is the whole response (headers alone) gets the details of the contract; its
/// other headers stay.
fn completed(mut response: Response<Body>) -> Response<Body> {
    let Some(status) = Status::from_header_map(response.headers()) else { return response };
    if status.code() == tonic::Code::Ok || !status.details().is_empty() {
        return response;
    }
    match wire::complete(status).add_header(response.headers_mut()) {
        Ok(()) => response,
        Err(status) => status.into_http(),
    }
}

/// The `grpc-timeout` header: at most 8 digits and a unit. One that does not parse is
/// ignored, as the protocol's other servers do.
fn timeout(headers: &HeaderMap) -> Option<Duration> {
    let text = headers.get("grpc-timeout")?.to_str().ok()?;
    let (digits, unit) = text.split_at_checked(text.len().checked_sub(1)?)?;
    if digits.is_empty() || digits.len() > 8 || !digits.bytes().all(|b| b.is_ascii_digit()) {
        return None;
    }
    let value: u64 = digits.parse().ok()?;
    match unit {
        "H" => Some(Duration::from_secs(value * 3600)),
        "M" => Some(Duration::from_secs(value * 60)),
        "S" => Some(Duration::from_secs(value)),
        "m" => Some(Duration::from_millis(value)),
        "u" => Some(Duration::from_micros(value)),
        "n" => Some(Duration::from_nanos(value)),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Catches a unit taken for another, and a malformed header that ends a call.
    #[test]
    fn timeouts_parse_by_the_protocol() {
        let parse = |text: &'static str| {
            timeout(&HeaderMap::from_iter([(
                http::HeaderName::from_static("grpc-timeout"),
                http::HeaderValue::from_static(text),
            )]))
        };
        assert_eq!(parse("2H"), Some(Duration::from_secs(7200)));
        assert_eq!(parse("3M"), Some(Duration::from_secs(180)));
        assert_eq!(parse("4S"), Some(Duration::from_secs(4)));
        assert_eq!(parse("99999999m"), Some(Duration::from_millis(99_999_999)));
        assert_eq!(parse("5u"), Some(Duration::from_micros(5)));
        assert_eq!(parse("6n"), Some(Duration::from_nanos(6)));
        for malformed in ["", "S", "100000000m", "-1S", "+1S", "1s", "1", "1.5S"] {
            assert_eq!(parse(malformed), None, "{malformed}");
        }
    }
}
