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
    batch::{Batch, Hulls, scene::Bodies},
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

/// The answer to a scene. The answer to a message of a stream comes with its bases, and its hulls stay
/// leased for the messages that follow at once.
pub(super) async fn answer(
    app: &App,
    context: &CallContext,
    scene: CheckedScene,
    memory: Permit,
    is_of_stream: bool,
) -> Result<(QueryContactsResponse, Vec<u32>), ServiceError> {
    let started = tracing::enabled!(tracing::Level::DEBUG).then(Instant::now);
    let (request_id, outputs) = (scene.request_id, scene.template.outputs());
    let (pairs, bodies) = (scene.template.pair_count(), scene.template.body_count());
    let bytes = memory.bytes() as usize;
    let scene = app.engine().compute_threads().defer_drop((scene, memory), bytes);
    let job = &context.job;
    let admission = app.engine().admit(pairs, outputs, &job.caller)?;
    let Assembled { mut batch, lease, missing_hulls, invalid_bodies } =
        assemble(app, context, scene, is_of_stream).await?;
    if is_of_stream {
        batch.keep_bases();
    }
    let memory = context.covered(Part::Answers);
    let (mut columns, memory) = app.engine().compute(batch, Some(lease), admission, job, memory).await?;
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
    is_of_stream: bool,
) -> Result<Assembled, ServiceError> {
    let hull_ids = &scene.0.hull_ids;
    let kept = if is_of_stream { context.leased_hulls(hull_ids) } else { None };
    let (leased, missing_hulls) = if let Some(leased) = kept {
        app.registry().count_leased_again(leased.hulls.len());
        (leased, Vec::new())
    } else {
        let (hulls, lease) = lease_hulls(app, hull_ids, &context.job).await?;
        let missing = missing(&hulls);
        let leased =
            LeasedHulls { hull_ids: hull_ids.clone(), hulls: Arc::new(hulls), lease: Arc::new(lease) };
        if is_of_stream && missing.is_empty() {
            context.keep_leased(leased.clone());
        }
        (leased, missing)
    };
    let (scene, memory) = scene.into_inner();
    let bodies = Bodies::new(scene.template, leased.hulls, Arc::new(scene.poses))?;
    let mut batch = Batch::new(bodies, scene.warm_starts)?;
    batch.keep(memory);
    let invalid_bodies = scene.invalid_bodies;
    Ok(Assembled { batch, lease: leased.lease, missing_hulls, invalid_bodies })
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
