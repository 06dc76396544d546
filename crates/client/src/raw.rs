//! Calls whose messages are bytes, for programs that send recorded requests again.

use prost::bytes::{Buf, BufMut, Bytes};
use tonic::client::Grpc;
use tonic::codec::{Codec, DecodeBuf, Decoder, EncodeBuf, Encoder};
use tonic::codegen::http::uri::PathAndQuery;
use tonic::{Request, Status};

use crate::Client;

/// Hands bytes on as they are.
#[derive(Clone, Copy, Debug, Default)]
struct RawCodec;

impl Codec for RawCodec {
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

impl Encoder for RawCodec {
    type Item = Bytes;
    type Error = Status;

    fn encode(&mut self, message: Bytes, buffer: &mut EncodeBuf<'_>) -> Result<(), Status> {
        buffer.put(message);
        Ok(())
    }
}

impl Decoder for RawCodec {
    type Item = Bytes;
    type Error = Status;

    fn decode(&mut self, buffer: &mut DecodeBuf<'_>) -> Result<Option<Bytes>, Status> {
        Ok(Some(buffer.copy_to_bytes(buffer.remaining())))
    }
}

impl Client {
    /// Calls `method` (the path without the leading slash) with these encoded messages, and hands each encoded
    /// message of the answer to `answered`. The call is not repeated and has no timeout. Nothing is checked.
    ///
    /// # Errors
    /// The status with which the call ends, unless it is OK.
    pub async fn raw(
        &self,
        method: &str,
        messages: Vec<Bytes>,
        mut answered: impl FnMut(&[u8]),
    ) -> Result<(), Status> {
        let path: PathAndQuery = format!("/{method}")
            .parse()
            .map_err(|_| Status::invalid_argument(format!("{method:?} is not the name of a method")))?;
        let mut grpc = Grpc::new(self.service())
            .max_encoding_message_size(usize::MAX)
            .max_decoding_message_size(usize::MAX);
        grpc.ready().await.map_err(|error| Status::unavailable(error.to_string()))?;
        let request = Request::new(tokio_stream::iter(messages));
        let mut answer = grpc.streaming(request, path, RawCodec).await?.into_inner();
        while let Some(message) = answer.message().await? {
            answered(&message);
        }
        Ok(())
    }
}
