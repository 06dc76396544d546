//! Browsers: gRPC-web and the playground's page, on the same port as gRPC.
//!
//! Browsers speak HTTP/2 to a server with TLS, and HTTP/1.1 to one without. A page cannot send gRPC, because it
//! cannot read trailers, so it sends gRPC-web, which has them in the body. These calls go through the same
//! [`Middleware`] as all others and differ only in their encoding.
//!
//! A browser also sends requests for pages of other sites. Three rules protect the server. It allows calls
//! across origins only to the origins that the operator has listed. It refuses each content type that browsers
//! send to other sites without asking first. And without TLS it answers only requests that name it by an IP
//! address, as localhost, or as the host of a listed origin.

use std::{
    convert::Infallible,
    io,
    net::IpAddr,
    sync::Arc,
    task::{Context, Poll},
    time::Duration,
};

use futures_util::future::BoxFuture;
use http::{HeaderName, HeaderValue, Method, Request, Response, StatusCode, header, uri::Authority};
use hyper::{body::Incoming, server::conn::http1};
use hyper_util::rt::TokioTimer;
use tonic::body::Body;
use tonic_web::{GrpcWebLayer, GrpcWebService};
use tower::{Layer, Service};
use tower_http::cors::{AllowHeaders, AllowOrigin, Cors, CorsLayer};

#[cfg(feature = "playground")]
use super::playground;
use super::{
    listener::AcceptedConnection, middleware::Middleware, origin::Origin, server::ServerOptions,
    stall::Stall, web_body::WebBody,
};

/// The content security policy of all answers that are not calls. A page may not load anything from other
/// origins, may run only its own script, and may not be framed.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; \
                      img-src data:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

/// The headers of an answer that a page of a listed origin may read. gRPC-web puts the status there if the
/// answer has no message.
const STATUS_HEADERS: [HeaderName; 3] = [
    HeaderName::from_static("grpc-status"),
    HeaderName::from_static("grpc-message"),
    HeaderName::from_static("grpc-status-details-bin"),
];

/// The time for which a browser need not ask again whether it may call. Browsers shorten it to their own limit.
const MAX_AGE: Duration = Duration::from_secs(86_400);

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

/// Serves gRPC-web, the playground's page if it is enabled, and gRPC over HTTP/2.
#[derive(Clone, Debug)]
pub(super) struct Web {
    calls: Cors<GrpcWebService<Middleware>>,
    own: Middleware,
    options: Arc<ServerOptions>,
    /// Only over HTTP/1.1: the answers wait while the peer does not read.
    stall: Option<Stall>,
}

impl Web {
    pub(super) fn over_http1(calls: Middleware, options: Arc<ServerOptions>, stall: Stall) -> Self {
        Self { stall: Some(stall), ..Self::over_http2(calls, options) }
    }

    pub(super) fn over_http2(calls: Middleware, options: Arc<ServerOptions>) -> Self {
        let web = GrpcWebLayer::new().layer(calls.clone());
        Self { calls: across_origins(&options.grpc_web_origins).layer(web), own: calls, options, stall: None }
    }

    /// The answer to a request.
    fn answer(
        &mut self,
        mut request: Request<Incoming>,
    ) -> BoxFuture<'static, Result<Response<Body>, Infallible>> {
        let text = match *request.method() {
            _ if self.is_http1() && !names_this_server(&request, &self.options.grpc_web_origins) => {
                TextAnswer::plain(
                    StatusCode::FORBIDDEN,
                    "without TLS only requests to an IP address, to localhost or to the host of a listed origin \
                     are answered",
                )
            }
            Method::GET | Method::HEAD => page(&self.options, request.uri().path()),
            Method::OPTIONS if !self.options.grpc_web_origins.is_empty() => {
                return Box::pin(self.calls.call(request));
            }
            _ => match encoding(&request) {
                Some(Encoding::Grpc) => return Box::pin(self.calls.call(request)),
                Some(Encoding::GrpcWeb) => {
                    // Otherwise this header could ask for an answer in base64.
                    let binary = HeaderValue::from_static("application/grpc-web+proto");
                    request.headers_mut().insert(header::ACCEPT, binary);
                    let (answer, patience) = (self.calls.call(request), self.own.patience());
                    return Box::pin(async move {
                        Ok(answer.await?.map(|body| Body::new(WebBody::call(body, patience))))
                    });
                }
                None => TextAnswer::plain(
                    StatusCode::UNSUPPORTED_MEDIA_TYPE,
                    "the content type must be that of gRPC or of binary gRPC-web",
                ),
            },
        };
        let own = self.own.clone();
        Box::pin(async move { Ok(text.answer(&own, &request)) })
    }

    /// HTTP/1.1 is only served without TLS, so no certificate proves which server this is.
    fn is_http1(&self) -> bool {
        self.stall.is_some()
    }
}

/// The answer to a request that is not a call.
#[cfg(feature = "playground")]
fn page(options: &ServerOptions, path: &str) -> TextAnswer {
    if !options.playground {
        return TextAnswer::no_pages();
    }
    match playground::file(path) {
        Some((kind, text)) => TextAnswer { code: StatusCode::OK, kind, text },
        None => TextAnswer::plain(StatusCode::NOT_FOUND, "not found; the page is at /"),
    }
}

/// The answer to a request that is not a call.
#[cfg(not(feature = "playground"))]
fn page(_: &ServerOptions, _: &str) -> TextAnswer {
    TextAnswer::no_pages()
}

/// The CORS layer: pages of the listed origins may call.
fn across_origins(origins: &[Origin]) -> CorsLayer {
    let listed = origins.iter().filter_map(|origin| HeaderValue::from_str(origin.as_str()).ok());
    CorsLayer::new()
        .allow_origin(AllowOrigin::list(listed))
        .allow_methods([Method::POST])
        .allow_headers(AllowHeaders::mirror_request())
        .expose_headers(STATUS_HEADERS)
        .max_age(MAX_AGE)
}

impl Service<Request<Incoming>> for Web {
    type Response = Response<Body>;
    type Error = Infallible;
    type Future = BoxFuture<'static, Result<Response<Body>, Infallible>>;

    fn poll_ready(&mut self, cx: &mut Context<'_>) -> Poll<Result<(), Infallible>> {
        Service::<Request<Incoming>>::poll_ready(&mut self.calls, cx)
    }

    fn call(&mut self, request: Request<Incoming>) -> Self::Future {
        let stall = self.stall.clone();
        let answer = self.answer(request);
        Box::pin(async move {
            if let Some(stall) = stall {
                stall.over().await;
            }
            answer.await
        })
    }
}

/// Whether the request names the server by an IP address, as localhost, or as the host of one of `origins`,
/// wherever it names the server. Otherwise a site elsewhere whose name resolves to this server would have the
/// same origin, and its pages could call the server.
fn names_this_server<B>(request: &Request<B>, origins: &[Origin]) -> bool {
    let hosts = request.headers().get_all(header::HOST).iter();
    let mut named = hosts
        .map(|host| host.to_str().ok()?.parse::<Authority>().ok())
        .chain(request.uri().authority().cloned().map(Some))
        .peekable();
    named.peek().is_some()
        && named.all(|authority| {
            authority.is_some_and(|authority| {
                let host = authority.host();
                host.eq_ignore_ascii_case("localhost")
                    || host.trim_start_matches('[').trim_end_matches(']').parse::<IpAddr>().is_ok()
                    || origins.iter().any(|origin| origin.host().eq_ignore_ascii_case(host))
            })
        })
}

/// The encodings of calls.
enum Encoding {
    Grpc,
    GrpcWeb,
}

/// The encoding of a call by its content type, or `None` if it is neither gRPC's nor gRPC-web's. Browsers send
/// other content types to any site, but these types only after the site has allowed it. The text form of gRPC-web
/// is not served: its base64 would be a second copy of the answer, which no budget counts.
fn encoding<B>(request: &Request<B>) -> Option<Encoding> {
    let kind = request.headers().get(header::CONTENT_TYPE)?.as_bytes();
    let rest = kind.strip_prefix(b"application/grpc")?;
    let rest = rest.to_ascii_lowercase();
    match rest.strip_prefix(b"-web") {
        None => Some(Encoding::Grpc),
        Some(form) if form.starts_with(b"-text") => None,
        Some(_) => Some(Encoding::GrpcWeb),
    }
}

/// An answer that is not one of gRPC.
struct TextAnswer {
    code: StatusCode,
    kind: &'static str,
    text: &'static str,
}

impl TextAnswer {
    fn no_pages() -> Self {
        Self::plain(StatusCode::NOT_FOUND, "there are no pages here, only gRPC and gRPC-web")
    }

    fn plain(code: StatusCode, text: &'static str) -> Self {
        Self { code, kind: "text/plain; charset=utf-8", text }
    }

    /// The response, which costs the memory of a call until it is sent. If the budget has no room, the answer
    /// has only headers.
    fn answer<B>(self, own: &Middleware, request: &Request<B>) -> Response<Body> {
        let Ok(resources) = own.take_for_text(request.headers()) else {
            let mut busy = Response::new(Body::empty());
            *busy.status_mut() = StatusCode::SERVICE_UNAVAILABLE;
            busy.headers_mut().insert(header::RETRY_AFTER, HeaderValue::from_static("1"));
            return busy;
        };
        let body = match *request.method() {
            Method::HEAD => Body::empty(),
            _ => Body::new(WebBody::file(self.text, resources, own.patience())),
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
