//! `ContactService`: receives batches of pairs and returns contact manifolds.

use std::{future::Future, sync::Arc, time::Duration};

use futures_util::{
    StreamExt,
    stream::{self, BoxStream},
};
use tokio::{
    sync::watch,
    time::{Instant, timeout_at},
};
use tonic::{Request, Response, Status, Streaming};

use super::{
    App, Limits, ServiceError,
    answer::counted_answer,
    batch::Batch,
    context::{CallContext, LeasedHulls},
    decode::decoded,
    find::Finding,
    middleware::{Closing, Deadline},
    steps::Steps,
    wire::{self, Scene},
};
use crate::{
    budget::Part,
    compute::{FreedHere, Job},
    contact::Stop,
    metrics::Shed,
    proto::{
        Encoded, QueryContactsRequest, QueryContactsResponse,
        contact_service_server::{ContactService, ContactServiceServer},
    },
    size::ByteSize,
    store::{HullId, Hulls, Lease, LeaseError},
};

/// The time after which to retry if other requests hold too many hulls. Requests hold hulls for
/// about this time.
const HULLS_RETRY: Duration = Duration::from_millis(100);

pub(super) fn service(app: Arc<App>) -> ContactServiceServer<impl ContactService> {
    ContactServiceServer::new(Contacts { app })
}

struct Contacts {
    app: Arc<App>,
}

#[tonic::async_trait]
impl ContactService for Contacts {
    async fn query_contacts(
        &self,
        request: Request<Encoded<QueryContactsRequest>>,
    ) -> Result<Response<QueryContactsResponse>, Status> {
        let context = CallContext::of(&request);
        let scene = scene(&self.app, &context, request.into_inner()).await?;
        Ok(Response::new(answer(&self.app, &context, scene, false).await?.0))
    }

    type FindContactsStream = BoxStream<'static, Result<QueryContactsResponse, Status>>;

    async fn find_contacts(
        &self,
        request: Request<Encoded<QueryContactsRequest>>,
    ) -> Result<Response<Self::FindContactsStream>, Status> {
        let deadline = request.extensions().get::<Deadline>().copied();
        let context = CallContext::of(&request);
        let finding = Finding::begin(self.app.clone(), context, request.into_inner()).await?;
        let bytes = finding.bytes();
        let finding = self.app.engine().compute_threads().freed_here(finding, bytes);
        let answers = stream::try_unfold(finding, move |mut finding| async move {
            let part = within(deadline, finding.next()).await?;
            Ok(part.map(|part| (part, finding)))
        });
        Ok(Response::new(answers.boxed()))
    }

    type StreamContactsStream = BoxStream<'static, Result<QueryContactsResponse, Status>>;

    /// Answers one message at a time, in order. A batch uses all threads by itself, and messages
    /// that are not read yet stay with the client.
    async fn stream_contacts(
        &self,
        request: Request<Streaming<Encoded<QueryContactsRequest>>>,
    ) -> Result<Response<Self::StreamContactsStream>, Status> {
        let deadline = request.extensions().get::<Deadline>().copied();
        let closing = request.extensions().get::<Closing>().cloned();
        // Handlers without a connection, which fuzzing uses, never close.
        let closing = closing.unwrap_or_else(|| Closing(watch::channel(false).1));
        let context = CallContext::of(&request);
        let steps = Steps::new(self.app.clone(), context, request.into_inner(), closing);
        let answers = stream::try_unfold(steps, move |mut steps| async move {
            let step = within(deadline, steps.next()).await?;
            Ok(step.map(|answer| (answer, steps)))
        });
        Ok(Response::new(answers.boxed()))
    }
}

/// A part of a stream's answer, or an error if it does not come before the call's deadline.
async fn within<T, E: Into<Status>>(
    deadline: Option<Deadline>,
    part: impl Future<Output = Result<T, E>>,
) -> Result<T, Status> {
    match deadline {
        None => part.await.map_err(Into::into),
        Some(Deadline(at)) => match timeout_at(at, part).await {
            Ok(part) => part.map_err(Into::into),
            Err(_) => Err(ServiceError::deadline_exceeded().into()),
        },
    }
}

/// The scene of a request that inherits nothing.
async fn scene(
    app: &Arc<App>,
    context: &CallContext,
    request: Encoded<QueryContactsRequest>,
) -> Result<Scene, ServiceError> {
    let check = |request, memory, limits: &Limits, stop: &Stop| {
        let scene = wire::stoppable_scene(request, limits, stop)?;
        Ok(Scene { memory: Some(memory), ..scene })
    };
    decoded(app, context, request, check).await
}

/// The answer to a scene. The answer to a message of a stream comes with its bases, and its hulls stay
/// leased for the messages that follow at once.
pub(super) async fn answer(
    app: &App,
    context: &CallContext,
    scene: Scene,
    is_of_stream: bool,
) -> Result<(QueryContactsResponse, Vec<u32>), ServiceError> {
    let started = tracing::enabled!(tracing::Level::DEBUG).then(Instant::now);
    let (request_id, outputs) = (scene.request_id, scene.setting.outputs);
    let (pairs, bodies) = (scene.setting.pair_count(), scene.setting.body_hulls.len());
    let bytes = scene.memory.as_ref().map_or(0, |memory| memory.bytes() as usize);
    let scene = app.engine().compute_threads().freed_here(scene, bytes);
    let job = &context.job;
    let admission = app.engine().admit(pairs, outputs, &job.caller)?;
    let (mut batch, missing_hulls, invalid_bodies) = assemble(app, context, scene, is_of_stream).await?;
    if is_of_stream {
        batch.keep_bases();
    }
    let memory = context.covered(Part::Answers);
    let (mut columns, memory) = app.engine().compute(batch, admission, job, memory).await?;
    debug_assert_eq!(columns.len(), pairs);
    if let Some(started) = started {
        let [contact, separated, undecided, invalid] = columns.outcome_counts();
        let ms = started.elapsed().as_secs_f64() * 1e3;
        let bytes = columns.wire_bytes(outputs);
        tracing::debug!(
            request_id,
            pairs,
            bodies,
            contact,
            separated,
            undecided,
            invalid,
            bytes,
            ms,
            missing_hulls = missing_hulls.len(),
            invalid_bodies = invalid_bodies.len(),
            "answered"
        );
    }
    let bases = if is_of_stream { columns.kept_bases(outputs) } else { Vec::new() };
    let response = wire::response(request_id, columns, missing_hulls, invalid_bodies);
    Ok((counted_answer(app, context, response, memory).await?, bases))
}

/// The batch of a scene with its hulls, the indices of missing hulls, and the indices of unusable
/// bodies.
async fn assemble(
    app: &App,
    context: &CallContext,
    scene: FreedHere<Scene>,
    is_of_stream: bool,
) -> Result<(Batch, Vec<u32>, Vec<u32>), ServiceError> {
    let setting = &scene.setting;
    let kept = if is_of_stream { context.leased_hulls(setting) } else { None };
    let (leased, missing) = if let Some(leased) = kept {
        app.registry().found_again(leased.hulls.len());
        (leased, Vec::new())
    } else {
        let (hulls, lease) = fetch(app, &setting.hull_ids, &context.job).await?;
        let missing = missing(&hulls);
        let leased = LeasedHulls { setting: setting.clone(), hulls: Arc::new(hulls), lease: Arc::new(lease) };
        if is_of_stream && missing.is_empty() {
            context.keep_leased(leased.clone());
        }
        (leased, missing)
    };
    let (mut batch, invalid_bodies) = Batch::new(scene.into_inner(), leased.hulls);
    batch.lease(leased.lease);
    Ok((batch, missing, invalid_bodies))
}

/// The indices of missing hulls.
pub(super) fn missing(hulls: &Hulls) -> Vec<u32> {
    hulls.iter().enumerate().filter(|(_, hull)| hull.is_err()).map(|(i, _)| i as u32).collect()
}

/// Leases the hulls. They are in the order of `ids`, and stay cached until the lease is dropped.
pub(super) async fn fetch(app: &App, ids: &[HullId], job: &Job) -> Result<(Hulls, Lease), ServiceError> {
    app.registry().lease(ids, job).await.map_err(|why| match why {
        LeaseError::TooLarge => {
            let (limit, all) = (app.registry().most_leased_alone(), app.limits().cache_bytes);
            let message = format!(
                "the hulls take more than {}, the most that one caller may use of the hull cache \
                 (cache_bytes is {}): use fewer or smaller hulls per request",
                ByteSize(limit),
                ByteSize(all)
            );
            ServiceError::invalid("HULLS_TOO_LARGE", "hull_ids", message)
        }
        LeaseError::Busy => {
            app.metrics().shed(Shed::Hulls);
            let message = "other requests use too much of the hull cache: retry later";
            ServiceError::unavailable("TOO_BUSY", HULLS_RETRY, message)
        }
    })
}
