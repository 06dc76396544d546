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

use futures_util::future::BoxFuture;
use http::{HeaderValue, Method, Request, Response, StatusCode, header, uri::Authority};
use hyper::{body::Incoming, server::conn::http1};
use hyper_util::rt::TokioTimer;
use tonic::body::Body;
use tonic_web::{GrpcWebLayer, GrpcWebService};
use tower::{Layer, Service};

use super::{listener::AcceptedConnection, middleware::Middleware, page_body::PageBody, stall::Stall};

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
/// hyper-util's `server::conn::auto` would do this too, but it waits for the first bytes without a limit, and
/// gives both protocols the same service and executor, which differ here.
///
/// # Errors
/// The system's error.
pub(super) async fn speaks_http1(io: &AcceptedConnection) -> io::Result<bool> {
    let AcceptedConnection::Tcp(stream) = io else { return Ok(false) };
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
    own: Middleware,
    /// Only over HTTP/1.1, which is without TLS: then no certificate proves which server this is.
    stall: Option<Stall>,
}

impl Page {
    pub(super) fn over_http1(calls: Middleware, stall: Stall) -> Self {
        Self { calls: GrpcWebLayer::new().layer(calls.clone()), own: calls, stall: Some(stall) }
    }

    pub(super) fn over_http2(calls: Middleware) -> Self {
        Self { calls: GrpcWebLayer::new().layer(calls.clone()), own: calls, stall: None }
    }
}

impl Service<Request<Incoming>> for Page {
    type Response = Response<Body>;
    type Error = Infallible;
    type Future = BoxFuture<'static, Result<Response<Body>, Infallible>>;

    fn poll_ready(&mut self, cx: &mut Context<'_>) -> Poll<Result<(), Infallible>> {
        Service::<Request<Incoming>>::poll_ready(&mut self.calls, cx)
    }

    fn call(&mut self, mut request: Request<Incoming>) -> Self::Future {
        let (stall, patience) = (self.stall.clone(), self.own.patience());
        let said = match *request.method() {
            _ if stall.is_some() && !names_no_site(&request) => PageAnswer::plain(
                StatusCode::FORBIDDEN,
                "without TLS the page is only served under an IP address or localhost",
            ),
            Method::GET | Method::HEAD => PageAnswer::file(request.uri().path()),
            _ => match encoding(&request) {
                None => PageAnswer::plain(
                    StatusCode::UNSUPPORTED_MEDIA_TYPE,
                    "the content type must be that of gRPC or of binary gRPC-web",
                ),
                Some(is_web) => {
                    if is_web {
                        // Otherwise this header could ask for an answer in base64.
                        let binary = HeaderValue::from_static("application/grpc-web+proto");
                        request.headers_mut().insert(header::ACCEPT, binary);
                    }
                    let answer = self.calls.call(request);
                    return Box::pin(async move {
                        if let Some(stall) = stall {
                            stall.over().await;
                        }
                        let response = answer.await?;
                        if !is_web {
                            return Ok(response);
                        }
                        Ok(response.map(|body| Body::new(PageBody::call(body, patience))))
                    });
                }
            },
        };
        let own = self.own.clone();
        Box::pin(async move {
            if let Some(stall) = stall {
                stall.over().await;
            }
            Ok(said.answer(&own, &request))
        })
    }
}

/// Whether the request names the server by an IP address or as localhost, wherever it names the server.
/// Otherwise a site elsewhere whose name resolves to this server would have the same origin, and its pages
/// could call the server.
fn names_no_site<B>(request: &Request<B>) -> bool {
    let hosts = request.headers().get_all(header::HOST).iter();
    let mut named = hosts
        .map(|host| host.to_str().ok()?.parse::<Authority>().ok())
        .chain(request.uri().authority().cloned().map(Some))
        .peekable();
    named.peek().is_some()
        && named.all(|authority| {
            authority.is_some_and(|authority| {
                let host = authority.host().trim_start_matches('[').trim_end_matches(']');
                host.eq_ignore_ascii_case("localhost") || host.parse::<IpAddr>().is_ok()
            })
        })
}

/// Whether the content type is gRPC-web's, or `None` if it is neither that nor gRPC's. Browsers send other
/// content types to any site, but these types only after the site has allowed it. The text form of gRPC-web is
/// not served: its base64 would be a second copy of the answer, which no budget counts.
fn encoding<B>(request: &Request<B>) -> Option<bool> {
    let kind = request.headers().get(header::CONTENT_TYPE)?.as_bytes();
    let rest = kind.strip_prefix(b"application/grpc")?;
    let rest = rest.to_ascii_lowercase();
    match rest.strip_prefix(b"-web") {
        Some(form) if form.starts_with(b"-text") => None,
        web => Some(web.is_some()),
    }
}

/// An answer that is not one of gRPC.
struct PageAnswer {
    code: StatusCode,
    kind: &'static str,
    text: &'static str,
}

impl PageAnswer {
    fn file(path: &str) -> Self {
        let Some((_, kind, text)) = FILES.iter().find(|(name, ..)| *name == path) else {
            return Self::plain(StatusCode::NOT_FOUND, "not found; the page is at /");
        };
        Self { code: StatusCode::OK, kind, text }
    }

    fn plain(code: StatusCode, text: &'static str) -> Self {
        Self { code, kind: "text/plain; charset=utf-8", text }
    }

    /// The response, which costs the memory of a call until it is sent. If the budget has no room, the answer
    /// has only headers.
    fn answer<B>(self, own: &Middleware, request: &Request<B>) -> Response<Body> {
        let Ok(resources) = own.take_for_page(request.headers()) else {
            let mut busy = Response::new(Body::empty());
            *busy.status_mut() = StatusCode::SERVICE_UNAVAILABLE;
            busy.headers_mut().insert(header::RETRY_AFTER, HeaderValue::from_static("1"));
            return busy;
        };
        let body = match *request.method() {
            Method::HEAD => Body::empty(),
            _ => Body::new(PageBody::file(self.text, resources, own.patience())),
        };
        let mut response = Response::new(body);
        *response.status_mut() = self.code;
        let headers = [
            (header::CONTENT_TYPE, self.kind),
            // The files belong to this server's version, so a cached copy must be revalidated.
            (header::CACHE_CONTROL, "no-cache"),
            (header::CONTENT_SECURITY_POLICY, POLICY),
            (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
            (header::REFERRER_POLICY, "no-referrer"),
        ];
        let headers = headers.map(|(name, value)| (name, HeaderValue::from_static(value)));
        response.headers_mut().extend(headers);
        response.headers_mut().insert(header::CONTENT_LENGTH, self.text.len().into());
        response
    }
}
