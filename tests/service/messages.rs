//! Messages that arrive slowly, in pieces, too many at a time, or never completely.

use std::time::Duration;

use bytes::Bytes;
use hullcast::service::{Limits, ServerOptions};
use tonic::{Code, Status};

use crate::support::{Setup, TestServer, raw, refusal, refused};

const QUERY: &str = "/hullcast.v1.ContactService/QueryContacts";
const STREAM: &str = "/hullcast.v1.ContactService/StreamContacts";
const INFO: &str = "/hullcast.v1.ServerService/GetServerInfo";
const CHECK: &str = "/grpc.health.v1.Health/Check";
const WATCH: &str = "/grpc.health.v1.Health/Watch";

const ARRIVING: &str = r#"hullcast_memory_bytes{part="arriving"}"#;

/// A server that gives its callers 300 ms to send a message.
async fn impatient() -> TestServer {
    let options = ServerOptions { message_time: Duration::from_millis(300), ..ServerOptions::default() };
    Setup { options, ..Setup::default() }.start().await
}

/// The status of a call with this body.
async fn status_of(server: &TestServer, path: &str, body: raw::Body) -> Status {
    let mut client = raw::connect(&server.address).await;
    let response = client.send_request(raw::call(path, &[], body)).await.unwrap();
    raw::status_in(response).await
}

/// 500 calls that each send only the five bytes of a frame head that announces 64 MiB. Catches
/// memory that is reserved for a declared length.
#[tokio::test(flavor = "multi_thread")]
async fn a_declared_length_takes_no_memory() {
    let server = TestServer::start().await;
    let (mut client, connection) = raw::connection(&server.address).await;
    let connection = tokio::spawn(connection);
    let head = Bytes::from_static(&[0, 4, 0, 0, 0]);
    let calls: Vec<_> = (0..500)
        .map(|_| {
            let call = raw::call(STREAM, &[], raw::Body::Unfinished(head.clone()));
            tokio::spawn(client.send_request(call))
        })
        .collect();
    server.until("hullcast_requests_in_flight", 500.0).await;
    tokio::time::sleep(Duration::from_millis(100)).await;
    assert_eq!(server.metric(ARRIVING), 0.0);
    drop((connection, calls));
}

/// Catches a frame head, or a message, that is only understood if it arrives in one HTTP/2 frame.
#[tokio::test(flavor = "multi_thread")]
async fn messages_may_come_a_byte_at_a_time() {
    let server = TestServer::start().await;
    // An unknown field of 300 bytes, which the server ignores.
    let mut message = vec![0xfa, 0x3f, 0xac, 0x02];
    message.extend([7; 300]);
    let whole = raw::frame(false, &message);
    for piece_bytes in [1, 2, 3, 4, 5, 6, 7, 100] {
        let pieces = whole.chunks(piece_bytes).map(Bytes::copy_from_slice).collect();
        let status = status_of(&server, INFO, raw::Body::Pieces(pieces)).await;
        assert_eq!(status.code(), Code::Ok, "{piece_bytes}: {status}");
    }
    server.until(ARRIVING, 0.0).await;
}

/// Catches a message in tiny pieces, each of which costs the server as much as hundreds of bytes: for a MiB in
/// chunks of one byte it worked for seconds after its caller had left. A short message may come byte by byte.
#[tokio::test(flavor = "multi_thread")]
async fn a_long_message_in_tiny_pieces_is_refused() {
    let server = TestServer::start().await;
    // A field that the server does not know, so that the message is valid at any length.
    let message =
        |bytes: usize| [vec![0xfa, 0x7f, (bytes & 0x7f | 0x80) as u8, (bytes >> 7) as u8], vec![0; bytes]];
    let expected = refused(Code::InvalidArgument, "PIECES_TOO_SMALL", "");
    for (bytes, piece_bytes, is_refused) in
        [(1000, 1, false), (5000, 1, true), (16_000, 10, true), (16_000, 100, false)]
    {
        let whole = raw::frame(false, &message(bytes).concat());
        let pieces = whole.chunks(piece_bytes).map(Bytes::copy_from_slice).collect();
        let status = status_of(&server, INFO, raw::Body::Pieces(pieces)).await;
        if is_refused {
            assert_eq!(refusal(&status), expected, "{bytes} bytes in pieces of {piece_bytes}");
        } else {
            assert_eq!(status.code(), Code::Ok, "{bytes} bytes in pieces of {piece_bytes}: {status}");
        }
    }
    server.until(ARRIVING, 0.0).await;
}

/// Catches messages after the first one of a unary call, which would be decoded and discarded
/// without end.
#[tokio::test(flavor = "multi_thread")]
async fn a_method_that_takes_one_message_refuses_a_second() {
    let server = TestServer::start().await;
    let one = raw::frame(false, &[]);
    let more = [&one[..], &one[..1], &raw::frame(false, &[0; 1000])[..700]];
    for path in [QUERY, INFO, CHECK, WATCH, "/hullcast.v1.ContactService/FindContacts"] {
        for more in more {
            let joined = Bytes::from([&one[..], more].concat());
            let apart = [one.clone(), Bytes::copy_from_slice(more)].into();
            for body in [raw::Body::Whole(joined), raw::Body::Pieces(apart)] {
                let status = status_of(&server, path, body).await;
                let expected = refused(Code::InvalidArgument, "TOO_MANY_MESSAGES", "");
                assert_eq!(refusal(&status), expected, "{path}");
            }
        }
    }
    server.until(ARRIVING, 0.0).await;
}

/// The end of the request never comes: within the message, between the message and the end of the
/// request, and before the first byte of a required message. Catches a message that is held for as
/// long as its caller likes.
#[tokio::test(flavor = "multi_thread")]
async fn a_message_that_does_not_end_is_late() {
    let server = impatient().await;
    let whole = raw::frame(false, &[0x40; 500]);
    let expected = refused(Code::DeadlineExceeded, "MESSAGE_LATE", "");
    for path in [QUERY, INFO, CHECK, WATCH] {
        for bytes in [0, 3, 5, 100, 505] {
            let status = status_of(&server, path, raw::Body::Unfinished(whole.slice(..bytes))).await;
            assert_eq!(refusal(&status), expected, "{path} {bytes}");
        }
    }
    for bytes in [1, 5, 100] {
        let status = status_of(&server, STREAM, raw::Body::Unfinished(whole.slice(..bytes))).await;
        assert_eq!(refusal(&status), expected, "a stream, {bytes}");
    }
    server.until(ARRIVING, 0.0).await;
}

/// Catches a stream that is ended because its caller sends nothing for a while.
#[tokio::test(flavor = "multi_thread")]
async fn a_stream_may_wait_between_messages() {
    let server = impatient().await;
    let mut client = raw::connect(&server.address).await;
    let call = raw::call(STREAM, &[], raw::Body::Unfinished(raw::frame(false, &[])));
    let response = tokio::time::timeout(Duration::from_secs(20), client.send_request(call));
    let response = response.await.unwrap().unwrap();
    assert!(Status::from_header_map(response.headers()).is_none());
    tokio::time::sleep(Duration::from_secs(1)).await;
    assert_eq!(server.metric("hullcast_requests_in_flight"), 1.0);
}

/// Catches a health check that is refused for lack of memory, or that may send megabytes without a
/// token.
#[tokio::test(flavor = "multi_thread")]
async fn health_is_answered_whatever_the_budget_holds() {
    let limits = Limits {
        max_memory_bytes: 256 << 20,
        max_message_bytes: 16 << 20,
        max_points_per_hull: 50_000,
        ..Limits::default()
    };
    let server = TestServer::with_limits(limits).await;
    let caller = hullcast::budget::Caller::alone();
    let mut filler = Vec::new();
    for bytes in [1 << 27, 1 << 20, 1 << 12, 1] {
        // The test takes all memory of the budget as a single caller.
        while let Ok(permit) = server.app.memory().take(&caller, hullcast::budget::Part::Answers, bytes) {
            filler.push(permit);
        }
    }
    let status = status_of(&server, CHECK, raw::Body::Whole(raw::frame(false, &[]))).await;
    assert_eq!(status.code(), Code::Ok, "{status}");
    drop(filler);
    for path in [CHECK, WATCH] {
        let status = status_of(&server, path, raw::Body::Unfinished(raw::frame(false, &[0; 1025]))).await;
        assert_eq!(refusal(&status), refused(Code::InvalidArgument, "MESSAGE_TOO_LARGE", ""), "{path}");
    }
}

/// Catches a call that is served although it is not gRPC, by its method or its content type: a page
/// of another site may send such a request.
#[tokio::test(flavor = "multi_thread")]
async fn requests_that_are_not_grpc_are_refused_by_http() {
    let server = TestServer::start().await;
    let mut client = raw::connect(&server.address).await;
    let mut code = async |method: &str, kind: Option<&str>| {
        let mut request = http::Request::builder().method(method).uri(format!("http://localhost{CHECK}"));
        if let Some(kind) = kind {
            request = request.header("content-type", kind);
        }
        let body = raw::Body::Whole(raw::frame(false, &[]));
        let response = client.send_request(request.body(body).unwrap()).await.unwrap();
        (response.status().as_u16(), response.headers().contains_key("allow"))
    };
    assert_eq!(code("POST", Some("application/grpc")).await, (200, false));
    assert_eq!(code("POST", Some("application/grpc+proto")).await, (200, false));
    for kind in [None, Some("application/json"), Some("text/plain"), Some("application/grpc-web")] {
        assert_eq!(code("POST", kind).await, (415, false), "{kind:?}");
    }
    for method in ["GET", "PUT", "OPTIONS", "HEAD"] {
        assert_eq!(code(method, Some("application/grpc")).await, (405, true), "{method}");
    }
    assert_eq!(server.metric("hullcast_requests_in_flight"), 0.0);
}

/// Catches an unlimited number of Watch streams on one connection, and places that are not
/// returned.
#[tokio::test(flavor = "multi_thread")]
async fn a_connection_has_few_watch_streams() {
    let server = TestServer::start().await;
    let mut client = raw::connect(&server.address).await;
    let mut open = Vec::new();
    let watch = || raw::call(WATCH, &[], raw::Body::Whole(raw::frame(false, &[])));
    for _ in 0..8 {
        open.push(client.send_request(watch()).await.unwrap());
    }
    let ninth = raw::status_in(client.send_request(watch()).await.unwrap()).await;
    assert_eq!(refusal(&ninth), refused(Code::ResourceExhausted, "TOO_MANY_WATCHES", ""));
    drop(open);
    server.until("hullcast_requests_in_flight", 0.0).await;
    let again = client.send_request(watch()).await.unwrap();
    assert!(Status::from_header_map(again.headers()).is_none());
}
