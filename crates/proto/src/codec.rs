//! The gRPC codecs. A client's codec reads and writes messages, numeric columns in bulk. A
//! server's codec writes messages in the same way, and leaves requests encoded: they are
//! decoded where their size can be bounded and the work can be stopped (`service::decode` of the server).

use std::marker::PhantomData;

use bytes::{Buf, Bytes};
use tonic::{
    Status,
    codec::{BufferSettings, DecodeBuf, Decoder, EncodeBuf, Encoder},
};

use super::bulk::{Columnar, decode, encode};

/// Buffers start small, because most messages are small, and grow once, to the message's size.
const BUFFER_BYTES: usize = 4 << 10;

/// Messages of a stream are gathered up to this before they are handed to the connection. The buffer lives
/// as long as its call, so it has to stay small.
const GATHERED_BYTES: usize = 16 << 10;

/// A message of type `M` as it arrived: its bytes, neither decoded nor checked.
#[derive(Clone, Debug)]
pub struct Encoded<M> {
    bytes: Bytes,
    message: PhantomData<fn() -> M>,
}

impl<M> Encoded<M> {
    /// The bytes that are meant to be an `M`.
    pub fn new(bytes: Bytes) -> Self {
        Self { bytes, message: PhantomData }
    }

    /// How many bytes the message has.
    pub fn len(&self) -> usize {
        self.bytes.len()
    }

    /// Whether the message has no bytes: every field has its default.
    pub fn is_empty(&self) -> bool {
        self.bytes.is_empty()
    }

    /// The message's bytes.
    pub fn into_bytes(self) -> Bytes {
        self.bytes
    }
}

/// Encodes `T` and decodes `U`.
#[derive(Clone, Copy, Debug)]
pub struct Codec<T, U>(PhantomData<fn(T) -> U>);

impl<T, U> Default for Codec<T, U> {
    fn default() -> Self {
        Self(PhantomData)
    }
}

impl<T, U> tonic::codec::Codec for Codec<T, U>
where
    T: Columnar + Send + 'static,
    U: Columnar + Send + 'static,
{
    type Encode = T;
    type Decode = U;
    type Encoder = Self;
    type Decoder = Self;

    fn encoder(&mut self) -> Self {
        Self(PhantomData)
    }

    fn decoder(&mut self) -> Self {
        Self(PhantomData)
    }
}

impl<T: Columnar, U> Encoder for Codec<T, U> {
    type Item = T;
    type Error = Status;

    fn encode(&mut self, mut message: T, buffer: &mut EncodeBuf<'_>) -> Result<(), Status> {
        buffer.reserve(message.encoded_len());
        encode(&mut message, buffer);
        Ok(())
    }

    fn buffer_settings(&self) -> BufferSettings {
        settings()
    }
}

impl<T, U: Columnar> Decoder for Codec<T, U> {
    type Item = U;
    type Error = Status;

    fn decode(&mut self, buffer: &mut DecodeBuf<'_>) -> Result<Option<U>, Status> {
        let bytes = buffer.copy_to_bytes(buffer.remaining());
        decode(bytes).map(Some).map_err(|error| Status::internal(error.to_string()))
    }

    fn buffer_settings(&self) -> BufferSettings {
        settings()
    }
}

/// Encodes `T`, and leaves each `U` encoded as it arrived.
#[derive(Clone, Copy, Debug)]
pub struct ServerCodec<T, U>(PhantomData<fn(T) -> U>);

impl<T, U> Default for ServerCodec<T, U> {
    fn default() -> Self {
        Self(PhantomData)
    }
}

impl<T, U> tonic::codec::Codec for ServerCodec<T, U>
where
    T: Columnar + Send + 'static,
    U: Send + 'static,
{
    type Encode = T;
    type Decode = Encoded<U>;
    type Encoder = Codec<T, U>;
    type Decoder = Self;

    fn encoder(&mut self) -> Codec<T, U> {
        Codec::default()
    }

    fn decoder(&mut self) -> Self {
        Self::default()
    }
}

impl<T, U> Decoder for ServerCodec<T, U> {
    type Item = Encoded<U>;
    type Error = Status;

    /// tonic's buffer has the whole message and nothing else: its bytes are split off, not copied.
    fn decode(&mut self, buffer: &mut DecodeBuf<'_>) -> Result<Option<Encoded<U>>, Status> {
        Ok(Some(Encoded::new(buffer.copy_to_bytes(buffer.remaining()))))
    }

    fn buffer_settings(&self) -> BufferSettings {
        settings()
    }
}

fn settings() -> BufferSettings {
    BufferSettings::new(BUFFER_BYTES, GATHERED_BYTES)
}
