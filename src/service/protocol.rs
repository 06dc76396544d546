//! Refuses requests that are not gRPC, by their HTTP method and content type ("gRPC over HTTP2",
//! section Requests).
//!
//! Browsers let the page of another site send a GET, or a POST with the content type of a form or of
//! plain text, without asking the server first. Such requests must not reach a handler.

use http::{HeaderName, HeaderValue, Method, Request, Response, StatusCode, header};
use tonic::body::Body;

/// The content types of gRPC's messages that are protocol buffers. If gRPC-web is served, its content
/// types have been converted before.
const TYPES: [&str; 2] = ["application/grpc", "application/grpc+proto"];

/// The answer to a request that is not gRPC, or `None` for a gRPC request.
///
/// The answer has only headers: the memory budget does not count it, and a body would wait until the peer
/// reads it.
pub(super) fn refusal<B>(request: &Request<B>) -> Option<Response<Body>> {
    if request.method() != Method::POST {
        return Some(answer(StatusCode::METHOD_NOT_ALLOWED, (header::ALLOW, "POST")));
    }
    if !request.headers().get(header::CONTENT_TYPE).is_some_and(is_grpc) {
        return Some(answer(StatusCode::UNSUPPORTED_MEDIA_TYPE, (header::ACCEPT, TYPES[0])));
    }
    None
}

/// Whether a content type is one of gRPC's, whatever its parameters.
fn is_grpc(value: &HeaderValue) -> bool {
    let Ok(text) = value.to_str() else { return false };
    let kind = text.split(';').next().unwrap_or_default().trim_end();
    TYPES.iter().any(|known| known.eq_ignore_ascii_case(kind))
}

/// An answer with a header that says what is accepted.
fn answer(code: StatusCode, (name, value): (HeaderName, &'static str)) -> Response<Body> {
    let mut response = Response::new(Body::empty());
    *response.status_mut() = code;
    response.headers_mut().insert(name, HeaderValue::from_static(value));
    response
}

#[cfg(test)]
mod tests {
    use hyper::body::Body as _;

    use super::*;

    fn code(method: Method, kind: Option<&str>) -> Option<u16> {
        let mut request = Request::new(());
        *request.method_mut() = method;
        if let Some(kind) = kind {
            request.headers_mut().insert(header::CONTENT_TYPE, HeaderValue::from_str(kind).unwrap());
        }
        refusal(&request).map(|response| {
            assert!(response.body().is_end_stream(), "a body that the peer may leave unread");
            response.status().as_u16()
        })
    }

    /// Catches a method or a content type that is served although it is not gRPC, and one of gRPC
    /// that is refused.
    #[test]
    fn only_grpc_is_served() {
        for kind in [
            "application/grpc",
            "application/grpc+proto",
            "application/grpc;charset=utf-8",
            "application/grpc+proto ; a=b",
            "Application/GRPC",
        ] {
            assert_eq!(code(Method::POST, Some(kind)), None, "{kind}");
        }
        for kind in [
            "application/json",
            "application/grpc+json",
            "application/grpc-web",
            "application/grpc-web+proto",
            "application/grpcx",
            "text/plain;application/grpc",
            "",
        ] {
            assert_eq!(code(Method::POST, Some(kind)), Some(415), "{kind}");
        }
        assert_eq!(code(Method::POST, None), Some(415));
        for method in [Method::GET, Method::HEAD, Method::OPTIONS, Method::PUT, Method::CONNECT] {
            assert_eq!(code(method.clone(), Some("application/grpc")), Some(405), "{method}");
        }
    }
}
