//! `HullService`: hulls registered, described, listed and deleted.

use std::{iter::Peekable, sync::Arc, time::Duration};

use futures_util::{StreamExt, TryStreamExt, stream};
use tonic::{Request, Response, Status};

use super::{App, ServiceError, context::CallContext, wire};
use crate::{
    compute::Job,
    log_limit::Repeated,
    metrics::Shed,
    proto::{
        DeleteHullsRequest, DeleteHullsResponse, GetHullsRequest, GetHullsResponse, HasHullsRequest,
        HasHullsResponse, HullRecord, ListHullsRequest, ListHullsResponse, RegisterHullResult,
        RegisterHullsRequest, RegisterHullsResponse,
        hull_service_server::{HullService, HullServiceServer},
    },
    store::{AT_A_TIME, HullId, Missing, Reader, RegisterError, Registered, StoreError},
};

/// Points of the hulls that are registered at a time: enough that all threads are busy,
/// and what is built but not stored yet stays small, some 25 MB.
const GROUP_POINTS: usize = 1 << 16;

/// Of `ListHulls`, where the request names none.
const DEFAULT_PAGE_SIZE: u32 = 1000;

/// When a client of a store that cannot be read should ask again.
const STORE_RETRY: Duration = Duration::from_millis(500);

pub(super) fn service(app: Arc<App>) -> HullServiceServer<impl HullService> {
    HullServiceServer::new(Hulls { app })
}

struct Hulls {
    app: Arc<App>,
}

#[tonic::async_trait]
impl HullService for Hulls {
    async fn register_hulls(
        &self,
        request: Request<RegisterHullsRequest>,
    ) -> Result<Response<RegisterHullsResponse>, Status> {
        let job = CallContext::of(&request).job;
        let definitions = wire::definitions(request.into_inner(), self.app.limits())?;
        let mut results = Vec::with_capacity(definitions.len());
        let mut left = definitions.into_iter().peekable();
        while left.peek().is_some() {
            results.extend(self.register(group(&mut left), &job).await?);
        }
        Ok(self.app.fitting(RegisterHullsResponse { results })?)
    }

    async fn get_hulls(
        &self,
        request: Request<GetHullsRequest>,
    ) -> Result<Response<GetHullsResponse>, Status> {
        let job = CallContext::of(&request).job;
        let request = request.into_inner();
        let ids = wire::ids(&request.ids, self.app.limits())?;
        let parts = wire::parts(request.field_mask)?;
        let reader = &self.app.registry().reader(&job);
        let hulls: Vec<_> =
            stream::iter(ids).map(|id| record(reader, id, parts)).buffered(AT_A_TIME).try_collect().await?;
        Ok(self.app.fitting(GetHullsResponse { hulls })?)
    }

    async fn has_hulls(
        &self,
        request: Request<HasHullsRequest>,
    ) -> Result<Response<HasHullsResponse>, Status> {
        let job = CallContext::of(&request).job;
        let ids = wire::ids(&request.into_inner().ids, self.app.limits())?;
        let reader = &self.app.registry().reader(&job);
        let has = |id| async move { reader.has(id).await.map_err(|_| unreadable()) };
        let present: Vec<_> = stream::iter(ids).map(has).buffered(AT_A_TIME).try_collect().await?;
        Ok(self.app.fitting(HasHullsResponse { present })?)
    }

    async fn list_hulls(
        &self,
        request: Request<ListHullsRequest>,
    ) -> Result<Response<ListHullsResponse>, Status> {
        let job = CallContext::of(&request).job;
        let request = request.into_inner();
        let after = wire::page_token(&request.page_token)?;
        let size = if request.page_size == 0 { DEFAULT_PAGE_SIZE } else { request.page_size };
        let size = size.min(self.app.limits().max_page_size);
        let listed = self.app.registry().list(after, size as usize, &job).await;
        let (blobs, more) = listed.map_err(|error| store_error(&self.app, error))?;
        Ok(self.app.fitting(wire::page(blobs, more))?)
    }

    async fn delete_hulls(
        &self,
        request: Request<DeleteHullsRequest>,
    ) -> Result<Response<DeleteHullsResponse>, Status> {
        let job = CallContext::of(&request).job;
        let ids = wire::ids(&request.into_inner().ids, self.app.limits())?;
        let mut deleted = Vec::with_capacity(ids.len());
        // One after the other: an id that is named twice is deleted once.
        for id in ids {
            let done = self.app.registry().delete(id, &job).await;
            deleted.push(done.map_err(|error| store_error(&self.app, error))?);
        }
        tracing::info!(hulls = deleted.iter().filter(|deleted| **deleted).count(), "deleted");
        Ok(self.app.fitting(DeleteHullsResponse { deleted })?)
    }
}

impl Hulls {
    async fn register(
        &self,
        group: Vec<wire::Definition>,
        job: &Job,
    ) -> Result<Vec<RegisterHullResult>, ServiceError> {
        let (mut given, mut malformed) = (Vec::with_capacity(group.len()), Vec::with_capacity(group.len()));
        for definition in group {
            malformed.push(definition.map(|definition| given.push(definition)).err());
        }
        let mut registered = self.app.registry().register(given, job).await.into_iter();
        let result = |malformed| match malformed {
            Some(error) => Some(Ok(wire::register_result(Err(error)))),
            None => registered.next().map(|registered| registered_result(&self.app, registered)),
        };
        malformed.into_iter().filter_map(result).collect()
    }
}

async fn record(reader: &Reader<'_>, id: HullId, parts: wire::Parts) -> Result<HullRecord, ServiceError> {
    let found = async {
        let hull = reader.get(id).await?;
        let definition = match parts.vertices {
            true => Some(reader.definition(id).await?),
            false => None,
        };
        Ok(wire::record(id, &hull, definition.as_ref(), parts))
    };
    match found.await {
        Ok(record) => Ok(record),
        Err(Missing::Unknown) => Ok(wire::not_found(id)),
        Err(Missing::Unavailable) => Err(unreadable()),
    }
}

pub(super) fn unreadable() -> ServiceError {
    ServiceError::unavailable("STORE_UNAVAILABLE", STORE_RETRY, "the store could not be read")
}

fn store_error(app: &App, error: StoreError) -> ServiceError {
    static FAILED: Repeated = Repeated::new();
    if let Some(left_out) = FAILED.due() {
        tracing::warn!(%error, left_out, "the store failed");
    }
    match error {
        StoreError::Full(_) => ServiceError::store_full(error.to_string()),
        StoreError::Busy(_) => {
            app.metrics().shed(Shed::Store);
            ServiceError::unavailable("TOO_BUSY", STORE_RETRY, format!("{error}; ask again"))
        }
        StoreError::Unavailable(_) | StoreError::Hung(_) | StoreError::NotABlob(_) => {
            ServiceError::unavailable("STORE_UNAVAILABLE", STORE_RETRY, error.to_string())
        }
    }
}

/// The next hulls that are registered together: at least one.
fn group(left: &mut Peekable<impl Iterator<Item = wire::Definition>>) -> Vec<wire::Definition> {
    let mut points = 0;
    std::iter::from_fn(|| {
        left.next_if(|definition| {
            let is_first = points == 0;
            points += definition.as_ref().map_or(1, |definition| definition.points.len().max(1));
            is_first || points <= GROUP_POINTS
        })
    })
    .collect()
}

/// A hull that is no hull is its own result; a store that fails is the call's.
fn registered_result(app: &App, registered: Registered) -> Result<RegisterHullResult, ServiceError> {
    match registered {
        Ok((id, hull)) => {
            tracing::debug!(hull = %id, vertices = hull.vertex_count(), "registered");
            Ok(wire::register_result(Ok((id, &hull))))
        }
        Err(RegisterError::Hull(error)) => Ok(wire::register_result(Err(wire::hull_error(&error)))),
        Err(RegisterError::Store(error)) => Err(store_error(app, error)),
        Err(RegisterError::Internal(error)) => {
            tracing::error!(%error, "a hull could not be built");
            Err(ServiceError::internal("a hull could not be built"))
        }
    }
}
