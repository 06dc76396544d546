//! `FindContacts`: candidate pairs are found some thousand at a time, and those that are not separated
//! are streamed in order. Pairs are computed only when the caller has read the pairs before them.
//!
//! [`Finder`] has the search. This module adds the memory, the admission, and the messages.

use std::sync::Arc;

use super::{
    App, Limits, Reason, ServiceError,
    admission::Admission,
    answer::{answer, counted_answer},
    context::{CallContext, grow},
    decode::decode_request,
    scene::{lease_hulls, missing},
    wire::{self, CheckedScene},
};
use crate::{
    batch::{Columns, Finder, Missing, scene::Bodies},
    budget::{Part, Permit},
    compute::{ComputeError, DeferredDrop},
    contact::Stop,
    log_limit::limited,
    proto::{Encoded, QueryContactsRequest, QueryContactsResponse},
    store::Lease,
};

/// The number of candidates that are computed together, and so the most pairs per message. At this
/// size a message costs next to nothing compared with its pairs.
const CANDIDATES: usize = 4096;

/// A `FindContacts` call in progress.
pub(super) struct FindCall {
    app: Arc<App>,
    context: CallContext,
    request_id: u64,
    /// The search, and the memory of the scene, the broad phase and the searches.
    search: DeferredDrop<(Finder, Permit)>,
    _lease: Lease,
    /// The admission that the call took before any work. `None` after its first use.
    admission: Option<Admission>,
    /// The missing hulls and the unusable bodies, to be sent with the first message.
    left_out: Option<(Vec<u32>, Vec<u32>)>,
}

impl FindCall {
    /// Checks the request, takes an admission, and builds the tree of the bodies.
    pub(super) async fn begin(
        app: Arc<App>,
        context: CallContext,
        request: Encoded<QueryContactsRequest>,
    ) -> Result<Self, ServiceError> {
        let check = |request, memory, limits: &Limits, stop: &Stop| {
            let (scene, rules) = wire::find(request, limits, stop)?;
            Ok((scene, rules, memory))
        };
        let decoded = decode_request(&app, &context, request, check).await?;
        let (hull_ids, bytes) = (decoded.0.hull_ids.clone(), decoded.2.bytes() as usize);
        // The caller may leave while the hulls are read; the scene may be large and must not be
        // freed on this thread.
        let compute = app.engine().compute_threads();
        let waiting = compute.defer_drop(decoded, bytes);
        let admission = app.engine().admit_any_size(most_candidates(&app), &context.job.caller)?;
        let (hulls, lease) = lease_hulls(&app, &hull_ids, &context.job).await?;
        let (scene, rules, mut memory) = waiting.into_inner();
        let CheckedScene { request_id, template, poses, invalid_bodies, .. } = scene;
        // An unavailable hull fails the call: its bodies' pairs are unknown, so no pair could carry
        // the flag.
        if hulls.iter().any(|hull| matches!(hull, Err(Missing::Unavailable))) {
            return Err(super::hulls::unreadable());
        }
        let bodies = Bodies::new(template, Arc::new(hulls), Arc::new(poses))?;
        let sorting = rules.sorting_bytes();
        grow(&app, &mut memory, Finder::bytes(&bodies) + sorting)?;
        let left_out = Some((missing(bodies.hulls()), invalid_bodies));
        let finder = Finder::new(bodies, rules, most_candidates(&app), compute, &context.job).await;
        let finder = finder.map_err(failed)?;
        memory.shrink_to(memory.bytes() - sorting as u64);
        let bytes = memory.bytes() as usize;
        let search = compute.defer_drop((finder, memory), bytes);
        Ok(Self { app, context, request_id, search, _lease: lease, admission: Some(admission), left_out })
    }

    /// The next message, or `None` at the end. There is always a first message.
    pub(super) async fn next(&mut self) -> Result<Option<QueryContactsResponse>, ServiceError> {
        while let Some(candidates) = self.candidates().await? {
            match self.answer(&candidates).await {
                Ok(None) => {}
                Ok(answer) => return Ok(answer),
                // Split the answer, as a client would split the request.
                Err(error)
                    if error.reason == Reason::ResponseTooLarge && self.search.0.split(&candidates) => {}
                Err(error) => return Err(error),
            }
        }
        let Some((hulls, bodies)) = self.left_out.take() else { return Ok(None) };
        let response = wire::response(self.request_id, Columns::default(), hulls, bodies);
        Ok(Some(answer(&self.app, &self.context, response).await?))
    }

    /// The answer for the candidates that are not separated, or `None` if all of them are.
    async fn answer(&mut self, candidates: &[u32]) -> Result<Option<QueryContactsResponse>, ServiceError> {
        let (engine, job) = (self.app.engine(), &self.context.job);
        let admission = match self.admission.take() {
            Some(admission) => admission,
            None => engine.admit_when_free(candidates.len() / 2, &job.caller).await,
        };
        let batch = self.search.0.batch(candidates.to_vec());
        let memory = self.context.take(&self.app, Part::Answers, 0)?;
        let (columns, memory) = engine.compute(batch, None, admission, job, memory).await?;
        self.context.note_flags(&columns.flags);
        if columns.is_empty() {
            return Ok(None);
        }
        let (hulls, bodies) = self.left_out.clone().unwrap_or_default();
        let answer = wire::response(self.request_id, columns, hulls, bodies);
        let answer = counted_answer(&self.app, &self.context, answer, memory).await?;
        self.left_out = None;
        Ok(Some(answer))
    }

    /// The next candidates to be computed together, or `None` when all have been.
    async fn candidates(&mut self) -> Result<Option<Vec<u32>>, ServiceError> {
        let compute = self.app.engine().compute_threads();
        self.search.0.next(compute, &self.context.job).await.map_err(failed)
    }
}

/// The number of pairs that are computed together.
pub(super) fn most_candidates(app: &App) -> usize {
    CANDIDATES.min(app.limits().max_pairs_per_request as usize)
}

/// The error of a search that did not end.
pub(super) fn failed(error: ComputeError) -> ServiceError {
    match error {
        ComputeError::Stopped => ServiceError::deadline_exceeded(),
        ComputeError::Panicked(why) => {
            limited!(error, %why, "a broad phase failed");
            ServiceError::internal("the broad phase failed; the server's log has the reason")
        }
    }
}
