//! `ServerService`: describes the server and its limits.

use std::sync::Arc;

use tonic::{Request, Response, Status};

use super::{App, answer::answer, context::CallContext, decode::decode_request, wire};
use crate::proto::{
    Encoded, GetServerInfoRequest, GetServerInfoResponse,
    server_service_server::{ServerService, ServerServiceServer},
};

pub(super) fn service(app: Arc<App>) -> ServerServiceServer<impl ServerService> {
    ServerServiceServer::new(Info { app })
}

struct Info {
    app: Arc<App>,
}

#[tonic::async_trait]
impl ServerService for Info {
    async fn get_server_info(
        &self,
        request: Request<Encoded<GetServerInfoRequest>>,
    ) -> Result<Response<GetServerInfoResponse>, Status> {
        let context = CallContext::of(&request);
        decode_request(&self.app, &context, request.into_inner(), |(), _, _, _| Ok(())).await?;
        let (limits, threads) = (self.app.limits(), self.app.engine().threads());
        let info = wire::server_info(limits, threads, self.app.memory());
        Ok(Response::new(answer(&self.app, &context, info).await?))
    }
}
