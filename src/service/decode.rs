//! Decodes requests. The memory comes from the call's budget, and a large request does not delay
//! the other calls of its thread.

use std::sync::Arc;

use super::{
    App, ServiceError,
    context::{CallContext, grow},
    limits::Limits,
    offload::offloaded,
    wire::{DecodeRequest, DecodeResources},
};
use crate::{
    budget::{Part, Permit},
    compute::LARGE_BYTES,
    contact::Stop,
    proto::Encoded,
};

/// Decodes a request, then checks it with `check`. The check receives the memory that was taken for
/// the request from the call's budget, and runs on the same thread.
///
/// # Errors
/// The errors of [`DecodeRequest::read`] and of `check`.
pub(super) async fn decode_request<M: DecodeRequest, T: Send + 'static>(
    app: &Arc<App>,
    context: &CallContext,
    message: Encoded<M>,
    check: impl FnOnce(M::Decoded, Permit, &Limits, &Stop) -> Result<T, ServiceError> + Send + 'static,
) -> Result<T, ServiceError> {
    let arrived = context.received_message(message.into_bytes());
    let length = arrived.len();
    let mut memory = context.covered(Part::Decoded);
    let decode = move |app: &App, stop: &Stop| {
        let (bytes, arriving) = arrived.joined();
        let mut take = |bytes| grow(app, &mut memory, bytes);
        let request = M::read(&bytes, &mut DecodeResources::new(app.limits(), stop, &mut take))?;
        drop((bytes, arriving));
        check(request, memory, app.limits(), stop)
    };
    if length <= LARGE_BYTES {
        return decode(app, &context.job.stop);
    }
    let of_thread = app.clone();
    offloaded(app, context, length, move |stop| decode(&of_thread, stop)).await
}
