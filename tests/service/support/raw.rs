//! gRPC by hand, for what a well-behaved client cannot send: it enforces its own deadline,
//! checks its own messages and never names a method that is not there.

use bytes::{BufMut, Bytes, BytesMut};
use http::{HeaderMap, Request};
use tokio::net::TcpStream;
use tonic::Status;

/// The status of a call of `path` with `headers` and `body`.
pub(crate) async fn status_of(
    address: &str,
    path: &str,
    headers: &[(&str, &str)],
    body: Bytes,
) -> (Status, HeaderMap) {
    let stream = TcpStream::connect(address).await.unwrap();
    let (client, connection) = h2::client::handshake(stream).await.unwrap();
    tokio::spawn(connection);
    let mut request = Request::post(format!("http://{address}{path}"))
        .header("content-type", "application/grpc")
        .header("te", "trailers");
    for (name, value) in headers {
        request = request.header(*name, *value);
    }
    let mut client = client.ready().await.unwrap();
    let (response, mut send) = client.send_request(request.body(()).unwrap(), false).unwrap();
    // A server that refuses by the headers resets before it has read the body.
    let _ = send.send_data(body, true);
    let response = response.await.unwrap();
    if let Some(status) = Status::from_header_map(response.headers()) {
        return (status, response.headers().clone());
    }
    let mut body = response.into_body();
    while let Some(data) = body.data().await {
        let data = data.unwrap();
        body.flow_control().release_capacity(data.len()).unwrap();
    }
    let trailers = body.trailers().await.unwrap().expect("a gRPC answer ends in trailers");
    (Status::from_header_map(&trailers).expect("a status"), trailers)
}

/// A gRPC frame around `message`.
pub(crate) fn frame(compressed: bool, message: &[u8]) -> Bytes {
    let mut frame = BytesMut::new();
    frame.put_u8(compressed.into());
    frame.put_u32(message.len() as u32);
    frame.put_slice(message);
    frame.freeze()
}
