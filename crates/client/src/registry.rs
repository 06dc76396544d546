//! Calls about registered hulls.

use std::collections::HashSet;

use hullcast_proto::register_hull_result::Result as Registered;
use hullcast_proto::{
    DeleteHullsRequest, GetHullsRequest, HasHullsRequest, HullDefinition, HullRecord, Limits,
    RegisterHullResult, RegisterHullsRequest,
};
use prost::Message;
use prost_types::FieldMask;

use crate::client::Deadline;
use crate::{Client, Error, Hull, HullId, HullRefused, Malformed};

/// Hulls per message. For ordinary hulls that is at most some megabytes.
const HULLS_PER_MESSAGE: usize = 256;

/// A part of the description of a hull ([`Client::get`]).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum HullPart {
    /// The counts, mass properties and radii: [`HullRecord::info`].
    Info,
    /// The vertices and their indices among the registered points.
    Vertices,
    /// The faces and their normals.
    Faces,
}

impl Client {
    /// Registers hulls, so that queries can name them by id. Returns one id per hull, in order.
    ///
    /// Only the hulls that the server lacks are sent, in as many messages as its limits need. So registering
    /// hulls again costs little, and a caller whose token may only query can use hulls that are there.
    ///
    /// # Errors
    /// [`Error::HullsRefused`] names every hull that the server refused; all others are registered.
    /// [`Error::Refused`], with the reason `TOKEN_MAY_NOT` if the token may not register, and `STORE_FULL` if
    /// the store has no room. After an error some of the hulls may be registered.
    pub async fn register(&self, hulls: &[Hull]) -> Result<Vec<HullId>, Error> {
        let deadline = self.deadline();
        let ids: Vec<HullId> = hulls.iter().map(Hull::id).collect();
        let missing = self.missing_by(deadline, &ids).await?;
        self.put_by(deadline, hulls, &ids, &missing).await?;
        Ok(ids)
    }

    /// Registers hulls without asking first which of them the server has. Returns one id per hull, in order.
    ///
    /// # Errors
    /// Those of [`Client::register`].
    pub async fn put(&self, hulls: &[Hull]) -> Result<Vec<HullId>, Error> {
        let ids: Vec<HullId> = hulls.iter().map(Hull::id).collect();
        let all: Vec<usize> = (0..hulls.len()).collect();
        self.put_by(self.deadline(), hulls, &ids, &all).await?;
        Ok(ids)
    }

    /// The indices in `ids` of the hulls that the server lacks, ascending. If an id is listed several times,
    /// only its first index is returned.
    ///
    /// # Errors
    /// [`Error::Refused`] if the store cannot be read.
    pub async fn missing(&self, ids: &[HullId]) -> Result<Vec<usize>, Error> {
        self.missing_by(self.deadline(), ids).await
    }

    pub(crate) async fn missing_by(&self, deadline: Deadline, ids: &[HullId]) -> Result<Vec<usize>, Error> {
        let mut seen = HashSet::new();
        let distinct: Vec<usize> = (0..ids.len()).filter(|&hull| seen.insert(ids[hull])).collect();
        let asked: Vec<HullId> = distinct.iter().map(|&hull| ids[hull]).collect();
        let present = self.has_by(deadline, &asked).await?;
        Ok(distinct.into_iter().zip(present).filter(|(_, present)| !present).map(|(hull, _)| hull).collect())
    }

    /// Whether the server can use each of these hulls in queries, in order.
    ///
    /// # Errors
    /// [`Error::Refused`] if the store cannot be read.
    pub async fn has(&self, ids: &[HullId]) -> Result<Vec<bool>, Error> {
        self.has_by(self.deadline(), ids).await
    }

    async fn has_by(&self, deadline: Deadline, ids: &[HullId]) -> Result<Vec<bool>, Error> {
        let mut all = Vec::with_capacity(ids.len());
        for part in ids.chunks(self.hulls_per_message(deadline).await?) {
            let message = HasHullsRequest { ids: bytes(part) };
            let answer = self
                .call(deadline, &message, |request| {
                    let mut stub = self.hulls();
                    async move { stub.has_hulls(request).await }
                })
                .await?;
            Malformed::unless_one_each("present", answer.present.len(), part.len())?;
            all.extend(answer.present);
        }
        Ok(all)
    }

    /// Describes hulls: one record per id, in order, or `None` for a hull that the server does not have.
    ///
    /// # Errors
    /// [`Error::Refused`] if the store cannot be read, or if the description of a single hull is larger than
    /// a message.
    pub async fn get(&self, ids: &[HullId], parts: &[HullPart]) -> Result<Vec<Option<HullRecord>>, Error> {
        let deadline = self.deadline();
        let paths = parts.iter().map(|part| part.path().to_owned()).collect();
        let mut message = GetHullsRequest { ids: Vec::new(), field_mask: Some(FieldMask { paths }) };
        let mut most = self.hulls_per_message(deadline).await?;
        let mut all = Vec::with_capacity(ids.len());
        let mut rest = ids;
        while !rest.is_empty() {
            let (now, later) = rest.split_at(rest.len().min(most));
            message.ids = bytes(now);
            let answer = self
                .call(deadline, &message, |request| {
                    let mut stub = self.hulls();
                    async move { stub.get_hulls(request).await }
                })
                .await;
            let records = match answer {
                Err(error) if now.len() > 1 && error.is_for(&["RESPONSE_TOO_LARGE", "MEMORY_TOO_LARGE"]) => {
                    most = now.len() / 2;
                    continue;
                }
                answer => answer?.hulls,
            };
            Malformed::unless_one_each("hulls", records.len(), now.len())?;
            for (record, id) in records.into_iter().zip(now) {
                if record.id != id.0 {
                    return Err(Malformed::new(format!("a record is not that of the hull {id}")).into());
                }
                all.push(record.found.then_some(record));
            }
            rest = later;
        }
        Ok(all)
    }

    /// Removes hulls from the store. Returns, for each id in order, whether the hull was stored before.
    ///
    /// # Errors
    /// [`Error::Refused`], with the reason `TOKEN_MAY_NOT` if the token may not delete. After an error some
    /// of the hulls may be deleted.
    pub async fn delete(&self, ids: &[HullId]) -> Result<Vec<bool>, Error> {
        let deadline = self.deadline();
        let mut all = Vec::with_capacity(ids.len());
        for part in ids.chunks(self.hulls_per_message(deadline).await?) {
            let message = DeleteHullsRequest { ids: bytes(part) };
            let answer = self
                .call(deadline, &message, |request| {
                    let mut stub = self.hulls();
                    async move { stub.delete_hulls(request).await }
                })
                .await?;
            Malformed::unless_one_each("deleted", answer.deleted.len(), part.len())?;
            all.extend(answer.deleted);
        }
        Ok(all)
    }

    /// Sends the definitions of the hulls at these indices.
    pub(crate) async fn put_by(
        &self,
        deadline: Deadline,
        hulls: &[Hull],
        ids: &[HullId],
        places: &[usize],
    ) -> Result<(), Error> {
        if places.is_empty() {
            return Ok(());
        }
        let limits = self.limits(deadline).await?;
        let mut refused = Vec::new();
        let mut rest = places;
        while !rest.is_empty() {
            let message = first_message(hulls, rest, &limits);
            let (now, later) = rest.split_at(message.hulls.len());
            let answer = self
                .call(deadline, &message, |request| {
                    let mut stub = self.hulls();
                    async move { stub.register_hulls(request).await }
                })
                .await?;
            Malformed::unless_one_each("results", answer.results.len(), now.len())?;
            for (&place, result) in now.iter().zip(answer.results) {
                refused.extend(registered(place, ids[place], result)?);
            }
            rest = later;
        }
        if refused.is_empty() { Ok(()) } else { Err(Error::HullsRefused(refused)) }
    }

    async fn hulls_per_message(&self, deadline: Deadline) -> Result<usize, Error> {
        Ok(most_hulls(&self.limits(deadline).await?))
    }
}

impl HullPart {
    fn path(self) -> &'static str {
        match self {
            Self::Info => "info",
            Self::Vertices => "vertices",
            Self::Faces => "faces",
        }
    }
}

/// The most hulls of a message.
fn most_hulls(limits: &Limits) -> usize {
    HULLS_PER_MESSAGE.min(limits.max_hulls_per_request as usize).max(1)
}

/// A message with as many of the hulls at these indices as the limits allow, but at least one.
fn first_message(hulls: &[Hull], places: &[usize], limits: &Limits) -> RegisterHullsRequest {
    let most = most_hulls(limits);
    let mut message = RegisterHullsRequest::default();
    let mut room = limits.max_message_bytes;
    for &place in places {
        let definition = hulls[place].definition();
        let size = size_in_list(&definition);
        if !message.hulls.is_empty() && (message.hulls.len() >= most || size > room) {
            break;
        }
        room = room.saturating_sub(size);
        message.hulls.push(definition);
    }
    message
}

/// The most bytes of a definition as an entry of a message: its own, and those of its length and its tag.
fn size_in_list(definition: &HullDefinition) -> u64 {
    definition.encoded_len() as u64 + 11
}

/// The refusal of the hull at `place`, or `None` if it is registered.
fn registered(
    place: usize,
    id: HullId,
    result: RegisterHullResult,
) -> Result<Option<HullRefused>, Malformed> {
    match result.result {
        Some(Registered::Hull(info)) if info.id == id.0 => Ok(None),
        Some(Registered::Hull(_)) => Err(Malformed::new(format!(
            "the id of hulls[{place}] is not the hash of the hull's content, {id}"
        ))),
        Some(Registered::Error(error)) => Ok(Some(HullRefused {
            hull: place,
            field: error.field,
            index: error.index.map(|index| index as usize),
            reason: error.reason,
            message: error.message,
        })),
        None => Err(Malformed::new(format!("results[{place}] has neither a hull nor an error"))),
    }
}

fn bytes(ids: &[HullId]) -> Vec<Vec<u8>> {
    ids.iter().map(|id| id.0.to_vec()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use hullcast_proto::{HullError, HullInfo};

    /// Catches a message over the server's limits, and a hull that fits into no message and is never sent.
    #[test]
    fn messages_keep_to_the_limits() {
        let hulls = [10, 10, 1000, 10].map(|points| Hull::new(vec![[0.0; 3]; points]));
        let counts = |limits: Limits| {
            let (mut rest, mut counts) = (&[0, 1, 2, 3][..], Vec::new());
            while !rest.is_empty() {
                let message = first_message(&hulls, rest, &limits);
                let count = message.hulls.len();
                assert!(count == 1 || message.encoded_len() as u64 <= limits.max_message_bytes);
                counts.push(count);
                rest = &rest[count..];
            }
            counts
        };
        let limits = |max_message_bytes, max_hulls_per_request| Limits {
            max_message_bytes,
            max_hulls_per_request,
            ..Limits::default()
        };
        assert_eq!(counts(limits(1 << 20, 100)), [4]);
        assert_eq!(counts(limits(1 << 20, 3)), [3, 1]);
        assert_eq!(counts(limits(1 << 20, 0)), [1; 4]);
        assert_eq!(counts(limits(1000, 100)), [2, 1, 1]);
    }

    /// Catches a hull that is mistaken for another, and a refusal that loses its place.
    #[test]
    fn ids_are_the_contents_hash() {
        let id = HullId([3; 32]);
        let hull = |id: &[u8]| RegisterHullResult {
            result: Some(Registered::Hull(HullInfo { id: id.to_vec(), ..HullInfo::default() })),
        };
        assert_eq!(registered(0, id, hull(&[3; 32])), Ok(None));
        assert!(registered(5, id, hull(&[4; 32])).expect_err("another").to_string().contains("hulls[5]"));
        assert!(registered(5, id, hull(&[3; 31])).is_err());
        assert!(registered(5, id, RegisterHullResult::default()).is_err());
        let error = HullError { field: "vertices".into(), index: Some(2), ..HullError::default() };
        let refused = registered(5, id, RegisterHullResult { result: Some(Registered::Error(error)) });
        let refused = refused.expect("an answer").expect("a refusal");
        assert_eq!((refused.hull, refused.index), (5, Some(2)));
    }
}
