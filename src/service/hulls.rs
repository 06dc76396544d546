//! `HullService`: registers, describes, lists and deletes hulls.

use std::{iter::Peekable, sync::Arc, time::Duration};

use tonic::{Request, Response, Status};

use super::{
    App, Limits, Reason, ServiceError,
    answer::answer,
    context::{CallContext, no_memory},
    decode::decode_request,
    records::{present, records},
    sizes::{GROUP_BYTES, LISTED_BYTES},
    wire,
};
use crate::{
    budget::{Part, Permit},
    compute::Job,
    contact::Stop,
    log_limit::limited,
    metrics::Shed,
    proto::{
        CONTRACT, DeleteHullsRequest, DeleteHullsResponse, Encoded, GetHullsRequest, GetHullsResponse,
        HasHullsRequest, HasHullsResponse, ListHullsRequest, ListHullsResponse, RegisterHullResult,
        RegisterHullsRequest, RegisterHullsResponse,
        hull_service_server::{HullService, HullServiceServer},
    },
    store::{RegisterError, Registered, StoreError, building_bytes},
};

/// The page size of `ListHulls` if the request gives none.
const DEFAULT_PAGE_SIZE: u32 = 1000;

/// The time after which a client should retry if the store cannot be read.
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
        let (definitions, _memory) = self.decode_request(&context, request).await?;
        let mut results = Vec::with_capacity(definitions.len());
        let mut left = definitions.into_iter().peekable();
        while left.peek().is_some() {
            results.extend(self.register(group(&mut left), &context.job).await?);
        }
        tracing::debug!(hulls = results.len(), "registered");
        let response = RegisterHullsResponse { results, contract: CONTRACT };
        Ok(Response::new(answer(&self.app, &context, response).await?))
    }

    async fn get_hulls(
        &self,
        request: Request<Encoded<GetHullsRequest>>,
    ) -> Result<Response<GetHullsResponse>, Status> {
        let context = CallContext::of(&request);
        let ((ids, parts), _memory) = self.decode_request(&context, request).await?;
        let (hulls, memory) = records(&self.app, &context, &ids, parts).await?;
        // The answer is charged with its exact size instead.
        drop(memory);
        Ok(Response::new(answer(&self.app, &context, GetHullsResponse { hulls }).await?))
    }

    async fn has_hulls(
        &self,
        request: Request<Encoded<HasHullsRequest>>,
    ) -> Result<Response<HasHullsResponse>, Status> {
        let context = CallContext::of(&request);
        let (ids, _memory) = self.decode_request(&context, request).await?;
        let present = present(&self.app, &context, &ids).await?;
        Ok(Response::new(answer(&self.app, &context, HasHullsResponse { present }).await?))
    }

    async fn list_hulls(
        &self,
        request: Request<Encoded<ListHullsRequest>>,
    ) -> Result<Response<ListHullsResponse>, Status> {
        let context = CallContext::of(&request);
        let (listing, _memory) = self.decode_request(&context, request).await?;
        let size = if listing.page_size == 0 { DEFAULT_PAGE_SIZE } else { listing.page_size };
        let size = size.min(self.app.limits().max_page_size) as usize;
        let listed = context.take(&self.app, Part::Answers, size.saturating_mul(LISTED_BYTES))?;
        let found = self.app.registry().list(listing.after, size, &context.job).await;
        let (blobs, more) = found.map_err(|error| store_error(&self.app, error))?;
        let page = wire::page(blobs, more);
        // The answer is charged with its exact size instead.
        drop(listed);
        Ok(Response::new(answer(&self.app, &context, page).await?))
    }

    async fn delete_hulls(
        &self,
        request: Request<Encoded<DeleteHullsRequest>>,
    ) -> Result<Response<DeleteHullsResponse>, Status> {
        let context = CallContext::of(&request);
        let (ids, _memory) = self.decode_request(&context, request).await?;
        let mut deleted = Vec::with_capacity(ids.len());
        // The hulls are deleted one after the other, so that an id that is named twice is
        // deleted once.
        for id in ids {
            let done = self.app.registry().delete(id, &context.job).await;
            deleted.push(done.map_err(|error| store_error(&self.app, error))?);
        }
        let hulls = deleted.iter().filter(|deleted| **deleted).count();
        if hulls > 0 {
            limited!(info, hulls, "deleted");
        }
        Ok(Response::new(answer(&self.app, &context, DeleteHullsResponse { deleted }).await?))
    }
}

impl Hulls {
    /// A decoded request, and its memory.
    async fn decode_request<M: wire::DecodeRequest>(
        &self,
        context: &CallContext,
        request: Request<Encoded<M>>,
    ) -> Result<(M::Decoded, Permit), ServiceError> {
        let keep = |decoded, memory, _: &Limits, _: &Stop| Ok((decoded, memory));
        decode_request(&self.app, context, request.into_inner(), keep).await
    }

    async fn register(
        &self,
        group: Vec<wire::CheckedDefinition>,
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

pub(super) fn unreadable() -> ServiceError {
    ServiceError::unavailable(
        Reason::StoreUnavailable,
        STORE_RETRY,
        "the store could not be read: retry later",
    )
}

fn store_error(app: &App, error: StoreError) -> ServiceError {
    limited!(warn, %error, "the store failed");
    match error {
        StoreError::Full(_) => ServiceError::new(Reason::StoreFull, error.to_string()),
        StoreError::Busy(_) => {
            app.metrics().shed(Shed::Store);
            ServiceError::unavailable(Reason::TooBusy, STORE_RETRY, format!("{error}: retry later"))
        }
        StoreError::Unavailable(_) | StoreError::Hung(_) | StoreError::NotABlob(_) => {
            ServiceError::unavailable(Reason::StoreUnavailable, STORE_RETRY, error.to_string())
        }
    }
}

/// The next hulls to be registered together; at least one.
fn group(left: &mut Peekable<impl Iterator<Item = wire::CheckedDefinition>>) -> Vec<wire::CheckedDefinition> {
    let mut bytes = 0;
    std::iter::from_fn(|| {
        left.next_if(|definition| {
            let is_first = bytes == 0;
            bytes += building_bytes(definition.as_ref().map_or(0, |definition| definition.points.len()));
            is_first || bytes <= GROUP_BYTES
        })
    })
    .collect()
}

/// A refused hull is a result of its own; a failing store fails the call.
fn registered_result(app: &App, registered: Registered) -> Result<RegisterHullResult, ServiceError> {
    match registered {
        Ok((id, hull)) => Ok(wire::register_result(Ok((id, &hull)))),
        Err(RegisterError::Hull(error)) => Ok(wire::register_result(Err(wire::hull_error(&error)))),
        Err(RegisterError::Store(error)) => Err(store_error(app, error)),
        Err(RegisterError::NoMemory(why)) => Err(no_memory(app.metrics(), why)),
        Err(RegisterError::Stopped) => Err(ServiceError::deadline_exceeded()),
        Err(RegisterError::Internal(error)) => {
            limited!(error, %error, "a hull could not be built");
            Err(ServiceError::internal("a hull could not be built; the server's log has the reason"))
        }
    }
}
