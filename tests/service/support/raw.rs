//! gRPC by hand, for requests that a well-behaved client cannot send: such a client enforces its
//! own deadline, checks its own messages and never names a method that does not exist.

use std::{
    collections::VecDeque,
    convert::Infallible,
    future::poll_fn,
    pin::Pin,
    task::{Context, Poll},
};

use bytes::{BufMut, Bytes, BytesMut};
use http::{HeaderMap, Request, Response};
use hyper::{
    body::{Body as _, Frame, Incoming},
    client::conn::http2::{Connection, SendRequest, handshake},
};
use hyper_util::rt::{TokioExecutor, TokioIo};
use tokio::net::TcpStream;
use tonic::Status;

/// The body of a request.
pub(crate) enum Body {
    /// These bytes, then the end.
    Whole(Bytes),
    /// These bytes, and no end.
    Unfinished(Bytes),
    /// Nothing, and no end.
    Never,
    /// These pieces, each a frame of its own, then the end.
    Pieces(VecDeque<Bytes>),
}

impl hyper::body::Body for Body {
    type Data = Bytes;
    type Error = Infallible;

    fn poll_frame(
        self: Pin<&mut Self>,
        _: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, Infallible>>> {
        match self.get_mut() {
            Self::Unfinished(bytes) if !bytes.is_empty() => {
                Poll::Ready(Some(Ok(Frame::data(std::mem::take(bytes)))))
            }
            Self::Never | Self::Unfinished(_) => Poll::Pending,
            Self::Pieces(pieces) => Poll::Ready(pieces.pop_front().map(|piece| Ok(Frame::data(piece)))),
            Self::Whole(bytes) if bytes.is_empty() => Poll::Ready(None),
            Self::Whole(bytes) => Poll::Ready(Some(Ok(Frame::data(std::mem::take(bytes))))),
        }
    }
}

/// An HTTP/2 connection, which the caller must poll.
pub(crate) async fn connection(
    address: &str,
) -> (SendRequest<Body>, Connection<TokioIo<TcpStream>, Body, TokioExecutor>) {
    let stream = TcpStream::connect(address).await.unwrap();
    // Without this option each call waits 40 ms for the acknowledgement of the previous one.
    stream.set_nodelay(true).unwrap();
    handshake(TokioExecutor::new(), TokioIo::new(stream)).await.unwrap()
}

/// An HTTP/2 connection, polled by a task.
pub(crate) async fn connect(address: &str) -> SendRequest<Body> {
    let (client, connection) = connection(address).await;
    tokio::spawn(connection);
    client
}

/// An HTTP/2 connection from another loopback address. Its streams accept `window` bytes before the
/// server must wait until they are read.
pub(crate) async fn connect_from(from: &str, address: &str, window: u32) -> SendRequest<Body> {
    let socket = tokio::net::TcpSocket::new_v4().unwrap();
    socket.bind(format!("{from}:0").parse().unwrap()).unwrap();
    let stream = socket.connect(address.parse().unwrap()).await.unwrap();
    stream.set_nodelay(true).unwrap();
    let mut http = hyper::client::conn::http2::Builder::new(TokioExecutor::new());
    http.initial_stream_window_size(window).initial_connection_window_size(1 << 20);
    let (client, connection) = http.handshake(TokioIo::new(stream)).await.unwrap();
    tokio::spawn(connection);
    client
}

/// A call of the method `path`.
pub(crate) fn call(path: &str, headers: &[(&str, &str)], body: Body) -> Request<Body> {
    let request = Request::post(format!("http://localhost{path}"))
        .header("content-type", "application/grpc")
        .header("te", "trailers");
    headers.iter().fold(request, |request, (name, value)| request.header(*name, *value)).body(body).unwrap()
}

/// The status of a call of `path` on a new connection, and the headers or trailers that contained
/// it.
pub(crate) async fn status_of(
    address: &str,
    path: &str,
    headers: &[(&str, &str)],
    body: Bytes,
) -> (Status, HeaderMap) {
    status_on(&mut connect(address).await, path, headers, body).await
}

/// The status of a call on an existing connection, and the headers or trailers that contained it.
pub(crate) async fn status_on(
    client: &mut SendRequest<Body>,
    path: &str,
    headers: &[(&str, &str)],
    body: Bytes,
) -> (Status, HeaderMap) {
    let response = client.send_request(call(path, headers, Body::Whole(body))).await.unwrap();
    ended(response).await
}

/// The final status of a response.
pub(crate) async fn status_in(response: Response<Incoming>) -> Status {
    ended(response).await.0
}

/// The final status of a response, and the headers or trailers that contained it.
async fn ended(response: Response<Incoming>) -> (Status, HeaderMap) {
    if let Some(status) = Status::from_header_map(response.headers()) {
        return (status, response.headers().clone());
    }
    let mut body = response.into_body();
    while let Some(frame) = poll_fn(|cx| Pin::new(&mut body).poll_frame(cx)).await {
        if let Ok(trailers) = frame.unwrap().into_trailers() {
            return (Status::from_header_map(&trailers).expect("a status"), trailers);
        }
    }
    panic!("a gRPC answer ends in trailers")
}

/// The bytes of the answer to a call of `path` on a new connection. The call is repeated as long as
/// the server is too busy.
pub(crate) async fn answer_of(address: &str, path: &str, body: Bytes) -> Bytes {
    loop {
        let request = call(path, &[], Body::Whole(body.clone()));
        let response = connect(address).await.send_request(request).await.unwrap();
        if let Some(status) = Status::from_header_map(response.headers()) {
            assert_eq!(status.code(), tonic::Code::Unavailable, "{status}");
            continue;
        }
        let (mut body, mut answer) = (response.into_body(), BytesMut::new());
        let mut status = None;
        while let Some(frame) = poll_fn(|cx| Pin::new(&mut body).poll_frame(cx)).await {
            match frame.unwrap().into_data() {
                Ok(data) => answer.put(data),
                Err(frame) => status = Status::from_header_map(&frame.into_trailers().expect("trailers")),
            }
        }
        let status = status.expect("a gRPC answer ends in trailers");
        if status.code() == tonic::Code::Ok {
            return answer.freeze();
        }
        assert_eq!(status.code(), tonic::Code::Unavailable, "{status}");
    }
}

/// A gRPC frame that contains `message`.
pub(crate) fn frame(compressed: bool, message: &[u8]) -> Bytes {
    let mut frame = BytesMut::new();
    frame.put_u8(compressed.into());
    frame.put_u32(message.len() as u32);
    frame.put_slice(message);
    frame.freeze()
}
