//! The outermost layer, which applies to every call of every method.
//!
//! The layer names and counts each call. Before it reads any of the body, it refuses a caller without the
//! token that the method needs, and takes the call's fixed cost from the memory budget. It limits the
//! request's messages ([`MessageBody`]) and the time and memory of the answer ([`AnswerBody`]), and it
//! enforces the deadline. Errors that the transport itself produces (an unknown method, compression) get
//! the code and the details of the contract.

use std::{
    convert::Infallible,
    sync::Arc,
    task::{Context, Poll},
    time::Duration,
};

use bytes::Bytes;
use futures_util::future::BoxFuture;
use http::{HeaderMap, HeaderName, HeaderValue, Request, Response};
use hyper::body::Body as HttpBody;
use tokio::{sync::watch, time::Instant};
use tonic::{Code, Status, body::Body, service::Routes};
use tower::Service;
use tracing::Instrument;

use super::{
    App, ServerOptions,
    answer_body::{AnswerBody, AnswerTimes},
    call::{self, BoxError, Call, CallResources},
    context::{CallContext, no_memory},
    error::ServiceError,
    method::Method,
    peers::Peer,
    protocol,
    reason::Reason,
    recording::{self, RecordedRequest},
    request_body::{MessageBody, MessageRules},
    sizes::{CALL_BYTES, HEADER_RECORD_BYTES},
    wire,
};
use crate::{
    budget::{Caller, MemoryBudget, Part},
    log_limit::limited,
    trace,
};

/// The largest message of a health check or of reflection: a name.
const NAME_BYTES: usize = 1 << 10;

/// The time at which the caller stops waiting. An extension of each request that has one.
#[derive(Clone, Copy, Debug)]
pub(super) struct Deadline(pub(super) Instant);

/// Becomes true when the request's connection is about to close. An extension of every request.
#[derive(Clone, Debug)]
pub(super) struct Closing(pub(super) watch::Receiver<bool>);

impl Closing {
    /// Completes when the connection is about to close.
    pub(super) async fn announced(&mut self) {
        if self.0.wait_for(|closing| *closing).await.is_err() {
            // The sender is gone, so the value can no longer become true.
            std::future::pending().await
        }
    }
}

/// A health check with more headers takes memory as other calls do.
const FREE_HEADERS: usize = 32;

/// The layer around all routes, for one connection.
#[derive(Clone, Debug)]
pub(super) struct Middleware {
    app: Arc<App>,
    routes: Routes,
    options: Arc<ServerOptions>,
    peer: Peer,
    closing: Closing,
}

impl Middleware {
    pub(super) fn new(
        app: Arc<App>,
        routes: Routes,
        options: Arc<ServerOptions>,
        peer: Peer,
        closing: Closing,
    ) -> Self {
        Self { app, routes, options, peer, closing }
    }

    /// The latest time at which the call ends: the caller's deadline, or the server's if that is earlier or
    /// the caller has none. Long-lived calls have only the deadline of the caller.
    fn deadline(&self, method: &Method, headers: &HeaderMap) -> Option<Instant> {
        let most = Duration::from_secs(self.app.limits().max_deadline_seconds.into());
        let given = timeout(headers);
        let allowed = if method.is_long_lived() { given } else { Some(given.unwrap_or(most).min(most)) };
        allowed.and_then(|allowed| Instant::now().checked_add(allowed))
    }

    /// Takes the resources of an answer to a browser that is not a call.
    #[cfg(feature = "grpc-web")]
    pub(super) fn take_for_text(&self, headers: &HeaderMap) -> Result<CallResources, ServiceError> {
        self.take(Method::other(), headers, &self.peer.caller(None))
    }

    /// The time that a peer has for taking an answer.
    #[cfg(feature = "grpc-web")]
    pub(super) fn patience(&self) -> Duration {
        self.options.answer_time
    }

    /// Takes the resources that the call holds until its end.
    fn take(
        &self,
        method: &Method,
        headers: &HeaderMap,
        caller: &Caller,
    ) -> Result<CallResources, ServiceError> {
        let watch = method.is_watch().then(|| {
            self.peer.watch().ok_or_else(|| {
                let why = "the connection has too many Watch and reflection streams: close one first";
                ServiceError::new(Reason::TooManyWatches, why)
            })
        });
        let watch = watch.transpose()?;
        let is_free = method.is_health() && watch.is_none() && headers.len() <= FREE_HEADERS;
        let check = if is_free { self.peer.health_check() } else { None };
        let memory = if check.is_some() {
            None
        } else {
            let bytes = |(name, value): (&HeaderName, &HeaderValue)| name.as_str().len() + value.len();
            let headers = headers.iter().map(|header| bytes(header) + HEADER_RECORD_BYTES);
            let bytes = (CALL_BYTES + headers.sum::<usize>()) as u64;
            let memory = self.app.memory().take(caller, Part::Connections, bytes);
            Some(memory.map_err(|why| no_memory(self.app.metrics(), why))?)
        };
        Ok(CallResources::new(memory, watch.or(check)))
    }

    fn message_rules(&self, method: &Method) -> MessageRules {
        MessageRules {
            max_bytes: if method.names_a_service() {
                NAME_BYTES
            } else {
                self.app.limits().max_message_bytes
            },
            is_single: method.takes_one_message(),
            patience: self.options.message_time,
        }
    }
}

impl<B> Service<Request<B>> for Middleware
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
        if let Some(refusal) = protocol::refusal(&request) {
            return Box::pin(std::future::ready(Ok(refusal)));
        }
        let method = Method::of(request.uri().path());
        let traced = trace::call(&method.name, request.headers());
        let span = call::span(&method.name, request.headers(), &traced);
        let token = self.options.security.check(method, request.headers());
        let caller = self.peer.caller(token.as_ref().ok().and_then(|name| name.as_deref()));
        // Health checks are answered even if the budget is full; their messages are tiny.
        let memory = if method.is_health() { MemoryBudget::unlimited() } else { self.app.memory().clone() };
        let context = CallContext::new(caller, memory);
        let resources = token.and_then(|_| self.take(method, request.headers(), &context.job.caller));
        let (resources, refusal) = match resources {
            Ok(resources) => (resources, None),
            Err(refusal) => {
                report(&refusal, &method.name);
                (CallResources::default(), Some(refusal))
            }
        };
        let stop = context.job.stop.clone();
        let call = Call::new(self.app.clone(), &method.name, span.clone(), traced.clone(), stop, resources);
        let deadline = self.deadline(method, request.headers());
        let times = AnswerTimes { patience: self.options.answer_time, deadline };
        if let Some(refusal) = refusal {
            let response = Status::from(refusal).into_http();
            return Box::pin(async move { Ok(answered(call, response, context, times)) });
        }
        request.extensions_mut().insert(self.closing.clone());
        request.extensions_mut().insert(context.clone());
        if let Some(at) = deadline {
            request.extensions_mut().insert(Deadline(at));
        }
        let rules = self.message_rules(method);
        let tape = self.options.recorder.as_ref().and_then(|recorder| recording::tape(recorder, method));
        if tape.is_some() {
            context.on_tape();
        }
        let body = {
            let (app, context, tape) = (self.app.clone(), context.clone(), tape.clone());
            |body| MessageBody::new(RecordedRequest::new(body, tape), app, context, rules)
        };
        let answer = self.routes.call(request.map(body));
        let responded = async move {
            let response = match deadline {
                None => answer.await?,
                // Dropping the call stops its computation.
                Some(at) => match tokio::time::timeout_at(at, answer).await {
                    Ok(response) => response?,
                    Err(_) => Status::from(ServiceError::deadline_exceeded()).into_http(),
                },
            };
            let response = completed(response);
            let Some(tape) = tape else { return Ok(answered(call, response, context, times)) };
            let status = Status::from_header_map(response.headers());
            let response = answered(call, response, context.clone(), times);
            Ok(recording::recorded(response, tape, context, status))
        };
        // Both spans are entered: traced work takes its parent from the entered spans, even if nothing is
        // logged.
        Box::pin(responded.instrument(span).instrument(traced))
    }
}

/// Logs that a call was refused because of its token. The token itself is never logged.
fn report(refusal: &ServiceError, method: &str) {
    if matches!(refusal.reason.code(), Code::Unauthenticated | Code::PermissionDenied) {
        limited!(info, reason = refusal.reason.name(), method, "a call was refused for its token");
    }
}

/// Wraps the response for the transport. The call ends when its body ends.
fn answered(
    mut call: Call,
    response: Response<Body>,
    context: CallContext,
    times: AnswerTimes,
) -> Response<Body> {
    if let Some(status) = Status::from_header_map(response.headers()) {
        call.ended_with(status.code());
    }
    response.map(|body| Body::new(AnswerBody::new(body, call, context, times)))
}

/// Adds the details of the contract to an error that is the whole response (headers only). Its other
/// headers stay.
fn completed(mut response: Response<Body>) -> Response<Body> {
    let Some(status) = Status::from_header_map(response.headers()) else { return response };
    if status.code() == Code::Ok || !status.details().is_empty() {
        return response;
    }
    match wire::complete(status).add_header(response.headers_mut()) {
        Ok(()) => response,
        Err(status) => status.into_http(),
    }
}

/// The `grpc-timeout` header: at most 8 digits and a unit. A malformed header is ignored, as in other gRPC
/// servers.
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

    /// Catches a unit that is mistaken for another, and a malformed header that ends a call.
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
