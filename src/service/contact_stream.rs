//! Answers a stream of requests in order, one at a time. Each request may inherit from the one
//! before.

use std::{sync::Arc, time::Duration};

use tonic::{Status, Streaming};

use super::{
    App, Limits, Reason, ServiceError, context::CallContext, decode::decode_request, middleware::Closing,
    scene::answer, wire,
};
use crate::{
    batch::{Motions, scene::SceneTemplate},
    budget::{CallerStream, Permit},
    compute::DeferredDrop,
    contact::{STEPS_BETWEEN_LOOKS, Stop},
    proto::{Encoded, QueryContactsRequest, QueryContactsResponse},
    store::HullId,
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
    /// The steps of the call when the stream last gave way to other calls.
    gave_way: u64,
    stream: CallerStream,
}

/// The streams of one caller give way to the other calls of their threads after these steps of work, about
/// 2 ms, which they share. Streams of small messages that are all there already would otherwise never do so.
const STEPS_BEFORE_YIELD: u64 = 2 * STEPS_BETWEEN_LOOKS;

/// The steps of a message besides those that its decoding and its pairs count: about 2 us.
const MESSAGE_STEPS: u64 = 2_000;

/// The previous message of the stream.
enum Previous {
    /// The message is the first of the stream.
    None,
    /// The state of the previous message was not kept, because the budget had no room.
    Dropped,
    /// The state that the next message may inherit.
    Kept { state: DeferredDrop<InheritableState>, memory: Permit },
}

/// The hulls, bodies, pairs, motions and options of a message, and the bases of its answer.
struct InheritableState {
    hull_ids: Arc<Vec<HullId>>,
    template: Arc<SceneTemplate>,
    motions: Motions,
    bases: Vec<u32>,
}

impl InheritableState {
    /// The bytes of the state.
    fn bytes(&self) -> usize {
        size_of_val(&self.hull_ids[..])
            + self.template.heap_bytes()
            + self.motions.heap_bytes()
            + self.template.pair_count() * size_of::<[u32; 6]>()
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
        Self { app, context, requests, closing, previous: Previous::None, gave_way: 0, stream }
    }

    /// The next answer, or `None` after the last request.
    pub(super) async fn next(&mut self) -> Result<Option<QueryContactsResponse>, Status> {
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
            Some(request) => Ok(Some(self.answer_message(request).await?)),
        }
    }

    async fn answer_message(
        &mut self,
        request: Encoded<QueryContactsRequest>,
    ) -> Result<QueryContactsResponse, ServiceError> {
        self.context.job.stop.spend(MESSAGE_STEPS)?;
        let previous = std::mem::replace(&mut self.previous, Previous::None);
        let check = |request: QueryContactsRequest, memory, limits: &Limits, stop: &Stop| {
            let (scene, state_memory) = match (request.inherit, previous) {
                (false, previous) => {
                    let memory = match previous {
                        Previous::Kept { memory, .. } => Some(memory),
                        Previous::None | Previous::Dropped => None,
                    };
                    (wire::stoppable_scene(request, limits, stop)?, memory)
                }
                (true, Previous::Kept { state, memory }) => {
                    let InheritableState { hull_ids, template, motions, bases } = state.into_inner();
                    let scene = wire::inherited(request, hull_ids, template, &motions, bases, stop)?;
                    (scene, Some(memory))
                }
                (true, Previous::None) => {
                    let why = "the first message of a stream has nothing to inherit: send the scene in full";
                    return Err(ServiceError::in_field(Reason::NothingToInherit, "inherit", why));
                }
                (true, Previous::Dropped) => {
                    let why = "there was no memory to keep the stream's state: \
                               open a new stream and send the scene in full";
                    return Err(ServiceError::unavailable(Reason::StateNotKept, RETRY, why));
                }
            };
            Ok((scene, memory, state_memory))
        };
        let (scene, memory, state_memory) = decode_request(&self.app, &self.context, request, check).await?;
        let (hull_ids, template) = (scene.hull_ids.clone(), scene.template.clone());
        let motions = scene.poses.motions().clone();
        let (response, bases) = answer(&self.app, &self.context, scene, memory, true).await?;
        let new_state = InheritableState { hull_ids, template, motions, bases };
        let bytes = new_state.bytes();
        let state = self.app.engine().compute_threads().defer_drop(new_state, bytes);
        self.previous = match self.context.take_state_memory(bytes, state_memory) {
            Some(memory) => Previous::Kept { state, memory },
            None => Previous::Dropped,
        };
        Ok(response)
    }
}
