//! A gRPC client and an echo server whose messages are raw bytes. They show the cost of the transport
//! if no message is decoded.

use std::convert::Infallible;
use std::error::Error;
use std::future::{Ready, poll_fn, ready};
use std::pin::Pin;
use std::task::{Context, Poll};

use bytes::{Buf, BufMut, Bytes};
use hyper::server::conn::http2;
use hyper::service::service_fn;
use hyper_util::rt::{TokioExecutor, TokioIo};
use tokio::net::TcpListener;
use tokio_stream::Stream;
use tonic::client::Grpc;
use tonic::codec::{BufferSettings, Codec, DecodeBuf, Decoder, EncodeBuf, Encoder};
use tonic::codegen::Service;
use tonic::codegen::http::uri::PathAndQuery;
use tonic::transport::{Channel, Endpoint};
use tonic::{Request, Response, Status, Streaming};

/// The window and frame sizes of the hullcast server.
const WINDOW_BYTES: u32 = 8 << 20;
const FRAME_BYTES: u32 = 1 << 20;

/// A codec that passes messages on as the bytes on the wire.
#[derive(Clone, Copy, Default)]
pub struct Raw;

impl Codec for Raw {
    type Encode = Bytes;
    type Decode = Bytes;
    type Encoder = Self;
    type Decoder = Self;

    fn encoder(&mut self) -> Self {
        Self
    }

    fn decoder(&mut self) -> Self {
        Self
    }
}

fn settings() -> BufferSettings {
    BufferSettings::new(4 << 10, 64 << 10)
}

impl Encoder for Raw {
    type Item = Bytes;
    type Error = Status;

    fn encode(&mut self, message: Bytes, buffer: &mut EncodeBuf<'_>) -> Result<(), Status> {
        buffer.reserve(message.len());
        buffer.put_slice(&message);
        Ok(())
    }

    fn buffer_settings(&self) -> BufferSettings {
        settings()
    }
}

impl Decoder for Raw {
    type Item = Bytes;
    type Error = Status;

    fn decode(&mut self, buffer: &mut DecodeBuf<'_>) -> Result<Option<Bytes>, Status> {
        Ok(Some(buffer.copy_to_bytes(buffer.remaining())))
    }

    fn buffer_settings(&self) -> BufferSettings {
        settings()
    }
}

/// A connection to one method of a server.
#[derive(Clone)]
pub struct RawClient {
    grpc: Grpc<Channel>,
    path: PathAndQuery,
}

impl RawClient {
    /// Connects to the method `path` of the server at `address`, host:port.
    pub async fn connect(address: &str, path: &'static str) -> Result<Self, Box<dyn Error>> {
        let endpoint = Endpoint::from_shared(format!("http://{address}"))?
            .initial_stream_window_size(WINDOW_BYTES)
            .initial_connection_window_size(WINDOW_BYTES);
        let grpc = Grpc::new(endpoint.connect().await?).max_decoding_message_size(usize::MAX);
        Ok(Self { grpc, path: PathAndQuery::from_static(path) })
    }

    /// Sends one message and waits for its answer.
    pub async fn call(&mut self, message: Bytes) -> Result<Bytes, Status> {
        self.ready().await?;
        Ok(self.grpc.unary(Request::new(message), self.path.clone(), Raw).await?.into_inner())
    }

    /// Sends a stream of messages and returns the stream of answers.
    pub async fn stream(
        &mut self,
        messages: impl Stream<Item = Bytes> + Send + 'static,
    ) -> Result<Streaming<Bytes>, Status> {
        self.ready().await?;
        Ok(self.grpc.streaming(Request::new(messages), self.path.clone(), Raw).await?.into_inner())
    }

    async fn ready(&mut self) -> Result<(), Status> {
        self.grpc.ready().await.map_err(|error| Status::unknown(error.to_string()))
    }
}

/// Waits for the next answer of a stream.
pub async fn next(answers: &mut Streaming<Bytes>) -> Result<Bytes, Status> {
    let next = poll_fn(|cx| Pin::new(&mut *answers).poll_next(cx)).await;
    next.unwrap_or_else(|| Err(Status::unknown("the stream ended")))
}

/// Answers every message with the same `bytes` bytes. It is a bare tonic service on hyper, set up as in
/// the hullcast server.
pub async fn serve_echo(bytes: usize) -> Result<(), Box<dyn Error>> {
    let echo = Echo(vec![0; bytes].into());
    let listener = TcpListener::bind("127.0.0.1:0").await?;
    println!("listening on {}", listener.local_addr()?);
    let mut http = http2::Builder::new(TokioExecutor::new());
    http.initial_stream_window_size(WINDOW_BYTES)
        .initial_connection_window_size(WINDOW_BYTES)
        .max_frame_size(FRAME_BYTES);
    loop {
        let (stream, _) = listener.accept().await?;
        stream.set_nodelay(true)?;
        let echo = echo.clone();
        let answer = service_fn(move |request| {
            let echo = echo.clone();
            async move {
                let mut grpc = tonic::server::Grpc::new(Raw).max_decoding_message_size(usize::MAX);
                Ok::<_, Infallible>(grpc.unary(echo, request).await)
            }
        });
        tokio::spawn(http.serve_connection(TokioIo::new(stream), answer));
    }
}

#[derive(Clone)]
struct Echo(Bytes);

impl Service<Request<Bytes>> for Echo {
    type Response = Response<Bytes>;
    type Error = Status;
    type Future = Ready<Result<Response<Bytes>, Status>>;

    fn poll_ready(&mut self, _: &mut Context<'_>) -> Poll<Result<(), Status>> {
        Poll::Ready(Ok(()))
    }

    fn call(&mut self, _: Request<Bytes>) -> Self::Future {
        ready(Ok(Response::new(self.0.clone())))
    }
}
