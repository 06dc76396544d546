//! The answers of `GetHulls` and `HasHulls`. Each distinct hull is looked up once, however often
//! the request names it, and the size of the answer is known before the answer is built.

use std::{
    collections::HashMap,
    sync::{Mutex, PoisonError},
};

use futures_util::{StreamExt, TryStreamExt, stream};

use super::{
    App, ServiceError,
    answer::{ANSWER_COPIES, too_large},
    context::{CallContext, grow},
    hulls::unreadable,
    offload::offloaded,
    wire,
};
use crate::{
    batch::Missing,
    budget::{Part, Permit},
    lock::locked,
    proto::HullRecord,
    store::{AT_A_TIME, HullId, Reader},
};

/// Bytes of memory of a record besides its columns: the message, and the summary of the hull.
const RECORD_BYTES: usize = 512;

/// Bytes of memory per point of a definition while it is read: the blob and the points.
const READ_BYTES_PER_POINT: usize = 48;

/// The ids of a request without repetitions.
struct DistinctIds {
    /// Each id once, in the order of its first occurrence, with the number of its occurrences.
    ids: Vec<(HullId, usize)>,
    /// For each id of the request, its index in `ids`.
    indices: Vec<usize>,
}

impl DistinctIds {
    fn of(given: &[HullId]) -> Self {
        let mut index_of = HashMap::with_capacity(given.len());
        let (mut ids, mut indices) = (Vec::new(), Vec::with_capacity(given.len()));
        for &id in given {
            let index = *index_of.entry(id).or_insert(ids.len());
            if index == ids.len() {
                ids.push((id, 0));
            }
            ids[index].1 += 1;
            indices.push(index);
        }
        Self { ids, indices }
    }
}

/// Whether the server can answer for each hull.
///
/// # Errors
/// STORE_UNAVAILABLE.
pub(super) async fn present(
    app: &App,
    context: &CallContext,
    ids: &[HullId],
) -> Result<Vec<bool>, ServiceError> {
    let reader = &app.registry().reader(&context.job);
    let distinct = DistinctIds::of(ids);
    let looked_up = stream::iter(distinct.ids).map(|(id, _)| is_present(reader, id)).buffered(AT_A_TIME);
    let present: Vec<bool> = looked_up.try_collect().await?;
    Ok(distinct.indices.into_iter().map(|index| present[index]).collect())
}

async fn is_present(reader: &Reader<'_>, id: HullId) -> Result<bool, ServiceError> {
    reader.has(id).await.map_err(|_| unreadable())
}

/// A record for each id, and the memory that all of them take.
///
/// # Errors
/// RESPONSE_TOO_LARGE before the records are built, TOO_BUSY, STORE_UNAVAILABLE.
pub(super) async fn records(
    app: &App,
    context: &CallContext,
    ids: &[HullId],
    parts: wire::RecordParts,
) -> Result<(Vec<HullRecord>, Permit), ServiceError> {
    let DistinctIds { ids, indices } = DistinctIds::of(ids);
    let size = Mutex::new(AnswerSize { bytes: 0, memory: context.take(app, Part::Answers, 0)? });
    let reading = RecordReader { app, context, reader: app.registry().reader(&context.job), parts, size };
    let read = |(id, times)| reading.record(id, times);
    let records: Vec<_> = stream::iter(ids).map(read).buffered(AT_A_TIME).try_collect().await?;
    let AnswerSize { bytes, memory } = reading.size.into_inner().unwrap_or_else(PoisonError::into_inner);
    let repeat = move |stop: &_| wire::repeated(records, &indices, stop);
    Ok((offloaded(app, context, bytes, repeat).await?, memory))
}

/// The state while the records of one answer are read.
struct RecordReader<'a> {
    app: &'a App,
    context: &'a CallContext,
    reader: Reader<'a>,
    parts: wire::RecordParts,
    size: Mutex<AnswerSize>,
}

/// The encoded size of the records that have been started.
struct AnswerSize {
    /// The encoded answer has at least this many bytes.
    bytes: usize,
    memory: Permit,
}

impl RecordReader<'_> {
    /// The record of a hull that occurs `times` times in the answer.
    async fn record(&self, id: HullId, times: usize) -> Result<HullRecord, ServiceError> {
        match self.found(id, times).await? {
            Ok(record) => Ok(record),
            Err(Missing::Unknown) => {
                self.take(times, 0)?;
                Ok(wire::not_found(id))
            }
            Err(Missing::Unavailable) => Err(unreadable()),
        }
    }

    async fn found(&self, id: HullId, times: usize) -> Result<Result<HullRecord, Missing>, ServiceError> {
        let parts = self.parts;
        let hull = match self.reader.get(id).await {
            Ok(hull) => hull,
            Err(missing) => return Ok(Err(missing)),
        };
        let bytes = wire::record_bytes(&hull, parts);
        self.take(times, bytes)?;
        let mut working = hull.heap_bytes();
        if parts.vertices {
            working += READ_BYTES_PER_POINT * hull.registered_count();
        }
        let working = self.context.take(self.app, Part::Answers, working)?;
        let definition = match parts.vertices {
            true => match self.reader.definition(id).await {
                Ok(definition) => Some(definition),
                Err(missing) => return Ok(Err(missing)),
            },
            false => None,
        };
        let build = move |_: &_| {
            let record = wire::record(id, &hull, definition.as_ref(), parts);
            drop((definition, hull, working));
            Ok(record)
        };
        let record = offloaded(self.app, self.context, bytes, build).await?;
        // Gives way to other calls, since many small cached records would otherwise occupy the
        // thread.
        tokio::task::coop::consume_budget().await;
        Ok(Ok(record))
    }

    /// Takes the memory of `times` records with columns of `bytes` bytes. Refuses an answer that
    /// would be too large to send.
    fn take(&self, times: usize, bytes: usize) -> Result<(), ServiceError> {
        let mut size = locked(&self.size);
        size.bytes = size.bytes.saturating_add(times.saturating_mul(bytes));
        if size.bytes > self.app.limits().max_message_bytes {
            return Err(too_large(self.app, size.bytes));
        }
        let memory = times.saturating_mul(ANSWER_COPIES * (bytes + RECORD_BYTES));
        grow(self.app, &mut size.memory, memory)
    }
}

#[cfg(test)]
mod tests {
    use prost::Message;

    use super::*;
    use crate::{
        budget::{Caller, MemoryBudget},
        compute::Job,
        proto::GetHullsResponse,
        service::{Limits, Reason},
        store::{HullDefinition, blobs},
    };

    /// Catches an id that is looked up twice, lost, or answered in another's place.
    #[test]
    fn repeated_ids_are_looked_up_once() {
        let ids = [3, 1, 3, 3, 2, 1].map(|byte| HullId([byte; 32]));
        let distinct = DistinctIds::of(&ids);
        assert_eq!(distinct.ids, [(ids[0], 3), (ids[1], 2), (ids[4], 1)]);
        let again: Vec<_> = distinct.indices.iter().map(|&index| distinct.ids[index].0).collect();
        assert_eq!(again, ids);
    }

    const ALL: wire::RecordParts = wire::RecordParts { info: true, vertices: true, faces: true };

    /// A server with one hull of points on a sphere, and the hull's id.
    async fn with_a_hull(limits: Limits) -> (App, HullId) {
        let app = App::new(blobs::open("memory://").unwrap(), limits, 1).unwrap();
        // A Fibonacci spiral.
        let point = |i: usize| {
            let (z, turn) = ((2 * i) as f64 / 399.0 - 1.0, 2.4 * i as f64);
            let radius = (1.0 - z * z).max(0.0).sqrt();
            [radius * turn.cos(), radius * turn.sin(), z]
        };
        let definition = HullDefinition { points: (0..400).map(point).collect(), ..Default::default() };
        let registered =
            app.registry().register(vec![definition], &Job::new(Caller::alone())).await.remove(0);
        (app, registered.unwrap().0)
    }

    fn runtime() -> tokio::runtime::Runtime {
        tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap()
    }

    /// Catches memory that grows with the repetitions of an id before the answer is known to be too
    /// large.
    #[test]
    fn an_answer_too_large_is_refused_before_it_is_built() {
        let runtime = runtime();
        let limits = Limits { max_message_bytes: 1 << 20, ..Limits::default() };
        let (app, id) = runtime.block_on(with_a_hull(limits));
        let context = CallContext::new(Caller::alone(), app.memory().clone());
        let ids = vec![id; 16_384];
        let mut refused = None;
        let made = allocation_counter::measure(|| {
            refused = runtime.block_on(records(&app, &context, &ids, ALL)).err();
        });
        assert_eq!(refused.map(|error| error.reason), Some(Reason::ResponseTooLarge));
        // One record has about 50 kB. Only the tables of ids may be allocated; their memory belongs
        // to the decoded request.
        assert!(made.bytes_max < (ids.len() * wire::HULL_BYTES / 2) as u64, "{made:?}");
        assert_eq!(app.memory().used(), 0);
    }

    /// Catches records that take more memory than was charged, a repeated hull that is read again,
    /// and an answer that differs from those of single requests.
    #[test]
    fn repeated_hulls_share_what_is_read() {
        let runtime = runtime();
        let (app, id) = runtime.block_on(with_a_hull(Limits::default()));
        let context = CallContext::new(Caller::alone(), app.memory().clone());
        let ask = |ids: &[HullId]| runtime.block_on(records(&app, &context, ids, ALL)).unwrap();
        let single = ask(&[id]).0.remove(0);
        let unknown = HullId([1; 32]);
        let one = allocation_counter::measure(|| drop(ask(&[id])));
        let mut several = None;
        let ids = [id, unknown, id, id, id];
        let made = allocation_counter::measure(|| several = Some(ask(&ids)));
        let (several, memory) = several.unwrap();
        for (record, asked) in several.iter().zip(ids) {
            let expected = if asked == id { single.clone() } else { wire::not_found(unknown) };
            assert_eq!(*record, expected);
        }
        let encoded = GetHullsResponse { hulls: several }.encoded_len();
        assert!(memory.bytes() >= 2 * encoded as u64, "{memory:?}, {encoded}");
        let reading = one.bytes_max;
        assert!(made.bytes_max <= memory.bytes() + reading, "{made:?}, {memory:?}, {reading}");
        assert!(made.count_total < one.count_total + 200, "{made:?}, {one:?}");
    }

    /// Catches an answer that is built although its caller may not hold that much memory.
    #[test]
    fn records_are_not_built_without_room() {
        let runtime = runtime();
        let (app, id) = runtime.block_on(with_a_hull(Limits::default()));
        let budget = MemoryBudget::new(1 << 20, false, &[]);
        let context = CallContext::new(Caller::alone(), budget.clone());
        let ids = vec![id; 100];
        let refused = runtime.block_on(records(&app, &context, &ids, ALL)).unwrap_err();
        assert_eq!(refused.reason, Reason::MemoryTooLarge);
        assert_eq!(budget.used(), 0);
    }
}
