//! Answers a stream of requests in order, one at a time. Each request may inherit from the one
//! before.

use std::{sync::Arc, time::Duration};

use tonic::{Status, Streaming};

use super::{
    App, Limits, Reason, ServiceError,
    context::{CallContext, grow},
    decode::decode_request,
    find::most_candidates,
    middleware::Closing,
    step::{AnswerBefore, Previous, StepAnswer, StepState, find::FindStep, named::answer_named},
    wire::{self, Before},
};
use crate::{
    budget::{CallerStream, Permit},
    compute::DeferredDrop,
    contact::{STEPS_BETWEEN_LOOKS, Stop},
    proto::{Encoded, QueryContactsRequest, QueryContactsResponse},
};

/// The time after which to retry if the server stops, or if streams keep too much state.
const RETRY: Duration = Duration::from_millis(100);

/// A stream of requests in progress.
pub(super) struct ContactStream {
    app: Arc<App>,
    context: CallContext,
    requests: Streaming<Encoded<QueryContactsRequest>>,
    closing: Closing,
    previous: Previous,
    /// The answer that is being sent, if it comes in several messages.
    finding: Option<DeferredDrop<FindStep>>,
    /// Whether the client has sent a message that only clients send that know steps. Others get the answers that
    /// they always got: no row is used again, and no answer is sent as `unchanged`.
    knows_steps: bool,
    /// The steps of the call when the stream last gave way to other calls.
    gave_way: u64,
    stream: CallerStream,
}

/// The streams of one caller give way to the other calls of their threads after these steps of work, about
/// 2 ms, which they share. Streams of small messages that are all there already would otherwise never do so.
const STEPS_BEFORE_YIELD: u64 = 2 * STEPS_BETWEEN_LOOKS;

/// The steps of a message besides those that its decoding and its pairs count: about 2 us.
const MESSAGE_STEPS: u64 = 2_000;

/// The parts of the state of the message before that a message uses, and the memory of that state.
type Taken = (Option<Before>, Option<AnswerBefore>, Option<Permit>);

/// Takes the state that a message refers to.
///
/// # Errors
/// The message refers to a message before, and there is none, or its state was not kept.
fn taken(request: &QueryContactsRequest, previous: Previous) -> Result<Taken, ServiceError> {
    let field = if request.inherit { "inherit" } else { "previous_bodies" };
    let refers = request.inherit || !request.previous_bodies.is_empty();
    match previous {
        Previous::Kept { state, memory } if refers => {
            let StepState { scene, answer } = state.into_inner();
            Ok((Some(scene), Some(answer), Some(memory)))
        }
        Previous::Kept { memory, .. } => Ok((None, None, Some(memory))),
        Previous::None if refers => {
            let why = "the first message of a stream has no message before it: send the scene in full, without \
                       this field";
            Err(ServiceError::in_field(Reason::NothingToInherit, field, why))
        }
        Previous::Dropped if refers => {
            let why = "there was no memory to keep the stream's state: \
                       open a new stream and send the scene in full";
            Err(ServiceError::unavailable(Reason::StateNotKept, RETRY, why))
        }
        Previous::None | Previous::Dropped => Ok((None, None, None)),
    }
}

impl ContactStream {
    /// A stream that ends with its requests, or after the message in progress once `closing` is
    /// true.
    pub(super) fn new(
        app: Arc<App>,
        context: CallContext,
        requests: Streaming<Encoded<QueryContactsRequest>>,
        closing: Closing,
    ) -> Self {
        let stream = context.job.caller.stream();
        let (previous, finding, knows_steps) = (Previous::None, None, false);
        Self { app, context, requests, closing, previous, finding, knows_steps, gave_way: 0, stream }
    }

    /// The next answer, or `None` after the last request.
    pub(super) async fn next(&mut self) -> Result<Option<QueryContactsResponse>, Status> {
        if self.finding.is_some() {
            return Ok(Some(Box::pin(self.next_part()).await?));
        }
        let steps = self.context.job.stop.steps();
        if steps - self.gave_way >= STEPS_BEFORE_YIELD / self.stream.count().max(1) as u64 {
            self.gave_way = steps;
            tokio::task::yield_now().await;
        }
        let request = tokio::select! {
            biased;
            () = self.closing.announced() => {
                let why = "the connection is about to close: open the stream again";
                return Err(ServiceError::unavailable(Reason::Stopping, RETRY, why).into());
            }
            request = self.requests.message() => request.map_err(wire::complete)?,
        };
        match request {
            None => Ok(None),
            // A stream that waits for its next message does not hold the large state of an answer.
            Some(request) => Ok(Some(Box::pin(self.answer_message(request)).await?)),
        }
    }

    /// The next message of an answer to a search for pairs.
    async fn next_part(&mut self) -> Result<QueryContactsResponse, ServiceError> {
        let Some(mut finding) = self.finding.take() else {
            return Err(ServiceError::internal("a stream has no answer to continue"));
        };
        let (response, is_last) = finding.next().await?;
        if is_last {
            self.previous = finding.into_inner().finish().await?;
        } else {
            self.finding = Some(finding);
        }
        Ok(response)
    }

    /// The answer to a message, or the first part of it.
    async fn answer_message(
        &mut self,
        request: Encoded<QueryContactsRequest>,
    ) -> Result<QueryContactsResponse, ServiceError> {
        self.context.job.stop.spend(MESSAGE_STEPS)?;
        let previous = std::mem::replace(&mut self.previous, Previous::None);
        let app = self.app.clone();
        let check = move |request: QueryContactsRequest, mut memory: Permit, limits: &Limits, stop: &Stop| {
            let (scene, answer, state_memory) = taken(&request, previous)?;
            let step = wire::step(request, scene, limits, stop, |bytes| grow(&app, &mut memory, bytes))?;
            Ok((step, memory, answer, state_memory))
        };
        let decoded = decode_request(&self.app, &self.context, request, check).await?;
        self.knows_steps |= decoded.0.uses_steps;
        let bytes = decoded.1.bytes() as usize;
        // The caller may leave while the hulls are read; the scene may be large and must not be freed on this
        // thread.
        let engine = self.app.engine();
        let waiting = engine.compute_threads().defer_drop(decoded, bytes);
        let (step, caller) = (&waiting.0, &self.context.job.caller);
        let template = step.scene.template.clone();
        let is_search = step.rules.is_some();
        let admission = if is_search {
            engine.admit_any_size(most_candidates(&self.app), caller)?
        } else {
            engine.admit(template.pair_count(), template.outputs(), caller)?
        };
        let (mut step, mut memory, answer, state_memory) = waiting.into_inner();
        let warm_starts = std::mem::take(&mut step.scene.warm_starts);
        let (app, context, knows_steps) = (&self.app, &self.context, self.knows_steps);
        let begun = StepAnswer::begin(app, context, step, answer, state_memory, knows_steps, &mut memory);
        // If the caller leaves during the answer, its parts and the answer before may be large too.
        let mut answer = engine.compute_threads().defer_drop(begun.await?, usize::MAX);
        if is_search {
            let finding = FindStep::begin(answer.into_inner(), admission, memory).await?;
            self.finding = Some(self.app.engine().compute_threads().defer_drop(finding, usize::MAX));
            return self.next_part().await;
        }
        let response = answer_named(&mut answer, admission, warm_starts, memory).await?;
        self.previous = answer.into_inner().finish(None).await?;
        Ok(response)
    }
}
