//! Answers one scene: fetches its hulls, computes its pairs and makes the response.

use std::{sync::Arc, time::Duration};

use tokio::time::Instant;

use super::{
    App, Reason, ServiceError,
    answer::counted_answer,
    context::{CallContext, LeasedHulls},
    wire::{self, CheckedScene},
};
use crate::{
    batch::{Batch, Columns, Hulls, Outputs, scene::Bodies},
    budget::{Part, Permit},
    compute::{DeferredDrop, Job},
    metrics::Shed,
    proto::QueryContactsResponse,
    size::ByteSize,
    store::{HullId, Lease, LeaseError},
};

/// The time after which to retry if other requests hold too many hulls. Requests hold hulls for
/// about this time.
const HULLS_RETRY: Duration = Duration::from_millis(100);

/// The answer to a scene.
pub(super) async fn answer(
    app: &App,
    context: &CallContext,
    scene: CheckedScene,
    memory: Permit,
) -> Result<QueryContactsResponse, ServiceError> {
    let started = tracing::enabled!(tracing::Level::DEBUG).then(Instant::now);
    let (request_id, outputs) = (scene.request_id, scene.template.outputs());
    let (pairs, bodies) = (scene.template.pair_count(), scene.template.body_count());
    let bytes = memory.bytes() as usize;
    let scene = app.engine().compute_threads().defer_drop((scene, memory), bytes);
    let job = &context.job;
    let admission = app.engine().admit(pairs, outputs, &job.caller)?;
    let Assembled { batch, lease, missing_hulls, invalid_bodies } = assemble(app, context, scene).await?;
    let memory = context.covered(Part::Answers);
    let (columns, memory) = app.engine().compute(batch, Some(lease), admission, job, memory).await?;
    context.note_flags(&columns.flags);
    debug_assert_eq!(columns.len(), pairs);
    if let Some(started) = started {
        log_answered(request_id, bodies, &columns, outputs, &missing_hulls, &invalid_bodies, started);
    }
    let response = wire::response(request_id, columns, missing_hulls, invalid_bodies);
    counted_answer(app, context, response, memory).await
}

/// Logs an answer to named pairs.
pub(super) fn log_answered(
    request_id: u64,
    bodies: usize,
    columns: &Columns,
    outputs: Outputs,
    missing_hulls: &[u32],
    invalid_bodies: &[u32],
    started: Instant,
) {
    let [contact, separated, undecided, invalid] = columns.outcome_counts();
    let ms = started.elapsed().as_secs_f64() * 1e3;
    let bytes = columns.wire_bytes(outputs);
    tracing::debug!(
        request_id,
        pairs = columns.len(),
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

/// A scene with its hulls.
struct Assembled {
    batch: Batch,
    lease: Arc<Lease>,
    /// The indices of missing hulls.
    missing_hulls: Vec<u32>,
    /// The indices of unusable bodies.
    invalid_bodies: Vec<u32>,
}

/// Fetches the hulls of a scene. The batch keeps the scene's memory.
async fn assemble(
    app: &App,
    context: &CallContext,
    scene: DeferredDrop<(CheckedScene, Permit)>,
) -> Result<Assembled, ServiceError> {
    let (hulls, lease) = lease_hulls(app, &scene.0.hull_ids, &context.job).await?;
    let missing_hulls = missing(&hulls);
    let (scene, memory) = scene.into_inner();
    let bodies = Bodies::new(scene.template, Arc::new(hulls), Arc::new(scene.poses))?;
    let mut batch = Batch::new(bodies, scene.warm_starts)?;
    batch.keep(memory);
    let invalid_bodies = scene.invalid_bodies;
    Ok(Assembled { batch, lease: Arc::new(lease), missing_hulls, invalid_bodies })
}

/// Leases the hulls of a message of a stream. They stay leased for the messages that follow at once.
pub(super) async fn lease_for_stream(
    app: &App,
    context: &CallContext,
    hull_ids: &Arc<Vec<HullId>>,
) -> Result<LeasedHulls, ServiceError> {
    if let Some(leased) = context.leased_hulls(hull_ids) {
        app.registry().count_leased_again(leased.hulls.len());
        return Ok(leased);
    }
    let (hulls, lease) = lease_hulls(app, hull_ids, &context.job).await?;
    let leased = LeasedHulls { hull_ids: hull_ids.clone(), hulls: Arc::new(hulls), lease: Arc::new(lease) };
    if leased.hulls.iter().all(Result::is_ok) {
        context.keep_leased(leased.clone());
    }
    Ok(leased)
}

/// The indices of missing hulls.
pub(super) fn missing(hulls: &Hulls) -> Vec<u32> {
    hulls.iter().enumerate().filter(|(_, hull)| hull.is_err()).map(|(i, _)| i as u32).collect()
}

/// Leases the hulls. They are in the order of `ids`, and stay cached until the lease is dropped.
pub(super) async fn lease_hulls(
    app: &App,
    ids: &[HullId],
    job: &Job,
) -> Result<(Hulls, Lease), ServiceError> {
    app.registry().lease(ids, job).await.map_err(|why| match why {
        LeaseError::TooLarge => {
            let (limit, all) = (app.registry().most_leased_alone(), app.limits().cache_bytes);
            let message = format!(
                "the hulls take more than {}, the most that one caller may use of the hull cache \
                 (cache_bytes is {}): use fewer or smaller hulls per request",
                ByteSize(limit),
                ByteSize(all)
            );
            ServiceError::in_field(Reason::HullsTooLarge, "hull_ids", message)
        }
        LeaseError::Busy => {
            app.metrics().shed(Shed::Hulls);
            let message = "other requests use too much of the hull cache: retry later";
            ServiceError::unavailable(Reason::TooBusy, HULLS_RETRY, message)
        }
    })
}
