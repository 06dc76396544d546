//! Decodes requests within bounds.
//!
//! Each request is read twice. The first pass allocates nothing: it counts the elements of every
//! repeated field and refuses counts over a limit, with the field's name. Then the memory of the
//! decoded request is taken from the call's budget, and the second pass reserves every column once
//! and fills it. A request of n bytes therefore needs at most 2 n bytes, plus
//! [`HULL_BYTES`](crate::service::sizes::HULL_BYTES) for each hull or id, whose number is limited, plus
//! 8 KiB. The columns themselves need at most n bytes; the factor 2 covers the lists that validation adds.
//!
//! Every message that prost accepts is accepted, with the same meaning.

mod definitions;
mod query;
mod records;
#[cfg(test)]
mod tests;

use super::fields::Fields;
#[cfg(feature = "testing")]
use super::{find::find, request::stoppable_scene, steps::step};
use crate::{
    contact::{Stop, stop::Meter},
    proto,
    service::{error::ServiceError, limits::Limits},
};

/// The memory that any request may need for its outputs, the paths of its field mask, and an error. The
/// memory that each call takes covers it.
#[cfg(any(test, feature = "testing"))]
pub const CONSTANT_BYTES: usize = 8 << 10;

/// The limits, the step counter and the memory for decoding one request.
pub(in crate::service) struct DecodeResources<'a> {
    limits: &'a Limits,
    meter: Meter<'a>,
    take: &'a mut (dyn FnMut(usize) -> Result<(), ServiceError> + Send),
}

impl<'a> DecodeResources<'a> {
    /// `take` takes memory from the call's budget before it is allocated; `stop` ends the work.
    pub(in crate::service) fn new(
        limits: &'a Limits,
        stop: &'a Stop,
        take: &'a mut (dyn FnMut(usize) -> Result<(), ServiceError> + Send),
    ) -> Self {
        Self { limits, meter: Meter::new(stop), take }
    }
}

/// A message that a client may send.
pub(in crate::service) trait DecodeRequest: Send + Sync + 'static {
    /// The decoded message.
    type Decoded: Send + 'static;

    /// Decodes a message.
    ///
    /// # Errors
    /// The message is malformed or exceeds a limit, the budget has no room for it, or the work was stopped.
    fn read(message: &[u8], resources: &mut DecodeResources<'_>) -> Result<Self::Decoded, ServiceError>;
}

impl DecodeRequest for proto::GetServerInfoRequest {
    type Decoded = ();

    fn read(message: &[u8], resources: &mut DecodeResources<'_>) -> Result<(), ServiceError> {
        let mut fields = Fields::new(message);
        while fields.next(&resources.meter)?.is_some() {}
        Ok(())
    }
}

/// Decodes and checks a message as the handler of `method` does. Returns the number of bytes that this takes
/// from the budget. The fuzz target and the tests of memory use it.
///
/// # Errors
/// The errors of the handler.
#[cfg(feature = "testing")]
pub fn decoded_bytes(
    method: &str,
    message: &[u8],
    limits: &Limits,
    stop: &Stop,
) -> Result<usize, ServiceError> {
    fn decode<M: DecodeRequest>(
        message: &[u8],
        limits: &Limits,
        stop: &Stop,
    ) -> Result<(M::Decoded, usize), ServiceError> {
        let mut taken = 0;
        let mut take = |bytes| {
            taken += bytes;
            Ok(())
        };
        let decoded = M::read(message, &mut DecodeResources::new(limits, stop, &mut take))?;
        Ok((decoded, taken))
    }
    let bytes = match method {
        "FindContacts" => {
            let (request, bytes) = decode::<proto::QueryContactsRequest>(message, limits, stop)?;
            find(request, limits, stop)?;
            bytes
        }
        "StreamContacts" => {
            let (request, mut bytes) = decode::<proto::QueryContactsRequest>(message, limits, stop)?;
            let grow = |more| {
                bytes += more;
                Ok(())
            };
            step(request, None, limits, stop, grow)?;
            bytes
        }
        "RegisterHulls" => decode::<proto::RegisterHullsRequest>(message, limits, stop)?.1,
        "GetHulls" => decode::<proto::GetHullsRequest>(message, limits, stop)?.1,
        "HasHulls" => decode::<proto::HasHullsRequest>(message, limits, stop)?.1,
        "DeleteHulls" => decode::<proto::DeleteHullsRequest>(message, limits, stop)?.1,
        "ListHulls" => decode::<proto::ListHullsRequest>(message, limits, stop)?.1,
        "GetServerInfo" => decode::<proto::GetServerInfoRequest>(message, limits, stop)?.1,
        _ => {
            let (request, bytes) = decode::<proto::QueryContactsRequest>(message, limits, stop)?;
            stoppable_scene(request, limits, stop)?;
            bytes
        }
    };
    Ok(bytes)
}
