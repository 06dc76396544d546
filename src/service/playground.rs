//! The playground: a page that shows contacts, and gRPC-web for pages, on the same port as gRPC.
//!
//! These calls go through the same [`Middleware`] as all others and differ only in their encoding.
//! Browsers speak HTTP/2 to a server with TLS, and HTTP/1.1 to one without.

use std::{
    convert::Infallible,
    io,
    net::IpAddr,
    task::{Context, Poll},
    time::Duration,
};

use futures_util::future::{BoxFuture, Either, Ready, ready};
use http::{HeaderValue, Method, Request, Response, StatusCode, header, uri::Authority};
use hyper::{body::Incoming, server::conn::http1};
use hyper_util::rt::TokioTimer;
use tonic::body::Body;
use tonic_web::{GrpcWebLayer, GrpcWebService};
use tower::{Layer, Service};

use super::{listener::Connection, middleware::Middleware};

/// The files of the page, built by `make playground`.
const FILES: [(&str, &str, &str); 4] = [
    ("/", "text/html; charset=utf-8", include_str!("../../playground/dist/index.html")),
    ("/playground.css", "text/css; charset=utf-8", include_str!("../../playground/dist/playground.css")),
    ("/playground.js", "text/javascript; charset=utf-8", include_str!("../../playground/dist/playground.js")),
    ("/licences.txt", "text/plain; charset=utf-8", include_str!("../../playground/dist/licences.txt")),
];

/// The page may not load anything from other origins, may run only its own script, and may not be
/// framed.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; \
                      img-src data:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

/// The pause before looking again at a peer that has sent only one byte.
const LOOK: Duration = Duration::from_millis(10);

/// Whether the first bytes of `io` are those of HTTP/1.1; they stay unread. TLS and Unix sockets
/// carry only HTTP/2.
///
/// # Errors
/// The system's error.
pub(super) async fn speaks_http1(io: &Connection) -> io::Result<bool> {
    let Connection::Tcp(stream) = io else { return Ok(false) };
    // HTTP/2 begins with "PRI"; an HTTP/1.1 request that begins with P has another second letter.
    let mut first = [0; 2];
    loop {
        match (stream.peek(&mut first).await?, first) {
            (0, _) => return Err(io::ErrorKind::UnexpectedEof.into()),
            (1, [b'P', _]) => tokio::time::sleep(LOOK).await,
            (_, begins) => return Ok(begins != *b"PR"),
        }
    }
}

/// The protocol of HTTP/1.1 connections. A peer has `patience` for sending each request's header, which has
/// at most `header_bytes`.
pub(super) fn http1(patience: Duration, header_bytes: u32) -> http1::Builder {
    let mut http = http1::Builder::new();
    http.timer(TokioTimer::new()).header_read_timeout(patience).max_buf_size(header_bytes as usize);
    http
}

/// Serves the page, gRPC-web and, over HTTP/2, gRPC.
#[derive(Clone, Debug)]
pub(super) struct Page {
    calls: GrpcWebService<Middleware>,
    /// Without TLS no certificate proves which server this is.
    is_plain: bool,
}

impl Page {
    pub(super) fn over_http1(calls: Middleware) -> Self {
        Self { calls: GrpcWebLayer::new().layer(calls), is_plain: true }
    }

    pub(super) fn over_http2(calls: Middleware) -> Self {
        Self { calls: GrpcWebLayer::new().layer(calls), is_plain: false }
    }
}

impl Service<Request<Incoming>> for Page {
    type Response = Response<Body>;
    type Error = Infallible;
    type Future = Either<
        Ready<Result<Response<Body>, Infallible>>,
        BoxFuture<'static, Result<Response<Body>, Infallible>>,
    >;

    fn poll_ready(&mut self, cx: &mut Context<'_>) -> Poll<Result<(), Infallible>> {
        Service::<Request<Incoming>>::poll_ready(&mut self.calls, cx)
    }

    fn call(&mut self, request: Request<Incoming>) -> Self::Future {
        let answer = match *request.method() {
            _ if self.is_plain && !names_no_site(&request) => plain(
                StatusCode::FORBIDDEN,
                "without TLS the page is only served under an IP address or localhost",
            ),
            Method::GET | Method::HEAD => file(request.uri().path()),
            _ if !is_grpc(&request) => {
                plain(StatusCode::UNSUPPORTED_MEDIA_TYPE, "the content type must be that of gRPC or gRPC-web")
            }
            _ => return Either::Right(Box::pin(self.calls.call(request))),
        };
        Either::Left(ready(Ok(answer)))
    }
}

/// Whether the request names the server by an IP address or as localhost. Otherwise a site
/// elsewhere whose name resolves to this server would have the same origin, and its pages could
/// call the server.
fn names_no_site<B>(request: &Request<B>) -> bool {
    let host =
        request.headers().get(header::HOST).and_then(|host| host.to_str().ok()?.parse::<Authority>().ok());
    host.is_some_and(|authority| {
        let host = authority.host().trim_start_matches('[').trim_end_matches(']');
        host.eq_ignore_ascii_case("localhost") || host.parse::<IpAddr>().is_ok()
    })
}

/// Whether the content type is gRPC's. Browsers send other content types to any site, but these
/// types only after the site has allowed it.
fn is_grpc<B>(request: &Request<B>) -> bool {
    let kind = request.headers().get(header::CONTENT_TYPE);
    kind.is_some_and(|kind| kind.as_bytes().starts_with(b"application/grpc"))
}

/// Answers GET and HEAD; hyper leaves out the body for HEAD.
fn file(path: &str) -> Response<Body> {
    let Some((_, kind, text)) = FILES.iter().find(|(name, ..)| *name == path) else {
        return plain(StatusCode::NOT_FOUND, "not found; the page is at /");
    };
    answer(StatusCode::OK, kind, text)
}

fn plain(code: StatusCode, text: &'static str) -> Response<Body> {
    answer(code, "text/plain; charset=utf-8", text)
}

fn answer(code: StatusCode, kind: &'static str, text: &'static str) -> Response<Body> {
    let mut response = Response::new(Body::new(text.to_owned()));
    *response.status_mut() = code;
    let headers = [
        (header::CONTENT_TYPE, kind),
        // The files belong to this server's version, so a cached copy must be revalidated.
        (header::CACHE_CONTROL, "no-cache"),
        (header::CONTENT_SECURITY_POLICY, POLICY),
        (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
        (header::REFERRER_POLICY, "no-referrer"),
    ];
    response.headers_mut().extend(headers.map(|(name, value)| (name, HeaderValue::from_static(value))));
    response
}
