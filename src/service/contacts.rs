//! `ContactService`: receives batches of pairs and returns contact manifolds.

use std::{future::Future, sync::Arc};

use futures_util::{
    StreamExt,
    stream::{self, BoxStream},
};
use tokio::{sync::watch, time::timeout_at};
use tonic::{Request, Response, Status, Streaming};

use super::{
    App, Limits, ServiceError,
    contact_stream::ContactStream,
    context::CallContext,
    decode::decode_request,
    find::FindCall,
    middleware::{Closing, Deadline},
    scene::answer,
    wire,
};
use crate::{
    contact::Stop,
    proto::{
        Encoded, QueryContactsRequest, QueryContactsResponse,
        contact_service_server::{ContactService, ContactServiceServer},
    },
};

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
        let check = |request, memory, limits: &Limits, stop: &Stop| {
            Ok((wire::stoppable_scene(request, limits, stop)?, memory))
        };
        let (scene, memory) = decode_request(&self.app, &context, request.into_inner(), check).await?;
        Ok(Response::new(answer(&self.app, &context, scene, memory).await?))
    }

    type FindContactsStream = BoxStream<'static, Result<QueryContactsResponse, Status>>;

    async fn find_contacts(
        &self,
        request: Request<Encoded<QueryContactsRequest>>,
    ) -> Result<Response<Self::FindContactsStream>, Status> {
        let deadline = request.extensions().get::<Deadline>().copied();
        let context = CallContext::of(&request);
        let finding = FindCall::begin(self.app.clone(), context, request.into_inner()).await?;
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
        let messages = ContactStream::new(self.app.clone(), context, request.into_inner(), closing);
        let answers = stream::try_unfold(messages, move |mut messages| async move {
            let step = within(deadline, messages.next()).await?;
            Ok(step.map(|answer| (answer, messages)))
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
