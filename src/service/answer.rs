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
    contact::Stop,
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
    Ok(encoded(app, context, message, memory, false).await?.0)
}

/// Does the same as [`answer`], for an answer whose memory is taken already.
pub(super) async fn counted_answer<M: Columnar + Send + 'static>(
    app: &App,
    context: &CallContext,
    message: M,
    memory: Permit,
) -> Result<M, ServiceError> {
    Ok(encoded(app, context, message, memory, false).await?.0)
}

/// Does the same as [`counted_answer`], for an answer whose columns the caller goes on using. Returns the message
/// that tonic has to encode, and the whole answer.
pub(super) async fn kept_answer<M: Columnar + Clone + Send + 'static>(
    app: &App,
    context: &CallContext,
    message: M,
    memory: Permit,
) -> Result<(M, M), ServiceError> {
    match encoded(app, context, message, memory, true).await? {
        (passed, Some(whole)) => Ok((passed, whole)),
        (passed, None) => Ok((passed.clone(), passed)),
    }
}

/// Encodes an answer if it is large. Then the second value is the answer, if it is to be kept.
async fn encoded<M: Columnar + Send + 'static>(
    app: &App,
    context: &CallContext,
    message: M,
    mut memory: Permit,
    is_kept: bool,
) -> Result<(M, Option<M>), ServiceError> {
    let length = message.encoded_len();
    if length > app.limits().max_message_bytes {
        return Err(too_large(app, length));
    }
    // An empty message stands for a large one, so it is never passed on as it is.
    if length > 0 && length <= SMALL_BYTES {
        return Ok((message, None));
    }
    grow(app, &mut memory, HEAD_BYTES + length)?;
    let encode = move |_: &Stop| {
        let mut message = message;
        let bytes = framed(&mut message, length);
        Ok((bytes, is_kept.then_some(message)))
    };
    let (bytes, whole) = offloaded(app, context, length, encode).await?;
    memory.shrink_to(bytes.len() as u64);
    context.keep_answer(EncodedAnswer { bytes, memory });
    Ok((M::default(), whole))
}

/// A message of `length` bytes with its head.
fn framed<M: Columnar>(message: &mut M, length: usize) -> Bytes {
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
