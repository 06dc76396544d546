//! Answers one scene: fetches its hulls, computes its pairs and makes the response.

use std::time::Duration;

use tokio::time::Instant;

use super::{
    App, ServiceError,
    answer::counted_answer,
    batch::Batch,
    context::CallContext,
    wire::{self, Scene},
};
use crate::{
    budget::Part,
    compute::{FreedHere, Job},
    metrics::Shed,
    proto::QueryContactsResponse,
    store::{HullId, Hulls, Lease, LeaseError},
};

/// When to retry if other requests hold too many hulls: about the time for which they hold them.
const HULLS_RETRY: Duration = Duration::from_millis(100);

/// The answer to a scene, and its bases if `keep_bases` is set.
pub(super) async fn answer(
    app: &App,
    context: &CallContext,
    scene: Scene,
    keep_bases: bool,
) -> Result<(QueryContactsResponse, Vec<u32>), ServiceError> {
    let started = Instant::now();
    let (request_id, outputs) = (scene.request_id, scene.setting.outputs);
    let (pairs, bodies) = (scene.setting.pair_count(), scene.setting.body_hulls.len());
    let bytes = scene.memory.as_ref().map_or(0, |memory| memory.bytes() as usize);
    let scene = app.engine().compute_threads().freed_here(scene, bytes);
    let job = &context.job;
    let admission = app.engine().admit(pairs, outputs, &job.caller)?;
    let (mut batch, missing_hulls, invalid_bodies) = assemble(app, scene, job).await?;
    if keep_bases {
        batch.keep_bases();
    }
    let memory = context.covered(Part::Answers);
    let (mut columns, memory) = app.engine().compute(batch, admission, job, memory).await?;
    debug_assert_eq!(columns.len(), pairs);
    if tracing::enabled!(tracing::Level::DEBUG) {
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
    let bases = if keep_bases { columns.kept_bases(outputs) } else { Vec::new() };
    let response = wire::response(request_id, columns, missing_hulls, invalid_bodies);
    Ok((counted_answer(app, context, response, memory).await?, bases))
}

/// The batch of a scene with its hulls, the indices of missing hulls, and the indices of unusable
/// bodies.
async fn assemble(
    app: &App,
    scene: FreedHere<Scene>,
    job: &Job,
) -> Result<(Batch, Vec<u32>, Vec<u32>), ServiceError> {
    let (hulls, lease) = fetch(app, &scene.setting.hull_ids, job).await?;
    let missing = missing(&hulls);
    let (mut batch, invalid_bodies) = Batch::new(scene.into_inner(), hulls);
    batch.lease(lease);
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
                "the hulls take more than {limit} bytes, the most that one caller may use of the hull cache \
                 (cache_bytes is {all}): use fewer or smaller hulls per request"
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
