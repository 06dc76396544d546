//! `ContactService`: batches of pairs in, contact manifolds out.

use std::{sync::Arc, time::Duration};

use futures_util::{
    StreamExt,
    stream::{self, BoxStream, FuturesUnordered},
};
use tokio::time::{Instant, timeout_at};
use tonic::{Request, Response, Status, Streaming};

use super::{
    App, ServiceError,
    batch::Batch,
    edge::Deadline,
    wire::{self, Scene},
};
use crate::{
    contact::ConvexHull,
    proto::{
        QueryContactsRequest, QueryContactsResponse,
        contact_service_server::{ContactService, ContactServiceServer},
    },
    store::{HullId, Missing},
};

/// Hulls of one request that are read from the store at a time.
const LOADS: usize = 16;

/// When a client of a server that stops should try another.
const STOPPING_RETRY: Duration = Duration::from_millis(100);

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
        request: Request<QueryContactsRequest>,
    ) -> Result<Response<QueryContactsResponse>, Status> {
        Ok(answer(&self.app, request.into_inner()).await?)
    }

    type FindContactsStream = BoxStream<'static, Result<QueryContactsResponse, Status>>;

    async fn find_contacts(
        &self,
        _: Request<QueryContactsRequest>,
    ) -> Result<Response<Self::FindContactsStream>, Status> {
        Err(ServiceError::unimplemented("FindContacts", "the broad phase is not implemented yet").into())
    }

    type StreamContactsStream = BoxStream<'static, Result<QueryContactsResponse, Status>>;

    /// One message at a time, in order: a batch uses all threads by itself, and what is not
    /// read yet stays with the client.
    async fn stream_contacts(
        &self,
        request: Request<Streaming<QueryContactsRequest>>,
    ) -> Result<Response<Self::StreamContactsStream>, Status> {
        let deadline = request.extensions().get::<Deadline>().copied();
        let steps = Steps { app: self.app.clone(), requests: request.into_inner() };
        let answers = stream::try_unfold(steps, move |mut steps| async move {
            let step = match deadline {
                None => steps.next().await,
                Some(Deadline(at)) => timeout_at(at, steps.next())
                    .await
                    .unwrap_or_else(|_| Err(ServiceError::deadline_exceeded().into())),
            };
            Ok(step?.map(|answer| (answer, steps)))
        });
        Ok(Response::new(answers.boxed()))
    }
}

/// A stream of requests being answered.
struct Steps {
    app: Arc<App>,
    requests: Streaming<QueryContactsRequest>,
}

impl Steps {
    /// The next answer; none at the end of the requests.
    async fn next(&mut self) -> Result<Option<QueryContactsResponse>, Status> {
        let mut stopping = self.app.stopping.subscribe();
        let request = tokio::select! {
            biased;
            request = self.requests.message() => request.map_err(wire::complete)?,
            _ = stopping.wait_for(|stopping| *stopping) => {
                return Err(ServiceError::unavailable("STOPPING", STOPPING_RETRY, "the server stops").into());
            }
        };
        match request {
            None => Ok(None),
            Some(request) => Ok(Some(answer(&self.app, request).await?.into_inner())),
        }
    }
}

async fn answer(
    app: &App,
    request: QueryContactsRequest,
) -> Result<Response<QueryContactsResponse>, ServiceError> {
    let started = Instant::now();
    let scene = wire::scene(request, app.limits())?;
    let pairs = scene.pairs.len() / 2;
    let admission = app.engine().admit(pairs, scene.outputs)?;
    let (request_id, outputs) = (scene.request_id, scene.outputs);
    let bodies = scene.body_hulls.len();
    let (batch, missing_hulls, invalid_bodies) = assemble(app, scene).await;
    let columns = app.engine().compute(batch, admission).await?;
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
    app.fitting(wire::response(request_id, columns, missing_hulls, invalid_bodies))
}

/// The scene with its hulls at hand, the indices of those that are missing, and of the
/// bodies that are unusable.
async fn assemble(app: &App, scene: Scene) -> (Batch, Vec<u32>, Vec<u32>) {
    let hulls = fetch(app, &scene.hull_ids).await;
    let missing = hulls.iter().enumerate().filter(|(_, hull)| hull.is_err()).map(|(i, _)| i as u32).collect();
    let (batch, invalid_bodies) = Batch::new(scene, hulls);
    (batch, missing, invalid_bodies)
}

/// The hulls, in the order of their ids: what is cached at once, the rest from the store.
async fn fetch(app: &App, ids: &[HullId]) -> Vec<Result<Arc<ConvexHull>, Missing>> {
    let registry = app.registry();
    let mut hulls: Vec<_> = ids.iter().map(|&id| registry.cached(id).ok_or(Missing::Unknown)).collect();
    let mut to_load = ids.iter().enumerate().filter(|(i, _)| hulls[*i].is_err()).map(|(i, &id)| (i, id));
    let load = |(i, id)| async move { (i, registry.get(id).await) };
    let to_load: Vec<_> = to_load.by_ref().collect();
    let mut to_load = to_load.into_iter();
    let mut loading: FuturesUnordered<_> = to_load.by_ref().take(LOADS).map(load).collect();
    while let Some((i, hull)) = loading.next().await {
        hulls[i] = hull;
        loading.extend(to_load.next().map(load));
    }
    hulls
}
