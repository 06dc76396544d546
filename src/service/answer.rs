//! Answers on their way to the transport.
//!
//! tonic encodes a message on the thread that serves the connection, into a buffer that it keeps until the
//! call ends. That suits small answers. A large answer is encoded here instead: on the compute threads, into
//! memory that the call has taken. It then waits in the call's context, tonic encodes an empty message in
//! its place, and the response's body puts it back ([`AnswerBody`](super::answer_body::AnswerBody)).

use bytes::{BufMut, Bytes, BytesMut};

use super::{
    App, Reason, ServiceError,
    context::{CallContext, EncodedAnswer, grow},
    offload::offloaded,
    request_body::HEAD_BYTES,
    sizes::SMALL_BYTES,
};
use crate::{
    budget::{Part, Permit},
    proto::bulk::{Columnar, encode},
    size::ByteSize,
};

/// An answer is held in memory twice: as a message and encoded.
pub(super) const ANSWER_COPIES: usize = 2;

/// Checks that an answer is within the message limit, takes the memory for it, and encodes it if it is large.
/// Returns the message that tonic has to encode.
///
/// # Errors
/// RESPONSE_TOO_LARGE; TOO_BUSY or MEMORY_TOO_LARGE if there is no memory.
pub(super) async fn answer<M: Columnar + Send + 'static>(
    app: &App,
    context: &CallContext,
    message: M,
) -> Result<M, ServiceError> {
    let length = message.encoded_len();
    let mut memory = context.covered(Part::Answers);
    grow(app, &mut memory, length)?;
    encoded(app, context, message, length, memory).await
}

/// Does the same as [`answer`], for an answer whose memory is taken already.
pub(super) async fn counted_answer<M: Columnar + Send + 'static>(
    app: &App,
    context: &CallContext,
    message: M,
    memory: Permit,
) -> Result<M, ServiceError> {
    let length = message.encoded_len();
    encoded(app, context, message, length, memory).await
}

/// Encodes an answer of `length` bytes if it is large.
async fn encoded<M: Columnar + Send + 'static>(
    app: &App,
    context: &CallContext,
    message: M,
    length: usize,
    mut memory: Permit,
) -> Result<M, ServiceError> {
    if length > app.limits().max_message_bytes {
        return Err(too_large(app, length));
    }
    // An empty message stands for a large one, so it is never passed on as it is.
    if length > 0 && length <= SMALL_BYTES {
        return Ok(message);
    }
    grow(app, &mut memory, HEAD_BYTES + length)?;
    let bytes = offloaded(app, context, length, move |_| Ok(framed(message, length))).await?;
    memory.shrink_to(bytes.len() as u64);
    context.keep_answer(EncodedAnswer { bytes, memory });
    Ok(M::default())
}

/// A message of `length` bytes with its head.
fn framed<M: Columnar>(message: M, length: usize) -> Bytes {
    let mut bytes = BytesMut::with_capacity(HEAD_BYTES + length);
    bytes.put_u8(0);
    bytes.put_u32(length as u32);
    encode(message, &mut bytes);
    bytes.freeze()
}

/// The error for an answer of at least `bytes` bytes.
pub(super) fn too_large(app: &App, bytes: usize) -> ServiceError {
    let [bytes, limit] = [bytes, app.limits().max_message_bytes].map(|bytes| ByteSize(bytes as u64));
    let message =
        format!("the answer has at least {bytes}, at most {limit} are allowed: request less at a time");
    ServiceError::new(Reason::ResponseTooLarge, message)
}
