//! `HullService`: hulls registered, described, listed and deleted.

use std::{iter::Peekable, sync::Arc, time::Duration};

use tonic::{Request, Response, Status};

use super::{
    App, Limits, ServiceError,
    context::CallContext,
    decode::decoded,
    records::{present, records},
    wire,
};
use crate::{
    budget::{Part, Permit},
    contact::Stop,
    proto::{
        DeleteHullsRequest, DeleteHullsResponse, Encoded, GetHullsRequest, GetHullsResponse, HasHullsRequest,
        HasHullsResponse, ListHullsRequest, ListHullsResponse, RegisterHullResult, RegisterHullsRequest,
        RegisterHullsResponse,
        hull_service_server::{HullService, HullServiceServer},
    },
    store::{RegisterError, Registered, StoreError},
};

/// Points of the hulls that are registered at a time: enough that all threads are busy,
/// and what is built but not stored yet stays small, some 25 MB.
const GROUP_POINTS: usize = 1 << 16;

/// Of `ListHulls`, where the request names none.
const DEFAULT_PAGE_SIZE: u32 = 1000;

/// Bytes of memory for each hull of a page of `ListHulls`: as the store names it, and twice in
/// the answer.
const LISTED_BYTES: usize = 320;

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
        request: Request<Encoded<RegisterHullsRequest>>,
    ) -> Result<Response<RegisterHullsResponse>, Status> {
        let context = CallContext::of(&request);
        let (definitions, _memory) = self.decoded(&context, request).await?;
        let mut results = Vec::with_capacity(definitions.len());
        let mut left = definitions.into_iter().peekable();
        while left.peek().is_some() {
            results.extend(self.register(group(&mut left)).await?);
        }
        Ok(self.app.bounded_answer(&context, RegisterHullsResponse { results })?)
    }

    async fn get_hulls(
        &self,
        request: Request<Encoded<GetHullsRequest>>,
    ) -> Result<Response<GetHullsResponse>, Status> {
        let context = CallContext::of(&request);
        let ((ids, parts), _memory) = self.decoded(&context, request).await?;
        let (hulls, memory) = records(&self.app, &context, &ids, parts).await?;
        // The answer's exact size takes its place.
        drop(memory);
        Ok(self.app.bounded_answer(&context, GetHullsResponse { hulls })?)
    }

    async fn has_hulls(
        &self,
        request: Request<Encoded<HasHullsRequest>>,
    ) -> Result<Response<HasHullsResponse>, Status> {
        let context = CallContext::of(&request);
        let (ids, _memory) = self.decoded(&context, request).await?;
        let present = present(&self.app, &ids).await?;
        Ok(self.app.bounded_answer(&context, HasHullsResponse { present })?)
    }

    async fn list_hulls(
        &self,
        request: Request<Encoded<ListHullsRequest>>,
    ) -> Result<Response<ListHullsResponse>, Status> {
        let context = CallContext::of(&request);
        let (listing, _memory) = self.decoded(&context, request).await?;
        let size = if listing.page_size == 0 { DEFAULT_PAGE_SIZE } else { listing.page_size };
        let size = size.min(self.app.limits().max_page_size) as usize;
        let listed = context.take(&self.app, Part::Answers, size.saturating_mul(LISTED_BYTES))?;
        let (blobs, more) = self.app.registry().list(listing.after, size).await.map_err(store_error)?;
        let page = wire::page(blobs, more);
        // The answer's exact size takes its place.
        drop(listed);
        Ok(self.app.bounded_answer(&context, page)?)
    }

    async fn delete_hulls(
        &self,
        request: Request<Encoded<DeleteHullsRequest>>,
    ) -> Result<Response<DeleteHullsResponse>, Status> {
        let context = CallContext::of(&request);
        let (ids, _memory) = self.decoded(&context, request).await?;
        let mut deleted = Vec::with_capacity(ids.len());
        // One after the other: an id that is named twice is deleted once.
        for id in ids {
            deleted.push(self.app.registry().delete(id).await.map_err(store_error)?);
        }
        tracing::info!(hulls = deleted.iter().filter(|deleted| **deleted).count(), "deleted");
        Ok(self.app.bounded_answer(&context, DeleteHullsResponse { deleted })?)
    }
}

impl Hulls {
    /// A request, and its memory.
    async fn decoded<M: wire::Request>(
        &self,
        context: &CallContext,
        request: Request<Encoded<M>>,
    ) -> Result<(M::Decoded, Permit), ServiceError> {
        let keep = |decoded, memory, _: &Limits, _: &Stop| Ok((decoded, memory));
        decoded(&self.app, context, request.into_inner(), keep).await
    }

    async fn register(&self, group: Vec<wire::Definition>) -> Result<Vec<RegisterHullResult>, ServiceError> {
        let (mut given, mut malformed) = (Vec::with_capacity(group.len()), Vec::with_capacity(group.len()));
        for definition in group {
            malformed.push(definition.map(|definition| given.push(definition)).err());
        }
        let mut registered = self.app.registry().register(given).await.into_iter();
        let result = |malformed| match malformed {
            Some(error) => Some(Ok(wire::register_result(Err(error)))),
            None => registered.next().map(registered_result),
        };
        malformed.into_iter().filter_map(result).collect()
    }
}

pub(super) fn unreadable() -> ServiceError {
    ServiceError::unavailable("STORE_UNAVAILABLE", STORE_RETRY, "the store could not be read")
}

fn store_error(error: StoreError) -> ServiceError {
    tracing::warn!(%error, "the store failed");
    match error {
        StoreError::Full(_) => ServiceError::store_full(error.to_string()),
        StoreError::Unavailable(_) => {
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
fn registered_result(registered: Registered) -> Result<RegisterHullResult, ServiceError> {
    match registered {
        Ok((id, hull)) => {
            tracing::debug!(hull = %id, vertices = hull.vertex_count(), "registered");
            Ok(wire::register_result(Ok((id, &hull))))
        }
        Err(RegisterError::Hull(error)) => Ok(wire::register_result(Err(wire::hull_error(&error)))),
        Err(RegisterError::Store(error)) => Err(store_error(error)),
        Err(RegisterError::Internal(error)) => {
            tracing::error!(%error, "a hull could not be built");
            Err(ServiceError::internal("a hull could not be built"))
        }
    }
}
